"""Photographs of calibration squares with known truth, in three steps.

What is in view (``Optics``), the light that falls on the pixels (``light_map``), and what a camera and its sonars make of it
(``render``, ``photograph``, ``read_sonars``).

Edges are exact: the area that a polygon covers of each (sub)pixel is computed, not sampled. Blur is applied on a grid
``SUBPIXELS`` times finer than the image before each pixel collects its light. Nothing here is shared with the detector's model
of an edge (:mod:`aridcal.jobs.head1992.outlines`), so that the one can test the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from aridcal.engine.instruments.camera import predict_ranges, project
from aridcal.engine.instruments.camera_sonar import Head
from aridcal.jobs.head1992.square import SQUARE_SIDE, fiducial_corners, index_corners, paper_corners

# Of the JPEG files: its errors stay below the camera's noise.
JPEG_QUALITY = 90

# [m] Squares whose centres are this near the one looked at may be in view.
NEIGHBOUR_DISTANCE = 4 * SQUARE_SIDE

# [m] from the lens to a square that can be in focus.
LEAST_DISTANCE = 0.05

# [px] to the image's border: a fiducial nearer to it may be cut off by the blur.
VIEW_MARGIN = 3.0

# [m] by which a square must be nearer the optical axis than the others: the detector is to have no doubt.
OWN_SQUARE_LEAD = SQUARE_SIDE / 10

# Of a shot: largest change of the light, a share; blur from and to, [px]; noise, [grey levels].
LIGHT, BLUR, NOISE = 0.15, (0.5, 0.9), 1.5

# [grey levels] of the camera's full scale.
WHITE = 255

SUBPIXELS = 4
# A straight edge is drawn as so many pieces, each bent by the lens.
EDGE_PIECES = 8


class Patch(NamedTuple):
    """Something in front of the scene, dirt or an obstacle: a polygon of image points (K, 2), [px], of one reflectance."""

    outline: np.ndarray
    reflectance: float


class Glare(NamedTuple):
    """A round highlight: centre [px], radius [px] and strength as a share of full scale."""

    u: float
    v: float
    radius: float
    strength: float


@dataclass(frozen=True)
class ImageAppearance:
    """All of an image but its geometry.

    Attributes:
        paper: Reflectance of the paper, 0 to 1 of the camera's full scale.
        ink: Reflectance of the fiducials; brighter than the paper for white on black.
        surroundings: Reflectance of what lies around the paper.
        light: Relative change of the light from the image's middle to its right and lower edges.
        blur: Standard deviation of the lens's blur, [px].
        noise: Standard deviation of the camera's noise, [grey levels].
        patches: Dirt and obstacles, the later ones in front.
        glares: Highlights.
        wrong_pixels: Share of isolated pixels that show anything.
    """

    paper: float = 0.8
    ink: float = 0.12
    surroundings: float = 0.55
    light: tuple[float, float] = (0.0, 0.0)
    blur: float = 0.6
    noise: float = 2.0
    patches: Sequence[Patch] = ()
    glares: Sequence[Glare] = ()
    wrong_pixels: float = 0.0


def coverage(polygons: np.ndarray, width: int, height: int) -> np.ndarray:
    """Compute the share of each pixel's area that lies inside polygons that do not overlap.

    Args:
        polygons: Corners in one sense of rotation, shape (M, K, 2), [px]; pixel (0, 0) reaches from -0.5 to 0.5.
        width: Of the image, [px].
        height: Of the image, [px].

    Returns:
        Shape (height, width), 0 to 1.

    Each edge is cut at the pixel borders. A piece in one pixel adds the area between itself and that pixel's right border;
    every pixel further right gets the whole height of the piece: one cumulative sum along the rows does it.
    """
    p, q = _cut_at_pixels(polygons)
    middle = (p + q) / 2
    column = np.floor(middle[:, 0]).astype(int)
    row = np.floor(middle[:, 1]).astype(int)
    keep = (row >= 0) & (row < height) & (column < width)
    rise = (q - p)[keep, 1]
    row, column, x = row[keep], column[keep], middle[keep, 0]
    right = np.where(column < 0, 1.0, 1.0 - (x - column))  # share of this pixel right of the piece
    cell = row * (width + 1) + np.maximum(column, 0)
    cells = (width + 1) * height
    this_pixel = np.bincount(cell, rise * right, cells)
    next_pixel = np.bincount(cell + 1, rise * (1 - right), cells + 1)[:cells]
    sums = (this_pixel + next_pixel).reshape(height, width + 1)
    return np.abs(np.cumsum(sums, axis=1)[:, :width])


def _cut_at_pixels(polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut the edges of polygons, (M, K, 2), at pixel borders: ends of the pieces, each (P, 2); pixel 0 reaches from 0 to 1.

    A point of an edge is start + t (end - start); t = 0, 1 and its crossings with whole x and whole y, sorted, are the cuts.
    """
    start = polygons.reshape(-1, 2) + 0.5
    end = np.roll(polygons, -1, axis=1).reshape(-1, 2) + 0.5
    edges = np.arange(len(start))
    crossed = [_crossings(start[:, axis], end[:, axis]) for axis in (0, 1)]
    owners = np.concatenate([np.repeat(edges, 2), *(owner for owner, _ in crossed)])
    cuts = np.concatenate([np.tile([0.0, 1.0], len(start)), *(t for _, t in crossed)])
    order = np.lexsort((cuts, owners))
    owners, cuts = owners[order], cuts[order]
    points = start[owners] + cuts[:, None] * (end - start)[owners]
    same_edge = owners[1:] == owners[:-1]
    return points[:-1][same_edge], points[1:][same_edge]


