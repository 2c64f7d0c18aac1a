r"""Shapes of an instrument's noise: along a direction, lines of sight, axes of the target, or across a lever to the target.

A stereo camera is worst in depth, and worse by the square of the distance. A body of markers is found to turn as well as to
move: its rotation noise throws a target that stands off it, across the lever. Such noise ties a row's numbers together as a
joint's reading does, and a search that knows joints alone would name these.

Directions, points and levers are fitted to the residual of a fit: with u = P y and P_ii of a row
(:mod:`aridcal.engine.fit.variance_components`) and G its axes, the score of a variance along v is :math:`\tfrac12 v^T S v` with
:math:`S = \sum_i G_i^T (u_i u_i^T - P_{ii}) G_i`, largest along an eigenvector. Numbers that are fitted so have a price:
:attr:`Shape.free`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy.linalg import eigh

from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION, Channel
from aridcal.engine.numerics import FLOOR, TINY

INSTRUMENT_DISTANCES = (1.5, 2.0, 2.8, 4.0, 8.0)
"""Work: Distances of an instrument that is looked for, in RMS distances of the targets from their middle: nearer it would stand
among them, and from farther off its lines of sight are as good as parallel."""

ShapeKind = Literal["direction", "depth", "bearing", "own_axis", "lever"]
SHAPES: tuple[ShapeKind, ...] = get_args(ShapeKind)


@dataclass(frozen=True)
class NoiseShape:
    """The shape of a channel's noise.

    Attributes:
        kind: ``direction`` of the world; ``depth``: along lines of sight, growing with the distance; ``bearing``: across
            these; ``own_axis``: along an axis of the target, or across it; ``lever``: of a rotation that is measured, too.
        channel: Name of the channel.
        vector: Unit vector, in the world or, for ``own_axis``, in the target's axes; for a lever the lever in the target's
            axes, [m]; None for lines of sight.
        point: Where lines of sight begin, in the world, [m]; None for kinds without.
        across: True if the noise is in the two directions across.
        power: Power of the distance with which the noise grows.
        typical: RMS distance of the rows, [m]: there the noise has its stated size.
        free: Numbers that were fitted to the residual.
        among: Number of shapes of its kind that it was chosen from.
    """

    kind: ShapeKind
    channel: str
    vector: np.ndarray | None = None
    point: np.ndarray | None = None
    across: bool = False
    power: int = 0
    typical: float = 1.0
    free: int = 0
    among: int = 1

    def price(self, rows: int) -> float:
        """Least gain, [nat]: half the logarithm of the rows for each number fitted (Schwarz 1978), and that of the choice."""
        return 0.5 * self.free * float(np.log(rows)) + float(np.log(self.among))

    @property
    def unit(self) -> str:
        """Unit of the noise."""
        if self.kind == "lever":
            return "rad"
        return "rad" if self.channel == TARGET_ROTATION.name else "m"


@dataclass(frozen=True)
class TargetPoses:
    """Poses of the targets of N rows, and the channels that measure them.

    Attributes:
        R: Attitudes, shape (N, 3, 3).
        p: Places, shape (N, 3), [m].
        axes: Axes of each channel that measures targets in the world, shape (N, m, 3) each, by the channel's name.
        rotations: Name of the rotation channel beside each position channel, by the name of the latter.
    """

    R: np.ndarray
    p: np.ndarray
    axes: dict[str, np.ndarray]
    rotations: dict[str, str]


def directed(shape: NoiseShape, targets: TargetPoses) -> np.ndarray:
    """Error of the channel's three numbers per unit of the noise, shape (N, 3, d)."""
    if shape.kind == "lever":
        assert shape.vector is not None
        return -_cross_matrices(targets.R @ shape.vector)
    if shape.kind == "own_axis":
        along = targets.R @ shape.vector
    elif shape.vector is not None:
        along = np.broadcast_to(shape.vector, targets.p.shape)
    else:
        away = targets.p - shape.point
        along = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), FLOOR)
    root = along[:, :, None]
    if shape.across:
        root = np.eye(3) - root * along[:, None, :]
    if not shape.power:
        return root
    return root * ((distances(shape, targets) / shape.typical) ** shape.power)[:, None, None]


