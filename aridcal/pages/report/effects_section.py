"""The report on the effects in the model: gains, curves, coefficients, what they are confounded with, and what was rejected."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.corrections.effect import ANGULAR, Coefficient, Effect
from aridcal.engine.corrections.labels import label_in
from aridcal.engine.corrections.regional_kind import is_field, is_of_labels, labels_of
from aridcal.engine.trust.gains import Curve, Diagnosis, NamedEffect
from aridcal.jobs.calibrate.folder import step_in_words
from aridcal.jobs.calibrate.outcome import Outcome, errors
from aridcal.pages.drawing.figures import cloud_caption, curve
from aridcal.pages.drawing.html import Content, bullets, figures, fold, table, tag
from aridcal.pages.drawing.words import how_to_separate
from aridcal.system.wording import number, plural, plus_minus, shown_unit

CURVES_IN_SIGHT = 4
MOST_REJECTED = 15
MOST_BARRED = 25

# Periods of a curve from which it needs a wide figure.
MOST_PERIODS_OF_A_NARROW_FIGURE = 5.0

# p-values below it are not written out.
LEAST_P_VALUE_SHOWN = 1e-100

LOAD_UNITS = {"gravity_torque": "N·m", "gravity_moment": "N·m", "payload_torque": "N·m"}
COLUMN_UNITS = {"time": "s", "temperature": "°C", "payload": "kg"}


def effects_in_the_model(outcome: Outcome) -> Iterator[Content]:
    """What each effect gains, its curves and coefficients, and what it is confounded with."""
    if not outcome.effects:
        searched = outcome.diagnosis is not None and outcome.diagnosis.tested > 0
        search = "and the search accepted none" if searched else "and no search was made"
        yield tag("p", f"No effect beyond the geometry was declared, {search}.")
        return
    pairs = [(effect, part) for effect in outcome.effects for part in effect.curves]
    curves = [_curve(outcome, f"effect-{k}", effect, part) for k, (effect, part) in enumerate(pairs)]
    yield figures(curves[:CURVES_IN_SIGHT])
    if len(curves) > CURVES_IN_SIGHT:
        yield fold(plural(len(curves) - CURVES_IN_SIGHT, "more curve"), figures(curves[CURVES_IN_SIGHT:]))
    yield from _confounded(outcome)
    labels = [_by_label(outcome, e.effect) for e in outcome.effects if is_of_labels(e.effect)]
    yield fold("Gain and coefficients of each effect", _gains(outcome), _coefficients(outcome), labels)


def _gains(outcome: Outcome) -> Markup:
    """Errors on held-out rows without each effect and with it."""
    head = ["effect", "moves", "depends on", "source", "p-value"]
    for channel in outcome.channels:
        head += [f"{channel.title} without it", "with it"]
    lines, explained = [], set()
    for e in outcome.effects:
        name: list[Content] = [e.effect.label]
        if e.effect.kind not in explained:
            name += [tag("br"), tag("em", EFFECT_KINDS[e.effect.kind].words)]
            explained.add(e.effect.kind)
        if e.effect.at is not None:
            name += [tag("br"), step_in_words(e.effect, outcome.measurements)]
        line: list[Content] = [name, ", ".join(e.effect.motion), ", ".join(e.effect.covariates)]
        line += ["declared" if e.declared else "found", p_in_words(e.p_value)]
        every = np.ones(len(e.before), dtype=bool)
        before, after = (errors(residual, every, outcome.channels) for residual in (e.before, e.after))
        for channel in outcome.channels:
            line += [number(before[channel.key]["rms"]), number(after[channel.key]["rms"])]
        lines.append(line)
    caption = (
        "Gain of each effect: RMS on the held-out rows of the whole model without it (all else refitted) and with it"
    )
    return table(head, lines, caption, numbers=4)


def p_in_words(p: float) -> str:
    """A p-value to two digits."""
    return "below 1e−100" if p < LEAST_P_VALUE_SHOWN else number(p, 2)


def _curve(outcome: Outcome, key: str, effect: NamedEffect, motion: Curve) -> tuple[Content, Markup]:
    """Caption and picture of one motion of an effect over one covariate."""
    unit, scale = axis_unit(outcome, motion.covariate)
    moved, size = shown_unit(motion.unit)
    label = effect.effect.label
    alt = f"{label}: {motion.component} over {motion.covariate}"
    rows = (scale * motion.row_values, size * motion.pulled)
    labels = (f"{motion.covariate}{unit}", f"{motion.component} [{moved}]")
    periods = max(effect.effect.order, default=0.0) * float(np.ptp(motion.at)) / (2 * math.pi)
    at, value, std = scale * motion.at, size * motion.value, size * motion.std
    picture = curve(key, alt, at, value, std, rows, labels, winding=periods > MOST_PERIODS_OF_A_NARROW_FIGURE)
    span, sigma = number(float(np.ptp(value))), number(float(np.median(std)), 2)
    range_and_sigma = f"{span} {moved} peak to peak, known to {sigma} {moved} (median 1σ)"
    said = f", {motion.component} over {motion.covariate}: {range_and_sigma}{cloud_caption(len(motion.row_values))}"
    return [tag("code", label), said], picture


def axis_unit(outcome: Outcome, covariate: str) -> tuple[str, float]:
    """Unit for the label of an axis, and what a value in SI is multiplied with."""
    unit = _unit(outcome, covariate)
    if unit == "rad":
        return " [°]", 180 / math.pi
    return (f" [{unit}]" if unit else ""), 1.0


def _unit(outcome: Outcome, covariate: str) -> str:
    """SI unit of a covariate; empty where only the user knows."""
    robot = outcome.robot
    kinds = {j.name: j.kind for j in robot.joints} | dict(zip(robot.readings, robot.kinds, strict=True))
    if covariate in kinds:
        return "m" if kinds[covariate] == "prismatic" else "rad"
    joint, _, load = covariate.rpartition(".")
    for ending, unit in LOAD_UNITS.items():
        if joint and load.startswith(ending):
            force = kinds.get(joint) == "prismatic" and not load.startswith("gravity_moment")
            return "N" if force else unit
    for column, unit in COLUMN_UNITS.items():
        if covariate == column or covariate.startswith(f"{column}_"):
            return unit
    return ""


def _coefficients(outcome: Outcome) -> Content:
    """Coefficients of the effects that have few; curves say more of the others."""
    fit = outcome.stage("final").fit
    index = {name: k for k, name in enumerate(fit.model.names)}
    lines: list[list[Content]] = []
    for e in outcome.effects:
        if e.effect.smooth:
            continue
        units = {c.component: c.unit for c in e.curves}
        if is_field(e.effect):
            units = {component: "rad" if component in ANGULAR else "m" for component in e.effect.motion}
        for c in e.effect.coefficients:
            if c.name in index:
                k = index[c.name]
                shown, size = shown_unit(units.get(c.component, "m"))
                value = plus_minus(size * float(fit.theta[k]), size * float(fit.std[k]))
                unit = (shown if c.component in units else "") + _per(outcome, c.basis)
                lines.append([tag("code", c.name), value, unit])
    return table(["coefficient", "value ± 1σ", "unit"], lines, "Coefficients of the effects") if lines else ""


def _by_label(outcome: Outcome, effect: Effect) -> Content:
    """What each label deviates by from the mean of all, and how many fitted rows say so.

    What all of them have in common is as uncertain as they differ, since it is the one model's, too; differences are not.
    """
    fit, m = outcome.stage("final").fit, outcome.measurements
    labels = labels_of(c.basis for c in effect.coefficients)
    turning = {j.name for j in outcome.robot.joints if j.kind == "revolute"}
    shown = {
        component: shown_unit(
            "rad" if component in ANGULAR or (component == "axis" and effect.where in turning) else "m"
        )
        for component in effect.motion
    }
    cells: dict[str, list[Content]] = {name: [] for name in labels}
    for component, (_, size) in shown.items():
        own = [
            fit.model.names.index(Coefficient(effect.where, component, Basis("label", (name,))).name) for name in labels
        ]
        apart = np.eye(len(own)) - 1.0 / len(own)
        value = size * apart @ fit.theta[own]
        std = size * np.sqrt(np.diag(apart @ fit.covariance[np.ix_(own, own)] @ apart))
        for name, *numbers in zip(labels, value.tolist(), std.tolist(), strict=True):
            cells[name].append(plus_minus(*numbers))
    assert m.labels.station is not None
    used = m.labels.station[~m.test & ~outcome.outlier]
    lines = [[label_in(name), str(int(np.sum(used == label_in(name)))), *cells[name]] for name in labels]
    head = ["label", "fitted rows", *(f"{component} [{unit}]" for component, (unit, _) in shown.items())]
    caption = f"{effect.label}: how each label deviates from the mean of all, ± 1σ; any other label has the one model"
    return table(head, lines, caption)


def _per(outcome: Outcome, basis: Basis) -> str:
    """What a coefficient's unit is divided by: the unit of what it is multiplied with."""
    if basis.form not in ("linear", "times_power"):  # the other bases have no unit
        return ""
    unit = _unit(outcome, basis.of[0])
    if not unit:
        return f" per unit of {basis.of[0]}"
    power = basis.numbers[2] if basis.form == "times_power" else 0.0
    if power and basis.numbers[1] == 1.0:  # a travel that is not scaled to its range
        unit += "·m" if power == 1.0 else f"·m^{power:g}"
    return f" / {f'({unit})' if '·' in unit else unit}"


