"""What a kind of effect is: one row that campaigns, search, simulator, report and documents ask."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.levels import SLIGHT, STILL
from aridcal.engine.robot.chain import Joint, Robot

MOVED_ANGLE = 1e-2
"""[rad] of a joint: over less, any effect of it is a constant."""

LEAST_KNOTS = 4
"""Work: A smooth function of fewer knots than a cubic has coefficients would be no smoother than a cubic."""


class Declaration(Protocol):
    """An effect as a campaign or a scenario states it; what is not stated is None.

    Attributes:
        kind: Of the table of kinds.
        where: A joint of the chain, ``world_base`` or ``tip_target``; ``camera`` or a sonar of a measuring head.
        with_: The other joint of a coupling.
        by: What a backlash switches with, or over what a constant varies.
        order: Periods in one turn of the joint.
        motion: Components that move.
        covariates: Columns that it depends on.
        at: Row or time of the first measurement after it.
    """

    kind: str
    where: str
    with_: str | None
    by: str | None
    order: tuple[float, ...] | None
    motion: tuple[str, ...] | None
    covariates: tuple[str, ...] | None
    at: Any  # of a campaign a `Moment`


@dataclass(frozen=True)
class ObservedRows:
    """The rows that effects are to be tested on.

    Attributes:
        robot: The chain.
        table: Covariates of those rows (see :func:`aridcal.engine.corrections.loads.covariate_table`), shape (N,) each.
        measured: Names of the columns beside the joints that are complete and not constant.
        orientations: False where only positions were measured: the target's own turns are not seen then.
        stated_components: What is taken as stated of each thing that measurements refer to, by the names of its role and its own.
            own.
        referred: Different configurations of the rows that refer to each of those things.
        labels: Covariates of the rows' labels (see :mod:`aridcal.engine.corrections.labels`).
        masses: Covariates of the payloads.
    """

    robot: Robot
    table: Mapping[str, np.ndarray]
    measured: tuple[str, ...]
    orientations: bool = True
    stated_components: Mapping[tuple[str, str], tuple[str, ...]] = field(default_factory=dict)
    referred: Mapping[tuple[str, str], int] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    masses: tuple[str, ...] = ("payload",)

    def moves(self, joint: Joint) -> bool:
        """True if the joint's reading covers enough to say anything about it."""
        travel = float(np.ptp(self.table[joint.name]))
        return travel > (MOVED_ANGLE if joint.kind == "revolute" else STILL)

    def moving(self, kind: str = "") -> Iterator[Joint]:
        """Joints that moved; of one kind, if it is given."""
        return (j for j in self.robot.joints if kind in ("", j.kind) and self.moves(j))

    def varying(self) -> list[str]:
        """All readings and measured columns that vary."""
        return [j.name for j in self.moving()] + list(self.measured)

    def load_changes(self, name: str) -> bool:
        """True if a load is there and changes."""
        load = self.table.get(name)
        if load is None:
            return False
        largest = float(np.abs(load).max())
        return float(np.ptp(load)) > SLIGHT * max(1.0, largest)

    def columns(self, prefix: str) -> tuple[str, ...]:
        """Measured columns whose name is the prefix, or the prefix with a suffix."""
        return tuple(n for n in self.measured if n == prefix or n.startswith(f"{prefix}_"))


@dataclass(frozen=True)
class EffectKind:
    """One row of the table of kinds. Whatever is to be known of a kind stands here, and nowhere else.

    Attributes:
        name: As in campaigns, results and messages.
        where: Where it acts, in words.
        words: What it is, in words, as the report says it.
        bases: Forms of its bases, keys of :data:`aridcal.engine.corrections.basis.FORMS`; ``1`` for constants.
        example: An entry of a campaign's ``effects`` that declares it, YAML.
        doc: Anchor of its section in ``docs/effects.md``.
        testable: Yields every effect of this kind that some rows can test; what they cannot show is not yielded.
        of_head: Part of a measuring head that it is of; empty for all else.
        key: Key of a declaration that belongs to this kind alone: ``with``, which it then needs, ``by`` or ``at``.
        bys: Words that ``by`` may be; empty where it names something else, which it then needs.
        of_order: Effects that a declaration with ``order`` means, where any order may be declared: the generator can
            yield only some.
        of_declaration: The effect that any declaration means, where the generator yields only some.
        on_request: True for what is sought only where a campaign names it.
        exclusive: True if the effects of this kind at one place are alternatives, the most likely first. A declaration
            means the first that fits; of any other kind it means all of them together.
        columns: Columns beside the joints that a declared effect depends on, for the simulator to draw.
        curve: Motions that it may have where it is a smooth function; empty where it is none.
        holds: Kinds whose effects at the same joint are special cases of this one.
        named: False for what stands in where no cause is known: sought only in what the others leave.
        shown: What it depends on, for the results, where its coefficients depend on no covariate.
    """

    name: str
    where: str
    words: str
    bases: tuple[str, ...]
    example: str
    doc: str
    testable: Callable[[ObservedRows], Iterator[Effect]]
    of_head: Literal["", "camera", "sonar"] = ""
    key: Literal["with", "by", "at"] | None = None
    bys: tuple[str, ...] = ()
    of_order: Callable[[Declaration, float], Iterator[Effect]] | None = None
    of_declaration: Callable[[ObservedRows, Declaration], Iterator[Effect]] | None = None
    on_request: bool = False
    exclusive: bool = False
    columns: Callable[[Declaration], tuple[str, ...]] = lambda _: ()
    curve: tuple[str, ...] = ()
    holds: frozenset[str] = frozenset()
    named: bool = True
    shown: tuple[str, ...] = ()


def slope(where: str, component: str, of: str, centre: float = 0.0) -> Coefficient:
    """A motion in proportion to a covariate's distance from a centre."""
    return Coefficient(where, component, Basis("linear", (of,), (centre,)))


def rounded_mean(values: np.ndarray) -> float:
    """The mean of a covariate, rounded so that a basis made from it reads back from a file."""
    return round(float(np.mean(values)), 9)


def turns(where: str, component: str, of: str, order: float) -> tuple[Coefficient, ...]:
    """Sine and cosine of a joint's reading, ``order`` periods in a turn."""
    return tuple(Coefficient(where, component, Basis(form, (of,), (order,))) for form in ("sin", "cos"))


def bumps(where: str, component: str, of: str, values: np.ndarray, knots: int) -> tuple[Coefficient, ...]:
    """A smooth function of a covariate as a motion.

    Args:
        where: A joint of the chain, ``world_base`` or ``tip_target``.
        component: The one that moves.
        of: Name of the covariate; see :func:`knots_over`.
        values: Of the covariate, shape (N,).
        knots: The most there may be.
    """
    return tuple(Coefficient(where, component, basis) for basis in knots_over(of, values, knots))


def knots_over(of: str, values: np.ndarray, knots: int) -> tuple[Basis, ...]:
    """A smooth function of a covariate: cubic B-splines on evenly spaced knots over the range seen.

    Args:
        of: Name of the covariate.
        values: Of the covariate, shape (N,).
        knots: The most there may be; there is one for every two different values, and three more beyond each end, over
            which the function goes back to zero.
    """
    low, high = float(values.min()), float(values.max())
    different = len(np.unique(np.round(values, 6)))
    count = int(np.clip(different // 2, LEAST_KNOTS, knots))
    step = (high - low) / (count - 1)
    return tuple(Basis("bump", (of,), (low + k * step, step)) for k in range(-3, count + 3))
