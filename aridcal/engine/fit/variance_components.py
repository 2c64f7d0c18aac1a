r"""Variance components by restricted maximum likelihood: how large each cause of the residuals' scatter is.

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
from aridcal.engine.fit.scatter import LikelihoodPoint, Scatter, covariances, derivatives, place
from aridcal.engine.levels import PLAINLY, RARE
from aridcal.engine.numerics import MOST_ITERATIONS, STEP_HALVINGS, TINY

FAR_PROMISE = 1.0
"""Work: [nat]: a step of the average information that promises more is not near enough for it to be trusted; a bound is
maximised instead, which never overshoots."""

LAST_GAIN = 1e-3
"""Work: [nat] that the maximum may be out by after the last of all steps: a twentieth of a standard deviation."""

ROUGH_GAIN = 0.1
"""Work: [nat]: the same as long as components are added. A likelihood ratio is then out by less than a tenth, and the chance of
noise by a tenth of itself; what has settled better takes twice the time."""

PROMISE_ERROR_SHARE = 0.1
"""Work: Share of what a step promises, below :data:`FAR_PROMISE`, by which its gain is off half of that: less in 99 of 100
steps from places about the maximum in 60 rows of 4 numbers."""

SAFE_SHARE = 0.95
"""Work: What is less than this share of something is less where variances have settled, too: scores move by a fiftieth until
then."""

LEAST_VARIANCE_SHARE = 1e-6
"""Work: Share of its start below which the variance of a channel does not fall: a covariance must be positive, and an
instrument a thousand times better than the scatter is no instrument."""

IMITATION_SHARE = 0.01
"""Share of a component's information that must be its own: with less, those in the model imitate it."""


@dataclass(frozen=True)
class Components:
    """Variances at the maximum of the restricted likelihood.

    Attributes:
        free: Components in the model, shape (C,) bool.
        variance: Of each component, shape (C,), not negative; 0 for components that are not in the model.
        covariance: Of these estimates, shape (C, C); 0 for components that are not in the model, or vanished.
        log_likelihood: Restricted, but for a constant.
        pull: P y of each row, shape (N, m).
        kernel: P_ii of each row, shape (N, m, m).
        low: Below which variances do not fall, shape (C,): a share of the channels' first estimates.
        at: Variances at which pull, kernel and covariance were computed, shape (C,): one short step from the maximum.
        error: Bound on the error of the log-likelihood, [nat].
    """

    free: np.ndarray
    variance: np.ndarray
    covariance: np.ndarray
    log_likelihood: float
    pull: np.ndarray
    kernel: np.ndarray
    low: np.ndarray
    at: np.ndarray
    error: float

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


def estimate(scatter: Scatter, channels: np.ndarray, is_channel: np.ndarray) -> Components:
    """Maximise the restricted likelihood with the channels alone, which every residual has.

    Args:
        scatter: Residuals and components.
        channels: Variances of the channels to begin with, positive, one for each in ``is_channel``.
        is_channel: Which components are channels, shape (C,) bool; their variances may not vanish.
    """
    start = np.zeros(len(is_channel))
    start[is_channel] = channels
    return _maximum(scatter, start, is_channel, LEAST_VARIANCE_SHARE * start)


def settled(scatter: Scatter, maximum: Components) -> Components:
    """A maximum known to :data:`ROUGH_GAIN`, refined to :data:`LAST_GAIN` with the same components."""
    if maximum.error < LAST_GAIN:
        return maximum
    return _maximum(scatter, maximum.variance, maximum.free, maximum.low, LAST_GAIN)


def add_component(
    scatter: Scatter, maximum: Components, is_channel: np.ndarray, price: np.ndarray | float = 0.0
) -> tuple[int, Components] | None:
    """The component with the largest score, and the maximum with it; None if chance explains that score.

    Args:
        scatter: Residuals and components.
        maximum: The maximum without it.
        is_channel: Which components are channels, shape (C,) bool: all others are candidates.
        price: Gain that pays for the numbers of a component that were fitted to the residuals, shape (C,), [nat].
    """
    demand = score_tests(scatter, maximum, price)
    if not demand.clear:
        maximum = settled(scatter, maximum)
        demand = score_tests(scatter, maximum, price)
    cost = np.broadcast_to(price, is_channel.shape)
    cheapest = int(np.argmax(np.where(cost > 0.0, 0.0, demand.normal)))
    # A component that has a price does not stand in the way of one that has none.
    for k in dict.fromkeys((demand.first, cheapest)):
        if demand.normal[k] > 0.0 and demand.plain[k] >= PLAINLY:
            more = with_one(scatter, maximum, k, float(demand.variance[k]))
            if gain_is_real(more, maximum, float(cost[k]), is_channel):
                return k, more
    return None


def with_one(scatter: Scatter, maximum: Components, k: int, variance: float) -> Components:
    """The maximum with one more component k, which begins at a variance."""
    start, free = maximum.variance.copy(), maximum.free.copy()
    start[k], free[k] = variance, True
    return _with_others(scatter, maximum, start, free)


