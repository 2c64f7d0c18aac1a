"""Other numbers for a program's targets, with which the real arm comes to where the nominal one would.

A target of joints q stands for the place T_nominal(q) of the tip, as whoever programmed it offline saw it. A pose P stands for
base P tool^-1; the controller finds q for it with the nominal arm. Either way the wanted place W of the tip is known, and the
joints q' that bring the real one there follow from the calibrated model: T_real(q') = W. Joints are replaced by q'; a pose by the
one for which the controller finds q': base^-1 T_nominal(q') tool.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from aridcal.errors import CovariateNotFound
from aridcal.inputs.approach import approach
from aridcal.inputs.query import Query
from aridcal.model.inverse import Command, InverseKinematics
from aridcal.model.one_row import OneRowModel
from aridcal.programs.axes import axes_of
from aridcal.programs.branches import controller, flange, holding, positions_of_arm
from aridcal.programs.notations import inverse
from aridcal.programs.postures import posture_of
from aridcal.programs.targets import Branch, Number, Target, written
from aridcal.result.compensate import STILL
from aridcal.result.predict import at_any_station, directions, extrapolates, std_of
from aridcal.result.saved_model import SavedModel

BEYOND = "is beyond what was measured for the calibration"

UNREACHED = "cannot be reached within the joint limits"

SINGULAR = "is close to a singularity: corrected as far as small motions of the joints can"

PARTLY = "does not state all axes: corrected as far as those can that it states"

OTHERWISE = (
    "CONFIG names a position that the nominal arm does not have there, the nearest was taken: check base, tool and URDF"
)

SEEN = 1e-6
"""[m]: what remains of an error where axes are missing is said from here on; the rounding of the numbers leaves as much."""

GENTLE = 0.2
"""[rad] or [m]: an arm whose elbow is nearly straight bends it by so much for 2 cm; a correction that moves a joint further goes
round a singularity, and the arm would swing there between two targets."""

DAMPINGS = np.logspace(-4, 0, 9)
"""[m/rad]: tried one after the other until no joint moves further."""

SAME = 1e-3
"""[rad] or [m]: readings that differ by more are another position of the arm."""

WORTH = 0.5
"""A correction that is not whole is made where it leaves less than half of the error."""

DIGITS = 6
"""Of millimetres and milliradians in the side table: a nanometre, which nobody reads past."""

NOWHERE = "the nominal arm does not get there: it is out of reach, or base, tool or tip are others"

LEVER = 1.0
"""[m]: where positions alone were measured, a turn of the tip counts as so much as it moves a tool of this length."""


@dataclass(frozen=True)
class Correction:
    """What becomes of one target.

    Attributes:
        target: As it stands in the program.
        why: Why it is left as it is; empty where it is corrected.
        remark: What is to be known of a correction.
        texts: New numbers, as they are written.
        moved: By how much the place that the controller is told is moved, [m] and [rad].
        before: How far the real tip would be from its place as the program is, [m] and [rad].
        after: How far it will be, rounding included, [m] and [rad].
        positions: Positions of the arm that agree with the program; the nearest to the target before is taken.
        doubt: How much the correction would differ with another of them, [m].
    """

    target: Target
    why: str = ""
    remark: str = ""
    texts: tuple[str, ...] = ()
    moved: tuple[float, float] = (np.nan, np.nan)
    before: tuple[float, float] = (np.nan, np.nan)
    after: tuple[float, float] = (np.nan, np.nan)
    positions: int = 1
    doubt: float = 0.0

    @property
    def changes(self) -> list[tuple[Number, str]]:
        """Numbers of the text and what stands there now."""
        return list(zip(self.target.numbers, self.texts, strict=True)) if not self.why else []


@dataclass(frozen=True)
class _Arm:
    """The real arm beside the nominal one, both from base to tip, at given covariates.

    Attributes:
        saved: The calibration.
        covariates: Of the effects, the directions of approach left out.
    """

    saved: SavedModel
    covariates: Mapping[str, float]

    @cached_property
    def nominal(self) -> InverseKinematics:
        """What the controller works with."""
        return controller(self.saved.final.model.robot)

    @cached_property
    def real(self) -> InverseKinematics:
        """The calibrated arm with its effects; wanted poses are those of the target in the world."""
        robot = self.saved.final.model.robot
        noise = self.saved.noise if self.saved.kind == "pose" else (self.saved.noise[0], self.saved.noise[0] / LEVER)
        model = OneRowModel(self.saved.final.model, self.saved.final.theta, self.station)
        low, high = robot.limits.T
        return InverseKinematics(model, low, high, self.nominal.turning, True, noise)

    @cached_property
    def station(self) -> str | None:
        model = self.saved.final.model
        return next((label for label, _ in (*model.world_base, *model.tip_target) if label is not None), None)

    @cached_property
    def _frames(self) -> tuple[np.ndarray, np.ndarray]:
        """T_world_base and T_tip_target as calibrated: the same before and after, so that they matter to the weighing alone."""
        world, tip = self.saved.final.model.frames(self.saved.final.theta)
        first = [next(T for label, T in frames if label in (None, self.station)) for frames in (world, tip)]
        return np.asarray(first[0].homogeneous), np.asarray(first[1].homogeneous)

    def target(self, wanted: np.ndarray) -> np.ndarray:
        """T_world_target with the tip at T_base_tip."""
        base, target = self._frames
        return np.asarray(base @ wanted @ target)

    def command(
        self, wanted: np.ndarray, q: np.ndarray, sides: Mapping[str, float], held: np.ndarray | None
    ) -> Command:
        """Readings that bring the real tip to T_base_tip."""
        T = self.target(wanted)
        return holding(self.real, held).command(T[:3, :3], T[:3, 3], q, {**self.covariates, **sides})

    def nearby(
        self, wanted: np.ndarray, q: np.ndarray, sides: Mapping[str, float], held: np.ndarray | None
    ) -> tuple[np.ndarray, str]:
        r"""Readings near others that bring the real tip to T_base_tip, and a remark where that is not wholly to be had.

        Close to a singularity, damped least squares with the least damping :math:`\lambda` that keeps the joints near,

        .. math:: \delta q = J^T (J J^T + \lambda^2)^{-1} e
        """
        command = self.command(wanted, q, sides, held)
        if command.reached and np.abs(command.readings - q).max() < GENTLE and self._same_side(command.readings, q):
            return command.readings, ""
        T, values = self.target(wanted), {**self.covariates, **sides}
        own = holding(self.real, held)
        e, J = own.error(T[:3, :3], T[:3, 3], q, values)
        J = J * (own.low < own.high)
        for damping in DAMPINGS:
            step = J.T @ np.linalg.solve(J @ J.T + damping**2 * np.eye(len(J)), e)
            there = np.clip(q + step, own.low, own.high)
            if np.abs(there - q).max() < GENTLE:
                left, _ = own.error(T[:3, :3], T[:3, 3], there, values)
                return (there, SINGULAR) if np.linalg.norm(left) < WORTH * np.linalg.norm(e) else (q, UNREACHED)
        return q, UNREACHED

    def _same_side(self, q: np.ndarray, start: np.ndarray) -> bool:
        """Whether the controller, coming from a start, stands as wanted, and no elbow has gone through its singularity."""
        T = flange(self.saved.final.model.robot, q)
        found = self.nominal.command(T[:3, :3], T[:3, 3], start, {})
        return found.reached and float(np.abs(found.readings - q).max()) < SAME

    def miss(self, wanted: np.ndarray, q: np.ndarray, sides: Mapping[str, float]) -> tuple[float, float]:
        """How far the real target is from where it should be, [m] and [rad]."""
        T = self.target(wanted)
        e, _ = self.real.error(T[:3, :3], T[:3, 3], q, {**self.covariates, **sides})
        return float(np.linalg.norm(e[:3])), float(np.linalg.norm(e[3:])) / self.real.lever


def correct(
    saved: SavedModel,
    targets: Sequence[Target],
    covariates: Mapping[str, float],
    start: np.ndarray | None = None,
    told: Callable[[int], None] = lambda done: None,
) -> list[Correction]:
    """Correct the targets of a program, one after the other: each starts where the one before has come to.

    Args:
        saved: The calibration.
        targets: In the order in which the robot goes there.
        covariates: What effects depend on beside the joints: temperature, for instance.
        start: Readings where the program begins, shape (columns,), [rad] or [m]; default: the middle of what was measured.
        told: Called with the number of targets that are done.

    Raises:
        CovariateNotFound: an effect depends on something that is not given.
    """
    arm = _Arm(saved, covariates)
    missing = [n for n in at_any_station(saved).model.needs if n not in covariates and n not in directions(saved)]
    if missing:
        raise CovariateNotFound(f"the model depends on {missing[0]!r}: state it, as in --at {missing[0]}=VALUE")
    middle = np.array([np.mean(saved.ranges.get(name, (0.0, 0.0))) for name in saved.final.model.robot.readings])
    walk = _Walk(arm, middle if start is None else start)
    found = []
    for done, target in enumerate(targets):
        told(done)
        found.append(walk.go(target))
    return found


class _Walk:
    """Targets one after the other.

    Args:
        arm: That goes there.
        start: Where it begins.
    """

    def __init__(self, arm: _Arm, start: np.ndarray) -> None:
        self._arm, self._robot = arm, arm.saved.final.model.robot
        self._posture = posture_of(self._robot, axes_of(self._robot.kinds))
        self._nominal = start  # where the controller believes that the arm is
        self._sent = start  # where the joints are sent with the corrections
        self._sides = dict.fromkeys(directions(arm.saved), 0.0)

    def go(self, target: Target) -> Correction:
        """Correct one more target."""
        if target.why:
            return Correction(target, target.why)
        return self._joints(target) if target.form == "joints" else self._pose(target)

    def _joints(self, target: Target) -> Correction:
        assert target.readings is not None
        q = np.where(np.isfinite(target.readings), target.readings, self._nominal)
        wanted = flange(self._robot, q)
        free = np.isin(np.arange(len(q)), [k for _, k in target.units])
        sides = self._approached(q)
        real, remark = self._arm.nearby(wanted, q, sides, np.where(free, np.nan, self._sent))
        texts = []
        sent = np.where(free, q, self._sent)
        for n, digits, (unit, k) in zip(target.numbers, target.places, target.units, strict=True):
            texts.append(written(n.value + (real[k] - q[k]) / unit, n.text, digits))
            sent[k] = q[k] + (float(texts[-1]) - n.value) * unit
        as_is = np.where(free, q, self._sent)
        moved = _apart(flange(self._robot, sent), flange(self._robot, as_is))
        after = self._arm.miss(wanted, sent, sides)
        if not free.all() and self._arm.miss(wanted, real, sides)[0] > SEEN:
            remark = remark if remark == UNREACHED else PARTLY
        found = Correction(
            target, self._left(real, remark, sides), remark, tuple(texts), moved,
            self._arm.miss(wanted, as_is, sides), after,
        )  # fmt: skip
        self._nominal, self._sent = q, (as_is if found.why else sent)
        return found

    def _pose(self, target: Target) -> Correction:
        assert target.notation is not None and target.base is not None and target.tool is not None
        told = target.base @ target.notation.pose(target.values)
        wanted = told @ inverse(target.tool)
        stands, settled, odd = self._stands(wanted, target.branch)
        if not stands:
            return Correction(target, NOWHERE)
        q, others = stands[0], [] if settled else stands[1:]
        sides = self._approached(q)
        real, remark = self._arm.nearby(wanted, q, sides, target.branch.held)
        remark = remark or odd
        new = self._posed(target, real)
        values = target.notation.numbers(new, target.values)
        texts = tuple(
            written(value, n.text, digits)
            for value, n, digits in zip(values, target.numbers, target.places, strict=True)
        )
        as_read = target.base @ target.notation.pose(np.array([float(text) for text in texts])) @ inverse(target.tool)
        near = Branch(near=q, held=target.branch.held, settled=True)
        sent = next(iter(positions_of_arm(self._arm.nominal, as_read, near, q)), q)
        found = Correction(
            target, self._left(real, remark, sides), remark, texts, _apart(target.base @ new, told),
            self._arm.miss(wanted, q, sides), self._arm.miss(wanted, sent, sides),
            len(stands), max((self._differs(target, wanted, new, other, sides) for other in others), default=0.0),
        )  # fmt: skip
        self._nominal, self._sent = q, (q if found.why else sent)
        return found

    def _stands(self, wanted: np.ndarray, branch: Branch) -> tuple[list[np.ndarray], bool, str]:
        """How the arm may stand at T_base_tip, whether that is known, and a remark."""
        posture, letters = self._posture, branch.letters
        if posture is None or not letters:
            return positions_of_arm(self._arm.nominal, wanted, branch, self._nominal), branch.settled, ""
        known = replace(
            branch,
            fits=lambda q: branch.fits(q) and posture.fits(letters, q),
            settled=branch.settled or posture.decides(letters),
        )
        found = positions_of_arm(self._arm.nominal, wanted, known, self._nominal)
        if found:
            return found, known.settled, ""
        found = positions_of_arm(self._arm.nominal, wanted, branch, self._nominal)
        return found, branch.settled, f"{OTHERWISE} ({' '.join(letters)})"

    def _posed(self, target: Target, q: np.ndarray) -> np.ndarray:
        """The pose in the program's frame for which the controller finds readings."""
        assert target.base is not None and target.tool is not None
        return np.asarray(inverse(target.base) @ flange(self._robot, q) @ target.tool)

    def _differs(
        self, target: Target, wanted: np.ndarray, new: np.ndarray, other: np.ndarray, sides: Mapping[str, float]
    ) -> float:
        """How much a correction would differ if the arm stood otherwise, [m]."""
        real, _ = self._arm.nearby(wanted, other, sides, target.branch.held)
        return _apart(self._posed(target, real), new)[0]

    def _approached(self, q: np.ndarray) -> dict[str, float]:
        """From which side each joint comes that has to do with it."""
        for name in self._sides:
            k = self._robot.readings.index(self._robot.joint(name.removesuffix("_direction")).reading)
            self._sides[name] = float(approach(q[k : k + 1], STILL, self._sides[name], float(self._nominal[k]))[0])
        return self._sides

    def _left(self, real: np.ndarray, remark: str, sides: Mapping[str, float]) -> str:
        """Why a target is left as it is; empty if it is not."""
        if remark == UNREACHED:
            return remark
        known = {name: np.array([value]) for name, value in {**self._arm.covariates, **sides}.items()}
        line, usable = np.ones(1, dtype=int), np.ones(1, dtype=bool)
        station = None if self._arm.station is None else np.array([self._arm.station])
        query = Query(pd.DataFrame(), real[None], None, None, known, station, line, usable, (), ())
        return BEYOND if extrapolates(self._arm.saved, query, std_of(self._arm.saved, query))[0] else ""


