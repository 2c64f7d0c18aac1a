"""`aridcal merge`: two logs of a simulated motion become the rows that were simulated, or are refused."""

from __future__ import annotations

from pathlib import Path

import made_bags
import made_logs
import numpy as np
import pandas as pd
import pytest
import robots
from made_logs import Made
from scipy.spatial.transform import Rotation
from scipy.special import polygamma
from scipy.stats import chi2

import aridcal
from aridcal.jobs.merge import averages, bags
from aridcal.jobs.merge.alignment import Moves, jump
from aridcal.jobs.merge.clocks import correlations
from aridcal.jobs.merge.log import Log
from aridcal.jobs.merge.log_rows import MergeResult
from aridcal.jobs.merge.standstills import standstills
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.merge import main
from aridcal.runs.log_merge import join_logs
from aridcal.system.errors import AridcalError, MeasurementError

UR10 = robots.URDF / "ur10.urdf"
ROBOT = robots.ur10()
STOPS = 20
"""Of the logs that most tests join."""
XYZ, TURN = ["x", "y", "z"], ["qx", "qy", "qz", "qw"]
STD = ["std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz"]


def join(joints: pd.DataFrame | Path, tracker: pd.DataFrame | Path | None, **answers: int) -> MergeResult:
    settled = {key.replace("_", "."): number for key, number in answers.items()}
    return join_logs(joints, tracker, UR10, "tool0", leave_open, settled)


def rows_of(found: MergeResult, truth: Made) -> np.ndarray:
    """Number of the stop that each row is of, told by its joints alone."""
    q = found.table[list(ROBOT.readings)].to_numpy()
    return np.array([np.argmin(np.abs(truth.q - row).sum(axis=1)) for row in q])


def late(found: MergeResult, truth: Made) -> float:
    """Largest error of the clocks, [s]."""
    time = truth.tracker["time"].to_numpy()
    return float(np.abs(found.clocks.joints(time) - truth.joints_clock(time)).max())


def strange(found: MergeResult, truth: Made) -> np.ndarray:
    """Rows about the truth in their own sigmas, position then rotation, shape (K, 6)."""
    k = rows_of(found, truth)
    off = found.table[XYZ].to_numpy() - truth.position[k]
    turned = Rotation.from_quat(found.table[TURN].to_numpy()) * Rotation.from_matrix(truth.rotation[k]).inv()
    return np.hstack([off, turned.as_rotvec()]) / found.table[STD].to_numpy()


def is_likely(z: np.ndarray) -> bool:
    """Whether squares add up to what chi-square allows in all but one of 1,000 cases, either way."""
    return bool(0.0005 < chi2.cdf(np.sum(z**2), z.size) < 0.9995)


@pytest.fixture(scope="module")
def small() -> Made:
    return made_logs.made(ROBOT, n=STOPS, seed=1)


@pytest.fixture(scope="module")
def plain(small: Made) -> pd.DataFrame:
    """Their rows."""
    return join(small.joints, small.tracker).table


@pytest.mark.parametrize(
    ("n", "seed", "offset", "drift", "wrong"),
    [(20, 11, 3.7, 4e-5, 0.0), (12, 12, -1000.0, 5e-4, 5e-3)],
)
def test_clocks_and_rows_are_those_that_were_simulated(
    n: int, seed: int, offset: float, drift: float, wrong: float
) -> None:
    truth = made_logs.made(ROBOT, n=n, seed=seed, offset=offset, drift=drift, wrong=wrong)
    found = join(truth.joints, truth.tracker)
    assert late(found, truth) < (5e-3 if wrong else 5e-4)
    assert rows_of(found, truth).tolist() == list(range(n))
    assert not found.unpaired
    assert is_likely(strange(found, truth))
    mean_std = found.table[STD].to_numpy() * np.sqrt(found.table["n"].to_numpy())[:, None]
    np.testing.assert_allclose(np.median(mean_std, axis=0), [5e-5] * 3 + [1e-4] * 3, rtol=0.25)
    begin, end = truth.arrived - 0.001, truth.left + 0.001
    begin[0], end[-1] = 0.0, np.inf  # rest before and after counts
    assert np.all((found.table["time"] > begin) & (found.table["time"] < end))


