"""Where cameras, boards and markers are, from any mounting: rotations over an even grid, everything else linear for each.

For a camera whose rotation on its carrier is R_c, a ray d of an image lies along w = R_c d. The marker that it shows is at
Z on the carrier, so that (1 - w w')(Z - t_c) = 0, and Z is linear in the marker's place, or in the board's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.instruments.descent import DescentPoint, StartView, descend, descent_point, spread, thing_states
from aridcal.engine.instruments.pixels import LENS, ON_TIP, PLACE_COMPONENTS, R9, T, normalised
from aridcal.engine.instruments.pose import nearest_rotation

TRIED_ROTATIONS = 480
"""Rotations tried: neighbours are about 30 degrees apart, well inside what the sweeps reach over."""

SWEEPS_OF_A_ROTATION = 3
"""Sweeps that improve each rotation in turn with its unknowns x, before and after the better rotations are chosen."""

IMPROVED_ROTATIONS = 48
"""Rotations that are improved further, the best ones."""

COMPARED_ROWS = 120
"""Rows of a pair of camera and board on which rotations are compared."""

MOST_UNKNOWN_MARKERS = 10
"""Unknown markers on which rotations are compared, at the most."""

DESCENDED_ROTATIONS = 10
"""Rotations from which least squares are tried."""

SAME_ROTATION_TRACE = 2.98
"""Trace of the turn from one rotation to another, eight degrees, up to which the two are one."""

FIRST_STEPS, FURTHER_STEPS, FURTHER_PLACES = 20, 60, 4
"""Steps of least squares from each; further steps for the best, and how many those are: some valleys are long."""

LEAST_KNOWN_MARKERS = 12
"""Rows with known markers from which a camera is placed by those alone."""

SIGHTING_RIDGE = 1e-9
"""Share of the equations' trace that keeps them solvable where these rows leave something open."""

LEAST_MARKER_SPREAD = 1e-3
"""Spread of a board's markers across a plane or line, as a share of that along it, which says nothing of its tilt."""


@dataclass(frozen=True)
class _Sight:
    """Rows of one camera that see one board: Z - t_c = offset + linear x, with x what is unknown of camera, board and markers.

    Attributes:
        rows: Their numbers in the view.
        rays: Unit directions in the camera, shape (n, 3).
        offset: Shape (n, 3), [m].
        linear: Shape (n, 3, K): the camera's place, the board's and its axes, the markers' places, each if unknown.
        camera: True if the camera's place is unknown.
        middle: Of the board's markers, shape (3,), if its place is unknown, else None.
        axes: Along which they spread, shape (3, r).
        markers: Unknown ones.
    """

    rows: np.ndarray
    rays: np.ndarray
    offset: np.ndarray
    linear: np.ndarray
    camera: bool
    middle: np.ndarray | None
    axes: np.ndarray
    markers: np.ndarray


SettledThings = dict[str, set[int]]
"""Which cameras and boards have a place already: numbers, by role."""


def sighted(view: StartView, target: np.ndarray, beforehand: dict[str, np.ndarray], steps: int) -> list[DescentPoint]:
    """Places of everything that pixels refer to, from hints first; components that are known and not free stay as they are.

    Pairs of camera and board are taken in turn, those first of which the most is known: what one pair has located helps the next.

    Args:
        view: Rows of pixels.
        target: T_tip_target, which pixels do not ask for, shape (4, 4).
        beforehand: States beforehand, by role.
        steps: Of least squares in the end.
    """
    fixed_lenses = replace(view, free={name: mask.copy() for name, mask in view.free.items()})
    fixed_lenses.free["camera"][:, len(PLACE_COMPONENTS) :] = (
        False  # a lens a little off moves nothing far: the fit frees it
    )
    states, settled = _beginning(fixed_lenses, beforehand)
    pairs = [(int(c), int(b)) for c, b in np.unique(view.refers[:, :2], axis=0)]
    candidates = [descent_point(fixed_lenses, target, states)]
    rows = {pair: np.flatnonzero((view.refers[:, :2] == pair).all(axis=1)) for pair in pairs}
    while pairs:
        camera, board = pair = max(
            pairs, key=lambda pair: ((pair[0] in settled["camera"]) + (pair[1] in settled["board"]), len(rows[pair]))
        )
        pairs.remove(pair)
        candidates = _pair(fixed_lenses, candidates[0], settled, pair, rows[pair])
        settled["camera"].add(camera)
        settled["board"].add(board)
    hint = descent_point(fixed_lenses, target, beforehand)
    starts = [hint, *candidates] if view.complete(beforehand).all() else candidates
    return [descend(fixed_lenses, place, steps) for place in starts]


