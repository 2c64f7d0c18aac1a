"""Two logs of one motion as a table of measurements: a row for each standstill that both have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from aridcal.errors import MeasurementError
from aridcal.inputs.orientations import QUATERNION
from aridcal.inputs.quantities import FINEST, POSITION, STD
from aridcal.logs.alignment import Moves, improved, jump, placed, window_means
from aridcal.logs.averages import Averages, averages
from aridcal.logs.clocks import Candidate, Clocks, candidates
from aridcal.logs.log import Log, seen
from aridcal.logs.log_files import JointLog
from aridcal.logs.pairs import FEWEST as FEWEST_SAMPLES
from aridcal.logs.pairs import Pairs, pairs, resolution, settled, within
from aridcal.logs.standstills import Standstills, limit_of, speeds, standstills
from aridcal.logs.written_as import Tracked, in_si, tracked
from aridcal.prepare.covariates import SAMPLES
from aridcal.prepare.guesses import Asker
from aridcal.prepare.orientation_columns import CLEAR
from aridcal.prepare.propose import SAMPLE, STRANGE_SHARE
from aridcal.prepare.units_and_angles import Sample, readings
from aridcal.robot.chain import Robot
from aridcal.robot.kinematics import tip_frames

FEWEST = 6
"""Standstills that both logs share at least: the frames alone take nine numbers, and any three fit any three."""

MANY = 0.5
"""Of two offsets that of which fewer than this share of the other's standstills pair is no rival: few fit anything."""

SHOWN_OFFSETS = 5
"""Offsets that a message names."""

SAME = 1.5
"""Offsets that are nearer are one, [s]: candidates are a cell of their grid wide, and drifts blur them."""

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


@dataclass(frozen=True)
class _Judged:
    """A candidate, and how near the nominal robot comes at the standstills that it pairs."""

    candidate: Candidate
    found: Pairs
    share: float


