"""Where a fiducial is, to a few thousandths of a pixel: its outline fitted to the grey levels around it.

The pose that is already known to a fraction of a pixel gives the shape of each fiducial in the image
(:func:`aridcal.jobs.head1992.outlines.predict_shapes`). The shape is then shifted, grown, blurred and lit until it explains
the grey levels, all fiducials of an image at once. What is reported is the image of the fiducial's centre, not the centroid
of its image, so that the perspective bias of centroids does not arise.

The model of a pixel's grey level at an offset d from the fiducial's centre, with e(d) the share of its light that comes from
the fiducial and b(d) the shares from beyond the paper::

    grey = paper + slope.d + e(d) (contrast + contrast slope.d) + leak.b(d)
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from aridcal.jobs.head1992.outlines import Pixels, Shapes, fiducial_share, near_outlines, share_beyond_paper

# Places in theta, see ``Fits``: what shifts, grows and blurs the outline, the paper's light, the contrast and what lies around.
N_PARAMETERS = 12
SHIFT, GROWTH, VARIANCE = slice(0, 2), 2, 3
PAPER, PAPER_SLOPE, CONTRAST, CONTRAST_SLOPE = 4, slice(5, 7), 7, slice(8, 10)
LEAK = slice(10, 12)
OUTLINE, LIGHT, DOUBTFUL = slice(0, 4), slice(4, 7), slice(8, 12)  # the last ones have a prior

# Robust weights. Tukey's biweight has 95 % efficiency at 4.7 sigma and about 98 % at 6. With weights w at Gaussian noise the
# variance is sigma² TUKEY_VARIANCE inv(J' w J), E[w] E[psi²] / E[psi']² (Huber, "Robust Statistics", 1981).
EDGE_TUKEY = 6.0
TUKEY_VARIANCE = 0.965
SIGMA_PER_MAD = 1.4826  # sigma of Gaussian noise over the median of its absolute values
GROSS_CUT = (
    0.6,
    5.0,
)  # share of the contrast, and [grey levels], that a residual may have while edges may be a pixel off
LEAST_CUT = 0.1, 0.01  # share of the contrast that is never cut off, before a fit has settled and after
NOISIER_RATIO = 1.3  # times the usual noise: only then a fiducial's own is believed, which it knows to some 10 %

# Steps and their end.
RIM_WIDTH = 1.5  # [px] to either side of an outline: its edge
MAX_EDGE_STEPS = 8
STILL, MOST = 0.4, 0.75  # a fit is done when its last step was below so many sigma for most of the fiducials
START_BLUR = 0.7  # [px] of a lens in focus
LARGEST_EDGE_STEP = 1.0  # [px] of shift and growth: the edge's slope is known no further
LARGEST_GROWTH, LARGEST_BLUR = 0.3, 0.6  # of the fiducial's half size: what goes beyond is no fiducial
EDGE_RIDGE = 1e-6  # of the diagonal: keeps the equations solvable where a fiducial shows nothing of a parameter

# What is expected. Light falls on paper and fiducial alike, so that contrast changes as the paper does; glare spares it. By how
# much the change may differ from that: a share of it, and some grey levels across half a fiducial.
UNEVEN, UNEVEN_STD = 1.0, 0.05
LEAK_STD = 60.0  # [grey levels] by which the surroundings may differ from the paper
CLEAN_EDGE, DOUBT = 0.9, 30.0  # dirt that has cost an edge weight shows in the centre too (measured on rendered dirt)
MODEL_STD = (
    0.0004  # [px] that the edge model itself is wrong by (measured at 512 and 1,024 px, on images of little noise)
)


@dataclass(frozen=True)
class Fits:
    """Outlines fitted to an image.

    Attributes:
        centres: Images of the fiducials' centres, shape (F, 2), [px].
        covariances: Of the centres, shape (F, 2, 2), [px²].
        shape_std: Standard deviation of growth [px] and blur variance [px²], shape (F, 2).
        noise: Robust standard deviation of what remains, shape (F,), [grey levels].
        edge_weight: Mean robust weight of the pixels at the outline, 0 to 1, shape (F,).
        theta: All parameters, shape (F, 12): shift u, v from the predicted centre [px]; growth, by which each edge lies
            further out [px]; variance of the blur without the pixel's own [px²]; grey level of the paper and its change to
            the right and down; fiducial minus paper, likewise; what lies beside and what lies above or below the
            paper minus paper, blurred over its edges.
    """

    centres: np.ndarray
    covariances: np.ndarray
    shape_std: np.ndarray
    noise: np.ndarray
    edge_weight: np.ndarray
    theta: np.ndarray

    def __getitem__(self, which: np.ndarray) -> Fits:
        """Select fits."""
        return Fits(*(getattr(self, f.name)[which] for f in fields(self)))

    @property
    def shift(self) -> np.ndarray:
        """Of the centres from where they were predicted, shape (F, 2), [px]."""
        return self.theta[:, SHIFT]

    @property
    def growth(self) -> np.ndarray:
        """By how much each edge lies further out than it should, shape (F,), [px]."""
        return self.theta[:, GROWTH]

    @property
    def blur(self) -> np.ndarray:
        """Standard deviation of the edges' blur without the pixel's own, shape (F,), [px]."""
        return np.sqrt(np.maximum(self.theta[:, VARIANCE], 0))

    @property
    def contrast(self) -> np.ndarray:
        """Fiducial minus paper, shape (F,), [grey levels]."""
        return self.theta[:, CONTRAST]


def fit_outlines(image: np.ndarray, shapes: Shapes, start: Fits | None = None, gross_steps: int = 0) -> Fits:
    """Fit shift, growth, blur and light of each fiducial by robust least squares.

    Gauss-Newton with Tukey's weights and a weak prior on what the fiducial alone may not determine: each step solves
    (J'wJ + prior) change = J'w r - prior (theta - expected), fiducial by fiducial.

    Args:
        image: Grey levels, shape (height, width).
        shapes: How the fiducials are imaged, as far as known; all of them inside the image.
        start: An earlier fit of the same fiducials.
        gross_steps: Steps to take first that leave out gross errors only.

    Returns:
        The fits. A fiducial that is not there shows by its contrast, noise or edge weight.
    """
    blur = START_BLUR if start is None else float(np.median(start.blur))
    pixels = near_outlines(image, shapes, blur)
    reach = np.max(shapes.half_extent, axis=1)
    across = pixels.d.T / pixels.spread(reach)
    theta = _start(pixels) if start is None else start.theta.copy()
    if start is not None:
        theta[:, SHIFT] = start.centres - shapes.centres
    for step in range(gross_steps + MAX_EDGE_STEPS):
        gross = step < gross_steps
        r, J, clipped = _residuals(pixels, shapes, theta, across)
        noise = _noise(pixels, r, clipped)
        cut = _cut(noise, np.abs(theta[:, CONTRAST]), gross, start is not None)
        weights = np.maximum(1 - (r / pixels.spread(cut)) ** 2, 0) ** 2
        A, b = _normal_equations(pixels, r, J, np.where(clipped, 0, weights))
        _add_prior(A, b, theta, noise)
        change, inverse = _solve(A, b)
        theta, change = _stepped(theta, change, reach)
        if not gross and _is_still(change, inverse, noise):
            break
    return _fits(pixels, shapes, theta, noise, inverse, weights)


def _fits(
    pixels: Pixels, shapes: Shapes, theta: np.ndarray, noise: np.ndarray, inverse: np.ndarray, weights: np.ndarray
) -> Fits:
    """Turn the inverse of the last step's equations, (F, 12, 12), into covariances: noise² TUKEY_VARIANCE inverse."""
    usual = float(np.median(noise))
    sigma = np.where(noise < NOISIER_RATIO * usual, usual, noise)
    covariance = inverse * (TUKEY_VARIANCE * sigma[:, None, None] ** 2)
    rim = np.abs(pixels.depth) < RIM_WIDTH
    edge_weight = pixels.total(np.where(rim, weights, 0)) / pixels.total(rim)
    dirt = 1 + DOUBT * np.maximum(0, CLEAN_EDGE - edge_weight)
    of_shape = np.einsum("fii->fi", covariance)[:, GROWTH : VARIANCE + 1]
    return Fits(
        centres=shapes.centres + theta[:, SHIFT],
        covariances=covariance[:, SHIFT, SHIFT] * dirt[:, None, None] + MODEL_STD**2 * np.eye(2),
        shape_std=np.sqrt(np.maximum(of_shape, 0)),
        noise=noise,
        edge_weight=edge_weight,
        theta=theta,
    )


def _start(pixels: Pixels) -> np.ndarray:
    """Start theta, shape (F, 12), from the mean grey levels a pixel inside and a pixel outside the predicted outlines."""
    theta = np.zeros((len(pixels.counts), N_PARAMETERS))
    inside, outside = (
        pixels.total(np.where(there, pixels.grey, 0)) / pixels.total(there)
        for there in (pixels.depth > 1, pixels.depth < -1)
    )
    theta[:, VARIANCE] = START_BLUR**2
    theta[:, PAPER] = outside
    theta[:, CONTRAST] = inside - outside
    return theta


def _residuals(
    pixels: Pixels, shapes: Shapes, theta: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare the grey levels with the model.

    Args:
        pixels: P of them.
        shapes: Of F fiducials.
        theta: Of the fiducials, shape (F, 12).
        across: Places in half sizes of the fiducial, to the right and down, shape (2, P).

    Returns:
        Grey level minus model (P,), the model's derivatives (12, P), and which pixels are as bright or dark as can be (P,).
    """
    own = pixels.spread(theta)
    cover, by_outline = fiducial_share(pixels, shapes, own[OUTLINE])
    J = np.empty((N_PARAMETERS, len(pixels.grey)), np.float32)
    J[PAPER] = 1
    J[PAPER_SLOPE] = across
    J[CONTRAST] = cover
    J[CONTRAST_SLOPE] = across * cover
    J[LEAK] = share_beyond_paper(pixels, shapes, own[OUTLINE])
    right, down = across
    by_right, by_down = own[CONTRAST_SLOPE]
    contrast = own[CONTRAST] + right * by_right + down * by_down
    J[OUTLINE] = contrast * by_outline
    paper = np.einsum("kp,kp->p", J[LIGHT], own[LIGHT])
    leak = np.einsum("kp,kp->p", J[LEAK], own[LEAK])
    r = pixels.grey - paper - leak
    r -= contrast * cover
    too_bright = (pixels.grey >= 255) & (r < 0)
    too_dark = (pixels.grey <= 0) & (r > 0)
    clipped = too_bright | too_dark
    r[clipped] = 0
    return r, J, clipped


def _noise(pixels: Pixels, r: np.ndarray, clipped: np.ndarray) -> np.ndarray:
    """Estimate the noise of each fiducial's pixels by the median of their absolute residuals, shape (F,), [grey levels]."""
    size = np.where(clipped, np.inf, np.abs(r))
    middle = np.maximum(pixels.counts - pixels.total(clipped), 1) // 2
    medians = [np.partition(size[part], m)[m] for part, m in zip(pixels.parts, middle, strict=True)]
    return SIGMA_PER_MAD * np.array(medians)


def _cut(noise: np.ndarray, level: np.ndarray, gross: bool, started: bool) -> np.ndarray:
    """Choose the residuals from which pixels have no weight, shape (F,), from noise and size of the contrast (F,)."""
    if gross:
        return GROSS_CUT[0] * level + GROSS_CUT[1]
    least = LEAST_CUT[1] if started else LEAST_CUT[0]
    return np.maximum(EDGE_TUKEY * noise, least * level + 1)


def _normal_equations(
    pixels: Pixels, r: np.ndarray, J: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return J'wJ, shape (F, 12, 12), and J'w r, shape (F, 12), of each fiducial."""
    Jw = J * weights
    A = [Jw[:, part] @ J[:, part].T for part in pixels.parts]
    b = [Jw[:, part] @ r[part] for part in pixels.parts]
    return np.array(A, dtype=float), np.array(b, dtype=float)


def _add_prior(A: np.ndarray, b: np.ndarray, theta: np.ndarray, noise: np.ndarray) -> None:
    """Add what is expected of the contrast's slope and of the leaks, with its doubt, to the equations.

    The contrast should change as the paper's light does: by ratio = contrast / paper times the paper's slope.
    """
    expected, doubt = np.zeros((2, len(theta), 4))
    paper = np.maximum(theta[:, PAPER], 1 + np.abs(theta[:, CONTRAST]) / 50)  # on dark paper its change is hardly known
    ratio = (theta[:, CONTRAST] / paper)[:, None]
    slope = ratio * theta[:, PAPER_SLOPE]
    expected[:, :2] = slope
    doubt[:, :2] = UNEVEN * np.abs(slope) + UNEVEN_STD * np.maximum(1, ratio**2)
    doubt[:, 2:] = LEAK_STD
    prior = (noise[:, None] / doubt) ** 2
    own = range(DOUBTFUL.start, DOUBTFUL.stop)
    A[:, own, own] += prior
    b[:, DOUBTFUL] -= prior * (theta[:, DOUBTFUL] - expected)


def _solve(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve A x = b of each fiducial, its diagonal brought to one: x, shape (F, 12), and A^-1, shape (F, 12, 12)."""
    unit = np.sqrt(np.einsum("fii->fi", A)) + EDGE_RIDGE
    units = unit[:, :, None] * unit[:, None, :]
    scaled = A / units + EDGE_RIDGE * np.eye(N_PARAMETERS)
    x = np.linalg.solve(scaled, (b / unit)[..., None])[..., 0] / unit
    return x, np.linalg.inv(scaled) / units


def _stepped(theta: np.ndarray, change: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Take a step, not too far, and keep growth and blur where a fiducial is still one: theta and the step taken."""
    change = change.copy()
    variance = theta[:, VARIANCE]
    change[:, :3] = np.clip(change[:, :3], -LARGEST_EDGE_STEP, LARGEST_EDGE_STEP)
    change[:, VARIANCE] = np.clip(change[:, VARIANCE], -variance / 2 - 0.05, variance / 2 + 0.2)
    theta = theta + change
    theta[:, GROWTH] = np.clip(theta[:, GROWTH], -LARGEST_GROWTH * reach, LARGEST_GROWTH * reach)
    theta[:, VARIANCE] = np.clip(theta[:, VARIANCE], -0.01, (LARGEST_BLUR * reach) ** 2)
    return theta, change


def _is_still(change: np.ndarray, inverse: np.ndarray, noise: np.ndarray) -> bool:
    """Tell whether the last step moved the edges of most fiducials by next to nothing."""
    variance = np.einsum("fii->fi", inverse)[:, OUTLINE]
    sigma = noise[:, None] * np.sqrt(variance)
    moved = np.max(np.abs(change[:, OUTLINE]) / (sigma + 1e-6), axis=1)
    return bool(np.quantile(moved, MOST) < STILL)
