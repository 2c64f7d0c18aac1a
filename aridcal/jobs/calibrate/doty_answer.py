"""The closed-form answer of Doty (1992) (its sections 3.3 and 8, corrected) on the poses of a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.fit.closed_form import tip_poses
from aridcal.engine.fit.constants import stage_urdf
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.instruments.pose import residuals
from aridcal.engine.robot.chain import chain_in_urdf
from aridcal.engine.robot.doty1992 import link_table, links_from_poses, pose
from aridcal.engine.rows.dataset import Dataset


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
