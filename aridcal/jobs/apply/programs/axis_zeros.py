"""Zeros of the controller's axes: as the campaign or the user states them, and what a program says against them."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.files.counting import counting
from aridcal.jobs.apply.programs.anatomy import anatomy_of
from aridcal.jobs.apply.programs.axes import DEGREE, MILLIMETRE, axes_of
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.postures import Posture
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import CampaignError

RIGHT_ANGLE = 90.0
"""Makers' zeros and those of descriptions differ by so many degrees, or a multiple."""

TRUE = 1.0
"""Degrees within which an arm at zero stands as its maker draws it: a description's own roundings are far less."""

AT_ZERO = dict.fromkeys(("RAPID", "FANUC LS", "INFORM"), (RIGHT_ANGLE, 0.0)) | {"KRL": (0.0, 0.0)}
"""Where the controller shows zero: the upper arm above level, and the forearm, degrees. KUKA's arm is stretched out level in
front; ABB's, FANUC's and Yaskawa's upper arm is upright, the forearm level."""

MAKERS = {"KRL": ("KUKA", "A"), "RAPID": ("ABB", "axis "), "FANUC LS": ("FANUC", "J"), "INFORM": ("Yaskawa", "axis ")}

SENSES = {
    "KRL": (-1, 1, 1, -1, 1, -1),
    "RAPID": (1, 1, 1, 1, 1, 1),
    "FANUC LS": (1, 1, -1, -1, -1, -1),
    "INFORM": (1, 1, -1, -1, -1, -1),
}
"""Which way the maker's axes turn, as :attr:`Anatomy.senses` has them."""

LEAST_WITNESSES = 3
"""Poses whose words speak against the zeros, at least: one or two are a slip of a pen. Of joint targets one beyond the limits is
enough, for none of them could ever have been driven."""

BY_CHANCE = 0.5
"""The share of poses whose words may agree with wrong zeros. KUKA's T has one bit an axis: with two zeros wrong a quarter of the
poses agree by chance, and twice as many would not be spread evenly; quarters of a turn agree with none."""

COPIED = 0.1
"""The share of poses whose words may not agree with the right zeros: linear moves do not ask for them, and nobody mends them."""

MOST_WITNESS_POSES = 100
"""Poses that are looked at: more say the same."""

LIMIT_TOLERANCE = 1.0
"""Degrees or millimetres beyond a limit that a description's rounding explains."""


def cell_zeros(saved: SavedModel, text: str | None, language: Language) -> tuple[float, ...]:
    """What the controller shows of each axis of the arm where its reading is zero, in the program's units; empty: zero of each.

    Args:
        saved: The calibration, whose campaign may say it.
        text: What the user says in its place: numbers with commas between them, one for each axis.
        language: Of the program.

    Raises:
        CampaignError: these are no such numbers.
    """
    robot = saved.final.model.robot
    axes = axes_of(robot.kinds)
    if text is None:
        stated = [_stated(saved, k) for k in axes.arm]
        unknown = (k for k in axes.external if robot.readings[k] not in saved.controller_zeros)
        if any(_stated(saved, k) for k in unknown):
            raise CampaignError(
                "measurements.joints: programs of a rail that counts from another zero are not corrected; give a table of poses"
            )
        units = axes.units(axes.arm, language.angle, language.length)
        zeros = tuple(value / unit for value, (unit, _) in zip(stated, units, strict=True))
    else:
        zeros = _numbers(text, len(axes.arm))
    return zeros if any(zeros) else ()


def _stated(saved: SavedModel, reading: int) -> float:
    """What the controller shows of a joint where its reading is zero, [rad] or [m]: where nobody says it, as its tables count.

    Raises:
        CampaignError: the tables count backwards, which programs are not read in.
    """
    robot = saved.final.model.robot
    name = robot.readings[reading]
    if name in saved.controller_zeros:
        return saved.controller_zeros[name]
    own = counting(saved.measurements, robot.readings, robot.kinds)
    if own.sign[reading] < 0.0:
        raise CampaignError(
            f"measurements.joints.{name}.sign: programs whose joints count backwards are not corrected; where the controller "
            f"counts as the URDF does, say so: `robot: {{controller_zeros: {{{name}: 0}}}}`"
        )
    return float(own.zero[reading])


def _numbers(text: str, count: int) -> tuple[float, ...]:
    expected = f"--zeros {text}: should be {count} numbers with commas between them, one for each axis of the arm"
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise CampaignError(f"{expected}, as in --zeros {','.join(['0'] * count)}") from None
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise CampaignError(
            f"{expected}, in the program's units: what the controller shows where the URDF's joint is at 0"
        )
    return numbers


