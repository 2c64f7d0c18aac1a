"""What is asked of a residual: silent on noise, and each question answered by what was planted for it."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
import robots
from scipy.stats import kstest

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.condition_kinds import FEWEST_ROWS_OF_A_SIDE
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.noise import RepeatScatter, declared_notices
from aridcal.engine.fit.problem import problem
from aridcal.engine.instruments.channels import PIXEL
from aridcal.engine.instruments.setup import Block
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.search.noise_tests import (
    SHUFFLES,
    TESTED_STRETCHES,
    Clue,
    ResidualView,
    _change,
    _neighbours,
    _things,
    chance_moments,
    clues,
    stretches,
)
from aridcal.system.progress import SILENT

UNKNOWN = (None, None)


def rows(
    r: np.ndarray, q: np.ndarray, time: np.ndarray | None = None, noise: tuple[float | None, ...] = UNKNOWN
) -> Dataset:
    """Rows of poses or positions that only say where, when and how well they were measured."""
    n, m = r.shape
    names = tuple(f"joint_{k}" for k in range(q.shape[1]))
    covariates = {} if time is None else {"time": time}
    rotation = np.broadcast_to(np.eye(3), (n, 3, 3)) if m == 6 else None
    return dataset(names, ["revolute"] * len(names), q, np.zeros((n, 3)), rotation, sigma=noise, covariates=covariates)


def telling(
    r: np.ndarray,
    q: np.ndarray,
    time: np.ndarray | None = None,
    noise: tuple[float | None, ...] = UNKNOWN,
    repeats: RepeatScatter | None = None,
) -> list[Clue]:
    """What shows structure."""
    return [c for c in clues(rows(r, q, time, noise), r, repeats, 1.0) if c.tells]


def test_chances_of_noise_are_uniform_and_hardly_ever_tell() -> None:
    """Every question to white noise: p-values are spread evenly, which is what makes one of 0.001 rare."""
    chances, told = [], 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        r, q, time = rng.standard_normal((50, 6)), rng.uniform(-1, 1, (50, 4)), rng.permutation(50).astype(float)
        asked = clues(rows(r, q, time, (1.0, 1.0)), r, None, 1.0)
        told += sum(c.tells for c in asked)
        chances.append([c.p_value for c in asked])
    assert np.shape(chances) == (60, 5)
    for values in np.array(chances).T:
        assert kstest(values, "uniform").pvalue > 1e-3
    assert told <= 2  # of 300


def test_chances_that_the_declared_noise_makes_the_residual_are_uniform() -> None:
    chances = []
    for seed in range(300):
        rng = np.random.default_rng(seed)  # so few rows that nothing else is asked
        r, q = rng.standard_normal((16, 6)) * np.repeat([0.1, 3.0], 3), rng.uniform(-1, 1, (16, 4))
        chances.append([c.p_value for c in clues(rows(r, q, noise=(0.1, 3.0)), r, None, 1.0)])
    assert np.shape(chances) == (300, 2)
    for values in np.array(chances).T:
        assert kstest(values, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("columns", [1, 3])
def test_what_chance_makes_of_pairs_is_what_all_orders_make_of_them(columns: int) -> None:
    rng = np.random.default_rng(columns)
    x = 0.4 + rng.standard_normal((6, columns)) ** 3  # neither centred nor normal
    first, second = np.array([[0, 1, 1, 3, 4, 0, 5, 2], [1, 0, 2, 4, 3, 5, 2, 0]])  # some twice, either way round
    every = [np.sum(x[list(order)][first] * x[list(order)][second]) for order in permutations(range(6))]
    assert chance_moments(x, first, second) == pytest.approx((np.mean(every), np.std(every)), rel=1e-9)


def test_rows_that_stand_twice_are_no_neighbours_of_themselves() -> None:
    """Residuals have nothing in common; a quarter of what rows are compared with would be themselves."""
    rng = np.random.default_rng(2)
    readings = np.repeat(rng.standard_normal((500, 3)), 2, axis=0)
    found = _neighbours([ResidualView("so", rng.standard_normal((1000, 2)))], readings)
    assert found.share < 0.05 and found.p_value > 0.01


def test_what_depends_on_the_configuration_makes_neighbours_err_alike() -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, (2000, 2))
    f = np.sin(2 * q[:, :1] + q[:, 1:])
    noise = rng.standard_normal((2000, 6))
    (found,) = telling(noise + f, q)
    variance = np.mean(f**2)
    assert found.share == pytest.approx(variance / (1 + variance), abs=0.04)
    assert telling(noise + rng.permutation(f), q) == []  # the same errors, at other configurations


def test_a_walk_in_time_makes_rows_err_alike_in_the_order_of_time_alone() -> None:
    rng = np.random.default_rng(2)
    walk = np.cumsum(0.3 * rng.standard_normal((300, 6)), axis=0)
    time = rng.permutation(300).astype(float)
    r = walk[time.astype(int)] + rng.standard_normal((300, 6))
    q = rng.uniform(-1, 1, (300, 3))
    found, change = telling(r, q, time)
    assert (found.question, change.question) == ("order", "change")
    assert "in the order of time" in change.what
    variance = np.mean(np.var(walk, axis=0)) + np.mean(walk.mean(axis=0) ** 2)
    assert found.share == pytest.approx(variance / (1 + variance), abs=0.1)
    assert telling(r, q) == []
    there = telling(r[np.argsort(time)], q)  # the order of the table counts where no time was logged
    assert [clue.question for clue in there] == ["order", "change"]


@pytest.mark.parametrize("half", ["position", "rotation"])
def test_a_residual_above_the_declared_noise_tells_how_much_of_it_is_not_noise(half: str) -> None:
    """Positions, or rotations, with twice the noise: only the declaration of that half is contradicted."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-1, 1, (300, 3))
    scale = np.repeat([2.0, 1.0] if half == "position" else [1.0, 2.0], 3)
    r = scale * rng.standard_normal((300, 6))
    (found,) = telling(r, q, noise=(1.0, 1.0))
    assert found.share == pytest.approx(0.75, abs=0.05)
    assert telling(r, q, noise=(None, 1.0) if half == "position" else (1.0, None)) == []
    assert telling(r, q, noise=(2.0, 2.0)) == []  # less than was declared is no structure
    assert len(telling(r[:, :3], q, noise=(1.0, 1.0))) == (half == "position")


