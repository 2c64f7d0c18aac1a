"""Which variable and which routine a name is: of the routine, of its module, or of the whole project."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import PurePath

from aridcal.jobs.apply.programs.krl.tokens import plain
from aridcal.jobs.apply.programs.text import Code

_MODULE = re.compile(
    r"^[ \t]*(?:global[ \t]+)?(?:defdat[ \t]+|def[ \t]+|deffct[ \t]+[\w$]+(?:[ \t]*\[[^\]\n]*\])?[ \t]+)([\w$]+)",
    re.M | re.A,
)

_HEAD = re.compile(
    r"^[ \t]*+(?P<shared>global[ \t]++)?(?:def|deffct[ \t]++[\w$]++(?:[ \t]*+\[[^\]\n]*+\])?)[ \t]++(?P<name>[\w$]++)"
    r"[ \t]*+(?:\((?P<parameters>[^)\n]*+)\))?[ \t\r]*+$",
    re.M | re.A,
)

_PARAMETER = re.compile(r"\s*([\w$]+)\s*(?:\[[\s,]*\])?\s*(?::\s*(in|out))?\s*", re.A)


@dataclass(frozen=True)
class File:
    """A file of a project.

    Attributes:
        index: In the project.
        code: Its text.
        ours: Whether it is to be corrected.
        data: Whether it is a data list.
    """

    index: int
    code: Code
    ours: bool
    data: bool

    @cached_property
    def module(self) -> str:
        """The module that it belongs to: a .src and its .dat have one name."""
        match = _MODULE.search(self.code.plain)
        return match.group(1) if match else self.stem

    @property
    def stem(self) -> str:
        """The name of the file."""
        return PurePath(self.code.name).stem.lower()

    def heads(self) -> Iterable[re.Match[str]]:
        """Where its routines begin."""
        return _HEAD.finditer(self.code.plain)


def file_of(index: int, name: str, text: str, ours: bool) -> File:
    """A file as the reader takes it."""
    return File(index, Code(index, name, text, plain(text)), ours, name.lower().endswith(".dat"))


@dataclass(frozen=True)
class RoutineHead:
    """The beginning of a routine.

    Attributes:
        key: Among the project's routines.
        name: In small letters.
        parameters: Names, and whether each is handed over by value.
    """

    key: str
    name: str
    parameters: tuple[tuple[str, bool], ...]


@dataclass
class Names:
    """All names of a project.

    Attributes:
        types: Of variables, by key.
        twice: Names of routines and modules that several files have.
    """

    types: dict[str, str] = field(default_factory=dict)
    twice: set[str] = field(default_factory=set)
    _own: dict[str, set[str]] = field(default_factory=dict)
    _routines: dict[tuple[str, str], RoutineHead] = field(default_factory=dict)

    def take_heads(self, file: File) -> None:
        """Note which routines a file has."""
        for order, match in enumerate(file.heads()):
            name = match.group("name")
            key = f"{file.index}/{name}"
            parameters = tuple(
                (m.group(1), m.group(2) == "in")
                for part in (match.group("parameters") or "").split(",")
                if (m := _PARAMETER.fullmatch(part))
            )
            scopes = [str(file.index)]
            if order == 0 or match.group("shared"):
                scopes.append("")
            for scope in scopes:
                if (scope, name) in self._routines:
                    self.twice.add(name)
                self._routines[scope, name] = RoutineHead(key, name, parameters)

    def routine(self, file: File, name: str) -> RoutineHead | None:
        """The routine that a call in a file means; None if no file has it, or several have."""
        head = self._routines.get((str(file.index), name)) or self._routines.get(("", name))
        return None if head is None or name in self.twice else head

    def declare(self, scope: str, name: str, kind: str, shared: bool) -> str:
        """A variable of a module or of a routine, ``module`` or ``module/routine``; gives its key."""
        key = sys.intern(name if shared else f"{scope}:{name}")
        self.types[key] = kind
        if not shared:
            self._own.setdefault(scope, set()).add(name)
        return key

    def resolve(self, module: str, routine: str, name: str) -> tuple[str, bool]:
        """The key of a variable, one string wherever it stands, and whether routines of all files reach it."""
        for scope in (f"{module}/{routine}", module):
            if name in self._own.get(scope, ()):
                return sys.intern(f"{scope}:{name}"), False
        return sys.intern(name), True
