"""The first screen of the report: the error before and after, its causes, what remains, and how far to trust it."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np
from markupsafe import Markup

from aridcal.engine.corrections.catalogue import KINDS, is_of_head
from aridcal.engine.fit.noise import WORTH_SAYING
from aridcal.engine.search.noise_tests import Clue
from aridcal.files.purposes import About
from aridcal.jobs.calibrate.instrument_results import known_scale
from aridcal.jobs.calibrate.joint_zeros import joint_zeros
from aridcal.jobs.calibrate.key_figures import (
    LEAST_HELD_OUT,
    OVERFIT_RATIO,
    PLUS,
    QUESTIONABLE_OUTLIERS,
    Step,
    another_day,
    constants,
    every_held_out_row,
    final_halves,
    generalisation,
    judged_channels,
    narrow_joints,
    or_as_well,
    over_time,
    removed_shares,
    scored,
    sigma_and_error,
    squared,
    steps,
)
from aridcal.jobs.calibrate.outcome import Outcome, errors, leading
from aridcal.jobs.calibrate.verdict import VERDICTS
from aridcal.pages.drawing.frame import card
from aridcal.pages.drawing.html import Content, bullets, codes, fold, tag
from aridcal.pages.drawing.parts import division_in_words, p_of_halves, size_in_words, zero_in_words
from aridcal.pages.drawing.words import (
    NOT_FOR_A_CONTROLLER,
    NOT_STATED,
    at_target_in_words,
    causes_in_words,
    kept_in_words,
    noise_in_words,
    noise_unknown_in_words,
    per_number,
    scale_in_words,
    sigmas_in_words,
    who_and_what,
)
from aridcal.system.wording import counted, number

NO_BETTER = " No model can reliably do better."
BELOW = (
    " The remaining error is smaller than {}, so that is no floor: it is stated too large, or was measured otherwise."
)

LINKED = {
    "calibrated.urdf": "for your controller",
    "calibration.yaml": "for compensation",
    "scene.html": "robot and errors in 3D",
    "certificate.pdf": "the record on one page",
    "result.json": "figures for programs",
}
"""Files of the result that the first screen leads to, and what they are for."""

NOT_READY = {"calibrated.urdf": "not for a controller", "calibration.yaml": "the whole model"}
"""What these files are for where there are too few data."""

GIVEN = {"nominal": "as designed", "geometric": "with the URDF", "final": "with compensation"}
"""Models by what a customer is given of them."""

OF_THE_TARGET = ("position", "rotation")
"""Channels that say how far the target is from where the controller sent it."""

MOST_BARS = 7
MOST_CAUSES = 3
MOST_NAMES = 3

# Share of the squared error below which only its smallness is told.
LEAST_SHARE_SHOWN = 1e-3

SPELLED = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def summary(outcome: Outcome, beside: Collection[str] = frozenset()) -> Iterator[Content]:
    """The first screen: how good before, how good now, why, what remains, can I trust it.

    Args:
        outcome: What was found.
        beside: Names of files that stand beside the page, which it links to.
    """
    m, robot = outcome.measurements, outcome.robot
    files = ", ".join(path.name for path in m.origin.files)
    rows = f"{counted(len(m), 'row')}, {m.test.sum():,} of them held out"
    yield tag("h1", f"Calibration of {robot.tree.name}")
    yield tag("p", f"{files} · {rows} · {robot.path.name}, {robot.from_to}", class_="about")
    yield tag("p", list(_who_and_what(outcome)), class_="about")
    ready = outcome.verdict.for_controller
    if not ready:
        yield tag("p", tag("strong", NOT_FOR_A_CONTROLLER), class_="refused")
    links = [
        part
        for name, use in (LINKED if ready else LINKED | NOT_READY).items()
        if name in beside
        for part in (" · ", tag("a", name, href=name), f": {use}")
    ]
    if links:
        yield tag("p", "In this folder: ", links[1:], class_="about")
    cards = [_card(outcome, k) for k in judged_channels(outcome)]
    yield tag("div", cards, _other_day(outcome), class_="cards")
    for good, words in kept_in_words(outcome, asked=True):
        yield tag("p", tag("strong", words), class_="good" if good else "look")
    _, other_day = another_day(outcome) or ("", "")  # has a card of its own
    checked = [_check(good, words) for good, words in checks(outcome) if words != other_day]
    yield tag(
        "div",
        tag("div", tag("h2", "Main corrections"), list(_causes(outcome))),
        tag("div", tag("h2", "What remains"), list(_remaining(outcome))),
        tag("div", tag("h2", "Can I trust it?"), tag("ul", checked, class_="checks")),
        class_="answers",
    )


def _who_and_what(outcome: Outcome) -> Iterator[Content]:
    """Robot, serial number, instrument, who and when, as far as the campaign states them."""
    about = outcome.campaign.about or About()
    facts = dict(who_and_what(about, outcome.robot, outcome.measurements))
    if not about.robot:
        del facts["Robot"]  # its name is the title
    stated = [f"{name}: {said}" for name, said in facts.items() if said != NOT_STATED]
    yield f"{' · '.join(stated)}. "
    rest = [name.lower() for name, said in facts.items() if said == NOT_STATED]
    if rest:
        yield "Not stated, under "
        yield tag("code", "about:")
        yield f" in the campaign: {', '.join(rest)}."


def _card(outcome: Outcome, k: int) -> Markup:
    """Before and after of one channel in large figures, then one bar for each model."""
    mask, rows = scored(outcome)
    mask = mask & outcome.measurements.measures[:, k]
    channel = outcome.channels[k]
    what, unit = channel.noun, channel.shown
    scores = [(step, errors(step.residual, mask, outcome.channels)[channel.key]) for step in steps(outcome)]
    before, after = scores[0][1], scores[-1][1]
    said = (
        f"On {mask.sum():,} {rows}, the instrument's noise included. 95 % are below {number(after['p95'])} {unit}, "
        f"the largest is {number(after['max'])} {unit}.{at_target_in_words(outcome, k, mask)}"
    )
    bars = _bars([(step, e["rms"]) for step, e in scores], unit)
    own = in_controller(outcome, k)
    below = [tag("p", tag("strong", own)) if own else "", bars]
    return card(what, unit, ("before calibration", before["rms"]), ("after calibration", after["rms"]), said, below)


def in_controller(outcome: Outcome, k: int) -> str:
    """What a controller is left with, by what it is given; empty for a channel that is no error of the robot's own.

    Empty, too, where data are too few for a controller.

    Args:
        outcome: What was found.
        k: Number of the channel.
    """
    channel = outcome.channels[k]
    if channel.name not in OF_THE_TARGET or not outcome.verdict.for_controller:
        return ""
    mask = scored(outcome)[0] & outcome.measurements.measures[:, k]
    urdf, whole = (
        errors(outcome.stage(name).residual, mask, outcome.channels)[channel.key]["rms"]
        for name in ("geometric", "final")
    )
    alone = f"In your controller: {number(urdf)} {channel.shown} with the URDF"
    if not outcome.effects:
        return f"{alone}; compensation adds nothing to it."
    if any(is_of_head(e.effect.kind) for e in outcome.effects):
        return f"{alone}; {number(whole)} {channel.shown} for the whole model, with effects of the measuring head."
    return f"{alone}, {number(whole)} {channel.shown} with compensation."


def _other_day(outcome: Outcome) -> Content:
    """A card on another day's rows; nothing where there are none."""
    verification, said = outcome.verification, another_day(outcome)
    if verification is None or said is None:
        return ""
    rows = verification.measurements
    channel = rows.channels[leading(rows)[0]]
    before, after = (
        errors(verification.residuals[name], ~verification.outlier, rows.channels)[channel.key]["rms"]
        for name in ("nominal", "final")
    )
    word, sentence = said
    below = tag("p", tag("strong", sentence), class_="good" if word == "agrees" else "look")
    noun = f"{channel.noun} on another day"
    days = ("before calibration, that day's rows", before), ("after calibration, that day's rows", after)
    return card(noun, channel.shown, *days, "before → after calibration, on the rows given with --verify.", below)


