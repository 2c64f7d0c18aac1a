"""Configurations that tell two effects apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from scipy.spatial.transform import Rotation

from aridcal import design as command
from aridcal.engine.robot.chain import load_robot
from aridcal.files.campaign import load_campaign
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.plan import discrimination
from aridcal.jobs.plan import pose_design as planning
from aridcal.jobs.plan.configurations import Candidates, draw_candidates, rows_like
from aridcal.jobs.plan.discrimination import Duel, duel_lines
from aridcal.jobs.plan.information import candidate_information, measured_information, whitened
from aridcal.jobs.plan.pose_design import PlanRequest, design
from aridcal.jobs.plan.prior_knowledge import PlanSetup, beforehand
from aridcal.jobs.plan.usual_effects import with_pair
from aridcal.pages.plan_page import plan_page

PAIR = ("shoulder_lift_joint.joint_compliance", "shoulder_lift_joint.joint_gain")
POSTURE = (0.3, -1.2, 1.4, -0.6, 1.1, 0.4)
NOISE = 1e-4


@pytest.fixture(autouse=True)
def _few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "POOL", 300)


def path_of(folder: Path) -> Path:
    """A campaign of a UR10, of few kinds of effects."""
    path = folder / "campaign.yaml"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {robots.URDF / 'ur10.urdf'}, tip: tool0}}\n"
        "measurements: {file: rows.csv, kind: pose, noise: {position: 1.0e-4, rotation: 1.0e-4}}\n"
        "frames: {tip_target: {xyz: [0.05, 0.03, 0.15]}}\n"
        "diagnosis: {candidates: [joint_gain, joint_compliance, joint_harmonic, bearing_compliance]}\n"
    )
    return path


def known_of(path: Path) -> PlanSetup:
    made = load_campaign(path)
    return beforehand(made, load_robot(made.robot.urdf, made.robot.tip))


def at(readings: np.ndarray) -> Candidates:
    n = len(readings)
    return Candidates(readings, np.ones_like(readings), np.zeros(n, dtype=int), np.zeros(n, dtype=int), np.arange(n))


def bent(path: Path, readings: np.ndarray, rms: float) -> tuple[PlanSetup, np.ndarray]:
    """The arm with a shoulder that yields, by so much RMS at the target, [m]."""
    known, ((number,), _) = with_pair(known_of(path), PAIR, at(readings))
    theta = np.zeros(len(known.theta))
    made = rows_like(known, readings, np.zeros(len(readings), dtype=int))
    rows = known.model.rows(readings, made.conditions)
    plain = known.model.poses(theta, rows)[1]
    theta[number] = 1e-3
    theta[number] *= rms / np.sqrt(np.mean(np.sum((known.model.poses(theta, rows)[1] - plain) ** 2, axis=1)))
    return known, theta


def table_of(known: PlanSetup, theta: np.ndarray, readings: np.ndarray, rng: np.random.Generator) -> pd.DataFrame:
    made = rows_like(known, readings, np.zeros(len(readings), dtype=int))
    R, p = known.model.poses(theta, known.model.rows(readings, made.conditions))
    p = p + NOISE * rng.standard_normal(p.shape)
    q = Rotation.from_matrix(Rotation.from_rotvec(NOISE * rng.standard_normal(p.shape)).as_matrix() @ R).as_quat()
    columns = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), np.hstack([p, q]).T, strict=True))
    return pd.DataFrame(readings, columns=list(known.robot.readings)).assign(**columns)


def test_two_effects_that_look_alike_are_named_after_the_planned_rows(tmp_path: Path) -> None:
    """The whole search, before and after: rows of one cell do not tell a shoulder that yields from one that turns too far."""
    path, rng = path_of(tmp_path), np.random.default_rng(0)
    readings = POSTURE + rng.uniform(-0.3, 0.3, (40, 6))
    known, theta = bent(path, readings, 6 * NOISE)
    old = table_of(known, theta, readings, rng)
    old.to_csv(tmp_path / "rows.csv", index=False)

    def found(table: pd.DataFrame) -> tuple[set[str], set[str]]:
        effects = identify(load_campaign(path).with_tables([table])).effects
        twins = {f"{e.where}.{e.kind}" for f in effects for e in f.confounded_with}
        return {f"{f.effect.where}.{f.effect.kind}" for f in effects}, twins

    first, twins = found(old)
    assert PAIR[0] not in first or PAIR[1] in twins
    plan = design(known_of(path), PlanRequest(8, apart=PAIR))
    new = table_of(known, theta, plan.readings, rng)
    then, twins = found(pd.concat([old, new], ignore_index=True))
    assert PAIR[0] in then and PAIR[1] not in then | twins
    before, after = ([getattr(d, key) for d in plan.duels[:2]] for key in ("before", "after"))
    assert max(before) < 15 < 50 < min(after)


def test_expected_evidence_is_what_a_fit_of_the_rival_leaves(tmp_path: Path) -> None:
    """Half the sum of squares, in sigmas, that plain least squares leaves of the effect with the rival in its place."""
    path, rng = path_of(tmp_path), np.random.default_rng(1)
    readings = POSTURE + rng.uniform(-0.3, 0.3, (40, 6))
    known, theta = bent(path, readings, 12 * NOISE)
    table_of(known, theta, readings, rng).to_csv(tmp_path / "rows.csv", index=False)
    plan = design(known_of(path), PlanRequest(8, apart=PAIR))
    wide, parts = with_pair(known_of(path), PAIR, at(plan.readings))
    flat, residual = measured_information(wide, at(plan.readings))
    new = whitened(wide, at(plan.readings))
    F = np.concatenate([flat, new.reshape(-1, new.shape[2])])
    offered = draw_candidates(wide, 300, 16, np.random.default_rng(np.random.SeedSequence(0).spawn(5)[0]))
    constants = [k for k in candidate_information(wide, offered, 8).coefficients if k not in {*parts[0], *parts[1]}]

    def left(y: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return y - columns @ np.linalg.lstsq(columns, y, rcond=1e-12)[0]

    (own,), (other,) = parts
    fitted = np.linalg.lstsq(flat[:, [*constants, own]], residual, rcond=1e-12)[0][-1]
    beaten = left(F[:, own] * fitted, F[:, [*constants, other]])
    duel = next(d for d in plan.duels if "compliance" in d.true and "joint_gain" in d.rival)
    assert duel.after == pytest.approx(beaten @ beaten / 2, rel=0.02)
    before = left(flat[:, own] * fitted, flat[:, [*constants, other]])
    assert duel.before == pytest.approx(before @ before / 2, rel=0.02) and duel.shown


def test_an_effect_that_no_row_shows_is_taken_for_one_that_they_would(tmp_path: Path) -> None:
    """Rows of an arm without any: what is expected is a condition, and said to be one."""
    path, rng = path_of(tmp_path), np.random.default_rng(3)
    readings = POSTURE + rng.uniform(-0.3, 0.3, (40, 6))
    known, theta = bent(path, readings, NOISE)
    table_of(known, 0 * theta, readings, rng).to_csv(tmp_path / "rows.csv", index=False)
    plan = design(known_of(path), PlanRequest(8, apart=PAIR))
    page = plan_page(plan, known.robot, "c.yaml")
    assert "They are to tell two effects apart" in page and "will be named, if it is four sigmas large" in page
    assert "random ones" not in page  # chosen for something else
    duels = plan.duels
    assert not any(duel.shown for duel in duels) and min(duel.after for duel in duels[:2]) > 15


def test_the_choice_is_the_best_by_every_single_exchange() -> None:
    """On random numbers, by the bound of the chance to be wrong worked out in full."""
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((40, 2, 6)) * rng.uniform(0.2, 2.0, (40, 1, 1))
    sides = [
        discrimination._Side(np.array([0, 1, 2, 3]), 1, np.eye(1), ("a", "b"), (0, 1)),
        discrimination._Side(np.array([0, 1, 3, 2]), 1, 4 * np.eye(1), ("b", "a"), (1, 0)),
        discrimination._Side(np.array([0, 1, 4, 5, 2]), 1, np.eye(1), ("b", "c"), (1, 2)),
        discrimination._Side(np.array([0, 1, 3, 4, 5]), 2, np.eye(2), ("c", "a"), (0, 2)),
    ]
    chosen = discrimination._exchanged(rows, 0.01 * np.eye(6), sides, 6)
    assert len(set(chosen)) == 6

    def cost(some: list[int]) -> float:
        F = rows[some].reshape(-1, 6)
        M, total = 0.01 * np.eye(6) + F.T @ F, 0.0
        for side in sides:
            block = np.linalg.inv(M[np.ix_(side.columns, side.columns)])[-side.own :, -side.own :]
            total += np.exp(-np.trace(side.weight @ np.linalg.inv(block)) / 8)
        return total

    others = [c for c in range(40) if c not in chosen]
    swapped = [cost([*chosen[:k], c, *chosen[k + 1 :]]) for k in range(6) for c in others]
    assert cost(chosen) <= min(swapped) * (1 + 2e-6)


def test_what_is_expected_is_said_of_the_nearest_rival() -> None:
    duels = (Duel("a", "b", 1.0, 90.0), Duel("a", "c", 2.0, 20.0), Duel("b", "a", 0.5, 4.0))
    lines = duel_lines(duels)
    assert len(lines) == 2 and "b is behind by 1.0" in lines[0] and "c, the nearest, by 20.0: will be named" in lines[0]
    assert "may be taken for it still (" in lines[1]
    assert "which the rows so far do not show" in duel_lines((Duel("a", "b", 1.0, 90.0, shown=False),))[0]


def test_two_criteria_at_once_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(path_of(tmp_path)), "-n", "8", "-o", str(tmp_path / "p.csv"), "--apart", ",".join(PAIR)]
    assert command.main([*arguments, "--optimal", "A"]) == 2
    assert "leave --optimal out" in capsys.readouterr().err
    known = replace(known_of(tmp_path / "campaign.yaml"), sigma=np.full(2, 1e-4))
    assert all(duel.before < 1e-3 < 30 < duel.after for duel in design(known, PlanRequest(8, apart=PAIR)).duels[:2])
