"""Which robots a fleet has: campaigns by patterns, each named after its folder."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aridcal.system.errors import CampaignError
from aridcal.system.reading.user_names import check_name, check_path

RESERVED_NAMES_OF_FLEET = frozenset({"fleet.parquet", "fleet.html"})
"""Names in the fleet's folder that no robot can have."""


@dataclass(frozen=True)
class Member:
    """A robot of a fleet.

    Attributes:
        name: Of the folder that its campaign stands in.
        campaign: Path of it, absolute.
    """

    name: str
    campaign: Path


def members(patterns: Sequence[str], out: Path) -> tuple[Member, ...]:
    """Find the campaigns of a fleet.

    Args:
        patterns: Paths of campaigns, in which ``*``, ``?`` and ``**`` stand for what the shell has them stand for.
        out: The fleet's folder.

    Returns:
        One for each robot, by name.

    Raises:
        CampaignError: a pattern fits nothing, or two robots would have one name.
    """
    out = out.absolute()
    found: dict[Path, None] = {}
    for pattern in patterns:
        check_path(Path(pattern), CampaignError)
        # A path that is there is meant as it is, brackets and all.
        paths = [pattern] if Path(pattern).exists() else sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207 - of absolute patterns, too
        if not paths:
            raise CampaignError(
                f"{pattern}: no campaign fits this; a pattern names files, 'robots/*/campaign.yaml' for instance"
            )
        found |= dict.fromkeys(Path(os.path.normpath(Path(path).absolute())) for path in paths)
    by_name: dict[str, list[Path]] = {}
    for path in found:
        by_name.setdefault(path.parent.name, []).append(path)
    for name, of_name in by_name.items():
        _check(name, of_name, out)
    return tuple(Member(name, by_name[name][0]) for name in sorted(by_name))


def _check(name: str, paths: Sequence[Path], out: Path) -> None:
    """Refuse a name that cannot be a folder of the fleet's alone."""
    if len(paths) > 1:
        raise CampaignError(
            f"two robots would be called {name!r}: {paths[0]} and {paths[1]}. A robot is called as the folder "
            "of its campaign: rename one of the folders, or name the campaigns that are meant"
        )
    check_name(name, str(paths[0]), CampaignError)
    if name in RESERVED_NAMES_OF_FLEET or not name or name.startswith("."):
        raise CampaignError(f"{paths[0]}: a robot cannot be called {name!r}; rename the folder of its campaign")
    if (out / name).resolve() == paths[0].parent.resolve():
        raise CampaignError(f"{out}: the results of {name} would stand among its inputs; choose another folder with -o")
