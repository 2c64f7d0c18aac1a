"""Programs that call each other by name: which a name means, which are reached, and where all begins."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence


def called_program(own_names: Sequence[str], ours: Mapping[int, bool]) -> dict[str, int]:
    """Which program a name means: of several, the only one that is to be corrected, or none.

    Args:
        own_names: Of each program.
        ours: Whether each is to be corrected.
    """
    names: dict[str, int] = {}
    for name in dict.fromkeys(own_names):
        same = [k for k, own in enumerate(own_names) if own == name]
        candidates = [k for k in same if ours[k]] or same
        if len(candidates) == 1:
            names[name] = candidates[0]
    return names


def routine_of(names: Mapping[str, int], program: int) -> str:
    """The name under which a program is walked: its own, or one that nobody calls where two have the same."""
    return next((name for name, k in names.items() if k == program), f"/{program}")


def reachable_programs(
    start: Sequence[int], calls: Sequence[Sequence[str]], names: Mapping[str, int]
) -> frozenset[int]:
    """Programs that some call or start, those themselves included.

    Args:
        start: Where it begins.
        calls: Names that each calls.
        names: Which a name means.
    """
    reachable: dict[int, None] = {}
    waiting = list(start)
    while waiting:
        k = waiting.pop()
        if k not in reachable:
            reachable[k] = None
            waiting += [names[name] for name in calls[k] if name in names]
    return frozenset(reachable)


def uncalled_programs(walked: Sequence[int], calls: Sequence[Sequence[str]], names: Mapping[str, int]) -> Iterator[int]:
    """Programs that none of the others calls."""
    callees = {names[name] for k in walked for name in calls[k] if name in names and names[name] != k}
    return (k for k in walked if k not in callees)
