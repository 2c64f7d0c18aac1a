"""What holds for every robot, table and calibration, not only for those that somebody thought of: drawn by Hypothesis."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
from hypothesis import HealthCheck, Phase, assume, example, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import Geometry, fit_geometry
from aridcal.engine.instruments.camera import predict_pixels, rays
from aridcal.engine.instruments.camera_sonar import predict_ranges
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.engine.robot.splice import splice_origins
from aridcal.engine.rows.dataset import Dataset, RowNoise, weighed
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.measurement_settings import ANGLES, LENGTHS
from aridcal.files.read import load_measurements
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel


def examples(n: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The same examples every time; a slow machine is no failure."""
    return settings(
        max_examples=n, derandomize=True, deadline=None, database=None, phases=(Phase.explicit, Phase.generate, Phase.shrink),
        suppress_health_check=(HealthCheck.too_slow, HealthCheck.function_scoped_fixture),
    )  # fmt: skip


SEEDS = st.integers(0, 2**32 - 1)
LENGTH = st.floats(-3.0, 3.0)
ANGLE = st.floats(-7.0, 7.0)  # more than once round
VECTOR = st.tuples(LENGTH, LENGTH, LENGTH)
RPY = st.tuples(ANGLE, ANGLE, ANGLE)
AXIS = st.one_of(
    st.sampled_from([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]),
    st.tuples(LENGTH, LENGTH, LENGTH).filter(lambda axis: np.linalg.norm(axis) > 0.1),
)


@dataclass(frozen=True)
class Drawn:
    """A joint as it was drawn; ``master`` is the number of the joint that it mimics."""

    kind: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    master: int | None = None
    multiplier: float = 1.0
    offset: float = 0.0


@st.composite
def chains(draw: st.DrawFn, most: int = 6) -> list[Drawn]:
    """Revolute, continuous, prismatic and fixed joints with any axes and origins; some mimic one before them."""
    kinds = draw(st.lists(st.sampled_from(["revolute", "continuous", "prismatic", "fixed"]), min_size=1, max_size=most))
    assume(set(kinds) != {"fixed"})
    drawn: list[Drawn] = []
    for kind in kinds:
        own = Drawn(kind, draw(VECTOR), draw(RPY), draw(AXIS))
        masters = [k for k, joint in enumerate(drawn) if joint.kind != "fixed" and joint.master is None]
        if masters and kind != "fixed" and draw(st.integers(0, 3)) == 0:
            own = replace(own, master=draw(st.sampled_from(masters)), multiplier=draw(LENGTH), offset=draw(LENGTH))
        drawn.append(own)
    return drawn


def urdf(drawn: list[Drawn]) -> bytes:
    """The chain as a URDF, every number exact."""
    lines = ['<robot name="drawn"><link name="link_0"/>']
    for k, joint in enumerate(drawn):
        mimic = f'<mimic joint="joint_{joint.master}" multiplier="{joint.multiplier!r}" offset="{joint.offset!r}"/>'
        limits = (
            '<limit lower="-9" upper="9" effort="1" velocity="1"/>' if joint.kind in ("revolute", "prismatic") else ""
        )
        lines.append(
            f'<link name="link_{k + 1}"/><joint name="joint_{k}" type="{joint.kind}"><parent link="link_{k}"/>'
            f'<child link="link_{k + 1}"/><origin xyz="{robots.numbers(np.array(joint.xyz))}" '
            f'rpy="{robots.numbers(np.array(joint.rpy))}"/><axis xyz="{robots.numbers(np.array(joint.axis))}"/>'
            f"{limits}{mimic if joint.master is not None else ''}</joint>"
        )
    return "\n".join([*lines, "</robot>"]).encode()


def robot_of(drawn: list[Drawn]) -> Robot:
    return parse_robot(urdf(drawn), f"link_{len(drawn)}")


