"""Simulated campaigns of every kind: what was written is what the machine, among its things, would have shown."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import yaml
from simulated_instruments import EYE, TRUTH, UR10, scenario

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.instruments.camera import INTRINSICS
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS, labelled
from aridcal.engine.inverse import reachable
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import load_campaign
from aridcal.files.read import load_measurements
from aridcal.identify import main as identify
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.pipeline import identify as outcome_of
from aridcal.jobs.simulate import camera_postures
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.simulate import main
from aridcal.system.errors import CampaignError

CASES: dict[str, tuple[object, dict]] = {
    "point": ({"kind": "point"}, {}),
    "distance": ({"kind": "distance"}, {}),
    "plane": ({"kind": "plane"}, {}),
    "inclination": ({"kind": "inclination"}, {}),
    "on the tip": ({"kind": "pixels"}, {"cameras": {"eye": EYE | {"xyz": [0.05, 0, 0.02], "rpy": [0.1, -0.1, 1.0]}}}),
    "beside": ({"kind": "pixels"}, {"cameras": {"eye": EYE | {"on": "world"}}}),
    "board": ({"kind": "pixels"}, {"cameras": {"eye": EYE}, "markers": {"file": "markers.csv"}}),
    "two cameras": ({"kind": "pixels"}, {"cameras": {"a": EYE, "b": EYE | {"xyz": [0.1, 0, 0]}}}),
    "mixed": (
        [
            {"kind": "point"},
            {"kind": "pose"},
            {"kind": "inclination", "name": "level"},
            {"kind": "pixels", "camera": "eye"},
        ],
        {"cameras": {"eye": EYE}},
    ),
}


def written(folder: Path, made: Scenario) -> tuple[Dataset, dict]:
    """What a reader of the campaign gets, and the truth as its file has it."""
    out = folder / "out"
    out.mkdir()
    write_campaign(simulate(made), out, out)
    campaign = load_campaign(out / "campaign.yaml")
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, None, campaign.limits.urdf)
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds)
    assert rows.origin.refused == ()
    return rows, json.loads((out / "truth.json").read_text())


def frame(place: dict) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(place["rpy"])), np.array(place["xyz"]))


def state(role: str, thing: dict, on_tip: bool) -> np.ndarray:
    """State of a thing, from the words of the truth's file."""
    if role == "plane":
        return np.array([*thing["normal"], thing["offset"]])
    if role == "anchor":
        return np.array([*thing["xyz"], thing["offset"], thing["scale"]])
    if role in ("point", "marker"):
        return np.array(thing["xyz"])
    place = [*thing["xyz"], *frame(thing).rotation.reshape(-1)]
    lens = [*(thing[name] for name in INTRINSICS[:4]), *thing["distortion"], float(on_tip)] if role == "camera" else []
    return np.array([*place, *lens])


def misfits(rows: Dataset, truth: dict, on_tip: bool = True) -> dict[str, np.ndarray]:
    """Residuals of each block at the truth, the target's poses being those of the true constants."""
    robot = load_robot(Path(UR10["urdf"]), UR10["tip"])
    names = [name.rsplit(".", 1) for name in truth["parameters"]]
    frames = {name: frame(place) for name, place in truth["frames"].items()}
    world = frames.pop("world_base")
    found = {}
    for number, block in enumerate(rows.blocks):
        own = rows.select(rows.labels.block == number)
        label = own.labels.target if own.labels.target is not None else np.full(len(own), next(iter(frames)))
        kind = MEASUREMENT_KINDS[block.kind]
        R, p = np.empty((len(own), 3, 3)), np.empty((len(own), 3))
        for name in np.unique(label):
            here = label == name
            tip = pin.SE3.Identity() if block.kind == "pixels" else frames[str(name)]
            model = Model(robot, tuple(Coefficient(*n) for n in names), ((None, world),), ((None, tip),))
            R[here], p[here] = model.poses(np.array([*truth["parameters"].values()]), model.rows(own.readings[here]))
        states = [
            np.array(
                [state(role.name, truth["instruments"][role.name][label], on_tip) for label in own.labels.refers[:, k]]
            )
            for k, role in enumerate(labelled(block.kind))
        ] or [np.zeros((len(own), role.size)) for role in kind.roles]
        found[block.name] = kind.residual(R, p, own.observed[:, : len(kind.read)], states)
    return found


