r"""The predicted poses of two calibrations compared: what differs beyond the uncertainty of both.

Configurations q are drawn where both calibrations saw the joints. With the target's poses :math:`T_A, T_B` there, and what each
calibration's coefficients do to them, :math:`J_A, J_B`,

.. math:: d = T_B - T_A, \qquad C = J_A \Sigma_A J_A^T + J_B \Sigma_B J_B^T + \varepsilon^2 1

with :math:`\varepsilon` what is no difference: rounding, and what is not linear,

as for halves of rows (:mod:`aridcal.engine.trust.halves`), but in the poses and not in the coefficients: which constants
stand for the same motion, and which were left at their nominal value because no row told them, is each calibration's own
choice (its gauge), and the poses do not depend on it. What nobody can tell is taken off both sides, columns :math:`F` that
may take up all they can:

- a motion of the base, and of the target on the tool, as one body, where these were set up anew. Large ones are taken off first,
  in closed form with small steps after it; what is left is linear.
- what a constant does that one calibration has and the other's rows could not tell, less what the other's own coefficients take
  up of it. A calibration that never saw a constant says nothing of its change. How its own coefficients took it up depends on its
  rows, of which nothing is left; as if what they could not take up were noise of its rows, its covariance is larger by
  :math:`1 + \ell^2 |J_{2\perp}|^2 / (n \sigma^2)`, with :math:`\ell` what the constant may be off by.

An effect that only one of them has was not seen by the other: there it may be as large as its rows would not have noticed. How
much that is follows from the number of its rows and their noise, as if they had been spread like the configurations here:

.. math:: \Sigma_u = (J_{2\perp}^T W J_{2\perp} + 1 / \ell^2)^{-1}, \qquad J_{2\perp} = J_2 - J_1 (J_1^T W J_1)^{-1} J_1^T W J_2

What is left is compared by Hotelling's statistic in the r directions that the coefficients can move the poses (Hotelling 1931,
doi:10.1214/aoms/1177732979), each pose weighted by the noise (the result does not depend on these weights, only its rounding
does):

.. math:: T^2 = d_\perp^T C_\perp^+ d_\perp, \qquad T^2 / r \sim F(r, \nu)

with :math:`\nu` the freedom behind the noise, where that was estimated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import svd
from scipy.special import fdtrc

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.normal_equations import across, pseudo_inverse
from aridcal.engine.robot.chain import Robot
from aridcal.engine.trust.workspace import UNTOLD_SIGMA
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.history.compared_poses import OVER_TIME, common_poses
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.jobs.maintain.repair import unit_of
from aridcal.system.wording import plural

LEAST_DIFFERENCE = 1e-7
"""[m] and [rad]: what is no difference for anybody, RMS over the configurations: rounding is smaller."""

SECOND_ORDER_LEVER = 0.1
"""[m]: what a squared angle moves that is hardly known, when base and tool took their part of it: a tenth of what it does at a
metre. Of angles known to 1 mrad it is 0.1 um."""

SAME_MOTION_SHARE = 1e-5
"""Share of a constant's squares that other constants leave of it where it is one motion with them but for terms of second order,
of constants off by 3 mm or 3 mrad: it was told, under their names. Its value times what is left is what these terms may be."""

WELL_KNOWN_SIGMA = 3e-3
"""[m] and [rad]: sigma of the least known constant above which this cannot be said: in a corner all motions look alike."""

ROUNDING_SHARE = 1e-9
"""Share of the largest singular value, coefficients scaled by their uncertainty, below which a direction is rounding."""

UNKNOWN_NOTICE = (
    "the {} calibration could not tell {} that the other has: what they do was taken off, and less is told of all else"
)
"""Notice where the rows of one calibration tell too little."""


@dataclass(frozen=True)
class CoefficientColumn:
    """One coefficient in the configurations that are compared.

    Attributes:
        coefficient: Of the arm; frames that were set up anew have none.
        unit: m or rad; of an effect's coefficient that of the motion, per unit of its basis.
        values: In the first and the second calibration; NaN where one has no such coefficient.
        moves: How the numbers change with it, in sigmas, shape (n,).
    """

    coefficient: Coefficient
    unit: str
    values: tuple[float, float]
    moves: np.ndarray


@dataclass(frozen=True)
class Difference:
    """Two calibrations compared where both saw the robot. Numbers n: 6 of each configuration, 3 where a rotation is not known.

    Attributes:
        columns: Coefficients of the arm in either calibration, K of them.
        covariance: Of the coefficients' differences, shape (K, K): the sum of both; a calibration adds nothing for a
            coefficient that it does not have.
        lacking: Columns, each of unit variance, of what effects of one calibration may amount to in the other, which has none
            of them, shape (n, u).
        readings: Of the configurations, shape (M, columns), [rad] or [m].
        robot: Of both calibrations.
        turns: Whether rotations are compared.
        d: Second minus first, in sigmas, shape (n,).
        free: Columns of motions that cannot be told: of base, target and unknown constants, shape (n, f).
        sigma: Divisors of a configuration's numbers, [m] and [rad], shape (6,) or (3,).
        freedom: Degrees of freedom of the noise of both; infinite where it was declared.
        frames: Frames set up anew, ``world_base`` and ``tip_target``, and how far apart both have each, [m] and [rad].
        notices: What a reader should know.
    """

    columns: tuple[CoefficientColumn, ...]
    covariance: np.ndarray
    lacking: np.ndarray
    readings: np.ndarray
    robot: Robot
    turns: bool
    d: np.ndarray
    free: np.ndarray
    sigma: np.ndarray
    freedom: float
    frames: Mapping[str, tuple[float, float]]
    notices: tuple[str, ...]

    @cached_property
    def _directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions that both can move the poses in, free motions taken off, shape (n, r), and sigma along each, shape (r,)."""
        J = np.column_stack([column.moves for column in self.columns])
        spread = across(self.free, np.hstack([J @ _root(self.covariance), self.lacking]))
        Q, R = np.linalg.qr(spread)
        U, S, _ = svd(R, lapack_driver="gesvd")  # LAPACK's faster one gives up on some matrices of less than full rank
        U = Q @ U
        told = ROUNDING_SHARE * max(float(S.max(initial=0.0)), np.finfo(float).tiny) < S
        turns = [column.unit == "rad" and column.coefficient.basis.always for column in self.columns]
        second = SECOND_ORDER_LEVER * float(np.diag(self.covariance)[turns].max(initial=0.0))
        floor = np.sqrt(len(self.d)) * (LEAST_DIFFERENCE + second) / float(self.sigma.min())
        return U[:, told], np.hypot(S[told], floor)

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        """Columns of the poses, (n,) or (n, k), along the directions that both tell, in sigmas there: (r,) or (r, k)."""
        U, S = self._directions
        return np.asarray(((U.T @ columns).T / S).T)

    @cached_property
    def z(self) -> np.ndarray:
        """The difference, whitened: standard normal where nothing changed, shape (r,)."""
        return self.whitened(across(self.free, self.d[:, None])[:, 0])

    def p_of(self, squares: float, count: int) -> float:
        """Chance of a larger sum of squares of ``count`` of these numbers."""
        if count == 0:
            return 1.0
        return float(fdtrc(count, min(self.freedom, 1e9), squares / count))

    @property
    def p_value(self) -> float:
        """Chance that two calibrations of one robot differ as much."""
        return self.p_of(float(self.z @ self.z), len(self.z))

    @property
    def changed(self) -> bool:
        """Whether more differs than the uncertainty explains."""
        return self.p_value < FALSE_ALARMS

    @cached_property
    def apart(self) -> np.ndarray:
        """Distances of the targets, free motions taken off, [m] and [rad], shape (M, 3) or (M, 6)."""
        left = across(self.free, self.d[:, None])
        return np.asarray(left.reshape(-1, len(self.sigma)) * self.sigma)

    @cached_property
    def expected(self) -> np.ndarray:
        """1-sigma of these distances by the uncertainty of both, shape of :attr:`apart`."""
        U, S = self._directions
        return np.asarray(np.sqrt(np.sum((U * S) ** 2, axis=1)).reshape(-1, len(self.sigma)) * self.sigma)


