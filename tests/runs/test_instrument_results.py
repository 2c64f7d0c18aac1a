"""Results of campaigns whose rows measure something else than the target's pose: figures, files, screen and report."""

from __future__ import annotations

import io
import json
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import chromium
import gauges
import numpy as np
import pandas as pd
import pytest
from lxml import html
from rich.console import Console
from searched import searched_rows

import aridcal
from aridcal.calibration import Calibration
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.instruments.channels import columns, spread
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.rows.dataset import Dataset
from aridcal.identify import summary
from aridcal.jobs.calibrate.folder import residual_table, result_document
from aridcal.jobs.calibrate.instrument_results import known_scale_sigma, scale_std, thing_values
from aridcal.jobs.calibrate.outcome import Outcome, leading
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.pages.drawing.html import join, tag
from aridcal.pages.report.data_section import data
from aridcal.pages.report.first_screen import summary as first_screen
from aridcal.pages.report.instruments_section import BLIND, MORE, instruments
from aridcal.runs.result_folder import write_folder
from aridcal.system.errors import AridcalError

BLOCKS: dict[str, Callable[[gauges.Arm], tuple[gauges.Measured, ...]]] = {
    "point": lambda arm: (gauges.points(arm),),
    "loose": lambda arm: (gauges.points(arm, tied=False),),
    "distance": lambda arm: (gauges.distances(arm),),
    "plane": lambda arm: (gauges.heights(arm),),
    "pixels": lambda arm: (gauges.pixels(arm),),
    "inclination": lambda arm: (gauges.levels(arm),),
    "targets": lambda arm: (gauges.positions(arm),),
    "mixed": lambda arm: (gauges.points(arm), gauges.distances(arm), gauges.pixels(arm, 10)),
}
KEYS = {
    "point": ["position_mm"],
    "loose": ["position_mm"],
    "distance": ["distance_mm"],
    "plane": ["distance_mm"],
    "pixels": ["pixel_px"],
    "inclination": ["inclination_mrad"],
    "targets": ["position_mm"],
    "mixed": ["position_mm", "distance_mm", "pixel_px"],
}
ROLES = {
    "point": {"points"},
    "distance": {"anchors"},
    "plane": {"planes"},
    "pixels": {"cameras", "boards", "markers"},
    "mixed": {"points", "anchors", "cameras", "boards", "markers"},
}
EVERY = pytest.mark.parametrize("name", list(BLOCKS))
STEP = 1e-6
HOME = TemporaryDirectory(prefix="gauges")


@cache
def measured(name: str) -> tuple[gauges.Arm, Dataset]:
    """A simulated campaign."""
    arm = gauges.arm()
    return arm, gauges.rows(arm, *BLOCKS[name](arm))


@cache
def found(name: str) -> Outcome:
    """What comes of it."""
    folder = Path(HOME.name) / name
    folder.mkdir()
    return gauges.outcome(folder, *measured(name))


@cache
def saved_of(name: str) -> SavedModel:
    """What is saved of it."""
    return calibration(found(name))


@cache
def written(name: str) -> tuple[Path, tuple[str, ...]]:
    """Its result folder, and what could not be drawn."""
    folder = Path(HOME.name) / f"{name}-results"
    return folder, write_folder(found(name), folder).notices


def drawn(name: str) -> str:
    """Its report."""
    return (written(name)[0] / "report.html").read_text("utf-8")


def header(name: str) -> str:
    """The first screen of its report."""
    return text(tag("html", tag("body", list(first_screen(found(name))))))


def section(name: str) -> str:
    """What its report says of the instruments."""
    return text(tag("html", tag("body", list(instruments(found(name))))))


def text(report: str, part: str = "//body") -> str:
    """What a reader sees of a part of the page, in one line."""
    return " ".join(" ".join(element.text_content() for element in html.fromstring(report).xpath(part)).split())


# ---- figures ---------------------------------------------------------------------------------------------------------


