"""TP programs of FANUC: a point is corrected where the program uses it for one place, and that place is certain."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from program_attacks.fanuc import (
    ACTIVE,
    ANYWHERE,
    BEFORE,
    FRAME_SET,
    FRAMES,
    GO,
    KNOWN,
    OPTIONS,
    RIGHT,
    SHIFTED,
    START,
    listing,
    point,
)
from robots import ur10
from scipy.spatial.transform import Rotation
from six_axes import robot

from aridcal.engine.robot.chain import parse_robot
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.fanuc import ROW
from aridcal.jobs.apply.programs.frames import KnownFrames, read_frames
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.targets import PoseReference, Target

MARKS = re.compile("[⟦⟧⟨⟩]")


ARM = robot()


def frames_of(text: str, folder: Path) -> KnownFrames:
    path = folder / "frames.yaml"
    path.write_text(text)
    return read_frames(path)


def stated(frames: KnownFrames | None = None) -> Cell:
    eye = {str(n): np.eye(4) for n in range(1, 4)}
    return Cell(ARM, frames if frames is not None else KnownFrames(eye, eye, j3_from_link_2=True))


def read(text: str, cell: Cell | None = None, ours: bool = True, **others: str) -> ProgramReading:
    """What is read of a program and of other files that are not corrected."""
    sources = [SourceFile(Path("main.ls"), text, ours)]
    sources += [SourceFile(Path(name.replace("_", ".")), other, False) for name, other in others.items()]
    return ROW.read(Project(tuple(sources)), cell or stated())


def by_name(reading: ProgramReading) -> dict[str, Target]:
    return {target.name: target for target in reading.targets}


def why(text: str, name: str = "P[1]", **others: str) -> str:
    return by_name(read(text, None, True, **others))[name].why


def place(text: str, cell: Cell | None = None, name: str = "P[1]", **others: str) -> PoseReference:
    target = by_name(read(text, cell, True, **others))[name]
    assert target.why == "" and target.place is not None
    return target.place


def marked(files: dict[str, str], cell: Cell) -> list[tuple[str, bool]]:
    """The mark before each marked number, and whether the target that it belongs to is corrected."""
    plain = {name: MARKS.sub("", text) for name, text in files.items()}
    sources = tuple(SourceFile(Path(name), text, True) for name, text in plain.items())
    targets = ROW.read(Project(sources), cell).targets
    corrected = {(t.file, n.start) for t in targets if not t.why for n in t.numbers}
    return [
        (match.group(), (file, match.start() - marks_before) in corrected)
        for file, text in enumerate(files.values())
        for marks_before, match in enumerate(MARKS.finditer(text))
        if match.group() in "⟦⟨"
    ]


CONTROLS = (
    [(name, [*START, GO]) for name, _ in (*OPTIONS, *BEFORE, *ANYWHERE)]
    + [(name, ["UFRAME_NUM=1", "UTOOL_NUM=1", GO]) for name, _ in ACTIVE]
    + [("a shift", [*KNOWN, SHIFTED]), ("a frame", [*FRAME_SET, GO])]
)


@pytest.mark.parametrize(("name", "lines"), CONTROLS)
def test_without_the_construct_the_point_is_corrected(name: str, lines: list[str], tmp_path: Path) -> None:
    text = listing(lines, [point(1, RIGHT), point(2, RIGHT if "L P[2] 100mm/sec FINE" in lines else ("", ""))])
    assert all(corrected for _, corrected in marked({"main.ls": text}, stated(frames_of(FRAMES, tmp_path))))


HARMLESS = (
    "R[1]=R[2]+1", "R[R[1]]=GI[3:part]", "SR[1]=SR[2]+R[1]", "DO[1:a place]=ON", "RO[3]=PULSE,0.5sec", "GO[2]=R[1]",
    "F[1]=(DI[1] AND !DI[2])", "AO[1]=2", "TIMER[1]=START", "WAIT   1.00(sec)", "WAIT DI[1]=ON", "WAIT (DI[1] AND F[2])",
    "PAUSE", "UALM[1]", "MESSAGE[go to P 1]", "SKIP CONDITION DI[1]=ON", "OVERRIDE=50%", "JOINT_MAX_SPEED[1]=20",
    "LINEAR_MAX_SPEED=250", "PAYLOAD[2:part]", "PAYLOAD[GP1:2]", "COL DETECT ON", "COL GUARD ADJUST 90", "TC_ONLINE (ON)",
    "LOCK PREG", "UNLOCK PREG", "$WAITTMOUT=200", "$[KAREL]count=1", "Arc Start[1]", "Weld End[1,1]", "Weave Sine[1]",
    "Weave End", "SPOT[SD=1,P=2]", "VISION RUN_FIND 'A'", "RSR[1]=ENABLE", "SEMAPHORE[1]=ON", "!a remark: UFRAME_NUM=2",
    "//UFRAME_NUM=2", "--eg:UFRAME_NUM=2", "PR[5]=LPOS", "PR[5,3]=7", "LPR[1]=LPOS", "UFRAME_NUM[GP2]=2", "UFRAME[3]=PR[9]",
    "UTOOL[3]=PR[9]", "UFRAME[GP2:1]=PR[9]", "VOFFSET CONDITION VR[1]", "IF R[1]=1,JMP LBL[99]", "JMP LBL[99]",
    "PRESS_MOTN[1]", "SS[1]", "SE", "GUN[1]=ON", "PALLETIZING-B_1", "------", "TORQ_LIMIT 80.0%",
    "CLEAR_RESUME_PROG", "P[5]=LPOS", "P[5,3]=7",
    "TOOL_OFFSET CONDITION PR[1]", "OFFSET CONDITION PR[1]",
    "SELECT R[1]=1,JMP LBL[99]",
    "PL[1]=[1,1,1]", "MONITOR END HANDLER", "DIAG_REC[1,2,3]", "Stitch Start", "AR[1]=5",
)  # fmt: skip


@pytest.mark.parametrize("line", HARMLESS)
def test_an_instruction_that_has_nothing_to_do_with_places_changes_none(line: str) -> None:
    text = listing([*START, line, GO, "LBL[99]", "L P[2] 100mm/sec FINE"], [point(1), point(2)])
    targets = by_name(read(text))
    assert [targets[name].why for name in ("P[1]", "P[2]")][1:] == [""]
    assert line == "JMP LBL[99]" or targets["P[1]"].why == ""


HARMLESS_OPTIONS = (
    "", "ACC80", "ACC R[1]", "PTH", "Wjnt", "BREAK", "CTV50", "EV50%", "Ind.EV50%", "RT_LD5.0", "AP_LD100", "PSPD80",
    "TB .05sec,DO[1]=ON", "TA 0.10sec,GO[2]=5", "DB 5.0mm,RO[1]=PULSE,0.2sec", "TB .10sec,P-SPS", "TIME BEFORE 0.5 sec,DO[1]=OFF",
    "Skip,LBL[1]", "SkipJump,LBL[1]", "Skip,LBL[1],PR[7]=LPOS", "Arc Start[1]", "Weld End[1,2]", "SPOT[SD=1,P=R[2]]",
    "ACC80 PTH Wjnt TB .05sec,DO[1]=(F[1])", "\n    :  Arc End[1]",
)  # fmt: skip


@pytest.mark.parametrize("option", HARMLESS_OPTIONS)
def test_an_option_that_changes_the_way_alone_leaves_the_place(option: str) -> None:
    assert why(listing([*START, f"{GO} {option}", "LBL[1]"], [point(1), point(2)])) == ""


LEFT_OPTIONS = (
    "INC",
    "VOFFSET,VR[1]",
    "VOFFSET",
    "RTCP",
    "COORD",
    "COORD[2]",
    "MROT",
    "Offset,PR[1]",
    "Tool_Offset,PR[R[1]]",
)


@pytest.mark.parametrize("option", LEFT_OPTIONS)
def test_an_option_that_moves_the_place_matters_to_its_own_move_alone(option: str) -> None:
    lines = ["UFRAME_NUM=1", f"{GO} {option}", "L P[2] 9mm/sec FINE"]
    targets = by_name(read(listing(lines, [point(1), point(2)])))
    assert "line 6" in targets["P[1]"].why
    assert targets["P[2]"].why == ""


def test_a_program_called_at_a_time_is_followed() -> None:
    text = listing([f"{GO} TB .10sec,CALL SUB(1)", "L P[2] 9mm/sec FINE"], [point(1), point(2)])
    targets = by_name(read(text, None, True, sub_ls=listing(["DO[1]=ON"], name="SUB")))
    assert [targets[name].why for name in ("P[1]", "P[2]")] == ["", ""]


PLAIN_HEADERS = (
    "/APPL\n",
    "/APPL\n/APPL\n\nAUTO_SINGULARITY_HEADER;\n  ENABLE_SINGULARITY_AVOIDANCE   : TRUE;\n",
    "/APPL\n  ARC Welding Equipment : 1,*,*,*,*;\n",
    "/APPL\n  SPOT : TRUE ;\n  SPOT Welding Equipment Number : 1 ;\n",
    "/APPL\nLINE_TRACK;\n  LINE_TRACK_SCHEDULE_NUMBER      : 0;\n  LINE_TRACK_BOUNDARY_NUMBER      : 0;\n"
    "  CONTINUE_TRACK_AT_PROG_END      : FALSE;\n",
    "/APPL\nPLTZ_MODE_HEADER;\n PLTZ_MODE_ENABLE   : FALSE;\n J4TURN  : ZERORAD;\n ORIENT  : DOWNWARDS;\n",
)


@pytest.mark.parametrize("header", PLAIN_HEADERS)
def test_application_data_that_leave_points_where_they_are_are_known(header: str) -> None:
    assert why(listing([*START, GO], [point(1), point(2)], header=header)) == ""


MOVES = (
    "J P[1:a place] 100% FINE", "J P[1] R[1:speed]% CNT50", "L P[1] 250mm/sec CNT R[2]", "L P[1] 10cm/min CR5",
    "L P[1] 100inch/min CNT0", "L P[1] 90deg/sec FINE", "L P[1] max_speed CNT100", "L P[1] WELD_SPEED CNT100",
    "C P[2]    \n    :  P[1] 100mm/sec FINE", "C P[1] P[2] 100mm/sec FINE", "A P[1] 100mm/sec CNT100",
    "l p[1] 100MM/SEC fine", "L  P [ 1 ]  100 mm/sec  CNT 50", "L P[1] AR[2]mm/sec FINE", "L P[1] 2.5sec FINE",
    "J P[1] 500msec FINE",
)  # fmt: skip


@pytest.mark.parametrize("move", MOVES)
def test_every_kind_of_motion_goes_to_its_points(move: str) -> None:
    assert why(listing([*START, move], [point(1), point(2)])) == ""


def test_the_frame_and_the_tool_are_those_of_the_numbers(tmp_path: Path) -> None:
    cell = stated(frames_of(FRAMES, tmp_path))
    text = listing(["UFRAME_NUM=2", "UTOOL_NUM=2", GO], [point(1, user="2", tool="2")])
    own = place(text, cell)
    np.testing.assert_allclose(own.base, cell.frames.bases["2"])
    np.testing.assert_allclose(own.tool, cell.frames.tools["2"])
    active = place(text.replace("UF : 2, UT : 2", "UF : F, UT : F"), cell)
    np.testing.assert_allclose(active.base, own.base)
    np.testing.assert_allclose(active.tool, own.tool)


def test_a_point_s_own_numbers_hold_where_nothing_sets_the_active_ones(tmp_path: Path) -> None:
    cell = stated(frames_of(FRAMES, tmp_path))
    np.testing.assert_allclose(place(listing([GO], [point(1, user="2")]), cell).base, cell.frames.bases["2"])
    for lines in (["UFRAME_NUM=R[1]", GO], ["UFRAME_NUM=2", "UTOOL_NUM=AR[2]", GO]):
        assert "of the active one" in by_name(read(listing(lines, [point(1, user="2")]), cell))["P[1]"].why


def test_the_controller_stops_at_a_point_of_another_frame() -> None:
    text = listing(["UFRAME_NUM=2", GO], [point(1)])
    assert why(text) == "is in user frame 1, but line 5 has set 2: the controller stops at line 6"


def test_the_world_frame_is_where_the_user_states_it_or_the_link_base_of_the_urdf() -> None:
    text = listing(["UFRAME_NUM=0", "UTOOL_NUM=0", GO], [point(1, user="0", tool="0")])
    own = place(text, stated(KnownFrames()))
    np.testing.assert_allclose(own.base, np.eye(4))
    np.testing.assert_allclose(own.tool, np.eye(4))
    raised, longer = np.eye(4), np.eye(4)
    raised[2, 3], longer[2, 3] = 0.67, 0.2
    there = place(text, stated(KnownFrames({"0": raised}, {"0": longer})))
    np.testing.assert_allclose(there.base, raised)
    np.testing.assert_allclose(there.tool, longer)
    foot = (
        '<joint name="b" type="fixed"><parent link="l0"/><child link="base"/><origin xyz="0 0 0.67"/></joint>'
        '<link name="base"/>'
    )
    lifted = replace(stated(KnownFrames()), robot=robot(foot))
    reading = read(text, lifted)
    own_place = by_name(reading)["P[1]"].place
    assert own_place is not None
    np.testing.assert_allclose(own_place.base, raised)
    assert any("link base" in note for note in reading.notes)
    assert any("user tool 0" in note for note in reading.notes)


def xyzwpr(*numbers: float) -> np.ndarray:
    """X Y Z W P R as the manual has them: turned about the fixed x, then y, then z."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", numbers[3:], degrees=True).as_matrix(), np.array(numbers[:3]) / 1e3
    return T


