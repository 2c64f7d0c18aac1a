"""The closed form of Doty (1992) (its sections 3.3 and 8, corrected) on poses: a start of the fit, and an answer beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.corrections.effect import LINK_COMPONENTS
from aridcal.engine.fit.constants import stage_urdf
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.instruments.pose import residuals
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import chain_in_urdf
from aridcal.engine.rows.dataset import Dataset
from aridcal.jobs.head1992.doty1992 import link_table, links_from_poses, pose


@dataclass(frozen=True)
class ClosedForm:
    """The closed-form answer of Doty (1992), beside the full one.

    Attributes:
        nominal: ``d theta beta a alpha`` of each link, shape (4, 5), [m] and [rad].
        links: Likewise, from the closed form.
        full: Likewise, of the geometric stage.
        residual: Measured minus predicted of all rows by the closed form, shape (N, 6), [m] and [rad].
    """

    nominal: np.ndarray
    links: np.ndarray
    full: np.ndarray
    residual: np.ndarray


def closed_form(geometric: Fit, rows: Dataset, some: np.ndarray) -> ClosedForm | None:
    """Solve for the links as Doty (1992) does: lengths and offsets from x and y, then psi from the matrix E.

    Doty (1992) takes base and camera as known: here they are where the geometric stage has them.

    Args:
        geometric: The geometric stage.
        rows: N measured poses.
        some: Rows to solve from, shape (N,) bool; Doty (1992) wants two, three are needed, all are taken.

    Returns:
        Its links beside those of the full solution; None for an arm of another build, or with poses too much alike.
    """
    model, robot = geometric.model, geometric.model.robot
    if rows.rotation is None or len(model.world_base) + len(model.tip_target) > 2:
        return None
    links = links_from_poses(robot, tip_poses(model, rows)[some], rows.readings[some])
    if links is None:
        return None
    base, target = (frames[0][1].homogeneous for frames in (model.world_base, model.tip_target))
    predicted = base @ pose(links, robot.positions(rows.readings)) @ target
    residual = residuals(predicted[:, :3, :3], predicted[:, :3, 3], rows.position, rows.rotation)
    return ClosedForm(link_table(robot), links, link_table(chain_in_urdf(robot, stage_urdf(geometric))), residual)


def closed_form_starts(fit: Fit, rows: Dataset) -> list[np.ndarray]:
    """Starts of a fit with link parameters from the closed form, shape (K,) each; none where the robot has no such form.

    Args:
        fit: K coefficients; the others stay as they are.
        rows: N measured poses.
    """
    robot = fit.model.robot
    of_links = [(k, c) for k, c in enumerate(fit.model.coefficients) if c.component in LINK_COMPONENTS]
    if not of_links or rows.rotation is None:
        return []
    links = links_from_poses(robot, tip_poses(fit.model, rows), rows.readings)
    if links is None:
        return []
    change, theta = links - link_table(robot), fit.theta.copy()
    for k, c in of_links:
        theta[k] = change[robot.names.index(c.where), LINK_COMPONENTS.index(c.component)]
    return [theta]


def tip_poses(model: Model, rows: Dataset) -> np.ndarray:
    """T_base_tip of each measured pose with the model's first frames taken as known, shape (N, 4, 4)."""
    base, target = (frames[0][1].homogeneous for frames in (model.world_base, model.tip_target))
    T = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = rows.rotation, rows.position
    return np.asarray(np.linalg.inv(base) @ T @ np.linalg.inv(target))
