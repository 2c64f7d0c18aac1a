"""The C export against `predict`, and how long it takes beside Pinocchio.

Example:
    python benchmarks/export.py results/ur10-b results/panda          # results that identify wrote
    python benchmarks/export.py --shipped --blind 300

Each calibration is exported with ``aridcal export --c``'s own functions, compiled with ``-std=c99 -Wall -Wextra -Werror
-pedantic`` by every compiler that is there, and again under the address and undefined-behaviour sanitizers; each build gets
10,000 rows drawn evenly over what was measured, and its poses are compared with those of ``predict``. The blind cases are those
of ``blind.py``, every kind of effect in turn, with their true coefficients. The round trip is the distance that the real robot,
which is the calibrated model here, keeps from where the nominal arm has the target: with the joints of ``NAME_correct``, and with
those of ``compensate`` from the same start.

Times are CPU times of one thread: the best of 15 passes over 500 rows. Pinocchio's is ``forwardKinematics`` of the nominal
chain, called from Python, the call included. Needs gcc or clang.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from machines import ADDED, NAMED, Case, draw_case
from rich.console import Console
from rich.table import Table

from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.export.c_code import c_files
from aridcal.jobs.export.machine import Machine, machine
from aridcal.runs.model_export import predicted_rows
from aridcal.system.errors import AridcalError

HERE = Path(__file__).resolve().parents[1]
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
ROUND_TRIPS = 300
PASSES, TIMED = 15, 500

DRIVER = """
#define _POSIX_C_SOURCE 199309L
#include "arm.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int count, char **words)
{
    double row[arm_JOINTS + arm_CONDITIONS], out[12 + 6 * arm_JOINTS + 3 + arm_JOINTS];
    static double rows[TIMED][arm_JOINTS + arm_CONDITIONS];
    arm_conditions c;
    arm_pose T;
    int n = 0;
    memset(&c, 0, sizeof c);
    while (fread(row, sizeof row, 1, stdin) == 1) {
        if (arm_CONDITIONS)
            memcpy(&c, row + arm_JOINTS, sizeof c);
        if (n < TIMED)
            memcpy(rows[n++], row, sizeof row);
        if (count > 1)
            continue;
        arm_forward(row, &c, &T);
        memcpy(out, &T, sizeof T);
        arm_jacobian(row, &c, out + 12);
        out[12 + 6 * arm_JOINTS] = arm_correct(row, &c, out + 15 + 6 * arm_JOINTS, out + 13 + 6 * arm_JOINTS);
        fwrite(out, sizeof out, 1, stdout);
    }
    for (int what = 0; what < 4 && count > 1; what++) {
        double best = 1.0;
        for (int pass = 0; pass < atoi(words[1]); pass++) {
            const double begin = now();
            for (int k = 0; k < n; k++) {
                memcpy(&c, rows[k] + arm_JOINTS, arm_CONDITIONS * sizeof(double));
                if (what == 0)
                    arm_nominal(rows[k], &T);
                else if (what == 1)
                    arm_forward(rows[k], &c, &T);
                else if (what == 2)
                    arm_jacobian(rows[k], &c, out);
                else
                    arm_correct(rows[k], &c, out, out + arm_JOINTS);
            }
            const double took = (now() - begin) / n;
            best = took < best ? took : best;
        }
        printf("%.9g\\n", 1e6 * best);
    }
    return 0;
}
""".replace("TIMED", str(TIMED))


@dataclass(frozen=True)
class Score:
    """How one export did.

    Attributes:
        name: Of the calibration.
        effects: Coefficients of its effects.
        position: Largest difference of positions, [m].
        rotation: Largest difference of elements of R.
        builds: How many builds agreed on that.
        times: Of nominal, forward, jacobian and correct, [us]; NaN where they were not taken.
        pinocchio: Of its forward kinematics, [us].
        ours: RMS distance after `correct`, [m]; NaN where it was not tried.
        theirs: That after `compensate`.
    """

    name: str
    effects: int
    position: float
    rotation: float
    builds: int
    times: np.ndarray
    pinocchio: float
    ours: float
    theirs: float


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="*", type=Path, help="result folders, or campaigns")
    parser.add_argument(
        "--shipped", action="store_true", help="identify every campaign of identification/, and export it"
    )
    parser.add_argument("--blind", type=int, default=0, metavar="N", help="so many blind cases, too")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", type=int, default=10_000)
    return parser.parse_args()


def main() -> int:
    arguments, console = parse_arguments(), Console(width=170)
    compilers = [name for name in ("gcc", "clang") if shutil.which(name)]
    if not compilers:
        console.print("needs gcc or clang")
        return 2
    scores, blind = [], []
    for name, saved in calibrations(arguments):
        scores.append(score(name, saved, arguments.rows, compilers))
        console.print(line(scores[-1]), highlight=False, markup=False)
    for k, (name, saved) in enumerate(blind_cases(arguments.blind, arguments.seed)):  # each compiler in turn
        blind.append(score(name, saved, arguments.rows, [compilers[k % len(compilers)]], whole=False))
        console.print(line(blind[-1]), highlight=False, markup=False)
    if scores:
        console.print(table(scores))
    every = scores + blind
    worst = max(every, key=lambda s: max(s.position, s.rotation))
    position, rotation = max(s.position for s in every), max(s.rotation for s in every)
    console.print(
        f"{len(scores)} results and {len(blind)} blind cases, {arguments.rows:,} rows each, {sum(s.builds for s in every)} "
        f"builds: at most {position:.1e} m and {rotation:.1e} in R ({worst.name})",
        highlight=False,
    )
    return int(max(position, rotation) > 1e-12)


def calibrations(arguments: argparse.Namespace) -> Iterator[tuple[str, SavedModel]]:
    """Results that were named, and those of campaigns."""
    shipped = sorted(HERE.glob("identification/*/campaign*.yaml")) if arguments.shipped else []
    for path in (*arguments.results, *shipped):
        name = "/".join(path.parts[-3:])
        try:
            yield name, calibration(identify(path)) if path.name.startswith("campaign") else SavedModel.load(path)
        except AridcalError as error:
            print(f"{path}: {error}", file=sys.stderr)


def blind_cases(count: int, seed: int) -> Iterator[tuple[str, SavedModel]]:
    """Cases of ``blind.py`` with their true coefficients."""
    wanted = [("single", kind) for kind in (*NAMED, *ADDED)] + [("combination", None), ("off", None)]
    for k in range(count):
        what, kind = wanted[k % len(wanted)]
        case = draw_case(1_000_000 * seed + k, what, kind)
        yield f"{case.seed} {case.names}", true_model(case)


def true_model(case: Case) -> SavedModel:
    """The truth of a case as a calibration that saw its training rows."""
    model, train = case.truth, case.train
    solved = SolvedModel(model, case.theta, 1e-12 * np.eye(len(case.theta)))
    columns = dict(zip(model.robot.readings, train.readings.T, strict=True)) | dict(train.covariates)
    ranges = {name: (float(values.min()), float(values.max())) for name, values in columns.items()}
    depends = {*model.robot.readings, *model.needs}
    ranges = {name: pair for name, pair in ranges.items() if name in depends}
    sigma = (float(case.sigma[0]), float(case.sigma[-1]))
    kind = "pose" if len(case.sigma) == 2 else "position"
    return SavedModel(solved, solved, kind, (0.0, 0.0, -9.81), sigma, ranges, {})


def score(name: str, saved: SavedModel, count: int, compilers: Sequence[str], whole: bool = True) -> Score:
    """Export, build, compare; with times and round trips if it is to be whole."""
    described = machine(saved)
    rows = predicted_rows(saved, described, count)
    J, width = len(described.joints), 12 + 7 * len(described.joints) + 3
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for file, text in c_files(described, "arm", "0" * 64, ["arm"], predicted_rows(saved, described, 10)).items():
            (home / file).write_text(text, encoding="utf-8")
        (home / "driver.c").write_text(DRIVER)
        position = rotation = 0.0
        builds = 0
        for compiler in compilers:
            for options in (("-O2",), SANITIZED):
                program = home / f"{compiler}{options[0]}"
                sources = [str(home / "arm.c"), str(home / "driver.c")]
                subprocess.run([compiler, *STRICT, *options, *sources, "-lm", "-o", str(program)], check=True)
                some = rows.inputs if options == ("-O2",) else rows.inputs[:500]
                done = subprocess.run([program], input=some.tobytes(), capture_output=True, check=True)
                out = np.frombuffer(done.stdout).reshape(len(some), width)
                position = max(position, float(np.abs(out[:, 9:12] - rows.p[: len(some)]).max()))
                rotation = max(rotation, float(np.abs(out[:, :9] - rows.R[: len(some)].reshape(-1, 9)).max()))
                builds += 1
        times, pinocchio, ours, theirs = np.full(4, np.nan), np.nan, np.nan, np.nan
        if whole:
            program = next(
                home / f"{compiler}-O2" for compiler in ("gcc", "clang") if (home / f"{compiler}-O2").exists()
            )
            timed = subprocess.run(
                [program, str(PASSES)], input=rows.inputs[:TIMED].tobytes(), capture_output=True, check=True
            )
            times = np.array([float(text) for text in timed.stdout.split()])
            pinocchio = pinocchio_time(saved, rows.inputs[:TIMED, :J])
            done = subprocess.run([program], input=rows.inputs[:ROUND_TRIPS].tobytes(), capture_output=True, check=True)
            errors = np.frombuffer(done.stdout).reshape(-1, width)[:, 13 + 6 * J]
            ours = float(np.sqrt(np.mean(errors**2)))
            theirs = compensated(saved, described, rows.inputs[:ROUND_TRIPS])
    return Score(name, len(described.effects), position, rotation, builds, times, pinocchio, ours, theirs)


def pinocchio_time(saved: SavedModel, readings: np.ndarray) -> float:
    """Pinocchio's forward kinematics of the nominal chain, [us]."""
    model = saved.expected.model
    world, tip = model.frames(saved.expected.theta)
    bare = type(model)(
        model.robot, (), world, tip, model.around, routes=model.routes, target_on=model.target_on
    ).locked(np.zeros(0), *model.first_labels)
    data = bare.model.createData()
    configurations = list((readings @ model.robot.factors.T + model.robot.offsets)[:, bare.joints])
    best = np.inf
    for _ in range(PASSES):
        begin = time.thread_time()
        for q in configurations:
            pin.forwardKinematics(bare.model, data, q)
        best = min(best, (time.thread_time() - begin) / len(configurations))
    return 1e6 * best


