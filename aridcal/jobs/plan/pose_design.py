"""Which configurations to measure next, and how well the target will be known then."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from aridcal.engine.robot.chain import Robot
from aridcal.files.counting import counting
from aridcal.files.measurement_settings import MeasurementSettings
from aridcal.files.orientations import column_of
from aridcal.jobs.plan.approaches import Approaches, approach_sides, from_both_sides
from aridcal.jobs.plan.configurations import Candidates, allowed, draw_candidates, ends, offers
from aridcal.jobs.plan.discrimination import Duel, discriminating_candidates
from aridcal.jobs.plan.information import CandidateInformation, candidate_information, in_line, rows_of, target_columns
from aridcal.jobs.plan.plan_coverage import PlanCoverage, Sigma, coverage, indices, observed_sigma, sigma_of
from aridcal.jobs.plan.prior_knowledge import PlanSetup
from aridcal.jobs.plan.refinement import RefinedCandidates, refined
from aridcal.jobs.plan.row_exchange import FEW, Criterion, RowChoice, best_choice, nested, rms_sigma
from aridcal.jobs.plan.target_region import region_readings
from aridcal.jobs.plan.travel import short_order
from aridcal.jobs.plan.usual_effects import (
    both_sides,
    observed_rows,
    with_pair,
    with_stated_effects,
    with_usual_effects,
)
from aridcal.system.errors import CampaignError
from aridcal.system.progress import SILENT, Progress

POOL, SMALL_POOL = 3000, 1000
"""Configurations to choose from, and the same where many are wanted, or each must be sought: twice as many make the choice better
by a per cent."""

RANDOM_CHOICES = 100
"""Random choices that the best one is set beside."""


@dataclass(frozen=True)
class PlanRequest:
    """What is asked of a plan.

    Attributes:
        n: Number of configurations.
        criterion: See :mod:`aridcal.jobs.plan.row_exchange`.
        region: Table of joints, or of places of the target, where it is to be known; None: anywhere in the joints' ranges.
        apart: Two effects that are to be told apart, ``WHERE.KIND`` each; none otherwise.
        seed: Of all that is drawn.
    """

    n: int
    criterion: Criterion = "A"
    region: Path | None = None
    apart: tuple[str, ...] = ()
    seed: int = 0


@dataclass(frozen=True)
class Plan:
    """Configurations to measure next.

    Attributes:
        readings: In the order in which to visit them, shape (n, columns), [rad] or [m].
        via: By way of which readings to come to each, so that joints come from the side that is meant; NaN where there are none.
        straight: True where the way from the one before does that by itself, if it is straight in joints, shape (n,).
        labels: What each measures, by column.
        directions: From which side joints come, -1 or 1, by the joint's name, for those of which it matters.
        sigma: Against the number of configurations, the best ones first; with two effects to be told apart what these do to the
            target, each as far as the other leaves it open.
        random: RMS sigma of as many random configurations, median of :data:`RANDOM_CHOICES`, [m]; NaN as for :class:`Sigma`.
        indices: Observability indices O1 to O5 of the rows so far and the planned ones together, of all but suspects.
        unknowns: Number of coefficients that can be identified with the planned rows.
        measured: Rows so far.
        notices: What was assumed.
        kept_out: What the arm was kept out of.
        duels: What is expected of two effects that are to be told apart, against each other and against what imitates them.
        coverage: For the page.
    """

    readings: np.ndarray
    via: np.ndarray
    straight: np.ndarray
    labels: dict[str, np.ndarray]
    directions: dict[str, np.ndarray]
    sigma: tuple[Sigma, ...]
    random: float
    indices: tuple[float, ...]
    unknowns: int
    measured: int
    notices: tuple[str, ...]
    kept_out: str
    duels: tuple[Duel, ...]
    coverage: PlanCoverage

    @property
    def by_way(self) -> np.ndarray:
        """True where programs go by way of a point, shape (n,)."""
        return np.asarray(np.isfinite(self.via).all(axis=1) & ~self.straight)

    @property
    def titles(self) -> tuple[str, ...]:
        """What each configuration measures, in words; empty where there is only one thing."""
        parts = [
            [f"{name} {label}" for label in values] for name, values in self.labels.items() if len(set(values)) > 1
        ]
        return tuple(", ".join(words) for words in zip(*parts, strict=True)) if parts else len(self.readings) * ("",)

    @property
    def at_n(self) -> Sigma:
        """Of the plan itself."""
        return next(s for s in self.sigma if s.n == len(self.readings))


def design(setup: PlanSetup, request: PlanRequest, progress: Progress = SILENT) -> Plan:
    """Choose configurations.

    Args:
        setup: What is known before.
        request: What they are for.
        progress: Called with what is being done.

    Raises:
        AridcalError: nothing can be planned, or something of what is asked needs mending.
    """
    seeds = np.random.SeedSequence(request.seed).spawn(5)
    drawing, choosing, chance, moving, approaching = (np.random.default_rng(s) for s in seeds)
    progress("drawing configurations")
    anywhere = setup.campaign.measurements.traits.anywhere
    pool = POOL if request.n <= FEW and anywhere else SMALL_POOL
    candidates = draw_candidates(setup, max(pool, 4 * request.n), 2 * request.n, drawing)
    setup = with_stated_effects(setup, candidates)
    if not (len(setup.rows) or setup.campaign.effects or request.apart):
        setup = with_usual_effects(setup, candidates)
    setup, parts = with_pair(setup, request.apart, candidates)
    region = region_readings(setup, request.region, drawing)
    choice, unknowns = question(setup, request, candidates, region)
    progress(f"choosing {request.n} of {len(candidates.readings):,} configurations")
    duels: tuple[Duel, ...] = ()
    if request.apart:
        pair = [
            (name, tuple(setup.model.coefficients[k] for k in part))
            for name, part in zip(request.apart, parts, strict=True)
        ]
        observed = observed_rows(setup, candidates.rows(setup))
        chosen, duels = discriminating_candidates(setup, unknowns, pair, observed, candidates, request.n)
    else:
        chosen = best_choice(choice, request.n, choosing)
    best = RefinedCandidates(candidates.some(chosen), choice.rows[chosen])
    if anywhere and not request.apart:
        progress("moving them to better places nearby")
        best = refined(setup, unknowns, choice, best, moving)
    progress("saying what they will tell")
    visited, approaches, notices = _visits(setup, best.candidates, approaching)
    rows = rows_of(setup, unknowns, visited)
    random = [
        rms_sigma(choice, choice.information(chance.permutation(len(choice.rows))[: request.n]))
        for _ in range(RANDOM_CHOICES)
    ]
    extended = replace(choice, rows=in_line(rows, choice.rows))
    order = nested(extended, range(request.n), min(2 * request.n, len(extended.rows)))
    counts = {request.n // 4, request.n // 2, request.n, len(order)} - {0}
    counts |= {0} if len(setup.rows) else set()
    titles = [offers(setup).titles[k] for k in visited.offer]
    both = np.flatnonzero(both_sides(setup)).tolist()
    return Plan(
        readings=visited.readings,
        via=approaches.via,
        straight=approaches.straight,
        labels={name: np.array([title[name] for title in titles]) for name in titles[0]},
        directions={setup.robot.readings[j]: approaches.sides[:, j] for j in both},
        sigma=tuple(sigma_of(extended, order[:count]) for count in sorted(counts)),
        random=observed_sigma(float(np.median(random))),
        indices=indices(setup, unknowns, rows),
        unknowns=len(unknowns.coefficients),
        measured=len(setup.rows),
        notices=(*setup.notices, *_of_region(setup, request), *notices),
        kept_out=setup.kept_out,
        duels=duels,
        coverage=coverage(setup, unknowns, extended, order, visited, rows, region),
    )


def _of_region(setup: PlanSetup, request: PlanRequest) -> list[str]:
    """Notices where a plan is for the campaign's own region, or for its own point on the target."""
    region, remarks = setup.campaign.region, []
    if request.region is None and (region.file is not None or region.joints):
        remarks.append("the target is to be known over the `region` that the campaign names")
    if any(region.tool):
        remarks.append("what is to be known is the point `tool` of the campaign's `region`, not the target itself")
    return remarks


