"""What rows can tell, and no more: does a calibration say what is so where rows are few, dependent, or tell two causes alike?

    PYTHONPATH=.:tests/support python benchmarks/honesty.py                # all questions, 25 draws each
    PYTHONPATH=.:tests/support python benchmarks/honesty.py places --draws 5

Each question has its control: the same without the trap.

- `few`: 12, 20, 30 and 50 rows of three robots whose constants are off by 1 mm and 1 mrad. Error over the nominal robot's, and
  how often the truth is within two of its `std_*`.
- `places`: 45 places measured five times, 4 mrad apart, where the instrument errs alike at a place (control: at each row anew);
  a clean arm and one with an effect. Effects without a cause, error against the truth beside that of the constants alone, z of
  `std_*`.
- `seating`: 13 % of 200 rows 0.7 mm high (control: noise with tails that is as wide, of one group). How often two groups are
  named, and by how many mm.
- `heat`: an arm measured at 20 ± 0.3 degrees, asked at 32 with all lengths 12 ppm/K longer (control: asked at 20). Share of rows
  marked, and z of `std_*`, marked rows included.
- `night`: the base is knocked by 1 mm at 00:30 in a campaign from 23:00 to 01:00, times of day without dates (control: no knock).
  Whether something is found, and the share of rows on the right side of the step.
- `gravity`: compliant joints, error curves and an unknown tool on a wedge, a wall or the ceiling, where the campaign has
  gravity along -z (control: on the floor). How often the setting is named, and by how much the vector to set is off.
- `slips`: a UR10, a 7R arm or ARID's form, 60 poses, where a joint's column counts backwards or from another quarter of a turn,
  or where poses are those of the world in the target (control: none of it). How often exactly the right key is named, and how
  often with that key the error on held-out rows is that of the control.
- `check`: 20 new poses in one corner of the workspace, of an arm that has not changed, whose calibration from 200 poses left
  structure below detection: small error curves of all joints, or errors of their zeros that go with all readings; or noise of
  Student's t with two degrees of freedom (control: neither). Verdicts without structure, false alarms; how often one joint that
  is off by 0.3 or 1 mm at the target, or 0.3 or 1 mrad where its lever is below a metre, raises an alarm, and is named.
- `accused`: a body of markers off the target whose rotation noise moves it on a lever of 0.1 to 0.3 m, or a camera whose noise
  in depth grows by the square of the distance (controls: joints that are misread, and even noise). How often the cause of the
  noise is named, something else is, and something else without the cause beside it as a tie (`false`).
- `rivals`: 120 poses in the order of joint 1, whose zero moves once in time, or jumps at a reading; or in warming air, where the
  base or joint 2 goes with the temperature, or with time (controls: the same rows shuffled, so that the causes come apart). How
  often the cause is named (`told`), without a tie with another covariate (`plainly`), another one is named without it (`false`);
  and z of `std_*` where the two causes predict otherwise, marked rows left out.
- `column`: a 6R arm on a bent column, two of whose joints yield and all of whose gears err, 310 positions in 30 places
  (controls: as many rows all over the workspace; a rigid column and an arm without a fault but for its constants). Error on
  poses never measured, all over the joints' ranges, over that of an oracle: the fit of the same rows with exactly the true
  effects, in their true form.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from random_robots import draw_robot
from rich.console import Console
from rich.table import Table
from robots import Truth, random_placement, random_robot, readings, simulate, table, ur10, write_campaign
from robots import measured as as_measured
from scipy.spatial.transform import Rotation
from tilted import geometric, measured

import aridcal
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Surroundings, covariate_table
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import problem
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset, with_places
from aridcal.jobs.calibrate.gravity_direction import gravity_direction
from aridcal.jobs.simulate.true_effects import TrueEffect, make_causes
from aridcal.system.errors import AridcalError

PLACES, EACH, APART = 45, 5, 4e-3
"""Places, readings of each, and half of how far their joints are apart, [rad]."""

NOISE, ALIKE = 2e-5, 1.5e-4
"""Of each reading, and of a place, [m] per axis."""

BEND = 2e-4
"""[rad]: amplitude of an error curve of joint 2."""

QUERIES = 400


def places(seed: int, alike: bool, bent: bool) -> dict[str, float]:
    """Rows in places, the instrument's error common to each or not."""
    robot, rng = ur10(), np.random.default_rng(seed)
    truth = simulate(robot, PLACES, rng, kind="position")
    q = np.repeat(truth.readings, EACH, axis=0) + rng.uniform(-APART, APART, (PLACES * EACH, 6))
    model, theta = truth.model, truth.theta
    if bent:
        curve = (Coefficient(robot.names[1], "axis", Basis("sin", (robot.readings[1],), (2.0,))),)
        model = model.with_coefficients((*model.coefficients, *curve))
        theta = np.append(theta, BEND)
    _, p = model.poses(theta, model.rows(q))
    own = rng.normal(size=(PLACES, 3)).repeat(EACH, axis=0) if alike else rng.normal(size=p.shape)
    p = p + ALIKE * own + NOISE * rng.normal(size=p.shape)
    rows = pd.DataFrame({**dict(zip(robot.readings, q.T, strict=True)), **dict(zip("xyz", p.T, strict=True))})
    queries = readings(robot, QUERIES, rng, 0.8)
    _, wanted = model.poses(theta, model.rows(queries))
    asked = pd.DataFrame(dict(zip(robot.readings, queries.T, strict=True)))
    answers = {}
    for name, enabled in (("final", True), ("constants", False)):
        with tempfile.TemporaryDirectory() as folder:
            path = write_campaign(Path(folder), truth, rows, diagnosis={"enabled": enabled})
            cal = aridcal.calibrate(path)
            predicted = cal.predict(asked)
        off = predicted[["x", "y", "z"]].to_numpy() - wanted
        inside = ~predicted["extrapolates"].to_numpy(bool)
        sigma = predicted[["std_x", "std_y", "std_z"]].to_numpy()
        answers[name] = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        answers[f"z {name}"] = float(np.sqrt(np.mean((off[inside] / sigma[inside]) ** 2)))
        if enabled:
            answers["effects"] = float(len(cal.result["effects"]))
            answers["floor"] = float(cal.result["verdict"] == "noise_floor")
    return answers


