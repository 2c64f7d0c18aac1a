"""The report on parts of the rows: halves fitted apart, parts left out, single rows, and what all tell of the constants."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from aridcal.engine.levels import JUDGING_FOLDS
from aridcal.engine.trust.combinations import Combination, Identifiability
from aridcal.engine.trust.cross_validation import DECIDING_SHIFT, Influence
from aridcal.engine.trust.halves import Halves
from aridcal.jobs.calibrate.instrument_results import known_scale_sigma
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.html import Content, bullets, fold, table, tag
from aridcal.pages.drawing.parts import (
    combination_in_words,
    constant_in_words,
    division_in_words,
    p_of_halves,
    pair_in_words,
)
from aridcal.pages.report.data_section import row_place
from aridcal.system.wording import number, plural

MOST_INFLUENTIAL_ROWS = 5
MOST_PAIRS = 5
AT_AN_END = 4
"""Combinations that are shown at either end of the list."""

TOO_FEW = "There are too few rows to fit halves of them separately and compare the models."


def halves(outcome: Outcome) -> Iterator[Content]:
    """Whether models fitted to halves of the rows agree."""
    looked = outcome.second_look
    if looked is None:
        return
    comparisons = {name: each for name, each in looked.halves.items() if each is not None}
    if not comparisons:
        yield tag("p", TOO_FEW)
        return
    last = list(comparisons.values())[-1]
    title = f"Halves of the rows, fitted apart: they {'agree' if last.agree else 'disagree'} ({p_of_halves(last)})"
    said = tag(
        "p",
        f"The rows are divided into halves in {last.divisions} ways: by blocks of a reading, a load, another column or time. "
        f"Constants and effects are fitted to each half apart. {_judgement(last)}",
    )
    placed = known_scale_sigma(outcome.measurements) is not None
    head = [
        "model",
        "halves that differ most",
        "squared difference (1: noise, in any one division)",
        "chance that noise does it",
    ]
    lines = []
    for name, each in comparisons.items():
        line: list[Content] = [name, division_in_words(each.of, each.how), number(each.squares), p_of_halves(each)]
        lines.append([*line, number(1e3 * each.measured), number(1e3 * each.expected)] if placed else line)
    shown = table(
        [*head, "at the target [mm]", "of that from noise [mm]"] if placed else head,
        lines,
        "Halves fitted apart, both frames moved so that the two agree best",
        numbers=2,
    )
    yield fold(title, said, shown)


def _judgement(comparison: Halves) -> str:
    """What the halves of the final model say."""
    if comparison.agree:
        return f"Noise explains what differs ({p_of_halves(comparison)})."
    return (
        f"Noise does not explain what differs ({p_of_halves(comparison)}): the model lacks something that "
        f"{division_in_words(comparison.of, comparison.how)} feel unequally."
    )


def left_out_section(outcome: Outcome) -> Iterator[Content]:
    """Errors of rows left out in turn, and the rows that move the answer most."""
    looked = outcome.second_look
    if looked is None:
        return
    if looked.folds is not None:
        said = tag(
            "p",
            f"{JUDGING_FOLDS} parts of the fitted rows are predicted in turn by a fit to the other parts. The effects stay the "
            f"same.",
        )
        channels = [(k, c) for k, c in enumerate(outcome.channels) if not c.inner]
        lines = []
        for k, c in channels:
            mean, spread, fitted = (
                c.scale * float(v[k]) for v in (looked.folds.mean, looked.folds.spread, looked.folds.fitted)
            )
            lines.append([c.title, number(mean), number(spread, 2), number(fitted)])
        head = ["RMS", "rows left out", "± from part to part", "the same rows, fitted"]
        k, first = channels[0]
        title = f"Rows left out in turn: {number(first.scale * float(looked.folds.mean[k]))} {first.shown} RMS"
        yield fold(title, said, table(head, lines, "Error of rows left out"))
    placed = known_scale_sigma(outcome.measurements) is not None
    if looked.influence is not None and len(looked.influence.rows) and placed:
        yield _influence(outcome, looked.influence)


def _influence(outcome: Outcome, influence: Influence) -> Markup:
    """The rows without which the predicted target moves most."""
    count = len(influence.deciding)
    largest = f"The one that moves it most does so by {number(1e3 * influence.shift[0], 2)} mm"
    own = f"the target is known to {number(1e3 * influence.sigma, 2)} mm (1σ, three axes)"
    what = "Each row is left out, all others are fitted: how far does the predicted target move, RMS over all rows? "
    if count:
        title = (
            f"{plural(count, 'row')} {'moves' if count == 1 else 'move'} the target by more than {DECIDING_SHIFT:g}σ"
        )
        said = tag("p", f"{what}{largest}; {own}. Measure near these again.", class_="look")
    else:
        title = f"No single row moves the target by more than {DECIDING_SHIFT:g}σ"
        said = tag("p", f"{what}{largest}; {own}.")
    m = outcome.measurements
    train = np.flatnonzero(m.train)
    lines = []
    for i in range(min(MOST_INFLUENTIAL_ROWS, len(influence.rows))):
        k = int(train[influence.rows[i]])
        shift, share = (
            1e3 * float(influence.shift[i]),
            float(influence.shift[i]) / max(influence.sigma, np.finfo(float).tiny),
        )
        lines.append([
            row_place(m, k), number(shift, 2), number(share, 2),
            number(float(influence.leverage[i]), 2), number(float(influence.cook[i]), 2),
        ])  # fmt: skip
    head = ["row", "shift of the target [mm]", "in σ of the target", "leverage", "Cook's distance"]
    return fold(title, said, table(head, lines, "The rows that move the target most"))


def combinations_section(outcome: Outcome) -> Iterator[Content]:
    """Combinations of constants from the best known to the worst, and minimal sets."""
    constants = None if outcome.second_look is None else outcome.second_look.identifiability
    if constants is None:
        return
    robot = outcome.robot
    yield fold(
        "How well combinations of constants are known",
        bullets([pair_in_words(pair, robot) for pair in constants.pairs[:MOST_PAIRS]]) if constants.pairs else "",
        _combinations(outcome, constants),
    )
    yield fold(
        f"A minimal identifiable set of {plural(len(constants.names), 'constant')}",
        list(_minimal(outcome, constants)),
    )


def _combinations(outcome: Outcome, constants: Identifiability) -> Markup:
    """The two ends of the list of combinations."""
    every = constants.combinations
    shown = range(len(every))
    if len(every) > 2 * AT_AN_END + 1:
        shown = [*range(AT_AN_END), *range(len(every) - AT_AN_END, len(every))]  # type: ignore[assignment]
    best, lines, before = every[0].std, [], -1
    for k in shown:
        if k > before + 1:
            lines.append([f"… {k - before - 1} between them …", "", ""])
        times = number(every[k].std / best, 2) if best > 0 else ""
        lines.append([combination_in_words(every[k], outcome.robot), _sigma(every[k]), times])
        before = k
    caption = "Independent combinations of constants, from the best known to the worst; 1 mm counts as 1 mrad"
    return table(["combination", "± 1σ", "times the best"], lines, caption)


def _sigma(of: Combination) -> str:
    """1-sigma of a combination with its unit."""
    unit = {"rad": "mrad", "m": "mm", "": "mm or mrad"}[of.unit]
    return f"{number(1e3 * of.std, 2)} {unit}"


def _minimal(outcome: Outcome, constants: Identifiability) -> Iterator[Content]:
    """A minimal identifiable set, and which constants could stay nominal."""
    robot = outcome.robot
    named = ", ".join(constant_in_words(name, robot) for name in constants.names)
    yield tag(
        "p",
        f"{named}. All other requested constants can be fixed at nominal without loss.",
    )
    if not constants.spare:
        yield tag("p", "None of them could stay nominal: without any one these rows are predicted worse.")
        return
    spare = ", ".join(constant_in_words(name, robot) for name in constants.spare)
    yield tag(
        "p",
        f"{_how_many(len(constants.spare))}, as far as these rows can tell: {spare}. The predicted target "
        f"then moves by {number(1e3 * constants.shift, 2)} mm RMS; it is known to "
        f"{number(1e3 * constants.sigma, 2)} mm (1σ, three axes).",
    )


def _how_many(count: int) -> str:
    """How many constants could stay nominal, as a sentence begins."""
    return "One of them could stay nominal" if count == 1 else f"{count} of them could stay nominal together"
