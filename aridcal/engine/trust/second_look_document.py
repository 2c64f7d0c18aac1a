"""A second look as plain data, for ``result.json``."""

from __future__ import annotations

from typing import Any

from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.combinations import Identifiability
from aridcal.engine.trust.cross_validation import Folds, Influence
from aridcal.engine.trust.halves import Halves
from aridcal.engine.trust.second_look import SecondLook

MOST_INFLUENCES = 20
"""Drawn: Rows of which the influence is written."""


def document(look: SecondLook, train: Dataset) -> dict[str, Any]:
    """A second look under its keys in ``result.json``.

    Args:
        look: The second look at a calibration.
        train: The rows that the calibration was fitted to.
    """
    parts: dict[str, Any] = {"halves": {name: _halves(each) for name, each in look.halves.items() if each is not None}}
    if look.folds is not None:
        parts["folds"] = _folds(look.folds, train)
    if look.influence is not None:
        parts["influence"] = _influence(look.influence, train)
    if look.identifiability is not None:
        parts["known"] = _known(look.identifiability)
    return parts


def _halves(halves: Halves) -> dict[str, Any]:
    """The halves of one stage, [mm]."""
    return {
        "p_value": halves.p_value,
        "agree": halves.agree,
        "divided_by": halves.of,
        "into": halves.how,
        "squares": halves.squares,
        "degrees_of_freedom": list(halves.freedom),
        "divisions": halves.divisions,
        "rows": halves.rows,
        "position_mm": {"measured": 1e3 * halves.measured, "expected": 1e3 * halves.expected},
    }


def _folds(folds: Folds, train: Dataset) -> dict[str, Any]:
    """Errors of the folds, by channel, in the unit that is shown."""
    by_channel = zip(train.channels, folds.mean, folds.spread, folds.fitted, folds.error.T, strict=True)
    return {
        c.key: {
            "rms": c.scale * float(mean),
            "spread": c.scale * float(spread),
            "fitted": c.scale * float(fitted),
            "each": [c.scale * float(value) for value in each],
        }
        for c, mean, spread, fitted, each in by_channel
    }


def _influence(influence: Influence, train: Dataset) -> dict[str, Any]:
    """The rows that move the target most, [mm]."""
    rows = [
        {
            "file": train.origin.files[train.origin.file[k]].name,
            "row": int(train.origin.line[k]),
            "shift_mm": 1e3 * float(influence.shift[i]),
            "leverage": float(influence.leverage[i]),
            "cook": float(influence.cook[i]),
        }
        for i, k in enumerate(influence.rows[:MOST_INFLUENCES].tolist())
    ]
    return {"target_std_mm": 1e3 * influence.sigma, "deciding": len(influence.deciding), "rows": rows}


def _known(identifiability: Identifiability) -> dict[str, Any]:
    """Combinations of constants, and the minimal set of them."""
    return {
        "combinations": [
            {"parts": dict(c.parts), "unit": c.unit or "m and rad", "std": c.std} for c in identifiability.combinations
        ],
        "pairs": [
            {
                "constants": [p.first, p.second],
                "unit": p.unit,
                "std_of_sum": p.of_sum,
                "std_of_difference": p.of_difference,
            }
            for p in identifiability.pairs
        ],
        "minimal_set": list(identifiability.names),
        "could_stay_nominal": list(identifiability.spare),
        "target_mm": {"moves": 1e3 * identifiability.shift, "std": 1e3 * identifiability.sigma},
    }
