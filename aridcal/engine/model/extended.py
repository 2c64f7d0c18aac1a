"""The extended Pinocchio model: every component that a coefficient moves is one more joint of the robot.

Pinocchio's own forward kinematics and Jacobians then give poses and columns, exact at any size of a correction. With P the
nominal placement of a joint, M its motion, C and D the corrections in axes of frames and of links:

    T_parent_joint = P C(constants) C(effects) M(q) D(link)      revolute: the bearing moves, and does not turn along
    T_parent_joint = P C(constants) M(q) C(effects) D(link)      prismatic: the carriage moves, where it is now

Where the path climbs it goes by the inverse, factor by factor from the last: the same corrections, the other way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import mul
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import LINK_COMPONENTS, Coefficient
from aridcal.engine.model.joint_motions import Motion, joint_model, motion, rank, transform
from aridcal.engine.model.many_rows import LEAST_TOGETHER, JointArrays, MovingFrame, stepped, twists, walk_joints
from aridcal.engine.robot.chain import FixedJoint, Joint, Robot
from aridcal.engine.robot.doty import Link, doty_links, segments
from aridcal.engine.robot.kinematics import carried_bodies

# C(x, y, z, roll, pitch, yaw) = Tx Ty Tz Rz(yaw) Ry(pitch) Rx(roll): exactly URDF's xyz and rpy.
COMPONENT_ORDER = ("x", "y", "z", "yaw", "pitch", "roll")

# Doty's link parameters as motions of frame components.
LINK_AXES = {"d": "z", "theta": "yaw", "beta": "pitch", "a": "x", "alpha": "roll"}

MOST_JOINTS = 128
"""Joints up to which an extended model is one Pinocchio model: an arm of seven has a hundred, with all that a search tries. Its
workspace grows with their cube: 0.1 GB for these, 3 GB for the 430 of an arm of sixty axes."""

JOINTS_OF_A_SEGMENT = 48
"""Joints of each part of a longer one, whose workspaces take 5 MB."""

Group = Literal["constant", "effect", "link", "own"]


class Slot(NamedTuple):
    """One joint of the extended model.

    Attributes:
        where: A joint of the chain, the tip's fixed joint, ``world_base`` or ``tip_target``.
        group: A constant or an effect in axes of a frame, a correction of a link, or the robot's own motion.
        component: The one that moves; empty for the robot's own motion.
    """

    where: str
    group: Group
    component: str

    @property
    def name(self) -> str:
        """Name of the Pinocchio joint; the robot's own joints keep theirs."""
        return self.where if self.group == "own" else ".".join(self)


class PlacedJoint(NamedTuple):
    """A joint of the extended model: where it stands on the one before, which it is, how it moves."""

    placement: pin.SE3
    slot: Slot
    motion: Motion


class ChainStep(NamedTuple):
    """A step from base to tip: a fixed placement, then a joint of the extended model or the end of an origin.

    Attributes:
        placement: From the step before.
        slot: The joint; None where a joint's own ``<origin>`` ends.
        motion: Of that joint.
        origin: Name of the joint whose ``<origin>`` ends here; empty where there is a joint instead.
        before: Fixed joints between the origin that ended last and this one.
        climbs: True where the path goes through this origin upwards.
    """

    placement: pin.SE3
    slot: Slot | None = None
    motion: Motion | None = None
    origin: str = ""
    before: pin.SE3 = pin.SE3.Identity()
    climbs: bool = False


def robot_slot(name: str) -> Slot:
    """A joint of the robot itself."""
    return Slot(name, "own", "")


def slot_of(c: Coefficient) -> Slot:
    """The joint that carries a coefficient; a frame's constants and its effects share theirs."""
    if c.component in LINK_COMPONENTS:
        return Slot(c.where, "link", c.component)
    frame = c.where in ("world_base", "tip_target")
    return Slot(c.where, "constant" if c.basis.constant or frame else "effect", c.component)


def frame_slots(where: str, needed: Sequence[Slot]) -> list[Slot]:
    """The joints that move a frame, in the order of C."""
    every = [Slot(where, "constant", component) for component in COMPONENT_ORDER]
    return [slot for slot in every if slot in needed]