SIZE, FINE = 1e-3, 1e-4
"""[m] and [rad]: by how much constants are off, and the instrument's noise."""


def few(seed: int, name: str, rows: int) -> dict[str, float]:
    """Few rows of a robot, positions or poses."""
    rng = np.random.default_rng(1000 * seed + rows)
    robot = ur10() if name == "UR10" else random_robot(seed, "RRRRRRR" if name == "7R" else "PRRR")
    kind = "pose" if seed % 2 else "position"
    truth = simulate(robot, rows, rng, SIZE, FINE, kind=kind)
    with tempfile.TemporaryDirectory() as folder:
        noise = {"position": FINE, "rotation": FINE} if kind == "pose" else {"position": FINE}
        block = {"file": "measurements.csv", "kind": kind, **({"noise": noise} if seed % 4 < 2 else {})}
        cal = aridcal.calibrate(write_campaign(Path(folder), truth, measurements=block, diagnosis={"enabled": True}))
        assert cal.outcome is not None
        nominal = cal.outcome.stage("nominal").fit
    queries = readings(robot, QUERIES, rng, 0.9)
    _, wanted = truth.model.poses(truth.theta, truth.model.rows(queries))
    predicted = cal.predict(pd.DataFrame(dict(zip(robot.readings, queries.T, strict=True))))
    off = predicted[["x", "y", "z"]].to_numpy() - wanted
    sigma = predicted[["std_x", "std_y", "std_z"]].to_numpy()
    inside = ~predicted["extrapolates"].to_numpy(bool)
    _, bare = nominal.model.poses(nominal.theta, nominal.model.rows(queries))
    error, before = (float(np.sqrt(np.mean(np.sum(o**2, axis=1)))) for o in (off, bare - wanted))
    return {
        "ratio": error / before,
        "covered": float(np.mean(np.abs(off[inside]) < 2.0 * sigma[inside])) if inside.any() else np.nan,
        "error mm": 1e3 * error,
    }


ROWS, WIDE = 200, 1.5e-4
"""Rows of the following questions, and their noise per axis, [m]."""

HIGH, SHARE = 7e-4, 0.13
"""[m]: how much higher a target is seated in a share of the rows."""


def seating(seed: int, seated: bool) -> dict[str, float]:
    """Some rows too high; or one noise with tails, as wide."""
    rng = np.random.default_rng(seed)
    truth = simulate(ur10(), ROWS, rng, kind="position")
    rows = table(truth)
    if seated:
        rows[list("xyz")] += WIDE * rng.standard_normal((ROWS, 3))
        rows["z"] += HIGH * (rng.random(ROWS) < SHARE)
    else:
        rows[list("xyz")] += np.sqrt(WIDE**2 + HIGH**2 * SHARE) / 2.0 * rng.standard_t(4, (ROWS, 3))
    with tempfile.TemporaryDirectory() as folder:
        cal = aridcal.calibrate(write_campaign(Path(folder), truth, rows, diagnosis={"enabled": True}))
    groups = [
        float(told[1]) for reason in cal.result["reasons"] if (told := re.search(r"rows are ([\d.]+) mm", reason))
    ]
    return {
        "named": float(bool(groups)),
        "mm": groups[0] if groups else np.nan,
        "effects": float(len(cal.result["effects"])),
    }


