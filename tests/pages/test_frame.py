"""Pages: one frame for all, in which nothing that a user wrote becomes markup; what the first screen says is what was found."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import jinja2
import numpy as np
import pytest
import robots
from lxml import html
from markupsafe import Markup
from repository import ROOT

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.trust.gains import Diagnosis, NamedEffect
from aridcal.files.purposes import About
from aridcal.jobs.calibrate.controllers import ControllerExports, controller_exports
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.joint_zeros import joint_zeros, zero_of
from aridcal.jobs.calibrate.outcome import Outcome, Verification
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.pages.drawing.html import table, tag
from aridcal.pages.drawing.one_page import OnePage, Part, as_html
from aridcal.pages.drawing.page_frame import Section, card, empty_page, filled, framed_page
from aridcal.pages.guide_page import guide_page
from aridcal.pages.report.first_screen import in_controller
from aridcal.pages.report.page import page, write_report
from aridcal.system.wording import number, plus_minus

ASSETS = ROOT / "aridcal" / "pages" / "drawing" / "assets"
HOSTILE = """<img src=x onerror="alert('1')"> & </td></title></style><script>alert(1)</script>{{ 7 * 7 }}{% raw %}"""


def made_of(words: str) -> dict[str, Markup]:
    """Every template, with the same words wherever words go."""
    one = OnePage(
        words, words, [(words, words)], [Part(words, [(words, words)], [[words], [words]], [words])], words, ""
    )
    return {
        "page.html": framed_page(words, words, [Section(words, words, words), Section(words, [words], "b")], words),
        "empty.html": empty_page(words, words),
        "card.html": card(words, words, (words, 1.0), (words, 2.0), words, words),
        "one_page.html": as_html(one),
        "guide.html": guide_page(words, words),
        "scene.html": filled("scene.html", title=words, style="", data="", licence="", meshcat="", script=""),
    }


def test_hostile_words_stay_words_in_every_template() -> None:
    made = made_of(HOSTILE)
    assert made.keys() == {path.name for path in ASSETS.glob("*.html")}
    plain_ones = made_of("x")
    for name, text in made.items():
        elements, usual = ([e.tag for e in html.document_fromstring(t).iter()] for t in (text, plain_ones[name]))
        assert elements == usual, name
        shown = " ".join(html.document_fromstring(text).itertext()).lower()
        assert HOSTILE.lower() in shown, name


def test_a_value_that_is_forgotten_is_an_error_and_no_gap() -> None:
    with pytest.raises(jinja2.UndefinedError):
        filled("empty.html", title="x")


def test_markup_goes_into_a_template_as_it_is() -> None:
    assert "<b>a &amp; b</b>" in framed_page("t", tag("b", "a & b"), [], "f")


def test_a_table_too_wide_for_a_phone_has_its_titles_in_every_cell() -> None:
    head = ["model", "held out: RMS", "mean", "fitted: RMS", "mean", "max"]
    rows = [["nominal", *("1.23" for _ in head[1:])], ["geometric and more", *("4.5" for _ in head[1:])]]
    made = html.fragment_fromstring(table(head, rows, "c"))
    assert made.find("table").get("class") == "stacked pairs"
    for line in made.xpath("table/tbody/tr"):
        assert [cell.get("data-label") for cell in line.findall("td")] == head[1:]
    assert [c.get("class") for c in made.xpath("table/tbody/tr[1]/td")] == ["n first", "n", "n first", "n", "n"]
    narrow = html.fragment_fromstring(table(["a", "b"], [["joint_1", "1.2 mm"]], "c"))
    assert narrow.find("table").get("class") is None
    assert not narrow.xpath("//@data-label")


def test_the_title_in_a_cell_is_text_and_cannot_leave_its_attribute() -> None:
    made = html.fragment_fromstring(table(["a", tag("b", HOSTILE), HOSTILE], [["w" * 60, HOSTILE, tag("i", "1")]], "c"))
    assert made.xpath("//td/@data-label") == [HOSTILE, HOSTILE]
    assert not made.xpath("//img | //script")
    assert tag("b", HOSTILE).striptags() == HOSTILE


# ---- joint zeros -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [robots.ur10(), robots.arid()], ids=["ur10", "arid"])
@pytest.mark.parametrize("which", ["full", "doty"])
def test_a_zero_moves_the_target_as_the_joint_itself_does(robot: robots.Robot, which: str) -> None:
    """Second road: poses with the constant, and poses of a joint that stands so much further."""
    model = Model(robot, tuple(constants(robot, which)))
    q = robots.readings(robot, 5, np.random.default_rng(0), 0.6)
    found = {k: zero for k, name in enumerate(model.names) if (zero := zero_of(name, robot))}
    assert len({joint for joint, _ in found.values()}) >= len(robot.names) - (which == "doty") * len(robot.names) // 2
    for k, (joint, way) in found.items():
        theta = np.zeros(len(model.names))
        theta[k] = 1e-4
        moved = q.copy()
        moved[:, robot.names.index(joint)] += way * 1e-4
        R, p = model.poses(theta, model.rows(q))
        R_moved, p_moved = model.poses(np.zeros_like(theta), model.rows(moved))
        assert np.abs(p - p_moved).max() < 1e-9, model.names[k]
        assert np.abs(R - R_moved).max() < 1e-8, model.names[k]


# ---- what the first screen says --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    truth = robots.simulate(robots.ur10(), 60, np.random.default_rng(3), noise=1e-4)
    return identify(robots.write_campaign(tmp_path_factory.mktemp("frame"), truth))


@pytest.fixture(scope="module")
def handover(outcome: Outcome) -> ControllerExports:
    return controller_exports(outcome)


def with_effect(outcome: Outcome, kind: str, where: str) -> Outcome:
    """The outcome with one effect, which leaves a quarter of the geometric stage's error."""
    nominal, geometric, final = outcome.stages
    residual = 0.25 * geometric.residual
    test = outcome.parts()["test"]
    found = NamedEffect(
        Effect(kind, where, (Coefficient(where, "axis", Basis("linear", (where,), (0.0,))),)),
        False, 1e-9, geometric.residual[test], residual[test], residual, (),
    )  # fmt: skip
    stages = (nominal, geometric, replace(final, residual=residual))
    return replace(outcome, stages=stages, diagnosis=Diagnosis((found,), (), (), 0, ()))


