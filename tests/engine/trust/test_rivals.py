"""Causes that the rows cannot tell apart: named as ties, weighed, kept with the model, and part of what a prediction states."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import honesty
import numpy as np
import pandas as pd
import pytest
from calibrated import NOISE, Machine, machine
from robots import measured
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.evidence import Score
from aridcal.engine.search.rival_models import weights
from aridcal.engine.trust.rival_predictions import Rival
from aridcal.files.query import load_query
from aridcal.jobs.apply.joint_commands import compensate
from aridcal.jobs.apply.target_poses import predict, read_query
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.history.comparison import compare
from aridcal.jobs.maintain.checking import check
from aridcal.jobs.maintain.hypotheses import widened
from aridcal.jobs.maintain.repair import repair_calibration

STEP = Coefficient("elbow_joint", "axis", Basis("step", ("elbow_joint",), (0.2,)))
SLOPE = Coefficient("shoulder_lift_joint", "axis", Basis("linear", ("shoulder_lift_joint",), (0.0,)))


@cache
def arm() -> Machine:
    """A calibrated UR10, read only but for its random numbers."""
    return machine(3, n=150)


def rivals() -> tuple[Rival, ...]:
    """Two of one effect, each with other coefficients beside its own."""
    saved = arm().saved
    own = saved.final.model.coefficients[0]
    return (
        Rival("a step", "a gain", 0.3, ((STEP, 4e-5), (own, -1e-5))),
        Rival("a slope", "a gain", 0.2, ((SLOPE, 3e-5),)),
    )


def asked(saved: SavedModel, n: int = 60) -> pd.DataFrame:
    """Joints within what was measured."""
    rng = np.random.default_rng(5)
    names = saved.final.model.robot.readings
    return pd.DataFrame({name: rng.uniform(*saved.ranges[name], n) for name in names})


def predicted(saved: SavedModel, table: pd.DataFrame) -> pd.DataFrame:
    robot = saved.final.model.robot
    return predict(saved, load_query(table, robot.readings, robot.limits, robot.kinds, saved.measurements))


def shifted(saved: SavedModel, rival: Rival) -> SavedModel:
    """The model that a rival is: its coefficients changed, those that it lacks beside them."""
    model, theta = saved.final.model, dict(zip(saved.final.model.coefficients, saved.final.theta, strict=True))
    for coefficient, value in rival.change:
        theta[coefficient] = theta.get(coefficient, 0.0) + value
    return replace(
        saved,
        final=SolvedModel(
            model.with_coefficients(tuple(theta)), np.array(list(theta.values())), np.zeros((len(theta),) * 2)
        ),
    )


def test_a_prediction_is_the_mean_over_the_causes_and_states_the_spread_between_them() -> None:
    """Second road: each cause predicts by itself; mean and variance are those of a mixture, with weights 0.5, 0.3 and 0.2."""
    saved = arm().saved
    table = asked(saved)
    alone, beside = predicted(saved, table), predicted(replace(saved, rivals=rivals()), table)
    place, std = ["x", "y", "z"], ["std_x", "std_y", "std_z"]
    each = [alone[place].to_numpy(), *(predicted(shifted(saved, rival), table)[place].to_numpy() for rival in rivals())]
    shares = np.array([0.5, 0.3, 0.2])
    mean = np.einsum("k,kni->ni", shares, each)
    assert np.abs(mean - each[0]).max() > 5e-6
    np.testing.assert_allclose(beside[place], mean, atol=1e-9)
    between = np.einsum("k,kni->ni", shares, (np.array(each) - mean) ** 2)
    stated = np.sqrt(alone[std].to_numpy() ** 2 + between)
    np.testing.assert_allclose(beside[std], stated, rtol=5e-4)  # differences of 10 um are linear as far as that


def test_a_command_brings_the_mean_over_the_causes_to_the_wanted_pose() -> None:
    saved = replace(arm().saved, rivals=rivals())
    table = asked(saved, 6)
    poses = predicted(saved, table)
    for row, pose in zip(table.to_numpy(), poses.to_dict("records"), strict=True):
        wanted = np.eye(4)
        wanted[:3, :3] = Rotation.from_quat([pose[name] for name in ("qx", "qy", "qz", "qw")]).as_matrix()
        wanted[:3, 3] = [pose[name] for name in "xyz"]
        found = saved.command(wanted, row + 1e-3)
        assert found.reached
        np.testing.assert_allclose(found.readings, row, atol=1e-6)


def test_a_column_that_only_a_rival_depends_on_need_not_be_given_and_stands_in_the_middle() -> None:
    saved = arm().saved
    warm = Coefficient("elbow_joint", "axis", Basis("linear", ("temperature",), (20.0,)))
    own = saved.final.model.coefficients[0]
    either = Rival("heat", "a gain", 0.5, ((warm, 2e-5), (own, -1e-5)))
    saved = replace(saved, rivals=(either,), recorded={"temperature": (18.0, 26.0)})
    table = asked(saved)
    without, middle = predicted(saved, table), predicted(saved, table.assign(temperature=22.0))
    place, std = ["x", "y", "z"], ["std_x", "std_y", "std_z"]
    pd.testing.assert_frame_equal(without[place], middle[place])
    wide, known = (np.linalg.norm(one[std], axis=1) for one in (without, middle))
    assert (wide >= known).all() and (wide > 1.2 * known).any()  # it may have been any
    warmer = predicted(saved, table.assign(temperature=26.0))
    assert np.abs(warmer[place] - middle[place]).to_numpy().max() > 1e-5
    wanted = without.drop(columns=list(saved.final.model.robot.readings))
    commanded = compensate(saved, read_query(saved, wanted, poses=True))
    assert commanded["reached"].all()


def test_rivals_are_kept_with_the_model_and_older_files_have_none(tmp_path: Path) -> None:
    saved = replace(arm().saved, rivals=rivals())
    file = tmp_path / "calibration.yaml"
    file.write_text(saved.dump())
    again = SavedModel.load(file)
    assert again.rivals == saved.rivals
    table = asked(saved)
    pd.testing.assert_frame_equal(predicted(again, table), predicted(saved, table))
    file.write_text(arm().saved.dump())
    assert "rivals" not in file.read_text() and SavedModel.load(file).rivals == ()


@pytest.mark.parametrize("which", [0, 1])
def test_new_rows_of_a_cause_that_could_not_be_told_are_no_alarm_and_a_joint_that_jumped_is_one(which: int) -> None:
    m, large = arm(), 40.0
    some = tuple(replace(r, change=tuple((c, large * value) for c, value in r.change)) for r in rivals())
    named = replace(m.saved, rivals=())
    doubted = replace(m.saved, rivals=some)
    q, jumped = m.configurations(12), 2e-3 * np.eye(6)[3]
    noise = NOISE * np.random.default_rng(2).standard_normal((2, 12, 3))

    def rows(offset: np.ndarray | float) -> Dataset:
        other = shifted(m.saved, some[which]).final
        R, p = other.model.poses(other.theta, other.model.rows(q + offset))
        R = Rotation.from_rotvec(noise[1]).as_matrix() @ R
        return measured(other.model.robot, q, p + noise[0], R)

    assert not check(named, rows(0.0)).good
    assert check(doubted, rows(0.0)).good
    found = check(doubted, rows(jumped))
    assert [cause.where for cause in found.causes] == [named.final.model.robot.names[3]]
    assert not repair_calibration(doubted, found).saved.rivals


@pytest.mark.parametrize("which", [0, 1])
def test_the_cause_that_was_not_named_is_no_change_between_two_calibrations_and_a_zero_that_changed_is(
    which: int,
) -> None:
    saved, large = arm().saved, 40.0
    some = tuple(replace(r, change=tuple((c, large * value) for c, value in r.change)) for r in rivals())
    other = shifted(saved, some[which])
    fitted = np.pad(saved.final.covariance, (0, len(other.final.theta) - len(saved.final.theta)))
    other = replace(other, final=replace(other.final, covariance=fitted))
    free = widened(other.final)
    zero = free.model.names.index("elbow_joint.axis")
    worn = replace(other, final=replace(free, theta=free.theta + 3e-3 * np.eye(len(free.theta))[zero]))
    assert compare(saved, other).changed
    for pair in ((replace(saved, rivals=some), other), (other, replace(saved, rivals=some))):
        assert not compare(*pair).changed
    found = compare(replace(saved, rivals=some), worn)
    assert [cause.names for cause in found.causes.changes] == [("elbow_joint.axis",)]
    assert found.causes.changes[0].value[0] == pytest.approx(3e-3, rel=0.05)


def score(gain: float) -> Score:
    """The evidence of a candidate, [nat]."""
    return Score(gain, 0.0, 1)


def test_causes_are_weighed_alike_beforehand_however_many_places_each_has() -> None:
    time, place = Basis("step", ("time",), (5.0,)), Basis("step", ("elbow_joint",), (0.2,))
    of_time = [(Effect("shift", name, (Coefficient(name, "axis", time),)), score(2.0)) for name in "abcd"]
    of_place = [(Effect("joint_map", "e", (Coefficient("e", "axis", place),)), score(2.0))]
    shares = weights([*of_time, *of_place])
    assert sum(shares) == pytest.approx(1.0)
    assert sum(shares[:4]) == pytest.approx(0.5)
    behind = weights([*of_place, (of_time[0][0], score(2.0 - np.log(9.0)))])
    assert behind == pytest.approx([0.9, 0.1])


@pytest.mark.parametrize("shuffled", [False, True])
def test_a_jump_in_a_joint_is_named_where_rows_tell_it_from_one_in_time_and_a_tie_where_they_do_not(
    shuffled: bool,
) -> None:
    said = honesty.rivals(2, "joint", "time", shuffled)
    assert (said["told"], said["false"]) == (1.0, 0.0)
    assert said["plainly"] == float(shuffled)
    assert 0.5 < said["z"] < 1.5