def _bars(scores: list[tuple[Step, float]], unit: str) -> Markup:
    """One bar for each model; of many the ones before the last are taken together."""
    bars = [(_name(step), value) for step, value in scores]
    if len(bars) > MOST_BARS:
        kept = MOST_BARS - 2
        hidden = len(bars) - kept - 1
        _, reached = bars[-2]
        bars = [*bars[:kept], (f"{PLUS}{hidden} more effects", reached), bars[-1]]
    largest = max(value for _, value in bars) or 1.0
    drawn = []
    for name, value in bars:
        track = tag("span", tag("i", style=f"width:{100 * value / largest:.1f}%"), class_="track")
        figure = tag("span", f"{number(value)} {unit}", class_="value")
        drawn.append(tag("li", tag("span", name, class_="name"), track, figure))
    return tag("ol", drawn, class_="bars")


def _name(step: Step) -> str:
    """Name of a model, as a customer knows it; what equals the whole model keeps its other name."""
    names = step.names[:-1] if len(step.names) > 1 and step.names[-1] == "final" else step.names
    return " = ".join(GIVEN.get(name, name) for name in names)


def _causes(outcome: Outcome) -> Iterator[Content]:
    """Which corrections removed how much of the squared error, and the largest of them."""
    shares = removed_shares(outcome)
    identified = [p for p in constants(outcome) if p["status"] == "identified"]
    if shares and shares[0][1] <= 0.0:
        yield tag("p", f"No correction lowers the {squared(outcome).removeprefix('squared ')} of these rows.")
    elif shares:
        yield tag("p", f"Shares of the {squared(outcome)} that they remove:")
        lines = _shares_in_words(outcome, shares, len(identified))
        yield tag("ul", [tag("li", tag("b", share), " ", who) for share, who in lines], class_="shares")
    words: list[Content] = []
    zeros = joint_zeros(outcome.stage("geometric").fit, outcome.robot)
    of_zeros = {name for zero in zeros for name in zero.names}
    for unit in ("rad", "m"):
        zero = max((z for z in zeros if z.unit == unit), key=lambda z: abs(z.value), default=None)
        if zero is not None:
            words += [", ", f"{zero.joint} zero off by {zero_in_words(zero)} (", codes(zero.names), ")"]
    for unit in ("rad", "m"):
        others = (p for p in identified if p["unit"] == unit and p["name"] not in of_zeros)
        largest = max(others, key=lambda p: abs(p["value"]), default=None)
        if largest is not None:
            words += [", ", tag("code", largest["name"]), f" {size_in_words(largest)}"]
    if words:
        yield tag("p", "Largest: ", words[1:], ".")