def product_of_exponentials(drawn: list[Drawn], reading: dict[str, float]) -> np.ndarray:
    """T_base_tip(q) = exp(S_1 q_1) exp(S_2 q_2) ... M, each screw S in the base frame at q = 0 (Brockett 1984)."""
    M, T = np.eye(4), np.eye(4)
    for k, joint in enumerate(drawn):
        own = np.eye(4)
        own[:3, :3] = Rotation.from_euler("xyz", joint.rpy).as_matrix()
        own[:3, 3] = joint.xyz
        M = M @ own
        if joint.kind == "fixed":
            continue
        axis, at = M[:3, :3] @ (np.array(joint.axis) / np.linalg.norm(joint.axis)), M[:3, 3]
        screw = np.zeros((4, 4))
        if joint.kind == "prismatic":
            screw[:3, 3] = axis
        else:
            screw[:3, :3] = np.cross(np.eye(3), axis)
            screw[:3, 3] = -np.cross(axis, at)
        q = reading[f"joint_{k if joint.master is None else joint.master}"]
        T = T @ expm(screw * (joint.multiplier * q + joint.offset))
    return T @ M


def random_readings(robot: Robot, n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-3.0, 3.0, (n, len(robot.readings)))


# --- model


@examples(40)
@given(chains(), SEEDS)
def test_forward_kinematics_is_the_product_of_exponentials(drawn: list[Drawn], seed: int) -> None:
    robot = robot_of(drawn)
    model = Model(robot, ())
    q = random_readings(robot, 2, seed)
    R, p = model.poses(np.zeros(0), model.rows(q))
    for k, row in enumerate(q):
        expected = product_of_exponentials(drawn, dict(zip(robot.readings, row.tolist(), strict=True)))
        np.testing.assert_allclose(R[k], expected[:3, :3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(p[k], expected[:3, 3], rtol=0, atol=1e-11)


@examples(25)
@given(chains(4), SEEDS)
def test_every_column_of_the_jacobian_is_the_difference_of_two_poses(drawn: list[Drawn], seed: int) -> None:
    robot = robot_of(drawn)
    rng = np.random.default_rng(seed)
    moving = [
        Coefficient(j.name, c, Basis("linear", (*j.drive.factors,), (0.3,)))
        for j in robot.joints
        for c in ("axis", "r1")
    ]
    coefficients = (*robots.FRAMES, *constants(robot, "full"), *moving)
    world, tip = (((None, robots.random_placement(rng)),) for _ in range(2))
    model = Model(robot, coefficients, world, tip)
    rows = model.rows(random_readings(robot, 2, seed))
    theta, h = rng.normal(0, 0.05, len(coefficients)), 1e-5
    _, _, J = model.jacobian(theta, rows)
    for k, step in enumerate(h * np.eye(len(theta))):
        (R_up, p_up), (R_down, p_down) = (model.poses(theta + s * step, rows) for s in (1, -1))
        slide = (p_up - p_down) / (2 * h)
        turn = Rotation.from_matrix(R_up @ R_down.transpose(0, 2, 1)).as_rotvec() / (2 * h)
        size = 1.0 + np.abs(J[:, :, k]).max()  # error of the difference: h² times third derivatives, and rounding / h
        np.testing.assert_allclose(
            J[:, :, k], np.hstack([slide, turn]), rtol=0, atol=1e-7 * size, err_msg=model.names[k]
        )


@examples(25)
@given(chains(), SEEDS)
def test_a_command_does_what_it_says_and_stays_where_the_target_is_already(drawn: list[Drawn], seed: int) -> None:
    """The errors that it states are those of the forward model; from the right readings it does not leave; limits hold."""
    robot = robot_of(drawn)
    model = Model(robot, ())
    solved = SolvedModel(model, np.zeros(0), np.zeros((0, 0)))
    saved = SavedModel(solved, solved, "pose", (0.0, 0.0, -9.81), (1e-4, 1e-4), {}, {})
    q, off = random_readings(robot, 2, seed)
    R, p = model.poses(np.zeros(0), model.rows(q[None]))
    wanted = np.eye(4)
    wanted[:3, :3], wanted[:3, 3] = R[0], p[0]
    for start in (q, q + 0.05 * off):
        found = saved.command(wanted, start)
        R_found, p_found = model.poses(np.zeros(0), model.rows(found.readings[None]))
        assert found.position_error == pytest.approx(float(np.linalg.norm(p_found[0] - p[0])), abs=1e-9)
        turn = Rotation.from_matrix(R_found[0] @ R[0].T).magnitude()
        assert found.rotation_error == pytest.approx(float(turn), abs=1e-7)
        low, high = robot.limits.T
        assert ((found.readings >= low) & (found.readings <= high)).all()
        if start is q:
            assert found.reached
            np.testing.assert_allclose(found.readings, q, rtol=0, atol=1e-6)


# --- formats

SEQUENCES = [s for s in ("xyz", "zyx", "zxz", "XYZ", "ZYX", "XZX", "YXZ")]


@dataclass(frozen=True)
class Dialect:
    """Units, and how orientations are written: a sequence of Euler angles, ``rotvec`` or ``quaternion``."""

    length: str
    angle: str
    orientation: str

    def table(self, robot: Robot, q: np.ndarray, position: np.ndarray, rotation: Rotation) -> pd.DataFrame:
        metres, radians = LENGTHS[self.length], ANGLES[self.angle]
        one = np.where([kind == "prismatic" for kind in robot.kinds], metres, radians)
        columns = dict(zip(robot.readings, (q / one).T, strict=True)) | dict(
            zip("xyz", (position / metres).T, strict=True)
        )
        if self.orientation == "quaternion":
            return pd.DataFrame(columns | dict(zip(("qx", "qy", "qz", "qw"), rotation.as_quat().T, strict=True)))
        turn = rotation.as_rotvec() if self.orientation == "rotvec" else rotation.as_euler(self.orientation)
        return pd.DataFrame(columns | dict(zip(("r1", "r2", "r3"), (turn / radians).T, strict=True)))

    def campaign(self) -> Campaign:
        columns = ["r1", "r2", "r3"]
        ways = {"quaternion": "quaternion", "rotvec": {"rotvec": columns}}
        orientation = ways.get(self.orientation, {"euler": self.orientation, "columns": columns})
        units = {"length": self.length, "angle": self.angle}
        measurements = {"file": "m.csv", "kind": "pose", "units": units, "orientation": orientation}
        return robots.campaign(measurements=measurements)


DIALECTS = st.builds(
    Dialect,
    st.sampled_from(list(LENGTHS)),
    st.sampled_from(list(ANGLES)),
    st.sampled_from(["quaternion", "rotvec", *SEQUENCES]),
)


def load(robot: Robot, campaign: Campaign, table: Path | pd.DataFrame) -> Dataset:
    return as_written(load_measurements(campaign, robot.readings, robot.limits, robot.kinds, files=[table]))


def as_written(data: Dataset) -> Dataset:
    """The rows in the order of the file: they are kept in one of their own."""
    return data.select(np.argsort(data.origin.line))


@examples(30)
@given(DIALECTS, SEEDS)
def test_the_same_poses_in_any_units_and_angles_are_the_same_data(dialect: Dialect, seed: int) -> None:
    robot, rng = robots.random_robot(1, "RPC"), np.random.default_rng(seed)
    q = rng.uniform(-1.4, 1.4, (12, 3))
    position, rotation = rng.uniform(-2, 2, (12, 3)), Rotation.random(12, rng=rng)
    read = load(robot, dialect.campaign(), dialect.table(robot, q, position, rotation))
    np.testing.assert_allclose(read.readings, q, rtol=1e-14)
    np.testing.assert_allclose(read.position, position, rtol=1e-14)
    assert read.rotation is not None
    # Euler angles near their lock lose half the digits of a rotation; scipy's own way back bounds it.
    np.testing.assert_allclose(read.rotation, rotation.as_matrix(), rtol=0, atol=1e-7)


NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=True)
WORDS = st.text(st.characters(codec="utf-8", exclude_characters="\r\n\0", exclude_categories=("Cs", "Cc")), max_size=8)


@examples(25)
@given(st.lists(st.tuples(NUMBERS, NUMBERS, WORDS), min_size=6, max_size=9), SEEDS)
def test_csv_parquet_and_a_dataframe_give_the_same_data_to_the_bit(
    tmp_path: Path, cells: list[tuple[float, float, str]], seed: int
) -> None:
    robot, rng = robots.random_robot(1, "RP"), np.random.default_rng(seed)
    table = Dialect("m", "rad", "quaternion").table(
        robot,
        rng.uniform(-1, 1, (len(cells), 2)),
        rng.uniform(-2, 2, (len(cells), 3)),
        Rotation.random(len(cells), rng=rng),
    )
    table = table.assign(
        time=[a for a, _, _ in cells], temperature=[b for _, b, _ in cells], note=[c.strip() for *_, c in cells]
    )
    table.to_csv(tmp_path / "m.csv", index=False)
    table.to_parquet(tmp_path / "m.parquet", index=False)
    settings = robots.campaign(measurements={"file": "m.csv", "kind": "pose", "ignore": ["note"]})
    one, *others = (load(robot, settings, t) for t in (tmp_path / "m.csv", tmp_path / "m.parquet", table))
    for other in others:
        for name in ("readings", "position", "rotation", "test", "origin.line", "origin.order",
                     "repeats.configuration", "repeats.stale"):  # fmt: skip
            np.testing.assert_array_equal(attrgetter(name)(one), attrgetter(name)(other), err_msg=name)
        assert set(one.covariates) == set(other.covariates) == {"time", "temperature"}
        for name, values in one.covariates.items():
            np.testing.assert_array_equal(values, other.covariates[name])


KIND_TABLES = st.lists(
    st.sampled_from(["position", "point", "distance", "plane", "pixels", "inclination"]),
    min_size=1,
    max_size=3,
    unique=True,
)


@examples(25)
@given(KIND_TABLES, SEEDS)
def test_permuted_rows_of_any_kinds_are_the_same_data(tmp_path: Path, kinds: list[str], seed: int) -> None:
    """In every number, label, split and thing; lines alone follow the file."""
    robot, rng = robots.random_robot(2, "RP"), np.random.default_rng(seed)
    eye = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0}
    blocks = [{"kind": kind, "file": str(tmp_path / f"{kind}.csv")} for kind in kinds]
    instruments = {"cameras": {"eye": eye}} if "pixels" in kinds else {}
    campaign = robots.campaign(measurements=blocks, instruments=instruments)
    tables = {kind: rows_of(kind, robot, rng) for kind in kinds}
    read = []
    for _ in range(2):
        for kind, table in tables.items():
            table.sample(frac=1, random_state=int(rng.integers(1000))).to_csv(tmp_path / f"{kind}.csv", index=False)
        read.append(load_measurements(campaign, robot.readings, robot.limits, robot.kinds, 1))
    one, two = read
    for name in ("readings", "observed", "position", "test", "labels.refers", "labels.block", "labels.target",
                 "repeats.configuration"):  # fmt: skip
        np.testing.assert_array_equal(attrgetter(name)(one), attrgetter(name)(two), err_msg=name)
    for name, things in one.instruments.things.items():
        assert things.names == two.instruments.things[name].names


