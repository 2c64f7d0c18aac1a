"""Marks that may be fiducials: blobs of the right area and shape (Doty's FID, step 1, section 5.4).

The area to expect follows from the sonars' plane, area in px = f² xi A / Z³, so that a centre fiducial and a perimeter one,
twice as small, are told apart by Doty's threshold between them and not by equality.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from aridcal.engine.instruments.camera import DOTY_OPENCV, on_plane, project
from aridcal.jobs.head1992.sonar import Plane
from aridcal.jobs.head1992.square import CENTRE_FIDUCIAL, FIDUCIAL_SIZES, INCH

# Of a perimeter fiducial and of a centre one, [m²].
SMALL_AREA, CENTRE_AREA = INCH**2 / 16, INCH**2 / 8

# Doty's threshold between the two, n² / (8 sqrt 2) px in its units: equally many times off either.
BETWEEN_AREAS = np.sqrt(SMALL_AREA * CENTRE_AREA)

# Times that an area may be too large or too small: blur, the threshold, a sonar's fault.
AREA_TOLERANCE = 1.7

# The same before perspective is known, -21 to +25 % across a square at 10 degrees: only to leave out what is
# plainly none.
LENGTH_TOLERANCE = AREA_TOLERANCE**1.5

# Long side over short side, nominally 1 and 2: tilt and a half-pixel of blur all around change both.
SMALL_ASPECT, CENTRE_ASPECT = 1.4, (1.45, 2.8)

# Area over that of the rectangle with the same second moments: 1 for a rectangle, less for what is hollow or
# ragged.
FILLED_SHARES = (0.85, 1.15)

# [grey levels], and as many standard deviations of the smoothed noise: fewer would turn noise into blobs.
MIN_CONTRAST = 8.0

# Of what stands out most nearby: an edge is where the light is half of each side's, however it is blurred.
HALF_WAY = 0.5

# Side of the window that wipes marks out, in widths of a centre fiducial: wider than the narrowest way out of any.
WIDEST_MARK = 1.5

# Median of the difference of two independent pixels, in standard deviations of one: 0.6745 sqrt 2.
NOISE_PER_MEDIAN = 0.95

# [px²] of an outline that is a mere line: about that of a pixel, 1 / 12.
LEAST_BLOB_VARIANCE = 0.1

# [grey levels] from which a place may be bright for any reason.
WASHED_OUT_GREY = 250

# Of the right size: more of them are texture, and matching them takes long.
MAX_BLOBS = 60

# Before shapes are looked at: three of four may be letters, screws and shadows.
MAX_OUTLINES = 4 * MAX_BLOBS

# Of a fiducial's contrast by which bare paper may differ from paper nearby: less than half-way to a mark.
LIKE_PAPER = 0.4

# A fiducial and some paper around it: so many of its sides to either side, so many points along each.
SPOT_REACH, SPOT_POINTS = 0.8, 7


class Blobs(NamedTuple):
    """Candidates, in the image and on the sonars' plane.

    Attributes:
        pixels: Centroids, shape (B, 2).
        places: The same on the plane as x + i y, shape (B,), [m]: the optical axis meets the plane at 0, x to the right.
        is_centre: True of blobs with the size and shape of a centre fiducial, shape (B,).
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

    A mark is what stands out from all that is too wide for one by half of what anything near it does, so that neither uneven
    light nor the paper's edge matters. Its area on the paper is A = area in px Z³ / (fx fy xi), at depth Z.

    Args:
        smoothed: From ``smooth``, shape (height, width).
        dark: Look for black on white, else for white on black.
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        plane: What the sonars say.
    """
    scale = intrinsics[0] / plane.distance  # [px/m]
    hat, top = _hat(smoothed, dark, scale)
    contrast = MIN_CONTRAST * max(_noise(smoothed), 1.0)
    marks = (hat > cv2.convertScaleAbs(top, alpha=HALF_WAY)) & (top > contrast)
    outlines = _outlines(marks, scale)
    if not 0 < len(outlines) <= MAX_OUTLINES:
        return Blobs(np.zeros((0, 2)), np.zeros(0, complex), np.zeros(0, bool), np.zeros(0))
    rectangles = _rectangles(outlines)
    tips = rectangles.pixels + rectangles.long_axes
    places = on_plane(np.stack([rectangles.pixels, tips]), intrinsics, plane.normal, plane.distance)
    depth = np.abs(places[0, :, 2])
    area = rectangles.area * depth**3 / (intrinsics[0] * intrinsics[1] * plane.distance)  # [m²]
    is_centre, is_small = _kinds(rectangles, area)
    keep = is_centre | is_small
    right, up, axis = _plane_axes(plane)
    middles, ends = (places[:, keep] - axis) @ (right + 1j * up)
    return Blobs(rectangles.pixels[keep], middles, is_centre[keep], np.angle(ends - middles))


def _hat(smoothed: np.ndarray, dark: bool, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Height of each pixel above all that is too wide for a mark, and the largest nearby, uint8.

    Morphology's black hat (closing minus image) for dark marks, its white hat (image minus opening) for bright ones, with a
    square window (Serra, "Image Analysis and Mathematical Morphology", 1982).
    """
    width = int(WIDEST_MARK * FIDUCIAL_SIZES[CENTRE_FIDUCIAL - 1, 0] * scale) | 1  # odd
    row = np.ones((width, 1), np.uint8)

    def wide(f: Callable[[np.ndarray, np.ndarray], np.ndarray], image: np.ndarray) -> np.ndarray:
        return f(f(image, row), row.T)

    if dark:
        closing = wide(cv2.erode, wide(cv2.dilate, smoothed))
        hat = cv2.subtract(closing, smoothed)
    else:
        opening = wide(cv2.dilate, wide(cv2.erode, smoothed))
        hat = cv2.subtract(smoothed, opening)
    return hat, wide(cv2.dilate, hat)


