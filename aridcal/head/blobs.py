"""Marks that may be fiducials: blobs of the right area and shape (the report's FID, step 1, section 5.4).

The area to expect follows from the sonars' plane, area in px = f² xi A / Z³, so that a centre fiducial and a perimeter one,
twice as small, are told apart by the report's threshold between them and not by equality.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from aridcal.head.camera import REPORT_OPENCV, on_plane, project
from aridcal.head.sonar import Plane
from aridcal.head.square import CENTRE_FIDUCIAL, INCH, SIZES

SMALL_AREA, CENTRE_AREA = INCH**2 / 16, INCH**2 / 8
BETWEEN_AREAS = np.sqrt(SMALL_AREA * CENTRE_AREA)  # n² / (8 sqrt 2) px in the report's units
AREA_TOLERANCE = 1.7  # times too large or too small: blur, the threshold, a sonar's fault
SMALL_ASPECT, CENTRE_ASPECT = 1.4, (1.45, 2.8)
FILLED = (0.85, 1.15)  # area over that of the rectangle with the same second moments
MIN_CONTRAST = 8.0  # [grey levels], and as many standard deviations of the smoothed noise
WASHED_OUT = 250  # [grey levels]
MAX_BLOBS = 60  # of the right size: more of them are texture


class Blobs(NamedTuple):
    """Candidates, in the image and on the sonars' plane.

    Attributes:
        pixels: Centroids, shape (B, 2).
        places: The same on the plane as x + i y, shape (B,), [m]: the optical axis meets the plane at 0, x to the right.
        is_centre: Which have the size and shape of a centre fiducial, shape (B,).
        angles: Of the long side on the plane, shape (B,), [rad], modulo pi.
    """

    pixels: np.ndarray
    places: np.ndarray
    is_centre: np.ndarray
    angles: np.ndarray


def smooth(image: np.ndarray) -> np.ndarray:
    """Remove isolated wrong pixels and some of the noise, uint8."""
    return cv2.GaussianBlur(cv2.medianBlur(image, 3), (3, 3), 0)


def find_blobs(smoothed: np.ndarray, dark: bool, intrinsics: np.ndarray, plane: Plane) -> Blobs:
    """Find the blobs that have the area and the shape of fiducials.

    Args:
        smoothed: From ``smooth``, shape (height, width).
        dark: Look for black on white, else for white on black.
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        plane: What the sonars say.

    Returns:
        The candidates. A mark is what stands out from all that is too wide for one (morphology's black or white hat) by half
        of what anything near it does, so that neither uneven light nor the paper's edge matters.
    """
    scale = intrinsics[0] / plane.distance
    width = int(1.5 * SIZES[CENTRE_FIDUCIAL - 1, 0] * scale) | 1  # wider than the narrowest way out of any fiducial
    kernel = np.ones((width, 1), np.uint8)

    def wide(f: Callable[[np.ndarray, np.ndarray], np.ndarray], image: np.ndarray) -> np.ndarray:
        return f(f(image, kernel), kernel.T)

    if dark:
        hat = cv2.subtract(wide(cv2.erode, wide(cv2.dilate, smoothed)), smoothed)
    else:
        hat = cv2.subtract(smoothed, wide(cv2.dilate, wide(cv2.erode, smoothed)))
    top = wide(cv2.dilate, hat)
    noise = np.median(np.abs(smoothed[::4, :-3:4].astype(float) - smoothed[::4, 3::4])) / 0.95
    marks = (hat > cv2.convertScaleAbs(top, alpha=0.5)) & (top > MIN_CONTRAST * max(noise, 1.0))
    limits = SMALL_AREA * scale**2 / AREA_TOLERANCE**1.5, CENTRE_AREA * scale**2 * AREA_TOLERANCE**1.5
    found, _ = cv2.findContours(marks.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    lengths = 2 * np.sqrt(limits[0]), 8 * np.sqrt(limits[1])
    outlines = [o for o in found if lengths[0] < len(o) < lengths[1] and not _at_border(o, smoothed)]
    if not 0 < len(outlines) <= 4 * MAX_BLOBS:
        return Blobs(np.zeros((0, 2)), np.zeros(0, complex), np.zeros(0, bool), np.zeros(0))
    m = [cv2.moments(o) for o in outlines]
    m00, m10, m01, mu20, mu11, mu02 = np.array(
        [[max(k["m00"], 1.0)] + [k[name] for name in ("m10", "m01", "mu20", "mu11", "mu02")] for k in m]
    ).T
    # An outline runs through the middles of a mark's outer pixels: half a pixel is missing all around (Pick's theorem).
    area = m00 + np.array([len(o) for o in outlines]) / 2 + 1
    pixels = np.column_stack([m10, m01]) / m00[:, None]
    spreads = np.moveaxis(np.array([[mu20, mu11], [mu11, mu02]]), 2, 0) / m00[:, None, None]
    variances, axes = np.linalg.eigh(spreads)
    short, long = np.sqrt(12 * np.maximum(variances, 0.1)).T + 1
    points = np.stack([pixels, pixels + axes[:, :, 1]])
    places = on_plane(points, intrinsics, plane.normal, plane.distance)
    area_m2 = area * np.abs(places[0, :, 2]) ** 3 / (intrinsics[0] * intrinsics[1] * plane.distance)  # px to m²
    aspect = long / short
    filled = (area / (short * long) > FILLED[0]) & (area / (short * long) < FILLED[1])
    is_centre = (area_m2 > BETWEEN_AREAS) & (area_m2 < CENTRE_AREA * AREA_TOLERANCE)
    is_centre &= (aspect > CENTRE_ASPECT[0]) & (aspect < CENTRE_ASPECT[1])
    is_small = (
        (area_m2 < SMALL_AREA * AREA_TOLERANCE) & (area_m2 > SMALL_AREA / AREA_TOLERANCE) & (aspect < SMALL_ASPECT)
    )
    keep = filled & (is_centre | is_small)
    right, up, axis = _plane_axes(plane)
    flat = (places[:, keep] - axis) @ (right + 1j * up)
    return Blobs(pixels[keep], flat[0], is_centre[keep], np.angle(flat[1] - flat[0]))


def is_blank(
    smoothed: np.ndarray, intrinsics: np.ndarray, plane: Plane, known: np.ndarray, places: np.ndarray, turn: complex
) -> np.ndarray:
    """Tell at which places on the plane there plainly is bare paper where a small fiducial should be.

    Args:
        smoothed: From ``smooth``, shape (height, width).
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        plane: What the sonars say.
        known: Where small fiducials of the same square are seen, as in ``Blobs``, shape (K,), [m].
        places: Where there should be more of them, shape (M,), [m].
        turn: Of the square on the plane, of modulus 1.

    Returns:
        Shape (M,); False where the place is not wholly in view, is covered by something that is not like the paper around the
        nearest known fiducial, or may be washed out.
    """
    if len(known) == 0:
        return np.zeros(len(places), dtype=bool)
    right, up, axis = _plane_axes(plane)
    side = np.linspace(-0.8, 0.8, 7) * SIZES[0, 0]  # the fiducial and some paper around it
    spots = np.concatenate([known, places])[:, None] + turn * (side[:, None] + 1j * side).ravel()
    points = axis + spots.real[..., None] * right + spots.imag[..., None] * up
    uv = np.rint(project(points @ REPORT_OPENCV, intrinsics)).astype(int)
    height, width = smoothed.shape
    seen = np.all((uv >= 0) & (uv < [width, height]), axis=(1, 2))[len(known) :]
    u, v = np.moveaxis(np.clip(uv, 0, [width - 1, height - 1]), 2, 0)
    grey = smoothed[v, u].astype(float)  # (K + M, 49)
    outer = np.pad(np.zeros((5, 5), dtype=bool), 1, constant_values=True).ravel()
    paper, middle = np.median(grey[: len(known), outer], axis=1), grey[: len(known), 24]
    there, nearest = grey[len(known) :], np.argmin(np.abs(places[:, None] - known), axis=1)
    expected, contrast = paper[nearest, None], np.abs(middle - paper)
    like_paper = np.abs(there - expected) < 0.4 * np.minimum(contrast[nearest], np.median(contrast))[:, None]
    washed_out = (there > WASHED_OUT) & np.any(paper < WASHED_OUT)
    return seen & np.all(like_paper & ~washed_out, axis=1)


def _plane_axes(plane: Plane) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the plane's axes to the right and up and where the optical axis meets it, in the report's camera frame."""
    right = np.array([1.0, 0, 0]) - plane.normal[0] * plane.normal
    right /= np.linalg.norm(right)
    return right, np.cross(plane.normal, right), np.array([0, 0, -plane.distance / plane.normal[2]])


def _at_border(outline: np.ndarray, image: np.ndarray) -> bool:
    x, y, w, h = cv2.boundingRect(outline)
    return bool(x <= 0 or y <= 0 or x + w >= image.shape[1] or y + h >= image.shape[0])
