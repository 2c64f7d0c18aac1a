"""What instruments make it easy to claim, attacked: scales out of nothing, effects of metres, steps between two places."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gauges
import numpy as np
import pytest
from searched import searched_rows

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.condition_kinds import FEWEST_ROWS_OF_A_SIDE
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import fit
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.search.change_points import _within_a_place
from aridcal.system.errors import MeasurementError


@pytest.mark.parametrize("blocks", [("heights",), ("points",)])
def test_nothing_is_found_where_nothing_is_wrong_though_the_scale_is_free(
    blocks: tuple[str, ...], tmp_path: Path
) -> None:
    """A model that shrinks the arm leaves less of every row: it must not look as if it explained anything."""
    of = gauges.arm(5)
    made = {"heights": lambda: gauges.heights(of, 150), "points": lambda: gauges.points(of, 3, 25, tied=False)}
    rows = gauges.rows(of, *(made[name]() for name in blocks))
    question = gauges.campaign(tmp_path, of, rows, diagnosis={"enabled": True}).question
    found = searched_rows(question, of.robot, rows)
    assert found.effects == ()
    assert found.verdict == "noise_floor"


@pytest.mark.parametrize("kind", ["heights", "points"])
def test_a_motion_that_can_shrink_the_arm_does_not_shrink_the_noise(kind: str, tmp_path: Path) -> None:
    """Offsets that turn with the first joints bring every target nearer to its plane or point: least squares would take them."""
    of = gauges.arm(5)
    block = gauges.heights(of, 150) if kind == "heights" else gauges.points(of, 3, 25, tied=False)
    data = gauges.rows(of, block)
    campaign = gauges.campaign(tmp_path, of, data)
    geometric = fit_geometry(campaign.question, of.robot, data, ()).geometric
    joints = of.robot.names[:3]
    free = tuple(
        Coefficient(joint, c, Basis(form, (joint,), (1.0,)))
        for joint in joints
        for c in ("t1", "t2")
        for form in ("sin", "cos")
    )
    model = geometric.model.with_coefficients((*geometric.model.coefficients, *free))
    start = np.concatenate([geometric.theta, np.zeros(len(free))])
    wide = fit(problem(model, data), start, prior=Prior(start, np.eye(len(start)) / 0.05**2))
    truth = gauges.NOISE["distance" if kind == "heights" else "position"]
    assert wide.estimated[0] > 0.85 * truth


def test_a_step_is_sought_only_where_one_place_has_rows_on_both_sides() -> None:
    group = np.repeat([0, 1, 2], 20)
    before = np.arange(FEWEST_ROWS_OF_A_SIDE, 60 - FEWEST_ROWS_OF_A_SIDE + 1)
    allowed = before[_within_a_place(np.arange(60.0), group, before)]
    assert not set(allowed) & {20, 40}
    assert set(allowed) == {k for k in before.tolist() if FEWEST_ROWS_OF_A_SIDE <= k % 20 <= 20 - FEWEST_ROWS_OF_A_SIDE}


def test_rows_that_cannot_tell_where_their_things_are_are_refused_by_name(tmp_path: Path) -> None:
    of = gauges.arm(2)
    data = gauges.rows(of, gauges.distances(of, 3, 3))
    with pytest.raises(MeasurementError, match=r"anchor .* cannot tell where it is"):
        fit_geometry(gauges.campaign(tmp_path, of, data).question, of.robot, data, ())


def test_one_marker_seen_once_costs_nothing(tmp_path: Path) -> None:
    """The other rows are fitted as if it were not there."""
    of = gauges.arm(3)
    data = gauges.rows(of, gauges.points(of, 2, 30, tied=False))
    alone = fit_geometry(gauges.campaign(tmp_path, of, data).question, of.robot, data, ()).geometric
    refers = data.labels.refers.copy().astype("U16")
    refers[7, 0] = "lonely"
    things = data.instruments.things["point"]
    more = replace(
        things,
        names=(*things.names, "lonely"),
        start=np.vstack([things.start, np.full((1, 3), np.nan)]),
        free=np.vstack([things.free, np.ones((1, 3), dtype=bool)]),
        std=np.vstack([things.std, np.full((1, 3), np.inf)]),
    )
    instruments = replace(data.instruments, things={"point": more})
    odd = replace(data, instruments=instruments).with_labels(refers=refers)
    with_it = fit_geometry(gauges.campaign(tmp_path, of, odd).question, of.robot, odd, ()).geometric
    assert with_it.model.names == alone.model.names
    assert np.abs((with_it.theta - alone.theta) / alone.std).max() < 1.0
