"""What languages write of the arm's posture beside a pose: KUKA's S and T, ABB's confdata, FANUC's CONFIG.

Each word is a :class:`_Part`: where it stands, and what should stand there for a stance of the arm. A part that agrees with the
stance, or that nobody can tell of this arm, is given back as it stands.

KUKA (System Software, status and turn): bit k of T is set where axis k + 1 is below zero. Bits of S: 0 where the wrist's centre
is behind axis 1, 1 where axis 3 is beyond the angle that stretches the arm, 2 where axis 5 is below zero; the others, that of an
absolutely accurate point for instance, are not of the posture.
ABB (RAPID, confdata): quarters of a turn of axes 1, 4 and 6 (metres of one that slides), counted from zero downwards, too; cfx
counts 4 where the wrist's centre is behind axis 1, 2 where it is behind the lower arm, 1 where axis 5 is negative. Arms that
cannot bend over backwards, such as those with a parallel rod, do not use cfx.
FANUC (CONFIG): N where the flange is bent down with axis 4 at zero, F where up; T with the wrist in front of axis 1, B behind it;
U with the elbow above the line from axis 2 to the wrist, D below: of an arm that leans over backwards that letter is kept, for no
public source says whether "above" turns round with it. Turn numbers are whole turns of axes 1, 4 and 6 away from their middle.
Yaskawa (RCONF) is not read: it stands once for many positions, and of its first number, flip or no flip, the manual of the NX100
says that axis 4 decides (flip from -90 to 90 degrees), and none that was found says whether newer controllers count so. All its
boundaries are kept clear of: half turns of axes 1, 4 and 6, quarters of axis 4, the elbow stretched, the wrist above axis 1, axis
5 straight.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np

from aridcal.jobs.apply.programs.anatomy import Anatomy
from aridcal.jobs.apply.programs.axes import Axes
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.targets import Words
from aridcal.jobs.apply.programs.text import Number, Numbers

EITHER = 3e-4
"""[rad], [m] or shares of the arm's length: so close to where a word changes either is right. A pose of two digits of a degree is
rounded by 1e-4 rad, and a wrist bent by 20 degrees makes three times that of it at axes 4 and 6."""

QUARTER = math.pi / 2.0

INTEGER = re.compile(r"(?P<open>'?)(?P<base>[BH]?)(?P<digits>[+-]?[0-9A-F]{1,16})(?P<close>'?)", re.IGNORECASE)
"""A whole number of KRL: ``2``, ``'B010'`` or ``'H1A'``."""

BASES = {"": 10, "B": 2, "H": 16}

UNUSED = "cfx stays as it stands: this arm cannot bend over backwards within its limits, and such arms do not use it"

UNSEEN = (
    "stays as it stands: it is of an arm with a wrist of three axes that meet, in front of or behind an upright axis 1"
)


@dataclass(frozen=True)
class Stance:
    """How an arm stands.

    Attributes:
        shown: What its controller shows of each axis of the arm, [rad] or [m].
        anatomy: What else can be seen of it; None: nothing.
    """

    shown: Sequence[float]
    anatomy: Anatomy | None

    @cached_property
    def sides(self) -> tuple[float, float, float]:
        """In front of axis 1, bent forward, axis 5 positive: each above zero where it is so, NaN where nobody can tell."""
        if self.anatomy is None:
            return math.nan, math.nan, math.nan
        return self.anatomy.ahead(self.shown), self.anatomy.bent(self.shown), math.sin(self.shown[4])


Rule = Callable[[Stance, str], str | None]
"""What should stand in place of a text; None where nobody can tell."""


@dataclass(frozen=True, slots=True)
class Posture:
    """Words of a program, and what each should be.

    Attributes:
        numbers: Where each stands.
        rules: One for each.
        axes: Of the robot.
        anatomy: Of the robot.
    """

    numbers: Numbers
    rules: tuple[Rule, ...]
    axes: Axes
    anatomy: Anatomy | None

    def __call__(self, readings: np.ndarray) -> tuple[str, ...] | None:
        """What should stand there for readings, shape (columns,); None where nobody can tell all of it."""
        values, axes = readings.tolist(), self.axes
        shown = [values[k] + shift for k, shift in zip(axes.arm, axes.shifts, strict=True)]
        stance = Stance(shown, self.anatomy)
        texts = []
        for text, rule in zip(self.numbers.texts, self.rules, strict=True):
            own = rule(stance, text)
            if own is None:
                return None
            texts.append(own)
        return tuple(texts)


def krl_words(status: Number | None, turn: Number | None, cell: Cell) -> Words | None:
    """S and T of an E6POS or a POS; None where neither stands there."""
    given = [(name, n, rule) for name, n, rule in (("S", status, _status), ("T", turn, _turn)) if n is not None]
    if not given:
        return None
    pattern = ", ".join(f"{name} {{}}" for name, _, _ in given)
    return _words([n for _, n, _ in given], tuple(rule for _, _, rule in given), pattern, cell)


def rapid_words(data: Sequence[Number], cell: Cell) -> Words | None:
    """cf1, cf4, cf6 and cfx of a robtarget; None where these are no four numbers."""
    return _words(data, _quarters(cell.axes, cell.anatomy), "confdata [{},{},{},{}]", cell) if len(data) == 4 else None


def fanuc_words(config: Numbers, cell: Cell) -> Words | None:
    """CONFIG : 'N U T, 0, 0, 0': its three letters and turn numbers; None where nothing stands there."""
    return _words(config, _letters(cell.axes), "CONFIG '{} {} {}, {}, {}, {}'", cell) if config else None


def rconf_sides(cell: Cell) -> Callable[[np.ndarray], tuple[int, ...]]:
    """For readings of an arm of six axes, on which side of each boundary they are that RCONF may count."""
    return partial(_sides, cell.axes, cell.anatomy)


def _sides(axes: Axes, anatomy: Anatomy | None, readings: np.ndarray) -> tuple[int, ...]:
    shown = [float(readings[k]) + shift for k, shift in zip(axes.arm, axes.shifts, strict=True)]
    halves = [math.floor(shown[k] / math.tau + 0.5) for k in (0, 3, 5)]
    flip = math.floor(shown[3] / math.pi + 0.5)
    return *halves, flip, *(int(value > 0.0) for value in Stance(shown, anatomy).sides)


@lru_cache
def _quarters(axes: Axes, anatomy: Anatomy | None) -> tuple[Rule, ...]:
    """Rules of cf1, cf4, cf6 and cfx."""
    six = len(axes.arm) == 6
    others = [_quarter(axis, axes) if six else _kept for axis in (3, 5)]
    return _quarter(0, axes), *others, _cfx if anatomy is not None and anatomy.stretches else _kept


@lru_cache
def _letters(axes: Axes) -> tuple[Rule, ...]:
    """Rules of CONFIG's three letters and turn numbers."""
    counted = len(axes.arm) == 6 and all(axes.kinds[axes.arm[k]] != "prismatic" for k in (0, 3, 5))
    counts = [_turns(axis) for axis in (0, 3, 5)] if counted else [_kept] * 3
    return *([_letter] * 3), *counts


