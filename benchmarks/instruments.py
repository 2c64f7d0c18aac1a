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
from dataclasses import replace
from typing import Any

import numpy as np
from instrument_cases import ARMS, WAYS, Made, elsewhere, made, noisy, scenario

from aridcal.effects.effect import Effect
from aridcal.errors import AridcalError
from aridcal.fit.least_squares import Fit, fit
from aridcal.fit.problem import problem
from aridcal.fit.stages import fit_geometry
from aridcal.instruments.channels import spread
from aridcal.model.model import Model
from aridcal.model.reaching import draw_readings
from aridcal.prepare.simulation import named_constants
from aridcal.search.arm import calibrated_arm, fit_constants
from aridcal.search.noise_causes import noise_causes
from aridcal.showing import SILENT

ROWS = 120
IMAGES = 30
QUERIES = 100
PLACES = ("world_base", "tip_target")


def rows_of(way: str) -> int:
    """Rows of an ordinary campaign, or images."""
    return IMAGES if WAYS[way][0] == "pixels" else ROWS


def geometric(one: Made) -> Fit:
    """Constants of the training rows."""
    return fit_geometry(one.campaign, one.robot, one.train, ()).geometric


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
            target = None if with_noise.rows.target is None else np.full(QUERIES, with_noise.rows.target[0])
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
                    errors.append(_error(geometric(one), elsewhere(one, QUERIES)))
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


BLIND = ("point", "distance", "plane", "eye in hand")
KINDS = (
    "joint_gain",
    "joint_harmonic",
    "joint_backlash",
    "joint_compliance",
    "axis_wobble",
    "joint_coupling",
    "thermal",
)
SIZES = (3.0, 40.0)
"""Of an effect: RMS per number in sigma, after projection off constants, frames and things."""

SMALL = 1e-4
"""[rad] or [m]: of an effect whose size is measured."""


def causes(kind: str | None, runs: int, rows: int, seed: int) -> None:
    """Whether clean rows name no cause, and rounded joints theirs with its size."""
    step = np.radians(0.1)
    print(
        f"{'kind':20} {'runs':>4} {'clean: named':>12} {'rounded: named':>14} {'all joints':>10} {'their size / true':>18}"
    )
    for way in [kind] if kind else WAYS:
        done, clean, named, sizes = 0, 0, 0, []
        for k in range(runs):
            keys, robot = scenario(way, "six", seed * 1000 + k, rows or 2 * rows_of(way))
            try:
                one = made(noisy(keys), robot)
            except AridcalError as fault:
                print(f"  {way} {k}: {fault}")
                continue
            done += 1
            coarse = replace(one.rows, readings=np.round(one.rows.readings / step) * step)
            for data in (one.rows, coarse):
                geometry = fit_constants(one.campaign, robot, data, ())
                found = noise_causes(geometry.geometric, (), data)
                further = () if found is None else found.further
                clean, named = clean + bool(further and data is one.rows), named + bool(further and data is coarse)
                if data is coarse and len(further) == len(robot.readings):
                    sizes.append(min(c.value for c in further) * np.sqrt(12.0) / step)
        ends = f"{min(sizes, default=np.nan):.2f} to {max(sizes, default=np.nan):.2f}"
        print(f"{way:20} {done:4} {clean:12} {named:14} {len(sizes):10} {ends:>18}", flush=True)


def draw_effect(joints: Sequence[str], load: dict[str, float], rng: np.random.Generator) -> dict[str, Any]:
    """An effect as a scenario has it, its coefficients of natural proportions and not yet of its size."""
    name, where = str(rng.choice(KINDS)), str(rng.choice(list(joints)))
    keys: dict[str, Any] = {"kind": name, "where": where}
    if name == "joint_harmonic":
        keys["order"] = [int(rng.integers(1, 5))]
    elif name == "axis_wobble":
        keys |= {"order": [int(rng.integers(1, 3))], "motion": [str(rng.choice(["r1", "r2"]))]}
    elif name == "joint_coupling":
        keys["with"] = str(rng.choice([other for other in joints if other != where]))
    elif name == "joint_backlash":
        keys["by"] = "load"
    elif name == "thermal":
        keys["motion"] = [str(rng.choice(["x", "y", "z"]))]
    count = {"joint_harmonic": 2, "axis_wobble": 2}.get(name, 1)
    per = load[where] if name == "joint_compliance" else 6.0 if name == "thermal" else 1.0
    return keys | {"coefficients": (SMALL / per * rng.standard_normal(count)).tolist() if count > 1 else [SMALL / per]}


