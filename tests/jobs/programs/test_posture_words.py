"""Words for postures, by hand and by a closed form that the code under test does not use."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import robots
from calibrated import machine
from posture_arms import ABB, FANUC, KUKA, Arm

from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.jobs.apply.programs import fanuc, krl, rapid
from aridcal.jobs.apply.programs.axis_zeros import (
    LEAST_WITNESSES,
    cell_zeros,
    senses_hint,
    without_mirrored,
    zeros_hint,
)
from aridcal.jobs.apply.programs.branches import flange
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.notations import KUKA as NOTATION
from aridcal.jobs.apply.programs.postures import EITHER, fanuc_words, krl_words, rapid_words, unread_words
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.rewrite import Request, correct_programs
from aridcal.jobs.apply.programs.sentences import lines_of
from aridcal.jobs.apply.programs.targets import Branch, Target, Words
from aridcal.jobs.apply.programs.text import NONE, Number, Numbers
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.system.errors import AridcalError

KUKA_ZERO = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
"""Of a URDF whose upper arm is upright at zero."""


def numbers(*texts: str) -> tuple[Number, ...]:
    return tuple(Number(10 * k, text) for k, text in enumerate(texts))


Some = TypeVar("Some")


def some(given: Some | None) -> Some:
    assert given is not None
    return given


def krl_of(cell: Cell, status: str, turn: str) -> Words:
    return some(krl_words(Number(0, status), Number(10, turn), cell))


def rapid_of(cell: Cell, *data: str) -> Words:
    return some(rapid_words(numbers(*data), cell))


def fanuc_of(cell: Cell, letters: str, *turns: str) -> Words:
    return some(fanuc_words(Numbers(numbers(*letters, *turns)), cell))


BLANK = {KUKA: ("0", "0"), ABB: ("0", "0", "0", "0"), FANUC: ("F", "D", "B", "0", "0", "0")}
"""Words of each maker's language, of some posture."""


def words_of(arm: Arm, cell: Cell, texts: tuple[str, ...]) -> Words:
    """The words of the language of an arm's maker."""
    if arm is KUKA:
        return krl_of(cell, *texts)
    return rapid_of(cell, *texts) if arm is ABB else fanuc_of(cell, "".join(texts[:3]), *texts[3:])


def degrees(*shown: float) -> np.ndarray:
    return np.radians(shown)


def poses(arm: Arm, n: int, seed: int = 1) -> list[dict[tuple[bool, bool, bool], np.ndarray]]:
    """All eight positions at random poses that have eight, each checked to be one."""
    robot, rng = arm.robot(), np.random.default_rng(seed)
    every: list[dict[tuple[bool, bool, bool], np.ndarray]] = []
    while len(every) < n:
        q = np.radians(rng.uniform(-170.0, 170.0, 6))
        T = flange(robot, q)
        positions = arm.positions(T)
        if len(positions) == 8:
            for other in positions.values():
                np.testing.assert_allclose(flange(robot, other), T, atol=1e-9)
            assert min(np.abs(np.angle(np.exp(1j * (q - other)))).max() for other in positions.values()) < 1e-6
            every.append(positions)
    return every


def test_the_eight_positions_of_a_pose_have_the_eight_status_numbers_of_kuka() -> None:
    cell = Cell(KUKA.robot())
    for positions in poses(KUKA, 30):
        status = {sides: some(krl_of(cell, "0", "0").texts(q))[0] for sides, q in positions.items()}
        assert status == {
            (behind, below, flipped): str(int(behind) + 2 * (not below) + 4 * flipped)
            for behind, below, flipped in positions
        }


def test_turn_says_which_axes_of_kuka_are_negative() -> None:
    cell = Cell(KUKA.robot())
    for shown in np.random.default_rng(2).uniform(-170.0, 170.0, (50, 6)):
        _, turn = some(krl_of(cell, "0", "'B000000'").texts(np.radians(shown)))
        assert turn == "'B" + "".join("1" if axis < 0 else "0" for axis in shown[::-1]) + "'"


def test_cfx_of_abb_is_the_row_of_the_manuals_table() -> None:
    """Rows 0 to 7: in front or behind axis 1, in front of or behind the lower arm, axis 5 positive or negative."""
    cell = Cell(ABB.robot())
    table = list(itertools.product((False, True), repeat=3))
    for positions in poses(ABB, 30):
        for sides, q in positions.items():
            assert some(rapid_of(cell, "0", "0", "0", "0").texts(q))[3] == str(table.index(sides))


