"""The shipped campaigns of robots with several limbs: what their pages say of them is so."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from in_sight import MOST_WORDS, words_in_sight
from repository import ROOT
from searched import searched

import aridcal
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import urdf_of
from aridcal.engine.fit.problem import problem
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.robot.splice import origin_texts, splice_origins
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.files.read import load_measurements
from aridcal.jobs.calibrate.instrument_results import thing_values
from aridcal.jobs.calibrate.outcome import errors
from aridcal.pages.drawing.scene import limb_names, limb_of, scene
from aridcal.simulate import main as simulate
from notebooks import ran

TWO_ARMS = ROOT / "identification" / "two-arms"
HEAD = ROOT / "identification" / "humanoid-head"
COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")


def true_model(urdf: bytes, parameters: dict[str, float], base: str, tips: tuple[str, ...]) -> pin.Model:
    """The robot as it was built: each origin of the URDF moved by its own constants."""
    origins = {}
    for joint in (joint for tip in tips for joint in parse_robot(urdf, tip, base).joints):
        off = np.array([parameters.get(f"{joint.name}.{component}", 0.0) for component in COMPONENTS])
        origins[joint.name] = joint.origin * pin.SE3(pin.rpy.rpyToMatrix(off[3:]), off[:3])
    return pin.buildModelFromXML(splice_origins(urdf, origin_texts(urdf, origins)).decode())


def test_the_shipped_tables_of_two_arms_are_what_the_scenario_makes(tmp_path: Path) -> None:
    assert simulate([str(TWO_ARMS / "scenario.yaml"), "-o", str(tmp_path)]) == 0
    for number in (1, 2):
        made, stored = (pd.read_csv(folder / f"measurements_{number}.csv") for folder in (tmp_path, TWO_ARMS))
        assert list(made) == list(stored)
        numbers = stored.select_dtypes("number").columns
        np.testing.assert_allclose(made[numbers], stored[numbers], rtol=0, atol=1e-9)
    assert (tmp_path / "campaign.yaml").read_text().replace("two_arms.urdf", "../../urdf/two_arms.urdf") == (
        TWO_ARMS / "campaign.yaml"
    ).read_text()


@pytest.fixture(scope="module")
def two_arms(tmp_path_factory: pytest.TempPathFactory) -> aridcal.Calibration:
    """As the notebook on this campaign leaves it, which runs and says what it promises."""
    found = ran("7-two-arms", tmp_path_factory.mktemp("notebook"))["cal"]
    assert isinstance(found, aridcal.Calibration)
    return found


def test_the_shoulder_that_yields_is_found_and_how_much(two_arms: aridcal.Calibration) -> None:
    (effect,) = two_arms.result["effects"]
    assert (effect["kind"], effect["where"]) == ("joint_compliance", "left_joint_2")
    (coefficient,) = effect["coefficients"]
    (true,) = json.loads((TWO_ARMS / "truth.json").read_text())["effects"][0]["coefficients"]
    assert abs(coefficient["value"] - true["value"]) < 3.0 * coefficient["std"] < 0.15 * true["value"]
    assert two_arms.result["verdict"] == "noise_floor"
    assert 3.5 < two_arms.errors.loc["nominal"].loc["test"]["position_rms_mm"] < 3.6  # as the page has them
    assert 0.19 < two_arms.errors.loc["final"].loc["test"]["position_rms_mm"] < 0.21
    assert 0.05 < two_arms.errors.loc["final"].loc["test"]["distance_rms_mm"] < 0.053


def test_the_report_of_two_arms_is_read_in_ten_minutes(two_arms: aridcal.Calibration) -> None:
    assert len(words_in_sight(two_arms.report().html)) <= MOST_WORDS


def test_the_hands_are_where_pinocchio_has_them_in_postures_that_nobody_measured(two_arms: aridcal.Calibration) -> None:
    """The finger moves on the right hand as it truly does: distances of its places need none of the hands' own frames."""
    truth = json.loads((TWO_ARMS / "truth.json").read_text())
    urdf = (ROOT / "urdf" / "two_arms.urdf").read_bytes()
    nominal, real = pin.buildModelFromXML(urdf.decode()), true_model(
        urdf, truth["parameters"], "torso", ("left_hand", "right_hand")
    )  # fmt: skip
    names = list(real.names)[1:]
    inside = 0.05 + 0.9 * np.random.default_rng(8).uniform(size=(200, len(names)))
    q = real.lowerPositionLimit + inside * (real.upperPositionLimit - real.lowerPositionLimit)
    shoulder, data = names.index("left_joint_2"), nominal.createData()
    bent = q.copy()
    stiffness = truth["effects"][0]["coefficients"][0]["value"]
    bent[:, shoulder] -= stiffness * np.array(
        [pin.computeGeneralizedGravity(nominal, data, row)[shoulder] for row in q]
    )

    def finger(model: pin.Model, q: np.ndarray, place: list[float]) -> np.ndarray:
        data, found = model.createData(), []
        for row in q:
            pin.framesForwardKinematics(model, data, row)
            right, left = (data.oMf[model.getFrameId(f"{side}_hand")] for side in ("right", "left"))
            found.append(right.actInv(left.act(np.array(place))))
        return np.array(found)

    told = two_arms.predict(pd.DataFrame(q, columns=names), of="left_hand", within="right_hand")
    place = np.array(two_arms.result["frames"]["tip_target[finger]"]["xyz"])
    quaternions = told[["qx", "qy", "qz", "qw"]].to_numpy(float)
    R = np.array([pin.Quaternion(*np.roll(each, 1)).matrix() for each in quaternions])
    predicted = told[["x", "y", "z"]].to_numpy(float) + R @ place
    expected = finger(real, bent, truth["frames"]["finger"]["xyz"])
    untouched = finger(nominal, q, [0.06, 0, 0])
    apart, true, before = (np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (predicted, expected, untouched))
    after, nominal_off = (np.sqrt(np.mean((each - true) ** 2)) for each in (apart, before))
    assert after < 2.5e-4 < 1e-3 < nominal_off


