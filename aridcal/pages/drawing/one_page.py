"""A page of A4 as HTML and as PDF: the same words in both, made smaller until they fit, and nothing cut off."""

from __future__ import annotations

import functools
import io
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from markupsafe import Markup

from aridcal.pages.drawing.page_frame import asset, filled

if TYPE_CHECKING:
    from matplotlib.font_manager import FontProperties
    from matplotlib.ft2font import FT2Font

POINTS_PER_MM = 72 / 25.4

WIDTH, HEIGHT, MARGIN = 210.0, 297.0, 15.0
"""Size of the page and its white edge, [mm]; printers reach all but 5 mm."""

TEXT, TITLE, FIGURE, HEADING = 8.5, 15.0, 12.0, 9.5
"""Sizes of letters before they are made smaller, [pt]: of text, of the title, of figures and verdict, of headings."""

LINE, GAP = 1.3, 0.7
"""Height of a line in sizes of its letters, and white above a part in sizes of the text."""

SMALLER = 0.97
"""Step by which everything is made smaller until it fits."""

SMALLEST_SCALE = 0.3
"""Least scale: below it no eye reads; what a campaign may state fits on the page long before."""

LABELS, NAMES = 0.21, 0.3
"""Shares of the width that the names of facts take, and those of the headline."""

COLUMN_GAP_PT = 8.0
"""[pt] between columns of a table."""

FONT = "DejaVu Sans"
"""Comes with matplotlib, so that the PDF is the same on every computer."""

OTHER_FONTS = (
    *("Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans CJK KR", "Source Han Sans", "WenQuanYi Zen Hei", "IPAGothic"),
    *("Microsoft YaHei", "Yu Gothic", "Malgun Gothic", "PingFang SC", "Hiragino Sans", "Arial Unicode MS", "Noto Sans"),
)
"""Asked, where a computer has them, for characters that the first font lacks."""

BOX = 1.2
"""Width of the box that stands for a character without a font, in sizes of letters."""

INK, SOFT = "#1d242b", "#5f6b76"


@dataclass(frozen=True)
class Part:
    """A part of the page.

    Attributes:
        heading: Above it.
        facts: Names and what they are.
        table: Rows of a table, the first its head; all of one length.
        words: Paragraphs.
    """

    heading: str
    facts: Sequence[tuple[str, str]] = ()
    table: Sequence[Sequence[str]] = ()
    words: Sequence[str] = ()


@dataclass(frozen=True)
class OnePage:
    """What the page says.

    Attributes:
        title: What it is.
        under: What must be known of it first.
        headline: Names and what they are: all in letters of one size, the largest but the title's.
        parts: The rest.
        foot: The last line.
        boxes: Added to it in the PDF where boxes stand for characters.
    """

    title: str
    under: str
    headline: Sequence[tuple[str, str]]
    parts: Sequence[Part]
    foot: str
    boxes: str


@dataclass(frozen=True)
class _Line:
    """Text at its place, [pt] from the upper left corner of what may be printed; y is that of the line's lower edge."""

    x: float
    y: float
    text: str
    size: float
    bold: bool = False
    color: str = INK


@dataclass
class _Column:
    """Lines as they are put one below the other.

    Attributes:
        scale: Of all sizes.
        fonts: Families that are asked in turn.
        y: Lower edge of what is there, [pt].
        lines: So far.
        rules: Heights of horizontal lines.
    """

    scale: float
    fonts: tuple[str, ...]
    y: float = 0.0
    lines: list[_Line] = field(default_factory=list)
    rules: list[float] = field(default_factory=list)

    @property
    def width(self) -> float:
        return (WIDTH - 2 * MARGIN) * POINTS_PER_MM

    def put(self, cells: Sequence[tuple[float, float, str]], size: float, bold: str = "", color: str = INK) -> None:
        """A row of cells, each with its left edge, its width and its text, which is broken to fit.

        Args:
            cells: Of the row.
            size: Of letters, before they are made smaller.
            bold: One character for each cell: `b` is bold, `s` soft.
            color: Of cells that are not soft.
        """
        size *= self.scale
        lowest = self.y
        for k, (x, width, text) in enumerate(cells):
            look = bold[k] if k < len(bold) else " "
            y = self.y
            for line in wrapped(text, width / size, look == "b", self.fonts):
                y += LINE * size
                self.lines.append(_Line(x, y, line, size, look == "b", SOFT if look == "s" else color))
            lowest = max(lowest, y)
        self.y = lowest

    def gap(self, times: float = 1.0) -> None:
        """White."""
        self.y += times * GAP * TEXT * self.scale

    def rule(self) -> None:
        """A horizontal line."""
        self.gap(0.4)
        self.rules.append(self.y)