def rows_of(kind: str, robot: Robot, rng: np.random.Generator, n: int = 12) -> pd.DataFrame:
    """A sound table of a kind."""
    labels = rng.choice(["a", "b"], n)
    own: dict[str, Any] = {
        "position": dict(zip("xyz", rng.uniform(-1, 1, (3, n)), strict=True)),
        "point": {"point": labels},
        "distance": {"distance": rng.uniform(0.5, 2, n), "anchor": labels},
        "plane": {"plane": labels, "reading": rng.uniform(0, 1e-3, n)},
        "pixels": {"u": rng.uniform(0, 600, n), "v": rng.uniform(0, 400, n), "marker": labels},
        "inclination": dict(zip(("gx", "gy", "gz"), rng.normal(size=(3, n)), strict=True)),
    }[kind]
    return pd.DataFrame(dict(zip(robot.readings, rng.uniform(-1, 1, (len(robot.readings), n)), strict=True)) | own)


@examples(15)
@given(SEEDS)
def test_a_campaign_that_is_written_is_the_campaign_that_is_read(tmp_path: Path, seed: int) -> None:
    """Robot, readings and poses to the bit; rotations to the rounding of a quaternion."""
    rng = np.random.default_rng(seed)
    truth = robots.simulate(
        robots.random_robot(seed % 1000, "RPR"), 8, rng, 1e-2, 1e-4, tip=robots.random_placement(rng)
    )
    campaign = load_campaign(robots.write_campaign(tmp_path, truth))
    robot = truth.model.robot
    read = as_written(load_measurements(campaign, robot.readings, robot.limits, robot.kinds))
    assert campaign.robot.urdf.read_bytes() == truth.model.robot.urdf
    np.testing.assert_array_equal(read.readings, truth.readings)
    np.testing.assert_array_equal(read.position, truth.measured.position)
    np.testing.assert_allclose(read.rotation, truth.measured.rotation, rtol=0, atol=1e-14)


