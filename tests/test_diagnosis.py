"""The loop: what a simulated machine lacks is found by name, sized, and nothing else is claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from aridcal.identify import identify
from aridcal.outcome import Outcome, errors
from aridcal.settings import load_settings
from aridcal.simulate import Scenario, simulate, write_campaign

ARID = Path(__file__).parent.parent / "urdf" / "arid.urdf"
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
             n: int = 240, seed: int = 1, outliers: float = 0.0, declared: float = SIGMA) -> Path:  # fmt: skip
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


def named(outcome: Outcome) -> set[tuple[str, str]]:
    return {(e.effect.kind, e.effect.where) for e in outcome.effects}


def error(outcome: Outcome, stage: str) -> float:
    return float(errors(outcome.stage(stage).residual, outcome.parts()["test"])["position_mm"]["rms"])


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_undeclared_effect_is_named_and_taken_away(tmp_path, kind):
    outcome = identify(campaign(tmp_path, [{"kind": kind, **EFFECTS[kind]}]))
    assert error(outcome, "geometric") > 1.3 * LEAST
    (found,) = outcome.effects
    alike = {(found.effect.kind, found.effect.where)} | {(t.kind, t.where) for t in found.confounded_with}
    assert (kind, EFFECTS[kind]["where"]) in alike
    assert error(outcome, "final") < 1.15 * LEAST
    assert outcome.verdict == "noise_floor"


@pytest.mark.parametrize("kind", ["rail_straightness", "rail_angular", "joint_map", "bearing_compliance", "drift"])
def test_a_declared_effect_is_fitted_as_it_is_declared(tmp_path, kind):
    truth = {"kind": kind, **EFFECTS[kind]}
    path = campaign(tmp_path, [truth])
    keys = yaml.safe_load(path.read_text())
    keys["effects"] = [{"kind": kind, "where": truth["where"]}]
    keys["diagnosis"] = {"enabled": False}
    path.write_text(yaml.safe_dump(keys))
    outcome = identify(path)
    assert named(outcome) == {(kind, str(truth["where"]))}
    assert all(e.declared for e in outcome.effects)
    assert error(outcome, "final") < 1.15 * LEAST


def test_an_effect_that_is_declared_twice_is_fitted_once(tmp_path):
    path = campaign(tmp_path, [{"kind": "joint_gain", **EFFECTS["joint_gain"]}])
    twice = {"diagnosis": {"enabled": False}, "effects": [{"kind": "joint_gain", "where": "joint_1"} for _ in range(2)]}
    path.write_text(path.read_text() + "".join(yaml.safe_dump({key: value}) for key, value in twice.items()))
    outcome = identify(path)
    found = [e for e in outcome.effects for c in e.effect.coefficients if c.name.startswith("joint_1.axis")]
    assert named(outcome) == {("joint_gain", "joint_1")}
    assert len(found) == 1
    assert error(outcome, "final") < 1.15 * LEAST


@pytest.mark.parametrize("seed", range(4))
def test_a_clean_machine_shows_no_effect_whatever_columns_were_logged(tmp_path, seed):
    logged = ("time", "temperature", "humidity", "payload", "joint_3_direction")
    outcome = identify(campaign(tmp_path, [], logged, seed=seed))
    assert not outcome.effects
    assert outcome.verdict == "noise_floor"
    assert error(outcome, "final") < 1.15 * LEAST


def test_gross_outliers_neither_create_nor_hide_an_effect(tmp_path):
    sag = {"kind": "joint_compliance", **EFFECTS["joint_compliance"]}
    (tmp_path / "sag").mkdir()
    (tmp_path / "clean").mkdir()
    assert named(identify(campaign(tmp_path / "sag", [sag], outliers=0.05))) == {("joint_compliance", "joint_3")}
    assert not named(identify(campaign(tmp_path / "clean", [], outliers=0.05)))


def test_three_effects_at_once_are_told_apart(tmp_path):
    kinds = ("joint_compliance", "thermal", "joint_coupling")
    outcome = identify(campaign(tmp_path, [{"kind": k, **EFFECTS[k]} for k in kinds]))
    assert named(outcome) == {(k, str(EFFECTS[k]["where"])) for k in kinds}
    assert error(outcome, "final") < 1.15 * LEAST


def test_a_shuffled_column_is_not_taken(tmp_path):
    path = campaign(tmp_path, [{"kind": "thermal", **EFFECTS["thermal"]}])
    rows = pd.read_csv(tmp_path / "measurements.csv", dtype=str)
    rows["temperature"] = np.random.default_rng(0).permutation(rows["temperature"])
    rows.to_csv(tmp_path / "measurements.csv", index=False)
    assert not any("temperature" in e.effect.covariates for e in identify(path).effects)


def test_a_function_of_two_columns_has_no_name_but_is_seen_and_said(tmp_path):
    twist = {"kind": "unknown", "where": "joint_3", "motion": "z", "form": "twist", "covariates": ["joint_4", "time"],
             "coefficients": 1e-3}  # fmt: skip
    outcome = identify(campaign(tmp_path, [twist]))
    assert outcome.verdict == "structure_remains"
    assert {e.effect.kind for e in outcome.effects} == {"unknown"}
    assert set(outcome.effects[0].effect.covariates) == {"joint_4", "time"}
    assert error(outcome, "final") < 0.5 * error(outcome, "geometric")


@pytest.mark.parametrize("wrong", [0.5, 2.0])
def test_noise_that_is_stated_two_times_off_is_noticed_and_said(tmp_path, wrong):
    outcome = identify(campaign(tmp_path, [], declared=wrong * SIGMA))
    said = [n for n in outcome.notices if "declared" in n and "noise" in n]
    assert {"position", "rotation"} <= {word for n in said for word in n.split()}
    assert all(("2.0 times" if wrong < 1 else "1/2.0") in n for n in said)


def test_rows_marked_test_choose_nothing(tmp_path):
    path = campaign(tmp_path, [{"kind": "joint_compliance", **EFFECTS["joint_compliance"]}])
    rows = pd.read_csv(tmp_path / "measurements.csv", dtype=str)
    rows["split"] = np.where(np.arange(len(rows)) % 4 == 3, "test", "train")
    rows.to_csv(tmp_path / "measurements.csv", index=False)
    before = identify(path)
    spoiled = rows["split"] == "test"
    rows.loc[spoiled, "z"] = (rows.loc[spoiled, "z"].astype(float) + 3e-4).astype(str)
    rows.to_csv(tmp_path / "measurements.csv", index=False)
    after = identify(path)
    np.testing.assert_array_equal(before.stage("final").fit.theta, after.stage("final").fit.theta)
    assert error(after, "final") > error(before, "final")


def test_thousands_of_rows_are_searched_on_some_and_fitted_on_all(tmp_path, monkeypatch):
    path = campaign(tmp_path, [{"kind": "joint_coupling", **EFFECTS["joint_coupling"]}], n=500)
    whole = identify(path)
    monkeypatch.setattr("aridcal.diagnosis.SEARCHED", 150)
    some = identify(path)
    assert named(some) == named(whole) == {("joint_coupling", "joint_3")}
    fits = [o.stage("final").fit for o in (some, whole)]
    assert len(fits[0].weight) == len(fits[1].weight)
    name = next(c.name for c in fits[0].model.coefficients if not c.basis.constant)
    values = [f.theta[f.model.names.index(name)] for f in fits]
    assert abs(values[0] - values[1]) < 0.1 * fits[0].std[fits[0].model.names.index(name)]
    assert fits[0].spent == pytest.approx(fits[1].spent, abs=0.5)
