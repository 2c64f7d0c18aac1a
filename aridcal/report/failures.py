"""What only serves looks fails by itself: a notice in its place, and everything else goes on."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from aridcal.errors import printable, shortened

T = TypeVar("T")

LONGEST = 300
"""Letters of a notice's reason: readers of files quote what they choke on, and names have no limit."""

_missing: ContextVar[list[str] | None] = ContextVar("missing", default=None)


@contextmanager
def noting() -> Iterator[list[str]]:
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
    """Add a notice to those that :func:`noting` collects."""
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
    return shortened(printable(text), LONGEST)
