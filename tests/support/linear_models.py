"""Made-up linear models in which one effect or none is planted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.fit.flags import OUTLIER
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.search.linear_model import LinearModel

SLOTS = (("j1", "axis"), ("j1", "x"), ("j2", "axis"), ("tip_target", "z"))


def made_up(rng: np.random.Generator, n: int = 300, noise: np.ndarray | None = None) -> LinearModel:
    """A made-up linear model of two joints and two columns."""
    table = {name: rng.uniform(-2.0, 2.0, n) for name in ("j1", "j2", "time", "humidity")}
    table["time"] = np.sort(table["time"])
    r = rng.standard_normal((n, 6)) if noise is None else noise
    run = np.arange(n) * 24 // n
    return LinearModel(
        channels=(TARGET_POSITION, TARGET_ROTATION),
        A=rng.standard_normal((n, 6, 4)),
        gauge=1e-6 * np.eye(4),
        G=rng.standard_normal((n, 6, len(SLOTS))),
        slots=SLOTS,
        phi=np.zeros((n, 0)),
        bases=(),
        r=r,
        limit=np.full(n, OUTLIER),
        configuration=np.arange(n),
        thing=None,
        off=None,
        present=np.ones((n, 2), dtype=bool),
        taken_up=np.zeros(2),
        share=1.0,
        run=run,
        fold=rng.integers(0, 5, n),
        joints=("j1", "j2"),
        table=table,
    )


def with_effect(b: LinearModel, slot: int, values: np.ndarray) -> LinearModel:
    return replace(b, r=b.r + b.G[:, :, slot] * values[:, None])


def linear(where: str, component: str, of: str) -> Effect:
    return Effect("thermal", where, (Coefficient(where, component, Basis("linear", (of,), (0.0,))),))
