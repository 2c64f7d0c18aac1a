r"""Candidates scored roughly, all at once: against the model as it is, and against it without each of its effects.

With V the inverse of the model's information, C the columns of a candidate and :math:`T = C^T A V`, all in sigmas,

.. math:: M = C^T C - T A^T C, \qquad s = C^T (r - A \beta)

are what a candidate is scored by (:mod:`aridcal.engine.search.evidence`). Without the columns E of one effect nothing need
be solved anew: with :math:`W = V_{EE}^{-1}`

.. math:: M_{-E} = M + T_E W T_E^T, \qquad s_{-E} = s + T_E W \beta_E

at the same noise.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from itertools import chain

import numpy as np

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.fit.normal_equations import conditional, inverse
from aridcal.engine.search.evidence import Score, scores
from aridcal.engine.search.linear_model import LinearModel
from aridcal.engine.search.products import column_places, grouped
from aridcal.engine.search.state import State
from aridcal.system.progress import SILENT, Progress

# Sums of a candidate from which its score follows: M, s, and squared lengths before projection.
Sums = tuple[np.ndarray, np.ndarray, np.ndarray]


def score_all(model: LinearModel, effects: Sequence[Effect], state: State, progress: Progress = SILENT) -> list[Score]:
    """Rough scores of candidates against a solved state, each by itself, its columns projected off the model's."""
    scored = model.answers.of(state)
    new = [e for e in effects if e not in scored]
    sums = {
        effect: (M, s[columns], raw[columns])
        for placed_there, _, s, raw in _project(model, new, state, progress)
        for effect, columns, M in placed_there
    }
    scored.update(_score(sums, state, state.solution.beta))
    return [scored[e] for e in effects]


def score_without(
    model: LinearModel,
    effects: Sequence[Effect],
    state: State,
    effects_out: Collection[Effect],
    progress: Progress = SILENT,
) -> dict[Effect, dict[Effect, Score]]:
    """Rough scores of candidates without each of some effects of a state, at the state's noise, by the effect taken out.

    Effects still in the model are no candidates.
    """
    V, beta = state.solution.inverse, state.solution.beta
    every = zip(state.active, state.places[1:], strict=True)
    out = {a.effect: columns for a, columns in every if a.effect in effects_out}
    if not out:
        return {}
    parts = list(out.values())
    W = [inverse(V[columns, columns]) for columns in parts]
    sums: list[dict[Effect, Sums]] = [{} for _ in parts]
    others = [{a.effect for a in state.active} - {effect} for effect in out]  # still in the model: no candidates
    for placed_there, T, s, raw in _project(model, effects, state, progress):
        for sums_without, columns, w, in_model in zip(sums, parts, W, others, strict=True):
            back = T[:, columns] @ w
            pull = s + back @ beta[columns]
            for effect, k, M in placed_there:
                if effect not in in_model:
                    sums_without[effect] = M + back[k] @ T[k, columns].T, pull[k], raw[k]
    scores_without = {}
    for (effect, columns), sums_without in zip(out.items(), sums, strict=True):
        gone = np.zeros(len(beta), dtype=bool)
        gone[columns] = True
        scores_without[effect] = _score(sums_without, state, conditional(V, beta, gone))
    return scores_without


def _project(
    model: LinearModel, effects: Sequence[Effect], state: State, progress: Progress
) -> Iterator[tuple[list[tuple[Effect, slice, np.ndarray]], np.ndarray, np.ndarray, np.ndarray]]:
    """Chunk by chunk: candidates, their columns in it and their M; then T, s and squared lengths of all w columns."""
    products, beta, weight = model.products, state.solution.beta, state.solution.sigma**-2.0
    candidates, done = set(effects), 0
    prepared: list[Effect] = []
    others: list[Effect] = []
    for e in effects:
        (prepared if model.prepared(e) else others).append(e)
    for chunk in chain(products.chunks(prepared), (products.chunk(group) for group in grouped(others))):
        progress.part(done, len(effects), "candidates")
        AC, CC, Cr = state.in_use(chunk)
        CA, CC = np.tensordot(weight, AC, 1).T, np.tensordot(weight, CC, 1)
        T = CA @ state.solution.inverse
        d = CC.shape[-1]  # all columns of the chunk, or those of each candidate of a grid
        CC = CC.reshape(-1, d, d)
        M = CC - T.reshape(len(CC), d, -1) @ CA.reshape(len(CC), d, -1).transpose(0, 2, 1)
        there = [
            (effect, columns, M[0, columns, columns] if chunk.grid is None else M[k])
            for k, (effect, columns) in enumerate(column_places(chunk.effects))
            if effect in candidates
        ]
        done += len(there)
        yield there, T, weight @ Cr - CA @ beta, np.diagonal(CC, axis1=1, axis2=2).ravel()


def _score(sums: dict[Effect, Sums], state: State, beta: np.ndarray) -> dict[Effect, Score]:
    """Scores of candidates, those of one shape together, for a model with coefficients beta."""
    equations, sigma = state.equations, state.solution.sigma
    total, count = float(np.sum(equations.squares_left(beta) / sigma**2)), float(equations.count.sum())
    alike = defaultdict(list)
    for effect in sums:
        alike[len(effect.coefficients), effect.shape if effect.smooth else None].append(effect)
    evidence: dict[Effect, Score] = {}
    for (_, shape), group in alike.items():
        M, s, raw = (np.stack(parts) for parts in zip(*(sums[e] for e in group), strict=True))
        evidence.update(zip(group, scores(M, s, raw, total, count, shape), strict=True))
    return evidence
