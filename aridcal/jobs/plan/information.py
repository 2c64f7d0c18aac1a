"""What configurations would tell: their rows of the Jacobian in units of the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.fit.elimination import Groups
from aridcal.engine.fit.identifiable import identifiable
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.instruments.channels import spread
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.trust.workspace import LOOSE, shifted
from aridcal.jobs.plan.beforehand import Beforehand
from aridcal.jobs.plan.configurations import Candidates

KNOWN = 0.1
"""Share of :data:`LOOSE` beyond which a sigma is that of what is assumed, not measured."""

ROUNDING = 1e-10
"""Share of the largest singular value below which what several rows of one configuration tell together is nothing: thirty markers
move as one body, by six numbers."""


@dataclass(frozen=True)
class Told:
    """What candidates would tell, in D unknowns: those of the things first, then the coefficients that can be identified.

    Attributes:
        candidates: In sigmas, shape (C, p, D).
        known: Information of what is known without them, shape (D, D).
        measured: The same without :data:`LOOSE`.
        things: How many of the unknowns are the things'.
        kept: Coefficients among the model's, in the order of the other unknowns.
        sizes: What of each unknown counts as much as a metre or a radian, shape (D,).
    """

    candidates: np.ndarray
    known: np.ndarray
    measured: np.ndarray
    things: int
    kept: tuple[int, ...]
    sizes: np.ndarray


def told(known: Beforehand, candidates: Candidates, n: int) -> Told:
    """What candidates would tell beside what is known.

    Args:
        known: K coefficients.
        candidates: C of them.
        n: How many are to be chosen: what they tell as a whole decides which coefficients can be identified.
    """
    rows = whitened(known, candidates)
    width = rows.shape[2]
    flat, _ = so_far(known, candidates)
    every = np.concatenate([flat, rows.reshape(-1, width) * np.sqrt(n / len(candidates.readings))])
    count = width - len(known.theta)
    R = np.asarray(np.linalg.qr(every, mode="r"))
    sizes = np.concatenate([np.ones(count), known.model.sizes])
    kept = identifiable(R[count:, count:] * sizes[count:], range(len(known.theta))).kept
    some = _columns(count, kept)
    flat = flat[:, some]
    measured = flat.T @ flat
    loose = np.diag(1.0 / (LOOSE * sizes[some]) ** 2)
    return Told(together(rows[:, :, some], candidates), measured + loose, measured, count, kept, sizes[some])


def rows_of(known: Beforehand, of: Told, candidates: Candidates) -> np.ndarray:
    """What other candidates would tell of the same unknowns, in sigmas, shape (C, p, D)."""
    return together(whitened(known, candidates)[:, :, _columns(of.things, of.kept)], candidates)


def whitened(known: Beforehand, candidates: Candidates) -> np.ndarray:
    """All columns of candidates' rows in sigmas, those of the things before those of the coefficients, shape (N, m, D)."""
    return _whitened(problem(known.model, candidates.rows(known)), known)[0]


def so_far(known: Beforehand, candidates: Candidates) -> tuple[np.ndarray, np.ndarray]:
    """What the rows so far tell, and what is stated and expected: columns (n, D), and residuals (n,), all in sigmas."""
    stated = _stated(problem(known.model, candidates.some([0]).rows(known)), known)
    if not len(known.rows):
        return stated, np.zeros(len(stated))
    weight = np.sqrt(known.weight * known.rows.repeats.share)
    columns, residual = _whitened(problem(known.model, known.rows).agreeing(known.theta), known)
    flat = (columns * weight[:, None, None]).reshape(-1, columns.shape[2])
    left = (residual * weight[:, None]).ravel()
    return np.concatenate([flat, stated]), np.concatenate([left, np.zeros(len(stated))])


def _columns(things: int, kept: Sequence[int]) -> np.ndarray:
    """Those of all unknowns that are asked about: the things' and the coefficients kept."""
    return np.concatenate([np.arange(things), things + np.array(kept, dtype=int)])


def _whitened(question: Problem, known: Beforehand) -> tuple[np.ndarray, np.ndarray]:
    """Columns of all rows in sigmas, those of the things before those of the coefficients, (N, m, D); and residuals, (N, m)."""
    per_number = 1.0 / spread(known.sigma, question.channels)
    parts, left = [], []
    for block in question.blocks():
        pieces = question.pieces(known.theta, block)
        things = _spread_out(pieces.B, question.group_of(block), question.groups)
        parts.append(np.concatenate([things, pieces.J], axis=2) * per_number[:, None])
        left.append(pieces.r * per_number)
    return np.concatenate(parts), np.concatenate(left)


