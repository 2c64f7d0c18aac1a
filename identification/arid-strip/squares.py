"""Where the calibration squares hang: three strips of 28, each bent along the inside of the payload bay door.

    python identification/arid-strip/squares.py      # writes squares.csv beside itself

The world is the Orbiter's frame: x along the rail, so that base z = Orbiter x, base x = -Orbiter y, base y = -Orbiter z.
Squares follow each other along their own y; their z points at the arm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from aridcal.jobs.head1992.doty1992 import ORBITER_TO_BASE
from aridcal.jobs.head1992.square import SQUARE_SIDE, STRIP_SQUARES

STATIONS = (2.0, 8.5, 15.0)  # along the rail, [m]
RADIUS = 1.75  # of the door, [m]
FIRST, LAST = np.array([1.15, 2.35]), np.array([-1.08, 1.16])  # ends of a strip in the base's x and y, about there, [m]


def strip() -> np.ndarray:
    """T_base_square of one strip at the rail's zero, shape (28, 4, 4)."""
    turn = SQUARE_SIDE / RADIUS
    middle, chord = (FIRST + LAST) / 2, (LAST - FIRST) / np.linalg.norm(LAST - FIRST)
    outward = np.array([-chord[1], chord[0]])
    outward *= np.sign(outward @ middle)
    centre = middle + (0.27 - RADIUS) * outward
    T = np.tile(np.eye(4), (STRIP_SQUARES, 1, 1))
    for k in range(STRIP_SQUARES):
        angle = (k - (STRIP_SQUARES - 1) / 2) * turn
        out = np.cos(angle) * outward + np.sin(angle) * chord
        z, y = np.array([*-out, 0.0]), np.array([*(np.cos(angle) * chord - np.sin(angle) * outward), 0.0])
        T[k, :3, :3] = np.column_stack([np.cross(y, z), y, z])
        T[k, :2, 3] = centre + RADIUS * out
    return T


def main() -> None:
    """Write the table."""
    rows = []
    for station in STATIONS:
        for T in strip():
            R, p = ORBITER_TO_BASE.T @ T[:3, :3], ORBITER_TO_BASE.T @ (T[:3, 3] + [0, 0, station])
            quaternion = Rotation.from_matrix(R).as_quat(canonical=True)
            rows.append([len(rows), *np.round(p, 6), *np.round(quaternion, 9)])
    columns = ["index", "x", "y", "z", "qx", "qy", "qz", "qw"]
    path = Path(__file__).parent / "squares.csv"
    pd.DataFrame(rows, columns=columns).to_csv(path, index=False)


if __name__ == "__main__":
    main()
