r"""Two groups of rows that differ by one shift: a target seated otherwise in some, another reflector, a slip that stayed.

Two normal groups of one covariance, a share :math:`\pi` of the rows :math:`\delta` off the others, against one (McLachlan and
Peel, Finite Mixture Models, Wiley 2000). With the residuals x white, :math:`u = \delta / |\delta|`, :math:`y = u^T x` and
:math:`v = 1 - \pi (1 - \pi) |\delta|^2`, only y tells them apart,

.. math:: T = 2 \sum_n \log \frac{\pi\, \varphi(y_n; (1 - \pi) |\delta|, v)
          + (1 - \pi)\, \varphi(y_n; -\pi |\delta|, v)}{\varphi(y_n; 0, 1)}

and T is made largest by expectation and maximisation from several directions. What chance makes of it comes from the rows
themselves, with signs drawn at random: that keeps any symmetric noise, long tails too. Groups that are nearly as large as each
other survive that. Tails never look like such groups; of one noise only one without tails does, as rounding makes it: they are
set against even noise, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import Channels
from aridcal.engine.levels import DOUBT, FEWEST_NOISE_ROWS, FEWEST_TOGETHER
from aridcal.engine.numerics import TINY
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_tests import FALSE_ALARM, Clue
from aridcal.system.errors import name_list

LEAST_SHARE = 0.04
"""Share of the rows that a group has at the least: fewer are outliers, and flagged as such."""

EVEN_SHARE = 0.25
"""Share from which random signs may leave two groups much as they were."""

LEAST_STATISTIC = 20.0
"""Work: T below which nobody draws anything: of normal noise in three axes one set of rows in a hundred has more, and
:data:`GROUP_DRAWS` of them take as many times as long."""

GROUP_DRAWS = 60
"""Work: Sets of rows that say what chance does; their largest T is Gumbel's, whose scale is then known to a tenth."""

FIRST_DRAWS = 12
"""Work: Of these, those that are looked at first: where they leave a chance of :data:`DOUBT` to T, their scale, known to 30 %,
would have to be wrong by a factor of 2.4 for all of them to leave less than :data:`FALSE_ALARM`."""

MOST_GROUP_ROWS = 600
"""Work: Rows that are looked at, spread evenly over more."""

EM_STEPS = 25
"""Work: Steps of expectation and maximisation: groups that differ by two sigmas have settled then."""

FIRST_SHARE = 0.2
"""Work: Share of the rows that the search begins with, those farthest along a direction."""

MOST_EXPLAINED = 0.98
"""Work: Largest share of the variance along its direction that a shift may explain: the groups have some width."""


@dataclass(frozen=True)
class _Groups:
    """The likeliest two groups of each of B sets of rows: statistic (B,), share (B,), and of each row the chance (B, n)."""

    T: np.ndarray
    share: np.ndarray
    chance: np.ndarray


def groups(rows: Dataset, residual: np.ndarray, fit: Fit) -> list[Clue]:
    """Ask whether a share of the rows is shifted by one vector, in world axes or in the target's.

    Args:
        rows: N rows, independent of each other.
        residual: Residuals of these rows, shape (N, m).
        fit: The model, for the target's axes.

    Returns:
        The clearest clue; none where rows are too few, or nothing stands out.
    """
    views = []
    for number in range(len(rows.blocks)):
        of_block = np.flatnonzero(rows.labels.block == number)
        if len(of_block) < FEWEST_NOISE_ROWS:
            continue
        of_block = of_block[np.linspace(0, len(of_block) - 1, min(len(of_block), MOST_GROUP_ROWS)).round().astype(int)]
        part = rows.select(of_block)
        columns = ~np.isnan(residual[of_block]).any(axis=0)
        channels = tuple(c for c, measured in zip(rows.channels, part.measures.T, strict=True) if measured.any())
        r = residual[of_block][:, columns]
        views += [(part, channels, words, view) for words, view in _views(part, channels, r, fit)]
    answers = [clue for one in views if (clue := _clue(*one, len(views))) is not None]
    return [min(answers, key=lambda clue: clue.p_value)] if answers else []


def _views(rows: Dataset, channels: Channels, r: np.ndarray, fit: Fit) -> list[tuple[str, np.ndarray]]:
    """Residuals in world axes and, where channels have three axes, in those of the target; each with its words."""
    if not all(channel.size == 3 for channel in channels):
        return [("", r)]
    fit_problem = problem(fit.model, rows).settled(fit.theta)
    R, _ = fit_problem.model.poses(fit.theta, fit_problem.rows)
    turned = np.hstack([np.einsum("nji,nj->ni", R, r[:, 3 * k : 3 * k + 3]) for k in range(len(channels))])
    return [("in world axes", r), ("in the target's axes", turned)]


