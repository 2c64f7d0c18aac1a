"""URDFs as they are written: read whole, and where they are xacro, expanded by a process of its own within limits.

Run as a program, this module is that process. A xacro file holds expressions of Python that its reader evaluates
(``${...}``, ``$(eval ...)``), includes other files and reads YAML. It is kept to that: see
:mod:`aridcal.engine.robot.xacro_expressions`, and the limits in :func:`_within_limits`. What nobody trusts is better
expanded on another machine all the same.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from lxml import etree

from aridcal.engine.robot.packages import HINT, find_package
from aridcal.engine.robot.xacro_expressions import evaluate, forget_others
from aridcal.system.errors import RobotError, nearest, shortened
from aridcal.system.reading.regular_files import MEGA, URDF, Limit, read_file

SECONDS = 20
"""For one file, of CPU and of the clock; the largest public ones, humanoids with hands, take 2 s."""

MEMORY_GB = 1.0
"""Address space: xacro holds a document of 20 MB in 0.5 GB."""

MOST_OPEN_FILES = 64
"""Open at a time: includes are nested a few deep."""

NAMESPACE = "xacro"
"""What the namespaces of xacro end in; there are several, and all are in use."""

UNDEFINED = re.compile(r"Undefined substitution argument (\S+)")


def read_urdf(
    path: Path,
    limit: Limit = URDF,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
) -> bytes:
    """Read a robot's description as plain URDF.

    Args:
        path: A URDF, in any encoding that it declares, or a xacro file.
        limit: How large it may be, as it is and expanded.
        packages: Where packages of ROS are that are not found otherwise.
        arguments: Values of the xacro file's arguments.

    Returns:
        The file's own bytes if it has no macros, else what they expand to.

    Raises:
        RobotError: it cannot be read, or cannot be expanded.
    """
    content = read_file(path, RobotError, limit)
    if not is_xacro(content, path):
        if arguments:
            raise RobotError(f"{path}: is no xacro file, which alone has arguments: delete {', '.join(arguments)}")
        return content
    if b"<!DOCTYPE" in content:
        raise RobotError(f"{path}: has a DOCTYPE: DTDs and entities are refused. Remove it from the file")
    if importlib.util.find_spec("xacrodoc") is None:
        raise RobotError(
            f'{path}: holds xacro macros: `pip install "aridcal[xacro]"` for them to be read, or run xacro first and '
            "name the URDF that it writes"
        )
    return _expanded(path, limit, packages or {}, arguments or {})


def plain_name(path: Path) -> Path:
    """Return the name under which a description would lie as plain URDF: without the ending ``.xacro``."""
    if path.suffix.lower() != ".xacro":
        return path
    return path.with_suffix("") if Path(path.stem).suffix else path.with_suffix(".urdf")


def is_xacro(content: bytes, path: Path) -> bool:
    """Tell whether a description has macros to expand: by its name, or by elements in xacro's namespace."""
    if path.suffix.lower() == ".xacro":
        return True
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, recover=True)
    try:
        root = etree.fromstring(content, parser)
    except (etree.XMLSyntaxError, ValueError):
        return False  # whoever reads it as XML says what is wrong
    if root is None:
        return False
    tags = (str(element.tag) for element in root.iter() if isinstance(element.tag, str))
    return any(tag.startswith("{") and tag[1:].partition("}")[0].rstrip("/").endswith(NAMESPACE) for tag in tags)


