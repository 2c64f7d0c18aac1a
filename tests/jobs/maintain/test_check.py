"""`aridcal check`: false alarms as stated, and what moved named; the rules of evidence against other libraries."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import calibrated
import numpy as np
import pandas as pd
import pytest
import robots
import yaml
from calibrated import NOISE, Machine, jump, machine
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import chi2, multivariate_normal, multivariate_t
from simulated_instruments import scenario

from aridcal.__main__ import main
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.tails import Tails
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.wander import Wander, wandering
from aridcal.jobs.calibrate.folder import write_results
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.maintain.bounds import FALSE_ALARMS, bounds
from aridcal.jobs.maintain.checking import check, new_rows_question
from aridcal.jobs.maintain.hypotheses import suspects, widened
from aridcal.jobs.maintain.likelihoods import (
    LOG_WEIGHTS,
    NOISE_FACTORS,
    NewRowsQuestion,
    alarm,
    covariance_of,
    evidence,
    likely,
)
from aridcal.jobs.maintain.new_rows import NewRowNoise, freedom_of, new_row_noise
from aridcal.jobs.simulate.simulation import simulate, write_campaign

NAMES = robots.ur10().readings


@cache
def ur10(seed: int = 1, kind: str = "pose") -> Machine:
    return machine(seed, kind)


def question(m: Machine, rows: Dataset) -> NewRowsQuestion:
    return new_rows_question(widened(m.saved.final), rows, new_row_noise(m.saved, rows))


# -- the rules of evidence, by a second road


def test_the_most_likely_coefficients_are_those_of_weighted_least_squares():
    m = ur10()
    q = m.configurations(8)
    rows = m.measured(q, jump(2, 2e-3))
    asking = question(m, rows)
    zero = next(s for s in suspects(widened(m.saved.final), rows) if s.where == NAMES[2])
    asking = asking.with_moved(zero, 1e-2)
    free = np.flatnonzero(np.diag(asking.covariance) > 0.0)
    root = np.linalg.inv(np.linalg.cholesky(asking.covariance[np.ix_(free, free)]))

    def left(change: np.ndarray) -> np.ndarray:
        theta = asking.theta.copy()
        theta[free] += change / np.linalg.norm(root, axis=0)
        r = asking.problem.residual(theta) / asking.sigma
        return np.concatenate([r.ravel(), root @ (theta - asking.theta)[free]])

    other = least_squares(left, np.zeros(len(free)), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = likely(asking)
    sigma = np.sqrt(np.diag(covariance_of(asking, found))[free])
    assert (
        np.abs((found.theta - asking.theta)[free] - other.x / np.linalg.norm(root, axis=0)).max() < 0.02 * sigma.max()
    )
    assert found.theta[zero.touched[0]] == pytest.approx(2e-3, abs=4 * sigma.max())


def test_evidence_is_the_mean_of_normal_densities():
    m = ur10()
    rows = m.measured(m.configurations(4), jump(1, 1e-4))
    asking = question(m, rows)
    place = likely(asking)
    base = next(s for s in suspects(widened(m.saved.final), rows) if s.where == "world_base")
    B = place.J @ base.directions
    sizes = base.sizes[:7]  # farther than 1 cm the other library takes these matrices for singular
    found = evidence(place, 1.0, B, sizes)
    known = place.J @ asking.covariance @ place.J.T
    eye = np.eye(len(place.r))
    logs = [
        [multivariate_normal(None, k**2 * eye + known + s**2 * B @ B.T).logpdf(place.r) for k in NOISE_FACTORS]
        for s in sizes
    ]
    np.testing.assert_allclose(found.density, logs, atol=1e-4)
    assert found.total == pytest.approx(logsumexp(np.array(logs) + LOG_WEIGHTS) - np.log(len(logs)), abs=1e-6)
    assert np.exp(LOG_WEIGHTS).sum() == pytest.approx(1.0)


def test_the_residual_as_a_whole_is_tested_with_chi_squares():
    m = ur10()
    rows = m.measured(m.configurations(8), noise=3 * NOISE)
    asking = question(m, rows)
    r, J = asking.at(asking.theta)
    squares = r @ np.linalg.solve(np.eye(len(r)) + J @ asking.covariance @ J.T, r)
    found = alarm(asking, [])
    assert found.squares == pytest.approx(squares, rel=1e-6)
    assert found.p_value == pytest.approx(2.0 * chi2.sf(squares, 48), rel=1e-6)


def test_noise_that_was_estimated_from_few_rows_raises_fewer_alarms():
    m = ur10()
    rows = m.measured(m.configurations(8), noise=1.4 * NOISE)
    sure = question(m, rows)
    unsure = replace(sure, freedom=freedom_of(NewRowNoise(np.ones(2), np.array([30.0, 30.0])), np.array([3, 3])))
    assert unsure.freedom == pytest.approx(60.0)
    assert alarm(sure, []).p_value < 0.2 * alarm(unsure, []).p_value


def test_bounds_of_millions_of_gross_errors_are_numbers_about_the_error():
    """Series for the noncentrality end in NaN there."""
    off = bounds(np.full((1_000_000, 3), 9.4e-3), 1e-4)
    assert off.low < 1e-4 * np.sqrt(3 * (94**2 - 1)) < off.high < 1.0001 * off.low


def test_the_bounds_of_the_error_hold_it_as_often_as_they_say():
    """Where one sum of squares in a hundred is smaller, by sampling, the highest error is the true one; so at the other end."""
    rng = np.random.default_rng(3)
    sigma, error = 1e-4, 2e-4
    off = rng.normal(size=24)
    off *= error / np.sqrt(np.sum(off**2) / 8)
    squares = np.sum((off + sigma * rng.normal(size=(100_000, 24))) ** 2, axis=1)
    few, many = (
        bounds(np.full((8, 3), np.sqrt(of / 24)), sigma)
        for of in np.quantile(squares, [FALSE_ALARMS, 1 - FALSE_ALARMS])
    )
    assert few.high == pytest.approx(
        error, rel=0.01
    )  # of 100,000 samples the quantile is known to 3 parts in a thousand
    assert many.low == pytest.approx(error, rel=0.01)


def test_noise_with_tails_and_nothing_to_explain_has_the_density_of_students_t():
    m = ur10()
    rows = m.measured(m.configurations(6), noise=3 * NOISE)
    asking = question(m, rows)
    asking = replace(asking, covariance=np.zeros_like(asking.covariance), tails=np.array([2.0, 5.0]))
    place = likely(asking)
    found = evidence(place, 1.0, np.zeros((len(place.r), 0)), (1.0,)).density[0]
    r = asking.at(asking.theta)[0].reshape(6, 6)
    for k, seen in zip(NOISE_FACTORS, found, strict=True):
        of_channels = [
            multivariate_t(np.zeros(3), k**2 * np.eye(3), df=df).logpdf(part)
            for df, part in ((2.0, r[:, :3]), (5.0, r[:, 3:]))
        ]
        assert seen == pytest.approx(np.sum(of_channels), abs=1e-8)


def test_what_rows_share_takes_its_part_of_what_they_tell():
    """The covariance of the coefficients is that of normal numbers given others, the shared part among their noise."""
    m = with_wander(ur10(), 1e-4)
    rows = m.measured(m.configurations(8))
    asking = uneven_question(m, rows)
    place = likely(asking)
    P, C = asking.covariance, asking.shared(place.J)
    assert C.max() > 1.0
    S = np.eye(len(C)) + place.J @ P @ place.J.T + C
    given = P - P @ place.J.T @ np.linalg.solve(S, place.J @ P)
    np.testing.assert_allclose(covariance_of(asking, place), given, atol=1e-9 * P.max())


# -- false alarms, and what moved


def with_wander(m: Machine, sigma: float) -> Machine:
    """The machine with a calibration that left errors of its zeros that go with all readings, [rad]."""
    record = {"wander": [asdict(Wander("all", 1.0, sigma, sigma, 1.0))]}
    return replace(m, saved=replace(m.saved, record=record))


def uneven_question(m: Machine, rows: Dataset) -> NewRowsQuestion:
    shared = wandering(m.saved.wanders, m.model.robot, rows.readings, m.saved.ranges)
    return new_rows_question(widened(m.saved.final), rows, new_row_noise(m.saved, rows), wandering=shared)


def corner(m: Machine, n: int) -> np.ndarray:
    """Readings in one corner of where it was calibrated, shape (n, 6)."""
    low, high = np.array([m.saved.ranges[name] for name in NAMES]).T
    side, inside = m.rng.choice([0.0, 1.0], 6), 0.1 * m.rng.random((n, 6))
    return low + (high - low) * np.abs(side - inside)


def test_errors_that_neighbouring_places_share_are_false_alarms_as_seldom_as_stated():
    """Zeros wander by 0.05 mrad beside a noise as large; a calibration that does not know that fails most checks."""
    m = with_wander(ur10(), 5e-5)
    waves, before, after, missed = 60, 0, 0, 0
    for _ in range(24):
        q = corner(m, 12)
        k, phase = m.rng.normal(size=(6, waves, 6)), m.rng.uniform(0.0, 2.0 * np.pi, (6, waves))
        offset = 5e-5 * np.sqrt(2.0 / waves) * np.cos(np.einsum("jwk,nk->njw", k, q) + phase).sum(axis=2)
        rows = m.measured(q, offset)
        every = suspects(widened(m.saved.final), rows)
        before += alarm(question(m, rows), every).p_value < FALSE_ALARMS
        after += alarm(uneven_question(m, rows), every).p_value < FALSE_ALARMS
        missed += alarm(uneven_question(m, m.measured(q, offset + jump(2, 1e-3))), every).p_value >= FALSE_ALARMS
    assert before > 12
    assert after <= 1  # 0.2 expected
    assert missed == 0


def test_noise_with_tails_makes_false_alarms_as_seldom_as_stated_and_hides_no_jump():
    """Student's t with two degrees of freedom: one position in four is more than three sigma off."""
    m, scale = ur10(), np.array([NOISE, NOISE])
    noise = NewRowNoise(scale, np.full(2, np.inf), (Tails(2.0, NOISE), Tails(2.0, NOISE)))
    wide, before, after, missed = widened(m.saved.final), 0, 0, 0
    for _ in range(30):
        q = m.configurations(10)
        for offset in (0.0, jump(1, 5e-4)):
            rows = m.measured(q, offset, 0.0)
            shake = NOISE * np.sqrt(2.0 / m.rng.chisquare(2.0, (10, 2, 1))) * m.rng.normal(size=(10, 2, 3))
            turned = Rotation.from_rotvec(shake[:, 1]).as_matrix() @ rows.rotation
            rows = robots.placed(rows, position=rows.position + shake[:, 0], rotation=turned)
            every = suspects(wide, rows)
            alarmed = alarm(new_rows_question(wide, rows, noise), every).p_value < FALSE_ALARMS
            if np.any(offset):
                missed += not alarmed
            else:
                after += alarmed
                before += (
                    alarm(new_rows_question(wide, rows, NewRowNoise(scale, noise.freedom)), every).p_value
                    < FALSE_ALARMS
                )
    assert before > 20
    assert after <= 1  # 0.3 expected at the most
    assert missed == 0


