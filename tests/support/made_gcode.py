"""G-code of gantries as it is written in shops, a controller that drives it, and gantries of which the truth is known.

The controller knows nothing of ``aridcal.jobs.apply.programs``: it reads letter by letter and keeps the place in machine
coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from calibrated import Machine, machine
from made_programs import MARK, Made

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.robot.chain import Robot, parse_robot

ZEROS = {"G54": (0.05, -0.1, 0.02), "G55": (-0.12, 0.2, 0.0), "G59": (0.0, 0.03, -0.04)}
"""[m]: where the zeros of axes are; G57 is not told to us, and left."""

LETTERS = {"prismatic": "XYZ", "turning": "ABC"}


def gantry(rotary: bool) -> Robot:
    """Three slides of 2 m, and a rotary axis behind them whose tool is 0.2 m off."""
    joints = [
        ("x", "prismatic", "1 0 0", "0 0 0"),
        ("y", "prismatic", "0 1 0", "0 0 0.5"),
        ("z", "prismatic", "0 0 1", "0.1 0 0"),
    ]
    joints += [("a", "revolute", "1 0 0", "0 0 -0.1")] if rotary else []
    links = ["base", *(name for name, *_ in joints)]
    parts = [f'<link name="{name}_link"/>' for name in links] + ['<link name="tip"/>']
    for before, (name, kind, axis, xyz) in zip(links, joints, strict=False):
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{before}_link"/><child link="{name}_link"/><axis xyz="{axis}"/>'
            f'<origin xyz="{xyz}"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
        )
    parts.append(
        f'<joint name="tool" type="fixed"><parent link="{links[-1]}_link"/><child link="tip"/><origin xyz="0 0.05 -0.2"/></joint>'
    )
    return parse_robot(f'<robot name="gantry">{"".join(parts)}</robot>'.encode(), "tip")


def calibrated_gantry(rotary: bool) -> Machine:
    """Axes out of square by some milliradians, slides too long by some 0.1 mm a metre, a rail that waves; all calibrated."""
    scale = [
        (Coefficient(name, "axis", Basis("linear", (name,), (0.0,))), size)
        for name, size in (("x", 4e-4), ("y", -3e-4), ("z", 2e-4))
    ]
    rail = [
        (Coefficient("x", "axis", Basis(form, ("x",), (order,))), size)
        for form, order, size in (("sin", 3.0, 2e-4), ("cos", 5.0, 1e-4))
    ]
    return machine(3, "position", n=150, effects=(*scale, *rail), robot=gantry(rotary))


@dataclass(frozen=True)
class Block:
    """A move.

    Attributes:
        line: From 1.
        place: Of the axes in machine coordinates, [m] or [rad].
        named: Axes whose words stand in it.
    """

    line: int
    place: np.ndarray
    named: str


def words(line: str) -> list[tuple[str, float]]:
    """Letters with their numbers, letter by letter; comments left out."""
    found: list[tuple[str, str]] = []
    depth = 0
    for letter in line:
        if letter == ";" and not depth:
            break
        depth += (letter == "(") - (letter == ")")
        if depth or letter in ") \t\r%":
            continue
        if letter.isalpha():
            found.append((letter.upper(), ""))
        elif found:
            found[-1] = (found[-1][0], found[-1][1] + letter)
    return [(letter, float(text)) for letter, text in found]


def drive(text: str, kinds: Sequence[str], zeros: Mapping[str, Sequence[float]], start: np.ndarray) -> list[Block]:
    """Where a controller sends the axes, move by move.

    Args:
        text: The program.
        kinds: Of the axes: X Y Z slide, A turns.
        zeros: Of each work offset, [m].
        start: Where the axes stand, and home; [m] or [rad].
    """
    axes = "XYZ" + "A" * (len(kinds) - 3)
    at, shift, home = start.astype(float).copy(), np.zeros(len(kinds)), start
    motion, step, unit, work, found = 0, False, 1e-3, "G54", []
    for number, line in enumerate(text.split("\n"), start=1):
        own = words(line)
        codes = [value for letter, value in own if letter == "G"]
        for code in codes:
            motion = int(code) if code in (0, 1, 2, 3) else motion
            step = code == 91 or (step and code != 90)
            unit = 0.0254 if code == 20 else 1e-3 if code == 21 else unit
            work = f"G{code:g}" if code in (54, 55, 56, 57, 58, 59) else work
            shift = np.zeros_like(shift) if code == 92.1 else shift
        told = {axes.index(letter): value for letter, value in own if letter in axes}
        if 4 in codes or not told:
            continue
        zero = np.array([*zeros[work], *[0.0] * (len(axes) - 3)])
        size = np.array([unit if letter != "A" else np.pi / 180 for letter in axes])
        for k, value in told.items():
            if 92 in codes:
                shift[k] = at[k] - zero[k] - size[k] * value
            elif 28 in codes:
                at[k] = home[k]
            elif 53 in codes:
                at[k] = size[k] * value
            else:
                at[k] = size[k] * value + (at[k] if step else zero[k] + shift[k])
        if 92 not in codes:
            found.append(Block(number, at.copy(), "".join(axes[k] for k in sorted(told))))
    return found


def gcode(rng: np.random.Generator, low: np.ndarray, high: np.ndarray, n: int) -> Made:
    """As CAM systems and hands write them.

    Args:
        rng: Of all that is drawn.
        low: Of the axes, [m] or [rad].
        high: Likewise.
        n: Moves, about.
    """
    axes = "XYZ" + "A" * (len(low) - 3)
    made, end = Made(), str(rng.choice(["\n", "\r\n"]))
    inches, lower, numbered, packed = rng.random(4) < (0.3, 0.3, 0.6, 0.2)
    size = np.array([(0.0254 if inches else 1e-3) if letter != "A" else np.pi / 180 for letter in axes])
    work, places = "G54", iter(range(10, 100000, 10))
    middle, half = (low + high) / 2, (high - low) / 2
    at = middle.copy()
    start = [float(f"{v:.4f}") for v in at / np.array([1e-3] * 3 + [np.pi / 180] * (len(axes) - 3))]
    entries = "".join(f"  {name}: {{xyz: {list(xyz)}, rpy: [0, 0, 0]}}\n" for name, xyz in ZEROS.items())
    made.frames = f"format: 1\nbases:\n{entries}start: {start}\n"

    def line(text: str = "", comment: str = "") -> None:
        code = text.replace(" ", "") if packed else text
        name = f"N{next(places)} " if numbered and text and text[0] not in "%O" else ""
        made.template += name + (code.lower() if lower else code) + comment + end

    def move(head: str, which: str, q: np.ndarray, tail: str = "", comment: str = "", stepped: bool = False) -> None:
        parts = []
        zero = np.array([*ZEROS.get(work, (0.0,) * 3), *[0.0] * (len(axes) - 3)])
        for letter in which:
            k = axes.index(letter)
            value = (q[k] - (0.0 if stepped else zero[k])) / size[k]
            made.numbers.append(f"{value:.{int(rng.integers(1, 5))}f}")
            parts.append(letter + MARK)
        line(" ".join([head, *parts, tail]).strip(), comment)

    line("%")
    line("", "(Schweißportal: Ümlaute, G1 X9 Y9)")
    line("O1001", " ; Prüfung; G0 X1")
    line(f"G17 G40 G49 G80 G90 G91.1 {'G20' if inches else 'G21'}")
    line("G54 S12000 M3")
    move("G0", axes, at, comment=" (Start)")
    for k in range(n):
        at = np.clip(at + rng.normal(0.0, 0.1, len(at)) * half, middle - 0.8 * half, middle + 0.8 * half)
        how = rng.random()
        some = "".join(letter for letter in axes if rng.random() < 0.5) or "X"
        head = str(rng.choice(["G1", "G01", "G0", "G00"]))
        if how < 0.50:
            move(head, axes, at, f"F{100 * (1 + k % 9)}", str(rng.choice(["", " (Düse an)", "; nach Z5"])))
        elif how < 0.66:
            move(head, some, at)
        elif how < 0.74:
            line(str(rng.choice(["G17", "G18", "G19"])))
            move(str(rng.choice(["G2", "G03"])), "XY", at, "I1.5 J0.5")
        elif how < 0.80:
            line("G91")
            move(head, some, 0.02 * half, stepped=True)
            line("G90")
        elif how < 0.88:
            work = str(rng.choice([*ZEROS, "G57"]))
            line(work)
            move(head, some if rng.random() < 0.5 else axes, at)
        elif how < 0.92:
            line("G92 X0 Y0")
            move("G1", axes, 0.1 * half, "F200")
            line("G92.1")
        elif how < 0.95:
            line("G28 Z0")
            move(head, some, at)
        else:
            line("G4 P0.5", " (warten)")
            move(head, "", at, "F300")
    line("M30")
    line("%")
    return made
