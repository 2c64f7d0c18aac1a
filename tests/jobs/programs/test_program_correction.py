"""Targets corrected: the true arm comes to where the nominal one would, in the posture that is stated, or nothing changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
import robots
from calibrated import Machine, machine
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.instruments.pose import rotation_vector
from aridcal.engine.inverse.many_poses import ArmRows, InverseRows
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.jobs.apply.programs import branches, correct
from aridcal.jobs.apply.programs.branches import Controller, Poses, controller, flange, flanges
from aridcal.jobs.apply.programs.corrections import Correction, as_table
from aridcal.jobs.apply.programs.notations import ABB, FANUC, KUKA, UR, pose
from aridcal.jobs.apply.programs.targets import Branch, Notation, PoseReference, Target, Words
from aridcal.jobs.apply.programs.text import LARGEST_IN_PROGRAM, Number, Numbers
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel

HOME = np.array([0.3, -1.2, 1.5, -1.5, -1.4, 0.2])
"""A UR10 with its elbow and its wrist bent: far from where two of its positions meet."""

NOTATIONS = {"UR": UR, "KUKA": KUKA, "ABB": ABB, "FANUC": FANUC}


@cache
def arm() -> Machine:
    """A UR10 of which the truth is known, calibrated with noise."""
    return machine(3, n=150)


@cache
def real(
    *coefficients: Coefficient, urdf: bytes | None = None, size: float = 1e-3, turn: float = 2.0 * np.pi
) -> SavedModel:
    """An arm that is known exactly, as far as joints turn or slide by so much."""
    robot = robots.ur10() if urdf is None else parse_robot(urdf, "tip")
    every = (*constants(robot, "full"), *coefficients)
    theta = np.random.default_rng(0).normal(0.0, size, len(every))
    solved = SolvedModel(Model(robot, every), theta, np.zeros((len(every),) * 2))
    ranges = {name: (-turn, turn) for name in (*robot.readings, *solved.model.needs)}
    return SavedModel(solved, solved, "pose", (0.0, 0.0, -9.81), (5e-5, 5e-5), ranges, {})


def numbers(values: np.ndarray, digits: int) -> tuple[Number, ...]:
    return tuple(Number(0, f"{value:.{digits}f}") for value in values)


def stated(q: np.ndarray, *axes: int) -> Target:
    """A target of joints, all or some, in radians."""
    axes = axes or tuple(range(len(q)))
    texts = numbers(q[list(axes)], 6)
    readings = np.full(len(q), np.nan)
    readings[list(axes)] = [n.value for n in texts]
    return Target(1, "joints", "joints", Numbers(texts), readings=readings, units=tuple((1.0, k) for k in axes))


def shown(
    robot: Robot, q: np.ndarray, notation: Notation = UR, place: PoseReference | None = None, **branch: object
) -> Target:
    """A target that is a pose."""
    place = place or PoseReference(np.eye(4), np.eye(4))
    T = np.linalg.inv(place.base) @ flange(robot, q) @ place.tool
    texts = numbers(notation.numbers(T, np.ones(7)[: len(notation.digits)]), 6)
    return Target(1, "pose", "pose", Numbers(texts), notation=notation, place=place, branch=Branch(**branch))  # type: ignore[arg-type]


def frame(rng: np.random.Generator, size: float) -> np.ndarray:
    return pose(rng.uniform(-size, size, 3), Rotation.random(random_state=rng))


def seam(n: int, rng: np.random.Generator) -> np.ndarray:
    """Readings along a way in joints, each a little off the one before."""
    t = np.linspace(0.0, n / 40.0, n)[:, None]
    return HOME + 0.4 * np.sin(t * rng.uniform(0.5, 1.0, 6) + rng.uniform(0.0, 6.0, 6))


def crossing(n: int, rng: np.random.Generator) -> np.ndarray:
    """Readings along a way that passes a straight elbow and a straight wrist."""
    share = np.linspace(-1.0, 1.0, n)[:, None]
    return HOME * [1, 1, 0, 1, 0, 1] + share * rng.uniform(0.3, 0.6, 6)


def now(c: Correction) -> np.ndarray:
    """Its numbers as they are to be."""
    return np.array([float(text) for text in (c.texts or c.target.numbers.texts)])


def sent(robot: Robot, c: Correction, q: np.ndarray) -> np.ndarray:
    """Where a controller with the nominal arm sends the joints for a correction, from readings close by: one pose at a time."""
    if c.target.form == "joints":
        there = q.copy()
        for value, (unit, k) in zip(now(c), c.target.units, strict=True):
            there[k] = unit * value
        return there
    assert c.target.place is not None
    assert c.target.notation is not None
    return commanded(robot, c.target.place, c.target.notation.pose(now(c)), q)


def commanded(robot: Robot, place: PoseReference, T: np.ndarray, q: np.ndarray) -> np.ndarray:
    wanted = place.base @ T @ np.linalg.inv(place.tool)
    found = controller(robot).command(wanted[:3, :3], wanted[:3, 3], q, {})
    assert found.reached
    return found.readings


def off(m: Machine, wanted: np.ndarray, q: np.ndarray) -> tuple[float, float]:
    """How far the true target is from where it should be, and from where the calibrated model says, [m]."""
    final = m.saved.final
    world, tip = (frames[0][1].homogeneous for frames in final.model.frames(final.theta))
    _, true = m.model.poses(m.theta, m.model.rows(q[None]))
    _, said = final.poses(q[None])
    return float(np.linalg.norm(true[0] - (world @ wanted @ tip)[:3, 3])), float(np.linalg.norm(true[0] - said[0]))


@pytest.mark.parametrize("name", NOTATIONS)
def test_the_true_arm_comes_to_the_places_of_joints_and_of_poses_in_any_frame_with_any_tool(name: str) -> None:
    m, rng = arm(), np.random.default_rng(7)
    robot, wide = m.model.robot, replace(m.saved, ranges=dict.fromkeys(m.model.robot.readings, (-6.0, 6.0)))
    ways, targets = seam(60, rng), []
    for k, q in enumerate(ways):
        place = PoseReference(frame(rng, 1.0), frame(rng, 0.2))
        targets.append(stated(q) if k % 5 == 0 else shown(robot, q, NOTATIONS[name], place))
    found = correct.correct(wide, targets, {})
    assert [c.why for c in found] == [""] * 60
    before, after, model = [], [], []
    for c, q in zip(found, ways, strict=True):
        nominal = sent(robot, Correction(c.target, why="as it is"), q)
        wanted = flange(robot, nominal)
        there = sent(robot, c, nominal)
        before.append(off(m, wanted, nominal)[0])
        after.append(off(m, wanted, there)[0])
        model.append(off(m, wanted, there)[1])
    assert np.linalg.norm(after) < 1.2 * np.linalg.norm(model)
    assert np.linalg.norm(after) < 0.02 * np.linalg.norm(before)


BACKLASH = tuple(
    Coefficient(name, "axis", Basis("linear", (f"{name}_direction",), (0.0,))) for name in robots.ur10().names[1:4]
)
"""Joints that stand elsewhere when they come from the other side."""


def mixed(n: int, rng: np.random.Generator) -> list[Target]:
    """Joints, some of them alone, and poses, some of which are out of reach."""
    found = []
    for k, q in enumerate(crossing(n, rng)):
        target = shown(robots.ur10(), q) if k % 3 else stated(q, *((0, 4) if k % 6 == 3 else ()))
        far = PoseReference(pose(np.array([9.0, 0.0, 0.0]), Rotation.identity()), np.eye(4))
        found.append(replace(target, place=far) if k % 7 == 4 and target.place else target)
    return found


PROGRAMS: dict[str, Callable[[int, np.random.Generator], list[Target]]] = {
    "through singularities": lambda n, rng: [shown(robots.ur10(), q) for q in crossing(n, rng)],
    "far apart": lambda n, rng: [shown(robots.ur10(), q) for q in HOME + rng.uniform(-1.0, 1.0, (n // 3, 6))],
    "all together": mixed,
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_many_targets_at_once_are_corrected_as_one_after_the_other(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Backlash among the effects, so that the side matters from which each joint comes."""
    saved = real(*BACKLASH)
    targets = PROGRAMS[name](30, np.random.default_rng(11))
    together = correct.correct(saved, targets, {}, HOME)
    monkeypatch.setattr(correct, "TARGETS_AT_ONCE", 1)
    apart = correct.correct(saved, targets, {}, HOME)
    assert [(c.why, c.remark) for c in together] == [(c.why, c.remark) for c in apart]
    for one, other in zip(together, apart, strict=True):
        last_digit = [10.0 ** -len(text.split(".")[1]) for text in one.texts]
        values = (np.array([float(text) for text in c.texts]) for c in (one, other))
        assert (np.abs(np.subtract(*values)) < 1.01 * np.array(last_digit)).all()
    assert any(not c.why for c in together)


