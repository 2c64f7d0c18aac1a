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
from aridcal.engine.levels import FEWEST_ROWS, FEWEST_TOGETHER
from aridcal.engine.numerics import TINY
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_tests import SURE, Clue
from aridcal.system.errors import listed

LEAST = 0.04
"""Share of a group: fewer rows are outliers, and flagged as such."""

EVEN = 0.25
"""Share from which signs at random may leave two groups much as they were."""

WORTH = 20.0
"""Work: T below which nobody draws anything: of normal noise in three axes one set of rows in a hundred has more, and
:data:`DRAWS` of them take as many times as long."""

DRAWS = 60
"""Work: Sets of rows that say what chance does; their largest T is Gumbel's, whose scale is then known to a tenth."""

MOST = 600
"""Work: Rows that are looked at, spread evenly over more."""

STEPS = 25
"""Work: Of expectation and maximisation; what differs by two sigmas has settled then."""

FIRST = 0.2
"""Work: Share of the rows that the search begins with, those farthest along a direction."""

APART = 0.98
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
        residual: Theirs, shape (N, m).
        fit: The model, for the target's axes.

    Returns:
        The clearest answer; none where rows are too few, or nothing stands out.
    """
    asked = []
    for number in range(len(rows.blocks)):
        own = np.flatnonzero(rows.labels.block == number)
        if len(own) < FEWEST_ROWS:
            continue
        own = own[np.linspace(0, len(own) - 1, min(len(own), MOST)).round().astype(int)]
        part = rows.select(own)
        there = ~np.isnan(residual[own]).any(axis=0)
        channels = tuple(c for c, measured in zip(rows.channels, part.measures.T, strict=True) if measured.any())
        r = residual[own][:, there]
        asked += [(part, channels, words, seen) for words, seen in _views(part, channels, r, fit)]
    answers = [clue for one in asked if (clue := _asked(*one, len(asked))) is not None]
    return [min(answers, key=lambda clue: clue.p_value)] if answers else []


def _views(rows: Dataset, channels: Channels, r: np.ndarray, fit: Fit) -> list[tuple[str, np.ndarray]]:
    """Residuals in world axes, and in the target's where channels have three."""
    if not all(channel.size == 3 for channel in channels):
        return [("", r)]
    asked = problem(fit.model, rows).settled(fit.theta)
    R, _ = asked.model.poses(fit.theta, asked.rows)
    turned = np.hstack([np.einsum("nji,nj->ni", R, r[:, 3 * k : 3 * k + 3]) for k in range(len(channels))])
    return [("in world axes", r), ("in the target's axes", turned)]


def _asked(rows: Dataset, channels: Channels, words: str, r: np.ndarray, times: int) -> Clue | None:
    """One view, one of several; none where one group will do."""
    x = _white(r)
    seen = _likeliest(x[None])
    T, share, chance = float(seen.T[0]), float(seen.share[0]), seen.chance[0]
    if T < WORTH:
        return None
    few = chance > 0.5 if share <= 0.5 else chance < 0.5
    smaller = min(share, 1.0 - share)
    if min(few.sum(), len(few) - few.sum()) < FEWEST_TOGETHER:
        return None
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], (DRAWS, len(x), 1))
    p_value = _chance(T, x * signs)
    if smaller >= EVEN:
        p_value = 2.0 * min(p_value, _chance(T, rng.uniform(-1.0, 1.0, (DRAWS, *x.shape))))
    p_value = min(1.0, times * p_value)
    if p_value >= SURE:
        return None
    shift = r[few].mean(axis=0) - r[~few].mean(axis=0)
    along = shift / np.linalg.norm(shift)
    variance = float(np.mean(few)) * float(np.mean(~few)) * float(shift @ shift) / max(float(np.var(r @ along)), TINY)
    lines = listed([str(line) for line in np.sort(rows.origin.line[few]).tolist()])
    what = (
        f"{few.sum()} of {len(few)} rows are {_shift(shift, channels)} off the others, {words}".rstrip(", ")
        + f": is the target seated otherwise there? Lines {lines}"
    )
    return Clue("groups", what, min(variance, 1.0), p_value)


def _chance(T: float, drawn: np.ndarray) -> float:
    """That the largest statistic of rows without groups is at least T, from sets of these, shape (B, n, k) (Gumbel 1958)."""
    chances = _likeliest(np.array([_white(one) for one in drawn])).T
    scale = max(float(chances.std()), TINY) * np.sqrt(6.0) / np.pi
    place = float(chances.mean()) - np.euler_gamma * scale
    return float(-np.expm1(-np.exp((place - T) / scale)))


def _shift(shift: np.ndarray, channels: Channels) -> str:
    """By how much, and which way, in words: ``0.7 mm along (0.01 -0.03 1.00)``."""
    parts, begin = [], 0
    for channel in channels:
        own = shift[begin : begin + channel.size]
        begin += channel.size
        size = float(np.linalg.norm(own))
        way = f" along ({' '.join(f'{number:.2f}' for number in own / max(size, TINY))})" if channel.size > 1 else ""
        parts.append(f"{channel.scale * size:.2g} {channel.shown}{way}")
    return " and ".join(parts)


def _white(r: np.ndarray) -> np.ndarray:
    """Rows (n, k) with mean zero and covariance one."""
    centred = r - r.mean(axis=0)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(centred.T, bias=True)))
    kept = values > TINY + 1e-12 * values[-1]
    return np.asarray(centred @ (vectors[:, kept] / np.sqrt(values[kept])))


def _likeliest(x: np.ndarray) -> _Groups:
    """The two groups that make T largest, of sets of white rows, shape (B, n, k)."""
    k = x.shape[2]
    skew = np.einsum("bnk,bn->bk", x, np.sum(x**2, axis=2))
    skew /= np.maximum(np.linalg.norm(skew, axis=1, keepdims=True), TINY)
    ways = [skew, *(np.broadcast_to(sign * axis, skew.shape) for axis in np.eye(k) for sign in (1.0, -1.0))]
    best = _settled(x, ways[0])
    for way in ways[1:]:
        other = _settled(x, way)
        better = other.T > best.T
        best = _Groups(
            np.where(better, other.T, best.T),
            np.where(better, other.share, best.share),
            np.where(better[:, None], other.chance, best.chance),
        )
    return best


def _settled(x: np.ndarray, way: np.ndarray) -> _Groups:
    """Expectation and maximisation from the rows farthest along a direction, shape (B, k)."""
    y = np.einsum("bnk,bk->bn", x, way)
    chance = (y >= np.quantile(y, 1.0 - FIRST, axis=1)[:, None]).astype(float)
    for _ in range(STEPS):
        share = np.clip(chance.mean(axis=1), LEAST, 1.0 - LEAST)
        both = share * (1.0 - share)
        delta = np.einsum("bn,bnk->bk", chance, x) / (x.shape[1] * both)[:, None]
        length = np.maximum(np.linalg.norm(delta, axis=1), TINY)
        y = np.einsum("bnk,bk->bn", x, delta / length[:, None])
        length = np.minimum(length, np.sqrt(APART / both))
        v = 1.0 - both * length**2
        odds = np.log(share / (1.0 - share))[:, None] + (length / v)[:, None] * (y - ((0.5 - share) * length)[:, None])
        chance = expit(odds)
    others = np.log1p(-share)[:, None] - 0.5 * ((y + (share * length)[:, None]) ** 2 / v[:, None] + np.log(v)[:, None])
    return _Groups(2.0 * np.sum(others + np.logaddexp(0.0, odds) + 0.5 * y**2, axis=1), share, chance)
