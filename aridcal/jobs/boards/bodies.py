"""Bodies to print: a holder of two sockets for a ball, and the cup that carries the ball on a robot's flange.

A seat is a cone of 45 degrees, which a ball touches along a circle: it sits in one place only, wherever its size. Surfaces are
built ring by ring around each bore, so that they are closed without any Boolean operation. Lengths are in [m], z is up.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from aridcal.jobs.boards.sheet import MM
from aridcal.system.errors import CampaignError

# Radii of a seat's mouth and of the bore below it, in radii of the ball; it touches at 0.71.
MOUTH, BORE = 0.85, 0.5

# Depth of the cup's bore, in radii of the ball: from 0.09 on the ball does not touch its floor; the rest is for glue.
GLUE_DEPTH = 0.25

# [m] of material around a mouth or a bolt, and below a seat.
WALL = 0.003

# Height and depth of the holder, and width of its ends with the bolts, [m].
HEIGHT, DEPTH, END = 0.016, 0.040, 0.024

# Thickness of the cup's plate, height of its stem above it, and material of the plate beyond the bolts, [m].
PLATE, STEM, RIM = 0.006, 0.034, 0.0065

# Radius of a bolt's head, in its diameters.
BOLT_HEAD_RADIUS = 0.95

# Pieces of a side of a cell, so many that a seat is round to some 0.01 mm, and of the circle around the cup's axis for each bolt.
PIECES, SECTOR_PIECES = 72, 48

# [m] Corners that are nearer to each other are one.
SAME_CORNER = 1e-8

Triangles = np.ndarray
"""Shape (T, 3, 3), corners anticlockwise seen from outside."""


def seat_rise(ball: float) -> float:
    """How far the centre of a ball in a seat lies above the seat's mouth, [m]; of a ball of that diameter.

    The cone's tip is a mouth's radius below the mouth, and the ball's centre sqrt(2) of its radii above the tip.
    """
    return (np.sqrt(2) - MOUTH) * ball / 2


def holder(ball: float, apart: float, bolt: float) -> trimesh.Trimesh:
    """A plate with two seats on its top, on the x axis around the origin, and a bore for a bolt at each end.

    The bore below a seat takes dust, or a magnet that holds a ball of steel.

    Args:
        ball: Diameter of the ball, [m].
        apart: Distance of the seats, and so of the ball's two places, [m].
        bolt: Diameter of the bores for bolts, [m].

    Raises:
        CampaignError: the seats or bores do not fit.
    """
    radius = ball / 2
    _check_sizes(ball=ball, apart=apart, bolt=bolt)
    if apart < 2 * (MOUTH * radius + WALL) or 2 * (MOUTH * radius + WALL) > DEPTH:
        room = min(apart, DEPTH)
        raise CampaignError(
            f"--ball: seats for {MM * ball:g} mm do not fit {MM * apart:g} mm apart into {MM * DEPTH:g} mm of depth; take a "
            f"ball below {MM * (room - 2 * WALL) / MOUTH:.3g} mm"
        )
    if (MOUTH - BORE) * radius + WALL > HEIGHT:
        raise CampaignError(f"--ball: a seat for {MM * ball:g} mm is deeper than the holder: take a smaller one")
    if bolt + 2 * WALL > END:
        raise CampaignError(f"--bolt: {MM * bolt:g} mm leave no wall in an end of {MM * END:g} mm: take a thinner one")
    low = HEIGHT - (MOUTH - BORE) * radius
    seat = [(MOUTH * radius, HEIGHT), (BORE * radius, low), (BORE * radius, 0.0)]
    through = [(bolt / 2, HEIGHT), (bolt / 2, 0.0)]
    cells = [
        (_rectangle(-apart - END, -apart), through),
        (_rectangle(-apart, 0.0), seat),
        (_rectangle(0.0, apart), seat),
        (_rectangle(apart, apart + END), through),
    ]
    outlines = [outline for outline, _ in cells]
    parts = [_bored(outline, (outline.min(axis=0) + outline.max(axis=0)) / 2, bore, HEIGHT) for outline, bore in cells]
    return _body([*parts, *_walls(outlines, HEIGHT)])


def cup(ball: float, bolts: int, circle: float, bolt: float) -> trimesh.Trimesh:
    """A plate for a flange, with a stem whose top is a seat for a ball: it is glued in. The flange's axis is z.

    Args:
        ball: Diameter of the ball, [m].
        bolts: Number of bolts.
        circle: Diameter of the circle of bolts, [m]; four on 50 mm is ISO 9409-1-50-4.
        bolt: Diameter of the bores for bolts, [m].

    Raises:
        CampaignError: the stem leaves no room for the bolts.
    """
    _check_sizes(ball=ball, circle=circle, bolt=bolt)
    if not 3 <= bolts <= 12:
        raise CampaignError(f"--bolts: {bolts} bolts; three to twelve hold a flange")
    radius, mouth = circle / 2, MOUTH * ball / 2
    stem = mouth + WALL
    if stem + BOLT_HEAD_RADIUS * bolt > radius or stem > 0.95 * radius * np.cos(np.pi / bolts):
        raise CampaignError(
            f"--ball: a stem of {2 * MM * stem:.3g} mm for {MM * ball:g} mm leaves no room for bolts on a circle of "
            f"{MM * circle:g} mm: take a smaller ball or a larger circle"
        )
    if 2 * radius * np.sin(np.pi / bolts) < bolt + WALL:
        raise CampaignError(
            f"--bolts: {bolts} of {MM * bolt:g} mm overlap on a circle of {MM * circle:g} mm: take fewer"
        )
    rim = radius + max(RIM, bolt / 2 + WALL)
    n = bolts * SECTOR_PIECES
    around = 2 * np.pi * np.arange(n) / n
    through = [(bolt / 2, PLATE), (bolt / 2, 0.0)]
    outlines, parts = [], []
    for k in range(bolts):
        outline = _sector(around[(np.arange(SECTOR_PIECES + 1) + k * SECTOR_PIECES) % n], stem, rim)
        middle = radius * _ray(around[k * SECTOR_PIECES + SECTOR_PIECES // 2])
        outlines.append(outline)
        parts.append(_bored(outline, middle, through, PLATE))
    inner = stem * _ray(around)
    top, low = PLATE + STEM, PLATE + STEM - (MOUTH - BORE) * ball / 2
    loops = [
        _at(inner, PLATE),
        _at(inner, top),
        _at(mouth * _ray(around), top),
        _at(BORE * ball / 2 * _ray(around), low),
    ]
    floor = low - GLUE_DEPTH * ball / 2
    loops.append(_at(BORE * ball / 2 * _ray(around), floor))
    tip = np.broadcast_to([0.0, 0.0, floor], loops[-1].shape)
    foot = _at(inner, 0.0)[::-1]
    parts += [_between(a, b) for a, b in zip(loops, [*loops[1:], tip], strict=True)]
    parts.append(_between(foot, np.zeros_like(foot)))
    return _body([*parts, *_walls([*outlines, inner], PLATE)])


def stl(body: trimesh.Trimesh) -> bytes:
    """A body as binary STL, in millimetres, as programs for printers take it."""
    scaled = body.copy()
    scaled.apply_scale(MM)
    return bytes(scaled.export(file_type="stl"))


def _check_sizes(**sizes: float) -> None:
    for name, size in sizes.items():
        if not 0.001 <= size <= 1.0:
            raise CampaignError(f"--{name}: {MM * size:g} mm; between 1 mm and 1 m can be printed")


def _ray(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _at(points: np.ndarray, z: float) -> np.ndarray:
    return np.column_stack([points, np.full(len(points), z)])


def _line(start: ArrayLike, end: ArrayLike) -> np.ndarray:
    """Points from a start to before an end, shape (PIECES, 2)."""
    share = np.arange(PIECES)[:, None] / PIECES
    return np.asarray(start) * (1 - share) + np.asarray(end) * share


def _rectangle(left: float, right: float) -> np.ndarray:
    """Outline of a cell of the holder, anticlockwise, shape (4 PIECES, 2)."""
    y = DEPTH / 2
    corners = [(left, -y), (right, -y), (right, y), (left, y)]
    return np.concatenate([_line(a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)])


def _sector(angles: np.ndarray, inner: float, outer: float) -> np.ndarray:
    """Outline of a piece of a ring, anticlockwise, from its inner end; angles in their order, shape (SECTOR_PIECES + 1,)."""
    first, last = _ray(angles[0]), _ray(angles[-1])
    outwards, inwards = _line(inner * first, outer * first), _line(outer * last, inner * last)
    return np.concatenate([outwards, outer * _ray(angles[:-1]), inwards, inner * _ray(angles[:0:-1])])


def _bored(outline: np.ndarray, middle: np.ndarray, bore: Sequence[tuple[float, float]], height: float) -> Triangles:
    """Top, bore and bottom of a cell: rings from its upper outline around the bore to its lower outline.

    Args:
        outline: Anticlockwise, shape (N, 2); every point of it is in sight of the middle.
        middle: Of the bore, shape (2,).
        bore: Radius and height of its circles, from the top downwards.
        height: Of the top.
    """
    out = outline - middle
    rays = out / np.linalg.norm(out, axis=1, keepdims=True)
    circles = [_at(middle + radius * rays, z) for radius, z in bore]
    loops = [_at(outline, height), *circles, _at(outline, 0.0)]
    return np.concatenate([_between(a, b) for a, b in pairwise(loops)])


def _between(first: np.ndarray, second: np.ndarray) -> Triangles:
    """The surface between two closed lines of as many points, shape (N, 3); it lies to the left of the first."""
    next_first, next_second = np.roll(first, -1, axis=0), np.roll(second, -1, axis=0)
    return np.concatenate([
        np.stack([first, next_first, second], axis=1),
        np.stack([second, next_first, next_second], axis=1),
    ])  # fmt: skip


def _walls(outlines: Sequence[np.ndarray], height: float) -> list[Triangles]:
    """Upright walls along the edges of cells that are not shared by two of them."""
    starts = np.concatenate(outlines)
    ends = np.concatenate([np.roll(outline, -1, axis=0) for outline in outlines])
    keys = [
        tuple(map(tuple, np.round(edge / SAME_CORNER).astype(int).tolist()))
        for edge in np.stack([starts, ends], axis=1)
    ]
    edges = set(keys)
    unshared = np.array([(end, start) not in edges for start, end in keys])
    a, b = starts[unshared], ends[unshared]
    low_a, low_b, high_a, high_b = _at(a, 0.0), _at(b, 0.0), _at(a, height), _at(b, height)
    return [np.stack([low_a, low_b, high_a], axis=1), np.stack([high_a, low_b, high_b], axis=1)]


def _body(parts: Sequence[Triangles]) -> trimesh.Trimesh:
    """One closed surface of triangles: coinciding corners are merged, triangles without area dropped."""
    corners = np.round(np.concatenate(parts).reshape(-1, 3) / SAME_CORNER).astype(np.int64)
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    with_area = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return trimesh.Trimesh(vertices * SAME_CORNER, faces[with_area], process=False)
