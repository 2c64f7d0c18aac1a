"""Candidates that the residual hints at: harmonics of any order, narrow bumps, dents in space, functions of two covariates."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np
from scipy.spatial.distance import cdist

from aridcal.engine.corrections.basis import Basis, wendland
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient, Effect
from aridcal.engine.corrections.effect_kind import turns
from aridcal.engine.corrections.joint_kinds import ORDERS
from aridcal.engine.corrections.regional_kind import IN_SPACE, SHIFT, WIDTHS, ball_field
from aridcal.engine.corrections.sights import TARGET
from aridcal.engine.fit.flags import OUTLIER, distance
from aridcal.engine.levels import STILL
from aridcal.engine.numerics import TINY
from aridcal.engine.robot.chain import Robot
from aridcal.engine.search.state import State
from aridcal.system.progress import SILENT, Progress

SCANNED_ORDERS = 800
"""Orders of a joint's error that are looked through, a quarter period over its range apart: gears of up to 200 teeth over
a whole turn, and no peak falls between two of them."""

TABLE_WAVES = 32
"""Work: Waves of which the others are made: about the square root of :data:`SCANNED_ORDERS`, which costs least."""

LOUD_HARMONIC = 30.0
"""Work: Chi-square of a harmonic that is worth a closer look: chance makes one in three million, and thousands are looked
through."""

PEAKS = 2
"""Work: Harmonics of each joint that are tested."""

FINE_ORDERS = 81
"""Work: Orders around a peak among which it is found again, forty times as close."""

WHOLE_NUMBER_TOLERANCE = 0.05
"""An order this near to a whole number is one: shafts turn a whole number of times."""

WINDOWS = (0.12, 0.24, 0.48)
"""Widths [rad] of the windows of a narrow bump: a Gaussian is loudest in 2.8 of its own sigmas, so 0.04 to 0.2 rad. What is
wider, the curves of 72 knots over a turn can follow."""

PLACES_PER_WIDTH = 4
"""Work: Places of a window within its own width that are different from one another."""

LOUD_WINDOW = 20.0
"""Work: Chi-square of one degree at which a window is worth a closer look: chance makes it once in 100,000, and a thousand are
looked through."""

FEWEST_IN_WINDOW = 3
"""Rows of a window at the least: one or two are outliers sooner than a bump."""

KNOTS_IN_WINDOW = 4
"""Knots of a narrow map over the width of its window: 0.7 sigma of a Gaussian bump apart, which they follow to 1 %."""

WINDOWS_AROUND = 1.5
"""Windows on either side of the centre over which a narrow map reaches: four sigmas of a Gaussian bump."""

DENTS = (2.0, 2.8, 4.0, 5.6, 8.0)
"""Work: Radii of a ball in which targets are off, in distances between nodes, half an octave apart: what is wider is a
field."""

LOUD_DENT = 25.0
"""Work: Chi-square of three degrees at which a ball is worth a closer look: chance makes it once in 60,000, and five hundred
are looked through."""

PAIR_DEGREE = 4
"""Work: Of the polynomials in two covariates with which pairs are looked through: bends and waves of two periods."""

LOUDEST = 12
"""Work: Pairs that are tested: each has some fifty columns, and what explains less is seldom the cause."""


def hinted_candidates(state: State, kinds: Collection[str]) -> list[Effect]:
    """Candidates of some kinds that are tried only where the residual hints at them."""
    sources = {"joint_harmonic": harmonics, "joint_map": narrow_maps, "residual_field": dents}
    return [effect for kind, source in sources.items() if kind in kinds for effect in source(state)]


def harmonics(state: State) -> list[Effect]:
    r"""Harmonics of any order that the residual hints at: a periodogram over each joint's reading.

    Each row asks for a turn of the joint, with weight w; the power of order k is chi-square with two degrees of freedom,

    .. math:: P(k) = 2 \left| \sum_n p_n e^{i k q_n} \right|^2 / \sum_n w_n

    with p the row's pull (weight times the turn that it asks for), its mean taken off (Lomb 1976,
    doi:10.1007/BF00648343).
    """
    harmonics_of_joints = []
    joints = state.model.joints
    count = SCANNED_ORDERS * len(joints)
    for name in joints:
        q, pull, weight = _turns_of_joint(state, name, state.residual, state.used)
        orders = _loud_orders(q, pull, float(weight.sum())) if np.ptp(q) >= STILL and weight.any() else []
        for order in orders:
            usual = order in ORDERS  # tried anyway
            wave = turns(name, "axis", name, order)
            harmonics_of_joints.append(Effect("joint_harmonic", name, wave, (order,), looked=1 if usual else count))
    return harmonics_of_joints


def narrow_maps(state: State) -> list[Effect]:
    r"""Narrow bumps of a joint's error curve that the residual hints at: a window slid over each joint's reading.

    With p and w as in :func:`harmonics`, a window of rows that ask for the same turn has

    .. math:: \chi^2_1 = \Big( \sum_n p_n \Big)^2 \Big/ \sum_n w_n

    The candidate is a smooth function about the loudest window alone: over the rest of the range it costs nothing.
    """
    clipped = _clipped(state)
    every = np.ones(len(clipped), dtype=bool)
    places = {name: _turns_of_joint(state, name, clipped, every) for name in state.model.joints}
    count = sum(int(PLACES_PER_WIDTH * np.ptp(q) / width) for q, _, _ in places.values() for width in WINDOWS)
    maps = []
    for name, (q, pull, weight) in places.items():
        chi_square, centre, width = _loudest_window(q, pull, weight)
        if chi_square > LOUD_WINDOW:
            step = width / KNOTS_IN_WINDOW
            reach = round(WINDOWS_AROUND * KNOTS_IN_WINDOW)
            knots = [round(centre + k * step, 9) for k in range(-reach, reach + 1)]
            curve = tuple(Coefficient(name, "axis", Basis("bump", (name,), (knot, step))) for knot in knots)
            maps.append(Effect("joint_map", name, curve, smooth=True, looked=count))
    return maps


def dents(state: State) -> list[Effect]:
    r"""Places around which the residual hints that targets are off: balls of several sizes, tried at all places.

    With p and w as in :func:`harmonics`, here for a shift of the target, and :math:`\varphi` the function about a place,

    .. math:: \chi^2_3 = \Big| \sum_n \varphi_n p_n \Big|^2 \Big/ \sum_n \varphi_n^2 w_n

    One shift at one place has three coefficients; a field over all places would have to be as large everywhere.
    """
    model, slots = state.model, [("world_base", component) for component in SHIFT]
    if not (set(TARGET) <= set(model.table) and set(slots) <= set(model.slots)):
        return []
    places = np.column_stack([model.table[name] for name in TARGET])
    field = ball_field(places)
    if not field:
        return []
    G = np.stack([model.slot_columns(*slot) for slot in slots], axis=2) / state.sigma[:, None]
    pull = np.einsum("nms,nm->ns", G, _clipped(state) / state.sigma)
    weight = np.einsum("nms,nms->n", G, G) / len(slots)
    pull = pull - weight[:, None] * pull.sum(axis=0) / max(weight.sum(), TINY)
    centres = np.array([basis.numbers[:3] for basis in field])
    apart = cdist(centres, places)
    radii = [field[0].numbers[3] * width / WIDTHS[0] for width in DENTS]
    best, basis = LOUD_DENT, None
    for radius in radii:
        shape = wendland(apart / radius)
        chi_square = np.sum((shape @ pull) ** 2, axis=1) / np.maximum(shape**2 @ weight, TINY)
        chi_square[np.sum(apart < 0.5 * radius, axis=1) < FEWEST_IN_WINDOW] = 0.0
        k = int(np.argmax(chi_square))
        if chi_square[k] > best:
            best = float(chi_square[k])
            basis = Basis("ball", TARGET, (*centres[k].tolist(), round(radius, 6)))
    if basis is None:
        return []
    shift = tuple(Coefficient(*slot, basis) for slot in slots)
    return [Effect("residual_field", "world_base", shift, by=IN_SPACE, looked=len(centres) * len(radii))]


def _clipped(state: State) -> np.ndarray:
    """Residuals, shape (N, m), those of flagged rows cut to the limit of flags: they may be what an effect explains."""
    far = distance(state.residual, state.solution.sigma, state.channels)
    return np.asarray(state.residual * np.minimum(1.0, OUTLIER / np.maximum(far, TINY))[:, None])


def _turns_of_joint(
    state: State, joint: str, residual: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A joint's readings in some rows, and the turn that explains each row's residual, as pull and weight, shape (n,) each.

    The mean of the turns is taken off: it belongs to the constants.
    """
    model = state.model
    q = model.table[joint][rows]
    if (joint, "axis") not in model.slot_index:
        return q, np.zeros(len(q)), np.zeros(len(q))
    column = model.slot_columns(joint, "axis")[rows] / state.sigma
    weight, pull = np.sum(column**2, axis=1), np.sum(column * residual[rows] / state.sigma, axis=1)
    return q, pull - weight * pull.sum() / max(weight.sum(), TINY), weight


