"""The result folder: figures, URDFs, the whole model, and every row's residual (FORMATS section 3)."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from aridcal import __version__
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.corrections.effect import ANGULAR, FRAME_COMPONENTS, ROW_ORDER, Coefficient, Effect
from aridcal.engine.fit.constants import is_zero
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.instruments.channels import columns
from aridcal.engine.instruments.kinds import labelled
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.search.noise_causes import NoiseCause, NoiseCauses
from aridcal.engine.trust.certainty import as_document
from aridcal.engine.trust.gains import NamedEffect
from aridcal.engine.trust.iso9283 import document as iso_document
from aridcal.engine.trust.second_look_document import document
from aridcal.jobs.calibrate.measuring_head import MeasuringHead
from aridcal.jobs.calibrate.outcome import Outcome, Stage, Verification, errors
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.calibrate.urdf_files import write_calibrated, write_urdf
from aridcal.system.progress import SILENT, Progress
from aridcal.system.reading.memory_release import give_back_of
from aridcal.system.writing.table_writer import csv_lines

if TYPE_CHECKING:
    import pandas as pd

WRITTEN_AT_ONCE = 20_000
"""Rows that are written between two reports of progress: half a second."""

RESIDUAL_DIGITS = 9
"""Digits of numbers in residuals.csv: a nanometre of a metre."""

FRAME_NAMES = ("world_base", "tip_target")


def write_results(outcome: Outcome, folder: Path, progress: Progress = SILENT) -> tuple[str, ...]:
    """Write every file of the result folder that needs no drawing.

    Returns:
        Notices on parts of the user's own URDF that readers of URDFs cannot read.
    """
    (folder / "result.json").write_text(json.dumps(result_document(outcome), indent=2, allow_nan=False) + "\n")
    give_back_of(
        len(outcome.measurements)
    )  # memory of the figures: the scatter over all rows below needs as much again
    geometric, final = outcome.stage("geometric").fit, outcome.stage("final").fit
    notices = list(write_calibrated(folder, geometric.model, geometric.theta))
    if outcome.effects:
        notices += write_urdf(folder / "model.urdf", final.model, final.theta)
    (folder / "calibration.yaml").write_text(calibration(outcome).dump(), encoding="utf-8")
    order = outcome.measurements.as_read
    with (folder / "residuals.csv").open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(residual_columns_of(outcome, order[:0])) + "\n")
        for first in progress.through(
            range(0, len(order), WRITTEN_AT_ONCE), len(order), "rows of residuals.csv", WRITTEN_AT_ONCE
        ):
            file.write(csv_lines(residual_columns_of(outcome, order[first : first + WRITTEN_AT_ONCE]), RESIDUAL_DIGITS))
    if outcome.head is not None:
        import pandas as pd  # slow to load, and other campaigns have no images

        pd.DataFrame(outcome.head.fiducials).to_csv(folder / "fiducials.csv", index=False)
    return tuple(dict.fromkeys(notices))


def result_document(outcome: Outcome) -> dict[str, Any]:
    """`result.json` as plain data."""
    m = outcome.measurements
    parts = outcome.parts()
    return finite({
        "format": 1,
        "n": {
            "rows": len(m) + len(m.origin.refused),
            "used": len(m),
            "train": int(parts["train"].sum()),
            "test": int(parts["test"].sum()),
            "outliers": int(outcome.outlier.sum()),
            "refused": [
                asdict(remark) for remark in m.origin.refused
            ],
            "outlier_rows": [
                {"file": m.origin.files[m.origin.file[k]].name, "row": int(m.origin.line[k]), "why": why}
                for k in m.as_read[outcome.outlier[m.as_read]]
                for why in ["stale measurement" if m.repeats.doubtful[k] else "gross outlier"]
            ],
        },
        "error": {
            name: {part: errors(outcome.stage(name).residual, mask, outcome.channels) for part, mask in parts.items()}
            for name in ("nominal", "geometric", "final")
        },
        "noise": {
            **{c.key: c.scale * float(sigma) for c, sigma in zip(outcome.channels, outcome.noise, strict=True)},
            "source": outcome.noise_source,
            **({} if outcome.causes is None else noise_document(outcome.causes)),
        },
        "frames": frames(outcome.stage("final")),
        "parameters": parameters(outcome.stage("geometric").fit),
        "effects": [_effect(e, outcome) for e in outcome.effects],
        **({"instruments": instruments(outcome)} if outcome.things else {}),
        **({"head": _head(outcome.head, frames(outcome.stage("final")))} if outcome.head is not None else {}),
        **_over_time(outcome),
        **({} if outcome.iso is None else {"iso_9283": iso_document(outcome.iso, m)}),
        **({} if outcome.second_look is None else document(outcome.second_look, m.fitted)),
        **({} if outcome.certainty is None else {"workspace": as_document(outcome.certainty)}),
        "verdict": outcome.verdict.word,
        "unexplained_fraction": outcome.verdict.share,
        "reasons": list(outcome.verdict.reasons),
        "seconds": round(outcome.seconds, 3),
        "version": __version__,
        "convergence": {s.name: _convergence(s.fit) for s in outcome.stages},
        **({"verification": _verification(outcome.verification)} if outcome.verification is not None else {}),
        "notices": list(outcome.notices),
    })  # fmt: skip


CAUSES = {
    "channel": "channels",
    "joint": "joint_readings",
    "range": "per_range",
    "length": "per_length",
    "sight": "about_line_of_sight",
    "repeatability": "repeatability",
    "direction": "in_world_axes",
    "depth": "along_lines_of_sight",
    "bearing": "across_lines_of_sight",
    "own_axis": "in_target_axes",
    "lever": "on_a_lever",
}


def noise_document(causes: NoiseCauses) -> dict[str, Any]:
    """Causes of the scatter by kind and name: value, std and unit of each, and the causes that explain it as well."""
    document: dict[str, Any] = {}
    for c in causes.causes:
        rivals = [{"cause": CAUSES.get(r.kind, "joint_readings"), "name": r.name, **_noise_cause(r)} for r in c.rivals]
        document.setdefault(CAUSES[c.kind], {})[c.name] = _noise_cause(c) | ({"or": rivals} if rivals else {})
    return document


def _noise_cause(c: NoiseCause) -> dict[str, Any]:
    """One cause: its value, and its direction or lever."""
    entry: dict[str, Any] = {"value": c.value, "std": c.std, "unit": c.unit}
    shape = c.shape
    if shape is None:
        return entry
    if shape.vector is not None:
        entry["lever" if shape.kind == "lever" else "axis"] = shape.vector.tolist()
    if shape.kind == "own_axis":
        entry["across"] = shape.across
    if shape.point is not None:
        entry |= {"from": shape.point.tolist(), "distance": shape.typical, "power": shape.power}
    return entry


def _over_time(outcome: Outcome) -> dict[str, Any]:
    """The error with whole stretches of time held back, where an effect depends on time."""
    error = None if outcome.diagnosis is None else outcome.diagnosis.over_time
    first = outcome.channels[0]
    return {} if error is None else {"over_time": {first.key: {"rms": first.scale * error}}}


def instruments(outcome: Outcome) -> dict[str, Any]:
    """Every number of every thing that the rows refer to, by the plural of its role, its label and its component."""
    document: dict[str, Any] = {}
    for v in outcome.things:
        numbers = document.setdefault(f"{v.role}s", {}).setdefault(v.name, {})
        numbers[v.component] = {"value": v.value, "std": v.std, "unit": v.unit, "status": v.status}
        if v.redundant_with:
            numbers[v.component]["redundant_with"] = list(v.redundant_with)
    return document


def _verification(verification: Verification) -> dict[str, Any]:
    """Another day's rows: the errors of each stage, and of the last with the frames fitted anew."""
    residuals = dict(verification.residuals)
    if verification.realigned is not None:
        residuals["realigned"] = verification.realigned
    return {
        "file": verification.file,
        "rows": len(verification.measurements),
        **({"own_rows_left_out": verification.copied} if verification.copied else {}),
        "outliers": int(verification.outlier.sum()),
        "error": {
            name: errors(residual, ~verification.outlier, verification.measurements.channels)
            for name, residual in residuals.items()
        },
    }


