"""Robot programs: only targets' numbers change, and with them the real arm comes to where the nominal one would."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calibrated import Machine, machine
from made_programs import FANUC, KUKA, MAKERS, UR, Dialect, Made, path, transform
from robot_programs import error, sent
from scipy.spatial.transform import Rotation

from aridcal.compensate import main as compensate
from aridcal.errors import CampaignError
from aridcal.fit.constants import constants
from aridcal.model.model import Model
from aridcal.programs import fanuc, gcode, krl, rapid, urscript
from aridcal.programs.axes import Axes, axes_of
from aridcal.programs.branches import flange
from aridcal.programs.correct import correct
from aridcal.programs.frames import KnownFrames, read_frames, unsaid_base
from aridcal.programs.languages import LANGUAGES
from aridcal.programs.notations import ABB as OUR_ABB
from aridcal.programs.notations import FANUC as OUR_FANUC
from aridcal.programs.notations import KUKA as OUR_KUKA
from aridcal.programs.notations import UR as OUR_UR
from aridcal.programs.targets import Notation, Target, spliced, written
from aridcal.result.saved_model import SavedModel, SolvedModel
from aridcal.robot.chain import chain, parse_robot
from aridcal.robot.tree import read_tree

SIX = axes_of(("revolute",) * 6)

NOTHING = KnownFrames()


@cache
def arm() -> Machine:
    """A UR10 of which the truth is known."""
    return machine(3, n=150)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("calibrated") / "calibration.yaml"
    file.write_text(arm().saved.dump())
    return file


def made(ending: str, seed: int, points: int = 8) -> Made:
    """A program of a language."""
    m, rng = arm(), np.random.default_rng(seed)
    low, high = np.array([m.saved.ranges[name] for name in m.model.robot.readings]).T
    return MAKERS[ending][1](rng, path(rng, low, high, points), lambda q: flange(m.model.robot, q))


def run(text: str, ending: str, calibration: Path, folder: Path, *more: str) -> tuple[int, str, pd.DataFrame]:
    """Exit status, the corrected text, and the side table; both empty where nothing was written."""
    program, out = folder / f"program{ending}", folder / f"corrected{ending}"
    program.write_bytes(text.encode("utf-8"))
    status = compensate([str(calibration), str(program), "-o", str(out), *more])
    if status:
        assert not out.exists()
        return status, "", pd.DataFrame()
    return status, out.read_bytes().decode("utf-8"), pd.read_csv(folder / f"{out.name}.corrections.csv")


def framed(program: Made, folder: Path) -> Sequence[str]:
    """Arguments that state a program's frames."""
    if not program.frames:
        return ()
    (folder / "frames.yaml").write_text(program.frames)
    return "--frames", str(folder / "frames.yaml")


@pytest.mark.parametrize("ending", MAKERS)
def test_only_numbers_of_targets_change_and_the_real_arm_comes_to_their_places(
    ending: str, calibration: Path, tmp_path: Path
) -> None:
    """Read by the template that the program was made from, and driven by a controller with the nominal arm."""
    program, m = made(ending, 1), arm()
    status, text, side = run(program.text, ending, calibration, tmp_path, *framed(program, tmp_path))
    numbers = program.read(text)
    assert status == 0
    assert numbers is not None
    assert len(side) == len(program.kinds)
    before, after, model = [], [], []
    for q, there in zip(sent(program, program.numbers, ending, m), sent(program, numbers, ending, m), strict=True):
        wanted = flange(m.model.robot, q)
        before.append(error(wanted, m, q)[0])
        after.append(error(wanted, m, there)[0])
        model.append(error(wanted, m, there)[1])
    assert side["corrected"].all()
    assert np.linalg.norm(after) < 1.2 * np.linalg.norm(model)
    assert np.linalg.norm(after) < 0.01 * np.linalg.norm(before)


@pytest.mark.parametrize("ending", MAKERS)
def test_a_program_that_is_cut_or_garbled_anywhere_is_read_or_left_but_never_breaks_the_reader(ending: str) -> None:
    text, rng = made(ending, 2, 4).text, np.random.default_rng(0)
    for _ in range(60):
        start, length = rng.integers(len(text)), rng.integers(1, 30)
        garbled = (
            text[:start]
            + str(rng.choice(["", "[", "{", ")", "p[", '"', ",", "= ", ":", "9" * 400]))
            + text[start + length :]
        )
        for target in LANGUAGES[ending].read(garbled, SIX, NOTHING):
            assert target.why or np.isfinite(target.values).all()
            assert all(garbled[n.start : n.end] == n.text for n in target.numbers)


