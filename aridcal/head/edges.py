"""Where a fiducial is, to a few thousandths of a pixel: its outline fitted to the grey levels around it.

The pose that is already known to a fraction of a pixel gives the shape of each fiducial in the image. The shape is then
shifted, grown, blurred and lit until it explains the grey levels, all fiducials of an image at once. What is reported is the
image of the fiducial's centre, not the centroid of its image, so that the perspective bias of centroids does not arise.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from aridcal.head.pose import predict_pixels
from aridcal.head.square import CENTRES, SIDE, Layout

MARGIN = 0.0030  # [m] of surroundings used: less than from a fiducial to the paper's edge
TUKEY = 6.0  # residuals beyond so many sigma have no weight
# With Tukey weights w at Gaussian noise, variance = sigma^2 * TUKEY_VARIANCE * inv(J' w J): E[w] E[psi^2] / E[psi']^2.
TUKEY_VARIANCE = 0.965
N_PARAMETERS = 12
MAX_STEPS = 8
STILL, MOST = 0.4, 0.75  # a fit is done when its last step was below so many sigma for most of the fiducials
START_BLUR = 0.7  # [px]
# Light falls on paper and fiducial alike, so that contrast changes as the paper does; glare spares it. By how much the change
# may differ from that: a share of it, and some grey levels across half a fiducial.
UNEVEN, UNEVEN_STD = 1.0, 0.05
LEAK_STD = 60.0  # [grey levels] by which the surroundings may differ from the paper
PIXEL_VARIANCE = 1 / 12
# Where dirt has cost an edge some of its weight, what is left of the dirt shows in the centre too (measured on rendered dirt).
CLEAN_EDGE, DOUBT = 0.9, 30.0
MODEL_STD = 0.0008  # [px] what the edge model itself may be wrong by
_GRID = 1.2 * np.array([[i, j] for i in (-0.5, 0, 0.5) for j in (-0.5, 0, 0.5)])


@dataclass(frozen=True)
class Shapes:
    """How fiducials are imaged from a given pose.

    Attributes:
        centres: Images of their centres, shape (F, 2), [px].
        inverse: From (1, du, dv, du², du dv, dv²) around ``centres`` to places in units of the fiducial's width and height
            from its centre, shape (F, 6, 2).
        half_extent: Half of the box around the image of the fiducial, shape (F, 2), [px].
        scale: Pixels per metre, shape (F,).
        paper_edge: Where the paper ends on its near side, in the coordinates of ``inverse``, shape (F, 2); inf for none.
    """

    centres: np.ndarray
    inverse: np.ndarray
    half_extent: np.ndarray
    scale: np.ndarray
    paper_edge: np.ndarray

    def __getitem__(self, which: np.ndarray) -> Shapes:
        """Select fiducials."""
        return Shapes(*(getattr(self, f.name)[which] for f in fields(self)))


def predict_shapes(T_camera_square: np.ndarray, layout: Layout, intrinsics: np.ndarray) -> Shapes:
    """Predict the images of fiducials, perspective and distortion to second order across each of them."""
    local = layout.sizes[:, None] * _GRID
    pixels, _, _ = predict_pixels(T_camera_square, layout.centres[:, None] + local @ layout.axes, intrinsics)
    centres = pixels[:, 4]
    d = pixels - centres[:, None]
    extent = np.abs(d).max(axis=1)
    unit = d / extent[:, None]  # well conditioned
    A = _quadratic(unit[..., 0], unit[..., 1])
    coefficients = np.linalg.solve(np.swapaxes(A, 1, 2) @ A, np.swapaxes(A, 1, 2) @ np.broadcast_to(_GRID, d.shape))
    eu, ev = extent[:, 0], extent[:, 1]
    scaling = np.stack([np.ones_like(eu), eu, ev, eu**2, eu * ev, ev**2], axis=-1)
    scale = np.linalg.norm(pixels[:, 7] - pixels[:, 1], axis=1) / (1.2 * layout.sizes[:, 0])
    place = CENTRES[layout.fiducial - 1]
    paper_edge = np.where(np.abs(place) > SIDE / 4, (np.sign(place) * SIDE / 2 - place) / layout.sizes, np.inf)
    return Shapes(centres, coefficients / scaling[..., None], extent / 1.2, scale, paper_edge)


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
    def growth(self) -> np.ndarray:
        """By how much each edge lies further out than it should, shape (F,), [px]."""
        return self.theta[:, 2]

    @property
    def blur(self) -> np.ndarray:
        """Standard deviation of the edges' blur without the pixel's own, shape (F,), [px]."""
        return np.sqrt(np.maximum(self.theta[:, 3], 0))

    @property
    def contrast(self) -> np.ndarray:
        """Fiducial minus paper, shape (F,), [grey levels]."""
        return self.theta[:, 7]


def fit_outlines(image: np.ndarray, shapes: Shapes, start: Fits | None = None, gross_steps: int = 0) -> Fits:
    """Fit shift, growth, blur and light of each fiducial by robust least squares.

    Args:
        image: Grey levels, shape (height, width).
        shapes: How the fiducials are imaged, as far as known; all of them inside the image.
        start: An earlier fit of the same fiducials.
        gross_steps: Steps of Gauss and Newton to take first that leave out gross errors only.

    Returns:
        The fits. A fiducial that is not there shows by its contrast, noise or edge weight.
    """
    blur = START_BLUR if start is None else float(np.median(start.blur))
    pixels = _near_outlines(image, shapes, np.minimum(MARGIN * shapes.scale, 2.5 + 3 * blur))
    first = np.cumsum(pixels.counts) - pixels.counts
    parts = [slice(a, a + c) for a, c in zip(first, pixels.counts, strict=True)]
    spread = pixels.spread
    reach = np.max(shapes.half_extent, axis=1)
    theta = _start(pixels, shapes, first) if start is None else start.theta.copy()
    if start is not None:
        theta[:, :2] = start.centres - shapes.centres
    J = np.empty((N_PARAMETERS, len(pixels.grey)), np.float32)
    J[4], J[5:7] = 1, pixels.d.T / spread(reach)
    for step in range(gross_steps + MAX_STEPS):
        light = spread(theta)
        model, slope = _edges(pixels, shapes, light)
        J[7], J[8:10], J[10:] = model, J[5:7] * model, _beyond_paper(pixels, shapes, light)
        contrast = light[7] + J[5] * light[8] + J[6] * light[9]
        J[:4] = contrast * slope
        r = pixels.grey - np.einsum("kp,kp->p", J[4:7], light[4:7]) - np.einsum("kp,kp->p", J[10:], light[10:])
        r -= contrast * model
        clipped = ((pixels.grey >= 255) & (r < 0)) | ((pixels.grey <= 0) & (r > 0))  # as bright or dark as can be
        r[clipped] = 0
        size = np.where(clipped, np.inf, np.abs(r))
        middle = np.maximum(pixels.counts - np.add.reduceat(clipped, first), 1) // 2
        noise = 1.4826 * np.array([np.partition(size[p], m)[m] for p, m in zip(parts, middle, strict=True)])
        gross = step < gross_steps
        settled = start is not None
        level = np.abs(theta[:, 7])
        cut = 0.6 * level + 5 if gross else np.maximum(TUKEY * noise, (0.01 if settled else 0.1) * level + 1)
        w = np.maximum(1 - (r / spread(cut)) ** 2, 0) ** 2
        Jw = J * np.where(clipped, 0, w)
        A = np.array([Jw[:, part] @ J[:, part].T for part in parts], dtype=float)
        b = np.array([Jw[:, part] @ r[part] for part in parts], dtype=float)
        expected, doubt = np.zeros((2, len(theta), 4))
        ratio = (theta[:, 7] / np.maximum(theta[:, 4], 1 + level / 50))[:, None]
        expected[:, :2] = ratio * theta[:, 5:7]  # on dark paper its change is hardly known
        doubt[:, :2] = UNEVEN * np.abs(expected[:, :2]) + UNEVEN_STD * np.maximum(1, ratio**2)
        doubt[:, 2:] = LEAK_STD
        prior = (noise[:, None] / doubt) ** 2
        A[:, range(8, 12), range(8, 12)] += prior
        b[:, 8:] -= prior * (theta[:, 8:] - expected)
        unit = np.sqrt(np.einsum("fii->fi", A)) + 1e-6
        A = A / (unit[:, :, None] * unit[:, None, :]) + 1e-6 * np.eye(N_PARAMETERS)
        change = np.linalg.solve(A, (b / unit)[..., None])[..., 0] / unit
        change[:, :3] = np.clip(change[:, :3], -1, 1)
        change[:, 3] = np.clip(change[:, 3], -theta[:, 3] / 2 - 0.05, theta[:, 3] / 2 + 0.2)
        theta += change
        theta[:, 2] = np.clip(theta[:, 2], -0.3 * reach, 0.3 * reach)
        theta[:, 3] = np.clip(theta[:, 3], -0.01, (0.6 * reach) ** 2)
        inverse = np.linalg.inv(A) / (unit[:, :, None] * unit[:, None, :])
        moved = np.abs(change[:, :4]) / (noise[:, None] * np.sqrt(np.einsum("fii->fi", inverse)[:, :4]) + 1e-6)
        if not gross and np.quantile(np.max(moved, axis=1), MOST) < STILL:
            break
    pooled = float(np.median(noise))
    sigma = np.where(noise < 1.3 * pooled, pooled, noise)
    inverse *= TUKEY_VARIANCE * sigma[:, None, None] ** 2
    rim = np.abs(pixels.depth) < 1.5
    edge_weight = np.add.reduceat(np.where(rim, w, 0), first) / np.add.reduceat(rim, first)
    dirt = 1 + DOUBT * np.maximum(0, CLEAN_EDGE - edge_weight)
    return Fits(
        centres=shapes.centres + theta[:, :2],
        covariances=inverse[:, :2, :2] * dirt[:, None, None] + MODEL_STD**2 * np.eye(2),
        shape_std=np.sqrt(np.maximum(np.einsum("fii->fi", inverse)[:, 2:4], 0)),
        noise=noise,
        edge_weight=edge_weight,
        theta=theta,
    )


def _start(pixels: _Pixels, shapes: Shapes, first: np.ndarray) -> np.ndarray:
    theta = np.zeros((len(first), N_PARAMETERS))
    theta[:, 3] = START_BLUR**2
    inside, outside = (
        np.add.reduceat(np.where(there, pixels.grey, 0), first) / np.add.reduceat(there, first)
        for there in (pixels.depth > 1, pixels.depth < -1)
    )
    theta[:, 4], theta[:, 7] = outside, inside - outside
    return theta


@dataclass(frozen=True)
class _Pixels:
    """Pixels near the outlines of all fiducials, in one list.

    Attributes:
        grey: Grey levels, shape (P,).
        d: Places relative to the predicted centres, shape (P, 2), [px].
        depth: Distance inside the predicted outline, shape (P,), [px].
        counts: How many there are of each fiducial, shape (F,).
    """

    grey: np.ndarray
    d: np.ndarray
    depth: np.ndarray
    counts: np.ndarray

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Give each pixel its fiducial's values, shape (F, ...): shape (..., P)."""
        return np.repeat(values.astype(np.float32).T, self.counts, axis=-1)