def test_what_the_clocks_are_said_to_be_known_to_is_how_well_they_are() -> None:
    z = []
    for seed in range(4):
        truth = made_logs.made(ROBOT, n=9, seed=20 + seed, wrong=3e-3, stay=np.full(9, 2.0))
        found = join(truth.joints, truth.tracker)
        time = np.array([found.clocks.middle])
        z.append((found.clocks.joints(time) - truth.joints_clock(time)) / found.clocks.std(time))
    assert is_likely(np.array(z))


def test_a_stop_in_which_the_tracker_lost_its_target_is_named_and_makes_no_row(small: Made) -> None:
    """Whatever it writes instead: nothing, no numbers, zeros or its last place."""
    time = small.joints_clock(small.tracker["time"].to_numpy())

    def lost(stop: int) -> np.ndarray:
        return np.asarray((time > small.arrived[stop] - 0.5) & (time < small.left[stop] + 0.3))

    nothing, nan, zero, frozen = 3, 7, 11, 15
    tracker = small.tracker.copy()
    tracker.loc[lost(frozen), XYZ + TURN] = np.nan
    tracker = tracker.ffill()
    tracker.loc[lost(nan), XYZ + TURN] = np.nan
    tracker.loc[lost(zero), XYZ + TURN] = 0.0
    found = join(small.joints, tracker[~lost(nothing)])
    stops = [nothing, nan, zero, frozen]
    assert sorted(set(range(STOPS)) - set(rows_of(found, small).tolist())) == stops
    assert len(found.unpaired) == len(stops)
    for stop, one in zip(stops, found.unpaired, strict=True):
        assert "lost its target" in str(one)
        assert one.begin == pytest.approx(small.arrived[stop], abs=0.3)
    assert is_likely(strange(found, small))


def test_a_program_that_repeats_itself_is_paired_by_its_ends_or_refused() -> None:
    q = np.tile(np.random.default_rng(3).uniform(-1.5, 1.5, (4, 6)), (4, 1))
    truth = made_logs.made(ROBOT, stops=q, stay=np.full(16, 2.0), move=np.full(15, 2.0), seed=3)
    assert late(join(truth.joints, truth.tracker), truth) < 1e-3
    time = truth.joints_clock(truth.tracker["time"].to_numpy())
    with pytest.raises(MeasurementError, match="repeats itself"):
        join(truth.joints, truth.tracker[(time > 20) & (time < 55)])


def test_equal_times_at_other_poses_are_no_repetition() -> None:
    truth = made_logs.made(ROBOT, n=20, stay=np.full(20, 2.0), move=np.full(19, 2.0), seed=4)
    time = truth.joints_clock(truth.tracker["time"].to_numpy())
    found = join(truth.joints, truth.tracker[(time > 15) & (time < 60)])
    assert late(found, truth) < 2e-3
    assert all(one.end < 20 or one.begin > 52 for one in found.unpaired), found.unpaired


