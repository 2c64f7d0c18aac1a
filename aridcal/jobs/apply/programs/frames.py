"""Frames of a program: its own, and those that only the controller has, from a file of the user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import Field

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.tree import read_tree
from aridcal.files.instrument_settings import Placement
from aridcal.files.yaml_file import Number, Settings, load_settings
from aridcal.jobs.apply.programs.axes import MOST_AXES
from aridcal.jobs.apply.programs.text import Code
from aridcal.jobs.apply.programs.uses import ANY, Frame, line_name
from aridcal.jobs.apply.programs.walk import Unknown
from aridcal.system.errors import CampaignError

EXAMPLE = """a file of --frames states frames that only the controller has, in metres and radians, for instance
  format: 1
  bases: {"1": {xyz: [0.8, 0, 0.3], rpy: [0, 0, 1.5708]}}    # of the base: frames of targets, by name or number
  tools: {"1": {xyz: [0, 0, 0.15], rpy: [0, 0, 0]}}          # of the tip
docs/apply/index.md has a page for each controller: how it writes its frames"""

FURTHEST_TURN = 6.3
"""[rad]: a turn, with its rounding."""

FARTHEST_FRAME = 100.0
"""[m]: the longest rails of robots have half of it."""

ROUNDED = 1e-3
"""[m] and of a rotation's matrix: a listing in tenths of a millimetre and of a degree agrees with exact numbers within that."""


class ProgramFrameSettings(Settings):
    """A file of ``--frames``.

    Attributes:
        bases: T_base_frame of each frame that targets are in, by its name in the program, or its number in quotes.
        tools: T_tip_tool of each tool, likewise.
        start: Readings of the joints where the program begins, in the units of the program.
        harmless: Routines that no given file has, and that change nothing of frames, tools, modes and points.
        j3_from_link_2: FANUC: the controller counts J3 from link 2, as the URDF's joint, not from the horizontal.
        pulses_per_degree: Yaskawa: of each axis of the arm.
    """

    bases: Mapping[str, Placement] = Field(default_factory=dict)
    tools: Mapping[str, Placement] = Field(default_factory=dict)
    start: tuple[Number, ...] | None = None
    harmless: tuple[str, ...] = ()
    j3_from_link_2: bool = False
    pulses_per_degree: tuple[Number, ...] = ()


@dataclass(frozen=True)
class KnownFrames:
    """Frames by name, each of shape (4, 4), [m].

    Attributes:
        bases: Where targets are.
        tools: What is to be there.
        start: See :class:`ProgramFrameSettings`.
        harmless: Likewise, in small letters.
        j3_from_link_2: Likewise.
        pulses_per_degree: Likewise.
    """

    bases: Mapping[str, np.ndarray] = field(default_factory=dict)
    tools: Mapping[str, np.ndarray] = field(default_factory=dict)
    start: tuple[float, ...] | None = None
    harmless: frozenset[str] = frozenset()
    j3_from_link_2: bool = False
    pulses_per_degree: tuple[float, ...] = ()


def read_frames(path: Path | None) -> KnownFrames:
    """Read a file of frames; none if there is no file.

    Raises:
        CampaignError: naming file, line and key of what is wrong.
    """
    if path is None:
        return KnownFrames()
    try:
        settings = load_settings(path, ProgramFrameSettings)
    except CampaignError as problem:
        raise CampaignError(f"{problem}\n{EXAMPLE}" if path.is_file() else str(problem)) from None
    if settings.pulses_per_degree and (
        len(settings.pulses_per_degree) != MOST_AXES or 0.0 in settings.pulses_per_degree
    ):
        raise CampaignError(f"{path}: pulses_per_degree: should be {MOST_AXES} numbers, none of them 0: of S L U R B T")
    harmless = frozenset(name.lower() for name in settings.harmless)
    bases, tools = (_poses(path, kind, getattr(settings, kind)) for kind in ("bases", "tools"))
    return KnownFrames(bases, tools, settings.start, harmless, settings.j3_from_link_2, settings.pulses_per_degree)


