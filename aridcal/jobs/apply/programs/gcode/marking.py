"""A comment in a G-code program that no controller takes for a command."""

from __future__ import annotations

BRACKETS = str.maketrans("()", "[]")
"""Comments in comments end too early on some controllers, and are errors on others."""


def comment(text: str, sentence: str) -> tuple[int, str]:
    """A comment at the end: behind the closing ``%``, or behind the last block, where no block's line changes.

    Args:
        text: The program.
        sentence: One line.
    """
    end = "\r\n" if "\r\n" in text else "\n" if "\n" in text or "\r" not in text else "\r"
    words = " ".join(sentence.encode("ascii", "replace").decode().translate(BRACKETS).split())
    before = "" if not text or text.endswith(("\n", "\r")) else end
    return len(text), f"{before}({words}){end}"
