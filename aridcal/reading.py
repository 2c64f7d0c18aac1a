"""Files that a user names, read safely: regular files only, no larger than they may be, under names that can be shown."""

from __future__ import annotations

import argparse
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from aridcal.errors import AridcalError, has_controls, printable, shortened

LONGEST_NAME = 500
"""Characters of the name of a joint, a link, a column or a label: any that a person gives is shorter, and so are messages."""

MEGA = 1e6


@dataclass(frozen=True)
class Limit:
    """How large a file of one sort may be.

    Attributes:
        megabytes: At most; more is refused before it is read.
        key: The key of a campaign or of head.yaml that raises it; empty if none does.
    """

    megabytes: float
    key: str = ""

    @property
    def remedy(self) -> str:
        """What to do about a file that is larger."""
        return f"raise `limits: {{{self.key}: …}}` if it is meant to be" if self.key else "name another file"


URDF = Limit(20, "urdf_mb")
"""Text alone, without meshes: that of a humanoid with hands takes 0.3 MB."""

TABLE = Limit(500, "table_mb")
"""A million rows of 24 numbers with all their digits; read, it takes some three times as much memory."""

IMAGE = Limit(100, "image_mb")
"""100 megapixels of grey levels without any compression."""

SETTINGS = Limit(1)
"""Written by hand: some 20,000 lines."""

CALIBRATION = Limit(50)
"""The URDF as text, and two covariances of a thousand coefficients each."""

RESULT = Limit(500)
"""Pages and figures of a result folder, meshes included."""

KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
"""What waits for ever or never ends when it is read."""


def read_file(path: Path, error: type[AridcalError], limit: Limit) -> bytes:
    """Read a whole file that the user named: nothing is waited for, and no more than the limit is ever in memory.

    Args:
        path: The file; links to regular files are followed.
        error: The kind of error to raise.
        limit: How large it may be.

    Raises:
        AridcalError: of the given kind, if there is no such file, or it is none, empty, too large or cannot be read.
    """
    shown = shortened(printable(str(path)), LONGEST_NAME)
    try:
        _check_regular(path.stat(), shown, error, limit)  # before opening: some devices act on that alone
        with open(path, "rb", opener=_without_waiting) as file:  # noqa: PTH123
            _check_regular(os.fstat(file.fileno()), shown, error, limit)  # it may be another one by now
            content = file.read(int(limit.megabytes * MEGA) + 1)
    except FileNotFoundError:
        raise error(f"{shown}: there is no such file") from None
    except (OSError, ValueError) as problem:
        raise error(f"{shown}: cannot be read: {why(problem)}") from None
    if len(content) > limit.megabytes * MEGA:  # it grew
        _too_large(shown, len(content), error, limit)
    if not content or content.isspace():
        raise error(f"{shown}: is empty")
    return content


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check_regular(status: os.stat_result, shown: str, error: type[AridcalError], limit: Limit) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{shown}: is a folder, not a file")
    if not stat.S_ISREG(status.st_mode):
        kind = next((kind for is_kind, kind in KINDS if is_kind(status.st_mode)), "no regular file")
        raise error(f"{shown}: is {kind}; only regular files are read: save its content as a file")
    if status.st_size > limit.megabytes * MEGA:
        _too_large(shown, status.st_size, error, limit)
    if not status.st_size:  # also what the kernel makes up while it is read, as under /proc
        raise error(f"{shown}: is empty")


def _too_large(shown: str, size: int, error: type[AridcalError], limit: Limit) -> NoReturn:
    raise error(f"{shown}: has {size / MEGA:,.1f} MB, at most {limit.megabytes:g} MB are read; {limit.remedy}")


def why(problem: Exception) -> str:
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
    shown = shortened(printable(str(path)))
    if has_controls(str(path)):
        raise error(f"{shown}: the name of this file holds a control character: rename it")
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return
    except (OSError, ValueError) as problem:
        raise error(f"{shown}: cannot be the name of a file: {why(problem)}. Give another one") from None


def path_argument(text: str) -> Path:
    """A path of the command line: the ``type`` of an argument of argparse."""
    try:
        check_path(Path(text), AridcalError)
    except AridcalError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from None
    return Path(text)
