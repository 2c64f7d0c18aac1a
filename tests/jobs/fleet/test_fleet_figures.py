"""Who stands out of a fleet and what drifts: found where it is so, and as seldom as stated where it is not."""

from __future__ import annotations

import datetime
from typing import Any

import numpy as np
import pytest

from aridcal.jobs.fleet.drifts import chance_of, drifting, freedom_of
from aridcal.jobs.fleet.outliers import FEWEST_ROBOTS, outlying_robots, quantile_of_largest
from aridcal.jobs.fleet.runs import FleetResults
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.pages.fleet_page import fleet_page

START = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)

NAMES = ("joint_1.yaw", "joint_2.yaw", "joint_3.x")


def row(robot: str, rng: np.random.Generator, month: int = 0, scatter: float = 1.0, **more: Any) -> dict[str, Any]:
    """A run with errors that scatter by a tenth, and constants by their standard deviation times ``scatter``."""
    day = (START + datetime.timedelta(days=30 * month)).isoformat()
    stages = [
        {"stage": stage, "channel": "position_mm", "rows": 40}
        | dict.fromkeys(("mean", "median", "p95", "max"), size)
        | {"rms": size}
        for stage, usual in (("nominal", 3.0), ("geometric", 0.3), ("final", 0.2))
        for size in [usual * float(np.exp(0.1 * rng.standard_normal()))]
    ]
    constants = [
        {"name": name, "value": scatter * 1e-4 * float(rng.standard_normal()), "std": 1e-4, "nominal": 0.0}
        | {"unit": "m" if name.endswith("x") else "rad", "status": "identified"}
        for name in NAMES
    ]
    mounting = {"name": "world_base.x", "value": float(rng.normal()), "std": 1e-9, "unit": "m", "nominal": None}
    run = f"{robot} {month}"
    return {
        **{
            "robot": robot,
            "campaign": f"/{robot}/campaign.yaml",
            "key": run,
            "inputs": run,
            "urdf": "one",
            "time": day,
        },
        **{"measured": day, "version": "1", "status": "done", "error": None, "rows": 200, "verdict": "noise_floor"},
        **{"seconds": 1.0, "stages": stages, "effects": [], "notices": []},
        "constants": [*constants, mounting | {"status": "identified"}],
    } | more


@pytest.mark.parametrize("n", [8, 30])
def test_of_fleets_that_are_alike_one_in_a_hundred_has_a_robot_named(n: int) -> None:
    """Of 400 fleets 4 are expected; more than 11 come by chance once in a thousand times."""
    rng = np.random.default_rng(n)
    told = sum(bool(outlying_robots([row(f"r{k}", rng, scatter=30.0) for k in range(n)])[0]) for _ in range(400))
    assert told <= 11


def test_the_threshold_is_exceeded_as_often_as_it_says_also_where_it_is_extrapolated() -> None:
    """By draws of their own: for ten robots, and far out in the tail, where it may err to the safe side alone."""
    rng = np.random.default_rng(99)
    x = rng.standard_normal((200_000, 10))
    away = np.abs(x - np.median(x, axis=1, keepdims=True))
    largest = away.max(axis=1) / (1.4826 * np.median(away, axis=1))
    assert np.mean(largest > quantile_of_largest(10, 0.01)) == pytest.approx(0.01, abs=0.002)
    assert np.mean(largest > quantile_of_largest(10, 1e-4)) < 2e-4
    x = rng.standard_normal((40_000, 200))
    away = np.abs(x - np.median(x, axis=1, keepdims=True))
    largest = away.max(axis=1) / (1.4826 * np.median(away, axis=1))
    assert np.mean(largest > quantile_of_largest(200, 0.01 / 36)) < 0.01 / 36  # six errors and thirty constants