def merged(robot: Robot, joints: JointLog, tracker: Log, places: tuple[tuple[str, ...], ...], asker: Asker) -> Merged:
    """Join two logs.

    Args:
        robot: The chain.
        joints: Its readings over time.
        tracker: What a tracker measured, as it is written.
        places: Columns that may be the place, the likeliest first.
        asker: Asked where the logs leave a choice that changes numbers.

    Raises:
        AridcalError: the logs cannot be joined; saying why, and what to do.
    """
    place = _moving(tracker, places)
    tracker = seen(tracker, place)
    raw = tracker.of(place)
    seen_still = standstills(tracker, raw)
    best, units = _best(robot, joints, tracker, raw, seen_still, _still(joints))
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
    wide = pairs(clocks, joints.log, still, si.log, seen_still)
    found, good = settled(wide, si.log, si.position)
    creeping = [
        Unpaired(si.log.title, float(a), float(b), "the target never settles: wait longer at each pose")
        for a, b in zip(wide.begin[~good], wide.end[~good], strict=True)
    ]
    found = found.some(np.flatnonzero(good))
    if len(found) < FEWEST:
        raise _too_few(joints.log, si.log, len(found))
    mean = window_means(joints.log, q, clocks.joints(found.begin), clocks.joints(found.end))
    windows = [within(si.log.time, a, b) for a, b in zip(found.begin, found.end, strict=True)]
    average = averages(windows, si.position, si.quaternion, _steps(si))
    _, off = placed(robot, mean, average.position)
    table = _table(robot, mean, average, clocks.joints(0.5 * (found.begin + found.end)))
    alone = _alone(clocks, joints.log, still, si.log, seen_still, wide)
    tips = speeds(joints.log, tip_frames(robot, q)[1])
    return Merged(
        table, clocks, best.candidate.correlation, moves, joints.log, still, tips, si, seen_still, found, average, off,
        tuple(sorted([*alone, *creeping], key=lambda one: (one.log, one.begin))),
        (*joints.log.notes, *si.log.notes),
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


def _best(
    robot: Robot, joints: JointLog, tracker: Log, raw: np.ndarray, seen_still: Standstills, still: Standstills
) -> tuple[_Judged, tuple[str, ...]]:
    """The offset at which speeds are alike and the standstills fit the nominal robot.

    Raises:
        MeasurementError: there is none, or there are several.
    """
    tried: list[tuple[Candidate, tuple[str, ...]]] = []
    for units in joints.units:
        tips = tip_frames(robot, joints.readings(units))[1]
        tried += [(one, units) for one in candidates(joints.log, tips, tracker, raw)]
    judged: list[tuple[_Judged, tuple[str, ...]]] = []
    most = 0
    for candidate, units in tried:
        found = pairs(candidate.clocks, joints.log, still, tracker, seen_still, 1.0)
        most = max(most, len(found))
        if len(found) < FEWEST:
            continue
        some = found.some(np.sort(np.random.default_rng(0).permutation(len(found))[:SAMPLE]))
        clocks = candidate.clocks
        q = window_means(joints.log, joints.log.values, clocks.joints(some.begin), clocks.joints(some.end))
        m = window_means(tracker, raw, some.begin, some.end)
        turning = np.array([kind != "prismatic" for kind in robot.kinds])
        ways = readings(Sample(q, turning, m, np.zeros(len(q))), robot)
        if ways:
            judged.append((_Judged(candidate, found, ways[0].share), units))
    if not judged:
        if not tried:
            raise MeasurementError(
                f"{joints.log.title} and {tracker.title}: at no offset of the clocks are the speeds of the nominal "
                "tip and of the target "
                "alike for 20 s. Check that both are of one motion, and that the URDF is this robot's"
            )
        raise _too_few(joints.log, tracker, most)
    fullest = max(len(one.found) for one, _ in judged)
    rivals = [one for one in judged if len(one[0].found) >= MANY * fullest]
    best = min(rivals, key=lambda one: one[0].share)
    if best[0].share > STRANGE_SHARE:
        raise MeasurementError(
            f"{joints.log.title} and {tracker.title}: at the offset of the clocks at which they agree best the "
            "nominal robot misses the "
            f"targets by {100 * best[0].share:.2g} % of their spread. Check that both logs are of one motion, that "
            "the URDF is this robot's, "
            "each joint's column and sign, and that neither tracker nor target was moved in between"
        )
    apart = [
        one for one, _ in judged
        if abs(one.candidate.clocks.offset - best[0].candidate.clocks.offset) > SAME
        and one.share <= CLEAR * best[0].share
        and len(one.found) >= MANY * len(best[0].found)
    ]  # fmt: skip
    if apart:
        offsets = sorted({round(one.candidate.clocks.offset) for one in (best[0], *apart)})
        said = ", ".join(map(str, offsets[:SHOWN_OFFSETS])) + (" …" if len(offsets) > SHOWN_OFFSETS else "")
        raise MeasurementError(
            f"{joints.log.title} and {tracker.title}: fit as well with the clocks about {said} s apart: the "
            "program repeats itself, and nothing "
            "tells which round is which; or a clock jumped. Log from before the first move until after the last, "
            "or begin with one "
            "move that is not repeated"
        )
    return best


def _too_few(joints: Log, tracker: Log, count: int) -> MeasurementError:
    return MeasurementError(
        f"{joints.title} and {tracker.title}: share {count} standstills, {FEWEST} are the least. Check that both "
        "logs are of one motion, "
        "and let the robot stand for two seconds at each pose"
    )


def _aligned(
    clocks: Clocks, robot: Robot, joints: Log, q: np.ndarray, still: Standstills, si: Tracked, seen_still: Standstills
) -> tuple[Clocks, Moves]:
    """Offset and drift from all moves, round after round."""
    lasts = float(np.ptp(si.log.time))
    for _ in range(ROUNDS):
        found = pairs(clocks, joints, still, si.log, seen_still, 1.0)
        if len(found) < FEWEST:
            raise _too_few(joints, si.log, len(found))
        better, moves = improved(clocks, robot, joints, q, si.log, si.position, found)
        change = abs(better.offset - clocks.offset) + 0.5 * lasts * abs(better.drift - clocks.drift)
        clocks = better
        if change < ENOUGH:
            break
    return clocks, moves


def _steps(si: Tracked) -> np.ndarray:
    """To what the tracker rounds positions [m] and rotations [rad]; a quaternion's numbers change by half an angle."""
    steps = resolution(si.position)
    if si.quaternion is None:
        return steps
    return np.r_[steps, np.repeat(2.0 * resolution(si.quaternion).max(), 3)]


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
