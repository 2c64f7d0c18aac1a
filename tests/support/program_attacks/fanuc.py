"""TP programs whose points do not mean what they say, from the operator's manual, and beside each the same without it.

P[1] is what the construct changes, P[2] is where the arm goes before it.
"""

from __future__ import annotations

from collections.abc import Sequence

from program_attacks import Attack

FRAMES = """format: 1
bases: {"1": {xyz: [0.1, 0, 0], rpy: [0, 0, 0.3]}, "2": {xyz: [0, 0.2, 0], rpy: [0, 0, 0]}}
tools: {"1": {xyz: [0, 0, 0.1], rpy: [0, 0, 0]}, "2": {xyz: [0, 0, 0.2], rpy: [0, 0.1, 0]}}
"""

LEFT, RIGHT = ("⟦", "⟧"), ("⟨", "⟩")


def point(
    number: int, marks: tuple[str, str] = ("", ""), user: str = "1", tool: str = "1", config: str = "N U T, 0, 0, 0"
) -> str:
    """A pose in /POS, its X between marks."""
    stated = f"\t\tCONFIG : '{config}'," if config else ""
    return (
        f"P[{number}]{{\n   GP1:\n\tUF : {user}, UT : {tool},{stated}\n"
        f"\tX =   {marks[0]}80{number}.250{marks[1]}  mm,\tY =   -98.244  mm,\tZ =   402.635  mm,\n"
        "\tW =  -179.204 deg,\tP =     1.377 deg,\tR =   -68.968 deg\n};\n"
    )


def listing(
    lines: Sequence[str], points: Sequence[str] = (), name: str = "MAIN", header: str = "", after: str = ""
) -> str:
    """A program: moves begin with their letter, other instructions are set in by two blanks, as the controller does."""
    body = "".join(
        f"{k:4d}:{line if line[:2] in ('J ', 'L ', 'C ', 'A ') else '  ' + line}    ;\n"
        for k, line in enumerate(lines, start=1)
    )
    return f"/PROG  {name}\n/ATTR\nDEFAULT_GROUP\t= 1,*,*,*,*;\n{header}/MN\n{body}/POS\n{''.join(points)}/END\n{after}"


START = ("UFRAME_NUM=1", "UTOOL_NUM=1", "L P[2] 100mm/sec FINE")

GO = "L P[1] 100mm/sec FINE"

FRAME_SET = ("PR[1]=LPOS", "PR[1]=PR[1]-PR[1]", "UFRAME[1]=PR[1]")
"""The frame is certain, whatever other programs have done before."""

SETS_FRAME = listing(["UFRAME[1]=PR[9]"], name="SUB")

OPTIONS = (
    ("a step from where the arm is", "INC"),
    ("an offset register that nobody knows", "Offset,PR[1]"),
    ("a tool offset register that nobody knows", "Tool_Offset,PR[1]"),
    ("an offset without its condition", "Offset"),
    ("a tool offset without its condition", "Tool_Offset"),
    ("an offset whose register is worked out", "Offset,PR[R[1]]"),
    ("an offset in a local register", "Offset,LPR[1]"),
    ("an offset in another frame", "Offset,PR[1],UFRAME[2]"),
    ("an offset behind a harmless option", "ACC80 Offset,PR[1]"),
    ("an offset behind a time", "TB .05sec,DO[77]=ON Tool_Offset,PR[1]"),
    ("an offset in small letters", "offset,pr[1]"),
    ("an offset with blanks", "Offset , PR [ 1 : way ]"),
    ("a camera's offset", "VOFFSET,VR[1]"),
    ("a camera's offset by its condition", "VOFFSET"),
    ("a tool that stands", "RTCP"),
    ("a frame that moves", "COORD"),
    ("a frame that moves by a leader", "COORD[2]"),
    ("a turn by the shorter way", "MROT"),
    ("an option that the manual does not have", "XYZ5"),
)

