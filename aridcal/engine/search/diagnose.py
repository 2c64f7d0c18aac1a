"""From residual to effect: what the model lacks, added and refitted, and what is left when nothing more has a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.engine.corrections.catalogue import KINDS, Barred, candidates, declared
from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.effect_kind import Observed
from aridcal.engine.corrections.place_scatter import is_scatter
from aridcal.engine.corrections.smooth import Kernel
from aridcal.engine.corrections.unknown_kind import pair
from aridcal.engine.fit.flags import cluster, flagged, limits
from aridcal.engine.fit.least_squares import Fit, thin
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.question import Question
from aridcal.engine.levels import LENIENT
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.candidates import pairs
from aridcal.engine.search.confounded import Tied, tied, twins
from aridcal.engine.search.covariate_table import look
from aridcal.engine.search.curves import reshaped
from aridcal.engine.search.declared import tied_to_frames, with_declared, with_fields
from aridcal.engine.search.exact import (
    FEWEST_PLACES,
    Start,
    few_places,
    flagged_again,
    linear_model,
    refit,
    refit_constants,
    worth,
)
from aridcal.engine.search.held_back import missed
from aridcal.engine.search.linear_model import Active, LinearModel
from aridcal.engine.search.places import has_scatter, scatter_of, with_scatter, without_scatter
from aridcal.engine.search.ranking import is_small, rank
from aridcal.engine.search.sets import Choices, evidence_of_set
from aridcal.engine.search.state import State, activate, solve_state
from aridcal.engine.search.stepwise import Found, confirmed, exchanged, search
from aridcal.system.progress import SILENT, Progress

SEARCHES = 6
"""Work: Times that the model is linearised anew and searched, where that is cheap; two are usual, two more each time that sets
are exchanged."""

SEARCHED = 2000
"""Work: Rows at the most that are searched: an effect that matters shows in these, and every trial costs as many as there
are."""

MOST_LARGE = 4
"""Work: Effects at the most that are chosen on the exact model."""

RIVALS = 5
"""Work: Candidates that are compared there for each of them."""

LARGE = 100.0
"""[nat] in favour of an effect that is worth comparing on the exact model: it bends the constants."""

RIVAL_SHARE = 0.5
"""Work: Share of the best evidence on the linear model that a rival must have: less cannot win on the exact one."""

FEW_PLACES = (
    f"at fewer than {FEWEST_PLACES} places nothing shows that a curve of free form holds elsewhere; measure at more"
)
"""Why no such function is sought there."""

PAIRED = 3
"""Work: Functions of two covariates that are added at the most: each costs as much as all functions of one."""

EXPLAINED = 0.5
"""Share of those rows that may be flagged again: if fewer are, what was found explains them."""

BENT = 0.01
"""Relative change of a channel's noise from the linear model to the exact one, from which what a single search found is asked
again: effects of 50 mrad change it by 0.03, so that others seem to be there; those of a real UR10 by 0.001."""

UNNAMED = 6
"""Work: Effects without a name that are added at the most: what is left then has no simple form."""

# A fitted effect: itself, and size and kernel of its prior if it is smooth.
Shaped = tuple[Effect, float, Kernel]


@dataclass(frozen=True)
class Diagnosed:
    """The final model and how it came about.

    Attributes:
        fit: Constants and effects, fitted together on the exact model.
        linearised_at: Where the model was linearised for the last search.
        observed: Covariates of the rows that were searched: some of the training rows, if there are thousands.
        found: The search's result.
        named: The candidates that have a name.
        barred: Candidates that could not be tested, and why.
        scattered: True if rows of one place err alike, beside which the effects were found.
        confounded: For each active effect, the candidates that are confounded with it in these data; see :func:`told_apart`.
        tied: How likely these are, and what the model is with each.
    """

    fit: Fit
    linearised_at: Fit
    observed: Observed
    found: Found
    named: tuple[Effect, ...]
    barred: tuple[Barred, ...]
    scattered: bool
    confounded: tuple[tuple[Effect, ...], ...] = ()
    tied: tuple[Tied, ...] = ()

    @property
    def linear(self) -> LinearModel:
        """The model as it was linearised for the last search."""
        return self.found.state.model

    @property
    def declared(self) -> tuple[Effect, ...]:
        """Effects that the campaign states."""
        return tuple(a.effect for a in self.found.state.active if a.stated)


@dataclass(frozen=True)
class Setting:
    """What one search works with.

    Attributes:
        start: The geometric stage and the rows.
        observed: Their covariates.
        library: All effects that may come into the model.
        scatter: What rows of one place may err by alike, beside which effects must show.
    """

    start: Start
    observed: Observed
    library: tuple[Effect, ...]
    scatter: tuple[Effect, ...]

    @property
    def progress(self) -> Progress:
        """Called with what is being done."""
        return self.start.progress

    def linear(self, at: Fit, active: Sequence[Active] = ()) -> LinearModel:
        """The exact model linearised about a fit, with some effects in it."""
        return linear_model(self.start, at, active, self.library, self.observed)

    def about(self, at: Fit, state: State, sigma: np.ndarray | None = None) -> State:
        """The effects of a state solved about a fit, from the state's noise or another one, shape (C,)."""
        noise = state.solution.sigma if sigma is None else sigma
        return solve_state(self.linear(at, state.active), state.active, noise, state.used)


