"""What long work tells of itself: the step that it is at, and how much of it is done."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.control import Control
from rich.segment import ControlType

T = TypeVar("T")

EVERY = 2.0
"""[s] between two lines inside one step, at the least: one sees that it goes on, and a log stays short."""

Show = Callable[[str], None]


class Progress:
    """Passed down through long work, which calls it with each step and tells it how far the step is.

    Args:
        show: Called with each step.
        passing: Called with what soon holds no more, how far a step is; default: as ``show``.
        clock: In seconds.
    """

    def __init__(self, show: Show, passing: Show | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._show, self._passing, self._clock = show, passing or show, clock
        self._step, self._told = "", clock()

    def __call__(self, step: str) -> None:
        """Begin a step."""
        self.at(step)
        self._show(step)

    def at(self, step: str) -> None:
        """Begin a step that is told of only if it takes long."""
        self._step, self._told = step, self._clock()

    def part(self, done: int, total: int, of: str) -> None:
        """Tell how much of the step is done, unless something was told within the last :data:`EVERY` seconds.

        Args:
            done: How many.
            total: Of how many.
            of: What they are, ``rows`` for instance.
        """
        self._tell(f"{done:,} of {total:,} {of}")

    def share(self, done: float) -> None:
        """The same of what is not counted, ``done`` from 0 to 1."""
        self._tell(f"{int(100 * done)} %")

    def _tell(self, how_far: str) -> None:
        now = self._clock()
        if now - self._told >= EVERY:
            self._told = now
            self._passing(f"{self._step}: {how_far}")

    def over(self, items: Sequence[T], of: str) -> Iterator[T]:
        """Go through items, and tell how many are done."""
        return self.through(items, len(items), of)

    def through(self, items: Iterable[T], total: int, of: str) -> Iterator[T]:
        """The same where their number must be said."""
        for done, item in enumerate(items):
            self.part(done, total, of)
            yield item


SILENT = Progress(lambda _: None)
"""Of work that nobody watches."""


@contextmanager
def told_on(console: Console) -> Iterator[Progress]:
    """Progress of a command: a line for each step, and inside it one line that is overwritten; in a pipe lines alone.

    Args:
        console: Of stderr.
    """
    started = time.perf_counter()

    def line(step: str) -> str:
        return f"{time.perf_counter() - started:5.1f} s  {step}"

    def show(step: str) -> None:
        clear()
        console.print(line(step), style="dim", markup=False, highlight=False, soft_wrap=True)

    def passing(step: str) -> None:
        clear()
        console.print(line(step), style="dim", markup=False, highlight=False, no_wrap=True, overflow="ellipsis", end="")

    def clear() -> None:
        if console.is_terminal:
            console.control(Control(ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2)))

    try:
        yield Progress(show, passing if console.is_terminal else show)
    finally:
        clear()
