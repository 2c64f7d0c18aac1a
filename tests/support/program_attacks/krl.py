"""Constructs of KRL that change what a target means, after KUKA's manual, each beside plain targets of the same kind."""

from __future__ import annotations

from program_attacks import Attack

POSE = "{X 500,Y 10,Z 300,A 4,B 5,C 6}"

OTHER = "{X 400,Y 20,Z 350,A 7,B 8,C 9}"

FULL = "{X 500,Y 10,Z 300,A 4,B 5,C 6,S 2,T 10}"

GOOD = f"LIN ⟨{POSE}⟩"

LEFT = f"LIN ⟦{POSE}⟧"

FRAME = "{X 100,Y 0,Z 50,A 10,B 0,C 0}"

BEGIN = (
    "BAS(#INITMOV,0)\nPTP {A1 10,A2 -80,A3 90,A4 5,A5 40,A6 6}\n"
    "$BASE={X 1,Y 2,Z 3,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}\n"
)
"""Axes, base and tool are known behind it."""


DECLARED = "DECL E6POS P1,P2,P3\nDECL E6POS P[5]\nINT I\nREAL R\nFRAME F\n"


def program(body: str, more: str = "") -> dict[str, str]:
    """A program of one file, known at its beginning."""
    return {"a.src": f"&ACCESS RVP\nDEF a( )\n{DECLARED}{BEGIN}{body}\nEND\n{more}"}


def project(body: str, data: str, more: str = "", **others: str) -> dict[str, str]:
    """A program with its data list, and other files, in whose names `_` is `$` and `__` a point."""
    files = {"a.src": f"DEF a( )\n{BEGIN}{body}\nEND\n{more}", "a.dat": f"DEFDAT A\n{data}\nENDDAT\n"}
    return files | {name.replace("__", ".").replace("_", "$"): text for name, text in others.items()}


CONFIG = (
    "DEFDAT $CONFIG\nFRAME BASE_DATA[32]\nFRAME TOOL_DATA[16]\n"
    f"BASE_DATA[1]={FRAME}\nBASE_DATA[2]={OTHER}\nTOOL_DATA[1]={FRAME}\nENDDAT\n"
)

FORM = 'DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}'

INLINE = "$BWDSTART=FALSE\nPDAT_ACT=PPDAT1\nFDAT_ACT=FP1\nBAS(#PTP_PARAMS,100)\nPTP XP1"


def left(name: str, statement: str, why: str = "", more: str = "") -> Attack:
    """A statement behind which a plain target is left, and before which the same is corrected."""
    return Attack(name, program(f"{GOOD}\n{statement}\n{LEFT}", more), why=why)


def followed(name: str, statement: str, more: str = "") -> Attack:
    """A statement that is followed exactly, or is harmless."""
    return Attack(name, program(f"{GOOD}\n{statement}\n{GOOD}", more))


def point(name: str, statement: str, why: str = "", more: str = "") -> Attack:
    """A statement that uses the numbers of a point otherwise; another point beside it is corrected."""
    return Attack(name, program(f"P1=⟦{POSE}⟧\nP2=⟨{OTHER}⟩\nLIN P1\nLIN P2\n{statement}", more), why=why)


