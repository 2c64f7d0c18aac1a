"""Is the residual noise? Tests of repeats, neighbours, order, jumps and the declared noise, each by itself.

Errors of the base are alike in world axes, errors of the target in the target's, and an error of a joint only along that joint's
own motion. So neighbours, order and jumps are tested in all of these views; the clearest counts, corrected for their number.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtr, chdtrc, ndtr

from aridcal.engine.corrections.condition_kinds import FEWEST_ROWS_OF_A_SIDE
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.noise import RepeatScatter
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.residual import scaled_columns
from aridcal.engine.instruments.channels import columns, spread
from aridcal.engine.instruments.kinds import labelled
from aridcal.engine.levels import FEWEST_TOGETHER
from aridcal.engine.numerics import FLOOR, TINY
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.progress import SILENT, Progress

FALSE_ALARM = 7e-4
"""Chance of a false alarm of each question. There are seven at the most: one of 200 clean campaigns is called structured."""

LEAST_STRUCTURE_SHARE = 0.1
"""Share of the variance below which repeatable structure is not worth a word: 5 % of the error."""

NEAREST_CONFIGURATIONS = 4
"""Nearest configurations that a row is compared with; they are sought among four times as many rows at the least."""

NEIGHBOURING_ROWS = 3
"""Rows after each that count as its neighbours, in each order: a bump of few rows makes few pairs."""

SHUFFLES = 400
"""Work: Orders drawn at random that tell how much chance varies: its spread is then known to 4 %."""

SHUFFLED_AT_ONCE = 2**17
"""Work: Numbers of residuals that are shuffled at once: they stay in the cache, and few rows take few calls."""

MOST_TESTED_ROWS = 10_000
"""Work: Rows that are asked at the most, of more: a correlation of 0.03 shows among so many."""

TESTED_STRETCHES = 20
"""Work: Stretches of rows in the order of measurement that those are: 500 rows on end show what changes fast, twenty of these
what changes slowly."""

LEAST_LEVER_SHARE = 1e-9
"""Work: Share of its largest lever below which a joint moves the target in none of a row's numbers."""

NoiseQuestion = Literal[
    "repeats", "neighbours", "order", "change", "declared", "held_out", "offset", "flags", "thing", "groups"
]


@dataclass(frozen=True)
class ResidualView:
    """Residuals in some axes, or along one joint's own motion.

    Attributes:
        words: The axes or the joint, for messages.
        white: Residuals in sigmas, shape (N, k).
    """

    words: str
    white: np.ndarray


@dataclass(frozen=True)
class Clue:
    """The result of one test of the residual.

    Attributes:
        question: The test.
        what: The structure that it looks for, in words.
        share: Share of the residual's variance that is structure, 0 to 1.
        p_value: Chance of so clear a result if the residual were white.
    """

    question: NoiseQuestion
    what: str
    share: float
    p_value: float

    @property
    def tells(self) -> bool:
        """True if the test shows structure worth a word."""
        return self.p_value < FALSE_ALARM and self.share > LEAST_STRUCTURE_SHARE


def clues(
    rows: Dataset,
    residual: np.ndarray,
    repeats: RepeatScatter | None,
    freedom: float,
    fit: Fit | None = None,
    progress: Progress = SILENT,
) -> list[Clue]:
    """Tests of whether residuals are white.

    Args:
        rows: The rows in use; their declared noise is tested, too.
        residual: Of each row, scaled by its relative sigmas, shape (N, m).
        repeats: Scatter of repeated configurations, if there are any.
        freedom: Share of the numbers that is left after fitting, 0 to 1.
        fit: The model, for the target's axes and the joints' motions; None: world axes alone are tested.
        progress: Called with the number of shuffles.
    """
    sigma = rms_of_channels(residual, rows)
    residual = np.nan_to_num(residual)
    white = residual / spread(sigma, rows.channels)
    clues_found = [_repeats(repeats, sigma)] if repeats is not None else []
    if len(white) > 4 * NEAREST_CONFIGURATIONS:
        some = stretches(rows.sequence, MOST_TESTED_ROWS)
        part = rows if len(some) == len(rows) else rows.select(some)
        others = _other_views(part, residual[some], sigma, fit) if fit else []
        views = [ResidualView("in world axes", white[some]), *others]
        if _moving_joints(part.readings).any():
            clues_found.append(_neighbours(views, part.readings))
        each = "measurements" if "time" in part.covariates else "rows"
        order = part.sequence
        clues_found.append(
            _correlation("order", f"consecutive {each} have similar residuals", views, order[:-1], order[1:])
        )
        clues_found += _changes(views, part, progress)
    if not rows.direct:
        clues_found += _things(rows, white)
    return clues_found + _declared_noise(rows, sigma, freedom)


