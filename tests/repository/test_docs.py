"""The documents: every link leads somewhere, every effect has its picture, and the site builds."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import chromium
import numpy as np
import pytest
import yaml
from repository import ROOT

from aridcal.__main__ import COMMANDS
from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.files.campaign import Campaign

DOCS = ROOT / "docs"
PAGES = [
    *sorted(DOCS.rglob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(ROOT.glob("notebooks/*.ipynb")),
]


def made_by(script: str) -> ModuleType:
    """A script of the documents that makes one of the pages."""
    spec = spec_from_file_location(script, DOCS / f"{script}.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def text_of(page: Path) -> str:
    """A page's markdown without its blocks of code."""
    text = page.read_text("utf-8")
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    return re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as forges and the site make them."""
    titles = re.findall(r"^#+ (.*)$", text_of(page), re.MULTILINE)
    return {re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", title).strip().lower()) for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    wrong = []
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)]*)\)", re.sub(r"`[^`\n]*`", "", text_of(page))):
        if "://" in target:
            continue
        to = page.parent / target if target else page
        if not to.exists() or (anchor and anchor not in anchors(to)):
            wrong.append(f"{target}#{anchor}")
    assert wrong == []


def test_the_code_that_conventions_show_for_an_equation_is_there():
    text = (DOCS / "conventions.md").read_text("utf-8")
    named = set(re.findall(r"`((?:jobs\.head1992|engine\.instruments)\.\w+)\.(\w+)`", text))
    assert len(named) > 4
    assert [part for part in sorted(named) if not hasattr(import_module(f"aridcal.{part[0]}"), part[1])] == []
    tests = set(re.findall(r"test_\w+\.py", text))
    assert tests <= {path.name for path in (ROOT / "tests").rglob("test_*.py")}


def test_every_kind_of_effect_has_its_paragraph_and_its_picture():
    text = (DOCS / "effects.md").read_text("utf-8")
    of_instruments = [kind for kind in EFFECT_KINDS if EFFECT_KINDS[kind].doc == "of-instruments"]
    for kind in (kind for kind in EFFECT_KINDS if kind not in of_instruments):
        assert f"### `{kind}`\n![" in text, kind
        assert (DOCS / "images" / "effects" / f"{kind}.png").stat().st_size < 30_000
    assert [kind for kind in of_instruments if f"| `{kind}` |" not in text] == []


def test_every_number_that_the_search_decides_by_is_in_the_documents_with_its_reason() -> None:
    thresholds = made_by("thresholds")
    page = thresholds.PAGE.read_text("utf-8")
    assert page == thresholds.page(), "run `python docs/thresholds.py`"
    rows = re.findall(r"^\| `(\w+)\.([A-Z_0-9]+)` \| ([^|]+) \| [^|]{3,} \|$", page, re.MULTILINE)
    assert len(rows) == page.count("\n| `") and len({(module, name) for module, name, _ in rows}) == len(rows) > 100
    of_module = {
        module.rpartition("/")[2]: module
        for places in thresholds.ROOMS.values()
        for module in thresholds.modules(places)
    }
    for module, name, values in rows:
        constant = getattr(import_module(f"aridcal.{of_module[module].replace('/', '.')}"), name)
        first = constant[0] if isinstance(constant, tuple) else constant
        np.testing.assert_allclose(
            float(getattr(first, "length", first)), float(values.split(",")[0]), rtol=1e-12, err_msg=f"{module}: {name}"
        )


def test_the_keys_of_a_campaign_are_those_of_the_models():
    """Every key that a campaign may have stands in the page, as `python docs/keys.py` writes it."""
    keys = made_by("keys")
    assert keys.PAGE.read_text("utf-8") == keys.page(), "run `python docs/keys.py`"
    sections = re.findall(r"^## (\w+)$", keys.page(), re.MULTILINE)
    assert set(sections) == {field.alias or name for name, field in Campaign.model_fields.items()}
    for section, example in (("robot", "coupled"), ("measurements", "table.dates.order"), ("region", "tool")):
        of_section = keys.page().split(f"## {section}\n")[1].split("\n## ")[0]
        assert f"| `{example}` | " in of_section


def test_the_readme_names_both_commands_that_set_up_a_fresh_machine():
    readme, makefile = (ROOT / "README.md").read_text("utf-8"), (ROOT / "Makefile").read_text("utf-8")
    for target in ("demo", "test"):
        assert f"\n    make {target}\n" in readme and re.search(rf"^{target}:", makefile, re.MULTILINE)


def test_the_readme_and_the_formats_name_every_command():
    for page in ("README.md", "docs/formats.md"):
        text = (ROOT / page).read_text("utf-8")
        assert [command for command in COMMANDS if f"`aridcal {command}" not in text] == [], page


def test_the_site_has_every_page_in_its_menu():
    menu = yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))["nav"]
    named = set(re.findall(r"[\w/-]+\.md", json.dumps(menu)))
    made = {
        "index.md",
        "contributing.md",
        "commands.md",
        *(f"notebooks/{path.stem}.md" for path in ROOT.glob("notebooks/*.ipynb")),
    }
    assert named == made | {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, notebooks not run."""
    if find_spec("mkdocs") is None:
        pytest.skip("needs mkdocs, which only the extra `docs` installs: `make docs`")
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"ARIDCAL_DOCS_RUN": "0", "NO_MKDOCS_2_WARNING": "1"}
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, env=environment)
    return folder


def test_the_site_asks_nothing_of_the_network(site: Path) -> None:
    for page in site.rglob("*.html"):
        asked = re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"?(?:https?:)?//", page.read_text("utf-8"))
        assert asked == [], page


def test_every_page_opens_from_the_disk_without_a_complaint(site: Path, browser: chromium.Browser) -> None:
    for name in sorted(site.rglob("*.html")):
        if name.name == "404.html":
            continue
        with browser.open(name) as page:
            assert page.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 0)"), name
            assert page.console == [], name
            assert {url.partition(":")[0] for url in page.requests} <= {"file"}, name


def test_the_search_works_from_the_disk(site: Path, browser: chromium.Browser) -> None:
    with browser.open(site / "index.html") as page:
        page.evaluate("document.querySelector('[data-md-toggle=search]').click()")
        page.evaluate("document.querySelector('[data-md-component=search-query]').focus()")
        page.call("Input.insertText", text="backlash")
        page.wait("document.querySelector('.md-search-result__item a')")
        found = page.evaluate("[...document.querySelectorAll('.md-search-result__item a')].map((a) => a.href).join()")
        assert "effects.html" in found
