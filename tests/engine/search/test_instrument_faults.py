"""What instruments do otherwise than stated: found by name and size where rows tell it, and invented nowhere.

Campaigns are simulated with the fault, read from their files and searched blind, all kinds of effects being candidates.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import robots
import yaml
from repository import ROOT
from scipy.integrate import quad
from searched import Searched, searched

from aridcal.engine.corrections.basis import evaluate
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.sights import LENGTH, PLATE_COORDINATES, SAG, Sights, sight_table, target_places
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import with_things_moved
from aridcal.engine.robot.kinematics import along_plane
from aridcal.files.campaign import JobSettings
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.folder import step_in_words
from aridcal.jobs.calibrate.instrument_results import thing_values
from aridcal.jobs.calibrate.pipeline import identify, refit_with_final_instruments
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, truth_document, write_campaign
from aridcal.system.errors import CampaignError

UR10 = {"urdf": str(ROOT / "urdf" / "ur10.urdf"), "tip": "tool0"}
NOISE = {"position": 5e-5, "rotation": 5e-5, "distance": 5e-5, "pixel": 0.1, "inclination": 1e-4}
TRUTH = {
    "seed": 1,
    "frames": {"tip_target": {"xyz": [0.04, -0.03, 0.12], "rpy": [0.3, 0.2, 0.1]}},
    "parameters": {"elbow_joint.x": 2e-3, "wrist_1_joint.pitch": 1e-3, "shoulder_lift_joint.yaw": -1e-3},
    "noise": NOISE,
}
WIRES = {"anchors": {"w1": {}, "w2": {}, "w3": {}}}
PLATES = {"planes": {"table": {"normal": [0, 0, 1]}, "wall": {"normal": [1, 0, 0]}, "side": {"normal": [0, 1, 0]}}}
EYE = {"fx": 700, "fy": 690, "cx": 330, "cy": 235, "width": 640, "height": 480}
Found = Callable[[str], tuple[Searched, list[float]]]
LASER = {"kind": "position", "name": "laser"}
POSE = {"kind": "pose", "name": "laser"}


@dataclass(frozen=True)
class Case:
    """A campaign, and the faults that it has."""

    measurements: object
    instruments: dict
    n: int
    effects: tuple[dict, ...]
    real: dict


BENT = {"kind": "flatness", "where": "table", "coefficients": [2e-3, -1e-3, 3e-3]}
CASES = {
    "a tracker's scale, beside wires": Case(
        [LASER, {"kind": "distance"}], WIRES, 60,
        ({"kind": "tracker_scale", "where": "laser", "coefficients": 4e-4},), {},
    ),
    "a tracker's range, beside wires": Case(
        [LASER, {"kind": "distance"}], WIRES, 60,
        ({"kind": "range_error", "where": "laser", "coefficients": 5e-4},), {},
    ),
    "a wire's scale, and another's sag": Case(
        {"kind": "distance"}, WIRES, 110,
        (
            {"kind": "distance_scale", "where": "w2", "coefficients": 1e-3},
            {"kind": "wire_sag", "where": "w3", "coefficients": 3e-4},
        ), {},
    ),
    "a bent plate, and another that was knocked": Case(
        {"kind": "plane"}, PLATES, 160,
        (BENT, {"kind": "shift", "where": "wall", "coefficients": [1e-3, -1e-3, 1e-3], "at": {"row": 81}}),
        {"gauge": 0.02},
    ),
    "a lens": Case(
        {"kind": "pixels"}, {"cameras": {"eye": EYE}}, 30,
        ({"kind": "lens_distortion", "where": "eye", "motion": "k1", "coefficients": -0.02},), {},
    ),
}  # fmt: skip


def scenario(folder: Path, case: Case, faulty: bool = True, **more: object) -> Scenario:
    real = {"instruments": case.real} if case.real else {}
    truth = TRUTH | {"n": case.n, "effects": list(case.effects) if faulty else []} | real
    keys = {"format": 1, "robot": UR10, "measurements": case.measurements, "truth": truth} | more
    keys |= {"instruments": case.instruments} if case.instruments else {}
    plain = json.loads(json.dumps(keys))  # YAML would write what stands twice as an alias
    (folder / "scenario.yaml").write_text(yaml.safe_dump(plain))
    return load_settings(folder / "scenario.yaml", Scenario)


def written(folder: Path, case: Case, faulty: bool = True, **more: object) -> tuple[Path, list[float]]:
    """A campaign's path, and the true coefficients of its fault."""
    made = simulate(scenario(folder, case, faulty, **more))
    (folder / "out").mkdir()
    write_campaign(made, folder / "out", folder / "out")
    told = [c["value"] for effect in truth_document(made)["effects"] for c in effect["coefficients"]]
    return folder / "out" / "campaign.yaml", told


