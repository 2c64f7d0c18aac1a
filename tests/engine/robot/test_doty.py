"""The Doty description of a chain: exact for any chain, Doty's numbers for the ARID, honest where singular."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from repository import ROOT

from aridcal.engine.robot.chain import Joint, Robot, load_robot
from aridcal.engine.robot.doty import (
    DOTY_COMPONENTS,
    Link,
    align,
    axis_to_link,
    doty_links,
    link_transform,
    motion,
    segments,
)
from aridcal.engine.robot.drive import Drive

URDF = ROOT / "urdf"
X, Y, Z = np.eye(3)
NO_TURN = np.eye(3)


def chain(joints: list[tuple[str, np.ndarray, pin.SE3]], tip: pin.SE3) -> Robot:
    """A bare chain of (kind, axis, origin), with the tip on a fixed joint; nothing else of the URDF matters here."""
    made = tuple(
        Joint(f"joint_{k}", kind, axis, pin.SE3.Identity(), origin, Drive({f"joint_{k}": 1.0}))
        for k, (kind, axis, origin) in enumerate(joints, start=1)
    )
    return Robot(b"", Path("chain.urdf"), "base", "tip", made, (), "tip_joint", pin.SE3.Identity(), tip, {}, {})


def at(rotation: np.ndarray = NO_TURN, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    return pin.SE3(rotation, np.array([x, y, z]))


def placements(robot: Robot) -> list[pin.SE3]:
    """From each moving joint, after its motion, to the next one's frame, the tip last."""
    return list(robot.onward[1:])


def fold(link: Link, **corrections: float) -> pin.SE3:
    """From a joint's frame, after its motion, to the next one's, with corrections dd, dtheta, dbeta, da, dalpha."""
    d = {c: corrections.get(f"d{c}", 0.0) for c in DOTY_COMPONENTS}
    corrected = link_transform(
        link.theta + d["theta"], link.beta + d["beta"], link.a + d["a"], link.alpha + d["alpha"], d["d"]
    )
    return link.before * pin.SE3(corrected) * link.after


def joint_motion(joint: Joint, q: float) -> pin.SE3:
    if joint.kind == "prismatic":
        return pin.SE3(np.eye(3), q * joint.axis)
    return pin.SE3(pin.AngleAxis(q, joint.axis).toRotationMatrix(), np.zeros(3))


def random_chain(rng: np.random.Generator) -> Robot:
    """Two to seven joints of either kind; neighbours at random, parallel, coaxial, intersecting, or nearly so."""
    joints = []
    for _ in range(rng.integers(2, 8)):
        axis = rng.normal(size=3) if rng.random() < 0.4 else rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
        origin = pin.SE3.Random() if rng.random() < 0.5 else at(x=rng.normal(), z=rng.normal())
        style = rng.integers(4)
        if style == 1:  # on the axis before, whatever its direction
            along = rng.normal() * (joints[-1][1] if joints else Z)
            origin = pin.SE3(origin.rotation, along)
        elif style == 2:  # almost on it
            origin = pin.SE3(origin.rotation, rng.normal(size=3) * 3e-4)
        elif style == 3:  # almost parallel
            origin = pin.SE3(pin.exp3(rng.normal(size=3) * 3e-4), origin.translation)
        joints.append((str(rng.choice(["revolute", "prismatic"])), axis / np.linalg.norm(axis), origin))
    return chain(joints, pin.SE3.Random())


@pytest.fixture(scope="module")
def random_chains() -> list[Robot]:
    rng = np.random.default_rng(1992)
    pin.seed(1992)
    return [random_chain(rng) for _ in range(200)]


def doty_chain(parameters: np.ndarray) -> Robot:
    """A rail and revolute joints whose frames are Doty frames: every moving joint turns about its z."""
    origins = [pin.SE3.Identity()] + [pin.SE3(link_transform(*row)) for row in parameters]
    kinds = ["prismatic"] + ["revolute"] * (len(parameters) - 1)
    return chain([(kind, Z, origin) for kind, origin in zip(kinds, origins[:-1], strict=True)], origins[-1])