def wrapped(text: str, width: float, bold: bool, fonts: tuple[str, ...]) -> list[str]:
    """Break text into lines at blanks, and within words that are longer than a line.

    Args:
        text: On one line.
        width: Of a line, in sizes of its letters.
        bold: Whether it is.
        fonts: Families that are asked in turn.
    """
    lines, line, left = [], "", width
    for word in text.split(" "):
        needed = sum(advance(c, bold, fonts) for c in word)
        blank = advance(" ", bold, fonts) if line else 0.0
        if line and blank + needed > left:
            lines.append(line)
            line, left, blank = "", width, 0.0
        if needed > width:
            for c in word:
                if advance(c, bold, fonts) > left and line:
                    lines.append(line)
                    line, left = "", width
                line, left = line + c, left - advance(c, bold, fonts)
            continue
        line, left = f"{line} {word}" if line else word, left - blank - needed
    return [*lines, line]


@functools.lru_cache(maxsize=4096)
def advance(character: str, bold: bool, fonts: tuple[str, ...]) -> float:
    """By how much a character moves the next one to the right, in sizes of letters; kerning is left out."""
    name = next((name for name in fonts if character in _characters(name, bold)), None)
    if name is None:
        return BOX
    font = _font(name, bold)
    font.set_size(100.0, 72)
    return float(font.load_char(ord(character)).linearHoriAdvance) / 65536.0 / 100.0


def _properties(bold: bool, fonts: tuple[str, ...]) -> FontProperties:
    from matplotlib.font_manager import FontProperties

    return FontProperties(family=list(fonts), weight="bold" if bold else "normal")


def _font(name: str, bold: bool) -> FT2Font:
    """A family's font as matplotlib will choose it."""
    from matplotlib.font_manager import fontManager, get_font

    return get_font(fontManager.findfont(_properties(bold, (name,))))


@functools.lru_cache(maxsize=64)
def _characters(name: str, bold: bool) -> frozenset[str]:
    """All that a family's font has."""
    return frozenset(map(chr, _font(name, bold).get_charmap()))


def fonts_for(text: str) -> tuple[tuple[str, ...], str]:
    """Families that have the characters of a text, and the characters that none of this computer's has."""
    from matplotlib.font_manager import fontManager

    there = {entry.name for entry in fontManager.ttflist}
    chosen, lacking = [FONT], set(text) - _characters(FONT, False)
    for name in OTHER_FONTS:
        if name in there and (found := lacking & _characters(name, False)):
            chosen.append(name)
            lacking -= found
    return tuple(chosen), "".join(sorted(lacking))


