"""Two calibrations of one robot compared: what changed in predicted poses, why, and the same in words and as a document."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from aridcal import __version__
from aridcal.engine.robot.chain import Robot
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.history.changes import Cause, Causes, causes, untold_zeros
from aridcal.jobs.history.difference import Difference, difference
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.system.wording import enumerated, number, plus_minus, shown_in

LARGE = 3e-3
"""[m] and [rad]: a change above this is no longer linear: terms of second order reach 10 um and 10 urad."""

ROUNDS = 6
"""Times that a large change is taken off and looked for again; three are usual."""

SETTLED = 1e-7
"""[m] and [rad]: a large change that moves by less is found."""

WORST_ROWS = 8
"""Configurations that are listed: where the poses differ most."""


@dataclass(frozen=True)
class Comparison:
    """Two calibrations of one robot.

    Attributes:
        difference: Of the predicted poses.
        causes: What changed.
        records: What both calibrations say of themselves.
        urdf: Of the first robot, its file's name; whether both are the same text.
        stated: What the campaigns say differently of joints that have no column.
    """

    difference: Difference
    causes: Causes
    records: tuple[dict[str, Any], dict[str, Any]]
    urdf: tuple[str, bool]
    stated: tuple[str, ...] = ()

    @property
    def changed(self) -> bool:
        """Whether more differs than the uncertainty explains."""
        return self.difference.changed

    @property
    def notices(self) -> tuple[str, ...]:
        """What a reader should know."""
        own = [] if self.urdf[1] else ["the nominal URDFs differ: constants are corrections of each calibration's own"]
        return (*self.difference.notices, *own, *self.stated)


def compare(a: SavedModel, b: SavedModel) -> Comparison:
    """Compare two calibrations of one robot.

    Raises:
        AridcalError: they are not of the same joints, or saw none of the same configurations.
    """
    found = difference(a, b)
    why = causes(found) if found.changed else Causes((), found.p_value)
    moved: dict[str, float] = {}
    seen = found
    for _ in range(ROUNDS):
        large = [c for c in why.found[:1] if not moved and np.abs(c.value).max() > LARGE]
        again = [c for c in why.found if moved and set(c.names) <= set(moved)]
        step = {name: float(value) for c in (*large, *again) for name, value in zip(c.names, c.value, strict=True)}
        if not step or all(abs(value - moved.get(name, 0.0)) < SETTLED for name, value in step.items()):
            break
        moved = step
        seen = difference(a, b, moved)
        why = causes(seen, moved)
    robots = [saved.final.model.robot for saved in (a, b)]
    same = robots[0].urdf == robots[1].urdf
    return Comparison(found, why, (a.record, b.record), (robots[0].path.name, same), tuple(_stated(*robots)))


def _stated(first: Robot, second: Robot) -> Iterator[str]:
    """Joints without a column of which two campaigns say different things, in words."""
    one, other = first.stated, second.stated
    for name in dict.fromkeys((*one.names, *other.names)):
        said = [_said(robot, name) for robot in (first, second)]
        if said[0] != said[1]:
            yield (
                f"{name} {said[0]} in the first campaign and {said[1]} in the second: by that "
                "alone the first model has what it moves elsewhere"
            )


def _said(robot: Robot, name: str) -> str:
    """What a campaign says of a joint without a column."""
    place, coupled = robot.stated.joints.get(name), robot.stated.coupled.get(name)
    if place is not None:
        unit = "m" if robot.moves[name][1] == "prismatic" else "rad"
        return f"stands at {place:g} {unit} (`robot.joints`)"
    if coupled is not None:
        return f"follows {enumerated([f'{factor:g} {master}' for master, factor in coupled.items()])} (`robot.coupled`)"
    return "is as its column or the URDF says"


def p_in_words(p_value: float) -> str:
    """A p-value: ``p = 0.03``; of very small ones the bound."""
    return f"p = {number(p_value, 2)}" if p_value >= 1e-12 else "p < 1e-12"


def lines(found: Comparison) -> list[str]:
    """The answer in words, the verdict first."""
    d = found.difference
    odd = p_in_words(d.p_value)
    if not found.changed:
        said = [f"nothing changed beyond the uncertainty ({odd}; below {FALSE_ALARMS:g} a change is told)"]
    else:
        said = [f"changed: the predicted poses differ by more than the uncertainty of both ({odd})"]
    said.append(_sizes(d))
    said += [_cause(c) for c in found.causes.found]
    if found.changed and not found.causes.found:
        said.append("no single constant, zero or effect explains it")
    elif found.changed and found.causes.rest < FALSE_ALARMS:
        said.append(
            f"what else changed cannot be named: more is left than the uncertainty explains ({p_in_words(found.causes.rest)})"
        )
    if d.frames:
        said.append(_frames(d))
    untold = untold_zeros(d)
    if untold:
        zeros = "the zero" if len(untold) == 1 else "the zeros"
        said.append(f"not told from that: {zeros} of {enumerated(list(untold))}")
    return said


def _sizes(d: Difference) -> str:
    """How far the targets are apart."""
    parts = []
    for k, (unit, scale) in enumerate((("mm", 1e3), ("mrad", 1e3))[: 1 + d.turns]):
        own = slice(3 * k, 3 * k + 3)
        apart = np.linalg.norm(d.apart[:, own], axis=1)
        usual = float(np.sqrt(np.mean(np.sum(d.expected[:, own] ** 2, axis=1))))
        rms, most = float(np.sqrt(np.mean(apart**2))), float(apart.max())
        parts.append(
            f"{number(scale * rms)} {unit} RMS, {number(scale * most)} {unit} at most ({number(scale * usual)} {unit} RMS is "
            "what the uncertainty alone makes)"
        )
    return "the targets are apart by " + "; ".join(parts)


def _cause(c: Cause) -> str:
    """One cause."""
    if len(c.names) == 1:
        unit, scale = shown_in(c.units[0])
        sign = "+" if c.value[0] > 0 else ""
        by = f"by {sign}{plus_minus(scale * float(c.value[0]), scale * float(c.std[0]))} {unit}"
    else:
        by = f"in {len(c.names)} coefficients"
    alike = f"; {enumerated(list(c.alike))} would explain it as well" if c.alike else ""
    return f"changed: {c.words} {by} ({p_in_words(c.p_value)}){alike}"


NOUNS = {"world_base": "base (or the instrument)", "tip_target": "tool (or the target on it)"}
"""Of frames, as `aridcal check` calls them."""


def _frames(d: Difference) -> str:
    """What was set up anew."""
    parts = [
        f"the {NOUNS[where]}, {number(1e3 * length)} mm and {number(1e3 * turn)} mrad elsewhere"
        if d.turns or where == "world_base"
        else f"the {NOUNS[where]}, {number(1e3 * length)} mm elsewhere"
        for where, (length, turn) in d.frames.items()
    ]
    return f"not counted, for each calibration fits it anew: {enumerated(parts)}"


def constants(found: Comparison) -> list[dict[str, Any]]:
    """Coefficients that both calibrations have, each by itself, in SI; those of which the difference is surest come first."""
    d = found.difference
    rows = []
    for k, column in enumerate(d.columns):
        before, after = column.values
        std = float(np.sqrt(max(d.covariance[k, k], 0.0)))
        if not np.isfinite(before + after) or std == 0.0:
            continue
        rows.append(
            {
                "name": column.coefficient.name,
                "unit": column.unit,
                "before": before,
                "after": after,
                "change": after - before,
                "std": std,
                "p_value": d.p_of(((after - before) / std) ** 2, 1),
            }
        )
    return sorted(rows, key=lambda row: -abs(row["change"]) / row["std"])


def worst(d: Difference) -> np.ndarray:
    """Indices of the configurations where the targets are farthest apart, the worst first."""
    return np.argsort(-np.linalg.norm(d.apart[:, :3], axis=1))[:WORST_ROWS]


def document(found: Comparison) -> dict[str, Any]:
    """``compare.json`` as plain data, in SI where no unit is in the name."""
    d = found.difference
    size = np.linalg.norm(d.apart[:, :3], axis=1)
    expected = np.sqrt(np.sum(d.expected[:, :3] ** 2, axis=1))
    poses: dict[str, Any] = {"position_mm": _spread(1e3 * size, 1e3 * expected)}
    if d.turns:
        turn = np.linalg.norm(d.apart[:, 3:], axis=1)
        poses["rotation_mrad"] = _spread(1e3 * turn, 1e3 * np.sqrt(np.sum(d.expected[:, 3:] ** 2, axis=1)))
    return {
        "format": 1,
        "changed": found.changed,
        "p_value": d.p_value,
        "false_alarms": FALSE_ALARMS,
        "compared": len(d.z),
        "configurations": len(d.readings),
        "poses": poses,
        "causes": [
            {
                "what": c.words,
                "coefficients": [
                    {"name": name, "unit": unit, "before": before, "change": float(value), "std": float(std)}
                    for name, unit, before, value, std in zip(c.names, c.units, c.before, c.value, c.std, strict=True)
                ],
                "p_value": c.p_value,
                "as_well": list(c.alike),
            }
            for c in found.causes.found
        ],
        "rest_p_value": found.causes.rest,
        "constants": constants(found),
        "frames": {where: {"distance": length, "angle": turn} for where, (length, turn) in d.frames.items()},
        "not_told": [f"the zero of {name}" for name in untold_zeros(d)],
        "worst": [dict(zip(d.robot.readings, d.readings[k].tolist(), strict=True)) for k in worst(d)],
        "notices": list(found.notices),
        "version": __version__,
    }


def _spread(apart: np.ndarray, expected: np.ndarray) -> dict[str, float]:
    """Statistics of distances, shape (M,), and what the uncertainty alone makes of them."""
    return {
        "rms": float(np.sqrt(np.mean(apart**2))),
        "p95": float(np.percentile(apart, 95)),
        "max": float(apart.max()),
        "expected_rms": float(np.sqrt(np.mean(expected**2))),
    }
