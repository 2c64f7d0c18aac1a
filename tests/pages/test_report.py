"""The report: all that was found is on it, nothing is loaded, and nothing that a user wrote becomes markup."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from in_sight import MOST_WORDS, words_in_sight
from lxml import html
from markupsafe import Markup
from rich.console import Console

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.catalogue import EFFECT_KINDS, UntestableEffect
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.robot.doty import doty_links
from aridcal.engine.rows.remarks import Remark
from aridcal.engine.search.noise_tests import Clue
from aridcal.engine.trust.gains import Curve, Diagnosis, NamedEffect, RejectedEffect
from aridcal.engine.trust.halves import Halves
from aridcal.identify import summary as print_summary
from aridcal.jobs.calibrate.controllers import ControllerExports, controller_exports
from aridcal.jobs.calibrate.folder import parameters, result_document
from aridcal.jobs.calibrate.key_figures import or_as_well
from aridcal.jobs.calibrate.outcome import STATISTICS, Outcome, Verification, errors
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.verdict import Verdict
from aridcal.pages.drawing.html import join
from aridcal.pages.report import trust_checks
from aridcal.pages.report.data_section import data
from aridcal.pages.report.first_screen import summary
from aridcal.pages.report.fit_section import fits
from aridcal.pages.report.page import page, write_report
from aridcal.pages.report.trust_checks import checks
from aridcal.system.wording import number

ANSWERS = ["data", "separable", "enough", "fits", "depends", "remains", "iso", "parameters", "use"]
HOSTILE = """<img src=x onerror="alert('1')">$\\frac{1}{0}$ &amp;"""


def rows_with_faults(truth: robots.Truth) -> pd.DataFrame:
    """The table with two gross outliers, the last four configurations measured twice."""
    rows = robots.table(truth)
    again = rows.tail(4).copy()
    again[["x", "y", "z"]] += np.random.default_rng(2).normal(0.0, 1e-4, (4, 3))
    rows.loc[[5, 17], "x"] += 0.05
    return pd.concat([rows, again], ignore_index=True)


@pytest.fixture(scope="module")
def truth() -> robots.Truth:
    return robots.simulate(robots.ur10(), 120, np.random.default_rng(1), noise=1e-4)


@pytest.fixture(scope="module")
def outcome(truth: robots.Truth, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return identify(robots.write_campaign(tmp_path_factory.mktemp("pose"), truth, rows_with_faults(truth)))


@pytest.fixture(scope="module")
def handover(outcome: Outcome) -> ControllerExports:
    return controller_exports(outcome)


@pytest.fixture(scope="module")
def report(outcome: Outcome, handover: ControllerExports) -> str:
    return page(outcome, handover)


def whole_page(outcome: Outcome) -> Markup:
    """The page with exports of its own."""
    return page(outcome, controller_exports(outcome))


def text(report: str, part: str = "//body") -> str:
    """What a reader sees of a part of the page, in one line."""
    return " ".join(" ".join(element.text_content() for element in html.fromstring(report).xpath(part)).split())


def table(report: str, caption: str) -> list[list[str]]:
    """Body rows of the first table whose caption starts so."""
    found = html.fromstring(report).xpath(f'//table[starts-with(caption, "{caption}")]')
    return [[cell.text_content() for cell in row] for row in found[0].xpath("tbody/tr")]


def plain(shown: str) -> float:
    """A printed number."""
    return float(shown.replace(",", "").replace("−", "-"))


class Balance(HTMLParser):
    """Notes tags that do not close in the order of their opening."""

    def __init__(self, report: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.feed(report)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def assert_sound(report: str) -> None:
    """Well formed, ids unique, every reference answered within the page, nothing loaded."""
    balance = Balance(report)
    assert balance.open == balance.wrong == []
    root = html.fromstring(report)
    ids = root.xpath("//@id")
    assert len(ids) == len(set(ids))
    referred = [*re.findall(r"url\(([^)]*)\)", report), *root.xpath("//@href"), *root.xpath("//@src")]
    assert all(name.startswith("#") and name[1:] in ids for name in referred)
    assert not list(root.iter("script", "link", "img", "iframe", "object", "embed", "base", "form"))
    assert "@import" not in report


# ---- the page as a whole ---------------------------------------------------------------------------------------------


def test_the_six_questions_are_answered_in_order(report: str) -> None:
    assert_sound(report)
    assert html.fromstring(report).xpath("//section/@id") == ANSWERS


def test_the_file_is_the_page_and_the_page_is_the_same_each_time(
    outcome: Outcome, handover: ControllerExports, report: str, tmp_path: Path
) -> None:
    write_report(outcome, handover, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text("utf-8") == report


def test_little_is_in_sight_and_all_tables_but_the_exports_are_a_click_away(report: str) -> None:
    assert 500 < len(words_in_sight(report)) <= MOST_WORDS
    open_tables = html.fromstring(report).xpath("//table[not(ancestor::details)]/caption/text()")
    assert [caption.partition(",")[0] for caption in open_tables] == ["Exports for controllers"]
    folds = html.fromstring(report).xpath("//details")
    assert all(fold.get("open") is None and fold[0].tag == "summary" and fold[0].text_content() for fold in folds)


def test_every_figure_has_words_and_units(report: str) -> None:
    plots = html.fromstring(report).xpath('//*[name()="svg"]')
    assert (
        len(plots) == 2 + 2 + 6 + 3 + 1 + 6 + 2
    )  # data, before and after, axes, planes, order of time, joints, slices
    for plot in plots:
        assert plot.get("role") == "img"
        assert len(plot.get("aria-label")) > 20
        assert plot.xpath("ancestor::figure/figcaption")[0].text_content()
        assert re.search(r"\[(mm|mrad|m|°|%|1)\]", plot.text_content())


def test_every_table_has_a_caption_and_titled_columns(report: str) -> None:
    found = html.fromstring(report).xpath("//table")
    assert len(found) > 10
    for each in found:
        assert each.find("caption").text_content()
        assert len({len(row) for row in each.iter("tr")}) == 1
        assert len(each.xpath("thead/tr/th[@scope='col']")) == len(each.xpath("thead/tr/*"))
        assert len(each.xpath("tbody/tr/th[@scope='row']")) == len(each.xpath("tbody/tr"))


def test_twelve_thousand_rows_stay_below_two_megabytes(outcome: Outcome, handover: ControllerExports) -> None:
    some = np.random.default_rng(0).integers(0, len(outcome.measurements), 12_000)
    many = replace(
        outcome,
        measurements=outcome.measurements.select(some),
        stages=tuple(replace(s, residual=s.residual[some]) for s in outcome.stages),
        outlier=outcome.outlier[some],
    )
    written = page(many, handover)
    assert len(written.encode()) < 2_000_000
    assert "12,000 rows" in text(written, "//header")


# ---- what it says ----------------------------------------------------------------------------------------------------


def test_errors_of_every_stage_and_part_are_those_of_the_outcome(outcome: Outcome, handover: ControllerExports) -> None:
    flagged = outcome.outlier.copy()
    flagged[np.flatnonzero(outcome.measurements.test)[0]] = True  # so that outliers count among the held-out rows
    outcome = replace(outcome, outlier=flagged)
    report = page(outcome, handover)
    for key, caption in (("position_mm", "Position error"), ("rotation_mrad", "Rotation error")):
        shown = {name: row[1:] for row in table(report, caption) for name in row[0].split(" = ")}
        assert shown.keys() == {"nominal", "geometric", "final"}
        for stage in outcome.stages:
            parts = outcome.parts()
            expected = [
                errors(stage.residual, parts[p], outcome.channels)[key][s]
                for p in ("test", "train", "test_all")
                for s in STATISTICS
            ]
            assert [plain(v) for v in shown[stage.name]] == pytest.approx(expected, rel=5.1e-3)
    head = [
        th.text_content() for th in html.fromstring(report).xpath('//table[caption="Position error [mm]"]/thead//th')
    ]
    assert [head[k] for k in (1, 6, 11)] == ["held out: RMS", "fitted: RMS", "held out, with outliers: RMS"]


def test_the_first_screen_has_the_errors_on_held_out_rows(outcome: Outcome, report: str) -> None:
    first = text(report, "//header")
    test = outcome.parts()["test"]
    for stage in (outcome.stages[0], outcome.stages[-1]):
        for key, unit in (("position_mm", "mm"), ("rotation_mrad", "mrad")):
            assert f"{number(errors(stage.residual, test, outcome.channels)[key]['rms'])} {unit}" in first
    assert "Calibration of ur10" in first
    assert "measurements.csv · 124 rows" in first
    assert f"On {test.sum()} held-out rows" in first
    for question in ("Main corrections", "What remains", "Can I trust it?"):
        assert question in first


def test_each_figure_of_the_first_screen_says_whether_it_holds_the_noise(outcome: Outcome, report: str) -> None:
    """Errors of rows hold the instrument's, what is said of the region does not: side by side they would contradict."""
    screen = text(report, "//header")
    assert "held-out rows, the instrument's noise included. 95 % are below" in screen
    bounds = re.findall(r"off by less than [\d.]+ m\w+ ([^,]*), with 95 %", screen)
    assert bounds and set(bounds) == {"without the instrument's noise"}


