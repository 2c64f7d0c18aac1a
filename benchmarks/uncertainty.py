"""Is the target as uncertain as a calibration says: predicted sigma against the scatter of many simulated calibrations.

Example:
    PYTHONPATH=.:tests/support python benchmarks/uncertainty.py sigma declared
    PYTHONPATH=.:tests/support python benchmarks/uncertainty.py sigma found --runs 60

A UR10 with constants 1 mm and 1 mrad off, drawn anew in each run like its frames, its effects and the noise of 0.1 mm and
0.1 mrad, is calibrated from rows of six tenths of its joints' ranges. At 100 configurations inside these ranges, and at 100
outside, the RMS over the runs of the sigma that was predicted is divided by that of the true error. Outside it is told how many
errors are within two sigma, or marked as extrapolated. ``kinds`` does so for every kind of measurement,
its things drawn anew in each run, so that errors count in sigmas of their own run. ``tolerance`` tells how often what 95 % of the
measured range are said to be within is too little, and ``real`` what rows of a
real UR10 say to it (needs ``../shared/data``).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import robots
from instrument_cases import TOP, WAYS, made, noisy, rows_of, scenario
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants, station_labels
from aridcal.engine.fit.least_squares import fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import recentred
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import Model
from aridcal.engine.rows.dataset import Dataset, with_sigma
from aridcal.engine.search.loop import calibrated_arm, fit_constants
from aridcal.engine.trust.certainty import certainty
from aridcal.engine.trust.uncertainty import with_contradicted_noise
from aridcal.engine.trust.workspace import knowledge
from aridcal.files.campaign import load_campaign
from aridcal.jobs.calibrate.pipeline import identify, score
from aridcal.jobs.calibrate.tolerance_region import requirement
from aridcal.system.errors import AridcalError
from aridcal.system.progress import SILENT

NOISE = 1e-4
"""[m] and [rad]."""

INSIDE = 0.6
"""Share of each joint's range that is measured."""

QUERIES = 100

WITHIN = 8.02
"""Of chi square with three degrees of freedom: as rare as two sigma of one number, 4.6 %."""

Effects = tuple[tuple[Coefficient, float], ...]


@dataclass(frozen=True)
class Case:
    """How machines are made and calibrated.

    Attributes:
        kind: ``pose`` or ``position``.
        rows: How many.
        effects: Draws the true ones.
        sections: Of the campaign.
        stations: At which rows are measured.
    """

    kind: str = "pose"
    rows: int = 100
    effects: Callable[[np.random.Generator], Effects] = lambda rng: ()
    sections: tuple[tuple[str, object], ...] = (("diagnosis", {"enabled": False}),)
    stations: int = 1


def harmonics(rng: np.random.Generator) -> Effects:
    """Of two joints."""
    return tuple(
        (Coefficient(where, "axis", Basis(form, (where,), (1.0,))), float(rng.normal(0.0, 5e-4)))
        for where in ("shoulder_lift_joint", "elbow_joint")
        for form in ("sin", "cos")
    )


def curve(rng: np.random.Generator) -> Effects:
    """An error curve of one joint: waves of up to eight periods, their sizes falling with the square of their number."""
    where = "elbow_joint"
    return tuple(
        (Coefficient(where, "axis", Basis(form, (where,), (float(k),))), float(rng.normal(0.0, 1e-3 / k**2)))
        for k in range(1, 9)
        for form in ("sin", "cos")
    )


DECLARED = (
    "effects",
    [{"kind": "joint_harmonic", "where": w, "order": 1} for w in ("shoulder_lift_joint", "elbow_joint")],
)
MAP = ("effects", [{"kind": "joint_map", "where": "elbow_joint"}])
QUIET = ("diagnosis", {"enabled": False})
FRAMES = ("frames", {"world_base": {"per": "station"}})
CASES = {
    "constants": Case(),
    "positions": Case("position"),
    "few positions": Case("position", 40),
    "declared": Case(effects=harmonics, sections=(QUIET, DECLARED)),
    "found": Case(effects=harmonics, sections=()),
    "map declared": Case(rows=200, effects=curve, sections=(QUIET, MAP)),
    "map found": Case(rows=200, effects=curve, sections=()),
    "stations": Case(stations=3, sections=(QUIET, FRAMES)),
}


