r"""Variance components by restricted maximum likelihood: of what causes the scatter of residuals is made, and how large each is.

The residuals y of N rows of m numbers have columns A whose coefficients have a normal prior (precision :math:`\Lambda`,
often zero), and rows that err independently of one another. (Where rows of a table err together they are one row here.)

.. math:: y = A \beta + e, \qquad V_i = cov(e_i) = \sum_k \theta_k B_{ik}, \qquad \theta_k \ge 0

With :math:`H = A^T V^{-1} A + \Lambda` and :math:`P = V^{-1} - V^{-1} A H^{-1} A^T V^{-1}`, the restricted likelihood and
its derivatives are (Patterson and Thompson 1971; Harville 1977, section 4)

.. math:: \ell = -\tfrac12 \Big[\sum_i \log |V_i| + \log |H| + y^T P y\Big], \qquad
          \frac{\partial \ell}{\partial \theta_k} = \tfrac12 \big[y^T P B_k P y - tr(P B_k)\big]

It is maximised with the average information :math:`\tfrac12 y^T P B_k P B_l P y` (Gilmour, Thompson and Cullis 1995), the
mean of the observed and of Fisher's, which needs P times vectors only. Rows being independent, :math:`tr(P B_k)` needs
only the diagonal blocks :math:`P_{ii}`, and is exact. Far from the maximum :mod:`aridcal.engine.fit.minorant` says where to
look next.

Unknown things, of which there may be thousands, have columns as well, without a prior. Those of one clump of rows are not
zero in these rows alone, and are solved for clump by clump: with M the projection that takes them off the whitened rows,
:math:`\log |H|` is the sum of the clumps' own and of that of :math:`A^T M A + \Lambda`. That, too, is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from aridcal.engine.fit.minorant import Bound, moments
from aridcal.engine.fit.normal_equations import shortest
from aridcal.engine.fit.scatter import Place, Scatter, covariances, derivatives, place
from aridcal.engine.levels import PLAINLY, RARE
from aridcal.engine.numerics import HALVINGS, STEPS, TINY

FAR = 1.0
"""Work: [nat]: a step of the average information that promises more is not near enough for it to be trusted; a bound is
maximised instead, which never overshoots."""

SETTLED = 1e-3
"""Work: [nat] that the maximum may be out by after the last of all steps: a twentieth of a standard deviation."""

ROUGH = 0.1
"""Work: [nat]: the same as long as components are added. A likelihood ratio is then out by less than a tenth, and the chance of
noise by a tenth of itself; what has settled better takes twice the time."""

OFF = 0.1
"""Work: Share of what a step promises, below :data:`FAR`, by which its gain is off half of that: less in 99 of 100 steps from
places about the maximum in 60 rows of 4 numbers."""

CLEAR = 0.95
"""Work: What is less than this share of something is less where variances have settled, too: scores move by a fiftieth until
then."""

LEAST = 1e-6
"""Work: Share of its start below which the variance of a channel does not fall: a covariance must be positive, and an
instrument a thousand times better than the scatter is no instrument."""

IMITATED = 0.01
"""Share of a component's information that must be its own: with less, those in the model imitate it."""


@dataclass(frozen=True)
class Components:
    """Variances at the maximum of the restricted likelihood.

    Attributes:
        free: Those in the model, shape (C,) bool.
        variance: Of each component, shape (C,), not negative; 0 for those that are not in the model.
        covariance: Of those estimates, shape (C, C); 0 for those that are not in the model, or vanished.
        log_likelihood: Restricted, but for a constant.
        pull: P y of each row, shape (N, m).
        kernel: P_ii of each row, shape (N, m, m).
        low: Below which no variance falls, shape (C,): by what the channels began with, however often they are settled anew.
        at: Variances of which pull, kernel and covariance are, shape (C,): one short step from those of the maximum.
        left: [nat] that the log-likelihood is out by at the most.
    """

    free: np.ndarray
    variance: np.ndarray
    covariance: np.ndarray
    log_likelihood: float
    pull: np.ndarray
    kernel: np.ndarray
    low: np.ndarray
    at: np.ndarray
    left: float

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation of each component, shape (C,)."""
        return np.sqrt(self.variance)

    @property
    def sigma_std(self) -> np.ndarray:
        """1-sigma of :attr:`sigma`, shape (C,); see :func:`std_of_sigma`."""
        return std_of_sigma(self.variance, self.covariance)


def std_of_sigma(variance: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """1-sigma of standard deviations, shape (C,): that of the variance over twice the standard deviation.

    Where the variance is not known to differ from zero, it is the standard deviation that it may have.

    Args:
        variance: Shape (C,).
        covariance: Of the variances, shape (C, C).
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    small = np.minimum(std / np.maximum(2.0 * np.sqrt(variance), TINY), np.sqrt(std))
    return np.asarray(np.where(variance > 0.0, small, 0.0))