def blind(kind: str | None, cases: int, seed: int) -> None:
    """What a search names of one undeclared effect, and what it invents where there is none."""
    for way in [kind] if kind else BLIND:
        named, alike, invented, ratios, false, took, done = 0, 0, 0, [], 0, 0.0, 0
        for k in range(cases):
            number = seed * 10_000 + k
            rng = np.random.default_rng([number, 13])
            n = 2 * rows_of(way)
            keys, robot = scenario(way, "six", number, n)
            try:
                clean, started = made(noisy(keys), robot), time.process_time()
                arm = _searched(clean)
                took += time.process_time() - started
                said = arm.diagnosed.found.state.active
                false += bool(said)
                if said:
                    print(f"  {way} {number} clean -> {', '.join(sorted({_said(a.effect) for a in said}))}")
                one, effect = _with_effect(way, number, n, rng)
                arm = _searched(one)
            except Exception as fault:  # a crash is a result, and must not end the others
                print(f"  {way} {number} failed: {type(fault).__name__}: {str(fault)[:160]}")
                continue
            done += 1
            found = {a.effect for a in arm.diagnosed.found.state.active}
            places = {(e.kind, e.where) for e in found}
            twins = {(t.kind, t.where) for others in arm.diagnosed.confounded for t in others}
            right = (effect["kind"], effect["where"]) in places | twins
            invented += len(places) - bool(right and places)
            new = elsewhere(one, QUERIES)
            errors = [_error(f, new) for f in (arm.geometry.geometric, arm.diagnosed.fit, _oracle(one, effect))]
            named += right
            alike += right or errors[1] < 1.2 * errors[2]
            ratios.append(errors[1] / errors[2])
            if not right:
                print(f"  {way} {number} {effect['kind']} at {effect['where']} -> {sorted(places)}; error {errors}")
        if done:
            p = np.percentile(ratios, [50, 95])
            print(
                f"{way}: named right {named}/{done}, right or as good as the oracle {alike}/{done}, invented beside {invented}; "
                f"clean with an effect {false}/{cases}; error over the oracle's: median {p[0]:.2f}, 95 % {p[1]:.2f}; "
                f"{took / cases:.1f} s a search", flush=True
            )  # fmt: skip


def _said(effect: Effect) -> str:
    return f"{effect.kind} at {effect.where}"


def _searched(one: Made) -> Any:
    """Do what ``aridcal identify`` does: constants and search."""
    geometry = fit_constants(one.campaign, one.robot, one.rows, ())
    return calibrated_arm(one.campaign, one.robot, one.rows, (), geometry, SILENT)


def _with_effect(way: str, seed: int, n: int, rng: np.random.Generator) -> tuple[Made, dict[str, Any]]:
    """A campaign with one effect that leaves a residual of a size that is drawn, in sigma."""
    keys, robot = scenario(way, "six", seed, n)
    while True:
        effect = draw_effect(robot.names, {name: 50.0 / (k + 1) for k, name in enumerate(robot.names)}, rng)
        keys, _ = scenario(way, "six", seed, n, [effect])
        try:
            one = made(keys, robot)
        except AridcalError:
            continue
        left = geometric(one).residual / spread(one.sigma, one.rows.channels)
        size = float(np.sqrt(np.mean(left**2)))
        wanted = float(np.exp(rng.uniform(*np.log(SIZES))))
        coefficients = np.array(effect["coefficients"]) * wanted / max(size, 1e-300)
        if wanted / max(size, 1e-300) * SMALL < 0.01:  # nor larger than 10 mrad
            effect["coefficients"] = coefficients.tolist()
            keys, _ = scenario(way, "six", seed, n, [effect])
            return made(noisy(keys), robot), effect


def _oracle(one: Made, effect: dict[str, Any]) -> Fit:
    """The fit of one who knows what is wrong, and looks for nothing else."""
    declared = {name: value for name, value in effect.items() if name != "coefficients"}
    keys = one.campaign.model_dump(by_alias=True, exclude_unset=True)
    keys |= {"effects": [declared], "diagnosis": {"enabled": False}}
    told = one.campaign.model_copy(
        update={name: getattr(type(one.campaign).model_validate(keys), name) for name in ("effects", "diagnosis")}
    )
    geometry = fit_constants(told, one.robot, one.rows, ())
    found: Fit = calibrated_arm(told, one.robot, one.rows, (), geometry, SILENT).diagnosed.fit
    return found


def _error(found: Fit, new: Made) -> float:
    """RMS per number on exact rows that were never measured, in sigma."""
    off = problem(found.model, new.rows).residual(found.theta) / spread(new.sigma, new.rows.channels)
    return float(np.sqrt(np.nanmean(off**2)))


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
                target = None if one.rows.target is None else np.full(QUERIES, label)
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
