"""Starts from a closed form, for robots whose link parameters have one."""

from __future__ import annotations

import numpy as np

from aridcal.engine.corrections.effect import LINK_COMPONENTS
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.model.model import Model
from aridcal.engine.robot.doty1992 import link_table, links_from_poses
from aridcal.engine.rows.dataset import Dataset


def closed_form_starts(fit: Fit, rows: Dataset) -> list[np.ndarray]:
    """Starts of a fit with link parameters from a closed form, shape (K,) each; none where the robot has no such form.

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
