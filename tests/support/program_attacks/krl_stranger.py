"""KRL by somebody who had not seen the reader: coupled bases, interrupts, triggers, shadowed names, side effects."""

from __future__ import annotations

from program_attacks import Attack

START = """$TOOL={X 0,Y 0,Z 120,A 0,B 0,C 0}
$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}
PTP {A1 5,A2 -90,A3 90,A4 10,A5 85,A6 12}
"""


def _main(body: str, behind: str = "", declared: str = "") -> str:
    return f"&ACCESS RVP\n&REL 12\nDEF cell( )\n{declared}\nBAS (#INITMOV,0)\n{START}{body.strip()}\nEND\n{behind}"


def _case(name: str, body: str, behind: str = "", declared: str = "", **files: str) -> Attack:
    others = {
        key.replace("_dat", ".dat").replace("config", "$config").replace("_src", ".src").replace("_sub", ".sub"): text
        for key, text in files.items()
    }
    return Attack(name, {"cell.src": _main(body, behind, declared), **others})


A = "{X 512.5,Y -310.2,Z 420.7,A 12,B 80.5,C 3.1}"
B = "{X 640.1,Y -122.8,Z 355.4,A 10,B 81.2,C 2.2}"
Q = "{A1 12.5,A2 -80.1,A3 95.2,A4 3.3,A5 70.7,A6 11.9}"
E = "{X 512.5,Y -310.2,Z 420.7,A 12,B 80.5,C 3.1,S 2,T 2,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}"
F = "{X 640.1,Y -122.8,Z 355.4,A 10,B 81.2,C 2.2,S 2,T 2,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}"
DAT = "&ACCESS RVP\nDEFDAT CELL\nEXT BAS (BAS_COMMAND :IN,REAL :IN )\n{}\nENDDAT\n"

