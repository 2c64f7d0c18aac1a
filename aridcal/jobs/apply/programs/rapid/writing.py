"""RAPID that is written: planned moves, and the comment of a corrected module."""

from __future__ import annotations

import re
from collections.abc import Iterator

from aridcal.jobs.apply.programs.moves import ARM_AXES, Moves
from aridcal.jobs.apply.programs.rapid.grammar import blanked

NOT_USED = "9E+09"
"""RAPID's value of an external axis that there is not."""

END = re.compile(r"endmodule(?<!\wendmodule)\b")
"""In small letters: a search for plain letters first takes a tenth of the time."""


def comment(text: str, sentence: str) -> tuple[int, str]:
    """Where a comment is put that changes no target's line, and the comment: before the end of the last module."""
    end = "\r\n" if "\r\n" in text else "\n"
    remark = f"! {' '.join(sentence.split())}{end}"
    ends = [match.start() for match in END.finditer(blanked(text).lower())]
    if not ends:
        return len(text), remark if text.endswith("\n") or not text else end + remark
    start = text.rfind("\n", 0, ends[-1]) + 1
    return (ends[-1] if text[start : ends[-1]].strip() else start), remark


def write(moves: Moves, stem: str) -> Iterator[str]:
    """`MoveAbsJ` to a zone of `fine` stops exactly."""
    axes = moves.axes()
    yield f"MODULE {stem}"
    yield from (f"  ! {note}" for note in moves.notes)
    yield f"  PROC {stem}_run()"
    for stop in moves.stops:
        value = dict(zip(axes, (f"{v:.5f}" for v in moves.shown(stop)), strict=True))
        arm, outside = (
            ", ".join(value.get(f"{letter}{k}", NOT_USED) for k in range(1, ARM_AXES + 1)) for letter in ("A", "E")
        )
        yield f"    MoveAbsJ [[{arm}], [{outside}]] \\NoEOffs, v100, fine, tool0;"
        if stop.number:
            yield f"    ! {stop.remark}"
            yield f'    TPWrite "configuration {stop.number}";'
            yield f"    WaitTime \\InPos, {moves.settle:.3f};"
    yield "  ENDPROC"
    yield "ENDMODULE"
