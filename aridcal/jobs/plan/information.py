"""The information of configurations: their rows of the Jacobian in units of the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.fit.elimination import Groups
from aridcal.engine.fit.identifiable import identifiable
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.instruments.channels import spread
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.workspace import UNTOLD_SIGMA, shifted
from aridcal.jobs.plan.configurations import Candidates
from aridcal.jobs.plan.prior_knowledge import PlanSetup

ASSUMED_SHARE = 0.1
"""Share of :data:`UNTOLD_SIGMA` beyond which a sigma is that of what is assumed, not measured."""

TOGETHER_RANK = 1e-10
"""Share of the largest singular value below which what several rows of one configuration tell together is nothing: thirty markers
move as one body, by six numbers."""


@dataclass(frozen=True)
class CandidateInformation:
    """Information of candidates in D unknowns: those of the things first, then the coefficients that can be identified.

    Attributes:
        candidates: In sigmas, shape (C, p, D).
        prior_information: Information without the candidates, shape (D, D).
        measured: Information without the candidates and without :data:`UNTOLD_SIGMA`, shape (D, D).
        things: Number of unknowns of things.
        coefficients: Indices of the model's coefficients, in the order of the other unknowns.
        sizes: What of each unknown counts as much as a metre or a radian, shape (D,).
    """

    candidates: np.ndarray
    prior_information: np.ndarray
    measured: np.ndarray
    things: int
    coefficients: tuple[int, ...]
    sizes: np.ndarray


def candidate_information(setup: PlanSetup, candidates: Candidates, n: int) -> CandidateInformation:
    """Information of candidates beside what is known.

    Args:
        setup: K coefficients.
        candidates: C of them.
        n: Number to be chosen: the information of as many decides which coefficients can be identified.
    """
    rows = whitened(setup, candidates)
    width = rows.shape[2]
    flat, _ = measured_information(setup, candidates)
    all_rows = np.concatenate([flat, rows.reshape(-1, width) * np.sqrt(n / len(candidates.readings))])
    count = width - len(setup.theta)
    R = np.asarray(np.linalg.qr(all_rows, mode="r"))
    sizes = np.concatenate([np.ones(count), setup.model.sizes])
    kept = identifiable(R[count:, count:] * sizes[count:], range(len(setup.theta))).independent
    asked_about = _columns(count, kept)
    flat = flat[:, asked_about]
    measured = flat.T @ flat
    loose = np.diag(1.0 / (UNTOLD_SIGMA * sizes[asked_about]) ** 2)
    return CandidateInformation(
        stack_by_candidate(rows[:, :, asked_about], candidates),
        measured + loose,
        measured,
        count,
        kept,
        sizes[asked_about],
    )


def rows_of(setup: PlanSetup, unknowns: CandidateInformation, candidates: Candidates) -> np.ndarray:
    """Rows of other candidates in the same unknowns, in sigmas, shape (C, p, D)."""
    return stack_by_candidate(
        whitened(setup, candidates)[:, :, _columns(unknowns.things, unknowns.coefficients)], candidates
    )


def whitened(setup: PlanSetup, candidates: Candidates) -> np.ndarray:
    """All columns of candidates' rows in sigmas, those of the things before those of the coefficients, shape (N, m, D)."""
    return _whitened(problem(setup.model, candidates.rows(setup)), setup)[0]


def measured_information(setup: PlanSetup, candidates: Candidates) -> tuple[np.ndarray, np.ndarray]:
    """Columns (n, D) and residuals (n,) of the rows so far and of what is stated or expected beforehand, in sigmas."""
    beforehand = _beforehand_rows(problem(setup.model, candidates.some([0]).rows(setup)), setup)
    if not len(setup.rows):
        return beforehand, np.zeros(len(beforehand))
    weight = np.sqrt(setup.weight * setup.rows.repeats.share)
    columns, residual = columns_of(setup, setup.rows)
    flat = (columns * weight[:, None, None]).reshape(-1, columns.shape[2])
    residuals = (residual * weight[:, None]).ravel()
    return np.concatenate([flat, beforehand]), np.concatenate([residuals, np.zeros(len(beforehand))])


