"""What is said on the screen of programs that were corrected."""

from __future__ import annotations

import numpy as np

from aridcal.jobs.apply.programs.corrections import Corrections
from aridcal.jobs.apply.programs.read_project import LoadedProject
from aridcal.jobs.apply.programs.rewrite import Answer
from aridcal.jobs.apply.programs.targets import Target
from aridcal.system.errors import shortened

SHOWN_REASONS = 12
"""Reasons for which targets are left; the table beside the program has all."""


def lines_of(answer: Answer) -> list[str]:
    """What was taken for granted, what was left and why, and what is gained."""
    lines = [f"note: {note}" for note in answer.notes]
    lines += _reasons(answer.corrections, answer.opened)
    lines += _remarks(answer.corrections, answer.opened)
    if answer.saved.measurements.joint_reading == "reported":
        lines.append("joints are taken as the controller reports them, as in the calibration, not as it is told")
    return [*lines, f"{_headline(answer)}; each one in {answer.outputs.side}"]


def _headline(answer: Answer) -> str:
    corrected = ~answer.corrections.left
    where = answer.outputs.folder if answer.outputs.folder is not None else answer.outputs.files[0]
    headline = f"{where}: {corrected.sum()} of {len(answer.corrections)} targets corrected"
    if not corrected.any():
        return headline
    before, after = (1e3 * _rms(off[corrected, 0]) for off in (answer.corrections.before, answer.corrections.after))
    off = f"the calibrated model has the tip {before:.3f} mm off (RMS) as the program was, {after:.4f} mm as it is now"
    return f"{headline}; {off}"


def _reasons(corrections: Corrections, loaded: LoadedProject) -> list[str]:
    """Why targets are left, the most frequent reason first, each with the first of its targets."""
    by_reason: dict[str, list[int]] = {}
    for k in np.flatnonzero(corrections.left).tolist():
        by_reason.setdefault(corrections.why[k], []).append(k)
    reasons = sorted(by_reason.items(), key=lambda item: -len(item[1]))
    lines = []
    for why, same in reasons[:SHOWN_REASONS]:
        others = f" and {len(same) - 1} more" if len(same) > 1 else ""
        lines.append(f"left as it is: {_name(corrections.targets[same[0]], loaded)}{others}: {why}")
    rest = reasons[SHOWN_REASONS:]
    if rest:
        lines.append(f"and {sum(len(same) for _, same in rest)} more, for {len(rest)} other reasons")
    return lines


def _remarks(corrections: Corrections, loaded: LoadedProject) -> list[str]:
    """What is to be known of corrections, and where most remains."""
    by_remark: dict[str, list[int]] = {}
    for k in np.flatnonzero(~corrections.left).tolist():
        if corrections.remark[k]:
            by_remark.setdefault(corrections.remark[k], []).append(k)
    lines = []
    for remark, same in by_remark.items():
        most = same[int(np.argmax(corrections.after[same, 0]))]
        position, rotation = 1e3 * corrections.after[most]
        lines.append(
            f"{len(same)} of them: {remark}. Most remains at {_name(corrections.targets[most], loaded)}: "
            f"{position:.3f} mm and {rotation:.3f} mrad"
        )
    return lines


def _name(target: Target, loaded: LoadedProject) -> str:
    """How messages name a target."""
    sources = loaded.project.sources
    file = f"{sources[target.file].path.name} " if len(sources) > 1 else ""
    return f"{file}line {target.line}, {shortened(target.name)}"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
