"""Can I trust it? One rule for each thing that speaks for a calibration, or that should be looked at first.

Each says why it is asked. What it says is good or not, and a sentence; a rule that does not apply says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from aridcal.jobs.calibrate.instrument_results import known_scale_sigma
from aridcal.jobs.calibrate.key_figures import (
    LEAST_HELD_OUT,
    OVERFIT_RATIO,
    QUESTIONABLE_OUTLIERS,
    every_held_out_row,
    final_halves,
    generalisation,
    narrow_joints,
    over_time,
    sigma_and_error,
    verification_agreement,
)
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.parts import division_in_words, p_of_halves
from aridcal.pages.drawing.words import scale_in_words, tolerance_in_words
from aridcal.system.wording import number, plural

MOST_NAMES = 3

Checks = Iterator[tuple[bool, str]]
"""True for what speaks for the result, False for what should be looked at first; and the sentence."""


def held_out_rows(outcome: Outcome) -> Checks:
    """Rows that were not fitted judge the model; without any, or with few of them sound, its error is too optimistic."""
    held_out, every = (int(outcome.parts()[part].sum()) for part in ("test", "test_all"))
    if not every:
        yield False, "No rows were held out: the errors above are those of the fit itself, and too optimistic."
        return
    flagged = every - held_out
    none = f"0 of {every:,} held-out rows flagged as outliers"  # the cards have their error
    yield flagged <= QUESTIONABLE_OUTLIERS * every, f"{every_held_out_row(outcome) if flagged else none}."
    if over_time(outcome):
        yield True, f"{over_time(outcome).capitalize()}."
    if 0 < held_out < LEAST_HELD_OUT:
        yield False, f"Checked on {plural(held_out, 'held-out row')} only."


def outliers(outcome: Outcome) -> Checks:
    """A sound setup loses a row in a thousand: more of them are no accident."""
    flagged, rows = int(outcome.outlier.sum()), len(outcome.measurements)
    yield flagged <= QUESTIONABLE_OUTLIERS * rows, f"{plural(flagged, 'outlier')} in {plural(rows, 'row')}."


def refused_rows(outcome: Outcome) -> Checks:
    """Rows that cannot be read are lost before anything judges them."""
    refused = len(outcome.measurements.origin.refused)
    read = len(outcome.measurements) + refused
    if refused:
        yield refused <= QUESTIONABLE_OUTLIERS * read, f"{refused:,} of {plural(read, 'row')} could not be used."


def minimum(outcome: Outcome) -> Checks:
    """A fit may stop early, or in another minimum than the best one."""
    c = outcome.stage("geometric").fit.convergence
    if c.restarts:
        reached = f"{c.agreed} of {c.restarts} other starting points lead to the same minimum."
        yield c.converged and c.agreed == c.restarts, reached
    else:
        yield c.converged, "The fit converged." if c.converged else "The fit did not converge."


def held_out_error(outcome: Outcome) -> Checks:
    """A model that follows the noise of its own rows, or lacks something, is worse on others."""
    ratio = generalisation(outcome)
    if ratio is None:
        return
    clues = () if outcome.diagnosis is None else outcome.diagnosis.clues
    differs = any(clue.question == "held_out" and clue.tells for clue in clues)
    good = ratio < OVERFIT_RATIO and not differs
    yield good, f"The held-out error is {ratio:.2f} times the error of the fitted rows."


def halves(outcome: Outcome) -> Checks:
    """A model that holds is the same from either half of the rows."""
    each = final_halves(outcome)
    if each is None:
        return
    p = p_of_halves(each)
    disagree = f"differ by more than noise explains ({p}): {division_in_words(each.of, each.how)}"
    yield each.agree, f"Halves of the rows, fitted apart, {f'agree ({p})' if each.agree else disagree}."


def bounds(outcome: Outcome) -> Checks:
    """What the region keeps within matters more than the error of single rows."""
    yield from tolerance_in_words(outcome, asked=False)


def scale(outcome: Outcome) -> Checks:
    """Rows without a known length agree as well for a robot of any size."""
    for sentence in scale_in_words(outcome):
        yield known_scale_sigma(outcome.measurements) not in (None, math.inf), f"{sentence[0].upper()}{sentence[1:]}."


def target(outcome: Outcome) -> Checks:
    """Rows that measure something else than the target may agree though the target is known badly."""
    beside_error = None if outcome.measurements.direct else sigma_and_error(outcome)
    if beside_error is None:
        return
    sigma, error = beside_error
    agree = f" The rows agree to {number(error, 2)} mm there: that is consistency, not accuracy."
    known = f"The target is known to ± {number(sigma, 2)} mm (1σ in its worst direction)."
    yield sigma < error, known if sigma < error else f"{known}{agree}"


def other_day(outcome: Outcome) -> Checks:
    """Rows of one day do not show what changes from day to day."""
    verified = verification_agreement(outcome)
    if verified is not None:
        yield verified[0] == "agrees", verified[1]


def joint_travel(outcome: Outcome) -> Checks:
    """Where a joint was not measured, its model is a guess."""
    narrow = [joint.name for joint in narrow_joints(outcome)]
    rest = len(narrow) - MOST_NAMES
    more = f" and {rest} more" if rest > 0 else ""
    if narrow:
        yield False, f"Less than half of the range was measured of {', '.join(narrow[:MOST_NAMES])}{more}."


RULES: tuple[Callable[[Outcome], Checks], ...] = (
    held_out_rows,
    outliers,
    refused_rows,
    minimum,
    held_out_error,
    halves,
    bounds,
    scale,
    target,
    other_day,
    joint_travel,
)
"""In the order in which a reader asks."""


def checks(outcome: Outcome) -> Checks:
    """What all rules say."""
    for rule in RULES:
        yield from rule(outcome)
