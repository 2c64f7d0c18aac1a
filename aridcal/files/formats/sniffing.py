"""How a table is written, found by looking at it once; what it does not tell is left open, never guessed.

`aridcal init` writes what is found here into the campaign, and whatever reads the table afterwards goes by that alone.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from aridcal.files.formats import robot_calibration
from aridcal.files.formats.encodings import encoding
from aridcal.files.formats.layout import TableLayout, layout, list_parts, list_size
from aridcal.files.formats.makers import maker
from aridcal.files.formats.number_marks import is_number, marks
from aridcal.system.errors import MeasurementError, name_list
from aridcal.system.reading import workbooks
from aridcal.system.reading.dates import has_date, orders, seconds
from aridcal.system.reading.dialect import PLAIN, Dates, Dialect
from aridcal.system.reading.numerals import numbers_in_list
from aridcal.system.reading.regular_files import Limit
from aridcal.system.reading.tables_in_dialect import LINE_END, decoded

SNIFFED_LINES = 3000
"""Lines that are looked at: more make nothing plainer."""

MOST_CHARACTERS = 4_000_000
"""Characters that are looked at; some of a line of any length."""

AT_FIRST = 40
"""Lines among which a maker's name is looked for."""

POSE_OF_SIX = ("x", "y", "z", "rx", "ry", "rz")
"""Names for a list of six numbers that is called a pose."""

NESTED_LIST = re.compile(r"[\[({]([^\[\](){}]*)[\])}]")
"""A list in a list."""

POSE_OF_SEVEN = ("x", "y", "z", "q1", "q2", "q3", "q4")

CLOCK_WORDS = ("time", "stamp", "date", "zeit", "datum", "uhrzeit", "heure", "fecha", "hora")
"""In the name of a column that may be of dates."""

Pick = Callable[[str, str, Sequence[str], str], int]
"""Asks: key, question, answers, why; gives the number of the answer, or raises."""


@dataclass(frozen=True)
class FileFormat:
    """How a file is written.

    Attributes:
        dialects: All that it may be in, the likeliest first.
        maker: Of the program that wrote it; empty where nothing tells.
    """

    dialects: tuple[Dialect, ...]
    maker: str = ""


def look(content: bytes, path: Path, limit: Limit, pick: Pick) -> FileFormat:
    """Find out how a file is written.

    Args:
        content: Its bytes.
        path: Its name.
        limit: How much may be read.
        pick: Asked where the file leaves a choice that no robot's motion decides.

    Raises:
        MeasurementError: it is no table, or one that is written in two ways at once.
    """
    ending = path.suffix.lower()
    if ending in robot_calibration.CALIBRATION_ENDINGS:
        return _samples(content, path, pick)
    sheet, coded, separated = "", "utf-8", ","
    if ending in workbooks.WORKBOOK_ENDINGS:
        sheet, text = _sheet(content, path, limit, pick)
    else:
        coded = encoding(content, path)
        text = decoded(content, path, coded)
    lines = LINE_END.split(text[:MOST_CHARACTERS])[:SNIFFED_LINES]
    who = maker(lines[:AT_FIRST])
    try:
        found = layout(lines)
    except MeasurementError as problem:
        raise MeasurementError(f"{path}, {problem}") from None
    if found is None:
        return FileFormat((replace(PLAIN, encoding=coded, sheet=sheet),), who)
    if ending not in workbooks.WORKBOOK_ENDINGS:
        separated = found.separator
    names = () if found.header else _names(found, path, who, pick)
    base = Dialect(
        encoding=coded,
        separator=separated,
        header=found.header,
        first_row=_first_row(found),
        comment=found.comment,
        sheet=sheet,
        names=names,
    )
    base = replace(base, lists=_lists(found), dates=_dates(found, path, pick))
    numbers = [row[k] for row in found.rows for k in found.numeric if k < len(row) and is_number(row[k])]
    numbers += [part for row in found.rows for cell in row for part in list_parts(cell)]
    if sheet or ending in workbooks.WORKBOOK_ENDINGS:
        numbers = [cell for cell in numbers if "," in cell] or numbers  # Excel's own numbers are none in any dialect
    pairs = marks(numbers, str(path))
    return FileFormat(tuple(replace(base, decimal=decimal, thousands=group) for decimal, group in pairs), who)


