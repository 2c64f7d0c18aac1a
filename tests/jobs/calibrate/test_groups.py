"""Two groups of rows that differ by one shift: named with their rows, and never made of one noise, whatever its tails."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import robots

from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.search.noise_tests import Clue
from aridcal.jobs.calibrate import groups as of_groups
from aridcal.jobs.calibrate.groups import _likeliest, _white, groups
from aridcal.jobs.calibrate.pipeline import identify

NOISE = 1.5e-4


def fitted(truth: robots.Truth) -> Fit:
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(truth.model.robot, "full")))
    return fit_identifiable(problem(model, truth.measured), range(len(model.coefficients)))


def seated(
    n: int, share: float, size: float, seed: int, of_target: bool = False, kind: str = "position"
) -> tuple[robots.Truth, np.ndarray]:
    """Rows of which some are higher, in the world or in the target's axes."""
    rng = np.random.default_rng(seed)
    truth = robots.simulate(robots.ur10(), n, rng, 1e-3, NOISE, kind=kind)
    odd = rng.random(n) < share
    R, _ = truth.model.poses(truth.theta, truth.model.rows(truth.readings))
    way = R[:, :, 2] if of_target else np.array([0.0, 0.0, 1.0])
    return replace(
        truth, measured=robots.placed(truth.measured, position=truth.measured.position + size * odd[:, None] * way)
    ), odd


def asked(truth: robots.Truth) -> list[Clue]:
    found = fitted(truth)
    return groups(truth.measured, found.residual, found)


@pytest.mark.parametrize(("share", "size"), [(0.08, 0.8e-3), (0.45, 0.7e-3)])
@pytest.mark.parametrize("of_target", [False, True], ids=["world", "target"])
def test_rows_that_were_seated_otherwise_are_told_with_how_many_how_far_and_which_way(
    share: float, size: float, of_target: bool
) -> None:
    truth, odd = seated(250, share, size, 3, of_target)
    (clue,) = asked(truth)
    assert clue.tells
    assert f"in {'the target' if of_target else 'world'}" in clue.what
    count = int(clue.what.split(" of ")[0])
    few = min(odd.sum(), 250 - odd.sum())
    assert abs(count - few) <= 0.15 * few + 1
    told = float(clue.what.split(" rows are ")[1].split(" mm")[0])
    assert told == pytest.approx(1e3 * size, rel=0.2)
    assert " 1.00)" in clue.what or "0.9" in clue.what
    lines = {int(word) for word in clue.what.split("Lines ")[1].split(" and ")[0].split(",")}
    right = set(truth.measured.origin.line[odd if odd.sum() == few else ~odd].tolist())
    assert len(lines & right) >= 0.85 * len(lines)


@pytest.mark.parametrize("noise", ["normal", "t3", "t3 of rows", "even", "grid"])
def test_one_noise_of_any_tails_is_no_two_groups(noise: str) -> None:
    """Of 12 sets of rows, each of which is asked, not one."""
    truth, _ = seated(150, 0.0, 0.0, 5)
    found = fitted(truth)
    false = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        drawn = {
            "normal": lambda rng: rng.standard_normal((150, 3)),
            "t3": lambda rng: rng.standard_t(3, (150, 3)),
            "t3 of rows": lambda rng: rng.standard_normal((150, 3)) / np.sqrt(rng.chisquare(3, (150, 1)) / 3),
            "even": lambda rng: rng.uniform(-1, 1, (150, 3)),
            "grid": lambda rng: np.round(rng.standard_normal((150, 3))),
        }[noise](rng)
        false += any(clue.tells for clue in groups(truth.measured, NOISE * drawn, found))
    assert false == 0


def test_first_draws_alone_end_the_look_only_where_all_would_find_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shifts about as large as can just be told; with all draws each time, the same is said of every one."""
    truth, odd = seated(150, 0.1, 0.0, 5)
    found = fitted(truth)
    rows = [
        np.random.default_rng(seed).standard_normal((150, 3)) * NOISE + np.outer(odd, [0.0, 0.0, size * NOISE])
        for seed in range(3)
        for size in (0.0, 2.0, 2.5, 3.0, 3.5)
    ]
    quick = [groups(truth.measured, r, found) for r in rows]
    monkeypatch.setattr(of_groups, "DOUBT", 2.0)  # no chance is as large
    assert quick == [groups(truth.measured, r, found) for r in rows]
    assert 0 < sum(map(bool, quick)) < len(rows)


def test_the_statistic_is_twice_the_gain_in_likelihood_of_two_normal_densities() -> None:
    """Second road: the densities of k variables, from scipy, with the covariance that is left within the groups."""
    from scipy.stats import multivariate_normal

    rng = np.random.default_rng(1)
    x = rng.standard_normal((200, 3))
    x[:40] += [3.0, -1.0, 2.0]
    x = _white(x)
    found = _likeliest(x[None])
    pi, chance = float(found.chance[0].mean()), found.chance[0]
    delta = chance @ x / (len(x) * pi * (1 - pi))
    within = np.eye(3) - pi * (1 - pi) * np.outer(delta, delta)
    of_few = multivariate_normal((1 - pi) * delta, within).pdf(x)
    of_others = multivariate_normal(-pi * delta, within).pdf(x)
    one = multivariate_normal(np.zeros(3), np.eye(3)).logpdf(x)
    gain = 2.0 * np.sum(np.log(pi * of_few + (1 - pi) * of_others) - one)
    assert found.T[0] == pytest.approx(gain, abs=0.05)


def test_a_campaign_with_some_rows_seated_high_has_structure_left(tmp_path: Path) -> None:
    """With its control: noise as wide, of one group."""
    truth, _ = seated(220, 0.13, 0.7e-3, 11)
    judged = identify(robots.write_campaign(tmp_path, truth)).verdict
    assert judged.word == "structure_remains"
    told = re.search(r"rows are ([\d.]+) mm along \([^)]*\) off the others", judged.reasons[0])
    assert told and float(told[1]) == pytest.approx(0.7, rel=0.2)
    rng = np.random.default_rng(11)
    wide = robots.simulate(robots.ur10(), 220, rng, 1e-3, 2.4e-4, kind="position")
    assert identify(robots.write_campaign(tmp_path, wide)).verdict.word == "noise_floor"
