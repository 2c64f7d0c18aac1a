"""An attack and its control are one text: with the trap in it, what is marked ⟦…⟧ must be left; without, corrected."""

from __future__ import annotations

from collections.abc import Mapping

from program_attacks import Attack

SLOT = "§"
"""Where in a text the trap stands."""


def twins(
    name: str,
    files: Mapping[str, str],
    trap: str | tuple[str, ...],
    plain: str | tuple[str, ...] = "",
    frames: str = "",
    why: str = "",
) -> tuple[Attack, Attack]:
    """The attack, and the same project without its trap as the control.

    Args:
        name: What changes the meaning.
        files: Texts with a slot § for each part of the trap, in the order of the files.
        trap: What is put in, one text for all slots, or one for each.
        plain: What is put in where there is no trap, likewise.
        frames: A file of ``--frames``.
        why: Words that the reason of what is left should have.
    """
    control = {file: text.replace("⟦", "⟨").replace("⟧", "⟩") for file, text in filled(files, plain).items()}
    return Attack(name, filled(files, trap), frames, why), Attack(f"control: {name}", control, frames)


def filled(files: Mapping[str, str], parts: str | tuple[str, ...]) -> dict[str, str]:
    """Texts with their slots filled."""
    slots = sum(text.count(SLOT) for text in files.values())
    rest = [parts] * slots if isinstance(parts, str) else list(parts)
    assert len(rest) == slots, f"{len(rest)} parts for {slots} slots"
    answer = {}
    for file, text in files.items():
        pieces = text.split(SLOT)
        answer[file] = "".join(piece + (rest.pop(0) if k < len(pieces) - 1 else "") for k, piece in enumerate(pieces))
    return answer
