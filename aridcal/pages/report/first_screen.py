"""The first screen of the report: the error before and after, its causes, what remains, and how far to trust it."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from markupsafe import Markup

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, is_of_head
from aridcal.engine.fit.noise import WORTH_SAYING
from aridcal.files.purposes import About
from aridcal.jobs.calibrate.joint_zeros import joint_zeros
from aridcal.jobs.calibrate.key_figures import (
    PLUS,
    ModelStep,
    constants,
    judged_channels,
    or_as_well,
    removed_shares,
    scored,
    squared,
    steps,
    verification_agreement,
)
from aridcal.jobs.calibrate.outcome import Outcome, errors, leading
from aridcal.jobs.calibrate.verdict import VERDICTS
from aridcal.pages.drawing.html import Content, bullets, codes, fold, tag
from aridcal.pages.drawing.page_frame import card
from aridcal.pages.drawing.parts import size_in_words, zero_in_words
from aridcal.pages.drawing.words import (
    NOT_FOR_A_CONTROLLER,
    NOT_STATED_WORDS,
    at_target_in_words,
    causes_in_words,
    certificate_subject,
    noise_in_words,
    noise_unknown_in_words,
    per_number,
    sigmas_in_words,
    tolerance_in_words,
)
from aridcal.pages.report.trust_checks import RULES, other_day
from aridcal.system.wording import number, plural

NO_RELIABLE_MODEL = " No model can reliably do better."
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

GIVEN_MODELS = {"nominal": "as designed", "geometric": "with the URDF", "final": "with compensation"}
"""Models by what a customer is given of them."""

OF_THE_TARGET = ("position", "rotation")
"""Channels that say how far the target is from where the controller sent it."""

MOST_BARS = 7
MOST_SHOWN_CAUSES = 3

# Share of the squared error below which only its smallness is told.
LEAST_SHARE_SHOWN = 1e-3

SPELLED = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def summary(outcome: Outcome, beside: Collection[str] = frozenset()) -> Iterator[Content]:
    """The first screen: how good before, how good now, why, what remains, can I trust it.

    Args:
        outcome: What was found.
        beside: Names of files that stand beside the page, which it links to.
    """
    yield from _title(outcome)
    yield from _files(outcome, beside)
    cards = [_card(outcome, k) for k in judged_channels(outcome)]
    yield tag("div", cards, _other_day(outcome), class_="cards")
    for good, words in tolerance_in_words(outcome, asked=True):
        yield tag("p", tag("strong", words), class_="good" if good else "look")
    yield tag(
        "div",
        tag("div", tag("h2", "Main corrections"), list(_shares(outcome)), list(_largest(outcome))),
        tag("div", tag("h2", "What remains"), list(_remaining(outcome))),
        tag("div", tag("h2", "Can I trust it?"), tag("ul", list(_trust(outcome)), class_="checks")),
        class_="answers",
    )


def _title(outcome: Outcome) -> Iterator[Markup]:
    """Which robot was calibrated from what, by whom, and whether a controller may have the result."""
    m, robot = outcome.measurements, outcome.robot
    files = ", ".join(path.name for path in m.origin.files)
    rows = f"{plural(len(m), 'row')}, {m.test.sum():,} of them held out"
    yield tag("h1", f"Calibration of {robot.tree.name}")
    yield tag("p", f"{files} · {rows} · {robot.path.name}, {robot.from_to}", class_="about")
    yield tag("p", list(_who_and_what(outcome)), class_="about")
    if not outcome.verdict.for_controller:
        yield tag("p", tag("strong", NOT_FOR_A_CONTROLLER), class_="refused")


def _files(outcome: Outcome, beside: Collection[str]) -> Iterator[Markup]:
    """Links to the files of the result that stand beside the page."""
    uses = LINKED if outcome.verdict.for_controller else LINKED | NOT_READY
    there = [(name, use) for name, use in uses.items() if name in beside]
    links = [part for name, use in there for part in (" · ", tag("a", name, href=name), f": {use}")]
    if links:
        yield tag("p", "In this folder: ", links[1:], class_="about")


def _trust(outcome: Outcome) -> Iterator[Markup]:
    """What each rule says, but for another day's rows, which have a card of their own."""
    for rule in RULES:
        if rule is not other_day:
            yield from (_check(good, words) for good, words in rule(outcome))


def _who_and_what(outcome: Outcome) -> Iterator[Content]:
    """Robot, serial number, instrument, who and when, as far as the campaign states them."""
    about = outcome.campaign.about or About()
    facts = dict(certificate_subject(about, outcome.robot, outcome.measurements))
    if not about.robot:
        del facts["Robot"]  # its name is the title
    stated = [f"{name}: {said}" for name, said in facts.items() if said != NOT_STATED_WORDS]
    yield f"{' · '.join(stated)}. "
    rest = [name.lower() for name, said in facts.items() if said == NOT_STATED_WORDS]
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
    verification, said = outcome.verification, verification_agreement(outcome)
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


