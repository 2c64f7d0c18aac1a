"""Robots with several arms, measured from link to link: errors beside an oracle's, what is named, what sigmas are worth.

    python benchmarks/trees.py                           # every way, 50 draws, half of them with an undeclared effect
    python benchmarks/trees.py --way camera --draws 4
    python benchmarks/trees.py --together                # both arms together and each alone
    python benchmarks/trees.py --large                   # 40 joints, four paths, 2,000 rows: CPU seconds and memory

The robot has two 7R arms and a head on a torso; origins of all joints are 1 mm and 1 mrad (1 sigma) off, noise is known. Its
rows are Pinocchio's, and so is the oracle: least squares from the truth on, told which effect there is, derivatives by
differences. Errors are those of 60 rows without noise that are held out. An effect is a compliance, a gain or a harmonic of a
joint of an arm; after what constants take up it leaves 3 to 15 sigmas (RMS over the way's numbers).

Where rows hardly see a joint, as a table does one that turns about its normal, so much may take an effect that no robot has:
half a radian of a harmonic, or a gain that is off by 0.9. Another joint and kind are drawn then, until the size is within MOST.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.table import Table
from tree_robot import Effect, Robot, built, urdf, with_errors
from tree_ways import MARKS, SPOTS, WAYS, Seen, Tracker, Way

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.residual import linearise
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.system.errors import AridcalError

TEST = 60
SIZES = (3.0, 15.0)
MOST = {"joint_compliance": 1e-3, "joint_gain": 0.05, "joint_harmonic": 0.02}
"""Largest coefficient of each kind, in [rad/(N m)], [1] and [rad]: a shoulder of 1 kN m/rad sags by up to 66 mrad under its
own arm; a reading is off by 1 in 20; or by more than a degree somewhere in each turn."""

TRIED = 1e-4
"""Coefficient at which it is found out what an effect leaves: that goes with it."""

STEP = 1e-5
"""[m] and [rad]: of central differences, exact to 1e-10 of the largest column."""

RANK = 1e-6
"""Of the largest singular value: below it is no direction, but the error of the differences."""


@dataclass(frozen=True)
class Draw:
    """One robot with its rows.

    Attributes:
        robot: As built.
        fitted: Rows of each way.
        exact: Rows of each way without noise.
    """

    robot: Robot
    fitted: dict[Way, Seen]
    exact: dict[Way, Seen]


def drawn(ways: Sequence[Way], seed: int, with_effect: bool) -> Draw:
    """A robot, its effect of a size that rows can tell, and its rows."""
    rng = np.random.default_rng([seed, 2])
    robot = built(seed, urdf())
    if with_effect:
        rows = {way: way.draw(robot, way.rows, np.random.default_rng([seed, 3]), False) for way in ways}
        robot = replace(robot, effects=(_some_effect(robot, rows, seed, rng),))
    fitted = {way: way.draw(robot, way.rows, np.random.default_rng([seed, 4]), True) for way in ways}
    exact = {way: way.draw(robot, TEST, np.random.default_rng([seed, 5]), False) for way in ways}
    return Draw(robot, fitted, exact)


def _some_effect(robot: Robot, rows: dict[Way, Seen], seed: int, rng: np.random.Generator) -> Effect:
    """An effect of a robot without one: of the first kind and joint of those drawn that may have what rows can tell."""
    joints = [name for name in robot.joints if "_j" in name and not name.endswith("_j7")]
    kinds = cycle(np.roll(list(MOST), -(seed // 2)).tolist())

    def another() -> Effect:
        joint, order, phase = str(rng.choice(joints)), int(rng.integers(1, 3)), float(rng.uniform(0, 2 * np.pi))
        return Effect(next(kinds), joint, TRIED, order, phase)

    left, effect, wanted = left_by(robot, rows), another(), float(rng.uniform(*SIZES))
    while TRIED * wanted > MOST[effect.kind] * (leaves := left(effect)):
        effect = another()
    return replace(effect, size=TRIED * wanted / leaves)


def whitened(robot: Robot, things: dict[Way, np.ndarray], rows: dict[Way, Seen]) -> np.ndarray:
    """Residuals of all ways in sigmas, one after the other."""
    return np.concatenate([(way.residual(robot, things[way], own) / way.sigma).ravel() for way, own in rows.items()])


def columns(robot: Robot, things: dict[Way, np.ndarray], rows: dict[Way, Seen]) -> np.ndarray:
    """What origins, things and the effect's size change of the whitened residuals, by differences."""
    found = []
    for k in range(robot.moved.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = robot.moved.ravel().copy()
            moved[k] += sign * STEP
            ends.append(whitened(with_errors(robot, moved, robot.effects), things, rows))
        found.append(ends[0] - ends[1])
    for way, own in things.items():
        for k in range(len(own)):
            step = STEP * np.eye(len(own))[k]
            found.append(
                whitened(robot, things | {way: own + step}, rows) - whitened(robot, things | {way: own - step}, rows)
            )
    for other in _quadratures(robot):
        ends = [whitened(_with(robot, other, sign * STEP), things, rows) for sign in (1.0, -1.0)]
        found.append(ends[0] - ends[1])
    return np.array(found).T / (2.0 * STEP)


def _quadratures(robot: Robot) -> list[Effect]:
    """What is sought of the robot's effect: its size, and of a harmonic that a quarter of a turn away, too."""
    return [
        replace(effect, size=1.0, phase=effect.phase + turn)
        for effect in robot.effects
        for turn in ((0.0, np.pi / 2) if effect.kind == "joint_harmonic" else (0.0,))
    ]


def _with(robot: Robot, effect: Effect, size: float) -> Robot:
    """The robot with some of an effect beside what it has."""
    return replace(robot, effects=(*robot.effects, replace(effect, size=size)))


def left_by(robot: Robot, rows: dict[Way, Seen]) -> Callable[[Effect], float]:
    """RMS in sigmas of what an effect leaves that constants and things of a robot without one cannot take up."""
    things = {way: way.things() for way in rows}
    J, before = columns(robot, things, rows), whitened(robot, things, rows)
    back = np.linalg.pinv(J, rcond=RANK)

    def left(effect: Effect) -> float:
        off = whitened(replace(robot, effects=(effect,)), things, rows) - before
        return float(np.sqrt(np.mean((off - J @ (back @ off)) ** 2)))

    return left


def oracle(draw: Draw) -> dict[Way, np.ndarray]:
    """Residuals of the exact rows after least squares that start at the truth and know of the effect, as the ways have them."""
    robot, things = draw.robot, {way: way.things() for way in draw.fitted}
    at = {way: own if own.agreeing is None else replace(own, q=own.agreeing) for way, own in draw.fitted.items()}
    back = np.linalg.pinv(columns(robot, things, at), rcond=RANK)
    for _ in range(3):
        step = -back @ whitened(robot, things, draw.fitted)
        count = robot.moved.size
        moved, step = robot.moved.ravel() + step[:count], step[count:]
        for way, own in things.items():
            things[way], step = own + step[: len(own)], step[len(own) :]
        robot = with_errors(robot, moved, robot.effects)
        for other, value in zip(_quadratures(draw.robot), step, strict=True):
            robot = _with(robot, other, float(value))
        if robot.effects:
            robot = replace(robot, effects=(_summed(robot.effects),))
    return {way: way.residual(robot, things[way], own) for way, own in draw.exact.items()}


def _summed(effects: tuple[Effect, ...]) -> Effect:
    """Effects of one kind and place as one."""
    first = effects[0]
    if first.kind != "joint_harmonic":
        return replace(first, size=sum(e.size for e in effects))
    whole = sum(e.size * np.exp(1j * e.phase) for e in effects)
    return replace(first, size=float(np.abs(whole)), phase=float(np.angle(whole)))


def write(folder: Path, draw: Draw, **more: Any) -> Path:
    """The campaign of a draw."""
    (folder / "tree.urdf").write_bytes(urdf())
    for side in ("left", "right"):
        marks = pd.DataFrame(MARKS, columns=["x", "y", "z"])
        marks.insert(0, "marker", [f"{side}_{k}" for k in range(len(MARKS))])
        marks.to_csv(folder / f"{side}_marks.csv", index=False)
    spots = pd.DataFrame(SPOTS, columns=["x", "y", "z"])
    spots.insert(0, "point", [str(k) for k in range(len(SPOTS))])
    spots.to_csv(folder / "spots.csv", index=False)
    blocks: list[dict[str, Any]] = []
    things: dict[str, Any] = {}
    for way in draw.fitted:
        parts = [way.table(draw.robot, rows).assign(split=split)
                 for rows, split in ((draw.fitted[way], "train"), (draw.exact[way], "test"))]  # fmt: skip
        if "shot" in parts[1]:
            parts[1]["shot"] += parts[0]["shot"].max() + 1
        pd.concat(parts).to_csv(folder / f"{way.name}.csv", index=False)
        block, named = way.keys()
        noise = {channel: sigma for channel, (_, sigma) in way.channels.items()}
        blocks.append({"kind": way.kind, "file": f"{way.name}.csv", "noise": noise, **block})
        for key, value in named.items():
            things[key] = things.get(key, {}) | value if isinstance(value, dict) else value
    document = {
        "format": 1,
        "robot": {"urdf": "tree.urdf", "base": "torso", "tip": "left_hand"},
        "measurements": blocks if len(blocks) > 1 else blocks[0],
        "instruments": things,
    } | more
    (folder / "campaign.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return folder / "campaign.yaml"


def exact_errors(outcome: Outcome) -> tuple[np.ndarray, float]:
    """Residuals of the exact rows, (n, m), and the RMS of their ratio to the sigmas that the model states for them."""
    final, rows = outcome.stages[-1].fit, outcome.measurements
    asked = problem(final.model, rows.select(rows.test)).agreeing(final.theta)
    off = asked.residual(final.theta)
    if asked.groups is None:
        spread = asked.carried(final.theta, final.covariance, slice(0, len(asked)))
    else:
        spread = _with_things(asked, problem(final.model, rows.fitted), final)
    sigma = np.sqrt(np.maximum(np.einsum("nmm->nm", spread), 1e-30))
    return off, float(np.sqrt(np.nanmean((off / sigma) ** 2)))


def _with_things(asked: Problem, fitted: Problem, final: Fit) -> np.ndarray:
    r"""Covariance of rows, (n, m, m), whose things were solved for beside the coefficients.

    .. math:: (J - B X) C (J - B X)^T + B H^{-1} B^T

    with C that of the coefficients, X how the things follow them, and H the things' own information in the fitted rows.
    """
    found = linearise(fitted, final.theta, final.weight, final.sigma).groups
    assert found is not None
    pieces, own = asked.pieces(final.theta), asked.group_of(slice(None))
    J = pieces.J - pieces.B @ found.X[own]
    of_things = pieces.B @ found.inverse[own] @ pieces.B.transpose(0, 2, 1)
    return np.asarray(J @ final.covariance @ J.transpose(0, 2, 1) + of_things)


def trial(names: list[str], seed: int) -> dict[str, Any]:
    """One draw, calibrated; every other one has an effect."""
    ways = [WAYS[name] for name in names]
    with_effect = bool(seed % 2)
    draw = drawn(ways, seed, with_effect)
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), draw)
        started = time.process_time()
        outcome = identify(path)
        seconds = time.process_time() - started
    off, sigma = exact_errors(outcome)
    best = oracle(draw)
    weighed = [float(np.mean((own / way.sigma) ** 2)) for way, own in best.items()]
    sizes = np.concatenate([np.broadcast_to(way.sigma, own.shape).ravel() for way, own in best.items()])
    ours = off[np.isfinite(off)].ravel() / sizes if len(ways) == 1 else off[np.isfinite(off)] / _spread(outcome, off)
    ratio = float(np.sqrt(np.mean(ours**2) / np.mean(weighed)))
    named = () if outcome.diagnosis is None else outcome.diagnosis.effects
    places = {(each.effect.kind, each.effect.where) for each in named}
    twins = {(twin.kind, twin.where) for each in named for twin in each.confounded_with}
    truth = {(e.kind, e.joint) for e in draw.robot.effects}
    right = truth & (places | twins)
    return {
        "seed": seed, "ratio": ratio, "sigma": sigma, "seconds": seconds, "verdict": outcome.verdict.word,
        "effect": next(iter(truth), None), "named": bool(right), "false": len(places) - bool(right and places),
        "places": sorted(map(str, places)),
    }  # fmt: skip


