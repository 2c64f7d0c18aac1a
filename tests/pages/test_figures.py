"""Figures: what is drawn stands where its values say, and one colour means one size in all figures that are compared."""

from __future__ import annotations

import re

import numpy as np
import pytest
from lxml import etree
from markupsafe import Markup

from aridcal.pages.drawing.drawn_rows import MOST_DRAWN, SOUND_DRAWN, drawn_rows
from aridcal.pages.drawing.fields import LEVELS, SQUARES_A_SIDE, color_steps, field
from aridcal.pages.drawing.figures import (
    COLOURS,
    Trend,
    banded_curves,
    correlogram,
    coverage,
    curve,
    falling,
    histogram,
    panels,
)
from aridcal.pages.drawing.html import collect_notices
from aridcal.pages.drawing.plot import Area, LegendEntry, Scale, along, legend, scale, tick_texts
from aridcal.pages.drawing.timelines import TimeStretch, sparkline, timeline

RNG = np.random.default_rng(0)
HOSTILE = """<b onclick="x">&'"""

AREA = Area(50.0, 20.0, 200.0, 100.0, Scale(-3.0, 5.0), Scale(0.0, 0.02))


def numbers(d: str) -> np.ndarray:
    """Places in a path's data, shape (n, 2)."""
    return np.array(re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", d), dtype=float).reshape(-1, 2)


def svg(drawn: Markup) -> etree._Element:
    return etree.fromstring(drawn.encode())


def dots_of(drawn: Markup, color: str) -> np.ndarray:
    """Where dots of a colour are, shape (n, 2)."""
    found = [p for p in svg(drawn).iter("path") if p.get("stroke") == color and p.get("stroke-linecap") == "round"]
    return numbers("".join(p.get("d") for p in found))


def ticks(drawn: Markup) -> tuple[dict[float, float], dict[float, float]]:
    """Places of the numbers of both axes, by their value."""
    words = [t for t in svg(drawn).iter("text") if re.fullmatch(r"[−\d.,e]+", t.text or "")]
    value = {t: float((t.text or "").replace("−", "-").replace(",", "")) for t in words}
    across = {value[t]: float(t.get("x")) for t in words if t.get("text-anchor") == "middle"}
    return across, {value[t]: float(t.get("y")) - 3.5 for t in words if t.get("text-anchor") == "end"}


# ---- axes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1e-12, 3e-5, 0.02, 1.0, 47.0, 8e3, 2e6, 5e11])
@pytest.mark.parametrize("middle", [0.0, 0.3, -7.0])
def test_ticks_are_few_round_inside_and_told_apart(size: float, middle: float) -> None:
    ends = Scale((middle - 0.5) * size, (middle + 0.5) * size)
    at, said = ends.ticks(6)
    assert 2 <= len(at) <= 7
    assert len(set(said)) == len(said)
    assert (at >= ends.low - 1e-6 * size).all() and (at <= ends.high + 1e-6 * size).all()
    read = [float(word.replace("−", "-").replace(",", "")) for word in said]
    np.testing.assert_allclose(read, at, atol=1e-6 * size)


@pytest.mark.parametrize("span", [1.001, 1.05, 2.0, 30.0, 1e4, 1e9])
def test_logarithmic_ticks_are_few_inside_and_told_apart(span: float) -> None:
    ends = Scale(0.013, 0.013 * span, log=True)
    at, said = ends.ticks(6)
    assert 2 <= len(at) <= 7 and len(set(said)) == len(said)
    assert (at >= ends.low * (1 - 1e-6)).all() and (at <= ends.high * (1 + 1e-6)).all()
    np.testing.assert_allclose([float(word.replace("−", "-")) for word in said], at, rtol=5e-3)


def test_one_value_and_none_at_all_have_a_scale() -> None:
    for value in (0.0, 1e-300, -4.0, 1e12):
        ends = scale(np.array([value, value]), 0.05)
        assert ends.low < value < ends.high
    assert tick_texts(np.array([0.0]), 1.0) == ["0"]


def test_a_line_breaks_where_values_are_missing() -> None:
    u = np.array([0.0, 1.0, np.nan, 3.0, 4.0, np.inf])
    assert along(u, np.zeros(6)) == "M0.0 0.0L1.0 0.0M3.0 0.0L4.0 0.0"
    assert along(np.full(3, np.nan), np.zeros(3)) == ""


def test_a_legend_takes_as_many_lines_as_it_needs() -> None:
    entries = [LegendEntry("a name of some length", "red") for _ in range(4)]
    one, high = legend(entries[:1], 0.0, 310.0)
    four, higher = legend(entries, 0.0, 310.0)
    assert one.count("<circle") == 1 and four.count("<circle") == 4
    assert high < higher <= 4 * high
    assert legend([], 0.0, 310.0) == ("", 0.0)


# ---- what is drawn stands where it says ----------------------------------------------------------------------------


def test_dots_stand_where_the_ticks_say() -> None:
    x, y = np.arange(40.0), RNG.normal(0, 2e-3, 40)
    drawn = panels("k", "alt", x, {"now": y}, ("row", "x [mm]"))
    across, down = ticks(drawn)
    places = dots_of(drawn, "#0072B2")
    assert len(places) == 40 and len(across) > 2 and len(down) > 2
    for column, value, of in ((0, x, across), (1, y, down)):
        slope, start = np.polyfit(list(of), list(of.values()), 1)
        np.testing.assert_allclose(places[:, column], start + slope * value, atol=0.15)


def test_of_two_panels_the_second_has_the_axis_of_the_first() -> None:
    """Or the noise that is left would look as large as what was there before."""
    x = np.arange(30.0)
    before, after = 5.0 * np.sin(x), 0.5 * np.sin(x)
    drawn = panels("k", "alt", x, {"before": before, "after": after}, ("row", "x [mm]"))
    spans = [np.ptp(dots_of(drawn, color)[:, 1]) for color in ("#D55E00", "#0072B2")]
    assert spans[0] == pytest.approx(10 * spans[1], abs=1.0)  # ten times what places are rounded to


def test_wild_points_are_cut_off_at_the_panel() -> None:
    x = np.linspace(0, 1, 200)
    y = np.where(np.arange(200) == 7, 1e3, np.sin(9 * x))
    t = Trend(x[::20], np.sin(9 * x[::20]), np.full(10, 0.1), x, np.sin(9 * x))
    root = svg(panels("joint-3", "alt", x, {"now": y}, ("q", "e"), {"now": t}))
    (clip,) = root.iter("clipPath")
    (group,) = (g for g in root.iter("g") if g.get("clip-path"))
    assert clip.get("id") == "joint-3-0" and group.get("clip-path") == "url(#joint-3-0)"
    box = {name: float(value) for name, value in clip[0].items()}
    line = max((numbers(p.get("d")) for p in group.iter("path") if not p.get("stroke-linecap")), key=len)
    assert (line[:, 1] > box["y"]).all() and (line[:, 1] < box["y"] + box["height"]).all()


def test_histograms_show_shares_of_each_and_count_the_wild_in_the_last_bin() -> None:
    values = {"before": np.r_[np.full(30, 0.5), np.full(10, 1.0)], "after": np.r_[np.full(99, 0.1), 50.0]}
    drawn = histogram("k", "alt", values, "error [mm]")
    _, down = ticks(drawn)
    slope, start = np.polyfit(list(down.values()), list(down), 1)
    tops = []
    for p in svg(drawn).iter("path"):
        if p.get("stroke-width") == "1.4":
            tops.append(start + slope * numbers(p.get("d"))[:, 1].min())
    np.testing.assert_allclose(tops, [75.0, 99.0], atol=1.0)


def test_curves_and_their_bands_stand_where_the_ticks_say() -> None:
    at = np.array([10.0, 20.0, 50.0, 80.0])
    value = np.array([4.0, 2.0, np.nan, 1.0])
    drawn = banded_curves(
        "k", "alt", at, {"one": np.column_stack([value, value - 0.5, value + 0.5])}, ("rows", "x [mm]"), None
    )
    across, down = ticks(drawn)
    there = np.isfinite(value)
    (shape,) = (p for p in svg(drawn).iter("path") if p.get("fill") == COLOURS[0])
    edge = numbers(shape.get("d"))
    for column, of, wanted in ((0, across, at[there]), (1, down, value[there])):
        slope, start = np.polyfit(list(of), list(of.values()), 1)
        np.testing.assert_allclose(dots_of(drawn, COLOURS[0])[:, column], start + slope * wanted, atol=0.15)
        upper = wanted if column == 0 else wanted + 0.5
        np.testing.assert_allclose(edge[3:, column], start + slope * upper[::-1], atol=0.15)


@pytest.mark.parametrize("days", [3.0, 40.0, 800.0])
def test_times_are_named_by_months_or_days_and_a_change_is_marked_between_its_ends(days: float) -> None:
    day = 19_000.0 + np.linspace(0.0, days, 9)
    value = np.linspace(-1.0, 1.0, 9)
    marked = TimeStretch(day[2], day[5], HOSTILE)
    drawn = timeline("k", "alt", day, value, np.full(9, 0.1), "zero [mrad]", [marked])
    dated = [t for t in svg(drawn).iter("text") if re.fullmatch(r"\d{4}-\d{2}(-\d{2})?", t.text or "")]
    assert 1 <= len(dated) <= 5
    places = dots_of(drawn, "#0072B2")
    slope, start = np.polyfit(day, places[:, 0], 1)
    for word in dated:
        at = np.datetime64(word.text).astype("datetime64[D]").astype(float)
        assert float(word.get("x")) == pytest.approx(start + slope * at, abs=0.15)
    assert not drawn.count("is not drawn")
    (title,) = svg(drawn).iter("title")
    assert title.text == HOSTILE
    box = numbers(title.getnext().get("d"))
    assert (box[:, 0].min(), box[:, 0].max()) == pytest.approx((places[2, 0], places[5, 0]), abs=0.15)


def test_a_line_in_a_cell_ends_in_its_last_value() -> None:
    drawn = sparkline(np.array([1.0, np.nan, 3.0, 2.0, np.nan]), "alt")
    (end,) = dots_of(drawn, "#0072B2")
    np.testing.assert_allclose(end, [4 + 112 * 3 / 4, 12.0], atol=0.05)
    assert "–" in sparkline(np.full(3, np.nan), "alt")


def test_every_joint_has_its_line_and_its_limits() -> None:
    names = ["shoulder", "a_joint_with_a_very_long_name", HOSTILE]
    drawn = coverage("k", "alt", names, [RNG.random(50), np.zeros(5), np.zeros(0)], ["0 to 1 m", "0° … 90°", "−1"])
    words = [t.text for t in svg(drawn).iter("text")]
    assert {
        "shoulder",
        "a_joint_with_a_very…",
        HOSTILE[:19] + "…" if len(HOSTILE) > 20 else HOSTILE,
        "0° … 90°",
    } <= set(words)


def test_hostile_words_stay_words_in_every_figure() -> None:
    x = np.linspace(0.0, 1.0, 20)
    t = Trend(x, x, x + 1, x, x)
    two = {HOSTILE: x, "b": x}
    with collect_notices() as notices:
        drawn = [
            histogram("a", HOSTILE, two, HOSTILE),
            panels("b", HOSTILE, x, two, (HOSTILE, HOSTILE), {HOSTILE: t, "b": t}),
            correlogram("c", HOSTILE, np.arange(1, 21), x, 0.1, HOSTILE),
            field(
                "d",
                HOSTILE,
                RNG.random((20, 2)),
                x,
                (HOSTILE, HOSTILE),
                HOSTILE,
                color_steps(x),
                marks={HOSTILE: np.eye(2)},
            ),
            falling("e", HOSTILE, x, {HOSTILE: x + 1}, (HOSTILE, HOSTILE)),
            curve("f", HOSTILE, x, x, x, (x, x), (HOSTILE, HOSTILE), winding=True),
            banded_curves("g", HOSTILE, x, {HOSTILE: np.column_stack([x, x, x])}, (HOSTILE, HOSTILE), None),
            timeline("h", HOSTILE, x, x, x, HOSTILE),
        ]
    assert notices == []
    for each in drawn:
        root = svg(each)
        assert root.get("aria-label") == HOSTILE
        assert HOSTILE in [word.text for word in root.iter("text")]
        assert not list(root.iter("b"))


def test_a_figure_of_nothing_is_a_line_in_its_place() -> None:
    with collect_notices() as notices:
        drawn = histogram("k", "alt", {"a": np.zeros(0), "b": np.zeros(0)}, "x")
    assert len(notices) == 1 and "the figure 'k'" in notices[0] and 'class="missing"' in drawn


# ---- one colour scale ------------------------------------------------------------------------------------------------


def colors_of(drawn: Markup) -> dict[str, int]:
    """How many dots each colour has."""
    return {color: len(dots_of(drawn, color)) for color in LEVELS}


def test_figures_that_are_compared_have_one_scale_and_one_size_one_colour() -> None:
    points = np.column_stack([np.arange(30.0) * 3, np.arange(30.0) % 7 * 3])
    small, large = np.full(30, 0.04), np.full(30, 0.4)
    steps = color_steps(np.concatenate([small, large]))
    drawn = [field("k", "alt", points, v, ("x", "y"), "mm", steps) for v in (small, large)]
    first, second = (colors_of(each) for each in drawn)
    assert first == {LEVELS[0]: 30} | dict.fromkeys(LEVELS[1:], 0)  # alone, each would have had all colours
    assert second == dict.fromkeys(LEVELS[:-1], 0) | {LEVELS[-1]: 30}
    words = [[t.text for t in svg(each).iter("text")] for each in drawn]
    assert words[0] == words[1]


def test_noise_has_about_one_colour_and_a_bad_corner_another() -> None:
    """Steps of equally many values showed noise in all colours."""
    points = RNG.uniform(0.0, 1.0, (20_000, 2))
    noise = np.linalg.norm(RNG.normal(0.0, 0.05, (20_000, 3)), axis=1)
    steps = color_steps(noise)
    found = colors_of(field("k", "alt", points, noise, ("x", "y"), "mm", steps))
    assert max(found.values()) > 0.8 * sum(found.values())
    corner = (points > 0.8).all(axis=1)
    worse = np.where(corner, 4.0 * noise, noise)
    found = colors_of(field("k", "alt", points, worse, ("x", "y"), "mm", color_steps(worse)))
    assert 0.5 * corner.mean() * sum(found.values()) < found[LEVELS[3]] + found[LEVELS[4]]


@pytest.mark.parametrize("values", [np.zeros(5), np.full(5, 3e-9), np.r_[np.ones(99), 1e6], np.linspace(0, 1, 11)])
def test_steps_begin_at_zero_rise_and_reach_the_largest(values: np.ndarray) -> None:
    steps = color_steps(values)
    assert steps[0] == 0.0 and (np.diff(steps) > 0).all() and steps[-1] >= values.max()
    assert len(steps) == len(LEVELS) + 1
    assert np.percentile(values, 94) <= 5 * steps[1] * (1 + 1e-9)


def test_a_dot_of_a_field_has_the_colour_of_its_rms_and_a_hole_where_nothing_was_measured() -> None:
    points = np.array([[0.0, 0.0], [0.0, 0.0], [50.0, 0.0], [100.0, 80.0]])
    values = np.array([0.1, 0.7, 0.5, 0.05])  # RMS of the first two: 0.5
    steps = np.array([0.0, 0.2, 0.45, 0.6, 0.8, 1.0])
    drawn = field("k", "alt", points, values, ("x", "y"), "mm", steps, hollow=np.array([True, True, False, False]))
    assert colors_of(drawn) == {LEVELS[0]: 1, LEVELS[1]: 0, LEVELS[2]: 2, LEVELS[3]: 0, LEVELS[4]: 0}
    (hole,) = dots_of(drawn, "white")
    assert np.abs(dots_of(drawn, LEVELS[2]) - hole).sum(axis=1).min() < 0.11


def test_a_field_is_as_long_to_the_right_as_upwards() -> None:
    points = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]])
    drawn = field("k", "alt", points, np.full(3, 0.5), ("x", "y"), "mm", np.arange(6.0))
    places = dots_of(drawn, LEVELS[0])
    assert np.ptp(places[:, 0]) == pytest.approx(2 * np.ptp(places[:, 1]), abs=0.3)


