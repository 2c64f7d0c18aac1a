"""What a check and a repair found, in words for the screen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.files.counting import counting
from aridcal.files.measurement_settings import MeasurementSettings
from aridcal.jobs.calibrate.outcome import rms_in_words
from aridcal.jobs.maintain.bounds import FALSE_ALARMS, Bounds
from aridcal.jobs.maintain.checking import Cause, CheckResult
from aridcal.jobs.maintain.repair import RepairChange
from aridcal.jobs.maintain.repaired_outcomes import RepairOutcomes
from aridcal.system.wording import enumeration

LARGEST_ZERO_CHANGE = 0.03
"""[rad] or [m] of a joint's zero beyond which what depends on its reading is no longer what was calibrated: gravity's lever is
then off by up to a thirtieth."""

MILLI_PER_UNIT = 1e3
"""[mm] in a metre, [mrad] in a radian."""


def check_lines(checked: CheckResult, changes: Sequence[RepairChange], settings: MeasurementSettings) -> list[str]:
    """The answer of `aridcal check`, the verdict first; before it temperatures that the calibration did not see.

    Args:
        checked: What the rows say.
        changes: Size of each move.
        settings: Of the campaign's tables: units, for a configuration to measure.
    """
    rows, error = checked.rows, checked.error
    all_rows = np.ones(len(rows), dtype=bool)
    expected = " and ".join(
        f"{c.scale * s:.3g} {c.shown}"
        for c, s, measured in zip(
            rows.channels, checked.noise.sigma, np.atleast_1d(rows.measures.any(axis=0)), strict=True
        )
        if measured
    )
    remainder = (
        f"{len(rows)} rows: {rms_in_words(checked.residual, all_rows, rows)} RMS where the noise is {expected} per axis"
    )
    lines = [*_heat_line(checked), _verdict(checked), remainder if error is None else f"{remainder}; {_error(error)}"]
    if checked.unseen:
        lines.append(f"not seen by these rows, whatever moved: {enumeration([s.words for s in checked.unseen])}")
    for change in changes:
        if change.cause.kind == "new":
            lines.append(f"fitted anew: {change.cause.words}, {amount(change, checked)} from where it was")
    by_cause = {id(change.cause): change for change in changes}
    for cause in checked.causes:
        lines += _cause_lines(checked, cause, by_cause.get(id(cause)), settings)
    if checked.causes:
        remainder = (
            "goes with the calibration" if checked.rest.p_value >= FALSE_ALARMS else "is explained by nothing known"
        )
        lines.append(f"what remains {remainder} ({checked.rest.words})")
    return lines


def repair_error_line(outcomes: RepairOutcomes) -> str:
    """Errors of the new rows before and after the repair, and of each row with the repair fitted to the others alone."""
    m = outcomes.rows.measurements
    every = ~outcomes.rows.outlier & ~m.test
    after = outcomes.rows.stage("final").residual
    before, repaired, without_row = (
        rms_in_words(residual, every, m)
        for residual in (outcomes.rows.stage("before").residual, after, outcomes.left_out)
    )
    held_out = f"; {rms_in_words(after, m.test, m)} on {int(m.test.sum())} held-out rows" if m.test.any() else ""
    return f"error of the new rows: {before} before, {repaired} after, {without_row} where each is left out{held_out}"


def _heat_line(checked: CheckResult) -> list[str]:
    """A warning where the rows were measured outside the calibration's temperatures, with what heat alone does."""
    heat = checked.heat
    if heat is None:
        return []
    low, high = (f"{value:.4g}" for value in heat.rows)
    of_rows = low if low == high else f"{low} to {high}"
    return [
        f"{heat.column} {of_rows}, where the calibration saw {heat.calibrated_range[0]:.4g} to {heat.calibrated_range[1]:.4g}: "
        f"{heat.excess:.3g} K "
        f"more or less move the target by some {MILLI_PER_UNIT * heat.growth:.2g} mm, and shift zeros. What follows may be no "
        f"more "
        "than that: check at the calibration's own temperature before anything is mended"
    ]


