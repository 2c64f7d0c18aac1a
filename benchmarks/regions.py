"""Calibration by region: constants that vary along a rail or by station, and one calibration square that is off.

    python benchmarks/regions.py                  # all, some minutes
    python benchmarks/regions.py rail --cases 10  # ARID, beta and alpha of three links varying along the rail by 1 mrad RMS
    python benchmarks/regions.py square           # three strips of 28 squares; around one of them the targets are 0.5 mm off
    python benchmarks/regions.py station          # eight stations, each with zeros of two joints of its own, 1 mrad RMS
    python benchmarks/regions.py few              # the same; one station has three rows
    python benchmarks/regions.py lone             # twenty stations, at one of which the targets are 0.5 mm off

Each case is an ARID with constants that are 2 mm and 2 mrad off, measured by a tracker of 0.1 mm and 0.1 mrad. Models are
fitted to the training rows and judged at others: `measured` by what the tracker says of them, `true` by where the targets really
are. The oracle knows the true functions and fits their sizes. `asked` is `diagnosis: {candidates: [all, regional,
residual_field]}`, `declared` names the effects, and `one model` has neither. Clean cases are the same arms without the variation:
what do the two cost there? `station` has labels in the clean cases, too.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from accuracy import ARID_FRAMES, NOISE, WRONG, arid, campaign_of, truth_of
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import Fit, fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.search.loop import CalibratedArm, calibrated_arm, fit_constants
from aridcal.files.campaign import Campaign
from aridcal.system.progress import SILENT

TRAIN, JUDGED = 200, 1000  # rows along the rail
VARIES = 1e-3  # RMS along the rail, [rad]
BENDS = 3  # half waves over the rail, at the most
STRIPS, SQUARES, VIEWS, HELD_OUT = (3.0, 3.5, 4.0), 28, 4, 4  # [m] along the rail; of a strip; rows at each square
OFF, REACH = 5e-4, 0.12  # how far targets are off around a square, and how far around it (one sigma), [m]
LINKS: list[dict[str, object]] = [
    {"kind": "regional", "where": f"joint_{k}", "motion": ("beta", "alpha"), "by": "joint_1"} for k in (1, 2, 3)
]
STATIONS, FEW, MANY = 8, 3, 20  # labels; rows of one that has few; labels of which one is off
SHIFTS: list[dict[str, object]] = [{"kind": "regional", "where": "world_base", "by": "station"}]
ZEROS: list[dict[str, object]] = [
    {"kind": "regional", "where": f"joint_{k}", "motion": ("axis",), "by": "station"} for k in (2, 3)
]
FIELD: list[dict[str, object]] = [{"kind": "residual_field", "where": "world_base"}]
ASKED = ("all", "regional", "residual_field")


@dataclass(frozen=True)
class Case:
    """Rows with their truth.

    Attributes:
        robot: The nominal arm.
        rows: Those to fit, and as ``test`` those to judge by.
        true: Where the targets are, shape (N, 3), [m].
        judged: Rows to judge by, shape (N,) bool.
        known: Coefficients of the true functions, for the oracle.
        columns: Their values, shape (N,) each.
    """

    robot: Robot
    rows: Dataset
    true: np.ndarray
    judged: np.ndarray
    known: tuple[Coefficient, ...]
    columns: dict[str, np.ndarray]


def wavy(q: np.ndarray, travel: float, rng: np.random.Generator) -> np.ndarray:
    """A smooth function of the rail's place, of mean 0 and RMS 1 along the rail, at places q."""
    parts = [(k, *rng.standard_normal(2)) for k in range(1, BENDS + 1)]

    def value(u: np.ndarray) -> np.ndarray:
        return sum((a * np.sin(np.pi * k * u) + b * np.cos(np.pi * k * u) for k, a, b in parts), np.zeros(len(u)))

    along = value(np.linspace(0.0, 1.0, 400))
    return (value(q / travel) - along.mean()) / along.std()


def rail(seed: int, varies: bool) -> Case:
    """Configurations drawn evenly."""
    rng = np.random.default_rng([seed, 1])
    robot = arid()
    low, high = robot.limits.T
    q = rng.uniform(low, high, (TRAIN + JUDGED, len(low)))
    tilts = [(joint.name, c) for joint in robot.joints[:3] for c in ("beta", "alpha")]
    columns = {f"wave_{k}": VARIES * wavy(q[:, 0], high[0], rng) for k in range(len(tilts))}
    known = tuple(
        Coefficient(*tilt, Basis("linear", (name,), (0.0,))) for tilt, name in zip(tilts, columns, strict=True)
    )
    truth = truth_of(robot, "doty", ARID_FRAMES)
    theta = np.concatenate([WRONG * rng.standard_normal(len(truth.coefficients)), np.full(len(known), float(varies))])
    whole = truth.with_coefficients((*truth.coefficients, *known))
    R, p = whole.poses(theta, whole.rows(q, columns))
    test = np.arange(len(q)) >= TRAIN
    return Case(robot, measured(robot, q, R, p, test, rng), p, test, known, columns)


