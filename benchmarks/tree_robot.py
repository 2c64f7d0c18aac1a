"""Arms on one torso, as they were built, and where their links are: Pinocchio's model, nothing of the product; for `trees.py`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

ARM = (
    ("0 0 1", "0 {side} 0.35"),
    ("1 0 0", "0 {near} 0"),
    ("0 0 1", "0 {near} 0"),
    ("0 1 0", "0.30 0 0.02"),
    ("1 0 0", "0.05 0 0"),
    ("0 1 0", "0.28 0 0.02"),
    ("1 0 0", "0.08 0.01 0"),
)
"""Axis and origin of each joint of a 7R arm; `side` is where its shoulder stands, `near` a short step to the same side."""

HEAD = (("0 0 1", "0.05 0 0.6"), ("0 1 0", "0.02 0 0.1"))
BUILT = 1e-3
"""[m] and [rad], 1 sigma: of origins as built."""

RANGE = 1.1
"""[rad] to either side of zero."""


def urdf(arms: Sequence[str] = ("left", "right"), more: int = 0) -> bytes:
    """The nominal robot: arms of 7 + `more` joints, and a head of two joints that carries a camera."""
    parts = ['<?xml version="1.0"?>', '<robot name="tree"><link name="torso"/>']

    def hung(name: str, joint: str, parent: str, xyz: str, axis: str = "", rpy: str = "0 0 0") -> None:
        moves = f'<axis xyz="{axis}"/><limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>' if axis else ""
        parts.append(
            f'<link name="{name}"><inertial><mass value="2"/><origin xyz="0.1 0 0.02"/><inertia ixx="0.01" iyy="0.01" '
            f'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{joint}" type="{"revolute" if axis else "fixed"}"><parent link="{parent}"/><child link="{name}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/>{moves}</joint>'
        )

    for number, arm in enumerate(arms):
        out = (0.25 + 0.3 * (number // 2)) * (1 if number % 2 == 0 else -1)
        parent = "torso"
        for k in range(7 + more):
            axis, xyz = ARM[k % 7] if k < 7 else (ARM[k % 7][0], "0.06 0.01 0")
            hung(f"{arm}_{k + 1}", f"{arm}_j{k + 1}", parent, xyz.format(side=out, near=0.05 * np.sign(out)), axis)
            parent = f"{arm}_{k + 1}"
        hung(f"{arm}_hand", f"{arm}_mount", parent, "0.1 0 0")
    for k, ((axis, xyz), name) in enumerate(zip(HEAD, ("neck", "head"), strict=True)):
        hung(name, ("pan", "nod")[k], ("torso", "neck")[k], xyz, axis)
    hung("camera", "camera_mount", "head", "0.08 0 0.05", rpy="-1.9 0 -1.57")
    return "\n".join([*parts, "</robot>"]).encode()


AXES = {"JointModelRX": (1.0, 0.0, 0.0), "JointModelRY": (0.0, 1.0, 0.0), "JointModelRZ": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Poses:
    """Poses of N rows: rotations (N, 3, 3) and places (N, 3), or one of all rows, (3, 3) and (3,)."""

    R: np.ndarray
    p: np.ndarray

    def __matmul__(self, other: Poses) -> Poses:
        return Poses(self.R @ other.R, self.act(other.p))

    def __getitem__(self, rows: np.ndarray) -> Poses:
        return Poses(self.R[rows], self.p[rows])

    def act(self, points: np.ndarray) -> np.ndarray:
        """Points of these frames, (N, 3) or (3,), in the frame that these poses are in, (N, 3)."""
        return np.asarray((self.R @ points[..., None])[..., 0] + self.p)

    def inverse(self) -> Poses:
        """The other way round."""
        back = np.swapaxes(self.R, -1, -2)
        return Poses(back, -(back @ self.p[..., None])[..., 0])


def fixed(T: pin.SE3) -> Poses:
    """One pose of all rows."""
    return Poses(T.rotation, T.translation)


def placed(v: np.ndarray) -> Poses:
    """One pose of all rows, from its translation and rotation vector."""
    return Poses(pin.exp3(v[3:]), v[:3])


@dataclass(frozen=True)
class Effect:
    """What one joint does beside its geometry: the joint turns by `size` times the basis.

    Attributes:
        kind: As the product calls it.
        joint: Its name.
        size: Coefficient, [rad] per unit of the basis.
        order: Of a harmonic.
        phase: Of a harmonic, [rad].
    """

    kind: str
    joint: str
    size: float = 1.0
    order: int = 1
    phase: float = 0.0

    def turns(self, robot: Robot, q: np.ndarray) -> np.ndarray:
        """What is added to the joint in rows of joint positions, shape (N,), [rad]."""
        at = robot.joints.index(self.joint)
        if self.kind == "joint_compliance":
            data = robot.nominal.createData()
            torque = [pin.computeGeneralizedGravity(robot.nominal, data, row)[at] for row in q]
            return -self.size * np.array(torque)
        if self.kind == "joint_gain":
            return self.size * q[:, at]
        return self.size * np.sin(self.order * q[:, at] + self.phase)


@dataclass(frozen=True)
class Robot:
    """A robot of the nominal model whose origins are moved, and which may have one effect.

    Attributes:
        nominal: Pinocchio's, of the URDF.
        moved: What follows each nominal origin, of joints and then of links that are fixed to them, as translation and
            rotation vector, shape (joints + ends, 6).
        effects: Of its joints.
    """

    nominal: pin.Model
    moved: np.ndarray
    effects: tuple[Effect, ...] = ()

    @property
    def joints(self) -> list[str]:
        """Names of the joints, in Pinocchio's order."""
        return list(self.nominal.names)[1:]

    @property
    def ends(self) -> list[str]:
        """Links that are fixed to others: hands and the camera."""
        return [frame.name for frame in self.nominal.frames if frame.name.endswith(("_hand", "camera"))]

    def places(self, q: np.ndarray, links: Sequence[str]) -> dict[str, Poses]:
        """Where links are in the torso's frame, in rows of joint positions (N, joints)."""
        model, still = self.nominal, [pin.SE3(pin.exp3(step[3:]), step[:3]) for step in self.moved]
        turned = q.copy()
        for effect in self.effects:
            turned[:, self.joints.index(effect.joint)] += effect.turns(self, q)
        n = len(q)
        at = {0: Poses(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)))}

        def joint(number: int) -> Poses:
            if number not in at:
                before = joint(model.parents[number])
                own = turned[:, number - 1]
                about = np.array(AXES[model.joints[number].shortname()])
                turn = Rotation.from_rotvec(own[:, None] * about).as_matrix()
                placed = before @ fixed(model.jointPlacements[number] * still[number - 1])
                at[number] = placed @ Poses(turn, np.zeros((n, 3)))
            return at[number]

        ends, found = self.ends, {}
        for link in links:
            frame = model.frames[model.getFrameId(link)]
            step = still[len(self.joints) + ends.index(link)] if link in ends else pin.SE3.Identity()
            found[link] = joint(frame.parentJoint) @ fixed(frame.placement * step)
        return found