def test_the_scene_has_targets_at_the_hand_and_tells_the_arms_apart(two_arms: aridcal.Calibration) -> None:
    """Rows are measured from the other hand: they are drawn where Pinocchio has the target seen from the torso."""
    assert two_arms.outcome is not None
    drawn = scene(two_arms.outcome)
    model, data = drawn.nominal.tree, drawn.nominal.tree.createData()
    R = drawn.T_world_base[:, :3, :3].transpose(0, 2, 1)
    in_base = np.einsum("nij,nj->ni", R, drawn.measured - drawn.T_world_base[:, :3, 3])
    rows = two_arms.outcome.measurements.as_read
    places = {"finger": np.array([0.06, 0, 0]), "socket": np.array([0, 0, -0.05])}
    for k, row in enumerate(rows.tolist()):
        pin.framesForwardKinematics(model, data, drawn.readings[k])
        torso, left = (data.oMf[model.getFrameId(name)] for name in ("torso", "left_hand"))
        expected = torso.actInv(left.act(places[str(two_arms.outcome.measurements.labels.target[row])]))
        assert np.linalg.norm(in_base[k] - expected) < 0.02  # the robot was built some millimetres otherwise
    assert limb_names(drawn.nominal) == ("left_hand", "right_hand")
    for joint in list(model.names)[1:]:
        assert limb_of(drawn.nominal, joint) == (0 if joint.startswith("left") else 1)


@pytest.fixture(scope="module")
def talos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The campaign of TALOS's head, as its README makes it."""
    folder = tmp_path_factory.mktemp("talos")
    assert runpy.run_path(str(HEAD / "make.py"))["make"](folder) == folder / "scenario.yaml"
    assert simulate([str(folder / "scenario.yaml"), "-o", str(folder)]) == 0
    return folder