def test_a_joint_that_comes_from_the_other_side_is_sent_elsewhere() -> None:
    """Second road: the model of one row, with the side stated."""
    saved, up = real(*BACKLASH), np.array([0.0, 0.2, 0.2, 0.2, 0.0, 0.0])
    robot, final = saved.final.model.robot, saved.final
    ways = np.array([HOME, HOME + up, HOME, HOME + 2 * up, HOME + up])
    found = correct.correct(saved, [stated(q) for q in ways], {}, HOME - up)
    one = OneRowModel(final.model, final.theta)
    for c, q, side in zip(found, ways, (1.0, 1.0, -1.0, 1.0, -1.0), strict=True):
        there = sent(robot, c, q)
        _, p = one.pose(there, one.effects(there, {f"{name}_direction": side for name in robot.names}))
        assert np.linalg.norm(p - flange(robot, q)[:3, 3]) < 3e-6
        assert not c.why


RAIL = b"""<robot name="on_rail"><link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<link name="e"/><link name="f"/><link name="g"/><link name="tip"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>%s
<joint name="end" type="fixed"><parent link="g"/><child link="tip"/><origin xyz="0 0 0.1"/></joint></robot>"""

SIX = b"".join(
    b'<joint name="j%d" type="revolute"><parent link="%c"/><child link="%c"/><origin xyz="%s"/><axis xyz="%s"/>'
    b'<limit lower="-2.9" upper="2.9" effort="1" velocity="1"/></joint>' % (k, 96 + k, 97 + k, xyz, axis)
    for k, (xyz, axis) in enumerate(
        [
            (b"0 0 0.4", b"0 0 1"), (b"0.1 0 0.2", b"0 1 0"), (b"0 0 0.6", b"0 1 0"),
            (b"0.5 0 0.05", b"1 0 0"), (b"0.2 0 0", b"0 1 0"), (b"0.1 0 0", b"1 0 0"),
        ],
        start=1,
    )
)  # fmt: skip


