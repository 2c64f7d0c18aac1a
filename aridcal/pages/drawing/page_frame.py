"""Whole pages and cards, filled in from Jinja2's templates in `assets/`; whatever is no markup already is escaped there."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from markupsafe import Markup

from aridcal.pages.drawing.html import Content, join
from aridcal.system.errors import printable_lines
from aridcal.system.wording import number

if TYPE_CHECKING:
    from jinja2 import Environment


@dataclass(frozen=True)
class Section:
    """A part of a page with its own place in the contents.

    Attributes:
        title: Above it, and in the contents.
        content: What stands there.
        key: Its anchor.
    """

    title: str
    content: Content
    key: str

    @property
    def body(self) -> Markup:
        """Its content as markup."""
        return join(self.content)


@functools.cache
def _spelt_out(value: object) -> object:
    """Text with control characters spelt out; markup as it is."""
    return printable_lines(value) if type(value) is str else value


def _templates() -> Environment:
    """The templates, read once; Jinja2 is loaded when there is a page to draw."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(
        loader=FunctionLoader(asset), autoescape=True, finalize=_spelt_out, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip


def asset(name: str) -> str:
    """The text of a template, a style or a script."""
    return files("aridcal.pages.drawing").joinpath(f"assets/{name}").read_text("utf-8")


def filled(template: str, **values: object) -> Markup:
    """A template with its values.

    Args:
        template: File in `assets/`.
        values: By their names there; :class:`Markup` goes in as it is, all else is escaped. A name without a value is an error.
    """
    return Markup(_templates().get_template(template).render(values))


def sections(named: Sequence[tuple[str, Content]]) -> list[Section]:
    """Sections from titles and contents, with anchors by their number."""
    return [Section(title, content, f"part-{k}") for k, (title, content) in enumerate(named, start=1)]


def framed_page(title: str, head: Content, parts: Sequence[Section], foot: str) -> Markup:
    """A page in the report's style that needs nothing else: first screen, contents, sections, foot.

    Args:
        title: Of the window.
        head: The first screen.
        parts: Sections; the contents lead to each.
        foot: The last line.
    """
    style = Markup(asset("report.css"))
    return filled("page.html", title=title, style=style, head=join(head), sections=parts, foot=foot)


def empty_page(title: str, notice: str) -> Markup:
    """A page that says why it shows nothing, so that none of an earlier result is taken for it."""
    return filled("empty.html", title=title, notice=notice)


def card(
    noun: str, unit: str, before: tuple[str, float], after: tuple[str, float], said: str, below: Content = ""
) -> Markup:
    """Before and after of one quantity in large figures.

    Args:
        noun: The quantity.
        unit: Of both numbers.
        before: What the first number is of, and the number.
        after: Likewise the second.
        said: Under them.
        below: The rest.
    """
    return filled(
        "card.html",
        noun=f"{noun.capitalize()}, RMS",
        unit=unit,
        before=(before[0], number(before[1])),
        after=(after[0], number(after[1])),
        said=said,
        below=join(below),
    )
