"""Two arms that hold one body, as Pinocchio has them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import two_arms
import yaml
from scipy.spatial.transform import Rotation
from searched import searched

import aridcal
from aridcal.engine.instruments.joined import JOINED
from aridcal.jobs.calibrate.job_inputs import read_job
from aridcal.jobs.calibrate.saved_model import SolvedModel
from aridcal.runs.repair_folder import recalibrate
from aridcal.system.errors import AridcalError

LIMIT = 1.3
"""Held-out errors of some 30 rows scatter by less."""

XYZ = ["x", "y", "z"]


def test_a_grasp_starts_where_its_rows_have_the_second_link() -> None:
    rng = np.random.default_rng(3)
    R, p = Rotation.random(1, rng).as_matrix(), rng.normal(0, 1, (1, 3))
    off = Rotation.from_rotvec(rng.normal(0, 1e-3, (400, 3))).as_matrix()
    found = JOINED.located(off @ R, np.repeat(p, 400, axis=0), np.zeros((400, 0)), [])  # type: ignore[misc]
    np.testing.assert_allclose(found[:3], p[0], rtol=0, atol=1e-12)
    away = Rotation.from_matrix(found[3:].reshape(3, 3) @ R[0].T).magnitude()
    assert away < 4 * 1e-3 * np.sqrt(3 / 400)
    assert np.isnan(JOINED.located(R[:0], p[:0], np.zeros((0, 0)), [])).all()  # type: ignore[misc]


def write(
    folder: Path, ways: tuple[str, ...] = ("joined",), rows: int = 128, **more: Any
) -> tuple[two_arms.Machine, Path]:
    robot = two_arms.machine()
    q = np.random.default_rng(0).uniform(-1.1, 1.1, (rows, len(robot.joints)))
    return robot, two_arms.write(folder, robot, ways, q, **more)


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> tuple[two_arms.Machine, aridcal.Calibration, Path]:
    folder = tmp_path_factory.mktemp("held")
    robot, path = write(folder)
    return robot, aridcal.calibrate(path), folder


def test_held_out_rows_are_met_to_the_noise(held: tuple[two_arms.Machine, aridcal.Calibration, Path]) -> None:
    _, found, _ = held
    errors = found.errors.loc["final"].loc["test"]
    assert errors["position_rms_mm"] < LIMIT * np.sqrt(3.0) * 1e3 * two_arms.SIGMA
    assert errors["rotation_rms_mrad"] < LIMIT * np.sqrt(3.0) * 1e3 * two_arms.SIGMA
    assert found.errors.loc["nominal"].loc["test"]["position_rms_mm"] > 2.0
    assert found.result["verdict"] == "noise_floor" and found.effects.empty


def test_new_grasps_hold_the_hands_where_they_are(held: tuple[two_arms.Machine, aridcal.Calibration, Path]) -> None:
    """What no gauge touches: the predicted pose of one hand in the other stays what it is while the real robot's does."""
    robot, found, folder = held
    (folder / "calibration.yaml").write_text(found.model.dump(), encoding="utf-8")
    loaded = aridcal.load(folder / "calibration.yaml")
    q, label = two_arms.grasps(robot, 80, np.random.default_rng(5), 0.0)
    told = found.predict(robot.table(q), of="right_hand", within="left_hand")[XYZ].to_numpy(float)
    again = loaded.predict(robot.table(q), of="right_hand", within="left_hand")[XYZ].to_numpy(float)
    np.testing.assert_allclose(told, again, rtol=0, atol=1e-12)
    spread = [np.sqrt(told[label == name].var(axis=0).sum()) for name in np.unique(label)]
    assert max(spread) < two_arms.SIGMA


def test_grasps_are_among_the_results_and_on_the_report(
    held: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path
) -> None:
    held[1].save(tmp_path / "out")
    told = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "two links that hold one body" in told and "grasp 3" in told
    grasps = yaml.safe_load((tmp_path / "out" / "result.json").read_text())["instruments"]["grasps"]
    assert len(grasps) == two_arms.GRASPS


