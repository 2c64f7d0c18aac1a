"""A URDF as a chain: checked against Pinocchio's own reading of the whole tree and against yourdfpy."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
import yourdfpy

from aridcal.engine.robot.chain import ReadingColumn, Robot, load_robot, parse_robot
from aridcal.engine.robot.drive import Drive
from aridcal.engine.robot.kinematics import gravity_loads, joint_frames, rotations, tip_frames, transverse, tree_frames
from aridcal.system.errors import RobotError

FRANKA = robots.SHARED_ROBOTS / "panda_description" / "urdf" / "panda.urdf"
TIAGO = robots.SHARED_ROBOTS / "tiago_description" / "robots" / "tiago.urdf"

# The column: `lift` and `lift_2` are what the tip sees; `motor` is a dead side branch, parsed last, that drives both,
# one of them by way of the other. `flap` hangs on the last link and follows `motor` too.
COLUMN = b"""<?xml version="1.0"?>
<robot name="column">
  <link name="root"/>
  <link name="base"/>
  <link name="stage"><inertial><mass value="3"/><origin xyz="0.1 0.2 -0.1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="top"><inertial><mass value="2"/><origin xyz="-0.3 0 0.4"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"><inertial><mass value="1.5"/><origin xyz="0 0.2 0.2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="vane"><inertial><mass value="4"/><origin xyz="0.5 0 0"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="spindle"/>
  <joint name="mount" type="fixed"><parent link="root"/><child link="base"/>
    <origin xyz="1 2 3" rpy="0.3 -0.4 2"/></joint>
  <joint name="lift_2" type="prismatic"><parent link="stage"/><child link="top"/>
    <origin xyz="0 0 0.5" rpy="0.1 0 0"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/>
    <mimic joint="lift" multiplier="-0.5" offset="0.25"/></joint>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="stage"/>
    <origin xyz="0.2 0 0" rpy="0 0.2 0"/><axis xyz="0 0.6 0.8"/><limit lower="0" upper="1" effort="1" velocity="1"/>
    <mimic joint="motor" multiplier="0.1" offset="0.05"/></joint>
  <joint name="wrist" type="continuous"><parent link="top"/><child link="hand"/>
    <origin xyz="0 0.1 0.3"/><axis xyz="1 0 0"/></joint>
  <joint name="flap" type="revolute"><parent link="hand"/><child link="vane"/>
    <origin xyz="0.2 0 0"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
    <mimic joint="motor" multiplier="2" offset="-0.3"/></joint>
  <joint name="motor" type="revolute"><parent link="base"/><child link="spindle"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="7" effort="1" velocity="1"/></joint>
</robot>
"""


def tree_configuration(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Pinocchio's configuration of the whole tree for one row: measured joints and all that follow them."""
    model, value = robot.tree, dict(zip(robot.readings, readings, strict=True))
    q = pin.neutral(model)
    for k, name in enumerate(model.names[1:], start=1):
        drive = robot.mimics.get(name, Drive({name: 1.0}))
        if drive.factors.keys() <= value.keys():
            joint = model.joints[k]
            position = sum(factor * value[master] for master, factor in drive.factors.items()) + drive.offset
            at = joint.idx_q
            q[at : at + joint.nq] = [np.cos(position), np.sin(position)] if joint.nq == 2 else position
    return q


def pinocchio_pose(robot: Robot, readings: np.ndarray) -> pin.SE3:
    """T_base_tip as Pinocchio sees it."""
    data = robot.tree.createData()
    pin.framesForwardKinematics(robot.tree, data, tree_configuration(robot, readings))
    base, tip = (data.oMf[robot.tree.getFrameId(link)] for link in (robot.base, robot.tip))
    return base.inverse() * tip


CHAINS = [
    (lambda: robots.random_robot(1, "RRRRRR"), "any axes"),
    (lambda: robots.random_robot(2, "PRPRC"), "prismatic and continuous"),
    (lambda: robots.random_robot(3, "RPC", aligned=True), "frame axes"),
    (lambda: parse_robot(COLUMN, "hand", "base"), "mimics"),
    (lambda: parse_robot(COLUMN, "hand", "stage"), "base inside the tree"),
    (lambda: parse_robot(COLUMN, "base", "hand"), "upwards"),
    (lambda: parse_robot(robots.random_chain(np.random.default_rng(7), "RPC"), "tip", "branch"), "up and down"),
    (lambda: load_robot(TIAGO, "head_2_link", "hand_thumb_flex_2_link"), "from a hand to the head"),
    (robots.arid, "arid"),
    (robots.ur10, "ur10"),
    (lambda: load_robot(FRANKA, "panda_hand"), "panda"),
    (lambda: load_robot(TIAGO, "hand_thumb_flex_2_link"), "tiago"),
]