def test_outliers_are_named_with_file_and_line(outcome: Outcome, report: str) -> None:
    assert outcome.outlier.sum() == 2
    found = table(report, "Outliers")
    assert [row[0] for row in found] == ["measurements.csv, line 7", "measurements.csv, line 19"]
    assert all(49 < plain(row[3]) < 51 for row in found)


def test_repeats_are_reported_as_iso_9283_does(outcome: Outcome, report: str) -> None:
    assert outcome.repeats is not None
    assert outcome.repeats.groups == 4
    shown = text(report, "//section[@id='data']")
    assert "4 configurations measured more than once (8 rows)" in shown
    repeatability = f"{number(1e3 * outcome.repeats.repeatability)} mm"
    assert f"the mean distance to the centre plus three standard deviations is {repeatability}" in shown


def test_redundant_coefficients_are_named_with_their_twins(outcome: Outcome, report: str) -> None:
    fit = outcome.stage("geometric").fit
    found = dict(table(report, "Redundant coefficients"))
    assert found.keys() == fit.redundant.keys()
    for name, partners in fit.redundant.items():
        assert found[name].split(", ")[:6] == list(partners[:6])


def test_every_identified_constant_is_given_with_its_uncertainty(outcome: Outcome, report: str) -> None:
    root = html.fromstring(report)
    for p in parameters(outcome.stage("geometric").fit):
        where, component = p["name"].rsplit(".", 1)
        cells = root.xpath(f'//table[normalize-space(caption)="{where}"]//tr[th="{component}"]/td/text()')
        if p["status"] != "identified":
            continue
        unit = 1e-3 * (np.pi / 180 / 1e-3 if where in ("world_base", "tip_target") and p["unit"] == "rad" else 1.0)
        value, spread = (cells[0].split(" ± ") if len(cells) == 1 else cells)[:2]
        assert plain(value.split()[0].rstrip("°")) * unit == pytest.approx(p["value"], abs=0.6 * p["std"] + 1e-6)
        assert 1e-3 * plain(spread.split()[0]) == pytest.approx(p["std"], rel=0.06)


