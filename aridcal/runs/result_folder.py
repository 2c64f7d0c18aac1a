"""A result folder with all its files: figures, URDFs, exports for controllers, the report and the scene."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from aridcal.system.progress import SILENT, Progress
from aridcal.system.writing.whole_files import atomic_folder

if TYPE_CHECKING:
    from aridcal.jobs.calibrate.controllers import ControllerExports
    from aridcal.jobs.calibrate.outcome import Outcome

RESULT_FILES = frozenset(
    {
        *(
            "result.json",
            "calibration.yaml",
            "calibrated.urdf",
            "calibrated.xml",
            "model.urdf",
            "residuals.csv",
            "fiducials.csv",
        ),
        *("kinematics.yaml", "dh.yaml", "dh_modified.yaml", "doty.yaml", "joint_offsets.yaml", "frames.yaml"),
        *("joint_maps.urdf", "joint_maps.csv", "report.html", "scene.html", "fleet.json"),
        *("certificate.html", "certificate.pdf"),
    }
)
"""All files that a result may have: a file of an earlier result that this one lacks must go."""

RESULT_FOLDERS = frozenset({"regions", "hand_eye"})
"""Folders that a result may have."""


@dataclass(frozen=True)
class FolderRemarks:
    """Remarks on a folder that was written.

    Attributes:
        handover: What each kind of controller can be given.
        notices: What could not be read back or drawn, and why.
    """

    handover: ControllerExports
    notices: tuple[str, ...]


def write_folder(
    outcome: Outcome, folder: Path, progress: Progress = SILENT, beside: Mapping[str, str] = MappingProxyType({})
) -> FolderRemarks:
    """Write every file of a result folder: all appear together or none does.

    Figures come first. A picture that cannot be drawn costs a notice and no other file.

    Args:
        outcome: Of the calibration.
        folder: Where to write it.
        progress: Told what is being written.
        beside: Further files, text by name.

    Raises:
        OutputError: the folder cannot be written.
    """
    # Commands ask for the names above before they read a table; what draws is loaded when there is something to draw.
    from aridcal.jobs.calibrate.controllers import controller_exports, write_controllers
    from aridcal.jobs.calibrate.folder import write_results
    from aridcal.pages.certificate import write_certificate
    from aridcal.pages.drawing.scene import write_scene
    from aridcal.pages.report.page import write_report
    from aridcal.system.reading.memory_release import give_back_of

    rows = len(outcome.measurements)
    give_back_of(rows)
    with atomic_folder(folder, RESULT_FILES | RESULT_FOLDERS) as stage:
        progress("writing figures and tables")
        notices_read = write_results(outcome, stage, progress)
        progress("working out what controllers can be given")
        give_back_of(rows)
        handover = controller_exports(outcome)
        write_controllers(outcome, handover, stage)
        progress("drawing the scene")
        notices = write_scene(outcome, stage / "scene.html")
        notices += write_certificate(outcome, stage, datetime.date.today())
        give_back_of(rows)
        progress("drawing the report")  # last, for it links to what is there
        notices = notices_read + write_report(outcome, handover, stage / "report.html", progress) + notices
        for name, text in beside.items():
            (stage / name).write_text(text, encoding="utf-8")
    return FolderRemarks(handover, notices)
