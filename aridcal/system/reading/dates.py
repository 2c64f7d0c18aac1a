"""Dates and times of day as seconds: strict about what is a date, never guessing which number is the month."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

DATE_ORDERS = ("ymd", "dmy", "mdy")
"""Orders in which day, month and year may stand."""

MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
"""Where a month is a word, no order is needed."""

DATE_NUMBERS = re.compile(r"(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})\.?")
COMPACT = re.compile(r"(\d{4})(\d{2})(\d{2})(?=[T _]|$)")
DATE_WITH_WORDS = re.compile(
    r"(?:(\d{1,2})[-. ]+([A-Za-z]{3})[a-z]*[-., ]+(\d{4})|([A-Za-z]{3})[a-z]*[-. ]+(\d{1,2}),?[- ]+(\d{4}))"
)
CLOCK = re.compile(
    r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?)?\s*([AaPp])?\.?(?:[Mm]\.?)?\s*(Z|UTC|GMT|[-+]\d{2}:?\d{2})?"
)
CENTURY = 70
"""Years of two digits from here on are of 1900."""

DAY = 86_400.0

MOST_DAYS = 7
"""Steps back of a clock that may each be another day; a table in no order at all has more."""

SWAPPED = 10.0
"""Usual steps of a clock: one that steps back by less has no new day, but rows that changed their places."""


NIGHTS = (
    "steps back as if it passed midnight more than once, or a night, and has no date: add the date, put rows in the order in "
    "which they were measured, or leave the column out (`ignore`, `table.dates`)"
)
"""What a message says of a column of times that pass several nights."""


def seconds(cell: str, order: str) -> float | None:
    """Seconds since 1970 of a date with or without a time of day, or since midnight of a time of day alone.

    Args:
        cell: As it is written.
        order: Of day, month and year where all three are numbers; a year of four digits that stands first is one anyway.

    Returns:
        None where it is none: no such day, or one of another order.
    """
    text = cell.strip()
    date, clock_text = _date(text, order)
    if date is None:
        return _clock(text)
    if not clock_text:
        return date
    clock = _clock(clock_text.lstrip("T_,").strip())
    return None if clock is None else date + clock


def orders(cells: Sequence[str]) -> tuple[str, ...]:
    """Orders in which every one of some cells is a date; several where nothing tells."""
    return tuple(order for order in DATE_ORDERS if all(seconds(cell, order) is not None for cell in cells))


def has_date(cell: str) -> bool:
    """True of a date, false of a time of day alone."""
    return any(_date(cell.strip(), order)[0] is not None for order in DATE_ORDERS)


def unrolled(clock: np.ndarray, of_day: bool) -> np.ndarray | None:
    """Times in the order of their rows, with a day added from midnight on where they are times of day and pass it once.

    Args:
        clock: Shape (N,), [s], NaN where a row has none.
        of_day: True of what was written as times of day; other numbers may count from anything.

    Returns:
        Shape (N,); None where rows pass midnight, or a night, and nobody can tell how often: to sort them would mix their days.
    """
    rows = np.flatnonzero(np.isfinite(clock))
    times = clock[rows]
    back = np.flatnonzero(np.diff(times) < 0)
    if not len(back) or not (of_day or (times.min() >= 0.0 and times.max() < DAY)):
        return clock
    by = times[back] - times[back + 1]
    before, after = times[: back[0] + 1], times[back[0] + 1 :]
    if len(back) == 1 and by[0] > DAY / 2 and after.max() < before.min():
        later = np.zeros(len(clock))
        later[rows[back[0] + 1 :]] = DAY
        return clock + later
    few, long = len(back) <= MOST_DAYS, by > DAY / 2
    if of_day:
        nights = bool(long.any()) or (few and bool(np.any(by > SWAPPED * np.median(np.abs(np.diff(times))))))
    else:
        nights = few and bool(long.all())
    return None if nights else clock


def times_of_day(clock: np.ndarray, low: float, high: float) -> np.ndarray:
    """Times of day, shape (N,), as those between two others count that pass midnight."""
    after = (clock >= 0.0) & (clock < low) & (clock + DAY <= high)
    return np.where((low < DAY <= high < low + DAY) & after, clock + DAY, clock)


def _date(text: str, order: str) -> tuple[float | None, str]:
    """Seconds at the beginning of a date, and what follows it."""
    if (match := COMPACT.match(text)) is not None:
        year, month, day = match.groups()
    elif (match := DATE_NUMBERS.match(text)) is not None:
        parts = (match[1], match[3], match[4])
        if len(parts[0]) == 4:
            order = "ymd"
        elif len(parts[0]) > 2 or len(parts[2]) not in (2, 4) or order == "ymd":
            return None, text
        where = {letter: part for letter, part in zip(order, parts, strict=True)}
        year, month, day = where["y"], where["m"], where["d"]
    elif (match := DATE_WITH_WORDS.match(text)) is not None:
        word = (match[2] or match[4]).lower()
        if word not in MONTHS:
            return None, text
        year, month, day = match[3] or match[6], str(MONTHS.index(word) + 1), match[1] or match[5]
    else:
        return None, text
    if len(year) <= 2:
        year = str(int(year) + (1900 if int(year) >= CENTURY else 2000))
    try:
        begin = datetime(int(year), int(month), int(day), tzinfo=UTC)
    except ValueError:
        return None, text
    return begin.timestamp(), text[match.end() :]


def _clock(text: str) -> float | None:
    """Seconds since midnight, of UTC where a zone is said."""
    match = CLOCK.fullmatch(text.strip())
    if match is None:
        return None
    hour, minute, second = int(match[1]), int(match[2]), int(match[3] or 0)
    if match[5]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + 12 * (match[5].lower() == "p")
    if hour > 23 or minute > 59 or second > 60:
        return None
    fraction = float(f"0.{match[4]}") if match[4] else 0.0
    return 3600.0 * hour + 60.0 * minute + second + fraction - _ahead(match[6])


def _ahead(zone: str | None) -> float:
    """Seconds by which a zone is ahead of UTC."""
    if zone is None or zone[0] not in "+-":
        return 0.0
    digits = zone[1:].replace(":", "")
    size = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])
    return -size if zone[0] == "-" else size