def _spread(outcome: Outcome, off: np.ndarray) -> np.ndarray:
    """The declared sigma of each number that is there."""
    channels = outcome.measurements.channels
    sigma = np.repeat(outcome.noise, [channel.size for channel in channels])
    return np.asarray(np.broadcast_to(sigma, off.shape)[np.isfinite(off)])


def trials(ways: list[str], draws: int, first: int) -> None:
    """A row for each way."""
    table = Table("way", "draws", "error / oracle: median", "95 %", "named", "false", "error / sigma", "CPU, s")
    for way in ways:
        done = []
        for seed in range(first, first + draws):
            try:
                done.append(trial(way.split("+"), seed))
                print(way, json.dumps(done[-1], default=str), file=sys.stderr, flush=True)
            except AridcalError as fault:
                print(way, seed, "refused:", fault, file=sys.stderr, flush=True)
        ratios = [one["ratio"] for one in done]
        asked = [one for one in done if one["effect"] is not None]
        table.add_row(
            way, str(len(done)), f"{np.median(ratios):.3f}", f"{np.quantile(ratios, 0.95):.3f}",
            f"{sum(one['named'] for one in asked)} of {len(asked)}", str(sum(one["false"] for one in done)),
            f"{np.sqrt(np.mean([one['sigma'] ** 2 for one in done])):.3f}", f"{np.mean([one['seconds'] for one in done]):.1f}",
        )  # fmt: skip
    Console(width=120).print(table)


