"""Files for ROS 2, without ROS: the node runs on messages as rosbags defines them, the launch starts what it says."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import types
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import compiled
import numpy as np
import pinocchio as pin
import pytest
import robots
import yaml
from exported import saved_from, written
from lxml import etree

from aridcal import export
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants, urdf_of
from aridcal.engine.model.model import Model
from aridcal.jobs.calibrate.saved_model import SavedModel

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"


@dataclass(frozen=True)
class Exported:
    """A calibration, and its folder for ROS 2."""

    saved: SavedModel
    folder: Path


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """A UR10 with sag, backlash and a drift with the temperature."""
    home, robot, rng = tmp_path_factory.mktemp("ros2"), robots.ur10(), np.random.default_rng(2)
    effects = (
        Coefficient("elbow_joint", "axis", Basis("linear", ("elbow_joint.gravity_torque",), (0.0,))),
        Coefficient("shoulder_pan_joint", "axis", Basis("linear", ("shoulder_pan_joint_direction",), (0.0,))),
        Coefficient("wrist_1_joint", "pitch", Basis("linear", ("temperature",), (20.0,))),
    )
    coefficients = (*constants(robot, "full")[:20], *effects)
    world, tip = robots.random_placement(rng), robots.random_placement(rng, 0.3)
    theta = np.r_[rng.normal(0.0, 1e-3, 20), 1e-5, 2e-4, 1e-4]
    saved = saved_from(Model(robot, coefficients, ((None, world),), ((None, tip),)), theta)
    folder = written(saved, home / "results")
    (folder / "joint_offsets.yaml").write_text("joint_offsets: {elbow_joint: 0.001}\n")
    (folder / "kinematics.yaml").write_text("kinematics: {}\n")
    assert export.main([str(folder), "--ros2", str(home / "my_arm")]) == 0
    return Exported(saved, home / "my_arm")


class FakeNode:
    """As much of rclpy's node as ours asks for."""

    parameters: ClassVar[dict[str, Any]] = {}

    def __init__(self, name: str, **options: object) -> None:
        self.name, self.sent, self.said = name, [], []
        assert options == {"automatically_declare_parameters_from_overrides": True}

    def get_parameter(self, name: str) -> types.SimpleNamespace:
        return types.SimpleNamespace(value=self.parameters[name])

    def has_parameter(self, name: str) -> bool:
        return name in self.parameters

    def create_publisher(self, kind: type, topic: str, depth: int) -> types.SimpleNamespace:
        assert topic == "joint_trajectory" and depth
        return types.SimpleNamespace(publish=self.sent.append)

    def create_subscription(self, kind: type, topic: str, callback: object, depth: int) -> None:
        assert topic == "wanted_trajectory" and callable(callback) and depth

    def get_logger(self) -> types.SimpleNamespace:
        return types.SimpleNamespace(error=self.said.append, warning=self.said.append)


@pytest.fixture
def store() -> Any:
    """Definitions of messages."""
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed: no definitions of messages")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


