"""Robot programs corrected: is every other byte kept, and does the real arm come to where it should?

40 programs a language as integrators write them (nested frames, names, comments, CRLF, umlauts) for a simulated UR10 of which
the truth is known. The corrected text is read by the program's own template, and its numbers are given to a controller with the
nominal arm; where the true arm then stands is compared with where it should be, and with the calibrated model's error.

G-code is for two gantries, three slides and three slides with a rotary axis, out of square, with errors of scale and a rail that
waves. A controller that knows nothing of the reader (``made_gcode.py``) drives the original and the corrected text to the
end, arcs, steps, G92 and homing too; where the original sends the nominal gantry is where the corrected text should bring the
true one.

Example:
    python benchmarks/robot_programs.py --programs 40
    python benchmarks/robot_programs.py --only .nc
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from calibrated import Machine, machine
from made_gcode import ZEROS, calibrated_gantry, drive, gcode
from made_programs import MAKERS, Made, path
from rich.console import Console
from rich.table import Table

from aridcal.compensate import main as compensate
from aridcal.jobs.apply.programs.branches import controller, flange

POINTS = 25


def error(wanted: np.ndarray, m: Machine, q: np.ndarray) -> tuple[float, float]:
    """How far the true target is from where it should be, and from where the calibrated model says, [m]."""
    final = m.saved.final
    world, tip = (frames[0][1].homogeneous for frames in final.model.frames(final.theta))
    _, true = m.model.poses(m.theta, m.model.rows(q[None]))
    _, said = final.poses(q[None])
    return float(np.linalg.norm(true[0] - (world @ wanted @ tip)[:3, 3])), float(np.linalg.norm(true[0] - said[0]))


def sent(made: Made, texts: list[str], ending: str, m: Machine) -> list[np.ndarray]:
    """Readings to which the controller goes for each target of a program, with the nominal arm."""
    dialect, _ = MAKERS[ending]
    nominal, found, values = controller(m.model.robot), [], list(map(float, texts))
    for kind, base, tool, q in zip(made.kinds, made.bases, made.tools, made.readings, strict=True):
        count = 6 if kind == "joints" else len(dialect.pose(np.eye(4)))
        own, values = np.array(values[:count]), values[count:]
        if kind == "joints":
            found.append(dialect.joints * own)
        else:
            T = base @ dialect.read(own) @ np.linalg.inv(tool)
            command = nominal.command(T[:3, :3], T[:3, 3], q, {})
            assert command.reached
            found.append(command.readings)
    return found


def corrected(made: Made, ending: str, calibration: Path, folder: Path) -> tuple[str, pd.DataFrame]:
    """The text that the command writes, and its side table."""
    program, out = folder / f"program{ending}", folder / f"corrected{ending}"
    program.write_bytes(made.text.encode("utf-8"))
    arguments = [str(calibration), str(program), "-o", str(out)]
    if made.frames:
        (folder / "frames.yaml").write_text(made.frames)
        arguments += ["--frames", str(folder / "frames.yaml")]
    assert compensate(arguments) == 0
    return out.read_bytes().decode("utf-8"), pd.read_csv(folder / f"{out.name}.corrections.csv")


class Tally:
    """What became of the targets of a language's programs, counted, and how far off the real machine was, [m]."""

    def __init__(self) -> None:
        self.count = {"kept": 0.0, "targets": 0.0, "left": 0.0, "part": 0.0}
        self.errors: dict[str, list[float]] = {"before": [], "after": [], "model": [], "rest": [0.0]}

    def target(self, m: Machine, q: np.ndarray, there: np.ndarray, corrected: bool, remark: object) -> None:
        """Add one: readings that the program asked for, those of the corrected one, and what was said of it."""
        wanted = flange(m.saved.final.model.robot, q)
        if not corrected:
            self.count["left"] += 1
        elif isinstance(remark, str):
            self.count["part"] += 1
            self.errors["rest"].append(error(wanted, m, there)[0])
        else:
            self.errors["before"].append(error(wanted, m, q)[0])
            self.errors["after"].append(error(wanted, m, there)[0])
            self.errors["model"].append(error(wanted, m, there)[1])

    def told(self) -> dict[str, float]:
        """Counts, and RMS errors, [mm]."""
        return self.count | {name: 1e3 * float(np.sqrt(np.mean(np.square(e)))) for name, e in self.errors.items()}