def _loudest_window(q: np.ndarray, pull: np.ndarray, weight: np.ndarray) -> tuple[float, float, float]:
    """Chi-square, centre and width of the window whose rows agree most on a turn."""
    order = np.argsort(q)
    q = q[order]
    pulls, weights = (np.concatenate([[0.0], np.cumsum(values[order])]) for values in (pull, weight))
    best = (0.0, 0.0, WINDOWS[0])
    for width in WINDOWS:
        first, last = np.arange(len(q)), np.searchsorted(q, q + width, side="right")
        chi_square = (pulls[last] - pulls[first]) ** 2 / np.maximum(weights[last] - weights[first], TINY)
        chi_square[last - first < FEWEST_IN_WINDOW] = 0.0
        k = int(np.argmax(chi_square))
        if chi_square[k] > best[0]:
            best = float(chi_square[k]), float(q[k] + q[last[k] - 1]) / 2, width
    return best


def _loud_orders(q: np.ndarray, pull: np.ndarray, weight: float) -> list[float]:
    """Orders at which the periodogram of the rows' pulls has its highest peaks, the highest first."""
    step = np.pi / (2 * np.ptp(q))
    orders = np.arange(1, SCANNED_ORDERS + 1) * step
    # The wave of order a + b is the product of those of a and b: a table of a few dozen waves makes all, and its waves
    # are powers of the first. Products cost a fifth of sines and cosines.
    fine = np.cumprod(np.tile(np.exp(1j * step * q), (TABLE_WAVES, 1)), axis=0)
    coarse = np.ones((len(range(0, SCANNED_ORDERS, TABLE_WAVES)), len(q)), dtype=complex)
    np.cumprod(np.tile(fine[-1], (len(coarse) - 1, 1)), axis=0, out=coarse[1:])
    power = 2.0 * np.abs((coarse * pull) @ fine.T).ravel()[:SCANNED_ORDERS] ** 2 / weight
    peaks = np.flatnonzero((power > np.roll(power, 1)) & (power > np.roll(power, -1)) & (power > LOUD_HARMONIC))
    loud = []
    for peak in peaks[np.argsort(-power[peaks])][:PEAKS]:
        close = orders[peak] + np.linspace(-1, 1, FINE_ORDERS) * step
        waves = np.empty((FINE_ORDERS, len(q)), dtype=complex)
        waves[0], waves[1:] = np.exp(1j * close[0] * q), np.exp(1j * (close[1] - close[0]) * q)
        order = float(close[np.argmax(np.abs(np.cumprod(waves, axis=0) @ pull))])
        whole = round(order)
        loud.append(float(whole) if abs(order - whole) < WHOLE_NUMBER_TOLERANCE else round(order, 3))
    return loud


