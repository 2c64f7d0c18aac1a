"""Where a fiducial is, to a few thousandths of a pixel: its outline fitted to the grey levels around it.

The pose that is already known to a fraction of a pixel gives the shape of each fiducial in the image. The shape is then
shifted, grown, blurred and lit until it explains the grey levels, all fiducials of an image at once. What is reported is the
image of the fiducial's centre, not the centroid of its image, so that the perspective bias of centroids does not arise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aridcal.head.pose import predict_pixels
from aridcal.head.square import Layout

MARGIN = 0.0030  # [m] of surroundings used: less than from a fiducial to the paper's edge
TUKEY = 6.0  # residuals beyond so many sigma have no weight
# With Tukey weights w at Gaussian noise, variance = sigma^2 * TUKEY_VARIANCE * inv(J' w J): E[w] E[psi^2] / E[psi']^2.
TUKEY_VARIANCE = 0.965
PIXEL_VARIANCE = 1 / 12
MODEL_STD = 0.0015  # [px] what the edge model itself may be wrong by
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
    """

    centres: np.ndarray
    inverse: np.ndarray
    half_extent: np.ndarray
    scale: np.ndarray


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
    return Shapes(centres, coefficients / scaling[..., None], extent / 1.2, scale)


@dataclass(frozen=True)
class Fits:
    """Outlines fitted to an image.

    Attributes:
        centres: Images of the fiducials' centres, shape (F, 2), [px].
        covariances: Of the centres, shape (F, 2, 2), [px²].
        growth: By how much each edge lies further out than it should, shape (F,), [px].
        blur: Standard deviation of the edges' blur without the pixel's own, shape (F,), [px].
        contrast: Fiducial minus paper, shape (F,), [grey levels].
        noise: Robust standard deviation of what remains, shape (F,), [grey levels].
        edge_weight: Mean robust weight of the pixels at the outline, 0 to 1, shape (F,).
    """

    centres: np.ndarray
    covariances: np.ndarray
    growth: np.ndarray
    blur: np.ndarray
    contrast: np.ndarray
    noise: np.ndarray
    edge_weight: np.ndarray


def fit_outlines(image: np.ndarray, shapes: Shapes, sizes: np.ndarray, blur: float, steps: tuple[int, int]) -> Fits:
    """Fit shift, growth, blur and light of each fiducial by robust least squares.

    Args:
        image: Grey levels, shape (height, width).
        shapes: Prediction to start from.
        sizes: Width and height of each fiducial, shape (F, 2), [m].
        blur: To start from, [px].
        steps: Gauss-Newton steps that leave out gross errors only, then steps with Tukey's weights.

    Returns:
        The fits. A fiducial that is not there shows by its contrast, noise or edge weight.
    """
    margin = np.minimum(MARGIN * shapes.scale, 2.5 + 3 * blur)
    pixels = _near_outlines(image, shapes, margin)
    n, counts, starts = len(sizes), pixels.counts, np.cumsum(pixels.counts) - pixels.counts

    def spread(values: np.ndarray) -> np.ndarray:
        return np.repeat(values.astype(np.float32), counts)

    inside = pixels.depth > 1
    total_in = np.add.reduceat(np.where(inside, pixels.grey, 0), starts) / np.add.reduceat(inside, starts)
    outside = pixels.depth < -1
    total_out = np.add.reduceat(np.where(outside, pixels.grey, 0), starts) / np.add.reduceat(outside, starts)
    # Parameters: shift u, v; growth; blur variance; light of the paper (3); fiducial minus paper (3).
    theta = np.zeros((n, 10))
    theta[:, 3], theta[:, 4], theta[:, 7] = blur**2, total_out, total_in - total_out
    reach = np.max(shapes.half_extent, axis=1)
    tilt = (pixels.d / spread(reach)[:, None]).astype(np.float32)
    J = np.empty((len(pixels.grey), 10), np.float32)
    for step in range(sum(steps) + 1):
        model, slope = _edges(pixels, shapes, theta, spread)
        J[:, 4], J[:, 5:7], J[:, 7], J[:, 8:] = 1, tilt, model, tilt * model[:, None]
        contrast = spread(theta[:, 7]) + tilt[:, 0] * spread(theta[:, 8]) + tilt[:, 1] * spread(theta[:, 9])
        J[:, :4] = contrast[:, None] * slope
        paper = spread(theta[:, 4]) + tilt[:, 0] * spread(theta[:, 5]) + tilt[:, 1] * spread(theta[:, 6])
        r = pixels.grey - paper - contrast * model
        noise = 1.4826 * np.array([np.median(np.abs(part)) for part in np.split(r, starts[1:])])
        cut = 0.6 * np.abs(theta[:, 7]) + 5 if step < steps[0] else TUKEY * np.maximum(noise, 0.4)
        w = np.maximum(1 - (r / spread(cut)) ** 2, 0) ** 2
        Jw = J * w[:, None]
        slices = [slice(a, a + c) for a, c in zip(starts, counts, strict=True)]
        A = np.array([Jw[part].T @ J[part] for part in slices], dtype=float)
        size = np.sqrt(np.einsum("fii->fi", A)) + 1e-6
        A = A / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(10)
        if step == sum(steps):
            break
        b = np.array([Jw[part].T @ r[part] for part in slices], dtype=float) / size
        change = np.linalg.solve(A, b[..., None])[..., 0] / size
        change[:, :3] = np.clip(change[:, :3], -1, 1)
        theta += change
        theta[:, 3] = np.clip(theta[:, 3], -0.01, (0.3 * reach) ** 2)
        theta[:, 2] = np.clip(theta[:, 2], -0.3 * reach, 0.3 * reach)
    pooled = float(np.median(noise))
    sigma = np.where(noise < 1.3 * pooled, pooled, noise)
    inverse = np.linalg.inv(A)[:, :2, :2] / (size[:, :2, None] * size[:, None, :2])
    rim = np.abs(pixels.depth) < 1.5
    return Fits(
        centres=shapes.centres + theta[:, :2],
        covariances=TUKEY_VARIANCE * sigma[:, None, None] ** 2 * inverse + MODEL_STD**2 * np.eye(2),
        growth=theta[:, 2],
        blur=np.sqrt(np.maximum(theta[:, 3], 0)),
        contrast=theta[:, 7],
        noise=noise,
        edge_weight=np.add.reduceat(np.where(rim, w, 0), starts) / np.add.reduceat(rim, starts),
    )


