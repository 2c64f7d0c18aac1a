"""Propose a campaign for a URDF and tables of measurements: names say what may be meant, the nominal robot what is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from aridcal.campaign import ANGLES, LENGTHS
from aridcal.columns import (
    SCATTER,
    Family,
    angle_triples,
    match_joints,
    named,
    numbered,
    positions,
    quaternions,
    unit,
    words,
)
from aridcal.dialect import Reading, Sample, angle_writings, quaternion_writings, readings
from aridcal.errors import MeasurementError, RobotError
from aridcal.measurements import blocks
from aridcal.quality import joint_kinds
from aridcal.robot import Robot, links, parse_robot
from aridcal.source import POSITION, STD
from aridcal.tables import Table

SAMPLE = 150  # rows that judge; more make no clearer verdict
CLEAR = 3.0  # times better than the next: no more a matter of taste
STRANGE_SHARE, STRANGE_ANGLE = 0.05, 0.2  # no nominal robot is off by so much: of the targets' spread; [rad]
UNIT_SLACK = 0.05  # how far from 1 the norms of a quaternion's columns may be
UPRIGHT = 5.0  # [deg]: the base's z is the instrument's
TIPS = ("tool0", "flange", "ee_link", "tcp")
HOW = {"similar name": "names alike", "number": "by their numbers", "order": "by their ORDER along the chain"}

Choose = Callable[[str, Sequence[str], str], int | None]
"""Asks a question with its possible answers, the likeliest first, and why; returns the answer's number, None without."""


@dataclass(frozen=True)
class Guess:
    """One thing that a campaign says, and why.

    Attributes:
        key: Where it stands in the campaign, ``measurements.units`` for instance; without a dot: a mere remark.
        value: What stands there; None: nothing, the default holds.
        why: The evidence.
        sure: False if a person should look at it.
    """

    key: str
    value: Any
    why: str
    sure: bool = True


@dataclass
class Proposal:
    """What was found in a URDF and a table, in the order in which it was found."""

    robot: Robot
    guesses: list[Guess] = field(default_factory=list)

    def say(self, key: str, value: Any, why: str, sure: bool = True) -> None:
        """Add a guess."""
        self.guesses.append(Guess(key, value, why, sure))

    def say_columns(self, columns: dict[str, str], why: str, sure: bool = True) -> None:
        """Add the columns of joints or quantities; those that have their own name need no entry."""
        for quantity, column in columns.items():
            self.say(f"measurements.columns.{quantity}", None if column == quantity else column, why, sure)


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
    robot, joints, how, sure = _chain(urdf, path, table, choose)
    made = Proposal(robot)
    made.say("robot.base", robot.base, "the URDF's root link")
    ends = f"{robot.names[0]} … {robot.names[-1]}" if len(robot.names) > 1 else robot.names[0]
    made.say("robot.tip", robot.tip, f"end of the chain {ends}; anything rigid after the last joint does as well", sure)
    made.say_columns(joints, HOW.get(how, "named as in the URDF"), sure=how != "order")
    used = set(joints.values())
    place = _position(table, used, choose, made)
    used |= {*place.columns, *_split(table, used, made)}
    sample, rows = _sample(table, robot, [joints[name] for name in robot.readings], place)
    reading = _units(sample, robot, [*joints.values(), *place.columns], choose, made)
    used |= _orientation(table, used, rows, reading, choose, made)
    _gravity(reading, made)
    _covariates(table, used, made)
    _repeats(_numbers(table, [joints[name] for name in robot.readings]), reading, made)
    return made