def header(made: Markup) -> str:
    return " ".join(html.document_fromstring(made).find("body/header").text_content().split())


def test_what_a_controller_gets_is_what_result_json_says(outcome: Outcome, handover: ControllerExports) -> None:
    more = with_effect(outcome, "joint_gain", outcome.robot.names[1])
    said = header(page(more, handover))
    error = result_document(replace(more, diagnosis=None))["error"]
    for channel, unit in (("position_mm", "mm"), ("rotation_mrad", "mrad")):
        urdf, whole = (number(error[stage]["test"][channel]["rms"]) for stage in ("geometric", "final"))
        assert f"In your controller: {urdf} {unit} with the URDF, {whole} {unit} with compensation." in said
        assert urdf != whole
    alone = header(page(outcome, handover))
    rms = number(result_document(outcome)["error"]["geometric"]["test"]["position_mm"]["rms"])
    assert f"In your controller: {rms} mm with the URDF; compensation adds nothing to it." in alone
    assert "with compensation" not in alone


def test_effects_of_the_measuring_head_are_not_promised_to_a_controller(outcome: Outcome) -> None:
    said = in_controller(with_effect(outcome, "lens_distortion", outcome.robot.names[1]), 0)
    assert "with compensation" not in said
    assert "effects of the measuring head" in said


def test_the_largest_zero_is_named_as_result_json_has_it(outcome: Outcome, handover: ControllerExports) -> None:
    found = [(p, zero_of(p["name"], outcome.robot)) for p in result_document(outcome)["parameters"]]
    zeros = [(zero[0], zero[1] * p["value"], p) for p, zero in found if zero and p["status"] == "identified"]
    joint, value, p = max(zeros, key=lambda z: abs(z[1]))
    in_mrad = plus_minus(1e3 * value, 1e3 * p["std"])
    made = page(outcome, handover)
    assert f"{joint} zero off by {in_mrad} mrad = {number(math.degrees(value))}° ({p['name']})" in header(made)
    listed = html.document_fromstring(made).xpath('//table[starts-with(caption, "Zeros of the joints")]/tbody/tr/th')
    assert [th.text_content() for th in listed] == [
        name for name in outcome.robot.names if name in {z[0] for z in zeros}
    ]


