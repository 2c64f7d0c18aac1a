"""INFORM jobs of Yaskawa: a position is corrected where its frame, its tool and all that a job does with it are certain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibrated import machine
from posture_arms import ABB, FANUC
from program_attacks.yaskawa import BEFORE, FRAMES, GO, HOME, PULSES, START, USER, job, position
from robots import ur10
from six_axes import robot

from aridcal.engine.robot.chain import Robot
from aridcal.jobs.apply.programs.axes import DEGREE
from aridcal.jobs.apply.programs.axis_zeros import senses_hint
from aridcal.jobs.apply.programs.branches import flange
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.correct import OTHER_SIDE, correct
from aridcal.jobs.apply.programs.corrections import Corrections
from aridcal.jobs.apply.programs.frames import KnownFrames, read_frames
from aridcal.jobs.apply.programs.notations import YASKAWA
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.targets import PoseReference, Target
from aridcal.jobs.apply.programs.yaskawa import ROW
from aridcal.jobs.apply.programs.yaskawa.project import context
from aridcal.system.errors import CampaignError


def turned(angle: float, axis: int) -> np.ndarray:
    """A turn about an axis that stands still, degrees."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    R, (j, k) = np.eye(3), [n for n in range(3) if n != axis]
    R[j, j], R[k, k], R[j, k], R[k, j] = c, c, (-s, s)[axis == 1], (s, -s)[axis == 1]
    return R


def xyz(*numbers: float) -> np.ndarray:
    """X Y Z Rx Ry Rz as the manual has them: turned by Rx, Ry, Rz about the axes of the frame, which stand still."""
    T = np.eye(4)
    T[:3, :3] = turned(numbers[5], 2) @ turned(numbers[4], 1) @ turned(numbers[3], 0)
    T[:3, 3] = np.array(numbers[:3]) / 1e3
    return T


def cell(frames: str = FRAMES, folder: Path | None = None, arm: Robot | None = None, start: bool = False) -> Cell:
    known = KnownFrames()
    if folder is not None:
        (folder / "frames.yaml").write_text(frames)
        known = read_frames(folder / "frames.yaml")
    return Cell(arm or ur10(), known, (), start)


def read(text: str, own: Cell, **others: str) -> ProgramReading:
    """What is read of a job and of other files that are not corrected."""
    sources = [SourceFile(Path("MAIN.JBI"), text)]
    sources += [SourceFile(Path(name.replace("_", ".")), other, False) for name, other in others.items()]
    return ROW.read(Project(tuple(sources)), own)


def by_name(reading: ProgramReading) -> dict[str, Target]:
    return {target.name: target for target in reading.targets}


def place(text: str, own: Cell, name: str = "C00001", **others: str) -> PoseReference:
    target = by_name(read(text, own, **others))[name]
    assert target.why == "" and target.place is not None
    return target.place


def test_angles_are_those_about_axes_that_stand_still() -> None:
    numbers = np.array([100.0, -20.0, 30.0, 170.0, -35.0, 12.0])
    np.testing.assert_allclose(YASKAWA.pose(numbers), xyz(*numbers), atol=1e-12)


def test_the_frame_and_the_tool_are_those_of_the_lines_before_the_position(tmp_path: Path) -> None:
    own = cell(folder=tmp_path)
    text = job([GO], USER + "///USER 2\n///TOOL 2\n" + position("C00001"))
    there = place(text, own)
    np.testing.assert_allclose(there.base, own.frames.bases["2"])
    np.testing.assert_allclose(there.tool, own.frames.tools["2"])
    swapped = text.replace("///POSTYPE USER\n", "").replace("///USER 2\n", "///USER 2\n///POSTYPE USER\n")
    np.testing.assert_allclose(place(swapped, own).base, own.frames.bases["2"])


