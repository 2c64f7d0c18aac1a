"""Propose a campaign for a URDF and tables of measurements: names say what may be meant, the nominal robot what is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aridcal.engine.robot.chain import Robot, chain, with_limbs
from aridcal.engine.robot.tree import read_tree
from aridcal.files.measurement_settings import TARGET
from aridcal.files.orientations import POSITION_COLUMNS, QUATERNION_SLACK
from aridcal.files.tables import Table
from aridcal.jobs.prepare.column_names import (
    MEASURED_WORDS,
    ON_A_BODY,
    Family,
    has_orientation,
    joint_families,
    match_joints,
    places,
    quaternions,
    unit,
)
from aridcal.jobs.prepare.condition_columns import say_covariates, say_repeats
from aridcal.jobs.prepare.guesses import Chooser, Proposal, ask
from aridcal.jobs.prepare.limb_columns import limbs_of
from aridcal.jobs.prepare.orientation_columns import CLEAR_RATIO, MOST_ANSWERS, say_orientation, sensible
from aridcal.jobs.prepare.other_kinds import kind_of_table, say_other_kind
from aridcal.jobs.prepare.other_readings import SAMPLE_ROWS
from aridcal.jobs.prepare.units_and_angles import Sample, TableReading, fit_with_one_slip, readings, rounded
from aridcal.system.errors import MeasurementError, RobotError, name_list, shortened

# Share of rows in which a quaternion's norm is 1.
LEAST_UNIT_NORM_SHARE = 0.8
# Rows without which nothing can be judged: the frames alone take twelve numbers.
FEWEST_TABLE_ROWS = 4
# No nominal robot misses the targets by so much of their spread.
STRANGE_SHARE = 0.05
# The base's z is the instrument's if they are as close as that, [deg]: floors and tripods are less exact than
# noise.
MOST_TILT_DEG = 5.0
# Links that are the tip by their name, the likeliest first.
TIPS = ("tool0", "flange", "ee_link", "tcp")
# How joints were matched with columns, in words.
MATCHES_IN_WORDS = {
    "similar name": "names alike",
    "number": "by their numbers",
    "order": "by their ORDER along the chain",
}


COMPUTED_ALONE = (
    "what the controller's own model makes of its joints, NO MEASUREMENT: a calibration to it gives that model back. Name the "
    "columns of an instrument"
)
"""What is said of positions that a controller computes, where there are no others."""

QUESTIONS = (
    *("table.sheet", "table.names", "table.dates", "table.decimal"),
    *("joints", "columns", "units", "orientation", "reading", "robot.tip"),
)
"""Keys of what may be asked; answers may be given beforehand."""


def propose(urdf: bytes, path: Path, table: Table, asker: Chooser, clock: str | None = None) -> Proposal:
    """Propose what a campaign should say.

    Args:
        urdf: The URDF's bytes.
        path: Where they came from.
        table: The measurements.
        asker: Asked wherever the evidence does not decide.
        clock: Column of seconds that was made of dates.

    Raises:
        MeasurementError: joints or positions have no columns, or a campaign cannot tell their units.
        RobotError: the URDF cannot be read, or has no serial chain.
    """
    chains = _chains(urdf, path)

    def fit(robot: Robot, columns: Mapping[str, str], label: str | None) -> float:
        return _misfit_share(table, robot, columns, label)

    limbs = limbs_of(chains, table, lambda ends: _tip(ends, asker)[0], fit, asker)
    if limbs is None:
        proposal, columns = _one_chain(chains, table, asker)
    else:
        proposal, columns = Proposal(limbs.robot), limbs.columns
        limbs.say(proposal)
    robot = proposal.robot
    joint_columns = [columns[name] for name in robot.readings]
    used = set(columns.values())
    if limbs is not None and limbs.on:
        proposal.robot = with_limbs(robot, list(limbs.on.values()))
    spare = limbs.spare if limbs is not None else ()
    if (other := kind_of_table(table, used)) is not None:
        kind, columns_of_kind = other
        turning = np.array([joint != "prismatic" for joint in robot.kinds])
        used |= {
            *say_other_kind(kind, columns_of_kind, table, joint_columns, turning, proposal),
            *_split(table, used, proposal),
        }
        say_covariates(table, used, proposal, clock, kind.noise, spare)
        return proposal
    place = _position(table, robot, used, joint_columns, asker, proposal)
    used |= {*place.columns, *_split(table, used, proposal)}
    sample, rows = _sample(table, robot, joint_columns, place)
    reading = _units(sample, robot, joint_columns, place.columns, asker, proposal)
    used |= say_orientation(table, used, place, rows, reading, asker, proposal)
    _gravity(reading, proposal)
    say_covariates(table, used, proposal, clock, spare=spare)
    if proposal.robot is robot:
        say_repeats(sensible(table, joint_columns), reading, proposal)
    return proposal


def _one_chain(
    chains: dict[tuple[str, ...], list[Robot]], table: Table, asker: Chooser
) -> tuple[Proposal, dict[str, str]]:
    """The proposal's beginning for one chain whose joints have columns, and the column of each joint."""
    joints, columns, how = _joints(chains, table, asker)
    robot, sure = _tip(chains[joints], asker)
    proposal = Proposal(robot)
    proposal.say("robot.base", robot.base, "the URDF's root link")
    ends = f"{robot.names[0]} … {robot.names[-1]}" if len(robot.names) > 1 else robot.names[0]
    proposal.say(
        "robot.tip", robot.tip, f"end of the chain {ends}; anything rigid after the last joint does as well", sure
    )
    proposal.say_columns(columns, MATCHES_IN_WORDS.get(how, "named as in the URDF"), sure=how != "order")
    return proposal, columns