def as_keys(dialect: Dialect) -> dict[str, object]:
    """What `table` of a campaign says of a dialect: only what is not plain csv."""
    words = {"\t": "tab", " ": "blanks"}
    keys: dict[str, object] = {}
    for name in ("sheet", "encoding", "separator", "decimal", "thousands", "first_row", "export"):
        value = getattr(dialect, name)
        if value != getattr(PLAIN, name):
            keys[name] = {" ": "blank"}.get(value, value) if name == "thousands" else words.get(value, value)
    if dialect.names:
        keys["names"] = list(dialect.names)
    elif dialect.header != PLAIN.header:
        keys["header"] = dialect.header[0] if len(dialect.header) == 1 else list(dialect.header)
    if dialect.comment:
        keys["comment"] = list(dialect.comment)
    if dialect.lists:
        keys["lists"] = {name: list(parts) for name, parts in dialect.lists.items()}
    if dialect.dates:
        keys["dates"] = {"order": dialect.dates.order, "columns": list(dialect.dates.columns)}
    return keys


PLACE = ("x", "y", "z")

ORIENTATIONS = (("qx", "qy", "qz", "qw"), ("qw", "qx", "qy", "qz"), ("rx", "ry", "rz"), ())
"""Columns behind a position, the usual first."""

FEWEST_JOINTS, MOST_JOINTS = 2, 16
"""Columns that are left for joints where nobody names any."""


def _names(layout: TableLayout, path: Path, who: str, pick: Pick) -> tuple[str, ...]:
    """Names of the columns of a table without a header, as somebody chooses them: joints by their numbers, and a pose.

    Raises:
        MeasurementError: no usual table has so many columns.
    """
    count = len(layout.rows[0])
    answers: dict[str, tuple[str, ...]] = {}
    for turn in ORIENTATIONS:
        pose = (*PLACE, *turn)
        joints = count - len(pose)
        if FEWEST_JOINTS <= joints <= MOST_JOINTS and layout.numeric >= set(range(count)):
            numbered = tuple(f"q{k + 1}" for k in range(joints))
            answers[f"{joints} joints, then {' '.join(pose)}"] = (*numbered, *pose)
            answers[f"{' '.join(pose)}, then {joints} joints"] = (*pose, *numbered)
    nothing = f"no line names its {count} columns{_of(who)}"
    remedy = f"write their names above line {layout.first}, joints as in the URDF, then x y z and the orientation's"
    if not answers:
        raise MeasurementError(f"{path}: {nothing}; {remedy}")
    chosen = pick("table.names", f"{path}: which columns are these", list(answers), f"{nothing}; answer, or {remedy}")
    return list(answers.values())[chosen]


def _of(who: str) -> str:
    return f" (it looks like an export of {who})" if who else ""


def _first_row(layout: TableLayout) -> int:
    """0 where rows begin right below the header."""
    return 0 if layout.first == max(layout.header, default=0) + 1 else layout.first


def _samples(content: bytes, path: Path, pick: Pick) -> FileFormat:
    """Samples of robot_calibration, and the sensor that measured."""
    names = robot_calibration.sensors(content, path)
    if not names:
        raise MeasurementError(
            f"{path}: no sensor has points that change from sample to sample; measure more configurations"
        )
    k = 0 if len(names) == 1 else pick("table.sheet", "which sensor measured the target", names, f"{path} has several")
    return FileFormat(
        (replace(PLAIN, export=robot_calibration.FORMAT_NAME, sheet=names[k]),), robot_calibration.FORMAT_NAME
    )


def _sheet(content: bytes, path: Path, limit: Limit, pick: Pick) -> tuple[str, str]:
    """The sheet that holds a table, empty where there is one only, and its text."""
    names = workbooks.sheets(content, path, limit)
    texts = {name: workbooks.as_csv(content, path, limit, name, ".").decode() for name in names}
    tables = [name for name in names if layout(texts[name][:MOST_CHARACTERS].split("\n")[:SNIFFED_LINES])]
    if not tables:
        raise MeasurementError(
            f"{path}: none of the sheets {name_list(names)} holds a table of numbers; name the table that was measured"
        )
    k = (
        0
        if len(tables) == 1
        else pick("table.sheet", "which sheet holds the measurements", tables, f"{path} has several tables")
    )
    return ("" if len(names) == 1 else tables[k]), texts[tables[k]]


