"""Poses of any link in any other: of the calibrated robot, whichever path leads there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
from misread import machine
from robots import varying

import aridcal
import aridcal.predict
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.fit.constants import constants, urdf_of
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Route, check_route, parse_robot, with_limbs
from aridcal.system.errors import RobotError

URDF = robots.random_chain(np.random.default_rng(6), "RPRC")
"""Links base, link_1 to link_4 and tip in a row, with a bracket and a plate after link_1, which carries a branch, too."""

ENDS = ((None, None), (None, "link_3"), ("tip", "plate"), ("link_2", "tip"), ("branch", "tip"), ("plate", "branch"))
ROUTES = tuple(Route(*ends) for ends in ENDS)


def placed(robot_urdf: bytes, route: Route, readings: dict[str, float]) -> pin.SE3:
    """From one link to another by Pinocchio's reading of a URDF."""
    model = pin.buildModelFromXML(robot_urdf.decode())
    data, q = model.createData(), pin.neutral(model)
    for name, value in readings.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(value), np.sin(value)] if joint.nq == 2 else value
    pin.framesForwardKinematics(model, data, q)
    start, end = (data.oMf[model.getFrameId(link)] for link in (route.start or "base", route.end or "tip"))
    return start.actInv(end)


def whole(coefficients: str, seed: int = 1) -> tuple[Model, np.ndarray]:
    """A model of rows that take all these paths, and corrections."""
    robot = with_limbs(parse_robot(URDF, "tip", "base"), [link for ends in ENDS for link in ends if link is not None])
    chosen = constants(robot, "full") if coefficients == "constants" else varying(robot)
    chosen = tuple(c for c in chosen if c.where not in ("world_base", "tip_target"))
    model = Model(robot, chosen, around=Surroundings(np.array([1.0, 5.0, -8.0])), routes=ROUTES)
    return model, np.random.default_rng(seed).normal(0, 0.02, len(chosen))


@pytest.mark.parametrize("count", [1, 20])  # one by one, and walked together
def test_paths_side_by_side_are_where_the_urdf_with_the_constants_has_them(count: int) -> None:
    """Fixed joints in the middle of a path are corrected, too: the tip's own, seen from the tip."""
    model, theta = whole("constants")
    assert model.robot.readings == ("joint_1", "joint_2", "joint_3", "joint_4", "branch_joint")
    q = robots.readings(model.robot, count * len(ROUTES), np.random.default_rng(0))
    route = np.tile(np.arange(len(ROUTES)), count)
    R, p = model.poses(theta, model.rows(q, route=route))
    text = urdf_of(model, theta)
    for k in range(len(q)):
        expected = placed(text, ROUTES[route[k]], dict(zip(model.robot.readings, q[k].tolist(), strict=True)))
        np.testing.assert_allclose(p[k], expected.translation, atol=1e-12)
        np.testing.assert_allclose(R[k], expected.rotation, atol=1e-12)


@pytest.mark.parametrize("which", ["constants", "effects"])
def test_columns_of_all_paths_are_their_differences(which: str) -> None:
    model, theta = whole(which)
    q = robots.readings(model.robot, 2 * len(ROUTES), np.random.default_rng(3))
    rows = model.rows(q, {"time": np.zeros(len(q))}, route=np.tile(np.arange(len(ROUTES)), 2))
    theta = theta / np.maximum(1.0, 0 * theta + 100.0 * np.array(["gravity" in c.name for c in model.coefficients]))
    R, _, J = model.jacobian(theta, rows)
    for k, c in enumerate(model.coefficients):
        h = 1e-4 / max(1.0, np.abs(J[:, :, k]).max())
        ahead, behind = (model.poses(theta + s * h * np.eye(len(theta))[k], rows) for s in (1, -1))
        turn = (ahead[0] - behind[0]) @ R.transpose(0, 2, 1) / (2 * h)
        found = np.hstack([(ahead[1] - behind[1]) / (2 * h), turn[:, [2, 0, 1], [1, 2, 0]]])
        size = max(np.abs(J[:, :, k]).max(), 1.0)
        np.testing.assert_allclose(J[:, :, k], found, rtol=0, atol=1e-6 * size, err_msg=c.name)


def test_the_columns_of_readings_of_all_paths_are_their_differences() -> None:
    model, theta = whole("constants")
    q = robots.readings(model.robot, len(ROUTES), np.random.default_rng(3), 0.9)
    route, h = np.arange(len(ROUTES)), 1e-6
    J = model.by_readings(theta, model.rows(q, route=route))[2]
    for k in range(q.shape[1]):
        step = h * np.eye(q.shape[1])[k]
        ahead, behind = (model.poses(theta, model.rows(q + s * step, route=route))[1] for s in (1, -1))
        np.testing.assert_allclose(J[:, :3, k], (ahead - behind) / (2 * h), rtol=0, atol=1e-7)


