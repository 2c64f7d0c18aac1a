r"""Configurations that tell two effects apart, and each from all else that could stand in its place.

If an effect h with coefficients :math:`\theta` is there and another one r is fitted in its place, beside all constants, then the
logarithm of the likelihood falls behind by :math:`\lambda_{hr}/2` on average,

.. math:: \lambda_{hr} = \theta^T \big( [M^{-1}]_{hh} \big)^{-1} \theta

with M the information of constants, r and h together (the non-centrality of the test of h beside r: T-optimality, Atkinson and
Fedorov 1975, doi:10.1093/biomet/62.1.57; for two hypotheses that is what Box and Hill 1967 expect of the odds). The chance that
noise turns the order round is at most :math:`\tfrac12 e^{-\lambda_{hr}/8}` (Bhattacharyya). Configurations are chosen that make
the sum of this over all such pairs small: each of the two effects against the other, and against those of the search's
candidates that imitate it in the rows at hand and in the ones chosen so far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from aridcal.engine.corrections.catalogue import KINDS, candidates
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import Observed
from aridcal.engine.trust.workspace import LOOSE
from aridcal.jobs.plan.beforehand import Beforehand
from aridcal.jobs.plan.configurations import Candidates
from aridcal.jobs.plan.information import Told, so_far, together, whitened

SAFE = 8.0
"""Non-centrality over this in the exponent: Bhattacharyya's bound of the chance to be wrong."""

CLEAR = 30.0
"""Non-centrality beyond which a rival is none: 15 nats behind, where the search asks for 3, and noise of five."""

LEAST = 16.0
"""Non-centrality of an effect by itself that is taken where the rows show less of it: four sigmas, as little as is ever named."""

HOPELESS = 6.0
"""Non-centrality that even three times as many configurations as are asked for would not bring: the two are one."""

AT_ONCE, ROUNDS = 4, 3
"""Rivals of each effect that are taken up after a choice, and how often: more than three times changes nothing."""

EXPECTED = 5.0e-4
"""[rad] or [m]: RMS motion of an effect of which no row tells how large it is."""

PASSES = 6
"""Passes of the exchange at the most; three are usual."""

BETTER = 1.0e-6
"""Of the logarithm of the chance, by which an exchange must be better: rounding must not exchange for ever."""

LARGEST = 4
"""Coefficients of a rival at the most: what has more pays for them in the search's evidence."""


@dataclass(frozen=True)
class Duel:
    """One effect against another one that could stand in its place.

    Attributes:
        true: What is there, in words.
        rival: What is fitted instead.
        before: Nats by which the rival is expected to be behind, by the rows so far.
        after: The same with the planned ones.
        shown: False where the rows so far show less of the effect than is ever named: it was taken for larger.
    """

    true: str
    rival: str
    before: float
    after: float
    shown: bool = True


@dataclass(frozen=True, eq=False)
class _Side:
    """One duel as arrays.

    Attributes:
        columns: Of base, rival and effect, the effect's last, shape (D,).
        own: How many are the effect's.
        weight: theta theta', shape (own, own).
        title: What the effect and its rival are called.
        owner: Which of the two effects each is, 0 or 1; 2 for a rival that is neither.
        shown: See :class:`Duel`.
    """

    columns: np.ndarray
    own: int
    weight: np.ndarray
    title: tuple[str, str]
    owner: tuple[int, int]
    shown: bool = True

    def power(self, covariance: np.ndarray) -> np.ndarray:
        """Non-centrality by covariances of all columns, (..., D, D) to (...)."""
        return self.of_own(covariance[..., -self.own :, -self.own :])

    def of_own(self, covariance: np.ndarray) -> np.ndarray:
        """The same by covariances of the effect's own coefficients alone, (..., own, own) to (...)."""
        return np.asarray(
            np.einsum("...ii->...", np.linalg.solve(covariance, np.broadcast_to(self.weight, covariance.shape)))
        )


