"""Hand a calibration over to whoever runs it: as code, to simulators, descriptions and controllers.

`--c DIR` writes C99 that needs nothing but the mathematical library, allocates nothing and keeps no state: NAME.h, NAME.c,
NAME_test.c, which compares it with 1,000 rows of `predict`, and CMakeLists.txt. NAME is the folder's name, or `--name`.
NAME_forward says where the target is, NAME_correct which joints bring the real target to where the nominal arm would have it,
NAME_jacobian how it moves, NAME_in_range whether that was measured. `--numpy FILE.py` writes a module that imports NumPy alone,
`--casadi FILE.casadi` a function for optimal control (`pip install "aridcal[export]"`). What an effect depends on beside the
joints, a temperature or a side of approach, is an argument. Where frames are per station, the first station's are taken.

`--mjcf FILE.xml` and `--sdf FILE.sdf` write `calibrated.urdf` for MuJoCo and Gazebo, `--xacro FILE.xacro` a macro with its
origins. `--randomize N -o DIR` draws N calibrations that the rows allow: `draws.csv`, `frames.csv`, `model_1.urdf` and on.
`--ros2 DIR` writes a launch with its URDF and transforms, and a node that corrects trajectories with the model as C.
`--table GRID -o DIR` writes compensation tables of joints that have an error curve of their own, for LinuxCNC, SINUMERIK
and HEIDENHAIN. `--list` says what can be had, and which error remains.

Example:
    aridcal export results --list
    aridcal export results --c my_arm && cmake -S my_arm -B build && cmake --build build && ctest --test-dir build
    aridcal export results --mjcf my_arm.xml --sdf my_arm.sdf
    aridcal export results --randomize 100 -o draws
    aridcal export results --table 1deg,5mm -o tables
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens, seed_argument
from aridcal.jobs.calibrate.saved_model import calibration_file
from aridcal.jobs.export.machine import Machine
from aridcal.jobs.export.receivers import FULL, RECEIVERS, remaining
from aridcal.runs.model_export import export_c, export_casadi, export_numpy
from aridcal.runs.model_files import export_draws, export_mjcf, export_ros2, export_sdf, export_tables, export_xacro
from aridcal.system.errors import OutputError
from aridcal.system.progress import Screen
from aridcal.system.reading.regular_files import RESULT, read_file
from aridcal.system.reading.user_names import path_argument

FILES: dict[str, tuple[str, str, Callable[[Path, Path], list[str]]]] = {
    "mjcf": ("calibrated.urdf for MuJoCo", ".xml", export_mjcf),
    "sdf": ("calibrated.urdf for Gazebo", ".sdf", export_sdf),
    "xacro": ("the macro calibrated_origin", ".xacro", export_xacro),
}
"""By option: what it writes, the file's ending, and what writes it and says what it does not hold."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("export", __doc__)
    arguments.add_argument(
        "calibration", type=path_argument, metavar="RESULTS", help="result folder, or calibration.yaml"
    )
    arguments.add_argument("--list", action="store_true", help="say who can be given what, and the error that remains")
    arguments.add_argument("--c", type=path_argument, metavar="DIR", help="write C99 into this folder")
    arguments.add_argument("--name", help="with --c: what all names begin with (default: the folder's name)")
    arguments.add_argument("--numpy", type=path_argument, metavar="FILE.py", help="write a Python module")
    arguments.add_argument("--casadi", type=path_argument, metavar="FILE.casadi", help="write a function of CasADi")
    for option, (what, *_) in FILES.items():
        arguments.add_argument(f"--{option}", type=path_argument, metavar=_ending(option), help=f"write {what}")
    arguments.add_argument("--ros2", type=path_argument, metavar="DIR", help="write files for ROS 2 into this folder")
    arguments.add_argument("--randomize", type=int, metavar="N", help="with -o: draw calibrations from the posterior")
    arguments.add_argument(
        "--table", metavar="GRID", help="with -o: compensation tables of joints, 1deg,5mm for instance"
    )
    arguments.add_argument("-o", "--out", type=path_argument, metavar="DIR", help="folder of --randomize, or --table")
    arguments.add_argument("--seed", type=seed_argument, default=0, help="of --randomize: the same, the same draws")
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    console, _ = screens(arguments)
    _check(arguments)
    path = calibration_file(arguments.calibration)
    if arguments.list:
        _list(console, path, arguments.calibration)
    if arguments.c:
        described, name = export_c(path, arguments.c, arguments.name)
        console.say(f"{arguments.c}: {name}.h, {name}.c, {name}_test.c, CMakeLists.txt", *_lines(described))
    if arguments.numpy:
        console.say(f"{arguments.numpy}: forward(q, conditions)", *_lines(export_numpy(path, arguments.numpy)))
    if arguments.casadi:
        console.say(f"{arguments.casadi}: forward(q, conditions)", *_lines(export_casadi(path, arguments.casadi)))
    for option, (what, _, write) in FILES.items():
        if file := getattr(arguments, option):
            console.say(f"{file}: {what}", *(f"  {remark}" for remark in write(path, file)))
    if arguments.ros2:
        remarks = export_ros2(path, arguments.ros2)
        written = f"{arguments.ros2}: calibrated.launch.py, correct_trajectory.py, and what they need"
        console.say(written, *(f"  {remark}" for remark in remarks))
    if arguments.randomize is not None:
        remarks = export_draws(path, arguments.out, arguments.randomize, arguments.seed)
        drawn = f"{arguments.out}: draws.csv, frames.csv, model_1.urdf to model_{arguments.randomize}.urdf"
        console.say(drawn, *(f"  {remark}" for remark in remarks))
    if arguments.table is not None:
        said = export_tables(path, arguments.out, arguments.table)
        console.say(
            f"{arguments.out}: tables.csv, and a table for each controller and joint", *(f"  {line}" for line in said)
        )


