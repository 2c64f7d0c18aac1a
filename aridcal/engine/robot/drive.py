"""How readings move joints: what a column of its own, a master, several of them, or a stated place come down to."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from aridcal.system.errors import RobotError, nearest, shortened


@dataclass(frozen=True)
class Drive:
    """What moves a joint: position = sum of factor * reading, + offset.

    A joint with a column follows that with the factor 1, a mimic its master; one that stands still follows none.

    Attributes:
        factors: By name of the joint whose column that is, [unit of the position / unit of the reading].
        offset: [rad] or [m].
    """

    factors: Mapping[str, float]
    offset: float = 0.0

    def of(self, drives: Mapping[str, Drive]) -> Drive:
        """The drive in which masters that have drives of their own are replaced by what these follow."""
        factors: dict[str, float] = {}
        offset = self.offset
        for name, factor in self.factors.items():
            master_drive = drives.get(name, Drive({name: 1.0}))
            for master, further in master_drive.factors.items():
                factors[master] = factors.get(master, 0.0) + factor * further
            offset += factor * master_drive.offset
        return Drive(factors, offset)


@dataclass(frozen=True)
class StatedJoints:
    """What a campaign says of joints that have no column.

    Attributes:
        joints: Where joints stand in all rows, [rad] or [m].
        coupled: Factors of joints that follow several others, by these others' names.
    """

    joints: Mapping[str, float] = field(default_factory=dict)
    coupled: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Joints that it says something of."""
        return (*self.joints, *self.coupled)

    @property
    def drives(self) -> dict[str, Drive]:
        """Drives of the joints, masters not yet resolved."""
        still = {name: Drive({}, place) for name, place in self.joints.items()}
        return still | {name: Drive(factors) for name, factors in self.coupled.items()}

    def check(self, joints: Collection[str], moving: Collection[str], mimics: Collection[str], urdf: str) -> None:
        """Refuse statements that no robot of these joints can have.

        Args:
            joints: Names of all its joints.
            moving: Of those that move.
            mimics: Of those that have a ``<mimic>``.
            urdf: Its file, for messages.

        Raises:
            RobotError: naming the key.
        """
        for key, name in (*(("joints", n) for n in self.joints), *(("coupled", n) for n in self.coupled)):
            _check_moves(f"robot.{key}", name, joints, moving, urdf)
            if name in mimics:
                raise RobotError(
                    f"{urdf}: joint {name!r} has a <mimic>, and stands under `robot.{key}`, too. Delete one of both"
                )
        for name, factors in self.coupled.items():
            key = f"robot.coupled.{shortened(name)}"
            if name in self.joints:
                raise RobotError(f"{key}: the joint stands under `robot.joints`, too. Delete one of both")
            if not factors:
                raise RobotError(f"{key}: names no joint that it follows. One that stands still is of `robot.joints`")
            for master, factor in factors.items():
                _check_moves(key, master, joints, moving, urdf)
                if factor == 0.0:
                    raise RobotError(f"{key}.{shortened(master)}: a factor of 0 follows nothing. Delete this joint")


NO_STATEMENTS = StatedJoints()
"""Every joint has a column, or a ``<mimic>``."""


def _check_moves(key: str, name: str, joints: Collection[str], moving: Collection[str], urdf: str) -> None:
    """Refuse the name of no joint that moves."""
    if name not in joints:
        raise RobotError(f"{key}: {urdf} has no joint {shortened(name)!r}{nearest(name, moving)}. Write one that moves")
    if name not in moving:
        raise RobotError(f"{key}: joint {name!r} of {urdf} does not move{nearest(name, moving)}. Write one that does")


class Loop(Exception):
    """A joint follows itself."""

    def __init__(self, first: str, by: str) -> None:
        self.first, self.by = first, by
        super().__init__(first, by)


def resolved(direct: Mapping[str, Drive]) -> dict[str, Drive]:
    """Drives whose masters follow no other joint any more.

    Args:
        direct: Of all joints that follow others or stand still.

    Raises:
        Loop: a joint follows itself, by way of others or not.
    """
    drives: dict[str, Drive] = {}
    for first in direct:
        path = {} if first in drives else {first: None}
        while path:
            name = next(reversed(path))
            above = next((m for m in direct[name].factors if m in direct and m not in drives), None)
            if above is None:
                drives[name] = direct[name].of(drives)
                del path[name]
            elif above in path:
                raise Loop(first, above)
            else:
                path[above] = None
    return drives