def _beginning(view: StartView, beforehand: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], SettledThings]:
    """States to begin with, and what of them is settled.

    A board without a place, none of whose markers has one either, is put in the middle of its carrier: they are told from
    there.
    """
    states = {name: state.copy() for name, state in beforehand.items()}
    complete = {name: np.isfinite(state).all(axis=1) for name, state in beforehand.items()}
    boards = complete["board"] & ~view.free["board"].any(axis=1)
    for b in np.unique(view.refers[:, 1]):
        markers = np.unique(view.refers[view.refers[:, 1] == b, 2])
        if not complete["marker"][markers].any():
            boards[b] = True
            if not complete["board"][b]:
                states["board"][b] = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    cameras = complete["camera"] & ~view.free["camera"].any(axis=1)
    return states, {"camera": set(np.flatnonzero(cameras).tolist()), "board": set(np.flatnonzero(boards).tolist())}


def _pair(
    view: StartView, place: DescentPoint, settled: SettledThings, pair: tuple[int, int], rows: np.ndarray
) -> list[DescentPoint]:
    """Places in which a pair has its own, the best first."""
    camera, board = pair
    if not np.isfinite(place.states["camera"][camera, LENS]).all():
        return [place]
    candidates = [place]
    if not (camera in settled["camera"] and board in settled["board"]):
        sight = _sight(view, place.states, settled, pair, rows)
        if sight is None:
            return [place]
        part = view.select(sight.rows)
        trials = [
            descent_point(part, place.target, _with_solution(view, place.states, sight, pair, turn, x))
            for turn, x in _compared(sight, _turns(place.states["camera"][camera], camera in settled["camera"]))
        ]
        limited = replace(part, free=_without_settled(part.free, pair, settled))
        trials = [descend(limited, trial, FIRST_STEPS) for trial in trials]
        trials = [
            descend(limited, trial, FURTHER_STEPS)
            for trial in sorted(trials, key=lambda trial: trial.cost)[:FURTHER_PLACES]
        ]
        candidates = sorted(trials, key=lambda trial: trial.cost)[:2]
    part = view.select(rows)
    located_places = []
    for trial in candidates:
        lacking = np.flatnonzero(~np.isfinite(trial.states["marker"]).all(axis=1))
        states = thing_states(part, trial.target, trial.states, lacking, place.states["marker"])
        located_places.append(descent_point(view, trial.target, states))
    return located_places


def _without_settled(
    free: dict[str, np.ndarray], pair: tuple[int, int], settled: SettledThings
) -> dict[str, np.ndarray]:
    """Masks of the free components, without those of a camera or board that is settled."""
    limited = {name: mask.copy() for name, mask in free.items()}
    for name, number in zip(("camera", "board"), pair, strict=True):
        if number in settled[name]:
            limited[name][number] = False
    return limited


def _turns(camera: np.ndarray, settled: bool) -> np.ndarray:
    """Rotations of a camera to try, shape (G, 3, 3): its own if it is settled, else its own first if it has one."""
    rotation = camera[R9].reshape(1, 3, 3)
    if settled:
        return rotation
    return np.concatenate([rotation, grid()]) if np.isfinite(rotation).all() else grid()


