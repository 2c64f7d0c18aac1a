"""A second arm, in plain NumPy: kinematics, gravity's pull and least squares that share nothing with aridcal's.

A URDF is read as XML, a chain is a product of 4 x 4 matrices, derivatives are differences, and what noise does to a fit
is solved once, linearised at the truth. ``tests/repository/test_attacks.py`` compares it with Pinocchio.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

STEP = 1e-6
"""Of the differences, [m] and [rad]: their error, STEP^2, and that of rounding, 1e-16 / STEP, are below 1e-9 of a column."""

ALIKE = 1e-7
"""Singular value over the largest below which a direction counts as one that the rows cannot show: differences make
directions that are the same differ by about 1e-10, and the poorest that rows can show are above 1e-5."""

Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Arm:
    """A chain.

    Attributes:
        names: Of its J joints.
        turns: Which of them turn, shape (J,) bool.
        axes: Unit vector of each in its own frame, shape (J, 3).
        origins: Place of each frame in that of the joint before at rest, shape (J, 4, 4).
        end: Of the tip in the last joint's frame, shape (4, 4).
        travel: Lowest and highest reading of each, shape (J, 2), [rad] or [m].
        masses: Mass [kg] and its centre in the joint's own frame [m] of each link, shape (J, 4).
        gravity: In the base's frame, shape (3,), [m/s^2].
        urdf: Its text.
        tip: Name of the last link.
    """

    names: tuple[str, ...]
    turns: np.ndarray
    axes: np.ndarray
    origins: np.ndarray
    end: np.ndarray
    travel: np.ndarray
    masses: np.ndarray
    gravity: np.ndarray
    urdf: str
    tip: str

    def frames(self, q: np.ndarray, off: np.ndarray | None = None) -> np.ndarray:
        """Frame of each joint, after its motion, and of the tip in the base's, shape (J + 1, N, 4, 4).

        Args:
            q: Readings, shape (N, J).
            off: Error of each joint's place as a twist in its own frame (linear, angular), shape (J, 6), [m] and [rad].
        """
        T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        found = []
        for k, axis in enumerate(self.axes):
            place = self.origins[k] if off is None else self.origins[k] @ small(off[k])
            move = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
            if self.turns[k]:
                move[:, :3, :3] = Rotation.from_rotvec(q[:, k : k + 1] * axis).as_matrix()
            else:
                move[:, :3, 3] = q[:, k : k + 1] * axis
            T = T @ place @ move
            found.append(T)
        return np.stack([*found, T @ self.end])

    def target(self, q: np.ndarray, world: np.ndarray, tool: np.ndarray, off: np.ndarray) -> Pose:
        """Rotation (N, 3, 3) and position (N, 3) of the target in the world.

        Args:
            q: Readings, shape (N, J).
            world: T_world_base, shape (4, 4), or one for each row, (N, 4, 4).
            tool: T_tip_target, the same.
            off: As :meth:`frames` has it.
        """
        T = world @ self.frames(q, off)[-1] @ tool
        return T[:, :3, :3], T[:, :3, 3]

    def pull(self, q: np.ndarray, payload: np.ndarray, lever: np.ndarray) -> np.ndarray:
        """Torque (force) of gravity about (along) each joint's axis, the way it pulls, shape (N, J), [N m] or [N].

        Args:
            q: Readings, shape (N, J).
            payload: [kg], shape (N,), held at the target.
            lever: The target in the tip's frame, shape (3,), [m].
        """
        T = self.frames(q)
        heavy = [(self.masses[k, 0], T[k, :, :3, :3] @ self.masses[k, 1:] + T[k, :, :3, 3]) for k in range(len(T) - 1)]
        held = T[-1, :, :3, :3] @ lever + T[-1, :, :3, 3]
        found = np.zeros_like(q)
        for k, axis in enumerate(self.axes):
            about = T[k, :, :3, :3] @ axis
            for mass, centre in [*heavy[k:], (payload[:, None], held)]:
                force = np.broadcast_to(mass * self.gravity, centre.shape)
                push = np.cross(centre - T[k, :, :3, 3], force) if self.turns[k] else force
                found[:, k] += np.einsum("ni,ni->n", about, push)
        return found


def small(twist: np.ndarray) -> np.ndarray:
    """Motion of a twist (linear, angular), shape (..., 6), as a shift and then a turn, shape (..., 4, 4)."""
    T = np.zeros((*twist.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(twist[..., 3:].reshape(-1, 3)).as_matrix().reshape(*twist.shape[:-1], 3, 3)
    T[..., :3, 3] = twist[..., :3]
    T[..., 3, 3] = 1.0
    return T


def read_arm(urdf: str, tip: str, gravity: tuple[float, float, float], most: float = np.inf) -> Arm:
    """Read a URDF's chain from its root to a link; no joint turns further than ``most`` to either side, [rad]."""
    root = ET.fromstring(urdf)
    joints = {_link(joint, "child"): joint for joint in root.iter("joint")}
    links = {link.get("name"): link for link in root.iter("link")}
    chain, link = [], tip
    while link in joints:
        chain.append(joints[link])
        link = _link(joints[link], "parent")
    names, turns, axes, origins, travel, masses = [], [], [], [], [], []
    before = np.eye(4)
    for joint in reversed(chain):
        before = before @ _place(joint.find("origin"))
        if joint.get("type") == "fixed":
            continue
        limit = joint.find("limit")
        names.append(str(joint.get("name")))
        turns.append(joint.get("type") != "prismatic")
        axes.append(_numbers(joint.find("axis"), "xyz", "1 0 0"))
        origins.append(before)
        before = np.eye(4)
        low, high = (float(limit.get(end, "0")) if limit is not None else 0.0 for end in ("lower", "upper"))
        travel.append((max(low, -most), min(high, most)) if turns[-1] else (low, high))
        inertial = links[_link(joint, "child")].find("inertial")
        mass = inertial.find("mass") if inertial is not None else None
        centre = _place(inertial.find("origin"))[:3, 3] if inertial is not None else np.zeros(3)
        masses.append([float(mass.get("value", "0")) if mass is not None else 0.0, *centre])
    direction = np.array(axes)
    return Arm(
        tuple(names), np.array(turns), direction / np.linalg.norm(direction, axis=1, keepdims=True), np.array(origins),
        before, np.array(travel), np.array(masses), np.array(gravity), urdf, tip,
    )  # fmt: skip


