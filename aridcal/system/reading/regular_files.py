"""Files that a user names, read whole: regular files only, no larger than they may be."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path

from aridcal.system.errors import AridcalError, printable, shortened
from aridcal.system.reading.user_names import LONGEST_NAME, reason_of

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

TABLE_LIMIT = Limit(500, "table_mb")
"""A million rows of 24 numbers with all their digits; read, it takes some three times as much memory."""

IMAGE = Limit(100, "image_mb")
"""100 megapixels of grey levels without any compression."""

SETTINGS = Limit(1)
"""Written by hand: some 20,000 lines."""

CALIBRATION = Limit(50)
"""The URDF as text, and two covariances of a thousand coefficients each."""

RESULT = Limit(500)
"""Pages and figures of a result folder, meshes included."""

SPECIAL_FILES = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
"""Files that wait for ever or never end when they are read, and what they are."""


def read_file(path: Path, error: type[AridcalError], limit: Limit) -> bytes:
    """Read a whole file that the user named: nothing is waited for, and no more than the limit is ever in memory.

    Args:
        path: The file; links to regular files are followed.
        error: The kind of error to raise.
        limit: How large it may be.

    Raises:
        AridcalError: of the given kind, if there is no such file, or it is none, empty, too large or cannot be read.
    """
    name = shortened(printable(str(path)), LONGEST_NAME)
    try:
        _check_regular(path.stat(), name, error, limit)  # before opening: some devices act on that alone
        with open(path, "rb", opener=_without_waiting) as file:
            status = os.fstat(file.fileno())
            _check_regular(status, name, error, limit)  # it may be another one by now
            content = file.read(status.st_size + 1)
    except FileNotFoundError:
        raise error(f"{name}: there is no such file; check its name") from None
    except (OSError, ValueError) as problem:
        raise error(f"{name}: cannot be read: {reason_of(problem)}; check the file and who may read it") from None
    if len(content) > status.st_size:
        raise error(f"{name}: grew while it was read: wait until it is complete")
    if not content or content.isspace():
        raise error(f"{name}: is empty; write it anew, or name another file")
    return content


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check_regular(status: os.stat_result, name: str, error: type[AridcalError], limit: Limit) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{name}: is a folder, not a file; name a file in it")
    if not stat.S_ISREG(status.st_mode):
        kind = next((kind for is_kind, kind in SPECIAL_FILES if is_kind(status.st_mode)), "no regular file")
        raise error(f"{name}: is {kind}; only regular files are read: save its content as a file")
    if status.st_size > limit.megabytes * MEGA:
        size = status.st_size / MEGA
        raise error(f"{name}: has {size:,.1f} MB, at most {limit.megabytes:g} MB are read; {limit.remedy}")
    if not status.st_size:  # also what the kernel makes up while it is read, as under /proc
        raise error(f"{name}: is empty; write it anew, or name another file")


def not_utf8(content: bytes, place: int, path: Path, error: type[AridcalError]) -> AridcalError:
    """The error for text in another encoding, with the line of its first byte that shows it."""
    line = content.count(b"\n", 0, place) + 1
    return error(f"{path}, line {line}: is not UTF-8 text; save the file as UTF-8")
