"""Two calibrations of one robot compared: what changed in predicted poses, why, and the same in words and as a document."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from aridcal import __version__
from aridcal.engine.robot.chain import Robot
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.history.changes import Causes, NamedChange, causes, unobservable_zeros
from aridcal.jobs.history.difference import Difference, difference
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.system.wording import enumeration, number, plus_minus, shown_unit

LARGE_CHANGE = 3e-3
"""[m] and [rad]: a change above this is no longer linear: terms of second order reach 10 um and 10 urad."""

LARGE_CHANGE_ROUNDS = 6
"""Most times that a large change is taken off and looked for again; three are usual."""

LAST_CHANGE_STEP = 1e-7
"""[m] and [rad]: a large change that moves by less is found."""

WORST_ROWS = 8
"""Configurations that are listed: where the poses differ most."""


@dataclass(frozen=True)
class Comparison:
    """Two calibrations of one robot.

    Attributes:
        difference: Of the predicted poses.
        causes: What changed.
        records: Of both calibrations, as their files hold them.
        urdf: Name of the first robot's file, and whether both files have the same text.
        stated: Notices of joints without a column of which the campaigns say different things.
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
        of_urdfs = (
            [] if self.urdf[1] else ["the nominal URDFs differ: constants are corrections of each calibration's own"]
        )
        return (*self.difference.notices, *of_urdfs, *self.stated)


def compare(a: SavedModel, b: SavedModel) -> Comparison:
    """Compare two calibrations of one robot.

    Raises:
        AridcalError: they are not of the same joints, or saw none of the same configurations.
    """
    as_they_are = difference(a, b)
    causes_found = causes(as_they_are) if as_they_are.changed else Causes((), as_they_are.p_value)
    changes_taken: dict[str, float] = {}
    with_changes = as_they_are
    for _ in range(LARGE_CHANGE_ROUNDS):
        large = [c for c in causes_found.changes[:1] if not changes_taken and np.abs(c.value).max() > LARGE_CHANGE]
        again = [c for c in causes_found.changes if changes_taken and set(c.names) <= set(changes_taken)]
        step = {name: float(value) for c in (*large, *again) for name, value in zip(c.names, c.value, strict=True)}
        if not step or all(
            abs(value - changes_taken.get(name, 0.0)) < LAST_CHANGE_STEP for name, value in step.items()
        ):
            break
        changes_taken = step
        with_changes = difference(a, b, changes_taken)
        causes_found = causes(with_changes, changes_taken)
    robots = [saved.final.model.robot for saved in (a, b)]
    same = robots[0].urdf == robots[1].urdf
    return Comparison(
        as_they_are,
        causes_found,
        (a.record, b.record),
        (robots[0].path.name, same),
        tuple(_differences_of_joints(*robots)),
    )


def _differences_of_joints(first: Robot, second: Robot) -> Iterator[str]:
    """Joints without a column of which two campaigns say different things, in words."""
    one, other = first.stated, second.stated
    for name in dict.fromkeys((*one.names, *other.names)):
        words = [_joint_in_words(robot, name) for robot in (first, second)]
        if words[0] != words[1]:
            yield (
                f"{name} {words[0]} in the first campaign and {words[1]} in the second: by that "
                "alone the first model has what it moves elsewhere"
            )


def _joint_in_words(robot: Robot, name: str) -> str:
    """What a campaign says of a joint without a column, in words."""
    place, coupled = robot.stated.joints.get(name), robot.stated.coupled.get(name)
    if place is not None:
        unit = "m" if robot.moves[name][1] == "prismatic" else "rad"
        return f"stands at {place:g} {unit} (`robot.joints`)"
    if coupled is not None:
        return (
            f"follows {enumeration([f'{factor:g} {master}' for master, factor in coupled.items()])} (`robot.coupled`)"
        )
    return "is as its column or the URDF says"


def p_in_words(p_value: float) -> str:
    """A p-value: ``p = 0.03``; of very small ones the bound."""
    return f"p = {number(p_value, 2)}" if p_value >= 1e-12 else "p < 1e-12"


