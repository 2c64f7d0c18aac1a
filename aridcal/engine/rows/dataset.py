"""One data set, from the files to the report: what was measured, row by row, and how well."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from aridcal.engine.corrections.effect import ROW_ORDER
from aridcal.engine.instruments.channels import Channels, columns, spread
from aridcal.engine.instruments.pose import kind_of_places, pose_numbers
from aridcal.engine.instruments.setup import Block, Instruments
from aridcal.engine.robot.chain import JointKind
from aridcal.engine.rows.repeats import blocks, by_appearance, first_alike
from aridcal.engine.rows.row_facts import (
    Labels,
    Origin,
    Repeats,
    labels_together,
    no_labels,
    origins_together,
    selected,
)


@dataclass(frozen=True)
class Dataset:
    """Usable rows in SI, N of them. Made once; a part of it is made by :meth:`select`.

    Rows that were read from files are in an order that depends on what they hold, not on where they stand (see
    :func:`aridcal.engine.rows.repeats.by_content`): sums, and draws of random rows, are then the same whatever the order of
    a table.

    Attributes:
        names: The reading columns, by the names of their joints.
        kinds: Kind of each reading column.
        readings: Joint readings or commands, shape (N, columns), [rad] or [m].
        blocks: Of rows of one kind each.
        observed: What was read, as the kind of the row's block has it, shape (N, W); NaN beyond what it has.
        relative: How the rows' noise differs from the channels' sigmas: relative sigmas of the numbers in world axes,
            shape (N, m), with RMS 1 over the training rows; or factors L, shape (N, m, m), where numbers of a row err
            together, so that the noise is L times independent noise of the channels' sigmas; None where rows are alike.
        covariates: Every other numeric column, shape (N,), NaN in its holes.
        test: Held-out rows, shape (N,) bool: they never fit and never choose.
        labels: Which block, things, station, target and path each row is of.
        repeats: Which rows repeat others.
        origin: Which files and lines rows come from.
        instruments: What is known beforehand of the things that rows refer to.
    """

    names: tuple[str, ...]
    kinds: tuple[JointKind, ...]
    readings: np.ndarray
    blocks: tuple[Block, ...]
    observed: np.ndarray
    relative: np.ndarray | None
    covariates: dict[str, np.ndarray]
    test: np.ndarray
    labels: Labels
    repeats: Repeats
    origin: Origin
    instruments: Instruments = field(default_factory=Instruments)

    def __len__(self) -> int:
        return len(self.readings)

    @property
    def channels(self) -> Channels:
        """What the rows measure, C channels of m numbers in all, block after block."""
        return tuple(channel for block in self.blocks for channel in block.channels)

    @property
    def sigma(self) -> tuple[float | None, ...]:
        """Declared 1-sigma of each channel per axis, in its unit; None where it is to be estimated."""
        return tuple(sigma for block in self.blocks for sigma in block.sigma)

    @property
    def direct(self) -> bool:
        """True where a tracker without faults gives the place of the only target in all rows: nothing else is between."""
        return len(self.blocks) == 1 and self.blocks[0].traits.tracked and not self.instruments.things

    @property
    def position(self) -> np.ndarray:
        """Place of the target in the world frame as rows tell it by themselves, shape (N, 3), [m]; NaN where they do not."""
        return self._placed[0]

    @property
    def rotation(self) -> np.ndarray | None:
        """Rotation of the target in the world frame as rows tell it by themselves, shape (N, 3, 3), or None."""
        return self._placed[1]

    @cached_property
    def _placed(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Positions and rotations of the target, of the kinds that tell them."""
        position, rotation = np.full((len(self), 3), np.nan), None
        for number, block in enumerate(self.blocks):
            rows = slice(None) if len(self.blocks) == 1 else np.flatnonzero(self.labels.block == number)
            place = block.traits.placed
            if place is None or not self.observed.shape[1]:
                continue
            p, R = place(block.traits.numbers(self.observed[rows]), self.beforehand(number, rows))
            if len(self.blocks) == 1:
                return p, R
            position[rows] = p
            if R is not None:
                rotation = np.full((len(self), 3, 3), np.nan) if rotation is None else rotation
                rotation[rows] = R
        return position, rotation

    def beforehand(self, number: int, rows: np.ndarray | slice) -> list[np.ndarray]:
        """States known beforehand of the things of some rows of a block, (n, P) for each role; 0 where a role has no faults."""
        states = []
        for k, role in enumerate(self.blocks[number].traits.roles):
            label, things = self.labels.refers[rows, k], self.instruments.things.get(role.name)
            if things is None:
                states.append(np.zeros((len(label), role.size)))
                continue
            index = {name: at for at, name in enumerate(things.names)}
            states.append(things.start[[index[name] for name in label.tolist()]])
        return states

    @property
    def train(self) -> np.ndarray:
        """Rows that may be fitted, shape (N,) bool."""
        return ~self.test

    @cached_property
    def fitted(self) -> Dataset:
        """The data of the rows that may be fitted: made once, since whatever is fitted to them keeps them."""
        return self.select(self.train)

    @property
    def measures(self) -> np.ndarray:
        """Which channels each row measures, shape (N, C) bool."""
        of_block = np.repeat(np.arange(len(self.blocks)), [len(block.channels) for block in self.blocks])
        return np.asarray(self.labels.block[:, None] == of_block)

    @property
    def sees_turns(self) -> bool:
        """False where the target is a point in all rows: its own turns change nothing that is measured."""
        return any(block.traits.turns for block in self.blocks)

    @property
    def conditions(self) -> dict[str, np.ndarray]:
        """Everything beside the joints that effects depend on: the covariates and the order of the rows."""
        return self.covariates | {ROW_ORDER: self.origin.order}

    @property
    def sequence(self) -> np.ndarray:
        """Numbers of the rows as they were measured: by `time`, or as they stand where not every row has one, shape (N,)."""
        time = self.covariates.get("time")
        if time is None or not np.isfinite(time).all():
            return self.as_read
        return np.argsort(time, kind="stable")

    @property
    def as_read(self) -> np.ndarray:
        """Numbers of the rows as they stand in the files, shape (N,)."""
        return np.lexsort((self.origin.line, self.origin.file))

    @property
    def title(self) -> str:
        """The first file, for messages."""
        return str(self.origin.files[0]) if self.origin.files else "the data"

    def select(self, rows: np.ndarray) -> Dataset:
        """The data of some rows, chosen by a mask or by indices; remarks on the files stay."""
        if isinstance(rows, np.ndarray) and rows.dtype == bool and rows.all():
            return self
        repeats = selected(self.repeats, rows)
        return replace(
            selected(self, rows),
            covariates={name: value[rows] for name, value in self.covariates.items()},
            labels=selected(self.labels, rows),
            repeats=replace(repeats, configuration=by_appearance(repeats.configuration)),
            origin=selected(self.origin, rows),
        )

    def with_labels(self, **changes: Any) -> Dataset:
        """The rows with some of their :class:`Labels` replaced."""
        return replace(self, labels=replace(self.labels, **changes))

    def with_repeats(self, **changes: Any) -> Dataset:
        """The rows with some of their :class:`Repeats` replaced."""
        return replace(self, repeats=replace(self.repeats, **changes))

    def with_origin(self, **changes: Any) -> Dataset:
        """The rows with parts of their :class:`Origin` replaced."""
        return replace(self, origin=replace(self.origin, **changes))

    def declared(self, estimate: np.ndarray) -> np.ndarray:
        """Sigma of each channel, shape (C,): as declared, and the estimate where nothing is declared."""
        return np.array([sigma or estimated for sigma, estimated in zip(self.sigma, estimate, strict=True)])