def _laid_out(page: OnePage, scale: float, fonts: tuple[str, ...], lacking: str) -> _Column:
    """The page at one scale; it may be too high."""
    column = _Column(scale, fonts)
    whole = column.width
    label, wide = LABELS * whole, NAMES * whole
    column.put([(0.0, whole, page.title)], TITLE, "b")
    column.put([(0.0, whole, page.under)], TEXT)
    column.gap()
    for name, said in page.headline:
        column.put([(0.0, wide - COLUMN_GAP_PT, name), (wide, whole - wide, said)], FIGURE, " b")
    for part in page.parts:
        column.gap()
        column.rule()
        column.put([(0.0, whole, part.heading)], HEADING, "b")
        for name, said in part.facts:
            column.put([(0.0, label - COLUMN_GAP_PT, name), (label, whole - label, said)], TEXT, "s ")
        edges = _columns(part.table, whole, scale, fonts)
        for k, row in enumerate(part.table):
            column.put([(x, w, cell) for (x, w), cell in zip(edges, row, strict=True)], TEXT, "s" * len(row) * (k == 0))
        for words in part.words:
            column.put([(0.0, whole, words)], TEXT)
    column.gap()
    column.rule()
    foot = f"{page.foot} {page.boxes}" if lacking else page.foot
    column.put([(0.0, whole, foot)], TEXT, "s")
    return column


def _columns(
    table: Sequence[Sequence[str]], whole: float, scale: float, fonts: tuple[str, ...]
) -> list[tuple[float, float]]:
    """Left edge and width of each column of a table, [pt]: what its text needs, wide ones less where that is too much."""
    if not table:
        return []
    needed = [
        max(sum(advance(c, False, fonts) for c in row[k]) for row in table) * TEXT * scale + 1.0
        for k in range(len(table[0]))
    ]
    room, widths = whole - COLUMN_GAP_PT * (len(needed) - 1), [0.0] * len(needed)
    narrowest = sorted(range(len(needed)), key=lambda k: needed[k])
    for rank, k in enumerate(narrowest):  # narrow columns get what they need, wide ones share what is left
        widths[k] = min(needed[k], room / (len(needed) - rank))
        room -= widths[k]
    edges, x = [], 0.0
    for width in widths:
        edges.append((x, width))
        x += width + COLUMN_GAP_PT
    return edges


def _fitted(page: OnePage) -> tuple[_Column, str]:
    """The page at the largest scale at which it fits, and the characters that no font has."""
    every = [page.title, page.under, page.foot, page.boxes, *(word for pair in page.headline for word in pair)]
    for part in page.parts:
        cells = (word for row in (*part.facts, *part.table) for word in row)
        every += [part.heading, *cells, *part.words]
    fonts, lacking = fonts_for("".join(every))
    scale = 1.0
    column = _laid_out(page, scale, fonts, lacking)
    while column.y > (HEIGHT - 2 * MARGIN) * POINTS_PER_MM and scale > SMALLEST_SCALE:
        scale *= SMALLER
        column = _laid_out(page, scale, fonts, lacking)
    return column, lacking


def as_pdf(page: OnePage) -> tuple[bytes, str]:
    """The page as PDF, and the characters in it that no font of this computer has."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    column, lacking = _fitted(page)
    wide, high, edge = (POINTS_PER_MM * length for length in (WIDTH, HEIGHT, MARGIN))
    figure = Figure(figsize=(wide / 72, high / 72))
    for line in column.lines:
        x, y = (edge + line.x) / wide, 1.0 - (edge + line.y - 0.25 * LINE * line.size) / high
        properties = _properties(line.bold, column.fonts)
        properties.set_size(line.size)
        figure.text(x, y, line.text, fontproperties=properties, color=line.color, parse_math=False, va="baseline")
    for y in column.rules:
        at = 1.0 - (edge + y) / high
        figure.add_artist(Line2D([edge / wide, 1.0 - edge / wide], [at, at], color=SOFT, linewidth=0.5))
    content = io.BytesIO()
    # TrueType letters: of Type 3 some versions of matplotlib leave others than Latin ones out when text is copied.
    with rc_context({"pdf.fonttype": 42}), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of characters without a glyph: the page says so itself
        figure.savefig(content, format="pdf", metadata={"Title": page.title, "CreationDate": None})
    return content.getvalue(), lacking


def as_html(page: OnePage) -> Markup:
    """The page as HTML of its own, to be read on a screen and printed on one sheet."""
    scale = _fitted(page)[0].scale
    return filled("one_page.html", page=page, scale=f"{scale:.3f}", style=Markup(asset("one_page.css")))