def test_a_robot_left_with_twice_the_error_and_one_with_another_constant_are_named_first() -> None:
    rng = np.random.default_rng(1)
    rows = [row(f"r{k:02d}", rng) for k in range(40)]
    for stage in rows[7]["stages"]:
        stage["rms"] *= 3.0
    rows[9]["constants"][1]["value"] = 5e-3
    found, numbers = outlying_robots(rows)
    assert numbers == 3 + len(NAMES)
    assert {out.robot for out in found} == {"r07", "r09"}
    assert (found[0].robot, found[0].what, found[0].unit) == ("r09", "joint_2.yaw", "rad")
    assert found[0].value == 5e-3
    errors = [out for out in found if out.robot == "r07"]
    assert {out.what for out in errors} == {"nominal position_mm", "geometric position_mm", "final position_mm"}
    assert all(out.value == pytest.approx(3 * out.usual, rel=0.5) for out in errors)


def test_half_of_the_robots_may_be_spoilt_and_few_or_others_are_not_compared() -> None:
    rng = np.random.default_rng(2)
    rows = [row(f"r{k:02d}", rng) for k in range(21)]
    for k in range(9):
        rows[k]["constants"][0]["value"] += 1.0 + k
    assert {out.robot for out in outlying_robots(rows)[0]} == {f"r{k:02d}" for k in range(9)}
    assert outlying_robots(rows[: FEWEST_ROBOTS - 1]) == ([], 0)
    mixed = [r | {"urdf": str(k % 3)} for k, r in enumerate(rows)]
    assert outlying_robots(mixed)[1] == 0
    assert outlying_robots([r | {"status": "failed"} for r in rows]) == ([], 0)
    two = [*rows, *(r | {"robot": f"s{k}", "urdf": "two"} for k, r in enumerate(rows[:3]))]
    assert {out.robot for out in outlying_robots(two)[0]} == {f"r{k:02d}" for k in range(9)}
    page = fleet_page(FleetResults(tuple(two), {r["robot"]: r for r in two}, (), {}, (), ""), "plant")
    assert "3 robots of makes (URDFs) with fewer than 8 robots were not compared" in page


def test_robots_that_are_all_the_same_to_the_last_digit_are_not_divided_by_nothing() -> None:
    rng = np.random.default_rng(3)
    same = row("a", rng)
    rows = [same | {"robot": f"r{k}"} for k in range(10)]
    assert outlying_robots(rows)[0] == []


def test_of_fleets_in_which_nothing_moves_one_in_a_hundred_is_told_of_a_drift() -> None:
    rng = np.random.default_rng(4)
    told = 0
    for _ in range(400):
        found, robots = drifting([row(f"r{k}", rng, month) for k in range(10) for month in (0, 1, 2)])
        assert (robots, len(found)) == (10, 10 * len(NAMES))
        told += any(drift.significant for drift in found)
    assert told <= 11
    assert FALSE_ALARMS == 0.01


@pytest.mark.parametrize("freedom", [12, 60])
def test_of_200_robots_of_30_constants_one_fleet_in_a_hundred_is_told_of_a_drift_also_with_few_rows(
    freedom: int,
) -> None:
    """Noise that each of the two runs knows from its own rows: 2,000 fleets, 20 expected; the largest constant of each decides.

    By normal numbers, as if the noise were known, far more fleets would be told of a drift.
    """
    rng = np.random.default_rng(freedom)
    robots, constants, fleets = 200, 30, 2000
    limit = FALSE_ALARMS / (robots * constants)
    told = as_if_known = 0
    for _ in range(fleets):
        variance = rng.chisquare(freedom, (2, robots)).mean(axis=0) / freedom
        largest = np.max(np.abs(rng.standard_normal((robots, constants))).max(axis=1) / np.sqrt(variance))
        told += chance_of(float(largest), 2 * freedom) < limit
        as_if_known += chance_of(float(largest), np.inf) < limit
    assert told <= 34
    assert as_if_known > 40


def test_degrees_of_freedom_are_those_of_the_fitted_rows_or_fewer() -> None:
    poses = row("a", np.random.default_rng(0))
    assert freedom_of(poses) == 3 * (200 - 40) - 4
    wires = [stage | {"channel": "distance_mm"} for stage in poses["stages"]]
    assert freedom_of(poses | {"stages": wires}) == 200 - 40 - 4
    assert freedom_of(poses | {"rows": 41}) == 1


