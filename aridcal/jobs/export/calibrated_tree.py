"""What a simulator is told of a calibrated robot: links, joints and weights of `calibrated.urdf`, one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.fit.constants import origins_of, urdf_of
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.drive import Drive
from aridcal.engine.robot.link_shapes import find_mesh, floats
from aridcal.engine.robot.meshes import NotDrawable
from aridcal.engine.robot.tree import MOVING, UrdfTree, numbers, parse_xml, placement_of, read_tree
from aridcal.jobs.calibrate.saved_model import SolvedModel
from aridcal.system.wording import plural

LEAST_MASS, LEAST_INERTIA = 1e-6, 1e-9
"""Of a link without a weight where a simulator wants one, [kg] and [kg m^2]: a grain of sand, which bears on no joint."""


@dataclass(frozen=True)
class Body:
    """The weight of a link.

    Attributes:
        mass: [kg].
        placement: Of the frame of the inertia, in the link.
        inertia: About its centre of mass, shape (3, 3), [kg m^2].
    """

    mass: float
    placement: pin.SE3
    inertia: np.ndarray


@dataclass(frozen=True)
class Solid:
    """A shape that collides.

    Attributes:
        kind: ``box`` (edges), ``cylinder`` (radius, length), ``sphere`` (radius) or ``mesh`` (scales).
        size: As the kind has it, [m].
        placement: In the link.
        mesh: The file of a mesh.
    """

    kind: str
    size: tuple[float, ...]
    placement: pin.SE3
    mesh: Path | None = None


@dataclass(frozen=True)
class Step:
    """A joint with what it carries.

    Attributes:
        name: As in the URDF.
        parent: Link.
        child: Link.
        origin: Calibrated ``<origin>``.
        kind: None of a joint that does not move.
        axis: Unit vector in the joint's frame, shape (3,).
        limits: Lowest and highest position, [rad] or [m]; None where there are none.
        drive: What it follows; None of one that moves by itself.
    """

    name: str
    parent: str
    child: str
    origin: pin.SE3
    kind: Literal["revolute", "prismatic"] | None
    axis: np.ndarray
    limits: tuple[float, float] | None
    drive: Drive | None


class CalibratedTree:
    """The tree of `calibrated.urdf`.

    Args:
        geometric: The geometric stage of a calibration.
        home: A file beside which its meshes may lie.
    """

    def __init__(self, geometric: SolvedModel, home: Path) -> None:
        self.robot: Robot = geometric.model.robot
        self.urdf = urdf_of(geometric.model, geometric.theta)
        self.origins = origins_of(geometric.model, geometric.theta)
        self.tree: UrdfTree = read_tree(self.urdf, self.robot.path, self.robot.stated)
        self._home = home
        self._links = {element.get("name", ""): element for element in parse_xml(self.urdf, home).iterfind("link")}
        self._left_out: list[str] = []

    @property
    def root(self) -> str:
        """The link that hangs from none."""
        return next(link for link in self.tree.links if link not in self.tree.parent_of)

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Every joint, parents before their children."""
        below: dict[str, list[str]] = {}
        for name, element in self.tree.joints.items():
            below.setdefault(_link_of(element, "parent"), []).append(name)
        steps, waiting = [], [self.root]
        while waiting:
            for name in below.get(waiting.pop(), ()):
                steps.append(self._step(name))
                waiting.append(steps[-1].child)
        return tuple(steps)

    def _step(self, name: str) -> Step:
        element = self.tree.joints[name]
        axis, kind = self.tree.moves.get(name, (np.array([1.0, 0.0, 0.0]), None))
        limit = element.find("limit")
        limits = None
        if kind is not None and element.get("type") != "continuous" and limit is not None:
            low, high = (float(numbers(limit, key, "0", 1, self.robot.path)[0]) for key in ("lower", "upper"))
            limits = (low, high) if low < high else None
        return Step(
            name,
            _link_of(element, "parent"),
            _link_of(element, "child"),
            self.tree.origins[name],
            MOVING.get(element.get("type", "")),
            axis,
            limits,
            self.tree.mimics.get(name),
        )

    def body(self, link: str) -> Body | None:
        """The weight of a link; None where the URDF has none that a body can have."""
        inertial = self._links[link].find("inertial")
        mass = None if inertial is None else inertial.find("mass")
        if inertial is None or mass is None:
            return None
        value = float(numbers(mass, "value", "0", 1, self.robot.path)[0])
        tensor = np.zeros((3, 3))
        if (inertia := inertial.find("inertia")) is not None:
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
                key = f"i{'xyz'[i]}{'xyz'[j]}"
                tensor[i, j] = tensor[j, i] = float(numbers(inertia, key, "0", 1, self.robot.path)[0])
        if value <= 0.0 or not (np.linalg.eigvalsh(tensor) > 0.0).all():
            return None
        return Body(value, self._placement(inertial.find("origin")), tensor)

    def solids(self, link: str, formats: tuple[str, ...]) -> Iterator[Solid]:
        """The shapes of a link that collide; what is left out is said by :attr:`remarks`.

        Args:
            link: The link.
            formats: Endings of the mesh files that the simulator reads.
        """
        for collision in self._links[link].iterfind("collision"):
            for shape in collision.iterfind("geometry/*"):
                try:
                    yield self._solid(shape, self._placement(collision.find("origin")), formats)
                except NotDrawable as reason:
                    self._left_out.append(f"{link} ({reason})")

    @property
    def remarks(self) -> list[str]:
        """Which shapes were left out, in words."""
        if not self._left_out:
            return []
        more = len(self._left_out) - 1
        return [
            f"{plural(len(self._left_out), 'shape')} left out: {self._left_out[0]}"
            + (f" and {more} more" if more else "")
        ]

    def _solid(self, shape: etree._Element, placement: pin.SE3, formats: tuple[str, ...]) -> Solid:
        keys = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}
        kind = str(shape.tag)
        if kind in keys:
            size = tuple(value for key in keys[kind] for value in floats(shape, key, ""))
            if len(size) != {"box": 3, "sphere": 1, "cylinder": 2}[kind] or min(size) <= 0.0:
                raise NotDrawable(f"a {kind} without a size")
            return Solid(kind, size, placement)
        if kind != "mesh":
            raise NotDrawable(f"<{kind}> is no shape of URDF")
        path = find_mesh(shape.get("filename", ""), replace(self.robot, path=self._home))
        if path.suffix.lower() not in formats:
            raise NotDrawable(f"a mesh {path.suffix}, not one of {', '.join(formats)}")
        return Solid(kind, floats(shape, "scale", "1 1 1"), placement, path.resolve())

    def _placement(self, origin: etree._Element | None) -> pin.SE3:
        return pin.SE3.Identity() if origin is None else placement_of(origin, self.robot.path)


def _link_of(joint: etree._Element, role: str) -> str:
    """The link that a joint names, whose tree has been checked."""
    link = joint.find(role)
    return "" if link is None else link.get("link", "")


def as_text(values: Iterable[float]) -> str:
    """Numbers as XML has them, the shortest that read back as the same float64."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0


def as_comment(about: Iterable[str]) -> str:
    """What a file says of itself, as the inside of a comment of XML."""
    return "\n  " + "\n  ".join(line.replace("--", "- -") for line in about) + "\n"