@EVERY
def test_errors_and_noise_are_told_by_channel_and_are_those_of_the_rows(name: str) -> None:
    outcome = found(name)
    document = json.loads(json.dumps(result_document(outcome), allow_nan=False))
    table = residual_table(outcome)
    rows = table[(table.split == "test") & (table.outlier == 0)]
    wide = [c for c in table if c.startswith("final_")]
    assert list(document["error"]["final"]["test"]) == KEYS[name]
    for key, part in zip(KEYS[name], columns(outcome.channels), strict=True):
        numbers = rows[wide[part]].dropna().to_numpy()
        rms = np.sqrt(np.mean(np.sum(numbers**2, axis=1))) * (1.0 if key.endswith("px") else 1e3)
        assert document["error"]["final"]["test"][key]["rms"] == pytest.approx(rms, rel=1e-6)
        assert document["noise"][key] == pytest.approx(
            gauges.NOISE[key.partition("_")[0]] * (1.0 if key.endswith("px") else 1e3), rel=0.15
        )


def test_a_row_of_a_mixed_campaign_has_residuals_of_its_own_block_alone() -> None:
    outcome = found("mixed")
    table = residual_table(outcome)
    for block in outcome.measurements.blocks:
        own = table[table.block == block.name]
        mine = [c for c in table if c.startswith(f"final_{block.name}_")]
        others = [c for c in table if c.startswith("final_") and c not in mine]
        assert own[mine].notna().all(axis=None)
        assert own[others].isna().all(axis=None)
    assert set(table[table.block == "pixels"].camera) == {"eye"}
    assert set(table[table.block == "pixels"].target) == {"tip"}


@pytest.mark.parametrize("name", list(ROLES))
def test_every_number_of_every_thing_is_in_the_results(name: str) -> None:
    document = result_document(found(name))["instruments"]
    things = found(name).measurements.instruments.things
    assert set(document) == ROLES[name]
    for role, every in things.items():
        assert set(document[f"{role}s"]) == set(every.names)
        for numbers in document[f"{role}s"].values():
            assert all(n["status"] in ("identified", "fixed", "redundant") for n in numbers.values())
            assert all((n["std"] is not None) == (n["status"] == "identified") for n in numbers.values())


@pytest.mark.parametrize("name", ["point", "distance", "mixed"])
def test_things_are_as_far_apart_as_they_truly_are_within_their_sigmas(name: str) -> None:
    blocks = {b.kind: b for b in BLOCKS[name](gauges.arm())}  # the same draws again
    role = "anchor" if name == "distance" else "point"
    truth = blocks["distance" if role == "anchor" else "point"].states[role]
    numbers = result_document(found(name))["instruments"][f"{role}s"]
    place, sigma = (
        {label: np.array([n[c][key] for c in "xyz"]) for label, n in numbers.items()} for key in ("value", "std")
    )
    first, *others = truth
    for other in others:
        told = np.linalg.norm(place[other] - place[first])
        true = np.linalg.norm(truth[other][:3] - truth[first][:3])
        assert abs(told - true) < 4.0 * np.linalg.norm([*sigma[first], *sigma[other]])


def joint_covariance(asked: Problem, outcome: Outcome) -> tuple[np.ndarray, list[tuple[str, int, int]]]:
    """Covariance of all coefficients and all free components of things, by differences; and whose the latter are."""
    fit = outcome.stages[-1].fit
    free = [
        (role, k, c)
        for role, t in asked.instruments.things.items()
        if t.role.many
        for k, c in np.argwhere(t.free).tolist()
    ]

    def left(theta: np.ndarray, change: np.ndarray) -> np.ndarray:
        states = dict(asked.states)
        for (role, k, c), step in zip(free, change, strict=True):
            if step:
                things = asked.instruments.things[role]
                one = np.zeros((1, len(things.role.components)))
                one[0, c] = step
                states[role] = states[role].copy()
                states[role][k] = things.role.moved(states[role][k : k + 1], one)[0]
        residual = asked.with_states(states).residual(theta) / spread(fit.sigma, asked.channels)
        known = []
        for tie in asked.instruments.ties:
            ends = [
                states[tie.role][asked.instruments.things[tie.role].names.index(end)] for end in (tie.first, tie.second)
            ]
            known.append((tie.value - np.linalg.norm(ends[0] - ends[1])) / tie.std)
        return np.concatenate([np.nan_to_num(residual * np.sqrt(fit.weight)[:, None]).ravel(), known])

    K, U = len(fit.theta), len(free)
    J = []
    for j in range(K + U):
        step = np.zeros(K + U)
        step[j] = STEP
        J.append((left(fit.theta + step[:K], step[K:]) - left(fit.theta - step[:K], -step[K:])) / (2 * STEP))
    A = np.array(J).T
    H = A.T @ A
    H[:K, :K] += fit.believed  # where rows are few
    scale = np.sqrt(np.diag(H))
    return np.linalg.inv(H / np.outer(scale, scale)) / np.outer(scale, scale), free


