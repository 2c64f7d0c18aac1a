"""Markup: nothing that a user wrote becomes markup, and numbers read as they should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lxml import html
from markupsafe import Markup

from aridcal.pages.drawing.html import bullets, join, table, tag
from aridcal.system.wording import fixed, number, plural, plus_minus

HOSTILE = """<img src=x onerror="alert('1')"> & </td><script>alert(1)</script>"""


def test_text_comes_back_as_it_was_written() -> None:
    page = join([tag("p", HOSTILE, title=HOSTILE), table([HOSTILE], [[HOSTILE]], HOSTILE), bullets([HOSTILE])])
    parsed = html.fragment_fromstring(page, create_parent="div")
    assert not list(parsed.iter("img", "script"))
    assert parsed.find("p").get("title") == HOSTILE
    shown = [element.text for element in parsed.iter("p", "caption", "th", "li")]
    assert shown == [HOSTILE] * 5


def test_markup_is_not_escaped_twice() -> None:
    assert tag("p", tag("b", "a & b")) == "<p><b>a &amp; b</b></p>"
    assert join(["<", Markup("<br>"), [tag("i", "x")]]) == "&lt;<br><i>x</i>"


def test_text_that_is_added_to_markup_is_escaped() -> None:
    assert tag("b", "x") + HOSTILE == tag("b", "x") + join(HOSTILE)
    assert not list(html.fragment_fromstring(tag("b", "x") + HOSTILE, create_parent="div").iter("img", "script"))


def test_attributes_that_are_none_are_left_out() -> None:
    assert tag("td", "1", class_=None, aria_label="one") == '<td aria-label="one">1</td>'


def test_a_long_list_says_how_many_it_leaves_out() -> None:
    parsed = html.fragment_fromstring(bullets((str(k) for k in range(100)), 25, "more"))
    items = [item.text_content() for item in parsed.iter("li")]
    assert items[:25] == [str(k) for k in range(25)]
    assert items[25:] == ["and 75 more"]


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [
        (0.42964, 3, "0.430"),
        (1234.5, 3, "1,234"),
        (-0.05, 2, "−0.050"),
        (0.0, 3, "0"),
        (5.67e-7, 2, "5.7e−07"),
        (math.nan, 3, "–"),
        (math.inf, 3, "–"),
    ],
)
def test_numbers_keep_their_significant_digits(value: float, digits: int, shown: str) -> None:
    assert number(value, digits) == shown


def test_numbers_read_back_within_their_digits() -> None:
    rng = np.random.default_rng(0)
    for value in 10 ** rng.uniform(-9, 9, 300):
        assert float(number(value).replace(",", "").replace("−", "-")) == pytest.approx(value, rel=5.1e-3)


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (1.26149, 0.0219, "1.261 ± 0.022"),
        (-0.341, 0.104, "−0.34 ± 0.10"),
        (1234.56, 25.0, "1,235 ± 25"),
        (-0.0004, 0.11, "0.00 ± 0.11"),
        (1.5, 0.0, "1.500"),
    ],
)
def test_a_value_has_the_digits_of_its_uncertainty(value: float, std: float, shown: str) -> None:
    assert plus_minus(value, std) == shown


def test_zero_has_no_sign() -> None:
    assert fixed(-0.00001, 3) == "0.000"
    assert fixed(-0.3, 0) == "0"


def test_one_thing_is_not_many() -> None:
    assert plural(1, "row") == "1 row"
    assert plural(1495, "row") == "1,495 rows"