@contextmanager
def set_up(m: Machine) -> Iterator[tuple[Path, np.ndarray, np.ndarray]]:
    """A folder with the calibration of a machine, and the ranges of its readings, shape (joints,) each."""
    low, high = np.array([m.saved.ranges[name] for name in m.saved.final.model.robot.readings]).T
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "calibration.yaml").write_text(m.saved.dump())
        yield Path(name), low, high


def measure(ending: str, programs: int, m: Machine) -> dict[str, float]:
    """What becomes of the programs of a language."""
    robot, tally = m.saved.final.model.robot, Tally()
    with set_up(m) as (folder, low, high):
        for seed in range(programs):
            rng = np.random.default_rng(seed)
            made = MAKERS[ending][1](rng, path(rng, low, high, POINTS), lambda q: flange(robot, q))
            text, side = corrected(made, ending, folder / "calibration.yaml", folder)
            texts = made.read(text)
            tally.count["targets"] += len(made.kinds)
            if texts is None:
                continue
            tally.count["kept"] += 1
            ways = zip(sent(made, made.numbers, ending, m), sent(made, texts, ending, m), strict=True)
            for (q, there), (_, row) in zip(ways, side.iterrows(), strict=True):
                tally.target(m, q, there, bool(row["corrected"]), row["remark"])
    return tally.told()


def measure_gantry(programs: int, m: Machine) -> dict[str, float]:
    """What becomes of G-code, original and corrected driven to the end by a controller that knows nothing of ours."""
    robot, tally = m.saved.final.model.robot, Tally()
    with set_up(m) as (folder, low, high):
        for seed in range(programs):
            made = gcode(np.random.default_rng(seed), low, high, POINTS)
            text, side = corrected(made, ".nc", folder / "calibration.yaml", folder)
            tally.count["kept"] += made.read(text) is not None
            tally.count["targets"] += len(side)
            units = np.array([np.pi / 180 if kind == "revolute" else 1e-3 for kind in robot.kinds])
            start = units * np.array(yaml.safe_load(made.frames)["start"])
            zeros = {**ZEROS, "G57": (0.0, 0.0, 0.0)}
            was, now = (
                {block.line: block.place for block in drive(program, robot.kinds, zeros, start)}
                for program in (made.text, text)
            )
            for row in side.itertuples():
                tally.target(m, was[row.line], now[row.line], bool(row.corrected), row.remark)
    return tally.told()


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("--programs", type=int, default=40, help="of each language")
    command.add_argument("--only", choices=[*MAKERS, ".nc"], default="", help="one language")
    arguments = command.parse_args()
    programs, only = arguments.programs, arguments.only
    m = machine(3, n=150)
    console = Console(width=120)
    heads = (
        "language",
        "bytes kept",
        "targets",
        "left",
        "in part",
        "rest [mm]",
        "before [mm]",
        "after",
        "model's",
        "ratio",
    )
    table = Table(*heads)
    measured = {ending: measure(ending, programs, m) for ending in MAKERS if only in ("", ending)}
    if only in ("", ".nc"):
        measured["gantry .nc"] = measure_gantry(programs, calibrated_gantry(rotary=False))
        measured["with a rotary axis"] = measure_gantry(programs, calibrated_gantry(rotary=True))
    for ending, found in measured.items():
        table.add_row(
            ending, f"{found['kept']:.0f} of {programs}", *(f"{found[name]:.0f}" for name in ("targets", "left", "part")),
            f"{found['rest']:.2f}", f"{found['before']:.3f}", f"{found['after']:.4f}", f"{found['model']:.4f}",
            f"{found['after'] / found['model']:.2f}",
        )  # fmt: skip
    console.print(table)


if __name__ == "__main__":
    main()