def test_repeats_that_scatter_less_than_the_residual_are_the_measure_of_what_is_repeatable() -> None:
    """The scatter of 3 rows about their mean is noise of variance 1; configurations differ by a variance of 4."""
    rng = np.random.default_rng(4)
    group = rng.permutation(np.repeat(np.arange(200), 3))
    noise = rng.standard_normal((600, 3))
    r = noise + 2.0 * rng.standard_normal((200, 3))[group]
    q = rng.uniform(-1, 1, (600, 3))  # neighbours are strangers, so that only the repeats can tell
    (found,) = telling(r, q, repeats=RepeatScatter(200, 600, np.ones(1), np.array([400.0]), 0.0))
    assert found.share == pytest.approx(0.8, abs=0.05)
    assert telling(noise, q, repeats=RepeatScatter(200, 600, np.ones(1), np.array([400.0]), 0.0)) == []


def test_noise_stated_wrongly_is_said_both_ways_and_noise_stated_well_is_not() -> None:
    poses, positions = (rows(np.zeros((5, m)), np.zeros((5, 1)), noise=(1.0, 1.0)) for m in (6, 3))
    assert declared_notices(poses, np.array([1.02, 0.98]), 1000.0) == []
    large, small = declared_notices(poses, np.array([2.0, 0.25]), 1000.0)
    assert "is 2 times" in large and "position" in large and "rotation" not in large and "too small" in large
    assert "is 0.25 times" in small and "rotation" in small and "position" not in small and "too large" in small
    assert len(declared_notices(positions, np.array([2.0]), 1000.0)) == 1
    assert declared_notices(poses, np.array([2.0, 0.5]), 5.0) == []  # five numbers do not tell


