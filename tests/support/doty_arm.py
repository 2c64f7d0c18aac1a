"""Doty's arm and its printed matrix E, for tests and for the page on the claims of 1992."""

import numpy as np

LENGTHS = np.array([0.5, 1.2, 0.9])

LIMITS = np.array([[0.0, 718 * 0.0254], *np.radians([[4, 112], [102, 148], [-117, -16]])])


def random_q(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (*shape, 4))


def angles(q: np.ndarray, theta_1: float = 0.0) -> np.ndarray:
    return np.concatenate([np.full((*q.shape[:-1], 1), theta_1), q[..., 1:]], axis=-1)


def arid(psi: np.ndarray | None = None, lengths: np.ndarray = LENGTHS) -> np.ndarray:
    links = np.zeros((4, 5))
    links[:3, 3] = lengths
    if psi is not None:
        links[:, 2], links[:, 4] = psi.reshape(2, 4)
    return links


def ranks(matrices: np.ndarray) -> np.ndarray:
    values = np.linalg.svd(matrices, compute_uv=False)
    return np.sum(values > 1e-10 * values[..., :1], axis=-1)


def conditions(matrices: np.ndarray) -> np.ndarray:
    values = np.linalg.svd(matrices, compute_uv=False)
    return values[..., 0] / values[..., -1]


def printed_E(theta: np.ndarray) -> np.ndarray:
    """Rows 1 to 4 of E as Doty (1992) prints them: shape (..., 4, 8), for theta of shape (..., 4)."""
    _, t2, t3, t4 = np.moveaxis(theta, -1, 0)
    f1, f12, f123, f1234 = np.moveaxis(np.cumsum(theta, axis=-1), -1, 0)
    zero, one, c, s = np.zeros_like(t2), np.ones_like(t2), np.cos, np.sin
    rows = [
        [c(f1234), c(f123), c(f12), c(f1), s(f1234), s(f123), s(f12), s(f1)],
        [s(f1234), s(f123), s(f12), s(f1), -c(f1234), -c(f123), -c(f12), c(f1)],
        [zero, -c(t3 + t4), c(t4), -one, s(t2 + t3 + t4), s(t3 + t4), s(t4), zero],  # the first cell is blank
        [s(t2 + t3 + t4), s(t3 + t4), s(t4), zero, c(t2 + t3 + t4), c(t3 + t4), c(t4), one],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
