"""What the names of a project mean: data and routines of its modules, and which data anything in them may change."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from aridcal.jobs.apply.programs.frames import absent
from aridcal.jobs.apply.programs.rapid.grammar import NAME, DataDeclaration, Module, Routine, Statement, bodies, fold
from aridcal.jobs.apply.programs.rapid.table import (
    FUNCTIONS,
    MODES,
    MOVES,
    READING,
    UNSTEADY,
    WILD,
    WRITING,
    WRITING_FUNCTIONS,
)
from aridcal.jobs.apply.programs.rapid.values import Datum, Scope, component, leaves
from aridcal.jobs.apply.programs.text import Code
from aridcal.jobs.apply.programs.uses import line_name
from aridcal.jobs.apply.programs.walk import Body, Choice, Repeat, Step

CALLED = re.compile(rf"(?<![.\\\w])({NAME})\s*\(")
BARE = re.compile(rf"({NAME})((?:\s*\{{[^{{}};]*\}}|\s*\.\s*{NAME})*)")
WORDS_BEFORE_BRACKETS = frozenset(["not", "and", "or", "xor", "div", "mod"])
OPTION = re.compile(rf"\\\s*({NAME})\s*(:=|\?)?")

INSTRUCTIONS = frozenset({"exitcycle"}) | READING | WRITING | WILD | UNSTEADY | MOVES.keys() | MODES.keys()


@dataclass
class BoundRoutine:
    """A routine with what its names mean.

    Attributes:
        key: Its name among all routines.
        module: That it stands in.
        routine: As it stands there.
        scope: Data that it sees.
        parameters: In their order.
        data: Its own.
    """

    key: str
    module: Module
    routine: Routine
    scope: Scope
    parameters: list[Datum]
    data: list[Datum]

    @property
    def code(self) -> Code:
        """The file."""
        return self.module.code


@dataclass(frozen=True, slots=True)
class Option:
    """An optional argument.

    Attributes:
        name: In small letters.
        sign: ``:=``, ``?`` or nothing.
        span: Of its value.
    """

    name: str
    sign: str
    span: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Arguments:
    """Arguments of a call: those that must stand there, and the optional ones."""

    required: tuple[tuple[int, int], ...] = ()
    options: tuple[Option, ...] = ()

    def option(self, name: str) -> Option | None:
        """An optional argument; None where it is not given."""
        return next((option for option in self.options if option.name == name), None)

    @property
    def spans(self) -> Iterator[tuple[int, int]]:
        """Of all values."""
        yield from self.required
        yield from (option.span for option in self.options if option.sign)


PLAIN = re.compile(
    r"""\s*(\[\s*\[[^][]*\]\s*(?:,\s*\[[^][]*\]\s*)*\]|[^][,\\(){};"]*)((?:\\[^][,\\(){};"]*)*)(?:,|\Z)"""
)
"""An argument in the form of most: a name or a target of plain numbers, with options that are names."""


def arguments(code: Code, start: int, end: int) -> Arguments:
    """Arguments between two places: commas part them, a backslash begins an optional one."""
    text = code.plain[start:end]
    required: list[tuple[int, int]] = []
    options: list[Option] = []
    place = 0
    while place < len(text):
        match = PLAIN.match(text, place)
        if match is None:
            return _any_arguments(code, start, end)
        if match.group(1).strip():
            required.append(code.trimmed(start + match.start(1), start + match.end(1)))
        if match.group(2):
            options += _options(code, start + match.start(2), start + match.end(2))
        place = match.end()
    return Arguments(tuple(required), tuple(options))


def _options(code: Code, start: int, end: int) -> Iterator[Option]:
    """Optional arguments, each without a backslash inside."""
    for option in OPTION.finditer(code.plain, start, end):
        stop = code.plain.find("\\", option.end(), end)
        span = code.trimmed(option.end(), end if stop < 0 else stop)
        yield Option(fold(option.group(1)), option.group(2) or "", span)


def _any_arguments(code: Code, start: int, end: int) -> Arguments:
    """Arguments with brackets in them."""
    required: list[tuple[int, int]] = []
    options: list[Option] = []
    for first, last in code.arguments(start, end):
        cuts = _cuts(code, first, last)
        if cuts[0] > first:
            required.append(code.trimmed(first, cuts[0]))
        for cut, stop in zip(cuts, [*cuts[1:], last], strict=True):
            match = OPTION.match(code.plain, cut, stop)
            if match is not None:
                options.append(Option(fold(match.group(1)), match.group(2) or "", code.trimmed(match.end(), stop)))
    return Arguments(tuple(required), tuple(options))


def _cuts(code: Code, first: int, last: int) -> list[int]:
    """Places of backslashes outside of brackets; the end where there is none."""
    if code.plain.find("\\", first, last) < 0:
        return [last]
    cuts, place = [], first
    for match in re.compile(r"[\\(\[{]").finditer(code.plain, first, last):
        if match.start() < place:
            continue
        if match.group() == "\\":
            cuts.append(match.start())
        else:
            place = max(code.closing(match.start()), match.start())
    return cuts or [last]


@dataclass
class Names:
    """All names of a project.

    Attributes:
        codes: All files, for lines in messages.
        harmless: Routines that the user states as such.
        routines: All, by key.
        stepped: Modes that any statement sets to anything but their default.
        unknown_calls: Why routines may run of which nothing is known; empty where none does.
        scattered: Why routines may be called from anywhere; empty where all calls are plain.
        called: Keys of routines that others call.
        cut_short: Whether a cycle may end before main does, by `ExitCycle`.
    """

    codes: tuple[Code, ...]
    harmless: frozenset[str]
    routines: dict[str, BoundRoutine] = field(default_factory=dict)
    stepped: set[str] = field(default_factory=set)
    scattered: str = ""
    unknown_calls: str = ""
    called: set[str] = field(default_factory=set)
    cut_short: bool = False
    _calls: dict[tuple[int, str], str] = field(default_factory=dict)
    _globals: dict[str, str] = field(default_factory=dict)
    _changed_all: set[bool] = field(default_factory=set)
    _twice: set[str] = field(default_factory=set)
    _edges: list[tuple[Datum, Datum]] = field(default_factory=list)
    _all: list[Datum] = field(default_factory=list)
    _homes: dict[str, BoundRoutine] = field(default_factory=dict)
    _prepared: dict[int, Arguments] = field(default_factory=dict)

    def read(self, modules: Sequence[Module]) -> None:
        """Take in all modules."""
        scopes = self._declare(modules)
        for index, module in enumerate(modules):
            nothing = Routine("", "proc", True, 0)
            self._homes[f"{index}"] = BoundRoutine("", module, nothing, scopes[index], [], [])
            for routine in module.routines:
                self._bind(index, module, routine, scopes[index])
        for bound in self.routines.values():
            for body in bodies(bound.routine):
                for statement in statements(body):
                    self._look(bound, statement)
        self._spread()

    @property
    def data(self) -> list[Datum]:
        """Data of all modules and routines, without parameters."""
        return self._all

    def home(self, datum: Datum) -> BoundRoutine:
        """What the names beside the declaration of data mean."""
        return self.routines[datum.owner] if datum.owner else self._homes[datum.address[0]]

    def line(self, code: Code, place: int) -> str:
        """How messages name a line."""
        return line_name(self.codes, code, place)

    def routine(self, module: Module, name: str) -> str | None:
        """The key of the routine that a module calls by a name; None where no given module has it."""
        own = self._calls.get((id(module), name))
        if own is None or not self.routines[own].routine.local:
            return f"? {name}" if name in self._twice else own or self._globals.get(name)
        return own

    def begin_with(self, module: Module, prefix: str) -> list[str]:
        """Keys of all procedures that a module sees and whose names begin like this."""
        scope = {**self._globals, **{name: key for (owner, name), key in self._calls.items() if owner == id(module)}}
        return [
            key
            for name, key in scope.items()
            if name.startswith(prefix) and name not in self._twice and self.routines[key].routine.kind == "proc"
        ]

    def arguments(self, bound: BoundRoutine, statement: Statement) -> Arguments:
        """Arguments of a call."""
        given = self._prepared.get(id(statement))
        if given is None:
            start = statement.body if statement.kind == "call" else late(bound.code, statement)[1]
            given = arguments(bound.code, start, statement.end)
            if not self._is_plain_move(bound, statement):  # there are too many moves to keep theirs
                self._prepared[id(statement)] = given
        return given

    def _is_plain_move(self, bound: BoundRoutine, statement: Statement) -> bool:
        """Whether a statement is a move of the controller's own that changes no data and calls nothing."""
        move = MOVES.get(statement.name) if statement.kind == "call" else None
        if move is None or move.written or move.routine is not None:
            return False
        return self.routine(bound.module, statement.name) is None

    def _declare(self, modules: Sequence[Module]) -> list[Scope]:
        """Data of modules: each sees its own, then those of all others that are not local."""
        everywhere: dict[str, Datum] = {}
        levels: list[dict[str, Datum]] = []
        aliases = {name: kind for module in modules for name, kind in module.aliases.items()}
        for index, module in enumerate(modules):
            own: dict[str, Datum] = {}
            for declared in module.data:
                datum = self._datum(declared, module.code, f"{index}", aliases)
                name = fold(declared.name)
                twice = own.get(name) or (None if declared.local else everywhere.get(name))
                if twice is not None:
                    first = self.line(twice.code, twice.declared.place)
                    why = f"{first} and {self.line(module.code, declared.place)} declare it"
                    self._change_whole(twice, why)
                    self._change_whole(datum, why)
                own[name] = datum
                if not declared.local:
                    everywhere.setdefault(name, datum)
            levels.append(own)
        self._aliases = aliases
        return [Scope((own, everywhere)) for own in levels]

    def _datum(self, declared: DataDeclaration, code: Code, owner: str, aliases: dict[str, str]) -> Datum:
        kind = declared.type
        for _ in aliases:
            kind = aliases.get(kind, kind)
        datum = Datum(declared, code, (owner, fold(declared.name)), kind)
        self._all.append(datum)
        return datum

    def _bind(self, index: int, module: Module, routine: Routine, scope: Scope) -> None:
        name = fold(routine.name)
        key = f"{index} {name}"
        parameters = [self._datum(declared, module.code, key, self._aliases) for declared in routine.parameters]
        del self._all[len(self._all) - len(parameters) :]
        data = [self._datum(declared, module.code, key, self._aliases) for declared in routine.data]
        own = {datum.address[1]: datum for datum in (*parameters, *data)}
        for datum in (*parameters, *data):
            datum.owner = key
        for datum in parameters:
            datum.parameter = True
        self.routines[key] = BoundRoutine(key, module, routine, Scope((own, *scope.levels)), parameters, data)
        self._calls[id(module), name] = key
        if not routine.local:
            self._twice |= {name} if name in self._globals else set()
            self._globals[name] = key

    def _look(self, bound: BoundRoutine, statement: Statement) -> None:
        """What a statement may change, for the whole project."""
        code = bound.code
        why = f"{self.line(code, statement.start)} changes it"
        if statement.kind == "assign":
            path = code.plain[statement.start : statement.body].rstrip().removesuffix(":=")
            self._change(bound, statement.name, why, path if "{" not in path else "")
        elif statement.kind in ("call", "late"):
            self._look_at_call(bound, statement, why)
        elif statement.kind == "connect" and self.missing_trap(bound, statement):
            self._scatter(bound, Arguments(), why, absent(statement.name))
        for name, start, end in calls(code, statement.body, statement.end):
            self._look_at_function(bound, name, arguments(code, start, end), why)

    def missing_trap(self, bound: BoundRoutine, statement: Statement) -> bool:
        """Whether no given file has the routine that a `CONNECT` names."""
        return self.routine(bound.module, statement.name) not in self.routines and statement.name not in self.harmless

    def _look_at_call(self, bound: BoundRoutine, statement: Statement, why: str) -> None:
        if self._is_plain_move(bound, statement):
            return
        given, name = self.arguments(bound, statement), statement.name
        if statement.kind == "late":
            prefix, _, whole = late(bound.code, statement)
            keys = self.begin_with(bound.module, prefix) if prefix else []
            if prefix and whole:
                keys = [key for key in keys if key.split(" ", 1)[1] == prefix]
            for parameter in keys:
                self._pass_on(bound, self.routines[parameter], given, why)
            if not keys and not (whole and prefix in self.harmless):
                if not whole:
                    self.scattered = self.scattered or f"{why[:-11]} calls a procedure by a worked out name"
                self._scatter(bound, given, why, absent(prefix) if whole else self.scattered)
            return
        key = self.routine(bound.module, statement.name)
        if key is not None and key in self.routines:
            self._pass_on(bound, self.routines[key], given, why)
        elif key is None and name in INSTRUCTIONS:
            self._look_at_instruction(bound, name, given, why)
        elif name not in self.harmless:
            self._scatter(bound, given, why, absent(name))

    def _look_at_instruction(self, bound: BoundRoutine, name: str, arguments: Arguments, why: str) -> None:
        self.cut_short |= name == "exitcycle"
        if name in WRITING:
            for span in arguments.spans:
                self._change_span(bound, span, why)
        if name in MOVES:
            for k in MOVES[name].written:
                if k < len(arguments.required):
                    self._change_span(bound, arguments.required[k], why)
            routine = MOVES[name].routine
            if routine is not None and routine < len(arguments.required):
                self._look_at_named(bound, quoted_name(bound.code, arguments.required[routine]), why)
        if name in MODES and MODES[name][1] != "default":
            self.stepped.add(MODES[name][0])
        if name in WILD:
            self.unknown_calls = self.unknown_calls or f"{why[:-11]} may change all modes ({name})"
            if name == "callbyvar":
                self.scattered = self.scattered or f"{why[:-11]} calls a procedure by a worked out name"
            self._change_all(f"{why[:-11]} may change all data ({name})", local=True)

    def _look_at_named(self, bound: BoundRoutine, name: str, why: str) -> None:
        """A move calls a procedure that a text names."""
        key = self.routine(bound.module, name)
        if key is not None and key in self.routines:
            self._pass_on(bound, self.routines[key], Arguments(), why)
        elif name not in self.harmless:
            reason = absent(name) if name else f"{why[:-11]} calls a procedure by a worked out name"
            self.scattered = self.scattered or ("" if name else reason)
            self._scatter(bound, Arguments(), why, reason)

    def _change_all(self, why: str, local: bool) -> None:
        """Data of modules may be changed: those that others see, or also the local ones."""
        if local in self._changed_all:
            return
        self._changed_all |= {local, False}
        for datum in self._all:
            if not datum.owner and datum.declared.storage != "const" and (local or not datum.declared.local):
                self._change_whole(datum, why)

    def _look_at_function(self, bound: BoundRoutine, name: str, arguments: Arguments, why: str) -> None:
        key = self.routine(bound.module, name)
        if key is not None and key in self.routines:
            self._pass_on(bound, self.routines[key], arguments, why)
        elif key is None and name in FUNCTIONS:
            if name in WRITING_FUNCTIONS:
                for span in arguments.spans:
                    self._change_span(bound, span, why)
        elif name not in self.harmless:
            self._scatter(bound, arguments, why, absent(name))

    def _scatter(self, bound: BoundRoutine, arguments: Arguments, why: str, reason: str) -> None:
        """A routine that is not known may change what it is given, and all that it sees."""
        self.unknown_calls = self.unknown_calls or reason
        for span in arguments.spans:
            self._change_span(bound, span, why)
        self._change_all(reason, local=False)

    def _pass_on(self, bound: BoundRoutine, callee: BoundRoutine, arguments: Arguments, why: str) -> None:
        """What the routine changes of its parameters, it changes of the data that they stand for."""
        if callee is not bound:
            self.called.add(callee.key)
        for parameter, span in matched(callee, arguments):
            if parameter.declared.storage in ("var", "pers", "inout") and span is not None:
                match = BARE.fullmatch(bound.code.plain, *span)
                datum = bound.scope.datum(fold(match.group(1))) if match else None
                if datum is not None:
                    self._edges.append((parameter, datum))

    def _change_span(self, bound: BoundRoutine, span: tuple[int, int], why: str) -> None:
        match = BARE.fullmatch(bound.code.plain, *span)
        if match is not None:
            self._change(bound, fold(match.group(1)), why)

    def _change(self, bound: BoundRoutine, name: str, why: str, path: str = "") -> None:
        """Data may be changed, or a part of it."""
        datum = bound.scope.datum(name)
        if datum is None or datum.declared.storage == "const":
            return
        part = component(datum.type, path) if "." in path else None
        if part is None or datum.parameter:
            self._change_whole(datum, why)
        else:
            datum.changed = datum.changed or why
            datum.leaves |= frozenset(leaves(part[1], part[0]))

    def _change_whole(self, datum: Datum, why: str) -> None:
        datum.changed, datum.whole = datum.changed or why, True

    def _spread(self) -> None:
        """Parameters that are changed change what they stand for, however far away."""
        callers: dict[int, list[Datum]] = {}
        for parameter, datum in self._edges:
            callers.setdefault(id(parameter), []).append(datum)
        waiting = [parameter for parameter, _ in self._edges if parameter.changed]
        while waiting:
            parameter = waiting.pop()
            for datum in callers.get(id(parameter), ()):
                if not datum.whole and datum.declared.storage != "const":
                    self._change_whole(datum, parameter.changed)
                    waiting.append(datum)


