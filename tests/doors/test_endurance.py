"""Long tables, long chains and long work: memory that does not grow with them, and progress while one waits."""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from arid_saved import calibration, inside
from rich.console import Console
from ur10_saved import BACKLASH, HEAT, POSE, readings, wanted
from ur10_saved import calibration as with_play

from aridcal import compensate, identify, predict
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.residual import linearise
from aridcal.engine.model import extended
from aridcal.engine.model.memory import Size, available_memory, check_memory
from aridcal.engine.model.model import Model
from aridcal.jobs.apply import stretches
from aridcal.jobs.calibrate import pipeline
from aridcal.jobs.calibrate.folder import write_results
from aridcal.system.errors import CampaignError, MeasurementError
from aridcal.system.progress import EVERY, Progress, StepProgress, console_progress


def hundred_times(folder: Path, rows: int) -> pd.DataFrame:
    """A query with words, blanks and holes, so that a stretch differs from the next."""
    query = inside(rows).assign(note=[f"row {k}" if k % 3 else "" for k in range(rows)])
    (folder / "calibration.yaml").write_text(calibration().dump(), encoding="utf-8")
    query.to_csv(folder / "query.csv", index=False, float_format="%.17g")
    return query


def predicted(folder: Path, query: str, out: str) -> int:
    return predict.main([str(folder / "calibration.yaml"), str(folder / query), "-o", str(folder / out)])


