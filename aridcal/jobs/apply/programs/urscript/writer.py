"""Planned moves as URScript: `movej` with a blend radius of 0 stops exactly."""

from __future__ import annotations

from collections.abc import Iterator

from aridcal.jobs.apply.programs.moves import Moves

SPEED = 0.3
"""[rad/s] of all moves, and half of it in a second: a tenth of what these arms can."""


def write(moves: Moves, stem: str) -> Iterator[str]:
    """Lines of a program."""
    yield f"def {stem}():"
    yield from (f"  # {note}" for note in moves.notes)
    for stop in moves.stops:
        q = ", ".join(f"{value:.6f}" for value in stop.readings.tolist())
        yield f"  movej([{q}], a={SPEED / 2:g}, v={SPEED:g})"
        if stop.number:
            yield f"  # {stop.remark}"
            yield f'  textmsg("configuration {stop.number}")'
            yield f"  sleep({moves.settle:.3f})"
    yield "end"
