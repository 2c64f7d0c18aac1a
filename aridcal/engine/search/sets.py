"""Sets of effects: what is believed of a set beforehand, and the evidence for it as a whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import lgamma, log

import numpy as np

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.fit.normal_equations import inverse
from aridcal.engine.levels import PRICE, SEVERAL
from aridcal.engine.numerics import TINY
from aridcal.engine.search.linear_model import Active
from aridcal.engine.search.state import State, solve_state

Family = tuple[str, tuple[str, ...]]
"""Kind and motion: the same cause at other places, of whatever order."""


def family(effect: Effect) -> Family:
    """What an effect shares with the same cause at other places: gears of one make err alike, links of one make yield alike."""
    return effect.kind, effect.motion


@dataclass(frozen=True)
class Choices:
    """What is tried, and what it was chosen among.

    Attributes:
        library: Candidates that are tried.
        count: Candidates in all.
        places: Where each family may act.
        orders: The orders that it may have.
    """

    library: tuple[Effect, ...]
    count: int
    places: Mapping[Family, frozenset[str]]
    orders: Mapping[Family, frozenset[tuple[float, ...]]]

    @classmethod
    def of(cls, library: Sequence[Effect], count: int = 0) -> Choices:
        """All candidates, or a count of those of which the library holds the most promising ones."""
        places: dict[Family, set[str]] = {}
        orders: dict[Family, set[tuple[float, ...]]] = {}
        for effect in library:
            places.setdefault(family(effect), set()).add(effect.where)
            orders.setdefault(family(effect), set()).add(effect.order)
        return cls(
            tuple(library),
            max(count, len(library)),
            {own: frozenset(some) for own, some in places.items()},
            {own: frozenset(some) for own, some in orders.items()},
        )

    def only(self, library: Sequence[Effect]) -> Choices:
        """Some of the candidates tried alone, chosen among all the same."""
        return replace(self, library=tuple(library))

    def siblings(self, active: Sequence[Active], effect: Effect) -> int:
        """Candidates of its family at places without one, where several others of it are in the model; else 0."""
        own = family(effect)
        taken = {a.effect.where for a in active if family(a.effect) == own} - {effect.where}
        if len(taken) < SEVERAL:
            return 0
        left = self.places.get(own, frozenset()) - taken
        return max(len(left), 1) * max(len(self.orders.get(own, ())), 1)

    def cost(self, active: Iterable[Active]) -> float:
        r"""What naming a set costs beforehand, [nat]: which families, at k of m places each, and with which orders.

        .. math:: \sum_{\text{families}} \log F + \log \binom{m}{k} + \log(m + 1)
                  + \log \frac{(n + f - 1)!}{(f - 1)! \prod_j n_j!}

        for F families, as if each number of places were as likely beforehand as any other (J. G. Scott, J. O. Berger, Annals of
        Statistics 38, 2010, 2587, section 3), and with n effects of f possible orders, :math:`n_j` of each, as if each
        composition of orders were (Laplace's rule of succession): places of one make err in one way.
        """
        found: dict[Family, list[Effect]] = {}
        for a in active:
            if not a.stated:
                found.setdefault(family(a.effect), []).append(a.effect)
        return sum(self._cost_of(own, effects) for own, effects in found.items())

    def price(self, active: Sequence[Active], more: Active) -> float:
        """What one more effect adds to that, [nat]."""
        return self.cost([*active, more]) - self.cost(active)

    def _cost_of(self, own: Family, effects: Sequence[Effect]) -> float:
        counted = Counter(e.order for e in effects)
        k, n = len({e.where for e in effects}), len(effects)
        m = max(len(self.places.get(own, ())), k)
        f = len(self.orders.get(own, frozenset()) | set(counted))
        where = lgamma(m + 1) - lgamma(k + 1) - lgamma(m - k + 1) + log(m + 1)
        orders = lgamma(n + f) - lgamma(f) - sum(lgamma(j + 1) for j in counted.values())
        return log(max(len(self.places), 1)) + where + orders


def evidence_of_set(state: State, choices: Choices, used: np.ndarray) -> float:
    r"""Logarithm of the evidence for a set of effects on some rows, up to a constant that all sets share, [nat].

    Laplace's integral over the coefficients of all effects together, so that what two of them do alike is charged once:

    .. math:: \log L - \tfrac12 \log \big| T V^{-1} T + D \big| - \tfrac12 \beta_p^T (V_{pp} + T_p^2)^{-1} \beta_p
              - n_p - 2 n_s - \text{cost}

    with V the covariance of the coefficients, the noise in L found for the set. Each of the :math:`n_p` plain effects, of d
    coefficients, has a normal prior whose size is the likeliest, :math:`\tau^2 = (|\beta|^2 + \operatorname{tr} V) / d`; T
    holds it and D is 1 there. The :math:`n_s` smooth functions are solved in modes of unit prior, which is in V already: T is 1
    and D is 0.

    Args:
        state: The set.
        choices: What it was chosen among.
        used: Rows by which sets are compared, shape (N,) bool.
    """
    if not np.array_equal(state.used, used):
        state = solve_state(state.model, state.active, state.solution.sigma, used, fixed=True)
    charged = choices.cost(state.active)
    beta, V = state.solution.beta, state.solution.inverse
    size, plain = np.ones(len(beta)), np.zeros(len(beta), dtype=bool)
    for a, own in zip(state.active, state.places[1:], strict=True):
        if a.effect.smooth:
            charged += 2.0 * PRICE
            continue
        variance = (float(beta[own] @ beta[own]) + float(np.trace(V[own, own]))) / (own.stop - own.start)
        size[own], plain[own] = np.sqrt(max(variance, TINY)), True
        charged += PRICE
    if plain.any():
        apart = beta[plain] / size[plain]
        spread = V[np.ix_(plain, plain)] / np.outer(size[plain], size[plain])
        charged += 0.5 * float(apart @ np.linalg.solve(spread + np.eye(len(apart)), apart))
    effects = slice(len(state.model.gauge), len(beta))
    T = size[effects]
    information = T[:, None] * inverse(V[effects, effects]) * T + np.diag(plain[effects].astype(float))
    volume = np.linalg.slogdet(information)[1] if len(T) else 0.0
    return float(state.solution.likelihood - 0.5 * volume - charged)
