"""How far a calibration can be relied on: over the joints' whole range, and over the region that the campaign names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.fit.noise import RepeatScatter
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.tolerance import ToleranceAnswer, excess_error, instrument_noise, no_answer, tolerance_answer
from aridcal.engine.trust.workspace import Knowledge, OpenCombination, Workspace, ends, knowledge, spread_out

SLICE_POOL = 8192
"""Work: Configurations among which those of a slice are looked for."""

SLICE_THICKNESS = 0.06
"""Drawn: Of the reach: half the thickness of a slice. A tenth of all configurations are then in one."""

MOST_SLICE_CONFIGURATIONS = 400
"""Drawn: Configurations of a slice: more would be dots upon dots."""

PLANES = ((0, 2), (0, 1))
"""Axes of the base frame along the slices: a view from the side, and one from above."""


LEAST_REGION_CONFIGURATIONS = 128
"""Configurations, of :data:`aridcal.engine.trust.workspace.WORKSPACE_SAMPLES`, that must be like measured ones to stand for a
range: their share that is within a tolerance is then known to 2 %."""


@dataclass(frozen=True)
class Slice:
    """Configurations that bring the target near a plane.

    Attributes:
        axes: Of the base frame, along the plane.
        at: Where the plane is along the third axis, [m].
        workspace: How well the target is known there.
    """

    axes: tuple[int, int]
    at: float
    workspace: Workspace


@dataclass(frozen=True)
class Certainty:
    """How well the target is known.

    Attributes:
        anywhere: Over the whole range of the joints.
        slices: Over the whole range, near planes through the middle of where the target was measured.
        region: Over the region that the campaign names, or the whole range seen.
        title: What that region is, in words.
        tool: The point on the target that the region is of, in the target's axes, [m].
        tolerances: What the region keeps within: of the position, and of the rotation where that was measured; none where no row
            tells.
        open_combinations: Combinations of constants that no reading tells, and that move the target.
    """

    anywhere: Workspace
    slices: tuple[Slice, ...]
    region: Workspace
    title: str
    tool: tuple[float, float, float]
    tolerances: tuple[ToleranceAnswer, ...]
    open_combinations: tuple[OpenCombination, ...]

    @property
    def within(self) -> bool:
        """False where a tolerance was given, and is not kept."""
        return all(part.within is not False for part in self.tolerances)


@dataclass(frozen=True)
class Requirement:
    """Requirements on the certainty of the target.

    Attributes:
        tool: A point that moves with the target, in its axes, [m].
        tolerance: Error of the place [m] and of the turn [rad] that 95 % of the region may have; None where not stated.
        title: The region in words.
    """

    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tolerance: tuple[float | None, float | None] = (None, None)
    title: str = ""


def certainty(
    wanted: Requirement,
    fit: Fit,
    rows: Dataset,
    candidates: Sequence[Coefficient],
    where: np.ndarray | None,
    outlier: np.ndarray,
    residual: np.ndarray,
    repeats: RepeatScatter | None,
) -> Certainty:
    """Say how well the target is known.

    Args:
        wanted: The point on the target, its region in words, and the tolerance.
        fit: The final model.
        rows: All N rows.
        candidates: All constants that the campaign asks for.
        where: Readings of the region, shape (R, columns), [rad] or [m]; None where the campaign names none.
        outlier: Flagged rows, shape (N,) bool.
        residual: Measured minus predicted of all rows, shape (N, m).
        repeats: Scatter of rows that repeat a configuration, where there are any.
    """
    train = rows.fitted
    known_model = knowledge(fit, train, candidates)
    tool = wanted.tool
    everywhere = spread_out(*ends(train, fit.model.robot.limits))
    anywhere = known_model.over(train, everywhere, _like(train, everywhere))
    title = wanted.title
    if where is None:
        region, title = _measured_region(known_model, train, tool)
    else:
        region = known_model.over(train, where, _like(train, where), tool)
    answers, noise = [], instrument_noise(fit, rows, repeats)
    moves = known_model.columns(region.rows, np.asarray(tool, dtype=float))[1:]
    judging = rows.test if (rows.test & ~outlier).any() else rows.train & ~outlier
    for turn, of in enumerate(("position", "rotation")):
        tolerance = wanted.tolerance[turn]
        measured = rows.sees_turns or not turn
        excess = excess_error(fit, rows, judging, outlier, residual, noise, tool, bool(turn)) if measured else None
        answer = tolerance_answer(known_model, region, moves, excess, tolerance, bool(turn))
        if answer is not None:
            answers.append(answer)
        elif tolerance is not None:
            answers.append(no_answer(of, tolerance))
    slices = _slices(known_model, train)
    if any(tool):
        title += f", for the point {', '.join(f'{1e3 * number:g}' for number in tool)} mm from the target"
    return Certainty(
        anywhere, slices, region, title, tool, tuple(answers), known_model.untold(anywhere.rows, train.sees_turns)
    )


def _like(train: Dataset, readings: np.ndarray) -> np.ndarray:
    """Numbers of fitted rows, drawn at random, whose conditions (all but the joints) stand for configurations, shape (M,)."""
    return np.random.default_rng(0).integers(0, len(train), len(readings))


def _measured_region(known_model: Knowledge, train: Dataset, tool: Sequence[float]) -> tuple[Workspace, str]:
    """The region where the campaign names none, and its title: the measured part of the box of all joint ranges.

    Where that part is next to nothing, as with a ball in three sockets, the region is the measured configurations themselves.
    """
    readings = spread_out(train.readings.min(axis=0), train.readings.max(axis=0))
    box = known_model.over(train, readings, _like(train, readings), tool)
    if box.measured.sum() >= LEAST_REGION_CONFIGURATIONS:
        return box.select(box.measured), "the range that was measured"
    rows = np.unique(np.linspace(0, len(train) - 1, LEAST_REGION_CONFIGURATIONS).round().astype(int))
    return known_model.over(train, train.readings[rows], rows, tool), "the configurations that were measured"


def _slices(known_model: Knowledge, train: Dataset) -> tuple[Slice, ...]:
    """Slices of the whole range of the joints."""
    readings = spread_out(*ends(train, known_model.fit.model.robot.limits), SLICE_POOL)
    like = _like(train, readings)
    cloud = known_model.places(train, readings, like)
    middle = np.median(known_model.places(train, train.readings, np.arange(len(train))), axis=0)
    thick = SLICE_THICKNESS * float(np.ptp(cloud, axis=0).max())
    slices = []
    for axes in PLANES:
        across = 3 - sum(axes)
        near = np.flatnonzero(np.abs(cloud[:, across] - middle[across]) < thick)[:MOST_SLICE_CONFIGURATIONS]
        if len(near):
            slices.append(Slice(axes, float(middle[across]), known_model.over(train, readings[near], like[near])))
    return tuple(slices)


def as_document(certain: Certainty) -> dict[str, Any]:
    """Certainty as plain data: over the joints' whole range, over the region, and what the region keeps within."""
    document: dict[str, Any] = {
        "whole_range": _spread(certain.anywhere),
        "region": {"of": certain.title, **_spread(certain.region)},
    }
    for part in certain.tolerances:
        unit = "mrad" if part.of == "rotation" else "mm"
        document["region"][part.of] = {
            f"bound_{unit}": 1e3 * part.bound,
            f"calibration_rms_{unit}": 1e3 * part.calibration,
            f"beyond_rms_{unit}": 1e3 * part.excess,
            **({} if part.tolerance is None else _judged(part, unit)),
            "remarks": list(part.remarks),
        }
    return document


