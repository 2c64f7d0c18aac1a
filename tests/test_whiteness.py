"""What is asked of a residual: silent on noise, and each question answered by what was planted for it."""

from __future__ import annotations

import numpy as np

from aridcal.outcome import Repeats
from aridcal.residual import Sigma
from aridcal.solver import Noise
from aridcal.whiteness import Clue, clues, noise_notice

UNKNOWN = Noise(None, None)


def ask(r: np.ndarray, q: np.ndarray, time: np.ndarray | None = None, noise: Noise = UNKNOWN) -> dict[str, Clue]:
    return {c.what: c for c in clues(r, q, time, None, noise, 1.0)}


def test_noise_tells_nothing():
    told = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-1, 1, (150, 4))
        told += sum(
            c.tells for c in clues(rng.standard_normal((150, 6)), q, np.arange(150.0), None, Noise(1.0, 1.0), 1.0)
        )
    assert told == 0


def test_what_depends_on_the_configuration_makes_neighbours_err_alike():
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, (400, 2))
    r = rng.standard_normal((400, 6)) + np.sin(2 * q[:, :1] + q[:, 1:])
    found = ask(r, q)["rows at neighbouring configurations err alike"]
    assert found.tells
    assert (
        0.5 < found.share / np.mean(np.sin(2 * q[:, 0] + q[:, 1]) ** 2 / (1 + np.sin(2 * q[:, 0] + q[:, 1]) ** 2)) < 1.5
    )


def test_a_walk_in_time_makes_rows_err_alike_in_the_order_of_time_alone():
    rng = np.random.default_rng(2)
    walk = np.cumsum(0.3 * rng.standard_normal((300, 6)), axis=0)
    time = rng.permutation(300).astype(float)
    r = walk[time.astype(int)] + rng.standard_normal((300, 6))
    q = rng.uniform(-1, 1, (300, 3))
    assert ask(r, q, time)["rows measured one after the other err alike"].tells
    assert not ask(r, q)["rows next to each other err alike"].tells


def test_a_residual_above_the_declared_noise_tells_how_much_of_it_is_not_noise():
    rng = np.random.default_rng(3)
    q = rng.uniform(-1, 1, (300, 3))
    r = np.hstack([2.0 * rng.standard_normal((300, 3)), rng.standard_normal((300, 3))])
    found = ask(r, q, noise=Noise(1.0, 1.0))
    position = found["the residual exceeds the declared position noise"]
    assert position.tells
    assert abs(position.share - 0.75) < 0.05
    assert not found["the residual exceeds the declared rotation noise"].tells


def test_repeats_that_scatter_less_than_the_residual_are_the_measure_of_what_is_repeatable():
    rng = np.random.default_rng(4)
    group = np.repeat(np.arange(60), 3)
    r = rng.standard_normal((180, 3)) + 2.0 * rng.standard_normal((60, 3))[group]
    q = rng.uniform(-1, 1, (60, 3))[group]
    own = r - np.array([r[group == g].mean(axis=0) for g in range(60)])[group]
    sigma = Sigma(float(np.sqrt(np.sum(own**2) / (3 * 120))), 1.0)
    found = clues(r, q, None, Repeats(60, 180, sigma, 0.0), UNKNOWN, 1.0)[0]
    assert found.tells
    assert abs(found.share - 0.8) < 0.1


def test_noise_stated_wrongly_is_said_both_ways_and_noise_stated_well_is_not():
    assert noise_notice(Sigma(1.02, 0.98), Noise(1.0, 1.0), 1000.0, True) == []
    large, small = noise_notice(Sigma(2.0, 0.5), Noise(1.0, 1.0), 1000.0, True)
    assert "2.0 times the declared position noise" in large
    assert "1/2.0 of the declared rotation noise" in small