def _apart(A: np.ndarray, B: np.ndarray) -> tuple[float, float]:
    """How far two poses are from each other, [m] and [rad]."""
    R = A[:3, :3].T @ B[:3, :3]
    turn = np.arctan2(np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]), np.trace(R) - 1.0)
    return float(np.linalg.norm(A[:3, 3] - B[:3, 3])), float(turn)


def as_table(corrections: Sequence[Correction]) -> pd.DataFrame:
    """The corrections of each move, one row a target; millimetres and milliradians."""
    return pd.DataFrame(list(_rows(corrections)))


def _rows(corrections: Sequence[Correction]) -> Iterator[dict[str, object]]:
    for c in corrections:
        yield {
            "line": c.target.line,
            "target": c.target.name,
            "written_as": c.target.form,
            "corrected": not c.why,
            "remark": c.why or c.remark,
            "moved_mm": round(1e3 * c.moved[0], DIGITS) if not c.why else 0.0,
            "turned_mrad": round(1e3 * c.moved[1], DIGITS) if not c.why else 0.0,
            "error_before_mm": round(1e3 * c.before[0], DIGITS),
            "error_before_mrad": round(1e3 * c.before[1], DIGITS),
            "error_after_mm": round(1e3 * (c.before if c.why else c.after)[0], DIGITS),
            "error_after_mrad": round(1e3 * (c.before if c.why else c.after)[1], DIGITS),
            "arm_positions": c.positions,
            "other_position_mm": round(1e3 * c.doubt, DIGITS),
        }