def test_the_positions_that_do_not_lean_backwards_have_letters_of_their_own_at_fanuc() -> None:
    cell = Cell(FANUC.robot())
    for positions in poses(FANUC, 30):
        for (behind, below, flipped), q in positions.items():
            letters = "".join(some(fanuc_of(cell, "FUT", "0", "0", "0").texts(q))[:3])
            assert letters == ("F" if flipped else "N") + ("D" if below and not behind else "U") + (
                "B" if behind else "T"
            )
            assert q[4] != 0 and (q[4] < 0) != flipped  # J5 is negative where the flange is bent down


@pytest.mark.parametrize(
    ("shown", "status", "turn"),
    [
        ((0, -90, 90, 0, 0, 0), "2", "2"),  # as $H_POS of new controllers is
        ((-10, -60, 80, 0, 40, -20), "2", "35"),
        ((-10, -60, 80, -5, -40, 20), "6", "27"),
        ((30, -160, 10, 170, 20, 10), "3", "2"),  # leaning over backwards
        ((0, -40, -10, 0, 30, 0), "0", "6"),  # bent backwards
    ],
)
def test_status_and_turn_of_kuka_by_hand(shown: tuple[float, ...], status: str, turn: str) -> None:
    cell = Cell(KUKA.robot())
    assert krl_of(cell, status, turn).agree(degrees(*shown))
    assert not krl_of(cell, str(int(status) ^ 1), turn).agree(degrees(*shown))
    assert not krl_of(cell, status, str(int(turn) ^ 2)).agree(degrees(*shown))


def test_kukas_status_changes_where_the_offset_of_axis_4_stretches_the_arm() -> None:
    """Axis 4 is 35 mm above axis 3, the wrist 420 mm on: the arm is stretched at A3 = atan(35 / 420)."""
    cell, phi = Cell(KUKA.robot()), math.degrees(math.atan2(35.0, 420.0))
    assert krl_of(cell, "0", "2").agree(degrees(0, -60, phi - 0.1, 0, 30, 0))
    assert krl_of(cell, "2", "2").agree(degrees(0, -60, phi + 0.1, 0, 30, 0))


@pytest.mark.parametrize(
    ("shown", "data"),
    [
        ((45, 20, 10, 45, 45, 45), ("0", "0", "0", "0")),
        ((-1, 20, 10, 95, -45, -91), ("-1", "1", "-2", "1")),
        ((179, 20, 10, 181, 45, 361), ("1", "2", "4", "0")),
        ((10, -80, 30, 10, 45, 10), ("0", "0", "0", "4")),
        ((10, 80, -160, 10, 45, 10), ("0", "0", "0", "2")),
    ],
)
def test_confdata_of_abb_by_hand(shown: tuple[float, ...], data: tuple[str, ...]) -> None:
    assert some(rapid_of(Cell(ABB.robot([(-400, 400)] * 6)), "7", "7", "7", "7").texts(degrees(*shown))) == data


def test_turn_numbers_of_fanuc_count_whole_turns_away_from_the_middle() -> None:
    words = fanuc_of(Cell(FANUC.robot()), "NUT", "0", "0", "0")
    for shown, turns in (
        ((0, 0, 0), "000"),
        ((179, -179, 10), "000"),
        ((181, 0, -181), ("1", "0", "-1")),
        ((0, 350, 0), "010"),
    ):
        q = degrees(shown[0], 0, -20, shown[1], -40, shown[2])
        assert some(words.texts(q))[3:] == tuple(turns)


def test_fanucs_letters_of_a_published_pose() -> None:
    """J. Wiley, The perils of six-axis robots (ONE Robotics, 2013): N U T, and F U T. J3 is shown from the horizontal."""
    cell = Cell(FANUC.robot())
    for wrist, letter in (((77.661, -51.975, -79.273), "N"), ((-102.339, 51.975, 100.727), "F")):
        q = degrees(7.962, -5.284, -36.250 - 5.284, *wrist)
        assert some(fanuc_of(cell, "NDB", "0", "0", "0").texts(q)) == (letter, "U", "T", "0", "0", "0")


