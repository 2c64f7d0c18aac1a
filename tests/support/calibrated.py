"""Calibrated robots of which the truth is known, and new rows measured on them, for the tests of check and recalibrate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import robots
import yaml
from repository import ROOT
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import fit_identifiable
from aridcal.engine.fit.stages import recentred
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign

NOISE = 5e-5
"""[m] and [rad]: of a laser tracker."""


@dataclass(frozen=True)
class Machine:
    """A robot as it is, and as it was calibrated.

    Attributes:
        model: With its true coefficients ``theta``.
        theta: Shape (K,).
        saved: The calibration.
        rng: For all that is drawn of it.
    """

    model: Model
    theta: np.ndarray
    saved: SavedModel
    rng: np.random.Generator

    def configurations(self, n: int) -> np.ndarray:
        """Random readings where it was calibrated, shape (n, columns)."""
        return robots.readings(self.model.robot, n, self.rng, 0.6)

    def measured(self, readings: np.ndarray, offset: np.ndarray | float = 0.0, noise: float = NOISE) -> Dataset:
        """Rows with noise; the joints really stand ``offset`` beside their readings."""
        kind = self.saved.kind
        return measured(self.model, self.theta, readings, readings + offset, noise, self.rng, kind)


def measured(
    model: Model,
    theta: np.ndarray,
    readings: np.ndarray,
    real: np.ndarray,
    noise: float,
    rng: np.random.Generator,
    kind: str,
) -> Dataset:
    """Rows of a true model whose joints really stand at ``real``, and are read as ``readings``; noise declared."""
    R, p = model.poses(theta, model.rows(real))
    p = p + noise * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(noise * rng.normal(size=p.shape)).as_matrix() @ R
    return robots.declared(robots.measured(model.robot, readings, p, R if kind == "pose" else None), NOISE, NOISE)


def machine(
    seed: int,
    kind: str = "pose",
    n: int = 100,
    effects: tuple[tuple[Coefficient, float], ...] = (),
    robot: Robot | None = None,
) -> Machine:
    """A UR10, or another arm, with constants off by 1 mm and 1 mrad, calibrated with n rows.

    Args:
        seed: Of everything.
        kind: ``pose`` or ``position``.
        n: Rows.
        effects: Coefficients that it has besides, with their values.
        robot: The other arm.
    """
    rng = np.random.default_rng(seed)
    robot = robot or robots.ur10()
    own = constants(robot, "full")
    frames = ((None, robots.random_placement(rng)),), ((None, robots.random_placement(rng, 0.3)),)
    model = Model(robot, (*robots.FRAMES, *own, *(c for c, _ in effects)), *frames)
    theta = np.concatenate([np.zeros(12), rng.normal(0.0, 1e-3, len(own)), [value for _, value in effects]])
    q = robots.readings(robot, n, rng, 0.6)
    rows = measured(model, theta, q, q, NOISE, rng, kind)
    fit = recentred(fit_identifiable(robots.problem(model, rows), range(len(theta))))
    final = SolvedModel(fit.model, fit.theta, fit.covariance)
    keep = np.flatnonzero([c.basis.constant for c in fit.model.coefficients])
    constant = fit.model.with_coefficients([fit.model.coefficients[k] for k in keep])
    geometric = SolvedModel(constant, fit.theta[keep], fit.covariance[np.ix_(keep, keep)])
    ranges = {name: (float(v.min()), float(v.max())) for name, v in zip(robot.readings, q.T, strict=True)}
    saved = SavedModel(geometric, final, kind, (0.0, 0.0, -9.81), (NOISE, NOISE), ranges, {})
    return Machine(model, theta, saved, rng)


def jump(joint: int, size: float) -> np.ndarray:
    """An offset of one joint of six, shape (6,)."""
    return size * np.eye(6)[joint]


def with_frame(rows: Dataset, rotation: np.ndarray, shift: np.ndarray) -> Dataset:
    """The rows as an instrument sees them that stands elsewhere."""
    turned = None if rows.rotation is None else rotation @ rows.rotation
    return robots.placed(rows, position=rows.position @ rotation.T + shift, rotation=turned)


def table(rows: Dataset, path: Path) -> Path:
    """The rows as a table of measurements in SI."""
    frame = robots.table(robots.Truth(Model(robots.ur10(), ()), np.zeros(0), rows))
    frame.to_csv(path, index=False, float_format="%.17g")
    return path


SEEN = {"position": NOISE, "rotation": NOISE, "distance": NOISE, "pixel": 0.1, "inclination": 2e-5}
"""Noise of instruments: of lengths and turns that of the tracker, 0.1 px of a camera, 0.02 mrad of a level."""


def by_instruments(
    m: Machine,
    folder: Path,
    kinds: Sequence[str],
    offset: np.ndarray | float = 0.0,
    instruments: object = None,
    **truth: object,
) -> Path:
    """A small campaign of what other instruments measured of a machine whose joints stand beside their readings.

    Args:
        m: The machine.
        folder: Where its files are written.
        kinds: Of its blocks.
        offset: Of the joints, shape (columns,).
        instruments: As in a campaign.
        truth: More of the scenario's: ``n`` for instance.
    """
    own = {
        c.name: float(value)
        for c, value in zip(m.model.coefficients, m.theta, strict=True)
        if c.where not in ("world_base", "tip_target")
    }
    frames = {where: _stated(getattr(m.model, where)[0][1]) for where in ("world_base", "tip_target")}
    keys = {
        "format": 1,
        "robot": {"urdf": str(ROOT / "urdf" / "ur10.urdf"), "tip": "tool0"},
        "measurements": [{"kind": kind} for kind in kinds],
        "truth": {"parameters": own, "frames": frames, "noise": SEEN, "n": 20, "seed": 4} | truth,
        **({"instruments": instruments} if instruments else {}),
    }
    (folder / "scenario.yaml").write_text(yaml.safe_dump(keys))
    write_campaign(simulate(load_settings(folder / "scenario.yaml", Scenario)), folder, folder)
    made = yaml.safe_load((folder / "campaign.yaml").read_text())
    del made["robot"]
    blocks = made["measurements"] if isinstance(made["measurements"], list) else [made["measurements"]]
    for block in blocks:
        block["noise"] = {channel.name: SEEN[channel.name] for channel in MEASUREMENT_KINDS[block["kind"]].channels}
        rows = robots.read_csv(folder / block["file"])
        rows[list(m.model.robot.readings)] -= offset
        rows.to_csv(folder / block["file"], index=False, float_format="%.17g")
    (folder / "campaign.yaml").write_text(yaml.safe_dump(made))
    return folder / "campaign.yaml"


def _stated(frame: pin.SE3) -> dict[str, list[float]]:
    return {"xyz": frame.translation.tolist(), "rpy": pin.rpy.matrixToRpy(frame.rotation).tolist()}
