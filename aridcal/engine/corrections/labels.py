"""Labels of rows as covariates: 1 in the rows of a station, 0 in all others."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

LABEL_COLUMN = "station"
"""The column of labels: of stations, of squares, of whatever rows are alike in."""

MOST_LABELS = 100
"""Stations or places of which each may deviate by itself: of more the mean over the rows of one is what counts anyhow."""


def label_column(label: str) -> str:
    """Name of the covariate that is 1 in the rows of a station."""
    return f"{LABEL_COLUMN}[{label}]"


def label_in(name: str) -> str:
    """The label of a covariate of a station."""
    return name[len(LABEL_COLUMN) + 1 : -1]


def is_label(name: str) -> bool:
    """True for a covariate of a station."""
    return name.startswith(f"{LABEL_COLUMN}[") and name.endswith("]")


def labels_in(station: np.ndarray | None) -> list[str]:
    """Different labels of some rows, sorted; a row with an empty one has none."""
    return [] if station is None else [str(label) for label in np.unique(station) if label]


def label_columns(names: Iterable[str], station: np.ndarray | None) -> dict[str, np.ndarray]:
    """The covariates of labels among some names, shape (N,) each; none where the rows have no labels at all.

    Args:
        names: Of covariates, others among them.
        station: Label of each row, shape (N,).
    """
    if station is None:
        return {}
    return {name: (station == label_in(name)).astype(float) for name in names if is_label(name)}
