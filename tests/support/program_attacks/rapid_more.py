"""RAPID: constructs of the reference manual, and of modules by hand, that change what a target means."""

from __future__ import annotations

from program_twins import twins

from program_attacks import Attack

AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"

TARGET = f"[[900,100,700],[0,0,1,0],[0,0,0,0],{AXES}]"

LOAD = "[1,[0,0,50],[1,0,0,0],0,0,0]"

DATA = f"""  PERS tooldata tG:=[TRUE,[[0,0,120],[1,0,0,0]],{LOAD}];
  PERS tooldata tH:=[TRUE,[[0,50,200],[1,0,0,0]],{LOAD}];
  TASK PERS wobjdata wA:=[FALSE,TRUE,"",[[500,0,200],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  TASK PERS wobjdata wB:=[FALSE,TRUE,"",[[600,0,200],[1,0,0,0]],[[0,0,10],[1,0,0,0]]];
  CONST jointtarget jH:=⟨[[0,-20,30,0,40,0],{AXES}]⟩;
"""

MOVE = "MoveL p10,v200,fine,tG\\WObj:=wA;"


def module(main: str, declared: str = "", routines: str = "", kind: str = "CONST", target: str = TARGET) -> str:
    """A module with a joint target, a robtarget ``p10``, and lines of ``main`` behind the first move."""
    return (
        f"MODULE M\n{DATA}  {kind} robtarget p10:=⟦{target}⟧;\n{declared}  PROC main()\n"
        "    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n"
        f"    {main}\n  ENDPROC\n{routines}ENDMODULE\n"
    )


def lone(
    name: str, trap: str, plain: str = "", declared: str = "", routines: str = "", kind: str = "CONST"
) -> tuple[Attack, Attack]:
    """A trap between a joint target and a move to a robtarget."""
    return twins(name, {"M.mod": module(f"§\n    {MOVE}", declared, routines, kind)}, trap, plain)


def body(
    name: str,
    main: str,
    trap: str | tuple[str, ...],
    plain: str | tuple[str, ...] = "",
    declared: str = "",
    routines: str = "",
    kind: str = "CONST",
) -> tuple[Attack, Attack]:
    """Lines of ``main`` with a trap in them."""
    return twins(name, {"M.mod": module(main, declared, routines, kind)}, trap, plain)


VARIABLE = "  VAR num n1:=0;\n"

STATE = (
    *lone(
        "a displacement by where the arm is", "PDispOn \\ExeP:=p10, pSeen, tG;", "PDispOff;", "  VAR robtarget pSeen;\n"
    )[:1],
    *lone("a displacement by a frame that was measured", "PDispSet peSeen;", "PDispOff;", "  VAR pose peSeen;\n"),
    *lone(
        "a displacement in a routine",
        "prepare;",
        "lamp;",
        "  VAR pose peSeen;\n",
        "  PROC prepare()\n    PDispSet peSeen;\n  ENDPROC\n  PROC lamp()\n    Set doLamp;\n  ENDPROC\n",
    )[:1],
    *lone("a work object is another one's copy", "wA:=wSeen;", "Set doLamp;", "  PERS wobjdata wSeen;\n"),
    *lone("a component of the user frame is measured", "wA.uframe.trans.z:=ai1;", "SetAO ao1, 3.5;"),
    *lone(
        "a component of the object frame is raised", "wA.oframe.trans.x:=wA.oframe.trans.x+ai1;", "n1:=n1+1;", VARIABLE
    ),
    *lone("the tool is worn", "tG.tframe.trans.z:=tG.tframe.trans.z-ai1;", "Incr n1;", VARIABLE),
    *lone("the tool is what the pendant has chosen", "tG:=CTool();", "WaitTime 0.5;"),
    *lone("the work object holds the robot", "wA.robhold:=bHeld;", "bHeld:=TRUE;", "  VAR bool bHeld;\n"),
    *lone("the user frame moves", 'wA.ufprog:=FALSE;\n    wA.ufmec:="STN1";', "WaitRob \\InPos;"),
    *lone("a routine that no module has", "rMeasureTable;", 'TPWrite "ready";'),
    *lone("a routine named by a text", "%stJob%;", "Stop;", '  PERS string stJob:="rOne";\n'),
    *lone("a routine named by a number", 'CallByVar "rJob",n1;', 'TPReadNum n1,"job";', VARIABLE),
    *lone("a module is loaded and run", 'Load \\Dynamic, "HOME:/JOB.MOD";\n    %"JOB:main"%;', "TPErase;"),
    *lone(
        "a routine of its own sets the work object if an input is on",
        "look;",
        "WaitDI di1,1;",
        routines="  PROC look()\n    IF di1=1 THEN\n      wA.uframe.trans:=CPos(\\Tool:=tG);\n    ENDIF\n  ENDPROC\n",
    )[:1],
    *lone(
        "a case of an input sets the tool",
        "TEST n1\n    CASE 1:\n      tG:=tH;\n    DEFAULT:\n      Set do1;\n    ENDTEST",
        "TEST n1\n    CASE 1:\n      Set do2;\n    DEFAULT:\n      Set do1;\n    ENDTEST",
        VARIABLE,
    ),
    *lone("a line with IF sets the work object", "IF di1=1 wA:=wB;", "IF di1=1 Set do1;"),
    *lone(
        "a tool is calibrated on the way",
        "MToolTCPCalib j1,j2,j3,j4,tG,n1,n2;",
        "n1:=n1+n2;",
        "  VAR num n1;\n  VAR num n2;\n",
    ),
    *lone("an object is defined by three points on the way", "wA.uframe:=DefFrame(pA,pB,pC);", "WaitTime 1;"),
    *lone(
        "a work object comes from a function",
        "wA:=fTable(2);",
        "n1:=fTwice(2);",
        VARIABLE,
        "  FUNC num fTwice(num n)\n    RETURN 2*n;\n  ENDFUNC\n",
    ),
    *lone(
        "a work object is read from a file",
        "ReadRawBytes raw1\\Time:=2;\n    UnpackRawBytes raw1,1,wA.uframe.trans.x\\Float4;",
        "ClearRawBytes raw1;",
        "  VAR rawbytes raw1;\n",
    ),
    *lone("a text that sets data by name", 'SetDataVal "wA",wSeen;', 'TPWrite "wA";', "  VAR wobjdata wSeen;\n"),
    *lone("the conveyor's part is awaited", "ActUnit CNV1;\n    WaitWObj wA\\RelDist:=10;", "WaitTime\\InPos,0;"),
    *lone("letters of other cases", "WA.OFRAME.Trans.Z:=AI1;", "N1:=N1+1;", VARIABLE),
    *lone(
        "a loop sets the work object in each pass",
        "WHILE di1=0 DO\n      wA.uframe.trans.x:=ai1;\n    ENDWHILE",
        "WHILE di1=0 DO\n      WaitTime 0.1;\n    ENDWHILE",
    ),
    *lone(
        "a jump back over a line that changes the object",
        "GOTO start;\n    again:\n    wA.oframe.trans.x:=ai1;\n    start:\n    IF di1=1 GOTO again;",
        "GOTO start;\n    again:\n    Set do1;\n    start:\n    IF di1=1 GOTO again;",
    ),
    *lone("two statements on a line", "Set do1; wA.oframe.trans.x:=ai1;", "Set do1; Reset do2;"),
    *lone(
        "a function in an argument changes the tool",
        "WaitTime fHeavy();",
        "WaitTime 0.5;",
        routines="  FUNC num fHeavy()\n    tG.tframe.trans.z:=ai1;\n    RETURN 0.5;\n  ENDFUNC\n",
    )[:1],
)