def _noise(smoothed: np.ndarray) -> float:
    """Estimate the standard deviation of a smoothed image's noise from every fourth pixel and the third one beside it."""
    left = smoothed[::4, :-3:4].astype(float)
    right = smoothed[::4, 3::4]
    return float(np.median(np.abs(left - right)) / NOISE_PER_MEDIAN)


def _outlines(marks: np.ndarray, scale: float) -> list[np.ndarray]:
    """Trace the outlines of marks that are neither too short nor too long for a fiducial and off the image's border."""
    smallest = SMALL_AREA * scale**2 / LENGTH_TOLERANCE
    largest = CENTRE_AREA * scale**2 * LENGTH_TOLERANCE
    # Outlines in pixels: a square's is 4 sides long, half of that for one cut up; twice that for one that is ragged.
    shortest, longest = 2 * np.sqrt(smallest), 8 * np.sqrt(largest)
    contours, _ = cv2.findContours(marks.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    right_length = [o for o in contours if shortest < len(o) < longest]
    return [o for o in right_length if not _at_border(o, marks)]


class _Rectangles(NamedTuple):
    """Blobs as the rectangles that have their second moments.

    Attributes:
        pixels: Centroids, shape (B, 2).
        area: Of the blobs, shape (B,), [px²].
        short: Short side, shape (B,), [px].
        long: Long side, shape (B,), [px].
        long_axes: Unit vectors along the long side, shape (B, 2).
    """

    pixels: np.ndarray
    area: np.ndarray
    short: np.ndarray
    long: np.ndarray
    long_axes: np.ndarray


def _rectangles(outlines: list[np.ndarray]) -> _Rectangles:
    """Measure blobs by the moments of their outlines.

    An outline runs through the middles of a mark's outer pixels: half a pixel is missing all around. By Pick's theorem the
    area is that of the outline plus half its points plus one; each side is one pixel longer. A rectangle of side w has
    variance w² / 12 along it.
    """
    names = ("m10", "m01", "mu20", "mu11", "mu02")
    moments = [cv2.moments(o) for o in outlines]
    m00 = np.array([max(m["m00"], 1.0) for m in moments])
    m10, m01, mu20, mu11, mu02 = np.array([[m[name] for name in names] for m in moments]).T
    lengths = np.array([len(o) for o in outlines])
    area = m00 + lengths / 2 + 1
    pixels = np.column_stack([m10, m01]) / m00[:, None]
    spreads = np.moveaxis(np.array([[mu20, mu11], [mu11, mu02]]), 2, 0)
    variances, axes = np.linalg.eigh(spreads / m00[:, None, None])
    short, long = np.sqrt(12 * np.maximum(variances, LEAST_BLOB_VARIANCE)).T + 1
    return _Rectangles(pixels, area, short, long, axes[:, :, 1])


def _kinds(rectangles: _Rectangles, area: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tell which blobs have size and shape of a centre fiducial and which of a small one, each (B,), by area in [m²]."""
    aspect = rectangles.long / rectangles.short
    around = rectangles.short * rectangles.long
    filled = rectangles.area / around
    solid = (filled > FILLED_SHARES[0]) & (filled < FILLED_SHARES[1])
    large = (area > BETWEEN_AREAS) & (area < CENTRE_AREA * AREA_TOLERANCE)
    slender = (aspect > CENTRE_ASPECT[0]) & (aspect < CENTRE_ASPECT[1])
    little = (area > SMALL_AREA / AREA_TOLERANCE) & (area < SMALL_AREA * AREA_TOLERANCE)
    stout = aspect < SMALL_ASPECT
    return solid & large & slender, solid & little & stout


def is_blank(
    smoothed: np.ndarray,
    intrinsics: np.ndarray,
    plane: Plane,
    seen_places: np.ndarray,
    places: np.ndarray,
    turn: complex,
) -> np.ndarray:
    """Tell at which places on the plane there plainly is bare paper where a small fiducial should be.

    Args:
        smoothed: From ``smooth``, shape (height, width).
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        plane: What the sonars say.
        seen_places: Where small fiducials of the same square are seen, as in ``Blobs``, shape (K,), [m].
        places: Where there should be more of them, shape (M,), [m].
        turn: Of the square on the plane, of modulus 1.

    Returns:
        Shape (M,); False where the place is not wholly in view, is covered by something that is not like the paper around the
        nearest known fiducial, or may be washed out.
    """
    n = len(seen_places)
    if n == 0:
        return np.zeros(len(places), dtype=bool)
    grey, in_view = _spots(smoothed, intrinsics, plane, np.concatenate([seen_places, places]), turn)
    seen_grey, grey_expected = grey[:n], grey[n:]
    inside = np.zeros((SPOT_POINTS - 2, SPOT_POINTS - 2), dtype=bool)
    rim = np.pad(inside, 1, constant_values=True).ravel()
    paper = np.median(seen_grey[:, rim], axis=1)
    contrast = np.abs(seen_grey[:, SPOT_POINTS**2 // 2] - paper)
    nearest = np.argmin(np.abs(places[:, None] - seen_places), axis=1)
    contrast_nearby = np.minimum(contrast[nearest], np.median(contrast))[:, None]
    like_paper = np.abs(grey_expected - paper[nearest, None]) < LIKE_PAPER * contrast_nearby
    washed_out = (grey_expected > WASHED_OUT_GREY) & np.any(paper < WASHED_OUT_GREY)
    return in_view[n:] & np.all(like_paper & ~washed_out, axis=1)


def _spots(
    smoothed: np.ndarray, intrinsics: np.ndarray, plane: Plane, places: np.ndarray, turn: complex
) -> tuple[np.ndarray, np.ndarray]:
    """Read the grey levels on and around places (K,) on the plane: (K, SPOT_POINTS²), and which lie wholly in view, (K,)."""
    right, up, axis = _plane_axes(plane)
    side = np.linspace(-SPOT_REACH, SPOT_REACH, SPOT_POINTS) * FIDUCIAL_SIZES[0, 0]
    spot = (side[:, None] + 1j * side).ravel()
    grid = places[:, None] + turn * spot
    to_right, to_up = grid.real[..., None], grid.imag[..., None]
    points = axis + to_right * right + to_up * up
    pixels = project(points @ DOTY_OPENCV, intrinsics)
    uv = np.rint(pixels).astype(int)
    height, width = smoothed.shape
    in_view = np.all((uv >= 0) & (uv < [width, height]), axis=(1, 2))
    u, v = np.moveaxis(np.clip(uv, 0, [width - 1, height - 1]), 2, 0)
    return smoothed[v, u].astype(float), in_view


def _plane_axes(plane: Plane) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the plane's axes to the right and up and where the optical axis meets it, in Doty's camera frame."""
    n = plane.normal
    right = np.array([1.0, 0, 0]) - n[0] * n
    right /= np.linalg.norm(right)
    up = np.cross(n, right)
    pierced = np.array([0, 0, -plane.distance / n[2]])
    return right, up, pierced


def _at_border(outline: np.ndarray, image: np.ndarray) -> bool:
    """Tell whether a mark touches the image's border, so that some of it may be outside."""
    x, y, width, height = cv2.boundingRect(outline)
    right, below = x + width, y + height
    return bool(x <= 0 or y <= 0 or right >= image.shape[1] or below >= image.shape[0])
