"""Pages as a reader opens them: headless Chromium without network, at phone and desk width, and on paper."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path

import chromium
import numpy as np
import pytest
import robots
import shot_campaigns
from scipy.spatial.transform import Rotation

from aridcal.identify import main as identify
from aridcal.pages.drawing.html import bullets, table, tag
from aridcal.pages.drawing.page_frame import card, framed_page, sections

LOUD = """(() => {
  const wide = (e) => e.getBoundingClientRect().right > innerWidth + 1 && !e.closest(".scroll, figure");
  return [...document.querySelectorAll("main *, header *")].filter(wide).map((e) => e.outerHTML.slice(0, 80));
})()"""


LETTERS = """Math.min(...[...document.querySelectorAll("svg text")].map((t) => {
  const shown = t.ownerSVGElement.getBoundingClientRect().width / t.ownerSVGElement.viewBox.baseVal.width;
  return shown * parseFloat(getComputedStyle(t).fontSize);
}))"""
"""Size of the smallest letters of a figure, [px]."""

BROKEN = r"""(() => {
  const found = [], range = document.createRange();
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    if (node.parentElement.closest("svg, thead, style") || !node.parentElement.offsetParent) continue;
    for (const word of node.data.matchAll(/[\p{L}\p{N}_.]+/gu)) {
      range.setStart(node, word.index);
      range.setEnd(node, word.index + word[0].length);
      if (new Set([...range.getClientRects()].map((r) => Math.round(r.top))).size > 1) found.push(word[0]);
    }
  }
  return found;
})()"""
"""Words that stand on two lines."""


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of a robot whose second joint has an error curve that nobody declared."""
    folder = tmp_path_factory.mktemp("pages")
    truth = robots.simulate(robots.arid(), 90, np.random.default_rng(2), noise=5e-5, which="doty")
    rows = robots.table(truth)
    model, q = truth.model, truth.readings.copy()
    q[:, 1] += 2e-3 * np.sin(2 * q[:, 1])
    R, p = model.poses(truth.theta, model.rows(q))
    rows[["x", "y", "z"]] = p + np.random.default_rng(3).normal(0, 5e-5, p.shape)
    turned = Rotation.from_rotvec(np.random.default_rng(4).normal(0, 5e-5, p.shape)).as_matrix() @ R
    rows[["qx", "qy", "qz", "qw"]] = Rotation.from_matrix(turned).as_quat()
    rows = rows.assign(time=30.0 * np.arange(90), temperature=20 + np.random.default_rng(5).normal(0, 1, 90))
    path = robots.write_campaign(folder, truth, rows, diagnosis={"enabled": True})
    assert identify([str(path), "--out", str(folder / "results")]) == 0
    return folder / "results"


def unfold(page: chromium.Page) -> None:
    page.evaluate("document.querySelectorAll('details').forEach((fold) => { fold.open = true; })")


@pytest.fixture(scope="module")
def opened(result: Path, browser: chromium.Browser) -> Iterator[chromium.Page]:
    with browser.open(result / "report.html", 1280, 900) as page:
        page.evaluate("(window.unfolded = [...document.querySelectorAll('details[open]')]).length")
        yield page


@pytest.fixture(params=[390, 1280])
def report(request: pytest.FixtureRequest, opened: chromium.Page) -> Iterator[chromium.Page]:
    """The report as it is when it was opened in a window of that width."""
    opened.resize(request.param, 900)
    opened.evaluate("document.querySelectorAll('details').forEach((e) => { e.open = window.unfolded.includes(e); })")
    opened.evaluate("scrollTo({top: 0, behavior: 'instant'})")
    yield opened
    assert opened.console == []
    assert opened.requests == []


def test_the_report_fits_the_window_and_can_be_read(report: chromium.Page) -> None:
    width = report.evaluate("innerWidth")
    tables = "[...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth + 1).length"
    for opened in (False, True):
        if opened:
            unfold(report)
        assert report.evaluate("document.documentElement.scrollWidth") <= width
        assert report.evaluate(LOUD) == []
        assert report.evaluate(tables) == 0  # nothing is cut off at the side
    assert report.evaluate(LETTERS) >= 11.0
    assert report.evaluate("document.querySelector('.now').getBoundingClientRect().bottom") < 500
    if width > 1000:  # on a desk the first screen answers all five questions
        assert report.evaluate("document.querySelector('.answers').getBoundingClientRect().bottom") < 900