BEFORE: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("an offset condition", ("OFFSET CONDITION PR[1]",)),
    ("a user frame from a register", ("UFRAME[1]=PR[9]",)),
    ("a user frame of group 1 from a register", ("UFRAME[GP1:1]=PR[9]",)),
    ("a user frame in small letters", ("uframe[1]=pr[9]",)),
    ("a user frame with blanks", ("UFRAME [ 1 ] = PR [ 9 ]",)),
    ("a user frame whose number is worked out", ("UFRAME[R[1]]=PR[9]",)),
    ("a tool from a register", ("UTOOL[1]=PR[9]",)),
    ("a tool whose number is an argument", ("UTOOL[AR[1]]=PR[9]",)),
    ("a system variable of user frames", ("$MNUFRAME[1,1]=PR[9]",)),
    ("a system variable of tools", ("$MNUTOOL[1,1]=PR[9]",)),
    ("a system variable of the active frame", ("$MNUFRAMENUM[1]=2",)),
    ("a system variable of offsets", ("$PARAM_GROUP[1].$OFFSET_CART=1",)),
    ("another active user frame", ("UFRAME_NUM=2",)),
    ("another active tool", ("UTOOL_NUM=2",)),
    ("another active user frame of group 1", ("UFRAME_NUM[GP1,GP2]=2",)),
    ("another active user frame on every way", ("IF (R[1]=1) THEN", "UFRAME_NUM=2", "ELSE", "UFRAME_NUM=2", "ENDIF")),
    ("another active user frame behind a jump", ("JMP LBL[7]", "UFRAME_NUM=1", "LBL[7]", "UFRAME_NUM=2")),
    ("a program that no file has", ("CALL GRIP",)),
    ("a program that no file has, with arguments", ("CALL GRIP(1,'a;b')",)),
    ("a program that no file has, on a condition", ("IF R[1]=1,CALL GRIP",)),
    (
        "a program that no file has, in a selection",
        ("SELECT R[1]=1,CALL GRIP", "=2,JMP LBL[1]", "ELSE,JMP LBL[1]", "LBL[1]"),
    ),
    ("a program whose name is worked out", ("CALL SR[1]",)),
    ("a task that no file has", ("RUN GRIP",)),
    ("a handler that no file has", ("MONITOR GRIP",)),
    ("an error program that no file has", ("ERROR_PROG=GRIP",)),
    ("a macro", ("Open hand 1",)),
    ("an instruction in German", ("BENUTZER_NUM=2",)),
    ("a conveyor", ("LINE[1] ON",)),
    ("a conveyor's trigger", ("SETTRIG LNSCH[1] R[1]",)),
    ("seam tracking", ("Track TAST[1]",)),
    ("a touch offset", ("Touch Offset PR[1]",)),
    ("a touch search", ("Search Start[1] PR[1]",)),
    ("an offset of passes", ("MP Offset PR[1] RPM[1]",)),
    ("soft float", ("SOFTFLOAT[1]",)),
    ("soft float on a condition", ("IF (R[1]=1) THEN", "SOFTFLOAT[1]", "ENDIF")),
    ("a force control", ("FORCE CTRL[1]",)),
    ("a sensor", ("SENSOR_ON[1]",)),
    ("two instructions on a line", ("R[1]=1 ; UFRAME[1]=PR[9]",)),
    ("a remark and an instruction on a line", ("!frame ; UFRAME[1]=PR[9]",)),
    ("a name with a bracket", ("R[1:a]b]=1",)),
    ("a name with a quote", ("R[1:don't]=1 + R[2:it's]",)),
    ("an instruction on two lines", ("UFRAME[1]=\n    :  PR[9]",)),
    ("an instruction without an end", ("R[1]=1\n  99:  UFRAME[1]=PR[9]",)),
    ("a branch that is never closed", ("IF (R[1]=1) THEN",)),
    ("a loop that is never closed", ("FOR R[1]=1 TO 3",)),
    ("an end of a loop that began nowhere", ("ENDFOR",)),
)
"""Instructions between the moves to P[2] and P[1]."""

ANYWHERE: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("a point set to where the arm is", ("P[1]=LPOS",)),
    ("a point set to a register", ("P[1]=PR[2]",)),
    ("an element of a point", ("P[1,3]=5",)),
    ("a point with a name set anew", ("P[1:a place]=JPOS",)),
    ("a register set to the point", ("PR[1]=P[1]",)),
    ("a register set to the point in small letters", ("pr[1]=p[1]",)),
    ("a sum with the point", ("PR[1]=P[1]+PR[2]",)),
    ("a difference with the point", ("PR[1]=PR[2]-P[1:a]",)),
    ("an element of the point in a register", ("R[1]=P[1,1]",)),
    ("the point given to a program", ("CALL SUB(P[1])",)),
    ("the point given on a condition", ("IF R[1]=1,CALL SUB(1,P[1])",)),
    ("the point in a branch", ("IF (R[1]=1) THEN", "PR[1]=P[1]", "ENDIF")),
    ("the point in a mixed condition", ("IF (R[1]=1),PR[1]=P[1]",)),
    ("the point where nothing comes", ("JMP LBL[9]", "PR[1]=P[1]", "LBL[9]")),
)
"""Instructions behind the moves, which use or set P[1]."""

