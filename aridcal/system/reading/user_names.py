"""Names of a user, of joints and of files: refused where they would break what they are written into."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from aridcal.system.errors import AridcalError, has_controls, printable, shortened

LONGEST_NAME = 500
"""Characters of the name of a joint, a link, a column or a label: any that a person gives is shorter, and so are messages."""


def reason_of(problem: Exception) -> str:
    """What the operating system says against a name or a file."""
    return getattr(problem, "strerror", None) or str(problem)


def check_name(name: str, what: str, error: type[AridcalError]) -> None:
    """Refuse a name that would break the lines of messages, tables and YAML files that it is written into.

    Args:
        name: Of a joint, a link, a column, a station.
        what: Where it stands, for the message.
        error: The kind of error to raise.

    Raises:
        AridcalError: of the given kind; the message shows the name with its control characters spelt out.
    """
    if has_controls(name):
        raise error(
            f"{what}: the name '{shortened(printable(name))}' holds a control character or a line break: rename it"
        )
    if len(name) > LONGEST_NAME:
        raise error(
            f"{what}: the name {shortened(name)!r} has {len(name):,} characters, at most {LONGEST_NAME} are read"
        )


def check_path(path: Path, error: type[AridcalError]) -> None:
    """Refuse a name that no file can have, or that would break the lines of messages.

    Raises:
        AridcalError: of the given kind, with the name shortened.
    """
    name = shortened(printable(str(path)))
    if any("\udc80" <= c <= "\udcff" for c in str(path)):  # how Python shows bytes that it cannot read
        raise error(
            f"{name}: the name of this file is not {sys.getfilesystemencoding().upper()}, as this session reads names: rename it"
        )
    if has_controls(str(path)):
        raise error(f"{name}: the name of this file holds a control character: rename it")
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return
    except (OSError, ValueError) as problem:
        raise error(f"{name}: cannot be the name of a file: {reason_of(problem)}. Give another one") from None


def path_argument(text: str) -> Path:
    """A path of the command line: the ``type`` of an argument of argparse."""
    try:
        check_path(Path(text), AridcalError)
    except AridcalError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from None
    return Path(text)