def test_names_of_any_length_stay_within_a_phone(browser: chromium.Browser, tmp_path: Path) -> None:
    name = "joint_" + "x" * 150
    head = [tag("h1", name), tag("div", card(name, "mm", ("before", 1.0), ("after", 0.1), name), class_="cards")]
    rows = [[tag("code", name), name, "1.234 ± 0.001 mm", "1.2"] for _ in range(2)]
    content = [tag("p", tag("code", name)), table(["a", name, "b", "c"], rows, name, numbers=2), bullets([name])]
    (tmp_path / "page.html").write_text(framed_page(name, head, sections([(name, content), ("b", "")]), name))
    with browser.open(tmp_path / "page.html", 390, 800) as page:
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.evaluate(LOUD) == []
        assert page.evaluate(
            "document.querySelector('.scroll').scrollWidth <= document.querySelector('.scroll').clientWidth + 1"
        )


def test_links_lead_to_sections_and_to_files_that_are_there(report: chromium.Page, result: Path) -> None:
    found = "[...document.querySelectorAll('nav a')].every((a) => document.querySelector(a.getAttribute('href')))"
    assert report.evaluate(found)
    named = report.evaluate("[...document.querySelectorAll('a')].map((a) => a.getAttribute('href'))")
    files = {name for name in named if not name.startswith("#")}
    assert files >= {"calibrated.urdf", "calibration.yaml", "scene.html", "result.json", "joint_offsets.yaml"}
    assert all((result / name).is_file() for name in files)


def test_the_contents_stay_at_the_side_of_a_wide_screen(report: chromium.Page) -> None:
    wide = report.evaluate("innerWidth") > 1000
    report.evaluate("document.querySelector('main > section:last-child').scrollIntoView({behavior: 'instant'})")
    box = report.evaluate(
        "(() => {const b = document.querySelector('nav').getBoundingClientRect(); return [b.right, b.top, b.bottom]})()"
    )
    begins = report.evaluate("document.querySelector('main').getBoundingClientRect().left")
    in_sight = box[0] <= begins and box[1] >= 0 and box[2] <= 900
    assert in_sight == wide


def test_words_are_whole_on_a_phone(report: chromium.Page) -> None:
    unfold(report)
    assert report.evaluate(BROKEN) == []


def test_on_paper_the_report_keeps_its_order_and_width(result: Path, browser: chromium.Browser) -> None:
    with browser.open(result / "report.html", 718, 1000) as page:  # A4 less its margins, at 96 dots an inch
        page.call("Emulation.setEmulatedMedia", media="print")
        assert page.evaluate(LOUD) == []
        tables = "[...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth + 1).length"
        assert page.evaluate(tables) == 0  # paper does not scroll
        folded = "Math.min(...[...document.querySelectorAll('details')].map((e) => e.lastElementChild.offsetHeight))"
        assert page.evaluate(folded) > 0  # nor has it a click
        tops = page.evaluate(
            "[...document.querySelectorAll('main > section')].map((e) => e.getBoundingClientRect().top)"
        )
        assert tops == sorted(tops)
        assert page.evaluate("getComputedStyle(document.querySelector('nav')).display") == "none"
        made = base64.b64decode(page.call("Page.printToPDF", preferCSSPageSize=True)["data"])
        assert made.startswith(b"%PDF")
        assert 4 <= made.count(b"/Type /Page\n") <= 20
        assert len(made) < 2_000_000


def test_the_results_scene_opens_without_complaint(result: Path, browser: chromium.Browser) -> None:
    with browser.open(result / "scene.html", 1000, 700) as page:
        page.wait("document.documentElement.dataset.ready")
        assert page.evaluate("document.querySelectorAll('input[name=effect]').length") >= 1
        assert page.console == page.requests == []


def test_the_sheet_of_shots_opens_without_complaint(browser: chromium.Browser, tmp_path: Path) -> None:
    shots = shot_campaigns.Campaign(tmp_path, 2)
    assert shots.run() == 0
    with browser.open(tmp_path / "out" / "shots.html", 390, 900) as page:
        for width in (390, 1280):
            page.resize(width, 900)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate("document.images.length") == 2
        assert page.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
        assert page.console == page.requests == []
