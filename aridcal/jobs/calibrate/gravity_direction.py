r"""Does gravity pull where the campaign says? Compliant joints show it: a wrong setting looks like many effects.

A joint of compliance :math:`c_k` gives way by :math:`c_k \tau_k`, and the load is linear in gravity: with a unit vector u and the
load :math:`\tau_{ki}` under gravity along axis i, :math:`\tau_k = \sum_i u_i \tau_{ki}`. With the
constants and the first harmonic of every turning joint free in both (gears may have one, and a tilted load resembles it), the
whitened residual r leaves

.. math:: S(u) = \min_{\theta, c} \Big| r - J \theta - \sum_k c_k \sum_i u_i C_{ki} \Big|^2

S is compared at its smallest with S at the declared direction, on places held back in turn, each place one number. Joints give
way in the direction of the pull: where compliances known to :data:`CERTAINLY` sigmas differ in sign, nothing is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtr  # Student's t: its upper tail is stdtr(freedom, -t), and scipy.stats is slow to load

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import covariate_table
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.normal_equations import inverse
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.residual import reduced_stretches
from aridcal.engine.instruments.channels import spread
from aridcal.engine.levels import CERTAINLY, CHOOSING_FOLDS
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.numerics import RIDGE
from aridcal.engine.robot.kinematics import LEVEL_GRAVITY
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.search.noise_tests import FALSE_ALARM

MOST_GRAVITY_ROWS = 600
"""Work: Rows that are looked at, spread evenly over more: a direction that matters shows in these."""

LEAST_LEAN = np.radians(20.0)
"""A base that is not level leans by a degree or two; a robot on a wall, under a ceiling or on a wedge by more than this. A load
under gravity 20 degrees off is still right to 6 %."""

START_DIRECTIONS = 150
"""Work: Directions that the search begins with."""

COARSE_STEP, FINE_STEP = 0.1, 2e-3
"""Work: [rad]: they are some 12 degrees apart, and a tenth of a degree changes no load that matters."""


def gravity_direction(fit: Fit, rows: Dataset) -> str:
    """Ask whether gravity pulls elsewhere than the campaign says.

    Args:
        fit: The geometric stage, with its surroundings: constants, and no effects.
        rows: N training rows.

    Returns:
        The sentence for the report, with the key to be set; empty where the rows do not contradict the campaign.
    """
    declared = np.asarray(fit.model.around.gravity, dtype=float)
    size = float(np.linalg.norm(declared))
    if declared.ndim != 1 or size == 0.0:
        return ""
    some = rows.select(~fit.outliers) if fit.outliers.any() else rows
    some = some.select(np.linspace(0, len(some) - 1, min(len(some), MOST_GRAVITY_ROWS)).round().astype(int))
    place = held_back_groups(some)
    loads = _loads(fit, some)
    if place.max() + 1 < CHOOSING_FOLDS**2 or not loads:
        return ""
    r, J = _columns(fit, some, loads)
    sums = _Sums(r, J, len(loads) // 3, place)
    return _answer(sums, declared / size)


def _loads(fit: Fit, rows: Dataset) -> dict[tuple[str, int], np.ndarray]:
    """Load on each joint that bears any, under gravity along each axis of the base, by joint and axis, shape (N,) each."""
    model = fit.model
    payload = {name: rows.covariates[name] for name in model.around.masses if model.around.loaded}
    world = rows_of_data(model, rows).world
    tables = []
    for axis in np.eye(3):
        around = replace(model.around, gravity=-LEVEL_GRAVITY[2] * axis)
        tables.append(covariate_table(model.robot, rows.readings, payload, around, world, {".gravity_"}))
    torques = {
        (name, i): tables[i].get(f"{name}.gravity_torque", np.zeros(0)) for name in model.robot.names for i in range(3)
    }
    bearing = [
        name
        for name in model.robot.names
        if any(torques[name, i].size and np.ptp(torques[name, i]) > 0.0 for i in range(3))
    ]
    return {(name, i): torques[name, i] for name in bearing for i in range(3)}


def _columns(fit: Fit, rows: Dataset, loads: dict[tuple[str, int], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residual (N, m) and columns (N, m, K) of constants, then of harmonics, then of loads, joint by joint."""
    robot, model = fit.model.robot, fit.model
    named = {f"load of {joint} along {'xyz'[i]}": (joint, values) for (joint, i), values in loads.items()}
    turning = [joint.name for joint in robot.joints if joint.kind != "prismatic" and joint.drive.factors]
    waves = [Coefficient(name, "axis", Basis(form, (name,), (1.0,))) for name in turning for form in ("sin", "cos")]
    pulls = [Coefficient(joint, "axis", Basis("linear", (name,), (0.0,))) for name, (joint, _) in named.items()]
    with_loads = replace(rows, covariates={**rows.covariates, **{name: values for name, (_, values) in named.items()}})
    larger_model = replace(model.with_coefficients((*model.coefficients, *waves, *pulls)), states=model.states)
    theta = np.concatenate([fit.theta, np.zeros(len(waves) + len(pulls))])
    pieces = [
        (r, J) for _, r, J in reduced_stretches(problem(larger_model, with_loads), theta, np.ones(len(rows)), fit.sigma)
    ]
    r, J = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    sigma = spread(fit.sigma, rows.channels)
    return r / sigma, J / sigma[:, None]


