r"""What an instrument's noise may lie along: a direction, lines of sight, axes of the target, a lever on which the target stands.

A stereo camera is worst in depth, and worse by the square of the distance. A body of markers is found to turn as well as to
move: its rotation noise throws a target that stands off it, across the lever. Such noise ties a row's numbers together as a
joint's reading does, and a search that knows joints alone accuses these.

Directions, points and levers are taken from what a fit leaves: with u = P y and P_ii of a row
(:mod:`aridcal.engine.fit.variance_components`) and G its axes, the score of a variance along v is :math:`\tfrac12 v^T S v` with
:math:`S = \sum_i G_i^T (u_i u_i^T - P_{ii}) G_i`, largest along an eigenvector. Numbers that are taken so are paid for:
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

AWAY = (1.5, 2.0, 2.8, 4.0, 8.0)
"""Work: Distances of an instrument that is looked for, in RMS distances of the targets from their middle: nearer it would stand
among them, and from farther off its lines of sight are as good as parallel."""

Kind = Literal["direction", "depth", "bearing", "own_axis", "lever"]
SHAPES: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class Shape:
    """What noise lies along.

    Attributes:
        kind: ``direction`` of the world; ``depth``: along lines of sight, growing with the distance; ``bearing``: across
            these; ``own_axis``: along an axis of the target, or across it; ``lever``: of a rotation that is measured, too.
        channel: Whose noise.
        vector: Unit vector, of the world or, of ``own_axis``, of the target; of a lever the lever, in the target's axes,
            [m]; None of lines of sight.
        point: Where lines of sight begin, in the world, [m]; None where there are none.
        across: True if the noise is in the two directions across.
        power: Of the distance that it grows with.
        typical: RMS distance of the rows, [m], at which its size is what is said.
        free: Numbers of it that were taken from the residual.
        among: Shapes of its kind that it was chosen among.
    """

    kind: Kind
    channel: str
    vector: np.ndarray | None = None
    point: np.ndarray | None = None
    across: bool = False
    power: int = 0
    typical: float = 1.0
    free: int = 0
    among: int = 1

    def price(self, rows: int) -> float:
        """What it must gain, [nat]: half the logarithm of the rows for each of its numbers (Schwarz 1978), and the choice."""
        return 0.5 * self.free * float(np.log(rows)) + float(np.log(self.among))

    @property
    def unit(self) -> str:
        """Of its size."""
        if self.kind == "lever":
            return "rad"
        return "rad" if self.channel == TARGET_ROTATION.name else "m"


@dataclass(frozen=True)
class Seen:
    """Where the targets of N rows are.

    Attributes:
        R: Attitudes, shape (N, 3, 3).
        p: Places, shape (N, 3), [m].
        own: Axes of the rows' numbers of each channel that has three, shape (N, m, 3) each, by name.
        turned: Name of the rotations that were measured with the positions, by the name of these.
    """

    R: np.ndarray
    p: np.ndarray
    own: dict[str, np.ndarray]
    turned: dict[str, str]


def directed(shape: Shape, seen: Seen) -> np.ndarray:
    """What the noise does to the three numbers of its channel, per unit of its size, shape (N, 3, d)."""
    if shape.kind == "lever":
        assert shape.vector is not None
        return -_crossed(seen.R @ shape.vector)
    if shape.kind == "own_axis":
        along = seen.R @ shape.vector
    elif shape.vector is not None:
        along = np.broadcast_to(shape.vector, seen.p.shape)
    else:
        away = seen.p - shape.point
        along = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), FLOOR)
    root = along[:, :, None]
    if shape.across:
        root = np.eye(3) - root * along[:, None, :]
    if not shape.power:
        return root
    return root * ((distances(shape, seen) / shape.typical) ** shape.power)[:, None, None]


def root(shape: Shape, seen: Seen) -> np.ndarray:
    """The same of all numbers of the rows, shape (N, m, d)."""
    made = seen.own[shape.channel] @ directed(shape, seen)
    return made + seen.own[seen.turned[shape.channel]] if shape.kind == "lever" else made


def distances(shape: Shape, seen: Seen) -> np.ndarray:
    """From the point: along the direction, if it has one, shape (N,), [m]."""
    assert shape.point is not None
    away = seen.p - shape.point
    return np.abs(away @ shape.vector) if shape.vector is not None else np.linalg.norm(away, axis=1)


def _crossed(v: np.ndarray) -> np.ndarray:
    """Matrices of v x, shape (N, 3, 3), of shape (N, 3)."""
    made = np.zeros((len(v), 3, 3))
    made[:, [2, 0, 1], [1, 2, 0]] = v
    made[:, [1, 2, 0], [2, 0, 1]] = -v
    return made


def aimed(
    seen: Seen, channels: Sequence[Channel], left: np.ndarray, pull: np.ndarray, kernel: np.ndarray
) -> list[list[Shape]]:
    """Of each kind and channel the shapes that a fit's residual may ask for, that which it asks for most first.

    Always as many kinds, in the order of :func:`shapes_of`.

    Args:
        seen: N rows.
        channels: Those whose noise is asked about, of ``seen``.
        left: What the fit leaves in each row, shape (N, m).
        pull: P y of each row, shape (N, m).
        kernel: P_ii of each row, shape (N, m, m).
    """
    found = []
    for channel in channels:
        G = seen.own[channel.name]
        u, P = np.einsum("nmi,nm->ni", G, pull), G.transpose(0, 2, 1) @ kernel @ G
        W = u[:, :, None] * u[:, None, :] - P
        for some in _of_channel(seen, channel, W, P, left):
            some = [replace(shape, among=len(some)) for shape in some]
            order = np.argsort([-_merit(shape, seen, W, P) for shape in some], kind="stable") if len(some) > 1 else [0]
            found.append([some[k] for k in order])
    return found


def nearby(shape: Shape, step: float, seen: Seen) -> Iterator[Shape]:
    """Shapes whose numbers, taken from the residual, are other by a share of their size."""
    for sign in (step, -step):
        for axis in np.eye(3):
            if shape.point is not None and shape.vector is None:
                far = float(np.linalg.norm(shape.point - seen.p.mean(axis=0)))
                yield sized(replace(shape, point=shape.point + sign * far * axis), seen)
            elif shape.vector is not None:
                size = float(np.linalg.norm(shape.vector))
                vector = shape.vector + sign * size * axis
                if shape.kind != "lever":
                    vector = vector / np.linalg.norm(vector)
                moved = replace(shape, vector=vector)
                yield moved if shape.point is None else sized(moved, seen)


def sized(shape: Shape, seen: Seen) -> Shape:
    """The same, its size said at the RMS distance of the rows."""
    return replace(shape, typical=max(float(np.sqrt(np.mean(distances(shape, seen) ** 2))), FLOOR))


def shapes_of(seen: Seen, channel: Channel) -> list[Shape]:
    """One of each kind that :func:`aimed` gives for a channel, not aimed yet."""
    kinds: list[Kind] = ["direction", "own_axis"]
    if channel.axes == TARGET_POSITION.axes:
        kinds += ["depth", "bearing"]
        if channel.name in seen.turned:
            kinds.append("lever")
    return [Shape(kind, channel.name) for kind in kinds]


def _of_channel(seen: Seen, channel: Channel, W: np.ndarray, P: np.ndarray, left: np.ndarray) -> Iterator[list[Shape]]:
    """Shapes of each kind, from W = u u' - P and P of the channel's three numbers in each row, shape (N, 3, 3) each."""
    name, p = channel.name, seen.p
    least, most = _extremes(W.sum(axis=0), P.sum(axis=0))
    yield [Shape("direction", name, most, free=2)]
    turned = seen.R.transpose(0, 2, 1)
    low, high = _extremes((turned @ W @ seen.R).sum(axis=0), (turned @ P @ seen.R).sum(axis=0))
    yield [Shape("own_axis", name, high, free=2), Shape("own_axis", name, low, across=True, free=2)]
    if channel.axes != TARGET_POSITION.axes:
        return
    middle = p.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((p - middle) ** 2, axis=1))))
    origin = np.zeros(3)

    def from_afar(v: np.ndarray) -> list[np.ndarray]:
        return [middle + sign * far * spread * v for far in AWAY for sign in (1.0, -1.0)]

    depths = [Shape("depth", name, None, origin, power=k) for k in (0, 1, 2)]
    depths.append(Shape("depth", name, most, origin, power=2, free=2))
    depths += [Shape("depth", name, None, point, power=2, free=3) for point in from_afar(most)]
    bearings = [Shape("bearing", name, None, origin, across=True, power=1)]
    bearings += [Shape("bearing", name, None, point, across=True, power=1, free=3) for point in from_afar(least)]
    for some in (depths, bearings):
        yield [sized(shape, seen) for shape in some]
    if name in seen.turned:
        yield [Shape("lever", name, _lever(seen, name, left), free=3)]


def _extremes(S: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along which S is least and most, in units of K, each with its largest number positive."""
    # eigh of both at once; where nothing is measured along some axis K is singular, and a ridge makes it none.
    ridge = max(1e-9 * float(np.trace(K)), TINY)
    vectors = eigh(S, K + ridge * np.eye(3))[1].T
    vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    largest = np.abs(vectors).argmax(axis=1)
    vectors = vectors * np.sign(vectors[np.arange(3), largest])[:, None]
    return vectors[0], vectors[-1]