def telling_apart(
    known: Beforehand,
    of: Told,
    effects: Sequence[tuple[str, tuple[Coefficient, ...]]],
    observed: Observed,
    offered: Candidates,
    n: int,
) -> tuple[list[int], tuple[Duel, ...]]:
    """Candidates that tell effects apart, and what is expected of them.

    Args:
        known: Has the coefficients of all of these effects.
        of: Which of the unknowns can be identified.
        effects: Two, with what each is called.
        observed: What other effects can be made of.
        offered: C configurations.
        n: How many to choose.
    """
    meant = [_members(known, observed, name, part) for name, part in effects]
    others = _library(known, observed, effects)
    every = [*meant[0], *meant[1], *others]
    owner = [0] * len(meant[0]) + [1] * len(meant[1]) + [2] * len(others)
    wide = known.with_coefficients(
        tuple(dict.fromkeys(c for e in others for c in e.coefficients if c not in known.model.coefficients))
    )
    number = {c: of.things + k for k, c in enumerate(wide.model.coefficients)}
    rows = together(whitened(wide, offered), offered)
    flat, residual = so_far(wide, offered)
    parts = [[number[c] for c in effect.coefficients] for effect in every]
    mine = {number[c] for _, part in effects for c in part}
    base = np.array([k for k in (*range(of.things), *(of.things + k for k in of.kept)) if k not in mine])
    sizes = np.concatenate([np.ones(of.things), wide.model.sizes])
    information = flat.T @ flat + np.diag(1.0 / (LOOSE * sizes) ** 2)
    pool = np.einsum("cpi,cpj->ij", rows, rows, optimize=True) * (3.0 * n / len(rows))
    sides = []
    for h in (k for k, side in enumerate(owner) if side < 2):
        weight, shown = _expected(base, parts[h], information, flat.T @ residual)
        for r, part in enumerate(parts):
            rest = [k for k in part if k not in parts[h]]
            if owner[r] == owner[h] or not rest:
                continue
            columns = np.concatenate([base, rest, parts[h]]).astype(int)
            made = _Side(columns, len(parts[h]), weight, (every[h].label, every[r].label), (owner[h], owner[r]), shown)
            if owner[r] < 2 or _power(made, information + pool) > HOPELESS:
                sides.append(made)
    chosen, taken = [], [side for side in sides if side.owner[1] < 2]
    for _ in range(ROUNDS):
        chosen = _exchanged(rows, information, taken, n)
        F = rows[chosen].reshape(-1, rows.shape[2])
        more = _nearest([side for side in sides if side not in taken], information + F.T @ F)
        if not more:
            break
        taken += more
    F = rows[chosen].reshape(-1, rows.shape[2])
    then = information + F.T @ F
    duels = [Duel(*s.title, _power(s, information) / 2, _power(s, then) / 2, s.shown) for s in taken]
    return chosen, tuple(duels)


def duel_lines(duels: Sequence[Duel]) -> list[str]:
    """What is expected, in sentences: for each effect the rival that comes nearest, before and with the planned rows."""
    lines = []
    for true in dict.fromkeys(duel.true for duel in duels):
        own = [duel for duel in duels if duel.true == true]
        before, after = min(own, key=lambda d: d.before), min(own, key=lambda d: d.after)
        verdict = "will be named" if after.after >= CLEAR / 2 else "may be taken for it still"
        size = "" if after.shown else ", if it is four sigmas large, which the rows so far do not show"
        lines.append(
            f"if {true} is there, {before.rival} is behind by {before.before:.1f} nats so far, and with the planned rows "
            f"{after.rival}, the nearest, by {after.after:.1f}: {verdict}{size} (the search asks for 3)"
        )
    return lines


def _members(known: Beforehand, observed: Observed, name: str, part: tuple[Coefficient, ...]) -> list[Effect]:
    """What an effect that is to be told apart may be.

    Each of those that the search has at that place, a harmonic of one order for instance; if it is none of these, as declared.
    """
    where, _, kind = name.rpartition(".")
    own = [e for e in candidates(observed, (kind,)) if e.where == where and set(e.coefficients) <= set(part)]
    return own or [Effect(kind, where, part)]


