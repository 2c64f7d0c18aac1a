"""What a coefficient multiplies: where x component x basis, the one form of every correction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from itertools import groupby
from operator import attrgetter

import numpy as np

from aridcal.engine.corrections.basis import CONSTANT, Basis, basis_name
from aridcal.engine.corrections.labels import LABEL_COLUMN
from aridcal.engine.corrections.smooth import Nodes, Shape, SmoothPart
from aridcal.engine.robot.kinematics import transverse

MOUNTING_FRAMES = ("world_base", "tip_target")
"""Where a mounting is, which every campaign has anew, and not the robot."""

FRAME_COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")
LINK_COMPONENTS = ("d", "theta", "beta", "a", "alpha")
ROW_ORDER = "file row"
"""Covariate that every table has: the line of the file, counted on through several files."""

ANGULAR = frozenset({"roll", "pitch", "yaw", "theta", "beta", "alpha", "r1", "r2"})


@dataclass(frozen=True, init=False)
class Coefficient:
    """One unknown of the model: a basis times a small motion somewhere.

    Attributes:
        where: A joint of the chain, the tip's fixed joint, ``world_base`` or ``tip_target``.
        component: ``x y z roll pitch yaw``; ``axis t1 t2 r1 r2`` of a joint; ``theta beta a alpha d`` of its link.
        basis: What it is multiplied with, row by row.
        station: For one frame per station: the label of the rows that it moves.
    """

    where: str
    component: str
    basis: Basis = CONSTANT
    station: str | None = None

    def __init__(self, where: str, component: str, basis: Basis = CONSTANT, station: str | None = None) -> None:
        """Hold what is given: a search makes ten thousand, in half the time that the generated method takes."""
        vars(self).update(where=where, component=component, basis=basis, station=station)

    @cached_property
    def name(self) -> str:
        """The same string in tables, files and messages, ``joint_2.pitch`` for instance."""
        label = "" if self.station is None else f"[{self.station}]"
        tail = "" if self.basis.always else f":{basis_name(self.basis).replace(f'{self.where}.', '')}"
        return f"{self.where}{label}.{self.component}{tail}"


@dataclass(frozen=True)
class Effect:
    """One cause of error: a kind, a place, and the coefficients that describe it (FORMATS section 4).

    Attributes:
        kind: Of the table of kinds.
        where: A joint of the chain, ``world_base`` or ``tip_target``.
        coefficients: One for each motion and basis.
        order: Periods per turn, for harmonics and wobble.
        with_: The other joint of a coupling.
        by: What a backlash switches with; over what a constant varies.
        smooth: True where the coefficients are samples of a smooth function and shrink to zero where unseen.
        grid: For a smooth function of two covariates: samples along each; else empty.
        looked: Members of its kind that were looked through before this one, the loudest, became a candidate.
    """

    kind: str
    where: str
    coefficients: tuple[Coefficient, ...]
    order: tuple[float, ...] = ()
    with_: str | None = None
    by: str | None = None
    smooth: bool = False
    grid: tuple[int, ...] = ()
    looked: int = 1

    def __hash__(self) -> int:
        """Hash of the contents, computed once: searches look effects up millions of times."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        # Of curves of dozens of coefficients the ends: those that differ in between alone are rare, and are compared.
        shape = self.order, self.with_, self.by, self.smooth, self.grid, self.looked, len(self.coefficients)
        return hash((self.kind, self.where, self.coefficients[:1], self.coefficients[-1:], shape))

    def __getstate__(self) -> dict[str, object]:
        """The fields without the hash: another process hashes strings otherwise."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def hinted(self) -> bool:
        """True for a member that the residual hinted at, beside those that are always tried."""
        return self.looked > 1

    @cached_property
    def shape(self) -> Shape:
        """Samples of its smooth functions: one for each motion and covariate."""
        functions = groupby(self.coefficients, attrgetter("component", "basis.of"))
        return tuple(self._samples([c.basis for c in group]) for _, group in functions)

    def _samples(self, bases: Sequence[Basis]) -> SmoothPart:
        if bases[0].form == "ball":
            x, y, z, radii = np.array([basis.numbers for basis in bases]).T
            return Nodes(tuple(zip(*(np.round(of / radii, 9).tolist() for of in (x, y, z)), strict=True)))
        return self.grid or (len(bases),)

    @cached_property
    def slots(self) -> tuple[tuple[str, str], ...]:
        """Places and components that move, each pair once."""
        return tuple(dict.fromkeys((c.where, c.component) for c in self.coefficients))

    @property
    def motion(self) -> tuple[str, ...]:
        """Components that move, each once."""
        return tuple(dict.fromkeys(c.component for c in self.coefficients))

    @property
    def covariates(self) -> tuple[str, ...]:
        """Columns it depends on, each once; none of what is the same in all rows."""
        of = ((LABEL_COLUMN,) if c.basis.form == "label" else c.basis.of for c in self.coefficients)
        return tuple(dict.fromkeys(name for names in of for name in names))

    @cached_property
    def at(self) -> Basis | None:
        """The step of what happened between two rows; None of what always acts."""
        return next((c.basis for c in self.coefficients if c.basis.form == "step"), None)

    def placed(self, number: float) -> Effect:
        """The effect with its step at another value of its covariate."""
        coefficients = tuple(replace(c, basis=replace(c.basis, numbers=(number,))) for c in self.coefficients)
        return replace(self, coefficients=coefficients)

    @property
    def identity(self) -> tuple[object, ...]:
        """What makes two effects the same for a user: two steps at one place are two effects."""
        return self.kind, self.where, self.with_, self.by, self.at

    @property
    def label(self) -> str:
        """Short name for tables and messages."""
        extra = self.with_ or self.by or (",".join(f"{k:g}" for k in self.order) if self.order else "")
        if self.at is not None:
            extra = _moment(self.at)
        return f"{self.kind} at {self.where}" + (f" ({extra})" if extra else "")


def _moment(step: Basis) -> str:
    """Where a step is: the first row after it, or the time."""
    (of,), (number,) = step.of, step.numbers
    return f"row {math.ceil(number)}" if of == ROW_ORDER else f"{of} {number:.6g}"


def direction(component: str, axis: np.ndarray | None) -> np.ndarray:
    """Unit vector along or about which a component moves, shape (3,).

    Args:
        component: ``x y z roll pitch yaw`` of a frame, or ``t1 t2 r1 r2`` across a joint's axis.
        axis: Of the joint, in its own frame, shape (3,); a frame's components need none.
    """
    return _direction(component, None if axis is None else tuple(axis.tolist()))


@cache
def _direction(component: str, axis: tuple[float, ...] | None) -> np.ndarray:
    """:func:`direction`, computed once for each axis: models are made by the hundred, and move along a few."""
    if component in FRAME_COMPONENTS:
        vector = np.eye(3)[FRAME_COMPONENTS.index(component) % 3]
    else:
        assert axis is not None
        vector = transverse(np.array(axis))[int(component[1]) - 1]
    vector.flags.writeable = False
    return vector
