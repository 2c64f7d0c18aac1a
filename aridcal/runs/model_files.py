"""A calibration written as files of simulators, descriptions and controllers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from aridcal import __version__
from aridcal.engine.robot.splice_mjcf import splice_mjcf
from aridcal.files.measurement_settings import ANGLES, LENGTHS, amount, with_unit
from aridcal.files.yaml_file import parse_yaml
from aridcal.jobs.calibrate.saved_model import SavedModel, calibration_file
from aridcal.jobs.calibrate.urdf_files import write_urdf
from aridcal.jobs.export.axis_tables import LINUXCNC_ENTRIES, AxisTable, axis_tables, heidenhain, linuxcnc, siemens
from aridcal.jobs.export.calibrated_tree import CalibratedTree
from aridcal.jobs.export.draws import draws, frames_of
from aridcal.jobs.export.identifiers import identifier
from aridcal.jobs.export.machine import machine
from aridcal.jobs.export.mjcf_file import mjcf
from aridcal.jobs.export.ros2_files import asset, static_transforms, transforms_text, transmissions
from aridcal.jobs.export.sdf_file import sdf
from aridcal.jobs.export.xacro_file import xacro
from aridcal.runs.model_export import MARK, alone, c_names, check_own, loaded, write_c
from aridcal.system.errors import OutputError, shortened
from aridcal.system.reading.regular_files import CALIBRATION, SETTINGS, TABLE_LIMIT, read_file
from aridcal.system.wording import plural
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import write_csv
from aridcal.system.writing.whole_files import atomic_file, atomic_folder, claimed

DRAWS, FRAMES, DRAWN = "draws.csv", "frames.csv", re.compile(r"model_\d+\.urdf")
"""What a folder of drawn calibrations holds."""

DIGITS = 17
"""Of a drawn coefficient: it reads back as the same float64."""

MOST_DRAWS = 100_000
"""Work: files in one folder, 1 GB of an arm's."""