@pytest.mark.parametrize("timed", [False, True])
def test_a_jump_is_seen_at_its_row_in_the_order_in_which_it_came(timed: bool) -> None:
    rng = np.random.default_rng(6)
    r, q = rng.standard_normal((240, 6)), rng.uniform(-1, 1, (240, 3))
    late = np.arange(240) >= 90
    r += 1.3 * late[:, None] * [1, -1, 0, 0, 1, 0]
    mixed = rng.permutation(240) if timed else np.arange(240)
    time = np.arange(240.0)[mixed] if timed else None
    found = [c for c in telling(r[mixed], q, time) if c.question == "change"]
    (told,) = found
    at = int(np.flatnonzero(mixed == 90)[0]) + 2
    assert f"and {at}" in told.what or not timed
    if not timed:
        first = int(told.what.split(" and ")[1].split(",")[0])
        assert abs(first - at) <= 3
    between = 3 * 1.3**2 * 0.375 * 0.625  # variance of three of the six numbers
    assert told.share == pytest.approx(between / (6 + between), abs=0.05)
    assert not [c for c in telling(rng.permutation(r), q) if c.question == "change"]


def solved(seed: int, kind: str = "pose", n: int = 150) -> tuple[Fit, Dataset, np.ndarray, np.random.Generator]:
    """A machine with its model, and white residuals of its rows in units of 0.1 mm and 0.1 mrad."""
    rng = np.random.default_rng(seed)
    place = robots.random_placement(rng), robots.random_placement(rng, 0.2)
    truth = robots.simulate(robots.ur10(), n, rng, 1e-3, world=place[0], tip=place[1], kind=kind)
    r = 1e-4 * rng.standard_normal((n, 6 if kind == "pose" else 3))
    found = fit(problem(truth.model, truth.measured), truth.theta)
    return found, truth.measured, r, rng


def asked(found: Fit, rows_: Dataset, r: np.ndarray) -> dict[str, Clue]:
    """What tells, by its question."""
    return {c.question: c for c in clues(rows_, r, None, 1.0, found) if c.tells}


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_a_target_that_slipped_is_seen_in_its_own_axes_alone(kind: str) -> None:
    found, data, r, _ = solved(7, kind)
    R = found.model.poses(found.theta, found.model.rows(data.readings))[0]
    axis = found.model.tip_target[0][1].rotation.T[:, 2]  # of the tip's z, about which the last joint turns
    slip = np.where(np.arange(150) < 75, -1.0, 1.0)[:, None] * 1.5e-4 * axis
    r[:, :3] += np.einsum("nij,nj->ni", R, slip)
    told = asked(found, data, r)
    assert "in the target's axes" in told["change"].what
    assert "in the target's axes" in told["order"].what
    assert not [c for c in clues(data, r, None, 1.0) if c.tells]  # in world axes there is nothing


def test_a_zero_that_jumped_is_seen_as_that_joint_s_motion() -> None:
    found, data, r, _ = solved(8)
    joint = Coefficient("elbow_joint", "axis", Basis("ones", ("elbow_joint",)))
    model = found.model.with_coefficients((*found.model.coefficients, joint))
    twist = model.jacobian(np.append(found.theta, 0.0), model.rows(data.readings))[2][:, :, -1]
    r += np.where(np.arange(150) < 60, -1.0, 1.0)[:, None] * 1e-4 * twist
    told = asked(found, data, r)
    assert "as a motion of elbow_joint" in told["change"].what
    assert "as a motion of elbow_joint" in told["order"].what


