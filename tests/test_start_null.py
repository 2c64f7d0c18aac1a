"""Closed-form starts keep at its hint what the measurements cannot tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots

from aridcal.campaign import load_campaign
from aridcal.geometry import fit_geometry
from aridcal.identify import stale_rows
from aridcal.measurements import load_measurements
from aridcal.quality import joint_kinds, joint_limits
from aridcal.residual import Observations
from aridcal.robot import load_robot
from aridcal.solver import Noise
from aridcal.start import FrameStart, start_frames

CAMPAIGNS = Path(__file__).resolve().parents[1] / "identification"


def tilt_free(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Poses of a tool that only ever turns about the base's z: rotations (n, 3, 3), positions (n, 3)."""
    turn = np.array([pin.exp3(np.array([0.0, 0.0, a])) for a in rng.uniform(-np.pi, np.pi, n)])
    return turn, rng.uniform(-1, 1, (n, 3))


def starts(
    R: np.ndarray, p: np.ndarray, X: pin.SE3, Y: pin.SE3, hint: pin.SE3, kind: str, noise: np.ndarray | float = 0.0
) -> list[FrameStart]:
    position = p @ X.rotation.T + X.translation + (X.rotation @ R) @ Y.translation + noise
    measured = Observations(position, X.rotation @ R @ Y.rotation if kind == "pose" else None)
    zero = np.zeros(len(p), dtype=int)
    return start_frames(R, p, measured, zero, zero, None, None, (hint,))


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("seed", range(3))
def test_a_translation_that_the_base_can_follow_starts_at_its_hint(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, p = tilt_free(60, rng)
    X, Y, hint = (robots.random_placement(rng) for _ in range(3))
    best = starts(R, p, X, Y, hint, kind, 1e-4 * rng.normal(size=p.shape))[0]
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
    for start in starts(R, p, X, Y, hint, kind):
        assert start.tip_target[0].translation == pytest.approx(hint.translation, abs=1e-9)


def test_a_hint_far_off_spoils_no_start_that_the_measurements_barely_tell() -> None:
    rng = np.random.default_rng(4)
    turn, p = tilt_free(500, rng)
    R = np.array([T @ pin.exp3(3e-4 * w) for T, w in zip(turn, rng.normal(size=(500, 3)), strict=True)])
    X, Y = robots.random_placement(rng), robots.random_placement(rng)
    hint = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1000.0]))
    noise = 5e-4 * rng.normal(size=p.shape)
    best = starts(R, p, X, Y, hint, "pose", noise)[0]
    seen = p @ best.world_base[0].rotation.T + best.world_base[0].translation
    seen = seen + (best.world_base[0].rotation @ R) @ best.tip_target[0].translation
    true = p @ X.rotation.T + X.translation + (X.rotation @ R) @ Y.translation
    assert np.sqrt(np.mean((true + noise - seen) ** 2)) < 1.1 * np.sqrt(np.mean(noise**2))


def test_series_d_names_its_target_translation_and_keeps_it_at_the_hint(shared_data: Path) -> None:
    # Public data of a UR10 whose tool stayed upright: github.com/christianlandgraf/ipa-robot-accuracy, series D.
    assert shared_data.is_dir()
    campaign = load_campaign(CAMPAIGNS / "ur10-laser-tracker" / "campaign-d.yaml")
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base)
    rows = load_measurements(campaign, robot.readings, joint_limits(robot), joint_kinds(robot), 0)
    train = ~rows.test
    geometry = fit_geometry(campaign, robot, rows.select(train), (), Noise(), stale_rows(rows)[train])
    hint = campaign.frames.tip_target.xyz
    for found in (geometry.nominal, geometry.geometric):
        assert "tip_target.z" in found.redundant
        assert any(name.startswith("world_base.") for name in found.redundant["tip_target.z"])
        tip = found.model.recentred(found.theta)[0].tip_target[0][1]
        assert tip.translation[2] == pytest.approx(hint[2], abs=1e-4)
        assert np.abs(tip.translation[:2]).max() < 2e-3  # nothing ran away
