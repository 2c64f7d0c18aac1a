"""Constructs of RAPID that change what a target means, after ABB's reference, each beside plain targets of the same kind."""

from __future__ import annotations

from program_attacks import Attack

ZERO = "[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]"

POSE = f"[[500,10,300],[0,0,1,0],{ZERO}]"

OTHER = f"[[400,20,350],[0,0.6,0.8,0],{ZERO}]"

JOINTS = "[[10,20,30,40,50,60],[9E9,9E9,9E9,9E9,9E9,9E9]]"

DATA = """PERS tooldata t1:=[TRUE,[[10,20,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PERS tooldata t2:=[TRUE,[[0,0,50],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PERS wobjdata w1:=[FALSE,TRUE,"",[[100,0,50],[1,0,0,0]],[[5,6,7],[1,0,0,0]]];
PERS wobjdata w2:=[FALSE,TRUE,"",[[0,300,50],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
VAR num n;
VAR bool b;
VAR pose shift:=[[1,2,3],[1,0,0,0]];
"""

PLAIN = f"PROC plain()\nMoveL ⟨{POSE}⟩,v100,fine,tool0;\nMoveAbsJ ⟨{JOINTS}⟩,v100,fine,tool0;\nENDPROC\n"
"""Controls, in a routine of their own: a controller begins it with all modes as at its start."""


TOOL = "PERS tooldata tB:=[TRUE,[[0,0,9],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"

OBJECT = 'PERS wobjdata wB:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'


def bare(body: str, data: str = "") -> str:
    """A module with a main routine, without more."""
    return f"MODULE a\n{data}PROC main()\n{body}\nENDPROC\nENDMODULE\n"


def program(body: str, data: str = "", more: str = "") -> dict[str, str]:
    """A module with a main routine."""
    return {"a.mod": f"MODULE a\n{DATA}{data}PROC main()\n{body}\nENDPROC\n{PLAIN}{more}ENDMODULE\n"}


def left(name: str, statement: str, why: str = "", more: str = "", data: str = "") -> Attack:
    """A statement behind which a plain target is left."""
    return Attack(name, program(f"{statement}\nMoveL ⟦{POSE}⟧,v100,fine,tool0;", data, more), why=why)


def alone(name: str, statement: str, more: str, data: str = "") -> Attack:
    """A statement that leaves all targets of the program, wherever they stand."""
    body = f"{statement}\nMoveL ⟦{POSE}⟧,v100,fine,tool0;\nMoveAbsJ ⟨{JOINTS}⟩,v100,fine,tool0;"
    return Attack(name, {"a.mod": f"MODULE a\n{DATA}{data}PROC main()\n{body}\nENDPROC\n{more}ENDMODULE\n"})


def followed(name: str, statement: str, more: str = "", data: str = "") -> Attack:
    """A statement that is followed exactly, or is harmless."""
    return Attack(name, program(f"{statement}\nMoveL ⟨{POSE}⟩,v100,fine,tool0;", data, more))


def before(name: str, statement: str, end: str = "") -> Attack:
    """A statement before which a plain target is corrected."""
    body = f"MoveL ⟨{OTHER}⟩,v100,fine,tool0;\n{statement}\nMoveL ⟦{POSE}⟧,v100,fine,tool0;\n{end}"
    return Attack(name, program(body))


def point(name: str, statement: str, why: str = "", more: str = "", kind: str = "CONST", data: str = "") -> Attack:
    """A statement that uses the numbers of a point otherwise; another point beside it is corrected."""
    points = f"{kind} robtarget p1:=⟦{POSE}⟧;\nCONST robtarget p2:=⟨{OTHER}⟩;\nVAR robtarget px;\n{data}"
    return Attack(
        name, program(f"MoveL p1,v100,fine,tool0;\nMoveL p2,v100,fine,tool0;\n{statement}", points, more), why=why
    )


