r"""One constant of one robot over time: did it drift or jump, and from when on; a yearly cycle is neither.

Values :math:`x_i` at times :math:`t_i`, sigma :math:`s_i`. What may always be there is a constant and a cycle of a year with any
amplitude and phase, columns N; a change is one more column g:

- ``drift``: :math:`\max(t - \tau, 0)`, from a run on (wear),
- ``jump``: 0 before, 1 from a run on (a collision, a motor that was changed),
- ``odd run``: 1 in one run alone (nothing changed: that run was measured badly).

.. math:: z_g = \frac{g_\perp^T W x}{\sqrt{g_\perp^T W g_\perp}}, \qquad g_\perp = g - N (N^T W N)^{-1} N^T W g

is standard normal where nothing changed, whatever the cycle. A column that a cycle all but makes up has no part in it. The
p-value is that of the largest of G of them, by Bonferroni's inequality: :math:`p \le 2 G \Phi(-\max |z_g|)`, exact enough, for
it stands in a tail where neighbours seldom both exceed it.

The cycle of a hall is no sine. Where one is there, its shape may be off by a share of its amplitude, as if it were noise.

When it began: with a flat prior over the time that was seen. The cycle is what other robots of the fleet have, where there are
some; alone, each shape is tried with and without it, weights by Schwarz's criterion (Schwarz 1978, doi:10.1214/aos/1176344136):

.. math:: p(\tau) \propto \exp\big(-\tfrac12 \min \chi^2(\tau) - \tfrac{k}{2} \ln n\big)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

YEAR = 365.25
"""[d]"""

FEWEST_RUNS = 5
"""Fewest runs of which a change can be told from a yearly cycle: a constant, the cycle's two numbers, a change, and one more."""

TELLABLE_SHARE = 0.01
"""Share of a column's squares that the cycle must leave: what it all but makes up would be told by the cycle's shape alone."""

CYCLE_SHAPE_ERROR = 0.2
"""Share of a cycle's amplitude by which it may be off from a sine: the second harmonic of monthly means of temperatures reaches a
tenth in a temperate climate, heated halls have more."""

GRID_TIMES = 400
"""Times at which a drift may have begun: a day each of a year."""

INTERVAL_PROBABILITY = 0.95
"""Of the interval in which a drift or a jump began."""


@dataclass(frozen=True)
class Series:
    """One constant of one robot, n runs in the order of time.

    Attributes:
        day: When each was measured, [d], shape (n,).
        value: Of the constant, shape (n,), [m] or [rad].
        std: 1-sigma, shape (n,).
    """

    day: np.ndarray
    value: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class Cycle:
    """A yearly cycle as other robots show it: its two numbers, and their scatter from robot to robot.

    Attributes:
        mean: Amplitudes of cosine and sine of the day, [m] or [rad].
        std: Scatter of both, likewise.
    """

    mean: tuple[float, float]
    std: tuple[float, float]


@dataclass(frozen=True)
class ChangeEvidence:
    """Whether a series shows anything but a yearly cycle.

    Attributes:
        p_value: Chance of as much where there is nothing, for all shapes of this series together; 1 if it cannot be told.
        p_any: Chance likewise, with a yearly cycle counted as a change, too.
        shapes: Number of shapes that were tried.
        squares: Sum of squares that a constant and a cycle leave, in sigmas, and its degrees of freedom.
    """

    p_value: float
    p_any: float
    shapes: int
    squares: tuple[float, int]


@dataclass(frozen=True)
class SeriesChange:
    """A change that a series shows.

    Attributes:
        kind: ``drift``, ``jump`` or ``odd run``.
        began: Day of the beginning, [d]; of a jump the middle of the interval, of an odd run its day.
        low: Earliest day of the interval.
        high: Latest day of the interval.
        before_first: True if it may have begun before the first run.
        size: Of a jump or an odd run, of a drift per day, [m] or [rad].
        std: Sigma of the size.
        so_far: Change until the last run, [m] or [rad]; of an odd run 0.
    """

    kind: str
    began: float
    low: float
    high: float
    before_first: bool
    size: float
    std: float
    so_far: float


