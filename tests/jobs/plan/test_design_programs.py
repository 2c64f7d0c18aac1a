"""Plans as programs of controllers, and from which side joints come."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
import yaml

import aridcal
from aridcal import design as command
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.rows.approach import approach
from aridcal.files.campaign import load_campaign
from aridcal.jobs.plan import pose_design as planning
from aridcal.jobs.plan.approaches import BACK_ANGLE, approach_sides, from_both_sides
from aridcal.jobs.plan.configurations import targets_of
from aridcal.jobs.plan.joint_moves import PROGRAMS, Moves, check_program, moves, program
from aridcal.jobs.plan.pose_design import PlanRequest, as_table, design
from aridcal.jobs.plan.prior_knowledge import beforehand
from aridcal.system.errors import OutputError

SIX = 6 * ("revolute",)
TURN = np.array([[-3.0, 3.0]] * 6)
TOOL = "frames: {tip_target: {xyz: [0.05, 0.03, 0.15]}}\n"
PLAY = "effects: [{kind: joint_backlash, where: elbow_joint, by: direction}]\n"


@pytest.fixture(autouse=True)
def _few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    """A smaller pool than the command's, so that tests are quick."""
    monkeypatch.setattr(planning, "POOL", 200)


def written(folder: Path, more: str = PLAY, urdf: str = "ur10.urdf", tip: str = "tool0") -> Path:
    """A campaign whose table is not there."""
    path = folder / "campaign.yaml"
    block = "{file: rows.csv, kind: pose, noise: {position: 1.0e-4, rotation: 1.0e-4}}"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {robots.URDF / urdf}, tip: {tip}}}\nmeasurements: {block}\n{TOOL}{more}"
    )
    return path


def some_moves(kinds: tuple[str, ...] = SIX, n: int = 5, label: str = "") -> Moves:
    """Random ones, every other one by way of a point."""
    rng = np.random.default_rng(0)
    readings, via = rng.uniform(-3, 3, (2, n, len(kinds)))
    via[::2] = np.nan
    return moves("c.yaml", tuple(f"j{k}" for k in range(len(kinds))), kinds, readings, via, n * [label], 0.75)


def expected(made: Moves) -> np.ndarray:
    """Its readings, one row for each stop."""
    return np.array([stop.readings for stop in made.stops])


NUMBER = r"(-?\d+\.\d+)"


def test_urscript_moves_stops_and_waits_in_radians() -> None:
    made = some_moves()
    text = program(made, ".script", "poses")
    found = [re.findall(NUMBER, q) for q in re.findall(r"^  movej\(\[(.*?)\], a=0\.15, v=0\.3\)$", text, re.MULTILINE)]
    np.testing.assert_allclose(np.array(found, dtype=float), expected(made), atol=5.1e-7)
    assert text.startswith("def poses():\n") and text.endswith("end\n")
    assert text.count("sleep(0.750)") == 5 and len(made.stops) == 7


@pytest.mark.parametrize("kinds", [SIX, ("prismatic", *SIX), ("revolute", "prismatic", *SIX[1:])])
def test_krl_and_rapid_have_degrees_and_millimetres_on_their_axes(kinds: tuple[str, ...]) -> None:
    """Against numbers taken apart by their axes' names."""
    made = some_moves(kinds)
    wanted = expected(made) * [1e3 if kind == "prismatic" else 180 / np.pi for kind in kinds]
    turning = [k for k, kind in enumerate(kinds) if kind == "revolute"]
    sliding = [k for k, kind in enumerate(kinds) if kind == "prismatic"]
    krl = program(made, ".src", "poses")
    lines = re.findall(r"PTP \{(.*)\}", krl)
    assert len(lines) == len(made.stops) and krl.count("WAIT SEC 0.750") == 5
    for line, own in zip(lines, wanted, strict=True):
        values = {axis: float(value) for axis, value in re.findall(rf"([AE]\d) {NUMBER}", line)}
        assert sorted(values) == sorted([f"A{k + 1}" for k in range(6)] + [f"E{k + 1}" for k in range(len(sliding))])
        np.testing.assert_allclose([values[f"A{k + 1}"] for k in range(6)], own[turning], atol=5.1e-6)
        np.testing.assert_allclose([values[f"E{k + 1}"] for k in range(len(sliding))], own[sliding], atol=5.1e-6)
    rapid = program(made, ".mod", "poses")
    lines = re.findall(r"MoveAbsJ \[\[(.*?)\], \[(.*?)\]\] \\NoEOffs, v100, fine, tool0;", rapid)
    assert len(lines) == len(made.stops) and rapid.count("WaitTime \\InPos, 0.750;") == 5
    for (arm, outside), own in zip(lines, wanted, strict=True):
        np.testing.assert_allclose([float(v) for v in arm.split(", ")], own[turning], atol=5.1e-6)
        axes = outside.split(", ")
        assert len(axes) == 6 and set(axes[len(sliding) :]) == {"9E+09"}
        np.testing.assert_allclose([float(v) for v in axes[: len(sliding)]], own[sliding], atol=5.1e-6)