def _near_outlines(image: np.ndarray, shapes: Shapes, margin: np.ndarray) -> _Pixels:
    middle = np.rint(shapes.centres).astype(int)
    reach_u, reach_v = np.ceil(np.max(shapes.half_extent + margin[:, None], axis=0)).astype(int)
    dv, du = (g.ravel() for g in np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1])
    u, v = middle[:, :1] + du, middle[:, 1:] + dv
    off = middle - shapes.centres
    x, y = (du + off[:, :1]).astype(np.float32), (dv + off[:, 1:]).astype(np.float32)
    c = np.moveaxis(shapes.inverse, 0, -1)[..., None].astype(np.float32)
    px, py = _pitch(shapes)
    depth = np.minimum(
        (0.5 - np.abs(_place(x, y, c[:, 0]))) / px[:, None], (0.5 - np.abs(_place(x, y, c[:, 1]))) / py[:, None]
    )
    height, width = image.shape
    near = (np.abs(depth) < margin[:, None]) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    return _Pixels(
        image[v[near], u[near]].astype(np.float32), np.stack([x[near], y[near]], axis=-1), depth[near], near.sum(axis=1)
    )


def _pitch(shapes: Shapes) -> tuple[np.ndarray, np.ndarray]:
    """Return how much of the fiducial's width and height one pixel across its edges is."""
    pitch = np.linalg.norm(shapes.inverse[:, 1:3], axis=1)
    return pitch[:, 0], pitch[:, 1]