def difference(a: SavedModel, b: SavedModel, moved: Mapping[str, float] | None = None) -> Difference:
    """Compare two calibrations of one arm.

    Args:
        a: The first.
        b: The second.
        moved: What is added to coefficients of the first beforehand, by name: large changes are none that are linear.

    Raises:
        AridcalError: they are not of the same joints, or saw none of the same configurations.
    """
    both = common_poses(a, b, moved or {})
    noise = [a.scatter[0], b.scatter[0]]
    sigma = np.repeat([max(LEAST_DIFFERENCE, *(n[k] for n in noise)) for k in range(1 + both.turns)], 3)
    per_sigma = np.tile(1.0 / sigma, len(both.readings))[:, None]
    whitened_moves = [J * per_sigma for J in both.J]
    free = both.bodies * per_sigma
    columns, covariances = _together(both.solved, whitened_moves, frozenset(both.frames))
    moves = np.column_stack([column.moves for column in columns])
    lacking, unknown, notices = [], [], [*both.notices, *_shared_rows(a, b)]
    for side, saved in enumerate((a, b)):
        has = np.array([not np.isnan(column.values[side]) for column in columns], dtype=bool)
        variance = np.diag(covariances[side])
        constant = [column.coefficient.basis.always for column in columns]
        well_known = float(variance[constant].max(initial=0.0)) < WELL_KNOWN_SIGMA**2
        fitted = has & (variance > 0.0)
        effects, constants, times = _unknown_to(saved, columns, moves, has, fitted, free, sigma, well_known)
        lacking.append(effects)
        unknown.append(constants)
        covariances[side] *= times
        if constants.shape[1]:
            notices.append(UNKNOWN_NOTICE.format(("first", "second")[side], plural(constants.shape[1], "constant")))
    return Difference(
        columns=columns,
        covariance=covariances[0] + covariances[1],
        lacking=np.hstack(lacking),
        readings=both.readings,
        robot=a.final.model.robot,
        turns=both.turns,
        d=both.d * per_sigma[:, 0],
        free=np.hstack([free, *unknown]),
        sigma=sigma,
        freedom=_freedom(a, b, both.turns),
        frames=both.frames,
        notices=tuple(notices),
    )


