"""Calibrated robots of which the truth is known, and new rows measured on them, for the tests of check and recalibrate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import robots
from scipy.spatial.transform import Rotation

from aridcal.effects.effect import Coefficient
from aridcal.fit.constants import constants
from aridcal.fit.least_squares import fit_identifiable
from aridcal.fit.stages import recentred
from aridcal.inputs.dataset import Dataset
from aridcal.model.model import Model
from aridcal.result.saved_model import SavedModel, SolvedModel

NOISE = 5e-5
"""[m] and [rad]: of a laser tracker."""


@dataclass(frozen=True)
class Machine:
    """A robot as it is, and as it was calibrated.

    Attributes:
        model: With its true coefficients ``theta``.
        theta: Shape (K,).
        saved: The calibration.
        rng: For all that is drawn of it.
    """

    model: Model
    theta: np.ndarray
    saved: SavedModel
    rng: np.random.Generator

    def configurations(self, n: int) -> np.ndarray:
        """Random readings where it was calibrated, shape (n, columns)."""
        return robots.readings(self.model.robot, n, self.rng, 0.6)

    def measured(self, readings: np.ndarray, offset: np.ndarray | float = 0.0, noise: float = NOISE) -> Dataset:
        """Rows with noise; the joints really stand ``offset`` beside their readings."""
        kind = self.saved.kind
        return measured(self.model, self.theta, readings, readings + offset, noise, self.rng, kind)


def measured(
    model: Model,
    theta: np.ndarray,
    readings: np.ndarray,
    real: np.ndarray,
    noise: float,
    rng: np.random.Generator,
    kind: str,
) -> Dataset:
    """Rows of a true model whose joints really stand at ``real``, and are read as ``readings``; noise declared."""
    R, p = model.poses(theta, model.rows(real))
    p = p + noise * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(noise * rng.normal(size=p.shape)).as_matrix() @ R
    return robots.declared(robots.measured(model.robot, readings, p, R if kind == "pose" else None), NOISE, NOISE)


def machine(
    seed: int, kind: str = "pose", n: int = 100, effects: tuple[tuple[Coefficient, float], ...] = ()
) -> Machine:
    """A UR10 with constants off by 1 mm and 1 mrad, calibrated with n rows.

    Args:
        seed: Of everything.
        kind: ``pose`` or ``position``.
        n: Rows.
        effects: Coefficients that it has besides, with their values.
    """
    rng = np.random.default_rng(seed)
    robot = robots.ur10()
    own = constants(robot, "full")
    frames = ((None, robots.random_placement(rng)),), ((None, robots.random_placement(rng, 0.3)),)
    model = Model(robot, (*robots.FRAMES, *own, *(c for c, _ in effects)), *frames)
    theta = np.concatenate([np.zeros(12), rng.normal(0.0, 1e-3, len(own)), [value for _, value in effects]])
    q = robots.readings(robot, n, rng, 0.6)
    rows = measured(model, theta, q, q, NOISE, rng, kind)
    fit = recentred(fit_identifiable(robots.problem(model, rows), range(len(theta))))
    final = SolvedModel(fit.model, fit.theta, fit.covariance)
    keep = np.flatnonzero([c.basis.constant for c in fit.model.coefficients])
    constant = fit.model.with_coefficients([fit.model.coefficients[k] for k in keep])
    geometric = SolvedModel(constant, fit.theta[keep], fit.covariance[np.ix_(keep, keep)])
    ranges = {name: (float(v.min()), float(v.max())) for name, v in zip(robot.readings, q.T, strict=True)}
    saved = SavedModel(geometric, final, kind, (0.0, 0.0, -9.81), (NOISE, NOISE), ranges, {})
    return Machine(model, theta, saved, rng)


def jump(joint: int, size: float) -> np.ndarray:
    """An offset of one joint of six, shape (6,)."""
    return size * np.eye(6)[joint]


def with_frame(rows: Dataset, rotation: np.ndarray, shift: np.ndarray) -> Dataset:
    """The rows as an instrument sees them that stands elsewhere."""
    turned = None if rows.rotation is None else rotation @ rows.rotation
    return replace(rows, position=rows.position @ rotation.T + shift, rotation=turned)


def table(rows: Dataset, path: Path) -> Path:
    """The rows as a table of measurements in SI."""
    frame = robots.table(robots.Truth(Model(robots.ur10(), ()), np.zeros(0), rows))
    frame.to_csv(path, index=False, float_format="%.17g")
    return path
