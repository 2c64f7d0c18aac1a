"""Ways to measure between the links of a robot with several arms, with what each reads and a campaign of it; for `trees.py`.

Each way knows its rows three times: as joint positions and labels, as residuals of a robot and of the unknown things around
it (for the oracle, which is Pinocchio and nothing of the product), and as the tables and keys of a campaign.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import pinocchio as pin
from scipy.spatial.transform import Rotation
from tree_robot import RANGE, Poses, Robot, placed, reached, turned_by, urdf, with_errors

SIGMA, PIXEL = 1e-4, 0.2
FINGER, BALL = np.array([0.05, 0.02, 0.01]), np.array([0.02, 0.01, 0.1])
MARKS = np.array([[0, 0, 0], [0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04]]) + FINGER
SPOTS = np.array([[0.02, 0, 0.05], [0.06, 0.03, 0.05], [-0.02, 0.03, 0.05], [0.02, -0.04, 0.05], [0.02, 0.02, 0.09]])
LENS = {"fx": 700.0, "fy": 700.0, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}
HANDS = {"left": "left_hand", "right": "right_hand"}
TABLE_NORMAL, TABLE_OFFSET = np.array([0.02, -0.03, 1.0]), 0.05


@dataclass(frozen=True)
class Seen:
    """Rows of one way.

    Attributes:
        q: Joint positions, shape (N, joints).
        label: Of each row: which hand, point or marker, shape (N,).
        observed: What was read, shape (N, m), as the way has it.
        shot: Number of the image of each row, shape (N,).
        agreeing: Of rows that say that a condition holds: joint positions at which it does, noise left out, shape (N, joints).
            Derivatives are taken there (Gauss and Helmert): elsewhere a robot that shrinks would seem to explain the noise.
    """

    q: np.ndarray
    label: np.ndarray
    observed: np.ndarray
    shot: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    agreeing: np.ndarray | None = None


class Way(ABC):
    """A way to measure."""

    name: ClassVar[str]
    kind: ClassVar[str]
    channels: ClassVar[dict[str, tuple[int, float]]]
    """Numbers and noise of each."""
    rows: ClassVar[int] = 240

    @property
    def sigma(self) -> np.ndarray:
        """Noise of each number, shape (m,)."""
        return np.repeat([s for _, s in self.channels.values()], [n for n, _ in self.channels.values()])

    @abstractmethod
    def things(self) -> np.ndarray:
        """True numbers of what is unknown around the robot."""

    @abstractmethod
    def draw(self, robot: Robot, n: int, rng: np.random.Generator, noisy: bool) -> Seen:
        """Rows that the real robot can take."""

    @abstractmethod
    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:
        """Read minus expected, shape (N, m)."""

    @abstractmethod
    def table(self, robot: Robot, rows: Seen) -> pd.DataFrame:
        """The rows as a user has them."""

    @abstractmethod
    def keys(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The block and the instruments of a campaign."""

    def noise(self, n: int, rng: np.random.Generator, noisy: bool) -> np.ndarray:
        """Of n rows, shape (n, m)."""
        return self.sigma * rng.standard_normal((n, len(self.sigma))) * noisy


def touching(
    robot: Robot,
    q: np.ndarray,
    off: Callable[[Robot, np.ndarray, np.ndarray], np.ndarray],
    label: np.ndarray,
    e: np.ndarray,
) -> Seen:
    """Rows near some postures in which something is zero but for noise e, (N, m), as the arms can reach them."""
    arms = [name for name in robot.joints if "_j" in name]
    agreeing, good = reached(robot, q, off, arms)
    noisy, too = reached(robot, agreeing, lambda own, q, k: off(own, q, k) - e[k], arms)
    good &= too
    return Seen(noisy[good], label[good], np.zeros((int(good.sum()), e.shape[1])), agreeing=agreeing[good])


def first(rows: Seen, n: int) -> Seen:
    """The first n of rows that touch something."""
    assert rows.agreeing is not None
    return Seen(rows.q[:n], rows.label[:n], rows.observed[:n], agreeing=rows.agreeing[:n])


def postures(robot: Robot, n: int, rng: np.random.Generator) -> np.ndarray:
    """Anywhere in the range, shape (n, joints)."""
    return rng.uniform(-RANGE, RANGE, (n, len(robot.joints)))


def own_joints(robot: Robot, rows: Seen, **columns: Any) -> pd.DataFrame:
    """Readings, and other columns."""
    return pd.DataFrame(dict(zip(robot.joints, rows.q.T, strict=True)) | columns)


def _between(robot: Robot, q: np.ndarray, start: str, end: str) -> Poses:
    """Poses of one link in another's frame."""
    places = robot.places(q, [start, end])
    return places[start].inverse() @ places[end]


