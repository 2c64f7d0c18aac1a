"""Robots and simulated campaigns that several test files share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pyarrow.csv
import yaml
from repository import ROOT
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.model.model import LabelledFrames, Model
from aridcal.engine.robot.chain import Robot, load_robot, parse_robot
from aridcal.engine.rows.dataset import Dataset, dataset, with_places, with_sigma
from aridcal.files.campaign import Campaign
from aridcal.files.yaml_file import parse_settings

URDF = ROOT / "urdf"
SHARED_ROBOTS = Path(pin.__file__).resolve().parents[4] / "share" / "example-robot-data" / "robots"

FRAMES = tuple(Coefficient(where, c) for where in ("world_base", "tip_target") for c in FRAME_COMPONENTS)


def arid() -> Robot:
    """Doty's arm."""
    return load_robot(URDF / "arid.urdf", "flange")


def ur10() -> Robot:
    """Six revolute joints."""
    return load_robot(URDF / "ur10.urdf", "tool0")


def numbers(values: np.ndarray) -> str:
    """Numbers as a URDF attribute, exact."""
    return " ".join(f"{v:.17g}" for v in values)


def random_chain(rng: np.random.Generator, kinds: str = "RPRCR", aligned: bool = False) -> bytes:
    """URDF of a chain base -> tip of revolute, prismatic and continuous joints: any axes, any masses.

    Two fixed joints stand between joints 1 and 2 and one ends the chain; joint 1's link carries a moving side branch.
    """
    types = {"R": "revolute", "P": "prismatic", "C": "continuous"}
    parts = ['<?xml version="1.0"?>', '<robot name="random">', '<link name="base"/>']
    parent = "base"

    def link(name: str) -> None:
        mass, com = rng.uniform(0.5, 5.0), rng.uniform(-0.3, 0.3, 3)
        inertia = " ".join(f'{k}="{v}"' for k, v in zip(("ixx", "iyy", "izz"), rng.uniform(0.2, 0.3, 3), strict=True))
        parts.append(
            f'<link name="{name}"><inertial><origin xyz="{numbers(com)}" rpy="{numbers(rng.uniform(-1, 1, 3))}"/>'
            f'<mass value="{mass:.17g}"/><inertia {inertia} ixy="0.01" ixz="0" iyz="-0.02"/></inertial></link>'
        )

    def joint(name: str, kind: str, parent: str, child: str) -> None:
        axis = np.eye(3)[rng.integers(3)] if aligned else rng.normal(size=3)
        axis = axis / np.linalg.norm(axis)
        limits = "" if kind == "continuous" else '<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>'
        moving = "" if kind == "fixed" else f'<axis xyz="{numbers(axis)}"/>{limits}'
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{numbers(rng.uniform(-0.6, 0.6, 3))}" rpy="{numbers(rng.uniform(-2, 2, 3))}"/>'
            f"{moving}</joint>"
        )

    for k, kind in enumerate(kinds, start=1):
        link(f"link_{k}")
        joint(f"joint_{k}", types[kind], parent, f"link_{k}")
        parent = f"link_{k}"
        if k == 1:
            for name in ("bracket", "plate"):
                link(name)
                joint(f"{name}_fixed", "fixed", parent, name)
                parent = name
            link("branch")
            joint("branch_joint", "revolute", "link_1", "branch")
    link("tip")
    joint("tip_fixed", "fixed", parent, "tip")
    return "\n".join([*parts, "</robot>"]).encode()


def random_robot(seed: int, kinds: str = "RPRCR", aligned: bool = False) -> Robot:
    """The chain of :func:`random_chain`."""
    return parse_robot(random_chain(np.random.default_rng(seed), kinds, aligned), "tip")


def readings(robot: Robot, n: int, rng: np.random.Generator, share: float = 1.0) -> np.ndarray:
    """Readings within the limits, shape (n, columns); half a turn each way where there are none."""
    low, high = np.clip(robot.limits, -np.pi, np.pi).T
    middle, half = (low + high) / 2, share * (high - low) / 2
    return rng.uniform(middle - half, middle + half, (n, len(low)))


def random_placement(rng: np.random.Generator, size: float = 2.0) -> pin.SE3:
    """Any attitude, anywhere within ``size`` metres."""
    return pin.SE3(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-size, size, 3))


@dataclass(frozen=True)
class Truth:
    """A machine as it really is: its model, its coefficients, and what was measured of it."""

    model: Model
    theta: np.ndarray
    measured: Dataset

    @property
    def readings(self) -> np.ndarray:
        return self.measured.readings

    def data(self, model: Model, *sigma: float) -> Problem:
        """The rows as another model sees them, with the noise that is declared of them."""
        return problem(model, declared(self.measured, *sigma))


def measured(robot: Robot, q: np.ndarray, position: np.ndarray, rotation: np.ndarray | None = None) -> Dataset:
    """Rows as if they had been read from a file, all of them for training."""
    rows = dataset(robot.readings, robot.kinds, q, position, rotation)
    return rows.with_origin(files=(Path("m.csv"),))


def positions_alone(rows: Dataset) -> Dataset:
    """The same rows of which no rotation was measured."""
    return with_places(rows, rows.position)