@dataclass(frozen=True)
class _Pixels:
    """Pixels near the outlines of all fiducials in one list: grey level, place relative to the predicted centre (P, 2),
    depth inside the predicted outline [px]; and how many there are of each fiducial.
    """

    grey: np.ndarray
    d: np.ndarray
    depth: np.ndarray
    counts: np.ndarray


def _near_outlines(image: np.ndarray, shapes: Shapes, margin: np.ndarray) -> _Pixels:
    middle = np.rint(shapes.centres).astype(int)
    reach_u, reach_v = np.ceil(np.max(shapes.half_extent + margin[:, None], axis=0)).astype(int)
    dv, du = (g.ravel() for g in np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1])
    u, v = middle[:, :1] + du, middle[:, 1:] + dv
    off = middle - shapes.centres
    x, y = (du + off[:, :1]).astype(np.float32), (dv + off[:, 1:]).astype(np.float32)
    c = shapes.inverse[:, :, :, None].astype(np.float32)
    px, py = _pitch(shapes)
    depth = np.minimum(
        (0.5 - np.abs(_place(x, y, c[:, :, 0]))) / px[:, None], (0.5 - np.abs(_place(x, y, c[:, :, 1]))) / py[:, None]
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
    return c[:, 0] + x * (c[:, 1] + c[:, 3] * x + c[:, 4] * y) + y * (c[:, 2] + c[:, 5] * y)


def _edges(
    pixels: _Pixels, shapes: Shapes, theta: np.ndarray, spread: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each pixel's light from the fiducial (P,), and its derivatives by the first four parameters."""
    x, y = pixels.d[:, 0] - spread(theta[:, 0]), pixels.d[:, 1] - spread(theta[:, 1])
    strips = []
    for k, pitch in enumerate(_pitch(shapes)):
        c = shapes.inverse[:, :, k]
        place = _place(x, y, np.stack([spread(c[:, j]) for j in range(6)], axis=-1)) / spread(pitch)
        half = spread(0.5 / pitch + theta[:, 2])
        # Seen along an edge's normal, a pixel is a trapezoid: two impulses +-delta and a Gaussian of the same variance and
        # kurtosis stand for it.
        delta = (np.sum((c[:, 1:3] / pitch[:, None]) ** 4, axis=1) / 240) ** 0.25
        sigma = np.sqrt(np.maximum(theta[:, 3] + PIXEL_VARIANCE - delta**2, 0.01))
        t = np.stack([half - place, half + place])
        delta, sigma = spread(delta), spread(sigma)
        (cdf1, pdf1), (cdf2, pdf2) = _normal((t + delta) / sigma), _normal((t - delta) / sigma)
        edge, by_d = (cdf1 + cdf2) / 2, (pdf1 + pdf2) / (2 * sigma)
        by_variance = -((t + delta) * pdf1 + (t - delta) * pdf2) / (4 * sigma**3)
        cover = edge[0] + edge[1] - 1
        across = by_d[0] - by_d[1]  # by a shift towards growing place
        along = (c[:, 1:3] / pitch[:, None]).T
        strips.append(
            (cover, [across * spread(along[0]), across * spread(along[1]), by_d[0] + by_d[1], by_variance.sum(axis=0)])
        )
    (cover_x, by_x), (cover_y, by_y) = strips
    return cover_x * cover_y, np.stack([a * cover_y + b * cover_x for a, b in zip(by_x, by_y, strict=True)], axis=-1)


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
