"""Names of joints and columns as identifiers of C and Python."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence

C_WORDS = frozenset(
    {
        *("auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern"),
        *("float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed"),
        *("sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while"),
    }
)
"""Keywords of C99."""


def identifier(name: str) -> str:
    """A name with all that no identifier may hold replaced by ``_``."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_") or "unnamed"
    plain = f"n{plain}" if plain[0].isdigit() else plain
    return f"{plain}_" if plain in C_WORDS or keyword.iskeyword(plain) else plain


def different(names: Sequence[str]) -> list[str]:
    """Identifiers of some names, each another one."""
    result: list[str] = []
    for name in names:
        plain, k = identifier(name), 2
        while plain in result:
            plain, k = f"{identifier(name)}_{k}", k + 1
        result.append(plain)
    return result


def is_identifier(name: str) -> bool:
    """True for a name that C takes."""
    return re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) is not None and name not in C_WORDS
