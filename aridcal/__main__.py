"""The console script: ``aridcal COMMAND …`` is ``python -m aridcal.COMMAND …``."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from aridcal import __version__
from aridcal.command_line import run
from aridcal.system.errors import AridcalError, nearest

COMMANDS = {
    "init": "write a campaign for a URDF and a table of measurements",
    "merge": "a log of joints and a log of a tracker, with a clock each, to a table of measurements",
    "identify": "calibrate: from a campaign to a calibrated URDF, a report and a 3D scene",
    "predict": "poses of the real target for rows of joint readings",
    "compensate": "joint commands that bring the real target to wanted poses",
    "export": "the model for whoever runs it: C, NumPy, CasADi, ROS 2, MuJoCo, Gazebo, tables",
    "guide": "be led while measuring: is the row good, which pose is next, when is it enough",
    "design": "configurations to measure next, and how well the target is known then",
    "check": "is a calibration still good, from a few new rows, and if not, what moved",
    "recalibrate": "mend a calibration with a few rows after something moved",
    "compare": "what changed between two calibrations, beyond their uncertainty",
    "history": "each robot's errors and constants over months, drifts and jumps, worst first",
    "print": "boards, cubes of tags and sockets for a ball, to print at true scale",
    "detect": "corners of printed boards and tags in images, as a table",
    "measure": "measured poses from camera images and sonar ranges",
    "view": "3D scene of a result in the browser",
    "simulate": "simulate a campaign with a known truth",
    "fleet": "calibrate many robots, here or on a Dask cluster, with a page on all of them",
    "study": "repeat a simulation many times: errors, and what is found how often",
    "doctor": "check this installation",
    "completion": "complete commands with Tab in your shell",
}
"""Modules with a ``main``, and the job of each."""

USAGE = "\n".join(
    ["usage: aridcal COMMAND …", "", "commands:"]
    + [f"  {command:<11} {job}" for command, job in COMMANDS.items()]
    + ["", "`aridcal COMMAND --help` explains a command; `aridcal --version` prints the version."]
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    command = arguments[0] if arguments else None
    if command in ("-h", "--help"):
        return run(lambda: print(USAGE))
    if command == "--version":
        return run(lambda: print(f"aridcal {__version__}"))
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
