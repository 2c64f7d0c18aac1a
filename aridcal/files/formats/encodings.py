"""Which encoding a file of text is in."""

from __future__ import annotations

import codecs
from pathlib import Path

import charset_normalizer

from aridcal.system.errors import MeasurementError

ENCODING_SAMPLE = 200_000
"""Bytes from the beginning that are looked at: names of columns stand there."""

NOUGHTS_SHARE = 0.05
"""Share of noughts that UTF-16 has far more of."""

WESTERN = frozenset("äöüÄÖÜßàâáãåæçèéêëìíîïñòóôõøùúûÿÀÂÁÃÅÆÇÈÉÊËÌÍÎÏÑÒÓÔÕØÙÚÛ°µ±²³·×€–—’‘“”«»\u00a0§")
"""What Windows' own encoding of western Europe is used for: letters, degrees, micro, blanks that do not break."""


def encoding(content: bytes, path: Path) -> str:
    """Name of the encoding, as Python knows it.

    Raises:
        MeasurementError: it is none of text.
    """
    if content.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    begin = content[:ENCODING_SAMPLE]
    if b"\0" in begin:
        if begin.count(0) > NOUGHTS_SHARE * len(begin) or not _is_utf8(content):
            return _without_mark(begin, path)
        return "utf-8"  # a slip, which whoever reads the table names
    if _is_utf8(content):
        return "utf-8"
    western = begin.decode("cp1252", errors="replace")
    if all(letter.isascii() or letter in WESTERN for letter in western):
        return "cp1252"
    words = b"\n".join(line for line in begin.splitlines() if not line.isascii())  # numbers tell nothing, and dilute
    best = charset_normalizer.from_bytes(words).best()
    if best is None:
        raise MeasurementError(f"{path}: is not UTF-8 text, nor any other that is known; save it as UTF-8")
    try:
        content.decode(best.encoding)
    except (UnicodeError, LookupError):
        raise MeasurementError(f"{path}: is not UTF-8 text, nor {best.encoding} throughout; save it as UTF-8") from None
    return best.encoding


def _is_utf8(content: bytes) -> bool:
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _without_mark(begin: bytes, path: Path) -> str:
    """UTF-16 whose noughts stand at every second place."""
    even, odd = begin[::2].count(0), begin[1::2].count(0)
    most = max(len(begin) // 4, 1)
    if odd >= most and even == 0:
        return "utf-16-le"
    if even >= most and odd == 0:
        return "utf-16-be"
    raise MeasurementError(f"{path}: holds bytes of no text; name the table as text, or save it as UTF-8 or .xlsx")