def test_one_clean_check_in_a_hundred_is_a_false_alarm():
    p_values = []
    for seed, kind in enumerate(["pose", "position", "pose", "position"]):
        m = machine(100 + seed, kind)
        q = m.configurations(8)
        wide = widened(m.saved.final)
        for _ in range(75):
            rows = m.measured(q)
            asking = new_rows_question(wide, rows, new_row_noise(m.saved, rows))
            p_values.append(alarm(asking, suspects(wide, rows)).p_value)
    assert 1 <= np.sum(np.array(p_values) < FALSE_ALARMS) <= 8  # 3 expected: three standard deviations
    for level in (0.03, 0.1):  # nor is any other p-value smaller than stated
        most = 300 * level + 3 * np.sqrt(300 * level * (1 - level))
        assert np.sum(np.array(p_values) < level) <= most


@pytest.mark.parametrize("joint", range(6))
def test_a_zero_that_jumped_by_half_a_milliradian_is_named(joint):
    m = ur10(joint % 3 + 1)
    found = check(m.saved, m.measured(m.configurations(8), jump(joint, 5e-4)))
    assert not found.good
    assert [(c.kind, c.where) for c in found.causes] == [("zero", NAMES[joint])]
    assert found.causes[0].probability > 0.9
    assert found.rest.p_value > FALSE_ALARMS


