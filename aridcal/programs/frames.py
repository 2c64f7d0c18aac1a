"""Frames of a program: its own, and those that only the controller has, from a file of the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from pydantic import Field

from aridcal.errors import CampaignError
from aridcal.inputs.instrument_settings import Placement
from aridcal.inputs.yaml_file import Number, Settings, load_settings
from aridcal.robot.chain import Robot
from aridcal.robot.tree import read_tree

EXAMPLE = """a file of --frames states frames that only the controller has, in metres and radians, for instance
  format: 1
  bases: {"1": {xyz: [0.8, 0, 0.3], rpy: [0, 0, 1.5708]}}    # of the base: frames of targets, by name or number
  tools: {"1": {xyz: [0, 0, 0.15], rpy: [0, 0, 0]}}          # of the tip
docs/apply/index.md has a page for each controller: how it writes its frames"""


class FrameSettings(Settings):
    """A file of ``--frames``.

    Attributes:
        bases: T_base_frame of each frame that targets are in, by its name in the program, or its number in quotes.
        tools: T_tip_tool of each tool, likewise.
        start: Readings of the joints where the program begins, in the units of the program.
    """

    bases: Mapping[str, Placement] = Field(default_factory=dict)
    tools: Mapping[str, Placement] = Field(default_factory=dict)
    start: tuple[Number, ...] | None = None


@dataclass(frozen=True)
class KnownFrames:
    """Frames by name, each of shape (4, 4), [m].

    Attributes:
        bases: Where targets are.
        tools: What is to be there.
        start: See :class:`FrameSettings`.
    """

    bases: Mapping[str, np.ndarray] = field(default_factory=dict)
    tools: Mapping[str, np.ndarray] = field(default_factory=dict)
    start: tuple[float, ...] | None = None


def read_frames(path: Path | None) -> KnownFrames:
    """Read a file of frames; none if there is no file.

    Raises:
        CampaignError: naming file, line and key of what is wrong.
    """
    if path is None:
        return KnownFrames()
    try:
        settings = load_settings(path, FrameSettings)
    except CampaignError as problem:
        raise CampaignError(f"{problem}\n{EXAMPLE}" if path.is_file() else str(problem)) from None
    return KnownFrames(_poses(settings.bases), _poses(settings.tools), settings.start)


def controllers_base(robot: Robot) -> np.ndarray | None:
    """Where the controller's base is in the campaign's, if the URDF says that it is elsewhere, T of shape (4, 4).

    Descriptions of ROS-Industrial, and those of Universal Robots, have a link `base` for it, beside `base_link`.
    """
    tree, link, T = read_tree(robot.urdf, robot.path), "base", np.eye(4)
    while link != robot.base:
        parent, joint = tree.parent_of.get(link, ("", None))
        if joint is None or joint.get("name") in tree.moves:
            return None
        link, T = parent, tree.origins[str(joint.get("name"))].homogeneous @ T
    return None if np.allclose(T, np.eye(4), atol=1e-6) else T


def unsaid_base(robot: Robot, frames: KnownFrames) -> str:
    """What to do if the controller's base is the URDF's link ``base``, and nobody says so; empty if nothing is."""
    T = controllers_base(robot)
    if T is None or "default" in frames.bases:
        return ""
    xyz, rpy = (
        ", ".join(f"{round(value, 9) + 0.0:.9g}" for value in part)
        for part in (T[:3, 3], pin.rpy.matrixToRpy(T[:3, :3]))
    )
    return (
        f"targets were taken to be in {robot.base}. If the controller counts from the URDF's link `base`, they are others: give "
        f"--frames a file with the lines `format: 1` and `bases: {{default: {{xyz: [{xyz}], rpy: [{rpy}]}}}}`"
    )


def _poses(placements: Mapping[str, Placement]) -> dict[str, np.ndarray]:
    return {name.lower(): placement.homogeneous for name, placement in placements.items()}


def unknown(kind: str, name: str) -> str:
    """Why a target in a frame that only the controller has is left as it is."""
    return f"{kind} {name} is not in the program: state it with --frames"
