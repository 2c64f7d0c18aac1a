"""Programs in which something changes what a target means: what stands between ⟦ ⟧ must be left, between ⟨ ⟩ corrected."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Attack:
    """A program.

    Attributes:
        name: What is done in it.
        files: Texts by their names, with marks; the first is the program.
        frames: A file of ``--frames``.
        why: A part of the reason that must be given.
    """

    name: str
    files: dict[str, str]
    frames: str = ""
    why: str = ""
