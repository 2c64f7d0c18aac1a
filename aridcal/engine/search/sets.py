"""Sets of effects: the prior of a set, and the evidence for it as a whole."""

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
from aridcal.engine.search.linear_model import ActiveEffect
from aridcal.engine.search.state import State, solve_state

Family = tuple[str, tuple[str, ...]]
"""Kind and motion: the same cause at other places, of whatever order."""


def family(effect: Effect) -> Family:
    """The family of an effect: gears of one make err alike, links of one make yield alike."""
    return effect.kind, effect.motion


@dataclass(frozen=True)
class Choices:
    """Candidates that are tried, and all candidates among which they are chosen.

    Attributes:
        library: Candidates that are tried.
        count: Number of all candidates.
        places: Where each family may act.
        orders: Orders that each family may have.
    """

    library: tuple[Effect, ...]
    count: int
    places: Mapping[Family, frozenset[str]]
    orders: Mapping[Family, frozenset[tuple[float, ...]]]

    @classmethod
    def of(cls, library: Sequence[Effect], count: int = 0) -> Choices:
        """Choices of a library: all candidates, or the most promising ones of ``count``."""
        places: dict[Family, set[str]] = {}
        orders: dict[Family, set[tuple[float, ...]]] = {}
        for effect in library:
            places.setdefault(family(effect), set()).add(effect.where)
            orders.setdefault(family(effect), set()).add(effect.order)
        return cls(
            tuple(library),
            max(count, len(library)),
            {this_family: frozenset(some) for this_family, some in places.items()},
            {this_family: frozenset(some) for this_family, some in orders.items()},
        )

    def only(self, library: Sequence[Effect]) -> Choices:
        """These choices with some candidates tried alone; they still count as chosen among all."""
        return replace(self, library=tuple(library))

    def siblings(self, active: Sequence[ActiveEffect], effect: Effect) -> int:
        """Candidates of its family at places without one, where several others of it are in the model; else 0."""
        this_family = family(effect)
        places_taken = {a.effect.where for a in active if family(a.effect) == this_family} - {effect.where}
        if len(places_taken) < SEVERAL:
            return 0
        places_free = self.places.get(this_family, frozenset()) - places_taken
        return max(len(places_free), 1) * max(len(self.orders.get(this_family, ())), 1)

    def cost(self, active: Iterable[ActiveEffect]) -> float:
        r"""Minus the logarithm of the prior of a set, [nat]: its families, k of m places of each, and their orders.

        .. math:: \sum_{\text{families}} \log F + \log \binom{m}{k} + \log(m + 1)
                  + \log \frac{(n + f - 1)!}{(f - 1)! \prod_j n_j!}

        for F families, each number of places being as likely as any other (J. G. Scott, J. O. Berger, Annals of
        Statistics 38, 2010, 2587, section 3), and with n effects of f possible orders, :math:`n_j` of each, each
        composition of orders being as likely (Laplace's rule of succession): places of one make err in one way.
        """
        by_family: dict[Family, list[Effect]] = {}
        for a in active:
            if not a.declared:
                by_family.setdefault(family(a.effect), []).append(a.effect)
        return sum(self._cost_of(this_family, effects) for this_family, effects in by_family.items())

    def price(self, active: Sequence[ActiveEffect], more: ActiveEffect) -> float:
        """What one more effect adds to the cost, [nat]."""
        return self.cost([*active, more]) - self.cost(active)

    def _cost_of(self, this_family: Family, effects: Sequence[Effect]) -> float:
        order_counts = Counter(e.order for e in effects)
        k, n = len({e.where for e in effects}), len(effects)
        m = max(len(self.places.get(this_family, ())), k)
        f = len(self.orders.get(this_family, frozenset()) | set(order_counts))
        where = lgamma(m + 1) - lgamma(k + 1) - lgamma(m - k + 1) + log(m + 1)
        orders = lgamma(n + f) - lgamma(f) - sum(lgamma(j + 1) for j in order_counts.values())
        return log(max(len(self.places), 1)) + where + orders


def evidence_of_set(state: State, choices: Choices, in_use: np.ndarray) -> float:
    r"""Logarithm of the evidence for a set of effects on some rows, up to a constant that all sets share, [nat].

    Laplace's integral over the coefficients of all effects together, so that two effects of like columns are charged once:

    .. math:: \log L - \tfrac12 \log \big| T V^{-1} T + D \big| - \tfrac12 \beta_p^T (V_{pp} + T_p^2)^{-1} \beta_p
              - n_p - 2 n_s - \text{cost}

    with V the covariance of the coefficients, the noise in L found for the set. Each of the :math:`n_p` plain effects, of d
    coefficients, has a normal prior whose size is the likeliest, :math:`\tau^2 = (|\beta|^2 + \operatorname{tr} V) / d`; T
    holds it and D is 1 there. The :math:`n_s` smooth functions are solved in modes of unit prior, which is in V already: T is 1
    and D is 0.

    Args:
        state: The set.
        choices: Candidates among which it is chosen.
        in_use: Rows by which sets are compared, shape (N,) bool.
    """
    if not np.array_equal(state.used, in_use):
        state = solve_state(state.model, state.active, state.solution.sigma, in_use, fixed=True)
    charged = choices.cost(state.active)
    beta, V = state.solution.beta, state.solution.inverse
    size, plain = np.ones(len(beta)), np.zeros(len(beta), dtype=bool)
    for a, place in zip(state.active, state.places[1:], strict=True):
        if a.effect.smooth:
            charged += 2.0 * PRICE
            continue
        variance = (float(beta[place] @ beta[place]) + float(np.trace(V[place, place]))) / (place.stop - place.start)
        size[place], plain[place] = np.sqrt(max(variance, TINY)), True
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
