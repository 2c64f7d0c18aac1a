"""The certificate: dated, of one page, its words those of the result, never more than the verdict, and nobody's accreditation."""

from __future__ import annotations

import datetime
import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path

import gauges
import numpy as np
import pandas as pd
import pytest
import robots
import yaml
from lxml import html

from aridcal.calibration import Calibration
from aridcal.files.purposes import About
from aridcal.identify import main as identify_main
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.calibrate.verdict import Verdict
from aridcal.pages import certificate as module
from aridcal.pages.certificate import CERTIFICATE_FILES, certificate, write_certificate
from aridcal.pages.drawing.html import join
from aridcal.pages.drawing.one_page import OnePage, as_html
from aridcal.pages.report.iso_section import iso
from aridcal.runs.result_folder import RESULT_FILES
from aridcal.system.errors import CampaignError
from aridcal.system.wording import number

ISSUED = datetime.date(2026, 11, 22)
ABOUT = {
    "robot": "Universal Robots UR10",
    "serial_number": "2016301234",
    "instrument": "laser tracker",
    "instrument_serial": "753012",
    "who": "Jürgen Müller",
    "organisation": "Institut für Robotik <b>&amp;</b>",
    "date": "2026-11-20",
    "environment": "21.3 ± 0.4 °C",
    "method": "random poses, each after a stop of 2 s",
    "notes": "yearly",
    "certificate_number": "2026-117",
}


