"""Statements put into programs, moved, and wrapped in branches: what they can reach is left, all else is corrected as before.

    python benchmarks/program_mutants.py --mutants 1000
    python benchmarks/program_mutants.py --mutants 1000 --folder ~/programs     # programs by others, below a folder a language

Programs of `tests/support/made_programs.py` go from top to bottom, so that it is known which targets come behind a place:

- an unknown statement: no pose behind it is corrected, all before it as before, but where data outlive the program (RAPID);
- a tool that is set: poses behind it have exactly that tool, all before it their own;
- a tool that is set in a branch: no pose behind it is corrected;
- a harmless statement, also in a branch or a loop, a comment with code in it: nothing changes;
- a move in a branch: no frame changes.

Of programs by others it is not known what comes behind what: there a harmless statement must change nothing, and whatever is
still corrected behind an unknown one must have the same frame and the same tool as before.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from made_programs import MAKERS, Made, path
from programs_marked import cell_of
from robots import ur10

from aridcal.jobs.apply.programs.branches import flange
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.frames import read_frames
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.languages import LANGUAGES, language_of
from aridcal.jobs.apply.programs.project import Project, SourceFile, read_text
from aridcal.jobs.apply.programs.targets import Target
from aridcal.system.errors import AridcalError

POINTS = 15

SHIFT = 0.123
"""[m] along z of the tool that a mutation sets."""


@dataclass(frozen=True)
class Syntax:
    """How a language writes what mutations put in.

    Attributes:
        unknown: A statement that no manual has.
        harmless: One that changes nothing.
        tool: One that sets the tool to :data:`SHIFT` along z; empty where points name their tools themselves.
        comment: With code in it.
        branch: What stands before and behind a statement that may be carried out.
        loop: Likewise of one that is repeated.
        moves: A regular expression of lines that move.
        lasting: Whether data outlive the program, so that what an unknown statement does to them reaches its next run.
    """

    unknown: str
    harmless: str
    tool: str
    comment: str
    branch: tuple[str, str]
    loop: tuple[str, str] | None
    moves: str
    lasting: bool = False


SYNTAX = {
    "URScript": Syntax(
        "frobnicate_7(1)", "set_digital_out(3, True)", f"set_tcp(p[0, 0, {SHIFT}, 0, 0, 0])", "# set_tcp(p[1,2,3,0,0,0])",
        ("if get_digital_in(1):", "end"), ("while get_digital_in(2):", "end"), r"\s*(movej|movel|movep)\(",
    ),
    "KRL": Syntax(
        "FROBNICATE(1)", "$OUT[3]=TRUE", f"$TOOL={{X 0, Y 0, Z {1e3 * SHIFT}, A 0, B 0, C 0}}",
        "; $TOOL={X 1, Y 2, Z 3, A 0, B 0, C 0}", ("IF $IN[1] THEN", "ENDIF"),
        ("WHILE $IN[2]", "ENDWHILE"), r"(?i)\s*(PTP|LIN|SLIN)\b",
    ),
    "RAPID": Syntax(
        "Frobnicate 1;", "SetDO do3,1;", "", "! MoveL p10, v100, fine, tool0;", ("IF di1=1 THEN", "ENDIF"),
        ("WHILE di2=1 DO", "ENDWHILE"), r"\s*Move(J|L|AbsJ)\b", True,
    ),
    "FANUC LS": Syntax(
        "  99:  FROBNICATE[1]    ;", "  99:  DO[3]=ON ;", "", "  99:  !UTOOL_NUM=3 ;",
        ("  99:  IF (DI[1]=ON) THEN ;", "  99:  ENDIF ;"), None, r"\s*\d+:[JL] P\[",
    ),
    "INFORM": Syntax(
        "FROBNICATE 1", "DOUT OT#(3) ON", "", "'SFTON P003", ("IFTHENEXP IN#(1)=ON", "ENDIF"),
        ("WHILEEXP IN#(2)=ON", "ENDWHILE"), r"MOV[JL] C",
    ),
    "G-code": Syntax("G999", "M8", "", "(G92 X1 Y2)", ("", ""), None, r".*[XYZ]"),
}  # fmt: skip
"""By the language's name."""

