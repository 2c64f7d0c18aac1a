"""Hypotheses on noise: causes that may scatter rows, and the covariance that each gives the numbers of a row.

Channels, readings, range and lines of sight follow from the model alone. What has a shape
(:mod:`aridcal.engine.search.noise_shapes`) is aimed anew as long as it is not in the model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from aridcal.engine.fit.problem import Problem, problem, scaled
from aridcal.engine.fit.residual import scaled_columns
from aridcal.engine.fit.shared_readings import Stack
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION, Channel, columns
from aridcal.engine.instruments.setup import Block
from aridcal.engine.numerics import FLOOR
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search import noise_shapes
from aridcal.engine.search.noise_shapes import NoiseShape, TargetPoses

ALL_ALIKE = "all revolute joints"
"""Name of the cause that readings of all of them scatter alike: rounded to the same digit, or of the same encoder."""

HypothesisKind = (
    Literal["channel", "joint", "joints", "range", "sight", "length", "repeatability"] | noise_shapes.ShapeKind
)


@dataclass(frozen=True)
class NoiseHypothesis:
    """A possible cause of scatter.

    Attributes:
        kind: As of a :class:`NoiseCause` (:mod:`aridcal.engine.search.noise_causes`).
        name: As of a :class:`NoiseCause`.
        unit: As of a :class:`NoiseCause`.
        root: Scaled residual of each row per unit of the cause's d independent errors, shape (N, m, d).
        shape: Direction, point or lever of the cause; None where the model alone determines ``root``.
    """

    kind: HypothesisKind
    name: str
    unit: str
    root: np.ndarray
    shape: NoiseShape | None = None

    @property
    def common(self) -> bool:
        """True if all rows of a standstill share it."""
        return self.kind in ("joint", "joints")

    @property
    def blocks(self) -> np.ndarray:
        """Covariance of each row per unit of its variance, shape (N, m, m)."""
        return np.asarray(self.root @ self.root.transpose(0, 2, 1))

    @property
    def parts(self) -> tuple[NoiseHypothesis, ...]:
        """Causes of which each may repeat at neighbouring rows: the joints of ``joints`` one by one, else the cause itself."""
        if self.kind != "joints":
            return (self,)
        return tuple(replace(self, root=self.root[:, :, k : k + 1]) for k in range(self.root.shape[2]))

    def stacked(self, still: Stack) -> np.ndarray:
        """Covariance of each standstill per unit of its variance, shape (S, M, M)."""
        if not self.common:
            return still.matrices(self.blocks)
        root = still.vectors(self.root)
        return np.asarray(root @ root.transpose(0, 2, 1))


def measured_mask(rows: Dataset) -> np.ndarray:
    """Which numbers each row measures, shape (N, m) bool."""
    return np.repeat(rows.measures, [channel.size for channel in rows.channels], axis=1)


def possible(question: Problem, theta: np.ndarray) -> tuple[list[NoiseHypothesis], TargetPoses]:
    """Every cause that the model alone determines, without the residuals; and the poses of the targets."""
    rows, model = question.data, question.model
    at = np.concatenate([theta, np.zeros(len(model.own_motions))])
    more = problem(model.with_motions(model.own_motions), rows).settled(at)
    J = scaled_columns(more, at, len(model.own_motions))
    units = measured_mask(rows)[:, :, None] * np.eye(J.shape[1])
    parts = list(zip(rows.channels, columns(rows.channels), strict=True))
    causes = [NoiseHypothesis("channel", channel.name, channel.unit, units[:, :, part]) for channel, part in parts]
    moved = J @ model.robot.factors
    for k, (reading, kind) in enumerate(zip(model.robot.readings, model.robot.kinds, strict=True)):
        causes.append(NoiseHypothesis("joint", reading, "m" if kind == "prismatic" else "rad", moved[:, :, k, None]))
    turning = np.array([kind != "prismatic" for kind in model.robot.kinds])
    if turning.sum() > 1:
        causes.append(NoiseHypothesis("joints", ALL_ALIKE, "rad", moved[:, :, turning]))
    R, p = more.model.poses(at, more.rows)
    for what, name, unit, root in _roots_of_instruments(rows, p, units):
        causes.append(NoiseHypothesis(what, name, unit, scaled(root, rows.relative)))
    return causes, _targets(rows, R, p, units)


def _targets(rows: Dataset, R: np.ndarray, p: np.ndarray, units: np.ndarray) -> TargetPoses:
    """Places and attitudes of the targets, and the axes of all channels that measure these in the world."""
    axes, turned = {}, {}
    for block, channel, part in _channels(rows):
        if block.traits.tracked and channel.axes in (TARGET_POSITION.axes, TARGET_ROTATION.axes):
            axes[channel.name] = scaled(units[:, :, part], rows.relative)
    for block in rows.blocks:
        name = {channel.axes: channel.name for channel in block.channels}
        if block.traits.tracked and {TARGET_POSITION.axes, TARGET_ROTATION.axes} <= name.keys():
            turned[name[TARGET_POSITION.axes]] = name[TARGET_ROTATION.axes]
    return TargetPoses(R, p, axes, turned)


def _channels(rows: Dataset) -> Iterator[tuple[Block, Channel, slice]]:
    """Channels, the blocks that they are of, and where their numbers are."""
    blocks = [block for block in rows.blocks for _ in block.channels]
    yield from zip(blocks, rows.channels, columns(rows.channels), strict=True)


def shaped(shape: NoiseShape, targets: TargetPoses) -> NoiseHypothesis:
    """Noise of a shape as a possible cause."""
    return NoiseHypothesis(shape.kind, shape.channel, shape.unit, noise_shapes.root(shape, targets), shape)


def _roots_of_instruments(
    rows: Dataset, p: np.ndarray, units: np.ndarray
) -> Iterator[tuple[HypothesisKind, str, str, np.ndarray]]:
    """Causes of instruments: kind, channel, unit, and root of the covariance, shape (N, m, d).

    The model has the targets at p, shape (N, 3), [m]; ``units`` are unit vectors of the numbers of each row, (N, m, m).
    """
    away = np.linalg.norm(p, axis=1)
    for block, channel, part in _channels(rows):
        tracked = block.traits.tracked
        # Poses and positions are measured from the origin of the world frame, if from anywhere; other kinds are not.
        if tracked and channel.axes == TARGET_POSITION.axes:
            yield "range", channel.name, "m/m", away[:, None, None] * units[:, :, part]
        if tracked and channel.axes == TARGET_ROTATION.axes:
            sight = p / np.maximum(away, FLOOR)[:, None]
            yield "sight", channel.name, "rad", units[:, :, part] @ sight[:, :, None]
        if block.traits.ranges:
            yield "length", channel.name, "m/m", np.abs(np.nan_to_num(rows.observed[:, :1, None])) * units[:, :, part]
        if rows.relative is not None and not np.allclose(scaled(units[:, :, part], rows.relative), units[:, :, part]):
            yield "repeatability", channel.name, channel.unit, units[:, :, part]


def stretched(relative: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns of shape (N, m, d) times the rows' relative sigmas or factors (see :class:`Dataset`)."""
    return np.asarray(relative @ values if relative.ndim == 3 else relative[:, :, None] * values)