@dataclass(frozen=True)
class _Witnesses:
    """What a program says of its arm.

    Attributes:
        cell: As it was read for.
        poses: Words of each pose, and the nominal arm's positions there, at least one.
        joints: What the controller shows at each joint target, NaN where nothing is said, (axes of the arm,), degrees or mm.
    """

    cell: Cell
    poses: Sequence[tuple[Posture, Sequence[np.ndarray]]]
    joints: Sequence[np.ndarray]

    def agree(self, zeros: tuple[float, ...]) -> list[bool]:
        """Of each pose, whether its words fit a position with these zeros."""
        axes = replace(self.cell.axes, zeros=zeros)
        arm = anatomy_of(self.cell.robot, axes)
        return [
            any(_fits(replace(words, axes=axes, anatomy=arm), q, self.cell) for q in stands)
            for words, stands in self.poses
        ]

    def within(self, zeros: tuple[float, ...]) -> list[bool]:
        """Of each joint target, whether it is within the URDF's limits with these zeros."""
        axes = self.cell.axes
        units = np.array([axes.unit(k, DEGREE, MILLIMETRE) for k in axes.arm])
        low, high = (self.cell.robot.limits[list(axes.arm)] / units[:, None] + np.array(zeros)[:, None]).T
        return [
            bool(np.all(np.isnan(q) | ((q >= low - LIMIT_TOLERANCE) & (q <= high + LIMIT_TOLERANCE))))
            for q in self.joints
        ]


def _fits(words: Posture, q: np.ndarray, cell: Cell) -> bool:
    """Whether words agree with a position, or with the same with wrist axes turned by whole turns."""
    stated = tuple(words.numbers.texts)
    return any(words(turned) == stated for turned in _turned(q, cell))


def _turned(q: np.ndarray, cell: Cell) -> Iterator[np.ndarray]:
    """A position, and the same with axes 1, 4 and 6 turned by a whole turn within their limits."""
    axes, limits = cell.axes, cell.robot.limits
    turning = [axes.arm[k] for k in (0, 3, 5)]
    for turns in itertools.product((0.0, math.tau, -math.tau), repeat=len(turning)):
        other = q.copy()
        other[turning] += turns
        if (other >= limits[:, 0] - LIMIT_TOLERANCE * DEGREE).all() and (
            other <= limits[:, 1] + LIMIT_TOLERANCE * DEGREE
        ).all():
            yield other


def zeros_hint(targets: Sequence[Target], positions: Sequence[Sequence[np.ndarray]], cell: Cell, language: str) -> str:
    """What to state where a program contradicts its controller's zeros; empty where that is not certain.

    It is said only where two things that have nothing to do with each other agree: by the arm's own geometry the zeros of axes 2
    and 3 are a multiple of 90 degrees off where this maker has them; and the program names postures that the arm does not have
    (most of them), or joints beyond its limits, and no longer does with the maker's zeros. Of axes 1, 4 and 6 nothing is said: a
    base or a tool that is turned by a right angle looks just the same.

    Args:
        targets: Of the program, or some of them.
        positions: Of each target of a pose, all positions in which the nominal arm reaches it, whatever the words say; else none.
        cell: As the program was read for.
        language: Its name.
    """
    off = _off(cell, language)
    if off is None or not off.any():
        return ""
    poses = [
        (target.branch.words.texts, stands)
        for target, stands in zip(targets, positions, strict=True)
        if target.branch.words is not None and isinstance(target.branch.words.texts, Posture) and len(stands)
    ][:MOST_WITNESS_POSES]
    joints = [_shown(target, cell) for target in targets if target.form == "joints" and target.readings is not None]
    witnesses = _Witnesses(cell, poses, joints)
    as_is = cell.axes.zeros or (0.0,) * len(off)
    zeros = tuple(float(zero) for zero in np.array(as_is) + off)
    agreeing, within = witnesses.agree(as_is), witnesses.within(as_is)
    spoken = len(poses) - sum(agreeing) >= LEAST_WITNESSES and sum(agreeing) <= BY_CHANCE * len(poses)
    if not spoken and all(within):
        return ""
    if sum(witnesses.agree(zeros)) < (1.0 - COPIED) * len(poses) or not all(witnesses.within(zeros)):
        return ""
    return _sentence(language, off, zeros, (agreeing, within))