@pytest.mark.parametrize(
    ("before", "after"),
    [("10", "11"), ("'B001010'", "'B001011'"), ("'HA'", "'HB'"), ("'h0a'", "'h0B'"), ("+10", "11"), ("74", "75")],
)
def test_a_turn_keeps_its_notation_and_its_other_bits(before: str, after: str) -> None:
    """Axis 1 crosses zero: T 10 becomes 11, and T 74, of which bit 6 is an external axis, 75."""
    cell = Cell(KUKA.robot())
    words = krl_of(cell, "2", before)
    assert words.agree(degrees(1, -60, 80, -5, 40, 20))
    assert some(words.texts(degrees(-1, -60, 80, -5, 40, 20)))[1] == after


def test_the_bit_of_an_absolutely_accurate_point_is_kept() -> None:
    words = krl_of(Cell(KUKA.robot()), "18", "2")
    assert words.agree(degrees(1, -60, 80, 5, 40, 20))
    assert some(words.texts(degrees(1, -60, 80, 5, -40, 20))) == ("22", "18")


def test_close_to_a_boundary_either_word_is_right_and_kept() -> None:
    near, beyond = math.degrees(0.5 * EITHER), math.degrees(2.0 * EITHER)
    for arm, rest, pair in (
        (KUKA, (-60, 80, 10, 40, 20), (("2", "2"), ("2", "3"))),
        (ABB, (20, 10, 45, 45, 45), (("+0", "0", "0", "0"), ("-1", "0", "0", "0"))),
    ):
        cell = Cell(arm.robot())
        for side in (-1, 1):
            agreeing = [
                [words_of(arm, cell, t).agree(degrees(side * off, *rest)) for t in pair] for off in (near, beyond)
            ]
            assert agreeing == [[True, True], [side > 0, side < 0]]
    for turn in ("0", "1"):
        words = fanuc_of(Cell(FANUC.robot()), "NUT", turn, "0", "0")
        assert all(words.agree(degrees(180 + side * near, 0, -20, 0, -40, 0)) for side in (-1, 1))


def test_words_stay_where_no_axis_crosses_a_boundary_and_change_where_one_does() -> None:
    """Between two random places: an odd number of crossings of zero changes a bit of T, and only that."""
    cell, rng = Cell(KUKA.robot()), np.random.default_rng(4)
    for _ in range(50):
        a = rng.uniform(-170.0, 170.0, 6)
        k = rng.integers(6)
        b = a.copy()
        b[k] = rng.uniform(-170.0, 170.0)
        before, after = (int(some(krl_of(cell, "0", "0").texts(np.radians(q)))[1]) for q in (a, b))
        assert before ^ after == (1 << int(k) if a[k] * b[k] < 0 else 0)


def test_words_that_are_no_whole_numbers_are_no_posture() -> None:
    q = degrees(1, -60, 80, 5, 40, 20)
    for text in ("2.5", "-2", "'B12'", "'B10", "B", "1e999", "nan", "9" * 400):
        assert krl_of(Cell(KUKA.robot()), text, "2").texts(q) is None
    for text in ("0.5", "1e999", "nan", "9E9x"):
        assert rapid_of(Cell(ABB.robot()), text, "0", "0", "0").texts(q) is None
    assert rapid_of(Cell(ABB.robot()), "0", "0", "0", "8").texts(q) is None


def test_a_program_that_says_nothing_of_the_posture_has_no_words() -> None:
    cell = Cell(KUKA.robot())
    assert krl_words(None, None, cell) is None
    assert rapid_words((), cell) is None
    assert fanuc_words(NONE, cell) is None
    assert some(krl_words(None, Number(0, "2"), cell)).texts(degrees(1, -60, 80, 5, 40, 20)) == ("2",)


def test_words_are_named_as_they_stand() -> None:
    assert krl_of(Cell(KUKA.robot()), "2", "10").names == "S 2, T 10"
    assert rapid_of(Cell(ABB.robot()), "0", "-1", "0", "1").names == "confdata [0,-1,0,1]"
    assert fanuc_of(Cell(FANUC.robot()), "NUT", "0", "0", "1").names == "CONFIG 'N U T, 0, 0, 1'"


