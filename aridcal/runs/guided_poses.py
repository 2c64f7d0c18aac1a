"""A campaign guided from Python: poses one after another, until it is enough."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aridcal.files.campaign import Campaign, nominal_robot
from aridcal.jobs.guide.events import Alarm, Event, Known, Next, RowRead, Stop
from aridcal.jobs.guide.growing_table import content_of
from aridcal.jobs.guide.session import Session, session
from aridcal.runs.guided_campaign import to_calibrate
from aridcal.system.errors import MeasurementError, name_list
from aridcal.system.writing.append import append

Cells = Mapping[str, float | str]
"""What was measured, by column."""


@dataclass
class GuidedPose:
    """The pose to measure next.

    Attributes:
        joints: By column, in the campaign's units.
        measure: Columns that say what is measured there, where there are several things.
        why: What it is for.
    """

    joints: Mapping[str, float]
    measure: Mapping[str, str]
    why: str
    _of: Guided

    def record(self, measured: Cells | Sequence[Cells]) -> list[Alarm]:
        """Append a row to the campaign's table, or all rows of an image, and judge it.

        Args:
            measured: What was measured, by column, in the campaign's units: ``{"x": …, "y": …, "z": …}``. The joints are
                those of the pose, unless their columns stand here: readings of the moment are better. Of an image one for
                each corner: ``[{"marker": …, "u": …, "v": …}, …]``.

        Returns:
            What calls for action; empty where the row is good.

        Raises:
            AridcalError: the row does not have the table's columns, or cannot be written; or nothing was measured.
        """
        rows = [measured] if isinstance(measured, Mapping) else measured
        return self._of.take([{**self.joints, **self.measure, **row} for row in rows])

    def reject(self) -> None:
        """Ask for another pose in place of this one."""
        self._of.said(self._of.session.reject())


@dataclass
class Guided:
    """A campaign that is being measured; iterate over its poses, and record what was measured at each.

    Attributes:
        session: What is known of it.
        events: All that was said so far.
    """

    session: Session
    events: list[Event] = field(default_factory=list)

    def __iter__(self) -> Iterator[GuidedPose]:
        """Poses, until it is enough."""
        while not self.session.stopped:
            number = len(self.events)
            following = next(event for event in reversed(self.events) if isinstance(event, Next))
            yield GuidedPose(following.joints, following.labels, following.why, self)
            if len(self.events) == number:
                raise MeasurementError(
                    "nothing was recorded of the last pose; call its `record` or `reject`, or leave the loop"
                )

    @property
    def rows(self) -> list[RowRead]:
        """Each row that was read, and whether it is good by now."""
        return [*{event.row: event for event in self.events if isinstance(event, RowRead)}.values()]

    @property
    def known(self) -> Known | None:
        """How well the target is known; None while rows are too few to say so."""
        return next((event for event in reversed(self.events) if isinstance(event, Known)), None)

    @property
    def stop(self) -> Stop | None:
        """Why it is enough, and poses that check the result; None before that."""
        return next((event for event in reversed(self.events) if isinstance(event, Stop)), None)

    @property
    def campaign(self) -> Campaign:
        """For :func:`aridcal.calibrate`: the rows in use, with what moved between them."""
        return to_calibrate(self.session)

    def end(self) -> None:
        """End it: what is known is enough."""
        self.said(self.session.asked())

    def said(self, events: list[Event]) -> list[Event]:
        """Keep what was said."""
        self.events += events
        return events

    def take(self, rows: Sequence[Cells]) -> list[Alarm]:
        """Append rows and judge them; see :meth:`GuidedPose.record`."""
        path = self._path
        if not rows:
            raise MeasurementError(f"{path}: nothing was measured: call `reject` for another pose")
        dialect = self.session.campaign.measurements.table.dialect
        content = content_of(path, self.session.campaign.limits.table)
        begun = content is not None
        if not begun and dialect.begins != 2:
            raise MeasurementError(
                f"{path}: is not there, and `table` of the campaign describes more than one line above its rows"
            )
        names = (
            content.decode(dialect.encoding).splitlines()[dialect.begins - 2].split(dialect.separator)
            if content
            else [*rows[0]]
        )
        names = [name.strip().strip('"') for name in names]
        missing = [name for name in names if any(name not in cells for cells in rows)]
        if missing:
            raise MeasurementError(f"{path}: the table has columns that were not recorded: {name_list(missing)}")
        lines = [dialect.separator.join(_cell(cells[name], dialect.decimal) for name in names) for cells in rows]
        head = [] if begun else [dialect.separator.join(names)]
        text = "".join(f"{line}\n" for line in (*head, *lines))
        try:
            append(path, text if not content or content.endswith(b"\n") else f"\n{text}")
        except OSError as problem:
            raise MeasurementError(f"{path}: the row cannot be written to it: {problem}") from None
        return [event for event in self.said(self.look()) if isinstance(event, Alarm)]

    def look(self) -> list[Event]:
        """Take what stands in the table by now."""
        content = content_of(self._path, self.session.campaign.limits.table)
        return self.session.taken([] if content is None else self.session.table.take(content))

    @property
    def _path(self) -> Path:
        (path,) = self.session.campaign.measurements.files
        return path


def _cell(value: float | str, decimal: str) -> str:
    """A number or a word as the table has it."""
    return value if isinstance(value, str) else repr(float(value)).replace(".", decimal)


def guided(campaign: Campaign, tolerance: float | None) -> Guided:
    """A campaign that is to be measured, or goes on where its table ends.

    Args:
        campaign: Its table may not be there yet.
        tolerance: [m]; None: the campaign's, if it has one.

    Raises:
        AridcalError: the campaign or its table needs mending.
    """
    tolerance = tolerance or (campaign.tolerance.position if campaign.tolerance else None)
    begun = Guided(session(campaign, nominal_robot(campaign), tolerance))
    begun.said(begun.look())
    return begun
