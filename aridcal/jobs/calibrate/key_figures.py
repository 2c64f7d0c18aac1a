"""Key figures of an outcome: the numbers that its report and the summary on the screen put into words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from aridcal.engine.instruments.channels import Channels, norms, spread
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_tests import SURE
from aridcal.engine.search.residual_trends import Order, Trace
from aridcal.engine.trust.gains import NamedEffect
from aridcal.engine.trust.halves import Halves
from aridcal.jobs.calibrate.folder import parameters
from aridcal.jobs.calibrate.outcome import Outcome, Stage, leading, said, statistics

QUESTIONABLE = 0.03
"""Share of outliers above which the measurement is at fault. A sound setup loses a reflector now and then: some rows in a
thousand. Where it is some in a hundred, rows that are not flagged are wrong for the same reason."""

FEW = 20
"""Held-out rows below which an RMS is known to no better than about 10 %: of 3 n numbers it is 1 / sqrt(6 n)."""

OVERFITTED = 1.3
"""Held-out error over fitted error from which the model is too large for its data: noise alone, with n >= FEW rows held
out, stays below 1 + 3 / sqrt(6 n) = 1.27."""

MOST_TWINS = 3
"""Effects confounded with one that are named beside it; a screen holds no more, and the report lists all."""

STRAYING = 0.2
"""Share of autocorrelations off their 95 % band from which consecutive rows count as alike: of 30 lags noise leaves it with
1.5 on average, and with more than 6 of them in fewer than 1 of 1000 cases."""

NARROW = 0.5
"""Share of a joint's range below which the calibration extrapolates over more of the range than it has seen."""

PLUS = "+\u00a0"
"""Before the name of an effect that a step adds; the blank does not break a line."""

FULL_TURN = 2 * np.pi
"""The error curve of a revolute joint repeats after it [rad]."""

FRAMES = ("world_base.", "world_base[", "tip_target.", "tip_target[")
"""How the names of the frames' own coefficients begin."""


@dataclass(frozen=True)
class Step:
    """One model on the way from the nominal robot to the whole model.

    Attributes:
        names: What it is called: a stage, ``nominal``, ``geometric`` or ``final``, or ``+ EFFECT``; several if models
            leave the same.
        effect: The effect that it adds to the step before; empty if it adds none.
        residual: Measured minus predicted of all rows, shape (N, m).
    """

    names: tuple[str, ...]
    effect: str
    residual: np.ndarray

    @property
    def title(self) -> str:
        """Its names in one line: ``geometric = final``."""
        return " = ".join(self.names)


@dataclass(frozen=True)
class JointRange:
    """Where a joint was measured, by the fitted rows.

    Attributes:
        name: Of the joint.
        kind: ``revolute``, ``continuous`` or ``prismatic``.
        limits: Its lower and upper limit, [rad] or [m]; None if it has none.
        seen: Its lowest and highest reading, [rad] or [m].
        share: Its readings, shape (N,): 0 at the lower limit, 1 at the upper one (the ends of ``seen`` without limits).
        measured: Share of the range between the extreme readings; of one turn, where the range is larger.
    """

    name: str
    kind: str
    limits: tuple[float, float] | None
    seen: tuple[float, float]
    share: np.ndarray
    measured: float


def scored(outcome: Outcome) -> tuple[np.ndarray, str]:
    """The rows that judge the calibration: those held out, or those fitted if none were; outliers are excluded.

    If all held-out rows are outliers, they judge it all the same.

    Returns:
        A mask of the rows, shape (N,), and what they are called.
    """
    parts = outcome.parts()
    if parts["test"].any():
        return parts["test"], "held-out rows"
    if parts["test_all"].any():
        return parts["test_all"], "held-out rows, all flagged as outliers"
    return parts["train"], "fitted rows"


