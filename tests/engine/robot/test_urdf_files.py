"""The shipped robots are what their sources say, and every reader of URDF sees the same machine."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from lxml import etree
from repository import ROOT
from yourdfpy import URDF

FOLDER = ROOT / "urdf"
ARID, UR10 = FOLDER / "arid.urdf", FOLDER / "ur10.urdf"
TIPS = {ARID: "flange", UR10: "tool0"}
# the wheels of Pinocchio's family share one prefix
EXAMPLE_UR10 = Path(pin.__file__).parents[4] / "share/example-robot-data/robots/ur_description/urdf/ur10_robot.urdf"
both_robots = pytest.mark.parametrize("path", [ARID, UR10], ids=lambda path: path.stem)

# Universal Robots, "DH Parameters for calculations of kinematics and dynamics", UR10: one row per joint
UR10_D = [0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922]
UR10_A = [0.0, -0.612, -0.5723, 0.0, 0.0, 0.0]
UR10_ALPHA = [np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0]
UR10_MASS = [7.1, 12.7, 4.27, 2.0, 2.0, 0.365]
UR10_COM = [[0.021, 0, 0.027], [0.38, 0, 0.158], [0.24, 0, 0.068], [0, 0.007, 0.018], [0, 0.007, 0.018], [0, 0, -0.026]]


def placement(model: pin.Model, tip: str, q: np.ndarray) -> np.ndarray:
    """T_base_tip, shape (4, 4), by Pinocchio."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    base = data.oMf[model.getFrameId("base_link")]
    return (base.inverse() * data.oMf[model.getFrameId(tip)]).homogeneous


def configurations(model: pin.Model, n: int = 50) -> np.ndarray:
    """Joint values inside the limits, shape (n, nq)."""
    return np.random.default_rng(1992).uniform(model.lowerPositionLimit, model.upperPositionLimit, (n, model.nq))


