"""A camera's place as others read it: text to paste, and files for easy_handeye, MoveIt, xacro."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from textwrap import indent
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
import yaml

from aridcal.jobs.calibrate.hand_eye import Arm, CameraPlace, HandEye

FOLDER = "hand_eye"

GOES_WITH: Mapping[Arm, str] = {
    "nominal": "The arm is taken as its URDF has it: constants of its own explain no more of these rows than chance would.",
    "calibrated": "The arm's constants were fitted with it: it goes with calibrated.urdf. For the arm as its URDF has it, the "
    "best place is that of `nominal` in frames.yaml.",
    "full model": "The arm's constants and effects were fitted with it: it goes with the full model. For the arm as its URDF has "
    "it, the best place is that of `nominal` in frames.yaml.",
}

OPTICAL = "The frame is the optical one: z along the line of sight, x to the right of the image, y down."


def write_hand_eye(answer: HandEye, base: str, tip: str, folder: Path) -> None:
    """Write the files of every camera into a new folder ``hand_eye`` of a result folder.

    Args:
        answer: Of the calibration.
        base: Link at which the robot begins.
        tip: Link at which it ends.
        folder: The result folder.
    """
    home = folder / FOLDER
    home.mkdir()
    for place in answer.places:
        for ending, text in files(place, answer.arm, base, tip).items():
            (home / f"{_plain(place.name)}{ending}").write_text(text, encoding="utf-8")


def files(place: CameraPlace, arm: Arm, base: str, tip: str) -> dict[str, str]:
    """Texts of a camera's files by the endings of their names; see :func:`write_hand_eye`."""
    known = f"{place.name}: {place.in_words}."
    return {
        ".txt": _to_paste(place, known, arm),
        ".yaml": _commented(known, arm) + yaml.safe_dump(document(place, arm), sort_keys=False, width=200),
        ".xacro": _xacro(place, known),
        ".launch.py": _launch(place, known),
        ".easy_handeye.yaml": _commented(known, arm) + _easy_handeye(place, base, tip, {}),
        ".easy_handeye2.calib": _commented(known, arm)
        + _easy_handeye(place, base, tip, {"freehand_robot_movement": True}),
    }


def document(place: CameraPlace, arm: Arm) -> dict[str, Any]:
    """A camera's place as plain data: [m], [rad], quaternions x y z w; std as a twist in the camera's own axes."""
    return {
        "format": 1,
        "parent": place.parent,
        "child": _frame(place),
        "in_hand": place.in_hand,
        "arm": arm,
        "xyz": place.placement.translation.tolist(),
        "quaternion": _quaternion(place).tolist(),
        "rpy": pin.rpy.matrixToRpy(place.placement.rotation).tolist(),
        "matrix": place.placement.homogeneous.tolist(),
        "std": [std if np.isfinite(std) else None for std in place.std.tolist()],
    }


def _to_paste(place: CameraPlace, certainty: str, arm: Arm) -> str:
    """Everything that people paste, each under a heading."""
    xyz, q = _digits(place.placement.translation), _digits(_quaternion(place))
    names = f"{place.parent} {_frame(place)}"
    ros2 = " ".join(
        f"--{name} {value}" for name, value in zip(("x", "y", "z", "qx", "qy", "qz", "qw"), xyz + q, strict=True)
    )
    parts = {
        f"matrix, T_{place.parent}_{_frame(place)} [m]": "\n".join(
            " ".join(f"{value: .9f}" for value in row) for row in place.placement.homogeneous
        ),
        "xyz [m], quaternion x y z w": f"{' '.join(xyz)}\n{' '.join(q)}",
        "ROS 2": "ros2 run tf2_ros static_transform_publisher "
        f"{ros2} --frame-id {place.parent} --child-frame-id {_frame(place)}",
        "ROS 1": f"rosrun tf2_ros static_transform_publisher {' '.join(xyz + q)} {names}",
        "URDF": f"<link name={quoteattr(_frame(place))}/>\n{_joint(place, place.parent, '')}",
        "beside it": "the same for xacro (.xacro), MoveIt (.launch.py), easy_handeye (.easy_handeye.yaml, .easy_handeye2.calib)",
    }
    head = f"{certainty}\n{GOES_WITH[arm]}\n{OPTICAL}\n"
    return head + "".join(f"\n{title}\n{indent(text, '    ')}\n" for title, text in parts.items())


