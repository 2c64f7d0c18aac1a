"""What a plan covers: where its targets lie, where the target stays badly known, and which row tells of which suspect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.trust.workspace import UNTOLD_SIGMA
from aridcal.jobs.plan.configurations import Candidates, targets_of
from aridcal.jobs.plan.information import ASSUMED_SHARE, CandidateInformation
from aridcal.jobs.plan.prior_knowledge import PlanSetup
from aridcal.jobs.plan.row_exchange import RowChoice, covariances_without, rms_sigma, worst_sigma

CURVE_POINTS = 12
"""Points of the curve of sigma against the number of configurations: a smooth line, and each a small decomposition."""


@dataclass(frozen=True)
class Sigma:
    """Sigma of the target over the region with n new configurations; NaN where it is not known at all.

    Attributes:
        n: Number of new configurations.
        rms: All three directions together, [m].
        worst: At the worst place in the worst direction, [m].
    """

    n: int
    rms: float
    worst: float


@dataclass(frozen=True)
class PlanCoverage:
    """What a plan of n configurations covers.

    Attributes:
        targets: Of the configurations in the world, shape (n, 3), [m].
        places: Of the target over the region, shape (R, 3), [m].
        worst: 1-sigma there in the worst direction, shape (R,), [m].
        against: Sigma of the target with fewer and with more configurations.
        suspects: Effects that may be there, ``WHERE.KIND``.
        loss: Share by which the variance of each suspect would grow without each configuration, shape (n, suspects).
    """

    targets: np.ndarray
    places: np.ndarray
    worst: np.ndarray
    against: tuple[Sigma, ...]
    suspects: tuple[str, ...]
    loss: np.ndarray


def sigma_of(choice: RowChoice, chosen: list[int]) -> Sigma:
    """Sigma over the region with the chosen configurations."""
    M = choice.information(chosen)
    rms = observed_sigma(rms_sigma(choice, M))
    return Sigma(len(chosen), rms, worst_sigma(choice, M) if np.isfinite(rms) else np.nan)


def observed_sigma(sigma: float) -> float:
    """A sigma, or NaN where it comes from what is assumed, not from rows."""
    return sigma if sigma < ASSUMED_SHARE * UNTOLD_SIGMA else float("nan")


def coverage(
    setup: PlanSetup,
    unknowns: CandidateInformation,
    choice: RowChoice,
    order: list[int],
    visited: Candidates,
    rows: np.ndarray,
    region: np.ndarray,
) -> PlanCoverage:
    """The coverage of a plan.

    Args:
        setup: The model.
        unknowns: Its unknowns.
        choice: Has the configurations that were chosen and others.
        order: Numbers of them, the best first; see :func:`aridcal.jobs.plan.row_exchange.nested`.
        visited: The plan, n configurations.
        rows: What they tell, in sigmas, shape (n, p, D).
        region: Readings at the places, shape (R, columns).
    """
    counts = np.unique(np.linspace(1, len(order), CURVE_POINTS).round().astype(int)).tolist()
    planned, instruments = replace(choice, rows=rows), slice(0, choice.solved_for)
    M = planned.information(range(len(rows)))
    covariance, solved = np.linalg.inv(M), np.linalg.inv(M[instruments, instruments])
    names, parts = suspects(setup, unknowns)
    loss = np.zeros((len(rows), len(names)))
    for k, F in enumerate(rows):
        without_row = partial(planned.information, [other for other in range(len(rows)) if other != k])
        without, _ = covariances_without(planned, covariance, solved, F, without_row)
        loss[k] = [_growth(without, covariance, part) for part in parts]
    variances = np.linalg.eigvalsh(choice.variances(M))[:, -1]
    return PlanCoverage(
        targets=targets_of(setup, visited.readings, visited.first)[1],
        places=targets_of(setup, region, np.zeros(len(region), dtype=int))[1],
        worst=np.sqrt(variances.reshape(-1, len(region)).max(axis=0)),
        against=tuple(sigma_of(choice, order[:count]) for count in counts),
        suspects=names,
        loss=loss,
    )


def _growth(without: np.ndarray, covariance: np.ndarray, part: list[int]) -> float:
    """Share by which the variance of some unknowns is larger without a configuration."""
    return float(np.trace(without[np.ix_(part, part)]) / np.trace(covariance[np.ix_(part, part)]) - 1.0)


def suspects(setup: PlanSetup, unknowns: CandidateInformation) -> tuple[tuple[str, ...], list[list[int]]]:
    """Names of the effects among the unknowns, by place and covariates, and the indices of each one's unknowns."""
    parts: dict[str, list[int]] = {}
    for number, k in enumerate(unknowns.coefficients):
        c = setup.model.coefficients[k]
        if not c.basis.constant:
            parts.setdefault(_title(c), []).append(unknowns.things + number)
    return tuple(parts), list(parts.values())


def indices(setup: PlanSetup, unknowns: CandidateInformation, rows: np.ndarray) -> tuple[float, ...]:
    """Observability indices of all rows together, suspects held; see :func:`observability`.

    Args:
        setup: The model, and the rows so far.
        unknowns: Its unknowns.
        rows: New ones, in sigmas, shape (n, p, D).
    """
    flat = rows.reshape(-1, rows.shape[2])
    information = (unknowns.measured + flat.T @ flat) * unknowns.sizes * unknowns.sizes[:, None]
    expected = np.isfinite(setup.prior[list(unknowns.coefficients)])
    judged = np.flatnonzero(np.concatenate([np.ones(unknowns.things, dtype=bool), ~expected]))
    return observability(information[np.ix_(judged, judged)], unknowns.things, len(setup.rows) + len(rows))


def observability(information: np.ndarray, solved_for: int, n: int) -> tuple[float, ...]:
    r"""The five indices in use, of the Jacobian in sigmas per [m] and [rad] with singular values s, L of them, from n rows.

    .. math:: O_1 = (s_1 \cdots s_L)^{1/L} / \sqrt n, \quad O_2 = s_L / s_1, \quad O_3 = s_L, \quad O_4 = s_L^2 / s_1, \quad
              O_5 = 1 / (1/s_1 + \ldots + 1/s_L)

    (Borm and Menq 1991; Driels and Pathre 1990; Nahvi, Hollerbach and Hayward 1994; Nahvi and Hollerbach 1996; Sun and
    Hollerbach 2008, doi:10.1109/ROBOT.2008.4543390, which compares them.)

    Args:
        information: Shape (D, D).
        solved_for: Unknowns, the first ones, that are solved for beside.
        n: Rows.
    """
    cross = information[solved_for:, :solved_for]
    inner = np.linalg.pinv(information[:solved_for, :solved_for], hermitian=True)
    values = np.linalg.eigvalsh(information[solved_for:, solved_for:] - cross @ inner @ cross.T)
    s = np.sqrt(np.maximum(values, 0.0))[::-1]
    with np.errstate(divide="ignore"):
        first = float(np.exp(np.mean(np.log(s))) / np.sqrt(n))
        last = float(1.0 / np.sum(1.0 / s))
    return first, float(s[-1] / s[0]), float(s[-1]), float(s[-1] ** 2 / s[0]), last


def _title(c: Coefficient) -> str:
    """The name of a suspect: its place, and what it depends on."""
    depends = (name.removeprefix(c.where).strip("._").replace("_", " ") for name in c.basis.of if name != c.where)
    return f"{c.where}: {' and '.join(depends) or 'its own reading'}"
