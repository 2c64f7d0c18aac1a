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

from aridcal.engine.corrections.catalogue import EFFECT_KINDS, candidates
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.trust.workspace import UNTOLD_SIGMA
from aridcal.jobs.plan.configurations import Candidates
from aridcal.jobs.plan.information import CandidateInformation, measured_information, stack_by_candidate, whitened
from aridcal.jobs.plan.prior_knowledge import PlanSetup

BHATTACHARYYA_DIVISOR = 8.0
"""Non-centrality over this in the exponent: Bhattacharyya's bound of the chance to be wrong."""

CLEAR_NON_CENTRALITY = 30.0
"""Non-centrality beyond which a rival is none: 15 nats behind, where the search asks for 3, and noise of five."""

LEAST_NON_CENTRALITY = 16.0
"""Non-centrality of an effect by itself that is taken where the rows show less of it: four sigmas, as little as is ever named."""

HOPELESS_NON_CENTRALITY = 6.0
"""Non-centrality that even three times as many configurations as are asked for would not bring: the two are one."""

AT_ONCE, ROUNDS = 4, 3
"""Rivals of each effect that are taken up after a choice, and how often: more than three times changes nothing."""

EXPECTED_MOTION = 5.0e-4
"""[rad] or [m]: RMS motion of an effect of which no row tells how large it is."""

MOST_PASSES = 6
"""Passes of the exchange at the most; three are usual."""

LEAST_LOG_GAIN = 1.0e-6
"""Of the logarithm of the chance, by which an exchange must be better: rounding must not exchange for ever."""

MOST_RIVAL_COEFFICIENTS = 4
"""Coefficients of a rival at the most: what has more pays for them in the search's evidence."""


@dataclass(frozen=True)
class Duel:
    """One effect against another one that could stand in its place.

    Attributes:
        true: The effect that is there, in words.
        rival: The effect that is fitted instead, in words.
        before: Nats by which the rival is expected to be behind, by the rows so far.
        after: Nats likewise, by the rows so far and the planned ones.
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
        own: Number of the effect's columns.
        weight: theta theta', shape (own, own).
        title: Names of the effect and its rival.
        owner: For effect and rival: which of the two effects it is, 0 or 1; 2 for a rival that is neither.
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
        """Non-centrality by covariances of the effect's own coefficients alone, (..., own, own) to (...)."""
        return np.asarray(
            np.einsum("...ii->...", np.linalg.solve(covariance, np.broadcast_to(self.weight, covariance.shape)))
        )


