"""Where in a file of text the table stands: its separator, its header lines, its first row, what is no row."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from aridcal.files.formats.number_marks import is_number
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.dialect import BLANKS
from aridcal.system.reading.tables_in_dialect import is_units, joined_header, split_line, strip_comment

TRIED_SEPARATORS = ("\t", ";", ",", "|", BLANKS)
"""Tried in this order; of two that part the same numbers the first, blanks only where nothing else parts any."""

FEWEST_NUMBERS = 3
"""Numbers of a row: a table of measurements has more columns than that."""

NUMERIC_SHARE = 0.8
"""Share of rows in which a column is a number, if it is one of numbers."""

ABOVE = 12
"""Lines above the first row among which names are looked for."""

COMMENTS = ("#", "%", "//", "!", ";")
"""What lines of comment begin with."""

SUMMARIES = frozenset({
    "mean", "average", "avg", "std", "stdev", "std.dev", "sigma", "min", "max", "minimum", "maximum", "total", "sum", "rms",
    "range", "median", "count", "mittelwert", "durchschnitt", "standardabweichung", "summe", "moyenne", "promedio", "media",
})  # fmt: skip
"""Words that rows begin with which are computed from others."""


LAST_CHOSEN = frozenset({"id", "parent", "type"})
"""Titles of lines of a header that tell columns apart, but not to people."""


@dataclass(frozen=True)
class TableLayout:
    """Where a table stands.

    Attributes:
        separator: Between cells.
        header: Lines of the header, counted from 1; none where nothing names the columns.
        first: Line of the first row.
        comment: What lines begin with that are no rows.
        names: Of the columns; none without a header.
        rows: Cells of the rows that were looked at.
        numeric: Columns of numbers.
        score: How many numbers the separator parts.
    """

    separator: str
    header: tuple[int, ...]
    first: int
    comment: tuple[str, ...]
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: frozenset[int]
    score: int


def layout(lines: Sequence[str]) -> TableLayout | None:
    """The layout that makes the most numbers of some lines; None where none makes a table of them."""
    best: TableLayout | None = None
    for separator in TRIED_SEPARATORS:
        if separator == BLANKS and best is not None:  # words of names are parted by blanks, too
            return best
        found = _layout(lines, separator)
        if found and (best is None or found.score > best.score):
            best = found
    return best


def _layout(lines: Sequence[str], separator: str) -> TableLayout | None:
    marks = tuple(mark for mark in COMMENTS if mark != separator)
    used: set[str] = set()
    split: list[list[str]] = []
    commented: list[bool] = []
    for line in lines:
        mark = next((mark for mark in marks if line.lstrip().startswith(mark)), "")
        commented.append(bool(mark))
        used |= {mark} - {""}
        split.append(split_line(line, separator))
    counts = [0 if c else sum(map(_weight, cells)) for c, cells in zip(commented, split, strict=True)]
    widths = Counter(
        len(cells) for cells, count in zip(split, counts, strict=True) if count >= FEWEST_NUMBERS and len(cells) > 1
    )
    if not widths:
        return None
    width = max(widths, key=lambda size: (widths[size] * size, size))
    rows = [k for k, cells in enumerate(split) if counts[k] >= FEWEST_NUMBERS and len(cells) == width]
    numeric = _numeric([split[k] for k in rows], width)
    rows = [k for k in rows if _is_row(split[k], numeric)]
    if not rows:
        return None
    numeric = _numeric([split[k] for k in rows], width)
    first = rows[0]
    while first and not commented[first - 1] and _is_broken_row(split[first - 1], numeric):
        first -= 1
    comment = sorted(used) + _summaries(split, rows, numeric, first)
    header = _header(lines, split, commented, first, comment, separator, numeric, width)
    names = joined_header([split_line(strip_comment(lines[k], comment), separator) for k in header]) if header else []
    _refuse_second_header(split, header, rows, numeric)
    return TableLayout(
        separator, tuple(k + 1 for k in header), first + 1, tuple(comment), tuple(names),
        tuple(tuple(split[k]) for k in rows), frozenset(numeric), sum(counts[k] for k in rows),
    )  # fmt: skip


def _weight(cell: str) -> int:
    """Numbers in a cell: one, or those of a list."""
    return 1 if is_number(cell) else list_size(cell)


def list_size(cell: str) -> int:
    """How many numbers a cell holds that is a list of them; 0 if it is none."""
    return len(list_parts(cell))


def list_parts(cell: str) -> list[str]:
    """The numbers in a cell that is a list of them, in brackets of some sort; none if it is none."""
    bare = cell.strip().lower().removeprefix("pose").removeprefix("p").strip()
    if len(bare) < 5 or (bare[0], bare[-1]) not in {("[", "]"), ("(", ")"), ("{", "}")}:
        return []
    for sign in "[](){}":
        bare = bare.replace(sign, " ")
    parts = bare.replace(";", " ").replace(", ", " ").split()
    if len(parts) == 1 or not all(map(is_number, parts)):
        parts = [part for part in re.split(r"[;,\s]+", bare) if part]
    return parts if len(parts) > 1 and all(map(is_number, parts)) else []


def _numeric(rows: Sequence[Sequence[str]], width: int) -> set[int]:
    """Columns in which most filled cells are numbers, and some are filled."""
    numeric = set()
    for k in range(width):
        filled = [row[k] for row in rows if row[k]]
        if filled and sum(1 for cell in filled if _weight(cell)) >= NUMERIC_SHARE * len(filled):
            numeric.add(k)
    return numeric


def _is_row(cells: Sequence[str], numeric: set[int]) -> bool:
    """True of a line that has numbers, or nothing, where rows have numbers."""
    return sum(1 for k in numeric if not cells[k] or _weight(cells[k])) >= NUMERIC_SHARE * len(numeric)


def _is_broken_row(cells: Sequence[str], numeric: set[int]) -> bool:
    """True of a line that is no row, but for a cell too many or without a number: one of decimals, which no names are."""
    return 2 * sum(1 for cell in cells if is_number(cell) and set(cell) & set(".,")) > len(numeric)


def _refuse_second_header(
    split: Sequence[Sequence[str]], header: Sequence[int], rows: Sequence[int], numeric: set[int]
) -> None:
    """Refuse a file in which another table follows, of the same width and with its columns in another order.

    Raises:
        MeasurementError: naming the line of its header.
    """
    if not header:
        return
    own = split[header[-1]]
    for k in range(rows[0], rows[-1]):
        cells = split[k]
        words = [cell for cell in cells if cell and not is_number(cell)]
        known = sum(1 for cell in words if cell in own)
        if len(cells) == len(own) and 2 * known >= len(numeric) and list(cells) != list(own):
            raise MeasurementError(
                f"line {k + 1}: another header, in another order than that of line {header[-1] + 1}: these are two tables. Write "
                "each into a file of its own"
            )


def _summaries(split: Sequence[Sequence[str]], rows: Sequence[int], numeric: set[int], first: int) -> list[str]:
    """Beginnings of rows that are computed from others: no measurements, though they have all their numbers."""
    return sorted(
        {split[k][0] for k in range(first, len(split)) if split[k] and split[k][0].lower().rstrip(":.") in SUMMARIES}
    )


def _header(
    lines: Sequence[str],
    split: Sequence[Sequence[str]],
    commented: Sequence[bool],
    first: int,
    comment: Sequence[str],
    separator: str,
    numeric: set[int],
    width: int,
) -> list[int]:
    """Lines that name the columns, from the top: no more of them than make the names differ, and the units."""
    units: list[int] = []
    above: list[int] = []
    cells_of: dict[int, list[str]] = {}
    for k in range(first - 1, max(first - 1 - ABOVE, -1), -1):
        cells = split_line(strip_comment(lines[k], comment), separator) if commented[k] else list(split[k])
        if not cells:
            if above:
                break
            continue
        if len(cells) < 2 or len(cells) > width + 1:
            if not above:  # a remark between names and rows
                continue
            break
        cells_of[k] = cells
        if not above and not is_units(cells) and sum(map(bool, cells)) < len(numeric) / 2:
            continue  # a remark between names and rows
        if is_units(cells) and not units:
            units.append(k)
        else:
            above.append(k)
    if not above:
        return []
    upper = sorted(above[1:], key=lambda k: any(cell.lower() in LAST_CHOSEN for cell in cells_of[k][:2]))
    choices = [(above[0],), *((k, above[0]) for k in upper), *((a, b, above[0]) for a, b in combinations(upper, 2))]
    for chosen in choices:
        names = joined_header([cells_of[k] for k in sorted(chosen)])
        shown = [names[k] if k < len(names) else "" for k in sorted(numeric)]
        if all(name and not is_number(name) and "#" not in name.split(" ")[-1] for name in shown):
            return sorted([*chosen, *units])
    worded = [k for k in above if sum(1 for cell in cells_of[k] if cell and not is_number(cell)) >= len(numeric) / 2]
    return sorted([*worded[:1], *units]) if worded else []
