"""FID, the fiducial identification (report, section 5.4): from an image to named fiducials with their covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.head.blobs import Blobs, find_blobs, is_blank, smooth
from aridcal.head.edges import PIXEL_VARIANCE, Fits, fit_outlines, predict_shapes
from aridcal.head.matching import Match, NotMeasured, match, spans_plane
from aridcal.head.pose import Sonars, robust_pose, start_on_plane
from aridcal.head.sonar import Plane, fit_plane
from aridcal.head.square import Layout

BLOB_STD = 0.3  # [px] of a blob's centroid
LOOSE_STD = 0.01  # [m] of a sonar, as long as it only helps to find fiducials: its faults are none of theirs
GROSS_STEPS = 2
MAX_NOISE = 2.2  # times that of the other fiducials: something is on it
MIN_EDGE_WEIGHT = 0.7
MIN_SNR = 4.0  # contrast over noise
LEAST_CONTRAST = 0.5  # of that of the other fiducials
MAX_STD = 0.3  # [px]
GROWTH_SPREAD = 0.08  # [px] by which growth may differ between fiducials, beyond noise: dirt and glare show in it
VARIANCE_SPREAD = 0.25  # likewise, share of the edges' variance: some are nearer, some out of focus
MAX_GROWTH = 0.25  # of the fiducial's half size
MAX_SHIFT = 1.0  # [px] from where the blobs' pose puts it, and a tenth of its size


@dataclass(frozen=True)
class Fiducials:
    """Fiducials found in an image.

    Attributes:
        layout: Which they are, M of them.
        pixels: Images of their centres, shape (M, 2).
        covariances: Of those, shape (M, 2, 2), [px²].
        T_camera_square: Pose that their shapes were predicted with, shape (4, 4).
    """

    layout: Layout
    pixels: np.ndarray
    covariances: np.ndarray
    T_camera_square: np.ndarray


def find_fiducials(image: np.ndarray, layout: Layout, intrinsics: np.ndarray, sonars: Sonars) -> Fiducials:
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
    smoothed = smooth(image)
    found: list[tuple[Match, Blobs, bool]] = []
    refusals: list[NotMeasured] = []
    for dark in (True, False):
        blobs = find_blobs(smoothed, dark, intrinsics, plane)
        try:
            found.append((match(blobs, layout, partial(is_blank, smoothed, intrinsics, plane)), blobs, dark))
        except NotMeasured as refusal:
            refusals.append(refusal)
        if found and len(found[0][0].pairs) >= 4:
            break
    if not found:
        raise max(refusals, key=lambda refusal: "no square" not in str(refusal))
    matched, blobs, dark = max(found, key=lambda candidate: len(candidate[0].pairs))
    try:
        T = _blob_pose(matched, blobs, layout, intrinsics, sonars, plane)
        return _refine(image, T, layout, intrinsics, sonars, dark)
    except ValueError as error:
        raise NotMeasured(str(error)) from None


def _blob_pose(
    matched: Match, blobs: Blobs, layout: Layout, intrinsics: np.ndarray, sonars: Sonars, plane: Plane
) -> np.ndarray:
    mine, theirs = matched.pairs.T
    points, pixels = layout.centres[mine], blobs.pixels[theirs]
    covariances = np.tile(BLOB_STD**2 * np.eye(2), (len(points), 1, 1))
    start = start_on_plane(points, pixels, plane, intrinsics)
    pose, _ = robust_pose(points, pixels, covariances, sonars, intrinsics, start)
    return pose.T_camera_square


def _refine(
    image: np.ndarray, T: np.ndarray, layout: Layout, intrinsics: np.ndarray, sonars: Sonars, dark: bool
) -> Fiducials:
    """Fit the outlines from the pose of the blobs, then again from the pose that gives."""
    height, width = image.shape
    shapes = predict_shapes(T, layout, intrinsics)
    reach = shapes.half_extent + 2
    inside = np.all((shapes.centres > reach) & (shapes.centres < [width - 1, height - 1] - reach), axis=1)
    layout, shapes = layout[inside], shapes[inside]
    fits = fit_outlines(image, shapes, None, GROSS_STEPS)
    good = _acceptable(fits, shapes.half_extent, dark)
    good &= np.max(np.abs(fits.theta[:, :2]), axis=1) < MAX_SHIFT + 0.2 * np.min(shapes.half_extent, axis=1)
    for _ in range(2):
        layout, fits = layout[good], fits[good]
        _check(layout)
        pose, used = robust_pose(layout.centres, fits.centres, fits.covariances, sonars, intrinsics, T)
        layout, fits, T = layout[used], fits[used], pose.T_camera_square
        shapes = predict_shapes(T, layout, intrinsics)
        fits = fit_outlines(image, shapes, fits)
        good = _acceptable(fits, shapes.half_extent, dark)
        if np.all(good):
            break
    layout, fits = layout[good], fits[good]
    _check(layout)
    return Fiducials(layout, fits.centres, fits.covariances, T)


def _acceptable(fits: Fits, half_extent: np.ndarray, dark: bool) -> np.ndarray:
    """Tell which fits are those of a fiducial, and clean: alike in contrast, blur and growth, and well determined."""
    contrast = -fits.contrast if dark else fits.contrast
    known = np.all(np.isfinite(fits.theta), axis=1) & (fits.edge_weight > MIN_EDGE_WEIGHT)
    known &= contrast > MIN_SNR * fits.noise
    if not np.any(known):
        return known
    variance = fits.blur**2
    usual_contrast, usual_noise, usual_growth, usual_variance = (
        float(np.median(values[known])) for values in (contrast, fits.noise, fits.growth, variance)
    )
    growth_std, variance_std = fits.shape_std.T
    std = np.sqrt(np.max(np.linalg.eigvalsh(fits.covariances), axis=1))
    return (
        known
        & (contrast > LEAST_CONTRAST * usual_contrast)
        & (fits.noise < MAX_NOISE * usual_noise + 0.01 * contrast)
        & (np.abs(fits.growth - usual_growth) < GROWTH_SPREAD + 5 * growth_std)
        & (np.abs(variance - usual_variance) < VARIANCE_SPREAD * (usual_variance + PIXEL_VARIANCE) + 5 * variance_std)
        & (np.abs(fits.growth) < MAX_GROWTH * np.min(half_extent, axis=1))
        & (std < MAX_STD)
    )


def _check(layout: Layout) -> None:
    if not spans_plane(layout.centres):
        raise NotMeasured(f"only {len(layout)} clean fiducials: three that are not on one line are needed")
