"""Trends of the residual: over each joint as its own motion, over every measured column, and in the order of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtr

from aridcal.engine.corrections.loads import covariate_table
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import problem, scaled
from aridcal.engine.fit.residual import scaled_columns
from aridcal.engine.instruments.channels import spread
from aridcal.engine.levels import FAINT_LEVER_SHARE, SLIGHT
from aridcal.engine.numerics import FLOOR, TINY
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_tests import rms_of_channels
from aridcal.system.progress import SILENT, Progress

SLICE, MOST_SLICES = 20, 48
"""Drawn: Rows of a slice at the least, for its mean to be known to a fifth of the scatter; slices at the most, to be drawn."""

FEW_VALUES = 12
"""Drawn: A column with no more different values has one slice for each: they are settings, not readings."""

CURVE = 120
"""Drawn: Points of a smooth curve."""

TREND_LENGTHS = (0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
"""Drawn: Over which a smooth curve may be alike, in shares of the covariate's range: about an octave apart."""

LAGS = 30
"""Drawn: Rows apart at the most for which a correlation is shown."""

BAND = 1.96
"""Drawn: Standard deviations within which 95 % of chance lies."""


@dataclass(frozen=True)
class Course:
    """Motion that explains each row's residual with one model, and its course over a covariate.

    Attributes:
        rows: Motion of each row, shape (n,), [m] or [rad].
        mean: Mean of each slice, shape (B,).
        smooth: A smooth curve through the means, shape (G,).
        size: RMS of the means beyond their noise.
        p_value: Chance that slices of noise differ from zero as much.
    """

    rows: np.ndarray
    mean: np.ndarray
    smooth: np.ndarray
    size: float
    p_value: float


@dataclass(frozen=True)
class Trace:
    """Residuals over a covariate, as the motion that explains each row by itself.

    Attributes:
        motion: A joint, for its own axis, or an axis of a channel: ``x y z rx ry rz``.
        unit: ``m`` or ``rad``.
        covariate: A joint, a measured column, or a load.
        covariate_values: Covariate of the rows that this motion moves, shape (n,).
        centre: Covariate of slices of these rows, shape (B,).
        std: Standard deviation that noise gives the means of the slices, shape (B,).
        at: Covariate at which the smooth curves through the means were evaluated, shape (G,).
        before: Without effects.
        after: With the final model.
    """

    motion: str
    unit: str
    covariate: str
    covariate_values: np.ndarray
    centre: np.ndarray
    std: np.ndarray
    at: np.ndarray
    before: Course
    after: Course


@dataclass(frozen=True)
class Order:
    """The final model's residuals one after the other.

    Attributes:
        timed: True if the order is that of a column ``time``, False if it is that of the table.
        lags: Rows apart, shape (L,).
        correlation: Of residuals so many rows apart, mean of the axes, shape (L,).
        bound: Bound within which 95 % of such correlations lie if residuals are noise.
        changes: Changes of sign from one row to the next, all axes together.
        expected: Mean number of these if residuals are noise.
        spread: Standard deviation of that number.
        p_value: Chance that noise makes so few.
    """

    timed: bool
    lags: np.ndarray
    correlation: np.ndarray
    bound: float
    changes: int
    expected: float
    spread: float
    p_value: float


@dataclass(frozen=True)
class Traces:
    """Trends of the residual of the final model.

    Attributes:
        joints: Each joint's own motion over its own position.
        strongest: For each joint, load and column, the motion that depends on it most clearly.
        pairs_tested: Number of pairs of a motion and a covariate that these were chosen from.
        order: Residuals in the order of time.
    """

    joints: tuple[Trace, ...]
    strongest: tuple[Trace, ...]
    pairs_tested: int
    order: Order


@dataclass(frozen=True)
class _Pull:
    """Motion that explains each row's residual by itself, before and after; ``weight`` is 1 / its variance by noise."""

    motion: str
    unit: str
    before: np.ndarray
    after: np.ndarray
    weight: np.ndarray


