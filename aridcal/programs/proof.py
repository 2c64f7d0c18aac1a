"""The corrected text is read again before it is written: it must say what was meant, and nothing else may have changed."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from aridcal.programs.cell import Cell
from aridcal.programs.language import Language
from aridcal.programs.project import Project
from aridcal.programs.targets import Target
from aridcal.programs.text import Number, spliced


class Unproved(Exception):
    """The new text does not say what was meant: a fault of the program, never of its user."""


@dataclass(frozen=True, slots=True)
class Change:
    """Another text for a number.

    Attributes:
        file: Of the project, its index.
        number: Where it stands, as it is.
        text: What is to stand there.
    """

    file: int
    number: Number
    text: str


def corrected(
    language: Language, project: Project, cell: Cell, targets: Sequence[Target], changes: Sequence[Change]
) -> tuple[str, ...]:
    """The new text of each file, proved.

    Args:
        language: Of the project.
        project: As it is.
        cell: That it was read for.
        targets: As read from it.
        changes: Other numbers.

    Raises:
        Unproved: naming what is wrong.
    """
    for change in changes:
        if not project.sources[change.file].ours:
            raise Unproved(f"{project.sources[change.file].path}: is not to be changed")
    by_file: list[list[Change]] = [[] for _ in project.sources]
    for change in sorted(changes, key=lambda c: c.number.start):
        by_file[change.file].append(change)
    texts = [_spliced(source.text, own) for source, own in zip(project.sources, by_file, strict=True)]
    meant = {(c.file, c.number.start): c.text for c in changes}
    again = language.read(project.with_texts(texts), cell).targets
    if len(again) != len(targets):
        raise Unproved(f"{len(targets)} targets were read, of the new text {len(again)}")
    shifts = [_Shift(own) for own in by_file]
    for before, after in zip(targets, again, strict=True):
        _check(before, after, meant, shifts[before.file])
    return tuple(texts)


def _spliced(text: str, ordered: Sequence[Change]) -> str:
    """The text with other numbers, if each change has a place of its own and all between is as it was."""
    for first, second in pairwise(ordered):
        if first.number.end > second.number.start:
            raise Unproved(f"two changes at one place: {first.number.text} and {second.number.text}")
    new = spliced(text, [(c.number, c.text) for c in ordered])
    old_end = new_end = 0
    for c in ordered:
        start, before = c.number.start, c.number.text
        there = new_end + start - old_end
        if not text.startswith(before, start) or new[new_end:there] != text[old_end:start]:
            raise Unproved(f"{before} does not stand where it should")
        if not new.startswith(c.text, there):
            raise Unproved(f"{c.text} does not stand where it should")
        old_end, new_end = start + len(before), there + len(c.text)
    if new[new_end:] != text[old_end:]:
        raise Unproved("the text behind the last change is another one")
    return new


class _Shift:
    """Where a place of the old text is in the new one."""

    def __init__(self, ordered: Sequence[Change]) -> None:
        self._starts = [c.number.start for c in ordered]
        self._longer = list(accumulate((len(c.text) - len(c.number.text) for c in ordered), initial=0))

    def __call__(self, place: int) -> int:
        return place + self._longer[bisect_left(self._starts, place)]


def _check(before: Target, after: Target, meant: dict[tuple[int, int], str], shift: _Shift) -> None:
    """Make sure that a target of the new text is what was meant."""
    where = f"line {before.line}, {before.name}"
    was, now = _what(before), _what(after)
    if was != now:
        name, old, new = next(each for each in zip(SAME, was, now, strict=True) if each[1] != each[2])
        raise Unproved(f"{where}: its {name} was {old}, and is {new} in the new text")
    for old_number, new_number in zip(_numbers(before), _numbers(after), strict=True):
        text = meant.get((before.file, old_number.start), old_number.text)
        if (new_number.start, new_number.text) != (shift(old_number.start), text):
            raise Unproved(
                f"{where}: {text} was meant in place of {old_number.text}, the new text has {new_number.text}"
            )
    if not before.why:
        _check_place(before, after, where)


SAME = ("file", "line", "form", "reason", "units", "number of numbers")
"""What of a target no correction changes; see :func:`_what`."""


def _what(target: Target) -> tuple[object, ...]:
    return target.file, target.line, target.form, target.why, target.units, len(target.numbers)


def _numbers(target: Target) -> tuple[Number, ...]:
    """All numbers of a target, those of its posture behind the others."""
    words = target.branch.words
    return (*target.numbers, *(words.numbers if words is not None else ()))


def _check_place(before: Target, after: Target, where: str) -> None:
    places = [(before.place, after.place), *zip(before.beside, after.beside, strict=True)]
    for old, new in places:
        if (old is None) != (new is None):
            raise Unproved(f"{where}: its frame is read otherwise from the new text")
        if old is not None and new is not None and not (_equal(old.base, new.base) and _equal(old.tool, new.tool)):
            raise Unproved(f"{where}: its frame or tool is another one in the new text")


def _equal(old: np.ndarray, new: np.ndarray) -> bool:
    return old is new or old.tobytes() == new.tobytes() or np.array_equal(old, new)
