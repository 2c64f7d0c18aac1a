"""Key figures of an outcome: the numbers that its report and the summary on the screen put into words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from aridcal.engine.instruments.channels import Channels, norms, spread
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_tests import FALSE_ALARM
from aridcal.engine.search.residual_trends import Order, Trace
from aridcal.engine.trust.gains import NamedEffect
from aridcal.engine.trust.halves import Halves
from aridcal.jobs.calibrate.folder import parameters
from aridcal.jobs.calibrate.outcome import Outcome, Stage, leading, rms_in_words, statistics

QUESTIONABLE_OUTLIERS = 0.03
"""Share of outliers above which the measurement is at fault. A sound setup loses a reflector now and then: some rows in a
thousand. Where it is some in a hundred, rows that are not flagged are wrong for the same reason."""

LEAST_HELD_OUT = 20
"""Held-out rows below which an RMS is known to no better than about 10 %: of 3 n numbers it is 1 / sqrt(6 n)."""

OVERFIT_RATIO = 1.3
"""Held-out error over fitted error from which the model is too large for its data: noise alone, with n held-out rows, at
least LEAST_HELD_OUT of them, stays below 1 + 3 / sqrt(6 n) = 1.27."""

MOST_TWINS = 3
"""Effects confounded with one that are named beside it; a screen holds no more, and the report lists all."""

STRAY_SHARE = 0.2
"""Share of autocorrelations off their 95 % band from which consecutive rows count as alike: of 30 lags noise leaves it with
1.5 on average, and with more than 6 of them in fewer than 1 of 1000 cases."""

NARROW_SHARE = 0.5
"""Share of a joint's range below which the calibration extrapolates over more of the range than was measured."""

PLUS = "+\u00a0"
"""Before the name of an effect that a step adds; the blank does not break a line."""

FULL_TURN = 2 * np.pi
"""The error curve of a revolute joint repeats after it [rad]."""

FRAME_PREFIXES = ("world_base.", "world_base[", "tip_target.", "tip_target[")
"""How the names of the frames' own coefficients begin."""

DayVerdict = Literal["agrees", "remounted", "changed"]
"""What rows of another day say: the calibration holds; target or instrument stand elsewhere; the robot itself has changed."""


