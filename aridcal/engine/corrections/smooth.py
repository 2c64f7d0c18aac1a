"""Smooth functions as samples: their prior."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from aridcal.engine.corrections.basis import wendland

LEAST_MODE_SHARE = 1e-11
"""Work: smallest variance of a smooth function's modes, as a share of the largest: it stays invertible in double precision."""


@dataclass(frozen=True)
class Kernel:
    """Prior of a smooth function: over how many knots it is alike, and if it has kinks.

    Attributes:
        length: Correlation length in knots.
        kinks: True: Matern 7/2, three derivatives; False: a squared exponential, all derivatives.
    """

    length: float
    kinks: bool = True


@dataclass(frozen=True)
class Nodes:
    """A smooth function in space as a sum of functions about nodes, whose radius says how far it is alike.

    Attributes:
        places: Of the nodes, (x, y, z) each, in radii.
    """

    places: tuple[tuple[float, float, float], ...]


SmoothPart = tuple[int, ...] | Nodes
"""Samples of one function: knots along each of its covariates, or nodes in space."""

Shape = tuple[SmoothPart, ...]
"""Samples of several functions, one after the other: independent beforehand, but alike in size and length."""


def samples_root(shape: Shape, kernel: Kernel) -> np.ndarray:
    """Square root B of the prior covariance B B' of samples, shape (samples, samples).

    Args:
        shape: What they are samples of.
        kernel: Prior of functions on knots; nodes hold theirs in their radius.
    """
    roots = [_nodes_root(part) if isinstance(part, Nodes) else kernel_root(part, kernel) for part in shape]
    from scipy.linalg import block_diag  # slow to load, and a campaign is read without it

    return roots[0] if len(roots) == 1 else np.asarray(block_diag(*roots))


def kernels_that_matter(shape: Shape, kernels: tuple[Kernel, ...]) -> tuple[Kernel, ...]:
    """The kernels that make a difference to samples: one where all samples are at nodes, or alone, as those of a label."""
    return kernels[:1] if all(isinstance(part, Nodes) or part == (1,) for part in shape) else kernels


@cache
def kernel_root(shape: tuple[int, ...], kernel: Kernel) -> np.ndarray:
    r"""Square root of the prior covariance of a smooth function's samples, a product over its covariates.

    .. math:: k(d) = (1 + a + \tfrac25 a^2 + \tfrac1{15} a^3) e^{-a}, \quad a = \sqrt7\, d / \ell

    (Matern 7/2) where there may be kinks, else exp(-d^2 / 2 l^2), at d knots apart (C. E. Rasmussen, C. K. I. Williams,
    Gaussian Processes for Machine Learning, MIT Press 2006, section 4.2).

    Args:
        shape: Knots along each covariate.
        kernel: Prior along each covariate.

    Returns:
        B with covariance B B', shape (knots, knots) of all knots. No mode has less than a share :data:`LEAST_MODE_SHARE` of the
        largest variance, so that B has an inverse.
    """
    root: np.ndarray = np.ones((1, 1))
    for knots in shape:
        place = np.arange(knots)
        distance = np.abs(np.subtract.outer(place, place)) / kernel.length
        covariance = _matern(distance) if kernel.kinks else np.exp(-0.5 * distance**2)
        variances, modes = np.linalg.eigh(covariance)
        least = LEAST_MODE_SHARE ** (1 / len(shape)) * variances[-1]
        along = modes * np.sqrt(np.maximum(variances, least))
        root = np.kron(root, along)
    return root


def _matern(distance: np.ndarray) -> np.ndarray:
    """Matern 7/2 of a distance in correlation lengths."""
    a = np.sqrt(7.0) * distance
    return np.asarray((1.0 + a + 0.4 * a**2 + a**3 / 15.0) * np.exp(-a))


@cache
def _nodes_root(nodes: Nodes) -> np.ndarray:
    r"""Square root of the prior covariance of the weights w of functions about nodes.

    With the kernel k between two places, :math:`f(p) = \sum_j k(p, u_j) w_j` is the Gaussian process of that kernel, given its
    values at the nodes, if :math:`w \sim N(0, K^{-1})`, K the kernel between the nodes (J. Quinonero-Candela, C. E. Rasmussen,
    JMLR 6, 2005, section 3: subset of regressors).
    """
    from scipy.spatial.distance import cdist  # slow to load, and a campaign is read without it

    places = np.array(nodes.places)
    variances, modes = np.linalg.eigh(wendland(cdist(places, places)))
    return np.asarray(modes / np.sqrt(np.maximum(variances, LEAST_MODE_SHARE * variances[-1])))


def smooth_precision(shape: Shape, tau: float, kernel: Kernel) -> np.ndarray:
    """Inverse of the prior covariance of smooth functions' coefficients, (B B')^-1 / tau^2.

    Args:
        shape: What they are samples of.
        tau: Prior deviation of a coefficient, of a function at nodes that of the function, [m] or [rad].
        kernel: Prior beside that deviation.
    """
    root = np.linalg.inv(samples_root(shape, kernel))
    return np.asarray(root.T @ root) / tau**2
