"""The folder of a repaired calibration: what moved is identified with new rows and fitted, all else is kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from aridcal.files.tables import AnyTable
from aridcal.jobs.calibrate.controllers import controller_exports, write_controllers
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.urdf_files import write_calibrated, write_urdf
from aridcal.jobs.maintain.answers import check_lines, repair_error_line
from aridcal.jobs.maintain.checking import CheckResult, check
from aridcal.jobs.maintain.documents import document, figures_before, lineage, residuals
from aridcal.jobs.maintain.new_rows import read_new_rows
from aridcal.jobs.maintain.repair import Repair, repair_calibration
from aridcal.jobs.maintain.repaired_outcomes import RepairOutcomes, repair_outcomes
from aridcal.pages.drawing.scene import write_scene
from aridcal.pages.repair_page import write_repair_report
from aridcal.runs.result_folder import RESULT_FILES, RESULT_FOLDERS
from aridcal.system.errors import CampaignError, OutputError
from aridcal.system.progress import SILENT, Progress
from aridcal.system.reading.regular_files import CALIBRATION, read_file
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import atomic_folder, claimed

SCORED_ON = "where it was calibrated, against the repaired model"
"""Where exports are scored, in words: ten rows could not say it."""


def recalibrate(results: Path, table: AnyTable, out: Path, progress: Progress = SILENT) -> tuple[str, ...]:
    """Repair a calibration with new rows, and write the folder of what it is now.

    Args:
        results: The folder of the calibration, or its ``calibration.yaml``.
        table: See :func:`aridcal.jobs.maintain.new_rows.read_new_rows`.
        out: The folder to write.
        progress: Told what is being done.

    Returns:
        Lines on what moved.

    Raises:
        AridcalError: nothing can or must be repaired, or something of the input needs mending.
    """
    before = results / "calibration.yaml" if results.is_dir() else results
    if out.resolve() == before.resolve().parent:
        raise OutputError(f"{out}: holds the calibration that is to be repaired, which is kept; name another")
    check_apart((out / name for name in RESULT_FILES), [before, table if isinstance(table, Path) else None])
    with claimed(out, "folder", RESULT_FILES, RESULT_FOLDERS):
        saved = SavedModel.load(results)
        content = read_file(before, CampaignError, CALIBRATION)
        progress("asking what moved")
        new_rows = read_new_rows(saved, table)
        checked = check(saved, new_rows.rows, frames=new_rows.frames)
        repair = repair_calibration(saved, checked)
        lines = check_lines(checked, repair.changes, saved.measurements)
        progress("setting the repair beside the rows")
        outcomes = repair_outcomes(saved, checked, repair)
        parents = lineage(saved, before, content, checked)
        notices = _write(out, outcomes, checked, repair, parents, lines, figures_before(before), progress)
    return (*lines, repair_error_line(outcomes), *(f"note: {notice}" for notice in notices))


def _write(
    out: Path,
    outcomes: RepairOutcomes,
    checked: CheckResult,
    repair: Repair,
    parents: dict[str, Any],
    lines: list[str],
    figures: dict[str, Any],
    progress: Progress,
) -> tuple[str, ...]:
    """Write the folder's files; returns what could not be drawn."""
    saved = replace(repair.saved, record=repair.saved.record | {"lineage": parents})
    with atomic_folder(out, RESULT_FILES | RESULT_FOLDERS) as stage:
        (stage / "calibration.yaml").write_text(saved.dump(), encoding="utf-8")
        read = write_calibrated(stage, saved.geometric.model, saved.geometric.theta)
        if any(not c.basis.always for c in saved.final.model.coefficients):
            write_urdf(stage / "model.urdf", saved.final.model, saved.final.theta)
        figures_now = document(outcomes, checked, repair, parents, figures)
        (stage / "result.json").write_text(json.dumps(figures_now, indent=2, allow_nan=False) + "\n")
        residuals(outcomes).to_csv(stage / "residuals.csv", index=False, float_format="%.9g")
        progress("working out what controllers can be given")
        handover = replace(
            controller_exports(outcomes.model), rows=f"{len(outcomes.model.measurements)} configurations {SCORED_ON}"
        )
        write_controllers(outcomes.model, handover, stage)
        progress("drawing the report and the scene")
        notices = write_repair_report(outcomes, checked, repair, parents, lines, handover, stage / "report.html")
        return (*read, *notices, *write_scene(outcomes.rows, stage / "scene.html"))