def test_marks_of_several_limbs_in_one_image_take_their_own_paths(talos: Path) -> None:
    """Rows of one image stand one after the other with the same readings: asked for once, but once for each path."""
    table = pd.read_csv(talos / "measurements.csv")
    boards = table["marker"].str.partition("_")[0].groupby(table["shot"]).nunique()
    assert (boards > 1).any()
    campaign = load_campaign(talos / "campaign.yaml")
    robot = nominal_robot(campaign)
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds, robot=robot)
    states = {name: np.nan_to_num(things.start) for name, things in rows.instruments.things.items()}
    wall = rows.instruments.things["board"].names.index("board_on_world")
    states["board"][wall] = [0.7, 0.0, 0.9, *np.eye(3).ravel()]
    model = Model(robot, (Coefficient("head_1_joint", "pitch"),), tip_target=(("tip", pin.SE3.Identity()),),
                  instruments=rows.instruments, routes=rows.labels.routes, states=states)  # fmt: skip
    asked = problem(model, rows.with_labels(target=np.full(len(rows), "tip")))
    np.testing.assert_allclose(asked.linearised(np.zeros(1))[0], asked.residual(np.zeros(1)), atol=1e-9)


def test_the_head_sees_its_hands_where_pinocchio_has_them(talos: Path) -> None:
    """One hand seen from the other, which no row measured, in the postures of the campaign: as built, and as calibrated."""
    found = searched(talos / "campaign.yaml")
    assert found.verdict == "noise_floor" and found.effects == ()
    mask = found.rows.test & ~found.judged.outlier
    left = errors(found.judged.stages[-1].residual, mask, found.rows.channels)
    assert 0.3 < left["pixel_px"]["rms"] < 0.38  # as the page has it
    truth = json.loads((talos / "truth.json").read_text())
    nominal = nominal_robot(load_campaign(talos / "campaign.yaml"))
    limbs = {"torso_2_joint": -1, "arm_left_3_joint": 0, "head_1_joint": 1, "gripper_right_joint": 2}
    assert {joint: limb_of(nominal, joint) for joint in limbs} == limbs
    hands = ("gripper_left_base_link", "gripper_right_base_link")
    real = true_model(nominal.urdf, truth["parameters"], "base_link", (*hands, "rgbd_rgb_optical_frame"))
    q = (
        pd.read_csv(talos / "measurements.csv")
        .drop_duplicates("shot")[list(nominal.readings)]
        .sample(60, random_state=1)
    )

    def frame(place: dict) -> pin.SE3:
        return pin.SE3(pin.rpy.rpyToMatrix(np.array(place["rpy"])), np.array(place["xyz"]))

    boards: dict[str, dict[str, float]] = {}
    for number in thing_values(found.fit, found.rows.fitted):
        if number.role == "board":
            boards.setdefault(number.name, {})[number.component] = number.value

    def told(value: dict) -> pin.SE3:
        return frame({"xyz": [value[c] for c in COMPONENTS[:3]], "rpy": [value[c] for c in COMPONENTS[3:]]})

    def apart(model: pin.Model, tags: dict[str, pin.SE3]) -> np.ndarray:
        """How far the tags on one hand are from those on the other."""
        data, found = model.createData(), []
        for _, row in q.iterrows():
            at = pin.neutral(model)
            for name, value in row.items():
                at[model.joints[model.getJointId(name)].idx_q] = value
            pin.framesForwardKinematics(model, data, at)
            left, right = (data.oMf[model.getFrameId(hand)] * tags[f"board_on_{hand}"] for hand in hands)
            found.append(np.linalg.norm(left.translation - right.translation))
        return np.array(found)

    stated = {name: frame(place) for name, place in truth["instruments"]["board"].items()}
    true = apart(real, stated)
    geometric = found.arm.geometry.geometric
    calibrated = pin.buildModelFromXML(urdf_of(geometric.model, geometric.theta).decode())
    after = apart(calibrated, {name: told(board) for name, board in boards.items()}) - true
    before = apart(nominal.tree, stated) - true
    assert np.sqrt(np.mean(after**2)) < 5e-4 < 2e-3 < np.sqrt(np.mean(before**2))
