"""Bags of ROS written with rosbags from the tables of two logs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore


def _header(store: Typestore, seconds: float, ros1: bool) -> object:
    stamp = store.types["builtin_interfaces/msg/Time"](int(seconds), round(1e9 * (seconds % 1.0)))
    kind = store.types["std_msgs/msg/Header"]
    return kind(0, stamp, "world") if ros1 else kind(stamp, "world")


def write_bag(
    path: Path, joints: pd.DataFrame, tracker: pd.DataFrame, how: str, as_tf: bool = False, also: str = ""
) -> None:
    """Write both logs; ``how`` is ``ros1``, ``mcap`` or ``sqlite3``, ``also`` another frame in /tf."""
    ros1 = how == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    T = store.types
    place, turn = (
        T["geometry_msgs/msg/Vector3" if as_tf else "geometry_msgs/msg/Point"],
        T["geometry_msgs/msg/Quaternion"],
    )
    names = [name for name in joints.columns if name != "time"]
    messages = []
    for row in joints.to_dict("records"):
        body = T["sensor_msgs/msg/JointState"](
            _header(store, row["time"], ros1),
            names,
            np.array([row[name] for name in names]),
            np.zeros(len(names)),
            np.zeros(len(names)),
        )
        messages.append((row["time"], "/joint_states", "sensor_msgs/msg/JointState", body))
    kind = "tf2_msgs/msg/TFMessage" if as_tf else "geometry_msgs/msg/PoseStamped"
    for row in tracker.to_dict("records"):
        header = _header(store, row["time"], ros1)
        xyz, q = place(row["x"], row["y"], row["z"]), turn(row["qx"], row["qy"], row["qz"], row["qw"])
        if as_tf:
            parts = [T["geometry_msgs/msg/TransformStamped"](header, "probe", T["geometry_msgs/msg/Transform"](xyz, q))]
            if also:
                parts.append(
                    T["geometry_msgs/msg/TransformStamped"](header, also, T["geometry_msgs/msg/Transform"](xyz, q))
                )
            body = T[kind](parts)
        else:
            body = T["geometry_msgs/msg/PoseStamped"](header, T["geometry_msgs/msg/Pose"](xyz, q))
        messages.append((row["time"], "/tf" if as_tf else "/tracker/pose", kind, body))
    messages.sort(key=lambda message: message[0])
    if ros1:
        writer = Writer1(path)
    else:
        writer = Writer2(path, version=8, storage_plugin=StoragePlugin.MCAP if how == "mcap" else StoragePlugin.SQLITE3)
    with writer:
        connections = {}
        for arrival, topic, kind, body in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            raw = store.serialize_ros1(body, kind) if ros1 else store.serialize_cdr(body, kind)
            writer.write(connections[topic], round(1e9 * (arrival + 2000.0)), raw)


def write_camera_bag(
    path: Path,
    joints: pd.DataFrame,
    images: list[tuple[float, np.ndarray]],
    encoding: str,
    info: dict[str, object] | None,
    how: str = "mcap",
    topic: str = "/eye/image_raw",
    also: str = "",
) -> None:
    """Write joints and a camera; ``encoding`` is one of ROS, or ``jpeg`` or ``png``; images are colours in OpenCV's order.

    ``also`` is the topic of a second camera, which sees the same.
    """
    ros1 = how == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    T = store.types
    names = [name for name in joints.columns if name != "time"]
    messages = []
    for row in joints.to_dict("records"):
        q = np.array([row[name] for name in names])
        body = T["sensor_msgs/msg/JointState"](_header(store, row["time"], ros1), names, q, 0 * q, 0 * q)
        messages.append((row["time"], "/joint_states", "sensor_msgs/msg/JointState", body))
    for time, image in images:
        header, (height, width) = _header(store, time, ros1), image.shape[:2]
        if encoding in ("jpeg", "png"):
            data = np.frombuffer(cv2.imencode(f".{encoding}", image)[1], np.uint8)
            kind, name = "sensor_msgs/msg/CompressedImage", f"{topic}/compressed"
            body = T[kind](header, encoding, data)
        else:
            kind, name = "sensor_msgs/msg/Image", topic
            own = {"mono8": cv2.COLOR_BGR2GRAY, "rgb8": cv2.COLOR_BGR2RGB}.get(encoding)
            pixels = image if own is None else cv2.cvtColor(image, own)
            rows = pixels.reshape(height, -1)
            padded = np.hstack(
                [rows, np.zeros((height, 5), np.uint8)]
            )  # rows of a frame may end in bytes that mean nothing
            body = T[kind](header, height, width, encoding, 0, padded.shape[1], padded.reshape(-1))
        messages += [(time, one, kind, body) for one in (name, also) if one]
        if info is not None:
            numbers = {key: np.array(info[key], float) for key in ("d", "k", "r", "p")}
            region = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
            kind = "sensor_msgs/msg/CameraInfo"
            said = T[kind](header, info["height"], info["width"], info["model"], *numbers.values(), 0, 0, region)
            messages.append((time, f"{topic.rsplit('/', 1)[0]}/camera_info", kind, said))
    messages.sort(key=lambda message: message[0])
    plugin = StoragePlugin.MCAP if how == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if ros1 else Writer2(path, version=8, storage_plugin=plugin) as writer:
        connections = {}
        for arrival, topic_of, kind, body in messages:
            if topic_of not in connections:
                connections[topic_of] = writer.add_connection(topic_of, kind, typestore=store)
            raw = store.serialize_ros1(body, kind) if ros1 else store.serialize_cdr(body, kind)
            writer.write(connections[topic_of], round(1e9 * (arrival + 2000.0)), raw)