def joined_datasets(parts: Sequence[Dataset]) -> Dataset:
    """Several blocks of rows of the same joints as one data set, one after the other; without weights.

    Rows repeat a configuration only if they also are of one block, and refer to the same things and the same target.

    Args:
        parts: Data of one block each.
    """
    parts = _named_apart(parts)
    counts, n = [len(part) for part in parts], sum(map(len, parts))
    ends = np.cumsum([0, *counts])
    observed = np.full((n, max(part.observed.shape[1] for part in parts)), np.nan)
    covariates = {name: np.full(n, np.nan) for name in sorted({name for part in parts for name in part.covariates})}
    for part, low, high in zip(parts, ends[:-1], ends[1:], strict=True):
        observed[low:high, : part.observed.shape[1]] = part.observed
        for name, values in part.covariates.items():
            covariates[name][low:high] = values
    labels = Labels(
        block=np.repeat(np.arange(len(parts)), counts),
        refers=np.concatenate([part.labels.refers for part in parts]),
        station=labels_together([part.labels.station for part in parts], counts),
        target=labels_together([part.labels.target for part in parts], counts),
    )
    alike = [labels.block, np.concatenate([part.repeats.configuration for part in parts]), *labels.refers.T]
    if labels.target is not None:
        alike.append(labels.target)
    sha256 = "".join(part.origin.sha256 for part in parts)
    return Dataset(
        names=parts[0].names,
        kinds=parts[0].kinds,
        readings=np.concatenate([part.readings for part in parts]),
        blocks=tuple(part.blocks[0] for part in parts),
        observed=observed,
        relative=None,
        covariates=covariates,
        test=np.concatenate([part.test for part in parts]),
        labels=labels,
        repeats=Repeats(
            configuration=by_appearance(first_alike(alike)),
            stale=np.concatenate([part.repeats.stale for part in parts]),
            doubtful=np.concatenate([part.repeats.doubtful for part in parts]),
        ),
        origin=origins_together(
            [part.origin for part in parts],
            sha256 if len(parts) == 1 else hashlib.sha256(sha256.encode()).hexdigest(),
        ),
    )


