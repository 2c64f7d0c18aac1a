"""FANUC: instructions of the operator's manual, and of listings by hand, that change what a position means."""

from __future__ import annotations

from collections.abc import Sequence

from program_twins import twins

from program_attacks import Attack

FRAMES = """format: 1
bases:
  "1": {xyz: [0.5, 0.0, 0.2], rpy: [0.0, 0.0, 0.5]}
  "2": {xyz: [0.6, 0.1, 0.2], rpy: [0.0, 0.0, 0.4]}
tools:
  "1": {xyz: [0.0, 0.0, 0.12], rpy: [0.0, 0.0, 0.0]}
  "2": {xyz: [0.0, 0.05, 0.2], rpy: [0.0, 0.0, 0.0]}
"""


def listing(name: str, lines: Sequence[str], points: Sequence[str], more: str = "", end: str = "\n") -> str:
    """A listing of a program; a line without number of its own belongs to the one before."""
    rows = [f"/PROG  {name}", "/ATTR", "OWNER\t\t= MNEDITOR;", 'COMMENT\t\t= "";', "DEFAULT_GROUP\t= 1,*,*,*,*;"]
    rows += [f"{more}/MN", *(f"{k:4d}:{line} ;" for k, line in enumerate(lines, start=1)), "/POS", *points, "/END", ""]
    return end.join(rows)


def joints(
    number: str, values: Sequence[float] = (0, -20, 10, 0, -40, 0), frames: str = "UF : 1, UT : 1,", mark: str = "⟨⟩"
) -> str:
    """A position in joints."""
    texts = [f"J{k}= {value:10.3f} deg" for k, value in enumerate(values, start=1)]
    text = f"{texts[0]},\t{texts[1]},\t{texts[2]},\n\t{texts[3]},\t{texts[4]},\t{texts[5]}"
    return f"P[{number}]{{\n   GP1:\n\t{frames}\t\n\t{mark[:1]}{text}{mark[1:]}\n}};"


def pose(
    number: str,
    xyz: Sequence[float] = (900, 100, 700),
    frames: str = "UF : 1, UT : 1,",
    mark: str = "⟦⟧",
    more: str = "",
) -> str:
    """A position in a user frame."""
    x, y, z = xyz
    text = f"X = {x:9.3f}  mm,\tY = {y:9.3f}  mm,\tZ = {z:9.3f}  mm,\n"
    text += f"\tW =   180.000 deg,\tP =     0.000 deg,\tR =    10.000 deg{more}"
    return f"P[{number}]{{\n   GP1:\n\t{frames}\t\tCONFIG : 'N U T, 0, 0, 0',\n\t{mark[:1]}{text}{mark[1:]}\n}};"


START = ["  UFRAME_NUM=1", "  UTOOL_NUM=1", "J P[1] 50% FINE   "]

MOVE = "L P[2] 200mm/sec FINE   "


def body(
    name: str,
    lines: Sequence[str],
    trap: str | tuple[str, ...],
    plain: str | tuple[str, ...] = "",
    points: Sequence[str] = (joints("1"), pose("2")),
    more: str = "",
    **files: str,
) -> tuple[Attack, Attack]:
    """Lines behind the first joint position; other listings by their names."""
    texts = {"P.LS": listing("P", [*START, *lines], points, more), **{f"{key}.LS": text for key, text in files.items()}}
    return twins(name, texts, trap, plain, FRAMES)


def lone(name: str, trap: str, plain: str = "", **files: str) -> tuple[Attack, Attack]:
    """An instruction between a joint position and a pose."""
    return body(name, ["  §", MOVE], trap, plain, **files)


UNMARKED = joints("1", mark="")