def together(draws: int, first: int) -> None:
    """What calibrating both arms at once gains over each alone, by the RMS position error of exact rows."""
    table = Table("rows", "each arm alone, mm", "both together, mm", "with a bar between them, mm")
    for kind, rows in (("poses", 60), ("positions", 120)):
        errors: dict[str, list[float]] = {"alone": [], "both": [], "bar": []}
        for seed in range(first, first + draws):
            for name, own in errors.items():
                own.append(_position_error(kind, rows, name, seed))
        table.add_row(f"{rows} {kind}", *(f"{1e3 * np.sqrt(np.mean(np.square(own))):.4f}" for own in errors.values()))
    Console(width=120).print(table)


def _position_error(kind: str, rows: int, name: str, seed: int) -> float:
    """RMS over both hands of one draw, each hand measured in half of the rows, [m]."""
    make = type(WAYS[kind])
    whole = drawn([make(), WAYS["ballbar"]], seed, False)
    seen, bar = whole.fitted
    fitted = {seen: _some(whole.fitted[seen], np.arange(rows)), bar: _some(whole.fitted[bar], np.arange(rows))}
    squares = []
    sides = [("left",), ("right",)] if name == "alone" else [("left", "right")]
    for own in sides:
        way = make(*own)
        parts = {way: (_of(fitted[seen], own), _of(whole.exact[seen], own))}
        if name == "bar":
            parts[bar] = (fitted[bar], whole.exact[bar])
        draw = Draw(whole.robot, {w: p[0] for w, p in parts.items()}, {w: p[1] for w, p in parts.items()})
        with tempfile.TemporaryDirectory() as folder:
            keys = {
                "robot": {"urdf": "tree.urdf", "base": "torso", "tip": f"{own[0]}_hand"},
                "diagnosis": {"enabled": False},
            }
            off, _ = exact_errors(identify(write(Path(folder), draw, **keys)))
        squares += list(np.sum(off[np.isfinite(off[:, 0]), :3] ** 2, axis=1))
    return float(np.sqrt(np.mean(squares)))


