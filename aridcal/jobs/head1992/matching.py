"""Which blob is which fiducial of which square (Doty's FID, steps 2 and 3, made robust).

Blobs on the sonars' plane are a flat map to scale, so that only a turn and a shift are unknown. Each is proposed by a centre
fiducial (its long side gives the turn up to 180 degrees) or else by two blobs at the right distance, and the proposal that
explains most blobs wins. The corner marker decides between a square and the same upside down; squares stacked along y
look alike, and the square is by definition the one nearest the optical axis.

Places are complex numbers x + i y, [m], on the sonars' plane and on the square alike. A turn is a complex number of modulus 1:
place on the plane = turn * place on the square + shift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from aridcal.jobs.head1992.blobs import Blobs
from aridcal.jobs.head1992.square import (
    CENTRE_FIDUCIAL,
    CORNER_MARKER,
    FIDUCIAL_CENTRES,
    INCH,
    N_FIDUCIALS,
    ONE_SQUARE,
    SQUARE_SIDE,
    FiducialLayout,
)
from aridcal.system.errors import AridcalError

# [m] that a blob may be from its place before and after the turn is refined: about half and a third of a fiducial's
# side.
NEAR, CLOSE = 0.0035, 0.0022

# [m] by which one square must be nearer the optical axis than the others: more than the sonars' plane is wrong by.
AXIS_TIE = 0.002

# A mark too many says more than one that is not seen: dirt hides fiducials, but prints none.
SPARE_MARK = 2

# Marks by which a proposal that explains more needs no further comparison: more than one mark too many outweighs.
CLEAR_LEAD = 3

# [rad], [m] within which two proposals are one: far less than between two turns or two squares that look alike.
SAME_TURN, SAME_SHIFT = 0.2, 0.01

# Tried from pairs of blobs, those that explain most first.
MAX_PROPOSALS = 60

# Pairs of blobs at the distance of two fiducials: more of them are a regular pattern, not a square.
MAX_PAIRS = 20_000

# Blobs that a proposal from two of them must explain: any two blobs explain themselves.
LEAST_EXPLAINED = 3

# Sine by which a centre fiducial's long side may seem to be turned: 20 degrees, for blobs of about ten pixels.
MAX_SLANT = 0.35

# [m] Second singular value of places that are not on one line: rather more than a fiducial is wide.
LEAST_WIDTH = 0.3 * INCH

# Of p1 to p6 on the square, shape (6,).
_CENTRES = FIDUCIAL_CENTRES @ [1, 1j]

# Tells from places on the plane where small fiducials are seen, (K,), at which others, (M,), there plainly is none.
Blank = Callable[[np.ndarray, np.ndarray, complex], np.ndarray]


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


def match(blobs: Blobs, layout: FiducialLayout, blank: Blank) -> Match:
    """Match blobs to fiducials.

    A proposal's score is the number of fiducials that it finds less its contradictions, see ``_contradictions``.

    Args:
        blobs: Candidates.
        layout: Fiducials that may be in view, those of the square nearest the optical axis first.
        blank: Where there plainly is no fiducial.

    Returns:
        The proposal with the highest score.

    Raises:
        NotMeasured: Too few blobs, two proposals are as good, or nothing tells how the square is turned.
    """
    matches = _matches(_from_centres(blobs), blobs, layout) or _matches(_from_pairs(blobs), blobs, layout)
    if not matches:
        raise NotMeasured(f"no square found among {len(blobs.places)} marks of a fiducial's size and shape")
    most = max(len(m.pairs) for m in matches)
    rivals = [m for m in matches if len(m.pairs) > most - CLEAR_LEAD]
    against = [_contradictions(m, blobs, layout, blank) for m in rivals]
    scores = [len(m.pairs) - n for m, n in zip(rivals, against, strict=True)]
    first, *others = (k for k, score in enumerate(scores) if score == max(scores))
    best = rivals[first]
    if others:
        upside_down = abs(best.turn + rivals[others[0]].turn) < SAME_TURN
        if upside_down:
            raise NotMeasured("the corner marker is not seen: the square may be upside down")
        raise NotMeasured("the marks fit the square in more than one way")
    if not np.any(np.isin(layout.fiducial[best.pairs[:, 0]], (CORNER_MARKER, CENTRE_FIDUCIAL))):
        raise NotMeasured("neither a centre fiducial nor a corner marker is seen: the turn of the square is ambiguous")
    if against[first] > len(best.pairs) - 2:
        raise NotMeasured("too many fiducials are missing or too many marks are added: it is another target, or dirty")
    return best


def _matches(proposals: Iterable[tuple[complex, complex]], blobs: Blobs, layout: FiducialLayout) -> list[Match]:
    """Refined proposals of turn and shift, without those that lead to an earlier match or to too few pairs."""
    matches: list[Match] = []
    for turn, shift in proposals:
        if _among(turn, shift, matches):
            continue
        m = _refined(turn, shift, blobs, layout)
        if m is None or _among(m.turn, m.shift, matches):
            continue
        if spans_plane(layout.centres[m.pairs[:, 0]]):
            matches.append(m)
    return matches


def _contradictions(m: Match, blobs: Blobs, layout: FiducialLayout, blank: Blank) -> int:
    """Number of contradictions of a match: bare paper where fiducials should be, and more marks on the square than it has."""
    fiducials, matched_blobs = m.pairs.T
    missing = np.setdiff1d(np.arange(len(layout)), fiducials)
    expected = m.turn * _places(layout)[missing] + m.shift
    small = blobs.places[matched_blobs][~layout.is_centre[fiducials]]
    blank_places = blank(small, expected, m.turn)
    spare = (np.delete(blobs.places, matched_blobs) - m.shift) / m.turn
    on_square = np.maximum(np.abs(spare.real), np.abs(spare.imag)) < SQUARE_SIDE / 2
    return int(blank_places.sum() + SPARE_MARK * on_square.sum())


def _places(layout: FiducialLayout) -> np.ndarray:
    """Return the centres of fiducials on the square's plane, shape (M,)."""
    return layout.centres[:, :2] @ [1, 1j]


