"""Errors that all rows of one place share: a nuisance beside which effects must show, and no effect of the robot.

An instrument that is moved, re-aimed or read once for several rows errs alike in them. Each place has a shift and a turn of its
own, of one size for all places, which the rows choose: a variance component (Searle, Casella and McCulloch, Variance Components,
Wiley 1992, chapter 6).
"""

from __future__ import annotations

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect

BY = "repeats"
"""What such a deviation depends on."""

SHIFT, TURN = ("world_base", ("x", "y", "z")), ("tip_target", ("roll", "pitch", "yaw"))
"""Motions of the target and nothing else: along the world's axes, and about itself."""


def place_scatter(place: np.ndarray, shifts: bool, turns: bool) -> tuple[Effect, ...]:
    """A shift and a turn of each place, whose number each row has, shape (N,); without what the rows do not measure."""
    bases = [Basis("label", (_column(k),)) for k in np.unique(place).tolist()]
    measurable = [motions for motions, measured in ((SHIFT, shifts), (TURN, turns)) if measured]
    return tuple(
        Effect(
            "regional",
            where,
            tuple(Coefficient(where, c, basis) for c in motion for basis in bases),
            by=BY,
            smooth=True,
        )
        for where, motion in measurable
    )


def place_columns(place: np.ndarray) -> dict[str, np.ndarray]:
    """Covariates of the places: 1 in the rows of a place, shape (N,) each."""
    return {_column(k): (place == k).astype(float) for k in np.unique(place).tolist()}


def is_scatter(effect: Effect) -> bool:
    """True for an error that rows of a place share."""
    return effect.by == BY


def _column(k: int) -> str:
    return f"place[{k}]"
