"""Languages of robot programs, by the ending of a file's name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from aridcal.errors import AridcalError
from aridcal.programs import fanuc, gcode, krl, rapid, urscript
from aridcal.programs.axes import DEGREE, MILLIMETRE, Axes
from aridcal.programs.frames import KnownFrames
from aridcal.programs.targets import Target
from aridcal.reading.files import Limit, read_file

PROGRAM = Limit(50)
"""A spraying path of a million points has 50 MB."""


@dataclass(frozen=True)
class Language:
    """How programs of a maker are read.

    Attributes:
        name: Of the language.
        read: Targets of a text.
        angle: Its unit of angles, [rad].
        length: Its unit of lengths, [m].
    """

    name: str
    read: Callable[[str, Axes, KnownFrames], list[Target]]
    angle: float = DEGREE
    length: float = MILLIMETRE


URSCRIPT = Language("URScript", urscript.read, 1.0, 1.0)
KRL = Language("KRL", krl.read)
RAPID = Language("RAPID", rapid.read)
FANUC = Language("FANUC LS", fanuc.read)
GCODE = Language("G-code", gcode.read)

LANGUAGES = {
    ".script": URSCRIPT, ".urscript": URSCRIPT,
    ".src": KRL, ".dat": KRL,
    ".mod": RAPID, ".modx": RAPID, ".prg": RAPID, ".sys": RAPID,
    ".ls": FANUC,
    ".nc": GCODE, ".gcode": GCODE, ".ngc": GCODE, ".cnc": GCODE,
}  # fmt: skip
"""By the ending of the file's name."""


def language_of(path: Path) -> Language | None:
    """The language of a file; None where its name is none of a program."""
    return LANGUAGES.get(path.suffix.lower())


def read_program(path: Path) -> str:
    """A program's text, each byte a letter, so that it can be written back as it was whatever its encoding.

    Raises:
        AridcalError: it is not there, too large, or no text of one byte a letter.
    """
    content = read_file(path, AridcalError, PROGRAM)
    if b"\0" in content:
        raise AridcalError(
            f"{path}: is no text of one byte a letter: export the program as ASCII, ISO 8859 or UTF-8 text"
        )
    return content.decode("latin-1")