def test_an_offset_of_a_register_that_the_program_sets_is_followed(tmp_path: Path) -> None:
    cell = stated(frames_of(FRAMES, tmp_path))
    zero = ["PR[1]=LPOS", "PR[1]=PR[1]-PR[1]", "PR[1,1]=(-10)", "PR[1,2]=PR[1,1]+4", "PR[1,3]=50", "PR[2]=PR[1]"]
    direct = place(listing([*zero, GO], [point(1)]), cell)
    offset = place(listing([*zero, f"{GO} Offset,PR[2]"], [point(1)]), cell)
    np.testing.assert_allclose(offset.base, direct.base @ xyzwpr(-10, -6, 50, 0, 0, 0), atol=1e-12)
    np.testing.assert_allclose(offset.tool, direct.tool)
    tool = place(listing([*zero, f"{GO} Tool_Offset,PR[2]"], [point(1)]), cell)
    np.testing.assert_allclose(tool.base, direct.base)
    P = np.linalg.inv(direct.base) @ direct.tool  # any pose: the tip is at base P offset tool^-1
    np.testing.assert_allclose(
        P @ np.linalg.inv(tool.tool), P @ xyzwpr(-10, -6, 50, 0, 0, 0) @ np.linalg.inv(direct.tool), atol=1e-12
    )
    both = by_name(read(listing([*zero, f"{GO} Offset,PR[1]", GO], [point(1)]), cell))["P[1]"]
    assert both.why == "" and len(both.beside) == 1 and both.place is not None
    np.testing.assert_allclose(both.place.base, direct.base)
    by_condition = place(listing([*zero, "OFFSET CONDITION PR[2]", f"{GO} Offset"], [point(1)]), cell)
    np.testing.assert_allclose(by_condition.base, offset.base)
    tool_by_condition = place(listing([*zero, "TOOL_OFFSET CONDITION PR[2]", f"{GO} Tool_Offset"], [point(1)]), cell)
    np.testing.assert_allclose(tool_by_condition.tool, tool.tool)
    changed = [*zero, "OFFSET CONDITION PR[2]", "PR[2,1]=9", f"{GO} Offset"]
    assert "not certain" in by_name(read(listing(changed, [point(1)]), cell))["P[1]"].why
    called = [*zero, "OFFSET CONDITION PR[2]", "CALL SUB", f"{GO} Offset"]
    sub = listing(["R[1]=1"], name="SUB")
    assert "not certain" in by_name(read(listing(called, [point(1)]), cell, True, sub_ls=sub))["P[1]"].why