@pytest.mark.parametrize("name", CASES)
def test_without_noise_the_truth_leaves_nothing(name: str, tmp_path: Path) -> None:
    measurements, instruments = CASES[name]
    rows, truth = written(tmp_path, scenario(tmp_path, measurements, instruments))
    for block, residual in misfits(rows, truth, on_tip=name != "beside").items():
        pixels = "pixels" in block
        assert len(residual) >= TRUTH["n"]
        np.testing.assert_allclose(residual, 0.0, atol=1e-9 if pixels else 1e-12, err_msg=block)


@pytest.mark.parametrize(
    ("name", "channel", "size"),
    [("point", "position", 1e-3), ("distance", "distance", 1e-3), ("plane", "distance", 1e-3),
     ("inclination", "inclination", 1e-3), ("on the tip", "pixel", 0.5)],
)  # fmt: skip
def test_noise_is_as_large_as_it_was_asked_for(name: str, channel: str, size: float, tmp_path: Path) -> None:
    measurements, instruments = CASES[name]
    made = scenario(tmp_path, measurements, instruments, n=400 if name != "on the tip" else 100, noise={channel: size})
    residual = next(iter(misfits(*written(tmp_path, made)).values()))
    rms = np.sqrt(np.mean(residual**2))
    assert abs(rms / size - 1.0) < 4.0 / np.sqrt(2 * residual.size)


def test_a_socket_is_met_in_many_postures(tmp_path: Path) -> None:
    made = simulate(scenario(tmp_path, {"kind": "point"}, {}, n=60))
    table = made.measurements
    assert set(table["point"]) == {"point_1", "point_2", "point_3", "point_4"}
    joints = table[list(made.robot.readings)]
    assert (joints.groupby(table["point"]).std().to_numpy() > 0.3).all()


def test_a_known_length_is_that_of_two_points(tmp_path: Path) -> None:
    lengths = [{"between": ["a", "b"], "length": 0.05}, {"between": ["c", "d"], "length": 0.3, "std": 1e-6}]
    made = simulate(scenario(tmp_path, {"kind": "point"}, {"lengths": lengths}))
    at = dict(zip(made.real["point"].names, made.real["point"].states, strict=True))
    assert set(at) == {"a", "b", "c", "d"}
    assert abs(np.linalg.norm(at["a"] - at["b"]) - 0.05) < 5e-5
    assert abs(np.linalg.norm(at["c"] - at["d"]) - 0.3) < 5e-6


