"""INFORM jobs whose positions do not mean what they say, and beside each the same without it.

C00000 is in pulses, so that it is known how the arm stands; C00001 is what the construct changes, C00002 is where the arm goes
before it, and P00010 is a position variable.
"""

from __future__ import annotations

from collections.abc import Sequence

from program_twins import SLOT, twins

from program_attacks import Attack

FRAMES = """format: 1
bases: {"1": {xyz: [0.1, 0, 0], rpy: [0, 0, 0.3]}, "2": {xyz: [0, 0.2, 0], rpy: [0, 0, 0]}}
tools: {"1": {xyz: [0, 0, 0.1], rpy: [0, 0, 0]}, "2": {xyz: [0, 0, 0.2], rpy: [0, 0.1, 0]}}
pulses_per_degree: [1000, 1000, 1000, 800, 800, 500]
"""

PULSES = "///POSTYPE PULSE\n///PULSE\n"

USER = "///POSTYPE USER\n///RECTAN\n///RCONF 1,0,0,0,0,0,0,0\n"

HOME = "C00000=17200,-68800,85900,-68720,-64160,5750\n"


def position(name: str, marks: str = "", x: float = 801.25) -> str:
    """A pose, its numbers between marks."""
    return f"{name}={marks[:1]}{x:.3f},-98.244,402.635,179.2040,1.3770,-68.9680{marks[1:]}\n"


def job(
    lines: Sequence[str],
    positions: str = "",
    name: str = "MAIN",
    head: str = "///USER 1\n///TOOL 1\n",
    more: str = "///ATTR SC,RW\n///GROUP1 RB1\n",
) -> str:
    """A job."""
    body = "".join(f"{line}\n" for line in lines)
    return (
        f"/JOB\n//NAME {name}\n//POS\n///NPOS 3,0,0,0,0,0\n{head}{positions}"
        f"//INST\n///DATE 2026/11/28 10:26\n{more}NOP\n{body}END\n"
    )


BEFORE = f"{PULSES}{HOME}{USER}"

PLAIN = BEFORE + position("C00002", "⟨⟩", 810.0) + position("P00010", "⟨⟩", 820.0) + position("C00001", "⟦⟧")

ALONE = PLAIN.replace("⟨", "").replace("⟩", "")
"""Where the construct may reach the other two."""

START = ("MOVJ C00000 VJ=10.00", "MOVL C00002 V=100.0", "MOVL P010 V=100.0")

GO = "MOVL C00001 V=100.0 PL=0"

SUB = job(["DOUT OT#(1) ON"], name="SUB")


def between(name: str, trap: str, positions: str = PLAIN) -> tuple[Attack, Attack]:
    """Instructions before the move to C00001."""
    return twins(name, {"MAIN.JBI": job([*START, SLOT, GO], positions)}, trap, frames=FRAMES)


def called_before(name: str, trap: str, positions: str = PLAIN) -> tuple[Attack, Attack]:
    """Instructions of a job that is called before the move to C00001."""
    files = {"MAIN.JBI": job([*START, "CALL JOB:SUB", GO], positions), "SUB.JBI": job([SLOT], name="SUB")}
    return twins(name, files, trap, frames=FRAMES)


def moved(name: str, move: str) -> tuple[Attack, Attack]:
    """Another move to C00001, beside one of the table's kind."""
    positions = ALONE if "C00002" in move else PLAIN
    return twins(name, {"MAIN.JBI": job([*START, SLOT], positions)}, move, "MOVL C00001 V=100.0", FRAMES)


def stated(name: str, trap: str, plain: str = "", text: str = "") -> tuple[Attack, Attack]:
    """Something else in the head of C00001."""
    own = text or job([*START, GO], PLAIN.replace("C00001", f"{SLOT}C00001"))
    return twins(name, {"MAIN.JBI": own}, trap, plain, FRAMES)


