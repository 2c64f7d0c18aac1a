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
from aridcal.head.square import CENTRES, INCH, N_FIDUCIALS, SIDE, Layout

NEAR, CLOSE = 0.0035, 0.0022  # [m] a blob may be from its place, before and after the turn is refined
AXIS_TIE = 0.002  # [m] by which one square must be nearer the optical axis than the others
SAME_TURN, SAME_SHIFT = 0.2, 0.01  # [rad], [m] within which two proposals are one
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


def match(blobs: Blobs, layout: Layout, blank: Callable[[np.ndarray, complex], np.ndarray]) -> Match:
    """Find out which blobs are which fiducials.

    Args:
        blobs: Candidates.
        layout: Fiducials that may be in view, those of the square nearest the optical axis first.
        blank: Tells at which places on the plane, (M,), there plainly is no fiducial of a square so turned.

    Returns:
        The one proposal that explains more blobs than any other.

    Raises:
        NotMeasured: Too few blobs, or two proposals explain as many.
    """
    for proposals in (_from_centres(blobs), _from_pairs(blobs)):
        refined = [_refined(turn, shift, blobs, layout) for turn, shift in proposals]
        matches = [m for m in refined if m is not None and spans_plane(layout.centres[m.pairs[:, 0]])]
        if matches:
            break
    else:
        raise NotMeasured(f"no square found among {len(blobs.places)} marks of a fiducial's size and shape")
    most = max(len(m.pairs) for m in matches)
    tied = _distinct([m for m in matches if len(m.pairs) == most])
    if len(tied) > 1:
        places = layout.centres[:, :2] @ [1, 1j]
        missed = [np.setdiff1d(np.arange(len(layout)), m.pairs[:, 0]) for m in tied]
        against = [int(blank(m.turn * places[k] + m.shift, m.turn).sum()) for m, k in zip(tied, missed, strict=True)]
        tied = [m for m, n in zip(tied, against, strict=True) if n == min(against)]
    if len(tied) == 1:
        spare = np.delete(blobs.places, tied[0].pairs[:, 1])
        if np.sum(np.abs((spare - tied[0].shift) / tied[0].turn) < SIDE / 2) > most:
            raise NotMeasured("more marks on the square than fiducials: it is something else")
        return tied[0]
    if abs(tied[0].turn + tied[1].turn) < SAME_TURN:
        raise NotMeasured("the corner marker is not seen: the square may be upside down")
    raise NotMeasured("the marks fit the square in more than one way")


def _distinct(matches: list[Match]) -> list[Match]:
    distinct: list[Match] = []
    for m in matches:
        if all(abs(m.turn - d.turn) > SAME_TURN or abs(m.shift - d.shift) > SAME_SHIFT for d in distinct):
            distinct.append(m)
    return distinct


def _from_centres(blobs: Blobs) -> list[tuple[complex, complex]]:
    """Propose, for each centre fiducial, its square and those beside it, whose own centre may be hidden."""
    turns = [
        (sign * np.exp(1j * (blobs.angles[k] - np.pi / 2)), blobs.places[k])
        for k in np.flatnonzero(blobs.is_centre)
        for sign in (1, -1)
    ]
    return [(turn, place + step * SIDE * 1j * turn) for turn, place in turns for step in (0, 1, -1)]


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
    found = np.any((distance < CLOSE) & _same_kind(np.arange(N_FIDUCIALS) == 3, blobs), axis=2).sum(axis=1)
    order = np.argsort(-found, kind="stable")[:40]
    return [(turn[k], shift[k]) for k in order if found[k] >= 3]


def _refined(turn: complex, shift: complex, blobs: Blobs, layout: Layout) -> Match | None:
    """Match a proposal and refine it; None if another square would be nearer the optical axis, or too little is matched."""
    here = layout.centres[:, :2] @ [1, 1j]
    middles = here[layout.is_centre]  # of the squares: the own one first
    axis = -shift / turn  # where the optical axis meets the square
    others = np.append(middles[1:], 1j * np.copysign(SIDE, axis.imag))  # the square beside need not be listed
    if np.any(np.abs(axis - others) < np.abs(axis) + AXIS_TIE - 2 * NEAR):
        return None
    near = slice(N_FIDUCIALS)
    for part, tolerance in ((near, NEAR), (slice(None), CLOSE), (slice(None), CLOSE)):
        pairs = _pairs(turn * here[part] + shift, layout.is_centre[part], blobs, tolerance)
        if len(pairs) < 2:
            return None
        turn, shift = _rigid(here[pairs[:, 0]], blobs.places[pairs[:, 1]])
    axis = -shift / turn
    if np.any(np.abs(axis - others) < np.abs(axis) + AXIS_TIE):
        return None
    return Match(turn, shift, pairs)


def _pairs(places: np.ndarray, is_centre: np.ndarray, blobs: Blobs, tolerance: float) -> np.ndarray:
    distance = np.abs(places[:, None] - blobs.places)
    distance[~_same_kind(is_centre, blobs)] = np.inf
    if distance.size == 0:
        return np.zeros((0, 2), dtype=int)
    nearest = np.argmin(distance, axis=1)
    mutual = np.argmin(distance, axis=0)[nearest] == np.arange(len(places))
    mine = np.flatnonzero(mutual & (distance[np.arange(len(places)), nearest] < tolerance))
    return np.column_stack([mine, nearest[mine]])


def _same_kind(is_centre: np.ndarray, blobs: Blobs) -> np.ndarray:
    return is_centre[:, None] == blobs.is_centre


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
