r"""Steps, when something moved once: the best row for a step of each motion, and whether it is a step or a slow walk.

A step between two rows is a column that is the motion's own up to there and nothing after. For every row k at once, with
:math:`G_n` the motion's columns in row n and :math:`A_n` the model's, both in sigmas, the sums

.. math:: (C^T C)_k = \sum_{n < k} G_n^T G_n, \qquad (C^T A)_k = \sum_{n < k} G_n^T A_n, \qquad
          s_k = \sum_{n < k} G_n^T r_n

are cumulative, so that the score statistic of all of them, :math:`s_k^T M_k^+ s_k` with
:math:`M_k = (C^T C)_k - (C^T A)_k H^{-1} (C^T A)_k^T`, costs as much as a few (Andrews 1993, doi:10.2307/2951764, for the
largest of such statistics; Worsley 1986, doi:10.1093/biomet/73.1.91, for its correction).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import gammaincc

from aridcal.engine.corrections.condition_kinds import FEWEST_ROWS_OF_A_SIDE
from aridcal.engine.corrections.effect import Effect
from aridcal.engine.instruments.channels import by_row, spread
from aridcal.engine.search.evidence import explained, solve
from aridcal.engine.search.linear_model import ActiveEffect, LinearModel
from aridcal.engine.search.state import State, with_candidate

COARSE_STEPS = 200
"""Work: Steps that are looked at in the first round; between the best and its neighbours all are looked at."""

STEP_NODES = 33
"""Work: Of those, where what the model takes up of a step is worked out; between them it hardly differs from a line's, and what
it differs by only decides which steps are looked at closely. Each costs as much as the square of all that is in the model."""

CLOSE_STEPS = 12
"""Work: Steps that are looked at closely, those that seem best: between nodes what the model takes up is out by a tenth at the
most, near the ends."""

WANDER_LENGTHS = (2.0, 5.0, 12.0, 30.0, np.inf)
"""Work: Rows over which noise may stay alike: two and a half times apart, from one row to the next to a walk without end."""

WANDER_VARIANCES = (1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Work: Variances of such noise that are tried, in units of a row's own: two in a decade, from nothing to all that there is."""


NUMBERS_AT_ONCE = 2**16
"""Work: Numbers in the columns of the steps that are looked at together: half a MB, which a core keeps at hand."""


