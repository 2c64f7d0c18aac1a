"""Random imperfect robots, what is wrong with them, and the rows that a tracker would measure of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from random_robots import FAMILIES, draw_robot
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient, Effect
from aridcal.engine.corrections.loads import Payload, Surroundings, covariate_table
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import spread
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset, dataset, with_places, with_sigma
from aridcal.files.campaign import Campaign
from aridcal.jobs.simulate.true_effects import PreparedEffect, TrueEffect, draw_columns, make_causes
from aridcal.system.errors import CampaignError

NAMED = (
    "joint_gain", "joint_harmonic", "joint_map", "joint_backlash", "joint_compliance", "bearing_compliance",
    "axis_wobble", "rail_straightness", "rail_angular", "joint_coupling", "thermal", "drift", "payload_compliance",
)  # fmt: skip
ADDED = ("payload", "bump", "shift")
"""Cases that have numbers of their own, so that those of :data:`NAMED` stay what they were: a ``joint_compliance`` with a
payload on it, a ``joint_map`` that is one narrow bump, and a ``shift``."""

CURVES = {
    "joint_map": (("axis",), 36, (2.0, 4.0, 8.0)),
    "rail_straightness": (("t1", "t2"), 18, (3.0, 6.0, 12.0)),
    "rail_angular": (("roll", "pitch", "yaw"), 18, (3.0, 6.0, 12.0)),
}
"""Kinds that are smooth curves: motions, knots, and correlation lengths in knots."""
SIZES = (1.0, 40.0)  # of an effect: RMS per component in sigma, after projection off constants and frames
ROWS = (100, 400)
QUERIES = 200
TEST_SHARE = 0.2
WIDTHS = (0.05, 0.2)  # of a narrow bump: standard deviation of the Gaussian most like it, [rad]
BELL = 1.0 / np.sqrt(3.0)  # that of the spline of a curve's knot, in distances of knots
STEPS = (0.2, 0.8)  # where in the rows something moves once, of all rows
MOVED = "moved"  # column that is -1 before that and 0 after it
TOO_MUCH = 0.03  # an effect that must move the target by more than this to be seen at all is drawn anew, [m], [rad]
OUTLIERS = (20.0, 100.0)  # how far off a gross error is, [sigma]


@dataclass(frozen=True)
class Case:
    """One simulated campaign and all that is known of it.

    Attributes:
        seed: Makes it again.
        what: ``clean``, ``single``, ``combination`` or ``off`` (no catalogue has it).
        kind: Which of :data:`NAMED` or :data:`ADDED` was asked for.
        family: Of the robot.
        campaign: What the user would have written.
        rows: Measured, train and test.
        train: The training rows; their covariates hold the values of the true functions too.
        truth: The true model: frames, constants, then each cause's coefficients.
        theta: Their values.
        causes: True effects.
        shapes: Covariance from which the coefficients of each smooth cause were drawn; else None.
        sizes: Of each cause, [sigma].
        sigma: Of the noise of each channel, shape (2,) or (1,), [m] and [rad].
        query: Configurations never measured and their true poses, M rows, covariates as in ``train``.
    """

    seed: int
    what: str
    kind: str | None
    family: str
    campaign: Campaign
    rows: Dataset
    train: Dataset
    truth: Model
    theta: np.ndarray
    causes: tuple[PreparedEffect, ...]
    shapes: tuple[np.ndarray | None, ...]
    sizes: tuple[float, ...]
    sigma: np.ndarray
    query: Dataset

    @property
    def names(self) -> str:
        """What is wrong, in words."""
        said = [f"{c.effect.label} {'/'.join(c.effect.motion)} of {','.join(c.effect.covariates)} ({s:.1f} sigma)"
                for c, s in zip(self.causes, self.sizes, strict=True)]  # fmt: skip
        return " + ".join(said) or "nothing"


def draw_case(seed: int, what: str, kind: str | None = None, outliers: float = 0.0) -> Case:
    """Draw a robot, its faults and its measurements.

    Args:
        seed: Fixes everything.
        what: ``clean``, ``single``, ``combination`` or ``off``.
        kind: Of a single effect, or of the first of a combination.
        outliers: Share of the rows that are grossly wrong.
    """
    rng = np.random.default_rng(seed)
    for _ in range(200):
        case = _draw(seed, what, kind, outliers, rng)
        if case is not None:
            return case
    raise RuntimeError(f"case {seed}: no robot can have {kind or what}")


def contribution(model: Model, theta: np.ndarray, rows: Dataset, sigma: np.ndarray) -> np.ndarray:
    """Columns of a model's coefficients in units of the channels' sigma, shape (N * m, K)."""
    _, J = problem(model, rows).linearised(theta)
    return np.asarray((J / spread(sigma, rows.channels)[:, None]).reshape(-1, J.shape[2]))


def basis_of(A: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the span of columns, shape (rows, rank)."""
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s[0]])