def used(name: str, statement: str, more: str = "", kind: str = "CONST") -> Attack:
    """A use of points that can be followed."""
    points = f"{kind} robtarget p1:=⟨{POSE}⟩;\nCONST robtarget p2:=⟨{OTHER}⟩;\n"
    return Attack(name, program(f"MoveL p1,v100,fine,tool0;\nMoveL p2,v100,fine,tool0;\n{statement}", points, more))


def framed(name: str, statement: str, why: str = "", more: str = "", data: str = "") -> Attack:
    """A statement that changes the tool or the work object of a move behind it; others stay."""
    body = f"{statement}\nMoveL ⟦{POSE}⟧,v100,fine,t1\\WObj:=w1;\nMoveL ⟨{OTHER}⟩,v100,fine,t2\\WObj:=w2;"
    return Attack(name, program(body, data, more), why=why)


def move(name: str, statement: str, why: str = "", data: str = "") -> Attack:
    """A move whose own target is left."""
    return Attack(name, program(statement.format(left=f"⟦{POSE}⟧", joints=f"⟦{JOINTS}⟧"), data), why=why)


def moved(name: str, statement: str) -> Attack:
    """A move whose own targets are corrected."""
    return Attack(name, program(statement.format(good=f"⟨{POSE}⟩", other=f"⟨{OTHER}⟩", joints=f"⟨{JOINTS}⟩")))


