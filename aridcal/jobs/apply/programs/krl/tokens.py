"""Words, numbers and signs of a line of KRL."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from aridcal.jobs.apply.programs.krl.syntax import Fields, Text, Word
from aridcal.jobs.apply.programs.text import Number, Numbers

_NUMBER = r"[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:e[-+]?\d++)?"

_VALUE = rf"(?:{_NUMBER}|#[a-z_]\w*+|\"[^\"\n]*+\"|true|false)"

_NAME = r"[a-z_]\w*+(?:\[\])?"

_PLAIN = (
    r"\{[ \t]*+(?:(?:e6pos|pos|frame|e6axis|axis|fdat|pdat|ldat)[ \t]*+:[ \t]*+)?"
    rf"{_NAME}[ \t]++{_VALUE}[ \t]*+(?:,[ \t]*+{_NAME}[ \t]++{_VALUE}[ \t]*+)*\}}"
)
"""An aggregate of plain values, which is what most lines of long programs have."""

_FIELD = re.compile(rf"[{{,:][ \t]*+([a-z_]\w*+)(?:\[\])?[ \t]++(?:({_NUMBER})|(#[a-z_]\w*+)|[\"tf])", re.ASCII)

_TOKEN = re.compile(
    rf"[ \t\r]*+(?:(?P<plain>{_PLAIN})|(?P<number>(?:\d++(?:\.\d*+)?|\.\d++)(?:e[-+]?\d++)?(?![\w$.]))|(?P<name>[a-z_$][\w$]*+)"
    r"|(?P<word>#[ \t]*+[a-z_]\w*+)|(?P<text>\"[^\"\n]*+\")|(?P<bits>'[ \t]*+[bh][ \t]*+[0-9a-f]++[ \t]*+')"
    r"|(?P<sign>==|<>|<=|>=|[-+*/=<>(){}\[\],:.?&]))",
    re.ASCII,
)

GIVEN = re.compile(
    rf"[ \t]*+decl[ \t]++(?:(?P<shared>global)[ \t]++)?(?P<kind>[a-z_]\w*+)[ \t]++(?P<name>[a-z_$][\w$]*+)[ \t]*+="
    rf"[ \t]*+(?P<plain>{_PLAIN})[ \t\r]*+",
    re.ASCII,
)
"""``DECL E6POS XP1={X 1,Y 2,...}``, as data lists of long programs consist of."""

_STRINGS_AND_COMMENTS = re.compile(r'"[^"\n]*+"|;[^\n]*+')

NAME = re.compile(r"[a-z_$][\w$]*+", re.ASCII)


class MalformedStatement(Exception):
    """A statement is not written as the language has it."""


class Token(NamedTuple):
    """A word, a number or a sign.

    Attributes:
        kind: ``name``, ``number``, ``word``, ``text``, ``bits``, ``sign``, or ``plain``: an aggregate of plain values.
        text: In small letters.
        start: Its place in the file.
        end: Behind it.
    """

    kind: str
    text: str
    start: int
    end: int


def plain(text: str) -> str:
    """The text in small letters, comments as blanks and texts as blanks in quotes: every place keeps its number."""
    return _STRINGS_AND_COMMENTS.sub(_blank, text).lower()


def _blank(match: re.Match[str]) -> str:
    blanks = " " * (match.end() - match.start() - 2)
    return f'"{blanks}"' if match.group().startswith('"') else " " * (match.end() - match.start())


def tokens(text: str, start: int, end: int) -> list[Token]:
    """All tokens between two places.

    Raises:
        Misread: something there is none.
    """
    line: list[Token] = []
    while start < end:
        match = _TOKEN.match(text, start, end)
        if match is None:
            if text[start:end].strip(" \t\r"):
                raise MalformedStatement
            break
        kind = match.lastgroup
        assert kind is not None
        begin, start = match.span(kind)
        line.append(Token(kind, text[begin:start], begin, start))
    return line


def fields(low: str, text: str, token: Token) -> Mapping[str, Number | Word | Text]:
    """Fields of an aggregate of plain values.

    Args:
        low: The text in small letters.
        text: As it stands.
        token: The aggregate.

    Raises:
        Misread: a name stands there twice.
    """
    matches = list(_FIELD.finditer(low, token.start, token.end))
    names = tuple([match.group(1) for match in matches])
    if len(set(names)) < len(names):
        raise MalformedStatement
    spans = [match.span(2) for match in matches]
    if all(start >= 0 for start, _ in spans):
        return Fields(names, Numbers.packed(spans, [text[start:end] for start, end in spans]))
    values: dict[str, Number | Word | Text] = {}
    for name, match, (start, end) in zip(names, matches, spans, strict=True):
        word = match.group(3)
        values[name] = Number(start, text[start:end]) if start >= 0 else Word(word) if word else Text()
    return values
