"""What a fiducial looks like from a given pose: the shape of its image, and how much of each pixel's light it gives.

The shape is a quadratic map between the image and the fiducial, so that perspective and the lens's distortion are in it. Across
an edge the light falls off as an integrated Gaussian, the lens's blur, seen through the width of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from aridcal.engine.instruments.camera import predict_pixels
from aridcal.jobs.head1992.square import FIDUCIAL_CENTRES, SQUARE_SIDE, FiducialLayout

# Shapes are predicted from places up to so many half sizes from a fiducial's centre: its outline lies well inside.
GRID_REACH = 1.2

# Places on a fiducial in units of its width and height, shape (9, 2).
_GRID = GRID_REACH * np.array([[i, j] for i in (-0.5, 0, 0.5) for j in (-0.5, 0, 0.5)])
_LEFT, _MIDDLE, _RIGHT = 1, 4, 7  # of _GRID

# [m] of surroundings used around an outline: less than from a fiducial to the paper's edge.
MARGIN = 0.0030

# [px] and sigma of the blur: surroundings further from an edge than this say nothing of it.
BLUR_MARGIN = 2.5, 3.0

# [px²] of a pixel's own width.
PIXEL_VARIANCE = 1 / 12

# [px²] of an edge's blur in the model: a sharper one has a slope that no sampling sees.
LEAST_VARIANCE = 0.01

# [px] to an edge of the paper that is not near.
FAR_DISTANCE = 1e3

# Sigma outside an edge from which nothing of what lies beyond is seen: its share is 3e-5.
UNSEEN_FROM = -4.0


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


def predict_shapes(T_camera_square: np.ndarray, layout: FiducialLayout, intrinsics: np.ndarray) -> Shapes:
    """Predict the images of fiducials, perspective and distortion to second order across each of them.

    Nine places on and around a fiducial are projected, and the six coefficients of the way back, from the image to the
    fiducial, are fitted to them by least squares.

    Args:
        T_camera_square: Shape (4, 4).
        layout: The fiducials, F of them.
        intrinsics: In the order of ``INTRINSICS``, shape (9,).
    """
    local = layout.sizes[:, None] * _GRID
    places = layout.centres[:, None] + local @ layout.axes  # (F, 9, 3)
    pixels, _, _ = predict_pixels(T_camera_square, places, intrinsics)
    centres = pixels[:, _MIDDLE]
    offsets = pixels - centres[:, None]
    extent = np.abs(offsets).max(axis=1)
    inverse = _quadratic_through(offsets, extent)
    across = np.linalg.norm(pixels[:, _RIGHT] - pixels[:, _LEFT], axis=1)
    scale = across / (GRID_REACH * layout.sizes[:, 0])
    return Shapes(centres, inverse, extent / GRID_REACH, scale, _paper_edges(layout))


def _quadratic_through(offsets: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """Fit the places of ``_GRID`` as quadratic functions of image offsets (F, 9, 2), [px]: shape (F, 6, 2).

    Offsets are divided by their extent (F, 2), so that the normal equations A'A c = A'g are well conditioned; the
    coefficients are scaled back afterwards.
    """
    A = _quadratic(offsets / extent[:, None])
    At = np.swapaxes(A, 1, 2)
    places = np.broadcast_to(_GRID, offsets.shape)
    coefficients = np.linalg.solve(At @ A, At @ places)
    scaling = _quadratic(extent)
    return coefficients / scaling[..., None]


def _quadratic(xy: np.ndarray) -> np.ndarray:
    """Return 1, x, y, x², x y, y² of points (..., 2), shape (..., 6)."""
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def _paper_edges(layout: FiducialLayout) -> np.ndarray:
    """Find where the paper ends beside each fiducial, in units of its width and height from its centre, shape (F, 2).

    Inf along an axis on which the fiducial sits in the paper's middle half: its edge is too far away to matter.
    """
    place = FIDUCIAL_CENTRES[layout.fiducial - 1]
    edge = np.sign(place) * SQUARE_SIDE / 2
    beside = np.abs(place) > SQUARE_SIDE / 4
    return np.where(beside, (edge - place) / layout.sizes, np.inf)


@dataclass(frozen=True)
class Pixels:
    """Pixels near the outlines of all fiducials, in one list, fiducial by fiducial.

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

    @cached_property
    def first(self) -> np.ndarray:
        """Where each fiducial's pixels begin, shape (F,)."""
        return np.cumsum(self.counts) - self.counts

    @cached_property
    def parts(self) -> list[slice]:
        """The pixels of each fiducial."""
        return [slice(a, a + n) for a, n in zip(self.first, self.counts, strict=True)]

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Give each pixel its fiducial's values, shape (F, ...): shape (..., P)."""
        return np.repeat(values.astype(np.float32).T, self.counts, axis=-1)

    def total(self, values: np.ndarray) -> np.ndarray:
        """Sum the pixels' values, shape (P,), for each fiducial, shape (F,)."""
        return np.add.reduceat(values, self.first)


def near_outlines(image: np.ndarray, shapes: Shapes, blur: float) -> Pixels:
    """Collect the pixels near each predicted outline, as many as a blur of that sigma, [px], makes worth looking at."""
    margin = np.minimum(MARGIN * shapes.scale, BLUR_MARGIN[0] + BLUR_MARGIN[1] * blur)
    middle = np.rint(shapes.centres).astype(int)
    boxes = shapes.half_extent + margin[:, None]
    largest_box = np.max(boxes, axis=0)
    reach_u, reach_v = np.ceil(largest_box).astype(int)
    dv, du = (g.ravel() for g in np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1])
    u = middle[:, :1] + du  # (F, pixels of the largest box)
    v = middle[:, 1:] + dv
    off = middle - shapes.centres
    x = (du + off[:, :1]).astype(np.float32)
    y = (dv + off[:, 1:]).astype(np.float32)
    depth = _depth(x, y, shapes)
    height, width = image.shape
    in_view = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    near = (np.abs(depth) < margin[:, None]) & in_view
    grey = image[v[near], u[near]].astype(np.float32)
    places = np.stack([x[near], y[near]], axis=-1)
    return Pixels(grey, places, depth[near], near.sum(axis=1))


