"""The page `thresholds.md`: every number that decides what is found or said, from the constants and the docstrings below them.

Example:
    python docs/thresholds.py              # writes docs/thresholds.md, which tests/repository/test_docs.py compares
"""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import numpy as np

from aridcal.engine.corrections.smooth import Kernel

TOP = Path(__file__).resolve().parents[1]
PAGE = TOP / "docs" / "thresholds.md"

ROOMS = {
    "Levels of all rooms": ("engine/levels",),
    "What candidates can be": ("engine/corrections",),
    "Rows": ("engine/rows/split", "engine/rows/repeats"),
    "Fit": ("engine/fit",),
    "Search": ("engine/search",),
    "How far a calibration is trusted": ("engine/trust",),
    "The whole calibration": (
        "jobs/calibrate/gravity_direction",
        "jobs/calibrate/groups",
        "jobs/calibrate/job_inputs",
        "jobs/calibrate/pipeline",
        "jobs/calibrate/verdict",
    ),
}
"""Modules, or rooms of modules, whose constants decide what is found or said."""

NOT_DECIDING = ("Work: ", "Drawn: ")
"""How the reason of a constant begins that bounds the work, or what is drawn; any other has its row in the page."""

BEGINNING = """# Thresholds

All numbers that decide what is found or said, each with its reason, as the code has them (`python docs/thresholds.py`). What
bounds the work or is drawn is marked `Work:` or `Drawn:` in the code, and is not here. [How the search
works](how-the-search-works.md) says what they are for.
"""


def modules(places: tuple[str, ...]) -> list[str]:
    """Modules of some places in the package, those of a room by name."""
    package = TOP / "aridcal"
    return [
        f"{place}/{path.stem}" if (package / place).is_dir() else place
        for place in places
        for path in (sorted((package / place).glob("[!_]*.py")) if (package / place).is_dir() else [package / place])
    ]


def numbers(constant: object) -> list[float]:
    """A constant as numbers, in order; a kernel is its length."""
    many = constant if isinstance(constant, tuple | list | np.ndarray) else [constant]
    return [float(k.length if isinstance(k, Kernel) else k) for k in many]


def constants(module: str) -> dict[str, tuple[list[float], str]]:
    """Numeric constants of a module that decide something: their numbers and their reasons, from the docstrings that follow."""
    body = ast.parse((TOP / "aridcal" / f"{module}.py").read_text("utf-8")).body
    loaded = import_module(f"aridcal.{module.replace('/', '.')}")
    decide = {}
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            reason = " ".join(str(after.value.value).split()) if documented else ""
            for name in ast.unparse(target).strip("()").split(", "):
                constant = getattr(loaded, name)
                first = constant[0] if isinstance(constant, tuple) and constant else constant
                number = name.isupper() and isinstance(first, int | float | np.ndarray | Kernel)
                if number and not reason.startswith(NOT_DECIDING):
                    if not reason:
                        raise LookupError(f"{module}.{name} has no reason: write it below, as a docstring")
                    decide[name] = (numbers(constant), reason)
    return decide


def page() -> str:
    """The page as Markdown."""
    said = [BEGINNING]
    for title, places in ROOMS.items():
        rows = [
            f"| `{module.rpartition('/')[2]}.{name}` | {', '.join(f'{number:.12g}' for number in values)} | {_plain(reason)} |"
            for module in modules(places)
            for name, (values, reason) in constants(module).items()
        ]
        said.append("\n".join([f"## {title}\n", "| threshold | value | why |", "|---|---|---|", *rows]) + "\n")
    return "\n".join(said)


def _plain(reason: str) -> str:
    """Names in a docstring as Markdown has them."""
    return re.sub(r":\w+:`(?:[\w.]*\.)?(\w+)`", r"`\1`", reason).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