def _chains(urdf: bytes, path: Path) -> dict[tuple[str, ...], list[Robot]]:
    """Serial chains from the root to each link, by the joints whose readings they need.

    Raises:
        RobotError: there is none.
    """
    chains: dict[tuple[str, ...], list[Robot]] = {}
    failure: RobotError | None = None
    tree = read_tree(urdf, path)
    for link in tree.links:
        try:
            robot = chain(tree, link)
        except RobotError as error:
            failure = error
        else:
            chains.setdefault(robot.readings, []).append(robot)
    if not chains:
        raise failure or RobotError(f"{path}: has no links")
    return chains


def _joints(
    chains: Iterable[tuple[str, ...]], table: Table, asker: Chooser
) -> tuple[tuple[str, ...], dict[str, str], str]:
    """The longest chain whose joints all have columns.

    Returns:
        Its joints, the column of each, and how they were matched.

    Raises:
        MeasurementError: there is none, or a longer one has columns for some of its further joints only.
        AridcalError: two families of columns may be they, and nobody says which is.
    """
    names = [name for name in table.names if name]
    in_quaternions = {name for family in quaternions(names) if _is_quaternion(table, family) for name in family.columns}
    names_left = [
        name for name in names if name not in in_quaternions
    ]  # q1 … q4 may be a quaternion: no joints have norm 1 in all rows
    matches = {joints: match_joints(joints, names_left) for joints in chains}
    longest = max(map(len, matches))
    complete = {
        joints: match
        for joints, match in matches.items()
        if match and (match[1] in ("same name", "similar name") or 2 * len(joints) >= longest)
    }
    if not complete:
        lacking = [joint for joint in max(matches, key=len) if joint not in names]
        raise MeasurementError(
            f"{table.title}: no columns for the joints {', '.join(lacking)}. Its columns are {name_list(names)}. Name "
            "the joints' columns as in the URDF, or number them q1, q2, … along the chain. Where the controller logged them in a "
            f"file of its own, `aridcal merge joints.csv {table.title} --urdf … --tip …` makes one table of both"
        )
    best = max(complete, key=lambda joints: (complete[joints][1] != "order", len(joints)))
    for joints in matches:
        further = set(joints) - set(best)
        if set(joints) > set(best) and further & set(names):
            lacking = [joint for joint in joints if joint in further and joint not in names]
            raise MeasurementError(
                f"{table.title}: no columns for the joints {', '.join(lacking)}, though for joints beyond. Name them as in "
                "the URDF"
            )
    columns, how = complete[best]
    if how in ("number", "order"):
        families = joint_families(names_left, len(best))
        if len(families) > 1:
            answers = [f"{family.columns[0]} … {family.columns[-1]}" for family in families]
            question = "which columns are the joints' readings"
            likeliest = families[asker.pick("joints", question, answers, f"{table.title} has several as likely")]
            others = {name for family in families if family is not likeliest for name in family.columns}
            columns, how = match_joints(best, [name for name in names_left if name not in others]) or complete[best]
    return best, columns, how