def evidence(series: Series) -> ChangeEvidence:
    """The evidence of one series for a change."""
    n, weight = len(series.day), 1.0 / series.std
    steady = _Steady(weight, np.ones((n, 1)), series.value)
    if n < FEWEST_RUNS:
        return ChangeEvidence(1.0, _p_of_pairs(series), 1, (steady.squares(), n - 1))
    always = with_cycle(series.day)
    shapes = _shapes(series.day)
    beside = _Steady(weight, always, series.value)
    z = beside.scores(shapes)
    best = shapes[:, [int(np.argmax(np.abs(z)))]]
    columns = np.hstack([always, best]) * weight[:, None]
    amplitude = float(np.hypot(*np.linalg.lstsq(columns, series.value * weight, rcond=1e-10)[0][1:3]))
    blurred = 1.0 / np.hypot(series.std, CYCLE_SHAPE_ERROR * amplitude / np.sqrt(2.0))  # of a wave the RMS
    z = _Steady(blurred, always, series.value).scores(shapes)
    z_any = steady.scores(np.hstack([shapes, always[:, 1:]]))
    return ChangeEvidence(
        _bonferroni(z), _bonferroni(z_any), int(np.sum(z != 0.0)), (beside.squares(), n - always.shape[1])
    )


def dated(series: Series, cycle: Cycle | None = None) -> SeriesChange:
    """The likeliest change of a series; only of use where :func:`evidence` says that there is one.

    Args:
        series: One constant.
        cycle: Prior of the yearly cycle; None: nothing is known, and there may be none.
    """
    n, day = len(series.day), series.day
    span, weight = day[-1] - day[0], 1.0 / series.std
    ways = [_Steady(weight, np.ones((n, 1)), series.value)]
    if n >= FEWEST_RUNS:
        ways = (
            [*ways, _Steady(weight, with_cycle(day), series.value)]
            if cycle is None
            else [_with_cycle_known(series, cycle)]
        )
    grid = np.linspace(day[0], day[-1], GRID_TIMES, endpoint=False)
    columns = {"drift": _hinges(day, grid), "jump": _steps(day), "odd run": np.eye(n)}
    # a flat prior in time: a grid point of a drift has its part of the span, a jump the gap that it lies in
    prior = {
        "drift": np.full(GRID_TIMES, 1.0 / GRID_TIMES),
        "jump": np.diff(day) / span,
        "odd run": np.full(n, 1.0 / n),
    }
    squares_left = {kind: [way.squares() - way.scores(columns[kind]) ** 2 for way in ways] for kind in columns}
    least = min(float(squares.min()) for of_kind in squares_left.values() for squares in of_kind)
    scale = max(1.0, least / max(n - ways[-1].count - 2, 1))  # what scatters more is known less
    prices = [0.5 * way.count * np.log(n) for way in ways]
    log_posterior = {}
    for kind in columns:
        log = [-0.5 * squares / scale - price for squares, price in zip(squares_left[kind], prices, strict=True)]
        with np.errstate(divide="ignore"):
            log_posterior[kind] = np.logaddexp.reduce(log, axis=0) + np.log(prior[kind])
    kind = max(log_posterior, key=lambda k: float(np.logaddexp.reduce(log_posterior[k])))
    share = np.exp(log_posterior[kind] - np.logaddexp.reduce(log_posterior[kind]))
    most_likely = int(np.argmax(share))
    column = columns[kind][:, most_likely]
    if kind == "odd run":
        low = began = high = float(day[most_likely])
    elif kind == "jump":
        low, _, high = _quantiles(day, share)
        began = float(day[most_likely] + day[most_likely + 1]) / 2.0
        low, high = min(low, float(day[most_likely])), max(high, float(day[most_likely + 1]))
    else:
        low, began, high = _quantiles(np.append(grid, day[-1]), share)
        column = _hinges(day, np.array([began]))[:, 0]
    best = min(zip(ways, prices, strict=True), key=lambda pair: pair[0].size(column)[2] / scale + 2.0 * pair[1])[0]
    size, std, _ = best.size(column)
    first = bool(kind == "drift" and low <= day[0] + span / GRID_TIMES)
    so_far = 0.0 if kind == "odd run" else size * float(column[-1])
    return SeriesChange(kind, began, low, high, first, size, float(np.sqrt(scale)) * std, so_far)


