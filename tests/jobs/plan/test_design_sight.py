"""What an instrument must see of a planned configuration, and inclinations."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
import robots

from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.robot.collisions import lines_touch
from aridcal.files.campaign import load_campaign
from aridcal.jobs.plan import pose_design as planning
from aridcal.jobs.plan.clearance import apart
from aridcal.jobs.plan.configurations import draw_candidates, in_base, in_sight, targets_of
from aridcal.jobs.plan.information import _whitened, problem
from aridcal.jobs.plan.pose_design import PlanRequest, design
from aridcal.jobs.plan.prior_knowledge import PlanSetup, beforehand
from aridcal.jobs.plan.target_region import region_readings
from aridcal.system.errors import AridcalError, CampaignError

POSE = "kind: pose, noise: {position: 1.0e-4, rotation: 1.0e-4}"
TOOL = "diagnosis: {enabled: false}\nframes: {tip_target: {xyz: [0.05, 0.03, 0.15]}}\n"


@pytest.fixture(autouse=True)
def _few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "POOL", 200)


def known_of(
    folder: Path, more: str = "", block: str = POSE, urdf: Path = robots.URDF / "ur10.urdf", tip: str = "tool0"
) -> PlanSetup:
    path = folder / "campaign.yaml"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {urdf}, tip: {tip}}}\nmeasurements: {{file: rows.csv, {block}}}\n"
        + (TOOL if "tip_target" not in more and "kind: pixels" not in block else "diagnosis: {enabled: false}\n")
        + more
    )
    made = load_campaign(path)
    return beforehand(made, load_robot(made.robot.urdf, made.robot.tip))


LIMBS = """<robot name="limbs">
  <link name="base"/>
  <link name="upper"><collision><origin xyz="0 0 0.25"/><geometry><box size="0.1 0.12 0.5"/></geometry></collision></link>
  <link name="lower"><collision><origin xyz="0 0 .2"/><geometry><cylinder radius=".04" length=".4"/></geometry></collision></link>
  <link name="tool"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="j2" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.5"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="j3" type="revolute"><parent link="lower"/><child link="tool"/><origin xyz="0 0 0.45"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