def searched_for(folder: Path, case: Case, faulty: bool = True, **more: object) -> tuple[Searched, list[float]]:
    """A campaign from its files through fit and search, and the true coefficients of its fault."""
    path, told = written(folder, case, faulty, **more)
    return searched(path), told


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    """The campaign of a case as it was found, and its truth: searched once, whoever asks."""
    # Of many marks, steps in time cost more than all other kinds together: they are asked of a sound camera alone.
    usual = JobSettings.model_validate(
        {"format": 1, "robot": {"urdf": Path("a.urdf"), "tip": "b"}}
    ).diagnosis.candidates
    less = {"diagnosis": {"candidates": [kind for kind in usual if kind != "shift"]}}
    return cache(
        lambda name: searched_for(tmp_path_factory.mktemp("case"), CASES[name], **(less if name == "a lens" else {}))
    )


def held_out(of: Searched, stage: int) -> float:
    """RMS over the numbers of held-out rows in sigmas of their noise."""
    residual = of.judged.stages[stage].residual[of.rows.test]
    sigma = np.concatenate([np.full(c.size, NOISE[c.name.split("_")[-1]]) for c in of.rows.channels])
    return float(np.sqrt(np.nanmean((residual / sigma) ** 2)))


@pytest.mark.parametrize("name", CASES)
def test_a_fault_is_found_by_its_name_with_its_size(name: str, found: Found) -> None:
    """Held-out rows are then as good as their noise, which they were not before."""
    case = CASES[name]
    made, true = found(name)
    fit, effects = made.fit, {(effect.kind, effect.where): effect for effect in made.effects}
    assert len(made.effects) == len(effects) == len(case.effects)
    for fault in case.effects:
        own = [fit.model.names.index(c.name) for c in effects[fault["kind"], fault["where"]].coefficients]
        mine, true = true[: len(own)], true[len(own) :]
        off = fit.theta[own] - mine
        covariance = fit.covariance[np.ix_(own, own)]
        assert off @ np.linalg.solve(covariance, off) < 9.0 + 3.0 * len(own)  # 3 sigmas of one, about as rare for more
    assert not true
    assert held_out(made, 2) < min(1.4, 0.9 * held_out(made, 1))
    assert made.verdict == "noise_floor"


SOUND = {
    "a tracker and wires": CASES["a tracker's scale, beside wires"],
    "plates": Case({"kind": "plane"}, PLATES, 110, (), {"gauge": 0.02}),
    "sockets": Case({"kind": "point"}, {}, 110, (), {}),
    "a camera": CASES["a lens"],
}


@pytest.mark.parametrize("name", SOUND)
def test_nothing_is_found_where_instruments_do_as_stated(name: str, tmp_path: Path) -> None:
    made, _ = searched_for(tmp_path, SOUND[name], faulty=False)
    assert made.effects == ()
    assert made.verdict == "noise_floor"


