"""A calibrated robot as SDF, Gazebo's format: links and joints under the URDF's own names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.robot.splice import rpy_near
from aridcal.jobs.export.calibrated_tree import (
    LEAST_INERTIA,
    LEAST_MASS,
    Body,
    CalibratedTree,
    Step,
    as_comment,
    as_text,
)
from aridcal.system.errors import OutputError

MESHES = (".stl", ".obj", ".dae", ".glb", ".gltf")
"""Formats that Gazebo reads and that URDFs name."""

PLAIN, WITH_MIMICS = "1.9", "1.11"
"""Of SDF: the lowest with `continuous` joints, which Gazebo Fortress reads, and the lowest with `<mimic>`, of Harmonic."""

WORLD = "world"
"""SDF's name for what stands still: no link can be called that."""


def sdf(tree: CalibratedTree, about: Iterable[str]) -> tuple[str, list[str]]:
    """Write the tree of a calibrated robot as SDF.

    Args:
        tree: The robot.
        about: What the file says of itself, a line each.

    Returns:
        The text, and what it does not hold, in words.

    Raises:
        OutputError: a link below the root has a name that SDF keeps for itself.
    """
    file = etree.Element("sdf", version=WITH_MIMICS if any(s.drive for s in tree.steps) else PLAIN)
    file.append(etree.Comment(as_comment(about)))
    model, remarks = etree.SubElement(file, "model", name=tree.robot.path.stem), []
    if tree.root != WORLD:
        _link(model, tree, tree.root, None)
    for step in tree.steps:
        if step.child == WORLD:
            raise OutputError(f"link {WORLD!r} is not the root, and SDF has no other of that name: rename it")
        _joint(model, step)
        if step.drive is not None and len(step.drive.factors) != 1:
            does = "follows several others" if step.drive.factors else f"stands at {step.drive.offset:.6g}"
            remarks.append(f"joint {step.name} {does}, which SDF cannot say: set it yourself")
        _link(model, tree, step.child, step.name)
    etree.indent(file)
    return etree.tostring(file, encoding="unicode") + "\n", [*remarks, *tree.remarks]


def _link(model: etree._Element, tree: CalibratedTree, name: str, joint: str | None) -> None:
    link = etree.SubElement(model, "link", name=name)
    if joint is not None:  # where its joint is
        etree.SubElement(link, "pose", relative_to=joint).text = "0 0 0 0 0 0"
    # Of a link that says nothing SDF takes a kilogram.
    weight = tree.body(name) or Body(LEAST_MASS, pin.SE3.Identity(), LEAST_INERTIA * np.eye(3))
    inertial = etree.SubElement(link, "inertial")
    etree.SubElement(inertial, "pose").text = _pose(weight.placement)
    etree.SubElement(inertial, "mass").text = repr(weight.mass)
    inertia = etree.SubElement(inertial, "inertia")
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        etree.SubElement(inertia, f"i{'xyz'[i]}{'xyz'[j]}").text = repr(float(weight.inertia[i, j]))
    for k, solid in enumerate(tree.solids(name, MESHES)):
        collision = etree.SubElement(link, "collision", name=f"{name}_{k}")
        etree.SubElement(collision, "pose").text = _pose(solid.placement)
        shape = etree.SubElement(etree.SubElement(collision, "geometry"), solid.kind)
        keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("scale",)}
        if solid.mesh is not None:
            etree.SubElement(shape, "uri").text = Path(solid.mesh).as_uri()
        whole = len(keys[solid.kind]) == 1
        for key, value in zip(keys[solid.kind], [solid.size] if whole else [[v] for v in solid.size], strict=True):
            etree.SubElement(shape, key).text = as_text(value)


def _joint(model: etree._Element, step: Step) -> None:
    kind: str = "fixed" if step.kind is None else step.kind
    if step.kind == "revolute" and step.limits is None:
        kind = "continuous"
    joint = etree.SubElement(model, "joint", name=step.name, type=kind)
    etree.SubElement(joint, "pose", relative_to=step.parent).text = _pose(step.origin)
    etree.SubElement(joint, "parent").text = step.parent
    etree.SubElement(joint, "child").text = step.child
    if step.kind is None:
        return
    axis = etree.SubElement(joint, "axis")
    etree.SubElement(axis, "xyz").text = as_text(step.axis)
    if step.limits is not None:
        limit = etree.SubElement(axis, "limit")
        for key, value in zip(("lower", "upper"), step.limits, strict=True):
            etree.SubElement(limit, key).text = repr(value)
    if step.drive is not None and len(step.drive.factors) == 1:
        ((master, factor),) = step.drive.factors.items()
        mimic = etree.SubElement(axis, "mimic", joint=master)
        for key, value in (("multiplier", factor), ("offset", step.drive.offset), ("reference", 0.0)):
            etree.SubElement(mimic, key).text = repr(float(value))


def _pose(placement: pin.SE3) -> str:
    return as_text((*placement.translation, *rpy_near(placement.rotation, np.zeros(3))))
