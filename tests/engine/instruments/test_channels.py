"""What a row measures is data: nothing of fit or search knows how many channels there are, or how wide each is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.fit.flags import OUTLIER, QUANTILES, distance, outlier_rows, robust_sigma, usual_norms
from aridcal.engine.fit.normal_equations import accumulate
from aridcal.engine.instruments.channels import (
    TARGET_POSITION,
    TARGET_ROTATION,
    Channel,
    Channels,
    columns,
    flat,
    norms,
    spread,
)
from aridcal.engine.search.evidence import solve
from aridcal.engine.search.linear_model import LinearModel
from aridcal.engine.search.scoring import refine
from aridcal.engine.search.screening import score_all
from aridcal.engine.search.state import activate, solve_state

FORCE = Channel("force", "N", ("f",), "mN", 1e3, "force error")
WIRES = Channel("wire", "m", ("w1", "w2"), "mm", 1e3, "wire error")
TRIOS = [(TARGET_POSITION, TARGET_ROTATION, extra) for extra in (FORCE, WIRES)]
MADE_UP: list[Channels] = [*TRIOS, (WIRES, FORCE), (FORCE,)]

every = pytest.mark.parametrize("channels", MADE_UP, ids=lambda c: "-".join(k.name for k in c))


def sigmas(channels: Channels) -> np.ndarray:
    return np.array([1e-4, 3.0, 0.02])[: len(channels)]


def noise(channels: Channels, n: int, seed: int = 0) -> np.ndarray:
    """Residuals of n rows, written out channel by channel."""
    rng = np.random.default_rng(seed)
    parts = [s * rng.standard_normal((n, len(c.axes))) for s, c in zip(sigmas(channels), channels, strict=True)]
    return np.hstack(parts)


@every
def test_columns_of_the_channels_are_all_columns_once_and_in_order(channels: Channels) -> None:
    width = sum(len(c.axes) for c in channels)
    where = np.concatenate([np.arange(width)[part] for part in columns(channels)])
    np.testing.assert_array_equal(where, np.arange(width))
    assert [part.stop - part.start for part in columns(channels)] == [c.size for c in channels]
    each = spread(np.arange(len(channels)) + 10.0, channels)
    assert each.shape == (width,)
    for k, part in enumerate(columns(channels)):
        assert (each[part] == k + 10.0).all()


@every
def test_norms_are_lengths_row_by_row(channels: Channels) -> None:
    r = noise(channels, 7)
    found = norms(r, channels)
    assert found.shape == (len(channels), 7)
    at = 0
    for own, channel in zip(found, channels, strict=True):
        for length, row in zip(own, r, strict=True):
            assert length == pytest.approx(np.sqrt(sum(x * x for x in row[at : at + channel.size])))
        at += channel.size


def test_a_channel_is_called_by_its_name_and_the_unit_that_people_read() -> None:
    assert [c.key for c in (TARGET_POSITION, TARGET_ROTATION, FORCE)] == ["position_mm", "rotation_mrad", "force_mN"]


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_usual_norms_are_quantiles_of_the_chi_distribution(size: int) -> None:
    np.testing.assert_allclose(usual_norms(size), chi(size).ppf(QUANTILES), rtol=1e-9)


@every
def test_robust_sigma_of_each_channel_is_that_of_its_bulk(channels: Channels) -> None:
    r = noise(channels, 20_000)
    np.testing.assert_allclose(robust_sigma(r, channels), sigmas(channels), rtol=0.03)
    r[:1000] *= 1e3
    assert (robust_sigma(r, channels) < 1.2 * sigmas(channels)).all()


@every
def test_a_row_far_off_in_any_channel_is_flagged_and_no_other(channels: Channels) -> None:
    r, limit = noise(channels, 400, 1), np.full(400, OUTLIER)
    assert not outlier_rows(r, channels, limit).any()
    for k, part in enumerate(columns(channels)):
        r[k] = 0.0
        r[k, part.start] = 8.0 * sigmas(channels)[k]
    assert set(np.flatnonzero(outlier_rows(r, channels, limit))) == set(range(len(channels)))
    np.testing.assert_allclose(distance(r, sigmas(channels), channels)[: len(channels)], 8.0, rtol=1e-12)


@every
def test_noise_and_coefficients_are_those_of_each_channel(channels: Channels) -> None:
    """Second road: all numbers weighed one by one and handed to numpy."""
    rng = np.random.default_rng(2)
    theta = np.array([1.0, -2.0, 0.5])
    width, n = sum(c.size for c in channels), 1500
    J = rng.standard_normal((n, width, 3)) * spread(sigmas(channels), channels)[:, None]
    r = J @ theta + noise(channels, n, 3)
    every_row = np.ones((n, len(channels)), dtype=bool)
    found = solve(
        accumulate(flat(J, channels, every_row), flat(r, channels, every_row)), np.zeros((3, 3)), np.ones(len(channels))
    )
    np.testing.assert_allclose(found.sigma, sigmas(channels), rtol=0.06)
    weight = 1.0 / spread(found.sigma, channels)
    A, b = (J * weight[:, None]).reshape(-1, 3), (r * weight).ravel()
    np.testing.assert_allclose(found.beta, np.linalg.lstsq(A, b, rcond=None)[0], rtol=1e-6)
    assert (np.abs(found.beta - theta) < 5 * np.sqrt(np.diag(found.inverse))).all()


@every
def test_an_effect_is_scored_by_all_that_it_moves(channels: Channels) -> None:
    """Twice the likelihood's gain, each channel's noise profiled, from residual squares of the columns solved in full."""
    rng = np.random.default_rng(4)
    width, n = sum(c.size for c in channels), 400
    scale = spread(sigmas(channels), channels)
    warmth = rng.uniform(-1, 1, n)
    A, G = (rng.standard_normal((n, width, k)) * scale[:, None] for k in (3, 1))
    effect = Effect("thermal", "j1", (Coefficient("j1", "x", Basis("linear", ("warmth",), (0.0,))),))
    model = LinearModel(
        channels=channels,
        A=A,
        gauge=1e-9 * np.eye(3),
        G=G,
        slots=(("j1", "x"),),
        phi=np.zeros((n, 0)),
        bases=(),
        r=noise(channels, n, 5) + 0.6 * G[:, :, 0] * warmth[:, None],
        limit=np.full(n, OUTLIER),
        configuration=np.arange(n),
        thing=None,
        off=None,
        present=np.ones((n, len(channels)), dtype=bool),
        taken_up=np.zeros(len(channels)),
        share=1.0,
        run=np.arange(n) * 24 // n,
        fold=rng.integers(0, 5, n),
        joints=("j1",),
        table={"warmth": warmth},
    )
    state = solve_state(model, (), np.ones(len(channels)), np.ones(n, dtype=bool))
    assert state.used.all()
    rough = score_all(model, [effect], state)[0]
    found = refine(state, effect, rough)

    both = np.concatenate([A, G * warmth[:, None, None]], axis=2)
    r, twice = model.r, 0.0
    for columns_of, sign in ((A, 1.0), (both, -1.0)):
        sigma = sigmas(channels)
        for _ in range(20):  # noise and coefficients in turn
            weight = 1.0 / spread(sigma, channels)
            W = (columns_of * weight[:, None]).reshape(-1, columns_of.shape[2])
            theta = np.linalg.lstsq(W, (r * weight).ravel(), rcond=None)[0]
            left = r - columns_of @ theta
            sigma = np.array([np.sqrt(np.mean(left[:, part] ** 2)) for part in columns(channels)])
        twice += sign * n * sum(2 * c.size * np.log(s) for c, s in zip(channels, sigma, strict=True))
    price = 0.5 * (1.0 + np.log(twice))
    assert found.gain == pytest.approx(0.5 * twice - price, rel=0.02)
    assert rough.gain == pytest.approx(found.gain, rel=0.15)
    active = activate(state, effect, found)
    solution = solve_state(model, (active,), state.solution.sigma, state.used).solution
    np.testing.assert_allclose(solution.beta, theta, rtol=1e-3)
    assert abs(theta[3] - 0.6) < 3 * np.sqrt(solution.inverse[3, 3])