def test_the_link_tables_add_corrections_to_nominal_parameters(tmp_path: Path) -> None:
    truth = robots.simulate(robots.arid(), 60, np.random.default_rng(3), noise=1e-5, which="doty")
    found = identify(robots.write_campaign(tmp_path, truth, parameters={"set": "doty"}))
    report = whole_page(found)
    corrections = {p["name"]: p for p in parameters(found.stage("geometric").fit)}
    names = {"d": "d", "θ": "theta", "β": "beta", "a": "a", "α": "alpha"}
    for link in doty_links(found.robot):
        for symbol, nominal, _, calibrated in table(report, link.joint):
            if symbol not in names:
                continue
            p = corrections[f"{link.joint}.{names[symbol]}"]
            start = 0.0 if symbol == "d" else getattr(link, names[symbol])
            scale, unit = (180 / np.pi, "°") if p["unit"] == "rad" else (1e3, " mm")
            assert plain(nominal.removesuffix(unit)) == pytest.approx(scale * start, abs=6e-4)
            assert plain(calibrated.removesuffix(unit)) == pytest.approx(scale * (start + p["value"]), abs=6e-4)
    assert "(a < 1 mm)" in text(report, "//section[@id='data']")


def test_positions_alone_give_a_report_without_rotation_errors(tmp_path: Path) -> None:
    truth = robots.simulate(robots.ur10(), 80, np.random.default_rng(1), noise=1e-4, kind="position")
    report = whole_page(identify(robots.write_campaign(tmp_path, truth)))
    assert_sound(report)
    assert "otation error [mrad]" not in report
    assert "nan" not in text(report).lower()
    assert len(html.fromstring(report).xpath('//*[name()="svg"]')) == 2 + 1 + 3 + 3 + 1 + 6 + 2