def _lever(seen: Seen, name: str, left: np.ndarray) -> np.ndarray:
    """The lever that what is left of rotations explains what is left of positions by, in the target's axes, shape (3,), [m].

    A body that is read as turned by w has a target that stands off it by l read as moved by w x R l.
    """
    moved = np.einsum("nmi,nm->ni", seen.own[name], left)
    turn = np.einsum("nmi,nm->ni", seen.own[seen.turned[name]], left)
    columns = (_crossed(turn) @ seen.R).reshape(-1, 3)
    return np.asarray(np.linalg.lstsq(columns, moved.ravel())[0])


def _merit(shape: Shape, seen: Seen, W: np.ndarray, P: np.ndarray) -> float:
    """What a score test expects a shape to gain beside even noise of its channel, less what its numbers cost, [nat]."""
    r = directed(shape, seen)
    Pr = P @ r
    inner = r.transpose(0, 2, 1) @ Pr
    score = 0.5 * (float(np.vdot(r, W @ r)))
    own, with_even, even = 0.5 * np.vdot(inner, inner), 0.5 * np.vdot(Pr, Pr), 0.5 * np.vdot(P, P)
    score -= 0.5 * float(np.einsum("nii->", W)) * with_even / max(even, TINY)
    alone = max(own - with_even**2 / max(even, TINY), TINY)
    return np.sign(score) * 0.5 * float(score**2 / alone) - shape.price(len(r))