def columns_of(setup: PlanSetup, rows: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """All columns (N, m, D) and residuals (N, m) of measured rows, in sigmas."""
    return _whitened(problem(setup.model, rows).agreeing(setup.theta), setup)


def expected_rows(setup: PlanSetup) -> np.ndarray:
    """Rows of what is stated of things and expected of coefficients beforehand, in sigmas, shape (T, D)."""
    return _beforehand_rows(problem(setup.model, setup.patterns), setup)


def _columns(things: int, columns: Sequence[int]) -> np.ndarray:
    """Indices of the unknowns that are asked about: of the things, and of the coefficients kept."""
    return np.concatenate([np.arange(things), things + np.array(columns, dtype=int)])


def _whitened(question: Problem, setup: PlanSetup) -> tuple[np.ndarray, np.ndarray]:
    """Columns of all rows in sigmas, those of the things before those of the coefficients, (N, m, D); and residuals, (N, m)."""
    per_number = 1.0 / spread(setup.sigma, question.channels)
    parts, residuals = [], []
    for block in question.blocks():
        pieces = question.pieces(setup.theta, block)
        things = _spread_out(pieces.B, question.group_of(block), question.groups)
        parts.append(np.concatenate([things, pieces.J], axis=2) * per_number[:, None])
        residuals.append(pieces.r * per_number)
    return np.concatenate(parts), np.concatenate(residuals)


def _spread_out(B: np.ndarray, group: np.ndarray, groups: Groups | None) -> np.ndarray:
    """Columns (n, m, U) of each row's own group, placed among those of all groups, shape (n, m, unknowns of all)."""
    if groups is None:
        return np.zeros((*B.shape[:2], 0))
    place = _places(groups)
    wide = np.zeros((*B.shape[:2], int(groups.unknown.sum())))
    for g in np.unique(group[group >= 0]).tolist():
        rows_of_group = np.flatnonzero(group == g)
        wide[np.ix_(rows_of_group, np.arange(B.shape[1]), place[g, groups.unknown[g]])] = B[rows_of_group][
            :, :, groups.unknown[g]
        ]
    return wide


def _places(groups: Groups) -> np.ndarray:
    """Index among all unknowns of each unknown of each group, shape (G, U)."""
    return np.asarray(np.cumsum(groups.unknown).reshape(groups.unknown.shape) - 1)


def _beforehand_rows(question: Problem, setup: PlanSetup) -> np.ndarray:
    """Rows of what is stated of things and expected of coefficients beforehand, in sigmas, shape (T, D)."""
    expected = np.flatnonzero(np.isfinite(setup.prior))
    beforehand, groups = question.beforehand(), question.groups
    n_things = 0 if groups is None else int(groups.unknown.sum())
    n_beforehand = 0 if beforehand is None or groups is None else len(beforehand.group)
    rows = np.zeros((n_beforehand + len(expected), n_things + len(setup.prior)))
    rows[n_beforehand + np.arange(len(expected)), n_things + expected] = 1.0 / setup.prior[expected]
    if beforehand is not None and groups is not None:
        place = _places(groups)
        for t, (g, by) in enumerate(zip(beforehand.group.tolist(), beforehand.by, strict=True)):
            rows[t, place[g, groups.unknown[g]]] = by[groups.unknown[g]]
    return rows


def stack_by_candidate(rows: np.ndarray, candidates: Candidates) -> np.ndarray:
    """Rows (N, m, D) stacked by candidate, shape (C, p, D); an image's are reduced to the rank of all its markers."""
    _, m, D = rows.shape
    count = np.bincount(candidates.of, minlength=len(candidates.readings))
    place = np.arange(len(candidates.of)) - np.repeat(np.cumsum(count) - count, count)
    stacked = np.zeros((len(count), int(count.max()), m, D))
    stacked[candidates.of, place] = rows
    flat = stacked.reshape(len(count), -1, D)
    if stacked.shape[1] == 1:
        return flat
    _, s, Vt = np.linalg.svd(flat, full_matrices=False)
    rank = int((s > TOGETHER_RANK * s.max()).sum(axis=1).max())
    return np.asarray(s[:, :rank, None] * Vt[:, :rank])


def in_line(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rows of two sets of candidates, (C, p, D) and (E, q, D), in one array; zero rows where a candidate has fewer."""
    depth = max(first.shape[1], second.shape[1])
    deep = [np.pad(rows, ((0, 0), (0, depth - rows.shape[1]), (0, 0))) for rows in (first, second)]
    return np.concatenate(deep)


def target_columns(
    setup: PlanSetup,
    unknowns: CandidateInformation,
    readings: np.ndarray,
    pattern: int,
    parts: Sequence[Sequence[int]] = (),
    turns: bool = False,
) -> np.ndarray:
    """How the target, or the campaign's own point on it, moves in some configurations with the unknowns, shape (R, 3, D), [m].

    Args:
        setup: The model.
        unknowns: Which unknowns.
        readings: Shape (R, columns).
        pattern: Of the rows.
        parts: Coefficients of the model; the target moved by each of these sets alone, one after the other. None: by all.
        turns: Also how it turns, [rad]: the shape is then (R, 6, D).
    """
    pattern_rows = setup.patterns.select(np.full(len(readings), pattern))
    rows = rows_of_data(setup.model, pattern_rows, readings)
    R, _, J = setup.model.jacobian(setup.theta, rows)
    tool = np.array(setup.campaign.region.tool)
    J = shifted(J, R @ tool) if tool.any() else J
    parts_columns = []
    for part in parts or [unknowns.coefficients]:
        numbers = 6 if turns else 3
        columns = np.zeros((len(readings), numbers, unknowns.things + len(unknowns.coefficients)))
        for place, k in enumerate(unknowns.coefficients):
            if k in part:
                columns[:, :, unknowns.things + place] = J[:, :numbers, k]
        parts_columns.append(columns)
    return np.concatenate(parts_columns)
