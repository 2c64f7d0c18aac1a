"""Other numbers for a program's targets, with which the real arm comes to where the nominal one would.

A target of joints q stands for the place T_nominal(q) of the tip, as whoever programmed it offline saw it. A pose P stands for
base P tool^-1; the controller finds q for it with the nominal arm. Either way the wanted place W of the tip is known, and the
joints q' that bring the real one there follow from the calibrated model: T_real(q') = W. Joints are replaced by q'; a pose by the
one for which the controller finds q': base^-1 T_nominal(q') tool, its posture in words by that of q'.

Targets are worked out some thousand at a time, in arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aridcal.engine.instruments.pose import rotation_vector
from aridcal.engine.inverse.many_poses import ArmRows, InverseRows
from aridcal.engine.inverse.one_pose import FINEST_NOISE, MOST_UNAVOIDABLE
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.approach import approach
from aridcal.files.query import QueryRows
from aridcal.jobs.apply.joint_commands import LEAST_BACKLASH_MOTION
from aridcal.jobs.apply.programs.branches import FIRST_BRANCHES, STARTS, Chain, Controller, Memory, Poses, flanges
from aridcal.jobs.apply.programs.corrections import Corrections, joined_corrections, no_corrections
from aridcal.jobs.apply.programs.notations import inverse
from aridcal.jobs.apply.programs.targets import Notation, PoseReference, Target
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, NUL, written
from aridcal.jobs.apply.target_poses import directions, extrapolates, needed_of, std_of
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import CovariateNotFound

BEYOND_MEASURED = "is beyond what was measured for the calibration"

UNREACHED = "cannot be reached within the joint limits"

SINGULAR = "is close to a singularity: corrected as far as small motions of the joints can"

PARTLY = "does not state all axes: corrected as far as those can that it states"

NOT_NOMINAL = "the nominal arm does not get there: it is out of reach, or base, tool or tip are others"

LIMITED = (
    "the nominal arm gets there beyond its joint limits only: it is out of reach, or base, tool or limits are others"
)

NO_SUCH_POSTURE = "is none that the nominal arm has there"

WORDLESS = "its posture once corrected has no words in this language"

ELSEWHERE = "its posture once corrected is shared with another position of the arm, nearer to where it comes from"

OTHER_SIDE = "is stated for all of them alike, and this one stands otherwise than the first, or would once corrected"

TOO_LARGE = "its numbers once corrected are larger than those of any arm"

SEEN = 1e-6
"""[m]: what remains of an error where axes are missing is said from here on; the rounding of the numbers leaves as much."""

GENTLE = 0.2
"""[rad] or [m]: an arm whose elbow is nearly straight bends it by so much for 2 cm; a correction that moves a joint further goes
round a singularity, and the arm would swing there between two targets."""

DAMPINGS = np.logspace(-4, 0, 9)
"""[m/rad]: tried one after the other until no joint moves further."""

OTHER_POSITION = 1e-3
"""[rad] or [m]: readings that differ by more are another position of the arm."""

WORTH = 0.5
"""A correction that is not whole is made where it leaves less than half of the error."""

TIP_LEVER = 1.0
"""[m]: where positions alone were measured, a turn of the tip counts as so much as it moves a tool of this length."""

ALSO_A_CONSTANT = "is also used a constant way off, where its correction is right in part only"

BESIDE_WORSE = (
    "is also used a constant way off, where its correction would leave more than half of the error: give each a point"
)

BESIDE_NOWHERE = "is also used a constant way off, where the nominal arm does not get: give each place its own point"

UNSETTLED = "its correction depends on how the arm stands there: give --start J1,J2,…, or a joint target before it"

TARGETS_AT_ONCE = 2_000
"""Targets that are worked out together: all that is made on the way takes some megabytes, and a program of any length no more."""


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
    def controller(self) -> Controller:
        """What the controller works with: the nominal arm."""
        return Controller(self.saved.final.model.robot)

    @cached_property
    def real(self) -> InverseRows:
        """The calibrated arm with its effects; wanted poses are those of the target in the world."""
        expected, nominal = self.saved.expected, self.controller.inverse
        lever = self.saved.noise[0] / self.saved.noise[1] if self.saved.turns else TIP_LEVER
        return InverseRows(
            ArmRows(expected.model, expected.theta, *self.labels), nominal.low, nominal.high, nominal.turning, lever
        )

    @cached_property
    def labels(self) -> tuple[str | None, str | None]:
        """Labels of the first frames, where there are several: what base and target are is the same before and after."""
        return self.saved.final.model.first_labels

    @cached_property
    def _frames(self) -> tuple[np.ndarray, np.ndarray]:
        """T_world_base and T_tip_target as calibrated: the same before and after, so that they matter to the weighing alone."""
        world, tip = self.saved.expected.model.frames(self.saved.expected.theta)
        first = [next(T for label, T in frames if label in (None, *self.labels)) for frames in (world, tip)]
        return np.asarray(first[0].homogeneous), np.asarray(first[1].homogeneous)

    @cached_property
    def _allowed(self) -> tuple[float, float]:
        """What a pose may be missed by that counts as reached, [m] and [rad] times the lever."""
        lean = len(self.real.low) < 6
        noise = self.saved.noise[0], self.saved.noise[1] if self.saved.turns else self.saved.noise[0] / TIP_LEVER
        position, rotation = (MOST_UNAVOIDABLE if lean else max(sigma, FINEST_NOISE) for sigma in noise)
        return position, rotation * self.real.lever

    def target(self, wanted: np.ndarray) -> np.ndarray:
        """T_world_target with the tip at T_base_tip, shape (n, 4, 4)."""
        base, target = self._frames
        return np.asarray(base @ wanted @ target)

    def values(self, sides: Mapping[str, np.ndarray], n: int) -> dict[str, np.ndarray]:
        """All covariates of n targets."""
        given = self.saved.assumed | dict(self.covariates)
        return {name: np.full(n, value) for name, value in given.items()} | dict(sides)

    def nearby(
        self, wanted: np.ndarray, q: np.ndarray, sides: Mapping[str, np.ndarray], fixed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        r"""Readings near others that bring the real tip to T_base_tip, and a remark for each where that is not wholly to be had.

        Close to a singularity, damped least squares with the least damping :math:`\lambda` that keeps the joints near,

        .. math:: \delta q = J^T (J J^T + \lambda^2)^{-1} e
        """
        values, T = self.values(sides, len(q)), self.target(wanted)
        end = self.real.approach(T, q, fixed, values)
        position, rotation = (np.linalg.norm(end.error[:, part], axis=1) for part in (slice(3), slice(3, 6)))
        whole = (position < self._allowed[0]) & (rotation < self._allowed[1])
        whole &= np.abs(end.readings - q).max(axis=1, initial=0.0) < GENTLE
        whole[whole] = self._same_side(end.readings[whole], q[whole], fixed[whole])
        readings, remarks = end.readings.copy(), np.full(len(q), "", dtype=object)
        some = ~whole
        if some.any():
            own = {name: value[some] for name, value in values.items()}
            readings[some], remarks[some] = self._damped(T[some], q[some], fixed[some], own)
        return readings, remarks

    def _damped(
        self, T: np.ndarray, q: np.ndarray, fixed: np.ndarray, values: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """One damped step for each target, and what is said of it."""
        e, J = self.real.error(T, q, values)
        J = J * (np.isnan(fixed) & (self.real.low < self.real.high))[:, None]
        back, H = J.transpose(0, 2, 1), J @ J.transpose(0, 2, 1)
        there, gentle = q.copy(), np.zeros(len(q), dtype=bool)
        for damping in DAMPINGS:
            step = (back @ np.linalg.solve(H + damping**2 * np.eye(6), e[:, :, None]))[:, :, 0]
            trial = np.where(np.isnan(fixed), np.clip(q + step, self.real.low, self.real.high), fixed)
            new = ~gentle & (np.abs(trial - q).max(axis=1, initial=0.0) < GENTLE)
            there[new], gentle = trial[new], gentle | new
        remaining, _ = self.real.error(T, there, values)
        worth = gentle & (np.linalg.norm(remaining, axis=1) < WORTH * np.linalg.norm(e, axis=1))
        return np.where(worth[:, None], there, q), np.where(worth, SINGULAR, UNREACHED).astype(object)

    def _same_side(self, q: np.ndarray, start: np.ndarray, fixed: np.ndarray) -> np.ndarray:
        """Whether the controller, coming from a start, stands as wanted, and no elbow has gone through its singularity."""
        readings, reached, _ = self.controller.settle(flanges(self.controller.robot, q), start, fixed)
        return np.asarray(reached & (np.abs(readings - q).max(axis=1, initial=0.0) < OTHER_POSITION))

    def miss(self, wanted: np.ndarray, q: np.ndarray, sides: Mapping[str, np.ndarray]) -> np.ndarray:
        """How far the real target is from where it should be, [m] and [rad], shape (n, 2)."""
        e, _ = self.real.error(self.target(wanted), q, self.values(sides, len(q)))
        return np.stack([np.linalg.norm(e[:, :3], axis=1), np.linalg.norm(e[:, 3:], axis=1) / self.real.lever], axis=1)

    def beyond(self, q: np.ndarray, sides: Mapping[str, np.ndarray]) -> np.ndarray:
        """Readings that are not like those that were measured, shape (n,)."""
        n = len(q)
        station, target = (None if label is None else np.full(n, label) for label in self.labels)
        line, usable = np.arange(n), np.ones(n, dtype=bool)
        rows = QueryRows(q, None, None, self.values(sides, n), station, line, usable, (), (), target=target)
        return extrapolates(self.saved, rows, std_of(self.saved, rows))


def correct(
    saved: SavedModel,
    targets: Sequence[Target],
    covariates: Mapping[str, float],
    start: np.ndarray | None = None,
    count_rows: Callable[[int], None] = lambda done: None,
) -> Corrections:
    """Correct the targets of a program, one after the other: each starts where the one before has come to.

    Args:
        saved: The calibration.
        targets: In the order in which the robot goes there.
        covariates: What effects depend on beside the joints: temperature, for instance.
        start: Readings where the program begins, shape (columns,), [rad] or [m]; default: the middle of what was measured.
        count_rows: Called with the number of targets that are done.

    Raises:
        CovariateNotFound: an effect depends on something that is not given.
    """
    arm = _Arm(saved, covariates)
    missing = sorted(needed_of(saved) - covariates.keys() - set(directions(saved)))
    if missing:
        raise CovariateNotFound(f"the model depends on {missing[0]!r}: state it, as in --at {missing[0]}=VALUE")
    middle = np.array([np.mean(saved.ranges.get(name, (0.0, 0.0))) for name in saved.final.model.robot.readings])
    walk = _Walk(arm, middle if start is None else start)
    parts = []
    for first in range(0, max(len(targets), 1), TARGETS_AT_ONCE):
        count_rows(first)
        parts.append(walk.go(targets[first : first + TARGETS_AT_ONCE]))
    return joined_corrections(parts)


def every_position(robot: Robot, targets: Sequence[Target]) -> list[list[np.ndarray]]:
    """All positions in which the nominal arm reaches each target's pose, whatever its posture in words; none of joint targets."""
    poses = [k for k, target in enumerate(targets) if target.form == "pose" and not target.why]
    own = [targets[k] for k in poses]
    fixed = np.full((len(own), len(robot.readings)), np.nan)
    for k, target in enumerate(own):
        if target.branch.held is not None:
            fixed[k] = target.branch.held
    poses_of_targets = _placed(own, [target.values.tolist() for target in own]) if own else np.empty((0, 4, 4))
    near = np.tile(np.clip(0.0, *robot.limits.T), (len(own), 1))
    by_target: list[list[np.ndarray]] = [[] for _ in targets]
    positions = Controller(robot).positions(Poses(poses_of_targets, fixed, [None] * len(own)), near)
    for k, stands in zip(poses, positions, strict=True):
        by_target[k] = stands
    return by_target