def test_a_rail_stays_where_the_program_has_it() -> None:
    saved, rng = real(urdf=RAIL % SIX), np.random.default_rng(5)
    robot, final = saved.final.model.robot, saved.final
    ways = np.array([0.5, 0.2, 0.4, 0.3, 0.3, 0.6, 0.2]) + rng.uniform(-0.2, 0.2, (12, 7))
    targets = [shown(robot, q, held=np.array([q[0], *[np.nan] * 6])) for q in ways]
    one = OneRowModel(final.model, final.theta)
    for c, q in zip(correct.correct(saved, targets, {}, ways[0]), ways, strict=True):
        assert c.why == ""
        assert c.target.notation is not None
        T = c.target.notation.pose(now(c))
        low, high = robot.limits.T
        held = replace(controller(robot), low=np.array([q[0], *low[1:]]), high=np.array([q[0], *high[1:]]))
        there = held.command(T[:3, :3], T[:3, 3], q, {})
        assert there.reached
        assert np.linalg.norm(one.pose(there.readings, one.still)[1] - flange(robot, q)[:3, 3]) < 3e-6


# --- the arm's position ---------------------------------------------------------------------------------------------------------


def bits(*axes: int) -> Callable[[Sequence[str]], Words]:
    """Words of a made-up language: for some axes 1 where they are below zero but for whole turns, else 0."""

    def words(texts: Sequence[str]) -> Words:
        return Words(
            Numbers(Number(100 + k, text) for k, text in enumerate(texts)),
            lambda q: tuple("1" if np.sin(q[k]) < 0.0 else "0" for k in axes),
            "signs",
        )

    return words


ELBOW_AND_WRIST = bits(0, 2, 4)


def test_of_all_positions_that_one_is_taken_that_the_words_name() -> None:
    saved = real()
    robot = saved.final.model.robot
    flipped = [q for q in positions(robot, HOME) if ELBOW_AND_WRIST("000").texts(q) == ("0", "1", "0")]
    assert len(flipped) == 1
    for q, words in ((HOME, "001"), (flipped[0], "010")):
        (c,) = correct.correct(saved, [shown(robot, HOME, words=ELBOW_AND_WRIST(words))], {}, HOME)
        assert c.why == ""
        one = OneRowModel(saved.final.model, saved.final.theta)
        assert np.linalg.norm(one.pose(sent(robot, c, q), one.still)[1] - flange(robot, HOME)[:3, 3]) < 3e-6


