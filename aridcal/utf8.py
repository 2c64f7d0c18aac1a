"""Names of files in UTF-8, whatever locale a command is started in."""

# Imports as little as can be, as `interrupt` does.

from __future__ import annotations

import os
import sys


def restart() -> None:
    """Start a command again in Python's UTF-8 mode, where its locale cannot read a word of the command line that is UTF-8.

    A process keeps the encoding of file names that it was started with. In that mode every such word is read, so that this
    happens once.
    """
    if any(_unread(word) for word in sys.orig_argv):
        os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])


def _unread(word: str) -> bool:
    """True of a word with bytes that the locale has no characters for, and UTF-8 has."""
    if not any("\udc80" <= c <= "\udcff" for c in word):
        return False
    try:
        os.fsencode(word).decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True