ATTACKS = [
    _case("plain moves", f"LIN ⟨{A}⟩ C_DIS\nPTP ⟨{Q}⟩\nlin ⟨{B}⟩\nSLIN ⟨{A}⟩\nPTP ⟨{Q}⟩ C_PTP"),
    _case(
        "the base is coupled to an external axis",
        f"LIN ⟨{B}⟩\n$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,{{X 10,Y 0,Z 0,A 0,B 0,C 0}})\nLIN ⟦{A}⟧",
    ),
    _case("an external tool", f"LIN ⟨{B}⟩\n$IPO_MODE=#TCP\nLIN ⟦{A}⟧\n$IPO_MODE=#BASE\nLIN ⟨{B}⟩"),
    _case(
        "a relative move in the tool's axes",
        f"LIN ⟨{B}⟩\nLIN_REL ⟦{{Z -50}}⟧ #TOOL\nLIN_REL ⟦{{X 20.5,Y 3}}⟧\nPTP_REL ⟦{{A1 10.5}}⟧\nLIN ⟨{A}⟩",
    ),
    _case("a spline relative move", f"SLIN ⟨{B}⟩\nSLIN_REL ⟦{{X 30.5,Y 0,Z -20,A 0,B 0,C 0}}⟧\nSLIN ⟨{A}⟩"),
    _case(
        "an interrupt's routine moves the tool's end",
        f"INTERRUPT DECL 10 WHEN $IN[5]==TRUE DO worn( )\nINTERRUPT ON 10\nLIN ⟦{A}⟧\nINTERRUPT OFF 10",
        "DEF worn( )\n$TOOL.Z=$TOOL.Z-0.5\nEND\n",
    ),
    _case(
        "a trigger's routine sets the base",
        f"TRIGGER WHEN DISTANCE=0 DELAY=-20 DO rebase( ) PRIO=-1\nLIN ⟦{A}⟧\nLIN ⟦{B}⟧",
        "DEF rebase( )\n$BASE={X 0,Y 0,Z 300,A 0,B 0,C 0}\nEND\n",
    ),
    _case(
        "a condition has a side effect",
        f"LIN ⟨{B}⟩\nIF gripped( ) THEN\nWAIT SEC 0.1\nENDIF\nLIN ⟨{A}⟩",
        "DEFFCT BOOL gripped( )\n$TOOL={X 0,Y 0,Z 250,A 0,B 0,C 0}\nRETURN TRUE\nENDFCT\n",
    ),
    _case(
        "a local hides the point of the data list",
        "LIN ⟨XP2⟩\nXP1={X 1,Y 2,Z 3,A 0,B 0,C 0}\nXP1.Z=$POS_ACT.Z+10\nLIN XP1".replace("⟨XP2⟩", "XP2"),
        declared="DECL POS XP1",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "a subprogram changes a point by reference",
        "shift(XP1)\nLIN XP1\nLIN XP2",
        "DEF shift(P:OUT)\nDECL E6POS P\nP.X=P.X+15\nEND\n",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "a point by value is only a copy",
        "LIN XP1\nLIN XP2\nnote(XP1.X)",
        "DEF note(V:IN)\nREAL V\nEND\n",
        cell_dat=DAT.format(f"DECL E6POS XP2=⟨{F}⟩\nDECL E6POS XP1={E}"),
    ),
    _case(
        "names in other cases",
        "lin xp1\nXp1.z=XP1.Z+5\nLIN Xp2",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "the submit interpreter changes a point",
        "LIN XP1\nLIN XP2",
        cell_dat=DAT.replace("DEFDAT CELL", "DEFDAT CELL PUBLIC").format(
            f"DECL GLOBAL E6POS XP1=⟦{E}⟧\nDECL GLOBAL E6POS XP2=⟨{F}⟩"
        ),
        SPS_sub="DEF SPS( )\nLOOP\nXP1.Z=XP1.Z+$ANIN[1]\nENDLOOP\nEND\n",
    ),
    _case(
        "a sensor package corrects the path",
        f'LIN ⟨{B}⟩\nERR=RSI_CREATE("corr.rsi",CONTID,TRUE)\nERR=RSI_ON(#RELATIVE)\nLIN ⟦{A}⟧',
        declared="DECL INT ERR,CONTID",
    ),
    _case(
        "an unknown routine gets the point",
        'EKI_GetFrame("cam","Pos",XP1)\nLIN XP1\n$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}\n'
        "$TOOL={X 0,Y 0,Z 120,A 0,B 0,C 0}\nLIN ⟨" + B + "⟩",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧"),
    ),
    _case("a correction of the seam", f'LIN ⟨{B}⟩\nCorrOn("CD1"," "," ")\nLIN ⟦{A}⟧\nCorrOff( )'),
    _case(
        "the tool of an index",
        f"LIN ⟨{B}⟩\nIDX=PGNO_TOOL\n$TOOL=TOOL_DATA[IDX]\nLIN ⟦{A}⟧",
        declared="DECL INT IDX",
        config_dat="DEFDAT $CONFIG\nDECL FRAME TOOL_DATA[16]\nTOOL_DATA[1]={X 0,Y 0,Z 120,A 0,B 0,C 0}\nENDDAT\n",
    ),
    _case(
        "base data written by another module",
        f"BAS(#BASE,2)\nLIN ⟦{A}⟧\n$BASE={{X 100,Y 0,Z 0,A 0,B 0,C 0}}\nLIN ⟨{B}⟩",
        config_dat="DEFDAT $CONFIG\nDECL FRAME BASE_DATA[32]\nBASE_DATA[2]={X 800,Y 0,Z 300,A 0,B 0,C 0}\nENDDAT\n",
        measure_src="DEF measure( )\nBASE_DATA[2].X=BASE_DATA[2].X+$ANIN[3]\nEND\n",
    ),
    _case(
        "WITH sets the tool of one spline move",
        f"SPTP XP1 WITH $TOOL=TOOL_DATA[PGNO]\nSLIN ⟨{B}⟩",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧"),
    ),
    _case(
        "a spline block has its own base",
        f"SPLINE WITH $BASE=$WORLD:{{X 5,Y 0,Z 0,A 0,B 0,C $ANIN[1]}}\nSPL ⟦{A}⟧\nSLIN ⟦{B}⟧\nENDSPLINE\nSLIN ⟨{B}⟩",
    ),
    _case(
        "a frame from a function",
        f"$BASE=table( )\nLIN ⟦{A}⟧\n$BASE={{X 100,Y 0,Z 0,A 0,B 0,C 0}}\nLIN ⟨{B}⟩",
        "DEFFCT FRAME table( )\nDECL FRAME T\nT=$NULLFRAME\nT.Z=$ANIN[2]*100\nRETURN T\nENDFCT\n",
    ),
    _case(
        "loop with goto past the base",
        f"LIN ⟨{B}⟩\nagain:\nLIN ⟦{A}⟧\n$BASE.X=$BASE.X+50\nN=N+1\nIF N<5 THEN\nGOTO again\nENDIF",
        declared="DECL INT N",
    ),
    _case(
        "points of a grid",
        "FOR I=1 TO 3\nLIN XPAL[I]\nXPAL[I].Z=XPAL[I].Z+20\nENDFOR\nLIN XP2",
        declared="DECL INT I",
        cell_dat=DAT.format(f"DECL E6POS XPAL[3]\nXPAL[1]=⟦{E}⟧\nXPAL[2]=⟦{F}⟧\nXPAL[3]=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "an aggregate writes one component",
        "XP1={Z 300}\nLIN XP1\nLIN XP2",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "a point is where the robot was",
        "XP1=$POS_ACT\nLIN XP2\nLIN XP1",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "a string is read into a component",
        'SREAD(TXT[],STATE,OFFS,"%f",XP1.X)\nLIN XP2\nLIN XP1',
        declared="DECL CHAR TXT[20]\nDECL STATE_T STATE\nDECL INT OFFS",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "an inverse of the point is the base",
        "$BASE=INV_POS(XP1)\nLIN XP2\n$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}\nLIN XP1\nLIN ⟨" + B + "⟩",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟦{F}⟧"),
    ),
    _case(
        "fold and comment",
        f";FOLD LIN P1 CONT Vel=2 m/s CPDAT1 Tool[1] Base[2];%{{PE}}\n"
        f"LIN ⟨{A}⟩ ; was {{X 1,Y 2,Z 3,A 0,B 0,C 0}}\n;ENDFOLD\n; $BASE={{X 0,Y 0,Z 900}}\n"
        f"LIN ⟨{B}⟩",
    ),
    _case(
        "what changes nothing of the geometry",
        "$VEL.CP=0.5\n$APO.CDIS=5\n$ORI_TYPE=#CONSTANT\n$CIRC_TYPE=#BASE\n$ADVANCE=3\nWAIT SEC 0\n"
        "$OUT[3]=TRUE\nPULSE($OUT[4],TRUE,0.5)\n$LOAD.M=12\nWAIT FOR $IN[2]\nHALT\nCONTINUE\n"
        f"LIN ⟨{A}⟩\n$ACC.CP=2\nLIN ⟨{B}⟩",
    ),
    _case("world and null frame", f"$BASE=$WORLD\n$TOOL=$NULLFRAME\nLIN ⟨{A}⟩\n$BASE=$NULLFRAME\nLIN ⟨{B}⟩"),
    _case(
        "the robot's root is moved",
        f"LIN ⟨{B}⟩\n$ERSYSROOT={{X 10,Y 0,Z 0,A 0,B 0,C 0}}\n$ROBROOT_C={{X 1,Y 0,Z 0,A 0,B 0,C 0}}\nLIN ⟦{A}⟧",
    ),
    _case("conveyor", f"LIN ⟨{B}⟩\nConveyor.follow(1,100.0,200.0)\nLIN ⟦{A}⟧"),
    _case("conveyor of the technology package", f"LIN ⟨{B}⟩\nCONV_FOLLOW(1,-1)\nLIN ⟦{A}⟧\nCONV_QUIT(1)"),
    _case(
        "inline form with an external tool",
        "PDAT_ACT=PPDAT1\nFDAT_ACT=FP1\nBAS(#PTP_PARAMS,50)\nPTP XP1\n$IPO_MODE=#BASE\n"
        "$TOOL={X 0,Y 0,Z 120,A 0,B 0,C 0}\n$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}\nLIN XP2",
        cell_dat=DAT.format(
            f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩\n"
            f'DECL FDAT FP1={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #TCP,POINT2[] " "}}\n'
            f"DECL PDAT PPDAT1={{VEL 50,ACC 100,APO_DIST 100}}"
        ),
        config_dat="DEFDAT $CONFIG\nDECL FRAME TOOL_DATA[16]\nDECL FRAME BASE_DATA[32]\n"
        "TOOL_DATA[1]={X 0,Y 0,Z 120,A 0,B 0,C 0}\nBASE_DATA[1]={X 0,Y 0,Z 0,A 0,B 0,C 0}\nENDDAT\n",
    ),
    _case(
        "the inline form's data are written",
        "FP1.BASE_NO=PGNO\nPDAT_ACT=PPDAT1\nFDAT_ACT=FP1\nBAS(#PTP_PARAMS,50)\nPTP XP1",
        cell_dat=DAT.format(
            f'DECL E6POS XP1=⟦{E}⟧\nDECL FDAT FP1={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}}\n'
            f"DECL PDAT PPDAT1={{VEL 50,ACC 100,APO_DIST 100}}"
        ),
        config_dat="DEFDAT $CONFIG\nDECL FRAME TOOL_DATA[16]\nDECL FRAME BASE_DATA[32]\n"
        "TOOL_DATA[1]={X 0,Y 0,Z 120,A 0,B 0,C 0}\nBASE_DATA[1]={X 0,Y 0,Z 0,A 0,B 0,C 0}\nENDDAT\n",
    ),
    _case(
        "inline form as it should be",
        "PDAT_ACT=PPDAT1\nFDAT_ACT=FP1\nBAS(#PTP_PARAMS,50)\nPTP XP1",
        cell_dat=DAT.format(
            f'DECL E6POS XP1=⟨{E}⟩\nDECL FDAT FP1={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}}\n'
            f"DECL PDAT PPDAT1={{VEL 50,ACC 100,APO_DIST 100}}"
        ),
        config_dat="DEFDAT $CONFIG\nDECL FRAME TOOL_DATA[16]\nDECL FRAME BASE_DATA[32]\n"
        "TOOL_DATA[1]={X 0,Y 0,Z 120,A 0,B 0,C 0}\nBASE_DATA[1]={X 0,Y 0,Z 0,A 0,B 0,C 0}\nENDDAT\n",
    ),
    _case(
        "somebody's own BAS",
        f"BAS(#TOOL,1)\nLIN ⟦{A}⟧",
        "DEF BAS(CMD:IN,NR:IN)\nDECL BAS_COMMAND CMD\nREAL NR\n$BASE=$NULLFRAME\n$BASE.Z=NR*10+$ANIN[1]\nEND\n",
    ),
    _case(
        "a variable of the interface",
        f'LIN ⟨{B}⟩\nCWRITE($CMD,STAT,MODE,"SET $BASE")\nLIN ⟦{A}⟧',
        declared="DECL STATE_T STAT\nDECL MODUS_T MODE",
    ),
    _case(
        "a geometric offset behind the point",
        "LIN XP1:{X 0,Y 0,Z -80,A 0,B 0,C 0}\nLIN XP2\nLIN XP1:OFS",
        declared="DECL FRAME OFS",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "SWITCH sets the base",
        f"LIN ⟨{B}⟩\nSWITCH PGNO\nCASE 1,2\n$BASE={{X 100,Y 0,Z 0,A 0,B 0,C 0}}\nCASE 3\n"
        f"$BASE={{X 300,Y 0,Z 0,A 0,B 0,C 0}}\nENDSWITCH\nLIN ⟦{A}⟧",
    ),
    _case(
        "SWITCH sets one base in all cases",
        f"SWITCH PGNO\nCASE 1,2\n$BASE={{X 300,Y 0,Z 0,A 0,B 0,C 0}}\nDEFAULT\n"
        f"$BASE={{X 300,Y 0,Z 0,A 0,B 0,C 0}}\nENDSWITCH\nLIN ⟨{A}⟩",
    ),
    _case(
        "a global interrupt of another module",
        f"start_watch( )\nLIN ⟦{A}⟧",
        watch_src="GLOBAL DEF start_watch( )\nGLOBAL INTERRUPT DECL 12 WHEN $TIMER[1]>500 DO drift( )\n"
        "INTERRUPT ON 12\nEND\nDEF drift( )\n$BASE.Y=$BASE.Y+0.2\nEND\n",
    ),
    _case(
        "a repeat until with another base",
        f"LIN ⟨{B}⟩\nREPEAT\nLIN ⟦{A}⟧\n$BASE={{X 0,Y N*10,Z 0,A 0,B 0,C 0}}\nN=N+1\nUNTIL N>5",
        declared="DECL INT N",
    ),
    _case("partial joints", f"PTP ⟨{Q}⟩\nPTP {{A1 20.5}}\nPTP ⟨{Q}⟩"),
    _case("a form feed in a comment", f"LIN {B} ; old \x0c LIN ⟦{A}⟧\nLIN {A}"),
    _case("signs of Windows in a comment", f"LIN ⟨{B}⟩ ; \x84Ablage\x93 \x96 sp\xe4ter \x85 $BASE.Z=900\nLIN ⟨{A}⟩"),
    _case(
        "a point of two bases",
        "LIN XP1\n$BASE={X 300,Y 0,Z 0,A 0,B 0,C 0}\nLIN XP1\nLIN XP2",
        cell_dat=DAT.format(f"DECL E6POS XP1=⟦{E}⟧\nDECL E6POS XP2=⟨{F}⟩"),
    ),
    _case(
        "binary and hexadecimal stance",
        "PTP XP1\nPTP XP2",
        cell_dat=DAT.format(
            "DECL E6POS XP1=⟨{X 512.5,Y -310.2,Z 420.7,A 12,B 80.5,C 3.1,S 'B010',T 'B000010'}⟩\n"
            "DECL E6POS XP2=⟨{X 640.1,Y -122.8,Z 355.4,A 10,B 81.2,C 2.2,S 'H2',T 'H2'}⟩"
        ),
    ),
    _case("an axis that is not the robot's", f"LIN ⟨{B}⟩\nASYPTP {{E1 500.0}}\nLIN ⟨{A}⟩"),
    _case(
        "the tool's load routine changes the tool",
        f"LIN ⟨{B}⟩\nSET_TOOL(3)\nLIN ⟦{A}⟧\n$BASE={{X 100,Y 0,Z 0,A 0,B 0,C 0}}\n"
        f"$TOOL={{X 0,Y 0,Z 120,A 0,B 0,C 0}}\nLIN ⟦{B}⟧\n$IPO_MODE=#BASE\nLIN ⟨{B}⟩",
    ),
    _case("a program returns early", f"IF $IN[1] THEN\n$BASE={{X 300,Y 0,Z 0,A 0,B 0,C 0}}\nRETURN\nENDIF\nLIN ⟨{B}⟩"),
    _case(
        "a subprogram leaves early with another base",
        f"LIN ⟨{B}⟩\npart( )\nLIN ⟦{A}⟧",
        "DEF part( )\n$BASE={X 300,Y 0,Z 0,A 0,B 0,C 0}\nIF $IN[1] THEN\nRETURN\nENDIF\n"
        "$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}\nEND\n",
    ),
    _case("a circle goes on by an angle", f"CIRC ⟦{A}⟧,⟦{B}⟧,CA 270\nLIN ⟨{A}⟩"),
    _case("the orientation is not come to", f"$ORI_TYPE=#IGNORE\nSLIN ⟦{A}⟧\n$ORI_TYPE=#VAR\nSLIN ⟨{B}⟩"),
    _case(
        "the tool grows with each turn",
        f"LIN ⟨{B}⟩\nFOR I=1 TO 3\n$TOOL=$TOOL:{{X 0,Y 0,Z 10,A 0,B 0,C 0}}\nLIN ⟦{A}⟧\nENDFOR",
    ),
    _case(
        "a condition of a loop sets the base",
        f"LIN ⟨{B}⟩\nWHILE moved( )\nLIN ⟦{A}⟧\nENDWHILE",
        "DEFFCT BOOL moved( )\n$BASE.X=$BASE.X+7\nRETURN TRUE\nENDFCT\n",
    ),
    _case(
        "a base that the controller has twice",
        f"LIN ⟨{B}⟩\nBAS(#BASE,5)\nLIN ⟦{A}⟧",
        config_dat="DEFDAT $CONFIG\nBASE_DATA[5]={X 1,Y 0,Z 0,A 0,B 0,C 0}\n"
        "BASE_DATA[5]={X 2,Y 0,Z 0,A 0,B 0,C 0}\nENDDAT\n",
    ),
    _case(
        "a routine that its file does not show",
        f"LIN ⟨{B}⟩\nhidden( )\nLIN ⟦{A}⟧",
        chg_src="DEF chg( )\nEND\nDEF hidden( )\n$TOOL.Z=55\nEND\n",
    ),
]
