"""What remains, traced: to each joint as an error of its own, to every column measured, and to the order of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.stats import chi2, norm

from aridcal.diagnosis import Bound
from aridcal.effects import Basis, Coefficient, covariate_table
from aridcal.outcome import Order, Trace, Traces
from aridcal.solver import Fit

SLICE, MOST_SLICES = 20, 48  # rows of a slice at the least; slices at the most
FEW_VALUES = 12  # a column with no more different values has one slice for each
CURVE = 120  # points of a smooth curve
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
        strongest=tuple(
            min((_trace(p, name, values) for p in pulled), key=lambda t: t.p_value) for name, values in asked.items()
        ),
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
    relative = np.ones_like(after) if data.measured.relative is None else data.measured.relative[:, :m]
    # The noise that the residual shows, not the declared one: a pattern is sought, whatever the size.
    size = [np.sqrt(np.mean((after / relative)[:, k : k + 3] ** 2)) for k in range(0, m, 3)]
    sigma = relative * np.repeat(np.maximum(size, 1e-12), 3)
    J = model.jacobian(theta, data.rows)[2][:, :m, len(fit.theta) :] / sigma[:, :, None]
    found = []
    for k, joint in enumerate(robot.joints):
        lever = np.sum(J[:, :, k] ** 2, axis=1)
        was, is_now = (np.sum(J[:, :, k] * r / sigma, axis=1) / np.maximum(lever, 1e-30) for r in (before, after))
        weight = np.where(lever > FAINT * np.median(lever), lever, 0.0)
        if weight.any():
            found.append(_Pulled(joint.name, "rad" if joint.kind == "revolute" else "m", was, is_now, weight))
    return found + [
        _Pulled(axis, "m" if k < 3 else "rad", before[:, k], after[:, k], 1.0 / sigma[:, k] ** 2)
        for k, axis in enumerate(AXES[:m])
    ]


def _trace(pulled: _Pulled, covariate: str, values: np.ndarray) -> Trace:
    """Means of slices of rows, and a smooth curve through them."""
    seen = np.flatnonzero(pulled.weight > 0)
    seen = seen[np.argsort(values[seen], kind="stable")]
    x, w = values[seen], pulled.weight[seen]
    different, place = np.unique(x, return_inverse=True)
    if len(different) > FEW_VALUES:
        place = np.arange(len(x)) * int(np.clip(len(x) // SLICE, 1, MOST_SLICES)) // len(x)
    total = np.bincount(place, w)

    def means(v: np.ndarray) -> np.ndarray:
        return np.bincount(place, w * v[seen]) / total

    centre, before, after = means(values), means(pulled.before), means(pulled.after)
    at = np.linspace(centre[0], centre[-1], CURVE)
    sizes = [np.sqrt(max(float(total @ v**2) - len(total), 0.0) / float(total.sum())) for v in (before, after)]
    return Trace(
        pulled.motion, pulled.unit, covariate, x, pulled.before[seen], pulled.after[seen],
        centre, before, after, 1.0 / np.sqrt(total),
        at, _smooth(centre, before, total, at), _smooth(centre, after, total, at),
        sizes[0], sizes[1], float(chi2.sf(total @ after**2, len(total))),
    )  # fmt: skip


def _smooth(x: np.ndarray, y: np.ndarray, weight: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Cubic smoothing spline, as smooth as cross-validation wants it; straight lines where there are too few points."""
    if len(x) < 6 or np.diff(x).min() <= 0:
        return np.interp(at, x, y)
    return np.asarray(make_smoothing_spline((x - x[0]) / (x[-1] - x[0]), y, weight / weight.mean())(
        (at - x[0]) / (x[-1] - x[0])
    ))  # fmt: skip


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
