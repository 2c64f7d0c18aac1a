"""Which marks numbers are written with: what the cells of a table prove, and what they leave open."""

from __future__ import annotations

import re
from collections.abc import Iterable

from aridcal.system.errors import MeasurementError
from aridcal.system.reading.numerals import LOOKALIKE_CHARACTERS

_GROUPS = {".": ",' ", ",": ".' "}
NUMBER_IN_ANY_DIALECT = re.compile(
    "[-+]?(?:"
    + "|".join(
        rf"\d{{1,3}}(?:{re.escape(group)}\d{{3}})+(?:{re.escape(point)}\d*)?"
        for point, groups in _GROUPS.items()
        for group in groups
    )
    + r"|\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?"
)
"""A number in any dialect."""

GROUPED = {mark: re.compile(rf"[1-9]\d{{0,2}}(?:{re.escape(mark)}\d{{3}})+") for mark in ".,' "}
"""Digits in groups of three; no group begins with a nought."""


def plain(cell: str) -> str:
    """A cell with the usual characters for minus, blanks and apostrophes."""
    if not cell.isascii():
        for odd, meant in LOOKALIKE_CHARACTERS.items():
            cell = cell.replace(odd, meant)
    return cell.strip()


def is_number(cell: str) -> bool:
    """True of what is a number in some dialect."""
    return NUMBER_IN_ANY_DIALECT.fullmatch(plain(cell)) is not None


def marks(cells: Iterable[str], title: str) -> list[tuple[str, str]]:
    """Which decimal sign and which mark of thousands the numbers of a table can have, the usual ones first.

    Args:
        cells: Its numbers.
        title: Of the file, for messages.

    Returns:
        Pairs of both; several where the numbers do not tell, ``1,234`` and the like alone.

    Raises:
        MeasurementError: some have decimal points and some decimal commas.
    """
    decimals: dict[str, str] = {}
    groups: set[str] = set()
    open_: set[str] = set()
    for cell in cells:
        digits = re.split("[eE]", plain(cell).lstrip("+-"))[0]
        found = [mark for mark in ".,' " if mark in digits]
        for mark in "' ":
            if mark in found:
                groups.add(mark)
        points = [mark for mark in ".," if mark in found]
        if len(points) == 2:
            last = max(points, key=digits.rfind)
            decimals.setdefault(last, cell)
            groups.add(next(mark for mark in points if mark != last))
        elif points and digits.count(points[0]) > 1:
            groups.add(points[0])
        elif points and (len(found) > 1 or not GROUPED[points[0]].fullmatch(digits)):
            decimals.setdefault(points[0], cell)
        elif points:
            open_.add(points[0])
    both = sorted(set(decimals) & groups) or (sorted(decimals) if len(decimals) > 1 else [])
    if both or len(groups) > 1:
        shown = " and ".join(repr(cell) for cell in decimals.values()) or "several marks of thousands"
        raise MeasurementError(
            f"{title}: its numbers are not all written in one way ({shown}); export it again with one decimal sign, or set "
            "`table.decimal`, which makes the others no numbers"
        )
    group = next(iter(groups), "")
    if decimals:
        decimal = next(iter(decimals))
        return [(decimal, group or next(iter(open_ - {decimal}), ""))]
    if not open_:
        return [("," if group == "." else ".", group)]
    choices = []
    for decimal in sorted(open_ - {group}, reverse=True):  # point before comma
        choices.append((decimal, group or next(iter(open_ - {decimal}), "")))
    for mark in sorted(open_, reverse=True):
        if not group or group == mark:
            choices.append(("," if mark == "." else ".", mark))
    return [choice for k, choice in enumerate(choices) if choice not in choices[:k]]
