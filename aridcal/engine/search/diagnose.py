"""From residual to effect: the search on the linear model, the refit on the exact one, then smooth functions without a cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, UntestableEffect, candidates, declared
from aridcal.engine.corrections.effect import Effect
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.place_scatter import is_scatter
from aridcal.engine.corrections.smooth import Kernel
from aridcal.engine.corrections.unknown_kind import pair
from aridcal.engine.fit.flags import cluster, limits, outlier_rows
from aridcal.engine.fit.least_squares import Fit, thin
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.question import Question
from aridcal.engine.levels import LENIENT
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.candidates import pairs
from aridcal.engine.search.covariate_table import covariates_and_exclusions
from aridcal.engine.search.curves import reshaped
from aridcal.engine.search.declared_effects import add_declared_effects, frame_imitations, with_fields
from aridcal.engine.search.exact import (
    FEWEST_HELD_BACK_THINGS,
    Start,
    few_places,
    linear_model,
    refit,
    refit_constants,
    reflag_rows,
    worth,
)
from aridcal.engine.search.held_back_trials import needed_effects
from aridcal.engine.search.linear_model import ActiveEffect, LinearModel
from aridcal.engine.search.places import has_scatter, scatter_of, with_scatter, without_scatter
from aridcal.engine.search.ranking import is_small, rank
from aridcal.engine.search.rival_models import RivalModel, rivals_of_effects, twins
from aridcal.engine.search.sets import Choices, evidence_of_set
from aridcal.engine.search.state import State, activate, solve_state
from aridcal.engine.search.stepwise import StepwiseResult, confirm, exchange_sets, search
from aridcal.system.progress import SILENT, Progress

SEARCHES = 6
"""Work: Times that the model is linearised anew and searched, where that is cheap; two are usual, two more each time that sets
are exchanged."""

MOST_SEARCHED_ROWS = 2000
"""Work: Rows at the most that are searched: an effect that matters shows in these, and every trial costs as many as there
are."""

MOST_LARGE = 4
"""Work: Effects at the most that are chosen on the exact model."""

RIVALS = 5
"""Work: Candidates that are compared there for each of them."""

LARGE_EVIDENCE = 100.0
"""[nat] in favour of an effect that is worth comparing on the exact model: it bends the constants."""

RIVAL_SHARE = 0.5
"""Work: Share of the best evidence on the linear model that a rival must have: less cannot win on the exact one."""

FEW_PLACES = (
    f"at fewer than {FEWEST_HELD_BACK_THINGS} places nothing shows that a curve of free form holds elsewhere; "
    "measure at more"
)
"""Why no such function is sought there."""

MOST_PAIR_FUNCTIONS = 3
"""Work: Functions of two covariates that are added at the most: each costs as much as all functions of one."""

REFLAGGED_SHARE = 0.5
"""Share of those rows that may be flagged again: if fewer are, what was found explains them."""

NOISE_CHANGE_ON_EXACT_MODEL = 0.01
"""Relative change of a channel's noise from the linear model to the exact one, from which what a single search found is asked
again: effects of 50 mrad change it by 0.03, so that others seem to be there; those of a real UR10 by 0.001."""

MOST_UNNAMED_EFFECTS = 6
"""Work: Effects without a name that are added at the most: what is left then has no simple form."""

# A fitted effect: itself, and size and kernel of its prior if it is smooth.
ShapedEffect = tuple[Effect, float, Kernel]


@dataclass(frozen=True)
class SearchResult:
    """The final model and the search that led to it.

    Attributes:
        fit: Constants and effects, fitted together on the exact model.
        linearised_at: Where the model was linearised for the last search.
        observed: Covariates of the rows that were searched: some of the training rows, if there are thousands.
        stepwise: The search's result.
        named: The candidates whose kind names a cause.
        barred: Candidates that could not be tested, and why.
        scattered: True if rows of one place err alike, and the effects were searched beside that scatter.
        confounded: For each active effect, the candidates that are confounded with it in these data; see
            :func:`model_with_rivals`.
        tied: Weights of these candidates, and the model with each.
    """

    fit: Fit
    linearised_at: Fit
    observed: ObservedRows
    stepwise: StepwiseResult
    named: tuple[Effect, ...]
    barred: tuple[UntestableEffect, ...]
    scattered: bool
    confounded: tuple[tuple[Effect, ...], ...] = ()
    tied: tuple[RivalModel, ...] = ()

    @property
    def linear(self) -> LinearModel:
        """The model as it was linearised for the last search."""
        return self.stepwise.state.model

    @property
    def declared(self) -> tuple[Effect, ...]:
        """Effects that the campaign declares."""
        return tuple(a.effect for a in self.stepwise.state.active if a.declared)


@dataclass(frozen=True)
class Setting:
    """Rows, covariates and candidates of one search.

    Attributes:
        start: The geometric stage and the rows.
        observed: Their covariates.
        library: All effects that may come into the model.
        scatter: Effects by which rows of one place may err alike; all others must show beside them.
    """

    start: Start
    observed: ObservedRows
    library: tuple[Effect, ...]
    scatter: tuple[Effect, ...]

    @property
    def progress(self) -> Progress:
        """Called with the work in hand."""
        return self.start.progress

    def linear(self, at: Fit, active: Sequence[ActiveEffect] = ()) -> LinearModel:
        """The exact model linearised about a fit, with some effects in it."""
        return linear_model(self.start, at, active, self.library, self.observed)

    def about(self, at: Fit, state: State, sigma: np.ndarray | None = None) -> State:
        """The effects of a state solved about a fit, from the state's noise or another one, shape (C,)."""
        noise = state.solution.sigma if sigma is None else sigma
        return solve_state(self.linear(at, state.active), state.active, noise, state.used)


