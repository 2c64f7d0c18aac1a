"""A table that another program is writing: its complete lines, whatever happens to the file in between.

The file may be absent at first, be swapped for a longer one, end in half a line, be cut off, begin anew. Lines that were taken
stay
taken: of a file that does not go on as it was, those lines are new that were not taken as often as they stand there.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from aridcal.system.errors import MeasurementError
from aridcal.system.reading.regular_files import Limit, read_file


@dataclass
class GrowingTable:
    """Lines of a table as they come; it is changed by :meth:`take`.

    Attributes:
        first: Line of the first row, counted from 1.
        comment: Lines that begin with one of these are no rows.
        head: The lines above the first row.
        rows: Lines of rows so far, in the order in which they came.
    """

    first: int
    comment: tuple[str, ...] = ()
    head: list[bytes] = field(default_factory=list)
    rows: list[bytes] = field(default_factory=list)

    def take(self, content: bytes) -> list[int]:
        """Take the complete lines of the whole file as it is now.

        Returns:
            Indices of the rows that are new.

        Raises:
            MeasurementError: it begins with other column names than before.
        """
        lines = [line.rstrip(b"\r") for line in content.split(b"\n")[:-1]]
        above = self.first - 1
        if len(lines) < above:
            return []
        if self.head and lines[:above] != self.head:
            raise MeasurementError(
                "the table begins with other column names than before; give it the old ones again, or end this with "
                "`stop` and begin anew"
            )
        self.head = lines[:above]
        rows = [line for line in lines[above:] if self._is_row(line)]
        before = len(self.rows)
        if rows[:before] == self.rows:
            self.rows += rows[before:]
        else:
            taken = Counter(self.rows)
            for line in rows:
                if taken[line]:
                    taken[line] -= 1
                else:
                    self.rows.append(line)
        return list(range(before, len(self.rows)))

    def add(self, line: bytes) -> list[int]:
        """Take one more line, as of standard input: the lines above the first row come first; see :meth:`take`."""
        line = line.rstrip(b"\r\n")
        if len(self.head) < self.first - 1:
            self.head.append(line)
        elif self._is_row(line):
            self.rows.append(line)
            return [len(self.rows) - 1]
        return []

    def text(self, some: list[int]) -> bytes:
        """A table of some of the rows."""
        return b"".join(line + b"\n" for line in (*self.head, *(self.rows[k] for k in some)))

    def line(self, index: int) -> int:
        """Line of a row, as if the table had only grown."""
        return self.first + index

    def _is_row(self, line: bytes) -> bool:
        return bool(line.strip()) and not line.startswith(tuple(mark.encode() for mark in self.comment))


def content_of(path: Path, limit: Limit) -> bytes | None:
    """The whole file as it is now; None while it is absent, empty or being swapped."""
    try:
        if not path.stat().st_size:
            return None
        return read_file(path, MeasurementError, limit)
    except (OSError, MeasurementError):
        if not path.exists() or path.is_file():  # a moment later it may be there, or readable
            return None
        raise