def test_robot_and_base_coordinates_are_the_link_base_of_the_urdf_or_where_they_are_stated(tmp_path: Path) -> None:
    foot = (
        '<joint name="b" type="fixed"><parent link="l0"/><child link="base"/><origin xyz="0 0 0.45"/></joint>'
        '<link name="base"/>'
    )
    raised = np.eye(4)
    raised[2, 3] = 0.45
    for kind in ("ROBOT", "BASE"):
        text = job([GO], USER.replace("POSTYPE USER", f"POSTYPE {kind}") + position("C00001"))
        reading = read(text, cell(folder=tmp_path, arm=robot(foot)))
        own = by_name(reading)["C00001"].place
        assert own is not None
        np.testing.assert_allclose(own.base, raised)
        assert any("link base of the URDF" in note for note in reading.notes)
        assert any("nothing moves its base" in note for note in reading.notes) == (kind == "BASE")
        assert any("begun without a shift" in note for note in reading.notes)
        elsewhere = FRAMES.replace('bases: {"1"', 'bases: {robot: {xyz: [0, 0, 0.1], rpy: [0, 0, 0]}, "1"')
        again = read(text, cell(elsewhere, tmp_path, robot(foot)))
        stated = by_name(again)["C00001"].place
        assert stated is not None and stated.base[2, 3] == pytest.approx(0.1)
        assert not any("the robot's coordinates" in note for note in again.notes)


UFRAME = """//UFRAME 1
///NAME Tisch
///TOOL 1
///GROUP {group},0,0,0
///PULSE
////RORG C000=1,2,3,4,5,6
////RXX C001=1,2,3,4,5,6
////RXY C002=1,2,3,4,5,6
////BUSER 100.000,-20.500,30.000,10.0000,20.0000,30.0000
//UFRAME 2
///NAME
"""

TOOL = """//TOOL 0
///NAME STANDARD
0.000,0.000,385.000,0.0000,0.0000,0.0000
0.000,0.000,0.001
//TOOL 1
///NAME Brenner
1.000,2.000,150.500,5.0000,-30.0000,15.0000
9.000,9.000,9.000
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_controller_s_own_files_say_its_frames_and_tools(end: str) -> None:
    """User frames are in the base's coordinates, tool 0 is a tool like all others."""
    foot = (
        '<joint name="b" type="fixed"><parent link="l0"/><child link="base"/><origin xyz="0 0 0.45"/></joint>'
        '<link name="base"/>'
    )
    raised = np.eye(4)
    raised[2, 3] = 0.45
    files = {"UFRAME_CND": UFRAME.format(group=1).replace("\n", end), "TOOL_CND": TOOL.replace("\n", end)}
    own, text = Cell(robot(foot)), job([GO], USER + position("C00001"))
    there = place(text, own, **files)
    np.testing.assert_allclose(there.base, raised @ xyz(100.0, -20.5, 30.0, 10.0, 20.0, 30.0), atol=1e-12)
    np.testing.assert_allclose(there.tool, xyz(1.0, 2.0, 150.5, 5.0, -30.0, 15.0), atol=1e-12)
    np.testing.assert_allclose(place(text.replace("TOOL 1", "TOOL 0"), own, **files).tool, xyz(0, 0, 385, 0, 0, 0))
    del files["TOOL_CND"]
    assert "tool 0 is not" in by_name(read(text.replace("TOOL 1", "TOOL 0"), own, **files))["C00001"].why
    assert any("UFRAME.CND" in note for note in read(text, own, **files).notes)


def test_a_user_frame_of_another_robot_and_one_that_is_stated_otherwise_are_not_believed(tmp_path: Path) -> None:
    text = job([GO], USER + position("C00001"))
    other = read(text, Cell(ur10()), UFRAME_CND=UFRAME.format(group=0), TOOL_CND=TOOL)
    assert by_name(other)["C00001"].why == "user frame 1 is not in the program: state it with --frames"
    twice = read(text, cell(folder=tmp_path), UFRAME_CND=UFRAME.format(group=1), TOOL_CND=TOOL)
    assert "is stated twice, not alike" in by_name(twice)["C00001"].why


def test_pulses_are_read_by_what_the_user_states_of_each_axis(tmp_path: Path) -> None:
    text = job(START[:1], PULSES + HOME)
    assert "no file of a job says" in by_name(read(text, cell()))["C00000"].why
    own = cell(folder=tmp_path)
    target = by_name(read(text, own))["C00000"]
    assert target.readings is not None
    np.testing.assert_allclose(target.readings, DEGREE * np.array([17.2, -68.8, 85.9, -85.9, -80.2, 11.5]))
    assert [unit for unit, _ in target.units] == pytest.approx([DEGREE / n for n in (1000, 1000, 1000, 800, 800, 500)])
    assert set(target.places) == {0}
    shown = Cell(own.robot, own.frames, (0.0, -90.0, 0.0, 0.0, 0.0, 5.0))
    zeroed = by_name(read(text, shown))["C00000"].readings
    assert zeroed is not None
    np.testing.assert_allclose(zeroed, DEGREE * np.array([17.2, 21.2, 85.9, -85.9, -80.2, 6.5]))


