"""All languages of robot programs, by the ending of a file's name: the only list of them."""

from __future__ import annotations

from pathlib import Path

from aridcal.jobs.apply.programs import fanuc, gcode, krl, rapid, urscript, yaskawa
from aridcal.jobs.apply.programs.language import Language

LANGUAGES: tuple[Language, ...] = (urscript.ROW, krl.ROW, rapid.ROW, fanuc.ROW, gcode.ROW, yaskawa.ROW)


def language_of(path: Path) -> Language | None:
    """The language of a file; None where its name is none of a program."""
    return next((language for language in LANGUAGES if path.suffix.lower() in language.endings), None)