def _clue(rows: Dataset, channels: Channels, words: str, r: np.ndarray, times: int) -> Clue | None:
    """The clue of one of several views, ``times`` of them; None where one group will do."""
    x = _white(r)
    fitted_groups = _likeliest(x[None])
    T, share, chance = float(fitted_groups.T[0]), float(fitted_groups.share[0]), fitted_groups.chance[0]
    if T < LEAST_STATISTIC:
        return None
    few = chance > 0.5 if share <= 0.5 else chance < 0.5
    smaller = min(share, 1.0 - share)
    if min(few.sum(), len(few) - few.sum()) < FEWEST_TOGETHER:
        return None
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], (GROUP_DRAWS, len(x), 1))
    p_value = _chance(T, x * signs)
    if smaller >= EVEN_SHARE:
        p_value = 2.0 * min(p_value, _chance(T, rng.uniform(-1.0, 1.0, (GROUP_DRAWS, *x.shape))))
    p_value = min(1.0, times * p_value)
    if p_value >= FALSE_ALARM:
        return None
    shift = r[few].mean(axis=0) - r[~few].mean(axis=0)
    along = shift / np.linalg.norm(shift)
    variance = float(np.mean(few)) * float(np.mean(~few)) * float(shift @ shift) / max(float(np.var(r @ along)), TINY)
    lines = name_list([str(line) for line in np.sort(rows.origin.line[few]).tolist()])
    what = (
        f"{few.sum()} of {len(few)} rows are {_shift(shift, channels)} off the others, {words}".rstrip(", ")
        + f": is the target seated otherwise there? Lines {lines}"
    )
    return Clue("groups", what, min(variance, 1.0), p_value)


def _chance(T: float, sets: np.ndarray) -> float:
    """Probability that rows without groups have a statistic of at least T, from sets of them, shape (B, n, k).

    Where the first sets make T likely, the others are not looked at.
    """
    first = _statistics(sets[:FIRST_DRAWS])
    p_value = _gumbel_tail(T, first)
    return p_value if p_value >= DOUBT else _gumbel_tail(T, np.concatenate([first, _statistics(sets[FIRST_DRAWS:])]))


def _statistics(sets: np.ndarray) -> np.ndarray:
    """T of each of B sets of rows, shape (B, n, k)."""
    return _likeliest(np.array([_white(rows) for rows in sets])).T


def _gumbel_tail(T: float, chances: np.ndarray) -> float:
    """Probability of at least T, from a sample of what chance makes of it (Gumbel 1958)."""
    scale = max(float(chances.std()), TINY) * np.sqrt(6.0) / np.pi
    place = float(chances.mean()) - np.euler_gamma * scale
    return float(-np.expm1(-np.exp((place - T) / scale)))


def _shift(shift: np.ndarray, channels: Channels) -> str:
    """Size and direction of a shift in words: ``0.7 mm along (0.01 -0.03 1.00)``."""
    parts, begin = [], 0
    for channel in channels:
        of_channel = shift[begin : begin + channel.size]
        begin += channel.size
        size = float(np.linalg.norm(of_channel))
        direction = (
            f" along ({' '.join(f'{number:.2f}' for number in of_channel / max(size, TINY))})"
            if channel.size > 1
            else ""
        )
        parts.append(f"{channel.scale * size:.2g} {channel.shown}{direction}")
    return " and ".join(parts)


def _white(r: np.ndarray) -> np.ndarray:
    """Rows (n, k) with mean zero and covariance one."""
    centred = r - r.mean(axis=0)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(centred.T, bias=True)))
    spanned = values > TINY + 1e-12 * values[-1]
    return np.asarray(centred @ (vectors[:, spanned] / np.sqrt(values[spanned])))


def _likeliest(x: np.ndarray) -> _Groups:
    """The two groups that make T largest, of sets of white rows, shape (B, n, k)."""
    count, _, k = x.shape
    skew = np.einsum("bnk,bn->bk", x, np.sum(x**2, axis=2))
    skew /= np.maximum(np.linalg.norm(skew, axis=1, keepdims=True), TINY)
    axes = np.stack([np.eye(k), -np.eye(k)], axis=1).reshape(2 * k, k)
    tries = _maximised(x, np.concatenate([skew[:, None], np.broadcast_to(axes, (count, 2 * k, k))], axis=1))
    best = np.arange(count), np.argmax(tries.T, axis=1)
    return _Groups(tries.T[best], tries.share[best], tries.chance[best])


def _maximised(x: np.ndarray, directions: np.ndarray) -> _Groups:
    """Expectation and maximisation from the rows farthest along each of D directions, shape (B, D, k); all results by (B, D)."""
    across = x.transpose(0, 2, 1)
    y = directions @ across
    chance = (y >= np.quantile(y, 1.0 - FIRST_SHARE, axis=2)[..., None]).astype(float)
    for _ in range(EM_STEPS):
        share = np.clip(chance.mean(axis=2), LEAST_SHARE, 1.0 - LEAST_SHARE)
        product = share * (1.0 - share)
        delta = chance @ x / (x.shape[1] * product)[..., None]
        length = np.maximum(np.linalg.norm(delta, axis=2), TINY)
        y = delta / length[..., None] @ across
        length = np.minimum(length, np.sqrt(MOST_EXPLAINED / product))
        v = 1.0 - product * length**2
        odds = np.log(share / (1.0 - share))[..., None] + (length / v)[..., None] * (
            y - ((0.5 - share) * length)[..., None]
        )
        chance = expit(odds)
    others = np.log1p(-share)[..., None] - 0.5 * (
        (y + (share * length)[..., None]) ** 2 / v[..., None] + np.log(v)[..., None]
    )
    return _Groups(2.0 * np.sum(others + np.logaddexp(0.0, odds) + 0.5 * y**2, axis=2), share, chance)