def test_a_turn_of_the_base_about_the_first_joint_looks_like_its_zero_and_nothing_tells():
    m = ur10()
    (cause,) = check(m.saved, m.measured(m.configurations(8), jump(0, 5e-4))).causes
    assert any("base" in words for words in cause.alike)
    assert cause.telling == ()


@pytest.mark.parametrize("size", [2e-4, 0.01, 3.0])
def test_a_base_that_moved_is_named_however_far(size):
    m = ur10()
    turn = Rotation.from_rotvec(size * m.rng.normal(size=3)).as_matrix()
    rows = calibrated.with_frame(m.measured(m.configurations(8)), turn, size * m.rng.normal(size=3))
    found = check(m.saved, rows)
    assert [c.where for c in found.causes] == ["world_base"]
    assert found.rest.p_value > FALSE_ALARMS


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("size", [2e-3, 0.3])
def test_a_tool_that_moved_is_named(kind, size):
    m = ur10(2, kind)
    rows = m.measured(m.configurations(10))
    R, _ = m.model.poses(m.theta, m.model.rows(rows.readings))
    rows = robots.placed(rows, position=rows.position + R @ (size * np.array([0.6, -0.3, 0.7])))
    found = check(m.saved, rows)
    assert [c.where for c in found.causes] == ["tip_target"]