FRAMES = (
    left(
        "the base from a function",
        "$BASE=newbase(3)",
        more="DEFFCT FRAME newbase(n:IN)\nINT n\nRETURN $NULLFRAME\nENDFCT\n",
    ),
    left("a base of the controller that nobody gives", "BAS(#BASE,4)", "4"),
    left("a tool of the controller that nobody gives", "BAS(#TOOL,4)", "4"),
    left("a base worked out", "$BASE.Z=R+5"),
    left("an angle of the base", "$BASE.A=R"),
    left("the base from where the arm is", "$BASE=$POS_ACT"),
    left("the tool of INITMOV", "BAS(#INITMOV,0)"),
    left("the base in one branch", "IF $IN[1] THEN\n$BASE=$NULLFRAME\nENDIF", "ways"),
    left("other bases in two branches", f"IF $IN[1] THEN\n$BASE=$NULLFRAME\nELSE\n$BASE={FRAME}\nENDIF"),
    left("the base in a case", "SWITCH I\nCASE 1,2\n$BASE=$NULLFRAME\nENDSWITCH"),
    left("the tool in a branch, in small letters", "if $in[1] then\n$tool=$nullframe\nendif"),
    left("a base that grows", "FOR I=1 TO 3\n$BASE=$BASE:{X 10,Y 0,Z 0,A 0,B 0,C 0}\nENDFOR"),
    left("the base in a loop that may not run", "WHILE $IN[1]\n$BASE=$NULLFRAME\nENDWHILE"),
    left("the base in a called routine", "sub()", more="DEF sub()\nIF $IN[2] THEN\n$BASE=$NULLFRAME\nENDIF\nEND\n"),
    left("a routine that no file has", "MYSUB(1)", "MYSUB"),
    left("a function that no file has, in a condition", "IF MYFCT(1) THEN\nHALT\nENDIF", "MYFCT"),
    left("the tool outside", "$IPO_MODE=#TCP", "outside"),
    left("the mode in a branch", "IF $IN[1] THEN\n$IPO_MODE=#TCP\nENDIF"),
    left("external kinematics", "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,{X 0,Y 0,Z 0,A 0,B 0,C 0})"),
    left("a base of an incomplete frame", "$BASE={X 100}"),
    left("a statement that is none", "MOVEIT P1", "not understood"),
    left("a text that does not end", '$LOOP_MSG[]="', "not understood"),
    left("a command to the controller", 'CWRITE($CMD,STAT,MODE,"RUN /R1/X()")'),
    left("palletizing mode", "$PAL_MODE=TRUE", "$PAL_MODE"),
    left("the function generator", "$TECH[1].MODE=#CYCLE", "$TECH"),
    left("a sensor", "ST_ON1(1,2)", "sensor"),
    left("BAS of an external base", "BAS(#EX_BASE,2)"),
    left("BAS of frames that nobody gives", "BAS(#FRAMES,0)"),
    left("the base in a spline's head", "SPLINE WITH $BASE={X R,Y 0,Z 0,A 0,B 0,C 0}\nSPL P3\nENDSPLINE\n$BASE.Y=R"),
    left("the orientation is ignored", "$ORI_TYPE=#IGNORE", "IGNORE"),
    left(
        "recursion",
        "sub()",
        "calls itself",
        more="DEF sub()\nIF $IN[1] THEN\n$TOOL=$NULLFRAME\nsub()\nENDIF\nEND\n",
    ),
    followed("recursion that sets nothing", "sub()", more="DEF sub()\nIF $IN[1] THEN\nsub()\nENDIF\nEND\n"),
    left("a jump around the base", "IF $IN[1] THEN\nGOTO on\nENDIF\n$BASE=$NULLFRAME\non:"),
    left("a routine that gives the base by its parameter", "sub(I)", more="DEF sub(n:IN)\nINT n\nBAS(#BASE,n)\nEND\n"),
    left("PTP_REL and then poses without posture", "I=I+1\n$TOOL=P[I]"),
    Attack(
        "bases shifted by the correction of BAS",
        {
            "a.src": f"DEF a()\n{BEGIN}{GOOD}\nBASE_CORR_ON=TRUE\nBAS(#BASE,1)\n{LEFT}\nEND\n",
            "$config.dat": CONFIG,
        },
        why="BASE_CORR_ON",
    ),
    Attack(
        "a base that a routine writes for the next run",
        {"a.src": f"DEF a()\n{BEGIN}{GOOD}\nBAS(#BASE,1)\n{LEFT}\nBASE_DATA[1]={OTHER}\nEND\n", "$config.dat": CONFIG},
        why="one run to the next",
    ),
    Attack(
        "any base may have been written",
        {"a.src": f"DEF a()\n{BEGIN}{GOOD}\nBASE_DATA[I]={OTHER}\nBAS(#BASE,1)\n{LEFT}\nEND\n", "$config.dat": CONFIG},
    ),
    Attack(
        "a base behind a routine that no file has",
        {
            "a.src": f"DEF a()\n{BEGIN}{GOOD}\nMYSUB()\nBAS(#BASE,1)\n$TOOL=$NULLFRAME\n{LEFT}\nEND\n",
            "$config.dat": CONFIG,
        },
        why="MYSUB",
    ),
    Attack(
        "a base that moves with an external axis",
        {
            "a.src": f"DEF a()\n{BEGIN}{GOOD}\nBAS(#BASE,1)\n{LEFT}\nEND\n",
            "$config.dat": CONFIG.replace("ENDDAT", 'MACHINE_FRAME_DAT[1]={MACH_DEF_INDEX 2,PARENT[] "T"}\nENDDAT'),
        },
        why="external axis",
    ),
    Attack(
        "a base of the controller that contradicts --frames",
        {"a.src": f"DEF a()\n{BEGIN}{GOOD}\nBAS(#BASE,1)\n{LEFT}\nEND\n", "$config.dat": CONFIG},
        frames='format: 1\nbases: {"1": {xyz: [0.5, 0, 0], rpy: [0, 0, 0]}}\n',
        why="--frames",
    ),
    Attack(
        "an interrupt sets the base",
        program(
            f"INTERRUPT DECL 5 WHEN $IN[3] DO stop1()\nINTERRUPT ON 5\n{LEFT}", "DEF stop1()\n$BASE=$NULLFRAME\nEND\n"
        ),
        why="at any time",
    ),
    Attack(
        "an interrupt of a routine that no file has",
        program(f"INTERRUPT DECL 5 WHEN $IN[3] DO stop2()\nINTERRUPT ON 5\n{LEFT}"),
        why="at any time",
    ),
    Attack(
        "a trigger sets the tool",
        program(f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO sub() PRIO=-1\n{LEFT}", "DEF sub()\n$TOOL=$NULLFRAME\nEND\n"),
        why="at any time",
    ),
    Attack(
        "an interrupt breaks a routine off",
        program(
            f"INTERRUPT DECL 5 WHEN $IN[3] DO stop1()\n{GOOD}\nsub()\n{LEFT}",
            "DEF sub()\n$BASE=$NULLFRAME\nBAS(#TOOL,0)\n$BASE={X 1,Y 2,Z 3,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}\nEND\n"
            "DEF stop1()\nBRAKE\nRESUME\nEND\n",
        ),
        why="RESUME",
    ),
    Attack(
        "no base is set", {"a.src": f"DEF a()\nPTP ⟨{{A1 1,A2 -90,A3 90,A4 0,A5 9,A6 0}}⟩\n{LEFT}\nEND\n"}, why="$BASE"
    ),
    Attack(
        "routines that nothing calls begin with nothing",
        program(GOOD, f"DEF other()\n{LEFT}\nEND\n"),
        why="$BASE",
    ),
    Attack(
        "callers with other bases",
        program("sub()\n$BASE=$NULLFRAME\nsub()", f"DEF sub()\n{LEFT}\nEND\n"),
        why="another frame",
    ),
    Attack(
        "a file whose blocks do not close",
        {"a.src": f"DEF a()\n{BEGIN}IF $IN[1] THEN\n{LEFT}\nEND\n"},
        why="understood",
    ),
    Attack("an END too many", {"a.src": f"DEF a()\n{BEGIN}{LEFT}\nENDIF\nEND\n"}, why="understood"),
    Attack("a jump to nowhere", {"a.src": f"DEF a()\n{BEGIN}{LEFT}\nGOTO nowhere\nEND\n"}, why="label"),
    Attack(
        "a carriage return alone", {"a.src": f"DEF a()\n{BEGIN}; text\r$BASE=$NULLFRAME\n{LEFT}\nEND\n"}, why="carriage"
    ),
    Attack(
        "two files have the routine",
        {
            "a.src": f"DEF a()\n{BEGIN}{GOOD}\nsub()\n{LEFT}\nEND\n",
            "sub.src": "DEF sub()\nEND\n",
            "b.src": "DEF b()\nEND\nGLOBAL DEF sub()\n$BASE=$NULLFRAME\nEND\n",
        },
        why="several files",
    ),
)

POINTS = (
    point("written by part", "P1.Z=350", "part"),
    point("written by part, worked out", "P1.Z=P1.Z+10", "P1|part|computes"),
    point("written by part in small letters with blanks", "  p1 .z = 3"),
    point("assigned from", "P3=P1", "assigns"),
    point("computed with", "R=P1.X+5", "computes"),
    point("looked at in a condition", "IF P1.X>5 THEN\nHALT\nENDIF", "computes"),
    point("looked at in a loop", "WHILE P1.X>5\nHALT\nENDWHILE"),
    point("looked at until", "REPEAT\nHALT\nUNTIL P1.X>5"),
    point("looked at by FOR", "FOR I=1 TO P1.X\nHALT\nENDFOR"),
    point("looked at by SWITCH", "SWITCH P1.S\nCASE 2\nHALT\nENDSWITCH"),
    point("passed to a routine", "sub(P1)", "passes", more="DEF sub(q:OUT)\nE6POS q\nEND\n"),
    point("passed by value", "sub(P1)", "passes", more="DEF sub(q:IN)\nE6POS q\nEND\n"),
    point("passed to a function", "R=ABS(P1.X)"),
    point("used as the base", "$BASE=P1", "frame"),
    point("used in the base", f"$BASE={FRAME}:P1", "frame"),
    point("used as the tool", "$TOOL=P1", "frame"),
    point("a shift of another point", "LIN P2:P1", "shift"),
    point("written to a file", 'SWRITE(BUF[],STAT,OFF,"%f",P1.X)'),
    point("waited for", "WAIT FOR P1.X>5"),
    point("put out", "$ANOUT[1]=P1.X*0.1"),
    point("in a trigger", "TRIGGER WHEN DISTANCE=0 DELAY=0 DO R=P1.X"),
    point("in an interrupt's condition", "INTERRUPT DECL 4 WHEN P1.X>3 DO sub()", more="DEF sub()\nEND\n"),
    point("in a statement that is none", "FOO P1 BAR", "not understood"),
    point("handed back", "IF $IN[1] THEN\nRETURN P1\nENDIF"),
    point("read back from a channel", "CREAD(HANDLE,STAT,MODE,TIMEOUT,OFFSET,FORMAT[],P1)"),
    point("an index is worked out with it", "R=X[P1.S]"),
    Attack("two bases", program(f"P1=⟦{POSE}⟧\nLIN P1\n$BASE=$NULLFRAME\nLIN P1\n{GOOD}"), why="another frame"),
    Attack("two tools", program(f"P1=⟦{POSE}⟧\nLIN P1\n$TOOL=$NULLFRAME\nLIN P1\n{GOOD}"), why="another tool"),
    Attack("a base that goes round a loop", program(f"LOOP\n{LEFT}\n$BASE=$BASE:{FRAME}\nENDLOOP")),
    Attack(
        "indexed",
        program(f"P[1]=⟦{POSE}⟧\nP[2]=⟦{POSE}⟧\nP2=⟨{POSE}⟩\nFOR I=1 TO 2\nLIN P[I]\nENDFOR\nLIN P2"),
        why="indexes",
    ),
    Attack("indexed, and named once", program(f"P[1]=⟦{POSE}⟧\nLIN P[1]\nI=1\nLIN P[I]\n{GOOD}"), why="indexes"),
    Attack("an element assigned at a place worked out", program(f"P[I]=⟦{POSE}⟧\nLIN P[1]\n{GOOD}")),
    Attack("the same number under another name", program(f"P1=⟦{POSE}⟧\nP2=P1\nLIN P2\n{GOOD}"), why="assigns"),
    Attack("one of two values", program(f"IF $IN[1] THEN\nP1=⟦{POSE}⟧\nELSE\nP1=⟦{OTHER}⟧\nENDIF\nLIN P1\n{GOOD}")),
    Attack("a part is worked out in the literal", program(f"P1={{X R,Y 2,Z ⟦3⟧,A 4,B 5,C 6}}\nLIN P1\n{GOOD}")),
    Attack("a part of the literal in a move is worked out", program(f"LIN {{X ⟦1⟧,Y 2,Z 100+R,A 4,B 5,C 6}}\n{GOOD}")),
    Attack("a part of a pose", program(f"LIN {{Z ⟦300⟧}}\n{GOOD}"), why="does not state"),
    Attack("a step", program(f"LIN_REL {{X ⟦10⟧,Y 0,Z 5}}\n{GOOD}"), why="step"),
    Attack(
        "a step of axes",
        program(f"PTP_REL {{A1 ⟦10⟧}}\nPTP {{A1 ⟨10⟩,A2 -80,A3 90,A4 5,A5 40,A6 6}}\n{GOOD}"),
        why="step",
    ),
    Attack("a circle that goes on", program(f"CIRC ⟦{POSE}⟧,⟦{OTHER}⟧,CA 235\n{GOOD}"), why="CA"),
    Attack("a name twice in a pose", program("LIN {X ⟦1⟧,X 2,Y 2,Z 3,A 4,B 5,C 6}\n$BASE=$NULLFRAME")),
    Attack("a field that no pose has", program(f"LIN {{X ⟦1⟧,Y 2,Z 3,A 4,B 5,C 6,Q 7}}\n{GOOD}"), why="Q"),
    Attack("numbers beyond a million", program(f"LIN {{X ⟦1e7⟧,Y 2,Z 3,A 4,B 5,C 6}}\n{GOOD}"), why="million"),
    Attack("numbers beyond all", program(f"LIN {{X ⟦1e999⟧,Y 2,Z 3,A 4,B 5,C 6}}\n{GOOD}")),
    Attack("the posture in bits", program(f"PTP {{X ⟨1⟩,Y 2,Z 3,A 4,B 5,C 6,S 'B010',T 'HA'}}\n{GOOD}")),
    Attack("a coordinate in bits", program(f"PTP {{X 'B001',Y ⟦2⟧,Z 3,A 4,B 5,C 6,S 2,T 10}}\n{GOOD}"), why="bits"),
    Attack(
        "a point of the data list that the program writes",
        project(f"LIN P1\nP1={OTHER}\n{GOOD}", f"DECL E6POS P1=⟦{POSE}⟧"),
        why="one run to the next",
    ),
    Attack(
        "a point of the data list that a routine that no file has gets",
        project(
            f"{GOOD}\nTEACH(P1)\n$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\n$IPO_MODE=#BASE\nLIN P1\nLIN P2",
            f"DECL E6POS P1=⟦{POSE}⟧\nDECL E6POS P2=⟨{POSE}⟩",
        ),
    ),
    Attack(
        "a point that is declared twice",
        project(f"LIN P1\n{GOOD}", f"DECL E6POS P1=⟦{POSE}⟧\nDECL E6POS P1=⟦{OTHER}⟧"),
    ),
    Attack("a point that no move goes to", project(GOOD, f"DECL E6POS P1=⟦{POSE}⟧"), why="no move"),
    Attack(
        "a local variable hides the point",
        project(f"{GOOD}\nsub()", f"DECL E6POS P1=⟦{POSE}⟧", f"DEF sub()\nE6POS P1\nP1=⟨{OTHER}⟩\nLIN P1\nEND\n"),
    ),
    Attack(
        "a parameter hides the point",
        project(
            f"{GOOD}\nsub(P2)",
            f"DECL E6POS P1=⟦{POSE}⟧\nDECL E6POS P2=⟦{POSE}⟧",
            "DEF sub(P1:IN)\nE6POS P1\nLIN P1\nEND\n",
        ),
    ),
    Attack(
        "a point of another module",
        project(
            f"LIN P1\n{GOOD}", "INT N", b__dat=f"DEFDAT B\nDECL E6POS P1=⟦{POSE}⟧\nENDDAT\n", b__src="DEF b()\nEND\n"
        ),
    ),
    Attack(
        "a global point that another file computes with",
        project(f"LIN P1\n{GOOD}", f"DECL GLOBAL E6POS P1=⟦{POSE}⟧", b__src="DEF b()\nREAL R\nR=P1.Z\nEND\n"),
        why="b.src",
    ),
    Attack(
        "a point of a file that is not corrected",
        project(f"LIN XGLOB\n{GOOD}", "INT N", _config__dat=f"DEFDAT $CONFIG\nDECL E6POS XGLOB=⟦{POSE}⟧\nENDDAT\n"),
        why="not corrected",
    ),
    Attack(
        "the data of an inline form are written",
        project(f"FP1.BASE_NO=2\n{INLINE}", f"DECL E6POS XP1=⟦{FULL}⟧\n{FORM}", _config__dat=CONFIG).copy()
        | {"b.src": f"DEF b()\nFP1.TOOL_NO=R\nEND\nDEF c()\n{BEGIN}{GOOD}\nEND\n"},
    ),
    Attack(
        "the form's data depend on a branch",
        project(
            "IF $IN[1] THEN\nFDAT_ACT=FP1\nELSE\nFDAT_ACT=FP2\nENDIF\n"
            f"BAS(#PTP_PARAMS,100)\nPTP XP1\n{INLINE.replace('XP1', 'XP2')}",
            f"DECL E6POS XP1=⟦{FULL}⟧\nDECL E6POS XP2=⟨{FULL}⟩\n{FORM}\n"
            f"{FORM.replace('FP1', 'FP2').replace('BASE_NO 1', 'BASE_NO 2')}",
            _config__dat=CONFIG,
        ),
    ),
    Attack(
        "a form outside",
        project(INLINE, f"DECL E6POS XP1=⟦{FULL}⟧\n{FORM.replace('#BASE', '#TCP')}", _config__dat=CONFIG),
        why="outside",
    ),
    Attack(
        "a form with the base of an external axis",
        project(
            "SLIN XP1 WITH $TOOL=STOOL2(FP1),$BASE=EK(K_ROOT(FP1.BASE_NO),K_TYPE(FP1.BASE_NO),K_OFFS(FP1.BASE_NO))",
            f"DECL E6POS XP1=⟦{FULL}⟧\n{FORM}",
            _config__dat=CONFIG,
        ),
        why="external axis",
    ),
    Attack(
        "the base of a move alone",
        program(f"P1=⟦{POSE}⟧\nSLIN P1 WITH $BASE=$NULLFRAME\nSLIN P1\n{GOOD}"),
        why="another frame",
    ),
    Attack("a comment is none", program(f"; LIN {POSE.replace('500', '⟦500⟧')}\n{GOOD}\n;FOLD LIN ⟦{POSE}⟧\n;ENDFOLD")),
    Attack("a text is none", program(f'MSG[]="LIN ⟦{POSE}⟧"\n{GOOD}')),
    Attack("behind a text with a semicolon", program(f'MSG[]="a;b" ; LIN ⟦{POSE}⟧\n{GOOD}')),
    Attack("frames beside axes", program(f"PTP {{A1 ⟦1⟧,A2 -90,A3 90,A4 0,A5 9,A6 0}}:{FRAME}\n{GOOD}")),
)

CONTROLS = (
    followed("a part of the base", "$BASE.Z=100"),
    followed(
        "signals and timers",
        "$OUT[3]=TRUE\n$TIMER[1]=0\n$TIMER_STOP[1]=FALSE\n$FLAG[2]=$IN[3] AND NOT $IN[4]\nPULSE($OUT[1],TRUE,0.5)",
    ),
    followed(
        "speeds",
        "$VEL.CP=0.2\n$ACC_AXIS[1]=50\n$APO.CDIS=5\n$ADVANCE=3\nBAS(#VEL_PTP,30)\nBAS (#ACC_CP , 20 )\n$OV_PRO=50",
    ),
    followed("waits", "WAIT SEC 0.5\nWAIT FOR $IN[1] AND NOT $IN[2]\nCONTINUE\nHALT"),
    followed("arithmetic", "I=I+1\nR=SIN(R)*2-I/3\nP[I+1].X=R"),
    followed("messages", 'MSGNOTIFY("text; with a semicolon")\n$LOOP_MSG[]="a"'),
    followed("branches alike", "IF $IN[1] THEN\nHALT\nELSE\nWAIT SEC 1\nENDIF"),
    followed("a branch that sets the same base", "IF $IN[1] THEN\n$BASE={X 1,Y 2,Z 3,A 0,B 0,C 0}\nENDIF"),
    followed("loops", "FOR I=1 TO 5 STEP 2\nWAIT SEC 0.1\nENDFOR\nREPEAT\nI=I+1\nUNTIL I>3"),
    followed("a routine that is given", "sub(3)", "DEF sub(n:IN)\nINT n\n$OUT[n]=TRUE\nEND\n"),
    followed("the standard interrupt", "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\nINTERRUPT ON 3"),
    followed("a trigger of a signal", "TRIGGER WHEN DISTANCE=1 DELAY=-20 DO $OUT[5]=TRUE PRIO=-1"),
    followed(
        "an interrupt that only counts",
        "INTERRUPT DECL 4 WHEN $IN[4] DO sub()\nINTERRUPT ON 4",
        "DEF sub()\nI=I+1\nEND\n",
    ),
    followed("a load", "$LOAD={M 5,CM {X 0,Y 0,Z 10,A 0,B 0,C 0},J {X 0,Y 0,Z 0}}"),
    followed("grippers", "H50(GRP_APO,1,2,GCONT)\nUSER_GRP(0,DUMMY,DUMMY,GDEFAULT)"),
    followed("external axes", "ASYPTP {E1 30}"),
    followed("relative moves along a line", "LIN_REL {Z 50} #TOOL"),
    Attack(
        "a spline",
        program(f"SPLINE WITH $VEL.CP=0.2\nSPL ⟨{POSE}⟩\nSLIN ⟨{OTHER}⟩\nSCIRC ⟨{POSE}⟩,⟨{OTHER}⟩\nENDSPLINE C_SPL"),
    ),
    Attack("a circle", program(f"CIRC ⟨{POSE}⟩,⟨{OTHER}⟩ C_DIS")),
    Attack(
        "a shifted point",
        program(f"P1=⟨{POSE}⟩\nLIN P1:{{X 0,Y 0,Z -50,A 0,B 0,C 0}}\nLIN P1\nLIN P1:{{X 0,Y 0,Z -50,A 0,B 0,C 0}}"),
    ),
    Attack(
        "types before numbers",
        program(
            "LIN ⟨{FRAME: X 500, Y 10, Z 300, A 4, B 5, C 6}⟩\nPTP ⟨{E6POS:X 500,Y 10,Z 300,A 4,B 5,C 6,S 2,T 10,E1 0}⟩"
        ),
    ),
    Attack("numbers of all forms", program("LIN ⟨{X +500.,Y .5,Z 3e2,A -4E+0,B 5,C 6}⟩")),
    Attack(
        "tabs, blanks and small letters",
        program("\tlin\t⟨{ x 500 ,y\t10 , z 300,a 4,b 5,c 6 }⟩\tc_dis c_dis ; comment"),
    ),
    Attack(
        "inline forms",
        project(
            INLINE,
            f"DECL E6POS XP1=⟨{FULL}⟩\n{FORM}\nDECL PDAT PPDAT1={{VEL 100.0,ACC 100.0,APO_DIST 100.0}}",
            _config__dat=CONFIG,
        ),
    ),
    Attack(
        "inline forms of KSS 8",
        project(
            "SPTP XP1 WITH $VEL_AXIS[1]=SVEL_JOINT(100.0), $TOOL=STOOL2(FP1), $BASE=SBASE(FP1.BASE_NO), "
            "$IPO_MODE=SIPO_MODE(FP1.IPO_FRAME), $LOAD=SLOAD(FP1.TOOL_NO), $ACC_AXIS[1]=SACC_JOINT(PPDAT1), "
            "$APO=SAPO_PTP(PPDAT1), $GEAR_JERK[1]=SGEAR_JERK(PPDAT1), $COLLMON_TOL_PRO[1]=USE_CM_PRO_VALUES(0) C_SPL",
            f"DECL E6POS XP1=⟨{FULL}⟩\n{FORM}",
            _config__dat=CONFIG,
        ),
    ),
    Attack(
        "numbered bases of --frames",
        program(f"BAS(#BASE,5)\nBAS(#TOOL,3)\n{GOOD}"),
        frames='format: 1\nbases: {"5": {xyz: [0.5, 0, 0], rpy: [0, 0, 0]}}\ntools: {"3": {xyz: [0, 0, 0.1], rpy: [0, 0, 0]}}\n',
    ),
    Attack(
        "a base that is set twice",
        {
            "a.src": f"DEF a()\n{BEGIN}BASE_DATA[1]={FRAME}\n$BASE=BASE_DATA[1]\n{GOOD}\n"
            f"BASE_DATA[1]={OTHER}\n{GOOD}\nBAS(#BASE,1)\n{GOOD}\nEND\n"
        },
    ),
    Attack(
        "a harmless routine of --frames",
        program(f"WELD_ON(3)\n{GOOD}"),
        frames="format: 1\nharmless: [weld_on]\n",
    ),
    Attack(
        "a routine that no file has reaches no points of the data list",
        project(
            f"MYSUB()\n$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\n$IPO_MODE=#BASE\nLIN P1\n{GOOD}", f"DECL E6POS P1=⟨{POSE}⟩"
        ),
    ),
    Attack(
        "home is monitored",
        project(f"$H_POS=XHOME\nPTP XHOME\n{GOOD}", "DECL E6AXIS XHOME=⟨{A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}⟩"),
    ),
)

ATTACKS: tuple[Attack, ...] = (*FRAMES, *POINTS, *CONTROLS)