SCALE = {"kind": "tracker_scale", "where": "laser", "coefficients": 4e-4}
UNTOLD = {
    "a tracker beside sockets that nobody measured": Case([LASER, {"kind": "point"}], {}, 60, (SCALE,), {}),
    "a tracker beside an inclinometer": Case([POSE, {"kind": "inclination"}], {}, 90, (SCALE,), {}),
    "few places on a bent plate": Case({"kind": "plane"}, PLATES, 30, (BENT,), {}),
}


@pytest.mark.parametrize("name", [name for name in UNTOLD if "inclinometer" not in name])
def test_a_fault_that_rows_cannot_tell_invents_nothing(name: str, tmp_path: Path) -> None:
    """Links that are all longer do what a tracker's scale does; a plate of few places is as flat as its unknowns make it."""
    made, _ = searched_for(tmp_path, UNTOLD[name])
    assert made.effects == ()


def test_held_lengths_tell_the_scale_of_a_tracker(tmp_path: Path) -> None:
    """The same poses and inclinations, the links as long as the URDF says."""
    case = UNTOLD["a tracker beside an inclinometer"]
    exact = {"parameters": {}, "n": 90, "effects": [SCALE]}
    made = scenario(tmp_path, case, parameters={"set": "none"})
    made = made.model_copy(update={"truth": made.truth.model_validate(TRUTH | exact)})
    (tmp_path / "out").mkdir()
    write_campaign(simulate(made), tmp_path / "out", tmp_path / "out")
    found = searched(tmp_path / "out" / "campaign.yaml")
    assert found.named == {("tracker_scale", "laser")}
    fit = found.fit
    k = fit.model.names.index("laser.scale")
    assert abs(fit.theta[k] - 4e-4) < 3.0 * np.sqrt(fit.covariance[k, k])