def root(shape: NoiseShape, targets: TargetPoses) -> np.ndarray:
    """Error of all numbers of the rows per unit of the noise, shape (N, m, d)."""
    roots = targets.axes[shape.channel] @ directed(shape, targets)
    return roots + targets.axes[targets.rotations[shape.channel]] if shape.kind == "lever" else roots


def distances(shape: NoiseShape, targets: TargetPoses) -> np.ndarray:
    """Distances of the targets from the shape's point, along its vector if it has one, shape (N,), [m]."""
    assert shape.point is not None
    away = targets.p - shape.point
    return np.abs(away @ shape.vector) if shape.vector is not None else np.linalg.norm(away, axis=1)


def _cross_matrices(v: np.ndarray) -> np.ndarray:
    """Matrices of the cross product with v, shape (N, 3, 3), for v of shape (N, 3)."""
    matrices = np.zeros((len(v), 3, 3))
    matrices[:, [2, 0, 1], [1, 2, 0]] = v
    matrices[:, [1, 2, 0], [2, 0, 1]] = -v
    return matrices


def aimed(
    targets: TargetPoses, channels: Sequence[Channel], residual: np.ndarray, pull: np.ndarray, kernel: np.ndarray
) -> list[list[NoiseShape]]:
    """Shapes of each kind and channel fitted to a residual, the best of each kind first.

    The kinds are those of :func:`shapes_of`, in its order.

    Args:
        targets: Poses of N rows.
        channels: Channels whose noise may have a shape, of ``targets``.
        residual: Of each row, shape (N, m).
        pull: P y of each row, shape (N, m).
        kernel: P_ii of each row, shape (N, m, m).
    """
    shapes = []
    for channel in channels:
        G = targets.axes[channel.name]
        u, P = np.einsum("nmi,nm->ni", G, pull), G.transpose(0, 2, 1) @ kernel @ G
        W = u[:, :, None] * u[:, None, :] - P
        for some in _shapes_of_channel(targets, channel, W, P, residual):
            some = [replace(shape, among=len(some)) for shape in some]
            order = (
                np.argsort([-_merit(shape, targets, W, P) for shape in some], kind="stable") if len(some) > 1 else [0]
            )
            shapes.append([some[k] for k in order])
    return shapes


def nearby(shape: NoiseShape, step: float, targets: TargetPoses) -> Iterator[NoiseShape]:
    """Shapes whose fitted numbers differ by ``step``, a share of their size."""
    for sign in (step, -step):
        for axis in np.eye(3):
            if shape.point is not None and shape.vector is None:
                far = float(np.linalg.norm(shape.point - targets.p.mean(axis=0)))
                yield sized(replace(shape, point=shape.point + sign * far * axis), targets)
            elif shape.vector is not None:
                size = float(np.linalg.norm(shape.vector))
                vector = shape.vector + sign * size * axis
                if shape.kind != "lever":
                    vector = vector / np.linalg.norm(vector)
                moved = replace(shape, vector=vector)
                yield moved if shape.point is None else sized(moved, targets)


def sized(shape: NoiseShape, targets: TargetPoses) -> NoiseShape:
    """The shape with the size of its noise stated at the RMS distance of the rows."""
    return replace(shape, typical=max(float(np.sqrt(np.mean(distances(shape, targets) ** 2))), FLOOR))


def shapes_of(targets: TargetPoses, channel: Channel) -> list[NoiseShape]:
    """One shape of each kind that :func:`aimed` gives for a channel, without fitted numbers."""
    kinds: list[ShapeKind] = ["direction", "own_axis"]
    if channel.axes == TARGET_POSITION.axes:
        kinds += ["depth", "bearing"]
        if channel.name in targets.rotations:
            kinds.append("lever")
    return [NoiseShape(kind, channel.name) for kind in kinds]


