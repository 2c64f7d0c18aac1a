"""Which of many rows a picture draws, and the words that say so."""

from __future__ import annotations

import numpy as np

MOST_DRAWN = 5_000
"""Rows that are drawn: more are dots upon dots, and of a million a page would have 73 MB."""

SOUND_DRAWN = 1_000
"""Rows among them that were not flagged, at least: whatever is wrong with the flagged ones, these show the calibration."""


def drawn_rows(flagged: np.ndarray) -> tuple[np.ndarray, str]:
    """Rows that are drawn: all; of too many every flagged one, for nobody looks for the others, and every k-th of the rest.

    Args:
        flagged: Of the rows in the order in which they are stepped through, shape (N,) bool.

    Returns:
        Their numbers, rising; and which they are, in words, empty where all are drawn.
    """
    if len(flagged) <= MOST_DRAWN:
        return np.arange(len(flagged)), ""
    odd, sound = np.flatnonzero(flagged), np.flatnonzero(~flagged)
    every_odd, every = _every(len(odd), MOST_DRAWN), _every(len(sound), max(MOST_DRAWN - len(odd), SOUND_DRAWN))
    rows = np.sort(np.concatenate([odd[::every_odd], sound[::every]]))
    words = f"{len(rows):,} of {len(flagged):,} rows drawn"
    if not len(odd):
        return rows, f"{words}, {_each(every)}"
    which = (
        f"every flagged one ({len(odd):,})" if every_odd == 1 else f"{_each(every_odd)} of {len(odd):,} flagged ones"
    )
    return rows, f"{words}: {which}{f', {_each(every)} of the others' if len(sound) else ''}"


def _every(count: int, most: int) -> int:
    """The least step by which no more than so many are left."""
    return max(-(-count // most), 1)


def _each(every: int) -> str:
    """``every 200th``."""
    if every == 1:
        return "each"
    ending = "th" if every % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(every % 10, "th")
    return f"every {every:,}{ending}"