def compensated(saved: SavedModel, described: Machine, inputs: np.ndarray) -> float:
    """RMS distance of the target from where the nominal arm has it, with the joints of ``compensate``, [m]."""
    inverse, model = saved.inverse_kinematics(*described.frames), saved.expected.model
    world, tip = model.frames(saved.expected.theta)
    bare = type(model)(model.robot, (), world, tip, model.around, routes=model.routes, target_on=model.target_on)
    q, c = np.split(inputs, [len(described.joints)], axis=1)
    R, p = bare.poses(
        np.zeros(0),
        bare.rows(q, None, *(None if label is None else np.full(len(q), label) for label in described.frames)),
    )
    names = [each.name for each in described.conditions]
    errors = [
        inverse.command(
            R[k], p[k], q[k], {**saved.assumed, **dict(zip(names, c[k].tolist(), strict=True))}
        ).position_error
        for k in range(len(q))
    ]
    return float(np.sqrt(np.mean(np.square(errors))))


def line(s: Score) -> str:
    return f"{s.name}: {s.position:.1e} m, {s.rotation:.1e} in R, {s.builds} builds"


def table(scores: list[Score]) -> Table:
    result = Table(
        "",
        "effects",
        "m",
        "R",
        "nominal us",
        "/ pin",
        "forward us",
        "jacobian us",
        "correct us",
        "trip mm",
        "/ compensate",
    )
    for s in scores:
        nominal, forward, jacobian, correct = s.times
        ratio = s.ours / s.theirs if s.theirs > 1e-7 else np.nan
        result.add_row(
            s.name, str(s.effects), f"{s.position:.1e}", f"{s.rotation:.1e}", f"{nominal:.2f}", f"{nominal / s.pinocchio:.2f}",
            f"{forward:.2f}", f"{jacobian:.2f}", f"{correct:.1f}", f"{1e3 * s.ours:.4f}", f"{ratio:.2f} of {1e3 * s.theirs:.4f}",
        )  # fmt: skip
    return result


if __name__ == "__main__":
    sys.exit(main())
