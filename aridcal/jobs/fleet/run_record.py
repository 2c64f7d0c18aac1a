"""One run of one robot as a row: what ``fleet.parquet`` and ``fleet.json`` hold of it (docs/formats.md, section 8)."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pinocchio as pin
import pyarrow as pa

from aridcal import __version__
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Effect
from aridcal.engine.robot.chain import Robot
from aridcal.files.campaign import Campaign
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.outcome import STATISTICS, Outcome
from aridcal.jobs.fleet.keys import Inputs
from aridcal.system.errors import AridcalError
from aridcal.system.reading.regular_files import RESULT, read_file

DONE, FAILED = "done", "failed"

RUN_FILE = "fleet.json"
"""A robot's row in its result folder."""

Row = dict[str, Any]
"""A run by the columns of its table, :data:`RUN_SCHEMA` or that of a study; times as text, ISO 8601 in UTC."""

_STAGE = pa.struct(
    [("stage", pa.string()), ("channel", pa.string()), ("rows", pa.int64())]
    + [(name, pa.float64()) for name in STATISTICS]
)

_EFFECT = pa.struct(
    [(name, pa.string()) for name in ("effect", "kind", "where", "name", "component")]
    + [("value", pa.float64()), ("std", pa.float64()), ("unit", pa.string()), ("p_value", pa.float64())]
    + [("declared", pa.bool_()), ("channel", pa.string()), ("before", pa.float64()), ("after", pa.float64())]
)

_CONSTANT = pa.struct(
    [("name", pa.string()), ("value", pa.float64()), ("std", pa.float64()), ("unit", pa.string())]
    + [("status", pa.string()), ("nominal", pa.float64())]
)

_TIME = pa.timestamp("ms", tz="UTC")

RUN_SCHEMA = pa.schema(
    [(name, pa.string()) for name in ("robot", "campaign", "key", "inputs", "urdf")]
    + [("time", _TIME), ("measured", _TIME)]
    + [(name, pa.string()) for name in ("version", "status", "error")]
    + [("rows", pa.int64()), ("verdict", pa.string()), ("seconds", pa.float64())]
    + [("stages", pa.list_(_STAGE)), ("effects", pa.list_(_EFFECT)), ("constants", pa.list_(_CONSTANT))]
    + [("notices", pa.list_(pa.string()))]
)


