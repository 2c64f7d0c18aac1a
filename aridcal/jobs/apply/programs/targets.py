"""Targets of a robot program: where their numbers stand in the text, and what they mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from aridcal.jobs.apply.programs.text import NONE, Numbers


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


@dataclass(frozen=True, slots=True)
class Words:
    """What stands in the program of the arm's posture beside a pose: KUKA's S and T, ABB's confdata, FANUC's CONFIG.

    Attributes:
        numbers: Where it stands.
        texts: For readings, shape (columns,), what should stand there; None where no words describe them, or nobody knows which.
            What stands there in the program and agrees with the readings is given back as it is.
        written: What the language calls them, for messages, with a pair of braces for what stands there: ``S {}, T {}``.
    """

    numbers: Numbers
    texts: Callable[[np.ndarray], tuple[str, ...] | None]
    written: str

    @property
    def names(self) -> str:
        """What the language calls them, and what stands there: ``S 2, T 10`` for instance."""
        return self.written.format(*self.stated)

    @property
    def stated(self) -> tuple[str, ...]:
        """What stands there."""
        return tuple(self.numbers.texts)

    def agree(self, readings: np.ndarray) -> bool:
        """Whether what stands in the program is the posture of readings, shape (columns,)."""
        return self.texts(readings) == self.stated


@dataclass(frozen=True, slots=True)
class Shared:
    """What stands once in a program for the posture of several targets, and is not read: Yaskawa's RCONF.

    None of them can have it written anew, so that all of one text must stand on the same sides, before and once corrected.

    Attributes:
        name: For messages, with what stands there; the same for all that it is for.
        sides: Of readings, shape (columns,): on which side of each boundary they are that it may count.
    """

    name: str
    sides: Callable[[np.ndarray], tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class Branch:
    """What a program says of the arm's position beside the pose, in readings [rad] or [m].

    Attributes:
        words: Its posture in words; None where it says nothing.
        near: Readings to start from, shape (columns,), NaN where nothing is said; None: those of the target before.
        held: Readings that are to stay as they are, external axes for instance, shape (columns,), NaN where none is.
        nearest: Of several positions that fit the controller takes the nearest to ``near``, or to the target before.
        unknown: Why it is not known where the arm comes from; empty where it is, or where that does not matter.
        shared: Its posture, where that stands once for several targets.
    """

    words: Words | None = None
    near: np.ndarray | None = None
    held: np.ndarray | None = None
    nearest: bool = False
    unknown: str = ""
    shared: Shared | None = None


NOTHING_SAID = Branch()
"""A program that says nothing of the arm's position beside the pose."""


@dataclass(frozen=True, slots=True)
class PoseReference:
    """Where the numbers of a pose are meant.

    Attributes:
        base: T_base_frame of the frame that it is in, shape (4, 4).
        tool: T_tip_tool of the tool that is to be there, shape (4, 4).
    """

    base: np.ndarray
    tool: np.ndarray


@dataclass(frozen=True, slots=True)
class Target:
    """One place that a program sends the robot to.

    Attributes:
        line: Of the file, from 1, where it stands.
        name: What the program calls it, or how it stands there.
        form: Of its numbers: ``joints`` or a ``pose``.
        numbers: Where they stand; none where they are not plain.
        why: Why it cannot be corrected; empty if it can be.
        readings: Of joints, also of those that are left where it is known where they are: shape (columns,), [rad] or [m]; NaN
            where the program says nothing, so that the last one holds.
        units: Of joints: what one unit of each of ``numbers`` is, [rad] or [m], and which reading it belongs to.
        notation: Of a pose: how it is written.
        place: Of a pose: its frame and tool.
        beside: Of a pose: other frames and tools that it is used with, by a constant way off: an approach for instance. They
            take part in the correction as it is, which is right at ``place``.
        branch: Of a pose: the arm's position.
        digits: Of joints: behind the point.
        file: Of the project, its index.
    """

    line: int
    name: str
    form: Literal["joints", "pose"]
    numbers: Numbers = NONE
    why: str = ""
    readings: np.ndarray | None = None
    units: tuple[tuple[float, int], ...] = ()
    notation: Notation | None = None
    place: PoseReference | None = None
    beside: tuple[PoseReference, ...] = ()
    branch: Branch = NOTHING_SAID
    digits: int = 6
    file: int = 0

    @property
    def values(self) -> np.ndarray:
        """Its numbers, shape (numbers,), in the program's units."""
        return np.array([float(text) for text in self.numbers.texts])

    @property
    def places(self) -> tuple[int, ...]:
        """Digits behind the point of each of its numbers, at least."""
        return self.notation.digits if self.notation is not None else (self.digits,) * len(self.numbers)
