"""KRL: constructs of the programming manual, and of programs by hand, that change what a target means."""

from __future__ import annotations

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

SET = """$BASE={X 100,Y 0,Z 50,A 0,B 0,C 0}
$TOOL={X 0,Y 0,Z 120,A 0,B 0,C 0}
PTP ⟨{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}⟩
"""

POSE = "{X 900,Y 100,Z 800,A 0,B 90,C 0}"


def lone(
    name: str, trap: str, plain: str = "", declared: str = "", below: str = "", why: str = ""
) -> tuple[Attack, Attack]:
    """A trap between a joint target and a pose.

    Args:
        name: Of the attack.
        trap: Lines.
        plain: Lines in their place in the control.
        declared: Lines of declarations.
        below: Routines below.
        why: Words of the reason.
    """
    text = f"DEF p()\n{declared}{SET}§\nLIN ⟦{POSE}⟧\nEND\n{below}"
    return twins(name, {"p.src": text}, trap, plain, FRAMES, why)


def body(
    name: str,
    text: str,
    trap: str | tuple[str, ...],
    plain: str | tuple[str, ...] = "",
    declared: str = "",
    below: str = "",
) -> tuple[Attack, Attack]:
    """A program's lines behind the first joint target."""
    return twins(name, {"p.src": f"DEF p()\n{declared}{SET}{text}\nEND\n{below}"}, trap, plain, FRAMES)


POINT = f"DECL E6POS P1\nP1=⟦{POSE}⟧\n"

STATE = (
    *lone("the base's number comes from inputs", "$BASE=BASE_DATA[N]", "$BASE=BASE_DATA[1]", "DECL INT N\nN=$IN[1]\n"),
    *lone("the base is where the arm is", "$BASE=$POS_ACT", "$VEL.CP=0.5"),
    *lone("BAS sets a base by a number that is not known", "BAS(#BASE,N)", "BAS(#BASE,1)", "DECL INT N\nN=$ANIN[1]\n"),
    *lone("BAS sets a tool by a number that is not known", "BAS(#TOOL,N)", "BAS(#TOOL,2)", "DECL INT N\nN=$ANIN[1]\n"),
    *lone("a component of the base is measured", "$BASE.Z=$ANIN[1]*100", "$ADVANCE=3"),
    *lone(
        "a component of the tool is worn", "$TOOL.Z=$TOOL.Z-WEAR", "$VEL.ORI1=200", "DECL REAL WEAR\nWEAR=$ANIN[2]\n"
    ),
    *lone("the tool stands in the room", "$IPO_MODE=#TCP", "$IPO_MODE=#BASE"),
    *lone(
        "the base is on a table that turns",
        "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,{X 0,Y 0,Z 0,A 0,B 0,C 0})",
        "$ORI_TYPE=#VAR",
    ),
    *lone("the robot's root is set to what a variable says", "$ROBROOT=CELL_ROOT", "$APO.CDIS=10"),
    *lone("a routine of another file that is not given", "MEASURE_BASE()", "WAIT SEC 0.5"),
    *lone("an external routine that is declared", "GRIPPER(1,2)", "$OUT[1]=TRUE", "EXT GRIPPER(INT:IN,INT:IN)\n"),
    *lone(
        "a local routine sets the base to what is measured",
        "SETUP()",
        "LAMP()",
        below="DEF SETUP()\n$BASE=$POS_ACT\nEND\nDEF LAMP()\n$OUT[1]=TRUE\nEND\n",
    ),
    *lone(
        "one branch sets another base",
        "IF $IN[1] THEN\n$BASE={X 200,Y 0,Z 50,A 0,B 0,C 0}\nENDIF",
        "IF $IN[1] THEN\n$OUT[1]=TRUE\nENDIF",
    ),
    *lone(
        "a case sets another tool",
        "SWITCH N\nCASE 1\n$TOOL={X 0,Y 0,Z 200,A 0,B 0,C 0}\nCASE 2,3\n$OUT[1]=TRUE\nENDSWITCH",
        "SWITCH N\nCASE 1\n$OUT[2]=TRUE\nCASE 2,3\n$OUT[1]=TRUE\nENDSWITCH",
        "DECL INT N\nN=$ANIN[1]\n",
    ),
    *lone(
        "a label that is reached past the line that sets the base",
        "$BASE={X 200,Y 0,Z 50,A 0,B 0,C 0}\nIF $IN[1] THEN\nGOTO ON_TABLE\nENDIF\n"
        "$BASE={X 300,Y 0,Z 50,A 0,B 0,C 0}\nON_TABLE:",
        "IF $IN[1] THEN\nGOTO ON_TABLE\nENDIF\n$OUT[3]=TRUE\nON_TABLE:",
    ),
    *lone(
        "a switching action calls what sets the base",
        f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO SEEN() PRIO=-1\nLIN {POSE}",
        "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[4]=TRUE\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 20,A6 0}",
        below="DEF SEEN()\n$BASE=$POS_ACT\nEND\n",
    ),
    *lone("a sensor corrects the path", "IRET=RSI_MOVECORR()", "WAIT FOR $IN[1]", "DECL INT IRET\n"),
    *lone("a correction by RSI is switched on", "IRET=RSI_ON(#RELATIVE)", "WAIT FOR $IN[1]", "DECL INT IRET\n"),
    *lone(
        "data of the tool are written before they are fetched",
        "TOOL_DATA[1].Z=$ANIN[1]*200\n$TOOL=TOOL_DATA[1]",
        "$TOOL=TOOL_DATA[1]",
    ),
    *lone(
        "data of the base are measured, by an index that counts",
        "FOR I=1 TO 2\nBASE_DATA[I]=$POS_ACT\nENDFOR\n$BASE=BASE_DATA[1]",
        "FOR I=1 TO 2\n$OUT[I]=TRUE\nENDFOR\n$BASE=BASE_DATA[1]",
        "DECL INT I\n",
    ),
    *lone("a base is not among those that are stated", "$BASE=BASE_DATA[7]", "$BASE=BASE_DATA[2]"),
    *lone(
        "the base has another shift at its right", "$BASE=$BASE:SHIFT", "$BASE=$BASE:$NULLFRAME", "DECL FRAME SHIFT\n"
    ),
    *lone(
        "a repeated block sets the base at least once, and then otherwise",
        "REPEAT\n$BASE.X=$ANIN[1]\nUNTIL $IN[1]",
        "REPEAT\nWAIT SEC 0.1\nUNTIL $IN[1]",
    ),
    *lone(
        "the keyboard's case",
        "$base=$Pos_Act",
        "$vel.cp=0.4",
    ),
    *lone(
        "a base is handed to a routine that changes it",
        "RAISE($BASE)",
        "LOOK($IN[1])",
        below="DEF RAISE(F:OUT)\nDECL FRAME F\nF.Z=F.Z+$ANIN[1]\nEND\nDEF LOOK(B:IN)\nDECL BOOL B\n$OUT[1]=B\nEND\n",
    ),
    *lone(
        "a function in a condition sets the base",
        "IF SEEN() THEN\n$OUT[1]=TRUE\nENDIF",
        "IF $IN[1] THEN\n$OUT[1]=TRUE\nENDIF",
        below="DEFFCT BOOL SEEN()\n$BASE=$POS_ACT\nRETURN TRUE\nENDFCT\n",
    ),
    *lone(
        "a value is read into the base from a channel",
        'CREAD(H,ST,MODE,OFF,"%r",$BASE.X)',
        'CWRITE(H,ST,MODE,"%s","ready")',
        "DECL INT H,OFF\nDECL STATE_T ST\nDECL MODUS_T MODE\n",
    ),
    *lone(
        "a jump back leads over the line that changes the base",
        "GOTO BEGIN\nAGAIN:\n$BASE.X=$ANIN[1]\nBEGIN:\nIF $IN[2] THEN\nGOTO AGAIN\nENDIF",
        "GOTO BEGIN\nAGAIN:\n$OUT[2]=TRUE\nBEGIN:\nIF $IN[2] THEN\nGOTO AGAIN\nENDIF",
    ),
)