def test_asking_in_more_axes_makes_no_more_false_alarms() -> None:
    for seed in range(20):  # one of 200 is allowed
        found, data, r, _ = solved(200 + seed, "pose" if seed % 2 else "position", 60)
        assert not asked(found, data, r)


def of_markers(n: int) -> Dataset:
    """Rows of nine markers in turn."""
    rows = dataset(("a",), ("revolute",), np.linspace(0, 1, n)[:, None], np.full((n, 3), np.nan))
    refers = np.array([("eye", "board", str(k % 9)) for k in range(n)])
    block = Block("pixels", "pixels", (PIXEL,), (None,))
    return replace(rows, blocks=(block,)).with_labels(block=np.zeros(n, dtype=int), refers=refers)


def test_a_marker_at_a_wrong_place_is_named_and_noise_names_none() -> None:
    """Long tails are no marker; by chance one of 1,400 campaigns would name one."""
    rows = of_markers(180)
    tails = [_things(rows, np.random.default_rng(seed).standard_t(4, (180, 2)))[0] for seed in range(170)]
    assert sum(clue.tells for clue in tails) <= 1
    r = np.random.default_rng(0).standard_normal((180, 2))
    r[4::9] *= 2.5
    (found,) = _things(rows, r)
    assert found.tells and "marker 4" in found.what


def test_of_many_rows_stretches_on_end_are_asked_in_the_order_of_measurement() -> None:
    sequence = np.random.default_rng(0).permutation(100_003)
    some = stretches(sequence, 10_000)
    assert len(some) == len(np.unique(some)) == 10_000
    place = np.sort(np.argsort(sequence)[some])
    assert place[0] == 0 and place[-1] == 100_002
    ends = np.flatnonzero(np.diff(place) > 1)
    assert len(ends) == TESTED_STRETCHES - 1
    assert np.diff(place)[ends].max() - np.diff(place)[ends].min() <= 1
    np.testing.assert_array_equal(stretches(sequence[:9_000], 10_000), np.arange(9_000))


def shuffled(views: list[ResidualView]) -> list[list[np.ndarray]]:
    """The same shuffles of the rows, view by view."""
    rng = np.random.default_rng(0)
    orders = [rng.permutation(len(views[0].white)) for _ in range(SHUFFLES)]
    return [[view.white[order] for order in orders] for view in views]


def two_views(n: int) -> list[ResidualView]:
    rng = np.random.default_rng(5)
    wave = 0.3 * np.sin(np.arange(n) / 9.0)[:, None] + np.where(np.arange(n) < n // 3, 0.0, 0.4)[:, None]
    return [ResidualView("so", rng.normal(size=(n, 3))), ResidualView("otherwise", wave + rng.normal(size=(n, 1)))]


def test_a_jump_is_the_largest_step_of_the_mean_as_every_place_by_itself_gives_it() -> None:
    views, n = two_views(300), 300
    rows_ = rows(np.hstack([view.white for view in views])[:, :3], np.zeros((n, 1)))

    def largest(white: np.ndarray) -> tuple[float, int]:
        centred = white - white.mean(axis=0)
        steps = {
            k: float(np.sum(centred[:k].sum(axis=0) ** 2) / (k * (1.0 - k / n)))
            for k in range(FEWEST_ROWS_OF_A_SIDE, n - FEWEST_ROWS_OF_A_SIDE + 1)
        }
        best = max(steps, key=steps.__getitem__)
        return steps[best], best

    seen, at = largest(views[1].white)
    chance = np.array([largest(white)[0] for white in shuffled(views)[1]])
    found = _change(views, rows_, np.arange(n), "", SILENT)
    assert f"between rows {rows_.origin.line[at - 1]} and {rows_.origin.line[at]}," in found.what
    assert found.share == pytest.approx((seen - chance.mean()) / float(np.sum(views[1].white ** 2)), abs=1e-12)