def _expanded(path: Path, limit: Limit, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> bytes:
    request = {
        "path": str(path.absolute()),
        "packages": {name: str(place.absolute()) for name, place in packages.items()},
        "arguments": dict(arguments),
        "bytes": int(limit.megabytes * MEGA),
        "seconds": SECONDS,
    }
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        # -P: no module from the folder where the user happens to be
        process = subprocess.run(
            [sys.executable, "-P", "-m", __name__], input=json.dumps(request).encode(), capture_output=True, check=False,
            env=environment, timeout=SECONDS + 10,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise _endless(path) from None
    try:
        answer: dict[str, Any] = json.loads(process.stdout)
    except ValueError:
        if process.returncode in (-signal.SIGXCPU, -signal.SIGALRM, -signal.SIGKILL):
            raise _endless(path) from None
        raise RobotError(
            f"{path}: xacro died of it (status {process.returncode}), perhaps for want of memory: at most {MEMORY_GB:g} GB are "
            "given. Run xacro first, and name the URDF that it writes"
        ) from None
    if "urdf" in answer:
        return str(answer["urdf"]).encode()
    raise RobotError(_remedy(path, answer))


def _endless(path: Path) -> RobotError:
    return RobotError(
        f"{path}: xacro takes more than {SECONDS} s: look for a macro that calls itself, or run xacro first and name the URDF "
        "that it writes"
    )


def _remedy(path: Path, answer: Mapping[str, Any]) -> str:
    """Say what is wrong with a xacro file, and what to do."""
    if package := answer.get("package"):
        return f"{path}: needs the package {package!r}, which is not found: {HINT.format(name=package)}"
    if unknown := answer.get("unknown"):
        about = nearest(unknown, answer["known"])
        return f"{path}: has no argument {unknown!r}{about}. Its arguments: {', '.join(answer['known']) or 'none'}"
    if megabytes := answer.get("megabytes"):
        return f"{path}: expands to {megabytes:.1f} MB, more than may be read: shorten it"
    why = " ".join(str(answer.get("why", "")).split()).partition(" when evaluating expression")[0]
    if match := UNDEFINED.search(why):
        name = match[1]
        return (
            f"{path}: its argument {name!r} has no value: give it one with `--argument {name}=VALUE` (in a campaign: "
            f"`robot.arguments: {{{name}: VALUE}}`)"
        )
    return f"{path}: xacro cannot expand it: {shortened(why, 500)}. Mend it, or run xacro first and name what it writes"


class _Arguments(dict[str, str]):
    """Values of arguments, and which arguments the file has."""

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.known: dict[str, None] = {}

    def __contains__(self, name: object) -> bool:
        self.known[str(name)] = None
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.known[name] = None
        return super().__getitem__(name)


class _NoPackage(Exception):
    """A package was not found."""


def _answer(request: Mapping[str, Any]) -> dict[str, Any]:
    """Expand a file here and now: the URDF, or why there is none."""
    import xacrodoc.xacrodoc as doc

    path = Path(request["path"])
    places = {name: Path(place) for name, place in request["packages"].items()}
    missing: list[str] = []

    def find(name: str) -> str:
        folder = find_package(name, path.parent, places)
        if folder is None:
            missing.append(name)
            raise _NoPackage(name)
        return str(folder.absolute())

    values = _Arguments(request["arguments"])
    doc.packages.get_path = find
    forget_others(doc.xacro._global_symbols)
    doc.xacro.safe_eval = doc.substitution_args.eval = evaluate
    doc.substitution_args._eval_dict["find"] = find
    _within_limits(request["seconds"])
    try:
        doc.xacro.init_stacks(request["path"])
        document = doc.xacro.parse(None, request["path"])
        doc.xacro.process_doc(document, mappings=values)
        urdf = document.toprettyxml(indent="  ")
    except Exception as error:  # whatever a file makes of xacro
        if isinstance(getattr(error, "exc", None) or error, MemoryError):
            return {"why": f"takes more than {MEMORY_GB:g} GB"}
        return {"package": missing[-1]} if missing else {"why": str(error) or type(error).__name__}
    unknown = [name for name in request["arguments"] if name not in values.known]
    if unknown:
        return {"unknown": unknown[0], "known": list(values.known)}
    megabytes = len(urdf.encode()) / MEGA
    return {"urdf": urdf} if megabytes * MEGA <= request["bytes"] else {"megabytes": megabytes}


def _within_limits(seconds: int) -> None:
    """From now on: no byte goes to a file, no process begins (but root's may), memory and time are short."""
    most = int(1e9 * MEMORY_GB)
    limits = {
        resource.RLIMIT_AS: most,
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_NOFILE: MOST_OPEN_FILES,
        resource.RLIMIT_NPROC: 0,
    }
    for which, value in limits.items():
        _, hard = resource.getrlimit(which)
        least = value if hard == resource.RLIM_INFINITY else min(value, hard)
        with suppress(ValueError, OSError):  # macOS refuses a limit of memory
            resource.setrlimit(which, (least, least))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(seconds)


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "wb") as ours:
        os.dup2(2, 1)  # what xacro prints is no answer
        ours.write(json.dumps(_answer(json.load(sys.stdin))).encode())