def estimate(scatter: Scatter, channels: np.ndarray, held: np.ndarray) -> Components:
    """Maximise the restricted likelihood with the components alone that any residual has: the channels.

    Args:
        scatter: Residuals and components.
        channels: Variances of the channels to begin with, positive, as many as ``held``.
        held: Which components those are, shape (C,) bool; their variances may not vanish.
    """
    start = np.zeros(len(held))
    start[held] = channels
    return _maximum(scatter, start, held, LEAST * start)


def settled(scatter: Scatter, found: Components) -> Components:
    """The maximum with the same components to :data:`SETTLED`, from that to :data:`ROUGH`."""
    if found.left < SETTLED:
        return found
    return _maximum(scatter, found.variance, found.free, found.low, SETTLED)


def one_more(
    scatter: Scatter, found: Components, held: np.ndarray, price: np.ndarray | float = 0.0
) -> tuple[int, Components] | None:
    """The component that is asked for most, and the maximum with it; None if chance may ask for as much.

    Args:
        scatter: Residuals and components.
        found: The maximum without it.
        held: Channels, shape (C,) bool: what is asked for is one of the others.
        price: What each component must gain for numbers of its own that were taken from the residuals, shape (C,), [nat].
    """
    asked = asked_for(scatter, found, price)
    if not asked.clear:
        found = settled(scatter, found)
        asked = asked_for(scatter, found, price)
    cost = np.broadcast_to(price, held.shape)
    cheapest = int(np.argmax(np.where(cost > 0.0, 0.0, asked.normal)))
    # What costs something does not stand in the way of what costs nothing.
    for k in dict.fromkeys((asked.first, cheapest)):
        if asked.normal[k] > 0.0 and asked.plain[k] >= PLAINLY:
            more = with_one(scatter, found, k, float(asked.variance[k]))
            if needed(more, found, float(cost[k]), held):
                return k, more
    return None


def with_one(scatter: Scatter, found: Components, k: int, variance: float) -> Components:
    """The maximum with one more component, which begins at a variance."""
    start, free = found.variance.copy(), found.free.copy()
    start[k], free[k] = variance, True
    return _with_others(scatter, found, start, free)


def without(scatter: Scatter, found: Components, out: np.ndarray) -> Components:
    """The maximum without some of its components, shape (C,) bool."""
    return _with_others(scatter, found, np.where(out, 0.0, found.variance), found.free & ~out)


def roughly_without(scatter: Scatter, found: Components, out: np.ndarray) -> Components:
    """The same as :func:`without`, the columns' fit held: the likelihood there is a bound from below, and costs little."""
    V, free = covariances(scatter, found.at), found.free & ~out
    bound = _bound(scatter, found.at, found)
    wanted = bound.best(np.where(out, 0.0, found.variance), free, found.low)
    there = covariances(scatter, wanted)
    inverse = np.linalg.inv(there)
    left = np.einsum("nij,nj->ni", V, found.pull)
    pull = np.einsum("nij,nj->ni", inverse, left)
    kernel = inverse - inverse @ (V - V @ found.kernel @ V) @ inverse
    value = found.log_likelihood - (bound.height(found.at) - bound.height(wanted))
    nothing = np.zeros_like(found.covariance)
    return Components(free, wanted, nothing, value, pull, kernel, found.low, wanted, np.inf)