def _some(rows: Seen, which: np.ndarray) -> Seen:
    """Some of the rows of a way without images."""
    return Seen(rows.q[which], rows.label[which], rows.observed[which])


def _of(rows: Seen, sides: Sequence[str]) -> Seen:
    """The rows of some hands."""
    return _some(rows, np.flatnonzero(np.isin(rows.label, sides)))


def large(seed: int) -> None:
    """CPU seconds and memory of the whole command on 40 joints, four paths, 2,000 rows."""
    sides = ("left", "right", "low_left", "low_right")
    text = urdf(sides, 3)
    way, robot = Tracker(*sides), built(seed, text)
    rng = np.random.default_rng(seed)
    draw = Draw(robot, {way: way.draw(robot, 1600, rng, True)}, {way: way.draw(robot, 400, rng, True)})
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), draw)
        (Path(folder) / "tree.urdf").write_bytes(text)
        command = [sys.executable, "-m", "aridcal.identify", str(path), "--quiet"]
        subprocess.run(command, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        result = json.loads((Path(folder) / "results" / "result.json").read_text())
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{len(robot.joints)} joints, {len(sides)} paths, {result['n']['used']} rows: {used.ru_utime + used.ru_stime:.1f} s CPU, "
        f"{used.ru_maxrss / 1024:.0f} MB; {result['verdict']}, {len(result['effects'])} effects, held-out "
        f"{result['error']['final']['test']['position_mm']['rms']:.3f} mm"
    )


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("--way", action="append", help=f"one of {', '.join(WAYS)}, or several with + between them")
    command.add_argument("--draws", type=int, default=50)
    command.add_argument("--seed", type=int, default=1000, help="of the first draw")
    command.add_argument("--together", action="store_true")
    command.add_argument("--large", action="store_true")
    arguments = command.parse_args()
    if arguments.large:
        large(arguments.seed)
    elif arguments.together:
        together(arguments.draws, arguments.seed)
    else:
        trials(arguments.way or list(WAYS), arguments.draws, arguments.seed)


if __name__ == "__main__":
    main()
