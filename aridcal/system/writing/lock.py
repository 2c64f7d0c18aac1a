"""One writer at a time: a lock beside the output, which the system gives back when its holder dies."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from filelock import FileLock, Timeout

from aridcal.system.errors import BusyError

ATTEMPTS, PAUSE = 20, 0.01
"""A holder that ends removes its lock's file, which can be taken for a held lock for an instant: looked at again, [s]."""

_mine: ContextVar[frozenset[Path]] = ContextVar("_mine", default=frozenset())
"""Locks that this thread holds."""


def is_mine(lock: Path) -> bool:
    """Whether this thread holds a lock already: a claim inside a claim is no conflict."""
    return lock in _mine.get()


@contextmanager
def hold_lock(lock: Path, path: Path) -> Iterator[None]:
    """Hold a lock until the block ends; its file is gone afterwards.

    Args:
        lock: Its file, in a folder that exists; not one that this thread holds.
        path: What is locked, for messages.

    Raises:
        BusyError: another process holds it; its number is named.
        OSError: the file system has no room or no locks.
    """
    handle = _take(lock, path)
    token = _mine.set(_mine.get() | {lock})
    try:
        yield
    finally:
        _mine.reset(token)
        _give_back(lock, handle)


def _take(lock: Path, path: Path) -> FileLock:
    for _ in range(ATTEMPTS):
        handle = FileLock(lock, timeout=0, mode=0o666)  # writable for all: another user may have to clear it away
        try:
            handle.acquire()
        except Timeout:
            if holder := _holder(lock):
                raise BusyError(
                    f"{path}: is being written by {holder}; wait until it has ended, or choose another place"
                ) from None
            time.sleep(PAUSE)
            continue
        try:
            lock.write_text(f"{os.getpid()} {platform.node()}", encoding="utf-8")
        except OSError:  # the disk is full
            _give_back(lock, handle)
            raise
        return handle
    raise BusyError(f"{path}: is being written by another process; wait until it has ended, or choose another place")


def _give_back(lock: Path, handle: FileLock) -> None:
    """Remove a lock's file, while it is held: whoever opened it before looks again."""
    lock.unlink(missing_ok=True)
    handle.release()


def _holder(lock: Path) -> str:
    """Who holds a lock, in words; empty if its file says nothing, or no longer exists."""
    try:
        number, _, machine = lock.read_text(encoding="utf-8").partition(" ")
    except OSError:
        return ""
    if not number:
        return ""
    if machine != platform.node():
        return f"process {number} on {machine}"
    return "this very process, in another thread" if number == str(os.getpid()) else f"process {number}"
