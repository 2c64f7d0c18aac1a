"""Chosen configurations, moved a little further: joints are no grid, and the best place lies between the candidates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.engine.inverse.reachable import inner_limits
from aridcal.jobs.plan.configurations import Candidates, allowed, in_sight
from aridcal.jobs.plan.information import CandidateInformation, rows_of
from aridcal.jobs.plan.prior_knowledge import PlanSetup
from aridcal.jobs.plan.row_exchange import RowChoice, covariances_without, gain_of_rows, updated, weights_of_the_worst

STEP_SHARES = (0.15, 0.15, 0.08, 0.08, 0.04, 0.04, 0.02, 0.02)
"""Steps tried in turn, as a share of each joint's range: from as far as candidates lie apart to where nothing more is gained."""

PLACES_TRIED = 16
"""Configurations around each that are tried at every step: one joint moved in half of them, all joints in the others."""


@dataclass(frozen=True)
class RefinedCandidates:
    """Configurations, and their rows of the Jacobian.

    Attributes:
        candidates: n of them.
        rows: In sigmas, shape (n, p, D).
    """

    candidates: Candidates
    rows: np.ndarray


def refined(
    setup: PlanSetup,
    unknowns: CandidateInformation,
    choice: RowChoice,
    pool: RefinedCandidates,
    rng: np.random.Generator,
) -> RefinedCandidates:
    """A choice with each member moved to better places nearby, as long as there are any.

    A pattern search: what is tried around each is compared with all others where they are (coordinate exchange: Meyer and
    Nachtsheim 1995, doi:10.1080/00401706.1995.10485889).

    Args:
        setup: What is known.
        unknowns: Which unknowns.
        choice: What the candidates were chosen for.
        pool: The chosen candidates.
        rng: Draws the places tried.
    """
    chosen_for = replace(choice, rows=pool.rows)
    indices = range(len(pool.rows))
    before = chosen_for.cost(indices)
    if choice.criterion == "G":
        chosen_for = replace(chosen_for, criterion="A", weight=weights_of_the_worst(chosen_for, indices))
    current = pool
    for share in STEP_SHARES:
        current = _stepped(setup, unknowns, chosen_for, current, share, rng)
    return current if replace(choice, rows=current.rows).cost(indices) < before else pool


def _stepped(
    setup: PlanSetup,
    unknowns: CandidateInformation,
    choice: RowChoice,
    current: RefinedCandidates,
    share: float,
    rng: np.random.Generator,
) -> RefinedCandidates:
    """The choice with every configuration in turn moved to the best of some places around it."""
    n = len(current.candidates.readings)
    nearby = _around(setup, current.candidates, share, rng)
    rows = rows_of(setup, unknowns, nearby)
    readings, planned = current.candidates.readings.copy(), current.rows.copy()
    instruments = slice(0, choice.solved_for)
    M = replace(choice, rows=planned).information(range(n))
    covariance, solved = np.linalg.inv(M), np.linalg.inv(M[instruments, instruments])
    for k in range(n):
        without_row = partial(replace(choice, rows=planned).information, [other for other in range(n) if other != k])
        without, instruments_without = covariances_without(choice, covariance, solved, planned[k], without_row)
        places = np.arange(k * PLACES_TRIED, (k + 1) * PLACES_TRIED)
        gain = gain_of_rows(choice, np.concatenate([planned[k][None], rows[places]]), without, instruments_without, 1.0)
        for best in np.argsort(-gain[1:], kind="stable").tolist():
            if gain[1 + best] <= gain[0]:
                break
            place = places[best]
            if all(holds(setup, nearby.readings[[place]], nearby.first[[place]])[0] for holds in (allowed, in_sight)):
                readings[k], planned[k] = nearby.readings[place], rows[place]
                break
        covariance, solved = (
            updated(without, planned[k], 1.0),
            updated(instruments_without, planned[k][:, instruments], 1.0),
        )
    return RefinedCandidates(replace(current.candidates, readings=readings), planned)


def _around(setup: PlanSetup, candidates: Candidates, share: float, rng: np.random.Generator) -> Candidates:
    """Places around configurations, :data:`PLACES_TRIED` for each, off the limits."""
    low, high = inner_limits(setup.robot)
    n, columns = candidates.readings.shape
    step = share * (high - low) * rng.standard_normal((n, PLACES_TRIED, columns))
    half = PLACES_TRIED // 2
    step[:, :half] *= np.arange(columns) == rng.integers(0, columns, (n, half, 1))
    copies = candidates.some(np.repeat(np.arange(n), PLACES_TRIED))
    return replace(copies, readings=np.clip(copies.readings + step.reshape(-1, columns), low, high))
