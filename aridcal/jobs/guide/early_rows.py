r"""Which one of few rows spoils the rest, or did something move: each supposition is weighed with all estimated anew under it.

While rows are hardly more than the unknowns, a bad one hides: constants bend to it, their sizes are taken for larger than they
are, and the good rows after it look bad; a frame that moved hides likewise. So each supposition, a row k that is bad or a frame
that is elsewhere since row k, is weighed by all that the rows S say that it speaks of,

.. math:: p(y_S) \prod_{k \notin S} \pi\, p_{bad}(y_k \mid y_S)

where the sizes of the coefficients are those that these rows suggest (the fixed point of MacKay 1992, with the usual size of
each group for some coefficients), and their scatter is integrated out: :math:`p(y_S)` is a multivariate t density.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from aridcal.jobs.guide.judgement import CLEARLY, exceeded, left_out_squares
from aridcal.jobs.guide.movement import BAD_SIZES, IS_BAD, MOVES, SIZES, SURE, FrameMovement, log_density, log_mean
from aridcal.jobs.guide.posterior import PRIOR_WEIGHT, Posterior, members

NUMBERS_PER_UNKNOWN = 3.0
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
class SupposedMove:
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
class Suppositions:
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
    moves: tuple[SupposedMove, ...]

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

    def movement(self) -> FrameMovement | None:
        """The move that is likelier than that there is none, and than any bad row, by :data:`SURE`; None if there is none."""
        if not self.moves:
            return None
        best = max(self.moves, key=lambda move: move.gain)
        odds = best.gain - max(0.0, float(np.max(self.gain, initial=0.0)))
        if odds < SURE:
            return None
        close = sorted((move for move in self.moves if move.gain > best.gain - SURE), key=lambda move: -move.gain)
        return FrameMovement(best.first, tuple(dict.fromkeys(move.frame for move in close)), odds, best.size)


def is_young(posterior: Posterior, numbers: int) -> bool:
    """Whether so many numbers measured are too few for a bad row to show by itself."""
    return numbers < NUMBERS_PER_UNKNOWN * len(posterior.information)


@dataclass(frozen=True)
class _Equations:
    """Normal equations of H suppositions: nothing happened, one row is bad, one frame moved.

    Unknowns are in units of what is expected of them.

    Attributes:
        information: Of D unknowns and the six numbers of what moved, without any prior on sizes, shape (H, D + 6, D + 6).
        pull: Its right side, shape (H, D + 6).
        squares: Of the rows that the supposition speaks of, shape (H,).
        numbers: How many numbers these are, shape (H,).
    """

    information: np.ndarray
    pull: np.ndarray
    squares: np.ndarray
    numbers: np.ndarray


@dataclass(frozen=True)
class _Estimates:
    """What each supposition makes of the unknowns, in the sizes that its rows suggest.

    Attributes:
        size: Inverse squares of the sizes, shape (H, D + 6).
        information: With them, shape (H, D + 6, D + 6).
        covariance: Its inverse.
        value: Shape (H, D + 6).
    """

    size: np.ndarray
    information: np.ndarray
    covariance: np.ndarray
    value: np.ndarray


def weigh(
    posterior: Posterior, used: np.ndarray, F: np.ndarray, r: np.ndarray, frames: Mapping[str, np.ndarray]
) -> Suppositions:
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
    unit = np.r_[np.ones(things), posterior.base]
    prior = np.r_[np.zeros(things), (posterior.base / setup.prior) ** 2]
    G, y = F * unit, r + F[:, :, things:] @ setup.theta  # from nothing on, not from the last fit
    of_rows = np.einsum("nid,nie->nde", G, G, optimize=True)
    rest = posterior.information * np.outer(unit, unit) - of_rows.sum(axis=0) - np.diag(prior)
    out = np.argsort(-left_out_squares(posterior, F, r))[:TRIED]
    likely = _likely_moves(posterior, F, r, frames)
    slipped = [(frames[frame], SLIP / unit[frames[frame]], first) for frame, first in likely]
    equations = _equations(G, y, of_rows, rest, out, slipped)
    alike = [*(things + some for some in members(setup.model)), np.arange(D, D + 6)]
    estimates = _in_sizes(equations, np.r_[prior, np.ones(6)], alike)
    left = np.maximum(equations.squares - np.einsum("hd,hd->h", equations.pull, estimates.value), 0.0)
    evidence = _evidence(equations, estimates, left, rest, alike)
    gain = evidence - evidence[0]
    others = [
        _beside(G[k], y[k], *(part[h] for part in (estimates.value, estimates.covariance, left, equations.numbers)))
        for h, k in enumerate(out.tolist(), start=1)
    ]
    of_bad = gain[1 : 1 + len(out)] + np.array([bad for bad, _ in others]) + np.log(IS_BAD)
    of_moves = gain[1 + len(out) :] + np.log(MOVES)
    slips = SLIP / np.sqrt(estimates.size[1 + len(out) :, D])
    moves = tuple(
        SupposedMove(frame, first, float(value), float(by))
        for (frame, first), value, by in zip(likely, of_moves, slips, strict=True)
    )
    return Suppositions(out, of_bad, np.array([chance for _, chance in others]), moves)


def _equations(
    G: np.ndarray,
    y: np.ndarray,
    of_rows: np.ndarray,
    rest: np.ndarray,
    out: np.ndarray,
    moves: Sequence[tuple[np.ndarray, np.ndarray, int]],
) -> _Equations:
    """The equations of all suppositions.

    Args:
        G: Columns of the rows, shape (N, m, D).
        y: What they measured, shape (N, m).
        of_rows: Information of each, shape (N, D, D).
        rest: Information that is not of these rows, nor of sizes, shape (D, D).
        out: Rows that are left out in turn.
        moves: Columns of a frame, what a slip of :data:`SLIP` is in each, and the first row after it.
    """
    D = G.shape[2]
    pulls = np.einsum("nid,ni->nd", G, y)
    squares, numbers = np.sum(y**2, axis=1), np.any(G != 0.0, axis=2).sum(axis=1)
    H = 1 + len(out) + len(moves)
    information, pull = np.zeros((H, D + 6, D + 6)), np.zeros((H, D + 6))
    information[:, :D, :D], pull[:, :D] = of_rows.sum(axis=0) + rest, pulls.sum(axis=0)
    bad = slice(1, 1 + len(out))
    information[bad, :D, :D] -= of_rows[out]
    pull[bad, :D] -= pulls[out]
    for h, (some, scale, first) in enumerate(moves, start=1 + len(out)):
        of_move = slice(D, D + len(some))
        since = of_rows[first:].sum(axis=0)[:, some] * scale
        information[h, :D, of_move], information[h, of_move, :D] = since, since.T
        information[h, of_move, of_move] = since[some] * scale[:, None]
        pull[h, of_move] = pulls[first:].sum(axis=0)[some] * scale
    without = np.concatenate([[-1], out, np.full(len(moves), -1)]).astype(int)
    own = np.where(without < 0, 0.0, squares[without]), np.where(without < 0, 0, numbers[without])
    return _Equations(information, pull, squares.sum() - own[0], numbers.sum() - own[1])


def _in_sizes(equations: _Equations, prior: np.ndarray, alike: Sequence[np.ndarray]) -> _Estimates:
    """Estimates in sizes that suit them (the fixed point of MacKay 1992).

    Args:
        equations: Of H suppositions.
        prior: Inverse squares of the sizes that no row changes, shape (D + 6,).
        alike: Unknowns that share a size, each group's numbers.
    """
    size = np.tile(prior, (len(equations.pull), 1))
    for some in alike:
        size[:, some] = 1.0
    estimates = _solution(equations, size)
    for _ in range(ROUNDS):
        size = size.copy()
        for some in alike:
            open_share = estimates.covariance[:, some, some] * size[:, some]
            determined = PRIOR_WEIGHT + np.sum(np.maximum(1.0 - open_share, 0.0), axis=1)
            squares = PRIOR_WEIGHT + np.sum(estimates.value[:, some] ** 2, axis=1)
            size[:, some] = (determined / squares)[:, None]
        estimates = _solution(equations, size)
    return estimates


def _solution(equations: _Equations, size: np.ndarray) -> _Estimates:
    """Estimates in given sizes, inverse squares of shape (H, D + 6)."""
    information = equations.information + _diagonals(size)
    covariance = np.linalg.inv(information)
    return _Estimates(size, information, covariance, np.einsum("hde,he->hd", covariance, equations.pull))


def _evidence(
    equations: _Equations, estimates: _Estimates, left: np.ndarray, rest: np.ndarray, alike: Sequence[np.ndarray]
) -> np.ndarray:
    r"""Logarithm of the density of the rows under each supposition, but for a constant, shape (H,).

    With q what is left of the squares, n numbers, nu of :data:`SCATTER_WEIGHT`, and information :math:`P` before and
    :math:`M` after the rows, sizes s and their weight w of :data:`PRIOR_WEIGHT`,

    .. math:: \frac12 \log \frac{|P|}{|M|} + \log \Gamma(\tfrac{\nu + n}{2}) - \tfrac n2 \log \tfrac\nu2
              - \tfrac{\nu + n}{2} \log(1 + q / \nu) + \tfrac w2 \sum (\log s^{-2} - s^{-2})
    """
    before = _diagonals(estimates.size)
    before[:, : len(rest), : len(rest)] += rest
    nu, n = SCATTER_WEIGHT, equations.numbers
    evidence = 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(estimates.information)[1])
    evidence += gammaln((nu + n) / 2.0) - n / 2.0 * np.log(nu / 2.0) - (nu + n) / 2.0 * np.log1p(left / nu)
    for some in alike:
        evidence += PRIOR_WEIGHT / 2.0 * (np.log(estimates.size[:, some[0]]) - estimates.size[:, some[0]])
    return np.asarray(evidence)


def _beside(
    G: np.ndarray, y: np.ndarray, value: np.ndarray, covariance: np.ndarray, left: float, numbers: int
) -> tuple[float, float]:
    """A row beside all others: the logarithm of its density if it is bad, and the chance of a good one to be off as much.

    Args:
        G: Its columns, shape (m, D).
        y: What it measured, shape (m,).
        value: The unknowns as all others tell them, shape (D + 6,).
        covariance: Of these.
        left: Squares that are left of the others.
        numbers: How many numbers they are.
    """
    measured, D = np.any(G != 0.0, axis=1), G.shape[1]
    error = (y - G @ value[:D])[measured]
    spread = np.eye(len(error)) + G[measured] @ covariance[:D, :D] @ G[measured].T
    spread *= max(1.0, (SCATTER_WEIGHT + left) / (SCATTER_WEIGHT + numbers))
    bad = log_mean([log_density(error, spread + by**2 * np.eye(len(error))) for by in BAD_SIZES])
    square = float(error @ np.linalg.solve(spread, error))
    if square <= CLEARLY**2 * len(error):
        return bad, 1.0
    return bad, float(exceeded(square, len(error), SCATTER_WEIGHT + float(numbers)))


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