EVERY_POINT: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("any point set to where the arm is", ("P[R[1]]=LPOS",)),
    ("any point in a register", ("PR[R[2]]=P[R[1]]",)),
    ("a move to any point", ("L P[R[1]] 100mm/sec FINE",)),
    ("a move to any point by an argument", ("J P[AR[1]] 100% FINE",)),
    ("any point given to a program", ("CALL SUB(P[R[1]])",)),
)

SUBS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("a called program that sets the frame", ("CALL SUB",)),
    ("a called program that sets the frame, in a loop", ("FOR R[1]=1 TO 3", "CALL SUB", "ENDFOR")),
    ("a task that sets the frame", ("RUN SUB",)),
    ("a task that sets the frame, and never ends", ("RUN ENDLESS",)),
    ("a task that sets the frame, and is given up", ("RUN STOPPED",)),
    ("a task that calls what sets the frame", ("RUN CALLS",)),
    ("a task that starts what sets the frame", ("RUN STARTS",)),
    ("a task that calls what no file has", ("RUN LOST",)),
    ("an error program that sets the frame", ("ERROR_PROG=SUB",)),
    ("a resume program that sets the frame", ("RESUME_PROG[1]=SUB",)),
    ("a program at a time before a move", ("L P[3] 100mm/sec FINE TB .10sec,CALL SUB",)),
    ("a program at a distance before a move", ("L P[3] 100mm/sec FINE DB 5.0mm,CALL SUB",)),
    ("a handler whose program sets the frame", ("MONITOR HANDLER",)),
    ("a selection of programs", ("SELECT R[1]=1,CALL SUB", "=2,CALL EMPTY", "ELSE,CALL EMPTY")),
)

BOTH = [point(1, LEFT), point(2, RIGHT)]

NEITHER = [point(1, LEFT), point(2, LEFT)]

HANDLER = listing(["WHEN DI[1]=ON,CALL SUB"], name="HANDLER")

BEGUN = ("UTOOL_NUM=1", "UFRAME_NUM=1")

OTHERWISE = ("UFRAME_NUM=2", "LBL[1]", GO)

TASKS = {
    name: listing(lines, name=name)
    for name, lines in {
        "EMPTY": ["R[1]=1"],
        "ENDLESS": ["LBL[1]", "UFRAME[1]=PR[9]", "JMP LBL[1]"],
        "STOPPED": ["UFRAME[1]=PR[9]", "ABORT"],
        "CALLS": ["LBL[1]", "IF R[1]=1,CALL SUB", "JMP LBL[1]"],
        "STARTS": ["LBL[1]", "RUN SUB", "JMP LBL[1]"],
        "LOST": ["LBL[1]", "CALL GRIP", "JMP LBL[1]"],
    }.items()
}

ACTIVE: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("the active frame where none is set", ("UTOOL_NUM=1", GO)),
    ("the active frame from a register", ("UFRAME_NUM=R[1]", "UTOOL_NUM=1", GO)),
    ("the active frame from an argument", ("UFRAME_NUM=AR[1]", "UTOOL_NUM=1", GO)),
    ("the active frame of a branch", (*BEGUN, "IF (R[1]=1) THEN", "UFRAME_NUM=2", "ENDIF", GO)),
    ("the active frame of a condition", (*BEGUN, "IF (R[1]=1),UFRAME_NUM=2", GO)),
    ("the active frame of a loop", (*BEGUN, "LBL[1]", GO, "UFRAME_NUM=2", "JMP LBL[1]")),
    ("the active frame of a counted loop", (*BEGUN, "FOR R[1]=1 TO 2", GO, "UFRAME_NUM=2", "ENDFOR")),
    ("the active frame of a called program", (*BEGUN, "CALL OTHER", GO)),
    ("two moves in two frames", (*BEGUN, GO, "UFRAME_NUM=2", GO)),
    ("two moves with two tools", (*BEGUN, GO, "UTOOL_NUM=2", GO)),
    ("a jump whose label is worked out", (*BEGUN, "JMP LBL[R[1]]", "LBL[2]", *OTHERWISE)),
    ("a jump on a condition", (*BEGUN, "IF R[1]=1,JMP LBL[1]", *OTHERWISE)),
    ("a jump on a time-out", (*BEGUN, "WAIT DI[1]=ON TIMEOUT,LBL[1]", *OTHERWISE)),
    ("a jump where a camera sees nothing", (*BEGUN, "VISION GET_OFFSET 'A' VR[1] JMP LBL[1]", *OTHERWISE)),
    ("a jump where a search ends", (*BEGUN, "L P[3] 9mm/sec FINE Skip,LBL[1]", *OTHERWISE)),
    ("a jump where a search is cut off", (*BEGUN, "L P[3] 9mm/sec FINE SkipJump,LBL[1]", *OTHERWISE)),
)
"""Programs to P[1] in the active frame and tool."""

