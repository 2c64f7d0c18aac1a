"""A model and the rows of a data set: residuals, measured minus predicted, and their derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.fit.elimination import Groups, PriorRows, groups, prior_rows, states_after_step
from aridcal.engine.fit.noise import covariance_of_rows
from aridcal.engine.instruments.channels import Channels
from aridcal.engine.instruments.setup import Instruments
from aridcal.engine.model.local import LocalColumns
from aridcal.engine.model.many_rows import ROWS_PER_BLOCK, blocks
from aridcal.engine.model.model import Model, ModelRows
from aridcal.engine.model.predictions import Observations, ThingStates, observations_of, rows_at
from aridcal.engine.rows.dataset import Dataset
from aridcal.system.progress import SILENT, Progress


@dataclass(frozen=True)
class Pieces:
    """A stretch of n rows of m numbers.

    Attributes:
        r: Scaled residuals, shape (n, m); 0 where a row does not measure a channel.
        J: Columns of the coefficients, things held, shape (n, m, K).
        B: Columns of the unknowns of the rows' groups, shape (n, m, U); U = 0 where there are none.
        agreed: Joint positions one step nearer to those at which measurements and model agree, shape (n, joints).
    """

    r: np.ndarray
    J: np.ndarray
    B: np.ndarray
    agreed: np.ndarray


@dataclass(frozen=True)
class Problem:
    """A model with the rows of a data set that it is to predict.

    Attributes:
        data: N rows, m numbers each.
        measured: The rows as the model of K coefficients predicts them: what they read, and of which things.
        groups: Unknowns of things that are solved for beside the coefficients; None where there are none.
        progress: Called with the rows done in each pass over them.
    """

    data: Dataset
    measured: Observations
    groups: Groups | None = None
    progress: Progress = SILENT

    def __len__(self) -> int:
        return len(self.data)

    @property
    def model(self) -> Model:
        """The model that predicts the rows."""
        return self.measured.model

    @property
    def rows(self) -> ModelRows:
        """The rows as the model sees them."""
        return self.measured.rows

    @property
    def states(self) -> ThingStates:
        """Where the things are."""
        return self.measured.states

    @property
    def instruments(self) -> Instruments:
        """All things that the model or the rows refer to."""
        return self.measured.instruments

    @property
    def channels(self) -> Channels:
        """What each row measures."""
        return self.data.channels

    def blocks(self) -> Iterator[slice]:
        """Stretches of rows that are differentiated at a time; each is reported to ``progress``."""
        yield from self.progress.through(blocks(len(self)), len(self), "rows", ROWS_PER_BLOCK)

    def limbs(self, part: slice) -> list[slice | np.ndarray]:
        """Rows of a stretch grouped by the path that they take, as their places in the stretch."""
        if self.rows.route is None:
            return [slice(None)]
        route = self.rows.route[part]
        return [np.flatnonzero(route == path) for path in np.unique(route)]

    def select(self, some: np.ndarray) -> Problem:
        """The problem of some of the rows."""
        groups = None if self.groups is None else self.groups.select(some)
        return replace(self, data=self.data.select(some), measured=self.measured[some], groups=groups)

    def with_states(self, states: ThingStates) -> Problem:
        """The problem with the things at other places."""
        return replace(self, measured=replace(self.measured, states=states))

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Measured minus predicted, shape (N, m); see :meth:`Observations.residual`."""
        return self.measured.residual(theta)

    def scaled_residual(self, theta: np.ndarray) -> np.ndarray:
        """Residuals divided by the rows' relative sigmas, shape (N, m)."""
        return scaled(self.residual(theta), self.data.relative)

    def linearised(self, theta: np.ndarray, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residuals (n, m) of a stretch of rows, and the columns of the coefficients, shape (n, m, K)."""
        pieces = self.pieces(theta, part)
        return pieces.r, pieces.J

    def pieces(self, theta: np.ndarray, part: slice = slice(None)) -> Pieces:
        """Scaled residuals of a stretch of rows, with the columns of coefficients and of things."""
        here, relative = self.measured[part], None if self.data.relative is None else self.data.relative[part]
        if here.direct:
            r, twists = self.of_joints(theta, part)
            J = self.model.of_coefficients(twists, here.rows)
            return Pieces(r, J, np.zeros((*r.shape, 0)), here.rows.positions)
        views = here.sight(theta)
        none = np.zeros((*views.residual.shape, 0))
        B = none if self.groups is None else self.groups.columns(views.by_thing, part)
        r, J, B = (scaled(values, relative) for values in (views.residual, views.by_coefficient, B))
        return Pieces(r, J, B, views.agreed)

    def of_joints(self, theta: np.ndarray, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residuals (n, m) of a stretch of direct rows, and the columns of the model's joints, (n, m, joints)."""
        relative = None if self.data.relative is None else self.data.relative[part]
        r, twists = self.measured[part].of_joints(theta, relative is not None)
        return scaled(r, relative), scaled(twists, relative)

    def carried(self, theta: np.ndarray, covariance: np.ndarray, part: slice) -> np.ndarray:
        """Covariance that the coefficients' covariance, (K, K), gives the predictions of a stretch of rows, scaled, (n, m, m)."""
        local = self.local
        if local is None:
            return covariance_of_rows(self.pieces(theta, part).J, covariance)
        return local.carried(self.of_joints(theta, part)[1], self.rows.phi[part], covariance)

    @property
    def local(self) -> LocalColumns | None:
        """Which coefficients act in few rows, if direct rows are many; None where a column for each coefficient is quicker."""
        return self.model.local if self.measured.direct else None

    def taken(self, weight: np.ndarray) -> np.ndarray:
        """Numbers of each channel that unknown things take up, shape (C,), in the rows whose weight, shape (N,), is not 0."""
        count = np.zeros(len(self.channels))
        if self.groups is None:
            return count
        in_use = (weight > 0.0) & (self.groups.row >= 0)
        sizes = self.groups.unknown.sum(axis=1)
        pair = self.groups.row[in_use] * len(count) + self.data.measures[in_use].argmax(axis=1)
        rows = np.bincount(pair, minlength=len(sizes) * len(count)).reshape(len(sizes), len(count))
        return np.asarray(sizes @ (rows / np.maximum(rows.sum(axis=1, keepdims=True), 1)))

    def group_of(self, part: slice) -> np.ndarray:
        """Group of each of a stretch of rows, -1 for none."""
        return self.groups.row[part] if self.groups is not None else np.full(len(self.rows[part]), -1)

    def beforehand(self) -> PriorRows | None:
        """Prior knowledge of the groups, linearised where their things are; None without groups."""
        return None if self.groups is None else prior_rows(self.groups, self.instruments, self.states)

    def settled(self, theta: np.ndarray) -> Problem:
        """The problem with things that the model does not know put where these rows alone have them."""
        return replace(self, measured=self.measured.settled(theta))

    def stepped(self, step: np.ndarray, agreed: np.ndarray | None = None) -> Problem:
        """The problem after a step of the groups' unknowns, (G, U); differentiated at joint positions (N, joints) if given."""
        states = (
            self.states if self.groups is None else states_after_step(self.states, self.groups, self.instruments, step)
        )
        predictions = replace(self.measured, states=states)
        if agreed is not None:
            predictions = replace(
                predictions, agreed=self._rows_at(agreed) if predictions.wide is not None else predictions.rows
            )
        return replace(self, measured=predictions)

    def _rows_at(self, positions: np.ndarray) -> ModelRows:
        """The rows at other joint positions, shape (N, joints)."""
        return rows_at(self.measured, self.data, positions)

    def agreeing(self, theta: np.ndarray) -> Problem:
        """The problem differentiated where measurements and model agree; see :meth:`Observations.agreeing`."""
        if self.measured.agreed is not None:
            return self
        return replace(self, measured=self.measured.agreeing(theta, self._rows_at))


def problem(model: Model, data: Dataset, progress: Progress = SILENT) -> Problem:
    """The problem of a model and a data set, things where the model has them.

    Raises:
        CovariateNotFound: an effect depends on a column that was not measured.
        MeasurementError: a row's station is none of those that the model knows.
    """
    predictions = observations_of(model, data)
    return Problem(data, predictions, groups(predictions), progress)


def scaled(values: np.ndarray, relative: np.ndarray | None) -> np.ndarray:
    """Residuals or columns, shape (N, m) or (N, m, K), divided by the rows' relative sigmas (see :class:`Dataset`)."""
    if relative is None or not values.size:
        return values
    wide = values.reshape(*values.shape[:2], -1)
    if relative.ndim == 3:
        divided = np.linalg.solve(relative, np.nan_to_num(wide))
        divided[np.isnan(wide)] = np.nan  # channels that a row does not measure
    else:
        divided = wide / relative[:, :, None]
    return np.asarray(divided.reshape(values.shape))


def unscaled(r: np.ndarray, relative: np.ndarray | None) -> np.ndarray:
    """Scaled residuals, shape (N, m), back in [m] and [rad]."""
    if relative is None:
        return r
    if relative.ndim < 3:
        return np.asarray(r * relative)
    stretched = np.einsum("nij,nj->ni", relative, np.nan_to_num(r))
    return np.where(np.isnan(r), np.nan, stretched)