def every_held_out_row(outcome: Outcome) -> str:
    """The error of the final model on all held-out rows, flagged ones too, in words."""
    every = outcome.parts()["test_all"]
    flagged = int((every & outcome.outlier).sum())
    error = said(outcome.stages[-1].residual, every, outcome.measurements)
    return f"{flagged} of {every.sum():,} held-out rows flagged as outliers; {error} RMS with all of them"


def over_time(outcome: Outcome) -> str:
    """The error with whole stretches of time held back, in words; empty where no effect depends on time."""
    found = None if outcome.diagnosis is None else outcome.diagnosis.over_time
    first = outcome.channels[0]
    return (
        "" if found is None else f"with whole stretches of time held back: {first.scale * found:.3f} {first.shown} RMS"
    )


def row_errors(residual: np.ndarray, channels: Channels) -> np.ndarray:
    """Error of each row in the unit that is shown, shape (C, N), from residuals of shape (N, m)."""
    scale = np.array([channel.scale for channel in channels])
    return norms(residual, channels) * scale[:, None]


def overall(residual: np.ndarray, mask: np.ndarray, rows: Dataset, sigma: np.ndarray) -> float:
    """One number for the error of some rows: the RMS of the channel that judges, as it is shown; of several, all in sigmas.

    Args:
        residual: Shape (N, m).
        mask: Rows that count, shape (N,).
        rows: All N of them.
        sigma: Noise of each channel, shape (C,).
    """
    sizes = judging_errors(residual[mask], rows, sigma)
    return statistics(sizes[~np.isnan(sizes)])["rms"]


def judged_channels(outcome: Outcome) -> tuple[int, ...]:
    """Numbers of the channels that the rows which judge the calibration measure, without those that tell nothing of the arm.

    A block whose table says that all its rows are for training has none of them.
    """
    measured = outcome.measurements.measures[scored(outcome)[0]].any(axis=0)
    return tuple(k for k, channel in enumerate(outcome.channels) if measured[k] and not channel.inner)


def judging_errors(residual: np.ndarray, rows: Dataset, sigma: np.ndarray) -> np.ndarray:
    """Error of each row in the channel that judges it, shape (N,): as it is shown; in sigmas where there are several."""
    sizes = row_errors(residual, rows.channels)
    own = list(leading(rows))
    if len(own) == 1:
        return np.asarray(sizes[own[0]])
    unit = [channel.scale * float(s) for channel, s in zip(rows.channels, sigma, strict=True)]
    return np.asarray(np.fmax.reduce(sizes[own] / np.array(unit)[own, None], axis=0))


def squared(outcome: Outcome) -> str:
    """What :func:`overall` is squared, in words: ``squared position error``."""
    own = leading(outcome.measurements)
    return f"squared {outcome.channels[own[0]].noun}" if len(own) == 1 else "squared error of all instruments"


def or_as_well(effect: NamedEffect) -> str:
    """Effects that would do as well as one, in words: ``, or as well thermal at joint_4``; empty if there are none."""
    names = list(dict.fromkeys(other.label for other in effect.confounded_with))
    if not names:
        return ""
    rest = f" and {len(names) - MOST_TWINS} more" if len(names) > MOST_TWINS else ""
    return f", or as well {', '.join(names[:MOST_TWINS])}{rest}"


def another_day(outcome: Outcome) -> tuple[bool, str] | None:
    """What another day's rows say of the calibration: whether it holds, and the sentence; None: there are none."""
    found = outcome.verification
    if found is None:
        return None
    mask, words = scored(outcome)
    sound = ~found.outlier
    last, rows, others = outcome.stages[-1], outcome.measurements, found.measurements
    mask = mask & np.isin(rows.labels.block, others.labels.block)  # set beside the same instruments' rows
    own = overall(last.residual, mask, rows, outcome.noise)
    now = overall(found.residuals[last.name], sound, others, outcome.noise)
    told, before = said(found.residuals[last.name], sound, others), said(last.residual, mask, rows)
    if rows.measures[mask][:, leading(rows)].any(axis=0).sum() < 2:
        before = before.partition(" ")[0]
    own_rows = f", {found.copied:,} of the campaign's own left out" if found.copied else ""
    those = f"{found.file}, {sound.sum():,} of {len(sound):,}{own_rows}"
    sentence = f"Another day's rows ({those}): {told} RMS, {before} on the {words}"
    if now < OVERFITTED * own:
        return True, f"{sentence}."
    if found.realigned is None:
        return False, f"{sentence}: the robot, the target or the instrument has changed since."
    moved = overall(found.realigned, sound, others, outcome.noise) < OVERFITTED * own
    why = "the target or the instrument was remounted" if moved else "the robot has changed since"
    return False, f"{sentence}; {said(found.realigned, sound, others)} with both frames fitted anew: {why}."