def test_the_posture_of_an_arm_of_another_build_is_kept_and_that_is_said() -> None:
    """A UR's wrist has three axes that do not meet: only its axes' signs and quarters are known."""
    cell = Cell(robots.ur10())
    for q in np.random.default_rng(3).uniform(0.1, 1.0, (10, 6)):
        assert krl_of(cell, "5", "0").texts(q) == ("5", "0")
        assert rapid_of(cell, "0", "0", "0", "5").texts(q) == ("0", "0", "0", "5")
        assert fanuc_of(cell, "FDB", "0", "0", "0").texts(q) == tuple("FDB000")
    assert all(unread_words(row.name, cell) for row in (krl.ROW, rapid.ROW, fanuc.ROW))
    assert not any(
        unread_words(row.name, Cell(arm.robot()))
        for row, arm in ((krl.ROW, KUKA), (rapid.ROW, ABB), (fanuc.ROW, FANUC))
    )


def test_an_arm_of_which_an_axis_follows_another_is_of_another_build() -> None:
    lever = (
        '<link name="lever"/><joint name="side" type="revolute"><parent link="l1"/><child link="lever"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>'
    )
    followed = ABB.robot().urdf.decode().replace("</robot>", lever)
    followed = followed.replace('<child link="l3"/>', '<child link="l3"/><mimic joint="side" multiplier="-1"/>')
    assert Cell(parse_robot(followed.encode(), "l6", "world")).anatomy is None


def test_an_abb_that_cannot_bend_backwards_keeps_its_cfx_and_that_is_said() -> None:
    """Axis 3 of an arm with a parallel rod ends before the arm is stretched: RobotStudio uses no cfx there."""
    limits = [(-180.0, 180.0)] * 6
    limits[2] = (-60.0, 65.0)
    rod = Cell(ABB.robot(limits))
    assert rapid_of(rod, "0", "0", "0", "0").agree(degrees(10, 20, 10, 10, -45, 10))
    assert not rapid_of(Cell(ABB.robot()), "0", "0", "0", "0").agree(degrees(10, 20, 10, 10, -45, 10))
    assert "cfx" in unread_words(rapid.ROW.name, rod)


@pytest.mark.parametrize("mount", ['rpy="3.141592653589793 0 0"', 'rpy="0 1.5707963267948966 0.3" xyz="1 2 3"'])
def test_an_arm_on_a_ceiling_or_a_wall_has_the_same_words(mount: str) -> None:
    for arm, blank in BLANK.items():
        hung, standing = (words_of(arm, Cell(robot), blank) for robot in (arm.robot(mount=mount), arm.robot()))
        for q in np.radians(np.random.default_rng(5).uniform(-170.0, 170.0, (20, 6))):
            assert hung.texts(q) == standing.texts(q)


def test_words_are_those_of_the_controllers_angles_wherever_the_urdf_has_its_zero() -> None:
    own, other = Cell(KUKA.robot()), Cell(KUKA.robot(upright=True), zeros=KUKA_ZERO)
    for shown in np.random.default_rng(6).uniform(-170.0, 170.0, (50, 6)):
        q = np.radians(shown)
        np.testing.assert_allclose(flange(other.robot, q - np.radians(KUKA_ZERO)), flange(own.robot, q), atol=1e-12)
        assert krl_of(other, "0", "0").texts(q - np.radians(KUKA_ZERO)) == krl_of(own, "0", "0").texts(q)


@pytest.mark.parametrize("arm", [KUKA, ABB, FANUC])
def test_a_corrected_target_has_words_that_only_its_own_position_has(arm: Arm) -> None:
    """Close to a boundary of some word: the pose of the corrected joints, with the words for them, is no other position's."""
    cell, rng, crossed = Cell(arm.robot()), np.random.default_rng(7), 0
    for positions in poses(arm, 40, seed=8):
        for (behind, _, _), q in positions.items():
            if arm is FANUC and behind:  # of which the elbow's letter is not told
                continue
            axis, bounds = rng.choice([0, 3, 5]), [-np.pi, np.pi] if arm is FANUC else [-np.pi / 2, 0.0, np.pi / 2]
            place = q.copy()
            bound = rng.choice(bounds)
            place[axis] = bound + 4e-3 * rng.choice([-1, 1])
            real = place + rng.uniform(-1e-2, 1e-2, 6)
            arm_at = some(cell.anatomy)
            edges = (real[axis] - bound, arm_at.ahead(real), arm_at.bent(real), math.sin(real[4]))
            if np.abs(edges).min() < 2.0 * EITHER:  # where either word is right
                continue
            old = some(words_of(arm, cell, BLANK[arm]).texts(place))
            new = some(words_of(arm, cell, old).texts(real))
            crossed += old != new
            fitting = [
                turned
                for other in arm.positions(flange(cell.robot, real)).values()
                for turned in (other, other + np.round((real - other) / math.tau) * math.tau)
                if words_of(arm, cell, new).agree(turned)
            ]
            assert fitting
            assert all(np.abs(turned - real).max() < 1e-6 for turned in fitting)
    assert crossed > 10


