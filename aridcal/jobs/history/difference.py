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
from scipy.stats import f as fisher

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.normal_equations import across, pseudo_inverse
from aridcal.engine.robot.chain import Robot
from aridcal.engine.trust.workspace import LOOSE
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.history.poses import OVER_TIME, seen_by_both
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.jobs.maintain.repair import unit_of
from aridcal.system.wording import counted

SMALLEST = 1e-7
"""[m] and [rad]: what is no difference for anybody, RMS over the configurations: rounding is smaller."""

SECOND = 0.1
"""[m]: what a squared angle moves that is hardly known, when base and tool took their part of it: a tenth of what it does at a
metre. Of angles known to 1 mrad it is 0.1 um."""

ALIKE = 1e-5
"""Share of a constant's squares that other constants leave of it where it is one motion with them but for terms of second order,
of constants off by 3 mm or 3 mrad: it was told, under their names. Its value times what is left is what these terms may be."""

WELL = 3e-3
"""[m] and [rad]: sigma of the least known constant above which this cannot be said: in a corner all motions look alike."""

RANK = 1e-9
"""Share of the largest singular value, coefficients scaled by their uncertainty, below which a direction is rounding."""

UNTOLD = (
    "the {} calibration could not tell {} that the other has: what they do was taken off, and less is told of all else"
)
"""Notice of rows that tell too little."""


@dataclass(frozen=True)
class Column:
    """One coefficient in the configurations that are compared.

    Attributes:
        coefficient: Of the arm; frames that were set up anew have none.
        unit: Of it: m or rad; of an effect's that of the motion, per unit of its basis.
        values: In the first and the second calibration; NaN where it has none.
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
        columns: What both know of the arm, K coefficients.
        covariance: Of their differences, shape (K, K): the sum of both, a coefficient that one has not being known there.
        lacking: What the effects of one may be off by in the other, which has none, each of unit variance, shape (n, u).
        readings: Of the configurations, shape (M, columns), [rad] or [m].
        robot: Whose they are.
        turns: Whether rotations are compared.
        d: What differs, in sigmas, shape (n,).
        free: What nobody can tell, shape (n, f).
        sigma: What the numbers of a configuration were divided by, shape (6,) or (3,).
        freedom: Behind the noise of both; infinite where it was declared.
        frames: What was set up anew, ``world_base`` and ``tip_target``, and how far apart both have it, [m] and [rad].
        notices: What a reader should know.
    """

    columns: tuple[Column, ...]
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
        told = RANK * max(float(S.max(initial=0.0)), np.finfo(float).tiny) < S
        turns = [column.unit == "rad" and column.coefficient.basis.always for column in self.columns]
        second = SECOND * float(np.diag(self.covariance)[turns].max(initial=0.0))
        floor = np.sqrt(len(self.d)) * (SMALLEST + second) / float(self.sigma.min())
        return U[:, told], np.hypot(S[told], floor)

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        """Columns of the poses, (n,) or (n, k), in the directions that both tell, divided by what the uncertainty is there."""
        U, S = self._directions
        return np.asarray(((U.T @ columns).T / S).T)

    @cached_property
    def z(self) -> np.ndarray:
        """What differs, likewise: standard normal where nothing changed, shape (r,)."""
        return self.whitened(across(self.free, self.d[:, None])[:, 0])

    def p_of(self, squares: float, count: int) -> float:
        """Chance of a sum of squares of so many of these numbers."""
        if count == 0:
            return 1.0
        return float(fisher.sf(squares / count, count, min(self.freedom, 1e9)))

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
        """How far apart the targets are, free motions taken off, [m] and [rad], shape (M, 3) or (M, 6)."""
        left = across(self.free, self.d[:, None])
        return np.asarray(left.reshape(-1, len(self.sigma)) * self.sigma)

    @cached_property
    def expected(self) -> np.ndarray:
        """1-sigma of these, shape of :attr:`apart`, by the uncertainty of both."""
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
    both = seen_by_both(a, b, moved or {})
    noise = [a.scatter[0], b.scatter[0]]
    sigma = np.repeat([max(SMALLEST, *(n[k] for n in noise)) for k in range(1 + both.turns)], 3)
    per = np.tile(1.0 / sigma, len(both.readings))[:, None]
    own = [J * per for J in both.J]
    free = both.bodies * per
    columns, covariances = _together(both.solved, own, frozenset(both.frames))
    every = np.column_stack([column.moves for column in columns])
    lacking, untold, notices = [], [], [*both.notices, *_shared_rows(a, b)]
    for side, saved in enumerate((a, b)):
        known = np.array([not np.isnan(column.values[side]) for column in columns], dtype=bool)
        variance = np.diag(covariances[side])
        constant = [column.coefficient.basis.always for column in columns]
        well = float(variance[constant].max(initial=0.0)) < WELL**2
        fitted = known & (variance > 0.0)
        effects, constants, times = _not_seen(saved, columns, every, known, fitted, free, sigma, well)
        lacking.append(effects)
        untold.append(constants)
        covariances[side] *= times
        if constants.shape[1]:
            notices.append(UNTOLD.format(("first", "second")[side], counted(constants.shape[1], "constant")))
    return Difference(
        columns=columns,
        covariance=covariances[0] + covariances[1],
        lacking=np.hstack(lacking),
        readings=both.readings,
        robot=a.final.model.robot,
        turns=both.turns,
        d=both.d * per[:, 0],
        free=np.hstack([free, *untold]),
        sigma=sigma,
        freedom=_freedom(a, b, both.turns),
        frames=both.frames,
        notices=tuple(notices),
    )