@dataclass(frozen=True)
class _Steady:
    """The steady part of a series, and its values.

    Attributes:
        weight: 1 over the sigma of each run, shape (n,).
        N: Columns of the steady part, shape (n, k).
        value: Shape (n,).
        prior: Rows of unit noise that hold what is known of the coefficients, shape (m, k).
        wanted: Values of these rows, shape (m,).
    """

    weight: np.ndarray
    N: np.ndarray
    value: np.ndarray
    prior: np.ndarray | None = None
    wanted: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Number of coefficients that these runs alone tell."""
        return self.N.shape[1] - (0 if self.prior is None else len(self.prior))

    @cached_property
    def _orthonormal(self) -> tuple[np.ndarray, np.ndarray]:
        """An orthonormal basis of the columns, in sigmas, and what they leave of the values."""
        A, x = self.N * self.weight[:, None], self.value * self.weight
        if self.prior is not None and self.wanted is not None:
            A, x = np.vstack([A, self.prior]), np.append(x, self.wanted)
        Q, _ = np.linalg.qr(A)
        return Q, x - Q @ (Q.T @ x)

    def squares(self) -> float:
        """Sum of squares that the steady part leaves, in sigmas."""
        return float(np.sum(self._orthonormal[1] ** 2))

    def beside(self, columns: np.ndarray) -> np.ndarray:
        """Columns (n, G) in sigmas less what the steady part explains of them."""
        Q, x = self._orthonormal
        g = np.zeros((len(x), columns.shape[1]))
        g[: len(self.weight)] = columns * self.weight[:, None]
        return np.asarray(g - Q @ (Q.T @ g))

    def scores(self, columns: np.ndarray) -> np.ndarray:
        """Z of each column (n, G) beside the steady part, shape (G,); 0 where that explains all but a little of the column."""
        residual = self.beside(columns)
        remaining = np.sum(residual**2, axis=0)
        size = np.sum(((columns - columns.mean(axis=0)) * self.weight[:, None]) ** 2, axis=0)
        tellable = remaining > TELLABLE_SHARE * np.maximum(size, np.finfo(float).tiny)
        return np.asarray(
            np.where(tellable, residual.T @ self._orthonormal[1] / np.sqrt(np.where(tellable, remaining, 1.0)), 0.0)
        )

    def size(self, column: np.ndarray) -> tuple[float, float, float]:
        """Size of one column (n,) beside the steady part, its sigma, and the squares that both leave."""
        residual = self.beside(column[:, None])[:, 0]
        remaining, pull = max(float(residual @ residual), np.finfo(float).tiny), float(residual @ self._orthonormal[1])
        return pull / remaining, 1.0 / np.sqrt(remaining), self.squares() - pull**2 / remaining


def _with_cycle_known(series: Series, cycle: Cycle) -> _Steady:
    """A constant, and a cycle with a prior."""
    root = 1.0 / np.asarray(cycle.std)
    prior = np.hstack([np.zeros((2, 1)), np.diag(root)])
    return _Steady(1.0 / series.std, with_cycle(series.day), series.value, prior, root * np.asarray(cycle.mean))


def with_cycle(day: np.ndarray) -> np.ndarray:
    """A constant and a yearly cycle, shape (n, 3)."""
    phase = 2.0 * np.pi * day / YEAR
    return np.column_stack([np.ones(len(day)), np.cos(phase), np.sin(phase)])


def _hinges(day: np.ndarray, begins: np.ndarray) -> np.ndarray:
    """Drifts from given times on, [d], shape (n, len(begins))."""
    return np.maximum(day[:, None] - begins[None, :], 0.0)


def _steps(day: np.ndarray) -> np.ndarray:
    """Jumps before each run but the first, shape (n, n - 1)."""
    number = np.arange(len(day))
    return (number[:, None] >= number[None, 1:]).astype(float)


def _shapes(day: np.ndarray) -> np.ndarray:
    """All changes that are tried, shape (n, G), none twice: an odd last run is a jump."""
    return np.hstack([_hinges(day, day[:-2]), _steps(day), np.eye(len(day))[:, 1:-1]])


def _bonferroni(z: np.ndarray) -> float:
    """p-value of the largest of some scores."""
    looked = np.sum(z != 0.0)
    return float(min(1.0, 2.0 * looked * ndtr(-np.abs(z).max(initial=0.0))))


def _p_of_pairs(series: Series) -> float:
    """p-value of few runs: whether any pair of them differs (Bonferroni)."""
    x, s = series.value, series.std
    a, b = np.triu_indices(len(x), 1)
    return _bonferroni((x[a] - x[b]) / np.hypot(s[a], s[b]))


def _quantiles(edges: np.ndarray, share: np.ndarray) -> tuple[float, float, float]:
    """Low, middle and high of a density that is flat in each bin."""
    total = np.concatenate([[0.0], np.cumsum(share)])
    low, middle, high = np.interp(
        [(1 - INTERVAL_PROBABILITY) / 2, 0.5, (1 + INTERVAL_PROBABILITY) / 2], total / total[-1], edges
    )
    return float(low), float(middle), float(high)
