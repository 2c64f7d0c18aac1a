"""The documents: every link leads somewhere, every effect has its picture, and the site builds."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import chromium
import numpy as np
import pytest
import yaml

from aridcal.__main__ import COMMANDS
from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.corrections.smooth import Kernel

TOP = Path(__file__).resolve().parents[1]
DOCS = TOP / "docs"
PAGES = [
    *sorted(DOCS.rglob("*.md")),
    TOP / "README.md",
    TOP / "CONTRIBUTING.md",
    *sorted(TOP.glob("notebooks/*.ipynb")),
]


SEARCH_PAGE = DOCS / "how-the-search-works.md"
THRESHOLD = re.compile(r"^\| `(\w+)\.([A-Z_0-9]+)` \| ([^|]+) \| [^|]{3,} \|$", re.MULTILINE)
DECIDING_ROOMS = ("engine/corrections", "engine/fit", "engine/search", "engine/trust")
OTHER_DECIDERS = (
    "engine/levels",
    "jobs/calibrate/gravity_direction",
    "jobs/calibrate/groups",
    "jobs/calibrate/pipeline",
    "jobs/calibrate/verdict",
    "jobs/calibrate/job_inputs",
    "engine/rows/split",
    "engine/rows/repeats",
)
GEOMETRY = ("engine/robot/doty1992",)
NOT_DECIDING = ("Work: ", "Drawn: ")
"""How the reason of a constant begins that bounds the work, or what is drawn; any other has its row in the page."""


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
    assert [name for name in sorted(tests) if not (TOP / "tests" / name).is_file()] == []


def test_every_kind_of_effect_has_its_paragraph_and_its_picture():
    text = (DOCS / "effects.md").read_text("utf-8")
    of_instruments = [kind for kind in EFFECT_KINDS if EFFECT_KINDS[kind].doc == "of-instruments"]
    for kind in (kind for kind in EFFECT_KINDS if kind not in of_instruments):
        assert f"### `{kind}`\n![" in text, kind
        assert (DOCS / "images" / "effects" / f"{kind}.png").stat().st_size < 30_000
    assert [kind for kind in of_instruments if f"| `{kind}` |" not in text] == []


def deciding() -> dict[str, str]:
    """Modules whose constants decide what is found or said: name in the page to place in the package."""
    inside = {f"{room}/{path.stem}" for room in DECIDING_ROOMS for path in (TOP / "aridcal" / room).glob("[!_]*.py")}
    modules = {*inside, *OTHER_DECIDERS} - {*GEOMETRY}
    assert len({module.rpartition("/")[2] for module in modules}) == len(modules)
    return {module.rpartition("/")[2]: module for module in sorted(modules)}


def thresholds() -> dict[tuple[str, str], str]:
    """Rows of the page's tables: (module, name) and the value as it is written."""
    rows = THRESHOLD.findall(SEARCH_PAGE.read_text("utf-8"))
    assert len({(module, name) for module, name, _ in rows}) == len(rows)
    return {(module, name): value for module, name, value in rows}


def module_of(path: str) -> ModuleType:
    return import_module(f"aridcal.{path.replace('/', '.')}")


def numbers_of(constant: object) -> list[float]:
    """A constant as numbers, in order; a kernel is its length."""
    many = constant if isinstance(constant, tuple | list | np.ndarray) else [constant]
    return [float(k.length if isinstance(k, Kernel) else k) for k in many]


def test_thresholds_in_the_documents_are_those_of_the_code():
    for (module, name), value in thresholds().items():
        written = [float(part) for part in value.split(",")]
        constant = numbers_of(getattr(module_of(deciding()[module]), name))
        np.testing.assert_allclose(constant, written, rtol=1e-12, err_msg=f"{module}: {name}")


def constants_of(module: str) -> dict[str, str]:
    """Numeric constants of a module by name: their reasons, where a docstring follows, else nothing."""
    body = ast.parse((TOP / "aridcal" / f"{module}.py").read_text("utf-8")).body
    found = {}
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            reason = " ".join(str(after.value.value).split()) if documented else ""
            for name in ast.unparse(target).strip("()").split(", "):
                constant = getattr(module_of(module), name)
                first = constant[0] if isinstance(constant, tuple) and constant else constant
                number = name.isupper() and isinstance(first, int | float | np.ndarray | Kernel)
                if number and not reason.startswith(NOT_DECIDING):
                    found[name] = reason
    return found


def test_every_number_that_the_search_decides_by_is_in_the_documents_with_its_reason():
    """What fails here names the rows that are missing, ready to be pasted, or that say what decides nothing."""
    constants = {
        (
            stem,
            name,
        ): f"| `{stem}.{name}` | {', '.join(map(str, numbers_of(getattr(module_of(module), name))))} | {reason} |"
        for stem, module in deciding().items()
        for name, reason in constants_of(module).items()
    }
    written = thresholds()
    assert not (missing := [row for key, row in constants.items() if key not in written]), "\n".join(missing)
    assert not (idle := [key for key in written if key not in constants]), idle


def test_the_readme_and_the_formats_name_every_command():
    for page in ("README.md", "docs/formats.md"):
        text = (TOP / page).read_text("utf-8")
        assert [command for command in COMMANDS if f"`aridcal {command}" not in text] == [], page


def test_the_site_has_every_page_in_its_menu():
    menu = yaml.safe_load((TOP / "mkdocs.yml").read_text("utf-8"))["nav"]
    named = set(re.findall(r"[\w/-]+\.md", json.dumps(menu)))
    made = {"index.md", "commands.md", *(f"notebooks/{path.stem}.md" for path in TOP.glob("notebooks/*.ipynb"))}
    assert named == made | {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, notebooks not run."""
    if find_spec("mkdocs") is None:
        pytest.skip("needs mkdocs, which only the extra `docs` installs: `make docs`")
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"ARIDCAL_DOCS_RUN": "0", "NO_MKDOCS_2_WARNING": "1"}
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    subprocess.run(build, cwd=TOP, check=True, env=environment)
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
