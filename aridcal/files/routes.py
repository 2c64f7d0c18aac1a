"""Which path through the robot's tree each row takes: from what carries the instrument to what carries the target."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.engine.robot.chain import Robot, Route
from aridcal.files.things import InstrumentDeclarations


def routes_of(
    declarations: InstrumentDeclarations,
    kind: str,
    refers: np.ndarray,
    target: np.ndarray | None,
    tip: str,
    links: tuple[str, str] | None = None,
) -> list[Route]:
    """The path of each row of a kind, n of them.

    A camera is where its rows' paths end, whatever it looks at; only one in the world is where they start.

    Args:
        declarations: What the campaign says of instruments and targets.
        kind: Kind of the rows.
        refers: Labels of the things that rows refer to, in the order of the kind's roles, shape (n, 3).
        target: Label of each row's target, shape (n,), or None.
        tip: The robot's tip.
        links: The two links between which all rows of the block are, if the block names them.
    """
    if links is not None:
        return [_between(*links, tip)] * len(refers)
    roles = [role.name for role in MEASUREMENT_KINDS[kind].roles]
    targets = np.full(len(refers), "") if target is None else target
    labels = np.column_stack([refers, targets]).astype(str)
    distinct, number = np.unique(labels, axis=0, return_inverse=True)
    routes = [_route(declarations, dict(zip(roles, words, strict=False)), str(words[-1]), tip) for words in distinct]
    return [routes[k] for k in np.ravel(number).tolist()]


def _route(declarations: InstrumentDeclarations, label: dict[str, str], target: str, tip: str) -> Route:
    """The path from the instrument's carrier to the target's, by labels of things and of the target."""
    carriers = {role: declarations.carrier(role, name) for role, name in label.items() if name}
    if "camera" in carriers:
        camera, board = carriers["camera"], carriers["board"]
        start, end = (WORLD, board) if camera == WORLD else (board, camera)
    else:
        start = next((carrier for role, carrier in carriers.items() if role != "tracker"), WORLD)
        end = declarations.settings.targets[target].on if target in declarations.settings.targets else TIP
    return _between(start, end, tip)


def _between(start: str, end: str, tip: str) -> Route:
    """The path from one carrier to another."""
    return Route({WORLD: None, TIP: tip}.get(start, start), None if end in (TIP, tip) else end)


def numbered(routes: Sequence[Route], targets: Collection[str]) -> tuple[tuple[Route, ...], np.ndarray | None]:
    """The different paths, the default one first, and the number of each row's path; None where all take the default.

    Args:
        routes: Path of each row.
        targets: Links that carry targets: to these there is a path from the world, too.
    """
    distinct = tuple(dict.fromkeys([Route(), *routes, *(Route(None, link) for link in targets)]))
    if len(distinct) == 1:
        return distinct, None
    number = {route: k for k, route in enumerate(distinct)}
    return distinct, np.array([number[route] for route in routes], dtype=int)


def needed_columns(robot: Robot, routes: Sequence[Route]) -> np.ndarray:
    """Which columns of readings each row needs, shape (n, columns) bool: those of the joints on its path."""
    of_route = {route: np.isin(robot.readings, robot.between(*route).readings) for route in set(routes)}
    return np.array([of_route[route] for route in routes]).reshape(len(routes), len(robot.readings))
