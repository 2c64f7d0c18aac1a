"""How far a calibration can be trusted: repeats, uncertainty of the target, two halves fitted apart."""

from __future__ import annotations

import numpy as np

from aridcal.measurements import Measurements, blocks
from aridcal.outcome import Precision, Repeats
from aridcal.residual import Sigma, distance, normal, robust_sigma
from aridcal.robot import Robot
from aridcal.solver import Data, Fit, Noise, minimise
from aridcal.source import Kind

REACH_SAMPLES = 300
REALIGN_STEPS = 12
FAR = 10.0  # robust scales beyond which a test row is a gross outlier


def joint_kinds(robot: Robot) -> tuple[Kind, ...]:
    """Kind of each reading column: ``revolute``, ``prismatic`` or ``continuous``."""
    by_reading: dict[str, Kind] = {j.reading: "continuous" if j.continuous else j.kind for j in reversed(robot.joints)}
    return tuple(by_reading[name] for name in robot.readings)


def joint_limits(robot: Robot) -> np.ndarray:
    """Limits of each reading column, shape (columns, 2), infinite where there are none."""
    by_reading = {j.reading: (j.lower, j.upper) for j in reversed(robot.joints)}
    return np.array([by_reading[name] for name in robot.readings])


def repeats(robot: Robot, rows: Measurements, residual: np.ndarray) -> Repeats | None:
    """Scatter of rows that repeat a configuration; None where none does.

    Residuals, not raw poses, are compared: readings of repeats differ a little, and the model knows how much.
    """
    label = blocks(rows.readings, joint_kinds(robot))
    size = np.bincount(label)
    own = size[label] > 1
    groups = int((size > 1).sum())
    if groups == 0:
        return None
    total = np.zeros((len(size), residual.shape[1]))
    np.add.at(total, label, residual)
    apart = (residual - total[label] / size[label, None])[own]
    freedom = 3.0 * (own.sum() - groups)
    sigma = [float(np.sqrt(np.sum(part**2) / freedom)) for part in (apart[:, :3], apart[:, 3:])]
    # The centre is estimated from the same rows: distances come out too short by this factor.
    n = size[label[own]]
    distance = np.linalg.norm(apart[:, :3], axis=1) * np.sqrt(n / (n - 1.0))
    return Repeats(groups, int(own.sum()), Sigma(*sigma), float(distance.mean() + 3.0 * distance.std(ddof=1)))


def accuracy(robot: Robot, rows: Measurements, residual: np.ndarray) -> np.ndarray:
    """ISO 9283's AP of every configuration: how far the centre of its attained positions is off, [m].

    Args:
        robot: The nominal chain.
        rows: N rows; those that repeat a configuration count as one.
        residual: Measured minus predicted, shape (N, 6) or (N, 3), [m] and [rad].
    """
    if len(rows) == 0:
        return np.empty(0)
    label = blocks(rows.readings, joint_kinds(robot))
    total = np.stack([np.bincount(label, axis) for axis in residual[:, :3].T], axis=1)
    return np.asarray(np.linalg.norm(total / np.bincount(label)[:, None], axis=1))


def precision(fit: Fit, train: Measurements, data: Data, halves: tuple[float, float]) -> Precision:
    """Propagate the noise to the target, and set it beside what two halves fitted apart show (see :func:`halves`)."""
    robot = fit.model.robot
    position, rotation = target_sigma(fit, data)
    limits = joint_limits(robot)
    seen = np.stack([train.readings.min(axis=0), train.readings.max(axis=0)], axis=1)
    low, high = np.where(np.isfinite(limits), limits, seen).T
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(low, high, (REACH_SAMPLES, len(low)))
    some = rng.integers(0, len(train), REACH_SAMPLES)
    covariates = {name: values[some] for name, values in train.covariates.items()}
    rows = fit.model.rows(anywhere, covariates, None if train.station is None else train.station[some])
    reach, _ = target_sigma(fit, Data(rows, data.measured[some], data.suspect[some]))
    bases = fit.model.frames(fit.theta)[0]
    targets = fit.model.poses(fit.theta, rows)[1]
    places = np.array([bases[k][1].actInv(p) for k, p in zip(rows.world, targets, strict=True)])
    return Precision(position, rotation, reach, places, *halves)


def target_sigma(fit: Fit, data: Data) -> tuple[np.ndarray, np.ndarray]:
    """1-sigma of the predicted target in its worst direction, [m] and [rad], shape (N,) each."""
    _, _, J = fit.model.jacobian(fit.theta, data.rows)
    worst = []
    for part in (J[:, :3], J[:, 3:]):
        spread = part @ fit.covariance @ part.transpose(0, 2, 1)
        worst.append(np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[:, -1], 0.0)))
    return worst[0], worst[1]


def halves(fit: Fit, train: Measurements, data: Data, noise: Noise) -> tuple[float, float]:
    """RMS difference of two calibrations from one half of the rows each, and what noise alone would make, [m]."""
    label = blocks(train.readings, joint_kinds(fit.model.robot))
    side = np.random.default_rng(0).permutation(int(label.max()) + 1)[label] % 2 == 0
    count = len(fit.theta)
    if count == 0 or min(side.sum(), (~side).sum()) * data.measured.position.shape[1] < 2 * count:
        return float("nan"), float("nan")
    predicted, spread = [], 0.0
    for half in (side, ~side):
        point = minimise(fit.model, data[half], fit.theta, noise, fit.weight[half])
        _, p, J = fit.model.jacobian(point.theta, data.rows)
        covariance = np.linalg.pinv(point.sums.hessian(point.sigma), hermitian=True)
        spread += float(np.mean(np.einsum("nik,kl,nil->n", J[:, :3], covariance, J[:, :3])))
        predicted.append(p)
    apart = np.linalg.norm(predicted[0] - predicted[1], axis=1)
    return float(np.sqrt(np.mean(apart**2))), float(np.sqrt(spread))


def realigned(fit: Fit, data: Data) -> np.ndarray:
    """Residuals of other rows after fitting the two frames anew to them, all else as it was, shape (N, m), scaled.

    What this takes away was changed by remounting the target or moving the tracker, not by the robot.
    """
    theta = fit.theta.copy()
    own = [c.where in ("world_base", "tip_target") and c.basis.constant for c in fit.model.coefficients]
    frames = np.flatnonzero(own)
    r = fit.residual
    for _ in range(REALIGN_STEPS):
        here = normal(fit.model, theta, data.rows, data.measured, None, fit.sigma)
        r = here.residual
        H, g = here.hessian(fit.sigma)[np.ix_(frames, frames)], here.gradient(fit.sigma)[frames]
        step = np.linalg.lstsq(H, g, rcond=1e-12)[0]
        theta[frames] += step
        if np.all(np.abs(step) < 1e-12):
            break
    return r


def outliers(train: np.ndarray, flags: np.ndarray, stages: list[np.ndarray]) -> np.ndarray:
    """One set of flags for all stages: the final model's on train; on test only what is far off at every stage.

    "Far" is ten times the robust scale of the final model's training residuals: a test row that any stage predicts
    better than that is never left out.

    Args:
        train: Mask of the training rows, shape (N,).
        flags: Flags of the training rows, shape (train rows,).
        stages: Residuals of every stage, the final one last, all rows, scaled by the rows' relative sigmas.
    """
    sigma = robust_sigma(stages[-1][train])
    far = np.all([distance(r, sigma) > FAR for r in stages], axis=0)
    far[train] = flags
    return far
