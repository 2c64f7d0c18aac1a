r"""What a kind of measurement is: instrument x channel x unknowns, the mirror image of where x component x basis.

A row measures the target, whose pose the arm's model predicts, with the help of things that stand around it or sit on it: a
socket, an anchor, a plane, a camera, a marker. A kind says which things its rows refer to (:class:`Role`), what it predicts
from the target's pose and the states of those things, and how that changes with each (:class:`ResidualDerivatives`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from aridcal.engine.instruments.channels import LENGTH, Channels

States = Sequence[np.ndarray]
"""State of each thing that the rows refer to, one array of shape (n, P) for each role of a kind."""


@dataclass(frozen=True)
class Role:
    """What rows refer to by a label, and what may be unknown of it.

    A state is whatever numbers describe a thing: coordinates, a rotation matrix. A change has one number for each component.

    Attributes:
        name: ``anchor`` for instance.
        components: Names of what may be unknown of it, u of them.
        units: Of each.
        size: Numbers P of its state.
        moved: The state after a change: (n, P) and (n, u) to (n, P).
        slope: How the local change at the state moved by a change follows the components: (n, P) and (n, u) to (n, u, u);
            None where that is the identity. Derivatives of :class:`ResidualDerivatives` are by the local change.
        identified: Components that are unknown unless the campaign says otherwise.
        many: True where there may be thousands of them: they are solved for one by one, beside the rest of the model.
        places: For things whose components have places of corrections of their own, ``where.component`` of a coefficient and
            the components that it moves together. Empty where the place is the thing itself.
    """

    name: str
    components: tuple[str, ...]
    units: tuple[str, ...]
    size: int
    moved: Callable[[np.ndarray, np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray, np.ndarray], np.ndarray] | None
    identified: tuple[str, ...]
    many: bool
    places: Mapping[str, tuple[str, ...]] = field(default_factory=dict, hash=False)

    def moved_by(self, where: str, component: str) -> tuple[int, ...]:
        """Numbers of the components that a coefficient at one of these things moves."""
        names = self.places.get(f"{where}.{component}", (component,))
        return tuple(self.components.index(name) for name in names)


@dataclass(frozen=True)
class ResidualDerivatives:
    """Residuals of n rows of m numbers, and their derivatives.

    Attributes:
        residual: Measured minus predicted, shape (n, m).
        by_twist: How the prediction changes with a twist of the target at its own origin in world axes (linear, then
            angular), shape (n, m, 6).
        by_state: How it changes with a local change of each thing, shape (n, m, u) for each role.
    """

    residual: np.ndarray
    by_twist: np.ndarray
    by_state: tuple[np.ndarray, ...]


Residual = Callable[[np.ndarray, np.ndarray, np.ndarray, States], np.ndarray]
"""Rotations (n, 3, 3) and positions (n, 3) of the target in the world frame, what was read (n, W), states: to (n, m)."""

Derivatives = Callable[[np.ndarray, np.ndarray, np.ndarray, States], ResidualDerivatives]
"""From the arguments of a :data:`Residual` to a :class:`ResidualDerivatives`."""

RowPlacement = Callable[[np.ndarray, States], tuple[np.ndarray, np.ndarray | None]]
"""From the numbers of rows (n, W) and states to positions (n, 3) of the target in the world, and rotations (n, 3, 3) or None."""

ThingLocation = Callable[[np.ndarray, np.ndarray, np.ndarray, States], np.ndarray]
"""From the arguments of a :data:`Residual`, for the rows of one thing of the last role, to its state, shape (P,). Its own state
in the arguments is not looked at. Closed form or linear; NaN where these rows cannot tell."""


@dataclass(frozen=True)
class MeasurementKind:
    """One row of the table of kinds.

    Attributes:
        name: As in campaigns.
        words: What is measured, in words.
        channels: What a row reads.
        read: Names of the numbers that are read and predicted, columns of the table, W of them.
        roles: What its rows refer to.
        residual: Measured minus predicted.
        derivatives: The residual with its derivatives.
        located: Where a thing of the last role is, from the target's poses; None for a kind without roles.
        turns: False if the target's own rotation does not matter: it is a point.
        condition: True where a row says that a condition holds (the target is in the socket, on the plate): what was observed
            are then the readings of the joints.
        placed: The target's place in the world from a row alone; None for kinds whose rows do not tell it.
        bare: True where the target is the end of the row's path itself, a link's own frame: nothing of it is unknown.
        images: True where rows are marks in images, many of which show several: the cameras see the tip, or are on it.
        level: True where a row tells the vertical alone, and no length: a sensor has a frame of its own on the tip.
        missing: Of rows that come from no table, and read as many numbers as they need: which of m numbers a row does not
            measure, (n, W) and m to (n, m) bool.
        noise: Covariances of a row's first numbers, from what it read and the states of its things: (n, W) to (n, k, k); None
            where rows do not state them.
    """

    name: str
    words: str
    channels: Channels
    read: tuple[str, ...]
    roles: tuple[Role, ...]
    residual: Residual
    derivatives: Derivatives
    located: ThingLocation | None
    turns: bool = False
    condition: bool = False
    placed: RowPlacement | None = None
    bare: bool = False
    images: bool = False
    level: bool = False
    missing: Callable[[np.ndarray, int], np.ndarray] | None = None
    noise: Callable[[np.ndarray, States], np.ndarray] | None = None

    @property
    def places(self) -> bool:
        """True where a row measures the target's own place in the world."""
        return self.placed is not None

    @property
    def of_head(self) -> bool:
        """True of shots of a measuring head: its files say what was read, and no table of rows."""
        return self.missing is not None

    @property
    def tracked(self) -> bool:
        """True where a tracker gives the target's place in a table's own columns, whatever else stands around."""
        return self.places and not self.of_head

    @property
    def oriented(self) -> bool:
        """True where a tracker gives the target's place and orientation."""
        return self.tracked and self.turns

    @property
    def place_alone(self) -> bool:
        """True where a tracker gives the target's place and no orientation."""
        return self.tracked and not self.turns

    @property
    def joins(self) -> bool:
        """True where two links hold one body, which a block names."""
        return self.bare and not self.images

    @property
    def touches(self) -> bool:
        """True where a point of the target is held in place, and nothing is read."""
        return self.condition and not self.read and not self.turns

    @property
    def gauges(self) -> bool:
        """True where a gauge reads how far a condition is missed, if it reads anything."""
        return self.condition and bool(self.read)

    @property
    def ranges(self) -> bool:
        """True where a length is read that no condition holds at nothing."""
        return self.channels == (LENGTH,) and not self.condition

    @property
    def anywhere(self) -> bool:
        """True where any configuration can be measured: nothing must be touched, and nothing be in sight."""
        return not (self.condition or self.images or self.of_head)

    def numbers(self, observed: np.ndarray) -> np.ndarray:
        """The numbers that its rows read, shape (n, W), from columns for as many as the widest kind of a data set reads."""
        return observed[:, : len(self.read)] if self.missing is None else observed


def points_twist(by_point: np.ndarray) -> np.ndarray:
    """Derivatives by a twist of the target of what depends on its position alone, (n, m, 3) to (n, m, 6)."""
    return np.concatenate([by_point, np.zeros_like(by_point)], axis=2)


def added(state: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The state of what is described by coordinates: those plus the change."""
    return state + change
