"""The walk through a program: what is certain at a place is certain on every way that comes there."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
import pytest

from aridcal.jobs.apply.programs.walk import (
    DEEPEST,
    Body,
    Call,
    Choice,
    Jump,
    Leave,
    Mark,
    Node,
    ProgramState,
    Repeat,
    Step,
    TooManyWays,
    Unknown,
    Walk,
)


class Toy:
    """Statements are ``("set", name, value)``, ``("copy", to, from)``, ``("wipe",)``, ``("wipe", "v")``, ``("see", label)``."""

    def __init__(self) -> None:
        self.seen: dict[str, list[dict[str, object]]] = {}

    def step(self, what: object, state: ProgramState) -> None:
        assert isinstance(what, tuple)
        if what[0] == "set":
            state.set("v", what[1], what[2])
        elif what[0] == "copy":
            state.set("v", what[1], state.get("v", what[2]))
        elif what == ("wipe",):
            state.forget_all("wiped")
        elif what[0] == "wipe":
            state.forget_family(what[1], "wiped")
        elif state.recording:
            self.seen.setdefault(what[1], []).append({name: state.get("v", name) for name in "abc"})

    def enter(self, what: object, name: str, state: ProgramState) -> None:
        if what == "local":
            state.set("v", "c", "parameter")

    def leave(self, what: object, name: str, state: ProgramState) -> None:
        if what == "local":
            state.drop("v", "c")

    def absent(self, what: object, name: str, state: ProgramState) -> None:
        state.forget_all(name)


def put(name: str, value: object) -> Step:
    return Step(("set", name, value))


def see(label: str = "here") -> Step:
    return Step(("see", label))


def walked(body: Body, **routines: Body) -> dict[str, list[dict[str, object]]]:
    """What is certain wherever the program looks."""
    toy = Toy()
    Walk({"main": body, **routines}, toy).enter("main", ProgramState())
    return toy.seen


def certain(body: Body, name: str = "a", **routines: Body) -> object:
    """The value of a name at the only place where the program looks; None if it is not certain."""
    (values,) = walked(body, **routines)["here"]
    return None if isinstance(values[name], Unknown) else values[name]


def test_what_branches_set_alike_is_certain_and_what_they_set_otherwise_is_not() -> None:
    assert certain([Choice(((put("a", 1),), (put("a", 1),))), see()]) == 1
    assert certain([Choice(((put("a", 1),), (put("a", 2),))), see()]) is None
    assert certain([put("a", 1), Choice(((put("a", 2),), ())), see()]) is None
    assert certain([put("a", 1), Choice(((put("b", 2),), ())), see()]) == 1


def test_a_loop_may_have_changed_what_stands_before_it_in_its_body() -> None:
    assert certain([put("a", 1), Repeat((see(), put("a", 2)))]) is None
    assert certain([put("a", 1), Repeat((see(), put("a", 1)))]) == 1
    assert certain([put("a", 1), Repeat((put("a", 2), see()))]) == 2
    assert certain([put("a", 1), Repeat((put("a", 2),)), see()]) is None
    assert certain([put("a", 1), Repeat((put("a", 2),), once=True), see()]) == 2


def test_changes_go_round_a_loop_through_other_names() -> None:
    body = (see(), Step(("copy", "a", "b")), Step(("copy", "b", "c")), put("c", 2))
    assert certain([put("a", 1), put("b", 1), put("c", 1), Repeat(body)]) is None


def test_a_loop_that_wipes_leaves_only_what_it_sets_again() -> None:
    assert certain([put("a", 1), Repeat((see(), Step(("wipe",))))]) is None
    assert certain([put("a", 1), Repeat((Step(("wipe",)), put("a", 1), see()))]) == 1
    assert certain([put("a", 1), Repeat((see(), Step(("wipe", "v")), put("a", 1)))]) == 1
    assert certain([put("a", 1), put("b", 3), Repeat((Step(("wipe", "v")), put("a", 1))), see()], "b") is None


def test_a_way_that_leaves_does_not_come_behind_the_branch() -> None:
    left = Choice(((put("a", 2), Leave("routine")), ()))
    assert certain([put("a", 1), left, see()]) == 1
    assert certain([Call("f", None), see()], f=[put("a", 1), left]) is None
    assert certain([put("a", 1), Repeat((put("a", 2), Choice(((Leave("loop"),), ())), put("a", 1))), see()]) is None


def test_jumps_carry_their_state_to_their_mark_forwards_and_backwards() -> None:
    forth: Body = [put("a", 1), Choice(((Jump("x"),), ())), put("a", 2), Mark("x"), see()]
    assert certain(forth) is None
    assert certain([put("a", 1), Jump("x"), put("a", 2), Mark("x"), see()]) == 1
    back: Body = [put("a", 1), Mark("x"), see(), put("a", 2), Choice(((Jump("x"),), ()))]
    assert certain(back) is None
    assert certain([put("a", 1), Mark("x"), see(), put("b", 2), Choice(((Jump("x"),), ()))]) == 1
    anywhere: Body = [put("a", 1), Choice(((Jump(""),), ())), put("a", 2), Mark("x"), see()]
    assert certain(anywhere) is None


def test_a_routine_is_walked_in_the_state_of_each_caller() -> None:
    body: Body = [put("a", 1), Call("f", None), put("a", 2), Call("f", None)]
    assert [values["a"] for values in walked(body, f=[see()])["here"]] == [1, 2]
    assert certain([Call("f", None), see()], f=[put("a", 3)]) == 3
    assert certain([put("a", 1), Call("g", None), see()]) is None
    assert certain([put("a", 1), Call("main", None), see()]) is None


def test_a_routine_that_calls_itself_is_entered_in_any_state_that_it_makes() -> None:
    body = [put("a", 1), Call("f", None)]
    again = Choice(((put("a", 2), Call("f", None)), ()))
    assert certain(body, f=[see(), again]) is None
    by_way = {"f": [see(), Call("g", None)], "g": [Choice(((put("a", 2), Call("f", None)), ()))]}
    assert certain(body, **by_way) is None
    assert certain(body, f=[put("a", 3), see(), again]) == 3
    assert certain(body, f=[see(), Choice(((put("b", 2), Call("f", None)), ()))]) == 1


def test_a_local_name_ends_with_its_routine() -> None:
    body: Body = [put("c", 1), Call("f", "local"), see()]
    assert certain(body, "c", f=[see("inside"), put("b", 2)]) == 1
    assert walked(body, f=[see("inside")])["inside"][0]["c"] == "parameter"


def test_what_an_interrupt_sets_is_never_certain() -> None:
    toy = Toy()
    walk = Walk({"main": [put("a", 1), put("b", 2), see()], "trap": [put("a", 5)]}, toy)
    state = ProgramState()
    state.volatile(walk.writes("trap", state), "an interrupt")
    walk.enter("main", state)
    assert isinstance(toy.seen["here"][0]["a"], Unknown) and toy.seen["here"][0]["b"] == 2


def test_what_an_interrupt_sets_is_told_also_where_it_never_ends() -> None:
    toy = Toy()
    walk = Walk({"trap": [put("a", 5), Mark("x"), Jump("x")], "stop": [put("b", 1), Leave("program")]}, toy)
    assert walk.writes("trap", ProgramState()) == [("v", "a")]
    assert walk.writes("stop", ProgramState()) == [("v", "b")]


def test_programs_with_too_many_ways_are_given_up() -> None:
    body: Body = [put("a", 1), see()]
    for _ in range(40):
        body = [Repeat((put("b", 2), *body))]
    with pytest.raises(TooManyWays):
        walked(body)
    chain = {f"f{k}": [Call(f"f{k + 1}", None)] for k in range(2 * DEEPEST)}
    with pytest.raises(TooManyWays):
        walked([Call("f0", None)], **chain)


@pytest.mark.parametrize("seed", range(60))
def test_nothing_is_called_certain_that_a_run_contradicts(seed: int) -> None:
    """The second road: the program is run at random, each branch, loop and jump by chance."""
    rng = np.random.default_rng(seed)
    body = _random_body(rng, 0)
    routines = {"f": _random_body(rng, 2), "g": _random_body(rng, 2)}
    try:
        claims = walked([*body, see("end")], **routines)
    except TooManyWays:
        return
    for _ in range(150):
        for label, values in _run([*body, see("end")], routines, rng):
            states = claims[label]
            assert any(
                all(isinstance(state[k], Unknown) or state[k] == values.get(k) for k in "abc") for state in states
            ), f"{label}: {values} is in none of {states}"


def _random_body(rng: np.random.Generator, depth: int) -> list[Node]:
    body: list[Node] = []
    for _ in range(int(rng.integers(2, 5))):
        kind = int(rng.integers(9 if depth < 3 else 3))
        if kind < 2:
            body.append(put(str(rng.choice(list("abc"))), int(rng.integers(2))))
        elif kind == 2:
            body.append(see(f"s{rng.integers(1_000_000)}"))
        elif kind == 3:
            body.append(Choice((_random_body(rng, depth + 1), _random_body(rng, depth + 1))))
        elif kind == 4:
            body.append(Repeat(_random_body(rng, depth + 1), bool(rng.integers(2))))
        elif kind == 5 and depth < 2:
            body.append(Call(str(rng.choice(["f", "g"])), None))
        elif kind == 6:
            body.append(Choice(((Leave(str(rng.choice(["loop", "routine"]))),), ())))
        elif kind == 7 and depth in (0, 2):
            body += [Choice(((Jump("m"),), ())), put("a", int(rng.integers(2)))]
        else:
            body.append(Step(("copy", "a", "b")) if rng.integers(2) else Step(("wipe", "v")))
    if depth in (0, 2):
        body.insert(int(rng.integers(len(body))), Mark("m"))
    return body


class _Gone(Exception):
    pass


def _run(body: Body, routines: Mapping[str, Body], rng: np.random.Generator) -> list[tuple[str, dict[str, object]]]:
    """What a program sees on one of its ways."""
    seen: list[tuple[str, dict[str, object]]] = []
    values: dict[str, object] = {}
    left = [300]

    def routine(body: Body) -> None:
        start = 0
        while True:
            signal = go(body[start:])
            if not isinstance(signal, Jump):
                return
            marks = [k for k, node in enumerate(body) if isinstance(node, Mark) and node.label == signal.label]
            if not marks:
                raise _Gone
            start = marks[0]

    def go(body: Body) -> Node | None:
        for node in body:
            left[0] -= 1
            if left[0] < 0:
                raise _Gone
            signal: Node | None = None
            if isinstance(node, Step):
                step(node.what)
            elif isinstance(node, Choice):
                signal = go(node.ways[int(rng.integers(len(node.ways)))])
            elif isinstance(node, Repeat):
                turns = int(rng.integers(1 if node.once else 0, 4))
                for _ in range(turns):
                    signal = go(node.body)
                    if isinstance(signal, Leave) and signal.what == "loop":
                        signal = None
                        if rng.integers(2):
                            break
                    elif signal is not None:
                        break
            elif isinstance(node, Call):
                routine(routines[node.name])
            elif isinstance(node, Jump | Leave):
                return node
            if signal is not None:
                return signal
        return None

    def step(what: object) -> None:
        assert isinstance(what, tuple)
        if what[0] == "set":
            values[what[1]] = what[2]
        elif what[0] == "copy":
            values[what[1]] = values.get(what[2])
        elif what[0] == "wipe":
            values.update({name: float(rng.random()) for name in "abc"})
        else:
            seen.append((what[1], dict(values)))

    with suppress(_Gone):
        routine(body)
    return seen