@pytest.mark.parametrize("name", ["point", "distance", "plane", "mixed"])
def test_sigmas_of_things_and_of_the_scale_are_those_of_all_unknowns_solved_together(name: str) -> None:
    outcome = found(name)
    train = outcome.measurements.select(outcome.measurements.train)
    asked = problem(outcome.stages[-1].fit.model, train)
    covariance, free = joint_covariance(asked, outcome)
    K = len(outcome.stages[-1].fit.theta)
    std = {(v.name, v.component): v.std for v in outcome.things}
    for j, (role, k, c) in enumerate(free):
        things = asked.instruments.things[role]
        component = things.role.components[c]
        if not component.startswith("tilt"):  # of planes the normal is told
            assert std[things.names[k], component] == pytest.approx(np.sqrt(covariance[K + j, K + j]), rel=1e-3)
    if name == "plane":
        for k, label in enumerate(asked.instruments.things["plane"].names):
            tilts = [K + free.index(("plane", k, c)) for c in (0, 1)]
            spread_of_normal = np.sqrt(sum(std[label, n] ** 2 for n in ("nx", "ny", "nz")))
            assert spread_of_normal == pytest.approx(np.sqrt(np.trace(covariance[np.ix_(tilts, tilts)])), rel=1e-3)
    if name == "point":
        places = asked.states["point"] - asked.states["point"].mean(axis=0)
        along = np.zeros(len(covariance))
        for j, (_, k, c) in enumerate(free):
            along[K + j] = places[k, c] / np.sum(places**2)
        assert scale_std(outcome.stages[-1].fit, train) == pytest.approx(np.sqrt(along @ covariance @ along), rel=1e-3)


def test_what_no_row_tells_of_a_thing_is_redundant_with_the_rest_of_it() -> None:
    outcome = found("distance")
    m, fit = outcome.measurements, outcome.stages[-1].fit
    train = m.select(m.train)
    first = np.flatnonzero(train.labels.refers[:, 0] == "w0")
    kept = np.setdiff1d(np.arange(len(train)), first[3:])  # three readings, four unknowns
    values = {(v.name, v.component): v for v in thing_values(replace(fit, weight=fit.weight[kept]), train.select(kept))}
    lost = [values["w0", c] for c in ("x", "y", "z", "offset")]
    assert {v.status for v in lost} == {"redundant"}
    assert all(v.std is None and v.rows == 3 for v in lost)
    assert set(lost[0].redundant_with) == {"w0.y", "w0.z", "w0.offset"}
    assert {values["w1", c].status for c in "xyz"} == {"identified"}
    assert values["w1", "scale"].status == "fixed"


def test_a_thing_that_only_held_out_rows_refer_to_is_scored_and_has_no_place(tmp_path: Path) -> None:
    arm = gauges.arm()
    data = gauges.rows(arm, gauges.distances(arm, anchors=4))
    outcome = gauges.outcome(tmp_path, arm, replace(data, test=data.test | (data.labels.refers[:, 0] == "w3")))
    numbers = result_document(outcome)["instruments"]["anchors"]["w3"]
    assert [numbers[c]["value"] for c in ("x", "y", "z", "offset")] == [None] * 4
    own = outcome.stages[-1].residual[data.labels.refers[:, 0] == "w3"]
    assert 0.5 * gauges.NOISE["distance"] < np.sqrt(np.mean(own**2)) < 2.0 * gauges.NOISE["distance"]
    lines = html.fromstring(join(list(instruments(outcome)))).xpath(
        '//table[starts-with(caption, "Anchors ")]/tbody/tr'
    )
    (line,) = ([cell.text_content() for cell in row] for row in lines if row[0].text_content() == "w3")
    assert line[1:6] == ["not told"] * 4 + ["60"]


