"""Data sets made to deceive a calibration: what a plain arm measures, and what is wrong with it.

Every case is made from its own seed, by the kinematics of ``plain_arm.py``. A fault moves joints, the base or the target
by an amount for each row; the rows of the table come first, then the configurations at which the model is tried.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
from plain_arm import Arm, Pose, answer, curve_answer, derivatives, misses, small
from plain_robots import ARMS
from scipy.spatial.transform import Rotation

ROWS = 250
QUERIES = 1000
TEST_SHARE = 0.2
FIRST_LINE = 2  # of a file: the header is line 1
DURATION = 20.0  # from one row to the next, [s]


@dataclass(frozen=True)
class Cause:
    """What is truly wrong beside geometry, as a result should name it.

    Attributes:
        kinds: Kinds of effects that say it.
        where: The joint or the frame.
        row: First row in order of measuring after a step, counted from 0; None of what is no step.
        value: Its coefficient, where it has one.
    """

    kinds: tuple[str, ...]
    where: str
    row: int | None = None
    value: float | None = None


@dataclass(frozen=True)
class Scene:
    """An arm, its configurations and the truth; the first N rows are measured, the others are asked for (M in all).

    Attributes:
        rng: Draws what the attack needs.
        family: Of the arm.
        arm: As nominal.
        pose: Whether orientations are measured, too.
        declared: Whether the noise is.
        q: Readings as the table has them, shape (M, J).
        off: Error of each joint's place, a twist, shape (J, 6), [m] and [rad].
        world: T_world_base, shape (4, 4).
        tool: T_tip_target, shape (4, 4), or one for each row.
        sigma: Of the instrument, per axis, shape (2,), [m] and [rad].
        time: In order of measuring, shape (N,), [s].
        n: How many rows are measured.
        timed: Whether the table has ``time``.
        joints: What truly moves joints beside their readings, shape (M, J), [rad] or [m].
        base: What moves the base, a twist in its own axes for each row, shape (M, 6).
        held: What moves the target in the tip's grip, the same.
        free: What an oracle knows the form of: a direction among the derivatives, and its amount for each row.
        curve: Knots of a smooth curve that follows the true one: a direction, and amounts, shape (M, knots).
        causes: How the result should name it.
        said: The same in words.
        scatter: Standard deviation of each joint's readings, shape (J,).
        label: Which target each row measured, shape (M,).
        extra: Further columns, shape (M,) each.
    """

    rng: np.random.Generator
    family: str
    arm: Arm
    pose: bool
    declared: bool
    q: np.ndarray
    off: np.ndarray
    world: np.ndarray
    tool: np.ndarray
    sigma: np.ndarray
    time: np.ndarray
    n: int
    timed: bool
    joints: np.ndarray
    base: np.ndarray
    held: np.ndarray
    free: tuple[tuple[np.ndarray, np.ndarray], ...] = ()
    curve: tuple[np.ndarray, np.ndarray] | None = None
    causes: tuple[Cause, ...] = ()
    said: str = "nothing"
    scatter: np.ndarray = field(default_factory=lambda: np.zeros(0))
    label: np.ndarray | None = None
    extra: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def per_number(self) -> np.ndarray:
        """Sigma of each number of a row, shape (m,)."""
        return np.repeat(self.sigma, 3)[: 6 if self.pose else 3]

    @cached_property
    def truth(self) -> Pose:
        """Where the target truly is, M rows; what only scatters is left out."""
        return self.arm.target(
            self.q + self.joints, self.world @ small(self.base), self.tool @ small(self.held), self.off
        )

    @cached_property
    def columns(self) -> np.ndarray:
        """Derivatives of the pose by frames and constants, in sigma, shape (M, m, 12 + 6 J)."""
        D = derivatives(self.arm, self.q, self.world, self.tool, self.off, self.pose)
        return np.asarray(D / self.per_number[:, None])

    def about(self, joint: int) -> np.ndarray:
        """The direction among the derivatives that is a joint's own motion, shape (12 + 6 J,)."""
        found = np.zeros(12 + self.off.size)
        at = 12 + 6 * joint + (3 if self.arm.turns[joint] else 0)
        found[at : at + 3] = self.arm.axes[joint]
        return found

    def moved(self, joint: int, amount: np.ndarray) -> np.ndarray:
        """What a joint's motion by some amounts, shape (M,), does to the target, in sigma, shape (M, m)."""
        return np.asarray((self.columns @ self.about(joint)) * amount[:, None])


