"""A program and the controller's files that belong to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aridcal.system.errors import AridcalError
from aridcal.system.reading.regular_files import Limit, read_file

PROGRAM_LIMIT = Limit(50)
"""A spraying path of a million points has 50 MB."""


@dataclass(frozen=True)
class SourceFile:
    """A file of a project.

    Attributes:
        path: Of the file, as messages name it.
        text: Its content, each byte a letter, so that it can be written back as it was whatever its encoding.
        ours: Whether it is to be corrected; the others only say what its names mean.
    """

    path: Path
    text: str
    ours: bool = True


@dataclass(frozen=True)
class Project:
    """Files that are read together.

    Attributes:
        sources: Those to be corrected first.
    """

    sources: tuple[SourceFile, ...]

    def with_texts(self, texts: Sequence[str]) -> Project:
        """The same files with other texts."""
        return Project(tuple(SourceFile(s.path, text, s.ours) for s, text in zip(self.sources, texts, strict=True)))


def read_text(path: Path) -> str:
    """A program's text, each byte a letter.

    Raises:
        AridcalError: it is not there, too large, or no text of one byte a letter.
    """
    content = read_file(path, AridcalError, PROGRAM_LIMIT)
    if b"\0" in content:
        raise AridcalError(
            f"{path}: is no text of one byte a letter: export the program as ASCII, ISO 8859 or UTF-8 text"
        )
    return content.decode("latin-1")
