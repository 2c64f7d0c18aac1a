"""A template, not run on hardware: any arm of ROS 2, led by `aridcal guide`: MoveIt 2 moves it, a tracker's topic measures.

    python ros2.py campaign.yaml --ros-args -p group:=manipulator -p tracker:=/tracker/pose

Joints come from `/joint_states`, the target from a `geometry_msgs/PoseStamped`; both are taken after the arm has stood still.
"""

from __future__ import annotations

import sys
import time

import aridcal

SETTLE = 1.5  # [s]


def main(campaign: str) -> None:
    """Move, wait, measure, record; until it is enough."""
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from moveit.core.robot_state import RobotState
    from moveit.planning import MoveItPy
    from sensor_msgs.msg import JointState

    rclpy.init(args=sys.argv)
    node = rclpy.create_node("aridcal_guide")
    group = node.declare_parameter("group", "manipulator").value
    topic = node.declare_parameter("tracker", "/tracker/pose").value
    latest: dict[type, object] = {}
    node.create_subscription(JointState, "/joint_states", lambda m: latest.__setitem__(JointState, m), 10)
    node.create_subscription(PoseStamped, topic, lambda m: latest.__setitem__(PoseStamped, m), 10)
    moveit = MoveItPy(node_name="aridcal_guide_moveit")
    arm = moveit.get_planning_component(group)

    def measured() -> dict[str, float]:
        """Joints and target, both received after now."""
        latest.clear()
        while len(latest) < 2:
            rclpy.spin_once(node)
        joints, pose = latest[JointState], latest[PoseStamped].pose
        row = dict(zip(joints.name, joints.position, strict=True))
        p, q = pose.position, pose.orientation
        return row | {"x": p.x, "y": p.y, "z": p.z, "qx": q.x, "qy": q.y, "qz": q.z, "qw": q.w}

    guided = aridcal.guide(campaign, tolerance="0.2mm")
    for pose in guided:
        arm.set_start_state_to_current_state()
        state = RobotState(moveit.get_robot_model())
        state.joint_positions = dict(pose.joints)
        arm.set_goal_state(robot_state=state)
        plan = arm.plan()
        if not plan:
            pose.reject()  # MoveIt sees something in the way
            continue
        moveit.execute(plan.trajectory, controllers=[])
        time.sleep(SETTLE)
        for alarm in pose.record(measured()):
            node.get_logger().warning(f"{alarm.what}: {alarm.words}. Do: {alarm.do}")
    aridcal.calibrate(guided.campaign).save("results")


if __name__ == "__main__":
    main(sys.argv[1])
