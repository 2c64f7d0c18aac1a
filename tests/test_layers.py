"""The layer table of CONTRIBUTING.md: who may import whom."""

from __future__ import annotations

import ast
import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import aridcal

PACKAGE = Path(aridcal.__file__).parent
CONTRIBUTING = Path(__file__).parent.parent / "CONTRIBUTING.md"

LAYERS = [
    {"__init__", "errors"},
    {"robot", "doty", "settings", "tables", "columns", "source", "campaign", "measurements", "commands"},
    {"effects", "catalogue", "head"},
    {"model", "machine", "report1992", "residual"},
    {"start", "identifiable", "solver", "geometry", "inverse"},
    {
        "outcome",
        "arm",
        "instrument",
        "quality",
        "diagnosis",
        "search",
        "scoring",
        "scan",
        "bench",
        "evidence",
        "explain",
        "whiteness",
        "traces",
    },
    {"export", "urdf_writer", "formats", "calibration", "handover"},
    {
        "report",
        "sections",
        "dependence",
        "apart",
        "plots",
        "markup",
        "view",
        "scene",
        "shapes",
        "predict",
        "compensate",
        "measure",
        "sighted",
        "closed_form",
        "head_section",
        "shooting",
        "arm_and_head",
        "design",
        "simulate",
        "causes",
        "init",
        "propose",
        "dialect",
    },
    {"identify", "doctor", "completion", "__main__"},
]
LAYER = {module: number for number, modules in enumerate(LAYERS) for module in modules}

KEPT_TO = {
    "cv2": {"head"},
    "meshcat": {"view", "scene"},
    "scipy.optimize": {"solver", "start"},
}
"""Libraries that only some modules may import."""

MODULES = {
    path: path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    for path in sorted(PACKAGE.rglob("*.py"))
    if "__pycache__" not in path.parts
}


def imported(source: str, path: Path) -> Iterator[str]:
    """Full names of all that a module imports, wherever in it: ``from a import b`` gives ``a`` and ``a.b``."""
    package = ["aridcal", *path.relative_to(PACKAGE).parts[:-1]]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def module_of(name: str) -> str | None:
    """The module of aridcal that a full name lies in; None for what is not a module of aridcal."""
    parts = name.split(".")
    if parts[0] != "aridcal" or len(parts) == 1:
        return None
    if (PACKAGE / f"{parts[1]}.py").is_file() or (PACKAGE / parts[1]).is_dir():
        return parts[1]
    return "__init__" if hasattr(aridcal, parts[1]) else parts[1]


def complaints(source: str, path: Path) -> list[str]:
    """What in a module goes against the layer table or the list of kept libraries."""
    module = MODULES.get(path, path.stem)
    if module not in LAYER:
        return [f"{module} has no layer: give it one in tests/test_layers.py and CONTRIBUTING.md"]
    found = []
    for name in sorted(set(imported(source, path))):
        other = module_of(name)
        if other is not None and LAYER.get(other, len(LAYERS)) > LAYER[module]:
            found.append(f"{module} (layer {LAYER[module]}) imports {name} (layer {LAYER.get(other, 'none')})")
        for library, users in KEPT_TO.items():
            if (name == library or name.startswith(f"{library}.")) and module not in users:
                found.append(f"{module} imports {name}: {library} is kept to {', '.join(sorted(users))}")
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_module_imports_only_its_own_layer_and_lower_ones(path: Path) -> None:
    assert complaints(path.read_text("utf-8"), path) == []


def test_imports_have_no_cycle() -> None:
    parts = {path: ["aridcal", *path.relative_to(PACKAGE).with_suffix("").parts] for path in MODULES}
    names = {path: ".".join(parts[path]).removesuffix(".__init__") for path in MODULES}
    graph = {name: set(imported(path.read_text("utf-8"), path)) - {name} for path, name in names.items()}
    order = list(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError, which names the cycle
    assert set(names.values()) <= set(order)


def test_contributing_shows_the_same_table() -> None:
    shown: list[set[str]] = [set() for _ in LAYERS]
    for layer, modules in re.findall(r"^\| (\d) \| (.*?) \|", CONTRIBUTING.read_text("utf-8"), re.MULTILINE):
        shown[int(layer)] |= {name.rstrip("/") for name in re.findall(r"`(.*?)`", modules)}
    assert shown == [modules - {"__init__"} for modules in LAYERS]


@pytest.mark.parametrize(
    ("module", "source", "culprit"),
    [
        ("robot", "from aridcal.model import Model", "aridcal.model"),
        ("robot", "def late():\n    import aridcal.solver", "aridcal.solver"),
        ("robot", "from aridcal import solver", "aridcal.solver"),
        ("robot", "from . import model", "aridcal.model"),
        ("robot", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .model import Model", "aridcal.model"),
        ("model", "import aridcal.nowhere", "aridcal.nowhere"),
        ("model", "import cv2", "cv2"),
        ("report", "from meshcat import geometry", "meshcat"),
        ("model", "from scipy import optimize", "scipy.optimize"),
        ("model", "from scipy.optimize import minimize", "scipy.optimize"),
        ("brand_new", "", "brand_new has no layer"),
    ],
)
def test_forbidden_imports_are_named(module: str, source: str, culprit: str) -> None:
    assert culprit in "\n".join(complaints(source, PACKAGE / f"{module}.py"))


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("doty", "from aridcal.robot import Joint"),
        ("model", "from . import effects\nfrom aridcal.errors import AridcalError"),
        ("identify", "from aridcal import __version__, solver\nfrom scipy.spatial.transform import Rotation"),
        ("solver", "from scipy.optimize import minimize"),
    ],
)
def test_allowed_imports_pass(module: str, source: str) -> None:
    assert complaints(source, PACKAGE / f"{module}.py") == []