def positions(robot: Robot, q: np.ndarray) -> list[np.ndarray]:
    """All positions of the arm with the tip at one place, by searches from many starts, one at a time."""
    T, nominal, rng = flange(robot, q), controller(robot), np.random.default_rng(0)
    found: list[np.ndarray] = []
    for _ in range(150):
        command = nominal.command(T[:3, :3], T[:3, 3], rng.uniform(-np.pi, np.pi, len(q)), {})
        there = (command.readings + np.pi) % (2 * np.pi) - np.pi
        if command.reached and not any(np.abs(np.sin((there - other) / 2)).max() < 1e-4 for other in found):
            found.append(there)
    return found


def test_every_position_of_the_arm_is_found() -> None:
    robot = robots.ur10()
    poses = Poses(flange(robot, HOME)[None], np.full((1, 6), np.nan), [None])
    (found,) = Controller(robot).positions(poses, HOME[None])
    other = positions(robot, HOME)
    assert len(found) == len(other) == 8
    for q in other:
        assert min(np.abs(np.sin((q - one) / 2)).max() for one in found) < 1e-6
    np.testing.assert_allclose(found[0], HOME, atol=1e-6)


def test_three_reasons_not_to_get_to_a_pose_are_told_apart() -> None:
    saved = real(urdf=RAIL % SIX.replace(b"2.9", b"1.0"))
    robot, held = saved.final.model.robot, np.array([0.5, *[np.nan] * 6])
    q = np.array([0.5, 0.2, 0.4, 0.3, 0.3, 0.6, 0.2])
    beyond = q + np.array(
        [0.0, 3.0, 0, 0, 0, 0, 0]
    )  # the first axis stops at 2.9, and all others would have to turn over
    targets = [
        shown(robot, q, held=held, words=bits(1, 3)("11")),
        replace(
            shown(robot, q, held=held), place=PoseReference(pose(np.array([9.0, 0, 0]), Rotation.identity()), np.eye(4))
        ),
        shown(robot, beyond, held=held),
    ]
    found = correct.correct(saved, targets, {}, q)
    assert found[0].why == "its posture (signs) is none that the nominal arm has there"
    assert found[1].why == correct.NOT_NOMINAL
    assert found[2].why == correct.LIMITED


def test_words_follow_the_corrected_joints_and_name_the_same_position() -> None:
    """An axis that a correction takes through zero changes its word; where it has none, nothing is changed."""
    saved = real()
    robot, q = saved.final.model.robot, HOME.copy()
    axis = 5
    (plain,) = correct.correct(saved, [shown(robot, q)], {}, q)
    by = float((sent(robot, plain, q) - q)[axis])
    q[axis] = -0.5 * by  # the correction takes it to the other side of zero
    before, after = ("1", "0") if by > 0 else ("0", "1")
    words = bits(axis)(before)
    (c,) = correct.correct(saved, [shown(robot, q, words=words)], {}, q)
    assert (c.why, c.words) == ("", (after,))
    assert words.texts(sent(robot, c, q)) == (after,)
    wordless = replace(words, texts=lambda at: words.texts(at) if (at[axis] < 0.0) == (q[axis] < 0.0) else None)
    (left,) = correct.correct(saved, [shown(robot, q, words=wordless)], {}, q)
    assert left.why == correct.WORDLESS
    assert (left.texts, left.words) == ((), ())


def test_a_pose_of_which_nobody_knows_where_the_arm_comes_from_is_left_unless_it_does_not_matter() -> None:
    robot, unknown = robots.ur10(), "no joint target stands before it"
    target = shown(robot, HOME, unknown=unknown)
    (left,) = correct.correct(real(), [target], {}, HOME)
    assert left.why == f"{unknown}; {correct.UNSETTLED}"
    assert left.doubt > 1e-4
    for settled in (
        replace(target, branch=Branch(unknown=unknown, near=HOME)),
        replace(target, branch=Branch(unknown=unknown, words=bits(0, 1, 2, 3, 4)("01011"))),
    ):
        (c,) = correct.correct(real(), [settled], {}, HOME)
        assert c.why == ""
    (same,) = correct.correct(real(size=1e-7), [target], {}, HOME)  # hardly any error: all corrections agree
    assert (same.why, same.positions) == ("", 8)


