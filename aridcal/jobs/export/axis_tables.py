"""Compensation tables of controllers, one for each joint that has an error curve of its own, and what a table leaves of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from aridcal.engine.corrections.basis import evaluate
from aridcal.engine.corrections.effect import Coefficient
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import OutputError

WITHIN_STEP = 24
"""Places in each step of the grid at which the curve is compared with the line between two entries: a wave that is four steps
long is then met within 0.1 % of its height."""

MOST_ENTRIES = 100_000
"""Work: of one table, in memory and in files of some megabytes; controllers take some hundreds to some thousands."""

LINUXCNC_ENTRIES = 256
"""That LinuxCNC reads of a file (its documentation, COMP_FILE)."""

GRID_SLACK = 1e-9
"""In steps: a grid whose end is missed by rounding alone has that end."""


@dataclass(frozen=True)
class AxisTable:
    """Where a joint really stands, for readings of a grid.

    Attributes:
        joint: Its name.
        turns: True of a revolute joint: rad, and degrees in files of controllers; else m, and mm.
        zero: What the controller shows where the reading is zero, [rad] or [m].
        readings: Multiples of a step, shape (n,), [rad] or [m]: those of the range that was measured, and one beyond each end.
        rising: What is to be added to a reading that was reached from below, shape (n,).
        falling: The same from above; equal to ``rising`` of a joint without backlash.
        worst: Largest difference of the curve from the lines between the entries, over all that was measured.
        largest: Largest correction.
    """

    joint: str
    turns: bool
    zero: float
    readings: np.ndarray
    rising: np.ndarray
    falling: np.ndarray
    worst: float
    largest: float

    @property
    def unit(self) -> str:
        """Of files of controllers."""
        return "deg" if self.turns else "mm"

    @property
    def scale(self) -> float:
        """From rad or m to that unit."""
        return 180.0 / np.pi if self.turns else 1e3

    @property
    def step(self) -> float:
        """Distance of two entries, [rad] or [m]."""
        return float(self.readings[1] - self.readings[0])


def axis_tables(saved: SavedModel, angle: float | None, length: float | None) -> list[AxisTable]:
    """Make the tables of all joints that have a curve of their own.

    Args:
        saved: The calibration.
        angle: Step of joints that turn, [rad]; None: these have no table.
        length: Step of joints that slide, [m].

    Raises:
        OutputError: no joint has a curve, the step of one is not given, is larger than its range, or far too small.
    """
    model = saved.final.model
    tables, lacking = [], []
    for joint in model.robot.joints:
        own = [k for k, c in enumerate(model.coefficients) if c.where == joint.name and _own(c)]
        alone = joint.drive.factors == {joint.name: 1.0} and not joint.drive.offset
        if not own or not alone:
            continue
        step = length if joint.kind == "prismatic" else angle
        if step is None:
            lacking.append(f"{joint.name} ({'5mm' if joint.kind == 'prismatic' else '1deg'})")
            continue
        low, high = saved.ranges[joint.name]
        first, last = np.floor(low / step + GRID_SLACK), np.ceil(high / step - GRID_SLACK)
        if not (step <= high - low and last - first < MOST_ENTRIES):
            raise OutputError(
                f"--table: {joint.name} was measured from {low:.4g} to {high:.4g}: a step of {step:.4g} is too "
                f"{'large' if step > high - low else 'small'}: from one step to {MOST_ENTRIES:,} entries are possible"
            )
        readings = np.arange(first, last + 1) * step
        fine = np.linspace(low, high, int((high - low) / step * WITHIN_STEP) + 2)
        coefficients, theta = [model.coefficients[k] for k in own], saved.final.theta[own]
        ways = [_curve(coefficients, theta, joint.name, readings, sense) for sense in (1.0, -1.0)]
        exact = [_curve(coefficients, theta, joint.name, fine, sense) for sense in (1.0, -1.0)]
        lines = [np.interp(fine, readings, way) for way in ways]
        tables.append(
            AxisTable(
                joint.name, joint.kind != "prismatic", float(saved.controller_zeros.get(joint.name, 0.0)), readings,
                ways[0],
                ways[1], float(np.abs(np.subtract(exact, lines)).max()), float(np.abs(exact).max()),
            )
        )  # fmt: skip
    if lacking:
        raise OutputError(
            f"--table: no step for {', '.join(lacking)}: write it, too, with a comma between: --table 1deg,5mm"
        )
    if not tables:
        raise OutputError(
            "--table: no joint has an error curve of its own: joint_offsets.yaml holds all that tables could"
        )
    return tables


def linuxcnc(table: AxisTable) -> str:
    """A file for COMP_FILE of LinuxCNC, COMP_FILE_TYPE 0: where it should be, where it is from below, and from above."""
    shown = (table.readings + table.zero) * table.scale
    columns = (shown, shown + table.rising * table.scale, shown + table.falling * table.scale)
    return "".join(f"{a:.6f} {b:.6f} {c:.6f}\n" for a, b, c in zip(*columns, strict=True))


def siemens(table: AxisTable, number: int, about: Iterable[str]) -> str:
    """A file for the encoder error compensation of SINUMERIK: one value at each place, the mean of both directions.

    The control adds it to the position that it has measured; the axis then moves the other way.

    Args:
        table: Of a joint.
        number: Of the machine's axis, 1 for AX1.
        about: What the file says of itself, a line each.
    """
    values = (table.rising + table.falling) / 2.0 * table.scale
    shown = (table.readings + table.zero) * table.scale
    name = f"AX{number}"
    lines = [f"%_N_{name}_EEC_INI", *(f"; {line}" for line in about), "CHANDATA(1)"]
    lines += [f"$AA_ENC_COMP[0,{k},{name}]={value:.6f}" for k, value in enumerate(values)]
    ends = (("STEP", table.step * table.scale), ("MIN", shown[0]), ("MAX", shown[-1]))
    lines += [f"$AA_ENC_COMP_{key}[0,{name}]={value:.6f}" for key, value in ends]
    return "\n".join([*lines, f"$AA_ENC_COMP_IS_MODULO[0,{name}]=0", "M17", ""])


def heidenhain(table: AxisTable) -> str:
    """Rows for the columns AXISPOS, BACKLASH and the axis's own of a HEIDENHAIN .com table: csv, which is no .com itself."""
    shown = (table.readings + table.zero) * table.scale
    rows = zip(shown, table.falling * table.scale, table.rising * table.scale, strict=True)
    return "AXISPOS,BACKLASH,VALUE\n" + "".join(f"{a:.6f},{b:.6f},{c:.6f}\n" for a, b, c in rows)


def _own(c: Coefficient) -> bool:
    """True for what moves a joint along its axis as a function of its own position, or of the side that it came from."""
    return c.component == "axis" and bool(c.basis.of) and set(c.basis.of) <= {c.where, f"{c.where}_direction"}


def _curve(coefficients: list[Coefficient], theta: np.ndarray, joint: str, at: np.ndarray, sense: float) -> np.ndarray:
    """What is to be added to readings that were reached in a sense, shape (n,)."""
    covariates = {joint: at, f"{joint}_direction": np.full(len(at), sense)}
    return np.asarray(theta @ np.array([evaluate(c.basis, covariates) for c in coefficients]))
