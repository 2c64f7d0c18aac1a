"""How many rows being led saves, whether the stop is honest, and which faults are told.

    python benchmarks/guide.py              # all of it, a few draws: minutes
    python benchmarks/guide.py rows 50      # rows until twice the floor is kept, over random ones and over one plan
    python benchmarks/guide.py rows 10 --first 20 --arm UR10 --kind pose  # draws 20 to 29 of one cell
    python benchmarks/guide.py limit 2      # the fewest rows of any choice that knows the machine, over random ones
    python benchmarks/guide.py faults 50    # faults put in: told within two rows; alarms without a fault
    python benchmarks/guide.py early 10     # a bad row at each of the first ten places
    python benchmarks/guide.py time         # seconds a row, up to 1,000 rows of a UR10

A draw is a machine: each constant off by 1 mm or 1 mrad, a harmonic of 0.2 mrad in each gear, frames anywhere. The floor is
the error of the target, at the 95th percentile of the region, that is left after 200 random rows. What is kept is judged by
the truth: rows until the model of the moment errs by less than the tolerance in 95 % of the region, and goes on to; of plans,
the smallest one whose model does, and those of all larger ones. Random rows are of poses that can be measured; they and those
of plans are fitted by the same model, and taken for good without being judged. At the stop the calibration that is delivered is
asked, too.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from aridcal.engine.fit.constants import constants
from aridcal.engine.inverse.reachable import draw_readings, inner_limits
from aridcal.engine.model.predictions import rows_of_data
from aridcal.files.campaign import Campaign, load_campaign, nominal_robot
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.job_inputs import read_job
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.guide.events import Alarm, Event, Known, Next, Stop
from aridcal.jobs.guide.next_pose import pool
from aridcal.jobs.guide.posterior import Posterior, inverse
from aridcal.jobs.guide.row_reading import rows_so_far
from aridcal.jobs.guide.session import Session, session
from aridcal.jobs.plan.configurations import draw_candidates
from aridcal.jobs.plan.pose_design import PlanRequest, design
from aridcal.jobs.plan.prior_knowledge import beforehand
from aridcal.jobs.plan.row_exchange import RowChoice, greedy, rms_sigma
from aridcal.jobs.simulate.live import LiveArm, live_arm
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.runs.guided_campaign import to_calibrate
from aridcal.system.progress import one_thread

TOP = Path(__file__).resolve().parents[1]
FLOOR_ROWS, MOST_ROWS, PLACES = 200, 120, 100
PLANS = (15, 20, 30, 40, 55, 75, 100)
CONSTANT = 1e-3

SCARA = """<robot name="scara"><link name="base"/><link name="a"/><link name="b"/><link name="c"/>
<link name="d"/><link name="tool"/>
<joint name="one" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2.2" upper="2.2" effort="1" velocity="1"/></joint>
<joint name="two" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.325 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2.4" upper="2.4" effort="1" velocity="1"/></joint>
<joint name="lift" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0.275 0 0"/><axis xyz="0 0 1"/>
<limit lower="-0.2" upper="0.0" effort="1" velocity="1"/></joint>
<joint name="turn" type="revolute"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/>
<limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="d"/><child link="tool"/><origin xyz="0 0 -0.05"/></joint></robot>"""

GANTRY = """<robot name="gantry"><link name="base"/><link name="a"/><link name="b"/><link name="c"/>
<link name="d"/><link name="tool"/>
<joint name="along" type="prismatic"><parent link="base"/><child link="a"/><origin xyz="0 0 1.5"/><axis xyz="1 0 0"/>
<limit lower="0" upper="3" effort="1" velocity="1"/></joint>
<joint name="across" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="0" upper="2" effort="1" velocity="1"/></joint>
<joint name="up" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="0" effort="1" velocity="1"/></joint>
<joint name="turn" type="revolute"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="d"/><child link="tool"/><origin xyz="0.1 0 -0.1"/></joint></robot>"""

SEVEN = [(0, 0, 0.34, 0), (0, 0, 0, 1), (0, 0, 0.4, 0), (0, 0, 0, -1), (0, 0, 0.4, 0), (0, 0, 0, 1), (0, 0, 0.126, 0)]
"""Of a 7R arm: where each joint is beyond the one before, and whether it turns about z (0), y (1) or -y (-1)."""


def seven() -> str:
    """A redundant arm of seven joints that turn."""
    parts = ['<robot name="seven"><link name="base"/>']
    before = "base"
    for k, (x, y, z, about) in enumerate(SEVEN, start=1):
        axis = "0 0 1" if about == 0 else f"0 {about} 0"
        parts.append(
            f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{before}"/><child link="l{k}"/>'
            f'<origin xyz="{x} {y} {z}"/><axis xyz="{axis}"/><limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>'
        )
        before = f"l{k}"
    parts.append(
        f'<link name="tool"/><joint name="end" type="fixed"><parent link="{before}"/><child link="tool"/>'
        '<origin xyz="0 0 0.1"/></joint>'
    )
    return "".join(parts) + "</robot>"


ARMS: dict[str, Callable[[], tuple[str, str]]] = {
    "UR10": lambda: ((TOP / "urdf" / "ur10.urdf").read_text(), "tool0"),
    "7R": lambda: (seven(), "tool"),
    "SCARA": lambda: (SCARA, "tool"),
    "gantry": lambda: (GANTRY, "tool"),
}
ARID = {"arid": lambda: ((TOP / "urdf" / "arid.urdf").read_text(), "flange")}
NOISE = {"pose": {"position": 5e-5, "rotation": 1e-4}, "position": {"position": 5e-5}}


@dataclass
class Cell:
    """A simulated cell.

    Attributes:
        campaign: What the user wrote, its table not there yet.
        arm: The machine.
        places: Readings of the region, shape (R, columns).
    """

    campaign: Campaign
    arm: LiveArm
    places: np.ndarray

    def line(self, readings: np.ndarray) -> tuple[bytes, bytes]:
        """Measure one pose: the header, and the line."""
        head, row, _ = self.arm.measured(readings).to_csv(index=False).encode().split(b"\n")
        return head, row

    def error(self, posterior: Posterior) -> float:
        """95th percentile over the region of the target's error, [m]."""
        _, p = poses_now(posterior, self.places)
        return float(np.quantile(np.linalg.norm(p - self.truth(), axis=1), 0.95))

    def truth(self) -> np.ndarray:
        """Where the target really is at the places, shape (R, 3), [m]."""
        return self.arm.model.poses(self.arm.simulation.theta, self.arm.model.rows(self.places))[1]


