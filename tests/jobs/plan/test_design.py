"""Configurations to measure next: the exchange, what is predicted of it, and the command."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise, permutations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots

from aridcal import design as command
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.inverse import reachable
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.robot.kinematics import joint_frames
from aridcal.engine.search.loop import fit_constants
from aridcal.engine.trust.uncertainty import target_sigma
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.purposes import Box
from aridcal.files.read import load_measurements
from aridcal.jobs.plan import pose_design as planning
from aridcal.jobs.plan.clearance import crosses
from aridcal.jobs.plan.configurations import draw_candidates, targets_of
from aridcal.jobs.plan.plan_coverage import observability
from aridcal.jobs.plan.pose_design import Plan, PlanRequest, as_table, design, question
from aridcal.jobs.plan.prior_knowledge import PlanSetup, beforehand
from aridcal.jobs.plan.row_exchange import (
    RowChoice,
    best_choice,
    exchange_members,
    greedy,
    nested,
    rms_sigma,
    worst_sigma,
)
from aridcal.jobs.plan.target_region import region, region_readings
from aridcal.jobs.plan.travel import length, short_order, times
from aridcal.system.errors import AridcalError, CampaignError, MeasurementError

POSE = "kind: pose, noise: {position: 1.0e-4, rotation: 1.0e-4}"
TOOL = "frames: {tip_target: {xyz: [0.05, 0.03, 0.15]}}\n"
SETTINGS = ["A", "D", "G"]


@pytest.fixture(autouse=True)
def _few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    """A smaller pool than the command's, so that tests are quick."""
    monkeypatch.setattr(planning, "POOL", 200)
    monkeypatch.setattr(planning, "SMALL_POOL", 120)


def campaign(
    folder: Path, block: str = POSE, more: str = TOOL, urdf: str = "ur10.urdf", tip: str = "tool0"
) -> Campaign:
    """A campaign whose table is not there."""
    path = folder / "campaign.yaml"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {robots.URDF / urdf}, tip: {tip}}}\nmeasurements: {{file: rows.csv, {block}}}\n"
        f"diagnosis: {{enabled: false}}\n{more}"  # constants alone, and what is declared
    )
    return load_campaign(path)


def known_of(made: Campaign) -> PlanSetup:
    return beforehand(made, load_robot(made.robot.urdf, made.robot.tip))


def planned(made: Campaign, n: int, **asked: object) -> Plan:
    return design(known_of(made), PlanRequest(n, **asked))  # type: ignore[arg-type]


def a_choice(criterion: str, seed: int = 0, count: int = 12, solved_for: int = 2) -> RowChoice:
    """A small one of random numbers."""
    rng = np.random.default_rng(seed)
    target = rng.standard_normal((7, 3, 6))
    target[:, :, :solved_for] = 0.0
    rows = rng.standard_normal((count, 2, 6)) * rng.uniform(0.3, 3.0, (count, 1, 1))
    return RowChoice(rows, 0.1 * np.eye(6), target, np.ones(7), solved_for, criterion)  # type: ignore[arg-type]


# -- the exchange


@pytest.mark.parametrize("criterion", SETTINGS)
def test_a_choice_is_the_best_of_all_that_there_are(criterion: str) -> None:
    for seed in range(5):
        choice = a_choice(criterion, seed)
        every = [choice.cost(some) for some in combinations(range(12), 4)]
        found = best_choice(choice, 4, np.random.default_rng(0), starts=12)
        assert len(set(found)) == 4
        if criterion == "G":  # sought by way of weighted means: not always the very best
            assert choice.cost(found) <= np.quantile(every, 0.02)
        else:
            np.testing.assert_allclose(choice.cost(found), min(every), rtol=1e-9)


@pytest.mark.parametrize("criterion", ["A", "D"])
def test_no_single_exchange_makes_a_choice_better(criterion: str) -> None:
    choice = a_choice(criterion, seed=3, count=40)
    found = exchange_members(choice, list(range(8)))
    cost = choice.cost(found)
    others = [c for c in range(40) if c not in found]
    swapped = [choice.cost([*found[:k], c, *found[k + 1 :]]) for k in range(8) for c in others]
    assert min(swapped) >= cost - 1e-5 * abs(cost)


