r"""Model error apart from noise: halves of the rows that differ in a block, fitted apart and compared.

Noise is independent from row to row; what a model lacks is not: it depends on a joint, on time, on a load. Rows are therefore
divided by blocks (low and high readings of a joint, its middle and its ends, its alternate quarters; the same in time; the
side of approach, a load), every coefficient that both halves tell is fitted to each half apart, and the two are compared:

.. math:: T^2 = (\theta_A - \theta_B)^T (\Sigma_A + \Sigma_B)^+ (\theta_A - \theta_B) = S_{AB} - S_A - S_B, \qquad
          F = \frac{T^2 / d}{(S_A + S_B) / (n - k - d)}

with the squares S that fits to both, and to each half, leave, and d the rank of the difference (Chow 1960, doi:10.2307/1910133).
What no row tells has no part in it: the difference is taken in the identifiable subspace. Things that instruments refer to
(points, anchors, boards) and samples of smooth functions are common to both halves: they are no halves' own. F needs no
noise to be known.

Many divisions are looked at, and the one that shows most is named. What chance makes of the best of so many is not a guess:
the same rows are given noise instead of residuals, :data:`NULL_DRAWS` times, and all is done again (Monte Carlo test; Dwass
1957, doi:10.1214/aoms/1177707045). So the p-value is uniform where nothing is missing, however the divisions hang together.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import covariate_table
from aridcal.engine.fit.elimination import Elimination
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.normal_equations import across, pseudo_inverse, root_of_inverse
from aridcal.engine.levels import RARE
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.numerics import FLOOR
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.split import held_back_groups
from aridcal.engine.trust.columns import Columns, columns_of
from aridcal.system.progress import SILENT, Progress

MOST_COMPARED_ROWS = 1000
"""Work: Rows at the most that are compared: 300 show an error as large as the noise, and every draw costs as many as there
are."""

NULL_DRAWS = 199
"""Work: Sets of noise that say what chance does: a p-value near 0.05 is then known to 0.015. Smaller ones are bounded by
Bonferroni's."""

HALF_RANK = 1e-8
"""Work: Share of the largest eigenvalue, coefficients scaled alike, below which a half tells nothing of a difference: rounding
of the sums leaves 1e-12, and a direction known 10,000 times worse than another would only dilute it."""

SMALLEST_HALF = 0.2
"""Share of the rows below which a side is no half: a few rows of it would decide."""

NOISELESS_FACTOR = 10.0
"""Work: Times what counts as rounding: below it there is no noise that the halves could be compared with."""

PATTERNS = {
    "low and high": (0, 0, 0, 0, 1, 1, 1, 1),
    "the middle and the ends": (0, 0, 1, 1, 1, 1, 0, 0),
    "alternate quarters": (0, 0, 1, 1, 0, 0, 1, 1),
    "alternate quarters from an eighth on": (0, 1, 1, 0, 0, 1, 1, 0),
    "alternate eighths": (0, 1, 0, 1, 0, 1, 0, 1),
}
"""Which eighths of a column's values make a half: Walsh functions, so that one period over the range, or two, of any phase,
differ between the halves of at least one of them."""

GRAVITY = ".gravity_"
"""In the names of gravity's loads."""


@dataclass(frozen=True)
class Division:
    """Rows divided into two halves.

    Attributes:
        of: The column that divides them: a joint, a covariate, or ``row`` for the order of measurement.
        how: One of :data:`PATTERNS`.
        side: Rows of the second half, shape (N,) bool.
    """

    of: str
    how: str
    side: np.ndarray


@dataclass(frozen=True)
class Halves:
    """Halves of the rows fitted apart.

    Attributes:
        p_value: Chance that noise alone makes the halves of any division differ as much.
        of: The column of the division that differs most.
        how: How it divides the rows.
        squares: T^2 of that division over its freedom and over the noise of the rows: 1 is expected.
        freedom: Degrees of freedom of the difference, and of the noise.
        divisions: Number of divisions compared.
        rows: Number of rows compared.
        measured: RMS difference of the two predicted targets over these rows, both frames of the one moved so that the two
            agree best, [m].
        expected: What noise alone makes of that where this division is the one that differs most by chance, [m].
    """

    p_value: float
    of: str
    how: str
    squares: float
    freedom: tuple[int, int]
    divisions: int
    rows: int
    measured: float
    expected: float

    @property
    def agree(self) -> bool:
        """Whether noise explains what differs."""
        return self.p_value >= RARE