STATE = (
    *lone("the user frame is written by a register", "UFRAME[1]=PR[7]", "R[7]=1"),
    *lone("the tool is written by a register", "UTOOL[1]=PR[8]", "R[8]=1"),
    *lone("a frame is written whose number is in a register", "UFRAME[R[1]]=PR[7]", "R[1]=2"),
    *lone("a tool is written whose number is in a register", "UTOOL[R[1]]=PR[7]", "R[1]=R[1]+1"),
    *lone("a program that is not given", "CALL MEASURE", "WAIT   1.00(sec)"),
    *lone("a macro that is not given", "Find part", "DO[1]=ON"),
    *lone("a program whose name is in a string register", "CALL SR[1]", "SR[1]=SR[2]"),
    *lone("a program is called if an input is on", "IF DI[1]=ON,CALL MEASURE", "IF DI[1]=ON,JMP LBL[1]")[:1],
    *lone("a program is called by a choice", "SELECT R[1]=1,CALL MEASURE", "DO[2]=OFF"),
    *body("a program runs beside", ["  §", MOVE], "RUN MEASURE", "DO[1]=PULSE,0.5sec", [UNMARKED, pose("2")]),
    *body("a monitor calls what is not given", ["  §", MOVE], "MONITOR SEEN", "TIMER[1]=START", [UNMARKED, pose("2")]),
    *lone("a parameter of the frames is written", "$MNUFRAME[1,1]=PR[3]", "$WAITTMOUT=200"),
    *lone("a parameter of the tools is written", "$MNUTOOL[1,1]=PR[3]", "$WAITTMOUT=R[1]"),
    *lone("seam tracking is on", "Track TAST[1]", "Arc Start[1]"),
    *lone("a touch offset acts", "Touch Offset PR[12]", "WAIT DI[3]=ON"),
    *lone(
        "positions of a register array shift all points",
        "OFFSET CONDITION PR[5]\n    :L P[2] 200mm/sec FINE Offset",
        "PAYLOAD[1]",
    )[:1],
    *lone("a component of the user frame", "PR[7,3]=R[3]\n   9:  UFRAME[1]=PR[7]", "PR[7,3]=R[3]"),
    *body(
        "a given program writes the frame",
        ["  CALL SUB", MOVE],
        "UFRAME[1]=PR[2]",
        "DO[1]=ON",
        SUB=listing("SUB", ["  §"], []),
    ),
    *lone(
        "a given program calls one that is not given",
        "CALL SUB",
        "CALL LAMP",
        SUB=listing("SUB", ["  DO[1]=ON", "  CALL NOBODY"], []),
        LAMP=listing("LAMP", ["  DO[1]=ON"], []),
    ),
    *body(
        "a given program writes the frame of the number it is told",
        ["  CALL SUB(1)", MOVE],
        "UFRAME[AR[1]]=PR[2]",
        "R[1]=AR[1]",
        SUB=listing("SUB", ["  §"], []),
    ),
    *lone("a frame is written in a condition on one line", "IF (DI[1]=ON),UFRAME[1]=(PR[3])", "IF (DI[1]=ON),R[1]=(3)")[
        :1
    ],
)

JOINT = joints("1")

OTHER = pose("3", (900, 200, 700))

