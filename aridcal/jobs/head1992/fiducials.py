"""FID, the fiducial identification (Doty 1992, section 5.4): from an image to named fiducials with their covariances.

Blobs of the right size are found (:mod:`aridcal.jobs.head1992.blobs`), matched to the square
(:mod:`aridcal.jobs.head1992.matching`) and then measured by their outlines (:mod:`aridcal.jobs.head1992.edges`). What is not
as clean as the other fiducials is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.jobs.head1992.blobs import Blobs, find_blobs, is_blank, smooth
from aridcal.jobs.head1992.edges import Fits, fit_outlines
from aridcal.jobs.head1992.matching import Match, NotMeasured, match, spans_plane
from aridcal.jobs.head1992.outlines import PIXEL_VARIANCE, predict_shapes
from aridcal.jobs.head1992.sonar import Plane, fit_plane
from aridcal.jobs.head1992.square import FiducialLayout
from aridcal.jobs.head1992.square_pose import Sonars, robust_pose, start_on_plane

# [px] of a blob's centroid.
BLOB_STD = 0.3

# [m] of a sonar, as long as it only helps to find fiducials: its faults are none of theirs.
LOOSE_STD = 0.01

# Fiducials of one polarity that make it needless to look for the other one.
ENOUGH_PAIRS = 4

# From the pose of blobs an edge may be off by a pixel, which looks like a gross error until it is moved.
GROSS_STEPS = 2

# [px] that a fiducial must be inside the image by: its edge is blurred.
BORDER_MARGIN = 2.0

# Of outlines fitted again from the pose that they gave: the second one moves nothing that matters.
REFINING_ROUNDS = 2

# Times that of the other fiducials, and a share of the contrast: with more, something is on the fiducial.
MAX_NOISE, NOISE_SHARE = 2.2, 0.01

# Mean robust weight of the outline: with less, a third of it is covered.
MIN_EDGE_WEIGHT = 0.7

# Contrast over noise of a single pixel: with less, blobs could not have been told from noise.
MIN_SNR = 4.0

# Of that of the other fiducials: one that is half covered by something grey has less.
LEAST_CONTRAST = 0.5

# [px] of a centre: with more it is not known better than a blob's.
MAX_STD = 0.3

# [px] by which growth may differ between fiducials, beyond noise: dirt and glare show in it.
GROWTH_SPREAD = 0.08

# Likewise, share of the edges' variance: some are nearer, some out of focus.
VARIANCE_SPREAD = 0.25

# Standard deviations of its own growth and variance that a fiducial may also differ by.
SPREAD_STD = 5.0

# Of the fiducial's half size.
MAX_GROWTH = 0.25

# [px] from where the blobs' pose puts it, and share of its half size: further off it is something else.
MAX_SHIFT, SHIFT_SHARE = 1.0, 0.2


@dataclass(frozen=True)
class Fiducials:
    """Fiducials found in an image.

    Attributes:
        layout: Which they are, M of them.
        pixels: Images of their centres, shape (M, 2).
        covariances: Of those, shape (M, 2, 2), [px²].
        T_camera_square: Pose that their shapes were predicted with, shape (4, 4).
    """

    layout: FiducialLayout
    pixels: np.ndarray
    covariances: np.ndarray
    T_camera_square: np.ndarray


def find_fiducials(image: np.ndarray, layout: FiducialLayout, intrinsics: np.ndarray, sonars: Sonars) -> Fiducials:
    """Find the fiducials of the square nearest the optical axis, and of its neighbours.

    Args:
        image: Grey levels, uint8, shape (height, width).
        layout: Fiducials that may be in view, those of the square nearest the optical axis first.
        intrinsics: In the order of ``camera.INTRINSICS``, shape (9,).
        sonars: Ranges; they need only be right to some per cent.

    Returns:
        At least three fiducials that are not on one line.

    Raises:
        NotMeasured: No usable square, and why.
    """
    plane = fit_plane(sonars.readings, sonars.positions, sonars.measures)
    sonars = replace(sonars, std=max(sonars.std, LOOSE_STD))
    matched = _identify(smooth(image), layout, intrinsics, plane)
    try:
        T = _blob_pose(matched, layout, intrinsics, sonars, plane)
        return _refine(image, T, layout, intrinsics, sonars, matched.dark)
    except ValueError as error:
        raise NotMeasured(str(error)) from None


@dataclass(frozen=True)
class _Matched:
    """Blobs of one polarity that are matched to fiducials; dark is black on white."""

    match: Match
    blobs: Blobs
    dark: bool


def _identify(smoothed: np.ndarray, layout: FiducialLayout, intrinsics: np.ndarray, plane: Plane) -> _Matched:
    """Match blobs to fiducials, black on white first, then white on black; the polarity that explains more wins.

    Args:
        smoothed: The image, from ``smooth``, shape (height, width).
        layout: Fiducials that may be in view.
        intrinsics: Shape (9,).
        plane: What the sonars say.

    Raises:
        NotMeasured: Neither polarity shows a square.
    """
    blank = partial(is_blank, smoothed, intrinsics, plane)
    matches: list[_Matched] = []
    refusals: list[NotMeasured] = []
    for dark in (True, False):
        blobs = find_blobs(smoothed, dark, intrinsics, plane)
        try:
            matches.append(_Matched(match(blobs, layout, blank), blobs, dark))
        except NotMeasured as refusal:
            refusals.append(refusal)
        if matches and len(matches[0].match.pairs) >= ENOUGH_PAIRS:
            break
    if not matches:  # the refusal that says more than that there are no marks
        raise max(refusals, key=lambda refusal: "no square" not in str(refusal))
    return max(matches, key=lambda candidate: len(candidate.match.pairs))


def _blob_pose(
    matched: _Matched, layout: FiducialLayout, intrinsics: np.ndarray, sonars: Sonars, plane: Plane
) -> np.ndarray:
    """Measure T_camera_square, (4, 4), from the centroids of blobs: to some tenths of a pixel."""
    fiducial, blob = matched.match.pairs.T
    points, pixels = layout.centres[fiducial], matched.blobs.pixels[blob]
    covariances = np.tile(BLOB_STD**2 * np.eye(2), (len(points), 1, 1))
    start = start_on_plane(points, pixels, plane, intrinsics)
    pose, _ = robust_pose(points, pixels, covariances, sonars, intrinsics, start)
    return pose.T_camera_square


def _refine(
    image: np.ndarray, T: np.ndarray, layout: FiducialLayout, intrinsics: np.ndarray, sonars: Sonars, dark: bool
) -> Fiducials:
    """Fit the outlines from the pose of the blobs, then again from the pose that gives.

    Args:
        image: Grey levels, shape (height, width).
        T: T_camera_square from the blobs, shape (4, 4).
        layout: Fiducials that may be in view; those that are not wholly are left out.
        intrinsics: Shape (9,).
        sonars: Ranges.
        dark: Black on white.

    Raises:
        NotMeasured: Too few fiducials are clean.
    """
    height, width = image.shape
    shapes = predict_shapes(T, layout, intrinsics)
    reach = shapes.half_extent + BORDER_MARGIN
    in_view = (shapes.centres > reach) & (shapes.centres < [width - 1, height - 1] - reach)
    inside = np.all(in_view, axis=1)
    layout, shapes = layout[inside], shapes[inside]
    fits = fit_outlines(image, shapes, None, GROSS_STEPS)
    shift = np.max(np.abs(fits.shift), axis=1)
    half_size = np.min(shapes.half_extent, axis=1)
    good = _acceptable(fits, half_size, dark) & (shift < MAX_SHIFT + SHIFT_SHARE * half_size)
    for _ in range(REFINING_ROUNDS):
        layout, fits = layout[good], fits[good]
        _check(layout)
        pose, used = robust_pose(layout.centres, fits.centres, fits.covariances, sonars, intrinsics, T)
        layout, fits, T = layout[used], fits[used], pose.T_camera_square
        shapes = predict_shapes(T, layout, intrinsics)
        fits = fit_outlines(image, shapes, fits)
        good = _acceptable(fits, np.min(shapes.half_extent, axis=1), dark)
        if np.all(good):
            break
    layout, fits = layout[good], fits[good]
    _check(layout)
    return Fiducials(layout, fits.centres, fits.covariances, T)


def _acceptable(fits: Fits, half_size: np.ndarray, dark: bool) -> np.ndarray:
    """Tell which fits, (F,), are those of a fiducial, and clean: alike in contrast, blur and growth, and well determined.

    Args:
        fits: Of F fiducials.
        half_size: Of their images, the shorter side's, shape (F,), [px].
        dark: Black on white.
    """
    contrast = -fits.contrast if dark else fits.contrast
    finite = np.all(np.isfinite(fits.theta), axis=1)
    known = finite & (fits.edge_weight > MIN_EDGE_WEIGHT) & (contrast > MIN_SNR * fits.noise)
    if not np.any(known):
        return known

    def usual(values: np.ndarray) -> float:
        return float(np.median(values[known]))

    variance = fits.blur**2
    growth_std, variance_std = fits.shape_std.T
    growth_off = np.abs(fits.growth - usual(fits.growth))
    variance_off = np.abs(variance - usual(variance))
    growth_limit = GROWTH_SPREAD + SPREAD_STD * growth_std
    variance_limit = VARIANCE_SPREAD * (usual(variance) + PIXEL_VARIANCE) + SPREAD_STD * variance_std
    noise_limit = MAX_NOISE * usual(fits.noise) + NOISE_SHARE * contrast
    std = np.sqrt(np.max(np.linalg.eigvalsh(fits.covariances), axis=1))
    return (
        known
        & (contrast > LEAST_CONTRAST * usual(contrast))
        & (fits.noise < noise_limit)
        & (growth_off < growth_limit)
        & (variance_off < variance_limit)
        & (np.abs(fits.growth) < MAX_GROWTH * half_size)
        & (std < MAX_STD)
    )


def _check(layout: FiducialLayout) -> None:
    """Refuse what is left of the fiducials if it determines no pose."""
    if not spans_plane(layout.centres):
        raise NotMeasured(f"only {len(layout)} clean fiducials: three that are not on one line are needed")
