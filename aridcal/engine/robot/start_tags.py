"""Start tags of XML as text: one attribute changed, every other byte kept."""

from __future__ import annotations

import re

_NAME = re.compile(r"<[^\s/>]+")
_ATTRIBUTE = re.compile(r"""\s+(?P<key>[^\s=]+)\s*=\s*(?P<quoted>"[^"]*"|'[^']*')""", re.ASCII)


def codec_of(xml: bytes) -> str:
    """Codec in which markup can be read and written: all but UTF-16 agree on ASCII, and the rest may stay bytes."""
    if xml[:2] == b"\xff\xfe" or xml[1:2] == b"\0":
        return "utf-16-le"
    if xml[:2] == b"\xfe\xff" or xml[:1] == b"\0":
        return "utf-16-be"
    return "latin-1"


def with_attribute(tag: str, key: str, new_key: str, value: str, quote: str = '"') -> str:
    """Replace an attribute in a text that begins with a start tag, or add it after the others.

    Args:
        tag: The text.
        key: Of the attribute that is replaced.
        new_key: What it is called afterwards.
        value: Its new value.
        quote: What stands around it, where it is added.
    """
    start = _NAME.match(tag)
    end = start.end() if start else 0
    while match := _ATTRIBUTE.match(tag, end):
        end = match.end()
        if match["key"] == key:
            (first, _), (opening, closing) = match.span("key"), match.span("quoted")
            between = tag[match.end("key") : opening + 1]
            return tag[:first] + new_key + between + value + tag[closing - 1 :]
    return f"{tag[:end]} {new_key}={quote}{value}{quote}{tag[end:]}"
