"""How much memory a calibration needs, estimated before it starts: what does not fit is refused, not tried."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from aridcal.system.errors import CampaignError

BYTES_OF_A_NUMBER = 8
"""Bytes of a float64."""

BYTES_OF_THE_PROGRAM = 300_000_000
"""Bytes of the program and its libraries."""

SQUARE_MATRICES = 18
"""Square matrices of all coefficients that are alive at the worst moment: sums of two channels at two places, their balanced
copies, factors, inverses and singular vectors."""

COPIES_OF_COLUMNS = 10
"""Copies of the constants' columns for the rows that are searched: the linear model's and some states'."""

BYTES_OF_A_ROW = 1_500
"""Bytes of a row in all that is kept of it: readings, residuals of every stage, its cells in text. A million rows of poses of
six joints took 750 each, where nothing was sought; an effect's columns and conditions come to that."""

BYTES_OF_A_PAIR = 150_000
"""Bytes of what is tried for each pair of joints: couplings, functions of one load or of two covariates, and their columns."""

ROOTS = (Path("/sys/fs/cgroup"), Path("/sys/fs/cgroup/memory"))
"""Where Linux says what a container may use, in version 2 and in version 1."""

CGROUP_LIMITS = (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes"))


@dataclass(frozen=True)
class Size:
    """How large a calibration is.

    Attributes:
        coefficients: Frames' and constants'.
        stations: With a frame each; 0 where there is one for all.
        rows: Measured.
        searched: Of them, where effects are sought; 0 where none are.
        numbers: Measured in each row.
        joints: Of the chain.
    """

    coefficients: int
    stations: int
    rows: int
    searched: int
    numbers: int
    joints: int

    @property
    def needs(self) -> dict[str, int]:
        """Bytes that the calibration takes, right to a third, by what needs them."""
        K = self.coefficients
        return {
            "coefficients": BYTES_OF_A_NUMBER
            * (SQUARE_MATRICES * K**2 + COPIES_OF_COLUMNS * self.searched * self.numbers * K),
            "rows": BYTES_OF_A_ROW * self.rows,
            "search": BYTES_OF_A_PAIR * self.joints**2 if self.searched else 0,
        }


def check_memory(size: Size, place: str, available: int | None) -> None:
    """Refuse a calibration for which there is not enough memory.

    Args:
        size: Of the calibration.
        place: The campaign, for the message.
        available: Bytes, see :func:`available_memory`; None: not known, and nothing is refused.

    Raises:
        CampaignError: with what it would need, what there is, and what to leave out.
    """
    needs = size.needs
    total = BYTES_OF_THE_PROGRAM + sum(needs.values())
    if available is None or total <= available:
        return
    remedies = {
        "coefficients": f"{size.coefficients:,} coefficients of frames and constants"
        + (
            f" at {size.stations:,} stations: split the table by stations"
            if size.stations
            else ": take a smaller `parameters: {set: …}`"
        ),
        "rows": f"{size.rows:,} rows: give fewer",
        "search": f"effects that {size.joints} joints may have: fewer candidates with `diagnosis: {{candidates: "
        "[joint_compliance]}`, or none with `diagnosis: {enabled: false}`",
    }
    most = max(needs, key=lambda what: needs[what])
    raise CampaignError(
        f"{place}: would need about {_gigabytes(total)} of memory, and {_gigabytes(available)} are available. Most of it is for "
        f"{remedies[most]}"
    )


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:,.1f} GB"


def available_memory() -> int | None:
    """Bytes that the system, and the process's container, have left for this process; None where neither says."""
    amounts = []
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemAvailable:"):
            amounts.append(1024 * int(line.split()[1]))
    for folder in _groups():
        for limit, usage in CGROUP_LIMITS:
            most, used = _number(folder / limit), _number(folder / usage)
            if most is not None and used is not None:
                amounts.append(max(most - used + _cached(folder), 0))
    return min(amounts, default=None)


def _cached(folder: Path) -> int:
    """Bytes of files that the system keeps in a group's memory, and gives up when asked."""
    names = ("inactive_file", "total_inactive_file")
    fields = (line.split() for line in _lines(folder / "memory.stat"))
    return max((int(size) for name, size in fields if name in names), default=0)


def _groups() -> list[Path]:
    """Folders of the control groups that this process is in, and of those around them."""
    folders = []
    for line in _lines(Path("/proc/self/cgroup")):
        inner = Path(line.rsplit(":", 1)[-1].lstrip("/"))
        for root in ROOTS:
            folders += [root / part for part in (inner, *inner.parents)]
    return list(dict.fromkeys(folders))


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except OSError:
        return []


def _number(path: Path) -> int | None:
    text = "".join(_lines(path)[:1])
    return (
        int(text) if text.isdecimal() and int(text) < os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") else None
    )