def test_a_frame_that_the_program_sets_from_a_known_register_is_followed() -> None:
    numbers = (100.0, -20.0, 30.0, 10.0, 20.0, 30.0)
    register = ["PR[4]=LPOS", *(f"PR[4,{k}]={value}" for k, value in enumerate(numbers, start=1))]
    raised = np.eye(4)
    raised[2, 3] = 0.67
    cell = stated(KnownFrames({"0": raised}, {"1": np.eye(4)}))
    own = place(listing([*register, "UFRAME[1]=PR[4]", "UTOOL[1]=PR[4]", GO], [point(1)]), cell)
    np.testing.assert_allclose(own.base, raised @ xyzwpr(*numbers), atol=1e-12)
    np.testing.assert_allclose(own.tool, xyzwpr(*numbers), atol=1e-12)


def test_a_register_that_may_hold_joints_is_no_shift() -> None:
    elements = [f"PR[1,{k}]=0" for k in range(1, 7)]
    assert "not certain" in why(listing([*elements, SHIFTED], [point(1)]))
    assert "not certain" in why(listing(["PR[1]=JPOS", *elements, SHIFTED], [point(1)]))
    assert why(listing(["PR[1]=LPOS", *elements, SHIFTED], [point(1)])) == ""


SYSFRAME = """<HTML> <PRE>
[*SYSTEM*]$MNUFRAME  Storage: SHADOW  Access: RW  : ARRAY[2,9] OF POSITION
     [1,1] =
  Group: 1   Config: N D B, 0, 0, 0
  X:   100.000   Y:   -20.500   Z:    30.000
  W:    10.000   P:    20.000   R:   -30.000
     [1,2] =   'table'
  Group: 1   Config: N D B, 0, 0, 0
  X:     1.000   Y:     2.000   Z:     3.000
  W:     0.000   P:     0.000   R:    90.000
     [1,3] = Uninitialized
     [2,1] =
  Group: 2   Config: N D B, 0, 0, 0
  X:   999.000   Y:     0.000   Z:     0.000
  W:     0.000   P:     0.000   R:     0.000
[*SYSTEM*]$MNUFRAMENUM  Storage: SHADOW  Access: RW  : ARRAY[2] OF BYTE
     [1] = 7
[*SYSTEM*]$MNUTOOL  Storage: SHADOW  Access: RW  : ARRAY[2,10] OF POSITION
     [1,1] =
  Group: 1   Config: N D B, 0, 0, 0
  X:     0.000   Y:     0.000   Z:   150.750
  W:     0.000   P:   -90.000   R:     0.000
</PRE> </HTML>
"""