def fixed_base(robot: Robot) -> np.ndarray | None:
    """Where the URDF has the link `base`, in the campaign's base, T of shape (4, 4); None where no such link is fixed to that.

    Descriptions of ROS-Industrial, and those of Universal Robots, have it for the controller's base, beside `base_link`.
    """
    tree, link, T = read_tree(robot.urdf, robot.path), "base", np.eye(4)
    while link != robot.base:
        parent, joint = tree.parent_of.get(link, ("", None))
        if joint is None or joint.get("name") in tree.moves:
            return None
        link, T = parent, tree.origins[str(joint.get("name"))].homogeneous @ T
    return T


def _poses(path: Path, kind: str, placements: Mapping[str, Placement]) -> dict[str, np.ndarray]:
    """Frames by name in small letters, if they are in metres and radians as far as one can see.

    Raises:
        CampaignError: a frame is nowhere in a cell, turned by more than once, or two have one name.
    """
    poses: dict[str, np.ndarray] = {}
    for name, placement in placements.items():
        where = f"{path}: {kind}: {name}"
        if max(map(abs, placement.rpy)) > FURTHEST_TURN:
            raise CampaignError(f"{where}: rpy is in radians, and {max(placement.rpy, key=abs):g} is more than a turn")
        if max(map(abs, placement.xyz)) > FARTHEST_FRAME:
            raise CampaignError(f"{where}: xyz is in metres, and {max(placement.xyz, key=abs):g} is in no cell")
        if name.lower() in poses:
            raise CampaignError(f"{where}: stands there twice, for names are compared in small letters")
        poses[name.lower()] = placement.homogeneous
    return poses


def joined_frames(
    kind: str, stated: Mapping[str, np.ndarray], below: Frame, listings: Sequence[Mapping[int, np.ndarray]]
) -> dict[int, Frame | Unknown]:
    """Frames by number that the user states and those of the controller; where they differ neither is certain.

    Args:
        kind: What messages call one.
        stated: By name, of the base or of the tip.
        below: What those of the controller are in.
        listings: Of the controller, by number, T of shape (4, 4), [m].
    """
    sources = [{int(name): Frame(T) for name, T in stated.items() if name.isdecimal() and len(name) < 10}]
    sources += [{number: below @ Frame(T) for number, T in listing.items()} for listing in listings]
    joined: dict[int, Frame | Unknown] = {}
    for source in sources:
        for number, frame in source.items():
            own = joined.setdefault(number, frame)
            if isinstance(own, Frame) and np.abs(own.T - frame.T).max() > ROUNDED:
                joined[number] = Unknown(
                    f"{kind} {number} is stated twice, not alike: in --frames or in listings of the controller"
                )
    return joined


def frames_set(
    codes: Sequence[Code],
    writes: Sequence[Sequence[tuple[str, int, int]]],
    walked: frozenset[int],
    stated: KnownFrames,
    every: tuple[Code, ...],
) -> dict[str, dict[int, str]]:
    """Frames and tools that given programs set, so that they may hold anything when a program begins, and where.

    What the user states is believed against programs that have nothing to do with those that are corrected.

    Args:
        codes: Of each program.
        writes: What each sets: ``frame`` or ``tool``, its number or :data:`ANY`, and the place in its text.
        walked: Numbers of the programs that are corrected, and of those that they call.
        stated: By the user.
        every: Codes of the whole project.

    Returns:
        By ``frame`` and ``tool``, and by number, why it is not certain.
    """
    reasons: dict[str, dict[int, str]] = {"frame": {}, "tool": {}}
    believed = {"frame": stated.bases, "tool": stated.tools}
    for k, (code, own_writes) in enumerate(zip(codes, writes, strict=True)):
        for family, number, start in own_writes:
            if k in walked or (number != ANY and str(number) not in believed[family]):
                line = line_name(every, code, start)
                reasons[family].setdefault(number, f"{line} sets this user {family}, perhaps in a run before")
    return reasons


def absent(name: str) -> str:
    """Why nothing is certain behind a call of a routine that is in no given file."""
    return f"{name} is in no given file, and may change frames and points: give its file, or state it as `harmless` in --frames"


def unknown_frame(kind: str, name: str) -> str:
    """Why a target in a frame that only the controller has is left as it is."""
    return f"{kind} {name} is not in the program: state it with --frames"
