r"""Pose and distance characteristics of ISO 9283:1998, where rows repeat poses.

The commanded pose is what a model predicts: of the nominal model the command that a controller without calibration obeys, of
the final model the calibrated one. An attained pose is what was measured. Both are in the axes of the robot's base. With n
cycles j of one pose, attained at p_j with mean p, commanded at c, and with angles a of the attained orientation relative to
the commanded one (components of its rotation vector; to first order the differences of any Euler angles):

.. math::
    AP = |\bar p - c|, \quad AP_x = \bar x - x_c, \quad AP_a = \bar a \qquad (7.2.1)

    RP = \bar l + 3 S_l, \quad l_j = |p_j - \bar p|, \quad S_l^2 = \textstyle\sum (l_j - \bar l)^2 / (n - 1), \quad
    RP_a = 3 S_a \qquad (7.2.2)

    vAP = \max_{h,k} |\bar p_h - \bar p_k| \ \text{of directions of approach h, k} \qquad (7.2.3)

    AD = \bar D - |c_1 - c_2|, \quad D_j = |p_{1j} - p_{2j}| \qquad (7.3.2)

    RD = 3 S_D \qquad (7.3.3)

    dAP = |AP_{t=0} - AP_{t=T}|, \quad dRP = |RP_{t=0} - RP_{t=T}| \qquad (7.6)

Cycles whose readings differ a little, though they repeat one configuration, deviate each from its own command; distances are of
their mean command.

The standard asks for more than repeats: five poses in a stated plane of a stated cube, 30 cycles, rated load and speed. Rows
tell the first two numbers alone, so that these are figures by its definitions.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from aridcal.engine.fit.noise import copies, places
from aridcal.engine.model.model import LabelledFrames
from aridcal.engine.rows.dataset import Dataset

STANDARD = "ISO 9283:1998"

ASKED_CYCLES, ASKED_POSES = 30, 5
"""Drawn: What the standard asks for: cycles of each of the poses P1 to P5 (clause 6)."""

ASKED_HOURS = 8.0
"""Drawn: Duration of the standard's test of drift (7.6)."""

MOST_PAIRED = 20
"""Work: Poses of which all pairs have a distance: of 20 poses 190, where the standard asks for one."""

ENOUGH_CYCLES = 10
"""Cycles at the beginning and at the end between which drift is told, of fewer than 20 cycles half of them: of ten cycles a
repeatability is known to a quarter."""

LEAST_CYCLES = 3
"""Cycles without which no repeatability, no drift and no side of approach is told: of two cycles the distances to their mean are
equal, so that RP has no spread and comes out at 31 % on average."""

ISO_ROTATIONS = ("a", "b", "c")
"""Rotations about the base's x, y and z (ISO 9787)."""

MEANINGS = {
    "AP": ("pose accuracy", "7.2.1"),
    "RP": ("pose repeatability", "7.2.2"),
    "vAP": ("multi-directional pose accuracy variation", "7.2.3"),
    "AD": ("distance accuracy", "7.3.2"),
    "RD": ("distance repeatability", "7.3.3"),
    "dAP": ("drift of pose accuracy", "7.6"),
    "dRP": ("drift of pose repeatability", "7.6"),
}
"""What each symbol is, and its clause; one with an index x y z a b c is a component of it."""

OF_PAIRS = ("AD", "RD")
"""Figures of pairs of poses, not of poses."""

OF_FIT = ("AP", "AD", "dAP")
"""Figures that a fit makes smaller on its own rows: held-out poses judge them, all poses the others."""

Figures = Mapping[str, np.ndarray]
"""By symbol: of P poses or of D pairs, [m], those with index a b c in [rad]; NaN where the rows cannot tell."""


