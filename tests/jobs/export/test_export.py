"""A calibration as code: what runs without us computes what `predict` computes."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import compiled
import numpy as np
import pytest
import robots
import tree_robot
from compiled import BAD_INPUT, LIMIT, NOT_REACHED, OK, OUT_OF_RANGE, Export
from exported import saved_from, spoilt, written
from scipy.spatial.transform import Rotation

from aridcal import export
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.corrections.sights import TARGET, Sights
from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Route, parse_robot, with_limbs
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.export.casadi_function import casadi_function
from aridcal.jobs.export.machine import machine
from aridcal.jobs.export.numpy_code import numpy_module
from aridcal.runs.model_export import export_c, predicted_rows

ROUNDING = 1e-12
"""[m] and in R: what the export promises; some hundred roundings of lengths of a few metres."""


def module_from(text: str, folder: Path) -> ModuleType:
    """A written module, imported."""
    path = folder / "exported.py"
    path.write_text(text, "utf-8")
    spec = importlib.util.spec_from_file_location("exported", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ROBOTS = {
    "arm": lambda: robots.random_robot(1),
    "gantry": lambda: robots.random_robot(2, "PPPRR"),
    "hanging from its middle": lambda: parse_robot(
        robots.random_chain(np.random.default_rng(3), "RCPRR"), "tip", "link_2"
    ),
    "on a side branch": lambda: parse_robot(robots.random_chain(np.random.default_rng(4), "RCPRR"), "tip", "branch"),
}


@pytest.mark.parametrize("which", ROBOTS)
def test_numpy_and_casadi_compute_what_predict_does_for_every_form_of_basis(which: str, tmp_path: Path) -> None:
    saved = spoilt(len(which), ROBOTS[which]())
    described = machine(saved)
    rows = predicted_rows(saved, described, 200)
    q, c = np.split(rows.inputs, [len(described.joints)], axis=1)
    module = module_from(numpy_module(described, "0" * 64, ["an arm"]), tmp_path)
    assert saved.final.model.robot.readings == module.JOINTS
    R, p = module.forward(q, dict(zip(module.CONDITIONS, c.T, strict=True)))
    np.testing.assert_allclose(R, rows.R, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(p, rows.p, rtol=0, atol=ROUNDING)
    pytest.importorskip("casadi")
    function = casadi_function(described)
    for k in range(5):
        R_k, p_k = function(q[k], c[k])
        np.testing.assert_allclose(np.array(R_k), rows.R[k], rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(np.array(p_k)[:, 0], rows.p[k], rtol=0, atol=ROUNDING)


@pytest.fixture(scope="module")
def of_everything(tmp_path_factory: pytest.TempPathFactory) -> tuple[SavedModel, Export, np.ndarray]:
    """A robot with every form of basis, its export, and rows of readings and conditions."""
    folder = tmp_path_factory.mktemp("c")
    saved = spoilt(5, ROBOTS["gantry"](), size=3e-4)
    described, name = export_c(written(saved, folder / "results"), folder / "arm-5", None)
    assert name == "arm_5"
    return saved, Export(folder / "arm-5", name), predicted_rows(saved, described, 30, seed=1).inputs


def test_the_test_that_is_written_beside_the_code_passes_under_the_sanitizers(tmp_path: Path) -> None:
    compiled.compiler()
    saved = spoilt(6, ROBOTS["hanging from its middle"](), count=25)
    _, name = export_c(written(saved, tmp_path / "results"), tmp_path / "arm", None)
    said = compiled.program(tmp_path / "arm", name, "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    assert said.startswith("arm: 1000 rows")
    text = (tmp_path / "arm" / "arm_test.c").read_text("utf-8")
    (tmp_path / "arm" / "arm_test.c").write_text(text.replace("TOLERANCE 1e-12", "TOLERANCE 1e-18"), "utf-8")
    with pytest.raises(Exception, match="exit status 1"):
        compiled.program(tmp_path / "arm", name)


def test_the_jacobian_is_that_of_forward_by_differences(
    of_everything: tuple[SavedModel, Export, np.ndarray],
) -> None:
    saved, exported, rows = of_everything
    n, h = len(saved.final.model.robot.readings), 1e-6
    for row in rows:
        q, c = row[:n], row[n:]
        _, R, _ = exported.forward(q, c)
        J = exported.jacobian(q, c)
        for j, unit in enumerate(h * np.eye(n)):
            (_, R_ahead, ahead), (_, R_behind, behind) = exported.forward(q + unit, c), exported.forward(q - unit, c)
            np.testing.assert_allclose((ahead - behind) / (2 * h), J[:3, j], rtol=0, atol=1e-7)
            turn = (R_ahead - R_behind) @ R.T / (2 * h)
            np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], J[3:, j], rtol=0, atol=1e-7)


def test_the_nominal_arm_stands_between_the_frames_that_were_identified(
    of_everything: tuple[SavedModel, Export, np.ndarray],
) -> None:
    saved, exported, rows = of_everything
    model = saved.expected.model
    world, tip = model.frames(saved.expected.theta)
    bare = Model(model.robot, (), world, tip)
    q = rows[:, : len(model.robot.readings)]
    R, p = bare.poses(np.zeros(0), bare.rows(q))
    for k in range(len(q)):
        status, R_k, p_k = exported.nominal(q[k])
        assert status == OK
        np.testing.assert_allclose(R_k, R[k], rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(p_k, p[k], rtol=0, atol=ROUNDING)


def test_what_is_no_number_is_refused_and_nothing_is_written(
    of_everything: tuple[SavedModel, Export, np.ndarray],
) -> None:
    _, exported, rows = of_everything
    n = len(exported.names("joint_names"))
    assert len(exported.names("condition_names")) == rows.shape[1] - n
    for k in (0, n - 1, n, rows.shape[1] - 1):
        for bad in (np.nan, np.inf, -np.inf):
            row = rows[0].copy()
            row[k] = bad
            status, R, p = exported.forward(row[:n], row[n:])
            assert status == BAD_INPUT and not R.any() and not p.any()
            status, q, error = exported.correct(row[:n], row[n:])
            assert status == BAD_INPUT and np.isnan(q).all() and np.isnan(error).all()
            assert exported.in_range(row[:n], row[n:]) == BAD_INPUT


def ur10(theta: float, tmp_path: Path, kind: str = "pose") -> tuple[SavedModel, Export]:
    """A UR10 whose joints and gravity's sag are off by ``theta``, and its export."""
    robot = robots.ur10()
    sag = [Coefficient(name, "axis", Basis("linear", (f"{name}.gravity_torque",), (0.0,))) for name in robot.names[1:4]]
    play = Coefficient(robot.names[1], "axis", Basis("linear", (f"{robot.names[1]}_direction",), (0.0,)))
    model = Model(robot, (*constants(robot, "full"), *sag, play), around=Surroundings())
    values = np.full(len(model.coefficients), theta)
    values[-4:-1] = 0.02 * theta  # rad / (N m): of a hundred newton metres twice the rest
    saved = saved_from(model, values, kind)
    saved = replace(saved, holes={robot.readings[0]: ((0.2, 0.3),)})
    _, name = export_c(written(saved, tmp_path / "results"), tmp_path / "ur10", None)
    return saved, Export(tmp_path / "ur10", name)


