"""What users see while they wait, in a command, a terminal or a notebook; and pages."""

from __future__ import annotations

import html
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from typing import IO, Any, TypeVar

from rich.console import Console
from rich.control import Control
from rich.live import Live
from rich.segment import ControlType
from rich.spinner import Spinner
from rich.text import Text
from threadpoolctl import ThreadpoolController

from aridcal.system.errors import printable_lines

OF_BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")
"""What libraries of linear algebra look at when they are loaded."""

HEIGHT = 720
"""Height of a page inside a notebook, [px]: less than a screen, so that one can scroll past it."""

SHOWN_REMARKS = 5
"""Remarks that a screen shows; pages and files have all."""

T = TypeVar("T")

EVERY = 2.0
"""[s] between two lines inside one step, at the least: one sees that it goes on, and a log stays short."""

MINUTE = 60.0
"""[s]."""

Show = Callable[[str], None]

BAR = 20
"""Letters of a bar."""


def silence_stream(stream: IO[str]) -> None:
    """Nobody reads a stream any more: what is still printed goes nowhere. Python would try once more at its end, and complain."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


class Screen(Console):
    """A terminal, file or pipe; control characters in what a user named are spelt out, wherever they are printed.

    Once nobody reads it, as after ``| head``, the work goes on, and ends with its own status.
    """

    def render_str(self, text: str, **how: Any) -> Text:
        """Text as Rich prints it, in lines and in cells of tables."""
        return super().render_str(printable_lines(text), **how)

    def say(self, *lines: str) -> None:
        """Print lines as they are: nothing in them is markup, and none is broken."""
        for line in lines:
            self.print(line, markup=False, highlight=False, soft_wrap=True)

    def on_broken_pipe(self) -> None:
        """Rich would end the program with status 1."""
        silence_stream(self.file)


@dataclass(frozen=True)
class StepProgress:
    """How far a step is.

    Attributes:
        step: What is being done.
        said: How much of it is done, in words.
        share: From 0 to 1; None where nobody can say.
        left: What it will still take if it goes on like that, [s]; NaN where nobody can say.
    """

    step: str
    said: str
    share: float | None = None
    left: float = math.nan

    def __str__(self) -> str:
        return f"{self.step}: {self.said}" + (f", {self.remaining} left" if self.remaining else "")

    @property
    def remaining(self) -> str:
        """The time left in words; empty where nobody can say."""
        if math.isnan(self.left) or self.share == 1.0:
            return ""
        return duration(self.left)

    @property
    def bar(self) -> str:
        """The share as a bar with its percentage; empty where nobody can say."""
        if self.share is None:
            return ""
        full = int(BAR * self.share)
        return f"{'━' * full}{'─' * (BAR - full)} {100 * self.share:3.0f} %  "


Passing = Callable[[StepProgress], None]


def duration(seconds: float) -> str:
    """A time in words: ``40 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 1.5 * MINUTE:
        return f"{seconds:.0f} s"
    minutes = round(seconds / MINUTE)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


