"""What an effect is worth: the model without it, refitted, is what a fit of that model finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import robots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.trust.gains import refit_coefficients


def test_taking_coefficients_out_agrees_with_fitting_without_them() -> None:
    truth = robots.simulate(robots.ur10(), 150, np.random.default_rng(4), size=1e-3, noise=5e-5)
    waves = tuple(
        Coefficient(joint, "axis", Basis(form, (joint,), (1.0,)))
        for joint in ("shoulder_lift_joint", "elbow_joint")
        for form in ("sin", "cos")
    )
    constants = tuple(c for c in truth.model.coefficients if c.component in ("roll", "x"))
    model = truth.model.with_coefficients((*constants, *waves))
    theta = np.concatenate([np.random.default_rng(0).normal(0, 1e-3, len(constants)), [2e-3, -1e-3, 5e-4, 3e-3]])
    R, p = model.poses(theta, model.rows(truth.readings))
    noise = np.random.default_rng(1).normal(0, 5e-5, p.shape)
    data = robots.measured(model.robot, truth.readings, p + noise, R)
    whole = fit(problem(model, data))
    for gone in (waves[:2], waves[2:], waves, constants[:3]):
        keep = np.array([c not in gone for c in model.coefficients])
        less = model.with_coefficients([c for c, k in zip(model.coefficients, keep, strict=True) if k])
        again = fit(problem(less, data), weight=whole.weight)
        # Both weigh positions and rotations by the noise that the whole model shows.
        fixed = fit(problem(less, robots.declared(data, *whole.sigma)), weight=whole.weight)
        found = refit_coefficients(whole, ~keep, keep)
        assert not found[~keep].any()
        np.testing.assert_allclose(found[keep], fixed.theta, atol=2e-5)
        mine, exact = (
            np.sqrt(np.mean(np.sum(problem(m, data).residual(t)[:, :3] ** 2, axis=1)))
            for m, t in ((model, found), (less, fixed.theta))
        )
        assert mine == pytest.approx(exact, rel=2e-3)
        assert exact > 2 * 5e-5  # what is missing is missed
        assert again.estimated[0] > whole.estimated[0]
    every = np.ones(len(model.coefficients), dtype=bool)
    np.testing.assert_array_equal(refit_coefficients(whole, ~every, every), whole.theta)
    # What is neither gone nor free stays; what several take with them adds up.
    parts = [np.array([c in some for c in model.coefficients]) for some in (waves[:2], waves[2:])]
    free = np.array([c in constants for c in model.coefficients])
    both, *single = (refit_coefficients(whole, gone, free) - whole.theta for gone in (parts[0] | parts[1], *parts))
    np.testing.assert_allclose(both, sum(single), atol=1e-12)
    np.testing.assert_array_equal(single[0][parts[1]], 0.0)


def test_a_model_of_whose_coefficients_only_a_sum_is_told_can_lose_others() -> None:
    """An axis and the rotation of its bearing about it are one motion: the residual without others is that of either alone."""
    truth = robots.simulate(robots.ur10(), 80, np.random.default_rng(4), size=1e-3, noise=5e-5)
    wave = Basis("sin", ("elbow_joint",), (1.0,))
    once, again = (Coefficient("elbow_joint", component, wave) for component in ("axis", "pitch"))
    lost = Coefficient("shoulder_lift_joint", "axis", Basis("cos", ("shoulder_lift_joint",), (1.0,)))
    constants = tuple(c for c in truth.model.coefficients if c.component in ("roll", "x"))
    model = truth.model.with_coefficients((*constants, once, lost))
    theta = np.append(np.random.default_rng(0).normal(0, 1e-3, len(constants)), [2e-3, 1e-3])
    R, p = model.poses(theta, model.rows(truth.readings))
    p = p + np.random.default_rng(1).normal(0, 5e-5, p.shape)
    data = robots.positions_alone(robots.measured(model.robot, truth.readings, p, R))
    found = fit(problem(model, data))
    # Both motions in the model, each with half of what the rows tell of their sum.
    both = model.with_coefficients((*model.coefficients, again))
    halves = np.vstack([np.eye(len(theta)), np.zeros(len(theta))])
    halves[[len(constants), -1], len(constants)] = 0.5
    whole = replace(found, model=both, theta=halves @ found.theta, covariance=halves @ found.covariance @ halves.T)
    left = problem(both, data).residual
    np.testing.assert_allclose(left(whole.theta), problem(model, data).residual(found.theta), atol=1e-9)

    gone = np.array([c == lost for c in both.coefficients])
    less = model.with_coefficients((*constants, once))
    fixed = fit(problem(less, robots.declared(data, *found.sigma)), weight=found.weight)
    exact = problem(less, data).residual(fixed.theta)
    assert np.sqrt(np.mean(exact**2)) > 2 * 5e-5  # what is missing is missed
    np.testing.assert_allclose(left(refit_coefficients(whole, gone, ~gone)), exact, atol=2e-6)  # one Gauss-Newton step
