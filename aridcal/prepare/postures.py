"""Readings of a simulated arm: drawn, brought to where the target must be, or such that a camera sees its markers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aridcal.errors import CampaignError
from aridcal.inputs.instrument_settings import Carrier
from aridcal.inputs.things import BOARD, Known
from aridcal.instruments.camera import project
from aridcal.instruments.pixels import LENS, in_camera
from aridcal.instruments.pixels import PIXELS as KIND
from aridcal.prepare.true_things import (
    AROUND,
    FACING,
    RANGE_OF_TIP,
    RANGE_OF_WORLD,
    Real,
    TrueCamera,
    TrueThings,
    camera_state,
)
from aridcal.robot.chain import Robot

Pose = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Readings of all rows, shape (n, columns), to rotations (n, 3, 3) and positions (n, 3) of their targets, [m]."""

Miss = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Rotations and positions of the targets of all rows to how far each is from where it must be, shape (n, k), [m]."""

INSIDE = 0.02
"""Share of each joint's range that is left free at either end: effects move the readings a little further."""

STEPS, ROUNDS = 40, 40
"""Newton steps towards a place, and how often rows that have not come there start anew from other readings."""

TURN = 0.4
"""The most that a joint moves in one step, [rad] or [m], as far as the linear model holds."""

DAMPING = 1e-9
"""[m²/rad²]: keeps the step of a stretched arm finite."""

SMALL = 1e-5
"""[rad] or [m]: for differences."""

THERE = 1e-9
"""[m]: nearer than that the arm has come."""

NEAREST, FARTHEST = 0.1, 3.0
"""[m] from the camera: markers nearer or farther are not sharp."""

LEAN = 0.35
"""Cosine of the angle between a board's normal and the ray to the camera below which its print is not read: 70 degrees."""

BORDER = 5.0
"""[px] along the edges in which no marker is read: noise must not push it out."""

FEWEST = 4
"""Markers of a usable image, or all if there are fewer."""

POOL, DRAWS = 1000, 200
"""Postures that are drawn at once, and how often for one camera."""

PLACES, TRIED = 15, 400
"""Places that are drawn for a board or a camera, and postures on which they are compared."""

AT_ONCE = 100_000
"""Markers in images that are looked at in one go."""

Tips = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Readings, shape (n, columns), to poses of the tip in the world, (n, 3, 3) and (n, 3)."""

Draw = Callable[[int], np.ndarray]
"""So many readings drawn at random."""


def limits_of(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest readings, shape (columns,) each, [rad] or [m]; +-pi where there is no limit."""
    limits = {joint.reading: (joint.lower, joint.upper) for joint in robot.joints}
    low, high = np.array([limits[reading] for reading in robot.readings]).T
    return np.where(np.isfinite(low), low, -math.pi), np.where(np.isfinite(high), high, math.pi)


