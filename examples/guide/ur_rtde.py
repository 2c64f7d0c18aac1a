"""A template, not run on hardware: a UR arm over RTDE, led by `aridcal guide`, with a tracker of yours.

    python ur_rtde.py campaign.yaml 192.168.0.10

The campaign's joints are the URDF's (shoulder_pan_joint, …), in rad; its kind is `pose` or `position`.
"""

from __future__ import annotations

import sys
import time

import aridcal

SPEED, ACCELERATION = 0.3, 0.3  # [rad/s], [rad/s²]
SETTLE = 1.5  # [s] until arm and reflector stand still


def tracker() -> dict[str, float]:
    """One measurement in the campaign's units; replace it by your instrument's own."""
    raise NotImplementedError("x y z, and qx qy qz qw for `kind: pose`")


def main(campaign: str, host: str) -> None:
    """Move, wait, measure, record; until it is enough."""
    from rtde_control import RTDEControlInterface
    from rtde_receive import RTDEReceiveInterface

    control, receive = RTDEControlInterface(host), RTDEReceiveInterface(host)
    guided = aridcal.guide(campaign, tolerance="0.2mm")
    for pose in guided:
        print(pose.why, dict(pose.joints))
        if input("Enter: go there; r: another pose; q: end ").strip() == "r":
            pose.reject()
            continue
        control.moveJ(list(pose.joints.values()), SPEED, ACCELERATION)
        time.sleep(SETTLE)
        joints = dict(zip(pose.joints, receive.getActualQ(), strict=True))  # readings of the moment
        for alarm in pose.record({**joints, **tracker()}):
            print(alarm.what.upper(), alarm.words, "Do:", alarm.do)
    control.stopScript()
    aridcal.calibrate(guided.campaign).save("results")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
