"""Question 5 of the report: what drives the remaining error?"""

from __future__ import annotations

from collections.abc import Iterator

from markupsafe import Markup

from aridcal.engine.search.noise_tests import FALSE_ALARM
from aridcal.engine.search.residual_trends import Course, Order, Trace
from aridcal.engine.trust.gains import Diagnosis
from aridcal.jobs.calibrate.key_figures import (
    clear_traces,
    corrected,
    significant,
    slowly_changing,
    stray_autocorrelations,
)
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.figures import Trend, cloud_caption, correlogram, panels
from aridcal.pages.drawing.html import Content, figures, fold, table, tag
from aridcal.pages.report.effects_section import axis_unit, effects_in_the_model, other_candidates, p_in_words
from aridcal.system.progress import SILENT, Progress
from aridcal.system.wording import number, shown_unit

MOST_TRACES = 12

# Share of autocorrelations that noise puts outside its 95 % band.
SHARE_OUTSIDE_BAND = 0.05

# The two models that are compared.
WITHOUT, WITH = "without effects", "final model"


def drives(outcome: Outcome, progress: Progress = SILENT) -> Iterator[Content]:
    """Question 5: what drives the remaining error?"""
    if outcome.diagnosis is not None:
        yield from effects_in_the_model(outcome)
        yield from _noise_tests(outcome.diagnosis)
    yield from _in_order(outcome.traces.order)
    yield from _joints(outcome, progress)
    yield from _strongest(outcome, progress)
    if outcome.diagnosis is not None:
        yield from other_candidates(outcome.diagnosis)


def _noise_tests(diagnosis: Diagnosis) -> Iterator[Content]:
    """Tests of the final model's residual."""
    lines = []
    for clue in diagnosis.clues:
        answer = "yes" if clue.tells else "yes, but too little to matter" if clue.p_value < FALSE_ALARM else "no"
        lines.append([clue.what, f"{100 * clue.share:.0f} %", p_in_words(clue.p_value), answer])
    if lines:
        head = ["sign of structure", "share of the variance", "p-value", "significant"]
        shown = table(head, lines, "Signs of structure in the residual of the final model")
        yield fold(_signs_in_words(sum(clue.tells for clue in diagnosis.clues), len(lines)), shown)


def _signs_in_words(significant: int, tested: int) -> str:
    """How many signs of structure there are."""
    return f"Is the remaining error noise? {significant or 'None'} of {tested} signs of structure {_are(significant)} significant"


def _are(count: int) -> str:
    return "is" if count == 1 else "are"


def _in_order(order: Order) -> Iterator[Content]:
    """Runs and correlation from one row to the next."""
    count = len(order.lags)
    if count == 0:
        return
    ordered = "time order" if order.timed else "table order"
    place = f"In {ordered}" if order.timed else f"In {ordered} (no time was recorded)"
    off, by_chance = stray_autocorrelations(order), max(round(SHARE_OUTSIDE_BAND * count), 1)
    said = tag(
        "p",
        f"{place}, residuals change sign {order.changes:,} times from one row to the next; pure noise gives "
        f"{order.expected:,.0f} ± {order.spread:,.0f} (p = {number(order.p_value, 2)} for so few). {off} of {count} "
        f"autocorrelations {_are(off)} outside the 95 % band of noise; about {by_chance} may be by chance.",
    )
    title = "There is no sign of a slow change during the measurement"
    if slowly_changing(order):
        title = "Consecutive rows have similar residuals: something changed slowly, or they share what the model lacks"
    alt = "Autocorrelation of the residuals over the number of rows between them"
    label = f"lag in rows, {ordered} [1]"
    picture = correlogram("order", alt, order.lags, order.correlation, order.bound, label)
    yield fold(title, said, figures([("Autocorrelation of the residuals, mean over all axes", picture)]))


def _joints(outcome: Outcome, progress: Progress) -> Iterator[Content]:
    """The residual as an error of each joint, over that joint."""
    traces = outcome.traces.joints
    if not traces:
        return
    said = tag(
        "p",
        "Each dot is the motion of that joint which best explains the residual of one row. Bars are means over groups of "
        "rows, ± 2σ of noise; the line is a smooth curve through them. Rows at which the joint hardly moves the target are "
        "left out.",
    )
    drawn: list[tuple[Content, Markup]] = []
    for k, trace in enumerate(progress.over(traces, "pictures of joints")):
        caption = [
            tag("code", trace.motion),
            f": {_in_words(outcome, trace, len(traces))}",
            cloud_caption(len(trace.covariate_values)),
        ]
        drawn.append((caption, _picture(outcome, f"joint-{k}", trace)))
    waving = sum(corrected(trace.after.p_value, len(traces)) <= FALSE_ALARM for trace in traces)
    title = f"Remaining error as an error of each joint: {waving or 'none'} of {len(traces)} {_are(waving)} significant"
    yield fold(title, said, figures(drawn))