def _shares_in_words(outcome: Outcome, shares: list[tuple[Step, float]], corrections: int) -> Iterator[tuple[str, str]]:
    """``86 %`` and ``nine geometric corrections``, ``12 %`` and ``joint_map at joint_2 (the joint's angle errs ...)``.

    Args:
        outcome: What was found.
        shares: Steps with their shares of the squared error, the largest first.
        corrections: How many geometric corrections were identified.
    """
    meanings = {e.effect.label: f"{KINDS[e.effect.kind].words}{or_as_well(e)}" for e in outcome.effects}
    explained = set()
    for step, share in shares[:MOST_CAUSES]:
        geometric = "geometric" in step.names
        who = _corrections_in_words(corrections) if geometric else step.effect or "the final fit"
        meaning = "" if geometric else meanings.get(step.effect, "")
        if meaning and meaning not in explained:
            explained.add(meaning)
            who = f"{who} ({meaning})"
        yield _percent(share), who
    rest = [share for _, share in shares[MOST_CAUSES:]]
    if rest:
        yield _percent(sum(rest)), counted(len(rest), "further correction")


def _corrections_in_words(count: int) -> str:
    """``nine geometric corrections``, ``14 geometric corrections``."""
    spelled = SPELLED[count] if count < len(SPELLED) else f"{count}"
    return f"{spelled} geometric correction{'' if count == 1 else 's'}"


def _percent(share: float) -> str:
    """A share of the squared error in words."""
    return (
        f"{number(100 * share, 2)}\u00a0%"
        if abs(share) >= LEAST_SHARE_SHOWN
        else f"< {100 * LEAST_SHARE_SHOWN:g}\u00a0%"
    )


def _remaining(outcome: Outcome) -> Iterator[Markup]:
    """The verdict with its reasons, and the noise that no model can get below."""
    verdict = outcome.verdict
    if verdict.noise_unknown:
        sentence = noise_unknown_in_words(outcome)
        said = f"{sentence[0].upper()}{sentence[1:]}: declare it in the campaign, or measure some configurations twice."
    else:
        said = VERDICTS[verdict.word].sentences
    repeatable = f" {100 * verdict.share:.0f} % of the remaining variance is repeatable." if verdict.share > 0 else ""
    yield tag("p", said, repeatable)
    if verdict.reasons and not verdict.noise_unknown:
        yield tag("p", "Signs of it:")
        yield bullets(verdict.reasons)
    yield tag("p", _noise(outcome))
    causes = causes_in_words(outcome)
    if causes:
        yield fold("What scatters", tag("p", causes))


def _noise(outcome: Outcome) -> str:
    """The instrument's noise, where it is known from, and whether it is what no model can get below."""
    per_axis = f"{sigmas_in_words(outcome.noise, outcome.channels)} {per_number(outcome)}"
    more = bool(causes_in_words(outcome))
    whose, all_of_it = (" of the instrument", "with all that scatters ") if more else ("", "")
    in_all = f", {all_of_it}{noise_in_words(outcome, outcome.scatter)}" if more or outcome.measurements.direct else ""
    if outcome.noise_source == "declared":
        floor = NO_BETTER if _is_floor(outcome, outcome.noise) else BELOW.format("the declared noise")
        return f"Declared noise{whose}: {per_axis}{in_all}.{floor}"
    said = f"Noise{whose} estimated from the residuals: {per_axis}{in_all}."
    if outcome.repeats is None:
        return said
    repeats = f" Repeats scatter by {noise_in_words(outcome, outcome.repeats.sigma)}."
    floor = NO_BETTER if _is_floor(outcome, outcome.repeats.sigma) else BELOW.format("the scatter of the repeats")
    return f"{said}{repeats}{floor}"


