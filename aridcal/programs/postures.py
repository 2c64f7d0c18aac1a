"""What languages write of the arm's posture beside a pose: KUKA's S and T, ABB's confdata, FANUC's CONFIG."""

from __future__ import annotations

from aridcal.programs.cell import Cell
from aridcal.programs.targets import Words
from aridcal.programs.text import Number


def krl_words(status: Number | None, turn: Number | None, cell: Cell) -> Words | None:
    """S and T of an E6POS or a POS; None where neither stands there, or the arm has no such words."""
    return None


def rapid_words(data: tuple[Number, ...], cell: Cell) -> Words | None:
    """cf1, cf4, cf6 and cfx of a robtarget; None where the arm has no such words."""
    return None


def fanuc_words(letters: tuple[Number, ...], turns: tuple[Number, ...], cell: Cell) -> Words | None:
    """CONFIG : 'N U T, 0, 0, 0': its letters and turn numbers; None where nothing stands there, or the arm has no such words."""
    return None
