"""The question of a calibration: which frames and constants are unknown, what the campaign declares, what the search may add."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.effect_kind import Declaration
from aridcal.engine.corrections.loads import Payload
from aridcal.engine.robot.kinematics import LEVEL_GRAVITY

if TYPE_CHECKING:  # campaigns are read before what fits is loaded
    from aridcal.engine.fit.least_squares import Fit
    from aridcal.engine.rows.dataset import Dataset


def no_starts(fit: Fit, rows: Dataset) -> list[np.ndarray]:
    """No starts of a fit beside its own."""
    return []


@dataclass(frozen=True)
class EndFrame:
    """A frame at one end of the chain.

    Attributes:
        at: Its place in the world, or on the link that carries it; a hint where it is unknown.
        unknown: True if it is to be identified.
        by_station: True if each station has its own.
    """

    at: pin.SE3 = field(default_factory=pin.SE3.Identity)
    unknown: bool = True
    by_station: bool = False


@dataclass(frozen=True)
class Question:
    """What a campaign asks of the rows of a robot.

    Attributes:
        world_base: T_world_base.
        tip_target: T_tip_target of a target without a label, and the hint for labels that ``targets`` does not have.
        targets: T_tip_target of targets with labels, by label.
        target_on: Links other than the tip that carry targets, by the targets' labels.
        constants: Set of constants: ``full``, ``doty``, ``angles`` or ``none``.
        gravity: In the base frame, shape (3,), [m/s^2]; None: along -z of the world frame.
        payloads: Masses that hang at links; if empty, the payload of the rows hangs at the target of the default path.
        effects: Effects that the campaign declares.
        sought: Kinds of effects that the search may add to them.
        source: The file of the campaign, for messages.
        starts: Further starts that a fit of K constants to some rows is checked from, shape (K,) each: an arm of a known build
            may have a closed form.
    """

    world_base: EndFrame = EndFrame()
    tip_target: EndFrame = EndFrame()
    targets: Mapping[str, EndFrame] = field(default_factory=dict)
    target_on: Mapping[str, str] = field(default_factory=dict)
    constants: str = "full"
    gravity: np.ndarray | None = field(default_factory=lambda: np.array(LEVEL_GRAVITY))
    payloads: tuple[Payload, ...] = ()
    effects: tuple[Declaration, ...] = ()
    sought: tuple[str, ...] = ()
    source: Path = Path()
    starts: Callable[[Fit, Dataset], list[np.ndarray]] = no_starts

    @property
    def by_station(self) -> bool:
        """True where a frame is one for each station, so that every row must name its station."""
        return self.world_base.by_station or self.tip_target.by_station

    def target(self, label: str | None) -> EndFrame:
        """The frame of a target by its label; :attr:`tip_target` for labels that the campaign does not name."""
        return self.targets.get(str(label), self.tip_target)

    def without_search(self) -> Question:
        """The same question with the declared effects alone."""
        return replace(self, sought=())