def _link(joint: ET.Element, end: str) -> str:
    """Name of a joint's parent or child link."""
    found = joint.find(end)
    return "" if found is None else str(found.get("link"))


def _numbers(element: ET.Element | None, key: str, default: str) -> np.ndarray:
    return np.array([float(v) for v in (default if element is None else element.get(key, default)).split()])


def _place(origin: ET.Element | None) -> np.ndarray:
    """A URDF's ``<origin>`` as a matrix: fixed axes, first roll, then pitch, then yaw."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0")).as_matrix()
    T[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return T


# -- errors and their least squares


def misses(there: Pose, here: Pose, pose: bool) -> np.ndarray:
    """How far poses are off others, world axes, shape (N, 6) or, of positions, (N, 3), [m] and [rad]."""
    position = there[1] - here[1]
    if not pose:
        return position
    turn = Rotation.from_matrix(there[0] @ np.swapaxes(here[0], 1, 2)).as_rotvec()
    return np.hstack([position, turn])


def derivatives(
    arm: Arm, q: np.ndarray, world: np.ndarray, tool: np.ndarray, off: np.ndarray, pose: bool
) -> np.ndarray:
    """What both frames and every joint's place do to the target, shape (N, m, 12 + 6 J); all in their own axes."""
    found = []
    for step in STEP * np.eye(12 + off.size):
        there, here = (
            arm.target(q, world @ small(sign * step[:6]), tool @ small(sign * step[6:12]), off + sign * step[12:].reshape(-1, 6))
            for sign in (1.0, -1.0)
        )  # fmt: skip
        found.append(misses(there, here, pose) / (2.0 * STEP))
    return np.stack(found, axis=2)


def answer(seen: np.ndarray, asked: np.ndarray, error: np.ndarray) -> np.ndarray:
    """What a least squares fit predicts wrongly, in sigma.

    Args:
        seen: Derivatives of the fitted rows in units of sigma, shape (numbers, unknowns).
        asked: Those of the configurations asked for, in units of sigma there, shape (others, unknowns).
        error: Measured minus true of the fitted rows, in sigma, shape (numbers,).

    Returns:
        Predicted minus true, shape (others,).
    """
    size = np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    return np.asarray(asked / size @ np.linalg.lstsq(seen / size, error, rcond=ALIKE)[0])


def curve_answer(
    seen: np.ndarray, asked: np.ndarray, error: np.ndarray, curve: tuple[np.ndarray, np.ndarray],
    moved: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:  # fmt: skip
    """The same with a smooth curve beside: its knots are drawn alike, from a spread that the rows themselves tell best.

    Args:
        seen: As in :func:`answer`.
        asked: As in :func:`answer`.
        error: As in :func:`answer`.
        curve: Derivatives by the knots, of the fitted rows and of those asked for.
        moved: What the true curve does, to both, in sigma.
    """
    size = np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    U, s, _ = np.linalg.svd(seen / size, full_matrices=False)
    U = U[:, s > ALIKE * s[0]]
    B, y = curve[0] - U @ (U.T @ curve[0]), error + moved[0]
    y = y - U @ (U.T @ y)
    V, w, Wt = np.linalg.svd(B, full_matrices=False)
    along = V.T @ y
    spreads = np.geomspace(1e-3, 1e3, 61) / max(w[0], 1e-300)

    def misfit(spread: float) -> float:
        grown = 1.0 + (spread * w) ** 2
        return float(np.log(grown).sum() + (along**2 / grown).sum())

    best = min(spreads, key=misfit)
    knots = Wt.T @ (w / (w**2 + best**-2) * along)
    rest = error + moved[0] - curve[0] @ knots
    return answer(seen, asked, rest) + curve[1] @ knots - moved[1]
