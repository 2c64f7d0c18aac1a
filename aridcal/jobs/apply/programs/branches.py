"""How the controller stands at poses: its own inverse kinematics, with the nominal arm, and which of its answers.

Of several answers it takes the nearest to where it comes from, of those that agree with what the program says of the posture.
Where an arm comes from is the answer of the pose before, so that a program is a chain; many poses are nevertheless worked out
at once: what each comes from is guessed, and what comes out otherwise is worked out again until nothing changes. As each pose
depends only on the one before, that is what a walk along the chain gives, whatever was guessed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from aridcal.engine.inverse.many_poses import MOST_STEPS, ROWS_AT_ONCE, ArmRows, InverseRows, SearchEnd
from aridcal.engine.inverse.one_pose import MOST_UNAVOIDABLE, InverseKinematics
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.kinematics import tip_frames

REACHED_TOLERANCE = 1e-7
"""What counts as reached of the nominal arm, [m] and [rad]: far below what any arm repeats."""

STARTS = 60
"""Drawn over the joints' ranges: four of five come to a pose, so that each of the eight positions of a six-axis arm is missed by
all of them two times in a thousand."""

FIRST_BRANCHES = 6
"""Of them, for a first look at what other positions there are: half of an arm's eight, as a rule."""

AROUND, KICK = 6, 0.3
"""Starts close by, and how far they are, [rad] or [m]: with an elbow nearly straight a search may end on its other side, which is
further away, and one from there on the nearer."""

SAME_POSITION = 1e-4
"""Readings that differ by less are the same position of the arm, [rad] or [m]."""

UNMOVED_READING = 1e-6
"""Readings that differ by less are those from before: far more than what a search rounds, [rad] or [m]."""

SAME_BRANCH_FACTOR = 8.0
"""Times the way within which no other position can be: a search that starts where the arm comes from and ends so close by is
trusted not to have passed one, which must be on its way then."""

FAR_START = 2.0
"""[rad] or [m], all joints together: what comes from further away may come to any position, so that all are looked for."""

SPREAD, FURTHEST, UPHILL = 500, 20, 40
"""Configurations from which the arm's reach is sought, how many of them go uphill, and in how many steps: twice as many of each
change it by less than a thousandth."""

REACH_FACTOR = 1.01
"""Times that reach beyond which nothing is looked for: what the search for it may lack, ten times over."""

UNLIMITED_START = np.pi
"""Joints without limits are started within half a turn, [rad] or [m]."""

TURN = 2.0 * np.pi
"""Once round, [rad]."""

WHOLE_TURNS = (-2, -1, 0, 1, 2)
"""Whole turns by which joints are turned to agree with words: controllers count no more."""

QUICK = 8
"""Steps of a search for a guess: what takes longer is worked out where it matters."""

ANCHORS = 32
"""A pose of so many is solved first, one after the other, so that all others have a start close by."""

SWEEPS = 16
"""How often poses are worked out again before those left are guessed anew from what is certain by then."""

NARROW, USUAL, BROAD = 16, 256, 2048
"""Poses that are guessed together: as usual at first, more as long as guesses are right, fewer where they are not."""

Fits = Callable[[np.ndarray], bool]
"""Whether readings, shape (columns,), agree with what a program says of the posture."""


