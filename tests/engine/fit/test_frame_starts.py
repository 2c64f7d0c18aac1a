"""Closed-form starts: unknown frames found from any attitude; what the measurements cannot tell stays at its hint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
from repository import ROOT
from scipy.optimize import minimize

from aridcal.engine.fit.frame_starts import FrameStart, PoseRows, descend, lever_cost, start_frames
from aridcal.engine.fit.least_squares import fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.files.campaign import load_campaign
from aridcal.files.read import load_measurements

CAMPAIGNS = ROOT / "identification"
IDENTITY = (pin.SE3.Identity(),)
FINE = {"ftol": 1e-15, "gtol": 1e-12}


def starts(
    truth: robots.Truth,
    known_world: tuple[pin.SE3, ...] | None = None,
    known_tip: tuple[pin.SE3, ...] | None = None,
    world: np.ndarray | None = None,
    tip: np.ndarray | None = None,
    hint: tuple[pin.SE3, ...] = IDENTITY,
) -> list[FrameStart]:
    """Starts from the nominal robot: it knows nothing of the truth."""
    R, p = tip_frames(truth.model.robot, truth.readings)
    one = np.zeros(len(p), dtype=int)
    where = one if world is None else world, one if tip is None else tip
    rows = PoseRows(R, p, truth.measured.rotation, truth.measured.position, *where)
    return start_frames(rows, known_world, known_tip, hint)


def optimum(truth: robots.Truth, candidates: list[FrameStart]) -> tuple[float, Model, np.ndarray]:
    """Cost of the best fit of the two frames from the closed-form starts, and where it is."""
    best = None
    for start in candidates:
        frames = ((None, start.world_base[0]),), ((None, start.tip_target[0]),)
        model = Model(truth.model.robot, robots.FRAMES, *frames)
        found = fit_identifiable(truth.data(model, 1e-3, 1e-3), range(12))
        r = problem(found.model, truth.measured).residual(found.theta)
        cost = float(np.sum(r**2))
        if best is None or cost < best[0]:
            best = cost, found.model, found.theta
    assert best is not None
    return best


def positions_only(truth: robots.Truth) -> robots.Truth:
    return replace(truth, measured=robots.positions_alone(truth.measured))


@pytest.mark.parametrize("robot", [robots.arid, robots.ur10], ids=["arid", "ur10"])
@pytest.mark.parametrize("kind", ["pose", "position"])
def test_random_frames_lead_to_the_same_optimum(kind: str, robot) -> None:  # type: ignore[no-untyped-def]
    """A robot off by millimetres, measured with noise; tracker and target anywhere, in any attitude.

    The target stays at its place on the tip, so that the cost itself must not change.
    """
    rng = np.random.default_rng(0)
    base = robots.simulate(robot(), 60, rng, 1e-3, 1e-4, tip=robots.random_placement(rng, 0.3))
    costs = []
    for _ in range(7):
        truth = robots.moved(base, robots.random_placement(rng, 5.0), robots.random_placement(rng, 0.0))
        truth = positions_only(truth) if kind == "position" else truth
        cost, model, theta = optimum(truth, starts(truth))
        costs.append(cost)
        world, target = model.frames(theta)
        if robot is robots.arid:
            continue  # its axes are parallel: a shift along them may be either frame's
        if kind == "pose":
            off = truth.model.world_base[0][1].inverse() * world[0][1]
            assert np.linalg.norm(pin.log6(off).vector) < 0.05
        assert np.linalg.norm(target[0][1].translation - truth.model.tip_target[0][1].translation) < 0.05
    assert np.ptp(costs) < 1e-6 * np.mean(costs)


@pytest.mark.parametrize("tips", [1, 4])
def test_descents_end_no_higher_than_those_of_scipy(tips: int) -> None:
    rng = np.random.default_rng(tips)
    truth = robots.simulate(robots.ur10(), 60, rng, 1e-3, 1e-4, tip=robots.random_placement(rng, 0.3))
    R, p = tip_frames(truth.model.robot, truth.readings)
    tip, world = np.arange(60) % tips, np.arange(60) % 2
    cost = lever_cost(PoseRows(R, p, None, truth.measured.position, world, tip), tips)

    def one_place(t: np.ndarray) -> tuple[float, np.ndarray]:
        values, slopes = cost(t[None])
        return float(values[0]), slopes[0]

    starts = rng.uniform(-2.0, 2.0, (10, 3 * tips))
    places = descend(cost, starts, 1.0)
    for start, place, value in zip(starts, places, cost(places)[0], strict=True):
        peer, again = (minimize(one_place, x, jac=True, method="L-BFGS-B", options=FINE) for x in (start, place))
        assert value <= peer.fun + 1e-9 or np.linalg.norm(place - peer.x) > 1e-2  # or another minimum
        assert value <= again.fun + 1e-10


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_exact_data_give_exact_frames_without_a_fit(kind: str) -> None:
    rng = np.random.default_rng(1)
    base = robots.simulate(robots.ur10(), 40, rng, 0.0)
    for _ in range(20):
        truth = robots.moved(base, robots.random_placement(rng), robots.random_placement(rng, 0.5))
        truth = positions_only(truth) if kind == "position" else truth
        tip = truth.model.tip_target[0][1]
        hint = (tip,) if kind == "position" else IDENTITY
        best = min(
            np.abs((truth.model.world_base[0][1].inverse() * s.world_base[0]).homogeneous - np.eye(4)).max()
            + np.abs((tip.inverse() * s.tip_target[0]).homogeneous - np.eye(4)).max()
            for s in starts(truth, hint=hint)
        )
        assert best < 1e-4


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_one_known_frame_leaves_one_closed_form(kind: str) -> None:
    rng = np.random.default_rng(2)
    base = robots.simulate(robots.ur10(), 30, rng, 0.0)
    truth = robots.moved(base, robots.random_placement(rng), robots.random_placement(rng, 0.5))
    truth = positions_only(truth) if kind == "position" else truth
    world, tip = (truth.model.world_base[0][1],), (truth.model.tip_target[0][1],)
    (found,) = starts(truth, known_world=world, hint=tip)
    assert (tip[0].inverse() * found.tip_target[0]).isIdentity(1e-9)
    (found,) = starts(truth, known_tip=tip)
    assert (world[0].inverse() * found.world_base[0]).isIdentity(1e-9)
    (found,) = starts(truth, known_world=world, known_tip=tip)
    assert (found.world_base, found.tip_target) == (world, tip)


def test_a_target_whose_rotation_is_not_measured_keeps_its_hint() -> None:
    rng = np.random.default_rng(3)
    truth = positions_only(robots.moved(robots.simulate(robots.ur10(), 30, rng), robots.random_placement(rng),
                                        robots.random_placement(rng, 0.2)))  # fmt: skip
    hint = (robots.random_placement(rng),)
    for start in starts(truth, hint=hint):
        assert np.array_equal(start.tip_target[0].rotation, hint[0].rotation)


def test_wild_rows_do_not_lead_the_start_astray() -> None:
    """5 % of the rows off by half a metre and any rotation: the fit still gets home."""
    rng = np.random.default_rng(4)
    base = robots.simulate(robots.ur10(), 100, rng, 1e-3, 1e-4)
    truth = robots.moved(base, robots.random_placement(rng), robots.random_placement(rng, 0.3))
    assert truth.measured.rotation is not None
    p, R = truth.measured.position.copy(), truth.measured.rotation.copy()
    p[:5] += rng.uniform(-0.5, 0.5, (5, 3))
    R[5:10] = [robots.random_placement(rng).rotation for _ in range(5)]
    spoilt = replace(truth, measured=robots.placed(truth.measured, position=p, rotation=R))
    _, clean, a = optimum(truth, starts(truth))
    _, dirty, b = optimum(spoilt, starts(spoilt))
    for one, other in zip(clean.frames(a), dirty.frames(b), strict=True):
        assert np.linalg.norm(pin.log6(one[0][1].inverse() * other[0][1]).vector) < 2e-3


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_a_planar_arm_is_no_obstacle(kind: str) -> None:
    """The ARID without its rail: all points in one plane, where Kabsch's H is singular."""
    rng = np.random.default_rng(5)
    base = robots.simulate(robots.arid(), 60, rng, 0.0, 1e-5)
    base.readings[:, 0] = 3.0
    R, p = base.model.poses(base.theta, base.model.rows(base.readings))
    p = p + 1e-5 * rng.normal(size=p.shape)
    base = replace(base, measured=robots.measured(base.model.robot, base.readings, p, R))
    truth = robots.moved(base, robots.random_placement(rng), robots.random_placement(rng, 0.3))
    truth = positions_only(truth) if kind == "position" else truth
    cost, _, _ = optimum(truth, starts(truth))
    assert cost < 60 * 6 * (3e-5) ** 2


