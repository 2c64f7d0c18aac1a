"""The calibration square and the strip of squares: geometry as data, shared by printer, simulator and detector.

Square frame: origin at the centre fiducial, x right, y up along its long side, z out of the paper (report, sections 5.1 and
7.4). The report numbers the fiducials p1 to p6 in raster order of the upright square; p1, the corner marker, has no printed
place: (-1.75, +1.75) in follows from symmetry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

INCH = 0.0254
SIDE = 4 * INCH  # of a square, and the pitch of a strip
STRIP_SQUARES = 28
CENTRES = INCH * np.array([[-1.75, 1.75], [0, 1.75], [-1.75, 0], [0, 0], [1.75, 0], [0, -1.75]])
SIZES = INCH * np.array([[0.25, 0.25], [0.25, 0.25], [0.25, 0.25], [0.25, 0.5], [0.25, 0.25], [0.25, 0.25]])
CORNER_MARKER, CENTRE_FIDUCIAL = 1, 4
N_FIDUCIALS = len(CENTRES)
UNIT = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])

# Segments of each digit, from the top clockwise, the middle one last; bars in units of the digit's width.
_SEGMENTS = (
    "1111110",
    "0110000",
    "1101101",
    "1111001",
    "0110011",
    "1011011",
    "1011111",
    "1110000",
    "1111111",
    "1111011",
)
_BAR = 0.2
_BARS = np.array([[0, 0.8, 1, _BAR], [0.4, 0.4, _BAR, 0.6], [0.4, -0.4, _BAR, 0.6], [0, -0.8, 1, _BAR],
                  [-0.4, -0.4, _BAR, 0.6], [-0.4, 0.4, _BAR, 0.6], [0, 0, 0.6, _BAR]])  # fmt: skip
_DIGIT_WIDTH = 0.1 * INCH
_DIGITS_AT = INCH * np.array([0.875, -0.875])  # no turn of the square brings a fiducial here


def fiducial_corners() -> np.ndarray:
    """Return the corners of p1..p6, clockwise as seen, in the square frame, shape (6, 4, 2), [m]."""
    return CENTRES[:, None] + SIZES[:, None] * UNIT


def paper_corners() -> np.ndarray:
    """Return the corners of the square's own paper, shape (4, 2), [m]."""
    return SIDE * UNIT


def index_corners(index: int) -> np.ndarray:
    """Return the bars that print a square's index as seven-segment digits, shape (M, 4, 2), [m]."""
    text = str(index)
    bars = [
        bar + [1.4 * (k - (len(text) - 1) / 2), 0, 0, 0]
        for k, digit in enumerate(text)
        for bar, lit in zip(_BARS, _SEGMENTS[int(digit)], strict=True)
        if lit == "1"
    ]
    middle, size = np.split(_DIGIT_WIDTH * np.array(bars), 2, axis=1)
    return _DIGITS_AT + middle[:, None] + size[:, None] * UNIT


def strip_placements(n: int = STRIP_SQUARES) -> np.ndarray:
    """Return T_first_square of each square of a flat strip: stacked along +y, shape (n, 4, 4)."""
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 1, 3] = SIDE * np.arange(n)
    return T


@dataclass(frozen=True)
class Layout:
    """The fiducials that may be in view around one square, in that square's frame.

    Attributes:
        square: Index of the square that each fiducial belongs to, shape (M,).
        fiducial: Its number, 1 to 6, shape (M,).
        centres: Its centre, shape (M, 3), [m].
        axes: Unit vectors along its width and its height, shape (M, 2, 3).
        sizes: Width and height, shape (M, 2), [m].
    """

    square: np.ndarray
    fiducial: np.ndarray
    centres: np.ndarray
    axes: np.ndarray
    sizes: np.ndarray

    def __len__(self) -> int:
        """Count the fiducials."""
        return len(self.square)

    def __getitem__(self, which: np.ndarray) -> Layout:
        """Select fiducials."""
        return Layout(*(getattr(self, f.name)[which] for f in fields(self)))

    @property
    def corners(self) -> np.ndarray:
        """Corners of each fiducial, shape (M, 4, 3), [m]."""
        return self.centres[:, None] + (self.sizes[:, None] * UNIT) @ self.axes

    @property
    def is_centre(self) -> np.ndarray:
        """Which of them are centre fiducials, shape (M,)."""
        return self.fiducial == CENTRE_FIDUCIAL


def layout(squares: Mapping[int, np.ndarray], own: int, reach: float = 2.5 * SIDE) -> Layout:
    """Collect the fiducials of a square, first, and of those whose centres lie within reach of its centre.

    Args:
        squares: T_world_square of each known square, (4, 4).
        own: Index of the square in whose frame the answer is given.
        reach: [m].

    Returns:
        Six fiducials per square.
    """
    inverse = np.linalg.inv(squares[own])
    near = {k: inverse @ T for k, T in squares.items()}
    names = sorted((k for k, T in near.items() if np.linalg.norm(T[:3, 3]) <= reach), key=lambda k: (k != own, k))
    R, t = np.array([near[k][:3, :2] for k in names]), np.array([near[k][:3, 3] for k in names])
    return Layout(
        square=np.repeat(names, N_FIDUCIALS),
        fiducial=np.tile(np.arange(1, N_FIDUCIALS + 1), len(names)),
        centres=(t[:, None] + np.einsum("sij,fj->sfi", R, CENTRES)).reshape(-1, 3),
        axes=np.repeat(np.swapaxes(R, 1, 2), N_FIDUCIALS, axis=0),
        sizes=np.tile(SIZES, (len(names), 1)),
    )


ONE_SQUARE = layout({0: np.eye(4)}, 0)
