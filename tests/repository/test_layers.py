"""The rooms of CONTRIBUTING.md: imports go downwards only, between rooms and inside each."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from repository import ROOT, statements

import aridcal

PACKAGE = Path(aridcal.__file__).parent
CONTRIBUTING = ROOT / "CONTRIBUTING.md"

HOUSE: list[tuple[str, tuple[str, ...]]] = [
    (room.replace("/", "."), tuple(re.findall(r"`([a-z_0-9]+)`", modules)))
    for room, modules in re.findall(
        r"^\| `?([a-z ]+(?:/[a-z0-9]+)*)/?`? \| (`.*?) \|", CONTRIBUTING.read_text("utf-8"), re.MULTILINE
    )
]
"""Rooms, the lowest first, and the modules of each, the lowest first; a room may have a second row above its packages."""

PACKAGES = {".".join(path.parent.relative_to(PACKAGE).parts) for path in PACKAGE.rglob("__init__.py")}

PLACE = {
    f"aridcal.{room}.{module}" if room in PACKAGES else f"aridcal.{module}": (floor, step)
    for floor, (room, modules) in enumerate(HOUSE)
    for step, module in enumerate(modules)
}
"""Floor and step of each module; a package with a place in its room's row counts there as a module."""

PROGRAMS = "aridcal.jobs.apply.programs"

STRANGERS = [{"engine.fit", "jobs.head1992"}, {"pages.report", "jobs.prepare"}, {"face", "commands"}]
"""Rooms that never meet."""

KEPT_TO = {
    "casadi": ("aridcal.jobs.export.casadi_function",),
    "duckdb": ("aridcal.jobs.history.store",),
    "dask": ("aridcal.jobs.fleet.cluster",),
    "distributed": ("aridcal.jobs.fleet.cluster",),
    "rosbags": ("aridcal.jobs.merge.bags",),
    "cv2": ("aridcal.jobs.boards.", "aridcal.jobs.head1992."),
    "meshcat": ("aridcal.view", "aridcal.pages.drawing.scene"),
    "scipy.optimize": ("aridcal.engine.fit.",),
    "tornado": ("aridcal.view", "aridcal.runs.local_pages", "aridcal.runs.guide_server"),
    "yourdfpy": ("aridcal.engine.robot.read_back",),
    "trimesh": ("aridcal.jobs.boards.bodies", "aridcal.engine.robot.meshes"),
}
"""Libraries that only some modules may import."""

MODULES = sorted(path for path in PACKAGE.rglob("*.py") if "__pycache__" not in path.parts)


