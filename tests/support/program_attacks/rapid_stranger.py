"""RAPID by somebody who had not seen the reader: writing by name or by argument, hidden names, handlers, other tasks."""

from __future__ import annotations

from program_attacks import Attack

TOOL = "PERS tooldata tGrip := [TRUE,[[0,0,120],[1,0,0,0]],[1.2,[0,0,40],[1,0,0,0],0,0,0]];"
WOBJ = 'PERS wobjdata wCell := [FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];'
A = "[[512.5,-310.2,420.7],[0.0123,0.7071,0.7069,0.0101],[-1,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
B = "[[640.1,-122.8,355.4],[0.0101,0.7071,0.7069,0.0123],[-1,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"
J = "[[12.5,-80.1,95.2,3.3,70.7,11.9],[9E9,9E9,9E9,9E9,9E9,9E9]]"
P = f"CONST robtarget pA := ⟦{A}⟧;\n  CONST robtarget pB := ⟨{B}⟩;"
V = P.replace("CONST robtarget pA", "VAR robtarget pA")


def _main(body: str, data: str, behind: str = "", module: str = "MainModule") -> str:
    lines = "".join(f"    {line}\n" for line in body.strip("\n").split("\n"))
    begin = (
        f"MODULE {module}\n  {TOOL}\n  {WOBJ}\n  {data}\n  PROC main()\n    MoveAbsJ {J}\\NoEOffs, v500, fine, tGrip;\n"
    )
    return f"{begin}{lines}  ENDPROC\n{behind}ENDMODULE\n"


def _case(name: str, body: str, behind: str = "", data: str = P, **files: str) -> Attack:
    others = {f"{key}.mod": text for key, text in files.items()}
    return Attack(name, {"main.mod": _main(body, data, behind), **others})


GO_A = "MoveL pA, v100, fine, tGrip\\WObj:=wCell;"
GO_B = "MoveL pB, v100, fine, tGrip\\WObj:=wCell;"
SWAPPED = P.translate(str.maketrans("⟦⟧⟨⟩", "⟨⟩⟦⟧"))
NONE = P.replace("⟨", "⟦").replace("⟩", "⟧")
BOTH = P.replace("⟦", "⟨").replace("⟧", "⟩")

