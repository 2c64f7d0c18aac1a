"""Robot programs: only targets' numbers change, and with them the real arm comes to where the nominal one would."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calibrated import Machine, machine
from made_programs import FANUC, KUKA, MAKERS, UR, YASKAWA, Dialect, Made, path, quarters, signs, transform, turns
from robot_programs import error, sent
from robots import ur10
from scipy.spatial.transform import Rotation

import aridcal
from aridcal.compensate import main as compensate
from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import chain, parse_robot
from aridcal.engine.robot.tree import read_tree
from aridcal.jobs.apply.programs import gcode
from aridcal.jobs.apply.programs.branches import flange
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.correct import NOT_NOMINAL, correct
from aridcal.jobs.apply.programs.frames import KnownFrames, read_frames
from aridcal.jobs.apply.programs.languages import language_of
from aridcal.jobs.apply.programs.notations import ABB as OUR_ABB
from aridcal.jobs.apply.programs.notations import FANUC as OUR_FANUC
from aridcal.jobs.apply.programs.notations import KUKA as OUR_KUKA
from aridcal.jobs.apply.programs.notations import UR as OUR_UR
from aridcal.jobs.apply.programs.notations import YASKAWA as OUR_YASKAWA
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.targets import Notation
from aridcal.jobs.apply.programs.text import written
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.system.errors import AridcalError, CampaignError

CELL = Cell(ur10())

POSTURES: dict[str, Callable[[np.ndarray], list[str]]] = {
    ".script": lambda q: [], ".src": lambda q: [signs(q)], ".mod": quarters, ".ls": turns,
    ".jbi": lambda q: [],
}  # fmt: skip
"""What each language writes of the arm's posture."""


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


def test_a_result_folder_stands_for_the_calibration_in_it(calibration: Path, tmp_path: Path) -> None:
    """As `aridcal identify` prints it: its last line names the folder."""
    program = made(".script", 2)
    of_file, of_folder = tmp_path / "file", tmp_path / "folder"
    for named, folder in ((calibration, of_file), (calibration.parent, of_folder)):
        folder.mkdir()
        assert run(program.text, ".script", named, folder, *framed(program, folder))[0] == 0
    assert (of_file / "corrected.script").read_bytes() == (of_folder / "corrected.script").read_bytes()


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
    there = sent(program, numbers, ending, m)
    asked = [k for k, kind in enumerate(program.kinds) if kind == "pose" and k not in program.stale]
    words = iter(program.read_words(text))
    for q in (there[k] for k in asked):  # at a boundary either word is right
        near = [POSTURES[ending](q + step) for step in (0.0, 1e-3, -1e-3)]
        assert [next(words) for _ in near[0]] in near
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
        language = language_of(Path(f"p{ending}"))
        assert language is not None
        with suppress(AridcalError):
            for target in language.read(Project((SourceFile(Path(f"p{ending}"), garbled),)), CELL).targets:
                assert target.why or np.isfinite(target.values).all()
                assert all(garbled[n.start : n.end] == n.text for n in target.numbers)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(OUR_UR, UR), (OUR_KUKA, KUKA), (OUR_FANUC, FANUC), (OUR_YASKAWA, YASKAWA)],
    ids=["UR", "KUKA", "FANUC", "YASKAWA"],
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
    (tmp_path / "tool.yaml").write_text(
        "format: 1\nbases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\ntools: {default: {xyz: [0, 0, 0.1], rpy: [0, 0, 0]}}\n"
    )
    found = []
    for T, file in ((here, "tool.yaml"), (np.linalg.inv(half_a_turn) @ here, "frames.yaml")):
        numbers = ", ".join(f"{value:.9f}" for value in OUR_UR.numbers(T, start))
        more = ("--frames", str(tmp_path / file), "--start", ",".join(f"{q:.6f}" for q in low + 0.45 * (high - low)))
        _, text, table = run(f"movel(p[{numbers}])\n", ".script", calibration, tmp_path, *more)
        assert table["corrected"].all(), table["remark"].tolist()
        found.append(OUR_UR.pose(np.array([float(n) for n in text[text.index("[") + 1 : text.index("]")].split(",")])))
    np.testing.assert_allclose(half_a_turn @ found[1], found[0], atol=1e-7)
    assert not np.allclose(found[0], here, atol=1e-5)


