"""How right the answers are: on a real robot's unused rows, and in simulations whose truth is known.

Example:
    python benchmarks/accuracy.py                      # all tables
    python benchmarks/accuracy.py real ranks           # some of them

- ``real``: UR10 series B (public laser-tracker data), ten splits by seed, through ``identify``.
- ``coverage``: 400 simulated ARIDs with noise. Do 2-sigma intervals hold the truth in 95.4 % of all cases, and is the
  predicted sigma of the target the scatter of its prediction? What cannot be told apart has no truth of its own, so the
  truth is written in the fit's own coefficients: the same model fitted to the same rows without noise.
- ``predictions``: 150 of the blind benchmark's robots (``machines.py``), their effects found by the search. How often is the
  truth inside 2 ``std_*`` of the prediction at configurations never measured, inside the ranges seen?
- ``frames``: 100 true frames of any attitude, all with an identity hint: is the optimum the one that a start at the true
  frames leads to?
- ``exact``: rows without noise: do the coefficients come back?
- ``ranks``: how many coefficients are told apart, against 4 R + 2 P + 6 (poses) and 4 R + 2 P + 3 (positions).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from machines import draw_case
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.identifiable import identifiable
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.residual import triangle
from aridcal.engine.fit.stages import fit_geometry, recentred
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.search.loop import calibrated_arm, fit_constants
from aridcal.engine.trust.uncertainty import with_contradicted_noise
from aridcal.files.campaign import Campaign
from aridcal.jobs.calibrate.outcome import errors
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SolvedModel
from aridcal.system.progress import SILENT

TOP = Path(__file__).resolve().parents[1]
SHARED_ROBOTS = Path(pin.__file__).resolve().parents[4] / "share" / "example-robot-data" / "robots"
BAD_ROWS = (532, 854, 855, 1063)  # of series B: stale or disturbed measurements, by `sequence`
NOISE = 1e-4  # per axis, [m] and [rad]
WRONG = 2e-3  # standard deviation of every constant, [m] and [rad]
PREDICTED = ("clean", "single", "single", "combination", "off")  # in turn
PREDICTED_SEED = 2_600_000
ARID_FRAMES = (
    pin.SE3(pin.rpy.rpyToMatrix(1.58, 0.02, -2.3), np.array([6.2, -1.4, 3.1])),
    pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.2, 0.5), np.array([0.35, 0.04, -0.06])),
)


def arid() -> Robot:
    return load_robot(TOP / "urdf" / "arid.urdf", "flange")


def ur10() -> Robot:
    return load_robot(TOP / "urdf" / "ur10.urdf", "tool0")


ROBOTS = {"arid": arid, "ur10": ur10}


def truth_of(robot: Robot, which: str, frames: tuple[pin.SE3, pin.SE3]) -> Model:
    """A robot with all constants of a set, seen from and seen at some frames."""
    return Model(robot, constants(robot, which), ((None, frames[0]),), ((None, frames[1]),))


def measure(
    truth: Model,
    theta: np.ndarray,
    readings: np.ndarray,
    error: np.ndarray | None = None,
    kind: str = "pose",
    sigma: tuple[float, ...] = (),
) -> Dataset:
    """What a tracker says of some configurations; errors in world axes, shape (N, 6), [m] and [rad], default none."""
    error = np.zeros((len(readings), 6)) if error is None else error
    R, p = truth.poses(theta, truth.rows(readings))
    turned = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_matrix(R, assume_valid=True)
    rotation = turned.as_matrix() if kind == "pose" else None
    return dataset(truth.robot.readings, truth.robot.kinds, readings, p + error[:, :3], rotation, sigma=sigma)


def campaign_of(robot: Robot, which: str, kind: str = "pose", known: tuple[pin.SE3, pin.SE3] | None = None) -> Campaign:
    """What a user would have written; frames are unknown, with no hint, unless they are given."""
    frames = {}
    for name, frame in zip(("world_base", "tip_target"), known or (), strict=known is not None):
        rpy = pin.rpy.matrixToRpy(frame.rotation)
        frames[name] = {"xyz": frame.translation.tolist(), "rpy": rpy.tolist(), "identify": False}
    return Campaign.model_validate({
        "format": 1,
        "robot": {"urdf": Path("robot.urdf"), "tip": robot.tip},
        "measurements": {"file": (Path("rows.csv"),), "kind": kind},
        "frames": frames,
        "parameters": {"set": which},
    })  # fmt: skip


def solve(campaign: Campaign, robot: Robot, rows: Dataset) -> Fit:
    return fit_geometry(campaign.question, robot, rows, ()).geometric


def real(console: Console) -> None:
    if not (TOP.parent / "shared" / "data").is_dir():
        console.print("real: the public data are not beside this repository: see identification/ur10-laser-tracker")
        return
    path = TOP / "identification" / "ur10-laser-tracker" / "campaign-b.yaml"
    keys = yaml.safe_load(path.read_text())
    keys["robot"]["urdf"] = str((path.parent / keys["robot"]["urdf"]).resolve())
    file = (path.parent / keys["measurements"]["file"]).resolve()
    keys["measurements"]["file"] = str(file)
    keys["diagnosis"] = {"enabled": False}
    table = Table(title="UR10 series B, frames unknown: RMS on rows never used", title_justify="left")
    for head in ("seed", "test rows", "nominal [mm]", "geometric [mm]", "nominal [mrad]", "geometric [mrad]",
                 "identified", "flagged, by sequence (in test)"):  # fmt: skip
        table.add_column(head, justify="right")
    sequence = pd.read_csv(file)["sequence"].to_numpy()
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        campaign = Path(folder) / "campaign.yaml"
        campaign.write_text(yaml.safe_dump(keys))
        for seed in range(10):
            found = identify(campaign, seed)
            test = found.parts()["test"]
            e = [errors(found.stage(name).residual, test, found.channels) for name in ("nominal", "geometric")]
            row = [e[k][unit]["rms"] for unit in ("position_mm", "rotation_mrad") for k in (0, 1)]
            figures.append(row)
            number, left_out = sequence[found.measurements.origin.line - 2], found.measurements.test
            flagged = [f"({number[k]})" if left_out[k] else str(number[k]) for k in np.flatnonzero(found.outlier)]
            passed = np.isin(number, BAD_ROWS) & ~found.outlier
            missed = [f"{number[k]} in {'test' if left_out[k] else 'TRAIN'} passed" for k in np.flatnonzero(passed)]
            identified = len(found.stage("geometric").fit.theta)
            cells = [f"{v:.4f}" for v in row]
            table.add_row(str(seed), str(test.sum()), *cells, str(identified), ", ".join(flagged + missed))
    table.add_section()
    mean, spread = np.mean(figures, axis=0), np.std(figures, axis=0, ddof=1)
    table.add_row("mean", "", *(f"{m:.4f} ± {s:.4f}" for m, s in zip(mean, spread, strict=True)))
    console.print(table)


def coverage(console: Console, count: int = 400) -> None:
    robot = arid()
    truth = truth_of(robot, "doty", ARID_FRAMES)
    query = draw_readings(robot, 100, np.random.default_rng(0))
    table = Table(title=f"{count} noisy ARIDs, set doty, 150 rows of poses", title_justify="left")
    for head in ("frames", "noise", "coefficients", "inside 2 sigma [%]", "worst coefficient [%]",
                 "sigma/scatter, position", "sigma/scatter, rotation", "dropped coefficients hide [sigma]"):  # fmt: skip
        table.add_column(head, justify="right")
    for known, sigma in ((None, ()), (None, (NOISE, NOISE)), (ARID_FRAMES, ())):
        campaign = campaign_of(robot, "doty", known=known)
        inside: dict[str, list[bool]] = {}
        expected, happened, hidden = np.zeros(2), np.zeros(2), 0.0
        for seed in range(count):
            rng = np.random.default_rng([seed, 1992])
            theta = WRONG * rng.standard_normal(len(truth.coefficients))
            readings = draw_readings(robot, 150, rng)
            error = NOISE * rng.standard_normal((150, 6))
            found = solve(campaign, robot, measure(truth, theta, readings, error, sigma=sigma))
            true = fit(problem(found.model, measure(truth, theta, readings)), found.theta, np.ones(150))
            hidden = max(hidden, float(np.abs(true.residual).max()) / NOISE)
            for name, d, std in zip(found.model.names, found.theta - true.theta, found.std, strict=True):
                inside.setdefault(name, []).append(bool(abs(d) < 2 * std))
            unseen = problem(found.model, measure(truth, theta, query))
            _, _, J = found.model.jacobian(found.theta, unseen.rows)
            off = unseen.residual(found.theta)
            variance = np.einsum("nik,kl,nil->ni", J, found.covariance, J)
            for k in (0, 1):
                expected[k] += variance[:, 3 * k : 3 * k + 3].sum()
                happened[k] += (off[:, 3 * k : 3 * k + 3] ** 2).sum()
        shares = {name: 100 * float(np.mean(hits)) for name, hits in inside.items()}
        pooled = 100 * float(np.mean([hit for hits in inside.values() for hit in hits]))
        worst = min(shares, key=lambda name: shares[name])
        ratio = np.sqrt(expected / happened)
        table.add_row(
            "unknown" if known is None else "known", "declared" if sigma else "estimated",
            str(len(shares)), f"{pooled:.2f}", f"{shares[worst]:.1f} ({worst}, {len(inside[worst])} fits)",
            f"{ratio[0]:.3f}", f"{ratio[1]:.3f}", f"{hidden:.3f}",
        )  # fmt: skip
    console.print(table)


def predictions(console: Console, count: int = 150) -> None:
    table = Table(title=f"{count} robots, effects found by the search: truth inside 2 std", title_justify="left")
    for head in ("campaigns", "number", "predictions", "position [%]", "rotation [%]", "all [%]", "RMS of error/std"):
        table.add_column(head, justify="left" if head == "campaigns" else "right")
    found: dict[str, list[np.ndarray]] = {}
    for k in range(count):
        what = PREDICTED[k % len(PREDICTED)]
        case = draw_case(PREDICTED_SEED + k, what)
        robot, rows = case.truth.robot, case.rows
        geometry = fit_constants(case.campaign.question, robot, rows, ())
        arm = calibrated_arm(case.campaign.question, robot, rows, (), geometry, SILENT)
        final, q = arm.diagnosed.fit, case.query.readings
        seen = case.train.readings
        unseen = case.query.select(((q >= seen.min(axis=0)) & (q <= seen.max(axis=0))).all(axis=1))
        off = problem(final.model, unseen).residual(final.theta)
        covariance = with_contradicted_noise(final, arm.rows.select(arm.rows.train)).covariance
        solved = SolvedModel(final.model, final.theta, covariance)
        std = solved.std(unseen.readings, unseen.covariates)[:, : off.shape[1]]
        ratio = np.full((len(off), 6), np.nan)
        ratio[:, : off.shape[1]] = off / std
        found.setdefault(what, []).append(ratio)
        found.setdefault("all", []).append(ratio)
    for what, ratios in sorted(found.items(), key=lambda pair: pair[0] == "all"):
        r = np.concatenate(ratios)
        shares = [f"{100 * np.mean(np.abs(part[np.isfinite(part)]) < 2):.1f}" for part in (r[:, :3], r[:, 3:], r)]
        table.add_row(what, str(len(ratios)), str(len(r)), *shares, f"{np.sqrt(np.nanmean(r**2)):.2f}")
    console.print(table)


def frames(console: Console, count: int = 100) -> None:
    table = Table(title=f"{count} true frames of any attitude, hint = identity, 150 noisy rows", title_justify="left")
    for head in ("robot", "set", "kind", "same optimum", "largest difference of a residual [sigma]", "most steps"):
        table.add_column(head, justify="right")
    for name, which in (("arid", "doty"), ("ur10", "full")):
        robot = ROBOTS[name]()
        for kind in ("pose", "position"):
            campaign = campaign_of(robot, which, kind)
            worst, same, steps = 0.0, 0, 0
            for seed in range(count):
                rng = np.random.default_rng([seed, 7])
                attitude = Rotation.random(2, rng=rng).as_matrix()
                world, tip = (
                    pin.SE3(attitude[0], rng.uniform(-5, 5, 3)),
                    pin.SE3(attitude[1], rng.uniform(-0.4, 0.4, 3)),
                )
                truth = truth_of(robot, which, (world, tip))
                theta = WRONG * rng.standard_normal(len(truth.coefficients))
                error = NOISE * rng.standard_normal((150, 6))
                rows = measure(truth, theta, draw_readings(robot, 150, rng), error, kind, (NOISE, NOISE))
                found = solve(campaign, robot, rows)
                known = fit(problem(truth.with_coefficients(found.model.coefficients), rows))
                off = float(np.abs(found.residual - known.residual).max()) / NOISE
                worst, same, steps = max(worst, off), same + (off < 0.05), max(steps, found.convergence.steps)
            table.add_row(name, which, kind, f"{same} of {count}", f"{worst:.2g}", str(steps))
    console.print(table)


def exact(console: Console) -> None:
    table = Table(title="150 rows without noise: largest error of what comes back", title_justify="left")
    for head in (
        "robot",
        "set",
        "frames",
        "coefficients",
        "constants [m, rad]",
        "frames [m, rad]",
        "residual [m, rad]",
    ):
        table.add_column(head, justify="right")
    cases = (("arid", "doty", True), ("arid", "full", True), ("ur10", "full", True), ("ur10", "full", False))
    for name, which, known in cases:
        robot, rng = ROBOTS[name](), np.random.default_rng(3)
        pair = ARID_FRAMES
        truth = truth_of(robot, which, pair)
        readings = draw_readings(robot, 150, rng)
        campaign = campaign_of(robot, which, known=pair if known else None)
        # Only what can be told apart has a truth that can come back: let the rest be nominal.
        perfect = measure(truth, np.zeros(len(truth.coefficients)), readings)
        kept = set(solve(campaign, robot, perfect).model.names)
        theta = np.array([WRONG * rng.standard_normal() * (c.name in kept) for c in truth.coefficients])
        found = recentred(solve(campaign, robot, measure(truth, theta, readings)))
        value = dict(zip(found.model.names, found.theta, strict=True))
        constant = max(abs(value.get(c.name, 0.0) - t) for c, t in zip(truth.coefficients, theta, strict=True))
        placed = [pin.log6(a.inverse() * b[0][1]).vector for a, b in
                  zip(pair, (found.model.world_base, found.model.tip_target), strict=True)]  # fmt: skip
        table.add_row(
            name, which, "known" if known else "unknown", str(len(found.theta)), f"{constant:.1e}",
            "" if known else f"{np.abs(placed).max():.1e}", f"{np.abs(found.residual).max():.1e}",
        )  # fmt: skip
    console.print(table)


def ranks(console: Console) -> None:
    table = Table(title="Coefficients told apart, set full with both frames, 300 rows", title_justify="left")
    for head in ("robot", "joints", "candidates", "poses", "4R+2P+6", "positions", "4R+2P+3"):
        table.add_column(head, justify="right" if head != "robot" else "left")
    robots = {name: make() for name, make in ROBOTS.items()}
    for file, tip in (
        ("panda_description/urdf/panda.urdf", "panda_link8"),
        ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
        ("z1_description/urdf/z1.urdf", "link06"),
        ("so_arm_description/urdf/so101.urdf", "gripper_frame_link"),
        ("tiago_description/robots/tiago.urdf", "arm_tool_link"),
    ):
        if (SHARED_ROBOTS / file).is_file():
            robots[Path(file).stem] = load_robot(SHARED_ROBOTS / file, tip)
    for name, robot in robots.items():
        candidates = tuple(Coefficient(w, c) for w in ("world_base", "tip_target") for c in FRAME_COMPONENTS)
        candidates += constants(robot, "full")
        # Off the last axis: the turn of a point on it could not be seen.
        model = Model(robot, candidates, tip_target=((None, pin.SE3(np.eye(3), np.array([0.11, 0.07, 0.05]))),))
        readings = draw_readings(robot, 300, np.random.default_rng(0))
        zero, told = np.zeros(len(candidates)), []
        for kind in ("pose", "position"):
            asked = problem(model, measure(model, zero, readings, kind=kind))
            whole = triangle(asked, zero, np.ones(300), np.full(len(asked.channels), NOISE))
            told.append(len(identifiable(whole, range(len(candidates))).independent))
        turning = sum(joint.kind == "revolute" for joint in robot.joints)
        sliding = len(robot.joints) - turning
        most = 4 * turning + 2 * sliding
        table.add_row(
            name, f"{turning} R, {sliding} P", str(len(candidates)),
            str(told[0]), str(most + 6), str(told[1]), str(most + 3),
        )  # fmt: skip
    console.print(table)


TABLES: dict[str, Callable[[Console], None]] = {
    "real": real, "coverage": coverage, "predictions": predictions, "frames": frames, "exact": exact, "ranks": ranks,
}  # fmt: skip


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"of {', '.join(TABLES)}; default: all")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.tables if name not in TABLES]
    if unknown:
        parser.error(f"no table {unknown[0]!r}: choose from {', '.join(TABLES)}")
    for name in arguments.tables or TABLES:
        TABLES[name](Console(width=150))
    return 0


if __name__ == "__main__":
    sys.exit(main())