def _among(turn: complex, shift: complex, matches: list[Match]) -> bool:
    """True of a proposal that is one of the matches."""
    return any(abs(turn - m.turn) < SAME_TURN and abs(shift - m.shift) < SAME_SHIFT for m in matches)


def _from_centres(blobs: Blobs) -> list[tuple[complex, complex]]:
    """Propose, for each centre fiducial, its square and those beside it, whose own centre may be hidden."""
    proposals = []
    for k in np.flatnonzero(blobs.is_centre):
        along_y = np.exp(1j * (blobs.angles[k] - np.pi / 2))  # the long side runs along the square's y
        for turn in (along_y, -along_y):
            shift = blobs.places[k]
            pairs = _pairs(turn, shift, ONE_SQUARE, blobs, NEAR)
            if len(pairs) > 1:  # the turn is to be exact enough for the squares beside
                turn, shift = _rigid(_CENTRES[pairs[:, 0]], blobs.places[pairs[:, 1]])
            beside = SQUARE_SIDE * 1j * turn
            proposals += [(turn, shift), (turn, shift + beside), (turn, shift - beside)]
    return proposals


def _from_pairs(blobs: Blobs) -> list[tuple[complex, complex]]:
    """Propose squares from two blobs at the distance of two fiducials; only those that explain at least three blobs.

    Two blobs z_i, z_j seen as fiducials c_a, c_b give turn = (z_j - z_i) / (c_b - c_a), made of modulus 1, and
    shift = z_i - turn c_a.
    """
    i, j = np.nonzero(~np.eye(len(blobs.places), dtype=bool))
    a, b = np.nonzero(~np.eye(N_FIDUCIALS, dtype=bool))
    blob_steps = blobs.places[j] - blobs.places[i]
    model_steps = _CENTRES[b] - _CENTRES[a]
    too_long = np.abs(blob_steps)[:, None] - np.abs(model_steps)
    p, q = np.nonzero(np.abs(too_long) < CLOSE)
    if len(p) > MAX_PAIRS:
        return []
    turn = blob_steps[p] / model_steps[q]
    turn /= np.abs(turn)
    shift = blobs.places[i[p]] - turn * _CENTRES[a[q]]
    explained = _explained(turn, shift, blobs)
    order = np.argsort(-explained, kind="stable")
    order = order[_first_of_each(turn[order], shift[order])][:MAX_PROPOSALS]
    return [(turn[k], shift[k]) for k in order if explained[k] >= LEAST_EXPLAINED]