@pytest.mark.parametrize("criterion", SETTINGS)
def test_a_choice_of_rows_that_alone_tell_something_is_the_best(criterion: str) -> None:
    """Fewer rows than unknowns, of which next to nothing is known: what one row less leaves is asked anew, not downdated."""
    choice = replace(a_choice(criterion, seed=2, count=9), prior_information=1e-13 * np.eye(6))
    every = [choice.cost(some) for some in combinations(range(9), 2)]
    found = best_choice(choice, 2, np.random.default_rng(0), starts=12)
    assert choice.cost(found) <= (np.quantile(every, 0.1) if criterion == "G" else min(every) + 1e-6 * abs(min(every)))


def test_the_cost_of_criterion_d_is_that_of_what_is_asked_alone() -> None:
    """Against the covariance: its block of the other unknowns."""
    choice = a_choice("D")
    covariance = np.linalg.inv(choice.information([1, 5, 7]))[2:, 2:]
    np.testing.assert_allclose(choice.cost([1, 5, 7]), np.linalg.slogdet(covariance)[1], rtol=1e-10)


def test_sigmas_of_the_region_are_those_of_drawn_unknowns() -> None:
    choice = a_choice("A")
    covariance = np.linalg.inv(choice.information([0, 3, 4, 9]))
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(6), covariance, 40_000)
    moved = np.einsum("rik,nk->nri", choice.target, drawn)
    rms = np.sqrt(np.mean(np.sum(moved**2, axis=2)))
    worst = max(np.sqrt(np.linalg.eigvalsh(np.cov(moved[:, r].T))[-1]) for r in range(7))
    M = choice.information([0, 3, 4, 9])
    assert rms_sigma(choice, M) == pytest.approx(rms, rel=0.02)
    assert worst_sigma(choice, M) == pytest.approx(worst, rel=0.03)


def test_an_order_begins_with_what_is_worth_most_and_goes_on() -> None:
    choice = a_choice("A", count=40)
    chosen = exchange_members(choice, greedy(choice, 8))
    order = nested(choice, chosen, 12)
    assert set(order[:8]) == set(chosen) and len(set(order)) == 12
    costs = [choice.cost(order[:k]) for k in range(1, 13)]
    assert all(after < before for before, after in pairwise(costs))
    last = choice.cost(order[:7])
    assert last == pytest.approx(min(choice.cost([c for c in chosen if c != gone]) for gone in chosen))


# -- the order of visits, boxes, indices


def test_the_way_is_as_short_as_the_shortest_of_all() -> None:
    for seed in range(10):
        q = np.random.default_rng(seed).uniform(-2, 2, (7, 4))
        order, way = short_order(q), times(q)
        assert sorted(order.tolist()) == list(range(7))
        first = int(np.argmin(np.abs(q).max(axis=1)))
        every = [length(way, np.array([first, *p])) for p in permutations([k for k in range(7) if k != first])]
        assert length(way, order) <= 1.15 * min(every)
    q = np.random.default_rng(1).uniform(-2, 2, (60, 6))
    assert length(times(q), short_order(q)) < 0.8 * length(times(q), np.arange(60))


def test_a_line_crosses_a_box_where_its_points_do() -> None:
    box, rng = Box(min=(-0.3, -0.2, 0.1), max=(0.4, 0.5, 0.6)), np.random.default_rng(0)
    start, end = rng.uniform(-1, 1, (2, 500, 3))
    start[:50, 0] = end[:50, 0]  # along a face
    points = start[:, None] + np.linspace(0, 1, 4001)[:, None] * (end - start)[:, None]
    inside = ((points >= box.min) & (points <= box.max)).all(axis=2).any(axis=1)
    crossing = crosses(start, end, box)
    assert not (inside & ~crossing).any()
    assert (crossing & ~inside).sum() <= 3  # corners cut between two points
    assert 20 < crossing.sum() < 400


def test_indices_are_those_of_the_singular_values() -> None:
    rng = np.random.default_rng(0)
    B, J = rng.standard_normal((30, 2)), rng.standard_normal((30, 5))
    left = J - B @ np.linalg.lstsq(B, J, rcond=None)[0]
    s = np.linalg.svd(left, compute_uv=False)
    F = np.hstack([B, J])
    found = observability(F.T @ F, 2, 30)
    expected = (np.prod(s) ** 0.2 / np.sqrt(30), s[-1] / s[0], s[-1], s[-1] ** 2 / s[0], 1 / np.sum(1 / s))
    np.testing.assert_allclose(found, expected, rtol=1e-8)


