"""The things around an arm that its measurements refer to: what is known of them beforehand, and of their relations."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from aridcal.engine.instruments.channels import Channels
from aridcal.engine.instruments.kind import MeasurementKind, Role
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS

TIP, WORLD = "tip", "world"
"""Carriers of things for which no link is named; also the label of a target that is the tip itself, as cameras see it."""


@dataclass(frozen=True)
class Things:
    """Everything of one role, L things.

    Attributes:
        role: What they are.
        names: Their labels.
        start: State of each beforehand, shape (L, P); NaN where nothing is known.
        free: Which components are identified, shape (L, u) bool.
        std: 1-sigma of what is known beforehand of each component, shape (L, u): infinite where nothing is, and where a
            component that is not free is exact.
        linked: Names of those that a link of the robot carries: where they are is said in its frame, not in the world's.
    """

    role: Role
    names: tuple[str, ...]
    start: np.ndarray
    free: np.ndarray
    std: np.ndarray
    linked: frozenset[str] = frozenset()

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def places(self) -> dict[str, int]:
        """Number of the thing at each place of corrections."""
        if self.role.places:
            return {place.rpartition(".")[0]: 0 for place in self.role.places}
        return {name: k for k, name in enumerate(self.names)}

    @property
    def held(self) -> dict[str, tuple[str, ...]]:
        """Components of each thing that are taken as stated, by its place of corrections."""
        if not self.role.places:
            names = self.role.components
            return {
                name: tuple(c for c, free in zip(names, row, strict=True) if not free)
                for name, row in zip(self.names, self.free, strict=True)
            }
        exact: dict[str, tuple[str, ...]] = {}
        for place in self.role.places:
            where, _, component = place.rpartition(".")
            exact[where] = (*exact.get(where, ()), component)
        return exact


@dataclass(frozen=True)
class Tie:
    """A known relation of two things of one role.

    Attributes:
        role: Name of the role.
        first: Label of the one.
        second: Label of the other.
        form: ``distance`` of two points, [m]; ``cosine`` of the angle between two planes' normals.
        value: Of it.
        std: 1-sigma.
    """

    role: str
    first: str
    second: str
    form: Literal["distance", "cosine"]
    value: float
    std: float


@dataclass(frozen=True)
class Instruments:
    """All things that the measurements of a campaign refer to.

    Attributes:
        things: By the name of their role.
        ties: What is known of their relations.
        world: True where something of them is known in the world frame; else that is the robot's base frame.
    """

    things: dict[str, Things] = field(default_factory=dict)
    ties: tuple[Tie, ...] = ()
    world: bool = False

    @cached_property
    def names(self) -> frozenset[str]:
        """Places of corrections at all things: their labels, but for heads."""
        return frozenset(name for things in self.things.values() for name in things.places)

    @property
    def held(self) -> dict[tuple[str, str], tuple[str, ...]]:
        """Components of each thing that are taken as stated, by the name of its role and its place of corrections."""
        return {
            (role, name): components for role, things in self.things.items() for name, components in things.held.items()
        }

    def unit(self, name: str, component: str) -> str:
        """Unit of what a coefficient at a thing moves."""
        for role in (things.role for things in self.things.values() if name in things.places):
            if component in role.components or f"{name}.{component}" in role.places:
                return role.units[role.moved_by(name, component)[0]]
        raise KeyError(f"{name}.{component}")


@dataclass(frozen=True)
class Block:
    """Rows of one kind, as a campaign declares them.

    Attributes:
        name: Of the block.
        kind: Name of the kind.
        channels: What its rows measure: those of the kind; where another block measures one of the same name, its name
            begins with the block's.
        sigma: Declared noise of each, None where it is to be estimated.
        rows: What the noise that its rows state themselves is taken for.
    """

    name: str
    kind: str
    channels: Channels
    sigma: tuple[float | None, ...]
    rows: Literal["relative", "absolute", "ignore"] = "relative"

    @property
    def traits(self) -> MeasurementKind:
        """Its kind's row of the table of kinds."""
        return MEASUREMENT_KINDS[self.kind]