@dataclass(frozen=True)
class ModelStep:
    """One model on the way from the nominal robot to the whole model.

    Attributes:
        names: Its names: a stage, ``nominal``, ``geometric`` or ``final``, or ``+ EFFECT``; several if models have the same
            residual.
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
    """The range in which a joint was measured, by the fitted rows.

    Attributes:
        name: Of the joint.
        kind: ``revolute``, ``continuous`` or ``prismatic``.
        limits: Its lower and upper limit, [rad] or [m]; None if it has none.
        range: Its lowest and highest reading, [rad] or [m].
        share: Its readings, shape (N,): 0 at the lower limit, 1 at the upper one (the ends of ``range`` without limits).
        measured: Share of the range between the extreme readings; of one turn, where the range is larger.
    """

    name: str
    kind: str
    limits: tuple[float, float] | None
    range: tuple[float, float]
    share: np.ndarray
    measured: float


def scored(outcome: Outcome) -> tuple[np.ndarray, str]:
    """The rows that judge the calibration: those held out, or those fitted if none were; outliers are excluded.

    If all held-out rows are outliers, they judge it all the same.

    Returns:
        A mask of the rows, shape (N,) bool, and their name in words.
    """
    parts = outcome.parts()
    if parts["test"].any():
        return parts["test"], "held-out rows"
    if parts["test_all"].any():
        return parts["test_all"], "held-out rows, all flagged as outliers"
    return parts["train"], "fitted rows"


def every_held_out_row(outcome: Outcome) -> str:
    """The error of the final model on all held-out rows, flagged ones too, in words."""
    held_out = outcome.parts()["test_all"]
    flagged = int((held_out & outcome.outlier).sum())
    error = rms_in_words(outcome.stages[-1].residual, held_out, outcome.measurements)
    return f"{flagged} of {held_out.sum():,} held-out rows flagged as outliers; {error} RMS with all of them"


def over_time(outcome: Outcome) -> str:
    """The error with whole stretches of time held back, in words; empty where no effect depends on time."""
    error = None if outcome.diagnosis is None else outcome.diagnosis.over_time
    first = outcome.channels[0]
    return (
        "" if error is None else f"with whole stretches of time held back: {first.scale * error:.3f} {first.shown} RMS"
    )


def row_errors(residual: np.ndarray, channels: Channels) -> np.ndarray:
    """Error of each row in the unit that is shown, shape (C, N), from residuals of shape (N, m)."""
    scale = np.array([channel.scale for channel in channels])
    return norms(residual, channels) * scale[:, None]


def overall_error(residual: np.ndarray, mask: np.ndarray, rows: Dataset, sigma: np.ndarray) -> float:
    """One number for the error of some rows: the RMS of the leading channel as it is shown; of several channels in sigmas.

    Args:
        residual: Shape (N, m).
        mask: Rows that count, shape (N,).
        rows: All N of them.
        sigma: Noise of each channel, shape (C,).
    """
    sizes = judging_errors(residual[mask], rows, sigma)
    return statistics(sizes[~np.isnan(sizes)])["rms"]


def judged_channels(outcome: Outcome) -> tuple[int, ...]:
    """Numbers of the channels that the judging rows measure, without channels that tell nothing of the arm.

    A block of training rows only has no judging rows, and none of its channels is among them.
    """
    measured = outcome.measurements.measures[scored(outcome)[0]].any(axis=0)
    return tuple(k for k, channel in enumerate(outcome.channels) if measured[k] and not channel.inner)


def judging_errors(residual: np.ndarray, rows: Dataset, sigma: np.ndarray) -> np.ndarray:
    """Error of each row in its leading channel, shape (N,): as it is shown; in sigmas where there are several such channels."""
    sizes = row_errors(residual, rows.channels)
    leading_channels = list(leading(rows))
    if len(leading_channels) == 1:
        return np.asarray(sizes[leading_channels[0]])
    unit = [channel.scale * float(s) for channel, s in zip(rows.channels, sigma, strict=True)]
    return np.asarray(np.fmax.reduce(sizes[leading_channels] / np.array(unit)[leading_channels, None], axis=0))


def squared(outcome: Outcome) -> str:
    """The square of :func:`overall_error` in words: ``squared position error``."""
    leading_channels = leading(outcome.measurements)
    return (
        f"squared {outcome.channels[leading_channels[0]].noun}"
        if len(leading_channels) == 1
        else "squared error of all instruments"
    )


def or_as_well(effect: NamedEffect) -> str:
    """Effects that would do as well as one, in words: ``, or as well thermal at joint_4``; empty if there are none."""
    names = list(dict.fromkeys(other.label for other in effect.confounded_with))
    if not names:
        return ""
    rest = f" and {len(names) - MOST_TWINS} more" if len(names) > MOST_TWINS else ""
    return f", or as well {', '.join(names[:MOST_TWINS])}{rest}"


def verification_agreement(outcome: Outcome) -> tuple[DayVerdict, str] | None:
    """Whether another day's rows agree with the calibration, and the sentence on that; None without such rows."""
    verification = outcome.verification
    if verification is None:
        return None
    mask, words = scored(outcome)
    sound = ~verification.outlier
    last, rows, day_rows = outcome.stages[-1], outcome.measurements, verification.measurements
    mask = mask & np.isin(rows.labels.block, day_rows.labels.block)  # compared with rows of the same instruments
    own_error = overall_error(last.residual, mask, rows, outcome.noise)
    other_error = overall_error(verification.residuals[last.name], sound, day_rows, outcome.noise)
    in_words, before = (
        rms_in_words(verification.residuals[last.name], sound, day_rows),
        rms_in_words(last.residual, mask, rows),
    )
    if rows.measures[mask][:, leading(rows)].any(axis=0).sum() < 2:
        before = before.partition(" ")[0]
    own_rows = f", {verification.copied:,} of the campaign's own left out" if verification.copied else ""
    which_rows = f"{verification.file}, {sound.sum():,} of {len(sound):,}{own_rows}"
    sentence = f"Another day's rows ({which_rows}): {in_words} RMS, {before} on the {words}"
    if other_error < OVERFIT_RATIO * own_error:
        return "agrees", f"{sentence}."
    if verification.realigned is None:
        return "changed", f"{sentence}: the robot, the target or the instrument has changed since."
    moved = overall_error(verification.realigned, sound, day_rows, outcome.noise) < OVERFIT_RATIO * own_error
    word: DayVerdict = "remounted" if moved else "changed"
    why = "the target or the instrument was remounted" if moved else "the robot has changed since"
    return (
        word,
        f"{sentence}; {rms_in_words(verification.realigned, sound, day_rows)} with both frames fitted anew: {why}.",
    )


