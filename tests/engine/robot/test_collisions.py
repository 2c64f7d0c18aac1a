"""Bodies of a robot that touch: against distances of balls, and against Pinocchio's own reading of the meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots

from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.robot.chain import Robot, load_robot, parse_robot
from aridcal.engine.robot.collisions import bodies_of, touches
from aridcal.files.campaign import load_campaign
from aridcal.jobs.plan import pose_design as planning
from aridcal.jobs.plan.pose_design import PlanRequest, design
from aridcal.jobs.plan.prior_knowledge import beforehand

LENGTHS, RADIUS = (0.5, 0.4, 0.4), 0.1


def balls(shape: str = f'<sphere radius="{RADIUS}"/>') -> Robot:
    """Three links in a plane, a ball at the end of each and at the base, which stands away from the root and is turned."""
    parts = ['<robot name="r"><link name="root"/>']
    ball = f"<collision><geometry>{shape}</geometry></collision>"
    parts.append(
        f'<link name="base">{ball}</link><joint name="stand" type="fixed"><parent link="root"/><child link="base"/>'
    )
    parts.append('<origin xyz="1 2 3" rpy="0 0 0.5"/></joint>')
    parent = "base"
    for k, step in enumerate((0.0, *LENGTHS[:2])):
        own = f'<collision><origin xyz="{LENGTHS[k]} 0 0"/><geometry>{shape}</geometry></collision>'
        parts.append(f'<link name="l{k}">{own}</link><joint name="j{k}" type="revolute"><parent link="{parent}"/>')
        parts.append(f'<child link="l{k}"/><origin xyz="{step} 0 0"/><axis xyz="0 0 1"/>')
        parts.append('<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>')
        parent = f"l{k}"
    return parse_robot(("".join(parts) + "</robot>").encode(), "l2", "base")


def centres(q: np.ndarray) -> np.ndarray:
    """Of the balls in the base's frame, the base's own first, shape (n, 4, 3)."""
    angles = np.cumsum(q, axis=1)
    steps = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=2) * np.array(LENGTHS)[:, None]
    return np.concatenate([np.zeros((len(q), 1, 3)), np.cumsum(steps, axis=1)], axis=1)


def test_balls_touch_where_their_centres_are_near() -> None:
    robot, rng = balls(), np.random.default_rng(0)
    low, high = np.array([0.3, 0.2, -0.05]), np.array([0.9, 0.8, 0.4])
    bodies = bodies_of(robot, [(low, high)], draw_readings(robot, 50, rng))
    q = draw_readings(robot, 300, rng)
    at = centres(q)
    apart = np.linalg.norm(at[:, :, None] - at[:, None], axis=3)
    expected = (np.stack([apart[:, 0, 2], apart[:, 0, 3], apart[:, 1, 3]]) < 2 * RADIUS).any(axis=0)
    outside = np.linalg.norm(at[:, 1:] - np.clip(at[:, 1:], low, high), axis=2)
    expected |= (outside < RADIUS).any(axis=1)
    found = touches(robot, bodies.geometry, q).any(axis=1)
    np.testing.assert_array_equal(found, expected)
    assert 0.2 < found.mean() < 0.8 and bodies.unread == ()


def test_balls_touch_alike_wherever_the_path_starts() -> None:
    """From the last link to the foot, and boxes go with the link that is called the base: turned back, the same."""
    robot, rng = balls(), np.random.default_rng(0)
    upwards, q = parse_robot(robot.urdf, "base", "l2"), draw_readings(robot, 300, rng)
    assert upwards.readings == robot.readings[::-1]
    low, high = (
        np.array([0.05, -0.4, -0.1]),
        np.array([0.25, -0.1, 0.1]),
    )  # beside the last link, that no ball of its own is in
    alone, with_box = (bodies_of(upwards, boxes, q[:50, ::-1]) for boxes in ([], [(low, high)]))
    np.testing.assert_array_equal(
        touches(upwards, alone.geometry, q[:, ::-1]).any(axis=1),
        touches(robot, bodies_of(robot, [], q[:50]).geometry, q).any(axis=1),
    )
    angle, last = q.sum(axis=1), centres(q)
    turned = np.stack([np.stack([np.cos(angle), np.sin(angle)], 1), np.stack([-np.sin(angle), np.cos(angle)], 1)], 1)
    l2 = last[:, 2:3, :2]  # where the last link's joint is
    seen = np.einsum("nij,nkj->nki", turned, last[:, :3, :2] - l2)
    outside = np.linalg.norm(seen - np.clip(seen, low[:2], high[:2]), axis=2)
    in_box = (outside < RADIUS).any(axis=1)
    found = touches(upwards, with_box.geometry, q[:, ::-1]).any(axis=1)
    np.testing.assert_array_equal(found, in_box | touches(upwards, alone.geometry, q[:, ::-1]).any(axis=1))
    assert 0.1 < in_box.mean() < 0.9


def test_shapes_that_always_overlap_and_what_cannot_be_read_say_nothing() -> None:
    rng = np.random.default_rng(0)
    huge = balls('<sphere radius="3"/>')
    assert not bodies_of(huge, [], draw_readings(huge, 20, rng)).any
    missing = balls('<mesh filename="nowhere.stl"/>')
    bodies = bodies_of(missing, [], draw_readings(missing, 20, rng))
    assert (
        not bodies.any
        and len(bodies.unread) == 1
        and "4 shapes without a mesh file ('nowhere.stl')" in bodies.unread[0]
    )


@pytest.mark.skipif(not robots.SHARED_ROBOTS.exists(), reason="needs example-robot-data")
def test_what_collides_by_the_exact_meshes_collides_by_their_hulls() -> None:
    path = robots.SHARED_ROBOTS / "ur_description" / "urdf" / "ur10_robot.urdf"
    robot, rng = load_robot(path, "tool0"), np.random.default_rng(0)
    bodies = bodies_of(robot, [], draw_readings(robot, 100, rng))
    q = draw_readings(robot, 100, rng)
    found = touches(robot, bodies.geometry, q)
    model = pin.buildModelFromUrdf(str(path))
    exact = pin.buildGeomFromUrdf(
        model, str(path), pin.GeometryType.COLLISION, package_dirs=[str(robots.SHARED_ROBOTS.parent.parent)]
    )
    joints = [(bodies.geometry.geometryObjects[p.first].parentJoint, bodies.geometry.geometryObjects[p.second].parentJoint)
              for p in bodies.geometry.collisionPairs]  # fmt: skip
    pairs = [(i, j) for i, a in enumerate(exact.geometryObjects) for j, b in enumerate(exact.geometryObjects[:i])
             if (b.parentJoint, a.parentJoint) in joints]  # fmt: skip
    for i, j in pairs:
        exact.addCollisionPair(pin.CollisionPair(i, j))
    data, seen = model.createData(), exact.createData()
    hit = np.array([pin.computeCollisions(model, data, exact, seen, row, True) for row in q])
    assert (found.any(axis=1) | ~hit).all()
    assert 0.05 < hit.mean() < found.any(axis=1).mean() < 0.9


@pytest.mark.skipif(not robots.SHARED_ROBOTS.exists(), reason="needs example-robot-data")
def test_no_planned_configuration_touches_anything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "POOL", 200)
    urdf = robots.SHARED_ROBOTS / "ur_description" / "urdf" / "ur10_robot.urdf"
    path = tmp_path / "campaign.yaml"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {urdf}, tip: tool0}}\nmeasurements: {{file: none.csv, kind: position}}\n"
    )
    campaign = load_campaign(path)
    known = beforehand(campaign, load_robot(urdf, "tool0"))
    plan = design(known, PlanRequest(15))
    assert not touches(known.robot, known.bodies.geometry, plan.readings).any()
    anywhere = draw_readings(known.robot, 100, np.random.default_rng(1))
    assert touches(known.robot, known.bodies.geometry, anywhere).any(axis=1).mean() > 0.1
