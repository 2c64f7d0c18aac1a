"""One row a language: how its programs are read, marked and written; `LANGUAGES` of `languages.py` has all rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from aridcal.jobs.apply.programs.axes import DEGREE, MILLIMETRE
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.moves import Moves
from aridcal.jobs.apply.programs.project import Project


@dataclass(frozen=True)
class Language:
    """A language of robot programs.

    Attributes:
        name: Of the language.
        endings: Of its files' names, in small letters.
        read: What a project means for a cell.
        angle: Its unit of angles, [rad].
        length: Its unit of lengths, [m].
        context: Files beside a program that say what its names mean, and are read though nobody names them.
        comment: For a text and a sentence of one line: where a comment is put in that changes no target's line and is harmless,
            and the comment with its line end; None where the language has no harmless place.
        write: Lines of a program of planned moves, for a file's stem; None if we write none.
        external: Axes beside an arm's six that a planned program may have.
    """

    name: str
    endings: tuple[str, ...]
    read: Callable[[Project, Cell], ProgramReading]
    angle: float = DEGREE
    length: float = MILLIMETRE
    context: Callable[[Path], list[Path]] = lambda path: []
    comment: Callable[[str, str], tuple[int, str]] | None = None
    write: Callable[[Moves, str], Iterator[str]] | None = None
    external: int = 0
