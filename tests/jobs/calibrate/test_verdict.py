"""The verdict: one decision, which no hostile row may turn into `noise_floor`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
from rich.console import Console
from scipy.stats import kstest

from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.search.noise_tests import Clue
from aridcal.identify import summary
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.verdict import NOISE_UNKNOWN, decide, row_clues
from aridcal.pages.report.first_screen import BELOW, NO_RELIABLE_MODEL
from aridcal.pages.report.first_screen import summary as first_screen
from aridcal.pages.report.trust_checks import checks

SIGMA = 1e-4
SOUND = 3
"""Seed of the campaign that several tests look at."""
STEP = Effect("joint_gain", "joint_1", (Coefficient("joint_1", "axis"),))
UNKNOWN = replace(STEP, kind="unknown")


def campaign(folder: Path, spoil: object = None, seed: int = SOUND, noise: float | None = None) -> Path:
    """The ARID with small geometric errors, 200 poses, every fifth held out; those may be spoiled."""
    truth = robots.simulate(robots.arid(), 200, np.random.default_rng(seed), noise=SIGMA)
    table = robots.table(truth).assign(split=np.where(np.arange(200) % 5 == 4, "test", "train"))
    if spoil is not None:
        table = spoil(table)  # type: ignore[operator]
    stated = {} if noise is None else {"noise": {"position": noise, "rotation": noise}}
    return robots.write_campaign(folder, truth, table, measurements={"file": "measurements.csv", **stated})


def shifted(by: float) -> object:
    """All held-out rows moved by so much along x, [m]."""

    def spoil(table: pd.DataFrame) -> pd.DataFrame:
        return table.assign(x=table["x"] + np.where(table["split"] == "test", by, 0.0))

    return spoil


def wild(table: pd.DataFrame) -> pd.DataFrame:
    """Three of the forty held-out rows are wrong by centimetres."""
    table = table.copy()
    table.loc[[4, 54, 154], ["x", "y"]] += 0.03
    return table


def said(outcome: Outcome) -> str:
    """Everything on the screen, on one line."""
    console = Console(record=True, width=500)
    summary(outcome, console)
    return console.export_text()


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return identify(campaign(tmp_path_factory.mktemp("sound")))


def test_a_sound_campaign_is_at_the_noise_floor_and_says_how_many_rows_are_flagged(sound: Outcome) -> None:
    outcome = sound
    assert (outcome.verdict.word, outcome.verdict.reasons) == ("noise_floor", (NOISE_UNKNOWN,))
    assert "0 of 40 held-out rows flagged as outliers" in said(outcome)
    assert any("0 of 40 held-out rows flagged" in words and good for good, words in checks(outcome))


@pytest.mark.parametrize("by", [5e-4, 5e-3])
def test_held_out_rows_that_are_shifted_are_never_noise(by: float, tmp_path: Path) -> None:
    """By half a millimetre they are not flagged, by five all of them are: neither may be overlooked."""
    outcome = identify(campaign(tmp_path, shifted(by)))
    assert outcome.verdict.word == "structure_remains"
    document = result_document(outcome)
    assert document["error"]["final"]["test_all"]["position_mm"]["rms"] == pytest.approx(1e3 * by, rel=0.1)
    assert document["reasons"] == list(outcome.verdict.reasons) != []
    flagged = 40 if by > 1e-3 else 0
    assert f"{flagged} of 40 held-out rows flagged as outliers" in said(outcome)
    assert "No rows were held out" not in str(list(checks(outcome)))
    shown = str([str(part) for part in first_screen(outcome)])
    assert ("Checked on 0" in shown, "<b>−" in shown) == (False, False)
    assert ("No correction lowers" in shown) == (by > 1e-3)
    assert all(reason in said(outcome) for reason in outcome.verdict.reasons)
    assert outcome.verdict.reasons[0] in str([str(part) for part in first_screen(outcome)])


def test_more_than_three_per_cent_of_flagged_held_out_rows_are_never_noise(tmp_path: Path) -> None:
    outcome = identify(campaign(tmp_path, wild))
    assert outcome.outlier[outcome.measurements.test].sum() == 3
    assert outcome.verdict.word == "structure_remains"
    assert any("3 of 40 held-out rows are flagged" in reason for reason in outcome.verdict.reasons)


def test_what_a_verdict_says_of_clean_held_out_rows_is_by_chance_alone(sound: Outcome, tmp_path: Path) -> None:
    """The F test of 4 campaigns: no smaller p-values than uniform, and no verdict turned."""
    chances, told = [], 0
    for seed in range(4):
        (tmp_path / str(seed)).mkdir()
        outcome = sound if seed == SOUND else identify(campaign(tmp_path / str(seed), seed=seed))
        clue = next(c for c in outcome.diagnosis.clues if c.question == "held_out")  # type: ignore[union-attr]
        chances.append(clue.p_value)
        told += outcome.verdict.word != "noise_floor"
    assert kstest(chances, "uniform", alternative="greater").pvalue > 1e-3
    assert told == 0


def test_a_constant_error_that_nothing_may_take_up_is_structure(tmp_path: Path) -> None:
    """Frames and constants held where the robot is not: the mean of the residuals is not zero."""
    truth = robots.simulate(robots.arid(), 200, np.random.default_rng(5), noise=SIGMA)
    off = robots.table(truth).assign(x=lambda t: t["x"] + 5e-4)
    path = robots.write_campaign(
        tmp_path, truth, off, parameters={"set": "none"}, effects=[{"kind": "joint_gain", "where": "joint_2"}],
        frames={"world_base": {"identify": False}, "tip_target": {"identify": False}}, diagnosis={"enabled": False},
    )  # fmt: skip
    outcome = identify(path)
    assert outcome.verdict.word == "structure_remains"


CLUES = {
    "nothing": Clue("order", "consecutive rows", 0.5, 0.2),
    "small": Clue("order", "consecutive rows", 0.01, 1e-9),
    "tells": Clue("order", "consecutive rows have similar residuals", 0.4, 1e-9),
    "flags": Clue("flags", "flagged rows lie together", 0.9, 0.0),
}


@pytest.mark.parametrize("clues", [(), ("nothing",), ("small",), ("tells",), ("nothing", "flags"), ("tells", "flags")])
@pytest.mark.parametrize("effects", [(), (STEP,), (STEP, UNKNOWN)])
@pytest.mark.parametrize("freedom", [0.3, 0.9])
def test_word_share_and_reasons_never_contradict_one_another(
    clues: tuple[str, ...], effects: tuple[Effect, ...], freedom: float
) -> None:
    found = decide([CLUES[name] for name in clues], effects, freedom, True)
    telling = [CLUES[name] for name in clues if name in ("tells", "flags")]
    assert (found.word == "noise_floor") == (found.reasons == ())
    assert (found.word == "not_enough_data") == (freedom < 0.5)
    assert (found.share > 0) == bool(telling)
    assert all(clue.what in found.reasons for clue in telling)
    assert any("no known cause" in reason for reason in found.reasons) == (UNKNOWN in effects)


@pytest.mark.parametrize(("noise", "words"), [(SIGMA, NO_RELIABLE_MODEL), (4e-4, BELOW.format("the declared noise"))])
def test_a_noise_above_what_remains_is_not_called_a_floor(noise: float, words: str, tmp_path: Path) -> None:
    """What was 0.329 mm now stood beside a noise that made 1.26 mm."""
    shown = "".join(str(part) for part in first_screen(identify(campaign(tmp_path, noise=noise))))
    assert words.strip() in shown
    assert (NO_RELIABLE_MODEL.strip() in shown) != (BELOW.format("the declared noise").strip() in shown)


def test_flagged_rows_of_one_place_are_said_with_that_place(sound: Outcome) -> None:
    m, last = sound.measurements, sound.stage("final")
    flags = np.zeros(len(m), dtype=bool)
    bad = m.as_read[60:70]
    flags[bad] = True
    residual = last.residual.copy()
    residual[bad] += 0.02
    clues = row_clues(m, last.fit, residual, flags)
    (together,) = [c for c in clues if "lie together" in c.what]
    assert together.tells
    assert "rows 61 to 70" in together.what
