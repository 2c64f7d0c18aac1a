"""URScripts by somebody who had not seen the reader: shadowed names, threads, lists, structs, what calls bring along."""

from __future__ import annotations

from program_attacks import Attack

FRAMES = "format: 1\nbases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\n"
START = (
    "  set_tcp(p[0,0,0.12,0,0,0])\n  set_payload(1.5, [0,0,0.04])\n  movej([0.1,-1.5,1.5,0.1,1.5,0.2], a=1.4, v=1.05)\n"
)


def _main(body: str, before: str = "", behind: str = "") -> str:
    lines = "".join(f"  {line}\n" if line else "\n" for line in body.strip("\n").split("\n"))
    return f"{before}def cell():\n{START}{lines}end\n{behind}"


def _case(name: str, body: str, before: str = "", behind: str = "") -> Attack:
    return Attack(name, {"cell.script": _main(body, before, behind)}, FRAMES)


A = "p[-0.512,-0.310,0.420,0.02,3.11,0.01]"
B = "p[-0.640,-0.122,0.355,0.01,3.09,0.03]"
Q = "[0.31,-1.42,1.61,-0.22,1.47,0.35]"
R = "[0.52,-1.31,1.52,-0.12,1.44,0.15]"

ATTACKS = [
    _case(
        "plain moves, all optional arguments by name",
        f"movel(⟨{A}⟩, a=1.2, v=0.25, t=0, r=0.01)\nmovel(a=1.2, v=0.25, pose=⟨{B}⟩)",
    ),
    _case(
        "moves by a function of the same name as the built-in one",
        f"movel(⟦{A}⟧, a=0.3)\nmovej(⟦{Q}⟧)",
        "def movel(target, a=1.2, v=0.25):\n  movep(pose_trans(target, p[0,0,-0.05,0,0,0]), a=a, v=v)\nend\n",
    ),
    _case(
        "set_tcp is somebody's own",
        f"set_tcp(p[0,0,0.3,0,0,0])\nmovel(⟦{A}⟧)",
        'def set_tcp(offset):\n  textmsg("tool ", offset)\nend\n',
    ),
    _case(
        "a tool of inverse kinematics by name",
        f"movej(get_inverse_kin(⟨{A}⟩, tcp=get_tcp_offset()))\n"
        f"movej(get_inverse_kin(⟦{A}⟧, tcp=p[0,0,read_input_float_register(0),0,0,0]))\n"
        f"movej(get_inverse_kin(⟨{B}⟩, qnear=[0.1,-1.5,1.5,0.1,1.5,0.2]))",
    ),
    _case(
        "a local of a function hides the global",
        f"global home = ⟦{Q}⟧\nglobal rest = ⟨{R}⟩\ngo()\nmovej(rest)",
        "def go():\n  local home = get_actual_joint_positions()\n  home[5] = home[5] + 1.57\n  movej(home)\nend\n",
    ),
    _case(
        "a function without local writes the global",
        f"global home = ⟦{Q}⟧\nglobal rest = ⟨{R}⟩\nprepare()\nmovej(home)\nmovej(rest)",
        "def prepare():\n  home = get_actual_joint_positions()\nend\n",
    ),
    _case(
        "a thread changes a waypoint",
        f"global pick = ⟦{A}⟧\nglobal park = ⟨{B}⟩\nwatch = run watcher()\nmovel(pick)\nmovel(park)\nkill watch",
        "thread watcher():\n  while True:\n"
        "    pick = pose_add(pick, p[0, read_input_float_register(0), 0, 0, 0, 0])\n    sync()\n"
        "  end\nend\n",
    ),
    _case(
        "a thread sets the tool",
        f"movel(⟨{B}⟩)\nh = run changer()\nmovel(⟦{A}⟧)\njoin h\nset_tcp(p[0,0,0.12,0,0,0])\nmovel({A})",
        "thread changer():\n  sleep(0.5)\n  set_tcp(p[0,0,0.22,0,0,0])\nend\n",
    ),
    _case(
        "a list of points grows in front",
        f"global path = [⟦{A}⟧, ⟦{B}⟧]\npath.insert(0, get_actual_tcp_pose())\nmovel(path[0])\n"
        f"movel(path[1])\nmovej(⟨{Q}⟩)",
    ),
    _case("a list is sorted out by a method", f"global path = [⟦{A}⟧, ⟦{B}⟧]\npath.remove(0)\nmovel(path[0])"),
    _case(
        "two points change places",
        f"p_a = ⟨{A}⟩\np_b = ⟨{B}⟩\np_c = p_a\np_a = p_b\np_b = p_c\nmovel(p_a)\nmovel(p_b)\nmovel(⟨{A}⟩)",
    ),
    _case(
        "a struct's pose is written by component",
        f"wp = struct(pose=⟦{A}⟧, speed=0.1)\nwp.pose[2] = wp.pose[2] + 0.1\nmovel(wp.pose, v=wp.speed)\nmovel(⟨{B}⟩)",
    ),
    _case(
        "a switch without default sets the tool",
        f"movel(⟨{B}⟩)\nswitch read_input_integer_register(1):\n  case 1:\n"
        "    set_tcp(p[0,0,0.2,0,0,0])\n  end\n  case 2:\n    set_tcp(p[0,0,0.3,0,0,0])\n  end\n"
        f"end\nmovel(⟦{A}⟧)",
    ),
    _case(
        "recursion with another tool at each depth",
        f"step(3)\nset_tcp(p[0,0,0.12,0,0,0])\nmovel(⟨{B}⟩)",
        f"def step(n):\n  if n > 0:\n    movel(⟦{A}⟧)\n    set_tcp(p[0,0,0.1*n,0,0,0])\n    step(n - 1)\n  end\nend\n",
    ),
    _case(
        "interpreter mode brings statements that are not here",
        f"movel(⟨{B}⟩)\ninterpreter_mode(clearQueueOnEnter=True, clearOnEnd=True)\nmovel(⟦{A}⟧)",
    ),
    _case(
        "path offset from a thread",
        f"movel(⟨{B}⟩)\npath_offset_enable()\nrun wobble()\nmovel(⟦{A}⟧)",
        "thread wobble():\n  while True:\n    path_offset_set(p[0,0.01,0,0,0,0], 2)\n    sync()\n  end\nend\n",
    ),
    _case(
        "force mode begun by a function",
        f"movel(⟨{B}⟩)\ncomply()\nmovel(⟦{A}⟧)\nend_force_mode()\nmovel(⟨{A}⟩)",
        "def comply():\n"
        "  force_mode(own_pose(), [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, [0.1,0.1,0.15,0.3,0.3,0.3])\n"
        "end\n"
        "def own_pose():\n  return get_actual_tcp_pose()\nend\n",
    ),
    _case("a pose counts from a frame of the world model", f'movel(convert_pose(⟦{A}⟧, "pallet", "base"))'),
    _case(
        "the pose moves a frame of the world model",
        f'corner = ⟦{A}⟧\nmove_frame("pallet", corner, "base")\nmovel(corner)',
    ),
    _case(
        "a copy is written by component",
        f"p1 = ⟦{A}⟧\np2 = p1\np2[2] = p2[2] + 0.1\nmovel(p2)\nmovel(p1)\nmovel(⟨{B}⟩)",
    ),
    _case("speedj leaves the stance open", f"movel(⟨{B}⟩)\nspeedj([0,0,1.2,0,0,0], 0.5, 4)\nmovej(⟦{A}⟧)"),
    _case(
        "freedrive leaves the stance open",
        f"movej(⟨{B}⟩)\nfreedrive_mode()\nsleep(20)\nend_freedrive_mode()\nmovej(⟦{A}⟧)\nmovej(⟨{Q}⟩)\nmovej(⟨{A}⟩)",
    ),
    _case("degrees by d2r", f"movej([d2r(⟦20⟧), d2r(⟦-80⟧), d2r(⟦90⟧), 0, d2r(⟦85⟧), 0])\nmovej(⟨{Q}⟩)"),
    _case("sums in a joint list", f"movej([⟦0.3⟧+0.1, ⟦-1.4⟧-0.1, ⟦1.5⟧, ⟦-0.2⟧, ⟦1.5⟧*0.9, ⟦0.3⟧])\nmovej(⟨{Q}⟩)"),
    _case("a double minus", "movel(p[-0.5, ⟦--0.3⟧, 0.4, 0, 3.1, 0])\nmovej(⟨" + Q + "⟩)"),
    _case(
        "a function returns the point to several uses",
        f"movel(pose_trans(spot(), p[0,0,-0.1,0,0,0]))\nmovel(spot())\nmovel(⟨{B}⟩)",
        f"def spot():\n  return ⟦{A}⟧\nend\n",
    ),
    _case("names of a tool in quotes", f'set_tcp(p[0,0,0.12,0,0,0], "gripper")\nmovel(⟨{B}⟩)'),
    _case(
        "what changes nothing of the geometry",
        "set_gravity([0,0,9.82])\nset_target_payload(1.2, [0,0,0.05], [0,0,0,0,0,0])\n"
        "set_tool_voltage(24)\nset_standard_digital_out(3, True)\n"
        f'sync()\nsleep(0.2)\ntextmsg("part #1: end ")\nzero_ftsensor()\nmovel(⟨{A}⟩)\nstopl(2)\n'
        f"movel(⟨{B}⟩)",
    ),
    _case(
        "a point's distance is asked for",
        f"spot = ⟦{A}⟧\nif point_dist(spot, get_actual_tcp_pose()) > 0.1:\n  movel(spot)\nend\nmovel(⟨{B}⟩)",
    ),
    _case(
        "a point is sent to another program",
        f'spot = ⟦{A}⟧\ncam = rpc_factory("xmlrpc", "http://127.0.0.1:8000")\n'
        f"spot = cam.refine(spot)\nmovel(spot)\nmovel(⟨{B}⟩)",
    ),
    _case(
        "one pose is tool and target",
        f"both = ⟦{A}⟧\nset_tcp(both)\nmovel(both)\nset_tcp(p[0,0,0.12,0,0,0])\nmovel(⟨{B}⟩)",
    ),
    _case(
        "a tool is changed by a call in an argument",
        f"movel(⟨{B}⟩)\nmovel(⟨{A}⟩, v=fast())\nmovel(⟨{A}⟩)",
        "def fast():\n  set_tcp(p[0,0,0.3,0,0,0])\n  return 0.5\nend\n",
    ),
    _case(
        "a tool is changed behind and",
        f'movel(⟨{B}⟩)\nif get_standard_digital_in(1) and swapped():\n  textmsg("swapped")\nend\nmovel(⟦{A}⟧)',
        "def swapped():\n  set_tcp(p[0,0,0.3,0,0,0])\n  return True\nend\n",
    ),
    _case(
        "the tool's numbers are written one by one",
        f"tool = p[0,0,0.1,0,0,0]\ntool[2] = tool[2] + read_input_float_register(3)\nmovel(⟨{B}⟩)\n"
        f"set_tcp(tool)\nmovel(⟦{A}⟧)",
    ),
    _case(
        "a feature is taken from where the robot is",
        f"feature = get_actual_tcp_pose()\nmovel(pose_trans(feature, ⟦p[0,0.05,-0.1,0,0,0]⟧))\nmovel(⟨{B}⟩)",
    ),
    _case(
        "conveyor tracking from a function",
        f"movel(⟨{B}⟩)\nbelt()\nmovel(⟦{A}⟧)\nstop_conveyor_tracking()\nmovel(⟨{A}⟩)",
        "def belt():\n  track_conveyor_linear(p[0.001,0,0,0,0,0])\nend\n",
    ),
    _case(
        "a global is declared again in a branch",
        f"global spot = ⟦{A}⟧\nif get_standard_digital_in(2):\n"
        "  global spot = p[read_input_float_register(1),-0.3,0.4,0,3.1,0]\nend\nmovel(spot)\n"
        f"movel(⟨{B}⟩)",
    ),
    _case(
        "a parameter hides the global",
        f"global spot = ⟨{B}⟩\nvisit(get_actual_tcp_pose())\nmovel(spot)",
        "def visit(spot):\n  spot[2] = spot[2] + 0.1\n  movel(spot)\nend\n",
    ),
    _case(
        "a default value is the target",
        f"visit()\nvisit(pose_trans(get_actual_tcp_pose(), p[0,0,0.1,0,0,0]))\nmovel(⟨{B}⟩)",
        f"def visit(spot=⟦{A}⟧):\n  spot[2] = spot[2] + 0.05\n  movel(spot)\nend\n",
    ),
    _case(
        "a loop counts a point upwards",
        f"row = ⟦{A}⟧\ni = 0\nwhile i < 4:\n  movel(row)\n  row[1] = row[1] + 0.05\n  i = i + 1\nend\nmovel(⟨{B}⟩)",
    ),
    _case(
        "a loop is left before the tool is set back",
        f"while True:\n  movel(⟦{A}⟧)\n  set_tcp(p[0,0,0.3,0,0,0])\n"
        "  if get_standard_digital_in(1):\n    continue\n  end\n  set_tcp(p[0,0,0.12,0,0,0])\n"
        f"  movel(⟨{B}⟩)\nend",
    ),
    _case(
        "tool and point of one name in two functions",
        f"grip()\nmovel(⟨{B}⟩)",
        f"def grip():\n  local pose = p[0,0,0.12,0,0,0]\n  set_tcp(pose)\n  local spot = ⟨{A}⟩\n  movel(spot)\nend\n",
    ),
    _case(
        "labels of an exported program",
        '$ 1 "Robot Program"\n$ 2 "MoveL"\n$ 3 "Waypoint_1" "breakAfter"\n'
        f'movel(⟨{A}⟩, a=1.2, v=0.25)\n$ 4 "Waypoint_2"\nmovel(⟨{B}⟩, a=1.2, v=0.25)',
    ),
    _case(
        "a waypoint by pose and by stance, one of them written",
        f"global Waypoint_1_p=⟦{A}⟧\nglobal Waypoint_1_q={Q}\n"
        "Waypoint_1_p = pose_trans(Waypoint_1_p, p[0,0,0.02,0,0,0])\n"
        f"movej(get_inverse_kin(Waypoint_1_p, qnear=Waypoint_1_q))\nmovel(⟨{B}⟩)",
    ),
    _case(
        "external axes carry the robot",
        f'movel(⟨{B}⟩)\naxis_group_add("rail", p[0,0,0,0,0,0], "base")\n'
        'axis_group_add_axis("rail", "x", "", p[0,0,0,0,0,0], 1)\nattach_frame("base", "x")\n'
        f"movel(⟦{A}⟧)",
    ),
    _case(
        "a comment that looks like an end of line",
        f"# old: \x0b set_tcp(p[0,0,0.9,0,0,0])\nmovel(⟨{B}⟩) # note \x85 movel({A})",
    ),
    _case(
        "the tool is set in a function that is defined behind its call",
        f"movel(⟨{B}⟩)\nlate()\nmovel(⟦{A}⟧)",
        "",
        "def late():\n  set_tcp(p[0,0,get_analog_in(2),0,0,0])\nend\n",
    ),
    _case(
        "a name differs in its case alone",
        f"Spot = ⟨{A}⟩\nspot = ⟦{B}⟧\nspot[0] = spot[0] - 0.1\nmovel(spot)\nmovel(Spot)",
    ),
    _case(
        "a point is moved and its list is handed on",
        f"spots = [⟦{A}⟧, ⟦{B}⟧]\nn = shift(spots)\nmovel(spots[0])\nmovej(⟨{Q}⟩)",
        "def shift(points):\n  global spots = [points[1], points[0]]\n  return 1\nend\n",
    ),
    _case(
        "another program in the file sets no tool",
        f"movel(⟨{A}⟩)",
        "",
        f"def other():\n  movej({Q})\n  movel(⟦{B}⟧)\nend\n",
    ),
    _case("a text that does not end", f'movel(⟨{B}⟩)\ntextmsg("set)\nset_tcp(p[0,0,0.9,0,0,0])\nmovel(⟦{A}⟧)'),
    _case("a circle that keeps its orientation", f"movec(⟦{A}⟧, ⟦{B}⟧, mode=1)\nmovec(⟨{A}⟩, ⟨{B}⟩)"),
    _case(
        "one function gives back two points",
        f"movel(spot(1))\nmovel(⟨{B}⟩)",
        f"def spot(n):\n  if n == 1:\n    return ⟦{A}⟧\n  end\n  return ⟦{B}⟧\nend\n",
    ),
    _case("a move is the condition of a loop", f"while movel(⟦{A}⟧):\n  set_tcp(p[0,0,0.2,0,0,0])\nend"),
]