def test_a_tool_that_never_turns_still_fits() -> None:
    """The ARID holding its camera level: the target's translation is arbitrary, the fit is not."""
    rng = np.random.default_rng(6)
    base = robots.simulate(robots.arid(), 80, rng, 0.0)
    base.readings[:, 3] = -base.readings[:, 1] - base.readings[:, 2]
    R, p = base.model.poses(base.theta, base.model.rows(base.readings))
    p = p + 1e-5 * rng.normal(size=p.shape)
    base = replace(base, measured=robots.measured(base.model.robot, base.readings, p, R))
    truth = robots.moved(base, robots.random_placement(rng), robots.random_placement(rng, 0.3))
    found = starts(truth)
    misfits = []
    for start in found:
        model = Model(truth.model.robot, (), ((None, start.world_base[0]),), ((None, start.tip_target[0]),))
        r = problem(model, truth.measured).residual(np.zeros(0))
        misfits.append(np.sqrt(np.mean(r**2)))
    assert min(misfits) < 1e-3
    cost, model, theta = optimum(truth, found)
    assert cost < 80 * 6 * (3e-5) ** 2
    assert all(np.linalg.norm(f[0][1].translation) < 100.0 for f in model.frames(theta))


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("per", ["world", "tip", "both"])
def test_each_station_has_its_own_start(per: str, kind: str) -> None:
    rng = np.random.default_rng(7)
    base = robots.simulate(robots.ur10(), 90, rng, 0.0)
    label = np.arange(90) % 3
    worlds = [robots.random_placement(rng) for _ in range(3 if per != "tip" else 1)]
    tips = [robots.random_placement(rng, 0.3) for _ in range(3 if per != "world" else 1)]
    w, t = label % len(worlds), label % len(tips)
    assert base.measured.rotation is not None
    T = [worlds[w[n]] * pin.SE3(base.measured.rotation[n], base.measured.position[n]) * tips[t[n]] for n in range(90)]
    R = np.array([x.rotation for x in T]) if kind == "pose" else None
    p = np.array([x.translation for x in T])
    truth = replace(base, measured=robots.measured(base.model.robot, base.readings, p, R))
    found = starts(truth, world=w, tip=t, hint=tuple(tips))
    best = min(
        max(
            np.abs((a.inverse() * b).homogeneous - np.eye(4)).max()
            for a, b in zip([*worlds, *tips], [*s.world_base, *s.tip_target], strict=True)
        )
        for s in found
    )
    assert best < 1e-3


