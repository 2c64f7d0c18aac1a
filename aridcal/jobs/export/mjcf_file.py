"""A calibrated robot as MJCF: bodies and joints of MuJoCo under the URDF's own names."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.jobs.export.calibrated_tree import LEAST_INERTIA, LEAST_MASS, CalibratedTree, Step, as_comment, as_text
from aridcal.system.errors import OutputError

MESHES = (".stl", ".obj")
"""Formats that MuJoCo reads and that URDFs name."""

WORLD = "world"
"""MuJoCo's name for its own root: a link of this name can be that alone."""

LEAST = {"boundmass": repr(LEAST_MASS), "boundinertia": repr(LEAST_INERTIA), "balanceinertia": "true"}
"""MuJoCo refuses moving bodies without a weight, and inertias that no body has; a URDF may have both. [kg], [kg m^2]."""


def mjcf(tree: CalibratedTree, about: Iterable[str]) -> tuple[str, list[str]]:
    """Write the tree of a calibrated robot as MJCF.

    Args:
        tree: The robot.
        about: What the file says of itself, a line each.

    Returns:
        The text, and what it does not hold, in words.

    Raises:
        OutputError: a link has a name that MuJoCo keeps for itself.
    """
    model = etree.Element("mujoco", model=tree.robot.path.stem)
    model.append(etree.Comment(as_comment(about)))
    etree.SubElement(model, "compiler", {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false"} | LEAST)
    assets, world = etree.SubElement(model, "asset"), etree.SubElement(model, "worldbody")
    bodies = {tree.root: world if tree.root == WORLD else etree.SubElement(world, "body", name=tree.root)}
    _fill(bodies[tree.root], tree, tree.root, assets)
    follows, remarks = [], []
    for step in tree.steps:
        if step.child == WORLD:
            raise OutputError(f"link {WORLD!r} is not the root, and MuJoCo knows no other body of that name: rename it")
        body = etree.SubElement(bodies[step.parent], "body", {"name": step.child, **_pose(step.origin)})
        bodies[step.child] = body
        if step.kind is not None:
            body.append(_joint(step))
        if step.drive is not None:
            follow = _follow(step)
            if follow is None:
                remarks.append(f"joint {step.name} follows several others, which MJCF cannot say: set it yourself")
            else:
                follows.append(follow)
        _fill(body, tree, step.child, assets)
    if follows:
        etree.SubElement(model, "equality").extend(follows)
    if not len(assets):
        model.remove(assets)
    etree.indent(model)
    return etree.tostring(model, encoding="unicode") + "\n", [*remarks, *tree.remarks]


def _fill(body: etree._Element, tree: CalibratedTree, link: str, assets: etree._Element) -> None:
    """Add a link's weight and shapes; the world itself has no weight."""
    weight = tree.body(link)
    if weight is not None and body.tag == "body":
        turn = weight.placement.rotation
        i = turn @ weight.inertia @ turn.T  # beside `fullinertia` no orientation may stand
        full = as_text((i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]))
        etree.SubElement(
            body, "inertial", pos=as_text(weight.placement.translation), mass=repr(weight.mass), fullinertia=full
        )
    for solid in tree.solids(link, MESHES):
        geom = etree.SubElement(body, "geom", {"type": solid.kind, **_pose(solid.placement)})
        if solid.kind == "mesh":
            name = f"{link}_{len(assets)}"
            etree.SubElement(assets, "mesh", name=name, file=str(solid.mesh), scale=as_text(solid.size))
            geom.set("mesh", name)
        else:
            halved = {"box": (0.5, 0.5, 0.5), "cylinder": (1.0, 0.5), "sphere": (1.0,)}[solid.kind]
            geom.set("size", as_text(np.array(solid.size) * halved))


def _joint(step: Step) -> etree._Element:
    kind = "slide" if step.kind == "prismatic" else "hinge"
    joint = etree.Element("joint", name=step.name, type=kind, axis=as_text(step.axis))
    if step.limits is not None:
        joint.set("range", as_text(step.limits))
    return joint


def _follow(step: Step) -> etree._Element | None:
    """What MuJoCo has for a mimic: an equality of two joints; None where one cannot say it."""
    drive = step.drive
    if drive is None or len(drive.factors) > 1:
        return None
    master, factor = next(iter(drive.factors.items()), (None, 0.0))
    joint = etree.Element("joint", joint1=step.name, polycoef=as_text((drive.offset, factor, 0.0, 0.0, 0.0)))
    if master is not None:
        joint.set("joint2", master)
    return joint


def _pose(placement: pin.SE3) -> dict[str, str]:
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs().tolist()
    return {"pos": as_text(placement.translation), "quat": as_text((w, x, y, z))}