def highest(other: Scatter, scatter: Scatter, found: Components, of: np.ndarray) -> float:
    """The bound about a maximum at its highest, where blocks are others; but for a constant.

    Args:
        other: With the components in the model alone, one of them another.
        scatter: Of which the maximum is.
        found: The maximum.
        of: Numbers of the components in the model, ascending.
    """
    bound = replace(_bound(scatter, found.at, found), blocks=other.blocks)
    return bound.height(bound.best(found.variance[of], np.ones(len(of), dtype=bool), found.low[of]))


def needed(more: Components, fewer: Components, price: float, held: np.ndarray) -> bool:
    """True if chance does not give as much as further components do, whose shapes cost ``price`` [nat]."""
    gain = more.log_likelihood - fewer.log_likelihood - price
    return boundary_chance(2.0 * gain) * int((~held).sum()) < RARE


def promised(scatter: Scatter, found: Components, of: Sequence[np.ndarray], start: np.ndarray) -> np.ndarray:
    """What sets of further components gain at the least, shape (sets,), [nat], by the bound about a maximum.

    Args:
        scatter: Residuals and components.
        found: The maximum without them.
        of: Which, shape (C,) bool each.
        start: Variances that further components begin at, shape (C,).
    """
    bound = _bound(scatter, found.at, found)
    wanted = [bound.best(np.where(more, start, found.variance), found.free | more, found.low) for more in of]
    return np.array([bound.height(variances) for variances in wanted]) - bound.height(found.at)


def instead(scatter: Scatter, found: Components, several: np.ndarray, k: int) -> Components | None:
    """The maximum with one component in place of several; None if it explains the residuals less well than these.

    Args:
        scatter: Residuals and components.
        found: The maximum with the several.
        several: Which may go, shape (C,) bool.
        k: What may come.
    """
    start, free = np.where(several, 0.0, found.variance), found.free & ~several
    start[k], free[k] = found.variance[several & found.free].mean(), True
    fewer = _with_others(scatter, found, start, free)
    return fewer if fewer.log_likelihood >= found.log_likelihood else None


def _with_others(scatter: Scatter, found: Components, start: np.ndarray, free: np.ndarray) -> Components:
    """The maximum with other components; the bound about the one that is there says where to look first."""
    if (found.free != free).any():
        start = _bound(scatter, found.at, found).best(start, free, found.low)
    return _maximum(scatter, start, free, found.low)


def _maximum(
    scatter: Scatter, theta: np.ndarray, free: np.ndarray, low: np.ndarray, enough: float = ROUGH
) -> Components:
    """Maximise the restricted likelihood over the variances of the components in the model.

    The last step is not looked at: variances and likelihood are those that it leads to.

    Args:
        scatter: Residuals and components.
        theta: Variances to begin with, shape (C,); 0 for those that are not in the model.
        free: Components in the model, shape (C,) bool.
        low: Below which variances do not fall, shape (C,).
        enough: [nat] that the likelihood may be out by.
    """
    here, left, gain = place(scatter, theta), 0.0, 0.0
    score, information = derivatives(scatter, here, free)
    for _ in range(STEPS if np.isfinite(here.log_likelihood) else 0):
        moving, step = free & ~((theta <= low) & (score <= 0.0)), np.zeros(len(theta))
        step[moving] = shortest(information[np.ix_(moving, moving)], score[moving])  # of none, where data are exact
        promised = float(score @ step)
        ahead = np.where(free, np.maximum(theta + step, low), 0.0)
        whole = bool(np.all((ahead == theta + step)[moving]))
        left, gain = (OFF * promised, 0.5 * promised) if whole else (promised, 0.0)
        if left < enough:
            break
        higher = _higher(scatter, theta, here, step, promised, free, low)
        if higher is None:
            ahead, gain = theta, 0.0
            break
        theta, here = higher
        score, information = derivatives(scatter, here, free)
    else:
        ahead, gain = theta, 0.0
    inside = free & (theta > 0.0)
    covariance = np.zeros((len(theta),) * 2)
    covariance[np.ix_(inside, inside)] = shortest(information[np.ix_(inside, inside)], np.eye(int(inside.sum())))
    return Components(free, ahead, covariance, here.log_likelihood + gain, here.pull, here.kernel, low, theta, left)


