"""Who can be given a calibration, by which option, and the error that remains there: a row each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class Receiver:
    """One way to hand a calibration over.

    Attributes:
        who: Who takes it.
        option: Of ``aridcal export``.
        holds: How much of the calibration it takes: the ``final`` model with its effects, or the ``geometric`` one.
    """

    who: str
    option: str
    holds: Literal["final", "geometric"]


RECEIVERS: tuple[Receiver, ...] = (
    Receiver("a controller's loop in C or C++", "--c DIR", "final"),
    Receiver("Python with NumPy alone", "--numpy FILE.py", "final"),
    Receiver("optimal control with CasADi", "--casadi FILE.casadi", "final"),
    Receiver("MuJoCo", "--mjcf FILE.xml", "geometric"),
    Receiver("Gazebo", "--sdf FILE.sdf", "geometric"),
    Receiver("a description in xacro", "--xacro FILE.xacro", "geometric"),
    Receiver("a policy trained on many arms", "--randomize N -o DIR", "geometric"),
)
"""In the order in which they are listed."""

HOLDS = {"final": "the whole model", "geometric": "geometry alone"}


def remaining(receiver: Receiver, result: Mapping[str, Any] | None) -> str:
    """What is still wrong with the target where a receiver has the calibration, RMS on held-out rows, in words.

    Args:
        receiver: Who has it.
        result: What ``result.json`` holds; None where there is none.
    """
    parts = (result or {}).get("error", {}).get(receiver.holds, {})
    figures = parts.get("test") or parts.get("train") or {}
    shown = [
        f"{of['rms']:.3f} {channel.rsplit('_', 1)[1]}" for channel, of in figures.items() if of.get("rms") is not None
    ]
    rows = "held-out" if parts.get("test") else "fitted"
    return f"{' and '.join(shown)} on {rows} rows" if shown else "not in this folder: no result.json"