MODES = (
    left("a program displacement from the arm's position", f"PDispOn\\ExeP:={OTHER},{OTHER},tool0;", "moves the frame"),
    left("a program displacement from where the arm is", f"PDispOn {OTHER},tool0;", "moves the frame"),
    left("a program displacement that is computed", "PDispSet DefDFrame(p,p,p,p,p,p);", "moves the frame"),
    left("a program displacement that is added", "PDispAdd shift;", "moves the frame"),
    left("a program displacement on one way only", "IF b PDispSet [[0,0,9],[1,0,0,0]];", "moves the frame"),
    left("a program displacement in a loop", "WHILE b DO\nPDispSet [[0,0,9],[1,0,0,0]];\nENDWHILE", "moves the frame"),
    left(
        "a program displacement in a called routine",
        "go;",
        "moves",
        "PROC go()\nPDispOn [[1,2,3],[1,0,0,0]],tool0;\nENDPROC\n",
    ),
    followed("a program displacement that is set plainly", "PDispSet [[0,0,9],[1,0,0,0]];"),
    followed("a program displacement that is over", f"PDispOn {OTHER},tool0;\nPDispOff;"),
    left("an offset of external axes", "EOffsSet [100,0,0,0,0,0];", "external axes"),
    left("an offset of external axes from the position", f"EOffsOn {OTHER};", "external axes"),
    followed("an offset of external axes that is over", f"EOffsOn {OTHER};\nEOffsOff;"),
    Attack(
        "an offset of external axes and a joint target that ignores it",
        program(
            f"EOffsSet [100,0,0,0,0,0];\nMoveAbsJ ⟨{JOINTS}⟩\\NoEOffs,v100,fine,tool0;\nMoveAbsJ ⟦{JOINTS}⟧,v100,fine,tool0;"
        ),
    ),
    left("a wrist with axis 4 locked", "SingArea\\LockAxis4;", "turn the tool"),
    followed("a wrist that passes by singular places", "SingArea\\Wrist;"),
    left("a soft servo", "SoftAct 3,20;", "soft"),
    followed("a servo that is stiff again", "SoftAct 3,20;\nSoftDeact;"),
    left("an independent axis", "IndCMove ROB_1,6,20;", "by itself"),
    left("force control", "FCAct tool0;", "force"),
    followed("force control that is over", "FCAct tool0;\nFCDeact;"),
    left("data that any name writes", 'SetDataVal "w1",n;', "may change"),
    left("all data of a type", 'SetAllDataVal "wobjdata",w2;', "may change"),
    left("another module is loaded", 'Load \\Dynamic,"HOME:/b.mod";', "may change"),
    Attack(
        "a procedure whose name is worked out",
        {"a.mod": bare(f"MoveL ⟨{OTHER}⟩,v100,fine,tool0;\n%name%;\nMoveL ⟦{POSE}⟧,v100,fine,tool0;")},
        why="worked out",
    ),
    Attack(
        "a procedure whose name is data",
        {"a.mod": bare(f"MoveL ⟨{OTHER}⟩,v,z,tool0;\nCallByVar s,3;\nMoveL ⟦{POSE}⟧,v,z,tool0;")},
    ),
    before("a displacement behind a target", "PDispSet [[0,0,9],[1,0,0,0]];\nPDispAdd shift;", "EXIT;"),
    before("a routine that is in no file, behind a target", "goSomewhere;"),
    left("a routine that is in no file", "goSomewhere;", "goSomewhere is in no given file".lower()),
    left("a function that is in no file", "n:=getSomething();", "is in no given file"),
    left("a function that is in no file, in a condition", "IF getSomething()>3 n:=2;", "is in no given file"),
    left("a function that is in no file, in an argument", "WaitTime getSomething();", "is in no given file"),
    left(
        "a function that displaces",
        "n:=f();",
        "moves",
        "FUNC num f()\nPDispOn [[1,2,3],[1,0,0,0]],tool0;\nRETURN 1;\nENDFUNC\n",
    ),
    alone(
        "an interrupt that displaces",
        "CONNECT i WITH tr;\nISignalDI di1,1,i;",
        "TRAP tr\nPDispSet [[1,2,3],[1,0,0,0]];\nENDTRAP\n",
        "VAR intnum i;\n",
    ),
    alone(
        "an error handler that displaces",
        "risky;",
        "PROC risky()\nWaitDI di1,1;\nERROR\nPDispSet [[1,2,3],[1,0,0,0]];\nRETRY;\nENDPROC\n",
    ),
    left(
        "an error between a displacement and its end",
        "outer;",
        "",
        "PROC outer()\ninner;\nERROR\nTRYNEXT;\nENDPROC\n"
        "PROC inner()\nPDispSet [[1,2,3],[1,0,0,0]];\nWaitDI di1,1;\nPDispOff;\nENDPROC\n",
    ),
    left("a jump past the end of a displacement", "PDispSet [[1,2,3],[1,0,0,0]];\nIF b GOTO on;\nPDispOff;\non:"),
    left("a case that displaces", "TEST n\nCASE 1,2:\nPDispSet [[1,2,3],[1,0,0,0]];\nDEFAULT:\nPDispOff;\nENDTEST"),
    left("a statement behind a comment sign in a string", 'TPWrite "!";PDispOn [[1,2,3],[1,0,0,0]],tool0;'),
    left("capital letters", "PDISPON [[1,2,3],[1,0,0,0]],tool0;"),
    left("a statement on several lines", "PDispOn\n  [[1,2,3],[1,0,0,0]]\n  ,tool0\n  ;"),
    followed("a displacement in a comment", "! PDispOn p1,tool0;"),
    followed("a displacement in a string", 'TPWrite "PDispOn p1,tool0;";'),
    followed(
        "plain statements",
        'SetDO do1,1;WaitTime 1;TPWrite "a"+NumToStr(n,0);ConfL\\On;AccSet 50,50;VelSet 50,100;\nGripLoad load0;n:=n+1;Incr n;'
        "\nSet do1;Reset do1;WaitDI di1,1;"
        "PulseDO do1;WaitUntil di1=1 AND n>2;b:=NOT b;ClkReset c;StorePath;RestoPath;MotionSup\\Off;",
    ),
)