def test_a_path_on_which_nothing_moves_is_refused() -> None:
    with pytest.raises(RobotError, match="no joint moves between 'plate' and 'link_1'"):
        check_route(parse_robot(URDF, "tip", "base"), Route("plate", "link_1"))


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[aridcal.Calibration, robots.Truth]:
    folder, truth = tmp_path_factory.mktemp("links"), machine(robots.ur10(), 0.4, n=60)
    measurements = {"file": "measurements.csv", "kind": "pose"}
    path = robots.write_campaign(folder, truth, robots.table(truth), measurements=measurements)
    found = aridcal.calibrate(path)
    (folder / "calibration.yaml").write_text(found.model.dump(), encoding="utf-8")
    return aridcal.load(folder / "calibration.yaml"), truth


@pytest.mark.parametrize(
    ("of", "within"), [("wrist_1_link", "base_link"), ("upper_arm_link", "tool0"), ("tool0", "forearm_link")]
)
def test_links_of_a_calibration_are_those_of_its_urdf(
    of: str, within: str, calibrated: tuple[aridcal.Calibration, robots.Truth]
) -> None:
    found, truth = calibrated
    robot, geometric = truth.model.robot, found.model.geometric
    asked = replace(found, model=replace(found.model, final=geometric, rivals=()))  # what the URDF holds
    query = robots.table(truth)[list(robot.readings)]
    told = asked.predict(query, of=of, within=within)
    text = urdf_of(geometric.model, geometric.theta)
    for k, row in enumerate(query.to_numpy()):
        expected = placed(text, Route(within, of), dict(zip(robot.readings, row.tolist(), strict=True)))
        np.testing.assert_allclose(told.loc[k, ["x", "y", "z"]].to_numpy(float), expected.translation, atol=1e-9)
        quaternion = pin.Quaternion(expected.rotation).coeffs()
        np.testing.assert_allclose(
            abs(told.loc[k, ["qx", "qy", "qz", "qw"]].to_numpy(float) @ quaternion), 1.0, atol=1e-12
        )
    assert np.isfinite(told[["std_x", "std_rz"]].to_numpy()).all() and not told["extrapolates"].all()


def test_the_tips_place_in_the_world_is_the_targets_less_its_offset(
    calibrated: tuple[aridcal.Calibration, robots.Truth],
) -> None:
    found, truth = calibrated
    query = robots.table(truth)[list(truth.model.robot.readings)]
    tip, target = found.predict(query, of="tool0"), found.predict(query)
    offset = found.model.final.model.frames(found.model.final.theta)[1][0][1]
    R = pin.Quaternion(*tip.loc[0, ["qw", "qx", "qy", "qz"]].to_numpy(float)).matrix()
    there = tip.loc[0, ["x", "y", "z"]].to_numpy(float) + R @ offset.translation
    np.testing.assert_allclose(there, target.loc[0, ["x", "y", "z"]].to_numpy(float), atol=1e-9)


def test_a_link_beyond_joints_that_were_not_calibrated_is_nominal_from_there_and_says_so(tmp_path: Path) -> None:
    """A branch off the calibrated chain: its joint needs a column, and no row is like those that were seen."""
    truth = machine(parse_robot(robots.random_chain(np.random.default_rng(5), "RRRRRR"), "tip", "base"), 0.4, n=60)
    path = robots.write_campaign(
        tmp_path, truth, robots.table(truth), measurements={"file": "measurements.csv", "kind": "pose"}
    )
    found = aridcal.calibrate(path)
    geometric = found.model.geometric
    asked = replace(found, model=replace(found.model, final=geometric, rivals=()))
    query = robots.table(truth)[list(truth.model.robot.readings)][:6]
    with pytest.raises(aridcal.AridcalError, match="branch_joint"):
        asked.predict(query, of="branch", within="tip")
    query["branch_joint"] = np.linspace(-1.0, 1.0, len(query))
    told = asked.predict(query, of="branch", within="tip")
    assert told["extrapolates"].all()
    text = urdf_of(geometric.model, geometric.theta)
    for k, row in enumerate(query.to_dict("records")):
        expected = placed(text, Route("tip", "branch"), row)
        np.testing.assert_allclose(told.loc[k, ["x", "y", "z"]].to_numpy(float), expected.translation, atol=1e-9)


def test_the_command_names_what_is_wrong(
    calibrated: tuple[aridcal.Calibration, robots.Truth], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, truth = calibrated
    (tmp_path / "calibration.yaml").write_text(found.model.dump(), encoding="utf-8")
    robots.table(truth).to_csv(tmp_path / "q.csv", index=False)
    with pytest.raises(aridcal.AridcalError, match="name the link whose pose is wanted: of=LINK"):
        found.predict(robots.table(truth), within="tool0")
    words = [str(tmp_path / "calibration.yaml"), str(tmp_path / "q.csv"), "-o", str(tmp_path / "out.csv")]
    for more, why in (
        (["--in", "tool0"], "--in says in which link's frame"),
        (["--of", "wrist_9_link"], "no link 'wrist_9_link' (did you mean 'wrist_3_link'?)"),
        (["--of", "base_link"], "the base 'base_link' does not move in the world"),
        (["--of", "tool0", "--in", "wrist_3_link"], "no joint moves between 'wrist_3_link' and 'tool0'"),
    ):
        assert aridcal.predict.main([*words, *more]) == 2
        assert why in " ".join(capsys.readouterr().err.split())
        assert not (tmp_path / "out.csv").exists()
    assert aridcal.predict.main([*words, "--of", "forearm_link", "--in", "tool0"]) == 0