TABLES, ABOUT_TABLES, OF_TABLES = "tables.csv", "tables.txt", (".comp", "_eec.ini", "_com.csv")
"""What a folder of compensation tables holds, and what the files of each joint end in."""


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
    """Write calibrations drawn from the posterior: their coefficients, their frames, and a `model.urdf` of each.

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
    check_apart([folder / DRAWS, folder / FRAMES], [calibration])
    earlier = [path.name for path in folder.glob("model_*.urdf") if DRAWN.fullmatch(path.name)]
    if earlier and not (folder / DRAWS).is_file():
        raise OutputError(f"{folder}: has {earlier[0]}, and no {DRAWS}: not of a draw; give another folder")
    models = [f"model_{k}.urdf" for k in range(1, count + 1)]
    names = [DRAWS, FRAMES, *models]
    with claimed(folder, "folder", names):
        saved = loaded(calibration)[0]
        final = saved.final
        values = draws(final, count, seed)
        with atomic_folder(folder, earlier) as stage:
            write_csv(
                dict(zip((c.name for c in final.model.coefficients), values.T, strict=True)), stage / DRAWS, DIGITS
            )
            write_csv(frames_of(final.model, values), stage / FRAMES, DIGITS)
            for name, theta in zip(models, values, strict=True):
                write_urdf(stage / name, final.model, theta)
    unknown = len(saved.untold)
    return [f"{unknown} combinations of constants that no row tells are the same in all"] if unknown else []


def export_tables(calibration: Path, folder: Path, grid: str) -> list[str]:
    """Write compensation tables of joints that have an error curve of their own.

    Args:
        calibration: ``calibration.yaml``, or its result folder.
        folder: Where to write; tables of an earlier calibration go.
        grid: Steps with their units, of what turns and of what slides: ``1deg,5mm``.

    Returns:
        Of each table, how far it is from the curve, in words.

    Raises:
        OutputError: the grid is none, or no joint has such a curve.
    """
    steps = _steps(grid)
    check_apart([folder / TABLES, folder / ABOUT_TABLES], [calibration])
    earlier = _tables_in(folder)
    with claimed(folder, "folder", [TABLES, ABOUT_TABLES]):
        saved, digest = loaded(calibration)
        tables = axis_tables(saved, **steps)
        robot, maps = saved.final.model.robot, (calibration_file(calibration).parent / "joint_maps.urdf").exists()
        lines = [
            f"Error curves of joints of the calibrated robot {robot.path.name}, {MARK} {__version__}.",
            f"They go with {'joint_maps.urdf' if maps else 'calibrated.urdf'}: all other effects are left out.",
            f"sha256 of calibration.yaml: {digest}",
        ]
        written = {each.joint: _between(each, saved.span) for each in tables}
        with atomic_folder(folder, earlier) as stage:
            columns: dict[str, list[np.ndarray]] = {"joint": [], "reading": [], "rising": [], "falling": []}
            for each in tables:
                values = (np.full(len(each.readings), each.joint), each.readings, each.rising, each.falling)
                for column, some in zip(columns.values(), values, strict=True):
                    column.append(some)
                name, number = identifier(each.joint), robot.readings.index(each.joint) + 1
                (stage / f"{name}.comp").write_text(linuxcnc(each))
                (stage / f"{name}_eec.ini").write_text(siemens(each, number, [*lines, written[each.joint]]), "utf-8")
                (stage / f"{name}_com.csv").write_text(heidenhain(each))
            write_csv({key: np.concatenate(parts) for key, parts in columns.items()}, stage / TABLES, DIGITS)
            about = [*lines, *(f"{joint}: {words}" for joint, words in written.items())]
            (stage / ABOUT_TABLES).write_text("\n".join([*about, ""]), encoding="utf-8")
    long = [each.joint for each in tables if len(each.readings) > LINUXCNC_ENTRIES]
    remarks = [f"{name}.comp has more than the {LINUXCNC_ENTRIES} entries that LinuxCNC reads" for name in long]
    return [*(f"{joint}: {words}" for joint, words in written.items()), *remarks]


def export_ros2(calibration: Path, folder: Path) -> list[str]:
    """Write what a launch of ROS 2 takes as it is, and a node that corrects trajectories with the model as C.

    Args:
        calibration: ``calibration.yaml``, or its result folder.
        folder: Where to write it; whatever else is in it stays.

    Returns:
        What is left out, and what the node must be told, in words.

    Raises:
        OutputError: a file in the way is somebody's own.
    """
    name, beside = identifier(folder.resolve().name), calibration_file(calibration).parent
    texts = [
        "static_transforms.yaml",
        "calibrated.launch.py",
        "correct_trajectory.py",
        "joint_offsets.ros2_control.xml",
    ]
    names = [*c_names(name), *texts, "calibrated.urdf", "kinematics.yaml"]
    paths = [folder / each for each in names]
    check_apart(paths, [calibration, beside / "calibrated.urdf", beside / "kinematics.yaml"])
    with claimed(folder, "folder", names):
        check_own(paths[:-2])
        if not (folder / texts[0]).exists() and any(path.exists() for path in paths[-2:]):
            raise OutputError(f"{folder}: has a {' or a '.join(names[-2:])} of its own; give another folder")
        saved, digest = loaded(calibration)
        tree = CalibratedTree(saved.geometric, calibration_file(calibration))
        about, described = _about(saved, digest), machine(saved)
        transforms, remarks = static_transforms(saved, tree)
        with atomic_folder(folder, names[-3:]) as stage:
            write_c(stage, saved, described, name, digest)
            write_urdf(stage / "calibrated.urdf", saved.geometric.model, saved.geometric.theta)
            (stage / texts[0]).write_text(transforms_text(transforms, about), encoding="utf-8")
            for each in texts[1:3]:
                (stage / each).write_text(asset(each, name, f"{MARK} {__version__}"), encoding="utf-8")
            if (beside / "kinematics.yaml").exists():
                (stage / "kinematics.yaml").write_bytes(read_file(beside / "kinematics.yaml", OutputError, CALIBRATION))
            offsets = _offsets(beside)
            if offsets:
                note = "Offsets of joints by themselves, without calibrated.urdf: the error is that of `joint offsets alone`."
                (stage / texts[3]).write_text(transmissions(offsets, [about[0], note, about[2]]), encoding="utf-8")
            else:
                remarks.append(f"{texts[3]} is left out: no joint_offsets.yaml beside the calibration")
    told = [each.name for each in described.conditions if not each.name.endswith("_direction")]
    return [*remarks, *(f"the node needs the condition {each}: -p conditions.{each}:=NUMBER" for each in told)]


def _offsets(folder: Path) -> dict[str, float]:
    """Offsets of joints that a result folder states; none where it does not."""
    path = folder / "joint_offsets.yaml"
    if not path.exists():
        return {}
    text = read_file(path, OutputError, SETTINGS).decode("utf-8", "replace")
    offsets = parse_yaml(text, path)[0].get("joint_offsets")
    if not isinstance(offsets, dict) or not all(isinstance(value, float) for value in offsets.values()):
        raise OutputError(f"{path}: is none of `identify`: restore it, or move it away")
    return {str(name): value for name, value in offsets.items()}


def _tables_in(folder: Path) -> list[str]:
    """Files of an earlier export of tables.

    Raises:
        OutputError: there are tables, and no export wrote them.
    """
    if not (folder / TABLES).exists() and not (folder / ABOUT_TABLES).exists():
        return []
    check_own([folder / ABOUT_TABLES])
    if not ((folder / ABOUT_TABLES).exists() and (folder / TABLES).exists()):
        raise OutputError(f"{folder}: has one of {TABLES} and {ABOUT_TABLES}: not of an export; give another folder")
    lines = read_file(folder / TABLES, OutputError, TABLE_LIMIT).decode("utf-8", "replace").splitlines()
    joints = {
        identifier(line.rpartition(",")[0].rpartition(",")[0].rpartition(",")[0].strip('"')) for line in lines[1:]
    }
    return [f"{joint}{ending}" for joint in sorted(joints) for ending in OF_TABLES]


def _steps(grid: str) -> dict[str, float | None]:
    """Steps in rad and in m."""
    steps: dict[str, float | None] = {"angle": None, "length": None}
    for part in grid.split(","):
        try:
            value = with_unit(part.strip(), {**ANGLES, **LENGTHS}, "1deg,5mm")
        except ValueError as problem:
            raise OutputError(f"--table: {problem}") from None
        kind = "angle" if amount(part.strip())[1] in ANGLES else "length"
        if steps[kind] is not None:
            raise OutputError(
                f"--table {shortened(grid)}: two steps of one kind: write one for what turns, one for what slides"
            )
        steps[kind] = value
    return steps


def _between(table: AxisTable, span: float) -> str:
    """How far a table is from the curve between its entries, in words."""
    unit = "mrad" if table.turns else "mm"
    far = f", {1e3 * table.worst * span:.2g} mm at {span:.2f} m" if table.turns else ""
    return (
        f"{plural(len(table.readings), 'place')}, {table.step * table.scale:.6g} {table.unit} apart, corrections to "
        f"{1e3 * table.largest:.3g} {unit}, between them off by {1e3 * table.worst:.2g} {unit} at most{far}"
    )


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
