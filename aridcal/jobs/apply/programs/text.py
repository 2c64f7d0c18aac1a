"""A program's text: places, lines and brackets of it, each found once for the whole text."""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

NUMBER = re.compile(r"[-+]?+(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?+\d++)?")
"""A number as all these languages write it; nothing of it is given back, so that rows of digits are read once."""

NUL = "\0"
"""No number has it in its text."""

LARGEST_IN_PROGRAM = 1e6
"""In any unit, metres or degrees: no arm has a larger number in a target, and none with one is corrected."""

BRACKET = re.compile(r"[()\[\]{}]")

BRACKET_SEARCH_LETTERS = 500
"""Letters in which a bracket's closing one is looked for first: a line or two, where most are."""

CLOSES = {"(": ")", "[": "]", "{": "}"}


@dataclass(frozen=True, slots=True)
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


class Numbers(Sequence[Number]):
    """Numbers of a target, packed: a long program has a million of them.

    Args:
        numbers: Where they stand, and their texts.
    """

    __slots__ = ("joined", "starts")

    def __init__(self, numbers: Iterable[Number] = ()) -> None:
        own = tuple(numbers)
        self.starts = array("I", [n.start for n in own])
        self.joined = NUL.join([n.text for n in own])

    @classmethod
    def packed(cls, spans: Iterable[tuple[int, int]], texts: Iterable[str]) -> Numbers:
        """Numbers by where they stand, first letter and end, and what stands there."""
        own = cls.__new__(cls)
        own.starts = array("I", [start for start, _ in spans])
        own.joined = NUL.join(texts)
        return own

    @property
    def texts(self) -> list[str]:
        """What stands there."""
        return self.joined.split(NUL) if self.starts else []

    def __len__(self) -> int:
        return len(self.starts)

    @overload
    def __getitem__(self, k: int) -> Number: ...

    @overload
    def __getitem__(self, k: slice) -> tuple[Number, ...]: ...

    def __getitem__(self, k: int | slice) -> Number | tuple[Number, ...]:
        return Number(self.starts[k], self.texts[k]) if isinstance(k, int) else tuple(self)[k]

    def __iter__(self) -> Iterator[Number]:
        return map(Number, self.starts, self.texts)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))


NONE = Numbers()


def number(match: re.Match[str], group: int | str = 0) -> Number:
    """The number that a group of a match is."""
    return Number(match.start(group), match.group(group))


@dataclass(frozen=True)
class Code:
    """The text of one file of a project.

    Attributes:
        file: Its index in the project.
        name: For messages.
        text: As it stands, each byte a letter.
        plain: The same with comments and strings as blanks, so that every place keeps its number.
    """

    file: int
    name: str
    text: str
    plain: str

    @cached_property
    def _starts(self) -> array[int]:
        return array("I", [0, *(m.end() for m in re.finditer("\n", self.text))])

    @cached_property
    def _pairs(self) -> tuple[array[int], array[int]]:
        return bracket_pairs(self.plain)

    def line(self, place: int) -> int:
        """The line of a place, from 1."""
        return bisect_right(self._starts, place)

    def closing(self, place: int) -> int:
        """The place of the bracket that closes the one at a place; -1 if none does."""
        near = self._closing_near(place)
        if near:
            return near
        opening, closing = self._pairs
        k = bisect_left(opening, place)
        return closing[k] or -1 if k < len(opening) and opening[k] == place else -1

    def _closing_near(self, place: int) -> int:
        """The same where it is near, without a look at the whole text; 0 where that does not tell."""
        open_brackets = ""
        if self.plain[place : place + 1] not in CLOSES:
            return 0
        for match in BRACKET.finditer(self.plain, place, place + BRACKET_SEARCH_LETTERS):
            bracket = match.group()
            if bracket in CLOSES:
                open_brackets += CLOSES[bracket]
            elif not open_brackets.endswith(bracket):
                return 0
            elif len(open_brackets) == 1:
                return match.start()
            else:
                open_brackets = open_brackets[:-1]
        return 0

    def arguments(self, start: int, end: int) -> list[tuple[int, int]]:
        """Places of what commas part between two places, brackets of any kind kept whole; blanks at the ends left out.

        Nothing between the places is no argument.
        """
        spans, begin, place = [], start, start
        for match in re.compile(r"[,(\[{]").finditer(self.plain, start, end):
            if match.start() < place:  # inside of brackets that are passed over
                continue
            if match.group() == ",":
                spans.append(self.trimmed(begin, match.start()))
                begin = match.end()
            else:
                place = max(self.closing(match.start()), match.start())
        last = self.trimmed(begin, end)
        return [*spans, last] if spans or last[0] < last[1] else []

    def trimmed(self, start: int, end: int) -> tuple[int, int]:
        """A span without the blanks at its ends."""
        while start < end and self.plain[start].isspace():
            start += 1
        while end > start and self.plain[end - 1].isspace():
            end -= 1
        return start, end


def bracket_pairs(text: str) -> tuple[array[int], array[int]]:
    """Places of opening brackets that have their own closing one, in order, and those of these."""
    opening, closing = array("I"), array("I")
    open_brackets: list[int] = []  # numbers among the opening ones
    for match in BRACKET.finditer(text):
        place, bracket = match.start(), match.group()
        if bracket in CLOSES:
            open_brackets.append(len(opening))
            opening.append(place)
            closing.append(0)  # what is not closed ends nowhere: no bracket closes at the first place
        elif open_brackets and CLOSES[text[opening[open_brackets[-1]]]] == bracket:
            closing[open_brackets.pop()] = place
        else:  # what does not fit leaves all that is open without an end
            open_brackets.clear()
    return opening, closing


def blanked(text: str, comments: str) -> str:
    """The text with comments and strings as blanks, so that every place keeps its number.

    Args:
        text: The program.
        comments: A regular expression of strings and comments of the language.
    """
    return re.sub(comments, lambda match: re.sub(r"[^\n]", " ", match.group()), text)


def written(value: float, before: str, digits: int) -> str:
    """A number in place of another: as many digits behind the point as that had, or more where they are needed."""
    fraction = before.partition(".")[2]
    behind = len(fraction if fraction.isdigit() else fraction.lower().partition("e")[0])
    text = f"{value:.{behind if behind > digits else digits}f}"
    return text[1:] if text[0] == "-" and float(text) == 0.0 else text
