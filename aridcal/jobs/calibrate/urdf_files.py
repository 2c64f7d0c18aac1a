"""Writing of URDFs: the user's own file with a model's constants, once it predicts what the model predicts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect import MOUNTING_FRAMES
from aridcal.engine.fit.constants import is_zero, origins_of, urdf_of
from aridcal.engine.model.model import Model
from aridcal.engine.robot.mjcf import compiled
from aridcal.engine.robot.read_back import (
    COMPARED_CONFIGURATIONS,
    READ_BACK_TOLERANCE,
    Fault,
    ReadBackError,
    link_places,
    read_back,
)
from aridcal.engine.robot.splice_mjcf import splice_mjcf
from aridcal.engine.robot.tree import read_tree


def write_urdf(file: Path, model: Model, theta: np.ndarray) -> tuple[str, ...]:
    """Write a model's constants as URDF.

    Args:
        file: Path of the URDF to write.
        model: Its constants and zeros of joints go into the file; frames and effects do not.
        theta: Its coefficients, shape (K,).

    Returns:
        Notices on parts of the user's own file that a reader cannot read.

    Raises:
        NotReadBack: the file does not say what the model says; nothing is written.
    """
    origins = origins_of(model, theta)
    urdf = urdf_of(model, theta)
    notices = read_back(urdf, model.robot, origins, file.name)
    _check_tips(file.name, model, theta, origins)
    file.write_bytes(urdf)
    return notices


def write_calibrated(folder: Path, model: Model, theta: np.ndarray) -> tuple[str, ...]:
    """Write `calibrated.urdf`, and `calibrated.xml` of a robot that was read from MJCF; see :func:`write_urdf`."""
    notices = write_urdf(folder / "calibrated.urdf", model, theta)
    robot = model.robot
    if robot.mjcf is None:
        return notices
    (folder / "calibrated.xml").write_bytes(splice_mjcf(robot, origins_of(model, theta)))
    return (*notices, *(f"{robot.path.name}: {remark}" for remark in compiled(robot.mjcf, robot.path).remarks))


def _check_tips(file: str, model: Model, theta: np.ndarray, origins: Mapping[str, pin.SE3]) -> None:
    """Make sure that the new origins put the end of every limb where the model's own kinematics have it.

    Raises:
        NotReadBack: naming the link.
    """
    robot = model.robot
    tree = read_tree(robot.urdf, robot.path, robot.stated)
    readings = np.random.default_rng(0).uniform(-1.0, 1.0, (COMPARED_CONFIGURATIONS, len(robot.readings)))
    moved = dict(zip(robot.names, robot.positions(readings).T, strict=True))
    places = link_places(tree, {name: np.zeros(COMPARED_CONFIGURATIONS) for name in tree.moves} | moved, origins)
    constant = [c.where not in MOUNTING_FRAMES and (c.basis.constant or is_zero(c, robot)) for c in model.coefficients]
    for limb in robot.limbs:
        joints = {*limb.names, *(fixed.name for gap in limb.fixed for fixed in gap)}
        of_limb = [k for k, c in enumerate(model.coefficients) if constant[k] and c.where in joints]
        arm = Model(limb, tuple(model.coefficients[k] for k in of_limb))
        R, p = arm.poses(theta[of_limb], arm.rows(readings[:, robot.columns_of(limb)]))
        T = np.linalg.inv(places[limb.base]) @ places[limb.tip]
        off = max(float(np.abs(T[:, :3, :3] - R).max()), float(np.abs(T[:, :3, 3] - p).max()))
        if not off <= READ_BACK_TOLERANCE * max(1.0, float(np.abs(p).max())):
            fault = Fault(f"has link {limb.tip!r} elsewhere, by {off:.2g} m or rad", limb.tip)
            raise ReadBackError(file, "the model", fault)
