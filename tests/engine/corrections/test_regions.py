"""Calibration by region: what varies along a rail or in space is found, what does not is left, each region's URDF holds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import yaml
from scipy.linalg import cholesky
from searched import Searched, searched

from aridcal.calibration import Calibration
from aridcal.engine.corrections.basis import FORMS, Basis, wendland
from aridcal.engine.corrections.catalogue import declared
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.loads import Surroundings, covariate_table
from aridcal.engine.corrections.regional_kind import IN_SPACE, ball_field, far_from_nodes, spread_out, widths
from aridcal.engine.corrections.sights import TARGET, Sights, sight_table
from aridcal.engine.corrections.smooth import Kernel, samples_root, smooth_precision
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.engine.search.loop import calibrated_arm, fit_constants
from aridcal.files.campaign import EffectDeclaration, JobSettings
from aridcal.files.yaml_file import load_settings, parse_settings
from aridcal.jobs.apply.target_poses import predict, read_query
from aridcal.jobs.calibrate.controllers import controller_exports, write_controllers
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign
from aridcal.system.errors import AridcalError, CampaignError
from aridcal.system.progress import SILENT

NOISE = {"position": 1e-4, "rotation": 1e-4}
FRAMES = {
    "world_base": {"xyz": [5, 2, -2], "rpy": [1.5, 0, 0.8]},
    "tip_target": {"xyz": [0.3, -0.1, 0.1], "rpy": [0.2, 0.4, 0.1]},
}
ASKED = ["all", "regional", "residual_field"]
BENT = {"kind": "regional", "where": "joint_2", "motion": ["beta", "alpha"], "by": "joint_1"}


def simulated(folder: Path, true: list[dict[str, object]], n: int = 150, **more: object) -> Path:
    """An ARID with some effects; the campaign's path."""
    folder.mkdir(exist_ok=True)
    keys = {
        "format": 1,
        "robot": {"urdf": str(robots.URDF / "arid.urdf"), "tip": "flange", "gravity": [0.0, 9.81, 0.0]},
        "measurements": {"noise": NOISE},
        "parameters": {"set": "doty"},
        "truth": {"n": n, "seed": 3, "noise": NOISE, "frames": FRAMES, "effects": true},
    } | more
    (folder / "scenario.yaml").write_text(json.dumps(keys))
    write_campaign(simulate(load_settings(folder / "scenario.yaml", Scenario)), folder, folder)
    return folder / "campaign.yaml"


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    """The second link bends and twists by 1 mrad along the rail; its calibration, and the files for controllers."""
    folder = tmp_path_factory.mktemp("bent")
    truth = BENT | {"form": "ripple", "coefficients": [1e-3, 1e-3]}
    outcome = identify(simulated(folder, [truth], diagnosis={"candidates": ["regional"]}))
    (folder / "out").mkdir()
    write_controllers(outcome, controller_exports(outcome), folder / "out")
    return outcome, folder / "out"


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def test_a_link_that_bends_along_the_rail_is_found_where_it_is(bent: tuple[Outcome, Path]) -> None:
    outcome, _ = bent
    (found,) = outcome.effects
    assert (found.effect.kind, found.effect.where, found.effect.by) == ("regional", "joint_2", "joint_1")
    assert found.effect.motion == ("beta", "alpha")
    assert outcome.verdict.word == "noise_floor"
    test = outcome.parts()["test"]
    noise = 1e-4 * np.sqrt(3)
    assert rms(outcome.stage("geometric").residual[test, :3]) > 3 * noise
    assert rms(outcome.stage("final").residual[test, :3]) < 1.15 * noise


@pytest.fixture(scope="module")
def without(tmp_path_factory: pytest.TempPathFactory) -> Searched:
    """An arm that is the same everywhere, and nothing is sought."""
    return searched(simulated(tmp_path_factory.mktemp("plain"), [], 100, diagnosis={"enabled": False}))


@pytest.mark.parametrize("stated", [[], [BENT, {"kind": "residual_field", "where": "world_base"}]])
def test_where_nothing_varies_the_one_model_stays_to_the_last_digit(
    stated: list[dict[str, object]], without: Searched, tmp_path: Path
) -> None:
    path = simulated(
        tmp_path / "asked", [], 100, effects=stated, diagnosis={"candidates": ["regional", "residual_field"]}
    )
    one = identify(path)
    assert not one.effects
    np.testing.assert_array_equal(one.stage("final").residual, without.judged.stages[-1].residual)
    said = [notice for notice in one.notices if "the one model of the whole workspace stays" in notice]
    assert len(said) == len(stated)
    assert controller_exports(one).regions is None


