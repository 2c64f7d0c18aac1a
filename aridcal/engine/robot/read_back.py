"""URDFs that are written, read back by two readers that nobody here wrote: all links stand where they should, or no file appears.

Where links are meant to be follows from the user's own tree with the new origins, worked out here and not from the file.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from aridcal.engine.robot.chain import Robot, chain_in_urdf
from aridcal.engine.robot.drive import Drive
from aridcal.engine.robot.kinematics import rotations
from aridcal.engine.robot.tree import UrdfTree, parse_xml, read_tree
from aridcal.system.errors import AridcalError, printable, shortened

COMPARED_CONFIGURATIONS = 3
"""Random ones in which all links are compared: an origin that is wrong is wrong in each."""

READ_BACK_TOLERANCE = 1e-9
"""[m] and [1] that links may differ by, in units of the largest distance where that is beyond a metre: products of matrices round
by a thousandth of that."""

LONGEST_REASON = 200
"""Characters of what a reader says of a file."""

Places = Mapping[str, np.ndarray]
"""Links in the frame of the root, shape (K, 4, 4) each, [m], in K configurations."""


class ReadBackError(AridcalError):
    """A URDF does not say what it was meant to say.

    Attributes:
        file: Its name.
        link: The link that is farthest off; None where the file could not be read.
    """

    def __init__(self, file: str, reader: str, fault: Fault) -> None:
        self.file, self.link = file, fault.link
        super().__init__(
            f"{file}: {reader} {fault.words}: nothing was written. This is a fault of aridcal: please report it with the URDF"
        )


@dataclass(frozen=True)
class Fault:
    """What is wrong with a file for one reader.

    Attributes:
        words: What follows the reader's name in a sentence.
        link: The link that stands elsewhere.
    """

    words: str
    link: str | None = None


def read_back(urdf: bytes, robot: Robot, origins: Mapping[str, pin.SE3], file: str) -> tuple[str, ...]:
    """Read a URDF with Pinocchio and with yourdfpy, and compare every link with where new origins have it.

    Args:
        urdf: The file that is to be written.
        robot: The robot of the user's own file.
        origins: New ``<origin>`` by joint.
        file: Name of the file, for messages.

    Returns:
        What yourdfpy cannot read of the user's own file, in words; this is passed over.

    Raises:
        NotReadBack: a link stands elsewhere for one of the readers, or one cannot read the file.
    """
    tree = read_tree(robot.urdf, robot.path)
    positions = _positions(tree, np.random.default_rng(0))
    intended = link_places(tree, positions, origins)
    fault = _fault(intended, lambda: _by_pinocchio(chain_in_urdf(robot, urdf).tree, positions, tree))
    if fault is not None:
        raise ReadBackError(file, "Pinocchio", fault)

    def second(content: bytes, places: Places) -> Fault | None:
        return _fault(places, lambda: _by_yourdfpy(content, positions))

    fault = second(urdf, intended)
    if fault is None:
        return ()
    nominal = link_places(tree, positions, {})
    own_fault = second(robot.urdf, nominal)
    if own_fault is None:
        raise ReadBackError(file, "yourdfpy", fault)
    remark = (
        f"{robot.path.name}: yourdfpy {own_fault.words}; URDFs that are written from it were read back by Pinocchio"
    )
    fault = second(_bare(urdf, robot.path), intended)
    if fault is None:
        return (f"{remark} and, without shapes and inertias, by yourdfpy",)
    if second(_bare(robot.urdf, robot.path), nominal) is None:
        raise ReadBackError(file, "yourdfpy", fault)
    return (f"{remark} alone",)


def link_places(
    tree: UrdfTree, positions: Mapping[str, np.ndarray], origins: Mapping[str, pin.SE3]
) -> dict[str, np.ndarray]:
    """Where links are by a tree with some other origins.

    Args:
        tree: The links and joints.
        positions: Of each moving joint, shape (K,), [rad] or [m].
        origins: New ``<origin>`` by joint; those of the file elsewhere.

    Returns:
        See :data:`Places`.
    """
    count = len(next(iter(positions.values()), np.zeros(COMPARED_CONFIGURATIONS)))
    places: dict[str, np.ndarray] = {}
    for link in tree.links:
        above = [link]
        while above[-1] not in places and above[-1] in tree.parent_of:
            above.append(tree.parent_of[above[-1]][0])
        places.setdefault(above[-1], np.tile(np.eye(4), (count, 1, 1)))
        for child, parent in zip(above[-2::-1], above[:0:-1], strict=True):
            name = tree.parent_of[child][1].get("name", "")
            origin = origins.get(name, tree.origins[name]).homogeneous
            places[child] = places[parent] @ origin @ _motion(tree, name, positions, count)
    return places


def _motion(tree: UrdfTree, joint: str, positions: Mapping[str, np.ndarray], count: int) -> np.ndarray:
    """A joint's motion, shape (K, 4, 4)."""
    T = np.tile(np.eye(4), (count, 1, 1))
    if joint in tree.moves:
        axis, kind = tree.moves[joint]
        if kind == "prismatic":
            T[:, :3, 3] = positions[joint][:, None] * axis
        else:
            T[:, :3, :3] = rotations(axis, positions[joint])
    return T


