"""A calibration written as code for whoever runs it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from aridcal import __version__
from aridcal.engine.corrections.labels import is_label
from aridcal.jobs.calibrate.saved_model import SavedModel, calibration_file
from aridcal.jobs.export.c_code import Rows, c_files
from aridcal.jobs.export.casadi_function import casadi_function, is_function
from aridcal.jobs.export.identifiers import identifier, is_identifier
from aridcal.jobs.export.machine import Machine, Quantity, machine
from aridcal.jobs.export.numpy_code import numpy_module
from aridcal.system.errors import CampaignError, OutputError, shortened
from aridcal.system.reading.regular_files import CALIBRATION, RESULT, read_file
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import atomic_file, atomic_folder, claimed

ROWS = 1000
"""Rows of `predict` in the test of an export, as docs/apply/c.md promises."""

MARK = "written by `aridcal export`"
"""In every text of an export: a file without it is somebody's own, and is not replaced."""


def export_c(calibration: Path, folder: Path, name: str | None) -> tuple[Machine, str]:
    """Write the model as C into a folder; whatever else is in it stays.

    Args:
        calibration: ``calibration.yaml``, or its result folder.
        folder: Where to write it.
        name: Begins all names; default: the folder's own.

    Returns:
        What was written, and the name.

    Raises:
        OutputError: the name is none in C, or a file in the way is somebody's own.
    """
    name = identifier(folder.resolve().name) if name is None else name
    if not is_identifier(name):
        raise OutputError(
            f"--name {shortened(name)}: is no name in C: use letters, digits and _, and begin with a letter"
        )
    names = c_names(name)
    paths = [folder / each for each in names]
    check_apart(paths, [calibration])
    with claimed(folder, "folder", names):
        check_own(paths)
        saved, digest = loaded(calibration)
        described = machine(saved)
        with atomic_folder(folder) as stage:
            write_c(stage, saved, described, name, digest)
    return described, name


def c_names(name: str) -> list[str]:
    """Files of the export as C."""
    return [f"{name}.h", f"{name}.c", f"{name}_test.c", "CMakeLists.txt"]


def write_c(folder: Path, saved: SavedModel, described: Machine, name: str, digest: str) -> None:
    """Write the export as C into a folder that is being made."""
    rows = predicted_rows(saved, described, ROWS)
    for file, text in c_files(described, name, digest, _about(saved, described, name), rows).items():
        (folder / file).write_text(text, encoding="utf-8")


def export_numpy(calibration: Path, file: Path) -> Machine:
    """Write the model as a Python module that needs NumPy alone."""
    with alone(calibration, file):
        check_own([file])
        saved, digest = loaded(calibration)
        described = machine(saved)
        with atomic_file(file) as path:
            path.write_text(numpy_module(described, digest, _about(saved, described, file.stem)), encoding="utf-8")
    return described


def export_casadi(calibration: Path, file: Path) -> Machine:
    """Write the model as a function that CasADi loads, in any of its languages."""
    with alone(calibration, file):
        if file.exists() and not is_function(file):
            raise _not_ours(file)
        described = machine(loaded(calibration)[0])
        function = casadi_function(described)
        with atomic_file(file) as path:
            function.save(str(path))
    return described


def alone(calibration: Path, file: Path) -> AbstractContextManager[None]:
    """Take a file for this process."""
    check_apart([file], [calibration])
    return claimed(file, "file")


def loaded(calibration: Path) -> tuple[SavedModel, str]:
    """A calibration, and the sha256 of its file."""
    path = calibration_file(calibration)
    return SavedModel.load(path), hashlib.sha256(read_file(path, CampaignError, CALIBRATION)).hexdigest()


def check_own(paths: Iterable[Path]) -> None:
    """Refuse to replace what no export wrote.

    Raises:
        OutputError: naming the file.
    """
    for path in paths:
        if path.is_file() and MARK.encode() not in read_file(path, OutputError, RESULT):
            raise _not_ours(path)


def _not_ours(path: Path) -> OutputError:
    return OutputError(f"{path}: is there, and no `aridcal export` wrote it; give another place, or move it away")


def _about(saved: SavedModel, described: Machine, name: str) -> list[str]:
    """What the files say of themselves."""
    robot = saved.final.model.robot
    lines = [
        f"{name}: the calibrated robot {robot.path.name}, {robot.base} to {robot.tip}, {MARK} {__version__}.",
        "The whole model that `aridcal predict` computes with: geometry, effects and frames. SI units.",
    ]
    named = dict(zip(("station", "target"), described.frames, strict=True))
    for what, label in named.items():
        if label is not None:
            lines.append(f"The calibration has several frames: these are those of {what} {label}.")
    if not described.pose:
        lines.append("Positions alone were measured: the rotation of the target is not known, and R says nothing.")
    for column, value in described.assumed.items():
        lines.append(f"Column {column} is taken as {value:.6g}: only causes that are in doubt depend on it.")
    if any(c.basis.form == "step" for c in saved.expected.model.coefficients):
        lines.append("What moved once, between two rows, is where it is now.")
    if described.loads_held:
        lines.append("The Jacobian of this long arm leaves the loads on its joints as they are.")
    lines.append("How uncertain a prediction is, `aridcal predict` says; that is not in here.")
    return lines


def predicted_rows(saved: SavedModel, described: Machine, count: int, seed: int = 0) -> Rows:
    """Rows drawn evenly over what was measured, and what `predict` says of them."""
    rng = np.random.default_rng(seed)
    q = np.column_stack([_drawn(each, count, rng) for each in described.joints])
    columns = {each.name: _drawn(each, count, rng) for each in described.conditions}
    labels = [name for name in columns if is_label(name)]
    chosen = rng.integers(0, len(labels) + 1, count)
    columns |= {name: (chosen == k).astype(float) for k, name in enumerate(labels)}
    frames = [None if label is None else np.full(count, label) for label in described.frames]
    R, p = saved.expected.poses(q, saved.completed(columns, count), *frames)
    return Rows(np.column_stack([q, *columns.values()]), R, p)


def _drawn(quantity: Quantity, count: int, rng: np.random.Generator) -> np.ndarray:
    """Values of an input, shape (count,)."""
    low, high = quantity.range if np.isfinite(quantity.range).all() else (-1.0, 1.0)
    if quantity.name.endswith("_direction"):
        return rng.choice([-1.0, 0.0, 1.0], count)
    return np.asarray(rng.uniform(low, high, count))
