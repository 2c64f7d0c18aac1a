"""What the residual hints at, before anything is tested: harmonics of any order, functions of two covariates."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from aridcal.bench import Bench, State
from aridcal.catalogue import turns
from aridcal.effects import FRAME_COMPONENTS, Effect

SCANNED = 800  # orders of a joint's error that are looked through, a quarter period over its range apart
LOUD = 30.0  # chi-square of a harmonic that is worth a closer look
DEGREE = 4  # of the polynomials in two covariates with which pairs are looked through
LOUDEST = 12  # pairs that are tested


def harmonics(bench: Bench, state: State) -> list[Effect]:
    """Harmonics of any order that the residual hints at: a periodogram over each joint's reading."""
    sigma = np.repeat([state.solution.sigma.position, state.solution.sigma.rotation], 3)[: bench.r.shape[1]]
    used = state.weight > 0.5
    found = []
    for name in bench.own:
        q = bench.table[name][used]
        if (name, "axis") not in bench.slots or np.ptp(q) < 1e-3:
            continue
        place = bench.G[used][:, :, bench.slots.index((name, "axis"))] / sigma
        weight, pull = np.sum(place**2, axis=1), np.sum(place * state.residual[used] / sigma, axis=1)
        pull = pull - weight * pull.sum() / max(weight.sum(), 1e-300)
        orders = np.arange(1, SCANNED + 1) * np.pi / (2 * np.ptp(q))

        def power(
            k: np.ndarray, q: np.ndarray = q, pull: np.ndarray = pull, w: float = float(weight.sum())
        ) -> np.ndarray:
            return np.asarray(2.0 * np.abs(np.exp(1j * np.outer(k, q)) @ pull) ** 2 / w)

        seen = power(orders)
        peaks = np.flatnonzero((seen > np.roll(seen, 1)) & (seen > np.roll(seen, -1)) & (seen > LOUD))
        for peak in peaks[np.argsort(-seen[peaks])][:2]:
            fine = orders[peak] + np.linspace(-1, 1, 81) * (orders[1] - orders[0])
            order = float(fine[np.argmax(power(fine))])
            whole = round(order)
            order = float(whole) if abs(order - whole) < 0.05 else round(order, 3)
            found.append(Effect("joint_harmonic", name, turns(name, "axis", name, order), (order,)))
    return found


def pairs(bench: Bench, state: State, covariates: Sequence[str]) -> tuple[list[tuple[str, str, tuple[str, str]]], int]:
    """Where and of which two covariates a smooth function would explain most, and how many were looked at.

    The residual is pulled back to each motion of the bench as the motion that would explain it row by row, and that is
    projected on polynomials in two covariates.
    """
    used = state.weight > 0.5
    sigma = np.repeat([state.solution.sigma.position, state.solution.sigma.rotation], 3)[: bench.r.shape[1]]
    G = bench.G[used] / sigma[:, None]
    weight = np.einsum("nms,nms->ns", G, G)
    pull = np.einsum("nms,nm->ns", G, state.residual[used] / sigma) / np.sqrt(np.maximum(weight, 1e-300))
    pull[:, weight.sum(0) <= 0.0] = 0.0
    found = []
    for a, b in combinations(covariates, 2):
        waves = [np.polynomial.legendre.legvander(_spread(bench.table[name][used]), DEGREE) for name in (a, b)]
        columns = np.einsum("ni,nj->nij", *waves).reshape(len(pull), -1)
        seen = np.sum((np.linalg.qr(columns)[0].T @ pull) ** 2, axis=0)
        found += [(float(seen[s]), (where, component, (a, b))) for s, (where, component) in enumerate(bench.slots)
                  if component in FRAME_COMPONENTS]  # fmt: skip
    found.sort(key=lambda pair: -pair[0])
    return [place for _, place in found[:LOUDEST]], len(found)


def _spread(values: np.ndarray) -> np.ndarray:
    """A covariate brought to -1 to 1."""
    low, high = float(values.min()), float(values.max())
    return (2.0 * values - low - high) / max(high - low, 1e-300)