@pytest.mark.parametrize(
    ("ours", "theirs"), [(OUR_UR, UR), (OUR_KUKA, KUKA), (OUR_FANUC, FANUC)], ids=["UR", "KUKA", "FANUC"]
)
def test_poses_are_written_as_the_makers_write_them(ours: Notation, theirs: Dialect) -> None:
    """Turns about one axis after the other, as the manuals have them, beside one matrix."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        T = transform(rng.normal(size=3), rng.uniform(-1.4, 1.4, 3))
        values = theirs.pose(T)
        np.testing.assert_allclose(ours.pose(values), T, atol=1e-12)
        np.testing.assert_allclose(ours.numbers(T, values), values, atol=1e-9)


def test_a_quaternion_has_its_scalar_first_and_keeps_its_sign() -> None:
    T = transform([0.1, 0.2, 0.3], [0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(OUR_ABB.pose(np.array([100, 200, 300, np.sqrt(0.5), 0, 0, np.sqrt(0.5)])), T, atol=1e-12)
    minus = OUR_ABB.numbers(T, np.array([0, 0, 0, -0.7, 0, 0, -0.7]))
    np.testing.assert_allclose(minus[3:], [-np.sqrt(0.5), 0, 0, -np.sqrt(0.5)], atol=1e-12)


@pytest.mark.parametrize("ours", [OUR_UR, OUR_KUKA, OUR_FANUC, OUR_ABB], ids=["UR", "KUKA", "FANUC", "ABB"])
def test_numbers_stay_near_those_that_stood_there(ours: Notation) -> None:
    """A rotation vector of more than half a turn, angles beyond 180 degrees: a small correction changes them by little."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        values = np.array([10.0, 20.0, 30.0, *rng.uniform(-300.0, 300.0, 3)])
        if ours is OUR_UR:
            values[3:] = rng.uniform(3.3, 6.0) * Rotation.random(rng=rng).apply([1.0, 0.0, 0.0])
        if ours is OUR_ABB:
            values = np.concatenate([values[:3], -Rotation.random(rng=rng).as_quat()])
        T = ours.pose(values) @ transform([1e-4, 0, 0], [1e-4, 2e-4, 0])
        assert np.abs(ours.numbers(T, values)[3:] - values[3:]).max() < 1.0


@pytest.mark.parametrize(
    ("value", "before", "digits", "after"),
    [
        (1.23456789, "1.2", 4, "1.2346"),
        (1.2, "1.234567", 4, "1.200000"),
        (-1e-9, "0.0", 4, "0.0000"),
        (5.0, "5", 3, "5.000"),
    ],
)
def test_a_number_keeps_its_digits_and_gets_those_that_it_needs(
    value: float, before: str, digits: int, after: str
) -> None:
    assert written(value, before, digits) == after


def whys(targets: Sequence[Target]) -> list[str]:
    return [target.why for target in targets]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("set_tcp(p[0,0,0,0,0,0])\nmovel(p[x, 0, 0, 0, 0, 0])\n", "x in p[x, 0, 0, 0, 0, 0] is no plain number"),
        ("movel(p[1, 0, 0, 0, 0, 0])\n", "the tool default is not in the program"),
        ("set_tcp(p[0,0,0,0,0,0])\nmovel(pose_add(a, b))\n", "pose_add(...) is worked out by the controller only"),
        ("set_tcp(p[0,0,0,0,0,0])\na = p[0,0,0,0,0,0]\na = p[1,0,0,0,0,0]\nmovel(a)\n", "a is assigned 2 times"),
        ("a = b\nb = a\nmovel(a)\n", "stands for itself"),
        ("movej([0, 1, 2])\n", "has 3 joints, the robot 6"),
    ],
)
def test_what_only_a_ur_can_work_out_is_left(text: str, why: str) -> None:
    (found,) = whys(urscript.read(text, SIX, NOTHING))
    assert why in found