POINTS = (
    *body("one point with two bases", f"{POINT}LIN P1\n§\nLIN P1", "$BASE=BASE_DATA[2]", "$OUT[1]=TRUE"),
    *body(
        "one point with two tools in one loop", f"{POINT}LOOP\nLIN P1\n§\nENDLOOP", "$TOOL=TOOL_DATA[2]", "$OUT[1]=TRUE"
    ),
    *body(
        "a loop's end sets another base for its next pass",
        f"FOR I=1 TO 3\nLIN ⟦{POSE}⟧\n§\nENDFOR",
        "$BASE.X=$BASE.X+100",
        "WAIT SEC 0.1",
        "DECL INT I\n",
    ),
    *body(
        "a routine that is called with two bases",
        "GO()\n§\nGO()",
        "$BASE=BASE_DATA[2]",
        "$OUT[1]=FALSE",
        below=f"DEF GO()\nLIN ⟦{POSE}⟧\nEND\n",
    ),
    *body(
        "a routine that calls itself with another base",
        "GO(2)",
        "$BASE=BASE_DATA[2]",
        "$OUT[1]=FALSE",
        below=f"DEF GO(N:IN)\nDECL INT N\nLIN ⟦{POSE}⟧\nIF N>0 THEN\n§\nGO(N-1)\nENDIF\nEND\n",
    )[:1],
    *body("a coordinate is raised", f"{POINT}§\nLIN P1", "P1.Z=P1.Z+10", "$OUT[1]=TRUE"),
    *body("a coordinate is measured", f"{POINT}§\nLIN P1", "p1.z = $ANIN[1]", "$out[1] = TRUE"),
    *body("an angle decides", f"{POINT}§\nLIN P1\nENDIF", "IF P1.A>0 THEN", "IF $IN[1] THEN"),
    *body("a step in the base", f"§ ⟦{POSE}⟧", "LIN_REL", "LIN"),
    *body("a step in the tool", f"§ ⟦{POSE}⟧§", ("LIN_REL", " #TOOL"), ("LIN", "")),
    *body("a step of the joints", "§ ⟦{A1 10,A2 -80,A3 90,A4 0,A5 10,A6 0}⟧", "PTP_REL", "PTP"),
    *body("a step by a spline's move", f"§ ⟦{POSE}⟧", "SLIN_REL", "SLIN"),
    *body(
        "a step on a circle",
        "§ ⟦{X 900,Y 100,Z 800,A 0,B 90,C 0}⟧,⟦{X 900,Y 200,Z 700,A 0,B 90,C 0}⟧",
        "CIRC_REL",
        "CIRC",
    ),
    *body(
        "a shift that is measured is put behind the point",
        f"{POINT}SHIFT=$NULLFRAME\n§",
        "SHIFT.Z=$ANIN[1]\nLIN P1:SHIFT",
        "LIN P1",
        "DECL FRAME SHIFT\n",
    ),
    *body("a frame is put before the point", f"{POINT}LIN §P1", "SEEN:", "", "DECL FRAME SEEN\nSEEN=$POS_ACT\n"),
    *body("a point with some coordinates only", "LIN ⟦{X 900,Y 100§}⟧", "", ",Z 800,A 0,B 90,C 0"),
    *body(
        "a copy is changed, and both are targets",
        f"{POINT}LIN P1\n§",
        "P2=P1\nP2.Z=$ANIN[1]\nLIN P2",
        "LIN P1",
        "DECL E6POS P2\n",
    ),
    *body("a point is the base, too", f"{POINT}LIN P1\n§", "$BASE=P1\nLIN {X 0,Y 0,Z 10,A 0,B 0,C 0}", "LIN P1"),
    *body("a point's inverse is the base", f"{POINT}LIN P1\n§", "$BASE=INV_POS(P1)", "LIN P1"),
    *body(
        "axes are worked out from the point",
        f"{POINT}LIN P1\n§",
        "AX=INVERSE(P1,$AXIS_ACT,ST)\nAX.A6=AX.A6+90\nPTP AX",
        "LIN P1",
        "DECL E6AXIS AX\nDECL INT ST\n",
    ),
    *body(
        "a pose is worked out from axes that are a target, too",
        "AX=⟦{A1 10,A2 -80,A3 90,A4 0,A5 10,A6 0}⟧\nPTP AX\n§",
        "P2=FORWARD(AX,ST)\nP2.Z=P2.Z+50\nLIN P2",
        "PTP AX",
        "DECL E6AXIS AX\nDECL E6POS P2\nDECL INT ST\n",
    ),
    *body(
        "one axis of a joint target is turned",
        "AX=⟦{A1 10,A2 -80,A3 90,A4 0,A5 10,A6 0}⟧\n§\nPTP AX",
        "AX.A6=AX.A6+90",
        "$OUT[1]=TRUE",
        "DECL E6AXIS AX\n",
    ),
    *body(
        "a point is handed to a routine that changes it",
        f"{POINT}§\nLIN P1",
        "RAISE(P1)",
        "$OUT[1]=TRUE",
        below="DEF RAISE(P:OUT)\nDECL E6POS P\nP.Z=P.Z+$ANIN[1]\nEND\n",
    ),
    *body(
        "a point is handed to a routine that does not say how it takes it",
        f"{POINT}§\nLIN P1",
        "MEASURE(P1)",
        "WAIT SEC 0",
    ),
    *body(
        "points of an array with two bases, by a number that counts",
        f"PS[1]=⟦{POSE}⟧\nPS[2]=⟦{POSE}⟧\nFOR I=1 TO 2\n$BASE=BASE_DATA[1]\nLIN PS[I]\n$BASE=BASE_DATA[2]\nLIN PS[I]\nENDFOR§",
        "",
        "",
        "DECL E6POS PS[2]\nDECL INT I\n",
    )[:1],
    *body(
        "an element of an array is overwritten by an index that is not known",
        f"PS[1]=⟦{POSE}⟧\nPS[2]=⟦{POSE}⟧\n§\nLIN PS[1]\nLIN PS[2]",
        "PS[N]=$POS_ACT",
        "$OUT[1]=TRUE",
        "DECL E6POS PS[2]\nDECL INT N\nN=$ANIN[1]\n",
    )[:1],
    *body("a move in a comment", f";FOLD LIN P1 Vel=2 m/s;%{{PE}}\n§LIN ⟦{POSE}⟧\n;ENDFOLD", ";", ""),
    *body(
        "a move in a text",
        "§LIN ⟦{X 900,Y 100,Z 800,A 0,B 90,C 0}⟧§",
        ('MSG[]="', '"'),
        ("", " C_DIS"),
        "DECL CHAR MSG[80]\n",
    ),
    *body(
        "a base that is set for one move",
        f"SLIN ⟦{POSE}⟧ WITH §",
        "$BASE=$POS_ACT",
        "$VEL.CP=0.2",
    ),
    *body(
        "a tool that is set for one move, among others",
        f"SLIN ⟦{POSE}⟧ WITH $VEL.CP=0.2,§$ACC.CP=1.5",
        "$TOOL=WORN_TOOL,",
        "",
    ),
    *body(
        "a base that is set for a block of splines",
        f"SPLINE§\nSPL ⟦{POSE}⟧\nSLIN ⟦{{X 900,Y 200,Z 800,A 0,B 90,C 0}}⟧\nENDSPLINE",
        " WITH $BASE=SEEN",
        " WITH $VEL.CP=0.2",
        "DECL FRAME SEEN\n",
    ),
    *body(
        "a frame is worked out from three points, one of which is a target",
        f"{POINT}LIN P1\n§",
        "F=FRAME_OF(P1,$POS_ACT,$POS_ACT)\n$BASE=F\nLIN {X 0,Y 0,Z 0,A 0,B 0,C 0}",
        "LIN P1",
        "DECL FRAME F\n",
    ),
    *body(
        "a part of a structure that is measured in place",
        f"PART.P=⟦{POSE}⟧\n§\nLIN PART.P",
        "PART.P.Z=$ANIN[1]",
        "$OUT[1]=TRUE",
        "STRUC PART_T E6POS P,INT N\nDECL PART_T PART\n",
    )[:1],
)


