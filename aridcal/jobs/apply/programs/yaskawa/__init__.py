"""INFORM of Yaskawa: jobs with their positions in //POS, user frames and tools by number, and the controller's files of these."""

from __future__ import annotations

from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.yaskawa.project import ENDING, context, read

ROW = Language("INFORM", (ENDING,), read, context=context)