def _confounded(outcome: Outcome) -> Iterator[Content]:
    """Which effects these data cannot separate from those in the model, and what to measure."""
    m, robot = outcome.measurements, outcome.robot
    positions = robot.positions(m.readings)
    columns = dict(zip(robot.names, positions.T, strict=True)) | m.conditions
    lines: list[list[Content]] = []
    for e in outcome.effects:
        for other in e.confounded_with:
            lines.append([e.effect.label, other.label, how_to_separate(e.effect, other, robot, columns)])
    if not lines:
        yield tag("p", "No other effect that was tested explains these data as well.")
        return
    head = ["effect in the model", "confounded with", "to separate them"]
    shown = table(head, lines, "Effects that these data cannot separate", numbers=3)
    yield fold("Effects that these data cannot separate, and what to measure", shown)


def other_candidates(diagnosis: Diagnosis) -> Iterator[Content]:
    """What the search rejected, and what it could not test."""
    if not diagnosis.tested:
        return
    said: list[Content] = [
        tag(
            "p",
            "First the known kinds of effect, then functions of one or two covariates for what no known kind explains.",
        )
    ]
    if diagnosis.rejected:
        lines = [[r.effect.label, p_in_words(r.p_value), r.why] for r in diagnosis.rejected[:MOST_REJECTED]]
        head = ["effect", "p-value", "why rejected"]
        said.append(table(head, lines, "Best of the rejected candidates", numbers=3))
    if diagnosis.barred:
        said.append(tag("p", "These data cannot test:"))
        said.append(
            bullets((f"{b.what}: {b.why}" for b in diagnosis.barred), MOST_BARRED, "more that could not be tested")
        )
    yield fold(f"{plural(diagnosis.tested, 'candidate')} tested; why the best of the others were rejected", said)