def senses_hint(cell: Cell, language: str) -> str:
    """Which axes of the URDF turn the other way than the maker's; empty where none does, or nobody can tell.

    Joint targets, and words that count such an axis, then mean another place than the URDF's.

    Args:
        cell: As the program was read for.
        language: Its name.
    """
    arm = cell.anatomy
    if arm is None or language not in SENSES:
        return ""
    other = [k for k, (own, makers) in enumerate(zip(arm.senses, SENSES[language], strict=True)) if own * makers < 0]
    if not other:
        return ""
    maker, letter = MAKERS[language]
    joints = ", ".join(cell.robot.readings[cell.axes.arm[k]] for k in other)
    return (
        f"{joints} of the URDF turn the other way than {maker}'s {', '.join(f'{letter}{k + 1}' for k in other)}: joints in the "
        "program mean other places than the URDF's; calibrate with a URDF whose axes turn as the controller's do"
    )


def without_mirrored(targets: Sequence[Target], cell: Cell, language: str) -> Sequence[Target]:
    """Targets as they are, those left that axes which turn the other way give another meaning.

    These are joints and poses with a posture in words. How the arm stands at other poses is not known then: it comes from those.
    """
    why = senses_hint(cell, language)
    return [_mirrored(target, why) for target in targets] if why else targets


def _mirrored(target: Target, why: str) -> Target:
    if target.why:
        return target
    if target.form == "joints" or target.branch.words is not None:
        return replace(target, why=why)
    return replace(target, branch=replace(target.branch, unknown=target.branch.unknown or why))


def witnesses(targets: Sequence[Target], contradicted: int, cell: Cell) -> tuple[Sequence[Target], Sequence[Target]]:
    """Poses and joint targets that :func:`zeros_hint` is to look at; none where nothing speaks against the zeros.

    Args:
        targets: Of the program.
        contradicted: How many poses name a posture that the nominal arm does not have there.
        cell: As the program was read for.
    """
    joints = [
        target for target in targets if target.form == "joints" and target.readings is not None and not target.why
    ]
    low, high = cell.robot.limits.T
    readings = np.array([target.readings for target in joints]).reshape(-1, len(low))
    if contradicted < LEAST_WITNESSES and not ((readings < low) | (readings > high)).any():
        return [], []
    poses = [target for target in targets if target.branch.words is not None and not target.why]
    chosen = np.unique(np.linspace(0, len(poses) - 1, MOST_WITNESS_POSES).astype(int)).tolist() if poses else []
    return [poses[k] for k in chosen], joints


def _shown(target: Target, cell: Cell) -> np.ndarray:
    """What the controller shows at a joint target, degrees or mm."""
    assert target.readings is not None
    axes = cell.axes
    return np.array([target.readings[k] / axes.unit(k, DEGREE, MILLIMETRE) + axes.zero(k) for k in axes.arm])


def _off(cell: Cell, language: str) -> np.ndarray | None:
    """By how much the zeros of axes 2 and 3 are off where the maker has them, degrees; None where that is no right angle."""
    arm = cell.anatomy
    if arm is None or language not in AT_ZERO:
        return None
    upper, forearm = (math.degrees(cmath.phase(part)) for part in (arm.upper, arm.forearm))
    meant_upper, meant_forearm = AT_ZERO[language]
    lean = meant_upper - upper
    exact = np.array([0.0, arm.senses[1] * lean, arm.senses[2] * (meant_forearm - forearm - lean), 0.0, 0.0, 0.0])
    half_turn = 2.0 * RIGHT_ANGLE
    exact = (exact + half_turn) % (2.0 * half_turn) - half_turn
    off = RIGHT_ANGLE * np.round(exact / RIGHT_ANGLE)
    return off + 0.0 if np.abs(exact - off).max() < TRUE else None


def _sentence(
    language: str, off: np.ndarray, zeros: Sequence[float], verdicts: tuple[Sequence[bool], Sequence[bool]]
) -> str:
    maker, letter = MAKERS[language]
    axes = " and ".join(f"{letter}{k + 1} zero is {abs(off[k]):.0f}° off this URDF's" for k in np.flatnonzero(off))
    against = [
        f"{len(good) - sum(good)} of {len(good)} {what}"
        for good, what in zip(verdicts, ("postures", "joint targets"), strict=True)
        if not all(good)
    ]
    return (
        f"{maker}'s {axes}: {' and '.join(against)} of the program say so. State --zeros "
        f"{','.join(f'{zero:g}' for zero in zeros)}, or robot.controller_zeros in the campaign"
    )
