"""What the camera sees: images of calibration squares with known truth.

Edges are exact: the area that a polygon covers of each (sub)pixel is computed, not sampled. Blur is applied on a grid
``SUBPIXELS`` times finer than the image before each pixel collects its light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from aridcal.head.camera import project
from aridcal.head.square import fiducial_corners, index_corners, paper_corners

SUBPIXELS = 4
EDGE_PIECES = 8  # a straight edge is drawn as so many pieces, each bent by the lens


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
class Scene:
    """Everything but the geometry that makes an image.

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
    start = polygons.reshape(-1, 2) + 0.5
    end = np.roll(polygons, -1, axis=1).reshape(-1, 2) + 0.5
    edge, t = [np.repeat(np.arange(len(start)), 2)], [np.tile([0.0, 1.0], len(start))]
    for axis in (0, 1):
        a, b = start[:, axis], end[:, axis]
        low = np.floor(np.minimum(a, b)) + 1
        crossings = np.maximum(np.ceil(np.maximum(a, b)) - low, 0).astype(int)
        owner = np.repeat(np.arange(len(start)), crossings)
        nth = np.arange(len(owner)) - np.repeat(np.cumsum(crossings) - crossings, crossings)
        edge.append(owner)
        t.append((low[owner] + nth - a[owner]) / (b[owner] - a[owner]))
    owners, cuts = np.concatenate(edge), np.concatenate(t)
    order = np.lexsort((cuts, owners))
    owners, cuts = owners[order], cuts[order]
    points = start[owners] + cuts[:, None] * (end - start)[owners]
    same = owners[1:] == owners[:-1]
    p, q = points[:-1][same], points[1:][same]
    middle = (p + q) / 2
    column, row = np.floor(middle[:, 0]).astype(int), np.floor(middle[:, 1]).astype(int)
    keep = (row >= 0) & (row < height) & (column < width)
    rise, row, column, x = (q - p)[keep, 1], row[keep], column[keep], middle[keep, 0]
    right = np.where(column < 0, 1.0, 1.0 - (x - column))  # share of this pixel right of the piece
    cell = row * (width + 1) + np.maximum(column, 0)
    cells = (width + 1) * height
    sums = np.bincount(cell, rise * right, cells) + np.bincount(cell + 1, rise * (1 - right), cells + 1)[:cells]
    return np.abs(np.cumsum(sums.reshape(height, width + 1), axis=1)[:, :width])


def image_outlines(T_camera_square: np.ndarray, corners: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Project polygons of the square's plane, shape (M, 4, 2), [m], through the lens: (M, 4 * EDGE_PIECES, 2), [px]."""
    steps = np.arange(EDGE_PIECES)[:, None] / EDGE_PIECES
    points = corners[:, :, None] + steps * (np.roll(corners, -1, axis=1) - corners)[:, :, None]
    points = points.reshape(len(corners), -1, 2)
    return project(points @ T_camera_square[:3, :2].T + T_camera_square[:3, 3], intrinsics)


def light_map(
    T_camera_squares: Mapping[int, np.ndarray], intrinsics: np.ndarray, width: int, height: int, scene: Scene
) -> np.ndarray:
    """Render without noise and without rounding, shape (height, width), [grey levels].

    Args:
        T_camera_squares: Pose of each square in view in OpenCV's camera frame, by index, (4, 4).
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        width: [px].
        height: [px].
        scene: Everything else.
    """
    fine_size = (SUBPIXELS * width, SUBPIXELS * height)

    fine = np.full(fine_size[::-1], scene.surroundings, np.float32)
    seen = T_camera_squares.items()
    for make, value in ((lambda _: paper_corners()[None], scene.paper), (_printed, scene.ink)):
        if seen:
            _paint(fine, np.concatenate([image_outlines(T, make(index), intrinsics) for index, T in seen]), value)
    for patch in scene.patches:
        _paint(fine, patch.outline[None], patch.reflectance)
    if scene.blur > 0:
        fine = cv2.GaussianBlur(fine, (0, 0), SUBPIXELS * scene.blur, borderType=cv2.BORDER_REPLICATE)
    image = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(float)
    right, down = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    image *= 1 + scene.light[0] * right + scene.light[1] * down
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    for glare in scene.glares:
        image += glare.strength * np.exp(-((u - glare.u) ** 2 + (v - glare.v) ** 2) / (2 * glare.radius**2))
    return 255 * image


def render(
    T_camera_squares: Mapping[int, np.ndarray],
    intrinsics: np.ndarray,
    width: int,
    height: int,
    scene: Scene,
    rng: np.random.Generator,
) -> np.ndarray:
    """Take a photograph: ``light_map`` with noise, wrong pixels, rounding and saturation, uint8 (height, width)."""
    image = light_map(T_camera_squares, intrinsics, width, height, scene)
    image += scene.noise * rng.standard_normal(image.shape)
    if scene.wrong_pixels > 0:
        wrong = rng.random(image.shape) < scene.wrong_pixels
        image[wrong] = rng.uniform(0, 255, np.count_nonzero(wrong))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _paint(fine: np.ndarray, polygons: np.ndarray, reflectance: float) -> None:
    """Cover a part of the fine image with polygons given in pixels of the coarse one."""
    polygons = SUBPIXELS * (polygons + 0.5) - 0.5
    size = fine.shape[::-1]
    low = np.clip(np.floor(polygons.min(axis=(0, 1))).astype(int) - 1, 0, size)
    high = np.clip(np.ceil(polygons.max(axis=(0, 1))).astype(int) + 2, 0, size)
    if np.all(high > low):
        part = fine[low[1] : high[1], low[0] : high[0]]
        part += coverage(polygons - low, *(high - low)) * (reflectance - part)


def _printed(index: int) -> np.ndarray:
    return np.concatenate([fiducial_corners(), index_corners(index)])