@pytest.fixture(params=[c[0] for c in CHAINS], ids=[c[1] for c in CHAINS])
def robot(request: pytest.FixtureRequest) -> Robot:
    return request.param()  # type: ignore[no-any-return]


def test_chain_is_pinocchios(robot: Robot) -> None:
    q = robots.readings(robot, 10, np.random.default_rng(0))
    R, p = tip_frames(robot, q)
    positions = robot.positions(q)
    for k in range(len(q)):
        expected = pinocchio_pose(robot, q[k])
        np.testing.assert_allclose(R[k], expected.rotation, atol=1e-12)
        np.testing.assert_allclose(p[k], expected.translation, atol=1e-12)
        T = pin.SE3.Identity()
        for onward, joint, position in zip(robot.onward, robot.joints, positions[k], strict=False):
            slide = joint.kind == "prismatic"
            turn = np.eye(3) if slide else rotations(joint.along, np.array([position]))[0]
            T = T * onward * pin.SE3(turn, position * joint.along * slide)
        T = T * robot.onward[-1]
        assert (T.inverse() * expected).isIdentity(1e-12)


def test_chain_is_yourdfpys() -> None:
    """A second reader altogether, for axes in any direction with two fixed joints in between."""
    robot = robots.random_robot(5, "RPRCR")
    other = yourdfpy.URDF.load(io.BytesIO(robot.urdf), build_scene_graph=True, load_meshes=False)
    rng = np.random.default_rng(0)
    for q in robots.readings(robot, 5, rng):
        other.update_cfg(dict(zip(robot.names, q, strict=True)))
        R, p = tip_frames(robot, q[None])
        np.testing.assert_allclose(other.get_transform("tip", "base")[:3, :3], R[0], atol=1e-9)
        np.testing.assert_allclose(other.get_transform("tip", "base")[:3, 3], p[0], atol=1e-9)


def test_fixed_joints_between_are_kept_apart_from_the_joints_own_origin() -> None:
    robot = robots.random_robot(1, "RRR")
    tree = yourdfpy.URDF.load(io.BytesIO(robot.urdf), load_meshes=False)
    own = {name: joint.origin for name, joint in tree.joint_map.items()}
    np.testing.assert_allclose(robot.joint("joint_2").origin.homogeneous, own["joint_2"], atol=1e-12)
    between = own["bracket_fixed"] @ own["plate_fixed"]
    np.testing.assert_allclose(robot.joint("joint_2").before.homogeneous, between, atol=1e-12)
    assert robot.joint("joint_3").before.isIdentity()
    assert robot.tip_joint == "tip_fixed"
    np.testing.assert_allclose(robot.tip_origin.homogeneous, own["tip_fixed"], atol=1e-12)


def test_tip_on_a_moving_joint_has_no_joint_of_its_own() -> None:
    robot = parse_robot(robots.random_robot(1, "RR").urdf, "link_2")
    assert robot.tip_joint is None
    assert (robot.tip_before * robot.tip_origin).isIdentity()


def test_mimics_are_driven_by_their_last_master() -> None:
    """Lift = 0.1 motor + 0.05; lift_2 = -0.5 lift + 0.25 = -0.05 motor + 0.225: by hand."""
    robot = parse_robot(COLUMN, "hand", "base")
    assert robot.names == ("lift", "lift_2", "wrist")
    assert robot.readings == ("motor", "wrist")
    found = robot.positions(np.array([[2.0, 0.7], [-1.0, 0.0]]))
    np.testing.assert_allclose(found, [[0.25, 0.125, 0.7], [-0.05, 0.275, 0.0]], atol=1e-15)
    assert robot.limits[0].tolist() == [-3.0, 7.0]


def test_one_column_drives_a_master_and_its_mimic_on_the_same_chain() -> None:
    """The mimic is parsed before its master."""
    robot = parse_robot(COLUMN.replace(b'<mimic joint="motor" multiplier="0.1" offset="0.05"/>', b""), "hand", "base")
    assert robot.readings == ("lift", "wrist")
    np.testing.assert_allclose(robot.positions(np.array([[0.3, 0.0]])), [[0.3, 0.1, 0.0]])