FRAME_DG = """F Number: F00000

Tool Frame
   0.0     0.0   150.8     0.0   -90.0     0.0 Eoat1

Jog Frame
   9.0     0.0     0.0     0.0     0.0     0.0

User Frame
 100.0   -20.5    30.0    10.0    20.0   -30.0 UFrame1
   1.0     2.0     3.0     0.0     0.0    90.0 table
"""


def test_frames_of_the_controller_are_read_from_its_listings() -> None:
    raised = np.eye(4)
    raised[2, 3] = 0.67
    cell = stated(KnownFrames({"0": raised}))
    text = listing([GO], [point(1)])
    exact = place(text, cell, sysframe_va=SYSFRAME)
    np.testing.assert_allclose(exact.base, raised @ xyzwpr(100, -20.5, 30, 10, 20, -30), atol=1e-12)
    np.testing.assert_allclose(exact.tool, xyzwpr(0, 0, 150.75, 0, -90, 0), atol=1e-12)
    rounded = place(text, cell, frame_dg=FRAME_DG.replace("\n", "\r\n"))
    np.testing.assert_allclose(rounded.tool, xyzwpr(0, 0, 150.8, 0, -90, 0), atol=1e-12)
    both = place(text, cell, frame_dg=FRAME_DG, sysframe_va=SYSFRAME)
    np.testing.assert_allclose(both.tool, exact.tool, atol=1e-12)
    for number in ("3", "9"):
        assert (
            "state it with --frames" in why(listing([GO], [point(1, user=number)]), sysframe_va=SYSFRAME)
            or number == "3"
        )
    reading = read(text, cell, True, sysframe_va=SYSFRAME)
    assert "user frames and tools are those of sysframe.va" in reading.notes


