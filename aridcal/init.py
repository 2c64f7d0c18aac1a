"""Write a campaign by looking at a URDF and at measurements: which column is which, in which unit, in which frame.

What was guessed is printed and stands as a comment in the file. On a terminal it asks where the data leave a choice;
elsewhere it takes the likeliest and says so.

Example:
    aridcal init --urdf my_robot.urdf --measurements measurements.csv
"""

from __future__ import annotations

import itertools
import os
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.prompt import IntPrompt

from aridcal.campaign import Campaign
from aridcal.commands import CommandParser, atomic_file, check_writable, command_parser, run
from aridcal.errors import OutputError, RobotError
from aridcal.measurements import Measurements, load_measurements
from aridcal.propose import Choose, Guess, Proposal, propose
from aridcal.quality import joint_kinds, joint_limits
from aridcal.settings import parse_settings, read_bytes
from aridcal.tables import read_tables

WIDTH = 116
HEAD = """\
# Proposed by `aridcal init`. What was guessed says so: read it once. All keys: docs/formats.md.
format: 1
"""


def campaign_text(proposal: Proposal, urdf: Path, files: Sequence[Path], home: Path) -> str:
    """Write a proposal as ``campaign.yaml``, every choice with its reason above it.

    Args:
        proposal: What was found.
        urdf: The robot.
        files: The tables.
        home: Folder of the campaign; paths are relative to it.
    """
    names = [_relative(file, home) for file in files]
    parts: dict[str, list[Guess]] = {}
    for guess in proposal.guesses:
        parts.setdefault(guess.key.rpartition(".")[0], []).append(guess)
    lines = [HEAD + "robot:", f"  urdf: {_scalar(_relative(urdf, home))}", *_mapping(parts["robot"], "  ")]
    lines += ["measurements:", f"  file: {_scalar(names[0] if len(names) == 1 else names)}"]
    lines += _mapping([*parts.get("", []), *parts["measurements"]], "  ")
    columns = [g for g in parts["measurements.columns"] if g.value is not None or not g.sure]
    lines += ["  columns:"] if any(g.value is not None for g in columns) else []
    lines += _mapping(columns, "    ")
    lines += ["frames:", *_mapping(parts["frames"], "  ")] if "frames" in parts else []
    return "\n".join(lines) + "\n"


def _mapping(guesses: Sequence[Guess], indent: str) -> list[str]:
    """Lines of a mapping; guesses with one reason share its comment."""
    lines = []
    for (why, sure), group in itertools.groupby(guesses, key=lambda g: (g.why, g.sure)):
        entries = list(group)
        # A default has no line of its own: then the comment says what it is about.
        about = "" if entries[0].value is not None else f"{_last(entries[0])}: "
        said = f"{'' if sure else 'GUESSED: '}{about}{why}"
        lines += textwrap.wrap(said, WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}#   ")
        lines += [f"{indent}{_scalar(_last(g))}: {_scalar(g.value)}" for g in entries if g.value is not None]
    return lines


def _last(guess: Guess) -> str:
    return guess.key.rpartition(".")[2]


def _scalar(value: Any) -> str:
    """A value on one line of YAML, quoted where it must be."""
    return (
        yaml.safe_dump(value, default_flow_style=True, width=10_000, allow_unicode=True).removesuffix("...\n").strip()
    )


def _relative(path: Path, home: Path) -> str:
    return Path(os.path.relpath(path, home)).as_posix()


def _ask(question: str, answers: Sequence[str], why: str) -> int:
    """Ask on the terminal; the first answer is proposed."""
    console = Console(stderr=True)
    console.print(f"{question}? ({why})", markup=False)
    for number, answer in enumerate(answers, start=1):
        console.print(f"  {number}  {answer}", markup=False, highlight=False)
    picks = [str(k + 1) for k in range(len(answers))]
    return IntPrompt.ask("your choice", choices=picks, default=1, console=console) - 1


def _nobody(question: str, answers: Sequence[str], why: str) -> None:
    """Leave a question open: the likeliest answer is taken, and said to be a guess."""


def draft(urdf: Path, files: Sequence[Path], out: Path, choose: Choose) -> tuple[str, Proposal, Measurements]:
    """Propose a campaign and try it: what comes back can be identified as it stands.

    Args:
        urdf: The robot.
        files: Its measurements.
        out: Where the campaign will be.
        choose: Asked where the evidence does not decide.

    Returns:
        The text of the campaign, what it rests on, and the measurements as it reads them.

    Raises:
        AridcalError: what in the files needs mending first.
    """
    table = read_tables(files)
    proposal = propose(read_bytes(urdf, RobotError), urdf, table, choose)
    text = campaign_text(proposal, urdf, files, out.parent)
    campaign = parse_settings(text, out, Campaign)
    robot = proposal.robot
    return text, proposal, load_measurements(campaign, robot.readings, joint_limits(robot), joint_kinds(robot))


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("init", __doc__)
    arguments.add_argument("--urdf", type=Path, required=True, help="the nominal robot")
    arguments.add_argument(
        "--measurements", type=Path, required=True, nargs="+", metavar="CSV", help="measured poses, .csv or .parquet"
    )
    arguments.add_argument(
        "-o", "--out", type=Path, default=Path("campaign.yaml"), help="where to write (default: campaign.yaml, here)"
    )
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments.urdf, arguments.measurements, arguments.out))


def _main(urdf: Path, files: Sequence[Path], out: Path) -> None:
    if out.exists():
        raise OutputError(f"{out}: is there already; delete it, or choose another name with -o")
    check_writable(out, "file")
    text, proposal, rows = draft(urdf, files, out, _ask if sys.stdin.isatty() else _nobody)
    with atomic_file(out) as path:
        path.write_text(text, encoding="utf-8")
    console = Console()
    for (why, sure), group in itertools.groupby(proposal.guesses, key=lambda g: (g.why, g.sure)):
        entries = [_last(g) + ("" if g.value is None else f" = {_scalar(g.value)}") for g in group]
        console.print("[green]found  [/green]" if sure else "[yellow]guessed[/yellow]", end="  ")
        console.print(f"{', '.join(entries)}: {why}", markup=False, highlight=False, soft_wrap=True)
    for remark in (*rows.refused, *rows.notices)[:5]:
        console.print(f"note     {remark}", markup=False, highlight=False, soft_wrap=True)
    console.print(f"{out}: {len(rows)} usable rows, {len(rows.refused)} refused", soft_wrap=True, highlight=False)
    console.print(f"next: aridcal identify {out}", soft_wrap=True, highlight=False)


if __name__ == "__main__":
    sys.exit(main())