def _is_quaternion(table: Table, family: Family) -> bool:
    """True of four columns whose norm is 1 in most rows."""
    norm = np.linalg.norm(sensible(table, family.columns), axis=1)
    return len(family.columns) == 4 and bool(np.mean(np.abs(norm - 1) < QUATERNION_SLACK) > LEAST_UNIT_NORM_SHARE)


def _tip(robots: Sequence[Robot], asker: Chooser) -> tuple[Robot, bool]:
    """The chain that is meant of some that end rigidly after the same joint, and whether that is sure."""

    def rank(robot: Robot) -> tuple[int, bool]:
        by_name = TIPS.index(robot.tip) if robot.tip in TIPS else len(TIPS)
        return by_name, robot.tip_joint is None

    ends = sorted(robots, key=rank)
    if len(ends) == 1 or ends[0].tip in TIPS:
        return ends[0], True
    about = "all are rigid after the last joint: take what your programs call the tool"
    number, sure = ask(asker.choose, "which link is the tip", [robot.tip for robot in ends], about)
    return ends[number], sure


def _position(
    table: Table, robot: Robot, used: set[str], joints: Sequence[str], asker: Chooser, proposal: Proposal
) -> Family:
    """The columns of the measured position.

    Args:
        table: The measurements.
        robot: The chain.
        used: Columns that are spoken for.
        joints: Column of each reading.
        asker: Asked where more than one position may be the measured one.
        proposal: Told what was found.

    Raises:
        MeasurementError: there are none.
        AridcalError: several may be, and nobody says which is.
    """
    free = [name for name in table.names if name and name not in used]
    finite = {family: np.isfinite(sensible(table, family.columns)) for family in places(free)}
    families = [family for family in finite if finite[family].all(axis=1).any()] or [
        f for f in finite if finite[f].any()
    ]
    if not families:
        raise MeasurementError(f"{table.title}: no columns for the target's position: {_no_position(table, free)}")
    candidates = [family for family in families if not (family.commanded or family.computed)] or families
    surest = [family for family in candidates if family.about & (MEASURED_WORDS - ON_A_BODY)]
    moving, reason = candidates, ""
    if len(candidates) > 1 and len(surest) != 1:
        moving = [family for family in candidates if _may_be_measured(table, robot, joints, family)]
        reason = "; the others do not move as the robot does" if len(moving) == 1 else ""
    elif len(surest) == 1:
        moving = surest
    if len(moving) > 1:
        with_orientation = [family for family in moving if has_orientation(free, family)]
        moving = with_orientation if len(with_orientation) == 1 else moving
    position = (moving or candidates)[0]
    if len(moving) != 1 and len(candidates) > 1:
        candidates = moving or candidates
        options = [" ".join(family.columns) for family in candidates]
        question = "which columns are the measured position"
        position = candidates[asker.pick("columns", question, options, "more than one may be")]
    others = [" ".join(family.columns) for family in families if family is not position]
    why = "the measured position" + (f", not {' or '.join(others)}{reason}" if others else "")
    if position.computed:
        why = COMPUTED_ALONE
    columns = dict(zip(POSITION_COLUMNS, position.columns, strict=True))
    proposal.say_columns(columns, why, sure=not (position.commanded or position.computed))
    return position


def _no_position(table: Table, free: Sequence[str]) -> str:
    """What to do where no columns have numbers that may be a position."""
    for family in places(free):
        texts = [cell for cell in table.texts(family.columns[0]).tolist() if cell]
        if texts:
            return (
                f"{' '.join(family.columns)} hold no numbers, {shortened(texts[0])!r} for instance; write numbers alone"
            )
    return "call them x, y and z"


def _may_be_measured(table: Table, robot: Robot, joints: Sequence[str], place: Family) -> bool:
    """True of positions that are near the nominal robot's, read in some way."""
    return _share(table, robot, joints, place) <= STRANGE_SHARE