def test_an_effect_that_changed_is_named():
    """The elbow's gear error doubles."""
    wave = [Coefficient("elbow_joint", "axis", Basis(form, ("elbow_joint",), (2.0,))) for form in ("sin", "cos")]
    m = machine(5, effects=((wave[0], 8e-4), (wave[1], 3e-4)))
    worse = replace(m, theta=np.concatenate([m.theta[:-2], 2 * m.theta[-2:]]))
    assert check(m.saved, m.measured(m.configurations(15))).good
    found = check(m.saved, worse.measured(m.configurations(15)))
    assert [(c.kind, c.where) for c in found.causes] == [("effect", "elbow_joint")]


def test_a_row_that_is_off_by_itself_is_named_and_not_the_robot():
    m = ur10()
    rows = m.measured(m.configurations(8))
    rows.position[3] += [2e-3, 0.0, -1e-3]
    found = check(m.saved, rows)
    assert [(c.kind, c.where) for c in found.causes] == [("row", str(rows.origin.line[3]))]
    assert found.moved == ()


def test_an_instrument_that_scatters_more_is_named_and_not_the_robot():
    m = ur10()
    found = check(m.saved, m.measured(m.configurations(12), noise=4 * NOISE))
    assert [c.kind for c in found.causes] == ["noise"]


def test_a_base_and_a_zero_that_moved_together_are_both_named():
    m = ur10()
    rows = m.measured(m.configurations(15), jump(2, 2e-3))
    rows = calibrated.with_frame(rows, Rotation.from_rotvec([0.1, 0.4, -0.2]).as_matrix(), np.array([1.0, -0.5, 0.2]))
    assert {c.where for c in check(m.saved, rows).causes} == {"world_base", "elbow_joint"}


