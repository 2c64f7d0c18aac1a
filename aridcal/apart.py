"""Effects in words: what each kind is, and what would tell two of them apart that these data cannot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aridcal.effects import Effect
from aridcal.robot import Robot

MEANING = {
    "joint_gain": "the joint turns by more or less than it reads",
    "joint_harmonic": "an error that comes round with each turn of a shaft or disk",
    "joint_map": "an error of the joint's own reading, as of an encoder or gear",
    "joint_backlash": "play that is taken up on one side or the other",
    "joint_compliance": "the joint yields under the weight beyond it",
    "bearing_compliance": "the bearing tilts under the weight beyond it",
    "axis_wobble": "the axis itself wanders as the joint turns",
    "rail_straightness": "the rail is bent",
    "rail_angular": "the carriage tilts on its way along the rail",
    "joint_coupling": "the joint moves along when another one turns",
    "thermal": "it grows or shifts with temperature",
    "drift": "a frame that moved while these rows were measured",
    "payload_compliance": "it yields under the payload",
    "lens_distortion": "the lens bends the picture otherwise than declared",
    "focal_length": "the camera's scale is not the one declared",
    "principal_point": "the camera's centre is not where it was declared",
    "sonar_bias": "the sonar reads too long or too short",
    "sonar_scale": "the sonar's reading grows too fast or too slowly",
    "unknown": "something repeatable that no kind of effect explains",
}
"""Each kind of effect in a few words; its section in docs/effects.md says more."""

TOGETHER = 0.8  # correlation of two columns that is worth a word

# Covariates that are no reading of a joint: what they are, and how to change them while all else stays.
COLUMNS = {
    "time": ("time", "repeat the same configurations hours later, in another order"),
    "temperature": ("temperature", "measure the same configurations cold and warm"),
    "payload": ("the payload", "measure the same configurations with and without payload"),
}
LOADS = {
    "gravity_torque": "the gravity load on {}",
    "gravity_moment": "the gravity moment on the bearing of {}",
    "payload_torque": "the payload's pull on {}",
}


def tell_apart(a: Effect, b: Effect, robot: Robot, columns: Mapping[str, np.ndarray]) -> str:
    """A sentence on what to measure.

    Args:
        a: The effect that was named.
        b: One that would do as well.
        robot: The chain that both act on.
        columns: Joint positions and measured columns of the rows, shape (N,) each.
    """
    own, other = list(a.covariates), list(b.covariates)
    for change, keep in (
        ([n for n in other if n not in own], own),
        ([n for n in own if n not in other], other),
    ):
        if change:
            what, how = _words(change[0])
            stays = " and ".join(_words(n)[0] for n in keep)
            return (
                f"measure rows in which {what} changes while {stays} stays: {how}{_together(change[0], keep, columns)}."
            )
    follows = " and ".join(_words(n)[0] for n in own)
    names = list(robot.names)
    places = [_place(e.where, names) for e in (a, b)]
    between = [n for n in names[min(places) : max(places)] if n not in own]
    if between:
        return (
            f"both follow {follows}: at the same {follows}, turn {', '.join(between)} widely, which lie between them."
        )
    return f"both follow {follows} and act at the same place: only their shape differs. Measure more of its range, densely."


def _place(where: str, names: list[str]) -> int:
    """Where on the chain: 0 before the first joint."""
    if where in names:
        return names.index(where) + 1
    return 0 if where == "world_base" else len(names) + 1


def _words(name: str) -> tuple[str, str]:
    """A covariate in words, and how to change it."""
    joint, _, load = name.rpartition(".")
    for key, words in LOADS.items():
        if joint and load.startswith(key):
            return words.format(
                joint
            ), f"the same reading of {joint} with the arm beyond it stretched, folded or loaded"
    if name.endswith("_direction"):
        joint = name.removesuffix("_direction")
        return f"the direction in which {joint} approached", "reach the same configurations from both sides"
    for key, words_and_how in COLUMNS.items():
        if name == key or name.startswith(f"{key}_"):
            return words_and_how[0] if name == key else name, words_and_how[1]
    return name, f"move {name} over its range in each of a few settings of the rest"


def _together(change: str, keep: list[str], columns: Mapping[str, np.ndarray]) -> str:
    """A clause on columns that went together in these data."""
    for name in keep:
        if change in columns and name in columns:
            with np.errstate(invalid="ignore"):
                r = float(np.corrcoef(columns[change], columns[name])[0, 1])
            if abs(r) > TOGETHER:
                return f" (in these data the two go together: correlation {r:.2f})"
    return ""
