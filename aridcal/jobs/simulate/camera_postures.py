"""Readings of a simulated arm from which its cameras see their markers; where cameras and boards stand for that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.instruments.pixels import faces, in_image
from aridcal.engine.instruments.setup import WORLD
from aridcal.files.instrument_settings import Carrier
from aridcal.files.things import BOARD_PREFIX, InstrumentDeclarations
from aridcal.jobs.simulate.true_things import (
    FACING,
    MARKER_BOX,
    RANGE_OF_TIP,
    RANGE_OF_WORLD,
    RealCamera,
    RealThings,
    TrueCamera,
    TrueThings,
    real_camera,
    state_of_place,
)
from aridcal.system.errors import CampaignError

FEWEST_MARKERS = 4
"""Markers of a board in a usable image, or all if there are fewer."""

POOL, DRAWS = 1000, 200
"""Postures that are drawn at once, and how often for one camera."""

PLACES, TRIED = 15, 400
"""Places that are drawn for a board or a camera, and postures on which they are compared."""

MARKERS_AT_ONCE = 100_000
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

    real: dict[str, RealThings]
    boards: tuple[tuple[int, ...], ...]
    markers: tuple[np.ndarray, ...]
    printed: tuple[bool, ...]
    size: np.ndarray

    @property
    def board_of(self) -> np.ndarray:
        """Number of each marker's board, shape (markers,)."""
        return np.repeat(np.arange(len(self.markers)), [len(own) for own in self.markers])

    def shown(self, camera: int, tips: Tips, readings: np.ndarray) -> np.ndarray:
        """Markers that a camera sees in some postures, shape (n, markers) bool: of boards of which it sees enough."""
        markers = np.zeros((len(readings), len(self.real["marker"].names)), dtype=bool)
        for board in self.boards[camera]:
            on_board = self.seen(camera, board, *self.poses(camera, board, tips, readings))
            enough = on_board.sum(axis=1) >= min(FEWEST_MARKERS, on_board.shape[1])
            markers[:, self.markers[board]] = on_board & enough[:, None]
        return markers

    def poses(self, camera: int, board: int, tips: Tips, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of a camera's carrier, or of its board's, see :data:`Tips`; camera and board by their numbers."""
        return tips(readings, self.real["camera"].names[camera], self.real["board"].names[board])

    def seen(self, camera: int, board: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Markers of a board that a camera sees from poses, see :data:`Tips`, shape (n, M) bool."""
        step = max(1, MARKERS_AT_ONCE // len(self.markers[board]))
        parts = [self._seen(camera, board, R[k : k + step], p[k : k + step]) for k in range(0, len(R), step)]
        return np.concatenate(parts)

    def _seen(self, camera: int, board: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        markers, n = self.markers[board], len(R)
        m, index = len(markers), np.repeat(np.arange(n), len(markers))
        states = self.states(np.full(n * m, camera), board, np.tile(markers, n))
        visible = in_image(R[index], p[index], states, self.size[camera]).reshape(n, m)
        if self.printed[board]:
            cameras, boards, _ = self.states(np.full(n, camera), board, np.zeros(n, int))
            visible &= faces(R, p, cameras, boards)[:, None]
        return visible

    def states(self, camera: np.ndarray, board: int, marker: np.ndarray) -> list[np.ndarray]:
        """States of cameras, their board and markers, by their numbers."""
        numbers = {"camera": camera, "board": np.full(len(camera), board), "marker": marker}
        return [self.real[role].states[k] for role, k in numbers.items()]


@dataclass(frozen=True)
class _Board:
    """Markers on one carrier: those of a board, or some that lie about.

    Attributes:
        carrier: What they are on.
        labels: Of the markers.
        xyz: In the board's frame, shape (M, 3), [m].
        printed: Whether they are a board's, seen from the front alone.
        place: Of the board in its carrier's frame, shape (4, 4), [m]; None: to be found.
    """

    carrier: Carrier
    labels: tuple[str, ...]
    xyz: np.ndarray
    printed: bool
    place: np.ndarray | None


@dataclass(frozen=True)
class _Setup:
    """Cameras and boards while their places are being found.

    Attributes:
        cameras: By name.
        boards: What they look at.
        looked_at: Numbers of the boards that each camera looks at.
        size: Of each camera's images, shape (C, 2), [px].
    """

    cameras: dict[str, RealCamera]
    boards: tuple[_Board, ...]
    looked_at: tuple[tuple[int, ...], ...]
    size: np.ndarray

    def with_camera(self, name: str, place: np.ndarray) -> _Setup:
        """The setup with a camera somewhere."""
        return replace(self, cameras=self.cameras | {name: replace(self.cameras[name], place=place)})

    def with_board(self, number: int, place: np.ndarray) -> _Setup:
        """The setup with a board somewhere."""
        boards = [replace(b, place=place) if k == number else b for k, b in enumerate(self.boards)]
        return replace(self, boards=tuple(boards))

    def sight(self, elsewhere: np.ndarray) -> Sight:
        """What is seen in this setup, boards without a place being ``elsewhere``.

        Markers that lie about have no board of their own: theirs is their carrier's frame.
        """
        boards, markers, numbers, first = [], [], [], 0
        for board in self.boards:
            T = elsewhere if board.place is None else board.place
            boards.append(state_of_place(T if board.printed else np.eye(4)))
            markers.append(board.xyz if board.printed else board.xyz @ T[:3, :3].T + T[:3, 3])
            numbers.append(first + np.arange(len(board.labels)))
            first += len(board.labels)
        real = {
            "camera": RealThings(tuple(self.cameras), np.array([camera.state for camera in self.cameras.values()])),
            "board": RealThings(tuple(BOARD_PREFIX + board.carrier for board in self.boards), np.array(boards)),
            "marker": RealThings(tuple(n for board in self.boards for n in board.labels), np.concatenate(markers)),
        }
        printed = tuple(board.printed for board in self.boards)
        return Sight(real, self.looked_at, tuple(numbers), printed, self.size)


def sight(
    things: TrueThings, declarations: InstrumentDeclarations, tips: Tips, draw: Draw, rng: np.random.Generator
) -> Sight:
    """Cameras and markers as they are; see :mod:`aridcal.jobs.simulate.true_things`.

    What is not given stands where the arm shows or sees it from many postures: the best of some places.

    Args:
        things: What the scenario says.
        declarations: What the campaign knows.
        tips: Where cameras and boards are from each other.
        draw: Draws postures.
        rng: Draws places.

    Raises:
        CampaignError: the markers are given, but not of which of two boards.
    """
    settings = declarations.settings
    looked_at = {name: settings.looked_at(name) for name in settings.cameras}
    carriers: list[Carrier] = list(dict.fromkeys(carrier for each in looked_at.values() for carrier in each))
    if len(carriers) > 1 and isinstance(things.markers, dict):
        raise CampaignError(
            f"{declarations.origin}: truth.instruments.markers: there are cameras on the tip and beside the arm; write a number, "
            "and each sees so many of its own"
        )
    setup = _Setup(
        {name: real_camera(declarations, name, things.cameras.get(name, TrueCamera())) for name in settings.cameras},
        tuple(_board(carrier, len(carriers) == 1, things, declarations, rng) for carrier in carriers),
        tuple(tuple(map(carriers.index, each)) for each in looked_at.values()),
        np.array([[camera.width, camera.height] for camera in settings.cameras.values()], dtype=float),
    )
    for number in range(len(setup.cameras)):
        setup = _with_places(setup, number, tips, draw)
    return setup.sight(np.eye(4))


def _board(
    carrier: Carrier, alone: bool, things: TrueThings, declarations: InstrumentDeclarations, rng: np.random.Generator
) -> _Board:
    """The markers on a carrier; those of the world have no place yet where nobody says it.

    Args:
        carrier: What they are on.
        alone: Whether all markers are on it.
        things: What the scenario says.
        declarations: What the campaign knows.
        rng: Draws markers, and how a printed board's are off.
    """
    place: np.ndarray | None = None
    board = declarations.boards.get(BOARD_PREFIX + carrier)
    if board is not None:
        markers = {label: marker for label, marker in declarations.markers.items() if marker.on == carrier}
        labels = tuple(markers)
        std = np.array([marker.std for marker in markers.values()])
        xyz = np.array([marker.xyz for marker in markers.values()])
        xyz = xyz + np.where(np.isfinite(std), std, 0.0)[:, None] * rng.standard_normal(xyz.shape)
        stated = things.board or (board if board.given else None)
        place = None if stated is None else stated.homogeneous
    elif isinstance(things.markers, dict):
        labels, xyz, place = tuple(things.markers), np.array([*things.markers.values()]), np.eye(4)
    else:
        word = "marker" if alone else f"{carrier}_marker"
        labels = tuple(f"{word}_{k + 1}" for k in range(things.markers))
        xyz = rng.uniform(-0.5, 0.5, (len(labels), 3)) * (MARKER_BOX if carrier == WORLD else MARKER_BOX / 3)
    if carrier != WORLD and place is None:
        place = np.eye(4)
    return _Board(carrier, labels, xyz, board is not None, place)


def _with_places(setup: _Setup, number: int, tips: Tips, draw: Draw) -> _Setup:
    """The setup with the place that a camera lacks, where it sees most: its board's if it is on the tip, else its own."""
    name, camera = list(setup.cameras.items())[number]
    looked_at = setup.looked_at[number]
    b = next((k for k in looked_at if setup.boards[k].place is None), looked_at[0])
    board = setup.boards[b]
    if board.place is not None if camera.on_tip else camera.given:
        return setup
    board_name = BOARD_PREFIX + board.carrier
    carrier_places = np.tile(
        np.eye(4), (PLACES, 1, 1)
    )  # places of the camera's carrier in the board's, or the other way round
    carrier_places[:, :3, :3], carrier_places[:, :3, 3] = tips(draw(PLACES), name, board_name)
    view = _looking_at(board.xyz.mean(axis=0), RANGE_OF_TIP if camera.on_tip else RANGE_OF_WORLD)
    carrier_poses = tips(draw(TRIED), name, board_name)

    def count_seen(candidate: _Setup, elsewhere: np.ndarray) -> int:
        return int(candidate.sight(elsewhere).seen(number, b, *carrier_poses).sum())

    if camera.on_tip:
        places = carrier_places @ camera.place @ np.linalg.inv(view)
        return setup.with_board(b, max(places, key=lambda place: count_seen(setup.with_board(b, place), place)))
    assert board.place is not None
    places = carrier_places @ board.place @ view
    return setup.with_camera(name, max(places, key=lambda place: count_seen(setup.with_camera(name, place), np.eye(4))))


def _looking_at(middle: np.ndarray, distance: float) -> np.ndarray:
    """Pose in a board's frame of a camera that looks straight at a place of it from so far, shape (4, 4), [m]."""
    view = np.eye(4)
    view[:3, :3] = FACING
    view[:3, 3] = middle + [0.0, 0.0, distance]
    return view


def draw_images(sight: Sight, cameras: np.ndarray, tips: Tips, draw: Draw, place: str) -> tuple[np.ndarray, np.ndarray]:
    """Readings from which each image shows enough, shape (K, columns), and the markers in it, shape (K, markers) bool.

    Of several boards each is in turn what an image must show; others may come into it.

    Args:
        sight: Cameras and markers as they are.
        cameras: Number of the camera of each image, shape (K,).
        tips: Where cameras and boards are from each other.
        draw: Draws postures.
        place: What to name if a camera sees nothing.

    Raises:
        CampaignError: a camera sees the markers from hardly any posture.
    """
    readings = np.empty((len(cameras), draw(1).shape[1]))
    shown = np.zeros((len(cameras), len(sight.real["marker"].names)), dtype=bool)
    for c in np.unique(cameras).tolist():
        boards = sight.boards[c]
        for turn, board in enumerate(boards):
            missing, board_markers = np.flatnonzero(cameras == c)[turn :: len(boards)], sight.markers[board]
            for _ in range(DRAWS):
                if not len(missing):
                    break
                q = draw(POOL)
                markers = sight.shown(c, tips, q)
                usable = np.flatnonzero(markers[:, board_markers].any(axis=1))[: len(missing)]
                readings[missing[: len(usable)]] = q[usable]
                shown[missing[: len(usable)]] = markers[usable]
                missing = missing[len(usable) :]
            if len(missing):
                raise CampaignError(
                    f"{place}: the camera {sight.real['camera'].names[c]} sees the markers on "
                    f"{sight.real['board'].names[board].removeprefix(BOARD_PREFIX)} from hardly any posture of the robot: move "
                    f"camera "
                    "or markers under `truth.instruments`"
                )
    return readings, shown
