"""Simulated shots: where they are taken from, and that what they show is what the detector then finds."""

import cv2
import numpy as np
import pytest
import yaml
from heads import ARID, MODEL, OPTICS, SETTINGS, START, STRIP, THETA, poses, views

from aridcal.__main__ import main as aridcal
from aridcal.jobs.head1992.render import Optics, photograph
from aridcal.jobs.head1992.shots import sight
from aridcal.jobs.head1992.square_pose import Sonars
from aridcal.jobs.simulate.viewpoints import draw_views
from aridcal.system.errors import CampaignError

cv2.setNumThreads(1)


def test_views_are_inside_the_limits_and_show_the_square_they_name():
    q, square = views(30, seed=8)
    low, high = ARID.limits.T
    assert np.all((q >= low) & (q <= high)) and len(set(square)) == 30
    for T, own in zip(poses(MODEL, 0 * THETA, q), square, strict=True):
        off = {k: np.linalg.norm(np.cross(S[:3, 3] - T[:3, 3], T[:3, 2])) for k, S in OPTICS.squares.items()}
        near = [k for k in off if np.linalg.norm(OPTICS.squares[k][:3, 3] - T[:3, 3]) < 1.0]
        assert min(near, key=lambda k: off[k]) == own
        assert OPTICS.in_view(T, int(own), START.intrinsics) >= 4


def test_a_photograph_is_measured_where_it_was_taken_from():
    q, square = views(2, seed=9)
    rng = np.random.default_rng(0)
    for T, own in zip(poses(MODEL, THETA, q), square, strict=True):
        content, h = photograph(T, int(own), OPTICS, START, rng)
        image = np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE))
        assert image.shape == (512, 512) and len(content) < 60_000
        sonars = Sonars(h, START.positions, START.measures, START.std)
        pose = sight(image, sonars, int(own), dict(OPTICS.squares), SETTINGS).pose
        true = np.linalg.inv(T) @ OPTICS.squares[int(own)]
        off = np.linalg.inv(true) @ pose.T_camera_square
        twist = np.r_[off[:3, 3], off[2, 1], off[0, 2], off[1, 0]]
        assert twist @ np.linalg.solve(pose.covariance, twist) < 40  # chi-square of 6: 1 in a million


def test_squares_out_of_reach_are_refused_not_waited_for():
    far = Optics(512, 512, {0: np.diag([1.0, 1, 1, 1]) + 50 * np.eye(4, k=3)})
    nominal = MODEL.with_coefficients(())
    with pytest.raises(CampaignError, match=r"scenario\.yaml: this arm brings the camera in front of none"):
        draw_views(nominal, far, START.intrinsics, 2, np.random.default_rng(0), "scenario.yaml")


def test_a_simulated_campaign_elsewhere_has_all_it_needs_and_the_seed_fixes_it(tmp_path):
    keys = yaml.safe_load((STRIP / "scenario.yaml").read_text())
    keys["truth"] |= {"n": 2}
    keys["robot"]["urdf"] = str(ARID.path)
    keys["measurements"]["head"] = str(STRIP / "head.yaml")
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(keys))
    for name in ("a", "b"):
        assert aridcal(["simulate", str(tmp_path / "scenario.yaml"), "-o", str(tmp_path / name)]) == 0
    made = {p.relative_to(tmp_path / "a"): p.read_bytes() for p in (tmp_path / "a").rglob("*") if p.is_file()}
    assert {str(p) for p in made} == {
        "arid.urdf", "campaign.yaml", "head.yaml", "squares.csv", "shots.csv", "truth.json",
        "images/001.jpg", "images/002.jpg",
    }  # fmt: skip
    assert all((tmp_path / "b" / p).read_bytes() == content for p, content in made.items())
    assert aridcal(["measure", str(tmp_path / "a" / "head.yaml"), "-o", str(tmp_path / "m.csv")]) == 0


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        ({"noise": {"position": 1e-4}}, "truth.noise"),
        ({"effects": [{"kind": "sonar_bias", "where": "sonar_9", "coefficients": 1e-3}]}, "no place 'sonar_9'"),
        (
            {"effects": [{"kind": "lens_distortion", "where": "camera", "motion": ["p1", "p2"], "coefficients": 1}]},
            "p2",
        ),
    ],
)
def test_what_cannot_be_photographed_is_named(tmp_path, capsys, truth, message):
    keys = yaml.safe_load((STRIP / "scenario.yaml").read_text())
    keys["truth"] |= {"n": 1} | truth
    keys["robot"]["urdf"], keys["measurements"]["head"] = str(ARID.path), str(STRIP / "head.yaml")
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(keys))
    assert aridcal(["simulate", str(tmp_path / "scenario.yaml"), "-o", str(tmp_path / "out")]) == 2
    assert message in " ".join(capsys.readouterr().err.split()) and not (tmp_path / "out").exists()