def _in_words(outcome: Outcome, trace: Trace, tests: int) -> str:
    """What a trace shows, in a sentence."""
    now = _size_in_words(trace, trace.after, tests)
    if not outcome.effects:
        return f"{now}."
    return f"{WITHOUT} {_size_in_words(trace, trace.before, tests)}; {WITH} {now}."


def _size_in_words(trace: Trace, course: Course, tests: int) -> str:
    """A repeatable part with its p-value, corrected for the number of those asked about."""
    p = corrected(course.p_value, tests)
    if p > FALSE_ALARM:
        return f"nothing significant (p = {p_in_words(p)})"
    return f"{_size(trace, course)} RMS repeatable (p {'' if p < 1e-100 else '= '}{p_in_words(p)})"


def _unit(trace: Trace) -> str:
    return "sigma" if trace.unit == "1" else shown_unit(trace.unit)[0]


def _size(trace: Trace, course: Course) -> str:
    """The size of a trace with one model, in its own unit, in words."""
    return f"{number(shown_unit(trace.unit)[1] * course.size, 2)} {_unit(trace)}" if course.size > 0 else "0"


def _models(outcome: Outcome, trace: Trace) -> dict[str, Course]:
    """A trace with each of the models that are compared."""
    return {WITHOUT: trace.before, WITH: trace.after} if outcome.effects else {WITH: trace.after}


def _picture(outcome: Outcome, key: str, trace: Trace) -> Markup:
    """The rows' motions over a covariate, with their means and smooth curves."""
    unit, scale = axis_unit(outcome, trace.covariate)
    centre, at = scale * trace.centre, scale * trace.at
    models = _models(outcome, trace)
    size = shown_unit(trace.unit)[1]
    values = {name: size * course.rows for name, course in models.items()}
    trends = {
        name: Trend(centre, size * course.mean, size * trace.std, at, size * course.smooth)
        for name, course in models.items()
    }
    alt = f"Remaining error as a motion of {trace.motion}, over {trace.covariate}"
    labels = (f"{trace.covariate}{unit}", f"{trace.motion} [{_unit(trace)}]")
    return panels(key, alt, scale * trace.covariate_values, values, labels, trends)


def _strongest(outcome: Outcome, progress: Progress) -> Iterator[Content]:
    """On which joint, load or column anything depends."""
    traces, tests = clear_traces(outcome), outcome.traces.pairs_tested
    if not traces:
        return
    clear = [trace for trace in traces if significant(trace, tests)]
    title = "Remaining error against every recorded quantity: "
    title += f"clearest is {clear[0].motion} on {clear[0].covariate}" if clear else "no dependence is significant"
    said = tag(
        "p",
        "The residual along each joint's own motion and along each world axis was tested against every joint, load and "
        f"column: {tests:,} tests. {len(clear) or 'None'} {_are(len(clear))} significant.",
    )
    own = {(trace.motion, trace.covariate) for trace in outcome.traces.joints}  # are drawn above
    columns = set(outcome.measurements.covariates)
    worth = [
        trace
        for trace in traces
        if (trace.motion, trace.covariate) not in own and (significant(trace, tests) or trace.covariate in columns)
    ]
    drawn: list[tuple[Content, Markup]] = []
    for k, trace in enumerate(progress.over(worth[:MOST_TRACES], "pictures of dependences")):
        names = [tag("code", trace.motion), " over ", tag("code", trace.covariate)]
        caption = [*names, f": {_in_words(outcome, trace, tests)}", cloud_caption(len(trace.covariate_values))]
        drawn.append((caption, _picture(outcome, f"trace-{k}", trace)))
    yield fold(title, said, _trace_table(outcome, traces[:MOST_TRACES]), figures(drawn))


def _trace_table(outcome: Outcome, traces: list[Trace]) -> Markup:
    """Size and p-value of some dependences."""
    tests = outcome.traces.pairs_tested
    lines: list[list[Content]] = []
    for trace in traces:
        sizes = [_size(trace, course) for course in _models(outcome, trace).values()]
        p = p_in_words(corrected(trace.after.p_value, tests))
        verdict = "yes" if significant(trace, tests) else "no"
        lines.append([tag("code", trace.covariate), trace.motion, *sizes, p, verdict])
    models = [WITHOUT, WITH] if outcome.effects else [WITH]
    head = ["quantity", "clearest in", *models, f"p-value, corrected for {tests:,} tests", "significant"]
    caption = "Repeatable part of the remaining error, RMS, the most significant first"
    return table(head, lines, caption, numbers=2)