def discriminating_candidates(
    setup: PlanSetup,
    unknowns: CandidateInformation,
    effects: Sequence[tuple[str, tuple[Coefficient, ...]]],
    observed: ObservedRows,
    candidates_offered: Candidates,
    n: int,
) -> tuple[list[int], tuple[Duel, ...]]:
    """Candidates that tell effects apart, and what is expected of them.

    Args:
        setup: Has the coefficients of all of these effects.
        unknowns: Which of the unknowns can be identified.
        effects: Two, with what each is called.
        observed: What other effects can be made of.
        candidates_offered: C configurations.
        n: How many to choose.
    """
    members = [_members(setup, observed, name, part) for name, part in effects]
    others = _library(setup, observed, effects)
    hypotheses = [*members[0], *members[1], *others]
    owner = [0] * len(members[0]) + [1] * len(members[1]) + [2] * len(others)
    wide = setup.with_coefficients(
        tuple(dict.fromkeys(c for e in others for c in e.coefficients if c not in setup.model.coefficients))
    )
    number = {c: unknowns.things + k for k, c in enumerate(wide.model.coefficients)}
    rows = stack_by_candidate(whitened(wide, candidates_offered), candidates_offered)
    flat, residual = measured_information(wide, candidates_offered)
    parts = [[number[c] for c in effect.coefficients] for effect in hypotheses]
    own_columns = {number[c] for _, part in effects for c in part}
    base = np.array(
        [
            k
            for k in (*range(unknowns.things), *(unknowns.things + k for k in unknowns.coefficients))
            if k not in own_columns
        ]
    )
    sizes = np.concatenate([np.ones(unknowns.things), wide.model.sizes])
    information = flat.T @ flat + np.diag(1.0 / (UNTOLD_SIGMA * sizes) ** 2)
    pool = np.einsum("cpi,cpj->ij", rows, rows, optimize=True) * (3.0 * n / len(rows))
    sides = []
    for h in (k for k, side in enumerate(owner) if side < 2):
        weight, shown = _expected_size(base, parts[h], information, flat.T @ residual)
        for r, part in enumerate(parts):
            rest = [k for k in part if k not in parts[h]]
            if owner[r] == owner[h] or not rest:
                continue
            columns = np.concatenate([base, rest, parts[h]]).astype(int)
            made = _Side(
                columns, len(parts[h]), weight, (hypotheses[h].label, hypotheses[r].label), (owner[h], owner[r]), shown
            )
            if owner[r] < 2 or _power(made, information + pool) > HOPELESS_NON_CENTRALITY:
                sides.append(made)
    chosen, rivals = [], [side for side in sides if side.owner[1] < 2]
    for _ in range(ROUNDS):
        chosen = _exchanged(rows, information, rivals, n)
        F = rows[chosen].reshape(-1, rows.shape[2])
        nearest = _nearest_rivals([side for side in sides if side not in rivals], information + F.T @ F)
        if not nearest:
            break
        rivals += nearest
    F = rows[chosen].reshape(-1, rows.shape[2])
    information_after = information + F.T @ F
    duels = [Duel(*s.title, _power(s, information) / 2, _power(s, information_after) / 2, s.shown) for s in rivals]
    return chosen, tuple(duels)


def duel_lines(duels: Sequence[Duel]) -> list[str]:
    """What is expected, in sentences: for each effect the rival that comes nearest, before and with the planned rows."""
    lines = []
    for true in dict.fromkeys(duel.true for duel in duels):
        of_effect = [duel for duel in duels if duel.true == true]
        before, after = min(of_effect, key=lambda d: d.before), min(of_effect, key=lambda d: d.after)
        verdict = "will be named" if after.after >= CLEAR_NON_CENTRALITY / 2 else "may be taken for it still"
        size = "" if after.shown else ", if it is four sigmas large, which the rows so far do not show"
        lines.append(
            f"if {true} is there, {before.rival} is behind by {before.before:.1f} nats so far, and with the planned rows "
            f"{after.rival}, the nearest, by {after.after:.1f}: {verdict}{size} (the search asks for 3)"
        )
    return lines


def _members(setup: PlanSetup, observed: ObservedRows, name: str, part: tuple[Coefficient, ...]) -> list[Effect]:
    """The forms that an effect which is to be told apart may have.

    Each candidate of the search at that place, a harmonic of one order for instance; if there is none, the effect as declared.
    """
    where, _, kind = name.rpartition(".")
    of_search = [e for e in candidates(observed, (kind,)) if e.where == where and set(e.coefficients) <= set(part)]
    return of_search or [Effect(kind, where, part)]


def _library(
    setup: PlanSetup, observed: ObservedRows, effects: Sequence[tuple[str, tuple[Coefficient, ...]]]
) -> list[Effect]:
    """Candidates of the search beside two effects: small ones that hold neither of the two."""
    kinds = [
        kind
        for kind in setup.campaign.diagnosis.candidates
        if EFFECT_KINDS[kind].named and EFFECT_KINDS[kind].key != "at"
    ]
    names = {name for name, _ in effects}
    holding = {
        (kind.name, name.rpartition(".")[0])
        for kind in EFFECT_KINDS.values()
        for name in names
        if name.rpartition(".")[2] in kind.holds
    }
    return [
        effect
        for effect in candidates(observed, kinds)
        if not effect.smooth
        and len(effect.coefficients) <= MOST_RIVAL_COEFFICIENTS
        and f"{effect.where}.{effect.kind}" not in names
        and (effect.kind, effect.where) not in holding
    ]


