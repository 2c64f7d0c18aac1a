"""HTML that is safe by construction (text is escaped unless it is markup already), and numbers as text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape


class Html(str):
    """Text that is markup and goes into a page as it is."""


Content = str | Sequence["Content"]
"""Text, which is escaped; markup, which is not; or a sequence of either."""

VOID = frozenset({"meta", "br"})


def tag(name: str, /, *content: Content, **attributes: str | None) -> Html:
    """An element with its content.

    Args:
        name: Of the element.
        content: See :data:`Content`.
        attributes: By name; `class_` stands for `class`, `aria_label` for `aria-label`. `None` leaves one out.
    """
    pairs = ((key.rstrip("_").replace("_", "-"), value) for key, value in attributes.items() if value is not None)
    start = "".join(f' {key}="{escape(value)}"' for key, value in pairs)
    return Html(f"<{name}{start}>" + ("" if name in VOID else f"{join(content)}</{name}>"))


def join(content: Content) -> Html:
    """Content one after the other."""
    if isinstance(content, Html):
        return content
    return Html(escape(content) if isinstance(content, str) else "".join(join(part) for part in content))


def table(head: Sequence[Content], rows: Iterable[Sequence[Content]], caption: Content, numbers: int = 1) -> Html:
    """A table that scrolls by itself where the page is narrow.

    Args:
        head: Titles of the columns.
        rows: Cells; the first of a row is its title.
        caption: What the table shows.
        numbers: From this column on cells are numbers, set to the right.
    """

    def kind(column: int) -> str | None:
        return "n" if column >= numbers else None

    def cells(row: Sequence[Content]) -> list[Content]:
        first = tag("th", row[0], scope="row")
        return [first, *(tag("td", cell, class_=kind(k)) for k, cell in enumerate(row[1:], 1))]

    titles = [tag("th", title, scope="col", class_=kind(k)) for k, title in enumerate(head)]
    body = tag("tbody", [tag("tr", cells(row)) for row in rows])
    whole = tag("table", tag("caption", caption), tag("thead", tag("tr", titles)), body)
    return tag("div", whole, class_="scroll", tabindex="0", role="group", aria_label="table")


def figures(drawn: Iterable[tuple[Content, Html]]) -> Html:
    """Figures side by side where there is room: captions and pictures."""
    made = [tag("figure", tag("figcaption", caption), picture) for caption, picture in drawn]
    return tag("div", made, class_="figures")


def bullets(items: Iterable[Content], most: int | None = None, what: str = "more") -> Html:
    """A list; of a long one the first `most` items and the number of the others."""
    shown = list(items)
    rest = len(shown) - most if most is not None else 0
    if rest > 0:
        shown = [*shown[:most], tag("em", f"and {rest:,} {what}")]
    return tag("ul", [tag("li", item) for item in shown])


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    decimals = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    return fixed(value, max(decimals, 0))


def plus_minus(value: float, std: float) -> str:
    """A value with its standard deviation, both to two digits of the latter."""
    if not (math.isfinite(std) and std > 0):
        return number(value, 4)
    decimals = min(max(1 - math.floor(math.log10(std)), 0), 9)
    return f"{fixed(value, decimals)} ± {fixed(std, decimals)}"


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals, and no sign on zero."""
    return f"{round(value, decimals) + 0.0:,.{decimals}f}".replace("-", "−")


def counted(count: int, what: str) -> str:
    """A number of things: `1 row`, `1,495 rows`."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"