def drop_components(scatter: Scatter, maximum: Components, out: np.ndarray) -> Components:
    """The maximum without some of its components, shape (C,) bool."""
    return _with_others(scatter, maximum, np.where(out, 0.0, maximum.variance), maximum.free & ~out)


def roughly_without(scatter: Scatter, maximum: Components, out: np.ndarray) -> Components:
    """A cheap :func:`drop_components`, the columns' fit held: its likelihood is a bound from below."""
    V, free = covariances(scatter, maximum.at), maximum.free & ~out
    bound = _bound(scatter, maximum.at, maximum)
    variances = bound.best(np.where(out, 0.0, maximum.variance), free, maximum.low)
    there = covariances(scatter, variances)
    inverse = np.linalg.inv(there)
    residual = np.einsum("nij,nj->ni", V, maximum.pull)
    pull = np.einsum("nij,nj->ni", inverse, residual)
    kernel = inverse - inverse @ (V - V @ maximum.kernel @ V) @ inverse
    value = maximum.log_likelihood - (bound.height(maximum.at) - bound.height(variances))
    nothing = np.zeros_like(maximum.covariance)
    return Components(free, variances, nothing, value, pull, kernel, maximum.low, variances, np.inf)


def highest(other: Scatter, scatter: Scatter, maximum: Components, of: np.ndarray) -> float:
    """The highest value of the bound about a maximum when a component has other blocks; up to a constant.

    Args:
        other: Residuals and the components in the model alone, one of them with other blocks.
        scatter: Residuals and components of the maximum.
        maximum: The maximum.
        of: Numbers of the components in the model, ascending.
    """
    bound = replace(_bound(scatter, maximum.at, maximum), blocks=other.blocks)
    return bound.height(bound.best(maximum.variance[of], np.ones(len(of), dtype=bool), maximum.low[of]))


def gain_is_real(more: Components, fewer: Components, price: float, is_channel: np.ndarray) -> bool:
    """True if chance does not explain the gain of ``more`` components, whose shapes cost ``price`` [nat]."""
    gain = more.log_likelihood - fewer.log_likelihood - price
    return boundary_chance(2.0 * gain) * int((~is_channel).sum()) < RARE


def promised(scatter: Scatter, maximum: Components, of: Sequence[np.ndarray], start: np.ndarray) -> np.ndarray:
    """Least gain of sets of further components, shape (sets,), [nat], by the bound about a maximum.

    Args:
        scatter: Residuals and components.
        maximum: The maximum without them.
        of: The sets, shape (C,) bool each.
        start: Variances that further components begin at, shape (C,).
    """
    bound = _bound(scatter, maximum.at, maximum)
    optima = [bound.best(np.where(more, start, maximum.variance), maximum.free | more, maximum.low) for more in of]
    return np.array([bound.height(variances) for variances in optima]) - bound.height(maximum.at)


def replace_components(scatter: Scatter, maximum: Components, several: np.ndarray, k: int) -> Components | None:
    """The maximum with one component in place of several; None if it explains the residuals less well than these.

    Args:
        scatter: Residuals and components.
        maximum: The maximum with the several.
        several: Components that may go, shape (C,) bool.
        k: Component that may come.
    """
    start, free = np.where(several, 0.0, maximum.variance), maximum.free & ~several
    start[k], free[k] = maximum.variance[several & maximum.free].mean(), True
    fewer = _with_others(scatter, maximum, start, free)
    return fewer if fewer.log_likelihood >= maximum.log_likelihood else None


def _with_others(scatter: Scatter, maximum: Components, start: np.ndarray, free: np.ndarray) -> Components:
    """The maximum with other components in the model, begun where the bound about the present maximum is highest."""
    if (maximum.free != free).any():
        start = _bound(scatter, maximum.at, maximum).best(start, free, maximum.low)
    return _maximum(scatter, start, free, maximum.low)


def _maximum(
    scatter: Scatter, theta: np.ndarray, free: np.ndarray, low: np.ndarray, enough: float = ROUGH_GAIN
) -> Components:
    """Maximise the restricted likelihood over the variances of the components in the model.

    The last step is not looked at: variances and likelihood are those that it leads to.

    Args:
        scatter: Residuals and components.
        theta: Variances to begin with, shape (C,); 0 for components that are not in the model.
        free: Components in the model, shape (C,) bool.
        low: Below which variances do not fall, shape (C,).
        enough: [nat] that the likelihood may be out by.
    """
    here, error, gain = place(scatter, theta), 0.0, 0.0
    score, information = derivatives(scatter, here, free)
    for _ in range(MOST_ITERATIONS if np.isfinite(here.log_likelihood) else 0):
        moving, step = free & ~((theta <= low) & (score <= 0.0)), np.zeros(len(theta))
        step[moving] = shortest(
            information[np.ix_(moving, moving)], score[moving]
        )  # no component moves where data are exact
        promised = float(score @ step)
        ahead = np.where(free, np.maximum(theta + step, low), 0.0)
        whole = bool(np.all((ahead == theta + step)[moving]))
        error, gain = (PROMISE_ERROR_SHARE * promised, 0.5 * promised) if whole else (promised, 0.0)
        if error < enough:
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
    return Components(free, ahead, covariance, here.log_likelihood + gain, here.pull, here.kernel, low, theta, error)