def now() -> datetime.datetime:
    """The time, to the millisecond."""
    time = datetime.datetime.now(datetime.UTC)
    return time.replace(microsecond=time.microsecond // 1000 * 1000)


def measurement_time(campaign: Campaign | None, run: datetime.datetime) -> datetime.datetime:
    """When the rows were measured, as far as the campaign says so in digits; else when they were computed."""
    stated = campaign.about.date if campaign is not None and campaign.about is not None else None
    try:
        time = datetime.datetime.fromisoformat(stated or "")
    except ValueError:
        return run
    return time.astimezone(datetime.UTC) if time.tzinfo is not None else time.replace(tzinfo=datetime.UTC)


def failed_row(robot: str, path: Path, inputs: Inputs, error: str, seconds: float, campaign: Campaign | None) -> Row:
    """The row of a run that came to nothing.

    Args:
        robot: Its name.
        path: Of its campaign.
        inputs: What it would have read.
        error: Why.
        seconds: How long it took to come to that.
        campaign: None if it could not be read.
    """
    return _row(robot, path, inputs, campaign) | {"status": FAILED, "error": error, "seconds": round(seconds, 3)}


def done_row(robot: str, outcome: Outcome, inputs: Inputs) -> Row:
    """The row of a run that was completed.

    Args:
        robot: Its name.
        outcome: What was found.
        inputs: What was read.
    """
    campaign, found = outcome.campaign, result_document(outcome)
    return _row(robot, campaign.path, inputs, campaign) | {
        "rows": found["n"]["used"],
        "verdict": found["verdict"],
        "seconds": found["seconds"],
        "stages": _stages(found),
        "effects": _effects(found, [named.effect for named in outcome.effects], outcome.channels[0].name),
        "constants": [_constant(parameter, outcome.robot) for parameter in found["parameters"]],
        "notices": found["notices"],
    }


def _row(robot: str, path: Path, inputs: Inputs, campaign: Campaign | None) -> Row:
    """What every row says; its status is ``done`` until something else is written over it."""
    time = now()
    return {
        "robot": robot,
        "campaign": str(path.absolute()),
        "key": inputs.key,
        "inputs": inputs.inputs,
        "urdf": inputs.urdf,
        "time": time.isoformat(),
        "measured": measurement_time(campaign, time).isoformat(),
        "version": __version__,
        "status": DONE,
        "error": None,
        "rows": None,
        "verdict": None,
        "seconds": None,
        "stages": [],
        "effects": [],
        "constants": [],
        "notices": [],
    }


def _stages(result: Mapping[str, Any]) -> list[Row]:
    """Errors of every stage on held-out rows, one entry for each channel."""
    rows = result["n"]["test"]
    return [
        {"stage": stage, "channel": channel, "rows": rows} | {name: figures[name] for name in STATISTICS}
        for stage, parts in result["error"].items()
        for channel, figures in parts["test"].items()
    ]


def _effects(result: Mapping[str, Any], effects: list[Effect], channel: str) -> list[Row]:
    """One entry for each coefficient of each effect; the document has them in the same order."""
    rows = []
    for effect, said in zip(effects, result["effects"], strict=True):
        gain = next(value for key, value in said.items() if key.startswith(f"{channel}_rms_"))
        unit = next(key for key in said if key.startswith(f"{channel}_rms_")).replace("_rms_", "_")
        component = {c.name: c.component for c in effect.coefficients}
        for number in said["coefficients"]:
            rows.append(
                {"effect": effect.label, "kind": effect.kind, "where": effect.where}
                | {key: number[key] for key in ("name", "value", "std", "unit")}
                | {"component": component[number["name"]], "p_value": said["p_value"], "declared": said["declared"]}
                | {"channel": unit, **gain}
            )
    return rows


def _constant(parameter: Mapping[str, Any], robot: Robot) -> Row:
    """A constant, and the URDF's own number where there is one."""
    where, component = parameter["name"].rsplit(".", 1)
    kept = {key: parameter[key] for key in ("name", "value", "std", "unit", "status")}
    return kept | {"nominal": _nominal(where, component, robot)}


def _nominal(where: str, component: str, robot: Robot) -> float | None:
    """Component of a joint's own ``<origin>``, [m] or [rad]; None for what no origin has, as Doty's link parameters."""
    origins = {joint.name: joint.origin for joint in robot.joints}
    if robot.tip_joint is not None:
        origins.setdefault(robot.tip_joint, robot.tip_origin)
    if where not in origins or component not in FRAME_COMPONENTS:
        return None
    origin = origins[where]
    return float([*origin.translation, *pin.rpy.matrixToRpy(origin.rotation)][FRAME_COMPONENTS.index(component)])


def as_text(row: Row) -> str:
    """A row as a file."""
    return json.dumps(row, indent=1, allow_nan=False) + "\n"


def row_of_folder(folder: Path) -> Row | None:
    """The row of a result folder; None where there is none that can be read, or no result beside it."""
    if not all((folder / name).is_file() for name in ("result.json", "calibration.yaml", RUN_FILE)):
        return None
    try:
        row = json.loads(read_file(folder / RUN_FILE, AridcalError, RESULT))
        pa.Table.from_pylist([typed(row)], RUN_SCHEMA)
    except (AridcalError, OSError, ValueError, TypeError, KeyError, AttributeError, pa.ArrowException):
        return None
    return row if set(row) == set(RUN_SCHEMA.names) else None


def typed(row: Row) -> Row:
    """A row with its times as such."""
    return row | {name: datetime.datetime.fromisoformat(row[name]) for name in ("time", "measured")}


def plain(row: Row) -> Row:
    """A row with its times as text."""
    return row | {name: row[name].isoformat() for name in ("time", "measured")}