def draw_readings(robot: Robot, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw readings, uniform inside their limits, shape (n, columns), [rad] or [m]; +-pi where there is no limit."""
    low, high = limits_of(robot)
    return np.asarray(rng.uniform(low, high, (n, len(low))))


def brought(robot: Robot, pose: Pose, miss: Miss, n: int, rng: np.random.Generator, place: str) -> np.ndarray:
    """Readings with which every row's target is where it must be, each from a posture drawn at random, shape (n, columns).

    An arm has more joints than a touch has numbers: what is left free stays as it was drawn, so that postures differ.

    Args:
        robot: The chain.
        pose: Of the targets.
        miss: How far they are from where they must be.
        n: Rows.
        rng: Draws the postures.
        place: What to name if the arm does not come there.

    Raises:
        CampaignError: some rows cannot be reached.
    """
    low, high = limits_of(robot)
    margin = INSIDE * (high - low)
    low, high = low + margin, high - margin
    readings = draw_readings(robot, n, rng)
    left = np.ones(n, dtype=bool)
    for _ in range(ROUNDS):
        readings[left] = draw_readings(robot, int(left.sum()), rng)
        for _ in range(STEPS):
            step, off = _step(pose, miss, readings)
            left = (off > THERE) | ((readings < low) | (readings > high)).any(axis=1)
            if not left.any():
                return readings
            step[~left] = 0.0
            readings = np.clip(readings + step, low, high)
    raise CampaignError(
        f"{place}: {int(left.sum())} of {n} rows cannot be measured: the arm does not reach the places that they refer to; "
        "move those under `truth.instruments`"
    )


def settled(pose: Pose, miss: Miss, readings: np.ndarray, moved: np.ndarray, steps: int) -> np.ndarray:
    """Readings near others with which some rows' targets are where they must be, to rounding.

    Args:
        pose: Of the targets.
        miss: How far they are from where they must be.
        readings: Shape (n, columns).
        moved: Rows that may move, shape (n,) bool.
        steps: Of Newton's method.
    """
    for _ in range(steps):
        step, _ = _step(pose, miss, readings)
        readings = readings + np.where(moved[:, None], step, 0.0)
    return readings


def _step(pose: Pose, miss: Miss, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Newton's shortest step of every row, shape (n, columns), and how far each still is, shape (n,)."""
    e = miss(*pose(readings))
    J = np.empty((*e.shape, readings.shape[1]))
    for k, shift in enumerate(SMALL * np.eye(readings.shape[1])):
        J[:, :, k] = (miss(*pose(readings + shift)) - miss(*pose(readings - shift))) / (2 * SMALL)
    H = J @ J.transpose(0, 2, 1) + DAMPING * np.eye(e.shape[1])
    step = -np.einsum("nkj,nk->nj", J, np.linalg.solve(H, e[:, :, None])[:, :, 0])
    longest = np.abs(step).max(axis=1, keepdims=True)
    return step * np.minimum(1.0, TURN / np.maximum(longest, 1e-300)), np.linalg.norm(e, axis=1)


@dataclass(frozen=True)
class Sight:
    """Cameras, boards and markers as they are.

    Attributes:
        real: By role.
        board: Number of each camera's board, shape (C,).
        markers: Numbers of the markers of each board.
        printed: Boards whose markers are seen from the front alone.
        size: Width and height of each camera's images, shape (C, 2), [px].
    """

    real: dict[str, Real]
    board: np.ndarray
    markers: tuple[np.ndarray, ...]
    printed: tuple[bool, ...]
    size: np.ndarray

    def seen(self, camera: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Which markers of its board a camera sees from poses of the tip, shape (n, M) bool."""
        own = self.markers[self.board[camera]]
        made = [self._seen(camera, R[k : k + step], p[k : k + step])
                for step in [max(1, AT_ONCE // len(own))] for k in range(0, len(R), step)]  # fmt: skip
        return np.concatenate(made)

    def _seen(self, camera: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        board = int(self.board[camera])
        own, n = self.markers[board], len(R)
        m, each = len(own), np.repeat(np.arange(n), len(own))
        states = self.states(np.full(n * m, camera), np.tile(own, n))
        X, _, _, _ = in_camera(R[each], p[each], states)
        front = (X[:, 2] > NEAREST) & (X[:, 2] < FARTHEST)
        X = np.where(front[:, None], X, [0.0, 0.0, 1.0])
        lens, plain = states[0][:, LENS], states[0][:, LENS].copy()
        plain[:, 4:] = 0.0
        size = self.size[camera]
        pixel, unbent = project(X, lens), project(X, plain)
        inside = ((pixel > BORDER) & (pixel < size - 1 - BORDER)).all(axis=1)
        # beyond its border a lens model may fold the world back into the image
        inside &= (np.abs(unbent - size / 2) < 0.75 * size).all(axis=1)
        seen = (front & inside).reshape(n, m)
        if self.printed[board]:
            seen &= self._from_the_front(camera, R, p)[:, None]
        return seen

    def _from_the_front(self, camera: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """True of poses in which the camera is before the board, shape (n,)."""
        n = len(R)
        on_axis, (cameras, boards, _) = np.array([[0.0, 0.0, 1.0]]), self.states(np.full(n, camera), np.zeros(n, int))
        ends = [in_camera(R, p, (cameras, boards, np.repeat(at, n, axis=0)))[0] for at in (0 * on_axis, on_axis)]
        normal = ends[1] - ends[0]
        return np.asarray(-np.sum(normal * ends[0], axis=1) > LEAN * np.linalg.norm(ends[0], axis=1))

    def states(self, camera: np.ndarray, marker: np.ndarray) -> list[np.ndarray]:
        """States of cameras, their boards and markers, by their numbers."""
        boards = self.board[camera]
        return [self.real[role.name].states[k] for role, k in zip(KIND.roles, (camera, boards, marker), strict=True)]


def sight(things: TrueThings, known: Known, tips: Tips, draw: Draw, rng: np.random.Generator) -> Sight:
    """Cameras and markers as they are; see :mod:`aridcal.prepare.true_things`.

    What is not given stands where the arm shows or sees it from many postures: the best of some places.

    Args:
        things: What the scenario says.
        known: What the campaign knows.
        tips: Where the tip is.
        draw: Draws postures.
        rng: Draws places.

    Raises:
        CampaignError: the markers are given, but not of which of two boards.
    """
    settings = known.settings
    cameras = tuple(settings.cameras)
    sides: list[Carrier] = list(dict.fromkeys(settings.sides[name] for name in cameras))
    if len(sides) > 1 and isinstance(things.markers, dict):
        raise CampaignError(
            f"{known.origin}: truth.instruments.markers: there are cameras on the tip and beside the arm; write a number, "
            "and each sees so many of its own"
        )
    states, given = zip(*[camera_state(known, n, things.cameras.get(n, TrueCamera())) for n in cameras], strict=True)
    cams = np.array(states)
    names: list[str] = []
    local: list[np.ndarray] = []
    own: list[np.ndarray] = []
    places: list[np.ndarray | None] = []
    printed = []
    for side in sides:
        board = bool(known.markers) and known.board == BOARD + side
        if board:
            labels = tuple(known.markers)
            xyz = np.array([known.markers[label].xyz for label in labels])
            std = np.array([known.markers[label].std for label in labels])
            xyz = xyz + np.where(np.isfinite(std), std, 0.0)[:, None] * rng.standard_normal(xyz.shape)
            stated = things.board or (settings.markers if settings.markers.given else None)
            place = None if stated is None else stated.homogeneous
        elif isinstance(things.markers, dict):
            labels, place = tuple(things.markers), np.eye(4)
            xyz = np.array([things.markers[label] for label in labels])
        else:
            word = "marker" if len(sides) == 1 else f"{side}_marker"
            labels = tuple(f"{word}_{k + 1}" for k in range(things.markers))
            box = AROUND if side == "world" else AROUND / 3
            xyz, place = rng.uniform(-0.5, 0.5, (len(labels), 3)) * box, None
        if side == "tip" and place is None:
            place = np.eye(4)
        own.append(len(names) + np.arange(len(labels)))
        names += labels
        local.append(xyz)
        places.append(place)
        printed.append(board)
    number = np.array([sides.index(settings.sides[name]) for name in cameras])
    size = np.array([[settings.cameras[n].width, settings.cameras[n].height] for n in cameras], dtype=float)

    def made(cams: np.ndarray, placed: list[np.ndarray]) -> Sight:
        boards, markers = [], []
        for T, xyz, is_printed in zip(placed, local, printed, strict=True):
            boards.append(T if is_printed else np.eye(4))
            markers.append(xyz if is_printed else xyz @ T[:3, :3].T + T[:3, 3])
        rows = np.array([[*T[:3, 3], *T[:3, :3].reshape(-1)] for T in boards])
        real = {
            "camera": Real(cameras, cams),
            "board": Real(tuple(BOARD + side for side in sides), rows),
            "marker": Real(tuple(names), np.concatenate(markers)),
        }
        return Sight(real, number, tuple(own), tuple(printed), size)

    for c, is_given in enumerate(given):
        b, on_tip = int(number[c]), cams[c, 21] > 0.5
        if (on_tip and places[b] is not None) or (not on_tip and is_given):
            continue
        R, p = tips(draw(PLACES))
        T = np.tile(np.eye(4), (PLACES, 1, 1))
        T[:, :3, :3], T[:, :3, 3] = R, p
        before, camera = np.eye(4), np.eye(4)
        before[:3, :3], before[2, 3] = FACING, RANGE_OF_TIP if on_tip else RANGE_OF_WORLD
        camera[:3, 3], camera[:3, :3] = cams[c, :3], cams[c, 3:12].reshape(3, 3)
        middle = np.eye(4)
        middle[:3, 3] = local[b].mean(axis=0)
        there = places[b]
        if on_tip:
            tried = T @ camera @ np.linalg.inv(middle @ before)
        else:
            assert there is not None
            tried = T @ there @ middle @ before
        looks = tips(draw(TRIED))
        best, most = tried[0], -1
        for trial in tried:
            if on_tip:
                placed, now = [trial if k == b or at is None else at for k, at in enumerate(places)], cams
            else:
                placed = [np.eye(4) if at is None else at for at in places]
                now = cams.copy()
                now[c, :12] = [*trial[:3, 3], *trial[:3, :3].reshape(-1)]
            count = int(made(now, placed).seen(c, *looks).sum())
            if count > most:
                best, most = trial, count
        if on_tip:
            places[b] = best
        else:
            cams[c, :12] = [*best[:3, 3], *best[:3, :3].reshape(-1)]
    return made(cams, [np.eye(4) if at is None else at for at in places])


def draw_images(seen: Sight, cameras: np.ndarray, tips: Tips, draw: Draw, place: str) -> tuple[np.ndarray, np.ndarray]:
    """Readings from which each image shows enough, shape (K, columns), and what it shows, shape (K, markers) bool.

    Args:
        seen: Cameras and markers as they are.
        cameras: Number of the camera of each image, shape (K,).
        tips: Where the tip is.
        draw: Draws postures.
        place: What to name if a camera sees nothing.

    Raises:
        CampaignError: a camera sees the markers from hardly any posture.
    """
    readings = np.empty((len(cameras), draw(1).shape[1]))
    shown = np.zeros((len(cameras), len(seen.real["marker"].names)), dtype=bool)
    for c in np.unique(cameras).tolist():
        todo = np.flatnonzero(cameras == c)
        own = seen.markers[seen.board[c]]
        for _ in range(DRAWS):
            q = draw(POOL)
            markers = seen.seen(c, *tips(q))
            good = np.flatnonzero(markers.sum(axis=1) >= min(FEWEST, len(own)))[: len(todo)]
            readings[todo[: len(good)]] = q[good]
            shown[np.ix_(todo[: len(good)], own)] = markers[good]
            todo = todo[len(good) :]
            if not len(todo):
                break
        else:
            raise CampaignError(
                f"{place}: the camera {seen.real['camera'].names[c]} sees the markers from hardly any posture of the arm: move "
                "camera or markers under `truth.instruments`"
            )
    return readings, shown