def test_waypoints_for_moveit_name_the_joints() -> None:
    made = some_moves(("prismatic", *SIX), label="socket \N{GREEK SMALL LETTER ALPHA}")
    document = yaml.safe_load(program(made, ".yaml", "a name of any sort"))
    assert document["joint_names"] == [f"j{k}" for k in range(7)] and document["settle"] == 0.75
    np.testing.assert_allclose([point["positions"] for point in document["points"]], expected(made), atol=1e-9)
    numbers = [point["configuration"] for point in document["points"]]
    assert [n for n in numbers if n] == [1, 2, 3, 4, 5] and numbers.count(0) == 2


@pytest.mark.parametrize("ending", PROGRAMS)
def test_names_of_joints_and_things_stay_inside_comments(ending: str) -> None:
    """A line break or a quotation mark in a label is no instruction."""
    evil = 'a"\nmovej([0])\rPTP HOME\N{LINE SEPARATOR}END'
    made = moves(evil, (evil, *"bcdef"), SIX, np.zeros((1, 6)), np.full((1, 6), np.nan), [evil], 1.0)
    text = program(made, ending, "poses")
    if ending == ".yaml":
        document = yaml.safe_load(text)
        assert document["joint_names"][0] == evil and document["points"][0]["label"] == evil
        return
    plain = program(
        moves("t", tuple("abcdef"), SIX, np.zeros((1, 6)), np.full((1, 6), np.nan), ["x"], 1.0), ending, "poses"
    )
    assert text.isascii() and len(text.splitlines()) == len(plain.splitlines())
    mark = {".script": "#", ".src": ";", ".mod": "!"}[ending]
    orders = [[line for line in t.splitlines() if not line.lstrip().startswith(mark)] for t in (text, plain)]
    assert orders[0] == orders[1]


@pytest.mark.parametrize(
    ("ending", "stem", "kinds", "said"),
    [
        (".script", "poses", ("prismatic", *SIX), "this one has 6 revolute and 1 prismatic"),
        (".src", "poses", (*SIX, "revolute"), "this one has 7 revolute"),
        (".mod", "poses", SIX[:4], "this one has 4 revolute"),
        (".src", "my-poses", SIX, "letters, digits and _"),
        (".mod", "3poses", SIX, "letters, digits and _"),
        (".script", "p" * 25, SIX, "24 in all"),
    ],
)
def test_what_a_language_has_not_is_refused(ending: str, stem: str, kinds: tuple[str, ...], said: str) -> None:
    with pytest.raises(OutputError, match=said):
        check_program(ending, stem, kinds)


# -- from both sides


@pytest.mark.parametrize("n", [2, 9, 30])
def test_each_joint_comes_from_both_sides_wherever_it_is(n: int) -> None:
    rng = np.random.default_rng(n)
    readings = rng.uniform(-2.9, 2.9, (n, 6))
    both = np.array([True, True, True, True, False, False])
    made = from_both_sides(readings, SIX, TURN, both, rng)
    assert set(np.unique(made.sides[:, both])) <= {-1.0, 1.0}
    assert (np.abs(made.sides[:, both].sum(axis=0)) <= n % 2).all()
    for j in range(4):  # of two neighbours one from each side
        order = np.argsort(readings[:, j])
        pairs = made.sides[order[: n - n % 2], j].reshape(-1, 2)
        assert (pairs.sum(axis=1) == 0).all()
    np.testing.assert_array_equal(made.sides[:, 4:], approach_sides(readings, SIX)[:, 4:])


def test_the_way_of_a_program_brings_joints_from_the_sides_that_are_said() -> None:
    """By the same derivation that reads measured rows."""
    rng = np.random.default_rng(1)
    readings = rng.uniform(-2.99, 2.99, (40, 6))
    both = np.array([True, False, True, True, False, True])
    made = from_both_sides(readings, SIX, TURN, both, rng)
    path, own = [], []
    for via, needed, reading in zip(made.via, made.needed, readings, strict=True):
        if needed:
            path.append(via)
        path.append(reading)
        own.append(len(path) - 1)
    derived = np.column_stack([approach(column, 1e-6) for column in np.array(path).T])[own]
    np.testing.assert_array_equal(derived[:, both], made.sides[:, both])
    assert (np.abs(np.array(path)) <= 3.0).all()
    last = np.diff(np.array(path), axis=0)[np.array(own)[1:] - 1]  # far enough to take up the play
    assert (np.abs(last[:, both]) >= BACK_ANGLE - 1e-12).mean() > 0.99
    assert 5 < made.needed.sum() < 40


