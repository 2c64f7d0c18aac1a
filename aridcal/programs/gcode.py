"""G-code of a gantry."""

from __future__ import annotations

from aridcal.programs.cell import Cell, Reading
from aridcal.programs.language import Language
from aridcal.programs.project import Project


def read(project: Project, cell: Cell) -> Reading:
    """Targets of a project."""
    raise NotImplementedError


ROW = Language("G-code", (".nc", ".gcode", ".ngc", ".cnc"), read)