def halves(fit: Fit, train: Dataset, progress: Progress = SILENT) -> Halves | None:
    """Fit halves of the rows apart and compare them; None where there are too few rows, or no noise, to do so.

    Args:
        fit: K coefficients.
        train: The rows that it was fitted to.
        progress: Told how far the pass over them is.
    """
    if len(fit.theta) == 0 or np.all(fit.estimated <= NOISELESS_FACTOR * FLOOR):
        return None
    of_rows = columns_of(fit, train, np.maximum(fit.estimated, FLOOR), MOST_COMPARED_ROWS, progress)
    of_half = np.array([_is_of_half(c) for c in fit.model.coefficients])
    rows = train.select(of_rows.rows)
    frames = np.array([c.where in ("world_base", "tip_target") and c.basis.constant for c in fit.model.coefficients])
    at_target = _at_target(of_rows.target, of_half, frames)
    comparisons = list(_comparisons(of_rows, divisions(rows, _loads(fit, rows)), of_half, rows, at_target))
    if not comparisons:
        return None
    p_values = np.array([each.p_values for each in comparisons])
    best, least = p_values.argmin(axis=0), p_values.min(axis=0)
    by_draws = float(np.sum(least <= least[0])) / len(least)
    worst = comparisons[best[0]]
    moved = [comparisons[k].moved[draw] for draw, k in enumerate(best)]
    return Halves(
        p_value=min(by_draws, len(comparisons) * float(least[0])),
        of=worst.division.of,
        how=worst.division.how,
        squares=worst.squares,
        freedom=worst.freedom,
        divisions=len(comparisons),
        rows=len(of_rows),
        measured=float(np.sqrt(worst.usual * moved[0])),
        expected=float(np.sqrt(worst.usual * np.mean(moved[1:]))),
    )


def _loads(fit: Fit, rows: Dataset) -> dict[str, np.ndarray]:
    """Load of gravity on every joint of the nominal arm, by name, shape (N,) each: bending depends on sums of readings."""
    model = fit.model
    world = rows_of_data(model, rows).world
    table = covariate_table(model.robot, rows.readings, rows.covariates, model.around, world, {GRAVITY})
    return {name: values for name, values in table.items() if GRAVITY in name}


def _is_of_half(c: Coefficient) -> bool:
    """True for a coefficient that each half has of its own: all but samples of smooth functions and frames of single stations."""
    return not c.basis.smooth and c.station is None