def arid(a: tuple[float, float, float] = (0.5, 1.2, 0.9)) -> Robot:
    return doty_chain(np.array([[0.0, 0.0, length, 0.0] for length in (*a, 0.0)]))


def twist(placement: Callable[[float], pin.SE3], h: float = 1e-5) -> np.ndarray:
    """Derivative of a placement at 0 as a twist in its own frame, by central differences."""
    return pin.log6(placement(-h).actInv(placement(h))).vector / (2 * h)


def origin_correction(placement: pin.SE3, component: str, value: float) -> pin.SE3:
    """A placement with one of URDF's six components corrected: P Tx Ty Tz Rz Ry Rx."""
    k = ["x", "y", "z", "roll", "pitch", "yaw"].index(component)
    amount = value * np.eye(6)[k]
    return placement * pin.SE3(pin.rpy.rpyToMatrix(amount[3:]), amount[:3])


def test_link_transform_is_the_product_of_its_elementary_transforms():
    rng = np.random.default_rng(1)
    values = rng.uniform(-3, 3, (50, 5))
    for row, transform in zip(values, link_transform(*values.T), strict=True):
        theta, beta, a, alpha, d = row
        turns = [pin.AngleAxis(x, axis).toRotationMatrix() for x, axis in ((theta, Z), (beta, Y), (alpha, X))]
        product = at(z=d) * at(turns[0]) * at(turns[1]) * at(x=a) * at(turns[2])
        np.testing.assert_allclose(transform, product.homogeneous, atol=1e-14)


def test_axis_to_link_inverts_the_link_transform_from_any_point_of_the_axis():
    rng = np.random.default_rng(2)
    for _ in range(200):
        link = rng.uniform([-3.1, -1.5, 0.01, -3.1], [3.1, 1.5, 2.0, 3.1])
        transform = link_transform(*link)
        direction = transform[:3, 2]
        found = axis_to_link(transform[:3, 3] + rng.normal() * direction, direction)
        np.testing.assert_allclose(found, link, atol=1e-12)


def test_tilting_a_parallel_axis_moves_beta_by_the_tilt_where_the_dh_offset_jumps():
    tilt = 1e-3
    direction = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    found = axis_to_link(np.array([1.2, 0.0, 0.0]), direction)
    np.testing.assert_allclose(found, (0.0, tilt, 1.2 * np.cos(tilt), 0.0), atol=1e-15)
    common_point = np.linalg.lstsq(np.column_stack([Z, -direction]), np.array([1.2, 0, 0]), rcond=None)[0]
    assert common_point[0] < -1199.0  # Denavit and Hartenberg's d: where the two axes meet


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3)])
def test_align_permutes_frame_axes_exactly(axis):
    rotation = align(axis).rotation
    np.testing.assert_array_equal(rotation @ Z, axis)
    assert set(np.abs(rotation).ravel()) == {0.0, 1.0}
    assert np.linalg.det(rotation) == 1.0


def test_align_is_a_rotation_onto_any_direction_even_next_to_the_opposite_one():
    rng = np.random.default_rng(3)
    near = np.c_[rng.normal(size=(50, 2)) * np.logspace(-12, 0, 50)[:, None], -np.ones(50)]
    for direction in np.vstack([rng.normal(size=(50, 3)), near]):
        direction = direction / np.linalg.norm(direction)
        rotation = align(direction).rotation
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-13)
        np.testing.assert_allclose(rotation[:, 2], direction, atol=1e-13)


def test_before_link_after_is_the_placement_of_the_next_joint_on_any_chain(random_chains):
    for robot in random_chains:
        for link, placement in zip(doty_links(robot), placements(robot), strict=True):
            np.testing.assert_allclose(fold(link).homogeneous, placement.homogeneous, atol=1e-12)


def test_readings_added_to_theta_and_d_move_the_chain_as_its_joints_do(random_chains):
    rng = np.random.default_rng(4)
    for robot in random_chains:
        by_joints = by_links = robot.onward[0]
        links = doty_links(robot)
        for joint, link, placement in zip(robot.joints, links, placements(robot), strict=True):
            q = rng.uniform(-2, 2)
            by_joints = by_joints * joint_motion(joint, q) * placement
            by_links = by_links * (fold(link, dd=q) if link.prismatic else fold(link, dtheta=q))
        np.testing.assert_allclose(by_links.homogeneous, by_joints.homogeneous, atol=1e-10)


