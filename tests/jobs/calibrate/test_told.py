"""What no reading told of a calibration is in its file: predictions say where it matters, also when rows are long gone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
import yaml

from aridcal.engine.trust.workspace import KNOWN_TARGET_SIGMA
from aridcal.jobs.apply.target_poses import predict, read_query, uncertainty
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.system.errors import CampaignError

STILL = "elbow_joint"
AT = 0.9


def saved_from(folder: Path, still: bool, n: int = 40) -> tuple[Outcome, SavedModel]:
    """A UR10 whose elbow stood still all the time, or moved like the other joints; by way of the file."""
    rng = np.random.default_rng(2)
    truth = robots.simulate(
        robots.ur10(), n, rng, world=robots.random_placement(rng), tip=robots.random_placement(rng, 0.2)
    )
    model, q = truth.model, truth.readings.copy()
    if still:
        q[:, model.robot.readings.index(STILL)] = AT
    R, p = model.poses(truth.theta, model.rows(q))
    p = p + 1e-4 * rng.standard_normal(p.shape)
    truth = replace(truth, measured=robots.measured(model.robot, q, p, R))
    noise = {"position": 1e-4, "rotation": 1e-4}
    path = robots.write_campaign(
        folder, truth, measurements={"file": "measurements.csv", "kind": "pose", "noise": noise}
    )
    outcome = identify(path)
    (folder / "calibration.yaml").write_text(calibration(outcome).dump(), "utf-8")
    return outcome, SavedModel.load(folder / "calibration.yaml")


@pytest.fixture(scope="module")
def stood(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, SavedModel, Path]:
    folder = tmp_path_factory.mktemp("stood")
    return *saved_from(folder, True), folder / "calibration.yaml"


def asked(saved: SavedModel, elbow: np.ndarray) -> pd.DataFrame:
    rng, robot = np.random.default_rng(4), saved.final.model.robot
    table = pd.DataFrame(robots.readings(robot, len(elbow), rng), columns=list(robot.readings))
    return table.assign(**{STILL: elbow})


def test_a_joint_that_never_moved_leaves_places_untold(stood: tuple[Outcome, SavedModel, Path]) -> None:
    _, saved, _ = stood
    table = asked(saved, np.array([AT, AT, AT + 0.02, AT + 0.5, AT - 1.5, np.nan]))
    made = predict(saved, read_query(saved, table))
    assert made["told"].tolist() == [True, True, True, False, False, False]
    far = read_query(saved, table.iloc[:5])
    assert uncertainty(saved, far, (0.0, 0.0, 0.0))["told"].tolist() == [True, True, True, False, False]


def test_what_the_file_says_is_what_the_report_says(stood: tuple[Outcome, SavedModel, Path]) -> None:
    """Second road: the whole workspace from the rows themselves."""
    outcome, saved, _ = stood
    assert outcome.certainty is not None
    there = outcome.certainty.anywhere
    table = pd.DataFrame(there.readings, columns=list(saved.final.model.robot.readings))
    made = predict(saved, read_query(saved, table))
    np.testing.assert_array_equal(made["told"], there.observable & there.turns_told)
    assert 0.0 < made["told"].mean() < 1.0


def test_other_constants_predict_something_else_there_and_nowhere_else(stood: tuple[Outcome, SavedModel, Path]) -> None:
    """Attack: constants moved along what is said to be untold fit all rows as well, and miss other places."""
    outcome, saved, _ = stood
    solved, m = saved.final, outcome.measurements
    others = {c for part in saved.untold for c, _ in part} - set(solved.model.coefficients)
    wide = solved.model.with_coefficients((*solved.model.coefficients, *others))
    before = np.append(solved.theta, np.zeros(len(others)))
    there = asked(saved, np.full(30, AT + 1.5)).to_numpy(float)
    moved = []
    for part in saved.untold:
        way = dict(part)
        theta = before + 1e-3 * np.array([way.get(c, 0.0) for c in wide.coefficients])
        at_rows, elsewhere = (
            np.abs(wide.poses(theta, wide.rows(q))[1] - wide.poses(before, wide.rows(q))[1]).max()
            for q in (m.readings, there)
        )
        assert at_rows < 1e-6
        moved.append(elsewhere)
    assert max(moved) > 1e-3 * KNOWN_TARGET_SIGMA


def test_where_all_joints_moved_nothing_is_said_of_it(tmp_path: Path) -> None:
    _, saved = saved_from(tmp_path, False)
    assert saved.untold == ()
    assert "untold" not in (tmp_path / "calibration.yaml").read_text("utf-8")
    made = predict(saved, read_query(saved, asked(saved, np.array([0.3, 1.0]))))
    assert "told" not in made


@pytest.mark.parametrize(
    ("change", "said"),
    [({"where": "no_joint"}, r"calibration\.yaml"), ({"value": "much"}, "value"), ({"value": float("inf")}, "value")],
)
def test_a_damaged_file_is_refused(
    stood: tuple[Outcome, SavedModel, Path], change: dict[str, object], said: str, tmp_path: Path
) -> None:
    keys = yaml.safe_load(stood[2].read_text("utf-8"))
    keys["untold"][0][0] |= change
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(keys), "utf-8")
    with pytest.raises(CampaignError, match=said):
        SavedModel.load(tmp_path / "calibration.yaml")