def _together(
    both: tuple[SolvedModel, SolvedModel], moves: list[np.ndarray], anew: frozenset[str]
) -> tuple[tuple[CoefficientColumn, ...], np.ndarray]:
    """The coefficients of two calibrations beside one another, and their covariances, shape (2, K, K).

    A coefficient that both have moves the poses alike, but for terms of second order: the mean of both. One that depends on time
    does not, for each calibration has times of its own; there are two of it.
    """
    columns: list[CoefficientColumn] = []
    place: dict[str, int] = {}
    columns_of: list[list[int]] = []
    indices_of: list[list[int]] = []
    for side, (solved, J) in enumerate(zip(both, moves, strict=True)):
        columns_of.append([])
        indices_of.append([])
        for k, c in enumerate(solved.model.coefficients):
            if c.where in anew and c.basis.constant:
                continue
            over_time = any(name in OVER_TIME for name in c.basis.of)
            name = f"{c.name} of {side}" if over_time else c.name
            value = float(solved.theta[k])
            if name not in place:
                place[name] = len(columns)
                columns.append(
                    CoefficientColumn(
                        c, unit_of(solved.model, k), (value, np.nan) if side == 0 else (np.nan, value), J[:, k]
                    )
                )
            else:
                first = columns[place[name]]
                columns[place[name]] = CoefficientColumn(
                    c, first.unit, (first.values[0], value), 0.5 * (first.moves + J[:, k])
                )
            columns_of[side].append(place[name])
            indices_of[side].append(k)
    covariances = np.zeros((2, len(columns), len(columns)))
    for covariance, solved, rows, own_rows in zip(covariances, both, columns_of, indices_of, strict=True):
        covariance[np.ix_(rows, rows)] = solved.covariance[np.ix_(own_rows, own_rows)]
    return tuple(columns), covariances


