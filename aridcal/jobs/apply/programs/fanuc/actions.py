"""What single instructions of a TP program do, as the walk is given them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from aridcal.jobs.apply.programs.fanuc.table import Option
from aridcal.jobs.apply.programs.walk import Body, Choice, Repeat, Step

Fields = tuple[tuple[str, str], ...]
"""Parts of an instruction by name."""

Options = tuple[tuple[Option, Fields], ...]
"""Options of a move, and parts of them."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a motion instruction goes.

    Attributes:
        kind: P, PR, LPR or PAL_...
        index: What stands in the brackets.
    """

    kind: str
    index: str

    @property
    def point(self) -> int | None:
        """The number of a point of the program."""
        return int(self.index) if self.kind == "P" and short(self.index) else None


class Action(NamedTuple):
    """What an instruction does to the state.

    Attributes:
        does: ``move``, one of the table's changes, ``mode``, or ``unknown``.
        program: Index of the listing.
        start: Of the instruction in its text.
        fields: Parts of it by name.
        how: Of a move: J, L, C, A or S.
        places: Of a move.
        options: Of a move.
        raw: The instruction as it stands there.
    """

    does: str
    program: int
    start: int
    fields: Fields = ()
    how: str = ""
    places: tuple[Place, ...] = ()
    options: Options = ()
    raw: str = ""

    def at(self, start: int) -> Action:
        """The same at another place."""
        return Action(self.does, self.program, start, self.fields, self.how, self.places, self.options, self.raw)

    def field(self, name: str) -> str:
        """A part; empty if it is not there."""
        return next((value for own, value in self.fields if own == name), "") or ""


def actions(body: Body) -> Iterator[Action]:
    """All that a body does, in whatever order."""
    for node in body:
        if isinstance(node, Step):
            assert isinstance(node.what, Action)
            yield node.what
        elif isinstance(node, Choice):
            for way in node.ways:
                yield from actions(way)
        elif isinstance(node, Repeat):
            yield from actions(node.body)


def robot_group(index: str) -> str | None:
    """What stands in brackets without group 1; None where it is of another group."""
    return index.removeprefix("GP1:") if not index.startswith("GP") or index.startswith("GP1:") else None


def short(index: str) -> bool:
    """Whether it is a number of a register, a frame or a point."""
    return index.isdecimal() and len(index) < 10
