r"""Which one of few rows spoils the rest, or did something move: each supposition is weighed with all estimated anew under it.

While rows are hardly more than the unknowns, a bad one hides: constants bend to it, their sizes are taken for larger than they
are, and the good rows after it look bad; a frame that moved hides likewise. So each supposition, a row k that is bad or a frame
that is elsewhere since row k, is weighed by all that the rows S say that it speaks of,

.. math:: p(y_S) \prod_{k \notin S} \pi\, p_{bad}(y_k \mid y_S)

where the sizes of the coefficients are those that these rows suggest (the fixed point of MacKay 1992, with the usual size of
each group for some coefficients), and their scatter is integrated out: :math:`p(y_S)` is a multivariate t density.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from aridcal.jobs.guide.judgement import CLEARLY, exceeded, left_out_squares
from aridcal.jobs.guide.movement import BAD_SIZES, IS_BAD, MOVES, SIZES, SURE, Moved, log_density, log_mean
from aridcal.jobs.guide.posterior import PRIOR_WEIGHT, Posterior, groups

YOUNG = 3.0
"""Times as many numbers as unknowns up to which a bad row may hide: with more, what is left of a row beside all others is two
thirds of its error at the least."""

TRIED, MOVES_TRIED = 12, 4
"""Work: Rows that are left out in turn, those that fit worst, and moves of frames that explain most: what spoils the rest is
among them."""

SCATTER_WEIGHT = 6.0
"""Numbers for which the noise as it is taken to be counts where scatter is integrated out: as many as a pose has. What a model
lacks makes all rows worse alike, and among few rows that must not pass for some that are bad."""

ROUNDS = 5
"""Work: Of the sizes; the last ones change them by some per cent."""

SLIP = 1e-3
"""[m] and [rad] by which things slip, before rows tell: the middle of :data:`SIZES`."""

BEFORE, SINCE = 3, 2
"""Rows before and since a move without which it is not told from what is unknown of a frame, or from a bad row."""


@dataclass(frozen=True)
class Move:
    """A frame that may have moved.

    Attributes:
        frame: Its name.
        first: Number of the first row after it.
        gain: Logarithm of how much likelier all is with it than without.
        size: By how much, [m] and [rad].
    """

    frame: str
    first: int
    gain: float
    size: float


@dataclass(frozen=True)
class Weighed:
    """What is said for and against suppositions.

    Attributes:
        rows: Numbers of the rows that were left out in turn, shape (H,).
        gain: Logarithm of how much likelier all is if that row is bad than if none is, shape (H,).
        probability: Of a good row to be off as much as it is beside the others, shape (H,); 1 of rows not clearly off.
        moves: Frames that may have moved.
    """

    rows: np.ndarray
    gain: np.ndarray
    probability: np.ndarray
    moves: tuple[Move, ...]

    def spoiling(self, level: float) -> int | None:
        """The row that is bad: likelier than that none is, another, or a move, by :data:`SURE`; None if there is no such row.

        Args:
            level: Its probability must be below.
        """
        if not len(self.rows):
            return None
        best = int(np.argmax(self.gain))
        rivals = [0.0, *np.delete(self.gain, best).tolist(), *(move.gain for move in self.moves)]
        sure = self.gain[best] - max(rivals) > SURE and self.probability[best] < level
        return int(self.rows[best]) if sure else None

    def moved(self) -> Moved | None:
        """The move that is likelier than that there is none, and than any bad row, by :data:`SURE`; None if there is none."""
        if not self.moves:
            return None
        best = max(self.moves, key=lambda move: move.gain)
        odds = best.gain - max(0.0, float(np.max(self.gain, initial=0.0)))
        if odds < SURE:
            return None
        close = sorted((move for move in self.moves if move.gain > best.gain - SURE), key=lambda move: -move.gain)
        return Moved(best.first, tuple(dict.fromkeys(move.frame for move in close)), odds, best.size)


def is_young(posterior: Posterior, numbers: int) -> bool:
    """Whether so many numbers measured are too few for a bad row to show by itself."""
    return numbers < YOUNG * len(posterior.information)


def weighed(
    posterior: Posterior, used: np.ndarray, F: np.ndarray, r: np.ndarray, frames: Mapping[str, np.ndarray]
) -> Weighed:
    """Leave rows out in turn, and let frames move.

    Args:
        posterior: D unknowns, about its last fit.
        used: Which of the rows it holds already, shape (N,) bool.
        F: Columns of all rows, in the order in which they came, shape (N, m, D).
        r: Their residuals at the last fit, shape (N, m).
        frames: Columns of each frame that can move, at most six.
    """
    posterior = posterior.with_rows(F[~used], r[~used])
    setup, things, D = posterior.setup, posterior.things, F.shape[2]
    # all unknowns in units of what is expected of them, from nothing on; six more for what moved
    unit = np.r_[np.ones(things), posterior.base]
    prior = np.r_[np.zeros(things), (posterior.base / setup.prior) ** 2]
    G, y = F * unit, r + F[:, :, things:] @ setup.theta
    of_rows = np.einsum("nid,nie->nde", G, G, optimize=True)
    pulls = np.einsum("nid,ni->nd", G, y)
    rest = posterior.information * np.outer(unit, unit) - of_rows.sum(axis=0) - np.diag(prior)
    out = np.argsort(-left_out_squares(posterior, F, r))[:TRIED]
    likely = _likely_moves(posterior, F, r, frames)
    H = 1 + len(out) + len(likely)
    A, g = np.zeros((H, D + 6, D + 6)), np.zeros((H, D + 6))
    A[:, :D, :D], g[:, :D] = of_rows.sum(axis=0) + rest, pulls.sum(axis=0)
    squares, numbers = np.sum(y**2, axis=1), np.any(F != 0.0, axis=2).sum(axis=1)
    yy, n = np.full(H, squares.sum()), np.full(H, numbers.sum())
    for h, k in enumerate(out.tolist(), start=1):
        A[h, :D, :D] -= of_rows[k]
        g[h, :D] -= pulls[k]
        yy[h] -= squares[k]
        n[h] -= numbers[k]
    for h, (frame, first) in enumerate(likely, start=1 + len(out)):
        some = frames[frame]
        scale = SLIP / unit[some]
        of_move = slice(D, D + len(some))
        since = of_rows[first:].sum(axis=0)[:, some] * scale
        A[h, :D, of_move], A[h, of_move, :D], A[h, of_move, of_move] = since, since.T, since[some] * scale[:, None]
        g[h, of_move] = pulls[first:].sum(axis=0)[some] * scale
    keys = groups(setup.model)
    members = [
        things + np.array([k for k, other in enumerate(keys) if other == key]) for key in dict.fromkeys(keys) if key
    ]
    members.append(np.arange(D, D + 6))
    size = np.tile(np.r_[prior, np.ones(6)], (H, 1))  # inverse squares
    for some in members:
        size[:, some] = 1.0
    for round_ in range(ROUNDS + 1):
        M = A + _diagonals(size)
        V = np.linalg.inv(M)
        estimate = np.einsum("hde,he->hd", V, g)
        if round_ == ROUNDS:
            break
        for some in members:
            told = PRIOR_WEIGHT + np.sum(np.maximum(1.0 - V[:, some, some] * size[:, some], 0.0), axis=1)
            size[:, some] = (told / (PRIOR_WEIGHT + np.sum(estimate[:, some] ** 2, axis=1)))[:, None]
    q = np.maximum(yy - np.einsum("hd,hd->h", g, estimate), 0.0)
    nu = SCATTER_WEIGHT
    before = _diagonals(size)
    before[:, :D, :D] += rest
    log_p = 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(M)[1])
    log_p += gammaln((nu + n) / 2.0) - n / 2.0 * np.log(nu / 2.0) - (nu + n) / 2.0 * np.log1p(q / nu)
    for some in members:
        log_p += PRIOR_WEIGHT / 2.0 * (np.log(size[:, some[0]]) - size[:, some[0]])
    gain = log_p - log_p[0]
    probability = np.ones(len(out))
    for h, k in enumerate(out.tolist(), start=1):
        part = np.any(F[k] != 0.0, axis=1)
        error = (y[k] - G[k] @ estimate[h, :D])[part]
        spread = np.eye(len(error)) + G[k][part] @ V[h, :D, :D] @ G[k][part].T
        spread *= max(1.0, (nu + q[h]) / (nu + n[h]))
        gain[h] += log_mean([log_density(error, spread + by**2 * np.eye(len(error))) for by in BAD_SIZES]) + np.log(
            IS_BAD
        )
        square = float(error @ np.linalg.solve(spread, error))
        if square > CLEARLY**2 * len(error):
            probability[h - 1] = float(exceeded(square, len(error), nu + float(n[h])))
    of_moves = gain[1 + len(out) :] + np.log(MOVES)
    sizes = SLIP / np.sqrt(size[1 + len(out) :, D])
    moves = tuple(
        Move(frame, first, float(value), float(by))
        for (frame, first), value, by in zip(likely, of_moves, sizes, strict=True)
    )
    return Weighed(out, gain[1 : 1 + len(out)], probability, moves)


def _diagonals(values: np.ndarray) -> np.ndarray:
    """Diagonal matrices of values, shape (H, D), as (H, D, D)."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _likely_moves(
    posterior: Posterior, F: np.ndarray, r: np.ndarray, frames: Mapping[str, np.ndarray]
) -> list[tuple[str, int]]:
    r"""Frames and first rows after a move that explain most, all sizes as they are: :data:`MOVES_TRIED` of each frame.

    With the columns X of what moved, e what is left of the rows, :math:`U = X^T (1 - F \Sigma F^T) X` and :math:`b = X^T e`, a
    move of size d gains :math:`\frac12 b^T (U + d^{-2})^{-1} b - \frac12 \log |1 + d^2 U|`.
    """
    error = r - F @ posterior.step
    of_rows = np.einsum("nid,nie->nde", F, F, optimize=True)
    pulls = np.einsum("nid,ni->nd", F, error)
    firsts = np.arange(BEFORE, len(F) - SINCE + 1)
    if not len(firsts):
        return []
    since = np.cumsum(of_rows[::-1], axis=0)[::-1][firsts]
    pull = np.cumsum(pulls[::-1], axis=0)[::-1][firsts]
    likely: list[tuple[str, int]] = []
    for frame, some in frames.items():
        C = since[:, :, some]
        U = C[:, some] - np.swapaxes(C, 1, 2) @ posterior.covariance @ C
        values, vectors = np.linalg.eigh(U)
        values = np.maximum(values, 0.0)
        along = np.einsum("fij,fi->fj", vectors, pull[:, some]) ** 2
        gains = [0.5 * np.sum(along * d**2 / (1.0 + d**2 * values) - np.log1p(d**2 * values), axis=1) for d in SIZES]
        best = np.argsort(-np.max(gains, axis=0))[:MOVES_TRIED]
        likely += [(frame, int(firsts[k])) for k in best.tolist()]
    return likely
