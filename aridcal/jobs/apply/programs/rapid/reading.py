"""Targets of a project of RAPID modules."""

from __future__ import annotations

from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.rapid.grammar import MODULE, MalformedStatement, Module, blanked, fold, modules
from aridcal.jobs.apply.programs.rapid.meaning import GUARDED, Meaning
from aridcal.jobs.apply.programs.rapid.names import Names
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import NONE, Code
from aridcal.jobs.apply.programs.walk import Call, Choice, Node, ProgramState, Repeat, Step, TooManyWays, Walk

FIRST = ""
"""The key of what a controller begins with."""

TOO_LONG = "the program has more ways than can be followed"


def read(project: Project, cell: Cell) -> ProgramReading:
    """Targets of a project, in the order in which the robot goes there."""
    codes = tuple(Code(k, s.path.name, s.text, blanked(s.text)) for k, s in enumerate(project.sources))
    try:
        parsed, notes = _modules(project, codes)
        names = Names(codes, cell.frames.harmless)
        names.read(parsed)
    except _Broken as broken:
        return ProgramReading([broken.target], ())
    meaning = Meaning(names, cell, project.sources)
    try:
        _walk(meaning, names)
    except TooManyWays:
        meaning.leave_all(TOO_LONG)
    if names.unknown_calls and any(fold(bound.routine.name) == "main" for bound in names.routines.values()):
        notes.append(
            f"each cycle of main is taken to begin in the controller's own modes, though {names.unknown_calls}"
        )
    ledger, points = meaning.ledger, meaning.points
    meaning.end()
    del meaning, names, parsed  # a long program's are larger than its targets
    return ProgramReading(ledger.targets(points.target), tuple(notes))


class _Broken(Exception):
    """A file that cannot be read, as the one target that is left."""

    def __init__(self, target: Target) -> None:
        super().__init__(target.why)
        self.target = target


def _modules(project: Project, codes: tuple[Code, ...]) -> tuple[list[Module], list[str]]:
    """All modules of the program, and sentences on files that are no part of it."""
    given: list[Module] = []
    notes: list[str] = []
    for source, code in zip(project.sources, codes, strict=True):
        try:
            modules_of_file = modules(code)
        except MalformedStatement as problem:
            if not source.ours and MODULE.search(code.plain) is None:
                notes.append(f"{source.path}: is no RAPID: not looked at")
                continue
            raise _Broken(_broken(code, codes, problem)) from None
        twice = None if source.ours else _clash(given, modules_of_file)
        if twice:
            notes.append(f"{source.path}: declares {twice}, too, so that it is part of another program: not looked at")
        else:
            given += modules_of_file
    return given, notes


def _broken(code: Code, codes: tuple[Code, ...], problem: MalformedStatement) -> Target:
    line = code.line(problem.place)
    name = code.name if len(codes) > 1 else "the program"
    why = f"{code.name} line {line} is not understood, so that nothing is corrected: {problem}"
    return Target(line, name, "pose", NONE, why, file=code.file)


def _clash(modules: list[Module], modules_of_file: list[Module]) -> str:
    """A name that modules of one task cannot both declare for all; empty where there is none."""
    names = {name for module in modules for name in _global_names(module)}
    return next((name for module in modules_of_file for name in _global_names(module) if fold(name) in names), "")


def _global_names(module: Module) -> list[str]:
    data = [fold(own.name) for own in module.data if not own.local]
    return [*data, *(fold(own.name) for own in module.routines if not own.local)]


def _walk(meaning: Meaning, names: Names) -> None:
    walk = Walk({**meaning.bodies, FIRST: _first(meaning, names)}, meaning)
    state = ProgramState()
    meaning.begin(state)
    for key, bound in names.routines.items():
        if bound.routine.kind == "trap":
            state.volatile(walk.writes(key, state), f"the interrupt {bound.routine.name} changes it")
        if bound.routine.handlers:
            state.volatile(
                walk.writes(f"{key} handlers", state), f"the error handler of {bound.routine.name} changes it"
            )
    walk.reached.clear()  # what was looked at above has written nothing down
    walk.enter(FIRST, state)
    for key, bound in names.routines.items():
        if key not in walk.reached and f"{key}{GUARDED}" not in walk.reached:
            meaning.begin(state)
            if bound.routine.kind == "trap" or names.scattered:
                meaning.anywhere(state)
            walk.enter(key, state)


def _first(meaning: Meaning, names: Names) -> list[Node]:
    """What the controller begins with: main, or, where no given file has it, all that it may call, one after another.

    Main begins anew at its end, and then in the modes that it has set there.
    """
    every = [(key, bound.routine) for key, bound in names.routines.items() if bound.routine.kind == "proc"]
    main = [Call(key, None) for key, routine in every if fold(routine.name) == "main" and not routine.local]
    if main and not names.stepped:
        return [*main[:1]]
    if main:
        cut = (Choice(((), (Step(meaning.anywhere),))),) if names.cut_short else ()
        return [Repeat((*cut, *main[:1], Step(meaning.end_cycle)), once=True)]
    ways = tuple((Call(key, None),) for key, _ in every if key not in names.called)
    return [Repeat((Choice(ways),), once=True)] if ways else []