@pytest.fixture(scope="module")
def small() -> robots.Truth:
    return robots.simulate(robots.arid(), 40, np.random.default_rng(1), noise=1e-4)


def test_without_held_out_rows_the_report_says_so_and_of_a_hundred_refused_rows_some_are_named_and_all_are_counted(
    small: robots.Truth, tmp_path: Path
) -> None:
    rows = pd.concat([robots.table(small)] * 4, ignore_index=True)[:140].assign(split="train")
    rows.loc[40:139, "qx"] = np.nan
    report = whole_page(identify(robots.write_campaign(tmp_path, small, rows)))
    assert_sound(report)
    assert "On 40 fitted rows" in text(report, "//header")
    assert "No rows were held out" in text(report, "//header")
    assert "fitted: RMS" in text(report, "//section[@id='fits']")
    assert "held out: RMS" not in report
    shown = text(report, "//section[@id='data']")
    assert dict(table(report, "Rows of"))["refused: unusable"] == "100"
    assert "line 42" in shown
    assert "line 120" not in shown
    assert "and 75 more" in shown


def test_a_frame_per_station_is_listed_with_its_label(small: robots.Truth, tmp_path: Path) -> None:
    rows = robots.table(small).assign(station=np.array(["north <b>", "south"])[np.arange(40) % 2])
    found = identify(robots.write_campaign(tmp_path, small, rows, frames={"world_base": {"per": "station"}}))
    report = whole_page(found)
    assert_sound(report)
    for label in ("north <b>", "south"):
        assert [row[0] for row in table(report, f"world_base[{label}]")] == ["x", "y", "z", "roll", "pitch", "yaw"]


def test_many_outliers_question_the_data(outcome: Outcome, report: str) -> None:
    assert "points to a fault" not in text(report)
    flagged = outcome.outlier.copy()
    flagged[:10] = True
    said = join(list(data(replace(outcome, outlier=flagged))))
    assert (
        f"{100 * flagged.mean():.0f} % of the rows are outliers. More than 3 % points to a fault in the measurement"
        in said
    )


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("noise_floor", "consistent with the measurement noise"),
        ("structure_remains", "A repeatable error remains"),
        ("not_enough_data", "Measure more rows"),
    ],
)
def test_the_verdict_is_said_in_words(outcome: Outcome, verdict: str, words: str) -> None:
    first = join(list(summary(replace(outcome, verdict=Verdict(verdict, 0.42, ("rows differ",))))))
    assert words in first
    assert "42 % of the remaining variance" in first


def without_held_out_rows(outcome: Outcome) -> Outcome:
    return replace(outcome, measurements=replace(outcome.measurements, test=np.zeros(124, dtype=bool)))


def held_out_rows_flagged(outcome: Outcome) -> Outcome:
    return replace(outcome, outlier=outcome.outlier | outcome.measurements.test)


def four_flagged(outcome: Outcome) -> Outcome:
    return replace(outcome, outlier=outcome.outlier | (np.arange(124) < 4))


def four_refused(outcome: Outcome) -> Outcome:
    why = Remark("rows.csv", 3, "x", "", "is empty")
    return replace(outcome, measurements=outcome.measurements.with_origin(refused=4 * (why,)))