def stretches(sequence: np.ndarray, most: int) -> np.ndarray:
    """Ascending row numbers: all, or of many rows :data:`TESTED_STRETCHES` stretches on end, spread evenly.

    Args:
        sequence: Numbers of the N rows in the order of measurement, shape (N,).
        most: Rows at the most.
    """
    if len(sequence) <= most:
        return np.arange(len(sequence))
    length = most // TESTED_STRETCHES
    first = np.linspace(0, len(sequence) - length, TESTED_STRETCHES).round().astype(int)
    return np.sort(sequence[(first[:, None] + np.arange(length)).ravel()])


def _things(rows: Dataset, white: np.ndarray) -> list[Clue]:
    """Are the residuals of a thing larger than the others': a marker that is not where its table says, a loose socket?

    Squares of its rows against those of all others by their ranks (Mann and Whitney 1947), which long tails do not upset.
    """
    roles = [labelled(block.kind) for block in rows.blocks]
    labelled_row = np.array([bool(of) for of in roles])[rows.labels.block]
    names = np.where(
        rows.labels.refers[:, 2] != "", rows.labels.refers[:, 2], np.where(labelled_row, rows.labels.refers[:, 0], "")
    )
    title = np.array([of[-1].name if of else block.name for of, block in zip(roles, rows.blocks, strict=True)])
    labels, thing = np.unique(np.char.add(np.char.add(title[rows.labels.block], " "), names), return_inverse=True)
    numbers = np.sum(white != 0.0, axis=1)
    square = np.sum(white**2, axis=1) / np.maximum(numbers, 1)
    count, square_sum = np.bincount(thing), np.bincount(thing, square)
    candidates = np.flatnonzero(
        (count >= FEWEST_TOGETHER) & (len(thing) - count >= 4 * NEAREST_CONFIGURATIONS)
    ).tolist()
    if not candidates:
        return []
    from scipy.stats import mannwhitneyu  # slow to load, and only several things need it

    clues_of_things = []
    for k in candidates:
        here = thing == k
        chance = float(mannwhitneyu(square[here], square[~here], alternative="greater").pvalue)
        rest = float(np.mean(square[~here]))
        share = float(np.clip((square_sum[k] - count[k] * rest) / max(float(square.sum()), TINY), 0.0, 1.0))
        ratio = np.sqrt(square_sum[k] / count[k] / max(rest, TINY))
        what = f"rows of {labels[k]} leave {ratio:.2g} times as much as the others: is it where it is said to be?"
        clues_of_things.append(Clue("thing", what, share, min(1.0, len(candidates) * chance)))
    return [min(clues_of_things, key=lambda clue: clue.p_value)]


def rms_of_channels(residual: np.ndarray, rows: Dataset) -> np.ndarray:
    """RMS of each channel over the rows that measure it, shape (C,), from residuals of shape (N, m); FLOOR where none does."""
    parts = zip(columns(rows.channels), rows.measures.T, strict=True)
    return np.array(
        [np.sqrt(np.mean(residual[present][:, part] ** 2)) if present.any() else FLOOR for part, present in parts]
    )


