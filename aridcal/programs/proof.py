"""The corrected text is read again before it is written: it must say what was meant, and nothing else may have changed."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from io import StringIO

import numpy as np

from aridcal.programs.cell import Cell
from aridcal.programs.language import Language
from aridcal.programs.project import Project
from aridcal.programs.targets import Place, Target
from aridcal.programs.text import NUL, Numbers


class Unproved(Exception):
    """The new text does not say what was meant: a fault of the program, never of its user."""


AT_ONCE = 2_000
"""Targets that are compared together: what is made on the way takes some megabytes."""


@dataclass(frozen=True, slots=True)
class Change:
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
class Meant:
    """What n targets say, in columns: all that is kept of them while the new text is read.

    Attributes:
        files: Of the project, their indices.
        lines: Where they stand.
        names: What the program calls them.
        forms: Of their numbers.
        why: Why they cannot be corrected.
        units: Of their numbers.
        counts: How many numbers each has, those of its posture among them.
        starts: Where all their numbers start, those of a posture behind the others.
        texts: What stands there, of each target joined by :data:`NUL`.
        places: Frame and tool of each.
        beside: Likewise of other uses.
    """

    files: array[int]
    lines: array[int]
    names: list[str]
    forms: list[str]
    why: list[str]
    units: list[tuple[tuple[float, int], ...]]
    counts: array[int]
    starts: array[int]
    texts: list[str]
    places: list[Place | None]
    beside: list[tuple[Place, ...]]

    def __len__(self) -> int:
        return len(self.lines)

    def part(self, start: int, stop: int) -> Meant:
        """Some of them."""
        rows, first = slice(start, stop), sum(self.counts[:start])
        numbers = slice(first, first + sum(self.counts[rows]))
        own = {f.name: getattr(self, f.name)[numbers if f.name == "starts" else rows] for f in fields(self)}
        return Meant(**own)

    def where(self, k: int) -> str:
        """How messages name one."""
        return f"line {self.lines[k]}, {self.names[k]}"


def meant(targets: Sequence[Target]) -> Meant:
    """What targets say."""
    said = Meant(array("I"), array("I"), [], [], [], [], array("I"), array("I"), [], [], [])
    for target in targets:
        words = target.branch.words
        numbers = [target.numbers] if words is None else [target.numbers, words.numbers]
        said.files.append(target.file)
        said.lines.append(target.line)
        said.names.append(target.name)
        said.forms.append(target.form)
        said.why.append(target.why)
        said.units.append(target.units)
        said.counts.append(sum(map(len, numbers)))
        for own in numbers:
            said.starts.extend(own.starts)
        said.texts.append(NUL.join([own.joined for own in numbers if len(own)]))
        said.places.append(target.place)
        said.beside.append(target.beside)
    return said


def corrected(
    language: Language, project: Project, cell: Cell, said: Meant, edited: Sequence[Edited]
) -> tuple[str, ...]:
    """The new text of each file, proved.

    Args:
        language: Of the project.
        project: As it is.
        cell: That it was read for.
        said: What the targets that were read from it say.
        edited: The new text of each file.

    Raises:
        Unproved: naming what is wrong.
    """
    texts = [own.text for own in edited]
    again = language.read(project.with_texts(texts), cell).targets
    if len(again) != len(said):
        raise Unproved(f"{len(said)} targets were read, of the new text {len(again)}")
    for start in range(0, len(said), AT_ONCE):
        before, after = said.part(start, start + AT_ONCE), meant(again[start : start + AT_ONCE])
        _check(before, after)
        _check_numbers(before, after, project, edited)
    return tuple(texts)


def edited(project: Project, changes: Iterable[Change]) -> list[Edited]:
    """The text of each file with other numbers, if each has a place of its own and all between is as it was.

    Raises:
        Unproved: naming what is wrong.
    """
    edits = [_Edits(array("I"), array("I"), []) for _ in project.sources]
    for change in changes:
        source = project.sources[change.file]
        if not source.ours:
            raise Unproved(f"{source.path}: is not to be changed")
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

    def add(self, text: str, change: Change) -> None:
        """Take some more, of a text."""
        before, after = change.numbers.texts, change.texts.split(NUL)
        if len(before) != len(after):
            raise Unproved(f"{len(after)} texts are given for {len(before)} numbers")
        for start, own in zip(change.numbers.starts, before, strict=True):
            if not text.startswith(own, start):
                raise Unproved(f"{own} does not stand where it should")
        self.starts.extend(change.numbers.starts)
        self.lengths.extend(map(len, before))
        self.texts.extend(after)


@dataclass(frozen=True)
class Edited:
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


def _spliced(text: str, edits: _Edits) -> Edited:
    """The text with other numbers, if each has a place of its own and all between is as it was."""
    order = np.argsort(np.array(edits.starts, dtype=np.int64), kind="stable")
    starts, old = (np.array(own, dtype=np.int64)[order] for own in (edits.starts, edits.lengths))
    twice = np.flatnonzero(starts[1:] < (starts + old)[:-1])
    if len(twice):
        first = int(starts[twice[0] + 1])
        raise Unproved(f"two changes at one place: {text[first : first + int(old[twice[0] + 1])]}")
    texts = [edits.texts[k] for k in order.tolist()]
    lengths = np.fromiter(map(len, texts), dtype=np.int64, count=len(texts))
    new = StringIO(newline="")
    for rows, between in _between(text, starts, starts + old):
        parts = [""] * (2 * len(between))
        parts[::2], parts[1::2] = between, texts[rows]
        new.write("".join(parts))
    new.write(text[int(starts[-1] + old[-1]) if len(texts) else 0 :])
    own = Edited(new.getvalue(), starts, lengths, np.concatenate([[0], np.cumsum(lengths - old)]))
    _check_rest(text, starts + old, texts, own)
    return own


def _between(text: str, starts: np.ndarray, ends: np.ndarray) -> Iterator[tuple[slice, list[str]]]:
    """What stands in a text before each of some numbers that follow each other, some thousand of them at a time."""
    last = 0
    for first in range(0, len(starts), AT_ONCE):
        rows = slice(first, first + AT_ONCE)
        begins = [last, *ends[rows].tolist()]
        last = begins.pop()
        yield rows, [text[begin:end] for begin, end in zip(begins, starts[rows].tolist(), strict=True)]


def _check_rest(text: str, ends: np.ndarray, texts: Sequence[str], own: Edited) -> None:
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
            raise Unproved("the text between the numbers is another one")
        places = zip(starts[rows].tolist(), texts[rows], strict=True)
        wrong = next((said for start, said in places if not own.text.startswith(said, start)), None)
        if wrong is not None:
            raise Unproved(f"{wrong} does not stand where it should")
    end = int(ends[-1]) if len(ends) else 0
    if own.text[end + int(own.longer[-1]) :] != text[end:]:
        raise Unproved("the text behind the last change is another one")


def _check_numbers(before: Meant, after: Meant, project: Project, edited: Sequence[Edited]) -> None:
    """Make sure that the numbers of targets, as many as before, are those that were meant, where they were meant."""
    ends, files = np.cumsum(before.counts), np.repeat(before.files, before.counts)
    old_starts, new_starts = (np.array(own.starts, dtype=np.int64) for own in (before, after))
    old, new = (np.array(NUL.join(filter(None, own.texts)).split(NUL), dtype=object) for own in (before, after))
    for file in sorted(set(before.files)):
        rows = np.flatnonzero(files == file)
        text = edited[file].text
        lengths = np.array([len(own) for own in old[rows]], dtype=np.int64)
        starts, lengths = edited[file].meant(old_starts[rows], lengths)
        spans = zip(starts.tolist(), (starts + lengths).tolist(), strict=True)
        there = np.array([text[start:end] for start, end in spans], dtype=object)
        wrong = rows[(starts != new_starts[rows]) | (there != new[rows])]
        if len(wrong):
            k = int(wrong[0])
            where = before.where(int(np.searchsorted(ends, k, "right")))
            own = there[int(np.searchsorted(rows, k))]
            raise Unproved(f"{where}: {own} was meant in place of {old[k]}, the new text has {new[k]}")


SAME = {
    "files": "file",
    "lines": "line",
    "forms": "form",
    "why": "reason",
    "units": "units",
    "counts": "number of numbers",
}
"""What of a target no correction changes."""


def _check(before: Meant, after: Meant) -> None:
    """Make sure that targets of the new text mean what they meant."""
    for column, name in SAME.items():
        was, now = getattr(before, column), getattr(after, column)
        if was != now:
            k = next(k for k, (old, new) in enumerate(zip(was, now, strict=True)) if old != new)
            raise Unproved(f"{before.where(k)}: its {name} was {was[k]}, and is {now[k]} in the new text")
    for k, why in enumerate(before.why):
        if not why:
            _check_place(before, after, k)


def _check_place(before: Meant, after: Meant, k: int) -> None:
    places = [(before.places[k], after.places[k]), *zip(before.beside[k], after.beside[k], strict=True)]
    for old, new in places:
        if (old is None) != (new is None):
            raise Unproved(f"{before.where(k)}: its frame is read otherwise from the new text")
        if old is not None and new is not None and not (_equal(old.base, new.base) and _equal(old.tool, new.tool)):
            raise Unproved(f"{before.where(k)}: its frame or tool is another one in the new text")


def _equal(old: np.ndarray, new: np.ndarray) -> bool:
    return old is new or old.tobytes() == new.tobytes() or np.array_equal(old, new)
