"""Packages of ROS, found without ROS: where ``package://NAME/...`` and ``$(find NAME)`` lead."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from lxml import etree

from aridcal.system.errors import RobotError
from aridcal.system.reading.regular_files import Limit, read_file

MANIFEST = Limit(0.1)
"""`package.xml`, written by hand: a few kilobytes."""

HINT = "say where it is: `init --package {name}=FOLDER` (in a campaign `robot.packages`), ROS_PACKAGE_PATH or AMENT_PREFIX_PATH"
"""What to do about a package that is not found."""


def package_folders(name: str, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """List the folders that may be a package, the likeliest first; they may not exist.

    Args:
        name: Of the package.
        folder: Of the file that names it: packages above it, and beside these, count.
        packages: Where the user says that packages are. One that is named here is nowhere else.
    """
    if name in packages:
        yield packages[name]
        return
    above = [folder.resolve(), *folder.resolve().parents]
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    yield from (place for place in above + ros if place.name == name)
    yield from (place / name for place in above + ros + ament)
    yield from (place for place in above if called(place) == name)
    for place in ros:
        with suppress(OSError):
            yield from (other / name for other in sorted(place.iterdir()) if other.is_dir())


def find_package(name: str, folder: Path, packages: Mapping[str, Path]) -> Path | None:
    """Return the folder of a package; None if it is not found."""
    with suppress(OSError, ValueError):  # a name that no folder can have
        for place in package_folders(name, folder, packages):
            if place.is_dir():
                return place
    return None


def called(place: Path) -> str | None:
    """Return the name that the ``package.xml`` of a folder says, which a clone's folder need not have."""
    path = place / "package.xml"
    if not path.is_file():
        return None
    try:
        content = read_file(path, RobotError, MANIFEST)
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
        name = etree.fromstring(content, parser).findtext("name")
    except (RobotError, etree.XMLSyntaxError, ValueError):
        return None
    return name.strip() if name else None