def _named_apart(parts: Sequence[Dataset]) -> list[Dataset]:
    """The parts with channels of different names: where two parts share one, it begins with the name of its block."""
    names = Counter(channel.name for part in parts for channel in part.channels)
    renamed = []
    for part in parts:
        (block,) = part.blocks
        channels = tuple(
            replace(c, name=f"{block.name}_{c.name}", noun=f"{c.noun} of {block.name}") if names[c.name] > 1 else c
            for c in part.channels
        )
        renamed.append(replace(part, blocks=(replace(block, channels=channels),)))
    return renamed


@dataclass(frozen=True)
class RowNoise:
    """Noise of the rows beyond the channels' sigmas.

    Attributes:
        std: 1-sigma of each number of the rows in world axes, shape (N, m), or None.
        covariance: Of each row's numbers where they err together, shape (N, m, m), in place of ``std``; or None.
        absolute: True if they state the noise itself, not only how it differs from row to row.
    """

    std: np.ndarray | None = None
    covariance: np.ndarray | None = None
    absolute: bool = False


def dataset(
    names: Sequence[str],
    kinds: Sequence[JointKind],
    readings: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray | None = None,
    *,
    sigma: Sequence[float | None] = (),
    noise: RowNoise | None = None,
    covariates: dict[str, np.ndarray] | None = None,
    station: np.ndarray | None = None,
    test: np.ndarray | None = None,
) -> Dataset:
    """A data set from arrays: rows that come from no file, numbered as if a header stood above them.

    Args:
        names: Joints whose readings these are.
        kinds: Of each.
        readings: Shape (N, columns), [rad] or [m].
        position: Measured target positions in the world frame, shape (N, 3), [m].
        rotation: Measured rotations, shape (N, 3, 3), if there are any.
        sigma: Declared noise of each channel; default: all to be estimated.
        noise: How the rows' noise differs.
        covariates: Columns that effects may depend on, shape (N,) each.
        station: Labels, shape (N,).
        test: Held-out rows, shape (N,); default: none.
    """
    n = len(readings)
    nothing = np.zeros(n, dtype=bool)
    data = Dataset(
        names=tuple(names),
        kinds=tuple(kinds),
        readings=readings,
        blocks=(_tracked(rotation, sigma),),
        observed=pose_numbers(position, rotation),
        relative=None,
        covariates=dict(covariates or {}),
        test=nothing if test is None else test,
        labels=replace(no_labels(n), station=station),
        repeats=Repeats(configuration=blocks(readings, kinds), stale=nothing, doubtful=nothing),
        origin=Origin(
            file=np.zeros(n, dtype=int),
            line=np.arange(n) + 2,
            order=np.arange(n) + 2.0,
            split_given=test is not None,
        ),
    )
    return data if noise is None else weighed(data, noise)


def _tracked(rotation: np.ndarray | None, sigma: Sequence[float | None]) -> Block:
    """A block of poses, or of positions where there are no rotations, with its declared noise as far as that goes."""
    kind = kind_of_places(rotation)
    count = len(kind.channels)
    return Block(kind.name, kind.name, kind.channels, (*sigma, *count * (None,))[:count])