@pytest.mark.parametrize("sort", ["csv", "parquet"])
def test_a_long_table_is_predicted_by_stretches_as_it_would_be_as_a_whole(
    sort: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    query = hundred_times(tmp_path, 400)
    if sort == "parquet":
        query.drop(columns="note").to_parquet(tmp_path / "query.parquet")
    assert predicted(tmp_path, f"query.{sort}", "whole.csv") == 0
    monkeypatch.setattr(stretches, "STRETCH_BYTES", 3_000)
    number = len(list(stretches.stretches(tmp_path / f"query.{sort}")))
    assert number > 5
    assert predicted(tmp_path, f"query.{sort}", "parts.csv") == 0
    assert (tmp_path / "parts.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert predicted(tmp_path, f"query.{sort}", "parts.parquet") == 0
    parts = pd.read_parquet(tmp_path / "parts.parquet")
    np.testing.assert_array_equal(parts["x"], robots.read_csv(tmp_path / "whole.csv")["x"])
    assert len(parts) == 400


def test_lines_are_counted_through_all_stretches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows' line ends, blank lines and a last line without an end, each in another stretch."""
    hundred_times(tmp_path, 300)
    lines = (tmp_path / "query.csv").read_text().splitlines()
    lines[50:50] = ["", ""]
    text = "\r\n".join(lines)
    (tmp_path / "query.csv").write_bytes(text.encode())
    monkeypatch.setattr(stretches, "STRETCH_BYTES", 2_000)
    found = np.concatenate([s.table.line for s in stretches.stretches(tmp_path / "query.csv")])
    monkeypatch.undo()
    whole = np.concatenate([s.table.line for s in stretches.stretches(tmp_path / "query.csv")])
    assert found.tolist() == whole.tolist() and len(found) == 300 and found[-1] == len(lines)


@pytest.mark.parametrize("bad", ["1,2,3,4,5,6,7", 'a,b,c,"d'])
def test_a_bad_row_far_down_is_named_by_its_line_in_the_file(
    bad: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hundred_times(tmp_path, 300)
    lines = (tmp_path / "query.csv").read_text().splitlines()
    lines[249] = bad
    (tmp_path / "query.csv").write_text("\n".join(lines) + "\n")
    monkeypatch.setattr(stretches, "STRETCH_BYTES", 2_000)
    assert predicted(tmp_path, "query.csv", "out.csv") == 2
    assert "line 250" in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()


def test_a_nameless_column_that_fills_up_later_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ["a,b,"] + ["1,2,"] * 500 + ["1,2,3"] * 500
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    monkeypatch.setattr(stretches, "STRETCH_BYTES", 1_000)
    with pytest.raises(MeasurementError, match="has cells and no name"):
        list(stretches.stretches(tmp_path / "t.csv"))


def test_commands_by_stretches_are_those_of_the_whole_trajectory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without seeds, and with a side of approach that follows from the rows before, across the ends of stretches."""
    model = with_play(effects={BACKLASH: -2e-4, HEAT: 1e-5})
    q = readings(60).assign(temperature=20.0, elbow_joint_direction=1.0)
    poses = wanted(tmp_path, model, q)[[*POSE, "temperature"]]
    poses.to_csv(tmp_path / "poses.csv", index=False, float_format="%.17g")
    command = [str(tmp_path / "calibration.yaml"), str(tmp_path / "poses.csv"), "-o"]
    assert compensate.main([*command, str(tmp_path / "whole.csv")]) == 0
    monkeypatch.setattr(stretches, "STRETCH_BYTES", 1_500)
    assert len(list(stretches.stretches(tmp_path / "poses.csv"))) > 4
    assert compensate.main([*command, str(tmp_path / "parts.csv")]) == 0
    whole, parts = (robots.read_csv(tmp_path / f"{name}.csv") for name in ("whole", "parts"))
    assert whole["reached"].all() and set(whole["elbow_joint_direction"]) >= {-1.0, 1.0}
    np.testing.assert_array_equal(parts["elbow_joint_direction"], whole["elbow_joint_direction"])
    np.testing.assert_allclose(parts[list(q.columns[:6])], whole[list(q.columns[:6])], atol=1e-12)


def test_ten_times_the_rows_take_no_more_memory_to_predict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stretches, "STRETCH_BYTES", 8_000)

    def peak(rows: int) -> int:
        hundred_times(tmp_path, rows)
        tracemalloc.start()
        try:
            assert predicted(tmp_path, "query.csv", "out.csv") == 0
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(150)  # what is made once
    assert peak(1_500) < 1.3 * peak(150)


def test_a_long_chain_in_parts_has_the_poses_and_columns_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    robot = robots.random_robot(4, "RPRCRRP")
    world = tuple((label, robots.random_placement(rng)) for label in ("a", "b"))
    tip = ((None, robots.random_placement(rng)),)
    wave = Basis("sin", (robot.names[2],), (2.0,))
    every = (
        *(Coefficient("world_base", c, station=s) for s in ("a", "b") for c in FRAME_COMPONENTS),
        *(Coefficient("tip_target", c) for c in FRAME_COMPONENTS),
        *constants(robot, "full"),
        Coefficient(robot.names[2], "axis", wave),
    )
    theta = rng.normal(0, 0.02, len(every))
    q, station = robots.readings(robot, 30, rng), np.array(["a", "b", "b"] * 10)

    def asked() -> tuple[np.ndarray, ...]:
        model = Model(robot, every, world, tip)
        return *model.poses(theta, model.rows(q, None, station)), *model.jacobian(theta, model.rows(q, None, station))

    whole = asked()
    monkeypatch.setattr(extended, "MOST_JOINTS", 10)
    monkeypatch.setattr(extended, "JOINTS_OF_A_SEGMENT", 7)
    for a, b in zip(asked(), whole, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_stations_take_no_column_for_each_row() -> None:
    """A thousand stations of six constants would be six thousand numbers in every row."""
    labels = tuple(f"s{k}" for k in range(1000))
    rng = np.random.default_rng(0)
    frames = tuple((label, robots.random_placement(rng)) for label in labels)
    every = tuple(Coefficient("world_base", c, station=s) for s in labels for c in FRAME_COMPONENTS)
    model = Model(robots.ur10(), every, frames)
    q = robots.readings(model.robot, 2000, rng)
    rows = model.rows(q, None, np.array(labels)[np.arange(2000) // 2])
    assert sum(part.nbytes for part in (rows.positions, rows.phi, rows.world, rows.tip)) < 200 * len(rows)
    _, _, J = model.jacobian(np.zeros(len(every)), rows[10:20])
    assert np.flatnonzero(J.any(axis=(0, 1))).tolist() == list(range(30, 60))


def test_columns_that_move_no_row_of_a_block_change_no_sum(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = robots.simulate(robots.ur10(), 40, np.random.default_rng(0))
    rows = robots.measurements(truth, np.array(["a"] * 20 + ["b"] * 20))
    every = tuple(Coefficient("world_base", c, station=s) for s in ("a", "b", "c") for c in FRAME_COMPONENTS)
    frames = tuple((s, truth.model.world_base[0][1]) for s in ("a", "b", "c"))
    asked = problem(Model(truth.model.robot, every, frames, truth.model.tip_target), rows)
    theta, sigma = np.zeros(len(every)), np.ones(2)
    dense = linearise(asked, theta, None, sigma).equations
    monkeypatch.setattr("aridcal.engine.fit.residual.MANY_COEFFICIENTS", 0)
    monkeypatch.setattr("aridcal.engine.fit.problem.ROWS_PER_BLOCK", 7)
    sparse = linearise(asked, theta, None, sigma).equations
    np.testing.assert_allclose(sparse.AA, dense.AA, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sparse.Ar, dense.Ar, rtol=1e-12, atol=1e-12)
    assert not dense.AA[:, 12:].any()


def ticking(step: float) -> Iterator[float]:
    return (step * k for k in count())


def test_a_step_tells_how_far_it_is_and_not_too_often() -> None:
    clock, said = ticking(0.1), []
    progress = Progress(said.append, clock=lambda: next(clock))
    progress("fitting")
    done = list(progress.over(range(100), "rows"))
    assert done == list(range(100)) and said[0] == "fitting"
    assert len(said) - 1 == pytest.approx(100 * 0.1 / EVERY, abs=1)
    assert re.fullmatch(r"fitting: \d+ of 100 rows, \d+ s left", said[1])


def test_the_time_left_is_what_the_rest_takes_at_the_pace_so_far_and_the_bar_shows_the_share() -> None:
    told: list[StepProgress] = []
    clock = ticking(10.0)
    progress = Progress(lambda _: None, told.append, lambda: next(clock))
    progress("searching")
    for done in (1, 2, 3, 4):
        progress.part(done, 4, "rounds")
    assert [far.left for far in told] == pytest.approx([30.0, 20.0, 10.0, 0.0])
    assert [far.bar.count("━") for far in told] == [5, 10, 15, 20]
    assert [str(far) for far in told[2:]] == ["searching: 3 of 4 rounds, 10 s left", "searching: 4 of 4 rounds"]
    progress.part(0, 4, "rounds")  # nothing is done: nobody can say how long
    assert str(told[-1]) == "searching: 0 of 4 rounds"


def test_a_quiet_step_is_told_of_only_if_it_takes_long() -> None:
    said: list[str] = []
    clock = ticking(0.5)
    progress = Progress(said.append, clock=lambda: next(clock))
    progress.at("predicting")
    progress.share(0.1)
    assert said == []
    for done in (0.2, 0.3, 0.4, 0.5):
        progress.share(done)
    assert said == ["predicting: 40 %, 3 s left"]


def test_in_a_pipe_progress_is_lines_and_in_a_terminal_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for terminal in (False, True):
        console = Console(stderr=True, force_terminal=terminal, width=80)
        with console_progress(console) as progress:
            progress._clock = iter([0.0, 5.0, 10.0]).__next__
            progress("reading [bold]")
            progress.part(1, 2, "rows")
            progress.part(2, 2, "rows")
        written = capsys.readouterr().err
        assert written.count("\n") == (1 if terminal else 3)
        assert "reading [bold]: 2 of 2 rows" in written


def test_every_long_part_of_a_calibration_is_told(tmp_path: Path) -> None:
    """A clock that says that each moment took three seconds: what is never told of could be silent for ever."""
    said: list[str] = []
    clock = ticking(3.0)
    progress = Progress(said.append, clock=lambda: next(clock))
    truth = robots.simulate(robots.ur10(), 120, np.random.default_rng(0), noise=1e-4)
    path = robots.write_campaign(tmp_path, truth, diagnosis={"candidates": ["joint_gain", "unknown"]})
    outcome = pipeline.identify(path, progress=progress)
    write_results(outcome, tmp_path, progress)
    told = {found[1] for line in said if (found := re.search(r": [\d,]+ of [\d,]+ ([^,]+)", line))}
    assert {"rows", "candidates", "pairs", "other starts", "shuffles of the rows", "covariates"} <= told
    assert "rows of residuals.csv" in told


SMALL = Size(coefficients=48, stations=0, rows=500, searched=400, numbers=6, joints=6)


@pytest.mark.parametrize(
    ("changed", "about"),
    [
        (
            {"coefficients": 30_048, "stations": 5_000},
            r"136\.\d GB .*30,048 coefficients.*5,000 stations: split the table",
        ),
        ({"rows": 10_000_000}, r"15\.\d GB .*10,000,000 rows: give fewer"),
        ({"joints": 400, "coefficients": 100}, r"24\.\d GB .*`diagnosis: \{candidates: "),
    ],
)
def test_what_does_not_fit_is_refused_with_its_size_and_the_remedy(changed: dict[str, int], about: str) -> None:
    check_memory(SMALL, "campaign.yaml", 2_000_000_000)
    check_memory(Size(**{**vars(SMALL), **changed}), "campaign.yaml", None)
    with pytest.raises(CampaignError, match="campaign.yaml: would need about " + about):
        check_memory(Size(**{**vars(SMALL), **changed}), "campaign.yaml", 2_000_000_000)


def test_identify_refuses_before_it_fits_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = robots.write_campaign(tmp_path, robots.simulate(robots.ur10(), 60, np.random.default_rng(0), noise=1e-4))
    monkeypatch.setattr(pipeline, "available_memory", lambda: 10_000_000)
    assert identify.main([str(path), "-o", str(tmp_path / "results")]) == 2
    said = capsys.readouterr().err
    assert "would need about 0.3 GB of memory, and 0.0 GB are available" in said and "fitting" not in said
    assert not (tmp_path / "results").exists()


def test_the_system_says_how_much_memory_is_left() -> None:
    """Never more than there is."""
    there = available_memory()
    if not Path("/proc/meminfo").exists():
        assert there is None
        return
    total = next(int(line.split()[1]) for line in Path("/proc/meminfo").read_text().splitlines() if "MemTotal" in line)
    assert there is not None and 0 < there <= 1024 * total
