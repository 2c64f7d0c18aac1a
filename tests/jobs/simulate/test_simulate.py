"""Simulated campaigns: exact rows are those of another library, noise and effects are as large as stated."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import yaml
import yourdfpy
from lxml import etree
from repository import ROOT
from scipy import stats
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.robot.chain import load_robot
from aridcal.files.campaign import load_campaign
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, truth_document
from aridcal.simulate import main
from aridcal.system.errors import CampaignError

ARID = ROOT / "urdf" / "arid.urdf"

MIXED = """<robot name="mixed">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
  <joint name="turn" type="continuous">
    <parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="x" type="prismatic">
    <parent link="a"/><child link="b"/><axis xyz="1 0 0"/><limit lower="-0.1" upper="0.3" effort="1" velocity="1"/>
  </joint>
  <joint name="follower" type="prismatic">
    <parent link="b"/><child link="c"/><axis xyz="1 0 0"/><limit lower="-0.4" upper="0.1" effort="1" velocity="1"/>
    <mimic joint="x" multiplier="-2" offset="0.1"/>
  </joint>
  <joint name="wrist" type="revolute">
    <parent link="c"/><child link="d"/><axis xyz="0 1 0"/><limit lower="0.5" upper="0.75" effort="1" velocity="1"/>
  </joint>