def _chain(urdf: bytes, path: Path, table: Table, choose: Choose) -> tuple[Robot, dict[str, str], str, bool]:
    """The longest chain whose joints all have columns, those columns, how they were matched, and if its tip is sure."""
    names = [name for name in table.names if name]
    chains: dict[tuple[str, ...], list[Robot]] = {}
    why: RobotError | None = None
    for link in links(urdf, path):
        try:
            robot = parse_robot(urdf, link, None, path)
        except RobotError as error:
            why = error
        else:
            chains.setdefault(robot.readings, []).append(robot)
    if not chains:
        raise why or RobotError(f"{path}: has no links")
    found = {joints: match for joints in chains if (match := match_joints(joints, names))}
    if not found:
        lacking = [joint for joint in max(chains, key=len) if joint not in names]
        raise MeasurementError(
            f"{table.title}: no columns for the joints {', '.join(lacking)}. Its columns are {', '.join(names)}. Name "
            "the joints' columns as in the URDF, or number them q1, q2, … along the chain"
        )
    best = max(found, key=lambda joints: (found[joints][1] != "order", len(joints)))
    longer = [joints for joints in chains if set(joints) > set(best) and (set(joints) - set(best)) & set(names)]
    if longer:
        lacking = [joint for joint in longer[0] if joint not in best and joint not in names]
        raise MeasurementError(
            f"{table.title}: no columns for the joints {', '.join(lacking)}, though for joints beyond"
        )
    ends = sorted(chains[best], key=lambda r: (TIPS.index(r.tip) if r.tip in TIPS else len(TIPS), r.tip_joint is None))
    picked, sure = 0, True
    if len(ends) > 1 and ends[0].tip not in TIPS:
        about = "all are rigid after the last joint: take what your programs call the tool"
        picked, sure = _ask(choose, "which link is the tip", [robot.tip for robot in ends], about)
    return ends[picked], *found[best], sure


def _ask(choose: Choose, question: str, answers: Sequence[str], why: str) -> tuple[int, bool]:
    """The answer's number, the first if nobody answers, and whether somebody did."""
    answer = choose(question, answers, why)
    return answer or 0, answer is not None


def _position(table: Table, used: set[str], choose: Choose, made: Proposal) -> Family:
    families = positions(name for name in table.names if name and name not in used)
    families = [family for family in families if np.isfinite(_numbers(table, family.columns)).any()]
    if not families:
        raise MeasurementError(f"{table.title}: no columns for the target's position: call them x, y and z")
    options = [" ".join(family.columns) for family in families]
    picked, sure = 0, not families[0].commanded
    if len(families) > 1 and not families[1].commanded:
        picked, sure = _ask(choose, "which columns are the measured position", options, "more than one may be")
    passed = [option for k, option in enumerate(options) if k != picked]
    why = "the measured position" + (f", not {' or '.join(passed)}" if passed else "")
    columns = dict(zip(POSITION, families[picked].columns, strict=True))
    made.say_columns(columns, why, sure)
    return families[picked]


def _split(table: Table, used: set[str], made: Proposal) -> list[str]:
    """The column, if any, that tells rows to train with from rows to test with; a `station` is spoken for as well."""
    found = [name for name in table.names if name not in used and set(table.texts(name)) <= {"train", "test"}]
    for name in found[:1]:
        made.say_columns({"split": name}, f"the column {name} says train or test: it is kept to")
    return [*found[:1], *(["station"] if "station" in table.cells else [])]


def _numbers(table: Table, columns: Iterable[str]) -> np.ndarray:
    """Columns as they stand, shape (N, columns), NaN where there is no number."""
    return np.column_stack([table.numbers(name)[0] for name in columns])


def _sample(table: Table, robot: Robot, joints: Sequence[str], place: Family) -> tuple[Sample, np.ndarray]:
    """Rows to judge by, and their numbers in the table."""
    q, position = _numbers(table, joints), _numbers(table, place.columns)
    whole = np.flatnonzero(np.isfinite(q).all(axis=1) & np.isfinite(position).all(axis=1))
    if len(whole) < 4:
        raise MeasurementError(f"{table.title}: {len(whole)} rows have all joints and positions; 4 are the least")
    rows = np.sort(np.random.default_rng(0).permutation(whole)[:SAMPLE])
    labels = table.texts("station")[rows] if "station" in table.cells else np.zeros(len(rows))
    turning = np.array([kind != "prismatic" for kind in joint_kinds(robot)])
    return Sample(q[rows], turning, position[rows], np.unique(labels, return_inverse=True)[1]), rows


