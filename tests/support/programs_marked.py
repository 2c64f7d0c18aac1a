"""Programs with marks: ⟦…⟧ around what must be left, ⟨…⟩ around what must be corrected."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import program_attacks
from made_gcode import gantry
from program_attacks import Attack
from robots import ur10

from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import read_frames
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.languages import LANGUAGES, language_of
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.targets import Target
from aridcal.system.errors import AridcalError

OPENS = {"⟦": "⟧", "⟨": "⟩"}


@dataclass(frozen=True)
class Marked:
    """A span of a text.

    Attributes:
        start: Its first place.
        end: The place behind it.
        corrected: Whether it must be corrected; else it must be left.
    """

    start: int
    end: int
    corrected: bool


def stripped(text: str) -> tuple[str, list[Marked]]:
    """A text without its marks, each character a byte as latin-1, and where they stood."""
    letters: list[str] = []
    open_marks: list[tuple[str, int]] = []
    spans: list[Marked] = []
    for letter in text:
        if letter in OPENS:
            open_marks.append((letter, len(letters)))
        elif letter in OPENS.values():
            opened, start = open_marks.pop()
            assert OPENS[opened] == letter, f"{letter} closes {opened}"
            spans.append(Marked(start, len(letters), opened == "⟨"))
        else:
            letters += letter.encode("utf-8").decode("latin-1")
    assert not open_marks
    return "".join(letters), spans


@cache
def cell_of(language: Language, frames: str, start: bool = False) -> Cell:
    """A robot for programs of a language: a gantry for G-code, else a UR10."""
    robot = gantry(rotary=False) if language.name == "G-code" else ur10()
    return Cell(robot, read_frames(_file(frames)), (), start)


@cache
def _file(frames: str) -> Path | None:
    if not frames:
        return None
    import tempfile

    path = Path(tempfile.mkdtemp()) / "frames.yaml"
    path.write_text(frames)
    return path


def project_of(files: Mapping[str, str]) -> tuple[Language, Project, dict[int, list[Marked]]]:
    """The language of files, their project, and the marks of each by its index."""
    texts = {name: stripped(text) for name, text in files.items()}
    language = next(language for name in files if (language := language_of(Path(name))) is not None)
    ours = {name: language_of(Path(name)) is language and not name.startswith("$") for name in files}
    order = sorted(files, key=lambda name: not ours[name])
    sources = tuple(SourceFile(Path(name), texts[name][0], ours[name]) for name in order)
    return language, Project(sources), {k: texts[name][1] for k, name in enumerate(order)}


def wrong(files: Mapping[str, str], frames: str = "") -> list[str]:
    """What of a marked project is not as its marks say; nothing if all is right."""
    language, project, marks = project_of(files)
    try:
        reading: ProgramReading = language.read(project, cell_of(language, frames))
    except AridcalError as error:
        return [f"must be corrected, but: {error}" for own in marks.values() for mark in own if mark.corrected]
    corrected = [t for t in reading.targets if not t.why]
    faults = []
    for file, own in marks.items():
        for mark in own:
            inside = [t for t in corrected if t.file == file and _inside(t, mark)]
            text = project.sources[file].text[mark.start : mark.end]
            if mark.corrected and not inside:
                reasons = sorted({t.why for t in reading.targets if t.why})
                faults.append(f"{text}: must be corrected, but: {'; '.join(reasons)}")
            elif not mark.corrected and not all(map(is_unsettled, inside)):
                faults.append(f"{text}: must be left, and is corrected")
    return faults


def is_unsettled(target: Target) -> bool:
    """Whether it is not known how the arm stands there: such a target is left, too."""
    return bool(target.branch.unknown) and target.branch.words is None and target.branch.near is None


def _inside(target: Target, mark: Marked) -> bool:
    return any(mark.start <= n.start < mark.end for n in target.numbers)


def attacks(ending: str = "") -> Sequence[tuple[str, Attack]]:
    """All attacks with the name of their table; of one language only, where an ending of its files is given."""
    tables = [
        importlib.import_module(f"program_attacks.{m.name}") for m in pkgutil.iter_modules(program_attacks.__path__)
    ]
    return [
        (table.__name__.split(".")[-1], attack)
        for table in tables
        for attack in table.ATTACKS
        if not ending or any(name.lower().endswith(ending) for name in attack.files)
    ]


def language_named(name: str) -> Language:
    """The language of a name."""
    return next(language for language in LANGUAGES if language.name == name)