KNOWN = ("PR[1]=LPOS", "PR[1]=PR[1]-PR[1]", "PR[1,3]=50")
"""A register whose shift is certain."""

SHIFTED = "L P[1] 100mm/sec FINE Offset,PR[1]"

REGISTERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("a shift that turns", ("PR[1,4]=10",)),
    ("a shift by a register's number", ("PR[1,1]=R[1]",)),
    ("a shift by what is worked out", ("PR[1,1]=PR[1,1]*R[2]",)),
    ("a shift in a branch", ("IF (R[1]=1),PR[1,1]=5",)),
    ("a shift in a loop", ("LBL[1]", "PR[1,1]=PR[1,1]+5", "IF R[1]=1,JMP LBL[1]")),
    ("a shift in a register whose number is worked out", ("PR[R[1]]=LPOS",)),
    ("an element whose number is worked out", ("PR[1,R[2]]=5",)),
    ("a shift set by a search", ("L P[3] 9mm/sec FINE Skip,LBL[1],PR[1]=LPOS", "LBL[1]")),
    ("a shift set to joints", ("PR[1]=JPOS",)),
    ("a shift set to a frame", ("PR[1]=UFRAME[2]",)),
    ("a shift set by a called program", ("CALL SHIFTS",)),
    ("a shift set by a task", ("RUN SHIFTS",)),
    ("a shift added to another", ("PR[1]=PR[1]+PR[2]",)),
    ("a shift from the point itself", ("PR[1]=PR[1]+P[3]",)),
)
"""What takes the certainty of a register away."""

DATA: tuple[tuple[str, str], ...] = (
    ("a point twice", point(1, LEFT) + point(1, LEFT)),
    ("a point that is not taught", point(1, LEFT).replace("-98.244", "********")),
    ("a point of another group", point(1, LEFT).replace("GP1", "GP2")),
    ("a point with a group twice", point(1, LEFT).replace("\n};", "\n   GP1:\n\tUF : 2, UT : 1,\n};")),
    ("a point with CONFIG of a SCARA", point(1, LEFT, config="L, 0, 0, 0")),
    ("a point with CONFIG in other letters", point(1, LEFT, config="N L U T, 0, 0, 0")),
    ("a point with a number twice", point(1, LEFT).replace("\tY =", "\tX =   1.000 mm,\tY =")),
    ("a point with an unknown number", point(1, LEFT).replace("\tY =", "\tQ =   1.000 mm,\tY =")),
    ("a point in inches", point(1, LEFT).replace(" mm", " inch")),
    ("a point in radians", point(1, LEFT).replace(" deg", " rad")),
    ("a point in no unit", point(1, LEFT).replace(" mm", "")),
    ("a point with millimetres in an angle", point(1, LEFT).replace("1.377 deg", "1.377 mm")),
    ("a point without an angle", point(1, LEFT).replace("P =     1.377 deg,\t", "")),
    (
        "a point with an axis that the robot has not",
        point(1, LEFT).replace("-68.968 deg", "-68.968 deg,\n\tE1= 10.000 mm"),
    ),
    ("a point beyond all arms", point(1, LEFT).replace("-98.244", "1e999")),
    ("a point without frame and tool", point(1, LEFT).replace("UF : 1, UT : 1,", "")),
    ("a point in a frame with a name", point(1, LEFT, user="TABLE")),
    ("a point with a tool with a name", point(1, LEFT, tool="T1")),
    ("a point in a frame that nobody states", point(1, LEFT, user="7")),
    ("a point with a tool that nobody states", point(1, LEFT, tool="7")),
    ("a point in the active tool where none is set", point(1, LEFT, tool="F")),
)
"""Points of /POS; the program goes there without setting a frame or a tool."""