@pytest.fixture
def node(exported: Exported, store: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The node, with a ROS that is not there."""
    library = exported.folder / "libmy_arm.so"
    if not library.exists():
        options = ("-O1", "-shared", "-fPIC", str(exported.folder / "my_arm.c"), "-lm", "-o", str(library))
        subprocess.run([compiled.compiler(), *options], check=True)
    parts = {
        "rclpy": {},
        "rclpy.node": {"Node": FakeNode},
        "trajectory_msgs": {},
        "trajectory_msgs.msg": {"JointTrajectory": store.types[TRAJECTORY]},
    }
    for name, holds in parts.items():
        module = types.ModuleType(name)
        vars(module).update(holds)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("correct_trajectory", exported.folder / "correct_trajectory.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    FakeNode.parameters = {"library": str(library), "name": "my_arm", "conditions.temperature": 25.0}
    yield module.CorrectTrajectory()


def trajectory(store: Any, names: list[str], rows: np.ndarray) -> Any:
    """A message of rosbags."""
    kinds = store.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    points = [
        kinds["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=row.copy(),
            velocities=np.full(len(row), 0.5),
            accelerations=np.zeros(0),
            effort=np.zeros(0),
            time_from_start=kinds["builtin_interfaces/msg/Duration"](sec=k, nanosec=0),
        )
        for k, row in enumerate(rows)
    ]
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")
    return kinds[TRAJECTORY](header=header, joint_names=names, points=points)


WANTED = np.array([0.1, -1.0, 1.0, 0.3, 0.8, 0.2]) + 0.02 * np.arange(5)[:, None] * [1, -1, 1, -1, 1, 0]


def test_the_node_sends_joints_that_bring_the_real_target_where_the_nominal_arm_would_have_it(
    exported: Exported, node: Any, store: Any
) -> None:
    saved, order = exported.saved, [3, 0, 5, 1, 4, 2, 6]
    robot = saved.final.model.robot
    names = [*robot.readings, "gripper"]
    rows = np.column_stack([WANTED, np.full(5, 0.04)])[:, order]
    message = trajectory(store, [names[k] for k in order], rows)
    node.correct(message)
    (sent,) = node.sent
    read = store.deserialize_cdr(store.serialize_cdr(sent, TRAJECTORY), TRAJECTORY)
    assert read.joint_names == message.joint_names and read.header == message.header
    for k, point in enumerate(read.points):
        assert point.time_from_start == message.points[k].time_from_start
        np.testing.assert_array_equal(point.velocities, message.points[k].velocities)
        np.testing.assert_array_equal(message.points[k].positions, rows[k])  # what came in is left as it was
    q = np.array([point.positions for point in read.points])[:, np.argsort(order)]
    np.testing.assert_array_equal(q[:, 6], 0.04)
    came_from = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    columns = {"shoulder_pan_joint_direction": came_from, "temperature": np.full(5, 25.0)}
    R, p = saved.expected.poses(q[:, :6], columns)
    world, tip = saved.expected.model.frames(saved.expected.theta)
    bare = Model(robot, (), world, tip)
    R_meant, p_meant = bare.poses(np.zeros(0), bare.rows(WANTED))
    np.testing.assert_allclose(p, p_meant, rtol=0, atol=1e-9)
    np.testing.assert_allclose(R, R_meant, rtol=0, atol=1e-9)
    assert np.abs(q[:, :6] - WANTED).max() > 1e-4


def test_what_cannot_be_corrected_is_not_sent(exported: Exported, node: Any, store: Any) -> None:
    names = list(exported.saved.final.model.robot.readings)
    node.correct(trajectory(store, names[:-1], WANTED[:, :-1]))
    node.correct(trajectory(store, names, np.where(np.arange(6) == 2, np.nan, WANTED)))
    stretched = WANTED.copy()
    stretched[3] = [0.0, -1.5, 0.0, 0.0, 0.0, 0.0]  # the real arm would have to be longer
    node.correct(trajectory(store, names, stretched))
    del FakeNode.parameters["conditions.temperature"]
    node.correct(trajectory(store, names, WANTED))
    assert not node.sent
    for words, said in zip(
        ("no joint wrist_3", "a number is none", "point 3", "condition temperature"), node.said, strict=True
    ):
        assert "not sent" in said and words in said


def test_the_launch_publishes_calibrated_urdf_and_frames_of_the_measurements(
    exported: Exported, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[dict[str, Any]] = []
    parts = {"launch": {"LaunchDescription": list}, "launch_ros": {}, "launch_ros.actions": {"Node": lambda **of: of}}
    for name, holds in parts.items():
        module = types.ModuleType(name)
        vars(module).update(holds)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("launch_file", exported.folder / "calibrated.launch.py")
    assert spec is not None and spec.loader is not None
    launch = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(launch)
    started = launch.generate_launch_description()
    geometric = exported.saved.geometric
    (parameters,) = started[0]["parameters"]
    assert parameters["robot_description"].encode() == urdf_of(geometric.model, geometric.theta)
    world, tip = geometric.model.frames(geometric.theta)
    ends = {("calibration_world", "base_link"): world[0][1], ("tool0", "calibration_target"): tip[0][1]}
    for each in started[1:]:
        of = dict(zip(each["arguments"][::2], each["arguments"][1::2], strict=True))
        numbers = np.array([float(of[f"--{key}"]) for key in ("x", "y", "z", "qx", "qy", "qz", "qw")])
        T = ends.pop((of["--frame-id"], of["--child-frame-id"]))
        np.testing.assert_allclose(pin.XYZQUATToSE3(numbers).homogeneous, T.homogeneous, rtol=0, atol=1e-12)
    assert not ends


def test_transmissions_have_the_offsets_of_joints(exported: Exported) -> None:
    root = etree.parse(exported.folder / "joint_offsets.ros2_control.xml").getroot()
    (joint,) = root.iter("joint")
    assert joint.get("name") == "elbow_joint" and float(joint.findtext("offset", "")) == 0.001
    assert (exported.folder / "kinematics.yaml").read_text() == "kinematics: {}\n"


def test_a_world_has_the_root_of_the_urdf_as_its_child_and_none_that_joints_move(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(1)
    text = robots.random_chain(rng, "RR").replace(
        b'<link name="base"/>',
        b'<link name="floor"/><link name="base"/><joint name="stand" type="fixed"><parent link="floor"/><child link="base"/>'
        b'<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/></joint>',
        1,
    )
    for base in ("base", "link_1"):
        robot = robots.parse_robot(text, "tip", base)
        world = robots.random_placement(rng)
        saved = replace(saved_from(Model(robot, (), ((None, world),)), np.zeros(0)))
        folder = tmp_path / base
        assert export.main([str(written(saved, folder)), "--ros2", str(folder / "out")]) == 0
        transforms = yaml.safe_load((folder / "out" / "static_transforms.yaml").read_text())["transforms"]
        if base == "link_1":
            assert [each["child"] for each in transforms] == ["calibration_target"]
            assert "joints move 'link_1'" in capsys.readouterr().out
        else:
            first = transforms[0]
            assert first["child"] == "floor"
            T = pin.XYZQUATToSE3(np.r_[first["xyz"], first["quaternion"]])
            stand = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, 2.0, 3.0]))
            np.testing.assert_allclose((T * stand).homogeneous, world.homogeneous, rtol=0, atol=1e-12)


def test_files_of_somebody_else_stay(exported: Exported, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = exported.folder.parent / "results"
    (tmp_path / "calibrated.urdf").write_text("<robot/>")
    assert export.main([str(folder), "--ros2", str(tmp_path)]) == 2
    assert "of its own" in capsys.readouterr().err and (tmp_path / "calibrated.urdf").read_text() == "<robot/>"
    assert export.main([str(folder), "--ros2", str(exported.folder)]) == 0  # its own files are written anew