def _misfit_share(table: Table, robot: Robot, columns: Mapping[str, str], label: str | None) -> float:
    """Distance of a chain from the nearest positions that may have been measured, as a share of their spread."""
    free = [name for name in table.names if name and name not in columns.values()]
    joints = [columns[name] for name in robot.readings]
    candidates = [family for family in places(free) if not (family.commanded or family.computed)]
    return min((_share(table, robot, joints, family, label) for family in candidates), default=1.0)


def _share(table: Table, robot: Robot, joints: Sequence[str], place: Family, label: str | None = None) -> float:
    """Distance of positions from the nominal robot's, as a share of their spread, read in the way that fits best."""
    try:
        sample, _ = _sample(table, robot, joints, place, label)
    except MeasurementError:
        return 1.0
    return min((reading.share for reading in readings(sample, robot)), default=1.0)


def _split(table: Table, used: set[str], proposal: Proposal) -> list[str]:
    """Columns of labels, which are spoken for: the one that says `train` or `test`, `station` and `target`."""
    free = [name for name in table.names if name not in used]
    columns = [name for name in free if set(table.texts(name)) <= {"train", "test"}][:1]
    for name in columns:
        proposal.say_columns({"split": name}, f"the column {name} says train or test: it is kept to")
    return [*columns, *(name for name in ("station", TARGET) if name in table.cells)]


def _sample(
    table: Table, robot: Robot, joints: Sequence[str], place: Family, label: str | None = None
) -> tuple[Sample, np.ndarray]:
    """Rows to judge by, and their indices in the table.

    Args:
        table: N rows.
        robot: The chain.
        joints: Column of each reading.
        place: Columns of the position.
        label: Of the target to judge by; None: that of most rows.

    Raises:
        MeasurementError: too few rows have all of these.
    """
    q, position = sensible(table, joints), sensible(table, place.columns)
    finite = np.isfinite(q).all(axis=1) & np.isfinite(position).all(axis=1)
    if TARGET in table.cells:  # points of a board: of one alone, since each has a place of its own
        words, counts = np.unique(table.texts(TARGET), return_counts=True)
        finite &= table.texts(TARGET) == (words[np.argmax(counts)] if label is None else label)
    whole = np.flatnonzero(finite)
    if len(whole) < FEWEST_TABLE_ROWS:
        counts = np.isfinite(np.hstack([q, position])).sum(axis=0)
        emptiest = [*joints, *place.columns][int(np.argmin(counts))]
        raise MeasurementError(
            f"{table.title}: {len(whole)} rows have all joints and positions; {FEWEST_TABLE_ROWS} are the least. The column "
            f"{emptiest!r} has numbers in {counts.min()} of {len(table)} rows: mend it, or measure more"
        )
    chosen = np.random.default_rng(0).permutation(whole)[:SAMPLE_ROWS]
    rows = np.sort(chosen)
    labels = table.texts("station")[rows] if "station" in table.cells else np.zeros(len(rows))
    _, station = np.unique(labels, return_inverse=True)
    turning = np.array([kind != "prismatic" for kind in robot.kinds])
    return Sample(q[rows], turning, position[rows], station), rows


