"""The shipped campaigns of robots with several limbs: what their pages say of them is so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

import aridcal
from aridcal.robot.chain import parse_robot
from aridcal.robot.splice import splice_origins, written_origins
from aridcal.simulate import main as simulate

ROOT = Path(__file__).parent.parent
TWO_ARMS = ROOT / "identification" / "two-arms"
COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")


def true_model(urdf: bytes, parameters: dict[str, float], base: str, tips: tuple[str, ...]) -> pin.Model:
    """The robot as it was built: each origin of the URDF moved by its own constants."""
    origins = {}
    for joint in (joint for tip in tips for joint in parse_robot(urdf, tip, base).joints):
        off = np.array([parameters.get(f"{joint.name}.{component}", 0.0) for component in COMPONENTS])
        origins[joint.name] = joint.origin * pin.SE3(pin.rpy.rpyToMatrix(off[3:]), off[:3])
    return pin.buildModelFromXML(splice_origins(urdf, written_origins(urdf, origins)).decode())


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
def two_arms() -> aridcal.Calibration:
    return aridcal.calibrate(TWO_ARMS / "campaign.yaml")


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
