r"""Is the target where the calibration says, to within a tolerance, in 95 % of a region: how likely, and how near it is.

The error at a place has two parts. That of the calibration, :math:`J \delta` with :math:`\delta \sim N(0, \Sigma)`, is common to
all places. What goes beyond it (what the model lacks, what the arm does not repeat) is of its own at each, with a mean square
:math:`3 b^2` that rows never fitted tell: with the mean square :math:`s^2` of their residuals, the instrument's
declared noise :math:`\sigma` and the calibration's own variance there,

.. math:: b^2 = s^2 \, \nu / \chi^2_\nu - \sigma^2 - \overline{(J \Sigma J^T)}, \qquad b^2 \ge 0

where :math:`\chi^2_\nu` is drawn, so that few rows leave b open. Noise that nobody declared, or
that cannot be as large as declared, counts as the robot's. Each of many
draws of all that gives one error that 95 % of the region stay below; of these, the one that 95 % of the draws stay below is what
the region keeps within with 95 % confidence. Places where nothing was measured, or which no reading tells, are never within.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import betainc, betaincinv

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.noise import WORTH_SAYING, RepeatScatter
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import spread
from aridcal.engine.levels import DOUBT
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.target_uncertainty import target_view
from aridcal.engine.trust.workspace import Knowledge, Workspace

SHARE = 0.95
"""Share of the region that must be within. Convention."""

CONFIDENCE = 0.95
"""How sure that must be: of calibrations that are said to be within, at most one in twenty is not. Convention."""

MODEL_ERROR_DRAWS = 400
"""Work: Of the calibration's error: the 95th percentile of what they give is then that of 93 to 97 % of all."""

AXES_OF_A_PLACE = 3
"""Work: Of a place, or of a turn."""

NOISE_UNKNOWN_SENTENCE = (
    "the instrument's noise is not declared, or cannot be what is declared: all that scatters counts as the robot's"
)
"""What is said of it."""


