"""Weighted least squares on the extended model: starts, robust loss, identifiable subset, covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from aridcal.effects import Coefficient
from aridcal.errors import NotIdentifiable
from aridcal.identifiable import identifiable
from aridcal.model import Model, Rows
from aridcal.residual import (
    FLOOR,
    Normal,
    Observations,
    Sigma,
    distance,
    normal,
    predict_residuals,
    robust_sigma,
    scaled,
    triangle,
)

OUTLIER = 6.0  # sigmas per axis, position or rotation, beyond which a row is flagged: 1 clean row in 10 million
STEPS = 60
SETTLED = 0.03  # a step that moves no combination of coefficients by more than this share of its sigma is the last
ROUGH = 1.0  # the same for a robust fit, whose flags are all that is wanted of it
ROUGH_ROWS = 300
FEWEST = 10  # rows of each frame in any choice of rows: enough to find the frame
SUSPECT = 3.0  # sigmas beyond which a row is flagged that repeats another's measurement although the joints moved


@dataclass(frozen=True)
class Data:
    """What a fit sees: configurations and measured poses, row by row."""

    rows: Rows
    measured: Observations
    suspect: np.ndarray  # (N,) bool: the measurement repeats another row's bit for bit although the joints moved

    def __getitem__(self, rows: slice | np.ndarray) -> Data:
        return Data(self.rows[rows], self.measured[rows], self.suspect[rows])

    def __len__(self) -> int:
        return len(self.measured)


@dataclass(frozen=True)
class Noise:
    """Noise per axis, [m] and [rad].

    Attributes:
        declared_position: What the user states; None if it is to be estimated.
        declared_rotation: Likewise.
    """

    declared_position: float | None = None
    declared_rotation: float | None = None

    def sigma(self, estimate: Sigma) -> Sigma:
        """The declared values, and the estimate where nothing is declared."""
        return Sigma(self.declared_position or estimate.position, self.declared_rotation or estimate.rotation)


@dataclass(frozen=True)
class Prior:
    """What is believed of the coefficients beforehand.

    Attributes:
        mean: Shape (K,).
        precision: Shape (K, K).
        basis: Combinations of coefficients, in columns, that are alike in how sure one is of them, shape (K, K): the
            samples of a smooth function are far too alike themselves to be solved for one by one. None: each its own.
    """

    mean: np.ndarray
    precision: np.ndarray
    basis: np.ndarray | None = None


@dataclass(frozen=True)
class Convergence:
    """Proof that a minimum was found.

    Attributes:
        steps: Gauss-Newton steps taken.
        gradient: Largest gradient, as the step it asks for in sigmas of the coefficient.
        condition: Of the Jacobian, each column scaled to length 1.
        restarts: Other starts that were tried; each must lead to the same minimum.
        agreed: How many of them did.
    """

    steps: int
    gradient: float
    condition: float
    restarts: int = 0
    agreed: int = 0

    @property
    def converged(self) -> bool:
        """True if the gradient vanished and no restart found a better minimum."""
        return self.gradient < 1e-2


@dataclass(frozen=True)
class Fit:
    """A solved model.

    Attributes:
        model: The coefficients that were kept, frames at their start.
        theta: Their values, shape (K,).
        covariance: Shape (K, K).
        sigma: Noise per axis that weighed the rows.
        estimated: Noise per axis that the residuals show, degrees of freedom taken into account.
        weight: Of each row, shape (N,): 0 for outliers.
        residual: Measured minus predicted, scaled by the rows' relative sigmas, shape (N, m).
        candidates: All coefficients that were asked for.
        redundant: For each that was dropped: the names of those it cannot be told from.
        convergence: How well the minimum was found.
        spent: Degrees of freedom used up: K, or less where priors shrink.
    """

    model: Model
    theta: np.ndarray
    covariance: np.ndarray
    sigma: Sigma
    estimated: Sigma
    weight: np.ndarray
    residual: np.ndarray
    candidates: tuple[Coefficient, ...]
    redundant: dict[str, tuple[str, ...]]
    convergence: Convergence
    spent: float

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each coefficient, shape (K,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def outliers(self) -> np.ndarray:
        """Rows that were given no weight, shape (N,)."""
        return np.asarray(self.weight < 0.5)

    @property
    def freedom(self) -> float:
        """Degrees of freedom left: numbers measured minus those used up."""
        return float((~self.outliers).sum() * self.residual.shape[1] - self.spent)


@dataclass(frozen=True)
class _Point:
    theta: np.ndarray
    sums: Normal
    sigma: Sigma
    steps: int
    gradient: float


def minimise(
    model: Model,
    data: Data,
    theta: np.ndarray,
    noise: Noise,
    weight: np.ndarray | None,
    prior: Prior | None = None,
) -> _Point:
    """Levenberg-Marquardt from theta, noise that is not declared estimated on the way.

    Args:
        model: K coefficients.
        data: N rows.
        theta: Start, shape (K,).
        noise: Declared noise.
        weight: Of each row, shape (N,); None: Cauchy's, its scale found anew at each step, and the last decimals
            left to a later call with fixed weights.
        prior: Beliefs that are not measured here.
    """
    robust, settled = weight is None, SETTLED
    scale = Sigma(1.0, 1.0)
    if robust:
        settled = ROUGH
        scale = robust_sigma(scaled(predict_residuals(model, theta, data.rows, data.measured), data.measured))
    here = normal(model, theta, data.rows, data.measured, weight, scale)
    sigma = noise.sigma(scale if robust else _estimate(here, noise.sigma(robust_sigma(here.residual)), prior))
    damping, taken = 0.0, 0
    while taken < STEPS and damping < 1e8:
        H, g = _with_prior(here, sigma, theta, prior)
        step = _solve(H, g, prior, damping)
        last = float(np.sqrt(max(step @ g, 0.0))) < settled and damping == 0.0
        last |= bool(np.all(np.abs(step) < 1e-13 * (1.0 + np.abs(theta))))
        trial = normal(model, theta + step, data.rows, data.measured, weight, scale)
        before = _cost(here.residual, here.weight, sigma, theta, prior)
        after = _cost(trial.residual, here.weight, sigma, theta + step, prior)
        taken += 1
        if after <= before or last:
            theta, here, damping = theta + step, trial, 0.0 if damping < 1e-4 else damping / 10
            scale = robust_sigma(here.residual) if robust else scale
            sigma = noise.sigma(scale if robust else _estimate(here, sigma, prior))
        else:
            damping = max(10 * damping, 1e-4)
        if last:
            break
    H, g = _with_prior(here, sigma, theta, prior)
    rest = _solve(H, g, prior)
    return _Point(theta, here, sigma, taken, float(np.sqrt(max(rest @ g, 0.0))))


def fit(
    model: Model,
    data: Data,
    noise: Noise,
    theta: np.ndarray | None = None,
    weight: np.ndarray | None = None,
    prior: Prior | None = None,
) -> Fit:
    """Fit the given coefficients, all of them: robustly on some of the rows, then on all with the outliers flagged.

    Args:
        model: K coefficients that the data can tell apart.
        data: N rows.
        noise: Declared noise, estimated where it is not.
        theta: Start; default: zero.
        weight: Weights to use instead of looking for outliers, shape (N,).
        prior: Beliefs that are not measured here.
    """
    theta = np.zeros(len(model.coefficients)) if theta is None else theta
    steps = 0
    searching = weight is None
    if weight is None:
        some = thin(data.rows, max(ROUGH_ROWS, 4 * len(theta)))
        rough = minimise(model, data[some], theta, noise, None, prior)
        theta, steps = rough.theta, rough.steps
        weight = flag(scaled(predict_residuals(model, theta, data.rows, data.measured), data.measured), data.suspect)
    for _ in range(8):
        point = minimise(model, data, theta, noise, weight, prior)
        theta, steps = point.theta, steps + point.steps
        flags = flag(point.sums.residual, data.suspect) if searching else weight
        if np.array_equal(flags, weight):
            break
        weight = flags
    H, _ = _with_prior(point.sums, point.sigma, theta, prior)
    covariance = _solve(H, np.eye(len(H)), prior)
    diagonal = np.maximum(np.diag(H), 1e-300)
    correlation = H / np.sqrt(diagonal) / np.sqrt(diagonal)[:, None]
    condition = float(np.sqrt(np.linalg.cond(correlation))) if len(H) else 1.0
    return Fit(
        model, theta, covariance, point.sigma, _estimate(point.sums, point.sigma, prior), point.sums.weight,
        point.sums.residual, model.coefficients, {}, Convergence(steps, point.gradient, condition),
        float(np.sum(covariance * point.sums.hessian(point.sigma))),
    )  # fmt: skip


def fit_identifiable(
    model: Model, data: Data, noise: Noise, order: Sequence[int], theta: np.ndarray | None = None
) -> Fit:
    """Fit the identifiable ones of a model's coefficients; the others stay nominal and are named.

    Args:
        model: All candidates.
        data: N rows.
        noise: Declared noise.
        order: The candidates' indices, the ones to keep before others first.
        theta: Start, shape (all candidates,); default: zero.

    Raises:
        NotIdentifiable: nothing at all can be identified.
    """
    theta = np.zeros(len(model.coefficients)) if theta is None else theta
    sigma = noise.sigma(Sigma(1e-4, 1e-4))
    some = thin(data.rows, max(ROUGH_ROWS, 4 * len(theta)))
    first, weight = data[some], np.full(len(some), len(data) / len(some))
    subset = identifiable(triangle(model, theta, first.rows, first.measured, weight, sigma), order)
    for _ in range(4):
        kept = sorted(subset.kept)
        if not kept:
            raise NotIdentifiable([model.names])
        every = len(kept) == len(model.coefficients)
        inner = model if every else model.with_coefficients([model.coefficients[k] for k in kept])
        result = fit(inner, _with_rows(data, model, kept), noise, theta[kept])
        theta = np.zeros(len(model.coefficients))
        theta[kept] = result.theta
        R = triangle(model, theta, data.rows, data.measured, result.weight, result.sigma)
        # What was kept stays ahead: near the solution a symmetry of the nominal robot is broken a little, and what
        # that makes barely separable must not push out what is well known.
        subset = identifiable(R, order, kept)
        if sorted(subset.kept) == kept:
            break
    redundant = {model.names[k]: tuple(model.names[j] for j in partners) for k, partners in subset.redundant.items()}
    convergence = replace(result.convergence, condition=subset.condition)
    return replace(result, candidates=model.coefficients, redundant=redundant, convergence=convergence)


def flag(r: np.ndarray, suspect: np.ndarray) -> np.ndarray:
    """Weights 1 and 0: 0 for rows further off than the bulk of the rows can explain, shape (N,)."""
    return np.where(distance(r, robust_sigma(r)) > np.where(suspect, SUSPECT, OUTLIER), 0.0, 1.0)


def thin(rows: Rows, most: int) -> np.ndarray:
    """Row numbers: all, or a reproducible random choice of about ``most`` of them in order, of every frame its share."""
    if len(rows) <= most:
        return np.arange(len(rows))
    rng = np.random.default_rng(0)
    pair = rows.world * (rows.tip.max() + 1) + rows.tip
    chosen = []
    for k in np.unique(pair):
        own = np.flatnonzero(pair == k)
        share = max(most * len(own) // len(rows), min(len(own), FEWEST))
        chosen.append(rng.choice(own, share, replace=False))
    return np.sort(np.concatenate(chosen))


def _with_rows(data: Data, model: Model, kept: Sequence[int]) -> Data:
    """The same rows for fewer coefficients: their bases follow."""
    varying = [
        int(k) for k in np.flatnonzero([not c.basis.constant or c.station is not None for c in model.coefficients])
    ]
    columns = [varying.index(k) for k in kept if k in varying]
    return replace(data, rows=replace(data.rows, phi=data.rows.phi[:, columns]))


def _with_prior(sums: Normal, sigma: Sigma, theta: np.ndarray, prior: Prior | None) -> tuple[np.ndarray, np.ndarray]:
    H, g = sums.hessian(sigma), sums.gradient(sigma)
    if prior is not None:
        H, g = H + prior.precision, g + prior.precision @ (prior.mean - theta)
    return H, g


def _cost(r: np.ndarray, weight: np.ndarray, sigma: Sigma, theta: np.ndarray, prior: Prior | None) -> float:
    value = float(weight @ np.sum(r[:, :3] ** 2, axis=1)) / sigma.position**2
    value += float(weight @ np.sum(r[:, 3:] ** 2, axis=1)) / sigma.rotation**2
    if prior is not None:
        value += float((theta - prior.mean) @ prior.precision @ (theta - prior.mean))
    return value


def _solve(H: np.ndarray, b: np.ndarray, prior: Prior | None, damping: float = 0.0) -> np.ndarray:
    """H^-1 b in the prior's basis, scaled to unit diagonal, so that metres and radians do not upset the rank."""
    B = np.eye(len(H)) if prior is None or prior.basis is None else prior.basis
    H = B.T @ H @ B
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    S = H * scale * scale[:, None] + damping * np.eye(len(H))
    scaled_b = ((B.T @ b).T * scale).T
    try:
        x = cho_solve(cho_factor(S), scaled_b)
    except LinAlgError:
        x = np.linalg.lstsq(S, scaled_b, rcond=1e-13)[0]
    return np.asarray(B @ (x.T * scale).T)


def _estimate(sums: Normal, sigma: Sigma, prior: Prior | None) -> Sigma:
    """Noise per axis from the residuals: sum of squares over the degrees of freedom each part has left."""
    used = sums.weight
    H = sums.hessian(sigma)
    if prior is not None:
        H = H + prior.precision
    inverse = _solve(H, np.eye(len(H)), prior)
    values = []
    parts = ((slice(0, 3), sums.hessian_position, sigma.position), (slice(3, 6), sums.hessian_rotation, sigma.rotation))
    for part, hessian, scale in parts:
        r = sums.residual[:, part]
        if r.shape[1] == 0:
            values.append(1.0)
            continue
        spent = float(np.sum(inverse * hessian)) / scale**2
        freedom = 3 * float(used.sum()) - spent
        square = float(used @ np.sum(r**2, axis=1))
        values.append(max(float(np.sqrt(square / freedom)), FLOOR) if freedom > 0.5 else scale)
    return Sigma(values[0], values[1])
