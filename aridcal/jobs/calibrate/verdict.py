"""The verdict: one decision from all tests of the residual, which every sentence on what remains repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.corrections.effect import Effect
from aridcal.engine.fit.flags import MEASURED_COORDINATE, Cluster, cluster
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import spread
from aridcal.engine.levels import FEWEST_TOGETHER, SEVERAL
from aridcal.engine.numerics import FLOOR
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.search.loop import LEAST_NUMBERS_LEFT
from aridcal.engine.search.noise_tests import Clue

MANY_FLAGGED = 0.03
"""Share of flagged held-out rows above which nobody may say that only noise is left: a sound setup loses some rows in a
thousand, and what is flagged away is not explained."""

NOISE_UNKNOWN = "noise_unknown"
"""Reservation to ``noise_floor``: nobody has declared the noise, and no repeats show it."""


@dataclass(frozen=True)
class Wording:
    """A verdict in words.

    Attributes:
        cell: In a table of many calibrations.
        line: On the screen.
        sentences: In the report, with what to do.
    """

    cell: str
    line: str
    sentences: str


VERDICTS = {
    "noise_floor": Wording(
        "noise alone remains",
        "the remaining error is consistent with the noise",
        "The remaining error is consistent with the measurement noise. Nothing repeatable is left to model.",
    ),
    "structure_remains": Wording(
        "structure remains",
        "a repeatable error remains",
        "A repeatable error remains that the model does not describe. Section 5 shows what drives it.",
    ),
    "not_enough_data": Wording(
        "too few data",
        "too few data for this model",
        "There are too few data for a model of this size. Measure more rows, spread over more of each joint's range, or "
        "identify fewer parameters.",
    ),
}
"""Verdicts in words, by their names in ``result.json``."""


@dataclass(frozen=True)
class Verdict:
    """The decision on what remains.

    Attributes:
        word: A key of :data:`VERDICTS`.
        share: Share of the remaining variance that is repeatable beyond the noise, 0 to 1.
        reasons: Why it is not ``noise_floor``, in words; with ``noise_floor`` :data:`NOISE_UNKNOWN`, or none.
    """

    word: str
    share: float
    reasons: tuple[str, ...]

    @property
    def for_controller(self) -> bool:
        """False where too few numbers judge the model to command a robot by it."""
        return self.word != "not_enough_data"

    @property
    def noise_unknown(self) -> bool:
        """True where the rows show nothing repeatable, and the noise of the instrument is not known."""
        return NOISE_UNKNOWN in self.reasons


def decide(
    clues: Sequence[Clue], effects: Sequence[Effect], freedom: float, noise_known: bool, setting: str = ""
) -> Verdict:
    """The verdict.

    Args:
        clues: Answers of all tests of the residual.
        effects: Effects in the model.
        freedom: Degrees of freedom, as a share of the measured numbers.
        noise_known: Whether the noise of every channel was declared, or repeats show it.
        setting: Fault that the campaign itself seems to have, in words; said first, for it may cause the others; else empty.
    """
    telling = [c for c in clues if c.tells]
    share = max((c.share for c in telling), default=0.0)
    reasons = [*([setting] if setting else []), *(c.what for c in telling)]
    unnamed = [e for e in effects if not EFFECT_KINDS[e.kind].named]
    if unnamed:
        # Between and beyond the rows a smooth curve without a cause is not known.
        of = ", ".join(dict.fromkeys(f"{e.where} by {e.by or ' and '.join(e.covariates)}" for e in unnamed))
        reasons.append(f"a repeatable error has no known cause ({of})")
    if freedom <= LEAST_NUMBERS_LEFT:
        few = f"only {100 * max(freedom, 0.0):.0f} % of the measured numbers are left to judge the model by"
        return Verdict("not_enough_data", share, (few, *reasons))
    if reasons:
        return Verdict("structure_remains", share, tuple(reasons))
    return Verdict("noise_floor", share, () if noise_known else (NOISE_UNKNOWN,))


def row_clues(rows: Dataset, fit: Fit, residual: np.ndarray, outlier: np.ndarray) -> list[Clue]:
    """Clues from held-out rows and flagged rows against the model.

    Args:
        rows: All N rows.
        fit: The final model.
        residual: Of all rows, scaled by their relative sigmas, shape (N, m).
        outlier: Flagged rows, shape (N,) bool.
    """
    judging = rows.test & ~_beside_steps(rows, fit)
    answers = [
        _held_out(rows, judging & ~outlier, fit, residual, outlier),
        _offset(residual[~outlier]),
        _many_flagged(judging, residual, outlier),
        _together(rows, residual, outlier),
    ]
    return [clue for clue in answers if clue is not None]


def _beside_steps(rows: Dataset, fit: Fit) -> np.ndarray:
    """Held-out rows between the last fitted row before a step and the first after it, shape (N,) bool.

    No fitted row tells on which side of the step they are, so that they cannot speak against the model.
    """
    beside = np.zeros(len(rows), dtype=bool)
    for step in dict.fromkeys(c.basis for c in fit.model.coefficients if c.basis.form == "step"):
        values, at = rows.conditions[step.of[0]], step.numbers[0]
        fitted = values[rows.train]
        last, first = (
            np.max(fitted, where=fitted < at, initial=-np.inf),
            np.min(fitted, where=fitted >= at, initial=np.inf),
        )
        beside |= rows.test & (values > last) & (values < first)
    return beside


def _held_out(rows: Dataset, test: np.ndarray, fit: Fit, residual: np.ndarray, outlier: np.ndarray) -> Clue | None:
    r"""Do held-out rows err more than the noise of the fitted ones and the model's own uncertainty explain?

    With :math:`q = r^T D^{-1} r / m` of a held-out row, D the diagonal of its predicted variance
    :math:`\sigma_c^2 + (J \Sigma J^T)`, the mean of q follows :math:`F(n m / \kappa, \nu / \kappa)`, n configurations held
    out, :math:`\nu` the degrees of freedom of the fit. :math:`\kappa`, how much more the fitted rows' squares vary than
    those of normal noise, keeps heavy tails from being taken for a difference.
    """
    train = rows.train & ~outlier
    configurations = len(np.unique(held_back_groups(rows)[test]))
    if configurations < FEWEST_TOGETHER or fit.freedom <= 0:
        return None
    m = float(np.mean(np.sum(~np.isnan(residual[train]), axis=1)))
    variance = spread(fit.estimated**2, rows.channels)
    expected = variance + _model_variance(rows.select(test), fit)
    ratio = float(np.nanmean(np.nanmean(residual[test] ** 2 / expected, axis=1)))
    fitted = np.nanmean(residual[train] ** 2 / variance, axis=1)
    kappa = max(1.0, float(np.var(fitted) / np.mean(fitted) ** 2) * m / 2.0)
    p_value = float(fdtrc(configurations * m / kappa, fit.freedom / kappa, ratio))
    what = f"held-out rows err {np.sqrt(ratio):.2g} times as much as the noise of the fitted rows explains"
    return Clue("held_out", what, float(np.clip(1.0 - 1.0 / max(ratio, FLOOR), 0.0, 1.0)), p_value)


def _offset(residual: np.ndarray) -> Clue | None:
    """Is the mean of the residuals zero? With frames and constants held it need not be (Hotelling's T squared)."""
    n, m = residual.shape
    if n <= m + 1 or np.isnan(residual).any():
        return None
    mean = residual.mean(axis=0)
    spread_of_mean = np.atleast_2d(np.cov(residual.T)) / n
    statistic = float(mean @ np.linalg.pinv(spread_of_mean, hermitian=True) @ mean)
    p_value = float(fdtrc(m, n - m, statistic * (n - m) / (m * (n - 1))))
    share = float(np.mean(mean**2 / np.maximum(np.mean(residual**2, axis=0), FLOOR**2)))
    return Clue(
        "offset", "the mean of the residuals is not zero: something constant is held at a wrong value", share, p_value
    )


def _model_variance(rows: Dataset, fit: Fit) -> np.ndarray:
    """Variance of the prediction by the coefficients' covariance, scaled as the residuals, shape (N, m)."""
    fit_problem = problem(fit.model, rows).settled(fit.theta)
    parts = []
    for block in fit_problem.blocks():
        parts.append(np.einsum("nmm->nm", fit_problem.carried(fit.theta, fit.covariance, block)))
    return np.concatenate(parts)


def _many_flagged(test: np.ndarray, residual: np.ndarray, outlier: np.ndarray) -> Clue | None:
    """Are more held-out rows flagged than a sound setup loses?"""
    held_out, flagged = int(test.sum()), int((test & outlier).sum())
    if flagged < SEVERAL or flagged <= MANY_FLAGGED * held_out:
        return None
    what = (
        f"{flagged} of {held_out} held-out rows are flagged as outliers: no figure without them speaks for these rows"
    )
    squares = _squares(residual, outlier)
    return Clue("flags", what, float(squares[test & outlier].sum() / squares[test].sum()), 0.0)


def _together(rows: Dataset, residual: np.ndarray, outlier: np.ndarray) -> Clue | None:
    """Do flagged rows lie together? Then what is wrong there is repeatable."""
    group = cluster(outlier, rows)
    if group is None:
        return None
    squares = _squares(residual, outlier)
    share = float(squares[group.rows].sum() / squares.sum())
    return Clue(
        "flags",
        f"{group.rows.sum()} of {outlier.sum()} flagged rows lie together: {cluster_in_words(group)}",
        share,
        group.p_value,
    )


def _squares(residual: np.ndarray, outlier: np.ndarray) -> np.ndarray:
    """Square of each row's residual (N, m) in units of the mean square of the rows that are not flagged, shape (N,)."""
    usual = np.nanmean(residual[~outlier] ** 2, axis=0)
    return np.asarray(np.nansum(residual**2 / np.maximum(usual, FLOOR**2), axis=1))


def cluster_in_words(group: Cluster) -> str:
    """The place of a cluster in words: ``joint_2 between 0.31 and 0.52``."""
    if group.coordinate == MEASURED_COORDINATE:
        return "where the same is measured"
    if group.coordinate == "row":
        return f"rows {group.low + 1:.0f} to {group.high + 1:.0f} of those used"
    return f"{group.coordinate} between {group.low:.4g} and {group.high:.4g}"
