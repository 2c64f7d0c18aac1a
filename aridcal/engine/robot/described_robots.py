"""Robots by name, as the package robot_descriptions has them: what is in its cache, and nothing from the network."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aridcal.engine.robot.packages import called
from aridcal.system.errors import RobotError, nearest, shortened

LOOK_SECONDS = 60
"""To look into the cache: git is asked which version lies there, and answers in less than one."""

LONGEST_ROBOT_NAME = 100
"""Characters of a robot's name: those that there are have 40 at the most."""

NAME_ENDING = "_description"
"""What the names of robot_descriptions end in; it may be left out."""


@dataclass(frozen=True)
class RobotDescription:
    """Where a robot's description is, and what it takes to read it.

    Attributes:
        path: The URDF, or a xacro file.
        packages: Folders of the packages that it names.
        arguments: Values of the xacro file's arguments.
        cached: Whether it lies in the cache of robot_descriptions.
    """

    path: Path
    packages: Mapping[str, Path]
    arguments: Mapping[str, str]
    cached: bool = False


def robot_description(urdf: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> RobotDescription:
    """What a user named as the robot: a file, or a robot by its name; what the user says of either comes first.

    Raises:
        RobotError: it is no file, and no name of a robot in the cache.
    """
    if not is_name(urdf):
        return RobotDescription(urdf, packages, arguments)
    robot = named_robot(str(urdf))
    return RobotDescription(robot.path, {**robot.packages, **packages}, {**robot.arguments, **arguments}, True)


def is_name(path: Path) -> bool:
    """Tell whether what a user gave for a URDF may be the name of a robot: one word without an ending, and no file."""
    one_word = path.name == str(path) and not path.suffix and len(path.name) <= LONGEST_ROBOT_NAME
    return one_word and not path.exists()


def named_robot(name: str) -> RobotDescription:
    """Find a robot's description in the cache of robot_descriptions.

    Raises:
        RobotError: no such file or robot, or it is not in the cache: nothing is downloaded unasked.
    """
    if importlib.util.find_spec("robot_descriptions") is None:
        raise RobotError(
            f"{shortened(name)}: there is no such file; check its name. If it is meant to be the name of a robot: "
            '`pip install "aridcal[xacro]"` for names to be known'
        )
    # git may use no protocol: what is not in the cache is not fetched
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "GIT_ALLOW_PROTOCOL": "none"}
    try:
        process = subprocess.run(
            [sys.executable, "-P", "-m", __name__, name],
            capture_output=True,
            check=False,
            env=environment,
            timeout=LOOK_SECONDS,
        )
        answer: dict[str, Any] = json.loads(process.stdout)
    except (subprocess.TimeoutExpired, ValueError):
        raise RobotError(f"{shortened(name)}: robot_descriptions does not answer. Name a URDF by its file") from None
    if "known" in answer:
        raise RobotError(
            f"{shortened(name)}: there is no such file, and no robot of that name in robot_descriptions"
            f"{nearest(name, answer['known'])}. `robot_descriptions list` names those that there are"
        )
    full = answer["name"]
    if "why" in answer:
        raise RobotError(
            f"{full}: robot_descriptions has it {answer['why']}. Take another one of its robots, or name a URDF"
        )
    if "path" not in answer:
        raise RobotError(
            f"{full}: is not in the cache of robot_descriptions, and nothing is downloaded unasked: "
            f"`robot_descriptions pull {full}` does that; then run this again"
        )
    packages = {package: Path(place) for package, place in answer["packages"].items()}
    return RobotDescription(Path(answer["path"]), packages, answer["arguments"], True)


def _look(name: str) -> dict[str, Any]:
    """Look for a description here and now: where it is, or why it is not to be had, or the names of all that there are."""
    from robot_descriptions._descriptions import DESCRIPTIONS
    from robot_descriptions._repositories import REPOSITORIES

    full = next((each for each in (name, name + NAME_ENDING) if each in DESCRIPTIONS), None)
    if full is None:
        return {"known": [each.removesuffix(NAME_ENDING) for each, about in DESCRIPTIONS.items() if about.has_urdf]}
    about = DESCRIPTIONS[full]
    if not about.has_urdf:
        return {"name": full, "why": "as " + " and ".join(sorted(each.name for each in about.formats)) + " only"}
    repository = REPOSITORIES.get(about.repository or "")
    if repository is None or not _cached(repository.cache_path):
        return {"name": full}
    try:
        module: Any = importlib.import_module(f"robot_descriptions.{full}")
    except Exception:  # whatever git says when it may not fetch
        return {"name": full}
    path = getattr(module, "URDF_PATH", None) or getattr(module, "XACRO_PATH", "")
    folder = Path(module.PACKAGE_PATH)
    packages = {called(folder) or folder.name: str(folder)} | dict(getattr(module, "XACRO_PACKAGE_PATHS", {}))
    arguments = {} if hasattr(module, "URDF_PATH") else dict(getattr(module, "XACRO_ARGS", {}))
    return {"name": full, "path": path, "packages": packages, "arguments": arguments}


def _cached(cache_path: str) -> bool:
    """Tell whether a repository lies in the cache: else the import alone would begin to clone it."""
    cache = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")).expanduser()
    commit = os.environ.get("ROBOT_DESCRIPTION_COMMIT")
    inside = Path(f"{cache_path}-{commit}") / cache_path if commit else Path(cache_path)
    return (cache / inside / ".git").exists()


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "wb") as ours:
        os.dup2(2, 1)  # what the package prints is no answer
        ours.write(json.dumps(_look(sys.argv[1])).encode())