def divisions(rows: Dataset, loads: Mapping[str, np.ndarray]) -> list[Division]:
    """Every way in which rows are divided into halves by blocks; readings of turning joints within one turn, and as they are.

    Args:
        rows: N rows.
        loads: Loads of gravity on the joints, by name, shape (N,) each.
    """
    candidates = []
    joints = zip(rows.names, rows.kinds, rows.readings.T, strict=True)
    columns = [(of, np.angle(np.exp(1j * q)) if kind != "prismatic" else q) for of, kind, q in joints]
    for of, values in [*columns, ("row", np.argsort(rows.sequence).astype(float))]:
        eighth = np.minimum(8 * np.searchsorted(np.sort(values), values) // len(values), 7)
        candidates += [Division(of, how, np.array(pattern)[eighth] == 1) for how, pattern in PATTERNS.items()]
    readings = dict(zip(rows.names, rows.readings.T, strict=True))
    for of, values in (readings | rows.covariates | dict(loads)).items():
        if np.isfinite(values).all():
            middle = np.median(values)
            above, least = values > middle, values >= middle
            side = min((above, least), key=lambda half: abs(half.mean() - 0.5))
            candidates.append(Division(of, next(iter(PATTERNS)), side))
    distinct: dict[bytes, Division] = {}
    for each in candidates:
        balance = min(each.side.mean(), 1.0 - each.side.mean())
        if balance >= SMALLEST_HALF:
            distinct.setdefault((each.side ^ each.side[0]).tobytes(), each)  # whichever half is called the second
    return list(distinct.values())


@dataclass(frozen=True)
class _Comparison:
    """The halves of one division compared, for the residuals and for each draw of noise.

    Attributes:
        division: Which rows are on which side.
        p_values: p-values of the residuals, then of each draw, shape (1 + DRAWS,).
        squares: See :class:`Halves`.
        freedom: See :class:`Halves`.
        usual: Mean square of the difference at the target that noise makes, [m^2].
        moved: Mean square of the difference at the target, of the residuals and of each draw, in units of ``usual``, shape
            (1 + DRAWS,); NaN where an earlier division differs as much.
    """

    division: Division
    p_values: np.ndarray
    squares: float
    freedom: tuple[int, int]
    usual: float
    moved: np.ndarray


def _comparisons(
    rows: Columns, divided: list[Division], of_half: np.ndarray, data: Dataset, at_target: np.ndarray
) -> Iterator[_Comparison]:
    """Compare the halves of every division that leaves enough numbers.

    Args:
        rows: N rows of m numbers.
        divided: The divisions.
        of_half: Coefficients that each half has of its own, shape (K,) bool.
        data: The same rows.
        at_target: Square of a difference of those coefficients at the target, shape (k, k); see :func:`_at_target`.
    """
    N, m, K = rows.J.shape
    things = rows.solved()
    J = rows.J.reshape(N * m, K)
    none = np.zeros((len(rows.prior.misfit), K))
    JP, tied = rows.less(rows.J, none, things)
    inverse, spent = pseudo_inverse(J.T @ JP.reshape(N * m, K), HALF_RANK)
    sets, beforehand = _draws(rows, data)
    sets, beforehand = rows.less(sets, beforehand, things)
    flat = sets.reshape(N * m, -1)
    # All coefficients together, fitted to the residuals and to every draw.
    steps = inverse @ (J.T @ flat)
    flat = flat - JP.reshape(N * m, K) @ steps
    beforehand = beforehand - tied @ steps
    squares = np.sum(flat**2, axis=0) + np.sum(beforehand**2, axis=0)
    numbers = rows.share * rows.there.sum() + len(rows.prior.misfit) - np.sum(things.rank)
    freedom = round(float(numbers)) - spent
    least = np.full(flat.shape[1], np.inf)
    for division, side in zip(divided, _sides(rows, divided, of_half, things, flat, data.labels.route), strict=True):
        M = side.squares - side.cross.T @ inverse @ side.cross
        root = root_of_inverse(M, HALF_RANK)
        d = len(root)
        if d == 0 or freedom - d < d:
            continue
        w = root @ side.pull
        T2 = np.sum(w**2, axis=0)
        noise = (squares - T2) / (freedom - d)
        F = T2 / d / np.maximum(noise, np.finfo(float).tiny)
        p_values = fdtrc(d, freedom - d, F)
        worst = p_values < least  # the motion of the target is computed for these alone
        least = np.minimum(least, p_values)
        difference, moved = root.T @ w[:, worst], np.full(len(F), np.nan)
        usual = max(float(np.sum(at_target * (root.T @ root))), np.finfo(float).tiny) if worst.any() else np.nan
        moved[worst] = np.maximum(np.sum(difference * (at_target @ difference), axis=0), 0.0) / usual
        yield _Comparison(division, p_values, float(F[0]), (d, freedom - d), usual, moved)


@dataclass(frozen=True)
class _Side:
    """Sums over the second half of a division, of the k columns that each half has of its own.

    Attributes:
        squares: Products with one another, shape (k, k), less what the things take up.
        cross: Products with all columns, shape (K, k), likewise.
        pull: Products with the rest of the residuals and of each draw, shape (k, 1 + DRAWS).
    """

    squares: np.ndarray
    cross: np.ndarray
    pull: np.ndarray


def _sides(
    rows: Columns,
    divided: list[Division],
    of_half: np.ndarray,
    things: Elimination,
    flat: np.ndarray,
    route: np.ndarray | None,
) -> Iterator[_Side]:
    """The sums of every division; those of one column are made of the same few parts of the rows.

    Args:
        rows: N rows of m numbers.
        divided: The divisions.
        of_half: Coefficients that each half has of its own, shape (K,) bool.
        things: Things of all rows: rows share them, so that sums over parts of the rows do not add up to those over all.
        flat: Residuals and draws after the fit of all coefficients, shape (N m, 1 + DRAWS).
        route: Number of the path that each row takes, shape (N,); None where all take one.
    """
    N, m, K = rows.J.shape
    if rows.groups is not None:
        J, none = rows.J.reshape(N * m, K), np.zeros((len(rows.prior.misfit), int(of_half.sum())))
        for division in divided:
            A = np.where(division.side[:, None, None], rows.J[:, :, of_half], 0.0)
            AP = rows.less(A, none, things)[0].reshape(N * m, -1)
            A = A.reshape(N * m, -1)
            yield _Side(A.T @ AP, J.T @ AP, A.T @ flat)
        return
    path_of_row = np.zeros(N) if route is None else route
    limbs = [
        _Limb(np.flatnonzero(path_of_row == path), rows.J, of_half, flat.reshape(N, m, -1))
        for path in np.unique(path_of_row)
    ]
    sides_of: dict[str, dict[bytes, _Side]] = {}
    for division in divided:
        if division.of not in sides_of:
            same = np.array([sibling.side for sibling in divided if sibling.of == division.of])
            bits = np.arange(len(same))[::-1]
            code, number = np.unique(2**bits @ same, return_inverse=True)
            parts = code >> bits[:, None] & 1
            crosses, pulls = (
                np.zeros((len(same), K, of_half.sum())),
                np.zeros((len(same), of_half.sum(), flat.shape[1])),
            )
            for limb in limbs:
                each = {c: limb.sums(number == c) for c in np.flatnonzero(parts.any(axis=0)).tolist()}
                for cross, pull, some in zip(crosses, pulls, parts, strict=True):
                    chosen = [each[c] for c in np.flatnonzero(some).tolist()]
                    cross[np.ix_(limb.columns, limb.own)] += sum(c for c, _ in chosen)
                    pull[limb.own] += sum(p for _, p in chosen)
            sides = [_Side(cross[of_half], cross, pull) for cross, pull in zip(crosses, pulls, strict=True)]
            sides_of[division.of] = dict(zip((side.tobytes() for side in same), sides, strict=True))
        yield sides_of[division.of].pop(division.side.tobytes())


class _Limb:
    """Rows of one path: coefficients of other limbs do not move them."""

    def __init__(self, rows: np.ndarray, J: np.ndarray, of_half: np.ndarray, residuals: np.ndarray) -> None:
        """Keep the rows of one path, and the columns that move them.

        Args:
            rows: Numbers of the limb's rows.
            J: Columns of all N rows, shape (N, m, K).
            of_half: Coefficients that each half has of its own, shape (K,) bool.
            residuals: Residuals and draws after the fit of all coefficients, shape (N, m, 1 + DRAWS).
        """
        self.columns = np.flatnonzero(J[rows].any(axis=(0, 1)))
        self._rows, self._own = rows, of_half[self.columns]
        self.own = (np.cumsum(of_half) - 1)[self.columns[self._own]]
        self._J, self._residuals = J[rows][:, :, self.columns], residuals[rows]

    def sums(self, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cross and pull of :class:`_Side` over some of the N rows, shape (N,) bool, of the columns that are not zero."""
        chosen = some[self._rows]
        J, residuals = (x[chosen].reshape(-1, x.shape[2]) for x in (self._J, self._residuals))
        A = J[:, self._own]
        # Products of columns with themselves are symmetric, and half the work.
        cross = (J.T @ J)[:, self._own] if 2 * A.shape[1] > J.shape[1] else J.T @ A
        return cross, A.T @ residuals


def _draws(rows: Columns, data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """The residuals and then sets of noise, shape (N, m, 1 + DRAWS); the same for what is known beforehand, (T, 1 + DRAWS).

    The same rows give the same noise, other rows other noise: what chance made of one campaign is not that of the next.
    """
    of_kinds = () if data.direct else (data.observed,)
    content = b"".join(values.tobytes() for values in (data.readings, data.position, *of_kinds))
    rng = np.random.default_rng(int.from_bytes(hashlib.sha256(content).digest()))
    N, m = rows.r.shape
    if rows.share < 1.0:  # rows of one place are one measurement
        place = held_back_groups(data)
        of_places = rng.standard_normal((int(place.max()) + 1, m, NULL_DRAWS))
        draws = of_places[place] * np.sqrt(rows.share)
    else:
        draws = rng.standard_normal((N, m, NULL_DRAWS))
    noise = np.where(rows.there[:, :, None], draws, 0.0)
    beforehand = rng.standard_normal((len(rows.prior.misfit), NULL_DRAWS))
    return np.concatenate([rows.r[:, :, None], noise], axis=2), np.column_stack([rows.prior.misfit, beforehand])


def _at_target(target: np.ndarray, of_half: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Mean square at the target of a difference of coefficients, shape (k, k), less a common motion of base or target.

    Base and target are mounted anew by whoever uses a calibration: what differs by a motion of either is no difference of arms.

    Args:
        target: Shift of the target with each coefficient, shape (N, 3, K).
        of_half: Coefficients that each half has of its own, shape (K,) bool.
        frames: Coefficients of the two frames, shape (K,) bool.
    """
    J = target.reshape(-1, target.shape[2])
    J = across(J[:, frames], J[:, of_half])
    return np.asarray(J.T @ J) / len(target)
