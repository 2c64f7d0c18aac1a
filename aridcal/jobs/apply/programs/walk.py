"""Abstract interpretation: a program walked along all ways that it can take, with what is certain of its state on each.

A language turns a text into routines of nodes (:class:`Step`, :class:`Choice`, :class:`Repeat`, ...) and says by its
:class:`Semantics` what a statement does to a :class:`ProgramState`. The walk does the rest (Cousot and Cousot, POPL 1977):
where ways meet, what differs between them is unknown; a loop is walked until the state at its head stays; a called routine is
walked in the state of its caller. What is not certain is :class:`Unknown`, with the reason that the user reads.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

MOST_LOOP_WALKS = 6
"""Walks of one loop, or of a routine with jumps, until its states stay. What a loop sets becomes unknown in one walk, what is
computed from it in the next; after these all that is set there is taken as unknown."""

JUMPS = 200
"""Jumps of one routine whose states are kept apart: each is a copy of what the routine has set."""

BUDGET = 200
"""Statements that are walked for each that a project has. Each loop around a statement takes two or three walks, each call of its
routine one; a program that takes more is left as a whole, for the walk must end."""

LEAST_BUDGET = 50_000
"""The same for short programs: less than a second."""

MOST_BUDGET = 1_000_000
"""The same for long programs, or :data:`FEW_WALKS` of each statement where that is more: some ten seconds for 100,000 moves."""

FEW_WALKS = 10
"""Of a statement in two loops, one in the other."""

DEEPEST = 60
"""Statements in statements, and routines that call routines. People write ten; readers refuse what is deeper."""

EVERYTHING = ("*", None)
"""The key of all that a state holds."""


class TooManyWays(Exception):
    """The program has more ways than can be walked: nothing of it is understood."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """A value that is not certain. All such values are equal: the reason tells nothing apart.

    Attributes:
        why: The reason, for the user.
    """

    why: str = field(compare=False)


NEVER_SET = Unknown("is set nowhere before")

TO_AND_FRO = "the program jumps to and fro here"

DIFFERS = "it is not the same on all ways that the program can come here"


class _Shared:
    """What all overlays of a walk have in common.

    Attributes:
        volatile: What interrupts and other threads set: unknown for good. A family without a member stands for all of it.
        trials: Loops and jumps that are being tried: their moves are not written down.
        noted: All that is set by walks whose sets are asked for; None while nobody asks.
    """

    def __init__(self) -> None:
        self.volatile: dict[tuple[str, Hashable], Unknown] = {}
        self.trials = 0
        self.noted: dict[tuple[str, Hashable], None] | None = None


class ProgramState:
    """What is certain at one place of a program: values by family and member, ``("base", None)`` or ``("point", "p1")``.

    A state may lie over another one, as what a branch has changed; below it all is as before.

    Args:
        parent: The state below.
    """

    def __init__(self, parent: ProgramState | None = None) -> None:
        self._parent = parent
        self._shared: _Shared = parent._shared if parent is not None else _Shared()
        self._own: dict[str, dict[Hashable, object]] = {}
        self._families: dict[str, Unknown] = {}
        self._cleared: Unknown | None = None

    @property
    def recording(self) -> bool:
        """False while a loop or a jump is tried: moves are written down by the last walk alone."""
        return self._shared.trials == 0

    def get(self, family: str, member: Hashable = None) -> object:
        """A value; an :class:`Unknown` where it is not certain."""
        if self._shared.volatile:
            for key in ((family, member), (family, None), EVERYTHING):
                if key in self._shared.volatile:
                    return self._shared.volatile[key]
        level: ProgramState | None = self
        while level is not None:
            values = level._own.get(family)
            if values is not None and member in values:
                return values[member]
            if family in level._families:
                return level._families[family]
            if level._cleared is not None:
                return level._cleared
            level = level._parent
        return NEVER_SET

    def set(self, family: str, member: Hashable, value: object) -> None:
        """Set a value; of a family without members the member is None."""
        self._own.setdefault(family, {})[member] = value
        if self._shared.noted is not None:
            self._shared.noted[family, member] = None

    def forget(self, family: str, member: Hashable, why: str) -> None:
        """A value is unknown from here on."""
        self.set(family, member, Unknown(why))

    def forget_family(self, family: str, why: str) -> None:
        """All values of a family are unknown until they are set again."""
        self._own[family] = {}
        self._families[family] = Unknown(why)
        if self._shared.noted is not None:
            self._shared.noted[family, None] = None

    def forget_all(self, why: str) -> None:
        """All values are unknown until they are set again."""
        self._own, self._families, self._cleared = {}, {}, Unknown(why)
        if self._shared.noted is not None:
            self._shared.noted[EVERYTHING] = None

    @contextmanager
    def noted(self) -> Iterator[dict[tuple[str, Hashable], None]]:
        """Collect what is set in this state and its overlays, within a block and within the blocks in it."""
        before, own = self._shared.noted, dict[tuple[str, Hashable], None]()
        self._shared.noted = own
        try:
            yield own
        finally:
            self._shared.noted = before
            if before is not None:
                before.update(own)

    def drop(self, family: str, member: Hashable) -> None:
        """Take back what this overlay has set: the value below shows again, as of a local name that ends."""
        self._own.get(family, {}).pop(member, None)

    def volatile(self, keys: Iterable[tuple[str, Hashable]], why: str) -> None:
        """What interrupts or other threads set is unknown everywhere, for good."""
        for key in keys:
            self._shared.volatile[key] = Unknown(why)

    def own_keys(self) -> list[tuple[str, Hashable]]:
        """All that this overlay has set or forgotten; a family that it has forgotten as a whole has the member None."""
        keys: list[tuple[str, Hashable]] = [] if self._cleared is None else [EVERYTHING]
        keys += [(family, None) for family in self._families]
        return [*keys, *((family, member) for family, values in self._own.items() for member in values)]

    def _tells_more(self, head: ProgramState) -> bool:
        """Whether this state is certain of what an overlay of it, the head of a loop, is not."""
        wiped = (
            head._families if head._cleared is None else dict.fromkeys({*self._own, *self._families, *head._families})
        )
        if head._cleared is not None and self._cleared is None:
            return True
        if any(family not in self._families and self._cleared is None for family in head._families):
            return True
        mine = ((family, member) for family in wiped for member in self._own.get(family, {}))
        theirs = ((family, member) for family, values in head._own.items() for member in values)
        return any(self.get(*key) != head.get(*key) for key in (*mine, *theirs))

    def _absorb(self, child: ProgramState) -> None:
        """Take over all that an overlay has changed."""
        if child._cleared is not None:
            self._own, self._families, self._cleared = {}, {}, child._cleared
        for family, unknown in child._families.items():
            self._own[family] = {}
            self._families[family] = unknown
        for family, values in child._own.items():
            self._own.setdefault(family, {}).update(values)

    def join(self, ways: Sequence[ProgramState]) -> None:
        """Go on where several ways meet, each an overlay of this state: what differs between them is unknown."""
        if len(ways) == 1:
            self._absorb(ways[0])
            return
        keys = dict.fromkeys((f, m) for way in ways for f, values in way._own.items() for m in values)
        values = {key: _agreed([way.get(*key) for way in ways]) for key in keys}
        families = {family: unknown for way in ways for family, unknown in way._families.items()}
        cleared = next((way._cleared for way in ways if way._cleared is not None), None)
        if cleared is not None:
            self._own, self._families, self._cleared = {}, {}, cleared
        for family, unknown in families.items():
            self._own[family] = {}
            self._families[family] = unknown
        for (family, member), value in values.items():
            self.set(family, member, value)

    def copy_over(self, boundary: ProgramState) -> ProgramState:
        """This state as a single overlay of one that lies below it."""
        levels: list[ProgramState] = []
        level: ProgramState = self
        while level is not boundary:
            levels.append(level)
            assert level._parent is not None
            level = level._parent
        copy = ProgramState(boundary)
        for level in reversed(levels):
            copy._absorb(level)
        return copy

    def same_as(self, other: ProgramState) -> bool:
        """Whether two overlays of one state say the same."""
        mine = (self._cleared, self._families, self._own)
        return mine == (other._cleared, other._families, other._own)

    def become(self, other: ProgramState) -> None:
        """Say what another overlay of the same state says."""
        self._own, self._families, self._cleared = other._own, other._families, other._cleared

    def lies_on(self, other: ProgramState) -> bool:
        """Whether this is an overlay of another state."""
        return self._parent is other


def _agreed(values: Sequence[object]) -> object:
    """The value that all have; unknown where they differ."""
    for value in values:
        if isinstance(value, Unknown):
            return value
    return values[0] if all(value == values[0] for value in values[1:]) else Unknown(DIFFERS)


@dataclass(frozen=True, slots=True)
class Step:
    """A statement that is carried out and goes on to the next.

    Attributes:
        what: The language's own statement.
    """

    what: object


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several ways is taken.

    Attributes:
        ways: Bodies; an empty one where it may be that none is taken.
    """

    ways: tuple[Body, ...]


