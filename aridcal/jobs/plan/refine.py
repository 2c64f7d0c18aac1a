"""Chosen configurations, moved a little further: joints are no grid, and the best place lies between the candidates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.engine.inverse.reachable import off_the_limits
from aridcal.jobs.plan.beforehand import Beforehand
from aridcal.jobs.plan.configurations import Candidates, allowed, in_sight
from aridcal.jobs.plan.information import Told, rows_of
from aridcal.jobs.plan.row_exchange import Choice, taken_away, updated, weights_of_the_worst, worth_of

REACH = (0.15, 0.15, 0.08, 0.08, 0.04, 0.04, 0.02, 0.02)
"""Steps tried in turn, as a share of each joint's range: from as far as candidates lie apart to where nothing more is gained."""

TRIED = 16
"""Configurations around each that are tried at every step: one joint moved in half of them, all joints in the others."""


@dataclass(frozen=True)
class Refined:
    """Configurations, and what they tell.

    Attributes:
        candidates: n of them.
        rows: In sigmas, shape (n, p, D).
    """

    candidates: Candidates
    rows: np.ndarray


def refined(known: Beforehand, of: Told, choice: Choice, pool: Refined, rng: np.random.Generator) -> Refined:
    """A choice whose members are each moved to better places nearby, as long as there are any.

    A pattern search: what is tried around each is compared with all others where they are (coordinate exchange: Meyer and
    Nachtsheim 1995, doi:10.1080/00401706.1995.10485889).

    Args:
        known: What is known.
        of: Which unknowns.
        choice: What the candidates were chosen for.
        pool: Those that were.
        rng: Draws what is tried.
    """
    asked = replace(choice, rows=pool.rows)
    every = range(len(pool.rows))
    before = asked.cost(every)
    if choice.criterion == "G":
        asked = replace(asked, criterion="A", weight=weights_of_the_worst(asked, every))
    now = pool
    for share in REACH:
        now = _stepped(known, of, asked, now, share, rng)
    return now if replace(choice, rows=now.rows).cost(every) < before else pool


def _stepped(
    known: Beforehand, of: Told, choice: Choice, now: Refined, share: float, rng: np.random.Generator
) -> Refined:
    """Every configuration in turn at the best of some places around it."""
    n = len(now.candidates.readings)
    tried = _around(known, now.candidates, share, rng)
    rows = rows_of(known, of, tried)
    readings, told = now.candidates.readings.copy(), now.rows.copy()
    own = slice(0, choice.solved_for)
    M = replace(choice, rows=told).information(range(n))
    covariance, solved = np.linalg.inv(M), np.linalg.inv(M[own, own])
    for k in range(n):
        rest = partial(replace(choice, rows=told).information, [other for other in range(n) if other != k])
        without, solved_without = taken_away(choice, covariance, solved, told[k], rest)
        places = np.arange(k * TRIED, (k + 1) * TRIED)
        gain = worth_of(choice, np.concatenate([told[k][None], rows[places]]), without, solved_without, 1.0)
        for best in np.argsort(-gain[1:], kind="stable").tolist():
            if gain[1 + best] <= gain[0]:
                break
            place = places[best]
            if all(holds(known, tried.readings[[place]], tried.first[[place]])[0] for holds in (allowed, in_sight)):
                readings[k], told[k] = tried.readings[place], rows[place]
                break
        covariance, solved = updated(without, told[k], 1.0), updated(solved_without, told[k][:, own], 1.0)
    return Refined(replace(now.candidates, readings=readings), told)


def _around(known: Beforehand, candidates: Candidates, share: float, rng: np.random.Generator) -> Candidates:
    """Places around configurations, :data:`TRIED` for each, off the limits."""
    low, high = off_the_limits(known.robot)
    n, columns = candidates.readings.shape
    step = share * (high - low) * rng.standard_normal((n, TRIED, columns))
    half = TRIED // 2
    step[:, :half] *= np.arange(columns) == rng.integers(0, columns, (n, half, 1))
    every = candidates.some(np.repeat(np.arange(n), TRIED))
    return replace(every, readings=np.clip(every.readings + step.reshape(-1, columns), low, high))