def test_known_points_are_where_their_table_has_them_but_for_its_sigma(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("point,x,y,z,std\na,0.6,0.2,0.4,\nb,0.5,-0.3,0.5,1e-3\n")
    made = simulate(scenario(tmp_path, {"kind": "point"}, {"points": "points.csv"}))
    real = made.real["point"]
    np.testing.assert_array_equal(real.states[0], [0.6, 0.2, 0.4])
    assert 0 < np.abs(real.states[1] - [0.5, -0.3, 0.5]).max() < 5e-3


def test_perpendicular_planes_are(tmp_path: Path) -> None:
    pairs = [["floor", "wall"], ["floor", "side"], ["wall", "side"]]
    made = simulate(scenario(tmp_path, {"kind": "plane"}, {"perpendicular": pairs}))
    normals = made.real["plane"].states[:, :3]
    np.testing.assert_allclose(normals @ normals.T, np.eye(3), atol=1e-12)


def test_a_gauge_reads_heights_on_both_sides(tmp_path: Path) -> None:
    rows, truth = written(tmp_path, scenario(tmp_path, {"kind": "plane"}, {}, instruments={"gauge": 0.01}))
    assert -0.01 < rows.observed.min() < -0.002 < 0.002 < rows.observed.max() < 0.01
    np.testing.assert_allclose(misfits(rows, truth)["plane"], 0.0, atol=1e-12)


def test_targets_are_measured_in_turn(tmp_path: Path) -> None:
    tips = {"low": {"xyz": [0, 0, 0.1]}, "high": {"xyz": [0.1, 0, 0.2]}}
    frames = TRUTH["frames"] | {"targets": tips}
    rows, truth = written(tmp_path, scenario(tmp_path, {"kind": "point"}, {}, frames=frames))
    assert rows.labels.target is not None
    pairs = set(zip(rows.labels.target.tolist(), rows.labels.refers[:, 0].tolist(), strict=True))
    assert len(pairs) == 2 * 4
    np.testing.assert_allclose(misfits(rows, truth)["point"], 0.0, atol=1e-12)


def test_effects_bend_the_arm_and_the_target_still_meets_its_socket(tmp_path: Path) -> None:
    effects = [
        {"kind": "joint_compliance", "where": "shoulder_lift_joint", "coefficients": 2e-5},
        {"kind": "unknown", "where": "elbow_joint", "motion": "x", "covariates": "wrist_1_joint", "form": "bow",
         "coefficients": 2e-3},
        {"kind": "drift", "where": "world_base", "motion": "y", "coefficients": 1e-6},
    ]  # fmt: skip
    clean = simulate(scenario(tmp_path, {"kind": "point"}, {}))
    made = simulate(scenario(tmp_path, {"kind": "point"}, {}, effects=effects))
    robot, table = made.robot, made.measurements
    bow = table["wrist_1_joint"].to_numpy()
    u = (2 * bow - bow.min() - bow.max()) / np.ptp(bow)
    constants = [Coefficient(*name.rsplit(".", 1)) for name in made.parameters]
    causes = [c for cause in (made.causes[0], made.causes[2]) for c in cause.effect.coefficients]
    bent = [c for c in made.causes[1].effect.coefficients]
    tip = made.frames["tip_target"]
    from aridcal.jobs.simulate.simulation import surroundings

    around = surroundings(made.scenario, made.frames, ())
    model = Model(robot, (*constants, *causes, *bent), ((None, made.frames["world_base"]),), ((None, tip),), around)
    theta = np.array(
        [*made.parameters.values(), *made.causes[0].values, *made.causes[2].values, *made.causes[1].values]
    )
    columns = {"time": table["time"].to_numpy(), bent[0].basis.of[0]: 1.0 - u**2}
    _, p = model.poses(theta, model.rows(table[list(robot.readings)].to_numpy(), columns))
    point = np.array(
        [dict(zip(made.real["point"].names, made.real["point"].states, strict=True))[n] for n in table["point"]]
    )
    np.testing.assert_allclose(p, point, atol=1e-11)
    moved = table[list(robot.readings)].to_numpy() - clean.measurements[list(robot.readings)].to_numpy()
    assert 1e-4 < np.abs(moved).max() < 0.1


def test_rows_of_one_image_share_their_posture_and_their_time(tmp_path: Path) -> None:
    made = simulate(scenario(tmp_path, {"kind": "pixels"}, {"cameras": {"eye": EYE}}, covariates=["time"]))
    table = made.measurements
    alike = table.groupby("shot")[[*made.robot.readings, "time"]].nunique()
    assert len(alike) == TRUTH["n"]
    assert (alike == 1).all(axis=None)
    assert table["time"].is_monotonic_increasing
    assert (table.groupby("shot").size() >= 4).all()


def test_a_printed_board_is_seen_from_its_front(tmp_path: Path) -> None:
    made = simulate(scenario(tmp_path, *CASES["board"]))
    board, camera = (made.real[role].states[0] for role in ("board", "camera"))
    normal = board[3:12].reshape(3, 3)[:, 2]
    table = made.measurements.drop_duplicates("shot")
    names = [name.rsplit(".", 1) for name in made.parameters]
    model = Model(made.robot, tuple(Coefficient(*n) for n in names), ((None, made.frames["world_base"]),))
    R, p = model.poses(np.array([*made.parameters.values()]), model.rows(table[list(made.robot.readings)].to_numpy()))
    eye = p + R @ camera[:3]
    assert ((eye - board[:3]) @ normal > 0).all()


def test_outliers_are_named_by_block_and_stand_out(tmp_path: Path) -> None:
    both = [{"kind": "distance"}, {"kind": "point"}]
    made = scenario(
        tmp_path, both, {}, noise={"distance": 1e-4, "position": 1e-4}, outliers={"share": 0.125, "size": 100}
    )
    rows, truth = written(tmp_path, made)
    residuals = misfits(rows, truth)
    for number, lines in enumerate(truth["outliers"]["rows"]):
        own = rows.select(rows.labels.block == number)
        far = np.linalg.norm(residuals[own.blocks[number].name], axis=1) > 50e-4
        assert sorted(own.origin.line[far].tolist()) == lines
        assert len(lines) == 3


def test_the_seed_fixes_everything_and_noise_leaves_the_things(tmp_path: Path) -> None:
    one, again = (simulate(scenario(tmp_path, {"kind": "distance"}, {})) for _ in range(2))
    pd.testing.assert_frame_equal(one.measurements, again.measurements)
    noisy = simulate(scenario(tmp_path, {"kind": "distance"}, {}, noise={"distance": 1e-3}))
    np.testing.assert_array_equal(one.real["anchor"].states, noisy.real["anchor"].states)
    same = [*one.robot.readings, "anchor"]
    pd.testing.assert_frame_equal(one.measurements[same], noisy.measurements[same])


def test_the_command_writes_a_campaign_that_holds_no_truth(tmp_path: Path) -> None:
    made = scenario(tmp_path, CASES["mixed"][0], {"cameras": {"eye": EYE}, "markers": {"file": "markers.csv"}})
    assert main([str(made.path), "-o", str(tmp_path / "made")]) == 0
    files = {path.name for path in (tmp_path / "made").iterdir()}
    assert files == {
        "campaign.yaml",
        "truth.json",
        "ur10.urdf",
        "markers.csv",
        *(f"measurements_{k}.csv" for k in range(1, 5)),
    }
    keys = yaml.safe_load((tmp_path / "made" / "campaign.yaml").read_text())
    assert "truth" not in keys
    assert keys["instruments"]["cameras"]["eye"].keys() == EYE.keys()
    load_campaign(tmp_path / "made" / "campaign.yaml")


@pytest.mark.parametrize(
    ("measurements", "instruments", "truth", "says"),
    [
        ({"kind": "point"}, {}, {"instruments": {"points": {"far": [9, 9, 9]}}}, "the arm does not reach"),
        ({"kind": "pose"}, {}, {"instruments": {"points": 3}}, "truth.instruments: no row refers"),
        ({"kind": "pixels"}, {"cameras": {"eye": EYE}}, {"instruments": {"cameras": {"ear": {}}}}, "name the same"),
        ({"kind": "distance"}, {"anchors": {"rail": {}}},
         {"effects": [{"kind": "distance_scale", "where": "rial", "coefficients": 1e-3}]}, "no place 'rial'.*rail"),
        ({"kind": "distance"}, {"anchors": {"rail": {}}},
         {"effects": [{"kind": "lens_distortion", "where": "rail", "coefficients": 1e-3}]}, "or a camera under"),
        ([{"kind": "point"}, {"kind": "distance", "units": {"length": "mm"}}], {}, {}, "the table is written in SI"),
        ({"kind": "pixels"}, {"cameras": {"eye": EYE}, "markers": {"file": "markers.csv"}},
         {"instruments": {"board": {"xyz": [50, 0, 0]}}}, "hardly any posture"),
    ],
)  # fmt: skip
def test_what_cannot_be_simulated_is_refused(
    measurements: object, instruments: dict, truth: dict, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reachable, "MOST_ROUNDS", 2)  # what is metres away is looked for no more often than that
    monkeypatch.setattr(camera_postures, "DRAWS", 2)
    with pytest.raises(CampaignError, match=says):
        simulate(scenario(tmp_path, measurements, instruments, **truth))


def test_a_second_days_table_of_one_instrument_of_two_is_scored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The wire's table alone, from the command line, the sockets' alone; each beside its own rows of this day."""
    blocks = [{"kind": "distance"}, {"kind": "point"}]
    noise = {"noise": {"distance": 5e-5, "position": 1e-4}, "n": 90}
    made = scenario(tmp_path, blocks, {}, **noise)
    made.path.write_text(made.path.read_text() + "diagnosis: {enabled: false}\n")
    assert main([str(made.path), "-o", str(tmp_path / "made")]) == 0
    path, out = tmp_path / "made" / "campaign.yaml", tmp_path / "out"
    days = {channel: path.parent / f"measurements_{k}.csv" for k, channel in ((1, "distance_mm"), (2, "position_mm"))}
    arguments = [str(path), "--out", str(out), "--verify", str(days["distance_mm"])]
    assert identify(arguments) == 0, capsys.readouterr().err
    assert days["distance_mm"].name in (out / "report.html").read_text("utf-8")
    told = {
        "distance_mm": json.loads((out / "result.json").read_text()),
        "position_mm": result_document(outcome_of(path, verify=days["position_mm"])),
    }
    for key, absent, limit in (("distance_mm", "position_mm", 0.08), ("position_mm", "distance_mm", 0.25)):
        found = told[key]["verification"]
        assert found["rows"] == 90 and 0.0 < found["error"]["final"][key]["rms"] < limit
        assert set(found["error"]["final"][absent].values()) == {None}
