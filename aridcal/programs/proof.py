"""The corrected text is read again before it is written: it must say what was meant, and nothing else may have changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

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
    texts = [
        _spliced(source.text, [c for c in changes if c.file == file]) for file, source in enumerate(project.sources)
    ]
    meant = {(c.file, c.number.start): c.text for c in changes}
    again = language.read(project.with_texts(texts), cell).targets
    if len(again) != len(targets):
        raise Unproved(f"{len(targets)} targets were read, of the new text {len(again)}")
    shifts = [_Shift([c for c in changes if c.file == file]) for file in range(len(texts))]
    for before, after in zip(targets, again, strict=True):
        _check(before, after, meant, shifts[before.file])
    return tuple(texts)


def _spliced(text: str, changes: Sequence[Change]) -> str:
    """The text with other numbers, if each change has a place of its own and all between is as it was."""
    ordered = sorted(changes, key=lambda c: c.number.start)
    for first, second in pairwise(ordered):
        if first.number.end > second.number.start:
            raise Unproved(f"two changes at one place: {first.number.text} and {second.number.text}")
    new = spliced(text, [(c.number, c.text) for c in ordered])
    old_end = new_end = 0
    for c in ordered:
        gap = c.number.start - old_end
        if (
            text[c.number.start : c.number.end] != c.number.text
            or new[new_end : new_end + gap] != text[old_end : c.number.start]
        ):
            raise Unproved(f"{c.number.text} does not stand where it should")
        if new[new_end + gap : new_end + gap + len(c.text)] != c.text:
            raise Unproved(f"{c.text} does not stand where it should")
        old_end, new_end = c.number.end, new_end + gap + len(c.text)
    if new[new_end:] != text[old_end:]:
        raise Unproved("the text behind the last change is another one")
    return new


class _Shift:
    """Where a place of the old text is in the new one."""

    def __init__(self, changes: Sequence[Change]) -> None:
        ordered = sorted(changes, key=lambda c: c.number.start)
        self._starts = np.array([c.number.start for c in ordered], dtype=int)
        self._longer = np.cumsum([0, *(len(c.text) - len(c.number.text) for c in ordered)])

    def __call__(self, place: int) -> int:
        return place + int(self._longer[np.searchsorted(self._starts, place)])


def _check(before: Target, after: Target, meant: dict[tuple[int, int], str], shift: _Shift) -> None:
    """Make sure that a target of the new text is what was meant."""
    where = f"line {before.line}, {before.name}"
    same = [
        ("file", before.file, after.file),
        ("line", before.line, after.line),
        ("form", before.form, after.form),
        ("reason", before.why, after.why),
        ("units", before.units, after.units),
        ("number of numbers", len(before.numbers), len(after.numbers)),
    ]
    for name, old, new in same:
        if old != new:
            raise Unproved(f"{where}: its {name} was {old}, and is {new} in the new text")
    for old_number, new_number in zip(_numbers(before), _numbers(after), strict=True):
        text = meant.get((before.file, old_number.start), old_number.text)
        if (new_number.start, new_number.text) != (shift(old_number.start), text):
            raise Unproved(
                f"{where}: {text} was meant in place of {old_number.text}, the new text has {new_number.text}"
            )
    if not before.why:
        _check_place(before, after, where)


def _numbers(target: Target) -> tuple[Number, ...]:
    """All numbers of a target, those of its posture behind the others."""
    words = target.branch.words
    return (*target.numbers, *(words.numbers if words is not None else ()))


def _check_place(before: Target, after: Target, where: str) -> None:
    places = [(before.place, after.place), *zip(before.beside, after.beside, strict=True)]
    for old, new in places:
        if (old is None) != (new is None):
            raise Unproved(f"{where}: its frame is read otherwise from the new text")
        if (
            old is not None
            and new is not None
            and not (np.array_equal(old.base, new.base) and np.array_equal(old.tool, new.tool))
        ):
            raise Unproved(f"{where}: its frame or tool is another one in the new text")
