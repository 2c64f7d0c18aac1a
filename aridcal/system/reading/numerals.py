"""Numbers as people write them, made those that programs read: decimal commas, grouped digits."""

from __future__ import annotations

import re

import pyarrow as pa
import pyarrow.compute as pc

from aridcal.system.reading.dialect import Dialect

GROUPS = ("", ".", ",", "'", " ")
"""What may group digits by three."""

LIKE_A_NUMBER = r"^[-+]?[\d.,' ]*\d[\d.,' ]*([eE][-+]?\d+)?$"
"""Digits with any marks between them."""

LOOKALIKE_CHARACTERS = {"\u2212": "-", "\u00a0": " ", "\u202f": " ", "\u2009": " ", "\u2019": "'"}
"""Characters that look like the usual one: minus, blanks that do not break or are thin, an apostrophe."""

NO_NUMBER = "'"
"""Put before what looks like a number and is not written as the file's numbers are, so that nobody takes it for one."""

NUMBERS_IN_LIST = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
"""Numbers in a cell that holds several."""


def pattern(dialect: Dialect) -> str:
    """What a number looks like in a dialect, as a regular expression."""
    integer = r"\d+"
    if dialect.thousands:
        integer = rf"(?:\d{{1,3}}(?:{re.escape(dialect.thousands)}\d{{3}})+|\d+)"
    point = re.escape(dialect.decimal)
    return rf"^[-+]?(?:{integer}(?:{point}\d*)?|{point}\d+)(?:[eE][-+]?\d+)?$"


def as_numbers(column: pa.ChunkedArray, dialect: Dialect) -> pa.ChunkedArray:
    """A column of text with its numbers written with a point and no groups.

    Args:
        column: Text, null where empty.
        dialect: How numbers are written.

    Returns:
        The same text where it is no number. What is one in another dialect alone, ``1.5`` among decimal commas, is made none.
    """
    text = pc.utf8_trim_whitespace(column)
    for odd, usual in LOOKALIKE_CHARACTERS.items():
        text = pc.replace_substring(text, odd, usual)
    number = pc.match_substring_regex(text, pattern(dialect))
    plain = pc.replace_substring(text, dialect.thousands, "") if dialect.thousands else text
    if dialect.decimal != ".":
        plain = pc.replace_substring(plain, dialect.decimal, ".")
    number_like = pc.match_substring_regex(text, LIKE_A_NUMBER)
    words = pc.if_else(number_like, pc.binary_join_element_wise(NO_NUMBER, text, ""), column)
    return pc.if_else(number, plain, words)


def numbers_in_list(cell: str, dialect: Dialect) -> list[str]:
    """The numbers in a cell that holds a list, with points."""
    if dialect.decimal != ".":
        cell = cell.replace(dialect.decimal, ".")
    return NUMBERS_IN_LIST.findall(cell)