def _draw(seed: int, what: str, kind: str | None, outliers: float, rng: np.random.Generator) -> Case | None:
    family = str(rng.choice(FAMILIES))
    robot, gravity = draw_robot(family, rng)
    n = int(rng.integers(ROWS[0], ROWS[1] + 1))
    total = n + QUERIES
    readings = draw_readings(robot, total, rng)
    pose = bool(rng.random() < 0.85)
    sigma = np.exp(rng.uniform(np.log(3e-5), np.log(3e-4), 2))[: 2 if pose else 1]
    per_number = np.repeat(sigma, 3)
    frames = [pin.SE3(Rotation.random(rng=rng).as_matrix(), rng.uniform(-3, 3, 3)),
              pin.SE3(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.3, 0.3, 3))]  # fmt: skip
    columns = _covariates(robot, readings, rng)
    around = Surroundings(gravity, (Payload(frames[1].translation),), "payload" in columns)

    count = {"clean": 0, "single": 1, "off": 1, "combination": int(rng.integers(2, 4))}[what]
    causes: list[PreparedEffect] = []
    drawn: list[np.ndarray | None] = []
    known = dict(columns)
    for k in range(count):
        one = kind if kind is not None and k == 0 else str(rng.choice(NAMED))
        shape = None
        if what == "off":
            made, known = make_causes([_off(robot, columns, rng)], robot, readings, columns, around, rng, "case")
            cause: PreparedEffect | None = made[0]
        elif one in CURVES:
            cause, shape = _curve(one, robot, readings, rng)
        elif one == "bump":
            cause, shape = _bump(robot, readings, rng)
        elif one == "shift":
            cause, known[MOVED] = _shift(robot, total, pose, rng)
        elif one == "payload":
            cause = _named("joint_compliance", robot, readings, columns, around, rng) if one in columns else None
        else:
            cause = _named(one, robot, readings, columns, around, rng)
        if cause is None or any(
            (c.effect.kind, c.effect.where) == (cause.effect.kind, cause.effect.where) for c in causes
        ):
            return None
        causes.append(cause)
        drawn.append(shape)

    place = [Coefficient(where, c) for where in ("world_base", "tip_target") for c in FRAME_COMPONENTS]
    geometry = (*place, *constants(robot, "full"))
    truth = Model(robot, (*geometry, *(c for cause in causes for c in cause.effect.coefficients)),
                  ((None, frames[0]),), ((None, frames[1]),), around)  # fmt: skip
    off = np.exp(rng.uniform(np.log(2e-4), np.log(3e-3)))
    values = np.concatenate([np.zeros(len(place)), off * rng.standard_normal(len(geometry) - len(place))])

    query = np.zeros(total, dtype=bool)
    query[rng.choice(total, QUERIES, replace=False)] = True
    if MOVED in known:  # what is asked for is how the machine is now
        known |= {MOVED: np.where(query, 0.0, known[MOVED])} | (
            {"time": _last(known["time"], query)} if "time" in known else {}
        )
    test = rng.random(n) < TEST_SHARE
    bare = truth.with_coefficients(geometry)
    R, p = bare.poses(values, bare.rows(readings[~query]))
    perfect = dataset(robot.readings, robot.kinds, readings[~query], p, R if pose else None,
                      covariates={k: v[~query] for k, v in known.items()}, test=test)  # fmt: skip

    zero = np.concatenate([values, np.zeros(len(truth.coefficients) - len(values))])
    J = contribution(truth, zero, perfect.select(~test), sigma)
    U = basis_of(J[:, : len(geometry)])
    at, sizes, scaled, shapes = len(geometry), [], [], []
    for cause, shape in zip(causes, drawn, strict=True):
        d = len(cause.values)
        moved = J[:, at : at + d] @ cause.values
        at += d
        seen = np.sqrt(np.mean((moved - U @ (U.T @ moved)) ** 2))
        size = float(np.exp(rng.uniform(*np.log(SIZES))))
        if seen <= 0.0:
            return None
        factor = size / seen
        if factor * np.abs(moved.reshape(-1, len(per_number)) * per_number).max() > TOO_MUCH:
            return None
        scaled.append(PreparedEffect(cause.effect, factor * cause.values, cause.ranges))
        shapes.append(None if shape is None else factor**2 * shape)
        sizes.append(size)
    theta = np.concatenate([values, *(c.values for c in scaled)])

    R, p = truth.poses(theta, truth.rows(readings, known))
    unseen = dataset(robot.readings, robot.kinds, readings[query], p[query], R[query] if pose else None,
                     covariates={k: v[query] for k, v in known.items()})  # fmt: skip
    unseen = unseen.with_origin(order=np.full(QUERIES, np.inf))
    error = rng.standard_normal((n, 6))
    wrong = rng.permutation(n)[: round(outliers * n)]
    direction = rng.standard_normal((len(wrong), 2, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    error[wrong] += (rng.uniform(*OUTLIERS, len(wrong))[:, None, None] * direction).reshape(-1, 6)
    error = error[:, : len(per_number)] * per_number
    p = p[~query] + error[:, :3]
    rotation = Rotation.from_rotvec(error[:, 3:]).as_matrix() @ R[~query] if pose else None
    noise = tuple(sigma.tolist()) if rng.random() < 0.7 else ()
    measured = with_sigma(with_places(perfect, p, rotation), noise or perfect.sigma)
    rows = replace(measured, covariates={name: measured.covariates[name] for name in columns})
    return Case(seed, what, kind, family, _campaign(robot, gravity, pose, noise), rows, measured.select(~test), truth, theta,
                tuple(scaled), tuple(shapes), tuple(sizes), sigma, unseen)  # fmt: skip


def _covariates(robot: Robot, readings: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Some of the columns that a table may have, and one to three that mean nothing."""
    names = [name for name in ("time", "temperature", "payload") if rng.random() < 0.8]
    names += [f"{j}_direction" for j in robot.names] if rng.random() < 0.4 else []
    names += ["voltage", "humidity", "pressure"][: int(rng.integers(1, 4))]
    return draw_columns(names, robot, readings, int(rng.integers(2**31)))


def _named(
    kind: str, robot: Robot, readings: np.ndarray, columns: dict[str, np.ndarray], around: Surroundings,
    rng: np.random.Generator,
) -> PreparedEffect | None:  # fmt: skip
    """An effect of the catalogue with coefficients of natural proportions; None if this robot cannot have it."""
    joints = {k: [j.name for j in robot.joints if k in ("", j.kind)] for k in ("", "revolute", "prismatic")}
    wanted = "revolute" if kind in ("joint_harmonic", "axis_wobble") else ""
    if not joints[wanted]:
        return None
    where = str(rng.choice(joints[wanted]))
    joint = robot.joint(where)
    keys: dict[str, object] = {"kind": kind, "where": where}
    if kind == "joint_harmonic":
        keys["order"] = (float(rng.integers(1, 5)),)
    elif kind == "axis_wobble":
        keys |= {"order": (float(rng.integers(1, 3)),), "motion": _some(("r1", "r2", "t1", "t2"), rng)}
    elif kind == "joint_coupling":
        keys["with"] = str(rng.choice([j for j in robot.names if j != where]))
    elif kind == "joint_backlash":
        keys["by"] = "direction" if f"{where}_direction" in columns else "load"
    elif kind == "bearing_compliance":
        keys["motion"] = _some(("r1", "r2") if joint.kind == "revolute" else ("roll", "pitch", "yaw"), rng)
    elif kind == "thermal":
        if "temperature" not in columns:
            return None
        keys["where"] = str(rng.choice([*robot.names, "world_base", "tip_target"]))
        keys["motion"] = (str(rng.choice(FRAME_COMPONENTS)),)
    elif kind == "drift":
        if "time" not in columns:
            return None
        keys |= {"where": str(rng.choice(["world_base", "tip_target"])), "motion": _some(FRAME_COMPONENTS, rng)}
    elif kind == "payload_compliance":
        if "payload" not in columns:
            return None
        if rng.random() < 0.5:
            keys |= {"motion": ("axis",), "covariates": (f"{where}.payload_torque",)}
        else:
            keys |= {"motion": (str(rng.choice(("axis", "t1", "t2", "r1", "r2"))),), "covariates": ("payload",)}
    table = covariate_table(robot, readings, columns, around, np.zeros(len(readings), dtype=int), {".gravity_"})
    if kind in ("joint_compliance", "joint_backlash") and keys.get("by") != "direction":
        load = table[f"{where}.gravity_torque"]
        if np.ptp(load) < 1e-2 * max(1.0, np.abs(load).max()):
            return None
        if kind == "joint_backlash" and min(np.mean(load > 0), np.mean(load < 0)) < 0.1:
            return None
    probe = TrueEffect.model_validate(keys | {"coefficients": ({"std": 1.0},)})
    try:
        (cause,), _ = make_causes([probe], robot, readings, columns, around, rng, "case")
    except CampaignError:
        return None
    values = rng.standard_normal(len(cause.values))
    if kind == "bearing_compliance":  # a compliance is positive, and grows with travel
        values = np.abs(values)
    return PreparedEffect(cause.effect, values if len(values) > 1 else np.ones(1), {})


def _curve(
    kind: str, robot: Robot, readings: np.ndarray, rng: np.random.Generator
) -> tuple[PreparedEffect | None, np.ndarray | None]:
    """A smooth curve over a joint's travel, and the covariance of its knots."""
    components, count, lengths = CURVES[kind]
    joints = [k for k, j in enumerate(robot.joints) if kind == "joint_map" or j.kind == "prismatic"]
    length = float(rng.choice(lengths))
    if not joints:
        return None, None
    k = int(rng.choice(joints))
    name, travel = robot.names[k], robot.positions(readings)[:, k]
    low, step = float(travel.min()), float(np.ptp(travel)) / (count - 3)
    motion = str(rng.choice(components))
    # One knot beyond each end: a curve is not to know where the rows end.
    knots = tuple(Coefficient(name, motion, Basis("bump", (name,), (low + (i - 1) * step, step))) for i in range(count))
    shape = stiffness(count, length)
    values = np.linalg.cholesky(shape) @ rng.standard_normal(count)
    return PreparedEffect(Effect(kind, name, knots, smooth=True), values, {}), shape


def _bump(
    robot: Robot, readings: np.ndarray, rng: np.random.Generator
) -> tuple[PreparedEffect | None, np.ndarray | None]:
    """An error curve that is nil but for one knot, and the covariance of its knots to one who knows not which."""
    turning = [k for k, j in enumerate(robot.joints) if j.kind == "revolute"]
    if not turning:
        return None, None
    k = int(rng.choice(turning))
    name, travel = robot.names[k], robot.positions(readings)[:, k]
    width = float(np.exp(rng.uniform(*np.log(WIDTHS))))
    low, step = float(travel.min()) - float(rng.random()) * width / BELL, width / BELL
    count = int(np.ceil((float(travel.max()) - low) / step)) + 1
    knots = tuple(Coefficient(name, "axis", Basis("bump", (name,), (low + i * step, step))) for i in range(count))
    values = np.zeros(count)
    values[int(rng.integers(1, count - 1))] = float(rng.choice((-1.0, 1.0)))
    return PreparedEffect(Effect("joint_map", name, knots, smooth=True), values, {}), np.eye(count) / count


def _shift(robot: Robot, total: int, pose: bool, rng: np.random.Generator) -> tuple[PreparedEffect, np.ndarray]:
    """A base, a target or a joint's zero that moved between two rows, and the column that says when."""
    where = str(rng.choice([*robot.names, "world_base", "world_base", "tip_target", "tip_target"]))
    motion = {"world_base": FRAME_COMPONENTS, "tip_target": FRAME_COMPONENTS[: 6 if pose else 3]}.get(where, ("axis",))
    once = Basis("linear", (MOVED,), (0.0,))
    values = rng.standard_normal(len(motion))
    after = np.arange(total) >= int(rng.uniform(*STEPS) * total)
    effect = Effect("shift", where, tuple(Coefficient(where, component, once) for component in motion))
    return PreparedEffect(effect, values, {}), np.where(after, 0.0, -1.0)


def _last(time: np.ndarray, query: np.ndarray) -> np.ndarray:
    """Time of the last row in place of what the rows of a query have."""
    return np.where(query, time.max(), time)


def stiffness(count: int, length: float) -> np.ndarray:
    """Covariance of the knots of a curve without kinks, shape (count, count): what any other set of knots can follow."""
    apart = np.subtract.outer(np.arange(count), np.arange(count)) / length
    return np.asarray(np.exp(-0.5 * apart**2) + 1e-6 * np.eye(count))


def _off(robot: Robot, columns: dict[str, np.ndarray], rng: np.random.Generator) -> TrueEffect:
    """An effect that is in no catalogue: a named function of anything at any place."""
    where = str(rng.choice([*robot.names, "tip_target"]))
    motion = (str(rng.choice(FRAME_COMPONENTS)),)
    form = str(rng.choice(("bow", "kink", "step", "dent", "ripple", "product", "ridge", "twist")))
    count = 2 if form in ("product", "ridge", "twist") else 1
    anything = [j for j in robot.names if j != where]
    anything += [c for c in columns if not c.endswith("_direction") and c != "payload"]
    covariates = tuple(str(c) for c in rng.choice(anything, count, replace=False))
    keys = {"kind": "unknown", "where": where, "motion": motion, "form": form, "covariates": covariates}
    return TrueEffect.model_validate(keys | {"coefficients": (1.0,)})


def _some(components: Sequence[str], rng: np.random.Generator) -> tuple[str, ...]:
    """One of some components, or all of them."""
    return tuple(components) if rng.random() < 0.3 else (str(rng.choice(list(components))),)


def _campaign(robot: Robot, gravity: np.ndarray, pose: bool, noise: tuple[float, ...]) -> Campaign:
    declared = dict(zip(("position", "rotation"), noise, strict=False))
    return Campaign.model_validate({
        "format": 1,
        "robot": {"urdf": Path("robot.urdf"), "tip": robot.tip, "gravity": gravity.tolist()},
        "measurements": {"file": (Path("rows.csv"),), "kind": "pose" if pose else "position", "noise": declared},
    })  # fmt: skip
