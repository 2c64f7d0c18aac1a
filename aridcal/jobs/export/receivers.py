"""Who can be given a calibration, how, and the error that remains there: a row each."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aridcal.system.errors import OutputError
from aridcal.system.reading.regular_files import CALIBRATION, read_file

FULL, URDF_ALONE, MAPS, OFFSETS, REGIONS = (
    "full model", "URDF alone", "+ joint maps", "joint offsets alone", "URDF by region",
)  # fmt: skip
"""How much of a calibration a receiver takes, as the result folder's files call it."""

STAGES = {FULL: "final", URDF_ALONE: "geometric"}
"""Of `result.json`: the stage whose error that is."""

STATED = ("kinematics.yaml", "doty.yaml", "joint_offsets.yaml")
"""Files of result folders whose comments state the error of each; which there are hangs on the robot."""


@dataclass(frozen=True)
class Receiver:
    """One way to hand a calibration over.

    Attributes:
        who: Who takes it.
        option: Of ``aridcal export``; or, of what ``identify`` has written already, the file in the result folder.
        holds: How much of the calibration it takes.
    """

    who: str
    option: str
    holds: str

    @property
    def written(self) -> bool:
        """True of what is in the result folder, if the calibration has it."""
        return not self.option.startswith("--")


RECEIVERS: tuple[Receiver, ...] = (
    Receiver("a controller's loop in C or C++", "--c DIR", FULL),
    Receiver("Python with NumPy alone", "--numpy FILE.py", FULL),
    Receiver("optimal control with CasADi", "--casadi FILE.casadi", FULL),
    Receiver("ROS 2: a launch, and a node that corrects trajectories", "--ros2 DIR", FULL),
    Receiver("MuJoCo", "--mjcf FILE.xml", URDF_ALONE),
    Receiver("Gazebo", "--sdf FILE.sdf", URDF_ALONE),
    Receiver("a description in xacro", "--xacro FILE.xacro", URDF_ALONE),
    Receiver("a policy trained on many arms", "--randomize N -o DIR", URDF_ALONE),
    Receiver("LinuxCNC, SINUMERIK, HEIDENHAIN: compensation tables", "--table GRID -o DIR", MAPS),
    Receiver("robot_state_publisher, MoveIt, Drake, Isaac", "calibrated.urdf", URDF_ALONE),
    Receiver("MuJoCo: your own file", "calibrated.xml", URDF_ALONE),
    Receiver("ur_description, franka_description", "kinematics.yaml", URDF_ALONE),
    Receiver("controllers that take DH tables", "dh.yaml, dh_modified.yaml", URDF_ALONE),
    Receiver("controllers that take a URDF and a table for each joint", "joint_maps.urdf, joint_maps.csv", MAPS),
    Receiver("a URDF for each part of the workspace", "regions/index.yaml", REGIONS),
    Receiver("KUKA, ABB, FANUC, Yaskawa, Staubli: mastering, zeros", "joint_offsets.yaml", OFFSETS),
)
"""In the order in which they are listed. Programs are no file of the calibration: `aridcal compensate` corrects them."""


def remaining(receiver: Receiver, folder: Path, result: Mapping[str, Any] | None) -> str:
    """What is still wrong with the target where a receiver has the calibration, RMS on held-out rows, in words.

    Args:
        receiver: Who has it.
        folder: The result folder.
        result: What ``result.json`` holds; None where there is none.
    """
    parts = (result or {}).get("error", {}).get(STAGES.get(receiver.holds, ""), {})
    figures = parts.get("test") or parts.get("train") or {}
    shown = [
        f"{of['rms']:.3f} {channel.rsplit('_', 1)[1]}" for channel, of in figures.items() if of.get("rms") is not None
    ]
    if shown:
        return f"{' and '.join(shown)} on {'held-out' if parts.get('test') else 'fitted'} rows"
    figure = _stated(folder).get(receiver.holds)
    return f"{figure} on the same rows" if figure else "not in this folder"


def _stated(folder: Path) -> dict[str, str]:
    """Errors as the comment of an exported file states them: `All exports: nominal 1.15 mm, URDF alone 0.44, ...`."""
    there = [folder / name for name in STATED if (folder / name).is_file()]
    try:
        text = read_file(there[0], OutputError, CALIBRATION).decode("utf-8") if there else ""
    except (OutputError, ValueError):
        return {}
    line = re.search(r"^# All exports: nominal [\d.]+ (\S+), (.*)\.$", text, re.MULTILINE)
    if line is None:
        return {}
    pairs = (part.rpartition(" ") for part in line[2].split(", "))
    return {name: f"{figure} {line[1]}" for name, _, figure in pairs}
