"""What every code of G-code does: RS274/NGC and LinuxCNC, FANUC and Haas mills, Siemens in its ISO codes, firmware of printers.

A code that is a row here does what the row says on all of them, or the row makes unknown what it does on any. A code that is no
row may do anything: nothing behind it is understood.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

INCH, MILLIMETRE = 0.0254, 1e-3

STRAIGHT, ARC = "straight", "arc"

NOTHING = ""
"""The value of a mode that is off."""

SLIDES, TURNS = "XYZUVW", "ABC"
"""Letters of sliding and of turning axes, in the order of the robot's joints."""

AXES = frozenset(SLIDES + TURNS)

START: Mapping[str, object] = {
    "distance": "absolute",
    "unit": MILLIMETRE,
    "work offset": "G54",
    "plane": "XY",
    "length": NOTHING,
    "radius": NOTHING,
    "zero": NOTHING,
    "local zero": NOTHING,
    "offsets": NOTHING,
    "scale": NOTHING,
    "mirror": NOTHING,
    "turn": NOTHING,
    "polar": NOTHING,
    "cylinder": NOTHING,
    "diameter": NOTHING,
}
"""Modes as a reset leaves them. Motion has no such value: controllers differ."""

STATED = {"distance": "G90", "unit": "G21", "work offset": "G54"}
"""Modes that a program should state itself; where it does not, the code is taken for granted, and that is said."""


@dataclass(frozen=True)
class Code:
    """A row of the table.

    Attributes:
        mode: The mode that it sets; empty if it sets none.
        value: To what; None: to something that no target can be read in.
        why: The reason then, for the user.
        takes: Letters that belong to it in its block.
        words: What axis words of its block are: a ``place`` to go to, one of the ``machine``, ``data`` that moves nothing, or
            these axes go ``home``, or all go ``away``.
    """

    mode: str = ""
    value: object = None
    why: str = ""
    takes: str = ""
    words: str = "place"


def _harmless(codes: str, takes: str = "") -> dict[str, Code]:
    return dict.fromkeys(codes.split(), Code(takes=takes))


def _sets(codes: str, mode: str, value: object, takes: str = "", words: str = "place") -> dict[str, Code]:
    return dict.fromkeys(codes.split(), Code(mode, value, "", takes, words))


def _hides(codes: str, mode: str, why: str, takes: str = "", words: str = "place") -> dict[str, Code]:
    return dict.fromkeys(codes.split(), Code(mode, None, why, takes, words))


OTHER_MOTION = "is no straight move: cycles, threads and probing are left"