def _by_label(made: dict[str, Poses], label: np.ndarray) -> Poses:
    """Of each row the pose that its label names."""
    R, p = np.empty((len(label), 3, 3)), np.empty((len(label), 3))
    for name, poses in made.items():
        own = label == name
        R[own], p[own] = poses.R[own], poses.p[own]
    return Poses(R, p)


class Tracker(Way):
    """A tracker sees a target on each hand, in turn: poses."""

    name, kind = "poses", "pose"
    channels: ClassVar = {"position": (3, SIGMA), "rotation": (3, SIGMA)}

    def __init__(self, *sides: str) -> None:
        self.sides = sides or tuple(HANDS)

    def things(self) -> np.ndarray:
        """Tripod, then place and turn of each target."""
        targets = [[0.05, 0.02, 0.01 * (k + 1), 0.1, 0.2 - 0.1 * k, 0.3] for k in range(len(self.sides))]
        return np.array([2.0, -1.0, 0.5, 0.3, -0.2, 2.0, *np.ravel(targets)])

    def expected(self, robot: Robot, things: np.ndarray, q: np.ndarray, label: np.ndarray) -> Poses:
        """Poses of the targets in the tracker's frame."""
        tripod, *targets = map(placed, things.reshape(-1, 6))
        places = robot.places(q, [f"{side}_hand" for side in self.sides])
        on = zip(self.sides, targets, strict=True)
        return tripod @ _by_label({side: places[f"{side}_hand"] @ target for side, target in on}, label)

    def draw(self, robot: Robot, n: int, rng: np.random.Generator, noisy: bool) -> Seen:  # noqa: D102
        q, label = postures(robot, n, rng), np.array(self.sides)[np.arange(n) % len(self.sides)]
        seen, e = self.expected(robot, self.things(), q, label), self.noise(n, rng, noisy)
        R = Rotation.from_rotvec(e[:, -3:] if len(self.channels) == 2 else 0.0 * e).as_matrix() @ seen.R
        return Seen(q, label, np.hstack([seen.p + e[:, :3], R.reshape(n, 9)]))

    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:  # noqa: D102
        seen = self.expected(robot, things, rows.q, rows.label)
        turned = turned_by(rows.observed[:, 3:].reshape(-1, 3, 3), seen.R)
        return np.hstack([rows.observed[:, :3] - seen.p, turned])

    def table(self, robot: Robot, rows: Seen) -> pd.DataFrame:  # noqa: D102
        quaternion = Rotation.from_matrix(rows.observed[:, 3:].reshape(-1, 3, 3)).as_quat()
        read = dict(zip(["qx", "qy", "qz", "qw"], quaternion.T, strict=True)) if len(self.channels) == 2 else {}
        place = dict(zip(["x", "y", "z"], rows.observed[:, :3].T, strict=True))
        return own_joints(robot, rows, target=rows.label, **place, **read)

    def keys(self) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: D102
        return {}, {"targets": {side: {"on": f"{side}_hand"} for side in self.sides}}


class Reflectors(Tracker):
    """A tracker sees a reflector on each hand, in turn: positions."""

    name, kind = "positions", "position"
    channels: ClassVar = {"position": (3, SIGMA)}
    rows = 360

    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:  # noqa: D102
        return super().residual(robot, things, rows)[:, :3]