def _library(
    known: Beforehand, observed: Observed, effects: Sequence[tuple[str, tuple[Coefficient, ...]]]
) -> list[Effect]:
    """What the search would try beside two effects: small ones, that do not hold one of them."""
    kinds = [kind for kind in known.campaign.diagnosis.candidates if KINDS[kind].named and KINDS[kind].key != "at"]
    mine = {name for name, _ in effects}
    holding = {
        (kind.name, name.rpartition(".")[0])
        for kind in KINDS.values()
        for name in mine
        if name.rpartition(".")[2] in kind.holds
    }
    return [
        effect
        for effect in candidates(observed, kinds)
        if not effect.smooth
        and len(effect.coefficients) <= LARGEST
        and f"{effect.where}.{effect.kind}" not in mine
        and (effect.kind, effect.where) not in holding
    ]


def _expected(
    base: np.ndarray, own: Sequence[int], information: np.ndarray, pull: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Theta theta' of an effect as the rows so far have it, or so large that they would show it; and whether they do."""
    if not pull.any():
        return EXPECTED**2 * np.eye(len(own)), True
    columns = np.concatenate([base, own]).astype(int)
    covariance = np.linalg.inv(information[np.ix_(columns, columns)])
    theta = (covariance @ pull[columns])[-len(own) :]
    shown = float(theta @ np.linalg.solve(covariance[-len(own) :, -len(own) :], theta))
    return np.outer(theta, theta) * max(1.0, LEAST / max(shown, 1e-300)), shown >= LEAST


def _power(side: _Side, information: np.ndarray) -> float:
    """Non-centrality of one duel."""
    return float(side.power(np.linalg.inv(information[np.ix_(side.columns, side.columns)])))


def _nearest(sides: Sequence[_Side], information: np.ndarray) -> list[_Side]:
    """Of each effect those rivals that come nearest to it, if they come near."""
    power = {id(side): _power(side, information) for side in sides}
    found = []
    for h in (0, 1):
        own = sorted((s for s in sides if s.owner[0] == h), key=lambda s: power[id(s)])[:AT_ONCE]
        found += [s for s in own if power[id(s)] < CLEAR]
    return found


def _exchanged(rows: np.ndarray, information: np.ndarray, sides: Sequence[_Side], n: int) -> list[int]:
    """The n candidates of which the chance to be wrong is smallest: one by one, then exchanged."""
    told = [np.ascontiguousarray(rows[:, :, side.columns]) for side in sides]

    def costs(chosen: Sequence[int]) -> np.ndarray:
        F = rows[list(chosen)].reshape(-1, rows.shape[2])
        M = information + F.T @ F  # anew each time: what is hardly known at first does not bear being updated
        cost = _costs(told, [np.linalg.inv(M[np.ix_(side.columns, side.columns)]) for side in sides], sides)
        cost[list(chosen)] = np.inf
        return cost

    chosen: list[int] = []
    while len(chosen) < n:
        chosen.append(int(np.argmin(costs(chosen))))
    for _ in range(PASSES):
        settled = True
        for place, old in enumerate(chosen):
            cost = costs([*chosen[:place], *chosen[place + 1 :]])
            new = int(np.argmin(cost))
            if cost[new] < cost[old] - BETTER:
                chosen[place], settled = new, False
        if settled:
            break
    return chosen


def _costs(told: Sequence[np.ndarray], spread: Sequence[np.ndarray], sides: Sequence[_Side]) -> np.ndarray:
    """Logarithm of the bound of the chance to be wrong with each candidate added, shape (C,)."""
    powers = []
    for F, S, side in zip(told, spread, sides, strict=True):
        C, p, D = F.shape
        moved = (F.reshape(C * p, D) @ S).reshape(C, p, D)
        inner = np.eye(p) + moved @ F.transpose(0, 2, 1)
        own = moved[:, :, -side.own :]
        powers.append(side.of_own(S[-side.own :, -side.own :] - own.transpose(0, 2, 1) @ np.linalg.solve(inner, own)))
    return np.asarray(logsumexp(-np.array(powers) / SAFE, axis=0))
