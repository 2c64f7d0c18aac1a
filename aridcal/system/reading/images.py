"""Images that a table names: in its folder alone, and how large their headers say they are."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path

from aridcal.system.errors import AridcalError
from aridcal.system.reading.regular_files import Limit, read_file
from aridcal.system.reading.user_names import check_path


def read_image_file(name: str, folder: Path, limit: Limit) -> bytes:
    """Read an image, undecoded.

    Args:
        name: As a table in the folder has it.
        folder: Beyond which nothing is read.
        limit: How large the file may be.

    Raises:
        AridcalError: there is no such image in the folder, or it cannot be read. The message does not repeat the name.
    """
    if not name:
        raise AridcalError("no image is named: fill in the column")
    path = folder / name
    try:
        check_path(path, AridcalError)
        inside = path.resolve().is_relative_to(folder.resolve())
        content = read_file(path, AridcalError, limit) if inside and path.exists() else b""
    except RuntimeError:  # how Python 3.11 and 3.12 call a link to itself
        raise AridcalError("the image is a link that leads round in a circle: put the file there") from None
    except AridcalError as problem:
        raise AridcalError(f"the image cannot be read: {str(problem).removeprefix(f'{path}: ')}") from None
    if not inside:
        raise AridcalError("the image lies outside the folder of the shots: move it there")
    if not content:
        raise AridcalError("there is no such image: check its name")
    return content


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
    """Size in a PNG's first chunk. No chunk may claim more bytes than there are: OpenCV makes room for 4 GB before it looks."""
    place = 8
    for _ in range(MOST_SEGMENTS):
        length, kind = struct.unpack_from(">I4s", content, place)
        place += 12 + length
        if place > len(content):
            raise ValueError("a chunk is cut off")
        if kind == b"IEND":
            width, height = struct.unpack_from(">II", content, 16)
            return width, height
    raise ValueError("chunks without end")


def _jpeg(content: bytes) -> tuple[int, int]:
    """Size in the frame header of a JPEG, behind any number of other segments."""
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
    """Size of the first image of a TIFF: its tags 256 and 257."""
    order = "<" if content[:2] == b"II" else ">"
    (place,) = struct.unpack_from(f"{order}I", content, 4)
    (count,) = struct.unpack_from(f"{order}H", content, place)
    sizes = {}
    for k in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", content, place + 2 + 12 * k)
        if tag in (256, 257):
            (sizes[tag],) = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, place + 10 + 12 * k)
    return sizes.get(256, 0), sizes.get(257, 0)


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


MOST_SEGMENTS = 100_000
"""Segments before the frame header of a JPEG, where there are some hundreds with a large colour profile; and chunks of a PNG,
which may have one for every 8 kB."""

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
