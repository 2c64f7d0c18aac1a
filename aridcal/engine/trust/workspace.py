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
from aridcal.engine.fit.noise import carried
from aridcal.engine.fit.normal_equations import solve
from aridcal.engine.fit.problem import BLOCK, problem
from aridcal.engine.fit.residual import linearise
from aridcal.engine.model.many_rows import blocks, few
from aridcal.engine.model.model import Model, Rows
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.coverage import CHANNELS, Seen, holes, largest

SAMPLES = 512
"""Work: Configurations over the workspace: a share of 5 % is then known to 1 %, and the worst of them is that of all but some
thousandths."""

LOOSE = 0.1
"""[m] and [rad]: what a constant, or an effect at the target, may be off by that no row tells. No robot is wrong by more; what is
told is known a thousand times better, so that its size decides nothing else. Plans and comparisons take the same."""

TOLD = 0.01
"""[m] and [rad]: a target that what no row tells may move by more is not known. A tenth of :data:`LOOSE`."""

FAINTLY = 0.1
"""Share of :data:`TOLD` by which a combination of constants moves the target somewhere, or is kept in no file."""

Untold = tuple[tuple[Coefficient, float], ...]
"""A combination of constants, each with how far it may be off together with the others, [m] and [rad]."""

ENOUGH = 20_000
"""Work: Rows that tell what was measured, of more: sums over so many are those of all to a hundredth, and the largest
uncertainty among them is that of all but one in some thousands."""

ASKED = 100
"""Work: Rows by which it is told whether something moves the whole arm as one body: six would do."""

FELT = 1e-7
"""Work: [m]: what a motion is off by from that of one body, RMS, to be none; rounding is a thousand times smaller."""


