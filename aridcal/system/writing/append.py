"""Rows behind those of a table that others read while it grows; the one file that is not written whole."""

from __future__ import annotations

from pathlib import Path


def append(path: Path, text: str) -> None:
    """Put a few lines behind those of a file, or into a new one: one write, so that a reader sees whole lines or a begun one."""
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text)
