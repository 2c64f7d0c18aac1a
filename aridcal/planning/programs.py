"""Configurations as joint moves: URScript, KRL, RAPID, and waypoints for MoveIt.

Each configuration is an exact stop, after which the program waits until arm and instrument are still. Where a joint is to come
from one side, a point on the way comes first, through which the arm passes without a measurement. Programs go slowly, as the ways
between configurations are not looked at.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import yaml

from aridcal import __version__
from aridcal.errors import OutputError, printable, shortened

AXES = 6
"""Axes of an arm in KRL and RAPID, and as many external ones; joints of a UR."""

SPEED = 0.3
"""[rad/s] of URScript's moves, and half of it in a second: a tenth of what these arms can."""

PERCENT = 10
"""The same of KRL's, in per cent of the fastest."""

LONGEST = 24
"""Letters of a KRL program's name."""

NOT_USED = "9E+09"
"""RAPID's value of an external axis that there is not."""


@dataclass(frozen=True)
class Stop:
    """One place of a program.

    Attributes:
        readings: Of the joints, shape (columns,), [rad] or [m].
        number: Of the configuration that is measured here, from 1; 0 for a point on the way.
        label: What is measured there.
    """

    readings: np.ndarray
    number: int
    label: str


@dataclass(frozen=True)
class Moves:
    """What a program does.

    Attributes:
        title: Of the campaign, for a comment.
        names: Of the joints' readings.
        kinds: Of the joints.
        stops: In their order.
        settle: What it waits at each configuration, [s].
    """

    title: str
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    stops: tuple[Stop, ...]
    settle: float

    @property
    def notes(self) -> tuple[str, ...]:
        """What whoever runs it should know, for comments."""
        count = sum(stop.number > 0 for stop in self.stops)
        return (
            f"{count} configurations to measure, planned by aridcal {__version__} for {_word(self.title)}",
            f"joints in this order: {', '.join(_word(name) for name in self.names)}",
            f"stops {self.settle:g} s at each configuration; points on the way only decide from which side joints come",
            "the ways between were NOT looked at: run it slowly, with a hand on the stop button",
        )


def moves(
    title: str,
    names: tuple[str, ...],
    kinds: tuple[str, ...],
    readings: np.ndarray,
    via: np.ndarray,
    labels: Sequence[str],
    settle: float,
) -> Moves:
    """The places of a program: each configuration, after the point by way of which it is come to.

    Args:
        title: See :class:`Moves`, as ``names``, ``kinds`` and ``settle``.
        names: Of the joints' readings.
        kinds: Of the joints.
        readings: Shape (n, columns), [rad] or [m].
        via: Likewise; NaN where there is none.
        labels: What is measured at each.
        settle: [s].
    """
    stops = []
    for number, (own, before, label) in enumerate(zip(readings, via, labels, strict=True), start=1):
        if np.isfinite(before).all():
            stops.append(Stop(before, 0, ""))
        stops.append(Stop(own, number, label))
    return Moves(title, names, kinds, tuple(stops), settle)


def check_program(ending: str, stem: str, kinds: tuple[str, ...]) -> None:
    """Make sure that a program can be written, before any work is done for it.

    Args:
        ending: Of the file's name, a key of :data:`LANGUAGES`.
        stem: Of the file's name.
        kinds: Of the joints.

    Raises:
        OutputError: the language has no such arm, or no program of such a name.
    """
    language, most_outside, _ = LANGUAGES[ending]
    if most_outside is None:
        return
    if not re.fullmatch(rf"[A-Za-z][A-Za-z0-9_]{{0,{LONGEST - 1}}}", stem):
        raise OutputError(
            f"{shortened(stem)}{ending}: a program in {language} has the name of its file, so that should be a letter, and then "
            f"letters, digits and _, {LONGEST} in all at the most; give it such a name"
        )
    sliding = kinds.count("prismatic")
    turning = len(kinds) - sliding
    if turning != AXES or sliding > most_outside:
        beside = f" and at most {most_outside} external ones that slide" if most_outside else ""
        raise OutputError(
            f"{stem}{ending}: {language} is for arms of {AXES} revolute joints{beside}; this one has "
            f"{turning} revolute and {sliding} prismatic: write .csv or .yaml, and make moves of these in your "
            "controller's own way"
        )


def program(made: Moves, ending: str, stem: str) -> str:
    """The text of a file; see :func:`check_program`."""
    return "".join(f"{line}\n" for line in LANGUAGES[ending][2](made, stem))