HEADERS: tuple[tuple[str, str], ...] = (
    ("line tracking", "/APPL\nLINE_TRACK;\n  LINE_TRACK_SCHEDULE_NUMBER      : 1;\n"),
    ("palletizing mode", "/APPL\nPLTZ_MODE_HEADER;\n PLTZ_MODE_ENABLE   : TRUE;\n"),
    ("welding in several passes", "/APPL\nMPAS ;\nMPAS_NUM_PASSES        : 2;\n"),
    ("another application", "/APPL\n  DEFAULT_USER_FRAME : 2;\n"),
)


def _called(text: str, programs: dict[str, str]) -> dict[str, str]:
    """Those of the programs that a text names, or that these name."""
    own = {
        name: program for name, program in programs.items() if f" {name}" in text.replace("=", " ").replace(",", " ")
    }
    others = {name: program for name, program in programs.items() if name not in own}
    return own | {name: program for text in own.values() for name, program in _called(text, others).items()}


def _attacks() -> tuple[Attack, ...]:
    listed: list[Attack] = []

    def add(name: str, text: str, **others: str) -> None:
        listed.append(Attack(name, {"main.ls": text, **{f"{n.lower()}.ls": t for n, t in others.items()}}, FRAMES))

    for name, option in OPTIONS:
        add(name, listing([*START, f"{GO} {option}"], BOTH))
    for name, lines in BEFORE:
        last = f"{GO} Offset" if "condition" in name and "offset" in name else GO
        closed = not any(word in name for word in ("without an end", "never closed", "began nowhere"))
        everywhere = closed and not any(word in name for word in ("task", "handler", "error program"))
        frame = any("UFRAME[" in line.upper().replace(" ", "") or "UTOOL[" in line.upper() for line in lines)
        add(name, listing([*START, *lines, last], BOTH if everywhere and not frame else [point(1, LEFT), point(2)]))
    for name, lines in ANYWHERE:
        add(name, listing([*START, GO, *lines], BOTH), SUB=listing(["R[1]=1"], name="SUB"))
    for name, lines in EVERY_POINT:
        add(name, listing([*START, GO, *lines], NEITHER), SUB=listing(["R[1]=1"], name="SUB"))
    for name, lines in SUBS:
        text = listing([*FRAME_SET, *lines, GO], [point(1, LEFT), point(3)])
        add(name, text, **_called(text, {"SUB": SETS_FRAME, "HANDLER": HANDLER, **TASKS}))
    add("a program of the project that nobody calls", listing([GO], [point(1, LEFT)]), SUB=SETS_FRAME)
    for name, lines in ACTIVE:
        other = listing(["IF R[1]=1,JMP LBL[1]", "UFRAME_NUM=2", "LBL[1]"], name="OTHER")
        add(name, listing(lines, [point(1, LEFT, "F", "F"), point(3)]), OTHER=other)
    for name, lines in REGISTERS:
        shifts = listing(["PR[1]=LPOS"], name="SHIFTS")
        add(name, listing([*KNOWN, *lines, SHIFTED], [point(1, LEFT), point(3)]), SHIFTS=shifts)
    for name, text in DATA:
        active = ["UFRAME_NUM=1", "UTOOL_NUM=1"] if "with a name" in name else []
        add(
            name,
            listing([*active, GO, "L P[2] 100mm/sec FINE"], [text, point(2, ("", "") if "twice" in name else RIGHT)]),
        )
    for name, header in HEADERS:
        add(name, listing([*START, GO], NEITHER, header=header))
    add("two programs in a file", listing([*START, GO], NEITHER, after=listing(["R[1]=1"], name="SUB")))
    add("something else in /POS", listing([*START, GO], [*NEITHER, "Q[1]{};\n"]))
    add("groups that move one by one", listing([*START, "Independent GP\n    :  GP1 L P[1] 100mm/sec FINE"], BOTH))
    return tuple(listed)


ATTACKS = _attacks()
