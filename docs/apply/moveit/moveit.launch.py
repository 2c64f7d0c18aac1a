"""MoveIt 2 with a calibrated URDF: `ros2 launch moveit.launch.py urdf:=/path/to/results/calibrated.urdf`."""

from pathlib import Path

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = Path(__file__).resolve().parent


def parameters(urdf: Path) -> dict:
    """All parameters of move_group: the description, and the files beside this one."""

    def read(name: str) -> dict:
        return yaml.safe_load((HERE / name).read_text())

    return {
        "robot_description": urdf.read_text(),
        "robot_description_semantic": (HERE / "ur10.srdf").read_text(),
        "robot_description_kinematics": read("kinematics.yaml"),
        "robot_description_planning": read("joint_limits.yaml"),
        "planning_pipelines": ["ompl"],
        "ompl": {"planning_plugins": ["ompl_interface/OMPLPlanner"]},
        **read("moveit_controllers.yaml"),
    }


def nodes(context) -> list:
    """The nodes, once the launch argument is known."""
    given = parameters(Path(LaunchConfiguration("urdf").perform(context)))
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            parameters=[{"robot_description": given["robot_description"]}],
        ),
        Node(package="moveit_ros_move_group", executable="move_group", output="screen", parameters=[given]),
    ]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    urdf = DeclareLaunchArgument("urdf", description="calibrated.urdf of a result folder; the nominal one to undo")
    return LaunchDescription([urdf, OpaqueFunction(function=nodes)])
