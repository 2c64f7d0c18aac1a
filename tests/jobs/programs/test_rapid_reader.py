"""RAPID: what each target means, and what is left because it is not certain."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import robots
from program_attacks import Attack
from program_attacks.rapid import ATTACKS, DATA, JOINTS, OTHER, POSE, ZERO

from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import KnownFrames, read_frames
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.rapid import ROW, context
from aridcal.jobs.apply.programs.rapid.grammar import fold
from aridcal.jobs.apply.programs.targets import Target, Words
from aridcal.jobs.apply.programs.text import Number, Numbers

ARM = robots.ur10()

MARK = re.compile("[⟦⟧⟨⟩]")


def spans(text: str, begin: str, end: str) -> list[tuple[int, int]]:
    """Places of what stands between marks, in the text without any."""
    places, opened = [], 0
    for shift, match in enumerate(MARK.finditer(text)):
        place = match.start() - shift
        if match.group() == begin:
            opened = place
        elif match.group() == end:
            places.append((opened, place))
    return places


def read(files: Mapping[str, str], frames: KnownFrames | None = None, start: bool = True) -> ProgramReading:
    """The targets of a project without marks."""
    sources = tuple(SourceFile(Path(name), MARK.sub("", text)) for name, text in files.items())
    return ROW.read(Project(sources), Cell(ARM, frames or KnownFrames(), start=start))


def inside(targets: list[Target], file: int, span: tuple[int, int]) -> list[Target]:
    return [t for t in targets if t.file == file and any(span[0] <= n.start < span[1] for n in t.numbers)]


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_what_changes_a_targets_meaning_is_followed_or_the_target_is_left(attack: Attack, tmp_path: Path) -> None:
    path = tmp_path / "frames.yaml"
    path.write_text(attack.frames or "format: 1\n", "utf-8")
    targets = list(read(attack.files, read_frames(path)).targets)
    reasons = [target.why for target in targets if target.why]
    for file, text in enumerate(attack.files.values()):
        for span in spans(text, "⟦", "⟧"):
            assert all(target.why for target in inside(targets, file, span)), (text, targets)
        for span in spans(text, "⟨", "⟩"):
            assert [target.why for target in inside(targets, file, span)] == [""], (span, reasons)
    assert not attack.why or any(attack.why.lower() in reason.lower() for reason in reasons), reasons


def main(body: str, data: str = "") -> dict[str, str]:
    return {"a.mod": f"MODULE a\n{DATA}{data}PROC main()\n{body}\nENDPROC\nENDMODULE\n"}


def shifted(*xyz: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = xyz
    return T


@pytest.mark.parametrize("option", ["", "\\WObj:=wobj0"])
def test_the_world_and_the_flange_are_where_the_user_states_them(option: str) -> None:
    world, flange = np.eye(4), np.eye(4)
    world[0, 3], flange[2, 3] = 1.0, 0.5
    text = f"MODULE m\nPROC main()\nMoveL {POSE}, v100, fine, tool0{option};\nENDPROC\nENDMODULE\n"
    place = read({"m.mod": text}, KnownFrames({"wobj0": world}, {"tool0": flange})).targets[0].place
    assert place is not None
    np.testing.assert_allclose(place.base, world)
    np.testing.assert_allclose(place.tool, flange)


@pytest.mark.parametrize(
    ("body", "base", "tool"),
    [
        ("", (0.105, 0.006, 0.057), (0.01, 0.02, 0.1)),
        ("w1.uframe.trans.z:=150;", (0.105, 0.006, 0.157), (0.01, 0.02, 0.1)),
        ("w1.uframe.trans.z:=100+2*25;", (0.105, 0.006, 0.157), (0.01, 0.02, 0.1)),
        ("w1:=w2;", (0.0, 0.3, 0.05), (0.01, 0.02, 0.1)),
        ("w1.oframe:=w2.uframe;", (0.1, 0.3, 0.1), (0.01, 0.02, 0.1)),
        ("t1.tframe:=t2.tframe;", (0.105, 0.006, 0.057), (0.0, 0.0, 0.05)),
        ("w1.uframe:=PoseMult(w2.uframe,[[1,2,3],[1,0,0,0]]);", (0.006, 0.308, 0.06), (0.01, 0.02, 0.1)),
        ("w1.uframe:=PoseInv([[1,2,3],[1,0,0,0]]);", (0.004, 0.004, 0.004), (0.01, 0.02, 0.1)),
        ("PDispSet [[7,0,0],[1,0,0,0]];", (0.112, 0.006, 0.057), (0.01, 0.02, 0.1)),
        ("PDispSet shift;", (0.106, 0.008, 0.06), (0.01, 0.02, 0.1)),
    ],
)
def test_frames_that_are_set_plainly_are_computed(body: str, base: tuple[float, ...], tool: tuple[float, ...]) -> None:
    (target,) = read(main(f"{body}\nMoveL {POSE},v100,fine,t1\\WObj:=w1;")).targets
    assert target.why == "" and target.place is not None
    np.testing.assert_allclose(target.place.base, shifted(*base), atol=1e-9)
    np.testing.assert_allclose(target.place.tool, shifted(*tool), atol=1e-9)


@pytest.mark.parametrize(
    ("step", "base", "tool"),
    [
        ("Offs({},0,0,100)", shifted(0, 0, 0.1), np.eye(4)),
        ("Offs({},-5,n0,100)", shifted(-0.005, 0.03, 0.1), np.eye(4)),
        ("Offs(Offs({},1,0,0),0,2,0)", shifted(0.001, 0.002, 0), np.eye(4)),
        ("RelTool({},0,0,-50)", np.eye(4), shifted(0, 0, 0.05)),
        ("Offs(RelTool({},0,0,-50),1,0,0)", shifted(0.001, 0, 0), shifted(0, 0, 0.05)),
    ],
)
def test_a_constant_way_off_a_point_is_another_place_of_it(step: str, base: np.ndarray, tool: np.ndarray) -> None:
    data = f"CONST robtarget p1:={POSE};\nCONST num n0:=30;\n"
    body = f"MoveL p1,v100,fine,tool0;\nMoveL {step.format('p1')},v100,fine,tool0;"
    (target,) = read(main(body, data)).targets
    (beside,) = target.beside
    np.testing.assert_allclose(beside.base, base, atol=1e-12)
    np.testing.assert_allclose(beside.tool, tool, atol=1e-12)


def test_reltool_turns_the_tool_about_its_own_axes() -> None:
    """The second road: the place is base p D, which is base p (D tool^-1) of the tip."""
    data = f"CONST robtarget p1:={POSE};\n"
    (target,) = read(main("MoveL RelTool(p1,10,0,0\\Rz:=90),v100,fine,t2;", data)).targets
    assert target.place is not None and target.notation is not None
    D = np.array([[0.0, -1, 0, 0.01], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    wanted = target.notation.pose(target.values) @ D @ np.linalg.inv(shifted(0, 0, 0.05))
    tip = target.place.base @ target.notation.pose(target.values) @ np.linalg.inv(target.place.tool)
    np.testing.assert_allclose(tip, wanted, atol=1e-12)


def test_targets_come_in_the_order_of_the_moves_each_with_its_line_and_name() -> None:
    data = (
        f"CONST robtarget p1:={POSE};\nCONST robtarget arr{{2}}:=[{POSE},\n{OTHER}];\nCONST robtarget never:={POSE};\n"
    )
    targets = read(
        main(f"MoveL arr{{2}},v1,z0,tool0;\nMoveL p1,v1,z0,tool0;\nMoveAbsJ {JOINTS},v1,z0,tool0;", data)
    ).targets
    names = [(t.name, t.line, t.form, bool(t.why)) for t in targets]
    first = DATA.count("\n") + 2
    assert names[:3] == [
        ("arr{2}", first + 2, "pose", False),
        ("p1", first, "pose", False),
        ("[[10,20,30,40,50,60],…]", first + 7, "joints", False),
    ]
    assert {name for name, _, _, left in names[3:] if left} == {"arr{1}", "never"}


CONF = [
    ("", "MoveJ", True),
    ("", "MoveL", True),
    ("ConfL\\Off;", "MoveL", False),
    ("ConfL \\Off;", "MoveJ", True),
    ("ConfJ\\Off;", "MoveJ", False),
    ("ConfJ\\Off;", "TriggJ", False),
    ("ConfJ\\Off;", "MoveL", True),
    ("ConfL\\Off;ConfL\\On;", "MoveL", True),
]


@pytest.mark.parametrize(("mode", "move", "counts"), CONF)
def test_confdata_counts_where_the_controller_asks_for_it(
    mode: str, move: str, counts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aridcal.jobs.apply.programs.rapid.points.rapid_words", _words)
    behind = "tr1,z1,tool0" if move == "TriggJ" else "z1,tool0"
    body = f"{mode}\n{move} {POSE},v100,{behind};\nMoveL {OTHER},v100,z1,tool0;"
    first, second = read(main(body), start=False).targets
    assert first.why == "" and (first.branch.words is not None) == counts
    assert first.branch.nearest != counts and bool(first.branch.unknown) != counts
    if counts:  # a posture in words is a stance
        assert second.branch.unknown == ""
    elif move == "MoveL":
        assert second.branch.unknown


def test_a_point_that_is_reached_with_and_without_confdata_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aridcal.jobs.apply.programs.rapid.points.rapid_words", _words)
    data = f"CONST robtarget p1:={POSE};\nCONST robtarget p2:={OTHER};\n"
    body = "MoveL p1,v,z,tool0;\nMoveL p2,v,z,tool0;\nConfL\\Off;\nMoveL p1,v,z,tool0;\nIF b ConfL\\On;\n"
    targets = read(main(f"{body}MoveL {POSE},v,z,tool0;\nEXIT;", data)).targets
    why = [target.why for target in targets]
    assert "another way of moving" in why[0] and why[1] == "" and "confdata" in why[2]


def _words(data: tuple[Number, ...], cell: Cell) -> Words:
    """Words that no readings contradict."""
    return Words(Numbers(data), lambda readings: tuple(n.text for n in data), "confdata")


def test_where_the_arm_comes_from_is_not_known_before_a_joint_target() -> None:
    off = "ConfL\\Off;\n"  # so that confdata does not say how the arm stands
    body = f"{off}MoveL {POSE},v100,fine,tool0;\nMoveAbsJ {JOINTS},v100,fine,tool0;\nMoveL {OTHER},v100,fine,tool0;"
    unknown = [bool(t.branch.unknown) for t in read(main(body), start=False).targets]
    assert unknown == [True, False, False]
    assert not any(t.branch.unknown for t in read(main(body), start=True).targets)
    lost = f"{off}MoveAbsJ {JOINTS},v100,fine,tool0;\nMoveJ CRobT(),v100,fine,tool0;\nMoveL {OTHER},v100,fine,tool0;"
    assert [bool(t.branch.unknown) for t in read(main(lost), start=False).targets][1]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "MODULE",
        "MODULE a",
        "MODULE a\nPROC main()\nMoveL [[1",
        'MODULE a\nPROC main()\nTPWrite "\nENDPROC\nENDMODULE',
        "MODULE a\nPROC main()\nENDIF\nENDPROC\nENDMODULE",
        "MODULE a\rPROC main()\rENDPROC\rENDMODULE",
        "MODULE a\nPROC main()\n" + "IF b THEN\n" * 5000 + "ENDPROC\nENDMODULE",
        "MODULE a\nPROC main()\nn:=" + "(" * 5000 + ";\nENDPROC\nENDMODULE",
        "MODULE a\nPROC main()\nn:=" + "f(" * 5000 + ")" * 5000 + ";\nENDPROC\nENDMODULE",
        "MODULE a\nPROC main()\nFOR i FROM 1 DO\nENDFOR\nENDPROC\nENDMODULE",
        "MODULE a\nCONST num n:=n;\nCONST robtarget p:=p;\nPROC main()\nMoveL p,v,z,tool0;\nENDPROC\nENDMODULE",
        f"MODULE a\nPROC main()\nMoveL [[1e999,0,0],[1,0,0,0],{ZERO}],v,z,tool0;\nENDPROC\nENDMODULE",
        f"MODULE a\nPROC main()\nMoveL [[{'9' * 5000},0,0],[1,0,0,0],{ZERO}],v,z,tool0;\nENDPROC\nENDMODULE",
        f"MODULE a\nPROC main()\nMoveL [[1,0,0],[0,0,0,0],{ZERO}],v,z,tool0;\nENDPROC\nENDMODULE",
        f"MODULE a\nPROC main()\nMoveL [[0x10,0,0],[1,0,0,0],{ZERO}],v,z,tool0;\nENDPROC\nENDMODULE",
    ],
)
def test_no_text_raises_and_what_is_not_formed_as_rapid_is_left(text: str) -> None:
    assert all(target.why for target in read({"a.mod": text}).targets)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("number", ["500", "500.", "+500", "5E2", "5.0e+2", ".5E3"])
def test_numbers_are_read_as_rapid_writes_them(end: str, number: str) -> None:
    text = main(f"MoveL [ [{number} ,10,\n300],[0,0,1,0],{ZERO}],v100,fine,tool0;")["a.mod"]
    (target,) = read({"a.mod": "\xef\xbb\xbf" + text.replace("\n", end)}).targets
    assert target.why == "" and target.values[0] == 500.0


def test_the_comment_stands_before_the_end_of_the_last_module_and_moves_no_target() -> None:
    assert ROW.comment is not None
    for text in (
        main(f"MoveL {POSE},v100,fine,tool0;")["a.mod"],
        f"MODULE a PROC main() MoveL {POSE},v,z,tool0; ENDPROC ENDMODULE",
    ):
        place, remark = ROW.comment(text, "corrected by aridcal\nENDMODULE")
        new = text[:place] + remark + text[place:]
        assert remark.startswith("! ") and remark.count("\n") == 1
        before, after = read({"a.mod": text}).targets, read({"a.mod": new}).targets
        assert [(t.line, t.why, t.numbers) for t in before] == [(t.line, t.why, t.numbers) for t in after] and before
    place, remark = ROW.comment("MODULE a\r\nENDMODULE\r\n", "x")
    assert (place, remark) == (10, "! x\r\n")


def test_the_context_of_a_program_is_the_other_modules_of_its_task(tmp_path: Path) -> None:
    for name in ("PROGMOD/a.mod", "PROGMOD/b.mod", "PROGMOD/notes.txt", "SYSMOD/user.sys"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("MODULE x\nENDMODULE\n", "utf-8")
    assert [path.name for path in context(tmp_path / "PROGMOD" / "a.mod")] == ["b.mod", "user.sys"]


def test_a_module_that_cannot_be_in_the_same_task_is_no_context() -> None:
    own = SourceFile(Path("a.mod"), f"MODULE a\nPROC main()\nMoveL {POSE},v,z,tB;\nENDPROC\nENDMODULE\n")
    tool = "PERS tooldata tB:=[TRUE,[[0,0,9],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    for routine, corrected in (("PROC main()\nENDPROC\n", False), ("PROC other()\nENDPROC\n", True)):
        beside = SourceFile(Path("b.mod"), f"MODULE b\n{tool}{routine}ENDMODULE\n", ours=False)
        reading = ROW.read(Project((own, beside)), Cell(ARM))
        assert [target.why == "" for target in reading.targets] == [corrected] and bool(reading.notes) != corrected


def test_a_file_beside_it_that_is_no_rapid_is_passed_over_and_one_that_is_broken_leaves_all() -> None:
    own = SourceFile(Path("a.mod"), main(f"MoveL {POSE},v,z,tool0;")["a.mod"])
    for text, corrected in (("real :: x = 1", True), ("MODULE b\nPROC x()\nMoveL", False)):
        reading = ROW.read(Project((own, SourceFile(Path("b.mod"), text, ours=False))), Cell(ARM))
        assert [target.why == "" for target in reading.targets] == [corrected] and bool(reading.notes) == corrected


def test_a_point_of_a_file_that_is_not_corrected_is_named_and_left() -> None:
    own = SourceFile(Path("a.mod"), "MODULE a\nPROC main()\nMoveL pB,v,z,tool0;\nENDPROC\nENDMODULE\n")
    beside = SourceFile(
        Path("b.mod"), f"MODULE b\nCONST robtarget pB:={POSE};\nCONST robtarget pC:={POSE};\nENDMODULE\n", ours=False
    )
    (target,) = ROW.read(Project((own, beside)), Cell(ARM)).targets
    assert target.why == "stands in b.mod, which is not corrected: give it, too" and target.file == 1


def on_a_rail() -> Robot:
    """An arm of six turning joints on a rail."""
    urdf = ARM.urdf.decode()
    joint = '<joint name="rail" type="prismatic"><parent link="floor"/><child link="{}"/><axis xyz="1 0 0"/>'
    limit = '<limit lower="0" upper="3" effort="1" velocity="1"/></joint><link name="floor"/></robot>'
    moved = urdf.replace("</robot>", joint.format(ARM.base) + limit)
    return parse_robot(moved.encode(), ARM.tip)


def test_external_axes_of_a_pose_are_held() -> None:
    cell = Cell(on_a_rail(), start=True)
    assert cell.axes.external
    text = main("MoveL [[500,10,300],[0,0,1,0],[0,0,0,0],[1500,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;")["a.mod"]
    (target,) = ROW.read(Project((SourceFile(Path("a.mod"), text),)), cell).targets
    assert target.branch.held is not None
    assert np.nansum(target.branch.held) == pytest.approx(1.5)
    off = text.replace("PROC main()\n", "PROC main()\nDeactUnit TRACK;\n")
    (target,) = ROW.read(Project((SourceFile(Path("a.mod"), off),)), cell).targets
    assert "external axes" in target.why


def test_a_frame_in_place_of_a_truth_leaves_the_moves_and_nothing_else() -> None:
    """Found by chance: what stands for a part of a work object was asked for its hash."""
    text = (
        'MODULE M\n  TASK PERS wobjdata w:=[FALSE,tool0,"",[[500,0,200],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
        f"  PROC main()\n    MoveAbsJ [[0,-20,30,0,40,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v,z,tool0;\n    w.oframe.trans.x:=ai1;\n"
        f"    MoveL {POSE},v,z,tool0\\WObj:=w;\n    MoveL {OTHER},v,z,tool0;\n  ENDPROC\nENDMODULE\n"
    )
    left, plain = (target for target in read({"m.mod": text}).targets if target.form == "pose")
    assert left.why and not plain.why


@pytest.mark.parametrize("name", ["Punkt", "Größe", "Ωμέγα", "点", "jH\u2028"])
def test_a_name_of_any_script_is_folded_once_whatever_the_bytes_are(name: str) -> None:
    as_read = name.encode("utf-8").decode("latin-1")
    assert fold(as_read) == name.lower() == fold(fold(as_read))