def fdat(tool: int, base: str, mode: str) -> str:
    """Data of a point as inline forms have them."""
    return f'DECL FDAT FP1={{TOOL_NO {tool},BASE_NO {base},IPO_FRAME {mode},POINT2[] " ",TQ_STATE FALSE}}\n'


INLINE = (
    "DEF p()\nPTP ⟨{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}⟩\n"
    ";FOLD LIN P1 Vel=2 m/s CPDAT1 Tool[1] Base[1];%{PE}%R 5.2,%MKUKATPBASIS,%CMOVE,%VLIN\n"
    "$BWDSTART=FALSE\nLDAT_ACT=LCPDAT1\nFDAT_ACT=FP1\n§\nBAS(#CP_PARAMS,2)\nLIN XP1\n;ENDFOLD\nEND\n"
)

LDAT = "DECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,APO_DIST 100.0,APO_FAC 50.0,ORI_TYP #VAR}\n"

FILES = (
    *twins(
        "an inline form with the tool in the room",
        {
            "p.src": INLINE.replace("§", ""),
            "p.dat": "DEFDAT p\nDECL E6POS XP1=⟦" + POSE + "⟧\n"
            'DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME §,POINT2[] " ",TQ_STATE FALSE}\n' + LDAT + "ENDDAT\n",
        },
        "#TCP",
        "#BASE",
        FRAMES,
    ),
    *twins(
        "an inline form whose tool's number is written before",
        {"p.src": INLINE, "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\n{fdat(1, '1', '#BASE')}{LDAT}ENDDAT\n"},
        "FDAT_ACT.TOOL_NO=$ANIN[1]",
        "",
        FRAMES,
    ),
    *twins(
        "an inline form with a base that nobody states",
        {
            "p.src": INLINE.replace("§", ""),
            "p.dat": "DEFDAT p\nDECL E6POS XP1=⟦" + POSE + "⟧\n"
            'DECL FDAT FP1={TOOL_NO 1,BASE_NO §,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}\n' + LDAT + "ENDDAT\n",
        },
        "9",
        "1",
        FRAMES,
    ),
    *twins(
        "a point of the list of data is overwritten before it is a target",
        {"p.src": f"DEF p()\n{SET}§\nLIN XP1\nEND\n", "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\nENDDAT\n"},
        "XP1=$POS_ACT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "a local name hides that of the list of data",
        {
            "p.src": f"DEF p()\n§\n{SET}LIN XP1\nEND\n",
            "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\nENDDAT\n",
        },
        "DECL E6POS XP1\nXP1=$POS_ACT",
        "DECL INT N",
        FRAMES,
    ),
    *twins(
        "one name in two lists of data, one of them in a base that is measured",
        {
            "a.src": f"DEF a()\n{SET}LIN XP1\nEND\n",
            "a.dat": f"DEFDAT a\nDECL E6POS XP1=⟨{POSE}⟩\nENDDAT\n",
            "b.src": f"DEF b()\n{SET}§\nLIN XP1\nEND\n",
            "b.dat": f"DEFDAT b\nDECL E6POS XP1=⟦{POSE}⟧\nENDDAT\n",
        },
        "$BASE=$POS_ACT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "a public point that another program changes",
        {
            "p.src": f"DEF p()\n{SET}§\nLIN XP1\nEND\n",
            "p.dat": f"DEFDAT p PUBLIC\nDECL GLOBAL E6POS XP1=⟦{POSE}⟧\nENDDAT\n",
            "q.src": "GLOBAL DEF q()\nXP1.Z=$ANIN[1]\nEND\n",
        },
        "q()",
        "$OUT[1]=TRUE",
        FRAMES,
    )[:1],
    *twins(
        "a routine of another file sets the base",
        {
            "p.src": f"DEF p()\n{SET}r()\nLIN ⟦{POSE}⟧\nEND\n",
            "r.src": "DEF r()\n§\nEND\n",
        },
        "$BASE=$POS_ACT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "the controller's own list of data has the base, and the program writes a part of it",
        {
            "p.src": f"DEF p()\n$TOOL=$NULLFRAME\n§\n$BASE=BASE_DATA[3]\nPTP ⟨{{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}}⟩\n"
            f"LIN ⟦{POSE}⟧\nEND\n",
            "$config.dat": "DEFDAT $CONFIG\nBASE_DATA[3]={X 500,Y 0,Z 100,A 30,B 0,C 0}\nENDDAT\n",
        },
        "BASE_DATA[3].X=BASE_DATA[3].X+$ANIN[1]",
        "$OUT[1]=TRUE",
    ),
    *twins(
        "an interrupt changes the base while the program waits",
        {
            "p.src": f"DEF p()\nINTERRUPT DECL 4 WHEN $IN[7]==TRUE DO SEEN()\n{SET}INTERRUPT ON 4\nWAIT SEC 1\n"
            f"LIN ⟦{POSE}⟧\nEND\n"
            "DEF SEEN()\n§\nEND\n"
        },
        "$BASE=$POS_INT",
        "$OUT[5]=TRUE",
        FRAMES,
    ),
    *twins(
        "an interrupt changes a point",
        {
            "p.src": f"DEF p()\nINTERRUPT DECL 4 WHEN $IN[7] DO SEEN()\n{SET}INTERRUPT ON 4\nWAIT SEC 1\nLIN XP1\nEND\n"
            "DEF SEEN()\n§\nEND\n",
            "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\nENDDAT\n",
        },
        "XP1.Z=$POS_INT.Z",
        "$OUT[5]=TRUE",
        FRAMES,
    ),
    *twins(
        "one name is declared twice in a list of data",
        {
            "p.src": f"DEF p()\n{SET}LIN XP1\nEND\n",
            "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\n§ENDDAT\n",
        },
        "DECL E6POS XP1={X 0,Y 500,Z 700,A 0,B 90,C 0}\n",
        "DECL INT N=3\n",
        FRAMES,
    ),
)

