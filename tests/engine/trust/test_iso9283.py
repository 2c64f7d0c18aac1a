"""ISO 9283: every figure is that of a second evaluation, cycle by cycle from the definitions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import robots
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.pose import residuals
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.iso9283 import ASKED_CYCLES, ASKED_POSES, Iso9283, document, iso_9283, repeatability_of

POSES, CYCLES, PERIOD = 6, 30, 100.0
SIDES = ("shoulder_pan_joint_direction", "elbow_joint_direction")
EXACT = {"rel": 0, "abs": 1e-12}
"""[m] and [rad]: a thousandth of what the figures must agree to, 1e-9."""


class Bench:
    """A UR10 that drives to its poses in turn, with constants off, noise, backlash, drift; its rows in random order.

    Attributes:
        rows: What was measured.
        bases: T_world_base of the nominal model and of the calibrated one.
        commands: Poses that each of them predicts for each row: rotations (N, 3, 3) and positions (N, 3).
        found: What is claimed of it.
    """

    def __init__(self, seed: int = 0, kind: str = "pose", cycles: int = CYCLES) -> None:
        rng = np.random.default_rng(seed)
        truth = robots.simulate(robots.ur10(), POSES, rng, world=robots.random_placement(rng), kind="pose")
        q = np.tile(truth.readings, (cycles, 1))
        number = np.arange(len(q)) // POSES
        sides = {name: np.where(number % 2 == k % 2, 1.0, -1.0) for k, name in enumerate(SIDES)}
        calibrated, nominal = truth.theta, np.zeros(len(truth.theta))
        self.bases = [truth.model.frames(theta)[0] for theta in (nominal, calibrated)]
        self.commands = [truth.model.poses(theta, truth.model.rows(q)) for theta in (nominal, calibrated)]
        R, p = self.commands[1]
        p = p + 2e-5 * rng.normal(size=p.shape) + 1e-4 * sides[SIDES[0]][:, None] * [0.3, -1.0, 0.2]
        p = p + 1e-6 * number[:, None]
        R = Rotation.from_rotvec(3e-5 * rng.normal(size=p.shape) + [1e-4, 0.0, -2e-4]).as_matrix() @ R
        rows = robots.measured(truth.model.robot, q, p, R if kind == "pose" else None)
        held_out = np.isin(rows.repeats.configuration, [1, 4])
        rows = replace(rows, test=held_out, covariates={"time": PERIOD * np.arange(len(q))} | sides)
        mixed = rng.permutation(len(q))
        self.rows = rows.select(mixed)
        self.commands = [(R[mixed], p[mixed]) for R, p in self.commands]
        self.found = self.evaluated(self.rows)

    def evaluated(self, rows: Dataset, outlier: np.ndarray | None = None) -> Iso9283:
        left = [residuals(R, p, rows.position, rows.rotation) for R, p in self.commands]
        flagged = np.zeros(len(rows), dtype=bool) if outlier is None else outlier
        found = iso_9283(rows, flagged, (self.bases[0], left[0]), (self.bases[1], left[1]))
        assert found is not None
        return found

    def by_hand(self, model: int) -> dict[str, list[float]]:
        """The figures of all poses, one cycle and one number at a time."""
        base: pin.SE3 = self.bases[model][0][1]
        R_command, p_command = self.commands[model]
        figures: dict[str, list[float]] = {}
        attained: list[list[list[float]]] = []
        commanded: list[list[float]] = []
        time = self.rows.covariates["time"]
        order = sorted(range(len(self.rows)), key=lambda k: time[k])
        turns_known = self.rows.rotation is not None
        for first in order[:POSES]:
            cycles = [k for k in order if np.array_equal(self.rows.readings[k], self.rows.readings[first])]
            points = [list(base.inverse() * self.rows.position[k]) for k in cycles]
            c = list(base.inverse() * p_command[first])
            attained.append(points)
            commanded.append(c)
            centre = [mean([p[i] for p in points]) for i in range(3)]
            one = {"AP": math.dist(centre, c)}
            one |= {f"AP_{axis}": centre[i] - c[i] for i, axis in enumerate("xyz")}
            one["RP"] = scatter(points)
            if turns_known:
                turns = []
                for k in cycles:
                    own = base.rotation.T @ self.rows.rotation[k]
                    asked = base.rotation.T @ R_command[k]
                    turns.append((Rotation.from_matrix(own) * Rotation.from_matrix(asked).inv()).as_rotvec())
                for i, axis in enumerate("abc"):
                    angles = [float(turn[i]) for turn in turns]
                    one[f"AP_{axis}"] = mean(angles)
                    one[f"RP_{axis}"] = 3 * deviation(angles)
            sides = [[p for p, k in zip(points, cycles, strict=True) if self.side(k) == s] for s in (-1.0, 1.0)]
            ends = [[mean([p[i] for p in some]) for i in range(3)] for some in sides]
            one["vAP"] = math.dist(*ends)
            for symbol, figure in (("dAP", lambda some: off(some, c)), ("dRP", scatter)):  # noqa: B023
                one[symbol] = abs(figure(points[:10]) - figure(points[-10:]))
            for symbol, value in one.items():
                figures.setdefault(symbol, []).append(value)
        figures |= {"AD": [], "RD": []}
        for a in range(POSES):
            for b in range(a + 1, POSES):
                distances = [math.dist(p, q) for p, q in zip(attained[a], attained[b], strict=True)]
                figures["AD"].append(mean(distances) - math.dist(commanded[a], commanded[b]))
                figures["RD"].append(3 * deviation(distances))
        return figures

    def side(self, row: int) -> float:
        return float(self.rows.covariates[SIDES[0]][row])


def mean(values: list[float]) -> float:
    return math.fsum(values) / len(values)


def deviation(values: list[float]) -> float:
    return math.sqrt(math.fsum((v - mean(values)) ** 2 for v in values) / (len(values) - 1))


def scatter(points: list[list[float]]) -> float:
    centre = [mean([p[i] for p in points]) for i in range(3)]
    distances = [math.dist(p, centre) for p in points]
    return mean(distances) + 3 * deviation(distances)


def off(points: list[list[float]], command: list[float]) -> float:
    return math.dist([mean([p[i] for p in points]) for i in range(3)], command)


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_every_figure_is_that_of_an_evaluation_by_hand(kind: str) -> None:
    bench = Bench(kind=kind)
    for model, figures in enumerate((bench.found.nominal, bench.found.final)):
        expected = bench.by_hand(model)
        assert set(figures) == set(expected)
        for symbol, values in expected.items():
            assert figures[symbol].tolist() == pytest.approx(values, **EXACT), symbol
            assert np.ptp(values) > 1e-8, f"{symbol} is alike everywhere: the test would not see a mistake"


def test_calibration_lowers_accuracies_and_leaves_repeatabilities() -> None:
    found = Bench().found
    assert found.worst(found.final, "AP") < 0.1 * found.worst(found.nominal, "AP")
    assert found.worst(found.final, "AD") < 0.1 * found.worst(found.nominal, "AD")
    assert found.final["RP"] == pytest.approx(found.nominal["RP"], **EXACT)


def test_poses_that_were_held_out_judge() -> None:
    found = Bench().found
    assert found.counts.tolist() == [CYCLES] * POSES
    assert np.flatnonzero(found.held_out).tolist() == [1, 4]
    assert found.worst(found.nominal, "AP") == max(found.nominal["AP"][[1, 4]])
    (own,) = np.flatnonzero((found.pairs == [1, 4]).all(axis=1))
    assert found.worst(found.nominal, "AD") == abs(found.nominal["AD"][own])
    for symbol in ("RP", "RP_a", "RD", "vAP", "dRP"):  # no fit makes these smaller
        assert found.worst(found.nominal, symbol) == max(found.nominal[symbol]), symbol


def test_cycles_that_are_not_quite_repeated_deviate_each_from_its_own_command() -> None:
    """Readings of encoders differ by less than what counts as one configuration; taken for one command they would be errors."""
    rng = np.random.default_rng(1)
    truth = robots.simulate(robots.ur10(), POSES, rng)
    q = np.tile(truth.readings, (5, 1)) + 1e-4 * rng.uniform(-1, 1, (5 * POSES, 6))
    R, p = truth.model.poses(truth.theta, truth.model.rows(q))
    noise = 1e-6 * rng.normal(size=p.shape)
    rows = robots.measured(truth.model.robot, q, p + noise, R)
    left, frames = residuals(R, p, rows.position, rows.rotation), truth.model.frames(truth.theta)[0]
    found = iso_9283(rows, np.zeros(len(rows), dtype=bool), (frames, left), (frames, left))
    assert found is not None
    for k in range(POSES):
        own = [[float(v) for v in noise[row]] for row in range(k, 5 * POSES, POSES)]
        assert found.final["AP"][k] == pytest.approx(off(own, [0.0, 0.0, 0.0]), abs=1e-9)
        assert found.final["RP"][k] == pytest.approx(scatter(own), abs=1e-9)


def test_a_pose_of_which_any_cycle_was_fitted_is_not_held_out() -> None:
    bench = Bench()
    test = bench.rows.test.copy()
    test[bench.found.cycles[1][7]] = False
    found = bench.evaluated(replace(bench.rows, test=test))
    assert np.flatnonzero(found.held_out).tolist() == [4]


def test_without_held_out_poses_all_judge() -> None:
    bench = Bench()
    found = bench.evaluated(replace(bench.rows, test=np.zeros(len(bench.rows), dtype=bool)))
    assert found.worst(found.nominal, "AP") == max(found.nominal["AP"])
    assert found.worst(found.nominal, "AD") == max(abs(found.nominal["AD"]))
    alone = bench.evaluated(replace(bench.rows, test=bench.rows.repeats.configuration == 0))
    assert alone.worst(alone.nominal, "AD") == found.worst(found.nominal, "AD")  # one pose has no distance


def test_figures_do_not_depend_on_the_instruments_axes() -> None:
    bench, T = Bench(), robots.random_placement(np.random.default_rng(3))
    before = bench.found
    bench.bases = [((None, T * bases[0][1]),) for bases in bench.bases]
    bench.commands = [(T.rotation @ R, np.array([T * point for point in p])) for R, p in bench.commands]
    moved = np.array([T * point for point in bench.rows.position])
    after = bench.evaluated(robots.placed(bench.rows, position=moved, rotation=T.rotation @ bench.rows.rotation))
    for symbol, values in before.final.items():
        assert after.final[symbol] == pytest.approx(values, **EXACT), symbol


@pytest.mark.parametrize(("cycles", "poses", "enough"), [(30, 5, True), (29, 5, False), (30, 4, False)])
def test_fewer_cycles_or_poses_than_the_standard_asks_for_are_told(cycles: int, poses: int, enough: bool) -> None:
    assert (ASKED_CYCLES, ASKED_POSES) == (30, 5)
    bench = Bench(cycles=cycles)
    used = np.isin(bench.rows.repeats.configuration, np.arange(poses))
    bench.commands = [(R[used], p[used]) for R, p in bench.commands]
    assert bench.evaluated(bench.rows.select(used)).enough is enough


@pytest.mark.parametrize(("cycles", "share"), [(2, 0.31), (3, 0.72), (5, 0.85), (10, 0.93)])
def test_a_repeatability_of_few_cycles_is_too_small_by_what_is_said(cycles: int, share: float) -> None:
    rng = np.random.default_rng(0)
    radius = np.linalg.norm(rng.normal(size=(200_000, 3)), axis=1)
    found = [repeatability_of(rng.normal(size=(cycles, 3))) for _ in range(3000)]
    assert np.mean(found) / (radius.mean() + 3 * radius.std()) == pytest.approx(share, abs=0.015)


def test_two_cycles_tell_no_repeatability() -> None:
    bench = Bench(cycles=2)
    for symbol in ("RP", "RP_a", "RD", "dAP", "dRP", "vAP"):
        assert np.isnan(bench.found.final[symbol]).all(), symbol
    for symbol in ("AP", "AP_a", "AD"):
        assert not np.isnan(bench.found.final[symbol]).any(), symbol


def test_copies_and_flagged_rows_are_no_cycles() -> None:
    """A reading that froze would make any repeatability perfect; a lost reflector any accuracy bad."""
    bench = Bench()
    rows = bench.rows
    own = np.flatnonzero(rows.repeats.configuration == 0)
    frozen, rotation = rows.position.copy(), rows.rotation.copy()
    frozen[own[1:20]], rotation[own[1:20]] = frozen[own[0]], rotation[own[0]]
    frozen[own[25]] += 0.05
    outlier = np.zeros(len(rows), dtype=bool)
    outlier[own[25]] = True
    found = bench.evaluated(robots.placed(rows, position=frozen, rotation=rotation), outlier)
    assert (found.copies, found.flagged) == (19, 1)
    pose = next(k for k, group in enumerate(found.cycles) if rows.repeats.configuration[group[0]] == 0)
    assert found.counts[pose] == CYCLES - 20
    assert found.final["RP"][pose] > 0.5 * np.median(found.final["RP"])


def test_what_rows_cannot_tell_is_not_told() -> None:
    bench = Bench()
    bare = replace(bench.rows, covariates={})
    assert np.isnan(bench.evaluated(bare).final["dAP"]).all()
    assert np.isnan(bench.evaluated(bare).final["vAP"]).all()
    guessed = bench.rows.with_origin(derived=SIDES)  # directions that the order of rows suggests are no knowledge
    assert np.isnan(bench.evaluated(guessed).final["vAP"]).all()
    assert not np.isnan(bench.evaluated(guessed).final["dAP"]).any()


def test_distances_are_those_of_one_station() -> None:
    bench = Bench()
    station = np.where(bench.rows.repeats.configuration < 2, "north", "south")
    base = bench.bases[0][0][1]
    bench.bases = [(("north", base), ("south", base))] * 2
    found = bench.evaluated(bench.rows.with_labels(station=station))
    at = [str(station[group[0]]) for group in found.cycles]
    assert len(found.pairs) == 1 + 6  # of two poses, and of four
    assert all(at[a] == at[b] for a, b in found.pairs)
    assert found.nominal["AP"] == pytest.approx(bench.found.nominal["AP"], **EXACT)


def test_rows_that_repeat_nothing_and_other_kinds_have_no_figures() -> None:
    truth = robots.simulate(robots.ur10(), 5, np.random.default_rng(0))
    rows, left, none = truth.measured, np.zeros((5, 6)), np.zeros(5, dtype=bool)
    frames = truth.model.frames(truth.theta)[0]
    assert iso_9283(rows, none, (frames, left), (frames, left)) is None
    assert iso_9283(rows.select(none), none[:0], (frames, left[:0]), (frames, left[:0])) is None


def test_the_document_has_every_figure_with_its_unit_and_line() -> None:
    bench = Bench()
    written = document(bench.found, bench.rows)
    assert len(written["poses"]) == POSES
    assert len(written["distances"]) == POSES * (POSES - 1) // 2
    for k, pose in enumerate(written["poses"]):
        group = bench.found.cycles[k]
        assert pose["row"] == bench.rows.origin.line[group[0]]
        assert pose["split"] == ("test" if bench.rows.test[group[0]] else "train")
        assert pose["hours"] == pytest.approx((CYCLES - 1) * POSES * PERIOD / 3600)
        assert pose["final"]["AP_mm"] == pytest.approx(1e3 * bench.found.final["AP"][k])
        assert pose["nominal"]["RP_c_mrad"] == pytest.approx(1e3 * bench.found.nominal["RP_c"][k])
    assert written["distances"][0]["final"]["AD_mm"] == pytest.approx(1e3 * bench.found.final["AD"][0])
