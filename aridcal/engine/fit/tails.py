r"""Noise with tails: Student's t of each channel, all numbers of a row in it far off together.

A channel of m numbers, with squares :math:`d^2` of a row in units of sigma, has the density

.. math:: \log t = \log\Gamma\Big(\frac{\nu + m}{2}\Big) - \log\Gamma\Big(\frac{\nu}{2}\Big) - \frac m2 \log(\nu\pi\sigma^2)
          - \frac{\nu + m}{2} \log\Big(1 + \frac{d^2}{\nu}\Big)

which is that of normal noise whose variance differs from row to row: given :math:`d^2` the inverse of that is expected to be
:math:`w = (\nu + m) / (\nu + d^2)` times that of sigma (Lange, Little and Taylor 1989, doi:10.2307/2290063).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from aridcal.engine.levels import STRONG
from aridcal.engine.numerics import MOST_ITERATIONS

FREEDOMS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 20.0, 30.0)
"""Work: Degrees of freedom that are tried: from Cauchy's to such as hundreds of rows cannot tell from normal noise."""


FEWEST_OF_TAILS = 20
"""Rows below which nothing is said of tails: of one row in twenty chance makes them."""


@dataclass(frozen=True)
class Tails:
    """Student's t.

    Attributes:
        freedom: Its degrees of freedom; below 2 it has no variance.
        sigma: Its scale per axis, in the channel's unit.
    """

    freedom: float
    sigma: float


def weights(squares: np.ndarray, size: np.ndarray | float, freedom: np.ndarray | float) -> np.ndarray:
    """Expected inverse variance of rows over that of sigma; 1 for normal noise, whose freedom is infinite.

    Args:
        squares: Of each row, in units of sigma.
        size: Numbers m of each row.
        freedom: Of each row's noise.
    """
    finite = np.isfinite(freedom)
    nu = np.where(finite, freedom, 1.0)
    return np.asarray(np.where(finite, (nu + size) / (nu + squares), 1.0))


def log_density(squares: np.ndarray, size: np.ndarray | float, freedom: np.ndarray | float) -> np.ndarray:
    """Logarithm of the density of rows, in units of sigma; arguments as for :func:`weights`."""
    finite = np.isfinite(freedom)
    nu = np.where(finite, freedom, 1.0)
    constant = gammaln(0.5 * (nu + size)) - gammaln(0.5 * nu) - 0.5 * size * np.log(nu * np.pi)
    normal = -0.5 * size * np.log(2.0 * np.pi) - 0.5 * squares
    return np.asarray(np.where(finite, constant - 0.5 * (nu + size) * np.log1p(squares / nu), normal))


def tails_of(squares: np.ndarray, size: int) -> Tails | None:
    """Student's t fitted to residuals; None where normal noise fits as well, or residuals are exact.

    Args:
        squares: Of each row, shape (n,).
        size: Numbers of a row.
    """
    middle = float(np.median(squares)) if len(squares) >= FEWEST_OF_TAILS else 0.0
    if middle <= 0.0:
        return None
    mean = float(np.mean(squares)) / size
    normal = float(np.sum(log_density(squares / mean, size, np.inf))) - 0.5 * size * len(squares) * np.log(mean)
    best, tails = normal + STRONG, None
    for freedom in FREEDOMS:
        variance = middle / size
        for _ in range(MOST_ITERATIONS):
            variance = float(np.mean(weights(squares / variance, size, freedom) * squares)) / size
        value = float(np.sum(log_density(squares / variance, size, freedom)))
        value -= 0.5 * size * len(squares) * np.log(variance)
        if value > best:
            best, tails = value, Tails(freedom, float(np.sqrt(variance)))
    return tails
