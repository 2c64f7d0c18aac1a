"""Targets of a robot program: where their numbers stand in the text, what they mean, and the text with other numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
"""A number as all these languages write it."""


@dataclass(frozen=True)
class Number:
    """A number of the program.

    Attributes:
        start: Its first letter's place in the text.
        text: As it stands there.
    """

    start: int
    text: str

    @property
    def end(self) -> int:
        """The place behind its last letter."""
        return self.start + len(self.text)

    @property
    def value(self) -> float:
        """What it says."""
        return float(self.text)


def number(match: re.Match[str], group: int | str = 0) -> Number:
    """The number that a group of a match is."""
    return Number(match.start(group), match.group(group))


@dataclass(frozen=True)
class Notation:
    """How a language writes a pose as numbers.

    Attributes:
        pose: Numbers to a pose, shape (4, 4), [m].
        numbers: A pose, and the numbers that stood there, to numbers: of all that say the same, the nearest to them.
        digits: Behind the point, for each number: what rounds a target by a micrometre or so, or what the language writes.
    """

    pose: Callable[[np.ndarray], np.ndarray]
    numbers: Callable[[np.ndarray, np.ndarray], np.ndarray]
    digits: tuple[int, ...]


@dataclass(frozen=True)
class Branch:
    """What a program says of the arm's position beside the pose, in readings [rad] or [m].

    Attributes:
        fits: Whether readings, shape (columns,), agree with it.
        near: Readings to start from, shape (columns,), NaN where nothing is said; None: those of the target before.
        held: Readings that are to stay as they are, external axes for instance, shape (columns,), NaN where none is.
        settled: With that the position is known: of several that fit, the controller itself takes the nearest.
        letters: How the arm stands in the three letters of FANUC, ``NUT`` for instance; empty where nothing is said.
    """

    fits: Callable[[np.ndarray], bool] = field(default=lambda q: True)
    near: np.ndarray | None = None
    held: np.ndarray | None = None
    settled: bool = False
    letters: str = ""


@dataclass(frozen=True)
class Target:
    """One place that a program sends the robot to.

    Attributes:
        line: Of the text, from 1.
        name: What the program calls it, or how it stands there.
        form: Of its numbers: ``joints`` or a ``pose``.
        numbers: Where they stand.
        why: Why it cannot be corrected; empty if it can be.
        readings: Of joints: shape (columns,), [rad] or [m]; NaN where the program says nothing, so that the last one holds.
        units: Of joints: what one unit of each of ``numbers`` is, [rad] or [m], and which reading it belongs to.
        notation: Of a pose: how it is written.
        base: Of a pose: T_base_frame of the frame that it is in, shape (4, 4).
        tool: Of a pose: T_tip_tool of the tool that is to be there, shape (4, 4).
        branch: Of a pose: the arm's position.
        digits: Of joints: behind the point.
    """

    line: int
    name: str
    form: Literal["joints", "pose"]
    numbers: tuple[Number, ...]
    why: str = ""
    readings: np.ndarray | None = None
    units: tuple[tuple[float, int], ...] = ()
    notation: Notation | None = None
    base: np.ndarray | None = None
    tool: np.ndarray | None = None
    branch: Branch = field(default_factory=Branch)
    digits: int = 6

    @property
    def values(self) -> np.ndarray:
        """Its numbers, shape (numbers,), in the program's units."""
        return np.array([n.value for n in self.numbers])

    @property
    def places(self) -> tuple[int, ...]:
        """Digits behind the point of each of its numbers, at least."""
        return self.notation.digits if self.notation is not None else (self.digits,) * len(self.numbers)


def line_of(text: str, place: int) -> int:
    """The line of a place in a text, from 1."""
    return text.count("\n", 0, place) + 1


def written(value: float, before: str, digits: int) -> str:
    """A number in place of another: as many digits behind the point as that had, or more where they are needed."""
    own = before.lower().split("e")[0]
    had = len(own.split(".")[1]) if "." in own else 0
    text = f"{value:.{max(had, digits)}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def spliced(text: str, changes: Sequence[tuple[Number, str]]) -> str:
    """The text with other numbers; all else stays."""
    parts, end = [], 0
    for old, new in sorted(changes, key=lambda change: change[0].start):
        parts += [text[end : old.start], new]
        end = old.end
    return "".join([*parts, text[end:]])


def blanked(text: str, comments: str) -> str:
    """The text with comments and strings as blanks, so that every place keeps its number.

    Args:
        text: The program.
        comments: A regular expression of strings and comments of the language.
    """
    return re.sub(comments, lambda found: re.sub(r"[^\n]", " ", found.group()), text)


def split_arguments(text: str, start: int, end: int) -> list[tuple[int, int]]:
    """Places of what commas part between two places, brackets of any kind kept whole; blanks at the ends left out."""
    depth, begin, found = 0, start, []
    for place in range(start, end):
        letter = text[place]
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            found.append((begin, place))
            begin = place + 1
    found.append((begin, end))
    return [_trimmed(text, *span) for span in found]


def _trimmed(text: str, start: int, end: int) -> tuple[int, int]:
    while start < end and text[start].isspace():
        start += 1
    while end > start and text[end - 1].isspace():
        end -= 1
    return start, end


def closing(text: str, place: int) -> int:
    """The place of the bracket that closes the one at a place; -1 if none does."""
    depth = 0
    for at in range(place, len(text)):
        depth += (text[at] in "([{") - (text[at] in ")]}")
        if depth == 0:
            return at
    return -1
