"""A project of KRL as targets."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from pathlib import Path

from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import KnownFrames
from aridcal.jobs.apply.programs.krl import table
from aridcal.jobs.apply.programs.krl.grammar import MalformedProgram, Reader
from aridcal.jobs.apply.programs.krl.meaning import Meaning
from aridcal.jobs.apply.programs.krl.names import File, Names, file_of
from aridcal.jobs.apply.programs.krl.points import Points
from aridcal.jobs.apply.programs.krl.project_facts import Mention, ProjectFacts
from aridcal.jobs.apply.programs.krl.syntax import Aggregate, Function, Move, UnclearStatement, Variable
from aridcal.jobs.apply.programs.krl.values import Element, foot
from aridcal.jobs.apply.programs.krl.writing import END_OF_FILE
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import NONE
from aridcal.jobs.apply.programs.uses import Frame, Ledger, line_name, product
from aridcal.jobs.apply.programs.walk import Body, Call, Choice, ProgramState, Repeat, Step, TooManyWays, Unknown, Walk

_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]|\r(?!\n)")
"""Letters that end no line on one system and do on another, or none at all."""

_BYTE_ORDER_MARK = "\xef\xbb\xbf"

_MOVE_LINE = re.compile(r"^[ \t]*+(?:s?ptp|s?lin|s?circ|spl)[ \t]*+(?=[^\w\s=])[^\n]*+", re.M)

_WORD = re.compile(r"[\w$]+")

_NUMBERED = re.compile(r"[+-]?\d{1,4}")

_INDEXED = re.compile(r"([\w$]+)\[(\d{1,4})\]")


def read(project: Project, cell: Cell) -> ProgramReading:
    """Targets of a project.

    Args:
        project: Programs, data lists, and files of the controller.
        cell: The robot, and frames that the user states.
    """
    files = tuple(
        file_of(k, source.path.name, _without_marks(source.text), source.ours)
        for k, source in enumerate(project.sources)
    )
    facts, names = _parsed([file for file in files if file.stem not in table.SYSTEM_MODULES])
    spoilt = _spoilt(files, facts)
    constants, begin = _values(files, facts, names, cell.frames)
    points = Points(files, cell, spoilt, Ledger())
    _declare(facts, names, points)
    meaning = Meaning(facts, names, points, constants, begin)
    try:
        _walk(facts, meaning, files, points)
    except TooManyWays:
        return ProgramReading(
            _left_alone(files, facts, names, spoilt, cell, "the program has more ways than can be followed")
        )
    broken_targets = [target for file, place, why in facts.broken for target in _of_broken(file, place, why)]
    notes = tuple(_notes(facts, constants, meaning))
    del facts, names, constants, begin, meaning  # a long program's are larger than its targets
    return ProgramReading([*points.targets(), *broken_targets], notes)


def context(path: Path) -> list[Path]:
    """Files beside a program that say what its names mean: its other half, and the controller's own data lists."""
    beside = [path.with_suffix(ending).name.lower() for ending in (".src", ".dat")]
    names_beside = {path.parent: {*beside, "$config.dat", "$machine.dat"}}
    for parent in path.absolute().parents:
        if parent.name.lower() == "r1":
            names_beside[parent] = {"$config.dat", "$machine.dat"}
            for folder in _folders(parent, ("system", "mada")):
                names_beside[folder] = {"$config.dat", "$machine.dat"}
    paths = [own for folder, names in names_beside.items() for own in _files(folder, names)]
    return [own for own in dict.fromkeys(paths) if own.absolute() != path.absolute()]


def _folders(parent: Path, names: Sequence[str]) -> list[Path]:
    return [own for own in _entries(parent) if own.name.lower() in names and own.is_dir()]


def _files(parent: Path, names: set[str]) -> list[Path]:
    return [own for own in _entries(parent) if own.name.lower() in names and own.is_file()]


def _entries(parent: Path) -> list[Path]:
    try:
        return sorted(parent.iterdir())
    except OSError:
        return []


def _without_marks(text: str) -> str:
    """The text, a byte order mark at its beginning and marks of its end as blanks."""
    if text.startswith(_BYTE_ORDER_MARK):
        text = " " * len(_BYTE_ORDER_MARK) + text[len(_BYTE_ORDER_MARK) :]
    return text.rstrip(END_OF_FILE).ljust(len(text))