@dataclass(frozen=True)
class Machine:
    """A robot as it is."""

    model: Model
    theta: np.ndarray


def machine(case: Case, rng: np.random.Generator) -> Machine:
    """Draw one."""
    robot = robots.ur10()
    own, effects = constants(robot, "full"), case.effects(rng)
    labels = [None] if case.stations == 1 else [f"s{k}" for k in range(case.stations)]
    world = tuple((label, robots.random_placement(rng)) for label in labels)
    model = Model(robot, (*own, *(c for c, _ in effects)), world, ((None, robots.random_placement(rng, 0.2)),))
    return Machine(model, np.concatenate([rng.normal(0.0, 1e-3, len(own)), [value for _, value in effects]]))


def measure(case: Case, made: Machine, rng: np.random.Generator, jitter: float | None = None) -> Dataset:
    """Rows with noise, which is declared; the joints stand beside their readings by a jitter, [rad], if there is one."""
    q = robots.readings(made.model.robot, case.rows, rng, INSIDE)
    station = None
    if case.stations > 1:
        station = np.array([f"s{k % case.stations}" for k in range(case.rows)])
    real = q if jitter is None else q + jitter * rng.normal(size=q.shape)
    R, p = made.model.poses(made.theta, made.model.rows(real, None, station))
    p = p + NOISE * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(NOISE * rng.normal(size=p.shape)).as_matrix() @ R
    rows = robots.measured(made.model.robot, q, p, R if case.kind == "pose" else None)
    return replace(robots.declared(rows, NOISE, NOISE), station=station)


def queries() -> tuple[np.ndarray, np.ndarray]:
    """Configurations, those inside first, and which of them are inside."""
    rng, robot = np.random.default_rng(99), robots.ur10()
    inside = robots.readings(robot, QUERIES, rng, INSIDE)
    every = robots.readings(robot, 4 * QUERIES, rng)
    low, high = inside.min(axis=0), inside.max(axis=0)
    outside = every[((every < low) | (every > high)).any(axis=1)][:QUERIES]
    return np.vstack([inside, outside]), np.arange(2 * QUERIES) < QUERIES


def sigma(name: str, runs: int, seed: int) -> None:
    """Predicted sigma against scatter."""
    case, (q, inside) = CASES[name], queries()
    campaign = robots.campaign(case.kind, **dict(case.sections))
    squares, variance, covered, alone, beyond, untold = np.zeros((6, len(q)))
    started = time.process_time()
    effects: dict[int, int] = {}
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        made = machine(case, rng)
        rows = measure(case, made, rng)
        labels = station_labels(campaign.question, rows)
        geometry = fit_constants(campaign.question, made.model.robot, rows, labels)
        arm = calibrated_arm(campaign.question, made.model.robot, rows, labels, geometry, SILENT)
        fit = recentred(with_contradicted_noise(arm.diagnosed.fit, rows))
        like = np.arange(len(q)) % len(rows)
        known = knowledge(fit, rows, arm.geometry.geometric.candidates).over(rows, q, like)
        station = None if rows.labels.station is None else rows.labels.station[like]
        true = made.model.poses(made.theta, made.model.rows(q, None, station))[1]
        off = fit.model.poses(fit.theta, known.rows)[1] - true
        squares += np.sum(off**2, axis=1)
        variance += np.einsum("nii->n", known.covariance)
        z = np.einsum("ni,ni->n", off, np.linalg.solve(known.covariance, off[:, :, None])[:, :, 0])
        beyond += ~known.measured
        untold += ~known.observable
        within = z < WITHIN
        covered += within | ~known.measured
        alone += within
        count = len(arm.diagnosed.stepwise.state.active)
        effects[count] = effects.get(count, 0) + 1
    ratio, out = np.sqrt(variance / squares), ~inside
    covered, alone, beyond, untold = (100 * each / runs for each in (covered, alone, beyond, untold))
    print(
        f"{name:14s} {runs:4d}  inside: {spread_of(ratio[inside])}, marked {beyond[inside].mean():.1f} %, "
        f"not told {untold[inside].mean():.1f} %; outside: covered {alone[out].mean():.1f} %, covered or marked "
        f"{covered[out].mean():.1f} %, ratio {np.median(ratio[out]):.3f}; "
        f"RMS {1e3 * np.sqrt(squares[inside].mean() / runs):.4f} mm; effects {effects}; {time.process_time() - started:.0f} s",
        flush=True,
    )


