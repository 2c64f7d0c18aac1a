"""What is said on the screen of programs that were corrected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.errors import shortened
from aridcal.programs.correct import Correction
from aridcal.programs.job import Answer
from aridcal.programs.read_project import Opened

SHOWN_REASONS = 12
"""Reasons for which targets are left; the table beside the program has all."""


def lines_of(answer: Answer) -> list[str]:
    """What was taken for granted, what was left and why, and what is gained."""
    corrections, opened = answer.corrections, answer.opened
    done = [c for c in corrections if not c.why]
    lines = [f"note: {note}" for note in answer.reading.notes]
    lines += _reasons([c for c in corrections if c.why], opened)
    lines += _remarks(done, opened)
    if answer.saved.measurements.joint_reading == "reported":
        lines.append("joints are taken as the controller reports them, as in the calibration, not as it is told")
    return [*lines, f"{_headline(answer, done)}; each one in {answer.outputs.side}"]


def _headline(answer: Answer, done: Sequence[Correction]) -> str:
    where = answer.outputs.folder if answer.outputs.folder is not None else answer.outputs.files[0]
    headline = f"{where}: {len(done)} of {len(answer.corrections)} targets corrected"
    if not done:
        return headline
    before, after = 1e3 * _rms([c.before[0] for c in done]), 1e3 * _rms([c.after[0] for c in done])
    off = f"the calibrated model has the tip {before:.3f} mm off (RMS) as the program was, {after:.4f} mm as it is now"
    return f"{headline}; {off}"


def _reasons(left: Sequence[Correction], opened: Opened) -> list[str]:
    """Why targets are left, the most frequent reason first, each with the first of its targets."""
    by_reason: dict[str, list[Correction]] = {}
    for correction in left:
        by_reason.setdefault(correction.why, []).append(correction)
    reasons = sorted(by_reason.items(), key=lambda item: -len(item[1]))
    lines = []
    for why, same in reasons[:SHOWN_REASONS]:
        others = f" and {len(same) - 1} more" if len(same) > 1 else ""
        lines.append(f"left as it is: {_name(same[0], opened)}{others}: {why}")
    rest = reasons[SHOWN_REASONS:]
    if rest:
        lines.append(f"and {sum(len(same) for _, same in rest)} more, for {len(rest)} other reasons")
    return lines


def _remarks(done: Sequence[Correction], opened: Opened) -> list[str]:
    """What is to be known of corrections, and where most remains."""
    lines = []
    for remark in dict.fromkeys(c.remark for c in done if c.remark):
        same = [c for c in done if c.remark == remark]
        most = max(same, key=lambda c: c.after[0])
        lines.append(
            f"{len(same)} of them: {remark}. Most remains at {_name(most, opened)}: "
            f"{1e3 * most.after[0]:.3f} mm and {1e3 * most.after[1]:.3f} mrad"
        )
    return lines


def _name(correction: Correction, opened: Opened) -> str:
    """How messages name a target."""
    target, sources = correction.target, opened.project.sources
    file = f"{sources[target.file].path.name} " if len(sources) > 1 else ""
    return f"{file}line {target.line}, {shortened(target.name)}"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