def _bars(scores: list[tuple[ModelStep, float]], unit: str) -> Markup:
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


def _name(step: ModelStep) -> str:
    """Name of a model, as a customer knows it; what equals the whole model keeps its other name."""
    names = step.names[:-1] if len(step.names) > 1 and step.names[-1] == "final" else step.names
    return " = ".join(GIVEN_MODELS.get(name, name) for name in names)


def _shares(outcome: Outcome) -> Iterator[Markup]:
    """Which corrections removed how much of the squared error."""
    shares = removed_shares(outcome)
    if shares and shares[0][1] <= 0.0:
        yield tag("p", f"No correction lowers the {squared(outcome).removeprefix('squared ')} of these rows.")
    elif shares:
        yield tag("p", f"Shares of the {squared(outcome)} that they remove:")
        lines = _shares_in_words(outcome, shares, len(_identified(outcome)))
        yield tag("ul", [tag("li", tag("b", share), " ", who) for share, who in lines], class_="shares")


def _identified(outcome: Outcome) -> list[dict[str, Any]]:
    """Constants that the rows determine."""
    return [p for p in constants(outcome) if p["status"] == "identified"]


def _largest(outcome: Outcome) -> Iterator[Markup]:
    """The largest error of a joint's zero, and the largest other constant, of each unit."""
    zeros = joint_zeros(outcome.stage("geometric").fit, outcome.robot)
    of_zeros = {name for zero in zeros for name in zero.names}
    others = [p for p in _identified(outcome) if p["name"] not in of_zeros]
    words: list[Content] = []
    for unit in ("rad", "m"):
        zero = max((z for z in zeros if z.unit == unit), key=lambda z: abs(z.value), default=None)
        if zero is not None:
            words += [", ", f"{zero.joint} zero off by {zero_in_words(zero)} (", codes(zero.names), ")"]
    for unit in ("rad", "m"):
        largest = max((p for p in others if p["unit"] == unit), key=lambda p: abs(p["value"]), default=None)
        if largest is not None:
            words += [", ", tag("code", largest["name"]), f" {size_in_words(largest)}"]
    if words:
        yield tag("p", "Largest: ", words[1:], ".")


def _shares_in_words(
    outcome: Outcome, shares: list[tuple[ModelStep, float]], corrections: int
) -> Iterator[tuple[str, str]]:
    """``86 %`` and ``nine geometric corrections``, ``12 %`` and ``joint_map at joint_2 (the joint's angle errs ...)``.

    Args:
        outcome: What was found.
        shares: Steps with their shares of the squared error, the largest first.
        corrections: How many geometric corrections were identified.
    """
    meanings = {e.effect.label: f"{EFFECT_KINDS[e.effect.kind].words}{or_as_well(e)}" for e in outcome.effects}
    explained = set()
    for step, share in shares[:MOST_SHOWN_CAUSES]:
        geometric = "geometric" in step.names
        who = _corrections_in_words(corrections) if geometric else step.effect or "the final fit"
        meaning = "" if geometric else meanings.get(step.effect, "")
        if meaning and meaning not in explained:
            explained.add(meaning)
            who = f"{who} ({meaning})"
        yield _percent(share), who
    rest = [share for _, share in shares[MOST_SHOWN_CAUSES:]]
    if rest:
        yield _percent(sum(rest)), plural(len(rest), "further correction")


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
        floor = NO_RELIABLE_MODEL if _is_floor(outcome, outcome.noise) else BELOW.format("the declared noise")
        return f"Declared noise{whose}: {per_axis}{in_all}.{floor}"
    said = f"Noise{whose} estimated from the residuals: {per_axis}{in_all}."
    if outcome.repeats is None:
        return said
    repeats = f" Repeats scatter by {noise_in_words(outcome, outcome.repeats.sigma)}."
    floor = (
        NO_RELIABLE_MODEL if _is_floor(outcome, outcome.repeats.sigma) else BELOW.format("the scatter of the repeats")
    )
    return f"{said}{repeats}{floor}"


def _is_floor(outcome: Outcome, sigma: np.ndarray) -> bool:
    """True if the final residual is nowhere below a noise, shape (C,), by more than people misstate one by; NaN is none."""
    scatter = outcome.stage("final").fit.estimated
    return not np.any(scatter <= sigma * math.exp(-WORTH_SAYING))


def _check(good: bool, text: str) -> Markup:
    """A line with a tick, or with a mark that it needs a look."""
    mark = tag("b", "✓" if good else "!", title="passed" if good else "check this")
    return tag("li", mark, text, class_="good" if good else "look")
