"""FANUC listings by somebody who had not seen the reader: tracking, tasks beside, indirect frames, what TB and TA call."""

from __future__ import annotations

from program_attacks import Attack

FRAMES = """format: 1
bases:
  "0": {xyz: [0, 0, 0], rpy: [0, 0, 0]}
  "1": {xyz: [0.1, 0, 0], rpy: [0, 0, 0]}
  "2": {xyz: [0.3, 0, 0], rpy: [0, 0, 0]}
tools: {"1": {xyz: [0, 0, 0.12], rpy: [0, 0, 0]}, "2": {xyz: [0, 0, 0.2], rpy: [0, 0, 0]}}
"""
JOINTS = """   GP1:
\tUF : 1, UT : 1,\t
\tJ1=     5.000 deg,\tJ2=   -90.000 deg,\tJ3=    90.000 deg,
\tJ4=    10.000 deg,\tJ5=    85.000 deg,\tJ6=    12.000 deg
"""
POSE = """   {group}:
\tUF : {frame}, UT : {tool},\t\tCONFIG : 'N U T, 0, 0, 0',
\tX = {opening} {x}  mm,\tY = -310.200  mm,\tZ =  420.700  mm,
\tW =  178.100 deg,\tP =    1.200 deg,\tR =   12.300 deg{closing}{extra}
"""
HEAD = """/PROG  {name}
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "{comment}";
PROG_SIZE\t= 912;
DEFAULT_GROUP\t= 1,*,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
{appl}/MN
"""


def _pose(opening: str, closing: str, **other: str) -> str:
    plain = {"group": "GP1", "frame": "1", "tool": "1", "x": "512.500", "extra": ""}
    return POSE.format(opening=opening, closing=closing, **(plain | other))


def _listing(
    name: str, lines: str, points: dict[int, str] | None = None, comment: str = "weld side", appl: str = ""
) -> str:
    out = [HEAD.format(name=name, comment=comment, appl=appl)]
    for number, line in enumerate(lines.strip("\n").replace("\n:", " \f").split("\n"), 1):
        first, *more = line.split("\f")
        gap = "" if line[:2] in ("J ", "L ", "C ", "A ") else "  "
        out.append("\n    :  ".join([f"{number:4d}:{gap}{first}", *more]) + "    ;\n")
    out.append("/POS\n")
    out += [f"P[{k}]{{\n{text}}};\n" for k, text in (points or {}).items()]
    return "".join(out) + "/END\n"


LEFT, DONE = ("⟦", "⟧"), ("⟨", "⟩")
MARKS = {"-": LEFT, "+": DONE, ".": ("", "")}


def _case(
    name: str, lines: str, marks: str, appl: str = "", frames: str = FRAMES, comment: str = "weld side", **files: str
) -> Attack:
    """A listing whose first point is one of joints; `marks` says of each further point whether it must be left or corrected."""
    points = {1: JOINTS} | {k: _pose(*MARKS[mark]) for k, mark in enumerate(marks, 2)}
    head = "UFRAME_NUM=1\nUTOOL_NUM=1\nJ P[1] 50% FINE\n"
    return Attack(
        name,
        {
            "CELL.LS": _listing("CELL", head + lines, points, comment, appl),
            **{f"{key}.LS": text for key, text in files.items()},
        },
        frames,
    )


def _own(name: str, lines: str, points: dict[int, str]) -> Attack:
    head = "UFRAME_NUM=1\nUTOOL_NUM=1\nJ P[1] 50% FINE\n"
    return Attack(name, {"CELL.LS": _listing("CELL", head + lines, {1: JOINTS} | points)}, FRAMES)


TRACKED = """/APPL
  LINE_TRACK;
    LINE_TRACK_SCHEDULE_NUMBER      : 1;
    LINE_TRACK_BOUNDARY_NUMBER      : 1;
    CONTINUE_TRACK_AT_PROG_END      : FALSE;
"""