def _check(arguments: argparse.Namespace) -> None:
    """Refuse options that say nothing, or not enough."""
    endings = {"numpy": ".py", "casadi": ".casadi"} | {option: ending for option, (_, ending, _) in FILES.items()}
    into_folder = (arguments.randomize is not None) + (arguments.table is not None)
    if into_folder != (arguments.out is not None):
        raise OutputError("-o DIR belongs to one of --randomize N and --table GRID: give it and one of them")
    if not any(getattr(arguments, each) for each in ("list", "c", "ros2", *endings)) and not into_folder:
        raise OutputError("say what to write, `--c DIR` for instance; `aridcal export RESULTS --list` has them all")
    if arguments.name is not None and not arguments.c:
        raise OutputError("--name is of --c DIR: give that, too")
    for option, ending in endings.items():
        file = getattr(arguments, option)
        if file and file.suffix != ending:
            raise OutputError(f"{file}: should be a {ending} file")


def _ending(option: str) -> str:
    return f"FILE{FILES[option][1]}"


def _lines(described: Machine) -> list[str]:
    """What whoever calls it must know."""
    lines = ["  q: " + ", ".join(f"{each.name} [{each.unit}]" for each in described.joints)]
    lines += [f"  condition {each.name}: {each.unit}" for each in described.conditions]
    if described.frames != (None, None):
        named = " and ".join(repr(label) for label in described.frames if label is not None)
        lines.append(f"  of several frames those of {named}")
    if not described.pose:
        lines.append("  positions alone: the target's rotation was not measured")
    lines += [f"  {name} is taken as {value:.6g}" for name, value in described.assumed.items()]
    return lines


def _list(console: Screen, path: Path, named: Path) -> None:
    """Print the table of receivers."""
    result = _result(path)
    for receiver in RECEIVERS:
        files = [path.parent / name for name in receiver.option.split(", ")]
        if receiver.written and not all(file.exists() for file in files):
            continue
        how = (
            ", ".join(map(str, files))
            if receiver.written
            else f"aridcal export {shlex.quote(str(named))} {receiver.option}"
        )
        console.say(f"{receiver.who}: {receiver.holds}, {remaining(receiver, path.parent, result)}", f"    {how}")
    console.say(
        f"robot programs: {FULL}, {remaining(RECEIVERS[0], path.parent, result)}",
        f"    aridcal compensate {shlex.quote(str(named))} PROGRAM -o CORRECTED",
    )


def _result(path: Path) -> dict[str, Any] | None:
    """What `result.json` beside a calibration holds; None if there is none to be read."""
    try:
        return dict(json.loads(read_file(path.parent / "result.json", OutputError, RESULT)))
    except (OutputError, ValueError, TypeError):
        return None


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
