r"""The best n of many configurations, by Fedorov's exchange on the information of what they would measure.

A configuration c, measured, adds :math:`F_c^T F_c` to the information M of D unknowns, with F_c its Jacobian in sigmas, shape
(p, D). Its inverse follows each exchange by Woodbury's identity,

.. math:: (M \pm F^T F)^{-1} = \Sigma \mp \Sigma F^T (1 \pm F \Sigma F^T)^{-1} F \Sigma

so that the worth of every candidate costs some small matrices and no decomposition (Fedorov 1972, Theory of Optimal Experiments,
chapter 3; one exchange at a time as in Cook and Nachtsheim 1980, doi:10.1080/00401706.1980.10486162). Criteria:

- A: the mean variance of the target's position over a region, :math:`tr(\Sigma W)` (I- or V-optimal in some books).
- G: the largest variance there in any direction, by A with the weights of the places raised where it is large.
- D: the volume of the uncertainty of the constants and frames, unknown places of instruments solved for:
  :math:`\ln\det M - \ln\det M_{BB}`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np

Criterion = Literal["A", "D", "G"]

MOST_QUESTIONS, FEWEST_PASSES = 600, 1
"""Times that a member of a choice is asked whether another is better, and passes through all of them at the least: four or five
passes are usual for thirty; of hundreds, each matters less."""

STARTS, FEW = 3, 40
"""Choices that exchanges begin with where few are wanted: the greedy one and random ones, which end within a per cent of each
other; and up to how many that is. More begin with the greedy one alone."""

LEAST_GAIN_SHARE = 1e-6
"""Share by which an exchange must be better: rounding must not exchange for ever."""

LEAST_PRIOR_SHARE = 1e-9
"""Share of what a row tells that is known without it, below which Woodbury's identity leaves nothing but rounding."""

WORST_ROUNDS = 6
"""Times that the weights of the places are raised where the target is worst known."""