@dataclass(frozen=True)
class Iso9283:
    """What repeats tell of pose and distance characteristics. P poses, D pairs of them.

    Attributes:
        cycles: Rows of each pose in the order of their measurement, P of them: copies and flagged rows are not among them.
        held_out: Poses that were not fitted, shape (P,) bool.
        hours: From the first to the last cycle of each pose; NaN without times, shape (P,).
        pairs: Numbers of the poses of each pair, shape (D, 2).
        copies: Rows left out since they equal another measurement bit for bit.
        flagged: Rows of these poses left out as outliers.
        nominal: With the nominal model as the command.
        final: With the final model as the command.
    """

    cycles: tuple[np.ndarray, ...]
    held_out: np.ndarray
    hours: np.ndarray
    pairs: np.ndarray
    copies: int
    flagged: int
    nominal: Figures
    final: Figures

    @property
    def counts(self) -> np.ndarray:
        """Number of cycles of each pose, shape (P,)."""
        return np.array([len(rows) for rows in self.cycles])

    @property
    def enough(self) -> bool:
        """True if as many cycles of as many poses were made as the standard asks for."""
        return int((self.counts >= ASKED_CYCLES).sum()) >= ASKED_POSES

    def judged(self, symbol: str) -> np.ndarray:
        """Poses, or pairs, that judge by a figure: of those that a fit makes smaller the held-out ones if there are any; bool."""
        every = np.ones(len(self.pairs) if symbol in OF_PAIRS else len(self.cycles), dtype=bool)
        if symbol.partition("_")[0] not in OF_FIT:
            return every
        new = self.held_out[self.pairs].all(axis=1) if symbol in OF_PAIRS else self.held_out
        return new if new.any() else every

    def worst(self, figures: Figures, symbol: str) -> float:
        """Largest size of a figure over the poses that judge by it, or over their pairs; NaN where there is none."""
        sizes = np.abs(figures[symbol][self.judged(symbol)])
        sizes = sizes[~np.isnan(sizes)]
        return float(sizes.max()) if len(sizes) else float("nan")


def applies(rows: Dataset) -> bool:
    """True where every row measures the pose or the position of one target: other kinds attain no pose."""
    return rows.direct


def iso_9283(
    rows: Dataset,
    outlier: np.ndarray,
    nominal: tuple[LabelledFrames, np.ndarray],
    final: tuple[LabelledFrames, np.ndarray],
) -> Iso9283 | None:
    """Evaluate all poses that were attained more than once; None where there is none.

    Args:
        rows: N rows.
        outlier: Flagged rows, shape (N,) bool.
        nominal: T_world_base of the nominal stage, by station where there are several, and what that stage leaves of the
            rows: measured minus predicted in world axes, shape (N, m), [m] and [rad].
        final: Likewise of the final stage.
    """
    if not applies(rows):
        return None
    copied = copies(rows)
    label, usable = places(rows), ~(copied | outlier)
    repeating = rows.sequence[usable[rows.sequence]]
    repeating = repeating[
        np.bincount(label[repeating])[label[repeating]] > 1
    ]  # of a million rows most are alone, and need no array each
    _, first, number, count = np.unique(label[repeating], return_index=True, return_inverse=True, return_counts=True)
    if not len(repeating):
        return None
    together = np.split(repeating[np.argsort(number, kind="stable")], np.cumsum(count)[:-1])
    cycles = tuple(together[k] for k in np.argsort(first))  # in the order of their first cycles
    of_poses = np.isin(label, label[[group[0] for group in cycles]])
    pairs = _pairs(rows, cycles)
    return Iso9283(
        cycles=cycles,
        held_out=np.array([bool(rows.test[group].all()) for group in cycles]),
        hours=np.array([_hours(rows, group) for group in cycles]),
        pairs=pairs,
        copies=int((of_poses & copied).sum()),
        flagged=int((of_poses & outlier & ~copied).sum()),
        nominal=_figures(rows, cycles, pairs, *nominal),
        final=_figures(rows, cycles, pairs, *final),
    )


