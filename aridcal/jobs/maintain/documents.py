"""``result.json`` of a repair, and where a repaired calibration comes from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aridcal import __version__
from aridcal.files.yaml_file import decode
from aridcal.jobs.calibrate.folder import finite, frames, parameters, residual_columns, residual_table, result_document
from aridcal.jobs.calibrate.outcome import errors
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.maintain.checking import CheckResult
from aridcal.jobs.maintain.repair import Repair
from aridcal.jobs.maintain.repaired_outcomes import RepairOutcomes
from aridcal.system.errors import AridcalError
from aridcal.system.reading.regular_files import RESULT, read_file

UNNAMED_KIND = "unknown"
"""Kind of an effect of which the calibration before keeps coefficients alone."""


def lineage(saved: SavedModel, calibration: Path, content: bytes, checked: CheckResult) -> dict[str, Any]:
    """Where a repaired calibration comes from: the one before, and the rows that changed it.

    Args:
        saved: The calibration before.
        calibration: Its file.
        content: That file's bytes.
        checked: What the rows said.
    """
    rows = checked.rows
    counting = ~checked.question.dropped
    return {
        "from": str(calibration),
        "sha256": hashlib.sha256(content).hexdigest(),
        "rows": {
            "files": [file.name for file in rows.origin.files],
            "sha256": rows.origin.sha256,
            "used": sorted(int(line) for line in rows.origin.line[counting]),
            "left_out": sorted(int(line) for line in rows.origin.line[~counting]),
        },
        "moved": [cause.where for cause in checked.moved],
        "fitted_anew": [where if label is None else f"{where}[{label}]" for where, label in checked.unknowns.anew],
        "aridcal": __version__,
        "before": saved.record.get("lineage"),
    }


def document(
    outcomes: RepairOutcomes, checked: CheckResult, mended: Repair, parents: dict[str, Any], before: dict[str, Any]
) -> dict[str, Any]:
    """All figures of a repair: those of every calibration, on the new rows, and what moved.

    Args:
        outcomes: The repaired calibration as outcomes.
        checked: What the rows said.
        mended: The repair.
        parents: See :func:`lineage`.
        before: `result.json` of the calibration before, or nothing where it is not there.
    """
    rows = checked.rows
    held_out = outcomes.rows.measurements.test
    masks = {"new_rows": ~outcomes.rows.outlier & ~held_out, "test": held_out}
    figures = result_document(outcomes.rows)
    stages = {
        "before": outcomes.rows.stage("before").residual,
        "after": outcomes.rows.stage("final").residual,
        "left_out": outcomes.left_out,
    }
    not_identified = {p.get("name"): p for p in _listed(before, "parameters") if p.get("status") != "identified"}
    fitted = parameters(outcomes.model.stage("geometric").fit)
    constants = [p if p["status"] == "identified" else not_identified.get(p["name"], p) for p in fitted]
    repair = {
        "error": figures["error"]
        | {
            name: {part: errors(residual, mask, rows.channels) for part, mask in masks.items()}
            for name, residual in stages.items()
        },
        "frames": frames(outcomes.model.stage("final")),
        "parameters": constants,
        "effects": list(_effects(_listed(before, "effects"), mended.saved.final)),
        "moved": [
            {
                "kind": change.cause.kind,
                "where": change.cause.where,
                "probability": change.cause.probability,
                "not_refuted": list(change.cause.alike),
                "changes": [
                    {"name": name, "unit": unit, "value": float(value), "std": float(std)}
                    for name, unit, value, std in zip(change.names, change.units, change.value, change.std, strict=True)
                ],
            }
            for change in mended.changes
        ],
        "p_value": {"before": checked.first.p_value, "after": checked.rest.p_value},
        "lineage": parents,
    }
    return dict(finite(figures | repair))


def residuals(outcomes: RepairOutcomes) -> pd.DataFrame:
    """``residuals.csv``: of each new row what each model leaves, and the repaired one where the row is left out."""
    m = outcomes.rows.measurements
    axes = residual_columns(m)
    more = {f"left_out_{axis}": column for axis, column in zip(axes, outcomes.left_out[m.as_read].T, strict=True)}
    return residual_table(outcomes.rows).assign(**more)


def figures_before(calibration: Path) -> dict[str, Any]:
    """`result.json` beside a calibration; nothing where it cannot be read: then its effects have no names."""
    path = calibration.parent / "result.json"
    try:
        found = json.loads(decode(read_file(path, AridcalError, RESULT), path, AridcalError))
    except (AridcalError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _listed(document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Entries of a list in a file that may be damaged."""
    entries = document.get(key)
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _effects(before: Sequence[dict[str, Any]], final: SolvedModel) -> Iterator[dict[str, Any]]:
    """Effects as the calibration before names them, with their coefficients as they are now.

    Their gains are on the rows of that calibration.
    """
    indices = {c.name: k for k, c in enumerate(final.model.coefficients) if not c.basis.always}
    std = np.sqrt(np.maximum(np.diag(final.covariance), 0.0))
    for effect in before:
        names = [c.get("name") for c in _listed(effect, "coefficients")]
        if names and all(name in indices for name in names):
            of_effect = [(c, indices.pop(str(c["name"]))) for c in _listed(effect, "coefficients")]
            coefficients = [c | {"value": float(final.theta[k]), "std": float(std[k])} for c, k in of_effect]
            yield effect | {"coefficients": coefficients}
    for name, k in indices.items():
        c = final.model.coefficients[k]
        yield {
            "kind": UNNAMED_KIND,
            "where": c.where,
            "motion": [c.component],
            "covariates": list(c.basis.of),
            "coefficients": [{"name": name, "value": float(final.theta[k]), "std": float(std[k])}],
        }
