"""Figures of matplotlib for Python users: what a calibration left, before and after. None of them touches pyplot's state."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from aridcal.engine.instruments.channels import INCLINATION, LENGTH, PIXEL, TARGET_POSITION, TARGET_ROTATION, Channel
from aridcal.jobs.calibrate.folder import residual_table
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.figures import AFTER, BEFORE
from aridcal.system.errors import AridcalError

if TYPE_CHECKING:
    import pandas as pd

WIDTH, HEIGHT = 4.2, 2.6
"""Of one panel, [in]."""

PANELS_PER_ROW = 3
"""Panels side by side: a notebook is some 12 inches wide."""

MAP = "cividis"
"""Colours that rise evenly in lightness, and that colour-blind readers see as all others do."""

MODEL_STYLES: dict[str, dict[str, Any]] = {
    "before": {"color": BEFORE, "marker": "o", "mfc": "none"},
    "after": {"color": AFTER, "marker": "."},
}
"""Told apart by their signs as well as by their colours, Okabe and Ito's."""

PLOTTED_CHANNELS = (TARGET_POSITION, TARGET_ROTATION, LENGTH, PIXEL, INCLINATION)


class Picture(Figure):
    """A figure that notebooks show without pyplot as well."""

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        self.savefig(content, format="png", dpi=100)
        return content.getvalue()


@dataclass(frozen=True)
class Quantity:
    """What N rows leave of one quantity that was measured.

    Attributes:
        name: Of its block, where there are several, and what an error of it is called.
        unit: In which it is shown.
        axes: Names of its numbers.
        before: By the nominal model, shape (N, k), [unit]; NaN of rows that do not measure it.
        after: By the final one.
    """

    name: str
    unit: str
    axes: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray

    @property
    def sizes(self) -> dict[str, np.ndarray]:
        """Length of each row's error before and after, shape (N,)."""
        return {"before": np.linalg.norm(self.before, axis=1), "after": np.linalg.norm(self.after, axis=1)}


@dataclass(frozen=True)
class Arm:
    """Where N rows have the arm and the target.

    Attributes:
        joints: Readings by joint, with their units, shape (N,) each, [deg] or [m].
        places: Of the target, shape (N, 3), [m].
        label: What ``sizes`` are, with their unit.
        sizes: Of each row's error before and after, shape (N,).
    """

    joints: Mapping[str, np.ndarray]
    places: np.ndarray
    label: str
    sizes: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Plots:
    """Figures of a calibration, each a ``matplotlib.figure.Figure`` to be shown, changed or saved.

    Rows that were flagged as outliers are in none of them.

    Example:
        cal.plot.errors().savefig("errors.pdf")
    """

    quantities: tuple[Quantity, ...]
    sound: np.ndarray
    held_out: np.ndarray
    arm: Arm | None

    def errors(self) -> Figure:
        """Distribution of the errors of held-out rows (of fitted ones, if none are) before and after, a panel a quantity."""
        judged = self.sound & self.held_out
        rows, judged = ("held-out rows", judged) if judged.any() else ("fitted rows", self.sound)
        figure, panels = _grid(len(self.quantities))
        for panel, quantity in zip(panels, self.quantities, strict=True):
            for when, size in quantity.sizes.items():
                own = np.sort(size[judged & np.isfinite(size)])
                share = 100 * np.arange(1, len(own) + 1) / max(len(own), 1)
                rms = np.sqrt(np.mean(own**2)) if len(own) else np.nan
                label = f"{when}: RMS {rms:.3g} {quantity.unit}"
                dash = "--" if when == "before" else "-"
                panel.step(own, share, where="post", color=MODEL_STYLES[when]["color"], linestyle=dash, label=label)
            _scaled(panel, quantity.sizes.values(), "x")
            panel.set(xlabel=f"{quantity.name} [{quantity.unit}]", ylabel=f"{rows} below [%]", ylim=(0, 102))
            panel.legend(fontsize="small")
        return figure

    def residuals(self) -> Figure:
        """Measured minus predicted over the rows in their order, before and after, a panel for each number that they measure."""
        figure, panels = _grid(sum(len(quantity.axes) for quantity in self.quantities))
        row = np.flatnonzero(self.sound) + 1
        for quantity in self.quantities:
            for k, axis in enumerate(quantity.axes):
                panel = next(panels)
                for when, values in (("before", quantity.before), ("after", quantity.after)):
                    _dots(panel, row, values[self.sound, k], when)
                panel.axhline(0.0, color="0.5", linewidth=0.8)
                panel.set(xlabel="row", ylabel=f"{axis} [{quantity.unit}]", title=quantity.name)
        _legend(figure)
        return figure

    def joints(self) -> Figure:
        """Size of each row's error over the readings of each joint, before and after.

        Raises:
            AridcalError: the calibration was loaded.
        """
        arm = self._arm("joints")
        figure, panels = _grid(len(arm.joints))
        for panel, (joint, reading) in zip(panels, arm.joints.items(), strict=True):
            for when, size in arm.sizes.items():
                _dots(panel, reading[self.sound], size[self.sound], when)
            _scaled(panel, [size[self.sound] for size in arm.sizes.values()], "y")
            panel.set(xlabel=joint, ylabel=arm.label)
        _legend(figure)
        return figure

    def workspace(self) -> Figure:
        """Where in the workspace rows err how much, before and after in the same colours, seen along its thinnest axis.

        Raises:
            AridcalError: the calibration was loaded.
        """
        arm = self._arm("workspace")
        places, sizes = arm.places[self.sound], {when: size[self.sound] for when, size in arm.sizes.items()}
        first, second = sorted(np.argsort(np.ptp(places, axis=0))[1:].tolist())
        every = np.concatenate([size[np.isfinite(size)] for size in sizes.values()])
        ends = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
        norm = LogNorm(*ends) if 0.0 < ends[0] < ends[1] else Normalize(*ends)
        figure, panels = _grid(len(sizes), height=3.6)
        used = []
        for panel, (when, size) in zip(panels, sizes.items(), strict=True):
            order = np.argsort(size)  # the worst on top
            at = places[order]
            drawn = panel.scatter(at[:, first], at[:, second], c=size[order], s=14, cmap=MAP, norm=norm)
            panel.set(xlabel=f"{'xyz'[first]} [m]", ylabel=f"{'xyz'[second]} [m]", title=when, aspect="equal")
            used.append(panel)
        figure.colorbar(drawn, ax=used, label=arm.label)
        return figure

    def _arm(self, what: str) -> Arm:
        if self.arm is None:
            raise AridcalError(
                f"`plot.{what}` needs the measurements behind a calibration, and this one was loaded: "
                "`aridcal.calibrate(campaign)` has them"
            )
        return self.arm