@pytest.fixture(scope="module")
def of_a_ur10(tmp_path_factory: pytest.TempPathFactory) -> tuple[SavedModel, Export]:
    return ur10(1e-3, tmp_path_factory.mktemp("ur10"))


def test_corrected_joints_bring_the_target_as_near_to_the_nominal_arms_as_compensate_does(
    of_a_ur10: tuple[SavedModel, Export],
) -> None:
    saved, exported = of_a_ur10
    inverse, rng, column = saved.inverse_kinematics(), np.random.default_rng(0), "shoulder_lift_joint_direction"
    low, high = np.array([saved.ranges[name] for name in saved.final.model.robot.readings]).T
    squares, reached = np.zeros(2), 0
    for wanted in rng.uniform(low, high, (60, 6)):
        c = rng.choice([-1.0, 1.0], 1)
        _, R, p = exported.nominal(wanted)
        status, q, error = exported.correct(wanted, c)
        R_real, p_real = saved.expected.poses(q[None], {column: c})
        turn = Rotation.from_matrix(R @ R_real[0].T).magnitude()
        np.testing.assert_allclose(error, [np.linalg.norm(p - p_real[0]), turn], rtol=1e-6, atol=1e-9)
        assert (status == NOT_REACHED) == (error.max() > 1e-5)
        reached += status != NOT_REACHED
        command = inverse.command(R, p, wanted, {column: float(c[0])})
        assert command.reached == (status != NOT_REACHED)
        squares += error[0] ** 2, command.position_error**2
    assert 50 <= reached < 60  # some stretched arms would have to be longer
    assert squares[0] <= 1.05**2 * squares[1]


def test_beside_a_straight_wrist_corrected_joints_come_as_near_as_compensate_does(
    of_a_ur10: tuple[SavedModel, Export],
) -> None:
    """There every search sticks: one of too few steps or starts leaves a fifth more."""
    saved, exported = of_a_ur10
    inverse, rng, column = saved.inverse_kinematics(), np.random.default_rng(3), "shoulder_lift_joint_direction"
    low, high = np.array([saved.ranges[name] for name in saved.final.model.robot.readings]).T
    rows = rng.uniform(low, high, (200, 6))
    rows[:, 4] = rng.uniform(-0.05, 0.05, 200)
    squares, stuck = np.zeros(2), 0
    for wanted in rows:
        _, R, p = exported.nominal(wanted)
        command = inverse.command(R, p, wanted, {column: 1.0})
        squares += exported.correct(wanted, np.ones(1))[2][0] ** 2, command.position_error**2
        stuck += command.position_error > 1e-5
    assert stuck > 5
    assert squares[0] <= 1.05**2 * squares[1]


