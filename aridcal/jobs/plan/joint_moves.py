"""Configurations as joint moves: programs in the languages that write them, and waypoints for MoveIt.

Each configuration is an exact stop, after which the program waits until arm and instrument are still. Where a joint is to come
from one side, a point on the way comes first, through which the arm passes without a measurement. Programs go slowly, as the ways
between configurations are not looked at.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
import yaml

from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.languages import LANGUAGES
from aridcal.jobs.apply.programs.moves import ARM_AXES, Moves, Stop
from aridcal.system.errors import OutputError, shortened

LONGEST_PROGRAM_NAME = 24
"""Letters of a KRL program's name."""

WAYPOINTS = ".yaml"
"""Ending of the only form whose reader plans the ways itself."""

WRITERS: dict[str, Language] = {language.endings[0]: language for language in LANGUAGES if language.write is not None}
"""Languages that plans are written in, by the ending of a file's name."""

PROGRAMS = (*WRITERS, WAYPOINTS)


def moves(
    title: str,
    names: tuple[str, ...],
    kinds: tuple[str, ...],
    readings: np.ndarray,
    via: np.ndarray,
    labels: Sequence[str],
    settle: float,
    more: tuple[str, ...] = (),
) -> Moves:
    """The stops of a program: each configuration, after the way point of its approach.

    Args:
        title: See :class:`Moves`, as ``names``, ``kinds``, ``settle`` and ``more``.
        names: Of the joints' readings.
        kinds: Of the joints.
        readings: Shape (n, columns), [rad] or [m].
        via: Likewise; NaN where there is none.
        labels: What is measured at each.
        settle: [s].
        more: Further notes.
    """
    stops = []
    for number, (reading, way_point, label) in enumerate(zip(readings, via, labels, strict=True), start=1):
        if np.isfinite(way_point).all():
            stops.append(Stop(way_point, 0, ""))
        stops.append(Stop(reading, number, label))
    return Moves(title, names, kinds, tuple(stops), settle, more)


def check_program(ending: str, stem: str, kinds: tuple[str, ...]) -> None:
    """Make sure that a program can be written, before any work is done for it.

    Args:
        ending: Of the file's name, one of :data:`PROGRAMS`.
        stem: Of the file's name.
        kinds: Of the joints.

    Raises:
        OutputError: the language has no such arm, or no program of such a name.
    """
    language = WRITERS.get(ending)
    if language is None:
        return
    if not re.fullmatch(rf"[A-Za-z][A-Za-z0-9_]{{0,{LONGEST_PROGRAM_NAME - 1}}}", stem):
        raise OutputError(
            f"{shortened(stem)}{ending}: a program in {language.name} has the name of its file, so that should be a letter, and "
            f"then letters, digits and _, {LONGEST_PROGRAM_NAME} in all at the most; give it such a name"
        )
    sliding = kinds.count("prismatic")
    turning = len(kinds) - sliding
    if turning != ARM_AXES or sliding > language.external:
        beside = f" and at most {language.external} external ones that slide" if language.external else ""
        raise OutputError(
            f"{stem}{ending}: {language.name} is for arms of {ARM_AXES} revolute joints{beside}; this one has "
            f"{turning} revolute and {sliding} prismatic: write .csv or .yaml, and make moves of these in your "
            "controller's own way"
        )


def program(motion: Moves, ending: str, stem: str) -> str:
    """The text of a file; see :func:`check_program`."""
    write = WRITERS[ending].write if ending in WRITERS else _waypoints
    assert write is not None
    return "".join(f"{line}\n" for line in write(motion, stem))


def _waypoints(motion: Moves, stem: str) -> Iterator[str]:
    """ROS: names and positions as in `trajectory_msgs/JointTrajectory`; MoveIt plans the ways itself."""
    yield from (f"# {note}" for note in motion.notes[:-1])
    yield "# rad and m; plan to `positions` of each point in turn, and measure where `configuration` is not 0"
    points = [
        {
            "configuration": stop.number,
            **({"label": stop.label} if stop.label else {}),
            "positions": [round(value, 9) for value in stop.readings.tolist()],
        }
        for stop in motion.stops
    ]
    document = {"joint_names": list(motion.names), "settle": motion.settle, "points": points}
    yield yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=10_000, allow_unicode=True).rstrip()
