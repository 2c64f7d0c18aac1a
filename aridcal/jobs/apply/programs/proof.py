"""The corrected text is read again before it is written: it must say what was meant, and nothing else may have changed."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any, Literal

import numpy as np

from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.targets import PoseReference, Target
from aridcal.jobs.apply.programs.text import NUL, Numbers


class ProofFailure(Exception):
    """The new text does not say what was meant: a fault of the program, never of its user."""


COMPARED_AT_ONCE = 2_000
"""Targets that are compared together: what is made on the way takes some megabytes."""


@dataclass(frozen=True, slots=True)
class TextChange:
    """Other texts for numbers, those of a target for instance.

    Attributes:
        file: Of the project, its index.
        numbers: Where they stand, as they are.
        texts: What is to stand there, joined by :data:`NUL`.
    """

    file: int
    numbers: Numbers
    texts: str


@dataclass(frozen=True)
class ExpectedTargets:
    """What some targets say, in columns: all that is kept of them while the new text is read.

    Texts of many targets are one here: small ones would lie between all else that was made of the program, whose memory could
    not be given back.

    Attributes:
        files: Of the project, their indices.
        lines: Where they stand.
        names: What the program calls them, joined by :data:`NUL`.
        forms: Of their numbers.
        why: Why they cannot be corrected.
        units: Of their numbers.
        counts: How many numbers each has, those of its posture among them.
        starts: Where all their numbers start, those of a posture behind the others.
        texts: What stands there, joined by :data:`NUL`.
        places: Frame and tool of each.
        beside: Likewise of other uses.
    """

    files: array[int]
    lines: array[int]
    names: str
    forms: list[Literal["joints", "pose"]]
    why: list[str]
    units: list[tuple[tuple[float, int], ...]]
    counts: array[int]
    starts: array[int]
    texts: str
    places: list[PoseReference | None]
    beside: list[tuple[PoseReference, ...]]

    def __len__(self) -> int:
        return len(self.lines)

    def named(self) -> list[Target]:
        """The targets with their names and places alone."""
        own = zip(self.lines, self.names.split(NUL), self.forms, self.files, strict=True)
        return [Target(line, name, form, file=file) for line, name, form, file in own]

    def where(self, k: int) -> str:
        """How messages name one."""
        return f"line {self.lines[k]}, {self.names.split(NUL)[k]}"


def expected_targets(targets: Sequence[Target]) -> list[ExpectedTargets]:
    """What targets say, some thousand at a time."""
    same: dict[object, Any] = {}  # one of all that are equal
    return [
        _meant(targets[first : first + COMPARED_AT_ONCE], same) for first in range(0, len(targets), COMPARED_AT_ONCE)
    ]


def _meant(targets: Sequence[Target], same: dict[object, Any]) -> ExpectedTargets:
    words = [target.branch.words for target in targets]
    numbers = [(t.numbers,) if own is None else (t.numbers, own.numbers) for t, own in zip(targets, words, strict=True)]
    starts = array("I")
    for own in numbers:
        for part in own:
            starts.extend(part.starts)
    places = [target.place for target in targets]
    return ExpectedTargets(
        files=array("I", [target.file for target in targets]),
        lines=array("I", [target.line for target in targets]),
        names=NUL.join([target.name for target in targets]),
        forms=[target.form for target in targets],
        why=[same.setdefault(target.why, target.why) for target in targets],
        units=[same.setdefault(target.units, target.units) for target in targets],
        counts=array("I", [sum(map(len, own)) for own in numbers]),
        starts=starts,
        texts=NUL.join([part.joined for own in numbers for part in own if len(part)]),
        places=[place and same.setdefault((id(place.base), id(place.tool)), place) for place in places],
        beside=[target.beside for target in targets],
    )


def corrected(
    language: Language, project: Project, cell: Cell, expected: Sequence[ExpectedTargets], edited: Sequence[EditedText]
) -> tuple[str, ...]:
    """The new text of each file, proved.

    Args:
        language: Of the project.
        project: As it is.
        cell: That it was read for.
        expected: What the targets that were read from it say.
        edited: The new text of each file.

    Raises:
        Unproved: naming what is wrong.
    """
    texts = [own.text for own in edited]
    again, count = language.read(project.with_texts(texts), cell).targets, sum(map(len, expected))
    if len(again) != count:
        raise ProofFailure(f"{count} targets were read, of the new text {len(again)}")
    for before, after in zip(expected, expected_targets(again), strict=True):
        _check(before, after)
        _check_numbers(before, after, edited)
    return tuple(texts)


def edit_texts(project: Project, changes: Iterable[TextChange]) -> list[EditedText]:
    """The text of each file with other numbers, if each has a place of its own and all between is as it was.

    Raises:
        Unproved: naming what is wrong.
    """
    edits = [_Edits(array("I"), array("I"), []) for _ in project.sources]
    for change in changes:
        source = project.sources[change.file]
        if not source.ours:
            raise ProofFailure(f"{source.path}: is not to be changed")
        edits[change.file].add(source.text, change)
    return [_spliced(source.text, own) for source, own in zip(project.sources, edits, strict=True)]


@dataclass(frozen=True)
class _Edits:
    """Other texts for numbers of one file.

    Attributes:
        starts: Where each stands.
        lengths: Of what stands there.
        texts: What is to stand there.
    """

    starts: array[int]
    lengths: array[int]
    texts: list[str]

    def add(self, text: str, change: TextChange) -> None:
        """Take some more, of a text."""
        before, after = change.numbers.texts, change.texts.split(NUL)
        if len(before) != len(after):
            raise ProofFailure(f"{len(after)} texts are given for {len(before)} numbers")
        for start, own in zip(change.numbers.starts, before, strict=True):
            if not text.startswith(own, start):
                raise ProofFailure(f"{own} does not stand where it should")
        self.starts.extend(change.numbers.starts)
        self.lengths.extend(map(len, before))
        self.texts.extend(after)


@dataclass(frozen=True)
class EditedText:
    """A text with n other numbers, and where the places of the old one are in it.

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