def test_statuses_tell_limits_from_ranges_and_holes(of_a_ur10: tuple[SavedModel, Export]) -> None:
    _, exported = of_a_ur10
    c, q = np.ones(1), np.array([0.1, -1.0, 1.0, 0.3, 0.8, 0.2])
    assert exported.in_range(q, c) == OK == exported.correct(q, c)[0]
    inside_the_hole = q + [0.15, 0, 0, 0, 0, 0]
    assert exported.in_range(inside_the_hole, c) == OUT_OF_RANGE
    assert exported.in_range(q, 2 * c) == OUT_OF_RANGE


def test_a_joint_that_cannot_go_on_is_said_to_stand_at_its_limit(tmp_path: Path) -> None:
    robot = robots.arid()
    coefficients = constants(robot, "full")
    saved = saved_from(Model(robot, coefficients), np.full(len(coefficients), 1e-3))
    _, name = export_c(written(saved, tmp_path / "results"), tmp_path / "arid", None)
    exported, (low, high) = Export(tmp_path / "arid", name), robot.limits.T
    rail = robot.kinds.index("prismatic")
    for end, sense in ((low, -1.0), (high, 1.0)):
        wanted = (low + high) / 2 + 0.1
        wanted[rail] = end[rail] + 0.3 * sense
        status, q, error = exported.correct(wanted, np.zeros(1))
        assert status == LIMIT and q[rail] == end[rail] and error[0] > 0.02
        assert np.all((low <= q) & (q <= high))


def test_of_positions_alone_the_position_is_reached_and_no_rotation_is_claimed(tmp_path: Path) -> None:
    _, exported = ur10(1e-3, tmp_path, "position")
    wanted = np.array([0.1, -1.0, 1.0, 0.3, 0.8, 0.2])
    _, _, p = exported.nominal(wanted)
    status, q, error = exported.correct(wanted, np.ones(1))
    assert status == OK and error[0] < 1e-9 and np.isnan(error[1])
    np.testing.assert_allclose(exported.forward(q, np.ones(1))[2], p, rtol=0, atol=1e-9)


def test_frames_of_the_first_station_are_taken_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng, robot = np.random.default_rng(3), robots.arid()
    world = tuple((label, robots.random_placement(rng)) for label in "AB")
    sag = Coefficient("joint_2", "axis", Basis("linear", ("joint_2.gravity_torque",), (0.0,)))
    own = tuple(Coefficient("world_base", "x", Basis("linear", ("time",), (0.0,)), label) for label in "AB")
    moved = tuple(Coefficient("world_base", "yaw", station=label) for label in "AB")
    around = Surroundings(np.array([[0.0, 9.81, 0.0], [9.81, 0.0, 0.0]]))
    model = Model(robot, (sag, *own, *moved), world, around=around)
    saved = saved_from(model, np.array([1e-5, 1e-3, 2e-3, 0.01, 0.02]))
    described = machine(saved)
    rows = predicted_rows(saved, described, 50)
    q, time = rows.inputs[:, :-1], rows.inputs[:, -1]
    _, p = saved.final.poses(q, {"time": time}, np.full(50, "A"))
    np.testing.assert_array_equal(rows.p, p)
    assert export.main([str(written(saved, tmp_path / "r")), "--numpy", str(tmp_path / "arm.py")]) == 0
    assert "'A'" in capsys.readouterr().out
    module = module_from((tmp_path / "arm.py").read_text("utf-8"), tmp_path)
    np.testing.assert_allclose(module.forward(q, {"time": time})[1], p, rtol=0, atol=ROUNDING)