@pytest.mark.parametrize("name", CASES)
def test_columns_of_a_fault_are_differences_of_the_residual(name: str, found: Found) -> None:
    """Of every coefficient of the exact model with the fault that was found, at values that are not zero."""
    made, _ = found(name)
    fit, rows = made.fit, made.rows.select(made.rows.train)
    asked = problem(fit.model, rows)
    R, p = fit.model.poses(fit.theta, asked.rows)
    slopes = asked.measured.slopes(R, p, fit.theta)
    assert len(slopes.by_moved) == len(asked.measured.moved) > 0
    for moved, column in zip(asked.measured.moved, slopes.by_moved, strict=True):
        step = 1e-5 * np.eye(len(fit.theta))[moved.index]
        ahead, behind = (asked.measured.left(R, p, fit.theta + s) for s in (step, -step))
        expected = np.nan_to_num(behind - ahead) / 2e-5
        np.testing.assert_allclose(column, expected, atol=1e-7 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("kind", ["tracker_scale", "range_error"])
def test_a_simulated_tracker_shows_its_places_stretched_from_the_origin(kind: str, tmp_path: Path) -> None:
    fault = {"kind": kind, "where": "laser", "coefficients": 1e-3}
    case = Case([LASER, {"kind": "distance"}], WIRES, 20, (fault,), {})
    quiet = dict.fromkeys(NOISE, 0.0)
    tables = []
    for faulty in (False, True):
        made = scenario(tmp_path, case, faulty)
        made = made.model_copy(
            update={"truth": made.truth.model_copy(update={"noise": made.truth.noise.model_validate(quiet)})}
        )
        tables.append(simulate(made).tables)
    plain, off = ((laser[["x", "y", "z"]].to_numpy(), wires.distance.to_numpy()) for laser, wires in tables)
    away = np.linalg.norm(plain[0], axis=1, keepdims=True)
    np.testing.assert_allclose(
        off[0] / plain[0] - 1.0, np.tile(1e-3 * (away if kind == "range_error" else 1.0), 3) + 0 * plain[0], atol=1e-9
    )
    np.testing.assert_array_equal(off[1], plain[1])


def test_a_wire_that_hangs_is_longer_by_the_arc_of_its_parabola() -> None:
    """Length of the arc under a weight across the chord, integrated, against the covariate times w^2 / (24 T^2)."""
    robot = robots.ur10()
    q = robots.readings(robot, 5, np.random.default_rng(2), 0.5)
    anchor, gravity = np.array([2.0, -1.0, 0.3]), np.array([3.0, -2.0, -9.0])
    sights = Sights(np.array([[0.0, 0.0, 0.1]]), {"rail": anchor})
    table = sight_table(robot, q, sights, gravity, np.zeros(5, dtype=int))
    place = target_places(robot, q, np.tile([0.0, 0.0, 0.1], (5, 1)))
    weight, tension = 0.3, 20.0  # N/m, N
    for k in range(5):
        chord = place[k] - anchor
        L = np.linalg.norm(chord)
        across = weight * np.linalg.norm(np.cross(chord / L, gravity / np.linalg.norm(gravity)))
        arc, _ = quad(lambda x, a=across, L=L: np.sqrt(1.0 + (a * (2.0 * x - L) / (2.0 * tension)) ** 2) - 1.0, 0.0, L)
        assert table["rail" + LENGTH][k] == pytest.approx(L, rel=1e-12)
        assert weight**2 / (24.0 * tension**2) * table["rail" + SAG][k] == pytest.approx(arc, rel=1e-3)


def test_without_gravity_no_wire_hangs() -> None:
    robot = robots.ur10()
    table = sight_table(
        robot, np.zeros((1, 6)), Sights(anchors={"rail": np.ones(3)}), np.zeros(3), np.zeros(1, dtype=int)
    )
    assert table["rail" + SAG] == 0.0


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.5, -0.6]])
def test_directions_along_a_plane_stay_where_they_are_as_it_tilts(normal: list[float]) -> None:
    """No noise of the normal exchanges them: a bend keeps its name."""
    n = np.array(normal) / np.linalg.norm(normal)
    directions = np.array(along_plane(n))
    np.testing.assert_allclose(directions @ directions.T, np.eye(2), atol=1e-15)
    np.testing.assert_allclose(directions @ n, 0.0, atol=1e-15)
    for change in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
        tilted = (n + change) / np.linalg.norm(n + change)
        assert np.abs(np.array(along_plane(tilted)) - directions).max() < 5e-3


def test_a_plate_keeps_its_middle_and_its_shape_on_other_rows(found: Found) -> None:
    """Places on it are counted from where the fitted rows touched it, whichever rows are asked about."""
    made, _ = found("a bent plate, and another that was knocked")
    fit, rows = made.fit, made.rows
    whole = problem(fit.model, rows)
    k = np.flatnonzero([c.basis.of == ("table" + PLATE_COORDINATES[0],) for c in fit.model.coefficients])
    assert len(k) == 1
    varying = [c for c in fit.model.coefficients if not c.basis.constant]
    own = varying.index(fit.model.coefficients[int(k[0])])
    half = rows.select(np.arange(0, len(rows), 2))
    np.testing.assert_array_equal(problem(fit.model, half).rows.phi[:, own], whole.rows.phi[::2, own])
    fitted = rows.train & (rows.labels.refers[:, 0] == "table")
    u = fit.model.coefficients[int(k[0])].basis
    assert isinstance(fit.model.coefficients[int(k[0])], Coefficient)
    table = sight_table(fit.model.robot, rows.readings, fit.model.around.sights, np.zeros(3), whole.rows.tip)
    np.testing.assert_allclose(evaluate(u, table), whole.rows.phi[:, own], atol=1e-15)
    assert abs(table["table" + PLATE_COORDINATES[0]][fitted].mean()) < 1e-12


