"""The calibration square and the strip of squares: geometry as data, shared by printer, simulator and detector.

Square frame: origin at the centre fiducial, x right, y up along its long side, z out of the paper (Doty 1992, sections 5.1 and
7.4). Doty (1992) numbers the fiducials p1 to p6 in raster order of the upright square; p1, the corner marker, has no printed
place: (-1.75, +1.75) in follows from symmetry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

# [m]
INCH = 0.0254

# Side of a square, and the pitch of a strip, [m].
SQUARE_SIDE = 4 * INCH

STRIP_SQUARES = 28

# Centres of p1 to p6 in the square frame, shape (6, 2), [m].
FIDUCIAL_CENTRES = INCH * np.array([[-1.75, 1.75], [0, 1.75], [-1.75, 0], [0, 0], [1.75, 0], [0, -1.75]])

# Width and height of p1 to p6, shape (6, 2), [m].
FIDUCIAL_SIZES = INCH * np.array([[0.25, 0.25], [0.25, 0.25], [0.25, 0.25], [0.25, 0.5], [0.25, 0.25], [0.25, 0.25]])

CORNER_MARKER, CENTRE_FIDUCIAL = 1, 4
N_FIDUCIALS = len(FIDUCIAL_CENTRES)

# Corners of a rectangle of size one around its centre, clockwise as seen, shape (4, 2).
UNIT_CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])

# Which segments each digit lights: from the top clockwise, the middle one last.
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
_DIGIT_PITCH = 1.4  # from digit to digit, in widths of a digit
_BAR = 0.2  # thickness of a segment, likewise
# x, y, width and height of each segment, likewise
_BARS = np.array([[0, 0.8, 1, _BAR], [0.4, 0.4, _BAR, 0.6], [0.4, -0.4, _BAR, 0.6], [0, -0.8, 1, _BAR],
                  [-0.4, -0.4, _BAR, 0.6], [-0.4, 0.4, _BAR, 0.6], [0, 0, 0.6, _BAR]])  # fmt: skip
_DIGIT_WIDTH = 0.1 * INCH
_DIGITS_AT = INCH * np.array([0.875, -0.875])  # no turn of the square brings a fiducial here


def fiducial_corners() -> np.ndarray:
    """Return the corners of p1..p6, clockwise as seen, in the square frame, shape (6, 4, 2), [m]."""
    return FIDUCIAL_CENTRES[:, None] + FIDUCIAL_SIZES[:, None] * UNIT_CORNERS


def paper_corners() -> np.ndarray:
    """Return the corners of the square's own paper, shape (4, 2), [m]."""
    return SQUARE_SIDE * UNIT_CORNERS


def index_corners(index: int) -> np.ndarray:
    """Return the bars that print a square's index as seven-segment digits, shape (M, 4, 2), [m]."""
    text = str(index)
    bars = []
    for k, digit in enumerate(text):
        to_the_right = _DIGIT_PITCH * (k - (len(text) - 1) / 2)
        lit = np.array(list(_SEGMENTS[int(digit)])) == "1"
        bars.append(_BARS[lit] + [to_the_right, 0, 0, 0])
    middles, sizes = np.split(_DIGIT_WIDTH * np.concatenate(bars), 2, axis=1)
    return _DIGITS_AT + middles[:, None] + sizes[:, None] * UNIT_CORNERS


def strip_placements(n: int = STRIP_SQUARES) -> np.ndarray:
    """Return T_first_square of each square of a flat strip: stacked along +y, shape (n, 4, 4)."""
    T_first_square = np.tile(np.eye(4), (n, 1, 1))
    T_first_square[:, 1, 3] = SQUARE_SIDE * np.arange(n)
    return T_first_square


@dataclass(frozen=True)
class FiducialLayout:
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

    def __getitem__(self, which: np.ndarray) -> FiducialLayout:
        """Select fiducials."""
        return FiducialLayout(*(getattr(self, f.name)[which] for f in fields(self)))

    @property
    def corners(self) -> np.ndarray:
        """Corners of each fiducial, shape (M, 4, 3), [m]."""
        flat = self.sizes[:, None] * UNIT_CORNERS
        return self.centres[:, None] + flat @ self.axes

    @property
    def is_centre(self) -> np.ndarray:
        """Which of them are centre fiducials, shape (M,)."""
        return self.fiducial == CENTRE_FIDUCIAL


# [m] Two squares to either side of one: all that a camera near enough to measure has in view.
LAYOUT_REACH = 2.5 * SQUARE_SIDE


def layout(squares: Mapping[int, np.ndarray], square: int, reach: float = LAYOUT_REACH) -> FiducialLayout:
    """Collect the fiducials of a square, first, and of those whose centres lie within reach of its centre.

    Args:
        squares: T_world_square of each known square, (4, 4).
        square: Index of the square in whose frame the answer is given.
        reach: [m].

    Returns:
        Six fiducials per square.
    """
    T_own_world = np.linalg.inv(squares[square])
    T_own_square = {k: T_own_world @ T for k, T in squares.items()}
    near = [k for k, T in T_own_square.items() if np.linalg.norm(T[:3, 3]) <= reach]
    names = sorted(near, key=lambda k: (k != square, k))
    xy_axes = np.array([T_own_square[k][:3, :2] for k in names])  # (S, 3, 2)
    origins = np.array([T_own_square[k][:3, 3] for k in names])
    centres = origins[:, None] + np.einsum("sij,fj->sfi", xy_axes, FIDUCIAL_CENTRES)
    axes = np.swapaxes(xy_axes, 1, 2)
    numbers = np.arange(1, N_FIDUCIALS + 1)
    return FiducialLayout(
        square=np.repeat(names, N_FIDUCIALS),
        fiducial=np.tile(numbers, len(names)),
        centres=centres.reshape(-1, 3),
        axes=np.repeat(axes, N_FIDUCIALS, axis=0),
        sizes=np.tile(FIDUCIAL_SIZES, (len(names), 1)),
    )


# A square alone, in its own frame.
ONE_SQUARE = layout({0: np.eye(4)}, 0)