def built(seed: int, text: bytes) -> Robot:
    """A robot with the errors of its making."""
    robot = Robot(pin.buildModelFromXML(text.decode()), np.zeros((0, 6)))
    count = len(robot.joints) + len(robot.ends)
    return replace(robot, moved=np.random.default_rng([seed, 1]).normal(0, BUILT, (count, 6)))


def reached(
    robot: Robot, q: np.ndarray, off: Callable[[Robot, np.ndarray, np.ndarray], np.ndarray], joints: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions near those given at which something is zero, by Gauss and Newton row by row.

    Args:
        robot: As built.
        q: Starts, shape (N, joints).
        off: What is to be zero of rows with these numbers, (robot, q, numbers) -> (N, m).
        joints: Those that may move.

    Returns:
        The positions, and which rows got there within the range of the joints, shape (N,) bool.
    """
    own = [robot.joints.index(name) for name in joints]
    q, every = q.copy(), np.arange(len(q))
    for _ in range(8):
        now = off(robot, q, every)
        J = np.empty((*now.shape, len(own)))
        for column, k in enumerate(own):
            step = q.copy()
            step[:, k] += 1e-6
            J[:, :, column] = (off(robot, step, every) - now) / 1e-6
        q[:, own] -= np.einsum("njm,nm->nj", np.linalg.pinv(J, rcond=1e-3), now)
        q[:, own] = np.clip(q[:, own], -1.4, 1.4)
    left = np.linalg.norm(off(robot, q, every), axis=1)
    return q, left < 1e-9


def with_errors(robot: Robot, moved: np.ndarray, effects: tuple[Effect, ...]) -> Robot:
    """The same robot as another set of numbers has it."""
    return replace(robot, moved=moved.reshape(-1, 6), effects=effects)


def turned_by(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Rotation vectors from one set of rotation matrices to another, world axes, shape (N, 3), [rad]."""
    return Rotation.from_matrix(one @ np.swapaxes(other, 1, 2)).as_rotvec()