POINTS = (
    *body("an offset on the move", [f"{MOVE}§"], "Offset,PR[5]"),
    *body("an offset that a condition names", ["  OFFSET CONDITION PR[5]", f"{MOVE}§"], "Offset"),
    *body("a tool offset on the move", [f"{MOVE}§"], "Tool_Offset,PR[6]"),
    *body("a tool offset that a condition names", ["  TOOL_OFFSET CONDITION PR[6]", f"{MOVE}§"], "Tool_Offset"),
    *body("a vision offset", [f"{MOVE}§"], "VOFFSET,VR[1]"),
    *body("a vision offset that a condition names", ["  VOFFSET CONDITION VR[1]", f"{MOVE}§"], "VOFFSET"),
    *body("a step", [f"{MOVE}§"], "INC"),
    *body(
        "a step of the joints",
        ["J P[2] 50% FINE §"],
        "INC",
        "ACC80",
        [JOINT, joints("2", (5, -20, 10, 0, -40, 0), mark="⟦⟧")],
    ),
    *body("coordinated with a table", [f"{MOVE}§"], "COORD", "ACC50"),
    *body("a tool in the room", [f"{MOVE}§"], "RTCP", "PTH"),
    *body("an offset that is one of two uses", [f"{MOVE}", f"{MOVE}§"], "Offset,PR[5]"),
    *body("an offset on many options", [f"{MOVE}ACC80 §TB    .10sec,DO[1]=ON"], "Offset,PR[R[4]] "),
    *body("a position goes into a register", [MOVE, "  §"], "PR[3]=P[2]", "PR[3]=LPOS"),
    *body("a position goes into a register that is counted on", [MOVE, "  §"], "PR[3]=P[2]+PR[4]", "PR[3]=PR[3]+PR[4]"),
    *body("a position is written", ["  §", MOVE], "P[2]=LPOS", "PR[2]=LPOS"),
    *body(
        "a position is written whose number is in a register",
        ["  §", MOVE],
        "P[R[1]]=PR[2]",
        "PR[R[1]]=PR[2]",
        [UNMARKED, pose("2")],
    ),
    *body(
        "a position whose number is in a register, with an offset",
        [MOVE, "L P[R[1]] 200mm/sec FINE §"],
        "Offset,PR[5]",
        "",
        [UNMARKED, pose("2")],
    )[:1],
    *body(
        "the frame is changed at a loop's end",
        ["  FOR R[1]=1 TO 3", MOVE, "  §", "  ENDFOR"],
        "UFRAME[1]=PR[3]",
        "DO[1]=ON",
    ),
    *body(
        "the frame is changed before a jump back",
        ["  LBL[1]", MOVE, "  §", "  JMP LBL[1]"],
        "UTOOL[1]=PR[3]",
        "R[1]=R[1]+1",
    ),
    *body(
        "a jump reaches the move past what is set",
        ["  IF R[1]=1,JMP LBL[2]", "  §", "  LBL[2]", MOVE],
        "UFRAME[1]=PR[3]",
        "DO[1]=ON",
    ),
    *body(
        "a frame that the move's line takes from what is set",
        ["  UFRAME_NUM=§", MOVE],
        "R[3]",
        "1",
        [JOINT, pose("2", frames="UF : F, UT : 1,")],
    )[:1],
    *body(
        "a tool that the move's line takes from what is set",
        ["  UTOOL_NUM=§", MOVE],
        "R[3]",
        "1",
        [JOINT, pose("2", frames="UF : 1, UT : F,")],
    )[:1],
    *body("a frame that nobody states", [MOVE], "7", "2", [JOINT, pose("2", frames="UF : §, UT : 1,")])[:1],
    *body("a tool that nobody states", [MOVE], "7", "2", [JOINT, pose("2", frames="UF : 1, UT : §,")])[:1],
    *body(
        "a position that was never taught",
        [MOVE],
        "********",
        "   11.000",
        [JOINT, pose("2").replace("   10.000", "§")],
    ),
    *body("a move in a remark", ["  §L P[2] 200mm/sec FINE   "], "!", ""),
    *body("a move that is commented out", ["§L P[2] 200mm/sec FINE   "], "//", ""),
    *body("a move in a text", ["  §L P[2] 200mm/sec FINE§"], ("MESSAGE[", "]"), ("", "   "))[:1],
    *body("an instruction that is commented out acts not, the other does", ["  §UFRAME[1]=PR[3]", MOVE], "", "//"),
    *body(
        "a program called on the way",
        [f"{MOVE}§", "L P[3] 200mm/sec FINE"],
        "TB    .50sec,CALL SEEN",
        "TB    .50sec,DO[3]=ON",
        [UNMARKED, pose("2", mark=""), OTHER],
    ),
    *body(
        "a program called at a distance",
        [f"{MOVE}§", "L P[3] 200mm/sec FINE"],
        "DB     5.0mm,CALL SEEN",
        "DB     5.0mm,DO[3]=ON",
        [UNMARKED, pose("2", mark=""), OTHER],
    ),
    *body(
        "the listing is of a program that follows a line",
        [MOVE],
        "1",
        "0",
        [UNMARKED, pose("2")],
        "/APPL\n\nLINE_TRACK;\n  LINE_TRACK_SCHEDULE_NUMBER      : §;\n  LINE_TRACK_BOUNDARY_NUMBER      : 1;\n"
        "  CONTINUE_TRACK_AT_PROG_END      : TRUE;\n\n",
    )[:1],
    *body(
        "a program called twice with an offset in force, which a register names",
        ["  CALL SUB", "  §", "  CALL SUB"],
        "UFRAME[1]=PR[9]",
        "DO[1]=ON",
        [JOINT],
        SUB=listing("SUB", [MOVE], [pose("2")]),
    ),
    *body(
        "one number in two programs, one of them with an offset",
        [MOVE, "  CALL SUB"],
        "Offset,PR[1]",
        "",
        [JOINT, pose("2", mark="⟨⟩")],
        SUB=listing("SUB", ["L P[2] 200mm/sec FINE §"], [pose("2")]),
    ),
    *body(
        "a program that calls itself and writes the frame",
        ["  CALL SUB"],
        "UFRAME[1]=PR[9]",
        "DO[1]=ON",
        [JOINT],
        SUB=listing("SUB", [MOVE, "  IF R[1]>3,JMP LBL[1]", "  §", "  CALL SUB", "  LBL[1]"], [pose("2")]),
    )[:1],
    *body(
        "an arc's middle with an offset",
        ["C P[3]    \n    :  P[2] 100mm/sec FINE §"],
        "Offset,PR[5]",
        "",
        [JOINT, pose("2"), OTHER],
    ),
    *body(
        "one name with signs that look like the list's own",
        [MOVE + "§"],
        "Offset,PR[5]",
        "",
        [JOINT, pose('2:"a]b{ X = 5.0 mm };"')],
    ),
    *body(
        "a second group of axes that goes with it",
        [f"{MOVE}§"],
        "COORD",
        "",
        [JOINT, pose("2").replace("\n};", "\n   GP2:\n\tUF : 1, UT : 1,\n\tJ1=     0.000 deg\n};")],
    )[:1],
    *body(
        "positions are declared twice",
        [MOVE],
        pose("2", (901, 100, 700), mark=""),
        "P[9]{\n   GP1:\n\tUF : 1, UT : 1,\t\n\tJ1= 0.000 deg,\tJ2= 0.000 deg,\tJ3= 0.000 deg,\n"
        "\tJ4= 0.000 deg,\tJ5= 0.000 deg,\tJ6= 0.000 deg\n};",
        [UNMARKED, pose("2"), "§"],
    ),
    *body("a seam is met in another pass", ["  §", MOVE], "MP Offset PR[4] RPM[5]", "Weave Sine[1]"),
    *body(
        "a frame is set by what a look-up in a table gives",
        ["  §", MOVE],
        "UFRAME[1]=VR[1].FOUND_POS[1]",
        "R[1]=VR[1].MODELID",
    ),
    *body("German words for a jump and a call", ["  §", MOVE], "AUFRUF MESSEN", "!AUFRUF MESSEN"),
    *body(
        "a jump to a label whose number is in a register",
        ["  UFRAME[1]=PR[2]", "  LBL[3]", "  §", MOVE],
        "JMP LBL[R[1]]",
        "DO[1]=ON",
    )[:1],
    *body(
        "a condition with many parts and a frame behind it",
        ["  IF (R[1]=1 AND DI[1]) THEN", "  §", "  ELSE", "  DO[2]=ON", "  ENDIF", MOVE],
        "UFRAME[1]=PR[1]",
        "DO[3]=ON",
    ),
    *body(
        "a choice's other case writes the frame",
        [
            "  SELECT R[1]=1,JMP LBL[1]",
            "  =2,JMP LBL[2]",
            "  ELSE,JMP LBL[3]",
            "  LBL[1]",
            "  §",
            "  LBL[2]",
            "  LBL[3]",
            MOVE,
        ],
        "UFRAME[1]=PR[1]",
        "DO[3]=ON",
    ),
)