ATTACKS = [
    _case(
        "plain moves",
        f"{GO_A}\nMoveJ pB, v100\\V:=300, z10\\Z:=12, tGrip\\WObj:=wCell\\TLoad:=load0;\n"
        f"MoveAbsJ ⟨{J}⟩\\NoEOffs, v500, fine, tGrip;",
        data=BOTH,
    ),
    _case(
        "SetDataVal writes by name",
        f'SetDataVal "pA", CRobT(\\Tool:=tGrip\\WObj:=wCell);\n{GO_A}',
        data=V.replace("⟨", "⟦").replace("⟩", "⟧"),
    ),
    _case(
        "SetAllDataVal writes all of a type",
        'SetAllDataVal "wobjdata"\\TypeMod:="MainModule"\\Hidden, wNew;\nMoveL pA, v100, fine, tGrip\\WObj:=wCell;',
        data=NONE + "\n  VAR wobjdata wNew;",
    ),
    _case(
        "a string is turned into a point",
        f"bOk := StrToVal(sText, pA);\n{GO_A}\n{GO_B}",
        data=V + "\n  VAR bool bOk;\n  VAR string sText;",
    ),
    _case(
        "raw bytes into a component",
        f"UnpackRawBytes rbIn, 1, pA.trans.x\\Float4;\n{GO_A}\n{GO_B}",
        data=V + "\n  VAR rawbytes rbIn;",
    ),
    _case("Add to a component", f"Add pA.trans.z, 10;\n{GO_A}\n{GO_B}", data=V),
    _case("Incr of a component", f"Incr pA.trans.z;\n{GO_A}\n{GO_B}", data=V),
    _case("a device is read into the point", f"ReadAnyBin ioDev, pA;\n{GO_A}\n{GO_B}", data=V + "\n  VAR iodev ioDev;"),
    _case(
        "a message is read into the point",
        f"RMQGetMsgData rmqM, pA;\n{GO_A}\n{GO_B}",
        data=V + "\n  VAR rmqmessage rmqM;",
    ),
    _case("the search writes the point", f"SearchL\\Stop, diTouch, pA, pB, v50, tGrip\\WObj:=wCell;\n{GO_A}", data=V),
    _case(
        "the tool is calibrated by the program",
        f"{GO_B}\nMToolTCPCalib j1, j2, j3, j4, tGrip, nMax, nMean;\n{GO_A}",
        data=NONE + "\n  CONST jointtarget j1:=[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
        "  CONST jointtarget j2:=[[2,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
        "  CONST jointtarget j3:=[[3,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
        "  CONST jointtarget j4:=[[4,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];\n  VAR num nMax;\n"
        "  VAR num nMean;",
    ),
    _case(
        "wobj0 is somebody's own",
        f"MoveL pA, v100, fine, tGrip;\n{GO_B}\nMoveL pA, v100, fine, tGrip\\WObj:=wobj0;",
        data=P + '\n  LOCAL PERS wobjdata wobj0 := [FALSE,FALSE,"CNV1",[[0,0,500],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
    ),
    _case(
        "MoveL is somebody's own",
        "MoveL pA, v100, fine, tGrip\\WObj:=wCell;\nMoveJ pB, v100, fine, tGrip\\WObj:=wCell;",
        "  LOCAL PROC MoveL(robtarget p, speeddata v, zonedata z, PERS tooldata t\\PERS wobjdata WObj)\n"
        "    MoveJ Offs(p,0,0,50), v, z, t\\WObj:=wCell;\n  ENDPROC\n",
        data=BOTH,
    ),
    _case(
        "an argument is handed on only where present",
        f"go pA;\n{GO_B}",
        "  PROC go(robtarget p\\PERS wobjdata frame)\n    MoveL p, v100, fine, tGrip\\WObj?frame;\n  ENDPROC\n",
        data=BOTH,
    ),
    _case(
        "a trap moves the frame",
        f"CONNECT iTemp WITH tDrift;\nITimer 60, iTemp;\n{GO_A}",
        "  TRAP tDrift\n    wCell.oframe.trans.z := wCell.oframe.trans.z + AInput(aiTemp);\n  ENDTRAP\n",
        data=f"VAR intnum iTemp;\n  CONST robtarget pA := ⟦{A}⟧;",
    ),
    _case(
        "an error handler moves the frame and tries again",
        "MoveL pA, v100, fine, tGrip\\WObj:=wCell;\n  ERROR\n"
        "    wCell.uframe.trans.x := wCell.uframe.trans.x + 5;\n    RETRY;",
        data=f"CONST robtarget pA := ⟦{A}⟧;",
    ),
    _case(
        "late binding calls what sets the displacement",
        f'{GO_B}\n%"shift"+NumToStr(n,0)%;\n{GO_A}',
        "  PROC shift1()\n    PDispSet [[0,0,50],[1,0,0,0]];\n  ENDPROC\n",
        data=SWAPPED + "\n  VAR num n := 1;",
    ),
    _case(
        "CallByVar",
        f'{GO_B}\nCallByVar "shift", n;\n{GO_A}',
        "  PROC shift1()\n    PDispSet [[0,0,50],[1,0,0,0]];\n  ENDPROC\n",
        data=NONE + "\n  VAR num n := 1;",
    ),
    _case("a module is loaded and run", f'{GO_B}\nLoad\\Dynamic, "HOME:/part.mod";\n%"part_main"%;\n{GO_A}', data=NONE),
    _case(
        "another task writes the point",
        f"{GO_A}\n{GO_B}",
        data=P.replace("CONST robtarget pA", "PERS robtarget pA"),
        vision="MODULE Vision\n  PERS robtarget pA;\n  PROC main()\n    WHILE TRUE DO\n"
        "      pA.trans.x := 500 + AInput(aiX);\n    ENDWHILE\n  ENDPROC\nENDMODULE\n".replace(
            "PROC main", "PROC vmain"
        ),
    ),
    _case(
        "a point local to another module has the same name",
        f"{GO_B}\nother;",
        data=f"LOCAL CONST robtarget pB := ⟨{B}⟩;",
        other="MODULE Other\n  LOCAL VAR robtarget pB := ⟦" + A + "⟧;\n  PROC other()\n    pB := Offs(pB,0,0,10);\n"
        "    MoveL pB, v100, fine, tGrip\\WObj:=wCell;\n  ENDPROC\nENDMODULE\n",
    ),
    _case(
        "a local of the routine hides the point",
        f"{GO_A}\n{GO_B}".replace(GO_A, "go;"),
        "  PROC go()\n    VAR robtarget pA := ⟦"
        + B
        + "⟧;\n    pA.trans.z := pA.trans.z + 10;\n    MoveL pA, v100, fine, tGrip\\WObj:=wCell;\n"
        "  ENDPROC\n",
        data=f"CONST robtarget pB := ⟨{B}⟩;",
    ),
    _case(
        "INOUT changes the point",
        f"adjust pA;\n{GO_A}\n{GO_B}",
        "  PROC adjust(INOUT robtarget p)\n    p := RelTool(p,0,0,5);\n  ENDPROC\n",
        data=V,
    ),
    _case(
        "a parameter named like the tool",
        f"go tOther;\n{GO_B}",
        "  PROC go(PERS tooldata tGrip)\n    MoveL pA, v100, fine, tGrip\\WObj:=wCell;\n  ENDPROC\n",
        data=BOTH + "\n  PERS tooldata tOther := [TRUE,[[0,0,333],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];",
    ),
    _case(
        "named constants in the point",
        f"{GO_A}\n{GO_B}",
        data=P.replace("420.7", "nHeight") + "\n  VAR num nHeight := 420.7;",
    ),
    _case(
        "a conveyor's frame",
        f"WaitWObj wConv\\RelDist:=50;\nMoveL pA, v100, fine, tGrip\\WObj:=wConv;\n{GO_B}\nDropWObj wConv;",
        data=P + '\n  PERS wobjdata wConv := [FALSE,FALSE,"CNV1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
    ),
    _case(
        "a camera's frame",
        "CamGetResult cam1, ctCam;\nwCell.oframe := ctCam.cframe;\nMoveL pA, v100, fine, tGrip\\WObj:=wCell;",
        data=f"VAR cameratarget ctCam;\n  CONST robtarget pA := ⟦{A}⟧;",
    ),
    _case(
        "path correction",
        f"{GO_B}\nCorrCon cg;\nCorrWrite cg, [0,2,0];\nMoveL pA, v100, fine, tGrip\\WObj:=wCell\\Corr;\nCorrDiscon cg;",
        data=P + "\n  VAR corrdescr cg;",
    ),
    _case(
        "synchronised motion",
        f"{GO_B}\nSyncMoveOn s1, tasks;\nMoveL pA\\ID:=10, v100, fine, tGrip\\WObj:=wStn;\nSyncMoveOff s2;",
        data=P + "\n  VAR syncident s1;\n  VAR syncident s2;\n"
        '  PERS tasks tasks{2} := [["T_ROB1"],["T_STN1"]];\n'
        '  PERS wobjdata wStn := [FALSE,FALSE,"STN1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
    ),
    _case(
        "externally guided motion",
        f"{GO_B}\nEGMRunPose egmID1, EGM_STOP_HOLD\\x\\y\\z\\CondTime:=5;\n{GO_A}".replace(
            GO_A, "MoveL Offs(pA,0,0,n), v100, fine, tGrip\\WObj:=wCell;"
        ),
        data=P + "\n  VAR egmident egmID1;\n  VAR num n;",
    ),
    _case(
        "an expression is the frame",
        f"{GO_B}\nMoveL pA, v100, fine, tGrip\\WObj:=wArr{{n}};",
        data=P + "\n  VAR num n := 1;\n  PERS wobjdata wArr{2};",
    ),
    _case(
        "a function's side effect in the zone",
        f"{GO_B}\nMoveL pA, v100, zone(), tGrip\\WObj:=wCell;\nMoveL pA, v100, fine, tGrip\\WObj:=wCell;",
        "  FUNC zonedata zone()\n    PDispSet [[0,0,30],[1,0,0,0]];\n    RETURN z10;\n  ENDFUNC\n",
        data=SWAPPED,
    ),
    _case("compact if sets the frame", f"{GO_B}\nIF diTable = 1 wCell.uframe.trans.x := 300;\n{GO_A}", data=NONE),
    _case(
        "goto passes the displacement",
        f"{GO_B}\nIF diX = 1 GOTO over;\nPDispSet [[0,0,30],[1,0,0,0]];\nover:\n{GO_A}\nPDispOff;\n"
        "MoveL pB, v100, fine, tGrip\\WObj:=wCell;",
    ),
    _case(
        "statements over several lines with comments between",
        "MoveL ! approach ; slowly\n  pA,   ! the part\n  v100, fine,\n  tGrip\n  \\WObj:=wCell;\n"
        "MoveL pB,v100,fine,tGrip\\WObj:=wCell;MoveJ pA,v100,fine,tGrip\\WObj:=wCell;",
        data=BOTH,
    ),
    _case("marks of comments in a string", f'TPWrite "go! ""pA"" ; MoveL pA";\n{GO_A}\n{GO_B}', data=BOTH),
    _case(
        "what changes nothing of the geometry",
        "AccSet 50,50;\nVelSet 80,1000;\nConfL\\On;\nSingArea\\Wrist;\nGripLoad load0;\n"
        "WaitDI diX, 1\\MaxTime:=5;\nSetDO doY, 1;\nPulseDO\\PLength:=0.2, doZ;\nTPErase;\n"
        "WaitTime\\InPos, 0.5;\nStop\\NoRegain;\n"
        "CirPathMode\\PathFrame;\nPathAccLim TRUE\\AccMax:=4, FALSE;\nClkReset ck;\nClkStart ck;\n"
        f"{GO_A}\n{GO_B}",
        data=BOTH + "\n  VAR clock ck;",
    ),
    _case(
        "the tool is the result of a function",
        f"{GO_B}\ntGrip := toolOf(n);\nMoveL pA, v100, fine, tGrip\\WObj:=wCell;",
        "  FUNC tooldata toolOf(num k)\n"
        "    VAR tooldata t := [TRUE,[[0,0,0],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
        "    t.tframe.trans.z := 100*k;\n    RETURN t;\n  ENDFUNC\n",
        data=NONE + "\n  VAR num n := 1;",
    ),
    _case(
        "external offset",
        f"{GO_B}\nEOffsSet [10,0,0,0,0,0];\nMoveAbsJ ⟦{J}⟧, v500, fine, tGrip;\nEOffsOff;\n"
        f"MoveAbsJ ⟨{J}⟩, v500, fine, tGrip;".replace(f"⟦{J}⟧", J),
        data=f"CONST robtarget pB := ⟨{B}⟩;",
    ),
    _case(
        "copies of points", f"pA := pB;\n{GO_A}\npA.trans.z := 300;\n{GO_A}", data=V.replace("⟨", "⟦").replace("⟩", "⟧")
    ),
    _case(
        "an array's element",
        "FOR i FROM 1 TO 2 DO\n  pArr{i}.trans.z := pArr{i}.trans.z + 5;\n"
        "  MoveL pArr{i}, v100, fine, tGrip\\WObj:=wCell;\nENDFOR\n" + GO_B,
        data=f"CONST robtarget pB := ⟨{B}⟩;\n  VAR robtarget pArr{{2}} := [⟦{A}⟧, ⟦{B}⟧];",
    ),
    _case(
        "TEST without DEFAULT sets the displacement",
        f"{GO_B}\nTEST n\nCASE 1,2:\n  PDispSet [[0,0,30],[1,0,0,0]];\nCASE 3:\n  PDispOff;\nENDTEST\n{GO_A}",
        data=NONE + "\n  VAR num n := 1;",
    ),
    _case(
        "the frame of one is the place of another",
        "wCell.oframe.trans := pA.trans;\nMoveL pA, v100, fine, tGrip\\WObj:=wobj0;\n"
        "MoveL pB, v100, fine, tGrip\\WObj:=wobj0;",
    ),
    _case(
        "points of a frame's definition",
        "wCell.uframe := DefFrame(pA, p2, p3);\nMoveL pA, v100, fine, tGrip\\WObj:=wobj0;\n"
        "MoveL pB, v100, fine, tGrip\\WObj:=wobj0;",
        data=P + f"\n  CONST robtarget p2 := ⟦{B}⟧;\n  CONST robtarget p3 := ⟦{A}⟧;",
    ),
    _case(
        "hexadecimal and exponents",
        f"{GO_A}",
        data=f"CONST robtarget pA := ⟨{A.replace('512.5', '5.125E2').replace('-310.2', '-3.102E+02')}⟩;",
    ),
    _case(
        "backward handler",
        f"go;\n{GO_B}",
        "  PROC go()\n    PDispSet [[0,0,30],[1,0,0,0]];\n"
        "    MoveL pA, v100, fine, tGrip\\WObj:=wCell;\n    PDispOff;\n  UNDO\n    PDispOff;\n"
        "  ENDPROC\n",
        data=NONE,
    ),
    _case("soft servo leaves the target's meaning", f"SoftAct 3, 20;\n{GO_A}\nSoftDeact;\n{GO_B}", data=P),
    _case(
        "a relative move by the tool",
        f"MoveL RelTool(pA, 0, 0, -50\\Rx:=10), v100, fine, tGrip\\WObj:=wCell;\n{GO_B}",
        data=BOTH,
    ),
    _case(
        "an unknown instruction gets the frame",
        f"{GO_B}\nVisionFrame wCell;\nMoveL pA, v100, fine, tGrip\\WObj:=wCell;",
        data=NONE,
    ),
    _case(
        "a stationary tool",
        f"{GO_B}\nMoveL pA, v100, fine, tNozzle\\WObj:=wHeld;",
        data=P + "\n"
        "  PERS tooldata tNozzle := [FALSE,[[1000,0,900],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
        '  PERS wobjdata wHeld := [TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
    ),
    _case("confdata counts on a condition", f"IF diX = 1 ConfL\\Off;\n{GO_A}", data=f"CONST robtarget pA := ⟦{A}⟧;"),
    _case("an axis is locked", f"SingArea\\LockAxis4;\n{GO_A}", data=f"CONST robtarget pA := ⟦{A}⟧;"),
    _case(
        "a part of the frame is worked out",
        f"wCell.oframe.trans := [0,0,AInput(aiZ)];\n{GO_A}",
        data=f"CONST robtarget pA := ⟦{A}⟧;",
    ),
    _case(
        "the tool stands in two modules",
        GO_A,
        data=f"CONST robtarget pA := ⟦{A}⟧;",
        other="MODULE Other(SYSMODULE)\n  PERS tooldata tGrip;\nENDMODULE\n",
    ),
    _case(
        "a way off that changes",
        f"nUp := GInput(giN);\nMoveL Offs(pA,0,0,nUp), v100, z5, tGrip\\WObj:=wCell;\n{GO_A}\n{GO_B}",
        data=P + "\n  VAR num nUp := 5;",
    ),
]