def test_zeros_of_one_joint_add_up_with_their_covariance(outcome: Outcome) -> None:
    """As in a repair, which adds a zero of its own: both together are how far the joint is off."""
    fit = outcome.stage("geometric").fit
    (zero, *_) = joint_zeros(fit, outcome.robot)
    k = fit.model.names.index(zero.names[0])
    way = zero_of(zero.names[0], outcome.robot)[1]  # type: ignore[index]
    model = fit.model.with_coefficients((*fit.model.coefficients, Coefficient(zero.joint, "axis")))
    covariance = np.pad(fit.covariance, (0, 1))
    covariance[-1, -1] = 4e-8
    covariance[-1, k] = covariance[k, -1] = -way * 1e-10
    both = joint_zeros(
        replace(fit, model=model, theta=np.append(fit.theta, 1e-3), covariance=covariance), outcome.robot
    )
    (added,) = [z for z in both if z.joint == zero.joint]
    assert added.names == (zero.names[0], f"{zero.joint}.axis")
    assert added.value == pytest.approx(zero.value + 1e-3, abs=1e-15)
    assert added.std == pytest.approx(math.sqrt(zero.std**2 + 4e-8 - 2e-10), rel=1e-12)


def test_another_day_has_a_card_with_the_figures_of_result_json(outcome: Outcome, handover: ControllerExports) -> None:
    residuals = {s.name: 1.1 * s.residual for s in outcome.stages}
    day = Verification("<2>.csv", outcome.measurements, residuals, outcome.outlier, outcome.stages[-1].residual)
    verified = replace(outcome, verification=day)
    made = html.document_fromstring(page(verified, handover))
    (shown,) = made.xpath('//header//div[@class="card"][contains(h2, "on another day")]')
    error = result_document(verified)["verification"]["error"]
    figures = [shown.xpath(f'.//span[@class="{which}"]')[0].text_content() for which in ("before", "now")]
    assert figures == [f"{number(error[s]['position_mm']['rms'])} mm" for s in ("nominal", "final")]
    assert header(page(verified, handover)).count("Another day's rows (<2>.csv") == 1


def test_robot_instrument_and_date_are_those_stated_and_what_is_not_is_said(
    outcome: Outcome, handover: ControllerExports
) -> None:
    about = About(robot="R & <b>", serial_number="</p><script>", instrument="T {{ 1 }}", date="2026-11-20")
    stated = replace(outcome, campaign=outcome.campaign.model_copy(update={"about": about}))
    said = header(page(stated, handover))
    assert "Robot: R & <b> · Serial number: </p><script> · Instrument: T {{ 1 }} · Measured on: 2026-11-20." in said
    assert "Not stated, under about: in the campaign: measured by." in said
    unknown = header(page(outcome, handover))
    assert re.search(r"Measured on: not stated \(newest file: 20\d\d-\d\d-\d\d\)", unknown)
    assert "serial number, instrument, measured by" in unknown
    assert "Calibration of ur10" in unknown and "Robot:" not in unknown  # its name stands in the title already


def test_links_lead_to_files_that_are_there_and_to_no_others(
    outcome: Outcome, handover: ControllerExports, tmp_path: Path
) -> None:
    def linked(folder: Path) -> set[str]:
        write_report(outcome, handover, folder / "report.html")
        refs = html.document_fromstring((folder / "report.html").read_text("utf-8")).xpath("//a/@href")
        return {ref for ref in refs if not ref.startswith("#")}

    assert linked(tmp_path) == set()
    for name in ("calibrated.urdf", "scene.html", "foreign.txt"):
        (tmp_path / name).write_text("")
    assert linked(tmp_path) == {"calibrated.urdf", "scene.html"}