def _spread_out(B: np.ndarray, group: np.ndarray, groups: Groups | None) -> np.ndarray:
    """Columns (n, m, U) of the rows' own groups as those of all groups, shape (n, m, unknowns of all)."""
    if groups is None:
        return np.zeros((*B.shape[:2], 0))
    place = _places(groups)
    wide = np.zeros((*B.shape[:2], int(groups.unknown.sum())))
    for g in np.unique(group[group >= 0]).tolist():
        own = np.flatnonzero(group == g)
        wide[np.ix_(own, np.arange(B.shape[1]), place[g, groups.unknown[g]])] = B[own][:, :, groups.unknown[g]]
    return wide


def _places(groups: Groups) -> np.ndarray:
    """Which of all unknowns each unknown of each group is, shape (G, U)."""
    return np.asarray(np.cumsum(groups.unknown).reshape(groups.unknown.shape) - 1)


def _stated(question: Problem, known: Beforehand) -> np.ndarray:
    """What is stated of things, and expected of coefficients, beforehand, in sigmas, shape (T, D)."""
    expected = np.flatnonzero(np.isfinite(known.prior))
    beforehand, groups = question.beforehand(), question.groups
    things = 0 if groups is None else int(groups.unknown.sum())
    of_things = 0 if beforehand is None or groups is None else len(beforehand.group)
    rows = np.zeros((of_things + len(expected), things + len(known.prior)))
    rows[of_things + np.arange(len(expected)), things + expected] = 1.0 / known.prior[expected]
    if beforehand is not None and groups is not None:
        place = _places(groups)
        for t, (g, by) in enumerate(zip(beforehand.group.tolist(), beforehand.by, strict=True)):
            rows[t, place[g, groups.unknown[g]]] = by[groups.unknown[g]]
    return rows


def together(rows: np.ndarray, candidates: Candidates) -> np.ndarray:
    """Rows (N, m, D) of each candidate one under another, shape (C, p, D); of an image what its markers tell together."""
    _, m, D = rows.shape
    count = np.bincount(candidates.of, minlength=len(candidates.readings))
    place = np.arange(len(candidates.of)) - np.repeat(np.cumsum(count) - count, count)
    stacked = np.zeros((len(count), int(count.max()), m, D))
    stacked[candidates.of, place] = rows
    flat = stacked.reshape(len(count), -1, D)
    if stacked.shape[1] == 1:
        return flat
    _, s, Vt = np.linalg.svd(flat, full_matrices=False)
    rank = int((s > ROUNDING * s.max()).sum(axis=1).max())
    return np.asarray(s[:, :rank, None] * Vt[:, :rank])


def in_line(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """What two sets of candidates tell, (C, p, D) and (E, q, D), one after the other; the shorter with rows of nothing."""
    depth = max(first.shape[1], second.shape[1])
    deep = [np.pad(rows, ((0, 0), (0, depth - rows.shape[1]), (0, 0))) for rows in (first, second)]
    return np.concatenate(deep)


def target_columns(
    known: Beforehand, of: Told, readings: np.ndarray, pattern: int, parts: Sequence[Sequence[int]] = ()
) -> np.ndarray:
    """How the target, or the campaign's own point on it, moves in some configurations with the unknowns, shape (R, 3, D), [m].

    Args:
        known: The model.
        of: Which unknowns.
        readings: Shape (R, columns).
        pattern: Of the rows.
        parts: Coefficients of the model; the target moved by each of these sets alone, one after the other. None: by all.
    """
    made = known.patterns.select(np.full(len(readings), pattern))
    rows = rows_of_data(known.model, made, readings)
    R, _, J = known.model.jacobian(known.theta, rows)
    tool = np.array(known.campaign.region.tool)
    J = shifted(J, R @ tool) if tool.any() else J
    found = []
    for part in parts or [of.kept]:
        columns = np.zeros((len(readings), 3, of.things + len(of.kept)))
        for place, k in enumerate(of.kept):
            if k in part:
                columns[:, :, of.things + place] = J[:, :3, k]
        found.append(columns)
    return np.concatenate(found)