def test_an_arm_whose_axes_turn_otherwise_than_yaskawas_is_named() -> None:
    """FANUC's turn alike: left, forward, then up or clockwise seen from the flange; ABB's do not."""
    assert senses_hint(Cell(FANUC.robot()), ROW.name) == ""
    assert "j3, j4, j5, j6 of the URDF turn the other way than Yaskawa's" in senses_hint(Cell(ABB.robot()), ROW.name)


@pytest.mark.parametrize("numbers", ["[1000, 1000]", "[1000, 1000, 1000, 0, 800, 500]"])
def test_pulses_per_degree_are_six_numbers(numbers: str, tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="should be 6 numbers, none of them 0"):
        cell(f"format: 1\npulses_per_degree: {numbers}\n", tmp_path)


def test_a_relative_job_is_in_the_frame_that_its_caller_names(tmp_path: Path) -> None:
    own = cell(folder=tmp_path)
    relative = "///ATTR SC,RW,RJ\n////FRAME USER 1\n///GROUP1 RB1\n"
    positions = USER + position("C00001") + position("P00010")
    sub = job([GO, "MOVL P010 V=1.0"], positions, "SUB", more=relative)
    alone = read(sub, own)
    assert any("relative jobs" in note for note in alone.notes)
    reading = ROW.read(
        Project((SourceFile(Path("MAIN.JBI"), job(["CALL JOB:SUB UF#(2)"])), SourceFile(Path("SUB.JBI"), sub))), own
    )
    found = by_name(reading)
    step = found["C00001"].place
    assert step is not None
    np.testing.assert_allclose(step.base, own.frames.bases["2"])
    assert "called with UF#(2)" in found["P00010"].why


def test_how_the_arm_stands_is_known_from_the_start_or_from_pulses_until_rconf_changes(tmp_path: Path) -> None:
    poses = position("C00002") + position("C00003", x=810.0) + "///RCONF 0,0,0\n" + position("C00004", x=820.0)
    lines = [f"MOVL C0000{k} V=1.0" for k in (2, 3, 4)]
    text = job(lines, USER + poses)
    unknown = [by_name(read(text, cell(folder=tmp_path)))[f"C0000{k}"].branch.unknown for k in (2, 3, 4)]
    assert all("RCONF is not read: state --start" in why for why in unknown)
    after = job([START[0], *lines], BEFORE + poses)
    for reading in (read(text, cell(folder=tmp_path, start=True)), read(after, cell(folder=tmp_path))):
        unknown = [by_name(reading)[f"C0000{k}"].branch.unknown for k in (2, 3, 4)]
        assert unknown[:2] == ["", ""] and "RCONF is another one from line" in unknown[2]
        assert any("RCONF is not read" in note for note in reading.notes)
    left = job(["MOVJ C00000 VJ=1.0", *lines], f"{PULSES}{HOME}{USER}{poses}")
    own = cell(FRAMES.split("pulses")[0], tmp_path, start=True)
    assert by_name(read(left, own))["C00002"].branch.unknown != ""


def test_a_position_variable_is_taken_as_its_job_states_it_and_that_is_said(tmp_path: Path) -> None:
    text = job(["MOVL P010 V=1.0", "MOVL P[B000] V=1.0"], USER + position("P00010"))
    line = text.split("\n").index("MOVL P[B000] V=1.0") + 1
    assert by_name(read(text, cell(folder=tmp_path)))["P00010"].why.startswith(f"line {line} uses it otherwise")
    plain = read(text.replace("MOVL P[B000] V=1.0", "MOVL P077 V=1.0"), cell(folder=tmp_path))
    found = by_name(plain)
    assert found["P00010"].why == "" and "no given job states" in found["P077"].why
    assert any(note.startswith("position variables are taken as loaded") for note in plain.notes)
    other = job(["MOVL P010 V=1.0"], name="OTHER")
    assert (
        "OTHER.JBI uses it"
        in by_name(read(text.replace("P[B000]", "P010"), cell(folder=tmp_path), OTHER_JBI=other))["P00010"].why
    )


