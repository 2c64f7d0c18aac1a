"""What a command does before all else: it answers signals, and takes the place of streams that whoever started it has closed.

Ctrl-C or SIGTERM while its libraries still load: a line and exit status 130 or 143, as at any later moment.
"""

# Imports as little as can be: until `watch` has run, Ctrl-C prints a traceback.

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

MESSAGE = "interrupted: nothing was left half written"
SIGNALLED = 128
"""What shells add to a signal's number for the exit status: 130 after Ctrl-C, 143 after SIGTERM."""


def leave(number: int, frame: FrameType | None) -> None:
    """End the process at once: a KeyboardInterrupt inside an import would print a traceback, or be lost in it."""
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(SIGNALLED + number)


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


def open_closed_streams() -> None:
    """Open what was closed (``>&-``) to nowhere: the next file that is opened would take its number, and what is printed."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            stream = open(number, "r" if number == 0 else "w", encoding="utf-8", closefd=False)  # noqa: SIM115 (for as long as we live)
            setattr(sys, name, stream)


def watch() -> None:
    """From now on signals end a command as :func:`leave` does; whoever imports the library keeps Python's own way."""
    if not is_command(sys.argv, sys.orig_argv):
        return
    open_closed_streams()
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)):
        if signal.getsignal(number) is usual:
            signal.signal(number, leave)
