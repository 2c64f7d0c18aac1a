"""A camera's own numbers from the images that were taken anyway, by OpenCV's calibration of the plane boards in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from aridcal.engine.instruments.camera import INTRINSICS
from aridcal.jobs.boards.finders import ImageMarks
from aridcal.system.errors import AridcalError

# Images that are used, evenly spread: more take long and tell little more.
MOST_IMAGES = 60

# Views without which nothing is tried, and share of the focal length that its standard deviation may be.
FEWEST_VIEWS, WORST_FOCAL = 4, 0.01

# Fewest marks of a view from which the lens is estimated as well.
MANY_MARKS = 12

# An image fits no board if its misfit is so many times that of the others, and beyond so many pixels.
STRANGE, LEAST_STRANGE = 4.0, 0.5


class LensUnknown(AridcalError):
    """The images do not tell the camera's numbers; the message says why."""


@dataclass(frozen=True)
class Lens:
    """A camera's numbers.

    Attributes:
        intrinsics: In the order of ``INTRINSICS``, shape (9,).
        std: Of each, 0 where it was held, shape (9,).
        misfit: RMS of each image's marks, [px]; NaN of an image that was not used; shape (I,).
    """

    intrinsics: np.ndarray
    std: np.ndarray
    misfit: np.ndarray

    @property
    def rms(self) -> float:
        """RMS misfit of all images, [px]."""
        return float(np.sqrt(np.nanmean(self.misfit**2)))

    @property
    def strange(self) -> np.ndarray:
        """True of images whose misfit is far above that of the others, shape (I,) bool."""
        median = float(np.nanmedian(self.misfit))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.misfit > max(STRANGE * median, LEAST_STRANGE))


def estimate(images: Sequence[ImageMarks], size: tuple[int, int]) -> Lens:
    """Estimate a camera's numbers, a lens of two radial and two tangential terms among them.

    Args:
        images: Marks in each.
        size: Width and height of all of them, [px].

    Raises:
        LensUnknown: they are too few, or show the board too much from one side.
    """
    used = np.unique(np.linspace(0, len(images) - 1, min(len(images), MOST_IMAGES)).round().astype(int))
    views = [(k, np.flatnonzero(images[k].group == g)) for k in used for g in np.unique(images[k].group)]
    views = [(k, rows) for k, rows in views if _is_plane(images[k], rows)]
    if len(views) < FEWEST_VIEWS:
        raise LensUnknown(f"{len(views)} views of the board: {FEWEST_VIEWS} are needed, better 15, tilted every way")
    places = [images[k].places[rows].astype(np.float32) for k, rows in views]
    pixels = [images[k].pixels[rows].astype(np.float32) for k, rows in views]
    flags = cv2.CALIB_FIX_K3
    if min(map(len, places)) < MANY_MARKS:
        flags |= cv2.CALIB_FIX_K2 | cv2.CALIB_ZERO_TANGENT_DIST
    try:
        solution = cv2.calibrateCameraExtended(places, pixels, size, None, None, flags=flags)
    except cv2.error:
        raise LensUnknown("the views contradict each other, or are all alike: tilt the board every way") from None
    _, K, lens, _, _, std_all, _, by_view = solution
    intrinsics = np.r_[K[0, 0], K[1, 1], K[0, 2], K[1, 2], np.ravel(lens)[:5]]
    std = np.ravel(std_all)[: len(INTRINSICS)].astype(float)
    focal = max(std[0] / intrinsics[0], std[1] / intrinsics[1]) if np.all(intrinsics[:2] > 0) else np.inf
    if not np.isfinite(intrinsics).all() or not focal < WORST_FOCAL:
        raise LensUnknown(
            f"the focal length is known to {100 * focal:.2g} % only: take images with the board tilted by 30 to 45 degrees "
            "every way, near and far"
        )
    misfit = np.full(len(images), np.nan)
    squares = np.ravel(by_view) ** 2
    for k in used:
        views_of_image = [n for n, (image, _) in enumerate(views) if image == k]
        misfit[k] = np.sqrt(np.mean(squares[views_of_image])) if views_of_image else np.nan
    return Lens(intrinsics, std, misfit)


def fit(images: Sequence[ImageMarks], intrinsics: np.ndarray) -> np.ndarray:
    """Misfit of each image's marks with a camera that is known, RMS [px], shape (I,).

    Args:
        images: Marks in each.
        intrinsics: In the order of ``INTRINSICS``, shape (9,).
    """
    fx, fy, cx, cy = intrinsics[:4]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    misfit = np.full(len(images), np.nan)
    for k, found in enumerate(images):
        squares = []
        for g in np.unique(found.group):
            rows = np.flatnonzero(found.group == g)
            done, turn, shift = cv2.solvePnP(
                found.places[rows], found.pixels[rows], K, intrinsics[4:], flags=cv2.SOLVEPNP_IPPE
            )
            if done:
                turn, shift = cv2.solvePnPRefineLM(
                    found.places[rows], found.pixels[rows], K, intrinsics[4:], turn, shift
                )
                seen, _ = cv2.projectPoints(found.places[rows], turn, shift, K, intrinsics[4:])
                squares.append(np.sum((seen.reshape(-1, 2) - found.pixels[rows]) ** 2, axis=1))
        misfit[k] = np.sqrt(np.mean(np.concatenate(squares))) if squares else np.nan
    return misfit


def _is_plane(marks: ImageMarks, rows: np.ndarray) -> bool:
    """Four marks or more that are not on one line."""
    extents = np.linalg.svd(marks.places[rows] - marks.places[rows].mean(axis=0), compute_uv=False)
    return len(rows) >= 4 and bool(extents[1] > 1e-6 * extents[0])