POINTS = (
    *body("one point with two tools", f"MoveL p10,v200,fine,§\\WObj:=wA;\n    {MOVE}", "tH", "tG"),
    *body("one point in two objects on a line", f"{MOVE} MoveL p10,v200,fine,tG§;", "\\WObj:=wB", "\\WObj:=wA"),
    *body("one point in another object behind IF", f"IF di1=1 MoveL p10,v200,fine,tG\\WObj:=w§;\n    {MOVE}", "B", "A"),
    *body(
        "a loop's end changes the object for its next pass",
        f"FOR i FROM 1 TO 3 DO\n      {MOVE}\n      §\n    ENDFOR",
        "wA.oframe.trans.x:=wA.oframe.trans.x+100;",
        "Set do1;",
    ),
    *body(
        "a routine is called with two tools",
        "go tG;\n    go t§;",
        "H",
        "G",
        routines="  PROC go(PERS tooldata t)\n    MoveL p10,v200,fine,t\\WObj:=wA;\n  ENDPROC\n",
    )[:1],
    *body(
        "a routine is called with two objects that change between",
        "go;\n    §\n    go;",
        "wA:=wB;",
        "Set do1;",
        routines=f"  PROC go()\n    {MOVE}\n  ENDPROC\n",
    ),
    *body(
        "a routine that calls itself and changes the object",
        "go 2;",
        "wA.oframe.trans.x:=wA.oframe.trans.x+100;",
        "Set do1;",
        routines=f"  PROC go(num n)\n    {MOVE}\n    IF n>0 THEN\n      §\n      go n-1;\n    ENDIF\n  ENDPROC\n",
    )[:1],
    *body(
        "a coordinate is raised", f"§\n    {MOVE}", "p10.trans.z:=p10.trans.z+10;", "n1:=n1+10;", VARIABLE, kind="VAR"
    ),
    *body("a coordinate is measured", f"§\n    {MOVE}", "P10.Trans.Z:=ai1;", "n1:=ai1;", VARIABLE, kind="PERS"),
    *body("a coordinate decides", f"IF § THEN\n      {MOVE}\n    ENDIF", "p10.trans.z>500", "di1=1"),
    *body("a posture word is written", f"§\n    {MOVE}", "p10.robconf.cf1:=n1;", "n1:=0;", VARIABLE, kind="VAR"),
    *body("an orientation is exchanged", f"§\n    {MOVE}", "p10.rot:=CRobT().rot;", "Set do1;", kind="VAR"),
    *body(
        "another point is made from it by an offset",
        f"{MOVE}\n    §",
        "p20:=Offs(p10,0,0,ai1);\n    MoveL p20,v200,fine,tG\\WObj:=wA;",
        MOVE,
        VARIABLE + "  VAR robtarget p20;\n",
    ),
    *body(
        "it is copied, and the copy is changed",
        f"{MOVE}\n    §",
        "p20:=p10;\n    p20.trans.x:=ai1;\n    MoveL p20,v200,fine,tG\\WObj:=wA;",
        MOVE,
        VARIABLE + "  VAR robtarget p20;\n",
    ),
    *body("an offset that is worked out", "MoveL §,v200,fine,tG\\WObj:=wA;", "Offs(p10,0,0,ai1)", "p10", VARIABLE),
    *body(
        "an offset in a loop",
        "FOR i FROM 0 TO 4 DO\n      MoveL §,v200,fine,tG\\WObj:=wA;\n    ENDFOR",
        "Offs(p10,i*50,0,0)",
        "p10",
    ),
    *body(
        "a turn of the tool that is worked out",
        "MoveL §,v200,fine,tG\\WObj:=wA;",
        "RelTool(p10,0,0,0\\Rz:=ai1)",
        "p10",
        VARIABLE,
    ),
    *body(
        "it is handed to a routine that changes it",
        f"§\n    {MOVE}",
        "raise p10;",
        "Set do1;",
        routines="  PROC raise(INOUT robtarget p)\n    p.trans.z:=p.trans.z+ai1;\n  ENDPROC\n",
        kind="VAR",
    ),
    *body(
        "it is handed to a routine that moves above it",
        f"§\n    {MOVE}",
        "over p10;",
        "Set do1;",
        routines="  PROC over(robtarget p)\n    p.trans.z:=p.trans.z+ai1;\n    MoveL p,v200,fine,tG\\WObj:=wA;\n  ENDPROC\n",
    )[:1],
    *body("it is handed to a routine that no module has", f"§\n    {MOVE}", "rPick p10;", "WaitTime 1;"),
    *body("it is the object's frame, too", f"{MOVE}\n    §", "wB.uframe.trans:=p10.trans;", MOVE),
    *body(
        "it is a displacement, too",
        f"{MOVE}\n    §",
        "PDispOn \\ExeP:=p10, pSeen, tG;",
        MOVE,
        "  CONST robtarget pSeen:=[[0,0,0],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n",
    ),
    *body("one of three points of a frame", f"{MOVE}\n    §", "wB.uframe:=DefFrame(p10,pX,pY);", MOVE),
    *body(
        "axes are worked out from it",
        f"{MOVE}\n    §",
        "j1:=CalcJointT(p10,tG\\WObj:=wA);\n    j1.robax.rax_6:=0;\n    MoveAbsJ j1,v200,fine,tG;",
        MOVE,
        "  VAR jointtarget j1;\n",
    ),
    *body("its distance is worked out", f"{MOVE}\n    §", "IF Distance(p10.trans,CPos())>10 Stop;", "IF di1=1 Stop;"),
    *body("a search overwrites it", f"§\n    {MOVE}", "SearchL di1,p10,pEnd,v50,tG\\WObj:=wA;", "Set do1;", kind="VAR"),
    *body(
        "a correction generator acts on the move",
        "MoveL p10,v200,fine,tG\\WObj:=wA§;",
        "\\Corr",
        "",
        "  VAR corrdescr id1;\n",
    ),
    *body("a sensor tracks the seam", "ArcL p10,v200,sm1,wd1§,fine,tG\\WObj:=wA;", "\\Track:=tr1", "")[:1],
    *body(
        "a tool out of an array by a number",
        "MoveL p10,v200,fine,§\\WObj:=wA;",
        "tAll{n1}",
        "tG",
        VARIABLE
        + f"  PERS tooldata tAll{{2}}:=[[TRUE,[[0,0,120],[1,0,0,0]],{LOAD}],[TRUE,[[0,0,150],[1,0,0,0]],{LOAD}]];\n",
    ),
    *body(
        "a move in a text, a text in a move",
        "§MoveL p10,v200,fine,tG\\WObj:=wA;§",
        ('TPWrite "', '";'),
        ('TPWrite "! no comment "" MoveL"; ', " ! TPWrite"),
    ),
    *body("a move in a comment", "§MoveL p10,v200,fine,tG\\WObj:=wA;", "! ", ""),
    *body("a move by a sensor", "§ p10,v200,fine,tG\\WObj:=wA;", "EGMMoveL egm1,", "MoveL", "  VAR egmident egm1;\n"),
    *body(
        "a local point hides it",
        "§\n    MoveAbsJ jH\\NoEOffs,v500,fine,tG;",
        "go;",
        MOVE,
        routines="  PROC go()\n    VAR robtarget p10;\n    p10:=CRobT(\\Tool:=tG\\WObj:=wA);\n"
        "    MoveL p10,v200,fine,tG\\WObj:=wA;\n  ENDPROC\n",
    )[:1],
    *body(
        "a parameter hides it",
        "§",
        "go CRobT(\\Tool:=tG\\WObj:=wA);",
        MOVE,
        routines="  PROC go(robtarget p10)\n    MoveL p10,v200,fine,tG\\WObj:=wA;\n  ENDPROC\n",
    )[:1],
    *body("a work object without a value", "MoveL p10,v200,fine,tG\\WObj:=w§;", "New", "A", "  VAR wobjdata wNew;\n"),
    *body(
        "a tool that stands in the room",
        "MoveL p10,v200,fine,t§\\WObj:=w§;",
        ("Fixed", "Held"),
        ("G", "A"),
        f"  PERS tooldata tFixed:=[FALSE,[[800,0,500],[1,0,0,0]],{LOAD}];\n"
        '  PERS wobjdata wHeld:=[TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,100],[1,0,0,0]]];\n',
    ),
    *body(
        "an object on a unit that turns",
        "MoveL p10,v200,fine,tG\\WObj:=w§;",
        "Turn",
        "A",
        '  PERS wobjdata wTurn:=[FALSE,FALSE,"STN1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n',
    ),
)

