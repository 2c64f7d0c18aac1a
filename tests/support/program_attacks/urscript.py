"""URScripts in which something changes what a target means, each with its control: the same program without that."""

from __future__ import annotations

import re

from program_attacks import Attack

FRAMES = "format: 1\nbases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\n"

HEAD = "set_tcp(p[0, 0, 0.1, 0, 0, 0])\nmovej([0.1, -1.5, 1.5, 0.1, 1.5, 0.2])\n"

P, Q, J = "p[0.4, 0.2, 0.3, 0, 3, 0.1]", "p[0.5, 0.1, 0.2, 0, 3, 0.2]", "[0.2, -1.4, 1.6, 0.1, 1.4, 0.3]"

GO = f"movel(⟦{P}⟧)\n"
POINT = f"p1 = ⟦{P}⟧\n"
BOTH = f"{GO}movej(⟦{J}⟧)\n"

CASES: tuple[tuple[str, str, str], ...] = (
    # Points: « » holds the construct, «attack¦control» where the control has something else there
    ("component", f"{POINT}movel(p1)\n«p1[2] = 0.5\n»movel(p1)\n", "writes a part"),
    ("component of a copy", f"{POINT}«p2 = p1\np2[2] = 0.5\nmovel(p2)\n»movel(p1)\n", "writes a part"),
    ("added to", f"{POINT}movel(p1)\n«movel(pose_add(p1, p[0, 0, 0.1, 0, 0, 0]))\n»", "passes it on"),
    ("subtracted", f"{POINT}movel(p1)\n«d = pose_sub(p1, p[0, 0, 0.1, 0, 0, 0])\n»", "passes it on"),
    ("computed with", f"q1 = ⟦{J}⟧\nmovej(q1)\n«q2 = q1 + q1\n»", "computes"),
    ("indexed", f"q1 = ⟦{J}⟧\nmovej(q1)\n«x = q1[0]\n»", "takes a part"),
    ("indexed in an argument", f"{POINT}movel(p1«, a=p1[2]»)\n", "takes a part"),
    ("compared", f"{POINT}movel(p1)\n«if p1 == get_actual_tcp_pose():\n halt\nend\n»", "computes"),
    ("sent", f'{POINT}movel(p1)\n«socket_send_line(p1, "a")\n»', "passes it on"),
    ("as a string", f"{POINT}movel(p1)\n«s = to_str(p1)\n»", "passes it on"),
    ("rpc", f'{POINT}movel(p1)\n«h = rpc_factory("xmlrpc", "x")\nh.move(p1)\n»', "passes it on"),
    ("run", f"def f(a):\n x = a\nend\n{POINT}movel(p1)\n«run f(p1)\n»", "passes it on"),
    ("register", f"{POINT}movel(p1)\n«write_output_float_register(0, p1[0])\n»", "takes a part"),
    ("forward kinematics", f"q1 = ⟦{J}⟧\nmovej(q1)\n«movel(get_forward_kin(q1))\n»", "passes it on"),
    ("interpolated", f"{POINT}movel(p1)\n«movel(interpolate_pose(p1, {Q}, 0.5))\n»", "passes it on"),
    ("inverted", f"{POINT}movel(p1)\n«x = pose_inv(p1)\n»", "as a frame"),
    ("frame of another", f"{POINT}movel(p1)\n«movel(pose_trans(p1, {Q}))\n»", "as a frame"),
    ("in a frame that is a target", f"p1 = {Q}\n«movel(p1)\n»movel(pose_trans(p1, ⟦{P}⟧))\n", "is a target itself"),
    ("in two frames", f"{POINT}movel(pose_trans({Q}, p1))\n«movel(p1)\n»", "another frame"),
    ("as the tool", f"{POINT}movel(p1)\n«set_tcp(p1)\n»", "as a tool"),
    ("with two tools", f"{POINT}movel(p1)\n«set_tcp(p[0, 0, 0.2, 0, 0, 0])\n»movel(p1)\n", "another tool"),
    ("in a list", f"{POINT}movel(p1)\n«l = [p1, p1]\nmovel(l[i])\n»", "takes a part"),
    ("list by an index", f"l = [⟦{P}⟧, {Q}]\n«movel(l[i])¦movel({P})»\n", ""),
    ("list method", f"l = [⟦{P}⟧]\n«l.append({Q})\nmovel(l[0])¦movel({P})»\n", ""),
    ("member of a structure", f"{POINT}movel(p1)\n«s = struct(a=p1)\nmovel(s.a)\n»", "passes it on"),
    ("member written", f"{POINT}movel(p1)\n«s.a = p1\n»", "puts it"),
    ("assigned in a branch", f"{POINT}movel(p1)\n«if x:\n p1 = {Q}\nend\n»movel(p1)\n", "uses p1"),
    ("one of two", f"{POINT}t = p1\n«if x:\n t = {Q}\nend\nset_tcp(p[0, 0, 0.2, 0, 0, 0])\n»movel(t)\n«movel(t)\n»", ""),
    ("reassigned by a function", f"{POINT}def f():\n global p1 = x\nend\n«if x:\n f()\nend\n»movel(p1)\n", ""),
    ("set by several functions", f"p1 = ⟦{P}⟧\ndef f():\n «p1 = {Q}»\nend\nf()\nmovel(p1)\n", "several functions"),
    ("parameter of the same name", f"def f(p1):\n movel(p1)\nend\n{POINT}f(p1)\n«set_tcp({P})\nf(p1)\n»", "another tool"),
    ("thread writes it", f"{POINT}«thread t():\n p1 = get_actual_tcp_pose()\nend\nrun t()\n»movel(p1)\n", "at any time"),
    ("thread moves there", f"{POINT}«thread t():\n movel(p1)\nend\nrun t()\n»movel(p1)\n", "thread"),
    ("component in a function", f"{POINT}def f():\n «p1[0] = 1¦sync()»\nend\nf()\nmovel(p1)\n", ""),
    ("element computed", f"movel(«p[0.4, 0.2, z, 0, 3, 0.1]¦⟨{P}⟩»)\n", ""),
    ("unary sign", f"x = -1\nmovel(«p[0.4, - 0.2, 0.3, 0, 3, 0.1]¦⟨{P}⟩»)\n", ""),
    ("degrees", f"movej(«[d2r(10), -1.4, 1.6, 0.1, 1.4, 0.3]¦⟨{J}⟩»)\n", ""),
    # Modes
    ("force", f"«force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,5,0,0,0], 2, [1,1,1,1,1,1])\n»{BOTH}", "force_mode"),
    ("force in a branch", f"«if x:\n force_mode(tool_pose(), [], [], 2, [])\nend\n»{BOTH}", ""),
    ("force in a function", f"def f():\n «force_mode(tool_pose(), [], [], 2, [])¦sync()»\nend\nf()\n{BOTH}", "force_mode"),
    ("conveyor", f"«track_conveyor_linear(p[1,0,0,0,0,0], 500)\n»{BOTH}", "conveyor"),
    ("round conveyor", f"«track_conveyor_circular(p[1,0,0,0,0,0], 500, True)\n»{BOTH}", "conveyor"),
    ("path offset", f"«path_offset_enable()\npath_offset_set([0,0,0.1,0,0,0], 1)\n»{BOTH}", "path offset"),
    ("freedrive", f"«freedrive_mode()\nend_freedrive_mode()\n»{GO}", ""),
    ("teach", f"«teach_mode()\nsleep(1)\nend_teach_mode()\n»{GO}", ""),
    ("screw", f"«screw_driving(p[0,0,0,0,0,0], 1, 1, 1)\n»{BOTH}", "screw"),
    ("thread with force", f"«thread t():\n force_mode(tool_pose(), [], [], 2, [])\nend\nrun t()\n»{BOTH}", "at any time"),
    ("interpreter", f"«interpreter_mode()\n»{BOTH}", "from outside"),
    ("unknown function", f"«rq_move()\n»{BOTH}", "no given file"),
    ("unknown function in a condition", f"«if is_ready():\n sync()\nend\n»{BOTH}", "no given file"),
    ("unknown function in an argument", f"«movel({Q}, a=acceleration())\n»{BOTH}", "no given file"),
    ("unknown function that may not run", f"«if x and is_ready():\n sync()\nend\n»{BOTH}", ""),
    ("named by no statement", f"{POINT}movel(p1)\n«movel p1\n»", "names it"),
    ("given to an unknown function", f"{POINT}movel(p1)\n«f(p1)\n»", "passes it on to f"),
    ("put into a pose", f"q1 = ⟦{J}⟧\nmovej(q1)\n«x = p[q1, 1]\n»", "puts it into a pose"),
    ("no statement", f"«@@@\n»{BOTH}", "no statement"),
    ("bare word", f"«movej\n»{BOTH}", "no statement"),
    ("unclosed bracket", f"«x = (1\n»{BOTH}", ""),
    ("unknown block", f"«for i in x:\n sync()\nend\n»{BOTH}", ""),
    ("the language's name", f"«def sync():\n set_tcp({P})\nend\n»sync()\n{BOTH}", "more than once"),
    ("defined twice", f"def f():\n sync()\nend\n«def f():\n set_tcp({Q})\nend\n»f()\n{BOTH}", "more than once"),
    ("calls itself", f"def f():\n if x:\n  «set_tcp({Q})\n  »f()\n end\nend\nf()\n{GO}", ""),
    ("strange keyword", f"movel(⟦{P}⟧«, frame={Q}»)\n", "not known to take"),
    # Tools and frames
    ("tool computed", f"«set_tcp(pose_add(p[0,0,0.1,0,0,0], {Q}))\n»{GO}", "tool"),
    ("tool of an input", f"«t = p[0,0,read_input_float_register(0),0,0,0]\nset_tcp(t)\n»{GO}", "tool"),
    ("tool in a branch", f"«if x:\n set_tcp({Q})\nend\n»{GO}", ""),
    ("tool in a loop", f"while x:\n {GO} «set_tcp({Q})\n»end\n", ""),
    ("tool in a function", f"def f():\n «if x:\n  set_tcp({Q})\n end\n»end\nf()\n{GO}", ""),
    ("tool in a thread", f"«thread t():\n set_tcp({Q})\nend\nrun t()\n»{GO}", "at any time"),
    ("tool of a parameter", f"def f(t):\n set_tcp(t)\nend\nf({Q})\n«f(x)\n»{GO}", "tool"),
    ("tool by a name", f'«set_tcp("welder")\n»{GO}', "tool"),
    ("function with two tools", f"def f():\n movel(⟦{P}⟧)\nend\nf()\n«set_tcp({Q})\nf()\n»", "another tool"),
    (
        "local of the function around it",
        f"def f():\n local p1 = ⟦{P}⟧\n def g():\n  «p1 = x¦sync()»\n end\n g()\n movel(p1)\nend\nf()\n",
        "",
    ),
    ("frame of a camera", f"movel(pose_trans(«get_plane()¦{Q}», ⟦{P}⟧))\n", ""),
    ("frame changed", f"f = {Q}\n«f[0] = x\n»movel(pose_trans(f, ⟦{P}⟧))\n", ""),
    ("frame in a branch", f"f = {Q}\n«if x:\n f = p[1,0,0,0,0,0]\nend\n»movel(pose_trans(f, ⟦{P}⟧))\n", ""),
    ("frame where the arm is", f"movel(pose_trans(«get_actual_tcp_pose()¦{Q}», ⟦{P}⟧))\n", ""),
    # How the arm comes there
    ("joints by speed", f"«speedj([1,0,0,0,0,0], 1, 1)\n»{GO}", ""),
    ("joints to nowhere", f"«movej(x)\n»{GO}", ""),
    ("revolutions", f"«reset_revolution_counter()\n»{GO}", ""),
    ("linear to joints", f"«movej(x)\n»movel(⟦{J}⟧)\n", ""),
    ("joints worked out elsewhere", f"q = get_inverse_kin(⟦{P}⟧)\n«movej({J})\n»movej(q)\n", ""),
    ("qnear of nowhere", f"movej(get_inverse_kin(⟦{P}⟧«, qnear=x»))\n", ""),
    ("two starts", f"{POINT}movej(get_inverse_kin(p1, {J}))\n«movej(get_inverse_kin(p1, [1,-1,1,0,1,0]))\n»", "way of moving"),
    ("own tool of kinematics", f"{POINT}movel(p1)\n«movej(get_inverse_kin(p1, {J}, tcp=p[0,0,0.3,0,0,0]))\n»", "another tool"),
    ("servo to a pose", f"«servoj¦movej»(⟦{P}⟧)\n", "takes joints"),
    ("circle's way without orientation", "movec(⟦p[0.4, 0.2, 0.3, «0, 0, 0¦0, 3, 0.1»]⟧, " f"⟨{Q}⟩)\n", "only its position"),
    ("circle's mode", f"movec(⟦{P}⟧, ⟦{Q}⟧, a=1, v=1, r=0«, mode=1»)\n", "mode"),
    ("too few numbers", "movej(⟦[0.2, -1.4, 1.6, 0.1, 1.4«¦, 0.3»]⟧)\n", "numbers"),
    ("number of no robot", "movej(⟦[0.2, -1.4, 1.6, 0.1, 1.4, «1e9¦0.3»]⟧)\n", "no robot"),
    ("infinite", "movel(⟦p[0.4, 0.2, 0.3, 0, 3, «1e999¦0.3»]⟧)\n", "no robot"),
)  # fmt: skip


def _program(text: str, construct: bool) -> str:
    """A case's program with its construct, or its control without."""
    part = 0 if construct else 1
    return HEAD + re.sub("«(.*?)»", lambda m: (m[1].split("¦") + [""])[part], text, flags=re.DOTALL)


ATTACKS = tuple(Attack(name, {"a.script": _program(text, True)}, FRAMES, why) for name, text, why in CASES)

CONTROLS = tuple(Attack(name, {"a.script": _program(text, False)}, FRAMES) for name, text, _ in CASES)
