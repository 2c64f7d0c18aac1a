"""Two logs of one motion as a table of measurements: a row for each standstill that both have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.files.orientations import QUATERNION
from aridcal.files.quantities import POSITION, STD
from aridcal.files.yaml_file import FINEST
from aridcal.jobs.merge.alignment import Moves, improved, jump, placed, window_means
from aridcal.jobs.merge.averages import Averages, averages, without_spikes
from aridcal.jobs.merge.clocks import MOST_DRIFT, Clocks
from aridcal.jobs.merge.log import Log, seen
from aridcal.jobs.merge.log_files import JointLog, TrackerLog
from aridcal.jobs.merge.offsets import FEWEST, best_offset, too_few
from aridcal.jobs.merge.others import carried
from aridcal.jobs.merge.pairs import FEWEST as FEWEST_SAMPLES
from aridcal.jobs.merge.pairs import Pairs, pairs, settled, within
from aridcal.jobs.merge.standstills import Standstills, limit_of, speeds, standstills
from aridcal.jobs.merge.written_as import Tracked, in_si, tracked
from aridcal.jobs.prepare.condition_columns import SAMPLES
from aridcal.jobs.prepare.guesses import Asker
from aridcal.jobs.prepare.propose import STRANGE_SHARE
from aridcal.system.errors import MeasurementError

FAR = 10.0
"""Times the usual distance from the nominal robot that no row is off by."""

ROUNDS = 12
"""Of the alignment; it is done when clocks move by less than :data:`ENOUGH` anywhere in the log."""

ENOUGH = 1e-5
"""[s]: a target at 1 m/s moves by 10 micrometres in it."""

TIME = "time"
"""Column of a row's time, by the joints' clock."""


@dataclass(frozen=True)
class Unpaired:
    """A standstill that makes no row.

    Attributes:
        log: Whose.
        begin: By its own clock, [s].
        end: Likewise.
        why: In words.
    """

    log: str
    begin: float
    end: float
    why: str

    def __str__(self) -> str:
        return f"{self.log}, {self.begin:.3f} to {self.end:.3f} s: {self.why}"


@dataclass(frozen=True)
class Merged:
    """What came of two logs.

    Attributes:
        table: A row for each standstill, SI.
        clocks: How the tracker's clock becomes the joints'.
        correlation: Of the speeds in both.
        moves: What each move says of the clocks.
        joints: The joints' log.
        still: Its standstills, and the speeds of the nominal tip beside them, shape (N,), [m/s].
        tips: See ``still``.
        tracker: The tracker's log, in SI.
        tracked: Its standstills, speeds in [m/s].
        found: Windows behind the rows.
        averages: Of these.
        off: Measured minus nominal at each row, frames fitted, shape (K, 3), [m].
        unpaired: What makes no row.
        notices: What a user should know.
    """

    table: pd.DataFrame
    clocks: Clocks
    correlation: float
    moves: Moves
    joints: Log
    still: Standstills
    tips: np.ndarray
    tracker: Tracked
    tracked: Standstills
    found: Pairs
    averages: Averages
    off: np.ndarray
    unpaired: tuple[Unpaired, ...]
    notices: tuple[str, ...]


def merged(robot: Robot, joints: JointLog, measured: TrackerLog, asker: Asker) -> Merged:
    """Join two logs.

    Args:
        robot: The chain.
        joints: Its readings over time.
        measured: What a tracker measured, as it is written.
        asker: Asked where the logs leave a choice that changes numbers.

    Raises:
        AridcalError: the logs cannot be joined; saying why, and what to do.
    """
    place = _moving(measured.log, measured.places)
    tracker = seen(measured.log, place)
    raw = tracker.of(place)
    seen_still = standstills(tracker, raw)
    best, units = best_offset(robot, joints, tracker, raw, seen_still, _still(joints))
    q = joints.readings(units)
    still = standstills(joints.log, q)
    found = pairs(best.candidate.clocks, joints.log, still, tracker, seen_still, 1.0)
    times = best.candidate.clocks
    means = window_means(joints.log, joints.log.values, times.joints(found.begin), times.joints(found.end))
    middles = np.searchsorted(tracker.time, 0.5 * (found.begin + found.end))
    si = tracked(robot, means, tracker, middles, asker)
    q = in_si(si.units, joints.log.values)
    still, seen_still = standstills(joints.log, q), standstills(si.log, si.position)
    clocks, moves = _aligned(times, robot, joints.log, q, still, si, seen_still)
    late = jump(moves)
    if late is not None:
        raise MeasurementError(
            f"{si.log.title}: from {late[0]:.3f} s of its clock on everything is {abs(late[1]):.3g} s "
            f"{'later' if late[1] > 0 else 'earlier'} "
            "by the joints' clock than before: one of the clocks was set in between. Cut both logs there, and "
            "merge each part by itself"
        )
    if abs(clocks.drift) > MOST_DRIFT + 3.0 * float(np.sqrt(clocks.covariance[1, 1])):
        raise MeasurementError(
            f"{joints.log.title} and {si.log.title}: the clocks drift apart by {1e6 * clocks.drift:,.0f} ppm; good ones do by "
            f"less than 100, at most {1e6 * MOST_DRIFT:,.0f} are believed. Check the unit of both times, and that no clock was "
            "set in between"
        )
    wide = pairs(clocks, joints.log, still, si.log, seen_still)
    found, good = settled(wide, si.log, si.position)
    creeping = [
        Unpaired(si.log.title, float(a), float(b), "the target never settles: wait longer at each pose")
        for a, b in zip(wide.begin[~good], wide.end[~good], strict=True)
    ]
    found = found.some(np.flatnonzero(good))
    if len(found) < FEWEST:
        raise too_few(joints.log, si.log, len(found))
    mean = window_means(joints.log, q, clocks.joints(found.begin), clocks.joints(found.end))
    windows = [within(si.log.time, a, b) for a, b in zip(found.begin, found.end, strict=True)]
    samples, spikes = without_spikes(windows, si.position, si.steps[:3])
    average = averages(samples, si.position, si.quaternion, si.steps)
    _, off = placed(robot, mean, average.position)
    _refuse_strange(off, average.position, clocks.joints(0.5 * (found.begin + found.end)), si.log.title)
    table = _table(robot, mean, average, clocks.joints(0.5 * (found.begin + found.end)))
    own = {*robot.readings, *POSITION, *QUATERNION, *STD, TIME, SAMPLES}
    windows_of = {
        "joints": (joints.others, clocks.joints(found.begin), clocks.joints(found.end)),
        "tracker": (measured.others, found.begin, found.end),
    }
    further, said = carried(windows_of, own)
    table = table.assign(**further)
    spiked = [f"{si.log.title}: {spikes} samples at standstill far from their neighbours: left out"] if spikes else []
    alone = _alone(clocks, joints.log, still, si.log, seen_still, wide)
    tips = speeds(joints.log, tip_frames(robot, q)[1])
    return Merged(
        table, clocks, best.candidate.correlation, moves, joints.log, still, tips, si, seen_still, found, average, off,
        tuple(sorted([*alone, *creeping], key=lambda one: (one.log, one.begin))),
        (*joints.log.notes, *si.log.notes, *spiked, *said),
    )  # fmt: skip


def _moving(tracker: Log, places: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """The first place that moves."""
    failed: MeasurementError | None = None
    for place in places:
        there = np.isfinite(tracker.of(place)).all(axis=1)
        try:
            whole = tracker.keep(there)
            limit_of(speeds(whole, whole.of(place)), tracker.title)
        except MeasurementError as problem:
            failed = failed or problem
        else:
            return place
    assert failed is not None
    raise failed


def _still(joints: JointLog) -> Standstills:
    """Standstills of the joints in the first of the units that they may be in: seconds do not depend on that."""
    return standstills(joints.log, joints.readings(joints.units[0]))


def _aligned(
    clocks: Clocks, robot: Robot, joints: Log, q: np.ndarray, still: Standstills, si: Tracked, seen_still: Standstills
) -> tuple[Clocks, Moves]:
    """Offset and drift from all moves, round after round."""
    lasts = float(np.ptp(si.log.time))
    for _ in range(ROUNDS):
        found = pairs(clocks, joints, still, si.log, seen_still, 1.0)
        if len(found) < FEWEST:
            raise too_few(joints, si.log, len(found))
        better, moves = improved(clocks, robot, joints, q, si.log, si.position, found)
        change = abs(better.offset - clocks.offset) + 0.5 * lasts * abs(better.drift - clocks.drift)
        clocks = better
        if change < ENOUGH:
            break
    return clocks, moves


def _refuse_strange(off: np.ndarray, position: np.ndarray, time: np.ndarray, title: str) -> None:
    """Refuse rows that no nominal robot is so far from, though it is near the others.

    Raises:
        MeasurementError: naming the first.
    """
    size = np.linalg.norm(off, axis=1)
    spread = float(np.sqrt(np.mean(np.sum((position - position.mean(axis=0)) ** 2, axis=1))))
    strange = np.flatnonzero((size > STRANGE_SHARE * spread) & (size > FAR * np.median(size)))
    if len(strange):
        raise MeasurementError(
            f"{title}: at {time[strange[0]]:.3f} s of the joints' clock, the first of {len(strange)} such among "
            f"{len(off)} standstills, the target is {1e3 * size[strange[0]]:.3g} mm from where the nominal robot has it, usually "
            f"{1e3 * np.median(size):.3g} mm. Target or tracker was moved, another target was seen, or a clock was set: cut both "
            "logs there, or delete these samples"
        )


def _table(robot: Robot, q: np.ndarray, average: Averages, time: np.ndarray) -> pd.DataFrame:
    """Rows in the order of time."""
    clash = sorted(set(robot.readings) & {*POSITION, *QUATERNION, *STD, TIME, SAMPLES})
    if clash:
        raise MeasurementError(
            f"{robot.path.name}: a joint is called {clash[0]!r}, as a column of the table is; rename it"
        )
    columns: dict[str, np.ndarray] = {name: q[:, k] for k, name in enumerate(robot.readings)}
    columns |= dict(zip(POSITION, average.position.T, strict=True))
    if average.quaternion is not None:
        columns |= dict(zip(QUATERNION, average.quaternion.T, strict=True))
    if (average.std > FINEST).all():  # of an instrument that rounds its noise away nothing is known
        columns |= dict(zip(STD, average.std.T, strict=False))
    columns |= {TIME: time, SAMPLES: average.count}
    return pd.DataFrame(columns)


def _alone(
    clocks: Clocks, joints: Log, still: Standstills, tracker: Log, seen_still: Standstills, found: Pairs
) -> list[Unpaired]:
    """Standstills that one log has and the other has not, each with the reason."""
    alone = []
    for k in sorted(set(range(len(still))) - set(found.joints.tolist())):
        a, b = (float(clocks.tracker(np.array([t]))[0]) for t in (still.begin[k], still.end[k]))
        rows = within(tracker.time, a, b)
        if b < tracker.time[0] or a > tracker.time[-1]:
            why = "before or after the tracker's log"
        elif rows.stop - rows.start < max(FEWEST_SAMPLES, 0.5 * (b - a) / tracker.period):
            why = "the tracker lost its target: few samples or none"
        elif not np.any((seen_still.begin < b) & (seen_still.end > a)):
            why = "the tracker's target moves"
        else:
            why = "both stand together for too short a time"
        alone.append(Unpaired(joints.title, float(still.begin[k]), float(still.end[k]), why))
    for k in sorted(set(range(len(seen_still))) - set(found.tracker.tolist())):
        a, b = (float(clocks.joints(np.array([t]))[0]) for t in (seen_still.begin[k], seen_still.end[k]))
        if b < joints.time[0] or a > joints.time[-1]:
            why = "before or after the joints' log"
        elif not np.any((still.begin < b) & (still.end > a)):
            why = "the joints move, or have no samples"
        else:
            why = "both stand together for too short a time"
        alone.append(Unpaired(tracker.title, float(seen_still.begin[k]), float(seen_still.end[k]), why))
    return alone
