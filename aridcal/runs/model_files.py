"""A calibration written as files of simulators, descriptions and controllers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from aridcal import __version__
from aridcal.engine.robot.splice_mjcf import splice_mjcf
from aridcal.jobs.calibrate.saved_model import SavedModel, calibration_file
from aridcal.jobs.calibrate.urdf_files import write_urdf
from aridcal.jobs.export.calibrated_tree import CalibratedTree
from aridcal.jobs.export.draws import draws
from aridcal.jobs.export.mjcf_file import mjcf
from aridcal.jobs.export.sdf_file import sdf
from aridcal.jobs.export.xacro_file import xacro
from aridcal.runs.model_export import MARK, alone, check_own, loaded
from aridcal.system.errors import OutputError
from aridcal.system.writing.apart import check_apart
from aridcal.system.writing.table_writer import write_csv
from aridcal.system.writing.whole_files import atomic_file, atomic_folder, claimed

DRAWS, DRAWN = "draws.csv", re.compile(r"model_\d+\.urdf")
"""What a folder of drawn calibrations holds."""

DIGITS = 17
"""Of a drawn coefficient: it reads back as the same float64."""

MOST_DRAWS = 100_000
"""Work: files in one folder, 1 GB of an arm's."""


def export_mjcf(calibration: Path, file: Path) -> list[str]:
    """Write `calibrated.urdf` as MJCF; returns what the file does not hold, in words.

    Of a robot that was read from MJCF it is the user's own file, the places of its bodies calibrated.
    """
    return _as_text(calibration, file, _mjcf)


def export_sdf(calibration: Path, file: Path) -> list[str]:
    """Write `calibrated.urdf` as SDF; returns what the file does not hold, in words."""
    return _as_text(calibration, file, _sdf)


def export_xacro(calibration: Path, file: Path) -> list[str]:
    """Write the origins of `calibrated.urdf` as a macro of xacro."""
    return _as_text(calibration, file, lambda tree, about: (xacro(tree, about).encode(), []))


def export_draws(calibration: Path, folder: Path, count: int, seed: int) -> list[str]:
    """Write calibrations drawn from the posterior: their coefficients, and a `model.urdf` of each.

    Args:
        calibration: ``calibration.yaml``, or its result folder.
        folder: Where to write; models of an earlier draw go.
        count: How many.
        seed: The same one gives the same files.

    Returns:
        What the draws do not hold, in words.

    Raises:
        OutputError: there are too many, or a table in the way is somebody's own.
    """
    if not 1 <= count <= MOST_DRAWS:
        raise OutputError(f"--randomize {count}: should be from 1 to {MOST_DRAWS:,}")
    check_apart([folder / DRAWS], [calibration])
    earlier = [path.name for path in folder.glob("model_*.urdf") if DRAWN.fullmatch(path.name)]
    if earlier and not (folder / DRAWS).is_file():
        raise OutputError(f"{folder}: has {earlier[0]}, and no {DRAWS}: not of a draw; give another folder")
    names = [DRAWS, *(f"model_{k}.urdf" for k in range(1, count + 1))]
    with claimed(folder, "folder", names):
        saved = loaded(calibration)[0]
        final = saved.final
        values = draws(final, count, seed)
        with atomic_folder(folder, earlier) as stage:
            write_csv(
                dict(zip((c.name for c in final.model.coefficients), values.T, strict=True)), stage / DRAWS, DIGITS
            )
            for name, theta in zip(names[1:], values, strict=True):
                write_urdf(stage / name, final.model, theta)
    unknown = len(saved.untold)
    return [f"{unknown} combinations of constants that no row tells are the same in all"] if unknown else []


def _as_text(
    calibration: Path, file: Path, write: Callable[[CalibratedTree, Iterable[str]], tuple[bytes, list[str]]]
) -> list[str]:
    """Write one text."""
    with alone(calibration, file):
        check_own([file])
        saved, digest = loaded(calibration)
        tree = CalibratedTree(saved.geometric, calibration_file(calibration))
        text, remarks = write(tree, _about(saved, digest))
        with atomic_file(file) as path:
            path.write_bytes(text)
    return remarks


def _mjcf(tree: CalibratedTree, about: Iterable[str]) -> tuple[bytes, list[str]]:
    """The user's own MJCF with its bodies calibrated, or the URDF as MJCF."""
    if tree.robot.mjcf is None:
        return _encoded(mjcf(tree, about))
    return splice_mjcf(tree.robot, tree.origins), []


def _sdf(tree: CalibratedTree, about: Iterable[str]) -> tuple[bytes, list[str]]:
    return _encoded(sdf(tree, about))


def _encoded(written: tuple[str, list[str]]) -> tuple[bytes, list[str]]:
    text, remarks = written
    return text.encode(), remarks


def _about(saved: SavedModel, digest: str) -> list[str]:
    """What such a file says of itself."""
    robot = saved.final.model.robot
    return [
        f"The calibrated robot {robot.path.name}, {robot.from_to}, {MARK} {__version__}.",
        "The geometry of calibrated.urdf: effects are not in it, and its error is that of `URDF alone`.",
        f"sha256 of calibration.yaml: {digest}",
    ]
