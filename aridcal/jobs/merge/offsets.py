"""Which offset of the clocks it is: that at which standstills of both logs fit the nominal robot, if there is only one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.jobs.merge.alignment import window_means
from aridcal.jobs.merge.clocks import Candidate, Clocks, candidates
from aridcal.jobs.merge.log import Log
from aridcal.jobs.merge.log_files import JointLog
from aridcal.jobs.merge.pairs import Pairs, pairs
from aridcal.jobs.merge.standstills import Standstills, span_of
from aridcal.jobs.prepare.campaign_proposal import SAMPLE_ROWS, STRANGE_SHARE
from aridcal.jobs.prepare.orientation_columns import CLEAR_RATIO
from aridcal.jobs.prepare.units_and_angles import Sample, readings
from aridcal.system.errors import MeasurementError

FEWEST_STANDSTILLS = 6
"""Fewest standstills that both logs must share: the frames alone take nine numbers, and any three fit any three."""

RIVAL_PAIR_SHARE = 0.5
"""An offset is a rival of another if at least this share of the other's standstills pair with it: few fit anything."""

RIVAL_CONTRADICTION = 1.0
"""An offset is no rival if one log stands while the other moves for so much longer than with the best one, [s]."""

MOST_CONTRADICTED_SHARE = 0.1
"""Share of the time in which the target may move while the joints stand: people walk by, floors shake."""

SHOWN_OFFSETS = 5
"""Offsets that a message names."""

SAME_OFFSET = 1.5
"""Offsets that are nearer are one, [s]: candidates are a cell of their grid wide, and drifts blur them."""


@dataclass(frozen=True)
class JudgedCandidate:
    """A candidate, how near the nominal robot comes at the standstills that it pairs, and for how long it is contradicted."""

    candidate: Candidate
    pairs: Pairs
    share: float
    contrary: tuple[float, float]


def best_offset(
    robot: Robot, joints: JointLog, tracker: Log, raw: np.ndarray, tracker_still: Standstills, still: Standstills
) -> tuple[JudgedCandidate, tuple[str, ...]]:
    """The offset at which speeds are alike and the standstills fit the nominal robot.

    Raises:
        MeasurementError: there is none, or there are several.
    """
    candidates_and_units: list[tuple[Candidate, tuple[str, ...]]] = []
    for units in joints.units:
        tips = tip_frames(robot, joints.readings(units))[1]
        candidates_and_units += [(one, units) for one in candidates(joints.log, tips, tracker, raw)]
    fits: list[tuple[JudgedCandidate, tuple[str, ...]]] = []
    most_pairs = 0
    for candidate, units in candidates_and_units:
        windows_of_both = pairs(candidate.clocks, joints.log, still, tracker, tracker_still, 1.0)
        most_pairs = max(most_pairs, len(windows_of_both))
        if len(windows_of_both) < FEWEST_STANDSTILLS:
            continue
        sample = windows_of_both.some(np.sort(np.random.default_rng(0).permutation(len(windows_of_both))[:SAMPLE_ROWS]))
        clocks = candidate.clocks
        q = window_means(joints.log, joints.log.values, clocks.joints(sample.begin), clocks.joints(sample.end))
        m = window_means(tracker, raw, sample.begin, sample.end)
        turning = np.array([kind != "prismatic" for kind in robot.kinds])
        ways = readings(Sample(q, turning, m, np.zeros(len(q))), robot)
        if ways:
            contrary = contradiction_time(clocks, joints.log, still, tracker, tracker_still)
            fits.append((JudgedCandidate(candidate, windows_of_both, ways[0].share, contrary), units))
    if not fits:
        if not candidates_and_units:
            raise MeasurementError(
                f"{joints.log.title} and {tracker.title}: at no offset of the clocks are the speeds of the nominal "
                "tip and of the target "
                "alike for 20 s. Check that both are of one motion, and that the URDF is this robot's"
            )
        raise too_few(joints.log, tracker, most_pairs)
    fullest = max(len(one.pairs) for one, _ in fits)
    rivals = [one for one in fits if len(one[0].pairs) >= RIVAL_PAIR_SHARE * fullest]
    best = min(rivals, key=lambda one: one[0].share)
    if best[0].share > STRANGE_SHARE:
        raise MeasurementError(
            f"{joints.log.title} and {tracker.title}: at the offset of the clocks at which they agree best the "
            "nominal robot misses the "
            f"targets by {100 * best[0].share:.2g} % of their spread. Check that both logs are of one motion, that "
            "the URDF is this robot's, "
            "each joint's column and sign, and that neither tracker nor target was moved in between"
        )
    near = [one for one in rivals if one[0].share <= CLEAR_RATIO * best[0].share]
    best = min(near, key=lambda one: sum(one[0].contrary))
    offset, least = best[0].candidate.clocks.offset, sum(best[0].contrary)
    elsewhere = [
        one
        for one, _ in near
        if abs(one.candidate.clocks.offset - offset) > SAME_OFFSET and sum(one.contrary) < least + RIVAL_CONTRADICTION
    ]
    if elsewhere:
        offsets = sorted({round(one.candidate.clocks.offset) for one in (best[0], *elsewhere)})
        listed = ", ".join(map(str, offsets[:SHOWN_OFFSETS])) + (" …" if len(offsets) > SHOWN_OFFSETS else "")
        raise MeasurementError(
            f"{joints.log.title} and {tracker.title}: fit as well with the clocks about {listed} s apart: the "
            "program repeats itself, and nothing tells which round is which; or a clock jumped. Log from before the first "
            "move until after the last, or begin with one move that is not repeated"
        )
    shared = _shared(best[0].candidate.clocks, joints.log, tracker)
    if best[0].contrary[0] > MOST_CONTRADICTED_SHARE * shared:
        raise MeasurementError(
            f"{joints.log.title} and {tracker.title}: for {best[0].contrary[0]:.3g} of {shared:.3g} s the "
            "target moves while the joints stand, with the clocks as they agree best. If one of the clocks was set while it ran, "
            "cut both logs there and merge each part by itself; else check that target and tracker stood firmly"
        )
    return best


