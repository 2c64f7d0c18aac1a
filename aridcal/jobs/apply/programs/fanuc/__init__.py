"""LS of FANUC: TP programs with their points in /POS, frames by number, and the controller's listings of these."""

from __future__ import annotations

from aridcal.jobs.apply.programs.fanuc.listings import ENDING, context, read
from aridcal.jobs.apply.programs.language import Language

ROW = Language("FANUC LS", (ENDING,), read, context=context)