def _is_floor(outcome: Outcome, sigma: np.ndarray) -> bool:
    """True if the final residual is nowhere below a noise, shape (C,), by more than people misstate one by; NaN is none."""
    scatter = outcome.stage("final").fit.estimated
    return not np.any(scatter <= sigma * math.exp(-WORTH_SAYING))


def checks(outcome: Outcome) -> Iterator[tuple[bool, str]]:
    """What speaks for the result (True) and what should be looked at first (False)."""
    yield from _row_checks(outcome)
    yield from _fit_checks(outcome)
    yield from kept_in_words(outcome, asked=False)
    for sentence in scale_in_words(outcome):
        yield known_scale(outcome.measurements) not in (None, math.inf), f"{sentence[0].upper()}{sentence[1:]}."
    sigma_beside_error = None if outcome.measurements.direct else sigma_and_error(outcome)
    if sigma_beside_error is not None:
        sigma, error = sigma_beside_error
        more = (
            ""
            if sigma < error
            else f" The rows agree to {number(error, 2)} mm there: that is consistency, not accuracy."
        )
        yield sigma < error, f"The target is known to ± {number(sigma, 2)} mm (1σ in its worst direction).{more}"
    verified = another_day(outcome)
    if verified is not None:
        yield verified[0] == "agrees", verified[1]
    narrow = [j.name for j in narrow_joints(outcome)]
    if narrow:
        rest = len(narrow) - MOST_NAMES
        more = f" and {rest} more" if rest > 0 else ""
        yield False, f"Less than half of the range was measured of {', '.join(narrow[:MOST_NAMES])}{more}."


def _row_checks(outcome: Outcome) -> Iterator[tuple[bool, str]]:
    """Are rows held out, and how many are bad?"""
    m = outcome.measurements
    held_out, every = (int(outcome.parts()[part].sum()) for part in ("test", "test_all"))
    if every:
        flagged = every - held_out
        none = f"0 of {every:,} held-out rows flagged as outliers"  # the cards have their error
        yield flagged <= QUESTIONABLE_OUTLIERS * every, f"{every_held_out_row(outcome) if flagged else none}."
        if over_time(outcome):
            yield True, f"{over_time(outcome).capitalize()}."
        if 0 < held_out < LEAST_HELD_OUT:
            yield False, f"Checked on {counted(held_out, 'held-out row')} only."
    else:
        yield False, "No rows were held out: the errors above are those of the fit itself, and too optimistic."
    flagged, refused = int(outcome.outlier.sum()), len(m.origin.refused)
    yield flagged <= QUESTIONABLE_OUTLIERS * len(m), f"{counted(flagged, 'outlier')} in {counted(len(m), 'row')}."
    if refused:
        read = len(m) + refused
        yield refused <= QUESTIONABLE_OUTLIERS * read, f"{refused:,} of {counted(read, 'row')} could not be used."


def _fit_checks(outcome: Outcome) -> Iterator[tuple[bool, str]]:
    """Is the minimum the right one, and does the model hold on rows that it was not fitted to?"""
    c = outcome.stage("geometric").fit.convergence
    if c.restarts:
        reached = f"{c.agreed} of {c.restarts} other starting points lead to the same minimum."
        yield c.converged and c.agreed == c.restarts, reached
    else:
        yield c.converged, "The fit converged." if c.converged else "The fit did not converge."
    ratio = generalisation(outcome)
    if ratio is not None:
        differs = any(clue.question == "held_out" and clue.tells for clue in _clues(outcome))
        yield (
            ratio < OVERFIT_RATIO and not differs,
            f"The held-out error is {ratio:.2f} times the error of the fitted rows.",
        )
    halves = final_halves(outcome)
    if halves is not None:
        p = p_of_halves(halves)
        which = division_in_words(halves.of, halves.how)
        disagree = f"Halves of the rows, fitted apart, differ by more than noise explains ({p}): {which}."
        yield halves.agree, f"Halves of the rows, fitted apart, agree ({p})." if halves.agree else disagree


def _clues(outcome: Outcome) -> tuple[Clue, ...]:
    """Answers of all questions to the residual."""
    return () if outcome.diagnosis is None else outcome.diagnosis.clues


def _check(good: bool, text: str) -> Markup:
    """A line with a tick, or with a mark that it needs a look."""
    mark = tag("b", "✓" if good else "!", title="passed" if good else "check this")
    return tag("li", mark, text, class_="good" if good else "look")