def _expected_size(
    base: np.ndarray, columns_of_effect: Sequence[int], information: np.ndarray, pull: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Theta theta' of an effect by the rows so far, or as large as they would show; and whether they show it."""
    if not pull.any():
        return EXPECTED_MOTION**2 * np.eye(len(columns_of_effect)), True
    columns = np.concatenate([base, columns_of_effect]).astype(int)
    covariance = np.linalg.inv(information[np.ix_(columns, columns)])
    theta = (covariance @ pull[columns])[-len(columns_of_effect) :]
    non_centrality = float(
        theta @ np.linalg.solve(covariance[-len(columns_of_effect) :, -len(columns_of_effect) :], theta)
    )
    return np.outer(theta, theta) * max(
        1.0, LEAST_NON_CENTRALITY / max(non_centrality, 1e-300)
    ), non_centrality >= LEAST_NON_CENTRALITY


def _power(side: _Side, information: np.ndarray) -> float:
    """Non-centrality of one duel."""
    return float(side.power(np.linalg.inv(information[np.ix_(side.columns, side.columns)])))


def _nearest_rivals(sides: Sequence[_Side], information: np.ndarray) -> list[_Side]:
    """The rivals nearest to each effect, as far as they are near at all."""
    power = {id(side): _power(side, information) for side in sides}
    nearest = []
    for h in (0, 1):
        of_effect = sorted((s for s in sides if s.owner[0] == h), key=lambda s: power[id(s)])[:AT_ONCE]
        nearest += [s for s in of_effect if power[id(s)] < CLEAR_NON_CENTRALITY]
    return nearest


def _exchanged(rows: np.ndarray, information: np.ndarray, sides: Sequence[_Side], n: int) -> list[int]:
    """The n candidates with the smallest chance of a wrong verdict: chosen one by one, then exchanged."""
    by_side = [np.ascontiguousarray(rows[:, :, side.columns]) for side in sides]

    def costs(chosen: Sequence[int]) -> np.ndarray:
        F = rows[list(chosen)].reshape(-1, rows.shape[2])
        M = information + F.T @ F  # summed anew each time: updates lose all digits of what is hardly known at first
        cost = _log_chances(by_side, [np.linalg.inv(M[np.ix_(side.columns, side.columns)]) for side in sides], sides)
        cost[list(chosen)] = np.inf
        return cost

    chosen: list[int] = []
    while len(chosen) < n:
        chosen.append(int(np.argmin(costs(chosen))))
    for _ in range(MOST_PASSES):
        unchanged = True
        for place, old in enumerate(chosen):
            cost = costs([*chosen[:place], *chosen[place + 1 :]])
            new = int(np.argmin(cost))
            if cost[new] < cost[old] - LEAST_LOG_GAIN:
                chosen[place], unchanged = new, False
        if unchanged:
            break
    return chosen


def _log_chances(
    by_side: Sequence[np.ndarray], covariances: Sequence[np.ndarray], sides: Sequence[_Side]
) -> np.ndarray:
    """Logarithm of the bound of the chance to be wrong with each candidate added, shape (C,)."""
    powers = []
    for F, S, side in zip(by_side, covariances, sides, strict=True):
        C, p, D = F.shape
        moved = (F.reshape(C * p, D) @ S).reshape(C, p, D)
        inner = np.eye(p) + moved @ F.transpose(0, 2, 1)
        of_effect = moved[:, :, -side.own :]
        powers.append(
            side.of_own(S[-side.own :, -side.own :] - of_effect.transpose(0, 2, 1) @ np.linalg.solve(inner, of_effect))
        )
    return np.asarray(logsumexp(-np.array(powers) / BHATTACHARYYA_DIVISOR, axis=0))