def test_a_controller_whose_base_is_turned_against_the_urdf_gets_the_same_correction(
    calibration: Path, tmp_path: Path
) -> None:
    """ROS has `base_link` turned by half a turn against the base of a UR: unsaid, other poses would be corrected."""
    half_a_turn = transform([0.0, 0.0, 0.0], [0.0, 0.0, np.pi])
    tool = transform([0.0, 0.0, 0.1], [0.0, 0.0, 0.0])
    low, high = np.array([arm().saved.ranges[name] for name in arm().model.robot.readings]).T
    here = flange(arm().model.robot, low + 0.45 * (high - low)) @ tool
    start = np.array([0, 0, 0, 2.0, 2.0, 0.0])
    (tmp_path / "frames.yaml").write_text(
        "format: 1\nbases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 3.141592653589793]}}\n"
        "tools: {default: {xyz: [0, 0, 0.1], rpy: [0, 0, 0]}}\n"
    )
    (tmp_path / "tool.yaml").write_text("format: 1\ntools: {default: {xyz: [0, 0, 0.1], rpy: [0, 0, 0]}}\n")
    found = []
    for T, file in ((here, "tool.yaml"), (np.linalg.inv(half_a_turn) @ here, "frames.yaml")):
        numbers = ", ".join(f"{value:.9f}" for value in OUR_UR.numbers(T, start))
        _, text, table = run(
            f"movel(p[{numbers}])\n", ".script", calibration, tmp_path, "--frames", str(tmp_path / file)
        )
        assert table["corrected"].all(), table["remark"].tolist()
        found.append(OUR_UR.pose(np.array([float(n) for n in text[text.index("[") + 1 : text.index("]")].split(",")])))
    np.testing.assert_allclose(half_a_turn @ found[1], found[0], atol=1e-7)
    assert not np.allclose(found[0], here, atol=1e-5)