def _other_views(rows: Dataset, residual: np.ndarray, sigma: np.ndarray, fit: Fit) -> list[ResidualView]:
    """Residuals in the target's axes, and along each joint's own motion.

    With J a joint's column and r the residual of a row, both in sigmas, J'r / |J| is the part of r along that motion: white
    and of variance 1 if r is.
    """
    robot = fit.model.robot
    question = problem(fit.model.with_motions(fit.model.own_motions), rows)
    theta = np.concatenate([fit.theta, np.zeros(len(robot.joints))])
    scale = spread(sigma, rows.channels)
    views = []
    if all(channel.axes == ("x", "y", "z") or channel.axes == ("rx", "ry", "rz") for channel in rows.channels):
        R, _ = question.model.poses(theta, question.rows)
        parts = columns(rows.channels)
        turned = np.concatenate([np.einsum("nji,nj->ni", R, residual[:, part]) for part in parts], axis=1)
        views.append(ResidualView("in the target's axes", turned / scale))
    J = scaled_columns(question, theta, len(robot.joints)) / scale[:, None]
    lever = np.linalg.norm(J, axis=1)
    along = np.einsum("nms,nm->ns", J, residual / scale) / np.maximum(lever, TINY)
    for k, name in enumerate(robot.names):
        felt = lever[:, k] > LEAST_LEVER_SHARE * lever.max()
        if felt.all():
            views.append(ResidualView(f"as a motion of {name}", along[:, k, None] / np.sqrt(np.mean(along[:, k] ** 2))))
    return views


def _repeats(repeats: RepeatScatter, sigma: np.ndarray) -> Clue:
    """Is the residual larger than the scatter of repeats, which is the noise without errors of the model?"""
    numbers = float(repeats.freedom.sum())
    share = float(np.clip(1.0 - np.nansum(repeats.freedom * repeats.sigma**2 / sigma**2) / numbers, 0.0, 1.0))
    p_value = float(chdtr(numbers, numbers * (1.0 - share)))
    return Clue("repeats", "repeats scatter less than the residual", share, p_value)


def _neighbours(views: Sequence[ResidualView], readings: np.ndarray) -> Clue:
    """Do rows at near configurations err alike?"""
    rows, others = _nearest(readings)
    apart = rows != others  # among equal rows the nearest need not be the row itself
    return _correlation(
        "neighbours", "neighbouring configurations have similar residuals", views, rows[apart], others[apart]
    )


def neighbours(rows: Dataset) -> list[np.ndarray]:
    """Pairs of neighbouring rows, shape (pairs, 2) each, in several orders.

    In time (as they stand, where there is no time), along every reading, and in all readings at once, where repeats are
    nearest.
    """
    along = [np.argsort(q, kind="stable") for q in rows.readings.T[_moving_joints(rows.readings)]]
    nearest = np.sort(np.column_stack(_nearest(rows.readings)), axis=1)
    return [*map(_successors, [rows.sequence, *along]), np.unique(nearest, axis=0)]


def _moving_joints(readings: np.ndarray) -> np.ndarray:
    """Joints that are not always at the same reading, shape (columns,) bool."""
    return np.asarray(readings.std(axis=0) > FLOOR)


