"""A project of jobs: the frames of its controller, and the targets of those that are corrected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from aridcal.jobs.apply.programs.callers import called_program, reachable_programs, routine_of, uncalled_programs
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import frames_set, joined_frames
from aridcal.jobs.apply.programs.project import Project
from aridcal.jobs.apply.programs.text import Code
from aridcal.jobs.apply.programs.uses import HERE, Frame
from aridcal.jobs.apply.programs.walk import ProgramState, TooManyWays, Walk
from aridcal.jobs.apply.programs.yaskawa.controller import read_tools, read_user_frames
from aridcal.jobs.apply.programs.yaskawa.flow import Flow, read_flow
from aridcal.jobs.apply.programs.yaskawa.listing import Job, read_job
from aridcal.jobs.apply.programs.yaskawa.meaning import Meaning, StatedFrames

ENDING = ".jbi"

USER_FRAMES, TOOLS = "uframe.cnd", "tool.cnd"
"""The controller's own files of its frames."""

ROBOT = "robot"
"""Under this name --frames states where the robot's coordinates are."""

WAYS = "the job has more ways than can be followed"


def context(path: Path) -> list[Path]:
    """Other jobs beside one, and the controller's files of its frames."""
    try:
        beside = sorted(path.parent.iterdir())
    except OSError:
        return []
    return [
        other
        for other in beside
        if (other.suffix.lower() == ENDING or other.name.lower() in (USER_FRAMES, TOOLS)) and other.name != path.name
    ]


def read(project: Project, cell: Cell) -> ProgramReading:
    """Targets of a project: positions of //POS, in the order in which the jobs go there."""
    codes = tuple(Code(file, s.path.name, s.text, s.text) for file, s in enumerate(project.sources))
    programs = [code for code in codes if project.sources[code.file].path.suffix.lower() == ENDING]
    jobs = [job for code in programs if (job := read_job(code)) is not None]
    ours = {k: project.sources[job.code.file].ours for k, job in enumerate(jobs)}
    given, notes = _given(project, cell, codes)
    try:
        return _walked(cell, codes, jobs, ours, given, notes)
    except (TooManyWays, RecursionError):
        for job in jobs:
            job.why = job.why or WAYS
        own = frozenset(k for k in ours if ours[k])
        meaning = Meaning(jobs, [Flow() for _ in jobs], codes, ours, own, own, given, cell)
        return ProgramReading(meaning.targets())


def _walked(
    cell: Cell,
    codes: tuple[Code, ...],
    jobs: Sequence[Job],
    ours: Mapping[int, bool],
    stated: StatedFrames,
    notes: tuple[str, ...],
) -> ProgramReading:
    flows = [read_flow(k, job) for k, job in enumerate(jobs)]
    names, calls = called_program([job.name for job in jobs], ours), [flow.calls for flow in flows]
    spoken = reachable_programs([k for k in ours if ours[k]], calls, names)
    above = [k for k in ours if not ours[k] and reachable_programs([k], calls, names) & spoken and k not in spoken]
    walked = [k for k in ours if k in spoken or k in above]
    meaning = Meaning(jobs, flows, codes, ours, spoken, frozenset(walked), stated, cell)
    walk = Walk({routine_of(names, k): flows[k].body for k in walked}, meaning)
    state = ProgramState()
    writes = [flow.writes for flow in flows]
    own_codes = [job.code for job in jobs]
    meaning.begin(state, frames_set(own_codes, writes, frozenset(walked), cell.frames, codes))
    for k in uncalled_programs(walked, calls, names):
        walk.enter(routine_of(names, k), ProgramState(state))
    for k in walked:
        if routine_of(names, k) not in walk.reached:
            walk.enter(routine_of(names, k), ProgramState(state))
    del walk
    for flow in flows:
        flow.body = ()  # a long job's is as large as its targets
    return ProgramReading(meaning.targets(), (*notes, *_assumptions(meaning.assumed, cell)))


def _given(project: Project, cell: Cell, codes: tuple[Code, ...]) -> tuple[StatedFrames, tuple[str, ...]]:
    """Frames that are known when a job begins, and what was taken for granted."""
    stated = cell.frames.bases.get(ROBOT)
    here = cell.elsewhere if stated is None else stated
    robot = HERE if here is None else Frame(here)
    names = [project.sources[code.file].path.name.lower() for code in codes]
    users = [read_user_frames(code.text) for code in codes if names[code.file] == USER_FRAMES]
    tools = [read_tools(code.text) for code in codes if names[code.file] == TOOLS]
    notes = [
        f"user frames or tools are those of {code.name}" for code in codes if names[code.file] in (USER_FRAMES, TOOLS)
    ]
    frames = joined_frames("user frame", cell.frames.bases, robot, users)
    return StatedFrames(robot, frames, joined_frames("tool", cell.frames.tools, HERE, tools)), tuple(notes)


def _assumptions(assumed: set[str], cell: Cell) -> tuple[str, ...]:
    """What no file says, and moves have needed."""
    link = cell.robot.base if cell.elsewhere is None else "base"
    notes = {
        "robot": f"the robot's coordinates are taken as the link {link} of the URDF"
        if ROBOT not in cell.frames.bases
        else "",
        "base": "base coordinates are taken as those of the robot: nothing moves its base",
        "unshifted": "jobs are taken as begun without a shift (SFTON) where no given job calls them",
        "variables": "position variables are taken as loaded with their job: other jobs must neither set them nor go there",
        "relative": "relative jobs are taken in their own frame where no given job calls them with another (UF#)",
        "posture": "RCONF is not read: the arm is taken to come to the first position without bending another way",
    }
    return tuple(notes[name] for name in sorted(assumed) if notes[name])