@pytest.mark.parametrize("step", [-3.0, 0.05])
def test_a_clock_that_was_set_is_refused(small: Made, step: float) -> None:
    tracker = small.tracker.copy()
    tracker.loc[len(tracker) // 2 :, "time"] += step
    with pytest.raises(MeasurementError, match=r"set back|was set|clock jumped"):
        join(small.joints, tracker)


@pytest.mark.parametrize(("share", "step"), [(0.75, 30.0)])
def test_a_clock_that_was_set_far_is_refused_or_costs_rows_but_never_makes_wrong_ones(
    small: Made, share: float, step: float
) -> None:
    tracker = small.tracker.copy()
    tracker.loc[int(share * len(tracker)) :, "time"] += step
    try:
        found = join(small.joints, tracker)
    except MeasurementError:
        return
    off = found.table[XYZ].to_numpy() - small.position[rows_of(found, small)]
    assert np.abs(off).max() < 5e-4


def test_a_target_that_was_moved_between_is_refused(small: Made) -> None:
    tracker = small.tracker.copy()
    tracker.loc[len(tracker) - 40 :, "x"] += 0.3
    with pytest.raises(MeasurementError, match="tracker was moved"):
        join(small.joints, tracker)


def without_motion(table: pd.DataFrame, columns: list[str], noise: float) -> pd.DataFrame:
    rng = np.random.default_rng(0)
    fixed = table.iloc[0][columns].to_numpy(dtype=float) + noise * rng.normal(size=(len(table), len(columns)))
    return table.assign(**dict(zip(columns, fixed.T, strict=True)))


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("another motion", "of one motion"),
        ("no overlap", "of one motion"),
        ("robot at rest", "nothing moves"),
        ("noisy robot at rest", "stand for a second"),
        ("tracker at rest", "stand for a second"),
        ("no stops", "standstills"),
        ("four stops", "share 4 standstills"),
        ("a beginning", "30 samples"),
        ("no time", "call it `time`"),
        ("no joint", "Name the joints"),
        ("no place", "call them x, y and z"),
        ("dates in a DataFrame", "do not rise"),
    ],
)
def test_what_cannot_be_joined_is_refused_with_the_remedy(small: Made, what: str, said: str) -> None:
    joints, tracker, names = small.joints, small.tracker, list(ROBOT.readings)
    if what == "another motion":
        tracker = made_logs.made(ROBOT, n=STOPS, seed=9).tracker
    elif what == "no overlap":
        joints, tracker = joints[: len(joints) // 3], tracker[len(tracker) // 2 :]
    elif what.endswith("robot at rest"):
        joints = without_motion(joints, names, 1e-5 if "noisy" in what else 0.0)
    elif what == "tracker at rest":
        tracker = without_motion(tracker, XYZ, 5e-5)
    elif what in ("no stops", "four stops"):
        few = {"n": 4} if what == "four stops" else {"n": 12, "stay": np.full(12, 0.05)}
        other = made_logs.made(ROBOT, seed=1, **few)  # type: ignore[arg-type]
        joints, tracker = other.joints, other.tracker
    elif what == "a beginning":
        joints = joints[:30]
    elif what == "no time":
        tracker = tracker.drop(columns="time")
    elif what == "no joint":
        joints = joints.drop(columns=names[2])
    elif what == "no place":
        tracker = tracker.drop(columns="x")
    else:
        tracker = tracker.assign(time="2026-01-02 10:00:00")
    with pytest.raises(AridcalError, match=said):
        join(joints, tracker)


def test_samples_that_depend_on_each_other_count_for_less() -> None:
    truth = made_logs.made(ROBOT, n=40, seed=5, noise=(0.0, 1e-4), rates=(25.0, 20.0))
    rng, rho = np.random.default_rng(5), 0.8
    noise = rng.normal(size=(len(truth.tracker), 3))
    for k in range(1, len(noise)):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    tracker = truth.tracker.copy()
    tracker[XYZ] += 1e-4 * noise
    found = join(truth.joints, tracker)
    z = strange(found, truth)[:, :3]
    np.testing.assert_allclose(found.averages.correlation[:3], rho, atol=0.05)
    assert 0.8 < np.mean(z**2) < 1.5
    naive = z * found.table[STD[:3]].to_numpy() / (1e-4 / np.sqrt(found.table["n"].to_numpy()))[:, None]
    assert np.mean(naive**2) > 4  # what sigma / sqrt(n) would say


def test_a_target_that_creeps_after_each_move_is_averaged_only_when_it_stands() -> None:
    truth = made_logs.made(ROBOT, n=20, seed=6, stay=np.full(20, 5.0))
    time = truth.joints_clock(truth.tracker["time"].to_numpy())
    k = np.clip(np.searchsorted(truth.arrived, time) - 1, 0, None)
    since = np.maximum(time - truth.arrived[k], 0.0)
    tracker = truth.tracker.copy()
    tracker["x"] += 2e-3 * np.exp(-since / 0.3)
    found = join(truth.joints, tracker)
    off = found.table["x"].to_numpy() - truth.position[rows_of(found, truth), 0]
    assert len(off) == 20
    assert np.abs(off).max() < 6e-5  # a window from the first sample on is off by 0.12 mm at 5 s
    assert found.table["n"][:19].max() < 45


def test_units_dates_angles_and_separators_are_found_as_init_finds_them(
    small: Made, plain: pd.DataFrame, tmp_path: Path
) -> None:
    joints = small.joints.copy()
    joints.iloc[:, 1:] *= 180 / np.pi
    joints.columns = pd.Index(["time_ms", *(f"q{k}" for k in range(1, 7))])
    joints["time_ms"] *= 1000
    tracker = small.tracker[XYZ] * 1000
    angles = Rotation.from_quat(small.tracker[TURN].to_numpy()).as_euler("ZYX", degrees=True)
    tracker[["A", "B", "C"]] = angles
    dates = pd.to_datetime(1_700_000_000 + small.tracker["time"], unit="s")
    tracker.insert(0, "Timestamp", dates.dt.strftime("%Y-%m-%d %H:%M:%S.%f"))
    joints.to_csv(tmp_path / "joints.csv", index=False)
    tracker.to_csv(tmp_path / "tracker.csv", sep=";", index=False)
    table = join(tmp_path / "joints.csv", tmp_path / "tracker.csv").table
    np.testing.assert_array_equal(table["n"], plain["n"])
    np.testing.assert_allclose(table[plain.columns], plain, atol=2e-6)


def test_a_clock_of_unknown_unit_is_asked_for_and_the_answer_taken(small: Made) -> None:
    joints, tracker = small.joints[::50], small.tracker
    with pytest.raises(AridcalError, match=r"--set joints.time=NUMBER.: 1 = s .*; 2 = ms") as refused:
        join(joints, tracker)
    assert "measurements." not in str(refused.value)
    with pytest.raises(AridcalError, match=r"standstills|alike"):
        join(joints, tracker, joints_time=2)


def test_samples_out_of_order_and_twice_do_no_harm(small: Made, plain: pd.DataFrame) -> None:
    joints = small.joints.iloc[np.r_[0:500, 502, 501, 500, 503 : len(small.joints)]]
    tracker = pd.concat([small.tracker, small.tracker[300:310]]).sort_values("time", kind="stable")
    found = join(joints, tracker)
    pd.testing.assert_frame_equal(found.table, plain)
    assert any("10 samples have the time of the one before" in notice for notice in found.notices)


def test_wild_samples_at_standstill_are_left_out_and_said(small: Made) -> None:
    rng = np.random.default_rng(4)
    tracker = small.tracker.copy()
    wild = rng.choice(len(tracker), 15, replace=False)
    tracker.loc[wild, XYZ] += rng.normal(0.0, 0.2, (15, 3))
    found = join(small.joints, tracker)
    assert is_likely(strange(found, small))
    assert late(found, small) < 5e-4
    assert any("far from their neighbours" in notice for notice in found.notices)


def test_rounded_instruments_get_no_sigma_below_their_last_digit() -> None:
    truth = made_logs.made(ROBOT, n=10, seed=7, noise=(1e-6, 1e-6))
    found = join(truth.joints, truth.tracker.round(4))
    off = found.table[XYZ].to_numpy() - truth.position[rows_of(found, truth)]
    assert found.table[STD[:3]].to_numpy().min() > 2.8e-5  # 0.1 mm / sqrt(12)
    assert np.mean((off / found.table[STD[:3]].to_numpy()) ** 2) < 1.6


@pytest.fixture(scope="module")
def recorded() -> tuple[Made, pd.DataFrame]:
    """Logs as a bag may hold them, and their rows: ROS 1 has no times before 1970."""
    truth = made_logs.made(ROBOT, n=8, seed=8, offset=-20.0)
    return truth, join(truth.joints[::4], truth.tracker).table


@pytest.mark.parametrize(("how", "as_tf"), [("ros1", False), ("mcap", False), ("sqlite3", True)])
def test_a_bag_gives_the_same_table(recorded: tuple[Made, pd.DataFrame], tmp_path: Path, how: str, as_tf: bool) -> None:
    truth, plain = recorded
    bag = tmp_path / ("run.bag" if how == "ros1" else "run")
    made_bags.write_bag(bag, truth.joints[::4], truth.tracker, how, as_tf, "wrist_3_link" if as_tf else "")
    (file,) = bag.glob("*.mcap") if how == "mcap" else [bag]
    table = join(file, None).table
    np.testing.assert_array_equal(table["n"], plain["n"])
    np.testing.assert_allclose(table, plain, atol=1e-8)  # stamps of ROS are whole nanoseconds


def test_a_bag_that_holds_two_targets_or_none_says_so(small: Made, tmp_path: Path) -> None:
    joints, tracker = small.joints[::25], small.tracker[:400]
    made_bags.write_bag(tmp_path / "two", joints, tracker, "mcap", True, "other_probe")
    with pytest.raises(AridcalError, match=r"which is the measured target.*1 = /tf probe; 2 = /tf other_probe"):
        join(tmp_path / "two", None)
    made_bags.write_bag(tmp_path / "none", joints, tracker[:0], "mcap")
    with pytest.raises(AridcalError, match="no PoseStamped"):
        join(tmp_path / "none", None)
    renamed = joints.rename(columns={ROBOT.readings[0]: "j0"})
    made_bags.write_bag(tmp_path / "other", renamed, tracker, "mcap")
    with pytest.raises(AridcalError, match=rf"{ROBOT.readings[0]}.*j0"):
        join(tmp_path / "other", None)


def test_a_broken_bag_and_a_missing_library_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cut.bag").write_bytes(b"#ROSBAG V2.0\nnonsense")
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\nnonsense")
    for name in ("cut.bag", "cut.mcap", "", "absent.mcap"):
        with pytest.raises(AridcalError, match="cannot be read as a bag"):
            join(tmp_path / name, None)
    with pytest.raises(AridcalError, match="is one table"):
        join(tmp_path / "joints.csv", None)
    monkeypatch.setattr(bags, "find_spec", lambda name: None)
    with pytest.raises(AridcalError, match=r"aridcal\[ros\]"):
        join(tmp_path / "cut.bag", None)


def test_the_command_writes_a_table_that_init_reads_and_a_page(
    small: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    time = small.joints_clock(small.tracker["time"].to_numpy())
    small.joints.to_csv("joints.csv", index=False)
    small.tracker[~((time > small.arrived[5] - 0.5) & (time < small.left[5] + 0.3))].to_csv("tracker.csv", index=False)
    robot = ["--urdf", str(UR10), "--tip", "tool0"]
    assert main(["joints.csv", "tracker.csv", *robot, "-o", "rows.csv"]) == 0
    out = capsys.readouterr().out
    assert f"{STOPS - 1} rows" in out
    assert "no row: joints.csv, " in out
    page = Path("rows.html").read_text("utf-8")
    assert page.count("<svg") == 5
    assert "lost its target" in page
    assert 'class="missing"' not in page
    assert len(aridcal.propose(UR10, "rows.csv").measurements.files) == 1
    assert "how many samples a row is the mean of" in capsys.readouterr().out
    before = Path("joints.csv").read_bytes()
    assert main(["joints.csv", "tracker.csv", *robot, "-o", "joints.csv"]) == 2
    assert Path("joints.csv").read_bytes() == before
    assert main(["joints.csv", "tracker.csv", "--urdf", str(UR10), "--tip", "tool9", "-o", "other.csv"]) == 2
    assert "did you mean 'tool0'?). Check --tip" in capsys.readouterr().err
    assert main(["joints.csv", "joints.csv", *robot, "-o", "other.csv"]) == 2
    assert not Path("other.csv").exists()
    assert not Path("other.html").exists()


def test_correlations_of_every_lag_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=40), rng.normal(size=25)
    a[[3, 17]], b[8] = np.nan, np.nan
    lags, r, n = correlations(a, b, 5)
    for lag in (-15, -3, 0, 4, 20):
        k = np.arange(max(0, -lag), min(len(b), len(a) - lag))
        pair = np.array([a[k + lag], b[k]])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        at = int(np.flatnonzero(lags == lag)[0])
        assert n[at] == pair.shape[1]
        assert r[at] == pytest.approx(np.corrcoef(pair)[0, 1], abs=1e-9)


def test_the_mean_of_rotations_is_scipys_whatever_the_signs() -> None:
    rng = np.random.default_rng(1)
    near = Rotation.from_euler("xyz", [1, 2, 3]) * Rotation.from_rotvec(0.1 * rng.normal(size=(30, 3)))
    signs = rng.choice([-1, 1], (30, 1))
    mean = averages.mean_rotation(near.as_quat() * signs)
    assert (Rotation.from_quat(mean) * near.mean().inv()).magnitude() < 1e-12


@pytest.mark.parametrize("x", [0.3, 2.0, 50.0])
def test_the_inverse_of_trigamma_inverts_it(x: float) -> None:
    assert averages._inverse_trigamma(float(polygamma(1, x))) == pytest.approx(x, rel=1e-6)


def test_scatter_that_differs_from_stop_to_stop_is_kept_and_that_which_does_not_is_shared() -> None:
    rng = np.random.default_rng(2)
    windows = [np.arange(k * 10, k * 10 + 10) for k in range(200)]
    same = averages.averages(windows, 1e-4 * rng.normal(size=(2000, 3)), None)
    assert np.ptp(same.std) / same.std.mean() < 0.3
    sigma = np.repeat(np.exp(rng.normal(size=200)), 10)[:, None] * 1e-4
    position = sigma * rng.normal(size=(2000, 3))
    other = averages.averages(windows, position, None)
    z = other.position / other.std
    assert np.corrcoef(np.log(other.std[:, 0]), np.log(sigma[::10, 0]))[0, 1] > 0.9
    assert 0.8 < np.mean(z**2) < 1.4  # of Student's t with ten degrees of freedom it is 1.25


def test_moves_that_scatter_are_no_jump_and_steps_among_them_are() -> None:
    rng = np.random.default_rng(5)
    for n in (8, 15, 150):
        time = np.sort(rng.uniform(0, 1000, n))
        for _ in range(30):
            late = 5e-3 * rng.standard_t(3, n)
            assert jump(Moves(time, late, np.ones(n))) is None
        at = n // 2
        found = jump(Moves(time, 1e-3 * rng.normal(size=n) + 0.2 * (np.arange(n) >= at), np.ones(n)))
        assert found is not None
        assert found == (time[at], pytest.approx(0.2, abs=0.01))


def test_a_drift_that_no_clock_has_is_refused(small: Made) -> None:
    tracker = small.tracker.assign(time=1.004 * small.tracker["time"])
    with pytest.raises(MeasurementError, match=r"drift apart|alike for|misses"):
        join(small.joints, tracker)


def test_a_spike_parts_no_standstill_and_a_hole_does() -> None:
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 20.0, 0.01)
    x = np.clip(time - 8.0, 0.0, 1.0)[:, None] * [0.5, 0.0, 0.0] + 1e-5 * rng.normal(size=(2000, 3))
    x[400] += 5e-3
    log = Log("log", time, ("x", "y", "z"), x)
    found = standstills(log, x)
    np.testing.assert_allclose(found.begin, [0.0, 9.0], atol=0.15)
    np.testing.assert_allclose(found.end, [8.0, 20.0], atol=0.15)
    kept = log.keep((time < 14.0) | (time > 15.0))
    assert len(standstills(kept, kept.values)) == 3
