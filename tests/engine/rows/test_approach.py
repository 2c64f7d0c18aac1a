"""The side of approach from the order of rows: derived where no column gives it, and for backlash alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from searched import searched

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, candidates
from aridcal.engine.rows.approach import approach, with_directions
from aridcal.engine.rows.dataset import dataset
from aridcal.engine.search.diagnose import covariates_and_exclusions
from aridcal.engine.search.loop import fit_constants
from aridcal.files.campaign import load_campaign
from aridcal.files.read import load_measurements
from aridcal.jobs.apply.target_poses import predict, read_query
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration

PLAY = 3e-4
JOINT = 1
BACKLASH = {"diagnosis": {"candidates": ["joint_backlash", "joint_gain"]}, "parameters": {"set": "none"}}


def test_a_joint_that_comes_back_to_a_configuration_keeps_its_side() -> None:
    reading = np.array([0.0, 0.5, 0.5004, np.nan, 0.4998, 0.2, 0.2, 0.9])
    assert approach(reading, 1e-3).tolist() == [0, 1, 1, 1, 1, -1, -1, 1]


def test_each_file_has_its_own_order_and_time_goes_before_it() -> None:
    q = np.array([[0.0, 1.0], [1.0, 0.5], [0.5, 0.7], [0.0, 0.2]])
    rows = dataset(("a", "b"), ("revolute", "revolute"), q, np.zeros((4, 3)), covariates={"b_direction": np.ones(4)})
    rows = rows.with_origin(file=np.array([0, 0, 1, 1]))
    assert with_directions(rows).origin.derived == ("a_direction",)  # b's was measured
    assert with_directions(rows).covariates["a_direction"].tolist() == [0, 1, 0, -1]
    timed = replace(rows, covariates={"time": np.array([5.0, 4.0, 2.0, np.nan])})
    assert with_directions(timed).covariates["a_direction"].tolist() == [-1, 0, 0, -1]
    assert with_directions(timed).covariates["b_direction"].tolist() == [1, 0, 0, -1]


def campaign(folder: Path, shuffled: bool = False) -> Path:
    """A UR10 with play in one joint, measured row after row; nobody wrote the side down."""
    rng = np.random.default_rng(5)
    truth = robots.simulate(robots.ur10(), 200, rng, 0.0, 5e-5, world=robots.random_placement(rng))
    table = robots.table(truth)
    name = truth.model.robot.readings[JOINT]
    table[name] -= PLAY * approach(truth.readings[:, JOINT], 1e-3)
    if shuffled:
        table = table.sample(frac=1, random_state=1)
    return robots.write_campaign(folder, truth, table, **BACKLASH)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return identify(campaign(tmp_path_factory.mktemp("play")))


def test_play_is_found_from_the_order_of_rows_and_said_to_be(played: Outcome) -> None:
    (effect,) = played.effects
    name = robots.ur10().readings[JOINT]
    assert (effect.effect.kind, effect.effect.where, effect.effect.by) == ("joint_backlash", name, "direction")
    fit = played.stage("final").fit
    assert fit.theta[fit.model.names.index(effect.effect.coefficients[0].name)] == pytest.approx(PLAY, rel=0.1)
    assert [n for n in played.notices if "derived from the order of the rows" in n and name in n]
    assert played.causes is not None and played.causes.further == ()


def test_where_rows_are_in_no_order_play_is_scatter_of_that_joint(tmp_path: Path) -> None:
    found = searched(campaign(tmp_path, shuffled=True))
    assert "joint_backlash" not in {effect.kind for effect in found.effects}
    assert found.arm.causes is not None
    assert [c.name for c in found.arm.causes.further] == [robots.ur10().readings[JOINT]]


def test_nothing_but_backlash_may_depend_on_a_derived_side(tmp_path: Path) -> None:
    """Every other candidate is the same with it and without."""
    found = load_campaign(campaign(tmp_path))
    robot = robots.ur10()
    rows = with_directions(load_measurements(found, robot.readings, robot.limits, robot.kinds))
    geometric = fit_constants(found.question, robot, rows, ()).geometric
    train = rows.select(rows.train)
    asked = [
        covariates_and_exclusions(geometric.model, part)[0]
        for part in (train, replace(train, covariates={}).with_origin(derived=()))
    ]
    with_it, without = (candidates(part, [k for k in EFFECT_KINDS if EFFECT_KINDS[k].testable]) for part in asked)
    more = set(with_it) - set(without)
    assert {(e.kind, e.by) for e in more} == {("joint_backlash", "direction")}
    assert len(more) == len(robot.joints)


def test_predict_takes_the_middle_where_the_side_is_unknown_and_says_so(played: Outcome, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(calibration(played).dump(), encoding="utf-8")
    saved = SavedModel.load(path)
    robot = robots.ur10()
    column = f"{robot.readings[JOINT]}_direction"
    asked = pd.DataFrame(robots.readings(robot, 5, np.random.default_rng(1)), columns=list(robot.readings))
    query = read_query(saved, asked)
    assert [n.column for n in query.notices] == [column]
    found = predict(saved, query)
    both = [predict(saved, read_query(saved, asked.assign(**{column: side}))) for side in (-1, 1)]
    for axis in "xyz":
        np.testing.assert_allclose(found[axis], (both[0][axis] + both[1][axis]) / 2, atol=1e-6)
    assert not found["extrapolates"].all()