def trace(fit: Fit, rows: Dataset, before: np.ndarray, after: np.ndarray, progress: Progress = SILENT) -> Traces:
    """Trace residuals to joints, columns and time.

    Args:
        fit: The final model.
        rows: The N rows in use.
        before: Residuals of the model without effects, shape (N, m), [m] and [rad].
        after: Residuals of the final model.
        progress: Called with the number of covariates done.
    """
    robot = fit.model.robot
    pulls, world = _pulls(fit, rows, before, after)
    motions = {p.motion: p for p in pulls}
    measured = {name: values for name, values in rows.covariates.items() if name not in rows.origin.derived}
    complete = {name: values for name, values in measured.items() if np.isfinite(values).all()}
    table = covariate_table(robot, rows.readings, complete, fit.model.around, world, {".gravity_"})
    covariates = {name: v for name, v in table.items() if _varies(v) and ".gravity_moment" not in name}
    return Traces(
        joints=tuple(
            _trace(motions[name], name, covariates[name])
            for name in robot.names
            if name in motions and name in covariates
        ),
        strongest=tuple(
            _strongest(pulls, name, covariates[name]) for name in progress.over(list(covariates), "covariates")
        ),
        pairs_tested=len(pulls) * len(covariates),
        order=_order_of_time(after, rows),
    )


def _varies(values: np.ndarray) -> bool:
    return float(np.ptp(values)) > SLIGHT * float(np.abs(values).max())


def _pulls(fit: Fit, rows: Dataset, before: np.ndarray, after: np.ndarray) -> tuple[list[_Pull], np.ndarray]:
    r"""Residuals pulled back to each joint's own axis, row by row, and along the axes of each channel; and the rows' base frames.

    Weighted least squares in one unknown: with J the joint's column and r the residual, both in sigmas, a row's motion is
    :math:`J^T r / J^T J`, of variance :math:`1 / J^T J`.
    """
    robot = fit.model.robot
    question = problem(fit.model.with_motions(fit.model.own_motions), rows)
    theta = np.concatenate([fit.theta, np.zeros(len(robot.joints))])
    before_scaled, after_scaled = (np.nan_to_num(scaled(r, rows.relative)) for r in (before, after))
    # The noise that the residual shows, not the declared one: a pattern is sought, whatever the size.
    sigma = spread(np.maximum(rms_of_channels(after_scaled, rows), FLOOR), rows.channels)
    J = scaled_columns(question, theta, len(robot.joints)) / sigma[:, None]
    pulls = []
    for k, joint in enumerate(robot.joints):
        lever = np.sum(J[:, :, k] ** 2, axis=1)
        weight = np.where(lever > FAINT_LEVER_SHARE * np.median(lever), lever, 0.0)
        if weight.any():
            pull_before, pull_after = (
                np.sum(J[:, :, k] * r / sigma, axis=1) / np.maximum(lever, TINY) for r in (before_scaled, after_scaled)
            )
            pulls.append(_Pull(joint.name, "rad" if joint.kind == "revolute" else "m", pull_before, pull_after, weight))
    axes = [(axis, channel.unit) for channel in rows.channels for axis in channel.axes]
    for k, (axis, unit) in enumerate(axes):
        present = ~np.isnan(after[:, k])
        weight = np.where(
            present, 1.0 / max(float(np.nanmean(after[:, k] ** 2)) if present.any() else 0.0, FLOOR**2), 0.0
        )
        pulls.append(_Pull(axis, unit, np.nan_to_num(before[:, k]), np.nan_to_num(after[:, k]), weight))
    return pulls, question.rows.world


def _strongest(pulls: Sequence[_Pull], covariate: str, values: np.ndarray) -> Trace:
    """The motion whose dependence on a covariate noise explains least."""
    chances, sliced = [], {}
    for p in pulls:
        key = (p.weight > 0).tobytes()
        if key not in sliced:  # motions share few sets of rows
            sliced[key] = _sliced(p, values)
        chances.append(_p_value(_means(p, values, p.after, sliced[key])))
    return _trace(pulls[int(np.argmin(chances))], covariate, values)


def _trace(pull: _Pull, covariate: str, values: np.ndarray) -> Trace:
    """A motion over a covariate, before and after."""
    informed = pull.weight > 0
    sliced = _sliced(pull, values)
    before, after = (_means(pull, values, motion_of_rows, sliced) for motion_of_rows in (pull.before, pull.after))
    at = np.linspace(after.centre[0], after.centre[-1], CURVE)

    def course(motion_of_rows: np.ndarray, means: _Means) -> Course:
        return Course(
            motion_of_rows[informed], means.mean, _smooth(means, at), _rms_beyond_noise(means), _p_value(means)
        )

    course_before, course_after = course(pull.before, before), course(pull.after, after)
    return Trace(
        pull.motion, pull.unit, covariate, values[informed], after.centre, after.std, at, course_before, course_after
    )


