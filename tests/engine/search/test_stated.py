"""What a campaign declares: taken as it is, whatever the order it is declared in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots import arid, simulate, table, write_campaign
from searched import searched

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient

NOISE = 1e-4


@pytest.mark.parametrize(("rows", "seed"), [(30, 1)])
def test_the_order_in_which_effects_are_declared_changes_nothing(rows: int, seed: int, tmp_path: Path) -> None:
    """A rail that bends under three gears that err by millimetres, few rows: a curve alone may do most of what the gears do."""
    rng = np.random.default_rng(seed)
    truth = simulate(arid(), rows, rng, noise=NOISE, kind="position")
    robot, q = truth.model.robot, truth.readings
    rail, *joints = robot.names
    travel = (rail,), (float(q[:, 0].min() + q[:, 0].max()) / 2, float(np.ptp(q[:, 0])) / 2, 2.0)
    bends = [Coefficient(rail, across, Basis("power", *travel)) for across in ("t1", "t2")]
    waves = [
        Coefficient(j, "axis", Basis(f, (j,), (order,))) for j in joints for order in (1.0, 2.0) for f in ("sin", "cos")
    ]
    values = np.concatenate([truth.theta, [1.5e-3, -1e-3], 3e-3 * rng.standard_normal(len(waves))])
    model = truth.model.with_coefficients((*truth.model.coefficients, *bends, *waves))
    seen = table(truth)
    seen[["x", "y", "z"]] = model.poses(values, model.rows(q))[1] + NOISE * rng.standard_normal((rows, 3))
    wanted = q.min(axis=0) + np.ptp(q, axis=0) * rng.random((200, q.shape[1]))
    bent = [{"kind": "rail_straightness", "where": rail, "motion": across} for across in ("t1", "t2")]
    uneven = [{"kind": "joint_harmonic", "where": joint, "order": [1, 2]} for joint in joints]
    answers = []
    for name, effects in (("first", [*bent, *uneven]), ("last", [*uneven, *bent])):
        (tmp_path / name).mkdir()
        found = searched(write_campaign(tmp_path / name, truth, seen, effects=effects))
        answers.append(found.fit.model.poses(found.fit.theta, found.fit.model.rows(wanted))[1])
        assert not found.arm.diagnosed.barred
    true = model.poses(values, model.rows(wanted))[1]
    apart, off = (np.sqrt(np.mean(np.sum((answers[1] - other) ** 2, axis=1))) for other in (answers[0], true))
    assert apart < 0.1 * NOISE
    assert off < 2 * NOISE  # three axes of rows with noise once, over so few rows