def grid() -> np.ndarray:
    """Rotations spread evenly, shape (GRID, 3, 3): a super-Fibonacci spiral (Alexa 2022, CVPR, 8291)."""
    from scipy.spatial.transform import Rotation  # slow to load, and a campaign is read without it

    s = np.arange(TRIED_ROTATIONS) + 0.5
    r, R = np.sqrt(s / TRIED_ROTATIONS), np.sqrt(1.0 - s / TRIED_ROTATIONS)
    alpha, beta = 2 * np.pi * s / np.sqrt(2.0), 2 * np.pi * s / 1.533751168755204288118041
    quaternions = np.column_stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)])
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def _sight(
    view: StartView, states: dict[str, np.ndarray], settled: SettledThings, pair: tuple[int, int], rows: np.ndarray
) -> _Sight | None:
    """Equations of the rows on which a pair's rotations are compared; None if there are too few."""
    camera, board = states["camera"][pair[0]], states["board"][pair[1]]
    xy = normalised(view.observed[rows], np.broadcast_to(camera[LENS], (len(rows), 9)))
    sharp = np.isfinite(xy).all(axis=1)
    labels = view.refers[rows, 2]
    placed_markers = np.isfinite(states["marker"]).all(axis=1)[labels]
    board_open = pair[1] not in settled["board"]
    chosen = sharp & placed_markers
    if not board_open and chosen.sum() < LEAST_KNOWN_MARKERS:
        count = np.bincount(labels[sharp & ~placed_markers], minlength=len(states["marker"]))
        chosen = sharp & (placed_markers | np.isin(labels, np.argsort(-count, kind="stable")[:MOST_UNKNOWN_MARKERS]))
    some = np.flatnonzero(chosen)
    some = some[spread(len(some), COMPARED_ROWS)]
    if len(some) < 3:
        return None
    rows, xy, labels, placed_markers = rows[some], xy[some], labels[some], placed_markers[some]
    R, p = view.R[rows], view.p[rows]
    on_tip = camera[ON_TIP] > 0.5
    carried = np.swapaxes(R, 1, 2) if on_tip else R
    offset = -np.einsum("nij,nj->ni", carried, p) if on_tip else p.copy()
    marker = np.where(placed_markers[:, None], states["marker"][labels], 0.0)
    columns, middle, axes, markers = [], None, np.zeros((3, 0)), np.unique(labels[~placed_markers])
    if pair[0] not in settled["camera"]:
        columns.append(np.broadcast_to(-np.eye(3), (len(rows), 3, 3)))
    else:
        offset -= camera[T]
    if board_open:
        middle, axes = _shape(marker)
        along = (marker - middle) @ axes
        columns += [carried, *(along[:, k, None, None] * carried for k in range(axes.shape[1]))]
    else:
        turned = board[R9].reshape(3, 3)
        offset += np.einsum("nij,nj->ni", carried, board[T] + marker @ turned.T)
        columns += [np.where((labels == label)[:, None, None], carried @ turned, 0.0) for label in markers]
    rays = np.column_stack([xy, np.ones(len(xy))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    linear = np.concatenate(columns, axis=2)
    return _Sight(rows, rays, offset, linear, pair[0] not in settled["camera"], middle, axes, markers)


def _shape(marker: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle of the markers, (3,), and the axes along which they spread, (3, r): two for a flat board, none for one marker."""
    middle = marker.mean(axis=0)
    _, sizes, Vt = np.linalg.svd(marker - middle, full_matrices=False)
    return middle, Vt[sizes > LEAST_MARKER_SPREAD * max(sizes[0], 1e-9)].T


def _compared(sight: _Sight, turns: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The best rotations and their unknowns x, improved in turn: rotations by Wahba's problem, x by linear equations.

    The first that is given is among them: a hint.
    """
    turns, x, cost = _swept(sight, turns)
    better = np.unique(np.r_[0, np.argsort(cost, kind="stable")[:IMPROVED_ROTATIONS]])
    turns, x, cost = _swept(sight, turns[better])
    chosen: list[int] = []
    for k in [0, *np.argsort(cost, kind="stable").tolist()]:
        if not any(np.trace(turns[k].T @ turns[other]) > SAME_ROTATION_TRACE for other in chosen):
            chosen.append(k)
    return [(turns[k], x[k]) for k in chosen[:DESCENDED_ROTATIONS]]


def _swept(sight: _Sight, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations (G, 3, 3) after some sweeps, their unknowns x (G, K), and the mean of 1 - cos of the rays' errors, (G,)."""
    K = sight.linear.shape[2]
    flat = sight.linear.reshape(-1, K)
    square, pull = flat.T @ flat, flat.T @ sight.offset.ravel()
    for sweep in range(SWEEPS_OF_A_ROTATION):
        w = sight.rays @ np.swapaxes(turns, 1, 2)
        f = np.einsum("gni,nik->gnk", w, sight.linear)
        M = square - np.swapaxes(f, 1, 2) @ f
        right = -pull + np.einsum("gnk,gn->gk", f, np.einsum("gni,ni->gn", w, sight.offset))
        ridge = SIGHTING_RIDGE * np.trace(square) / K * np.eye(K)
        x = np.linalg.solve(M + ridge, right[:, :, None])[:, :, 0]
        X = sight.offset + np.einsum("nik,gk->gni", sight.linear, x)
        u = X / np.maximum(np.linalg.norm(X, axis=2, keepdims=True), 1e-12)
        cost = 1.0 - np.mean(np.sum(u * w, axis=2), axis=1)
        if sweep < SWEEPS_OF_A_ROTATION - 1 and sight.camera:
            turns = nearest_rotation(np.swapaxes(u, 1, 2) @ sight.rays)
    return turns, x, cost


def _with_solution(
    view: StartView,
    states: dict[str, np.ndarray],
    sight: _Sight,
    pair: tuple[int, int],
    turn: np.ndarray,
    x: np.ndarray,
) -> dict[str, np.ndarray]:
    """States with the solution x of a pair; all others stay."""
    new = {name: state.copy() for name, state in states.items()}
    if sight.camera:
        new["camera"][pair[0], T], new["camera"][pair[0], R9] = x[:3], turn.ravel()
        x = x[3:]
    if sight.middle is not None:
        r = sight.axes.shape[1]
        turned, axes = x[3 : 3 + 3 * r].reshape(r, 3).T, sight.axes
        if r == 2:  # the third follows from the two
            turned = np.column_stack(
                [turned, np.cross(turned[:, 0], turned[:, 1]) / max(np.linalg.norm(turned[:, 0]), 1e-12)]
            )
            axes = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
        R = nearest_rotation(turned @ axes.T)
        new["board"][pair[1]] = np.concatenate([x[:3] - R @ sight.middle, R.ravel()])
    else:
        new["marker"][sight.markers] = x.reshape(-1, 3)
    return new
