"""Programs of other people: how many of their targets with a plain meaning are corrected, and why the others are left.

    PYTHONPATH=.:tests/support python benchmarks/others_programs.py FOLDER

FOLDER has a folder for each project: its programs as they were found, and `frames.yaml` where frames, the start or harmless
routines are known only to its controller. Targets are those of the reader: whether the arm of a project reaches them depends on
its URDF, which such projects seldom hold. The robot is a UR10, or a gantry for G-code.

A target has no plain meaning where the program itself works it out, changes it or uses its numbers for two things, where no move
goes there, where the program is none that its controller takes, or moves axes that the robot does not have. All others count.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from pathlib import Path

from made_gcode import gantry
from programs_marked import is_unsettled
from rich.console import Console
from rich.table import Table
from robots import ur10

from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.frames import read_frames
from aridcal.jobs.apply.programs.read_project import read_project
from aridcal.jobs.apply.programs.targets import Target
from aridcal.system.errors import AridcalError, printable

KINDS = {
    "worked out, changed, or used for two things": (
        r"work(s|ed) (it |out|X|Y|Z)|worked out|works out another|computes with|changes it|sets \S+ from it|assigns from"
        r"|writes a part|writes it|is one of several|a copy of numbers|caller says|position register|passes it on"
        r"|with another|while the program runs|set nowhere|uses it as a frame|takes its numbers|may change it at any time"
        r"|sets (a part of )?it|not certain: line|is no plain numbers|not the same on all ways"
    ),
    "somewhere else than its numbers say: a step, shifted, a cycle, beside by a radius, axes not stated": (
        r"is a step from|shifts|lies beside by|cycles, threads and probing|its frame moves with another group"
        r"|stays? as (it|they) (is|are)|is a place of the machine|goes to a point that|the controller stops"
        r"|no plain move before says where"
    ),
    "no move goes there": r"no move of the given files|is called by no program",
    "axes that the robot does not have": r"external axis|has an axis|is none of an arm of six axes",
    "no program that the controller takes": r"is no whole program|is no statement of|ends nothing|and names it",
    "file, frame or start that is not given": (
        r"no given file|not in the program: state|stands in|--start|comes from|stands there"
    ),
    "arc, or where one begins": r"arcs are left|an arc or a curve begins",
}
"""Reasons for which targets are left."""

NOT_PLAIN = tuple(KINDS)[:5]


def kind_of(why: str) -> str:
    """The kind of a reason."""
    return next((kind for kind, form in KINDS.items() if re.search(form, why)), "not understood")


def read(folder: Path) -> tuple[str, list[Target]]:
    """The language of a project, and its targets."""
    opened = read_project((folder,), folder / "nowhere")
    frames = read_frames(folder / "frames.yaml" if (folder / "frames.yaml").exists() else None)
    robot = gantry(rotary=False) if opened.language.name == "G-code" else ur10()
    reading = opened.language.read(opened.project, Cell(robot, frames, (), frames.start is not None))
    return opened.language.name, list(reading.targets)


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("folder", type=Path)
    arguments = command.parse_args()
    table, kinds, reasons = (
        Table("project", "language", "targets", "plain", "corrected"),
        Counter[str](),
        Counter[str](),
    )
    totals = Counter[str]()
    for folder in sorted(path for path in arguments.folder.iterdir() if path.is_dir()):
        try:
            language, targets = read(folder)
        except AridcalError as error:
            table.add_row(folder.name, "", "", "", printable(str(error))[:60])
            continue
        whys = [t.why or t.branch.unknown for t in targets if t.why or is_unsettled(t)]
        own = Counter(map(kind_of, whys))
        kinds.update(own)
        reasons.update(f"{kind_of(why)}: {re.sub(r'[0-9]+', 'N', why)}" for why in whys)
        count = {"targets": len(targets), "plain": len(targets) - sum(own[kind] for kind in NOT_PLAIN)}
        count["corrected"] = len(targets) - len(whys)
        table.add_row(folder.name, language, *map(str, count.values()))
        totals.update(count)
    table.add_row("all", "", *(str(totals[name]) for name in ("targets", "plain", "corrected")))
    console = Console(width=160)
    console.print(table)
    console.print(f"corrected of those with a plain meaning: {totals['corrected'] / max(totals['plain'], 1):.1%}")
    for heading, counts in (("kind", kinds), ("reason", reasons)):
        why = Table("targets left", heading)
        for reason, number in counts.most_common():
            why.add_row(str(number), printable(reason))
        console.print(why)


if __name__ == "__main__":
    main()