POINTS = (
    point("a point that another is computed from", "px:=Offs(p1,0,0,n);\nMoveL px,v100,fine,tool0;", "sets px from it"),
    point("a point that another is set from", "px:=p1;", "sets px from it"),
    point("a component that is read", "n:=p1.trans.x;", "sets n from it"),
    point("a component that is compared", "IF p1.trans.z>3 n:=1;", "computes with it"),
    point("a point that is written by component", "p1.trans.z:=5;", "changes it", kind="VAR"),
    point("a point that is written", "p1:=CRobT();", "changes it", kind="PERS"),
    point("a point that is passed on", "unknownroutine p1;", "passes it on"),
    point("a point that is written by a search", "SearchL di1,p1,p2,v100,tool0;", "changes it", kind="VAR"),
    point(
        "a point in a computation of joints", "j:=CalcJointT(p1,tool0);", "sets j from it", data="VAR jointtarget j;\n"
    ),
    Attack(
        "points in a frame",
        program(
            "MoveL p1,v100,fine,tool0;\nMoveL p2,v100,fine,tool0;\nw2.uframe:=DefFrame(p1,p1,p1);",
            f"CONST robtarget p1:=⟦{POSE}⟧;\nCONST robtarget p2:=⟨{OTHER}⟩;\n",
        ),
    ),
    point("a point a computed way off", "MoveL Offs(p1,0,0,n),v100,fine,tool0;", "works out"),
    point("a point a computed turn off", "MoveL RelTool(p1,0,0,5\\Rz:=n),v100,fine,tool0;", "works out"),
    point("a point with another tool", "MoveL p1,v100,fine,t1;", "another tool"),
    point("a point with another tool in an interrupt", "n:=1;", "another tool", "TRAP tr\nMoveL p1,v,z,t1;\nENDTRAP\n"),
    point(
        "a point with another tool in a routine that nothing calls",
        "n:=1;",
        "another",
        "PROC x()\nMoveL p1,v,z,t1;\nENDPROC\n",
    ),
    point(
        "a point with another tool in an error handler",
        "hop;",
        "another tool",
        "PROC hop()\nWaitDI di1,1;\nERROR\nMoveL p1,v,z,t1;\nRETRY;\nENDPROC\n",
    ),
    point(
        "a point with another tool in an error handler, as a parameter",
        "hop p1;",
        "another tool",
        "PROC hop(robtarget r)\nWaitDI di1,1;\nERROR\nMoveL r,v,z,t1;\nRETRY;\nENDPROC\n",
    ),
    point("a point with another work object", "MoveL p1,v100,fine,tool0\\WObj:=w1;", "another frame"),
    point("a point as a reference", "PDispOn p1,tool0;\nPDispOff;", "computes with it"),
    point("a point that is displayed", 'TPWrite "" \\Pos:=p1.trans;', "computes with it"),
    point(
        "a point that a routine writes",
        "change p1;",
        "changes it",
        "PROC change(INOUT robtarget r)\nr.trans.x:=4;\nENDPROC\n",
        "VAR",
    ),
    point(
        "a point that a routine computes with",
        "above p1;",
        "works out",
        "PROC above(robtarget r)\nMoveL Offs(r,0,0,n),v100,fine,tool0;\nENDPROC\n",
    ),
    point(
        "a point that a routine goes to with its own tool",
        "hop p1;",
        "another tool",
        "PROC hop(robtarget r)\nMoveL r,v100,fine,t1;\nENDPROC\n",
    ),
    point(
        "a point whose copy is changed in part",
        "raised p1;",
        "sets a part of it",
        "PROC raised(robtarget r)\nr.trans.z:=100;\nMoveL r,v100,fine,tool0;\nENDPROC\n",
    ),
    point(
        "a point whose copy is measured",
        "raised p1;",
        "may change it",
        "PROC raised(robtarget r)\nGetDataVal s,r;\nMoveL r,v100,fine,tool0;\nENDPROC\n",
    ),
    point(
        "a point that a function gives back",
        "MoveL same(p1),v100,fine,tool0;",
        "",
        "FUNC robtarget same(robtarget r)\nRETURN r;\nENDFUNC\n",
    ),
    point(
        "a point that a declaration is made from",
        "n:=1;",
        "sets q from it",
        data="CONST robtarget q:=[p1.trans,[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n",
    ),
    Attack(
        "a type with another name",
        program("MoveL p1,v100,fine,tool0;\nP1.Trans.X:=3;", f"ALIAS robtarget place;\nVAR place p1:=⟦{POSE}⟧;\n"),
    ),
    used("two moves on a line", "MoveL p1,v100,fine,tool0; MoveL p2,v100,fine,tool0;"),
    used(
        "a constant way off",
        "MoveL Offs(p1,0,0,100),v100,fine,tool0;MoveJ RelTool(p2,0,0,-50\\Rz:=90),v100,fine,tool0;",
    ),
    used("no way off", "MoveL Offs(p1,0,0,0),v100,fine,tool0;MoveL RelTool(p2,0,0,0\\Rz:=0),v100,fine,tool0;"),
    used("an IF of one line", "IF n>1 AND b MoveL p1,v100,fine,tool0;"),
    used("a routine that goes there", "hop p1;", "PROC hop(robtarget r)\nMoveL r,v100,fine,tool0;\nENDPROC\n"),
    used(
        "a routine with its tool as a parameter",
        "hop p1,tool0\\WObj:=wobj0;\nhop p2,tool0;",
        "PROC hop(robtarget r,PERS tooldata t\\PERS wobjdata WObj)\nMoveL r,v100,fine,t\\WObj?WObj;\nENDPROC\n",
    ),
    used(
        "a routine a constant way off",
        "above p1;",
        "PROC above(robtarget r)\nMoveL Offs(r,0,0,50),v100,fine,tool0;\nENDPROC\n",
    ),
    used(
        "a name worked out from its beginning",
        '%"step"+NumToStr(n,0)%;',
        "PROC step1()\nMoveL p1,v100,fine,tool0;\nENDPROC\n",
    ),
    Attack(
        "elements of an array by a computed index",
        program(
            "MoveL a{1},v100,fine,tool0;\nMoveL a{n},v100,fine,tool0;\nMoveL c{2},v100,fine,tool0;\nMoveL c{1},v100,fine,tool0;",
            f"CONST robtarget a{{2}}:=[⟦{POSE}⟧,⟦{OTHER}⟧];\nCONST robtarget c{{2}}:=[⟨{POSE}⟩,⟨{OTHER}⟩];\n",
        ),
    ),
    Attack(
        "elements of an array in a loop",
        program(
            "FOR i FROM 1 TO 2 DO\nMoveL a{i},v100,fine,tool0;\nENDFOR",
            f"CONST robtarget a{{2}}:=[⟦{POSE}⟧,⟦{OTHER}⟧];\n",
        ),
    ),
    Attack(
        "an element that is written",
        program(
            "MoveL a{1},v100,fine,tool0;\na{n}:=CRobT();\nMoveL a{2},v100,fine,tool0;",
            f"VAR robtarget a{{2}}:=[⟦{POSE}⟧,⟦{OTHER}⟧];\n",
        ),
    ),
    Attack(
        "a loop's name that hides a point",
        program(
            "MoveL p1,v100,fine,tool0;\nFOR p2 FROM 1 TO 3 DO\nMoveL p2,v100,fine,tool0;\nENDFOR",
            f"CONST robtarget p1:=⟨{POSE}⟩;\nCONST robtarget p2:=⟦{OTHER}⟧;\n",
        ),
    ),
    Attack(
        "a parameter that hides a point",
        program(
            f"MoveL p2,v100,fine,tool0;\nhop ⟨{OTHER}⟩;",
            f"CONST robtarget p1:=⟦{POSE}⟧;\nCONST robtarget p2:=⟨{OTHER}⟩;\n",
            "PROC hop(robtarget p1)\nMoveL p1,v100,fine,tool0;\nENDPROC\n",
        ),
    ),
    Attack(
        "a routine's own data that hides a point",
        program(
            "hop;",
            f"CONST robtarget p1:=⟦{POSE}⟧;\n",
            f"PROC hop()\nCONST robtarget p1:=⟨{OTHER}⟩;\nMoveL p1,v100,fine,tool0;\nENDPROC\n",
        ),
    ),
    Attack(
        "a point that is computed once",
        program(
            "px:=CRobT();\nMoveL px,v100,fine,tool0;", f"VAR robtarget px:=⟦{POSE}⟧;\nCONST robtarget py:=⟦{OTHER}⟧;\n"
        ),
    ),
    Attack(
        "a joint target that is computed with",
        program(
            "MoveAbsJ j1,v100,fine,tool0;\nMoveAbsJ j2,v100,fine,tool0;\nn:=j1.robax.rax_1;",
            f"CONST jointtarget j1:=⟦{JOINTS}⟧;\nCONST jointtarget j2:=⟨{JOINTS}⟩;\n",
        ),
        why="sets n from it",
    ),
)