def _positions(tree: UrdfTree, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Random positions of all moving joints, shape (K,), [rad] or [m]; mimics follow their masters."""
    free = {name: rng.uniform(-1.0, 1.0, COMPARED_CONFIGURATIONS) for name in tree.moves}
    positions = {}
    for name in tree.moves:
        drive = tree.mimics.get(name, Drive({name: 1.0}))
        position = np.full(COMPARED_CONFIGURATIONS, drive.offset)
        for master, factor in drive.factors.items():
            position += factor * free.get(master, np.zeros(COMPARED_CONFIGURATIONS))
        positions[name] = position
    return positions


def _by_pinocchio(model: pin.Model, positions: Mapping[str, np.ndarray], tree: UrdfTree) -> Places:
    """Places of links as Pinocchio read them; every mimic is a joint of its own there."""
    data = model.createData()
    frames = {link: model.getFrameId(link, pin.FrameType.BODY) for link in tree.links}
    root = frames[next(link for link in tree.links if link not in tree.parent_of)]
    places: dict[str, list[np.ndarray]] = {link: [] for link in frames}
    for k in range(COMPARED_CONFIGURATIONS):
        q = pin.neutral(model)
        for name, position in positions.items():
            joint = model.getJointId(name)
            first, angle = model.idx_qs[joint], position[k]
            q[first : first + model.nqs[joint]] = angle if model.nqs[joint] == 1 else [np.cos(angle), np.sin(angle)]
        pin.framesForwardKinematics(model, data, q)
        from_root = data.oMf[root].inverse()
        for link, frame in frames.items():
            places[link].append((from_root * data.oMf[frame]).homogeneous)
    return {link: np.array(each) for link, each in places.items()}


def _by_yourdfpy(urdf: bytes, positions: Mapping[str, np.ndarray]) -> Places:
    """Places of links as yourdfpy reads them; it moves mimics by itself."""
    from yourdfpy import URDF  # brings trimesh and all its parts: half a second, which only what writes URDFs spends

    with _quiet("yourdfpy.urdf"):
        parsed = URDF.load(io.BytesIO(urdf), build_scene_graph=False, load_meshes=False).robot
        for link in parsed.links:
            link.visuals.clear()  # they were read; making them would take most of the time
        robot = URDF(parsed, build_scene_graph=True, load_meshes=False)
        all_places: dict[str, list[np.ndarray]] = {link: [] for link in robot.link_map}
        for k in range(COMPARED_CONFIGURATIONS):
            robot.update_cfg({name: positions[name][k] for name in robot.actuated_joint_names if name in positions})
            for link, places in all_places.items():
                places.append(robot.get_transform(link, robot.base_link))
    return {link: np.array(each) for link, each in all_places.items()}


def _fault(intended: Places, reader: Callable[[], Places]) -> Fault | None:
    """What is wrong with what a reader makes of a file; None where all links are where they are meant to be."""
    try:
        places = reader()
    except Exception as error:  # whatever a library makes of a file that it does not like
        return Fault(f"cannot read it ({shortened(printable(f'{type(error).__name__}: {error}'), LONGEST_REASON)})")
    missing = [link for link in intended if link not in places]
    if missing:
        return Fault(f"has no link {shortened(missing[0])!r}", missing[0])
    off = {link: float(np.max(np.abs(places[link] - T) / _size(T))) for link, T in intended.items()}
    worst = max(off, key=lambda link: off[link] if off[link] == off[link] else np.inf)
    if off[worst] <= READ_BACK_TOLERANCE:
        return None
    return Fault(f"has link {shortened(worst)!r} elsewhere, by {off[worst]:.2g} m or rad", worst)


def _size(T: np.ndarray) -> float:
    """The largest distance of some places, one metre at the least."""
    return max(1.0, float(np.abs(T[:, :3, 3]).max()))


def _bare(urdf: bytes, path: Path) -> bytes:
    """A URDF without what does not move links: shapes, materials, inertias, transmissions and what simulators add."""
    root = parse_xml(urdf, path)
    for element in list(root):
        if element.tag == "link":
            for part in list(element):
                element.remove(part)
        elif element.tag != "joint":
            root.remove(element)
    return bytes(etree.tostring(root, encoding="utf-8"))


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Keep a library's own remarks from the screen."""
    logger = logging.getLogger(name)
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before