def _higher(
    scatter: Scatter,
    theta: np.ndarray,
    here: LikelihoodPoint,
    step: np.ndarray,
    promised: float,
    free: np.ndarray,
    low: np.ndarray,
) -> tuple[np.ndarray, LikelihoodPoint] | None:
    """Likelier variances, and the likelihood there; None if the step's direction has none."""
    if promised > FAR_PROMISE:
        variances = _bound(scatter, theta, here).best(theta, free, low)
        there = place(scatter, variances)
        if there.log_likelihood > here.log_likelihood:
            return variances, there
    for _ in range(STEP_HALVINGS):
        variances = np.where(free, np.maximum(theta + step, low), 0.0)
        there = place(scatter, variances)
        if there.log_likelihood >= here.log_likelihood:
            return variances, there
        step = 0.5 * step
    return None


def _bound(scatter: Scatter, at: np.ndarray, here: Components | LikelihoodPoint) -> Bound:
    """The bound about a likelihood at variances ``at``, shape (C,)."""
    return Bound(scatter.blocks, scatter.fixed, moments(covariances(scatter, at), here.pull, here.kernel))


def boundary_chance(twice: float) -> float:
    """Chance that noise raises twice the log-likelihood so much by one more variance, which may not be negative.

    Half the cases give nothing, the rest chi-square with one degree of freedom (Self and Liang 1987, case 5).
    """
    return float(ndtr(-np.sqrt(max(twice, 0.0))))


def contributions(scatter: Scatter, maximum: Components) -> np.ndarray:
    """Contribution of each row to the derivative by each component's variance, shape (C, N)."""
    # u' B u - tr(P B) = tr((u u' - P) B).
    weight = maximum.pull[:, :, None] * maximum.pull[:, None, :] - maximum.kernel
    n = len(weight)
    flat = scatter.blocks.reshape(len(scatter.blocks), n, -1).transpose(1, 0, 2)
    return 0.5 * (flat @ weight.reshape(n, -1, 1))[:, :, 0].T


@dataclass(frozen=True)
class ScoreTests:
    """Score tests of the components that are not in the model; 0 for those in it, and those that it can imitate.

    Attributes:
        normal: Score in standard deviations of normal noise, shape (C,), less the component's price, not below 0.
        plain: Score in standard deviations of the rows' own contributions, shape (C,) (White 1982): a few wild rows, or long
            tails, do not raise it.
        variance: Variance after a first step, shape (C,).
    """

    normal: np.ndarray
    plain: np.ndarray
    variance: np.ndarray

    @property
    def first(self) -> int:
        """Component with the largest score."""
        return int(np.argmax(self.normal))

    @property
    def clear(self) -> bool:
        """True if the plain score of that component is clearly above or below :data:`PLAINLY`, by :data:`SAFE_SHARE`."""
        return not SAFE_SHARE < self.plain[self.first] / PLAINLY < 1.0 / SAFE_SHARE


def score_tests(scatter: Scatter, maximum: Components, price: np.ndarray | float = 0.0) -> ScoreTests:
    """The score test: the derivative at zero, less what the components in the model take up, over its standard deviation.

    Args:
        scatter: Residuals and components.
        maximum: The maximum with the components in the model.
        price: Of each component, shape (C,), [nat]: so much of what it would gain is not counted.
    """
    free = maximum.free
    half = maximum.kernel @ scatter.blocks
    flat = half.reshape(len(half), -1)
    information = 0.5 * flat @ half.transpose(0, 1, 3, 2).reshape(len(half), -1).T
    share = shortest(information[np.ix_(free, free)], information[free])
    alone = np.diag(information) - np.einsum("fc,fc->c", share, information[free])
    each = contributions(scatter, maximum)
    own_contributions = each - share.T @ each[free]
    score = own_contributions.sum(axis=1)
    new = ~free & (alone > IMITATION_SHARE * np.diag(information))
    alone = np.where(new, alone, 1.0)
    plain = score / np.sqrt(np.maximum(np.sum(own_contributions**2, axis=1), TINY))
    normal = score / np.sqrt(alone)
    charged = np.sqrt(np.maximum(np.maximum(normal, 0.0) ** 2 - 2.0 * price, 0.0))
    normal = np.where(np.asarray(price) > 0.0, charged, normal)
    return ScoreTests(*(np.where(new, value, 0.0) for value in (normal, plain, score / alone)))
