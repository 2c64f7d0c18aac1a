"""G-code of a gantry."""

from __future__ import annotations

from aridcal.programs.gcode.marking import comment
from aridcal.programs.gcode.reading import read
from aridcal.programs.language import Language

ROW = Language("G-code", (".nc", ".gcode", ".ngc", ".cnc", ".tap"), read, comment=comment)