def _units(sample: Sample, robot: Robot, columns: Sequence[str], choose: Choose, made: Proposal) -> Reading:
    """Keep the units, and the frames per station, that the nominal robot agrees with."""
    tried = readings(sample, robot)
    best = next(r for r in tried if r.per is None)
    if tried[0].per and tried[0].share * CLEAR < best.share:
        why = f"stations that share it: {1e3 * best.metres:.3g} mm off; one each: {1e3 * tried[0].metres:.3g} mm"
        made.say(f"frames.{tried[0].per}", {"per": "station"}, why)
        best = tried[0]
    if best.travel != best.length:
        raise MeasurementError(
            f"positions are in {best.length} but joints that slide in {best.travel}: `units` speaks of all lengths of "
            "a file. Convert one of them, in a spreadsheet for instance, and run this again"
        )
    near = [r for r in tried if r.per == best.per and (r.travel == r.length or r is best)][:4]
    clear = len(near) == 1 or near[1].share > CLEAR * near[0].share
    if not clear:
        names = [f"{r.angle} and {r.length}" for r in near]
        about = "they fit the nominal robot alike"
        picked, clear = _ask(choose, "which units have joints and positions", names, about)
        best = near[picked]
    said = {unit(column) for column in columns} - {None}
    why = "as the header says: " if said and said <= {best.angle, best.length} else ""
    why += f"in {best.angle} and {best.length} the nominal robot misses the targets by {1e3 * best.metres:.3g} mm"
    why += f" ({100 * best.share:.2g} % of their spread)"
    others = [f"; in {r.angle} and {r.length} by {100 * r.share:.2g} %" for r in near if r is not best]
    why += others[0] if others else ""
    if best.share > STRANGE_SHARE:
        why += ". That is MUCH: check that the URDF is this robot's, each joint's column, sign and zero, and whether tracker"
        why += " or target were moved in between (then give each place its label in a column `station`)"
    units = (("length", best.length, "m"), ("angle", best.angle, "rad"))
    value = {key: unit for key, unit, default in units if unit != default}
    made.say("measurements.units", value or None, why, sure=clear and best.share <= STRANGE_SHARE)
    return best


def _orientation(
    table: Table, used: set[str], rows: np.ndarray, reading: Reading, choose: Choose, made: Proposal
) -> set[str]:
    """Keep the writing of orientations that the nominal robot agrees with; returns its columns."""
    free = [name for name in table.names if name and name not in used]
    for family in (*quaternions(free), *angle_triples(free)):
        values = _numbers(table, family.columns)[rows]
        if not np.isfinite(values).all(axis=1).any():
            continue
        norm = float(np.nanmedian(np.linalg.norm(values, axis=1)))
        if len(family.columns) == 4 and abs(norm - 1) > UNIT_SLACK:
            continue
        ways = (quaternion_writings if len(family.columns) == 4 else angle_writings)(family, values, reading)
        break
    else:
        made.say("measurements.kind", "position", "no columns of an orientation", sure=False)
        return set()
    best, clear = ways[0], len(ways) == 1 or ways[1].misfit > CLEAR * ways[0].misfit
    if not clear:
        about = "they fit the nominal robot alike"
        picked, clear = _ask(choose, "how are orientations written", [way.what for way in ways[:4]], about)
        best = ways[picked]
    if best.angle not in (None, reading.angle):
        raise MeasurementError(
            f"{table.title}: joints are in {reading.angle} but {' '.join(family.columns)} in {best.angle}: `units` "
            "speaks of all angles of a file. Convert one of them, in a spreadsheet for instance, and run this again"
        )
    others = [f"{way.what} by {1e3 * way.misfit:.3g}" for way in ways if way is not best][:1]
    why = f"{best.what} misses the nominal robot's orientations by {1e3 * best.misfit:.3g} mrad"
    why += f"; {others[0]}" if others else ""
    if best.misfit > STRANGE_ANGLE:
        why += ". That is MUCH: check their order, and that they turn the target into the world and not back"
    made.say("measurements.kind", "pose", "positions and orientations")
    for key, value in best.keys.items():
        made.say(key, value, why, sure=clear and best.misfit <= STRANGE_ANGLE)
    return set(family.columns)


