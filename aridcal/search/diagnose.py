"""From residual to effect: what the model lacks, added and refitted, and what is left when nothing more has a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.effects.catalogue import KINDS, Barred, candidates, declared
from aridcal.effects.effect import Effect
from aridcal.effects.kinds import Observed
from aridcal.effects.place_scatter import is_scatter
from aridcal.effects.smooth import Kernel
from aridcal.effects.unknown_kind import pair
from aridcal.fit.flags import cluster, flagged, limits
from aridcal.fit.least_squares import Fit, thin
from aridcal.fit.problem import problem
from aridcal.fit.question import Question
from aridcal.inputs.dataset import Dataset
from aridcal.model.measured import rows_of_data
from aridcal.search.confounded import twins
from aridcal.search.covariates import look
from aridcal.search.exact import (
    FEWEST_PLACES,
    Start,
    few_places,
    flagged_again,
    linear_model,
    refit,
    refit_constants,
    worth,
)
from aridcal.search.held_back import missed
from aridcal.search.hints import pairs
from aridcal.search.linear_model import LinearModel
from aridcal.search.places import has_scatter, scatter_of, with_scatter, without_scatter
from aridcal.search.ranking import is_small, rank
from aridcal.search.sets import Choices, evidence_of_set
from aridcal.search.shapes import reshaped
from aridcal.search.state import State, activate, solve_state
from aridcal.search.stated import tied_to_frames, with_declared, with_fields
from aridcal.search.stepwise import Found, confirmed, exchanged, search
from aridcal.search.tied import Tied, tied
from aridcal.showing import SILENT, Progress

ROUNDS = 6
"""Times that the model is linearised anew and searched, where that is cheap; two are usual, two more each time that sets are
exchanged."""

SEARCHED = 2000
"""Rows at the most that are searched: an effect that matters shows in these, and every trial costs as many as there are."""

MOST_LARGE = 4
"""Effects at the most that are chosen on the exact model."""

RIVALS = 5
"""Candidates that are compared there for each of them."""

LARGE = 100.0
"""[nat] in favour of an effect that is worth comparing on the exact model: it bends the constants."""

RIVAL_SHARE = 0.5
"""Share of the best evidence on the linear model that a rival must have: less cannot win on the exact one."""

FEW_PLACES = (
    f"at fewer than {FEWEST_PLACES} places nothing shows that a curve of free form holds elsewhere; measure at more"
)
"""Why no such function is sought there."""

PAIRED = 3
"""Functions of two covariates that are added at the most: each costs as much as all functions of one."""

TOGETHER = 0.01
"""Chance of a cluster of flagged rows at which the search is repeated with them: it costs time, and decides nothing yet."""

EXPLAINED = 0.5
"""Share of those rows that may be flagged again: if fewer are, what was found explains them."""

BENT = 0.01
"""Relative change of a channel's noise from the linear model to the exact one, from which what a single search found is asked
again: effects of 50 mrad change it by 0.03, so that others seem to be there; those of a real UR10 by 0.001."""

UNNAMED = 6
"""Effects without a name that are added at the most: what is left then has no simple form."""


@dataclass(frozen=True)
class Diagnosed:
    """The final model and how it came about.

    Attributes:
        fit: Constants and effects, fitted together on the exact model.
        linearised_at: Where the model was linearised for the last search.
        linear: That linearised model; of some of the training rows, if there are thousands.
        observed: The same rows' covariates.
        found: The search's result.
        named: The candidates that have a name.
        declared: Effects that are stated.
        barred: Candidates that could not be tested, and why.
        confounded: For each active effect, the candidates that are confounded with it in these data; see :func:`told_apart`.
        tied: How likely these are, and what the model is with each.
        scattered: True if rows of one place err alike, beside which the effects were found.
    """

    fit: Fit
    linearised_at: Fit
    linear: LinearModel
    observed: Observed
    found: Found
    named: tuple[Effect, ...]
    declared: tuple[Effect, ...]
    barred: tuple[Barred, ...]
    confounded: tuple[tuple[Effect, ...], ...] = ()
    tied: tuple[Tied, ...] = ()
    scattered: bool = False


def diagnose(
    question: Question,
    geometric: Fit,
    train: Dataset,
    progress: Progress = SILENT,
    before: Diagnosed | None = None,
) -> Diagnosed:
    """Find the effects that the geometric model lacks, and fit all together.

    Args:
        question: Which effects are stated, and which kinds may be sought.
        geometric: The geometric stage.
        train: The rows that it was fitted to.
        progress: Called with what is being done.
        before: An earlier search, on other weights: where a search takes long, its effects are confirmed and added to, and not
            sought again; where they were found beside the scatter of places, which the weights now hold, they are only fitted.
    """
    found = _diagnosed(question, geometric, train, None, progress, before)
    searched = _thinned(Start(geometric, train, limits(train))).train
    if (
        any(not a.stated for a in found.found.state.active)
        and not found.scattered
        and (scatter := scatter_of(searched))
    ):
        progress("asking whether rows of one place err alike, in place of these effects")
        beside = _diagnosed(question, geometric, train, None, progress, None, scatter)
        found = max(found, beside, key=partial(_evidence, scatter, found.found.state.used & beside.found.state.used))
    together = cluster(found.fit.outliers, train)
    if together is None or together.p_value > TOGETHER:
        return found
    progress(f"{together.rows.sum()} flagged rows lie together in {together.coordinate}: searching with them")
    again = _diagnosed(question, geometric, train, together.rows, progress, replace(found, scattered=False))
    left = int((again.fit.outliers & together.rows).sum())
    return again if left < EXPLAINED * together.rows.sum() else found


def _diagnosed(
    question: Question,
    geometric: Fit,
    train: Dataset,
    kept: np.ndarray | None,
    progress: Progress,
    before: Diagnosed | None,
    scatter: tuple[Effect, ...] = (),
) -> Diagnosed:
    """One search; see :func:`diagnose`.

    Args:
        question: See there.
        geometric: See there.
        train: N rows.
        kept: Rows that count whatever they leave, shape (N,) bool: what they show may be structure.
        progress: See there.
        before: See there.
        scatter: What rows of one place may err by alike, beside which effects must show.
    """
    every = Start(geometric, train, limits(train, kept), progress)
    start = _thinned(every)
    progress("listing the effects that these rows can show")
    observed, barred = look(start.geometric.model, start.train)
    stated = [declared(observed, d, str(question.source)) for d in question.effects]
    taken = {e.identity for e in stated}
    named = [
        e for e in candidates(observed, tuple(k for k in question.sought if KINDS[k].named)) if e.identity not in taken
    ]
    unnamed = candidates(observed, tuple(k for k in question.sought if not KINDS[k].named))
    if few_places(start.geometric.model, start.train):
        curves = dict.fromkeys(e.kind for e in (*named, *unnamed) if e.smooth)
        barred += [Barred(kind, FEW_PLACES) for kind in curves]
        named, unnamed = [e for e in named if not e.smooth], []
    settled = before is not None and before.scattered
    library = [*named, *unnamed, *stated, *scatter_of(start.train)]
    progress("linearising the model")
    place = Place(start.geometric, linear_model(start, start.geometric, (), library, observed))
    named = [e for e in named if place.linear.moves(e)]
    if named:
        progress(f"testing {len(named)} known effects")
    sought = [d.at is None for d in question.effects]
    state, lost = with_declared(place.linear, stated, sought, start.geometric)
    barred += lost + tied_to_frames(place.linear, state, named)
    beside = with_scatter(place.linear, state, scatter)
    if has_scatter(beside):
        progress("rows of one place err alike: testing beside that")
        place = Place(start.geometric, linear_model(start, start.geometric, beside.active, library, observed))
        state = solve_state(place.linear, beside.active, beside.solution.sigma, beside.used)
    small = is_small(place.linear, named)
    if small and not settled:
        place, state = _large_first(start, place, named, library, state, observed)
    fresh = (small and not settled) or before is None
    if before is not None and not fresh:
        every_one = (*state.active, *(a for a in before.found.state.active if not a.stated))
        state = solve_state(place.linear, every_one, state.solution.sigma, state.used)
        if not settled:
            state = confirmed(place.linear, state, len(named) + len(unnamed), progress)
    if before is not None and settled:
        current, found, fitted = place.at, replace(before.found, state=state), _shapes(replace(state, active=()))
    else:
        place, current, found, fitted = _searched(
            start, place, named, library, scatter, state, observed, progress, fresh
        )
    state, lost = with_fields(place.linear, stated, reshaped(place.linear, found.state, lambda a: a.stated))
    found, barred = replace(found, state=state), barred + lost
    if unnamed and not settled:
        progress(f"testing {len(unnamed)} functions of unknown cause, then pairs")
        more = _unnamed(place.linear, unnamed, found, observed, fresh, progress)
        if fresh and len(more.state.active) > len(state.active):  # what only imitated it is not missed any more
            again = search(place.linear, named, more.state, 0, progress=progress)
            more = replace(again, rejected=more.rejected, tested=more.tested)
        found, state = more, more.state
    scattered = has_scatter(state)
    if scattered:
        state = without_scatter(place.linear, state)
        found = replace(found, state=state)
    place.linear.products.forget()  # of the library no more is asked here
    bent = False
    if _shapes(state) != fitted:
        progress(_fitting(state))
        current = refit(start, state, current)
        bent = not small and bool(np.any(np.abs(np.log(current.estimated / state.solution.sigma)) > BENT))
    if state.active:
        judged = not (scattered or settled)
        place, current, found = _about_optimum(start, current, found, library, observed, judged, bent, progress)
    current = flagged_again(replace(start, limit=limits(start.train)), found.state, current)
    if len(train) > len(start.train):
        progress(f"fitting all {len(train)} rows")
        current = _widened(replace(every, limit=limits(train)), found.state, current)
    stated = [a.effect for a in found.state.active if a.stated]
    return Diagnosed(
        current,
        place.at,
        place.linear,
        observed,
        found,
        tuple(named),
        tuple(stated),
        tuple(barred),
        scattered=scattered or settled,
    )


def _evidence(scatter: tuple[Effect, ...], used: np.ndarray, diagnosed: Diagnosed) -> float:
    """Evidence for what was found, with the scatter of places where that is clear beside it, on some rows, [nat]."""
    state = with_scatter(diagnosed.linear, diagnosed.found.state, scatter)
    return evidence_of_set(diagnosed.linear, state, Choices.of(diagnosed.named), used)


def told_apart(diagnosed: Diagnosed, progress: Progress = SILENT) -> Diagnosed:
    """The same with what is confounded with each effect: asked of the final model only. Its products are forgotten."""
    linear, state = diagnosed.linear, diagnosed.found.state
    found = twins(linear, diagnosed.named, state, progress)
    constants = [c for c in diagnosed.linearised_at.model.coefficients if c.basis.constant]
    rivals = tied(linear, constants, state, found)
    linear.products.forget()
    return replace(diagnosed, confounded=tuple(tuple(e for e, _ in own[1:]) for own in found), tied=rivals)


def _about_optimum(
    start: Start,
    current: Fit,
    found: Found,
    library: Sequence[Effect],
    observed: Observed,
    judged: bool,
    bent: bool,
    progress: Progress,
) -> tuple[Place, Fit, Found]:
    """The model about its own optimum; where blocks held back may judge, without the effects that they do not miss.

    Where it was bent on the way there, without those that would not be found any more, too.
    """
    place = Place(current, linear_model(start, current, found.state.active, library, observed))
    state = solve_state(place.linear, found.state.active, current.sigma, found.state.used)
    kept = missed(place.linear, state) if judged else state
    if judged and bent:
        kept = confirmed(place.linear, kept, found.tested, progress)
    if len(kept.active) < len(state.active):
        progress(_fitting(kept))
        current = refit(start, kept, current)
    return place, current, replace(found, state=kept)


@dataclass(frozen=True)
class Place:
    """Where the exact model was linearised, and what that gave."""

    at: Fit
    linear: LinearModel


def _fitting(state: State) -> str:
    """Words for a refit."""
    count = len(state.active)
    return f"fitting {count} effect{'' if count == 1 else 's'}: {', '.join(a.effect.label for a in state.active[:4])}"


def _searched(
    start: Start,
    place: Place,
    named: Sequence[Effect],
    library: Sequence[Effect],
    scatter: tuple[Effect, ...],
    state: State,
    observed: Observed,
    progress: Progress,
    fresh: bool,
) -> tuple[Place, Fit, Found, list[tuple[Effect, float, Kernel]]]:
    """Search, refit on the exact model and search again about that, until the same effects are found.

    Returns:
        Where the model was linearised last, the last refit, what was found, and the shapes that were fitted.
    """
    current = place.at
    small = is_small(place.linear, named)
    fitted = _shapes(replace(state, active=()))
    stuck, found = False, Found(state, (), 0)
    for _ in range(ROUNDS if small else 1):
        before = state
        if not stuck:
            found = search(place.linear, named, state, exchange=fresh, progress=progress)
        whole = fresh and small and {a.effect for a in found.state.active} == {a.effect for a in before.active}
        if whole:
            found = exchanged(place.linear, named, found, progress)
        state = with_scatter(place.linear, found.state, scatter) if has_scatter(found.state) else found.state
        found = replace(found, state=state)
        same = {a.effect for a in state.active} == {a.effect for a in before.active}
        settled = same and place.at is current and current is not start.geometric
        if not small or not state.active or settled:
            break
        progress(_fitting(state))
        trial = refit(start, state, current)
        if _exchanged(before, state) and worth(trial, state) < worth(current, before):
            # What looks better on the linear model is not so on the exact one: are whole other sets?
            found, state = replace(found, state=before), before
            if whole or not fresh:
                break
            stuck = True
            continue
        current, stuck = trial, False
        fitted = _shapes(state)
        place = Place(current, linear_model(start, current, state.active, library, observed))
        state = solve_state(place.linear, state.active, state.solution.sigma, state.used)
        found = replace(found, state=state)
    return place, current, found, fitted


def _exchanged(before: State, after: State) -> bool:
    """True if an effect of a state is not in the next one."""
    return not {a.effect for a in before.active} <= {a.effect for a in after.active}


def _thinned(every: Start) -> Start:
    """Enough rows to search with."""
    geometric, train = every.geometric, every.train
    rows = rows_of_data(geometric.model, train)
    some = thin(rows, SEARCHED)
    if len(some) == len(train):
        return every
    fewer = replace(geometric, weight=geometric.weight[some], residual=geometric.residual[some])
    return Start(fewer, train.select(some), every.limit[some], every.progress)


def _widened(every: Start, state: State, current: Fit) -> Fit:
    """What was found on some of the rows, fitted to all of them."""
    if not state.active:
        return every.geometric
    asked = problem(current.model, every.train, every.progress)
    used = ~flagged(asked.scaled_residual(current.theta), every.train.channels, every.limit)
    return refit_constants(every, replace(state, used=used), current)


def _unnamed(
    model: LinearModel,
    unnamed: Sequence[Effect],
    named: Found,
    observed: Observed,
    fresh: bool,
    progress: Progress,
) -> Found:
    """Smooth functions of one covariate, and then of two, for what no kind of effect explains."""
    more = search(model, unnamed, named.state, UNNAMED, exchange=fresh, progress=progress)
    rejected, tested = named.rejected + more.rejected[:1], named.tested + more.tested
    for k in range(PAIRED):
        before = more.state
        places, looked = pairs(model, before, observed.varying(), observed.robot, progress)
        library = [pair(observed, *place) for place in places]
        more = search(model.prepare(library), library, before, 1, looked, fresh, progress)
        tested += looked if k == 0 else 0
        if len(more.state.active) == len(before.active):
            break
    return Found(more.state, rejected, tested)


def _shapes(state: State) -> list[tuple[Effect, float, Kernel]]:
    """The effects of a state, smooth ones with their shape."""
    return [(a.effect, a.score.tau, a.score.kernel) for a in state.active if not is_scatter(a.effect)]


def _large_first(
    start: Start, place: Place, named: Sequence[Effect], library: Sequence[Effect], state: State, observed: Observed
) -> tuple[Place, State]:
    """Take effects so large that they bend the constants: rivals are compared on the exact model, not the linear one."""
    for _ in range(MOST_LARGE):
        best = _best_rival(start, place, named, state)
        if best is None:
            break
        fitted, trial = best
        place = Place(fitted, linear_model(start, fitted, trial.active, library, observed))
        state = solve_state(place.linear, trial.active, fitted.sigma, trial.used)
    return place, state


def _best_rival(start: Start, place: Place, named: Sequence[Effect], state: State) -> tuple[Fit, State] | None:
    """The large effect that explains most on the exact model, refitted with it; None if there is no large effect."""
    linear = place.linear
    ranked = rank(linear, named, state, progress=start.progress)
    top = ranked[0][1].gain if ranked else 0.0
    large = [(e, s) for e, s in ranked[:RIVALS] if s.gain > max(LARGE, RIVAL_SHARE * top)]
    rivals = {(e.kind, e.where, e.motion): (e, s) for e, s in reversed(large)}
    best: tuple[float, Fit, State] | None = None
    for effect, found in reversed(rivals.values()):
        active = (*state.active, activate(linear, state, effect, found))
        trial = solve_state(linear, active, state.solution.sigma, state.used)
        fitted = refit(start, trial, place.at)
        value = worth(fitted, trial)
        if best is None or value > best[0]:
            best = value, fitted, trial
    return None if best is None else best[1:]