def _pairs(rows: Dataset, cycles: Sequence[np.ndarray]) -> np.ndarray:
    """Pairs of poses at one station, of many poses of the first of them, shape (D, 2)."""
    first = [group[0] for group in cycles[:MOST_PAIRED]]
    pairs = itertools.combinations(range(len(first)), 2)
    together = [
        p
        for p in pairs
        if rows.labels.station is None or rows.labels.station[first[p[0]]] == rows.labels.station[first[p[1]]]
    ]
    return np.array(together, dtype=int).reshape(-1, 2)


def _hours(rows: Dataset, group: np.ndarray) -> float:
    """Hours from the first to the last of some rows; NaN where one has no time."""
    time = rows.covariates.get("time")
    return float("nan") if time is None else float(np.ptp(time[group]) / 3600.0)


def _figures(
    rows: Dataset, cycles: Sequence[np.ndarray], pairs: np.ndarray, bases: LabelledFrames, residual: np.ndarray
) -> Figures:
    """All figures with one model as the command."""
    some = np.concatenate(cycles)
    label = [None] * len(rows) if rows.labels.station is None else rows.labels.station.tolist()
    frame = dict(bases)
    base = [frame[label[k]] if label[k] in frame else bases[0][1] for k in some]
    command = np.array([b.actInv(p) for b, p in zip(base, rows.position[some] - residual[some, :3], strict=True)])
    turned = np.array([b.rotation.T for b in base])
    off = np.einsum("nij,nkj->nki", turned, residual[some].reshape(len(some), -1, 3))
    ends = np.cumsum([len(group) for group in cycles])[:-1]
    deviations, commands = np.split(off, ends), np.split(command, ends)
    centre = [c.mean(axis=0) for c in commands]
    attained = [c + d[:, 0] for c, d in zip(centre, deviations, strict=True)]
    figures = {symbol: np.full(len(cycles), np.nan) for symbol in _symbols(off.shape[1] > 1)}
    for k, (group, d) in enumerate(zip(cycles, deviations, strict=True)):
        for symbol, value in _of_pose(rows, group, d).items():
            figures[symbol][k] = value
    figures["AD"], figures["RD"] = np.array([
        _of_pair(attained[a], attained[b], centre[a], centre[b]) for a, b in pairs
    ]).reshape(-1, 2).T  # fmt: skip
    return figures


def _symbols(turns: bool) -> list[str]:
    """Symbols of the figures of poses."""
    turning = [f"{symbol}_{axis}" for symbol in ("AP", "RP") for axis in ISO_ROTATIONS] if turns else []
    return ["AP", "AP_x", "AP_y", "AP_z", "RP", *turning, "vAP", "dAP", "dRP"]