def test_squares_of_a_field_are_those_of_pairs() -> None:
    """Each square has one number; the slow road sorts pairs."""
    for k in range(20):
        points = RNG.normal(size=(500, 2)) * [1.0, 10.0 ** (k / 5 - 2)] + 5.0 * RNG.normal(size=2)
        side = float(np.ptp(points, axis=0).max()) / SQUARES_A_SIDE
        squares = np.unique(np.floor(points / side), axis=0)
        drawn = colors_of(field("k", "alt", points, np.ones(500), ("x", "y"), "mm", color_steps(np.ones(500))))
        assert sum(drawn.values()) == len(squares)


@pytest.mark.parametrize(
    ("rows", "flagged", "said"),
    [
        (5_000, 10, ""),
        (5_001, 0, "2,501 of 5,001 rows drawn, every 2nd"),
        (1_000_000, 0, "5,000 of 1,000,000 rows drawn, every 200th"),
        (1_000_000, 1, "4,977 of 1,000,000 rows drawn: every flagged one (1), every 201st of the others"),
        (60_000, 2_000, "4,900 of 60,000 rows drawn: every flagged one (2,000), every 20th of the others"),
        (60_000, 5_000, "6,000 of 60,000 rows drawn: every flagged one (5,000), every 55th of the others"),
        (60_000, 20_000, "6,000 of 60,000 rows drawn: every 4th of 20,000 flagged ones, every 40th of the others"),
        (5_100, 5_100, "2,550 of 5,100 rows drawn: every 2nd of 5,100 flagged ones"),
    ],
)
def test_of_too_many_rows_the_flagged_ones_stay(rows: int, flagged: int, said: str) -> None:
    """A gross outlier among a million rows is what somebody looks for: it must not fall between every 200th."""
    odd = np.zeros(rows, dtype=bool)
    odd[RNG.choice(rows, flagged, replace=False)] = True
    drawn, words = drawn_rows(odd)
    assert words == said
    assert (np.diff(drawn) > 0).all() and len(drawn) <= MOST_DRAWN + SOUND_DRAWN
    assert flagged > MOST_DRAWN or odd[drawn].sum() == flagged
    steps = np.diff(np.flatnonzero(np.isin(np.flatnonzero(~odd), drawn)))
    assert len(np.unique(steps)) <= 1  # the others evenly
    assert not words or words.startswith(f"{len(drawn):,} of {rows:,} rows drawn")
