"""A campaign guided while it is measured: what comes from its table and from the user, and the calibration at the end."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from os import SEEK_END
from pathlib import Path
from typing import IO

import numpy as np

from aridcal.files.campaign import Campaign, EffectDeclaration, Moment
from aridcal.jobs.guide.events import Event
from aridcal.jobs.guide.growing_table import content_of
from aridcal.jobs.guide.session import Session
from aridcal.jobs.guide.shown_effects import shown_effects
from aridcal.runs.result_folder import write_folder
from aridcal.system.errors import MeasurementError
from aridcal.system.progress import Progress
from aridcal.system.writing.append import append
from aridcal.system.writing.whole_files import atomic_file

LONGEST_HEADER = 100_000
"""Bytes of a first line that are looked at."""

LOOK_EVERY = 0.1
"""[s] between two looks at the table: a row is to be answered within a second."""

REJECT, STOP = "reject", "stop"
"""Commands, each a line: no row of a table is one word."""


@dataclass
class Incoming:
    """What the user says, from standard input and from the page: lines, in the order in which they come.

    Attributes:
        lines: Of standard input or of the page; None: there is an end of standard input.
    """

    lines: queue.Queue[str | None] = field(default_factory=queue.Queue)

    def listen(self, stream: IO[str]) -> None:
        """Take the lines of a stream as they come, in a thread of its own that ends with the program."""

        def read() -> None:
            try:
                for line in stream:
                    self.lines.put(line)
            except (OSError, ValueError):  # closed, or no text: nothing more comes from there
                pass
            self.lines.put(None)

        threading.Thread(target=read, daemon=True).start()

    def waiting(self) -> list[str | None]:
        """All that came since the last time."""
        came: list[str | None] = []
        while True:
            try:
                came.append(self.lines.get_nowait())
            except queue.Empty:
                return came


def followed(
    session: Session, incoming: Incoming, pause: Callable[[float], None] = time.sleep
) -> Iterator[list[Event]]:
    """Events as the table grows, until the stop; those that belong together at once.

    Lines of standard input that are no commands are rows, appended to the campaign's table.

    Args:
        session: Of the campaign; its table is followed.
        incoming: What the user says.
        pause: Waits for some seconds.

    Raises:
        AridcalError: the table does not fit the campaign, or cannot be read or written.
    """
    (path,) = session.campaign.measurements.files
    seen: tuple[int, ...] = ()
    stamp: tuple[int, ...] = ()
    from_input = ended = False
    first = True
    while True:
        commands = []
        for line in incoming.waiting():
            if line is None:
                ended = from_input
            elif line.strip() in (REJECT, STOP):
                commands.append(line.strip())
            elif line.strip():
                _append(path, line)
                from_input = True
        stamp, looked = _stamp(path), stamp
        growing = session.campaign.measurements.traits.images and stamp != looked  # half an image, perhaps
        if stamp != seen and not growing:
            content = content_of(path, session.campaign.limits.table)
            new = session.table.take(content) if content is not None else []
            if content is not None:
                seen = stamp
            if new or first:
                yield session.taken(new)
                first = False
        elif first:
            yield session.taken([])
            first = False
        for command in commands:
            if not session.stopped:
                yield session.reject() if command == REJECT else session.asked()
        if ended and not growing and not session.stopped:
            yield session.asked()
        if session.stopped:
            return
        pause(LOOK_EVERY)


def _stamp(path: Path) -> tuple[int, ...]:
    """What changes when a file does; empty while there is none."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_dev, status.st_ino, status.st_mtime_ns, status.st_size


def _ends(path: Path) -> tuple[str, str]:
    """The first line of a table and its last character; empty where there is none."""
    if not path.exists():
        return "", ""
    with path.open("rb") as file:
        first = file.readline(LONGEST_HEADER).decode("utf-8").strip()
        file.seek(0, SEEK_END)
        if not file.tell():
            return "", ""
        file.seek(-1, SEEK_END)
        return first, file.read(1).decode("latin-1")


def _append(path: Path, line: str) -> None:
    """Put a row from standard input into the campaign's table, unless it is the header that is there already."""
    try:
        first, end = _ends(path)
        if first and first == line.strip():
            return
        append(path, ("\n" if end not in ("", "\n") else "") + line.rstrip("\r\n") + "\n")
    except (OSError, UnicodeError) as problem:
        raise MeasurementError(f"{path}: a row of standard input cannot be written to it: {problem}") from None


def to_calibrate(session: Session) -> Campaign:
    """The campaign that the full search is for: the rows in use, and what they show, slips among it, as declared effects.

    Where the table holds exactly these rows it is that table; else a table beside it, ``NAME.good.csv``, holds them. Lengths to
    points that could not be touched are left out: no row refers to these.

    Raises:
        OutputError: that cannot be written.
    """
    campaign, table = session.campaign, session.table
    (path,) = campaign.measurements.files
    usable = session.serving()
    content = content_of(path, campaign.limits.table)
    if content is None or content.replace(b"\r\n", b"\n") != table.text(usable):
        copy = path.with_name(f"{path.stem}.good{path.suffix}")
        with atomic_file(copy) as stage:
            stage.write_bytes(table.text(usable))
        settings = campaign.measurements.model_copy(update={"file": (copy,)})
        campaign = campaign.model_copy(update={"measurements": settings})
    number = {k: place for place, k in enumerate(usable)}
    shifts = []
    for first, frames in session.slips:
        line = next((table.first + number[k] for k in sorted(number) if k >= first), None)
        shifts += [EffectDeclaration(kind="shift", where=where, at=Moment(row=line)) for where in frames if line]
    shown = () if session.posterior is None or campaign.effects else shown_effects(session.posterior)
    lengths = tuple(
        length for length in campaign.instruments.lengths if not session.skipped_points & set(length.between)
    )
    instruments = campaign.instruments.model_copy(update={"lengths": lengths})
    return campaign.model_copy(update={"effects": (*campaign.effects, *shown, *shifts), "instruments": instruments})


def calibrated(session: Session, out: Path, progress: Progress) -> None:
    """Make the full search from all rows in use, and write its folder: the poses that check it are the rows held out.

    Raises:
        AridcalError: the rows cannot be calibrated from, or the folder cannot be written.
    """
    from aridcal.jobs.calibrate.job_inputs import read_job  # slow to load: only at the end
    from aridcal.jobs.calibrate.pipeline import identify

    job = read_job(to_calibrate(session), 0, progress)
    if not job.rows.origin.split_given:
        job = replace(job, rows=replace(job.rows, test=np.zeros(len(job.rows), dtype=bool)))
    write_folder(identify(job, progress=progress), out, progress)