@examples(20)
@given(chains(4), SEEDS, st.sampled_from(["pose", "position"]), st.booleans())
def test_a_saved_calibration_predicts_what_it_predicted_before(
    tmp_path_factory: pytest.TempPathFactory, drawn: list[Drawn], seed: int, kind: str, stations: bool
) -> None:
    robot, rng = robot_of(drawn), np.random.default_rng(seed)
    joint = robot.joints[-1].name
    effects = (
        Coefficient(joint, "axis", Basis("sin", (robot.readings[-1],), (2.0,))),
        Coefficient("tip_target", "x", Basis("linear", ("temperature",), (20.0,))),
    )
    labels = ("A", "ü 1: [b]") if stations else (None,)
    world = tuple((label, robots.random_placement(rng)) for label in labels)
    wrong = constants(robot, "full")
    around = Surroundings(rng.normal(size=3), (Payload(rng.normal(size=3)),), True)
    solved = []
    for coefficients in (wrong, wrong + effects):
        root = rng.normal(size=(len(coefficients), len(coefficients)))
        model = Model(robot, coefficients, world, ((None, robots.random_placement(rng)),), around)
        solved.append(SolvedModel(model, rng.normal(0, 1e-2, len(coefficients)), 1e-8 * (root @ root.T)))
    saved = SavedModel(*solved, kind, (0.0, 0.0, -9.81), (1e-4, 1e-4), {"temperature": (1.0, 2.0)}, {"data": {"n": 3}})
    path = tmp_path_factory.mktemp("saved") / "calibration.yaml"
    path.write_text(saved.dump(), encoding="utf-8")
    again = SavedModel.load(path)
    assert (again.kind, again.noise, again.ranges, again.record) == (
        saved.kind,
        saved.noise,
        saved.ranges,
        saved.record,
    )
    assert again.final.model.robot.urdf == robot.urdf
    q, conditions = random_readings(robot, 3, seed), {"temperature": rng.normal(20, 5, 3)}
    label = np.array(rng.choice(labels, 3)) if stations else None
    for before, after in ((saved.geometric, again.geometric), (saved.final, again.final)):
        for a, b in zip(before.poses(q, conditions, label), after.poses(q, conditions, label), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)  # a quaternion's rounding in the frames
        np.testing.assert_array_equal(before.theta, after.theta)
        np.testing.assert_array_equal(before.covariance, after.covariance)
        np.testing.assert_allclose(
            before.std(q, conditions, label), after.std(q, conditions, label), rtol=1e-9, atol=1e-15
        )


