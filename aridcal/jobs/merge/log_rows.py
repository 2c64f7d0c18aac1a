"""Two logs of one motion as a table of measurements: a row for each standstill that both have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.files.orientations import QUATERNION
from aridcal.files.quantities import POSITION_COLUMNS, STD
from aridcal.files.yaml_file import FINEST
from aridcal.jobs.merge.alignment import Moves, align_frames, improved, jump, window_means
from aridcal.jobs.merge.averages import Averages, averages, without_spikes
from aridcal.jobs.merge.clocks import MOST_DRIFT, Clocks
from aridcal.jobs.merge.log import Log, without_blind_samples
from aridcal.jobs.merge.log_files import JointLog, TrackerLog
from aridcal.jobs.merge.offsets import FEWEST_STANDSTILLS, best_offset, too_few
from aridcal.jobs.merge.other_columns import window_values
from aridcal.jobs.merge.pairs import FEWEST_SAMPLES as FEWEST_SAMPLES
from aridcal.jobs.merge.pairs import Pairs, pairs, settled, window_samples
from aridcal.jobs.merge.standstills import Standstills, limit_of, speeds, standstills
from aridcal.jobs.merge.tracker_format import TrackerRows, in_si, tracked
from aridcal.jobs.prepare.campaign_proposal import STRANGE_SHARE
from aridcal.jobs.prepare.condition_columns import SAMPLES_COLUMN
from aridcal.jobs.prepare.guesses import Chooser
from aridcal.system.errors import MeasurementError

FAR_RATIO = 10.0
"""Times the usual distance from the nominal robot beyond which a row is refused."""

ALIGNMENT_ROUNDS = 12
"""Of the alignment; it is done when clocks move by less than :data:`CLOCK_CHANGE_AT_END` anywhere in the log."""

CLOCK_CHANGE_AT_END = 1e-5
"""[s]: a target at 1 m/s moves by 10 micrometres in it."""

TIME_COLUMN = "time"
"""Column of a row's time, by the joints' clock."""


@dataclass(frozen=True)
class UnpairedStandstill:
    """A standstill that makes no row.

    Attributes:
        log: Title of the log that has it.
        begin: By that log's clock, [s].
        end: Likewise.
        why: The reason, in words.
    """

    log: str
    begin: float
    end: float
    why: str

    def __str__(self) -> str:
        return f"{self.log}, {self.begin:.3f} to {self.end:.3f} s: {self.why}"


@dataclass(frozen=True)
class MergeResult:
    """Rows from two logs, and how they were made.

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
        pairs: Windows behind the rows, K of them.
        averages: Of these windows.
        off: Measured minus nominal at each row, frames fitted, shape (K, 3), [m].
        unpaired: Standstills that make no row.
        notices: What a user should know.
    """

    table: pd.DataFrame
    clocks: Clocks
    correlation: float
    moves: Moves
    joints: Log
    still: Standstills
    tips: np.ndarray
    tracker: TrackerRows
    tracked: Standstills
    pairs: Pairs
    averages: Averages
    off: np.ndarray
    unpaired: tuple[UnpairedStandstill, ...]
    notices: tuple[str, ...]


def merged(robot: Robot, joints: JointLog, measured: TrackerLog, asker: Chooser) -> MergeResult:
    """Join two logs.

    Args:
        robot: The chain.
        joints: Its readings over time.
        measured: What a tracker measured, as it is written.
        asker: Asked where the logs leave a choice that changes numbers.

    Raises:
        AridcalError: the logs cannot be joined; saying why, and what to do.
    """
    place = _moving_place(measured.log, measured.places)
    tracker = without_blind_samples(measured.log, place)
    raw = tracker.of(place)
    tracker_still = standstills(tracker, raw)
    best, units = best_offset(robot, joints, tracker, raw, tracker_still, _still(joints))
    q = joints.readings(units)
    still = standstills(joints.log, q)
    paired = pairs(best.candidate.clocks, joints.log, still, tracker, tracker_still, 1.0)
    times = best.candidate.clocks
    means = window_means(joints.log, joints.log.values, times.joints(paired.begin), times.joints(paired.end))
    middles = np.searchsorted(tracker.time, 0.5 * (paired.begin + paired.end))
    si = tracked(robot, means, tracker, middles, asker)
    q = in_si(si.units, joints.log.values)
    still, tracker_still = standstills(joints.log, q), standstills(si.log, si.position)
    clocks, moves = _clocks_from_moves(times, robot, joints.log, q, still, si, tracker_still)
    jumped = jump(moves)
    if jumped is not None:
        raise MeasurementError(
            f"{si.log.title}: from {jumped[0]:.3f} s of its clock on everything is {abs(jumped[1]):.3g} s "
            f"{'later' if jumped[1] > 0 else 'earlier'} "
            "by the joints' clock than before: one of the clocks was set in between. Cut both logs there, and "
            "merge each part by itself"
        )
    if abs(clocks.drift) > MOST_DRIFT + 3.0 * float(np.sqrt(clocks.covariance[1, 1])):
        raise MeasurementError(
            f"{joints.log.title} and {si.log.title}: the clocks drift apart by {1e6 * clocks.drift:,.0f} ppm; good ones do by "
            f"less than 100, at most {1e6 * MOST_DRIFT:,.0f} are believed. Check the unit of both times, and that no clock was "
            "set in between"
        )
    windows_of_both = pairs(clocks, joints.log, still, si.log, tracker_still)
    paired, at_rest = settled(windows_of_both, si.log, si.position)
    creeping = [
        UnpairedStandstill(si.log.title, float(a), float(b), "the target never settles: wait longer at each pose")
        for a, b in zip(windows_of_both.begin[~at_rest], windows_of_both.end[~at_rest], strict=True)
    ]
    paired = paired.some(np.flatnonzero(at_rest))
    if len(paired) < FEWEST_STANDSTILLS:
        raise too_few(joints.log, si.log, len(paired))
    mean = window_means(joints.log, q, clocks.joints(paired.begin), clocks.joints(paired.end))
    windows = [window_samples(si.log.time, a, b) for a, b in zip(paired.begin, paired.end, strict=True)]
    samples, spikes = without_spikes(windows, si.position, si.steps[:3])
    average = averages(samples, si.position, si.quaternion, si.steps)
    _, residual = align_frames(robot, mean, average.position)
    _refuse_strange(residual, average.position, clocks.joints(0.5 * (paired.begin + paired.end)), si.log.title)
    table = _table(robot, mean, average, clocks.joints(0.5 * (paired.begin + paired.end)))
    own_columns = {*robot.readings, *POSITION_COLUMNS, *QUATERNION, *STD, TIME_COLUMN, SAMPLES_COLUMN}
    windows_of = {
        "joints": (joints.others, clocks.joints(paired.begin), clocks.joints(paired.end)),
        "tracker": (measured.others, paired.begin, paired.end),
    }
    columns, remarks = window_values(windows_of, own_columns)
    table = table.assign(**columns)
    spike_notes = (
        [f"{si.log.title}: {spikes} samples at standstill far from their neighbours: left out"] if spikes else []
    )
    unpaired = _unpaired(clocks, joints.log, still, si.log, tracker_still, windows_of_both)
    tips = speeds(joints.log, tip_frames(robot, q)[1])
    return MergeResult(
        table, clocks, best.candidate.correlation, moves, joints.log, still, tips, si, tracker_still, paired, average, residual,
        tuple(sorted([*unpaired, *creeping], key=lambda one: (one.log, one.begin))),
        (*joints.log.notes, *si.log.notes, *spike_notes, *remarks),
    )  # fmt: skip


def _moving_place(tracker: Log, places: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """The first place whose values move."""
    failure: MeasurementError | None = None
    for place in places:
        finite = np.isfinite(tracker.of(place)).all(axis=1)
        try:
            whole = tracker.keep(finite)
            limit_of(speeds(whole, whole.of(place)), tracker.title)
        except MeasurementError as problem:
            failure = failure or problem
        else:
            return place
    assert failure is not None
    raise failure


def _still(joints: JointLog) -> Standstills:
    """Standstills of the joints in the first of the units that they may be in: seconds do not depend on that."""
    return standstills(joints.log, joints.readings(joints.units[0]))


def _clocks_from_moves(
    clocks: Clocks,
    robot: Robot,
    joints: Log,
    q: np.ndarray,
    still: Standstills,
    si: TrackerRows,
    tracker_still: Standstills,
) -> tuple[Clocks, Moves]:
    """Offset and drift from all moves, round after round."""
    lasts = float(np.ptp(si.log.time))
    for _ in range(ALIGNMENT_ROUNDS):
        paired = pairs(clocks, joints, still, si.log, tracker_still, 1.0)
        if len(paired) < FEWEST_STANDSTILLS:
            raise too_few(joints, si.log, len(paired))
        better, moves = improved(clocks, robot, joints, q, si.log, si.position, paired)
        change = abs(better.offset - clocks.offset) + 0.5 * lasts * abs(better.drift - clocks.drift)
        clocks = better
        if change < CLOCK_CHANGE_AT_END:
            break
    return clocks, moves


def _refuse_strange(misses: np.ndarray, position: np.ndarray, time: np.ndarray, title: str) -> None:
    """Refuse rows that are much farther from the nominal robot than the others.

    Raises:
        MeasurementError: naming the first.
    """
    size = np.linalg.norm(misses, axis=1)
    spread = float(np.sqrt(np.mean(np.sum((position - position.mean(axis=0)) ** 2, axis=1))))
    far = np.flatnonzero((size > STRANGE_SHARE * spread) & (size > FAR_RATIO * np.median(size)))
    if len(far):
        raise MeasurementError(
            f"{title}: at {time[far[0]]:.3f} s of the joints' clock, the first of {len(far)} such among "
            f"{len(misses)} standstills, the target is {1e3 * size[far[0]]:.3g} mm from where the nominal robot has it, usually "
            f"{1e3 * np.median(size):.3g} mm. Target or tracker was moved, another target was seen, or a clock was set: cut both "
            "logs there, or delete these samples"
        )


def _table(robot: Robot, q: np.ndarray, average: Averages, time: np.ndarray) -> pd.DataFrame:
    """Rows in the order of time."""
    clash = sorted(set(robot.readings) & {*POSITION_COLUMNS, *QUATERNION, *STD, TIME_COLUMN, SAMPLES_COLUMN})
    if clash:
        raise MeasurementError(
            f"{robot.path.name}: a joint is called {clash[0]!r}, as a column of the table is; rename it"
        )
    columns: dict[str, np.ndarray] = {name: q[:, k] for k, name in enumerate(robot.readings)}
    columns |= dict(zip(POSITION_COLUMNS, average.position.T, strict=True))
    if average.quaternion is not None:
        columns |= dict(zip(QUATERNION, average.quaternion.T, strict=True))
    if (average.std > FINEST).all():  # of an instrument that rounds its noise away nothing is known
        columns |= dict(zip(STD, average.std.T, strict=False))
    columns |= {TIME_COLUMN: time, SAMPLES_COLUMN: average.count}
    return pd.DataFrame(columns)


def _unpaired(
    clocks: Clocks, joints: Log, still: Standstills, tracker: Log, tracker_still: Standstills, paired: Pairs
) -> list[UnpairedStandstill]:
    """Standstills of one log without a partner in the other, each with the reason."""
    unpaired = []
    for k in sorted(set(range(len(still))) - set(paired.joints.tolist())):
        a, b = (float(clocks.tracker(np.array([t]))[0]) for t in (still.begin[k], still.end[k]))
        rows = window_samples(tracker.time, a, b)
        if b < tracker.time[0] or a > tracker.time[-1]:
            why = "before or after the tracker's log"
        elif rows.stop - rows.start < max(FEWEST_SAMPLES, 0.5 * (b - a) / tracker.period):
            why = "the tracker lost its target: few samples or none"
        elif not np.any((tracker_still.begin < b) & (tracker_still.end > a)):
            why = "the tracker's target moves"
        else:
            why = "both stand together for too short a time"
        unpaired.append(UnpairedStandstill(joints.title, float(still.begin[k]), float(still.end[k]), why))
    for k in sorted(set(range(len(tracker_still))) - set(paired.tracker.tolist())):
        a, b = (float(clocks.joints(np.array([t]))[0]) for t in (tracker_still.begin[k], tracker_still.end[k]))
        if b < joints.time[0] or a > joints.time[-1]:
            why = "before or after the joints' log"
        elif not np.any((still.begin < b) & (still.end > a)):
            why = "the joints move, or have no samples"
        else:
            why = "both stand together for too short a time"
        unpaired.append(
            UnpairedStandstill(tracker.title, float(tracker_still.begin[k]), float(tracker_still.end[k]), why)
        )
    return unpaired