def test_sides_go_with_no_smooth_function_of_the_reading() -> None:
    """As the way happens to come, a joint high in its range comes from below; chosen sides tell play from curves."""
    rng = np.random.default_rng(2)
    q = rng.uniform(-2.9, 2.9, (40, 1))
    natural = approach_sides(q, SIX[:1])[:, 0]
    chosen = from_both_sides(q, SIX[:1], TURN[:1], np.array([True]), rng).sides[:, 0]
    curves = np.column_stack([np.ones(40), q, np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)])

    def left(side: np.ndarray) -> float:
        return float(np.sum((side - curves @ np.linalg.lstsq(curves, side, rcond=None)[0]) ** 2) / 40)

    assert left(chosen) > 0.9 > 0.75 > left(natural)


def test_joints_at_their_ends_come_from_inside() -> None:
    q = np.array([[2.99], [2.98], [-2.99], [0.0], [0.5]])
    made = from_both_sides(q, SIX[:1], TURN[:1], np.array([True]), np.random.default_rng(0))
    assert made.sides[:3, 0].tolist() == [1.0, 1.0, -1.0]
    assert (np.abs(made.via[made.needed]) <= 3.0).all()


def test_a_plan_says_from_which_side_and_goes_that_way(tmp_path: Path) -> None:
    floor = "design: {keep_out: [{min: [-2, -2, -2], max: [2, 2, 0.02]}]}\n"
    path = written(tmp_path, PLAY + floor)
    out = [part for name in ("p.csv", "p.yaml", "p.script") for part in ("-o", str(tmp_path / name))]
    assert command.main([str(path), "-n", "12", *out]) == 0
    table = pd.read_csv(tmp_path / "p.csv")
    assert list(table.columns[6:]) == ["elbow_joint_direction"] and table["elbow_joint_direction"].abs().eq(1).all()
    assert abs(table["elbow_joint_direction"].sum()) <= 2
    document = yaml.safe_load((tmp_path / "p.yaml").read_text())
    points = document["points"]
    elbow = document["joint_names"].index("elbow_joint")
    sides = approach(np.array([point["positions"][elbow] for point in points]), 1e-6)
    own = [k for k, point in enumerate(points) if point["configuration"]]
    np.testing.assert_array_equal(sides[own], table["elbow_joint_direction"])
    # who plans the ways itself is told of one before each that can be; others only where it takes one
    before = [k - 1 for k in own if k and not points[k - 1]["configuration"]]
    gap = [points[k + 1]["positions"][elbow] - points[k]["positions"][elbow] for k in before]
    assert len(before) >= 10 and np.allclose(np.abs(gap), BACK_ANGLE)
    assert (tmp_path / "p.script").read_text().count("movej") < len(points)
    made = load_campaign(path)
    known = beforehand(made, load_robot(made.robot.urdf, made.robot.tip))
    every = np.array([point["positions"] for point in points])
    assert (targets_of(known, every, np.zeros(len(every), dtype=int))[1][:, 2] > 0.02).all()


def test_without_play_nothing_is_said_of_sides(tmp_path: Path) -> None:
    made = load_campaign(written(tmp_path, "diagnosis: {enabled: false}\n"))
    robot = load_robot(made.robot.urdf, made.robot.tip)
    plain = design(beforehand(made, robot), PlanRequest(10))
    assert not plain.directions and np.isnan(plain.via).all()
    assert list(as_table(plain, robot, made.measurements).columns) == list(robot.readings)


# -- the command


def test_all_outputs_appear_or_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path)
    names = ["p.csv", "p.script", "p.src", "p.mod", "p.yaml", "p.html", "p.parquet"]
    out = [part for name in names for part in ("-o", str(tmp_path / name))]
    assert command.main([str(path), "-n", "4", "--settle", "2.5", *out]) == 0
    assert all((tmp_path / name).stat().st_size for name in names)
    assert "sleep(2.500)" in (tmp_path / "p.script").read_text()
    assert "4 configurations" in capsys.readouterr().out
    for bad, said in [
        ("p.txt", "should be a file that ends in one of"),
        ("campaign.yaml", "this would overwrite it; write to another file"),
        ("a-b.src", "letters, digits and _"),
        ("q.csv", "named twice"),
    ]:
        more = ["-o", str(tmp_path / "q.csv"), "-o", str(tmp_path / bad)]
        assert command.main([str(path), "-n", "4", *more]) == 2
        assert said in " ".join(capsys.readouterr().err.split()) and not (tmp_path / "q.csv").exists()
    assert "format: 1" in path.read_text()


