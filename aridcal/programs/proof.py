"""The corrected text is read again before it is written: it must say what was meant, and nothing else may have changed."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import StringIO

import numpy as np

from aridcal.programs.cell import Cell
from aridcal.programs.language import Language
from aridcal.programs.project import Project
from aridcal.programs.targets import Target
from aridcal.programs.text import Number


class Unproved(Exception):
    """The new text does not say what was meant: a fault of the program, never of its user."""


AT_ONCE = 2_000
"""Targets that are compared together: what is made on the way takes some megabytes."""


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
    language: Language, project: Project, cell: Cell, targets: Sequence[Target], changes: Iterable[Change]
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
    edits = [_Edits([], [], []) for _ in project.sources]
    for change in changes:
        source = project.sources[change.file]
        if not source.ours:
            raise Unproved(f"{source.path}: is not to be changed")
        edits[change.file].add(source.text, change)
    spliced = [_spliced(source.text, own) for source, own in zip(project.sources, edits, strict=True)]
    del edits  # a million texts that are in the new programs now
    texts = [text for text, _ in spliced]
    again = language.read(project.with_texts(texts), cell).targets
    if len(again) != len(targets):
        raise Unproved(f"{len(targets)} targets were read, of the new text {len(again)}")
    for start in range(0, len(targets), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        for before, after in zip(targets[part], again[part], strict=True):
            _check(before, after)
        _check_numbers(targets[part], again[part], spliced)
    return tuple(texts)


@dataclass(frozen=True)
class _Edits:
    """Other texts for numbers of one file.

    Attributes:
        starts: Where each stands.
        ends: Where it ends.
        texts: What is to stand there.
    """

    starts: list[int]
    ends: list[int]
    texts: list[str]

    def add(self, text: str, change: Change) -> None:
        """Take one more, of a text."""
        start, before = change.number.start, change.number.text
        if not text.startswith(before, start):
            raise Unproved(f"{before} does not stand where it should")
        self.starts.append(start)
        self.ends.append(start + len(before))
        self.texts.append(change.text)


@dataclass(frozen=True)
class _Moved:
    """Where the places of an old text are in the new one, for n numbers that have changed.

    Attributes:
        text: The new text.
        starts: Of the changed numbers in the old text, in their order, shape (n,).
        lengths: Of what stands there now, shape (n,).
        longer: By how much the new text is longer up to each, and to its end, shape (n + 1,).
    """

    text: str
    starts: np.ndarray
    lengths: np.ndarray
    longer: np.ndarray

    def meant(self, starts: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where numbers of the old text should be in the new one, and how long they should be there."""
        k = np.searchsorted(self.starts, starts)
        changed = np.append(self.starts, -1)[k] == starts
        return starts + self.longer[k], np.where(changed, np.append(self.lengths, 0)[k], lengths)


def _spliced(text: str, edits: _Edits) -> tuple[str, _Moved]:
    """The text with other numbers, if each has a place of its own and all between is as it was."""
    starts, ends = np.array(edits.starts, dtype=np.int64), np.array(edits.ends, dtype=np.int64)
    order = np.argsort(starts, kind="stable")
    twice = order[1:][starts[order[1:]] < ends[order[:-1]]]
    if len(twice):
        raise Unproved(f"two changes at one place: {text[starts[twice[0]] : ends[twice[0]]]}")
    new, end = StringIO(newline=""), 0
    for k in order.tolist():
        new.write(text[end : edits.starts[k]])
        new.write(edits.texts[k])
        end = edits.ends[k]
    new.write(text[end:])
    lengths = np.array([len(edits.texts[k]) for k in order.tolist()], dtype=np.int64)
    longer = np.concatenate([[0], np.cumsum(lengths - (ends - starts)[order])])
    moved = _Moved(new.getvalue(), starts[order], lengths, longer)
    _check_rest(text, edits, order, moved)
    return moved.text, moved


def _check_rest(text: str, edits: _Edits, order: np.ndarray, moved: _Moved) -> None:
    """Make sure that the new text has each new number at its place, and all between as it was."""
    new, old_end, new_end = moved.text, 0, 0
    for k in order.tolist():
        start, own = edits.starts[k], edits.texts[k]
        there = new_end + start - old_end
        if new[new_end:there] != text[old_end:start]:
            raise Unproved(f"the text before {own} is another one")
        if not new.startswith(own, there):
            raise Unproved(f"{own} does not stand where it should")
        old_end, new_end = edits.ends[k], there + len(own)
    if new[new_end:] != text[old_end:]:
        raise Unproved("the text behind the last change is another one")


def _check_numbers(before: Sequence[Target], after: Sequence[Target], spliced: Sequence[tuple[str, _Moved]]) -> None:
    """Make sure that the numbers of targets, as many as before, are those that were meant, where they were meant."""
    for file, (text, moved) in enumerate(spliced):
        rows = [k for k, target in enumerate(before) if target.file == file]
        (old_starts, old), (new_starts, new) = (_standing([targets[k] for k in rows]) for targets in (before, after))
        starts, lengths = moved.meant(old_starts, np.array([len(own) for own in old], dtype=np.int64))
        meant = [text[start : start + n] for start, n in zip(starts.tolist(), lengths.tolist(), strict=True)]
        if new != meant or not np.array_equal(starts, new_starts):
            wrong = (starts != new_starts) | (np.array(new) != np.array(meant))
            k = int(wrong.argmax())
            target = before[rows[int(np.searchsorted(np.cumsum([_count(before[row]) for row in rows]), k, "right"))]]
            raise Unproved(f"{_where(target)}: {meant[k]} was meant in place of {old[k]}, the new text has {new[k]}")


def _standing(targets: Sequence[Target]) -> tuple[np.ndarray, list[str]]:
    """Where all numbers of targets start, those of a posture behind the others, and what stands there."""
    starts, texts = array("I"), list[str]()
    for target in targets:
        starts += target.numbers.starts
        texts += target.numbers.texts
        if target.branch.words is not None:
            starts += target.branch.words.numbers.starts
            texts += target.branch.words.numbers.texts
    return np.array(starts, dtype=np.int64), texts


def _count(target: Target) -> int:
    """How many numbers a target has, those of its posture among them."""
    words = target.branch.words
    return len(target.numbers) + (0 if words is None else len(words.numbers))


def _check(before: Target, after: Target) -> None:
    """Make sure that a target of the new text means what it meant."""
    was, now = _what(before), _what(after)
    if was != now:
        name, old, new = next(each for each in zip(SAME, was, now, strict=True) if each[1] != each[2])
        raise Unproved(f"{_where(before)}: its {name} was {old}, and is {new} in the new text")
    if not before.why:
        _check_place(before, after)


SAME = ("file", "line", "form", "reason", "units", "number of numbers")
"""What of a target no correction changes; see :func:`_what`."""


def _what(target: Target) -> tuple[object, ...]:
    return target.file, target.line, target.form, target.why, target.units, _count(target)


def _where(target: Target) -> str:
    return f"line {target.line}, {target.name}"


def _check_place(before: Target, after: Target) -> None:
    places = [(before.place, after.place), *zip(before.beside, after.beside, strict=True)]
    for old, new in places:
        if (old is None) != (new is None):
            raise Unproved(f"{_where(before)}: its frame is read otherwise from the new text")
        if old is not None and new is not None and not (_equal(old.base, new.base) and _equal(old.tool, new.tool)):
            raise Unproved(f"{_where(before)}: its frame or tool is another one in the new text")


def _equal(old: np.ndarray, new: np.ndarray) -> bool:
    return old is new or old.tobytes() == new.tobytes() or np.array_equal(old, new)