REACHES_NOTHING = (
    Attack(
        "control: data of a base are written behind the line that has fetched them",
        {
            "p.src": f"DEF p()\n$TOOL=$NULLFRAME\n$BASE=BASE_DATA[1]\nPTP ⟨{{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}}⟩\n"
            f"BASE_DATA[1]=$POS_ACT\n$BASE=BASE_DATA[1]\nLIN ⟦{POSE}⟧\nEND\n"
        },
        FRAMES,
    ),
    Attack(
        "control: what stands behind a return, and in a text or a comment",
        {
            "p.src": f'DEF p()\nDECL CHAR M[80]\n{SET}OFF()\nM[]="$BASE=$POS_ACT; "\n; $BASE=$POS_ACT\n'
            f";FOLD $BASE=$POS_ACT;%{{PE}}\n"
            f";ENDFOLD\nLIN ⟨{POSE}⟩\nEND\nDEF OFF()\nRETURN\n$BASE=$POS_ACT\nEND\n"
        },
        FRAMES,
    ),
    Attack(
        "control: an inline form of KSS 8 with its line for collision detection",
        {
            "p.src": INLINE.replace("§\n", "").replace("LIN XP1", "SET_CD_PARAMS (0)\nLIN XP1"),
            "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟨{POSE}⟩\n{fdat(1, '1', '#BASE')}{LDAT}ENDDAT\n",
        },
        FRAMES,
    ),
    Attack(
        "control: cases of letters, blanks and tabs",
        {
            "p.src": "&ACCESS RVP\r\n&REL 3\r\ndef P( )\r\n\t$Base = { x 100 , y 0 , z 50 , a 0 , b 0 , c 0 }\r\n"
            "\t$tool=$nullframe\r\n"
            "\tptp ⟨{ a1 0 , a2 -90 , a3 90 , a4 0 , a5 10 , a6 0 }⟩\r\n"
            "\tLin ⟨{z 800, x 900.0, y -1E+2, c 0, b +90, a 0}⟩ c_dis\r\nend\r\n"
        },
        FRAMES,
    ),
)