FRAMES = (
    framed("a work object that another is copied to", "IF b w1:=w2;", "changes it"),
    framed("a work object by component, on one way", "IF b w1.uframe.trans.z:=9;", "changes it"),
    framed("a work object by component, computed", "w1.uframe.trans.z:=n;", "w1"),
    framed("a work object that is computed", "w1.oframe:=DefFrame(CRobT(),CRobT(),CRobT());", "works it out"),
    framed("a tool that is measured", "MToolTCPCalib j,j,j,j,t1,n,n;", "change it", data="VAR jointtarget j;\n"),
    framed("a tool that is computed", "t1.tframe.trans.z:=n+1;", "t1"),
    framed("a tool that is held by no robot", "t1.robhold:=FALSE;", "not held"),
    framed("a work object that the robot holds", "w1.robhold:=TRUE;", "held by the robot"),
    framed("a user frame that a unit moves", "w1.ufprog:=FALSE;", "mechanical unit"),
    framed("a work object on a conveyor", "WaitWObj w1\\RelDist:=20;", "change"),
    framed("data that is read by name", 'GetDataVal "w",w1;', "change"),
    framed("a text that is turned into a frame", 'b:=StrToVal("[]",w1);', "change"),
    framed(
        "a frame that a routine changes",
        "turn w1;",
        "changes it",
        "PROC turn(PERS wobjdata w)\nw.uframe.trans.x:=n;\nENDPROC\n",
    ),
    framed(
        "a frame that a routine of a routine changes",
        "one w1;",
        "w1",
        "PROC one(PERS wobjdata w)\ntwo w;\nENDPROC\nPROC two(PERS wobjdata w)\nw:=wobjs{n};\nENDPROC\n",
    ),
    framed("a frame that an interrupt changes", "n:=1;", "", "TRAP tr\nw1.uframe.trans.x:=9;\nENDTRAP\n"),
    framed("a frame that is left changed", "n:=1;", "changes it", "PROC later()\nw1.uframe.trans.x:=9;\nENDPROC\n"),
    Attack(
        "a tool that stands in the cell",
        program(
            f"MoveL ⟦{POSE}⟧,v100,fine,tf\\WObj:=w1;",
            "PERS tooldata tf:=[FALSE,[[0,0,1],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n",
        ),
        why="not held",
    ),
    Attack(
        "a work object that is moved",
        program(
            f"MoveL ⟦{POSE}⟧,v100,fine,tool0\\WObj:=wf;",
            'PERS wobjdata wf:=[FALSE,FALSE,"STN1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n',
        ),
        why="mechanical unit",
    ),
    Attack("a tool of no file", program(f"MoveL ⟦{POSE}⟧,v100,fine,tGun;"), why="tGun is not in the program"),
    Attack(
        "a work object of no file",
        program(f"MoveL ⟦{POSE}⟧,v100,fine,tool0\\WObj:=wA;"),
        why="wA is not in the program",
    ),
    Attack(
        "frames that the user states",
        program(f"MoveL ⟨{POSE}⟩,v100,fine,tGun\\WObj:=wA;"),
        "format: 1\nbases: {wA: {xyz: [1, 0, 0]}}\ntools: {tgun: {xyz: [0, 0, 0.1]}}\n",
    ),
    Attack(
        "a routine that the user states as harmless",
        program(f"grip 5;\nMoveL ⟨{POSE}⟩,v100,fine,t1\\WObj:=w1;"),
        "format: 1\nharmless: [Grip]\n",
    ),
    Attack(
        "a tool of numbers that are worked out",
        program(
            f"MoveL ⟦{POSE}⟧,v100,fine,tn;",
            "PERS tooldata tn:=[TRUE,[[0,0,n],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n",
        ),
    ),
    Attack(
        "frames set plainly in a routine, one after another",
        program(
            f"w1.uframe:=[[1,2,3],[1,0,0,0]];\nMoveL ⟨{POSE}⟩,v100,fine,t1\\WObj:=w1;\nw1.uframe:=[[4,5,6],[1,0,0,0]];"
            f"\nMoveL ⟨{OTHER}⟩,v100,fine,t1\\WObj:=w1;"
        ),
    ),
    Attack(
        "data of another module",
        {
            "a.mod": bare(f"MoveL ⟨{POSE}⟩,v100,fine,tB\\WObj:=wB;\nMoveL pB,v100,fine,tool0;"),
            "b.sys": f"MODULE b(SYSMODULE)\nTASK {TOOL}{OBJECT}CONST robtarget pB:=⟨{OTHER}⟩;\nENDMODULE\n",
        },
    ),
    Attack(
        "local data of another module",
        {
            "a.mod": f"MODULE a\nPROC main()\nMoveL ⟦{POSE}⟧,v100,fine,tB;\nENDPROC\nENDMODULE\n",
            "b.sys": f"MODULE b(SYSMODULE)\nLOCAL {TOOL}ENDMODULE\n",
        },
        why="tB is not in the program",
    ),
    Attack(
        "data that two modules declare",
        {
            "a.mod": f"MODULE a\nCONST robtarget p1:=⟦{POSE}⟧;\nPROC main()\nMoveL p1,v100,fine,tool0;\nENDPROC\nENDMODULE\n",
            "b.mod": f"MODULE b\nCONST robtarget P1:=⟦{OTHER}⟧;\nENDMODULE\n",
        },
        why="declare it",
    ),
    Attack(
        "a routine that two modules declare",
        {
            "a.mod": f"MODULE a\nPROC main()\nprep;\nMoveL ⟦{POSE}⟧,v100,fine,tool0;\nENDPROC\nPROC prep()\nENDPROC\nENDMODULE\n",
            "b.mod": "MODULE b\nPROC main2()\nprep;\nENDPROC\nPROC PREP()\nPDispOn p,tool0;\nENDPROC\nENDMODULE\n",
        },
    ),
    Attack(
        "another module that changes a frame",
        {
            "a.mod": bare(f"MoveL ⟦{POSE}⟧,v100,fine,t1\\WObj:=w1;\nMoveL ⟨{OTHER}⟩,v100,fine,t1\\WObj:=w2;", DATA),
            "b.mod": "MODULE b\nPROC other()\nw1.oframe:=[[1,1,1],[1,0,0,0]];\nENDPROC\nENDMODULE\n",
        },
        why="changes it",
    ),
    Attack(
        "a routine of the program with the name of an instruction",
        program(
            f"MoveL p1,v100,fine,tool0;\nSetDO do1,1;\nMoveJ ⟦{POSE}⟧,v100,fine,tool0;\nPDispOff;",
            f"CONST robtarget p1:=⟨{OTHER}⟩;\n",
            "PROC SetDO(string d,num v)\nPDispOn [[1,2,3],[1,0,0,0]],tool0;\nENDPROC\n",
        ),
    ),
)

