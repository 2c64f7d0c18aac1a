"""Calibrations from every kind of measurement: are they exact, are their uncertainties true, do they find what is wrong?

Example:
    python benchmarks/instruments.py coverage --kind point --runs 200
    python benchmarks/instruments.py exact
    python benchmarks/instruments.py ranks
    python benchmarks/instruments.py counts --runs 5
    python benchmarks/instruments.py starts --kind "eye in hand" --runs 100
    python benchmarks/instruments.py blind --kind distance --cases 50 --seed 1
    python benchmarks/instruments.py causes --kind distance --runs 50
    python benchmarks/instruments.py together
    python benchmarks/instruments.py speed

Every campaign is simulated by ``aridcal simulate``'s own code, written to a folder and read back. Constants are drawn with
1 mm and 1 mrad, tools and cameras are mounted anyhow.

- ``coverage`` compares the fit of noisy rows with that of the same rows without noise, whose constants are what the kept ones
  must be: those that no data of the kind can tell apart are then alike in both. Each run counts in sigmas of its own, so
  that weak ones do not speak for all. No search.
- ``exact``: rows never fitted, without noise, and where the target goes but for what the kind cannot know (a motion, a scale).
- ``ranks``: how many numbers of the arm, its frames and its mounting each kind tells.
- ``counts``: how far the prediction of rows never measured is off, against the number of rows, in sigmas of the instrument.
- ``starts``: the noise that is left says whether a fit ended where it should.
- ``causes``: what is named of noise in clean rows, and in the same with joints rounded to 0.1 degree. No search.
- ``blind``: one undeclared effect a case, or none. The oracle is told the effect's kind and place.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable, Sequence

import numpy as np
from instrument_cases import ARMS, QUERIES, WAYS, Made, elsewhere, error_of, geometric, made, noisy, rows_of, scenario
from instruments_blind import blind, causes

from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import Model
from aridcal.jobs.simulate.simulation import named_constants
from aridcal.system.errors import AridcalError

PLACES = ("world_base", "tip_target")


def coverage(kind: str | None, runs: int, seed: int) -> None:
    """Whether uncertainties are true."""
    print(
        f"{'kind':20} {'runs':>4} {'constants':>9} {'within 2 sigma':>14} {'sigma/scatter: constants':>25} {'target':>7}"
    )
    for way in [kind] if kind else WAYS:
        inside, count, squares, of_target, failed = 0, 0, 0.0, [], 0
        for k in range(runs):
            keys, robot = scenario(way, "six", seed * 1000 + k, rows_of(way))
            try:
                with_noise, without = made(noisy(keys), robot), made(keys, robot)
                found = geometric(with_noise)
                true = fit(problem(found.model, without.train), found.theta)
            except AridcalError as fault:
                failed += 1
                print(f"  {way} {k}: {fault}")
                continue
            off = found.theta - true.theta
            inside += int((np.abs(off) < 2 * found.std).sum())
            count += len(off)
            squares += float(off @ np.linalg.solve(found.covariance, off))
            q = draw_readings(robot, QUERIES, np.random.default_rng(k))
            target = (
                None if with_noise.rows.labels.target is None else np.full(QUERIES, with_noise.rows.labels.target[0])
            )
            at = found.model.rows(q, None, None, target)
            _, here, J = found.model.jacobian(found.theta, at)
            _, there = found.model.poses(true.theta, at)
            spread_said = J[:, :3] @ found.covariance @ J[:, :3].transpose(0, 2, 1)
            e = (here - there)[:, :, None]
            of_target.append(float(np.mean(e.transpose(0, 2, 1) @ np.linalg.solve(spread_said, e)) / 3))
        done = max(runs - failed, 1)
        ratios = np.sqrt(max(count, 1) / max(squares, 1e-300)), 1.0 / np.sqrt(np.mean(of_target))
        share = inside / max(count, 1)
        print(f"{way:20} {done:4} {count / done:9.1f} {share:14.4f} {ratios[0]:25.3f} {ratios[1]:7.3f}", flush=True)


def exact(seed: int) -> None:
    """Whether exact rows give back the machine."""
    print(f"{'kind':20} {'rows never fitted':>18} {'target':>12}")
    for way in WAYS:
        keys, robot = scenario(way, "six", seed, rows_of(way))
        one = made(keys, robot)
        found = geometric(one)
        new = elsewhere(one, rows_of(way))
        left = problem(found.model, new.rows).residual(found.theta)
        unit = one.rows.channels[0].unit
        print(f"{way:20} {np.abs(left).max():15.1e} {unit:3} {_misplaced(one, new, found):10.1e} m", flush=True)


def _misplaced(one: Made, new: Made, found: Fit) -> float:
    """How far targets are from the true ones after the best similarity, [m]; NaN where the target is not a place."""
    if one.campaign.measurements.kind in ("pixels", "inclination"):
        return float("nan")
    truth = one.simulation
    path = truth.scenario.path
    frames = ((None, truth.frames["world_base"]),), ((None, truth.frames["tip_target"]),)
    real = Model(one.robot, named_constants(one.robot, truth.parameters, path), *frames)
    _, p = real.poses(np.array([*truth.parameters.values()]), real.rows(new.rows.readings))
    _, q = found.model.poses(found.theta, found.model.rows(new.rows.readings))
    return similarity(q, p)


def similarity(q: np.ndarray, p: np.ndarray) -> float:
    """Largest distance that is left of points after the best motion and scale (Umeyama 1991), [m]."""
    a, b = q - q.mean(axis=0), p - p.mean(axis=0)
    U, s, Vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ np.diag(sign) @ Vt
    return float(np.linalg.norm(b - (s * sign).sum() / np.sum(a**2) * a @ R.T, axis=1).max())


THEORY = {
    "pose": (6, 6, "nothing"),
    "position": (6, 3, "the target's rotation"),
    "point": (0, 2, "the base's place, the target's rotation, scale"),
    "point and length": (0, 3, "the base's place, the target's rotation"),
    "distance": (0, 3, "the base's place, the target's rotation"),
    "plane": (0, 2, "the base's place, the target's rotation, scale"),
    "eye in hand": (0, 5, "the base's place, scale"),
    "eye in hand, board": (0, 6, "the base's place (the board's is its own)"),
    "eye to hand": (0, -1, "the base's place, the mounting (each marker has its own), scale"),
    "eye to hand, board": (0, 6, "the base's place (the camera's is its own)"),
    "inclination": (None, 3, "all lengths, turns about the vertical"),
}
"""What a kind tells beside the 4 N of N revolute axes that are nowhere parallel (Everett and Hollerbach 1988: 4 N + 6 with both
frames): of the base, of the target, and what it loses. Angles alone are 2 N + 3 less the turn about the vertical."""


def theory(way: str, joints: int) -> int:
    """Numbers that a kind tells of an arm of revolute joints with its frames and its mounting."""
    base, target, _ = THEORY[way]
    if base is None:  # R_0 Rz R_1 ... Rz R_N: three angles each, one of them along the next axis, less the vertical
        return 2 * joints + 3 - 1
    return 4 * joints - 6 + base + target


def ranks(seed: int) -> None:
    """How many numbers each kind tells, frames and mounting included, against the rows (images)."""
    counts = (10, 20, 40, 80)
    print(f"{'kind':20} {'arm':6} " + " ".join(f"{n:>5}" for n in counts) + f" {'theory':>7}  loses")
    for way in WAYS:
        for family in ARMS:
            told = []
            for n in counts:
                keys, robot = scenario(way, family, seed, n)
                try:
                    one = made(noisy(keys), robot)
                    model = geometric(one).model
                    boards = {
                        name for r in ("board",) if r in one.simulation.real for name in one.simulation.real[r].names
                    }
                    cameras = set(one.campaign.instruments.cameras)
                    # one of camera and board is the mounting on the tip, the other is where it looks
                    far = {c for c in cameras if one.campaign.instruments.cameras[c].on == "world"} | {
                        b for b in boards if b.endswith("world")
                    }
                    told.append(f"{sum(c.where not in far for c in model.coefficients):5}")
                except (AridcalError, np.linalg.LinAlgError) as fault:
                    told.append("    -")
                    print(f"  {way} {family} {n}: {type(fault).__name__}: {str(fault)[:150]}")
            expected = "" if family == "arid" else theory(way, {"six": 6, "seven": 7}[family])
            print(f"{way:20} {family:6} {' '.join(told)} {expected:>7}  {THEORY[way][2]}", flush=True)


COUNTS = (20, 40, 80, 160)


def counts(kind: str | None, runs: int, seed: int) -> None:
    """How many rows (images) make the calibration as good as the instrument: error of its prediction elsewhere."""
    print(
        f"{'kind':20} " + " ".join(f"{n:>6}" for n in COUNTS) + "  median error elsewhere over the instrument's noise"
    )
    for way in [kind] if kind else WAYS:
        line, said = [], []
        for n in COUNTS:
            errors = []
            for k in range(runs):
                keys, robot = scenario(way, "six", seed * 1000 + k, n)
                try:
                    one = made(noisy(keys), robot)
                    errors.append(error_of(geometric(one), elsewhere(one, QUERIES)))
                except (AridcalError, np.linalg.LinAlgError) as fault:
                    said.append(f"  {way} {n} {k}: {type(fault).__name__}: {str(fault)[:160]}")
            line.append(f"{np.median(errors):6.2f}" if errors else "     -")
        print(f"{way:20} {' '.join(line)}", flush=True)
        print("\n".join(said[:5]), end="\n" if said else "")


def starts(kind: str | None, runs: int, seed: int) -> None:
    """Whether fits end in one optimum, however tool, world and camera are turned."""
    print(f"{'kind':20} {'runs':>5} {'in the optimum':>15} {'restarts agreed':>16} {'seconds':>8}")
    for way in [kind] if kind else WAYS:
        good, agreed, tried, took, said = 0, 0, 0, 0.0, []
        for k in range(runs):
            number = seed * 1000 + k
            keys, robot = scenario(way, "six", number, rows_of(way), attitude=True)
            try:
                one = made(noisy(keys), robot)
                started = time.process_time()
                found = geometric(one)
                took += time.process_time() - started
            except (AridcalError, np.linalg.LinAlgError) as fault:
                said.append(f"  {way} {number}: {type(fault).__name__}: {str(fault)[:160]}")
                continue
            there = bool((found.estimated < 1.3 * one.sigma).all())
            good += there
            agreed += found.convergence.agreed
            tried += found.convergence.restarts
            if not there:
                said.append(f"  {way} {number}: {found.estimated / one.sigma} sigma are left")
        print(f"{way:20} {runs:5} {good:15} {agreed:8} of {tried:4} {took / max(runs, 1):8.2f}", flush=True)
        print("\n".join(said[:5]), end="\n" if said else "")


def together(runs: int, rows: int, seed: int) -> None:
    """Whether three reflectors on one tool tell more than each alone."""
    tips = {"a": {"xyz": [0.1, 0.0, 0.1]}, "b": {"xyz": [-0.05, 0.09, 0.1]}, "c": {"xyz": [-0.05, -0.09, 0.25]}}
    errors: dict[str, list[float]] = {name: [] for name in (*tips, "together")}
    for k in range(runs):
        keys, robot = scenario("position", "six", seed * 1000 + k, rows)
        frames = keys["truth"]["frames"]
        for name in errors:
            own = tips if name == "together" else {name: tips[name]}
            n = rows * len(own)
            told = {**keys, "truth": {**keys["truth"], "n": n, "frames": {**frames, "targets": own}}}
            one, without = made(noisy(told), robot), made(told, robot)
            found = geometric(one)
            true = fit(problem(found.model, without.train), found.theta)
            q, off = draw_readings(robot, QUERIES, np.random.default_rng(k)), []
            for label in own:
                target = None if one.rows.labels.target is None else np.full(QUERIES, label)
                at = found.model.rows(q, None, None, target)
                off.append(found.model.poses(found.theta, at)[1] - found.model.poses(true.theta, at)[1])
            errors[name].append(float(np.sqrt(np.mean(np.sum(np.array(off) ** 2, axis=2)))))
    for name, each in errors.items():
        print(f"{name:10} {1e6 * np.sqrt(np.mean(np.square(each))):8.2f} um RMS of the predicted target")
    alone = np.sqrt(np.mean([np.square(errors[name]) for name in tips]))
    print(
        f"alone over together: {alone / np.sqrt(np.mean(np.square(errors['together']))):.2f} (the arm's own: sqrt(3) = 1.73)"
    )


def speed(rows: int, images: int, seed: int) -> None:
    """Seconds of CPU for the constants, and memory."""
    for way in ("point", "distance"):
        keys, robot = scenario(way, "six", seed, rows)
        one = made(noisy(keys), robot)
        started = time.process_time()
        geometric(one)
        print(f"{way}: {len(one.rows)} rows, geometric {time.process_time() - started:.2f} s CPU (1.5)", flush=True)
    keys, robot = scenario("eye in hand", "six", seed, images)
    keys["truth"]["instruments"]["markers"] = 500
    one = made(noisy(keys), robot)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    geometric(one)
    took, most = time.process_time() - started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(
        f"pixels: {len(one.rows)} rows of 500 unknown markers, geometric {took:.1f} s CPU (10); "
        f"peak {most / 2**20:.2f} GB (1), {before / 2**20:.2f} GB before"
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "name", choices=("coverage", "exact", "ranks", "counts", "starts", "causes", "blind", "together", "speed")
    )
    parser.add_argument("--kind", choices=tuple(WAYS))
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--rows", type=int, default=0)
    parser.add_argument("--images", type=int, default=250)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(argv)
    work: dict[str, Callable[[], None]] = {
        "coverage": lambda: coverage(asked.kind, asked.runs, asked.seed),
        "exact": lambda: exact(asked.seed),
        "ranks": lambda: ranks(asked.seed),
        "counts": lambda: counts(asked.kind, asked.runs, asked.seed),
        "starts": lambda: starts(asked.kind, asked.runs, asked.seed),
        "causes": lambda: causes(asked.kind, asked.runs, asked.rows, asked.seed),
        "blind": lambda: blind(asked.kind, asked.cases, asked.seed),
        "together": lambda: together(asked.runs, asked.rows or 1000, asked.seed),
        "speed": lambda: speed(asked.rows or 10_000, asked.images, asked.seed),
    }
    work[asked.name]()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
