"""Curves with bands about them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from aridcal.drawing.figures import AFTER, BEFORE, GREY, as_svg, one_axes, with_legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = (AFTER, BEFORE, "#009E73", "#CC79A7", GREY)
"""Okabe and Ito's, which everybody can tell apart; of more curves the first ones are drawn."""


@as_svg
def banded(
    key: str, alt: str, at: np.ndarray, values: Mapping[str, np.ndarray], labels: tuple[str, str], top: float | None
) -> Figure:
    """Some curves over one axis, each with the interval of its points.

    Args:
        key: Of the figure, unique in the page.
        alt: What the figure shows, for those who cannot see it.
        at: Shape (B,).
        values: By name, shape (B, 3): value, lower and upper end of the interval; NaN where there is none.
        labels: Of the two axes, with their units.
        top: Of the vertical axis; None: what the values need.
    """
    figure, axes = one_axes()
    for (name, v), color in zip(values.items(), COLOURS, strict=False):
        axes.fill_between(at, v[:, 1], v[:, 2], color=color, alpha=0.18, linewidth=0)
        axes.plot(at, v[:, 0], color=color, linewidth=1.8, marker="o", markersize=3.5, label=name)
    axes.set(xlabel=labels[0], ylabel=labels[1], ylim=(0, top))
    return with_legend(figure, axes, columns=3)
