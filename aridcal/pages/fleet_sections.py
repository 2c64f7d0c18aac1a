"""Sections of pages that fail one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from aridcal.pages.drawing.html import Content, attempt, join, missing


def draw_section(page: str, title: str, content: Callable[[], Iterator[Content]]) -> list[Content]:
    """A section's content up to where it fails, and then a line that says so.

    Args:
        page: The file, for that line.
        title: Of the section.
        content: Draws its parts.
    """
    parts: list[Content] = []

    def draw() -> None:
        parts.extend(join(part) for part in content())

    attempt(f"{page}: the rest of section {title!r}", draw, lambda notice: parts.append(missing(notice)))
    return parts