@dataclass(frozen=True)
class _Means:
    """Slices of rows: mean covariate, weighted mean of the rows' motion, and its noise; shape (B,) each."""

    centre: np.ndarray
    mean: np.ndarray
    std: np.ndarray


def _sliced(pull: _Pull, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the rows that a motion moves, in the order of a covariate, shape (n,), and the slice of each, shape (n,)."""
    informed = np.flatnonzero(pull.weight > 0)
    informed = informed[np.argsort(values[informed], kind="stable")]
    different, place = np.unique(values[informed], return_inverse=True)
    if len(different) > FEW_VALUES:
        place = np.arange(len(informed)) * int(np.clip(len(informed) // SLICE, 1, MOST_SLICES)) // len(informed)
    return informed, place


def _means(
    pull: _Pull, values: np.ndarray, motion_of_rows: np.ndarray, sliced: tuple[np.ndarray, np.ndarray]
) -> _Means:
    """Means of slices; these have equally many rows, or one value each of a column with few."""
    informed, place = sliced
    weight = pull.weight[informed]
    total = np.bincount(place, weight)
    centre, mean = (np.bincount(place, weight * v[informed]) / total for v in (values, motion_of_rows))
    return _Means(centre, mean, 1.0 / np.sqrt(total))


def _p_value(m: _Means) -> float:
    """Chance that noise alone makes such means."""
    return float(chdtrc(len(m.mean), np.sum((m.mean / m.std) ** 2)))


def _rms_beyond_noise(m: _Means) -> float:
    """RMS of the means, less the part by noise."""
    weight = 1.0 / m.std**2
    return float(np.sqrt(max(weight @ m.mean**2 - len(weight), 0.0) / weight.sum()))


def _smooth(m: _Means, at: np.ndarray) -> np.ndarray:
    """The likeliest smooth function through the means (Gaussian process, Matern 5/2); zero where they are noise."""
    variance = _rms_beyond_noise(m) ** 2
    span = float(np.ptp(m.centre))
    if variance == 0.0 or span == 0.0:
        return np.zeros(len(at))

    def kernel(x: np.ndarray, length: float) -> np.ndarray:
        d = np.sqrt(5.0) * np.abs(x[:, None] - m.centre) / (length * span)
        return np.asarray(variance * (1.0 + d + d**2 / 3.0) * np.exp(-d))

    best, curve = -np.inf, np.zeros(len(at))
    for length in TREND_LENGTHS:
        K = kernel(m.centre, length) + np.diag(m.std**2)
        pull = np.linalg.solve(K, m.mean)
        likelihood = -0.5 * float(m.mean @ pull + np.linalg.slogdet(K)[1])
        if likelihood > best:
            best, curve = likelihood, kernel(at, length) @ pull
    return curve


def _order_of_time(residual: np.ndarray, rows: Dataset) -> Order:
    """Changes of sign, and correlation over so many rows, in the order of time (of the table, where there is none)."""
    # Each number of the rows that measure it, one after the other: a missing number is no change of sign.
    series = [r[~np.isnan(r)] for r in residual[rows.sequence].T]
    series = [r for r in series if len(r) > 1]
    lags = np.arange(1, min((len(r) // 4 for r in series), default=0) + 1)[:LAGS]
    correlation = np.array([np.mean([r[k:] @ r[:-k] / max(float(r @ r), 1e-300) for r in series]) for k in lags])
    changes = sum(int(np.sum(np.diff(np.sign(r)) != 0)) for r in series)
    pairs, numbers = sum(len(r) - 1 for r in series), sum(len(r) for r in series)
    expected, deviation = pairs / 2, float(np.sqrt(pairs) / 2)
    return Order(
        timed=bool(np.isfinite(rows.covariates.get("time", np.nan)).all()),
        lags=lags,
        correlation=correlation,
        bound=BAND / np.sqrt(max(numbers, 1)),
        changes=changes,
        expected=expected,
        spread=deviation,
        p_value=float(ndtr((changes - expected) / max(deviation, 1e-12))),
    )