@dataclass(frozen=True)
class Step:
    """How far a search is.

    Attributes:
        at: The exact model as it was fitted last, about which the state of what was found is linear.
        found: The effects.
        fitted: Shapes of the effects that it was fitted with.
    """

    at: Fit
    found: Found
    fitted: tuple[Shaped, ...] = ()


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
    every = Start(geometric, train, limits(train), progress)
    first = _diagnosed(question, every, before)
    if any(not a.stated for a in first.found.state.active) and not first.scattered:
        scatter = scatter_of(_thinned(every).train)
        if scatter:
            progress("asking whether rows of one place err alike, in place of these effects")
            beside = _diagnosed(question, every, None, scatter)
            used = first.found.state.used & beside.found.state.used
            first = max(first, beside, key=partial(_evidence, scatter, used))
    together = cluster(first.fit.outliers, train)
    if together is None or together.p_value > LENIENT:
        return first
    progress(f"{together.rows.sum()} flagged rows lie together in {together.coordinate}: searching with them")
    # What these rows show may be structure: they count whatever they leave.
    counting = replace(every, limit=limits(train, together.rows))
    again = _diagnosed(question, counting, replace(first, scattered=False))
    left = int((again.fit.outliers & together.rows).sum())
    return again if left < EXPLAINED * together.rows.sum() else first


