"""How much better chosen configurations are than random ones, and how near to the best that exchanges find.

    python benchmarks/design.py            # UR10, ARID, a Panda; poses, positions, points, distances: some minutes
    python benchmarks/design.py suspects   # what suspects cost where there are none, and gain where they are
    python benchmarks/design.py bound      # what no choice for the first of these can be better than
    python benchmarks/design.py series-b   # the real UR10: 100 of its own rows, chosen and at random; needs ../shared/data

The first prints, for each arm and kind, the RMS sigma of the target over the joints' whole range with the chosen configurations,
as a share of the median of 100 random choices; for constants alone and with the effects usual for such arms as suspects; and,
among a third of the candidates, as a share of the best of 20 exchanges from random beginnings. The last calibrates (`aridcal
identify`, effects and all) from 100 rows of series B and prints the RMS error at all others.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.robot.chain import load_robot
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.read import load_measurements
from aridcal.jobs.calibrate.outcome import errors
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.plan.configurations import Candidates, draw_candidates
from aridcal.jobs.plan.information import rows_of
from aridcal.jobs.plan.pose_design import POOL, RANDOM_CHOICES, SMALL_POOL, PlanRequest, question
from aridcal.jobs.plan.prior_knowledge import PlanSetup, beforehand
from aridcal.jobs.plan.refinement import RefinedCandidates, refined
from aridcal.jobs.plan.row_exchange import best_choice, exchange_members, rms_sigma, worst_sigma
from aridcal.jobs.plan.target_region import region_readings
from aridcal.jobs.plan.usual_effects import with_usual_effects

TOP = Path(__file__).resolve().parents[1]
DATA = TOP / ".." / "shared" / "data"
SERIES_B = DATA / "ur10-laser-tracker" / "series_b.csv"
EXCHANGES, DRAWS, REGION, ROUNDS = 20, 10, 300, 400

TOOL = "frames: {tip_target: {xyz: [0.05, 0.03, 0.15]}}\n"
POINTS = "point,x,y,z,std\na,0.5,0.2,0.3,0.05\nb,0.4,-0.3,0.4,0.05\n"
SOCKETS = "instruments: {points: points.csv, lengths: [{between: [a, b], length: 0.519615}]}\n"
WIRES = "instruments: {anchors: {rail: {xyz: [1.2, 0.3, 0.1]}, wall: {xyz: [-1.0, 0.9, 0.3]}}}\n"
ARMS = {
    "UR10": (TOP / "urdf" / "ur10.urdf", "tool0"),
    "ARID": (TOP / "urdf" / "arid.urdf", "flange"),
    "Panda": (DATA / "panda-sockets" / "panda.urdf", "panda_link8"),
}
CASES = [
    ("UR10", "pose", 30, "{position: 1.0e-4, rotation: 1.0e-4}", TOOL),
    ("UR10", "pose", 30, "{position: 1.0e-4, rotation: 1.0e-3}", TOOL),
    ("UR10", "position", 15, "{position: 1.0e-4}", TOOL),
    ("ARID", "pose", 30, "{position: 1.0e-4, rotation: 1.0e-4}", TOOL),
    ("Panda", "pose", 30, "{position: 1.0e-4, rotation: 1.0e-4}", TOOL),
    ("UR10", "point", 30, "{position: 1.0e-4}", TOOL + SOCKETS),
    ("UR10", "distance", 60, "{distance: 1.0e-4}", TOOL + WIRES),
]  # fmt: skip


def campaign(folder: Path, arm: str, kind: str, noise: str, more: str) -> Campaign:
    """A campaign of which nothing was measured yet."""
    urdf, tip = ARMS[arm]
    (folder / "points.csv").write_text(POINTS)
    path = folder / "campaign.yaml"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {urdf}, tip: {tip}}}\nmeasurements: {{file: none.csv, kind: {kind}, noise: {noise}}}\n{more}"
    )
    return load_campaign(path)


def planned() -> None:
    """Plans from nothing, for constants alone and with the effects that such arms usually have as suspects."""
    print("arm    kind      n  suspects  chosen, mm  worst, mm  of random  of the best of exchanges  CPU s    noise")
    for arm, kind, n, noise, more in CASES:
        for suspects in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                made = campaign(Path(folder), arm, kind, noise, more)
                robot = load_robot(made.robot.urdf, made.robot.tip)
                started = time.process_time()
                known, rng = beforehand(made, robot), np.random.default_rng(0)
                candidates = draw_candidates(known, POOL if MEASUREMENT_KINDS[kind].anywhere else SMALL_POOL, n, rng)
                known = with_usual_effects(known, candidates) if suspects else known
                region = region_readings(known, None, rng)
                choice, of = question(known, PlanRequest(n), candidates, region)
                chosen = best_choice(choice, n, rng)
                best = RefinedCandidates(candidates.some(chosen), choice.rows[chosen])
                if MEASUREMENT_KINDS[kind].anywhere:
                    best = refined(known, of, choice, best, rng)
                seconds = time.process_time() - started
                M = replace(choice, rows=best.rows).information(range(n))
                count = len(candidates.readings)
                random = [
                    rms_sigma(choice, choice.information(rng.permutation(count)[:n])) for _ in range(RANDOM_CHOICES)
                ]
                near = "" if suspects else f"{_near(known, n, region, rng):.3f}"
            sigma = rms_sigma(choice, M)
            told = f"{1e3 * sigma:10.4f} {1e3 * worst_sigma(choice, M):10.4f} {sigma / np.median(random):10.3f}  {near:>24s}"
            usual = "usual" if suspects else "none"
            print(f"{arm:6s} {kind:8s} {n:3d}  {usual:8s}  {told}  {seconds:7.1f}  {noise}", flush=True)


def _near(known: PlanSetup, n: int, region: np.ndarray, rng: np.random.Generator) -> float:
    """RMS sigma of a choice among some candidates, as a share of that of the best of many exchanges."""
    few, _ = question(known, PlanRequest(n), draw_candidates(known, SMALL_POOL, n, rng), region)
    begun = [rng.permutation(len(few.rows))[:n].tolist() for _ in range(EXCHANGES)]
    least = min(few.cost(exchange_members(few, some)) for some in begun)
    return float(np.sqrt(few.cost(best_choice(few, n, rng)) / least))


def suspects() -> None:
    """What a plan for constants costs where effects are, and one for suspects where there are none; as shares of random ones."""
    for arm, kind, n, noise, more in (CASES[0], CASES[2], CASES[3]):
        with tempfile.TemporaryDirectory() as folder:
            made = campaign(Path(folder), arm, kind, noise, more)
            bare, rng = beforehand(made, load_robot(made.robot.urdf, made.robot.tip)), np.random.default_rng(0)
            candidates = draw_candidates(bare, POOL, n, rng)
            region = region_readings(bare, None, rng)
            asked = [
                (k, *question(k, PlanRequest(n), candidates, region))
                for k in (bare, with_usual_effects(bare, candidates))
            ]
        for title, (known, choice, of) in zip(("constants alone", "usual suspects"), asked, strict=True):
            chosen = best_choice(choice, n, rng)
            best = refined(known, of, choice, RefinedCandidates(candidates.some(chosen), choice.rows[chosen]), rng)
            shares = []
            for other, judged, unknowns in asked:
                random = [
                    rms_sigma(judged, judged.information(rng.permutation(POOL)[:n])) for _ in range(RANDOM_CHOICES)
                ]
                M = replace(judged, rows=rows_of(other, unknowns, best.candidates)).information(range(n))
                shares.append(rms_sigma(judged, M) / np.median(random))
            told = f"{shares[0]:.3f} where there are constants alone, {shares[1]:.3f} where such effects are"
            print(f"{arm}, {n} of {kind}, planned for {title}: {told}", flush=True)


def bound() -> None:
    r"""How small a share of random choices' sigma any thirty poses of a UR10 can have, constants alone.

    Of designs as measures w over places, the one with the smallest tr(W M^-1) is found by multiplication (Silvey, Titterington
    and Torsney 1978). It is convex in M, and so that of no other one is below tr(W M^-1)^2 / g, with g the largest gradient over
    places (Kiefer's general equivalence theorem, 1974) and that of what is assumed beforehand.
    """
    arm, kind, n, noise, more = CASES[0]
    with tempfile.TemporaryDirectory() as folder:
        made = campaign(Path(folder), arm, kind, noise, more)
        known, rng = beforehand(made, load_robot(made.robot.urdf, made.robot.tip)), np.random.default_rng(0)
        candidates = draw_candidates(known, POOL, n, rng)
        choice, of = question(known, PlanRequest(n), candidates, region_readings(known, None, rng))
        chosen = best_choice(choice, n, rng)
        best = refined(known, of, choice, RefinedCandidates(candidates.some(chosen), choice.rows[chosen]), rng)
    random = np.median(
        [rms_sigma(choice, choice.information(rng.permutation(POOL)[:n])) for _ in range(RANDOM_CHOICES)]
    )
    rows = np.concatenate([choice.rows, best.rows])
    w = np.full(len(rows), 1.0 / len(rows))
    for _ in range(ROUNDS):
        S = np.linalg.inv(choice.prior_information / n + np.einsum("c,cpi,cpj->ij", w, rows, rows, optimize=True))
        gradient = np.einsum("cpi,ij,cpj->c", rows, S @ choice.averaged @ S, rows, optimize=True)
        w = w * np.sqrt(gradient) / np.sum(w * np.sqrt(gradient))
    trace = float(np.trace(choice.averaged @ S))
    assumed = float(np.trace(S @ choice.averaged @ S @ choice.prior_information)) / n
    lowest = np.sqrt(trace**2 / (gradient.max() + assumed) / n) / random
    print(f"{arm}, {n} of {kind}: no choice among {len(rows)} places is below {lowest:.3f} of random ones")


def series_b() -> None:
    """100 rows of a real arm."""
    real = load_campaign(TOP / "identification" / "ur10-laser-tracker" / "campaign-b.yaml")
    robot = load_robot(real.robot.urdf, real.robot.tip, real.robot.base)
    rows = load_measurements(real, robot.readings, robot.limits, robot.kinds)
    table = pd.read_csv(SERIES_B).iloc[rows.origin.line - 2].reset_index(drop=True)
    every = len(rows)
    nothing = np.zeros(every, dtype=int)
    own = Candidates(rows.readings, np.ones_like(rows.readings), nothing, nothing, np.arange(every))
    for suspects in (False, True):
        rng = np.random.default_rng(0)
        with tempfile.TemporaryDirectory() as folder:
            tool = "frames: {tip_target: {xyz: [0, 0, 0.093]}}\n"
            bare = campaign(Path(folder), "UR10", "pose", "{position: 1.0e-4, rotation: 1.0e-4}", tool)
            known = beforehand(bare, robot)
            known = with_usual_effects(known, own) if suspects else known
            choice, _ = question(known, PlanRequest(100), own, rows.readings[rng.permutation(every)[:REGION]])
            chosen = best_choice(choice, 100, rng)
        what = "constants and usual suspects" if suspects else "constants"
        print(f"chosen for {what}: {final_rms(real, table, chosen)} mm", flush=True)
    rng = np.random.default_rng(1)
    for _ in range(DRAWS):
        print(f"random: {final_rms(real, table, rng.permutation(every)[:100].tolist())} mm", flush=True)


def final_rms(real: Campaign, table: pd.DataFrame, some: list[int]) -> str:
    """RMS error at all rows that were not chosen, of the geometric and of the final model, calibrated from those chosen, [mm]."""
    split = np.where(np.isin(np.arange(len(table)), some), "train", "test")
    outcome = identify(real.with_tables([table.assign(split=split)]))
    test = outcome.measurements.test
    figures = [errors(stage.residual, test, outcome.channels)["position_mm"]["rms"] for stage in outcome.stages[1:]]
    return ", ".join(f"{name} {rms:.4f}" for name, rms in zip(("geometric", "final"), figures, strict=True))


if __name__ == "__main__":
    {"": planned, "suspects": suspects, "bound": bound, "series-b": series_b}["".join(sys.argv[1:])]()