def test_each_region_s_urdf_alone_predicts_the_rows_of_its_region(bent: tuple[Outcome, Path]) -> None:
    """Second road: files alone, read back by Pinocchio, the region looked up in the index as its head says."""
    outcome, folder = bent
    index = yaml.safe_load((folder / "regions" / "index.yaml").read_text("utf-8"))
    frames = yaml.safe_load((folder / "frames.yaml").read_text("utf-8"))["URDF by region"]
    world, tip = (
        pin.SE3(pin.rpy.rpyToMatrix(np.array(frames[f]["rpy"])), np.array(frames[f]["xyz"]))
        for f in ("world_base", "tip_target")
    )
    m = outcome.measurements
    names = list(index["regions"])
    middle = np.array([index["regions"][name]["middle"]["joint_1"] for name in names])
    nearest = np.argmin(np.abs(m.readings[:, :1] - middle), axis=1)
    error = np.full((len(m), 3), np.nan)
    for k, name in enumerate(names):
        urdf = (folder / "regions" / index["regions"][name]["urdf"]).read_bytes()
        R, p = tip_frames(parse_robot(urdf, "flange"), m.readings[nearest == k])
        predicted = (p + R @ tip.translation) @ world.rotation.T + world.translation
        error[nearest == k] = m.position[nearest == k] - predicted
        entry = index["regions"][name]
        judged = (nearest == k) & m.test & ~outcome.outlier
        assert entry["rows"] == {"all": int((nearest == k).sum()), "held_out": int(judged.sum())}
        if judged.any():
            assert entry["error"]["this_urdf"] == pytest.approx(rms(error[judged]), rel=1e-6)
    assert sorted(p.name for p in (folder / "regions").iterdir()) == sorted(
        ["index.yaml", *(f"{n}.urdf" for n in names)]
    )
    test = outcome.parts()["test"]
    exports = {e.name: e for e in controller_exports(outcome).exports}
    assert exports["URDF by region"].error == pytest.approx(rms(error[test]), rel=1e-6)
    assert exports["URDF by region"].error < 0.5 * exports["URDF alone"].error


def test_python_has_the_regions_as_a_table_fresh_and_loaded(bent: tuple[Outcome, Path]) -> None:
    outcome, folder = bent
    saved = calibration(outcome)
    fresh = Calibration(saved, outcome).regions
    loaded = Calibration(saved, folder=folder).regions
    pd.testing.assert_frame_equal(fresh, loaded)
    assert list(fresh.index) == sorted(p.stem for p in (folder / "regions").glob("*.urdf"))
    assert fresh["rows_all"].sum() == len(outcome.measurements)
    assert (fresh["low_joint_1"] <= fresh["high_joint_1"]).all()
    assert Calibration(saved, folder=folder / "regions").regions.empty  # no such file there


def test_a_damaged_index_is_refused(bent: tuple[Outcome, Path], tmp_path: Path) -> None:
    (tmp_path / "regions").mkdir()
    saved = calibration(bent[0])
    for text in ("regions: {region_01: {urdf: a.urdf}}\n", "regions: [1]\n", "regions: &a [*a]\n", "- 1\n"):
        (tmp_path / "regions" / "index.yaml").write_text(text)
        with pytest.raises(AridcalError, match=r"index.yaml"):
            _ = Calibration(saved, folder=tmp_path).regions


CENTRE, OFF, REACH = np.array([0.9, 2.2, 0.5]), np.array([3e-4, -4e-4, 3.3e-4]), 0.4  # in the base frame, [m]


def dent(places: np.ndarray) -> np.ndarray:
    """By how much targets at some places of the base frame are off, shape (N, 3), [m]."""
    distance = np.linalg.norm(places - CENTRE, axis=1)
    return np.exp(-0.5 * (distance / REACH) ** 2)[:, None] * OFF