def one_start_led_elsewhere(outcome: Outcome) -> Outcome:
    fit = outcome.stage("geometric").fit
    elsewhere = replace(fit, convergence=replace(fit.convergence, agreed=1))
    stages = [replace(s, fit=elsewhere) if s.name == "geometric" else s for s in outcome.stages]
    return replace(outcome, stages=tuple(stages))


def held_out_rows_further_off(outcome: Outcome) -> Outcome:
    off = np.where(outcome.measurements.test, 2.0, 1.0)[:, None]
    return replace(outcome, stages=tuple(replace(s, residual=s.residual * off) for s in outcome.stages))


def joint_hardly_moved(outcome: Outcome) -> Outcome:
    rows = outcome.measurements
    return replace(outcome, measurements=replace(rows, readings=rows.readings * [1.0, 1.0, 0.01, 1.0, 1.0, 1.0]))


def test_a_sound_calibration_passes_every_rule_that_says_anything(outcome: Outcome) -> None:
    assert all(good for good, _ in checks(outcome))


@pytest.mark.parametrize(
    ("rule", "faulty"),
    [
        (trust_checks.held_out_rows, without_held_out_rows),
        (trust_checks.held_out_rows, held_out_rows_flagged),
        (trust_checks.outliers, four_flagged),
        (trust_checks.refused_rows, four_refused),
        (trust_checks.minimum, one_start_led_elsewhere),
        (trust_checks.held_out_error, held_out_rows_further_off),
        (trust_checks.joint_travel, joint_hardly_moved),
    ],
)
def test_a_fault_is_told_by_its_own_rule_and_marked_on_the_first_screen(
    outcome: Outcome,
    rule: Callable[[Outcome], trust_checks.Checks],
    faulty: Callable[[Outcome], Outcome],
) -> None:
    told = [words for good, words in rule(faulty(outcome)) if not good]
    assert len(told) == 1
    marked = html.fromstring(join(list(summary(faulty(outcome))))).xpath("//ul[@class='checks']/li[@class='look']")
    assert f"!{told[0]}" in [line.text_content() for line in marked]


def test_halves_that_disagree_are_held_against_the_result(outcome: Outcome) -> None:
    looked = outcome.second_look
    assert looked is not None
    found = looked.halves["final"]
    assert found is not None

    def said(halves: Halves | None) -> Outcome:
        return replace(outcome, second_look=replace(looked, halves={"final": halves}))

    good, bad = replace(found, p_value=0.43), replace(found, p_value=3e-12, of="joint_2", how="low and high")
    assert (True, "Halves of the rows, fitted apart, agree (p = 0.43).") in checks(said(good))
    words = "Halves of the rows, fitted apart, differ by more than noise explains (p = 3.0e−12): low and high joint_2."
    assert (False, words) in checks(said(bad))
    assert "the model lacks something that low and high joint_2 feel unequally" in join(list(fits(said(bad))))
    assert not any("alves" in words for _, words in checks(said(None)))
    assert "too few rows to fit halves" in join(list(fits(said(None))))


def test_another_days_data_get_a_section_of_their_own(outcome: Outcome, handover: ControllerExports) -> None:
    residuals = {stage.name: 2 * stage.residual for stage in outcome.stages}
    other = Verification(
        "<day 2>.csv",
        outcome.measurements,
        residuals,
        np.zeros(len(outcome.measurements), bool),
        outcome.stages[-1].residual,
    )
    report = page(replace(outcome, verification=other), handover)
    assert_sound(report)
    section = text(report, "//section[@id='verification']")
    assert "<day 2>.csv: 124 rows" in section
    assert "final, frames refitted" in section
    every = np.ones(124, dtype=bool)
    assert number(errors(residuals["final"], every, outcome.channels)["position_mm"]["rms"]) in section
    written = result_document(replace(outcome, verification=other))["verification"]
    assert written["rows"] == 124
    assert written["error"]["final"] == errors(residuals["final"], every, outcome.channels)
    assert written["error"]["realigned"] == errors(outcome.stages[-1].residual, every, outcome.channels)
    assert "verification" not in result_document(outcome)