def _explained(turn: np.ndarray, shift: np.ndarray, blobs: Blobs) -> np.ndarray:
    """Count the fiducials of one square that each of K proposals finds a blob of its kind for, shape (K,)."""
    places = turn[:, None] * _CENTRES + shift[:, None]
    distance = np.abs(places[..., None] - blobs.places)  # (K, 6, B)
    alike = ONE_SQUARE.is_centre[:, None] == blobs.is_centre
    explained = np.any((distance < CLOSE) & alike, axis=2)
    return np.asarray(explained.sum(axis=1))


def _first_of_each(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Index the first of proposals that are about the same, in their order."""
    turns = [turn.real / SAME_TURN, turn.imag / SAME_TURN]
    shifts = [shift.real / CLOSE, shift.imag / CLOSE]
    rough = np.rint(np.column_stack([*turns, *shifts]))
    _, first = np.unique(rough, axis=0, return_index=True)
    return np.sort(first)


def _refined(turn: complex, shift: complex, blobs: Blobs, layout: FiducialLayout) -> Match | None:
    """Match a proposal and refine it; None if another square would be nearer the optical axis, or too little is matched.

    The own square alone is matched first, by a rough turn; then all in view, twice, by the turn that this gives.
    """
    centres = _places(layout)
    if not _nearest_the_axis(turn, shift, centres[layout.is_centre], AXIS_TIE - 2 * NEAR):
        return None
    own_square = layout[np.arange(N_FIDUCIALS)]
    for part, tolerance in ((own_square, NEAR), (layout, CLOSE), (layout, CLOSE)):
        pairs = _pairs(turn, shift, part, blobs, tolerance)
        if len(pairs) < 2:
            return None
        turn, shift = _rigid(centres[pairs[:, 0]], blobs.places[pairs[:, 1]])
    if not _nearest_the_axis(turn, shift, centres[layout.is_centre], AXIS_TIE):
        return None
    return Match(turn, shift, pairs)


def _nearest_the_axis(turn: complex, shift: complex, middles: np.ndarray, lead: float) -> bool:
    """Tell whether the own square is nearer the optical axis, which meets the plane at 0, than others by a lead, [m].

    Args:
        turn: Of the proposal.
        shift: Likewise.
        middles: Of the squares, the own one first, shape (S,).
        lead: May be negative.
    """
    axis = -shift / turn  # where the optical axis meets the square
    beside = 1j * np.copysign(SQUARE_SIDE, axis.imag)  # a square that need not be listed
    others = np.append(middles[1:], beside)
    return not np.any(np.abs(axis - others) < np.abs(axis) + lead)


def _pairs(turn: complex, shift: complex, layout: FiducialLayout, blobs: Blobs, tolerance: float) -> np.ndarray:
    """Pair fiducials and blobs of the same kind that are each other's nearest, shape (K, 2)."""
    if len(blobs.places) == 0:
        return np.zeros((0, 2), dtype=int)
    places = turn * _places(layout) + shift
    distance = np.abs(places[:, None] - blobs.places)
    distance[~_alike(turn, layout, blobs)] = np.inf
    all_places = np.arange(len(places))
    nearest = np.argmin(distance, axis=1)
    mutual = np.argmin(distance, axis=0)[nearest] == all_places
    close = distance[all_places, nearest] < tolerance
    matched = np.flatnonzero(mutual & close)
    return np.column_stack([matched, nearest[matched]])


def _alike(turn: complex, layout: FiducialLayout, blobs: Blobs) -> np.ndarray:
    """Tell which blobs are of which fiducials' kind, centre fiducials not slanted, shape (M, B)."""
    upright = turn * (layout.axes[:, 1, :2] @ [1, 1j])
    along = np.exp(1j * blobs.angles)
    slant = np.abs(np.imag(along * np.conj(upright[:, None])))
    as_centre = blobs.is_centre & (slant < MAX_SLANT)
    return np.where(layout.is_centre[:, None], as_centre, ~blobs.is_centre)


def _rigid(model: np.ndarray, places: np.ndarray) -> tuple[complex, complex]:
    """Fit seen = turn * model + shift by least squares: Kabsch in the plane, in one complex number."""
    turn = np.vdot(model - model.mean(), places - places.mean())
    turn = turn / abs(turn) if abs(turn) > 0 else 1.0 + 0j
    return turn, places.mean() - turn * model.mean()


def spans_plane(points: np.ndarray) -> bool:
    """Tell whether there are at least three points, shape (M, 3), [m], and not all on one line."""
    if len(points) < 3:
        return False
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[1] > LEAST_WIDTH)
