"""URScript of Universal Robots: programs by hand, of PolyScope and of offline systems."""

from __future__ import annotations

from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.urscript.reader import comment, read
from aridcal.jobs.apply.programs.urscript.writer import write

ROW = Language("URScript", (".script", ".urscript"), read, 1.0, 1.0, comment=comment, write=write)
