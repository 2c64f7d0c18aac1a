"""Files that a user names, read safely: regular files only, no larger than they may be, under names that can be shown."""

from __future__ import annotations

import argparse
import os
import re
import stat
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

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
        with open(path, "rb", opener=_without_waiting) as file:
            status = os.fstat(file.fileno())
            _check_regular(status, shown, error, limit)  # it may be another one by now
            content = file.read(status.st_size + 1)
    except FileNotFoundError:
        raise error(f"{shown}: there is no such file") from None
    except (OSError, ValueError) as problem:
        raise error(f"{shown}: cannot be read: {why(problem)}") from None
    if len(content) > status.st_size:
        raise error(f"{shown}: grew while it was read: wait until it is complete")
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
        size = status.st_size / MEGA
        raise error(f"{shown}: has {size:,.1f} MB, at most {limit.megabytes:g} MB are read; {limit.remedy}")
    if not status.st_size:  # also what the kernel makes up while it is read, as under /proc
        raise error(f"{shown}: is empty")


def image_size(content: bytes) -> tuple[int, int] | None:
    """Width and height of an image as its header states them, [px]: a few bytes can ask for gigabytes of pixels.

    Args:
        content: A file: PNG, JPEG, TIFF, BMP, PGM and its kin, or WebP.

    Returns:
        None of anything else, and of a header that is cut off.
    """
    for magic, size in IMAGE_SIZES.items():
        if content.startswith(magic):
            try:
                width, height = size(content)
            except (struct.error, ValueError, IndexError):
                return None
            return (width, height) if width > 0 and height > 0 else None
    return None


def _png(content: bytes) -> tuple[int, int]:
    width, height = struct.unpack_from(">II", content, 16)
    return width, height


def _jpeg(content: bytes) -> tuple[int, int]:
    """Of the frame header, behind any number of other segments."""
    place = 2
    for _ in range(MOST_SEGMENTS):
        marker, kind, length = struct.unpack_from(">BBH", content, place)
        if marker != 0xFF:
            raise ValueError("no segment starts here")
        if kind == 0xFF:  # a fill byte
            place += 1
        elif kind in JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", content, place + 5)
            return width, height
        else:
            place += 2 + length
    raise ValueError("segments without end")


def _tiff(content: bytes) -> tuple[int, int]:
    """Of the first image of the file: its tags 256 and 257."""
    order = "<" if content[:2] == b"II" else ">"
    (place,) = struct.unpack_from(f"{order}I", content, 4)
    (count,) = struct.unpack_from(f"{order}H", content, place)
    found = {}
    for k in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", content, place + 2 + 12 * k)
        if tag in (256, 257):
            (found[tag],) = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, place + 10 + 12 * k)
    return found.get(256, 0), found.get(257, 0)


def _bmp(content: bytes) -> tuple[int, int]:
    (header,) = struct.unpack_from("<I", content, 14)
    width, height = struct.unpack_from("<HH" if header == 12 else "<ii", content, 18)
    return width, abs(height)  # negative where the first row is the uppermost


def _netpbm(content: bytes) -> tuple[int, int]:
    words = re.sub(rb"#[^\n]*", b" ", content[:1000]).split()
    return int(words[1]), int(words[2])


def _webp(content: bytes) -> tuple[int, int]:
    kind = content[12:16]
    if content[8:12] != b"WEBP" or kind not in (b"VP8 ", b"VP8L", b"VP8X"):
        raise ValueError("no WebP")
    if kind == b"VP8X":
        numbers = int.from_bytes(content[24:30].ljust(6, b"\0"), "little")
        return 1 + (numbers & 0xFFFFFF), 1 + (numbers >> 24)
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", content, 26)
    return width & 0x3FFF, height & 0x3FFF


MOST_SEGMENTS = 10_000
"""Before the frame header of a JPEG; there are some ten, and some hundreds with a large colour profile."""

JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of frame headers; the other three are tables."""

IMAGE_SIZES: dict[bytes, Callable[[bytes], tuple[int, int]]] = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8": _jpeg,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"BM": _bmp,
    **dict.fromkeys((b"P1", b"P2", b"P3", b"P4", b"P5", b"P6"), _netpbm),
    b"RIFF": _webp,
}
"""What each sort of image starts with, and how its size is read."""


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