def chain_steps(robot: Robot, links: Sequence[Link], needed: Sequence[Slot]) -> list[ChainStep]:
    """Walk from base to tip.

    Args:
        robot: The nominal chain.
        links: Its link model; may be empty if no link is corrected.
        needed: The joints wanted beside the robot's own, each once.
    """
    corrected = {slot.where for slot in needed if slot.group == "link"}
    link_after = {link.joint: link for link in links if link.joint in corrected}
    steps: list[ChainStep] = []
    placement = before = pin.SE3.Identity()
    groups: dict[tuple[str, Group], list[Slot]] = {}
    for slot in needed:
        groups.setdefault((slot.where, slot.group), []).append(slot)

    def put(joints: Sequence[tuple[Slot, Motion]]) -> None:
        nonlocal placement
        for slot, move in joints:
            steps.append(ChainStep(placement, slot, move))
            placement = pin.SE3.Identity()

    def end_of_origin(name: str, climbs: bool = False) -> None:
        nonlocal placement, before
        steps.append(ChainStep(placement, origin=name, before=before, climbs=climbs))
        placement = before = pin.SE3.Identity()

    def cross(fixed: Sequence[FixedJoint]) -> None:
        nonlocal placement, before
        for each in fixed:
            constants = _sorted(groups.get((each.name, "constant"), ()), None)
            step = each.origin.inverse() if each.climbs else each.origin
            if not constants:
                placement, before = placement * step, before * step
            elif each.climbs:
                put(_backwards(constants))
                placement = placement * step
                end_of_origin(each.name, climbs=True)
            else:
                placement = placement * step
                put(constants)
                end_of_origin(each.name)

    after: pin.SE3 | None = None
    for joint, fixed in zip(robot.joints, robot.fixed, strict=False):
        constants = _sorted(groups.get((joint.name, "constant"), ()), joint)
        effects = _sorted(groups.get((joint.name, "effect"), ()), joint)
        own_motion = [(robot_slot(joint.name), motion("axis", joint))]
        moves = own_motion + effects if joint.kind == "prismatic" else effects + own_motion
        if after is None:
            cross(fixed)
            placement = placement if joint.climbs else placement * joint.origin
        else:  # the link's parameters have brought it there
            placement, before = placement * after, joint.before
        if joint.climbs:
            put(_backwards(moves))
            put(_backwards(constants))
            placement = placement * joint.origin.inverse()
            end_of_origin(joint.name, climbs=True)
            continue
        put(constants)
        end_of_origin(joint.name)
        put(moves)
        after = None
        if joint.name in link_after:
            parts, after = segments(link_after[joint.name])
            for component, ahead in parts:
                placement = placement * ahead
                slot = Slot(joint.name, "link", component)
                put([(slot, motion(LINK_AXES[component]))] if slot in needed else [])
    if after is None:
        cross(robot.fixed[-1])
        end_of_origin("")
        return steps
    placement, before = placement * after, robot.tip_before
    put(_sorted(groups.get((robot.tip_joint or "", "constant"), ()), None))
    end_of_origin(robot.tip_joint or "")
    return steps


def _backwards(motions: Sequence[tuple[Slot, Motion]]) -> list[tuple[Slot, Motion]]:
    """The inverse of some motions one after the other: each the other way, the last one first."""
    return [(slot, (-vector, turns)) for slot, (vector, turns) in reversed(motions)]


def _sorted(group: Sequence[Slot], joint: Joint | None) -> list[tuple[Slot, Motion]]:
    """A group of joints at one place with their motions, in the order of C; joints of one rank by their names."""
    in_order = sorted(group, key=lambda slot: (rank(slot.component, joint), slot.component))
    return [(slot, motion(slot.component, joint)) for slot in in_order]


class Segment(NamedTuple):
    """A stretch of an extended model's joints, as a Pinocchio model of its own.

    Attributes:
        columns: Its coordinates among those of the whole.
        model: Its joints, the first one placed where the stretch before ends.
        data: Pinocchio's workspace.
    """

    columns: slice
    model: pin.Model
    data: pin.Data