def test_a_tracker_beside_it_tells_the_rest(tmp_path: Path) -> None:
    robot, path = write(tmp_path, ("tracker", "joined"), 64, diagnosis={"enabled": False})
    fit = searched(path).fit
    model = SolvedModel(fit.model, fit.theta, fit.covariance)
    q = np.random.default_rng(8).uniform(-1.0, 1.0, (40, len(robot.joints)))
    read = robot.table(q)[list(fit.model.robot.readings)].to_numpy()
    told = {side: model.poses(read, target=np.full(len(q), side))[1] for side in ("left", "right")}
    left, right = (
        np.array([T.act(own) for T in robot.seen(q, "torso", f"{side}_hand")])
        for side, own in (("left", two_arms.LEFT), ("right", two_arms.RIGHT))
    )
    between = np.linalg.norm(told["left"] - told["right"], axis=1)
    np.testing.assert_allclose(between, np.linalg.norm(left - right, axis=1), rtol=0, atol=5e-4)


@pytest.mark.parametrize("moved", ["", "right_j3"])
def test_new_grasps_tell_which_joint_of_which_arm_moved_and_mend_it(
    moved: str, held: tuple[two_arms.Machine, aridcal.Calibration, Path], tmp_path: Path
) -> None:
    """Grasps that the calibration never saw, of a real robot whose zero has moved; the mended one holds them still."""
    robot, before, folder = held
    (folder / "calibration.yaml").write_text(before.model.dump(), encoding="utf-8")
    since = replace(robot, slipped=(moved, 2e-3) if moved else None)
    two_arms.write(tmp_path / "since", since, ("joined",), np.zeros((32, len(robot.joints))), seed=7)
    new = pd.read_csv(tmp_path / "since" / "joined.csv")
    new["grasp"] = "new " + new["grasp"]
    if not moved:
        assert before.check(new).good
        return
    lines = recalibrate(folder, new, tmp_path / "mended")
    limb = f"{moved.partition('_')[0]}_hand"
    (size,) = re.findall(rf"the zero of {moved} \(limb to {limb}\), by \+([\d.]+) ", " ".join(lines))
    assert abs(float(size) - 2.0) < 0.3
    after = aridcal.load(tmp_path / "mended")
    q, label = two_arms.grasps(since, 40, np.random.default_rng(5), 0.0)
    spread = []
    for each in (before, after):
        places = each.predict(robot.table(q), of="right_hand", within="left_hand")[XYZ].to_numpy(float)
        spread.append(max(np.sqrt(places[label == name].var(axis=0).sum()) for name in np.unique(label)))
    assert spread[1] < 2 * two_arms.SIGMA < 5 * two_arms.SIGMA < spread[0]


SLIPS: dict[str, tuple[dict[str, Any], str]] = {
    "no links": ({"links": None}, "needs the two links that hold one body"),
    "one link": ({"links": ["left_hand", "left_hand"]}, "needs the two links that hold one body"),
    "the world": ({"links": ["world", "left_hand"]}, "needs the two links that hold one body"),
    "a link that is none": ({"links": ["left_hand", "right_hnd"]}, r"measurements.links: no link 'right_hnd' .*'right_hand'"),
    "a target": ({"target": "left"}, "`kind: joined` has no target"),
    "links of another kind": ({"kind": "point", "noise": {}}, "links: belongs to `kind: joined`"),
}  # fmt: skip


@pytest.mark.parametrize("name", SLIPS)
def test_what_cannot_be_meant_is_named(name: str, tmp_path: Path) -> None:
    keys, why = SLIPS[name]
    _, path = write(tmp_path, rows=16)
    document = yaml.safe_load(path.read_text())
    document["measurements"] |= keys
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(AridcalError, match=why):
        aridcal.calibrate(path)


def test_a_row_without_its_grasp_is_refused(tmp_path: Path) -> None:
    _, path = write(tmp_path, rows=40, diagnosis={"enabled": False})
    table = pd.read_csv(tmp_path / "joined.csv")
    table.loc[3, "grasp"] = ""
    table.to_csv(tmp_path / "joined.csv", index=False)
    (refused,) = read_job(path).rows.origin.refused
    assert "grasp" in str(refused)
    table.drop(columns=["grasp"]).to_csv(tmp_path / "joined.csv", index=False)
    with pytest.raises(AridcalError, match="grasp"):
        aridcal.calibrate(path)
