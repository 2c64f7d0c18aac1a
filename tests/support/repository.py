"""Where the repository lies: robots, campaigns and documents that tests read beside the package."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def statements(source: str) -> Iterator[ast.AST]:
    """Every statement of a module, wherever in it; a tenth of all nodes, and imports are among them."""
    waiting: list[ast.AST] = [ast.parse(source)]
    while waiting:
        node = waiting.pop()
        inner = [s for part in ("body", "orelse", "finalbody", "handlers", "cases") for s in getattr(node, part, ())]
        waiting += inner
        yield from inner
