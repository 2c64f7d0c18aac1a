r"""How well the target is known over the workspace: what the rows tell, and what no reading tells.

The target's own twist by the coefficients is :math:`J`, shape (6, K); a point at d from its origin, in the target's axes, moves
by :math:`J_v - [R d]_\times J_\omega`. Its covariance is that by the coefficients, and that by the constants which were not
identified, and stay nominal:

.. math:: V = J_1 \Sigma J_1^T + J_u C J_u^T, \qquad J_u = J_2 - J_1 H_{11}^{-1} H_{12}, \qquad
          C = (H_{22} - H_{21} H_{11}^{-1} H_{12} + I / \ell^2)^{-1}

with the information H of the rows on the constants, those identified first, and :math:`\ell` what one of them may be off by
before anything was measured. A combination that moves no target has :math:`J_u = 0` and costs nothing; one that no reading tells,
and that moves the point, makes it unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.corrections.regional_kind import far_from_nodes
from aridcal.engine.fit.constants import has_world, measures_target
from aridcal.engine.fit.least_squares import Fit, thin
from aridcal.engine.fit.noise import covariance_of_rows
from aridcal.engine.fit.normal_equations import solve
from aridcal.engine.fit.problem import ROWS_PER_BLOCK, problem
from aridcal.engine.fit.residual import linearise
from aridcal.engine.model.many_rows import blocks, short_stretches
from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.coverage import POSE_PARTS, Coverage, holes, largest

WORKSPACE_SAMPLES = 512
"""Work: Configurations over the workspace: a share of 5 % is then known to 1 %, and the worst of them is that of all but some
thousandths."""

UNTOLD_SIGMA = 0.1
"""[m] and [rad]: what a constant, or an effect at the target, may be off by that no row tells. No robot is wrong by more; what is
told is known a thousand times better, so that its size decides nothing else. Plans and comparisons take the same."""

KNOWN_TARGET_SIGMA = 0.01
"""[m] and [rad]: a target that what no row tells may move by more is not known. A tenth of :data:`UNTOLD_SIGMA`."""

FAINT_COMBINATION_SHARE = 0.1
"""Share of :data:`KNOWN_TARGET_SIGMA` by which a combination of constants moves the target somewhere, or is kept in no file."""

OpenCombination = tuple[tuple[Coefficient, float], ...]
"""A combination of constants, each with how far it may be off together with the others, [m] and [rad]."""

MOST_KNOWLEDGE_ROWS = 20_000
"""Work: Rows that tell what was measured, of more: sums over so many are those of all to a hundredth, and the largest
uncertainty among them is that of all but one in some thousands."""

RIGID_MOTION_ROWS = 100
"""Work: Rows by which it is told whether something moves the whole arm as one body: six would do."""

RIGID_MOTION_TOLERANCE = 1e-7
"""Work: [m]: what a motion is off by from that of one body, RMS, to be none; rounding is a thousand times smaller."""


@dataclass(frozen=True)
class Workspace:
    """Configurations, and how well the target is known there.

    Attributes:
        rows: As the model sees them, M of them.
        readings: Shape (M, columns), [rad] or [m].
        places: Places of the target, or of the tool's point, in the base frame, shape (M, 3), [m].
        covariance: Covariance of that place, world axes, shape (M, 3, 3), [m²].
        turns: Covariance of the rotation vector, world axes, shape (M, 3, 3), [rad²].
        axes: Base axes in the world, shape (M, 3, 3).
        measured: False where nothing like it was measured: the model extrapolates there, shape (M,).
        observable: False where the place is not known, because no reading tells a part of what moves it, shape (M,).
        turns_told: False where the rotation is not known, likewise, shape (M,).
    """

    rows: ModelRows
    readings: np.ndarray
    places: np.ndarray
    covariance: np.ndarray
    turns: np.ndarray
    axes: np.ndarray
    measured: np.ndarray
    observable: np.ndarray
    turns_told: np.ndarray

    def __len__(self) -> int:
        return len(self.readings)

    @cached_property
    def _worst(self) -> tuple[np.ndarray, np.ndarray]:
        return worst_direction(self.axes.transpose(0, 2, 1) @ self.covariance @ self.axes)

    @property
    def sigma(self) -> np.ndarray:
        """1-sigma in the worst direction, shape (M,), [m]."""
        return self._worst[0]

    @property
    def way(self) -> np.ndarray:
        """The worst direction of the position, in base axes, its largest number positive, shape (M, 3)."""
        return self._worst[1]

    @property
    def turn(self) -> np.ndarray:
        """1-sigma of the rotation about its worst axis, shape (M,), [rad]."""
        return worst_direction(self.turns)[0]

    def select(self, some: np.ndarray) -> Workspace:
        """Some of the configurations."""
        parts = {f.name: getattr(self, f.name)[some] for f in fields(self)}
        return Workspace(**parts)


@dataclass(frozen=True)
class Knowledge:
    """A calibrated model, and how well its rows tell it.

    Attributes:
        fit: The stage.
        wide: Its model, with the D constants that were not identified behind its own K coefficients.
        follows: What the coefficients take up of each of the D constants, shape (K, D).
        open: Covariance of the D constants beyond that: what no row tells, shape (D, D).
        coverage: What the fitted rows were like.
    """

    fit: Fit
    wide: Model
    follows: np.ndarray
    open: np.ndarray
    coverage: Coverage

    def columns(self, rows: ModelRows, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How a point on the target moves, and the target turns, with the coefficients and with the open constants.

        Args:
            rows: Of the fit's own model, N of them.
            tool: The point, in the target's axes, shape (3,), [m].

        Returns:
            The point, world frame, shape (N, 3), [m]; columns of its shift and of the turn with the coefficients,
            shape (N, 6, K), and with the open constants, shape (N, 6, D).
        """
        count, extra = len(self.fit.theta), len(self.open)
        R, p, J = self.wide.jacobian(np.append(self.fit.theta, np.zeros(extra)), rows)
        arm = R @ tool
        J = shifted(J, arm)
        by_coefficients, by_open = J[:, :, :count], J[:, :, count:]
        return p + arm, by_coefficients, by_open - by_coefficients @ self.follows

    def over(
        self, data: Dataset, readings: np.ndarray, like: np.ndarray, tool: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> Workspace:
        """How well a point on the target is known in some configurations.

        Args:
            data: The rows that were fitted.
            readings: Shape (M, columns), [rad] or [m].
            like: Number of the row whose conditions (station, target, temperature) each configuration has, shape (M,).
            tool: The point, in the target's axes, [m].
        """
        model = self.fit.model
        rows = self._rows(data, readings, like)
        axes, origin = self._bases(rows)
        places, covariance, turns = np.empty((len(rows), 3)), *np.empty((2, len(rows), 3, 3))
        std, unknown = np.empty((len(rows), 6)), np.empty((2, len(rows)))
        for start in range(0, len(rows), ROWS_PER_BLOCK):
            some = slice(start, start + ROWS_PER_BLOCK)
            p, by_coefficients, by_open = self._spread(rows[some], np.asarray(tool, dtype=float))
            total = by_coefficients + by_open
            places[some] = np.einsum("nji,nj->ni", axes[some], p - origin[some])
            covariance[some], turns[some] = total[:, :3, :3], total[:, 3:, 3:]
            std[some] = np.sqrt(np.maximum(np.einsum("nii->ni", by_coefficients), 0.0))
            unknown[:, some] = [worst_direction(by_open[:, part, part])[0] for part in POSE_PARTS]
        columns = {name: values[like] for name, values in data.conditions.items()}
        columns |= dict(zip(model.robot.readings, readings.T, strict=True))
        measured, determined = ~self.coverage.beyond(columns, std), unknown < KNOWN_TARGET_SIGMA
        fields = [c.basis for c in model.coefficients if c.basis.form == "ball"]
        if fields:
            nominal = model.target_places(rows, readings)
            measured &= ~far_from_nodes(fields, nominal)
        return Workspace(rows, readings, places, covariance, turns, axes, measured, *determined)

    def _spread(self, rows: ModelRows, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A point on the target as :meth:`columns` has it, and its covariance by the coefficients and by the open constants."""
        local, extra = self.wide.local, len(self.open)
        if local is None:
            p, by_coefficients, by_open = self.columns(rows, tool)
            return p, covariance_of_rows(by_coefficients, self.fit.covariance), covariance_of_rows(by_open, self.open)
        R, p, twists = self.wide.motions(np.append(self.fit.theta, np.zeros(extra)), rows)
        arm, covariance = R @ tool, np.pad(self.fit.covariance, (0, extra))
        twists = shifted(twists, arm)
        # Only constants follow the open ones: coefficients that act in few rows have no part in it.
        combinations = np.vstack([-self.follows, np.eye(extra)])[local.plain]
        by_open = twists[:, :, local.carrier[local.plain]] @ combinations
        return p + arm, local.carried(twists, rows.phi, covariance), covariance_of_rows(by_open, self.open)

    def untold(self, rows: ModelRows, turns: bool) -> tuple[OpenCombination, ...]:
        """Independent combinations of constants that no reading tells, and that move the target or turn it somewhere.

        Args:
            rows: Where, of the fit's own model.
            turns: Whether its rotation counts.
        """
        if not len(self.open):
            return ()
        values, vectors = np.linalg.eigh(self.open)
        size = vectors * np.sqrt(np.maximum(values, 0.0))
        by_open = self.columns(rows, np.zeros(3))[2][:, : 6 if turns else 3] @ size
        _, _, axes = np.linalg.svd(by_open.reshape(-1, len(size)), full_matrices=False)
        moves = np.linalg.norm((by_open @ axes.T).reshape(len(rows), -1, 3, len(axes)), axis=2).max(axis=(0, 1))
        combinations = []
        for axis in axes[moves > FAINT_COMBINATION_SHARE * KNOWN_TARGET_SIGMA]:
            theta = np.concatenate([-self.follows @ size @ axis, size @ axis])
            of = zip(self.wide.coefficients, theta.tolist(), strict=True)
            combinations.append(tuple((c, value) for c, value in of if value and c.basis.constant))
        return tuple(combinations)

    def places(self, data: Dataset, readings: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Places of the target in some configurations, in the base frame, shape (M, 3), [m]; see :meth:`over`."""
        places = np.empty((len(readings), 3))
        for part in blocks(len(readings)):
            rows = self._rows(data, readings[part], like[part])
            axes, origin = self._bases(rows)
            at = self.fit.model.poses(self.fit.theta, rows)[1]
            places[part] = np.einsum("nji,nj->ni", axes, at - origin)
        return places

    def _rows(self, data: Dataset, readings: np.ndarray, like: np.ndarray) -> ModelRows:
        """Rows of the model at other readings, under the conditions of the rows ``like``."""
        covariates = {name: values[like] for name, values in data.conditions.items()}
        station, target = (None if v is None else v[like] for v in (data.labels.station, data.labels.target))
        return self.fit.model.rows(readings, covariates, station, target)

    def _bases(self, rows: ModelRows) -> tuple[np.ndarray, np.ndarray]:
        """Axes of each row's base in the world, shape (M, 3, 3), and its origin, shape (M, 3), [m]."""
        bases = self.fit.model.frames(self.fit.theta)[0]
        axes = np.array([frame.rotation for _, frame in bases])
        origin = np.array([frame.translation for _, frame in bases])
        return axes[rows.world], origin[rows.world]


def worst_direction(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1-sigma of vectors in their worst direction, shape (N,), and that direction, its largest number positive, shape (N, 3).

    Args:
        covariance: Shape (N, 3, 3).
    """
    values, vectors = np.linalg.eigh(covariance)
    worst = vectors[:, :, -1]
    largest = np.abs(worst).argmax(axis=1, keepdims=True)
    return np.sqrt(np.maximum(values[:, -1], 0.0)), worst * np.sign(np.take_along_axis(worst, largest, axis=1))


def target_covariance(
    model: Model, theta: np.ndarray, covariance: np.ndarray, rows: ModelRows, tool: np.ndarray | None = None
) -> np.ndarray:
    r"""Covariance :math:`J \Sigma J^T` of the target's position [m] and rotation vector [rad], world axes, shape (N, 6, 6).

    Args:
        model: K coefficients.
        theta: Their values, shape (K,).
        covariance: Their covariance, shape (K, K).
        rows: N configurations.
        tool: A point that moves with the target, in its axes, shape (3,), [m], in place of its origin.
    """
    covariances, local, chains = np.empty((len(rows), 6, 6)), model.local, model.chains(rows)
    for of, chain, of_chain, its_rows in chains:
        covariances[of] = target_covariance(
            chain, theta[of_chain], covariance[np.ix_(of_chain, of_chain)], its_rows, tool
        )
    for some in [] if chains else short_stretches(len(rows)):
        R, _, J = (model.jacobian if local is None else model.motions)(theta, rows[some])
        J = J if tool is None else shifted(J, R @ tool)
        covariances[some] = (
            covariance_of_rows(J, covariance) if local is None else local.carried(J, rows.phi[some], covariance)
        )
    return covariances


def target_std(model: Model, theta: np.ndarray, covariance: np.ndarray, rows: ModelRows) -> np.ndarray:
    """Roots of the diagonals of :func:`target_covariance`, shape (N, 6): the whole would take six times the memory."""
    std = np.empty((len(rows), 6))
    for part in blocks(len(rows)):
        variance = np.einsum("nii->ni", target_covariance(model, theta, covariance, rows[part]))
        std[part] = np.sqrt(np.maximum(variance, 0.0))
    return std


def shifted(J: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Twists of the target, shape (N, 6, K), as those of points that are an arm (N, 3), [m], from its origin."""
    moved = J.copy()
    moved[:, :3] += np.cross(J[:, 3:], arm[:, :, None], axis=1)
    return moved


def knowledge(fit: Fit, train: Dataset, candidates: Sequence[Coefficient]) -> Knowledge:
    """How well the rows tell a calibrated model.

    Args:
        fit: The stage.
        train: The rows that it was fitted to.
        candidates: All constants that the campaign asks for; of those that the fit has not, some combinations may be open.
    """
    model, count = fit.model, len(fit.theta)
    names = set(model.names)
    extra_constants = tuple(c for c in candidates if c.name not in names and c.basis.constant)
    wide = model.with_coefficients((*model.coefficients, *extra_constants))
    extra = len(extra_constants)
    follows, open_covariance = np.zeros((count, extra)), np.zeros((extra, extra))
    if extra:
        wide_problem = problem(wide, train)
        some = thin(wide_problem.rows, MOST_KNOWLEDGE_ROWS, wide_problem.groups)
        weight = fit.weight[some] * (len(train) / len(some))
        at = np.append(fit.theta, np.zeros(extra))
        wide_problem = wide_problem if len(some) == len(wide_problem) else wide_problem.select(some)
        H = linearise(wide_problem, at, weight, fit.sigma).equations.information(fit.sigma)
        constants = np.flatnonzero([c.basis.constant for c in model.coefficients])
        cross = H[constants][:, count:]
        follows[constants] = solve(H[np.ix_(constants, constants)], cross)
        remaining = H[count:, count:] - cross.T @ follows[constants]
        values, vectors = np.linalg.eigh(0.5 * (remaining + remaining.T))
        size = wide.sizes[count:]
        open_covariance = np.linalg.inv(
            vectors * np.maximum(values, 0.0) @ vectors.T + np.diag(1.0 / (UNTOLD_SIGMA * size) ** 2)
        )
    result = Knowledge(fit, wide, follows, open_covariance, _coverage(fit, train))
    conventions = [] if has_world(train) else ["world_base"]
    conventions += [] if measures_target(train) else ["tip_target"]
    return _less_frames(conventions, result, train) if conventions else result


def _less_frames(frames: Sequence[str], known_model: Knowledge, train: Dataset) -> Knowledge:
    """The same knowledge without open motions that only shift a frame.

    Where no instrument knows the world, the base is where the calibration has it by convention; so is the tip where cameras
    measure everything, whose own mounting takes up the error of the last link.
    """
    model, count = known_model.fit.model, len(known_model.fit.theta)
    some = np.unique(np.linspace(0, len(train) - 1, RIGID_MOTION_ROWS).round().astype(int))
    part = train.select(some)
    rows = rows_of_data(model, part)
    rigid = [Coefficient(frame, component) for frame in frames for component in FRAME_COMPONENTS]
    moved = model.with_coefficients((*model.coefficients, *rigid))
    _, _, J = moved.jacobian(np.append(known_model.fit.theta, np.zeros(len(rigid))), rows)
    _, _, by_open = known_model.columns(rows, np.zeros(3))
    moves = J[:, :, count:].reshape(-1, len(rigid))
    size = known_model.wide.sizes[count:]
    flat = by_open.reshape(len(moves), -1) * (UNTOLD_SIGMA * size)
    _, values, V = np.linalg.svd(flat - moves @ np.linalg.lstsq(moves, flat, rcond=None)[0])
    matters = np.zeros(len(V), dtype=bool)
    matters[: len(values)] = values > RIGID_MOTION_TOLERANCE * np.sqrt(len(moves))
    projector = size[:, None] * (V[matters].T @ V[matters]) / size
    return replace(known_model, open=projector @ known_model.open @ projector.T)


def _coverage(fit: Fit, train: Dataset) -> Coverage:
    """Ranges, holes and largest uncertainty of the fitted rows without outliers."""
    inliers = train.select(~fit.outliers)
    model = fit.model
    columns = dict(zip(model.robot.readings, inliers.readings.T, strict=True))
    columns |= {name: inliers.conditions[name] for name in model.needs}
    rows = rows_of_data(model, inliers)
    rows = rows[thin(rows, MOST_KNOWLEDGE_ROWS)]
    std = target_std(model, fit.theta, fit.covariance, rows)
    if not inliers.sees_turns:  # that of a target whose rotation was never measured says nothing
        std[:, 3:] = np.inf
    ranges = {name: (float(np.nanmin(v)), float(np.nanmax(v))) for name, v in columns.items()}
    gaps = {name: gap for name, v in columns.items() if (gap := holes(v))}
    return Coverage(ranges, gaps, largest(std))


def spread_out(low: np.ndarray, high: np.ndarray, count: int = WORKSPACE_SAMPLES) -> np.ndarray:
    r"""Configurations evenly between two corners, shape (count, columns), by an additive sequence.

    .. math:: u_n = (1/2 + n \alpha) \bmod 1, \qquad \alpha_k = g^{-k}, \qquad g^{d+1} = g + 1

    The step's powers are as far from fractions of small numbers as d of them can be, so that no two configurations are near
    each other (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"). Of each column the ranks are taken,
    so that every one of ``count`` equal slices of it has one configuration.
    """
    columns = len(low)
    polynomial = np.concatenate([[1.0], np.zeros(columns - 1), [-1.0, -1.0]])
    g = float(np.roots(polynomial).real.max())
    share = (0.5 + np.outer(np.arange(1, count + 1), g ** -np.arange(1.0, columns + 1))) % 1.0
    rank = np.argsort(np.argsort(share, axis=0), axis=0)
    return np.asarray(low + (high - low) * (rank + 0.5) / count)


def ends(data: Dataset, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest readings of the joints' whole range, shape (columns,) each; those of the rows where there is no limit.

    A joint that turns further than once has the one turn around its readings: beyond it the geometry repeats.

    Args:
        data: Rows.
        limits: Limits of the columns, shape (columns, 2), infinite where there are none.
    """
    measured = np.stack([data.readings.min(axis=0), data.readings.max(axis=0)], axis=1)
    low, high = np.where(np.isfinite(limits), limits, measured).T
    turning = np.array([kind != "prismatic" for kind in data.kinds])
    half = np.where(turning, np.maximum(np.pi, np.ptp(measured, axis=1) / 2), np.inf)
    middle = measured.mean(axis=1)
    return np.maximum(low, middle - half), np.minimum(high, middle + half)