</robot>"""

BOW = {"kind": "rail_straightness", "where": "joint_1", "form": "bow", "coefficients": [1e-3, 0]}

TRUTH = {
    "n": 40,
    "seed": 5,
    "parameters": {"joint_3.pitch": 0.01, "joint_4.x": {"std": 2e-3}, "joint_1.beta": {"std": 2e-3}},
    "frames": {
        "world_base": {"xyz": [1.0, -2.0, 0.5], "rpy": [0.3, -1.1, 2.4]},
        "tip_target": {"xyz": [0.1, 0.2, -0.3], "rpy": [-0.7, 0.4, 1.9]},
    },
}


def scenario(folder: Path, truth: dict | None = None, **keys) -> Scenario:
    """The ARID with some keys of the truth and of the campaign replaced."""
    text = {"format": 1, "robot": {"urdf": str(ARID), "tip": "flange"}, "truth": TRUTH | (truth or {})} | keys
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(text))
    return load_settings(path, Scenario)


def mixed(folder: Path, n: int = 5, **keys) -> Scenario:
    (folder / "mixed.urdf").write_text(MIXED)
    robot = {"urdf": "mixed.urdf", "tip": "d"}
    return scenario(folder, {"parameters": {}, "n": n}, robot=robot, **keys)


def read(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, dtype=str).astype(float)


def rotations(table: pd.DataFrame) -> Rotation:
    return Rotation.from_quat(table[["qx", "qy", "qz", "qw"]].to_numpy())


def test_exact_rows_are_what_another_library_predicts_for_the_true_robot(tmp_path):
    # The ARID's own origins do not turn, so that a correction of joint_3 is simply its new xyz and rpy.
    wanted = {"joint_3.y": 0.02, "joint_3.roll": 0.1, "joint_3.pitch": -0.2, "joint_3.yaw": 0.3, "flange_fixed.z": 0.04}
    root = etree.fromstring(ARID.read_bytes())
    root.find("joint[@name='joint_3']/origin").attrib.update({"xyz": "1.98 0.02 0", "rpy": "0.1 -0.2 0.3"})
    root.find("joint[@name='flange_fixed']/origin").attrib.update({"xyz": "0 0 0.04"})
    (tmp_path / "true.urdf").write_bytes(etree.tostring(root))
    other = yourdfpy.URDF.load(tmp_path / "true.urdf", load_meshes=False, build_scene_graph=True)

    table = simulate(scenario(tmp_path, {"parameters": wanted})).measurements
    frames = TRUTH["frames"]
    world, target = (
        pin.SE3(Rotation.from_euler("xyz", f["rpy"]).as_matrix(), np.array(f["xyz"])).homogeneous
        for f in (frames["world_base"], frames["tip_target"])
    )
    for row, turned in zip(table.itertuples(), rotations(table), strict=True):
        other.update_cfg([row.joint_1, row.joint_2, row.joint_3, row.joint_4])
        T = world @ other.get_transform("flange", "base_link") @ target
        np.testing.assert_allclose([row.x, row.y, row.z], T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(turned.as_matrix(), T[:3, :3], atol=1e-12)


def test_the_same_seed_gives_the_same_and_another_one_does_not(tmp_path):
    one, two, other = (simulate(scenario(tmp_path, {"seed": seed})) for seed in (1, 1, 2))
    pd.testing.assert_frame_equal(one.measurements, two.measurements)
    assert one.parameters == two.parameters
    assert one.parameters["joint_4.x"] != other.parameters["joint_4.x"]
    assert one.parameters["joint_3.pitch"] == other.parameters["joint_3.pitch"] == 0.01
    assert not np.allclose(one.measurements, other.measurements)


def test_more_rows_noise_or_outliers_leave_the_machine_as_it_is(tmp_path):
    noise = {"position": 1e-3, "rotation": 1e-3}
    plain = simulate(scenario(tmp_path))
    changed = simulate(scenario(tmp_path, {"n": 80, "noise": noise, "outliers": {"share": 0.5, "size": 10}}))
    assert plain.parameters == changed.parameters
    joints = ["joint_1", "joint_2", "joint_3", "joint_4"]
    pd.testing.assert_frame_equal(plain.measurements[joints], changed.measurements[joints][:40])


def test_constants_are_drawn_with_their_own_deviation(tmp_path):
    drawn = [simulate(scenario(tmp_path, {"seed": s, "n": 1})).parameters for s in range(40)]
    values = [d[name] for d in drawn for name in ("joint_4.x", "joint_1.beta")]
    assert stats.kstest(values, stats.norm(0, 2e-3).cdf).pvalue > 1e-3
    assert np.std(values) == pytest.approx(2e-3, rel=4 / np.sqrt(2 * len(values)))


def test_configurations_fill_the_limits_of_all_readings_evenly(tmp_path):
    renamed = {"columns": {"x": "slide"}}
    table = simulate(mixed(tmp_path, n=2000, measurements=renamed)).measurements
    for column, low, high in [("turn", -math.pi, math.pi), ("slide", -0.1, 0.3), ("wrist", 0.5, 0.75)]:
        assert stats.kstest(table[column], stats.uniform(low, high - low).cdf).pvalue > 1e-3
    assert list(table)[:3] == ["turn", "slide", "wrist"]


def test_noise_is_as_stated_on_each_world_axis(tmp_path):
    noise = {"position": 3e-3, "rotation": 2e-3}
    clean, noisy = (simulate(scenario(tmp_path, {"n": 2000} | extra)).measurements for extra in ({}, {"noise": noise}))
    moved = (noisy - clean)[["x", "y", "z"]].to_numpy()
    turned = (rotations(noisy) * rotations(clean).inv()).as_rotvec()
    for error, sigma in ((moved, 3e-3), (turned, 2e-3)):
        for axis in error.T:
            assert stats.kstest(axis, stats.norm(0, sigma).cdf).pvalue > 1e-3
        np.testing.assert_allclose(np.corrcoef(error.T), np.eye(3), atol=0.1)


def test_outliers_are_those_named_and_as_far_off_as_stated(tmp_path):
    noise = {"noise": {"position": 1e-4, "rotation": 2e-4}}
    outliers = {"outliers": {"share": 0.05, "size": 1000}}
    plain = simulate(scenario(tmp_path, noise | {"n": 200})).measurements
    hit = simulate(scenario(tmp_path, noise | outliers | {"n": 200}))
    off = np.linalg.norm((hit.measurements - plain)[["x", "y", "z"]], axis=1)
    turned = (rotations(hit.measurements) * rotations(plain).inv()).magnitude()
    assert hit.outliers.sum() == 10
    np.testing.assert_array_equal(off > 1e-9, hit.outliers)
    np.testing.assert_allclose(off[hit.outliers], 0.1, rtol=1e-9)
    np.testing.assert_allclose(turned[hit.outliers], 0.2, rtol=1e-2)  # turns do not quite add


def test_positions_alone_have_no_orientation_columns(tmp_path):
    both = simulate(scenario(tmp_path)).measurements
    position = simulate(scenario(tmp_path, measurements={"kind": "position"})).measurements
    pd.testing.assert_frame_equal(position, both.drop(columns=["qx", "qy", "qz", "qw"]))


def test_frames_that_the_truth_does_not_mention_are_as_the_campaign_says(tmp_path):
    known = {"tip_target": {"xyz": [0.0, 0.0, 0.25], "rpy": [0.0, 0.5, 0.0], "identify": False}}
    frames = simulate(scenario(tmp_path, {"frames": {}}, frames=known)).frames
    np.testing.assert_array_equal(frames["tip_target"].translation, [0.0, 0.0, 0.25])
    assert frames["world_base"] == pin.SE3.Identity()


# -- effects


def effects(*declared: dict, **truth) -> dict:
    """Truth with effects and without other faults."""
    return {"parameters": {}, "frames": {}, "n": 60, "effects": list(declared)} | truth


def moved(folder: Path, *declared: dict, **keys) -> tuple[np.ndarray, pd.DataFrame]:
    """How effects move the flange, in its place without them: (linear, angular) in world axes, shape (N, 6)."""
    with_it = simulate(scenario(folder, effects(*declared), **keys)).measurements
    without = simulate(scenario(folder, effects(), **keys)).measurements
    p = (with_it - without)[["x", "y", "z"]].to_numpy()
    return np.hstack([p, (rotations(with_it) * rotations(without).inv()).as_rotvec()]), with_it


def test_a_yielding_elbow_turns_by_its_gravity_torque_times_the_compliance(tmp_path):
    keys = {"robot": {"urdf": str(ARID), "tip": "flange", "gravity": [0.0, 9.81, 0.0]}}
    off, table = moved(tmp_path, {"kind": "joint_compliance", "where": "joint_3", "coefficients": 2e-6}, **keys)
    # Another road to the torque: MuJoCo is not needed, Pinocchio's generalized gravity is minus the load.
    model = pin.buildModelFromUrdf(str(ARID))
    model.gravity.linear = np.array([0.0, 9.81, 0.0])
    q = table[["joint_1", "joint_2", "joint_3", "joint_4"]].to_numpy()
    torque = np.array([-pin.computeGeneralizedGravity(model, model.createData(), row)[2] for row in q])
    np.testing.assert_allclose(off[:, 5], 2e-6 * torque, rtol=1e-6, atol=1e-12)
    assert np.ptp(torque) > 100


def test_a_rail_that_bows_shifts_the_arm_by_the_named_function(tmp_path):
    bow = {"kind": "rail_straightness", "where": "joint_1", "motion": "t2", "form": "bow", "coefficients": 2e-3}
    off, table = moved(tmp_path, bow)
    u = 2 * (table.joint_1 - table.joint_1.min()) / np.ptp(table.joint_1) - 1
    np.testing.assert_allclose(off[:, 1], 2e-3 * (1 - u**2), atol=1e-12)
    np.testing.assert_allclose(np.delete(off, 1, axis=1), 0, atol=1e-12)


def test_a_harmonic_has_the_amplitude_and_phase_given(tmp_path):
    wave = {"kind": "joint_harmonic", "where": "joint_2", "order": 3, "coefficients": [3e-4, -1e-4]}
    off, table = moved(tmp_path, wave)
    np.testing.assert_allclose(
        off[:, 5], 3e-4 * np.sin(3 * table.joint_2) - 1e-4 * np.cos(3 * table.joint_2), atol=1e-12
    )


def test_an_effect_in_no_catalogue_moves_two_ways_by_a_product(tmp_path):
    odd = {
        "kind": "unknown", "where": "world_base", "motion": ["x", "roll"], "covariates": ["joint_4", "temperature"],
        "form": "product", "coefficients": [1e-3, 2e-4],
    }  # fmt: skip
    off, table = moved(tmp_path, odd)
    u, v = (2 * (c - c.min()) / np.ptp(c) - 1 for c in (table.joint_4.to_numpy(), table.temperature.to_numpy()))
    np.testing.assert_allclose(off[:, 0], 1e-3 * u * v, atol=1e-12)
    np.testing.assert_allclose(off[:, 3], 2e-4 * u * v, atol=1e-9)


def test_payload_pulls_the_elbow_by_its_weight_times_its_lever(tmp_path):
    keys = {
        "robot": {"urdf": str(ARID), "tip": "flange", "gravity": [0.0, 9.81, 0.0]},
        "frames": {"tip_target": {"xyz": [0.4, 0.0, 0.0]}},
    }
    heavy = {
        "kind": "payload_compliance", "where": "joint_3", "covariates": "joint_3.payload_torque", "motion": "axis",
        "coefficients": 1e-5,
    }  # fmt: skip
    off, table = moved(tmp_path, heavy, **keys)
    a, b = table.joint_2 + table.joint_3, table.joint_2 + table.joint_3 + table.joint_4
    lever = 1.98 * np.cos(a) + 0.4 * np.cos(b)
    np.testing.assert_allclose(off[:, 5], 1e-5 * 9.81 * table.payload * lever, atol=1e-9)
    assert set(table.payload) == {0.0, 1.0, 2.5, 5.0}


@pytest.mark.parametrize("kind", sorted(kind for kind in EFFECT_KINDS if EFFECT_KINDS[kind].doc != "of-instruments"))
def test_every_kind_can_be_simulated_and_its_truth_is_told(tmp_path, kind):
    more = {
        "joint_coupling": {"with": "joint_2"},
        "joint_backlash": {"by": "direction"},
        "joint_harmonic": {"order": 2},
        "axis_wobble": {"order": 1, "motion": "r1"},
        "rail_straightness": {"motion": "t1"},
        "rail_angular": {"motion": "yaw"},
        "unknown": {"motion": "yaw", "covariates": "voltage"},
        "drift": {"where": "world_base"},
        "regional": {"by": "place"},
        "residual_field": {"where": "world_base"},
    }
    rail = {"where": "joint_1" if kind.startswith("rail") else "joint_3"}
    given = {"kind": kind, "coefficients": {"std": 1e-4}} | rail | more.get(kind, {})
    robot = {"urdf": str(ARID), "tip": "flange", "gravity": [0.0, 9.81, 0.0]}
    made = simulate(scenario(tmp_path, effects(given), robot=robot))
    plain = simulate(scenario(tmp_path, effects(), robot=robot))
    shift = (made.measurements[list(plain.measurements)] - plain.measurements).to_numpy()
    assert np.abs(shift).max() > 1e-6
    (told,) = truth_document(made)["effects"]
    assert told["kind"] == kind
    assert told["where"] == given["where"]
    assert all(c["name"].startswith(given["where"]) for c in told["coefficients"])
    assert all(abs(c["value"]) > 0 for c in told["coefficients"])


def test_a_calibration_that_declares_the_true_effect_gives_back_its_coefficient(tmp_path):
    heavy = {"kind": "joint_compliance", "where": "joint_3", "coefficients": 3e-6}
    robot = {"urdf": str(ARID), "tip": "flange", "gravity": [0.0, 9.81, 0.0]}
    truth = {"n": 120, "effects": [heavy], "noise": {"position": 1e-6, "rotation": 1e-6}}
    declared = {"effects": [{"kind": "joint_compliance", "where": "joint_3"}], "diagnosis": {"enabled": False}}
    given = scenario(tmp_path, truth, robot=robot, **declared)
    assert main([str(given.path), "-o", str(tmp_path / "out")]) == 0
    found = identify(tmp_path / "out" / "campaign.yaml").stages[-1].fit
    k = found.model.names.index("joint_3.axis:gravity_torque")
    assert found.theta[k] == pytest.approx(3e-6, abs=5 * found.covariance[k, k] ** 0.5)


def test_columns_are_what_a_day_of_measuring_gives(tmp_path):
    names = ["time", "temperature", "temperature_arm", "payload", "joint_2_direction", "humidity"]
    table = simulate(scenario(tmp_path, effects(covariates=names, n=400))).measurements
    assert list(table)[-6:] == names
    assert (np.diff(table.time) > 0).all()
    came = np.sign(np.diff(table.joint_2))
    np.testing.assert_array_equal(table.joint_2_direction[1:], came)
    for name in ("temperature", "humidity"):  # neighbours are alike
        assert np.corrcoef(table[name][1:], table[name][:-1])[0, 1] > 0.9
    assert not np.allclose(table.temperature, table.temperature_arm)


def test_a_further_column_or_effect_leaves_the_others_as_they_are(tmp_path):
    gain = {"kind": "joint_gain", "where": "joint_2", "coefficients": {"std": 1e-4}}
    warm = {"kind": "thermal", "where": "joint_3", "motion": "x", "coefficients": 1e-5}
    one = simulate(scenario(tmp_path, effects(gain)))
    two = simulate(scenario(tmp_path, effects(gain, warm, covariates=["humidity"])))
    assert one.causes[0].values == two.causes[0].values
    three = simulate(scenario(tmp_path, effects(warm)))
    np.testing.assert_array_equal(two.measurements.temperature, three.measurements.temperature)


# -- files


def test_the_campaign_is_the_scenario_without_its_truth(tmp_path):
    keys = {
        "measurements": {"kind": "pose", "noise": {"position": 1e-4}, "ignore": ["note"]},
        "parameters": {"set": "doty"},
        "frames": {"world_base": {"xyz": [1.0, 0.0, 0.0]}},
        "diagnosis": {"candidates": "all"},
    }
    given = scenario(tmp_path, **keys)
    assert main([str(given.path), "-o", str(tmp_path / "out")]) == 0
    campaign = load_campaign(tmp_path / "out" / "campaign.yaml")
    assert campaign.measurements.files == (tmp_path / "out" / "measurements.csv",)
    for key in ("parameters", "frames", "effects", "diagnosis"):
        assert getattr(campaign, key) == getattr(given, key)
    assert campaign.measurements.noise == given.measurements.noise
    assert campaign.measurements.ignore == given.measurements.ignore
    assert "truth:" not in campaign.text
    assert "candidates: all" in campaign.text


def test_measurements_come_back_from_the_file_to_the_last_digit(tmp_path):
    given = scenario(tmp_path, {"noise": {"position": 1e-4, "rotation": 1e-4}})
    assert main([str(given.path), "-o", str(tmp_path / "out")]) == 0
    table = read(tmp_path / "out" / "measurements.csv")
    pd.testing.assert_frame_equal(table, simulate(given).measurements, check_exact=True)


def test_truth_holds_what_was_drawn_and_counts_rows_as_lines_of_the_file(tmp_path):
    given = scenario(tmp_path, {"noise": {"position": 1e-4}, "outliers": {"share": 0.1, "size": 1e6}})
    assert main([str(given.path), "-o", str(tmp_path / "out")]) == 0
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    made = simulate(given)
    assert truth["parameters"] == made.parameters
    assert truth["noise"] == {"position": 1e-4, "rotation": 0.0}
    assert truth["frames"]["tip_target"]["rpy"] == pytest.approx([-0.7, 0.4, 1.9], abs=1e-12)
    lines = (tmp_path / "out" / "measurements.csv").read_text().splitlines()
    far = [n for n, line in enumerate(lines[1:], start=2) if abs(float(line.split(",")[4])) > 30]
    assert far
    assert set(far) <= set(truth["outliers"]["rows"])
    assert len(truth["outliers"]["rows"]) == 4


def test_the_robot_is_copied_beside_a_campaign_made_elsewhere(tmp_path):
    given = mixed(tmp_path, measurements={"columns": {"x": "slide"}})
    assert main([str(given.path), "-o", str(tmp_path / "deep" / "out")]) == 0
    campaign = load_campaign(tmp_path / "deep" / "out" / "campaign.yaml")
    assert campaign.robot.urdf.parent == tmp_path / "deep" / "out"
    assert campaign.robot.urdf.read_text() == MIXED


def test_the_scenarios_own_path_to_the_robot_is_kept_beside_it(tmp_path):
    (tmp_path / "job").mkdir()
    (tmp_path / "mixed.urdf").write_text(MIXED)
    robot = {"urdf": "../mixed.urdf", "tip": "d"}
    columns = {"columns": {"x": "slide"}}
    given = scenario(tmp_path / "job", {"parameters": {}}, robot=robot, measurements=columns)
    assert main([str(given.path), "-o", str(tmp_path / "job")]) == 0
    campaign = load_campaign(tmp_path / "job" / "campaign.yaml")
    assert "urdf: ../mixed.urdf" in campaign.text
    assert load_robot(campaign.robot.urdf, "d").readings == ("turn", "x", "wrist")
    assert given.path.read_text() == given.text
    assert not (tmp_path / "job" / "mixed.urdf").exists()


def test_a_scenario_is_not_overwritten_by_its_campaign(tmp_path, capsys):
    path = tmp_path / "campaign.yaml"
    text = scenario(tmp_path).text
    path.write_text(text)
    assert main([str(path), "-o", str(tmp_path)]) == 2
    assert "overwrite" in capsys.readouterr().err
    assert path.read_text() == text


@pytest.mark.parametrize("name", ["arid", "arid-undeclared"])
def test_the_shipped_campaign_is_what_its_scenario_makes(tmp_path, name):
    shipped = ROOT / "identification" / name
    assert main([str(shipped / "scenario.yaml"), "-o", str(tmp_path)]) == 0
    made, stored = (read(f / "measurements.csv") for f in (tmp_path, shipped))
    # Another processor rounds otherwise: 12 digits, not bytes.
    np.testing.assert_allclose(made, stored, rtol=0, atol=1e-12)
    for key in ("outliers", "effects"):
        assert (
            json.loads((tmp_path / "truth.json").read_text())[key]
            == json.loads((shipped / "truth.json").read_text())[key]
        )
    assert (tmp_path / "campaign.yaml").read_text().replace("arid.urdf", "../../urdf/arid.urdf") == (
        shipped / "campaign.yaml"
    ).read_text()


# -- bad input


@pytest.mark.parametrize(
    ("truth", "keys", "message"),
    [
        ({"parameters": {"joint_3.pich": 0.1}}, {}, r"joint_3\.pich.*did you mean 'joint_3\.pitch'"),
        ({"parameters": {"joint_4.theta": 0.1}}, {}, r"joint_4\.theta"),  # its link is singular
        ({"parameters": {"joint_2.d": 0.1}}, {}, r"joint_2\.d"),  # does not slide
        ({"parameters": {"joint_3.x": {"sdt": 0.1}}}, {}, r"sdt.*did you mean 'std'"),
        ({"parameters": {"joint_3.x": "big"}}, {}, r"joint_3\.x"),
        ({"n": 0}, {}, r"truth\.n"),
        ({"seed": -1}, {}, r"truth\.seed"),
        ({"effects": [{"kind": "drift"}]}, {}, r"effects\[0\]\.where: this key is missing"),
        (effects({"kind": "lens_distortion", "where": "camera", "coefficients": 1}), {}, r"lens_distortion"),
        (effects({"kind": "joint_gain", "where": "joint_9", "coefficients": 1}), {}, r"no place 'joint_9'"),
        (effects({"kind": "joint_gain", "where": "joint_2", "coefficients": [1, 2]}), {}, r"joint_2\.axis:joint_2"),
        (
            effects({"kind": "thermal", "where": "joint_2", "coefficients": 1}),
            {},
            r"has 7 coefficients, not 1: .*motion",
        ),
        (
            effects({"kind": "rail_straightness", "where": "joint_2", "coefficients": 1}),
            {},
            r"rail_straightness at joint_2",
        ),
        (effects(BOW | {"form": "bough"}), {}, r"'bough'.*did you mean 'bow'"),
        (effects(BOW | {"form": "product"}), {}, r"product is a function of 2 covariates"),
        (effects(BOW | {"kind": "joint_gain"}), {}, r"joint_gain has its own"),
        (effects(BOW | {"motion": "yaw"}), {}, r"has no motion 'yaw'"),
        (effects(BOW | {"where": "joint_5"}), {}, r"no covariate 'joint_5'.*did you mean"),
        (effects(BOW | {"covariates": "joint_7"}), {}, r"no covariate 'joint_7'"),
        (effects(BOW | {"kind": "unknown"}), {}, r"needs `motion` and `covariates`"),
        ({"outliers": {"share": 0.1, "size": 5}}, {}, r"truth\.noise"),
        ({"outliers": {"share": 1.1, "size": 5}}, {}, r"truth\.outliers\.share"),
        ({}, {"measurements": {"units": {"length": "mm"}}}, r"measurements\.units"),
        ({}, {"measurements": {"orientation": {"rotvec": ["a", "b", "c"]}}}, r"measurements\.orientation"),
        ({}, {"measurements": {"kind": "camera_sonar"}}, r"measurements\.head"),
        ({}, {"frames": {"world_base": {"per": "station"}}}, r"per: station"),
    ],
)
def test_what_cannot_be_simulated_is_named_with_the_file(tmp_path, truth, keys, message):
    with pytest.raises(CampaignError, match=message) as complaint:
        simulate(scenario(tmp_path, truth, **keys))
    assert "scenario.yaml" in str(complaint.value)


def test_a_joint_named_like_a_measured_quantity_needs_another_column(tmp_path):
    with pytest.raises(CampaignError, match=r"'x'.*measurements\.columns"):
        simulate(mixed(tmp_path))


def test_nothing_is_written_for_a_bad_scenario(tmp_path, capsys):
    (tmp_path / "scenario.yaml").write_text("format: 1\nrobot: {urdf: none.urdf, tip: flange}\ntruth: {n: 3}\n")
    assert main([str(tmp_path / "scenario.yaml"), "-o", str(tmp_path / "out")]) == 2
    assert "none.urdf" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