@dataclass(frozen=True, slots=True)
class Repeat:
    """A loop.

    Attributes:
        body: What is repeated.
        once: Whether it is carried out once at least.
    """

    body: Body
    once: bool = False


@dataclass(frozen=True, slots=True)
class Call:
    """A routine is called.

    Attributes:
        name: Of the routine, as in the routines given to :func:`walk`.
        what: The language's own statement.
    """

    name: str
    what: object


@dataclass(frozen=True, slots=True)
class Mark:
    """A place of the routine that jumps come to.

    Attributes:
        label: Its name.
    """

    label: str


@dataclass(frozen=True, slots=True)
class Jump:
    """The program goes on at a mark of the same routine; a conditional jump is a :class:`Choice` of it and nothing.

    Attributes:
        label: Of the mark; empty where it is worked out: any of them.
    """

    label: str


@dataclass(frozen=True, slots=True)
class Leave:
    """The program goes on behind what it is in.

    Attributes:
        what: ``loop`` (also to its next turn), ``routine`` or ``program``.
    """

    what: str


Node = Step | Choice | Repeat | Call | Mark | Jump | Leave
Body = Sequence[Node]


class Semantics(Protocol):
    """What the statements of a language do."""

    def step(self, what: object, state: ProgramState) -> None:
        """Carry out the statement of a :class:`Step`."""

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        """Set parameters and locals of a routine that is called by a statement, in an overlay of the caller's state."""

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        """Drop what ends with the routine, and set in the caller what it gives back."""

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        """A routine is called that is in no file that was given."""


