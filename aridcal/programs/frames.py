"""Frames of a program: its own, and those that only the controller has, from a file of the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import Field

from aridcal.inputs.instrument_settings import Placement
from aridcal.inputs.yaml_file import Number, Settings, load_settings


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
    settings = load_settings(path, FrameSettings)
    return KnownFrames(_poses(settings.bases), _poses(settings.tools), settings.start)


def _poses(placements: Mapping[str, Placement]) -> dict[str, np.ndarray]:
    return {name.lower(): placement.homogeneous for name, placement in placements.items()}


def unknown(kind: str, name: str) -> str:
    """Why a target in a frame that only the controller has is left as it is."""
    return f"{kind} {name} is not in the program: state it with --frames"