BETWEEN = (
    ("a shift", ("SFTON P011",)),
    ("a shift in a user frame", ("SFTON P011 UF#(1)",)),
    ("a shift of three dimensions", ("SFTON3D P011",)),
    ("two shifts and one end", ("SFTON P011", "SFTON P012", "SFTOF")),
    ("a shift on one of two ways", ("JUMP *A IF IN#(1)=ON", "SFTON P011", "*A")),
    ("a shift in a block", ("IFTHENEXP B000=1", "\t SFTON P011", "ENDIF")),
    ("a shift of another case", ("SWITCH B000 CASE 1", "\t SFTON P011", "CASE 2", "\t NOP", "ENDSWITCH")),
    ("a job that no file has", ("CALL JOB:GRIP",)),
    ("a job that no file has, on a condition", ("CALL JOB:GRIP IF IN#(1)=ON",)),
    ("a job whose number is worked out", ("CALL B000",)),
    ("a job of an input group", ("CALL IG#(1)",)),
    ("a macro", ("MACRO1 MJ#(1) ARGF0.0 ARGF2.0",)),
    ("a job beside it", ("PSTART JOB:BESIDE SUB1",)),
    ("a seam that is followed", ("COMARCON AMP=2.0 FREQ=2.5 ANGL=45",)),
    ("a conveyor", ("SYSTART CV#(1) STP=0.0",)),
    ("a soft servo", ("SVON RB1",)),
    ("an instruction of another controller", ("CHGTL TL#(2)",)),
    ("parameters of the system", ("SETPRM KIND=5 PRMNO=67 D000",)),
    ("a file of a tool", ("SETFILE TOOL#(1) (1) D000",)),
    ("an instruction in small letters", ("sfton p011",)),
    ("an instruction behind a label", ("*A SFTON P011",)),
    ("an addition to what is no move", ("DOUT OT#(1) ON", "+SFTON P011")),
    ("an instruction set in", ("\t \t SFTON P011",)),
    ("an instruction with blanks between", ("SFTON    P011",)),
)

WHOLE = (
    ("a user frame set anew", ("MFRAME UF#(1) P011 P012 P013",)),
    ("a user frame whose number is worked out", ("MFRAME UF#(B000) P011 P012 P013",)),
    ("a tool set anew", ("SETTOOL TL#(1) P011",)),
    ("a tool whose number is worked out", ("SETTOOL TL#(B000) P011",)),
    ("a block that is never closed", ("IFTHENEXP B000=1",)),
    ("an end of a block that began nowhere", ("ENDWHILE",)),
    ("a part of another block", ("IFTHENEXP B000=1", "CASE 2", "ENDIF")),
    ("lines before the first case", ("SWITCH B000", "MOVL C00002 V=1.0", "CASE 2", "ENDSWITCH")),
)
"""What is so for the whole job, or may have been done in a run before."""

MOVES = (
    ("a way from where the arm is", "IMOV C00001 V=100.0 RF"),
    ("a move that is led by a station", "SMOVL C00001 V=100.0  +MOVJ EC00001"),
    ("a move with another robot", "MOVL C00001 V=100.0  +MOVL C00002 V=100.0"),
    ("a move with another robot on a line of its own", "MOVL C00001 V=100.0\n+MOVL C00009 V=100.0"),
    ("a base that moves with it", "MOVL C00001 BC00001 V=100.0"),
    ("a base variable that moves with it", "MOVL C00001 BP001 V=100.0"),
    ("another tool", "MOVL C00001 TL#(2) V=100.0"),
    ("another user frame", "MOVL C00001 V=100.0 UF#(2)"),
    ("turns of an axis", "MOVJ C00001 VJ=10.00 MT=2"),
    ("a shift of the move", "MOVL C00001 V=100.0 +SFTON3D P011"),
    ("a search", "MOVL C00001 V=100.0 SRCH RIN#(1)=ON T=0.00 DIS=0.0"),
    ("an option that no manual has", "MOVL C00001 V=100.0 FOO=1"),
    ("two positions", "MOVL C00001 C00002 V=100.0"),
)

ANYWHERE = (
    ("the position as a point of reference", "REFP 1 C00001"),
    ("the position of a step", "GETPOS PX020 STEP#(4)"),
    ("the position of a step that is worked out", "GETPOS PX020 STEP#(B000)"),
    ("an increment", "IMOV C00001 V=10.0"),
    ("an instruction that nobody knows", "FORMAPR C00001 FCF#(1) R=D000 V=50.0"),
)
"""Behind the moves, where they use C00001."""