def kuka_program(cell: Cell, n: int = 12, words: bool = True) -> tuple[list[Target], list[list[np.ndarray]]]:
    """Poses of a KUKA in its usual range with the words that KUKA's zeros give, and the URDF's positions at each."""
    truth, rng = Cell(KUKA.robot()), np.random.default_rng(9)
    upright = cell.robot.onward[2].translation[2] > 0.1
    targets, positions = [], []
    for _ in range(n):
        q = np.radians(rng.uniform([-90, -120, 30, -90, -90, -170], [90, -20, 120, 90, 90, 170]))
        T = flange(truth.robot, q)
        status, turn = some(krl_of(truth, "0", "0").texts(q))
        targets.append(Target(1, "P", "pose", branch=Branch(krl_of(cell, status, turn) if words else None)))
        positions.append([other - np.radians(KUKA_ZERO) * upright for other in KUKA.positions(T).values()])
    return targets, positions


def home(cell: Cell, *shown: float) -> Target:
    """A joint target, as a reader reads it."""
    axes = cell.axes
    own = tuple(Number(0, str(value)) for value in shown)
    return Target(1, "HOME", "joints", readings=axes.readings(own, axes.units(axes.arm, np.pi / 180.0, 1e-3)))


LIMITS = [(-170.0, 170.0), (-100.0, 135.0), (-210.0, 66.0), (-185.0, 185.0), (-120.0, 120.0), (-350.0, 350.0)]
"""A KUKA's limits where its URDF is upright at zero: A2 from -190 to 45, A3 from -120 to 156 degrees."""


def test_zeros_that_poses_and_geometry_speak_against_are_named() -> None:
    cell = Cell(KUKA.robot(LIMITS, upright=True))
    targets, positions = kuka_program(cell, 40)
    hint = zeros_hint(targets, positions, cell, krl.ROW.name)
    assert "KUKA's A2 zero is 90° off this URDF's and A3 zero is 90° off this URDF's" in hint
    assert "--zeros 0,-90,90,0,0,0" in hint


def test_zeros_that_joint_targets_beyond_limits_speak_against_are_named() -> None:
    """A3 of KUKA's home is 90 degrees; the URDF's goes no further than 66."""
    cell = Cell(KUKA.robot(LIMITS, upright=True))
    assert "--zeros 0,-90,90,0,0,0" in zeros_hint([home(cell, 0, -90, 90, 0, 0, 0)], [[]], cell, krl.ROW.name)


def test_nothing_is_said_of_zeros_that_are_right_or_stated_or_not_contradicted() -> None:
    right, upright = Cell(KUKA.robot()), KUKA.robot(LIMITS, upright=True)
    stated, bare = Cell(upright, zeros=KUKA_ZERO), Cell(upright)
    for cell in (right, stated):
        assert zeros_hint(*kuka_program(cell), cell, krl.ROW.name) == ""
    assert zeros_hint([home(stated, 0, -90, 90, 0, 0, 0)], [[]], stated, krl.ROW.name) == ""
    assert zeros_hint(*kuka_program(bare, LEAST_WITNESSES - 1), bare, krl.ROW.name) == ""
    assert zeros_hint(*kuka_program(bare, words=False), bare, krl.ROW.name) == ""
    own = [
        replace(t, branch=Branch(krl_of(bare, *some(krl_of(bare, "0", "0").texts(stands[0])))))
        for t, stands in zip(*kuka_program(bare), strict=True)
    ]  # written for the URDF's zeros, by an offline system that has them
    assert zeros_hint(own, kuka_program(bare)[1], bare, krl.ROW.name) == ""
    assert zeros_hint([home(bare, 0, -90, 30, 0, 0, 0)], [[]], bare, krl.ROW.name) == ""  # it can go there
    assert (
        zeros_hint([home(bare, 0, -90, 90, 0, 130, 0)], [[]], bare, krl.ROW.name) == ""
    )  # not with any zero of axis 2
    assert zeros_hint([], [], bare, krl.ROW.name) == ""