def question(
    setup: PlanSetup, request: PlanRequest, candidates: Candidates, region: np.ndarray
) -> tuple[RowChoice, CandidateInformation]:
    """The choice that a request makes of candidates, and the information of these.

    Args:
        setup: What is known before.
        request: What the choice is for.
        candidates: C of them.
        region: Readings where the target is to be known, shape (R, columns).
    """
    setup, parts = with_pair(setup, request.apart, candidates)
    unknowns = candidate_information(setup, candidates, request.n)
    for name, part in zip(request.apart, parts, strict=True):
        if not set(part) & set(unknowns.coefficients):
            raise CampaignError(
                f"--apart {','.join(request.apart)}: no configuration tells {name} from the other one and from the constants: "
                "the data of this kind cannot"
            )
    target = np.concatenate([target_columns(setup, unknowns, region, k, parts) for k in ends(setup)])
    choice = RowChoice(
        unknowns.candidates,
        unknowns.prior_information,
        target,
        np.ones(len(target)),
        unknowns.things,
        request.criterion,
    )
    return choice, unknowns


def _visits(
    setup: PlanSetup, best: Candidates, rng: np.random.Generator
) -> tuple[Candidates, Approaches, tuple[str, ...]]:
    """Configurations in the order of their visits, how each is approached, and notices of approaches without room."""
    robot = setup.robot
    visited = best.some(short_order(best.readings))
    natural = approach_sides(visited.readings, robot.kinds)
    approaches = from_both_sides(visited.readings, robot.kinds, robot.limits, both_sides(setup), rng)
    number = np.flatnonzero(np.isfinite(approaches.via).all(axis=1))
    blocked = number[~allowed(setup, approaches.via[number], visited.first[number])]
    approaches.via[blocked] = np.nan
    blocked = blocked[~approaches.straight[blocked]]
    approaches.sides[blocked] = natural[blocked]
    visited = replace(visited, sides=approaches.sides)
    if not len(blocked):
        return visited, approaches, ()
    return (
        visited,
        approaches,
        (f"{len(blocked)} configurations are come to from one side only: there is no room for the other",),
    )


def as_table(plan: Plan, robot: Robot, settings: MeasurementSettings) -> pd.DataFrame:
    """Joints in the columns and units of a campaign's own table, and what each row measures."""
    labels = {column_of(name, settings, robot.readings): words for name, words in plan.labels.items()}
    sides = {
        column_of(f"{name}_direction", settings, robot.readings): settings.sense(f"{name}_direction") * side.astype(int)
        for name, side in plan.directions.items()
    }
    return joint_table(plan.readings, robot, settings).assign(**sides, **labels)


def joint_table(readings: np.ndarray, robot: Robot, settings: MeasurementSettings) -> pd.DataFrame:
    """Readings, shape (n, columns), [rad] or [m], in the columns and units of a campaign's own table."""
    names = [settings.columns.get(name, name) for name in robot.readings]
    cells = counting(settings, robot.readings, robot.kinds).cells(readings)
    return pd.DataFrame(dict(zip(names, cells.T, strict=True)))
