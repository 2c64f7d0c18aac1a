"""LS of FANUC: TP programs with their points in /POS, frames by number, and the controller's listings of these."""

from __future__ import annotations

from aridcal.programs.fanuc.project import ENDING, context, read
from aridcal.programs.language import Language

ROW = Language("FANUC LS", (ENDING,), read, context=context)
