"""Which constants of a robot and its frames are to be identified, and a URDF with their identified values."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.question import EndFrame, Question
from aridcal.engine.instruments.setup import TIP
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.doty import doty_links
from aridcal.engine.robot.splice import origin_texts, splice_origins
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.errors import RobotError


def frame_coefficients(question: Question, labels: tuple[str, ...], data: Dataset) -> tuple[Coefficient, ...]:
    """Unknowns of the frames that are to be identified: world_base, tip_target, then those of cameras and boards."""
    unknowns = []
    for where, frame in (("world_base", question.world_base), ("tip_target", question.tip_target)):
        if frame.unknown and (where == "tip_target" or has_world(data)):
            frames = frame_labels(where, frame, labels, data)
            known_targets = {name for name, target in question.targets.items() if not target.unknown}
            frames = (
                frames if where == "world_base" else tuple(s for s in frames if s != TIP and s not in known_targets)
            )
            unknowns += [Coefficient(where, c, station=s) for s in frames for c in FRAME_COMPONENTS]
    if not measures_target(data):
        unknowns = [c for c in unknowns if c.where != "tip_target"]
    for things in data.instruments.things.values():
        if not things.role.many:
            pairs = np.argwhere(things.free).tolist()
            unknowns += [Coefficient(things.names[k], things.role.components[c]) for k, c in pairs]
    return tuple(unknowns)


def constants_of_question(question: Question, robot: Robot, data: Dataset) -> tuple[Coefficient, ...]:
    """All constants that are to be identified: unknown frames, then the robot's."""
    labels = station_labels(question, data)
    return frame_coefficients(question, labels, data) + constants(robot, question.constants)


def frame_labels(where: str, frame: EndFrame, labels: tuple[str, ...], data: Dataset) -> tuple[str | None, ...]:
    """Labels of the frames at one end of the chain: stations, targets, or none where one frame serves all rows."""
    if frame.by_station:
        return labels
    if where == "tip_target" and data.labels.target is not None:
        return tuple(sorted({str(t) for t in data.labels.target}))
    return (None,)


def has_world(data: Dataset) -> bool:
    """True if a place or the vertical is known or measured in the world frame; otherwise world and base frame are one."""
    return data.instruments.world or any(block.traits.places or block.traits.level for block in data.blocks)


def measures_target(data: Dataset) -> bool:
    """True if a target on the tip is measured; cameras see the tip itself."""
    return not all(block.traits.bare for block in data.blocks)


def constants(robot: Robot, parameter_set: str) -> tuple[Coefficient, ...]:
    """Candidate constants of a parameter set, those to be kept before others first (FORMATS section 4)."""
    if parameter_set == "none":
        return ()
    if parameter_set == "full":
        coefficients = []
        for joint in robot.joints:
            along = {c: abs(float(joint.axis[k % 3])) for k, c in enumerate(FRAME_COMPONENTS)}
            ordered = sorted(FRAME_COMPONENTS, key=lambda c: -round(along[c], 9))
            coefficients += [Coefficient(joint.name, c) for c in ordered]
        ends = dict.fromkeys(limb.tip_joint for limb in robot.limbs if limb.tip_joint)
        return (*coefficients, *(Coefficient(end, c) for end in ends for c in FRAME_COMPONENTS))
    if robot.others:
        raise RobotError(
            f"parameters.set: {parameter_set}: the report's link parameters are those of one chain, and rows take paths to "
            f"{', '.join(limb.tip for limb in robot.limbs)}. Write `full`"
        )
    if robot.climbs:
        raise RobotError(
            f"parameters.set: {parameter_set}: the report's link parameters are those of a chain from its base outwards, and "
            f"joints move {robot.base!r} here. Write `full`"
        )
    coefficients = []
    for joint, link in zip(robot.joints, doty_links(robot), strict=True):
        if link.next_origin is None:
            continue  # nothing in the URDF could hold it: it is the target's frame
        components = ["d"] if joint.kind == "prismatic" else []
        components += ["a", "alpha"] if link.singular else ["theta", "beta", "a", "alpha"]
        next_components = ["yaw", "pitch"] if link.singular else []
        if parameter_set == "angles":
            components, next_components = (
                [c for c in components if c in ("beta", "alpha")],
                [c for c in next_components if c == "pitch"],
            )
        coefficients += [Coefficient(joint.name, c) for c in components]
        coefficients += [Coefficient(link.next_origin, c) for c in next_components]
    return tuple(coefficients)


def unused_links(robot: Robot, parameter_set: str) -> list[str]:
    """Sentences on where Doty's link model is singular or has no place in the URDF."""
    if parameter_set not in ("doty", "angles"):
        return []
    sentences = []
    for link in doty_links(robot):
        if link.next_origin is None:
            sentences.append(f"{link.joint} ends in the tip link itself: its link parameters are those of tip_target")
        elif link.singular:
            sentences.append(
                f"{link.joint} and the next axis meet (a < 1 mm), where theta and beta are undefined: "
                f"{link.next_origin}.yaw and .pitch take their place"
            )
    return sentences


def station_labels(question: Question, data: Dataset) -> tuple[str, ...]:
    """All stations, sorted, where a frame is one for each of them; else none. Rows from link to link may have none."""
    if data.labels.station is None or not question.by_station:
        return ()
    return tuple(sorted({str(s) for s in data.labels.station} - {""}))


def stage_urdf(fit: Fit) -> bytes:
    """The user's URDF with a fit's constants folded into the joints' own origins."""
    return urdf_of(fit.model, fit.theta)


def urdf_of(model: Model, theta: np.ndarray) -> bytes:
    """The user's URDF with a model's constants folded into the joints' own origins, zeros of joints included."""
    urdf = model.robot.urdf
    return splice_origins(urdf, origin_texts(urdf, origins_of(model, theta)))


def origins_of(model: Model, theta: np.ndarray) -> dict[str, pin.SE3]:
    """The ``<origin>`` of each joint that a model's constants or a joint's zero move."""
    robot = model.robot
    origins = dict(model.origins(theta))
    for k, c in enumerate(model.coefficients):
        if is_zero(c, robot):
            joint = robot.joint(c.where)
            slides = joint.kind == "prismatic"
            turn = np.eye(3) if slides else pin.AngleAxis(float(theta[k]), joint.axis).matrix()
            shift = float(theta[k]) * joint.axis if slides else np.zeros(3)
            origins[joint.name] = origins.get(joint.name, joint.origin) * pin.SE3(turn, shift)
    return origins


def is_zero(c: Coefficient, robot: Robot) -> bool:
    """True of the zero of a joint: a motion of its own that is the same in all rows."""
    return c.component == "axis" and c.basis.form == "ones" and c.where in robot.names
