"""The closed-form answer of the report of 1992 (its sections 3.3 and 8, corrected) on the poses of a calibration."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.doty import doty_links
from aridcal.errors import NotIdentifiable
from aridcal.export import stage_urdf
from aridcal.geometry import is_arid
from aridcal.measurements import Measurements
from aridcal.outcome import ClosedForm
from aridcal.report1992 import pose, start
from aridcal.residual import Observations, residuals
from aridcal.robot import parse_robot
from aridcal.solver import Fit


def closed_form(geometric: Fit, rows: Measurements, used: np.ndarray) -> ClosedForm | None:
    """Solve for the links as the report does: lengths and offsets from x and y, then psi from the matrix E.

    The report takes base and camera as known: here they are where the geometric stage has them.

    Args:
        geometric: The geometric stage.
        rows: N measured poses.
        used: Those to solve from, shape (N,) bool; the report wants two, three are needed, all are taken.

    Returns:
        Its links beside those of the full solution; None for an arm of another build, or with poses too much alike.
    """
    model = geometric.model
    robot = model.robot
    if rows.quaternion is None or not is_arid(robot) or len(model.world_base) + len(model.tip_target) > 2:
        return None
    base, target = (frames[0][1].homogeneous for frames in (model.world_base, model.tip_target))
    measured = Observations(rows.position, Rotation.from_quat(rows.quaternion).as_matrix())
    T = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = measured.rotation, measured.position
    ends, q = np.linalg.inv(base) @ T @ np.linalg.inv(target), robot.positions(rows.readings)
    try:
        links = start(ends[used], q[used])
    except NotIdentifiable:
        return None
    calibrated = parse_robot(stage_urdf(geometric), robot.tip, robot.base, robot.path)
    nominal, full = (
        np.array([[0.0, link.theta, link.beta, link.a, link.alpha] for link in doty_links(r)])
        for r in (robot, calibrated)
    )
    predicted = base @ pose(links, q) @ target
    return ClosedForm(nominal, links, full, residuals(predicted[:, :3, :3], predicted[:, :3, 3], measured))
