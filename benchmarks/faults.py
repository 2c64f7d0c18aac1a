"""The attacks: what is done to a scene or to its table before a calibration sees it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from hostile import Case, Cause, Measuring, Scene, draw_scene, measure, white

WIDTHS = (0.05, 0.2)  # of a bump, [rad]
BUMPS = (1.0, 20.0)  # RMS per number of a bump in the rows within two widths of it, [sigma]
SLIP = (2e-4, 4e-4)  # of a target, [m]
MOVED = ((2e-4, 1e-3), (1e-4, 5e-4))  # of a base, [m] and [rad]
JUMP = (2e-4, 1e-3)  # of a joint's zero, [rad]
STEPS = (0.2, 0.8)  # where in the rows something moves, of all rows
SCATTER = (2e-4, 4e-4)  # of a joint's readings, [rad]
CLEAR = 1.0
"""RMS per number in sigma below which a joint's jump or scatter is drawn anew: what moves the target by less than the
noise cannot be placed within 2 % of 250 rows, nor told within 15 %."""

WILD = (20.0, 100.0)  # how far off a gross error is, [sigma]

Made = tuple[Scene, Measuring]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Drawn alike in size at every scale."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _direction(rng: np.random.Generator) -> np.ndarray:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def clean(rng: np.random.Generator, k: int) -> Made:
    """Constants and noise, nothing else."""
    scene = draw_scene(rng, k)
    return scene, white(scene)


def bump(rng: np.random.Generator, k: int) -> Made:
    """One joint errs in a narrow part of its travel."""
    s = draw_scene(rng, k)
    joint = int(rng.choice(np.flatnonzero(s.arm.turns)))
    low, high = s.arm.travel[joint]
    width, size = _between(rng, *WIDTHS), _between(rng, *BUMPS)
    centre = float(rng.uniform(low + 2 * width, high - 2 * width))
    shape = np.exp(-0.5 * ((s.q[:, joint] - centre) / width) ** 2)
    near = np.abs(s.q[: s.n, joint] - centre) < 2 * width
    height = size / _rms(s.moved(joint, shape)[: s.n][near])
    amount = height * shape
    joints = s.joints.copy()
    joints[:, joint] = amount
    knots = np.arange(low - width, high + 2 * width, width)
    curve = np.exp(-0.5 * ((s.q[:, joint, None] - knots) / width) ** 2)
    name = s.arm.names[joint]
    made = replace(
        s, joints=joints, free=((s.about(joint), amount),), curve=(s.about(joint), curve),
        cause=Cause(("joint_map", "joint_harmonic", "unknown"), name),
        said=f"bump at {name}, {width:.3f} rad wide, {1e3 * height:.2f} mrad high, {size:.1f} sigma in {near.sum()} rows",
    )  # fmt: skip
    return made, white(made)


def _quiet(s: Scene) -> Scene:
    """An instrument that can tell a few tenths of a millimetre."""
    return replace(s, sigma=np.array([4e-5, 4e-5]) * s.rng.uniform(1.0, 2.5, 2))


def _after(s: Scene, row: int) -> np.ndarray:
    """1 from a row on, and of what is asked for, which is now; shape (M,)."""
    return (np.arange(len(s.q)) >= row).astype(float)


def _stepped(s: Scene, row: int, where: str, said: str, directions: np.ndarray, **moved: np.ndarray) -> Made:
    after = _after(s, row)
    free = tuple((d, after) for d in directions)
    order = "time" if s.timed else "rows"
    made = replace(s, free=free, cause=Cause(("shift",), where, row), said=f"{said} at row {row} (in order of {order})")
    made = replace(made, **moved)  # type: ignore[arg-type]
    return made, replace(white(made), shuffled=s.timed and bool(s.rng.random() < 0.5))


def _frame_step(rng: np.random.Generator, k: int, where: str) -> Made:
    s = _quiet(draw_scene(rng, k))
    row = int(rng.uniform(*STEPS) * s.n)
    twist = np.zeros(6)
    if where == "tip_target":
        twist[:3] = rng.uniform(*SLIP) * _direction(rng)
        at, slot = slice(6, 12), "held"
        said = f"target slips by {1e3 * np.linalg.norm(twist[:3]):.2f} mm"
    else:
        twist[:3], twist[3:] = rng.uniform(*MOVED[0]) * _direction(rng), rng.uniform(*MOVED[1]) * _direction(rng)
        at, slot = slice(0, 6), "base"
        said = f"base moves by {1e3 * np.linalg.norm(twist[:3]):.2f} mm, {1e3 * np.linalg.norm(twist[3:]):.2f} mrad"
    return _stepped(s, row, where, said, np.eye(12 + s.off.size)[at], **{slot: np.outer(_after(s, row), twist)})


def slip(rng: np.random.Generator, k: int) -> Made:
    """The target slips in its grip at some row."""
    return _frame_step(rng, k, "tip_target")


def tripod(rng: np.random.Generator, k: int) -> Made:
    """The instrument, or the base, moves at some row."""
    return _frame_step(rng, k, "world_base")


def jump(rng: np.random.Generator, k: int) -> Made:
    """A joint's zero jumps at some row."""
    while True:
        s = _quiet(draw_scene(rng, k))
        joint = int(rng.choice(np.flatnonzero(s.arm.turns)))
        size = rng.uniform(*JUMP) * rng.choice((-1.0, 1.0))
        if _rms(s.moved(joint, np.full(len(s.q), size))) >= CLEAR:
            break
    row = int(rng.uniform(*STEPS) * s.n)
    joints = s.joints.copy()
    joints[:, joint] = size * _after(s, row)
    name = s.arm.names[joint]
    return _stepped(s, row, name, f"zero of {name} jumps by {1e3 * size:.2f} mrad", s.about(joint)[None], joints=joints)


