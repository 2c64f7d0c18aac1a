"""The certificate as pages: one sheet of A4 in a browser and as PDF, nothing cut off, the same words in both."""

from __future__ import annotations

import base64
import re
from pathlib import Path
from typing import Any

import chromium
import numpy as np
import pypdfium2
import pytest
from lxml import html

from aridcal.pages.drawing import one_page
from aridcal.pages.drawing.one_page import MARGIN, POINTS_PER_MM, OnePage, Part, advance, as_html, as_pdf, wrapped

LONG, PARAGRAPH = 120, 500
"""Letters that a campaign may state."""

WORDS = {
    "wide": ("W" * LONG, "W" * PARAGRAPH),
    "markup": ('<script>alert("1")</script> $x^2$ &amp; ' * 3, "<b>\\frac{1}{0}</b> {x} %s " * 20),
    "cjk": ("校正機器人" * (LONG // 5), "温度二十度" * (PARAGRAPH // 5)),
    "umlauts": ("ÄÖÜ äöü ß É Ñ Ø Å " * 6, "Žluťoučký kůň Ελληνικά Русский " * 16),
}


def page(line: str = "x", paragraph: str = "y") -> OnePage:
    """As much as a certificate can say: every fact at its longest, 24 joints with long names, all ISO figures."""
    facts = [*((name, line) for name in ("Robot", "Serial number", "Measured by", "Measured on"))]
    facts += [
        ("Instrument", f"{line}, serial number {line}"),
        *((n, paragraph) for n in ("Environment", "Method", "Notes")),
    ]
    turns = "0.0695, 0.375, 1.09 mrad"
    iso = [(f"AP {k}", "orientation pose repeatability (7.2.2)", "15 pairs, fitted", turns, turns) for k in range(9)]
    joints = "; ".join(f"{'joint_' * 6}{k:04} −180° … 180°" for k in range(24))
    errors = [["", *["95 % below"] * 7], *[["Rotation error [mrad]", *["0.0837"] * 7]] * 4]
    places = [("Joints", joints), ("Gaps in them", joints[:400])]
    hashes = [("file", "sha256"), *[("measurements.csv (one after the other)", "6f00b073" * 8)] * 5]
    return OnePage(
        title="Calibration certificate",
        under="The maker's own record of a robot calibration. " * 3,
        headline=[
            ("Position error, RMS", "before 4.53, after 0.0837 mm"),
            ("Verdict", "A repeatable error remains that the model does not describe."),
        ],
        parts=[
            Part("Robot and measurement", facts=facts),
            Part("Errors", table=errors, words=["shortened reasons " * 33, "words " * 60]),
            Part("Where it is valid", facts=places, words=["Outside these ranges. " * 12]),
            Part("Figures", table=iso, words=["6 poses, 10 cycles of each. " * 5]),
            Part("Files", table=hashes),
        ],
        foot=f"No. {line}. Issued on 2026-11-22.",
        boxes="Boxes stand for characters.",
    )


def leaf(words: str, foot: str = "No. 1.") -> OnePage:
    """A page that says little."""
    return OnePage(
        title="Calibration certificate", under="", headline=[], parts=[Part("Robot", facts=[("Notes", words)])], foot=foot,
        boxes="",
    )  # fmt: skip


def squeezed(text: str) -> str:
    """Without blanks and hyphens of line ends: where lines break is free."""
    return re.sub(r"\s+", "", text)


def read(content: bytes) -> tuple[int, Any, str]:
    """Number of pages of a PDF, its first page, and all text of that."""
    document = pypdfium2.PdfDocument(content)
    text = document[0].get_textpage().get_text_range().replace("\ufffe", "").replace("\x02", "")
    return len(document), document[0], text


def root_text(made: OnePage) -> str:
    """What a reader of the HTML sees."""
    return "".join(html.fromstring(as_html(made)).xpath("//body")[0].itertext())


def words_in(part: Part) -> list[str]:
    """All that a part says."""
    return [part.heading, *(cell for row in (*part.facts, *part.table) for cell in row), *part.words]


def font_size(sheet: Any, words: str) -> float:
    """Size of the letters of the first place with some words, [pt]."""
    textpage = sheet.get_textpage()
    first, _ = textpage.search(words).get_next()
    return float(pypdfium2.raw.FPDFText_GetFontSize(textpage, first))


@pytest.mark.parametrize("which", WORDS)
def test_the_pdf_is_one_page_of_a4_with_every_word_inside_its_margins_and_the_verdict_as_large_as_the_figures(
    which: str, recwarn: pytest.WarningsRecorder
) -> None:
    made = page(*WORDS[which])
    content, lacking = as_pdf(made)
    assert not [w for w in recwarn if "missing from" in str(w.message)]  # of characters without a glyph
    count, sheet, text = read(content)
    assert count == 1
    assert sheet.get_size() == pytest.approx((210 * POINTS_PER_MM, 297 * POINTS_PER_MM), abs=0.1)
    readable = (words for part in made.parts for words in words_in(part) if set(words).isdisjoint(lacking))
    assert all(squeezed(words) in squeezed(text) for words in readable)
    textpage = sheet.get_textpage()
    boxes = np.array([textpage.get_charbox(k) for k in range(textpage.count_chars())])
    boxes = boxes[boxes[:, 2] > boxes[:, 0]]
    edge = MARGIN * POINTS_PER_MM - 1.0
    low, high = boxes.min(axis=0), boxes.max(axis=0)
    assert low[0] > edge and low[1] > edge
    assert high[2] < 210 * POINTS_PER_MM - edge and high[3] < 297 * POINTS_PER_MM - edge
    assert bool(lacking) == ("Boxes stand" in text) == (which == "cjk")
    sizes = {words: font_size(sheet, words) for words in ("A repeatable error", "before 4.53", "Robot and", "AP 3")}
    assert sizes["A repeatable error"] == sizes["before 4.53"] > 1.2 * sizes["Robot and"] > sizes["AP 3"]
    assert sizes["Robot and"] > 5.0  # [pt]: legible


@pytest.mark.parametrize("which", WORDS)
def test_the_html_is_printed_on_one_sheet_with_every_word(
    which: str, browser: chromium.Browser, tmp_path: Path
) -> None:
    made = page(*WORDS[which])
    path = tmp_path / "certificate.html"
    path.write_text(as_html(made), encoding="utf-8")
    with browser.open(path, 900, 1300) as opened:
        printed = base64.b64decode(opened.call("Page.printToPDF", preferCSSPageSize=True)["data"])
        assert opened.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert opened.evaluate(
            "[...document.querySelectorAll('dd,td,p')].every(e => e.scrollWidth <= e.clientWidth + 1)"
        )
        sizes = opened.evaluate("[...document.querySelectorAll('.headline dd')].map(e => getComputedStyle(e).fontSize)")
        assert len(set(sizes)) == 1  # the verdict is as large as the figures
        assert opened.console == [] and opened.requests == []
    count, sheet, text = read(printed)
    assert count == 1
    assert sheet.get_size() == pytest.approx((210 * POINTS_PER_MM, 297 * POINTS_PER_MM), abs=1.0)
    shown = root_text(made) if which == "cjk" else text  # without a font a browser prints boxes
    assert all(squeezed(words) in squeezed(shown) for part in made.parts for words in words_in(part))


def test_the_same_page_is_the_same_bytes() -> None:
    content, _ = as_pdf(leaf("x"))
    assert content == as_pdf(leaf("x"))[0] != as_pdf(leaf("x", "Issued on 2026-11-23."))[0]


def test_a_font_of_the_computer_is_taken_for_what_the_first_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    """U+210A is in STIX, which comes with matplotlib, and not in DejaVu Sans."""
    asked = leaf("\u210a")
    assert as_pdf(asked)[1] == "\u210a"
    monkeypatch.setattr(one_page, "OTHER_FONTS", ("No Such Font", "STIXGeneral"))
    content, lacking = as_pdf(asked)
    assert lacking == "" and "\u210a" in read(content)[2]


def test_lines_are_no_wider_than_they_may_be() -> None:
    fonts, rng = (one_page.FONT,), np.random.default_rng(0)
    for _ in range(50):
        words = ["".join(rng.choice(list("iWmäß-"), rng.integers(1, 30))) for _ in range(8)]
        width = float(rng.uniform(3, 20))
        made = wrapped(" ".join(words), width, False, fonts)
        assert squeezed("".join(made)) == "".join(words)
        assert all(sum(advance(c, False, fonts) for c in line) <= width + 1e-9 for line in made)
