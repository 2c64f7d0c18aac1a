"""Which constants of a robot and its frames are asked for."""

from __future__ import annotations

from aridcal.effects.effect import FRAME_COMPONENTS, Coefficient
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.dataset import Dataset
from aridcal.inputs.read import per_station
from aridcal.robot.chain import Robot
from aridcal.robot.doty import doty_links


def frame_coefficients(campaign: Campaign, labels: tuple[str, ...]) -> tuple[Coefficient, ...]:
    """Unknowns of the frames that are to be identified: world_base first."""
    found = []
    for where, settings in (("world_base", campaign.frames.world_base), ("tip_target", campaign.frames.tip_target)):
        if settings.identify:
            stations: tuple[str | None, ...] = labels if settings.per == "station" else (None,)
            found += [Coefficient(where, c, station=s) for s in stations for c in FRAME_COMPONENTS]
    return tuple(found)


def constants(robot: Robot, which: str) -> tuple[Coefficient, ...]:
    """Candidate constants of a parameter set, the ones to keep before others first (FORMATS section 4)."""
    if which == "none":
        return ()
    if which == "full":
        found = []
        for joint in robot.joints:
            along = {c: abs(float(joint.axis[k % 3])) for k, c in enumerate(FRAME_COMPONENTS)}
            ordered = sorted(FRAME_COMPONENTS, key=lambda c: -round(along[c], 9))
            found += [Coefficient(joint.name, c) for c in ordered]
        if robot.tip_joint:
            found += [Coefficient(robot.tip_joint, c) for c in FRAME_COMPONENTS]
        return tuple(found)
    found = []
    for joint, link in zip(robot.joints, doty_links(robot), strict=True):
        if link.next_origin is None:
            continue  # nothing in the URDF could hold it: it is the target's frame
        own = ["d"] if joint.kind == "prismatic" else []
        own += ["a", "alpha"] if link.singular else ["theta", "beta", "a", "alpha"]
        beyond = ["yaw", "pitch"] if link.singular else []
        if which == "angles":
            own, beyond = [c for c in own if c in ("beta", "alpha")], [c for c in beyond if c == "pitch"]
        found += [Coefficient(joint.name, c) for c in own]
        found += [Coefficient(link.next_origin, c) for c in beyond]
    return tuple(found)


def unused_links(robot: Robot, which: str) -> list[str]:
    """Sentences on where Doty's link model is singular or has no place in the URDF."""
    if which not in ("doty", "angles"):
        return []
    said = []
    for link in doty_links(robot):
        if link.next_origin is None:
            said.append(f"{link.joint} ends in the tip link itself: its link parameters are those of tip_target")
        elif link.singular:
            said.append(
                f"{link.joint} and the next axis meet (a < 1 mm), where theta and beta are undefined: "
                f"{link.next_origin}.yaw and .pitch take their place"
            )
    return said


def station_labels(campaign: Campaign, data: Dataset) -> tuple[str, ...]:
    """All stations, sorted, where a frame is one for each of them; else none."""
    if data.station is None or not per_station(campaign):
        return ()
    return tuple(sorted({str(s) for s in data.station}))