def _gravity(reading: Reading, made: Proposal) -> None:
    """Say whether the robot stands upright, as far as the instrument does."""
    tilt = float(np.degrees(np.arccos(np.clip(reading.world[0][2, 2], -1, 1))))
    if tilt < UPRIGHT:
        made.say("robot.gravity", None, f"along -z of the base, whose z is {tilt:.1f}° from the instrument's")
        return
    why = (
        f"the default is -z of the base, whose z is {tilt:.0f}° from the instrument's. Is the instrument levelled? Then"
    )
    made.say("robot.gravity", None, f"{why} write `gravity: world`", sure=False)


def _covariates(table: Table, used: set[str], made: Proposal) -> None:
    """What is left: sigmas of the rows, covariates, and columns that are neither."""
    std = [name for name in STD if name in table.cells]
    why = "not known: it is estimated. If you know it, write {position: …, rotation: …}, 1 sigma per axis, m and rad"
    if std:
        why = f"{' '.join(std)} weigh the rows; if they flatter the instrument, write {{rows: ignore}}"
    made.say("measurements.noise", None, why)
    free = [name for name in table.names if name and name not in used and name not in STD]
    for quantity, taken_for, spellings in (
        ("time", "s", ("time", "timestamp", "stamp", "t")),
        ("temperature", "°C", ("temperature", "temp")),
        ("payload", "kg", ("payload", "load")),
    ):
        column = named(free, *spellings)
        if column and np.isfinite(table.numbers(column)[0]).any():
            free.remove(column)
            made.say_columns({quantity: column}, f"by its name, taken for {taken_for}")
    ignored = {name: reason for name in free if (reason := _no_covariate(table, name, free))}
    if ignored:
        why = ", ".join(f"{name} ({reason})" for name, reason in ignored.items())
        made.say("measurements.ignore", list(ignored), f"no covariates: {why}", sure=False)
    kept = [name for name in free if name not in ignored]
    if kept:
        made.say(
            "covariates", None, f"effects may depend on {', '.join(kept)}; name under `ignore` what is none", False
        )


def _no_covariate(table: Table, name: str, free: Sequence[str]) -> str:
    """Why no effect can sensibly depend on a column; empty if one can."""
    if name.endswith("_direction"):
        return ""
    if set(words(name)) & SCATTER:
        return "how well something was measured"
    values = table.numbers(name)[0]
    values = values[np.isfinite(values)]
    if not len(values):
        return "no numbers"
    if len(values) > 2 and np.all(np.diff(values) == 1):
        return "counts the rows"
    if np.ptp(values) == 0:
        return "never changes"
    families = (*positions(free), *angle_triples(free), *quaternions(free), *numbered(free))
    return "of another pose or chain" if any(name in family.columns for family in families) else ""


def _repeats(q: np.ndarray, reading: Reading, made: Proposal) -> None:
    kinds = joint_kinds(made.robot)
    scale = [LENGTHS[reading.length] if kind == "prismatic" else ANGLES[reading.angle] for kind in kinds]
    sizes = np.bincount(blocks((q * scale)[np.isfinite(q).all(axis=1)], kinds))
    repeated = sizes[sizes > 1]
    why = f"{repeated.sum()} rows repeat {len(repeated)} configurations: they tell the noise by itself"
    made.say(
        "repeats", None, why if len(repeated) else "no configuration is repeated: that would tell the noise by itself"
    )
