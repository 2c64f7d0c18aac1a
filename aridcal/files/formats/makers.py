"""Whose export a file is, by what its maker writes at its beginning. All from documentation: see docs/formats.md."""

from __future__ import annotations

import re
from collections.abc import Sequence

SIGNS: tuple[tuple[str, str], ...] = (
    ("OptiTrack Motive", r"^\s*\"?Format Version,1\.\d+"),
    ("Vicon", r"\A\s*(Trajectories|Segments|Joints|Objects|Model Outputs)[,;\t ]*\r?\n\s*[\d.]+"),
    ("Qualisys Track Manager", r"^(FILE_VERSION|NO_OF_FRAMES|NO_OF_BODIES)\s"),
    ("NDI", r"^\"?(Tools|Frame)\"?,.*(Port \d|Q0,Qx,Qy,Qz,Tx,Ty,Tz)"),
    ("SpatialAnalyzer", r"SpatialAnalyzer|\bSA (Version|v?\d{4}\.)|New River Kinematics"),
    ("PolyWorks", r"PolyWorks|InnovMetric|IMInspect"),
    ("Leica/Hexagon", r"Leica|Hexagon|\bAT ?9[0-9]0|\bAT40[0-9]|T-Mac|\bemScon\b|\bRMS6D\b"),
    ("FARO", r"\bFARO\b|\bCAM2\b|\bVantage\b"),
    ("API", r"\bAPI (Radian|Tracker|OT2|iLT)|\bRadian\b|SmartTRACK|\bSTS\b|Automated Precision"),
    ("RoboDK", r"RoboDK"),
)
"""Makers and programs, and what their files begin with, the most certain first."""


def maker(lines: Sequence[str]) -> str:
    """Who wrote a file; empty where nothing says so."""
    text = "\n".join(lines)
    return next((name for name, sign in SIGNS if re.search(sign, text, re.MULTILINE)), "")