def test_nothing_is_said_of_zeros_where_words_are_wrong_whatever_the_zeros() -> None:
    """A program that says T 0 of every pose, as a bad postprocessor does."""
    for cell in (Cell(KUKA.robot()), Cell(KUKA.robot(LIMITS, upright=True))):
        targets, positions = kuka_program(cell, 30)
        wrong = [replace(t, branch=Branch(krl_of(cell, "2", "0"))) for t in targets]
        assert zeros_hint(wrong, positions, cell, krl.ROW.name) == ""


def test_axes_that_turn_the_other_way_than_the_makers_are_named() -> None:
    """As in a much used URDF of a KR 210, whose axes all turn to the left; and in one whose flange alone is turned round."""
    for row, arm in ((krl.ROW, KUKA), (rapid.ROW, ABB), (fanuc.ROW, FANUC)):
        for robot in (arm.robot(), arm.robot(upright=True), arm.robot(mount='rpy="3.141592653589793 0 0"')):
            assert senses_hint(Cell(robot), row.name) == ""
    left = Arm(KUKA.lengths, (1, 1, 1, 1, 1, 1), level=True)
    assert "j1, j4, j6 of the URDF turn the other way than KUKA's A1, A4, A6" in senses_hint(
        Cell(left.robot()), krl.ROW.name
    )
    flange_alone = Arm(FANUC.lengths, (1, 1, -1, -1, -1, 1), level=False)
    assert senses_hint(Cell(flange_alone.robot()), fanuc.ROW.name).startswith("j6 of the URDF")
    assert senses_hint(Cell(robots.ur10()), krl.ROW.name) == senses_hint(Cell(left.robot()), "URScript") == ""


def compensated(robot: Robot, ending: str, text: str, folder: Path) -> list[str]:
    """What is said of a program that is corrected for an arm without faults, calibrated everywhere."""
    solved = SolvedModel(Model(robot, ()), np.zeros(0), np.zeros((0, 0)))
    ranges = dict.fromkeys(robot.readings, (-7.0, 7.0))
    saved = SavedModel(solved, solved, "pose", (0.0, 0.0, -9.81), (5e-5, 5e-5), ranges, {})
    (folder / "calibration.yaml").write_text(saved.dump())
    (folder / f"a{ending}").write_text(text)
    answer = correct_programs(Request(folder / "calibration.yaml", (folder / f"a{ending}",), folder / f"b{ending}"))
    return lines_of(answer)


def krl_program(n: int) -> str:
    """PTP points of a KUKA with the words that its zeros give, and LIN points without any."""
    cell, lines = Cell(KUKA.robot()), []
    rng = np.random.default_rng(9)
    for k in range(n):
        q = np.radians(rng.uniform([-90, -120, 30, -90, -90, -170], [90, -20, 120, 90, 90, 170]))
        status, turn = some(krl_of(cell, "0", "0").texts(q))
        v = NOTATION.numbers(flange(cell.robot, q), np.zeros(6))
        pose = ",".join(f"{name} {value:.6f}" for name, value in zip("XYZABC", v, strict=True))
        lines.append(f"PTP {{{pose},S {status},T {turn}}}" if k % 3 else f"LIN {{{pose}}}")
    shown = ",".join(f"A{k + 1} {np.degrees(value):.4f}" for k, value in enumerate(q))
    return "\n".join(["DEF a()", "$BASE=$NULLFRAME", "$TOOL=$NULLFRAME", f"PTP {{{shown}}}", *lines, "END", ""])


def test_a_program_that_speaks_against_the_zeros_is_answered_with_what_to_state(tmp_path: Path) -> None:
    wrong = compensated(KUKA.robot(LIMITS, upright=True), ".src", krl_program(12), tmp_path)
    assert any("--zeros 0,-90,90,0,0,0" in line and line.startswith("note: ") for line in wrong)
    right = compensated(KUKA.robot(), ".src", krl_program(12), tmp_path)
    assert not any("--zeros" in line for line in right)


def unlike(robot: Robot, text: str) -> Sequence[Target]:
    """Targets of a KRL program for an arm of six axes, left where some of them turn the other way."""
    cell = Cell(robot)
    reading = krl.ROW.read(Project((SourceFile(Path("a.src"), text),)), cell)
    return without_mirrored(reading.targets, cell, krl.ROW.name)