@dataclass(frozen=True)
class ExtendedModel:
    """Robot, frames and one more joint for each component that some coefficients move.

    Attributes:
        robot: The nominal chain.
        coefficients: K of them.
        world_base: Starts of T_world_base, one or one for each station.
        tip_target: Starts of T_tip_target, likewise.
    """

    robot: Robot
    coefficients: tuple[Coefficient, ...]
    world_base: tuple[pin.SE3, ...]
    tip_target: tuple[pin.SE3, ...]

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """The joint that carries each coefficient, K of them; several may share one."""
        return tuple(slot_of(c) for c in self.coefficients)

    @cached_property
    def chain(self) -> list[ChainStep]:
        """From base to tip, without the frames at either end."""
        return chain_steps(self.robot, self.links, self._needed)

    @cached_property
    def links(self) -> tuple[Link, ...]:
        """Doty's link model, if a coefficient corrects a link; else empty."""
        return doty_links(self.robot) if any(slot.group == "link" for slot in self.slots) else ()

    @cached_property
    def index(self) -> dict[Slot, int]:
        """Which coordinate of the extended model each joint has: every one of them has one."""
        first, last = (frame_slots(where, self._needed) for where in ("world_base", "tip_target"))
        inner = [step.slot for step in self.chain if step.slot is not None]
        return {slot: k for k, slot in enumerate([*first, *inner, *last])}

    @cached_property
    def carrier(self) -> np.ndarray:
        """Coordinate that each coefficient moves, shape (K,)."""
        return np.array([self.index[slot] for slot in self.slots], dtype=int)

    @cached_property
    def own(self) -> list[int]:
        """Coordinate of each joint of the robot itself."""
        return [self.index[robot_slot(name)] for name in self.robot.names]

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """The chain in parts; an ordinary arm is one part."""
        joints, _ = self._joints(pin.SE3.Identity(), pin.SE3.Identity())
        parts = []
        for first in range(0, len(joints), self._size):
            model = pin.Model()
            for placement, slot, move in joints[first : first + self._size]:
                model.addJoint(model.njoints - 1, joint_model(move), placement, slot.name)
            parts.append(Segment(slice(first, first + model.nv), model, model.createData()))
        return tuple(parts)

    def poses(self, q: np.ndarray, world: int, tip: int) -> tuple[np.ndarray, np.ndarray]:
        """Target poses for one pair of frames: rotations (n, 3, 3) and positions (n, 3), [m].

        Args:
            q: Coordinates of all joints, shape (n, nv).
            world: Index of the frame to use.
            tip: Likewise.
        """
        if len(q) >= LEAST_TOGETHER:
            return self._poses_together(q, world, tip)[1:]
        return self._row_by_row(q, world, tip, None)

    def jacobian(self, q: np.ndarray, world: int, tip: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The poses, and the twist of the target that each joint causes, in world axes, shape (n, 6, nv)."""
        if len(q) >= LEAST_TOGETHER:
            frames, R, p = self._poses_together(q, world, tip)
            return R, p, twists(frames, p)
        wide = np.empty((len(q), 6, q.shape[1]))
        R, p = self._row_by_row(q, world, tip, wide)
        wide[:, :3] += np.cross(wide[:, 3:], p[:, :, None], axis=1)  # of the target, no longer of the world's origin
        return R, p, wide

    def _row_by_row(
        self, q: np.ndarray, world: int, tip: int, wide: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses by Pinocchio; if given, ``wide`` becomes the twists of the world's origin."""
        placements, end = self._ends(world, tip)
        for k, placement in placements.items():
            number, place = divmod(k, self._size)
            self.segments[number].model.jointPlacements[place + 1] = placement
        R, p = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
        for columns, model, data in self.segments:
            coordinates, first = q[:, columns], columns.start == 0
            last = data.oMi[model.njoints - 1]
            rotation, translation, twists_of_joints = last.rotation, last.translation, data.J
            turn, shift = (R, p) if first else (np.empty_like(R), np.empty_like(p))
            J = None if wide is None else wide[:, :, columns]
            for i in range(len(q)):
                if J is None:
                    pin.forwardKinematics(model, data, coordinates[i])
                else:
                    pin.computeJointJacobians(model, data, coordinates[i])
                    J[i] = twists_of_joints
                turn[i], shift[i] = rotation, translation
            if not first:
                if J is not None:
                    # From the end of the segments before to the world: v = R v + p x R w, w = R w.
                    J[:, :3], J[:, 3:] = R @ J[:, :3], R @ J[:, 3:]
                    J[:, :3] += np.cross(p[:, :, None], J[:, 3:], axis=1)
                R, p = R @ turn, p + (R @ shift[:, :, None])[:, :, 0]
        return R @ end.rotation, p + R @ end.translation

    def locked(self, value: Mapping[Slot, float], moving: set[Slot], world: int, tip: int) -> tuple[pin.Model, pin.SE3]:
        """The model with few joints left, bodies included, and the target's placement on its last joint.

        Args:
            value: Where joints are locked; those that are not named, at zero.
            moving: Joints that stay.
            world: Index of the frame to use.
            tip: Likewise.
        """
        joints, end = self._joints(self.world_base[world], self.tip_target[tip])
        bodies = self._bodies()
        model, parent, pending = pin.Model(), 0, pin.SE3.Identity()
        for placement, slot, move in joints:
            pending = pending * placement
            if slot in moving:
                parent, pending = model.addJoint(parent, joint_model(move), pending, slot.name), pin.SE3.Identity()
            else:
                pending = pending * transform(move, value.get(slot, 0.0))
            if slot in bodies:
                model.appendBodyToJoint(parent, bodies[slot], pending)
        return model, pending * end

    def _bodies(self) -> dict[Slot, pin.Inertia]:
        """The body that hangs on each joint: a carriage's own effects carry its body, too. None of a path that climbs.

        There a body would hang on the joint before its own.
        """
        if self.robot.climbs:
            return {}
        bodies, carrier, joint = carried_bodies(self.robot), {}, ""
        for step in self.chain:
            if step.slot is None:
                continue
            if step.slot.group == "own":
                joint = step.slot.where
            if joint and (step.slot.group == "own" or (step.slot.where, step.slot.group) == (joint, "effect")):
                carrier[joint] = step.slot
        return {slot: bodies[name] for name, slot in carrier.items()}

    def _joints(self, world_base: pin.SE3, tip_target: pin.SE3) -> tuple[list[PlacedJoint], pin.SE3]:
        """Every joint with its placement on the one before, in the order of ``index``, and the target's on the last."""
        joints: list[PlacedJoint] = []
        pending = world_base

        def add(slot: Slot, move: Motion) -> None:
            nonlocal pending
            joints.append(PlacedJoint(pending, slot, move))
            pending = pin.SE3.Identity()

        for slot in frame_slots("world_base", self._needed):
            add(slot, motion(slot.component))
        for step in self.chain:
            pending = pending * step.placement
            if step.slot is not None and step.motion is not None:
                add(step.slot, step.motion)
        pending = pending * tip_target
        for slot in frame_slots("tip_target", self._needed):
            add(slot, motion(slot.component))
        return joints, pending

    def _poses_together(self, q: np.ndarray, world: int, tip: int) -> tuple[list[MovingFrame], np.ndarray, np.ndarray]:
        """The frames that move, and poses, all rows walked at once with one pair of frames."""
        placements, end = self._ends(world, tip)
        for k, placement in placements.items():
            self._stepped.placement[k] = placement.homogeneous
        return walk_joints(self._stepped, q, end.homogeneous)

    def _ends(self, world: int, tip: int) -> tuple[dict[int, pin.SE3], pin.SE3]:
        """Placements that one pair of frames gives to joints, by their coordinates, and that of the target on the last one.

        Frames differ in two placements alone: thousands of stations need no model each.
        """
        before, after, tip_joints = self._end_placements
        first, end = self.world_base[world] * before, after * self.tip_target[tip]
        return ({0: first, len(self.index) - tip_joints: end}, pin.SE3.Identity()) if tip_joints else ({0: first}, end)

    @cached_property
    def _end_placements(self) -> tuple[pin.SE3, pin.SE3, int]:
        """From the base's frame to the first joint, from the last one to the tip's, and how many joints hold the tip."""
        inner = [k for k, step in enumerate(self.chain) if step.slot is not None]
        first = 0 if frame_slots("world_base", self._needed) else inner[0] + 1
        before, after = (
            reduce(mul, [step.placement for step in part], pin.SE3.Identity())
            for part in (self.chain[:first], self.chain[inner[-1] + 1 :])
        )
        return before, after, len(frame_slots("tip_target", self._needed))

    @cached_property
    def _stepped(self) -> JointArrays:
        """All joints of the extended model as arrays."""
        joints, _ = self._joints(pin.SE3.Identity(), pin.SE3.Identity())
        return stepped([(placement, move) for placement, _, move in joints])

    @property
    def _size(self) -> int:
        """Joints of a segment."""
        return MOST_JOINTS if len(self.index) <= MOST_JOINTS else JOINTS_OF_A_SEGMENT

    @cached_property
    def _needed(self) -> tuple[Slot, ...]:
        return tuple(dict.fromkeys(self.slots))
