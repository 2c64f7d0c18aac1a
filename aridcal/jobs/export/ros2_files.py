"""Files that ROS 2 takes as they are: a launch with its transforms, offsets of joints, a node that corrects trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import pinocchio as pin
import yaml
from lxml import etree

from aridcal.engine.robot.kinematics import link_frame
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.export.calibrated_tree import CalibratedTree

WORLD, TARGET = "calibration_world", "calibration_target"
"""Frames of the measurements, by names that no robot's own links have."""


def static_transforms(saved: SavedModel, tree: CalibratedTree) -> tuple[list[dict[str, Any]], list[str]]:
    """Where the base stands in the world of the measurements, and the target on the tip, as `calibrated.urdf` goes with them.

    A frame of TF has one parent, so the world is the parent of the URDF's root.

    Returns:
        Transforms as plain data, xyz [m] and quaternion (xyzw); and what is left out, in words.
    """
    model, theta = saved.geometric.model, saved.geometric.theta
    world, tip = (frames[0] for frames in model.frames(theta))
    robot, remarks, transforms = model.robot, [], []
    base = link_frame(robot, robot.base)
    if base.parentJoint:
        remarks.append(f"{WORLD} is left out: joints move {robot.base!r}, which the measurements are referred to")
    else:
        transforms.append(_transform(WORLD, tree.root, world[1] * _in_root(tree, robot.base).inverse()))
    transforms.append(_transform(robot.tip, TARGET, tip[1]))
    labels = [label for label, _ in (world, tip) if label is not None]
    if labels:
        remarks.append(f"of several frames those of {' and '.join(map(repr, labels))}")
    return transforms, remarks


def _in_root(tree: CalibratedTree, link: str) -> pin.SE3:
    """Where a link stands that no joint moves."""
    T, above = pin.SE3.Identity(), tree.tree.parent_of
    while link in above:
        link, joint = above[link]
        T = tree.tree.origins[joint.get("name", "")] * T
    return T


def _transform(parent: str, child: str, T: pin.SE3) -> dict[str, Any]:
    quaternion = pin.Quaternion(T.rotation).coeffs().tolist()
    return {"parent": parent, "child": child, "xyz": T.translation.tolist(), "quaternion": quaternion}


def transforms_text(transforms: list[dict[str, Any]], about: list[str]) -> str:
    """The file that the launch reads."""
    return "".join(f"# {line}\n" for line in about) + yaml.safe_dump(
        {"transforms": transforms}, sort_keys=False, width=200
    )


def transmissions(offsets: Mapping[str, float], about: list[str]) -> str:
    """Offsets of joints for ros2_control: a `SimpleTransmission` each, which adds its offset to what the actuator reads.

    Args:
        offsets: What is to be added to each joint's reading, [rad] or [m].
        about: What the file says of itself, a line each.
    """
    root = etree.Element("ros2_control", name="joint_offsets", type="system")
    root.append(etree.Comment("\n  " + "\n  ".join(about) + "\n"))
    for name, offset in offsets.items():
        transmission = etree.SubElement(root, "transmission", name=f"{name}_transmission")
        etree.SubElement(transmission, "plugin").text = "transmission_interface/SimpleTransmission"
        etree.SubElement(transmission, "actuator", name=f"{name}_actuator", role="actuator1")
        joint = etree.SubElement(transmission, "joint", name=name, role="joint1")
        etree.SubElement(joint, "mechanical_reduction").text = "1.0"
        etree.SubElement(joint, "offset").text = repr(float(offset))
    etree.indent(root)
    return etree.tostring(root, encoding="unicode") + "\n"


def asset(name: str, export: str, mark: str) -> str:
    """A text that goes with an export: the node, or the launch.

    Args:
        name: Of the file.
        export: With which the names of the C export begin.
        mark: Who wrote it.
    """
    text = files("aridcal.jobs.export").joinpath(f"assets/{name}.in").read_text("utf-8")
    return text.replace("NAME", export).replace("MARK", mark)