def test_numbers_that_are_used_a_constant_way_off_are_corrected_where_that_helps_there_too() -> None:
    saved = real()
    robot = saved.final.model.robot
    near, far = (pose(np.array([0.0, 0.0, -by]), Rotation.identity()) for by in (0.05, 0.1))
    turned = pose(np.zeros(3), Rotation.from_rotvec([0.0, 0.0, 2.5]))  # another way round, on the same pose
    one = OneRowModel(saved.final.model, saved.final.theta)
    for beside, worth in (([near], True), ([near, far], True), ([turned], False), ([near, turned], False)):
        places = tuple(PoseReference(np.eye(4), np.linalg.inv(shift)) for shift in beside)
        target = shown(robot, HOME)
        found = correct.correct(saved, [replace(target, beside=places)], {}, HOME)
        (c,) = found
        (alone,) = correct.correct(saved, [target], {}, HOME)
        assert bool(c.why) is not worth
        remains = []
        for place in places:
            was, will = (commanded(robot, place, UR.pose(values), HOME) for values in (target.values, now(alone)))
            wanted = flange(robot, was)[:3, 3]
            remains.append([float(np.linalg.norm(one.pose(q, one.still)[1] - wanted)) for q in (was, will)])
        assert c.beside == pytest.approx(max(after for _, after in remains), abs=1e-7)
        if worth:
            assert c.remark == correct.ALSO_A_CONSTANT
            assert all(after < 0.5 * before for before, after in remains)
            assert f"{1e3 * c.beside:.6f} mm" in as_table(found)["remark"][0]
        else:
            assert c.why == correct.BESIDE_WORSE


def test_what_is_left_stays_as_it_is_and_changes_name_the_file() -> None:
    saved = replace(real(), ranges=dict.fromkeys(robots.ur10().readings, (-2.0, 2.0)))
    targets = [replace(stated(HOME), file=3), stated(HOME + 2.0), replace(stated(HOME), why="line 3 computes with it")]
    told: list[int] = []
    found = correct.correct(saved, targets, {}, HOME, told.append)
    _, beyond, spoilt = found
    assert {change.file for change in found.changes()} == {3}
    assert (beyond.why, spoilt.why) == (correct.BEYOND_MEASURED, "line 3 computes with it")
    assert beyond.texts == spoilt.texts == ()
    assert told == [0]
    table = as_table(found)
    assert table["corrected"].tolist() == [True, False, False]
    assert table["moved_mm"].tolist()[1:] == [0.0, 0.0]


def test_a_perfect_arm_changes_nothing() -> None:
    saved = real(size=0.0)
    found = correct.correct(
        saved, [stated(HOME), *(shown(robots.ur10(), q) for q in seam(5, np.random.default_rng(1)))], {}
    )
    for c in found:
        assert c.why == ""
        np.testing.assert_allclose(now(c), c.target.values, atol=1.1e-6)


# --- the arithmetic in arrays ---------------------------------------------------------------------------------------------------


def test_rotation_vectors_are_those_of_pinocchio_at_all_angles() -> None:
    rng = np.random.default_rng(3)
    for angle in (0.0, 1e-12, 1e-6, 0.5, 3.0, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9):
        vectors = angle * np.array([v / np.linalg.norm(v) for v in rng.normal(size=(5, 3))])
        R = np.array([pin.exp3(v) for v in vectors])
        np.testing.assert_allclose([pin.exp3(v) for v in rotation_vector(R)], R, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(rotation_vector(R), axis=1), angle, atol=1e-7)