# -- plans from nothing


def test_chosen_configurations_beat_random_ones(tmp_path: Path) -> None:
    poses = planned(campaign(tmp_path), 30)
    assert poses.at_n.rms < 0.94 * poses.random
    positions = planned(campaign(tmp_path, "kind: position, noise: {position: 1.0e-4}"), 15)
    assert positions.at_n.rms < 0.75 * positions.random
    assert [s.n for s in positions.sigma] == [3, 7, 15, 30]
    assert np.isnan(positions.sigma[0].rms)  # nine numbers tell nothing of twenty-seven unknowns


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_configuration_or_two_tell_nothing_and_that_is_said(tmp_path: Path) -> None:
    for n in (1, 2):
        plan = planned(campaign(tmp_path), n, criterion="G")
        assert len(plan.readings) == n and np.isnan([plan.at_n.rms, plan.at_n.worst, plan.random]).all()
        assert max(plan.indices[1:]) < 1.0  # some thousand where all is known


def test_predicted_sigma_is_the_scatter_of_calibrations(tmp_path: Path) -> None:
    """The whole fit, with frames and the choice of constants, on simulated poses of the nominal arm."""
    made = campaign(tmp_path, urdf="arid.urdf", tip="flange")
    known, robot = known_of(made), load_robot(made.robot.urdf, made.robot.tip)
    plan = design(known, PlanRequest(30))
    rng = np.random.default_rng(5)
    places = region_readings(known, None, np.random.default_rng(8))[:80]
    _, exact = targets_of(known, places, np.zeros(80, dtype=int))
    R, p = targets_of(known, plan.readings, np.zeros(30, dtype=int))
    off = []
    for _ in range(20):
        turned = robots.Rotation.from_rotvec(1e-4 * rng.standard_normal((30, 3))).as_matrix() @ R
        rows = robots.measured(robot, plan.readings, p + 1e-4 * rng.standard_normal((30, 3)), turned)
        fit = fit_geometry(made.question, robot, robots.declared(rows, 1e-4, 1e-4), ()).geometric
        off.append(fit.model.poses(fit.theta, fit.model.rows(places))[1] - exact)
    scatter = np.sqrt(np.mean(np.sum(np.array(off) ** 2, axis=2)))
    assert plan.at_n.rms == pytest.approx(scatter, rel=0.15)  # 20 draws of some 20 unknowns, other places


@pytest.mark.parametrize(
    ("block", "more", "n"),
    [
        (POSE, TOOL, 12),
        ("kind: position, noise: {position: 1.0e-4}", TOOL, 15),
        ("kind: point, noise: {position: 1.0e-4}", TOOL + "instruments: {points: points.csv}\n", 20),
        (
            "kind: distance, noise: {distance: 1.0e-4}",
            TOOL + "instruments: {anchors: {rail: {xyz: [1.2, 0.3, 0.1]}}}\n",
            40,
        ),
    ],
    ids=["pose", "position", "point", "distance"],
)
def test_a_plan_is_within_five_per_cent_of_the_best_of_many_exchanges(
    tmp_path: Path, block: str, more: str, n: int
) -> None:
    (tmp_path / "points.csv").write_text("point,x,y,z,std\na,0.7,0.2,0.3,0.05\nb,0.5,-0.5,0.5,0.05\n")
    known, rng = known_of(campaign(tmp_path, block, more)), np.random.default_rng(0)
    candidates = draw_candidates(known, 200, n, rng)
    choice, _ = question(known, PlanRequest(n), candidates, region_readings(known, None, rng))
    found = choice.cost(best_choice(choice, n, rng))
    others = [
        choice.cost(exchange_members(choice, rng.permutation(len(candidates.readings))[:n].tolist())) for _ in range(8)
    ]
    assert np.sqrt(found) <= 1.05 * np.sqrt(min(others))