VARIABLE_USES = (
    ("set", "SET P010 P011"),
    ("set by an array", "SET P[B000] P011"),
    ("an element set", "SETE P010 (3) D000"),
    ("an element read", "GETE D000 P010 (3)"),
    ("all groups of it set", "GETS PX010 $PX000"),
    ("converted", "CNVRT PX010 PX011 BF"),
    ("in a sum", "ADD P010 P011"),
    ("copied", "SET P020 P010"),
    ("a shift", "SFTON P010"),
    ("a way", "IMOV P010 V=10.0 RF"),
    ("cleared with others", "CLEAR P005 10"),
    ("cleared with all", "CLEAR P000 ALL"),
    ("part of a frame", "MFRAME UF#(3) P010 P011 P012"),
    ("gone to by an array", "MOVL P[B000] V=10.0"),
    ("an argument", "CALL JOB:SUB ARGP010"),
    ("set with digits more", "SET P00010 P011"),
    ("set on a condition", "IFTHENEXP B000=1\n\t SET P010 P011\nENDIF"),
    ("set where nothing comes", "JUMP *Z\nSET P010 P011\n*Z"),
)

VARIABLE = BEFORE + position("C00002", "⟨⟩", 810.0) + position("P00010", "⟦⟧")


def variable(name: str, line: str) -> tuple[Attack, Attack]:
    """A use of P00010 behind the moves."""
    text = job([*START, SLOT], VARIABLE)
    return twins(f"a variable that is {name}", {"MAIN.JBI": text, "SUB.JBI": SUB}, line, frames=FRAMES)


HEADS = (
    ("another tool that nobody states", "///TOOL 3\n"),
    ("tool 0, which is no flange", "///TOOL 0\n"),
    ("another user frame that nobody states", "///USER 3\n"),
    ("coordinates of the tool", "///POSTYPE TOOL\n"),
    ("coordinates of a master's tool", "///POSTYPE MTOOL\n"),
    ("coordinates that no manual has", "///POSTYPE FOO\n"),
    ("pulses under another name", "///PULSE\n"),
    ("a posture that is no number", "///RCONF x\n"),
    ("a line that is none of positions", "///FOO 1\n"),
    ("a position that is none", "C00009=one\nC0000A=1,2,3\n"),
    ("a position twice", "C00002=1.000,2.000,3.000,0.0000,0.0000,0.0000\n"),
    ("a second job in the file", "/JOB\n//NAME OTHER\n//POS\n///TOOL 1\n///USER 1\n"),
)

GROUPS = (
    ("two robots", "///GROUP1 RB1\n///GROUP2 RB2\n"),
    ("another robot", "///GROUP1 RB2\n"),
    ("a base", "///GROUP1 RB1,BS1\n"),
    ("no robot", "///GROUP1 ST1\n"),
    ("no group", ""),
    ("groups that no manual has", "///GROUP1 RB1,XY1\n"),
)

ALL = PLAIN.replace("⟨", "⟦").replace("⟩", "⟧")

GROUPED = job([*START, GO], ALL, more=f"///ATTR SC,RW\n{SLOT}")

RELATIVE = "///ATTR SC,RW,RJ\n////FRAME USER 1\n///GROUP1 RB1\n"


def called(name: str, call: str, plain: str, more: str = RELATIVE) -> tuple[Attack, Attack]:
    """A job with a position, and how it is called."""
    sub = job([*START[:1], GO], BEFORE + position("C00001", "⟦⟧"), "SUB", more=more)
    return twins(name, {"MAIN.JBI": job([SLOT]), "SUB.JBI": sub}, call, plain, FRAMES)


OTHER_POSTURE = job(
    [*START, GO],
    BEFORE + position("C00002", "⟨⟩", 810.0) + position("P00010", "⟨⟩") + SLOT + position("C00001", "⟦⟧"),
)