def solved_stages(outcome: Outcome) -> dict[str, Stage]:
    """The fitted stages by name; neighbours that leave the same residual share an entry, ``geometric = final``."""
    found: list[tuple[str, Stage]] = []
    for stage in outcome.stages:
        name = stage.name
        if found and np.array_equal(found[-1][1].residual, stage.residual):
            same, _ = found.pop()
            name = f"{same} = {name}"
        found.append((name, stage))
    return {name: stage for name, stage in found if stage.name != "nominal"}


def steps(outcome: Outcome) -> list[Step]:
    """From the nominal robot to the whole model, one effect at a time; models that leave the same are one step."""
    *first, final = outcome.stages
    last = outcome.effects[-1].effect.label if outcome.effects else ""
    path = [Step((stage.name,), "", stage.residual) for stage in first]
    path += [Step((f"{PLUS}{e.effect.label}",), e.effect.label, e.reached) for e in outcome.effects[:-1]]
    path.append(Step((f"{PLUS}{last}", final.name) if last else (final.name,), last, final.residual))
    found: list[Step] = []
    for step in path:
        if found and np.array_equal(found[-1].residual, step.residual):
            before = found.pop()
            step = Step(before.names + step.names, before.effect or step.effect, step.residual)
        found.append(step)
    return found


def removed_shares(outcome: Outcome) -> list[tuple[Step, float]]:
    r"""Which share of the squared error (see :func:`squared`) each step removes, the largest first.

    .. math:: s_k = (e_{k-1}^2 - e_k^2) / e_0^2

    with the RMS errors :math:`e_k` of the rows of :func:`scored`; :math:`e_0` is that of the nominal robot. A share is
    negative if a step makes those rows worse. Steps that change nothing are left out.
    """
    mask, _ = scored(outcome)
    path = steps(outcome)
    square = [overall(step.residual, mask, outcome.measurements, outcome.noise) ** 2 for step in path]
    gains = [(step, square[k] - square[k + 1]) for k, step in enumerate(path[1:]) if square[k] != square[k + 1]]
    gains.sort(key=lambda pair: pair[1], reverse=True)
    return [(step, gain / square[0]) for step, gain in gains]


def of_frame(name: str) -> bool:
    """True if a coefficient belongs to the frame of the base or of the target."""
    return name.startswith(FRAMES)


def constants(outcome: Outcome) -> list[dict[str, Any]]:
    """The geometric parameters without the two frames, each as :func:`aridcal.jobs.calibrate.folder.parameters` has it."""
    return [p for p in parameters(outcome.stage("geometric").fit) if not of_frame(p["name"])]


def joint_ranges(outcome: Outcome) -> list[JointRange]:
    """Where each joint was measured, base first."""
    m, robot = outcome.measurements, outcome.robot
    fitted = m.readings[outcome.parts()["train"]]
    joints = zip(robot.readings, robot.kinds, robot.limits, fitted.T, strict=True)
    return [joint_range(name, kind, limits, q) for name, kind, limits, q in joints]