def test_configurations_of_points_hold_the_target_there(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("point,x,y,z\na,0.7,0.2,0.3\nb,0.5,-0.5,0.5\n")
    made = campaign(tmp_path, "kind: point, noise: {position: 1.0e-4}", TOOL + "instruments: {points: points.csv}\n")
    known = known_of(made)
    plan = design(known, PlanRequest(12))
    place = {"a": [0.7, 0.2, 0.3], "b": [0.5, -0.5, 0.5]}
    _, p = targets_of(known, plan.readings, np.zeros(12, dtype=int))
    np.testing.assert_allclose(p, [place[label] for label in plan.labels["point"]], atol=1e-6)
    table = as_table(plan, load_robot(made.robot.urdf, made.robot.tip), made.measurements)
    assert list(table.columns)[-1] == "point" and set(table["point"]) <= {"a", "b"}


def test_images_are_planned_that_show_the_board(tmp_path: Path) -> None:
    """The markers that a plan counts on lie in the image by an own pinhole, and before the camera."""
    board = [(f"m{i}{j}", 0.06 * i, 0.06 * j) for i in range(4) for j in range(3)]
    (tmp_path / "markers.csv").write_text("marker,x,y,z\n" + "".join(f"{m},{x},{y},0\n" for m, x, y in board))
    camera = "fx: 500, fy: 500, cx: 320, cy: 240, width: 640, height: 480, on: tip, xyz: [0, 0, 0.05], rpy: [0, 0, 0]"
    place = "file: markers.csv, xyz: [0.6, 0, 0.05], rpy: [0, 0, 0]"
    more = f"instruments: {{cameras: {{eye: {{{camera}}}}}, markers: {{{place}}}}}\n"
    known = known_of(campaign(tmp_path, "kind: pixels, noise: {pixel: 0.2}", more))
    plan = design(known, PlanRequest(8))
    R, p = targets_of(known, plan.readings, np.zeros(8, dtype=int))
    markers = np.array([(x + 0.6, y, 0.05) for _, x, y in board])
    seen = np.einsum("nji,nmj->nmi", R, markers - p[:, None]) - [0, 0, 0.05]
    pixel = 500 * seen[..., :2] / seen[..., 2:] + [320, 240]
    shown = (seen[..., 2] > 0) & (pixel > 0).all(axis=2) & (pixel < [640, 480]).all(axis=2)
    assert (shown.sum(axis=1) >= 4).all()
    assert set(plan.labels["camera"]) == {"eye"} and plan.at_n.rms < 1e-3


def test_the_arm_keeps_out_of_boxes_and_off_its_limits(tmp_path: Path) -> None:
    more = TOOL + "design: {keep_out: [{min: [-2, -2, -2], max: [2, 2, 0.05]}, {min: [0.3, -2, 0], max: [2, 2, 2]}]}\n"
    made = campaign(tmp_path, more=more)
    known, robot = known_of(made), load_robot(made.robot.urdf, made.robot.tip)
    # the first joint's own origin is above the floor, the base frame's is not part of the arm
    plan = design(known, PlanRequest(10))
    _, tool = targets_of(known, plan.readings, np.zeros(10, dtype=int))
    points = np.concatenate([joint_frames(robot, plan.readings)[1], tool[:, None]], axis=1)
    line = points[:, :-1, None] + np.linspace(0, 1, 50)[:, None] * (points[:, 1:] - points[:, :-1])[:, :, None]
    assert (line[..., 2] > 0.05).all() and (line[..., 0] < 0.3).all()
    low, high = robot.limits.T
    share = (plan.readings - low) / (high - low)  # said to the user: 2 % at either end
    assert share.min() >= 0.02 - 1e-12 and share.max() <= 0.98 + 1e-12


def test_the_region_decides_where_the_target_is_known(tmp_path: Path) -> None:
    made = campaign(tmp_path)
    robot = load_robot(made.robot.urdf, made.robot.tip)
    known, rng = known_of(made), np.random.default_rng(0)
    cell = np.array([0.6, -0.9, 1.2, -0.4, 1.0, 0.3]) + rng.uniform(-0.3, 0.3, (40, 6))
    joints, places = tmp_path / "joints.csv", tmp_path / "places.csv"
    pd.DataFrame(cell, columns=list(robot.readings)).to_csv(joints, index=False)
    _, p = targets_of(known, cell, np.zeros(40, dtype=int))
    pd.DataFrame(p, columns=["x", "y", "z"]).to_csv(places, index=False)
    np.testing.assert_allclose(region(known, joints, rng), cell)
    again = region(known, places, rng)
    np.testing.assert_allclose(targets_of(known, again, np.zeros(40, dtype=int))[1], p, atol=1e-6)
    of_cell = design(known, PlanRequest(10, region=joints))
    candidates = draw_candidates(known, 300, 10, np.random.default_rng(0))
    choice, _ = question(known, PlanRequest(10), candidates, cell)
    anywhere, _ = question(known, PlanRequest(10), candidates, region_readings(known, None, rng))
    chosen = best_choice(anywhere, 10, rng)
    assert of_cell.at_n.rms < rms_sigma(choice, choice.information(chosen))


def test_the_campaign_s_own_region_and_tool_are_planned_for(tmp_path: Path) -> None:
    """Second road: the same table as --region; and the covariance of the point from drawn unknowns."""
    rng = np.random.default_rng(0)
    cell = np.array([0.6, -0.9, 1.2, -0.4, 1.0, 0.3]) + rng.uniform(-0.3, 0.3, (40, 6))
    made = campaign(tmp_path)
    names = list(load_robot(made.robot.urdf, made.robot.tip).readings)
    pd.DataFrame(cell, columns=names).to_csv(tmp_path / "cell.csv", index=False)
    named = planned(made, 8, region=tmp_path / "cell.csv")
    assert not any("region" in notice for notice in named.notices)
    own = planned(campaign(tmp_path, more=TOOL + "region: {file: cell.csv}\n"), 8)
    np.testing.assert_array_equal(own.readings, named.readings)
    assert any("over the `region` that the campaign names" in notice for notice in own.notices)
    box = known_of(campaign(tmp_path, more=TOOL + f"region: {{joints: {{{names[1]}: [-1.2, -0.8]}}}}\n"))
    readings, limits = region_readings(box, None, rng), box.robot.limits
    assert (readings[:, 1] >= -1.2).all() and (readings[:, 1] <= -0.8).all()
    assert np.ptp(readings[:, 0]) > 0.9 * np.ptp(limits[0])
    point = (0.0, 0.3, 0.1)
    far = known_of(campaign(tmp_path, more=TOOL + f"region: {{file: cell.csv, tool: {list(point)}}}\n"))
    candidates = draw_candidates(far, 200, 10, np.random.default_rng(0))
    choice, of = question(far, PlanRequest(8), candidates, region_readings(far, None, rng))
    step = 1e-6
    for place, k in list(enumerate(of.coefficients))[::7]:
        ends = []
        for sign in (step, -step):
            theta = far.theta + sign * (np.arange(len(far.theta)) == k)
            R, p = far.model.poses(theta, far.model.rows(cell))
            ends.append(p + R @ np.array(point))
        moved = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(choice.target[:, :, of.things + place], moved, atol=1e-7)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "should have the columns of all joints"),
        ("x,y,z\n0.5,0.2,\n", "empty"),
        ("x,y,z\n9,9,9\n", "cannot reach"),
    ],
)
def test_a_region_that_cannot_be_used_is_refused(
    tmp_path: Path, text: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reachable, "MOST_ROUNDS", 2)  # a place nine metres away is tried no more often than that
    (tmp_path / "region.csv").write_text(text)
    with pytest.raises(AridcalError, match=said):
        planned(campaign(tmp_path), 5, region=tmp_path / "region.csv")


