"""Propose a campaign for a URDF and tables of measurements: names say what may be meant, the nominal robot what is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from aridcal.errors import MeasurementError, RobotError, listed
from aridcal.inputs.orientations import QUATERNION
from aridcal.inputs.quantities import ABSURD, POSITION, SAME_ORIENTATION
from aridcal.inputs.tables import Table
from aridcal.prepare.column_names import Family, angle_triples, match_joints, positions, quaternions, unit
from aridcal.prepare.covariates import say_covariates, say_repeats
from aridcal.prepare.guesses import Choose, Proposal, ask
from aridcal.prepare.other_kinds import other_kind, say_other_kind
from aridcal.prepare.units_and_angles import Reading, Sample, Writing, angle_writings, quaternion_writings, readings
from aridcal.robot.chain import Robot, chain
from aridcal.robot.tree import read_tree

# Rows that judge; more make no clearer verdict.
SAMPLE = 150
# Rows without which nothing can be judged: the frames alone take twelve numbers.
FEWEST = 4
# A way to read the table that fits so many times better than the next needs no question.
CLEAR = 3.0
# No nominal robot misses the targets by so much of their spread.
STRANGE_SHARE = 0.05
# No nominal robot misses orientations by so much, [rad].
STRANGE_ANGLE = 0.2
# How far from 1 the norms of a quaternion's columns may be.
UNIT_SLACK = 0.05
# Some programs write four zeros where they know no orientation.
NO_ROTATION = 0.5
# The base's z is the instrument's if they are as close as that, [deg]: floors and tripods are less exact than
# noise.
UPRIGHT = 5.0
# Answers that a question offers.
MOST_ANSWERS = 4
# Links that are the tip by their name, the likeliest first.
TIPS = ("tool0", "flange", "ee_link", "tcp")
# How joints were matched with columns, in words.
HOW = {"similar name": "names alike", "number": "by their numbers", "order": "by their ORDER along the chain"}


def propose(urdf: bytes, path: Path, table: Table, choose: Choose) -> Proposal:
    """Propose what a campaign should say.

    Args:
        urdf: The URDF's bytes.
        path: Where they came from.
        table: The measurements.
        choose: Asked wherever the evidence does not decide.

    Raises:
        MeasurementError: joints or positions have no columns, or a campaign cannot tell their units.
        RobotError: the URDF cannot be read, or has no serial chain.
    """
    chains = _chains(urdf, path)
    joints, columns, how = _joints(chains, table)
    robot, sure = _tip(chains[joints], choose)
    made = Proposal(robot)
    made.say("robot.base", robot.base, "the URDF's root link")
    ends = f"{robot.names[0]} … {robot.names[-1]}" if len(robot.names) > 1 else robot.names[0]
    made.say("robot.tip", robot.tip, f"end of the chain {ends}; anything rigid after the last joint does as well", sure)
    made.say_columns(columns, HOW.get(how, "named as in the URDF"), sure=how != "order")
    joint_columns = [columns[name] for name in robot.readings]
    used = set(columns.values())
    if (other := other_kind(table, used)) is not None:
        kind, own = other
        turning = np.array([joint != "prismatic" for joint in robot.kinds])
        used |= {*say_other_kind(kind, own, table, joint_columns, turning, made), *_split(table, used, made)}
        say_covariates(table, used, made, kind.noise)
        return made
    place = _position(table, used, choose, made)
    used |= {*place.columns, *_split(table, used, made)}
    sample, rows = _sample(table, robot, joint_columns, place)
    reading = _units(sample, robot, [*columns.values(), *place.columns], choose, made)
    used |= _orientation(table, used, rows, reading, choose, made)
    _gravity(reading, made)
    say_covariates(table, used, made)
    say_repeats(_sensible(table, joint_columns), reading, made)
    return made


def _chains(urdf: bytes, path: Path) -> dict[tuple[str, ...], list[Robot]]:
    """Serial chains from the root to each link, by the joints whose readings they need.

    Raises:
        RobotError: there is none.
    """
    chains: dict[tuple[str, ...], list[Robot]] = {}
    why: RobotError | None = None
    tree = read_tree(urdf, path)
    for link in tree.links:
        try:
            robot = chain(tree, link)
        except RobotError as error:
            why = error
        else:
            chains.setdefault(robot.readings, []).append(robot)
    if not chains:
        raise why or RobotError(f"{path}: has no links")
    return chains


def _joints(chains: Iterable[tuple[str, ...]], table: Table) -> tuple[tuple[str, ...], dict[str, str], str]:
    """The longest chain whose joints all have columns.

    Returns:
        Its joints, the column of each, and how they were matched.

    Raises:
        MeasurementError: there is none, or a longer one has columns for some of its further joints only.
    """
    names = [name for name in table.names if name]
    matches = {joints: match_joints(joints, names) for joints in chains}
    found = {joints: match for joints, match in matches.items() if match}
    if not found:
        lacking = [joint for joint in max(matches, key=len) if joint not in names]
        raise MeasurementError(
            f"{table.title}: no columns for the joints {', '.join(lacking)}. Its columns are {listed(names)}. Name "
            "the joints' columns as in the URDF, or number them q1, q2, … along the chain"
        )
    best = max(found, key=lambda joints: (found[joints][1] != "order", len(joints)))
    for joints in matches:
        beyond = set(joints) - set(best)
        if set(joints) > set(best) and beyond & set(names):
            lacking = [joint for joint in joints if joint in beyond and joint not in names]
            raise MeasurementError(
                f"{table.title}: no columns for the joints {', '.join(lacking)}, though for joints beyond. Name them as in "
                "the URDF"
            )
    columns, how = found[best]
    return best, columns, how


def _tip(robots: Sequence[Robot], choose: Choose) -> tuple[Robot, bool]:
    """Which of the chains that end rigidly after the same joint is meant, and if that is sure."""

    def rank(robot: Robot) -> tuple[int, bool]:
        by_name = TIPS.index(robot.tip) if robot.tip in TIPS else len(TIPS)
        return by_name, robot.tip_joint is None

    ends = sorted(robots, key=rank)
    if len(ends) == 1 or ends[0].tip in TIPS:
        return ends[0], True
    about = "all are rigid after the last joint: take what your programs call the tool"
    picked, sure = ask(choose, "which link is the tip", [robot.tip for robot in ends], about)
    return ends[picked], sure


def _position(table: Table, used: set[str], choose: Choose, made: Proposal) -> Family:
    """The columns of the measured position.

    Args:
        table: The measurements.
        used: Columns that are spoken for.
        choose: Asked where more than one position may be the measured one.
        made: Told what was found.

    Raises:
        MeasurementError: there are none.
    """
    free = [name for name in table.names if name and name not in used]
    families = [family for family in positions(free) if np.isfinite(_sensible(table, family.columns)).any()]
    if not families:
        raise MeasurementError(f"{table.title}: no columns for the target's position: call them x, y and z")
    options = [" ".join(family.columns) for family in families]
    picked, sure = 0, not families[0].commanded
    if len(families) > 1 and not families[1].commanded:
        picked, sure = ask(choose, "which columns are the measured position", options, "more than one may be")
    passed = [option for k, option in enumerate(options) if k != picked]
    why = "the measured position" + (f", not {' or '.join(passed)}" if passed else "")
    columns = dict(zip(POSITION, families[picked].columns, strict=True))
    made.say_columns(columns, why, sure)
    return families[picked]


def _split(table: Table, used: set[str], made: Proposal) -> list[str]:
    """The column, if any, that tells rows to train with from rows to test with; a `station` is spoken for as well."""
    free = [name for name in table.names if name not in used]
    found = [name for name in free if set(table.texts(name)) <= {"train", "test"}][:1]
    for name in found:
        made.say_columns({"split": name}, f"the column {name} says train or test: it is kept to")
    station = ["station"] if "station" in table.cells else []
    return [*found, *station]


def _sample(table: Table, robot: Robot, joints: Sequence[str], place: Family) -> tuple[Sample, np.ndarray]:
    """Rows to judge by, and their numbers in the table.

    Args:
        table: N rows.
        robot: The chain.
        joints: Column of each reading.
        place: Columns of the position.

    Raises:
        MeasurementError: too few rows have all of these.
    """
    q, position = _sensible(table, joints), _sensible(table, place.columns)
    finite = np.isfinite(q).all(axis=1) & np.isfinite(position).all(axis=1)
    whole = np.flatnonzero(finite)
    if len(whole) < FEWEST:
        counts = np.isfinite(np.hstack([q, position])).sum(axis=0)
        emptiest = [*joints, *place.columns][int(np.argmin(counts))]
        raise MeasurementError(
            f"{table.title}: {len(whole)} rows have all joints and positions; {FEWEST} are the least. The column "
            f"{emptiest!r} has numbers in {counts.min()} of {len(table)} rows: mend it, or measure more"
        )
    drawn = np.random.default_rng(0).permutation(whole)[:SAMPLE]
    rows = np.sort(drawn)
    labels = table.texts("station")[rows] if "station" in table.cells else np.zeros(len(rows))
    _, station = np.unique(labels, return_inverse=True)
    turning = np.array([kind != "prismatic" for kind in robot.kinds])
    return Sample(q[rows], turning, position[rows], station), rows


def _units(sample: Sample, robot: Robot, columns: Sequence[str], choose: Choose, made: Proposal) -> Reading:
    """Keep the units, and the frames per station, that the nominal robot agrees with.

    Args:
        sample: Rows to judge by.
        robot: The nominal robot.
        columns: Of joints and position: their names may end in a unit.
        choose: Asked where two ways fit alike.
        made: Told what was found.

    Returns:
        The way to read joints and positions.

    Raises:
        MeasurementError: positions and rails are in different units, which a campaign cannot say.
    """
    tried = readings(sample, robot)
    best = next(reading for reading in tried if reading.per is None)
    first = tried[0]
    if first.per and first.share * CLEAR < best.share:
        why = f"stations that share it: {1e3 * best.metres:.3g} mm off; one each: {1e3 * first.metres:.3g} mm"
        made.say(f"frames.{first.per}", {"per": "station"}, why)
        best = first
    if best.travel != best.length:
        raise MeasurementError(
            f"positions are in {best.length} but joints that slide in {best.travel}: `units` speaks of all lengths of "
            "a file. Convert one of them, in a spreadsheet for instance, and run this again"
        )
    near = [r for r in tried if r.per == best.per and (r.travel == r.length or r is best)][:MOST_ANSWERS]
    clear = len(near) == 1 or near[1].share > CLEAR * near[0].share
    if not clear:
        names = [f"{reading.angle} and {reading.length}" for reading in near]
        picked, clear = ask(choose, "which units have joints and positions", names, "they fit the nominal robot alike")
        best = near[picked]
    value = {}
    if best.length != "m":
        value["length"] = best.length
    if best.angle != "rad":
        value["angle"] = best.angle
    likely = best.share <= STRANGE_SHARE
    made.say("measurements.units", value or None, _why_units(best, near, columns), sure=clear and likely)
    return best


def _why_units(best: Reading, near: Sequence[Reading], columns: Sequence[str]) -> str:
    """What speaks for some units: the header, how near the nominal robot comes, and how near with the next best."""
    said = {unit(column) for column in columns} - {None}
    agrees = said and said <= {best.angle, best.length}
    why = "as the header says: " if agrees else ""
    why += f"in {best.angle} and {best.length} the nominal robot misses the targets by {1e3 * best.metres:.3g} mm"
    why += f" ({100 * best.share:.2g} % of their spread)"
    for other in [reading for reading in near if reading is not best][:1]:
        why += f"; in {other.angle} and {other.length} by {100 * other.share:.2g} %"
    if best.share > STRANGE_SHARE:
        why += ". That is MUCH: check that the URDF is this robot's, each joint's column, sign and zero, and whether tracker"
        why += " or target were moved in between (then give each place its label in a column `station`)"
    return why


def _orientation(
    table: Table, used: set[str], rows: np.ndarray, reading: Reading, choose: Choose, made: Proposal
) -> set[str]:
    """Keep the writing of orientations that the nominal robot agrees with.

    Args:
        table: N rows.
        used: Columns that are spoken for.
        rows: Those to judge by.
        reading: The way to read joints and positions.
        choose: Asked where two ways fit alike.
        made: Told what was found.

    Returns:
        The columns of the orientation; none where there are only positions.

    Raises:
        MeasurementError: joints and orientations are in different units, which a campaign cannot say; or there are two
            orientations that disagree.
    """
    found = _writings(table, used, rows, reading)
    if not found:
        made.say("measurements.kind", "position", "no columns of an orientation", sure=False)
        return set()
    family, ways = found[0]
    best, clear = ways[0], len(ways) == 1 or ways[1].misfit > CLEAR * ways[0].misfit
    if not clear:
        answers = [way.what for way in ways[:MOST_ANSWERS]]
        picked, clear = ask(choose, "how are orientations written", answers, "they fit the nominal robot alike")
        best = ways[picked]
    if best.angle not in (None, reading.angle):
        raise MeasurementError(
            f"{table.title}: joints are in {reading.angle} but {' '.join(family.columns)} in {best.angle}: `units` "
            "speaks of all angles of a file. Convert one of them, in a spreadsheet for instance, and run this again"
        )
    _refuse_second_orientation(table, rows, family, best, found[1:])
    why = f"{best.what} misses the nominal robot's orientations by {1e3 * best.misfit:.3g} mrad"
    for other in [way for way in ways if way is not best][:1]:
        why += f"; {other.what} by {1e3 * other.misfit:.3g}"
    likely = best.misfit <= STRANGE_ANGLE
    if not likely:
        why += ". That is MUCH: check their order, and that they turn the target into the world and not back"
    made.say("measurements.kind", "pose", "positions and orientations")
    for key, value in best.keys.items():
        made.say(key, value, why, sure=clear and likely)
    return set(family.columns)


def _refuse_second_orientation(
    table: Table, rows: np.ndarray, family: Family, best: Writing, others: Sequence[tuple[Family, list[Writing]]]
) -> None:
    """Refuse a second orientation that nothing says was commanded, and that is another than the first.

    Args:
        table: N rows.
        rows: Those to judge by.
        family: The first one's columns.
        best: How it is written.
        others: Further columns that may be orientations, and every way to read them.

    Raises:
        MeasurementError: naming a row and both.
    """
    for other, ways in others:
        alike = (other.commanded, other.measured) == (family.commanded, family.measured)
        if set(other.columns) & set(family.columns) or not alike or ways[0].misfit > STRANGE_ANGLE:
            continue
        whole = np.isfinite(table.matrix((*family.columns, *other.columns))[rows]).all(axis=1)
        apart = [np.where(whole, (way.rotation * best.rotation.inv()).magnitude(), 0.0) for way in ways]
        nearest = min(apart, key=np.max)
        worst = int(np.argmax(nearest))
        if nearest[worst] > SAME_ORIENTATION:
            raise MeasurementError(
                f"{table.title}, line {table.line[rows[worst]]}: {' '.join(family.columns)} and {' '.join(other.columns)} "
                f"are two orientations, {np.degrees(nearest[worst]):.3g} degrees apart. Delete the one that was not "
                "measured, or call its columns commanded"
            )


def _writings(table: Table, used: set[str], rows: np.ndarray, reading: Reading) -> list[tuple[Family, list[Writing]]]:
    """Columns that may be an orientation, the likeliest first, and every way to read each, the best first."""
    free = [name for name in table.names if name and name not in used]
    found = []
    for family in (*quaternions(free), *angle_triples(free)):
        values = _sensible(table, family.columns)[rows]
        named = set(family.columns) == set(QUATERNION) and np.isfinite(table.matrix(family.columns)).any()
        norm = np.linalg.norm(values, axis=1)
        if len(family.columns) == 4 and np.isfinite(norm).any() and abs(float(np.nanmedian(norm)) - 1) <= UNIT_SLACK:
            values[norm < NO_ROTATION] = np.nan
            found.append((family, quaternion_writings(family, values, reading)))
        elif len(family.columns) == 3 and np.isfinite(norm).any():
            found.append((family, angle_writings(family, values, reading)))
        elif named:
            raise MeasurementError(
                f"{table.title}: {' '.join(family.columns)} hold no quaternions of norm 1: mend them, or delete these columns if "
                "no orientation was measured"
            )
    return found


def _sensible(table: Table, columns: Sequence[str]) -> np.ndarray:
    """Columns as numbers, shape (N, columns); NaN where there is none, or one so large that it stands for a hole."""
    values = table.matrix(columns)
    return np.where(np.abs(values) <= ABSURD, values, np.nan)


def _gravity(reading: Reading, made: Proposal) -> None:
    """Say whether the robot stands upright, as far as the instrument does."""
    cosine = np.clip(reading.world[0][2, 2], -1, 1)
    tilt = float(np.degrees(np.arccos(cosine)))
    if tilt < UPRIGHT:
        made.say("robot.gravity", None, f"along -z of the base, whose z is {tilt:.1f}° from the instrument's")
        return
    why = f"the default is -z of the base, whose z is {tilt:.0f}° from the instrument's. Is the instrument levelled?"
    made.say("robot.gravity", None, f"{why} Then write `gravity: world`", sure=False)
