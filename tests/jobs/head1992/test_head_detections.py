"""From images to the result folder: the cache of fiducials, shots that cannot be used, and the shipped campaign."""

import json
import shutil
from contextlib import chdir
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
from heads import ARID, ROOT, START, STRIP, poses
from scipy.spatial.transform import Rotation

from aridcal.__main__ import main as aridcal
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.model.model import Model
from aridcal.files.campaign import load_campaign
from aridcal.identify import main
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.head1992.charuco import Board
from aridcal.jobs.head1992.detections import read_shots
from aridcal.jobs.head1992.observations import CampaignRows
from aridcal.jobs.head1992.render import Optics
from aridcal.jobs.simulate.simulation import named_constants
from aridcal.jobs.simulate.viewpoints import draw_views
from aridcal.system.progress import Progress
from notebooks import FOLDER, ran

EVERY = 6  # of the shipped shots
CAMERA = np.array([[700, 0, 255.5], [0, 700, 255.5], [0, 0, 1]])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small campaign that a test may spoil: every sixth of the shipped shots."""
    return some_of_the_shots(tmp_path, EVERY)


@pytest.fixture
def three(tmp_path: Path) -> Path:
    """Three of the shipped shots, where they are only read."""
    return some_of_the_shots(tmp_path, 30)


def some_of_the_shots(tmp_path: Path, every: int) -> Path:
    for name in ("head.yaml", "squares.csv"):
        shutil.copy(STRIP / name, tmp_path)
    urdf = ROOT / "urdf" / "arid.urdf"
    text = (STRIP / "campaign.yaml").read_text().replace("../../urdf/arid.urdf", str(urdf))
    (tmp_path / "campaign.yaml").write_text(text + "diagnosis: {candidates: [sonar_bias, lens_distortion]}\n")
    table = pd.read_csv(STRIP / "shots.csv").iloc[::every]
    table.to_csv(tmp_path / "shots.csv", index=False)
    (tmp_path / "images").mkdir()
    for image in table["image"]:
        shutil.copy(STRIP / image, tmp_path / image)
    return tmp_path


def run(folder: Path) -> dict:
    assert main([str(folder / "campaign.yaml")]) == 0
    return json.loads((folder / "results" / "result.json").read_text())


def read(folder: Path, cache: Path | None = None) -> tuple[CampaignRows, str]:
    """The shots, and what was said while they were read."""
    said: list[str] = []
    shots = read_shots(load_campaign(folder / "campaign.yaml"), ARID, cache, 0, Progress(said.append))
    return shots, " ".join(said)


def cached(folder: Path) -> Path:
    """What a run would leave behind."""
    path = folder / "fiducials.csv"
    read(folder)[0].detections.fiducials.to_csv(path, index=False)
    return path


def test_fiducials_are_looked_for_again_with_the_lens_that_was_found(folder, capsys):
    """Second road: the same images read with a head.yaml that is right."""
    campaign = folder / "campaign.yaml"
    effects = "[{kind: lens_distortion, where: camera, motion: k1}, {kind: sonar_bias, where: sonar_2}]"
    campaign.write_text(
        campaign.read_text().partition("diagnosis:")[0] + f"effects: {effects}\ndiagnosis: {{enabled: false}}\n"
    )
    right = read(folder)[0].detections.fiducials
    head = folder / "head.yaml"
    head.write_text(head.read_text().replace("\ncamera: {", "\ncamera: {distortion: [0.15, 0, 0, 0, 0], "))
    wrong = read(folder)[0].detections.fiducials
    first = run(folder)
    assert "with the lens that was found" in capsys.readouterr().err
    found = pd.read_csv(folder / "results" / "fiducials.csv")
    keys, at = ["shot", "square", "fiducial"], ["u", "v"]
    both, before = (right.merge(other, on=keys, suffixes=("", "_found")) for other in (found, wrong))
    assert len(both) == len(right) == len(found) > len(before)
    assert np.abs(both[at].to_numpy() - both[["u_found", "v_found"]].to_numpy()).max() < 0.01
    shutil.rmtree(folder / "images")
    second = run(folder)
    assert "that was found" not in capsys.readouterr().err
    for part in ("train", "test"):  # poses of single shots are begun elsewhere: the last digits differ
        rms, again = (said["error"]["final"][part]["position_mm"]["rms"] for said in (first, second))
        assert again == pytest.approx(rms, rel=1e-6)


def test_an_image_that_changed_is_read_anew(three):
    cache = cached(three)
    before = pd.read_csv(cache)
    image = sorted((three / "images").iterdir())[0]
    image.write_bytes(image.read_bytes() + b"\0")  # the same picture, other bytes
    again, said = read(three, cache)
    assert "reading 1 images" in said
    assert before["shot"][again.detections.fiducials["digest"] != before["digest"]].nunique() == 1
    pd.testing.assert_frame_equal(again.detections.fiducials.drop(columns="digest"), before.drop(columns="digest"))


@pytest.mark.parametrize(
    "text", ["", "shot,square\n1,2\n", "shot,square,fiducial,u,v,std_u,std_v,digest\n2,0,1,a,,,,x\n"]
)
def test_a_spoilt_cache_is_no_cache(three, text):
    (three / "spoilt.csv").write_text(text)
    assert "reading 3 images" in read(three, three / "spoilt.csv")[1]


def test_shots_that_cannot_be_used_are_named_and_the_others_are_used(folder):
    faults = [
        ({"image": "images/none.jpg"}, "no such image"),
        ({"image": "../outside.jpg"}, "outside the folder"),
        ({"image": "shots.csv"}, "no image of a known kind"),
        ({"h2": ""}, "h2: the range is missing"),
        ({"h2": "-0.3"}, "h2: a range of -0.3"),
        ({"h3": "312"}, "h3: a range of 312"),
        ({"square": "84"}, "no square 84"),
        ({"square": "x"}, "should be the index"),
        ({"joint_2": ""}, "empty"),
    ]
    table = pd.read_csv(folder / "shots.csv", dtype=str)
    for row, (cells, _) in enumerate(faults):
        for name, value in cells.items():
            table.loc[row, name] = value
    table.to_csv(folder / "shots.csv", index=False)
    shots, _ = read(folder)
    assert len(shots.rows) == shots.rows.observed.shape[0] == 14 - len(faults)
    assert [r.row for r in shots.rows.origin.refused] == [2 + k for k in range(len(faults))]
    for refused, (_, why) in zip(shots.rows.origin.refused, faults, strict=True):
        assert refused.file == "shots.csv" and why in refused.why


def test_without_a_usable_shot_nothing_is_written(folder, capsys):
    shutil.rmtree(folder / "images")
    assert main([str(folder / "campaign.yaml")]) == 2
    assert "nothing could be measured" in capsys.readouterr().err
    assert not (folder / "results").exists()


@pytest.mark.parametrize(
    ("line", "arguments", "message"),
    [
        ("frames: {tip_target: {xyz: [0, 0, 0]}}", [], "tip_target"),
        ("effects: [{kind: sonar_bias, where: sonar_7}]", [], "no place 'sonar_7'"),
        ("", ["--verify", "other.csv"], "--verify"),
    ],
)
def test_what_a_head_cannot_do_is_said(three, capsys, line, arguments, message):
    path = three / "campaign.yaml"
    path.write_text(path.read_text() + line + "\n")
    assert main([str(path), *arguments]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_ranges_and_squares_are_no_covariates_but_other_columns_are(three):
    table = pd.read_csv(three / "shots.csv")
    table["temperature"] = np.linspace(20, 25, len(table))
    table.to_csv(three / "shots.csv", index=False)
    shots, _ = read(three)
    assert set(shots.rows.covariates) == {"temperature"}


@pytest.fixture(scope="module")
def shipped(tmp_path_factory) -> Path:
    """The results of the notebook that calibrates it, which runs and says what it promises."""
    home = tmp_path_factory.mktemp("strip")
    found = ran("2-calibrate-the-arid", home)["cal"]
    with chdir(FOLDER):
        found.save(home / "results")
    return home / "results"


def truth() -> dict:
    return json.loads((STRIP / "truth.json").read_text())


def frame(given: dict) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*given["rpy"]), np.array(given["xyz"]))


def test_the_shipped_campaign_names_the_sonar_and_its_bias(shipped):
    (effect,) = json.loads((shipped / "result.json").read_text())["effects"]
    (true,) = truth()["effects"]
    assert (effect["kind"], effect["where"]) == (true["kind"], true["where"]) == ("sonar_bias", "sonar_2")
    (c,) = effect["coefficients"]
    assert abs(c["value"] - true["coefficients"][0]["value"]) < 4 * c["std"] and c["unit"] == "m"
    assert effect["position_rms_mm"]["after"] < effect["position_rms_mm"]["before"] and not effect["declared"]


def test_the_shipped_campaign_gives_the_true_camera_anywhere_in_the_range_seen(shipped):
    given = truth()
    coefficients = named_constants(ARID, given["parameters"], STRIP)
    world, mount = (frame(given["frames"][k]) for k in ("world_base", "tip_camera"))
    true = Model(ARID, coefficients, ((None, world),), ((None, mount),))
    table = pd.read_csv(STRIP / "shots.csv")[list(ARID.readings)].to_numpy()
    q = np.random.default_rng(0).uniform(table.min(0), table.max(0), (200, 4))
    expected = poses(true, np.array(list(given["parameters"].values())), q)
    found = json.loads((shipped / "result.json").read_text())
    camera = frame(found["head"]["tip_camera"]).homogeneous
    solved = SavedModel.load(shipped / "calibration.yaml").final
    assert not any(c.where == "tip_target" for c in solved.model.coefficients)  # its target is the tip
    R, p = solved.poses(q)
    tip = np.broadcast_to(np.eye(4), (200, 4, 4)).copy()
    tip[:, :3, :3], tip[:, :3, 3] = R, p
    off = (tip @ camera)[:, :3, 3] - expected[:, :3, 3]
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 3e-5
    nominal = poses(Model(ARID, (), ((None, world),), ((None, mount),)), np.zeros(0), q)
    assert np.sqrt(np.mean(np.sum((nominal - expected)[:, :3, 3] ** 2, axis=1))) > 2e-3


def test_the_mountings_unobservable_part_and_the_last_link_are_named_as_redundant(shipped):
    found = {p["name"]: p for p in json.loads((shipped / "result.json").read_text())["parameters"]}
    assert [n for n, p in found.items() if n.startswith("tip_target") and p["status"] == "redundant"] == [
        "tip_target.x"
    ]
    last = {n: p["redundant_with"] for n, p in found.items() if n.startswith("flange_fixed")}
    assert len(last) == 6 and all(any(w.startswith(("tip_target", "world_base")) for w in why) for why in last.values())


def test_the_calibrated_urdf_is_as_good_alone_as_the_whole_where_only_the_head_was_at_fault(shipped):
    found = SavedModel.load(shipped / "calibration.yaml")
    q = pd.read_csv(STRIP / "shots.csv")[list(ARID.readings)].to_numpy()
    alone, whole = (solved.poses(q)[1] for solved in (found.geometric, found.final))
    assert np.abs(alone - whole).max() < 5e-6


def test_predict_gives_the_tip_for_each_shot(shipped, tmp_path):
    assert (
        aridcal(["predict", str(shipped / "calibration.yaml"), str(STRIP / "shots.csv"), "-o", str(tmp_path / "p.csv")])
        == 0
    )
    found = pd.read_csv(tmp_path / "p.csv")
    squares = pd.read_csv(STRIP / "squares.csv").set_index("index").loc[found["square"], ["x", "y", "z"]]
    distance = np.linalg.norm(found[["x", "y", "z"]].to_numpy() - squares.to_numpy(), axis=1)
    assert np.all((distance > 0.28) & (distance < 0.56))  # range and 0.1 m from the flange to the camera


def test_the_report_shows_head_mounting_and_the_answer_of_1992(shipped):
    page = (shipped / "report.html").read_text()
    for words in (
        "The measuring head",
        "sonar_2.bias",
        "The closed form of Doty (1992) on the same poses",
        "closed form − full",
    ):
        assert words in page


def test_a_charuco_board_and_no_sonars_calibrate_an_arm_too(tmp_path, capsys):
    board, side = Board(7, 7, 0.02, 0.015, "DICT_4X4_50"), 0.07
    sheet = cv2.cvtColor(board.opencv().generateImage((1400, 1400)), cv2.COLOR_GRAY2BGR)[..., 0]
    to_square = np.array([[1e-4, 0, -side], [0, -1e-4, side], [0, 0, 1]])
    boards = {0: pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.1, 0.4), np.array([0.7, -0.2, 0.1])).homogeneous}
    robot = robots.ur10()
    mount = pin.SE3(pin.rpy.rpyToMatrix(0.02, -0.01, 0.3), np.array([0.03, 0.01, 0.1]))
    off = {"shoulder_lift_joint.yaw": 2e-2, "elbow_joint.x": 1.5e-2, "wrist_1_joint.roll": -2e-2}
    true = Model(robot, tuple(Coefficient(*name.split(".")) for name in off), tip_target=((None, mount),))
    nominal = true.with_coefficients(())
    rng = np.random.default_rng(4)
    q, _ = draw_views(nominal, Optics(512, 512, boards), START.intrinsics, 24, rng, "test")
    (tmp_path / "images").mkdir()
    names = []
    for k, T in enumerate(poses(true, np.array(list(off.values())), q)):
        seen = np.linalg.inv(T) @ boards[0]
        fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ CAMERA @ seen[:3, [0, 1, 3]] @ to_square
        image = cv2.warpPerspective(sheet, fine, (2048, 2048), borderValue=255)
        names.append(f"images/{k}.png")
        cv2.imwrite(str(tmp_path / names[-1]), cv2.resize(image, (512, 512), interpolation=cv2.INTER_AREA))
    pd.DataFrame(q, columns=list(robot.readings)).assign(image=names, square=0).to_csv(
        tmp_path / "shots.csv", index=False
    )
    R = Rotation.from_matrix(boards[0][:3, :3]).as_quat()
    where = pd.DataFrame([[0, *boards[0][:3, 3], *R]], columns=["index", *"xyz", "qx", "qy", "qz", "qw"])
    where.to_csv(tmp_path / "squares.csv", index=False)
    (tmp_path / "head.yaml").write_text(
        "format: 1\ncamera: {fx: 700, fy: 700, cx: 255.5, cy: 255.5, width: 512, height: 512}\n"
        "tip_camera: {}\ntarget: charuco\nsquares_x: 7\nsquares_y: 7\nsquare: 0.02\nmarker: 0.015\n"
        "dictionary: DICT_4X4_50\nsquares: squares.csv\nshots: shots.csv\n"
    )
    (tmp_path / "campaign.yaml").write_text(
        f"format: 1\nrobot: {{urdf: {robot.path}, tip: tool0}}\nmeasurements: {{kind: camera_sonar, head: head.yaml}}\n"
        "diagnosis: {candidates: [lens_distortion, joint_gain]}\n"
    )
    found = run(tmp_path)
    assert len(found["head"]["numbers"]) == 9 and found["head"]["range_rms_mm"] == {"declared": {}, "identified": {}}
    rms = [found["error"][stage]["test"]["position_mm"]["rms"] for stage in ("nominal", "final")]
    assert rms[1] < rms[0] / 3 and found["verdict"] == "noise_floor"
    camera = frame(found["head"]["tip_camera"])
    assert np.linalg.norm((mount.inverse() * camera).translation) < 2e-3
