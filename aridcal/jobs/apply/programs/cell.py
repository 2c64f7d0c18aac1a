"""What a program is read for: the robot, its axes as the controller counts them, and frames that the user states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.jobs.apply.programs.anatomy import Anatomy, anatomy_of
from aridcal.jobs.apply.programs.axes import Axes, axes_of
from aridcal.jobs.apply.programs.frames import KnownFrames, fixed_base
from aridcal.jobs.apply.programs.targets import Target


@dataclass(frozen=True)
class Cell:
    """The robot that a program moves.

    Attributes:
        robot: The nominal arm.
        frames: Those of ``--frames``.
        zeros: What the controller shows, in its units, of each axis of the arm where its reading is zero; empty: zero of each.
        start: Whether it is stated where the arm stands when the program begins.
    """

    robot: Robot
    frames: KnownFrames = field(default_factory=KnownFrames)
    zeros: tuple[float, ...] = ()
    start: bool = False

    @cached_property
    def axes(self) -> Axes:
        """The robot's readings as the program counts them."""
        return axes_of(self.robot.kinds, self.zeros)

    @cached_property
    def anatomy(self) -> Anatomy | None:
        """What words for its posture are about; None where it is no arm of that kind."""
        return anatomy_of(self.robot, self.axes)

    @cached_property
    def base(self) -> np.ndarray | None:
        """Where the URDF has the controller's base, in the campaign's, T of shape (4, 4); None where it does not say."""
        return fixed_base(self.robot)

    @property
    def elsewhere(self) -> np.ndarray | None:
        """The same where it is not the campaign's own; None where it is, or nothing is said."""
        return None if self.base is None or np.allclose(self.base, np.eye(4), atol=1e-6) else self.base


@dataclass(frozen=True)
class ProgramReading:
    """What a reader says of a project.

    Attributes:
        targets: In the order in which the robot goes there; behind them those that are left for a reason of the text.
        notes: Sentences on what was taken for granted, for the user.
    """

    targets: Sequence[Target]
    notes: tuple[str, ...] = ()
