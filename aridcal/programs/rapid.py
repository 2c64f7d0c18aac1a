"""RAPID of ABB."""

from __future__ import annotations

from aridcal.programs.cell import Cell, Reading
from aridcal.programs.language import Language
from aridcal.programs.project import Project


def read(project: Project, cell: Cell) -> Reading:
    """Targets of a project."""
    raise NotImplementedError


ROW = Language("RAPID", (".mod", ".modx", ".prg", ".sys"), read)