def _higher(
    scatter: Scatter,
    theta: np.ndarray,
    here: Place,
    step: np.ndarray,
    promised: float,
    free: np.ndarray,
    low: np.ndarray,
) -> tuple[np.ndarray, Place] | None:
    """Variances, and the place there, that are likelier than those of a place; None if the step's direction has none."""
    if promised > FAR:
        wanted = _bound(scatter, theta, here).best(theta, free, low)
        there = place(scatter, wanted)
        if there.log_likelihood > here.log_likelihood:
            return wanted, there
    for _ in range(HALVINGS):
        wanted = np.where(free, np.maximum(theta + step, low), 0.0)
        there = place(scatter, wanted)
        if there.log_likelihood >= here.log_likelihood:
            return wanted, there
        step = 0.5 * step
    return None


def _bound(scatter: Scatter, at: np.ndarray, here: Components | Place) -> Bound:
    """The bound about a place, of variances ``at``, shape (C,)."""
    return Bound(scatter.blocks, scatter.stated, moments(covariances(scatter, at), here.pull, here.kernel))


def boundary_chance(twice: float) -> float:
    """Chance that noise raises twice the log-likelihood so much by one more variance, which may not be negative.

    Half the cases give nothing, the rest chi-square with one degree of freedom (Self and Liang 1987, case 5).
    """
    return float(ndtr(-np.sqrt(max(twice, 0.0))))


def contributions(scatter: Scatter, found: Components) -> np.ndarray:
    """What each row adds to the derivative by each component's variance, shape (C, N)."""
    # u' B u - tr(P B) = tr((u u' - P) B).
    weight = found.pull[:, :, None] * found.pull[:, None, :] - found.kernel
    n = len(weight)
    flat = scatter.blocks.reshape(len(scatter.blocks), n, -1).transpose(1, 0, 2)
    return 0.5 * (flat @ weight.reshape(n, -1, 1))[:, :, 0].T


@dataclass(frozen=True)
class Asked:
    """How much each component that is not in the model is asked for; 0 for those in the model, and those it can imitate.

    Attributes:
        normal: Standard deviations of chance if noise is normal, shape (C,). What costs something is charged, down to 0.
        plain: The same from the rows' own contributions (White 1982): a few wild rows, or long tails, do not raise it.
        variance: That a first step would give it, shape (C,).
    """

    normal: np.ndarray
    plain: np.ndarray
    variance: np.ndarray

    @property
    def first(self) -> int:
        """What is asked for most."""
        return int(np.argmax(self.normal))

    @property
    def clear(self) -> bool:
        """True if what is asked for most is so by the rows' own contributions, or is not, by :data:`CLEAR`."""
        return not CLEAR < self.plain[self.first] / PLAINLY < 1.0 / CLEAR


def asked_for(scatter: Scatter, found: Components, price: np.ndarray | float = 0.0) -> Asked:
    """The score test: the derivative at zero, less what the components in the model take up, over its standard deviation.

    Args:
        scatter: Residuals and components.
        found: The maximum with the components in the model.
        price: Of each component, shape (C,), [nat]: so much of what it would gain is not counted.
    """
    free = found.free
    half = found.kernel @ scatter.blocks
    flat = half.reshape(len(half), -1)
    information = 0.5 * flat @ half.transpose(0, 1, 3, 2).reshape(len(half), -1).T
    share = shortest(information[np.ix_(free, free)], information[free])
    alone = np.diag(information) - np.einsum("fc,fc->c", share, information[free])
    each = contributions(scatter, found)
    own = each - share.T @ each[free]
    score = own.sum(axis=1)
    new = ~free & (alone > IMITATED * np.diag(information))
    alone = np.where(new, alone, 1.0)
    plain = score / np.sqrt(np.maximum(np.sum(own**2, axis=1), TINY))
    normal = score / np.sqrt(alone)
    charged = np.sqrt(np.maximum(np.maximum(normal, 0.0) ** 2 - 2.0 * price, 0.0))
    normal = np.where(np.asarray(price) > 0.0, charged, normal)
    return Asked(*(np.where(new, value, 0.0) for value in (normal, plain, score / alone)))
