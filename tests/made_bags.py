"""Bags of ROS written with rosbags from the tables of two logs."""

from __future__ import annotations

from pathlib import Path

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