def square(seed: int, varies: bool) -> Case:
    """Views of each square of three strips; around the fourteenth of the second strip the targets are off."""
    rng = np.random.default_rng([seed, 2])
    robot = arid()
    views = VIEWS + HELD_OUT
    strip, number, view = (a.ravel() for a in np.mgrid[: len(STRIPS), :SQUARES, :views])
    postures = np.column_stack([
        np.array(STRIPS)[strip], np.radians(np.linspace(20.0, 100.0, SQUARES))[number],
        np.full(len(view), np.radians(120.0)), np.full(len(view), np.radians(-60.0)),
    ])  # fmt: skip
    q = postures + np.array([0.04, 0.012, 0.03, 0.07]) * rng.uniform(-1.0, 1.0, postures.shape)
    truth = truth_of(robot, "doty", ARID_FRAMES)
    theta = WRONG * rng.standard_normal(len(truth.coefficients))
    R, p = truth.poses(theta, truth.rows(q))
    there = (strip == 1) & (number == SQUARES // 2 - 1)
    distance = np.linalg.norm(p - p[there].mean(axis=0), axis=1)
    dent = np.exp(-0.5 * (distance / REACH) ** 2)
    away = rng.standard_normal(3)
    p = p + float(varies) * OFF * dent[:, None] * away / np.linalg.norm(away)
    known = tuple(Coefficient("world_base", c, Basis("linear", ("dent",), (0.0,))) for c in ("x", "y", "z"))
    test = view >= VIEWS
    return Case(robot, measured(robot, q, R, p, test, rng), p, test & (distance < 1.5 * REACH), known, {"dent": dent})


def station(seed: int, varies: bool, few: bool = False) -> Case:
    """Rows at eight stations, or what a user calls so; two joints' zeros differ from one to the next."""
    rng = np.random.default_rng([seed, 3])
    robot = arid()
    low, high = robot.limits.T
    q = rng.uniform(low, high, (TRAIN + JUDGED, len(low)))
    label = rng.integers(0, STATIONS, len(q))
    if few:
        own = np.flatnonzero(label[:TRAIN] == 0)
        label[own[FEW:]] = 1
    zeros = VARIES * rng.standard_normal((STATIONS, 2))
    columns = {f"zero_{k}": values[label] for k, values in enumerate((zeros - zeros.mean(axis=0)).T)}
    known = tuple(
        Coefficient(f"joint_{k}", "axis", Basis("linear", (name,), (0.0,)))
        for k, name in zip((2, 3), columns, strict=True)
    )
    truth = truth_of(robot, "doty", ARID_FRAMES)
    theta = np.concatenate([WRONG * rng.standard_normal(len(truth.coefficients)), np.full(len(known), float(varies))])
    whole = truth.with_coefficients((*truth.coefficients, *known))
    R, p = whole.poses(theta, whole.rows(q, columns))
    test = np.arange(len(q)) >= TRAIN
    rows = measured(robot, q, R, p, test, rng).with_labels(station=np.array([f"s{k}" for k in label]))
    return Case(robot, rows, p, test & (label == 0) if few else test, known, columns)


def lone(seed: int, varies: bool) -> Case:
    """At one of twenty stations the targets are off; what is judged is that station."""
    rng = np.random.default_rng([seed, 4])
    robot = arid()
    low, high = robot.limits.T
    q = rng.uniform(low, high, (TRAIN + JUDGED, len(low)))
    label = rng.integers(0, MANY, len(q))
    columns = {"there": (label == 0).astype(float)}
    known = tuple(Coefficient("world_base", c, Basis("linear", ("there",), (0.0,))) for c in ("x", "y", "z"))
    away = rng.standard_normal(3)
    truth = truth_of(robot, "doty", ARID_FRAMES)
    theta = WRONG * rng.standard_normal(len(truth.coefficients))
    R, p = truth.poses(theta, truth.rows(q))
    p = p + float(varies) * OFF * columns["there"][:, None] * away / np.linalg.norm(away)
    test = np.arange(len(q)) >= TRAIN
    rows = measured(robot, q, R, p, test, rng).with_labels(station=np.array([f"s{k}" for k in label]))
    return Case(robot, rows, p, test & (label == 0), known, columns)


def few(seed: int, varies: bool) -> Case:
    """One station has three rows; what is judged is that station."""
    return station(seed, varies, True)


def measured(
    robot: Robot, q: np.ndarray, R: np.ndarray, p: np.ndarray, test: np.ndarray, rng: np.random.Generator
) -> Dataset:
    """What the tracker says of poses."""
    error = NOISE * rng.standard_normal((len(q), 6))
    turned = (Rotation.from_rotvec(error[:, 3:]) * Rotation.from_matrix(R)).as_matrix()
    return dataset(robot.readings, robot.kinds, q, p + error[:, :3], turned, sigma=(NOISE, NOISE), test=test)


def campaign(robot: Robot, effects: list[dict[str, object]], candidates: tuple[str, ...]) -> Campaign:
    """That of `benchmarks/accuracy.py`, with effects."""
    keys = campaign_of(robot, "doty").model_dump(by_alias=True, include={"format", "robot", "parameters"})
    keys["measurements"] = {"file": ("rows.csv",), "kind": "pose"}
    keys["diagnosis"] = {"enabled": bool(candidates), "candidates": candidates or ("all",)}
    return Campaign.model_validate(keys | {"effects": tuple(effects)})


def calibrated(case: Case, effects: list[dict[str, object]], candidates: tuple[str, ...]) -> CalibratedArm:
    """As `identify` does it."""
    asked = campaign(case.robot, effects, candidates)
    geometry = fit_constants(asked.question, case.robot, case.rows, ())
    return calibrated_arm(asked.question, case.robot, case.rows, (), geometry, SILENT)


def oracle(case: Case, one: Fit) -> Fit:
    """The one model and the true functions, whose sizes alone are unknown; what can be identified beside them."""
    model = one.model.with_coefficients((*one.candidates, *case.known))
    every = replace(case.rows, covariates=case.columns)
    return fit_identifiable(problem(model, every.select(every.train)), range(len(model.coefficients)))


def errors(case: Case, found: Fit) -> tuple[float, float]:
    """RMS over the rows that judge: of what the tracker says, and of the truth, [mm]."""
    rows = case.rows.select(case.judged)
    columns = {name: values[case.judged] for name, values in case.columns.items()}
    places = found.model.poses(found.theta, found.model.rows(rows.readings, columns, rows.labels.station))[1]
    every = places - rows.position, places - case.true[case.judged]
    return tuple(1e3 * float(np.sqrt(np.mean(np.sum(e**2, axis=1)))) for e in every)  # type: ignore[return-value]


def run(make: Callable[[int, bool], Case], declared: list[dict[str, object]], cases: int) -> None:
    """Print a table."""
    ways = {"one model": ([], ()), "declared": (declared, ()), "asked": ([], ASKED)}
    print(
        f"{make.__name__}: {cases} cases, medians; ratios are of each case to its oracle, clean ones to the one model"
    )
    for varies in (True, False):
        told: dict[str, list[tuple[float, float]]] = {name: [] for name in ("oracle", *ways)}
        found: dict[str, int] = dict.fromkeys(ways, 0)
        seconds: dict[str, list[float]] = {name: [] for name in ways}
        for seed in range(cases):
            case = make(seed, varies)
            for name, (effects, candidates) in ways.items():
                started = time.process_time()
                arm = calibrated(case, effects, candidates)
                seconds[name].append(time.process_time() - started)
                told[name].append(errors(case, arm.diagnosed.fit))
                found[name] += bool(arm.diagnosed.stepwise.state.active)
                if name == "one model":
                    told["oracle"].append(errors(case, oracle(case, arm.geometry.geometric)))
        unit = np.array(told["oracle" if varies else "one model"])
        print("varies" if varies else "clean")
        print(
            "             measured, mm   true, mm   measured/it: median, largest   true/it: median, largest   with effects  CPU s"
        )
        for name, values in told.items():
            ratio = np.array(values) / unit
            middle, worst, typical = np.median(ratio, axis=0), ratio.max(axis=0), np.median(values, axis=0)
            tail = f"{found[name]:>8} of {cases} {np.median(seconds[name]):8.1f}" if name in ways else ""
            print(
                f"  {name:<10} {typical[0]:10.4f} {typical[1]:12.4f} {middle[0]:16.3f} {worst[0]:10.3f} {middle[1]:18.3f} "
                f"{worst[1]:8.3f} {tail}",
                flush=True,
            )


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", metavar="NAME", help="rail, square, station, few, lone; default: all")
    parser.add_argument("--cases", type=int, default=10)
    arguments = parser.parse_args()
    parts = {
        "rail": (rail, LINKS), "square": (square, FIELD), "station": (station, ZEROS), "few": (few, ZEROS),
        "lone": (lone, SHIFTS),
    }  # fmt: skip
    for name in arguments.what or parts:
        if name not in parts:
            parser.error(f"no part {name!r}: choose from {', '.join(parts)}")
        run(*parts[name], arguments.cases)
    return 0


if __name__ == "__main__":
    sys.exit(main())
