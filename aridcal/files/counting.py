"""How the columns of a campaign's tables count the joints: in which unit, in which sense, from which zero."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.files.measurement_settings import ANGLES, LENGTHS, JointColumn, MeasurementSettings
from aridcal.system.errors import CampaignError, nearest, shortened


@dataclass(frozen=True)
class Counting:
    """Conversion of cells of joints to readings of the URDF's joints, and back.

    Attributes:
        unit: SI units in one unit of each column, shape (columns,).
        sign: 1, or -1 where the column counts backwards, shape (columns,).
        zero: What the column shows where the URDF's joint is at 0, shape (columns,), [rad] or [m].
    """

    unit: np.ndarray
    sign: np.ndarray
    zero: np.ndarray

    def of_shown(self, shown: np.ndarray) -> np.ndarray:
        """Readings from what the columns show, shape (N, columns), both in [rad] or [m]; in place, for tables may be long."""
        shown -= self.zero
        shown *= self.sign
        return shown

    def shown(self, readings: np.ndarray) -> np.ndarray:
        """What the columns show of readings, shape (N, columns), both in [rad] or [m]."""
        return readings * self.sign + self.zero

    def cells(self, readings: np.ndarray) -> np.ndarray:
        """Cells of readings, shape (N, columns)."""
        return self.shown(readings) / self.unit

    def steps(self, differences: np.ndarray) -> np.ndarray:
        """Differences of cells from differences of readings, shape (N, columns)."""
        return differences * self.sign / self.unit


def counting(settings: MeasurementSettings, readings: Sequence[str], kinds: Sequence[str]) -> Counting:
    """The conversion of a block's tables for joints of these names and kinds.

    Raises:
        CampaignError: the unit of a column is not of the joint's quantity.
    """
    joints = [settings.joints.get(name, JointColumn()) for name in readings]
    columns = [settings.columns.get(name, name) for name in readings]
    return Counting(
        unit=np.array([settings.units.joint(name, kind) for name, kind in zip(columns, kinds, strict=True)]),
        sign=np.array([float(joint.sign) for joint in joints]),
        zero=np.array([joint.shown_at_zero for joint in joints]),
    )


def check_on_chain(names: Iterable[str], key: str, readings: Sequence[str]) -> None:
    """Make sure that the names under a key are those of joints of the robot.

    Raises:
        CampaignError: naming the key.
    """
    for name in names:
        if name not in readings:
            raise CampaignError(
                f"{key}: no joint {shortened(name)!r} on the chain{nearest(name, readings)}; write one of its moving joints"
            )


def check_joints(settings: MeasurementSettings, place: str, readings: Sequence[str], kinds: Sequence[str]) -> None:
    """Make sure that `joints` of a block speaks of joints of the robot, each in a unit of its own.

    Args:
        settings: Of the block.
        place: The campaign's file and the key of the block, for messages.
        readings: Names of the robot's joints.
        kinds: Kind of each.

    Raises:
        CampaignError: naming the key.
    """
    check_on_chain(settings.joints, f"{place}.joints", readings)
    kind = dict(zip(readings, kinds, strict=True))
    for name, joint in settings.joints.items():
        what, units = ("slides", LENGTHS) if kind[name] == "prismatic" else ("turns", ANGLES)
        if joint.zero is not None and joint.zero_unit not in units:
            raise CampaignError(
                f"{place}.joints.{name}.zero: {joint.zero}, but this joint {what}; write a number with one of {', '.join(units)}"
            )