@dataclass(frozen=True)
class ExcessError:
    """Error of rows beyond the calibration's own uncertainty, along each axis, as seen from the target.

    Attributes:
        squares: Mean square of the residuals, [m²] or [rad²].
        noise: Mean variance of the instrument's declared noise.
        model: Mean variance of the prediction.
        freedom: Degrees of freedom behind ``squares``.
        size: Length of each row's residual, shape (n,), [m] or [rad]; infinite for outliers, since nobody knows whether the
            instrument failed there.
        declared: False where nothing says what the instrument's noise is.
        held_out: False where no row was held out: the residuals are then those of fitted rows.
    """

    squares: float
    noise: float
    model: float
    freedom: float
    size: np.ndarray
    declared: bool
    held_out: bool

    @property
    def sigma(self) -> float:
        """Most likely standard deviation, [m] or [rad]."""
        return float(np.sqrt(max(self.squares - self.noise - self.model, 0.0)))

    def drawn(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Standard deviations that the squares allow, drawn at random, shape (count,), [m] or [rad]."""
        squares = self.squares * self.freedom / rng.chisquare(self.freedom, count)
        return np.asarray(np.sqrt(np.maximum(squares - self.noise - self.model, 0.0)))


@dataclass(frozen=True)
class ToleranceAnswer:
    """The tolerance that a region keeps.

    Attributes:
        of: ``position`` or ``rotation``.
        tolerance: The campaign's tolerance, [m] or [rad]; None where it has none.
        bound: What 95 % of the region are within, with 95 % confidence; infinite where more than 5 % of it were not measured.
        share: Share of the region that is likely within the tolerance, 0 to 1; NaN without a tolerance.
        confidence: Probability that 95 % of the region are within it; NaN without a tolerance.
        calibration: RMS length of the calibration's error over the part that was measured.
        excess: RMS length of the error beyond that of the calibration.
        measured: Share of the region where similar configurations were measured.
        observable_share: Share of the region where the readings tell the target.
        rows: Number of rows that judge: the held-out ones, if there are any.
        held_out: False where no row was held out.
        rows_within: Number of judging rows within the tolerance, the instrument's noise included.
        rows_share: Share of such rows that is within at least, with 95 % confidence (Clopper and Pearson 1934).
        reasons: Why the region is not within, in words; empty where it is, or where there is no tolerance.
        remarks: Assumptions, in words.
    """

    of: str
    tolerance: float | None
    bound: float
    share: float
    confidence: float
    calibration: float
    excess: float
    measured: float
    observable_share: float
    rows: int
    held_out: bool
    rows_within: int
    rows_share: float
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def judges(self) -> str:
        """The name of the rows that judge."""
        return "held-out rows" if self.held_out else "fitted rows"

    @property
    def gap(self) -> str:
        """Why nothing can be said of a part of the region, in words."""
        if self.observable_share < SHARE:
            return (
                f"no reading tells a part of what moves the target{' in some of it' if self.observable_share else ''}"
            )
        return f"{100 * (1.0 - self.measured):.0f} % of that was not measured"

    @property
    def within(self) -> bool | None:
        """The answer; None where no tolerance was given."""
        return None if self.tolerance is None else not self.reasons


def instrument_noise(fit: Fit, rows: Dataset, repeats: RepeatScatter | None) -> np.ndarray:
    """Noise of each channel per axis that may be blamed on the instrument, shape (C,); 0 where it is not declared.

    It is the declared noise, but no more than the scatter of repeats, and 0 where the rows fit so well that the declared noise
    cannot be true: an error of the robot would hide in it.

    Args:
        fit: The final model.
        rows: All rows.
        repeats: Scatter of rows that repeat a configuration, where there are any.
    """
    declared_sigma = np.array([sigma or 0.0 for sigma in rows.sigma])
    true = fit.estimated > declared_sigma * np.exp(-WORTH_SAYING)
    scatter = np.inf if repeats is None else np.nan_to_num(repeats.sigma, nan=np.inf)
    return np.where(true, np.minimum(declared_sigma, scatter), 0.0)


def excess_error(
    fit: Fit,
    rows: Dataset,
    judging: np.ndarray,
    outlier: np.ndarray,
    residual: np.ndarray,
    noise: np.ndarray,
    tool: Sequence[float],
    turn: bool,
) -> ExcessError | None:
    """Error of the judging rows beyond the calibration; None where no row tells it.

    Of a point beside the target both the shift and the turn that explain a row count, together.

    Args:
        fit: The final model.
        rows: All N rows.
        judging: Rows that judge, shape (N,) bool.
        outlier: Flagged rows, shape (N,) bool.
        residual: Measured minus predicted of all rows, shape (N, m).
        noise: See :func:`instrument_noise`.
        tool: The point, in the target's axes, [m].
        turn: True for the rotation, False for the position.
    """
    flagged = np.full(int((judging & outlier).sum()), np.inf)
    judging = judging & ~outlier
    judging_rows = rows.select(judging)
    if not len(judging_rows):
        return None
    fit_problem = problem(fit.model, judging_rows).settled(fit.theta)
    view = target_view(fit, judging_rows)
    sigma = spread(noise, rows.channels)
    size, squares, scatter, model, ranks = np.full((5, len(judging_rows)), np.nan)
    residuals, declared = residual[judging], True
    for block in fit_problem.blocks():  # of all rows at once the covariances alone would take 288 bytes a row
        covariance = fit_problem.carried(fit.theta, fit.covariance, block)
        arm = fit.model.poses(fit.theta, fit_problem.rows[block])[0] @ np.asarray(tool, dtype=float)
        for lever in view.levers:
            first, last = np.searchsorted(lever.rows, (block.start, block.stop))
            some, in_block = lever.rows[first:last], lever.rows[first:last] - block.start
            by = lever.turn[first:last]
            if not turn:
                by = lever.shift[first:last] + np.cross(by, arm[in_block][:, :, None], axis=1)
            rank = np.linalg.matrix_rank(by)
            some, in_block, by, rank = some[rank > 0], in_block[rank > 0], by[rank > 0], rank[rank > 0]
            if not len(some):
                continue
            felt = np.abs(by).max(axis=(0, 1)) > 0.0
            declared &= bool(np.all(sigma[lever.part][felt] > 0.0))
            off = np.einsum("nij,nj->ni", by, residuals[some, lever.part])
            part = covariance[in_block][:, lever.part, lever.part]
            size[some], ranks[some] = np.linalg.norm(off, axis=1), rank
            squares[some] = np.sum(off**2, axis=1)
            scatter[some] = np.sum((by * sigma[lever.part]) ** 2, axis=(1, 2))
            model[some] = np.einsum("nij,njk,nik->n", by, part, by)
    with_size = np.isfinite(size)
    if not with_size.any():
        return None
    count = float(ranks[with_size].sum())
    per_row = squares[with_size] / ranks[with_size]
    configurations = len(np.unique(judging_rows.repeats.configuration[with_size]))
    # Rows whose squares vary more than those of normal errors count for fewer, and repeats of a configuration for one.
    wild = max(
        1.0, float(np.var(per_row) / max(np.mean(per_row) ** 2, np.finfo(float).tiny)) * count / with_size.sum() / 2.0
    )
    held_out = bool(rows.test[judging].any())
    if not held_out and fit.freedom < 1.0:  # not one measured number is left over that the calibration was not bent to
        return None
    free = 1.0 if held_out else fit.freedom / fit.numbers
    return ExcessError(
        squares=float(squares[with_size].sum() / count) / free,
        noise=float(scatter[with_size].sum() / count) if declared else 0.0,
        model=float(model[with_size].sum() / count) if held_out else 0.0,
        freedom=free * count * configurations / with_size.sum() / wild,
        size=np.concatenate([size[with_size], flagged]),
        declared=declared,
        held_out=held_out,
    )


def tolerance_answer(
    known_model: Knowledge,
    region: Workspace,
    moves: tuple[np.ndarray, np.ndarray],
    excess: ExcessError | None,
    tolerance: float | None,
    turn: bool,
) -> ToleranceAnswer | None:
    """What a region keeps within; None where no row tells the error beyond the calibration.

    Args:
        known_model: The calibrated model.
        region: The configurations, R of them.
        moves: Columns of the shift of a point on the target and of the turn, with the coefficients (R, 6, K) and with what is
            open (R, 6, D); see :meth:`Knowledge.columns`.
        excess: Error of the rows beyond the calibration.
        tolerance: [m] or [rad]; None where the campaign has none.
        turn: True for the rotation, False for the position.
    """
    if excess is None:
        return None
    part = slice(3, 6) if turn else slice(0, 3)
    rng = np.random.default_rng(0)
    by_coefficients, by_open = moves
    off = _drawn(by_coefficients[:, part], known_model.fit.covariance, rng) + _drawn(
        by_open[:, part], known_model.open, rng
    )
    off += _beyond(excess, off.shape, rng)
    determined = region.turns_told if turn else region.observable
    known_places = region.measured & determined
    length = np.where(known_places[:, None], np.linalg.norm(off, axis=1), np.inf)
    quantiles = np.quantile(length, SHARE, axis=0, method="higher")
    bound = float(np.quantile(quantiles, CONFIDENCE, method="higher"))
    variance = np.einsum("nii->n", region.turns if turn else region.covariance)[known_places]
    remarks = [] if excess.declared else [NOISE_UNKNOWN_SENTENCE]
    if not excess.held_out:
        remarks.append("no row was held out: what goes beyond the calibration is that of the fitted rows")
    answer = ToleranceAnswer(
        of="rotation" if turn else "position",
        tolerance=tolerance,
        bound=bound,
        share=float("nan"),
        confidence=float("nan"),
        calibration=float(np.sqrt(variance.mean())) if known_places.any() else float("nan"),
        excess=float(np.sqrt(AXES_OF_A_PLACE) * excess.sigma),
        measured=float(region.measured.mean()),
        observable_share=float(determined.mean()),
        rows=len(excess.size),
        held_out=excess.held_out,
        rows_within=0,
        rows_share=float("nan"),
        reasons=(),
        remarks=tuple(remarks),
    )
    if tolerance is None:
        return answer
    with_noise = np.linalg.norm(
        off[known_places] + np.sqrt(excess.noise) * rng.standard_normal(off[known_places].shape), axis=1
    )
    usual = float(np.mean(with_noise > tolerance)) if known_places.any() else 1.0
    within, count = int((excess.size <= tolerance).sum()), len(excess.size)
    confidence = float(np.mean(quantiles <= tolerance))
    reasons = [] if bound <= tolerance else [_why(answer)]
    beyond = count - within
    # probability of so many or more by chance: the binomial tail (DLMF 8.17.5)
    if beyond and betainc(beyond, within + 1, max(1.0 - SHARE, usual)) <= DOUBT:
        reasons.append(f"{beyond} of {count} {answer.judges} are off by more, which is more than this explains")
    return replace(
        answer,
        share=float(np.mean(length <= tolerance)),
        confidence=confidence,
        rows_within=within,
        rows_share=float(betaincinv(within, count - within + 1, 1.0 - CONFIDENCE)) if within else 0.0,
        reasons=tuple(reasons),
    )


def no_answer(of: str, tolerance: float) -> ToleranceAnswer:
    """The answer where a tolerance was given, and no row tells anything of it."""
    nan = float("nan")
    reasons = (f"no row tells the target's {of}",)
    return ToleranceAnswer(of, tolerance, np.inf, 0.0, 0.0, nan, nan, 0.0, 0.0, 0, True, 0, nan, reasons, ())


def _drawn(columns: np.ndarray, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Errors by coefficients drawn from their covariance, shape (R, 3, draws), from columns of shape (R, 3, K)."""
    values, vectors = np.linalg.eigh(covariance)
    # The symmetric root is the same whatever signs rounding gives the vectors.
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    flat = columns.reshape(columns.shape[0] * columns.shape[1], len(root))
    return np.asarray(flat @ (root @ rng.standard_normal((len(root), MODEL_ERROR_DRAWS)))).reshape(
        *columns.shape[:2], MODEL_ERROR_DRAWS
    )


def _beyond(excess: ExcessError, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """What goes beyond the calibration, shape (R, 3, draws): normal along a direction drawn at each place.

    Joints that do not repeat, and most that a model lacks, move a place more one way than another, which nobody knows. Of all
    normal errors of one mean square those along one line have the longest tail: 95 % are within 1.96 of its roots, and within
    1.61 of those that go all ways alike.
    """
    direction = rng.standard_normal(shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = np.sqrt(AXES_OF_A_PLACE) * excess.drawn(shape[2], rng) * rng.standard_normal((shape[0], 1, shape[2]))
    return np.asarray(direction * size)


def _why(answer: ToleranceAnswer) -> str:
    """Why a region is not within its tolerance, as far as the calibration's own figures say it."""
    if np.isinf(answer.bound):
        return answer.gap
    unit = "mrad" if answer.of == "rotation" else "mm"
    return f"only {1e3 * answer.bound:.3g} {unit} can be said with {100 * CONFIDENCE:.0f} % confidence"