def test_joints_of_any_name_keep_it_in_c(tmp_path: Path) -> None:
    names = {"joint_1": 'the "NAME" */ ??/ \\n joint', "joint_2": "NAME_double", "joint_3": "Gelenk Süd"}
    text = robots.random_chain(np.random.default_rng(1), "RRR").decode()
    for old, new in names.items():
        text = text.replace(f'name="{old}"', f'name="{new.replace(chr(34), "&quot;")}"')
    robot = parse_robot(text.encode(), "tip")
    gain = Coefficient(names["joint_2"], "axis", Basis("sin", (names["joint_1"],), (2.0,)))
    heat = Coefficient(names["joint_3"], "r1", Basis("linear", ("temperature NAME",), (2.0,)))
    saved = saved_from(Model(robot, (gain, heat)), np.array([1e-3, 1e-3]))
    _, name = export_c(written(saved, tmp_path / "results"), tmp_path / "out", "double_arm")
    exported = Export(tmp_path / "out", name)
    assert exported.names("joint_names") == list(names.values())
    assert exported.names("condition_names") == ["temperature NAME"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--list"),
        (["--name", "arm"], "--c DIR"),
        (["--c", "out", "--name", "7th arm"], "no name in C"),
        (["--c", "out", "--name", "double"], "no name in C"),
        (["--numpy", "arm.txt"], "should be a .py file"),
        (["--casadi", "arm.py"], "should be a .casadi file"),
        (["--c", "mine", "--name", "arm"], "CMakeLists.txt: is there"),
        (["--numpy", "mine/own.py"], "own.py: is there"),
    ],
)
def test_what_cannot_be_written_is_refused_and_what_is_there_stays(
    options: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    robot = robots.arid()
    written(
        saved_from(Model(robot, constants(robot, "full")), np.zeros(len(constants(robot, "full")))), Path("results")
    )
    Path("mine").mkdir()
    for name in ("CMakeLists.txt", "own.py"):
        (Path("mine") / name).write_text("mine\n")
    before = sorted(map(str, tmp_path.rglob("*")))
    assert export.main(["results", *options]) == 2
    assert words in capsys.readouterr().err
    assert sorted(map(str, tmp_path.rglob("*"))) == before
    assert (Path("mine") / "own.py").read_text() == "mine\n"


def test_an_export_is_replaced_by_the_next_and_other_files_stay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = robots.arid()
    coefficients = constants(robot, "full")
    results = written(saved_from(Model(robot, coefficients), np.zeros(len(coefficients))), tmp_path / "results")
    out = tmp_path / "arm"
    out.mkdir()
    (out / "main.c").write_text("mine\n")
    for _ in range(2):
        assert export.main([str(results), "--c", str(out), "--numpy", str(tmp_path / "arm.py")]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["CMakeLists.txt", "arm.c", "arm.h", "arm_test.c", "main.c"]
    assert export.main([str(results), "--list"]) == 0
    assert "--c DIR" in capsys.readouterr().out


@pytest.mark.parametrize("first", ["left_hand", "right_hand"])
def test_of_several_limbs_the_first_targets_is_exported_with_its_own_path(first: str, tmp_path: Path) -> None:
    rng, hands = np.random.default_rng(8), ["left_hand", "right_hand"]
    robot = with_limbs(parse_robot(tree_robot.urdf(), "left_hand", "torso"), ["right_hand"])
    tip = tuple((hand, robots.random_placement(rng, 0.1)) for hand in sorted(hands, key=lambda hand: hand != first))
    coefficients = [Coefficient("world_base", c, Basis("ball", TARGET, (0.3, 0.2, 0.3, 2.0))) for c in "xyz"]
    for side in ("left", "right"):
        load = Basis("linear", (f"{side}_j4.gravity_torque",), (0.0,))
        coefficients += [Coefficient(f"{side}_j4", "axis", load), Coefficient(f"{side}_j2", "pitch")]
    around = Surroundings(sights=Sights(np.array([frame.translation for _, frame in tip])))
    routes = tuple(Route(None, None if hand == robot.tip else hand) for hand in hands)
    on = {hand: hand for hand in hands if hand != robot.tip}
    model = Model(robot, tuple(coefficients), tip_target=tip, around=around, routes=routes, target_on=on)
    saved = saved_from(model, rng.normal(0.0, 1e-2, len(coefficients)))
    described = machine(saved)
    assert first in described.frames
    rows = predicted_rows(saved, described, 30)
    module = module_from(numpy_module(described, "0" * 64, ["two arms"]), tmp_path)
    R, p = module.forward(rows.inputs)
    np.testing.assert_allclose(R, rows.R, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(p, rows.p, rtol=0, atol=ROUNDING)
    other = "right" if first == "left_hand" else "left"
    still = [k for k, name in enumerate(robot.readings) if name.startswith(other)]
    assert not described.moves[still].any() and described.moves.sum() == 7


def test_a_long_arm_keeps_its_loads_and_leaves_their_slopes_out(tmp_path: Path) -> None:
    robot = robots.random_robot(3, "R" * 9)
    sag = [Coefficient(name, "axis", Basis("linear", (f"{name}.gravity_torque",), (0.0,))) for name in robot.names]
    saved = saved_from(Model(robot, tuple(sag)), np.full(9, 1e-4))
    described = machine(saved)
    assert described.loads_held and len(described.slopes) == 9
    rows = predicted_rows(saved, described, 20)
    module = module_from(numpy_module(described, "0" * 64, ["a long arm"]), tmp_path)
    np.testing.assert_allclose(module.forward(rows.inputs)[1], rows.p, rtol=0, atol=ROUNDING)
