"""Runs of a study in figures: shares and medians with their intervals, the scatter of constants beside what they claim."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import binom

from aridcal.engine.corrections.effect import MOUNTING_FRAMES
from aridcal.jobs.fleet.run_record import DONE, Row

INTERVAL_CONFIDENCE = 0.95
"""Of all intervals of a study."""


@dataclass(frozen=True)
class Estimate:
    """A figure and its interval of :data:`INTERVAL_CONFIDENCE`."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class CaseFigures:
    """One case of a study.

    Attributes:
        rows: Measured; None where that is not varied.
        size: Of the effect; None where that is not varied.
        runs: Done.
        failed: Runs that came to nothing.
        finding_share: Share of runs that find the effect, by name or among those that are confounded with what they name.
        named: Share of runs that name it first.
        others: Share of runs that accept some effect that is not there.
        final: Median error of the final model, in the unit of its channel.
        true: The same against the truth; None where it is not known.
    """

    rows: int | None
    size: float | None
    runs: int
    failed: int
    finding_share: Estimate | None
    named: Estimate | None
    others: Estimate
    final: Estimate
    true: Estimate | None


@dataclass(frozen=True)
class ConstantScatter:
    """A constant over the runs of a case.

    Attributes:
        name: Of the constant.
        unit: ``m`` or ``rad``.
        runs: That identify it.
        scatter: Standard deviation of its values over them.
        low: Lower end of its interval.
        high: Upper end.
        std: What the runs state, RMS.
    """

    name: str
    unit: str
    runs: int
    scatter: float
    low: float
    high: float
    std: float


def share(times: int, of: int) -> Estimate:
    """A share with Wilson's interval (1927, doi:10.1080/01621459.1927.10502953), which stays within 0 and 1.

    Args:
        times: How often.
        of: Of how many, not 0.
    """
    z = float(ndtri(0.5 + 0.5 * INTERVAL_CONFIDENCE))
    p, shrink = times / of, 1.0 + z**2 / of
    middle = (p + z**2 / (2 * of)) / shrink
    half = z / shrink * math.sqrt(p * (1 - p) / of + z**2 / (4 * of**2))
    return Estimate(p, max(middle - half, 0.0), min(middle + half, 1.0))


def median(values: Sequence[float]) -> Estimate:
    """A median with the interval between two of the values, whatever they are distributed like (David and Nagaraja 2003, 7.1).

    With fewer than 6 values no two of them hold the median with this confidence; then the interval is all of them.
    """
    ordered = np.sort(values)
    n = len(ordered)
    below = max(int(binom.ppf(0.5 - 0.5 * INTERVAL_CONFIDENCE, n, 0.5)) - 1, 0)
    return Estimate(float(np.median(ordered)), float(ordered[below]), float(ordered[n - 1 - below]))


def points(rows: Sequence[Row]) -> list[CaseFigures]:
    """Cases of a study by size, then by number of rows."""
    cases: dict[tuple[float, float], list[Row]] = {}
    for row in rows:
        place = (-1.0 if row["size"] is None else row["size"], row["rows"] or 0)
        cases.setdefault(place, []).append(row)
    return [point for place in sorted(cases) if (point := _point(cases[place])) is not None]


def _point(rows: Sequence[Row]) -> CaseFigures | None:
    """One case; None if no run of it came to anything."""
    done = [row for row in rows if row["status"] == DONE]
    if not done:
        return None
    true = [row["true_rms_mm"] for row in done if row["true_rms_mm"] is not None]
    final = [row["final"] for row in done if row["final"] is not None]
    sought = done[0]["found"] is not None
    return CaseFigures(
        rows=done[0]["rows"],
        size=done[0]["size"],
        runs=len(done),
        failed=len(rows) - len(done),
        finding_share=share(sum(row["found"] for row in done), len(done)) if sought else None,
        named=share(sum(row["named"] for row in done), len(done)) if sought else None,
        others=share(sum(row["others"] > 0 for row in done), len(done)),
        final=median(final) if final else Estimate(math.nan, math.nan, math.nan),
        true=median(true) if true else None,
    )


def recurrent_effects(rows: Sequence[Row]) -> list[tuple[str, Estimate]]:
    """Each effect that some run found, and the share of runs that did, most first."""
    done = [row for row in rows if row["status"] == DONE]
    count: dict[str, int] = {}
    for row in done:
        for label in row["effects"]:
            count[label] = count.get(label, 0) + 1
    ordered = sorted(count.items(), key=lambda pair: (-pair[1], pair[0]))
    return [(label, share(times, len(done))) for label, times in ordered]


def scatters(rows: Sequence[Row]) -> list[ConstantScatter]:
    """How far each constant of the arm scatters over the runs, beside what they state, the most understated first.

    The interval of a standard deviation is that of normal values with so many degrees of freedom, by Wilson and Hilferty (1931,
    doi:10.1073/pnas.17.12.684).
    """
    values: dict[str, list[Row]] = {}
    for row in rows:
        for constant in row["constants"] or () if row["status"] == DONE else ():
            if constant["name"].startswith(
                MOUNTING_FRAMES
            ):  # stated as twists in their own axes, which xyz and rpy are not
                continue
            values.setdefault(constant["name"], []).append(constant)
    found = [_scatter(name, own) for name, own in values.items() if len(own) > 1]
    return sorted(found, key=lambda s: -s.scatter / s.std if s.std > 0 else -math.inf)


def _scatter(name: str, own: Sequence[Row]) -> ConstantScatter:
    freedom = len(own) - 1
    spread = float(np.std([c["value"] for c in own], ddof=1))
    z, v = float(ndtri(0.5 + 0.5 * INTERVAL_CONFIDENCE)), 2.0 / (9.0 * freedom)
    low, high = (spread / max(1.0 - v + s * z * math.sqrt(v), 1e-3) ** 1.5 for s in (1.0, -1.0))
    std = float(np.sqrt(np.mean([c["std"] ** 2 for c in own])))
    return ConstantScatter(name, own[0]["unit"], len(own), spread, low, high, std)