WARM, GROWTH = 12.0, 12e-6
"""[K], and [1/K] of steel."""


def heat(seed: int, warm: bool) -> dict[str, float]:
    """Asked at another temperature than measured at; or at the same."""
    rng = np.random.default_rng(seed)
    truth = simulate(ur10(), ROWS, rng, noise=5e-5, kind="position")
    rows = table(truth).assign(temperature=20.0 + rng.uniform(-0.3, 0.3, ROWS))
    with tempfile.TemporaryDirectory() as folder:
        cal = aridcal.calibrate(write_campaign(Path(folder), truth, rows, diagnosis={"enabled": True}))
    q = readings(truth.model.robot, QUERIES, rng, 0.8)
    asked = pd.DataFrame(dict(zip(truth.model.robot.readings, q.T, strict=True)))
    away = WARM if warm else 0.0
    predicted = cal.predict(asked.assign(temperature=20.0 + away))
    _, real = truth.model.poses(truth.theta, truth.model.rows(q))
    off = predicted[["x", "y", "z"]].to_numpy() - (1.0 + GROWTH * away) * real  # the base is the world's origin
    sigma = predicted[["std_x", "std_y", "std_z"]].to_numpy()
    return {"marked": float(predicted["extrapolates"].mean()), "z": float(np.sqrt(np.mean((off / sigma) ** 2)))}


KNOCK, BEGIN, KNOCKED = 1e-3, 23 * 3600.0, 24.5 * 3600.0
"""[m], and [s] of the first day: when the campaign begins, and when the base is knocked."""


def night(seed: int, knocked: bool) -> dict[str, float]:
    """Times of day that pass midnight, and a knock after it; or none."""
    rng = np.random.default_rng(seed)
    truth = simulate(ur10(), ROWS, rng, noise=1e-4)
    time = BEGIN + 7200.0 * np.sort(rng.random(ROWS))
    rows = table(truth)
    rows["x"] += KNOCK * (time > KNOCKED) * knocked
    rows["when"] = [f"{int(t) // 3600 % 24:02d}:{int(t) // 60 % 60:02d}:{int(t) % 60:02d}" for t in time]
    block = {"file": "measurements.csv", "kind": "pose", "columns": {"time": "when"}}
    block["table"] = {"dates": {"order": "ymd", "columns": ["when"]}}
    with tempfile.TemporaryDirectory() as folder:
        cal = aridcal.calibrate(
            write_campaign(Path(folder), truth, rows, measurements=block, diagnosis={"enabled": True})
        )
    assert cal.outcome is not None
    m = cal.outcome.measurements
    steps = [c.basis for e in cal.outcome.effects for c in e.effect.coefficients if c.basis.form == "step"]
    if not steps:
        return {"found": 0.0, "right side": np.nan}
    after = (m.conditions[steps[0].of[0]] >= steps[0].numbers[0])[m.as_read]
    return {"found": 1.0, "right side": float(np.mean(after == (time > KNOCKED)))}


def gravity(seed: int, way: str, gears: float, compliance: float) -> dict[str, float]:
    """A UR10 with a tool that the URDF does not have, on the floor, a wall, a wedge or the ceiling; stated: the floor."""
    pull = np.array(
        {"floor": (0, 0, -1), "wall": (1, 0, 0), "wedge": (0, 0.866, -0.5), "ceiling": (0, 0, 1)}[way], dtype=float
    )
    rows = measured(seed, pull, compliance, gears, tool=2.0)
    said = gravity_direction(geometric(rows), rows.fitted)
    if not said:
        return {"named": 0.0, "degrees off": np.nan}
    vector = np.array([float(x) for x in re.findall(r"-?\d+\.\d+", said.split("gravity: [")[1])])
    return {"named": 1.0, "degrees off": float(np.degrees(np.arccos(min(vector @ pull / np.linalg.norm(vector), 1.0))))}


