"""The fifth question of a report: if the model does not fit, on what does the rest depend?"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from aridcal.apart import MEANING, tell_apart
from aridcal.effects import Basis
from aridcal.markup import Content, Html, bullets, counted, figures, number, plus_minus, table, tag
from aridcal.outcome import Curve, Diagnosis, NamedEffect, Order, Outcome, Trace
from aridcal.plots import Trend, correlogram, curve, panels
from aridcal.quality import joint_kinds
from aridcal.sections import ERRORS, norms
from aridcal.whiteness import LEAST, SURE

MOST_REJECTED = 15
MOST_BARRED = 25
MOST_TRACES = 12
WINDING = 5.0  # periods of a curve that needs a wide figure

UNITS = {"gravity_torque": "N·m", "gravity_moment": "N·m", "payload_torque": "N·m"}
COLUMNS = {"time": "s", "temperature": "°C", "payload": "kg"}


def depends(outcome: Outcome) -> Iterator[Content]:
    """5: if it does not fit, on what does the rest depend?"""
    if outcome.diagnosis is not None:
        yield from _effects(outcome)
        yield from _clues(outcome.diagnosis)
    yield from _in_order(outcome.traces.order)
    yield from _joints(outcome)
    yield from _strongest(outcome)
    if outcome.diagnosis is not None:
        yield from _search(outcome.diagnosis)


def _clues(found: Diagnosis) -> Iterator[Content]:
    yield tag("h3", "Is what remains noise?")
    lines = []
    for what, share, p in found.clues:
        tells = share > LEAST and p < SURE
        lines.append([what, f"{100 * share:.0f} %", _chance(p), "yes" if tells else "no"])
    if lines:
        head = ["question", "share of the variance", "chance if all were noise", "beyond chance"]
        yield table(head, lines, "What the residual of the final model was asked")


def _in_order(order: Order) -> Iterator[Content]:
    """Runs and correlation from one row to the next."""
    if len(order.lags) == 0:
        return
    place = "in the order of time" if order.timed else "in the order of the table, since no time was recorded"
    strays = np.abs(order.correlation) > order.bound
    follows = order.p_value < SURE or strays.mean() > 0.2
    yield tag(
        "p",
        f"From one row to the next, {place}, residuals change sign {order.changes:,} times; noise would make "
        f"{order.expected:,.0f} ± {order.spread:,.0f} (chance of so few: {number(order.p_value, 2)}). "
        f"{counted(int(strays.sum()), 'correlation')} of {len(order.lags)} leave the band of noise, where about "
        f"{max(round(0.05 * len(order.lags)), 1)} may by chance: ",
        "residuals follow one another. Either something changed slowly while these rows were measured, or rows that "
        "follow one another are alike in some other way that the model lacks."
        if follows
        else "nothing is seen that changes slowly while measuring.",
    )
    label = f"rows apart, {'in the order of time' if order.timed else 'in the order of the table'} [1]"
    alt = "Correlation of residuals over the number of rows between them"
    yield figures([
        ("Do neighbours in time err alike? Correlation of residuals, mean of all axes",
         correlogram("order", alt, order.lags, order.correlation, order.bound, label))
    ])  # fmt: skip


def _joints(outcome: Outcome) -> Iterator[Content]:
    """The residual as an error of each joint, over that joint."""
    found = outcome.traces.joints
    if not found:
        return
    yield tag("h3", "What is left, as an error of each joint")
    yield tag(
        "p",
        "Each dot is the motion of that joint which would best explain what one row leaves. Bars are means of slices of "
        "rows, ± 2σ of noise; the line is a smooth curve through them. Rows where the joint hardly moves the target are "
        "left out.",
    )
    drawn = []
    for k, t in enumerate(found):
        caption = [tag("code", t.motion), f": {_said(t, len(found), bool(outcome.effects))}"]
        drawn.append((caption, _picture(outcome, f"joint-{k}", t)))
    yield figures(drawn)


def _said(t: Trace, asked: int, effects: bool) -> str:
    """What is seen of a trace, in a sentence."""
    unit = "mrad" if t.unit == "rad" else "mm"

    def seen(size: float, p_value: float) -> str:
        chance = min(1.0, p_value * asked)
        if chance > SURE:
            return f"nothing beyond chance (p = {_chance(chance)})"
        return f"{number(1e3 * size, 2)} {unit} RMS that repeats (p {'' if chance < 1e-100 else '= '}{_chance(chance)})"

    now = seen(t.size_after, t.p_value)
    return f"without effects {seen(t.size_before, t.p_before)}, now {now}." if effects else f"{now}."


def _picture(outcome: Outcome, key: str, t: Trace) -> Html:
    unit, scale = axis_unit(outcome, t.covariate)
    moved = "mrad" if t.unit == "rad" else "mm"
    trends = {
        "now": Trend(scale * t.centre, 1e3 * t.mean_after, 1e3 * t.std, scale * t.at, 1e3 * t.smooth_after),
    }
    values = {"now": 1e3 * t.after}
    if outcome.effects:
        name = "without effects"
        trends = {name: Trend(scale * t.centre, 1e3 * t.mean_before, 1e3 * t.std, scale * t.at, 1e3 * t.smooth_before),
                  **trends}  # fmt: skip
        values = {name: 1e3 * t.before, **values}
    alt = f"What remains as a motion of {t.motion}, over {t.covariate}"
    return panels(key, alt, scale * t.seen, values, (f"{t.covariate}{unit}", f"{t.motion} [{moved}]"), trends)


def _strongest(outcome: Outcome) -> Iterator[Content]:
    """On which joint, load or column anything depends."""
    found = sorted(outcome.traces.strongest, key=lambda t: t.p_value)
    if not found:
        return
    asked = outcome.traces.asked
    yield tag("h3", "What is left, against all that was recorded")
    seen = [t for t in found if t.p_value * asked <= SURE]
    yield tag(
        "p",
        f"Every joint's own motion and every axis of the world was set against every joint, load and column: "
        f"{counted(asked, 'question')}. ",
        f"{counted(len(seen), 'dependence')} cannot be chance; the clearest is that of {seen[0].motion} on "
        f"{seen[0].covariate}."
        if seen
        else "None of the answers is more than chance would give among so many.",
    )
    lines = []
    for t in found[:MOST_TRACES]:
        unit = "mrad" if t.unit == "rad" else "mm"
        sizes = [f"{number(1e3 * v, 2)} {unit}" if v > 0 else "0" for v in (t.size_before, t.size_after)]
        chance = min(1.0, t.p_value * asked)
        lines.append([
            tag("code", t.covariate), t.motion, *(sizes if outcome.effects else sizes[1:]), _chance(chance),
            "yes" if chance <= SURE else "no",
        ])  # fmt: skip
    sizes = ["without effects", "now"] if outcome.effects else ["now"]
    head = ["what remains, over", "seen most clearly in", *sizes, f"chance among {asked}", "beyond chance"]
    yield table(head, lines, "RMS of the slices' means beyond their noise, the clearest first", numbers=2)
    own = {(t.motion, t.covariate) for t in outcome.traces.joints}
    columns = set(outcome.measurements.covariates)
    worth = [
        t for t in found if (t.motion, t.covariate) not in own and (t.p_value * asked <= SURE or t.covariate in columns)
    ]
    yield figures(
        ([tag("code", t.motion), " over ", tag("code", t.covariate), f": {_said(t, asked, bool(outcome.effects))}"],
         _picture(outcome, f"trace-{k}", t))
        for k, t in enumerate(worth[:MOST_TRACES])
    )  # fmt: skip


def _effects(outcome: Outcome) -> Iterator[Content]:
    if not outcome.effects:
        yield tag("p", "No effect beyond the geometry was declared, and none was found that earns its place.")
        return
    yield tag("h3", "Effects in the model")
    pose = outcome.measurements.quaternion is not None
    yield _gains(outcome.effects, pose)
    pairs = [(e, c) for e in outcome.effects for c in e.curves]
    yield figures(_curve(outcome, f"effect-{k}", e, c) for k, (e, c) in enumerate(pairs))
    yield _coefficients(outcome)
    yield from _twins(outcome)


def _twins(outcome: Outcome) -> Iterator[Content]:
    """What these data cannot tell from the effects named, and what would."""
    lines: list[list[Content]] = []
    m, robot = outcome.measurements, outcome.robot
    columns = dict(zip(robot.names, robot.positions(m.readings).T, strict=True)) | dict(m.covariates)
    for e in outcome.effects:
        for twin in e.confounded_with:
            lines.append([e.effect.label, twin.label, tell_apart(e.effect, twin, robot, columns)])
    yield tag("h3", "What may be another effect instead")
    if lines:
        yield table(
            ["named", "would do as well", "to tell them apart"], lines, "Effects that these data cannot tell apart",
            numbers=3,
        )  # fmt: skip
    else:
        yield tag("p", "No other effect that was tried would do as well in the place of any of those named.")


def _gains(effects: tuple[NamedEffect, ...], pose: bool) -> Html:
    head = ["effect", "moves", "depends on", "", "chance of being noise"]
    for what in list(ERRORS.values())[: 1 + pose]:
        head += [f"{what} without it", "with it"]
    lines, known = [], set()
    for e in effects:
        name: list[Content] = [e.effect.label]
        if e.effect.kind not in known:
            name += [tag("br"), tag("em", MEANING[e.effect.kind])]
            known.add(e.effect.kind)
        line: list[Content] = [name, ", ".join(e.effect.motion), ", ".join(e.effect.covariates)]
        line += ["declared" if e.declared else "found", _chance(e.p_value)]
        for k in range(1 + pose):
            line += [number(_rms(norms(r)[k])) for r in (e.before, e.after)]
        lines.append(line)
    caption = (
        "Gain of each effect: RMS on rows never used, of the whole model without it (the rest refitted) and with it"
    )
    return table(head, lines, caption, numbers=4)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _chance(p: float) -> str:
    return "below 1e−100" if p < 1e-100 else number(p, 2)


def _curve(outcome: Outcome, key: str, effect: NamedEffect, found: Curve) -> tuple[Content, Html]:
    unit, scale = axis_unit(outcome, found.covariate)
    moved = "mm" if found.unit == "m" else "mrad"
    alt = f"{effect.effect.label}: {found.component} over {found.covariate}"
    rows = (scale * found.seen, 1e3 * found.pulled)
    labels = (f"{found.covariate}{unit}", f"{found.component} [{moved}]")
    winds = max(effect.effect.order, default=0.0) * float(np.ptp(found.at)) / (2 * math.pi) > WINDING
    picture = curve(
        key, alt, scale * found.at, 1e3 * found.value, 1e3 * found.std, rows, labels, wide=winds
    )  # fmt: skip
    span, known = 1e3 * float(np.ptp(found.value)), 1e3 * float(np.median(found.std))
    seen = f": {number(span)} {moved} from lowest to highest, known to {number(known, 2)} {moved} (median 1σ)"
    return [tag("code", effect.effect.label), f", {found.component} over {found.covariate}{seen}"], picture


def axis_unit(outcome: Outcome, covariate: str) -> tuple[str, float]:
    """Unit for the label of an axis, and what a value in SI is multiplied with."""
    unit = _unit(outcome, covariate)
    if unit == "rad":
        return " [°]", 180 / math.pi
    return (f" [{unit}]" if unit else ""), 1.0


def _unit(outcome: Outcome, covariate: str) -> str:
    """SI unit of a covariate; empty where only the user knows."""
    robot = outcome.robot
    joints = {j.name: j.kind for j in robot.joints} | dict(zip(robot.readings, joint_kinds(robot), strict=True))
    if covariate in joints:
        return "m" if joints[covariate] == "prismatic" else "rad"
    joint, _, load = covariate.rpartition(".")
    for key, unit in UNITS.items():
        if joint and load.startswith(key):
            force = joints.get(joint) == "prismatic" and not load.startswith("gravity_moment")
            return "N" if force else unit
    return next((u for key, u in COLUMNS.items() if covariate == key or covariate.startswith(f"{key}_")), "")


def _coefficients(outcome: Outcome) -> Content:
    """Coefficients of the effects that have few; curves say more of the others."""
    fit = outcome.stage("final").fit
    index = {name: k for k, name in enumerate(fit.model.names)}
    lines = []
    for e in outcome.effects:
        units = {c.component: "mm" if c.unit == "m" else "mrad" for c in e.curves}
        for c in () if e.effect.smooth else e.effect.coefficients:
            if c.name in index:
                k = index[c.name]
                value = plus_minus(1e3 * float(fit.theta[k]), 1e3 * float(fit.std[k]))
                lines.append([tag("code", c.name), value, units.get(c.component, "") + _per(outcome, c.basis)])
    if not lines:
        return ""
    return table(["coefficient", "value ± 1σ", "unit"], lines, "Coefficients of the effects")


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


def _search(found: Diagnosis) -> Iterator[Content]:
    if not found.tested:
        return
    yield tag("h3", "What else was tried")
    yield tag(
        "p",
        f"{counted(found.tested, 'candidate')} tested in all: the effects that have a name, then functions of one or two "
        "covariates for what has none.",
    )
    if found.rejected:
        lines = [[r.effect.label, _chance(r.p_value), r.why] for r in found.rejected[:MOST_REJECTED]]
        yield table(["effect", "chance of being noise", "why not"], lines, "Best of those not taken", numbers=3)
    if found.barred:
        yield tag("p", "Not tested, because these data cannot:")
        yield bullets((f"{what}: {why}" for what, why in found.barred), MOST_BARRED, "more that could not be tested")
