"""One writer at a time: a lock beside the output, which the system gives back when its holder dies."""

from __future__ import annotations

import fcntl
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from aridcal.system.errors import BusyError
from aridcal.system.writing.signals import defer_signals

_mine: ContextVar[frozenset[Path]] = ContextVar("_mine", default=frozenset())
"""Locks that this thread holds."""


def is_mine(lock: Path) -> bool:
    """Whether this thread holds a lock already: a claim inside a claim is no conflict."""
    return lock in _mine.get()


@contextmanager
def hold_lock(lock: Path, path: Path) -> Iterator[None]:
    """Hold a lock (flock(2)) until the block ends; its file is gone afterwards.

    Args:
        lock: Its file, in a folder that exists; not one that this thread holds.
        path: What is locked, for messages.

    Raises:
        BusyError: another process holds it; its number is named.
        OSError: the file system has no room or no locks.
    """
    handle = _taken(lock, path)
    token = _mine.set(_mine.get() | {lock})
    try:
        lock.write_text(f"{os.getpid()} {platform.node()}", encoding="utf-8")
        yield
    finally:
        _mine.reset(token)
        with defer_signals():
            with suppress(OSError):
                lock.unlink()  # while it is held: whoever opened it before looks again
            fcntl.flock(handle, fcntl.LOCK_UN)  # of children, too, that have the handle from a fork
            os.close(handle)


def _taken(lock: Path, path: Path) -> int:
    """The handle of a lock that is held from now on."""
    while True:
        handle = os.open(
            lock, os.O_RDWR | os.O_CREAT, 0o666
        )  # writable for all: another user may have to clear it away
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), lock.stat()):
                    return handle
        except BlockingIOError:
            holder = _holder(os.pread(handle, 999, 0).decode("utf-8", "replace"))
            os.close(handle)
            raise BusyError(
                f"{path}: is being written by {holder}; wait until it has ended, or choose another place"
            ) from None
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # its holder removed it after we had opened it


def _holder(text: str) -> str:
    """Who holds a lock, in words, by what its file says."""
    number, _, machine = text.partition(" ")
    if not number:
        return "another process"
    if machine != platform.node():
        return f"process {number} on {machine}"
    return "this very process, in another thread" if number == str(os.getpid()) else f"process {number}"
