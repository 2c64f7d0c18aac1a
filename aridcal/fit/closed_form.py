"""The closed-form answer of Doty (1992) (its sections 3.3 and 8, corrected) on the poses of a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.effects.effect import LINK_COMPONENTS
from aridcal.errors import NotIdentifiable
from aridcal.fit.constants import stage_urdf
from aridcal.fit.least_squares import Fit
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.pose import residuals
from aridcal.model.model import Model
from aridcal.robot.chain import Robot, same_chain
from aridcal.robot.doty import doty_links
from aridcal.robot.doty1992 import pose, start

KINDS = ("prismatic", "revolute", "revolute", "revolute")
"""Of the joints of the ARID."""


@dataclass(frozen=True)
class ClosedForm:
    """The closed-form answer of Doty (1992), beside the full one.

    Attributes:
        nominal: ``d theta beta a alpha`` of each link, shape (4, 5), [m] and [rad].
        links: Likewise, from the closed form.
        full: Likewise, of the geometric stage.
        residual: What the closed form leaves of all rows, shape (N, 6), [m] and [rad].
    """

    nominal: np.ndarray
    links: np.ndarray
    full: np.ndarray
    residual: np.ndarray


def closed_form(geometric: Fit, rows: Dataset, used: np.ndarray) -> ClosedForm | None:
    """Solve for the links as Doty (1992) does: lengths and offsets from x and y, then psi from the matrix E.

    Doty (1992) takes base and camera as known: here they are where the geometric stage has them.

    Args:
        geometric: The geometric stage.
        rows: N measured poses.
        used: Those to solve from, shape (N,) bool; Doty (1992) wants two, three are needed, all are taken.

    Returns:
        Its links beside those of the full solution; None for an arm of another build, or with poses too much alike.
    """
    model = geometric.model
    robot = model.robot
    if rows.rotation is None or not is_arid(robot) or len(model.world_base) + len(model.tip_target) > 2:
        return None
    base, target = (frames[0][1].homogeneous for frames in (model.world_base, model.tip_target))
    ends, q = _ends(model, rows), robot.positions(rows.readings)
    try:
        links = start(ends[used], q[used])
    except NotIdentifiable:
        return None
    calibrated = same_chain(robot, stage_urdf(geometric))
    predicted = base @ pose(links, q) @ target
    left = residuals(predicted[:, :3, :3], predicted[:, :3, 3], rows.position, rows.rotation)
    return ClosedForm(_link_table(robot), links, _link_table(calibrated), left)


def closed_form_starts(found: Fit, rows: Dataset) -> list[np.ndarray]:
    """Coefficients that the closed form gives, for an arm of the ARID's build and its own parameters; else none.

    Args:
        found: A fit that has link parameters among its K coefficients.
        rows: N measured poses.

    Returns:
        One start of shape (K,), or none.
    """
    robot = found.model.robot
    wanted = [(k, c) for k, c in enumerate(found.model.coefficients) if c.component in LINK_COMPONENTS]
    if not wanted or rows.rotation is None or not is_arid(robot):
        return []
    try:
        links = start(_ends(found.model, rows), robot.positions(rows.readings))
    except NotIdentifiable:
        return []
    nominal = _link_table(robot)
    theta = found.theta.copy()
    for k, c in wanted:
        joint, column = robot.names.index(c.where), LINK_COMPONENTS.index(c.component)
        theta[k] = links[joint, column] - nominal[joint, column]
    return [theta]


def _ends(model: Model, rows: Dataset) -> np.ndarray:
    """T_base_tip of each measured pose with the model's first frames taken as known, shape (N, 4, 4)."""
    base, target = (frames[0][1].homogeneous for frames in (model.world_base, model.tip_target))
    T = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = rows.rotation, rows.position
    return np.asarray(np.linalg.inv(base) @ T @ np.linalg.inv(target))


def _link_table(robot: Robot) -> np.ndarray:
    """``d theta beta a alpha`` of each link, shape (links, 5); d is the joint's own travel, so its offset is 0."""
    return np.array([[0.0, link.theta, link.beta, link.a, link.alpha] for link in doty_links(robot)])


def is_arid(robot: Robot) -> bool:
    """A rail and three revolute joints, all parallel, frames as in Doty (1992)."""
    if tuple(joint.kind for joint in robot.joints) != KINDS:
        return False
    along_z = all(np.allclose(joint.axis, [0, 0, 1]) for joint in robot.joints)
    return along_z and not robot.climbs and all(np.allclose(step.rotation, np.eye(3)) for step in robot.onward[:-1])