def poses_now(posterior: Posterior, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the target at readings of n places, (n, 3, 3) and (n, 3), [m], as they are known now."""
    setup = posterior.setup
    theta = setup.theta + posterior.step[posterior.things :]
    pattern = setup.patterns.select(np.zeros(len(places), dtype=int))
    return setup.model.poses(theta, rows_of_data(setup.model, pattern, places))


def delivered_poses(folder: Path, now: Session, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of the calibration that is delivered."""
    (folder / "measurements.csv").write_bytes(now.table.text(list(range(len(now.table.rows)))))
    job = read_job(to_calibrate(now))
    job = replace(job, rows=replace(job.rows, test=np.zeros(len(job.rows), dtype=bool)))
    fit = identify(job).stages[-1].fit
    still = {f"{name}_direction": np.zeros(len(places)) for name in now.robot.readings}
    return fit.model.poses(fit.theta, fit.model.rows(places, still))


@dataclass(frozen=True)
class Draw:
    """What one draw came to: rows, or images.

    Attributes:
        floor: [m].
        guided: Until twice the floor is kept, led.
        random: At random.
        plan: The smallest plan that keeps it; NaN where nothing can be planned.
        at_plans: Led, looked at after as many rows as plans have, and no others.
        equal: Error led over error at random, after as many rows: median over :data:`COUNTS` from :data:`EQUAL_FROM` on.
        stop: At the stop; 0 where there was none.
        said: Whether it was said that the tolerance is kept.
        within: Whether it is, of the calibration that is delivered.
        claims: Share of what was said to be known that held.
    """

    floor: float
    guided: int
    random: int
    plan: float
    at_plans: float
    equal: float
    stop: int
    said: bool
    within: bool
    claims: float


COLUMNS = "floor mm  guided  random  plan  /random  /plan  error /random  stopped at  truth within  claims that hold"


def draws_of(description: str | None) -> argparse.ArgumentParser:
    """Arguments of a benchmark of drawn cells."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("draws", type=int, nargs="?", default=3)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--arm", choices=list(ARMS), action="append")
    return parser


def print_draws(title: str, seeds: range, draw: Callable[[Path, int], Draw]) -> None:
    """A line for each draw as it comes, of a folder and a seed; then one of them all: medians, and sums of what is counted."""
    figures = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as name:
            figures.append(draw(Path(name), seed))
        print(_line(f"{title} seed {seed}", figures[-1:]), flush=True)
    print(_line(f"{title} all {len(figures)}", figures), flush=True)


def _line(title: str, figures: list[Draw]) -> str:
    """A line of a table."""

    def median(values: Iterable[float]) -> float:
        return float(np.median([*values]))

    return (
        f"{title:28s} {1e3 * median(d.floor for d in figures):8.3f} {median(d.guided for d in figures):7.0f} "
        f"{median(d.random for d in figures):7.0f} {median(d.plan for d in figures):5.0f} "
        f"{median(d.guided / d.random for d in figures):8.2f} {median(d.at_plans / d.plan for d in figures):6.2f} "
        f"{median(d.equal for d in figures):14.2f} {median(d.stop for d in figures):11.0f} "
        f"{sum(d.within for d in figures):6d} of {sum(d.said for d in figures)} {np.mean([d.claims for d in figures]):12.3f}"
    )


def cell(folder: Path, arm: str, kind: str, seed: int) -> Cell:
    """Draw a machine."""
    rng = np.random.default_rng([seed, 7])
    text, tip = (ARMS | ARID)[arm]()
    (folder / "arm.urdf").write_text(text)
    keys: dict[str, Any] = {
        "format": 1,
        "robot": {"urdf": "arm.urdf", "tip": tip},
        "measurements": {"file": "measurements.csv", "kind": kind, "noise": NOISE[kind]},
        "frames": {"tip_target": {"xyz": [0.05, 0.03, 0.15]}},
    }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(keys))
    campaign = load_campaign(folder / "campaign.yaml")
    robot = nominal_robot(campaign)
    effects: list[dict[str, Any]] = []
    for joint in robot.joints:
        if joint.kind != "prismatic":
            std = {"std": 2e-4}
            effects.append({"kind": "joint_harmonic", "where": joint.name, "order": 1, "coefficients": std})
    keys["truth"] = {
        "parameters": {c.name: {"std": CONSTANT} for c in constants(robot, "full")},
        "frames": {
            "world_base": {"xyz": rng.uniform(-2, 2, 3).tolist(), "rpy": rng.uniform(-1, 1, 3).tolist()},
            "tip_target": {"xyz": rng.uniform(0.02, 0.15, 3).tolist(), "rpy": rng.uniform(-1, 1, 3).tolist()},
        },
        "effects": effects,
        "noise": NOISE[kind],
        "n": 100,
        "seed": seed,
    }
    (folder / "scenario.yaml").write_text(json.dumps(keys))
    made = live_arm(load_settings(folder / "scenario.yaml", Scenario))
    return Cell(campaign, made, session(campaign, robot, None).region[:PLACES])


def fed(now: Session, one: Cell, readings: np.ndarray) -> list[Any]:
    """Measure a pose, and what is said to it."""
    head, line = one.line(readings)
    if not now.table.head:
        now.table.add(head)
    return now.taken(now.table.add(line))


def of(event: Next) -> np.ndarray:
    """Readings of a pose that is proposed."""
    return np.array(list(event.joints.values()))


COUNTS = (*range(3, 40), *range(40, 100, 2), *range(100, FLOOR_ROWS + 1, 5))
"""Rows after which models of random rows are looked at."""

PLAN_FITS, EQUAL_FROM = 4, 15


def models(now: Session, counts: Iterable[int]) -> Iterator[Posterior | None]:
    """The model of the moment after so many of the measurements in the table, all of them good."""
    now.read = rows_so_far(now.campaign, now.robot, now.table, now.read)
    for n in counts:
        now.good = {int(k): True for k in now.read.index[:n]}
        if now.posterior is not None and not now._knows()[:n].all():
            now.posterior = None  # with what is new the model begins anew
        if now.posterior is None:
            now._begin(0)
        else:
            now._fit()
        yield now.posterior


def until(errors: Sequence[float], tolerance: float, counts: Sequence[int] | None = None) -> int:
    """Rows from which on the error stays within a tolerance, which is more than that at the last count where it does not."""
    bad = [n for n, error in zip(counts or range(1, len(errors) + 1), errors, strict=True) if error > tolerance]
    return (bad[-1] if bad else 0) + 1


def judged(
    led: list[float],
    random: Sequence[float],
    counts: Sequence[int],
    plan: Callable[[float], float],
    plans: Sequence[int] = PLANS,
) -> tuple[float, int, int, float, float, float]:
    """The figures of a draw but for those of its stop.

    Args:
        led: Errors after each row; it ends where rows do.
        random: Errors after so many random rows.
        counts: These.
        plan: The smallest plan that keeps a tolerance, see :func:`smallest_plan`.
        plans: Those that were made.
    """
    tolerance = 2.0 * random[-1]
    at_plans = smallest_plan(lambda count: led[min(count, len(led)) - 1] <= tolerance, plans)
    both = [led[n - 1] / error for n, error in zip(counts, random, strict=True) if EQUAL_FROM <= n <= len(led)]
    kept = until(led, tolerance), until(random, tolerance, counts)
    return random[-1], *kept, plan(tolerance), at_plans, float(np.median(both)) if both else np.nan


def smallest_plan(keeps: Callable[[int], bool], plans: Sequence[int] = PLANS) -> float:
    """The smallest plan that keeps the tolerance, and all larger ones; NaN if the largest does not."""
    planned = np.nan
    for count in reversed(plans):
        if not keeps(count):
            break
        planned = count
    return planned


@cache
def _planned(arm: str, kind: str, count: int) -> np.ndarray:
    """Readings of a plan, shape (count, columns): it knows nothing of the machine that is drawn."""
    with tempfile.TemporaryDirectory() as name:
        one = cell(Path(name), arm, kind, 0)
        return design(beforehand(one.campaign, one.arm.simulation.robot), PlanRequest(count)).readings


def _fresh(one: Cell, poses: np.ndarray) -> Session:
    """A session with poses measured, none of them looked at yet."""
    one.arm.poses.clear()
    now = session(one.campaign, one.arm.simulation.robot, None)
    for readings in poses:
        head, line = one.line(readings)
        if not now.table.head:
            now.table.add(head)
        now.table.add(line)
    return now


def rows(arguments: argparse.Namespace) -> None:
    """Rows until twice the floor is kept: guided, random, planned beforehand; and the truth at the stop."""
    print(f"{'':28s} {COLUMNS}", flush=True)
    for arm, kind in _kinds_of_cell(arguments):
        print_draws(f"{arm} {kind}", seeds_of(arguments), partial(_one, arm, kind))


def _kinds_of_cell(arguments: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """Arms and kinds that were asked for."""
    return product(arguments.arm or ARMS, arguments.kind or NOISE)


def seeds_of(arguments: argparse.Namespace) -> range:
    """Draws that were asked for."""
    return range(arguments.first, arguments.first + arguments.draws)


def _one(arm: str, kind: str, folder: Path, seed: int) -> Draw:
    """One draw."""
    one = cell(folder, arm, kind, seed)
    robot, rng = one.arm.simulation.robot, np.random.default_rng([seed, 8])
    prior = session(one.campaign, robot, None).prior
    assert prior is not None  # poses and positions need no things
    drawn = draw_candidates(prior.setup, FLOOR_ROWS, FLOOR_ROWS, rng).readings
    random = [np.inf if known is None else one.error(known) for known in models(_fresh(one, drawn), COUNTS)]

    def plan(tolerance: float) -> float:
        def keeps(count: int) -> bool:
            *_, known = models(_fresh(one, _planned(arm, kind, count)), (count // 2, *PLAN_FITS * (count,)))
            return known is not None and one.error(known) <= tolerance

        return smallest_plan(keeps)

    tolerance = 2.0 * random[-1]
    now = session(one.campaign, robot, tolerance)
    one.arm.poses.clear()
    events, stop, said, within = now.taken([]), 0, False, False
    guided: list[float] = []
    claims: list[bool] = []
    while len(guided) < MOST_ROWS and isinstance(events[-1], Next):
        events = fed(now, one, of(events[-1]))
        guided.append(np.inf if now.posterior is None else one.error(now.posterior))
        claims += [guided[-1] <= event.position for event in events if isinstance(event, Known)]
        if isinstance(events[-1], Stop):
            stop, said = len(guided), events[-1].why == "tolerance"
            within = said and _delivered(folder, one, now) <= tolerance
    return Draw(*judged(guided, random, COUNTS, plan), stop, said, within, float(np.mean(claims)))


CANDIDATES, STEPS = 600, 400

LIMIT_COLUMNS = "random  plan  greedy  bound  greedy/random  bound/random  greedy/plan  bound/plan"


def print_limits(title: str, seeds: range, limit: Callable[[Path, int], Fewest]) -> None:
    """What any choice of rows could reach, by the sigma of the target, all about the model that random rows gave.

    ``greedy`` is the best row after row; ``plan`` is the same chosen by what is known before any row. ``bound`` is no choice: the
    least n at which n times the best mixture of configurations keeps the tolerance, parts of rows allowed (by the multiplicative
    algorithm, Silvey, Titterington and Torsney 1978); no n rows of the same candidates can do better.
    """
    figures = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as name:
            figures.append(limit(Path(name), seed))
    random, plan, best, bound = np.median(np.array([(d.random, d.plan, d.greedy, d.bound) for d in figures]), axis=0)
    every = [(d.greedy / d.random, d.bound / d.random, d.greedy / d.plan, d.bound / d.plan) for d in figures]
    ratios = np.median(np.array(every), axis=0)
    print(
        f"{title:20s} {random:6.0f} {plan:5.0f} {best:7.0f} {bound:6.0f} {ratios[0]:14.2f} {ratios[1]:13.2f} {ratios[2]:12.2f} "
        f"{ratios[3]:11.2f}",
        flush=True,
    )


def limits(arguments: argparse.Namespace) -> None:
    """Rows until twice the sigma of 200 random ones is kept: random, greedy, and the bound."""
    print(f"{'':20s} {LIMIT_COLUMNS}", flush=True)
    for arm, kind in _kinds_of_cell(arguments):
        print_limits(f"{arm} {kind}", seeds_of(arguments), partial(_limit, arm, kind))


def _limit(arm: str, kind: str, folder: Path, seed: int) -> Fewest:
    """One draw."""
    one = cell(folder, arm, kind, seed)
    prior = session(one.campaign, one.arm.simulation.robot, None).prior
    assert prior is not None
    rng = np.random.default_rng([seed, 8])
    return fewest(_fresh(one, draw_candidates(prior.setup, FLOOR_ROWS, FLOOR_ROWS, rng).readings), rng)


@dataclass(frozen=True)
class Fewest:
    """Rows until twice the sigma of all random rows is kept, see :func:`print_limits`; NaN where nothing can be planned."""

    random: int
    plan: float
    greedy: int
    bound: int


def fewest(now: Session, rng: np.random.Generator) -> Fewest:
    """The fewest rows of each way of choosing them, about the model of all rows in a table."""
    count = len(rows_so_far(now.campaign, now.robot, now.table, now.read).index)
    *_, known = models(now, [n for n in COUNTS if n < count] + [count])
    assert known is not None
    F, r = now._columns(np.arange(count))
    candidates = draw_candidates(known.setup, CANDIDATES, 0, rng)
    some = pool(known.with_rows(F, r, -1.0), candidates, now.region, None).choice
    order = rng.permutation(len(some.rows))
    of_random = [rms_sigma(some, some.information(order[:n])) for n in range(1, min(count, len(order)) + 1)]
    tolerance = 2.0 * of_random[-1]

    def kept(chosen: list[int]) -> int:
        return until([rms_sigma(some, some.information(chosen[:n])) for n in range(1, len(chosen) + 1)], tolerance)

    plan = np.nan if now.prior is None else kept(greedy(pool(now.prior, candidates, now.region, None).choice, count))
    best = kept(greedy(some, count // 2))
    few, enough = 1, best
    while enough - few > 1:
        middle = (few + enough) // 2
        few, enough = (few, middle) if _mixture(some, middle) <= tolerance else (middle, enough)
    return Fewest(until(of_random, tolerance), plan, best, enough)


def _mixture(some: RowChoice, n: int) -> float:
    """Sigma of the target below which no n rows' worth of candidates gets, [m].

    The variance is convex in the weights w with slopes -n g: none has less than its value at w less n (max g - w g).
    """
    flat, p = some.rows.reshape(-1, some.rows.shape[2]), some.rows.shape[1]
    weight = np.full(len(some.rows), 1.0 / len(some.rows))
    for _ in range(STEPS):
        covariance = inverse(some.prior_information + n * (flat * np.repeat(weight, p)[:, None]).T @ flat)
        gain = np.einsum("ij,ij->i", flat @ (covariance @ some.averaged @ covariance), flat).reshape(-1, p).sum(axis=1)
        least = float(np.sum(covariance * some.averaged)) - n * float(gain.max() - weight @ gain)
        weight = weight * np.sqrt(gain)
        weight /= weight.sum()
    return float(np.sqrt(max(least, 0.0)))


def _delivered(folder: Path, one: Cell, now: Session) -> float:
    """95th percentile over the region of the error of the calibration that is delivered, [m]."""
    _, p = delivered_poses(folder, now, one.places)
    return float(np.quantile(np.linalg.norm(p - one.truth(), axis=1), 0.95))


FAULTS = ("target", "tripod", "stale", "unit", "bad")


def faults(draws: int) -> None:
    """Faults put in at a row between 15 and 30: told within two rows; alarms before it."""
    print("arm     kind      fault    told  as       rows without a fault  alarms", flush=True)
    total, false = 0, 0
    for arm in ARMS:
        for kind in NOISE:
            for fault in FAULTS:
                told, named, clean, alarms = 0, 0, 0, 0
                for seed in range(draws):
                    with tempfile.TemporaryDirectory() as name:
                        seen, right, before, wrong = _fault(Path(name), arm, kind, fault, seed)
                    told, named, clean, alarms = told + seen, named + right, clean + before, alarms + wrong
                total, false = total + clean, false + alarms
                print(
                    f"{arm:7s} {kind:9s} {fault:8s} {told:3d}/{draws} {named:3d}/{draws} {clean:10d} {alarms:18d}",
                    flush=True,
                )
    print(f"{false} alarms in {total} rows without a fault")


NAMED = {"target": {"slip"}, "tripod": {"slip"}, "stale": {"stale"}, "unit": {"unit"}, "bad": {"outlier"}}


def _fault(folder: Path, arm: str, kind: str, fault: str, seed: int) -> tuple[int, int, int, int]:
    """One draw: told, told by its name, rows before it, alarms among these."""
    one = cell(folder, arm, kind, seed)
    rng = np.random.default_rng([seed, 9])
    at = int(rng.integers(15, 30))
    now = session(one.campaign, one.arm.simulation.robot, None)
    events = now.taken([])
    alarms: list[tuple[int, Alarm]] = []
    shift = rng.normal(size=3)
    shift *= rng.uniform(5e-4, 3e-3) / np.linalg.norm(shift)
    last = b""
    for n in range(1, at + 3):
        if not isinstance(events[-1], Next):
            events = _gone_on(now)
        if n == at and fault in ("target", "tripod"):
            model = one.arm.model
            frames = model.tip_target if fault == "target" else model.world_base
            ((label, frame),) = frames
            moved = frame.copy()
            moved.translation = frame.translation + shift
            ends = ((label, moved),)
            one.arm.model = replace(model, tip_target=ends) if fault == "target" else replace(model, world_base=ends)
        following = events[-1]
        assert isinstance(following, Next)
        head, line = one.line(of(following))
        if n == at or (n > at and fault == "unit"):
            line = _spoilt(line, last, fault, one, rng)
        last = line
        if not now.table.head:
            now.table.add(head)
        events = now.taken(now.table.add(line))
        alarms += [(n, event) for event in events if isinstance(event, Alarm)]
    late = [alarm for n, alarm in alarms if at <= n <= at + 2]
    return (
        int(bool(late)),
        int(any(alarm.what in NAMED[fault] for alarm in late)),
        at - 1,
        sum(n < at for n, _ in alarms),
    )


def _spoilt(line: bytes, last: bytes, fault: str, one: Cell, rng: np.random.Generator) -> bytes:
    """A line with a fault."""
    joints = len(one.arm.simulation.robot.readings)
    cells, before = line.decode().split(","), last.decode().split(",")
    if fault == "stale":
        cells[joints:] = before[joints:]
    elif fault == "unit":
        cells[joints : joints + 3] = [repr(1e3 * float(c)) for c in cells[joints : joints + 3]]
    elif fault == "bad":
        off = rng.normal(size=3)
        off *= rng.uniform(1e-3, 1e-2) / np.linalg.norm(off)
        cells[joints : joints + 3] = [
            repr(float(c) + float(d)) for c, d in zip(cells[joints : joints + 3], off, strict=True)
        ]
    return ",".join(cells).encode()


EARLY, LAST_EARLY = 10, 22


def early(draws: int) -> None:
    """A bad row at each of the first ten places, and none: the row told, and after how many; alarms of good rows; the end."""
    print(
        "arm     kind      bad row told  rows later: median, most  alarms of good rows  slips  error over clean: median, most"
    )
    good, alarms_of_good = 0, 0
    for arm in (*ARID, "UR10"):
        for kind in NOISE:
            clean: dict[int, float] = {}
            for place in range(EARLY + 1):
                later, false, slips, ratio = [], 0, 0, []
                for seed in range(draws):
                    with tempfile.TemporaryDirectory() as name:
                        at, wrong, moved, error = _early(Path(name), arm, kind, seed, place)
                    clean[seed] = error if not place else clean[seed]
                    later += [] if at is None else [at - place]
                    false, slips = false + wrong, slips + moved
                    ratio.append(error / clean[seed])
                    if not place:
                        good, alarms_of_good = good + LAST_EARLY, alarms_of_good + wrong
                late = f"{np.median(later):4.0f} {max(later):4d}" if later else "   -    -"
                print(
                    f"{arm:7s} {kind:9s} {place or 'none':>7}  {len(later):3d}/{draws} {late} {false:10d} {slips:5d} "
                    f"{np.median(ratio):8.2f} {max(ratio):8.2f}",
                    flush=True,
                )
    print(f"{alarms_of_good} alarms in {good} rows of campaigns without a bad one")


def _early(folder: Path, arm: str, kind: str, seed: int, place: int) -> tuple[int | None, int, int, float]:
    """One draw: the row at which the bad one was told, alarms of others, slips in the end, and the true error, [m]."""
    one = cell(folder, arm, kind, seed)
    rng = np.random.default_rng([seed, 11, place])
    now = session(one.campaign, one.arm.simulation.robot, None)
    events = now.taken([])
    told, false = None, 0
    for n in range(1, LAST_EARLY + 1):
        events = events if isinstance(events[-1], Next) else _gone_on(now)
        assert isinstance(events[-1], Next)
        head, line = one.line(of(events[-1]))
        line = _spoilt(line, b"", "bad", one, rng) if n == place else line
        if not now.table.head:
            now.table.add(head)
        events = now.taken(now.table.add(line))
        for alarm in events:
            if isinstance(alarm, Alarm):
                told = told or (n if alarm.row == place + 1 else None)
                false += alarm.row != place + 1
    return told, false, len(now.slips), np.inf if now.posterior is None else one.error(now.posterior)


def _gone_on(now: Session) -> list[Event]:
    """The next pose of a campaign that goes on although it is enough."""
    now.stopped = False
    known = now._now()
    assert known is not None  # poses and positions need no things
    return [now._next(known, now._pool(known))]


def seconds() -> None:
    """Seconds a row of a UR10 with a thousand poses."""
    with tempfile.TemporaryDirectory() as name:
        one = cell(Path(name), "UR10", "pose", 0)
        robot = one.arm.simulation.robot
        now = session(one.campaign, robot, None)
        pool = draw_readings(robot, 1000, np.random.default_rng(0), inner_limits)
        begun = time.perf_counter()
        head, line = one.line(pool[0])
        now.table.add(head)
        for readings in pool[:-10]:
            now.table.add(one.line(readings)[1])
        now.taken(list(range(len(now.table.rows))))
        print(f"{len(now.table.rows)} rows at once: {time.perf_counter() - begun:.1f} s", flush=True)
        for readings in pool[-10:]:
            line = one.line(readings)[1]
            begun = time.perf_counter()
            now.stopped = False
            now.taken(now.table.add(line))
            print(f"row {len(now.table.rows)}: {time.perf_counter() - begun:.2f} s", flush=True)


def main() -> None:
    """Run what was asked for."""
    parser = draws_of(__doc__)
    parser.add_argument("--kind", choices=list(NOISE), action="append")
    what, *others = sys.argv[1:] or ["all"]
    arguments = parser.parse_args(others)
    with one_thread():
        if what in ("rows", "all"):
            rows(arguments)
        if what in ("limit", "all"):
            limits(arguments)
        if what in ("faults", "all"):
            faults(arguments.draws)
        if what in ("early", "all"):
            early(arguments.draws)
        if what in ("time", "all"):
            seconds()


if __name__ == "__main__":
    main()