def _together(
    both: tuple[SolvedModel, SolvedModel], moves: list[np.ndarray], anew: frozenset[str]
) -> tuple[tuple[Column, ...], np.ndarray]:
    """The coefficients of two calibrations beside one another, and their covariances, shape (2, K, K).

    A coefficient that both have moves the poses alike, but for terms of second order: the mean of both. One that depends on time
    does not, for each calibration has times of its own; there are two of it.
    """
    columns: list[Column] = []
    place: dict[str, int] = {}
    at: list[list[int]] = []
    kept: list[list[int]] = []
    for side, (solved, J) in enumerate(zip(both, moves, strict=True)):
        at.append([])
        kept.append([])
        for k, c in enumerate(solved.model.coefficients):
            if c.where in anew and c.basis.constant:
                continue
            own = any(name in OVER_TIME for name in c.basis.of)
            name = f"{c.name} of {side}" if own else c.name
            value = float(solved.theta[k])
            if name not in place:
                place[name] = len(columns)
                columns.append(
                    Column(c, unit_of(solved.model, k), (value, np.nan) if side == 0 else (np.nan, value), J[:, k])
                )
            else:
                first = columns[place[name]]
                columns[place[name]] = Column(c, first.unit, (first.values[0], value), 0.5 * (first.moves + J[:, k]))
            at[side].append(place[name])
            kept[side].append(k)
    covariances = np.zeros((2, len(columns), len(columns)))
    for covariance, solved, rows, own_rows in zip(covariances, both, at, kept, strict=True):
        covariance[np.ix_(rows, rows)] = solved.covariance[np.ix_(own_rows, own_rows)]
    return tuple(columns), covariances


def _not_seen(
    saved: SavedModel,
    columns: tuple[Column, ...],
    moves: np.ndarray,
    known: np.ndarray,
    fitted: np.ndarray,
    free: np.ndarray,
    sigma: np.ndarray,
    well: bool,
) -> tuple[np.ndarray, np.ndarray, float]:
    """What one calibration cannot know of the coefficients that only the other has.

    Args:
        saved: The calibration.
        columns: K coefficients.
        moves: Their columns, shape (n, K).
        known: Which of them it has, shape (K,) bool.
        fitted: Which of these it fitted: zeros that it lacks are known to be 0.
        free: Motions of base and target, shape (n, f).
        sigma: See :class:`Difference`.
        well: Whether what it fitted is known well enough to say which motions are alike.

    Returns:
        Of effects, and of second order, each of unit variance, shape (n, u); of constants, which may be anything, shape (n, v);
        and times what the calibration's own covariance is larger for these.
    """
    constant = np.array([column.coefficient.basis.always for column in columns], dtype=bool)
    mine = np.hstack([moves[:, fitted], free])
    left = across(mine, moves[:, ~known])
    size = np.sqrt(np.mean(left**2, axis=0)) * float(sigma.min())
    own = constant[~known]
    alike = well & own & (np.sum(left**2, axis=0) < ALIKE * np.sum(moves[:, ~known] ** 2, axis=0))
    value = np.array([np.nanmax(np.abs(column.values)) for column, has in zip(columns, known, strict=True) if not has])
    slight = left[:, alike] * value[alike]
    effects, untold = left[:, ~own], left[:, own & ~alike & (LOOSE * size > SMALLEST)]
    noise = np.maximum(np.repeat([saved.scatter[0][k] for k in range(len(sigma) // 3)], 3), SMALLEST)
    places = len(moves) // len(sigma)
    rows = float(saved.record.get("data", {}).get("train", 0.0)) / places
    own_noise = np.tile(sigma / noise, places)[:, None]
    times = 1.0 + float(np.sum(np.mean((LOOSE * untold * own_noise) ** 2, axis=0)))
    if not effects.shape[1]:
        return slight, untold, times
    heard = effects * own_noise
    prior = np.maximum(size[~own] / LOOSE, np.finfo(float).tiny) ** 2  # alone, none moves the target by more than LOOSE
    inverse, _ = pseudo_inverse(rows * heard.T @ heard + np.diag(prior), RANK**2)
    return np.hstack([slight, effects @ _root(inverse)]), untold, times


def _root(covariance: np.ndarray) -> np.ndarray:
    """L with L L^T the covariance, shape (K, K); rounding below zero is nothing."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _freedom(a: SavedModel, b: SavedModel, turns: bool) -> float:
    """Degrees of freedom behind the noise of both (Welch 1947 for two variances that count alike): infinite if declared."""
    of_each = [_freedom_of(saved, turns) for saved in (a, b)]
    weights = sum(0.25 / freedom for freedom in of_each)
    return 1.0 / weights if weights > 0.0 else np.inf


def _freedom_of(saved: SavedModel, turns: bool) -> float:
    """Of one calibration, over all that its rows measured."""
    kinds = saved.record.get("scatter_of_kinds", {})
    if kinds:
        return float(sum(part["freedom"] for channels in kinds.values() for part in channels.values()))
    return float(sum(saved.scatter[1][: 1 + turns]))


def _shared_rows(a: SavedModel, b: SavedModel) -> list[str]:
    """What makes two calibrations no two independent ones."""
    data = [saved.record.get("data", {}).get("sha256") for saved in (a, b)]
    found = []
    if data[0] is not None and data[0] == data[1]:
        found.append("both were made from the same rows: their noise is the same, and less differs than is allowed for")
    if any("lineage" in saved.record for saved in (a, b)):
        found.append(
            "one is a repair and keeps what an earlier calibration knew: if that is the other, what it kept cannot differ"
        )
    return found