def test_a_job_of_an_arm_that_has_not_six_turning_axes_is_left() -> None:
    from made_gcode import gantry

    reading = read(job([GO], USER + position("C00001")), Cell(gantry(rotary=False)))
    assert "an arm of six turning axes" in reading.targets[0].why


def test_a_job_that_is_nested_too_deep_is_left_as_a_whole(tmp_path: Path) -> None:
    deep = ["IFTHENEXP B000=1"] * 70 + ["ENDIF"] * 70
    reading = read(job([*deep, GO], USER + position("C00001")), cell(folder=tmp_path))
    assert [target.why for target in reading.targets] == ["the job has more ways than can be followed"]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines_and_places_are_those_of_the_file_whatever_its_line_ends(end: str, tmp_path: Path) -> None:
    text = job([*START[:1], GO], BEFORE + position("C00001")).replace("\n", end)
    target = by_name(read(text, cell(folder=tmp_path)))["C00001"]
    assert text.split(end)[target.line - 1].startswith("C00001=")
    assert [text[n.start : n.end] for n in target.numbers] == [n.text for n in target.numbers]
    assert len(target.numbers) == 6
    assert by_name(read(f"\xef\xbb\xbf{text}", cell(folder=tmp_path)))["C00001"].why == ""


def test_what_belongs_to_a_job_stands_beside_it(tmp_path: Path) -> None:
    for name in ("MAIN.JBI", "sub.jbi", "UFRAME.CND", "tool.cnd", "RC.PRM", "x.txt"):
        (tmp_path / name).write_text("x")
    assert [path.name for path in context(tmp_path / "MAIN.JBI")] == ["UFRAME.CND", "sub.jbi", "tool.cnd"]
    assert context(tmp_path / "nowhere" / "MAIN.JBI") == []


# --- RCONF, which stands once for many positions -----------------------------------------------------------------------------


ARM = machine(3, n=150)


def corrected(folder: Path, *readings: np.ndarray, postures: tuple[str, ...] = ()) -> Corrections:
    """What becomes of poses behind a position in pulses, each at some readings of the nominal arm."""
    own = cell(
        "format: 1\ntools: {'1': {}}\npulses_per_degree: [1e4, 1e4, 1e4, 1e4, 1e4, 1e4]\n", folder, ARM.model.robot
    )
    pulses = ",".join(f"{n:.0f}" for n in readings[0] / DEGREE * 1e4)
    text = f"{PULSES}C00000={pulses}\n{USER.replace('POSTYPE USER', 'POSTYPE ROBOT')}"
    for k, q in enumerate(readings, start=1):
        numbers = YASKAWA.numbers(flange(ARM.model.robot, q), np.zeros(6))
        text += f"{postures[k - 1] if postures else ''}C{k:05d}={','.join(f'{n:.6f}' for n in numbers)}\n"
    lines = ["MOVJ C00000 VJ=1.0", *(f"MOVL C{k:05d} V=1.0" for k in range(1, len(readings) + 1))]
    return correct(ARM.saved, read(job(lines, text), own).targets, {})


def at(wrist: float) -> np.ndarray:
    """Readings with axis 4 somewhere, [rad]."""
    low, high = np.array([ARM.saved.ranges[name] for name in ARM.model.robot.readings]).T
    q = low + 0.45 * (high - low)
    q[3] = wrist
    return q


def test_positions_of_one_rconf_that_stand_on_two_sides_of_what_it_counts_are_left(tmp_path: Path) -> None:
    quarter = np.pi / 2
    found = corrected(tmp_path, at(quarter - 0.2), at(quarter - 0.1), at(quarter + 0.1), at(quarter - 0.3))
    assert [bool(why) for why in found.why] == [False, False, False, True, False]
    assert found.why[3] == f"its posture (RCONF 1) {OTHER_SIDE}"
    whole = corrected(tmp_path, at(-0.4), at(-0.2), at(0.3))
    assert not any(whole.why)


def test_a_correction_that_would_take_an_axis_across_what_rconf_counts_is_not_made(tmp_path: Path) -> None:
    """Of two places a hair's breadth on either side of a boundary the correction crosses it at one."""
    sides = []
    for off in (-1e-5, 1e-5):
        found = corrected(tmp_path, at(np.pi / 2 + off))
        sides.append(bool(found.why[1]))
    assert sorted(sides) == [False, True]
    assert not any(corrected(tmp_path, at(np.pi / 2 - 0.1)).why)