</robot>"""


def test_the_distance_of_two_lines_is_that_of_their_nearest_points() -> None:
    rng = np.random.default_rng(0)
    a, b, c, d = rng.uniform(-1, 1, (4, 60, 3))
    d[:10] = c[:10] + 0.5 * (b - a)[:10]  # parallel
    d[10:15] = c[10:15]  # a point
    at = np.linspace(0, 1, 401)[:, None, None]
    first, second = a + at * (b - a), c + at * (d - c)
    every = np.array([
        np.linalg.norm(first[:, None, k] - second[None, :, k], axis=2).min() for k in range(60)
    ])  # fmt: skip
    np.testing.assert_allclose(apart(a, b, c, d), every, atol=6e-3)
    assert (apart(a, b, c, d) <= every + 1e-12).all()


def test_a_line_touches_the_arm_where_one_of_its_points_is_inside(tmp_path: Path) -> None:
    (tmp_path / "limbs.urdf").write_text(LIMBS)
    known = known_of(tmp_path, "", "kind: position, noise: {position: 1.0e-4}", tmp_path / "limbs.urdf", "tool")
    robot, geometry = known.robot, known.bodies.geometry
    rng = np.random.default_rng(1)
    q = draw_readings(robot, 60, rng)
    starts, ends = rng.uniform(-0.5, 0.5, (2, 60, 3)) + [0, 0, 0.5]
    found = lines_touch(robot, geometry, q, starts, ends)
    data, seen = robot.tree.createData(), geometry.createData()
    expected = np.zeros(60, dtype=bool)
    for k in range(60):
        pin.forwardKinematics(robot.tree, data, q[k])
        pin.updateGeometryPlacements(robot.tree, data, geometry, seen)
        for at in np.linspace(0, 1, 300):
            point = coal.Transform3s(np.eye(3), starts[k] + at * (ends[k] - starts[k]))
            for shape, frame in zip(geometry.geometryObjects, seen.oMg, strict=True):
                own = coal.Transform3s(frame.rotation, frame.translation)
                ball = coal.Sphere(1e-3)
                expected[k] |= bool(
                    coal.collide(shape.geometry, own, ball, point, coal.CollisionRequest(), coal.CollisionResult())
                )
    assert (found != expected).sum() <= 1 and 5 < expected.sum() < 55  # a corner cut between two points


def test_the_target_opens_towards_the_instrument_and_nothing_stands_between(tmp_path: Path) -> None:
    """Angles by arccos, the arm as lines by their sampled distance, for an arm without collision shapes."""
    tracker = np.array([1.8, -0.6, 0.9])
    sight = "{at: [1.8, -0.6, 0.9], axis: [0, 0, 2], within: 0.8}"
    wall = "keep_out: [{min: [0.9, -1, -1], max: [1.0, 0.2, 0.6]}]"
    known = known_of(tmp_path, f"design: {{sight: {sight}, {wall}}}\n")
    assert not known.bodies.shaped
    q = draw_readings(known.robot, 400, np.random.default_rng(0))
    pattern = np.zeros(400, dtype=int)
    found = in_sight(known, q, pattern)
    R, p = in_base(known, q, pattern)
    way = tracker - p
    angle = np.arccos(np.sum(R[:, :, 2] * way, axis=1) / np.linalg.norm(way, axis=1))
    points = p[:, None] + np.linspace(0, 1, 2001)[:, None] * way[:, None]
    behind = ((points > [0.9, -1, -1]) & (points < [1.0, 0.2, 0.6])).all(axis=2).any(axis=1)
    plain = known_of(tmp_path, "design: {sight: {at: [1.8, -0.6, 0.9]}}\n")
    past = in_sight(plain, q, pattern)  # by the arm alone
    np.testing.assert_array_equal(found, (angle <= 0.8) & ~behind & past)
    assert 10 < found.sum() < 200 and 100 < past.sum() < 400 and behind.sum() > 10


def test_plans_keep_to_what_is_seen_and_the_region_does_not(tmp_path: Path) -> None:
    more = "design: {sight: {at: [2.0, 0.5, 1.0], axis: [0, 0, 1], within: 0.6}}\n"
    known, plain = known_of(tmp_path, more), known_of(tmp_path)
    plan = design(known, PlanRequest(8))
    assert in_sight(known, plan.readings, np.zeros(8, dtype=int)).all()
    R, p = targets_of(known, plan.readings, np.zeros(8, dtype=int))
    way = np.array([2.0, 0.5, 1.0]) - p
    assert (np.sum(R[:, :, 2] * way, axis=1) / np.linalg.norm(way, axis=1) >= np.cos(0.6) - 1e-12).all()
    places = [region_readings(k, None, np.random.default_rng(0)) for k in (known, plain)]
    np.testing.assert_array_equal(*places)


@pytest.mark.parametrize(
    ("sight", "said"),
    [
        ("{at: [2, 0, 1], axis: [0, 0, 1]}", "go together"),
        ("{at: [2, 0, 1], axis: [0, 0, 0], within: 1.0}", "points nowhere"),
        ("{axis: [0, 0, 1], within: 1.0}", "at"),
        ("{at: [2, 0, 1], axis: [0, 0, 1], within: 0.001}", "design.sight"),
    ],
)
def test_a_sight_that_cannot_be_is_refused(tmp_path: Path, sight: str, said: str) -> None:
    with pytest.raises(AridcalError, match=said):
        draw_candidates(known_of(tmp_path, f"design: {{sight: {sight}}}\n"), 200, 100, np.random.default_rng(0))


def test_markers_behind_a_box_are_not_counted_on(tmp_path: Path) -> None:
    """No line from the camera to a marker that counts has a point in the box, beyond what the mounts take; some would."""
    board = {f"m{i}{j}": (0.6 + 0.06 * i, 0.06 * j, 0.05) for i in range(4) for j in range(4)}
    table = "".join(f"{m},{x - 0.6},{y},0\n" for m, (x, y, _) in board.items())
    (tmp_path / "markers.csv").write_text("marker,x,y,z\n" + table)
    camera = "fx: 500, fy: 500, cx: 320, cy: 240, width: 640, height: 480, on: tip, xyz: [0, 0, 0.05], rpy: [0, 0, 0]"
    place = "file: markers.csv, xyz: [0.6, 0, 0.05], rpy: [0, 0, 0]"
    more = f"instruments: {{cameras: {{eye: {{{camera}}}}}, markers: {{{place}}}}}\n"
    low, high = [0.57, -0.02, 0.1], [0.7, 0.25, 0.12]
    block = "kind: pixels, noise: {pixel: 0.2}"

    def hidden(known: PlanSetup) -> np.ndarray:
        candidates = draw_candidates(known, 60, 10, np.random.default_rng(0))
        R, p = targets_of(known, candidates.readings[candidates.of], candidates.pattern)
        eye = p + 0.05 * R[:, :, 2]
        marker = np.array([board[str(known.patterns.labels.refers[k, 2])] for k in candidates.pattern])
        at = np.linspace(0, 1, 301)[:, None, None]
        points = eye + at * (marker - eye)
        mounts = (at[:, :, 0] * np.linalg.norm(marker - eye, axis=1) < 0.03) | (
            (1 - at[:, :, 0]) * np.linalg.norm(marker - eye, axis=1) < 0.03
        )
        return np.asarray(((points > low) & (points < high)).all(axis=2) & ~mounts).any(axis=0)

    assert not hidden(known_of(tmp_path, more + f"design: {{keep_out: [{{min: {low}, max: {high}}}]}}\n", block)).any()
    assert hidden(known_of(tmp_path, more, block)).mean() > 0.2


# -- inclinations


def test_inclinations_are_planned_at_what_they_would_read(tmp_path: Path) -> None:
    known = known_of(tmp_path, "", "kind: inclination, noise: {inclination: 1.0e-4}")
    candidates = draw_candidates(known, 50, 10, np.random.default_rng(0))
    rows = candidates.rows(known)
    R, _ = targets_of(known, candidates.readings, candidates.first)
    np.testing.assert_allclose(rows.observed[:, :3], -R[:, 2, :], atol=1e-12)
    np.testing.assert_allclose(_whitened(problem(known.model, rows), known)[1], 0.0, atol=1e-8)
    plan = design(known, PlanRequest(12))
    assert plan.at_n.rms < 0.95 * plan.random and "nothing of lengths" in plan.notices[0]


def test_shots_cannot_be_planned_and_the_reason_is_said(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="hangs on the squares in its image; plan for `kind: pose`"):
        path = tmp_path / "campaign.yaml"
        path.write_text(
            f"format: 1\nrobot: {{urdf: {robots.URDF / 'arid.urdf'}, tip: flange}}\n"
            "measurements: {kind: camera_sonar, head: head.yaml}\n"
        )
        made = load_campaign(path)
        beforehand(made, load_robot(made.robot.urdf, made.robot.tip))
