"""URScript programs: their targets, by a walk along all ways of each program."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import NONE, Code
from aridcal.jobs.apply.programs.urscript.grammar import (
    File,
    MalformedProgram,
    Parser,
    Routine,
    code_of,
    definitions,
)
from aridcal.jobs.apply.programs.urscript.meaning import DEFAULT, THREADED, Meaning
from aridcal.jobs.apply.programs.urscript.scopes import Scopes
from aridcal.jobs.apply.programs.urscript.table import MOVES
from aridcal.jobs.apply.programs.walk import ProgramState, TooManyWays, Walk

BASE_NOTE = "poses are taken in the link `base` of the URDF, as the controller counts them; --frames may state another"

LONE_RETURN = re.compile(r"\r(?!\n)")

MOVE = re.compile(rf"\b(?:{'|'.join(MOVES)})\s*+\(")


def read(project: Project, cell: Cell) -> ProgramReading:
    """Targets of a project.

    Raises:
        AridcalError: it has poses, and nothing says where the controller counts them from.
    """
    codes = tuple(code_of(k, source.path.name, source.text) for k, source in enumerate(project.sources))
    files, one, kept_targets = _parsed(codes)
    routines = {routine.key: routine for file in files.values() for routine in file.routines}
    empty = File([], {}, {})
    listed = [files.get(k, empty) for k in range(len(codes))]
    meaning = Meaning(codes, project, cell, routines, Scopes(listed, one), [file.titles for file in listed])
    try:
        _walked(meaning, files)
    except (TooManyWays, RecursionError):
        why = "the program has too many ways, or calls too deep, to be followed"
        return ProgramReading([target for code in codes for target in _all_left(code, why)])
    finally:
        meaning.walk = (
            None  # they hold each other, as routines and the names in them do, and all that was made of the text
        )
        for routine in routines.values():
            routine.body = ()
    notes = (BASE_NOTE,) if meaning.poses and DEFAULT not in cell.frames.bases else ()
    return ProgramReading([*meaning.targets(), *kept_targets], notes)


def comment(text: str, sentence: str) -> tuple[int, str]:
    """A comment behind all that there is."""
    end = "\r\n" if "\r\n" in text else "\n"
    return len(text), f"{'' if not text or text.endswith(chr(10)) else end}# {sentence}{end}"


def _parsed(codes: tuple[Code, ...]) -> tuple[dict[int, File], bool, list[Target]]:
    """Files that can be read, whether they call each other, and what the others leave."""
    kept_targets: list[Target] = []
    whole: list[Code] = []
    for code in codes:
        lone = LONE_RETURN.search(code.text)
        if lone:
            kept_targets += _all_left(
                code, f"{code.name} has a carriage return without a line feed: write its line ends anew"
            )
        else:
            whole.append(code)
    names, keys = _named(whole)
    files, one = {}, False
    for code in whole:
        own = names[code.file]
        others: dict[str, list[str]] = {}
        for name, elsewhere in ((n, k) for file in names if file != code.file for n, k in names[file].items()):
            others.setdefault(name, []).extend(elsewhere)
        try:
            files[code.file] = Parser(code, {**others, **own}, keys[code.file]).file()
        except MalformedProgram as problem:
            kept_targets += _all_left(code, f"{code.name} is no whole program: {problem}")
        else:
            mine = set(keys[code.file].values())
            one = one or any(not routine.calls <= mine for routine in files[code.file].routines)
    return files, one, kept_targets


def _named(codes: list[Code]) -> tuple[dict[int, dict[str, list[str]]], dict[int, dict[int, str]]]:
    """Keys of the routines of each file by their names, and by their places: their names, numbered where several have one."""
    names: dict[int, dict[str, list[str]]] = {}
    keys: dict[int, dict[int, str]] = {}
    count: Counter[str] = Counter()
    for code in codes:
        names[code.file], keys[code.file] = {}, {}
        for name, place in definitions(code):
            count[name] += 1
            key = name if count[name] == 1 else f"{name} {count[name]}"
            names[code.file].setdefault(name, []).append(key)
            keys[code.file][place] = key
    return names, keys


def _walked(meaning: Meaning, files: dict[int, File]) -> None:
    """Walk all programs of the files: what stands outside of functions, then functions that nothing calls, then threads."""
    routines = {routine.key: routine for file in files.values() for routine in file.routines}
    walk = meaning.walk = Walk({key: routine.body for key, routine in routines.items()}, meaning)
    callees = {key for routine in routines.values() for key in routine.calls if key != routine.key}
    for file in files.values():
        top, *others = file.routines
        state = meaning.begin()
        walk.enter(top.key, state)
        for routine in _entries(others, callees, walk):
            walk.enter(routine.key, ProgramState(state))
    for routine in routines.values():
        if routine.kind == "thread":
            state = ProgramState()
            state.forget_all(THREADED)
            walk.enter(routine.key, state)


def _entries(routines: list[Routine], callees: set[str], walk: Walk) -> Iterator[Routine]:
    """Functions that nothing calls; then those that only such call as nothing comes to."""
    functions = [routine for routine in routines if routine.kind != "thread"]
    yield from (routine for routine in functions if routine.key not in callees)
    yield from (routine for routine in functions if routine.key not in walk.reached)


def _all_left(code: Code, why: str) -> Iterator[Target]:
    """All moves of a file that cannot be read."""
    for move in MOVE.finditer(code.plain):
        yield Target(code.line(move.start()), move.group(), "pose", NONE, why, file=code.file)