def test_constants_are_compared_among_runs_and_robots_that_told_the_same_ones() -> None:
    """One constant less: what it stood for went to the others, by ten times their standard deviation."""
    rng = np.random.default_rng(8)

    def other_gauge(run: dict[str, Any]) -> dict[str, Any]:
        moved = [c | {"value": c["value"] + 1e-3} for c in run["constants"][1:]]
        return run | {"constants": [run["constants"][0] | {"status": "redundant", "std": None}, *moved]}

    first, second, third = (row("a", rng, month) for month in range(3))
    assert drifting([first, other_gauge(second)]) == ([], 0)
    found, robots = drifting([first, other_gauge(second), third])
    assert (robots, {drift.days for drift in found}) == (1, {60.0})
    rows = [row(f"r{k:02d}", rng) for k in range(30)]
    assert outlying_robots([*rows[:29], other_gauge(rows[29])])[0] == []


def test_a_constant_that_moves_is_first_with_its_days_and_frames_are_none() -> None:
    rng = np.random.default_rng(5)
    rows = [row(f"r{k}", rng, month) for k in range(10) for month in range(4)]
    next(r for r in rows if r["robot"] == "r3" and r["key"] == "r3 3")["constants"][2]["value"] += 2e-3
    found, _ = drifting(rows[::-1])  # whatever the order
    assert (found[0].robot, found[0].name, found[0].unit, found[0].days, found[0].significant) == (
        "r3",
        "joint_3.x",
        "m",
        90.0,
        True,
    )
    assert found[0].last[0] - found[0].first[0] == pytest.approx(2e-3, abs=6e-4)
    assert [drift.times for drift in found] == sorted((drift.times for drift in found), reverse=True)
    assert not any(drift.significant for drift in found[1:])


def test_the_same_rows_computed_twice_and_another_urdf_are_no_second_measurement() -> None:
    rng = np.random.default_rng(6)
    once = row("a", rng)
    again = row("a", rng, time=(START + datetime.timedelta(days=1)).isoformat(), key="newer version")
    assert again["inputs"] == once["inputs"]
    assert drifting([once, again]) == ([], 0)
    assert drifting([once, row("a", rng, 1, urdf="other")]) == ([], 0)


def test_the_page_names_who_stands_out_what_drifts_and_escapes_what_users_wrote() -> None:
    rng = np.random.default_rng(7)
    rows = [row(f"r{k}", rng, notices=["joint_1 never moves <b>"]) for k in range(12)]
    rows[4]["stages"][2]["rms"] = 9.0
    later = row("r5", rng, 3)
    later["constants"][0]["value"] = 0.01
    effect = {"effect": "joint_gain at joint_2", "kind": "joint_gain", "where": "joint_2", "name": "joint_2.axis:joint_2",
              "component": "axis", "value": 3e-4, "std": 1e-5, "unit": "rad", "p_value": 1e-9, "declared": False,
              "channel": "position_mm", "before": 0.4, "after": 0.2}  # fmt: skip
    rows[0]["effects"] = [effect]
    every = [*rows, later]
    now = {r["robot"]: r for r in every}
    page = fleet_page(
        FleetResults(tuple(every), now, (), {"<i>": "why & how"}, ("r99",), "the scheduler is gone"), "plant"
    )
    assert "is not drawn" not in page
    assert '<a href="r4/report.html">' in page
    assert "12 of 13 robots calibrated" in page
    assert "&lt;i&gt;" in page and "why &amp; how" in page and "r99" in page
    assert "final position_mm" in page.split("<h2>Robots that stand out")[1].split("<h2>Constants that drift")[0]
    assert "<strong>moved</strong>" in page.split("<h2>Constants that drift")[1].split("<h2>Effects across")[0]
    assert "50 %" in page.split("<h2>Effects across the fleet")[1]
    assert "joint_1 never moves &lt;b&gt; (11 robots)" in page
    assert page.index(">r4<", page.index("<h2>Every robot")) < page.index(">r3<", page.index("<h2>Every robot"))
