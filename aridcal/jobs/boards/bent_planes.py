"""A plane in an image: its homography, and how far the lens bends it, told by that one image alone.

Functions of the radius follow the division model with one term (Fitzgibbon, CVPR 2001, eq. 2): a pixel at the distance r from
the image's middle is seen, without the lens, in the same direction at r / (1 + b r²).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

# Bends that are tried, with radii counted in half diagonals: beyond them are fisheyes, which OpenCV's five terms do not describe.
MOST_BENT = 0.5

# Steps to the bend that fits best, each ten times nearer or better, and the difference that its slope is taken over.
STEPS, LITTLE = 5, 1e-4


def homography(places: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray | None, float]:
    """Least squares homography from places to pixels, each of shape (M, 2), and its RMS misfit in units of the latter."""
    H, _ = cv2.findHomography(places, pixels, 0)
    if H is None or not np.isfinite(H).all():
        return None, np.inf
    return H, float(np.sqrt(np.mean(np.sum((mapped(H, places) - pixels) ** 2, axis=1))))


def mapped(H: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Places, shape (M, 2), under a homography."""
    images = np.column_stack([places, np.ones(len(places))]) @ H.T
    return images[:, :2] / images[:, 2:]


def local(H: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Derivative of a homography at a place, shape (2, 2)."""
    u, v, w = H @ np.array([place[0], place[1], 1.0])
    return (H[:2, :2] - np.outer([u / w, v / w], H[2, :2])) / w


@dataclass(frozen=True)
class BentPlane:
    """A plane as a lens shows it.

    Attributes:
        H: Homography from the plane's x and y to pixels without the lens, shape (3, 3).
        bend: Of the lens, b of the division model; negative of a barrel.
        middle: Of the image, shape (2,), [px].
        half: Half its diagonal, in which radii count, [px].
    """

    H: np.ndarray
    bend: float
    middle: np.ndarray
    half: float

    def pixels(self, places: np.ndarray) -> np.ndarray:
        """Images of places (M, 2) on the plane, shape (M, 2), [px]."""
        away = (mapped(self.H, places) - self.middle) / self.half
        squared = np.sum(away**2, axis=1, keepdims=True)
        # The smaller root of b s r² - r + s = 0, s and r without and with the lens, in a form that b = 0 does not spoil.
        root = np.sqrt(np.maximum(1 - 4 * self.bend * squared, 0))
        return np.asarray(self.middle + self.half * 2 * away / (1 + root))

    def places(self, pixels: np.ndarray) -> np.ndarray:
        """Places on the plane whose images are these pixels (M, 2), shape (M, 2)."""
        return mapped(np.linalg.inv(self.H), _straight(pixels, self.bend, self.middle, self.half))


def bent_plane(places: np.ndarray, pixels: np.ndarray, size: tuple[int, int]) -> BentPlane:
    """Fit how a lens shows a plane, to marks on it.

    Args:
        places: On the plane, shape (M, 2), four or more that are not on one line.
        pixels: Images of the marks, shape (M, 2).
        size: Width and height of the image, [px].
    """
    middle = (np.array(size) - 1) / 2
    half = float(np.linalg.norm(middle))

    def plane_with(bend: float) -> BentPlane:
        H, _ = cv2.findHomography(places, _straight(pixels, bend, middle, half), 0)
        return BentPlane(H, bend, middle, half)

    def residual(bend: float) -> np.ndarray:
        return np.ravel(plane_with(bend).pixels(places) - pixels)

    bend = 0.0
    for _ in range(STEPS):  # Gauss-Newton in the bend alone, as each has its own homography
        here = residual(bend)
        slope = (residual(bend + LITTLE) - here) / LITTLE
        bend = float(np.clip(bend - slope @ here / (slope @ slope), -MOST_BENT, MOST_BENT))
    return plane_with(bend)


def _straight(pixels: np.ndarray, bend: float, middle: np.ndarray, half: float) -> np.ndarray:
    """Pixels as they would be without the lens."""
    away = (pixels - middle) / half
    return np.asarray(middle + half * away / (1 + bend * np.sum(away**2, axis=1, keepdims=True)))


def centre_of_area(corners: np.ndarray) -> np.ndarray:
    """Centre of the area within polygons, shape (M, K, 2); shape (M, 2)."""
    start = corners - corners[:, :1]  # near the origin, where differences of products are exact enough
    end = np.roll(start, -1, axis=1)
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    moment = ((start + end) * cross[..., None]).sum(axis=1)
    return np.asarray(corners[:, 0] + moment / (3 * cross.sum(axis=1))[:, None])