REACHES_NOTHING = (
    Attack(
        "control: what stands behind END is never run",
        {"P.LS": listing("P", [*START, MOVE, "  END", "  CALL MEASURE"], [JOINT, pose("2", mark="⟨⟩")])},
        FRAMES,
    ),
    Attack(
        "control: what a jump leads over is never run",
        {
            "P.LS": listing(
                "P", [*START, "  JMP LBL[5]", "  CALL MEASURE", "  LBL[5]", MOVE], [JOINT, pose("2", mark="⟨⟩")]
            )
        },
        FRAMES,
    ),
    Attack(
        "control: a condition for offsets that no move asks for",
        {"P.LS": listing("P", [*START, "  OFFSET CONDITION PR[5]", MOVE], [JOINT, pose("2", mark="⟨⟩")])},
        FRAMES,
    ),
    Attack(
        "control: frames are read, and what is read is written elsewhere",
        {
            "P.LS": listing(
                "P",
                [*START, "  PR[1]=UFRAME[1]", "  PR[2]=JPOS", "  LOCK PREG", "  UNLOCK PREG", MOVE],
                [JOINT, pose("2", mark="⟨⟩")],
            )
        },
        FRAMES,
    ),
    Attack(
        "control: remarks and texts with instructions in them",
        {
            "P.LS": listing(
                "P",
                [
                    *START,
                    "  !UFRAME[1]=PR[1] L P[2]",
                    "  //UFRAME[1]=PR[1]",
                    "  MESSAGE[CALL MEASURE]",
                    "  --eg:UTOOL[1]=PR[2]",
                    MOVE,
                ],
                [JOINT, pose('2:"UF : 9; }"', mark="⟨⟩")],
            )
        },
        FRAMES,
    ),
)

