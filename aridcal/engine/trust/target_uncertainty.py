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
    """How what rows of one block measure follows the target.

    Attributes:
        rows: Their numbers, shape (n,).
        part: Columns of what they measure, m of them.
        shift: The smallest shift of the target that changes these numbers by so much, shape (n, 3, m), [m] per unit; zero
            where none does.
        turn: The smallest turn, likewise, [rad] per unit.
    """

    rows: np.ndarray
    part: slice
    shift: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True)
class AtTarget:
    """Rows of any kind as they are seen from the target.

    Attributes:
        places: Where the model has the target, shape (N, 3), [m].
        levers: Of each block.
    """

    places: np.ndarray
    levers: tuple[Lever, ...]

    def shift(self, residual: np.ndarray) -> np.ndarray:
        r"""The smallest shift of the target that explains each row's residual, (N, m) to (N, 3), [m]; NaN where none does.

        .. math:: d = G^+ r

        with G, how the prediction follows the target's position. Of a position that is the error itself; of a distance, as
        much along the wire; of a pixel, its size times distance over focal length, across the line of sight.
        """
        found = np.full(self.places.shape, np.nan)
        for lever in self.levers:
            if np.any(lever.shift):
                found[lever.rows] = np.einsum("nij,nj->ni", lever.shift, residual[lever.rows, lever.part])
        return found

    def noise(self, sigma: np.ndarray) -> tuple[float, float]:
        """What noise of the numbers, shape (m,), is at the target, [m] and [rad] along each axis that the row tells of.

        Returns:
            Medians over the rows, of the block that knows it best; 1 where none does.
        """
        found = []
        for of in ("shift", "turn"):
            sizes = []
            for lever in self.levers:
                own: np.ndarray = getattr(lever, of)
                told = np.linalg.matrix_rank(own)
                if told.any():
                    spread = np.sum((own * sigma[lever.part]) ** 2, axis=(1, 2))[told > 0] / told[told > 0]
                    sizes.append(float(np.sqrt(np.median(spread))))
            found.append(min(sizes, default=1.0))
        return found[0], found[1]


def at_target(fit: Fit, rows: Dataset) -> AtTarget:
    """Look at N rows of any kind from the target.

    Args:
        fit: Where it is.
        rows: What was measured.
    """
    asked = problem(fit.model, rows)
    R, p = fit.model.poses(fit.theta, asked.rows)
    seen = asked.measured
    if seen.direct:
        numbers = slice(0, columns(rows.channels)[-1].stop)
        of_all = _lever(np.arange(len(rows)), numbers, np.eye(6)[None, numbers])
        shift, turn = (np.broadcast_to(own, (len(rows), *own.shape[1:])) for own in (of_all.shift, of_all.turn))
        return AtTarget(p, (replace(of_all, shift=shift, turn=turn),))
    by_twist = seen.settled(fit.theta).slopes(R, p, fit.theta).by_twist
    blocks = [(np.flatnonzero(seen.block == b), part) for b, part in enumerate(seen.parts)]
    return AtTarget(p, tuple(_lever(own, part, by_twist[own, part]) for own, part in blocks))


def _lever(own: np.ndarray, part: slice, by_twist: np.ndarray) -> Lever:
    """That of some rows, from how their numbers follow a twist of the target, shape (n, m, 6)."""
    return Lever(own, part, np.linalg.pinv(by_twist[:, :, :3]), np.linalg.pinv(by_twist[:, :, 3:]))