def plots_of(outcome: Outcome) -> Plots:
    """Figures of a calibration whose measurements are there."""
    plots, m, order = plots_of_table(residual_table(outcome)), outcome.measurements, outcome.measurements.as_read
    turns = [kind != "prismatic" for kind in m.kinds]
    joints = {
        f"{name} [{'deg' if turning else 'm'}]": np.degrees(column) if turning else column
        for name, turning, column in zip(m.names, turns, m.readings[order].T, strict=True)
    }
    stages = {"before": outcome.stages[0], "after": outcome.stages[-1]}
    sizes = {
        when: 1e3 * np.linalg.norm(outcome.at_target.shift(stage.residual)[order], axis=1)
        for when, stage in stages.items()
    }
    label = "error at the target [mm]"
    if not any(np.isfinite(size).any() for size in sizes.values()):
        first = plots.quantities[0]
        sizes, label = first.sizes, f"{first.name} [{first.unit}]"
    arm = Arm(joints, outcome.at_target.places[order], label, sizes)
    return Plots(plots.quantities, plots.sound, plots.held_out, arm)


def plots_of_table(table: pd.DataFrame) -> Plots:
    """Figures of a calibration of which nothing is there but ``residuals.csv``.

    Raises:
        KeyError: the table is none of that kind.
    """
    first = "nominal" if any(str(name).startswith("nominal_") for name in table) else "before"
    stages = {stage: [name for name in map(str, table) if name.startswith(f"{stage}_")] for stage in (first, "final")}
    quantities = [
        Quantity(
            f"{block.replace('_', ' ').strip()} {channel.noun}".strip(),
            channel.shown,
            channel.axes,
            *(
                channel.scale * table[[f"{stage}_{block}{axis}" for axis in channel.axes]].to_numpy(float)
                for stage in stages
            ),
        )
        for channel in PLOTTED_CHANNELS
        for block in _blocks(channel, {name.removeprefix("final_") for name in stages["final"]})
    ]
    if not quantities:
        raise KeyError("no residuals of what was measured of the target")
    return Plots(tuple(quantities), table["outlier"].to_numpy() == 0, table["split"].to_numpy() == "test", None)


def _blocks(channel: Channel, names: set[str]) -> Iterator[str]:
    """What stands before a channel's axes in the names of residuals: nothing, or a block and a line below."""
    last = channel.axes[0]
    for name in sorted(names):
        block = name.removesuffix(last)
        if (
            name.endswith(last)
            and (not block or block.endswith("_"))
            and {f"{block}{a}" for a in channel.axes} <= names
        ):
            yield block


def _grid(count: int, height: float = HEIGHT) -> tuple[Figure, Iterator[Axes]]:
    """A figure with so many panels, and these."""
    columns = min(max(count, 1), PANELS_PER_ROW)
    rows = -(-max(count, 1) // columns)
    figure = Picture(figsize=(WIDTH * columns, height * rows), layout="constrained")
    return figure, iter([figure.add_subplot(rows, columns, k + 1) for k in range(count)])


def _dots(panel: Axes, x: np.ndarray, y: np.ndarray, when: str) -> None:
    panel.plot(x, y, linestyle="none", markersize=3, label=when, rasterized=len(x) > 1000, **MODEL_STYLES[when])


def _scaled(panel: Axes, values: Iterable[np.ndarray], axis: str) -> None:
    """Equal lengths are equal ratios where nothing is zero: after is often a tenth of before."""
    every = np.concatenate(list(values))
    every = every[np.isfinite(every)]
    if len(every) and every.min() > 0.0:
        panel.set(**{f"{axis}scale": "log"})


def _legend(figure: Figure) -> None:
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False)