ATTACKS = [
    _case(
        "plain moves with many words",
        "L P[2] 100mm/sec CNT50 ACC80 RT_LD10\nJ P[3:over part] 30% FINE PTH\n"
        "L P[4] R[1]mm/sec FINE TB .10sec,DO[3]=ON\nL P[5] max_speed CNT100 Wjnt\n"
        "L P[6] 4000cm/min FINE DB 5.0mm,DO[1]=OFF",
        "+++++",
    ),
    _case("a program of line tracking", "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE", "--", appl=TRACKED),
    _case(
        "a called program of line tracking moves its own points alone",
        "L P[2] 100mm/sec FINE\nCALL TRK\nL P[3] 100mm/sec FINE",
        "++",
        TRK=_listing("TRK", "L P[1] 200mm/sec FINE", {1: _pose(*LEFT)}, appl=TRACKED),
    ),
    _case(
        "TB calls a program that changes the tool",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec CNT50 TB .50sec,CALL CHG\nL P[4] 100mm/sec FINE",
        ".--",
        CHG=_listing("CHG", "UTOOL_NUM=2"),
    ),
    _case(
        "TA calls a program that writes a frame",
        "L P[2] 100mm/sec FINE TA .20sec,CALL MEAS\nL P[3] 100mm/sec FINE",
        "--",
        MEAS=_listing("MEAS", "PR[7]=LPOS\nUFRAME[1]=PR[7]"),
    ),
    _case(
        "a task beside it changes the frame",
        "L P[2] 100mm/sec FINE\nRUN BESIDE\nL P[3] 100mm/sec FINE",
        "--",
        BESIDE=_listing("BESIDE", "PR[7,1]=R[5]\nUFRAME[1]=PR[7]"),
    ),
    _case(
        "a condition handler changes the tool",
        "L P[2] 100mm/sec FINE\nMONITOR WATCH1\nL P[3] 100mm/sec FINE\nMONITOR END WATCH1",
        ".-",
        WATCH1=_listing("WATCH1", "WHEN DI[1]=ON,CALL CHG"),
        CHG=_listing("CHG", "UTOOL_NUM=2"),
    ),
    _case("a frame of an index is written", "L P[2] 100mm/sec FINE\nUFRAME[R[3]]=PR[4]\nL P[3] 100mm/sec FINE", "--"),
    _case("a tool of an index is written", "UTOOL[R[3]]=PR[4]\nL P[2] 100mm/sec FINE", "-"),
    _case(
        "the frame's number is an argument",
        "L P[2] 100mm/sec FINE\nCALL SETF(2)\nL P[3] 100mm/sec FINE",
        "+-",
        SETF=_listing("SETF", "UFRAME_NUM=AR[1]"),
    ),
    _case(
        "the frame's number by a system variable",
        "L P[2] 100mm/sec FINE\n$MNUFRAMENUM[1]=2\nL P[3] 100mm/sec FINE",
        "+-",
    ),
    _case("the frame by a system variable", "$MNUFRAME[1,1]=PR[3]\nL P[2] 100mm/sec FINE", "-"),
    _case(
        "the tool by a system variable of the group",
        "L P[2] 100mm/sec FINE\n$GROUP[1].$UTOOL=PR[3]\nL P[3] 100mm/sec FINE",
        "+-",
    ),
    _case("the tool by $MNUTOOL", "$MNUTOOL[1,1]=PR[3]\nL P[2] 100mm/sec FINE", "-"),
    _case(
        "a touch offset",
        "L P[2] 100mm/sec FINE\nTouch Offset PR[5]\nL P[3] 100mm/sec FINE\nTouch Offset End\nL P[4] 100mm/sec FINE",
        "+-+",
    ),
    _case(
        "tracking of the seam",
        "L P[2] 100mm/sec FINE\nTrack TAST[1]\nL P[3] 100mm/sec FINE\nTrack End\nL P[4] 100mm/sec FINE",
        "+-+",
    ),
    _case(
        "a pass with offset",
        "L P[2] 100mm/sec FINE\nMultipass Offset PR[5]\nL P[3] 100mm/sec FINE\nMultipass Offset End",
        "+-",
    ),
    _case(
        "an offset by vision",
        "VISION RUN_FIND 'PART'\nVISION GET_OFFSET 'PART' VR[1] JMP LBL[9]\n"
        "L P[2] 100mm/sec FINE VOFFSET,VR[1]\nL P[3] 100mm/sec FINE\nLBL[9]",
        "-+",
    ),
    _case(
        "an offset of vision as a condition",
        "VOFFSET CONDITION VR[1]\nL P[2] 100mm/sec FINE VOFFSET\nL P[3] 100mm/sec FINE",
        "-+",
    ),
    _case("an offset in a continuation line", "L P[2] 100mm/sec FINE\n:Offset,PR[3]\nL P[3] 100mm/sec FINE", "-+"),
    _case("an arc over two lines", "C P[2]\n:P[3] 100mm/sec FINE\nL P[4] 100mm/sec FINE", "+++"),
    _case(
        "an arc over two lines with an offset",
        "C P[2]\n:P[3] 100mm/sec FINE Offset,PR[2]\nL P[4] 100mm/sec FINE",
        "--+",
    ),
    _case("arcs by A", "L P[2] 100mm/sec FINE\nA P[3] 100mm/sec CNT100\nA P[4] 100mm/sec FINE", "+++"),
    _case("a point copied into a register", "PR[5]=P[2]\nL P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE", "-+"),
    _case("a point written whole", "P[2]=LPOS\nL P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE", "-+"),
    _case("a point of an index is written", "P[R[1]]=PR[4]\nL P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE", "--"),
    _case("points of an index are gone to", "L P[R[1]] 100mm/sec FINE Offset,PR[1]\nL P[2] 100mm/sec FINE", "-"),
    _case(
        "mixed logic chooses the tool",
        "L P[2] 100mm/sec FINE\nIF (DI[1] AND R[2]>3) THEN\nUTOOL_NUM=2\nENDIF\nL P[3] 100mm/sec FINE",
        "+-",
    ),
    _case(
        "IF with JMP over the tool",
        "L P[2] 100mm/sec FINE\nIF DI[1]=ON,JMP LBL[1]\nUTOOL_NUM=2\nLBL[1]\nL P[3] 100mm/sec FINE",
        "+-",
    ),
    _case("IF with an assignment", "L P[2] 100mm/sec FINE\nIF (DI[1]),UTOOL_NUM=(2)\nL P[3] 100mm/sec FINE", "+-"),
    _case(
        "SELECT over lines",
        "L P[2] 100mm/sec FINE\nSELECT R[1]=1,CALL CHG\n:=2,JMP LBL[3]\n:ELSE,JMP LBL[3]\nLBL[3]\n"
        "L P[3] 100mm/sec FINE",
        "+-",
        CHG=_listing("CHG", "UTOOL_NUM=2"),
    ),
    _case("a loop back from another frame", "LBL[1]\nL P[2] 100mm/sec FINE\nUFRAME_NUM=2\nIF R[1]<5,JMP LBL[1]", "-"),
    _case("FOR with another tool", "FOR R[1]=1 TO 3\nL P[2] 100mm/sec FINE\nUTOOL_NUM=R[1]\nENDFOR", "-"),
    _case("a macro by its name", "L P[2] 100mm/sec FINE\nCHANGE HAND\nL P[3] 100mm/sec FINE", "+-"),
    _case(
        "remarked lines",
        "!UTOOL_NUM=2\n//UFRAME_NUM=2\n--eg:UTOOL_NUM=2\nL P[2] 100mm/sec FINE\n"
        "//L P[2] 100mm/sec FINE Offset,PR[1]\nL P[3] 100mm/sec FINE",
        "++",
    ),
    _case("a comment in the header that looks like a part", "L P[2] 100mm/sec FINE", "+", comment="/POS P[2]{ }"),
    _case(
        "palletizing",
        "L P[2] 100mm/sec FINE\nPALLETIZING-B_1\nJ PAL_1[A_1] 100% FINE\n"
        "L PAL_1[BTM] 100mm/sec FINE\nPALLETIZING-END_1\nL P[3] 100mm/sec FINE",
        "++",
    ),
    _case("increments with another word between", "L P[2] 100mm/sec FINE ACC50 INC\nL P[3] 100mm/sec FINE", "-+"),
    _case("coordinated motion", "L P[2] 100mm/sec FINE COORD\nL P[3] 100mm/sec FINE", "-+"),
    _case(
        "the tool's offset as a condition",
        "TOOL_OFFSET CONDITION PR[2]\nL P[2] 100mm/sec FINE Tool_Offset\nL P[3] 100mm/sec FINE",
        "-+",
    ),
    _case(
        "the offset's condition has its own frame",
        "OFFSET CONDITION PR[2],UFRAME[2]\nL P[2] 100mm/sec FINE Offset\nL P[3] 100mm/sec FINE",
        "-+",
    ),
    _case(
        "high-speed skip keeps where it was",
        "SKIP CONDITION DI[1]=ON\nL P[2] 100mm/sec FINE Skip,LBL[1],PR[5]=LPOS\nLBL[1]\nL P[3] 100mm/sec FINE",
        "++",
    ),
    _case(
        "what changes nothing of the geometry",
        "OVERRIDE=50%\nPAYLOAD[2]\nDO[1]=ON\nDO[2]=PULSE,0.5sec\nWAIT   .50(sec)\n"
        "WAIT DI[1]=ON TIMEOUT,LBL[9]\nR[1]=R[1]+1\nTIMER[1]=START\nCOL DETECT ON\nMESSAGE[go on]\n"
        "UALM[1]\nPR[20]=LPOS\nL P[2] 100mm/sec FINE\nLBL[9:end]\nL P[3] 100mm/sec FINE",
        "++",
    ),
    _own(
        "a frame of F is the frame that acts",
        "L P[2] 100mm/sec FINE\nUFRAME_NUM=2\nL P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose(*LEFT, frame="F"), 3: _pose(*DONE, frame="2")},
    ),
    _own(
        "the frame of the point is not the one that acts",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose(*LEFT, frame="2"), 3: _pose(*DONE)},
    ),
    _own(
        "the tool of the point is not the one that acts",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose(*LEFT, tool="2"), 3: _pose(*DONE)},
    ),
    _own(
        "a point that was never taught",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose(*LEFT, x="********"), 3: _pose(*DONE)},
    ),
    _own(
        "inches",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose(*LEFT).replace(" mm", " in"), 3: _pose(*DONE)},
    ),
    _own(
        "a rail in the group",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose(*LEFT, extra=",\n\tE1=   100.000  mm"), 3: _pose(*DONE)},
    ),
    _own(
        "a second group has the same letters",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose("⟨", "⟩") + "   GP2:\n\tUF : 0, UT : 1,\t\n\tJ1=    30.000 deg\n", 3: _pose(*DONE)},
    ),
    _own(
        "only the second group is a robot",
        "L P[2] 100mm/sec FINE\nL P[3] 100mm/sec FINE",
        {2: _pose(*LEFT, group="GP2"), 3: _pose(*DONE)},
    ),
]