MOVES = (
    move("path corrections", "MoveL {left},v100,fine,tool0\\Corr;", "Corr"),
    move("seam tracking", "ArcL {left},v100,sm1,wd1,fine,tool0\\Track:=tr1;", "track"),
    move("an option that is not known", "MoveL {left},v100,fine,tool0\\Foo;", "foo"),
    Attack("a tool of an array", program(f"MoveL ⟦{POSE}⟧,v100,fine,ts{{n}};", "PERS tooldata ts{2};\n")),
    move("a move without a tool", "MoveL {left},v100,fine;", "other arguments"),
    move("a force-controlled move", "FCPressL {left},v100,20,fine,tool0;", "force"),
    move("a move that a sensor corrects", "EGMMoveL e1,{left},v100,fine,tool0;", "sensor"),
    move("external axes alone", "MoveExtJ {joints},v100,fine;", "external axes alone"),
    move("a joint target in a linear move", "MoveL {joints},v100,fine,tool0;"),
    Attack(
        "a missing semicolon",
        {"a.mod": bare(f"MoveL ⟦{POSE}⟧,v100,fine,tool0\nIF b THEN\nMoveL ⟦{OTHER}⟧,v100,fine,tool0;\nENDIF")},
        why="is not understood",
    ),
    moved("circles", "MoveC {good},{other},v100,fine,tool0;"),
    moved("arc welding", "ArcLStart {good},v100,sm1,wd1,fine,tool0;\nArcL {other},v100,sm1,wd1\\Weave:=wv1,z1,tool0;"),
    moved(
        "arc welding on circles",
        "ArcC {good},{other},v100,sm1,wd1,z1,tool0\\WObj:=wobj0;\nArcCEnd {good},{other},v100,sm1,wd1,fine,tool0;",
    ),
    moved(
        "arc welding of the first controllers",
        "ArcL\\On,{good},v100,sm1,wd1,wv1,z1,tool0;\nArcL\\Off,{other},v100,sm1,wd1,wv1,fine,tool0;",
    ),
    moved("spots and nuts", "SpotL {good},v100,gun1,spot1,tool0;\nNutJ {other},v100,nut1\\InPos,gun1,tool0;"),
    moved("glue", "DispL\\On,{good},v100,bead1,z1,tool0;\nPaintL {other},v100,z1,tool0;"),
    moved(
        "searches",
        "SearchL\\Stop,di1,px,{good},v100,tool0;\nSearchC di1\\Flanks,px,{good},{other},v100,tool0\\WObj:=wobj0;",
    ),
    moved(
        "triggers",
        "TriggL {good},v100,tr1\\T2:=tr2,z1,tool0;\nTriggC {good},{other},v100,tr1,z1,tool0;\nTriggJ {good},v100,tr1,z1,tool0;",
    ),
    moved("trigger lists", "TriggLIOs {good},v100\\TriggData1:=a,z1,tool0\\WObj:=wobj0;"),
    moved(
        "moves with signals", "MoveLDO {good},v100,z1,tool0,do1,1;\nMoveJDO {other},v100,z1,tool0\\WObj:=wobj0,do1,1;"
    ),
    moved("moves with procedures", 'MoveLSync {good},v100,z1,tool0,"plain";'),
    moved(
        "options",
        "MoveL\\Conc,{good}\\ID:=10,v100\\V:=50\\T:=3,z1\\Z:=2\\Inpos:=inpos50,tool0\\WObj:=wobj0\\TLoad:=load0;",
    ),
    moved("joint targets", "MoveAbsJ\\Conc,{joints}\\NoEOffs,v100,fine,tool0\\WObj:=wobj0;"),
)

ATTACKS: tuple[Attack, ...] = (*MODES, *POINTS, *FRAMES, *MOVES)
