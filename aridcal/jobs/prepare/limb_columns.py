"""Which limbs of a robot a table is about: by columns of joints, by labels of targets, and by what the nominal robot says."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.files.measurement_settings import TARGET
from aridcal.files.tables import Table
from aridcal.jobs.prepare.column_names import match_joints
from aridcal.jobs.prepare.guesses import Chooser, Proposal
from aridcal.jobs.prepare.orientation_columns import CLEAR_RATIO, sensible
from aridcal.jobs.prepare.units_and_angles import rounded
from aridcal.system.errors import MeasurementError

# Chains that differ by fewer joints are one limb: fingers of a gripper.
FEWEST_OTHER_JOINTS = 2
# Ways in which columns are a joint's by its name: numbers tell no limb from another.
MATCHES_BY_NAME = ("same name", "similar name")

Chains = Mapping[tuple[str, ...], Sequence[Robot]]
"""Serial chains from the root to each link, by the joints whose readings they need."""

Fit = Callable[[Robot, Mapping[str, str], str | None], float]
"""How far rows of a target, None for all rows, are from a chain with some columns of joints, as a share of their spread."""


@dataclass(frozen=True)
class Limbs:
    """The paths through the robot that a table is about.

    Attributes:
        robot: The chain of the default path: that of most rows.
        columns: The column of each joint on any of the paths.
        why: Reasons, in words.
        on: Which link carries each target; none where all are on the tip.
        spare: Columns of joints that are on no path.
    """

    robot: Robot
    columns: dict[str, str]
    why: str
    on: dict[str, str] = field(default_factory=dict)
    spare: tuple[str, ...] = ()

    def say(self, proposal: Proposal) -> None:
        """Say which links the paths lead to."""
        root = self.robot.tree.frames[1].name == self.robot.base
        proposal.say("robot.base", self.robot.base, "the URDF's root link" if root else self.why)
        proposal.say("robot.tip", self.robot.tip, self.why if not self.on else "the target of most rows is on it")
        proposal.say_columns(self.columns, "the joints of all limbs, named as in the URDF")
        if self.on:
            proposal.say("instruments.targets", {label: {"on": link} for label, link in self.on.items()}, self.why)


def limbs_of(
    chains: Chains, table: Table, tip: Callable[[Sequence[Robot]], Robot], fit: Fit, asker: Chooser
) -> Limbs | None:
    """The limbs of a table with columns of several, or with targets that are called like links.

    Args:
        chains: Of the URDF.
        table: The measurements.
        tip: Which of some chains that end rigidly after the same joint is meant.
        fit: Judges a chain.
        asker: Asked where the nominal robot does not tell which limb a target is on.

    Returns:
        None where the table is about one chain, as most are.

    Raises:
        MeasurementError: a target is on a link whose joints have no columns.
        AridcalError: rows may be of one limb or another, and nobody says of which.
    """
    columns = _limbs_with_columns(chains, table)
    labels = _labels(table)
    links = {robot.tip: robot for ends in chains.values() for robot in ends}
    links_named = {label: links[label] for label in labels if label in links}
    if labels and len(links_named) == len(labels) and (len(columns) > 1 or len({*links_named.values()}) > 1):
        return _limbs_by_label(links_named, chains, table)
    if len(columns) < 2:
        return None
    limbs = [(tip(chains[joints]), own) for joints, own in columns.items()]
    if not labels:
        limbs += _between(limbs)
    limb_of, reasons = {}, []
    for label in labels or ("",):
        k, why = _limb_of_rows(label or None, limbs, table, fit, asker)
        limb_of[label] = limbs[k][0]
        reasons.append(why)
    robot = next(iter(limb_of.values()))
    links_of = {label: limb.tip for label, limb in limb_of.items()}
    columns_used = {joint: column for limb, own in limbs if limb in limb_of.values() for joint, column in own.items()}
    several = len(set(links_of.values())) > 1
    on = links_of if several else {}
    return Limbs(robot, columns_used, "; ".join(dict.fromkeys(reasons)), on, _spare(chains, table, columns_used))


def _spare(chains: Chains, table: Table, used: Mapping[str, str]) -> tuple[str, ...]:
    """Columns of joints that are on no path."""
    joints = {joint for names in chains for joint in names} - used.keys()
    return tuple(name for name in table.names if name in joints and name not in used.values())


def _limbs_with_columns(chains: Chains, table: Table) -> dict[tuple[str, ...], dict[str, str]]:
    """Longest chains all of whose joints have columns by their names, apart by some joints each."""
    names = [name for name in table.names if name]
    matches = {joints: match_joints(joints, names) for joints in chains}
    matched = {joints: match[0] for joints, match in matches.items() if match and match[1] in MATCHES_BY_NAME}
    limbs: list[tuple[str, ...]] = []
    for joints in sorted(matched, key=len, reverse=True):
        joint_set = set(joints)
        if all(len(joint_set - set(other)) >= FEWEST_OTHER_JOINTS for other in limbs):
            limbs.append(joints)
    return {joints: matched[joints] for joints in limbs}


def _between(limbs: Sequence[tuple[Robot, dict[str, str]]]) -> list[tuple[Robot, dict[str, str]]]:
    """Paths from the end of each limb to the end of each other one: one hand seen from another."""
    paths = []
    for (start, one), (end, other) in permutations(limbs, 2):
        robot, columns = start.between(start.tip, end.tip), one | other
        paths.append((robot, {joint: columns[joint] for joint in robot.readings}))
    return paths


def _labels(table: Table) -> list[str]:
    """Labels of the targets, those of most rows first."""
    if TARGET not in table.cells:
        return []
    words, counts = np.unique(table.texts(TARGET), return_counts=True)
    return [str(words[k]) for k in np.argsort(-counts, kind="stable") if words[k]]


def _limbs_by_label(robots: Mapping[str, Robot], chains: Chains, table: Table) -> Limbs:
    """The limbs of targets that are called like the links that carry them."""
    names = [name for name in table.names if name]
    columns: dict[str, str] = {}
    for label, robot in robots.items():
        match = match_joints(robot.readings, names)
        if match is None or match[1] not in MATCHES_BY_NAME:
            lacking = [joint for joint in robot.readings if joint not in names]
            raise MeasurementError(
                f"{table.title}: the target {label!r} is called like a link of the URDF, but there are no columns for the joints "
                f"{', '.join(lacking)} on the way to it: name these as in the URDF, or the target otherwise"
            )
        columns |= match[0]
    on = {label: label for label in robots}
    spare = _spare(chains, table, columns)
    return Limbs(next(iter(robots.values())), columns, "called like links of the URDF", on, spare)


def _limb_of_rows(
    label: str | None, limbs: Sequence[tuple[Robot, dict[str, str]]], table: Table, fit: Fit, asker: Chooser
) -> tuple[int, str]:
    """The index of the limb that some rows are of, and why: it alone has numbers, or its nominal robot agrees with the rows.

    Args:
        label: Of their target; None: all rows.
        limbs: Chains, and the columns of their joints.
        table: The measurements.
        fit: Judges a chain.
        asker: Asked where neither decides.
    """
    root = limbs[0][0].base
    tips = [robot.tip if robot.base == root else f"{robot.tip} seen from {robot.base}" for robot, _ in limbs]
    rows = slice(None) if label is None else table.texts(TARGET) == label
    complete = [np.isfinite(sensible(table, list(own.values()))[rows]).all(axis=1).any() for _, own in limbs]
    about = "the rows are" if label is None else f"the target {label!r} is"
    if sum(complete) == 1:
        k = complete.index(True)
        return k, f"{about} on {tips[k]}: the other limbs' joints have no numbers"
    shares = np.array([fit(robot, own, label) for robot, own in limbs])
    first, second = np.argsort(shares)[:2].tolist()
    if CLEAR_RATIO * shares[first] < shares[second]:
        distance = f"{rounded(100 * shares[first])} % of their spread from the nominal {tips[first]}"
        return first, f"{about} {distance}, {rounded(100 * shares[second])} % from {tips[second]}"
    key = "robot.tip" if label is None else f"instruments.targets.{label}.on"
    question = "which link was measured" if label is None else f"which link carries the target {label!r}"
    k = asker.pick(
        key, question, tips, "the table has joints of several limbs, and the nominal robot does not tell them apart"
    )
    return k, f"{about} on {tips[k]}, as you said"
