"""What is said while measuring: events, as one JSON object a line, units in the names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

What = Literal["slip", "stale", "outlier", "unit", "clock", "target", "table", "robot"]
"""Causes of alarms: something moved; a reading that was not renewed; a reading that is off; columns in another unit; times
that go backwards; a target that was not seen before; a line that is no row; rows that this robot cannot have made."""

Why = Literal["tolerance", "nothing to gain", "asked"]


@dataclass(frozen=True)
class RowRead:
    """A row that was read, or all rows of an image.

    Attributes:
        row: Line of the table; the header is line 1.
        ok: False where it is not used as it stands.
        reasons: What is wrong or odd about it, in words.
        count: Rows that are judged together, this one and those after it: those of an image.
    """

    row: int
    ok: bool
    reasons: tuple[str, ...] = ()
    count: int = 1

    def document(self) -> dict[str, Any]:
        """As plain data."""
        several = {"count": self.count} if self.count > 1 else {}
        return {"event": "row", "row": self.row, "ok": self.ok, "reasons": list(self.reasons), **several}


@dataclass(frozen=True)
class Alarm:
    """Something that calls for action.

    Attributes:
        row: Line of the table at which it began.
        what: Its cause.
        words: The same in words.
        do: What to do.
    """

    row: int
    what: What
    words: str
    do: str

    def document(self) -> dict[str, Any]:
        """As plain data."""
        return {"event": "alarm", "row": self.row, "what": self.what, "words": self.words, "do": self.do}


@dataclass(frozen=True)
class Known:
    """How well the target is known now.

    Attributes:
        rows: Rows in use.
        position: What 95 % of the region keep within with 95 % confidence, [m]; infinite while nothing can be said.
        rotation: The same of the turn, [rad]; infinite where rows do not tell how the target is turned.
        more: Rows that the tolerance still takes, if they go on as now; None where nobody can say, or none was given.
    """

    rows: int
    position: float
    rotation: float
    more: int | None = None

    def document(self) -> dict[str, Any]:
        """As plain data; null while nothing can be said."""
        figures = {"position_mm": _thousandths(self.position), "rotation_mrad": _thousandths(self.rotation)}
        return {"event": "known", "rows": self.rows, **figures, "more": self.more}


@dataclass(frozen=True)
class Next:
    """The pose to measure next.

    Attributes:
        joints: In the campaign's columns and units, and what to measure there where there are several things.
        why: What it is for.
        labels: Columns that say what is measured.
    """

    joints: Mapping[str, float]
    why: str
    labels: Mapping[str, str] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """As plain data."""
        beside = {"measure": dict(self.labels)} if self.labels else {}
        return {"event": "next", "joints": dict(self.joints), "why": self.why, **beside}


@dataclass(frozen=True)
class Stop:
    """The end of the measurements.

    Attributes:
        why: Its reason.
        words: The same in words.
        known: How well the target is known.
        check: Poses that check the calibration, in the campaign's columns and units.
        results: Folder of the report; empty where there is none.
    """

    why: Why
    words: str
    known: Known
    check: tuple[Mapping[str, float], ...] = ()
    results: str = ""

    def document(self) -> dict[str, Any]:
        """As plain data."""
        known = {name: value for name, value in self.known.document().items() if name not in ("event", "more")}
        beside = {"results": self.results} if self.results else {}
        return {
            "event": "stop",
            "why": self.why,
            "words": self.words,
            **known,
            "check": [dict(joints) for joints in self.check],
            **beside,
        }


Event: TypeAlias = RowRead | Alarm | Known | Next | Stop


def _thousandths(value: float) -> float | None:
    """A length in mm or a turn in mrad; None where it is not finite."""
    return round(1e3 * value, 6) if value < float("inf") else None
