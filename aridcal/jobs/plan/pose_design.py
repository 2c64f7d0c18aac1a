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
from aridcal.jobs.plan.approaches import Approaches, as_they_come, from_both_sides
from aridcal.jobs.plan.beforehand import Beforehand
from aridcal.jobs.plan.configurations import Candidates, allowed, draw_candidates, ends, offers
from aridcal.jobs.plan.discrimination import Duel, telling_apart
from aridcal.jobs.plan.information import Told, in_line, rows_of, target_columns, told
from aridcal.jobs.plan.plan_coverage import Coverage, Sigma, coverage, indices, sigma_of, told_sigma
from aridcal.jobs.plan.refine import Refined, refined
from aridcal.jobs.plan.row_exchange import FEW, Choice, Criterion, best_choice, nested, rms_sigma
from aridcal.jobs.plan.target_region import region_readings
from aridcal.jobs.plan.travel import short_order
from aridcal.jobs.plan.usual_effects import both_sides, observed_by, with_pair, with_stated_effects, with_usual_effects
from aridcal.system.errors import CampaignError
from aridcal.system.progress import SILENT, Progress

POOL, SMALL_POOL = 3000, 1000
"""Configurations to choose from, and the same where many are wanted, or each must be sought: twice as many make the choice better
by a per cent."""

RANDOM = 100
"""Random choices that the best one is set beside."""


@dataclass(frozen=True)
class Asked:
    """What a plan is to do.

    Attributes:
        n: Configurations.
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
        random: RMS sigma of as many random configurations, the median of :data:`RANDOM` choices, [m]; NaN as for :class:`Sigma`.
        indices: Observability indices O1 to O5 of the rows so far and the planned ones together, of all but suspects.
        unknowns: How many coefficients can be identified, with the planned rows.
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
    coverage: Coverage

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
        return tuple(", ".join(own) for own in zip(*parts, strict=True)) if parts else len(self.readings) * ("",)

    @property
    def at_n(self) -> Sigma:
        """Of the plan itself."""
        return next(s for s in self.sigma if s.n == len(self.readings))


def design(known: Beforehand, asked: Asked, progress: Progress = SILENT) -> Plan:
    """Choose configurations.

    Args:
        known: What is known before.
        asked: What they are for.
        progress: Called with what is being done.

    Raises:
        AridcalError: nothing can be planned, or something of what is asked needs mending.
    """
    seeds = np.random.SeedSequence(asked.seed).spawn(5)
    drawing, choosing, chance, moving, coming = (np.random.default_rng(s) for s in seeds)
    progress("drawing configurations")
    easy = known.campaign.measurements.traits.anywhere
    pool = POOL if asked.n <= FEW and easy else SMALL_POOL
    candidates = draw_candidates(known, max(pool, 4 * asked.n), 2 * asked.n, drawing)
    known = with_stated_effects(known, candidates)
    if not (len(known.rows) or known.campaign.effects or asked.apart):
        known = with_usual_effects(known, candidates)
    known, parts = with_pair(known, asked.apart, candidates)
    region = region_readings(known, asked.region, drawing)
    choice, of = question(known, asked, candidates, region)
    progress(f"choosing {asked.n} of {len(candidates.readings):,} configurations")
    duels: tuple[Duel, ...] = ()
    if asked.apart:
        pair = [
            (name, tuple(known.model.coefficients[k] for k in part))
            for name, part in zip(asked.apart, parts, strict=True)
        ]
        observed = observed_by(known, candidates.rows(known))
        chosen, duels = telling_apart(known, of, pair, observed, candidates, asked.n)
    else:
        chosen = best_choice(choice, asked.n, choosing)
    best = Refined(candidates.some(chosen), choice.rows[chosen])
    if easy and not asked.apart:
        progress("moving them to better places nearby")
        best = refined(known, of, choice, best, moving)
    progress("saying what they will tell")
    visited, approaches, notices = _visits(known, best.candidates, coming)
    rows = rows_of(known, of, visited)
    random = [
        rms_sigma(choice, choice.information(chance.permutation(len(choice.rows))[: asked.n])) for _ in range(RANDOM)
    ]
    more = replace(choice, rows=in_line(rows, choice.rows))
    order = nested(more, range(asked.n), min(2 * asked.n, len(more.rows)))
    counts = {asked.n // 4, asked.n // 2, asked.n, len(order)} - {0}
    counts |= {0} if len(known.rows) else set()
    titles = [offers(known).titles[k] for k in visited.offer]
    both = np.flatnonzero(both_sides(known)).tolist()
    return Plan(
        readings=visited.readings,
        via=approaches.via,
        straight=approaches.straight,
        labels={name: np.array([title[name] for title in titles]) for name in titles[0]},
        directions={known.robot.readings[j]: approaches.sides[:, j] for j in both},
        sigma=tuple(sigma_of(more, order[:count]) for count in sorted(counts)),
        random=told_sigma(float(np.median(random))),
        indices=indices(known, of, rows),
        unknowns=len(of.kept),
        measured=len(known.rows),
        notices=(*known.notices, *_of_region(known, asked), *notices),
        kept_out=known.kept_out,
        duels=duels,
        coverage=coverage(known, of, more, order, visited, rows, region),
    )


def _of_region(known: Beforehand, asked: Asked) -> list[str]:
    """That a plan is for the region that the campaign names, and for its point on the target."""
    own, said = known.campaign.region, []
    if asked.region is None and (own.file is not None or own.joints):
        said.append("the target is to be known over the `region` that the campaign names")
    if any(own.tool):
        said.append("what is to be known is the point `tool` of the campaign's `region`, not the target itself")
    return said


def question(known: Beforehand, asked: Asked, candidates: Candidates, region: np.ndarray) -> tuple[Choice, Told]:
    """What is to be chosen from candidates, for what is asked, and what they tell.

    Args:
        known: What is known before.
        asked: What the choice is for.
        candidates: C of them.
        region: Readings where the target is to be known, shape (R, columns).
    """
    known, parts = with_pair(known, asked.apart, candidates)
    of = told(known, candidates, asked.n)
    for name, part in zip(asked.apart, parts, strict=True):
        if not set(part) & set(of.kept):
            raise CampaignError(
                f"--apart {','.join(asked.apart)}: no configuration tells {name} from the other one and from the constants: the "
                "data of this kind cannot"
            )
    target = np.concatenate([target_columns(known, of, region, k, parts) for k in ends(known)])
    choice = Choice(of.candidates, of.known, target, np.ones(len(target)), of.things, asked.criterion)
    return choice, of


def _visits(
    known: Beforehand, best: Candidates, rng: np.random.Generator
) -> tuple[Candidates, Approaches, tuple[str, ...]]:
    """Configurations in the order of their visits, how each is come to, and what could not be had."""
    robot = known.robot
    visited = best.some(short_order(best.readings))
    natural = as_they_come(visited.readings, robot.kinds)
    approaches = from_both_sides(visited.readings, robot.kinds, robot.limits, both_sides(known), rng)
    number = np.flatnonzero(np.isfinite(approaches.via).all(axis=1))
    blocked = number[~allowed(known, approaches.via[number], visited.first[number])]
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
