"""Closed-form starts of unknown frames, from any attitude: AX = ZB for poses, Kabsch inside for positions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from aridcal.engine.fit.flags import robust_sigma
from aridcal.engine.instruments.pose import kind_of_places, nearest_rotation, residuals
from aridcal.engine.levels import SLIGHT
from aridcal.engine.numerics import RANK, STEP_HALVINGS

STRAIN = 1 / 3
"""Work: Share of the misfit that the points may move by on the way to the hint: it then grows by a twentieth at the most."""

BEST_STARTS = 2
"""Work: Target translations that are handed on: a fit of each tells which is right."""

SAME_MINIMUM_SHARE = 1e-3
"""Work: Share of the points' spread within which two minima are one."""

DESCENTS = 500
"""Work: Steps from each start at the most; ten are usual."""

ARMIJO = 1e-4
"""Work: Share of what the slope promises that a step must reach (Nocedal and Wright 2006, equation 3.4)."""

TURN_COUNTS = 0.1
"""Work: [m/rad]: how much a start's misfit in rotation counts beside that in position."""

# Of places (B, T), the value (B,) and the slope (B, T) at each.
Cost = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
FramePair = tuple[pin.SE3, ...]


@dataclass(frozen=True)
class FrameStart:
    """Placements of the world_base and tip_target frames, one per station or one in all."""

    world_base: FramePair
    tip_target: FramePair


@dataclass(frozen=True)
class PoseRows:
    """Rows that measure the target's place, and the frames that each belongs to.

    Attributes:
        R: Nominal T_base_tip, shape (N, 3, 3).
        p: Its translation, shape (N, 3), [m].
        M: Measured rotation of the target in the world, shape (N, 3, 3), or None.
        m: Its measured position, shape (N, 3), [m].
        world: Number of each row's world_base frame, shape (N,).
        tip: Number of each row's tip_target frame, shape (N,).
    """

    R: np.ndarray
    p: np.ndarray
    M: np.ndarray | None
    m: np.ndarray
    world: np.ndarray
    tip: np.ndarray


def start_frames(
    data: PoseRows, known_world: FramePair | None, known_tip: FramePair | None, hint_tip: FramePair
) -> list[FrameStart]:
    """Candidate starts for unknown T_world_base and T_tip_target; a fit from each tells which is right.

    Args:
        data: N rows.
        known_world: T_world_base of each world frame; None where they are to be identified.
        known_tip: T_tip_target of each target; None likewise.
        hint_tip: The target where nothing measures it: its rotation from positions alone, its translation along
            directions that the base can follow (a tool that never tilts).
    """
    if known_world is not None and known_tip is not None:
        return [FrameStart(known_world, known_tip)]
    if known_world is not None:
        return [_with_target(data, known_world, _levers_from_worlds(data, known_world, len(hint_tip)), hint_tip)]
    if known_tip is not None:
        t = np.array([frame.translation for frame in known_tip])
        turned = None
        if data.M is not None:
            turned = data.R @ np.array([frame.rotation for frame in known_tip])[data.tip]
        return [FrameStart(_kabsch(data, t, turned), known_tip)]
    hint = np.array([frame.translation for frame in hint_tip])
    places = [(_kabsch(data, t, None), t) for t in _levers(data, hint)]
    places += _kronecker(data, hint) if data.M is not None else []
    return [_with_target(data, world_base, t, hint_tip) for world_base, t in places]


def best_start(
    data: PoseRows, known_world: FramePair | None, known_tip: FramePair | None, hint_tip: FramePair
) -> FrameStart:
    """The start with the smallest misfit; see :func:`start_frames`."""
    channels = kind_of_places(data.M).channels

    def left(start: FrameStart) -> float:
        X = np.array([f.homogeneous for f in start.world_base])[data.world]
        Y = np.array([f.homogeneous for f in start.tip_target])[data.tip]
        T = np.broadcast_to(np.eye(4), (len(data.p), 4, 4)).copy()
        T[:, :3, :3], T[:, :3, 3] = data.R, data.p
        T = X @ T @ Y
        sigma = robust_sigma(residuals(T[:, :3, :3], T[:, :3, 3], data.m, data.M), channels)
        return float(sigma[0] + TURN_COUNTS * sigma[1:].sum())

    return min(start_frames(data, known_world, known_tip, hint_tip), key=left)


