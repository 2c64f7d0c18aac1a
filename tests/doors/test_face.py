"""``import aridcal``: the ten lines that the start page promises, from a table to a result folder and back."""

from __future__ import annotations

import ast
import importlib
import inspect
import io
import json
import re
import subprocess
import sys
import typing
import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from repository import ROOT
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_info, threadpool_limits

import aridcal
from aridcal import api
from aridcal.files.yaml_file import parse_settings
from aridcal.jobs.fleet.local_engine import run_tasks
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.runs.result_folder import RESULT_FILES

UR10 = robots.URDF / "ur10.urdf"
UNDECLARED = robots.URDF.parent / "identification" / "arid-undeclared"
JOINTS = [f"A{k}" for k in range(1, 7)]
ANGLES = ["A", "B", "C"]
STD = [f"std_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")]
TRUTH = """
format: 1
robot: {{urdf: {urdf}, tip: tool0}}
truth:
  n: {n}
  seed: {seed}
  noise: {{position: 1.0e-4, rotation: 1.0e-4}}
  parameters: {{elbow_joint.x: 0.002, wrist_1_joint.roll: 0.003, shoulder_lift_joint.yaw: 0.002}}
  frames: {{world_base: {{xyz: [2, -1, 0.3], rpy: [0, 0, 2]}}, tip_target: {{xyz: [0.06, 0.02, 0.1], rpy: [0.3, 0, 1]}}}}
"""


def measured(n: int = 60, seed: int = 0) -> pd.DataFrame:
    """What a KUKA user would have measured: A1 … A6 in degrees, X Y Z in mm, A B C as Euler angles."""
    text = TRUTH.format(urdf=UR10, n=n, seed=seed)
    made = simulate(parse_settings(text, Path("scenario.yaml"), Scenario)).measurements
    table = pd.DataFrame(np.degrees(made.iloc[:, :6].to_numpy()), columns=JOINTS)
    table[["X", "Y", "Z"]] = 1e3 * made[["x", "y", "z"]]
    table[ANGLES] = Rotation.from_quat(made[["qx", "qy", "qz", "qw"]]).as_euler("ZYX", degrees=True)
    return table


@pytest.fixture(scope="module")
def campaign() -> aridcal.Campaign:
    """A table in memory, proposed, without a search."""
    campaign = aridcal.propose(UR10, measured())
    quick = campaign.diagnosis.model_copy(update={"enabled": False})
    return campaign.model_copy(update={"diagnosis": quick})


@pytest.fixture(scope="module")
def cal(campaign: aridcal.Campaign) -> aridcal.Calibration:
    return aridcal.calibrate(campaign)


@pytest.fixture(scope="module")
def found() -> aridcal.Calibration:
    """A campaign with an effect that nobody declared."""
    return aridcal.calibrate(str(UNDECLARED / "campaign.yaml"))


def test_importing_costs_nothing_until_it_is_used() -> None:
    """No numpy, no Pinocchio, no module of aridcal's own but the few lines on Ctrl-C: it cannot be slow on any machine."""
    said = "import aridcal, sys; dir(aridcal); print(*{name.partition('.')[0] for name in sys.modules}, *sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True).stdout.split()
    assert {"numpy", "pandas", "pinocchio", "pydantic", "rich", "scipy", "yaml"} & set(loaded) == set()
    assert [name for name in loaded if name.startswith("aridcal.")] == ["aridcal.system", "aridcal.system.interrupt"]


def test_every_name_is_there_and_no_other() -> None:
    for name in aridcal.__all__:
        assert getattr(aridcal, name) is not None
        assert name in dir(aridcal)
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        getattr(aridcal, "calibrat")  # noqa: B009


def test_type_checkers_know_the_same_names_and_all_their_types() -> None:
    """They read the imports of ``if TYPE_CHECKING``, which Python never runs."""
    tree = ast.parse(Path(aridcal.__file__).read_text("utf-8"))
    (guard,) = [node for node in tree.body if isinstance(node, ast.If)]
    told = {alias.name: node.module for node in guard.body for alias in node.names}
    assert sorted([*told, "__version__"]) == sorted(aridcal.__all__)
    for name, module in told.items():
        assert getattr(importlib.import_module(module), name) is getattr(aridcal, name)
    verbs = [aridcal.propose, aridcal.calibrate, aridcal.load]
    methods = [
        value for name, value in vars(aridcal.Calibration).items() if inspect.isfunction(value) and name[0] != "_"
    ]
    for function in [*verbs, *methods]:
        hints = typing.get_type_hints(function)
        assert set(hints) - {"return"} == set(inspect.signature(function).parameters) - {"self"}
        assert "return" in hints
    assert Path(aridcal.__file__).with_name("py.typed").is_file()


