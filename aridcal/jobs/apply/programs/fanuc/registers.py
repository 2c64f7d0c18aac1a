"""Position registers: what is certain of their numbers while a program works with them."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from aridcal.jobs.apply.programs.notations import FANUC, MILLI
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM
from aridcal.jobs.apply.programs.uses import Frame
from aridcal.jobs.apply.programs.walk import ProgramState

ELEMENT = re.compile(r"PR\[(\d{1,9}),([1-6])\]")

REGISTER = re.compile(r"PR\[(\d{1,9})\]")

PLAIN = re.compile(r"\(?([-+]?(?:\d+\.?\d*|\.\d+))\)?")

TERMS = re.compile(r"([-+]?)((?:[^-+\[\]]|\[[^\[\]]*\])+)")


@dataclass(frozen=True)
class Register:
    """A position register that holds a pose.

    Attributes:
        numbers: X Y Z W P R, [mm] and [deg]; None of what is not certain.
    """

    numbers: tuple[float | None, ...] = (None,) * 6

    @property
    def frame(self) -> Frame | None:
        """The transform that it is; None where a number is not certain."""
        values = [n for n in self.numbers if n is not None]
        return Frame(FANUC.pose(np.array(values))) if len(values) == len(self.numbers) else None

    @property
    def shift(self) -> np.ndarray | None:
        """The way that it is, [m]; None where it turns (how angles are added is a setting), or is not certain."""
        x, y, z, *angles = self.numbers
        if x is None or y is None or z is None or any(angle != 0.0 for angle in angles):
            return None
        return MILLI * np.array([x, y, z])


def sum_of(text: str, state: ProgramState) -> Register | None:
    """A position register from registers that are added element by element; None where it may hold joints, or anything."""
    total: Register | None = None
    parts = list(TERMS.finditer(text))
    if "".join(part.group() for part in parts) != text:
        return None
    for part in parts:
        source = REGISTER.fullmatch(part.group(2))
        term = state.get("register", int(source.group(1))) if source is not None else None
        if part.group(2) in ("LPOS",) or re.fullmatch(r"U(?:FRAME|TOOL)\[\d+\]", part.group(2)) is not None:
            term = Register()
        if not isinstance(term, Register):
            return None
        if total is None:
            total = term if part.group(1) != "-" else Register()
        elif part.group(1) == "-" and len(parts) == 2 and parts[0].group() == part.group(2):
            total = Register((0.0,) * 6)  # a register less itself, whatever it holds
        else:
            sign = -1.0 if part.group(1) == "-" else 1.0
            total = Register(
                tuple(
                    None if a is None or b is None else a + sign * b
                    for a, b in zip(total.numbers, term.numbers, strict=True)
                )
            )
    return total


def number_of(text: str, state: ProgramState) -> float | None:
    """A number that stands there, or an element of a register, or a sum of these; None where it is not certain."""
    whole = PLAIN.fullmatch(text)
    if whole is not None:
        return _bounded(float(whole.group(1)))
    total = 0.0
    parts = list(TERMS.finditer(text))
    if not parts or "".join(part.group() for part in parts) != text:
        return None
    for part in parts:
        element, plain = ELEMENT.fullmatch(part.group(2)), PLAIN.fullmatch(part.group(2))
        if element is not None:
            register = state.get("register", int(element.group(1)))
            value = register.numbers[int(element.group(2)) - 1] if isinstance(register, Register) else None
        else:
            value = float(plain.group(1)) if plain is not None else None
        if value is None:
            return None
        total += -value if part.group(1) == "-" else value
    return _bounded(total)


def _bounded(value: float) -> float | None:
    return value if abs(value) <= LARGEST_IN_PROGRAM else None