def frames(stage: Stage) -> dict[str, Any]:
    """Identified frames: xyz [m], rpy [rad], and std as a twist in the frame's own axes."""
    fit = stage.fit
    std = dict(zip(fit.model.names, fit.std, strict=True))
    document: dict[str, Any] = {}
    for where, placements in zip(FRAME_NAMES, (fit.model.world_base, fit.model.tip_target), strict=True):
        for label, placement in placements:
            name = where if label is None else f"{where}[{label}]"
            document[name] = {
                "xyz": placement.translation.tolist(),
                "rpy": pin.rpy.matrixToRpy(placement.rotation).tolist(),
                "std": [float(std.get(f"{name}.{c}", 0.0)) for c in FRAME_COMPONENTS],
            }
    return document


def parameters(fit: Fit) -> list[dict[str, Any]]:
    """Every candidate constant of the arm and its frames: its value, or the constants that it is confounded with.

    A frame's constants are its own xyz and rpy; all others are corrections of the nominal value.
    """
    value = dict(zip(fit.model.names, fit.theta, strict=True))
    std = dict(zip(fit.model.names, fit.std, strict=True))
    frame_values: dict[str, float] = {}
    for where, placements in zip(FRAME_NAMES, (fit.model.world_base, fit.model.tip_target), strict=True):
        for label, placement in placements:
            numbers = [*placement.translation, *pin.rpy.matrixToRpy(placement.rotation)]
            name = where if label is None else f"{where}[{label}]"
            frame_values |= {f"{name}.{c}": float(v) for c, v in zip(FRAME_COMPONENTS, numbers, strict=True)}
    things = fit.model.instruments.names
    robot = fit.model.robot
    constants = [c for c in fit.candidates if (c.basis.constant or is_zero(c, robot)) and c.where not in things]
    candidates = {c.name: c.component for c in constants}
    turns = {c.name for c in constants if is_zero(c, robot) and robot.joint(c.where).kind != "prismatic"}
    fixed = {name: name.rsplit(".", 1)[1] for name in frame_values if name not in candidates}
    entries = []
    for name, component in (candidates | fixed).items():
        status = "identified" if name in value else "redundant" if name in candidates else "fixed"
        entries.append({
            "name": name,
            "unit": "rad" if name in turns or component in ANGULAR else "m",
            "value": frame_values.get(name, float(value.get(name, 0.0))),
            "std": float(std[name]) if name in value else None,
            "status": status,
            "redundant_with": list(fit.redundant.get(name, ())),
        })  # fmt: skip
    return entries


