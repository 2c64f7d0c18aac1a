"""URScript: constructs of the script manual, and of programs by hand, that change what a target means."""

from __future__ import annotations

from dataclasses import replace

from program_twins import twins

from program_attacks import Attack

BASE = "format: 1\nbases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 3.141592653589793]}}\n"

HEAD = """def prog():
  set_tcp(p[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
  movej(⟨[0.1, -1.2, 1.4, -1.5, -1.57, 0.2]⟩, a=1.2, v=0.5)
"""

LONE = (
    HEAD
    + """  §
  movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧, a=1.2, v=0.25)
end
"""
)
"""A trap between a joint target and a pose."""


def lone(name: str, trap: str, plain: str = "", before: str = "", why: str = "") -> tuple[Attack, Attack]:
    """A trap between a joint target and a pose; functions that it calls stand before the program's first line."""
    text = LONE.replace("def prog():\n", f"def prog():\n{before}")
    return twins(name, {"p.script": text}, trap, plain, why=why)


def body(name: str, text: str, trap: str | tuple[str, ...], plain: str | tuple[str, ...] = "") -> tuple[Attack, Attack]:
    """A program's lines behind the first joint target."""
    return twins(name, {"p.script": f"{HEAD}{text}\nend\n"}, trap, plain)


STATE = (
    *lone(
        "the tool's length comes from a register",
        "set_tcp(p[0, 0, read_input_float_register(3), 0, 0, 0])",
        "set_tcp(p[0, 0, 0.12, 0, 0, 0])",
    ),
    *lone("the tool is where the arm happens to be", "set_tcp(get_target_tcp_pose())", "get_target_tcp_pose()"),
    *lone(
        "the tool is a variable that a socket has filled",
        "    answer = socket_read_ascii_float(6)\n  set_tcp(p[answer[1], answer[2], answer[3], 0, 0, 0])",
        "    answer = socket_read_ascii_float(6)",
    ),
    *lone(
        "a linear conveyor is followed",
        "track_conveyor_linear(p[1, 0, 0, 0, 0, 0], 500.0)",
        "set_conveyor_tick_count(0, 0)",
    ),
    *lone("a turntable is followed", "track_conveyor_circular(p[0.5, 0.5, 0, 0, 0, 0], 500.0, False)"),
    *lone(
        "an offset is added to the path",
        "path_offset_enable()\n  path_offset_set(p[0, 0, 0.01, 0, 0, 0], 2)",
        "set_standard_digital_out(2, True)",
    ),
    *lone("a function that no file has may set the tool", "rq_open_and_wait()", "set_tool_digital_out(0, True)"),
    *lone(
        "a function sets the tool if an input is on",
        "pick()",
        "sync()",
        "  def pick():\n    if get_standard_digital_in(1):\n      set_tcp(p[0, 0, 0.2, 0, 0, 0])\n    end\n  end\n",
    ),
    *lone(
        "one branch sets another tool",
        "if get_standard_digital_in(0):\n    set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  else:\n"
        "    set_tcp(p[0, 0, 0.2, 0, 0, 0])\n  end",
        "if get_standard_digital_in(0):\n    set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  else:\n"
        "    set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  end",
    ),
    *lone(
        "an elif without else may set another tool",
        "if get_standard_digital_in(0):\n    set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  elif get_standard_digital_in(1):\n"
        "    set_tcp(p[0, 0, 0.2, 0, 0, 0])\n  end",
        "if get_standard_digital_in(0):\n    sleep(0.1)\n  elif get_standard_digital_in(1):\n    sleep(0.2)\n  end",
    ),
    *lone(
        "a thread sets the tool",
        "watcher = run watch()",
        "sync()",
        "  thread watch():\n    while (True):\n      if get_standard_digital_in(3):\n        set_tcp(p[0, 0, 0.2, 0, 0, 0])\n"
        "      end\n      sync()\n    end\n  end\n",
    ),
    *lone(
        "a component of the tool's pose is read from an input",
        "flange_tool[2] = read_input_float_register(0)\n  set_tcp(flange_tool)",
        "set_tcp(flange_tool)",
        "  flange_tool = p[0, 0, 0.1, 0, 0, 0]\n",
    ),
    *lone(
        "a function changes the global that the tool is taken from",
        "teach()\n  set_tcp(flange_tool)",
        "set_tcp(flange_tool)",
        "  global flange_tool = p[0, 0, 0.1, 0, 0, 0]\n  def teach():\n    flange_tool = get_actual_tcp_pose()\n  end\n",
    ),
    *lone(
        "a loop of unknown length sets the tool in its last pass",
        "while get_standard_digital_in(0):\n    set_tcp(p[0, 0, 0.2, 0, 0, 0])\n    sync()\n  end",
        "while get_standard_digital_in(0):\n    sync()\n  end",
    ),
    *lone(
        "the tool is set before a break out of a loop",
        "while (True):\n    if get_standard_digital_in(0):\n      set_tcp(p[0, 0, 0.3, 0, 0, 0])\n      break\n    end\n"
        "    if get_standard_digital_in(1):\n      break\n    end\n    sync()\n  end",
        "while (True):\n    if get_standard_digital_in(0):\n      break\n    end\n    sync()\n  end",
    ),
    *lone(
        "a function called as an argument sets the tool",
        "sleep(heavy())",
        "sleep(0.5)",
        "  def heavy():\n    set_tcp(p[0, 0, read_input_float_register(1), 0, 0, 0])\n    return 0.5\n  end\n",
    ),
    *lone(
        "a condition's function sets the tool",
        "if heavy():\n    sleep(0.5)\n  end",
        "if get_standard_digital_in(2):\n    sleep(0.5)\n  end",
        "  def heavy():\n    set_tcp(get_target_tcp_pose())\n    return True\n  end\n",
    ),
    *lone(
        "two statements stand on one line",
        "sleep(0.1); set_tcp(p[0, 0, read_input_float_register(1), 0, 0, 0])",
        "sleep(0.1)",
    ),
)