Corrected = dict[tuple[int, ...], Target]


def read(language: Language, text: str, cell: Cell) -> tuple[list[Target], list[Target]]:
    """Targets that are corrected, and those that are left."""
    targets = language.read(Project((SourceFile(Path(f"p{language.endings[0]}"), text),)), cell).targets
    return [t for t in targets if not t.why], [t for t in targets if t.why]


def lines_of_moves(text: str, syntax: Syntax) -> list[int]:
    """Numbers of the lines that move, from 0."""
    return [k for k, line in enumerate(text.split("\n")) if re.match(syntax.moves, line)]


def with_lines(text: str, at: int, before: Sequence[str], behind: Sequence[str] = (), until: int = 0) -> str:
    """A text with lines put in before one, and others behind so many more."""
    lines = text.split("\n")
    end = "\r" if lines[0].endswith("\r") else ""
    return "\n".join(
        [
            *lines[:at],
            *(line + end for line in before),
            *lines[at : at + until],
            *(line + end for line in behind),
            *lines[at + until :],
        ]
    )


def same_place(a: Target, b: Target) -> bool:
    """Whether two readings of a target mean the same."""
    if (a.form, [n.text for n in a.numbers], a.place is None) != (b.form, [n.text for n in b.numbers], b.place is None):
        return False
    if a.place is None or b.place is None:
        return True
    return bool(np.allclose(a.place.base, b.place.base) and np.allclose(a.place.tool, b.place.tool))


def key(target: Target) -> tuple[str, ...]:
    """What stands in the text of a target: made programs and most others say no point twice."""
    return tuple(number.text for number in target.numbers)


Fault = str


def check_made(language: Language, made: Made, cell: Cell, rng: np.random.Generator) -> tuple[str, Fault]:
    """One mutation of a made program: its name, and what is wrong; empty if nothing is."""
    syntax = SYNTAX[language.name]
    straight = made.text.replace("while (True):", "if (True):")  # else what stands behind would come before, too
    before = {key(t): t for t in read(language, straight, cell)[0]}
    order = _keys_in_order(made)
    moves = lines_of_moves(straight, syntax)
    assert len(moves) == len(order), f"{language.name}: {len(moves)} moves of {len(order)} targets"
    k = int(rng.integers(len(moves)))
    names = ["unknown", "harmless", "comment", "harmless in a branch", "move in a branch"]
    names += ["tool", "tool in a branch"] if syntax.tool else []
    names += ["harmless in a loop"] if syntax.loop else []
    name = str(rng.choice(names))
    text = _mutant(straight, moves[k], name, syntax)
    after = {key(t): t for t in read(language, text, cell)[0]}
    behind = (
        {place for place in order[k:] if before[place].form == "pose"} if all(o in before for o in order) else set()
    )
    for place, target in before.items():
        new = after.get(place)
        if place in behind and name in ("unknown", "tool in a branch"):
            if new is not None:
                return name, f"{place} behind line {moves[k] + 1} is still corrected"
        elif place in behind and name == "tool":
            if new is None or new.place is None or not np.allclose(new.place.tool[:3, 3], [0, 0, SHIFT]):
                return name, f"{place} behind line {moves[k] + 1} has not the tool that was set"
        elif name == "unknown" and new is None and (place in order[k:] or syntax.lasting):
            continue  # joints under a name may be others behind it; lasting data may be others everywhere
        elif new is None or not same_place(target, new):
            return name, f"{place} changed by what cannot reach it (line {moves[k] + 1})"
    return name, ""


def _keys_in_order(made: Made) -> list[tuple[str, ...]]:
    numbers, keys = iter(made.numbers), []
    for kind in made.kinds:
        count = 6 if kind == "joints" else (7 if "robtarget" in made.template else 6)
        keys.append(tuple(next(numbers) for _ in range(count)))
    return keys