def _place(x: np.ndarray, y: np.ndarray, c: np.ndarray) -> np.ndarray:
    return c[0] + x * (c[1] + c[3] * x + c[4] * y) + y * (c[2] + c[5] * y)


def _edges(pixels: _Pixels, shapes: Shapes, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each pixel's light from the fiducial (P,), and its derivatives by the first four parameters (4, P).

    Seen along an edge's normal, a pixel is a trapezoid: two impulses +-delta and a Gaussian of the same variance and
    kurtosis stand for it.
    """
    x, y = pixels.d[:, 0] - theta[0], pixels.d[:, 1] - theta[1]
    strips = []
    for k, pitch in enumerate(_pitch(shapes)):
        c = shapes.inverse[:, :, k] / pitch[:, None]  # place in pixels across the edge
        place = _place(x, y, pixels.spread(c))
        along = pixels.spread(c[:, 1:3])
        delta = pixels.spread((np.sum(c[:, 1:3] ** 4, axis=1) / 240) ** 0.25)
        inverse_sigma = 1 / np.sqrt(np.maximum(theta[3] + PIXEL_VARIANCE - delta**2, 0.01))
        t = pixels.spread(0.5 / pitch) + theta[2] - np.abs(place)  # inside the nearer edge; the other one is far
        t1, t2 = (t + delta) * inverse_sigma, (t - delta) * inverse_sigma
        (cdf1, pdf1), (cdf2, pdf2) = _normal(t1), _normal(t2)
        outwards = 0.5 * inverse_sigma * (pdf1 + pdf2)
        by_variance = -0.25 * inverse_sigma**2 * (t1 * pdf1 + t2 * pdf2)
        across = np.copysign(outwards, place)  # by a shift towards growing place
        strips.append((0.5 * (cdf1 + cdf2), np.stack([across * along[0], across * along[1], outwards, by_variance])))
    (cover_x, by_x), (cover_y, by_y) = strips
    return cover_x * cover_y, by_x * cover_y + by_y * cover_x


def _beyond_paper(pixels: _Pixels, shapes: Shapes, theta: np.ndarray) -> np.ndarray:
    """Return the share of each pixel's light from beyond the paper's near edges, shape (2, P)."""
    shares = np.zeros((2, len(pixels.grey)), np.float32)
    for k, pitch in enumerate(_pitch(shapes)):
        edge = shapes.paper_edge[:, k]
        c = shapes.inverse[:, :3, k].copy()
        c[:, 0] -= np.where(np.isfinite(edge), edge, 0)
        c *= (np.where(np.isfinite(edge), np.sign(edge), 0) / pitch)[:, None]
        c[:, 0] -= np.where(np.isfinite(edge), 0, 1e3)
        c = pixels.spread(c)
        t = (c[0] + c[1] * (pixels.d[:, 0] - theta[0]) + c[2] * (pixels.d[:, 1] - theta[1])) / np.sqrt(
            theta[3] + PIXEL_VARIANCE
        )
        near = t > -4
        shares[k, near] = _normal(t[near])[0]
    return shares


def _normal(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal distribution and density (Abramowitz and Stegun 26.2.17, to 1e-7)."""
    density = np.exp(t * t * np.float32(-0.5)) * np.float32(0.3989422804)
    k = 1 / (1 + np.float32(0.2316419) * np.abs(t))
    tail = np.float32(1.330274429)
    for a in (-1.821255978, 1.781477937, -0.356563782, 0.319381530):
        tail = tail * k + np.float32(a)
    tail = tail * k * density
    return np.where(t > 0, 1 - tail, tail), density


def _quadratic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