def campaign_of(folder: Path, **changes: object) -> Path:
    """A UR10 of which five poses were measured four times; two are held out, and a tenth of the other rows."""
    rng = np.random.default_rng(5)
    truth = robots.simulate(robots.ur10(), 60, rng, noise=5e-5)
    rows = robots.table(truth)
    again = [rows.iloc[:5].copy() for _ in range(3)]
    for some in again:
        some[["x", "y", "z"]] += rng.normal(0.0, 5e-5, (5, 3))
    every = pd.concat([rows, *again], ignore_index=True)
    every["split"] = np.where(np.arange(len(every)) % 60 % 5 < 2, "test", "train")
    every["split"] = np.where(
        np.arange(len(every)) >= 60, every["split"].iloc[np.arange(len(every)) % 5], every["split"]
    )
    every["time"] = 20.0 * np.arange(len(every))
    return robots.write_campaign(folder, truth, every, **changes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a result would be: the files that the certificate identifies."""
    folder = tmp_path_factory.mktemp("certificate")
    for name in module.HASHED:
        (folder / name).write_text(name)
    return folder


@pytest.fixture(scope="module")
def outcome(folder: Path) -> Outcome:
    found = identify(campaign_of(folder, about=ABOUT))
    return replace(found, verdict=Verdict("noise_floor", 0.0, ()))


def page_of(outcome: Outcome, folder: Path, **about: str) -> OnePage:
    return certificate(outcome, About.model_validate(ABOUT | about), folder, ISSUED)


def words_of(page: OnePage) -> str:
    """What a reader sees of it, in one line."""
    return " ".join(" ".join(html.fromstring(as_html(page)).xpath("//body")[0].itertext()).split())


# ---- what it says ----------------------------------------------------------------------------------------------------


def test_it_says_who_measured_what_when_and_with_what(outcome: Outcome, folder: Path) -> None:
    said = words_of(page_of(outcome, folder))
    for stated in ABOUT.values():
        assert stated in said
    assert "Issued on 2026-11-22" in said
    assert f"{len(outcome.measurements)} rows of poses" in said


def test_its_errors_are_those_of_the_result_on_held_out_rows(outcome: Outcome, folder: Path) -> None:
    test = outcome.parts()["test"]
    page = page_of(outcome, folder)
    for stage in (outcome.stages[0], outcome.stages[-1]):
        size = 1e3 * np.linalg.norm(stage.residual[test][:, :3], axis=1)
        rms, most = float(np.sqrt(np.mean(size**2))), float(size.max())
        assert number(rms) in dict(page.headline)["Position error, RMS"]
        assert number(most) in words_of(page)
    errors = next(part for part in page.parts if part.heading.startswith("Errors"))
    assert errors.heading == "Errors before and after, on held-out rows"
    assert [row[1] for row in errors.table[1:]] == [str(test.sum())] * 2


def test_its_uncertainty_is_twice_the_standard_deviation_and_says_so(outcome: Outcome, folder: Path) -> None:
    said = words_of(page_of(outcome, folder))
    sigma = 1e3 * outcome.precision.position
    assert f"k = 2 (about 95 % for normal noise): median {number(2 * float(np.median(sigma)))} mm" in said
    assert f"at most {number(2 * float(sigma.max()))} mm at the fitted rows" in said
    assert dict(page_of(outcome, folder).headline)["Uncertainty, k = 2"].startswith("by noise alone: median 0.0")


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("structure_remains", "A repeatable error remains that the model does not describe."),
        ("not_enough_data", "There are too few data for a model of this size."),
    ],
)
def test_it_claims_no_more_than_the_verdict(outcome: Outcome, folder: Path, word: str, words: str) -> None:
    page = page_of(replace(outcome, verdict=Verdict(word, 0.4, ("repeats scatter less",))), folder)
    assert page.headline[-1] == ("Verdict", words)  # among the figures, and in their letters
    said = words_of(page)
    assert f"Verdict {word}: repeats scatter less. 40 % of the remaining variance is repeatable." in said
    assert "By the verdict, real errors may well exceed it." in said
    assert "consistent with the measurement noise" not in said
    sound = words_of(page_of(outcome, folder))
    assert "consistent with the measurement noise" in sound
    assert "By the verdict" not in sound and words not in sound


@pytest.mark.parametrize(
    ("reasons", "answer"), [((), "kept in 95 %"), (("few rows",), "cannot be said to be kept in 95 %")]
)
def test_a_tolerance_stands_among_the_figures_whether_it_is_kept_or_not(
    outcome: Outcome, folder: Path, reasons: tuple[str, ...], answer: str
) -> None:
    assert outcome.certainty is not None
    first, *others = outcome.certainty.tolerances
    asked = replace(outcome.certainty, tolerances=(replace(first, tolerance=2e-4, reasons=reasons), *others))
    headline = dict(page_of(replace(outcome, certainty=asked), folder).headline)
    assert headline["Tolerance of position"].startswith(f"0.200 mm: {answer}")
    assert not any(name.startswith("Tolerance") for name, _ in page_of(outcome, folder).headline)


def test_it_is_the_makers_own_record_and_no_accreditation(outcome: Outcome, folder: Path) -> None:
    page = page_of(outcome, folder)
    assert page.title == "Calibration certificate: the maker's own record"
    assert "not issued by an accredited laboratory" in page.under
    said = words_of(page).lower()
    assert said.count("accredit") == 1 and "17025" not in said and "certified" not in said


def test_without_held_out_rows_it_says_that_errors_are_too_optimistic(outcome: Outcome, folder: Path) -> None:
    m = replace(outcome.measurements, test=np.zeros(len(outcome.measurements), dtype=bool))
    page = page_of(replace(outcome, measurements=m), folder)
    said = words_of(page)
    assert "Errors before and after, on fitted rows" in said
    assert "No rows were held out: these are errors of the fit itself, and too optimistic." in said


def test_what_is_not_stated_is_said_not_to_be(outcome: Outcome, folder: Path) -> None:
    page = certificate(outcome, About(), folder, ISSUED)
    facts = dict(page.parts[0].facts)
    assert facts["Robot"] == "ur10"
    assert [facts[name] for name in ("Serial number", "Instrument", "Measured by")] == ["not stated"] * 3
    (file,) = outcome.measurements.origin.files
    os.utime(file, (1.7e9, 1.7e9))
    dated = dict(certificate(outcome, About(), folder, ISSUED).parts[0].facts)["Measured on"]
    assert dated == "not stated (newest file: 2023-11-14)"


def test_uncertainty_that_no_row_tells_is_not_stated(outcome: Outcome, folder: Path) -> None:
    unknown = replace(outcome.precision, position=np.full_like(outcome.precision.position, np.nan))
    said = words_of(page_of(replace(outcome, precision=unknown), folder))
    assert "so no uncertainty of its place can be stated" in said
    assert "Uncertainty, k = 2 not known" in said
    assert "nan" not in said and "normal noise" not in said


@pytest.mark.parametrize("tied", [True, False])
def test_rows_that_agree_are_no_proof_of_accuracy(tmp_path: Path, tied: bool) -> None:
    """A ball in sockets: rows agree far better than the target is known; of sockets at unknown distances nothing is known."""
    of = gauges.arm(2)
    found = gauges.outcome(tmp_path, of, gauges.rows(of, gauges.points(of, rows=14, tied=tied)))
    for name in module.HASHED:
        (tmp_path / name).write_text(name)
    page = certificate(found, About(), tmp_path, ISSUED)
    short, said = dict(page.headline)["Uncertainty, k = 2"], words_of(page)
    if tied:
        assert number(2e3 * float(np.median(found.precision.position))) in short
        assert "that is consistency, not accuracy." in said
    else:
        assert short == "not known"
        assert "this is consistency, not accuracy" in said
    assert "ISO 9283" not in said
    assert "does not apply to these measurements" in join(list(iso(found)))


def test_it_is_valid_where_rows_were_fitted(outcome: Outcome, folder: Path) -> None:
    m = outcome.measurements
    facts = dict(next(p for p in page_of(outcome, folder).parts if p.heading == "Where it is valid").facts)
    fitted = np.degrees(m.readings[outcome.parts()["train"]])
    for name, q in zip(outcome.robot.readings, fitted.T, strict=True):
        ends = f"{q.min():.0f}° … {q.max():.0f}°".replace("-", "−")
        assert f"{name} {ends}" in facts["Joints"]


def test_iso_figures_of_few_cycles_are_no_test_to_the_standard(outcome: Outcome, folder: Path) -> None:
    part = next(p for p in page_of(outcome, folder).parts if "ISO 9283" in p.heading)
    assert part.heading == "Figures by the definitions of ISO 9283:1998"
    (words,) = part.words
    assert "asks for 30 cycles of 5 poses: these are figures by its definitions, not tests to it." in words
    assert "Of fewer than 10 cycles RP comes out too small on average" in words
    found = outcome.iso
    assert found is not None and found.held_out.sum() == 2
    shown = {row[0]: row for row in part.table}
    assert shown["AP"][2:] == (
        "2 held-out poses",
        f"{number(1e3 * max(found.nominal['AP'][found.held_out]))} mm",
        f"{number(1e3 * max(found.final['AP'][found.held_out]))} mm",
    )
    assert shown["RP"][2] == "5 poses"


def test_the_report_and_the_document_have_the_same_iso_figures(outcome: Outcome) -> None:
    section = join(list(iso(outcome)))
    found = outcome.iso
    assert found is not None
    for k in range(5):
        for figures in (found.nominal, found.final):
            assert number(1e3 * float(figures["AP"][k])) in section
    assert "5 poses, 4 cycles of each." in section


def test_in_python_the_iso_figures_are_a_table(outcome: Outcome) -> None:
    table = Calibration(calibration(outcome), outcome).iso_9283
    found = outcome.iso
    assert found is not None and len(table) == 5
    assert table["final_AP_mm"].tolist() == pytest.approx((1e3 * found.final["AP"]).tolist())
    assert table["nominal_RP_b_mrad"].tolist() == pytest.approx((1e3 * found.nominal["RP_b"]).tolist())
    assert table["cycles"].tolist() == [4] * 5 and sorted(table["split"]) == ["test"] * 2 + ["train"] * 3
    once = replace(outcome, outlier=outcome.measurements.covariates["time"] >= 20.0 * 60)
    assert Calibration(calibration(outcome), once).iso_9283.empty


def test_the_report_says_why_there_are_no_iso_figures(outcome: Outcome) -> None:
    once = replace(outcome, outlier=outcome.measurements.covariates["time"] >= 20.0 * 60)
    assert "No pose was attained twice" in join(list(iso(once)))


# ---- files -----------------------------------------------------------------------------------------------------------


def test_the_command_writes_both_files_and_their_hashes_are_those_of_the_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = campaign_of(tmp_path, about=ABOUT), tmp_path / "out"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())  # a mark that is not part of the text
    assert identify_main([str(path), "--out", str(out)]) == 0
    assert f"certificate: {out / 'certificate.pdf'}\n" in capsys.readouterr().out
    assert set(CERTIFICATE_FILES) <= RESULT_FILES  # none outlives a result without `about`
    said = html.fromstring((out / "certificate.html").read_bytes()).text_content()
    named = [path, tmp_path / "robot.urdf", tmp_path / "measurements.csv", *(out / name for name in module.HASHED)]
    for file in named:
        assert file.name in said
        assert hashlib.sha256(file.read_bytes()).hexdigest() in said
    assert f"Issued on {datetime.date.today().isoformat()}" in said
    assert (out / "certificate.pdf").read_bytes().startswith(b"%PDF")
    result = json.loads((out / "result.json").read_text())["iso_9283"]
    assert len(result["poses"]) == 5 and len(result["distances"]) == 10


def test_a_campaign_that_was_edited_during_the_run_is_identified_as_it_was_read(outcome: Outcome, folder: Path) -> None:
    path = outcome.campaign.path
    before = path.read_bytes()
    path.write_bytes(before + b"# changed\n")
    said = words_of(page_of(outcome, folder))
    path.write_bytes(before)
    assert hashlib.sha256(before).hexdigest() in said
    assert hashlib.sha256(before + b"# changed\n").hexdigest() not in said


def test_without_about_there_is_no_certificate(outcome: Outcome, tmp_path: Path) -> None:
    bare = replace(outcome, campaign=outcome.campaign.model_copy(update={"about": None}))
    assert write_certificate(bare, tmp_path, ISSUED) == ()
    assert not list(tmp_path.iterdir())


def test_a_page_that_cannot_be_drawn_costs_a_notice(
    outcome: Outcome, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(page: OnePage) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(module, "as_pdf", fail)
    (notice,) = write_certificate(outcome, folder, ISSUED)
    assert notice.startswith("the certificate is not drawn: MemoryError: no room")
    assert not (folder / "certificate.html").exists()


# ---- what users write ------------------------------------------------------------------------------------------------


def refusal(tmp_path: Path, text: str) -> str:
    """What is said of a campaign with this under `about`."""
    path = campaign_of(tmp_path)
    path.write_text(f"{path.read_text()}about:\n{text}", encoding="utf-8")
    with pytest.raises(CampaignError) as error:
        identify(path)
    assert str(path) in str(error.value) and "line" in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("  serial_number: 00123\n", r"about.serial_number: should be text: put it in quotes"),
        ("  who: no\n", "about.who: should be text: put it in quotes"),
        ("  serial: x\n", "about.serial: unknown key"),
        ("  serialnumber: x\n", "did you mean 'serial_number'?"),
        ('  who: "a\\u0007b"\n', "about.who: holds a control character; delete it"),
        ('  serial_number: "12\\u202e34"\n', "about.serial_number: holds a control character; delete it"),
        ('  who: " "\n', "about.who: is empty"),
        (f"  who: {'W' * 121}\n", "about.who: has 121 characters, and the certificate has room for 120"),
        (f"  notes: {'W' * 501}\n", "about.notes: has 501 characters, and the certificate has room for 500"),
        ("  environment: {temperature: 21}\n", "about.environment: should be text"),
    ],
)
def test_what_the_certificate_could_not_show_as_meant_is_refused(tmp_path: Path, text: str, said: str) -> None:
    assert said in refusal(tmp_path, text)


def test_lines_and_dates_of_yaml_are_taken_as_they_are_meant() -> None:
    text = yaml.safe_load("notes: |\n  one\n  two\n")["notes"]
    about = robots.campaign(about={"notes": text, "date": datetime.date(2026, 11, 20)}).about
    assert about is not None
    assert (about.notes, about.date) == ("one two", "2026-11-20")


def test_markup_is_text(outcome: Outcome, folder: Path) -> None:
    hostile = """<script>alert(1)</script><img src=x onerror="x">$\\frac{1}{0}$ {unfilled} %s"""
    page = page_of(outcome, folder, who=hostile, notes=hostile)
    root = html.fromstring(as_html(page))
    assert hostile in words_of(page)
    assert not list(root.iter("script", "img", "link", "iframe"))