def slips(seed: int, slip: str) -> dict[str, float]:
    """Columns that count otherwise than the URDF, and what the answer to them says."""
    rng = np.random.default_rng(seed)
    robot = (ur10(), random_robot(seed, "RRRRRRR"), random_robot(seed, "PRRR"))[seed % 3]
    truth = simulate(robot, 60, rng, SIZE, 1e-4)
    rows, keys = table(truth), dict[str, object]()
    joint = str(
        rng.choice([name for name, kind in zip(robot.readings, robot.kinds, strict=True) if kind != "prismatic"])
    )
    if slip == "sign":
        rows[joint] *= -1.0
        keys = {"joints": {joint: {"sign": -1}}}
    elif slip == "zero":
        quarter = int(rng.choice([-1, 1]))
        rows[joint] += 0.5 * np.pi * quarter
        keys = {"joints": {joint: {"zero": f"{90 * quarter}deg"}}}
    elif slip == "poses":
        back = Rotation.from_quat(rows[["qx", "qy", "qz", "qw"]].to_numpy()).inv()
        rows[["x", "y", "z"]] = -back.apply(rows[["x", "y", "z"]].to_numpy(copy=True))
        rows[["qx", "qy", "qz", "qw"]] = back.as_quat()
        keys = {"inverted": "pose"}
    remedy, right = _named(truth, rows), _error(truth, table(truth), {})
    return {"named": float(remedy == keys), "told something": float(bool(remedy)),
            "as without it": float(abs(_error(truth, rows, keys) / right - 1.0) < 1e-3)}  # fmt: skip


def _named(truth: Truth, rows: pd.DataFrame) -> object:
    """The keys that a campaign without any is told to set."""
    try:
        _error(truth, rows, {})
    except AridcalError as error:
        return yaml.safe_load(" ".join(str(error).split()).partition("Write under measurements `")[2].partition("`")[0])
    return {}


def _error(truth: Truth, rows: pd.DataFrame, keys: dict[str, object]) -> float:
    """Position error of the geometric model on held-out rows, [m]."""
    with tempfile.TemporaryDirectory() as folder:
        block = {"file": "measurements.csv", "kind": "pose", **keys}
        cal = aridcal.calibrate(write_campaign(Path(folder), truth, rows, measurements=block))
    assert cal.outcome is not None
    m = cal.outcome.measurements
    off = cal.outcome.stage("geometric").residual[m.test][:, :3]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


CORNER, NEW = 0.15, 20
"""Of the half range of each joint that a corner takes up, and rows there."""

CURVES, UNEVEN = 3e-5, 4e-5
"""[rad] of each of four waves of each joint's error, and of errors that go with all readings."""


def _unevenness(rng: np.random.Generator, kind: str) -> Callable[[np.ndarray], np.ndarray]:
    """Errors of the joints (n, 6) by their readings, that no declared effect has."""
    if kind == "curves":
        size, phase = CURVES * rng.normal(size=(4, 6)), rng.uniform(0.0, 2.0 * np.pi, (4, 6))
        return lambda q: sum(size[k] * np.sin((k + 1) * q + phase[k]) for k in range(4))
    if kind == "all readings":  # of a Gaussian process with a length of 1 rad
        waves, phase = rng.normal(size=(6, 40, 6)), rng.uniform(0.0, 2.0 * np.pi, (6, 40))
        return lambda q: UNEVEN * np.sqrt(2.0 / 40) * np.cos(np.einsum("jwk,nk->njw", waves, q) + phase).sum(axis=2)
    return np.zeros_like


def check(seed: int, kind: str, tails: bool) -> dict[str, float]:
    """New rows in a corner, of an arm that is as it was, and of one that moved."""
    rng = np.random.default_rng(seed)
    truth = simulate(ur10(), 1, rng)
    model, robot, uneven = truth.model, truth.model.robot, _unevenness(rng, kind)

    def scattered(count: int) -> np.ndarray:
        return FINE * (rng.standard_t(2, (count, 3)) if tails else rng.standard_normal((count, 3)))

    def rows(q: np.ndarray, offset: np.ndarray | float = 0.0) -> pd.DataFrame:
        R, p = model.poses(truth.theta, model.rows(q + uneven(q) + offset))
        R = Rotation.from_rotvec(scattered(len(q))).as_matrix() @ R
        return table(Truth(model, truth.theta, as_measured(robot, q, p + scattered(len(q)), R)))

    q = readings(robot, ROWS, rng, 0.6)
    low, high = q.min(axis=0), q.max(axis=0)
    with tempfile.TemporaryDirectory() as folder:
        cal = aridcal.calibrate(write_campaign(Path(folder), truth, rows(q), diagnosis={"enabled": True}))
    side, inside = rng.choice([0.0, 1.0], 6), 0.5 * CORNER * rng.random((NEW, 6))
    q = low + (high - low) * np.abs(side - inside)
    found = {"noise floor": cal.result["verdict"] == "noise_floor", "false alarm": not cal.check(rows(q)).good}
    joint = int(rng.integers(6))
    one = np.eye(6)[joint]
    there, away = (model.poses(truth.theta, model.rows(q + 1e-6 * step))[1] for step in (0.0, one))
    lever = 1e6 * float(np.sqrt(np.mean(np.sum((away - there) ** 2, axis=1))))
    for size in (3e-4, 1e-3):
        # Of levers below a metre the size is that of the angle.
        moved = cal.check(rows(q, size / max(lever, 1.0) * one))
        found[f"{1e3 * size:g} mm found"] = not moved.good
        found[f"{1e3 * size:g} mm named"] = moved.moved["moved"].tolist()[:1] == [robot.names[joint]]
    return found


