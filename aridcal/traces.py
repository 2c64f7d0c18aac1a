"""What remains, traced: to each joint as an error of its own, to every column measured, and to the order of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from aridcal.diagnosis import Bound
from aridcal.effects import Basis, Coefficient, covariate_table
from aridcal.outcome import Order, Trace, Traces
from aridcal.residual import FLOOR, scaled
from aridcal.solver import Fit

SLICE, MOST_SLICES = 20, 48  # rows of a slice at the least; slices at the most
FEW_VALUES = 12  # a column with no more different values has one slice for each
CURVE = 120  # points of a smooth curve
LENGTHS = (0.02, 0.05, 0.1, 0.2, 0.4, 1.0)  # over which a smooth curve is alike, in shares of the covariate's range
LAGS = 30
FAINT = 0.05  # rows at which a motion moves the target by less than this share of the median lever say nothing of it
AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class _Pulled:
    """Residuals as a motion that each row asks for by itself; ``weight`` is 1 / variance that the noise makes of it."""

    motion: str
    unit: str
    before: np.ndarray
    after: np.ndarray
    weight: np.ndarray


def trace(fit: Fit, used: Bound, before: np.ndarray, after: np.ndarray) -> Traces:
    """Trace residuals to joints, columns and time.

    Args:
        fit: The final model.
        used: The N rows in use.
        before: Residuals of the model without effects, shape (N, m), [m] and [rad].
        after: Residuals of the final model.
    """
    robot, rows = fit.model.robot, used.train
    pulled = _pull(fit, used, before, after)
    own = {p.motion: p for p in pulled}
    complete = {name: values for name, values in rows.covariates.items() if np.isfinite(values).all()}
    world = fit.model.rows(rows.readings, rows.covariates, rows.station).world
    table = covariate_table(robot, rows.readings, complete, fit.model.around, world, {".gravity_"})
    asked = {name: v for name, v in table.items() if _varies(v) and ".gravity_moment" not in name}
    return Traces(
        joints=tuple(_trace(own[name], name, asked[name]) for name in robot.names if name in own and name in asked),
        strongest=tuple(_strongest(pulled, name, values) for name, values in asked.items()),
        asked=len(pulled) * len(asked),
        order=_order(after, rows.covariates.get("time")),
    )


def _varies(values: np.ndarray) -> bool:
    return float(np.ptp(values)) > 1e-3 * float(np.abs(values).max())


def _pull(fit: Fit, used: Bound, before: np.ndarray, after: np.ndarray) -> list[_Pulled]:
    """Residuals pulled back to each joint's own axis, row by row by weighted least squares, and along the world's axes."""
    robot, m = fit.model.robot, after.shape[1]
    ones = Basis("ones", (robot.names[0],))
    model = fit.model.with_coefficients(
        (*fit.model.coefficients, *(Coefficient(name, "axis", ones) for name in robot.names))
    )
    data = used.data(model)
    theta = np.concatenate([fit.theta, np.zeros(len(robot.names))])
    # The noise that the residual shows, not the declared one: a pattern is sought, whatever the size.
    white = [scaled(r, data.measured) for r in (before, after)]
    sigma = np.repeat([max(float(np.sqrt(np.mean(white[1][:, k : k + 3] ** 2))), FLOOR) for k in range(0, m, 3)], 3)
    J = scaled(model.jacobian(theta, data.rows)[2][:, :m, len(fit.theta) :], data.measured) / sigma[:, None]
    found = []
    for k, joint in enumerate(robot.joints):
        lever = np.sum(J[:, :, k] ** 2, axis=1)
        was, is_now = (np.sum(J[:, :, k] * r / sigma, axis=1) / np.maximum(lever, 1e-30) for r in white)
        weight = np.where(lever > FAINT * np.median(lever), lever, 0.0)
        if weight.any():
            found.append(_Pulled(joint.name, "rad" if joint.kind == "revolute" else "m", was, is_now, weight))
    for k, axis in enumerate(AXES[:m]):
        weight = np.full(len(after), 1.0 / max(float(np.mean(after[:, k] ** 2)), FLOOR**2))
        found.append(_Pulled(axis, "m" if k < 3 else "rad", before[:, k], after[:, k], weight))
    return found


def _strongest(pulled: Sequence[_Pulled], covariate: str, values: np.ndarray) -> Trace:
    """The motion of which noise would least likely show as much."""
    chances = [_chance(_means(p, values, p.after)) for p in pulled]
    return _trace(pulled[int(np.argmin(chances))], covariate, values)


def _trace(pulled: _Pulled, covariate: str, values: np.ndarray) -> Trace:
    """A motion over a covariate, before and after."""
    seen = pulled.weight > 0
    was, left = (_means(pulled, values, v) for v in (pulled.before, pulled.after))
    at = np.linspace(left.centre[0], left.centre[-1], CURVE)
    return Trace(
        pulled.motion, pulled.unit, covariate, values[seen], pulled.before[seen], pulled.after[seen],
        left.centre, was.mean, left.mean, left.std, at, _smooth(was, at), _smooth(left, at),
        _size(was), _size(left), _chance(was), _chance(left),
    )  # fmt: skip


@dataclass(frozen=True)
class _Means:
    """Slices of rows: mean covariate, weighted mean of what the rows ask for, and the noise of that; shape (B,) each."""

    centre: np.ndarray
    mean: np.ndarray
    std: np.ndarray


def _means(pulled: _Pulled, values: np.ndarray, asks: np.ndarray) -> _Means:
    """Slices of equally many rows; of a column with few values, one slice for each."""
    seen = np.flatnonzero(pulled.weight > 0)
    seen = seen[np.argsort(values[seen], kind="stable")]
    weight = pulled.weight[seen]
    different, place = np.unique(values[seen], return_inverse=True)
    if len(different) > FEW_VALUES:
        place = np.arange(len(seen)) * int(np.clip(len(seen) // SLICE, 1, MOST_SLICES)) // len(seen)
    total = np.bincount(place, weight)
    centre, mean = (np.bincount(place, weight * v[seen]) / total for v in (values, asks))
    return _Means(centre, mean, 1.0 / np.sqrt(total))


def _chance(m: _Means) -> float:
    """That noise alone makes such means."""
    return float(chi2.sf(np.sum((m.mean / m.std) ** 2), len(m.mean)))


def _size(m: _Means) -> float:
    """RMS of the means beyond what noise makes of them."""
    weight = 1.0 / m.std**2
    return float(np.sqrt(max(weight @ m.mean**2 - len(weight), 0.0) / weight.sum()))


def _smooth(m: _Means, at: np.ndarray) -> np.ndarray:
    """The likeliest smooth function through the means (Gaussian process, Matern 5/2); zero where they are noise."""
    variance = _size(m) ** 2
    span = float(np.ptp(m.centre))
    if variance == 0.0 or span == 0.0:
        return np.zeros(len(at))

    def kernel(x: np.ndarray, length: float) -> np.ndarray:
        d = np.sqrt(5.0) * np.abs(x[:, None] - m.centre) / (length * span)
        return np.asarray(variance * (1.0 + d + d**2 / 3.0) * np.exp(-d))

    best, curve = -np.inf, np.zeros(len(at))
    for length in LENGTHS:
        K = kernel(m.centre, length) + np.diag(m.std**2)
        pull = np.linalg.solve(K, m.mean)
        likelihood = -0.5 * float(m.mean @ pull + np.linalg.slogdet(K)[1])
        if likelihood > best:
            best, curve = likelihood, kernel(at, length) @ pull
    return curve


def _order(residual: np.ndarray, time: np.ndarray | None) -> Order:
    """Changes of sign, and correlation over so many rows, in the order of time (of the table, where there is none)."""
    timed = time is not None and bool(np.isfinite(time).all())
    order = np.argsort(time, kind="stable") if timed and time is not None else np.arange(len(residual))
    r = residual[order]
    n, m = r.shape
    square = np.sum(r**2, axis=0)
    lags = np.arange(1, min(LAGS, n // 4) + 1)
    correlation = np.array([np.mean(np.sum(r[k:] * r[:-k], axis=0) / np.maximum(square, 1e-300)) for k in lags])
    changes = int(np.sum(np.diff(np.sign(r), axis=0) != 0))
    expected, spread = m * (n - 1) / 2, np.sqrt(m * (n - 1)) / 2
    return Order(timed, order, lags, correlation, 1.96 / np.sqrt(m * n), changes, expected, float(spread),
                 float(norm.cdf((changes - expected) / max(float(spread), 1e-12))))  # fmt: skip
