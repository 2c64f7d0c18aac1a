r"""What rows tell of an arm's constants: combinations from the best known to the worst, and those that could be left nominal.

Two constants may each be known badly and their sum well: a covariance says more than its diagonal. Its eigenvectors, a metre
counting as a radian, are the combinations that these rows tell independently of each other.
Frames of base and target are free throughout: they take their part of what is confounded with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.corrections.effect import ANGULAR
from aridcal.engine.fit.identifiable import CARRIES
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.levels import PRICE
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.columns import columns_of
from aridcal.system.progress import SILENT, Progress

MOST_PARTS = 4
"""Drawn: Parts of a combination that are named; no one can picture more."""

PAIR_RATIO = 3.0
"""Times that a sum is known better than the difference, or the other way round, from which a pair is worth a sentence: the two
are then correlated by 0.8."""

AVERAGED_ROWS = 300
"""Work: Rows over which the shift of the target is averaged."""


@dataclass(frozen=True)
class Combination:
    """A combination of constants that the rows tell apart from all others.

    Attributes:
        parts: Names with their shares, the largest first and positive; squares of all, also of those not named, sum to 1.
        unit: Of all parts, ``m`` or ``rad``; empty where there are both, a metre counting as a radian.
        std: 1-sigma, in that unit.
    """

    parts: tuple[tuple[str, float], ...]
    unit: str
    std: float


@dataclass(frozen=True)
class Pair:
    """Two constants of one unit of which the rows know the sum and the difference unequally well.

    Attributes:
        first: Name.
        second: Name.
        unit: ``m`` or ``rad``.
        of_sum: 1-sigma of the sum.
        of_difference: 1-sigma of the difference.
    """

    first: str
    second: str
    unit: str
    of_sum: float
    of_difference: float

    @property
    def ratio(self) -> float:
        """How many times the one is known better than the other."""
        return max(self.of_sum, self.of_difference) / min(self.of_sum, self.of_difference)


@dataclass(frozen=True)
class Identifiability:
    """How well rows tell the constants.

    Attributes:
        names: Identifiable constants, K' of them: none can be left out unless its value is known.
        combinations: Combinations of these constants, the best known first.
        pairs: Pairs worth a sentence, the most unequal first.
        spare: Constants that could stay nominal together: these rows cannot tell them from nominal.
        needed: The other constants, without which the rows are predicted worse.
        shift: RMS by which the target moves if the spare ones stay nominal and the rest follow, [m].
        sigma: RMS 1-sigma of the target before, all three axes, [m].
    """

    names: tuple[str, ...]
    combinations: tuple[Combination, ...]
    pairs: tuple[Pair, ...]
    spare: tuple[str, ...]
    needed: tuple[str, ...]
    shift: float
    sigma: float


def identifiability(fit: Fit, train: Dataset, progress: Progress = SILENT) -> Identifiability | None:
    """Ask what rows tell of the arm's constants; None for a fit without such constants.

    Args:
        fit: A stage without effects.
        train: The rows that it was fitted to.
        progress: Told how far the pass over them is.
    """
    of_arm = [c.basis.constant and c.where in _places(fit) for c in fit.model.coefficients]
    arm_constants = np.flatnonzero(of_arm)
    if len(arm_constants) == 0:
        return None
    names = [fit.model.names[k] for k in arm_constants]
    units = ["rad" if fit.model.coefficients[k].component in ANGULAR else "m" for k in arm_constants]
    covariance = fit.covariance[np.ix_(arm_constants, arm_constants)]
    spare, moved = _spare(fit, arm_constants)
    rows = columns_of(fit, train, fit.sigma, AVERAGED_ROWS, progress)
    J = rows.target.reshape(-1, len(fit.theta))
    variance = float(np.sum((J @ fit.covariance) * J)) / len(rows)
    return Identifiability(
        names=tuple(names),
        combinations=_combinations(names, units, covariance),
        pairs=_pairs(names, units, covariance),
        spare=tuple(fit.model.names[k] for k in spare),
        needed=tuple(fit.model.names[k] for k in arm_constants if k not in spare),
        shift=float(np.sqrt(np.sum((J @ moved) ** 2) / len(rows))),
        sigma=float(np.sqrt(max(variance, 0.0))),
    )


def _places(fit: Fit) -> set[str]:
    """Names of the places where an arm's constants act: its joints and the tip's fixed joint."""
    robot = fit.model.robot
    return {*robot.names, *([robot.tip_joint] if robot.tip_joint else [])}


def _combinations(names: list[str], units: list[str], covariance: np.ndarray) -> tuple[Combination, ...]:
    """Eigenvectors of a covariance (K', K') in words, the smallest variance first."""
    values, vectors = np.linalg.eigh(covariance)
    combinations = []
    for value, vector in zip(values.tolist(), vectors.T, strict=True):
        largest_first = np.argsort(-np.abs(vector), kind="stable")
        vector = vector * np.sign(vector[largest_first[0]])
        parts = [k for k in largest_first.tolist() if abs(vector[k]) >= CARRIES * vector[largest_first[0]]][:MOST_PARTS]
        shared = {units[k] for k in parts}
        unit = shared.pop() if len(shared) == 1 else ""
        combinations.append(
            Combination(tuple((names[k], float(vector[k])) for k in parts), unit, float(np.sqrt(max(value, 0.0))))
        )
    return tuple(combinations)


def _pairs(names: list[str], units: list[str], covariance: np.ndarray) -> tuple[Pair, ...]:
    """Pairs of one unit whose sum and difference are known unequally well."""
    pairs = []
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            if units[i] != units[j]:
                continue
            squares, cross = covariance[i, i] + covariance[j, j], 2.0 * covariance[i, j]
            if squares - abs(cross) <= 0.0:
                continue  # one of the two is known to rounding
            pair = Pair(names[i], names[j], units[i], float(np.sqrt(squares + cross)), float(np.sqrt(squares - cross)))
            if pair.ratio >= PAIR_RATIO:
                pairs.append(pair)
    return tuple(sorted(pairs, key=lambda pair: -pair.ratio))


def _spare(fit: Fit, arm_constants: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Constants that may stay nominal together, the cheapest first, and how all coefficients then change, shape (K,).

    Fixing constant k at nominal costs theta_k^2 / Sigma_kk squares, in sigmas, when all others follow. It may cost two: its own
    variance, 1, is gained, and a constant that is really nominal costs 1 on average. As a likelihood that is the price of any
    number (Akaike 1973; Mallows' C_p).
    """
    theta, covariance = fit.theta.copy(), fit.covariance.copy()
    needed, spare = arm_constants.tolist(), []
    while needed:
        variance = np.diag(covariance)[needed]
        cost = np.where(variance > 0.0, theta[needed] ** 2 / np.where(variance > 0.0, variance, 1.0), np.inf)
        least = int(np.argmin(cost))
        if 0.5 * cost[least] >= PRICE:
            break
        k = needed.pop(least)
        spare.append(k)
        share = covariance[:, k] / covariance[k, k]
        theta -= share * theta[k]
        covariance -= np.outer(share, covariance[k])
    return spare, theta - fit.theta
