"""What ``result.json`` holds, as DataFrames whose columns name their units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from aridcal.jobs.calibrate.outcome import STATISTICS, Verification, errors

Document = Mapping[str, Any]

EFFECT_COLUMNS = ("kind", "where", "motion", "covariates", "declared", "p_value")
"""Behind them stand those of each channel's error, before and after."""

PARAMETER_COLUMNS = ("value_mm", "std_mm", "value_mrad", "std_mrad", "status", "redundant_with")

ISO_COLUMNS = ("file", "row", "cycles", "split", "hours")
"""Behind them stand the figures of each model."""


def error_table(result: Document) -> pd.DataFrame:
    """Errors of what was measured: of the target [mm] and [mrad], of a camera [px].

    Args:
        result: ``result.json``.

    Returns:
        Statistics of each model (``nominal``, ``geometric``, ``final``) on each part of the rows (``train``, ``test``,
        ``test_all``); indexed by both.
    """
    scores = {(model, part): e for model, parts in result["error"].items() for part, e in parts.items()}
    index = pd.MultiIndex.from_tuples(scores, names=["model", "rows"])
    return _statistics(scores.values(), index)


def verification_table(verification: Verification) -> pd.DataFrame:
    """Errors on another day's rows, [mm] and [mrad], gross outliers left out: of each model, and ``realigned``."""
    residuals = dict(verification.residuals)
    if verification.realigned is not None:
        residuals["realigned"] = verification.realigned
    scored = [
        errors(residual, ~verification.outlier, verification.measurements.channels) for residual in residuals.values()
    ]
    return _statistics(scored, pd.Index(residuals, name="model"))


def effect_table(result: Document) -> pd.DataFrame:
    """Effects of a ``result.json``, one a row, the largest gain first; before and after are on held-out rows."""
    rows = []
    channels = [key.rpartition("_") for key in next(iter(result["error"]["final"].values()))]
    for effect in result["effects"]:
        row = dict(effect)
        row["motion"] = ", ".join(effect["motion"])
        row["covariates"] = ", ".join(effect["covariates"])
        for quantity, _, unit in channels:
            for when, value in effect.get(f"{quantity}_rms_{unit}", {}).items():
                row[f"{quantity}_rms_{when}_{unit}"] = value
        rows.append(row)
    gains = [f"{quantity}_rms_{when}_{unit}" for quantity, _, unit in channels for when in ("before", "after")]
    return pd.DataFrame(rows, columns=[*EFFECT_COLUMNS, *gains])


def influence_table(result: Document) -> pd.DataFrame:
    """Rows of a ``result.json`` without which the predicted target moves most; ``deciding``: by more than 1 sigma."""
    influence = result.get("influence", {"deciding": 0, "rows": []})
    table = pd.DataFrame(influence["rows"], columns=["file", "row", "shift_mm", "leverage", "cook"])
    table["deciding"] = [k < influence["deciding"] for k in range(len(table))]
    return table.set_index(["file", "row"])


def combination_table(result: Document) -> pd.DataFrame:
    """Combinations of constants of a ``result.json``, the best known first: share of each named constant, and ``std``.

    A metre counts as a radian; shares too small to be named are 0.
    """
    constants = result.get("known", {"combinations": [], "minimal_set": []})
    table = pd.DataFrame([c["parts"] for c in constants["combinations"]], columns=constants["minimal_set"], dtype=float)
    return table.fillna(0.0).assign(std=[c["std"] for c in constants["combinations"]])


def parameter_table(result: Document) -> pd.DataFrame:
    """Constants of a ``result.json`` by name, lengths in [mm] and angles in [mrad]; empty where they are the other."""
    rows = {}
    for parameter in result["parameters"]:
        unit = {"m": "mm", "rad": "mrad"}[parameter["unit"]]
        row = {"status": parameter["status"], "redundant_with": ", ".join(parameter["redundant_with"])}
        for key in ("value", "std"):
            if parameter[key] is not None:
                row[f"{key}_{unit}"] = 1e3 * parameter[key]
        rows[parameter["name"]] = row
    table = pd.DataFrame.from_dict(rows, orient="index", columns=list(PARAMETER_COLUMNS))
    numbers = dict.fromkeys(PARAMETER_COLUMNS[:4], float)
    return table.astype(numbers).rename_axis("name")


def iso_table(result: Document) -> pd.DataFrame:
    """Poses of a ``result.json`` that were measured more than once, by the figures of ISO 9283 [mm] and [mrad]; empty without."""
    poses = result.get("iso_9283", {"poses": []})["poses"]
    models = ("nominal", "final")
    rows = [
        {key: value for key, value in pose.items() if key not in models}
        | {f"{model}_{symbol}": value for model in models for symbol, value in pose[model].items()}
        for pose in poses
    ]
    table = pd.DataFrame(rows, columns=list(rows[0]) if rows else list(ISO_COLUMNS))
    return table.astype({name: float for name in table if str(name).startswith(models) or name == "hours"})


def region_table(index: Document) -> pd.DataFrame:
    """Regions of an ``index.yaml`` by name: their URDF, where each holds, and what it leaves in SI units.

    Args:
        index: ``regions/index.yaml``; empty where nothing varies by region.
    """
    rows = {}
    for name, region in index.get("regions", {}).items():
        row = {"urdf": region["urdf"]} | ({"label": region["label"]} if "label" in region else {})
        for part in (*(() if "label" in region else ("middle", "low", "high")), "rows", "error"):
            row |= {f"{part}_{of}": value for of, value in region[part].items()}
        rows[name] = row
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("region")


def _statistics(scores: Iterable[Mapping[str, Mapping[str, float]]], index: pd.Index) -> pd.DataFrame:
    """Error statistics as a table: ``{"position_mm": {"rms": 0.1}}`` gives the column ``position_rms_mm``."""
    rows = []
    for quantities in scores:
        row = {}
        for name, values in quantities.items():
            quantity, _, unit = name.rpartition("_")
            for statistic in STATISTICS:
                row[f"{quantity}_{statistic}_{unit}"] = values[statistic]
        rows.append(row)
    return pd.DataFrame(rows, index=index).astype(float)