def step_points(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where steps of a covariate can be: midway between two rows, with enough rows on either side.

    Args:
        values: Of the rows in use, shape (n,).

    Returns:
        Number of rows before each step, shape (k,), and the covariate there, shape (k,).
    """
    ordered = np.sort(values)
    before = np.arange(FEWEST_ROWS_OF_A_SIDE, len(ordered) - FEWEST_ROWS_OF_A_SIDE + 1)
    before = before[ordered[before - 1] < ordered[before]] if len(before) else before
    return before, 0.5 * (ordered[before - 1] + ordered[before])


def _within_a_place(values: np.ndarray, group: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Which steps have enough rows of some one group of things on both sides, shape (k,) bool; steps by the rows before each.

    A step between the rows of two places is confounded with these places, each of which has an unknown of its own.
    ``values`` of the covariate and ``group`` are of the rows in use, shape (n,).
    """
    ordered = group[np.argsort(values, kind="stable")]
    return np.asarray(_on_both_sides(ordered[:, None] == np.unique(ordered), before).any(axis=1))


def _between_its_rows(
    model: LinearModel, state: State, values: np.ndarray, slots: Sequence[int], before: np.ndarray
) -> np.ndarray:
    """Which steps have enough rows on both sides that the slots move, shape (k,) bool; steps by the rows before each.

    Of steps between the same two such rows the last. ``values`` of the covariate are of the rows in use, shape (n,).
    """
    sees = np.any(model.G[:, :, list(slots)], axis=(1, 2))[state.used][np.argsort(values, kind="stable")]
    return np.asarray(sees[before] & _on_both_sides(sees, before))


def _on_both_sides(members: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Whether enough members among the ordered rows, (n, ...) bool, are on either side of each step, shape (k, ...)."""
    passed = np.cumsum(members, axis=0)
    there = passed[before - 1]
    return np.asarray((there >= FEWEST_ROWS_OF_A_SIDE) & (passed[-1] - there >= FEWEST_ROWS_OF_A_SIDE))


def best_steps(model: LinearModel, state: State, templates: Sequence[Effect]) -> list[Effect]:
    """Templates with their step at the row where it explains most; those without a possible row are left out."""
    return model.answers.once(state, ("steps", *templates), lambda: _best_steps(model, state, templates))


def _best_steps(model: LinearModel, state: State, templates: Sequence[Effect]) -> list[Effect]:
    steps_of: dict[Effect, Effect] = {}
    for of in dict.fromkeys(e.covariates[0] for e in templates):
        values = model.table[of][state.used]
        before, points = step_points(values)
        if model.off is not None:
            inside = _within_a_place(values, model.off.group[state.used], before)
            before, points = before[inside], points[inside]
        possible = {}
        for effect in (e for e in templates if e.covariates[0] == of):
            slots = model.slots_of(effect)
            possible_steps = _between_its_rows(model, state, values, slots, before)
            if possible_steps.any():
                possible[effect] = slots, possible_steps
        if not possible:
            continue
        groups = [(slots, before[possible_steps]) for slots, possible_steps in possible.values()]
        best = (
            _Scan.of(state, of, groups).best(groups)
            if model.off is None
            else _best_beside_things(model, state, values, groups)
        )
        for (effect, (_, possible_steps)), place in zip(possible.items(), best, strict=True):
            steps_of[effect] = effect.placed(float(points[possible_steps][place]))
    return [steps_of[effect] for effect in templates if effect in steps_of]


# Slots that move together, and the rows before each of the steps that they may have, ascending.
SlotGroup = tuple[Sequence[int], np.ndarray]


def _best_beside_things(model: LinearModel, state: State, values: np.ndarray, groups: Sequence[SlotGroup]) -> list[int]:
    """Index of the best step of each group, all its rows looked at for each, as unknown things take up a part of each.

    ``values`` of the covariate are of the rows in use, shape (n,).
    """
    A, r = state.whitened(state.design), state.whitened(state.flat(state.residual))
    order = np.argsort(np.argsort(values, kind="stable"))

    def of_block(slots: Sequence[int], before: np.ndarray) -> np.ndarray:
        after = np.zeros((len(model.r), len(before)))
        after[state.used] = order[:, None] >= before
        columns = model.G[:, :, None, list(slots)] * after[:, None, :, None]
        C = state.whitened(state.flat(model.seen(columns.reshape(*columns.shape[:2], -1))))
        each = C.reshape(len(C), *columns.shape[2:]).transpose(1, 2, 0)
        CA, Cr = (each.reshape(-1, len(C)) @ A).reshape(*each.shape[:2], -1), each @ r
        M = each @ each.transpose(0, 2, 1) - CA @ state.solution.inverse @ CA.transpose(0, 2, 1)
        return explained(M, Cr, np.sum(each**2, axis=2))[0]

    def squares(slots: Sequence[int], before: np.ndarray) -> np.ndarray:
        step = max(1, NUMBERS_AT_ONCE // (model.r.size * len(slots)))
        return np.concatenate([of_block(slots, before[at : at + step]) for at in range(0, len(before), step)])

    return [_best(before, partial(squares, slots)) for slots, before in groups]


@dataclass(frozen=True)
class _Scan:
    """Steps scored from sums over the rows before them, rows in the order of a covariate.

    Attributes:
        state: The model without a step.
        slots: Position of each slot in the columns.
        G: Columns of the slots over the variance, zero in rows that are not in use, shape (N, m, S).
        squares: (C'C) up to each row in use, shape (n + 1, S, S).
        pulls: s up to each, shape (n + 1, S).
        members: Columns of the design's members, shape (N, m, d) each.
        row: Place of each row in use, shape (n,).
    """

    state: State
    slots: dict[int, int]
    G: np.ndarray
    squares: np.ndarray
    pulls: np.ndarray
    members: tuple[np.ndarray, ...]
    row: np.ndarray

    @classmethod
    def of(cls, state: State, of: str, groups: Sequence[SlotGroup]) -> _Scan:
        """The sums for some groups of slots, rows in the order of the covariate ``of``."""
        model = state.model
        moving = list(dict.fromkeys(slot for slots, _ in groups for slot in slots))
        order = np.argsort(model.table[of], kind="stable")
        in_use = state.used[order]
        row, sigma = np.flatnonzero(in_use), state.sigma[:, None]
        g = model.G[:, :, moving][order] * (in_use[:, None] / state.sigma)[:, :, None]
        members = tuple(model.products.in_order(of, order, effect) for effect, _ in state.members)
        turned, right = g[row].transpose(0, 2, 1), state.residual[order[row], :, None] / sigma
        sums = (np.cumsum(each, axis=0) for each in (turned @ g[row], (turned @ right)[:, :, 0]))
        squares, pulls = (np.insert(upto, 0, 0.0, axis=0) for upto in sums)
        return cls(state, {slot: k for k, slot in enumerate(moving)}, g / sigma, squares, pulls, members, row)

    def best(self, groups: Sequence[SlotGroup]) -> list[int]:
        """Index of the step of each group that explains most."""
        every = np.unique(np.concatenate([_evenly(before, COARSE_STEPS) for _, before in groups]))
        nodes = self._nodes(every)

        def best_of(slots: Sequence[int], before: np.ndarray) -> int:
            columns = [self.slots[slot] for slot in slots]

            def promising(rough: np.ndarray) -> np.ndarray:
                seems = self._explained(columns, rough, nodes.between(rough, columns))
                return np.sort(np.argsort(-seems, kind="stable")[:CLOSE_STEPS])

            def exactly(rows: np.ndarray) -> np.ndarray:
                return self._explained(columns, rows, self._taken(self._shared(columns, rows, nodes)))

            return _best(before, exactly, promising)

        return [best_of(*group) for group in groups]

    def _nodes(self, every: np.ndarray) -> _Nodes:
        """At the most :data:`STEP_NODES` of some steps, evenly, from the first to the last."""
        before = _evenly(every, STEP_NODES)
        shared = self._shared(range(len(self.slots)), before)
        return _Nodes(before, shared, self._taken(shared))

    def _explained(self, columns: Sequence[int], before: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Squares that steps of some columns explain, shape (k,); the model takes up the part ``products``, (k, d, d)."""
        squares = self.squares[before][:, columns][:, :, columns]
        return explained(squares - products, self.pulls[before][:, columns], np.einsum("kss->ks", squares))[0]

    def _taken(self, shared: np.ndarray) -> np.ndarray:
        """Part of the products of columns that the model takes up, (k, d, d), from those with the members' columns, (k, d, W)."""
        ends = np.cumsum([member.shape[2] for member in self.members])[:-1]
        shared = self.state.in_modes(np.split(shared, ends, axis=2))
        inverse = self.state.solution.inverse
        return np.asarray(
            (shared.reshape(-1, len(inverse)) @ inverse).reshape(shared.shape) @ np.swapaxes(shared, 1, 2)
        )

    def _shared(self, columns: Sequence[int], before: np.ndarray, nodes: _Nodes | None = None) -> np.ndarray:
        """C'A over the rows before each step, ascending, of some columns and the members', (k, d, W), summed from nodes on."""
        G = self.G[:, :, columns]
        end, total = 0, np.zeros((len(columns), sum(member.shape[2] for member in self.members)))
        sums = np.empty((len(before), *total.shape))
        for k, (count, stop) in enumerate(zip(before.tolist(), self.row[before].tolist(), strict=True)):
            if nodes is not None and (node := nodes.last(count)) >= 0 and self.row[nodes.before[node]] > end:
                end, total = int(self.row[nodes.before[node]]), nodes.shared[node][columns]
            if stop > end:
                part = G[end:stop].reshape(-1, len(columns)).T
                more = [part @ member[end:stop].reshape(part.shape[1], -1) for member in self.members]
                end, total = stop, total + np.hstack(more)
            sums[k] = total
        return sums


@dataclass(frozen=True)
class _Nodes:
    """Steps at which the part that the model takes up is computed.

    Attributes:
        before: Rows before each, ascending, shape (k,).
        shared: C'A, shape (k, S, W).
        taken_up: Part of the products of their columns that the model takes up, shape (k, S, S).
    """

    before: np.ndarray
    shared: np.ndarray
    taken_up: np.ndarray

    def last(self, count: int) -> int:
        """Number of the last of them with no more rows before it; -1 if there is none."""
        return int(np.searchsorted(self.before, count, side="right")) - 1

    def between(self, before: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        """Part of the products of some columns that the model takes up at steps, linear between nodes, shape (k, d, d)."""
        products = self.taken_up[:, columns][:, :, columns]
        if len(self.before) == 1:
            return np.repeat(products, len(before), axis=0)
        high = np.clip(np.searchsorted(self.before, before), 1, len(self.before) - 1)
        low = high - 1
        share = ((before - self.before[low]) / (self.before[high] - self.before[low]))[:, None, None]
        return np.asarray((1.0 - share) * products[low] + share * products[high])


def _evenly(before: np.ndarray, most: int) -> np.ndarray:
    """``most`` of some steps, evenly from the first to the last; all if they are fewer."""
    return before[np.unique(np.linspace(0, len(before) - 1, min(most, len(before))).round().astype(int))]


def _best(
    before: np.ndarray,
    squares: Callable[[np.ndarray], np.ndarray],
    promising: Callable[[np.ndarray], np.ndarray] | None = None,
) -> int:
    """Index of the step that explains most: of :data:`COARSE_STEPS` of them first, then of all between the best one's neighbours.

    Args:
        before: Rows before each step, ascending, shape (k,).
        squares: Gives the squares that some of the steps explain.
        promising: Chooses which of the first steps are computed, ascending; None: all.
    """
    rough = _evenly(before, COARSE_STEPS)
    some = np.arange(len(rough)) if promising is None else promising(rough)
    top = int(some[np.argmax(squares(rough[some]))])
    ends = rough[max(top - 1, 0)], rough[min(top + 1, len(rough) - 1)]
    low, high = np.searchsorted(before, ends).tolist()
    return int(low + np.argmax(squares(before[low : high + 1])))


def walk_instead(model: LinearModel, state: State, candidate: ActiveEffect) -> float:
    r"""Chance that a step as clear as this one comes from noise that stays alike for some rows, or walks.

    The motion that explains each row's residual by itself, with the step in the model, is a series y. It is explained twice,
    with and without the step, as a constant and noise of two sorts: white, and an autoregression over the rows

    .. math:: x_{t+1} = e^{-1/L} x_t + \eta_t, \qquad L = \infty \text{ for a random walk}

    of the variance and length L that suit each best (Harvey 1989, sections 3.4 and 4.3: the likelihood from a Kalman
    filter). Twice the gain in log-likelihood is compared with chi-square with as many degrees as the step has motions, and
    corrected for all rows at which the step might have been. A walk has many small steps and explains one that stands
    alone badly; whatever changes slowly it explains well.

    Args:
        model: The linearised model.
        state: The model without the step.
        candidate: The step.
    """
    effect = candidate.effect
    values = model.table[effect.covariates[0]][state.used]
    order = np.argsort(values, kind="stable")
    total, precision = with_candidate(state, candidate)
    solution = solve(total, precision, state.solution.sigma)
    d = len(effect.coefficients)
    sigma = spread(solution.sigma, model.channels)
    design = by_row(state.design, state.channels, state.present) / sigma[:, None]
    right = by_row(state.right, state.channels, state.present) / sigma
    motion = model.G[state.used][:, :, model.slots_of(effect)] / sigma[:, None] @ solution.beta[-d:]
    weight = np.sum(motion**2, axis=1)
    pull = np.sum(motion * (right - design @ solution.beta[:-d]), axis=1)
    informed = weight > 0.0
    order = order[informed[order]]
    step = np.where(values < effect.coefficients[0].basis.numbers[0], -1.0, 0.0)
    points = len(step_points(values)[0])
    series = np.stack([pull / np.where(informed, weight, 1.0), np.ones(len(values)), step], axis=1)[order]
    without, with_step = _likelihoods(series, 1.0 / weight[order])
    twice = 2.0 * max(with_step - without, 0.0)
    return float(min(1.0, points * gammaincc(0.5 * d, 0.5 * twice)))


def _likelihoods(series: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """Best log-likelihoods of a series explained by a constant, and by a constant and a step.

    The columns of ``series``, shape (n, 3), are what is explained, the constant and the step; ``variance`` is the white noise
    of each row up to a common factor, shape (n,).
    """
    n = len(series)
    white = float(np.median(variance))
    length, wander = (grid.ravel() for grid in np.meshgrid(WANDER_LENGTHS, WANDER_VARIANCES))
    fade = np.exp(-1.0 / length)
    endless = np.isinf(length)
    long_run = white * wander
    # Variance of each row's step: a walk grows by it; an autoregression of it has ``long_run`` in the long run.
    innovation_variance = np.where(endless, long_run, long_run * (1.0 - fade**2))
    P = np.where(endless, 0.0, long_run)
    x = np.zeros((len(fade), 3))
    products = np.zeros((len(fade), 3, 3))
    logs = np.zeros(len(fade))
    for row, v in zip(series, variance, strict=True):
        F = P + v
        innovation = row - x
        products += innovation[:, :, None] * innovation[:, None, :] / F[:, None, None]
        logs += np.log(F)
        gain = P / F
        x = fade[:, None] * (x + gain[:, None] * innovation)
        P = fade**2 * P * (1.0 - gain) + innovation_variance
    best = []
    for k in (1, 2):
        inner, cross = products[:, 1 : k + 1, 1 : k + 1], products[:, 1 : k + 1, 0]
        squares = products[:, 0, 0] - np.einsum("pk,pk->p", cross, np.linalg.solve(inner, cross[:, :, None])[:, :, 0])
        best.append(float(np.max(-0.5 * (n * np.log(np.maximum(squares, np.finfo(float).tiny)) + logs))))
    return best[0], best[1]
