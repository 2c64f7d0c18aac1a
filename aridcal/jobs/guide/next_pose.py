"""Which pose to measure next: the one that tells most beside what is there, and that the arm gets to from here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.jobs.guide.posterior import Posterior, configurations, inverse, region_columns
from aridcal.jobs.plan.configurations import Candidates, allowed
from aridcal.jobs.plan.information import stack_by_candidate, whitened
from aridcal.jobs.plan.row_exchange import RowChoice, gain_of_rows, rms_sigma, updated

PLACES = 100
"""Places of the region: their mean is known to a tenth, and the same ones count for every choice."""

AS_GOOD = 0.97
"""Share of the best worth from which the nearest pose is taken: the way there costs time, too."""

TURN_STEP, SLIDE_STEP = 0.05, 0.02
"""[rad] and [m] between two looks at the way to a pose: of an arm of a metre its end goes 5 cm, half of what an arm is thick."""

NEAR = 0.2
"""[rad] or [m] within which a rejected pose's neighbours are rejected, too."""

LOOKS, TOGETHER = 8, 32
"""Work: Points of a way that are looked at first, of so many ways at once: of ways that are not free most show it there."""

WAYS = 150
"""Work: Poses to which a way is sought: where none of the best has one, the arm is boxed in, and the user finds a way."""

MORE_IMAGES, KEPT_IMAGES = 30, 450
"""Poses for images that are drawn with each image, as those that show a board must be sought, and a row is answered within a
second; and how many are chosen from: of 90 the best ones take a quarter more images than of 600."""

AHEAD = 10
"""Rows ahead that say whether more of them gain anything."""


@dataclass(frozen=True)
class Pool:
    """Configurations that can be measured, C of them, as the posterior sees them.

    Attributes:
        candidates: The configurations.
        choice: Their rows in sigmas, and how the target moves over the region.
    """

    candidates: Candidates
    choice: RowChoice


def drawn(posterior: Posterior, rng: np.random.Generator) -> Candidates:
    """Configurations that can be measured."""
    return configurations(posterior.setup, rng)


def more_of(candidates: Candidates, posterior: Posterior, rng: np.random.Generator) -> Candidates:
    """The configurations of images with some more, the earliest left out beyond :data:`KEPT_IMAGES`."""
    every = candidates.and_more(configurations(posterior.setup, rng, MORE_IMAGES))
    return every.some(np.arange(max(0, len(every.readings) - KEPT_IMAGES), len(every.readings)))


def pool(posterior: Posterior, candidates: Candidates, region: np.ndarray, here: np.ndarray | None) -> Pool:
    """The configurations as the posterior sees them.

    Args:
        posterior: K coefficients beside the unknowns of things.
        candidates: The configurations.
        region: Readings where the target is to be known, shape (R, columns).
        here: Readings of the last pose, shape (columns,), from where joints come to the next; None before any.
    """
    if here is not None:
        candidates = replace(candidates, sides=np.where(candidates.readings >= here, 1.0, -1.0))
    rows = stack_by_candidate(whitened(posterior.setup, candidates), candidates)
    target = region_columns(posterior.setup, posterior.things, region)[:, :3]
    ones = np.ones(len(target))
    return Pool(candidates, RowChoice(rows, posterior.information, target, ones, posterior.things, "A"))


def worth(some: Pool, posterior: Posterior) -> np.ndarray:
    """Share of the target's mean variance that each configuration takes away, shape (C,)."""
    covariance = posterior.covariance
    solved = np.zeros((some.choice.solved_for, some.choice.solved_for))
    gain = gain_of_rows(some.choice, some.choice.rows, covariance, solved, 1.0)
    return np.asarray(gain / max(float(np.sum(covariance * some.choice.averaged)), np.finfo(float).tiny))


def best_first(
    some: Pool, gain: np.ndarray, posterior: Posterior, here: np.ndarray | None, rejected: Sequence[np.ndarray]
) -> Iterator[int]:
    """Configurations, the one to measure next first: those that are reached from here by a straight way of the joints.

    Args:
        some: C configurations.
        gain: Of each, see :func:`worth`.
        posterior: Says where the arm keeps clear.
        here: Readings of the last pose, shape (columns,); None before any.
        rejected: Readings of poses that the user does not want.
    """
    readings = some.candidates.readings
    usable = np.ones(len(readings), dtype=bool)
    for pose in rejected:
        usable &= np.abs(readings - pose).max(axis=1) > NEAR
    left = np.flatnonzero(usable).tolist()
    far = np.zeros(len(readings)) if here is None else np.abs(readings - here).max(axis=1)
    if here is not None and not allowed(posterior.setup, here[None], some.candidates.first[:1]).all():
        here = None  # the arm stands where plans do not: how it gets out of there, only the user sees
    tries = 0
    looked_free: dict[int, bool] = {}
    while left and tries < WAYS:
        top = max(gain[k] for k in left)
        good = [k for k in left if gain[k] >= AS_GOOD * top]
        k = min(good, key=lambda k: far[k])
        if here is not None and k not in looked_free:
            others = [other for other in left if other not in looked_free and other != k]
            few = [k, *sorted(others, key=lambda other: -gain[other])[: TOGETHER - 1]]
            free = _looks_free(posterior, here, readings[few], some.candidates.first[few])
            looked_free |= dict(zip(few, free.tolist(), strict=True))
        left.remove(k)
        tries += here is not None
        if here is None or (looked_free[k] and reaches(posterior, here, readings[k], int(some.candidates.first[k]))):
            yield k


