"""What a program does with each of its points: do all moves mean one place by its numbers, and does nothing else use them?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from aridcal.jobs.apply.programs.targets import PoseReference, Target
from aridcal.jobs.apply.programs.text import Code
from aridcal.jobs.apply.programs.walk import Unknown

ANY = -1
"""Number that stands for every point, frame or tool: which one is meant, the text alone does not say."""

NEVER = "no move of the given files goes there, so that its frame and tool are not known"

SAME_FRAME = 1e-9
"""[m] and of a rotation's matrix: frames that differ by rounding are the same."""


@dataclass(frozen=True)
class Frame:
    """A transform of shape (4, 4), [m], as a value of a state."""

    T: np.ndarray

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Frame) and (self.T is other.T or bool(np.abs(self.T - other.T).max() < SAME_FRAME))

    def __matmul__(self, other: Frame) -> Frame:
        return Frame(self.T @ other.T)

    __hash__ = None  # type: ignore[assignment]  # what is nearly equal has no hash


HERE = Frame(np.eye(4))
"""No transform."""


def product(*factors: object) -> Frame | Unknown:
    """The product of frames, each of which may be unknown."""
    T = HERE
    for factor in factors:
        if isinstance(factor, Unknown):
            return factor
        assert isinstance(factor, Frame)
        T = T @ factor
    return T


class Use(NamedTuple):
    """How a move comes to a point.

    Attributes:
        line: Where the move stands, as messages say it: ``line 12``, with the file where there are several.
        base: :class:`Frame` that the point is in, or :class:`Unknown`.
        tool: Frame of the tip that is to be there, likewise.
        aside: The move goes to a place a constant way off from the point, which base and tool contain.
        why: Why the numbers are not to be corrected for this move; empty if they may be.
        near: Readings that the controller starts from, where the program states them.
        unknown: Why it is not known where the arm comes from; empty where it is known or does not matter.
        mode: Anything else in which uses must agree.
    """

    line: str
    base: object = HERE
    tool: object = HERE
    aside: bool = False
    why: str = ""
    near: tuple[float, ...] | None = None
    unknown: str = ""
    mode: str = ""

    @property
    def trouble(self) -> str:
        """Why the place is not known; empty if it is."""
        base, tool = self.base, self.tool
        return self.why or (base.why if isinstance(base, Unknown) else tool.why if isinstance(tool, Unknown) else "")

    @property
    def place(self) -> PoseReference:
        """The frame and the tool, of a use without trouble."""
        assert isinstance(self.base, Frame) and isinstance(self.tool, Frame)
        return PoseReference(self.base.T, self.tool.T)

    def same(self, other: Use) -> bool:
        """True where both mean the same place of the same tip, in the same way."""
        return (self.base, self.tool, self.mode, self.near) == (other.base, other.tool, other.mode, other.near)

    def agrees(self, stated: Use) -> bool:
        """True where this means what another use states; one that says nothing of where it starts keeps the arm as it stands."""
        near = self.near == stated.near or (self.near is None and not self.unknown)
        return near and (self.base, self.tool, self.mode) == (stated.base, stated.tool, stated.mode)


What = TypeVar("What")
"""What a language calls a point of its text."""

Make = Callable[[What, Use, tuple[PoseReference, ...]], Target]
"""Turns a point, its use and its other places into a target without a reason."""


@dataclass(slots=True)
class _Point(Generic[What]):
    what: What
    uses: tuple[Use, ...] = ()
    spoilt: str = ""