def _joint(place: CameraPlace, parent: str, prefix: str) -> str:
    """The ``<joint>`` that fixes the camera's frame to its parent."""
    xyz = " ".join(_digits(place.placement.translation))
    rpy = " ".join(_digits(pin.rpy.matrixToRpy(place.placement.rotation)))
    return (
        f'<joint name={quoteattr(f"{prefix}{place.name}_optical_joint")} type="fixed">\n'
        f"  <parent link={quoteattr(parent)}/>\n"
        f"  <child link={quoteattr(prefix + _frame(place))}/>\n"
        f'  <origin xyz="{xyz}" rpy="{rpy}"/>\n'
        "</joint>"
    )


def _xacro(place: CameraPlace, certainty: str) -> str:
    """A macro that adds the camera's frame to a robot; its name is the camera's as an identifier."""
    name, prefix = _plain(place.name).replace("-", "_"), "${prefix}"
    parameters = f"prefix:='' parent:='{place.parent}'"
    body = f"<link name={quoteattr(prefix + _frame(place))}/>\n{_joint(place, '${parent}', prefix)}"
    return (
        '<?xml version="1.0"?>\n'
        f"<!-- {certainty.replace('--', '- -')} -->\n"
        f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
        f"  <xacro:macro name={quoteattr(name)} params={quoteattr(parameters)}>\n"
        f"{indent(body, '    ')}\n"
        "  </xacro:macro>\n"
        "</robot>\n"
    )


def _launch(place: CameraPlace, certainty: str) -> str:
    """A launch file of ROS 2 like the one that MoveIt's hand-eye panel saves."""
    values = _digits(place.placement.translation) + _digits(_quaternion(place))
    pairs = [
        part
        for name, value in zip(("x", "y", "z", "qx", "qy", "qz", "qw"), values, strict=True)
        for part in (name, value)
    ]
    words = ["frame-id", place.parent, "child-frame-id", _frame(place), *pairs]
    arguments = "".join(
        f"                {f'--{name}'!r}, {value!r},\n" for name, value in zip(words[::2], words[1::2], strict=True)
    )
    return (
        f"# {certainty}\n"
        "from launch import LaunchDescription\n"
        "from launch_ros.actions import Node\n\n\n"
        "def generate_launch_description():\n"
        "    return LaunchDescription([\n"
        "        Node(\n"
        '            package="tf2_ros",\n'
        '            executable="static_transform_publisher",\n'
        f"            arguments=[\n{arguments}            ],\n"
        "        )\n"
        "    ])\n"
    )


def _easy_handeye(place: CameraPlace, base: str, tip: str, further: Mapping[str, Any]) -> str:
    """The calibration as easy_handeye stores it; ``further`` are parameters that its second version has."""
    xyz, q = place.placement.translation.tolist(), _quaternion(place).tolist()
    parameters = {
        "namespace": f"/{_plain(place.name)}/",
        "eye_on_hand": place.in_hand,
        "robot_base_frame": base if place.in_hand else place.parent,
        "robot_effector_frame": place.parent if place.in_hand else tip,
        "tracking_base_frame": _frame(place),
        "tracking_marker_frame": "board",
        "move_group_namespace": "/",
        "move_group": "manipulator",
        **further,
    }
    numbers = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), xyz + q, strict=True))
    return yaml.safe_dump({"parameters": parameters, "transformation": numbers}, sort_keys=False)


def _commented(certainty: str, arm: Arm) -> str:
    return "".join(f"# {line}\n" for line in (certainty, GOES_WITH[arm], OPTICAL))


def _frame(place: CameraPlace) -> str:
    """Name of the camera's frame, as ROS calls frames of this kind."""
    return f"{place.name}_optical_frame"


def _quaternion(place: CameraPlace) -> np.ndarray:
    """X y z w, shape (4,)."""
    return np.asarray(pin.Quaternion(place.placement.rotation).normalized().coeffs())


def _digits(numbers: np.ndarray) -> list[str]:
    """Numbers to a nanometre or nanoradian."""
    return [f"{value:.9f}" for value in np.asarray(numbers) + 0.0]


def _plain(name: str) -> str:
    """A camera's name as a file may have it."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)