@pytest.fixture(scope="module")
def off(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    """A short rail; around one place in space the targets are 0.6 mm off, of which no campaign says anything."""
    folder = tmp_path_factory.mktemp("off")
    urdf = (robots.URDF / "arid.urdf").read_text("utf-8").replace('upper="18.2372"', 'upper="1.0"')
    (folder / "short.urdf").write_text(urdf, "utf-8")
    robot = {"urdf": str(folder / "short.urdf"), "tip": "flange", "gravity": [0.0, 9.81, 0.0]}
    path = simulated(folder, [], 400, robot=robot, diagnosis={"candidates": ASKED})
    table = pd.read_csv(folder / "measurements.csv")
    world = pin.SE3(pin.rpy.rpyToMatrix(np.array(FRAMES["world_base"]["rpy"])), np.array(FRAMES["world_base"]["xyz"]))
    places = (table[["x", "y", "z"]].to_numpy() - world.translation) @ world.rotation
    table[["x", "y", "z"]] += dent(places) @ world.rotation.T
    table.to_csv(folder / "measurements.csv", index=False)
    outcome = identify(path)
    (folder / "calibration.yaml").write_text(calibration(outcome).dump(), "utf-8")
    return outcome, folder / "calibration.yaml"


def test_a_place_where_targets_are_off_is_found_and_corrected_there_and_nowhere_else(off: tuple[Outcome, Path]) -> None:
    outcome, _ = off
    assert {e.effect.kind for e in outcome.effects} == {"residual_field"}
    fit = outcome.stage("final").fit
    places = np.vstack([CENTRE, CENTRE + [0, 0, 0.2], CENTRE + [0.3, 0, 0], CENTRE + [0, 2.0, 0]])
    field = np.zeros((len(places), 3))
    for c, value in zip(fit.model.coefficients, fit.theta, strict=True):
        if c.basis.form == "ball":
            field[:, "xyz".index(c.component)] += value * FORMS["ball"].value(list(places.T), c.basis.numbers)
    np.testing.assert_allclose(field, dent(places), atol=1.5e-4)
    m, world = outcome.measurements, fit.model.world_base[0][1]
    places = (m.position - world.translation) @ world.rotation
    near = outcome.parts()["test"] & (np.linalg.norm(places - CENTRE, axis=1) < 1.2 * REACH)
    assert near.sum() > 3
    before, after = (outcome.stage(name).residual[near, :3] for name in ("geometric", "final"))
    best = rms(before - dent(places[near]) @ world.rotation.T)  # what the truth itself would leave there
    assert rms(before) > 1.3 * best
    assert rms(after) < 1.15 * best


def test_what_nobody_asks_for_is_not_sought() -> None:
    every = JobSettings.model_validate(
        {"format": 1, "robot": {"urdf": Path("a.urdf"), "tip": "b"}}
    ).diagnosis.candidates
    assert not {"regional", "residual_field"} & set(every)
    text = "format: 1\nrobot: {urdf: a.urdf, tip: b}\ndiagnosis: {candidates: [all, regional, joint_gain]}\n"
    asked = parse_settings(text, Path("campaign.yaml"), JobSettings).diagnosis.candidates
    assert set(asked) == {*every, "regional"}
    assert len(asked) == len(set(asked))


def test_the_saved_model_predicts_as_the_fit_does_for_many_rows_and_for_one(off: tuple[Outcome, Path]) -> None:
    outcome, path = off
    saved, fit, q = SavedModel.load(path), outcome.stage("final").fit, outcome.measurements.readings
    R, p = saved.final.poses(q)
    expected = fit.model.poses(fit.theta, fit.model.rows(q))
    np.testing.assert_allclose(p, expected[1], atol=1e-12)
    np.testing.assert_allclose(R, expected[0], atol=1e-12)
    one = OneRowModel(saved.final.model, saved.final.theta)
    for k in range(0, len(q), 40):
        np.testing.assert_allclose(one.pose(q[k], one.effects(q[k], {}))[1], p[k], atol=1e-12)
    # the command that brings the target where the model has it from some readings is those readings
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R[0], p[0]
    found = saved.command(pose, q[0] + 0.02)
    assert found.reached
    np.testing.assert_allclose(found.readings, q[0], atol=1e-6)


def test_a_field_whose_targets_are_not_in_the_file_is_refused(off: tuple[Outcome, Path], tmp_path: Path) -> None:
    text = off[1].read_text("utf-8")
    keys = yaml.safe_load(text)
    keys["final"]["loads"]["targets"] += [[0.1, 0.2, 0.3]]
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(keys), "utf-8")
    with pytest.raises(CampaignError, match=r"loads.targets: 2 places for 1 frames"):
        SavedModel.load(tmp_path / "calibration.yaml")


def rows_in_space(n: int = 120) -> tuple[ObservedRows, Model, np.ndarray]:
    rng = np.random.default_rng(4)
    robot = robots.random_robot(11, "PRCR")
    q = robots.readings(robot, n, rng)
    around = Surroundings(sights=Sights(np.array([[0.1, 0.2, 0.3]])))
    frames = ((None, robots.random_placement(rng)),)
    table = covariate_table(robot, q, {}, around, np.zeros(n, dtype=int), set())
    table |= sight_table(robot, q, around.sights, around.gravity, np.zeros(n, dtype=int))
    return ObservedRows(robot, table, ()), Model(robot, (), frames, frames, around), q