def test_a_frame_that_is_stated_twice_and_not_alike_is_not_known() -> None:
    text = listing([GO], [point(1, user="2")])
    assert "stated twice" in why(text, sysframe_va=SYSFRAME)  # here --frames say that it is the world
    alike = KnownFrames({"2": xyzwpr(1, 2, 3, 0, 0, 90)}, {"1": np.eye(4)})
    own = by_name(read(text, stated(alike), True, sysframe_va=SYSFRAME))["P[1]"]
    assert "user tool 1" in own.why and "user frame" not in own.why


def test_a_listing_is_not_believed_where_a_given_program_sets_the_frame() -> None:
    text = listing([GO], [point(1, user="2")])
    setter = listing(["UFRAME[2]=PR[1]"], name="SETTER")
    cell = stated(KnownFrames())
    assert by_name(read(text, cell, True, sysframe_va=SYSFRAME))["P[1]"].why == ""
    reason = by_name(read(text, cell, True, sysframe_va=SYSFRAME, setter_ls=setter))["P[1]"].why
    assert reason == "setter.ls line 5 sets this user frame, perhaps in a run before"
    assert why(text, setter_ls=setter) == ""  # what the user states is believed against a program that is not called
    calls = listing([GO, "CALL SETTER"], [point(1, user="2")])
    assert "in a run before" in why(calls, setter_ls=setter)


def test_a_called_program_is_walked_in_the_state_of_its_caller() -> None:
    sub = listing([GO], [point(1, user="F", tool="F")], name="SUB")
    caller = listing(["UFRAME_NUM=2", "UTOOL_NUM=2", "CALL SUB"], name="CALLER")
    cell = stated(KnownFrames({"2": xyzwpr(1, 2, 3, 4, 5, 6)}, {"2": xyzwpr(6, 5, 4, 3, 2, 1)}))
    own = place(sub, cell, caller_ls=caller)
    np.testing.assert_allclose(own.base, xyzwpr(1, 2, 3, 4, 5, 6))
    np.testing.assert_allclose(own.tool, xyzwpr(6, 5, 4, 3, 2, 1))
    other = listing(["UFRAME_NUM=1", "UTOOL_NUM=2", "CALL SUB"], name="OTHER")
    assert by_name(read(sub, cell, True, caller_ls=caller, other_ls=other))["P[1]"].why != ""


def test_points_of_called_programs_that_are_not_given_to_be_corrected_are_named_as_that() -> None:
    main = listing([GO, "CALL SUB"], [point(1)])
    sub = listing(["L P[7] 9mm/sec FINE"], [point(7)], name="SUB")
    idle = listing(["L P[8] 9mm/sec FINE"], [point(8)], name="IDLE")
    targets = by_name(read(main, None, True, sub_ls=sub, idle_ls=idle))
    assert targets["P[1]"].why == "" and "P[8]" not in targets
    assert targets["P[7]"].why == "stands in sub.ls, which is not corrected: give it, too"


def test_of_two_programs_of_one_name_none_is_taken() -> None:
    main = listing(["CALL SUB", GO], [point(1)])
    sub, bad = listing(["R[1]=1"], name="SUB"), listing(["UFRAME[1]=PR[1]"], name="SUB")
    assert why(main, sub_ls=sub) == ""
    assert "SUB is in no given file" in why(main, sub_ls=sub, old_ls=bad)


