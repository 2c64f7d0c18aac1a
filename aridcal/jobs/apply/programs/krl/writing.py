"""Planned moves as a program in KRL, and the mark of a corrected one."""

from __future__ import annotations

from collections.abc import Iterator

from aridcal.jobs.apply.programs.moves import Moves

PERCENT = 10
"""Of the fastest: programs go slowly, as the ways between configurations are not looked at."""

END_OF_FILE = "\x1a"
"""Old controllers end files with it."""


def program(moves: Moves, stem: str) -> Iterator[str]:
    """Lines of a program: `PTP` to axes without approximation stops exactly, and nothing is carried out ahead of `WAIT`."""
    axes = moves.axes()
    yield f"DEF {stem}( )"
    yield from (f"  ; {note}" for note in moves.notes)
    yield "  BAS(#INITMOV, 0)"
    yield f"  BAS(#VEL_PTP, {PERCENT})"
    for stop in moves.stops:
        values = [f"{axis} {value:.5f}" for axis, value in zip(axes, moves.shown(stop), strict=True)]
        yield f"  PTP {{{', '.join(values)}}}"
        if stop.number:
            yield f"  ; {stop.remark}"
            yield f"  WAIT SEC {moves.settle:.3f}"
    yield "END"


def comment(text: str, sentence: str) -> tuple[int, str]:
    """A comment at the end of a file: where, and what."""
    place = len(text.rstrip(END_OF_FILE))
    end = "\r\n" if "\r\n" in text else "\n"
    before = "" if text[:place].endswith("\n") or not place else end
    return place, f"{before}; {sentence}{end}"