def test_rows_too_alike_to_tell_ask_for_one_that_does():
    """The elbow and the wrist turn about parallel axes: in poses that differ little their zeros look alike."""
    m = ur10(20)  # a machine of its own: what other tests draw changes nothing here
    low, high = np.array([m.saved.ranges[name] for name in NAMES]).T
    asked_for = 0
    for _ in range(3):
        q = m.configurations(1) + 0.02 * m.rng.normal(size=(6, 6))
        found = check(m.saved, robots.positions_alone(m.measured(q, jump(2, 6e-4))))
        told = [told for cause in found.causes[:1] for told in cause.telling]
        if told:
            asked_for += 1
            more = np.array([t.readings for t in told])
            assert np.all((low <= more) & (more <= high))
            rows = robots.positions_alone(m.measured(np.vstack([q, np.repeat(more, 2, axis=0)]), jump(2, 6e-4)))
            again = check(m.saved, rows).causes[0]
            assert again.where == NAMES[2]
            assert not {t.suspect for t in told} & set(again.alike)  # what they were asked for, they tell
    assert asked_for


def test_what_to_measure_is_written_as_a_table_of_the_campaign(results, tmp_path, capsys):
    m = ur10(7)
    q = m.configurations(1) + 0.02 * m.rng.normal(size=(6, 6))
    bad = calibrated.table(m.measured(q, jump(2, 2.5e-4)), tmp_path / "bad.csv")
    sound = calibrated.table(m.measured(m.configurations(8)), tmp_path / "sound.csv")
    poses = tmp_path / "poses.csv"
    assert main(["check", str(results), str(bad), "--poses", str(poses)]) == 3
    assert "that would tell of the" in capsys.readouterr().out
    assert list(pd.read_csv(poses).columns) == list(NAMES)
    poses.unlink()
    assert main(["check", str(results), str(sound), "--poses", str(poses)]) == 0
    assert "not written" in capsys.readouterr().out and not poses.exists()
    for wrong, said in ((tmp_path / "poses.txt", ".csv or .parquet"), (bad, "another file")):
        before = bad.read_bytes()
        assert main(["check", str(results), str(bad), "--poses", str(wrong)]) == 2
        assert said in capsys.readouterr().err and bad.read_bytes() == before


def test_rows_that_are_held_out_tell_nothing(results, tmp_path):
    """Rows marked test neither raise an alarm nor name anything: their noise may be anything."""
    m = ur10(7)
    rows = m.measured(m.configurations(12))
    rows.position[:4] += 0.01
    held = replace(rows, test=np.arange(12) < 4).with_origin(split_given=True)
    assert check(m.saved, held).good
    assert not check(m.saved, held.with_origin(split_given=False)).good