def test_programs_that_the_user_states_to_be_harmless_change_nothing() -> None:
    text = listing(["CALL GRIP(1)", "RUN WATCH", "Open hand 1", GO], [point(1)])
    eye = {"1": np.eye(4)}
    stated_harmless = stated(KnownFrames(eye, eye, None, frozenset({"grip", "watch", "open hand 1"})))
    assert by_name(read(text, stated_harmless))["P[1]"].why == ""
    assert why(text) != ""


def test_a_task_that_is_given_makes_unknown_only_what_it_sets() -> None:
    main = listing(["RUN WATCH", GO], [point(1)])
    assert why(main, watch_ls=listing(["LBL[1]", "R[5]=DI[1]", "PR[3]=LPOS", "JMP LBL[1]"], name="WATCH")) == ""
    moved = listing(["RUN WATCH", *KNOWN, SHIFTED], [point(1)])
    assert "not certain" in why(moved, watch_ls=listing(["PR[1,1]=R[1]"], name="WATCH"))


def test_modes_end_where_the_program_ends_them() -> None:
    for begin, end in (
        ("Track TAST[1]", "Track End"),
        ("Touch Offset PR[1]", "Touch Offset End"),
        ("Search Start[1] PR[1]", "Search End"),
        ("MP Offset PR[1]", "MP Offset End"),
        ("SOFTFLOAT[1]", "SOFTFLOAT END"),
    ):
        lines = [begin, "L P[2] 9mm/sec FINE", end, GO]
        targets = by_name(read(listing(lines, [point(1), point(2)])))
        assert targets["P[1]"].why == ""
        assert "from line 5 on" in targets["P[2]"].why
    nested = ["SOFTFLOAT[1]", "Track TAST[1]", "Track End", GO]
    assert "soft float" in why(listing(nested, [point(1)]))


def test_labels_in_branches_and_loops_are_followed() -> None:
    inside = [
        "UFRAME_NUM=1",
        "IF (R[1]=1) THEN",
        "LBL[1]",
        "R[2]=R[2]+1",
        "IF R[2]<5,JMP LBL[1]",
        "ELSE",
        "R[1]=2",
        "ENDIF",
        GO,
    ]
    assert why(listing(inside, [point(1, user="F")])) == ""
    loop = ["UFRAME_NUM=1", "FOR R[1]=1 TO 5", "IF DI[1]=ON,JMP LBL[9]", "R[3]=1", "LBL[9]", "ENDFOR", GO]
    assert why(listing(loop, [point(1, user="F")])) == ""
    changing = ["UFRAME_NUM=1", "WHILE (R[1]=1)", "LBL[9]", "UFRAME_NUM=2", "ENDWHILE", GO]
    assert why(listing(changing, [point(1, user="F")])) != ""
    out = ["UFRAME_NUM=1", "IF (R[1]=1) THEN", "UFRAME_NUM=2", "LBL[3]", "ELSE", "UFRAME_NUM=2", "ENDIF", GO]
    assert by_name(read(listing(out, [point(1, user="F")])))["P[1]"].why == ""


def test_what_comes_behind_an_end_or_an_abort_is_not_carried_out() -> None:
    for end in ("END", "ABORT"):
        lines = [GO, "IF R[1]=1,JMP LBL[1]", end, "UFRAME_NUM=2", "LBL[1]", "L P[2] 9mm/sec FINE"]
        targets = by_name(read(listing(["UFRAME_NUM=1", *lines], [point(1), point(2, user="F")])))
        assert targets["P[1]"].why == "" and targets["P[2]"].why == ""
        behind = listing([GO, end, "L P[2] 9mm/sec FINE"], [point(1), point(2)])
        assert "no move of the given files goes there" in why(behind, "P[2]")


def test_loops_in_loops_are_followed_in_any_depth() -> None:
    for depth in (2, 4, 5, 30):
        loops, ends = ["FOR R[1]=1 TO 2"] * depth, ["ENDFOR"] * depth
        same = ["UFRAME_NUM=1", *loops, "UFRAME_NUM=1", *ends, GO]
        assert why(listing(same, [point(1, user="F")])) == ""
        other = ["UFRAME_NUM=1", *loops, GO, "UFRAME_NUM=2", *ends]
        assert why(listing(other, [point(1, user="F")])) != ""


def test_selections_join_their_branches() -> None:
    sets = {f"s{k}_ls": listing([f"UFRAME_NUM={k}"], name=f"S{k}") for k in (1, 2)}
    same = ["SELECT R[1]=1,CALL S1", "=2,CALL S1", "ELSE,CALL S1", GO]
    assert why(listing(same, [point(1, user="F")]), **sets) == ""
    other = ["SELECT R[1]=1,CALL S1", "=2,CALL S2", "ELSE,CALL S1", GO]
    assert why(listing(other, [point(1, user="F")]), **sets) != ""
    open_ended = ["SELECT R[1]=1,CALL S1", "=2,CALL S1", GO]
    assert why(listing(open_ended, [point(1, user="F")]), **sets) != ""