def _head(head: MeasuringHead, placements: Mapping[str, Any]) -> dict[str, Any]:
    """The measuring head: mounting, numbers, and how far image points and ranges of single shots fit together."""
    return {
        "tip_camera": placements["tip_target"],
        "numbers": [asdict(n) | {"redundant_with": []} for n in head.numbers],
        "misfit_within_shots": {"declared": head.misfit[0], "identified": head.misfit[1]},
        "range_rms_mm": {
            name: {f"sonar_{k + 1}": 1e3 * float(v) for k, v in enumerate(row)}
            for name, row in zip(("declared", "identified"), head.ranges, strict=True)
        },
    }  # fmt: skip


def _effect(named: NamedEffect, outcome: Outcome) -> dict[str, Any]:
    fit, effect = outcome.stage("final").fit, named.effect
    index = {name: k for k, name in enumerate(fit.model.names)}
    joints = {j.name: j.kind for j in outcome.robot.joints}
    document: dict[str, Any] = {"kind": effect.kind, "where": effect.where, "motion": list(effect.motion)}
    if effect.order:
        document["order"] = list(effect.order)
    if effect.with_:
        document["with"] = effect.with_
    if effect.by:
        document["by"] = effect.by
    if effect.at is not None:
        document["at"] = moment(effect.at, outcome.measurements)
    turning = {c: c in ANGULAR or (c == "axis" and joints.get(effect.where) == "revolute") for c in effect.motion}
    identified = {}
    for c in effect.coefficients:
        if c.name in index:
            k = index[c.name]
            identified[c.name] = _unit(fit, c, turning[c.component]), float(fit.theta[k]), float(fit.std[k])
    document |= {
        "covariates": [name for name in EFFECT_KINDS[effect.kind].shown or effect.covariates if name != ROW_ORDER],
        "coefficients": [
            dict(zip(("name", "unit", "value", "std"), (c.name, *identified[c.name]), strict=True))
            for c in effect.coefficients
        ],
        "p_value": named.p_value,
    }
    for channel, part in zip(outcome.channels, columns(outcome.channels), strict=True):
        document[f"{channel.name}_rms_{channel.shown}"] = _before_after(named, part, channel.scale)
    document["confounded_with"] = [_short(e) for e in named.confounded_with]
    document["declared"] = named.declared
    return document


def _unit(fit: Fit, c: Coefficient, turns: bool) -> str:
    """Unit of what a coefficient moves: of the arm a length or an angle, of a camera perhaps pixels."""
    things = fit.model.instruments
    return things.unit(c.where, c.component) if c.where in things.names else "rad" if turns else "m"


def moment(step: Basis, rows: Dataset) -> dict[str, Any]:
    """The first row after a step: its line, its file if there are several, its time if there is one."""
    first = rows_around(step, rows)[1]
    document: dict[str, Any] = (
        {"file": rows.origin.files[rows.origin.file[first]].name} if len(rows.origin.files) > 1 else {}
    )
    document["row"] = int(rows.origin.line[first])
    time = rows.covariates.get("time", np.full(len(rows), np.nan))[first]
    return document | ({"time": float(time)} if np.isfinite(time) else {})