@dataclass
class Ledger(Generic[What]):
    """All that a program does with its points, in the order of the walk.

    A point is a literal of the text, named by its file and its place there.
    """

    _points: dict[tuple[int, int], _Point[What]] = field(default_factory=dict)
    _frames: dict[bytes, Frame] = field(default_factory=dict)
    _kept: dict[int, Frame] = field(default_factory=dict)
    _vague: dict[tuple[int, int, str], Target] = field(default_factory=dict)

    def declare(self, key: tuple[int, int], what: What) -> None:
        """A point stands in the text; it is named in the answer even if nothing uses it."""
        if key not in self._points:
            self._points[key] = _Point(what)

    def go(self, key: tuple[int, int], use: Use) -> None:
        """A move goes to a declared point. Its first use decides where it comes among the targets."""
        point = self._points.pop(key) if not self._points[key].uses else self._points[key]
        self._points.setdefault(key, point)
        if not any(use.same(other) and use.trouble == other.trouble for other in point.uses):
            point.uses += (use,)

    def spoil(self, key: tuple[int, int], why: str) -> None:
        """Something else than a move uses the numbers of a declared point: they must stay."""
        point = self._points[key]
        point.spoilt = point.spoilt or why

    def leave(self, target: Target) -> None:
        """A move goes to a place that no plain numbers of the text say: named, with the reason in ``target.why``."""
        self._vague.setdefault((target.file, target.line, target.name), target)

    def targets(self, make: Make[What]) -> list[Target]:
        """Each point once: those that moves go to in the order of the walk, then what is left. The ledger is empty then.

        Args:
            make: Called once for each point, when all is known.
        """
        targets = list(self._read(make))
        targets += self._vague.values()
        self._vague.clear()
        return targets

    def _read(self, make: Make[What]) -> Iterator[Target]:
        """Targets of points; each point is dropped for its target, for a long program has many of both."""
        points = sorted(self._points.values(), key=lambda point: not point.uses)
        self._points.clear()
        points.reverse()
        while points:
            yield self._target(points.pop(), make)

    def _target(self, point: _Point[What], make: Make[What]) -> Target:
        """The target of a point; with a reason where not all that uses it means the same."""
        uses = point.uses or (Use("", Unknown(NEVER), Unknown(NEVER)),)
        direct = tuple([use for use in uses if not use.aside]) or uses if len(uses) > 1 else uses
        first = next((use for use in direct if use.near is not None), direct[0])
        trouble = point.spoilt or next((use.trouble for use in uses if use.trouble), "")
        if not trouble and len(direct) > 1:
            other = next((use for use in direct if not use.agrees(first)), None)
            if other is not None:
                trouble = _two_meanings(first, other)
        if trouble:
            return _with_reason(make(point.what, Use(first.line, HERE, HERE), ()), trouble)
        beside = tuple([use.place for use in uses if use is not first and use.aside and not use.same(first)])
        unknown = next((use.unknown for use in direct if use.unknown), "")
        base, tool = self._one(first.base), self._one(first.tool)
        if base is first.base and tool is first.tool and unknown == first.unknown:
            return make(point.what, first, beside)
        settled = Use(first.line, base, tool, first.aside, first.why, first.near, unknown, first.mode)
        return make(point.what, settled, beside)

    def _one(self, frame: object) -> object:
        """One frame for all that are equal to the last bit: a long program has a hundred thousand of a few."""
        if not isinstance(frame, Frame) or self._kept.get(id(frame)) is frame:
            return frame
        one = self._frames.setdefault(frame.T.tobytes(), frame)
        self._kept[id(one)] = one
        return one


def _two_meanings(first: Use, other: Use) -> str:
    parts = [
        ("frame", first.base == other.base),
        ("tool", first.tool == other.tool),
        ("way off the point", first.aside == other.aside),
        ("way of moving", (first.mode, first.near) == (other.mode, other.near)),
    ]
    what = next((name for name, same in parts if not same), "place")
    return f"{first.line} and {other.line} go there with another {what} each: give each its own point"


def _with_reason(target: Target, why: str) -> Target:
    return Target(target.line, target.name, target.form, target.numbers, target.why or why, file=target.file)


def line_name(codes: tuple[Code, ...], code: Code, place: int) -> str:
    """How messages name a line: with its file where there are several."""
    line = f"line {code.line(place)}"
    return line if len(codes) == 1 else f"{code.name} {line}"
