"""Photographs of calibration squares as a head on a simulated arm takes them, and the ranges that its sonars read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from aridcal.head.camera import project
from aridcal.head.reduction import Head
from aridcal.head.render import Scene, render
from aridcal.head.sonar import predict_ranges
from aridcal.head.square import SIDE, fiducial_corners

QUALITY = 90  # of the JPEG files: its errors stay below the camera's noise
AROUND = 4 * SIDE  # squares whose centres are this near the one looked at may be in view
NEAREST = 0.05  # [m] from the lens
MARGIN = 3.0  # [px] to the image's border
LIGHT, BLUR, NOISE = 0.15, (0.5, 0.9), 1.5  # share; [px]; [grey levels]


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

    def seen(self, T_world_camera: np.ndarray, own: int) -> dict[int, np.ndarray]:
        """T_camera_square of a square and of its neighbours, (4, 4)."""
        here = np.linalg.inv(T_world_camera)
        middle = self.squares[own][:3, 3]
        near = {k: here @ T for k, T in self.squares.items() if np.linalg.norm(T[:3, 3] - middle) < AROUND}
        return {k: T for k, T in near.items() if T[2, 3] > NEAREST and T[2, 2] < 0}

    def nearest(self, T_world_camera: np.ndarray) -> int:
        """Index of the square nearest the optical axis, of those before the camera."""
        here = np.linalg.inv(T_world_camera)
        seen = {k: here @ T for k, T in self.squares.items()}
        off = {k: np.hypot(*_pierced(T)) for k, T in seen.items() if T[2, 3] > NEAREST and T[2, 2] < 0}
        return min(off, key=lambda k: off[k])

    def in_view(self, T_world_camera: np.ndarray, own: int, intrinsics: np.ndarray) -> int:
        """Count the square's own fiducials that are wholly in view, if no other square is nearer the optical axis."""
        seen = self.seen(T_world_camera, own)
        if own not in seen:
            return 0
        off = {k: np.hypot(*_pierced(T)) for k, T in seen.items()}
        if any(off[k] < off[own] + SIDE / 10 for k in off if k != own):
            return 0
        T = seen[own]
        corners = fiducial_corners().reshape(-1, 2)
        pixels = project(corners @ T[:3, :2].T + T[:3, 3], intrinsics)
        inside = np.all((pixels > MARGIN) & (pixels < [self.width - 1 - MARGIN, self.height - 1 - MARGIN]), axis=1)
        return int(inside.reshape(-1, 4).all(axis=1).sum())


def _pierced(T_camera_square: np.ndarray) -> np.ndarray:
    """Where the optical axis meets a square, in its frame, (2,), [m]."""
    T = np.linalg.inv(T_camera_square)
    return np.asarray(T[:2, 3] - T[:2, 2] * T[2, 3] / T[2, 2])


def photograph(
    T_world_camera: np.ndarray, own: int, optics: Optics, head: Head, rng: np.random.Generator, noise: float = NOISE
) -> tuple[bytes, np.ndarray]:
    """Take one shot.

    Args:
        T_world_camera: Shape (4, 4).
        own: Index of the square nearest the optical axis.
        optics: The camera's size and the squares.
        head: As it really is.
        rng: Of light, blur and noise.
        noise: Standard deviation, [grey levels].

    Returns:
        The image as JPEG, and the ranges, shape (S,), [m].
    """
    seen = optics.seen(T_world_camera, own)
    right, down = rng.uniform(-LIGHT, LIGHT, 2)
    scene = Scene(light=(float(right), float(down)), blur=float(rng.uniform(*BLUR)), noise=noise)
    image = render(seen, head.intrinsics, optics.width, optics.height, scene, rng)
    content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    return content.tobytes(), read_sonars(seen[own], head, rng)


def read_sonars(T_camera_square: np.ndarray, head: Head, rng: np.random.Generator) -> np.ndarray:
    """Read the ranges to a square's plane, shape (S,), [m]."""
    h, _ = predict_ranges(T_camera_square, head.positions, head.measures)
    return np.asarray((1.0 + head.scale) * h + head.bias + head.std * rng.standard_normal(len(h)))
