"""A project of TP programs: its listings, the frames of its controller, and the targets of those that are corrected."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from aridcal.jobs.apply.programs.callers import called_program, reachable_programs, routine_of, uncalled_programs
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.fanuc.actions import actions
from aridcal.jobs.apply.programs.fanuc.controller import read_frames_of_controller
from aridcal.jobs.apply.programs.fanuc.flow import Flow, read_flow
from aridcal.jobs.apply.programs.fanuc.listing import Listing, read_listing
from aridcal.jobs.apply.programs.fanuc.meaning import Meaning, StatedFrames
from aridcal.jobs.apply.programs.frames import frames_set, joined_frames
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.text import Code
from aridcal.jobs.apply.programs.uses import HERE, Frame
from aridcal.jobs.apply.programs.walk import ProgramState, TooManyWays, Walk

ENDING = ".ls"

LISTINGS = ("sysframe.va", "frame.dg")
"""Listings of the frames that a controller holds, in the order in which they are believed: FRAME.DG rounds to a tenth."""

WAYS = "the program has more ways than can be followed"


def context(path: Path) -> list[Path]:
    """Other programs beside one, and the controller's listings of its frames."""
    try:
        beside = sorted(path.parent.iterdir())
    except OSError:
        return []
    return [
        other
        for other in beside
        if (other.suffix.lower() == ENDING or other.name.lower() in LISTINGS) and other.name != path.name
    ]


def read(project: Project, cell: Cell) -> ProgramReading:
    """Targets of a project: points of /POS, in the order in which the programs go there."""
    codes = tuple(Code(file, s.path.name, s.text, s.text) for file, s in enumerate(project.sources))
    programs = [code for code in codes if project.sources[code.file].path.suffix.lower() == ENDING]
    listings = [listing for code in programs if (listing := read_listing(code)) is not None]
    ours = {k: project.sources[listing.code.file].ours for k, listing in enumerate(listings)}
    try:
        flows = [read_flow(k, listing) for k, listing in enumerate(listings)]
        return _walked(project, cell, codes, listings, flows, ours)
    except (TooManyWays, RecursionError):
        left = [replace(listing, why=listing.why or WAYS) for k, listing in enumerate(listings) if ours[k]]
        nothing = StatedFrames(HERE, {}, {})
        own = dict.fromkeys(range(len(left)), True)
        meaning = Meaning(left, [Flow() for _ in left], codes, own, frozenset(own), nothing, cell)
        return ProgramReading(meaning.targets())


def _walked(
    project: Project,
    cell: Cell,
    codes: tuple[Code, ...],
    listings: Sequence[Listing],
    flows: Sequence[Flow],
    ours: Mapping[int, bool],
) -> ProgramReading:
    names, calls = (
        called_program([listing.name for listing in listings], ours),
        [(*flow.calls, *flow.tasks) for flow in flows],
    )
    spoken = reachable_programs([k for k in ours if ours[k]], calls, names)
    above = [k for k in ours if not ours[k] and reachable_programs([k], calls, names) & spoken and k not in spoken]
    walked = [k for k in ours if k in spoken or k in above]
    given, notes = _given(project, cell, codes)
    meaning = Meaning(listings, flows, codes, ours, spoken, given, cell)
    walk = Walk({routine_of(names, k): flows[k].body for k in walked}, meaning)
    state = ProgramState()
    writes = [flow.writes for flow in flows]
    own_codes = [listing.code for listing in listings]
    meaning.begin(state, frames_set(own_codes, writes, frozenset(walked), cell.frames, codes))
    for name in sorted({name for k in walked for name in flows[k].tasks}):
        state.volatile(
            _writes(name, flows, names, meaning, state), f"{name} runs beside the program, and may change it"
        )
    for k in uncalled_programs(walked, [flow.calls for flow in flows], names):
        walk.enter(routine_of(names, k), ProgramState(state))
    for k in walked:
        if routine_of(names, k) not in walk.reached:
            walk.enter(routine_of(names, k), ProgramState(state))
    del walk
    for flow in flows:
        flow.body = ()  # a long program's is as large as its targets
    return ProgramReading(meaning.targets(), (*notes, *_assumptions(meaning.assumed, cell)))


def _writes(
    name: str, flows: Sequence[Flow], names: Mapping[str, int], meaning: Meaning, state: ProgramState
) -> list[tuple[str, Hashable]]:
    """All that a program may change that runs beside others, wherever it is: it may never end, or be stopped at any line."""
    calls = [(*flow.calls, *flow.tasks) for flow in flows]
    own_and_called = reachable_programs([names[name]], calls, names) if name in names else frozenset()
    keys: dict[tuple[str, Hashable], None] = {}
    for own in (name, *(own for k in own_and_called for own in calls[k])):
        if own not in names:
            scratch = ProgramState(state)
            meaning.absent(None, own, scratch)
            keys |= dict.fromkeys(scratch.own_keys())
    for k in sorted(own_and_called):
        for action in actions(flows[k].body):
            if action.does != "move":
                scratch = ProgramState(state)
                meaning.step(action, scratch)
                keys |= dict.fromkeys(scratch.own_keys())
    return list(keys)


def _given(project: Project, cell: Cell, codes: tuple[Code, ...]) -> tuple[StatedFrames, tuple[str, ...]]:
    """Frames that are known when a program begins, and what was taken for granted."""
    notes = []
    world = cell.frames.bases.get("0")
    if world is None:
        world = cell.elsewhere
    base = HERE if world is None else Frame(world)
    flange = Frame(cell.frames.tools["0"]) if "0" in cell.frames.tools else HERE
    names = [project.sources[code.file].path.name.lower() for code in codes]
    listings = [read_frames_of_controller(code.text) for own in LISTINGS for code in codes if names[code.file] == own]
    notes += [f"user frames and tools are those of {code.name}" for code in codes if names[code.file] in LISTINGS]
    frames = joined_frames("user frame", cell.frames.bases, base, [listing.frames for listing in listings])
    tools = joined_frames("user tool", cell.frames.tools, flange, [listing.tools for listing in listings])
    return StatedFrames(base, frames, {**tools, 0: flange}), tuple(notes)


def _assumptions(assumed: set[str], cell: Cell) -> tuple[str, ...]:
    """What no file says, and moves have needed."""
    robot, stated = cell.robot, cell.frames
    notes = {
        "world": f"user frame 0, the world frame, is taken as {_world(cell)}" if "0" not in stated.bases else "",
        "flange": f"user tool 0, the flange, is taken as the link {robot.tip}" if "0" not in stated.tools else "",
        "joints": "J1 to J6 are taken as the campaign counts its joints: does it count J3 as the controller shows it?",
    }
    return tuple(notes[name] for name in sorted(assumed) if notes[name])


def _world(cell: Cell) -> str:
    return f"the link {cell.robot.base if cell.elsewhere is None else 'base'} of the URDF"