def test_regular_links_follow_one_another_with_nothing_in_between(random_chains):
    pairs = [pair for robot in random_chains for pair in zip(doty_links(robot), doty_links(robot)[1:], strict=False)]
    regular = [(link, following) for link, following in pairs if not link.singular and not following.singular]
    assert len(regular) > 100
    for link, following in regular:  # equation (3-4): L1 L2 L3 L4, bare
        np.testing.assert_allclose((link.after * following.before).homogeneous, np.eye(4), atol=1e-12)


def test_link_parameters_come_back_from_a_chain_made_of_them():
    rng = np.random.default_rng(5)
    for _ in range(100):
        parameters = rng.uniform([-3, -1.2, 0.01, -3], [3, 1.2, 2, 3], (4, 4))
        links = doty_links(doty_chain(parameters))
        found = [(link.theta, link.beta, link.a, link.alpha) for link in links]
        np.testing.assert_allclose(found, parameters, atol=1e-9)
        assert [link.prismatic for link in links] == [True, False, False, False]
        assert [link.next_origin for link in links] == ["joint_2", "joint_3", "joint_4", "tip_joint"]
        for link in links:
            np.testing.assert_allclose(link.before.homogeneous, np.eye(4), atol=1e-9)
            np.testing.assert_allclose(link.after.homogeneous, np.eye(4), atol=1e-9)


def test_the_arids_fourth_link_is_singular_and_the_others_are_not():
    links = doty_links(arid())
    assert [link.components for link in links] == [
        ("d", "theta", "beta", "a", "alpha"),
        ("theta", "beta", "a", "alpha"),
        ("theta", "beta", "a", "alpha"),
        ("a", "alpha"),
    ]
    assert [link.a for link in links] == [0.5, 1.2, 0.9, 0.0]
    assert all((link.theta, link.beta, link.alpha) == (0.0, 0.0, 0.0) for link in links)


def test_table_3_1_of_the_shipped_arid():
    robot = load_robot(URDF / "arid.urdf", tip="flange")
    links = doty_links(robot)
    assert [link.joint for link in links] == ["joint_1", "joint_2", "joint_3", "joint_4"]
    assert [link.prismatic for link in links] == [True, False, False, False]
    assert [link.a for link in links] == [0.3, 1.98, 1.98, 0.0]
    assert all(link.theta == link.beta == link.alpha == 0.0 for link in links)
    assert [link.singular for link in links] == [False, False, False, True]
    np.testing.assert_allclose(robot.limits[0], [0.0, 718 * 0.0254], atol=1e-9)
    np.testing.assert_allclose(np.degrees(robot.limits[1:]), [[4, 112], [102, 148], [-117, -16]], atol=1e-3)


@pytest.mark.parametrize("height", [1.0, 0.1, -1e-9, -0.9, -0.99, -0.9989, -0.9991, -1.0 + 1e-9])
def test_a_turn_onto_an_axis_is_a_rotation_wherever_the_axis_points(height):
    rng = np.random.default_rng(2)
    for turn in rng.uniform(-np.pi, np.pi, 20):
        across = np.sqrt((1.0 - height) * (1.0 + height))
        direction = np.array([across * np.cos(turn), across * np.sin(turn), height])
        R = align(direction / np.linalg.norm(direction)).rotation
        # Each entry is a dozen operations on numbers up to 2.
        np.testing.assert_allclose(R.T @ R, np.eye(3), rtol=0, atol=5e-15)
        np.testing.assert_allclose(R[:, 2], direction, rtol=0, atol=5e-15)