@dataclass
class _Ways:
    """Where ways out of what is being walked are kept.

    Attributes:
        routine: The state below the routine.
        returns: States where it is left.
        loop: The state below the innermost loop; None outside of loops.
        turns: States where that is left, or goes on to its next turn.
        jumps: States of jumps, by label.
        forget: Why all that the routine sets is unknown at its marks; empty where jumps are kept apart.
    """

    routine: ProgramState
    returns: list[ProgramState] = field(default_factory=list)
    loop: ProgramState | None = None
    turns: list[ProgramState] = field(default_factory=list)
    jumps: dict[str, list[ProgramState]] = field(default_factory=dict)
    forget: str = ""


class Walk:
    """A walk through the routines of a project.

    Args:
        routines: Bodies by name.
        semantics: Of the language.
    """

    def __init__(self, routines: Mapping[str, Body], semantics: Semantics) -> None:
        self._routines, self._semantics = routines, semantics
        size = sum(_size(body) for body in routines.values())
        self._left = max(LEAST_BUDGET, min(BUDGET * size, max(MOST_BUDGET, FEW_WALKS * size)))
        self._stack: list[str] = []
        self.reached: set[str] = set()
        self._marked = {name: _marked(body) for name, body in routines.items()}
        self._cyclic = _cyclic(routines)
        self._written: dict[str, list[tuple[str, Hashable]]] = {}

    def enter(self, name: str, state: ProgramState) -> None:
        """Walk a routine as the program begins there.

        Raises:
            TooLong: it has too many ways.
        """
        self._call(Call(name, None), state)

    def writes(self, name: str, state: ProgramState) -> list[tuple[str, Hashable]]:
        """What a routine sets when it is called in a state, which stays as it is: of an interrupt, for instance.

        All counts that is set on any way, also where the routine never comes to its end.
        """
        return self._set_within(state, lambda overlay: self._call(Call(name, None), overlay))

    def _set_within(self, state: ProgramState, walk: Callable[[ProgramState], object]) -> list[tuple[str, Hashable]]:
        """What a walk sets, tried in an overlay of a state."""
        with self._trial(state), state.noted() as keys:
            walk(ProgramState(state))
        return list(keys)

    @contextmanager
    def _trial(self, state: ProgramState) -> Iterator[None]:
        state._shared.trials += 1
        try:
            yield
        finally:
            state._shared.trials -= 1

    def _call(self, call: Call, state: ProgramState) -> bool:
        body = self._routines.get(call.name)
        if body is None:
            self._semantics.absent(call.what, call.name, state)
            return True
        if call.name in self._stack:
            self._forget_written(call.name, state)
            return True
        if len(self._stack) >= DEEPEST:
            raise TooManyWays
        self.reached.add(call.name)
        self._stack.append(call.name)
        own = ProgramState(state)
        if call.name in self._cyclic:  # it may also be entered from within itself, in any state that it makes
            self._find_written(call, body, state)
            self._forget_written(call.name, own)
        self._semantics.enter(call.what, call.name, own)
        entered = ProgramState(own)
        exits = self._routine(body, entered, self._marked[call.name])
        if exits:
            own.join(exits)
            self._semantics.leave(call.what, call.name, own)
            state._absorb(own)
        self._stack.pop()
        return bool(exits)

    def _find_written(self, call: Call, body: Body, state: ProgramState) -> None:
        """Find what a routine that calls itself sets: within that trial the call of itself does nothing of its own."""
        if call.name in self._written:
            return
        self._written[call.name] = []

        def inside(own: ProgramState) -> None:
            self._semantics.enter(call.what, call.name, own)
            self._routine(body, ProgramState(own), self._marked[call.name])

        self._written[call.name] = self._set_within(state, inside)

    def _forget_written(self, name: str, state: ProgramState) -> None:
        """What a routine that calls itself sets is unknown in it, and behind its call of itself."""
        why = f"{name} calls itself"
        for family, member in self._written.get(name, [EVERYTHING]):
            if (family, member) == EVERYTHING:
                state.forget_all(why)
            elif member is None:
                state.forget_family(family, why)
            else:
                state.forget(family, member, why)

    def _routine(self, body: Body, entered: ProgramState, marked: bool) -> list[ProgramState]:
        """States in which a routine is left, overlays of the one below the entered; none if it never ends."""
        below = entered._parent
        assert below is not None
        jumps: dict[str, list[ProgramState]] = {}
        if marked:
            with self._trial(entered):
                jumps, forget = self._settled(body, below)
        else:
            forget = ""
        ways = _Ways(below, jumps={label: list(states) for label, states in jumps.items()}, forget=forget)
        falls = self._run(body, entered, ways)
        return [*ways.returns, *([entered] if falls else [])]

    def _settled(self, body: Body, below: ProgramState) -> tuple[dict[str, list[ProgramState]], str]:
        """States of the jumps of a routine, and why they are not kept apart."""
        jumps: dict[str, list[ProgramState]] = {}
        for _ in range(MOST_LOOP_WALKS):
            ways = _Ways(below, jumps={label: list(states) for label, states in jumps.items()})
            self._run(body, ProgramState(below), ways)
            if sum(len(states) for states in ways.jumps.values()) > JUMPS:
                break
            merged = {label: [_merged(states, below)] for label, states in ways.jumps.items()}
            if merged.keys() == jumps.keys() and all(merged[k][0].same_as(jumps[k][0]) for k in merged):
                return jumps, ""
            jumps = merged
        return {}, TO_AND_FRO

    def _run(self, body: Body, state: ProgramState, ways: _Ways) -> bool:
        """Walk a body; returns whether the program comes to its end."""
        live = True
        for node in body:
            if not live and not (isinstance(node, Mark) or _marked((node,))):
                continue
            self._left -= 1
            if self._left < 0:
                raise TooManyWays
            if isinstance(node, Mark):
                live = self._mark(node, state, ways, live)
            elif not live:  # a jump into the middle of something
                state.forget_all(TO_AND_FRO)
                live = self._node(node, state, ways)
            else:
                live = self._node(node, state, ways)
        return live

    def _node(self, node: Node, state: ProgramState, ways: _Ways) -> bool:
        if isinstance(node, Step):
            self._semantics.step(node.what, state)
            return True
        if isinstance(node, Choice):
            return self._choice(node, state, ways)
        if isinstance(node, Repeat):
            return self._repeat(node, state, ways)
        if isinstance(node, Call):
            return self._call(node, state)
        if isinstance(node, Jump):
            ways.jumps.setdefault(node.label, []).append(state.copy_over(ways.routine))
        elif isinstance(node, Leave) and node.what == "loop" and ways.loop is not None:
            ways.turns.append(state.copy_over(ways.loop))
        elif isinstance(node, Leave) and node.what != "program":
            ways.returns.append(state.copy_over(ways.routine))
        return False

    def _mark(self, mark: Mark, state: ProgramState, ways: _Ways, live: bool) -> bool:
        if ways.forget or not state.lies_on(ways.routine):  # a jump into the middle of a branch or a loop
            state.forget_all(ways.forget or TO_AND_FRO)
            return True
        arrivals = [*ways.jumps.get(mark.label, []), *ways.jumps.get("", [])]
        if live:
            arrivals.append(state.copy_over(ways.routine))
        if arrivals:
            state.become(_merged(arrivals, ways.routine))
        return bool(arrivals)

    def _choice(self, choice: Choice, state: ProgramState, ways: _Ways) -> bool:
        ends = []
        for body in choice.ways:
            way = ProgramState(state)
            if self._run(body, way, ways):
                ends.append(way)
        if ends:
            state.join(ends)
        return bool(ends)

    def _repeat(self, loop: Repeat, state: ProgramState, ways: _Ways) -> bool:
        """The state at the head of a loop is that of its first turn joined with those of all later ones."""
        with self._trial(state):
            for _ in range(MOST_LOOP_WALKS):
                head = ProgramState(state)
                head.join([ProgramState(state), *self._turn(loop, state, ways)])
                if not state._tells_more(head):
                    break
                state._absorb(head)
            else:
                state.forget_all("a loop changes it with every turn")
        ends = self._turn(loop, state, ways)
        if not loop.once:
            ends.append(ProgramState(state))
        if ends:
            state.join(ends)
        return bool(ends)

    def _turn(self, loop: Repeat, state: ProgramState, ways: _Ways) -> list[ProgramState]:
        """States after one turn of a loop, overlays of that at its head."""
        inner = _Ways(ways.routine, ways.returns, state, [], ways.jumps, ways.forget)
        end = ProgramState(state)
        falls = self._run(loop.body, end, inner)
        return [*inner.turns, *([end] if falls else [])]