def _error(error: Bounds) -> str:
    """The model's own error, noise taken off."""
    what = "RMS" if error.axes > 1 else "RMS along what was measured"
    return (
        f"the model's own error there is {MILLI_PER_UNIT * error.estimate:.3f} mm {what}, between "
        f"{MILLI_PER_UNIT * error.low:.3f} and "
        f"{MILLI_PER_UNIT * error.high:.3f} mm"
    )


def _verdict(checked: CheckResult) -> str:
    """Yes or no, and how often that is wrong."""
    chance = f"{checked.first.words}; a calibration that is still right fails {100 * FALSE_ALARMS:g} % of checks"
    if checked.tolerance is None:
        return f"no longer good: {chance}" if checked.contradicted else f"still good: {chance}"
    limit = f"{MILLI_PER_UNIT * checked.tolerance:g} mm"
    if not checked.good:
        return f"no longer good: the error is above {limit} ({chance})"
    if checked.contradicted:
        return f"good enough: the error may be within {limit}, though something moved ({chance})"
    certainty = "is" if checked.error is not None and checked.error.high <= checked.tolerance else "may be"
    return f"still good: the error {certainty} within {limit} ({chance})"


def _cause_lines(
    checked: CheckResult, cause: Cause, change: RepairChange | None, settings: MeasurementSettings
) -> list[str]:
    """One cause: what, by how much, how sure, and what would tell it from another."""
    probability = f" (probability {_percent(cause.probability)})"
    if change is None:
        return [f"odd: {cause.words}{probability}"]
    lines = [f"moved: {cause.words}, by {amount(change, checked)}{probability}"]
    depending = any(not c.basis.always for c in checked.wide.model.coefficients)
    if cause.kind == "zero" and abs(float(change.value[0])) > LARGEST_ZERO_CHANGE and depending:
        lines.append(
            "  effects and gravity loads are those of its readings as they are: set the controller's zero by as much instead, "
            "and the calibration holds as it is"
        )
    if cause.alike:
        lines.append(f"  these rows would also allow: {', '.join(cause.alike)}")
        robot = checked.wide.model.robot
        if not cause.telling:
            lines.append("  no configuration of those tried tells them apart: either repair serves")
        for configuration in cause.telling[:1]:
            cells = counting(settings, robot.readings, robot.kinds).cells(configuration.readings)
            pairs = zip(robot.readings, cells.tolist(), strict=True)
            at = ", ".join(f"{name} {value:.4g}" for name, value in pairs)
            what = "this" if checked.rows.direct else "the target's place here"
            lines.append(f"  measure {what} to tell it from {configuration.suspect}: {at}")
            if configuration.joints:
                lines.append(f"  (it has {enumeration(configuration.joints)} where these rows do not reach)")
    return lines


def amount(change: RepairChange, checked: CheckResult) -> str:
    """By how much something moved."""
    value, std = change.value, change.std
    if change.cause.kind == "zero":
        unit = "mm" if change.units[0] == "m" else "mrad"
        return f"{MILLI_PER_UNIT * value[0]:+.3f} ± {MILLI_PER_UNIT * std[0]:.3f} {unit}"
    if change.cause.kind in ("frame", "new"):
        parts = []
        for unit, unit_shown in (("m", "mm"), ("rad", "mrad")):
            of_unit = [u == unit for u in change.units]
            if any(of_unit):
                size, uncertainty = (MILLI_PER_UNIT * float(np.linalg.norm(vector[of_unit])) for vector in (value, std))
                parts.append(f"{size:.3f} ± {uncertainty:.3f} {unit_shown}")
        return " and ".join(parts)
    suspect = change.cause.suspect
    assert suspect is not None
    before = checked.wide.theta[suspect.touched]
    return f"{_percent(float(np.linalg.norm(value) / np.linalg.norm(before)))} of its size"


def _percent(share: float) -> str:
    """A share with as many digits as tell it from 1."""
    return (
        f"{100 * share:.3g} %"
        if share < 0.995
        else f"{min(100 * share, 99.9):.1f} %"
        if share <= 1
        else f"{100 * share:.0f} %"
    )