POINTS = (
    *body(
        "one point with two tools",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(p1)\n  §\n  movel(p1)",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "set_tcp(p[0, 0, 0.1, 0, 0, 0])",
    ),
    *body(
        "a loop's end sets another tool for its next pass",
        "  i = 0\n  while i < 2:\n    movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)\n    §\n    i = i + 1\n  end",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    ),
    *body(
        "a function is called with two tools",
        "  def place():\n    movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)\n  end\n  place()\n  §\n  place()",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "set_standard_digital_out(1, False)",
    ),
    *body(
        "a function calls itself with another tool",
        "  def down(n):\n    movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)\n    if n > 0:\n      §\n      down(n - 1)\n"
        "    end\n  end\n  down(1)",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    ),
    *body(
        "a component is written by what a register says",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  §\n  movel(p1)",
        "p1[2] = read_input_float_register(0)",
        "sleep(0.1)",
    ),
    *body(
        "a component is raised again and again",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  i = 0\n  while i < 4:\n    movel(p1)\n    §\n    i = i + 1\n  end",
        "p1[2] = p1[2] + 0.02",
        "sleep(0.1)",
    ),
    *body(
        "a copy is changed, and both are targets",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(p1)\n  §",
        "p2 = p1\n  p2[2] = p1[2] + read_input_float_register(0)\n  movel(p2)",
        "movel(p1)",
    ),
    *body(
        "a point is also the origin of another",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(p1)\n  §",
        "movel(pose_trans(p1, p[0, 0, -0.001 * read_input_integer_register(0), 0, 0, 0]))",
        "movel(p1)",
    ),
    *body(
        "a point is mixed with another",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  p2 = p⟦[0.5, 0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(p1)\n  §\n"
        "  movel(p2)",
        "movel(interpolate_pose(p1, p2, 0.5))",
        "sleep(0.1)",
    ),
    *body(
        "a point's distance decides",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  §\n    movel(p1)\n  end",
        "if pose_dist(get_actual_tcp_pose(), p1) < 0.1:",
        "if get_standard_digital_in(0):",
    ),
    *body(
        "a point's component decides",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  §\n    movel(p1)\n  end",
        "if p1[2] > 0.35:",
        "if get_standard_digital_in(0):",
    ),
    *body(
        "a point is the tool as well",
        "  p1 = p⟦[0.1, 0.0, 0.4, 0.0, 0.0, 0.1]⟧\n  movel(p1)\n  §",
        "set_tcp(p1)",
        "movel(p1)",
    ),
    *body(
        "a point is the feature of another as well",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(p1)\n  §",
        "movel(pose_trans(pose_inv(p1), get_actual_tcp_pose()))",
        "movel(p1)",
    ),
    *body(
        "a point is told to a partner that works with it",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(p1)\n  §",
        'camera = rpc_factory("xmlrpc", "http://127.0.0.1:8000")\n  p2 = camera.seen_from(p1)\n  movel(p2)',
        "movel(p1)",
    ),
    *body(
        "joints are turned by one of them",
        "  q = ⟦[0.2, -1.2, 1.4, -1.5, -1.57, 0.2]⟧\n  §\n  movej(q)",
        "q[5] = q[5] + d2r(90)",
        "sleep(0.1)",
    ),
    *body(
        "joints are a target and the start of a computed pose",
        "  q = ⟦[0.2, -1.2, 1.4, -1.5, -1.57, 0.2]⟧\n  movej(q)\n  §",
        "movel(pose_trans(get_forward_kin(q), p[0, 0, -0.1, 0, 0, 0]))",
        "movej(q)",
    ),
    *body(
        "a pose is turned into joints of which one is changed",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(p1)\n  §",
        "q = get_inverse_kin(p1)\n  q[5] = q[5] + 1.5708\n  movej(q)",
        "movel(p1)",
    ),
    *body(
        "a step from where the arm is",
        "  §p⟦[0.4, 0.1, 0.35, 2.2, -2.2, 0.1]⟧§",
        ("movel(pose_add(get_actual_tcp_pose(), ", "))"),
        ("movel(", ")"),
    ),
    *body(
        "a step in the tool's frame",
        "  §p⟦[0.4, 0.1, 0.35, 2.2, -2.2, 0.1]⟧§",
        ("movel(pose_trans(get_target_tcp_pose(), ", "))"),
        ("movel(", ", a=0.3)"),
    ),
    *body(
        "a feature that a camera gives",
        "  §\n  movel(§p⟦[0.4, 0.1, 0.35, 2.2, -2.2, 0.1]⟧§",
        ("feature = camera_pose()", "pose_trans(feature, ", "))"),
        ("sleep(0.1)", "", ")"),
    ),
    *body(
        "a feature moves on in a loop",
        "  feature = p[0.1, 0, 0, 0, 0, 0]\n  i = 0\n  while i < 3:\n"
        "    movel(pose_trans(feature, p⟦[0.4, 0.1, 0.35, 2.2, -2.2, 0.1]⟧))\n"
        "    §\n    i = i + 1\n  end",
        "feature[0] = feature[0] + 0.05",
        "sleep(0.1)",
    ),
    *body(
        "a function sets the feature anew",
        "  global feature = p[0.1, 0, 0, 0, 0, 0]\n  def teach():\n    feature = get_actual_tcp_pose()\n  end\n  §\n"
        "  movel(pose_trans(feature, p⟦[0.4, 0.1, 0.35, 2.2, -2.2, 0.1]⟧))",
        "teach()",
        "sleep(0.1)",
    ),
    *body(
        "one literal in the features of two calls",
        "  def go(f):\n    movel(pose_trans(f, p⟦[0.4, 0.1, 0.35, 2.2, -2.2, 0.1]⟧))\n  end\n  go(p[0.1, 0, 0, 0, 0, 0])\n  §",
        "go(p[0.2, 0, 0, 0, 0, 0])",
        "go(p[0.1, 0, 0, 0, 0, 0])",
    ),
    *body(
        "a coordinate is worked out",
        "  dx = read_input_float_register(0)\n  movel(p⟦[0.4§, 0.1, 0.35, 2.2, -2.2, 0.1]⟧)",
        " + dx",
    ),
    *body(
        "a way off grows in a loop",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  i = 0\n  while i < 5:\n    §\n    i = i + 1\n  end",
        "movel(pose_trans(p1, p[0, 0, 0.01 * i, 0, 0, 0]))",
        "movel(p1)",
    ),
    *body(
        "points of a list with two tools, by a number that counts",
        "  ps = [p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧, p⟦[0.5, -0.2, 0.35, 2.2, -2.2, 0.1]⟧]\n  i = 0\n  while i < 2:\n"
        "    set_tcp(p[0, 0, 0.1, 0, 0, 0])\n    movel(ps[i])\n    set_tcp(p[0, 0, 0.2, 0, 0, 0])\n    movel(ps[i])\n"
        "    i = i + 1\n  end§",
        "\n  sleep(0.1)",
        "\n  sleep(0.1)",
    )[:1],
    *body(
        "a point is put together from a coordinate that two points have",
        "  x = ⟦0.5⟧\n  movel(p[x, -0.3, 0.35, 2.2, -2.2, 0.1])\n  movel(p[x, 0.3, 0.35, 2.2, -2.2, 0.1])§",
        "",
    )[:1],
    *body(
        "a point is overwritten by where the arm is before any move",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  §\n  movel(p1)",
        "p1 = get_actual_tcp_pose()",
        "sleep(0.1)",
    ),
    *body(
        "a parameter hides the point of the same name",
        "  global p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  def go(§):\n    movel(p1)\n  end\n  go(§)",
        ("p1", "get_actual_tcp_pose()"),
        ("", ""),
    ),
    *body(
        "a local hides the global of the same name",
        "  global p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  def go():\n    §\n    movel(p1)\n  end\n  go()",
        "local p1 = get_actual_tcp_pose()",
        "sleep(0.1)",
    ),
    *body(
        "a function writes a component of the global",
        "  global p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  def shift():\n    §\n  end\n  shift()\n  movel(p1)",
        "p1[0] = p1[0] + read_input_float_register(0)",
        "sleep(0.1)",
    ),
    *body(
        "names that differ in case",
        "  P1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  §1 = get_actual_tcp_pose()\n  movel(§1)",
        ("p", "p"),
        ("q", "P"),
    ),
    *body(
        "a point is assigned after the move that has its name",
        "  §\n  movel(p1)\n  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧§",
        ("p1 = get_actual_tcp_pose()", ""),
        ("p1 = get_actual_tcp_pose()", "\n  movel(p1)"),
    ),
    *body(
        "five joints",
        "  movej([§⟦-1.2, 1.4, -1.5, -1.57, 0.2⟧])",
        "",
        "0.1, ",
    ),
    *body(
        "a computed joint",
        "  movej(⟦[0.1, -1.2, 1.4, -1.5§, -1.57, 0.2]⟧)",
        " + 0.001 * read_input_integer_register(0)",
    ),
    *body(
        "a point is passed by a call in which it is moved off by what an input says",
        "  p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  def over(where):\n"
        "    where[2] = where[2] + read_input_float_register(0)\n"
        "    movel(where)\n  end\n  §\n  movel(p1)",
        "over(p1)",
        "sleep(0.1)",
    ),
    *body(
        "a thread changes the point that is moved to",
        "  global p1 = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  thread seen():\n    while (True):\n      §\n"
        "      sync()\n    end\n  end\n  run seen()\n  sleep(1.0)\n  movel(p1)",
        "p1[0] = read_input_float_register(0)",
        "n = read_input_float_register(0)",
    ),
    *body(
        "a text that looks like a move, and a move that looks like a comment",
        "  §movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)§",
        ('textmsg("', '")'),
        ('textmsg("# not a comment")\n  ', "  # textmsg("),
    ),
    *body("a move in a comment", "  §movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)", "# ", ""),
    *body(
        "a number that is none",
        "  movel(p⟦[§, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)",
        "1e999",
        "5.0e-1",
    ),
    *body(
        "a tool that only the controller's installation knows, chosen by a function of another file",
        "  §\n  movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)",
        "set_gripper_tcp(2)",
        "set_tcp(p[0, 0, 0.1, 0, 0, 0])",
    ),
    *body(
        "a world model's frame that moves with what it is attached to",
        "  §\n  movel(§p⟦[0.4, 0.1, 0.35, 2.2, -2.2, 0.1]⟧§)",
        ('table = get_pose("table", "base")', "pose_trans(table, ", ")"),
        ("sleep(0.1)", "", ""),
    ),
    *body(
        "a palette's corner counts the others",
        "  corner = p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧\n  movel(corner)\n  n = 0\n  while n < 6:\n    §\n"
        "    n = n + 1\n  end",
        "movel(p[corner[0] + 0.05 * n, corner[1], corner[2], corner[3], corner[4], corner[5]])",
        "movel(corner)",
    ),
    *body(
        "a tool is set by a function whose definition stands below its call",
        "  go()\n  def go():\n    §\n    movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)\n  end",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    )[:1],
)

REACHES_NOTHING = (
    Attack(
        "control: what stands behind a return is never run",
        {
            "p.script": "def prog():\n  def off():\n    return 1\n    set_tcp(get_actual_tcp_pose())\n  end\n"
            "  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  movej(⟨[0.1, -1.2, 1.4, -1.5, -1.57, 0.2]⟩)\n  n = off()\n"
            "  movel(p⟨[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟩)\nend\n"
        },
    ),
    Attack(
        "control: a tool is set in a text only",
        {
            "p.script": "def prog():\r\n\tset_tcp(p[0, 0, 0.1, 0, 0, 0])\r\n\tmovej(⟨[0.1, -1.2, 1.4, -1.5, -1.57, 0.2]⟩)\r\n"
            '\ttextmsg("set_tcp(get_actual_tcp_pose()); # ")\r\n\tpopup("Größe", "set_tcp", False, False, blocking=True)\r\n'
            "\tmovel(p⟨[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟩)\r\nend\r\n"
        },
    ),
    Attack(
        "control: a thread that switches a lamp",
        {
            "p.script": "def prog():\n  thread lamp():\n    while (True):\n      set_standard_digital_out(0, True)\n"
            "      sleep(0.5)\n"
            "      set_standard_digital_out(0, False)\n      sleep(0.5)\n    end\n  end\n  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n"
            "  t = run lamp()\n  movej(⟨[0.1, -1.2, 1.4, -1.5, -1.57, 0.2]⟩)\n  movel(p⟨[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟩)\n"
            "  kill t\nend\n"
        },
    ),
    Attack(
        "control: a tool that is set again plainly behind what is not known",
        {
            "p.script": "def prog():\n  set_tcp(get_actual_tcp_pose())\n  movej(⟨[0.1, -1.2, 1.4, -1.5, -1.57, 0.2]⟩)\n"
            "  movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)\n  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n"
            "  movej(⟨[0.1, -1.2, 1.4, -1.5, -1.5, 0.2]⟩)\n  movel(p⟨[0.5, -0.2, 0.35, 2.2, -2.2, 0.1]⟩)\nend\n"
        },
    ),
)

GRID = [(0.45 + 0.02 * (k % 4), -0.2 + 0.05 * (k // 4), 0.3 + 0.01 * (k % 3)) for k in range(14)]
"""Places of plain programs, [m]."""

TURN = "2.2214, -2.2214, 0.0"


def poses(count: int, digits: int) -> list[str]:
    """Poses with marks around their numbers."""
    return [f"p⟨[{', '.join(f'{v:.{digits}f}' for v in xyz)}, {TURN}]⟩" for xyz in GRID[:count]]


def stances(count: int) -> list[str]:
    """Joint targets with marks around their numbers."""
    return [f"⟨[{0.1 * k - 0.3:.4f}, -1.2000, 1.4000, -1.5000, -1.5708, {0.05 * k:.4f}]⟩" for k in range(count)]


def program(name: str, *lines: str, head: str = "def Program():", indent: str = "  ", end: str = "\n") -> Attack:
    """A plain program of which all is marked."""
    text = end.join([head, *(indent + line for line in lines), "end", ""])
    return Attack(f"plain: {name}", {"p.script": text})


TOOL = "set_tcp(p[0.0, 0.0, 0.1455, 0.0, 0.0, 0.0])"

PLAIN = (
    program(
        "offline programming, numbers in moves",
        "# Main program:",
        "global speed_ms    = 0.250",
        "global speed_rads  = 0.750",
        "global accel_mss   = 1.200",
        "global accel_radss = 1.200",
        "global blend_radius_m = 0.001",
        TOOL,
        f"movej({stances(1)[0]},accel_radss,speed_rads,0,0)",
        *(f"movel({p},accel_mss,speed_ms,0,blend_radius_m)" for p in poses(12, 6)),
    ),
    program(
        "PolyScope with waypoints under names and comments of its nodes",
        TOOL,
        "set_payload(1.5, [0.0, 0.0, 0.05])",
        "set_gravity([0.0, 0.0, 9.82])",
        *(f"global Waypoint_{k}_p={p}" for k, p in enumerate(poses(8, 4), start=1)),
        *(f"global Waypoint_{k}_q={q}" for k, q in enumerate(stances(2), start=1)),
        '# 1 "Robot Program"',
        "movej(Waypoint_1_q, a=1.3962634015954636, v=1.0471975511965976)",
        *(f"movel(Waypoint_{k}_p, a=1.2, v=0.25)" for k in range(1, 9)),
        "movej(Waypoint_2_q, a=1.4, v=1.05)",
    ),
    program(
        "an endless loop of picking and placing",
        TOOL,
        f"movej({stances(1)[0]}, a=1.4, v=1.05)",
        "while (True):",
        *(
            f"  movel({p}, a=1.2, v=0.25)\n    set_standard_digital_out({k % 8}, True)\n    sleep(0.5)"
            for k, p in enumerate(poses(8, 5))
        ),
        "end",
    ),
    program(
        "functions with waits and counters",
        TOOL,
        "def grip():",
        "  set_tool_digital_out(0, True)",
        "  while get_tool_digital_in(0) == False:",
        "    sync()",
        "  end",
        "end",
        "n = 0",
        f"movej({stances(1)[0]})",
        "while n < 3:",
        *(f"  movel({p}, v=0.1)\n    grip()" for p in poses(9, 4)),
        "  n = n + 1",
        "end",
    ),
    program(
        "joints alone, as a planner writes them",
        *(f"movej({q}, a=1.0, v=0.5, r=0.0)" for q in stances(16)),
    ),
    program(
        "circles and blends",
        TOOL,
        f"movej({stances(1)[0]}, a=1.4, v=1.05)",
        *(
            f"movel({a}, a=0.5, v=0.1, r=0.005)\n  movec({b}, {c}, a=0.5, v=0.1, r=0.0, mode=0)"
            for a, b, c in zip(poses(12, 6)[0::3], poses(12, 6)[1::3], poses(12, 6)[2::3], strict=True)
        ),
    ),
    program(
        "process moves with a tool that is changed on the way",
        TOOL,
        f"movej({stances(1)[0]}, a=1.4, v=1.05)",
        *(f"movep({p}, a=1.2, v=0.05, r=0.002)" for p in poses(6, 4)),
        "set_tcp(p[0.02, 0.0, 0.2, 0.0, 0.0, 0.785])",
        f"movej({stances(2)[1]}, a=1.4, v=1.05)",
        *(f"movep({p}, a=1.2, v=0.05, r=0.002)" for p in poses(6, 5)),
    ),
    program(
        "CRLF, tabs, comments with umlauts",
        TOOL,
        f"movej({stances(1)[0]})  # Grundstellung; movel(p[1, 2, 3, 4, 5, 6])",
        *(f"movel({p})\t# Naht {k}: Übergang" for k, p in enumerate(poses(10, 3))),
        indent="\t",
        end="\r\n",
    ),
    program(
        "branches that switch outputs and messages",
        TOOL,
        f"movej({stances(1)[0]}, a=1.4, v=1.05)",
        *(
            f'if get_standard_digital_in({k}):\n    textmsg("part ", {k})\n    movel({p}, a=1.2, v=0.25)\n  else:\n'
            f"    set_standard_analog_out(0, 0.{k})\n  end"
            for k, p in enumerate(poses(8, 4))
        ),
    ),
    program(
        "by hand, joints and poses in turn",
        TOOL,
        *(
            f"movej({q}, a=2, v=1)\n  movel({a}, a=1, v=0.2)\n  movel({b}, a=1, v=0.2)"
            for q, a, b in zip(stances(5), poses(10, 4)[0::2], poses(10, 4)[1::2], strict=True)
        ),
        "stopj(2.0)",
        head="def hand_written():",
    ),
)

P1 = "p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧"

NAMES = (
    *lone(
        "a function of the program's own has a built-in's name",
        "sleep(0.1)",
        "sync()",
        "  def sleep(t):\n    set_tcp(get_actual_tcp_pose())\n  end\n",
    )[:1],
    *body(
        "a move of the program's own has a built-in's name",
        "  def movel(where):\n    movej(pose_trans(where, get_actual_tcp_pose()))\n  end\n"
        "  movel(p⟦[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟧)§",
        "",
        "",
    )[:1],
    *lone(
        "a function is defined twice",
        "setup()",
        "sync()",
        "  def setup():\n    sync()\n  end\n  def setup():\n    set_tcp(p[0, 0, 0.3, 0, 0, 0])\n  end\n",
    )[:1],
    *lone("a name that begins as a built-in", "set_tcp_of(3)", "sync()"),
    *body("a name that begins as a move", f"  §({P1})", "movel_fast", "movel"),
    *lone(
        "an apostrophe in two texts with the tool between",
        'textmsg("don\'t")\n  §\n  textmsg("won\'t")'.replace("§", "set_tcp(get_actual_tcp_pose())"),
        'textmsg("don\'t")\n  sleep(0.1)\n  textmsg("won\'t")',
    ),
    *lone(
        "a quotation mark in two comments with the tool between",
        '# 5" pipe\n  set_tcp(get_actual_tcp_pose())\n  # 6" pipe',
        '# 5" pipe\n  sleep(0.1)\n  # 6" pipe',
    ),
    Attack(
        "a bare CR ends a comment",
        {
            "p.script": f"def prog():\n  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  # next\r  set_tcp(get_actual_tcp_pose())\n"
            f"  movel({P1})\nend\n"
        },
    ),
    *lone(
        "the tool grows in each pass of a loop",
        "while get_standard_digital_in(0):\n    set_tcp(pose_trans(get_tcp_offset(), p[0, 0, 0.01, 0, 0, 0]))\n  end",
        "while get_standard_digital_in(0):\n    sleep(0.1)\n  end",
    ),
    *lone(
        "a part of a structure that is measured is the tool",
        "s = struct(tool=p[0, 0, 0.1, 0, 0, 0])\n  s.tool[2] = read_input_float_register(0)\n  set_tcp(s.tool)",
        "s = struct(n=3)",
    )[:1],
    *body(
        "a component is raised by an operator that the manual has not",
        f"  p1 = {P1}\n  §\n  movel(p1)",
        "p1[2] += 0.1",
        "sleep(0.1)",
    )[:1],
    *body(
        "another pass of a loop goes another way",
        f"  i = 0\n  while i < 3:\n    if i == 1:\n      §\n    end\n    movel({P1})\n    i = i + 1\n  end",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    ),
    *body(
        "a pass that is cut short by continue",
        "  i = 0\n  while i < 3:\n    i = i + 1\n    if get_standard_digital_in(0):\n      §\n      continue\n"
        f"    end\n    movel({P1})\n  end",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    ),
    *body(
        "a thread moves while the program sets the tool",
        f"  thread mover():\n    movel({P1})\n  end\n  t = run mover()\n  §\n  join t",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    )[:1],
    *body(
        "a point is an argument's value where none is given",
        f"  def go(where={P1}):\n    movel(where)\n  end\n  §",
        "go(get_actual_tcp_pose())",
        "go()",
    )[:1],
    *body(
        "a circle's middle with another tool",
        f"  p1 = {P1}\n  movel(p1)\n  §\n  movec(p1, p[0.5, 0.3, 0.35, 2.2, -2.2, 0.1])",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    ),
    *body(
        "a function gives the point back, and what calls it moves it off",
        f"  def home():\n    return {P1}\n  end\n  §",
        "movel(pose_trans(home(), p[0, 0, read_input_float_register(0), 0, 0, 0]))",
        "sleep(0.1)",
    )[:1],
    *body(
        "a point's numbers are joints as well",
        f"  p1 = {P1}\n  movel(p1)\n  §",
        "movej([p1[0], -1.2, 1.4, -1.5, -1.57, p1[5]])",
        "movel(p1)",
    ),
    *body(
        "a nested function sets the tool",
        f"  def outer():\n    def inner():\n      §\n    end\n    inner()\n  end\n  outer()\n  movel({P1})",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    )[:1],
    *body(
        "poses that the pendant's installation has",
        f"  p1 = {P1}\n  §\n  movel(p1)",
        "p1 = Station_const",
        "sleep(0.1)",
    ),
    Attack(
        "a move before any tool is set",
        {
            "p.script": f"def prog():\n  movej(⟨[0.1, -1.2, 1.4, -1.5, -1.57, 0.2]⟩)\n  movel({P1})\n"
            "  set_tcp(p[0, 0, 0.1, 0, 0, 0])\nend\n"
        },
    ),
    Attack(
        "a second program of the file begins with the tool of the first, or with the one before",
        {
            "p.script": "def first():\n  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n"
            f"  movej(⟨[0.1, -1.2, 1.4, -1.5, -1.57, 0.2]⟩)\nend\ndef second():\n  movel({P1})\nend\n"
        },
    ),
    Attack(
        "control: letters whose second byte some take for the end of a line",
        {
            "p.script": f'{HEAD}  # Å set_tcp(get_actual_tcp_pose())\n  # à\xa0 movel(x)\n  textmsg("Å")  # …\n'
            "  movel(p⟨[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟩)\nend\n"
        },
    ),
    Attack(
        "control: a form feed and a vertical tab in a comment",
        {
            "p.script": f"{HEAD}  # a \f set_tcp(get_actual_tcp_pose())\n  # a \v set_tcp(get_actual_tcp_pose())\n"
            "  movel(p⟨[0.5, -0.3, 0.35, 2.2, -2.2, 0.1]⟩)\nend\n"
        },
    ),
)

INDIRECT = (
    *body(
        "two functions call each other, and the tool changes between",
        f"  def a(n):\n    movel({P1})\n    if n > 0:\n      §\n      b(n)\n    end\n  end\n  def b(n):\n    a(n - 1)\n"
        "  end\n  a(1)",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    )[:1],
    *body(
        "a thread calls a function that sets the tool",
        f"  def fit():\n    §\n  end\n  thread watch():\n    fit()\n  end\n  run watch()\n  movel({P1})",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    ),
    *body(
        "a function starts the thread that sets the tool",
        f"  thread watch():\n    §\n  end\n  def start():\n    run watch()\n  end\n  start()\n  movel({P1})",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    ),
    *body(
        "a branch starts the thread that sets the tool",
        f"  thread watch():\n    §\n  end\n  if get_standard_digital_in(1):\n    run watch()\n  end\n  movel({P1})",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    ),
    *body(
        "a thread is started behind the move in a loop",
        f"  thread watch():\n    §\n  end\n  i = 0\n  while i < 3:\n    movel({P1})\n    if i == 0:\n"
        "      run watch()\n    end\n    i = i + 1\n  end",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    ),
    *body(
        "a thread is awaited, and has set the tool",
        f"  thread watch():\n    §\n  end\n  t = run watch()\n  join t\n  movel({P1})",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    ),
    *body(
        "a thread changes the variable that the tool is set from",
        "  global length = 0.1\n  thread watch():\n    §\n  end\n  run watch()\n  set_tcp(p[0, 0, length, 0, 0, 0])\n"
        f"  movel({P1})",
        "length = read_input_float_register(0)",
        "sleep(0.1)",
    )[:1],
    *body(
        "a branch changes a number that the tool is set from",
        f"  length = 0.1\n  if get_standard_digital_in(1):\n    §\n  end\n  set_tcp(p[0, 0, length, 0, 0, 0])\n  movel({P1})",
        "length = 0.2",
        "sleep(0.1)",
    )[:1],
    *body(
        "a tool out of a list by a register",
        f"  tools = [p[0, 0, 0.1, 0, 0, 0], p[0, 0, 0.2, 0, 0, 0]]\n  §\n  movel({P1})",
        "set_tcp(tools[read_input_integer_register(0)])",
        "sleep(0.1)",
    ),
    *body(
        "a copy is the target, and the point it was copied from changes before its own move",
        f"  p1 = {P1}\n  p2 = p1\n  movel(p2)\n  §\n  movel(p1)",
        "p1[2] = read_input_float_register(0)",
        "sleep(0.1)",
    )[:1],
    *body(
        "the condition of a loop sets the tool",
        f"  def more():\n    §\n    return get_standard_digital_in(1)\n  end\n  while more():\n    movel({P1})\n  end",
        "set_tcp(get_actual_tcp_pose())",
        "sleep(0.1)",
    ),
    *body(
        "the tool is what a function gives",
        "  def choose():\n    if get_standard_digital_in(1):\n      return p[0, 0, 0.1, 0, 0, 0]\n    end\n"
        f"    return p[0, 0, 0.2, 0, 0, 0]\n  end\n  §\n  movel({P1})",
        "set_tcp(choose())",
        "sleep(0.1)",
    ),
    *body(
        "a point is compared with where the arm is",
        f"  p1 = {P1}\n  §\n    movel(p1)\n  end",
        "if p1 == get_actual_tcp_pose():",
        "if get_standard_digital_in(1):",
    ),
    *body(
        "a point's length is worked with", f"  p1 = {P1}\n  movel(p1)\n  §", "sleep(norm([p1[0], p1[1]]))", "sleep(0.1)"
    ),
    *body(
        "points of two branches, one of them raised behind",
        f"  if get_standard_digital_in(1):\n    p1 = {P1}\n  else:\n    p1 = p⟦[0.5, 0.3, 0.35, 2.2, -2.2, 0.1]⟧\n"
        "  end\n  §\n  movel(p1)",
        "p1[2] = p1[2] + read_input_float_register(0)",
        "sleep(0.1)",
    )[:1],
    *body(
        "a loop within a loop sets the tool at its end",
        f"  i = 0\n  while i < 2:\n    j = 0\n    while j < 2:\n      movel({P1})\n      j = j + 1\n    end\n    §\n"
        "    i = i + 1\n  end",
        "set_tcp(p[0, 0, 0.2, 0, 0, 0])",
        "sleep(0.1)",
    ),
    *body(
        "a waypoint that a joint move reaches from stated joints, and a linear move as the arm stands",
        f"  q1 = [0.2, -1.3, 1.5, -1.6, -1.5, 0.3]\n  p1 = {P1}\n  movej(get_inverse_kin(p1, qnear=q1))\n  §\n  movel(p1)",
        "set_tcp(p[0.0, 0.0, 0.2, 0.0, 0.0, 0.0])",
        "sleep(0.1)",
    ),
    *body(
        "a waypoint that joint moves reach from two stances",
        f"  q1 = [0.2, -1.3, 1.5, -1.6, -1.5, 0.3]\n  q2 = [0.2, -1.3, 1.5, 1.6, 1.5, 0.3]\n  p1 = {P1}\n"
        "  movej(get_inverse_kin(p1, qnear=q1))\n  movel(p1)\n  movej(get_inverse_kin(p1, qnear=§))",
        "q2",
        "q1",
    ),
    *body(
        "a conveyor is followed in one branch",
        f"  if get_standard_digital_in(1):\n    §\n  end\n  movel({P1})",
        "track_conveyor_linear(p[1, 0, 0, 0, 0, 0], 500.0)",
        "sleep(0.1)",
    ),
    *body(
        "a thread adds an offset to the path",
        f"  thread watch():\n    §\n  end\n  run watch()\n  movel({P1})",
        "path_offset_enable()\n    path_offset_set(p[0, 0, read_input_float_register(0), 0, 0, 0], 1)",
        "sleep(0.1)",
    ),
)

ATTACKS: tuple[Attack, ...] = tuple(
    replace(attack, frames=BASE) for attack in (*STATE, *POINTS, *REACHES_NOTHING, *INDIRECT, *PLAIN, *NAMES)
)