def _units(
    sample: Sample, robot: Robot, joints: Sequence[str], place: Sequence[str], asker: Chooser, proposal: Proposal
) -> TableReading:
    """Keep the units, and the frames per station, that the nominal robot agrees with.

    Args:
        sample: Rows to judge by.
        robot: The nominal robot.
        joints: Columns: their names may end in a unit.
        place: Columns of the position, likewise.
        asker: Asked where two ways fit alike and no header tells.
        proposal: Told what was found.

    Returns:
        The way to read joints and positions, with any joint counted as fits best.

    Raises:
        AridcalError: two ways fit alike, and nobody says which is meant.
    """
    ways = readings(sample, robot)
    best = next(reading for reading in ways if reading.per is None)
    shared_best = ways[0]
    if shared_best.per and shared_best.share * CLEAR_RATIO < best.share:
        why = f"stations that share it: {rounded(1e3 * best.metres)} mm off; one each: {rounded(1e3 * shared_best.metres)} mm"
        proposal.say(f"frames.{shared_best.per}", {"per": "station"}, why)
        best = shared_best
    near = [r for r in ways if r.per == best.per][:MOST_ANSWERS]
    counting, slip = best, ""
    if best.share > STRANGE_SHARE:  # a joint that counts otherwise makes other units look right
        other = fit_with_one_slip(sample, robot, near)
        if other.share <= STRANGE_SHARE:
            units = (other.angle, other.length, other.travel)
            best, counting = next(r for r in near if (r.angle, r.length, r.travel) == units), other
            slip = f". If one joint counted backwards, or from another quarter of a turn, by {rounded(100 * other.share)} %: "
            slip += "`aridcal identify` says which"
    alike = [reading for reading in near if reading.share <= CLEAR_RATIO * best.share]
    by_header = ""
    if len(alike) > 1 and best.share <= STRANGE_SHARE:  # else none is right, which is said below
        by_names = _units_in_header(sample, joints, place)
        agreeing = [reading for reading in alike if by_names and by_names <= set(_units_of(sample, reading))]
        if len(agreeing) == 1:
            best, by_header = agreeing[0], "as the header says, where others fit alike: "
        else:
            names = [_units_in_words(reading) for reading in alike]
            why = "these fit the nominal robot alike"
            best = alike[asker.pick("units", "which units have joints and positions", names, why)]
    value: dict[str, Any] = {}
    if best.length != "m":
        value["length"] = best.length
    if best.angle != "rad":
        value["angle"] = best.angle
    if best.travel != best.length:
        slides = [name for name, turns in zip(joints, sample.turning, strict=True) if not turns]
        value["columns"] = dict.fromkeys(slides, best.travel)
    proposal.fit = (best.metres, best.share)
    why = by_header + _why_units(best, near, [*joints, *place]) + slip
    proposal.say("measurements.units", value or None, why, sure=best.share <= STRANGE_SHARE)
    return counting


def _units_in_header(sample: Sample, joints: Sequence[str], place: Sequence[str]) -> set[tuple[str, str]]:
    """Units by the header: pairs of ``angle``, ``travel`` or ``length`` and a unit."""
    kinds = ["angle" if turns else "travel" for turns in sample.turning] + ["length"] * len(place)
    words = [unit(name) for name in (*joints, *place)]
    return {(kind, word) for kind, word in zip(kinds, words, strict=True) if word}


def _units_of(sample: Sample, reading: TableReading) -> list[tuple[str, str]]:
    """Units of a way to read joints and positions, in the same pairs."""
    travel = [] if sample.turning.all() else [("travel", reading.travel)]
    return [("angle", reading.angle), ("length", reading.length), *travel]


def _units_in_words(reading: TableReading) -> str:
    """Units of a way to read joints and positions."""
    length, travel = ("inches" if u == "in" else u for u in (reading.length, reading.travel))
    rails = "" if travel == length else f", rails in {travel}"
    return f"{reading.angle} and {length}{rails}"


def _why_units(best: TableReading, near: Sequence[TableReading], columns: Sequence[str]) -> str:
    """Reasons for some units: the header, how near the nominal robot comes, and how near with the next best."""
    header_units = {unit(column) for column in columns} - {None}
    agrees = header_units and header_units <= {best.angle, best.length}
    why = "as the header says: " if agrees else ""
    why += f"in {_units_in_words(best)} the nominal robot misses the targets by {rounded(1e3 * best.metres)} mm"
    why += f" ({rounded(100 * best.share)} % of their spread)"
    for other in [reading for reading in near if reading is not best][:1]:
        why += f"; in {_units_in_words(other)} by {rounded(100 * other.share)} %"
    if best.share > STRANGE_SHARE:
        why += ". That is MUCH: check that the URDF is this robot's, each joint's column, sign and zero (`joints`), whether poses"
        why += " are the other way round (`inverted`), and whether tracker"
        why += " or target were moved in between (then give each place its label in a column `station`)"
    return why


def _gravity(reading: TableReading, proposal: Proposal) -> None:
    """Say whether the robot stands upright, as far as the instrument does."""
    cosine = np.clip(reading.world[0][2, 2], -1, 1)
    tilt = float(np.degrees(np.arccos(cosine)))
    if tilt < MOST_TILT_DEG:
        proposal.say("robot.gravity", None, f"along -z of the base, whose z is {tilt:.1f}° from the instrument's")
        return
    why = f"the default is -z of the base, whose z is {tilt:.0f}° from the instrument's. Is the instrument levelled?"
    proposal.say("robot.gravity", None, f"{why} Then write `gravity: world`", sure=False)
