"""Redundancies of a robot of several limbs, in words: a torso against both shoulders, a camera against the neck."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.robot.chain import Robot
from aridcal.system.wording import enumeration

MOST_PLACES = 6
"""Places at the most: a coefficient confounded with more is so with everything, for want of rows and not by the tree."""


def limb_redundancies(fit: Fit) -> Iterator[str]:
    """Sentences on limbs, frames and instruments that the rows cannot tell apart; none of a robot of one limb.

    Redundancies of any arm are left out: constants of neighbours on one limb, and of the last joints and their target.

    Args:
        fit: The geometric stage, with its redundant constants.
    """
    robot = fit.model.robot
    if not robot.others:
        return
    groups: dict[tuple[tuple[str, ...], tuple[str, ...]], tuple[dict[str, None], dict[str, None], list[str]]] = {}
    for name, partners in fit.redundant.items():
        place = _place(name)
        limbs = robot.limbs_of(place)
        others = dict.fromkeys(other for partner in partners if (other := _place(partner)) != place)
        beyond = [other for other in others if robot.limbs_of(other) != limbs and not other.startswith("tip_target")]
        if not limbs or not beyond or len(others) > MOST_PLACES:
            continue
        key = limbs, tuple(sorted({_group(robot, other) for other in beyond}))
        places, against, names = groups.setdefault(key, ({}, {}, []))
        places[place] = None
        against.update(dict.fromkeys(beyond))
        names.append(name)
    for places, against, names in groups.values():
        phrase = (
            "1 constant of the former keeps its"
            if len(names) == 1
            else f"{len(names)} constants of the former keep their"
        )
        yield (
            f"{_in_words(robot, list(places))} cannot be told from {_in_words(robot, list(against))}: {phrase} nominal value, "
            "and the latter contain what these are off by"
        )


def _place(name: str) -> str:
    """The place of a coefficient: ``joint_2`` of ``joint_2.yaw``."""
    return name.rpartition(".")[0]


def _group(robot: Robot, place: str) -> str:
    """The limb of a joint; any other place by itself."""
    return " ".join(robot.limbs_of(place)) or place


def _in_words(robot: Robot, places: Sequence[str]) -> str:
    """Places, joints with their limbs."""
    return enumeration([robot.place_in_words(place) for place in places])