GRID = [(850 + 20 * (k % 4), -200 + 50 * (k // 4), 700 + 10 * (k % 3)) for k in range(18)]
"""Places of plain listings, [mm]."""


def poses(count: int, first: int = 2, frames: str = "UF : 1, UT : 1,") -> list[str]:
    """Poses with marks, numbered from ``first``."""
    return [pose(str(k), xyz, frames, "⟨⟩") for k, xyz in enumerate(GRID[:count], start=first)]


def plain(
    name: str, lines: Sequence[str], points: Sequence[str], more: str = "", end: str = "\n", **files: str
) -> Attack:
    """A plain listing of which all positions are marked."""
    texts = {
        "PLAIN.LS": listing("PLAIN", lines, points, more, end),
        **{f"{key}.LS": text for key, text in files.items()},
    }
    return Attack(f"plain: {name}", texts, FRAMES)


ARC = "/APPL\n  ARC Welding Equipment : 1,*,*,*,*;\n\n"

PLAIN = (
    plain(
        "offline programming, lines in a row",
        [*START, *(f"L P[{k}] 200mm/sec CNT50   " for k in range(2, 16))],
        [JOINT, *poses(14)],
    ),
    plain(
        "joints alone, as a planner writes them",
        [f"J P[{k}] 30% CNT100   " for k in range(1, 17)],
        [joints(str(k), (3 * k, -20, 10, 0, -40 - k, 0)) for k in range(1, 17)],
    ),
    plain(
        "picking and placing with signals and counters",
        [
            "  !Pick and place",
            *START,
            "  R[1]=0",
            "  LBL[1]",
            *(f"L P[{k}] 500mm/sec FINE    ;\n  {k}0:  DO[{k}]=ON ;\n  {k}1:  WAIT   0.30(sec)" for k in range(2, 10)),
            "  R[1]=R[1]+1",
            "  IF R[1]<10,JMP LBL[1]",
            "  END",
        ],
        [JOINT, *poses(8)],
    ),
    plain(
        "arc welding",
        [
            *START,
            "L P[2] 500mm/sec FINE\n    :  Arc Start[1]",
            "  Weave Sine[1]",
            *(f"L P[{k}] WELD_SPEED CNT100   " for k in range(3, 10)),
            "  Weave End",
            "L P[10] WELD_SPEED FINE\n    :  Arc End[1]",
        ],
        [JOINT, *poses(9)],
        ARC,
    ),
    plain(
        "two frames and two tools",
        [
            *START,
            *(f"L P[{k}] 200mm/sec FINE   " for k in range(2, 7)),
            "  UFRAME_NUM=2",
            "  UTOOL_NUM=2",
            "J P[20] 50% FINE   ",
            *(f"L P[{k}] 200mm/sec FINE   " for k in range(7, 12)),
        ],
        [JOINT, *poses(5), *poses(5, 7, "UF : 2, UT : 2,"), joints("20", (5, -20, 10, 0, -40, 0), "UF : 2, UT : 2,")],
    ),
    plain(
        "circles",
        [
            *START,
            *(
                f"L P[{k}] 200mm/sec FINE    ;\n  {k}0:C P[{k + 1}]    \n    :  P[{k + 2}] 100mm/sec FINE   "
                for k in (2, 5, 8, 11)
            ),
        ],
        [JOINT, *poses(12)],
    ),
    plain(
        "programs of its own",
        [
            *START,
            "  CALL GRIP(1)",
            *(f"L P[{k}] 200mm/sec FINE   " for k in range(2, 7)),
            "  CALL GRIP(0)",
            "  CALL WAY",
        ],
        [JOINT, *poses(5)],
        GRIP=listing(
            "GRIP", ["  R[10]=AR[1]", "  IF R[10]=1,JMP LBL[1]", "  RO[1]=OFF", "  END", "  LBL[1]", "  RO[1]=ON"], []
        ),
        WAY=listing("WAY", [f"L P[{k}] 200mm/sec CNT10   " for k in range(1, 6)], poses(5, 1)),
    ),
    plain(
        "CRLF, names of points, comments",
        ["  !Grundstellung", *START, *(f"L P[{k}:Naht {k}] 200mm/sec CNT20 ACC80   " for k in range(2, 12))],
        [JOINT, *(text.replace("]{", f':"Naht {k}"]{{', 1) for k, text in enumerate(poses(10), start=2))],
        end="\r\n",
    ),
    plain(
        "the robot's world and the first tool",
        ["  UFRAME_NUM=0", "  UTOOL_NUM=1", "J P[1] 50% FINE   ", *(f"J P[{k}] 50% CNT30   " for k in range(2, 12))],
        [joints("1", frames="UF : 0, UT : 1,"), *poses(10, 2, "UF : 0, UT : 1,")],
    ),
    plain(
        "by hand, with choices and waits",
        [
            *START,
            "  FOR R[1]=1 TO 3",
            *(
                f"  IF (DI[{k}]=ON) THEN ;\n  {k}0:L P[{k}] 200mm/sec FINE    ;\n  {k}1:  ELSE ;\n"
                f"  {k}2:  WAIT DI[{k}]=ON TIMEOUT,LBL[9] ;\n  {k}3:  ENDIF"
                for k in range(2, 10)
            ),
            "  ENDFOR",
            "  LBL[9]",
            "  MESSAGE[ready]",
        ],
        [JOINT, *poses(8)],
    ),
)

ORDER = (
    *body("an offset on the line's second row", [f"{MOVE}\n    :  §"], "Offset,PR[5]", "ACC80"),
    *body(
        "a sign for not in a condition, and a call behind it",
        ["  §", MOVE],
        "IF (!DI[1]),CALL MEASURE",
        "WAIT (!DI[1])",
    ),
    *body(
        "a call in a condition of many parts",
        ["  §", MOVE],
        "IF (DI[1]=ON AND !DI[2] OR R[1]>3),CALL MEASURE",
        "IF (DI[1]=ON AND !DI[2] OR R[1]>3),R[1]=(3)",
    ),
    *body("a label whose name looks like a move", ["  LBL[3:L P[2]]", "  §", MOVE], "UFRAME[1]=PR[1]", "DO[1]=ON"),
    *body(
        "a text that looks like a remark, and a call behind it",
        ["  SR[1]='!'", "  §", MOVE],
        "CALL SR[1]",
        "R[1]=STRLEN SR[1]",
    ),
    *body(
        "an argument that looks like the end of a line",
        ["  CALL LOG('; !')", MOVE],
        "CALL MEASURE",
        "DO[1]=ON",
        LOG=listing("LOG", ["  §"], []),
    ),
    *body(
        "a file whose program has another name",
        ["  CALL SUB", MOVE],
        "OTHER",
        "SUB",
        SUB=listing("§", ["  DO[1]=ON"], []),
    )[:1],
    *body("an axis beside the arm's six", [MOVE], ",\n\tE1 =  1500.000  mm", "", [JOINT, pose("2", more="§")]),
    *body(
        "a line of two moves, one with an offset",
        ["L P[2] 200mm/sec FINE    ;\n   9:L P[3] 200mm/sec FINE §"],
        "Offset,PR[5]",
        "",
        [JOINT, pose("2", mark="⟨⟩"), OTHER],
    ),
    *body(
        "a choice of programs by a register",
        ["  SELECT R[1]=1,CALL LAMP ;\n    :  =2,CALL MEASURE ;\n    :  ELSE,CALL LAMP", MOVE],
        "",
        "",
        LAMP=listing("LAMP", ["  DO[1]=ON"], []),
    )[:1],
    *body(
        "a loop counts down and writes the tool",
        ["  FOR R[1]=R[2] DOWNTO 1", "  §", "  ENDFOR", MOVE],
        "UTOOL[1]=PR[R[1]]",
        "DO[1]=ON",
    ),
    *body(
        "a jump back over what writes the frame",
        ["  JMP LBL[2]", "  LBL[1]", "  §", "  LBL[2]", "  IF DI[1]=ON,JMP LBL[1]", MOVE],
        "UFRAME[1]=PR[3]",
        "DO[1]=ON",
    ),
    *body(
        "a wait runs out into what writes the frame",
        ["  WAIT DI[1]=ON TIMEOUT,LBL[1]", "  JMP LBL[2]", "  LBL[1]", "  §", "  LBL[2]", MOVE],
        "UFRAME[1]=PR[3]",
        "DO[1]=ON",
    ),
    *body(
        "a skip leads to what writes the frame",
        ["  SKIP CONDITION DI[1]=ON", "L P[3] 50mm/sec FINE Skip,LBL[1]   ", "  §", "  LBL[1]", MOVE],
        "UTOOL[1]=PR[3]",
        "DO[1]=ON",
        [JOINT, pose("2"), pose("3", (900, 200, 700), mark="")],
    ),
    *body(
        "a frame is written in a program that runs beside",
        ["  RUN SUB", MOVE],
        "UFRAME[1]=PR[3]",
        "DO[1]=ON",
        [JOINT, pose("2")],
        SUB=listing("SUB", ["  §"], []),
    ),
    *body(
        "a program that runs before the move's end",
        [f"{MOVE}TB    .20sec,CALL SUB", "L P[3] 200mm/sec FINE"],
        "UFRAME[1]=PR[3]",
        "DO[1]=ON",
        [JOINT, pose("2"), OTHER],
        SUB=listing("SUB", ["  §"], []),
    ),
    *body("a group's mask without the first", [MOVE], "*,1,*,*,*", "1,*,*,*,*", [UNMARKED, pose("2")])[:0],
    *body("a position's frame by a name", [MOVE], "TABLE", "1", [JOINT, pose("2", frames="UF : §, UT : 1,")]),
    *body("a coordinate that is none", [MOVE], "9.1.2", "91.2", [JOINT, pose("2").replace("   10.000", "§")]),
    *body(
        "a coordinate is missing",
        [MOVE],
        "",
        ",\tR =    10.000 deg",
        [JOINT, pose("2").replace(",\tR =    10.000 deg", "§")],
    ),
    *body("a coordinate in inches", [MOVE], "in", "mm", [JOINT, pose("2").replace("mm,\tY", "§,\tY")]),
    *body("an angle in radians", [MOVE], "rad", "deg", [JOINT, pose("2").replace("10.000 deg", "10.000 §")]),
    Attack(
        "control: letters whose second byte some take for the end of a line",
        {
            "P.LS": listing(
                "P",
                [*START, "  !Å UFRAME[1]=PR[1]", "  !à\xa0UFRAME[1]=PR[1]", MOVE],
                [JOINT, pose('2:"Å"', mark="⟨⟩")],
            )
        },
        FRAMES,
    ),
    Attack(
        "control: speeds and zones by registers, and what a header says of singularities",
        {
            "P.LS": listing(
                "P",
                [
                    *START,
                    "L P[2] R[1]mm/sec CNT R[2] ACC R[3]   ",
                    "L P[3] 2.0sec CNT100   ",
                    "J P[4] R[7]% FINE   ",
                    "L P[5] max_speed CNT100 RT_LDR[1]   ",
                ][:6],
                [JOINT, *[pose(str(k), (900, 100 * k, 700), mark="⟨⟩") for k in (2, 3, 4)]],
                "/APPL\n\nAUTO_SINGULARITY_HEADER;\n  ENABLE_SINGULARITY_AVOIDANCE   : TRUE;\n\n"
                "MPAS ;\nMPAS_NUM_PASSES        : 0;\nMPAS_LAST_PASS         : 0;\n",
            )
        },
        FRAMES,
    ),
)

INDIRECT = (
    *body(
        "programs that call each other, with an offset on the way",
        ["  CALL A"],
        "UFRAME[1]=PR[1]",
        "DO[1]=ON",
        [JOINT],
        A=listing("A", [MOVE, "  IF R[1]>3,JMP LBL[1]", "  §", "  CALL B", "  LBL[1]"], [pose("2")]),
        B=listing("B", ["  CALL A"], []),
    )[:1],
    *body(
        "a program that a program calls writes the tool",
        ["  CALL A", MOVE],
        "UTOOL[1]=PR[1]",
        "DO[1]=ON",
        A=listing("A", ["  CALL B"], []),
        B=listing("B", ["  §"], []),
    ),
    *body(
        "a monitor's program writes the frame",
        ["  MONITOR CH", MOVE],
        "CALL SEEN",
        "DO[1]=ON",
        [UNMARKED, pose("2")],
        CH=listing("CH", ["  WHEN DI[1]=ON,§"], []),
    )[:1],
    *body(
        "a program on the way calls one that writes the frame",
        [f"{MOVE}DB     5.0mm,CALL A", "L P[3] 200mm/sec FINE   "],
        "UFRAME[1]=PR[1]",
        "DO[1]=ON",
        [JOINT, pose("2"), OTHER],
        A=listing("A", ["  CALL B"], []),
        B=listing("B", ["  §"], []),
    ),
    *body(
        "a frame that is what it was, by way of a register that nobody knows",
        ["  UFRAME[1]=PR[1]", "  §", MOVE],
        "UFRAME[1]=PR[2]",
        "DO[1]=ON",
        [UNMARKED, pose("2")],
    )[:1],
    *body(
        "an offset on a position that a loop comes to by two lines",
        ["  FOR R[1]=1 TO 2", "  IF R[1]=2,JMP LBL[1]", MOVE, "  LBL[1]", f"{MOVE}§", "  ENDFOR"],
        "Offset,PR[1]",
    ),
    *body(
        "a position that is copied by its number",
        ["  PR[1]=P[R[1]]", MOVE, "  §"],
        "L PR[1] 200mm/sec FINE",
        "DO[1]=ON",
        [UNMARKED, pose("2")],
    )[:1],
    *body(
        "a mixed condition with a call in brackets", ["  §", MOVE], "IF (R[1]=1),CALL MEASURE", "IF (R[1]=1),DO[1]=(ON)"
    ),
    *body("a part of a position is written", ["  §", MOVE], "P[2,3]=R[1]", "PR[2,3]=R[1]"),
    *body("a position is written by an offset of itself", ["  §", MOVE], "P[2]=P[2]+PR[1]", "PR[2]=PR[2]+PR[1]"),
)

ATTACKS: tuple[Attack, ...] = (*STATE, *POINTS, *REACHES_NOTHING, *INDIRECT, *PLAIN, *ORDER)
