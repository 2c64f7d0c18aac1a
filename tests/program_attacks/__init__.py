"""Programs with constructs that change what a target means: data for the readers' tests.

Numbers between ⟦ and ⟧ must be left as they are, those between ⟨ and ⟩ must be corrected.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Attack:
    """A project that a reader could take for a plainer one.

    Attributes:
        name: What it does.
        files: Texts by name; the first is the program to be corrected.
        frames: A file of frames; empty: each test's own.
        why: A part of the reason that the user is to read.
    """

    name: str
    files: dict[str, str]
    frames: str = ""
    why: str = ""
