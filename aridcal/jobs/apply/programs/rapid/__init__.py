"""RAPID of ABB: modules of a task, with all data and routines of one another."""

from __future__ import annotations

from pathlib import Path

from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.moves import ARM_AXES
from aridcal.jobs.apply.programs.rapid.reading import read
from aridcal.jobs.apply.programs.rapid.writing import comment, write

ENDINGS = (".mod", ".modx", ".prg", ".sys", ".sysx")


def context(path: Path) -> list[Path]:
    """The other modules of the task: beside it, and in the folders of a controller's backup."""
    folders = [path.parent]
    if path.parent.name.upper() in ("PROGMOD", "SYSMOD"):
        folders = [
            other for other in sorted(path.parent.parent.iterdir()) if other.name.upper() in ("PROGMOD", "SYSMOD")
        ]
    files = (file for folder in folders for file in sorted(folder.iterdir()))
    return [file for file in files if file.suffix.lower() in ENDINGS and file.is_file() and file != path]


ROW = Language("RAPID", ENDINGS, read, context=context, comment=comment, write=write, external=ARM_AXES)
