"""The example for MoveIt 2, without ROS: every name in it is one of the URDF's, and its launch starts what it says."""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path
from typing import Any

import pytest
import yaml
from lxml import etree
from repository import ROOT

EXAMPLE = ROOT / "docs" / "apply" / "moveit"
URDF = ROOT / "urdf" / "ur10.urdf"


def names(tag: str, file: Path = URDF) -> set[str]:
    """Names of all elements of a sort."""
    return {str(e.get("name")) for e in etree.parse(file).getroot().iter(tag)}


def moving() -> set[str]:
    """Names of the joints that move."""
    return {
        str(e.get("name"))
        for e in etree.parse(URDF).getroot().iter("joint")
        if e.get("type") in ("revolute", "continuous")
    }


def read(name: str) -> Any:
    return yaml.safe_load((EXAMPLE / name).read_text())


def test_the_planning_group_is_a_chain_of_the_urdf() -> None:
    srdf = etree.parse(EXAMPLE / "ur10.srdf").getroot()
    assert srdf.get("name") == etree.parse(URDF).getroot().get("name")
    for chain in srdf.iter("chain"):
        assert {chain.get("base_link"), chain.get("tip_link")} <= names("link")
    for state in srdf.iter("group_state"):
        assert state.get("group") in {group.get("name") for group in srdf.iter("group")}
        assert {joint.get("name") for joint in state.iter("joint")} == moving()


def test_solver_limits_and_controller_are_for_its_groups_and_joints() -> None:
    groups = names("group", EXAMPLE / "ur10.srdf")
    assert set(read("kinematics.yaml")) == groups
    assert "KDL" in read("kinematics.yaml")["manipulator"]["kinematics_solver"]
    assert set(read("joint_limits.yaml")["joint_limits"]) == moving()
    manager = read("moveit_controllers.yaml")["moveit_simple_controller_manager"]
    (controller,) = manager["controller_names"]
    assert set(manager[controller]["joints"]) == moving()


def test_speeds_are_within_those_of_the_urdf() -> None:
    limits = {
        str(joint.get("name")): float(limit.get("velocity"))
        for joint in etree.parse(URDF).getroot().iter("joint")
        if (limit := joint.find("limit")) is not None
    }
    for name, own in read("joint_limits.yaml")["joint_limits"].items():
        assert own["max_velocity"] <= limits[name] + 1e-4


def test_the_launch_gives_the_named_urdf_to_both_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """With stand-ins for ROS: what each is called with is kept."""

    class Kept:
        def __init__(self, *args: Any, **keys: Any) -> None:
            self.args, self.keys = args, keys

        def perform(self, context: dict[str, str]) -> str:
            return context[self.args[0]]

    for name in ("launch", "launch.actions", "launch.substitutions", "launch_ros", "launch_ros.actions"):
        module = types.ModuleType(name)
        for what in ("LaunchDescription", "DeclareLaunchArgument", "OpaqueFunction", "LaunchConfiguration", "Node"):
            setattr(module, what, Kept)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("moveit_launch", EXAMPLE / "moveit.launch.py")
    assert spec is not None
    assert spec.loader is not None
    launch = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(launch)
    declared, starts = launch.generate_launch_description().args[0]
    assert declared.args == ("urdf",)
    nodes = starts.keys["function"]({"urdf": str(URDF)})
    assert [node.keys["executable"] for node in nodes] == ["robot_state_publisher", "move_group"]
    for node in nodes:
        (given,) = node.keys["parameters"]
        assert given["robot_description"] == URDF.read_text()
    assert nodes[1].keys["parameters"][0]["moveit_controller_manager"].startswith("moveit_simple")