def spread_of(ratio: np.ndarray) -> str:
    """Ratios of some places in words."""
    if not len(ratio):
        return "no places"
    good = 100 * np.mean(np.abs(ratio - 1.0) <= 0.1)
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    return f"median {middle:.3f}, 5 to 95 % {low:.3f} to {high:.3f}, {good:.0f} % of places within 0.9 to 1.1"


def kinds(way: str, runs: int, seed: int) -> None:
    """The same for a kind of measurement, against the same rows without noise.

    What no reading tells, the scale of points without a known length for instance, is then alike in both, and is left out of the
    sigma, too; ``not told`` says where it counts there otherwise.
    """
    squares, surprise, beyond, untold = np.zeros((4, QUERIES))
    keys, robot = scenario(way, "six", seed, rows_of(way))
    rng, started, done = np.random.default_rng(99), time.process_time(), 0
    anywhere = draw_readings(robot, QUERIES // 2, rng)
    for run in range(runs):
        keys["truth"]["seed"] = 1000 * seed + run
        try:
            one, exact = made(noisy(keys), robot), made(keys, robot)
            geometry = fit_constants(one.campaign.question, robot, one.rows, ())
        except AridcalError as fault:
            print(f"  {way} {run}: {fault}")
            continue
        found = geometry.geometric
        true = fit(problem(found.model, exact.train), found.theta)
        q = np.vstack([one.train.readings[: QUERIES // 2], anywhere])  # as rows of this kind are, and anywhere
        whole = knowledge(found, one.train, found.candidates)
        like = np.zeros(QUERIES, dtype=int)
        untold += ~whole.over(one.train, q, like).observable
        known = replace(whole, open=np.zeros_like(whole.open)).over(one.train, q, like)
        off = found.model.poses(found.theta, known.rows)[1] - true.model.poses(true.theta, known.rows)[1]
        squares += np.sum(off**2, axis=1)
        surprise += np.einsum("ni,ni->n", off, np.linalg.solve(known.covariance, off[:, :, None])[:, :, 0])
        beyond += ~known.measured
        done += 1
    ratio, rows = np.sqrt(3.0 * done / surprise), np.arange(QUERIES) < QUERIES // 2
    print(
        f"{way:20s} {done:4d}  at rows: {spread_of(ratio[rows])}, marked {100 * beyond[rows].mean() / done:.0f} %; anywhere: "
        f"{spread_of(ratio[~rows])}, marked {100 * beyond[~rows].mean() / done:.0f} %; "
        f"not told {100 * untold.mean() / done:.1f} %; "
        f"RMS {1e3 * np.sqrt(squares.mean() / done):.4f} mm; {time.process_time() - started:.0f} s",
        flush=True,
    )


@dataclass(frozen=True)
class Promise:
    """How machines are made that a tolerance is promised of.

    Attributes:
        rows: How many, a fifth of them held out.
        declared: Whether the noise is.
        jitter: 1-sigma of what the joints do not repeat, [rad].
        effects: That nobody declares nor seeks.
    """

    rows: int = 120
    declared: bool = True
    jitter: float = 0.0
    effects: Callable[[np.random.Generator], Effects] = lambda rng: ()


PROMISES = {
    "clean": Promise(),
    "clean, few": Promise(50),
    "noise not declared": Promise(declared=False),
    "joints do not repeat": Promise(jitter=1e-4),
    "effects are missing": Promise(effects=harmonics),
}


def tolerance(name: str, runs: int, seed: int) -> None:
    """How often 95 % of the region are not within what is said, where the truth is known."""
    asked = PROMISES[name]
    case = Case(rows=asked.rows, effects=asked.effects)
    campaign, false, ratios = robots.campaign("pose", **dict(case.sections)), 0, []
    started = time.process_time()
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        made = machine(case, rng)
        robot = made.model.robot
        rows = measure(case, made, rng, asked.jitter)
        rows = replace(rows, test=np.arange(len(rows)) % 5 == 0)
        rows = rows if asked.declared else with_sigma(rows, (None, None))
        geometry = fit_constants(campaign.question, robot, rows, ())
        fit = recentred(with_contradicted_noise(geometry.geometric, rows.select(rows.train)))
        residual = problem(fit.model, rows).residual(fit.theta)
        known = certainty(
            requirement(campaign), fit, rows, fit.candidates, None, np.zeros(len(rows), dtype=bool), residual, None
        )
        said, q = known.tolerances[0].bound, known.region.readings
        own = rng.normal(0.0, asked.jitter, q.shape) if asked.jitter else 0.0
        true = made.model.poses(made.theta, made.model.rows(q + own))[1]
        reached = float(
            np.quantile(np.linalg.norm(fit.model.poses(fit.theta, fit.model.rows(q))[1] - true, axis=1), 0.95)
        )
        false += said < reached
        ratios.append(said / reached)
    print(
        f"{name:20s} {runs:4d}  said falsely {100 * false / runs:.1f} %; said over true: median {np.median(ratios):.2f}, "
        f"5 to 95 % {np.percentile(ratios, 5):.2f} to {np.percentile(ratios, 95):.2f}; {time.process_time() - started:.0f} s",
        flush=True,
    )


def real(name: str, runs: int, seed: int) -> None:
    """The same of a real UR10: calibrated from 250 rows, 50 of them held out, and set beside all other rows of the series."""
    campaign = load_campaign(TOP / "identification" / "ur10-laser-tracker" / "campaign-b.yaml")
    quiet = campaign.diagnosis.model_copy(update={"enabled": name == "effects sought"})
    campaign = campaign.model_copy(update={"diagnosis": quiet})
    table = pd.read_csv(campaign.measurements.files[0])
    for run in range(runs):
        started = time.process_time()
        some = np.random.default_rng([seed, run]).permutation(len(table))
        asked = table.iloc[some[:250]].assign(split=np.where(np.arange(250) < 50, "test", "train"))
        outcome = identify(campaign.with_tables([asked]))
        others = score(outcome, table.iloc[some[250:]])
        off = np.linalg.norm(others.residuals["final"][:, :3], axis=1)
        assert outcome.certainty is not None
        part = outcome.certainty.tolerances[0]
        within, true = 100 * np.mean(off <= part.bound), 1e3 * np.quantile(off, 0.95)
        print(
            f"{name}: said to be within {1e3 * part.bound:.3f} mm in 95 % of the range; so are {within:.1f} % of {len(off)} "
            f"other rows, 95 % of which are within {true:.3f} mm; {time.process_time() - started:.0f} s",
            flush=True,
        )


def main() -> None:
    """Run what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("question", choices=["sigma", "kinds", "tolerance", "real"])
    parser.add_argument("case", nargs="*", default=[])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    question, cases = {
        "sigma": (sigma, list(CASES)),
        "kinds": (kinds, list(WAYS)),
        "tolerance": (tolerance, list(PROMISES)),
        "real": (real, ["constants alone", "effects sought"]),
    }[arguments.question]
    for case in arguments.case or cases:
        question(case, arguments.runs, arguments.seed)


if __name__ == "__main__":
    main()
