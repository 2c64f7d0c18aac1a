"""Signals while a command works: Ctrl-C and SIGTERM unwind it, but not in the middle of a few operations on files."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], Any] | signal.Handlers


class Terminated(KeyboardInterrupt):
    """SIGTERM has come. It unwinds as Ctrl-C does, so that no polite way to stop a command leaves half a result."""


def terminate(number: int, frame: FrameType | None) -> None:
    """Raise what SIGTERM means to a command."""
    raise Terminated


@contextmanager
def handling(handlers: dict[signal.Signals, Handler]) -> Iterator[None]:
    """Set signal handlers for a while; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            with suppress(TypeError):  # None: a handler that was not set from Python cannot be set back
                signal.signal(number, handler)


@contextmanager
def defer_signals() -> Iterator[None]:
    """Let a few operations on files finish: a signal that comes meanwhile counts when they have."""
    waiting: list[int] = []

    def remember(number: int, frame: FrameType | None) -> None:
        waiting.append(number)

    try:
        with handling({signal.SIGINT: remember, signal.SIGTERM: remember}):
            yield
    finally:
        if waiting:
            signal.raise_signal(waiting[0])
