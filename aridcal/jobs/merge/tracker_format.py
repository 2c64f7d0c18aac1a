"""How a tracker's log is written: units and orientation, judged at standstills by the nominal robot, as `aridcal init` does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.robot.chain import Robot
from aridcal.files.measurement_settings import ANGLES, LENGTHS, MeasurementSettings
from aridcal.files.orientations import QUATERNION, normalised, orientation_columns, turned
from aridcal.files.quantities import POSITION_COLUMNS
from aridcal.files.tables import read_tables
from aridcal.jobs.merge.log import Log
from aridcal.jobs.merge.pairs import resolution
from aridcal.jobs.prepare.campaign_proposal import STRANGE_SHARE, propose
from aridcal.jobs.prepare.guesses import Chooser
from aridcal.system.errors import AridcalError, MeasurementError

QUATERNION_NORMS = (0.9, 1.1)
"""Quaternions beyond are none: some programs write four zeros where they know no orientation."""


@dataclass(frozen=True)
class TrackerRows:
    """A tracker's log in SI.

    Attributes:
        log: N samples of which all numbers are there.
        position: Shape (N, 3), [m].
        quaternion: x y z w, norm 1, shape (N, 4); None where there are only positions.
        steps: To what its last digit rounds positions [m] and, where there are any, rotations [rad], shape (3,) or (6,).
        units: Of the joints' readings, one each.
        words: What was found, for people.
    """

    log: Log
    position: np.ndarray
    quaternion: np.ndarray | None
    steps: np.ndarray
    units: tuple[str, ...]
    words: tuple[str, ...]


def tracked(robot: Robot, q: np.ndarray, tracker: Log, rows: np.ndarray, asker: Chooser) -> TrackerRows:
    """Find units and orientation.

    Args:
        robot: The chain.
        q: Readings at K standstills, in the joint log's own units, shape (K, columns).
        tracker: The tracker's log.
        rows: Its sample in the middle of each of these, shape (K,).
        asker: Asked where two ways fit alike.

    Raises:
        AridcalError: nothing fits, or two ways do and nobody says which is meant.
    """
    free = [name for name in tracker.columns if name not in robot.readings]
    columns = {name: q[:, k] for k, name in enumerate(robot.readings)}
    columns |= {name: tracker.of((name,))[rows, 0] for name in free}
    table = read_tables([pd.DataFrame(columns)])
    try:
        proposal = propose(robot.urdf, robot.path, table, asker)
    except MeasurementError as problem:
        raise MeasurementError(str(problem).replace("DataFrame", tracker.title)) from None
    proposed = {guess.key: guess.value for guess in proposal.guesses}
    kind = MEASUREMENT_KINDS.get(proposed.get("measurements.kind", ""))
    if kind is None or not kind.tracked:
        raise MeasurementError(
            f"{tracker.title}: holds no positions of a target; merge joins joints and positions or poses"
        )
    if proposal.fit is None or proposal.fit[1] > STRANGE_SHARE:
        distance = (
            ""
            if proposal.fit is None
            else f" by {1e3 * proposal.fit[0]:.3g} mm, {100 * proposal.fit[1]:.2g} % of their spread"
        )
        raise MeasurementError(
            f"{tracker.title}: at the standstills that fit best in time the nominal robot misses the targets{distance}. "
            "Check that the URDF "
            "is this robot's, each joint's column and sign, that neither tracker nor target was moved, and that "
            "both logs are of one "
            "motion"
        )
    renamed = {
        name: proposed[key]
        for name in (*POSITION_COLUMNS, *QUATERNION)
        if proposed.get(key := f"measurements.columns.{name}")
    }
    settings = MeasurementSettings.model_validate(
        {
            "kind": proposed["measurements.kind"],
            "units": proposed.get("measurements.units") or {},
            "orientation": proposed.get("measurements.orientation") or {},
            "columns": renamed,
        }
    )
    units = tuple(
        settings.units.columns.get(name, settings.units.length if kind == "prismatic" else settings.units.angle)
        for name, kind in zip(robot.readings, robot.kinds, strict=True)
    )
    place = tuple(renamed.get(name, name) for name in POSITION_COLUMNS)
    orientation = orientation_columns(settings)
    required = place if settings.traits.place_alone else (*place, *orientation)
    log = tracker.keep(np.isfinite(tracker.of(required)).all(axis=1), "without an orientation: left out")
    quaternion, steps = None, resolution(log.of(place)) * settings.units.metres
    if settings.traits.oriented:
        finest = float(resolution(log.of(orientation)).max())
        turn = (
            2.0
            if len(orientation) == 4
            else 1.0
            if len(orientation) == 9
            else settings.units.scale(orientation[0], "angle")
        )  # of half angles
        steps = np.r_[steps, np.full(3, turn * finest)]
        log, quaternion = _rotations(log, orientation, settings)
    words = tuple(g.why for g in proposal.guesses if g.key in ("measurements.units", "measurements.orientation"))
    return TrackerRows(log, log.of(place) * settings.units.metres, quaternion, steps, units, words)


def _rotations(log: Log, columns: tuple[str, ...], settings: MeasurementSettings) -> tuple[Log, np.ndarray]:
    """Quaternions of all samples; those that hold none are left out."""
    cells = log.of(columns)
    if len(columns) == 4:
        unit_norm = np.abs(np.linalg.norm(cells, axis=1) - 0.5 * sum(QUATERNION_NORMS)) < 0.5 * (
            QUATERNION_NORMS[1] - QUATERNION_NORMS[0]
        )
        log = log.keep(unit_norm, "whose quaternion has no norm of 1: left out")
        return log, normalised(cells[unit_norm], np.ones(int(unit_norm.sum()), dtype=bool))[0]
    scales = [1.0 if settings.orientation.matrix else settings.units.scale(name, "angle") for name in columns]
    try:
        return log, np.asarray(turned(cells * scales, settings).as_quat())
    except ValueError as problem:
        raise AridcalError(
            f"{log.title}: {' '.join(columns)} are no rotations: {problem}. Mend or delete them"
        ) from None


def in_si(units: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """Readings in [rad] and [m], shape (N, columns)."""
    return np.asarray(values * [{**ANGLES, **LENGTHS}[word] for word in units])
