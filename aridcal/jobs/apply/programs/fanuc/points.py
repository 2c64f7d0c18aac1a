"""Points of /POS as targets of a robot."""

from __future__ import annotations

import numpy as np

from aridcal.jobs.apply.programs.axes import DEGREE, MILLIMETRE, Axes
from aridcal.jobs.apply.programs.fanuc.listing import POSE, Point
from aridcal.jobs.apply.programs.notations import FANUC
from aridcal.jobs.apply.programs.targets import Branch, PoseReference, Target, Words
from aridcal.jobs.apply.programs.text import NONE, Code, Numbers
from aridcal.jobs.apply.programs.uses import Use

COUPLED = (
    "FANUC counts J3 from the horizontal, and the URDF its joint from link 2, so that J1 to J6 mean another place there: "
    "give poses, or state `j3_from_link_2: true` in --frames if this controller counts as the URDF does"
)
"""As drivers for ROS have it: of most arms the controller's J3 is the URDF's joint less J2 (J23_factor of fanuc_driver, which
is 1 for most arms, 0 or -1 for a few, and stands in no file of a program)."""


class Targets:
    """Points as targets.

    Args:
        axes: Of the robot: J1 and so on are its joints in their order, E1 and so on its rails.
        coupled: Whether J3 of joint targets is counted otherwise than the URDF's joint.
    """

    def __init__(self, axes: Axes, coupled: bool) -> None:
        self._axes, self._coupled = axes, coupled
        self._arm = {f"J{k + 1}": own for k, own in enumerate(axes.arm)}
        self._external = {f"E{k + 1}": own for k, own in enumerate(axes.external)}

    def beyond(self, point: Point) -> str:
        """Why a point does not fit the robot's axes."""
        if point.names == POSE:
            return ""
        other_names = [name for name in point.names if name not in POSE]
        axes = self._arm | self._external
        for name in other_names:
            if name not in axes:
                return f"has an axis {name} that the robot of the calibration has not"
            slides = self._axes.kinds[axes[name]] == "prismatic"
            unit = point.units[point.names.index(name)]
            if (unit == "MM") != slides:
                return f"has {name} in {unit.lower()}, but that axis {'slides' if slides else 'turns'}"
        if point.joints and not set(self._arm) <= set(other_names):
            return "does not state all joints of the arm"
        return COUPLED if point.joints and self._coupled else ""

    def target(
        self, code: Code, point: Point, words: Words | None, use: Use, beside: tuple[PoseReference, ...]
    ) -> Target:
        """The target of a point that a program uses.

        Args:
            code: The program's file.
            point: It.
            words: Of its CONFIG.
            use: How moves go there.
            beside: See :class:`aridcal.jobs.apply.programs.targets.Target`.
        """
        line, name = code.line(point.start), f"P[{point.number}]"
        if point.joints:
            axes = self._arm | self._external
            external_names = [axis for axis in axes if axis in point.names] if not point.why else []
            units = self._axes.units([axes[axis] for axis in external_names], DEGREE, MILLIMETRE)
            turned = tuple(point.field(axis) for axis in external_names)
            readings = self._axes.readings(turned, units)
            return Target(line, name, "joints", Numbers(turned), "", readings, units, digits=3, file=code.file)
        plain = not point.why
        numbers = (point.numbers if point.names == POSE else Numbers(map(point.field, POSE))) if plain else NONE
        branch = Branch(words, None, self._held(point), False, use.unknown)
        place = use.place if plain else None
        return Target(line, name, "pose", numbers, "", None, (), FANUC, place, beside, branch, file=code.file)

    def _held(self, point: Point) -> np.ndarray | None:
        """External axes that a pose states, shape (columns,), NaN of the others."""
        own = {axis: k for axis, k in self._external.items() if axis in point.names}
        if not own:
            return None
        readings = np.full(len(self._axes.kinds), np.nan)
        for axis, k in own.items():
            readings[k] = self._axes.unit(k, DEGREE, MILLIMETRE) * point.field(axis).value
        return readings