def test_a_link_base_that_is_elsewhere_is_where_a_ur_counts_from() -> None:
    """Second road: the URDF's own joint between the two links."""
    plain = Path(arm().model.robot.path).read_text()
    other = """<link name="base"/><joint name="to_base" type="KIND"><parent link="base_link"/><child link="base"/>
        <origin xyz="0 0 0" rpy="0 0 3.141592653589793"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    bases = []
    for text in (plain, *(plain.replace("</robot>", other.replace("KIND", kind)) for kind in ("revolute", "fixed"))):
        robot = chain(read_tree(text.encode(), Path("ur10.urdf")), "tool0", "base_link")
        bases.append(Cell(robot).elsewhere)
    assert bases[:2] == [None, None]
    assert bases[2] is not None
    np.testing.assert_allclose(bases[2], transform([0, 0, 0], [0, 0, np.pi]), atol=1e-12)


def test_targets_beyond_what_was_measured_or_out_of_reach_are_named_and_left(
    calibration: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = "movej([6.0, 6.0, 6.0, 6.0, 6.0, 6.0])\nset_tcp(p[0,0,0,0,0,0])\nmovel(p[9.0, 0.0, 0.0, 0.0, 0.0, 0.0])\n"
    (tmp_path / "base.yaml").write_text("format: 1\nbases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\n")
    status, same, side = run(text, ".script", calibration, tmp_path, "--frames", str(tmp_path / "base.yaml"))
    assert status == 0
    assert same == text
    assert not side["corrected"].any()
    said = capfd.readouterr().err
    assert "line 1, [6.0, 6.0, 6.0, 6.0, 6.0, 6.0]: is beyond what was measured" in said
    assert f"line 3, p[9.0, 0.0, 0.0, 0.0, 0.0, 0.0]: {NOT_NOMINAL}" in said


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
    assert "--frames, --at, --start and --zeros are for robot programs" in capfd.readouterr().err


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
    cell = Cell(saved.final.model.robot, KnownFrames(bases={"g54": np.eye(4)}))
    reading = gcode.ROW.read(Project((SourceFile(Path("p.nc"), text),)), cell)
    found = correct(saved, reading.targets, {})
    assert [len(c.texts) for c in found] == [3, 3, 1, 2]
    told = np.array([[100, 200, -50], [900, -300, 120], [150.5, -300, 120], [150.5, 40, 10]]) / 1e3
    sent = np.zeros(3)
    for c, q in zip(found, told, strict=True):
        for (unit, k), text in zip(c.target.units, c.texts, strict=True):
            sent[k] = unit * float(text)
        place = saved.final.poses(sent[None])[1][0]
        off, as_is = np.linalg.norm(place - q), np.linalg.norm(saved.final.poses(q[None])[1][0] - q)
        assert off == pytest.approx(c.after[0], abs=1e-9)
        assert off < (1e-6 if len(c.texts) == 3 else as_is)


@pytest.mark.parametrize(
    ("frame", "why"),
    [
        ("a: {rpy: [0, 0, 90]}", "a: rpy is in radians, and 90 is more than a turn"),
        ("a: {xyz: [0, -300, 0]}", "a: xyz is in metres, and -300 is in no cell"),
        ("a: {xyz: [0, 0, 1]}, A: {xyz: [0, 0, 2]}", "A: stands there twice"),
    ],
)
def test_frames_in_other_units_or_with_one_name_are_refused(frame: str, why: str, tmp_path: Path) -> None:
    file = tmp_path / "frames.yaml"
    for kind in ("bases", "tools"):
        file.write_text(f"format: 1\n{kind}: {{{frame}}}\n")
        with pytest.raises(CampaignError, match=f"{kind}: {why}"):
            read_frames(file)


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


def test_no_pattern_repeats_a_group_possessively() -> None:
    """Python's `re` matches such groups wrongly before 3.11.5 (gh-106052), Debian's own 3.11.2 among them."""
    repeated = re.compile(r"(?<!\\)\)(?:[*+?]|\{[\d,]+\})\+")
    files = sorted(Path(aridcal.__file__).parent.rglob("*.py"))
    patterns = [
        (file.name, node.value)
        for file in files
        if repeated.search(text := file.read_text())  # most files need not be parsed
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and repeated.search(node.value)
    ]
    assert len(files) > 300 and patterns == []
