"""What the residual hints at, before anything is tested: harmonics of any order, functions of two covariates."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from aridcal.effects.effect import FRAME_COMPONENTS, Effect
from aridcal.effects.kinds import turns
from aridcal.fit.normal_equations import TINY
from aridcal.search.linear_model import LinearModel, State

SCANNED = 800
"""Orders of a joint's error that are looked through, a quarter period over its range apart: gears of up to 200 teeth over
a whole turn, and no peak falls between two of them."""

LOUD = 30.0
"""Chi-square of a harmonic that is worth a closer look: chance makes one in three million, and thousands are looked through."""

PEAKS = 2
"""Harmonics of each joint that are tested."""

FINE = 81
"""Orders around a peak among which it is found again, forty times as close."""

WHOLE = 0.05
"""An order this near to a whole number is one: shafts turn a whole number of times."""

STILL = 1e-3
"""[rad] or [m]: a joint that covers less hints at nothing."""

DEGREE = 4
"""Of the polynomials in two covariates with which pairs are looked through: bends and waves of two periods."""

LOUDEST = 12
"""Pairs that are tested: each has some fifty columns, and what explains less is seldom the cause."""


def harmonics(model: LinearModel, state: State) -> list[Effect]:
    r"""Harmonics of any order that the residual hints at: a periodogram over each joint's reading.

    Each row asks for a turn of the joint, with weight w; the power of order k is chi-square with two degrees of freedom,

    .. math:: P(k) = 2 \left| \sum_n p_n e^{i k q_n} \right|^2 / \sum_n w_n

    with p the row's pull (weight times the turn that it asks for), its mean taken off (Lomb 1976,
    doi:10.1007/BF00648343).
    """
    found = []
    for name in model.own:
        q = model.table[name][state.used]
        if (name, "axis") not in model.slot_index or np.ptp(q) < STILL:
            continue
        column = model.slot_columns(name, "axis")[state.used] / state.sigma
        weight, pull = np.sum(column**2, axis=1), np.sum(column * state.residual[state.used] / state.sigma, axis=1)
        pull = pull - weight * pull.sum() / max(weight.sum(), TINY)
        found += [
            Effect("joint_harmonic", name, turns(name, "axis", name, order), (order,))
            for order in _loud_orders(q, pull, float(weight.sum()))
        ]
    return found


def _loud_orders(q: np.ndarray, pull: np.ndarray, weight: float) -> list[float]:
    """Orders at which the periodogram of the rows' pulls has its highest peaks, the highest first."""
    orders = np.arange(1, SCANNED + 1) * np.pi / (2 * np.ptp(q))

    def power(k: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * np.abs(np.exp(1j * np.outer(k, q)) @ pull) ** 2 / weight)

    seen = power(orders)
    peaks = np.flatnonzero((seen > np.roll(seen, 1)) & (seen > np.roll(seen, -1)) & (seen > LOUD))
    found = []
    for peak in peaks[np.argsort(-seen[peaks])][:PEAKS]:
        fine = orders[peak] + np.linspace(-1, 1, FINE) * (orders[1] - orders[0])
        order = float(fine[np.argmax(power(fine))])
        whole = round(order)
        found.append(float(whole) if abs(order - whole) < WHOLE else round(order, 3))
    return found


def pairs(
    model: LinearModel, state: State, covariates: Sequence[str]
) -> tuple[list[tuple[str, str, tuple[str, str]]], int]:
    """Where and of which two covariates a smooth function would explain most, and how many were looked at.

    The residual is pulled back to each slot as the motion that would explain it row by row, and that is projected on
    products of Legendre polynomials in two covariates.
    """
    used = state.used
    G = model.G[used] / state.sigma[:, None]
    weight = np.einsum("nms,nms->ns", G, G)
    pull = np.einsum("nms,nm->ns", G, state.residual[used] / state.sigma) / np.sqrt(np.maximum(weight, TINY))
    pull[:, weight.sum(0) <= 0.0] = 0.0
    frames = [(s, slot) for s, slot in enumerate(model.slots) if slot[1] in FRAME_COMPONENTS]
    found = []
    for a, b in combinations(covariates, 2):
        waves = [np.polynomial.legendre.legvander(_centred(model.table[name][used]), DEGREE) for name in (a, b)]
        products = np.einsum("ni,nj->nij", *waves).reshape(len(pull), -1)
        along = np.linalg.qr(products)[0].T @ pull
        explained = np.sum(along**2, axis=0)
        found += [(float(explained[s]), (where, component, (a, b))) for s, (where, component) in frames]
    found.sort(key=lambda pair: -pair[0])
    return [place for _, place in found[:LOUDEST]], len(found)


def _centred(values: np.ndarray) -> np.ndarray:
    """A covariate brought to -1 to 1."""
    low, high = float(values.min()), float(values.max())
    return (2.0 * values - low - high) / max(high - low, TINY)