def test_a_link_base_that_is_elsewhere_is_named_unless_the_user_states_the_base() -> None:
    plain = Path(arm().model.robot.path).read_text()
    other = """<link name="base"/><joint name="to_base" type="KIND"><parent link="base_link"/><child link="base"/>
        <origin xyz="0 0 0" rpy="0 0 3.141592653589793"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    said = []
    for text in (plain, *(plain.replace("</robot>", other.replace("KIND", kind)) for kind in ("revolute", "fixed"))):
        robot = chain(read_tree(text.encode(), Path("ur10.urdf")), "tool0", "base_link")
        said.append(unsaid_base(robot, NOTHING))
        assert unsaid_base(robot, KnownFrames(bases={"default": np.eye(4)})) == ""
    assert said[:2] == ["", ""]
    assert "xyz: [0, 0, 0], rpy: [0, 0, 3.14159265]" in said[2]


KRL_POSE = "{X 1,Y 2,Z 3,A 4,B 5,C 6}"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (f"PTP {KRL_POSE}\n", "the base default is not in the program"),
        (f"$BASE=$NULLFRAME\nBAS(#TOOL,4)\nLIN {KRL_POSE}\n", "TOOL_DATA[4] is not in the program"),
        ("$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\nLIN {X 5}\n", "lacks some of X Y Z A B C"),
        (f"LIN_REL {KRL_POSE}\n", "is a step from the place before"),
        (f"$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\n$IPO_MODE=#TCP\nLIN {KRL_POSE}\n", "stands outside"),
        (f"P1={KRL_POSE}\n$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\nLIN P1\n$TOOL={KRL_POSE}\nLIN P1\n", "different tools"),
        (f"P1={KRL_POSE}\n", "no move of this file goes there"),
    ],
)
def test_what_only_a_kuka_can_work_out_is_left(text: str, why: str) -> None:
    (found,) = whys(krl.read(text, SIX, NOTHING))
    assert why in found


def test_points_of_inline_forms_have_the_base_and_the_tool_of_their_data() -> None:
    text = f'DECL E6POS XP1={KRL_POSE}\nDECL FDAT FP1={{TOOL_NO 2,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " "}}\n'
    tool = transform([0, 0, 0.1], [0, 0, 0])
    (target,) = krl.read(text, SIX, KnownFrames(tools={"2": tool}))
    assert not target.why
    np.testing.assert_array_equal(target.tool, tool)
    np.testing.assert_array_equal(target.base, np.eye(4))


def test_a_shift_behind_a_colon_belongs_to_the_tool() -> None:
    """P:S with a tool T is where P is with the tool T S^-1."""
    shift = "{X 0,Y 0,Z 100,A 0,B 0,C 0}"
    text = f"$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\nP1={KRL_POSE}\nLIN P1:{shift} C_DIS\n"
    (target,) = krl.read(text, SIX, NOTHING)
    np.testing.assert_allclose(target.tool, transform([0, 0, -0.1], [0, 0, 0]), atol=1e-12)


RAPID_POSE = "[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (f"CONST robtarget p1:={RAPID_POSE};\n", "no move of this file goes there"),
        (f"CONST robtarget p1:={RAPID_POSE};\nMoveL p1,v100,fine,tGun;\n", "the tool tGun is not in the program"),
        (f"CONST robtarget p1:={RAPID_POSE};\nMoveL p1,v100,fine,tool0\\WObj:=wA;\n", "the work object wA is not in"),
        (f"CONST robtarget p1:={RAPID_POSE};\nPDispOn p1,tool0;\nMoveL p1,v100,fine,tool0;\n", "a displacement acts"),
        ("MoveL p9,v100,fine,tool0;\n", "is not in this file"),
    ],
)
def test_what_only_an_abb_can_work_out_is_left(text: str, why: str) -> None:
    (found,) = whys(rapid.read(text, SIX, NOTHING))
    assert why in found


def test_a_point_of_fanuc_needs_its_user_frame_and_tool() -> None:
    body = "GP1:\n UF : 3, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = 1.0 mm, Y = 2.0 mm, Z = 3.0 mm,\n W = 1.0 deg, P = 2.0 deg, "
    body += "R = 3.0 deg"
    text = f"/PROG A\n/MN\n1:L P[1] ;\n/POS\nP[1]{{\n{body}\n}};\n/END\n"
    assert "user frame 3 is not in the program" in fanuc.read(text, SIX, NOTHING)[0].why
    frames = KnownFrames(bases={"3": np.eye(4)}, tools={"1": np.eye(4)})
    assert fanuc.read(text, SIX, frames)[0].why == ""


GANTRY = axes_of(("prismatic",) * 3)

G54 = KnownFrames(bases={"g54": transform([0.5, 0.0, 0.0], [0, 0, 0])})


def test_axis_words_of_a_gantry_are_its_joints_from_the_zero_of_the_work_offset() -> None:
    text = "G21 G90 (G1 X9) \nG1 X10. Y-20.5 F900 ; X7\nZ3\nG20 X1\n"
    found = gcode.read(text, GANTRY, G54)
    readings = np.array([target.readings for target in found])
    np.testing.assert_allclose(
        readings, [[0.51, -0.0205, np.nan], [np.nan, np.nan, 0.003], [0.5254, np.nan, np.nan]], equal_nan=True
    )


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("G91 G1 X1\n", "is a step from the place before"),
        ("G2 X1 Y1 I5\n", "is no straight move"),
        ("G43 H1\nG1 Z1\n", "a length of a tool acts"),
        ("G55 G1 X1\n", "the work offset G55 is not in the program"),
        ("X1\n", "is no straight move"),
    ],
)
def test_what_only_a_gantry_can_work_out_is_left(text: str, why: str) -> None:
    (found,) = whys(gcode.read(text, GANTRY, G54))
    assert why in found


def test_a_rail_is_the_external_axis_and_keeps_its_place_for_a_pose() -> None:
    axes = Axes(("prismatic", *["revolute"] * 6), (1, 2, 3, 4, 5, 6), (0,))
    assert axes_of(axes.kinds) == axes
    text = "$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\nLIN {X 1,Y 2,Z 3,A 4,B 5,C 6,S 0,T 0,E1 1500.0}\n"
    (target,) = krl.read(text, axes, NOTHING)
    assert target.branch.held is not None
    np.testing.assert_allclose(target.branch.held, [1.5, *[np.nan] * 6], equal_nan=True)


def test_only_numbers_are_exchanged() -> None:
    (target,) = urscript.read("movej([1, -2.50,3e0 , .5, 0, 7])  # é\r\n", SIX, NOTHING)
    changes = [(n, f"<{n.text}>") for n in target.numbers]
    assert spliced("movej([1, -2.50,3e0 , .5, 0, 7])  # é\r\n", changes) == (
        "movej([<1>, <-2.50>,<3e0> , <.5>, <0>, <7>])  # é\r\n"
    )


def test_targets_beyond_what_was_measured_or_out_of_reach_are_named_and_left(
    calibration: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = "movej([6.0, 6.0, 6.0, 6.0, 6.0, 6.0])\nset_tcp(p[0,0,0,0,0,0])\nmovel(p[9.0, 0.0, 0.0, 0.0, 0.0, 0.0])\n"
    status, same, side = run(text, ".script", calibration, tmp_path)
    assert status == 0
    assert same == text
    assert not side["corrected"].any()
    said = capfd.readouterr().err
    assert "line 1, [6.0, 6.0, 6.0, 6.0, 6.0, 6.0]: is beyond what was measured" in said
    assert "line 3, p[9.0, 0.0, 0.0, 0.0, 0.0, 0.0]: the nominal arm does not get there" in said


@pytest.mark.parametrize(
    ("content", "more", "said"),
    [
        (b"def a():\nend\n", (), "no target of URScript is in it"),
        (b"movej([0,0,0,0,0,0])\n", ("--at", "temperature"), "should be NAME=NUMBER"),
        ("movej([0,0,0,0,0,0])\n".encode("utf-16"), (), "is no text of one byte a letter"),
        (b" \n", (), "is empty"),
    ],
)
def test_a_slip_is_named_and_nothing_is_written(
    content: bytes, more: Sequence[str], said: str, calibration: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    program, out = tmp_path / "a.script", tmp_path / "b.script"
    program.write_bytes(content)
    assert compensate([str(calibration), str(program), "-o", str(out), *more]) == 2
    assert said in capfd.readouterr().err
    assert not out.exists()


def test_a_program_is_written_under_the_ending_of_its_language(
    calibration: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.src").write_text("PTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}\n")
    assert compensate([str(calibration), str(tmp_path / "a.src"), "-o", str(tmp_path / "b.csv")]) == 2
    assert "should end as a.src does: it is KRL, too" in capfd.readouterr().err


def test_frames_are_for_programs_alone(calibration: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "poses.csv").write_text("x,y,z\n1,2,3\n")
    arguments = [str(calibration), str(tmp_path / "poses.csv"), "-o", str(tmp_path / "b.csv"), "--at", "a=1"]
    assert compensate(arguments) == 2
    assert "--frames and --at are for robot programs" in capfd.readouterr().err


SLIDE = (
    '<joint name="{0}" type="prismatic"><parent link="{1}"/><child link="{2}"/><axis xyz="{3}"/>'
    '<limit lower="-5" upper="5" effort="1" velocity="1"/></joint>'
)


def gantry() -> SavedModel:
    """Three slides whose axes are a few milliradians out of square, known exactly."""
    links = "".join(f'<link name="{name}"/>' for name in ("base", "a", "b", "tip"))
    slides = (("x", "base", "a", "1 0 0"), ("y", "a", "b", "0 1 0"), ("z", "b", "tip", "0 0 1"))
    urdf = f'<robot name="gantry">{links}{"".join(SLIDE.format(*slide) for slide in slides)}</robot>'
    robot = parse_robot(urdf.encode(), "tip")
    own = constants(robot, "full")
    theta = np.random.default_rng(0).normal(0.0, 2e-3, len(own))
    solved = SolvedModel(Model(robot, own), theta, np.zeros((len(own),) * 2))
    ranges = dict.fromkeys(robot.readings, (-2.0, 2.0))
    return SavedModel(solved, solved, "position", (0.0, 0.0, -9.81), (1e-5, 1e-3), ranges, {})


def test_a_gantry_comes_to_its_places_where_all_words_stand_and_as_near_as_those_that_do_can_bring_it() -> None:
    """Second road: the true model at the axes that the corrected words, and those kept from before, say."""
    saved = gantry()
    text = "G21 G90\nG1 X100 Y200.0 Z-50\nG1 X900 Y-300 Z120\nX150.5\nG1 Y40 Z10\n"
    targets = gcode.read(text, GANTRY, KnownFrames(bases={"g54": np.eye(4)}))
    found = correct(saved, targets, {})
    assert [len(c.changes) for c in found] == [3, 3, 1, 2]
    told = np.array([[100, 200, -50], [900, -300, 120], [150.5, -300, 120], [150.5, 40, 10]]) / 1e3
    sent = np.zeros(3)
    for c, q in zip(found, told, strict=True):
        for (unit, k), (_, new) in zip(c.target.units, c.changes, strict=True):
            sent[k] = unit * float(new)
        place = saved.final.poses(sent[None])[1][0]
        off, as_is = np.linalg.norm(place - q), np.linalg.norm(saved.final.poses(q[None])[1][0] - q)
        assert off == pytest.approx(c.after[0], abs=1e-9)
        assert off < (1e-6 if len(c.changes) == 3 else as_is)


def test_a_wrong_file_of_frames_is_answered_with_what_one_looks_like(tmp_path: Path) -> None:
    file = tmp_path / "frames.yaml"
    for text, problem in (("bases: {}\n", "'format' is missing"), ("format: 1\nbasis: {}\n", "did you mean 'bases'")):
        file.write_text(text)
        with pytest.raises(CampaignError, match=problem) as found:
            read_frames(file)
        said = str(found.value)
        assert said.startswith(str(file))
        example = said[said.index("  format: 1") : said.index("docs/apply/index.md")]
        file.write_text(textwrap.dedent(example))
        known = read_frames(file)  # what is shown is what is read
        np.testing.assert_allclose(known.tools["1"][:3, 3], [0, 0, 0.15])
    with pytest.raises(CampaignError) as absent:
        read_frames(tmp_path / "nowhere.yaml")
    assert "for instance" not in str(absent.value)