def _looks_free(posterior: Posterior, here: np.ndarray, there: np.ndarray, patterns: np.ndarray) -> np.ndarray:
    """False of ways that are not free where some of their points show it, shape (n,) bool; see :func:`reaches`.

    Args:
        posterior: Has the arm and what it keeps out of.
        here: Readings, shape (columns,).
        there: Those of the poses, shape (n, columns).
        patterns: Of what is measured there, shape (n,).
    """
    ways = [_way(posterior, here, end) for end in there]
    points = np.array([way[np.linspace(0, len(way) - 1, LOOKS, dtype=int)] for way in ways])
    free = allowed(posterior.setup, points.reshape(-1, len(here)), np.repeat(patterns, LOOKS))
    return np.asarray(free.reshape(-1, LOOKS).all(axis=1))


def reaches(posterior: Posterior, here: np.ndarray, there: np.ndarray, pattern: int) -> bool:
    """Whether the arm keeps clear on the straight way of the joints from one pose to another.

    Args:
        posterior: Has the arm and what it keeps out of.
        here: Readings, shape (columns,).
        there: Likewise.
        pattern: Of what is measured there.
    """
    way = _way(posterior, here, there)
    return bool(allowed(posterior.setup, way, np.full(len(way), pattern)).all())


def _way(posterior: Posterior, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Readings on the straight way of the joints from one pose to another, the first one left out, shape (n, columns)."""
    step = np.array([SLIDE_STEP if kind == "prismatic" else TURN_STEP for kind in posterior.setup.robot.kinds])
    count = max(2, int(np.ceil(np.max(np.abs(there - here) / step))) + 1)
    return np.asarray(here + np.linspace(0.0, 1.0, count)[1:, None] * (there - here))


def ahead(some: Pool, posterior: Posterior) -> np.ndarray:
    r"""Information that the next rows bring, :data:`AHEAD` of them, each the best, shape (D, D).

    A row F, chosen, takes :math:`B (1 + F B)^{-1} B^T` from the covariance, with :math:`B = \Sigma F^T`. So what each candidate
    is worth by, :math:`F_c \Sigma F_c^T` and :math:`F_c \Sigma W \Sigma F_c^T`, follows from :math:`F_c B` and
    :math:`F_c \Sigma W B`.
    """
    covariance, rows, W = posterior.covariance, some.choice.rows, some.choice.averaged
    C, p, D = rows.shape
    flat = rows.reshape(-1, D)
    propagated = flat @ covariance
    in_sigmas = propagated.reshape(C, p, D) @ np.swapaxes(rows, 1, 2)
    of_target = (propagated @ W).reshape(C, p, D) @ np.swapaxes(propagated.reshape(C, p, D), 1, 2)
    information = np.zeros_like(covariance)
    for _ in range(AHEAD):
        k = int(np.argmax(np.einsum("cii->c", np.linalg.solve(np.eye(p) + in_sigmas, of_target))))
        information += rows[k].T @ rows[k]
        B = covariance @ rows[k].T
        share = np.linalg.inv(np.eye(p) + in_sigmas[k])
        moved = (flat @ B).reshape(C, p, p) @ share
        across = moved @ np.swapaxes((flat @ (covariance @ (W @ B))).reshape(C, p, p), 1, 2)
        in_sigmas = in_sigmas - moved @ np.swapaxes((flat @ B).reshape(C, p, p), 1, 2)
        twice = moved @ (B.T @ W @ B) @ np.swapaxes(moved, 1, 2)
        of_target = of_target - across - np.swapaxes(across, 1, 2) + twice
        covariance = covariance - B @ share @ B.T
    return information


def gain_ahead(some: Pool, posterior: Posterior, information: np.ndarray) -> float:
    """Share by which the target's sigma becomes smaller with the next rows, whose information is given, shape (D, D)."""
    before = float(np.sum(posterior.covariance * some.choice.averaged))
    after = float(np.sum(inverse(posterior.information + information) * some.choice.averaged))
    return 1.0 - float(np.sqrt(max(after, 0.0) / max(before, np.finfo(float).tiny)))


def told_by(some: Pool, k: int, posterior: Posterior) -> list[str]:
    """Places of whose errors a configuration tells most, as far as the target feels them: two at the most."""
    covariance, things = posterior.covariance, posterior.things
    less = np.diag(covariance - updated(covariance, some.choice.rows[k], 1.0)) * np.diag(some.choice.averaged)
    of_place: dict[str, float] = {}
    for c, value in zip(posterior.setup.model.coefficients, less[things:].tolist(), strict=True):
        of_place[c.where] = of_place.get(c.where, 0.0) + value
    return sorted(of_place, key=lambda where: -of_place[where])[:2]


def sigma_of(some: Pool) -> float:
    """RMS over the region of the target's sigma, [m]."""
    return rms_sigma(some.choice, some.choice.prior_information)