class Eye(Way):
    """The camera on the head sees four markers on either hand: the markers' places on their boards are known."""

    name, kind = "camera", "pixels"
    channels: ClassVar = {"pixel": (2, PIXEL)}
    rows = 960

    def things(self) -> np.ndarray:
        """The camera on its link, then each board on its hand."""
        return np.array([0.003, -0.002, 0.004, 0.01, -0.02, 0.01, *np.zeros(12)])

    def _marks(self, robot: Robot, things: np.ndarray, q: np.ndarray, label: np.ndarray) -> np.ndarray:
        """Places of marks in the camera's frame, shape (N, 3)."""
        camera, *boards = map(placed, things.reshape(-1, 6))
        whole, number = np.unique(q, axis=0, return_inverse=True)
        places = robot.places(whole, ["camera", *HANDS.values()])
        eye = (places["camera"] @ camera).inverse()
        seen = {side: (eye @ places[hand] @ board)[number]
                for (side, hand), board in zip(HANDS.items(), boards, strict=True)}  # fmt: skip
        side = np.char.partition(label, "_")
        return _by_label(seen, side[:, 0]).act(MARKS[side[:, 2].astype(int)])

    @staticmethod
    def _pixels(at: np.ndarray) -> np.ndarray:
        return np.array([700.0, 700.0]) * at[:, :2] / at[:, 2:] + np.array([319.5, 239.5])

    def draw(self, robot: Robot, n: int, rng: np.random.Generator, noisy: bool) -> Seen:  # noqa: D102
        names = np.array([f"{side}_{k}" for side in HANDS for k in range(4)])
        q: list[np.ndarray] = []
        label: list[np.ndarray] = []
        shot: list[np.ndarray] = []
        count = 0
        while sum(len(some) for some in label) < n:
            some = postures(robot, 200, rng)
            at = self._marks(robot, self.things(), np.repeat(some, 8, axis=0), np.tile(names, 200))
            pixels = self._pixels(at)
            good = (at[:, 2] > 0.15) & (np.abs(pixels - [320, 240]) < [305, 225]).all(axis=1)
            for k, own in enumerate(good.reshape(200, 8)):
                if own.sum() >= 4:
                    label.append(names[own])
                    q.append(np.tile(some[k], (own.sum(), 1)))
                    shot.append(np.full(own.sum(), count))
                    count += 1
        whole, label_, shot_ = np.vstack(q)[:n], np.concatenate(label)[:n], np.concatenate(shot)[:n]
        read = self._pixels(self._marks(robot, self.things(), whole, label_)) + self.noise(n, rng, noisy)
        return Seen(whole, label_, read, shot_)

    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:  # noqa: D102
        return rows.observed - self._pixels(self._marks(robot, things, rows.q, rows.label))

    def table(self, robot: Robot, rows: Seen) -> pd.DataFrame:  # noqa: D102
        u, v = rows.observed.T
        return own_joints(robot, rows, marker=rows.label, u=u, v=v, shot=rows.shot)

    def keys(self) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: D102
        boards = [{"file": f"{side}_marks.csv", "on": hand} for side, hand in HANDS.items()]
        return {"camera": "eye"}, {"cameras": {"eye": {**LENS, "on": "camera"}}, "markers": boards}


class Ballbar(Way):
    """A bar from a ball on the right hand to the left finger: distances."""

    name, kind = "ballbar", "distance"
    channels: ClassVar = {"distance": (1, SIGMA)}
    rows = 480

    def things(self) -> np.ndarray:
        """The ball and the finger on their hands."""
        return np.concatenate([BALL, FINGER])

    def _length(self, robot: Robot, things: np.ndarray, q: np.ndarray) -> np.ndarray:
        finger = _between(robot, q, "right_hand", "left_hand").act(things[3:])
        return np.linalg.norm(finger - things[:3], axis=1)[:, None]

    def draw(self, robot: Robot, n: int, rng: np.random.Generator, noisy: bool) -> Seen:  # noqa: D102
        q = postures(robot, n, rng)
        return Seen(q, np.full(n, ""), self._length(robot, self.things(), q) + self.noise(n, rng, noisy))

    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:  # noqa: D102
        return rows.observed - self._length(robot, things, rows.q)

    def table(self, robot: Robot, rows: Seen) -> pd.DataFrame:  # noqa: D102
        return own_joints(robot, rows, distance=rows.observed[:, 0])

    def keys(self) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: D102
        ball = {"on": "right_hand", "xyz": BALL.tolist(), "offset": 0.0, "identify": ["place"]}
        finger = {"on": "left_hand", "xyz": FINGER.tolist()}
        return {"target": "finger"}, {"anchors": {"ball": ball}, "targets": {"finger": finger}}


class SelfTouch(Way):
    """The left finger touches five spots of known places on the right hand."""

    name, kind = "self-touch", "point"
    channels: ClassVar = {"position": (3, SIGMA)}

    def things(self) -> np.ndarray:
        """The finger on its hand."""
        return FINGER.copy()

    def _apart(self, robot: Robot, things: np.ndarray, q: np.ndarray, label: np.ndarray) -> np.ndarray:
        finger = _between(robot, q, "right_hand", "left_hand").act(things)
        return np.asarray(finger - SPOTS[label.astype(int)])

    def draw(self, robot: Robot, n: int, rng: np.random.Generator, noisy: bool) -> Seen:  # noqa: D102
        start, label = postures(robot, 4 * n, rng), (np.arange(4 * n) % 5).astype(str)
        e = self.noise(4 * n, rng, noisy)
        every = touching(robot, start, lambda own, q, k: self._apart(own, self.things(), q, label[k]), label, e)
        return first(every, n)

    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:  # noqa: D102
        return -self._apart(robot, things, rows.q, rows.label)

    def table(self, robot: Robot, rows: Seen) -> pd.DataFrame:  # noqa: D102
        return own_joints(robot, rows, point=rows.label)

    def keys(self) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: D102
        finger = {"on": "left_hand", "xyz": FINGER.tolist()}
        return {"target": "finger"}, {
            "points": {"file": "spots.csv", "on": "right_hand"},
            "targets": {"finger": finger},
        }