# -- adding to what was measured


@pytest.fixture
def begun(tmp_path: Path) -> Campaign:
    """A campaign with forty poses."""
    robot = robots.ur10()
    rng = np.random.default_rng(3)
    path = robots.write_campaign(tmp_path, robots.simulate(robot, 40, rng, noise=1e-4))
    return load_campaign(path)


def test_new_rows_add_to_those_measured(begun: Campaign) -> None:
    """Without new ones the sigma is that of the fit's own covariance."""
    robot = load_robot(begun.robot.urdf, begun.robot.tip, begun.robot.base)
    known = beforehand(begun, robot)
    plan = design(known, PlanRequest(8))
    assert [s.n for s in plan.sigma] == [0, 2, 4, 8, 16]
    rows = load_measurements(begun, robot.readings, robot.limits, robot.kinds)
    fit = fit_constants(begun.question, robot, rows, ()).geometric
    drawing = np.random.default_rng(np.random.SeedSequence(0).spawn(3)[0])
    draw_candidates(known, 200, 16, drawing)
    places = region_readings(known, None, drawing)
    _, _, J = fit.model.jacobian(fit.theta, fit.model.rows(places))
    own = np.einsum("nik,kl,nil->n", J[:, :3], fit.covariance, J[:, :3])
    assert plan.sigma[0].rms == pytest.approx(np.sqrt(own.mean()), rel=1e-3)
    worst, _ = target_sigma(fit, fit.model.rows(places))
    assert plan.sigma[0].worst == pytest.approx(worst.max(), rel=1e-3)
    assert plan.at_n.rms < plan.random < plan.sigma[0].rms