def _lists(layout: TableLayout) -> dict[str, tuple[str, ...]]:
    """Columns of lists, and names for their numbers."""
    lists: dict[str, tuple[str, ...]] = {}
    for k, name in enumerate(layout.names):
        cells = [row[k] for row in layout.rows if k < len(row) and row[k]]
        sizes = {len(numbers_in_list(cell, PLAIN)) for cell in cells if list_size(cell)}
        if not (name and cells) or len(sizes) != 1 or not all(map(list_size, cells)):
            continue
        size = sizes.pop()
        about = name.lower()
        named: tuple[str, ...] | None = None
        groups = [len(numbers_in_list(part, PLAIN)) for part in NESTED_LIST.findall(cells[0])]
        if groups[:2] == [3, 4]:  # RAPID's robtarget: place, orientation, axes' turns, other axes
            named = (*POSE_OF_SEVEN, *(f"{name} other {number}" for number in range(8, size + 1)))
        elif groups[:1] == [6] and len(groups) > 1:  # RAPID's jointtarget: the arm's axes, other axes
            named = (
                *(f"{name} axis {number}" for number in range(1, 7)),
                *(f"{name} other {k}" for k in range(7, size + 1)),
            )
        elif "pose" in about or "tcp" in about or cells[0].lower().startswith("p"):
            named = {6: POSE_OF_SIX, 7: POSE_OF_SEVEN}.get(size)
        else:
            named = (
                {3: ("x", "y", "z")}.get(size) if about in ("position", "xyz", "translation", "point", "p") else None
            )
        taken = set(layout.names) | {part for parts in lists.values() for part in parts}
        if named is None or set(named) & taken:
            named = tuple(f"{name} {number + 1}" for number in range(size))
        lists[name] = named
    return lists


def _dates(layout: TableLayout, path: Path, pick: Pick) -> Dates | None:
    """Columns of dates and times of day, if any, and the order of their numbers."""
    columns: list[str] = []
    for k, name in enumerate(layout.names):
        cells = _filled(layout, k)
        if k in layout.numeric or not (name and cells) or not orders(cells):
            continue
        if any(word in name.lower() for word in CLOCK_WORDS) or has_date(cells[0]):
            columns.append(name)
    if not columns:
        return None
    place = {name: k for k, name in enumerate(layout.names)}
    dated = [name for name in columns if has_date(_filled(layout, place[name])[0])]
    clocks = [name for name in columns if name not in dated]
    whole = [name for name in dated if ":" in _filled(layout, place[name])[0]]
    if whole:
        chosen = whole[:1]
    elif dated and clocks:
        chosen = [dated[0], clocks[0]]
    else:
        chosen = (dated or clocks)[:1]
    rows = [" ".join(row[place[name]] for name in chosen) for row in layout.rows]
    filled = [row for row in rows if row.strip()]
    return Dates(
        _order(filled, chosen, path, pick), tuple(sorted(chosen, key=lambda name: (name in clocks, place[name])))
    )


def _filled(layout: TableLayout, k: int) -> list[str]:
    return [row[k] for row in layout.rows if k < len(row) and row[k]]


def _order(cells: Sequence[str], names: Sequence[str], path: Path, pick: Pick) -> str:
    """The one order in which these are dates that differ as they should; asked where several are."""
    possible = orders(cells)
    if not possible:
        return "ymd"
    apart: dict[str, list[float]] = {}
    for order in possible:
        times = [seconds(cell, order) or 0.0 for cell in cells]
        apart[order] = [b - a for a, b in itertools.pairwise(times)]
    unlike = [order for k, order in enumerate(possible) if apart[order] not in [apart[o] for o in possible[:k]]]
    forward = [order for order in unlike if all(step >= 0 for step in apart[order])]
    unlike = forward if len(forward) == 1 else unlike
    if len(unlike) == 1:
        return unlike[0]
    why = f"{path}, column {' '.join(names)}: {cells[0]!r} is a date in each"
    return unlike[pick("table.dates", "in which order are day (d), month (m) and year (y)", unlike, why)]