def matched(callee: BoundRoutine, arguments: Arguments) -> Iterator[tuple[Datum, tuple[int, int] | None]]:
    """Each parameter of a routine with what is given for it; None where nothing is."""
    required = iter(arguments.required)
    for parameter in callee.parameters:
        if parameter.declared.optional:
            option = arguments.option(parameter.address[1])
            yield parameter, option.span if option is not None and option.sign else None
        else:
            yield parameter, next(required, None)


def calls(code: Code, start: int, end: int) -> Iterator[tuple[str, int, int]]:
    """Functions that an expression calls, in small letters, with the span of their arguments."""
    if code.plain.find("(", start, end) < 0:
        return
    for match in CALLED.finditer(code.plain, start, end):
        name = fold(match.group(1))
        if name not in WORDS_BEFORE_BRACKETS:
            yield name, match.end(), max(min(code.closing(match.end() - 1), end), match.end())


def late(code: Code, statement: Statement) -> tuple[str, int, bool]:
    """What the name of a procedure begins with, where its arguments begin, and whether that is the whole name."""
    start = statement.start + 1
    end = code.plain.find("%", start, statement.end)
    if end < 0:
        return "", statement.end, False
    match = re.compile(r'\s*"(?: *)"\s*(\+)?').match(code.plain, start, end)
    if match is None:
        return "", end + 1, False
    text = code.text[start : match.end()].strip().rstrip("+").strip().strip('"')
    whole = match.group(1) is None and not code.plain[match.end() : end].strip()
    return (fold(text) if whole or match.group(1) else ""), end + 1, whole


def quoted_name(code: Code, span: tuple[int, int]) -> str:
    """The name that a text in quotes says, in small letters; empty where it is worked out."""
    text = code.text[slice(*span)].strip()
    plain = len(text) > 2 and text[0] == text[-1] == '"' and text.count('"') == 2
    return fold(text[1:-1]) if plain else ""


def statements(body: Body) -> Iterable[Statement]:
    """All statements of a body."""
    for node in body:
        if isinstance(node, Step):
            assert isinstance(node.what, Statement)
            yield node.what
        elif isinstance(node, Choice):
            for way in node.ways:
                yield from statements(way)
        elif isinstance(node, Repeat):
            yield from statements(node.body)