class Table(Way):
    """Both fingers touch one table, whose place is unknown."""

    name, kind = "table", "plane"
    channels: ClassVar = {"distance": (1, SIGMA)}
    rows = 480

    def things(self) -> np.ndarray:
        """Normal times offset is redundant in length: two tilts and the offset; then both fingers."""
        return np.array([0.0, 0.0, TABLE_OFFSET, *FINGER, *BALL])

    def _off(self, robot: Robot, things: np.ndarray, q: np.ndarray, label: np.ndarray) -> np.ndarray:
        places = robot.places(q, list(HANDS.values()))
        fingers = {"left": things[3:6], "right": things[6:]}
        tip = _by_label({side: places[HANDS[side]] for side in HANDS}, label).act(
            np.array([fingers[side] for side in label])
        )
        normal = TABLE_NORMAL + np.array([*things[:2], 0.0])
        return (tip @ (normal / np.linalg.norm(normal)) - things[2])[:, None]

    def draw(self, robot: Robot, n: int, rng: np.random.Generator, noisy: bool) -> Seen:  # noqa: D102
        label = np.array(["left", "right"])[np.arange(3 * n) % 2]
        start, e = postures(robot, 3 * n, rng), self.noise(3 * n, rng, noisy)
        every = touching(robot, start, lambda own, q, k: self._off(own, self.things(), q, label[k]), label, e)
        return first(every, n)

    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:  # noqa: D102
        return -self._off(robot, things, rows.q, rows.label)

    def table(self, robot: Robot, rows: Seen) -> pd.DataFrame:  # noqa: D102
        return own_joints(robot, rows, target=rows.label)

    def keys(self) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: D102
        targets = {
            "left": {"on": "left_hand", "xyz": FINGER.tolist()},
            "right": {"on": "right_hand", "xyz": BALL.tolist()},
        }
        return {}, {"planes": {"desk": {"on": "torso", "normal": [0, 0, 1], "offset": 0.04}}, "targets": targets}


class Bar(Way):
    """Both hands hold one bar, which is taken anew six times: an unknown pose of the one hand in the other each time."""

    name, kind = "joined", "joined"
    channels: ClassVar = {"position": (3, SIGMA), "rotation": (3, SIGMA)}
    grasps: ClassVar = 6
    wanders: ClassVar = 0.4
    """[rad], 1 sigma: of joints about the posture of a grasp, before the hands meet it."""

    def _homes(self, robot: Robot) -> np.ndarray:
        """Postures in which the nominal robot takes the bar, shape (grasps, joints)."""
        return np.random.default_rng(11).uniform(-0.7, 0.7, (self.grasps, len(robot.joints)))

    def things(self) -> np.ndarray:
        """Place and turn of the right hand in the left one, of each grasp."""
        robot = Robot(pin.buildModelFromXML(urdf().decode()), np.zeros((0, 6)))
        nominal = with_errors(robot, np.zeros(6 * (len(robot.joints) + len(robot.ends))), ())
        held = _between(nominal, self._homes(nominal), *HANDS.values())
        return np.hstack([held.p, Rotation.from_matrix(held.R).as_rotvec()]).ravel()

    def residual(self, robot: Robot, things: np.ndarray, rows: Seen) -> np.ndarray:  # noqa: D102
        each = [placed(own) for own in things.reshape(-1, 6)]
        held = _by_label({str(k): Poses(*(np.broadcast_to(x, (len(rows.label), *x.shape)) for x in (own.R, own.p)))
                          for k, own in enumerate(each)}, rows.label)  # fmt: skip
        seen = _between(robot, rows.q, *HANDS.values())
        return np.hstack([held.p - seen.p, turned_by(held.R, seen.R)])

    def draw(self, robot: Robot, n: int, rng: np.random.Generator, noisy: bool) -> Seen:  # noqa: D102
        number = np.arange(4 * n) % self.grasps
        start = self._homes(robot)[number] + self.wanders * rng.standard_normal((4 * n, len(robot.joints)))
        label, e, held = number.astype(str), self.noise(4 * n, rng, noisy), self.things()

        def off(own: Robot, q: np.ndarray, k: np.ndarray) -> np.ndarray:
            return -self.residual(own, held, Seen(q, label[k], np.zeros((len(q), 6))))

        return first(touching(robot, np.clip(start, -RANGE, RANGE), off, label, e), n)

    def table(self, robot: Robot, rows: Seen) -> pd.DataFrame:  # noqa: D102
        return own_joints(robot, rows, grasp=rows.label)

    def keys(self) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: D102
        return {"links": list(HANDS.values())}, {}


WAYS: dict[str, Way] = {
    way.name: way for way in (Tracker(), Reflectors(), Eye(), Ballbar(), SelfTouch(), Table(), Bar())
}