@dataclass
class _Lot:
    """Some targets of a program of which it is known where they are, n of them, and what is worked out of them.

    Attributes:
        targets: As they are read.
        values: Their numbers, in the program's units.
        joints: Those that state readings, shape (n,) bool; the others are poses.
        stated: Readings that a target of joints states, shape (n, columns) bool.
        q: Readings where the controller believes that the arm is, shape (n, columns).
        wanted: T_base_tip where the tip is to be, shape (n, 4, 4).
        held: Readings that stay, shape (n, columns), NaN where they do not.
        sides: From which side joints come.
        real: Readings that bring the real tip there.
        sent: Readings where the joints are sent, texts rounded.
        why: Why each is left.
        remark: What is to be known of each.
        texts: Their new numbers.
        words: New words of their posture.
        moved: By how much the place is moved, [m] and [rad], shape (n, 2).
        before: How far the real tip would be from its place, likewise.
        after: How far it will be.
        positions: Of the arm that agree with the program.
        doubt: How much another one would change, [m].
        beside: What remains at other places where the same numbers are used, [m].
    """

    targets: Sequence[Target]
    values: Sequence[Sequence[float]]
    joints: np.ndarray
    stated: np.ndarray
    q: np.ndarray
    wanted: np.ndarray
    held: np.ndarray
    sides: dict[str, np.ndarray]

    def __post_init__(self) -> None:
        n = len(self.targets)
        self.real, self.sent = self.q.copy(), self.q.copy()
        self.why, self.remark = np.full(n, "", dtype=object), np.full(n, "", dtype=object)
        self.texts: list[tuple[str, ...]] = [()] * n
        self.words: list[tuple[str, ...]] = [()] * n
        self.moved, self.before, self.after = (np.full((n, 2), np.nan) for _ in range(3))
        self.positions, self.doubt, self.beside = np.ones(n, dtype=int), np.zeros(n), np.zeros(n)

    @property
    def poses(self) -> np.ndarray:
        """Numbers of those that are poses."""
        return np.flatnonzero(~self.joints)

    def own_sides(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """From which side joints come, of some."""
        return {name: side[rows] for name, side in self.sides.items()}

    def tell(self, corrections: Corrections, rows: np.ndarray) -> None:
        """Write down what becomes of each in some rows of corrections."""
        for name in ("moved", "before", "after", "positions", "doubt", "beside"):
            getattr(corrections, name)[rows] = getattr(self, name)
        for k, row in enumerate(rows.tolist()):
            corrections.why[row], corrections.remark[row] = self.why[k], self.remark[k]
            if not self.why[k]:
                corrections.texts[row], corrections.words[row] = NUL.join(self.texts[k]), NUL.join(self.words[k])


class _Walk:
    """Targets one after the other.

    Args:
        arm: That goes there.
        start: Where it begins.
    """

    def __init__(self, arm: _Arm, start: np.ndarray) -> None:
        self._arm, self._controller = arm, arm.controller
        self._robot = arm.saved.final.model.robot
        self._nominal = np.asarray(start, dtype=float)  # where the controller believes that the arm is
        self._sent = self._nominal  # where the joints are sent with the corrections
        self._sides = dict.fromkeys(directions(arm.saved), 0.0)
        self._shared: dict[str, tuple[int, ...]] = {}  # sides of all targets whose posture has this name

    def go(self, targets: Sequence[Target]) -> Corrections:
        """Correct some more targets."""
        corrections = no_corrections(targets)
        plain = np.array([k for k, target in enumerate(targets) if not target.why or _passes(target)], dtype=int)
        if len(plain):
            own = [targets[k] for k in plain.tolist()]
            there, whys, lot = self._stood(own)
            for k, why in zip(plain[~there].tolist(), whys, strict=True):
                corrections.why[k] = why
            if lot is not None:
                if len(lot.poses):
                    self._send_poses(lot)
                if lot.joints.any():
                    self._send_joints(lot)
                self._nominal, self._sent = lot.q[-1], lot.sent[-1]
                lot.tell(corrections, plain[there])
        return corrections

    # --- where the controller stands ----------------------------------------------------------------------------------------

    def _stood(self, targets: Sequence[Target]) -> tuple[np.ndarray, list[str], _Lot | None]:
        """Which targets the controller gets to, shape (n,); why not to the others; and the lot of those."""
        n, columns = len(targets), len(self._robot.readings)
        joints = np.array([target.form == "joints" for target in targets])
        given, near, fixed = (np.full((n, columns), np.nan) for _ in range(3))
        fits: list[Callable[[np.ndarray], bool] | None] = [None] * n
        for k, target in enumerate(targets):
            branch = target.branch
            if target.readings is not None:
                given[k] = target.readings
                continue
            if branch.held is not None:
                fixed[k] = branch.held
            if branch.near is not None:
                near[k] = branch.near
            if branch.words is not None:
                fits[k] = branch.words.agree
        wanted = np.tile(np.eye(4), (n, 1, 1))
        own = np.flatnonzero(~joints)
        values = [list(map(float, target.numbers.texts)) for target in targets]
        wanted[own] = _placed([targets[k] for k in own.tolist()], [values[k] for k in own.tolist()])
        poses = Poses(wanted, fixed, fits)
        memory: Memory = {}
        q, there = self._controller.walk(Chain(joints, given, poses, near), self._nominal, memory)
        nowhere = np.flatnonzero(~there)
        whys = [
            self._why_nowhere(targets[k], poses[nowhere[j : j + 1]], memory) for j, k in enumerate(nowhere.tolist())
        ]
        if not there.any():
            return there, whys, None
        q, joints, fixed = q[there], joints[there], fixed[there]
        wanted = np.where(joints[:, None, None], flanges(self._robot, q), wanted[there])
        stated = np.isfinite(given[there])
        reached = [target for target, ok in zip(targets, there.tolist(), strict=True) if ok]
        values = [own for own, ok in zip(values, there.tolist(), strict=True) if ok]
        return there, whys, _Lot(reached, values, joints, stated, q, wanted, fixed, self._approached(q))

    def _why_nowhere(self, target: Target, pose: Poses, memory: Memory) -> str:
        """Why the controller does not get to a pose, by what searches over all readings found."""
        ends = memory.get(pose.key(0))
        if ends is None or not len(ends):
            return NOT_NOMINAL
        words = target.branch.words
        if words is None or not self._controller.within_limits(pose, ends):
            return LIMITED
        return f"its posture ({words.names}) {NO_SUCH_POSTURE}"

    def _approached(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """From which side each joint comes that has to do with it."""
        approaches = {}
        for name, side in self._sides.items():
            k = self._robot.names.index(name.removesuffix("_direction"))
            at, middle = self._robot.positions(q)[:, k], self._robot.positions(self._nominal[None])[0, k]
            approaches[name] = approach(at, LEAST_BACKLASH_MOTION, side, float(middle))
            self._sides[name] = float(approaches[name][-1])
        return approaches

    # --- joints -------------------------------------------------------------------------------------------------------------

    def _send_joints(self, lot: _Lot) -> None:
        """Work out all targets of joints. What a target does not state holds from the one before that does.

        What holds is guessed to be the nominal reading, and targets are worked out again as long as that changes: each depends
        on those before it alone, so that the end is what one after the other gives.
        """
        given = lot.stated | ~lot.joints[:, None]
        order = np.where(given, np.arange(len(lot.q))[:, None], -1)
        last = np.vstack([np.full((1, order.shape[1]), -1), np.maximum.accumulate(order, axis=0)[:-1]])
        columns = np.arange(order.shape[1])
        rows, as_is = np.flatnonzero(lot.joints), np.full_like(lot.q, np.nan)
        while len(rows):
            holds = np.where(last[rows] < 0, self._sent, lot.sent[last[rows], columns])
            as_is[rows] = np.where(lot.stated[rows], lot.q[rows], holds)
            self._send_stated(lot, rows, as_is[rows])
            holds = np.where(last < 0, self._sent, lot.sent[last, columns])
            rows = np.flatnonzero(lot.joints & (~lot.stated & (holds != as_is)).any(axis=1))

    def _send_stated(self, lot: _Lot, rows: np.ndarray, as_is: np.ndarray) -> None:
        """Work out targets of joints for what holds of those that they do not state.

        Args:
            lot: All targets.
            rows: Which.
            as_is: Readings where the program sends the joints without their correction, shape (rows, columns).
        """
        wanted, q, free, sides = lot.wanted[rows], lot.q[rows], lot.stated[rows], lot.own_sides(rows)
        real, remark = self._arm.nearby(wanted, q, sides, np.where(free, np.nan, as_is))
        sent, large = as_is.copy(), np.zeros(len(rows), dtype=bool)
        for row, k in enumerate(rows.tolist()):
            target, texts = lot.targets[k], []
            own = zip(target.numbers.texts, lot.values[k], target.places, target.units, strict=True)
            for before, value, digits, (unit, j) in own:
                text = written(value + (real[row, j] - q[row, j]) / unit, before, digits)
                sent[row, j] = q[row, j] + (float(text) - value) * unit
                large[row] |= abs(float(text)) > LARGEST_IN_PROGRAM
                texts.append(text)
            lot.texts[k] = tuple(texts)
        lot.moved[rows] = _apart(flanges(self._robot, sent), flanges(self._robot, as_is))
        lot.before[rows], lot.after[rows] = (self._arm.miss(wanted, there, sides) for there in (as_is, sent))
        unreached = ~free.all(axis=1) & (remark != UNREACHED)
        unreached[unreached] = (
            self._arm.miss(wanted[unreached], real[unreached], lot.own_sides(rows[unreached]))[:, 0] > SEEN
        )
        remark[unreached] = PARTLY
        lot.remark[rows], lot.why[rows] = remark, self._left(real, remark, sides)
        lot.why[rows[large]] = TOO_LARGE
        for k in rows.tolist():
            lot.why[k] = lot.targets[k].why or lot.why[k]
        lot.sent[rows] = np.where((lot.why[rows] != "")[:, None], as_is, sent)

    def _left(self, real: np.ndarray, remark: np.ndarray, sides: Mapping[str, np.ndarray]) -> np.ndarray:
        """Why targets are left as they are; empty of those that are not."""
        beyond = np.where(self._arm.beyond(real, sides), BEYOND_MEASURED, "")
        return np.where(remark == UNREACHED, UNREACHED, beyond).astype(object)

    # --- poses --------------------------------------------------------------------------------------------------------------

    def _send_poses(self, lot: _Lot) -> None:
        """Work out all targets that are poses."""
        rows = lot.poses
        targets, sides = [lot.targets[k] for k in rows.tolist()], lot.own_sides(rows)
        wanted, q, fixed = lot.wanted[rows], lot.q[rows], lot.held[rows]
        real, remark = self._arm.nearby(wanted, q, sides, fixed)
        base, tool = _frames([_place(target) for target in targets])
        new = inverse(base) @ flanges(self._robot, real) @ tool
        numbers = []
        values = [lot.values[k] for k in rows.tolist()]
        for k, target, own in zip(rows.tolist(), targets, _numbers(targets, values, new), strict=True):
            lot.texts[k] = tuple(map(written, own, target.numbers.texts, target.places))
            numbers.append(list(map(float, lot.texts[k])))
        as_read = _placed(targets, numbers)
        whole = (remark == "")[:, None]  # the controller was seen to come there, and rounding is all that is between
        sent, reached, _ = self._controller.settle(as_read, np.where(whole, real, q), fixed)
        lot.real[rows], lot.sent[rows] = real, np.where(reached[:, None], sent, q)
        lot.moved[rows] = _apart(base @ new, wanted @ tool)
        lot.before[rows], lot.after[rows] = (self._arm.miss(wanted, there, sides) for there in (q, lot.sent[rows]))
        lot.remark[rows], lot.why[rows] = remark, self._left(real, remark, sides)
        lot.why[
            [k for k, own in zip(rows.tolist(), numbers, strict=True) if max(map(abs, own)) > LARGEST_IN_PROGRAM]
        ] = TOO_LARGE
        self._settle_stance(lot)
        self._reword(lot, rows, as_read)
        self._keep_shared(lot, rows)
        self._look_beside(lot, rows, numbers)
        uncorrected = rows[lot.why[rows] != ""]
        lot.sent[uncorrected] = lot.q[uncorrected]

    def _settle_stance(self, lot: _Lot) -> None:
        """Leave poses of which nobody knows how the arm stands there, where their corrections depend on it."""
        rows = np.array([k for k in lot.poses.tolist() if _unsettled(lot.targets[k]) and not lot.why[k]], dtype=int)
        for count in (FIRST_BRANCHES, STARTS):  # few starts find, as a rule, that corrections differ
            if len(rows):
                self._compare(lot, rows, count)
                rows = rows[lot.why[rows] == ""]

    def _compare(self, lot: _Lot, rows: np.ndarray, count: int) -> None:
        """Compare the corrections for all positions that some starts find."""
        poses = Poses(lot.wanted[rows], lot.held[rows], [_fits(lot.targets[k]) for k in rows.tolist()])
        positions = self._controller.positions(poses, lot.q[rows], count)
        pairs = [
            (k, other)
            for k, own in zip(rows.tolist(), positions, strict=True)
            for other in own
            if np.abs(other - lot.q[k]).max() > OTHER_POSITION
        ]
        lot.positions[rows] = 1
        if not pairs:
            return
        of, others = np.array([k for k, _ in pairs]), np.array([other for _, other in pairs])
        np.add.at(lot.positions, of, 1)
        real, remark = self._arm.nearby(lot.wanted[of], others, lot.own_sides(of), lot.held[of])
        differ = _apart(flanges(self._robot, real), flanges(self._robot, lot.real[of]))
        np.maximum.at(lot.doubt, of, differ[:, 0])
        noise = self._arm.saved.noise
        apart = (differ[:, 0] > noise[0]) | (differ[:, 1] > noise[1]) | (remark == UNREACHED)
        for k in of[apart].tolist():
            lot.why[k] = f"{lot.targets[k].branch.unknown}; {UNSETTLED}"

    def _reword(self, lot: _Lot, rows: np.ndarray, as_read: np.ndarray) -> None:
        """Say the postures of corrected joints, and make sure that the controller takes the same position for them."""
        changed, fits = [], []
        for row, k in enumerate(rows.tolist()):
            words = lot.targets[k].branch.words
            if words is None or lot.why[k]:
                continue
            texts = words.texts(lot.sent[k])
            if texts is None:
                lot.why[k] = WORDLESS
                continue
            lot.words[k] = texts
            if texts != words.stated:
                changed.append(row)
                fits.append(lambda q, words=words, texts=texts: words.texts(q) == texts)
        if changed:
            own = rows[changed]
            poses = Poses(as_read[changed], lot.held[own], fits)
            positions, _ = self._controller.nearest(poses, lot.q[own], lot.sent[own], {})
            other = np.abs(positions - lot.sent[own]).max(axis=1) > OTHER_POSITION
            lot.why[own[other]] = ELSEWHERE

    def _keep_shared(self, lot: _Lot, rows: np.ndarray) -> None:
        """Leave targets that do not stand as all whose posture is stated with theirs, or would not once corrected."""
        for k in rows.tolist():
            branch = lot.targets[k].branch
            if branch.shared is None or lot.why[k]:
                continue
            if _unsettled(lot.targets[k]):
                lot.why[k] = f"{branch.unknown}; {UNSETTLED}"
                continue
            own = branch.shared.sides(lot.q[k])
            if not own == self._shared.setdefault(branch.shared.name, own) == branch.shared.sides(lot.sent[k]):
                lot.why[k] = f"its posture ({branch.shared.name}) {OTHER_SIDE}"

    def _look_beside(self, lot: _Lot, rows: np.ndarray, numbers: Sequence[Sequence[float]]) -> None:
        """Work out what the correction does at other places where the same numbers are used."""
        pairs = [
            (row, place) for row, k in enumerate(rows.tolist()) if not lot.why[k] for place in lot.targets[k].beside
        ]
        if not pairs:
            return
        of = rows[[row for row, _ in pairs]]
        targets, places = [lot.targets[k] for k in of.tolist()], [place for _, place in pairs]
        wanted = _placed(targets, [lot.values[k] for k in of.tolist()], places)
        as_read = _placed(targets, [numbers[row] for row, _ in pairs], places)
        fixed, sides = lot.held[of], lot.own_sides(of)
        poses = Poses(wanted, fixed, [None] * len(of))
        q, there = self._controller.nearest(poses, lot.q[of], lot.q[of], {})
        sent, reached, _ = self._controller.settle(as_read, q, fixed)
        before, after = (self._arm.miss(wanted, readings, sides) for readings in (q, sent))
        weights = np.array([1.0, self._arm.real.lever])
        worth = np.linalg.norm(after * weights, axis=1) < WORTH * np.linalg.norm(before * weights, axis=1)
        np.maximum.at(lot.beside, of, after[:, 0])
        for k, ok, half in zip(of.tolist(), there & reached, worth, strict=True):
            if not (ok and half):
                lot.why[k] = lot.why[k] or (BESIDE_WORSE if ok else BESIDE_NOWHERE)
            lot.remark[k] = lot.remark[k] or ALSO_A_CONSTANT


def _passes(target: Target) -> bool:
    """Whether a target is left, and all the same it is known where the arm is there: axes that are stated stand there."""
    return target.form == "joints" and target.readings is not None


def _unsettled(target: Target) -> bool:
    """Whether it matters, and is not known, where the arm comes from."""
    return bool(target.branch.unknown) and target.branch.near is None


def _fits(target: Target) -> Callable[[np.ndarray], bool] | None:
    """Whether readings agree with what the program says of the posture; None where it says nothing."""
    return None if target.branch.words is None else target.branch.words.agree


def _place(target: Target) -> PoseReference:
    """Frame and tool of a pose."""
    assert target.place is not None
    return target.place


def _frames(places: Sequence[PoseReference]) -> tuple[np.ndarray, np.ndarray]:
    """Frames and tools, shape (n, 4, 4) each."""
    return np.array([place.base for place in places]), np.array([place.tool for place in places])


def _placed(
    targets: Sequence[Target], numbers: Sequence[Sequence[float]], places: Sequence[PoseReference] = ()
) -> np.ndarray:
    """T_base_tip of poses that say some numbers, shape (n, 4, 4): at their own places, or at others."""
    poses = np.empty((len(targets), 4, 4))
    for notation, own in _by_notation(targets):
        poses[own] = notation.pose(np.array([numbers[k] for k in own]))
    base, tool = _frames(places or [_place(target) for target in targets])
    return np.asarray(base @ poses @ inverse(tool)) if len(targets) else poses


def _numbers(targets: Sequence[Target], before: Sequence[Sequence[float]], poses: np.ndarray) -> list[list[float]]:
    """What the notation of each target, which said other numbers before, says of poses (n, 4, 4) in its frame."""
    by_target: list[list[float]] = [[]] * len(targets)
    for notation, own in _by_notation(targets):
        values = notation.numbers(poses[own], np.array([before[k] for k in own]))
        for k, numbers in zip(own, values.tolist(), strict=True):
            by_target[k] = numbers
    return by_target


def _by_notation(targets: Sequence[Target]) -> Iterator[tuple[Notation, list[int]]]:
    """The notations that targets are written in, and the numbers of the targets of each."""
    notations: dict[int, tuple[Notation, list[int]]] = {}
    for k, target in enumerate(targets):
        assert target.notation is not None
        notations.setdefault(id(target.notation), (target.notation, []))[1].append(k)
    yield from notations.values()


def _apart(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """How far poses (n, 4, 4) are from each other, [m] and [rad], shape (n, 2)."""
    R = A[:, :3, :3].transpose(0, 2, 1) @ B[:, :3, :3]
    turn = np.linalg.norm(rotation_vector(R), axis=1)
    return np.stack([np.linalg.norm(A[:, :3, 3] - B[:, :3, 3], axis=1), turn], axis=1)
