"""Configurations in which bodies of a robot touch one another or a box: the URDF's collision shapes, by Pinocchio and coal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import link_frame, locked_placement, tree_frames
from aridcal.engine.robot.link_shapes import LinkShape, mesh_files, say_missing, shapes_of
from aridcal.engine.robot.meshes import MeshMissing, NotDrawable, read_meshes
from aridcal.engine.robot.tree import parse_xml
from aridcal.system.errors import shortened

LEAST_THICKNESS = 1e-6
"""[m]: a mesh thinner than that has no hull; it stands for nothing that could be hit."""


LINE_RADIUS = 1e-3
"""[m]: radius of a line of sight."""


@dataclass(frozen=True)
class Bodies:
    """Shapes of a robot and around it that can touch.

    Attributes:
        geometry: Shapes on the joints of ``robot.tree``, boxes on none, and the pairs that are looked at.
        unread: What is not looked at, and why.
    """

    geometry: pin.GeometryModel
    unread: tuple[str, ...]

    @property
    def any(self) -> bool:
        """True if any pair is looked at."""
        return len(self.geometry.collisionPairs) > 0

    @property
    def shaped(self) -> bool:
        """True if any shape moves with the robot."""
        return any(shape.parentJoint for shape in self.geometry.geometryObjects)


def bodies_of(robot: Robot, boxes: Sequence[tuple[np.ndarray, np.ndarray]], usual: np.ndarray) -> Bodies:
    """The shapes of a robot that can touch one another or a box.

    Meshes count as their convex hulls, which are never smaller. Two shapes on one joint or on neighbours are never looked at, nor
    two that touch in every usual posture: their shapes overlap.

    Args:
        robot: The whole tree.
        boxes: Lowest and highest corner of each, shape (3,), [m], in the base's frame.
        usual: Readings of usual postures, shape (n, columns).
    """
    geometry = pin.GeometryModel()
    shapes, unread = _shapes(robot)
    for number, shape in enumerate(shapes):
        placement = pin.SE3(shape.placement)
        geometry.addGeometryObject(pin.GeometryObject(str(number), shape.joint, placement, _form(shape)))
    parents = robot.tree.parents
    pairs = [
        (a, b)
        for b, second in enumerate(shapes)
        for a, first in enumerate(shapes[:b])
        if first.joint != second.joint and first.joint != parents[second.joint] and second.joint != parents[first.joint]
    ]
    for a, b in pairs:
        geometry.addCollisionPair(pin.CollisionPair(a, b))
    always = np.flatnonzero(touches(robot, geometry, usual).all(axis=0))
    for k in always.tolist():
        geometry.removeCollisionPair(pin.CollisionPair(*pairs[k]))
    joint, base = _stands_on(robot)
    for number, (low, high) in enumerate(boxes):
        at = base * pin.SE3(np.eye(3), (low + high) / 2)
        box = geometry.addGeometryObject(
            pin.GeometryObject(f"box {number}", joint, at, coal.Box(*(high - low).tolist()))
        )
        for k, shape in enumerate(shapes):
            if shape.joint != joint:
                geometry.addCollisionPair(pin.CollisionPair(k, box))
    return Bodies(geometry, unread)


def touches(robot: Robot, geometry: pin.GeometryModel, readings: np.ndarray) -> np.ndarray:
    """Which pairs touch in which configuration, shape (n, pairs) bool.

    Args:
        robot: The whole tree.
        geometry: Shapes and pairs.
        readings: Shape (n, columns), [rad] or [m].
    """
    model, data, placed = robot.tree, robot.tree.createData(), geometry.createData()
    touching = np.zeros((len(readings), len(geometry.collisionPairs)), dtype=bool)
    for row, (_, placements) in enumerate(_placements(robot, readings)):
        for joint, placement in enumerate(placements, start=1):
            data.oMi[joint] = placement
        pin.updateGeometryPlacements(model, data, geometry, placed)
        pin.computeCollisions(geometry, placed, False)
        touching[row] = [result.isCollision() for result in placed.collisionResults]
    return touching


def lines_touch(
    robot: Robot, geometry: pin.GeometryModel, readings: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """Whether a straight line touches any shape that moves with the robot, in each configuration, shape (n,) bool.

    Args:
        robot: The whole tree.
        geometry: Shapes.
        readings: Shape (n, columns), [rad] or [m].
        starts: In the base's frame, shape (n, 3), [m].
        ends: Likewise.
    """
    model, data, placed = robot.tree, robot.tree.createData(), geometry.createData()
    moving = [k for k, shape in enumerate(geometry.geometryObjects) if shape.parentJoint]
    request = coal.CollisionRequest()
    touching = np.zeros(len(readings), dtype=bool)
    for row, (base, placements) in enumerate(_placements(robot, readings)):
        for joint, placement in enumerate(placements, start=1):
            data.oMi[joint] = placement
        pin.updateGeometryPlacements(model, data, geometry, placed)
        start, end = (np.asarray(base.act(each[row])) for each in (starts, ends))
        along = end - start
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
        line, at = coal.Capsule(LINE_RADIUS, float(np.linalg.norm(along))), coal.Transform3s(turn, (start + end) / 2)
        for k in moving:
            shape_pose = coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation)
            if coal.collide(
                geometry.geometryObjects[k].geometry, shape_pose, line, at, request, coal.CollisionResult()
            ):
                touching[row] = True
                break
    return touching


def _stands_on(robot: Robot) -> tuple[int, pin.SE3]:
    """The joint of the tree that moves the base, and what stands on it, 0 for none; and where the base is on that joint."""
    base = link_frame(robot, robot.base)
    return (base.parentJoint, base.placement) if robot.climbs else (0, locked_placement(robot, base))


def _placements(robot: Robot, readings: np.ndarray) -> Iterator[tuple[pin.SE3, list[pin.SE3]]]:
    """Where the base and every joint of the tree are in its root in each configuration: shapes on no joint are given there."""
    walked = list(tree_frames(robot, readings))
    for k in range(len(readings)):
        root, *joints = (pin.SE3(w.axes[k], w.origin[k]) for w in walked)
        base = root.inverse()
        yield base, [base * joint for joint in joints]


def _shapes(robot: Robot) -> tuple[list[LinkShape], tuple[str, ...]]:
    """The collision shapes of a URDF, and what of them cannot be read; one that is wrong costs no other."""
    root = parse_xml(robot.urdf, robot.path)
    every = [(link.get("name", ""), element) for link in root.findall("link") for element in link.findall("collision")]
    meshes = read_meshes(mesh_files([element for _, element in every], robot))
    shapes: list[LinkShape] = []
    unread = []
    missing: list[MeshMissing] = []
    for link, element in every:
        try:
            added = list(shapes_of(element, link, robot, None, meshes))
        except MeshMissing as error:
            missing.append(error)
            continue
        except NotDrawable as error:
            unread.append(f"collision shapes of link {shortened(link)!r} are not looked at: {error}")
            continue
        shapes += [
            shape for shape in added if shape.kind != "mesh" or np.ptp(shape.vertices, axis=0).min() > LEAST_THICKNESS
        ]
    unread += say_missing(missing, "collisions are not looked at")
    return shapes, tuple(unread)


def _form(shape: LinkShape) -> coal.CollisionGeometry:
    """A shape as coal has it."""
    if shape.kind == "mesh":
        points = coal.StdVec_Vec3s()
        points.extend(np.unique(shape.vertices, axis=0).astype(float))
        return coal.Convex.convexHull(points, True, "Qt")
    return {"box": coal.Box, "cylinder": coal.Cylinder, "sphere": coal.Sphere}[shape.kind](*shape.size)