TURN, DEPTH, MISREAD = 5e-4, 6e-5, 4e-4
"""Noise of a body's rotation, [rad], of a camera's depth, [m] at 1 m, and of readings, [rad]."""

AIDS = {"channels", "position_mm", "rotation_mrad", "source"}
"""Keys of a result's noise that name no cause beyond the instrument's channels."""

CAMERA = np.array([0.2, -0.1, 2.2])
"""[m]: where a robot's base is seen from a camera."""


def accused(seed: int, what: str, kind: str) -> dict[str, float]:
    """Noise of one cause beside a little even noise: which is named?"""
    rng, n = np.random.default_rng(seed), ROWS
    world = random_placement(rng)
    if what == "depth":
        world = pin.SE3(world.rotation, CAMERA)
    truth = simulate(ur10(), n, rng, 5e-4, world=world, tip=random_placement(rng, 0.1))
    rows = truth.measured
    assert rows.rotation is not None
    q, p, turn = (
        rows.readings.copy(),
        rows.position + NOISE * rng.standard_normal((n, 3)),
        1e-4 * rng.standard_normal((n, 3)),
    )
    if what == "lever":
        turn = TURN * rng.standard_normal((n, 3))
        p += np.cross(turn, rows.rotation @ (rng.uniform(0.1, 0.3) * random_placement(rng).rotation[0]))
    if what == "depth" or what == "depth, elsewhere":
        point = np.zeros(3) if what == "depth" else world.translation + 2.2 * random_placement(rng).rotation[0]
        away = np.linalg.norm(rows.position - point, axis=1, keepdims=True)
        p += DEPTH * away * (rows.position - point) * rng.standard_normal((n, 1))
    if what == "joint":
        q[:, seed % 6] += MISREAD * rng.standard_normal(n)
    if what == "joints":
        q += MISREAD * rng.standard_normal(q.shape)
    R = Rotation.from_rotvec(turn).as_matrix() @ rows.rotation if kind == "pose" else None
    truth = replace(truth, measured=replace(with_places(rows, p, R), readings=q))
    with tempfile.TemporaryDirectory() as folder:
        cal = aridcal.calibrate(write_campaign(Path(folder), truth, diagnosis={"enabled": True}))
    own = {
        "lever": "on_a_lever" if kind == "pose" else "in_target_axes",
        "joint": "joint_readings",
        "joints": "joint_readings",
    }
    right = "along_lines_of_sight" if "depth" in what else own.get(what, "")
    noise = {key: causes for key, causes in cal.result["noise"].items() if key not in AIDS}
    others = [cause for key, causes in noise.items() if key != right for cause in causes.values()]
    untied = [cause for cause in others if right not in {rival["cause"] for rival in cause.get("or", [])}]
    return {"named": float(right in noise), "another": float(bool(others)), "false": float(bool(untied))}


ORDERED, JUMP, WARMING = 120, 6e-4, 6.0
"""Rows, [m] or [rad] by which something moves over the campaign, and [K] by which the air warms in it."""

OVER = {"shift": "time", "drift": "time", "thermal": "temperature"}
"""What kinds of effects depend on; all others on joints."""


