"""Which variable a name of URScript is.

The manual: a name that is declared neither global nor local is the global variable if there is one, else one of its function.
Whether there is one may depend on what has run before, so that a name which several functions set is certain only where one of
them has just set it.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from aridcal.jobs.apply.programs.urscript.grammar import File, Routine

LOCAL, GLOBAL, SHARED, UNSURE = "local", "global", "shared", "unsure"
"""Families of variables: of one call of a routine; of a program; set by several functions; local to a routine around this one,
which the manual does not say to be seen."""


class Scopes:
    """The variables of a project.

    Args:
        files: As routines.
        one: Whether the files are one program, with one set of global names.
    """

    def __init__(self, files: Sequence[File], one: bool) -> None:
        self._one = one
        self.shared: set[tuple[int, str]] = set()
        self._keys: dict[tuple[str, str], tuple[str, Hashable]] = {}
        setters: dict[tuple[int, str], list[tuple[int, int]]] = {}
        declared: dict[tuple[int, str], tuple[int, int]] = {}
        for number, file in enumerate(files):
            for name, place in file.declared.items():
                declared.setdefault((self._space(number), name), (number, place))
            for routine in file.routines:
                for name, place in routine.assigned.items():
                    if name not in routine.local:
                        setters.setdefault((self._space(number), name), []).append((number, place))
        for variable, places in setters.items():
            several = len(places) + (variable in declared) > 1
            if several and min(places) < declared.get(variable, (len(files), 0)):
                self.shared.add(variable)

    def _space(self, file: int) -> int:
        return 0 if self._one else file

    def key(self, routine: Routine, name: str) -> tuple[str, Hashable]:
        """Family and member of a variable, as a routine says it."""
        key = self._keys.get((routine.key, name))
        if key is None:
            key = self._keys[routine.key, name] = self._resolved(routine, name)
        return key

    def _resolved(self, routine: Routine, name: str) -> tuple[str, Hashable]:
        if name in routine.local:
            return LOCAL, (routine.key, name)
        around = routine.parent
        while around is not None:
            if name in around.local:
                return UNSURE, (routine.key, name)
            around = around.parent
        variable = (self._space(routine.file), name)
        return (SHARED if variable in self.shared else GLOBAL), variable
