"""Smooth functions as samples: what is believed of them beforehand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

SPREAD = 1e-11  # smallest variance of a smooth function's modes, as a share of the largest


@dataclass(frozen=True)
class Kernel:
    """What is believed of a smooth function beforehand: over how many knots it is alike, and if it has kinks.

    Attributes:
        length: Correlation length in knots.
        kinks: True: Matern 7/2, three derivatives; False: a squared exponential, all derivatives.
    """

    length: float
    kinks: bool = True


@cache
def kernel_root(shape: tuple[int, ...], kernel: Kernel) -> np.ndarray:
    r"""Square root of the prior covariance of a smooth function's samples, a product over its covariates.

    .. math:: k(d) = (1 + a + \tfrac25 a^2 + \tfrac1{15} a^3) e^{-a}, \quad a = \sqrt7\, d / \ell

    (Matern 7/2) where there may be kinks, else exp(-d^2 / 2 l^2), at d knots apart (C. E. Rasmussen, C. K. I. Williams,
    Gaussian Processes for Machine Learning, MIT Press 2006, section 4.2).

    Args:
        shape: Knots along each covariate.
        kernel: What is believed.

    Returns:
        B with covariance B B', shape (knots, knots) of all knots. No mode has less than a share :data:`SPREAD` of the
        largest variance, so that B has an inverse.
    """
    root: np.ndarray = np.ones((1, 1))
    for knots in shape:
        place = np.arange(knots)
        distance = np.abs(np.subtract.outer(place, place)) / kernel.length
        covariance = _matern(distance) if kernel.kinks else np.exp(-0.5 * distance**2)
        variances, modes = np.linalg.eigh(covariance)
        least = SPREAD ** (1 / len(shape)) * variances[-1]
        own = modes * np.sqrt(np.maximum(variances, least))
        root = np.kron(root, own)
    return root


@cache
def kernel_modes(shape: tuple[int, ...], kernel: Kernel) -> tuple[np.ndarray, np.ndarray]:
    """Independent shapes of a smooth function's samples beforehand, in columns (knots, knots), and the deviation of each."""
    modes, sizes, _ = np.linalg.svd(kernel_root(shape, kernel), full_matrices=False)
    return modes, sizes


def _matern(distance: np.ndarray) -> np.ndarray:
    """Matern 7/2 of a distance in correlation lengths."""
    a = np.sqrt(7.0) * distance
    return np.asarray((1.0 + a + 0.4 * a**2 + a**3 / 15.0) * np.exp(-a))


def smooth_precision(shape: tuple[int, ...], tau: float, kernel: Kernel) -> np.ndarray:
    """Inverse of the prior covariance of a smooth function's coefficients, (B B')^-1 / tau^2.

    Args:
        shape: Knots along each covariate.
        tau: Prior deviation of a coefficient, [m] or [rad].
        kernel: What is believed beside that.
    """
    root = np.linalg.inv(kernel_root(shape, kernel))
    return np.asarray(root.T @ root) / tau**2