def _judged(part: ToleranceAnswer, unit: str) -> dict[str, Any]:
    """The answer to a tolerance, and the rows that judge it."""
    return {
        f"tolerance_{unit}": 1e3 * (part.tolerance or 0.0),
        "within": part.within,
        "share": part.share,
        "confidence": part.confidence,
        "rows": {
            "judging": part.judges,
            "count": part.rows,
            "within": part.rows_within,
            "share_at_least": part.rows_share,
        },
        "reasons": list(part.reasons),
    }


def _spread(part: Workspace) -> dict[str, Any]:
    """Statistics of some configurations where the target is known, 1-sigma in the worst direction."""
    sigma = np.where(part.observable, part.sigma, np.nan)
    sigma_mm = 1e3 * sigma[part.observable]
    worst = int(np.nanargmax(sigma)) if len(sigma_mm) else None
    return {
        "configurations": len(part),
        "measured": float(part.measured.mean()),
        "told": float(part.observable.mean()),
        "sigma_mm": {
            "median": float(np.median(sigma_mm)) if len(sigma_mm) else None,
            "p95": float(np.percentile(sigma_mm, 95)) if len(sigma_mm) else None,
            "worst": None if worst is None else 1e3 * float(sigma[worst]),
        },
        "worst_at": None
        if worst is None
        else {"xyz": part.places[worst].tolist(), "direction": part.way[worst].tolist()},
    }