CODES: Mapping[str, Code] = {
    # motion; G33 G31 G38 and the like bring the axes where only the controller knows
    **_sets("G0 G1", "motion", STRAIGHT),
    **_sets("G2 G3 G5 G5.1", "motion", ARC, "IJKRPQ"),
    **_hides("G5.2 G5.3 G6.1 G6.2", "motion", "is no straight move: curves are left", "IJKPQRL"),
    **_hides("G31 G31.1 G31.2 G31.3 G38.2 G38.3 G38.4 G38.5", "motion", OTHER_MOTION, "PQR"),
    **_hides("G33 G33.1 G34 G35 G74 G76 G84 G84.2 G84.3 G88", "motion", OTHER_MOTION, "IJKPQRLEH"),
    **_hides("G73 G81 G82 G83 G85 G86 G87 G89", "motion", OTHER_MOTION, "IJKPQRLE"),
    **_hides("G80", "motion", "stands behind G80, which ends all motion: controllers differ in what moves then"),
    # places
    **_sets("G90", "distance", "absolute"),
    **_hides("G91", "distance", "is a step from the place before (G91)"),
    **_sets("G20 G700", "unit", INCH),
    **_sets("G21 G710", "unit", MILLIMETRE),
    **_sets("G54 G55 G56 G57 G58 G59 G59.1 G59.2 G59.3", "work offset", "by name"),
    **_sets("G54.1", "work offset", "by name", "P"),
    **_hides("G154", "work offset", "the work offset is one of the further ones of Haas (G154)", "P"),
    **_hides("G500", "work offset", "no work offset acts that is known"),
    **_sets("G17 G17.1", "plane", "XY"),
    **_sets("G18 G19 G18.1 G19.1", "plane", "another"),
    # what shifts, turns and scales
    **_hides("G43", "length", "a length of a tool acts (G43) that only the controller knows", "H"),
    **_hides("G44 G43.1 G43.2 G43.3 G43.4 G43.5 G143 G234", "length", "the tool moves the zero", "HIJKPQ"),
    **_sets("G49", "length", NOTHING),
    **_hides("G41 G42", "radius", "the path lies beside by the cutter's radius", "D"),
    **_sets("G40", "radius", NOTHING),
    **_hides("G92", "zero", "the zero is set anew, to where only the controller is", words="data"),
    **_hides("G92.3", "zero", "the zero is set as it was once before"),
    **_sets("G92.1 G92.2", "zero", NOTHING, words="data"),
    **_hides("G52", "local zero", "a local zero acts", words="data"),
    **_hides("M73", "distance", "M73 keeps modes for the end of a subprogram", "PRCDQ"),
    **_hides("G10", "offsets", "offsets are written, so that they are not those of --frames", "LPQRIJKHD", "data"),
    **_hides("G51", "scale", "places are scaled", "IJKP", "data"),
    **_sets("G50", "scale", NOTHING, words="data"),
    **_hides("G51.1 G101", "mirror", "places are mirrored", "IJK", "data"),
    **_sets("G50.1 G100", "mirror", NOTHING, words="data"),
    **_hides("G68 G68.1 G68.2 G68.3 G68.4 G53.1 G254", "turn", "the coordinates are turned", "IJKPQRD", "data"),
    **_sets("G69", "turn", NOTHING),
    **_hides("G16", "polar", "X and Y are a radius and an angle"),
    **_sets("G15", "polar", NOTHING),
    **_hides("G12.1 G112 G7.1 G107", "cylinder", "X and Y are wound on a round part", "R", "data"),
    **_sets("G13.1 G113", "cylinder", NOTHING),
    **_hides("G7", "diameter", "X is a diameter"),
    **_sets("G8", "diameter", NOTHING, "P"),
    # away, and data; a place of the machine counts from no offset
    "G4": Code(takes="PQRKSEFLX", words="data"),
    "G28": Code(takes="P", words="home"),
    "G30": Code(takes="P", words="home"),
    "G53": Code(words="machine"),
    "M6": Code(words="away"),
    # how it goes, not where: exact stops, rounding, feeds, cycles' planes, arcs' centres
    **_harmless("G9 G11 G60 G61.1 G601 G602 G603 G641 G642 G643 G644 G645 G90.1 G91.1 G93 G94 G95 G98 G99 G450 G451"),
    **_harmless("G61 G64 G187", "PQR"),
    **_harmless("G96", "D"),
    **_harmless("G97"),
    # stops, spindle, coolant, gears, clamps, conveyors, gates, overrides, inputs and outputs, temperatures
    **_harmless("M0 M1 M2 M30", "P"),
    **_harmless("M3 M4 M5 M7 M8 M9 M10 M11 M12 M13 M14 M16 M29 M31 M32 M33 M34 M35 M38 M39 M40 M41 M42 M43 M44", "PQR"),
    **_harmless("M19", "PQR"),
    **_harmless("M45 M48 M49 M51 M52 M53 M82 M83 M88 M89", "P"),
    **_harmless("M62 M63 M64 M65", "P"),
    **_harmless("M66 M67 M68", "PLQE"),
    **_harmless("M104 M105 M106 M107 M108 M109 M140 M141 M190 M191", "PRTI"),
    **_harmless("M98", "PLQ"),
    **_harmless("M99"),
}
"""By the code's letter and number, without zeros in front."""

CYCLES = frozenset(code for code, row in CODES.items() if row.why == OTHER_MOTION)
"""Holes and threads on FANUC and LinuxCNC; where no axis words stand beside, Fagor and Heidenhain turn and scale by some."""

ADDED_OFFSETS = frozenset(["G58", "G59"])
"""Work offsets; on Siemens they add their axis words to the zero."""

CURVES = frozenset(["G5", "G5.1"])
"""FANUC's switches for fast machining where their block has no axis words: harmless then."""

CALLS = frozenset(["G65", "G66", "G66.1", "M98"])
"""They call the program that P names."""

MACHINE_WIDE = ("unit", "distance", "scale", "mirror", "turn", "polar", "cylinder", "diameter")
"""Modes that matter to a place of the machine (G53); offsets and lengths do not."""

CHANGE = "M6"
"""It puts the tool in that a T has named before: in a program that has it, T alone moves nothing."""

ENDS, RETURNS = frozenset({"M2", "M30"}), "M99"

WILD = {
    "M96": "calls a program whenever a signal comes (M96)",
    "M97": "calls lines of its own program (M97)",
}
"""What leads to other lines in a way that is not followed."""

FREE = frozenset("NFST")
"""Letters that every block may have: its number, feed, spindle, tool."""

CURVED = frozenset("IJKPQRL")
"""Letters of blocks that go on with an arc or a cycle."""

CENTRE = frozenset("IJ")
"""Letters that only arcs have, where cycles have none."""

EXTRUDER = "E"
"""Material that a printer puts out; on others a feed."""

VARIABLES = ((1, 199), (400, 999), (1100, 1135), (3000, 3006), (3011, 3012))
"""Numbers of variables that no controller has for offsets, tools and modes: the user's, outputs, alarms, stops, clocks."""