class _Sums:
    """Sums over each part of the places, from which the fit under any direction follows.

    Args:
        r: Residual, shape (N, m).
        J: Columns, shape (N, m, K): the last 3 L are those of L joints' loads along three axes.
        joints: L.
        place: Place of each row, shape (N,).
    """

    def __init__(self, r: np.ndarray, J: np.ndarray, joints: int, place: np.ndarray) -> None:
        self.r, self.J, self.joints, self.place = r, J, joints, place
        self.free = J.shape[2] - 3 * joints
        self.part = np.random.default_rng(0).permutation(int(place.max()) + 1)[place] % CHOOSING_FOLDS
        flat = [J[rows].reshape(-1, J.shape[2]) for rows in self._parts()]
        self.H = np.array([A.T @ A for A in flat])
        self.b = np.array([A.T @ r[rows].ravel() for A, rows in zip(flat, self._parts(), strict=True)])
        self.s = np.array([np.sum(r[rows] ** 2) for rows in self._parts()])

    def _parts(self) -> list[np.ndarray]:
        return [self.part == k for k in range(CHOOSING_FOLDS)]

    def reduced(self, u: np.ndarray) -> np.ndarray:
        """Columns of one compliance a joint under gravity along u, from those of three, shape (K, free + joints)."""
        D = np.zeros((self.J.shape[2], self.free + self.joints))
        D[: self.free, : self.free] = np.eye(self.free)
        D[self.free :, self.free :] = np.kron(np.eye(self.joints), u[:, None])
        return D

    def solved(self, u: np.ndarray, parts: Sequence[int]) -> tuple[np.ndarray, float, np.ndarray]:
        """Coefficients of all columns from some parts of the places, the squares left, and the covariance but for its scale."""
        chosen = list(parts)
        D = self.reduced(u)
        H, b = D.T @ self.H[chosen].sum(axis=0) @ D, D.T @ self.b[chosen].sum(axis=0)
        back = inverse(H, ridge=RIDGE)
        x = back @ b
        return D @ x, float(self.s[chosen].sum() - b @ x), back

    def of_loads(self, parts: Sequence[int]) -> tuple[np.ndarray, np.ndarray, float]:
        """Sums of the loads' columns, all others fitted: with each other (3 L, 3 L), with the residual (3 L,); its squares."""
        chosen, free = list(parts), self.free
        H, b = self.H[chosen].sum(axis=0), self.b[chosen].sum(axis=0)
        back = inverse(H[:free, :free], ridge=RIDGE) @ np.column_stack([H[:free, free:], b[:free]])
        by_free = H[free:, :free] @ back
        return (
            H[free:, free:] - by_free[:, :-1],
            b[free:] - by_free[:, -1],
            float(self.s[chosen].sum() - b[:free] @ back[:, -1]),
        )

    def best(self, parts: Sequence[int]) -> np.ndarray:
        """The direction that leaves the smallest squares: the best of many, then of its neighbours at ever smaller steps."""
        S, c, most = self.of_loads(parts)

        def leaves(u: np.ndarray) -> float:
            along = c.reshape(-1, 3) @ u
            return most - float(along @ inverse(_along(S, u), ridge=RIDGE) @ along)

        u = min(_directions(), key=leaves)
        squares, step = leaves(u), COARSE_STEP
        while step > FINE_STEP:
            across = np.linalg.svd(u[None])[2][1:]
            around = [u + step * side * across[k] for k in (0, 1) for side in (-1.0, 1.0)]
            trial = min((v / np.linalg.norm(v) for v in around), key=leaves)
            trial_squares = leaves(trial)
            u, squares, step = (trial, trial_squares, step) if trial_squares < squares else (u, squares, step / 2.0)
        return np.asarray(u)