JOINTS = (
    *twins(
        "a joint target whose pose is worked out and moved on",
        {
            "M.mod": f"MODULE M\n{DATA}  CONST jointtarget jZ:=⟦[[5,-20,30,0,40,0],{AXES}]⟧;\n  VAR robtarget pZ;\n"
            "  PROC main()\n    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n    MoveAbsJ jZ\\NoEOffs,v500,fine,tG;\n    §\n"
            "  ENDPROC\nENDMODULE\n"
        },
        "pZ:=CalcRobT(jZ,tG);\n    MoveL Offs(pZ,0,0,ai1),v200,fine,tG;",
        "Set do1;",
    ),
    *twins(
        "an axis of a joint target is written",
        {
            "M.mod": f"MODULE M\n{DATA}  VAR jointtarget jZ:=⟦[[5,-20,30,0,40,0],{AXES}]⟧;\n"
            "  PROC main()\n    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n    §\n    MoveAbsJ jZ\\NoEOffs,v500,fine,tG;\n"
            "  ENDPROC\nENDMODULE\n"
        },
        "jZ.robax.rax_6:=jZ.robax.rax_6+ai1;",
        "Set do1;",
    ),
)

TRAP = "  TRAP seen\n    §\n  ENDTRAP\n"

FLOW = (
    *twins(
        "an interrupt sets the object",
        {
            "M.mod": module(
                f"CONNECT i1 WITH seen;\n    ISignalDI di1,1,i1;\n    WaitTime 1;\n    {MOVE}",
                "  VAR intnum i1;\n",
                TRAP,
            )
        },
        "wA.oframe.trans.x:=ai1;",
        "Set do1;",
    ),
    *twins(
        "an interrupt changes the point",
        {
            "M.mod": module(
                f"CONNECT i1 WITH seen;\n    ITimer 1,i1;\n    WaitTime 1;\n    {MOVE}",
                "  VAR intnum i1;\n",
                TRAP,
                "VAR",
            )
        },
        "p10.trans.x:=ai1;",
        "Set do1;",
    ),
    *twins(
        "a handler of errors changes the object and tries again",
        {"M.mod": module(f"{MOVE}\n  ERROR\n    §\n    RETRY;")},
        "wA:=wB;",
        "WaitTime 1;",
    )[:1],
    *twins(
        "a handler of errors changes the object and goes on",
        {"M.mod": module(f"n1:=10/ai1;\n    {MOVE}\n  ERROR\n    §\n    TRYNEXT;", VARIABLE)},
        "wA:=wB;",
        "n1:=0;",
    )[:1],
    *twins(
        "another module overwrites the point",
        {
            "M.mod": module(f"§\n    {MOVE}", kind="PERS"),
            "N.mod": "MODULE N\n  PROC rSeen()\n    p10:=CRobT(\\Tool:=tG\\WObj:=wA);\n  ENDPROC\nENDMODULE\n",
        },
        "rSeen;",
        "Set do1;",
    )[:1],
    *twins(
        "another module's local point has the same name",
        {
            "M.mod": module(MOVE),
            "N.mod": f"MODULE N\n  LOCAL CONST robtarget p10:=⟦{TARGET}⟧;\n  PROC rOther()\n"
            "    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n"
            "    MoveL p10,v200,fine,tG\\WObj:=§;\n  ENDPROC\nENDMODULE\n",
        },
        "wNobody",
        "wA",
    )[1:],
    Attack(
        "another module's local point has the same name, and an object that nobody has",
        {
            "M.mod": module(MOVE).replace("⟦", "⟨").replace("⟧", "⟩"),
            "N.mod": f"MODULE N\n  LOCAL CONST robtarget p10:=⟦{TARGET}⟧;\n  PROC rOther()\n"
            "    MoveL p10,v200,fine,tG\\WObj:=wNobody;\n"
            "  ENDPROC\nENDMODULE\n",
        },
    ),
    *twins(
        "another module sets the object",
        {
            "M.mod": module(f"rOther;\n    {MOVE}"),
            "N.mod": "MODULE N\n  PROC rOther()\n    §\n  ENDPROC\nENDMODULE\n",
        },
        "wA.uframe.trans:=CPos();",
        "Set do1;",
    ),
    *twins(
        "a module of the system has the tool, and a routine changes it",
        {
            "M.mod": "MODULE M\n"
            f"  CONST jointtarget jH:=⟨[[0,-20,30,0,40,0],{AXES}]⟩;\n  CONST robtarget p10:=⟦{TARGET}⟧;\n  PROC main()\n"
            "    MoveAbsJ jH\\NoEOffs,v500,fine,tool0;\n    §\n    MoveL p10,v200,fine,tS;\n  ENDPROC\nENDMODULE\n",
            "$user.mod": f"MODULE user(SYSMODULE)\n  PERS tooldata tS:=[TRUE,[[0,0,120],[1,0,0,0]],{LOAD}];\nENDMODULE\n",
        },
        "tS.tframe.trans.z:=ai1;",
        "Set do1;",
    ),
    *twins(
        "an array's element is overwritten by an index that is not known",
        {
            "M.mod": f"MODULE M\n{DATA}  VAR robtarget pA{{2}}:=[⟦{TARGET}⟧,⟦{TARGET}⟧];\n{VARIABLE}  PROC main()\n"
            "    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n    §\n    MoveL pA{1},v200,fine,tG\\WObj:=wA;\n"
            "    MoveL pA{2},v200,fine,tG\\WObj:=wA;\n"
            "  ENDPROC\nENDMODULE\n"
        },
        "pA{n1}:=CRobT(\\Tool:=tG\\WObj:=wA);",
        "Set do1;",
    )[:1],
    *twins(
        "an array's elements are reached with two tools",
        {
            "M.mod": f"MODULE M\n{DATA}  CONST robtarget pA{{2}}:=[⟦{TARGET}⟧,⟦{TARGET}⟧];\n  PROC main()\n"
            "    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n    FOR i FROM 1 TO 2 DO\n      MoveL pA{i},v200,fine,tG\\WObj:=wA;\n"
            "      MoveL pA{i},v200,fine,tH\\WObj:=wA;\n    ENDFOR§\n  ENDPROC\nENDMODULE\n"
        },
        "",
    )[:1],
    *twins(
        "a routine with an optional object",
        {
            "M.mod": module(
                "go;\n    go\\w:=wB;§",
                routines="  PROC go(\\PERS wobjdata w)\n    MoveL p10,v200,fine,tG\\WObj?w;\n  ENDPROC\n",
            )
        },
        "",
    )[:1],
)