def step_in_words(effect: Effect, rows: Dataset) -> str:
    """A step in words, ``world_base moved between rows 117 and 118``; empty for what always acts."""
    if effect.at is None:
        return ""
    last, first = rows_around(effect.at, rows)
    who = f"the zero of {effect.where}" if effect.motion == ("axis",) else effect.where
    if rows.origin.file[last] == rows.origin.file[first]:
        between = f"rows {rows.origin.line[last]} and {rows.origin.line[first]}"
    else:
        ends = (f"row {rows.origin.line[k]} of {rows.origin.files[rows.origin.file[k]].name}" for k in (last, first))
        between = " and ".join(ends)
    when = f" (from time {effect.at.numbers[0]:.6g} on)" if effect.at.of[0] == "time" else ""
    return f"{who} moved between {between}{when}"


def rows_around(step: Basis, rows: Dataset) -> tuple[int, int]:
    """The last row before a step and the first after it."""
    values = rows.conditions[step.of[0]]
    last = np.where(values < step.numbers[0], values, -np.inf)
    first = np.where(values >= step.numbers[0], values, np.inf)
    return int(np.argmax(last)), int(np.argmin(first))


def _before_after(named: NamedEffect, part: slice, scale: float) -> dict[str, float]:
    """RMS of a channel on the held-out rows that measure it, without an effect and with it."""
    rms = {}
    for name, r in (("before", named.before), ("after", named.after)):
        squares = np.sum(r[:, part] ** 2, axis=1)
        squares = squares[~np.isnan(squares)]
        rms[name] = scale * float(np.sqrt(np.mean(squares))) if len(squares) else math.nan
    return rms


def _short(effect: Effect) -> dict[str, Any]:
    keys = {"kind": effect.kind, "where": effect.where, "with": effect.with_, "by": effect.by}
    return {key: value for key, value in keys.items() if value}


def residual_table(outcome: Outcome) -> pd.DataFrame:
    """The columns of ``residuals.csv``, one line per usable row."""
    import pandas as pd  # slow to load: only where somebody wants a DataFrame

    rows = outcome.measurements.as_read
    return pd.DataFrame(residual_columns_of(outcome, rows), index=rows)


def residual_columns_of(outcome: Outcome, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of ``residuals.csv``: place, part and flags of each row, and the residual of each stage, in SI and [px].

    Where rows are of several kinds also the block, the things that the row refers to and its target, as the campaign names them.

    Args:
        outcome: An outcome.
        rows: Numbers of the rows to write, in the order of the lines.
    """
    m = outcome.measurements
    axes = residual_columns(m)
    table: dict[str, Any] = {
        "file": np.array([path.name for path in m.origin.files], dtype=object)[m.origin.file[rows]],
        "row": m.origin.line[rows],
        "split": np.where(m.test[rows], "test", "train"),
        "weight": np.where(outcome.outlier[rows], 0.0, 1.0),
        "outlier": outcome.outlier[rows].astype(int),
        "stale": m.repeats.stale[rows].astype(int),
        **_labels(m, rows),
    }
    for stage in outcome.stages:
        label = stage.name.replace(" ", "_")
        table |= {f"{label}_{axis}": column for axis, column in zip(axes, stage.residual[rows].T, strict=True)}
    return {name: np.asarray(column) for name, column in table.items()}


def residual_columns(m: Dataset) -> list[str]:
    """Names of a residual's numbers: the axes of its channels, after the name of the block where there are several."""
    if len(m.blocks) < 2:
        return [axis for channel in m.channels for axis in channel.axes]
    return [f"{block.name}_{axis}" for block in m.blocks for channel in block.channels for axis in channel.axes]


def _labels(m: Dataset, rows: np.ndarray) -> dict[str, Any]:
    """Block, things and target of rows of several kinds, as columns."""
    if m.direct:
        return {}
    names = np.array([block.name for block in m.blocks])
    block_of_row, refers = m.labels.block[rows], m.labels.refers[rows]
    table: dict[str, Any] = {"block": names[block_of_row]}
    for b, block in enumerate(m.blocks):
        for k, role in enumerate(labelled(block.kind)):
            column = table.setdefault(role.name, np.full(len(rows), "", dtype=object))
            column[block_of_row == b] = refers[block_of_row == b, k]
    return table if m.labels.target is None else table | {"target": m.labels.target[rows]}


def _convergence(fit: Fit) -> dict[str, Any]:
    """How well a stage's minimum was found."""
    c = fit.convergence
    tried = {"rank": len(fit.theta), "restarts": c.restarts, "restarts_agreed": c.agreed}
    return {"converged": c.converged, "steps": c.steps, "gradient": c.gradient, "condition": c.condition} | tried


def finite(value: Any) -> Any:
    """A value for JSON, which has no NaN: numbers that could not be computed become null."""
    if isinstance(value, dict):
        return {key: finite(v) for key, v in value.items()}
    if isinstance(value, list):
        return [finite(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
