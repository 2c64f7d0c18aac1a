"""Programs of other people: how many of their targets are read as plain, and why the others are left.

    PYTHONPATH=.:tests python benchmarks/others_programs.py FOLDER

FOLDER has a folder for each project: its programs as they were found, and `frames.yaml` where frames, the start or harmless
routines are known only to its controller. `plain.txt`, where it is there, has the number of targets with a plain meaning by
somebody's own count. Targets are those of the reader: whether the arm of a project reaches them depends on its URDF, which such
projects seldom hold. The robot is a UR10, or a gantry for G-code.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

from made_gcode import gantry
from programs_marked import is_unsettled
from rich.console import Console
from rich.table import Table
from robots import ur10

from aridcal.errors import AridcalError, printable
from aridcal.programs.cell import Cell
from aridcal.programs.frames import read_frames
from aridcal.programs.read_project import read_project
from aridcal.programs.targets import Target


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
    table, reasons = Table("project", "language", "targets", "corrected", "plain"), Counter[str]()
    totals = Counter[str]()
    for folder in sorted(path for path in arguments.folder.iterdir() if path.is_dir()):
        try:
            language, targets = read(folder)
        except AridcalError as error:
            table.add_row(folder.name, "", "", "", printable(str(error))[:60])
            continue
        left = [t for t in targets if t.why or is_unsettled(t)]
        reasons.update(t.why or t.branch.unknown for t in left)
        note = folder / "plain.txt"
        plain = int(note.read_text().split()[0]) if note.exists() else None
        table.add_row(
            folder.name, language, str(len(targets)), str(len(targets) - len(left)), "" if plain is None else str(plain)
        )
        totals.update({"targets": len(targets), "corrected": len(targets) - len(left), "plain": plain or 0})
    table.add_row("all", "", *(str(totals[name]) for name in ("targets", "corrected", "plain")))
    console = Console(width=160)
    console.print(table)
    why = Table("targets left", "reason")
    for reason, count in reasons.most_common():
        why.add_row(str(count), printable(reason))
    console.print(why)


if __name__ == "__main__":
    main()
