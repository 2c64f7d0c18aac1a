"""The attacks: what is done to a scene or to its table before a calibration sees it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from hostile import DURATION, QUERIES, Case, Cause, Measuring, Scene, draw_scene, measure, white
from plain_arm import small
from plain_robots import HEAVY

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
        causes=(Cause(("joint_map", "joint_harmonic", "unknown"), name),),
        said=f"bump at {name}, {width:.3f} rad wide, {1e3 * height:.2f} mrad high, {size:.1f} sigma in {near.sum()} rows",
    )  # fmt: skip
    return made, white(made)


def _quiet(s: Scene) -> Scene:
    """An instrument that can tell a few tenths of a millimetre."""
    return replace(s, sigma=np.array([4e-5, 4e-5]) * s.rng.uniform(1.0, 2.5, 2))


def _after(s: Scene, row: int) -> np.ndarray:
    """1 from a row on, and of what is asked for, which is now; shape (M,)."""
    return (np.arange(len(s.q)) >= row).astype(float)


def _stepped(s: Scene, row: int, where: str, said: str, directions: np.ndarray, **moved: np.ndarray) -> Scene:
    """A scene with one step more, and its true motion."""
    after = _after(s, row)
    order = "time" if s.timed else "rows"
    told = f"{said} at row {row} (in order of {order})"
    made = replace(
        s, free=(*s.free, *((d, after) for d in directions)), causes=(*s.causes, Cause(("shift",), where, row)),
        said=f"{s.said}, {told}" if s.causes else told,
    )  # fmt: skip
    return replace(made, **moved)  # type: ignore[arg-type]


def _in_any_order(s: Scene) -> Made:
    """Measured, and of those that have a time half with their rows in another order."""
    return s, replace(white(s), shuffled=s.timed and bool(s.rng.random() < 0.5))


def _frame_step(s: Scene, row: int, where: str) -> Scene:
    rng, twist = s.rng, np.zeros(6)
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
    s = _quiet(draw_scene(rng, k))
    return _in_any_order(_frame_step(s, int(rng.uniform(*STEPS) * s.n), "tip_target"))


def tripod(rng: np.random.Generator, k: int) -> Made:
    """The instrument, or the base, moves at some row."""
    s = _quiet(draw_scene(rng, k))
    return _in_any_order(_frame_step(s, int(rng.uniform(*STEPS) * s.n), "world_base"))


def two_steps(rng: np.random.Generator, k: int) -> Made:
    """The target slips and the base moves, at rows that are not close together."""
    s = _quiet(draw_scene(rng, k))
    rows = np.array([rng.uniform(STEPS[0], 0.4), rng.uniform(0.6, STEPS[1])]) * s.n
    first, second = rng.permutation(rows.astype(int)).tolist()
    return _in_any_order(_frame_step(_frame_step(s, first, "tip_target"), second, "world_base"))


def drift(rng: np.random.Generator, k: int) -> Made:
    """The base or the target moves evenly with time: that is no step."""
    s = replace(_quiet(draw_scene(rng, k)), timed=True)
    where = "world_base" if rng.random() < 0.5 else "tip_target"
    twist = np.append(rng.uniform(4e-4, 1e-3) * _direction(rng), rng.uniform(2e-4, 5e-4) * _direction(rng))
    run = np.append((s.time - s.time[-1]) / (s.time[-1] - s.time[0]), np.zeros(QUERIES))
    moved = np.outer(run, twist)
    at = slice(0, 6) if where == "world_base" else slice(6, 12)
    s = replace(
        s, free=tuple((d, run) for d in np.eye(12 + s.off.size)[at]), causes=(Cause(("drift",), where),),
        said=f"{where} drifts by {1e3 * np.linalg.norm(twist[:3]):.2f} mm, {1e3 * np.linalg.norm(twist[3:]):.2f} mrad",
    )  # fmt: skip
    return _in_any_order(replace(s, base=moved) if where == "world_base" else replace(s, held=moved))


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
    said = f"zero of {name} jumps by {1e3 * size:.2f} mrad"
    return _in_any_order(_stepped(s, row, name, said, s.about(joint)[None], joints=joints))


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
            made = replace(s, causes=(Cause(("joint_readings",), s.arm.names[joint], value=float(scatter[joint])),))
            return _scattering(made, scatter)


def all_joints(rng: np.random.Generator, k: int) -> Made:
    """Readings of all joints of a one-metre arm scatter, at least two of them clearly."""
    while True:
        s = _quiet(draw_scene(rng, k, ("metre",), 300))
        scatter = rng.uniform(1e-4, 3e-4, len(s.arm.names))
        if sum(_rms(s.moved(j, np.full(len(s.q), v))) >= CLEAR for j, v in enumerate(scatter)) >= 2:
            return _scattering(s, scatter)


def rounding(rng: np.random.Generator, k: int) -> Made:
    """Positions are written to 0.1 mm by an instrument of 0.02 mm."""
    s, step, noise = draw_scene(rng, k), 1e-4, 2e-5
    s = replace(
        s, sigma=np.array([np.hypot(noise, step / np.sqrt(12)), s.sigma[1]]), said="positions rounded to 0.1 mm"
    )
    how = white(s)
    how.error[:, :3] *= noise / s.sigma[0]
    return s, replace(how, step=step)


def ar1(rng: np.random.Generator, k: int) -> Made:
    """Each row's noise resembles that of the row before."""
    s, alike = draw_scene(rng, k), rng.uniform(0.4, 0.9)
    how = white(s)
    for row in range(1, s.n):
        how.error[row] = alike * how.error[row - 1] + np.sqrt(1.0 - alike**2) * how.error[row]
    return replace(s, said=f"noise of neighbouring rows correlated, {alike:.2f}"), how


