"""Suspects of a plan, configurations moved to better places, and the page."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import robots

from aridcal.engine.inverse.reachable import limits_of
from aridcal.engine.robot.chain import load_robot
from aridcal.files.campaign import load_campaign
from aridcal.jobs.plan import pose_design as planning
from aridcal.jobs.plan.configurations import allowed, draw_candidates
from aridcal.jobs.plan.information import rows_of
from aridcal.jobs.plan.plan_coverage import Sigma, suspects
from aridcal.jobs.plan.pose_design import Plan, PlanRequest, design, question
from aridcal.jobs.plan.prior_knowledge import PlanSetup, beforehand
from aridcal.jobs.plan.refinement import RefinedCandidates, refined
from aridcal.jobs.plan.row_exchange import best_choice
from aridcal.jobs.plan.target_region import region_readings
from aridcal.jobs.plan.usual_effects import USUAL_MOTIONS, with_stated_effects, with_usual_effects
from aridcal.pages.drawing.figures import falling
from aridcal.pages.plan_page import plan_page, worth

POSE = "kind: pose, noise: {position: 1.0e-4, rotation: 1.0e-4}"
TOOL = "frames: {tip_target: {xyz: [0.05, 0.03, 0.15]}}\n"
BENDS = "effects: [{kind: joint_backlash, where: joint_3, by: direction}, {kind: joint_harmonic, where: joint_3, order: [1]}]\n"


@pytest.fixture(autouse=True)
def _few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "POOL", 200)


def known_of(
    folder: Path, block: str = POSE, more: str = TOOL, urdf: str = "arid.urdf", tip: str = "flange"
) -> PlanSetup:
    """A campaign whose table is not there."""
    path = folder / "campaign.yaml"
    path.write_text(
        f"format: 1\nrobot: {{urdf: {robots.URDF / urdf}, tip: {tip}}}\nmeasurements: {{file: rows.csv, {block}}}\n{more}"
    )
    made = load_campaign(path)
    return beforehand(made, load_robot(made.robot.urdf, made.robot.tip))


@pytest.mark.parametrize("criterion", ["A", "D", "G"])
def test_configurations_are_moved_to_better_places_that_are_allowed(tmp_path: Path, criterion: str) -> None:
    floor = "design: {keep_out: [{min: [-2, -2, -2], max: [2, 2, 0.05]}]}\n"
    known = known_of(tmp_path, more=TOOL + floor, urdf="ur10.urdf", tip="tool0")
    rng = np.random.default_rng(0)
    candidates = draw_candidates(known, 120, 16, rng)
    region = region_readings(known, None, rng)
    choice, of = question(known, PlanRequest(8, criterion), candidates, region)  # type: ignore[arg-type]
    chosen = best_choice(choice, 8, rng)
    pool = RefinedCandidates(candidates.some(chosen), choice.rows[chosen])
    np.testing.assert_allclose(rows_of(known, of, pool.candidates), pool.rows, rtol=1e-9, atol=1e-9)
    found = refined(known, of, choice, pool, rng)
    np.testing.assert_allclose(rows_of(known, of, found.candidates), found.rows, rtol=1e-9, atol=1e-9)
    moved = planning.replace(choice, rows=found.rows)
    before, after = choice.cost(chosen), moved.cost(range(8))
    assert after < (before if criterion != "D" else before - 0.5)
    if criterion == "A":
        assert after < 0.9 * before
    low, high = limits_of(known.robot)
    assert ((found.candidates.readings > low) & (found.candidates.readings < high)).all()
    assert allowed(known, found.candidates.readings, found.candidates.first).all()


def test_what_usual_effects_are_expected_to_do_is_what_is_said(tmp_path: Path) -> None:
    """Drawn coefficients move a joint by so much RMS over the configurations."""
    known = known_of(tmp_path)
    candidates = draw_candidates(known, 400, 40, np.random.default_rng(0))
    usual = with_usual_effects(known, candidates)
    kinds = {c.component for c in usual.model.coefficients[len(known.theta) :]}
    assert "axis" in kinds and len(kinds) > 1  # the rail's own motions too
    rows = candidates.rows(usual)
    varying = [k for k, c in enumerate(usual.model.coefficients) if not c.basis.constant]
    phi = usual.model.rows(rows.readings, rows.conditions).phi
    rng = np.random.default_rng(1)
    for column, k in enumerate(varying):
        moved = phi[:, column] * usual.prior[k] * rng.standard_normal((2000, 1))
        size = np.sqrt(np.mean(moved**2))
        assert min(abs(size / own - 1.0) for own in USUAL_MOTIONS.values()) < 0.1


def test_usual_effects_are_of_the_kinds_that_would_be_looked_for(tmp_path: Path) -> None:
    for more, expected in [
        ("diagnosis: {enabled: false}\n", set()),
        ("diagnosis: {candidates: [joint_harmonic]}\n", {"sin", "cos"}),
    ]:
        known = known_of(tmp_path, more=TOOL + more)
        candidates = draw_candidates(known, 50, 10, np.random.default_rng(0))
        usual = with_usual_effects(known, candidates)
        assert {c.basis.form for c in usual.model.coefficients if not c.basis.constant} == expected


def plan_of(folder: Path, n: int = 10, more: str = BENDS) -> Plan:
    return design(known_of(folder, more=TOOL + more), PlanRequest(n))


def test_what_hangs_on_a_configuration_is_what_goes_without_it(tmp_path: Path) -> None:
    """By the inverse of the information without each row, as it stands in the plan."""
    known = known_of(tmp_path, more=TOOL + BENDS)
    plan = design(known, PlanRequest(10))
    rng = np.random.default_rng(np.random.SeedSequence(0).spawn(5)[0])
    candidates = draw_candidates(known, 200, 20, rng)
    known = with_stated_effects(known, candidates)
    _, of = question(known, PlanRequest(10), candidates, region_readings(known, None, rng))
    names, parts = suspects(known, of)
    assert names == plan.coverage.suspects == ("joint_3: direction", "joint_3: its own reading")
    sides = np.zeros_like(plan.readings)
    sides[:, 2] = plan.directions["joint_3"]
    own = planning.Candidates(plan.readings, sides, np.zeros(10, dtype=int), np.zeros(10, dtype=int), np.arange(10))
    rows = rows_of(known, of, own)

    def variance(some: list[int]) -> np.ndarray:
        flat = rows[some].reshape(-1, rows.shape[2])
        spread = np.diag(np.linalg.inv(of.prior_information + flat.T @ flat))
        return np.array([spread[part].sum() for part in parts])

    every = list(range(10))
    loss = [variance([j for j in every if j != k]) / variance(every) - 1.0 for k in every]
    np.testing.assert_allclose(plan.coverage.loss, loss, rtol=1e-5)
    assert plan.coverage.worst.max() == pytest.approx(plan.at_n.worst, rel=1e-6)


class Tags(HTMLParser):
    """Checks that elements end in the order in which they begin."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_has_the_figures_of_the_plan(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    known = known_of(tmp_path)
    page = Tags()
    text = plan_page(plan, known.robot, "cell <b>&1.yaml")
    page.feed(str(text))
    assert not page.open and "<b>&1" not in text and "cell <b>&1.yaml" in page.text
    assert "10 configurations to measure" in page.text and f"{1e3 * plan.at_n.rms:.3g} mm" in page.text
    assert f"{1e3 * plan.random:.3g} mm" in page.text and "joint_3: direction" in page.text
    assert text.count('<svg class="plot"') == 4 and "is not drawn" not in text and "src=" not in text
    assert all(name in page.text for name in ("O1", "O2", "O3", "O4", "O5", "Seen from above", "Seen from the side"))


def test_a_page_of_too_few_configurations_says_so(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 1, "")
    text = plan_page(plan, known_of(tmp_path).robot, "c.yaml")
    assert "So few rows do not tell where the target is" in text and "nan" not in text.replace("resonan", "")


def test_repeating_a_plan_is_worth_its_square_root_only_where_nothing_else_was_measured() -> None:
    """Eight rows again beside 240 that are there take off next to nothing, not 29 %."""
    now, more = Sigma(8, 2.0e-5, 2.0e-5), Sigma(16, 1.9e-5, 1.9e-5)
    assert worth(now, more, 0) == "8 more of them would take 5 % off; measuring these again so many times, 29 %."
    assert worth(now, more, 240) == "8 more of them would take 5 % off."


def test_ticks_of_less_than_a_decade_can_be_told_apart() -> None:
    at = np.arange(1.0, 6.0)
    drawn = falling("k", "words", at, {"a": np.linspace(0.0242, 0.0221, 5)}, ("n", "sigma [mm]"))
    ticks = [text for text in re.findall(r">([^<>]+)<", drawn) if text.startswith("0.0")]
    assert len(ticks) == len(set(ticks)) > 1