def _spliced(text: str, edits: _Edits) -> EditedText:
    """The text with other numbers, if each has a place of its own and all between is as it was."""
    order = np.argsort(np.array(edits.starts, dtype=np.int64), kind="stable")
    starts, old = (np.array(own, dtype=np.int64)[order] for own in (edits.starts, edits.lengths))
    twice = np.flatnonzero(starts[1:] < (starts + old)[:-1])
    if len(twice):
        first = int(starts[twice[0] + 1])
        raise ProofFailure(f"two changes at one place: {text[first : first + int(old[twice[0] + 1])]}")
    texts = [edits.texts[k] for k in order.tolist()]
    lengths = np.fromiter(map(len, texts), dtype=np.int64, count=len(texts))
    new = StringIO(newline="")
    for rows, between in _between(text, starts, starts + old):
        parts = [""] * (2 * len(between))
        parts[::2], parts[1::2] = between, texts[rows]
        new.write("".join(parts))
    new.write(text[int(starts[-1] + old[-1]) if len(texts) else 0 :])
    own = EditedText(new.getvalue(), starts, lengths, np.concatenate([[0], np.cumsum(lengths - old)]))
    _check_rest(text, starts + old, texts, own)
    return own


def _between(text: str, starts: np.ndarray, ends: np.ndarray) -> Iterator[tuple[slice, list[str]]]:
    """What stands in a text before each of some numbers that follow each other, some thousand of them at a time."""
    last = 0
    for first in range(0, len(starts), COMPARED_AT_ONCE):
        rows = slice(first, first + COMPARED_AT_ONCE)
        begins = [last, *ends[rows].tolist()]
        last = begins.pop()
        yield rows, [text[begin:end] for begin, end in zip(begins, starts[rows].tolist(), strict=True)]


