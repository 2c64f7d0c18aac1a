"""A second look as plain data, for ``result.json``."""

from __future__ import annotations

from typing import Any

from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.combinations import Known
from aridcal.engine.trust.cross_validation import Folds, Influence
from aridcal.engine.trust.halves import Halves
from aridcal.engine.trust.second_look import SecondLook

MOST = 20
"""Drawn: Rows of which the influence is written."""


def document(looked: SecondLook, train: Dataset) -> dict[str, Any]:
    """What a second look found, under the keys of ``result.json``.

    Args:
        looked: At a calibration.
        train: The rows that it was fitted to.
    """
    found: dict[str, Any] = {
        "halves": {name: _halves(each) for name, each in looked.halves.items() if each is not None}
    }
    if looked.folds is not None:
        found["folds"] = _folds(looked.folds, train)
    if looked.influence is not None:
        found["influence"] = _influence(looked.influence, train)
    if looked.known is not None:
        found["known"] = _known(looked.known)
    return found


def _halves(found: Halves) -> dict[str, Any]:
    """Halves of one stage."""
    return {
        "p_value": found.p_value,
        "agree": found.agree,
        "divided_by": found.of,
        "into": found.how,
        "squares": found.squares,
        "degrees_of_freedom": list(found.freedom),
        "divisions": found.divisions,
        "rows": found.rows,
        "position_mm": {"measured": 1e3 * found.measured, "expected": 1e3 * found.expected},
    }


def _folds(found: Folds, train: Dataset) -> dict[str, Any]:
    """Errors of rows left out, by channel."""
    by_channel = zip(train.channels, found.mean, found.spread, found.fitted, found.error.T, strict=True)
    return {
        c.key: {
            "rms": c.scale * float(mean),
            "spread": c.scale * float(spread),
            "fitted": c.scale * float(fitted),
            "each": [c.scale * float(value) for value in each],
        }
        for c, mean, spread, fitted, each in by_channel
    }


def _influence(found: Influence, train: Dataset) -> dict[str, Any]:
    """The rows that move the target most."""
    rows = [
        {
            "file": train.origin.files[train.origin.file[k]].name,
            "row": int(train.origin.line[k]),
            "shift_mm": 1e3 * float(found.shift[i]),
            "leverage": float(found.leverage[i]),
            "cook": float(found.cook[i]),
        }
        for i, k in enumerate(found.rows[:MOST].tolist())
    ]
    return {"target_std_mm": 1e3 * found.sigma, "deciding": len(found.deciding), "rows": rows}


def _known(found: Known) -> dict[str, Any]:
    """Combinations of constants, and minimal sets."""
    return {
        "combinations": [
            {"parts": dict(c.parts), "unit": c.unit or "m and rad", "std": c.std} for c in found.combinations
        ],
        "pairs": [
            {
                "constants": [p.first, p.second],
                "unit": p.unit,
                "std_of_sum": p.of_sum,
                "std_of_difference": p.of_difference,
            }
            for p in found.pairs
        ],
        "minimal_set": list(found.names),
        "could_stay_nominal": list(found.spare),
        "target_mm": {"moves": 1e3 * found.shift, "std": 1e3 * found.sigma},
    }