def test_tables_in_millimetres_and_degrees_with_stations_are_read_as_the_campaign_s(tmp_path, capsys):
    """The rail jumps by 0.8 mm; then one station's base does."""
    truth = robots.simulate(robots.arid(), 130, np.random.default_rng(3), 1e-3, 1e-4)
    rows = robots.table(truth)
    rows["station"] = np.where(np.arange(130) % 2, "b", "a")
    rows.loc[rows["station"] == "b", "x"] += 0.3
    rows[["A", "B", "C"]] = Rotation.from_quat(rows[["qx", "qy", "qz", "qw"]]).as_euler("XYZ", degrees=True)
    rows = rows.drop(columns=["qx", "qy", "qz", "qw"])
    for joint in truth.model.robot.joints:
        rows[joint.name] *= 1e3 if joint.kind == "prismatic" else 180.0 / np.pi
    rows[["x", "y", "z"]] *= 1e3
    settings = {
        "file": "measurements.csv",
        "units": {"length": "mm", "angle": "deg"},
        "orientation": {"euler": "XYZ", "columns": ["A", "B", "C"]},
    }
    path = robots.write_campaign(
        tmp_path,
        truth,
        rows[:120],
        measurements=settings,
        frames={"world_base": {"per": "station"}},
        diagnosis={"enabled": False},
    )
    outcome = identify(path)
    (tmp_path / "results").mkdir()
    write_results(outcome, tmp_path / "results")
    rail, base = rows[120:].copy(), rows[120:].copy()
    rail["joint_1"] += 0.8
    base.loc[base["station"] == "b", "y"] += 2.0
    for name, table, status, words in (
        ("clean", rows[120:], 0, "still good"),
        ("rail", rail, 3, "the zero of joint_1, by -0.8"),
        ("base", base, 3, "the base (or the instrument) at station b, by 2.0"),
    ):
        table.to_parquet(tmp_path / f"{name}.parquet")
        assert main(["check", str(tmp_path / "results"), str(tmp_path / f"{name}.parquet")]) == status
        assert words in capsys.readouterr().out
    strange = rows[120:].assign(station="elsewhere")
    strange.to_csv(tmp_path / "strange.csv", index=False)
    assert main(["check", str(tmp_path / "results"), str(tmp_path / "strange.csv")]) == 2
    assert "'elsewhere' was not in the calibration" in capsys.readouterr().err


def test_a_calibration_from_exact_rows_can_be_checked():
    """Noise of nothing beside a base that moved by metres: nothing overflows, and names are right."""
    m = ur10()
    exact = replace(m, saved=replace(m.saved, noise=(0.0, 0.0)))
    q = m.configurations(8)
    assert [c.where for c in check(exact.saved, exact.measured(q, jump(2, 0.5), 0.0)).causes[:1]] == [NAMES[2]]
    rows = calibrated.with_frame(exact.measured(q, 0.0, 0.0), np.eye(3), np.array([5.0, -7.0, 2.0]))
    assert [c.where for c in check(exact.saved, rows).causes[:1]] == ["world_base"]


# -- tolerances


def test_with_a_tolerance_only_a_larger_error_counts():
    m = ur10()
    q = m.configurations(10)
    assert check(m.saved, m.measured(q, jump(2, 2e-4)), tolerance=1e-3).good
    assert not check(m.saved, m.measured(q, jump(2, 5e-3)), tolerance=1e-3).good
    found = check(m.saved, m.measured(q, jump(2, 2e-4)), tolerance=1e-3)
    assert found.contradicted and found.moved


# -- the command


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """A result folder of the machine, from its table, as `identify` writes it but for the report."""
    folder = tmp_path_factory.mktemp("results")
    m = ur10(7)
    truth = robots.Truth(m.model, m.theta, m.measured(m.configurations(80)))
    outcome = identify(robots.write_campaign(folder, truth))
    (folder / "results").mkdir()
    write_results(outcome, folder / "results")
    return folder / "results"


def test_the_exit_status_is_0_or_3_and_the_joint_is_named(results, tmp_path, capsys):
    m = ur10(7)
    q = m.configurations(10)
    good = calibrated.table(m.measured(q), tmp_path / "good.csv")
    bad = calibrated.table(m.measured(q, jump(3, 1e-3)), tmp_path / "bad.csv")
    assert main(["check", str(results), str(good)]) == 0
    assert capsys.readouterr().out.startswith("still good: ")
    assert main(["check", str(results / "calibration.yaml"), str(bad)]) == 3
    out = capsys.readouterr().out
    assert out.startswith("no longer good: ")
    assert "moved: the zero of wrist_1_joint, by +1.0" in out
    assert "fails 1 % of checks" in out
    assert main(["check", str(results), str(bad), "--tolerance", "5mm"]) == 0
    assert "good enough" in capsys.readouterr().out
    assert main(["check", str(results), str(bad), "--tolerance", "0.1 mm"]) == 3
    assert "above 0.1 mm" in capsys.readouterr().out