def lines(both: Comparison) -> list[str]:
    """The answer in words, the verdict first."""
    d = both.difference
    chance = p_in_words(d.p_value)
    if not both.changed:
        sentences = [f"nothing changed beyond the uncertainty ({chance}; below {FALSE_ALARMS:g} a change is told)"]
    else:
        sentences = [f"changed: the predicted poses differ by more than the uncertainty of both ({chance})"]
    sentences.append(_sizes(d))
    sentences += [_cause(c) for c in both.causes.changes]
    if both.changed and not both.causes.changes:
        sentences.append("no single constant, zero or effect explains it")
    elif both.changed and both.causes.rest < FALSE_ALARMS:
        sentences.append(
            f"what else changed cannot be named: more is left than the uncertainty explains ({p_in_words(both.causes.rest)})"
        )
    if d.frames:
        sentences.append(_frames(d))
    zeros_unknown = unobservable_zeros(d)
    if zeros_unknown:
        zeros = "the zero" if len(zeros_unknown) == 1 else "the zeros"
        sentences.append(f"not told from that: {zeros} of {enumeration(list(zeros_unknown))}")
    return sentences


def _sizes(d: Difference) -> str:
    """A sentence on the distances of the targets."""
    parts = []
    for k, (unit, scale) in enumerate((("mm", 1e3), ("mrad", 1e3))[: 1 + d.turns]):
        axes = slice(3 * k, 3 * k + 3)
        apart = np.linalg.norm(d.apart[:, axes], axis=1)
        usual = float(np.sqrt(np.mean(np.sum(d.expected[:, axes] ** 2, axis=1))))
        rms, most = float(np.sqrt(np.mean(apart**2))), float(apart.max())
        parts.append(
            f"{number(scale * rms)} {unit} RMS, {number(scale * most)} {unit} at most ({number(scale * usual)} {unit} RMS is "
            "what the uncertainty alone makes)"
        )
    return "the targets are apart by " + "; ".join(parts)


def _cause(c: NamedChange) -> str:
    """A line on one cause."""
    if len(c.names) == 1:
        unit, scale = shown_unit(c.units[0])
        sign = "+" if c.value[0] > 0 else ""
        by = f"by {sign}{plus_minus(scale * float(c.value[0]), scale * float(c.std[0]))} {unit}"
    else:
        by = f"in {len(c.names)} coefficients"
    alike = f"; {enumeration(list(c.alike))} would explain it as well" if c.alike else ""
    return f"changed: {c.words} {by} ({p_in_words(c.p_value)}){alike}"


NOUNS = {"world_base": "base (or the instrument)", "tip_target": "tool (or the target on it)"}
"""Of frames, as `aridcal check` calls them."""


def _frames(d: Difference) -> str:
    """A line on the frames that were set up anew."""
    parts = [
        f"the {NOUNS[where]}, {number(1e3 * length)} mm and {number(1e3 * turn)} mrad elsewhere"
        if d.turns or where == "world_base"
        else f"the {NOUNS[where]}, {number(1e3 * length)} mm elsewhere"
        for where, (length, turn) in d.frames.items()
    ]
    return f"not counted, for each calibration fits it anew: {enumeration(parts)}"


def constants(comparison: Comparison) -> list[dict[str, Any]]:
    """Coefficients that both calibrations have, each by itself, in SI; those of which the difference is surest come first."""
    d = comparison.difference
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


def document(comparison: Comparison) -> dict[str, Any]:
    """``compare.json`` as plain data, in SI where no unit is in the name."""
    d = comparison.difference
    size = np.linalg.norm(d.apart[:, :3], axis=1)
    expected = np.sqrt(np.sum(d.expected[:, :3] ** 2, axis=1))
    poses: dict[str, Any] = {"position_mm": _spread(1e3 * size, 1e3 * expected)}
    if d.turns:
        turn = np.linalg.norm(d.apart[:, 3:], axis=1)
        poses["rotation_mrad"] = _spread(1e3 * turn, 1e3 * np.sqrt(np.sum(d.expected[:, 3:] ** 2, axis=1)))
    return {
        "format": 1,
        "changed": comparison.changed,
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
            for c in comparison.causes.changes
        ],
        "rest_p_value": comparison.causes.rest,
        "constants": constants(comparison),
        "frames": {where: {"distance": length, "angle": turn} for where, (length, turn) in d.frames.items()},
        "not_told": [f"the zero of {name}" for name in unobservable_zeros(d)],
        "worst": [dict(zip(d.robot.readings, d.readings[k].tolist(), strict=True)) for k in worst(d)],
        "notices": list(comparison.notices),
        "version": __version__,
    }


def _spread(distance: np.ndarray, expected: np.ndarray) -> dict[str, float]:
    """Statistics of distances, shape (M,), and the RMS that the uncertainty alone would give."""
    return {
        "rms": float(np.sqrt(np.mean(distance**2))),
        "p95": float(np.percentile(distance, 95)),
        "max": float(distance.max()),
        "expected_rms": float(np.sqrt(np.mean(expected**2))),
    }
