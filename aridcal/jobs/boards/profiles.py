"""Edges of what is printed, along lines across them: where they are to a fraction of a pixel, and how blurred."""

from __future__ import annotations

import cv2
import numpy as np

# Samples of a line across an edge.
PROFILE_SAMPLES = 61

# Share of a line's samples at each of its ends that shows the grey level beside the edge.
PLATEAU = 0.15

# [grey levels] that two sides of an edge differ by at least.
LEAST_EDGE_CONTRAST = 25.0

# Lines across the side of a marker, and how far from its ends, in its length, the first and the last are.
LINES, CLEAR_OF_CORNERS = 24, 0.13

# Reach of these lines to either side, in modules of the marker. There is one of black inside and one of white outside: half of
# it keeps the light of bits and neighbours off, and a blur of the edge itself moves both its levels alike.
PROFILE_REACH = 0.5

# Lines that a side is fitted to at least, and residual beyond which one is left out, in their median.
FEWEST_LINES, OUTLYING = 10, 4.0

# Steps to where two bent sides meet: each is ten times nearer.
CORNER_STEPS = 5


def profiles(image: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Grey levels along lines from starts to ends, each of shape (n, 2), [px]; shape (n, SAMPLES), NaN outside the image."""
    share = np.linspace(0, 1, PROFILE_SAMPLES)
    places = starts[:, None] + share[:, None] * (ends - starts)[:, None]
    u, v = (np.ascontiguousarray(places[..., k], dtype=np.float32) for k in (0, 1))
    grey = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    height, width = image.shape
    inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    return np.where(inside, grey, np.nan)


def crossings(grey: np.ndarray) -> np.ndarray:
    """Where each line passes the middle between the grey levels of its two ends, as a share of it; NaN if unclear.

    Args:
        grey: Along lines, shape (n, SAMPLES).
    """
    level, contrast = _levels(grey)
    above = (grey - level[:, None]) * np.sign(contrast)[:, None]
    # One crossing only: anything else is another edge.
    passes = (above[:, :-1] < 0) & (above[:, 1:] >= 0)
    back = (above[:, :-1] >= 0) & (above[:, 1:] < 0)
    clear = (np.abs(contrast) >= LEAST_EDGE_CONTRAST) & (passes.sum(axis=1) == 1) & ~back.any(axis=1)
    k = np.argmax(passes, axis=1)
    rows = np.arange(len(grey))
    low, high = above[rows, k], above[rows, k + 1]
    share = (k - low / np.where(high > low, high - low, 1.0)) / (PROFILE_SAMPLES - 1)
    return np.where(clear, share, np.nan)


def blurs(grey: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Standard deviation of the blur of the edge that each line crosses, [px]; NaN where there is no contrast.

    An edge of contrast C blurred by a Gaussian of sigma has the slope C / (sqrt(2 pi) sigma) at its steepest.

    Args:
        grey: Along lines, shape (n, SAMPLES).
        lengths: Of the lines, shape (n,), [px].
    """
    _, contrast = _levels(grey)
    steps = lengths / (PROFILE_SAMPLES - 1)
    wide = 4  # samples that a slope is taken over: one pixel's noise is no edge
    slope = np.abs(grey[:, wide:] - grey[:, :-wide]).max(axis=1) / (wide * steps)
    seen = (np.abs(contrast) >= LEAST_EDGE_CONTRAST) & (slope > 0)
    return np.where(seen, np.abs(contrast) / np.sqrt(2 * np.pi) / np.where(seen, slope, 1.0), np.nan)


def _levels(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle between the grey levels at the two ends of each line, and their difference, each of shape (n,)."""
    n = round(PLATEAU * PROFILE_SAMPLES)
    first, last = grey[:, :n].mean(axis=1), grey[:, -n:].mean(axis=1)
    return (first + last) / 2, last - first


def side_lines(quad: np.ndarray, modules: int) -> tuple[np.ndarray, np.ndarray]:
    """Lines from inside a marker across its four sides.

    Args:
        quad: Its corners, clockwise as seen, shape (4, 2), [px].
        modules: Along a side.

    Returns:
        Starts and ends, each of shape (4, LINES, 2).
    """
    share = np.linspace(CLEAR_OF_CORNERS, 1 - CLEAR_OF_CORNERS, LINES)[:, None]
    sides = np.roll(quad, -1, axis=0) - quad
    middles = quad[:, None] + share * sides[:, None]
    outward = np.stack([sides[:, 1], -sides[:, 0]], axis=1)  # of a clockwise quad, v pointing down
    outward *= PROFILE_REACH / modules
    return middles - outward[:, None], middles + outward[:, None]


def refined_quad(image: np.ndarray, quad: np.ndarray, modules: int) -> tuple[np.ndarray, float] | None:
    """Corners of a marker where its four sides meet, each fitted as a parabola: lenses bend them.

    The corners themselves are not looked at: blur rounds them, but leaves the middle of an edge where it is.

    Args:
        image: Grey levels.
        quad: Roughly its corners, clockwise as seen, shape (4, 2), [px].
        modules: Along a side.

    Returns:
        The corners, shape (4, 2), and the blur of the sides, [px]; None where a side is not seen clearly.
    """
    starts, ends = side_lines(quad, modules)
    lengths = np.linalg.norm(ends - starts, axis=2)
    grey = profiles(image, starts.reshape(-1, 2), ends.reshape(-1, 2))
    where = crossings(grey).reshape(4, LINES)
    seen = starts + where[..., None] * (ends - starts)
    curves = []
    for side, points in enumerate(seen):
        points = points[np.isfinite(points[:, 0])]
        curve = _parabola(quad[side], quad[(side + 1) % 4], points)
        if curve is None:
            return None
        curves.append(curve)
    blur = blurs(grey, lengths.ravel())
    corners = [_meeting(quad[k], quad, curves, k) for k in range(4)]
    return np.array(corners), float(np.nanpercentile(blur, 90))


def _parabola(start: np.ndarray, end: np.ndarray, points: np.ndarray) -> np.ndarray | None:
    """Offset to the left of the line from start to end, as a polynomial of the share of the way; shape (3,), highest first."""
    if len(points) < FEWEST_LINES:
        return None
    along = end - start
    length = np.linalg.norm(along)
    normal = np.array([along[1], -along[0]]) / length
    share, offset = (points - start) @ along / length**2, (points - start) @ normal
    for _ in range(2):
        curve = np.polyfit(share, offset, 2)
        off = np.abs(np.polyval(curve, share) - offset)
        near = off <= OUTLYING * np.median(off) + 0.02
        if near.sum() < FEWEST_LINES:
            return None
        share, offset = share[near], offset[near]
    return curve


def _meeting(corner: np.ndarray, quad: np.ndarray, curves: list[np.ndarray], k: int) -> np.ndarray:
    """Where side k, which starts at corner k, meets the side that ends there: both as their tangents, step by step."""
    point = corner.copy()
    for _ in range(CORNER_STEPS):
        normals, values = [], []
        for side in (k, (k - 1) % 4):
            start = quad[side]
            along = quad[(side + 1) % 4] - start
            length = np.linalg.norm(along)
            unit, normal = along / length, np.array([along[1], -along[0]]) / length
            share = (point - start) @ unit / length
            slope = np.polyval(np.polyder(curves[side]), share) / length
            on_curve = start + share * along + np.polyval(curves[side], share) * normal
            across = normal - slope * unit
            normals.append(across)
            values.append(across @ on_curve)
        point = np.linalg.solve(np.array(normals), np.array(values))
    return point