def solved_stages(outcome: Outcome) -> dict[str, Stage]:
    """The fitted stages by name; neighbours with the same residual share an entry, ``geometric = final``."""
    stages: list[tuple[str, Stage]] = []
    for stage in outcome.stages:
        name = stage.name
        if stages and np.array_equal(stages[-1][1].residual, stage.residual):
            same, _ = stages.pop()
            name = f"{same} = {name}"
        stages.append((name, stage))
    return {name: stage for name, stage in stages if stage.name != "nominal"}


def steps(outcome: Outcome) -> list[ModelStep]:
    """From the nominal robot to the whole model, one effect at a time; models with the same residual are one step."""
    *first, final = outcome.stages
    last = outcome.effects[-1].effect.label if outcome.effects else ""
    path = [ModelStep((stage.name,), "", stage.residual) for stage in first]
    path += [ModelStep((f"{PLUS}{e.effect.label}",), e.effect.label, e.reached) for e in outcome.effects[:-1]]
    path.append(ModelStep((f"{PLUS}{last}", final.name) if last else (final.name,), last, final.residual))
    merged: list[ModelStep] = []
    for step in path:
        if merged and np.array_equal(merged[-1].residual, step.residual):
            before = merged.pop()
            step = ModelStep(before.names + step.names, before.effect or step.effect, step.residual)
        merged.append(step)
    return merged


def removed_shares(outcome: Outcome) -> list[tuple[ModelStep, float]]:
    r"""Which share of the squared error (see :func:`squared`) each step removes, the largest first.

    .. math:: s_k = (e_{k-1}^2 - e_k^2) / e_0^2

    with the RMS errors :math:`e_k` of the rows of :func:`scored`; :math:`e_0` is that of the nominal robot. A share is
    negative if a step makes those rows worse. Steps that change nothing are left out.
    """
    mask, _ = scored(outcome)
    path = steps(outcome)
    square = [overall_error(step.residual, mask, outcome.measurements, outcome.noise) ** 2 for step in path]
    gains = [(step, square[k] - square[k + 1]) for k, step in enumerate(path[1:]) if square[k] != square[k + 1]]
    gains.sort(key=lambda pair: pair[1], reverse=True)
    return [(step, gain / square[0]) for step, gain in gains]


def is_of_frame(name: str) -> bool:
    """True if a coefficient belongs to the frame of the base or of the target."""
    return name.startswith(FRAME_PREFIXES)


def constants(outcome: Outcome) -> list[dict[str, Any]]:
    """The geometric parameters without the two frames, each as :func:`aridcal.jobs.calibrate.folder.parameters` has it."""
    return [p for p in parameters(outcome.stage("geometric").fit) if not is_of_frame(p["name"])]