@dataclass(frozen=True)
class SearchStep:
    """The state of a search between two refits.

    Attributes:
        at: The last fit of the exact model, about which the state of ``stepwise`` is linear.
        stepwise: The effects.
        fitted: Shapes of the effects of that fit.
    """

    at: Fit
    stepwise: StepwiseResult
    fitted: tuple[ShapedEffect, ...] = ()


def diagnose(
    question: Question,
    geometric: Fit,
    train: Dataset,
    progress: Progress = SILENT,
    before: SearchResult | None = None,
) -> SearchResult:
    """Find the effects that the geometric model lacks, and fit all together.

    Args:
        question: Which effects are declared, and which kinds may be added.
        geometric: The geometric stage.
        train: The rows that it was fitted to.
        progress: Called with the work in hand.
        before: An earlier search, on other weights: where a search takes long, its effects are confirmed and added to, without
            a new search; where they come from a search beside the scatter of places, which is now in the weights, they are only
            fitted.
    """
    every = Start(geometric, train, limits(train), progress)
    first = _search_once(question, every, before)
    if any(not a.declared for a in first.stepwise.state.active) and not first.scattered:
        scatter = scatter_of(_fewer_rows(every).train)
        if scatter:
            progress("asking whether rows of one place err alike, in place of these effects")
            beside = _search_once(question, every, None, scatter)
            in_use = first.stepwise.state.used & beside.stepwise.state.used
            first = max(first, beside, key=partial(_evidence, scatter, in_use))
    together = cluster(first.fit.outliers, train)
    if together is None or together.p_value > LENIENT:
        return first
    progress(f"{together.rows.sum()} flagged rows lie together in {together.coordinate}: searching with them")
    # These rows may show structure: they are not flagged, however large their residuals.
    counting = replace(every, limit=limits(train, together.rows))
    with_flagged = _search_once(question, counting, replace(first, scattered=False))
    flagged = int((with_flagged.fit.outliers & together.rows).sum())
    return with_flagged if flagged < REFLAGGED_SHARE * together.rows.sum() else first