REACHES_NOTHING = (
    Attack(
        "control: what stands behind RETURN, in a text, in a comment",
        {
            "M.mod": module(
                f'off;\n    TPWrite "wA:=wB; ""PDispOn"" ";\n    ! wA.uframe:=peSeen;\n    {MOVE}',
                "  VAR pose peSeen;\n",
                "  PROC off()\n    RETURN;\n    PDispSet peSeen;\n  ENDPROC\n",
            )
            .replace("⟦", "⟨")
            .replace("⟧", "⟩")
        },
    ),
    Attack(
        "control: a displacement that is off again",
        {
            "M.mod": module(
                f"PDispSet peSeen;\n    MoveL p20,v200,fine,tG\\WObj:=wA;\n    PDispOff;\n    {MOVE}",
                f"  VAR pose peSeen;\n  CONST robtarget p20:={TARGET};\n",
            )
            .replace("⟦", "⟨")
            .replace("⟧", "⟩")
        },
    ),
    Attack(
        "control: a statement on many lines, letters of other cases, blanks",
        {
            "M.mod": module("movel\n      P10 ,\n      V200,Fine ,\n      TG \\wobj := WA ; ! end")
            .replace("⟦", "⟨")
            .replace("⟧", "⟩")
        },
    ),
    Attack(
        "control: a local point with its own value hides the module's",
        {
            "M.mod": module(
                f"go;\n    {MOVE}",
                routines=f"  PROC go()\n    CONST robtarget p10:=⟨{TARGET}⟩;\n    MoveL p10,v200,fine,tH\\WObj:=wB;\n  ENDPROC\n",
            )
            .replace("⟦", "⟨")
            .replace("⟧", "⟩")
        },
    ),
)

