"""HTML that is safe by construction (text is escaped unless it is markup already).

What only serves looks fails by itself: a notice in its place (:func:`attempt`), and everything else goes on.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from markupsafe import Markup, escape

from aridcal.system.errors import printable, printable_lines, shortened

# Text, which is escaped; markup, which is not; or a sequence of either.
Content = str | Sequence["Content"]

# Elements without content.
VOID = frozenset({"meta", "br"})

ON_A_PHONE, HALF_A_PHONE = 46, 20
"""Letters of a table side by side on a phone, 390 px wide, and of a number with its title in half of that width."""

COLUMN_GAP = 2
"""Letters that the white between two columns takes."""

UNBROKEN_LETTERS = 14
"""Letters of a cell of words below which breaking it makes a column of single words."""

T = TypeVar("T")

LONGEST_NOTICE = 300
"""Letters of a notice's reason: readers of files quote what they choke on, and names have no limit."""

_missing: ContextVar[list[str] | None] = ContextVar("missing", default=None)


def tag(name: str, /, *content: Content, **attributes: str | None) -> Markup:
    """An element with its content.

    Args:
        name: Of the element.
        content: See :data:`Content`.
        attributes: By name; `class_` stands for `class`, `aria_label` for `aria-label`. `None` leaves one out.

    Returns:
        ``<name key="value">content</name>``, or the start alone for the elements of :data:`VOID`.
    """
    pairs = ""
    for key, value in attributes.items():
        if value is not None:
            written = key.rstrip("_").replace("_", "-")
            pairs += f' {written}="{escape(printable_lines(value))}"'
    start = f"<{name}{pairs}>"
    if name in VOID:
        return Markup(start)
    return Markup(f"{start}{join(content)}</{name}>")


def join(content: Content) -> Markup:
    """Content one after the other: text is escaped, markup goes in as it is."""
    if isinstance(content, Markup):
        return content
    if isinstance(content, str):
        return escape(printable_lines(content))
    return Markup("").join(join(part) for part in content)


def missing(notice: str) -> Markup:
    """The line that stands where something could not be drawn."""
    return tag("p", notice, class_="missing")


def table(head: Sequence[Content], rows: Iterable[Sequence[Content]], caption: Content, numbers: int = 1) -> Markup:
    """A table; where the page is narrow, one that is too wide for it stands row below row, each cell with its column's title.

    Args:
        head: Titles of the columns.
        rows: Cells; the first of a row is its title.
        caption: What the table shows.
        numbers: From this column on cells are numbers, set to the right.
    """
    lines = [[join(cell) for cell in row] for row in rows]
    shown = [[cell.striptags() for cell in row] for row in lines]
    names = [join(title).striptags() for title in head]
    columns = [[name, *(row[k] for row in shown)] for k, name in enumerate(names)]
    stacked = sum(_letters(column, k >= numbers) + COLUMN_GAP for k, column in enumerate(columns)) > ON_A_PHONE

    widest = [len(name) + max(map(len, others), default=0) for name, *others in columns[max(numbers, 1) :]]
    pairs = stacked and len(widest) > 1 and max(widest) <= HALF_A_PHONE

    def kind(column: int) -> str | None:
        return "n" if column >= numbers else None

    def cell(column: int, content: Markup) -> Markup:
        if not stacked:
            return tag("td", content, class_=kind(column))
        begins = pairs and column >= numbers and ":" in names[column]  # of several numbers that belong together
        return tag("td", content, class_="n first" if begins else kind(column), data_label=names[column])

    def line(row: Sequence[Markup]) -> Markup:
        return tag(
            "tr", tag("th", row[0], scope="row"), [cell(k, content) for k, content in enumerate(row[1:], start=1)]
        )

    titles = [tag("th", title, scope="col", class_=kind(column)) for column, title in enumerate(head)]
    top = tag("thead", tag("tr", titles))
    body = tag("tbody", [line(row) for row in lines])
    whole = tag(
        "table", tag("caption", caption), top, body, class_="stacked pairs" if pairs else "stacked" if stacked else None
    )
    return tag("div", whole, class_="scroll", tabindex="0", role="group", aria_label="table")


def _letters(column: Sequence[str], numbers: bool) -> int:
    """How wide a column must be at least: numbers do not break, words do between them, but are not read one on a line."""
    words = [max(map(len, cell.split()), default=0) for cell in column]
    _, *cells = column
    return max(
        words[0],
        *(
            max(word, len(cell) if numbers else min(len(cell), UNBROKEN_LETTERS))
            for word, cell in zip(words[1:], cells, strict=True)
        ),
        0,
    )


def figures(drawn: Iterable[tuple[Content, Markup]], class_: str = "figures") -> Markup:
    """Figures side by side where there is room.

    Args:
        drawn: The caption and the picture of each.
        class_: ``figures three`` for three in a row on a wide screen, else two.
    """
    pictures = [tag("figure", tag("figcaption", caption), picture) for caption, picture in drawn]
    return tag("div", pictures, class_=class_)


def fold(title: Content, *content: Content) -> Markup:
    """Content behind its title, shown by a click, and on paper.

    Args:
        title: What stays in sight, with the figure that matters most.
        content: The rest.
    """
    return tag("details", tag("summary", title), content)


def bullets(items: Iterable[Content], most: int | None = None, what: str = "more") -> Markup:
    """A list; of a long one the first items and the number of the others.

    Args:
        items: What to list.
        most: How many items are shown; all if it is None.
        what: What the others are called, after their number.
    """
    shown = list(items)
    rest = len(shown) - most if most is not None else 0
    if rest > 0:
        shown = [*shown[:most], tag("em", f"and {rest:,} {what}")]
    return tag("ul", [tag("li", item) for item in shown])


def codes(names: Sequence[str]) -> Content:
    """Names one after the other, set as code."""
    return [part for name in names for part in (", ", tag("code", name))][1:]


@contextmanager
def collect_notices() -> Iterator[list[str]]:
    """Collect the notices of :func:`attempt` while a page is drawn.

    Yields:
        The notices so far, each once.
    """
    notices: list[str] = []
    token = _missing.set(notices)
    try:
        yield notices
    finally:
        _missing.reset(token)


def attempt(what: str, draw: Callable[[], T], instead: Callable[[str], T]) -> T:
    """Draw something, or note why that cannot be done.

    Memory that is not there and recursion without end count as any error; Ctrl-C does not.

    Args:
        what: What is drawn, as the notice calls it: ``report.html: section 'Limits'``.
        draw: Draws it.
        instead: Gives what stands in its place, from the notice.
    """
    try:
        return draw()
    except Exception as error:
        notice = f"{what} is not drawn: {reason(error)}"
    note(notice)
    return instead(notice)


def note(notice: str) -> None:
    """Add a notice to those that :func:`collect_notices` collects."""
    notices = _missing.get()
    if notices is not None and notice not in notices:
        notices.append(notice)


def reason(error: Exception) -> str:
    """Say what went wrong and where in the code: a picture's error is seen by nobody who could look at a traceback."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"{one_line(said)} ({frame.filename.rpartition('/')[2]}:{frame.lineno})"


def one_line(text: str) -> str:
    """Text without control characters, its beginning if it is long."""
    return shortened(printable(text), LONGEST_NOTICE)
