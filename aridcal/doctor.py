"""Check an installation: its libraries, a small robot calibrated from end to end, and places to write.

One line for each check, with the remedy where it fails. Exit status 0 if all required checks pass, else 2.

Example:
    aridcal doctor
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import importlib.util
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from aridcal import __version__
from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.system.errors import AridcalError
from aridcal.system.writing.whole_files import check_writable

IMPORTED_AS = {
    "charset-normalizer": "charset_normalizer",
    "opencv-python-headless": "cv2",
    "pin": "pinocchio",
    "pycollada": "collada",
    "pyyaml": "yaml",
}
"""Distributions whose modules have another name."""

GOOD_ENOUGH = 2.0  # times the noise that a sound calibration may leave

ARM = """\
<robot name="check">
  <link name="base"/><link name="a"/><link name="b"/>
  <link name="c"><visual><geometry><mesh filename="tool.obj"/></geometry></visual></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="lift" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="roll" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.8 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
</robot>
"""
TOOL_MESH = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n"
SCENARIO = """\
format: 1
robot: {urdf: arm.urdf, tip: c}
measurements: {noise: {position: 1.0e-4, rotation: 1.0e-4}}
diagnosis: {enabled: false}
truth:
  n: 40
  noise: {position: 1.0e-4, rotation: 1.0e-4}
  frames: {world_base: {xyz: [2, 1, 0], rpy: [0.1, 0.2, 3]}, tip_target: {xyz: [0.1, 0.05, 0], rpy: [1, 0, 0]}}
  parameters: {lift.x: 0.003, lift.roll: 0.002, roll.y: -0.002, roll.yaw: 0.004}
"""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        what: In a few words.
        found: What was found.
        remedy: What to do about it; empty: nothing needs doing.
        optional: True if aridcal does its work without.
    """

    what: str
    found: str
    remedy: str = ""
    optional: bool = False


def checks(here: Path) -> Iterator[Finding]:
    """Look at everything, the least first.

    Args:
        here: Folder in which results are to be written.
    """
    yield _python()
    yield from _libraries()
    yield _pinocchio()
    yield _attempt("round trip", _round_trip)
    for folder, remedy in ((here, "work in a folder of your own"), (Path(tempfile.gettempdir()), "set TMPDIR")):
        yield _writable(folder, remedy)
    browser = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("firefox")
    need = "only for looking at pages on this machine; reports and scenes open in any browser"
    yield Finding("browser", browser or "none", "" if browser else need, optional=True)


def _python() -> Finding:
    found = f"{sys.version.split()[0]}, {sys.executable}"
    old = sys.version_info < (3, 11)
    return Finding("python", found, "install Python 3.11 or newer and make a new environment with it" if old else "")


def _libraries() -> Iterator[Finding]:
    """Every library that aridcal requires: there, new enough, and importable."""
    for requirement in importlib.metadata.requires("aridcal") or ():
        match = re.match(r"([\w.-]+)\s*(?:>=\s*([\d.]+))?", requirement)
        if "extra ==" in requirement or match is None:
            continue
        name, least = match.groups()
        again = f"pip install --upgrade '{requirement}'"
        try:
            version = importlib.metadata.version(name)
            importlib.import_module(IMPORTED_AS.get(name.lower(), name))
        except importlib.metadata.PackageNotFoundError:
            yield Finding(name, "is not installed", again)
        except Exception as error:
            yield Finding(name, f"cannot be imported: {type(error).__name__}: {error}", f"{again} --force-reinstall")
        else:
            old = least is not None and _release(version) < _release(least)
            yield Finding(name, version, again if old else "")


def _release(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version.partition("+")[0])[:3])


def _pinocchio() -> Finding:
    """Another Pinocchio, of ROS for instance, may come first on the path."""
    spec = importlib.util.find_spec("pinocchio")
    where = Path(spec.origin or "").resolve() if spec else Path()
    if where.is_relative_to(Path(sys.prefix).resolve()):
        return Finding("pinocchio's place", "in this environment")
    said = f"comes from {where}, not from this environment"
    return Finding("pinocchio's place", said, "unset PYTHONPATH (ROS sets it), then try again", optional=True)


def _attempt(what: str, look: Callable[[], Finding]) -> Finding:
    try:
        return look()
    except Exception as error:
        remedy = "mend what fails above; if all else passes, report this line"
        return Finding(what, f"failed: {type(error).__name__}: {error}", remedy)


def _round_trip() -> Finding:
    """Simulate a small wrong robot, calibrate it, write all results, and see whether it came out right."""
    from aridcal.files.yaml_file import load_settings
    from aridcal.jobs.calibrate.key_figures import overall_error
    from aridcal.jobs.calibrate.pipeline import identify
    from aridcal.jobs.calibrate.saved_model import SavedModel
    from aridcal.jobs.simulate.scenario import Scenario
    from aridcal.jobs.simulate.simulation import simulate, write_campaign
    from aridcal.runs.result_folder import write_folder

    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        (home / "arm.urdf").write_text(ARM)
        (home / "tool.obj").write_text(TOOL_MESH)
        (home / "scenario.yaml").write_text(SCENARIO)
        write_campaign(simulate(load_settings(home / "scenario.yaml", Scenario)), home, home)
        outcome = identify(home / "campaign.yaml")
        written = write_folder(outcome, home / "results")
        SavedModel.load(home / "results")
    test = outcome.parts()["test"]
    before, after = (
        overall_error(s.residual, test, outcome.measurements, outcome.noise)
        for s in (outcome.stages[0], outcome.stages[-1])
    )
    said = f"{before:.2f} mm before, {after:.2f} mm calibrated (noise 0.17), {time.perf_counter() - started:.1f} s"
    wrong = after > GOOD_ENOUGH * 0.1 * 3**0.5
    if written.notices:  # nothing of this robot is hard to draw
        said += f"; {'; '.join(written.notices)}"
    return Finding("round trip", said, "this is a bug: report it with these lines" if wrong or written.notices else "")


def _writable(folder: Path, remedy: str) -> Finding:
    try:
        check_writable(folder / "results", "folder")
    except AridcalError as error:
        return Finding("writing", str(error), remedy)
    room = shutil.disk_usage(folder).free / 1e6
    return Finding("writing", f"{folder}, {room:.0f} MB free", "free some disk space" if room < 50 else "")


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("doctor", __doc__)
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    console, _ = screens(arguments)
    bad = []
    console.say(f"aridcal {__version__}, {Path(__file__).parent}")
    for check in checks(Path.cwd()):
        failed = bool(check.remedy) and not check.optional
        bad += [check.what] if failed else []
        mark = (
            "[bold red]FAIL[/bold red]"
            if failed
            else "[yellow]note[/yellow]"
            if check.remedy
            else "[green]ok[/green]  "
        )
        console.print(mark, end="  ")
        said = f"{check.what}: {check.found}" + (f". Remedy: {check.remedy}" if check.remedy else "")
        console.say(said)
    if bad:
        raise AridcalError(f"{len(bad)} of these checks failed: {', '.join(bad)}")
    console.print("all checks passed. next: aridcal init --urdf robot.urdf --measurements table.csv", highlight=False)


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
