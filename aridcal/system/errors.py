"""What can go wrong through no fault of the code: every error a user can cause, and what to do about it."""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Iterable, Sequence


class AridcalError(Exception):
    """Bad input or use. The message names the culprit and the remedy; commands print it and exit with status 2."""


class CampaignError(AridcalError):
    """A settings file (campaign, scenario, head) cannot be used as it stands."""


class RobotError(AridcalError):
    """A URDF cannot be read, or the chain asked for is not in it."""


class MeasurementError(AridcalError):
    """A table of measurements cannot be read, or nothing usable is left of it."""


class NotOfThisRobot(MeasurementError):
    """Measurements that no constants of this robot explain: of another robot, or not read as they were written."""


class CovariateNotFound(AridcalError):
    """An effect depends on a column that was not measured."""


class OutputError(AridcalError):
    """Results cannot be written where they were asked for."""


class BusyError(OutputError):
    """Another process is writing just there."""


class NotIdentifiable(AridcalError):
    """Some coefficients are confounded in these measurements."""

    def __init__(self, groups: Sequence[Sequence[str]]) -> None:
        self.groups = groups
        mixed = "; ".join(" with ".join(names) for names in groups)
        super().__init__(f"confounded: {mixed}. Fix one of each, or measure poses that separate them.")


CONTROL_CATEGORIES = frozenset({"Cc", "Zl", "Zp", "Cs"})
"""Unicode's categories of control characters, line and paragraph separators, and halves of characters."""

SHOWN_LENGTH = 60
"""Characters of a user's text that a message shows."""

SHOWN_NAMES = 30
"""Known names that a message lists."""

COMPARED_NAMES = 1000
"""Known names among which a misspelt one is looked for: comparing two takes some 20 µs."""


def has_controls(text: str) -> bool:
    """True of text that moves the cursor or breaks a line."""
    return not text.isprintable() and any(unicodedata.category(c) in CONTROL_CATEGORIES for c in text)


def printable(text: str) -> str:
    """The text with control characters spelt out, as Python writes them."""
    if text.isprintable():
        return text
    spelt = (repr(c)[1:-1] if unicodedata.category(c) in CONTROL_CATEGORIES else c for c in text)
    return "".join(spelt)


def printable_lines(text: str) -> str:
    """The text with control characters spelt out, all but line breaks and tabs."""
    if text.isprintable():
        return text
    return "".join(piece if piece in ("\n", "\t") else printable(piece) for piece in re.split("([\n\t])", text))


def shortened(text: str, most: int = SHOWN_LENGTH) -> str:
    """The text, or its beginning with three dots."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def name_list(names: Sequence[str]) -> str:
    """Names for a message: the first of them, and how many more there are."""
    more = f" and {len(names) - SHOWN_NAMES:,} more" if len(names) > SHOWN_NAMES else ""
    return ", ".join(shortened(name) for name in names[:SHOWN_NAMES]) + more


def nearest(name: str, choices: Iterable[str]) -> str:
    """A hint for a misspelt name: ``" (did you mean 'x'?)"``, or the names to choose from, or nothing."""
    names = [str(k) for k in choices]
    short = [k for k in names[:COMPARED_NAMES] if len(k) <= SHOWN_LENGTH]
    close = difflib.get_close_matches(name, short, n=1, cutoff=0.5) if len(name) <= SHOWN_LENGTH else []
    if close:
        return f" (did you mean {close[0]!r}?)"
    return f" (known: {name_list(names)})" if names else ""
