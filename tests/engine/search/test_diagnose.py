"""The loop: what a simulated machine lacks is found by name, sized, and nothing else is claimed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import yaml
from repository import ROOT
from scipy.spatial.transform import Rotation
from searched import searched

from aridcal.engine.search import diagnose
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.outcome import Outcome, errors
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign

ARID = ROOT / "urdf" / "arid.urdf"
SIGMA = 1e-4
LEAST = 1e3 * SIGMA * np.sqrt(3)  # RMS of the noise alone, mm

EFFECTS: dict[str, dict[str, object]] = {
    "joint_gain": {"where": "joint_1", "coefficients": 1e-4},
    "joint_harmonic": {"where": "joint_3", "order": 2, "coefficients": {"std": 1e-3}},
    "joint_map": {"where": "joint_2", "coefficients": {"std": 3e-4}},
    "joint_backlash": {"where": "joint_2", "by": "direction", "coefficients": 2e-4},
    "joint_compliance": {"where": "joint_3", "coefficients": 3e-6},
    "bearing_compliance": {"where": "joint_1", "motion": "yaw", "coefficients": [1e-6, 0, 2e-6]},
    "axis_wobble": {"where": "joint_2", "order": 1, "motion": ["r1", "r2"], "coefficients": {"std": 2e-3}},
    "rail_straightness": {"where": "joint_1", "motion": "t1", "form": "bow", "coefficients": 1e-3},
    "rail_angular": {"where": "joint_1", "motion": "roll", "coefficients": {"std": 3e-4}},
    "joint_coupling": {"where": "joint_3", "with": "joint_4", "coefficients": 1e-3},
    "thermal": {"where": "joint_3", "motion": "x", "coefficients": 1e-4},
    "drift": {"where": "world_base", "motion": "y", "coefficients": 1e-7},
    "payload_compliance": {
        "where": "joint_2", "covariates": "joint_2.payload_torque", "motion": "axis", "coefficients": 1e-5,
    },
}  # fmt: skip


def campaign(folder: Path, effects: list[dict[str, object]], covariates: tuple[str, ...] = ("time", "temperature"),
             n: int = 200, seed: int = 1, outliers: float = 0.0, declared: float = SIGMA) -> Path:  # fmt: skip
    """A simulated ARID with constants a millimetre off and some effects of which the campaign says nothing."""
    constants = {f"joint_{k}.{c}": {"std": 1e-3} for k in (2, 3, 4) for c in ("x", "roll", "pitch")}
    scenario = {
        "format": 1,
        "robot": {"urdf": str(ARID), "base": "base_link", "tip": "flange", "gravity": [0.0, 9.81, 0.0]},
        "measurements": {"kind": "pose", "noise": {"position": declared, "rotation": declared}},
        "truth": {
            "n": n, "seed": seed, "parameters": constants, "noise": {"position": SIGMA, "rotation": SIGMA},
            "outliers": {"share": outliers, "size": 50}, "effects": effects, "covariates": list(covariates),
        },
    }  # fmt: skip
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(scenario))
    write_campaign(simulate(load_settings(path, Scenario)), folder, folder)
    return folder / "campaign.yaml"


def changed(path: Path, **sections: object) -> Path:
    """Replace sections of a campaign."""
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | sections))
    return path


def named(outcome: Outcome) -> set[tuple[str, str]]:
    return {(e.effect.kind, e.effect.where) for e in outcome.effects}


def error(outcome: Outcome, stage: str) -> float:
    return float(errors(outcome.stage(stage).residual, outcome.parts()["test"], outcome.channels)["position_mm"]["rms"])


TOGETHER = [
    ("joint_compliance", "thermal", "joint_coupling"),
    ("rail_straightness", "joint_backlash", "bearing_compliance"),
    ("joint_map", "drift", "joint_gain"),
    ("axis_wobble", "payload_compliance", "joint_harmonic"),
    ("rail_angular",),
]
"""Every kind once."""


@pytest.mark.parametrize("kinds", TOGETHER, ids="-".join)
def test_undeclared_effects_are_told_apart_by_name_and_taken_away(tmp_path, kinds):
    found = searched(campaign(tmp_path, [{"kind": kind, **EFFECTS[kind]} for kind in kinds]))
    assert found.error("geometric") > 1.3 * LEAST
    assert found.named == {(kind, str(EFFECTS[kind]["where"])) for kind in kinds}
    assert found.error("final") < 1.15 * LEAST
    assert found.verdict == "noise_floor"


def test_no_kind_is_left_out_of_those_that_are_searched_for():
    assert sorted(kind for kinds in TOGETHER for kind in kinds) == sorted(EFFECTS)


def test_declared_effects_are_fitted_as_they_are_declared_and_once_each(tmp_path):
    kinds = ("joint_map", "drift", "joint_gain")
    path = campaign(tmp_path, [{"kind": kind, **EFFECTS[kind]} for kind in kinds])
    declared = [{"kind": kind, "where": EFFECTS[kind]["where"]} for kind in (*kinds, "joint_gain")]
    outcome = identify(changed(path, effects=declared, diagnosis={"enabled": False}))
    assert named(outcome) == {(kind, str(EFFECTS[kind]["where"])) for kind in kinds}
    assert len([c for e in outcome.effects for c in e.effect.coefficients if c.name.startswith("joint_1.axis")]) == 1
    assert all(e.declared for e in outcome.effects)
    assert error(outcome, "final") < 1.15 * LEAST


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """A machine without effects, of which all kinds of columns were logged."""
    logged = ("time", "temperature", "humidity", "payload", "joint_3_direction")
    return identify(campaign(tmp_path_factory.mktemp("clean"), [], logged))


def test_a_clean_machine_shows_no_effect_whatever_columns_were_logged(clean):
    outcome = clean
    assert not outcome.effects
    assert outcome.verdict.word == "noise_floor"
    assert error(outcome, "final") < 1.15 * LEAST


def test_a_machine_of_which_all_constants_are_known_may_lack_an_effect_all_the_same(tmp_path):
    """Both frames known, no constants asked for: a rail that is longer than its scale says is all that is found."""
    rng = np.random.default_rng(0)
    world, tip = robots.random_placement(rng), robots.random_placement(rng, 0.2)
    truth = robots.simulate(robots.arid(), 120, rng, 0.0, world=world, tip=tip)
    longer = 1e-4 * (truth.readings - truth.readings.mean(axis=0)) * [1.0, 0.0, 0.0, 0.0]
    R, p = truth.model.poses(truth.theta, truth.model.rows(truth.readings + longer))
    p = p + SIGMA * rng.normal(size=p.shape)
    R = Rotation.from_rotvec(SIGMA * rng.normal(size=p.shape)).as_matrix() @ R
    truth = replace(truth, measured=robots.measured(truth.model.robot, truth.readings, p, R))
    frames = {
        name: {"xyz": T.translation.tolist(), "rpy": pin.rpy.matrixToRpy(T.rotation).tolist(), "identify": False}
        for name, T in (("world_base", world), ("tip_target", tip))
    }
    kinds = {"candidates": ["joint_gain", "joint_harmonic", "joint_coupling"]}
    path = robots.write_campaign(tmp_path, truth, frames=frames, parameters={"set": "none"}, diagnosis=kinds)
    found = searched(path)
    assert found.named == {("joint_gain", "joint_1")}
    fit = found.fit
    assert [c.where for c in fit.model.coefficients] == ["joint_1"]
    assert fit.theta[0] == pytest.approx(1e-4, abs=4 * fit.std[0])
    assert found.error("final") < 1.15 * LEAST


def test_gross_outliers_neither_create_nor_hide_an_effect(tmp_path):
    sag = {"kind": "joint_compliance", **EFFECTS["joint_compliance"]}
    (tmp_path / "sag").mkdir()
    (tmp_path / "clean").mkdir()
    assert searched(campaign(tmp_path / "sag", [sag], outliers=0.05)).named == {("joint_compliance", "joint_3")}
    assert not searched(campaign(tmp_path / "clean", [], outliers=0.05)).named


@pytest.mark.parametrize(("where", "twice"), [("joint_1", "joint_1.z"), ("joint_2", "joint_2.yaw")])
def test_motions_of_a_declared_effect_that_no_row_tells_from_its_others_are_left_out_by_name(
    tmp_path: Path, where: str, twice: str
) -> None:
    """All motions at a joint: its axis and one of its bearing are the same. The others are fitted as if declared by name."""
    path = campaign(tmp_path, [{"kind": "thermal", **EFFECTS["thermal"]}], n=60)
    off: dict[str, object] = {"enabled": False}
    every = identify(changed(path, effects=[{"kind": "thermal", "where": where}], diagnosis=off))
    (effect,) = every.effects
    (said,) = [notice for notice in every.notices if "is left out" in notice]
    assert said.startswith(f"{twice}:temperature, of the declared thermal at {where}, is left out: it is confounded")
    motion = list(dict.fromkeys(c.component for c in effect.effect.coefficients))
    assert len(motion) == 6 and twice.partition(".")[2] not in motion
    named = searched(changed(path, effects=[{"kind": "thermal", "where": where, "motion": motion}], diagnosis=off))
    assert not named.arm.diagnosed.barred
    for c in effect.effect.coefficients:
        mine, theirs = (fit.std[fit.model.names.index(c.name)] for fit in (every.stages[-1].fit, named.fit))
        assert mine == pytest.approx(theirs, rel=1e-6)
        assert mine < 1e-3
    assert error(every, "final") == pytest.approx(named.error("final"), rel=1e-6)


def test_a_shuffled_column_is_not_taken(tmp_path):
    path = campaign(tmp_path, [{"kind": "thermal", **EFFECTS["thermal"]}])
    rows = pd.read_csv(tmp_path / "measurements.csv", dtype=str)
    rows["temperature"] = np.random.default_rng(0).permutation(rows["temperature"])
    rows.to_csv(tmp_path / "measurements.csv", index=False)
    found = searched(changed(path, diagnosis={"candidates": ["thermal", "drift", "unknown"]}))
    assert not any("temperature" in effect.covariates for effect in found.effects)


def test_a_function_of_two_columns_has_no_name_but_is_seen_and_said(tmp_path):
    twist = {"kind": "unknown", "where": "joint_3", "motion": "z", "form": "twist", "covariates": ["joint_4", "time"],
             "coefficients": 1e-3}  # fmt: skip
    found = searched(campaign(tmp_path, [twist]))
    assert found.verdict == "structure_remains"
    assert {effect.kind for effect in found.effects} == {"unknown"}
    assert set(found.effects[0].covariates) == {"joint_4", "time"}
    assert found.error("final") < 0.5 * found.error("geometric")


@pytest.mark.parametrize("wrong", [0.5, 2.0])
def test_noise_that_is_stated_two_times_off_is_noticed_and_said(tmp_path, clean, wrong):
    off: dict[str, object] = {"enabled": False}
    outcome = identify(changed(campaign(tmp_path, [], declared=wrong * SIGMA), diagnosis=off))
    said = sorted(set(outcome.notices) - set(clean.notices))
    assert len(said) == 2
    for notice, channel in zip(
        sorted(said, key=lambda notice: "rotation" in notice), ("position", "rotation"), strict=True
    ):
        times = re.search(rf"the residual is ([\d.]+) times the declared {channel} noise", notice)
        assert times is not None
        assert float(times[1]) == pytest.approx(1 / wrong, rel=0.1)


def test_rows_marked_test_choose_nothing(tmp_path):
    path = campaign(tmp_path, [{"kind": "joint_compliance", **EFFECTS["joint_compliance"]}])
    rows = pd.read_csv(tmp_path / "measurements.csv", dtype=str)
    rows["split"] = np.where(np.arange(len(rows)) % 4 == 3, "test", "train")
    rows.to_csv(tmp_path / "measurements.csv", index=False)
    before = searched(changed(path, diagnosis={"candidates": ["joint_compliance", "joint_gain", "joint_harmonic"]}))
    spoiled = rows["split"] == "test"
    rows.loc[spoiled, "z"] = (rows.loc[spoiled, "z"].astype(float) + 3e-4).astype(str)
    rows.to_csv(tmp_path / "measurements.csv", index=False)
    after = searched(path)
    np.testing.assert_array_equal(before.fit.theta, after.fit.theta)
    assert after.error("final") > before.error("final")


def test_what_is_found_on_some_of_many_rows_is_fitted_to_all_of_them(tmp_path, monkeypatch):
    """As if it had been declared, and nothing been sought."""
    monkeypatch.setattr(diagnose, "MOST_SEARCHED_ROWS", 300)
    path = campaign(tmp_path, [{"kind": "joint_coupling", **EFFECTS["joint_coupling"]}], (), n=600)
    found = searched(changed(path, diagnosis={"candidates": ["joint_coupling", "joint_gain", "joint_compliance"]}))
    known = {"kind": "joint_coupling", "where": "joint_3", "with": "joint_4"}
    stated = searched(changed(path, effects=[known], diagnosis={"enabled": False}))
    assert found.named == stated.named == {("joint_coupling", "joint_3")}
    one, other = found.fit, stated.fit
    assert len(one.weight) == len(other.weight) == 480
    assert one.model.names == other.model.names
    assert np.abs((one.theta - other.theta) / other.std).max() < 0.1
    np.testing.assert_allclose(one.std, other.std, rtol=0.05)
