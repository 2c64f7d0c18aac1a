"""Readings of a simulated arm from which its cameras see their markers; where cameras and boards stand for that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aridcal.errors import CampaignError
from aridcal.inputs.instrument_settings import Carrier
from aridcal.inputs.things import BOARD, Known
from aridcal.instruments.pixels import faces, in_image
from aridcal.instruments.setup import WORLD
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

FEWEST = 4
"""Markers of a board in a usable image, or all if there are fewer."""

POOL, DRAWS = 1000, 200
"""Postures that are drawn at once, and how often for one camera."""

PLACES, TRIED = 15, 400
"""Places that are drawn for a board or a camera, and postures on which they are compared."""

AT_ONCE = 100_000
"""Markers in images that are looked at in one go."""

Tips = Callable[[np.ndarray, str, str], tuple[np.ndarray, np.ndarray]]
"""Readings, shape (n, columns), a camera and a board, by name, to poses of what carries the camera in the axes of what carries
the board, (n, 3, 3) and (n, 3); of what carries the board in the world, if that carries the camera."""

Draw = Callable[[int], np.ndarray]
"""So many readings drawn at random."""


@dataclass(frozen=True)
class Sight:
    """Cameras, boards and markers as they are.

    Attributes:
        real: By role.
        boards: Numbers of the boards that each camera looks at.
        markers: Numbers of the markers of each board.
        printed: Boards whose markers are seen from the front alone.
        size: Width and height of each camera's images, shape (C, 2), [px].
    """

    real: dict[str, Real]
    boards: tuple[tuple[int, ...], ...]
    markers: tuple[np.ndarray, ...]
    printed: tuple[bool, ...]
    size: np.ndarray

    @property
    def board_of(self) -> np.ndarray:
        """Number of each marker's board, shape (markers,)."""
        return np.repeat(np.arange(len(self.markers)), [len(own) for own in self.markers])

    def shown(self, camera: int, tips: Tips, readings: np.ndarray) -> np.ndarray:
        """Which markers a camera sees in some postures, shape (n, markers) bool: those of boards of which it sees enough."""
        found = np.zeros((len(readings), len(self.real["marker"].names)), dtype=bool)
        for board in self.boards[camera]:
            seen = self.seen(camera, board, *self.poses(camera, board, tips, readings))
            enough = seen.sum(axis=1) >= min(FEWEST, seen.shape[1])
            found[:, self.markers[board]] = seen & enough[:, None]
        return found

    def poses(self, camera: int, board: int, tips: Tips, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Those of what carries a camera, or its board, by their numbers."""
        return tips(readings, self.real["camera"].names[camera], self.real["board"].names[board])

    def seen(self, camera: int, board: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Which markers of a board a camera sees from poses, see :data:`Tips`, shape (n, M) bool."""
        step = max(1, AT_ONCE // len(self.markers[board]))
        made = [self._seen(camera, board, R[k : k + step], p[k : k + step]) for k in range(0, len(R), step)]
        return np.concatenate(made)

    def _seen(self, camera: int, board: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        own, n = self.markers[board], len(R)
        m, each = len(own), np.repeat(np.arange(n), len(own))
        states = self.states(np.full(n * m, camera), board, np.tile(own, n))
        seen = in_image(R[each], p[each], states, self.size[camera]).reshape(n, m)
        if self.printed[board]:
            cameras, boards, _ = self.states(np.full(n, camera), board, np.zeros(n, int))
            seen &= faces(R, p, cameras, boards)[:, None]
        return seen

    def states(self, camera: np.ndarray, board: int, marker: np.ndarray) -> list[np.ndarray]:
        """States of cameras, their board and markers, by their numbers."""
        numbers = {"camera": camera, "board": np.full(len(camera), board), "marker": marker}
        return [self.real[role].states[k] for role, k in numbers.items()]


def sight(things: TrueThings, known: Known, tips: Tips, draw: Draw, rng: np.random.Generator) -> Sight:
    """Cameras and markers as they are; see :mod:`aridcal.prepare.true_things`.

    What is not given stands where the arm shows or sees it from many postures: the best of some places.

    Args:
        things: What the scenario says.
        known: What the campaign knows.
        tips: Where cameras and boards are from each other.
        draw: Draws postures.
        rng: Draws places.

    Raises:
        CampaignError: the markers are given, but not of which of two boards.
    """
    settings = known.settings
    cameras = tuple(settings.cameras)
    looked_at = {name: settings.looked_at(name) for name in cameras}
    sides: list[Carrier] = list(dict.fromkeys(side for name in cameras for side in looked_at[name]))
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
        stated_board = known.boards.get(BOARD + side)
        board = stated_board is not None
        if board:
            labels = tuple(label for label, place in known.markers.items() if place.on == side)
            xyz = np.array([known.markers[label].xyz for label in labels])
            std = np.array([known.markers[label].std for label in labels])
            xyz = xyz + np.where(np.isfinite(std), std, 0.0)[:, None] * rng.standard_normal(xyz.shape)
            stated = things.board or (stated_board if stated_board is not None and stated_board.given else None)
            place = None if stated is None else stated.homogeneous
        elif isinstance(things.markers, dict):
            labels, place = tuple(things.markers), np.eye(4)
            xyz = np.array([things.markers[label] for label in labels])
        else:
            word = "marker" if len(sides) == 1 else f"{side}_marker"
            labels = tuple(f"{word}_{k + 1}" for k in range(things.markers))
            box = AROUND if side == WORLD else AROUND / 3
            xyz, place = rng.uniform(-0.5, 0.5, (len(labels), 3)) * box, None
        if side != WORLD and place is None:
            place = np.eye(4)
        own.append(len(names) + np.arange(len(labels)))
        names += labels
        local.append(xyz)
        places.append(place)
        printed.append(board)
    numbers = tuple(tuple(map(sides.index, looked_at[name])) for name in cameras)
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
        return Sight(real, numbers, tuple(own), tuple(printed), size)

    for c, is_given in enumerate(given):
        on_tip = cams[c, 21] > 0.5
        b = next((k for k in numbers[c] if places[k] is None), numbers[c][0])
        if (on_tip and places[b] is not None) or (not on_tip and is_given):
            continue
        R, p = tips(draw(PLACES), cameras[c], BOARD + sides[b])
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
        looks = tips(draw(TRIED), cameras[c], BOARD + sides[b])
        best, most = tried[0], -1
        for trial in tried:
            if on_tip:
                placed, now = [trial if k == b or at is None else at for k, at in enumerate(places)], cams
            else:
                placed = [np.eye(4) if at is None else at for at in places]
                now = cams.copy()
                now[c, :12] = [*trial[:3, 3], *trial[:3, :3].reshape(-1)]
            count = int(made(now, placed).seen(c, b, *looks).sum())
            if count > most:
                best, most = trial, count
        if on_tip:
            places[b] = best
        else:
            cams[c, :12] = [*best[:3, 3], *best[:3, :3].reshape(-1)]
    return made(cams, [np.eye(4) if at is None else at for at in places])


def draw_images(seen: Sight, cameras: np.ndarray, tips: Tips, draw: Draw, place: str) -> tuple[np.ndarray, np.ndarray]:
    """Readings from which each image shows enough, shape (K, columns), and what it shows, shape (K, markers) bool.

    Of several boards each is in turn what an image must show; others may come into it.

    Args:
        seen: Cameras and markers as they are.
        cameras: Number of the camera of each image, shape (K,).
        tips: Where cameras and boards are from each other.
        draw: Draws postures.
        place: What to name if a camera sees nothing.

    Raises:
        CampaignError: a camera sees the markers from hardly any posture.
    """
    readings = np.empty((len(cameras), draw(1).shape[1]))
    shown = np.zeros((len(cameras), len(seen.real["marker"].names)), dtype=bool)
    for c in np.unique(cameras).tolist():
        boards = seen.boards[c]
        for turn, board in enumerate(boards):
            todo, own = np.flatnonzero(cameras == c)[turn :: len(boards)], seen.markers[board]
            for _ in range(DRAWS):
                if not len(todo):
                    break
                q = draw(POOL)
                markers = seen.shown(c, tips, q)
                good = np.flatnonzero(markers[:, own].any(axis=1))[: len(todo)]
                readings[todo[: len(good)]] = q[good]
                shown[todo[: len(good)]] = markers[good]
                todo = todo[len(good) :]
            if len(todo):
                raise CampaignError(
                    f"{place}: the camera {seen.real['camera'].names[c]} sees the markers on "
                    f"{seen.real['board'].names[board].removeprefix(BOARD)} from hardly any posture of the robot: move camera "
                    "or markers under `truth.instruments`"
                )
    return readings, shown