@dataclass(frozen=True)
class Workspace:
    """Configurations, and how well the target is known there.

    Attributes:
        rows: As the model sees them, M of them.
        readings: Shape (M, columns), [rad] or [m].
        places: Of the target, or of the tool's point, in the base frame, shape (M, 3), [m].
        covariance: Of that place, world axes, shape (M, 3, 3), [m²].
        turns: Of the rotation vector, world axes, shape (M, 3, 3), [rad²].
        axes: Base axes in the world, shape (M, 3, 3).
        measured: False where nothing like it was measured: the model extrapolates there, shape (M,).
        told: False where the place is not known, because no reading tells a part of what moves it, shape (M,).
        turns_told: The same of the rotation.
    """

    rows: Rows
    readings: np.ndarray
    places: np.ndarray
    covariance: np.ndarray
    turns: np.ndarray
    axes: np.ndarray
    measured: np.ndarray
    told: np.ndarray
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
        """That direction, in base axes, its largest number positive, shape (M, 3)."""
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
    """A calibrated model, and what its rows told of it.

    Attributes:
        fit: The stage.
        wide: Its model with the constants that were not identified behind its own.
        follows: What the coefficients take up of each of those, shape (K, D).
        open: Covariance of what is left of these, shape (D, D).
        seen: What the fitted rows were like.
    """

    fit: Fit
    wide: Model
    follows: np.ndarray
    open: np.ndarray
    seen: Seen

    def columns(self, rows: Rows, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How a point on the target moves, and the target turns, with the coefficients and with what is open.

        Args:
            rows: Of the fit's own model, N of them.
            tool: The point, in the target's axes, shape (3,), [m].

        Returns:
            The point, world frame, shape (N, 3), [m]; columns of its shift and of the turn, shape (N, 6, K), and the same with
            what is open, shape (N, 6, D).
        """
        count, extra = len(self.fit.theta), len(self.open)
        R, p, J = self.wide.jacobian(np.append(self.fit.theta, np.zeros(extra)), rows)
        arm = R @ tool
        J = shifted(J, arm)
        own, more = J[:, :, :count], J[:, :, count:]
        return p + arm, own, more - own @ self.follows

    def over(
        self, data: Dataset, readings: np.ndarray, like: np.ndarray, tool: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> Workspace:
        """How well a point on the target is known in some configurations.

        Args:
            data: The rows that were fitted.
            readings: Shape (M, columns), [rad] or [m].
            like: Number of the row that each is like in all but its joints: station, target, temperature; shape (M,).
            tool: The point, in the target's axes, [m].
        """
        model = self.fit.model
        rows = self._rows(data, readings, like)
        axes, origin = self._bases(rows)
        places, covariance, turns = np.empty((len(rows), 3)), *np.empty((2, len(rows), 3, 3))
        std, unknown = np.empty((len(rows), 6)), np.empty((2, len(rows)))
        for start in range(0, len(rows), BLOCK):
            some = slice(start, start + BLOCK)
            p, known, left = self._spread(rows[some], np.asarray(tool, dtype=float))
            every = known + left
            places[some] = np.einsum("nji,nj->ni", axes[some], p - origin[some])
            covariance[some], turns[some] = every[:, :3, :3], every[:, 3:, 3:]
            std[some] = np.sqrt(np.maximum(np.einsum("nii->ni", known), 0.0))
            unknown[:, some] = [worst_direction(left[:, part, part])[0] for part in CHANNELS]
        columns = {name: values[like] for name, values in data.conditions.items()}
        columns |= dict(zip(model.robot.readings, readings.T, strict=True))
        measured, told = ~self.seen.beyond(columns, std), unknown < TOLD
        fields = [c.basis for c in model.coefficients if c.basis.form == "ball"]
        if fields:
            nominal = model.target_places(rows, readings)
            measured &= ~far_from_nodes(fields, nominal)
        return Workspace(rows, readings, places, covariance, turns, axes, measured, *told)

    def _spread(self, rows: Rows, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A point on the target as :meth:`columns` has it, and its covariance by the coefficients and by what is open."""
        local, extra = self.wide.local, len(self.open)
        if local is None:
            p, own, more = self.columns(rows, tool)
            return p, carried(own, self.fit.covariance), carried(more, self.open)
        R, p, twists = self.wide.motions(np.append(self.fit.theta, np.zeros(extra)), rows)
        arm, covariance = R @ tool, np.pad(self.fit.covariance, (0, extra))
        twists = shifted(twists, arm)
        # Only constants follow what is open: what acts in few rows has no part in it.
        ways = np.vstack([-self.follows, np.eye(extra)])[local.plain]
        more = twists[:, :, local.carrier[local.plain]] @ ways
        return p + arm, local.carried(twists, rows.phi, covariance), carried(more, self.open)

    def untold(self, rows: Rows, turns: bool) -> tuple[Untold, ...]:
        """Independent combinations of constants that no reading tells, and that move the target or turn it somewhere.

        Args:
            rows: Where, of the fit's own model.
            turns: Whether its rotation counts.
        """
        if not len(self.open):
            return ()
        values, vectors = np.linalg.eigh(self.open)
        size = vectors * np.sqrt(np.maximum(values, 0.0))
        more = self.columns(rows, np.zeros(3))[2][:, : 6 if turns else 3] @ size
        _, _, ways = np.linalg.svd(more.reshape(-1, len(size)), full_matrices=False)
        moves = np.linalg.norm((more @ ways.T).reshape(len(rows), -1, 3, len(ways)), axis=2).max(axis=(0, 1))
        found = []
        for way in ways[moves > FAINTLY * TOLD]:
            theta = np.concatenate([-self.follows @ size @ way, size @ way])
            of = zip(self.wide.coefficients, theta.tolist(), strict=True)
            found.append(tuple((c, value) for c, value in of if value and c.basis.constant))
        return tuple(found)

    def places(self, data: Dataset, readings: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Where the target is in some configurations, in the base frame, shape (M, 3), [m]; see :meth:`over`."""
        places = np.empty((len(readings), 3))
        for part in blocks(len(readings)):
            rows = self._rows(data, readings[part], like[part])
            axes, origin = self._bases(rows)
            at = self.fit.model.poses(self.fit.theta, rows)[1]
            places[part] = np.einsum("nji,nj->ni", axes, at - origin)
        return places

    def _rows(self, data: Dataset, readings: np.ndarray, like: np.ndarray) -> Rows:
        """Other readings as the model sees them."""
        covariates = {name: values[like] for name, values in data.conditions.items()}
        station, target = (None if v is None else v[like] for v in (data.labels.station, data.labels.target))
        return self.fit.model.rows(readings, covariates, station, target)

    def _bases(self, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
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
    way = vectors[:, :, -1]
    largest = np.abs(way).argmax(axis=1, keepdims=True)
    return np.sqrt(np.maximum(values[:, -1], 0.0)), way * np.sign(np.take_along_axis(way, largest, axis=1))


def target_covariance(
    model: Model, theta: np.ndarray, covariance: np.ndarray, rows: Rows, tool: np.ndarray | None = None
) -> np.ndarray:
    r"""Covariance :math:`J \Sigma J^T` of the target's position [m] and rotation vector [rad], world axes, shape (N, 6, 6).

    Args:
        model: K coefficients.
        theta: Their values, shape (K,).
        covariance: Of them, shape (K, K).
        rows: N configurations.
        tool: A point that moves with the target, in its axes, shape (3,), [m], in place of its origin.
    """
    found, local, chains = np.empty((len(rows), 6, 6)), model.local, model.chains(rows)
    for of, chain, own, those in chains:
        found[of] = target_covariance(chain, theta[own], covariance[np.ix_(own, own)], those, tool)
    for some in [] if chains else few(len(rows)):
        R, _, J = (model.jacobian if local is None else model.motions)(theta, rows[some])
        J = J if tool is None else shifted(J, R @ tool)
        found[some] = carried(J, covariance) if local is None else local.carried(J, rows.phi[some], covariance)
    return found


def target_std(model: Model, theta: np.ndarray, covariance: np.ndarray, rows: Rows) -> np.ndarray:
    """Roots of the diagonals of :func:`target_covariance`, shape (N, 6): of a million rows the whole takes six times as much."""
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
    """What the rows told of a calibrated model.

    Args:
        fit: The stage.
        train: The rows that it was fitted to.
        candidates: All constants that were asked for; of those that the fit has not, some combinations may be open.
    """
    model, count = fit.model, len(fit.theta)
    names = set(model.names)
    others = tuple(c for c in candidates if c.name not in names and c.basis.constant)
    wide = model.with_coefficients((*model.coefficients, *others))
    extra = len(others)
    follows, left = np.zeros((count, extra)), np.zeros((extra, extra))
    if extra:
        asked = problem(wide, train)
        some = thin(asked.rows, ENOUGH, asked.groups)
        weight = fit.weight[some] * (len(train) / len(some))
        at = np.append(fit.theta, np.zeros(extra))
        asked = asked if len(some) == len(asked) else asked.select(some)
        H = linearise(asked, at, weight, fit.sigma).equations.information(fit.sigma)
        own = np.flatnonzero([c.basis.constant for c in model.coefficients])
        cross = H[own][:, count:]
        follows[own] = solve(H[np.ix_(own, own)], cross)
        rest = H[count:, count:] - cross.T @ follows[own]
        values, vectors = np.linalg.eigh(0.5 * (rest + rest.T))
        size = wide.sizes[count:]
        left = np.linalg.inv(vectors * np.maximum(values, 0.0) @ vectors.T + np.diag(1.0 / (LOOSE * size) ** 2))
    found = Knowledge(fit, wide, follows, left, _seen(fit, train))
    conventions = [] if has_world(train) else ["world_base"]
    conventions += [] if measures_target(train) else ["tip_target"]
    return _up_to(conventions, found, train) if conventions else found


def _up_to(frames: Sequence[str], known: Knowledge, train: Dataset) -> Knowledge:
    """The same without what is as if a frame were elsewhere.

    Where no instrument knows the world, the base is where the calibration has it by convention; so is the tip where cameras see
    all, whose own mounting takes up what the last link is off by.
    """
    model, count = known.fit.model, len(known.fit.theta)
    some = np.unique(np.linspace(0, len(train) - 1, ASKED).round().astype(int))
    part = train.select(some)
    rows = rows_of_data(model, part)
    rigid = [Coefficient(frame, component) for frame in frames for component in FRAME_COMPONENTS]
    moved = model.with_coefficients((*model.coefficients, *rigid))
    _, _, J = moved.jacobian(np.append(known.fit.theta, np.zeros(len(rigid))), rows)
    _, _, more = known.columns(rows, np.zeros(3))
    moves = J[:, :, count:].reshape(-1, len(rigid))
    size = known.wide.sizes[count:]
    flat = more.reshape(len(moves), -1) * (LOOSE * size)
    _, values, V = np.linalg.svd(flat - moves @ np.linalg.lstsq(moves, flat, rcond=None)[0])
    matters = np.zeros(len(V), dtype=bool)
    matters[: len(values)] = values > FELT * np.sqrt(len(moves))
    kept = size[:, None] * (V[matters].T @ V[matters]) / size
    return replace(known, open=kept @ known.open @ kept.T)


def _seen(fit: Fit, train: Dataset) -> Seen:
    """What the rows in use were like."""
    used = train.select(~fit.outliers)
    model = fit.model
    columns = dict(zip(model.robot.readings, used.readings.T, strict=True))
    columns |= {name: used.conditions[name] for name in model.needs}
    rows = rows_of_data(model, used)
    rows = rows[thin(rows, ENOUGH)]
    std = target_std(model, fit.theta, fit.covariance, rows)
    if not used.sees_turns:  # that of a target whose rotation was never measured says nothing
        std[:, 3:] = np.inf
    ranges = {name: (float(np.nanmin(v)), float(np.nanmax(v))) for name, v in columns.items()}
    gaps = {name: found for name, v in columns.items() if (found := holes(v))}
    return Seen(ranges, gaps, largest(std))


def spread_out(low: np.ndarray, high: np.ndarray, count: int = SAMPLES) -> np.ndarray:
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
    """Lowest and highest readings of the joints' whole range, shape (columns,) each; what was seen where there is no limit.

    Of a joint that turns further than once, the turn around what was seen: beyond it the geometry repeats.

    Args:
        data: Rows.
        limits: Of the columns, shape (columns, 2), infinite where there are none.
    """
    seen = np.stack([data.readings.min(axis=0), data.readings.max(axis=0)], axis=1)
    low, high = np.where(np.isfinite(limits), limits, seen).T
    turning = np.array([kind != "prismatic" for kind in data.kinds])
    half = np.where(turning, np.maximum(np.pi, np.ptp(seen, axis=1) / 2), np.inf)
    middle = seen.mean(axis=1)
    return np.maximum(low, middle - half), np.minimum(high, middle + half)