def _urscript(made: Moves, stem: str) -> Iterator[str]:
    """Universal Robots: `movej` with a blend radius of 0 stops exactly."""
    yield f"def {stem}():"
    yield from (f"  # {note}" for note in made.notes)
    for stop in made.stops:
        q = ", ".join(f"{value:.6f}" for value in stop.readings.tolist())
        yield f"  movej([{q}], a={SPEED / 2:g}, v={SPEED:g})"
        if stop.number:
            yield f"  # configuration {stop.number}{_of(stop)}"
            yield f'  textmsg("configuration {stop.number}")'
            yield f"  sleep({made.settle:.3f})"
    yield "end"


def _krl(made: Moves, stem: str) -> Iterator[str]:
    """KUKA: `PTP` to an axis position without approximation stops exactly, and no instruction is carried out ahead of `WAIT`."""
    axes = _axes(made)
    yield f"DEF {stem}( )"
    yield from (f"  ; {note}" for note in made.notes)
    yield "  BAS(#INITMOV, 0)"
    yield f"  BAS(#VEL_PTP, {PERCENT})"
    for stop in made.stops:
        values = [f"{axis} {value:.5f}" for axis, value in zip(axes, _shown(made, stop), strict=True)]
        yield f"  PTP {{{', '.join(values)}}}"
        if stop.number:
            yield f"  ; configuration {stop.number}{_of(stop)}"
            yield f"  WAIT SEC {made.settle:.3f}"
    yield "END"


def _rapid(made: Moves, stem: str) -> Iterator[str]:
    """ABB: `MoveAbsJ` to a zone of `fine` stops exactly."""
    axes = _axes(made)
    yield f"MODULE {stem}"
    yield from (f"  ! {note}" for note in made.notes)
    yield f"  PROC {stem}_run()"
    for stop in made.stops:
        value = dict(zip(axes, (f"{v:.5f}" for v in _shown(made, stop)), strict=True))
        arm, outside = (
            ", ".join(value.get(f"{letter}{k}", NOT_USED) for k in range(1, AXES + 1)) for letter in ("A", "E")
        )
        yield f"    MoveAbsJ [[{arm}], [{outside}]] \\NoEOffs, v100, fine, tool0;"
        if stop.number:
            yield f"    ! configuration {stop.number}{_of(stop)}"
            yield f'    TPWrite "configuration {stop.number}";'
            yield f"    WaitTime \\InPos, {made.settle:.3f};"
    yield "  ENDPROC"
    yield "ENDMODULE"


def _moveit(made: Moves, stem: str) -> Iterator[str]:
    """ROS: names and positions as in `trajectory_msgs/JointTrajectory`; MoveIt plans the ways itself."""
    yield from (f"# {note}" for note in made.notes[:3])
    yield "# rad and m; plan to `positions` of each point in turn, and measure where `configuration` is not 0"
    points = [
        {
            "configuration": stop.number,
            **({"label": stop.label} if stop.label else {}),
            "positions": [round(value, 9) for value in stop.readings.tolist()],
        }
        for stop in made.stops
    ]
    document = {"joint_names": list(made.names), "settle": made.settle, "points": points}
    yield yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=10_000, allow_unicode=True).rstrip()


WAYPOINTS = ".yaml"
"""Ending of the only one whose reader plans the ways itself."""

LANGUAGES: dict[str, tuple[str, int | None, Callable[[Moves, str], Iterator[str]]]] = {
    ".script": ("URScript", 0, _urscript),
    ".src": ("KRL", AXES, _krl),
    ".mod": ("RAPID", AXES, _rapid),
    WAYPOINTS: ("YAML", None, _moveit),
}
"""By the ending of a file's name: the language, how many external axes it has beside an arm's six (None: any arm), and what
writes it."""


def _axes(made: Moves) -> list[str]:
    """Axes of a controller for each joint: revolute ones are the arm's, prismatic ones are external."""
    arm, outside = (iter([f"{letter}{k}" for k in range(1, AXES + 1)]) for letter in ("A", "E"))
    return [next(outside) if kind == "prismatic" else next(arm) for kind in made.kinds]


def _shown(made: Moves, stop: Stop) -> list[float]:
    """Readings in degrees and millimetres."""
    return [
        1e3 * value if kind == "prismatic" else math.degrees(value)
        for kind, value in zip(made.kinds, stop.readings.tolist(), strict=True)
    ]


def _of(stop: Stop) -> str:
    """What is measured, for a comment."""
    return f", {_word(stop.label)}" if stop.label else ""


def _word(text: str) -> str:
    """A name that stays inside a comment of one line, in letters that every controller reads."""
    return shortened(printable(text)).encode("ascii", "replace").decode()
