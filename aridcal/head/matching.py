"""Which blob is which fiducial of which square (the report's FID, steps 2 and 3, made robust).

Blobs on the sonars' plane are a flat map to scale, so that only a turn and a shift are unknown. Each is proposed by a centre
fiducial (its long side gives the turn up to 180 degrees) or else by two blobs at the right distance, and the proposal that
explains most blobs wins. The corner marker decides between a square and the same upside down; squares stacked along y
look alike, and the square is by definition the one nearest the optical axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aridcal.errors import AridcalError
from aridcal.head.blobs import Blobs
from aridcal.head.square import CENTRE_FIDUCIAL, CENTRES, CORNER_MARKER, INCH, N_FIDUCIALS, ONE_SQUARE, SIDE, Layout

NEAR, CLOSE = 0.0035, 0.0022  # [m] a blob may be from its place, before and after the turn is refined
AXIS_TIE = 0.002  # [m] by which one square must be nearer the optical axis than the others
SPARE_MARK = 2  # a mark too many says more than one that is not seen
CLEAR_LEAD = 3  # marks by which a proposal that explains more needs no further comparison
SAME_TURN, SAME_SHIFT = 0.2, 0.01  # [rad], [m] within which two proposals are one
MAX_PROPOSALS = 60
MAX_SLANT = 0.35  # sine by which a centre fiducial's long side may seem to be turned
_CENTRES = CENTRES @ [1, 1j]


class NotMeasured(AridcalError):
    """An image in which no square can be measured; the message says why."""


@dataclass(frozen=True)
class Match:
    """A proposal: place on the plane = turn * place on the square + shift.

    Attributes:
        turn: Of modulus 1.
        shift: [m]
        pairs: Index into the layout and index of the blob, shape (K, 2).
    """

    turn: complex
    shift: complex
    pairs: np.ndarray


def match(blobs: Blobs, layout: Layout, blank: Callable[[np.ndarray, np.ndarray, complex], np.ndarray]) -> Match:
    """Find out which blobs are which fiducials.

    Args:
        blobs: Candidates.
        layout: Fiducials that may be in view, those of the square nearest the optical axis first.
        blank: Tells from places on the plane where small fiducials are seen, (K,), at which others, (M,), there plainly is none.

    Returns:
        The proposal that explains most blobs, less what speaks against it.

    Raises:
        NotMeasured: Too few blobs, two proposals are as good, or nothing tells how the square is turned.
    """
    matches: list[Match] = []
    for propose in (_from_centres, _from_pairs):
        for turn, shift in propose(blobs):
            m = None if _among(turn, shift, matches) else _refined(turn, shift, blobs, layout)
            if m is not None and spans_plane(layout.centres[m.pairs[:, 0]]) and not _among(m.turn, m.shift, matches):
                matches.append(m)
        if matches:
            break
    else:
        raise NotMeasured(f"no square found among {len(blobs.places)} marks of a fiducial's size and shape")
    most = max(len(m.pairs) for m in matches)
    rivals = [m for m in matches if len(m.pairs) > most - CLEAR_LEAD]
    against = [_contradictions(m, blobs, layout, blank) for m in rivals]
    scores = [len(m.pairs) - n for m, n in zip(rivals, against, strict=True)]
    tied = [k for k, score in enumerate(scores) if score == max(scores)]
    best = rivals[tied[0]]
    if len(tied) > 1:
        if abs(best.turn + rivals[tied[1]].turn) < SAME_TURN:
            raise NotMeasured("the corner marker is not seen: the square may be upside down")
        raise NotMeasured("the marks fit the square in more than one way")
    if not np.any(np.isin(layout.fiducial[best.pairs[:, 0]], (CORNER_MARKER, CENTRE_FIDUCIAL))):
        raise NotMeasured("neither a centre fiducial nor a corner marker is seen: they tell how the square is turned")
    if against[tied[0]] > len(best.pairs) - 2:
        raise NotMeasured("too much on the square is not as it should be: it is something else, or dirty")
    return best


def _contradictions(
    m: Match, blobs: Blobs, layout: Layout, blank: Callable[[np.ndarray, np.ndarray, complex], np.ndarray]
) -> int:
    """Count what speaks against a match: bare paper where fiducials should be, and more marks on the square than it has."""
    missed = np.setdiff1d(np.arange(len(layout)), m.pairs[:, 0])
    places = m.turn * (layout.centres[missed, :2] @ [1, 1j]) + m.shift
    spare = (np.delete(blobs.places, m.pairs[:, 1]) - m.shift) / m.turn
    on_square = np.maximum(np.abs(spare.real), np.abs(spare.imag)) < SIDE / 2
    small = blobs.places[m.pairs[:, 1]][~layout.is_centre[m.pairs[:, 0]]]
    return int(blank(small, places, m.turn).sum() + SPARE_MARK * on_square.sum())


def _among(turn: complex, shift: complex, matches: list[Match]) -> bool:
    return any(abs(turn - m.turn) < SAME_TURN and abs(shift - m.shift) < SAME_SHIFT for m in matches)


def _from_centres(blobs: Blobs) -> list[tuple[complex, complex]]:
    """Propose, for each centre fiducial, its square and those beside it, whose own centre may be hidden."""
    proposals = []
    for k in np.flatnonzero(blobs.is_centre):
        for sign in (1, -1):
            turn, shift = sign * np.exp(1j * (blobs.angles[k] - np.pi / 2)), blobs.places[k]
            pairs = _pairs(turn, shift, ONE_SQUARE, blobs, NEAR)
            if len(pairs) > 1:  # the turn is to be exact enough for the squares beside
                turn, shift = _rigid(_CENTRES[pairs[:, 0]], blobs.places[pairs[:, 1]])
            proposals += [(turn, shift + step * SIDE * 1j * turn) for step in (0, 1, -1)]
    return proposals


def _from_pairs(blobs: Blobs) -> list[tuple[complex, complex]]:
    """Propose squares from two blobs at the distance of two fiducials; only those that explain at least three blobs."""
    i, j = np.nonzero(~np.eye(len(blobs.places), dtype=bool))
    a, b = np.nonzero(~np.eye(N_FIDUCIALS, dtype=bool))
    seen, known = blobs.places[j] - blobs.places[i], _CENTRES[b] - _CENTRES[a]
    p, q = np.nonzero(np.abs(np.abs(seen)[:, None] - np.abs(known)) < CLOSE)
    turn = seen[p] / known[q]
    turn /= np.abs(turn)
    shift = blobs.places[i[p]] - turn * _CENTRES[a[q]]
    if len(turn) > 20_000:
        return []
    distance = np.abs(turn[:, None, None] * _CENTRES[:, None] + shift[:, None, None] - blobs.places)
    found = np.any((distance < CLOSE) & (ONE_SQUARE.is_centre[:, None] == blobs.is_centre), axis=2).sum(axis=1)
    order = np.argsort(-found, kind="stable")
    rough = np.column_stack([turn.real / SAME_TURN, turn.imag / SAME_TURN, shift.real / CLOSE, shift.imag / CLOSE])
    _, first = np.unique(np.rint(rough[order]), axis=0, return_index=True)
    order = order[np.sort(first)][:MAX_PROPOSALS]
    return [(turn[k], shift[k]) for k in order if found[k] >= 3]


def _refined(turn: complex, shift: complex, blobs: Blobs, layout: Layout) -> Match | None:
    """Match a proposal and refine it; None if another square would be nearer the optical axis, or too little is matched."""
    here = layout.centres[:, :2] @ [1, 1j]
    middles = here[layout.is_centre]  # of the squares: the own one first
    axis = -shift / turn  # where the optical axis meets the square
    others = np.append(middles[1:], 1j * np.copysign(SIDE, axis.imag))  # the square beside need not be listed
    if np.any(np.abs(axis - others) < np.abs(axis) + AXIS_TIE - 2 * NEAR):
        return None
    for part, tolerance in ((layout[np.arange(N_FIDUCIALS)], NEAR), (layout, CLOSE), (layout, CLOSE)):
        pairs = _pairs(turn, shift, part, blobs, tolerance)
        if len(pairs) < 2:
            return None
        turn, shift = _rigid(here[pairs[:, 0]], blobs.places[pairs[:, 1]])
    axis = -shift / turn
    if np.any(np.abs(axis - others) < np.abs(axis) + AXIS_TIE):
        return None
    return Match(turn, shift, pairs)


def _pairs(turn: complex, shift: complex, layout: Layout, blobs: Blobs, tolerance: float) -> np.ndarray:
    """Pair fiducials and blobs of the same kind that are each other's nearest, shape (K, 2)."""
    if len(blobs.places) == 0:
        return np.zeros((0, 2), dtype=int)
    places = turn * (layout.centres[:, :2] @ [1, 1j]) + shift
    distance = np.abs(places[:, None] - blobs.places)
    upright = turn * (layout.axes[:, 1, :2] @ [1, 1j])
    slant = np.abs(np.imag(np.exp(1j * blobs.angles) * np.conj(upright[:, None])))
    alike = np.where(layout.is_centre[:, None], blobs.is_centre & (slant < MAX_SLANT), ~blobs.is_centre)
    distance[~alike] = np.inf
    nearest = np.argmin(distance, axis=1)
    mutual = np.argmin(distance, axis=0)[nearest] == np.arange(len(places))
    mine = np.flatnonzero(mutual & (distance[np.arange(len(places)), nearest] < tolerance))
    return np.column_stack([mine, nearest[mine]])


def _rigid(model: np.ndarray, seen: np.ndarray) -> tuple[complex, complex]:
    """Fit seen = turn * model + shift by least squares: Kabsch in the plane, in one complex number."""
    turn = np.vdot(model - model.mean(), seen - seen.mean())
    turn = turn / abs(turn) if abs(turn) > 0 else 1.0 + 0j
    return turn, seen.mean() - turn * model.mean()


def spans_plane(points: np.ndarray) -> bool:
    """Tell whether there are at least three points, shape (M, 3), [m], and not all on one line."""
    if len(points) < 3:
        return False
    return bool(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] > 0.3 * INCH)
