"""Dates and times of day as seconds: strict about what is a date, never guessing which number is the month."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

ORDERS = ("ymd", "dmy", "mdy")
"""In which day, month and year may stand."""

MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
"""Where a month is a word, no order is needed."""

NUMBERS = re.compile(r"(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})\.?")
COMPACT = re.compile(r"(\d{4})(\d{2})(\d{2})(?=[T _]|$)")
WORDS = re.compile(
    r"(?:(\d{1,2})[-. ]+([A-Za-z]{3})[a-z]*[-., ]+(\d{4})|([A-Za-z]{3})[a-z]*[-. ]+(\d{1,2}),?[- ]+(\d{4}))"
)
CLOCK = re.compile(
    r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?)?\s*([AaPp])?\.?(?:[Mm]\.?)?\s*(Z|UTC|GMT|[-+]\d{2}:?\d{2})?"
)
CENTURY = 70
"""Years of two digits from here on are of 1900."""

DAY = 86_400.0


def seconds(cell: str, order: str) -> float | None:
    """Seconds since 1970 of a date with or without a time of day, or since midnight of a time of day alone.

    Args:
        cell: As it is written.
        order: Of day, month and year where all three are numbers; a year of four digits that stands first is one anyway.

    Returns:
        None where it is none: no such day, or one of another order.
    """
    text = cell.strip()
    date, rest = _date(text, order)
    if date is None:
        return _clock(text)
    if not rest:
        return date
    clock = _clock(rest.lstrip("T_,").strip())
    return None if clock is None else date + clock


def orders(cells: Sequence[str]) -> tuple[str, ...]:
    """Orders in which every one of some cells is a date; several where nothing tells."""
    return tuple(order for order in ORDERS if all(seconds(cell, order) is not None for cell in cells))


def has_date(cell: str) -> bool:
    """True of a date, false of a time of day alone."""
    return any(_date(cell.strip(), order)[0] is not None for order in ORDERS)


def _date(text: str, order: str) -> tuple[float | None, str]:
    """Seconds at the beginning of a date, and what follows it."""
    if (found := COMPACT.match(text)) is not None:
        year, month, day = found.groups()
    elif (found := NUMBERS.match(text)) is not None:
        parts = (found[1], found[3], found[4])
        if len(parts[0]) == 4:
            order = "ymd"
        elif len(parts[0]) > 2 or len(parts[2]) not in (2, 4) or order == "ymd":
            return None, text
        where = {letter: part for letter, part in zip(order, parts, strict=True)}
        year, month, day = where["y"], where["m"], where["d"]
    elif (found := WORDS.match(text)) is not None:
        word = (found[2] or found[4]).lower()
        if word not in MONTHS:
            return None, text
        year, month, day = found[3] or found[6], str(MONTHS.index(word) + 1), found[1] or found[5]
    else:
        return None, text
    if len(year) <= 2:
        year = str(int(year) + (1900 if int(year) >= CENTURY else 2000))
    try:
        begin = datetime(int(year), int(month), int(day), tzinfo=UTC)
    except ValueError:
        return None, text
    return begin.timestamp(), text[found.end() :]


def _clock(text: str) -> float | None:
    """Seconds since midnight, of UTC where a zone is said."""
    found = CLOCK.fullmatch(text.strip())
    if found is None:
        return None
    hour, minute, second = int(found[1]), int(found[2]), int(found[3] or 0)
    if found[5]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + 12 * (found[5].lower() == "p")
    if hour > 23 or minute > 59 or second > 60:
        return None
    part = float(f"0.{found[4]}") if found[4] else 0.0
    return 3600.0 * hour + 60.0 * minute + second + part - _ahead(found[6])


def _ahead(zone: str | None) -> float:
    """Seconds by which a zone is ahead of UTC."""
    if zone is None or zone[0] not in "+-":
        return 0.0
    digits = zone[1:].replace(":", "")
    size = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])
    return -size if zone[0] == "-" else size