def _points(data: PoseRows, t: np.ndarray) -> np.ndarray:
    """Target in the base frame for target translations t, shape (tips, 3)."""
    return data.p + np.einsum("nij,nj->ni", data.R, t[data.tip])


def _columns(data: PoseRows, tips: int) -> np.ndarray:
    """Derivatives of the targets in the base frame by the target translations, shape (N, 3, 3 tips)."""
    columns = np.zeros((len(data.p), 3, 3 * tips))
    for k in range(tips):
        columns[data.tip == k, :, 3 * k : 3 * k + 3] = data.R[data.tip == k]
    return columns


def _centred(values: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Values minus the mean over the rows of the same label."""
    out = values.copy()
    for k in np.unique(label):
        out[label == k] -= values[label == k].mean(axis=0)
    return out


def _levers(data: PoseRows, hint: np.ndarray) -> list[np.ndarray]:
    """Target translations t, shape (tips, 3) each, that let the measured points fall on the robot's.

    Minimises over t the misfit after Kabsch's rotation: |m|^2 + |c(t)|^2 - 2 sum over worlds of the (signed) nuclear norm
    of H(t), with c(t) linear in t; so the cost of a step does not depend on the number of rows.
    """
    tips = len(hint)
    cost = lever_cost(data, tips)
    spread = np.sum(_centred(data.m, data.world) ** 2, axis=1)
    size = max(float(np.sqrt(np.mean(spread))), 1e-6)  # one row alone has none
    directions = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    minima = np.array(_distinct(descend(cost, np.tile(size * directions, tips), size), SAME_MINIMUM_SHARE * size))
    lowest_first = minima[np.argsort(cost(minima)[0], kind="stable")]
    slid = [t + _slide(cost, t, hint.ravel() - t, size) for t in lowest_first]
    return [t.reshape(tips, 3) for t in _distinct(slid, SAME_MINIMUM_SHARE * size)[:BEST_STARTS]]


def _distinct(places: Iterable[np.ndarray], apart: float) -> list[np.ndarray]:
    """Translations without those that hardly differ from an earlier one."""
    distinct: list[np.ndarray] = []
    for t in places:
        if not any(np.allclose(t, other, atol=apart) for other in distinct):
            distinct.append(t)
    return distinct


def lever_cost(data: PoseRows, tips: int) -> Cost:
    r"""Misfit of target translations t and its slope, the base following by Kabsch, in units of the points' spread.

    .. math:: |m|^2 + |c_0 + C t|^2 - 2 \sum_w (\sigma_1 + \sigma_2 \pm \sigma_3)(H_{0w} + H_{1w} t)
    """
    worlds = int(data.world.max()) + 1
    c, C, m = (_centred(part, data.world) for part in (data.p, _columns(data, tips), data.m))
    rows_of_worlds = [data.world == w for w in range(worlds)]
    H0 = np.array([m[rows].T @ c[rows] for rows in rows_of_worlds])
    moments = [np.einsum("ni,njk->kij", m[rows], C[rows]).reshape(-1, 9) for rows in rows_of_worlds]
    H1 = np.concatenate(moments, axis=1)  # (T, 9 worlds)
    linear = np.einsum("nik,ni->k", C, c)
    quadratic = np.einsum("nik,nil->kl", C, C)
    measured = float(np.sum(m**2))
    constant = float(measured + np.sum(c**2))
    scale = max(measured, 1e-30)

    def cost(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        curved = t @ quadratic
        U, singular, Vt = np.linalg.svd(H0 + (t @ H1).reshape(-1, worlds, 3, 3))
        sign = np.ones(singular.shape)
        sign[..., 2] = np.sign(np.linalg.det(U @ Vt))
        turn = (U * sign[..., None, :]) @ Vt
        value = constant + 2 * t @ linear + np.sum(t * curved, axis=1) - 2 * np.sum(singular * sign, axis=(1, 2))
        slope = 2 * linear + 2 * curved - 2 * turn.reshape(len(t), -1) @ H1.T
        return value / scale, slope / scale

    return cost


def descend(cost: Cost, t: np.ndarray, size: float) -> np.ndarray:
    """The minima below B places, shape (B, T) both, by BFGS (Nocedal and Wright 2006, algorithm 6.1) with halved steps.

    The library's minimisers find the same ones one by one, and take longer to be loaded than to find them.
    """
    t = t.copy()
    value, slope = cost(t)
    inverse = np.tile(0.5 * size**2 * np.eye(t.shape[1]), (len(t), 1, 1))
    active = np.arange(len(t))
    for _ in range(DESCENTS):
        step = -np.squeeze(inverse[active] @ slope[active][:, :, None], axis=2)
        step, after_value, after_slope = _armijo(cost, t[active], value[active], slope[active], step)
        moved = np.isfinite(after_value)  # what cannot be lowered any more is at its minimum, to rounding
        active, step, after_value, after_slope = (part[moved] for part in (active, step, after_value, after_slope))
        turn, gain = after_slope - slope[active], value[active] - after_value
        t[active] += step
        value[active], slope[active] = after_value, after_slope
        goes_on = gain >= RANK * np.maximum(after_value, 1.0)
        active, step, turn = active[goes_on], step[goes_on], turn[goes_on]
        if not len(active):
            break
        along = np.sum(turn * step, axis=1)
        bent = along > 0.0  # else it curves downwards, and the matrix stays
        curving, step, turn, along = active[bent], step[bent], turn[bent], along[bent, None, None]
        across = np.eye(t.shape[1]) - step[:, :, None] * turn[:, None, :] / along
        inverse[curving] = (
            across @ inverse[curving] @ across.transpose(0, 2, 1) + step[:, :, None] * step[:, None, :] / along
        )
    return t


def _armijo(
    cost: Cost, t: np.ndarray, value: np.ndarray, slope: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps from B places halved until each lowers its value enough, and values and slopes there; infinite where none does."""
    step, after_value, after_slope = step.copy(), np.full(len(t), np.inf), np.zeros_like(t)
    falls = np.sum(step * slope, axis=1)
    open_steps = np.arange(len(t))
    for _ in range(STEP_HALVINGS):
        new_value, new_slope = cost(t[open_steps] + step[open_steps])
        enough = new_value <= value[open_steps] + ARMIJO * falls[open_steps]
        done = open_steps[enough]
        after_value[done], after_slope[done] = new_value[enough], new_slope[enough]
        open_steps = open_steps[~enough]
        if not len(open_steps):
            break
        step[open_steps] *= 0.5
        falls[open_steps] *= 0.5
    return step, after_value, after_slope


def _slide(cost: Cost, t: np.ndarray, gap: np.ndarray, size: float) -> np.ndarray:
    """The part of a gap from a minimum t to the hint, shape (T,), that the misfit does not notice, size being its unit [m].

    So a translation that cannot be identified stays at its hint.
    """
    steps = 1e-2 * size * np.eye(len(t))
    H = (cost(t + steps)[1] - cost(t - steps)[1]) / (4e-2 / size)
    moves, V = np.linalg.eigh(0.5 * (H + H.T))  # squared displacement of the points, [m^2/m^2]
    misfit = size * np.sqrt(max(float(cost(t[None])[0][0]), 1e-8))
    reach = STRAIN * misfit / np.sqrt(np.maximum(moves - 1e-10, 1e-30))
    along = V.T @ gap
    return np.asarray(V @ np.where(moves < SLIGHT**2, np.clip(along, -reach, reach), 0.0))


def _kabsch(data: PoseRows, t: np.ndarray, turned: np.ndarray | None) -> FramePair:
    """T_world_base of each world frame for known target translations, from positions and, where measured, rotations.

    Args:
        data: The rows.
        t: Target translations, shape (tips, 3).
        turned: Rotation of the target in the base frame, shape (N, 3, 3); None where it is not known.
    """
    c = _points(data, t)
    frames = []
    for w in range(int(data.world.max()) + 1):
        in_world = data.world == w
        middle_c, middle_m = c[in_world].mean(axis=0), data.m[in_world].mean(axis=0)
        H = (data.m[in_world] - middle_m).T @ (c[in_world] - middle_c)
        if turned is not None and data.M is not None:
            size = np.trace((c[in_world] - middle_c).T @ (c[in_world] - middle_c)) / in_world.sum()
            H += max(size, 1e-6) * np.einsum("nik,njk->ij", data.M[in_world], turned[in_world])
        R = nearest_rotation(H)
        frames.append(pin.SE3(R, middle_m - R @ middle_c))
    return tuple(frames)


def _kronecker(data: PoseRows, hint: np.ndarray) -> list[tuple[FramePair, np.ndarray]]:
    """Rotations from orientations alone (Shah 2013, doi:10.1115/1.4024473), both signs; then translations linearly."""
    assert data.M is not None
    turns = []
    for w in range(int(data.world.max()) + 1):
        in_world = data.world == w
        K = np.einsum("nij,nkl->ikjl", data.M[in_world], data.R[in_world]).reshape(9, 9)
        turns.append(np.linalg.svd(K)[0][:, 0].reshape(3, 3))
    rotations = [np.array([nearest_rotation(sign * turn) for turn in turns]) for sign in (1.0, -1.0)]
    return [_translations(data, RX, hint) for RX in rotations]


def _translations(data: PoseRows, RX: np.ndarray, hint: np.ndarray) -> tuple[FramePair, np.ndarray]:
    """Translations for known rotations: m = RX (p + R t) + tX is linear in t and tX; t is the nearest to its hint."""
    tips, n = len(hint), len(data.p)
    turn = RX[data.world]
    columns = np.einsum("nij,njk->nik", turn, _columns(data, tips))
    rest = data.m - np.einsum("nij,nj->ni", turn, _points(data, hint))
    A, b = _centred(columns, data.world), _centred(rest, data.world)
    information = np.einsum("nik,nil->kl", A, A) / n
    pull = np.einsum("nik,ni->k", A, b) / n
    moves, V = np.linalg.eigh(information)
    inverse = np.where(moves < SLIGHT**2, 0.0, 1.0 / np.maximum(moves, SLIGHT**2))
    x = V @ (inverse * (V.T @ pull))
    tX = rest - columns @ x
    bases = [tX[data.world == w].mean(axis=0) for w in range(len(RX))]
    world_base = tuple(pin.SE3(R, base) for R, base in zip(RX, bases, strict=True))
    return world_base, hint + x.reshape(tips, 3)


def _levers_from_worlds(data: PoseRows, world_base: FramePair, tips: int) -> np.ndarray:
    """Target translations t, shape (tips, 3), that belong to given world_base frames."""
    RX = np.array([frame.rotation for frame in world_base])[data.world]
    tX = np.array([frame.translation for frame in world_base])[data.world]
    target = np.einsum("nji,nj->ni", RX @ data.R, data.m - tX)
    lever = target - np.einsum("nji,nj->ni", data.R, data.p)
    return np.array([np.median(lever[data.tip == k], axis=0) for k in range(tips)])


def _with_target(data: PoseRows, world_base: FramePair, t: np.ndarray, hint: FramePair) -> FrameStart:
    """The start of given world_base frames and target translations, the targets' rotations from the measured ones."""
    RX = np.array([frame.rotation for frame in world_base])[data.world]
    tips = []
    for k, frame in enumerate(hint):
        of_tip, rotation = data.tip == k, frame.rotation
        if data.M is not None:
            turned = RX[of_tip] @ data.R[of_tip]
            rotation = nearest_rotation(np.einsum("nji,njk->ik", turned, data.M[of_tip]))
        tips.append(pin.SE3(rotation, t[k]))
    return FrameStart(world_base, tuple(tips))