@pytest.mark.parametrize(
    ("times", "realigned", "good", "says"),
    [
        (1.1, 1.0, True, ""),
        (3.0, 1.0, False, "mm with both frames fitted anew: the target or the instrument was remounted."),
        (3.0, 2.9, False, "mm with both frames fitted anew: the robot has changed since."),
    ],
)
def test_another_days_data_are_judged_on_the_first_screen(
    times: float, realigned: float, good: bool, says: str, outcome: Outcome
) -> None:
    flagged = outcome.outlier
    last = outcome.stages[-1].residual
    rows = outcome.measurements
    residuals = {stage.name: times * stage.residual for stage in outcome.stages}
    other = Verification("<day 2>.csv", rows, residuals, flagged, realigned * last)
    sentences = [(fine, said) for fine, said in checks(replace(outcome, verification=other)) if "Another day" in said]
    ((fine, said),) = sentences
    rms = 1e3 * np.sqrt(np.mean(np.sum((times * last[~flagged, :3]) ** 2, axis=1)))
    assert fine is good
    assert said.startswith(f"Another day's rows (<day 2>.csv, 122 of 124): {rms:.3f} mm RMS, ")
    assert said.endswith(says or "held-out rows.")
    assert "Another day" in join(list(summary(replace(outcome, verification=other))))
    assert not any("Another day" in words for _, words in checks(outcome))
    console = Console(file=io.StringIO(), width=250)
    print_summary(replace(outcome, verification=other), console)
    assert said in console.file.getvalue()  # type: ignore[attr-defined]


def test_effects_and_what_else_was_tried_are_shown(outcome: Outcome, handover: ControllerExports) -> None:
    name = outcome.robot.names[1]
    gain = Coefficient(name, "axis", Basis("linear", (name,), (0.0,)))
    effect = Effect("joint_gain", name, (gain,))
    grid = np.linspace(-2, 2, 50)
    rows = outcome.measurements.readings[:, 1]
    curve = Curve("axis", "rad", name, grid, 1e-3 * grid, np.full(50, 1e-5), rows, 1e-3 * rows)
    before = np.tile([[3e-3, 0, 0, 2e-3, 0, 0]], (10, 1))
    beyond = outcome.robot.names[2]
    load = Basis("linear", (f"{beyond}.gravity_torque",), (0.0,))
    other = Effect("joint_compliance", beyond, (Coefficient(beyond, "axis", load),))
    named = NamedEffect(effect, False, 1e-300, before, before / 4, outcome.stages[1].residual, (other,), (curve,))
    found = Diagnosis(
        (named,),
        (RejectedEffect(other, 0.2, 1.0, "too small <b>"),),
        (UntestableEffect("thermal", "no <i>"),),
        77,
        (Clue("order", "white?", 0.1, 0.5),),
    )
    report = page(replace(outcome, diagnosis=found), handover)
    assert_sound(report)
    screen = Console(file=io.StringIO(), width=250)
    print_summary(replace(outcome, diagnosis=found), screen)
    twin = f"or as well joint_compliance at {beyond}"
    assert f"found: joint_gain at {name} [axis], {twin}: " in screen.file.getvalue()  # type: ignore[attr-defined]
    assert or_as_well(replace(named, confounded_with=())) == ""
    five = tuple(Effect("thermal", joint, ()) for joint in outcome.robot.names[:5])
    assert or_as_well(replace(named, confounded_with=five * 2)).endswith(f"thermal at {five[2].where} and 2 more")
    assert table(report, "Gain of each effect") == [
        [
            f"joint_gain at {name}{EFFECT_KINDS['joint_gain'].words}",
            "axis",
            name,
            "found",
            "below 1e−100",
            "3.00",
            "0.750",
            "2.00",
            "0.500",
        ]
    ]
    section = text(report, "//section[@id='depends']")
    turned, still = outcome.robot.names[2], outcome.robot.names[1]
    assert table(report, "Effects that these data cannot separate")[0][:2] == [
        f"joint_gain at {name}", f"joint_compliance at {turned}"
    ]  # fmt: skip
    assert f"the gravity load on {turned} changes while {still} stays the same" in section
    for words in ("4.00 mrad peak to peak", "77 candidates", "too small <b>",
                  "thermal: no <i>", "white?"):  # fmt: skip
        assert words in section
    assert "model.urdf" in text(report, "//section[@id='use']")