def ur10_by_table(q: np.ndarray) -> list[np.ndarray]:
    """T_base_i of each frame of the Denavit-Hartenberg table, in ROS's base frame (turned by 180 deg about z)."""
    T, frames = np.diag([-1.0, -1.0, 1.0, 1.0]), []
    for theta, d, a, alpha in zip(q, UR10_D, UR10_A, UR10_ALPHA, strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        frames.append(T)
    return frames


@both_robots
def test_check_urdf_accepts_the_file(path):
    program = shutil.which("check_urdf", path=Path(sys.executable).parent) or shutil.which("check_urdf")
    if program is None:
        pytest.skip("check_urdf is not installed")
    done = subprocess.run([program, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Successfully Parsed XML" in done.stdout and "root Link: base_link" in done.stdout


@both_robots
def test_pinocchio_and_yourdfpy_agree_on_every_link(path):
    model, other = pin.buildModelFromUrdf(str(path)), URDF.load(path, load_meshes=False)
    assert list(model.names)[1:] == other.actuated_joint_names
    for q in configurations(model):
        other.update_cfg(q)
        for link in other.link_map:
            expected = other.get_transform(link, "base_link")
            np.testing.assert_allclose(
                placement(model, link, q), expected, rtol=0, atol=1e-13 * max(1, np.abs(q).max())
            )


@both_robots
def test_drawing_needs_no_mesh_files_and_names_only_defined_materials(path):
    robot = etree.parse(path).getroot()
    assert not robot.findall(".//mesh")
    defined = {material.get("name") for material in robot.findall("material")}
    assert {material.get("name") for material in robot.findall(".//visual/material")} == defined
    assert all(link.find("visual") is not None for link in robot.findall("link") if link.get("name") != "tool0")
    shapes = pin.buildGeomFromUrdf(pin.buildModelFromUrdf(str(path)), str(path), pin.GeometryType.VISUAL)
    assert shapes.ngeoms == len(robot.findall(".//visual"))


@both_robots
def test_inertias_are_physical(path):
    model = pin.buildModelFromUrdf(str(path))
    for body in list(model.inertias)[1:]:
        moments = np.linalg.eigvalsh(body.inertia)
        assert body.mass > 0 and moments[0] > 0
        assert moments[2] < moments[0] + moments[1]


@both_robots
def test_motors_can_carry_the_arm_anywhere(path):
    model = pin.buildModelFromUrdf(str(path))
    if path == ARID:
        model.gravity.linear = np.array([0.0, 9.81, 0.0])
    data = model.createData()
    load = np.array([pin.computeGeneralizedGravity(model, data, q) for q in configurations(model, 500)])
    assert np.all(np.abs(load) < model.effortLimit) and np.all(model.velocityLimit > 0)


def test_arid_joints_and_links_are_named_as_documented():
    model = pin.buildModelFromUrdf(str(ARID))
    assert list(model.names)[1:] == ["joint_1", "joint_2", "joint_3", "joint_4"]
    assert [joint.shortname() for joint in model.joints][1:] == ["JointModelPZ"] + 3 * ["JointModelRZ"]
    assert model.frames[model.getFrameId("flange_fixed")].type == pin.FrameType.FIXED_JOINT
    assert model.frames[model.getFrameId("flange_fixed")].parentJoint == model.getJointId("joint_4")


def test_arid_limits_are_those_of_table_3_1():
    model = pin.buildModelFromUrdf(str(ARID))
    inch = 0.0254
    lower, upper = [0 * inch, *np.radians([4, 102, -117])], [718 * inch, *np.radians([112, 148, -16])]
    np.testing.assert_allclose(model.lowerPositionLimit, lower, rtol=0, atol=1e-15)
    np.testing.assert_allclose(model.upperPositionLimit, upper, rtol=0, atol=1e-14)


def test_arid_kinematics_are_equation_3_10_with_perfect_links():
    model = pin.buildModelFromUrdf(str(ARID))
    a1, a2, a3 = 0.30, 1.98, 1.98
    for q in configurations(model):
        d1, f2, f3, phi = q[0], q[1], q[1] + q[2], q[1] + q[2] + q[3]
        x, y = a1 + a2 * np.cos(f2) + a3 * np.cos(f3), a2 * np.sin(f2) + a3 * np.sin(f3)
        c, s = np.cos(phi), np.sin(phi)
        expected = [[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, d1], [0, 0, 0, 1]]
        np.testing.assert_allclose(placement(model, "flange", q), expected, rtol=0, atol=1e-14 * (1 + d1))


def test_arid_gravity_loads_all_three_revolute_joints_and_not_the_rail():
    model = pin.buildModelFromUrdf(str(ARID))
    model.gravity.linear = np.array([0.0, 9.81, 0.0])
    data = model.createData()
    load = np.array([pin.computeGeneralizedGravity(model, data, q) for q in configurations(model, 500)])
    assert np.abs(load[:, 0]).max() < 1e-9
    heaviest = np.abs(load[:, 1:]).max(axis=0)
    assert heaviest[0] > heaviest[1] > heaviest[2] > 1.0
    assert np.ptp(load[:, 1:], axis=0).min() > 1.0


def test_arid_is_65_by_13_foot():
    foot, model = 0.3048, pin.buildModelFromUrdf(str(ARID))
    rail = max(float(box.get("size").split()[2]) for box in etree.parse(ARID).iterfind("link[@name='base_link']//box"))
    links = [
        np.linalg.norm(model.jointPlacements[model.getJointId(joint)].translation) for joint in ("joint_3", "joint_4")
    ]
    assert rail == pytest.approx(65 * foot, abs=1e-9)
    assert sum(links) == pytest.approx(13 * foot, abs=0.01)


def test_ur10_is_the_published_table_turned_by_180_degrees():
    model = pin.buildModelFromUrdf(str(UR10))
    for q in configurations(model):  # the file's pi/2 has twelve digits, hence 1e-10
        np.testing.assert_allclose(placement(model, "tool0", q), ur10_by_table(q)[-1], rtol=0, atol=1e-10)


@pytest.mark.skipif(not EXAMPLE_UR10.exists(), reason="example-robot-data is not installed")
def test_ur10_equals_the_one_of_example_robot_data():
    model, example = pin.buildModelFromUrdf(str(UR10)), pin.buildModelFromUrdf(str(EXAMPLE_UR10))
    assert list(model.names) == list(example.names)
    for q in configurations(model):
        np.testing.assert_array_equal(placement(model, "tool0", q), placement(example, "tool0", q))


def test_ur10_joints_turn_360_degrees_either_way():
    model = pin.buildModelFromUrdf(str(UR10))
    np.testing.assert_allclose(model.upperPositionLimit, 6 * [2 * np.pi], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(model.lowerPositionLimit, -model.upperPositionLimit)


def test_ur10_gravity_torques_are_those_of_the_published_masses():
    def energy(q: np.ndarray) -> float:
        frames = ur10_by_table(q)
        heights = [T[2] @ [*com, 1.0] for T, com in zip(frames, UR10_COM, strict=True)]
        return 9.81 * float(np.dot(UR10_MASS, heights))

    model = pin.buildModelFromUrdf(str(UR10))
    data = model.createData()
    for q in configurations(model, 10):
        slope = [(energy(q + step) - energy(q - step)) / 2e-5 for step in 1e-5 * np.eye(6)]
        np.testing.assert_allclose(pin.computeGeneralizedGravity(model, data, q), slope, rtol=0, atol=1e-7)
