"""The console script: ``aridcal COMMAND …`` is ``python -m aridcal.COMMAND …``."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from aridcal import __version__
from aridcal.commands import run
from aridcal.errors import AridcalError, nearest

COMMANDS = {
    "init": "URDF and measurements in; a campaign to start from out",
    "identify": "campaign in; calibrated URDF, figures and pictures out",
    "predict": "where the real target is, for each row of joints",
    "compensate": "joint commands that bring the real target to wanted poses",
    "measure": "camera images and sonar ranges to measured poses",
    "view": "nominal and calibrated robot in the browser",
    "simulate": "make a campaign with a known truth",
    "doctor": "check this installation",
    "completion": "complete commands with Tab in your shell",
}
"""Modules with a ``main``, and the job of each."""

USAGE = "\n".join(
    ["usage: aridcal COMMAND …", "", "commands:"]
    + [f"  {command:<11} {job}" for command, job in COMMANDS.items()]
    + ["", "`aridcal COMMAND --help` tells more; `aridcal --version` tells the version."]
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    command = arguments[0] if arguments else None
    if command in ("-h", "--help"):
        print(USAGE)
        return 0
    if command == "--version":
        print(f"aridcal {__version__}")
        return 0
    if command not in COMMANDS:
        return run(lambda: _refuse(command))
    # Imported only now: what one command needs, Pinocchio for instance, would make all of them slow to start.
    return int(importlib.import_module(f"aridcal.{command}").main(arguments[1:]))


def _refuse(command: str | None) -> None:
    if command is None:
        raise AridcalError(f"no command\n{USAGE}")
    raise AridcalError(f"unknown command {command!r}{nearest(command, COMMANDS)}\n`aridcal --help` lists all")


if __name__ == "__main__":
    sys.exit(main())