def _nearest(readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each row, and its :data:`NEAREST_CONFIGURATIONS` nearest, by readings in standard deviations; shape (pairs,) each."""
    points = readings[:, _moving_joints(readings)]
    points = points / points.std(axis=0)
    near = np.asarray(cKDTree(points).query(points, k=NEAREST_CONFIGURATIONS + 1)[1])[:, 1:]
    return np.repeat(np.arange(len(points)), NEAREST_CONFIGURATIONS), near.ravel()


def _successors(order: np.ndarray) -> np.ndarray:
    """Pairs of rows that are at most :data:`NEIGHBOURING_ROWS` apart in an order of shape (N,)."""
    return np.concatenate([np.column_stack([order[:-k], order[k:]]) for k in range(1, NEIGHBOURING_ROWS + 1)])


def _correlation(
    question: NoiseQuestion, what: str, views: Sequence[ResidualView], first: np.ndarray, second: np.ndarray
) -> Clue:
    """Correlation of pairs of rows, first and second of each, shape (pairs,), against its distribution over all orders."""
    white, starts = _side_by_side(views)
    sums = np.add.reduceat(np.einsum("nm,nm->m", white[first], white[second]), starts)
    mean, deviation = np.array([chance_moments(view.white, first, second) for view in views]).T
    z = (sums - mean) / np.maximum(deviation, TINY)
    best = int(np.argmax(z))
    p_value = min(1.0, len(views) * float(ndtr(-z[best])))
    share = sums[best] / (len(first) * views[best].white.shape[1])
    return Clue(question, f"{what} {views[best].words}", float(np.clip(share, 0.0, 1.0)), p_value)


def chance_moments(x: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    r"""Mean and standard deviation of the sum of products of pairs of rows, over all orders of the rows.

    With W symmetric, half the number of times that rows i and j are a pair, :math:`G = x x^T`, :math:`n_{(k)}` the product of k
    factors :math:`n (n - 1) \dots` and, off the diagonal, :math:`T_0 = \sum W_{ij}`, :math:`T_1 = \sum W_{ij}^2`,
    :math:`T_2 = \sum_i (\sum_j W_{ij})^2` and U the same of G,

    .. math:: E = \frac{T_0 U_0}{n_{(2)}}, \quad E^{(2)} = \frac{2 T_1 U_1}{n_{(2)}} + \frac{4 (T_2 - T_1) (U_2 - U_1)}{n_{(3)}}
        + \frac{(T_0^2 + 2 T_1 - 4 T_2) (U_0^2 + 2 U_1 - 4 U_2)}{n_{(4)}}

    are the first two moments (N. Mantel, Cancer Research 27, 1967, 209-220).

    Args:
        x: Shape (n, m), four rows at least.
        first: One row of each pair, shape (pairs,), never the same as the other.
        second: The other.
    """
    n = len(x)
    _, times = np.unique(np.minimum(first, second) * n + np.maximum(first, second), return_counts=True)
    count = 0.5 * (np.bincount(first, minlength=n) + np.bincount(second, minlength=n))
    T0, T1, T2 = float(len(first)), 0.5 * float(times @ times), float(count @ count)
    squares, total = np.einsum("nm,nm->n", x, x), x.sum(axis=0)
    of_row = x @ total - squares
    U0, U1, U2 = float(of_row.sum()), float(np.sum((x.T @ x) ** 2) - squares @ squares), float(of_row @ of_row)
    pairs, threes, fours = n * (n - 1.0), n * (n - 1.0) * (n - 2.0), n * (n - 1.0) * (n - 2.0) * (n - 3.0)
    mean = T0 * U0 / pairs
    square = 2.0 * T1 * U1 / pairs + 4.0 * (T2 - T1) * (U2 - U1) / threes
    square += (T0**2 + 2.0 * T1 - 4.0 * T2) * (U0**2 + 2.0 * U1 - 4.0 * U2) / fours
    return mean, float(np.sqrt(max(square - mean**2, 0.0)))


def _side_by_side(views: Sequence[ResidualView]) -> tuple[np.ndarray, np.ndarray]:
    """All views in one array, shape (N, columns), and the first column of each."""
    sizes = [view.white.shape[1] for view in views]
    return np.hstack([view.white for view in views]), np.cumsum([0, *sizes[:-1]])


def _changes(views: Sequence[ResidualView], rows: Dataset, progress: Progress) -> list[Clue]:
    """Did the residual jump between two rows? File by file, and in the order of time if that is another one."""
    sequence = rows.sequence
    by_file = sequence[np.argsort(rows.origin.file[sequence], kind="stable")]
    orders = [by_file] if np.array_equal(by_file, sequence) else [by_file, sequence]
    clues_of_orders = []
    for order in orders:
        words = "" if np.array_equal(order, rows.as_read) else " in the order of time"
        clues_of_orders.append(_change(views, rows, order, words, progress))
    return clues_of_orders


def _change(views: Sequence[ResidualView], rows: Dataset, order: np.ndarray, words: str, progress: Progress) -> Clue:
    r"""The largest step of the mean of any view, over all rows where it might be.

    .. math:: x = \max_k \frac{|S_k|^2}{k (1 - k / N)}, \qquad S_k = \sum_{n \le k} (r_n - \bar r)

    What chance makes of it comes from shuffled rows; maxima of many follow Gumbel's distribution, whose two numbers the
    shuffles give (Worsley 1986, doi:10.1093/biomet/73.1.91, has exact bounds where noise is normal).
    """
    rng = np.random.default_rng(0)
    white, starts = _side_by_side(views)
    white = white - white.mean(axis=0)
    n = len(white)
    before = np.arange(min(FEWEST_ROWS_OF_A_SIDE, n // 2), n - min(FEWEST_ROWS_OF_A_SIDE, n // 2) + 1)
    weight = before * (1.0 - before / n)

    # Column by column: sums and maxima run along what lies side by side in memory.
    turned = np.ascontiguousarray(white.T)
    parts = [slice(start, start + view.white.shape[1]) for start, view in zip(starts.tolist(), views, strict=True)]

    def statistics(orders: np.ndarray) -> Iterator[np.ndarray]:
        """Of several orders of the rows, (b, n): steps of each view, (b, places)."""
        squares = np.cumsum(turned[:, orders], axis=2)[:, :, before[0] - 1 : before[-1]]
        np.square(squares, out=squares)
        return (squares[part].sum(axis=0) / weight for part in parts)

    steps = [step[0] for step in statistics(order[None])]
    largest = np.array([step.max() for step in steps])
    each, drawn = max(SHUFFLED_AT_ONCE // white.size, 1), []
    for first in progress.over(range(0, SHUFFLES, each), "shuffles of the rows"):
        orders = np.array([rng.permutation(n) for _ in range(min(each, SHUFFLES - first))])
        drawn.append(np.transpose([step.max(axis=1) for step in statistics(orders)]))
    shuffled = np.concatenate(drawn)
    scale = np.maximum(shuffled.std(axis=0), 1e-12) * np.sqrt(6.0) / np.pi
    place = shuffled.mean(axis=0) - np.euler_gamma * scale
    chances = -np.expm1(-np.exp((place - largest) / scale))
    best = int(np.argmin(chances))
    total = float(np.sum(views[best].white ** 2))
    share = float(np.clip((largest[best] - shuffled[:, best].mean()) / total, 0.0, 1.0))
    k = int(before[np.argmax(steps[best])])
    last, following = rows.origin.line[order[k - 1 : k + 1]]
    what = f"residuals jump between rows {last} and {following}{words}, {views[best].words}"
    return Clue("change", what, share, min(1.0, len(views) * float(chances[best])))


def _declared_noise(rows: Dataset, sigma: np.ndarray, freedom: float) -> list[Clue]:
    """Is the residual larger than the declared noise? A share ``freedom`` of the numbers is left after fitting."""
    clues_of_channels = []
    for channel, declared, shown, present in zip(rows.channels, rows.sigma, sigma, rows.measures.T, strict=True):
        if declared:
            numbers, ratio = channel.size * float(present.sum()) * freedom, shown / declared
            share = float(np.clip(1.0 - ratio**-2, 0.0, 1.0))
            p_value = float(chdtrc(numbers, numbers * ratio**2))
            clues_of_channels.append(
                Clue("declared", f"the residual exceeds the declared {channel.name} noise", share, p_value)
            )
    return clues_of_channels