def _parsed(files: Sequence[File]) -> tuple[ProjectFacts, Names]:
    """All that files say: data lists first, which say what names of the programs are."""
    facts, names = ProjectFacts(), Names()
    sound = []
    for file in files:
        odd = _CONTROL.search(file.code.text)
        if odd is not None:
            facts.broken.append((file, odd.start(), "has a control character, or a carriage return alone"))
        else:
            sound.append(file)
    for file in sound:
        if not file.data:
            names.take_heads(file)
    for module, count in Counter((file.module, file.data) for file in sound).items():
        if count > 1:
            names.twice.add(module[0])
    for file in sorted(sound, key=lambda file: not file.data):
        reader = Reader(file, names, facts)
        try:
            if file.data:
                reader.data()
            else:
                reader.program()
        except MalformedProgram as problem:
            place, why = problem.args
            facts.broken.append((file, place, why))
    for file, place, why in facts.broken:
        unclear = UnclearStatement(
            f"{file.code.name} line {file.code.line(place)} {why}: nothing of the file is understood"
        )
        for match in file.heads():
            facts.bodies[f"{file.index}/{match.group('name')}"] = [Step(unclear)]
    return facts, names


def _values(
    files: Sequence[File], facts: ProjectFacts, names: Names, frames: KnownFrames
) -> tuple[dict[Element, object], dict[Element, object]]:
    """Values of data lists and of --frames: those that stay for ever, and those that hold when a program begins."""
    stated = _stated(frames, foot(facts))
    values: dict[Element, object] = dict(stated)
    given: dict[Element, File] = {}
    for file, variable, value in facts.values:
        element = variable.element
        values[element] = value
        if not variable.whole or element in given:
            values[element] = Unknown(f"{variable.shown} is given in two places")
        elif element in stated and not (isinstance(value, Aggregate) and value.frame == stated[element]):
            values[element] = Unknown(f"{variable.shown} is one frame in {file.code.name} and another in --frames")
        given[element] = file
    codes = tuple(file.code for file in files)
    writers: dict[str, str] = {}
    for mention in facts.writes.values():
        line = (
            f"{mention.file.code.name} line {mention.file.code.line(mention.variable.start)}"
            if len(codes) > 1
            else (f"line {mention.file.code.line(mention.variable.start)}")
        )
        writers.setdefault(
            mention.variable.key, f"{mention.variable.shown} is kept from one run to the next: {line} {mention.does}"
        )
    reached = bool(facts.missing - frames.harmless) or bool(facts.broken) or bool(names.twice)
    constants: dict[Element, object] = {}
    begin: dict[Element, object] = {}
    for element, content in values.items():
        key = element[0]
        if key in writers:
            begin[element] = Unknown(writers[key])
        elif key.split(":")[-1] in facts.imported:
            begin[element] = Unknown(f"{key.split(':')[-1].upper()} is imported by another module, which may write it")
        elif reached and ":" not in key:
            begin[element] = content
        else:
            constants[element] = content
    return constants, begin


def _stated(frames: KnownFrames, world_foot: Frame | Unknown) -> dict[Element, object]:
    """Frames of the user by the variable that they are: bases are stated from the robot's foot, and count from the world."""
    values: dict[Element, object] = {}
    for kind, given in (("base_data", frames.bases), ("tool_data", frames.tools)):
        for name, T in given.items():
            element: Element = (name, None)
            if _NUMBERED.fullmatch(name):
                element = (kind, (float(name),))
            elif (match := _INDEXED.fullmatch(name)) is not None:
                element = (match.group(1), (float(match.group(2)),))
            if name == "default":
                continue
            frame = product(world_foot, Frame(T)) if kind == "base_data" else Frame(T)
            if element in values and values[element] != frame:
                values[element] = Unknown(f"{name} is two frames in --frames")
            else:
                values[element] = frame
    return values


def _spoilt(files: Sequence[File], facts: ProjectFacts) -> dict[tuple[int, int], str]:
    """Why numbers at places of the text must stay: something else than a move uses them."""
    by_key: dict[str, list[tuple[Variable, Aggregate]]] = {}
    for _, variable, value in facts.points:
        by_key.setdefault(variable.key, []).append((variable, value))
    spoilt: dict[tuple[int, int], str] = {}

    def spoil(value: Aggregate, why: str) -> None:
        assert value.place is not None
        spoilt.setdefault(value.place, why)

    sound = dict(by_key)  # what is spoilt is not looked at again: a point may be read in each line
    for mention in facts.reads:
        own = sound.get(mention.variable.key)
        if own:
            rest = [given for given in own if not _may_be(mention.variable, given[0])]
            if len(rest) < len(own):
                why = f"{_line(files, mention)} {mention.does}"
                for variable, value in own:
                    if _may_be(mention.variable, variable):
                        spoil(value, why)
                sound[mention.variable.key] = rest
    words_of_files = [(file, set(_WORD.findall(file.code.plain))) for file, _, _ in facts.broken]
    for key, given in by_key.items():
        name = key.split(":")[-1]
        for file, words in words_of_files:
            if name in words:
                for _, value in given:
                    spoil(value, f"{file.code.name}, of which nothing is understood, names it")
        for variable, value in given:
            if name in facts.imported:
                spoil(value, f"{name.upper()} is imported by another module, which may write it")
            if variable.worked_out or variable.path:
                spoil(value, f"{variable.shown} is an element that the program works out")
    return spoilt