GRID = [(850 + 20 * (k % 4), -200 + 50 * (k // 4), 700 + 10 * (k % 3)) for k in range(16)]
"""Places of plain programs, [mm]."""

EXTERNAL = ",E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0"


def poses(count: int, digits: int, more: str = "") -> list[str]:
    """Poses with marks around them."""
    return [
        "⟨{" + ",".join(f"{k} {v:.{digits}f}" for k, v in zip("XYZABC", (*xyz, 0, 90, 0), strict=True)) + more + "}⟩"
        for xyz in GRID[:count]
    ]


def stances(count: int, digits: int = 3, more: str = "") -> list[str]:
    """Joint targets with marks around them."""
    return [
        "⟨{"
        + ",".join(f"A{j} {v:.{digits}f}" for j, v in enumerate((3 * k, -90, 90, 0, 10 + k, 0), start=1))
        + more
        + "}⟩"
        for k in range(count)
    ]


def program(name: str, *lines: str, head: tuple[str, ...] = (), end: str = "\n", **files: str) -> Attack:
    """A plain program of which all is marked."""
    text = end.join([*head, "DEF plain()", *lines, "END", ""])
    return Attack(f"plain: {name}", {"plain.src": text, **{n.replace("_", "."): t for n, t in files.items()}}, FRAMES)


STATED = ("$BASE={X 100.0,Y 0.0,Z 50.0,A 0.0,B 0.0,C 0.0}", "$TOOL={X 0.0,Y 0.0,Z 145.5,A 0.0,B 0.0,C 0.0}")

INI = (
    ";FOLD INI;%{PE}",
    "  ;FOLD BASISTECH INI",
    "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "    INTERRUPT ON 3 ",
    "    BAS (#INITMOV,0 )",
    "  ;ENDFOLD (BASISTECH INI)",
    "  ;FOLD USER INI",
    "    ;Make your modifications here",
    "  ;ENDFOLD (USER INI)",
    ";ENDFOLD (INI)",
)


def inline(k: int, kind: str) -> str:
    """An inline form of a move to a point."""
    name = f"P{k}"
    if kind == "PTP":
        return (
            f";FOLD PTP {name} Vel=100 % PDAT1 Tool[1] Base[1];%{{PE}}%R 8.3.31,%MKUKATPBASIS,%CMOVE,%VPTP,%P 1:PTP\n"
            f"$BWDSTART=FALSE\nPDAT_ACT=PPDAT1\nFDAT_ACT=F{name}\nBAS(#PTP_PARAMS,100)\nPTP X{name}\n;ENDFOLD"
        )
    return (
        f";FOLD LIN {name} Vel=2 m/s CPDAT1 Tool[1] Base[1];%{{PE}}%R 8.3.31,%MKUKATPBASIS,%CMOVE,%VLIN,%P 1:LIN\n"
        f"$BWDSTART=FALSE\nLDAT_ACT=LCPDAT1\nFDAT_ACT=F{name}\nBAS(#CP_PARAMS,2)\nLIN X{name}\n;ENDFOLD"
    )


PLAIN = (
    program(
        "offline programming, numbers in moves",
        *INI,
        *STATED,
        "$VEL.CP=0.25",
        "$APO.CDIS=1.0",
        f"PTP {stances(1)[0]} C_PTP",
        *(f"LIN {p} C_DIS" for p in poses(14, 3)),
        head=("&ACCESS RVP", "&REL 1", "&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe"),
    ),
    program(
        "points under names, declared and assigned",
        "DECL E6POS XA,XB,XC,XD,XE,XF,XG,XH",
        *STATED,
        f"PTP {stances(1)[0]}",
        *(f"X{letter}={p}" for letter, p in zip("ABCDEFGH", poses(8, 2), strict=True)),
        *(f"LIN X{letter}" for letter in "ABCDEFGH"),
    ),
    program(
        "inline forms with a list of data",
        *INI,
        f"PTP {stances(1)[0]}",
        *(inline(k, "PTP" if k % 3 == 1 else "LIN") for k in range(1, 9)),
        plain_dat="DEFDAT PLAIN\nEXT BAS (BAS_COMMAND :IN,REAL :IN )\nDECL INT SUCCESS\n"
        + "DECL PDAT PPDAT1={VEL 100.0,ACC 100.0,APO_DIST 100.0}\n"
        + LDAT
        + "".join(
            f'DECL E6POS XP{k}={p}\nDECL FDAT FP{k}={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}}\n'
            for k, p in enumerate(poses(8, 6, ",S 2,T 10" + EXTERNAL), start=1)
        )
        + "ENDDAT\n",
    ),
    program(
        "joints alone, as a planner writes them",
        "$VEL_AXIS[1]=20",
        *(f"PTP {q} C_PTP" for q in stances(16, 4, EXTERNAL)),
    ),
    program(
        "a loop with inputs, outputs and waits",
        *STATED,
        f"PTP {stances(1)[0]}",
        "LOOP",
        *(f"LIN {p}\n$OUT[{k}]=TRUE\nWAIT FOR $IN[{k}]\nWAIT SEC 0.2" for k, p in enumerate(poses(8, 1), start=1)),
        "ENDLOOP",
    ),
    program(
        "circles and lines",
        *STATED,
        f"PTP {stances(1)[0]}",
        *(
            f"LIN {a} C_VEL\nCIRC {b},{c}"
            for a, b, c in zip(poses(12, 3)[0::3], poses(12, 3)[1::3], poses(12, 3)[2::3], strict=True)
        ),
    ),
    program(
        "numbers of base and tool, changed on the way",
        "$BASE=BASE_DATA[1]",
        "$TOOL=TOOL_DATA[1]",
        f"PTP {stances(1)[0]}",
        *(f"LIN {p}" for p in poses(6, 3)),
        "$TOOL=TOOL_DATA[2]",
        "$BASE=BASE_DATA[2]",
        f"PTP {stances(2)[1]}",
        *(f"LIN {p}" for p in poses(6, 2)),
    ),
    program(
        "routines of its own",
        *STATED,
        f"PTP {stances(1)[0]}",
        "GRIP(TRUE)",
        *(f"LIN {p}\nGRIP({'TRUE' if k % 2 else 'FALSE'})" for k, p in enumerate(poses(8, 3))),
        "END",
        "DEF GRIP(ON:IN)",
        "DECL BOOL ON",
        "$OUT[1]=ON",
        "WAIT SEC 0.5",
    ),
    program(
        "splines of single moves, CRLF, umlauts",
        *STATED,
        f"SPTP {stances(1)[0]}",
        *(f"SLIN {p} C_SPL ; Naht {k}: Übergang" for k, p in enumerate(poses(10, 4))),
        end="\r\n",
    ),
    program(
        "by hand, with switches and counters",
        "DECL INT N",
        *STATED,
        "N=0",
        f"PTP {stances(1)[0]}",
        "WHILE N<10",
        "SWITCH N",
        *(f"CASE {k}\nLIN {p}" for k, p in enumerate(poses(8, 2))),
        "DEFAULT",
        "HALT",
        "ENDSWITCH",
        "N=N+1",
        "ENDWHILE",
    ),
)

ORDER = (
    *lone(
        "a routine of the file has a built-in's name",
        "BAS(#VEL_CP,1)",
        "$VEL.CP=1",
        below="DEF BAS(C:IN,R:IN)\nDECL BAS_COMMAND C\nDECL REAL R\n$BASE=$POS_ACT\nEND\n",
    )[:1],
    *twins(
        "a routine of the file hides that of another file",
        {
            "p.src": f"DEF p()\n{SET}SETUP()\nLIN ⟦{POSE}⟧\nEND\nDEF SETUP()\n§\nEND\n",
            "setup.src": "DEF SETUP()\n§\nEND\n",
        },
        ("$BASE=$POS_ACT", "$OUT[1]=TRUE"),
        ("$OUT[1]=TRUE", "$OUT[2]=TRUE"),
        FRAMES,
    ),
    *twins(
        "an alias of a point of another list is measured",
        {
            "p.src": f"DEF p()\nIMPORT E6POS HOME IS /R1/Q..XP1\n{SET}§\nLIN HOME\nEND\n",
            "q.dat": f"DEFDAT q PUBLIC\nDECL GLOBAL E6POS XP1=⟦{POSE}⟧\nENDDAT\n",
        },
        "HOME.Z=$ANIN[1]",
        "",
        FRAMES,
    )[:1],
    *lone(
        "a loop is left after the base was set",
        "LOOP\n$BASE=BASE_DATA[2]\nIF $IN[1] THEN\nEXIT\nENDIF\n$BASE=BASE_DATA[1]\nIF $IN[2] THEN\nEXIT\nENDIF\nENDLOOP",
        "LOOP\nIF $IN[1] THEN\nEXIT\nENDIF\nENDLOOP",
    ),
    *twins(
        "an interrupt leaves the routine in the middle of its bases",
        {
            "p.src": f"DEF p()\nINTERRUPT DECL 4 WHEN $IN[7] DO STOPIT()\n{SET}SEARCH()\nLIN ⟦{POSE}⟧\nEND\n"
            "DEF SEARCH()\nINTERRUPT ON 4\n$BASE=BASE_DATA[2]\nWAIT SEC 1\n$BASE={X 100,Y 0,Z 50,A 0,B 0,C 0}\n"
            "INTERRUPT OFF 4\nEND\n"
            "DEF STOPIT()\n§\nEND\n"
        },
        "BRAKE\nRESUME",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *body(
        "a part of a point is taken into another",
        f"{POINT}LIN P1\n§",
        "P2={X 900,Y 100,Z 800,A 0,B 90,C 0}\nP2.X=P1.X+$ANIN[1]\nLIN P2",
        "LIN P1",
        "DECL E6POS P2\n",
    ),
    *body(
        "a part of a point stands in an aggregate", f"{POINT}LIN P1\n§", "LIN {X P1.X,Y 0,Z 700,A 0,B 90,C 0}", "LIN P1"
    ),
    *body("the tool is in the room for one move", f"SLIN ⟦{POSE}⟧ WITH §", "$IPO_MODE=#TCP", "$ACC.CP=1.0"),
    *body(
        "the tool is in the room for a block",
        f"SPLINE WITH §\nSPL ⟦{POSE}⟧\nENDSPLINE",
        "$IPO_MODE=#TCP",
        "$ACC.CP=1.0",
    ),
    *body("a step behind a colon from where the arm is", f"LIN §⟦{POSE}⟧", "$POS_ACT:", ""),
    *body("a component twice in an aggregate", "LIN ⟦{X 900,Y 100,Z 800,A 0,B 90,C 0§}⟧", ",X 950", ",S 2,T 10"),
    *body("a component that is worked out", "LIN ⟦{X 900,Y 100,Z 800§,A 0,B 90,C 0}⟧", "+$ANIN[1]", ""),
    *body(
        "a component that a name says",
        "LIN ⟦{X 900,Y 100,Z §,A 0,B 90,C 0}⟧",
        "DEPTH",
        "800",
        "DECL REAL DEPTH\nDEPTH=$ANIN[1]\n",
    ),
    *twins(
        "a point of a list is overwritten behind its move, and the list is kept for the next run",
        {"p.src": f"DEF p()\n{SET}LIN XP1\n§\nEND\n", "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\nENDDAT\n"},
        "XP1=$POS_ACT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "data of the base are overwritten behind the move, and are kept for the next run",
        {
            "p.src": f"DEF p()\n$TOOL=$NULLFRAME\n$BASE=BASE_DATA[1]\nPTP ⟨{{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}}⟩\n"
            f"LIN ⟦{POSE}⟧\n§\nEND\n"
        },
        "BASE_DATA[1]=$POS_ACT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "a base of a list of data that another program measures",
        {
            "p.src": f"DEF p()\n$TOOL=$NULLFRAME\n$BASE=TABLE\nPTP ⟨{{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}}⟩\n"
            f"LIN ⟦{POSE}⟧\nEND\n",
            "p.dat": "DEFDAT p PUBLIC\nDECL GLOBAL FRAME TABLE={X 500,Y 0,Z 100,A 0,B 0,C 0}\nENDDAT\n",
            "q.src": "DEF q()\n§\nEND\n",
        },
        "TABLE=$POS_ACT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *body(
        "a rail is told a place in a move before",
        f"PTP {{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0,E1 §}}\nLIN ⟦{POSE}⟧",
        "1500.0",
        "0.0",
    ),
    *body(
        "a rail is told a place in one branch",
        f"IF $IN[1] THEN\nPTP {{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0,E1 §}}\nENDIF\nLIN ⟦{POSE}⟧",
        "-20",
        "0",
    ),
    *body(
        "arc welding by another routine than that of the package",
        f"{POINT}§\nLIN P1",
        "ArcMyNG(#ArcOnAfterMoveStd,WDAT1,WP1)",
        "TRIGGER WHEN PATH = ArcGetPath(#OnTheFlyArcOn, WDAT1) DELAY = ArcGetDelay(#GasPreflow, WDAT1) "
        "DO ArcMainNG(#GasPreflow, WDAT1, WP1) PRIO = -1\nArcMainNG(#ArcOnBeforeMoveStd, WDAT1, WP1)",
    ),
    *body("a rail is told a place", "LIN ⟦{X 900,Y 100,Z 800,A 0,B 90,C 0,S 2,T 10,E1 §}⟧", "1500.0", "0.0"),
    *lone(
        "the base is a product with what is not known behind many that are",
        "$BASE=BASE_DATA[1]:{X 0,Y 0,Z 10,A 0,B 0,C 0}:SEEN",
        "$BASE=BASE_DATA[1]:{X 0,Y 0,Z 10,A 0,B 0,C 0}",
        "DECL FRAME SEEN\nSEEN=$POS_ACT\n",
    ),
    *lone("a negative index", "$BASE=BASE_DATA[-1]", "$BASE=BASE_DATA[2]"),
    *lone("a frame without a value", "$BASE=EMPTY", "$APO.CPTP=20", "DECL FRAME EMPTY\n"),
    *lone(
        "a base by a function of the file that asks an input",
        "$BASE=TABLE()",
        "$ORI_TYPE=#CONSTANT",
        below="DEFFCT FRAME TABLE()\nDECL FRAME F\nF=$NULLFRAME\nF.X=$ANIN[1]\nRETURN F\nENDFCT\n",
    ),
    *lone(
        "a text between, with a semicolon and a quotation mark in it",
        'M[]="a;b"\n$BASE=$POS_ACT',
        'M[]="a;b"\n$OUT[1]=TRUE',
        "DECL CHAR M[20]\n",
    ),
    *lone(
        "a base is set behind a comment mark in a text on one line",
        'M[]="; " \n$BASE=$POS_ACT ; "',
        'M[]="; " \n$OUT[1]=TRUE ; "',
        "DECL CHAR M[20]\n",
    ),
    Attack(
        "a bare CR ends a comment",
        {"p.src": f"DEF p()\n{SET}; next\r$BASE=$POS_ACT\nLIN ⟦{POSE}⟧\nEND\n".replace("⟨", "").replace("⟩", "")},
        FRAMES,
    ),
    Attack(
        "control: letters whose second byte some take for the end of a line",
        {
            "p.src": f"DEF p()\n{SET}; Å $BASE=$POS_ACT\n;à\xa0$BASE=$POS_ACT\n;FOLD Å $BASE=$POS_ACT\n;ENDFOLD\n"
            f"LIN ⟨{POSE}⟩\nEND\n"
        },
        FRAMES,
    ),
    Attack(
        "control: aggregates that name their type, and positions of four kinds",
        {
            "p.src": f"DEF p()\n{SET}LIN ⟨{{POS: X 900,Y 100,Z 800,A 0,B 90,C 0,S 2,T 10}}⟩\n"
            f"LIN ⟨{{E6POS: X 900,Y 110,Z 800,A 0,B 90,C 0,E1 0.0}}⟩\n"
            "LIN ⟨{FRAME: X 900,Y 120,Z 800,A 0,B 90,C 0}⟩\nPTP ⟨{E6AXIS: A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0,E1 0.0}⟩\nEND\n"
        },
        FRAMES,
    ),
)

INDIRECT = (
    *body(
        "two routines call each other, and the base changes between",
        "A(1)",
        "$BASE=BASE_DATA[2]",
        "$OUT[1]=TRUE",
        below=f"DEF A(N:IN)\nDECL INT N\nLIN ⟦{POSE}⟧\nIF N>0 THEN\n§\nB(N)\nENDIF\nEND\nDEF B(N:IN)\nDECL INT N\nA(N-1)\nEND\n",
    )[:1],
    *twins(
        "an interrupt's routine calls what sets the base",
        {
            "p.src": f"DEF p()\nINTERRUPT DECL 4 WHEN $IN[7] DO SEEN()\n{SET}INTERRUPT ON 4\nWAIT SEC 1\nLIN ⟦{POSE}⟧\n"
            "END\nDEF SEEN()\nFIT()\nEND\nDEF FIT()\n§\nEND\n"
        },
        "$BASE=$POS_INT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "an interrupt that another routine declares and switches on",
        {
            "p.src": f"DEF p()\n{SET}ARM()\nWAIT SEC 1\nLIN ⟦{POSE}⟧\nEND\nDEF ARM()\n"
            "GLOBAL INTERRUPT DECL 4 WHEN $IN[7] DO SEEN()\nINTERRUPT ON 4\nEND\nDEF SEEN()\n§\nEND\n"
        },
        "$BASE=$POS_INT",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "an interrupt whose routine no file has",
        {
            "p.src": f"DEF p()\nINTERRUPT DECL 4 WHEN $IN[7] DO §\n{SET}INTERRUPT ON 4\nWAIT SEC 1\nLIN ⟦{POSE}⟧\nEND\n"
            "DEF LAMP()\n$OUT[1]=TRUE\nEND\n"
        },
        "NOBODY()",
        "LAMP()",
        FRAMES,
    ),
    *lone(
        "cases that all set the base, and no default",
        "SWITCH N\nCASE 1\n$BASE=BASE_DATA[2]\nCASE 2\n$BASE=BASE_DATA[2]\nENDSWITCH",
        "SWITCH N\nCASE 1\n$BASE=BASE_DATA[2]\nCASE 2\n$BASE=BASE_DATA[2]\nDEFAULT\n$BASE=BASE_DATA[2]\nENDSWITCH",
        "DECL INT N\nN=$ANIN[1]\n",
    ),
    *lone(
        "a loop that perhaps never runs sets the base",
        "WHILE $IN[1]\n$BASE=BASE_DATA[2]\nENDWHILE",
        "REPEAT\n$BASE=BASE_DATA[2]\nUNTIL $IN[1]",
    ),
    *lone(
        "a counted loop that perhaps never runs sets the base",
        "FOR I=1 TO N\n$BASE=BASE_DATA[2]\nENDFOR",
        "FOR I=1 TO N\n$OUT[1]=TRUE\nENDFOR",
        "DECL INT I,N\nN=$ANIN[1]\n",
    ),
    *body(
        "one literal in the bases of a list",
        f"FOR I=1 TO 2\n§\nLIN ⟦{POSE}⟧\nENDFOR",
        "$BASE=BASE_DATA[I]",
        "$BASE=BASE_DATA[1]",
        "DECL INT I\n",
    ),
    *lone(
        "a wait's condition sets the base",
        "WAIT FOR SEEN()",
        "WAIT FOR $IN[3]",
        below="DEFFCT BOOL SEEN()\n$BASE=$POS_ACT\nRETURN TRUE\nENDFCT\n",
    ),
    *lone(
        "an index's function sets the base",
        "$OUT[WHICH()]=TRUE",
        "$OUT[2]=TRUE",
        below="DEFFCT INT WHICH()\n$BASE=$POS_ACT\nRETURN 2\nENDFCT\n",
    ),
    *lone(
        "a component of data is handed to a routine that changes it",
        "RAISE(BASE_DATA[2].Z)\n$BASE=BASE_DATA[2]",
        "$BASE=BASE_DATA[2]",
        below="DEF RAISE(Z:OUT)\nDECL REAL Z\nZ=Z+$ANIN[1]\nEND\n",
    )[:1],
    *lone(
        "the base is one of a list of the program's own, by a number",
        "$BASE=TABLES[N]",
        "$BASE=$NULLFRAME",
        "DECL FRAME TABLES[2]\nDECL INT N\nTABLES[1]={X 1,Y 0,Z 0,A 0,B 0,C 0}\nTABLES[2]={X 2,Y 0,Z 0,A 0,B 0,C 0}\n"
        "N=$ANIN[1]\n",
    ),
    *twins(
        "an inline form whose base's number is written before",
        {
            "p.src": INLINE.replace("FDAT_ACT=FP1\n§", "§FDAT_ACT=FP1"),
            "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\n{fdat(1, '1', '#BASE')}{LDAT}ENDDAT\n",
        },
        "FP1.BASE_NO=$ANIN[1]\n",
        "",
        FRAMES,
    ),
    *twins(
        "a point is overwritten by another of the list",
        {
            "p.src": f"DEF p()\n{SET}§\nLIN XP1\nEND\n",
            "p.dat": f"DEFDAT p\nDECL E6POS XP1=⟦{POSE}⟧\nDECL E6POS XP2={{X 900,Y 0,Z 700,A 0,B 90,C 0}}\nENDDAT\n",
        },
        "XP1=XP2",
        "$OUT[1]=TRUE",
        FRAMES,
    ),
    *twins(
        "an inline form of a spline with the tool in the room",
        {
            "p.src": "DEF p()\nSPTP ⟨{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}⟩\n"
            ";FOLD SLIN P1 Vel=2 m/s CPDAT1 Tool[1] Base[1];%{PE}\n"
            "SLIN XP1 WITH $VEL=SVEL_CP(2.0,,LCPDAT1),$TOOL=STOOL2(FP1),"
            "$BASE=SBASE(FP1.BASE_NO),$IPO_MODE=SIPO_MODE(FP1.IPO_FRAME),"
            "$LOAD=SLOAD(FP1.TOOL_NO),$ACC=SACC_CP(LCPDAT1),$ORI_TYPE=SORI_TYP(LCPDAT1),"
            "$APO=SAPO(LCPDAT1),$JERK=SJERK(LCPDAT1) C_Spl\n;ENDFOLD\nEND\n",
            "p.dat": "DEFDAT p\nDECL E6POS XP1=⟦" + POSE + "⟧\n"
            'DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME §,POINT2[] " ",TQ_STATE FALSE}\n' + LDAT + "ENDDAT\n",
        },
        "#TCP",
        "#BASE",
        FRAMES,
    ),
    *lone(
        "a jump out of a loop over the line that sets the base again",
        "LOOP\n$BASE=BASE_DATA[2]\nIF $IN[1] THEN\nGOTO OUT\nENDIF\n$BASE={X 100,Y 0,Z 50,A 0,B 0,C 0}\n"
        "IF $IN[2] THEN\nEXIT\nENDIF\nENDLOOP\nOUT:",
        "LOOP\nIF $IN[1] THEN\nGOTO OUT\nENDIF\nIF $IN[2] THEN\nEXIT\nENDIF\nENDLOOP\nOUT:",
    ),
    *lone(
        "a routine that returns before it sets the base back",
        "WORK()",
        "LAMP()",
        below="DEF WORK()\n$BASE=BASE_DATA[2]\nIF $IN[1] THEN\nRETURN\nENDIF\n"
        "$BASE={X 100,Y 0,Z 50,A 0,B 0,C 0}\nEND\nDEF LAMP()\n$OUT[1]=TRUE\nEND\n",
    ),
)

ATTACKS: tuple[Attack, ...] = (*STATE, *POINTS, *FILES, *REACHES_NOTHING, *INDIRECT, *PLAIN, *ORDER)
