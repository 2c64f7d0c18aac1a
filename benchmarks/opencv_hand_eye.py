"""OpenCV's hand-eye methods, in a process of their own: run by ``hand_eye.py`` in an environment that still has them.

OpenCV 5 has no Python bindings of ``calibrateHandEye``. Standard input is one JSON line a draw: ``R`` (n, 3, 3) and ``p`` (n, 3)
of the nominal tip in the base, ``corners`` (m, 3) of the board, ``pixels`` (n, m, 2), ``lens`` fx fy cx cy and distortion.
Standard output is one line each: T_tip_camera (4, 4) by the name of the method.
"""

from __future__ import annotations

import json
import sys

import cv2
import numpy as np

HAND_EYE = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
WORLD_HAND_EYE = ("SHAH", "LI")


def places(R: np.ndarray, p: np.ndarray, corners: np.ndarray, pixels: np.ndarray, lens: list[float]) -> dict[str, list]:
    """T_tip_camera of each method."""
    fx, fy, cx, cy, *distortion = lens
    K, bent = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.array(distortion)
    turns, moves = [], []
    for image in pixels:
        _, r, t = cv2.solvePnP(corners, image, K, bent, flags=cv2.SOLVEPNP_IPPE)
        r, t = cv2.solvePnPRefineLM(corners, image, K, bent, r, t)
        turns.append(cv2.Rodrigues(r)[0])
        moves.append(t)
    calibrate, calibrate_world = (getattr(cv2, name) for name in ("calibrateHandEye", "calibrateRobotWorldHandEye"))
    found = {}
    for name in HAND_EYE:
        method = getattr(cv2, f"CALIB_HAND_EYE_{name}")
        turn, move = calibrate(list(R), list(p[:, :, None]), turns, moves, method=method)
        found[name] = _matrix(turn, move)
    back = np.swapaxes(R, 1, 2)
    base_in_tip = -np.einsum("nij,nj->ni", back, p)[:, :, None]
    for name in WORLD_HAND_EYE:
        method = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{name}")
        *_, turn, move = calibrate_world(turns, moves, list(back), list(base_in_tip), method=method)
        found[name] = np.linalg.inv(_matrix(turn, move))
    return {name: T.tolist() for name, T in found.items()}


def _matrix(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.ravel(t)
    return T


for line in sys.stdin:
    given = json.loads(line)
    R, p, corners, pixels = (np.array(given[name]) for name in ("R", "p", "corners", "pixels"))
    print(json.dumps(places(R, p, corners, pixels, given["lens"])), flush=True)