def range_noise(rng: np.random.Generator, k: int) -> Made:
    """Noise grows with the distance from an instrument that stands close by."""
    s = draw_scene(rng, k)
    centre = np.append(s.arm.frames(s.q)[-1][:, :3, 3].mean(axis=0), 1.0)
    spread = float(np.linalg.norm(s.arm.frames(s.q)[-1][:, :3, 3] - centre[:3], axis=1).mean())
    world = s.world.copy()
    world[:3, 3] = 1.2 * spread * _direction(rng) - world[:3, :3] @ centre[:3]
    s = replace(s, world=world)
    far = np.linalg.norm(s.truth[1][: s.n], axis=1)
    far = np.hypot(far, 0.2 * _rms(far))
    growth = far / _rms(far)
    how = white(s)
    said = f"noise grows with range, {growth.min():.1f} to {growth.max():.1f}"
    return replace(s, said=said), replace(how, error=how.error * growth[:, None], growth=growth)


def copies(rng: np.random.Generator, k: int) -> Made:
    """Some rows are copied with another time."""
    s = replace(draw_scene(rng, k), timed=True)
    chosen = np.repeat(rng.permutation(s.n)[: rng.integers(1, 6)], rng.integers(1, 4))

    def change(table: pd.DataFrame, _: np.ndarray) -> pd.DataFrame:
        again = table.iloc[chosen].assign(time=s.time[-1] + DURATION * np.arange(1, len(chosen) + 1))
        return pd.concat([table, again], ignore_index=True)

    made = replace(s, said=f"{len(set(chosen))} rows copied {len(chosen)} times with another time")
    return made, replace(white(made), change=change)


def walk(rng: np.random.Generator, k: int) -> Made:
    """The base wanders from row to row; it is asked for where it was at some of the rows.

    The first joint's place wanders with it: that is the same motion.
    """
    s = _quiet(draw_scene(rng, k))
    path = np.cumsum(rng.standard_normal((s.n, 6)), axis=0)
    path -= path.mean(axis=0)
    size = np.repeat([rng.uniform(1e-4, 4e-4), rng.uniform(5e-5, 2e-4)], 3)
    path *= size / np.sqrt(np.mean(path**2, axis=0))
    when = rng.integers(0, s.n, QUERIES)
    made = replace(
        s, base=np.vstack([path, path[when]]), extra={"time": np.append(s.time, s.time[when])} if s.timed else {},
        causes=tuple(Cause(("drift", "shift", "unknown"), where) for where in ("world_base", s.arm.names[0])),
        said=f"base wanders by {1e3 * size[0]:.2f} mm, {1e3 * size[3]:.2f} mrad RMS",
    )  # fmt: skip
    return made, white(made)