def test_a_continuous_joint_has_no_limits() -> None:
    robot = parse_robot(COLUMN, "hand", "base")
    wrist = robot.columns[1]
    assert (robot.joint("wrist").kind, wrist) == ("revolute", ReadingColumn("wrist", "continuous", -np.inf, np.inf))
    assert robots.arid().columns[0].upper == pytest.approx(718 * 0.0254)


def extended_loads(robot: Robot, readings: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Pinocchio's generalised gravity on six extra joints at each joint of the chain, shape (joints, 6).

    They stand before a revolute joint and after a prismatic one; the whole tree hangs on them, branches included.
    """
    tree, q = robot.tree, tree_configuration(robot, readings)
    data = tree.createData()
    pin.framesForwardKinematics(tree, data, q)
    model, inside, value, wanted = pin.Model(), {0: 0}, [], {}
    model.gravity.linear = data.oMf[tree.getFrameId(robot.base)].rotation @ gravity
    extra = [pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ()]
    extra += [pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ()]
    for k in range(1, tree.njoints):
        name, at, parent = tree.names[k], tree.jointPlacements[k], inside[tree.parents[k]]
        steps = [(tree.joints[k], q[tree.joints[k].idx_q :][: tree.joints[k].nq], name)]
        if name in robot.names:
            six = [(joint, [0.0], f"{name}.{n}") for n, joint in enumerate(extra)]
            steps = six + steps if robot.joint(name).kind == "revolute" else steps + six
        for joint, position, label in steps:
            parent = model.addJoint(parent, joint.copy() if hasattr(joint, "copy") else joint, at, label)
            value += list(position)
            at = pin.SE3.Identity()
        model.appendBodyToJoint(parent, tree.inertias[k], pin.SE3.Identity())
        inside[k] = parent
    pull = -pin.computeGeneralizedGravity(model, model.createData(), np.array(value))
    for name in robot.names:
        wanted[name] = [pull[model.joints[model.getJointId(f"{name}.{n}")].idx_v] for n in range(6)]
    return np.array([wanted[name] for name in robot.names])


def test_gravity_loads_are_pinocchios_along_and_across_every_axis(robot: Robot) -> None:
    rng = np.random.default_rng(4)
    q, gravity = robots.readings(robot, 4, rng), rng.normal(0, 9.81, (4, 3))
    found = gravity_loads(robot, tuple(tree_frames(robot, q)), gravity)
    for k in range(len(q)):
        expected = extended_loads(robot, q[k], gravity[k])
        # on the way up a joint bears what Pinocchio, which starts at the root, hangs on none: test_loads.py
        down = [not joint.climbs for joint in robot.joints]
        np.testing.assert_allclose(found[k, down], expected[down], atol=1e-11 * max(1.0, np.abs(expected).max()))
    assert np.abs(found).max() > 1.0
    one = gravity_loads(robot, tuple(tree_frames(robot, q)), gravity[0])
    np.testing.assert_allclose(one[0], found[0])


def test_loads_and_frames_of_a_row_do_not_depend_by_a_digit_on_those_beside_it(robot: Robot) -> None:
    """Candidates share what rows feel, and a row that is predicted alone is predicted as in its table."""
    q, gravity = robots.readings(robot, 70, np.random.default_rng(5)), np.array([1.0, 2.0, -9.81])
    whole = gravity_loads(robot, tuple(tree_frames(robot, q)), gravity), *tip_frames(robot, q), *joint_frames(robot, q)
    for part in (slice(0, 1), slice(3, 10), slice(5, 70)):
        own = q[part]
        alone = (
            gravity_loads(robot, tuple(tree_frames(robot, own)), gravity),
            *tip_frames(robot, own),
            *joint_frames(robot, own),
        )
        for one, other in zip(alone, whole, strict=True):
            np.testing.assert_array_equal(one, other[part])


def test_a_side_branch_that_follows_the_chain_moves_as_mass() -> None:
    """The vane follows the motor, whose column is measured: the wrist's load changes with it, as it should."""
    robot = parse_robot(COLUMN, "hand", "base")
    q = np.array([[0.0, 0.4], [0.8, 0.4]])
    load = gravity_loads(robot, tuple(tree_frames(robot, q)), np.array([0.0, 0.0, -9.81]))[
        :, robot.names.index("wrist"), 3:
    ]
    assert np.abs(load[0] - load[1]).max() > 1.0
    assert "flap" not in robot.names


def test_mass_beyond_counts_branches_and_fixed_links() -> None:
    robot = parse_robot(COLUMN, "hand", "base")
    np.testing.assert_allclose(robot.mass_beyond, [3 + 2 + 1.5 + 4, 2 + 1.5 + 4, 1.5 + 4])


def test_a_robot_without_masses_bears_no_load() -> None:
    robot = parse_robot(b"".join(part.split(b"</inertial>")[-1] for part in COLUMN.split(b"<inertial>")), "hand")
    assert not robot.mass_beyond.any()
    assert not gravity_loads(robot, tuple(tree_frames(robot, np.ones((2, 2)))), np.array([0, 0, -9.81])).any()


def test_joint_frames_do_not_turn_with_a_revolute_joint_but_travel_with_a_carriage() -> None:
    robot = robots.arid()
    q = np.array([[0.0, 0.5, 2.0, -1.0], [3.0, 1.5, 2.0, -1.0]])
    axes, origins = joint_frames(robot, q)
    np.testing.assert_allclose(axes[0, 1], axes[1, 1], atol=1e-15)
    np.testing.assert_allclose(origins[1, 0] - origins[0, 0], 3.0 * robot.joint("joint_1").axis, atol=1e-15)
    assert np.abs(axes[0, 2] - axes[1, 2]).max() > 0.1


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("k", [0, 1, 2])
def test_transverse_axes_of_a_frame_axis_are_the_other_two_in_order(k: int, sign: int) -> None:
    e1, e2 = transverse(sign * np.eye(3)[k])
    others = [i for i in range(3) if i != k]
    assert np.array_equal(e1, np.eye(3)[others[0]])
    assert np.array_equal(e2, np.eye(3)[others[1]])


def test_transverse_axes_of_any_axis_are_orthonormal_and_start_from_the_least_aligned() -> None:
    rng = np.random.default_rng(0)
    for axis in rng.normal(size=(50, 3)):
        axis /= np.linalg.norm(axis)
        e1, e2 = transverse(axis)
        np.testing.assert_allclose(np.array([e1, e2, axis]) @ np.array([e1, e2, axis]).T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(np.cross(axis, e1), e2, atol=1e-14)
        assert np.argmax(np.abs(e1)) == np.argmin(np.abs(axis))


def broken(change: str, to: str, urdf: bytes = COLUMN) -> bytes:
    text = urdf.decode()
    assert change in text
    return text.replace(change, to, 1).encode()


RING = (
    '<link name="ring_1"/><link name="ring_2"/>'
    '<joint name="back" type="fixed"><parent link="ring_1"/><child link="ring_2"/></joint>'
    '<joint name="round" type="fixed"><parent link="ring_2"/><child link="ring_1"/></joint></robot>'
)

ERRORS = [
    (COLUMN[:-10], "hand", None, "not well-formed"),
    (b"", "hand", None, "not well-formed"),
    (b"\xff\xfe\x00garbage", "hand", None, "not well-formed"),
    (b"not xml at all", "hand", None, "not well-formed"),
    (broken("<robot ", '<!DOCTYPE robot SYSTEM "file:///etc/passwd">\n<robot '), "hand", None, "DOCTYPE"),
    (
        broken("<robot ", '<!DOCTYPE r [<!ENTITY a "b"><!ENTITY c "&a;&a;&a;">]>\n<robot '),
        "hand",
        None,
        "DOCTYPE",
    ),
    (broken('<?xml version="1.0"?>', '<?xml version="1.0" encoding="nonsense"?>'), "hand", None, "robot.urdf"),
    (broken('name="column"', 'name="\u00e4"').decode().encode("latin-1"), "hand", None, "not well-formed"),
    (b"<sdf><model/></sdf>", "hand", None, "is SDF, Gazebo's format, .*Name the URDF"),
    (b"<html><body/></html>", "hand", None, "<html>, not <robot>"),
    (broken("</robot>", '<x:macro xmlns:x="http://www.ros.org/wiki/xacro"/></robot>'), "hand", None, "run xacro first"),
    (COLUMN, "hnd", None, "did you mean 'hand'"),
    (COLUMN, "hand", "bse", "did you mean 'base'"),
    (COLUMN, "base", "root", "no joint moves between 'root' and 'base': nothing to calibrate; set `robot.tip`"),
    (COLUMN, "base", None, "no joint moves .*: nothing to calibrate; set `robot.tip`"),
    (broken('<parent link="top"/>', '<parent link="tup"/>'), "hand", None, "'wrist': its parent link 'tup'"),
    (broken('<child link="hand"/>', ""), "hand", None, "'wrist': its child link"),
    (broken('<child link="spindle"/>', '<child link="hand"/>'), "hand", None, "'hand' has two parents: .*'wrist'"),
    (broken('<link name="spindle"/>', '<link name="spindle"/><link name="hand"/>'), "hand", None,
     r"line \d+: link 'hand' is there twice"),
    (broken('<link name="spindle"/>', '<link name="spindle"/><link/>'), "hand", None, r"line \d+: a link has no name"),
    (broken("</robot>", RING), "hand", None, "'ring_1', 'ring_2' form a loop.*'round', 'back'"),
    (broken("</robot>", '<link name="lost"/></robot>'), "hand", None, "'root', 'lost' have no parent"),
    (broken('<parent link="base"/><child link="stage"/>', '<parent link="hand"/><child link="stage"/>'), "hand", None,
     "'base'|'stage'.*form a loop.*'lift'"),
    (broken('name="wrist" type="continuous"', 'name="wrist" type="floating"'), "hand", None, "'wrist'.*'floating'"),
    (broken('name="wrist" type="continuous"', 'name="wrist"'), "hand", None, "'wrist'"),
    (broken('name="wrist" type', 'name="lift" type'), "hand", None, "'lift' is there twice"),
    (broken('name="wrist" type', "type"), "hand", None, "a joint has no name"),
    (broken('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>'), "hand", None, "'wrist': its axis is zero"),
    (broken('<axis xyz="1 0 0"/>', '<axis xyz="1 0"/>'), "hand", None, r"line \d+: <axis xyz='1 0'>"),
    (broken('xyz="0 0.1 0.3"', 'xyz="0 nan 0.3"'), "hand", None, "0 nan 0.3"),
    (broken('xyz="0 0.1 0.3"', 'xyz="0 0,1 0.3"'), "hand", None, "0 0,1 0.3"),
    (broken('rpy="0 0.2 0"', 'rpy="0 1e999 0"'), "hand", None, "1e999"),
    (broken('rpy="0 0.2 0"', 'quat_xyzw="0 0.1 0 0.995"'), "hand", None, r"line \d+: .*quat_xyzw.*as rpy"),
    (broken('lower="-3"', 'lower="low"'), "hand", None, "'low'"),
    (broken('<mimic joint="motor"', '<mimic joint="moter"'), "hand", None, "did you mean 'motor'"),
    (broken('<axis xyz="0 0 1"/><limit lower="-3"', '<mimic joint="lift"/><axis xyz="0 0 1"/><limit lower="-3"'),
     "hand", None, "mimics itself"),
    (broken('<mimic joint="motor"', '<mimic joint="mount"'), "hand", None, "'mount', which does not move"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("urdf", "tip", "base", "says"), ERRORS, ids=[e[3][:30] + str(k) for k, e in enumerate(ERRORS)]
)
def test_what_is_wrong_with_a_urdf_is_named(urdf: bytes, tip: str, base: str | None, says: str) -> None:
    with pytest.raises(RobotError, match=says) as caught:
        parse_robot(urdf, tip, base, Path("robot.urdf"))
    assert "robot.urdf" in str(caught.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"nowhere\.urdf.*robot\.urdf"):
        load_robot(tmp_path / "nowhere.urdf", "tip")
    with pytest.raises(RobotError, match=str(tmp_path)):
        load_robot(tmp_path, "tip")


def test_a_joint_that_is_not_there_is_named() -> None:
    with pytest.raises(RobotError, match="did you mean 'joint_2'"):
        robots.arid().joint("joint_22")


def test_a_joint_may_bear_the_name_of_the_base() -> None:
    plain = robots.arid().urdf
    twin = plain.replace(b'"joint_1"', b'"base_link_"').replace(b"base_link", b"arm").replace(b'"arm_"', b'"arm"')
    both = (parse_robot(plain, "flange", "base_link"), parse_robot(twin, "flange", "arm"))
    assert both[1].names[0] == both[1].base == "arm"
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 4))
    for one, other in zip(*(joint_frames(robot, q) for robot in both), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-15)
