"""Points that a program states in one place and goes to in others: in which frames, with which tools."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Frame = np.ndarray | str
"""A transform of shape (4, 4), or why it is not known."""

NEVER = "no move of this file goes there, so that its frame and tool are not known"


@dataclass(frozen=True)
class Use:
    """How a move comes to a point.

    Attributes:
        base: T_base_frame of the frame that the point is in.
        tool: T_tip_tool of what is to be there.
    """

    base: Frame
    tool: Frame

    @property
    def why(self) -> str:
        """Why the place is not known; empty if it is."""
        return next((part for part in (self.base, self.tool) if isinstance(part, str)), "")

    def same(self, other: Use) -> bool:
        """True where both mean the same place of the same tip."""
        pairs = ((self.base, other.base), (self.tool, other.tool))
        return all(
            a == b if isinstance(a, str) or isinstance(b, str) else bool(np.allclose(a, b, atol=1e-9)) for a, b in pairs
        )


def one_use(uses: Sequence[Use]) -> Use:
    """The use that all moves make of a point; one that says why where they differ, or where there is none."""
    if not uses:
        return Use(NEVER, NEVER)
    if all(uses[0].same(other) for other in uses[1:]):
        return uses[0]
    why = "moves go there in different frames or with different tools: give each its own point"
    return Use(why, why)


def known(frame: Frame) -> np.ndarray | None:
    """The transform, if it is known."""
    return None if isinstance(frame, str) else frame
