"""One robot of a fleet calibrated, wherever that happens: computed once, whoever else tries, and never in halves."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from aridcal.files.campaign import Campaign, load_campaign
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.fleet.keys import Inputs, inputs_of, inputs_of_text
from aridcal.jobs.fleet.run_record import RUN_FILE, Row, as_text, done_row, failed_row, row_of_folder
from aridcal.jobs.head1992.observations import CACHE
from aridcal.jobs.prepare.other_readings import refuse_misread
from aridcal.system.errors import AridcalError, BusyError, MeasurementError
from aridcal.system.progress import one_thread
from aridcal.system.writing.whole_files import claimed

PASSING = frozenset(
    {errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY, errno.EMFILE, errno.ENFILE, errno.ENOMEM}
    | {errno.ECONNRESET, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ENOTCONN, errno.EREMOTEIO}
)
"""What a disk or a network answers that may answer otherwise a moment later; all else is there the second time, too."""

TRIES, PAUSE = 2, 2.0
"""For those, and seconds between them."""

LOOK_AGAIN = 0.5
"""[s] between two looks at a folder that another process is writing."""

_one_at_a_time = threading.Lock()
"""Workers may have several threads; what draws the pages has settings that all threads of a process share."""


class Write(Protocol):
    """Writes a result folder, all of it or nothing."""

    def __call__(self, outcome: Outcome, folder: Path, *, beside: Mapping[str, str]) -> Any:
        """Write it, with further files by their names."""


@dataclass(frozen=True)
class Task:
    """One robot to calibrate.

    Attributes:
        robot: Its name.
        campaign: Path of its campaign, absolute.
        out: Its result folder, absolute.
        key: Of its inputs, when the fleet was started.
        write: Writes the folder.
    """

    robot: str
    campaign: str
    out: str
    key: str
    write: Write


def inputs_at(path: Path) -> tuple[Inputs, Campaign | None, str]:
    """Inputs of a campaign as they are now, the campaign, and, where it cannot be read, why."""
    try:
        campaign = load_campaign(path)
    except AridcalError as problem:
        return inputs_of_text(path), None, str(problem)
    return inputs_of(campaign), campaign, ""


def calibrated(task: Task) -> Row:
    """Calibrate a robot, unless its folder has the result already; a worker's whole work on it.

    A result of the same key is taken as it is: of a worker that died after it had written it, or of another that was thought
    dead and was not, which is waited for.

    Returns:
        The robot's row, ``done`` or ``failed``.
    """
    with _one_at_a_time, one_thread():
        started = time.perf_counter()
        for attempt in range(1, TRIES + 1):
            try:
                return _calibrated(task)
            except (AridcalError, OSError, MemoryError) as problem:
                if not (_passes(problem) and attempt < TRIES):
                    return _failed(task, problem, time.perf_counter() - started)
            time.sleep(PAUSE)
    raise AssertionError("the last attempt returns")


def _calibrated(task: Task) -> Row:
    out, path = Path(task.out), Path(task.campaign)
    if not path.is_file() and not path.parent.is_dir():
        raise MeasurementError(
            f"{path}: is not to be seen from this worker; workers need the fleet's files under the same paths"
        )
    with ExitStack() as mine:
        while True:
            try:
                mine.enter_context(claimed(out, "folder"))
                break
            except BusyError:
                time.sleep(LOOK_AGAIN)
        done = row_of_folder(out)
        if done is not None and done["key"] == task.key:
            return done
        inputs, campaign, why = inputs_at(path)
        if campaign is None:
            raise MeasurementError(why)
        _check(inputs, task)
        outcome = identify(campaign, cache=out / CACHE, judge=refuse_misread)
        row = done_row(task.robot, outcome, inputs)
        _check(inputs_at(path)[0], task)
        task.write(outcome, out, beside={RUN_FILE: as_text(row)})
        return row


def _check(inputs: Inputs, task: Task) -> None:
    """Make sure that what is read is what was asked about."""
    if inputs.key != task.key:
        raise MeasurementError(
            f"{task.campaign}: its files, or the version of aridcal, are not those that the fleet was started with; "
            "start it again once they stay as they are, with one version everywhere"
        )


def _failed(task: Task, problem: Exception, seconds: float) -> Row:
    inputs, campaign, _ = inputs_at(Path(task.campaign))
    asked = Inputs(task.key, inputs.inputs, inputs.urdf)
    said = str(problem) if isinstance(problem, AridcalError) else f"{type(problem).__name__}: {problem}"
    return failed_row(task.robot, Path(task.campaign), asked, said, seconds, campaign)


def _passes(problem: BaseException | None) -> bool:
    """Whether a second attempt may do better: a disk or a network was at fault."""
    while problem is not None:
        if isinstance(problem, OSError) and problem.errno in PASSING:
            return True
        problem = problem.__cause__
    return False