def test_each_effect_has_its_line_between_the_geometry_and_the_whole(
    outcome: Outcome, handover: ControllerExports
) -> None:
    names = outcome.robot.names[1:3]
    nominal, geometric, final = outcome.stages
    left = {name: share * nominal.residual for name, share in zip(names, (0.5, 0.25), strict=True)}
    test = outcome.parts()["test"]
    effects = tuple(
        NamedEffect(
            Effect("joint_gain", name, (Coefficient(name, "axis", Basis("linear", (name,), (0.0,))),)),
            False, 1e-9, nominal.residual[test], left[names[1]][test], left[name], (),
        )
        for name in names
    )  # fmt: skip
    stages = (nominal, replace(geometric, residual=0.75 * nominal.residual), replace(final, residual=left[names[1]]))
    report = page(replace(outcome, stages=stages, diagnosis=Diagnosis(effects, (), (), 0, ())), handover)
    whole = errors(nominal.residual, test, outcome.channels)["position_mm"]["rms"]
    expected = {
        "nominal": 1.0, "geometric": 0.75, f"+\u00a0joint_gain at {names[0]}": 0.5,
        f"+\u00a0joint_gain at {names[1]} = final": 0.25,
    }  # fmt: skip
    shown = {row[0]: plain(row[1]) for row in table(report, "Position error")}
    assert list(shown) == list(expected)
    assert list(shown.values()) == pytest.approx([share * whole for share in expected.values()], rel=5.1e-3)
    bars = html.fromstring(report).xpath("(//ol)[1]/li")
    assert [float(bar.xpath(".//i/@style")[0][6:-1]) for bar in bars] == pytest.approx([100, 75, 50, 25], abs=0.1)
    first = text(report, "//header")
    assert "9 more" not in first
    assert f"31 % joint_gain at {names[0]} ({EFFECT_KINDS['joint_gain'].words})" in first  # 0.75^2 - 0.5^2
    confounded = replace(effects[0], confounded_with=(effects[1].effect,))
    diagnosis = Diagnosis((confounded, effects[1]), (), (), 0, ())
    first = text(page(replace(outcome, stages=stages, diagnosis=diagnosis), handover), "//header")
    assert (
        f"31 % joint_gain at {names[0]} ({EFFECT_KINDS['joint_gain'].words}, or as well joint_gain at {names[1]})"
        in first
    )


# ---- hostile names --------------------------------------------------------------------------------------------------


def test_names_that_a_user_wrote_stay_text(truth: robots.Truth, tmp_path: Path) -> None:
    urdf = truth.model.robot.urdf.decode()
    for name in ("shoulder_pan_joint", '"ur10"', '"tool0"'):
        urdf = urdf.replace(name, name.replace(name.strip('"'), escape(HOSTILE + name.strip('"'))))
    robot = truth.model.robot
    hostile = parse_robot(urdf.encode(), HOSTILE + robot.tip, robot.base, robot.path)
    other = replace(truth, model=replace(truth.model, robot=hostile, coefficients=()))
    rows = rows_with_faults(other)
    rows.loc[40, "z"] = np.nan
    file = f"{HOSTILE}.csv".replace("/", "")
    path = robots.write_campaign(tmp_path, other, rows, measurements={"file": file})
    (tmp_path / "measurements.csv").rename(tmp_path / file)
    report = whole_page(identify(path))
    assert_sound(report)
    first = text(report, "//header")
    assert f"Calibration of {HOSTILE}ur10" in first
    assert file in first
    assert f"to {HOSTILE}tool0" in first
    assert f"{HOSTILE}shoulder_pan_joint" in text(report, "//section[@id='enough']")
    assert f"{file}, line 42" in text(report, "//section[@id='data']")