def _merged(states: Sequence[ProgramState], below: ProgramState) -> ProgramState:
    joined = ProgramState(below)
    joined.join(states)
    return joined


def _cyclic(routines: Mapping[str, Body]) -> frozenset[str]:
    """Routines that call themselves, perhaps by way of others: strongly connected components of the calls."""
    from scipy.sparse import coo_array  # slow to load, and most commands read no programs
    from scipy.sparse.csgraph import connected_components

    number = {name: k for k, name in enumerate(routines)}
    pairs = {(number[name], number[to]) for name, body in routines.items() for to in _called(body) if to in number}
    if not pairs:
        return frozenset()
    rows, columns = np.array(sorted(pairs)).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(number), len(number)))
    _, component = connected_components(graph, directed=True, connection="strong")
    several = np.bincount(component)[component] > 1
    selves = {a for a, b in pairs if a == b}
    return frozenset(name for name, k in number.items() if several[k] or k in selves)


def _called(body: Body) -> Iterator[str]:
    for node in body:
        if isinstance(node, Call):
            yield node.name
        for inner in _bodies(node):
            yield from _called(inner)


def _size(body: Body) -> int:
    return sum(1 + sum(_size(inner) for inner in _bodies(node)) for node in body)


def _bodies(node: Node) -> Sequence[Body]:
    if isinstance(node, Choice):
        return node.ways
    return (node.body,) if isinstance(node, Repeat) else ()


def _marked(body: Body) -> bool:
    return any(isinstance(node, Mark) or any(_marked(inner) for inner in _bodies(node)) for node in body)