def placed(rows: Dataset, **changes: object) -> Dataset:
    """The same rows with another measured ``position`` or ``rotation`` of the target, and other fields besides."""
    position, rotation = (changes.pop(of, getattr(rows, of)) for of in ("position", "rotation"))
    return replace(with_places(rows, position, rotation), **changes)


def declared(rows: Dataset, *sigma: float | None) -> Dataset:
    """The same rows with declared noise of position and rotation; what is not given is to be estimated."""
    missing = (None,) * len(rows.channels)
    return with_sigma(rows, (*sigma, *missing)[: len(rows.channels)])


def simulate(
    robot: Robot,
    n: int,
    rng: np.random.Generator,
    size: float = 1e-3,
    noise: float = 0.0,
    which: str = "full",
    world: pin.SE3 | None = None,
    tip: pin.SE3 | None = None,
    kind: str = "pose",
) -> Truth:
    """Measure a robot whose constants are off by ``size`` [m, rad], with noise per axis [m, rad]."""
    coefficients = constants(robot, which)
    frames: tuple[LabelledFrames, LabelledFrames] = (
        ((None, world or pin.SE3.Identity()),),
        ((None, tip or pin.SE3.Identity()),),
    )
    model = Model(robot, coefficients, *frames)
    theta = rng.normal(0.0, size, len(coefficients))
    q = readings(robot, n, rng)
    R, p = model.poses(theta, model.rows(q))
    p = p + noise * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(noise * rng.normal(size=p.shape)).as_matrix() @ R
    return Truth(model, theta, measured(robot, q, p, R if kind == "pose" else None))


def table(truth: Truth) -> pd.DataFrame:
    """The rows as a table of measurements."""
    columns = dict(zip(truth.model.robot.readings, truth.readings.T, strict=True))
    columns |= dict(zip("xyz", truth.measured.position.T, strict=True))
    if truth.measured.rotation is not None:
        q = Rotation.from_matrix(truth.measured.rotation).as_quat(canonical=True)
        columns |= dict(zip(("qx", "qy", "qz", "qw"), q.T, strict=True))
    return pd.DataFrame(columns)


def read_csv(path: Path) -> pd.DataFrame:
    """A table with every digit of its numbers, which pandas' own reader does not promise."""
    return pyarrow.csv.read_csv(path).to_pandas()


def write_campaign(folder: Path, truth: Truth, rows: pd.DataFrame | None = None, **changes: object) -> Path:
    """Write robot, table and campaign.yaml into a folder; ``changes`` replace top keys of the campaign."""
    robot = truth.model.robot
    (folder / "robot.urdf").write_bytes(robot.urdf)
    (table(truth) if rows is None else rows).to_csv(folder / "measurements.csv", index=False, float_format="%.17g")
    keys: dict[str, object] = {
        "format": 1,
        "robot": {"urdf": "robot.urdf", "base": robot.base, "tip": robot.tip},
        "measurements": {"file": "measurements.csv", "kind": "position" if truth.measured.rotation is None else "pose"},
        "diagnosis": {"enabled": False},
    }
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(keys | changes, sort_keys=False))
    return path


def campaign(kind: str = "pose", **sections: object) -> Campaign:
    """A campaign's settings, without its files."""
    keys = {"format": 1, "robot": {"urdf": "r.urdf", "tip": "tip"}, "measurements": {"file": "m.csv", "kind": kind}}
    return parse_settings(yaml.safe_dump(keys | sections), Path("campaign.yaml"), Campaign)


def measurements(truth: Truth, station: np.ndarray | None = None) -> Dataset:
    """The rows, at stations if there are any."""
    return truth.measured.with_labels(station=station)


def moved(truth: Truth, world: pin.SE3, tip: pin.SE3) -> Truth:
    """The same rows seen from elsewhere, with the target elsewhere on the tip (poses only)."""
    R, p = truth.measured.rotation, truth.measured.position
    assert R is not None
    p = (p + R @ tip.translation) @ world.rotation.T + world.translation
    frames = [((None, world * truth.model.world_base[0][1]),), ((None, truth.model.tip_target[0][1] * tip),)]
    model = replace(truth.model, world_base=frames[0], tip_target=frames[1])
    rows = placed(truth.measured, position=p, rotation=world.rotation @ R @ tip.rotation)
    return replace(truth, model=model, measured=rows)


TIME = Basis("linear", ("time",), (0.5,))


def wave(joint: str) -> Basis:
    return Basis("sin", (joint,), (1.5,))


def varying(robot: Robot) -> tuple[Coefficient, ...]:
    """Every component that an effect may move, each with a basis that differs from row to row."""
    found = []
    for joint in robot.joints:
        own = ("axis", "t1", "t2", "r1", "r2")
        own = (*own, "roll", "pitch", "yaw") if joint.kind == "prismatic" else own
        found += [Coefficient(joint.name, c, wave(joint.name)) for c in own]
        found.append(Coefficient(joint.name, "axis", Basis("linear", (f"{joint.name}.gravity_torque",), (0.0,))))
    frames = [Coefficient(w, c, TIME) for w in ("world_base", "tip_target") for c in FRAME_COMPONENTS]
    return tuple(found + frames)