def _line(files: Sequence[File], mention: Mention) -> str:
    return line_name(tuple(file.code for file in files), mention.file.code, mention.variable.start)


def _may_be(one: Variable, other: Variable) -> bool:
    """Whether two elements of one variable may be the same."""
    return one.worked_out or other.worked_out or one.index is None or other.index is None or one.index == other.index


def _declare(facts: ProjectFacts, names: Names, points: Points) -> None:
    """Name all points that variables of our files hold, used or not."""
    for file, variable, value in facts.points:
        if file.ours and names.types.get(variable.key) in table.POINTS:
            points.declare(variable.shown, value)


def _walk(facts: ProjectFacts, meaning: Meaning, files: Sequence[File], points: Points) -> None:
    """Walk all routines that nothing calls, then those that interrupts and triggers call."""
    walk = Walk(facts.bodies, meaning)
    volatile: list[tuple[list[tuple[str, Hashable]], str]] = []
    threads: dict[str, str] = {}
    for thread in facts.threads:
        why = f"{points.line(thread.file.index, thread.start)} may change it at any time"
        what = thread.what
        if isinstance(what, Function) and what.routine in facts.bodies:
            threads.setdefault(what.routine, why)
            volatile.append((walk.writes(what.routine, meaning.at_any_time(why)), why))
        elif not isinstance(what, Function) or what.name in facts.missing or what.name in table.PACKAGES:
            volatile.append((meaning.written_by(what), why))
    callees = {name for body in facts.bodies.values() for name in _called(body)}
    entries = [key for key in _ordered(facts.bodies, files) if key not in callees and key not in threads]

    def enter(key: str, state: ProgramState) -> None:
        for keys, why in volatile:
            state.volatile(keys, why)
        walk.enter(key, state)

    walk.reached.clear()
    for key in entries:
        enter(key, meaning.start())
    for key, why in threads.items():
        enter(key, meaning.at_any_time(why))
    for key in _ordered(facts.bodies, files):  # routines that only call each other
        if key not in walk.reached:
            enter(key, meaning.start())


def _ordered(bodies: Mapping[str, object], files: Sequence[File]) -> list[str]:
    ours = {str(file.index): file.ours for file in files}
    return sorted(bodies, key=lambda key: not ours[key.split("/")[0]])


def _called(body: Body) -> Iterator[str]:
    for node in body:
        if isinstance(node, Call):
            yield node.name
        elif isinstance(node, Choice):
            for way in node.ways:
                yield from _called(way)
        elif isinstance(node, Repeat):
            yield from _called(node.body)


def _left_alone(
    files: tuple[File, ...],
    facts: ProjectFacts,
    names: Names,
    spoilt: dict[tuple[int, int], str],
    cell: Cell,
    why: str,
) -> list[Target]:
    """All targets of a program that cannot be followed, with the reason."""
    points = Points(files, cell, spoilt, Ledger())
    _declare(facts, names, points)
    for body in facts.bodies.values():
        for move in _moves(body):
            for goal in move.targets:
                points.vague(goal, move.file, why)
    return [
        Target(t.line, t.name, t.form, t.numbers, t.why if t.why and not t.numbers else why, file=t.file)
        for t in points.targets()
    ]


def _moves(body: Body) -> Iterator[Move]:
    for node in body:
        if isinstance(node, Step) and isinstance(node.what, Move):
            yield node.what
        elif isinstance(node, Choice):
            for way in node.ways:
                yield from _moves(way)
        elif isinstance(node, Repeat):
            yield from _moves(node.body)


def _of_broken(file: File, place: int, why: str) -> Iterator[Target]:
    """Moves of a file that is no program, with what is wrong with it."""
    reason = f"line {file.code.line(place)} {why}: nothing of {file.code.name} is understood"
    if not file.ours:
        return
    for match in _MOVE_LINE.finditer(file.code.plain):
        shown = " ".join(match.group().split()).upper()[:60]
        yield Target(file.code.line(match.start()), shown, "pose", NONE, reason, file=file.index)


def _notes(facts: ProjectFacts, constants: Mapping[Element, object], meaning: Meaning) -> Iterator[str]:
    """What was taken for granted."""
    yield "BAS and the functions of inline forms are taken to do what KUKA's bas.src does"
    if ("$robroot", None) not in constants:
        yield "$WORLD is taken to be at the foot of the robot ($ROBROOT zero): give $machine.dat if it is elsewhere"
    if facts.packages:
        listed = ", ".join(sorted(facts.packages))
        yield f"{listed}: taken to switch signals, wait and weave, as KUKA's grippers, guns and torches do"