def test_one_station_and_one_block_are_planned_of_several(begun: Campaign, tmp_path: Path) -> None:
    """At the station of the last row; of the first block, what the other one tells counted in."""
    table = pd.read_csv(tmp_path / "measurements.csv")
    table["station"] = np.where(np.arange(40) < 25, "left", "right")
    table.to_csv(tmp_path / "stations.csv", index=False)
    text = begun.path.read_text().replace("measurements.csv", "stations.csv")
    (tmp_path / "stations.yaml").write_text(text + "frames: {world_base: {per: station}}\n")
    made = load_campaign(tmp_path / "stations.yaml")
    robot = load_robot(made.robot.urdf, made.robot.tip)
    plan = design(beforehand(made, robot), PlanRequest(4))
    assert set(plan.labels["station"]) == {"right"} and "right" in plan.notices[0]
    assert "station" in as_table(plan, robot, made.measurements)

    table = pd.read_csv(tmp_path / "measurements.csv")
    anchor = np.array([1.5, 0.4, 0.2])
    wire = np.linalg.norm(table[["x", "y", "z"]].to_numpy() - anchor, axis=1)
    table[list(robot.readings)].assign(distance=wire + 1e-4 * np.random.default_rng(0).standard_normal(40)).to_csv(
        tmp_path / "wire.csv", index=False
    )
    keys = f"format: 1\nrobot: {{urdf: {made.robot.urdf}, tip: {made.robot.tip}}}\nmeasurements:\n"
    blocks = "- {kind: distance, file: wire.csv}\n- {kind: pose, file: measurements.csv}\n"
    (tmp_path / "blocks.yaml").write_text(keys + blocks)
    both = design(beforehand(load_campaign(tmp_path / "blocks.yaml"), robot), PlanRequest(4))
    assert "anchor" in both.labels and "first block, distance" in both.notices[0]
    assert both.measured > 50 and both.at_n.rms < both.sigma[0].rms


# -- two effects told apart


def test_configurations_tell_two_effects_apart(tmp_path: Path) -> None:
    made = campaign(tmp_path, urdf="arid.urdf", tip="flange")
    pair = ("joint_3.joint_gain", "joint_3.joint_harmonic")
    known, rng = known_of(made), np.random.default_rng(0)
    candidates = draw_candidates(known, 300, 12, rng)
    choice, _ = question(known, PlanRequest(12, apart=pair), candidates, region_readings(known, None, rng))
    plain, _ = question(known, PlanRequest(12), candidates, region_readings(known, None, rng))
    apart, well = best_choice(choice, 12, rng), best_choice(plain, 12, rng)
    sigma = [rms_sigma(choice, choice.information(some)) for some in (apart, well)]
    assert sigma[0] < 0.9 * sigma[1]
    # each effect's own variance with all else left open, by the plain inverse
    M = choice.information(apart)
    moved = choice.target @ np.linalg.inv(M) @ choice.target.transpose(0, 2, 1)
    assert sigma[0] == pytest.approx(np.sqrt(np.mean(np.trace(moved, axis1=1, axis2=2))))
    assert len(choice.target) % 2 == 0 and not (choice.target[0] * choice.target[-1]).any()


def test_effects_that_a_campaign_declares_are_planned_for(tmp_path: Path) -> None:
    more = "effects: [{kind: joint_gain, where: joint_3}, {kind: thermal, where: joint_2}]\n"
    plain = planned(campaign(tmp_path, urdf="arid.urdf", tip="flange"), 10)
    plan = planned(campaign(tmp_path, more=TOOL + more, urdf="arid.urdf", tip="flange"), 10)
    assert plan.unknowns == plain.unknowns + 1 and plan.at_n.rms > plain.at_n.rms
    assert len(plan.notices) == 1 and "not planned for" in plan.notices[0] and "thermal" in plan.notices[0]
    pair = ("joint_3.joint_gain", "joint_3.joint_harmonic")
    duels = planned(campaign(tmp_path, more=TOOL + more, urdf="arid.urdf", tip="flange"), 10, apart=pair).duels
    assert {duel.true for duel in duels} == {"joint_gain at joint_3", "joint_harmonic at joint_3 (1)"}