def _of_pose(rows: Dataset, group: np.ndarray, off: np.ndarray) -> dict[str, float]:
    """Figures of one pose.

    Args:
        rows: All rows.
        group: Its cycles, n row numbers.
        off: Attained minus commanded, positions and then turns if there are any, shape (n, 1 or 2, 3).
    """
    where = off[:, 0]
    mean = off.mean(axis=0)
    figures = {"AP": accuracy_of(where), **dict(zip(("AP_x", "AP_y", "AP_z"), mean[0].tolist(), strict=True))}
    if off.shape[1] > 1:
        figures |= {f"AP_{axis}": value for axis, value in zip(ISO_ROTATIONS, mean[1].tolist(), strict=True)}
    if len(group) < LEAST_CYCLES:
        return figures
    figures["RP"] = repeatability_of(where)
    if off.shape[1] > 1:
        spread = 3.0 * off[:, 1].std(axis=0, ddof=1)
        figures |= {f"RP_{axis}": value for axis, value in zip(ISO_ROTATIONS, spread.tolist(), strict=True)}
    sides = _directions(rows, group)
    centres = [where[sides == side].mean(axis=0) for side in set(sides.tolist()) - {0}]
    if len(centres) > 1:
        figures["vAP"] = max(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(centres, 2))
    window = min(ENOUGH_CYCLES, len(group) // 2)
    if window >= LEAST_CYCLES and not np.isnan(_hours(rows, group)):
        first, last = where[:window], where[-window:]
        figures["dAP"] = abs(accuracy_of(first) - accuracy_of(last))
        figures["dRP"] = abs(repeatability_of(first) - repeatability_of(last))
    return figures


def accuracy_of(off: np.ndarray) -> float:
    """AP of attained minus commanded positions, shape (n, 3), [m]."""
    return float(np.linalg.norm(off.mean(axis=0)))


def repeatability_of(attained: np.ndarray) -> float:
    """RP of attained positions about any origin, shape (n, 3), [m]."""
    distance = np.linalg.norm(attained - attained.mean(axis=0), axis=1)
    return float(distance.mean() + 3.0 * distance.std(ddof=1))


def _of_pair(
    one: np.ndarray, other: np.ndarray, command: np.ndarray, command_of_other: np.ndarray
) -> tuple[float, float]:
    """AD and RD of two poses, attained at (n, 3) and (m, 3), [m]: of the cycles that both have."""
    n = min(len(one), len(other))
    distance = np.linalg.norm(one[:n] - other[:n], axis=1)
    commanded = np.linalg.norm(command - command_of_other)
    return float(distance.mean() - commanded), float(3.0 * distance.std(ddof=1)) if n >= LEAST_CYCLES else float("nan")


def _directions(rows: Dataset, group: np.ndarray) -> np.ndarray:
    """The side from which each of some rows was approached: equal numbers from 1 on are equal sides, 0 is unknown, shape (n,).

    Sides derived from the order of the rows do not count: rows between them may have been left out.
    """
    names = [f"{name}_direction" for name in rows.names]
    measured = [
        rows.covariates[name][group] for name in names if name in rows.covariates and name not in rows.origin.derived
    ]
    if not measured:
        return np.zeros(len(group), dtype=int)
    columns = np.column_stack(measured)
    label = np.unique(columns, axis=0, return_inverse=True)[1].reshape(-1) + 1
    label[np.isnan(columns).any(axis=1) | ~columns.any(axis=1)] = 0
    few = np.bincount(label)[label] < LEAST_CYCLES
    return np.where(few, 0, label)


def document(iso: Iso9283, rows: Dataset) -> dict[str, Any]:
    """The figures as ``result.json`` has them, [mm] and [mrad]."""

    def shown(figures: Figures, symbols: Sequence[str], k: int) -> dict[str, float]:
        units = {symbol: "mrad" if symbol[-1] in ISO_ROTATIONS else "mm" for symbol in symbols}
        return {f"{symbol}_{units[symbol]}": 1e3 * float(figures[symbol][k]) for symbol in symbols}

    models = {"nominal": iso.nominal, "final": iso.final}
    of_poses = [symbol for symbol in iso.final if symbol not in OF_PAIRS]
    names = [
        {"file": rows.origin.files[rows.origin.file[group[0]]].name, "row": int(rows.origin.line[group[0]])}
        for group in iso.cycles
    ]  # of the first cycle
    return {
        "standard": STANDARD,
        "enough_cycles_and_poses": iso.enough,
        "copies": iso.copies,
        "outliers": iso.flagged,
        "poses": [
            {
                **names[k],
                "cycles": len(group),
                "split": "test" if iso.held_out[k] else "train",
                "hours": iso.hours[k],
            }
            | {model: shown(figures, of_poses, k) for model, figures in models.items()}
            for k, group in enumerate(iso.cycles)
        ],
        "distances": [
            {"between": [names[int(a)], names[int(b)]], "cycles": int(min(iso.counts[[a, b]]))}
            | {model: shown(figures, OF_PAIRS, d) for model, figures in models.items()}
            for d, (a, b) in enumerate(iso.pairs)
        ],
    }
