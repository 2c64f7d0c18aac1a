"""What Python users see while they wait and of pages: in a terminal, in a notebook, and nothing elsewhere."""

from __future__ import annotations

import html
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from rich.console import Console
from rich.live import Live
from rich.spinner import Spinner
from rich.text import Text
from threadpoolctl import threadpool_limits

HEIGHT = 720
"""Of a page inside a notebook, [px]: less than a screen, so that one can scroll past it."""


@contextmanager
def working() -> Iterator[Callable[[str], None]]:
    """Show on one line what is being done, and let linear algebra use one thread, as the commands do.

    Yields:
        To be called with each step. Outside terminals and notebooks it shows nothing.
    """
    console = Console(stderr=True)
    started = time.perf_counter()

    def line(step: str) -> str:
        return f"{time.perf_counter() - started:5.1f} s  {step}"

    with threadpool_limits(1, user_api="blas"):
        if console.is_jupyter:
            yield from _in_notebook(line)
        elif console.is_terminal:
            yield from _in_terminal(console, line)
        else:
            yield lambda step: None


def _in_terminal(console: Console, line: Callable[[str], str]) -> Iterator[Callable[[str], None]]:
    """One line with a spinner. Each step is drawn at once: the next tick may come after the step has ended."""
    spinner = Spinner("dots")
    with Live(spinner, console=console, transient=True) as live:

        def show(step: str) -> None:
            spinner.update(text=Text(line(step)))
            live.refresh()

        yield show


def _in_notebook(line: Callable[[str], str]) -> Iterator[Callable[[str], None]]:
    """One output that each step overwrites. Rich's own needs ipywidgets, which few have."""
    from IPython.display import display

    shown = display({"text/plain": ""}, raw=True, display_id=True)

    def show(step: str) -> None:
        shown.update({"text/plain": line(step)}, raw=True)

    yield show
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
