"""`aridcal compare`: false alarms as stated, what changed is named, and what nobody can tell is no change."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import calibrated
import numpy as np
import pytest
import robots
from calibrated import NOISE, Machine, jump, machine
from scipy.stats import kstest

from aridcal.__main__ import main
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.least_squares import fit_identifiable
from aridcal.engine.fit.stages import recentred
from aridcal.engine.model.model import Model
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.history.changes import causes
from aridcal.jobs.history.comparison import compare, lines
from aridcal.jobs.history.difference import Difference, difference
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.system.errors import AridcalError

NAMES = robots.ur10().readings


def calibration(
    m: Machine,
    seed: int,
    kind: str = "pose",
    n: int = 60,
    offset: np.ndarray | float = 0.0,
    change: dict[str, float] | None = None,
    order: slice = slice(None),
    share: float = 0.6,
    noise: float = NOISE,
    without: tuple[str, ...] = (),
) -> SavedModel:
    """A machine calibrated once more, by a tracker and with a target that stand elsewhere.

    Args:
        m: The machine.
        seed: Of the rows and of where tracker and target stand.
        kind: Of the rows.
        n: How many.
        offset: Of the joints from their readings.
        change: What changed of the machine, by coefficient.
        order: In which constants are preferred where rows tell them only together.
        share: Of the joints' ranges.
        noise: Of the rows.
        without: Coefficients that the model lacks.
    """
    rng = np.random.default_rng([3, seed])
    placed = ((None, robots.random_placement(rng)),), ((None, robots.random_placement(rng, 0.3)),)
    model = replace(m.model, world_base=placed[0], tip_target=placed[1])
    theta = m.theta + np.array([(change or {}).get(name, 0.0) for name in model.names])
    q = robots.readings(model.robot, n, rng, share)
    rows = calibrated.measured(model, theta, q, q + offset, noise, rng, kind)
    rows = robots.declared(rows, noise, noise)
    model = model.with_coefficients([c for c in model.coefficients if c.name not in without])
    preferred = list(range(12)) + list(range(12, len(model.coefficients)))[order]
    fit = recentred(fit_identifiable(robots.problem(model, rows), preferred))
    solved = SolvedModel(fit.model, fit.theta, fit.covariance)
    ranges = {name: (float(v.min()), float(v.max())) for name, v in zip(model.robot.readings, q.T, strict=True)}
    return SavedModel(solved, solved, kind, (0.0, 0.0, -9.81), (noise, noise), ranges, {"data": {"train": n}})


@cache
def as_it_was(seed: int, kind: str) -> Machine:
    """Of three machines of each kind."""
    return machine(seed, kind, 60)


@cache
def pair_of_one(seed: int, kind: str = "pose") -> tuple[SavedModel, SavedModel]:
    """Two calibrations of a robot that did not change."""
    return pair(seed, kind)


def pair(seed: int, kind: str = "pose", **second: object) -> tuple[SavedModel, SavedModel]:
    m = as_it_was(seed % 3, kind)
    return calibration(m, 2 * seed, kind), calibration(m, 2 * seed + 1, kind, **second)


# -- nothing changed


def test_of_robots_that_did_not_change_as_many_are_said_to_have_as_is_stated() -> None:
    """The p-value is uniform, though tracker and target stood metres and radians elsewhere."""
    p_values = [difference(*pair_of_one(seed, kind)).p_value for kind in ("pose", "position") for seed in range(12)]
    assert kstest(p_values, "uniform").pvalue > 0.01
    assert np.sum(np.array(p_values) < FALSE_ALARMS) <= 2


def test_the_squares_are_those_of_the_coefficients_by_the_covariance_of_both() -> None:
    """By a second road: of two in one gauge, frames left out of both, no poses are needed."""
    for seed in range(4):
        a, b = pair_of_one(seed)
        names = [c.name for c in a.final.model.coefficients]
        assert names == [c.name for c in b.final.model.coefficients]
        arm = np.flatnonzero([c.where not in ("world_base", "tip_target") for c in a.final.model.coefficients])
        apart = (b.final.theta - a.final.theta)[arm]
        covariance = (a.final.covariance + b.final.covariance)[np.ix_(arm, arm)]
        found = difference(a, b)
        assert len(found.z) == len(arm)
        assert found.z @ found.z == pytest.approx(apart @ np.linalg.solve(covariance, apart), rel=0.02)


def test_constants_in_another_gauge_are_no_change() -> None:
    """The later calibration kept other constants of those that stand for one another: names and values differ, poses do not."""
    for seed in range(4):
        a, b = pair(seed, order=slice(None, None, -1))
        own = [{c.name for c in solved.final.model.coefficients} for solved in (a, b)]
        assert len(own[0] - own[1]) >= 4
        assert not difference(a, b).changed
    a, b = pair(5, order=slice(None, None, -1), offset=jump(2, 3e-4))
    assert lines(compare(a, b))[2].startswith(f"changed: the zero of {NAMES[2]} by +0.")


def test_a_zero_that_looks_like_a_base_set_up_anew_is_no_change_and_is_said_not_to_be_told() -> None:
    found = compare(*pair(1, offset=jump(0, 0.02)))
    assert not found.changed
    assert lines(found)[-1] == f"not told from that: the zeros of {NAMES[0]} and {NAMES[5]}"


def test_what_one_could_not_tell_is_no_change() -> None:
    """Positions in a corner of the range tell few of the constants; the others stayed nominal, and are a milliradian off."""
    m = machine(2, "position", 60)
    a = calibration(m, 50, "position")
    for seed, share in ((60, 0.04), (61, 0.04), (62, 0.02), (63, 0.02)):
        b = calibration(m, seed, "position", n=40, share=share)
        fewer = len(b.final.theta) < len(a.final.theta)
        for found in (difference(a, b), difference(b, a)):
            assert not found.changed
            assert any("could not tell" in notice for notice in found.notices) == fewer


# -- something did


@pytest.mark.parametrize("joint", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["pose", "position"])
def test_a_zero_that_moved_is_named_with_its_size(joint: int, kind: str) -> None:
    size = 6e-4 if kind == "pose" or joint < 4 else 2e-3
    found = compare(*pair(joint, kind, offset=jump(joint, size)))
    first, *others = found.causes.changes
    assert first.words == f"the zero of {NAMES[joint]}" or f"the zero of {NAMES[joint]}" in first.alike
    assert not others
    if first.words == f"the zero of {NAMES[joint]}":
        assert abs(first.value[0] - size) < 4 * first.std[0]
    assert found.causes.rest > FALSE_ALARMS


def test_a_zero_that_moved_far_is_found_though_nothing_is_linear_there() -> None:
    found = compare(*pair(2, offset=jump(3, 0.1)))
    (only,) = found.causes.changes
    assert only.words == f"the zero of {NAMES[3]}"
    assert only.value[0] == pytest.approx(0.1, abs=1e-4)


def test_two_changes_are_two_and_the_sizes_of_both_are_right() -> None:
    constant = f"{NAMES[1]}.z"
    found = compare(*pair(3, offset=jump(4, 4e-4), change={constant: 3e-4}))
    named = {cause.words: cause for cause in found.causes.changes}
    assert set(named) == {f"the zero of {NAMES[4]}", constant}
    assert named[constant].value[0] == pytest.approx(3e-4, abs=4 * named[constant].std[0])


def test_an_effect_that_one_lacks_counts_only_if_its_rows_would_have_shown_it() -> None:
    """0.1 mrad per sine: a good tracker sees it, one of ten times the noise and half the rows does not."""
    wave = Coefficient(NAMES[1], "axis", Basis("sin", (NAMES[1],), (2.0,)))
    m = machine(1, effects=((wave, 1e-4),))
    plain = replace(m, model=m.model.with_coefficients(m.model.coefficients[:-1]), theta=m.theta[:-1])
    a = calibration(m, 70)
    assert wave.name in a.final.model.names
    gone = compare(a, calibration(plain, 71))
    (cause,) = gone.causes.changes
    assert wave.name in cause.names
    assert cause.value[0] == pytest.approx(-1e-4, abs=4 * cause.std[0])
    coarse = calibration(m, 72, n=30, noise=10 * NOISE, without=(wave.name,))
    assert not difference(a, coarse).changed


def test_causes_of_nothing_are_none() -> None:
    found = difference(*pair_of_one(4))
    assert causes(found).changes == ()
    assert causes(found).rest == pytest.approx(found.p_value)


def test_the_stated_size_of_what_the_uncertainty_makes_is_that_of_repeated_calibrations() -> None:
    apart, expected = [], []
    for seed in range(8):
        found: Difference = difference(*pair_of_one(seed))
        apart.append(np.mean(found.apart[:, :3] ** 2))
        expected.append(np.mean(found.expected[:, :3] ** 2))
    assert np.sqrt(np.mean(apart) / np.mean(expected)) == pytest.approx(1.0, abs=0.3)


# -- the command


def folder(saved: SavedModel, path: Path) -> Path:
    path.mkdir()
    (path / "calibration.yaml").write_text(saved.dump())
    return path


def test_the_command_says_by_its_status_whether_something_changed(tmp_path: Path, capsys) -> None:
    m = machine(1)
    a, b = (folder(calibration(m, seed), tmp_path / f"{seed}") for seed in (80, 81))
    c = folder(calibration(m, 82, offset=jump(2, 5e-4)), tmp_path / "c")
    assert main(["compare", str(a), str(b)]) == 0
    assert capsys.readouterr().out.startswith("nothing changed beyond the uncertainty")
    assert main(["compare", str(a), str(c), "-o", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().out
    assert f"changed: the zero of {NAMES[2]} by +0." in said
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"compare.html", "compare.json"}
    found = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert found["changed"] is True
    (cause,) = found["causes"]
    (moved,) = cause["coefficients"]
    assert moved["change"] == pytest.approx(5e-4, abs=4 * moved["std"])
    by_name = {row["name"]: row for row in found["constants"]}
    assert by_name[f"{NAMES[1]}.z"]["p_value"] > 1e-3
    page = (tmp_path / "out" / "compare.html").read_text()
    assert "<h1>Changed</h1>" in page
    assert "report.html: the figure" not in page


def test_another_arm_and_ranges_apart_are_refused(tmp_path: Path, capsys) -> None:
    a = calibration(machine(1), 90)
    folder(a, tmp_path / "a")
    low, high = a.ranges[NAMES[3]]
    away = replace(a, ranges=a.ranges | {NAMES[3]: (high + 1.0, high + 2.0)})
    folder(away, tmp_path / "b")
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert f"{NAMES[3]}: one calibration saw it from {low:.4g} to {high:.4g}" in capsys.readouterr().err
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "nowhere")]) == 2
    strange = replace(a, final=replace(a.final, model=Model(robots.arid(), ()), theta=np.zeros(0)))
    with pytest.raises(AridcalError, match="not of the same arm"):
        difference(a, strange)


def test_the_same_rows_twice_are_said_to_be_so() -> None:
    a = calibration(machine(1), 91)
    a = replace(a, record={"data": {"sha256": "1234", "train": 60}})
    found = compare(a, a)
    assert not found.changed
    assert any("made from the same rows" in notice for notice in found.notices)


def test_the_face_has_the_verb_though_the_command_has_a_module_of_its_name(tmp_path: Path) -> None:
    import aridcal.compare
    import aridcal.history

    m = machine(1)
    a = calibration(m, 95)
    changes = aridcal.compare(
        folder(a, tmp_path / "a"), folder(calibration(m, 96, offset=jump(1, 5e-4)), tmp_path / "b")
    )
    assert changes.changed
    assert changes.causes["what"].tolist() == [f"the zero of {NAMES[1]}"]
    assert len(changes.constants) > 10
    assert repr(changes).startswith("changed: ")
    assert callable(aridcal.history)
