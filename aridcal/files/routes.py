"""Which path through the robot's tree each row takes: from what carries the instrument to what carries the target."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from aridcal.engine.instruments.kinds import KINDS
from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.engine.robot.chain import Robot, Route
from aridcal.files.things import Known


def routes_of(
    known: Known,
    kind: str,
    refers: np.ndarray,
    target: np.ndarray | None,
    tip: str,
    links: tuple[str, str] | None = None,
) -> list[Route]:
    """The path of each row of a kind, n of them.

    A camera is where its rows' paths end, whatever it looks at; only one in the world is where they start.

    Args:
        known: What the campaign says of instruments and targets.
        kind: Of the rows.
        refers: Labels of what they refer to, in the order of the kind's roles, shape (n, 3).
        target: Label of each row's target, shape (n,), or None.
        tip: The robot's tip.
        links: The two between which the block says that all its rows are.
    """
    if links is not None:
        return [_between(*links, tip)] * len(refers)
    roles = [role.name for role in KINDS[kind].roles]
    targets = np.full(len(refers), "") if target is None else target
    told = np.column_stack([refers, targets]).astype(str)
    every, number = np.unique(told, axis=0, return_inverse=True)
    made = [_route(known, dict(zip(roles, words, strict=False)), str(words[-1]), tip) for words in every]
    return [made[k] for k in np.ravel(number).tolist()]


def _route(known: Known, label: dict[str, str], target: str, tip: str) -> Route:
    """The path between two things."""
    carriers = {role: known.carrier(role, name) for role, name in label.items() if name}
    if "camera" in carriers:
        camera, board = carriers["camera"], carriers["board"]
        start, end = (WORLD, board) if camera == WORLD else (board, camera)
    else:
        start = next((carrier for role, carrier in carriers.items() if role != "tracker"), WORLD)
        end = known.settings.targets[target].on if target in known.settings.targets else TIP
    return _between(start, end, tip)


def _between(start: str, end: str, tip: str) -> Route:
    """The path from one carrier to another."""
    return Route({WORLD: None, TIP: tip}.get(start, start), None if end in (TIP, tip) else end)


def numbered(every: Sequence[Route], targets: Collection[str]) -> tuple[tuple[Route, ...], np.ndarray | None]:
    """The paths that there are, the default one first, and each row's number; None where all take that.

    Args:
        every: Of each row.
        targets: Links that carry targets: to these there is a path from the world, too.
    """
    found = tuple(dict.fromkeys([Route(), *every, *(Route(None, link) for link in targets)]))
    if len(found) == 1:
        return found, None
    number = {route: k for k, route in enumerate(found)}
    return found, np.array([number[route] for route in every], dtype=int)


def needed_columns(robot: Robot, every: Sequence[Route]) -> np.ndarray:
    """Which columns of readings each row needs, shape (n, columns) bool: those of the joints on its path."""
    of_route = {route: np.isin(robot.readings, robot.between(*route).readings) for route in set(every)}
    return np.array([of_route[route] for route in every]).reshape(len(every), len(robot.readings))
