"""What rows tell of the constants: combinations and minimal sets, set beside simulations and fits, and their words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import robots
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.trust import combinations as of_constants
from aridcal.engine.trust.combinations import Combination, Pair, identifiability
from aridcal.engine.trust.halves import PATTERNS
from aridcal.pages.drawing.parts import combination_in_words, constant_in_words, division_in_words, pair_in_words

NOISE = 1e-4


def calibrated(truth: robots.Truth) -> Fit:
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
    return fit_identifiable(truth.data(model, NOISE, NOISE), range(len(model.coefficients)))


def test_sums_and_differences_scatter_from_campaign_to_campaign_as_they_are_said_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Second road: the scatter of the constants of 60 campaigns at the same configurations; less unequal pairs are asked, too."""
    monkeypatch.setattr(of_constants, "PAIR_RATIO", 1.5)
    rng = np.random.default_rng(1)
    truth = robots.simulate(robots.arid(), 40, rng, 1e-3, NOISE)
    exact = truth.model.poses(truth.theta, truth.model.rows(truth.readings))
    found = calibrated(truth)
    told = identifiability(found, truth.measured)
    assert told is not None
    names, values = list(found.model.names), []
    for _ in range(60):
        turn = Rotation.from_rotvec(NOISE * rng.normal(size=(40, 3))).as_matrix()
        place = exact[1] + NOISE * rng.normal(size=(40, 3))
        again = replace(truth, measured=robots.measured(truth.model.robot, truth.readings, place, turn @ exact[0]))
        values.append(fit(again.data(found.model, NOISE, NOISE), found.theta, np.ones(40)).theta)
    every = np.array(values)
    assert told.pairs
    for pair in told.pairs:
        one, other = (every[:, names.index(name)] for name in (pair.first, pair.second))
        assert np.std(one + other) == pytest.approx(pair.of_sum, rel=0.35)  # of 60: 9 % each, and several are asked
        assert np.std(one - other) == pytest.approx(pair.of_difference, rel=0.35)


def test_combinations_are_independent_and_as_sure_as_the_covariance_says() -> None:
    truth = robots.simulate(robots.arid(), 60, np.random.default_rng(3), 1e-3, NOISE)
    found = calibrated(truth)
    told = identifiability(found, truth.measured)
    assert told is not None
    own = [found.model.names.index(name) for name in told.names]
    assert not any(name.startswith(("world_base", "tip_target")) for name in told.names)
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(len(own)), found.covariance[np.ix_(own, own)], 4000)
    total = float(np.sum(draws.var(axis=0)))
    assert sum(c.std**2 for c in told.combinations) == pytest.approx(total, rel=0.1)
    worst = told.combinations[-1]
    shares = np.zeros(len(own))
    for name, share in worst.parts:
        shares[told.names.index(name)] = share
    # Parts too small to be named are left out: what is named still carries the combination.
    assert float((draws @ shares).std()) == pytest.approx(worst.std * float(np.sum(shares**2)), rel=0.25)
    assert all(c.parts[0][1] > 0 and c.parts[0][1] == max(abs(s) for _, s in c.parts) for c in told.combinations)


def test_constants_that_are_nominal_are_spared_and_those_that_are_off_are_not() -> None:
    rng = np.random.default_rng(5)
    truth = robots.simulate(robots.arid(), 100, rng, 0.0, NOISE)
    every = truth.model.names
    off = ["joint_3.x", "joint_4.roll"]
    theta = np.where(np.isin(every, off), 1e-3, 0.0)
    R, p = truth.model.poses(theta, truth.model.rows(truth.readings))
    rows = robots.measured(truth.model.robot, truth.readings, p + NOISE * rng.normal(size=p.shape), R)
    found = calibrated(replace(truth, measured=rows))
    told = identifiability(found, rows)
    assert told is not None
    assert set(off) <= set(told.needed)
    assert len(told.spare) >= 4  # of seven that are nominal; each is kept by chance now and then
    assert told.shift < told.sigma * 2.0
    # Second road: the spare ones really left out.
    keep = [c for c in found.model.coefficients if c.name not in told.spare]
    data = robots.declared(rows, *found.sigma)
    smaller = fit(problem(found.model.with_coefficients(keep), data), weight=np.ones(100))
    asked = problem(found.model, rows)
    before = found.model.poses(found.theta, asked.rows)[1]
    after = smaller.model.poses(smaller.theta, problem(smaller.model, rows).rows)[1]
    assert told.shift == pytest.approx(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1))), rel=0.05)


def test_a_fit_of_frames_alone_knows_of_no_constants() -> None:
    truth = robots.simulate(robots.arid(), 40, np.random.default_rng(6), 0.0, NOISE)
    frames = fit(truth.data(truth.model.with_coefficients(robots.FRAMES)))
    assert identifiability(frames, truth.measured) is None


def test_words() -> None:
    robot = robots.ur10()
    assert constant_in_words("elbow_joint.yaw", robot) == "elbow_joint.yaw"  # it turns about y
    assert constant_in_words("elbow_joint.pitch", robot) == "elbow_joint's zero"
    assert constant_in_words("elbow_joint.theta", robot) == "elbow_joint's zero"
    assert constant_in_words("joint_1.z", robots.arid()) == "joint_1's zero"  # a rail
    assert constant_in_words("joint_1.yaw", robots.arid()) == "joint_1.yaw"
    both = (("elbow_joint.pitch", 0.72), ("wrist_1_joint.pitch", 0.69))
    zeros = "elbow_joint's zero and wrist_1_joint's zero"
    assert combination_in_words(Combination(both, "rad", 1.0), robot) == f"the sum of {zeros}"
    minus = (both[0], (both[1][0], -both[1][1]))
    assert combination_in_words(Combination(minus, "rad", 1.0), robot) == f"the difference of {zeros}"
    assert combination_in_words(Combination(both[:1], "rad", 1.0), robot) == "elbow_joint's zero alone"
    uneven = (both[0], ("elbow_joint.x", -0.36))
    assert combination_in_words(Combination(uneven, "", 1.0), robot) == "elbow_joint's zero − 0.50 elbow_joint.x"
    pair = Pair(both[0][0], both[1][0], "rad", 1e-5, 1.2e-4)
    assert pair_in_words(pair, robot) == (
        f"The sum of {zeros} is known 12 times better than their difference: ± 0.010 mrad against ± 0.12 mrad."
    )
    other = pair_in_words(replace(pair, of_sum=1.2e-4, of_difference=1e-5), robot)
    assert other.startswith(f"The difference of {zeros} is known 12 times better than their sum")


def test_every_division_has_words() -> None:
    for how in PATTERNS:
        assert division_in_words("row", how)
        assert "joint_3" in division_in_words("joint_3", how)
    assert division_in_words("row", "low and high") == "early and late rows"
    assert division_in_words("joint_3", "alternate quarters") == "alternate quarters of joint_3"