def test_comments_of_points_hold_brackets_of_any_kind() -> None:
    text = listing([GO, "L P[2] 9mm/sec FINE"], [point(1), point(2)])
    for comment in ('"a]b{"', '"}; P[9]{"', '"it\'s"', '""', '"a"b"'):
        targets = by_name(read(text.replace("P[1]{", f"P[1:{comment}]{{")))
        assert [targets[f"P[{k}]"].why for k in (1, 2)] == ["", ""]


def joints(number: int, j1: str = "10.000", more: str = "") -> str:
    return (
        f"P[{number}]{{\n   GP1:\n\tUF : 9, UT : 9,\t\n\tJ1=    {j1} deg,\tJ2=    71.314 deg,\tJ3=   -40.004 deg,\n"
        f"\tJ4=      .574 deg,\tJ5=   -50.086 deg,\tJ6=   145.670 deg{more}\n}};\n"
    )


def test_joints_need_no_frame_and_no_tool() -> None:
    reading = read(listing(["UFRAME_NUM=2", GO], [joints(1)]), stated(KnownFrames(j3_from_link_2=True)))
    target = by_name(reading)["P[1]"]
    assert target.why == "" and target.form == "joints" and target.readings is not None
    np.testing.assert_allclose(target.readings, np.radians([10, 71.314, -40.004, 0.574, -50.086, 145.67]))
    assert not any("J3" in note for note in reading.notes)
    assert "shifts joints" in why(listing([f"{GO} Tool_Offset,PR[1]"], [joints(1)]))
    assert "shifts joints" in why(listing([*KNOWN, SHIFTED], [joints(1)]))
    assert "axis J7" in why(listing([GO], [joints(1, more=",\n\tJ7=  1.000 mm")]))
    assert "in mm" in why(listing([GO], [joints(1).replace("10.000 deg", "10.000 mm")]))
    assert "all joints" in why(listing([GO], [joints(1).replace(",\tJ6=   145.670 deg", "")]))


def test_joints_of_an_arm_whose_j3_may_count_from_the_horizontal_are_left_unless_the_user_states_otherwise(
    tmp_path: Path,
) -> None:
    text = listing(["J P[1] 9% FINE", GO.replace("P[1]", "P[2]")], [joints(1), point(2, config="")])
    bare, other = stated(KnownFrames()), Cell(ur10(), KnownFrames())
    assert bare.anatomy is not None and other.anatomy is None
    left = by_name(read(text, bare))
    assert "from the horizontal" in left["P[1]"].why and "j3_from_link_2" in left["P[1]"].why
    assert (
        "--start" in left["P[2]"].branch.unknown or left["P[2]"].why
    )  # nobody knows where a misread target has taken the arm
    known = stated(frames_of("format: 1\nj3_from_link_2: true\n", tmp_path))
    assert by_name(read(text, known))["P[1]"].why == ""
    said = read(text, other)  # nobody can tell whether it is such an arm: it is asked
    assert by_name(said)["P[1]"].why == "" and any("J3" in note for note in said.notes)


def test_a_second_group_belongs_to_another_arm() -> None:
    second = point(1).replace("\n};", "\n   GP2:\n\tUF : 3, UT : 3,\t\n\tJ1=   100.000  mm\n};")
    target = by_name(read(listing([GO], [second])))["P[1]"]
    assert target.why == "" and len(target.numbers) == 6
    first = point(1).replace("   GP1:", "   GP2:\n\tUF : 3, UT : 3,\t\n\tJ1=   100.000  mm\n   GP1:")
    assert by_name(read(listing([GO], [first])))["P[1]"].why == ""


def test_external_axes_of_a_rail_are_held() -> None:
    rail = (
        '<joint name="r" type="prismatic"><parent link="l0"/><child link="c"/><axis xyz="0 1 0"/>'
        '<limit lower="-5" upper="5" effort="1" velocity="1"/></joint><link name="c"/>'
    )
    urdf = robot().urdf.decode().replace('<parent link="l0"/>', '<parent link="c"/>').replace(
        '<link name="l0"/>', f'<link name="l0"/>{rail}'
    )  # fmt: skip
    own = parse_robot(urdf.encode(), "l6", "l0", Path("f.urdf"))
    text = listing([GO], [point(1).replace("-68.968 deg", "-68.968 deg,\n\tE1= -1290.500  mm")])
    target = by_name(read(text, replace(stated(), robot=own)))["P[1]"]
    assert target.why == "" and target.branch.held is not None
    np.testing.assert_allclose(target.branch.held, [-1.2905, *[np.nan] * 6])