@dataclass(frozen=True)
class RowChoice:
    """Candidates to choose from, and the criterion.

    Attributes:
        rows: Of each candidate, in sigmas, shape (C, p, D), filled up with zeros.
        prior_information: Information without the candidates, shape (D, D), positive definite.
        target: How the target moves at the places of the region, shape (R, 3, D), [m].
        weight: Of each place, shape (R,), with mean 1.
        solved_for: Number of the first unknowns, places of instruments, which are solved for but not judged.
        criterion: See above.
    """

    rows: np.ndarray
    prior_information: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    solved_for: int
    criterion: Criterion

    @cached_property
    def averaged(self) -> np.ndarray:
        """W, shape (D, D): the mean of the target's J'J."""
        J = self.target * np.sqrt(self.weight / len(self.target))[:, None, None]
        flat = J.reshape(-1, J.shape[2])
        return np.asarray(flat.T @ flat)

    def information(self, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """M with some candidates measured, shape (D, D)."""
        F = self.rows[list(chosen)].reshape(-1, self.rows.shape[2])
        return np.asarray(self.prior_information + F.T @ F)

    def variances(self, information: np.ndarray) -> np.ndarray:
        """Covariance of the target at each place, shape (R, 3, 3), [m²]."""
        root = np.linalg.cholesky(information)
        half = np.linalg.solve(root, self.target.reshape(-1, len(root)).T).T.reshape(self.target.shape)
        return np.asarray(half @ half.transpose(0, 2, 1))

    def cost(self, chosen: Sequence[int]) -> float:
        """The criterion's value: the smaller, the better."""
        M = self.information(chosen)
        if self.criterion == "D":
            instruments = slice(0, self.solved_for)
            return float(np.linalg.slogdet(M[instruments, instruments])[1] - np.linalg.slogdet(M)[1])
        covariance = self.variances(M)
        if self.criterion == "G":
            return float(np.linalg.eigvalsh(covariance)[:, -1].max())
        return float(np.mean(self.weight * np.einsum("rii->r", covariance)))


def rms_sigma(choice: RowChoice, information: np.ndarray) -> float:
    """RMS over the region of the target's sigma, all three directions together, [m]."""
    return float(np.sqrt(np.mean(np.einsum("rii->r", choice.variances(information)))))


def worst_sigma(choice: RowChoice, information: np.ndarray) -> float:
    """The target's sigma at the worst place in the worst direction, [m]."""
    return float(np.sqrt(np.linalg.eigvalsh(choice.variances(information))[:, -1].max()))


def best_choice(choice: RowChoice, n: int, rng: np.random.Generator, starts: int | None = None) -> list[int]:
    """The best n candidates that exchanges find, each at most once.

    Args:
        choice: C candidates.
        n: How many, at most C.
        rng: Draws the starts after the first, which is greedy.
        starts: How many; default: :data:`STARTS`, or one where many are wanted.
    """
    starts = starts or (STARTS if n <= FEW else 1)
    if choice.criterion == "G":
        return _for_the_worst(choice, n, rng, starts)
    choices = [greedy(choice, n), *(rng.permutation(len(choice.rows))[:n].tolist() for _ in range(starts - 1))]
    ends = [exchange_members(choice, chosen) for chosen in choices]
    return min(ends, key=choice.cost)


def greedy(choice: RowChoice, n: int, begin: Sequence[int] = ()) -> list[int]:
    """Candidates added one by one, each the best there is."""
    chosen = list(begin)
    while len(chosen) < n:
        gain = _worth(choice, np.linalg.inv(choice.information(chosen)), _of_solved(choice, chosen))
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
    return chosen


def exchange_members(choice: RowChoice, chosen: Sequence[int]) -> list[int]:
    """A choice with members exchanged as long as that makes it better."""
    chosen = list(chosen)
    for _ in range(max(FEWEST_PASSES, MOST_QUESTIONS // max(len(chosen), 1))):
        covariance, solved = np.linalg.inv(choice.information(chosen)), _of_solved(choice, chosen)
        unchanged = True
        for place, old in enumerate(chosen):
            without_member = partial(choice.information, [c for c in chosen if c != old])
            without, solved_without = covariances_without(choice, covariance, solved, choice.rows[old], without_member)
            gain = _worth(choice, without, solved_without)
            gain_of_old = gain[old]
            gain[[c for c in chosen if c != old]] = -np.inf
            new = int(np.argmax(gain))
            if new == old or gain[new] - gain_of_old <= LEAST_GAIN_SHARE * abs(gain_of_old):
                continue
            chosen[place], unchanged = new, False
            covariance = updated(without, choice.rows[new], 1.0)
            solved = updated(solved_without, choice.rows[new, :, : choice.solved_for], 1.0)
        if unchanged:
            break
    return chosen


def nested(choice: RowChoice, chosen: Sequence[int], most: int) -> list[int]:
    """Candidates in an order of which every beginning is a good choice of its length.

    The choice comes first, its least useful member last, then further candidates.

    Args:
        choice: C candidates.
        chosen: A choice.
        most: Length of the order, at least that of the choice.
    """
    remaining, removed = list(chosen), []
    while remaining:
        covariance, solved = np.linalg.inv(choice.information(remaining)), _of_solved(choice, remaining)
        loss = [-gain_of_rows(choice, F, covariance, solved, -1.0)[0] for F in choice.rows[remaining][:, None]]
        removed.append(remaining.pop(int(np.argmin(loss))))
    return greedy(choice, most, removed[::-1])


def _for_the_worst(choice: RowChoice, n: int, rng: np.random.Generator, starts: int) -> list[int]:
    """The choice whose worst place is best known: see the module."""
    mean = replace(choice, criterion="A")
    best = chosen = best_choice(mean, n, rng, starts)
    for _ in range(WORST_ROUNDS):
        mean = replace(mean, weight=weights_of_the_worst(mean, chosen))
        chosen = exchange_members(mean, chosen)
        best = min(best, chosen, key=choice.cost)
    return best


def _worth(choice: RowChoice, covariance: np.ndarray, solved: np.ndarray) -> np.ndarray:
    """By how much each candidate, added, makes the cost smaller, shape (C,)."""
    return gain_of_rows(choice, choice.rows, covariance, solved, 1.0)


def gain_of_rows(
    choice: RowChoice, rows: np.ndarray, covariance: np.ndarray, solved: np.ndarray, sign: float
) -> np.ndarray:
    """By how much each of some rows, added or taken away (sign -1), makes the cost smaller, shape (n,)."""
    if choice.criterion == "D":
        of_instruments = rows[:, :, : choice.solved_for]
        return _log_volume(rows, covariance, sign) - _log_volume(of_instruments, solved, sign)
    n, p, D = rows.shape
    propagated = (rows.reshape(n * p, D) @ covariance).reshape(n, p, D)
    in_sigmas = propagated @ rows.transpose(0, 2, 1)
    cost_change = (propagated.reshape(n * p, D) @ choice.averaged).reshape(n, p, D) @ propagated.transpose(0, 2, 1)
    return np.asarray(sign * np.einsum("nii->n", np.linalg.solve(_beside(in_sigmas, sign), cost_change)))


def _log_volume(rows: np.ndarray, covariance: np.ndarray, sign: float) -> np.ndarray:
    """Logarithm of det (1 + sign F Sigma F'), shape (n,)."""
    n, p, D = rows.shape
    in_sigmas = (rows.reshape(n * p, D) @ covariance).reshape(n, p, D) @ rows.transpose(0, 2, 1)
    return np.asarray(np.linalg.slogdet(_beside(in_sigmas, sign))[1])


def _beside(in_sigmas: np.ndarray, sign: float) -> np.ndarray:
    """1 + sign F Sigma F', shape (..., p, p), positive definite.

    The eigenvalues of F Sigma F' of rows that are taken away are below 1 by what is known without them. Where these rows alone
    tell something, that is next to nothing, and rounding may leave nothing at all: :data:`LEAST_PRIOR_SHARE` replaces it.
    """
    one = np.eye(in_sigmas.shape[-1])
    if sign > 0.0 or not in_sigmas.size:
        return one + sign * in_sigmas
    values, V = np.linalg.eigh(in_sigmas)
    if values.max() < 1.0 - LEAST_PRIOR_SHARE:
        return one - in_sigmas
    return np.asarray((V * np.maximum(1.0 - values, LEAST_PRIOR_SHARE)[..., None, :]) @ np.swapaxes(V, -1, -2))


def weights_of_the_worst(choice: RowChoice, chosen: Sequence[int]) -> np.ndarray:
    """Weights of the places that grow with how badly the target is known there, shape (R,), with mean 1."""
    largest = np.linalg.eigvalsh(choice.variances(choice.information(chosen)))[:, -1]
    weight = choice.weight * largest / largest.mean()
    return np.asarray(weight / weight.mean())


def _of_solved(choice: RowChoice, chosen: Sequence[int]) -> np.ndarray:
    """Inverse of the information of the instruments' unknowns alone, see :attr:`Choice.solved_for`."""
    instruments = slice(0, choice.solved_for)
    return np.linalg.inv(choice.information(chosen)[instruments, instruments])


def covariances_without(
    choice: RowChoice,
    covariance: np.ndarray,
    solved: np.ndarray,
    F: np.ndarray,
    others: Callable[[], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Two covariances without some rows: of all unknowns, (D, D), and of the instruments' alone.

    Args:
        choice: Says which unknowns are the instruments'.
        covariance: With the rows, shape (D, D).
        solved: Likewise of the instruments' unknowns.
        F: The rows, shape (p, D).
        others: Information without them, shape (D, D): asked for where they alone tell something.
    """
    instruments = slice(0, choice.solved_for)
    if len(F) and np.linalg.eigvalsh(F @ covariance @ F.T)[-1] > 1.0 - LEAST_PRIOR_SHARE:
        M = others()
        return np.linalg.inv(M), np.linalg.inv(M[instruments, instruments])
    return updated(covariance, F, -1.0), updated(solved, F[:, instruments], -1.0)


def updated(covariance: np.ndarray, F: np.ndarray, sign: float) -> np.ndarray:
    """The covariance with rows (p, D) added, or taken away (sign -1)."""
    propagated = F @ covariance
    inner = np.eye(len(F)) + sign * (propagated @ F.T)
    return np.asarray(covariance - sign * (propagated.T @ np.linalg.solve(inner, propagated)))