@pytest.mark.parametrize(
    ("pair", "said"),
    [
        (("joint_3.joint_gian", "joint_3.joint_gain"), "did you mean 'joint_gain'"),
        (("elbow.joint_gain", "joint_3.joint_gain"), "no place 'elbow'"),
        (("joint_3.joint_coupling", "joint_3.joint_gain"), "declare it under `effects`"),
    ],
)
def test_effects_that_do_not_exist_are_refused(tmp_path: Path, pair: tuple[str, str], said: str) -> None:
    with pytest.raises(CampaignError, match=said):
        planned(campaign(tmp_path, urdf="arid.urdf", tip="flange"), 8, apart=pair)


# -- what cannot be planned, and the command


@pytest.mark.parametrize(
    ("block", "more", "said"),
    [
        ("kind: point", TOOL, "say nearly where: `points: points.csv`"),
        ("kind: distance", TOOL + "instruments: {anchors: {rail: {}}}\n", "say nearly where: `anchors"),
        (POSE, "frames: {world_base: {per: station}}\n", "no station is known"),
        (POSE, "design: {keep_out: [{min: [-9, -9, -9], max: [9, 9, 9]}]}\n", "check `design.keep_out`"),
        (POSE, "design: {keep_out: [{min: [1, 0, 0], max: [0, 1, 1]}]}\n", "`min` should be below"),
    ],
)
def test_what_cannot_be_planned_is_said(tmp_path: Path, block: str, more: str, said: str) -> None:
    with pytest.raises(AridcalError, match=said):
        planned(campaign(tmp_path, block, more), 5)


def test_half_of_the_tables_is_no_campaign(tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text("x\n1\n")
    path = campaign(tmp_path).path
    path.write_text(path.read_text().replace("file: rows.csv", "file: [rows.csv, more.csv]"))
    with pytest.raises(MeasurementError, match=r"more.csv: there is no such file"):
        known_of(load_campaign(path))


def test_the_command_writes_joints_in_the_campaigns_columns_and_units(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    block = POSE + ", units: {angle: deg, length: mm}, columns: {joint_1: J1}"
    made = campaign(tmp_path, block, urdf="arid.urdf", tip="flange")
    out = tmp_path / "poses.csv"
    assert command.main([str(made.path), "-n", "6", "-o", str(out)]) == 0
    robot, table = load_robot(made.robot.urdf, made.robot.tip), pd.read_csv(out)
    assert list(table.columns) == ["J1", *robot.readings[1:]] and len(table) == 6
    expected = planned(made, 6).readings / [1e-3 if kind == "prismatic" else np.pi / 180 for kind in robot.kinds]
    np.testing.assert_allclose(table.to_numpy(), expected, rtol=1e-14)
    said = capsys.readouterr().out
    assert "as many random configurations, mm" in said and "O5" in said and "6 configurations" in said
    again = tmp_path / "again.csv"
    assert command.main([str(made.path), "-n", "6", "-o", str(again)]) == 0
    assert again.read_bytes() == out.read_bytes()


@pytest.mark.parametrize(
    "arguments",
    [["-n", "0"], ["-n", "501"], ["-n", "5", "--apart", "joint_1.joint_gain"], ["-n", "5", "--optimal", "E"]],
)
def test_a_slip_in_the_arguments_is_bad_use(tmp_path: Path, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        command.main([str(campaign(tmp_path).path), "-o", str(tmp_path / "poses.csv"), *arguments])
    assert stop.value.code == 2


def test_a_failed_plan_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "poses.csv"
    out.write_text("kept\n")
    assert command.main([str(campaign(tmp_path, "kind: point").path), "-n", "5", "-o", str(out)]) == 2
    assert out.read_text() == "kept\n"
    assert command.main([str(campaign(tmp_path).path), "-n", "5", "-o", str(tmp_path / "poses.txt")]) == 2
    assert "ends in one of .csv" in capsys.readouterr().err
    assert command.main([str(campaign(tmp_path).path), "-n", "5", "-o", str(tmp_path / "rows.csv")]) == 2
    assert (
        "this would overwrite it; write to another file" in capsys.readouterr().err
        and not (tmp_path / "rows.csv").exists()
    )