def pairs() -> list[Attack]:
    """All attacks with their controls."""
    found = [between(name, "\n".join(lines)) for name, lines in BETWEEN]
    found += [between(name, "\n".join(lines), ALONE) for name, lines in WHOLE]
    found += [
        called_before("a called job sets the frame", "MFRAME UF#(1) P011 P012 P013", ALONE),
        called_before("a called job ends shifted", "SFTON P011"),
        called_before("a called job goes on with one that no file has", "JUMP JOB:X"),
        called_before("a called job calls one that no file has", "CALL JOB:X IF IN#(1)=ON"),
    ]
    found += [moved(name, line) for name, line in MOVES]
    found += [
        twins(name, {"MAIN.JBI": job([*START, GO, SLOT], PLAIN)}, line, frames=FRAMES)
        if "STEP" not in line
        else twins(name, {"MAIN.JBI": job([*START[:1], GO, SLOT], BEFORE + position("C00001", "⟦⟧"))}, line, "", FRAMES)
        for name, line in ANYWHERE
    ]
    found += [variable(name, line) for name, line in VARIABLE_USES]
    found += [stated(name, head) for name, head in HEADS[:7]]
    found += [stated(name, head, text=job([*START, GO], ALL + SLOT)) for name, head in HEADS[8:]]
    found += [stated(f"a job of {name}", groups, "///GROUP1 RB1\n", GROUPED) for name, groups in GROUPS]
    found += [
        called("a relative job called with another frame that nobody states", "CALL JOB:SUB UF#(7)", "CALL JOB:SUB"),
        called("a relative job called with a frame that is worked out", "CALL JOB:SUB UF#(B000)", "CALL JOB:SUB"),
        called("a relative job called with two frames", "CALL JOB:SUB\nCALL JOB:SUB UF#(2)", "CALL JOB:SUB"),
        called("a plain job called with a frame", "CALL JOB:SUB UF#(2)", "CALL JOB:SUB", "///ATTR SC,RW\n///GROUP1 RB1\n"),
        called("a job called shifted", "SFTON P011\nCALL JOB:SUB\nSFTOF", "CALL JOB:SUB"),
        called("a job called shifted once", "CALL JOB:SUB\nSFTON P011\nCALL JOB:SUB\nSFTOF", "CALL JOB:SUB"),
        stated(
            "a relative job taught in another frame", "2", "1",
            job([*START, GO], BEFORE + position("C00001", "⟦⟧") + position("C00002", "⟦⟧") + position("P00010", "⟨⟩"),
                more=RELATIVE.replace("USER 1", f"USER {SLOT}")),
        ),
        twins("another posture, which is not read", {"MAIN.JBI": OTHER_POSTURE}, "///RCONF 0,0,0,0,0,0\n", "", FRAMES),
        twins(
            "a number too many", {"MAIN.JBI": job([*START, GO], PLAIN.replace("-68.9680⟧", f"-68.9680{SLOT}⟧"))},
            ",0.0000", "", FRAMES,
        ),
    ]  # fmt: skip
    both = {"MAIN.JBI": job([*START], VARIABLE), "OTHER.JBI": job([SLOT], name="OTHER")}
    found.append(twins("a variable that another job sets", both, "SET P010 P011", "DOUT OT#(1) ON", FRAMES))
    states = {"MAIN.JBI": job([*START], VARIABLE), "OTHER.JBI": job(["NOP"], f"{USER}{SLOT}", "OTHER")}
    found.append(twins("a variable that two jobs state", states, position("P00010"), position("P00011"), FRAMES))
    return [attack for pair in found for attack in pair]


HARMLESS = Attack(
    "what changes nothing of the geometry",
    {
        "MAIN.JBI": job(
            [
                *START, "'SFTON P011", "//SFTON P011", 'MSG "SFTON P011"', "DOUT OT#(1) ON", "TIMER T=0.50",
                "WAIT IN#(1)=ON T=1.00",
                "SET B000 1", "SET P011 P012", "GETE D000 P011 (1)", "SETE P011 (2) D000", "ARCON ASF#(1)",
                "WVON WEV#(1)", "WVOF", "ARCOF AEF#(1)", "PAUSE IF IN#(2)=ON", "SPEED VJ=50.00 V=276.0", "SFTOF",
                "MFRAME UF#(3) P011 P012 P013", "SETTOOL TL#(3) P011", "SFTON P011", "NOP", "SFTOF", "CALL JOB:SUB",
                "MOVJ EC00001 VJ=10.00",
                "FOR I000=1 TO 3", "\t INC B001", "NEXT I000", "WHILEEXP IN#(1)=ON", "\t NOP", "ENDWHILE",
                "JUMP *A IF B000=1", "DOUT OT#(2) OFF", "*A", "REFP 1 C00009",
                "MOVL C00001 EC00001 V=I004 PL=0 CR=5.0 ACC=20 DEC=30 NWAIT  +MOVJ EC00002 VJ=10.00  //C00001",
                "MOVC C00001 V=50.0 FPT", "MOVS C00001 V=50.0 UNTIL IN#(1)=ON", "MOVJ C00001 VJ=10.00 ENWAIT T=0.50 TRAP *A",
            ],
            PLAIN.replace("⟦", "⟨").replace("⟧", "⟩"),
        ),
        "SUB.JBI": SUB,
    },
    FRAMES,
)  # fmt: skip

ATTACKS = [*pairs(), HARMLESS]