def _check_rest(text: str, ends: np.ndarray, texts: Sequence[str], own: EditedText) -> None:
    """Make sure that the new text has each new number at its place, and all between as it was.

    Args:
        text: The old one.
        ends: Of the numbers in it, in their order, shape (n,).
        texts: What should stand there now.
        own: The new text.
    """
    starts = own.starts + own.longer[:-1]
    was, now = _between(text, own.starts, ends), _between(own.text, starts, starts + own.lengths)
    for (rows, before), (_, after) in zip(was, now, strict=True):
        if before != after:
            raise ProofFailure("the text between the numbers is another one")
        places = zip(starts[rows].tolist(), texts[rows], strict=True)
        wrong = next((expected for start, expected in places if not own.text.startswith(expected, start)), None)
        if wrong is not None:
            raise ProofFailure(f"{wrong} does not stand where it should")
    end = int(ends[-1]) if len(ends) else 0
    if own.text[end + int(own.longer[-1]) :] != text[end:]:
        raise ProofFailure("the text behind the last change is another one")


def _check_numbers(before: ExpectedTargets, after: ExpectedTargets, edited: Sequence[EditedText]) -> None:
    """Make sure that the numbers of targets, as many as before, are those that were meant, where they were meant."""
    files, old = np.repeat(before.files, before.counts), before.texts.split(NUL) if len(before.starts) else []
    starts, lengths = np.array(before.starts, dtype=np.int64), np.fromiter(map(len, old), dtype=np.int64)
    for file in sorted(set(before.files)):
        rows = files == file
        starts[rows], lengths[rows] = edited[file].meant(starts[rows], lengths[rows])
    spans = zip(files.tolist(), starts.tolist(), (starts + lengths).tolist(), strict=True)
    there = [edited[file].text[start:end] for file, start, end in spans]
    shifted = starts != np.array(after.starts, dtype=np.int64)
    if NUL.join(there) != after.texts or shifted.any():
        new = after.texts.split(NUL)
        k = next(k for k in range(len(new)) if there[k] != new[k] or shifted[k])
        where = before.where(int(np.searchsorted(np.cumsum(before.counts), k, "right")))
        raise ProofFailure(f"{where}: {there[k]} was meant in place of {old[k]}, the new text has {new[k]}")


UNCHANGED_COLUMNS = {
    "files": "file",
    "lines": "line",
    "forms": "form",
    "why": "reason",
    "units": "units",
    "counts": "number of numbers",
}
"""What of a target no correction changes."""


def _check(before: ExpectedTargets, after: ExpectedTargets) -> None:
    """Make sure that targets of the new text mean what they meant."""
    for column, name in UNCHANGED_COLUMNS.items():
        was, now = getattr(before, column), getattr(after, column)
        if was != now:
            k = next(k for k, (old, new) in enumerate(zip(was, now, strict=True)) if old != new)
            raise ProofFailure(f"{before.where(k)}: its {name} was {was[k]}, and is {now[k]} in the new text")
    for k, why in enumerate(before.why):
        if not why:
            _check_place(before, after, k)


def _check_place(before: ExpectedTargets, after: ExpectedTargets, k: int) -> None:
    places = [(before.places[k], after.places[k]), *zip(before.beside[k], after.beside[k], strict=True)]
    for old, new in places:
        if (old is None) != (new is None):
            raise ProofFailure(f"{before.where(k)}: its frame is read otherwise from the new text")
        if old is not None and new is not None and not (_equal(old.base, new.base) and _equal(old.tool, new.tool)):
            raise ProofFailure(f"{before.where(k)}: its frame or tool is another one in the new text")


def _equal(old: np.ndarray, new: np.ndarray) -> bool:
    return old is new or old.tobytes() == new.tobytes() or np.array_equal(old, new)
