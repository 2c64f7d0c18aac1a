r"""A fit's rows as one linear problem: what they leave and what takes it off, in sigmas, things solved for on demand.

For whitened residuals r, columns J of the K coefficients and columns B of the unknowns of the rows' things (see
:mod:`aridcal.engine.fit.elimination`), with what is known of those beforehand as further rows T of unit noise, the sums over
some rows are

.. math:: H = J^T J - C^T H_B^{-1} C, \qquad g = J^T r - C^T H_B^{-1} b, \qquad
          H_B = B^T B + T^T T, \quad C = B^T J, \quad b = B^T r + T^T t

All that halves, folds and single rows ask of a fit follows from these without another look at the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.engine.fit.elimination import Elimination, Groups, PriorRows, Sums, solved
from aridcal.engine.fit.least_squares import Fit, thin
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.instruments.channels import Channels, spread
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.progress import SILENT, Progress

MOST_HELD_NUMBERS = 10_000_000
"""Work: Numbers of the largest array that is held, 80 MB: of a model of very many coefficients fewer rows are looked at."""


@dataclass(frozen=True)
class Columns:
    """N rows of m numbers about the solution of a fit, divided by their noise; rows without weight are left out.

    Attributes:
        rows: Numbers of these rows among the fitted ones, shape (N,).
        channels: Channels of the m numbers.
        r: Residuals in sigmas, shape (N, m); 0 where a row does not measure a channel.
        J: What each coefficient takes off the residuals, shape (N, m, K).
        B: What the unknowns of the row's group take off the residuals, shape (N, m, U); U is 0 without things.
        there: Numbers that were measured, shape (N, m) bool.
        group: Group of each row, shape (N,); -1 for none.
        groups: All groups; None where nothing of things is unknown.
        prior: What is known of the unknowns beforehand.
        share: Part of an independent measurement that each row counts for.
        target: How the predicted target moves with each coefficient, shape (N, 3, K), [m] per unit.
    """

    rows: np.ndarray
    channels: Channels
    r: np.ndarray
    J: np.ndarray
    B: np.ndarray
    there: np.ndarray
    group: np.ndarray
    groups: Groups | None
    prior: PriorRows
    share: float
    target: np.ndarray

    def __len__(self) -> int:
        return len(self.r)

    def solved(self, some: np.ndarray | slice = slice(None)) -> Elimination:
        """The things solved from some of the rows alone."""
        count, channels = self.J.shape[2], len(self.channels)
        count_of_groups, width = (0, 0) if self.groups is None else self.groups.unknown.shape
        sums = Sums(
            np.zeros((channels, count_of_groups, width, width)),
            np.zeros((channels, count_of_groups, width, count)),
            np.zeros((channels, count_of_groups, width)),
        )
        if self.groups is None:
            empty = np.zeros((0, 0, 0))
            return Elimination(np.zeros((0, 0, count)), np.zeros((0, 0)), empty, 0.0, np.zeros(0))
        sums.add(self.group[some], self.B[some], self.J[some], self.r[some], self.channels)
        return solved(sums, self.groups, self.prior, np.ones(channels))

    def equations(self, things: Elimination, some: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """H (K, K) and g (K,) of some of the rows, their things solved for as :meth:`solved` has it for the same rows."""
        J, group = self.J[some], self.group[some]
        residuals, _ = self.less(self.r[some, :, None], self.prior.misfit[:, None], things, some)
        without_things = J
        if self.groups is not None:
            without_things = J.copy()
            of_things = group >= 0
            without_things[of_things] -= self.B[some][of_things] @ things.X[group[of_things]]
        flat = J.reshape(-1, J.shape[2])
        return flat.T @ without_things.reshape(flat.shape), flat.T @ residuals.ravel()

    def less(
        self, values: np.ndarray, known: np.ndarray, things: Elimination, some: np.ndarray | slice = slice(None)
    ) -> tuple[np.ndarray, np.ndarray]:
        """Right-hand sides less what the things take up of them.

        Args:
            values: Residuals in sigmas of n rows, or other right-hand sides of these, shape (n, m, d).
            known: The same of what is known beforehand, shape (T, d).
            things: The things, solved from the same rows.
            some: The n rows.
        """
        if self.groups is None:
            return values, known
        group, B = self.group[some], self.B[some]
        grouped = group >= 0
        pull = np.zeros((len(things.inverse), B.shape[2], values.shape[2]))
        np.add.at(pull, group[grouped], B[grouped].transpose(0, 2, 1) @ values[grouped])
        np.add.at(pull, self.prior.group, self.prior.by[:, :, None] * known[:, None, :])
        y = things.inverse @ pull
        rest = values.copy()
        rest[grouped] -= B[grouped] @ y[group[grouped]]
        return rest, known - np.einsum("tu,tud->td", self.prior.by, y[self.prior.group])


def _linearised_rows(fit: Fit, data: Dataset, most: int, progress: Progress) -> tuple[np.ndarray, Problem]:
    """Numbers of the rows that are linearised, and their problem: bases of all other rows would take much memory."""
    model = fit.model.with_coefficients(()) if data.direct else fit.model
    whole = problem(model, data, progress)  # where things are between, all rows tell of these
    chosen = thin(whole.rows, most, whole.groups)
    chosen = chosen[fit.weight[chosen] > 0.0]
    part = whole if len(chosen) == len(whole) else whole.select(chosen)
    return chosen, (problem(fit.model, part.data, progress) if data.direct else part).agreeing(fit.theta)


def columns_of(fit: Fit, data: Dataset, sigma: np.ndarray, most: int, progress: Progress = SILENT) -> Columns:
    """Linearise a fit about its solution.

    Args:
        fit: K coefficients.
        data: The rows that it was fitted to.
        sigma: Noise that whitens each channel, shape (C,).
        most: Rows at the most: of more, a reproducible choice.
        progress: Told how far the pass over them is.
    """
    wide = sum(channel.size for channel in data.channels) * max(len(fit.theta), 1)
    chosen, fit_problem = _linearised_rows(fit, data, min(most, MOST_HELD_NUMBERS // wide), progress)
    per = 1.0 / spread(sigma, fit_problem.channels)
    root = np.sqrt(fit.weight[chosen] * data.repeats.share)[:, None] * per
    shape, count = root.shape, len(fit.theta)
    # Row by row in memory, for rows are what is picked out of them.
    r, J, B = np.empty(shape), np.empty((*shape, count)), np.empty((*shape, 0))
    target = np.empty((len(chosen), 3, count))
    if fit_problem.groups is not None:
        B = np.empty((*shape, fit_problem.groups.unknown.shape[1]))
    for block in fit_problem.blocks():
        piece = fit_problem.pieces(fit.theta, block)
        r[block] = np.nan_to_num(piece.r) * root[block]
        for into, columns in ((J, piece.J), (B, piece.B)):
            np.multiply(columns, root[block, :, None], out=into[block])
        if fit_problem.measured.direct and data.relative is None:
            target[block] = piece.J[:, :3]  # the target's own position is what rows measure first
        else:
            target[block] = fit.model.jacobian(fit.theta, fit_problem.rows[block])[2][:, :3]
    measured = ~fit_problem.measured.absent
    nothing = PriorRows(np.zeros(0, dtype=int), np.zeros((0, B.shape[2])), np.zeros(0))
    return Columns(
        rows=chosen,
        channels=fit_problem.channels,
        r=r,
        J=J,
        B=B,
        there=measured,
        group=fit_problem.group_of(slice(None)),
        groups=fit_problem.groups,
        prior=fit_problem.beforehand() or nothing,
        share=data.repeats.share,
        target=target,
    )
