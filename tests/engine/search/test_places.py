"""What an instrument errs by alike at a place is no effect of the robot, and hides none that is there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from linear_models import made_up
from robots import simulate, table, ur10, write_campaign
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal
from searched import Searched, searched

from aridcal.engine.corrections.place_scatter import place_columns, place_scatter
from aridcal.engine.search import diagnose
from aridcal.engine.search.places import has_scatter, with_scatter
from aridcal.engine.search.state import solve_state

PLACES, EACH, APART, FINE, ALIKE = 30, 3, 4e-3, 2e-5, 1.5e-4


def identified(folder: Path, each: int = EACH, **diagnosis: object) -> Searched:
    """A clean arm at 30 places, several rows each, whose instrument errs alike at a place."""
    rng = np.random.default_rng(11)
    truth = simulate(ur10(), PLACES, rng, kind="position")
    q = np.repeat(truth.readings, each, axis=0) + rng.uniform(-APART, APART, (PLACES * each, 6))
    _, p = truth.model.poses(truth.theta, truth.model.rows(q))
    own = rng.normal(size=(PLACES, 3)).repeat(each, axis=0)
    p = p + ALIKE * own + FINE * rng.normal(size=p.shape)
    names = truth.model.robot.readings
    rows = (
        table(truth)
        .iloc[:0]
        .reindex(range(len(q)))
        .assign(**dict(zip(names, q.T, strict=True)), **dict(zip("xyz", p.T, strict=True)))
    )
    return searched(write_campaign(folder, truth, rows, diagnosis={"enabled": True} | diagnosis))


def test_a_clean_arm_whose_instrument_errs_alike_at_a_place_has_no_effect(tmp_path):
    found = identified(tmp_path)
    assert found.effects == ()
    assert found.verdict != "structure_remains"


def test_of_more_rows_than_are_searched_those_that_are_have_the_places(tmp_path, monkeypatch):
    """The attack: rows beyond those that are searched, whose places are numbered otherwise."""
    monkeypatch.setattr(diagnose, "MOST_SEARCHED_ROWS", 300)  # thousands cost half a minute
    kinds = ["joint_gain", "joint_harmonic", "joint_map"]  # smooth in the joints, as what places share is
    assert identified(tmp_path, each=13, candidates=kinds).effects == ()


def test_the_size_of_the_scatter_is_the_likeliest_of_dense_covariances():
    rng = np.random.default_rng(3)
    place = np.repeat(np.arange(25), 4)
    model = made_up(rng, 100)
    slots = tuple(("world_base", axis) for axis in "xyz")
    shift = rng.normal(scale=0.8, size=(25, 3))[place]
    G = np.zeros((100, 6, 3))
    G[:, range(3), range(3)] = 1.0
    model = replace(model, slots=slots, G=G, r=np.hstack([shift, np.zeros((100, 3))]) + rng.standard_normal((100, 6)))
    (scatter,) = place_scatter(place, shifts=True, turns=False)
    columns = place_columns(place)
    bases = tuple(dict.fromkeys(c.basis for c in scatter.coefficients))
    model = replace(model, bases=bases, phi=np.column_stack([columns[basis.of[0]] for basis in bases]))
    state = solve_state(model, (), np.ones(2), np.ones(100, dtype=bool))
    beside = with_scatter(state, (scatter,))
    assert has_scatter(beside)
    (found,) = (a.score.tau for a in beside.active)
    A = model.A.reshape(600, -1)
    loose = A @ np.linalg.inv(model.gauge) @ A.T
    alike = np.kron(place[:, None] == place, np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
    noise = np.diag(np.tile(np.repeat(beside.solution.sigma**2, 3), 100))

    def against(tau: float) -> float:
        return -float(multivariate_normal(cov=noise + loose + tau**2 * alike).logpdf(model.r.ravel()))

    likeliest = minimize_scalar(against, bounds=(0.1, 3.0), method="bounded").x
    assert found == pytest.approx(
        likeliest, rel=0.15
    )  # amplitudes are tried four a decade of the variance: 0.29 apart at the most
