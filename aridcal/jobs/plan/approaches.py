"""From which side joints come to their configurations, and by way of which points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.rows.repeats import SAME_ANGLE, SAME_LENGTH

BACK_ANGLE, BACK_LENGTH = 0.05, 0.02
"""[rad] and [m] that a joint stays off before it comes to its reading: some tens of times the play of a worn gear or screw."""


@dataclass(frozen=True)
class Approaches:
    """Approaches of n configurations.

    Attributes:
        sides: -1 where a joint comes from above, 1 from below, 0 where it does not move, shape (n, columns).
        via: Readings of the way point before each, shape (n, columns); NaN where there is none.
        straight: True where joints come from these sides on a straight way in joints from the configuration before, shape (n,).
    """

    sides: np.ndarray
    via: np.ndarray
    straight: np.ndarray

    @property
    def needed(self) -> np.ndarray:
        """True where a point on the way is needed, if the way there is straight in joints, shape (n,)."""
        return np.asarray(np.isfinite(self.via).all(axis=1) & ~self.straight)


def negligible_moves(kinds: tuple[str, ...]) -> np.ndarray:
    """Largest move of each joint that counts as none, shape (columns,), [rad] or [m]."""
    return np.array([SAME_LENGTH if kind == "prismatic" else SAME_ANGLE for kind in kinds])


def approach_sides(readings: np.ndarray, kinds: tuple[str, ...]) -> np.ndarray:
    """Sides from which joints come where each configuration is gone to straight from the one before, shape (n, columns).

    0 for the first one, to which nobody knows the way; a joint that does not move keeps its side.

    Args:
        readings: Shape (n, columns), in the order of the visits.
        kinds: Of the joints.
    """
    sides = np.zeros_like(readings)
    for k in range(1, len(readings)):
        step = readings[k] - readings[k - 1]
        sides[k] = np.where(np.abs(step) > negligible_moves(kinds), np.sign(step), sides[k - 1])
    return sides


def from_both_sides(
    readings: np.ndarray, kinds: tuple[str, ...], limits: np.ndarray, both: np.ndarray, rng: np.random.Generator
) -> Approaches:
    """Sides such that each joint comes from either side as often, wherever in its range.

    Configurations are paired by what a joint reads: of two neighbours one is come to from above, the other from below, so that
    the side goes with no smooth function of the reading. Which of the two is left to the way from the one before, so that few
    points are needed on the way, and to chance where that does not say.

    Args:
        readings: Shape (n, columns), in the order of the visits.
        kinds: Of the joints.
        limits: Of their readings, shape (columns, 2).
        both: Joints that come from both sides, shape (columns,) bool; the others come as they come.
        rng: Decides where nothing else does.
    """
    natural = approach_sides(readings, kinds)
    back = np.array([BACK_LENGTH if kind == "prismatic" else BACK_ANGLE for kind in kinds])
    sides = natural.copy()
    for j in np.flatnonzero(both).tolist():
        room = np.abs(readings[:, j, None] - limits[j]) > back[j]  # to go there from below, from above
        sides[:, j] = _paired(readings[:, j], natural[:, j], room, rng)
    via = np.clip(readings - np.where(both, sides * back, 0.0), *limits.T)
    before = np.vstack([np.full(readings.shape[1], np.nan), readings[:-1]])
    on_the_way = sides * (readings - before) >= back  # it comes from that side by itself, from far enough
    if not both.any():
        via[:] = np.nan
    return Approaches(sides, via, on_the_way[:, both].all(axis=1))


def _paired(reading: np.ndarray, natural: np.ndarray, room: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sides of one joint, shape (n,): see :func:`from_both_sides`.

    Args:
        reading: Shape (n,).
        natural: Sides without points on the way, shape (n,).
        room: Whether it can come from below and from above, shape (n, 2).
        rng: Decides where nothing else does.
    """
    chance = rng.choice([-1.0, 1.0], len(reading))
    forced = np.where(room.all(axis=1), 0.0, np.where(room[:, 0], 1.0, -1.0))
    sides = np.where(natural == 0.0, chance, natural)
    order = np.argsort(reading, kind="stable")
    for lower, upper in zip(order[::2].tolist(), order[1::2].tolist(), strict=False):
        if forced[lower] or forced[upper]:
            sides[lower] = forced[lower] or -forced[upper]
            sides[upper] = forced[upper] or -forced[lower]
        elif sides[lower] == sides[upper]:
            sides[lower if chance[lower] > 0 else upper] *= -1.0
    if len(reading) % 2:
        last = order[-1]
        sides[last] = forced[last] or sides[last]
    return sides