def _search_once(
    question: Question, every: Start, before: SearchResult | None, scatter: tuple[Effect, ...] = ()
) -> SearchResult:
    """One search in all training rows; see :func:`diagnose` and :class:`Setting`."""
    start, progress = _fewer_rows(every), every.progress
    geometric = start.geometric
    progress("listing the effects that these rows can show")
    observed, barred_effects = covariates_and_exclusions(geometric.model, start.train)
    declared_effects = [declared(observed, d, str(question.source)) for d in question.effects]
    identities = {e.identity for e in declared_effects}
    named = [
        e
        for e in candidates(observed, tuple(k for k in question.sought if EFFECT_KINDS[k].named))
        if e.identity not in identities
    ]
    unnamed = candidates(observed, tuple(k for k in question.sought if not EFFECT_KINDS[k].named))
    if few_places(geometric.model, start.train):
        curves = dict.fromkeys(e.kind for e in (*named, *unnamed) if e.smooth)
        barred_effects += [UntestableEffect(kind, FEW_PLACES) for kind in curves]
        named, unnamed = [e for e in named if not e.smooth], []
    setting = Setting(start, observed, (*named, *unnamed, *declared_effects, *scatter_of(start.train)), scatter)
    progress("linearising the model")
    state, lost_effects = add_declared_effects(
        setting.linear(geometric), declared_effects, [d.at is None for d in question.effects], geometric
    )
    named = [e for e in named if state.model.moves(e)]
    if named:
        progress(f"testing {len(named)} known effects")
    barred_effects += lost_effects + frame_imitations(state, named)
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
        state = state.with_active((*state.active, *(a for a in before.stepwise.state.active if not a.declared)))
        if not settled:
            state = confirm(state, len(named) + len(unnamed), progress)
    if before is not None and settled:
        step = SearchStep(at, replace(before.stepwise, state=state))
    else:
        step = _search_named(setting, named, SearchStep(at, StepwiseResult(state, (), 0)), fresh)
    result = step.stepwise
    state, lost_effects = with_fields(reshaped(result.state, lambda a: a.declared), declared_effects)
    result, barred_effects = replace(result, state=state), barred_effects + lost_effects
    if unnamed and not settled:
        progress(f"testing {len(unnamed)} functions of unknown cause, then pairs")
        result = _search_unnamed(setting, unnamed, result, fresh)
        if fresh and len(result.state.active) > len(state.active):  # effects that only imitated a curve leave
            result = replace(result, state=search(result.state, named, 0, progress=progress).state)
    scattered = has_scatter(result.state)
    state = without_scatter(result.state)
    state.model.products.forget()  # no candidate is scored any more
    final, bent = step.at, False
    if _shapes(state) != step.fitted:
        progress(_words_of_refit(state))
        final = refit(start, state, final)
        bent = not small and bool(
            np.any(np.abs(np.log(final.estimated / state.solution.sigma)) > NOISE_CHANGE_ON_EXACT_MODEL)
        )
    linearised_at = final
    if state.active:
        state = setting.about(final, state, final.sigma)
        reduced = state if scattered or settled else needed_effects(state.model, state)
        if bent and not (scattered or settled):
            reduced = confirm(reduced, result.tested, progress)
        if len(reduced.active) < len(state.active):
            progress(_words_of_refit(reduced))
            final = refit(start, reduced, final)
        state = reduced
    final = reflag_rows(replace(start, limit=limits(start.train)), state, final)
    if len(every.train) > len(start.train):
        progress(f"fitting all {len(every.train)} rows")
        final = _fit_all_rows(replace(every, limit=limits(every.train)), state, final)
    result = replace(result, state=state)
    return SearchResult(
        final, linearised_at, observed, result, tuple(named), tuple(barred_effects), scattered or settled
    )


def _evidence(scatter: tuple[Effect, ...], in_use: np.ndarray, diagnosed: SearchResult) -> float:
    """Evidence for the effects of a search on some rows, [nat], the scatter of places with them where it is clear."""
    return evidence_of_set(with_scatter(diagnosed.stepwise.state, scatter), Choices.of(diagnosed.named), in_use)


def model_with_rivals(diagnosed: SearchResult, progress: Progress = SILENT) -> SearchResult:
    """The final model with the candidates that are confounded with each effect; its products are forgotten afterwards."""
    state = diagnosed.stepwise.state
    rivals = twins(state, diagnosed.named, progress)
    constants = [c for c in diagnosed.linearised_at.model.coefficients if c.basis.constant]
    weighed = rivals_of_effects(state, constants, rivals)
    state.model.products.forget()
    return replace(diagnosed, confounded=tuple(tuple(e for e, _ in effects[1:]) for effects in rivals), tied=weighed)


def _words_of_refit(state: State) -> str:
    """Words for a refit."""
    count = len(state.active)
    return f"fitting {count} effect{'' if count == 1 else 's'}: {', '.join(e.label for e in state.effects[:4])}"


