"""URScript: what a target means is certain, or the target is left with a reason."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from program_attacks import Attack
from program_attacks.urscript import ATTACKS, CONTROLS, FRAMES, HEAD, P, Q
from robots import ur10
from scipy.spatial.transform import Rotation

from aridcal.engine.robot.chain import parse_robot
from aridcal.jobs.apply.programs import urscript
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import KnownFrames, read_frames
from aridcal.jobs.apply.programs.moves import Moves, Stop
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.urscript.table import RULES, Rule
from aridcal.system.errors import AridcalError

OWN_BASE = KnownFrames(bases={"default": np.eye(4)})


def read(text: str, frames: KnownFrames = OWN_BASE, *, start: bool = False, **others: str) -> ProgramReading:
    """Targets of a program, and of files that are given beside it and not corrected."""
    sources = [
        SourceFile(Path("a.script"), text),
        *(SourceFile(Path(name), t, ours=False) for name, t in others.items()),
    ]
    return urscript.ROW.read(Project(tuple(sources)), Cell(ur10(), frames, start=start))


def is_corrected(target: Target) -> bool:
    """Whether nothing speaks against it."""
    return not target.why and not target.branch.unknown


def target(text: str, frames: KnownFrames = OWN_BASE) -> Target:
    """The last target of a program, which begins with tool and stance."""
    return read(HEAD + text, frames).targets[-1]


def frame(numbers: str) -> np.ndarray:
    """The pose p[...], by the manual: a rotation vector behind a position."""
    values = [float(n) for n in re.findall(r"-?[\d.]+", numbers)]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(values[3:]).as_matrix(), values[:3]
    return T


def marked(text: str) -> tuple[str, list[tuple[int, int]], list[tuple[int, int]]]:
    """A text without its marks, spans that must be left, and spans that must be corrected."""
    plain, left, corrected = "", [], []
    for part in re.split("([⟦⟧⟨⟩])", text):
        if part in "⟦⟨" and part:
            start = len(plain)
        elif part in "⟧⟩" and part:
            (left if part == "⟧" else corrected).append((start, len(plain)))
        else:
            plain += part
    return plain, left, corrected


def judged(attack: Attack, folder: Path) -> tuple[ProgramReading, list[bool], list[bool]]:
    """What is read, and for each marked span whether all its numbers are corrected: those to be left, those to be corrected."""
    text, left, corrected = marked(attack.files["a.script"])
    (folder / "frames.yaml").write_text(attack.frames)
    reading = read(text, read_frames(folder / "frames.yaml"))
    places = {n.start for t in reading.targets if is_corrected(t) for n in t.numbers}
    touched = [[any(start <= place < end for place in places) for start, end in spans] for spans in (left, corrected)]
    return reading, touched[0], touched[1]


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_what_changes_a_targets_meaning_leaves_it_with_a_reason(attack: Attack, tmp_path: Path) -> None:
    reading, left, corrected = judged(attack, tmp_path)
    assert not any(left)
    assert all(corrected)
    if attack.why:
        assert any(attack.why in t.why for t in reading.targets)


@pytest.mark.parametrize("attack", CONTROLS, ids=lambda attack: attack.name)
def test_the_same_program_without_it_is_corrected(attack: Attack, tmp_path: Path) -> None:
    _, left, corrected = judged(attack, tmp_path)
    if "list" not in attack.name:  # lists are left in any case
        assert all(left)
    assert all(corrected)


TOOL, STANCE = "p[0, 0, 0.1, 0, 0, 0]", "[0.1, -1.5, 1.5, 0.1, 1.5, 0.2]"


@pytest.mark.parametrize(
    ("text", "base", "tool"),
    [
        (f"movel({P})\n", [], TOOL),
        (f"movel(pose_trans({Q}, {P}))\n", [Q], TOOL),
        (f"movel(pose_trans(p_from_to={P}, p_from={Q}))\n", [Q], TOOL),
        (f"f = {Q}\ng = pose_trans(f, {Q})\nmovel(pose_trans(g, {P}))\n", [Q, Q], TOOL),
        (f"movel(pose_trans({Q}, pose_trans({Q}, {P})))\n", [Q, Q], TOOL),
        ("t = p[0, 0, 0.1, 0, 0, 0]\nt[2] = 0.25\nset_tcp(t)\n" f"movel({P})\n", [], "p[0, 0, 0.25, 0, 0, 0]"),
        (f"set_tcp(p[0, 0, 0.1 + 2 * 0.05 - 0.4 / 8, 0, 0, 0])\nmovel({P})\n", [], "p[0, 0, 0.15, 0, 0, 0]"),
        (f"set_tcp(p[0, 0, 0, d2r(90), 0, 0])\nmovel({P})\n", [], f"p[0, 0, 0, {math.pi / 2}, 0, 0]"),
        (f"old = get_tcp_offset()\nset_tcp({Q})\nset_tcp(old)\nmovel({P})\n", [], TOOL),
        (f"def f(t):\n set_tcp(t)\nend\nf({Q})\nmovel({P})\n", [], Q),
        (f"def f():\n return {Q}\nend\nset_tcp(f())\nmovel({P})\n", [], Q),
        (f"if x:\n set_tcp({Q})\nelse:\n set_tcp({Q})\nend\nmovel({P})\n", [], Q),
        (f"movej(get_inverse_kin({P}, tcp={Q}))\n", [], Q),
        (f"q = get_inverse_kin({P})\nset_tcp({Q})\nmovej(q)\n", [], TOOL),
        (f"def f(a, b):\n movel(pose_trans(b, a))\nend\nf(b={Q}, a={P})\n", [Q], TOOL),
        (f"force_mode(tool_pose(), [], [], 2, [])\nend_force_mode()\nmovel({P})\n", [], TOOL),
        (f"set_tcp({Q}) movel({P})\n", [], Q),
        (f"p = {Q}\np[2] = 0.2\nset_tcp(p)\nmovel({P})\n", [], Q),
    ],
)  # fmt: skip
def test_frames_and_tools_are_followed_exactly(text: str, base: list[str], tool: str) -> None:
    place = target(text).place
    assert place is not None
    product = np.eye(4)
    for numbers in base:
        product = product @ frame(numbers)
    np.testing.assert_allclose(place.base, product, atol=1e-12)
    np.testing.assert_allclose(place.tool, frame(tool), atol=1e-12)


def test_a_point_used_twice_is_one_target() -> None:
    targets = read(f"q1 = [-1.2, -1.5, 1.6, 0, 0, 0]\nmovej(q1)\nset_tcp({Q})\nmovej(q1)\nmovel({P})\n").targets
    assert [t.name for t in targets] == ["q1", P]
    assert all(is_corrected(t) for t in targets)


@pytest.mark.parametrize(
    "text",
    [
        f"def go(a, b):\n movel(a, v=b)\nend\ngo(⟨{P}⟩, 1)\ngo(⟨{Q}⟩, 2)\n",
        f"def prog():\n{HEAD} while (True):\n  movel(⟨{P}⟩)\n  if get_digital_in(1):\n   break\n  end\n end\nend\n",
        f'global W_p=⟨{P}⟩\nglobal W_q={STANCE}\n$ 3 "W" "breakAfter"\nmovej(get_inverse_kin(W_p, qnear=W_q), a=1)\n',
        f"p1 = ⟨{P}⟩\np2 = p1\nmovel(p2)\ntextmsg(\"at\", p1)\nif is_within_safety_limits(p1):\n movel(p1)\nend\n",
        f"x = 1 # movel({Q})\nmovel(\n ⟨p[0.4, # one\n 0.2, .3, +0, 3E0,\t1e-1]⟩,\n a=1)\n",
        f"movel(⟨{P}⟩) movel(⟨{Q}⟩)\nif x: movel(⟨p[1,0,0,0,0,0]⟩) end\n",
        f"while i < 3:\n i = i + 1\n movel(⟨{P}⟩)\nend\nhalt\nset_tcp({Q})\nmovel({P})\n",
        f"def f():\n if x:\n  return True\n end\n movel(⟨{P}⟩)\n return False\nend\nwhile f():\n movel(⟨{Q}⟩)\nend\n",
        f"thread t():\n while True:\n  n = n + 1\n  sync()\n end\nend\nh = run t()\nmovel(⟨{P}⟩)\nkill h\njoin h\n",
        f"def place():\n return ⟨{P}⟩\nend\ndef close_it():\n sleep(1)\nend\nmovel(place())\nclose_it()\nx = close_it()\n",
        f"movep(⟨{P}⟩, a=1, v=0.1, r=0.05)\nservoj(⟨[0.2, -1.4, 1.6, 0.1, 1.4, 0.3]⟩, t=0.1)\nservoc(⟨{Q}⟩)\n",
        f"enter_critical\nx = [1, [2, 3], p[1,2,3,4,5,6]]\ny = not x and -1 < 2\nexit_critical\nmovel(⟨{P}⟩)\n",
    ],
)  # fmt: skip
def test_programs_as_people_write_them_are_corrected(text: str) -> None:
    plain, left, corrected = marked(HEAD + text)
    places = {n.start for t in read(plain).targets if is_corrected(t) for n in t.numbers}
    assert corrected and not left
    assert all(sum(start <= place < end for place in places) == 6 for start, end in corrected)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_line_ends_byte_order_mark_and_strings_are_no_statements(end: str) -> None:
    lines = ["\xef\xbb\xbfset_tcp(p[0,0,0,0,0,0])", 'textmsg("# movej(p1)  (\\")', "movej([1,2,3,4,5,6]) # it's", ""]
    (one,) = read(end.join(lines)).targets
    assert (one.line, one.form, is_corrected(one)) == (3, "joints", True)


def test_numbers_of_a_target_are_those_of_the_text() -> None:
    text = HEAD + "movel(p[ .4,0.20 , +3.e-1, 0,3 ,-0.1])\n"
    last = read(text).targets[-1]
    assert [n.text for n in last.numbers] == [".4", "0.20", "+3.e-1", "0", "3", "-0.1"]
    assert all(text[n.start : n.end] == n.text for n in last.numbers)


def test_a_pose_before_any_joints_has_no_known_stance_unless_the_start_is_stated() -> None:
    text = f"set_tcp({Q})\nmovel({P})\nmovej([0,-1,1,0,1,0])\nmovel({Q})\n"
    unknown = [t.branch.unknown for t in read(text).targets]
    assert "--start" in unknown[0]
    assert unknown[2] == ""
    assert all(not t.branch.unknown for t in read(text, start=True).targets)
    nearby = read(f"set_tcp({Q})\nmovej(get_inverse_kin({P}, qnear=[0,-1,1,0,1,0]))\n").targets[0]
    assert is_corrected(nearby)
    assert nearby.branch.near is not None
    np.testing.assert_allclose(nearby.branch.near, [0, -1, 1, 0, 1, 0])


def test_a_tool_that_nothing_states_leaves_poses_and_no_joints() -> None:
    text = f"movej([0,-1,1,0,1,0])\nmovel({P})\n"
    joints, pose = read(text).targets
    assert is_corrected(joints)
    assert "tool" in pose.why
    stated = KnownFrames(bases={"default": np.eye(4)}, tools={"default": frame(Q)})
    place = read(text, stated).targets[1].place
    assert place is not None
    np.testing.assert_allclose(place.tool, frame(Q))


WITH_BASE = """<link name="base"/><joint name="b" type="fixed"><parent link="base_link"/><child link="base"/>
<origin rpy="0 0 3.141592653589793"/></joint>"""


def test_poses_are_in_the_link_base_and_that_is_said_else_the_base_must_be_stated() -> None:
    text = HEAD + f"movel({P})\n"
    robot = ur10()
    turned = parse_robot(robot.urdf.replace(b"</robot>", WITH_BASE.encode() + b"</robot>"), robot.tip, robot.base)
    reading = urscript.ROW.read(Project((SourceFile(Path("a.script"), text),)), Cell(turned))
    place = reading.targets[-1].place
    assert place is not None
    np.testing.assert_allclose(place.base, np.diag([-1, -1, 1, 1]), atol=1e-9)
    assert any("`base`" in note for note in reading.notes)
    with pytest.raises(AridcalError, match=r"bases: \{default:"):
        read(text, KnownFrames())
    assert is_corrected(read("movej([0,-1,1,0,1,0])\n", KnownFrames()).targets[0])
    assert read(text).notes == ()


def test_a_function_that_no_file_has_is_harmless_if_the_user_says_so_or_if_its_file_is_given() -> None:
    text = HEAD + f"close_it(5)\nmovel({P})\n"
    assert not is_corrected(read(text).targets[-1])
    assert is_corrected(read(text, KnownFrames(bases=OWN_BASE.bases, harmless=frozenset({"close_it"}))).targets[-1])
    assert is_corrected(read(text, **{"b.script": "def close_it(n):\n set_digital_out(1, True)\nend\n"}).targets[-1])
    assert not is_corrected(read(text, **{"b.script": f"def close_it(n):\n set_tcp({Q})\n foo()\nend\n"}).targets[-1])


def test_a_function_that_two_other_files_have_may_be_either() -> None:
    library = "def close_it(n):\n set_digital_out(1, True)\nend\n"
    text = HEAD + f"close_it(5)\nmovel({P})\n"
    assert not is_corrected(read(text, **{"b.script": library, "c.script": library}).targets[-1])


def test_points_of_a_file_that_is_not_corrected_are_named_and_left() -> None:
    go = read(HEAD + "go()\n", **{"b.script": f"def go():\n movel({P})\nend\n"}).targets[-1]
    assert "b.script, which is not corrected" in go.why


@pytest.mark.parametrize(
    "text",
    [
        f"{HEAD}if x:\nmovel({P})\n",
        f"{HEAD}movel({P})\nend\n",
        f"{HEAD}movel({P})\nelse:\nend\n",
        f"{HEAD}movel({P})\rmovel({Q})\n",
        f"{HEAD}{'if x:' * 100}\nmovel({P})\n{'end ' * 100}\n",
        HEAD + "".join(f"def f{k}():\n f{k + 1}()\nend\n" for k in range(200)) + f"f0()\nmovel({P})\n",
    ],
)
def test_a_program_that_is_none_as_a_whole_is_left_as_a_whole(text: str) -> None:
    targets = read(text).targets
    assert targets
    assert all(t.why for t in targets)


@pytest.mark.parametrize(
    "garbage",
    ["movel(", "p[", '"', "[1,", "x = (", "if ", "$ 1", "\xa0", "9" * 400, "x = 0x" + "f" * 400, "not ", "def f():"],
)
def test_any_text_is_read_or_left(garbage: str) -> None:
    for text in (garbage * 2000, (garbage + "\n") * 2000, HEAD + garbage + f"\nmovel({P})\n"):
        for one in read(text).targets:
            assert one.why or np.isfinite(one.values).all()


def test_a_function_or_thread_with_a_garbled_head_is_none() -> None:
    text = f"{HEAD}movel({P})\nthread t(:\n sync()\nend\nthread u():\n t()\nend\nrun t()\nrun u()\nmovel({Q})\n"
    assert [is_corrected(t) for t in read(text).targets] == [True, True, False]


def test_reasons_do_not_depend_on_places_that_a_correction_moves() -> None:
    text = f"{HEAD}movel({P})\ndef f():\n if x:\n  set_tcp({Q})\n  f()\n end\nend\nf()\nmovel({Q})\n"
    longer = text.replace("0.2, 0.3", "0.2000001, 0.3000001")
    assert [t.why for t in read(text).targets] == [t.why for t in read(longer).targets]
    assert read(text).targets[-1].why


@pytest.mark.parametrize(
    "name", sorted(set(RULES) - {n for n, rule in RULES.items() if rule in (Rule.HARMLESS, Rule.LOOKS)})
)
def test_each_function_that_is_not_harmless_changes_what_comes_after_it_or_is_a_move(name: str) -> None:
    before = read(f"{HEAD}movel({P})\nmovej([1,2,3,4,5,6])\n").targets
    joints = "[1,2,3,4,5,6]"
    after = read(f"{HEAD}{name}({joints})\nmovel({P})\nmovej({joints})\n").targets
    ends = name.startswith(("end_force", "end_screw", "stop_", "path_offset_disable"))
    assert ends or [is_corrected(t) for t in before] != [is_corrected(t) for t in after]


def test_the_comment_stands_behind_all_and_changes_no_target() -> None:
    assert urscript.ROW.comment is not None
    for text in (HEAD, HEAD.rstrip("\n"), HEAD.replace("\n", "\r\n"), ""):
        place, comment = urscript.ROW.comment(text, "corrected")
        new = text[:place] + comment + text[place:]
        assert new.splitlines()[-1] == "# corrected"
        assert ("\r\n" in text) == comment.endswith("\r\n")
        assert [(t.line, t.numbers) for t in read(new).targets] == [(t.line, t.numbers) for t in read(text).targets]


def test_planned_moves_are_read_as_they_were_meant() -> None:
    rng = np.random.default_rng(1)
    stops = tuple(Stop(rng.uniform(-2, 2, 6), k % 3, "") for k in range(8))
    assert urscript.ROW.write is not None
    lines = urscript.ROW.write(Moves("title", tuple("abcdef"), ("revolute",) * 6, stops, 1.5), "planned")
    targets = read("".join(f"{line}\n" for line in lines)).targets
    assert all(is_corrected(t) for t in targets)
    for planned, t in zip(stops, targets, strict=True):
        assert t.readings is not None
        np.testing.assert_allclose(t.readings, planned.readings, atol=1e-6)


def test_there_are_sixty_attacks_and_more_each_of_its_own() -> None:
    assert len({attack.files["a.script"] for attack in ATTACKS}) == len(ATTACKS) >= 60
    assert FRAMES


ONE_TOKEN = (
    f"movel({P})",
    f"movej({Q}, 1.4, 1.05, 0, 0)",
    f"movel({P}, a=1.2, v = 0.25, r=blend)",
    f"movel(pose_trans(table, {P}), acc, speed, 0, blend)",
    f"movej(pose_trans( table ,{P} ),a=acc)",
    f"movel(pose_trans(nowhere, {P}), v=speed)",
    f"movel({P}, v=table)",
    f"movel({P}, speed=1)",
    f"movel({P}, and)",
    f"movel(pose_trans(run, {P}))",
    f"movec({P}, 1, mode=one)",
    f"movel(pose_trans(table, {P}), True)",
    f"movel(pose_trans(seat, {P}))",
)
"""Moves that are read as one token where nothing stands before their bracket, and word by word where a blank does."""


@pytest.mark.parametrize("move", ONE_TOKEN)
@pytest.mark.parametrize("own", ["", "def movel(p):\nend\n", "def pose_trans(a, b):\n  return b\nend\n"])
def test_a_move_that_is_read_as_one_token_means_what_its_words_mean(move: str, own: str) -> None:
    head = (
        f"table = p[0.1,0,0,0,0,0.5]\nseat = {P}\nacc = 1.2\nspeed = 0.25\nblend = 0.01\none = 1\n{HEAD}movel(seat)\n"
    )

    def said(text: str) -> list[tuple[object, ...]]:
        targets = read(f"{own}def f():\n{head}{text}\nmovel({P})\nend\n").targets
        return [
            (
                t.line,
                t.form,
                t.numbers.texts,
                t.why.partition(": ")[0],
                t.branch.unknown,
                t.place and t.place.base.tolist(),
                t.place and t.place.tool.tolist(),
            )
            for t in targets
        ]

    words = move.replace("(", " (", 1)
    assert said(move) == said(words)
    assert said(f"x = y z {move}") == said(f"x = y z {words}")  # no statement: all that it names is used
