"""The fifth question of a report: if the model does not fit, on what does the rest depend?"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from aridcal.markup import Content, Html, bullets, counted, figures, number, plus_minus, table, tag
from aridcal.outcome import Curve, Diagnosis, NamedEffect, Outcome
from aridcal.plots import curve, profile
from aridcal.quality import joint_kinds
from aridcal.sections import ERRORS, norms

MOST_REJECTED = 15
MOST_BARRED = 25


def depends(outcome: Outcome) -> Iterator[Content]:
    """5: if it does not fit, on what does the rest depend?"""
    if outcome.diagnosis is not None:
        yield from _effects(outcome)
        yield from _search(outcome.diagnosis)
    yield tag("h3", "What is left, against each joint")
    yield tag(
        "p",
        "Where only noise is left, the RMS of the slices follows the dashed line; where it departs from it in several "
        "slices together, something that depends on this joint may be left.",
    )
    rows = ~outcome.outlier
    for k, left in enumerate(norms(outcome.stages[-1].residual[rows])):
        key, what = list(ERRORS.items())[k]
        drawn = []
        for i, name in enumerate(outcome.robot.readings):
            unit, scale = _unit(outcome, name)
            q = scale * outcome.measurements.readings[rows, i]
            picture = profile(f"{key}-{i}", f"{what} after calibration, over {name}", q, left, (f"{name}{unit}", what))
            drawn.append(([f"{what.split(' [')[0].capitalize()} over ", tag("code", name)], picture))
        yield figures(drawn)


def _effects(outcome: Outcome) -> Iterator[Content]:
    if not outcome.effects:
        yield tag("p", "No effect beyond the geometry was declared, and none was found that earns its place.")
        return
    yield tag("h3", "Effects in the model")
    pose = outcome.measurements.quaternion is not None
    yield _gains(outcome.effects, pose)
    twins = [e for e in outcome.effects if e.confounded_with]
    if twins:
        yield tag("p", "These data cannot tell some of them from others:")
        yield bullets(f"{e.effect.label}: or {', '.join(t.label for t in e.confounded_with)}" for e in twins)
    drawn = [
        _curve(outcome, f"effect-{i}-{k}", e, c) for i, e in enumerate(outcome.effects) for k, c in enumerate(e.curves)
    ]
    yield figures(drawn)
    yield _coefficients(outcome)


def _gains(effects: tuple[NamedEffect, ...], pose: bool) -> Html:
    head = ["effect", "moves", "depends on", "", "chance of being noise"]
    for what in list(ERRORS.values())[: 1 + pose]:
        head += [f"{what} without it", "with it"]
    lines = []
    for e in effects:
        line = [e.effect.label, ", ".join(e.effect.motion), ", ".join(e.effect.covariates)]
        line += ["declared" if e.declared else "found", _chance(e.p_value)]
        for k in range(1 + pose):
            line += [number(_rms(norms(r)[k])) for r in (e.before, e.after)]
        lines.append(line)
    caption = "Gain of each effect: RMS on rows never used, of the whole model without it (refitted) and with it"
    return table(head, lines, caption, numbers=4)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _chance(p: float) -> str:
    return "below 1e−100" if p < 1e-100 else number(p, 2)


def _curve(outcome: Outcome, key: str, effect: NamedEffect, found: Curve) -> tuple[Content, Html]:
    unit, scale = _unit(outcome, found.covariate)
    moved = "mm" if found.unit == "m" else "mrad"
    alt = f"{effect.effect.label}: {found.component} over {found.covariate}"
    rows = (scale * found.seen, 1e3 * found.pulled)
    labels = (f"{found.covariate}{unit}", f"{found.component} [{moved}]")
    picture = curve(key, alt, scale * found.at, 1e3 * found.value, 1e3 * found.std, rows, labels)
    span, known = 1e3 * float(np.ptp(found.value)), 1e3 * float(np.median(found.std))
    seen = f": {number(span)} {moved} from lowest to highest, known to {number(known, 2)} {moved} (median 1σ)"
    return [tag("code", effect.effect.label), f", {found.component} over {found.covariate}{seen}"], picture


def _unit(outcome: Outcome, covariate: str) -> tuple[str, float]:
    """Unit for the label of an axis, and what a value in SI is multiplied with."""
    kinds = dict(zip(outcome.robot.readings, joint_kinds(outcome.robot), strict=True))
    if covariate not in kinds:
        return "", 1.0
    return (" [m]", 1.0) if kinds[covariate] == "prismatic" else (" [°]", 180 / math.pi)


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
                lines.append([tag("code", c.name), f"{value} {units.get(c.component, '')}"])
    if not lines:
        return ""
    return table(["coefficient", "value ± 1σ"], lines, "Coefficients, per unit of what they are multiplied with")


def _search(found: Diagnosis) -> Iterator[Content]:
    if found.clues:
        lines = [[what, f"{100 * share:.0f} %", _chance(p)] for what, share, p in found.clues]
        yield tag("h3", "Is what remains noise?")
        head = ["question", "share of the variance that is not", "chance of being noise"]
        yield table(head, lines, "What the residual of the final model was asked")
    if not found.tested:
        return
    yield tag("h3", "What else was tried")
    yield tag("p", f"{counted(found.tested, 'candidate')} tested.")
    if found.rejected:
        lines = [[r.effect.label, _chance(r.p_value), r.why] for r in found.rejected[:MOST_REJECTED]]
        yield table(["effect", "chance of being noise", "why not"], lines, "Best of those not taken", numbers=3)
    if found.barred:
        yield bullets((f"{what}: {why}" for what, why in found.barred), MOST_BARRED, "more that could not be tested")