ORIGIN_VALUES = re.compile(rb'(<origin xyz=")[^"]*(" rpy=")[^"]*(")')


@examples(40)
@given(chains(), st.data())
def test_new_origins_leave_every_other_byte_of_the_urdf(drawn: list[Drawn], data: st.DataObject) -> None:
    before = urdf(drawn)
    chosen = data.draw(st.lists(st.sampled_from(range(len(drawn))), unique=True, min_size=1))
    origins = {f"joint_{k}": (np.array(data.draw(VECTOR)), np.array(data.draw(RPY))) for k in chosen}
    after = splice_origins(before, origins)
    assert ORIGIN_VALUES.sub(rb"\1\2\3", after) == ORIGIN_VALUES.sub(rb"\1\2\3", before)
    read = [origin.groups() for origin in re.finditer(rb'<origin xyz="([^"]*)" rpy="([^"]*)"', after)]
    for k, joint in enumerate(drawn):
        expected = origins.get(f"joint_{k}", (joint.xyz, joint.rpy))
        for text, vector in zip(read[k], expected, strict=True):
            assert [float(v) for v in text.split()] == list(vector)


# --- solver


def solve(data: Dataset, robot: Robot) -> Geometry:
    return fit_geometry(robots.campaign((data.rotation is None and "position") or "pose").question, robot, data, ())