def name_of(path: Path) -> str:
    """A module's full name."""
    return ".".join(("aridcal", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


def imported(source: str, name: str, package: bool = False) -> Iterator[str]:
    """Full names of all that a module imports, wherever in it: ``from a import b`` gives ``a`` and ``a.b``."""
    home = name.split(".") if package else name.split(".")[:-1]
    for node in statements(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = home[: len(home) - node.level + 1] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def module_of(name: str) -> str | None:
    """The module of aridcal that a full name lies in; None for what is not a module of aridcal."""
    parts = name.split(".")
    if parts[0] != "aridcal" or len(parts) == 1 or (len(parts) == 2 and parts[1].startswith("__")):
        return None
    while len(parts) > 1:
        if ".".join(parts) in PLACE:
            return ".".join(parts)
        if (PACKAGE.joinpath(*parts[1:])).is_dir() and len(parts) == 2:
            return None  # a room's name alone imports nothing of it
        parts.pop()
    return name


def complaints(source: str, name: str) -> list[str]:
    """What in a module goes against the house."""
    if name not in PLACE:
        return [f"{name} has no place: give it one in CONTRIBUTING.md"]
    found = []
    floor, step = PLACE[name]
    room = HOUSE[floor][0]
    for full in sorted(set(imported(source, name))):
        other = module_of(full)
        if other is not None and other != name and not name.startswith(f"{other}."):
            place = PLACE.get(other)
            if place is None or place >= (floor, step):
                found.append(f"{name} imports {full}, which does not lie below it")
            elif {room, HOUSE[place[0]][0]} in STRANGERS:
                found.append(f"{name} imports {full}: {room} and {HOUSE[place[0]][0]} never meet")
        for library, users in KEPT_TO.items():
            if (full == library or full.startswith(f"{library}.")) and not name.startswith(users):
                found.append(f"{name} imports {full}: {library} is kept to {', '.join(users)}")
    return found


def test_modules_import_only_what_lies_below_them() -> None:
    found = []
    for path in MODULES:
        text, name = path.read_text("utf-8"), name_of(path)
        if path.name != "__init__.py" or name in PLACE:
            found += complaints(text, name)
        elif path.parent != PACKAGE:  # a docstring and no more; aridcal's own loads lazily
            found += [
                f"{name} imports {own}" for own in imported(text, name, package=True) if own.startswith("aridcal")
            ]
    assert found == []


def test_no_two_rooms_have_a_module_of_one_name() -> None:
    """Languages of programs have the same modules on purpose; a plural counts as its singular."""
    rooms: dict[str, set[Path]] = {}
    for path in MODULES:
        inside = path.relative_to(PACKAGE)
        if (
            path.name != "__init__.py"
            and path.parent != PACKAGE
            and "/".join(inside.parts[:-2]) != "jobs/apply/programs"
        ):
            rooms.setdefault(path.stem.removesuffix("s"), set()).add(inside.parent)
    assert {stem: places for stem, places in rooms.items() if len(places) > 1} == {}


def test_every_module_has_one_place_and_every_place_a_module() -> None:
    there = {name for path in MODULES if (name := name_of(path)) in PLACE or path.name != "__init__.py"}
    assert sum(len(modules) for _, modules in HOUSE) == len(PLACE)
    assert set(PLACE) == there


@pytest.mark.parametrize(
    ("module", "source", "culprit"),
    [
        ("engine.robot.chain", "from aridcal.engine.model.model import Model", "aridcal.engine.model.model"),
        ("engine.robot.chain", "def late():\n    import aridcal.engine.fit.stages", "aridcal.engine.fit.stages"),
        ("engine.robot.chain", "from aridcal.engine.model import model", "aridcal.engine.model.model"),
        ("engine.robot.chain", "from . import doty", "aridcal.engine.robot.doty"),
        ("engine.robot.chain", "from ..model import model", "aridcal.engine.model.model"),
        ("engine.robot.chain", "if TYPE_CHECKING:\n    from .doty import Link", "aridcal.engine.robot.doty"),
        ("engine.model.model", "import aridcal.nowhere", "aridcal.nowhere"),
        ("engine.model.model", "import cv2", "cv2"),
        ("jobs.head1992.square_pose", "from aridcal.engine.fit.residual import residuals", "never meet"),
        ("pages.report.page", "from meshcat import geometry", "meshcat"),
        ("jobs.history.wear", "import duckdb", "duckdb"),
        ("calibration", "from aridcal.identify import main", "aridcal.identify"),
        ("identify", "from aridcal.calibration import Calibration", "never meet"),
        ("engine.model.model", "from scipy import optimize", "scipy.optimize"),
        ("engine.model.model", "from scipy.optimize import minimize", "scipy.optimize"),
        ("jobs.apply.programs.uses", f"from {PROGRAMS}.krl import ROW", f"{PROGRAMS}.krl"),
        ("jobs.apply.programs.krl.tokens", f"from {PROGRAMS}.krl import meaning", f"{PROGRAMS}.krl.meaning"),
        ("jobs.apply.programs.krl.meaning", f"from {PROGRAMS}.languages import LANGUAGES", f"{PROGRAMS}.languages"),
        ("brand_new", "", "aridcal.brand_new has no place"),
    ],
)  # fmt: skip
def test_forbidden_imports_are_named(module: str, source: str, culprit: str) -> None:
    assert culprit in "\n".join(complaints(source, f"aridcal.{module}"))


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("engine.robot.doty", "from aridcal.engine.robot.chain import Joint"),
        (
            "engine.model.model",
            "from aridcal.engine.corrections import basis\nfrom aridcal.system.errors import AridcalError",
        ),
        ("identify", "from aridcal import __version__\nfrom scipy.spatial.transform import Rotation"),
        ("engine.fit.frame_starts", "from scipy.optimize import minimize"),
        ("jobs.apply.programs.krl.meaning", f"from {PROGRAMS}.krl import table\nfrom {PROGRAMS} import walk"),
    ],
)
def test_allowed_imports_pass(module: str, source: str) -> None:
    assert complaints(source, f"aridcal.{module}") == []