def _shared(clocks: Clocks, joints: Log, tracker: Log) -> float:
    """Time that both logs cover, [s]."""
    first, last = clocks.joints(tracker.time[[0, -1]])
    return float(max(min(last, joints.time[-1]) - max(first, joints.time[0]), 0.0))


def contradiction_time(
    clocks: Clocks, joints: Log, still: Standstills, tracker: Log, tracker_still: Standstills
) -> tuple[float, float]:
    """Time for which the target moves while the joints stand, and for which the joints move while the target stands, [s].

    Both states lose a margin at both ends, so that clocks that are right to a cell of the grid are not contradicted at each move.
    """
    margin = max(span_of(joints), span_of(tracker)) + float(np.sqrt(clocks.covariance[0, 0]))
    first, last = clocks.joints(tracker.time[[0, -1]])
    grid = np.arange(max(first, joints.time[0]), min(last, joints.time[-1]), 0.5 * margin)
    if not len(grid):
        return 0.0, 0.0
    sides = []
    for begin, end, time in (
        (still.begin, still.end, joints.time),
        (clocks.joints(tracker_still.begin), clocks.joints(tracker_still.end), clocks.joints(tracker.time)),
    ):
        interval = np.clip(np.searchsorted(begin, grid, "right") - 1, 0, None)
        rests = (begin[interval] + margin < grid) & (grid < end[interval] - margin)
        following = np.r_[begin, np.inf][np.where(grid < begin[0], 0, interval + 1)]
        moves = ((grid > end[interval] + margin) | (grid < begin[0])) & (grid < following - margin)
        next_sample = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
        moves &= time[next_sample] - time[next_sample - 1] < margin  # of a hole nothing is known
        sides.append((rests, moves))
    (joints_rest, joints_move), (target_rests, target_moves) = sides
    step = 0.5 * margin
    return float(step * np.sum(joints_rest & target_moves)), float(step * np.sum(joints_move & target_rests))


def too_few(joints: Log, tracker: Log, count: int) -> MeasurementError:
    """The error for logs that share too few standstills."""
    return MeasurementError(
        f"{joints.title} and {tracker.title}: share {count} standstills, {FEWEST_STANDSTILLS} are the least. Check that both "
        "logs are of one motion, "
        "and let the robot stand for two seconds at each pose"
    )