def test_a_proposal_says_what_it_guessed_and_asks_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    campaign = aridcal.propose(UR10, measured(20))
    said = " ".join(capsys.readouterr().out.split())
    assert "guessed shoulder_pan_joint = A1" in said and "found units = {angle: deg, length: mm}" in said
    assert "DataFrame: 20 usable rows, 0 refused" in said
    assert "euler: ZYX" in str(campaign)
    assert list(tmp_path.iterdir()) == []


def test_a_proposal_can_be_kept_as_files(
    cal: aridcal.Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As its own text says: itself as campaign.yaml, the table under the name that stands in it; all gives the same."""
    monkeypatch.chdir(tmp_path)
    table = measured()
    text = str(aridcal.propose(UR10, table))
    Path("campaign.yaml").write_text(f"{text}diagnosis: {{enabled: false}}\n")
    table.to_csv("measurements.csv", index=False)
    again = aridcal.calibrate("campaign.yaml")
    pd.testing.assert_frame_equal(again.errors, cal.errors, rtol=1e-9)


def test_errors_are_those_of_the_residuals_and_name_their_units(cal: aridcal.Calibration) -> None:
    outcome = cal.outcome
    assert list(cal.errors.index.levels[0]) == ["final", "geometric", "nominal"]
    test = outcome.parts()["test"]
    r = outcome.stage("final").residual[test]
    rms = np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1)))
    assert cal.errors.loc[("final", "test"), "position_rms_mm"] == pytest.approx(1e3 * rms)
    assert cal.errors.loc[("final", "test"), "rotation_max_mrad"] == pytest.approx(
        1e3 * np.linalg.norm(r[:, 3:], axis=1).max()
    )
    assert all(name.endswith(("_mm", "_mrad")) for name in cal.errors)
    assert (
        cal.errors.loc[("final", "test"), "position_rms_mm"]
        < 0.25
        < cal.errors.loc[("nominal", "test"), "position_rms_mm"]
    )


def test_parameters_name_what_was_identified(cal: aridcal.Calibration) -> None:
    table, fit = cal.parameters, cal.outcome.stage("geometric").fit
    fitted = dict(zip(fit.model.names, zip(fit.theta, fit.std, strict=True), strict=True))
    assert set(table.index[table["status"] == "identified"]) == set(fitted)
    for name, (value, std) in fitted.items():
        if not name.startswith(("world_base", "tip_target")):  # of frames the table gives the frame itself
            unit, other = ("mrad", "mm") if name.endswith(("roll", "pitch", "yaw")) else ("mm", "mrad")
            assert table.loc[name, f"value_{unit}"] == pytest.approx(1e3 * value)
            assert table.loc[name, f"std_{unit}"] == pytest.approx(1e3 * std)
            assert np.isnan(table.loc[name, f"value_{other}"])
    assert table.loc["world_base.x", "value_mm"] == pytest.approx(2000, abs=5)
    lost = table[table["status"] == "redundant"]
    assert len(lost) and lost["redundant_with"].str.len().min() > 0 and lost["std_mm"].isna().all()


def test_a_second_look_is_a_table_as_well(cal: aridcal.Calibration) -> None:
    assert cal.outcome is not None
    looked = cal.outcome.second_look
    assert looked is not None and looked.identifiability is not None and looked.influence is not None
    combinations = cal.combinations
    assert list(combinations) == [*looked.identifiability.names, "std"]
    assert combinations["std"].is_monotonic_increasing
    first = looked.identifiability.combinations[0]
    assert combinations.loc[0, first.parts[0][0]] == first.parts[0][1]
    rows = cal.influence
    assert rows["shift_mm"].is_monotonic_decreasing and len(rows) == 20
    train = np.flatnonzero(cal.outcome.measurements.train)
    k = train[looked.influence.rows[0]]
    assert rows.index[0][1] == cal.outcome.measurements.origin.line[k]
    assert rows["deciding"].sum() == len(looked.influence.deciding)


def test_a_stage_fitted_again_with_the_final_flags_keeps_the_count_of_its_restarts(found: aridcal.Calibration) -> None:
    assert found.outcome is not None
    constants = found.outcome.stage("geometric").fit.convergence
    assert constants.restarts == constants.agreed >= 1
    said = found.result["convergence"]["geometric"]
    assert (said["restarts"], said["restarts_agreed"]) == (constants.restarts, constants.agreed)


def test_effects_name_their_gain(found: aridcal.Calibration, cal: aridcal.Calibration) -> None:
    assert cal.effects.empty and list(cal.effects)[:2] == ["kind", "where"]
    (effect,) = found.effects.to_dict("records")
    assert (effect["kind"], effect["where"], effect["declared"]) == ("joint_compliance", "joint_3", False)
    assert effect["position_rms_after_mm"] == pytest.approx(found.errors.loc[("final", "test"), "position_rms_mm"])
    assert effect["position_rms_before_mm"] > 3 * effect["position_rms_after_mm"]


def test_it_shows_itself_in_a_few_lines(found: aridcal.Calibration) -> None:
    lines = repr(found).splitlines()
    assert lines[0] == "Calibration of arid: error on 60 held-out rows"
    assert [line.split()[0] for line in lines[2:5]] == ["nominal", "geometric", "final"]
    assert "effects: joint_compliance at joint_3" in lines
    assert any(line.startswith("verdict: noise_floor: ") for line in lines)
    assert len(lines) < 15 and max(map(len, lines)) < 200
    shown = found._repr_html_()
    assert shown.count("<tr>") == 3 and "joint_compliance at joint_3" in shown and "<b>Calibration of arid" in shown


def test_what_a_notebook_shows_is_escaped(cal: aridcal.Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    hostile = cal.result | {"notices": ["<script>alert(1)</script>"]}
    monkeypatch.setitem(cal.__dict__, "result", hostile)
    assert "<script>" not in cal._repr_html_()


def test_another_day_is_scored_as_the_command_scores_it(cal: aridcal.Calibration, tmp_path: Path) -> None:
    other = measured(30, seed=5)
    found = cal.verify(other)
    assert (found.file, found.rows) == ("DataFrame", 30)
    assert list(found.errors.index) == ["nominal", "geometric", "final", "realigned"]
    p = cal.predict(other)[["X", "Y", "Z"]].to_numpy()
    rms = np.sqrt(np.mean(np.sum((p - other[["X", "Y", "Z"]].to_numpy()) ** 2, axis=1)))
    assert found.errors.loc["final", "position_rms_mm"] == pytest.approx(rms, rel=1e-6)
    other.to_csv(tmp_path / "other.csv", index=False)
    pd.testing.assert_frame_equal(cal.verify(tmp_path / "other.csv").errors, found.errors, rtol=1e-9)
    assert "other.csv: 30 rows of another day" in repr(cal.verify(tmp_path / "other.csv"))


def test_poses_and_joints_speak_the_campaigns_dialect_and_go_round(cal: aridcal.Calibration) -> None:
    queries = measured(15, seed=3).drop(columns=["X", "Y", "Z", *ANGLES])
    queries.index = range(100, 115)
    kept = queries.copy()
    poses = cal.predict(queries)
    assert list(poses) == [*JOINTS, "X", "Y", "Z", *ANGLES, *STD, "extrapolates"]
    assert list(poses.index) == list(queries.index)
    pd.testing.assert_frame_equal(queries, kept)
    joints = cal.compensate(poses.drop(columns=JOINTS), seed=queries + 0.5)
    assert joints["reached"].all() and joints[JOINTS].dtypes.eq(float).all()
    back = cal.predict(joints)
    np.testing.assert_allclose(back[["X", "Y", "Z"]], poses[["X", "Y", "Z"]], rtol=0, atol=1e-4)
    turn = Rotation.from_euler("ZYX", back[ANGLES], degrees=True)
    assert (turn * Rotation.from_euler("ZYX", poses[ANGLES], degrees=True).inv()).magnitude().max() < 1e-7


def test_files_are_taken_wherever_frames_are(cal: aridcal.Calibration, tmp_path: Path) -> None:
    queries = measured(8, seed=3).drop(columns=["X", "Y", "Z", *ANGLES]).assign(note="a")
    queries.to_csv(tmp_path / "q.csv", index=False, float_format="%.17g")
    poses = cal.predict(str(tmp_path / "q.csv"))
    pd.testing.assert_frame_equal(poses, cal.predict(queries), check_dtype=False, check_exact=True)
    poses.to_parquet(tmp_path / "poses.parquet")
    joints = cal.compensate(tmp_path / "poses.parquet", seed=tmp_path / "q.csv")
    pd.testing.assert_frame_equal(joints, cal.compensate(poses, seed=queries), check_dtype=False, rtol=1e-12)


def test_seeds_are_where_the_search_starts(cal: aridcal.Calibration) -> None:
    """Of the two ways in which the wrist reaches a pose, the one near the seed is found."""
    rng = np.random.default_rng(8)
    queries = pd.DataFrame(
        rng.uniform([-90, -90, 80, -90, 30, -90], [90, -30, 110, 90, 80, 90], (6, 6)), columns=JOINTS
    )
    poses = cal.predict(queries)
    flipped = queries.assign(A4=queries["A4"] + 180, A5=-queries["A5"], A6=queries["A6"] + 180)
    joints = cal.compensate(poses, seed=flipped)
    assert joints["reached"].all()
    np.testing.assert_array_equal(np.sign(joints["A5"]), -np.sign(queries["A5"]))


@pytest.mark.parametrize(
    ("seed", "why"),
    [(lambda q: q[:2], "2 rows of seeds for 4 poses"), (lambda q: q.drop(columns="A3"), "no column 'A3'")],
)
def test_seeds_that_do_not_fit_are_refused(cal: aridcal.Calibration, seed, why: str) -> None:
    queries = measured(4, seed=3)[JOINTS]
    with pytest.raises(aridcal.AridcalError, match=why):
        cal.compensate(cal.predict(queries), seed=seed(queries))


def test_rows_without_an_answer_are_named_in_a_warning(cal: aridcal.Calibration) -> None:
    queries = measured(4, seed=3)[JOINTS]
    queries.loc[2, "A2"] = np.nan
    with pytest.warns(UserWarning, match=r"DataFrame, line 4: column 'A2': empty"):
        poses = cal.predict(queries)
    assert poses["X"].isna().tolist() == [False, False, True, False]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cal.predict(queries.dropna())


def test_what_is_saved_is_what_the_command_writes(found: aridcal.Calibration, tmp_path: Path) -> None:
    from aridcal.identify import main

    found.save(tmp_path / "face")
    assert main([str(UNDECLARED / "campaign.yaml"), "--out", str(tmp_path / "command")]) == 0
    names = {path.name for path in (tmp_path / "command").iterdir()}
    assert {path.name for path in (tmp_path / "face").iterdir()} == names
    assert {"report.html", "scene.html", "calibration.yaml", "model.urdf", "frames.yaml"} < names <= RESULT_FILES
    for name in names - {"result.json"}:
        assert (tmp_path / "face" / name).read_bytes() == (tmp_path / "command" / name).read_bytes(), name
    results = [json.loads((tmp_path / way / "result.json").read_text()) for way in ("face", "command")]
    assert results[0] | {"seconds": 0} == results[1] | {"seconds": 0}


def test_a_failed_save_leaves_nothing(
    cal: aridcal.Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aridcal.jobs.calibrate.controllers.write_controllers", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cal.save(tmp_path / "results")
    assert list(tmp_path.iterdir()) == []


def test_what_is_loaded_is_what_was_saved(found: aridcal.Calibration, tmp_path: Path) -> None:
    found.save(tmp_path / "results")
    loaded = aridcal.load(tmp_path / "results")
    for table in ("errors", "effects", "parameters"):
        pd.testing.assert_frame_equal(getattr(loaded, table), getattr(found, table), check_exact=True)
    assert repr(loaded) == repr(found)
    queries = pd.read_csv(UNDECLARED / "measurements.csv")[:20]
    pd.testing.assert_frame_equal(loaded.predict(queries), found.predict(queries), rtol=1e-12)
    assert loaded.report().html == (tmp_path / "results" / "report.html").read_text()
    assert loaded.scene().html == (tmp_path / "results" / "scene.html").read_text()
    for name in ("verify", "save"):
        with pytest.raises(aridcal.AridcalError, match=rf"`{name}` needs the measurements .*`aridcal\.calibrate"):
            getattr(loaded, name)(tmp_path / "m.csv")


def test_the_model_file_alone_predicts_and_says_what_it_lacks(found: aridcal.Calibration, tmp_path: Path) -> None:
    (tmp_path / "calibration.yaml").write_text(found.model.dump())
    alone = aridcal.load(tmp_path / "calibration.yaml")
    queries = pd.read_csv(UNDECLARED / "measurements.csv")[:5]
    pd.testing.assert_frame_equal(alone.predict(queries), found.predict(queries), rtol=1e-12)
    assert repr(alone) == "Calibration of arid: the model alone, without its figures"
    assert repr(alone) in alone._repr_html_()
    for look in (lambda: alone.errors, lambda: alone.parameters, lambda: alone.effects, alone.report, alone.scene):
        with pytest.raises(aridcal.AridcalError, match="Load the whole result folder, or calibrate again"):
            look()


def test_a_calibration_that_is_not_there_is_answered_with_the_way_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(aridcal.AridcalError, match="there is no such file"):
        aridcal.load(tmp_path)


def test_pages_are_shown_in_a_frame_and_saved_where_asked(found: aridcal.Calibration, tmp_path: Path) -> None:
    report = found.report(tmp_path / "pages" / "report.html")
    assert (tmp_path / "pages" / "report.html").read_text("utf-8") == report.html
    assert report.html.startswith("<!DOCTYPE html>") and "joint_3" in report.html
    shown = report._repr_html_()
    inside = re.fullmatch(r'<iframe srcdoc="([^"]*)" .*></iframe>', shown, re.DOTALL)
    assert inside and "<" not in inside[1]
    assert "meshcat" in found.scene().html.lower()
    assert len(repr(report)) < 80


def test_calibrating_writes_nothing_and_is_silent_where_nobody_looks(
    campaign: aridcal.Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    aridcal.calibrate(campaign)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_terminal_shows_the_progress(
    campaign: aridcal.Campaign, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    aridcal.calibrate(campaign)
    assert "fitting frames and constants to" in capsys.readouterr().err


def test_a_notebook_shows_the_progress_on_one_line(campaign: aridcal.Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []

    class Handle:
        def update(self, data: dict[str, str], raw: bool) -> None:
            shown.append(data["text/plain"])

    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr("IPython.display.display", lambda *_, **__: Handle())
    aridcal.calibrate(campaign)
    assert any("fitting frames and constants" in line for line in shown)
    assert shown[-1].endswith("done")


def test_a_calibration_of_positions_says_nothing_of_orientations(tmp_path: Path) -> None:
    table = measured(80).drop(columns=ANGLES)
    campaign = aridcal.propose(str(UR10), table)
    quick = campaign.diagnosis.model_copy(update={"enabled": False})
    cal = aridcal.calibrate(campaign.model_copy(update={"diagnosis": quick}))
    assert not any("rotation" in name for name in (*cal.errors, *cal.effects))
    poses = cal.predict(table[JOINTS])
    assert list(poses) == [*JOINTS, "X", "Y", "Z", *STD[:3], "extrapolates"]
    assert "rotation_error" not in cal.compensate(poses)


API = ROOT / "docs" / "api.md"


def test_what_the_page_on_python_shows_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its blocks from top to bottom, in a folder with the files that they name."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.urdf").write_bytes(UR10.read_bytes())
    measured().to_csv("measurements.csv", index=False)
    measured(20, seed=5).to_csv("other_day.csv", index=False)
    measured(5, seed=3)[JOINTS].to_csv("queries.csv", index=False)
    quick = f"{TRUTH.format(urdf=UR10, n=25, seed=1)}diagnosis: {{enabled: false}}\n"
    (tmp_path / "scenario.yaml").write_text(f"{quick}study: {{runs: 2}}\n")
    for name in ("left", "right"):
        (tmp_path / "robots" / name).mkdir(parents=True)
        write_campaign(
            simulate(parse_settings(quick, tmp_path / "s.yaml", Scenario)), *[tmp_path / "robots" / name] * 2
        )
    for module in ("fleet_run", "study_run"):  # processes would take longer to start than to work
        monkeypatch.setattr(sys.modules[f"aridcal.runs.{module}"], "dask_engine", lambda *_: nullcontext(run_tasks))
    text = API.read_text("utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    loads = next(k for k, block in enumerate(blocks) if "aridcal.load(" in block)
    assert loads < len(blocks) - 1  # later blocks need the measurements: the next one calibrates again
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)
    assert names["command"].reached
    assert (tmp_path / "results" / "report.html").is_file() and (tmp_path / "scene.html").is_file()


def test_the_reference_names_what_there_is() -> None:
    blocks = re.findall(r"^::: ([\w.]+)(?:\n +options: \{members: \[(.*)\]\})?", API.read_text("utf-8"), re.MULTILINE)
    assert len(blocks) > 10
    for module, members in blocks:
        there = vars(importlib.import_module(module))
        for member in filter(None, members.split(", ")):
            assert getattr(there[member], "__module__", module) == module, f"{module}.{member}"


def test_calibrating_from_python_uses_one_thread_of_linear_algebra_and_gives_the_others_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def threads() -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    seen: list[set[int]] = []

    def stopped(*_: object, **__: object) -> None:
        seen.append(threads())
        raise aridcal.AridcalError("enough")

    monkeypatch.setattr(api, "identify", stopped)
    with threadpool_limits(2, user_api="blas"):
        with pytest.raises(aridcal.AridcalError, match="enough"):
            aridcal.calibrate("campaign.yaml")
        assert threads() == {2}
    assert seen == [{1}]