def predicted(found: Geometry, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    fit = found.geometric
    return fit.model.poses(fit.theta, fit.model.rows(q))


KINDS = st.sampled_from(["RR", "PRR", "RPR", "RRRR", "CRPR"])


@examples(8)
@given(KINDS, SEEDS, st.sampled_from(["pose", "position"]))
@example("RPR", 37681269, "pose")  # turns that fit exactly while places are off by millimetres
@example("PRR", 10, "pose")
def test_exact_data_leave_nothing_and_predict_what_was_never_measured(kinds: str, seed: int, kind: str) -> None:
    """Everything that moves the target is either identified or named as redundant: then other rows are predicted, too."""
    robot, rng = robots.random_robot(seed % 1000, kinds), np.random.default_rng(seed)
    world, tip = robots.random_placement(rng), robots.random_placement(rng, 0.3)
    truth = robots.simulate(robot, 60, rng, 2e-3, 0.0, world=world, tip=tip, kind=kind)
    found = solve(truth.measured, robot)
    fit = found.geometric
    assert np.abs(fit.residual).max() < 1e-9
    named = set(fit.model.names) | set(fit.redundant)
    assert set(c.name for c in fit.candidates) == named
    q = robots.readings(robot, 20, rng)
    R, p = predicted(found, q)
    R_true, p_true = truth.model.poses(truth.theta, truth.model.rows(q))
    np.testing.assert_allclose(p, p_true, rtol=0, atol=1e-7)
    if kind == "pose":
        np.testing.assert_allclose(R, R_true, rtol=0, atol=1e-7)


@examples(5)
@given(KINDS, SEEDS)
def test_a_fit_does_not_hang_on_the_order_of_rows_on_frames_or_on_the_scale_of_weights(kinds: str, seed: int) -> None:
    robot, rng = robots.random_robot(seed % 1000, kinds), np.random.default_rng(seed)
    truth = robots.simulate(robot, 50, rng, 2e-3, 1e-4)
    rows, q = truth.measured, robots.readings(robot, 10, rng)
    std = rng.uniform(0.5, 2.0, (50, 6))
    world = robots.random_placement(rng)
    R, p = predicted(solve(weighed(rows, RowNoise(std)), robot), q)
    shuffled = rng.permutation(50)
    R_shuffled, p_shuffled = predicted(solve(weighed(rows.select(shuffled), RowNoise(std[shuffled])), robot), q)
    R_scaled, p_scaled = predicted(solve(weighed(rows, RowNoise(7.0 * std)), robot), q)
    for other, at in ((R_shuffled, p_shuffled), (R_scaled, p_scaled)):
        np.testing.assert_allclose(at, p, rtol=0, atol=1e-7)
        np.testing.assert_allclose(other, R, rtol=0, atol=1e-7)
    elsewhere = robots.moved(truth, world, pin.SE3.Identity())
    R_plain, p_plain = predicted(solve(rows, robot), q)
    R_moved, p_moved = predicted(solve(elsewhere.measured, robot), q)
    np.testing.assert_allclose(p_moved, p_plain @ world.rotation.T + world.translation, rtol=0, atol=1e-7)
    np.testing.assert_allclose(R_moved, world.rotation @ R_plain, rtol=0, atol=1e-7)


# --- instruments


@examples(20)
@given(chains(4), SEEDS)
def test_a_position_is_the_first_half_of_a_pose(drawn: list[Drawn], seed: int) -> None:
    robot, rng = robot_of(drawn), np.random.default_rng(seed)
    truth = robots.simulate(robot, 4, rng, 1e-2, 1e-2)
    theta = rng.normal(0, 1e-2, len(truth.theta))
    pose = problem(truth.model, truth.measured).linearised(theta)
    position = problem(truth.model, robots.positions_alone(truth.measured)).linearised(theta)
    for whole, half in zip(pose, position, strict=True):
        np.testing.assert_array_equal(whole[:, :3], half)


@examples(40)
@given(SEEDS, st.sampled_from(["perpendicular", "along_axis"]))
def test_pixels_and_ranges_are_those_of_opencv_and_of_a_ray_that_meets_the_plane(seed: int, measures: str) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.uniform(-0.4, 0.4, 3))
    T = np.eye(4)
    T[:3, :3] = turn.as_matrix() @ np.diag(
        [1.0, -1.0, -1.0]
    )  # the square's z comes out of the paper, towards the camera
    T[:3, 3] = [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.2, 0.5)]
    points = rng.uniform(-0.05, 0.05, (7, 3)) * [1, 1, 0]
    intrinsics = np.array([700, 650, 255, 250, *rng.uniform(-1, 1, 5) * [0.05, 0.02, 1e-3, 1e-3, 1e-2]])
    camera = np.array([[intrinsics[0], 0, intrinsics[2]], [0, intrinsics[1], intrinsics[3]], [0, 0, 1]])
    pixels, by_twist, by_intrinsics = predict_pixels(T, points, intrinsics)
    expected, _ = cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], camera, intrinsics[4:])
    np.testing.assert_allclose(pixels, expected[:, 0], rtol=0, atol=1e-9)
    in_camera = points @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(rays(pixels, intrinsics), in_camera[:, :2] / in_camera[:, 2:], rtol=0, atol=1e-10)

    sensors = rng.uniform(-0.05, 0.05, (4, 3)) * [1, 1, 0]
    h, h_by_twist = predict_ranges(T, sensors, measures)
    doty = np.diag([1.0, -1.0, -1.0])
    normal, on_plane, at = T[:3, 2], T[:3, 3], sensors @ doty
    perpendicular = (on_plane - at) @ normal
    along = perpendicular / normal[2]
    np.testing.assert_allclose(h, np.abs(along if measures == "along_axis" else perpendicular), rtol=0, atol=1e-12)

    step = 1e-6
    for k, twist in enumerate(step * np.eye(6)):
        up, down = (T @ pin.exp6(pin.Motion(s * twist)).homogeneous for s in (1, -1))
        slope = (predict_pixels(up, points, intrinsics)[0] - predict_pixels(down, points, intrinsics)[0]) / (2 * step)
        np.testing.assert_allclose(by_twist[..., k], slope, rtol=0, atol=1e-4)
        slope = (predict_ranges(up, sensors, measures)[0] - predict_ranges(down, sensors, measures)[0]) / (2 * step)
        np.testing.assert_allclose(h_by_twist[:, k], slope, rtol=0, atol=1e-8)
    for k, change in enumerate(step * np.eye(9)):
        up, down = (predict_pixels(T, points, intrinsics + s * change)[0] for s in (1, -1))
        np.testing.assert_allclose(by_intrinsics[..., k], (up - down) / (2 * step), rtol=0, atol=1e-5)