def _shapes_of_channel(
    targets: TargetPoses, channel: Channel, W: np.ndarray, P: np.ndarray, residual: np.ndarray
) -> Iterator[list[NoiseShape]]:
    """Shapes of each kind, from W = u u' - P and P of the channel's three numbers in each row, shape (N, 3, 3) each."""
    name, p = channel.name, targets.p
    least, most = _extreme_directions(W.sum(axis=0), P.sum(axis=0))
    yield [NoiseShape("direction", name, most, free=2)]
    turned = targets.R.transpose(0, 2, 1)
    low, high = _extreme_directions((turned @ W @ targets.R).sum(axis=0), (turned @ P @ targets.R).sum(axis=0))
    yield [NoiseShape("own_axis", name, high, free=2), NoiseShape("own_axis", name, low, across=True, free=2)]
    if channel.axes != TARGET_POSITION.axes:
        return
    middle = p.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((p - middle) ** 2, axis=1))))
    origin = np.zeros(3)

    def from_afar(v: np.ndarray) -> list[np.ndarray]:
        return [middle + sign * far * spread * v for far in INSTRUMENT_DISTANCES for sign in (1.0, -1.0)]

    depths = [NoiseShape("depth", name, None, origin, power=k) for k in (0, 1, 2)]
    depths.append(NoiseShape("depth", name, most, origin, power=2, free=2))
    depths += [NoiseShape("depth", name, None, point, power=2, free=3) for point in from_afar(most)]
    bearings = [NoiseShape("bearing", name, None, origin, across=True, power=1)]
    bearings += [NoiseShape("bearing", name, None, point, across=True, power=1, free=3) for point in from_afar(least)]
    for some in (depths, bearings):
        yield [sized(shape, targets) for shape in some]
    if name in targets.rotations:
        yield [NoiseShape("lever", name, _lever(targets, name, residual), free=3)]


def _extreme_directions(S: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along which S is least and most, in units of K, each with its largest number positive."""
    # eigh of both at once; where nothing is measured along some axis K is singular without a ridge.
    ridge = max(1e-9 * float(np.trace(K)), TINY)
    vectors = eigh(S, K + ridge * np.eye(3))[1].T
    vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    largest = np.abs(vectors).argmax(axis=1)
    vectors = vectors * np.sign(vectors[np.arange(3), largest])[:, None]
    return vectors[0], vectors[-1]


def _lever(targets: TargetPoses, name: str, residual: np.ndarray) -> np.ndarray:
    """The lever by which residuals of rotations explain those of positions, in the target's axes, shape (3,), [m].

    A body that is read as turned by w has a target that stands off it by l read as moved by w x R l.
    """
    moved = np.einsum("nmi,nm->ni", targets.axes[name], residual)
    turn = np.einsum("nmi,nm->ni", targets.axes[targets.rotations[name]], residual)
    columns = (_cross_matrices(turn) @ targets.R).reshape(-1, 3)
    return np.asarray(np.linalg.lstsq(columns, moved.ravel())[0])


def _merit(shape: NoiseShape, targets: TargetPoses, W: np.ndarray, P: np.ndarray) -> float:
    """Gain of a shape beside even noise of its channel by a score test, less its price, [nat]."""
    r = directed(shape, targets)
    Pr = P @ r
    inner = r.transpose(0, 2, 1) @ Pr
    score = 0.5 * (float(np.vdot(r, W @ r)))
    information, with_even, even = 0.5 * np.vdot(inner, inner), 0.5 * np.vdot(Pr, Pr), 0.5 * np.vdot(P, P)
    score -= 0.5 * float(np.einsum("nii->", W)) * with_even / max(even, TINY)
    alone = max(information - with_even**2 / max(even, TINY), TINY)
    return np.sign(score) * 0.5 * float(score**2 / alone) - shape.price(len(r))
