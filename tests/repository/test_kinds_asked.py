"""What a measurement is of is asked of its kind's row in the table, never of the kind's name."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import aridcal
from aridcal.engine.instruments.kind import MeasurementKind
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS

PACKAGE = Path(aridcal.__file__).parent

PLAIN = {"camera_sonar", "pixels", "inclination"}
"""Names with which nothing else is compared: other kinds share theirs with channels, roles of things and columns."""

CHANNELS = {channel.name for kind in MEASUREMENT_KINDS.values() for channel in kind.channels}

OTHER_KINDS = {
    "jobs/apply/programs/urscript": "kinds of tokens",
    "jobs/prepare/other_kinds.py": "the table by which columns tell a kind",
}
"""Where such words are no questions of a kind, and what they are."""

MODULES = [
    path
    for path in sorted(PACKAGE.rglob("*.py"))
    if not (place := path.relative_to(PACKAGE).as_posix()).startswith(("engine/instruments/", *OTHER_KINDS))
]


def words(node: ast.AST | None, bound: dict[str, set[str]]) -> set[str]:
    """Kinds' names in what something is compared with: a word, words side by side, or a module's own name of these."""
    if node is None:
        return set()
    inside = list(ast.walk(node))
    own = {n.value for n in inside if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return (own & MEASUREMENT_KINDS.keys()).union(*(bound.get(n.id, set()) for n in inside if isinstance(n, ast.Name)))


def is_kind(node: ast.AST) -> bool:
    """True of ``kind``, ``kinds``, ``x.kind`` and ``x.kind.name``."""
    if isinstance(node, ast.Attribute) and node.attr == "name":
        node = node.value
    return (isinstance(node, ast.Name) and node.id in ("kind", "kinds")) or (
        isinstance(node, ast.Attribute) and node.attr in ("kind", "kinds")
    )


def rows_imported(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    """Rows of the table that are imported by name: their module's, not the table's."""
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("aridcal.engine.instruments."):
            there = importlib.import_module(str(node.module))
            yield from (
                (node.lineno, a.name) for a in node.names if isinstance(getattr(there, a.name, None), MeasurementKind)
            )


def questions(source: str) -> list[tuple[int, str]]:
    """Lines of a module that ask for a kind's name, and what they ask."""
    tree = ast.parse(source)
    nodes = list(ast.walk(tree))
    typed = {id(n) for s in nodes if isinstance(s, ast.Subscript) for n in ast.walk(s.slice)}
    bound = {
        target.id: words(node.value, {})
        for node in tree.body
        if isinstance(node, (ast.Assign, ast.AnnAssign))
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(target, ast.Name)
        and isinstance(node.value, (ast.Constant, ast.Tuple, ast.List, ast.Set, ast.Call))
    }
    found = list(rows_imported(nodes))
    for node in nodes:
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            said = set().union(*(words(side, bound) for side in sides))
            if said & PLAIN or (said and any(map(is_kind, sides))):
                found.append((node.lineno, ast.unparse(node)))
        elif isinstance(node, ast.Match) and is_kind(node.subject):
            said = set().union(*(words(case.pattern, bound) for case in node.cases))
            found += [(node.lineno, ", ".join(sorted(said)))] if said else []
        elif isinstance(node, (ast.Tuple, ast.List, ast.Set, ast.Dict)) and id(node) not in typed:
            each = node.keys if isinstance(node, ast.Dict) else node.elts
            said = {e.value for e in each if isinstance(e, ast.Constant) and e.value in MEASUREMENT_KINDS}
            sentences = isinstance(node, ast.Dict) and all(
                isinstance(v, ast.Constant) and " " in str(v.value) for v in node.values
            )
            if not sentences and ((len(said) > 1 and len(said) == len(each)) or said & (PLAIN - CHANNELS)):
                found.append((node.lineno, ast.unparse(node)))
    return found


def test_no_module_outside_instruments_asks_for_a_kind_by_its_name() -> None:
    named = re.compile(
        "|".join([*(f"[\"']{name}[\"']" for name in MEASUREMENT_KINDS), r"aridcal\.engine\.instruments\."])
    )
    sources = {str(path.relative_to(PACKAGE)): path.read_text("utf-8") for path in MODULES}
    found = {path: questions(source) for path, source in sources.items() if named.search(source)}
    assert {path: asked for path, asked in found.items() if asked} == {}


@pytest.mark.parametrize(
    "source",
    [
        'poses = settings.kind == "pose"',
        'if kind not in ("point", "plane"): pass',
        'found = any(block.kind != "pixels" for block in blocks)',
        'found = rows.kind.name == "plane"',
        'found = kinds == {"inclination"}',
        'found = "distance" in kinds',
        'found = measured != {"inclination"}',
        'OF_TARGETS = ("pose", "position")',
        'EASY = frozenset(["pose", "distance"])',
        'ONE = "pose"\nfound = block.kind == ONE',
        'OWN = {"pixels": lambda title: "tip", "inclination": lambda title: title}',
        'own = {"point": 1, "distance": 2, "plane": 3}[kind]',
        'role = {"point": "point", "distance": "anchor", "plane": "plane"}[kind]',
        'match block.kind:\n    case "pose":\n        pass',
        "from aridcal.engine.instruments.pixels import PIXELS",
        'found = channel in (None, "pixels")',
    ],
)
def test_every_way_in_which_kinds_were_asked_for_by_name_is_seen(source: str) -> None:
    assert questions(source)


@pytest.mark.parametrize(
    "source",
    [
        'found = role.name == "point"',
        'found = tie.form == "distance"',
        'found = channel.name in ("position", "rotation")',
        'kind: Literal["pose", "position"] = "pose"',
        'found = joint.kind == "prismatic"',
        "found = block.traits.images",
        'said = {"point": "How far off.", "pixels": "How far off in the image."}[kind]',
        'noise = {"distance", "pixel", "inclination"}',
    ],
)
def test_roles_channels_joints_and_words_for_readers_are_no_questions(source: str) -> None:
    assert questions(source) == []
