"""How far the targets of drawn calibrations are from each other: with all they hold, placed by their frames, and put on one spot.

aridcal identify identification/ur10-laser-tracker/campaign-b.yaml
python benchmarks/draws.py identification/ur10-laser-tracker/results
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from aridcal.engine.fit.constants import is_zero, urdf_of
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import chain_in_urdf
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.export.draws import draws
from aridcal.jobs.export.machine import machine
from aridcal.runs.model_export import predicted_rows

DRAWS, ROWS = 60, 50


def spread(places: np.ndarray) -> float:
    """RMS distance from the mean of the draws, [mm], of places (draws, rows, 3)."""
    return 1e3 * float(np.sqrt(np.sum(np.var(places, axis=0), axis=1).mean()))


def main(folder: Path) -> None:
    """Print the three figures, and what `predict` states."""
    saved = SavedModel.load(folder)
    final, described = saved.final, machine(saved)
    inputs = predicted_rows(saved, described, ROWS).inputs
    q, rest = np.split(inputs, [len(described.joints)], axis=1)
    columns = saved.completed({each.name: rest[:, k] for k, each in enumerate(described.conditions)}, ROWS)
    labels = [None if label is None else np.full(ROWS, label) for label in described.frames]
    model, rows = final.model, final.model.rows(q, columns, labels[0], labels[1])
    drawn = draws(final, DRAWS, 0)
    without = drawn.copy()
    effects = [not (c.basis.constant or is_zero(c, model.robot)) for c in model.coefficients]
    without[:, effects] = final.theta[effects]
    spots = []
    for theta in drawn:
        arm = Model(chain_in_urdf(model.robot, urdf_of(model, theta)), ())
        spots.append(arm.poses(np.zeros(0), arm.rows(q))[1])
    stated = 1e3 * float(np.sqrt(np.sum(final.std(q, columns, labels[0], labels[1])[:, :3] ** 2, axis=1).mean()))
    print(f"whole model: {spread(np.array([model.poses(t, rows)[1] for t in drawn])):.3f} mm, stated {stated:.3f}")
    print(f"constants, placed by their frames: {spread(np.array([model.poses(t, rows)[1] for t in without])):.3f} mm")
    print(f"tips of the URDFs, on one spot: {spread(np.array(spots)):.3f} mm")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
