"""Rows of any kind as they are seen from the target: what their residuals and their noise mean there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import columns
from aridcal.engine.rows.dataset import Dataset


@dataclass(frozen=True)
class Lever:
    """How the numbers that rows of one block measure follow the target.

    Attributes:
        rows: Numbers of the rows, shape (n,).
        part: Columns of what the rows measure, m of them.
        shift: The smallest shift of the target that changes a column by one unit, shape (n, 3, m), [m] per unit; zero where
            none does.
        turn: The smallest turn, likewise, [rad] per unit.
    """

    rows: np.ndarray
    part: slice
    shift: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True)
class TargetView:
    """Rows of any kind as they are seen from the target.

    Attributes:
        places: Where the model has the target, shape (N, 3), [m].
        levers: One of each block.
    """

    places: np.ndarray
    levers: tuple[Lever, ...]

    def shift(self, residual: np.ndarray) -> np.ndarray:
        r"""The smallest shift of the target that explains each row's residual, (N, m) to (N, 3), [m]; NaN where none does.

        .. math:: d = G^+ r

        with G, how the prediction follows the target's position. For a position d is the error itself; for a distance, as much
        along the wire; for a pixel, its size times distance over focal length, across the line of sight.
        """
        shift = np.full(self.places.shape, np.nan)
        for lever in self.levers:
            if np.any(lever.shift):
                shift[lever.rows] = np.einsum("nij,nj->ni", lever.shift, residual[lever.rows, lever.part])
        return shift

    def noise(self, sigma: np.ndarray) -> tuple[float, float]:
        """Noise at the target from noise of the numbers, shape (m,): [m] and [rad] along each axis that the row tells of.

        Returns:
            Medians over the rows, of the block with the smallest noise; 1 where no block tells.
        """
        medians = []
        for of in ("shift", "turn"):
            sizes = []
            for lever in self.levers:
                inverse: np.ndarray = getattr(lever, of)
                rank = np.linalg.matrix_rank(inverse)
                if rank.any():
                    spread = np.sum((inverse * sigma[lever.part]) ** 2, axis=(1, 2))[rank > 0] / rank[rank > 0]
                    sizes.append(float(np.sqrt(np.median(spread))))
            medians.append(min(sizes, default=1.0))
        return medians[0], medians[1]


def target_view(fit: Fit, rows: Dataset) -> TargetView:
    """Look at N rows of any kind from the target.

    Args:
        fit: The model, for the target's place.
        rows: The measurements.
    """
    fit_problem = problem(fit.model, rows)
    R, p = fit.model.poses(fit.theta, fit_problem.rows)
    measured = fit_problem.measured
    if measured.direct:
        numbers = slice(0, columns(rows.channels)[-1].stop)
        of_all = _lever(np.arange(len(rows)), numbers, np.eye(6)[None, numbers])
        shift, turn = (np.broadcast_to(some, (len(rows), *some.shape[1:])) for some in (of_all.shift, of_all.turn))
        return TargetView(p, (replace(of_all, shift=shift, turn=turn),))
    by_twist = measured.settled(fit.theta).slopes(R, p, fit.theta).by_twist
    blocks = [(np.flatnonzero(measured.block == b), part) for b, part in enumerate(measured.parts)]
    return TargetView(p, tuple(_lever(some, part, by_twist[some, part]) for some, part in blocks))


def _lever(rows: np.ndarray, part: slice, by_twist: np.ndarray) -> Lever:
    """The lever of some rows, from the derivatives of their numbers by a twist of the target, shape (n, m, 6)."""
    return Lever(rows, part, np.linalg.pinv(by_twist[:, :, :3]), np.linalg.pinv(by_twist[:, :, 3:]))
