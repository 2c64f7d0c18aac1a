"""Print a script for your shell: it completes commands, options and file names after Tab.

bash reads it from the folder in the example, zsh from a file `_aridcal` in a folder of $fpath; tcsh sources it.

Example:
    aridcal completion bash > ~/.local/share/bash-completion/completions/aridcal
"""

from __future__ import annotations

import argparse
import importlib
import sys

import shtab

from aridcal.__main__ import COMMANDS
from aridcal.command_line import CommandParser, command, command_parser
from aridcal.system.reading.user_names import path_argument


def whole_parser() -> argparse.ArgumentParser:
    """All commands with all their arguments as one parser; where a path is meant, file names complete it."""
    everything = argparse.ArgumentParser(prog="aridcal")
    commands = everything.add_subparsers()
    for name, job in COMMANDS.items():
        arguments = importlib.import_module(f"aridcal.{name}").parser()
        for action in arguments._actions:
            if action.type is path_argument:
                action.complete = shtab.FILE
        commands.add_parser(name, parents=[arguments], add_help=False, help=job)
    return everything


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("completion", __doc__)
    arguments.add_argument("shell", choices=shtab.SUPPORTED_SHELLS, help="which shell")
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    print(shtab.complete(whole_parser(), arguments.shell))


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
