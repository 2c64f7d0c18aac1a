"""Programs with constructs that change what a target means: what is marked ⟦…⟧ must be left, what is marked ⟨…⟩ corrected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Attack:
    """A project with a trap.

    Attributes:
        name: What changes the meaning.
        files: Texts by name, with marks around numbers or literals.
        frames: A file of ``--frames``; empty for none.
        why: Words that the reason of what is left should have.
    """

    name: str
    files: Mapping[str, str] = field(default_factory=dict)
    frames: str = ""
    why: str = ""