def with_places(data: Dataset, position: np.ndarray, rotation: np.ndarray | None = None) -> Dataset:
    """The rows with other places of the target, (N, 3) and (N, 3, 3), as of a tracker without faults."""
    nothing = no_labels(len(data))
    return replace(
        data,
        blocks=(_tracked(rotation, data.sigma),),
        observed=pose_numbers(position, rotation),
        instruments=Instruments(),
        labels=replace(data.labels, block=nothing.block, refers=nothing.refers),
    )


def weighed(data: Dataset, noise: RowNoise) -> Dataset:
    """The rows with their noise; the split must be final, for the training rows set the scale."""
    if noise.covariance is not None:
        std = np.sqrt(np.diagonal(noise.covariance, axis1=1, axis2=2))
    elif noise.std is not None:
        std = noise.std
    else:
        return replace(data, relative=None)
    typical = _typical(std[data.train], data.channels)
    if noise.covariance is not None:
        relative = factors(noise.covariance, typical, data.channels)
    else:
        relative = std / spread(typical, data.channels)
    data = replace(data, relative=relative)
    return with_sigma(data, typical.tolist()) if noise.absolute else data


def with_sigma(data: Dataset, sigma: Sequence[float | None]) -> Dataset:
    """The same rows with another declared noise of each channel."""
    ends = np.cumsum([0, *(len(block.channels) for block in data.blocks)]).tolist()
    blocks = [
        replace(block, sigma=tuple(sigma[low:high]))
        for block, low, high in zip(data.blocks, ends[:-1], ends[1:], strict=True)
    ]
    return replace(data, blocks=tuple(blocks))


def weighed_apart(data: Dataset, noises: Sequence[RowNoise]) -> Dataset:
    """The rows with the noise of each block's rows; the split must be final."""
    if all(noise.std is None for noise in noises):
        return data
    sigma, ends = [], np.cumsum([0, *(sum(channel.size for channel in block.channels) for block in data.blocks)])
    relative = np.ones((len(data), ends[-1]))
    for number, noise in enumerate(noises):
        rows = data.labels.block == number
        part = weighed(block_data(data, number, rows), noise)
        sigma += list(part.sigma)
        if part.relative is not None:
            relative[rows, ends[number] : ends[number + 1]] = part.relative
    return with_sigma(replace(data, relative=relative), sigma)


def block_data(data: Dataset, number: int, rows: np.ndarray) -> Dataset:
    """The data of some rows of one block, a mask or numbers, with its channels alone and without the rows' own noise."""
    part = data.select(rows)
    block = replace(part.labels, block=np.zeros(len(part), dtype=int))
    return replace(part, blocks=(data.blocks[number],), labels=block, relative=None)


def _typical(std: np.ndarray, channels: Channels) -> np.ndarray:
    """RMS of the rows' sigmas in each channel, shape (C,), from sigmas of shape (N, m); ones where there is no row."""
    if not len(std):
        return np.ones(len(channels))
    return np.array([np.sqrt(np.mean(std[:, part] ** 2)) for part in columns(channels)])


def factors(covariance: np.ndarray, typical: np.ndarray, channels: Channels) -> np.ndarray:
    r"""Factors of the rows' covariances: each row's noise is L times independent noise of the typical sigmas.

    .. math:: L = \begin{pmatrix} chol(C_{pp} - G C_{rp}) & G\, chol(C_{rr}) \\ 0 & chol(C_{rr}) \end{pmatrix}
              diag(s_p, s_r)^{-1}, \qquad G = C_{pr} C_{rr}^{-1}

    for two channels p and r, and so on from the last channel to the first where there are more. The independent noises of a
    channel are those that the channels after it do not explain, so that sigmas can still be estimated apart.

    Args:
        covariance: Of the numbers of the rows, shape (N, m, m), positive definite.
        typical: Typical sigma of each channel, shape (C,).
        channels: C channels of m numbers in all.
    """
    remaining, L = np.array(covariance, dtype=float), np.zeros_like(covariance, dtype=float)
    for part, sigma in reversed(list(zip(columns(channels), typical.tolist(), strict=True))):
        root = np.linalg.cholesky(remaining[:, part, part])
        L[:, part, part] = root / sigma
        before = slice(0, part.start)
        lever = np.linalg.solve(root, remaining[:, part, before]).transpose(0, 2, 1)
        L[:, before, part] = lever / sigma
        remaining[:, before, before] -= lever @ lever.transpose(0, 2, 1)
    return L
