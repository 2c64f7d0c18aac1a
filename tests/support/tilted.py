"""An arm whose joints give way under a pull that its campaign need not know of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import robots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Payload
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.loop import fit_constants

NOISE = 1e-4
"""[m] and [rad]."""


def measured(
    seed: int, pull: np.ndarray, compliance: float, gears: float = 0.0, tool: float = 0.0, n: int = 120
) -> Dataset:
    """Poses of a UR10 under a pull, its two large joints giving way; errors of gears, and a tool that the URDF does not have."""
    rng = np.random.default_rng(seed)
    truth = robots.simulate(robots.ur10(), n, rng)
    names = truth.model.robot.names
    load = [Coefficient(j, "axis", Basis("linear", (f"{j}.gravity_torque",), (0.0,))) for j in names[1:3]]
    waves = [
        Coefficient(j, "axis", Basis(form, (j,), (k,))) for j in names[:4] for form, k in (("sin", 1.0), ("cos", 2.0))
    ]
    around = replace(
        truth.model.around, gravity=9.81 * pull, loaded=tool > 0.0, payloads=(Payload(np.array([0.0, 0.0, 0.15])),)
    )
    model = replace(truth.model.with_coefficients((*truth.model.coefficients, *load, *waves)), around=around)
    theta = np.concatenate([truth.theta, [compliance] * 2, gears * rng.normal(size=len(waves))])
    q = truth.readings
    R, p = model.poses(theta, model.rows(q, {"payload": np.full(n, tool)} if tool else None))
    return robots.declared(robots.measured(model.robot, q, p + NOISE * rng.normal(size=p.shape), R), NOISE, NOISE)


def geometric(rows: Dataset) -> Fit:
    return fit_constants(robots.campaign("pose").question, robots.ur10(), rows, ()).geometric