def payload(rng: np.random.Generator, k: int) -> Made:
    """A joint yields to gravity under payloads of 0, 5 and 10 kg."""
    s = draw_scene(rng, k, HEAVY)
    carried = np.concatenate(
        [np.repeat(rng.choice((0.0, 5.0, 10.0), 25), s.n // 25), rng.choice((0.0, 5.0, 10.0), QUERIES)]
    )
    pull = s.arm.pull(s.q, carried, s.tool[:3, 3])
    joint = int(rng.choice(np.flatnonzero(np.ptp(pull, axis=0) > 0.2 * np.ptp(pull, axis=0).max())))
    size = _between(rng, 3.0, 20.0)
    value = size / _rms(s.moved(joint, pull[:, joint])[: s.n])
    joints = s.joints.copy()
    joints[:, joint] = value * pull[:, joint]
    name = s.arm.names[joint]
    made = replace(
        s, joints=joints, free=((s.about(joint), joints[:, joint]),), extra={"payload": carried},
        causes=(Cause(("joint_compliance",), name, value=float(value)),),
        said=f"{name} yields by {value:.2e} rad/(N m) under 0, 5, 10 kg, {size:.1f} sigma",
    )  # fmt: skip
    return made, white(made)


def wild(rng: np.random.Generator, k: int) -> Made:
    """Three rows in a hundred are grossly wrong."""
    s = draw_scene(rng, k)
    how = white(s)
    rows = rng.permutation(s.n)[: round(0.03 * s.n)]
    for row in rows:
        how.error[row] += rng.uniform(*WILD) * np.repeat(s.sigma, 3) * np.append(_direction(rng), _direction(rng))
    return replace(s, said=f"{len(rows)} wild rows"), replace(how, wild=tuple(rows.tolist()))


def markers(rng: np.random.Generator, k: int) -> Made:
    """Three markers of one body at each of 28 poses, made from one measured pose of it."""
    s = draw_scene(rng, k, n=3 * 28)
    q = np.vstack([np.repeat(s.q[:28], 3, axis=0), s.q[s.n :]])
    label = np.append(np.tile(np.arange(3), 28), rng.integers(0, 3, QUERIES))
    at = rng.uniform(-0.1, 0.1, (3, 3))
    tool = np.tile(s.tool, (len(q), 1, 1))
    tool[:, :3, 3] += (s.tool[:3, :3] @ at.T).T[label]
    noise, turn = rng.uniform(5e-4, 2e-3), rng.uniform(1e-3, 4e-3)
    body = rng.standard_normal((28, 6)) * np.repeat([noise, turn], 3)
    off = rng.uniform(0.1, 0.4) * noise * rng.standard_normal(s.off.shape)  # a good robot before a poor instrument
    s = replace(
        s, off=off, q=q, tool=tool, pose=False, label=label, extra={"station": np.array(["A", "B", "C"])[label]}
    )
    centre = s.arm.target(q[: s.n], s.world, s.tool[0] @ small(np.append(-at[0], np.zeros(3))), s.off)[1]
    arms = s.truth[1][: s.n] - centre
    error = np.zeros((s.n, 6))
    error[:, :3] = np.repeat(body[:, :3], 3, axis=0) + np.cross(np.repeat(body[:, 3:], 3, axis=0), arms)
    s = replace(s, sigma=np.array([_rms(error[:, :3]), s.sigma[1]]))
    made = replace(s, said=f"three markers of one body, {1e3 * s.sigma[0]:.2f} mm, 28 poses")
    return made, Measuring(error, np.ones(s.n), split=False)


ATTACKS: dict[str, Callable[[np.random.Generator, int], Made]] = {
    "clean": clean, "bump": bump, "slip": slip, "tripod": tripod, "jump": jump, "tests-0.5mm": tests_half,
    "tests-5mm": tests_five, "tests-wild": tests_wild, "joint-noise": joint_noise, "all-joints": all_joints,
    "rounding": rounding, "ar1": ar1, "range-noise": range_noise, "copies": copies, "walk": walk, "payload": payload,
    "wild": wild, "markers": markers, "two-steps": two_steps, "drift": drift,
}  # fmt: skip
"""In the order of their seeds: a new one goes last."""

SPACING = 10_000  # of the seeds of two attacks


def draw_case(seed: int) -> Case:
    """Make the data set of a seed: 1,000,000 x the base + 10,000 x the attack + the number of the case."""
    attack = list(ATTACKS)[seed // SPACING % 100]
    return measure(attack, seed, *ATTACKS[attack](np.random.default_rng(seed), seed % SPACING))