def _along(S: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Products of L joints' loads along three axes, (3 L, 3 L), as those of their loads along u, (L, L)."""
    L = len(S) // 3
    return np.asarray(np.einsum("aibj,i,j->ab", S.reshape(L, 3, L, 3), u, u))


def _directions() -> np.ndarray:
    """Directions spread evenly over half a sphere: a direction and its opposite differ by the compliances' sign."""
    k = np.arange(START_DIRECTIONS) + 0.5
    z, angle = k / START_DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.stack([np.sqrt(1.0 - z**2) * np.cos(angle), np.sqrt(1.0 - z**2) * np.sin(angle), z], axis=1)


def _answer(sums: _Sums, declared: np.ndarray) -> str:
    """The sentence on the direction that leaves the smallest squares; empty where the declared direction will do."""
    all_parts = range(CHOOSING_FOLDS)
    u = sums.best(all_parts)
    x, squares, back = sums.solved(u, all_parts)
    compliance, free = x[sums.free :].reshape(sums.joints, 3) @ u, sums.free
    freedom = max(sums.r.size - len(back) - 2, 1)
    z = compliance / np.sqrt(np.maximum(np.diag(back)[free:] * squares / freedom, np.finfo(float).tiny))
    sure = z[np.abs(z) > CERTAINLY]
    if not len(sure) or (np.sign(sure) != np.sign(sure[0])).any():
        return ""
    u = u * np.sign(sure[0])
    angle = float(np.arccos(np.clip(u @ declared, -1.0, 1.0)))
    if angle < LEAST_LEAN or (angle > np.pi - LEAST_LEAN and len(sure) < 2):
        return ""
    if angle > np.pi - LEAST_LEAN:  # as well explained, by joints that give way against the pull
        p_value = float(stdtr(freedom, -np.abs(sure).min()))
    else:
        gain = _held_back(sums, declared)
        error = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        p_value = float(stdtr(len(gain) - 1, -gain.mean() / max(error, np.finfo(float).tiny)))
    if p_value >= FALSE_ALARM:
        return ""
    vector = ", ".join(f"{-LEVEL_GRAVITY[2] * component:.2f}" for component in u)
    return (
        f"joints give way as if gravity pulled {np.degrees(angle):.0f} degrees from where the campaign says: is the robot "
        f"mounted otherwise? Then set `robot.gravity: [{vector}]`, in the base frame"
    )


def _held_back(sums: _Sums, declared: np.ndarray) -> np.ndarray:
    """Gain in squares of the free direction over the declared one, of each place, parts of the places held back in turn."""
    gains = []
    for k in range(CHOOSING_FOLDS):
        kept_parts, out = [part for part in range(CHOOSING_FOLDS) if part != k], sums.part == k
        squares = []
        for u in (declared, sums.best(kept_parts)):
            x, _, _ = sums.solved(u, kept_parts)
            squares.append(np.sum((sums.r[out] - sums.J[out] @ x) ** 2, axis=1))
        _, number = np.unique(sums.place[out], return_inverse=True)
        gains.append(np.bincount(number, squares[0] - squares[1]))
    return np.concatenate(gains)