def test_thousands_of_rows_start_from_some_of_them() -> None:
    rng = np.random.default_rng(8)
    base = robots.simulate(robots.ur10(), 9000, rng, 0.0)
    truth = robots.moved(base, robots.random_placement(rng), robots.random_placement(rng, 0.3))
    assert len(truth.data(truth.model)) == 9000
    off = [
        np.abs((truth.model.world_base[0][1].inverse() * s.world_base[0]).homogeneous - np.eye(4)).max()
        for s in starts(truth)
    ]
    assert min(off) < 1e-4


# -- what the measurements cannot tell stays at its hint


def tilt_free(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Poses of a tool that only ever turns about the base's z: rotations (n, 3, 3), positions (n, 3)."""
    turn = np.array([pin.exp3(np.array([0.0, 0.0, a])) for a in rng.uniform(-np.pi, np.pi, n)])
    return turn, rng.uniform(-1, 1, (n, 3))


def starts_of(
    R: np.ndarray, p: np.ndarray, X: pin.SE3, Y: pin.SE3, hint: pin.SE3, kind: str, noise: np.ndarray | float = 0.0
) -> list[FrameStart]:
    position = p @ X.rotation.T + X.translation + (X.rotation @ R) @ Y.translation + noise
    rotation = X.rotation @ R @ Y.rotation if kind == "pose" else None
    zero = np.zeros(len(p), dtype=int)
    return start_frames(PoseRows(R, p, rotation, position, zero, zero), None, None, (hint,))


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("seed", range(3))
def test_a_translation_that_the_base_can_follow_starts_at_its_hint(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, p = tilt_free(60, rng)
    X, Y, hint = (robots.random_placement(rng) for _ in range(3))
    best = starts_of(R, p, X, Y, hint, kind, 1e-4 * rng.normal(size=p.shape))[0]
    t = best.tip_target[0].translation
    assert t[2] == pytest.approx(hint.translation[2], abs=1e-9)
    assert t[:2] == pytest.approx(Y.translation[:2], abs=1e-3)
    # ... and the base made up for it.
    seen = best.world_base[0].act(p[0] + R[0] @ t)
    assert seen == pytest.approx(X.act(p[0] + R[0] @ Y.translation), abs=1e-3)


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_a_tool_that_never_turns_keeps_its_whole_translation_at_the_hint(kind: str) -> None:
    rng = np.random.default_rng(3)
    p = rng.uniform(-1, 1, (40, 3))
    R = np.broadcast_to(robots.random_placement(rng).rotation, (40, 3, 3))
    X, Y, hint = (robots.random_placement(rng) for _ in range(3))
    for start in starts_of(R, p, X, Y, hint, kind):
        assert start.tip_target[0].translation == pytest.approx(hint.translation, abs=1e-9)


def test_a_hint_far_off_spoils_no_start_that_the_measurements_barely_tell() -> None:
    rng = np.random.default_rng(4)
    turn, p = tilt_free(500, rng)
    R = np.array([T @ pin.exp3(3e-4 * w) for T, w in zip(turn, rng.normal(size=(500, 3)), strict=True)])
    X, Y = robots.random_placement(rng), robots.random_placement(rng)
    hint = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1000.0]))
    noise = 5e-4 * rng.normal(size=p.shape)
    best = starts_of(R, p, X, Y, hint, "pose", noise)[0]
    seen = p @ best.world_base[0].rotation.T + best.world_base[0].translation
    seen = seen + (best.world_base[0].rotation @ R) @ best.tip_target[0].translation
    true = p @ X.rotation.T + X.translation + (X.rotation @ R) @ Y.translation
    assert np.sqrt(np.mean((true + noise - seen) ** 2)) < 1.1 * np.sqrt(np.mean(noise**2))


def test_series_d_names_its_target_translation_and_keeps_it_at_the_hint(shared_data: Path) -> None:
    # Public data of a UR10 whose tool stayed upright: github.com/christianlandgraf/ipa-robot-accuracy, series D.
    assert shared_data.is_dir()
    campaign = load_campaign(CAMPAIGNS / "ur10-laser-tracker" / "campaign-d.yaml")
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base)
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds, 0)
    geometry = fit_geometry(campaign.question, robot, rows.select(rows.train), ())
    hint = campaign.frames.tip_target.xyz
    for found in (geometry.nominal, geometry.geometric):
        assert "tip_target.z" in found.redundant
        assert any(name.startswith("world_base.") for name in found.redundant["tip_target.z"])
        tip = found.model.recentred(found.theta)[0].tip_target[0][1]
        assert tip.translation[2] == pytest.approx(hint[2], abs=1e-4)
        assert np.abs(tip.translation[:2]).max() < 2e-3  # nothing ran away