@pytest.mark.parametrize("kinds", ["RRRRRR", "PRRRRRR", "RPRCR", "PPP", "RRR"])
def test_many_rows_come_to_their_poses_as_one_row_does(kinds: str) -> None:
    """Effects that depend on the joints; a single row by the other module."""
    robot, rng = robots.random_robot(4, kinds), np.random.default_rng(2)
    wave = Coefficient(robot.names[0], "axis", Basis("sin", (robot.names[0],), (1.0,)))
    every = (*constants(robot, "full"), wave)
    model, theta = Model(robot, every), rng.normal(0.0, 1e-3, len(every))
    q = robots.readings(robot, 50, rng, 0.5)
    low, high = robot.limits.T
    turning = np.array([kind != "prismatic" for kind in robot.kinds])
    rows = InverseRows(ArmRows(model, theta), low, high, turning, 1.0)
    one = replace(controller(robot), model=OneRowModel(model, theta))
    wanted = np.tile(np.eye(4), (50, 1, 1))
    wanted[:, :3, :3], wanted[:, :3, 3], J = rows.arm.looks(q, {})
    seeds, held = q + 0.02 * rng.normal(size=q.shape), np.full(q.shape, np.nan)
    found = rows.approach(wanted, seeds, held, {})
    for k in range(50):
        R, p, own = one.model.jacobian(q[k], one.model.effects(q[k], {}))
        np.testing.assert_allclose(wanted[k, :3, :3], R, atol=1e-9)
        np.testing.assert_allclose(J[k], own, atol=1e-9)
        command = one.command(R, p, seeds[k], {})
        if command.reached:
            assert np.linalg.norm(found.error[k]) < 1e-7
            if len(robot.readings) <= 6:
                np.testing.assert_allclose(found.readings[k], command.readings, atol=1e-4)


def test_no_configuration_is_further_away_than_the_arm_reaches() -> None:
    for robot in (robots.ur10(), robots.arid(), *(robots.random_robot(k, "RRRRRR") for k in range(4))):
        q = robots.readings(robot, 5_000, np.random.default_rng(0), 1.0)
        assert not Controller(robot).too_far(flanges(robot, q)).any()
    away = np.tile(np.eye(4), (1, 1, 1))
    away[0, :3, 3] = [0.0, 1.5, 0.1]
    assert Controller(robots.ur10()).too_far(away).all()


@pytest.mark.parametrize("name", NOTATIONS)
def test_notations_say_of_many_poses_what_they_say_of_each(name: str) -> None:
    notation, rng = NOTATIONS[name], np.random.default_rng(6)
    values = rng.uniform(-4.0, 4.0, (20, len(notation.digits))) * (1.0 if name == "UR" else 60.0)
    poses = notation.pose(values)
    written = notation.numbers(poses, values)
    for own, T, said in zip(values, poses, written, strict=True):
        np.testing.assert_allclose(notation.pose(own), T, atol=1e-12)
        np.testing.assert_allclose(notation.numbers(T, own), said, atol=1e-9)


def test_windows_of_any_size_give_the_same_walk(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, rng = robots.ur10(), np.random.default_rng(8)
    ways = np.concatenate([seam(40, rng), HOME + rng.uniform(-1.0, 1.0, (12, 6)), crossing(40, rng)])
    n = len(ways)
    chain = branches.Chain(
        np.zeros(n, dtype=bool), np.full((n, 6), np.nan),
        Poses(flanges(robot, ways), np.full((n, 6), np.nan), [None] * n), np.full((n, 6), np.nan),
    )  # fmt: skip
    found = []
    for size in (1, 8, 2048):
        monkeypatch.setattr(branches, "NARROW", size)
        monkeypatch.setattr(branches, "USUAL", size)
        found.append(Controller(robot).walk(chain, HOME, {})[0])
    for other in found[1:]:  # with the elbow straight, readings are less sharp than the tip's place
        np.testing.assert_allclose(other, found[0], atol=branches.SAME_POSITION)
        np.testing.assert_allclose(flanges(robot, other), flanges(robot, found[0]), atol=2 * branches.REACHED_TOLERANCE)


def test_numbers_that_a_correction_makes_larger_than_any_arm_has_are_left() -> None:
    """What is written must be read again as a target: a reader refuses such numbers."""
    endless = robots.random_chain(np.random.default_rng(2), kinds="CCCCCC")
    saved = real(urdf=endless, turn=2 * LARGEST_IN_PROGRAM)
    q = np.array([LARGEST_IN_PROGRAM, -1.2, 1.5, -1.5, -1.4, 0.2])
    found = [correct.correct(saved, [stated(q * [sign, 1, 1, 1, 1, 1])], {})[0] for sign in (1.0, -1.0)]
    assert sorted(c.why for c in found) == ["", correct.TOO_LARGE]
    assert all(abs(float(text)) <= LARGEST_IN_PROGRAM for c in found for text in c.texts)