def pairs(
    state: State, covariates: Sequence[str], robot: Robot, progress: Progress = SILENT
) -> tuple[list[tuple[str, str, tuple[str, str]]], int]:
    """Slots and pairs of covariates at which a smooth function would explain most, and the number of all such places.

    The residual is pulled back to each slot as the motion that would explain it row by row, and that is projected on
    products of Legendre polynomials in two covariates. A motion depends on no joint of another limb.
    """
    model, in_use = state.model, state.used
    G = model.G[in_use]
    G /= state.sigma[:, None]
    weight = np.einsum("nms,nms->ns", G, G)
    pull = np.einsum("nms,nm->ns", G, state.residual[in_use] / state.sigma) / np.sqrt(np.maximum(weight, TINY))
    pull[:, weight.sum(0) <= 0.0] = 0.0
    pull = np.ascontiguousarray(pull.T)  # slot by slot, as slots are picked from it
    frames = [(s, slot) for s, slot in enumerate(model.slots) if slot[1] in FRAME_COMPONENTS]
    places = []
    waves = {
        of: np.polynomial.legendre.legvander(_scaled_to_one(model.table[of][in_use]), PAIR_DEGREE) for of in covariates
    }
    every = [of for of in combinations(covariates, 2) if robot.on_one_limb(*of)]
    for a, b in progress.over(every, "pairs"):
        products = (waves[a][:, :, None] * waves[b][:, None]).reshape(pull.shape[1], -1)
        there = {where for where in dict(model.slots) if robot.on_one_limb(where, a, b)}
        near = [(s, slot) for s, slot in frames if slot[0] in there]
        along = pull[[s for s, _ in near]] @ np.linalg.qr(products)[0]
        explained = np.sum(along**2, axis=1).tolist()
        places += [(e, (where, component, (a, b))) for e, (_, (where, component)) in zip(explained, near, strict=True)]
    places.sort(key=lambda pair: -pair[0])
    return [place for _, place in places[:LOUDEST]], len(places)


def _scaled_to_one(values: np.ndarray) -> np.ndarray:
    """A covariate scaled to -1 to 1."""
    low, high = float(values.min()), float(values.max())
    return (2.0 * values - low - high) / max(high - low, TINY)