def test_a_field_is_the_gaussian_process_given_its_values_at_the_nodes() -> None:
    """Dense formulas: k(p, u) K^-1 k(u, p), and at the nodes themselves the kernel."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0.0, 1.0, (200, 3))
    bases = ball_field(places)
    nodes, radius = np.array([b.numbers[:3] for b in bases]), bases[0].numbers[3]

    def k(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return wendland(np.linalg.norm(a[:, None] - b, axis=2) / radius)

    phi = np.column_stack([FORMS["ball"].value(list(places.T), b.numbers) for b in bases])
    np.testing.assert_allclose(phi, k(places, nodes), atol=1e-12)
    where = ObservedRows(
        robots.arid(), dict(zip((*robots.arid().names, *TARGET), [*places.T, places[:, 0], *places.T], strict=True)), ()
    )
    effect = declared(where, EffectDeclaration(kind="residual_field", where="world_base"), "campaign.yaml")
    root = samples_root(effect.shape, Kernel(3.0))
    one = root[: len(nodes), : len(nodes)]
    K = k(nodes, nodes)
    np.testing.assert_allclose(
        phi @ one @ one.T @ phi.T, k(places, nodes) @ np.linalg.solve(K, k(nodes, places)), atol=1e-6
    )
    np.testing.assert_allclose(root[: len(nodes), len(nodes) :], 0.0)  # x, y and z are independent beforehand
    precision = smooth_precision(effect.shape, 2.0, Kernel(3.0))[: len(nodes), : len(nodes)]
    np.testing.assert_allclose(precision, K / 4.0, atol=1e-8)
    cholesky(K)  # Wendland's function is positive definite in space


@pytest.mark.parametrize("where", ["world_base", "tip_target", "joint_3"])
def test_any_place_may_vary_in_space_and_along_any_joint(where: str) -> None:
    rows, model, q = rows_in_space()
    for by in (IN_SPACE, "joint_1"):
        effect = declared(rows, EffectDeclaration(kind="regional", where=where, motion=("x", "pitch"), by=by), "c.yaml")
        assert effect.motion == ("x", "pitch")
        assert effect.by == by
        assert effect.covariates == (TARGET if by == IN_SPACE else ("joint_1",))
        theta = 1e-3 * np.random.default_rng(2).standard_normal(len(effect.coefficients))
        varying = model.with_coefficients(effect.coefficients)
        _, p = varying.poses(theta, varying.rows(q))
        for k in (0, 7, 30):  # second road: the same constants, at the values that the functions have there
            still = [Coefficient(where, component) for component in effect.motion]
            fixed = model.with_coefficients(still)
            table = {name: values[k : k + 1] for name, values in rows.table.items()}
            values = np.zeros(2)
            for c, value in zip(effect.coefficients, theta, strict=True):
                columns = [table[name] for name in c.basis.of]
                values[effect.motion.index(c.component)] += (
                    value * FORMS[c.basis.form].value(columns, c.basis.numbers)[0]
                )
            if where != "joint_3":  # effects of a joint act after its own constants, in another place
                np.testing.assert_allclose(fixed.poses(values, fixed.rows(q[k : k + 1]))[1][0], p[k], atol=1e-9)
        one = OneRowModel(varying, theta)
        for k in (0, 7, 30):
            np.testing.assert_allclose(one.pose(q[k], one.effects(q[k], {}))[1], p[k], atol=1e-12)
    assert widths(effect) == (effect,)


def test_a_field_is_not_known_where_nothing_was_measured() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(0.0, 1.0, (300, 3))
    bases = ball_field(places)
    assert not far_from_nodes(bases, places).any()
    assert not far_from_nodes(bases, rng.uniform(0.0, 1.0, (300, 3))).any()  # between them
    assert far_from_nodes(bases, places + [3.0, 0.0, 0.0]).all()
    far = far_from_nodes(bases, np.array([[0.5, 0.5, 1.0 + gap] for gap in (0.05, 1.0)]))
    assert far.tolist() == [False, True]
    assert not far_from_nodes(bases[:1], places + 10.0).any()  # one dent says nothing of other places
    assert not far_from_nodes([Basis("bump", ("joint_1",), (0.0, 1.0))], places).any()


def test_predictions_far_from_all_places_of_a_field_are_marked(off: tuple[Outcome, Path]) -> None:
    """The arm may go there, each joint by itself within its range: the targets were all at one end of its space."""
    saved, q = SavedModel.load(off[1]), off[0].measurements.readings
    model = saved.final.model
    places = sight_table(model.robot, q, model.around.sights, np.zeros(3), np.zeros(len(q), dtype=int))
    along = max((places[name] for name in TARGET), key=np.ptp)
    near = np.column_stack([places[name][along < np.quantile(along, 0.2)] for name in TARGET])
    field = [Coefficient("world_base", c, basis) for c in ("x", "y", "z") for basis in ball_field(near)]
    K = len(field)
    known = replace(saved, final=SolvedModel(model.with_coefficients(field), np.zeros(K), np.zeros((K, K))))
    table = pd.DataFrame(q, columns=model.robot.readings)
    marked = predict(known, read_query(known, table))["extrapolates"].to_numpy()
    assert marked[along > np.quantile(along, 0.95)].all()
    assert marked[along < np.quantile(along, 0.2)].mean() < 0.1


def test_nodes_are_spread_over_the_places() -> None:
    rng = np.random.default_rng(1)
    places = np.vstack([rng.normal(0.0, 0.01, (500, 3)), [[5.0, 0.0, 0.0]], [[0.0, 7.0, 0.0]]])
    chosen, beyond = spread_out(places, 12)
    assert {5.0, 7.0} <= set(chosen.max(axis=1).tolist())
    gaps = np.linalg.norm(places[:, None] - chosen, axis=2).min(axis=1)
    assert beyond == pytest.approx(gaps.max())
    apart = np.linalg.norm(chosen[:, None] - chosen, axis=2)[~np.eye(12, dtype=bool)]
    assert apart.min() >= beyond  # Gonzalez: nodes are no nearer to one another than the furthest place to them


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{kind: regional, where: joint_2}", "needs `by`: a joint, a column, or `place`"),
        ("{kind: joint_backlash, where: joint_2, by: joint_1}", "by: 'joint_1' should be direction or load"),
        ("{kind: joint_gain, where: joint_2, by: joint_1}", "`by` belongs to a joint_backlash or regional only"),
    ],
)
def test_a_declaration_that_makes_no_sense_says_so(text: str, said: str) -> None:
    campaign = f"format: 1\nrobot: {{urdf: a.urdf, tip: b}}\neffects: [{text}]\n"
    with pytest.raises(CampaignError, match=r"campaign.yaml, line 3") as found:
        parse_settings(campaign, Path("campaign.yaml"), JobSettings)
    assert said in str(found.value)


@pytest.mark.parametrize("wrong", [{"by": "temperature"}, {"by": "joint_1", "motion": ("k1",)}, {"by": "joint_9"}])
def test_a_declaration_of_what_is_not_there_is_refused(wrong: dict[str, object]) -> None:
    rows, _, _ = rows_in_space(20)
    with pytest.raises(CampaignError, match="cannot be fitted"):
        declared(rows, EffectDeclaration(kind="regional", where="joint_2", **wrong), "campaign.yaml")  # type: ignore[arg-type]


@pytest.mark.parametrize("jumps", [False, True], ids=["bends", "jumps"])
def test_what_does_not_hold_between_the_places_measured_is_not_called_a_constant_that_varies(jumps: bool) -> None:
    """Sixteen stops along the rail, a tilt at each: neighbours alike, or each its own. Rows alone cannot tell these apart."""
    rng = np.random.default_rng(0)
    robot = robots.arid()
    stop = np.repeat(np.arange(16), 12)
    q = robots.readings(robot, len(stop), rng)
    q[:, 0] = np.linspace(1.0, 17.0, 16)[stop]
    tilt = 1e-3 * (rng.choice([-1.0, 1.0], 16) if jumps else np.sin(np.linspace(0.0, 6.0, 16)))[stop]
    beta = Coefficient("joint_2", "beta", Basis("linear", ("tilt",), (0.0,)))
    model = Model(robot, (beta,))
    R, p = model.poses(np.ones(1), model.rows(q, {"tilt": tilt}))
    p = p + 1e-4 * rng.standard_normal(p.shape)
    rows = robots.declared(robots.measured(robot, q, p, R), 1e-4, 1e-4)
    asked = robots.campaign("pose", parameters={"set": "doty"}, diagnosis={"candidates": ("regional",)})
    found = calibrated_arm(
        asked.question, robot, rows, (), fit_constants(asked.question, robot, rows, ()), SILENT
    ).diagnosed.stepwise
    active = [a.effect.where for a in found.state.active]
    assert active == ([] if jumps else ["joint_2"])
    if jumps:
        best = found.rejected[0]
        assert best.score.gain > 100.0
        assert best.why == "does not hold in regions that were held back whole"