def test_an_effect_is_worth_at_a_place_held_out_what_a_fit_without_it_leaves_there(tmp_path: Path) -> None:
    """The points of that place follow each model: they are no part of either, and held by those of the other they would err."""
    arm = gauges.arm()
    data = gauges.rows(arm, gauges.points(arm, pairs=4))
    held = np.char.startswith(data.labels.refers[:, 0], "a3/")
    elbow = arm.robot.names.index("elbow_joint")
    readings = data.readings.copy()
    readings[:, elbow] += 5e-4 * np.sin(readings[:, elbow])
    data = replace(data, readings=readings, test=held)
    stated: dict[str, dict[str, object]] = {
        "elbow_joint": {"kind": "joint_harmonic", "where": "elbow_joint", "order": 1},
        "shoulder_lift_joint": {"kind": "joint_gain", "where": "shoulder_lift_joint"},
    }

    def error(residual: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))

    whole = gauges.outcome(tmp_path, arm, data, effects=list(stated.values()))
    (effect,) = (e for e in whole.effects if e.effect.where == "elbow_joint")
    # One Gauss-Newton step beside a fit to its end.
    job = gauges.campaign(tmp_path, arm, data, effects=[stated["shoulder_lift_joint"]])
    without = error(searched_rows(job.question, arm.robot, data).judged.stages[-1].residual[held])
    assert error(effect.before) == pytest.approx(without, rel=0.02)


# ---- at the target ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["point", "distance", "plane", "pixels", "mixed"])
def test_the_target_shifted_by_what_is_shown_leaves_no_residual(name: str) -> None:
    outcome = found(name)
    fit, m = outcome.stages[-1].fit, outcome.measurements
    asked = problem(fit.model, m)
    shift = outcome.at_target.shift(outcome.stages[-1].residual)
    R, p = fit.model.poses(fit.theta, asked.rows)
    before = np.nan_to_num(asked.measured.left(R, p, fit.theta))
    after = np.nan_to_num(asked.measured.left(R, p + shift, fit.theta))
    assert np.abs(after).max() < 2e-3 * np.abs(before).max()


def test_a_pixel_is_at_the_target_its_distance_over_the_focal_length() -> None:
    outcome = found("pixels")
    residual = outcome.stages[-1].residual
    shift = np.linalg.norm(outcome.at_target.shift(residual), axis=1)
    length = np.linalg.norm(residual, axis=1)
    # the board is half a metre in front of the camera, seen from straight above to 0.4 rad askew
    per_pixel = shift / length * gauges.LENS[0]
    assert np.all((per_pixel > 0.3) & (per_pixel < 0.7))
    said = header("pixels")
    rms = np.sqrt(np.mean(shift[outcome.parts()["test"]] ** 2))
    assert f"At the target that is {1e3 * rms:.3f} mm RMS" in said


# ---- scale -----------------------------------------------------------------------------------------------------------


def test_points_without_a_known_length_have_no_scale_and_all_pages_say_so() -> None:
    outcome = found("loose")
    assert known_scale_sigma(outcome.measurements) == np.inf
    screen = io.StringIO()
    summary(outcome, Console(file=screen, width=200))
    assert "scale: unknown" in screen.getvalue()
    assert "consistency, not accuracy" in header("loose")
    assert "Scale: unknown" in section("loose")


def test_known_lengths_tell_the_scale_by_their_sigma_over_their_length() -> None:
    rows = found("point").measurements
    assert known_scale_sigma(rows) == pytest.approx(1e-5 / gauges.SPACING / np.sqrt(3))
    one = replace(rows, instruments=replace(rows.instruments, ties=rows.instruments.ties[:1]))
    assert known_scale_sigma(one) == pytest.approx(1e-5 / gauges.SPACING)
    assert re.search(r"± 0\.12 mm per m", section("point"))
    assert known_scale_sigma(found("distance").measurements) == known_scale_sigma(found("mixed").measurements) == 0.0
    assert known_scale_sigma(found("pixels").measurements) == 0.0
    assert known_scale_sigma(found("inclination").measurements) is None