def rivals(seed: int, cause: str, other: str, shuffled: bool) -> dict[str, float]:
    """Rows in which two causes do the same, or shuffled; asked at conditions where they do not."""
    rng = np.random.default_rng(seed)
    truth = simulate(ur10(), ORDERED, rng, noise=1e-4)
    model, robot = truth.model, truth.model.robot
    q = truth.readings[rng.permutation(ORDERED)]
    if "joint" in (cause, other):
        q = q[np.argsort(q[:, 0])]
    time = 60.0 * np.arange(ORDERED)
    temperature = 20.0 + WARMING * time / time[-1] + 0.02 * rng.standard_normal(ORDERED)
    middle = float(q[:, 0].mean() if shuffled else q[ORDERED // 2 - 1 : ORDERED // 2 + 1, 0].mean())
    if shuffled:
        q = q[rng.permutation(ORDERED)]
        temperature = temperature[rng.permutation(ORDERED)]
    ways = {
        "time": lambda q, t, _: (t > time.mean()) - 0.5 if "joint" in (cause, other) else t / time[-1] - 0.5,
        "joint": lambda q, *_: (q[:, 0] > middle) - 0.5,
        "temperature": lambda q, _, warm: (warm - 20.0) / WARMING - 0.5,
    }
    base = "joint" not in (cause, other) and seed % 2 == 0
    zero, way = np.eye(6)[0 if "joint" in (cause, other) else 1], random_placement(rng).rotation[0]

    def poses(q: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = JUMP * size[:, None]
        R, p = model.poses(truth.theta, model.rows(q if base else q + 2.0 * moved * zero))
        return R, p + moved * way if base else p

    R, p = poses(q, ways[cause](q, time, temperature))
    turn = Rotation.from_rotvec(FINE * rng.standard_normal((ORDERED, 3))).as_matrix()
    rows = table(Truth(model, truth.theta, as_measured(robot, q, p + FINE * rng.standard_normal(p.shape), turn @ R)))
    rows = rows.assign(time=time)
    asked = readings(robot, QUERIES, rng, 0.8)
    when = rng.uniform(time[0], time[-1], QUERIES)
    warm = rng.uniform(temperature.min(), temperature.max(), QUERIES)
    query = pd.DataFrame(dict(zip(robot.readings, asked.T, strict=True))).assign(time=when)
    if "temperature" in (cause, other):
        rows, query = rows.assign(temperature=temperature), query.assign(temperature=warm)
    with tempfile.TemporaryDirectory() as folder:
        cal = aridcal.calibrate(write_campaign(Path(folder), truth, rows, diagnosis={"enabled": True}))
    predicted = cal.predict(query)
    right, wrong = (ways[name](asked, when, warm) for name in (cause, other))
    off = predicted[["x", "y", "z"]].to_numpy() - poses(asked, right)[1]
    apart = (np.abs(right - wrong) > 0.2) & ~predicted["extrapolates"].to_numpy(bool)
    z = off[apart] / predicted[["std_x", "std_y", "std_z"]].to_numpy()[apart]
    told = [{OVER.get(e["kind"], "joint") for e in (one, *one["confounded_with"])} for one in cal.result["effects"]]
    return {
        "told": float(any(cause in some for some in told)),
        "plainly": float({cause} in told),
        "false": float(any(cause not in some for some in told)),
        "z": float(np.sqrt(np.mean(z**2))),
        "error mm": 1e3 * float(np.sqrt(np.mean(np.sum(off[apart] ** 2, axis=1)))),
    }


STANDS, STOOD = 30, 310
"""Places, and rows in all."""

BOW, TILT, YIELD, GEAR = 1.5e-3, 1.5e-3, 2e-3, 5e-4
"""Of a column [m], of its tilt [rad], of a joint under the largest load of these rows [rad], and of an order of a gear [rad]."""

SEEN = 1.5e-4
"""[m]: noise of a position, as of cameras on the walls."""

FREE = 0.05
"""[m] and [rad] by which the oracle's constants may be off those of the geometric stage, as in the search."""


def column(seed: int, spread: float, gears: int) -> dict[str, float]:
    """A column that bends under an arm whose joints yield and whose gears err, seen by cameras.

    Args:
        seed: Of the draw.
        spread: By how much of a joint's range the rows of a place differ from its middle; infinite: rows stand in no places.
        gears: Joints whose gears err; none: the column and the joints are rigid, too.
    """
    rng = np.random.default_rng([seed, 26])
    robot, gravity = draw_robot("column", rng)
    q = draw_readings(robot, STOOD + QUERIES, rng)
    if np.isfinite(spread):
        around_it = spread * np.ptp(q, axis=0) * rng.uniform(-1.0, 1.0, (STOOD, q.shape[1]))
        q[:STOOD] = q[np.sort(np.arange(STOOD) % STANDS)] + around_it
    around = Surroundings(gravity)
    faults = _faults_of_column(robot, q, around, gears, rng) if gears else []
    causes, known = make_causes(faults, robot, q, {}, around, rng, "column")
    bare = simulate(robot, 1, rng, SIZE, kind="position")
    own = tuple(c for cause in causes for c in cause.effect.coefficients)
    model = replace(bare.model.with_coefficients((*bare.model.coefficients, *own)), around=around)
    _, p = model.poses(np.concatenate([bare.theta, *(cause.values for cause in causes)]), model.rows(q, known))
    rows = pd.DataFrame({**dict(zip(robot.readings, q.T, strict=True)), **dict(zip("xyz", p.T, strict=True))})
    seen = rows[:STOOD].copy()
    seen[list("xyz")] += SEEN * rng.standard_normal((STOOD, 3))
    base = {"urdf": "robot.urdf", "base": robot.base, "tip": robot.tip, "gravity": gravity.tolist()}
    with tempfile.TemporaryDirectory() as folder:
        cal = aridcal.calibrate(write_campaign(Path(folder), bare, seen, robot=base, diagnosis={"enabled": True}))
        told = aridcal.calibrate(write_campaign(Path(folder), bare, seen, robot=base, effects=_declared(faults)))
    assert cal.outcome is not None
    fits = {name: cal.outcome.stage(name).fit for name in ("nominal", "geometric")}
    fits["oracle"] = _oracle_of_column(fits["geometric"], cal.outcome.measurements.fitted, q, known, own)
    asked = {name: fit.model.poses(fit.theta, fit.model.rows(q[STOOD:], _rows(known, slice(STOOD, None))))[1]
             for name, fit in fits.items()}  # fmt: skip
    answers = {"final": cal.predict(rows[STOOD:]), "told": told.predict(rows[STOOD:])}
    asked |= {name: answer[["x", "y", "z"]].to_numpy() for name, answer in answers.items()}
    z = (asked["final"] - p[STOOD:]) / answers["final"][["std_x", "std_y", "std_z"]].to_numpy()
    error = {name: 1e3 * float(np.sqrt(np.mean(np.sum((at - p[STOOD:]) ** 2, axis=1)))) for name, at in asked.items()}
    ratio = error["final"] / error["oracle"]
    return {
        **{f"{name} mm": error[name] for name in ("nominal", "geometric", "final", "told", "oracle")},
        "over the oracle's": ratio,
        "z": float(np.sqrt(np.mean(z**2))),
        "told over the oracle's": error["told"] / error["oracle"],
        "told, at most 1.15": float(error["told"] <= 1.15 * error["oracle"]),
        "at most 1.15": float(ratio <= 1.15),
        "effects": float(len(cal.result["effects"])),
        "structure said": float(cal.result["verdict"] == "structure_remains"),
    }


def _rows(columns: dict[str, np.ndarray], some: np.ndarray | slice) -> dict[str, np.ndarray]:
    return {name: values[some] for name, values in columns.items()}


def _faults_of_column(
    robot: Robot, q: np.ndarray, around: Surroundings, gears: int, rng: np.random.Generator
) -> list[TrueEffect]:
    """A bow of the column and a tilt with it, two joints that yield, and gears of the first joints, off once and twice a turn."""
    load = covariate_table(robot, q, {}, around, np.zeros(len(q), dtype=int), {".gravity_"})
    rail, *turning = robot.names
    faults: list[dict[str, object]] = [
        {"kind": "rail_straightness", "where": rail, "motion": "t1", "form": "bow", "coefficients": BOW},
        {"kind": "rail_angular", "where": rail, "motion": "pitch", "form": "bow", "coefficients": TILT},
    ]
    for joint in turning[1:3]:
        yields = YIELD / float(np.abs(load[f"{joint}.gravity_torque"]).max())
        faults.append({"kind": "joint_compliance", "where": joint, "coefficients": yields})
    for joint in turning[:gears]:
        phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        waves = (GEAR * np.column_stack([np.cos(phase), np.sin(phase)])).ravel().tolist()
        faults.append({"kind": "joint_harmonic", "where": joint, "order": [1, 2], "coefficients": waves})
    return [TrueEffect.model_validate(fault) for fault in faults]


def _declared(faults: Sequence[TrueEffect]) -> list[dict[str, object]]:
    """The true causes as a campaign declares them: without their form or size."""
    said = ({"kind": f.kind, "where": f.where, "motion": f.motion, "order": f.order} for f in faults)
    return [{key: value for key, value in one.items() if value is not None} for one in said]


def _oracle_of_column(
    geometric: Fit, train: Dataset, q: np.ndarray, known: dict[str, np.ndarray], own: tuple[Coefficient, ...]
) -> Fit:
    """The fit of the same rows with exactly the true effects, in their true form."""
    number = {reading.tobytes(): k for k, reading in enumerate(q)}
    there = np.array([number[reading.tobytes()] for reading in train.readings])
    model = geometric.model.with_coefficients((*geometric.model.coefficients, *own))
    before = np.concatenate([geometric.theta, np.zeros(len(own))])
    held = np.concatenate([np.full(len(geometric.theta), FREE**-2.0), np.zeros(len(own))])
    rows = replace(train, covariates={**train.covariates, **_rows(known, there)})
    return fit(problem(model, rows), before, prior=Prior(before, np.diag(held)))


QUESTIONS: dict[str, Sequence[tuple[str, Callable[[int], dict[str, float]]]]] = {
    "few": tuple(
        (f"{name}, {rows} rows", partial(few, name=name, rows=rows))
        for name in ("UR10", "7R", "rail and 3R")
        for rows in (12, 20, 30, 50)
    ),
    "seating": (
        ("13 % 0.7 mm high", lambda seed: seating(seed, True)),
        ("one noise with tails", lambda seed: seating(seed, False)),
    ),
    "heat": (
        ("12 K warmer", lambda seed: heat(seed, True)),
        ("at the same temperature", lambda seed: heat(seed, False)),
    ),
    "night": (
        ("knocked at 00:30", lambda seed: night(seed, True)),
        ("no knock", lambda seed: night(seed, False)),
    ),
    "gravity": (
        *((way, partial(gravity, way=way, gears=2e-4, compliance=3e-5)) for way in ("wedge", "wall", "ceiling")),
        ("floor", partial(gravity, way="floor", gears=2e-4, compliance=3e-5)),
        ("floor, gears alone", partial(gravity, way="floor", gears=3e-4, compliance=0.0)),
    ),
    "slips": tuple((slip, partial(slips, slip=slip)) for slip in ("sign", "zero", "poses", "none")),
    "check": (
        ("error curves", lambda seed: check(seed, "curves", False)),
        ("errors by all readings", lambda seed: check(seed, "all readings", False)),
        ("noise of t2", lambda seed: check(seed, "none", True)),
        ("neither", lambda seed: check(seed, "none", False)),
    ),
    "accused": tuple(
        (f"{what or 'even noise'}, {kind}s", partial(accused, what=what, kind=kind))
        for what in ("lever", "depth", "depth, elsewhere", "joint", "joints", "")
        for kind in ("position", "pose")
    ),
    "rivals": tuple(
        (
            f"{cause}, not {other}, {'shuffled' if shuffled else 'in order'}",
            partial(rivals, cause=cause, other=other, shuffled=shuffled),
        )
        for cause, other in (("time", "joint"), ("joint", "time"), ("temperature", "time"), ("time", "temperature"))
        for shuffled in (False, True)
    ),
    "column": (
        ("bent, in 30 places, within 6 %", lambda seed: column(seed, 0.06, 4)),
        ("bent, in 30 places, within 1 %", lambda seed: column(seed, 0.01, 4)),
        ("bent, everywhere", lambda seed: column(seed, np.inf, 4)),
        ("gears of the wrist, too, within 6 %", lambda seed: column(seed, 0.06, 6)),
        ("rigid, in 30 places, within 1 %", lambda seed: column(seed, 0.01, 0)),
    ),
    "places": (
        ("alike at a place, clean arm", lambda seed: places(seed, True, False)),
        ("each anew, clean arm", lambda seed: places(seed, False, False)),
        ("alike at a place, an error curve", lambda seed: places(seed, True, True)),
        ("each anew, an error curve", lambda seed: places(seed, False, True)),
    ),
}


MEANT = "covered"
"""A share of which the mean over the draws is asked for, as each draw's own is of one robot alone."""


def _in_words(key: str, values: np.ndarray) -> str:
    if values.dtype == bool:
        return f"{key} {values.sum()} of {len(values)}"
    there = values[~np.isnan(values)]
    if key == MEANT and len(there):
        return f"{key} {there.mean():.3f} in the mean ({there.min():.2f} at the least)"
    if len(there) and np.isin(there, (0.0, 1.0)).all():
        return f"{key} {int(there.sum())} of {len(there)}"
    return f"{key} {np.median(there):.3g} ({np.quantile(there, 0.95):.3g})" if len(there) else f"{key} none"


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("questions", nargs="*", default=list(QUESTIONS))
    command.add_argument("--draws", type=int, default=25)
    command.add_argument("--seed", type=int, default=0)
    arguments = command.parse_args()
    for question in arguments.questions:
        answers = Table("case", "draws", "figures: how often, or median (95th percentile)")
        for name, draw in QUESTIONS[question]:
            drawn = [draw(arguments.seed + k) for k in range(arguments.draws)]
            figures = {key: np.array([one[key] for one in drawn]) for key in drawn[0]}
            said = ", ".join(_in_words(key, values) for key, values in figures.items())
            answers.add_row(name, str(len(drawn)), said)
        Console(width=160).print(question, answers)


if __name__ == "__main__":
    main()