def test_what_was_knocked_is_told_in_words_and_a_joint_has_a_zero(found: Found) -> None:
    made, _ = found("a bent plate, and another that was knocked")
    (effect,) = (effect for effect in made.effects if effect.kind == "shift")
    assert step_in_words(effect, made.rows).startswith("wall moved between rows ")
    of_joint = Effect("shift", "elbow_joint", (replace(effect.coefficients[0], where="elbow_joint", component="axis"),))
    assert step_in_words(of_joint, made.rows).startswith("the zero of elbow_joint moved between rows ")


def test_predictions_are_where_the_target_is_not_where_a_tracker_shows_it(tmp_path: Path) -> None:
    """Its fault is no part of the arm: left in the calibration, every command would miss by it."""
    stated = {"effects": [{"kind": "tracker_scale", "where": "laser"}], "diagnosis": {"enabled": False}}
    path, _ = written(tmp_path, CASES["a tracker's scale, beside wires"], **stated)
    outcome = identify(path)
    assert [e.effect.kind for e in outcome.effects] == ["tracker_scale"]
    saved = calibration(outcome)
    rows = outcome.measurements.select(outcome.measurements.labels.block == 0)
    _, p = saved.final.poses(rows.readings, rows.conditions)
    shown = rows.observed[:, :3]
    # least squares of the one number that carries places to what the tracker shows
    stretch = float(np.sum(p * shown) / np.sum(p * p)) - 1.0
    assert stretch == pytest.approx(4e-4, abs=4e-5)
    assert not any(c.where == "laser" for c in saved.final.model.coefficients)


def test_a_tracker_has_another_name_where_its_block_s_is_taken(tmp_path: Path) -> None:
    """A campaign whose socket is called as a block is remains one."""
    case = Case(
        [{"kind": "position", "name": "ball"}, {"kind": "point"}],
        {},
        40,
        (SCALE,),
        {"points": {"ball": [0.6, 0.3, 0.5], "b": [0.5, -0.4, 0.6]}},
    )
    made, _ = searched_for(tmp_path, case, faulty=False, diagnosis={"enabled": False})
    things = made.rows.instruments.things
    assert things["tracker"].names == ("block ball",)
    assert things["point"].names == ("b", "ball")
    assert {value.role for value in thing_values(made.fit, made.rows.fitted)} == {"point"}


def test_a_tracker_alone_is_told_that_it_has_nothing_to_compare_with(tmp_path: Path) -> None:
    case = Case({"kind": "pose"}, {}, 30, (SCALE,), {})
    with pytest.raises(
        CampaignError, match=r"no place 'laser'.*; tracker_scale acts at a block of poses or positions beside others"
    ):
        searched_for(tmp_path, case)


def test_a_plate_of_few_places_cannot_be_declared_bent(tmp_path: Path) -> None:
    stated = {"kind": "flatness", "where": "table"}
    with pytest.raises(CampaignError, match="flatness at table cannot be fitted"):
        searched_for(tmp_path, UNTOLD["few places on a bent plate"], effects=[stated])


def test_constants_of_the_urdf_are_those_of_a_lens_as_found_and_a_sag_of_each_row_is_no_state(found: Found) -> None:
    """What a thing always does goes into its state; what depends on the row cannot."""
    made, _ = found("a lens")
    test, stages = made.rows.test, made.judged.stages
    geometric = refit_with_final_instruments(stages, made.rows.fitted)[1].fit
    left = problem(geometric.model, made.rows).residual(geometric.theta)[test]
    rms = [float(np.sqrt(np.nanmean(r**2))) for r in (stages[1].residual[test], left, stages[2].residual[test])]
    assert rms[1] < 1.05 * rms[2] < rms[0]
    made, _ = found("a wire's scale, and another's sag")
    before, after = (stage.fit for stage in made.judged.stages[1:])
    moved = with_things_moved(before, after)
    assert moved is not None
    change = np.abs(moved.states["anchor"] - before.model.states["anchor"]).max(axis=1)
    assert change.tolist() == [0.0, pytest.approx(1e-3, rel=0.3), 0.0]  # w2's scale alone, though w3 sags
