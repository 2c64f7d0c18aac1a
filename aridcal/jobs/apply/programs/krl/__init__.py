"""KRL of KUKA: programs, their data lists, and the controller's own."""

from __future__ import annotations

from aridcal.jobs.apply.programs.krl.reading import context, read
from aridcal.jobs.apply.programs.krl.writing import comment, program
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.moves import ARM_AXES

ROW = Language("KRL", (".src", ".dat"), read, context=context, comment=comment, write=program, external=ARM_AXES)