@pytest.mark.parametrize("height", [0.0, 0.3, -0.7])
@pytest.mark.parametrize("miss", [0.0, 5e-4])
@pytest.mark.parametrize("tilt", [0.5 * np.pi, -0.5 * np.pi, np.pi, 0.0, 5e-4])
def test_an_axis_that_meets_the_one_before_is_singular_and_still_exact(height, miss, tilt):
    second = at(pin.rpy.rpyToMatrix(tilt, 0.0, 0.4), y=miss, z=height)
    robot = chain([("revolute", Z, pin.SE3.Identity()), ("revolute", Z, second)], at(x=0.5))
    first, last = doty_links(robot)
    assert first.singular and not last.singular
    assert first.components == ("a", "alpha")
    assert (first.beta, first.a) == (0.0, 0.0)
    np.testing.assert_allclose(fold(first).homogeneous, second.homogeneous, atol=1e-14)
    by_links = fold(first, dtheta=0.3) * fold(last, dtheta=-0.8)
    by_joints = joint_motion(robot.joints[0], 0.3) * second * joint_motion(robot.joints[1], -0.8) * at(x=0.5)
    np.testing.assert_allclose(by_links.homogeneous, by_joints.homogeneous, atol=1e-13)


def test_theta_turns_x_onto_the_common_normal_of_a_singular_link():
    rng = np.random.default_rng(6)
    for _ in range(50):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        robot = chain([("revolute", Z, pin.SE3.Identity()), ("revolute", direction, pin.SE3.Identity())], at(x=1.0))
        link = doty_links(robot)[0]
        x = motion("theta", link.theta).rotation @ X
        np.testing.assert_allclose(x, np.cross(Z, direction) / np.linalg.norm(np.cross(Z, direction)), atol=1e-12)
        np.testing.assert_allclose(np.cos(link.alpha), direction[2], atol=1e-12)


def test_ur10_is_regular_only_along_its_two_long_links():
    robot = load_robot(URDF / "ur10.urdf", tip="tool0")
    links = doty_links(robot)
    assert [link.singular for link in links] == [True, False, False, True, True, True]
    np.testing.assert_allclose([links[1].a, links[2].a], [0.612, 0.5723], atol=1e-3)
    for link, placement in zip(links, placements(robot), strict=True):
        np.testing.assert_allclose(fold(link).homogeneous, placement.homogeneous, atol=1e-14)


def test_segments_with_corrections_inserted_multiply_to_the_folded_placement(random_chains):
    rng = np.random.default_rng(7)
    kinds = set()
    for robot in random_chains[:60]:
        for link in doty_links(robot):
            kinds.add(link.components)
            corrections = dict(zip(DOTY_COMPONENTS, rng.uniform(-0.3, 0.3, 5), strict=True))
            cuts, rest = segments(link)
            assert tuple(component for component, _ in cuts) == link.components
            product = pin.SE3.Identity()
            for component, placement in cuts:
                product = product * placement * motion(component, corrections[component])
            folded = fold(link, **{f"d{component}": corrections[component] for component in link.components})
            np.testing.assert_allclose((product * rest).homogeneous, folded.homogeneous, atol=1e-12)
    assert len(kinds) == 4  # prismatic or not, singular or not


def test_joint_1_beta_is_joint_2_pitch_less_a1_times_joint_2_z():
    a1 = 0.5
    link = doty_links(arid((a1, 1.2, 0.9)))[0]
    origin = fold(link)
    beta = twist(lambda h: fold(link, dbeta=h))
    pitch = twist(lambda h: origin_correction(origin, "pitch", h))
    z = twist(lambda h: origin_correction(origin, "z", h))
    np.testing.assert_allclose(beta, pitch - a1 * z, atol=1e-9)


def test_corrections_of_a_link_are_independent_twists(random_chains):
    for robot in random_chains[:60]:
        for link in doty_links(robot):
            columns = [twist(lambda h, k=link, c=c: fold(k, **{f"d{c}": h})) for c in link.components]
            values = np.linalg.svd(np.array(columns), compute_uv=False)
            assert values[-1] > 1e-4, (link.joint, values)


def test_at_the_arids_fourth_joint_yaw_and_pitch_of_the_tip_stand_in_for_theta_and_beta():
    link = doty_links(arid())[3]
    own = [twist(lambda h, c=c: fold(link, **{f"d{c}": h})) for c in ("a", "alpha")]
    lent = [twist(lambda h, c=c: origin_correction(fold(link), c, h)) for c in ("yaw", "pitch")]
    assert link.next_origin == "tip_joint"
    assert np.linalg.svd(np.array(own + lent), compute_uv=False)[-1] > 0.5
