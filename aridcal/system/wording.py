"""Numbers, readings and lists as text, for screens, files and pages alike."""

from __future__ import annotations

import math
from collections.abc import Sequence

SMALL, LARGE, MOST_DECIMALS = 1e-4, 1e6, 9
"""Numbers between the first two are written without an exponent, with no more decimals than the third."""

SHOWN_UNIT = {"rad": "mrad", "m": "mm"}
"""A thousandth of a unit, in which it is shown."""


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, a dash where there is none.

    ``0.0123`` and ``1,234`` are written out; what is below :data:`SMALL` or from :data:`LARGE` on has an exponent.
    """
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    size = abs(value)
    if not SMALL <= size < LARGE:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    leading = math.floor(math.log10(size))  # place of the first digit: 0 for 1 to 9.99
    return fixed(value, max(digits - 1 - leading, 0))


def plus_minus(value: float, std: float) -> str:
    """A value with its standard deviation, both to two digits of the latter; the value alone if there is none."""
    if not (math.isfinite(std) and std > 0):
        return number(value, 4)
    leading = math.floor(math.log10(std))
    decimals = min(max(1 - leading, 0), MOST_DECIMALS)
    return f"{fixed(value, decimals)} ± {fixed(std, decimals)}"


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals, and no sign on zero."""
    return f"{round(value, decimals) + 0.0:,.{decimals}f}".replace("-", "−")


def plural(count: int, what: str) -> str:
    """A number of things: `1 row`, `1,495 rows`."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def shown_unit(unit: str) -> tuple[str, float]:
    """Unit in which a quantity in SI is shown, and what it is multiplied with."""
    return (SHOWN_UNIT[unit], 1e3) if unit in SHOWN_UNIT else (unit, 1.0)


def range_in_words(ends: tuple[float, float] | None, kind: str) -> str:
    """A range of a joint's readings, [rad] or [m]; None stands for no limits."""
    if ends is None:
        return "no limits"
    low, high = (reading_in_words(value, kind) for value in ends)
    return f"{low} … {high}"


def reading_in_words(value: float, kind: str) -> str:
    """A joint reading, [rad] or [m], with its unit; ``kind`` is that of the joint."""
    return f"{fixed(value, 3)} m" if kind == "prismatic" else f"{fixed(math.degrees(value), 0)}°"


def enumeration(words: Sequence[str]) -> str:
    """Words one after the other: ``a, b and c``."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