@pytest.mark.parametrize("settle", ["-1", "nan", "soon", "1e9"])
def test_a_wait_that_is_none_is_bad_use(tmp_path: Path, settle: str) -> None:
    with pytest.raises(SystemExit) as stop:
        command.main([str(written(tmp_path)), "-n", "4", "-o", str(tmp_path / "p.script"), "--settle", settle])
    assert stop.value.code == 2


# -- the Python face


def test_python_plans_and_saves_what_the_command_does(tmp_path: Path) -> None:
    path = written(tmp_path)
    poses = aridcal.plan(path, 5)
    poses.save(tmp_path / "a.csv", str(tmp_path / "poses.script"), settle=2.0)
    assert command.main([str(path), "-n", "5", "-o", str(tmp_path / "b.csv")]) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert "sleep(2.000)" in (tmp_path / "poses.script").read_text()
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "a.csv"), poses.table, check_dtype=False)
    rows = robots.simulate(robots.ur10(), 40, np.random.default_rng(3), noise=1e-4)
    of_frame = load_campaign(path).with_tables([robots.table(rows)])
    assert aridcal.plan(of_frame, 4).design.measured > 20  # its rows are in no file
    assert poses.sigma["n"].tolist() == [1, 2, 5, 10] and "5 configurations" in repr(poses)
    for wrong, said in [
        (lambda: aridcal.plan(path, 0), "n: should be"),
        (lambda: aridcal.plan(path, 2.5), "n: should be"),  # type: ignore[arg-type]
        (lambda: aridcal.plan(path, 5, optimal="E"), "optimal: should be one of A, D, G"),  # type: ignore[arg-type]
        (lambda: aridcal.plan(path, 5, apart=("joint_1.joint_gain",)), "apart: should be two"),
        (lambda: poses.save(tmp_path / "p.txt"), "ends in one of"),
        (lambda: poses.save(tmp_path / "c.csv", path), "this would overwrite it; write to another file"),
    ]:
        with pytest.raises(aridcal.AridcalError, match=said):
            wrong()
    assert not (tmp_path / "c.csv").exists()


def test_tables_and_controllers_count_as_the_campaign_says_and_waypoints_as_the_urdf(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(
        path.read_text().replace("kind: pose", "kind: pose, joints: {elbow_joint: {sign: -1, zero: 90deg}}")
    )
    out = [part for name in ("p.csv", "p.yaml", "p.script") for part in ("-o", str(tmp_path / name))]
    assert command.main([str(path), "-n", "5", *out]) == 0
    table = pd.read_csv(tmp_path / "p.csv")
    document = yaml.safe_load((tmp_path / "p.yaml").read_text())
    points = np.array([point["positions"] for point in document["points"]])
    own = [k for k, point in enumerate(document["points"]) if point["configuration"]]
    elbow = document["joint_names"].index("elbow_joint")
    shown = points[own]
    shown[:, elbow] = np.pi / 2 - shown[:, elbow]
    np.testing.assert_allclose(table[document["joint_names"]], shown, atol=1e-8)
    np.testing.assert_array_equal(table["elbow_joint_direction"], -approach(points[:, elbow], 1e-6)[own])
    found = [re.findall(NUMBER, q) for q in re.findall(r"movej\(\[(.*?)\]", (tmp_path / "p.script").read_text())]
    moved = np.array(found, dtype=float)
    assert all(np.abs(moved - row).max(axis=1).min() < 1e-6 for row in shown)


def test_rows_measured_from_both_sides_are_added_to(tmp_path: Path) -> None:
    """Columns of directions in the table, written as the campaign calls them, come back in the plan."""
    rng = np.random.default_rng(3)
    table = robots.table(robots.simulate(robots.ur10(), 40, rng, noise=1e-4))
    (tmp_path / "robot.urdf").write_bytes(robots.ur10().urdf)
    table.assign(side=rng.choice([-1, 1], 40)).to_csv(tmp_path / "m.csv", index=False)
    path = tmp_path / "c.yaml"
    block = "{kind: pose, file: m.csv, columns: {elbow_joint_direction: side}}"
    path.write_text(
        f"format: 1\nrobot: {{urdf: robot.urdf, tip: {robots.ur10().tip}}}\nmeasurements: {block}\n"
        f"diagnosis: {{enabled: false}}\n{PLAY}"
    )
    plan = aridcal.plan(path, 6)
    assert list(plan.table.columns[6:]) == ["side"] and plan.table["side"].sum() == 0
    assert 20 < plan.design.measured <= 40 and plan.design.via.shape == (6, 6)