def flanges(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """T_base_tip of the nominal arm in many configurations, shape (n, 4, 4)."""
    T_base_flange = np.zeros((len(readings), 4, 4))
    if len(readings):
        T_base_flange[:, :3, :3], T_base_flange[:, :3, 3] = tip_frames(robot, readings)
    T_base_flange[:, 3, 3] = 1.0
    return T_base_flange


def flange(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """T_base_tip of the nominal arm, shape (4, 4)."""
    return np.asarray(flanges(robot, readings[None])[0])


def controller(robot: Robot) -> InverseKinematics:
    """Inverse kinematics of the nominal arm for one pose, from base to tip."""
    low, high = robot.limits.T
    turning = np.array([kind != "prismatic" for kind in robot.kinds])
    return InverseKinematics(
        OneRowModel(Model(robot, ()), np.zeros(0)), low, high, turning, True, (REACHED_TOLERANCE, REACHED_TOLERANCE)
    )


Memory = dict[bytes, np.ndarray]
"""Ends of searches over all readings, by :meth:`Poses.key`."""


@dataclass(frozen=True)
class Poses:
    """Where the tip is to be, and what the program says of how the arm stands there; n of them.

    Attributes:
        wanted: T_base_tip, shape (n, 4, 4).
        held: Readings that stay, shape (n, columns), NaN where they do not.
        fits: Whether a posture is the one that is stated, n of them; None where nothing is stated.
    """

    wanted: np.ndarray
    held: np.ndarray
    fits: Sequence[Fits | None]

    def __len__(self) -> int:
        return len(self.wanted)

    def __getitem__(self, rows: np.ndarray) -> Poses:
        return Poses(self.wanted[rows], self.held[rows], [self.fits[k] for k in rows.tolist()])

    def key(self, row: int) -> bytes:
        """What an answer of a search over all readings depends on."""
        return self.wanted[row].tobytes() + self.held[row].tobytes()


@dataclass(frozen=True)
class Chain:
    """Targets one after the other, n of them.

    Attributes:
        joints: Those that are readings, shape (n,) bool; the others are poses.
        given: Their readings, shape (n, columns), NaN where those of the target before hold.
        poses: The others; of readings only the number of rows matters.
        near: Readings that the controller starts from by the program's word, shape (n, columns), NaN where it says nothing.
    """

    joints: np.ndarray
    given: np.ndarray
    poses: Poses
    near: np.ndarray

    @cached_property
    def depends(self) -> np.ndarray:
        """Targets for which it matters where the arm comes from, shape (n,)."""
        return np.asarray(np.isnan(np.where(self.joints[:, None], self.given, self.near)).any(axis=1))


@dataclass(frozen=True)
class Controller:
    """What a controller makes of poses.

    Attributes:
        robot: The nominal arm.
    """

    robot: Robot

    @cached_property
    def inverse(self) -> InverseRows:
        """Inverse kinematics of the nominal arm, a radian as much as a metre."""
        low, high = self.robot.limits.T
        turning = np.array([kind != "prismatic" for kind in self.robot.kinds])
        return InverseRows(ArmRows(Model(self.robot, ()), np.zeros(0)), low, high, turning, 1.0)

    @cached_property
    def one(self) -> InverseKinematics:
        """The same for one pose."""
        return controller(self.robot)

    @cached_property
    def reach(self) -> float:
        """The furthest that the tip gets from the first joint, [m]: uphill from the furthest of many configurations."""
        q = self._drawn(1, SPREAD)[0]
        for _ in range(UPHILL):
            _, p, J = self.inverse.arm.looks(q, {})
            out = p - self.robot.onward[0].translation
            far = np.linalg.norm(out, axis=1)
            furthest = np.argsort(far)[-FURTHEST:]
            way = np.einsum("nij,ni->nj", J[:, :3], out / np.maximum(far, REACHED_TOLERANCE)[:, None])[furthest]
            q = np.clip(
                q[furthest] + way / max(float(far.max()), REACHED_TOLERANCE), self.inverse.low, self.inverse.high
            )
        return float(far.max())

    def too_far(self, poses: np.ndarray) -> np.ndarray:
        """Poses that are further away than the arm gets, whatever its joints do, shape (n,)."""
        apart = np.linalg.norm(poses[:, :3, 3] - self.robot.onward[0].translation, axis=1)
        drawn_out = ~self.inverse.turning & ~np.isfinite(self.inverse.high - self.inverse.low)
        return np.asarray((apart > REACH_FACTOR * self.reach) & (not drawn_out.any()))

    @cached_property
    def unlimited(self) -> InverseRows:
        """The same arm without limits: what it finds beyond them tells why a pose is out of reach."""
        none = np.full(len(self.inverse.low), np.inf)
        return replace(self.inverse, low=-none, high=none)

    def redundant(self, fixed: np.ndarray) -> bool:
        """Whether the arm may reach a pose in ways without number, so that each depends on the one before by small amounts."""
        free = np.isnan(fixed) & (self.inverse.low < self.inverse.high)
        return bool((free.sum(axis=1) > 6).any())

    def settle(
        self, poses: np.ndarray, seeds: np.ndarray, fixed: np.ndarray, steps: int = MOST_STEPS
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where a search from each seed ends, shape (n, columns); whether the tip is there, (n,); and the Jacobian there."""
        end = self.inverse.approach(poses, seeds, fixed, {}, steps)
        return end.readings, self._there(end), end.J

    def _there(self, end: SearchEnd) -> np.ndarray:
        allowed = MOST_UNAVOIDABLE if end.readings.shape[1] < 6 else REACHED_TOLERANCE
        off = np.maximum(np.linalg.norm(end.error[:, :3], axis=1), np.linalg.norm(end.error[:, 3:], axis=1))
        return np.asarray(off < allowed)

    # --- the nearest position -------------------------------------------------------------------------------------------

    def nearest(
        self, poses: Poses, near: np.ndarray, guess: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, np.ndarray]:
        """The arm's position at each pose that fits, the nearest to where it comes from.

        Args:
            poses: N of them.
            near: Readings that it comes from, shape (n, columns).
            guess: Readings that may be the answer, likewise; they have no other part in it.
            memory: What was found of these poses before.

        Returns:
            Readings, shape (n, columns), those that it comes from where there is none; and whether there is one.
        """
        positions, there = near.copy(), np.zeros(len(poses), dtype=bool)
        every = np.arange(len(poses))
        searched = np.array([poses.key(k) in memory for k in every.tolist()], dtype=bool) if memory else every < 0
        remaining, far = every[~searched], searched.copy()
        for seeds, steps, close in ((guess, 0, 1.0), (near, MOST_STEPS, SAME_BRANCH_FACTOR)):
            some, at = poses[remaining], near[remaining]
            q, reached, J = self.settle(some.wanted, seeds[remaining], some.held, steps)
            q = self._turned_towards(q, at, some.held)
            inside = ((q >= self.inverse.low - SAME_POSITION) & (q <= self.inverse.high + SAME_POSITION)).all(axis=1)
            ok = reached & inside & self._alone(q, at, J, some.held, close)
            for k in np.flatnonzero(ok).tolist():
                fits = some.fits[k]
                ok[k] = fits is None or fits(q[k])
            positions[remaining[ok]], there[remaining[ok]] = q[ok], True
            far[remaining] = ~reached | (np.linalg.norm(q - at, axis=1) > FAR_START)
            remaining = remaining[~ok]
        self._around(poses, near, remaining[~far[remaining]], positions, there)
        self._everywhere(poses, near, every[~there], positions, there, memory)
        return positions, there

    def _turned_towards(self, q: np.ndarray, near: np.ndarray, fixed: np.ndarray) -> np.ndarray:
        """Readings (n, columns) turned by whole turns to be as near to others as may be."""
        return q + TURN * np.where(self.inverse.turning & np.isnan(fixed), np.round((near - q) / TURN), 0.0)

    def _alone(self, q: np.ndarray, near: np.ndarray, J: np.ndarray, fixed: np.ndarray, close: float) -> np.ndarray:
        r"""Whether no other position is likely to be as near to where the arm comes from, shape (n,).

        Along a straight line d in the readings the tip's way is :math:`J d + \frac{1}{2} H d^2`; it is back at its place for
        :math:`|d| \ge 2 \sigma_{min}(J) / |H|` at the earliest, and the curvature H is the arm's length at most, or thereabouts.
        """
        free = np.isnan(fixed) & (self.inverse.low < self.inverse.high)
        A = J * free[:, None]
        back = A.transpose(0, 2, 1)
        H = A @ back if A.shape[2] >= 6 else back @ A
        if A.shape[2] < 6:
            H[:, range(H.shape[1]), range(H.shape[1])] += ~free
        smallest = np.sqrt(np.maximum(np.linalg.eigvalsh(H)[:, 0], 0.0))
        return np.asarray(np.linalg.norm(q - near, axis=1) * max(self.reach, 1.0) < close * smallest)

    def _around(
        self, poses: Poses, near: np.ndarray, rows: np.ndarray, positions: np.ndarray, there: np.ndarray
    ) -> None:
        """Look around where some rows come from; fills in what is found."""
        draws = np.random.default_rng(0).standard_normal((AROUND, near.shape[1]))
        kicks = np.vstack([np.zeros(near.shape[1]), KICK * draws])
        for some in _parts(rows, len(kicks)):
            self._choose(
                poses, near, some, *self._from(poses[some], near[some][:, None] + kicks, self.inverse), positions, there
            )

    def _everywhere(
        self, poses: Poses, near: np.ndarray, rows: np.ndarray, positions: np.ndarray, there: np.ndarray, memory: Memory
    ) -> None:
        """Look over all readings for some rows, once for each pose; fills in what is found."""
        rows = rows[~self.too_far(poses.wanted[rows])]
        new = np.array([k for k in rows.tolist() if poses.key(k) not in memory], dtype=int)
        for k, ends in zip(new.tolist(), self.searched(poses[new]), strict=True):
            memory[poses.key(k)] = ends
        for k in rows.tolist():
            ends = memory[poses.key(k)]
            self._choose(poses, near, np.array([k]), ends[None], np.ones((1, len(ends)), dtype=bool), positions, there)

    def within_limits(self, pose: Poses, ends: np.ndarray) -> bool:
        """Whether any of the positions (positions, columns) of one pose, whatever its posture, is within the limits."""
        return any(self._turned(end, pose.held[0], end, None) is not None for end in ends)

    def _different(self, ends: np.ndarray) -> np.ndarray:
        """The different positions among ends of searches, shape (tries, columns), whole turns apart counted as one."""
        different: list[np.ndarray] = []
        for end in ends:
            off = np.array(different).reshape(-1, len(end)) - end
            off -= TURN * np.where(self.inverse.turning, np.round(off / TURN), 0.0)
            if not (np.abs(off).max(axis=1) < SAME_POSITION).any():
                different.append(end)
        return np.array(different).reshape(-1, ends.shape[1])

    def _choose(
        self,
        poses: Poses,
        near: np.ndarray,
        rows: np.ndarray,
        ends: np.ndarray,
        reached: np.ndarray,
        positions: np.ndarray,
        there: np.ndarray,
    ) -> None:
        """Take the nearest position of each row that some searches (rows, tries, columns) ended at."""
        nearest = self._turned_towards(ends, near[rows][:, None], poses.held[rows][:, None])
        inside = np.all(
            (nearest >= self.inverse.low - SAME_POSITION) & (nearest <= self.inverse.high + SAME_POSITION), axis=2
        )
        away = np.where(reached, np.sum((nearest - near[rows][:, None]) ** 2, axis=2), np.inf)
        for k, own, ok, sure, way, turned in zip(rows.tolist(), ends, reached, inside, away, nearest, strict=True):
            best = int(way.argmin()) if len(way) else 0
            if ok.any() and sure[best]:  # whatever is turned otherwise is further away
                fits = poses.fits[k]
                if fits is None or fits(turned[best]):
                    positions[k], there[k] = turned[best], True
                    continue
            first = next(iter(self._distinct(own[ok], poses.held[k], near[k], poses.fits[k])), None)
            if first is not None:
                positions[k], there[k] = first, True

    def _from(self, poses: Poses, seeds: np.ndarray, inverse: InverseRows) -> tuple[np.ndarray, np.ndarray]:
        """Ends of searches from several seeds each, (n, tries, columns), and which are there, (n, tries)."""
        n, tries, columns = seeds.shape
        wanted, fixed = np.repeat(poses.wanted, tries, axis=0), np.repeat(poses.held, tries, axis=0)
        ends = inverse.approach(wanted, seeds.reshape(-1, columns), fixed, {})
        return ends.readings.reshape(n, tries, columns), self._there(ends).reshape(n, tries)

    def _drawn(self, n: int, count: int) -> np.ndarray:
        """Starts over the joints' ranges, the same for each of n rows, shape (n, count, columns); once round is enough."""
        low, high = np.maximum(self.inverse.low, -UNLIMITED_START), np.minimum(self.inverse.high, UNLIMITED_START)
        low, high = np.where(low < high, low, self.inverse.low), np.where(low < high, high, self.inverse.high)
        drawn = low + (high - low) * np.random.default_rng(1).random((count, len(low)))
        return np.broadcast_to(drawn, (n, *drawn.shape))

    # --- one after the other --------------------------------------------------------------------------------------------

    def walk(self, chain: Chain, before: np.ndarray, memory: Memory) -> tuple[np.ndarray, np.ndarray]:
        """The arm's position at each target of a chain, each from where the one before has come to.

        Args:
            chain: N targets.
            before: Readings where it begins, shape (columns,).
            memory: Filled with what searches over all readings found.

        Returns:
            Readings, shape (n, columns), those of the target before where there is none; and whether there is one.
        """
        n, certain, window = len(chain.poses), 0, USUAL
        q, there = np.tile(before, (n, 1)), np.ones(n, dtype=bool)
        if self.redundant(chain.poses.held[~chain.joints]):
            window = 1
        while certain < n:
            end, here = min(certain + window, n), q[certain - 1] if certain else before
            q[certain:end] = self._guessed(chain, certain, end, here)
            certain = self._swept(chain, before, certain, end, q, there, memory)
            if window > 1:
                window = min(2 * window, BROAD) if certain == end else max(window // 2, NARROW)
        return q, there

    def _guessed(self, chain: Chain, start: int, end: int, before: np.ndarray) -> np.ndarray:
        """Readings of the targets from one to another, the chance of a wrong position taken."""
        anchors, seeds, here = [], [], before
        for k in range(start, end):
            if chain.joints[k]:
                here = np.where(np.isnan(chain.given[k]), here, chain.given[k])
            elif (k - start) % ANCHORS == 0 or k == end - 1:
                wanted, fixed = chain.poses.wanted[k], chain.poses.held[k]
                stays = np.isfinite(fixed)
                low, high = (np.where(stays, fixed, limit) for limit in (self.one.low, self.one.high))
                command = replace(self.one, low=low, high=high).command(wanted[:3, :3], wanted[:3, 3], here, {})
                here = command.readings if command.reached else here
            else:
                continue
            anchors.append(k)
            seeds.append(here)
        rows, anchor_positions = np.arange(start, end), np.array(seeds)
        guesses = np.column_stack([np.interp(rows, anchors, column) for column in anchor_positions.T])
        own = np.flatnonzero(~chain.joints[start:end])
        fixed = chain.poses.held[start + own]
        q, reached, _ = self.settle(chain.poses.wanted[start + own], guesses[own], fixed, QUICK)
        guesses[own[reached]] = self._turned_towards(q, guesses[own], fixed)[reached]
        return guesses

    def _swept(
        self,
        chain: Chain,
        before: np.ndarray,
        start: int,
        end: int,
        q: np.ndarray,
        there: np.ndarray,
        memory: Memory,
    ) -> int:
        """Work out targets, then those again that come from elsewhere now; gives the first that is not certain."""
        rows = np.arange(start, end)
        for _ in range(SWEEPS):
            new = self._anew(chain, before, rows, q, there, memory)
            other = self._apart(new, q[rows], chain.poses.held[rows]) > UNMOVED_READING
            q[rows] = new
            follow = rows[other] + 1
            rows = follow[(follow < end) & chain.depends[np.minimum(follow, len(q) - 1)]]
            if not len(rows):
                return self._wound(chain, before, start, end, q, there, memory)
        return self._wound(chain, before, start, int(rows[0]), q, there, memory)

    def _anew(
        self, chain: Chain, before: np.ndarray, rows: np.ndarray, q: np.ndarray, there: np.ndarray, memory: Memory
    ) -> np.ndarray:
        """Readings of some targets from where those before them are, shape (rows, columns)."""
        come = np.where((rows > 0)[:, None], q[rows - 1], before)
        new = np.where(np.isnan(chain.given[rows]), come, chain.given[rows])
        own = np.flatnonzero(~chain.joints[rows])
        near = np.where(np.isnan(chain.near[rows[own]]), come[own], chain.near[rows[own]])
        positions, there[rows[own]] = self.nearest(chain.poses[rows[own]], near, q[rows[own]], memory)
        new[own] = np.where(there[rows[own]][:, None], positions, come[own])
        return new

    def _apart(self, one: np.ndarray, other: np.ndarray, fixed: np.ndarray) -> np.ndarray:
        """How far readings (n, columns) are from others but for whole turns, shape (n,)."""
        return np.asarray(np.abs(self._turned_towards(one, other, fixed) - other).max(axis=1, initial=0.0))

    def _wound(
        self,
        chain: Chain,
        before: np.ndarray,
        start: int,
        end: int,
        q: np.ndarray,
        there: np.ndarray,
        memory: Memory,
    ) -> int:
        """Turn positions by whole turns to follow each other; gives the first that is another one for it, or the end.

        A search that starts a whole turn further ends a whole turn further, so that no target is worked out anew for turns, but
        where a limit is in the way or words count turns.
        """
        low, high = self.inverse.low - SAME_POSITION, self.inverse.high + SAME_POSITION
        for k in range(self._first_unwound(chain, before, start, end, q, there), end):
            come = q[k - 1] if k else before
            if chain.joints[k] or not there[k]:
                given = chain.given[k] if chain.joints[k] else np.full(len(come), np.nan)
                q[k] = np.where(np.isnan(given), come, given)
                continue
            near = np.where(np.isnan(chain.near[k]), come, chain.near[k])
            turned = self._turned_towards(q[k], near, chain.poses.held[k])
            if np.abs(turned - q[k]).max() < UNMOVED_READING:
                continue
            fits = chain.poses.fits[k]
            if ((turned >= low) & (turned <= high)).all() and fits is None:
                q[k] = turned
                continue
            row = np.array([k])
            new = self._anew(chain, before, row, q, there, memory)
            other = self._apart(new, q[row], chain.poses.held[row])[0] > UNMOVED_READING
            q[k] = new[0]
            if other:
                return k + 1
        return end

    def _first_unwound(
        self, chain: Chain, before: np.ndarray, start: int, end: int, q: np.ndarray, there: np.ndarray
    ) -> int:
        """The first target that is whole turns from where it comes from, or states other axes than hold; the end if none is."""
        rows = np.arange(start, end)
        come = np.where((rows > 0)[:, None], q[rows - 1], before)
        near = np.where(np.isnan(chain.near[rows]), come, chain.near[rows])
        posed = np.where(there[rows][:, None], self._turned_towards(q[rows], near, chain.poses.held[rows]), come)
        given = np.where(np.isnan(chain.given[rows]), come, chain.given[rows])
        follows = np.where(chain.joints[rows][:, None], given, posed)
        other = np.abs(follows - q[rows]).max(axis=1, initial=0.0) > UNMOVED_READING
        return int(rows[other.argmax()]) if other.any() else end

    # --- all positions --------------------------------------------------------------------------------------------------

    def positions(self, poses: Poses, near: np.ndarray, count: int = STARTS) -> list[list[np.ndarray]]:
        """The arm's positions at each pose that fit, the nearest to some readings (n, columns) first; from so many starts."""
        ends = self.searched(poses, count)
        rows = zip(ends, near, strict=True)
        return [self._distinct(own, poses.held[k], at, poses.fits[k]) for k, (own, at) in enumerate(rows)]

    def searched(self, poses: Poses, count: int = STARTS) -> list[np.ndarray]:
        """Ends of searches over all readings that get to each pose, (positions, columns), beyond limits and of any posture."""
        positions = []
        for some in _parts(np.arange(len(poses)), count):
            part, seeds = poses[some], self._drawn(len(some), count)
            ends, ok = self._from(part, seeds, self.inverse if self.redundant(part.held) else self.unlimited)
            positions += [self._different(own[reached]) for own, reached in zip(ends, ok, strict=True)]
        return positions

    def _distinct(self, ends: np.ndarray, fixed: np.ndarray, near: np.ndarray, fits: Fits | None) -> list[np.ndarray]:
        """The different positions among ends of searches (tries, columns) that fit, the nearest first."""
        positions: list[np.ndarray] = []
        for end in self._different(ends):
            q = self._turned(end, fixed, near, fits)
            if q is not None:
                positions.append(q)
        return sorted(positions, key=lambda q: float(np.sum((q - near) ** 2)))

    def _turned(self, q: np.ndarray, fixed: np.ndarray, near: np.ndarray, fits: Fits | None) -> np.ndarray | None:
        """The same position with joints turned by whole turns: as near as may be, or the nearest way in which it fits."""
        nearest = self._turned_towards(q, near, fixed)
        inside = (nearest >= self.inverse.low - SAME_POSITION) & (nearest <= self.inverse.high + SAME_POSITION)
        if inside.all() and (fits is None or fits(nearest)):
            return nearest
        ways = self._ways(nearest, np.isnan(fixed) & self.inverse.turning, near)
        return next((way for way in ways if fits is None or fits(way)), None)

    def _ways(self, q: np.ndarray, turning: np.ndarray, near: np.ndarray) -> list[np.ndarray]:
        """Ways within the limits in which joints are turned by whole turns, the nearest first.

        All joints as near as may be, or between minus and plus half a turn, and one or two of them otherwise.
        """
        choices = []
        limits = zip(self.inverse.low - SAME_POSITION, self.inverse.high + SAME_POSITION, strict=True)
        for value, turns, (low, high) in zip(q.tolist(), turning.tolist(), limits, strict=True):
            every = [value + TURN * k for k in WHOLE_TURNS] if turns else [value]
            choices.append([v for v in every if low <= v <= high])
        if not all(choices):
            return []
        ways = []
        for aim in (near, np.zeros(len(q))):
            middle = [min(own, key=lambda v: abs(v - wish)) for own, wish in zip(choices, aim.tolist(), strict=True)]
            others = [(k, v) for k, own in enumerate(choices) for v in own if v != middle[k]]
            for changes in ((), *combinations(others, 1), *combinations(others, 2)):
                way = np.array(middle)
                for k, value in changes:
                    way[k] = value
                ways.append(way)
        return sorted(ways, key=lambda way: float(np.sum((way - near) ** 2)))


def _parts(rows: np.ndarray, tries: int) -> Iterator[np.ndarray]:
    """Rows in parts that are worked on together with so many tries each."""
    size = max(ROWS_AT_ONCE // tries, 1)
    for start in range(0, len(rows), size):
        yield rows[start : start + size]