def _diagnosed(
    question: Question, every: Start, before: Diagnosed | None, scatter: tuple[Effect, ...] = ()
) -> Diagnosed:
    """One search in all training rows; see :func:`diagnose` and :class:`Setting`."""
    start, progress = _thinned(every), every.progress
    geometric = start.geometric
    progress("listing the effects that these rows can show")
    observed, barred = look(geometric.model, start.train)
    stated = [declared(observed, d, str(question.source)) for d in question.effects]
    taken = {e.identity for e in stated}
    named = [
        e for e in candidates(observed, tuple(k for k in question.sought if KINDS[k].named)) if e.identity not in taken
    ]
    unnamed = candidates(observed, tuple(k for k in question.sought if not KINDS[k].named))
    if few_places(geometric.model, start.train):
        curves = dict.fromkeys(e.kind for e in (*named, *unnamed) if e.smooth)
        barred += [Barred(kind, FEW_PLACES) for kind in curves]
        named, unnamed = [e for e in named if not e.smooth], []
    setting = Setting(start, observed, (*named, *unnamed, *stated, *scatter_of(start.train)), scatter)
    progress("linearising the model")
    state, lost = with_declared(setting.linear(geometric), stated, [d.at is None for d in question.effects], geometric)
    named = [e for e in named if state.model.moves(e)]
    if named:
        progress(f"testing {len(named)} known effects")
    barred += lost + tied_to_frames(state, named)
    state = with_scatter(state, scatter)
    if has_scatter(state):
        progress("rows of one place err alike: testing beside that")
        state = setting.about(geometric, state)
    small, settled = is_small(state.model, named), before is not None and before.scattered
    at = geometric
    if small and not settled:
        at, state = _large_first(setting, named, state)
    fresh = (small and not settled) or before is None
    if before is not None and not fresh:
        state = state.with_active((*state.active, *(a for a in before.found.state.active if not a.stated)))
        if not settled:
            state = confirmed(state, len(named) + len(unnamed), progress)
    if before is not None and settled:
        step = Step(at, replace(before.found, state=state))
    else:
        step = _searched(setting, named, Step(at, Found(state, (), 0)), fresh)
    found = step.found
    state, lost = with_fields(reshaped(found.state, lambda a: a.stated), stated)
    found, barred = replace(found, state=state), barred + lost
    if unnamed and not settled:
        progress(f"testing {len(unnamed)} functions of unknown cause, then pairs")
        found = _unnamed(setting, unnamed, found, fresh)
        if fresh and len(found.state.active) > len(state.active):  # what only imitated it is not missed any more
            found = replace(found, state=search(found.state, named, 0, progress=progress).state)
    scattered = has_scatter(found.state)
    state = without_scatter(found.state)
    state.model.products.forget()  # of the library no more is asked here
    final, bent = step.at, False
    if _shapes(state) != step.fitted:
        progress(_fitting(state))
        final = refit(start, state, final)
        bent = not small and bool(np.any(np.abs(np.log(final.estimated / state.solution.sigma)) > BENT))
    linearised_at = final
    if state.active:
        state = setting.about(final, state, final.sigma)
        kept = state if scattered or settled else missed(state.model, state)
        if bent and not (scattered or settled):
            kept = confirmed(kept, found.tested, progress)
        if len(kept.active) < len(state.active):
            progress(_fitting(kept))
            final = refit(start, kept, final)
        state = kept
    final = flagged_again(replace(start, limit=limits(start.train)), state, final)
    if len(every.train) > len(start.train):
        progress(f"fitting all {len(every.train)} rows")
        final = _widened(replace(every, limit=limits(every.train)), state, final)
    found = replace(found, state=state)
    return Diagnosed(final, linearised_at, observed, found, tuple(named), tuple(barred), scattered or settled)


def _evidence(scatter: tuple[Effect, ...], used: np.ndarray, diagnosed: Diagnosed) -> float:
    """Evidence for what was found, with the scatter of places where that is clear beside it, on some rows, [nat]."""
    return evidence_of_set(with_scatter(diagnosed.found.state, scatter), Choices.of(diagnosed.named), used)


def told_apart(diagnosed: Diagnosed, progress: Progress = SILENT) -> Diagnosed:
    """The same with what is confounded with each effect: asked of the final model only. Its products are forgotten."""
    state = diagnosed.found.state
    rivals = twins(state, diagnosed.named, progress)
    constants = [c for c in diagnosed.linearised_at.model.coefficients if c.basis.constant]
    weighed = tied(state, constants, rivals)
    state.model.products.forget()
    return replace(diagnosed, confounded=tuple(tuple(e for e, _ in own[1:]) for own in rivals), tied=weighed)


def _fitting(state: State) -> str:
    """Words for a refit."""
    count = len(state.active)
    return f"fitting {count} effect{'' if count == 1 else 's'}: {', '.join(e.label for e in state.effects[:4])}"