def joint_range(name: str, kind: str, limits: np.ndarray, q: np.ndarray) -> JointRange:
    """Range of one joint from its limits (2,) and readings (N,); a continuous joint counts within one turn."""
    if kind == "continuous":
        q, limits = np.angle(np.exp(1j * q)), np.array([-np.pi, np.pi])
    limited = bool(np.isfinite(limits).all())
    seen = float(q.min()), float(q.max())
    low, high = (float(limits[0]), float(limits[1])) if limited else seen
    span = high - low
    share = np.clip((q - low) / (span if span > 0 else 1.0), 0, 1)
    whole = span if kind == "prismatic" else min(span, FULL_TURN)
    measured = min(float(np.ptp(q)) / whole, 1.0) if whole > 0 else 0.0
    return JointRange(name, kind, (low, high) if limited else None, seen, share, measured)


def narrow_joints(outcome: Outcome) -> list[JointRange]:
    """Joints of which less than half of the range, or of one turn, was measured."""
    return [j for j in joint_ranges(outcome) if j.measured < NARROW]


def final_halves(outcome: Outcome) -> Halves | None:
    """What halves of the rows say of the final model; None where that was not asked or could not be."""
    return None if outcome.second_look is None else outcome.second_look.halves["final"]


def generalisation(outcome: Outcome) -> float | None:
    """RMS error on held-out rows over that on fitted rows; None with few held-out rows or an exact fit."""
    parts, last = outcome.parts(), outcome.stages[-1].residual
    if parts["test"].sum() < FEW:
        return None
    fitted, held_out = (overall(last, parts[part], outcome.measurements, outcome.noise) for part in ("train", "test"))
    return held_out / fitted if fitted > 0 else None


def sigma_and_error(outcome: Outcome) -> tuple[float, float] | None:
    """How well the target is known, and how far the rows are off, both at the target, [mm]; None where no row sees its place.

    Returns:
        The median 1-sigma of the target in its worst direction, and the RMS of the smallest shifts that explain the rows.
    """
    size = np.linalg.norm(outcome.at_target.shift(outcome.stages[-1].residual)[scored(outcome)[0]], axis=1)
    size = size[~np.isnan(size)]
    if not len(size):
        return None
    return 1e3 * float(np.median(outcome.precision.position)), 1e3 * statistics(size)["rms"]


def axis_rms(residual: np.ndarray, channels: Channels) -> np.ndarray:
    """RMS of each axis of residuals (N, m) in the unit that is shown, shape (m,); NaN where no row has measured it."""
    scale = spread(np.array([channel.scale for channel in channels]), channels)
    there = ~np.isnan(residual)
    squares = np.where(there, residual, 0.0) ** 2
    return np.asarray(scale * np.sqrt(squares.sum(axis=0) / np.where(there.any(axis=0), there.sum(axis=0), np.nan)))


def worst_rows(outcome: Outcome, count: int) -> np.ndarray:
    """Row numbers of the largest errors of the final model among the rows of :func:`scored`."""
    rows = np.flatnonzero(scored(outcome)[0])
    error = judging_errors(outcome.stages[-1].residual[rows], outcome.measurements, outcome.noise)
    return rows[np.argsort(-error, kind="stable")[:count]]


def corrected(p_value: float, asked: int) -> float:
    """A p-value corrected for the number of questions that were asked (Bonferroni): min(1, asked * p)."""
    return min(1.0, p_value * asked)


def strays(order: Order) -> int:
    """How many autocorrelations leave the 95 % band of noise."""
    return int(np.sum(np.abs(order.correlation) > order.bound))


def slowly_changing(order: Order) -> bool:
    """Whether consecutive rows have similar residuals: too few changes of sign, or too many correlations off the band."""
    return order.p_value < SURE or strays(order) / len(order.lags) > STRAYING


def clear_traces(outcome: Outcome) -> list[Trace]:
    """The strongest dependences of the residual, the most significant first."""
    return sorted(outcome.traces.strongest, key=lambda t: t.after.p_value)


def significant(trace: Trace, asked: int) -> bool:
    """Whether a dependence is more than chance gives among so many."""
    return trace.after.p_value * asked <= SURE
