"""How much memory a calibration needs, told before it starts: what does not fit is refused, not tried."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from aridcal.errors import CampaignError
from aridcal.fit.constants import constants, frame_coefficients
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.dataset import Dataset
from aridcal.robot.chain import Robot
from aridcal.search.diagnose import SEARCHED

NUMBER = 8
"""Bytes of a float64."""

ITSELF = 300_000_000
"""Bytes of the program and its libraries."""

SQUARES = 18
"""Square matrices of all coefficients that are alive at the worst moment: sums of two channels at two places, their balanced
copies, factors, inverses and singular vectors."""

COLUMNS = 10
"""Copies of the constants' columns for the rows that are searched: the linear model's and some states'."""

ROW = 5_000
"""Bytes of a row in all that is kept of it: readings, residuals of every stage, views, curves, its lines in text."""

PAIR = 150_000
"""Bytes of what is tried for each pair of joints: couplings, functions of one load or of two covariates, and their columns."""

ROOTS = (Path("/sys/fs/cgroup"), Path("/sys/fs/cgroup/memory"))
"""Where Linux says what a container may use, in version 2 and in version 1."""

LIMITS = (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes"))


@dataclass(frozen=True)
class Need:
    """Bytes that a calibration takes, by what asks for them.

    Attributes:
        coefficients: Frames and constants.
        rows: Measurements.
        search: Candidates.
    """

    coefficients: int
    rows: int
    search: int

    @property
    def total(self) -> int:
        """All of it."""
        return ITSELF + self.coefficients + self.rows + self.search


def needed(campaign: Campaign, robot: Robot, rows: Dataset, labels: tuple[str, ...]) -> Need:
    """Estimate what a calibration takes, to a third.

    Args:
        campaign: Which coefficients, and whether effects are sought.
        robot: The nominal chain.
        rows: All rows.
        labels: All stations, where a frame is per station.
    """
    K = len(frame_coefficients(campaign, labels)) + len(constants(robot, campaign.parameters.set))
    m = sum(channel.size for channel in rows.channels)
    searched = min(len(rows), SEARCHED)
    sought = campaign.diagnosis.enabled and bool(campaign.diagnosis.candidates)
    return Need(
        coefficients=NUMBER * (SQUARES * K**2 + COLUMNS * searched * m * K),
        rows=ROW * len(rows),
        search=PAIR * len(robot.joints) ** 2 if sought else 0,
    )


def check_memory(
    campaign: Campaign, robot: Robot, rows: Dataset, labels: tuple[str, ...], available: int | None = None
) -> None:
    """Refuse a calibration for which there is not enough memory.

    Args:
        campaign: See :func:`needed`.
        robot: See there.
        rows: See there.
        labels: See there.
        available: Bytes; default: as the system says, and no check where it says nothing.

    Raises:
        CampaignError: with what it would need, what there is, and what to leave out.
    """
    need = needed(campaign, robot, rows, labels)
    there = available_memory() if available is None else available
    if there is None or need.total <= there:
        return
    K = len(frame_coefficients(campaign, labels)) + len(constants(robot, campaign.parameters.set))
    stations = f" ({len(labels):,} stations)" if labels else ""
    remedies = {
        need.coefficients: f"most of it for {K:,} frames' and constants' coefficients{stations}: "
        + ("split the table by stations" if labels else "take a smaller `parameters.set`, or a chain of fewer joints"),
        need.rows: f"most of it for {len(rows):,} rows: give fewer rows",
        need.search: f"most of it for the effects that {len(robot.joints)} joints may have: fewer candidates with "
        "`diagnosis: {candidates: [joint_compliance, …]}`, or none with `diagnosis: {enabled: false}`",
    }
    raise CampaignError(
        f"{campaign.path}: would need about {_gigabytes(need.total)} of memory, and {_gigabytes(there)} are available; "
        f"{remedies[max(remedies)]}"
    )


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:,.1f} GB"


def available_memory() -> int | None:
    """Bytes that the system has left for this process, and its container; None where that is not told."""
    found = []
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemAvailable:"):
            found.append(1024 * int(line.split()[1]))
    for folder in _groups():
        for limit, usage in LIMITS:
            most, used = _number(folder / limit), _number(folder / usage)
            if most is not None and used is not None:
                found.append(max(most - used + _cached(folder), 0))
    return min(found, default=None)


def _cached(folder: Path) -> int:
    """Bytes of files that the system keeps in a group's memory, and gives up when asked."""
    names = ("inactive_file", "total_inactive_file")
    found = (line.split() for line in _lines(folder / "memory.stat"))
    return max((int(size) for name, size in found if name in names), default=0)


def _groups() -> list[Path]:
    """Folders of the control groups that this process is in, and of those around them."""
    found = []
    for line in _lines(Path("/proc/self/cgroup")):
        inner = Path(line.rsplit(":", 1)[-1].lstrip("/"))
        for root in ROOTS:
            found += [root / part for part in (inner, *inner.parents)]
    return list(dict.fromkeys(found))


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