def test_what_a_wire_calibrated_is_checked_with_positions(tmp_path, capsys):
    """A calibration from distances holds no anchors: new rows are of the target itself, or distances to anchors found anew."""
    made = simulate(scenario(tmp_path, {"kind": "distance"}, {}, n=120, noise={"distance": 1e-4}))
    write_campaign(made, tmp_path, tmp_path)
    path = tmp_path / "campaign.yaml"
    path.write_text(path.read_text() + "\ndiagnosis: {enabled: false}\n")
    saved = calibration(identify(path))
    (tmp_path / "calibration.yaml").write_text(saved.dump())
    rng = np.random.default_rng(0)
    low, high = np.array([saved.ranges[name] for name in NAMES]).T
    q = rng.uniform(low, high, (10, 6))
    for offset, status, words in ((0.0, 0, "still good"), (0.01, 3, "the zero of elbow_joint, by +")):
        _, p = saved.final.poses(q + jump(2, offset))
        p = p + saved.noise[0] * rng.normal(size=p.shape)
        pd.DataFrame(np.hstack([q, p]), columns=[*NAMES, *"xyz"]).to_csv(tmp_path / "new.csv", index=False)
        assert main(["check", str(tmp_path), str(tmp_path / "new.csv")]) == status
        assert words in capsys.readouterr().out
    own = pd.read_csv(tmp_path / "measurements.csv")[::6]
    for offset, status, words in ((0.0, 0, "not seen by these rows"), (0.02, 3, "the zero of elbow_joint, by -")):
        own.assign(elbow_joint=own["elbow_joint"] + offset).to_csv(tmp_path / "own.csv", index=False)
        assert main(["check", str(tmp_path), str(tmp_path / "own.csv")]) == status
        assert words in capsys.readouterr().out


def test_the_scatter_that_rows_are_set_beside_is_that_of_the_fitted_rows(results):
    saved = SavedModel.load(results)
    (position, rotation), (of_position, of_rotation) = saved.scatter
    for sigma, freedom in ((position, of_position), (rotation, of_rotation)):
        assert sigma == pytest.approx(NOISE, rel=4 / np.sqrt(2 * freedom))
        assert 100 < freedom < 3 * 64
    older = replace(saved, record={k: v for k, v in saved.record.items() if k != "scatter"})
    assert older.scatter == (saved.noise, (np.inf, np.inf))


@pytest.mark.parametrize(
    ("tolerance", "said"),
    [("0.2", "with its unit"), ("0.2furlong", "with its unit"), ("-1mm", "with its unit"), ("0mm", "with its unit")],
)
def test_a_tolerance_needs_a_unit(tolerance, said, results, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["check", str(results), "new.csv", f"--tolerance={tolerance}"])
    assert stop.value.code == 2
    assert said in capsys.readouterr().err


def test_tables_that_cannot_be_checked_are_refused_with_the_remedy(results, tmp_path, capsys):
    m = ur10(7)
    few = calibrated.table(m.measured(m.configurations(2)), tmp_path / "few.csv")
    many = calibrated.table(m.measured(m.configurations(201)), tmp_path / "many.csv")
    missing = tmp_path / "missing.csv"
    robots.read_csv(few).drop(columns="elbow_joint").to_csv(missing, index=False)
    for path, words in (
        (few, "2 usable rows: 5 to 20"),
        (many, "aridcal identify"),
        (missing, "elbow_joint"),
        (tmp_path / "nowhere.csv", "nowhere.csv"),
    ):
        assert main(["check", str(results), str(path)]) == 2
        assert words in capsys.readouterr().err
    bare = tmp_path / "calibration.yaml"
    keys = yaml.safe_load((results / "calibration.yaml").read_text())
    del keys["campaign"]
    bare.write_text(yaml.safe_dump(keys))
    assert main(["check", str(bare), str(few)]) == 2
    assert "holds no campaign" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "none"), str(few)]) == 2
