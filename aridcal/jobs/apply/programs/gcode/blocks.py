"""Lines of G-code as blocks of words: every letter of a line is read, or the block is not understood."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from aridcal.jobs.apply.programs.gcode.table import AXES
from aridcal.jobs.apply.programs.text import Number

PLAIN = re.compile(r"(?:[ \t]*+[A-Za-z][ \t]*+[-+]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++))*[ \t]*+")
"""A line of letters with plain numbers. G-code has no exponents: E behind a number is the next word."""

WORD = re.compile(r"([A-Za-z])[ \t]*+([-+]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++))")

COMMENT = re.compile(r"\([^()]*+\)|;.*+")

PYTHON = re.compile(r"[(;]\s*py\s*,", re.IGNORECASE)
"""LinuxCNC carries these comments out."""

SPACED = re.compile(r"[-+]?[ \t]*+[0-9.][0-9. \t]*+")
"""A number with blanks in it, which controllers pass over; nobody writes one on purpose."""

REFERENCE = re.compile(r"[-+]?[ \t]*+(?:[A-Za-z]{2,6}[ \t]*+(?=\[))?#*+(?:[0-9]++|<[^<>]*+>)?")
"""What may stand before a bracket, or in its place: ``#100``, ``-#<depth>``, ``SIN[30]``."""

LABEL = re.compile(r"[ \t]*+[Nn][ \t]*+([0-9]+)")


@dataclass(frozen=True, slots=True)
class Line:
    """A line of a program.

    Attributes:
        number: From 1.
        start: Place of its first letter in the text.
        code: The line with comments as blanks.
        fault: What is wrong with its comments; empty if nothing is.
    """

    number: int
    start: int
    code: str
    fault: str


@dataclass(frozen=True, slots=True)
class Block:
    """What a line says.

    Attributes:
        line: From 1.
        file: Of the project, its index.
        text: As it stands, for messages.
        codes: G and M words without zeros in front: ``G1``, ``M30``.
        axes: Letters of axis words with their numbers; None in place of a number that is worked out.
        others: All other words: letter and text, which is empty where the number is worked out.
        late: Codes that stand behind an axis word.
        fault: Why it is not understood; empty if it is.
    """

    line: int
    file: int
    text: str
    codes: tuple[str, ...] = ()
    axes: tuple[tuple[str, Number | None], ...] = ()
    others: tuple[tuple[str, str], ...] = ()
    late: tuple[str, ...] = ()
    fault: str = ""

    def word(self, letter: str) -> str:
        """The text of a word that is no axis; empty where there is none."""
        return next((text for other, text in self.others if other == letter), "")


def lines_of(text: str) -> Iterator[Line]:
    """All lines, with comments as blanks; a file without line feeds has carriage returns between its lines."""
    end = "\n" if "\n" in text or "\r" not in text else "\r"
    start = 0
    for number, row in enumerate(text.split(end), start=1):
        code = row.rstrip("\r")
        if start == 0 and code.startswith("\xef\xbb\xbf"):  # UTF-8 says so
            code = "   " + code[3:]
        fault = (
            "a carriage return stands within the line: controllers differ in whether it ends there"
            if "\r" in code
            else ""
        )
        if "(" in code or ";" in code or ")" in code:
            if PYTHON.search(code):
                fault = "a comment is carried out here (py)"
            code = COMMENT.sub(lambda match: " " * len(match.group()), code)
            if "(" in code or ")" in code:
                fault = "comments stand in comments here, or one has no end: controllers differ in where they end"
        yield Line(number, start, code, fault)
        start += len(row) + 1


def block_of(line: Line, file: int) -> Block:
    """The words of a line."""
    code = line.code
    fault = line.fault
    words: list[tuple[str, int, str]] = []
    if not fault and PLAIN.fullmatch(code):
        words = [(m.group(1).upper(), m.start(2), m.group(2)) for m in WORD.finditer(code)]
    elif not fault:
        words, fault = _worked_out(code)
    codes, axes, others, late = [], [], [], []
    for letter, place, text in words:
        if letter in AXES:
            axes.append((letter, Number(line.start + place, text) if text else None))
        elif letter not in "GM":
            others.append((letter, text))
        elif not text:
            fault = f"which {letter} code is meant is worked out here"
        else:
            codes.append(_name(letter, text))
            if axes:
                late.append(codes[-1])
    return Block(line.number, file, code.strip(), tuple(codes), tuple(axes), tuple(others), tuple(late), fault)


def _name(letter: str, text: str) -> str:
    """A code without zeros in front: G01 is G1."""
    whole, _, part = text.partition(".")
    part = part.rstrip("0")
    whole = whole.lstrip("0") or "0"
    return f"{letter}{whole}.{part}" if part else f"{letter}{whole}"


def _worked_out(code: str) -> tuple[list[tuple[str, int, str]], str]:
    """Words of a line with expressions: letter, place and text, which is empty where it is no plain number; and what is wrong."""
    words: list[tuple[str, int, str]] = []
    place, end = 0, len(code)
    while place < end:
        if code[place] in " \t":
            place += 1
            continue
        letter = code[place]
        if not (letter.isascii() and letter.isalpha()):
            return words, f"{letter!r} is not understood here"
        word, spaced = WORD.match(code, place), SPACED.match(code, _behind_blanks(code, place + 1))
        if spaced is not None:
            plain = word is not None and spaced.group().rstrip(" \t") == word.group(2)
            if not plain and spaced.group().count(".") > 1:
                return words, "a number has two points here"
            words.append(
                (letter.upper(), word.start(2) if plain and word else place, word.group(2) if plain and word else "")
            )
            place = spaced.end()
            continue
        behind = _expression_end(code, _behind_blanks(code, place + 1))
        if behind < 0:
            return words, f"{code[place : place + 12].split(' ')[0]} is not understood here"
        words.append((letter.upper(), place, ""))
        place = behind
    return words, ""


def _behind_blanks(code: str, place: int) -> int:
    while place < len(code) and code[place] in " \t":
        place += 1
    return place


def _expression_end(code: str, place: int) -> int:
    """The place behind an expression: ``#1``, ``-#<name>``, ``[...]``, ``sin[...]``; -1 if there is none."""
    match = REFERENCE.match(code, place)
    assert match is not None
    behind = match.end()
    if behind < len(code) and code[behind] == "[":
        depth = 0
        for at in range(behind, len(code)):
            depth += (code[at] == "[") - (code[at] == "]")
            if depth == 0:
                return at + 1
        return -1
    return behind if "#" in match.group() and code[behind - 1] not in "#" else -1