class Progress:
    """Progress of long work, handed down through it: it is called with each step and told how far the step is.

    Args:
        show: Called with each step.
        passing: Called with what soon holds no more, how far a step is; default: its words are shown as a step is.
        clock: In seconds.
    """

    def __init__(self, show: Show, passing: Passing | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._show, self._passing, self._clock = show, passing or (lambda far: show(str(far))), clock
        self._step, self._told = "", clock()
        self._began = self._told

    def __call__(self, step: str) -> None:
        """Begin a step."""
        self.at(step)
        self._show(step)

    def at(self, step: str) -> None:
        """Begin a step that is shown only if it takes long."""
        self._step, self._told = step, self._clock()
        self._began = self._told

    def note(self, text: str) -> None:
        """Tell something by the way; the step goes on."""
        self._show(text)

    def part(self, done: int, total: int, of: str) -> None:
        """Tell how much of the step is done, unless something was told within the last :data:`EVERY` seconds.

        Args:
            done: How many.
            total: Of how many.
            of: What they are, ``rows`` for instance.
        """
        self._tell(f"{done:,} of {total:,} {of}", done / total if total else None)

    def share(self, done: float) -> None:
        """Tell how much of a step is done that counts nothing, ``done`` from 0 to 1."""
        self._tell(f"{int(100 * done)} %", done)

    def _tell(self, text: str, share: float | None) -> None:
        now = self._clock()
        if now - self._told < EVERY:
            return
        self._told = now
        share = None if share is None else min(max(share, 0.0), 1.0)
        left = (now - self._began) * (1.0 - share) / share if share else math.nan
        self._passing(StepProgress(self._step, text, share, left))

    def over(self, items: Sequence[T], of: str) -> Iterator[T]:
        """Go through items, and tell how many are done."""
        return self.through(items, len(items), of)

    def through(self, items: Iterable[T], total: int, of: str, each: int = 1) -> Iterator[T]:
        """Go through items whose number must be said, or of which each stands for several, and tell how many are done."""
        for done, item in enumerate(items):
            self.part(done * each, total, of)
            yield item


SILENT = Progress(lambda _: None)
"""Progress of work that nobody watches."""


@contextmanager
def console_progress(console: Console) -> Iterator[Progress]:
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

    def passing(far: StepProgress) -> None:
        clear()
        text = line(f"{far.bar}{far}")
        console.print(text, style="dim", markup=False, highlight=False, no_wrap=True, overflow="ellipsis", end="")

    def clear() -> None:
        if console.is_terminal:
            console.control(Control(ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2)))

    try:
        yield Progress(show, passing if console.is_terminal else None)
    finally:
        clear()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let linear algebra use one thread: matrices are small, and threads that wait for each other cost ten times what they gain.

    SciPy has a library of its own beside NumPy's, loaded when needed: the environment holds that one, a limit what is there.
    """
    before = {name: os.environ.get(name) for name in OF_BLAS}
    os.environ.update(dict.fromkeys(OF_BLAS, "1"))
    try:
        with _loaded_libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@lru_cache(maxsize=1)
def _loaded_libraries(modules: int) -> ThreadpoolController:
    """The libraries that are loaded, looked for anew once more modules are: that takes as long as reading a small table."""
    return ThreadpoolController()


@contextmanager
def working() -> Iterator[Progress]:
    """Show on one line what is being done, and let linear algebra use one thread, as the commands do.

    Yields:
        To be told of each step. Outside terminals and notebooks it shows nothing.
    """
    console = Screen(stderr=True)
    started = time.perf_counter()

    def line(step: str) -> str:
        return f"{time.perf_counter() - started:5.1f} s  {step}"

    with one_thread():
        if console.is_jupyter:
            yield from _in_notebook(line)
        elif console.is_terminal:
            yield from _in_terminal(console, line)
        else:
            yield SILENT


def _in_terminal(console: Console, line: Callable[[str], str]) -> Iterator[Progress]:
    """One line with a spinner. Each step is drawn at once: the next tick may come after the step has ended."""
    spinner = Spinner("dots")
    with Live(spinner, console=console, transient=True) as live:

        def show(step: str) -> None:
            spinner.update(text=Text(printable_lines(line(step))))
            live.refresh()

        yield Progress(show, lambda far: show(f"{far.bar}{far}"))


def _in_notebook(line: Callable[[str], str]) -> Iterator[Progress]:
    """One output that each step overwrites. Rich's own needs ipywidgets, which few have."""
    from IPython.display import display

    output = display({"text/plain": ""}, raw=True, display_id=True)

    def show(step: str) -> None:
        output.update({"text/plain": line(step)}, raw=True)

    yield Progress(show, lambda far: show(f"{far.bar}{far}"))
    show("done")


@dataclass(frozen=True)
class Page:
    """A page of HTML that needs nothing else; a notebook shows it.

    Attributes:
        title: What it is.
        html: Its source.
    """

    title: str
    html: str = field(repr=False)

    def _repr_html_(self) -> str:
        source = html.escape(self.html)
        return f'<iframe srcdoc="{source}" width="100%" height="{HEIGHT}" style="border: 0"></iframe>'


class PrintedAnswer:
    """An answer for Python users, which terminals and notebooks show by its lines.

    Attributes:
        lines: The whole answer in words.
    """

    lines: tuple[str, ...]

    def __repr__(self) -> str:
        return "\n".join(self.lines)

    def _repr_html_(self) -> str:
        return "".join(f"<div>{html.escape(printable_lines(line))}</div>" for line in self.lines)