@dataclass(frozen=True)
class Case:
    """A data set and all that is known of it.

    Attributes:
        attack: Its name.
        seed: Makes it again.
        scene: The truth.
        table: As the user has it.
        test: Which rows no one fits, shape (N,) bool; of the table's rows in order of measuring.
        order: Row of the table of each measured row, shape (N,).
        wild: Rows that are grossly wrong, by their number in order of measuring.
        contradicted: Whether the rows that lie apart contradict those that are fitted.
        scale: Unit of a miss, per axis: the scatter of a row, shape (2,), [m] and [rad].
        oracle: Miss of a fit that knows the form of the fault and how rows scatter, RMS per number, in ``scale``.
        curve: The same, the fault's form being known as a smooth curve only; nan where it is no curve.
        nominal: The same of a fit of the frames alone.
    """

    attack: str
    seed: int
    scene: Scene
    table: pd.DataFrame
    test: np.ndarray
    order: np.ndarray
    wild: tuple[int, ...]
    contradicted: bool
    scale: np.ndarray
    oracle: float
    curve: float
    nominal: float

    @property
    def query(self) -> pd.DataFrame:
        """Configurations never measured, with the columns that the table has; the time is that of now."""
        s = self.scene
        asked = dict(zip(s.arm.names, s.q[s.n :].T, strict=True)) | {k: v[s.n :] for k, v in s.extra.items()}
        return pd.DataFrame(asked if "time" in asked or not s.timed else asked | {"time": s.time[-1]})

    def miss(self, R: np.ndarray, p: np.ndarray) -> float:
        """RMS per number of poses, shape (Q, 3, 3) and (Q, 3), against the truth of the query, in ``scale``."""
        s = self.scene
        off = (
            misses((R, p), (s.truth[0][s.n :], s.truth[1][s.n :]), s.pose)
            / np.repeat(self.scale, 3)[: len(s.per_number)]
        )
        return float(np.sqrt(np.mean(off**2)))


@dataclass(frozen=True)
class Measuring:
    """How a scene's rows came to be a table.

    Attributes:
        error: Of the instrument, in world axes, shape (N, 6), [m] and [rad].
        growth: Sigma of each row over the instrument's, shape (N,).
        step: To which positions are rounded, [m]; 0 if they are not.
        wild: Rows that are grossly wrong, by their number.
        contradicted: Whether the rows that lie apart contradict those that are fitted.
        shuffled: Whether the table's rows are not in the order of measuring.
        split: Whether the table says which rows lie apart.
        change: Last, what is done to the table; it gets the rows that lie apart, shape (N,) bool.
    """

    error: np.ndarray
    growth: np.ndarray
    step: float = 0.0
    wild: tuple[int, ...] = ()
    contradicted: bool = False
    shuffled: bool = False
    split: bool = True
    change: Callable[[pd.DataFrame, np.ndarray], pd.DataFrame] = lambda table, _: table