def _shifted_tests(rng: np.random.Generator, k: int, size: float) -> Made:
    s = _quiet(draw_scene(rng, k))
    shift = size * _direction(rng)

    def change(table: pd.DataFrame, test: np.ndarray) -> pd.DataFrame:
        table.loc[test, ["x", "y", "z"]] += shift
        return table

    made = replace(s, said=f"all held-out rows {1e3 * size:.1f} mm off")
    return made, replace(white(made), change=change, contradicted=True)


def tests_half(rng: np.random.Generator, k: int) -> Made:
    """All held-out rows are 0.5 mm off."""
    return _shifted_tests(rng, k, 5e-4)


def tests_five(rng: np.random.Generator, k: int) -> Made:
    """All held-out rows are 5 mm off."""
    return _shifted_tests(rng, k, 5e-3)


def tests_wild(rng: np.random.Generator, k: int) -> Made:
    """One in twenty held-out rows is wild."""
    s = draw_scene(rng, k)

    def change(table: pd.DataFrame, test: np.ndarray) -> pd.DataFrame:
        rows = rng.permutation(np.flatnonzero(test))[: int(np.ceil(0.05 * test.sum()))]
        for row in rows:
            table.loc[row, ["x", "y", "z"]] += rng.uniform(*WILD) * s.sigma[0] * _direction(rng)
        return table

    made = replace(s, said="one in twenty held-out rows is wild")
    return made, replace(white(made), change=change, contradicted=True)


def _scattering(s: Scene, scatter: np.ndarray) -> Made:
    said = ", ".join(f"{n} {1e3 * v:.2f} mrad" for n, v in zip(s.arm.names, scatter, strict=True) if v > 0.0)
    made = replace(s, scatter=scatter, said=f"readings scatter: {said}")
    return made, white(made)


def joint_noise(rng: np.random.Generator, k: int) -> Made:
    """Readings of one joint of a one-metre arm scatter."""
    while True:
        s = _quiet(draw_scene(rng, k, ("metre",), 300))
        scatter = np.zeros(len(s.arm.names))
        joint = int(rng.integers(len(scatter)))
        scatter[joint] = rng.uniform(*SCATTER)
        if _rms(s.moved(joint, np.full(len(s.q), scatter[joint]))) >= CLEAR:
            made = replace(s, cause=Cause(("joint_readings",), s.arm.names[joint], value=float(scatter[joint])))
            return _scattering(made, scatter)


def all_joints(rng: np.random.Generator, k: int) -> Made:
    """Readings of all joints of a one-metre arm scatter, at least two of them clearly."""
    while True:
        s = _quiet(draw_scene(rng, k, ("metre",), 300))
        scatter = rng.uniform(1e-4, 3e-4, len(s.arm.names))
        if sum(_rms(s.moved(j, np.full(len(s.q), v))) >= CLEAR for j, v in enumerate(scatter)) >= 2:
            return _scattering(s, scatter)


ATTACKS: dict[str, Callable[[np.random.Generator, int], Made]] = {
    "clean": clean, "bump": bump, "slip": slip, "tripod": tripod, "jump": jump, "tests-0.5mm": tests_half,
    "tests-5mm": tests_five, "tests-wild": tests_wild, "joint-noise": joint_noise, "all-joints": all_joints,
}  # fmt: skip
"""In the order of their seeds: a new one goes last."""

SPACING = 10_000  # of the seeds of two attacks


def draw_case(seed: int) -> Case:
    """Make the data set of a seed: 1,000,000 x the base + 10,000 x the attack + the number of the case."""
    attack = list(ATTACKS)[seed // SPACING % 100]
    return measure(attack, seed, *ATTACKS[attack](np.random.default_rng(seed), seed % SPACING))