def test_what_axes_that_turn_the_other_way_give_another_meaning_is_left() -> None:
    left = Arm(KUKA.lengths, (1, 1, 1, 1, 1, 1), level=True)
    targets = unlike(left.robot(), krl_program(6))
    assert len(targets) == 7
    for target in targets:
        counted = target.form == "joints" or target.branch.words is not None
        assert "turn the other way" in (target.why if counted else target.branch.unknown)
    assert not any(target.why or target.branch.unknown for target in unlike(KUKA.robot(), krl_program(6)))


def test_an_abb_program_for_a_urdf_that_lies_level_at_zero() -> None:
    """One whose zeros are KUKA's: A2 shows 90 degrees, A3 -90 where the URDF is at zero."""
    limits = [(-180, 180), (-180, 60), (-90, 165), (-180, 180), (-120, 120), (-180, 180)]
    level = Arm(ABB.lengths, ABB.signs, level=True).robot(limits)
    cell = Cell(level)
    hint = zeros_hint([home(cell, 0, 100, -100, 0, 30, 0)], [[]], cell, rapid.ROW.name)
    assert "--zeros 0,90,-90,0,0,0" in hint


CAMPAIGN = """format: 1
robot: {urdf: arm.urdf, tip: l6, base: world, controller_zeros: {j2: -1.5707963267948966, j3: 1.5707963267948966}}
measurements: {file: m.csv}
"""


def test_the_campaign_states_zeros_once_and_the_flag_takes_their_place(tmp_path: Path) -> None:
    saved = machine(5, n=40, robot=KUKA.robot(upright=True)).saved
    (tmp_path / "calibration.yaml").write_text(replace(saved, record={"campaign": CAMPAIGN}).dump())
    stated = SavedModel.load(tmp_path)
    np.testing.assert_allclose(cell_zeros(stated, None, krl.ROW), KUKA_ZERO)
    assert cell_zeros(stated, " 0,0,0,0,0,12.5 ", krl.ROW) == (0, 0, 0, 0, 0, 12.5)
    assert cell_zeros(stated, "0,0,0,0,0,0", krl.ROW) == cell_zeros(saved, None, krl.ROW) == ()


def test_programs_count_as_the_tables_do_where_nothing_else_is_said(tmp_path: Path) -> None:
    saved = machine(5, n=40, robot=KUKA.robot(upright=True)).saved
    tables = CAMPAIGN.replace("m.csv}", "m.csv, joints: {j3: {zero: 12deg}, j5: {zero: -90deg}}}")

    def stated(campaign: str) -> SavedModel:
        (tmp_path / "calibration.yaml").write_text(replace(saved, record={"campaign": campaign}).dump())
        return SavedModel.load(tmp_path)

    np.testing.assert_allclose(cell_zeros(stated(tables), None, krl.ROW), (0, -90, 90, 0, -90, 0))
    backwards = tables.replace("zero: -90deg", "sign: -1")
    with pytest.raises(AridcalError, match=r"measurements\.joints\.j5\.sign: .*controller_zeros: {j5: 0}"):
        cell_zeros(stated(backwards), None, krl.ROW)
    told = backwards.replace("controller_zeros: {", "controller_zeros: {j5: 0, ")
    np.testing.assert_allclose(cell_zeros(stated(told), None, krl.ROW), KUKA_ZERO)


def test_zeros_that_are_no_numbers_for_each_axis_are_refused() -> None:
    saved = machine(5, n=40, robot=KUKA.robot()).saved
    for given in ("", "0,0,0", "0,-90,90,0,0,x", "0,-90,90,0,0,nan", "0,-90,90,0,0,0,0", "inf,0,0,0,0,0"):
        with pytest.raises(AridcalError, match="6 numbers"):
            cell_zeros(saved, given, krl.ROW)


def test_a_campaign_that_names_a_joint_that_is_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_bytes(KUKA.robot().urdf)
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    assert nominal_robot(load_campaign(tmp_path / "campaign.yaml")).names[1] == "j2"
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN.replace("j3:", "j33:"))
    with pytest.raises(AridcalError, match=r"controller_zeros.*j33"):
        nominal_robot(load_campaign(tmp_path / "campaign.yaml"))
