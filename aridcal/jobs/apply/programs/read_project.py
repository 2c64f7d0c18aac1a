"""The files that a user names as a program, and those of the controller that belong to them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.languages import LANGUAGES, language_of
from aridcal.jobs.apply.programs.marks import MARK
from aridcal.jobs.apply.programs.project import Project, SourceFile, read_text
from aridcal.system.errors import AridcalError
from aridcal.system.writing.table_writer import WRITTEN_ENDINGS

MOST_FILES = 2000
"""Of one project: the largest backups of a controller have some hundreds."""

SYSTEM = "$"
"""Begins the names of files that belong to the controller: ``$config.dat``. They are read, and never corrected."""


@dataclass(frozen=True)
class LoadedProject:
    """A project as it was read.

    Attributes:
        language: Of all its programs.
        project: Its files.
        names: Of the files to be corrected, where they are to be written below an output folder.
    """

    language: Language
    project: Project
    names: tuple[Path, ...]


def is_program(path: Path) -> bool:
    """Whether a path is a program's file by its name, or a folder: of programs then, unless it has the name of a table."""
    return language_of(path) is not None or (path.is_dir() and path.suffix.lower() not in WRITTEN_ENDINGS)


def read_project(paths: Sequence[Path], out: Path) -> LoadedProject:
    """Read programs with what belongs to them.

    Args:
        paths: Files, or folders with all the programs below them.
        out: What is written of them: never a file that belongs to them, though it may stand beside them.

    Raises:
        AridcalError: there is none, they are of several languages, or a file cannot be read.
    """
    named_files = [(file, file.name) for path in paths if not path.is_dir() for file in (path,)]
    named_files += [(file, str(file.relative_to(path))) for path in paths if path.is_dir() for file in _below(path)]
    files = {os.path.realpath(file): (file, Path(name)) for file, name in named_files}
    ours = {
        real: (file, name)
        for real, (file, name) in files.items()
        if language_of(file) and not file.name.startswith(SYSTEM)
    }
    language = _one_language([file for file, _ in ours.values()], paths)
    if len({str(name).lower() for _, name in ours.values()}) < len(ours):
        raise AridcalError("two of the programs have the same name: give the folder that both are in")
    beside = [file for file, _ in files.values()] + [b for file, _ in ours.values() for b in language.context(file)]
    context = {real: file for file in beside if (real := os.path.realpath(file)) not in (*ours, os.path.realpath(out))}
    own = tuple(SourceFile(file, read_text(file)) for file, _ in ours.values())
    others = (SourceFile(file, read_text(file), False) for file in context.values())
    uncorrected = tuple(source for source in others if not MARK.search(source.text))
    return LoadedProject(language, Project((*own, *uncorrected)), tuple(name for _, name in ours.values()))


def _below(folder: Path) -> list[Path]:
    """All files below a folder that may be of a project, in the order of their names; links to folders are not followed."""
    endings = {ending for language in LANGUAGES for ending in language.endings}
    files: list[Path] = []
    for place, folders, names in os.walk(folder):
        folders.sort()
        files += [Path(place) / name for name in sorted(names) if Path(name).suffix.lower() in endings]
        if len(files) > MOST_FILES:
            raise AridcalError(f"{folder}: has more than {MOST_FILES} programs: give the folder of one project")
    return files


def _one_language(files: Sequence[Path], paths: Sequence[Path]) -> Language:
    languages = {language.name: language for file in files if (language := language_of(file)) is not None}
    if not languages:
        endings = ", ".join(ending for language in LANGUAGES for ending in language.endings)
        raise AridcalError(
            f"{', '.join(map(str, paths))}: there is no program in it: its name should end in one of {endings}"
        )
    if len(languages) > 1:
        raise AridcalError(
            f"{', '.join(map(str, paths))}: has programs in {' and '.join(sorted(languages))}: correct one language at a time"
        )
    return next(iter(languages.values()))