def joint_ranges(outcome: Outcome) -> list[JointRange]:
    """Measured range of each joint, base first."""
    m, robot = outcome.measurements, outcome.robot
    fitted = m.readings[outcome.parts()["train"]]
    joints = zip(robot.readings, robot.kinds, robot.limits, fitted.T, strict=True)
    return [joint_range(name, kind, limits, q) for name, kind, limits, q in joints]


def joint_range(name: str, kind: str, limits: np.ndarray, q: np.ndarray) -> JointRange:
    """Range of one joint from its limits (2,) and readings (N,); a continuous joint counts within one turn."""
    if kind == "continuous":
        q, limits = np.angle(np.exp(1j * q)), np.array([-np.pi, np.pi])
    limited = bool(np.isfinite(limits).all())
    extremes = float(q.min()), float(q.max())
    low, high = (float(limits[0]), float(limits[1])) if limited else extremes
    span = high - low
    share = np.clip((q - low) / (span if span > 0 else 1.0), 0, 1)
    whole = span if kind == "prismatic" else min(span, FULL_TURN)
    measured = min(float(np.ptp(q)) / whole, 1.0) if whole > 0 else 0.0
    return JointRange(name, kind, (low, high) if limited else None, extremes, share, measured)


def narrow_joints(outcome: Outcome) -> list[JointRange]:
    """Joints of which less than half of the range, or of one turn, was measured."""
    return [j for j in joint_ranges(outcome) if j.measured < NARROW_SHARE]


def final_halves(outcome: Outcome) -> Halves | None:
    """Halves of the rows under the final model; None where these were not asked for, or there are too few rows."""
    return None if outcome.second_look is None else outcome.second_look.halves["final"]


def generalisation(outcome: Outcome) -> float | None:
    """RMS error on held-out rows over that on fitted rows; None with few held-out rows or an exact fit."""
    parts, last = outcome.parts(), outcome.stages[-1].residual
    if parts["test"].sum() < LEAST_HELD_OUT:
        return None
    fitted, held_out = (
        overall_error(last, parts[part], outcome.measurements, outcome.noise) for part in ("train", "test")
    )
    return held_out / fitted if fitted > 0 else None


def sigma_and_error(outcome: Outcome) -> tuple[float, float] | None:
    """Uncertainty of the target and error of the rows, both at the target, [mm]; None where no row tells the target's place.

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
    measured = ~np.isnan(residual)
    squares = np.where(measured, residual, 0.0) ** 2
    return np.asarray(
        scale * np.sqrt(squares.sum(axis=0) / np.where(measured.any(axis=0), measured.sum(axis=0), np.nan))
    )


def worst_rows(outcome: Outcome, count: int) -> np.ndarray:
    """Row numbers of the largest errors of the final model among the rows of :func:`scored`."""
    rows = np.flatnonzero(scored(outcome)[0])
    error = judging_errors(outcome.stages[-1].residual[rows], outcome.measurements, outcome.noise)
    return rows[np.argsort(-error, kind="stable")[:count]]


def corrected(p_value: float, questions: int) -> float:
    """A p-value corrected for the number of questions that were asked (Bonferroni): min(1, asked * p)."""
    return min(1.0, p_value * questions)


def stray_autocorrelations(order: Order) -> int:
    """How many autocorrelations leave the 95 % band of noise."""
    return int(np.sum(np.abs(order.correlation) > order.bound))


def slowly_changing(order: Order) -> bool:
    """Whether consecutive rows have similar residuals: too few changes of sign, or too many correlations off the band."""
    return order.p_value < FALSE_ALARM or stray_autocorrelations(order) / len(order.lags) > STRAY_SHARE


def clear_traces(outcome: Outcome) -> list[Trace]:
    """The strongest dependences of the residual, the most significant first."""
    return sorted(outcome.traces.strongest, key=lambda t: t.after.p_value)


def significant(trace: Trace, questions: int) -> bool:
    """Whether a dependence is more than chance gives among so many."""
    return trace.after.p_value * questions <= FALSE_ALARM