def _searched(setting: Setting, named: Sequence[Effect], step: Step, fresh: bool) -> Step:
    """Search, refit on the exact model and search again about that, until the same effects are found."""
    progress = setting.progress
    small = is_small(step.found.state.model, named)
    stuck = False
    for _ in range(SEARCHES if small else 1):
        before, found = step.found.state, step.found
        if not stuck:
            found = search(before, named, exchange=fresh, progress=progress)
        whole = fresh and small and set(found.state.effects) == set(before.effects)
        if whole:
            found = exchanged(found, named, progress)
        state = with_scatter(found.state, setting.scatter) if has_scatter(found.state) else found.state
        found = replace(found, state=state)
        settled = set(state.effects) == set(before.effects) and step.at is not setting.start.geometric
        if not small or not state.active or settled:
            return replace(step, found=found)
        progress(_fitting(state))
        trial = refit(setting.start, state, step.at)
        if not set(before.effects) <= set(state.effects) and worth(trial, state) < worth(step.at, before):
            # What looks better on the linear model is not so on the exact one: are whole other sets?
            step, stuck = replace(step, found=replace(found, state=before)), True
            if whole or not fresh:
                return step
        else:
            stuck = False
            step = Step(trial, replace(found, state=setting.about(trial, state)), _shapes(state))
    return step


def _thinned(every: Start) -> Start:
    """Enough rows to search with."""
    geometric, train = every.geometric, every.train
    rows = rows_of_data(geometric.model, train)
    some = thin(rows, SEARCHED)
    if len(some) == len(train):
        return every
    fewer = replace(geometric, weight=geometric.weight[some], residual=geometric.residual[some])
    return replace(every, geometric=fewer, train=train.select(some), limit=every.limit[some])


def _widened(every: Start, state: State, current: Fit) -> Fit:
    """What was found on some of the rows, fitted to all of them."""
    if not state.active:
        return every.geometric
    asked = problem(current.model, every.train, every.progress)
    used = ~flagged(asked.scaled_residual(current.theta), every.train.channels, every.limit)
    return refit_constants(every, replace(state, used=used), current)


def _unnamed(setting: Setting, unnamed: Sequence[Effect], named: Found, fresh: bool) -> Found:
    """Smooth functions of one covariate, and then of two, for what no kind of effect explains."""
    observed, progress, model = setting.observed, setting.progress, named.state.model
    more = search(named.state, unnamed, UNNAMED, exchange=fresh, progress=progress)
    rejected, tested = named.rejected + more.rejected[:1], named.tested + more.tested
    for k in range(PAIRED):
        before = more.state
        places, count = pairs(before, observed.varying(), observed.robot, progress)
        library = [pair(observed, *place) for place in places]
        more = search(replace(before, model=model.prepare(library)), library, 1, count, fresh, progress)
        tested += count if k == 0 else 0
        if len(more.state.active) == len(before.active):
            break
    return Found(more.state, rejected, tested)


def _shapes(state: State) -> tuple[Shaped, ...]:
    """The effects of a state, smooth ones with their shape."""
    return tuple((a.effect, a.score.tau, a.score.kernel) for a in state.active if not is_scatter(a.effect))


def _large_first(setting: Setting, named: Sequence[Effect], state: State) -> tuple[Fit, State]:
    """Take effects so large that they bend the constants: rivals are compared on the exact model, not the linear one."""
    at = setting.start.geometric
    for _ in range(MOST_LARGE):
        best = _best_rival(setting.start, named, at, state)
        if best is None:
            break
        at, trial = best
        state = setting.about(at, trial, at.sigma)
    return at, state


def _best_rival(start: Start, named: Sequence[Effect], at: Fit, state: State) -> tuple[Fit, State] | None:
    """The large effect that explains most on the exact model, refitted with it; None if there is no large effect."""
    ranked = rank(state, named, progress=start.progress)
    top = ranked[0][1].gain if ranked else 0.0
    large = [(e, s) for e, s in ranked[:RIVALS] if s.gain > max(LARGE, RIVAL_SHARE * top)]
    rivals = {(e.kind, e.where, e.motion): (e, s) for e, s in reversed(large)}
    trials = []
    for effect, score in reversed(rivals.values()):
        trial = state.with_active((*state.active, activate(state, effect, score)))
        trials.append((refit(start, trial, at), trial))
    return max(trials, key=lambda pair: worth(*pair), default=None)