def test_where_the_arm_comes_from_is_asked_only_of_poses_without_a_posture() -> None:
    without = [point(1, config=""), point(2, config="")]
    first = by_name(read(listing([GO], without)))["P[1]"]
    assert first.why == "" and "--start" in first.branch.unknown
    known = by_name(read(listing(["J P[3] 9% FINE", GO], [*without, joints(3)])))["P[1]"]
    assert known.branch.unknown == ""
    lost = by_name(read(listing(["J P[3] 9% FINE", "J PR[1] 9% FINE", GO], [*without, joints(3)])))["P[1]"]
    assert "--start" in lost.branch.unknown
    kept = by_name(read(listing(["J P[3] 9% FINE", "L PR[1] 9mm/sec FINE", GO], [*without, joints(3)])))["P[1]"]
    assert kept.branch.unknown == ""
    begun = by_name(read(listing([GO], without), replace(stated(), start=True)))["P[1]"]
    assert begun.branch.unknown == ""


def test_targets_come_in_the_order_in_which_the_program_goes_there() -> None:
    lines = ["L P[3] 9mm/sec FINE", "L PR[4] 9mm/sec FINE", "L P[1] 9mm/sec FINE", "L P[3] 9mm/sec FINE"]
    targets = read(listing(lines, [point(k) for k in (1, 2, 3)])).targets
    assert [target.name for target in targets] == ["P[3]", "P[1]", "P[2]", "PR[4]"]


def test_line_ends_and_byte_order_marks_of_any_kind_are_read_alike() -> None:
    text = listing(
        ["UFRAME_NUM=1", "!tête", f"{GO} ACC80", "C P[2]    \n    :  P[3] 9mm/sec FINE"], [point(k) for k in (1, 2, 3)]
    )
    plain = [(t.name, t.why, t.values.tolist()) for t in read(text).targets]
    assert len(plain) == 3 and not any(reason for _, reason, _ in plain)
    small = re.sub(r"/[a-z]+|'n u t", lambda match: match.group().upper(), text.lower())
    others = (text.replace("\n", "\r\n"), "\xef\xbb\xbf" + text, text.replace("    ;", "\t;"), small)
    for other in others:
        assert [(t.name, t.why, t.values.tolist()) for t in read(other).targets] == plain


def test_the_project_is_the_programs_and_listings_beside_a_program(tmp_path: Path) -> None:
    for name in ("MAIN.LS", "sub.ls", "SYSFRAME.VA", "frame.dg", "numreg.va", "readme.txt"):
        (tmp_path / name).write_text("")
    assert [path.name for path in ROW.context(tmp_path / "MAIN.LS")] == ["SYSFRAME.VA", "frame.dg", "sub.ls"]
    assert ROW.context(tmp_path / "nowhere" / "main.ls") == []


MANY = 9999

BEGUN = "/PROG A\n/MN\n"

ODD = (
    "", "/PROG", "/PROG  A", "/PROG A\n/MN\n/POS\n/END", "/PROG A\n/POS\nP[1]{", "/MN\n  1:L P[1] 9mm/sec FINE ;\n",
    BEGUN + ";" * MANY, BEGUN + "IF (R[1]=1) THEN ;\n" * MANY + "/POS\n" + point(1),
    BEGUN + "IF R[1]=1," * MANY + ";\n/POS\n" + point(1), BEGUN + "[" * MANY + ";", BEGUN + "'" * MANY, BEGUN + "!" * MANY,
    BEGUN + "L P[1] " * MANY + ";", "/PROG A\n/POS\n" + "P[" * MANY, "/PROG A\n/POS\n" + 'P[1:"' * MANY,
    BEGUN + "\n" * MANY, BEGUN + "!" + "\n" * MANY, BEGUN + "9" * MANY + ":L P[" + "9" * MANY + "] 9mm/sec FINE ;\n",
    BEGUN + " 1:L P[1] 9mm/sec FINE ;\n/POS\nP[" + "1" * MANY + "]{\n GP1:\n UF : " + "9" * MANY + ", UT : 1,\n};",
    BEGUN + " 1: PR[" + "1" * MANY + ",3]=" + "9" * MANY + " ;\n", BEGUN + " 1: CALL A ;\n", BEGUN + " 1: RUN A ;\n",
    BEGUN + " 1: UFRAME_NUM=" + "9" * MANY + " ;\n", BEGUN + "LBL[1] ;\nJMP LBL[1] ;\n" * 999,
)  # fmt: skip


@pytest.mark.parametrize("text", ODD, ids=range(len(ODD)))
def test_texts_of_any_kind_are_read_without_a_fault(text: str) -> None:
    assert all(target.why for target in read(text, None, True, sysframe_va=text, frame_dg=text).targets)


def test_blocks_in_blocks_beyond_what_is_followed_leave_all() -> None:
    deep = listing([*["IF (R[1]=1) THEN"] * 200, GO, *["ENDIF"] * 200], [point(1)])
    assert "more ways than can be followed" in why(deep)
    flat = listing([*["IF (R[1]=1) THEN"] * 40, GO, *["ENDIF"] * 40], [point(1)])
    assert why(flat) == ""
