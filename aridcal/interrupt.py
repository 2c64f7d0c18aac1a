"""Ctrl-C while a command still loads its libraries: a line and exit status 130, as at any later moment."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

MESSAGE = "interrupted: nothing was left half written"
INTERRUPTED = 130


def leave(number: int, frame: FrameType | None) -> None:
    """End the process at once: a KeyboardInterrupt inside an import would print a traceback, or be lost in it."""
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(INTERRUPTED)


def is_command(argv: list[str], original: list[str]) -> bool:
    """True if Python was started to run one of our commands: by the console script, or by ``python -m``.

    Args:
        argv: ``sys.argv``, which starts with ``-m`` for as long as Python looks for the module.
        original: ``sys.orig_argv``.
    """
    started = argv[0] if argv else ""
    if started == "-m":
        return any(word.removeprefix("-m").partition(".")[0] == "aridcal" for word in original[1:])
    return started.rpartition(os.sep)[2].partition(".")[0] == "aridcal"


def watch() -> None:
    """From now on Ctrl-C ends a command as :func:`leave` does; whoever imports the library keeps Python's own way."""
    untouched = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if untouched and is_command(sys.argv, sys.orig_argv):
        signal.signal(signal.SIGINT, leave)