def _unknown_to(
    saved: SavedModel,
    columns: tuple[CoefficientColumn, ...],
    moves: np.ndarray,
    present: np.ndarray,
    fitted: np.ndarray,
    free: np.ndarray,
    sigma: np.ndarray,
    well_known: bool,
) -> tuple[np.ndarray, np.ndarray, float]:
    """What one calibration cannot know of the coefficients that the other alone has.

    Args:
        saved: The calibration.
        columns: K coefficients.
        moves: Their columns, shape (n, K).
        present: Which of them it has, shape (K,) bool.
        fitted: Which of these it fitted: zeros that it lacks are known to be 0.
        free: Motions of base and target, shape (n, f).
        sigma: See :class:`Difference`.
        well_known: Whether what it fitted is known well enough to say which motions are alike.

    Returns:
        Of effects, and of second order, each of unit variance, shape (n, u); of constants, which may be anything, shape (n, v);
        and times what the calibration's own covariance is larger for these.
    """
    constant = np.array([column.coefficient.basis.always for column in columns], dtype=bool)
    spanned = np.hstack([moves[:, fitted], free])
    residual = across(spanned, moves[:, ~present])
    size = np.sqrt(np.mean(residual**2, axis=0)) * float(sigma.min())
    constant_only = constant[~present]
    same_motion = (
        well_known
        & constant_only
        & (np.sum(residual**2, axis=0) < SAME_MOTION_SHARE * np.sum(moves[:, ~present] ** 2, axis=0))
    )
    value = np.array(
        [np.nanmax(np.abs(column.values)) for column, has in zip(columns, present, strict=True) if not has]
    )
    second_order = residual[:, same_motion] * value[same_motion]
    effects, unknown = (
        residual[:, ~constant_only],
        residual[:, constant_only & ~same_motion & (UNTOLD_SIGMA * size > LEAST_DIFFERENCE)],
    )
    noise = np.maximum(np.repeat([saved.scatter[0][k] for k in range(len(sigma) // 3)], 3), LEAST_DIFFERENCE)
    places = len(moves) // len(sigma)
    rows = float(saved.record.get("data", {}).get("train", 0.0)) / places
    own_noise = np.tile(sigma / noise, places)[:, None]
    times = 1.0 + float(np.sum(np.mean((UNTOLD_SIGMA * unknown * own_noise) ** 2, axis=0)))
    if not effects.shape[1]:
        return second_order, unknown, times
    seen = effects * own_noise
    prior = (
        np.maximum(size[~constant_only] / UNTOLD_SIGMA, np.finfo(float).tiny) ** 2
    )  # alone, none moves the target by more than LOOSE
    inverse, _ = pseudo_inverse(rows * seen.T @ seen + np.diag(prior), ROUNDING_SHARE**2)
    return np.hstack([second_order, effects @ _root(inverse)]), unknown, times


def _root(covariance: np.ndarray) -> np.ndarray:
    """L with L L^T the covariance, shape (K, K); variances that rounding made negative count as zero."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _freedom(a: SavedModel, b: SavedModel, turns: bool) -> float:
    """Degrees of freedom behind the noise of both (Welch 1947 for two variances that count alike): infinite if declared."""
    freedoms = [_freedom_of(saved, turns) for saved in (a, b)]
    weights = sum(0.25 / freedom for freedom in freedoms)
    return 1.0 / weights if weights > 0.0 else np.inf


def _freedom_of(saved: SavedModel, turns: bool) -> float:
    """Degrees of freedom of one calibration's noise, over all channels of its rows."""
    kinds = saved.record.get("scatter_of_kinds", {})
    if kinds:
        return float(sum(part["freedom"] for channels in kinds.values() for part in channels.values()))
    return float(sum(saved.scatter[1][: 1 + turns]))


def _shared_rows(a: SavedModel, b: SavedModel) -> list[str]:
    """Notices of why two calibrations are not independent."""
    data = [saved.record.get("data", {}).get("sha256") for saved in (a, b)]
    notices = []
    if data[0] is not None and data[0] == data[1]:
        notices.append(
            "both were made from the same rows: their noise is the same, and less differs than is allowed for"
        )
    if any("lineage" in saved.record for saved in (a, b)):
        notices.append(
            "one is a repair and keeps what an earlier calibration knew: if that is the other, what it kept cannot differ"
        )
    return notices
