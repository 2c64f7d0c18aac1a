"""Memory that nobody uses any more, given back to the system."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def frozen_garbage() -> Iterator[None]:
    """Keep the garbage collector from looking through what exists already: through all modules that takes a while."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


FEW_ROWS = 20_000
"""Work: Rows whose memory is not worth giving back, some 10 MB: it must be zeroed when it is wanted again, which takes 3 % of the
time of calibrations of some hundred rows."""


def give_back_of(rows: int) -> None:
    """Give back what so many rows took; see :func:`give_back`."""
    if rows >= FEW_ROWS:
        give_back()


def give_back() -> None:
    """Give back what Arrow and the C library keep of freed memory for later: of a million rows 300 MB, and 100 to 150 MB.

    Arrays below 32 MB lie in the C library's heap, which shrinks from its end alone: one small array there holds all gaps below
    it. ``malloc_trim`` gives the gaps back, too; only glibc has it, and elsewhere nothing is lost but that.
    """
    arrow = sys.modules.get("pyarrow")  # of what was not loaded nothing is kept
    if arrow is not None:
        arrow.default_memory_pool().release_unused()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
