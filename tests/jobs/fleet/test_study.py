"""Studies: the same machine in every case, what is found beside the truth, and intervals that hold what they say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
import yaml
from repository import ROOT
from scipy import stats

import aridcal
from aridcal.files.campaign import Campaign
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.fleet import trials as room
from aridcal.jobs.fleet.local_engine import run_tasks
from aridcal.jobs.fleet.study_figures import median, points, recurrent_effects, scatters, share
from aridcal.jobs.fleet.study_records import STUDY_SCHEMA, StudyResult, earlier_runs, studied
from aridcal.jobs.fleet.trials import Trial, half_of_rows, load_study, run_trial, search_in_words, trials
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.pages.study_page import study_page
from aridcal.runs.study_run import study_run
from aridcal.study import main
from aridcal.system.errors import CampaignError, OutputError
from aridcal.system.progress import SILENT

TEXT: dict[str, Any] = {
    "format": 1,
    "robot": {"urdf": str(ROOT / "urdf" / "arid.urdf"), "tip": "flange", "gravity": [0.0, 9.81, 0.0]},
    "measurements": {"kind": "pose", "noise": {"position": 1e-4, "rotation": 1e-4}},
    "parameters": {"set": "doty"},
    "diagnosis": {"candidates": ["joint_harmonic"]},
    "truth": {
        "n": 40,
        "parameters": {"joint_2.beta": {"std": 2e-3}},
        "effects": [{"kind": "joint_harmonic", "where": "joint_3", "order": 8, "coefficients": {"std": 3e-4}}],
        "frames": {
            "world_base": {"xyz": [6.2, -1.4, 3.1], "rpy": [1.58, 0.02, -2.3]},
            "tip_target": {"xyz": [0.35, 0.04, -0.06], "rpy": [0.3, -1.2, 0.5]},
        },
        "noise": {"position": 1e-4, "rotation": 1e-4},
    },
    "study": {"runs": 2, "rows": [30, 60], "sizes": [0, 1]},
}


def written(folder: Path, study: dict[str, Any] | None = None, **keys: Any) -> Path:
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(TEXT | keys | ({} if study is None else {"study": study})))
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudyResult]:
    folder = tmp_path_factory.mktemp("study")
    path = written(folder)
    every = trials(load_study(path))
    return path, studied(every, {}, folder, run_tasks, SILENT)


def test_every_case_has_its_runs_and_the_table_its_columns(done: tuple[Path, StudyResult]) -> None:
    path, found = done
    assert {(row["rows"], row["size"], row["run"]) for row in found.rows} == {
        (n, size, run) for n in (30, 60) for size in (0.0, 1.0) for run in (0, 1)
    }
    assert {row["status"] for row in found.rows} == {"done"}
    assert pyarrow.parquet.read_table(path.parent / "study.parquet").schema.names == STUDY_SCHEMA.names
    text = (ROOT / "docs" / "formats.md").read_text("utf-8").split("### Studies")[1]
    assert [name for name in STUDY_SCHEMA.names if f"`{name}`" not in text] == []


def test_an_effect_of_ten_times_the_noise_is_named_and_none_of_it_is_not(done: tuple[Path, StudyResult]) -> None:
    _, found = done
    assert {row["named"] for row in found.rows if row["size"] == 1.0 and row["rows"] == 60} == {True}
    assert {row["found"] for row in found.rows if row["size"] == 0.0} == {False}


def test_the_error_against_the_truth_is_what_another_road_gives(done: tuple[Path, StudyResult], tmp_path: Path) -> None:
    """The campaign written, read and calibrated from its files; the truth by asking the true robot without noise."""
    path, found = done
    row = next(row for row in found.rows if (row["rows"], row["size"]) == (60, 1.0))
    again = yaml.safe_load(path.read_text())
    again["truth"] |= {"n": 60, "seed": row["seed"]}
    del again["study"]
    results = []
    for name, noise in (("noisy", again["truth"]["noise"]), ("exact", {})):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "s.yaml").write_text(yaml.safe_dump(again | {"truth": again["truth"] | {"noise": noise}}))
        write_campaign(simulate(load_settings(folder / "s.yaml", Scenario)), folder, folder)
        results.append(folder / "campaign.yaml")
    outcome = identify(results[0])
    exact = np.genfromtxt(results[1].parent / "measurements.csv", delimiter=",", names=True)
    true = np.column_stack([exact[axis] for axis in "xyz"])
    m = outcome.measurements
    judge = m.test & ~outcome.outlier
    predicted = m.position[judge] - outcome.stages[-1].residual[judge, :3]
    rms = np.sqrt(np.mean(np.sum((true[m.origin.line[judge] - 2] - predicted) ** 2, axis=1)))
    assert row["true_rms_mm"] == pytest.approx(1e3 * rms, rel=1e-9)
    assert row["true_rms_mm"] < 1e3 * np.sqrt(
        np.mean(np.sum((m.position[judge] - true[m.origin.line[judge] - 2]) ** 2, axis=1))
    )


def test_the_same_run_has_the_same_machine_in_every_case_and_more_runs_keep_the_first(tmp_path: Path) -> None:
    few, more = (trials(load_study(written(tmp_path, {"runs": n, "rows": [30, 60], "sizes": [0, 1]}))) for n in (2, 3))
    assert len({t.seed for t in few.values()}) == 2
    assert set(few) < set(more)
    other = trials(load_study(written(tmp_path, {"runs": 2, "rows": [30, 60], "sizes": [0, 1], "seed": 1})))
    assert not set(few) & set(other)


def test_another_truth_is_another_study(tmp_path: Path) -> None:
    few = trials(load_study(written(tmp_path)))
    quieter = TEXT["truth"] | {"noise": {"position": 5e-5, "rotation": 1e-4}}
    assert not set(few) & set(trials(load_study(written(tmp_path, truth=quieter))))


def test_a_study_goes_on_where_it_was_and_does_failed_runs_again(
    done: tuple[Path, StudyResult], tmp_path: Path
) -> None:
    path, _ = done
    every = trials(load_study(path))
    known = earlier_runs(path.parent, every)
    assert len(known) == 8
    first = next(iter(every))
    again = studied(
        {first: every[first]}, {}, tmp_path, lambda work, tasks: iter([(n, work(t)) for n, t in tasks.items()]), SILENT
    )
    assert again.rows[0] | {"seconds": 0} == known[first] | {"seconds": 0}
    (tmp_path / "study.parquet").write_text("notes")
    with pytest.raises(OutputError, match="no table of a study"):
        earlier_runs(tmp_path, every)


@pytest.mark.parametrize(("keys", "said"), [
    ({"study": None}, "'study' is missing"),
    ({"study": {"runs": 1}}, "study.runs"),
    ({"study": {"sizes": [1], "effect": "joint_2.joint_gain"}}, "no 'joint_2.joint_gain'"),
    ({"study": {"effect": "joint_3.joint_harmonic"}}, "says which effect `sizes` are of"),
    ({"study": {"sizes": [1]}, "truth": TEXT["truth"] | {"effects": []}}, "there are 0 effects"),
    ({"truth": TEXT["truth"] | {"parameters": {"joint_9.x": 1}}}, "joint_9.x"),
])  # fmt: skip
def test_what_cannot_be_studied_is_refused_before_any_run(tmp_path: Path, keys: dict[str, Any], said: str) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in (TEXT | keys).items() if value is not None}))
    with pytest.raises(CampaignError, match=said):
        load_study(path)


# -- halves of a campaign's rows


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    keys = {key: value for key, value in TEXT.items() if key != "study"}
    keys |= {"diagnosis": {"enabled": False}, "truth": TEXT["truth"] | {"effects": [], "n": 60}}
    (folder / "s.yaml").write_text(yaml.safe_dump(keys))
    write_campaign(simulate(load_settings(folder / "s.yaml", Scenario)), folder, folder)
    path = folder / "campaign.yaml"
    path.write_text(path.read_text() + "study: {runs: 15}\n")
    return path


@pytest.fixture(scope="module")
def whole(campaign: Path) -> Outcome:
    return identify(campaign)


def test_halves_keep_all_held_out_rows_and_half_of_the_others(whole: Outcome) -> None:
    sizes, kept, every = [], [], whole.measurements
    for seed in range(2):
        rows = half_of_rows(seed)(every)
        assert set(rows.origin.line[rows.test]) == set(every.origin.line[every.test])
        sizes.append(int(rows.train.sum()))
        kept.append(frozenset(rows.origin.line[rows.train].tolist()))
    assert sizes == [math.ceil(every.train.sum() / 2)] * 2
    assert len(set(kept)) == 2


def test_constants_scatter_over_halves_as_the_whole_states(campaign: Path, whole: Outcome) -> None:
    """Independent noise alone: over halves the scatter is that of a fit of all rows, within what 15 runs can tell."""
    job = load_study(campaign)
    assert isinstance(job, Campaign)
    runs = [run_trial(trial) for trial in trials(job).values()]
    stated = {p["name"]: p["std"] for p in room.parameters(whole.stage("geometric").fit)}
    ratios = [s.scatter / stated[s.name] for s in scatters(runs)]
    assert len(ratios) >= 3
    assert 0.75 < float(np.sqrt(np.mean(np.square(ratios)))) < 1.3
    assert not any(s.name.startswith(("world_base", "tip_target")) for s in scatters(runs))
    page = study_page(StudyResult(tuple(runs), 0, 0, ""), "a campaign", search_in_words(job), True)
    assert "Are the constants known as well as stated?" in page
    assert "joint_2.beta" in page


def test_a_campaign_has_no_sizes(campaign: Path, tmp_path: Path) -> None:
    for more, said in (("sizes: [1]", "known truth"), ("rows: 30", "halves of its rows")):
        text = campaign.read_text().replace("runs: 15", more)
        path = campaign.with_name("other.yaml")
        path.write_text(text)
        with pytest.raises(CampaignError, match=said):
            load_study(path)


def test_other_commands_pass_over_the_block(campaign: Path, whole: Outcome) -> None:
    assert "study:" in campaign.read_text() and whole.verdict.word


# -- figures


def test_shares_and_medians_hold_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    held = [share(k, 20).low <= 0.3 <= share(k, 20).high for k in rng.binomial(20, 0.3, 2000)]
    assert np.mean(held) == pytest.approx(0.95, abs=0.03)  # Wilson's is right on average over shares, not for each
    for n in (8, 25):
        inside = [m.low <= 0.0 <= m.high for m in (median(x) for x in rng.standard_normal((2000, n)))]
        assert np.mean(inside) >= 0.94


def test_an_interval_of_a_scatter_is_that_of_the_chi_square(campaign: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [
        {"status": "done", "constants": [{"name": "joint_2.beta", "value": float(v), "std": 1.0, "unit": "rad"}]}
        for v in rng.standard_normal(25)
    ]
    (found,) = scatters(rows)
    low, high = (found.scatter * math.sqrt(24 / stats.chi2.ppf(p, 24)) for p in (0.975, 0.025))
    assert (found.low, found.high) == pytest.approx((low, high), rel=0.01)


def test_points_and_shares_count_what_was_done() -> None:
    def row(found: bool, others: int, status: str = "done", **more: Any) -> dict[str, Any]:
        return {"rows": 30, "size": 1.0, "status": status, "found": found, "named": False, "others": others,
                "final": 0.2, "true_rms_mm": 0.1, "effects": ["a"] * found} | more  # fmt: skip

    rows = [row(True, 0), row(True, 2), row(False, 0), row(False, 0, "failed")]
    (point,) = points(rows)
    assert point.finding_share is not None
    assert (point.runs, point.failed, point.finding_share.value, point.others.value) == (3, 1, 2 / 3, 1 / 3)
    assert [(label, s.value) for label, s in recurrent_effects(rows)] == [("a", 2 / 3)]
    assert points([row(False, 0, "failed")]) == []


def test_the_page_has_curves_and_intervals(done: tuple[Path, StudyResult]) -> None:
    page = study_page(done[1], "arid", search_in_words(load_study(done[0])), False)
    assert page.count('class="plot"') == 4
    assert "joint_harmonic at joint_3" in page
    assert "100 % (34 … 100)" in page  # two runs of two
    assert "is not drawn" not in page


def test_the_command_says_what_is_known(done: tuple[Path, StudyResult], capsys: pytest.CaptureFixture[str]) -> None:
    path, _ = done
    assert main([str(path), "-o", str(path.parent), "--scheduler", "tcp://127.0.0.1:9"]) == 0
    assert "8 of 8 runs done, 8 of them known already" in capsys.readouterr().out
    assert (path.parent / "study.html").is_file()


def test_python_has_what_the_command_says(done: tuple[Path, StudyResult]) -> None:
    path, found = done
    run = aridcal.study(path, path.parent, "tcp://127.0.0.1:9")  # all is known: nobody is asked
    assert repr(run) == "8 of 8 runs done, 8 of them known already"
    assert (len(run.runs), run.remaining) == (8, 0)
    cases = run.cases.set_index(["rows", "size"])
    assert list(cases.index) == [(n, size) for size in (0.0, 1.0) for n in (30, 60)]
    rows = [row for row in found.rows if (row["rows"], row["size"]) == (60, 1.0)]
    assert cases.loc[(60, 1.0), "found"] == np.mean([row["found"] for row in rows])
    assert cases.loc[(60, 1.0), "true"] == pytest.approx(np.median([row["true_rms_mm"] for row in rows]))
    assert (cases["found_low"] <= cases["found"]).all() and (cases["found"] <= cases["found_high"]).all()
    assert len(run.effects) == len(run.constants) == 0  # of machines of their own
    halves = [row | {"rows": None, "size": None} for row in found.rows]
    of_halves = study_run(StudyResult(tuple(halves), 0, 0, ""), path.parent)
    shares = dict(zip(of_halves.effects["effect"], of_halves.effects["share"], strict=True))
    assert shares == {label: share.value for label, share in recurrent_effects(found.rows)}
    assert list(of_halves.constants["name"]) == [s.name for s in scatters(found.rows)]


def test_a_run_that_fails_says_why(tmp_path: Path) -> None:
    path = written(tmp_path)
    trial = next(iter(trials(load_study(path)).values()))
    path.write_text(path.read_text().replace("joint_2.beta", "joint_8.beta"))
    row = run_trial(Trial(str(path), trial.case, 0, trial.seed, trial.key))
    assert row["status"] == "failed"
    assert "joint_8.beta" in row["error"]