def _mutant(text: str, at: int, name: str, syntax: Syntax) -> str:
    if name == "move in a branch":
        return with_lines(text, at, [syntax.branch[0]], [syntax.branch[1]], 1)
    statement = {
        "unknown": syntax.unknown,
        "comment": syntax.comment,
        "tool": syntax.tool,
        "tool in a branch": syntax.tool,
    }
    own = [statement.get(name, syntax.harmless)]
    if name.endswith("branch"):
        own = [syntax.branch[0], *own, syntax.branch[1]]
    if name.endswith("loop") and syntax.loop is not None:
        own = [syntax.loop[0], *own, syntax.loop[1]]
    return with_lines(text, at, own)


def check_other(language: Language, text: str, cell: Cell, rng: np.random.Generator) -> tuple[str, Fault]:
    """One mutation of somebody's program."""
    syntax = SYNTAX[language.name]
    moves = lines_of_moves(text, syntax)
    if not moves:
        return "no move", ""
    name = str(rng.choice(["unknown", "harmless", "comment"]))
    at = moves[int(rng.integers(len(moves)))]
    mutant = _mutant(text, at, name, syntax)
    before, after = (Counter(key(t) for t in read(language, own, cell)[0]) for own in (text, mutant))
    targets = {key(t): t for t in read(language, text, cell)[0]}
    if after - before:
        return name, f"{next(iter(after - before))} is corrected only behind what was put in before line {at + 1}"
    if name != "unknown" and before - after:
        return name, f"{next(iter(before - after))} is no longer corrected, for something harmless before line {at + 1}"
    wrong = [t for t in read(language, mutant, cell)[0] if before[key(t)] == 1 and not same_place(targets[key(t)], t)]
    return name, f"{wrong[0].name} means another place" if wrong else ""


def made_program(language: Language, seed: int) -> Made:
    """A straight program of a language."""
    robot, rng = ur10(), np.random.default_rng(seed)
    low, high = np.full(6, -1.5), np.full(6, 1.5)
    return MAKERS[language.endings[0]][1](rng, path(rng, low, high, POINTS), lambda q: flange(robot, q))


def measure(language: Language, mutants: int, folder: Path | None) -> None:
    """Print how many mutants of a language were right."""
    checks: list[Callable[[np.random.Generator], tuple[str, Fault]]] = []
    if language.endings[0] in MAKERS:
        programs = [made_program(language, seed) for seed in range(20)]
        cells = [cell_of(language, made.frames, True) for made in programs]
        checks += [partial(check_made, language, made, cell) for made, cell in zip(programs, cells, strict=True)]
    for file in sorted(folder.rglob("*")) if folder is not None else ():
        if language_of(file) is language and file.is_file():
            frames = read_frames(frames_file if (frames_file := file.parent / "frames.yaml").exists() else None)
            text, cell = read_text(file), Cell(cell_of(language, "").robot, frames, (), True)
            checks.append(partial(check_other, language, text, cell))
    if not checks:
        print(f"{language.name}: no programs; give --folder", flush=True)
        return
    rng, right, faults = np.random.default_rng(0), Counter[str](), 0
    for number in range(mutants):
        try:
            name, fault = checks[number % len(checks)](rng)
        except AridcalError as refusal:
            name, fault = f"refused: {str(refusal)[:60]}", ""
        right[name] += not fault
        faults += bool(fault)
        if fault and faults <= 10:
            print(f"{language.name}, mutant {number}, {name}: {fault}", flush=True)
    print(f"{language.name}: {mutants - faults} of {mutants} right; {dict(right)}", flush=True)


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("--mutants", type=int, default=1000, help="of each language")
    command.add_argument("--only", default="", help="the name of one language")
    command.add_argument("--folder", type=Path, help="programs by others")
    arguments = command.parse_args()
    for language in LANGUAGES:
        if arguments.only in ("", language.name):
            measure(language, arguments.mutants, arguments.folder)


if __name__ == "__main__":
    main()