def _words(numbers: Sequence[Number], rules: tuple[Rule, ...], pattern: str, cell: Cell) -> Words:
    own = numbers if isinstance(numbers, Numbers) else Numbers(numbers)
    return Words(own, Posture(own, rules, cell.axes, cell.anatomy), pattern)


def unread_words(language: str, cell: Cell) -> str:
    """What of a language's words is kept because this arm's geometry does not say what it means; empty if nothing.

    Args:
        language: ``KRL``, ``RAPID`` or ``FANUC LS``.
        cell: With the robot.
    """
    arm = cell.anatomy
    if language == "RAPID" and arm is not None:
        return "" if arm.stretches else UNUSED
    word = {"KRL": "S", "RAPID": "cfx", "FANUC LS": "the letters of CONFIG"}.get(language)
    return f"{word} {UNSEEN}" if word is not None and arm is None else ""


def _kept(stance: Stance, text: str) -> str:
    """A word of which nobody knows what it is for this arm."""
    return text


def _status(stance: Stance, text: str) -> str | None:
    ahead, bent, wrist = stance.sides
    return _with_bits(text, (ahead, -bent, wrist))


def _turn(stance: Stance, text: str) -> str | None:
    return _with_bits(text, stance.shown)


def _with_bits(text: str, decided: Sequence[float]) -> str | None:
    """A whole number in which bits are set where values are below zero, kept where these are near zero, or NaN."""
    literal = INTEGER.fullmatch(text)
    if literal is None or bool(literal["open"]) != bool(literal["close"]):
        return None
    base = BASES[literal["base"].upper()]
    try:
        before = int(literal["digits"], base)
    except ValueError:
        return None
    if before < 0:
        return None
    bits = before
    for k, value in enumerate(decided):
        if abs(value) > EITHER:  # not for NaN
            bits = bits & ~(1 << k) | (int(value < 0.0) << k)
    if bits == before:
        return text
    digits = {10: f"{bits:d}", 2: f"{bits:b}", 16: f"{bits:X}"}[base]
    if base != 10:
        digits = digits.zfill(len(literal["digits"]))
    return f"{literal['open']}{literal['base']}{digits}{literal['close']}"


@lru_cache
def _quarter(axis: int, axes: Axes) -> Rule:
    """The quarter of a turn, or the metre, that an axis is in."""
    unit = 1.0 if axes.kinds[axes.arm[axis]] == "prismatic" else QUARTER

    def rule(stance: Stance, text: str) -> str | None:
        return _counted(stance.shown[axis] / unit, EITHER / unit, text)

    return rule


@lru_cache
def _turns(axis: int) -> Rule:
    """Whole turns of an axis away from its middle."""

    def rule(stance: Stance, text: str) -> str | None:
        return _counted(stance.shown[axis] / math.tau + 0.5, EITHER / math.tau, text)

    return rule


def _counted(value: float, margin: float, text: str) -> str | None:
    """The whole number below a value; what stands there if it is that one, or that of a value close by."""
    stated = _whole(text)
    if stated is None:
        return None
    return text if stated in (math.floor(value - margin), math.floor(value + margin)) else str(math.floor(value))


@lru_cache
def _whole(text: str) -> int | None:
    """The whole number that a text says."""
    try:
        value = float(text)
    except ValueError:
        return None
    return int(value) if math.isfinite(value) and value.is_integer() else None


def _cfx(stance: Stance, text: str) -> str | None:
    stated = _whole(text)
    if stated is None or not 0 <= stated < 8:
        return None
    ahead, bent, wrist = stance.sides
    bits = _with_bits(str(stated), (wrist, bent, ahead))
    return text if bits == str(stated) else bits


LETTERS = {letter: pair for pair in ("NF", "TB", "UD") for letter in pair}
"""Each letter of CONFIG, and the pair that it is of: the first of it where the value is above zero."""


def _letter(stance: Stance, text: str) -> str | None:
    arm, pair = stance.anatomy, LETTERS.get(text)
    if arm is None or pair is None:
        return text
    ahead, bent, wrist = stance.sides
    value = {"NF": arm.senses[4] * wrist, "TB": ahead, "UD": bent if ahead > 0.0 else 0.0}[pair]
    return pair[value < 0.0] if abs(value) > EITHER else text  # not for NaN
