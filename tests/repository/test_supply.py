"""What aridcal depends on: each package used, each for a stated reason, and locked for developers."""

from __future__ import annotations

import ast
import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from repository import ROOT, statements

import aridcal
from aridcal.doctor import IMPORTED_AS

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
NEEDED = [Requirement(line) for line in PROJECT["dependencies"]]
EXTRAS = {
    extra: [r for r in map(Requirement, PROJECT["optional-dependencies"][extra]) if r.name != PROJECT["name"]]
    for extra in ("export", "fleet", "ros", "xacro", "dev")
}
"""What is installed on request; developers have all of it."""

ON_REQUEST = {
    "casadi": ("export", "jobs/export/casadi_function.py"),
    "dask": ("fleet", "jobs/fleet/cluster.py"),
    "distributed": ("fleet", "jobs/fleet/cluster.py"),
    "duckdb": ("fleet", "jobs/history/store.py"),
    "rosbags": ("ros", "jobs/merge/bags.py"),
    "robot_descriptions": ("xacro", "engine/robot/described_robots.py"),
    "xacrodoc": ("xacro", "engine/robot/expand.py"),
}
"""Modules of extras: which brings each, and the only file that imports it, inside of functions."""

BY_OTHERS = {"collada": "trimesh"}
"""Imported by another dependency, which does not ask for it itself."""

PART_OF = {"coal": "pinocchio", "pydantic_core": "pydantic", "tornado": "meshcat", "umsgpack": "meshcat"}
"""Modules of packages that a dependency requires and in whose terms it speaks: its errors, its server, its messages,
its shapes."""

NOT_OURS = {"IPython"}
"""Imported only inside a notebook, which has it."""


def used(source: str) -> set[str]:
    """Packages that a module imports, or looks for by name."""
    found: set[str] = set()
    for node in statements(source):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module)
    for node in ast.walk(ast.parse(source)) if re.search("find_spec|import_module", source) else ():
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("find_spec", "import_module")):
            found |= {a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)}
    return {name.split(".")[0] for name in found} - set(sys.stdlib_module_names) - {"aridcal"}


def test_imports_are_found_wherever_they_are() -> None:
    source = "import a.b\nfrom c.d import e\nfrom . import f\nimport os\ndef g():\n    import h\nfind_spec('i')"
    source += "\ntry:\n    import j\nexcept ImportError:\n    import k\nelse:\n    import l\nfinally:\n    import m"
    source += "\nmatch n:\n    case 1:\n        import o\nwith p:\n    for q in r:\n        import s"
    assert used(source) == {*"achijklmos"}


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """What each file of the package uses, by its path within it."""
    home = ROOT / "aridcal"
    return {path.relative_to(home).as_posix(): used(path.read_text("utf-8")) for path in home.rglob("*.py")}


def test_every_dependency_is_used_and_everything_used_is_a_dependency(imports: dict[str, set[str]]) -> None:
    imported = set().union(*imports.values())
    imported = {PART_OF.get(name, name) for name in imported} - NOT_OURS - set(ON_REQUEST)
    assert not imported & set(BY_OTHERS)
    assert imported | set(BY_OTHERS) == {IMPORTED_AS.get(r.name, r.name) for r in NEEDED}


def test_an_extra_is_imported_late_in_one_file_and_its_absence_says_how_to_get_it(
    imports: dict[str, set[str]],
) -> None:
    for module, (extra, home) in ON_REQUEST.items():
        assert module in {r.name.replace("-", "_") for r in EXTRAS[extra]}
        assert [path for path, used_there in imports.items() if module in used_there] == [home]
        source = (ROOT / "aridcal" / home).read_text("utf-8")
        at_once = [node for node in ast.parse(source).body if isinstance(node, ast.Import | ast.ImportFrom)]
        assert module not in used("\n".join(map(ast.unparse, at_once)))
        assert f'pip install "aridcal[{extra}]"' in source


def test_what_others_import_for_us_is_what_they_import() -> None:
    for module, other in BY_OTHERS.items():
        folder = Path(__import__(other).__file__).parent
        assert any(module in used(path.read_text("utf-8")) for path in (folder / "exchange").glob("*.py"))


def test_what_counts_as_part_of_a_dependency_is_required_by_it() -> None:
    distributions = importlib.metadata.packages_distributions()
    installed_as = {module: name for name, module in IMPORTED_AS.items()}
    for module, whole in PART_OF.items():
        requires = importlib.metadata.requires(installed_as.get(whole, whole))
        required = {canonicalize_name(Requirement(r).name) for r in requires or ()}
        assert {canonicalize_name(name) for name in distributions.get(module, [module])} & required, module


def test_every_dependency_has_its_reason_in_contributing() -> None:
    section = (ROOT / "CONTRIBUTING.md").read_text("utf-8").split("## Dependencies")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `([a-z0-9-]+)` \| (.+) \|$", section, re.MULTILINE)
    assert [name for name, _ in rows] == sorted(r.name for r in NEEDED)
    assert all(len(reason) > 10 for _, reason in rows)


def test_the_lock_holds_all_that_is_required_with_hashes() -> None:
    """If not, `make lock` was forgotten."""
    text = (ROOT / "requirements-dev.lock").read_text("utf-8")
    entries = re.findall(r"^([\w.-]+)==(\S+)(.*(?:\n    .*)+)", text, re.MULTILINE)
    assert len(entries) == len(re.findall(r"^\S+==", text, re.MULTILINE))
    assert all("--hash=sha256:" in rest for *_, rest in entries)
    locked: dict[str, list[str]] = {}
    for name, version, _ in entries:
        locked.setdefault(canonicalize_name(name), []).append(version)
    for required in (*NEEDED, *(r for own in EXTRAS.values() for r in own)):
        versions = locked[canonicalize_name(required.name)]
        assert all(required.specifier.contains(version) for version in versions), required


CONDA = {
    "matplotlib": "matplotlib-base",
    "meshcat": "meshcat-python",
    "opencv-python-headless": "py-opencv",
    "pin": "pinocchio",
}
"""What conda-forge calls otherwise."""


def test_the_recipe_for_conda_asks_for_the_same() -> None:
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text("utf-8"))
    run = dict(line.split(" ", 1) for line in recipe["requirements"]["run"])
    assert run.pop("python") == PROJECT["requires-python"]
    wanted = {CONDA.get(r.name, r.name): str(r.specifier) for r in NEEDED}
    wanted["py-opencv"] = wanted["py-opencv"].rpartition(".")[0]  # PyPI counts its own builds beyond OpenCV's versions
    assert run == wanted
    assert recipe["context"]["version"] == aridcal.__version__


def test_every_asset_is_part_of_an_installation() -> None:
    """A style sheet that only the repository has is missed by users alone."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]["package-data"]
    assets = {path.parent.parent for path in (ROOT / "aridcal").rglob("assets/*")}
    assert assets
    for package in assets:
        assert settings[".".join(package.relative_to(ROOT).parts)] == ["assets/*"]


def test_the_matrix_runs_tests_that_exist_on_every_python_that_is_promised() -> None:
    script = (ROOT / "scripts" / "matrix.py").read_text("utf-8")
    constants = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in ast.parse(script).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and isinstance(node.value, ast.Tuple)
    }
    assert all((ROOT / "tests" / f"{name}.py").is_file() for name in constants["QUICK"])
    assert PROJECT["requires-python"] == f">={constants['PYTHONS'][0]}"
