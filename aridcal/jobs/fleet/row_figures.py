"""Numbers of a fleet's rows, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from aridcal.engine.corrections.effect import MOUNTING_FRAMES
from aridcal.jobs.fleet.run_record import DONE, Row

STAGES = ("nominal", "geometric", "final")


def error_of(row: Row, stage: str, channel: str, figure: str = "rms") -> float:
    """An error on held-out rows, in the channel's unit; NaN where there is none."""
    for found in row["stages"]:
        if found["stage"] == stage and found["channel"] == channel:
            return math.nan if found[figure] is None else float(found[figure])
    return math.nan


def channels_of(rows: Sequence[Row]) -> tuple[str, ...]:
    """Channels that rows have, each once, in their order."""
    return tuple(dict.fromkeys(found["channel"] for row in rows for found in row["stages"]))


def identified(row: Row) -> dict[str, Mapping[str, object]]:
    """Constants of the arm that a run identified, by name."""
    return {
        c["name"]: c
        for c in row["constants"]
        if c["status"] == "identified" and c["std"] is not None and not c["name"].startswith(MOUNTING_FRAMES)
    }


def are_done(rows: Sequence[Row]) -> list[Row]:
    """Those that came to a result."""
    return [row for row in rows if row["status"] == DONE]