def draw_scene(rng: np.random.Generator, k: int, arms: Sequence[str] = tuple(ARMS), n: int = ROWS) -> Scene:
    """Draw an arm that is wrong in its constants alone; the number of the case says what is declared and measured."""
    family = arms[(k // 8 + k) % len(arms)]
    arm = ARMS[family](rng)
    total = n + QUERIES
    low, high = arm.travel.T
    q = rng.uniform(low, high, (total, len(arm.names)))
    sigma = np.exp(rng.uniform(np.log(4e-5), np.log(2e-4), 2))
    wrong = np.exp(rng.uniform(np.log(2e-4), np.log(2e-3)))
    tool = np.eye(4)
    tool[:3, :3] = Rotation.random(rng=rng).as_matrix()
    tool[:3, 3] = rng.uniform(0.05, 0.15, 3) * rng.choice((-1.0, 1.0), 3)
    world = np.eye(4)
    world[:3, :3] = Rotation.random(rng=rng).as_matrix()
    world[:3, 3] = rng.uniform(-3.0, 3.0, 3)
    still = np.zeros((total, 6))
    return Scene(
        rng, family, arm, pose=k // 2 % 2 == 0, declared=k % 2 == 0, q=q,
        off=wrong * rng.standard_normal((len(arm.names), 6)), world=world, tool=tool, sigma=sigma,
        time=np.cumsum(DURATION * rng.uniform(0.7, 1.3, n)), n=n, timed=k // 4 % 2 == 0,
        joints=np.zeros_like(q), base=still, held=still, scatter=np.zeros(len(arm.names)),
    )  # fmt: skip


def white(scene: Scene) -> Measuring:
    """Noise as it should be."""
    return Measuring(scene.rng.standard_normal((scene.n, 6)) * np.repeat(scene.sigma, 3), np.ones(scene.n))


def measure(attack: str, seed: int, scene: Scene, how: Measuring) -> Case:
    """Make the table, and what a fit that knows the truth would make of it."""
    s, n, m = scene, scene.n, len(scene.per_number)
    # What is measured from one configuration stays together.
    _, one = np.unique(s.q[:n], axis=0, return_inverse=True)
    count = int(one.max()) + 1
    test = np.isin(one.ravel(), s.rng.permutation(count)[: round(TEST_SHARE * count)])
    jitter = s.scatter * s.rng.standard_normal((n, len(s.scatter)))
    R, p = s.arm.target(
        (s.q + s.joints)[:n] + jitter, s.world @ small(s.base[:n]),
        (s.tool if s.tool.ndim == 2 else s.tool[:n]) @ small(s.held[:n]), s.off,
    )  # fmt: skip
    p = p + how.error[:, :3]
    p = np.round(p / how.step) * how.step if how.step else p
    R = Rotation.from_rotvec(how.error[:, 3:]).as_matrix() @ R
    table = pd.DataFrame(dict(zip(s.arm.names, s.q[:n].T, strict=True)))
    table[["x", "y", "z"]] = p
    if s.pose:
        table[["qx", "qy", "qz", "qw"]] = Rotation.from_matrix(R).as_quat(canonical=True)
    if s.timed:
        table["time"] = s.time
    table = table.assign(**{name: values[:n] for name, values in s.extra.items() if name != "time"})
    if how.split:
        table["split"] = np.where(test, "test", "train")
    table = how.change(table, test)
    order = np.arange(n)
    if how.shuffled:
        order = s.rng.permutation(len(table))
        table = table.iloc[np.argsort(order)].reset_index(drop=True)

    # In sigma, every row made white: a scattering joint moves the target along its own column.
    reach = [s.moved(j, np.full(len(s.q), v))[:n] for j, v in enumerate(s.scatter) if v > 0.0]
    spread = np.einsum("n,ij->nij", how.growth**2, np.eye(m)) + sum(np.einsum("ni,nj->nij", c, c) for c in reach)
    whiten = np.linalg.inv(np.linalg.cholesky(spread))
    wide = np.sqrt(np.einsum("nii->ni", spread).mean(axis=0)) * s.per_number
    scale = np.sqrt((wide.reshape(-1, 3) ** 2).mean(axis=1))
    kept = ~test
    kept[list(how.wild)] = False
    error = misses((R, p), (s.truth[0][:n], s.truth[1][:n]), s.pose) / s.per_number

    def fitted(columns: np.ndarray) -> np.ndarray:
        return np.asarray((whiten[kept] @ columns[:n][kept]).reshape(kept.sum() * m, -1))

    unit = np.repeat(s.sigma / np.resize(scale, 2), 3)[:m]

    def asked(columns: np.ndarray) -> np.ndarray:
        return np.asarray((unit[:, None] * columns[n:]).reshape((len(s.q) - n) * m, -1))

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    known = s.columns if s.label is None else _apart(s.columns, s.label)
    for direction, amount in s.free:
        known = np.concatenate([known, ((s.columns @ direction) * amount[:, None])[:, :, None]], axis=2)
    off = fitted(error[:, :, None])[:, 0]
    oracle = rms(answer(fitted(known), asked(known), off))
    curve = np.nan
    if s.curve is not None:
        direction, amounts = s.curve
        knots = np.einsum("nm,nk->nmk", s.columns @ direction, amounts)
        ((_, true),) = s.free
        moved = ((s.columns @ direction) * true[:, None])[:, :, None]
        bent = fitted(knots), asked(knots)
        curve = rms(
            curve_answer(fitted(s.columns), asked(s.columns), off, bent, (fitted(moved)[:, 0], asked(moved)[:, 0]))
        )
    # The frames alone: what the constants do counts as error.
    frames, wrong = known[:, :, : known.shape[2] - s.off.size - len(s.free)], s.columns[:, :, 12:] @ s.off.ravel()
    wrong = wrong[:, :, None]
    nominal = rms(answer(fitted(frames), asked(frames), off + fitted(wrong)[:, 0]) - asked(wrong)[:, 0])
    return Case(
        attack, seed, s, table, test, order, how.wild, how.contradicted, scale, oracle, curve, nominal
    )  # fmt: skip


def _apart(columns: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Derivatives with a target frame for each label in place of the one, shape (M, m, 6 + 6 L + 6 J)."""
    held = [columns[:, :, 6:12] * (label == one)[:, None, None] for one in np.unique(label)]
    return np.concatenate([columns[:, :, :6], *held, columns[:, :, 12:]], axis=2)
