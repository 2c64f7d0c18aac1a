"""Logs from bags of ROS 1 and ROS 2 (.bag, .db3, .mcap, folders): joints, and targets that a tracker publishes.

Read are JointState, PoseStamped, PointStamped, TransformStamped and the transforms of /tf; of a camera Image, CompressedImage and
CameraInfo.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.files.orientations import QUATERNION
from aridcal.files.quantities import POSITION_COLUMNS
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.merge.bag_camera import IMAGES, INFO, BagCamera, CameraInfo, Take, frame_of, info_of, same_camera
from aridcal.jobs.merge.log import Log, in_order
from aridcal.jobs.merge.log_files import JointLog, TrackerLog
from aridcal.jobs.prepare.guesses import Chooser
from aridcal.system.errors import MeasurementError, name_list, printable

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

BAG_ENDINGS = (".bag", ".db3", ".mcap")
"""Of bags that are one file; a folder is one of ROS 2."""

JOINT_STATE_TYPE = "sensor_msgs/msg/JointState"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/msg/PoseStamped": lambda message: (message.pose.position, message.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda message: (message.transform.translation, message.transform.rotation),
    "geometry_msgs/msg/PointStamped": lambda message: (message.point, None),
}
"""Place and orientation of each kind of message."""


def is_bag(source: object) -> bool:
    """Tell whether what a user names is a bag."""
    return isinstance(source, str | Path) and (Path(source).suffix.lower() in BAG_ENDINGS or Path(source).is_dir())


def _reader(path: Path) -> AnyReader:
    """A bag, to be entered.

    Raises:
        MeasurementError: it is none, or what reads it is not installed.
    """
    if find_spec("rosbags") is None:
        raise MeasurementError(
            f'{path}: is a bag of ROS: `pip install "aridcal[ros]"` for it to be read, or export tables of it'
        )
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    except Exception as problem:  # a bag is somebody else's format: its reader raises whatever it meets
        raise _unreadable(path, problem) from None


def _unreadable(path: Path, problem: Exception) -> MeasurementError:
    reason = " ".join(printable(str(problem)).split())[:200]
    return MeasurementError(
        f"{path}: cannot be read as a bag of ROS: {reason}. If it was cut off, repair it (`rosbag reindex`, `ros2 bag reindex`, "
        "`mcap recover`), or export its topics as tables"
    )


def _messages(
    path: Path, kinds: tuple[str, ...], use: Callable[[str, str, int, Any], None], topic: str | None = None
) -> None:
    """Hand over topic, kind, time of arrival and content of each message of some kinds, of one topic alone where it is named."""
    reader = _reader(path)
    try:
        with reader:
            connections = [one for one in reader.connections if one.msgtype in kinds and topic in (None, one.topic)]
            if connections:
                for connection, arrival, raw in reader.messages(connections=connections):
                    use(connection.topic, connection.msgtype, arrival, reader.deserialize(raw, connection.msgtype))
    except MeasurementError:
        raise
    except Exception as problem:  # as above
        raise _unreadable(path, problem) from None


def _stamp(header: Any) -> float:
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


def _log_of_rows(title: str, columns: tuple[str, ...], rows: list[tuple[float, ...]], arrivals: list[float]) -> Log:
    """A log; where no header has a time, that of arrival counts."""
    values = np.array(rows, dtype=float).reshape(len(rows), len(columns) + 1)
    notes: tuple[str, ...] = ()
    if not values[:, 0].any():
        values[:, 0] = arrivals
        notes = (f"{title}: headers have no time: that of arrival counts",)
    log = Log(title, values[:, 0], columns, values[:, 1:], notes)
    log = log.keep(np.isfinite(values).all(axis=1), "without a number: left out")
    return in_order(log, np.arange(1, len(log.time) + 1))


def joint_log(path: Path, robot: Robot) -> JointLog:
    """The joints' log of a bag: of the topic that has all joints of the chain.

    Raises:
        MeasurementError: there is none, or there are several.
    """
    rows: dict[str, list[tuple[float, ...]]] = {}
    arrivals: dict[str, list[float]] = {}
    names_seen: set[str] = set()

    def use(topic: str, kind: str, arrival: int, message: Any) -> None:
        names_seen.update(message.name)
        where = {name: k for k, name in enumerate(message.name)}
        if set(robot.readings) <= set(where) and len(message.position) == len(message.name):
            readings = [float(message.position[where[name]]) for name in robot.readings]
            rows.setdefault(topic, []).append((_stamp(message.header), *readings))
            arrivals.setdefault(topic, []).append(1e-9 * arrival)

    _messages(path, (JOINT_STATE_TYPE,), use)
    if not rows:
        lacking = [name for name in robot.readings if name not in names_seen]
        remark = (
            f"; its joints are {name_list(sorted(names_seen))}" if names_seen else "; it has no messages of that kind"
        )
        raise MeasurementError(
            f"{path}: no JointState has positions of all joints of the chain "
            f"({name_list(lacking or list(robot.readings))} lacking in "
            f"some){remark}. Record /joint_states of this robot, or choose the --tip whose chain it is"
        )
    topic = max(rows, key=lambda name: len(rows[name]))
    log = _log_of_rows(f"{path.name}:{topic}", robot.readings, rows[topic], arrivals[topic])
    if len(rows) > 1:
        others = [name for name in rows if name != topic]
        log = Log(
            log.title, log.time, log.columns, log.values, (*log.notes, f"{path.name}: {name_list(others)} not used")
        )
    units = tuple("m" if kind == "prismatic" else "rad" for kind in robot.kinds)
    return JointLog(log, (units,))


def tracker_log(path: Path, links: frozenset[str], asker: Chooser) -> TrackerLog | BagCamera:
    """The tracker's log of a bag: of the topic, or the frame of /tf, that moves and is no link of the robot; or images.

    Args:
        path: The bag.
        links: Of the robot: what is published of these is computed, not measured.
        asker: Asked where several remain.

    Raises:
        AridcalError: none is there, or several, and nobody says which.
    """
    rows: dict[str, list[tuple[float, ...]]] = {}
    arrivals: dict[str, list[float]] = {}

    def add(name: str, arrival: int, header: Any, place: Any, turn: Any) -> None:
        values = [place.x, place.y, place.z, *([turn.x, turn.y, turn.z, turn.w] if turn is not None else [])]
        rows.setdefault(name, []).append((_stamp(header), *map(float, values)))
        arrivals.setdefault(name, []).append(1e-9 * arrival)

    def use(topic: str, kind: str, arrival: int, message: Any) -> None:
        parts = message.transforms if kind in TRANSFORMS else [message]
        for part in parts:
            child = str(getattr(part, "child_frame_id", ""))
            if child.lstrip("/") not in links or not child:
                take = POSES["geometry_msgs/msg/TransformStamped" if kind in TRANSFORMS else kind]
                add(f"{topic} {child}".strip(), arrival, part.header, *take(part))

    _messages(path, (*POSES, *TRANSFORMS), use)
    moving = {name: found for name, found in rows.items() if len({one[1:4] for one in found}) > 1}
    images = _image_topics(path)
    if not moving and not images:
        rest = f" that moves; of {name_list(sorted(rows))} nothing does" if rows else ""
        raise MeasurementError(
            f"{path}: no PoseStamped, PointStamped, TransformStamped or frame of /tf{rest} that is no link of the robot, and no "
            "images. Record what the tracker or the camera publishes, or name its log after the bag"
        )
    names = [*sorted(moving, key=lambda name: -len(moving[name])), *images]
    k = (
        asker.pick("target", f"{path.name}: which is the measured target", names, "more than one may be")
        if len(names) > 1
        else 0
    )
    if names[k] in images:
        return camera(path, names[k])
    columns = (*POSITION_COLUMNS, *QUATERNION) if len(moving[names[k]][0]) == 8 else POSITION_COLUMNS
    log = _log_of_rows(f"{path.name}:{names[k]}", columns, moving[names[k]], arrivals[names[k]])
    return TrackerLog(log, (POSITION_COLUMNS,))


def _image_topics(path: Path) -> list[str]:
    """Topics of images; of one that is sent raw and compressed the former, and none of depths."""
    with_reader: list[str] = []
    reader = _reader(path)
    try:
        with reader:
            with_reader += sorted({one.topic for one in reader.connections if one.msgtype in IMAGES and one.msgcount})
    except Exception as problem:  # as above
        raise _unreadable(path, problem) from None
    return [
        topic
        for topic in with_reader
        if "depth" not in topic.lower()
        and not (topic.endswith("/compressed") and topic[: -len("/compressed")] in with_reader)
    ]


def camera(path: Path, topic: str) -> BagCamera:
    """When a topic's images were taken, and what their driver says of the camera."""
    stamps: list[float] = []
    arrivals: list[float] = []
    infos: dict[CameraInfo, None] = {}

    def use(name: str, kind: str, arrival: int, message: Any) -> None:
        if kind == INFO:
            if same_camera(name, topic):
                infos.setdefault(info_of(message))
        elif name == topic:
            stamps.append(_stamp(message.header))
            arrivals.append(1e-9 * arrival)

    for kinds, only in ((IMAGES, topic), ((INFO,), None)):
        _messages(path, kinds, use, only)
    by_arrival = not any(stamps)
    time = np.array(arrivals if by_arrival else stamps)
    return BagCamera(f"{path.name}:{topic}", topic, time, by_arrival, tuple(infos))


def frames(path: Path, topic: str, numbers: frozenset[int], take: Take) -> None:
    """Hand over images of a topic by their number, counted from 0 in the bag's order, or why one cannot be read."""
    count = 0

    def use(name: str, kind: str, arrival: int, message: Any) -> None:
        nonlocal count
        if count in numbers:
            try:
                take(count, frame_of(kind, message))
            except NotMeasured as problem:
                take(count, problem)
        count += 1

    _messages(path, IMAGES, use, topic)