def _crossings(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find where edges from a to b (E,) pass whole numbers: the edge of each crossing, and its t, each (C,)."""
    first = np.floor(np.minimum(a, b)) + 1
    last = np.ceil(np.maximum(a, b))
    counts = np.maximum(last - first, 0).astype(int)
    owner = np.repeat(np.arange(len(a)), counts)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    t = (first[owner] + nth - a[owner]) / (b[owner] - a[owner])
    return owner, t


def image_outlines(T_camera_square: np.ndarray, corners: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Project polygons of the square's plane, shape (M, 4, 2), [m], through the lens: (M, 4 * EDGE_PIECES, 2), [px]."""
    steps = np.arange(EDGE_PIECES)[:, None] / EDGE_PIECES
    sides = np.roll(corners, -1, axis=1) - corners
    points = corners[:, :, None] + steps * sides[:, :, None]
    return _project_flat(points.reshape(len(corners), -1, 2), T_camera_square, intrinsics)


def _project_flat(points: np.ndarray, T_camera_square: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Project points x, y of the square's plane, shape (..., 2), [m], to pixels, shape (..., 2)."""
    xy_axes, origin = T_camera_square[:3, :2], T_camera_square[:3, 3]
    return project(points @ xy_axes.T + origin, intrinsics)


def light_map(
    T_camera_squares: Mapping[int, np.ndarray], intrinsics: np.ndarray, width: int, height: int, scene: ImageAppearance
) -> np.ndarray:
    """Render without noise and without rounding, shape (height, width), [grey levels].

    Args:
        T_camera_squares: Pose of each square in view in OpenCV's camera frame, by index, (4, 4).
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        width: [px].
        height: [px].
        scene: All but the geometry.
    """
    fine = np.full((SUBPIXELS * height, SUBPIXELS * width), scene.surroundings, np.float32)
    papers, prints = [], []
    for index, T in T_camera_squares.items():
        papers.append(image_outlines(T, paper_corners()[None], intrinsics))
        prints.append(image_outlines(T, _print_outlines(index), intrinsics))
    if T_camera_squares:
        _paint(fine, np.concatenate(papers), scene.paper)
        _paint(fine, np.concatenate(prints), scene.ink)
    for patch in scene.patches:
        _paint(fine, patch.outline[None], patch.reflectance)
    if scene.blur > 0:
        fine = cv2.GaussianBlur(fine, (0, 0), SUBPIXELS * scene.blur, borderType=cv2.BORDER_REPLICATE)
    image = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(float)
    return WHITE * _lit(image, scene)


def _lit(image: np.ndarray, scene: ImageAppearance) -> np.ndarray:
    """Let uneven light and highlights fall on reflectances, shape (height, width)."""
    height, width = image.shape
    right, down = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    image = image * (1 + scene.light[0] * right + scene.light[1] * down)
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    for glare in scene.glares:
        distance2 = (u - glare.u) ** 2 + (v - glare.v) ** 2
        image += glare.strength * np.exp(-distance2 / (2 * glare.radius**2))
    return image


def render(
    T_camera_squares: Mapping[int, np.ndarray],
    intrinsics: np.ndarray,
    width: int,
    height: int,
    scene: ImageAppearance,
    rng: np.random.Generator,
) -> np.ndarray:
    """Take a photograph: ``light_map`` with noise, wrong pixels, rounding and saturation, uint8 (height, width)."""
    image = light_map(T_camera_squares, intrinsics, width, height, scene)
    image += scene.noise * rng.standard_normal(image.shape)
    if scene.wrong_pixels > 0:
        spoilt = rng.random(image.shape) < scene.wrong_pixels
        image[spoilt] = rng.uniform(0, WHITE, np.count_nonzero(spoilt))
    return np.clip(np.rint(image), 0, WHITE).astype(np.uint8)


def _paint(fine: np.ndarray, polygons: np.ndarray, reflectance: float) -> None:
    """Cover a part of the fine image with polygons given in pixels of the coarse one."""
    polygons = SUBPIXELS * (polygons + 0.5) - 0.5
    size = fine.shape[::-1]
    first = np.floor(polygons.min(axis=(0, 1))).astype(int) - 1
    last = np.ceil(polygons.max(axis=(0, 1))).astype(int) + 2
    low, high = np.clip(first, 0, size), np.clip(last, 0, size)
    if np.all(high > low):
        part = fine[low[1] : high[1], low[0] : high[0]]
        width, height = high - low
        part += coverage(polygons - low, width, height) * (reflectance - part)


def _print_outlines(index: int) -> np.ndarray:
    """Outlines of all that is printed on a square, shape (M, 4, 2), [m]."""
    return np.concatenate([fiducial_corners(), index_corners(index)])


@dataclass(frozen=True)
class Optics:
    """A camera's size and where its squares are.

    Attributes:
        width: [px].
        height: [px].
        squares: T_world_square of each square by its index, (4, 4).
    """

    width: int
    height: int
    squares: Mapping[int, np.ndarray]

    def seen(self, T_world_camera: np.ndarray, square: int) -> dict[int, np.ndarray]:
        """T_camera_square of a square and of its neighbours, (4, 4)."""
        middle = self.squares[square][:3, 3]
        near = {k: T for k, T in self.squares.items() if np.linalg.norm(T[:3, 3] - middle) < NEIGHBOUR_DISTANCE}
        return _facing(T_world_camera, near)

    def nearest(self, T_world_camera: np.ndarray) -> int:
        """Index of the square nearest the optical axis, of those before the camera."""
        off_axis = _off_axis(_facing(T_world_camera, self.squares))
        return min(off_axis, key=lambda k: off_axis[k])

    def in_view(self, T_world_camera: np.ndarray, square: int, intrinsics: np.ndarray) -> int:
        """Count the square's own fiducials that are wholly in view, if no other square is nearer the optical axis."""
        in_front = self.seen(T_world_camera, square)
        if square not in in_front:
            return 0
        off_axis = _off_axis(in_front)
        limit = off_axis.pop(square) + OWN_SQUARE_LEAD
        if any(other < limit for other in off_axis.values()):
            return 0
        pixels = _project_flat(fiducial_corners(), in_front[square], intrinsics)
        last = np.array([self.width - 1, self.height - 1])
        inside = (pixels > VIEW_MARGIN) & (pixels < last - VIEW_MARGIN)
        return int(inside.all(axis=(1, 2)).sum())


def _facing(T_world_camera: np.ndarray, squares: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
    """Return T_camera_square, (4, 4), of those of the squares that lie before the camera and face it."""
    T_camera_world = np.linalg.inv(T_world_camera)
    poses = {k: T_camera_world @ T for k, T in squares.items()}
    return {k: T for k, T in poses.items() if T[2, 3] > LEAST_DISTANCE and T[2, 2] < 0}


def _off_axis(T_camera_squares: Mapping[int, np.ndarray]) -> dict[int, float]:
    """Return how far from each square's centre the optical axis meets it, [m]."""
    return {k: float(np.hypot(*_pierced(T))) for k, T in T_camera_squares.items()}


def _pierced(T_camera_square: np.ndarray) -> np.ndarray:
    """Where the optical axis meets a square, in its frame, (2,), [m]: the lens o moved along the axis n by -o_z / n_z."""
    T = np.linalg.inv(T_camera_square)
    lens, axis = T[:3, 3], T[:3, 2]
    return np.asarray(lens[:2] - axis[:2] * lens[2] / axis[2])


def photograph(
    T_world_camera: np.ndarray, square: int, optics: Optics, head: Head, rng: np.random.Generator, noise: float = NOISE
) -> tuple[bytes, np.ndarray]:
    """Take one shot.

    Args:
        T_world_camera: Shape (4, 4).
        square: Index of the square nearest the optical axis.
        optics: The camera's size and the squares.
        head: As it really is.
        rng: Of light, blur and noise.
        noise: Standard deviation, [grey levels].

    Returns:
        The image as JPEG, and the ranges, shape (S,), [m].
    """
    seen = optics.seen(T_world_camera, square)
    right, down = rng.uniform(-LIGHT, LIGHT, 2)
    blur = float(rng.uniform(*BLUR))
    scene = ImageAppearance(light=(float(right), float(down)), blur=blur, noise=noise)
    image = render(seen, head.intrinsics, optics.width, optics.height, scene, rng)
    _, content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return content.tobytes(), read_sonars(seen[square], head, rng)


def read_sonars(T_camera_square: np.ndarray, head: Head, rng: np.random.Generator) -> np.ndarray:
    """Read the ranges to a square's plane, shape (S,), [m]: (1 + scale) h + bias + noise."""
    h, _ = predict_ranges(T_camera_square, head.positions, head.measures)
    noise = head.std * rng.standard_normal(len(h))
    return np.asarray((1.0 + head.scale) * h + head.bias + noise)