def _search_named(setting: Setting, named: Sequence[Effect], step: SearchStep, fresh: bool) -> SearchStep:
    """Search, refit on the exact model and search again about that, until the same effects are found."""
    progress = setting.progress
    small = is_small(step.stepwise.state.model, named)
    no_better = False
    for _ in range(SEARCHES if small else 1):
        before, result = step.stepwise.state, step.stepwise
        if not no_better:
            result = search(before, named, exchange=fresh, progress=progress)
        whole = fresh and small and set(result.state.effects) == set(before.effects)
        if whole:
            result = exchange_sets(result, named, progress)
        state = with_scatter(result.state, setting.scatter) if has_scatter(result.state) else result.state
        result = replace(result, state=state)
        settled = set(state.effects) == set(before.effects) and step.at is not setting.start.geometric
        if not small or not state.active or settled:
            return replace(step, stepwise=result)
        progress(_words_of_refit(state))
        trial = refit(setting.start, state, step.at)
        if not set(before.effects) <= set(state.effects) and worth(trial, state) < worth(step.at, before):
            # A set that is better on the linear model is not on the exact one: whole other sets may be.
            step, no_better = replace(step, stepwise=replace(result, state=before)), True
            if whole or not fresh:
                return step
        else:
            no_better = False
            step = SearchStep(trial, replace(result, state=setting.about(trial, state)), _shapes(state))
    return step


def _fewer_rows(every: Start) -> Start:
    """The start with :data:`MOST_SEARCHED_ROWS` of its rows at the most."""
    geometric, train = every.geometric, every.train
    rows = rows_of_data(geometric.model, train)
    some = thin(rows, MOST_SEARCHED_ROWS)
    if len(some) == len(train):
        return every
    fewer = replace(geometric, weight=geometric.weight[some], residual=geometric.residual[some])
    return replace(every, geometric=fewer, train=train.select(some), limit=every.limit[some])


def _fit_all_rows(every: Start, state: State, current: Fit) -> Fit:
    """Constants and effects from a search on some of the rows, fitted to all rows."""
    if not state.active:
        return every.geometric
    question = problem(current.model, every.train, every.progress)
    in_use = ~outlier_rows(question.scaled_residual(current.theta), every.train.channels, every.limit)
    return refit_constants(every, replace(state, used=in_use), current)


def _search_unnamed(setting: Setting, unnamed: Sequence[Effect], named: StepwiseResult, fresh: bool) -> StepwiseResult:
    """Add smooth functions of one covariate, and then of two, to the effects that name a cause."""
    observed, progress, model = setting.observed, setting.progress, named.state.model
    more = search(named.state, unnamed, MOST_UNNAMED_EFFECTS, exchange=fresh, progress=progress)
    rejected, tested = named.rejected + more.rejected[:1], named.tested + more.tested
    for k in range(MOST_PAIR_FUNCTIONS):
        before = more.state
        places, count = pairs(before, observed.varying(), observed.robot, progress)
        library = [pair(observed, *place) for place in places]
        more = search(replace(before, model=model.prepare(library)), library, 1, count, fresh, progress)
        tested += count if k == 0 else 0
        if len(more.state.active) == len(before.active):
            break
    return StepwiseResult(more.state, rejected, tested)


def _shapes(state: State) -> tuple[ShapedEffect, ...]:
    """The effects of a state, smooth ones with their shape."""
    return tuple((a.effect, a.score.tau, a.score.kernel) for a in state.active if not is_scatter(a.effect))


def _large_first(setting: Setting, named: Sequence[Effect], state: State) -> tuple[Fit, State]:
    """Add effects so large that they bend the constants, rivals being compared on the exact model, not the linear one."""
    at = setting.start.geometric
    for _ in range(MOST_LARGE):
        best = _best_rival(setting.start, named, at, state)
        if best is None:
            break
        at, trial = best
        state = setting.about(at, trial, at.sigma)
    return at, state


def _best_rival(start: Start, named: Sequence[Effect], at: Fit, state: State) -> tuple[Fit, State] | None:
    """The exact model refitted with the large effect that explains most there; None if there is no large effect."""
    ranked = rank(state, named, progress=start.progress)
    top = ranked[0][1].gain if ranked else 0.0
    large = [(e, s) for e, s in ranked[:RIVALS] if s.gain > max(LARGE_EVIDENCE, RIVAL_SHARE * top)]
    rivals = {(e.kind, e.where, e.motion): (e, s) for e, s in reversed(large)}
    trials = []
    for effect, score in reversed(rivals.values()):
        trial = state.with_active((*state.active, activate(state, effect, score)))
        trials.append((refit(start, trial, at), trial))
    return max(trials, key=lambda pair: worth(*pair), default=None)