def _depth(x: np.ndarray, y: np.ndarray, shapes: Shapes) -> np.ndarray:
    """Return how far inside the nearest edge places x, y (F, P) around the centres are, shape (F, P), [px]."""
    c = np.moveaxis(shapes.inverse, 0, -1)[..., None].astype(np.float32)
    of_edges = []
    for k, pitch in enumerate(_pitch(shapes)):
        place = _place(x, y, c[:, k])
        of_edges.append((0.5 - np.abs(place)) / pitch[:, None])
    return np.minimum(*of_edges)


def _pitch(shapes: Shapes) -> tuple[np.ndarray, np.ndarray]:
    """Return how much of the fiducial's width and height one pixel across its edges is, each (F,)."""
    pitch = np.linalg.norm(shapes.inverse[:, 1:3], axis=1)
    return pitch[:, 0], pitch[:, 1]


def _place(x: np.ndarray, y: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Evaluate c0 + c1 x + c2 y + c3 x² + c4 x y + c5 y²."""
    c0, c1, c2, c3, c4, c5 = c
    by_x = c1 + c3 * x + c4 * y
    by_y = c2 + c5 * y
    return c0 + x * by_x + y * by_y


def fiducial_share(pixels: Pixels, shapes: Shapes, outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each pixel's light that comes from its fiducial, with derivatives.

    A fiducial is where two strips cross, one between its left and right edges, one between its lower and upper ones.

    Args:
        pixels: P of them.
        shapes: Of the fiducials.
        outline: What each pixel's fiducial is moved by, shape (4, P): shift u, v [px], growth [px], by which each edge lies
            further out, and variance of the blur without the pixel's own [px²].

    Returns:
        Shares (P,) and their derivatives by ``outline`` (4, P).
    """
    x, y = pixels.d.T - outline[:2]
    across_width, across_height = _pitch(shapes)
    cover_x, by_x = _strip(pixels, x, y, outline, shapes.inverse[:, :, 0], across_width)
    cover_y, by_y = _strip(pixels, x, y, outline, shapes.inverse[:, :, 1], across_height)
    return cover_x * cover_y, by_x * cover_y + by_y * cover_x


def _strip(
    pixels: Pixels, x: np.ndarray, y: np.ndarray, outline: np.ndarray, inverse: np.ndarray, pitch: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each pixel's light from between two opposite edges, and its derivatives, as ``fiducial_share``.

    Seen along an edge's normal, a pixel is a trapezoid made of two boxes of widths a and b. Two impulses +-delta and a
    Gaussian of the same variance and kurtosis stand for it: delta⁴ = (a⁴ + b⁴) / 240. At t inside the edge the share is
    (F(t + delta) + F(t - delta)) / 2, F the Gaussian's integral.
    """
    _, _, growth, blur_variance = outline
    c = inverse / pitch[:, None]  # place in pixels across the edge
    place = _place(x, y, pixels.spread(c))
    by_u, by_v = pixels.spread(c[:, 1:3])
    delta4 = np.sum(c[:, 1:3] ** 4, axis=1) / 240
    delta = pixels.spread(delta4**0.25)
    variance = blur_variance + PIXEL_VARIANCE - delta**2
    inverse_sigma = 1 / np.sqrt(np.maximum(variance, LEAST_VARIANCE))
    half_width = pixels.spread(0.5 / pitch)
    t = half_width + growth - np.abs(place)  # inside the nearer edge; the other one is far
    t1 = (t + delta) * inverse_sigma
    t2 = (t - delta) * inverse_sigma
    (cdf1, pdf1), (cdf2, pdf2) = _normal(t1), _normal(t2)
    outwards = 0.5 * inverse_sigma * (pdf1 + pdf2)
    by_variance = -0.25 * inverse_sigma**2 * (t1 * pdf1 + t2 * pdf2)
    across = np.copysign(outwards, place)  # by a shift towards growing place
    share = 0.5 * (cdf1 + cdf2)
    by_outline = np.stack([across * by_u, across * by_v, outwards, by_variance])
    return share, by_outline


def share_beyond_paper(pixels: Pixels, shapes: Shapes, outline: np.ndarray) -> np.ndarray:
    """Return the share of each pixel's light from beyond the paper's near edges, shape (2, P).

    Args:
        pixels: P of them.
        shapes: Of the fiducials.
        outline: As in ``fiducial_share``; the paper does not grow.
    """
    x, y = pixels.d.T - outline[:2]
    sigma = np.sqrt(outline[3] + PIXEL_VARIANCE)
    shares = np.zeros((2, len(pixels.grey)), np.float32)
    for k, pitch in enumerate(_pitch(shapes)):
        edge = shapes.paper_edge[:, k]
        near = np.isfinite(edge)
        outwards = np.where(near, np.sign(edge), 0)
        c = shapes.inverse[:, :3, k].copy()  # pixels beyond the edge as a linear function of x and y
        c[:, 0] -= np.where(near, edge, 0)
        c *= (outwards / pitch)[:, None]
        c[:, 0] -= np.where(near, 0, FAR_DISTANCE)
        constant, by_x, by_y = pixels.spread(c)
        t = (constant + by_x * x + by_y * y) / sigma
        seen = t > UNSEEN_FROM
        shares[k, seen], _ = _normal(t[seen])
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
