"""G-code of a gantry."""

from __future__ import annotations

from aridcal.jobs.apply.programs.gcode.marking import comment
from aridcal.jobs.apply.programs.gcode.reading import read
from aridcal.jobs.apply.programs.language import Language

ROW = Language("G-code", (".nc", ".gcode", ".ngc", ".cnc", ".tap"), read, comment=comment)