GRID = [(850 + 20 * (k % 4), -200 + 50 * (k // 4), 700 + 10 * (k % 3)) for k in range(16)]
"""Places of plain programs, [mm]."""


def robtargets(count: int, digits: int, kind: str = "CONST", names: str = "p{}0", marked: bool = True) -> list[str]:
    """Declarations of robtargets."""
    return [
        f"{kind} robtarget {names.format(k)}:="
        + ("⟨" if marked else "")
        + f"[[{','.join(f'{v:.{digits}f}' for v in xyz)}],[0.000000,0.0,1.0,0.0],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"
        + ("⟩" if marked else "")
        + ";"
        for k, xyz in enumerate(GRID[:count], start=1)
    ]


def stances(count: int) -> list[str]:
    """Joint targets with marks."""
    return [f"⟨[[{3 * k:.3f},-20.0,30.0,0.0,{40 + k:.1f},0.0],{AXES}]⟩" for k in range(count)]


def program(name: str, data: list[str], lines: list[str], end: str = "\n", more: str = "") -> Attack:
    """A plain module of which all is marked."""
    rows = (
        ["%%%", "  VERSION:1", "  LANGUAGE:ENGLISH", "%%%", "", "MODULE Plain"] if end == "\r\n" else ["MODULE Plain"]
    )
    rows += ["    " + row for row in data] + ["    PROC main()"] + ["        " + row for row in lines] + ["    ENDPROC"]
    return Attack(f"plain: {name}", {"Plain.mod": end.join([*rows, more + "ENDMODULE", ""])})


FRAMES = [
    f"PERS tooldata tGun:=[TRUE,[[31.792631019,0,229.638935148],[0.945518576,0,0.325568154,0]],{LOAD}];",
    'TASK PERS wobjdata wTable:=[FALSE,TRUE,"",[[450,-20.5,180],[1,0,0,0]],[[10,20,30],[0.9999619,0,0,0.0087265]]];',
]

HOME = f"CONST jointtarget jHome:={stances(1)[0]};"

GO = "MoveAbsJ jHome\\NoEOffs,v1000,fine,tGun\\WObj:=wTable;"


def moves(count: int, words: str = "v200,z5,tGun\\WObj:=wTable", kind: str = "MoveL") -> list[str]:
    """Moves to robtargets."""
    return [f"{kind} p{k}0,{words};" for k in range(1, count + 1)]


PLAIN = (
    program(
        "offline programming: targets declared, one path", [*FRAMES, HOME, *robtargets(14, 9)], [GO, *moves(14)], "\r\n"
    ),
    program(
        "targets in the moves",
        [*FRAMES, HOME],
        [GO, *(f"MoveL {row.split(':=')[1].rstrip(';')},v100,z1,tGun\\WObj:=wTable;" for row in robtargets(10, 3))],
    ),
    program(
        "paths in routines of their own",
        [*FRAMES, HOME, *robtargets(9, 4)],
        [GO, "Path_10;", "WaitTime 0.5;", "Path_20;"],
        more="    PROC Path_10()\n        "
        + "\n        ".join(moves(5))
        + "\n    ENDPROC\n    PROC Path_20()\n        "
        + "\n        ".join(moves(9)[5:])
        + "\n    ENDPROC\n",
    ),
    program(
        "joints alone, as a planner writes them",
        [f"CONST jointtarget j{k}:={q};" for k, q in enumerate(stances(16))],
        [f"MoveAbsJ j{k},v300,z10,tool0;" for k in range(16)],
    ),
    program(
        "picking and placing with signals",
        [*FRAMES, HOME, *robtargets(8, 2, "PERS"), "VAR num nParts:=0;"],
        [
            "ConfL\\Off;",
            "AccSet 50,80;",
            GO,
            "WHILE TRUE DO",
            *(f"{move} SetDO doGrip,{k % 2}; WaitDI diOpen,{k % 2}\\MaxTime:=3;" for k, move in enumerate(moves(8))),
            "Incr nParts;",
            'TPWrite "parts "\\Num:=nParts;',
            "ENDWHILE",
        ],
    ),
    program(
        "circles and lines",
        [*FRAMES, HOME, *robtargets(12, 3)],
        [GO]
        + [
            f"MoveL p{k}0,v50,fine,tGun\\WObj:=wTable;\n        MoveC p{k + 1}0,p{k + 2}0,v50,z1,tGun\\WObj:=wTable;"
            for k in (1, 4, 7, 10)
        ],
    ),
    program(
        "tool0 and wobj0",
        [HOME, *robtargets(10, 1)],
        [
            "MoveAbsJ jHome,v1000,fine,tool0;",
            *moves(5, "v200,fine,tool0", "MoveJ"),
            *moves(10, "v200,fine,tool0\\WObj:=wobj0")[5:],
        ],
    ),
    program(
        "arc welding",
        [
            *FRAMES,
            HOME,
            *robtargets(8, 2),
            "TASK PERS seamdata sm1:=[0,0,0,0];",
            "TASK PERS welddata wd1:=[10,0,[0,0],[0,0]];",
        ],
        [GO, "MoveL p10,v1000,z10,tGun\\WObj:=wTable;", "ArcLStart p20,v1000,sm1,wd1,fine,tGun\\WObj:=wTable;"]
        + [f"ArcL p{k}0,v100,sm1,wd1,z1,tGun\\WObj:=wTable;" for k in range(3, 7)]
        + ["ArcLEnd p70,v100,sm1,wd1,fine,tGun\\WObj:=wTable;", "MoveL p80,v1000,fine,tGun\\WObj:=wTable;"],
    ),
    program(
        "CRLF, umlauts, switching on the way",
        [*FRAMES, HOME, *robtargets(10, 3, "LOCAL CONST", "p{}0")],
        ["! Grundstellung über dem Tisch", GO, "SingArea\\Wrist;", "GripLoad load0;"]
        + [f"MoveLDO p{k}0,v200,z5,tGun\\WObj:=wTable,doGlue,{k % 2}; ! Naht {k}" for k in range(1, 11)],
        "\r\n",
    ),
    program(
        "by hand, with cases and counters",
        [*FRAMES, HOME, *robtargets(8, 0), "VAR num n:=1;"],
        [GO, "FOR i FROM 1 TO 8 DO", "TEST i"]
        + [f"CASE {k}:\n            {move}" for k, move in enumerate(moves(8), start=1)]
        + ["DEFAULT:", "    Stop;", "ENDTEST", "n:=n+i;", "ENDFOR"],
    ),
)

IN_PLACE = (
    f"MODULE M\n{DATA}  PROC main()\n    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n"
    f"    MoveL ⟦{TARGET}⟧,v200,fine,tG\\WObj:=wA;\n  ENDPROC\nENDMODULE\n"
)
"""A module whose target stands in the move."""

ORDER = (
    *twins(
        "a displacement at the end acts in the next cycle",
        {"M.mod": module(f"{MOVE}\n    §", "  VAR pose peSeen;\n")},
        "PDispSet peSeen;",
        "PDispOff;",
    ),
    *twins(
        "a rail is told a place in a move before",
        {"M.mod": module(f"MoveAbsJ [[0,-20,30,0,40,0],[§,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v500,fine,tG;\n    {MOVE}")},
        "1500",
        "9E9",
    ),
    *twins(
        "a procedure of a move is named by a variable",
        {
            "M.mod": module(
                f"MoveLSync p20,v200,fine,tG\\WObj:=wA,§;\n    {MOVE}",
                f"  CONST robtarget p20:={TARGET};\n",
                "  PROC rLamp()\n    Set do1;\n  ENDPROC\n",
            )
        },
        "stNext",
        '"rLamp"',
    ),
    *twins(
        "a permanent object is measured at the end, and kept",
        {"M.mod": module(f"{MOVE}\n    §")},
        "wA.oframe.trans.x:=ai1;",
        "SetDO do1,1;",
    ),
    *twins(
        "a permanent tool is measured at the end, and kept",
        {"M.mod": module(f"{MOVE}\n    §")},
        "tG.tframe.trans.z:=ai1;",
        "PulseDO do1;",
    ),
    *lone(
        "an operator is asked for a part of the object",
        'TPReadNum wA.oframe.trans.x,"x?";',
        'TPReadNum n1,"x?";',
        VARIABLE,
    ),
    *lone(
        "a text is turned into the object",
        "bOk:=StrToVal(stIn,wA);",
        "bOk:=StrToVal(stIn,n1);",
        VARIABLE + "  VAR bool bOk;\n  VAR string stIn;\n",
    ),
    *body(
        "a text is turned into the point",
        f"§\n    {MOVE}",
        "bOk:=StrToVal(stIn,p10);",
        "bOk:=StrToVal(stIn,n1);",
        VARIABLE + "  VAR bool bOk;\n  VAR string stIn;\n",
        kind="VAR",
    ),
    *lone("the tool in force is read into another's data", "GetSysData tG;", "WaitTime 0.1;"),
    *lone(
        "data are read from a file into the object",
        "ReadAnyBin ioFile,wA\\Time:=2;",
        "Rewind ioFile;",
        "  VAR iodev ioFile;\n",
    ),
    *lone(
        "a routine is handed the object, and changes it",
        "learn wA;",
        "lamp do1;",
        routines="  PROC learn(PERS wobjdata w)\n    w.oframe.trans.x:=ai1;\n  ENDPROC\n"
        "  PROC lamp(VAR signaldo d)\n    SetDO d,1;\n  ENDPROC\n",
    )[:1],
    *lone(
        "a routine is handed the tool, and changes it",
        "learn tG;",
        "WaitTime 1;",
        routines="  PROC learn(INOUT tooldata t)\n    t.tframe.trans.z:=ai1;\n  ENDPROC\n",
    )[:1],
    *body(
        "a parameter has the object's name",
        f"{MOVE}\n    §",
        "go wB;",
        "Set do1;",
        routines="  PROC go(PERS wobjdata wA)\n    MoveL p10,v200,fine,tG\\WObj:=wA;\n  ENDPROC\n",
    )[:1],
    *body(
        "a parameter has the tool's name",
        f"{MOVE}\n    §",
        "go tH;",
        "Set do1;",
        routines="  PROC go(PERS tooldata tG)\n    MoveL p10,v200,fine,tG\\WObj:=wA;\n  ENDPROC\n",
    )[:1],
    *body(
        "a procedure named by a text on the way",
        f'MoveLSync p20,v200,fine,tG\\WObj:=wA,"§";\n    {MOVE}',
        "rNobody",
        "rLamp",
        f"  CONST robtarget p20:={TARGET};\n",
        "  PROC rLamp()\n    Set do1;\n  ENDPROC\n",
    ),
    *body(
        "a rail is told a place",
        MOVE.replace("p10", "p30") + "§",
        "",
        "",
        "  CONST robtarget p30:=⟦[[900,100,700],[0,0,1,0],[0,0,0,0],[1500,9E9,9E9,9E9,9E9,9E9]]⟧;\n",
    )[:1],
    *twins(
        "a part of a target in a move is worked out",
        {"M.mod": IN_PLACE.replace("900", "900§")},
        "+ai1",
    ),
    *twins(
        "a target's part is a name",
        {
            "M.mod": IN_PLACE.replace("700", "§").replace(
                "ENDMODULE", "  PERS num nH:=700;\n  PROC rSeen()\n    nH:=ai1;\n  ENDPROC\nENDMODULE"
            )
        },
        "nH",
        "700",
    ),
    *twins(
        "one public name in two modules",
        {"M.mod": module(MOVE), "N.mod": "MODULE N\n§ENDMODULE\n"},
        "  CONST robtarget p10:=[[900,-100,700],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n",
        "  CONST robtarget p11:=[[900,-100,700],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n",
    ),
    *twins(
        "a local routine hides another module's",
        {
            "M.mod": module(
                f"prepare;\n    {MOVE}", "  VAR pose peSeen;\n", "  LOCAL PROC prepare()\n    §\n  ENDPROC\n"
            ),
            "N.mod": "MODULE N\n  PROC prepare()\n    §\n  ENDPROC\nENDMODULE\n",
        },
        ("PDispSet peSeen;", "Set do1;"),
        ("Set do1;", "Reset do1;"),
    ),
    *twins(
        "a handler of errors of what is called goes back with another object",
        {
            "M.mod": module(
                f"go;\n    {MOVE}",
                routines="  PROC go()\n    MoveAbsJ jH\\NoEOffs,v500,fine,tG;\n  ERROR\n    §\n    RETURN;\n  ENDPROC\n",
            )
        },
        "wA.oframe.trans.x:=ai1;",
        "Set do1;",
    ),
    *twins(
        "a signal's interrupt on the way sets the object",
        {
            "M.mod": module(
                f"CONNECT i1 WITH seen;\n    TriggInt tr1,10,i1;\n    TriggL p20,v200,tr1,fine,tG\\WObj:=wA;\n    {MOVE}",
                f"  VAR intnum i1;\n  VAR triggdata tr1;\n  CONST robtarget p20:={TARGET};\n",
                TRAP,
            )
        },
        "wA.oframe.trans.x:=ai1;",
        "Set do1;",
    ),
    *lone(
        "a label is reached from behind",
        "GOTO lower;\n    upper:\n    GOTO go;\n    lower:\n    PDispSet peSeen;\n    GOTO upper;\n    go:",
        "GOTO lower;\n    upper:\n    GOTO go;\n    lower:\n    Set do1;\n    GOTO upper;\n    go:",
        "  VAR pose peSeen;\n",
    ),
    *lone(
        "a text with a doubled quotation mark, and a statement behind it",
        'TPWrite """"; PDispSet peSeen;',
        'TPWrite """"; Set do1;',
        "  VAR pose peSeen;\n",
    ),
    *lone(
        "an exclamation mark in a text, and a statement behind it",
        'TPWrite "go!"; PDispSet peSeen;',
        'TPWrite "go!"; Set do1;',
        "  VAR pose peSeen;\n",
    ),
    Attack(
        "a bare CR ends a comment",
        {
            "M.mod": module(f"! next\r    PDispSet peSeen;\n    {MOVE}", "  VAR pose peSeen;\n")
            .replace("⟨", "")
            .replace("⟩", "")
        },
    ),
    Attack(
        "control: letters whose second byte some take for the end of a line",
        {
            "M.mod": module(
                "! Å PDispSet peSeen;\n    ! à\xa0 PDispSet peSeen;\n    MoveL p10, ! Å first\n      v200,fine,tG\\WObj:=wA;",
                "  VAR pose peSeen;\n",
            )
            .replace("⟦", "⟨")
            .replace("⟧", "⟩")
        },
    ),
    Attack(
        "control: switches of a move that change nothing of its place",
        {
            "M.mod": module("MoveL\\Conc,p10\\ID:=7,v200\\V:=150,fine\\Inpos:=inpos50,tG\\WObj:=wA\\TLoad:=load0;")
            .replace("⟦", "⟨")
            .replace("⟧", "⟩")
        },
    ),
)

SHIFT = "  VAR pose peSeen;\n"

INDIRECT = (
    *lone(
        "an interrupt whose routine no module has",
        "CONNECT i1 WITH tNobody;\n    ISignalDI di1,1,i1;",
        "Set do1;",
        "  VAR intnum i1;\n",
    ),
    *body(
        "a joint move that calls a procedure named by a text",
        f'MoveJSync p20,v200,fine,tG\\WObj:=wA,"§";\n    {MOVE}',
        "rNobody",
        "rLamp",
        f"  CONST robtarget p20:={TARGET};\n",
        "  PROC rLamp()\n    Set do1;\n  ENDPROC\n",
    ),
    *body(
        "a procedure of its own that a move calls sets a displacement",
        f'MoveLSync p20,v200,fine,tG\\WObj:=wA,"rSeen";\n    {MOVE}',
        "PDispSet peSeen;",
        "Set do1;",
        SHIFT + f"  CONST robtarget p20:={TARGET};\n",
        "  PROC rSeen()\n    §\n  ENDPROC\n",
    ),
    *body(
        "two routines call each other, and a displacement comes between",
        "a 1;",
        "PDispSet peSeen;",
        "Set do1;",
        SHIFT,
        f"  PROC a(num n)\n    {MOVE}\n    IF n>0 THEN\n      §\n      b n;\n    ENDIF\n  ENDPROC\n  PROC b(num n)\n"
        "    a n-1;\n  ENDPROC\n",
    )[:1],
    *body(
        "a routine calls itself with a displacement",
        "go 2;",
        "PDispSet peSeen;",
        "Set do1;",
        SHIFT,
        f"  PROC go(num n)\n    {MOVE}\n    IF n>0 THEN\n      §\n      go n-1;\n    ENDIF\n  ENDPROC\n",
    )[:1],
    *body(
        "an interrupt's routine calls what sets a displacement",
        f"CONNECT i1 WITH seen;\n    ITimer 1,i1;\n    WaitTime 1;\n    {MOVE}",
        "PDispSet peSeen;",
        "Set do1;",
        SHIFT + "  VAR intnum i1;\n",
        "  TRAP seen\n    fit;\n  ENDTRAP\n  PROC fit()\n    §\n  ENDPROC\n",
    ),
    *body(
        "an interrupt that a routine connects",
        f"arm;\n    WaitTime 1;\n    {MOVE}",
        "PDispSet peSeen;",
        "Set do1;",
        SHIFT + "  VAR intnum i1;\n",
        "  TRAP seen\n    §\n  ENDTRAP\n  PROC arm()\n    CONNECT i1 WITH seen;\n    ISignalDI di1,1,i1;\n  ENDPROC\n",
    ),
    *body(
        "a cycle is ended with a displacement in force",
        f"{MOVE}\n    §\n    IF di1=1 ExitCycle;\n    PDispOff;",
        "PDispSet peSeen;",
        "Set do1;",
        SHIFT,
    ),
    *lone(
        "a displacement is off in one case only",
        "PDispSet peSeen;\n    TEST ai1\n    CASE 1,2:\n      PDispOff;\n    ENDTEST",
        "PDispSet peSeen;\n    TEST ai1\n    CASE 1,2:\n      PDispOff;\n    DEFAULT:\n      PDispOff;\n    ENDTEST",
        SHIFT,
    ),
    *lone(
        "a displacement is off in a loop that perhaps never runs",
        "PDispSet peSeen;\n    WHILE di1=1 DO\n      PDispOff;\n    ENDWHILE",
        "PDispSet peSeen;\n    PDispOff;\n    WHILE di1=1 DO\n      WaitTime 1;\n    ENDWHILE",
        SHIFT,
    ),
    *lone(
        "a displacement is off behind a return that comes first",
        "PDispSet peSeen;\n    back;",
        "PDispSet peSeen;\n    PDispOff;\n    back;",
        SHIFT,
        "  PROC back()\n    IF di1=1 RETURN;\n    PDispOff;\n  ENDPROC\n",
    ),
    *body(
        "a constant is another's copy, and both are targets with two tools",
        f"{MOVE}\n    MoveL p20,v200,fine,t§\\WObj:=wA;",
        "H",
        "G",
        "  CONST robtarget p20:=p10;\n",
    )[:1],
    *twins(
        "a module's own tool has the name of a public one",
        {
            "M.mod": module(f"{MOVE}\n    rOther;"),
            "N.mod": "MODULE N\n§  PROC rOther()\n    MoveL p10,v200,fine,tG\\WObj:=wA;\n  ENDPROC\nENDMODULE\n",
        },
        f"  LOCAL PERS tooldata tG:=[TRUE,[[0,0,300],[1,0,0,0]],{LOAD}];\n",
        f"  LOCAL PERS tooldata tN:=[TRUE,[[0,0,300],[1,0,0,0]],{LOAD}];\n",
    ),
    *twins(
        "a number of a declared target is worked out",
        {"M.mod": module(MOVE, "§", target=TARGET.replace("700", "nH"))},
        "  PERS num nH:=700;\n  PROC rSeen()\n    nH:=ai1;\n  ENDPROC\n",
    )[:1],
    *lone(
        "the condition of a loop sets a displacement",
        "WHILE bMore() DO\n      WaitTime 1;\n    ENDWHILE",
        "WHILE di1=1 DO\n      WaitTime 1;\n    ENDWHILE",
        SHIFT,
        "  FUNC bool bMore()\n    PDispSet peSeen;\n    RETURN FALSE;\n  ENDFUNC\n",
    )[:1],
    *body(
        "a move's speed is a function that sets a displacement",
        "MoveL p10,vSlow(),fine,tG\\WObj:=wA;",
        "PDispSet peSeen;",
        "Set do1;",
        SHIFT,
        "  FUNC speeddata vSlow()\n    §\n    RETURN v100;\n  ENDFUNC\n",
    )[:1],
    *body(
        "an object out of an array that a loop goes through",
        "FOR i FROM 1 TO 2 DO\n      MoveL p10,v200,fine,tG\\WObj:=w§;\n    ENDFOR",
        "All{i}",
        "A",
        '  PERS wobjdata wAll{2}:=[[FALSE,TRUE,"",[[1,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]],'
        '[FALSE,TRUE,"",[[2,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]]];\n',
    ),
)

ATTACKS: tuple[Attack, ...] = (*STATE, *POINTS, *JOINTS, *FLOW, *REACHES_NOTHING, *INDIRECT, *PLAIN, *ORDER)