def test_a_target_that_is_known_worse_than_the_rows_agree_is_said_to_be_consistent_not_accurate() -> None:
    weak, strong = header("pixels"), header("distance")  # one small board; wires all around
    assert re.search(r"! *The target is known to ± 1\.\d mm .* that is consistency, not accuracy", weak)
    assert re.search(r"✓ *The target is known to ± 0\.0\d+ mm \(1σ in its worst direction\)\.", strong)
    assert "not accuracy" not in strong
    deviation = np.median(found("pixels").precision.position)
    assert f"± {1e3 * deviation:.1f} mm" in weak


# ---- what is saved ---------------------------------------------------------------------------------------------------


@EVERY
def test_a_saved_calibration_predicts_the_target_of_the_outcome(name: str, tmp_path: Path) -> None:
    outcome = found(name)
    m = outcome.measurements
    (tmp_path / "calibration.yaml").write_text(saved_of(name).dump(), encoding="utf-8")
    saved = aridcal.load(tmp_path)
    rows = np.arange(len(m)) if m.labels.target is None else np.flatnonzero(m.labels.target != "tip")
    queries = pd.DataFrame(m.readings[rows], columns=outcome.robot.readings)
    if name == "targets":
        with pytest.raises(AridcalError, match="several targets"):
            saved.predict(queries)
        queries["target"] = m.labels.target[rows]
    roles = MEASUREMENT_KINDS[m.blocks[0].kind].roles
    labels = {role.name: m.labels.refers[rows, k] for k, role in enumerate(roles)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a table that was measured may be asked about as it is
        told = saved.predict(queries.assign(**labels))
    assert np.allclose(told[["x", "y", "z"]], outcome.at_target.places[rows], atol=1e-9)
    if name == "targets":
        assert saved.compensate(told).reached.all()
    turns = name in ("pixels", "inclination")
    assert saved.model.kind == ("pose" if turns else "position")
    assert not any(c.where in m.instruments.names for c in saved.model.final.model.coefficients)


@pytest.mark.parametrize("name", ["distance", "plane", "mixed", "targets"])
def test_predictions_are_where_the_target_truly_is_but_for_the_place_of_the_base(name: str) -> None:
    arm, data = measured(name)
    outcome = found(name)
    own = np.flatnonzero(data.test if data.labels.target is None else data.test & (data.labels.target != "tip"))
    told = outcome.at_target.places[own]
    true = arm.poses(data.readings[own])[1]
    if name == "targets":
        far = data.labels.target[own] == "far"
        true[far] = arm.poses(data.readings[own][far], gauges.REFLECTORS["far"])[1]
    a, b = told - told.mean(axis=0), true - true.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    off = np.linalg.norm(a @ R - b, axis=1)
    assert np.sqrt(np.mean(off**2)) < 3.0 * saved_of(name).largest_std[0]
    before = np.linalg.norm(outcome.stages[0].residual[own][:, :1], axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.5 * np.sqrt(np.nanmean(before**2))


def test_the_noise_of_a_saved_calibration_is_that_at_the_target() -> None:
    noise = {name: saved_of(name).noise for name in ("point", "distance", "pixels")}
    assert noise["point"] == (pytest.approx(gauges.NOISE["position"], rel=0.1), 1.0)
    assert noise["distance"] == (pytest.approx(gauges.NOISE["distance"], rel=0.15), 1.0)
    assert noise["pixels"][0] == pytest.approx(gauges.NOISE["pixel"] * 0.5 / gauges.LENS[0], rel=0.15)


# ---- screen, tables and pages ----------------------------------------------------------------------------------------


@EVERY
def test_the_screen_shows_errors_in_the_units_of_the_instruments(name: str) -> None:
    screen = io.StringIO()
    summary(found(name), Console(file=screen, width=200))
    document = result_document(found(name))
    for key in KEYS[name]:
        unit = key.rpartition("_")[2]
        rms = document["error"]["final"]["test"][key]["rms"]
        assert f"{rms:.3f} {unit}" in screen.getvalue()
        assert f"RMS, {unit}" in screen.getvalue()
    assert "nan" not in screen.getvalue()


@EVERY
def test_tables_in_python_have_a_column_for_each_channel(name: str) -> None:
    cal = Calibration(saved_of(name), found(name))
    for key in KEYS[name]:
        quantity, _, unit = key.rpartition("_")
        assert cal.errors.loc[("final", "test"), f"{quantity}_rms_{unit}"] > 0.0
    assert not cal.parameters.index.str.startswith(("eye.", "board.", "w0.")).any()
    assert KEYS[name][0].rpartition("_")[0] in repr(cal)


@pytest.mark.parametrize("name", ["inclination", "mixed", "targets"])
def test_the_report_has_all_sections_and_nothing_is_missing_or_not_a_number(name: str) -> None:
    assert written(name)[1] == ()
    report = drawn(name)
    sections = html.fromstring(report).xpath("//section/@id")
    assert sections == [
        "data",
        "separable",
        "enough",
        "fits",
        "depends",
        "remains",
        "iso",
        "instruments",
        "parameters",
        "use",
    ]
    assert not re.search(r"\bnan\b|\binf\b", text(report))
    assert "Consistency is not accuracy" in text(report, '//section[@id="instruments"]')
    ids = html.fromstring(report).xpath("//@id")
    assert len(ids) == len(set(ids))


@pytest.mark.parametrize("name", list(ROLES))
def test_every_thing_stands_in_the_report_with_its_rows_and_its_own_residual(name: str) -> None:
    outcome = found(name)
    m = outcome.measurements
    first = {b: outcome.channels[k] for b, k in enumerate(leading(m))}
    for b, block in enumerate(m.blocks):
        for k, role in enumerate(MEASUREMENT_KINDS[block.kind].roles):
            lines = {
                line[0].text_content(): [cell.text_content() for cell in line]
                for line in html.fromstring(join(list(instruments(outcome)))).xpath(
                    f'//table[starts-with(caption, "{role.name.capitalize()}s ")]/tbody/tr'
                )
            }
            for label in np.unique(m.labels.refers[m.labels.block == b, k]).tolist():
                own = (m.labels.block == b) & (m.labels.refers[:, k] == label)
                part = columns(outcome.channels)[leading(m)[b]]
                left = np.linalg.norm(outcome.stages[-1].residual[own & ~outcome.outlier][:, part], axis=1)
                *_, rows, flagged, rms = lines[label]
                assert int(rows) == own.sum()
                assert int(flagged) == (own & outcome.outlier).sum()
                assert float(rms) == pytest.approx(first[b].scale * np.sqrt(np.mean(left**2)), rel=5e-3)


def test_outliers_are_counted_by_block_and_by_thing() -> None:
    outcome = found("mixed")
    wild = outcome.outlier.copy()
    wild[[3, 150, 151]] = True  # one at a point, two of anchors
    flagged = replace(outcome, outlier=wild)
    report = join([*data(flagged), *instruments(flagged)])
    lines = html.fromstring(report).xpath('//table[starts-with(caption, "Rows of each block")]/tbody/tr')
    assert [line[5].text_content() for line in lines] == ["1", "2", "0"]
    points = html.fromstring(report).xpath('//table[starts-with(caption, "Points ")]/tbody/tr')
    label = outcome.measurements.labels.refers[3, 0]
    assert [row[5].text_content() for row in points if row[0].text_content() == label] == ["1"]


def test_what_was_not_repeated_is_said_in_words_of_the_kind() -> None:
    assert "Nothing was measured twice at one configuration, so" in join(list(data(found("distance"))))
    assert "(several marks in one image repeat nothing: a second image there would)" in join(
        list(data(found("pixels")))
    )


def test_every_kind_of_instrument_says_what_it_cannot_tell_and_what_would() -> None:
    assert set(BLIND) == set(MORE) == set(MEASUREMENT_KINDS) - {"pose", "position", "camera_sonar"}
    assert "a known distance from another" in section("loose")
    assert "a longer known length" in section("point")
    assert "directions of gravity tell no place" in section("inclination")


def test_the_page_shows_in_a_browser_without_a_word_of_complaint(browser: chromium.Browser, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(drawn("mixed"), encoding="utf-8")
    with browser.open(tmp_path / "report.html", 390, 800) as opened:
        assert not opened.evaluate("document.documentElement.scrollWidth > innerWidth")  # tables scroll by themselves
        assert opened.console == opened.requests == []
