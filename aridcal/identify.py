"""The main job: campaign in; calibrated URDF, figures and pictures out.

Example:
    aridcal identify identification/arid/campaign.yaml
    aridcal identify campaign.yaml --verify another_day.csv
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from aridcal.arm import bind, fit_arm, fit_constants
from aridcal.arm_and_head import fit_arm_and_head, with_head
from aridcal.campaign import Campaign, load_campaign
from aridcal.commands import CommandParser, atomic_folder, check_writable, command_parser, run
from aridcal.errors import CampaignError, MeasurementError
from aridcal.explain import explain, refitted, verdict
from aridcal.export import stage_urdf, write_results
from aridcal.geometry import Geometry, observations, recentred, unused_links
from aridcal.handover import hand_over, write_controllers
from aridcal.measurements import Measurements, load_measurements
from aridcal.outcome import Outcome, Stage, Verification, errors
from aridcal.quality import FAR, halves, joint_kinds, joint_limits, outliers, precision, realigned, repeats
from aridcal.report import write_report
from aridcal.residual import distance, predict_residuals, robust_sigma, scaled, unscaled
from aridcal.robot import load_robot, parse_robot
from aridcal.scene import Scene, write_scene
from aridcal.sighted import CACHE, read_shots
from aridcal.solver import Data, Fit, Noise, fit
from aridcal.traces import trace
from aridcal.whiteness import clues, noise_notice

Progress = Callable[[str], None]
STILL = 1e-3  # a joint that moves by less than this does not move, [rad] or [m]


def identify(
    path: Path,
    seed: int = 0,
    verify: Path | None = None,
    progress: Progress = lambda _: None,
    cache: Path | None = None,
) -> Outcome:
    """Run a campaign up to its outcome; nothing is written.

    Args:
        path: ``campaign.yaml``.
        seed: Of the split into train and test, where the table has none.
        verify: Another day's table, to be scored.
        progress: Called with what is being done.
        cache: ``fiducials.csv`` of an earlier run on the same images, if there is one.

    Raises:
        AridcalError: whatever in the input needs mending.
    """
    started = time.perf_counter()
    campaign = load_campaign(path)
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base)
    progress("reading the measurements")
    shots, both = None, None
    if campaign.measurements.kind == "camera_sonar":
        if verify is not None:
            raise CampaignError(f"{path}: --verify needs a table of poses; `kind: camera_sonar` has shots")
        shots = read_shots(campaign, robot, cache, seed, progress)
        campaign, rows = shots.campaign, shots.rows
    else:
        rows = load_measurements(campaign, robot.readings, joint_limits(robot), joint_kinds(robot), seed)
    rows, notices = _check_stations(campaign, rows)
    labels = _labels(campaign, rows)
    train = ~rows.test
    notices += _check_motion(campaign, rows, train)
    declared = campaign.measurements.noise
    if shots is not None:
        both = fit_arm_and_head(shots, rows, robot, labels, progress)
        campaign, arm, rows = both.campaign, both.arm, both.arm.rows
        stale = np.zeros(len(rows), dtype=bool)
    else:
        stale = stale_rows(rows)
        progress(f"fitting frames and constants to {train.sum()} rows")
        arm = fit_arm(campaign, fit_constants(campaign, robot, rows, labels, stale), rows, stale, progress)
    noise, geometric, bound, diagnosed = arm.noise, arm.geometry.geometric, arm.bound, arm.diagnosed
    progress("scoring")
    stages, outlier = _stages(campaign, rows, arm.geometry, diagnosed.fit, noise, stale)
    final, kept = stages[-1].fit, rows.select(~outlier)
    repeated = repeats(robot, kept, stages[-1].residual[~outlier])
    questions = clues(
        scaled(stages[-1].residual, observations(rows, declared.rows))[~outlier], kept.readings,
        kept.covariates.get("time"), repeated, noise, _freedom(final),
    )  # fmt: skip
    every = bind(campaign, geometric, rows, stale)
    diagnosis = explain(diagnosed, every, rows.test & ~outlier, questions)
    used = bind(campaign, geometric, kept, stale[~outlier])
    traces = trace(final, used, *(s.residual[~outlier] for s in stages[1:]))
    said, unexplained = verdict(questions, diagnosed, _freedom(final) > 0.5)
    # A model of hundreds of coefficients is not fitted twice more: its constants speak for it.
    compared = final if len(final.theta) < 120 else geometric
    apart = halves(compared, bound.train, bound.data(compared.model), noise)
    stated = noise.declared_position and (noise.declared_rotation or rows.quaternion is None)
    source = "declared" if stated else "estimated"
    outcome = Outcome(
        campaign=campaign,
        robot=robot,
        measurements=rows,
        stages=stages,
        outlier=outlier,
        stale=stale,
        noise=final.sigma,
        noise_source=source,
        repeats=repeated,
        precision=precision(final, bound.train, bound.data(final.model), apart),
        verdict=said,
        unexplained_fraction=unexplained,
        notices=(
            *notices,
            *noise_notice(final.estimated, noise, final.freedom, rows.quaternion is not None),
            *unused_links(robot, campaign.parameters.set),
            *(str(n) for n in rows.notices),
        ),
        seconds=0.0,
        traces=traces,
        diagnosis=diagnosis,
    )
    if both is not None and shots is not None:
        outcome = with_head(outcome, both, shots)
    if verify is not None:
        outcome = replace(outcome, verification=_verify(outcome, verify))
    return replace(outcome, seconds=time.perf_counter() - started)


def _freedom(fit: Fit) -> float:
    """Share of the numbers measured that is left after fitting."""
    used = fit.weight.sum() * fit.residual.shape[1]
    return float(1.0 - fit.spent / max(used, 1.0))


def _check_motion(campaign: Campaign, rows: Measurements, train: np.ndarray) -> tuple[str, ...]:
    """Refuse rows that can tell nothing whatever the model, and name the joints that never move."""
    title = str(rows.files[0])
    if not train.any():
        raise MeasurementError(f"{title}: every row is kept for the test: mark some as `train` in the column `split`")
    frames = campaign.frames
    constant = frames.world_base.identify or frames.tip_target.identify or campaign.parameters.set != "none"
    if not (constant or campaign.effects or campaign.diagnosis.enabled):
        raise CampaignError(
            f"{campaign.path}: nothing is to be identified: both frames have `identify: false`, `parameters` has "
            "`set: none`, and no effect is declared or sought. Change one of them"
        )
    travel = np.ptp(rows.readings[train], axis=0)
    still = [name for name, moved in zip(rows.names, travel, strict=True) if moved < STILL]
    if len(still) == len(rows.names):
        count = train.sum()
        why = "there is only one row to fit" if count == 1 else f"no joint moves in any of its {count} rows"
        raise MeasurementError(f"{title}: {why}: nothing can be identified. Measure other configurations")
    return tuple(f"{name} never moves: its parameters cannot be told from its neighbours'" for name in still)


def stale_rows(rows: Measurements) -> np.ndarray:
    """Rows whose measured pose equals the row before bit for bit although the joints moved, shape (N,)."""
    pose = rows.position if rows.quaternion is None else np.hstack([rows.position, rows.quaternion])
    same = (np.diff(pose, axis=0) == 0).all(axis=1)
    moved = (np.diff(rows.readings, axis=0) != 0).any(axis=1)
    neighbours = (np.diff(rows.line) == 1) & (np.diff(rows.file) == 0)
    return np.concatenate([[False], same & moved & neighbours])


def _stages(
    campaign: Campaign, rows: Measurements, geometry: Geometry, final: Fit, noise: Noise, stale: np.ndarray
) -> tuple[tuple[Stage, ...], np.ndarray]:
    """Every stage fitted with the final model's flags, and the flags of all rows."""
    train = ~rows.test
    fits = []
    for name, found in (("nominal", geometry.nominal), ("geometric", geometry.geometric), ("final", final)):
        if not np.array_equal(found.outliers, final.outliers):
            data = _data(campaign, found, rows.select(train), stale[train])
            again = fit(found.model, data, noise, found.theta, weight=final.weight)
            found = replace(again, candidates=found.candidates, redundant=found.redundant)
        fits.append((name, recentred(found)))
    measured = observations(rows, campaign.measurements.noise.rows)
    stages = tuple(
        Stage(
            name, found, predict_residuals(found.model, found.theta, _data(campaign, found, rows, stale).rows, measured)
        )
        for name, found in fits
    )
    return stages, outliers(train, final.outliers, [scaled(s.residual, measured) for s in stages])


def _data(campaign: Campaign, found: Fit, rows: Measurements, stale: np.ndarray) -> Data:
    measured = observations(rows, campaign.measurements.noise.rows)
    return Data(found.model.rows(rows.readings, rows.covariates, rows.station), measured, stale)


def _labels(campaign: Campaign, rows: Measurements) -> tuple[str, ...]:
    per_station = "station" in (campaign.frames.world_base.per, campaign.frames.tip_target.per)
    return tuple(sorted({str(s) for s in rows.station})) if per_station and rows.station is not None else ()


def _check_stations(campaign: Campaign, rows: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """A station with test rows alone has no frame: give them to train, or refuse the split if it is the user's."""
    labels = _labels(campaign, rows)
    if rows.station is None or not labels:
        return rows, ()
    lone = sorted(set(labels) - {str(s) for s in rows.station[~rows.test]})
    if not lone:
        return rows, ()
    if rows.split_given:
        raise MeasurementError(f"station {lone[0]!r} has only `test` rows: its frame cannot be identified")
    test = rows.test & ~np.isin(rows.station.astype(str), lone)
    return replace(rows, test=test), (
        f"all rows of station {', '.join(lone)} were needed for its frame: none tests it",
    )


def _verify(outcome: Outcome, path: Path) -> Verification:
    """Score another table with the models as they are, and with the two frames fitted anew."""
    campaign, robot = outcome.campaign, outcome.robot
    rows = load_measurements(campaign, robot.readings, joint_limits(robot), joint_kinds(robot), files=[path])
    measured = observations(rows, campaign.measurements.noise.rows)
    residuals = {}
    for stage in outcome.stages:
        model = stage.fit.model
        prepared = model.rows(rows.readings, rows.covariates, rows.station)
        residuals[stage.name] = predict_residuals(model, stage.fit.theta, prepared, measured)
    again = realigned(outcome.stage("final").fit, _data(campaign, outcome.stage("final").fit, rows, stale_rows(rows)))
    outlier = distance(again, robust_sigma(again)) > FAR
    return Verification(path.name, rows, residuals, outlier, unscaled(again, measured))


VERDICTS = {
    "noise_floor": "what remains is consistent with the noise",
    "structure_remains": "something repeatable remains",
    "not_enough_data": "too few data for this model",
}


def summary(outcome: Outcome, console: Console) -> None:
    """Print the figures that matter."""
    pose = outcome.measurements.quaternion is not None
    parts = outcome.parts()
    name = "test" if parts["test"].any() else "train"
    n = parts[name].sum()
    table = Table(title=f"error on {n} rows {'never used' if name == 'test' else 'used'}", title_justify="left")
    table.add_column("model", no_wrap=True)
    for head in ("RMS", "p95", "max"):
        table.add_column(f"{head}, mm", justify="right")
    for head in ("RMS", "p95") if pose else ():
        table.add_column(f"{head}, mrad", justify="right")
    for stage in outcome.stages:
        e = errors(stage.residual, parts[name])
        cells = [f"{e['position_mm'][k]:.3f}" for k in ("rms", "p95", "max")]
        cells += [f"{e['rotation_mrad'][k]:.3f}" for k in ("rms", "p95")] if pose else []
        table.add_row(stage.name, *cells)
    console.print(table)
    for effect in outcome.effects:
        found = "declared" if effect.declared else "found"
        rms = [
            1e3 * float(np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1))))
            for r in (effect.before, effect.after)
            if len(r)
        ]
        gain = f": {rms[0]:.3f} mm without it, {rms[1]:.3f} mm with it" if rms else ""
        console.print(f"{found}: {effect.effect.label} [{', '.join(effect.effect.motion)}]{gain}", markup=False)
    if outcome.diagnosis is not None and outcome.diagnosis.tested:
        console.print(f"{outcome.diagnosis.tested:,} candidates tested in all", markup=False)
    if outcome.verification is not None:
        v = outcome.verification
        sound = ~v.outlier
        scored = ((name, errors(r, sound)["position_mm"]["rms"]) for name, r in v.residuals.items())
        figures = ", ".join(f"{name} {value:.3f} mm" for name, value in scored)
        gross = f" ({v.outlier.sum()} gross outliers left out)" if v.outlier.any() else ""
        console.print(f"{v.file}, {sound.sum()} rows of another day{gross}: {figures}", markup=False)
        if v.realigned is not None:
            rest = errors(v.realigned, sound)["position_mm"]["rms"]
            console.print(f"  with both frames fitted anew: {rest:.3f} mm", markup=False)
    console.print(f"verdict: {outcome.verdict}: {VERDICTS[outcome.verdict]}", markup=False)
    for notice in outcome.notices[:8]:
        console.print(f"note: {notice}", markup=False)


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("identify", __doc__)
    arguments.add_argument("campaign", type=Path, help="campaign.yaml")
    arguments.add_argument("--out", type=Path, help="result folder (default: results/ beside the campaign)")
    arguments.add_argument("--verify", type=Path, metavar="CSV", help="another day's measurements to score")
    arguments.add_argument("--seed", type=int, default=0, help="of the train/test split, where the table has none")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> None:
    console = Console()
    out = arguments.out or arguments.campaign.parent / "results"
    check_writable(out, "folder")
    steps = Console(stderr=True)
    started = time.perf_counter()

    def progress(step: str) -> None:
        steps.print(f"[dim]{time.perf_counter() - started:5.1f} s  {step}[/dim]")

    outcome = identify(arguments.campaign, arguments.seed, arguments.verify, progress, out / CACHE)
    with atomic_folder(out, replaces={"model.urdf", "fiducials.csv", "joint_maps.urdf", "joint_maps.csv"}) as folder:
        progress("writing the results")
        write_results(outcome, folder)
        handover = hand_over(outcome)
        write_controllers(outcome, handover, folder)
        write_report(outcome, folder / "report.html")
        notices = write_scene(scene(outcome), folder / "scene.html")
    summary(outcome, console)
    console.print(f"what controllers can be given, RMS on {handover.rows}:\n  {handover.summary()}", soft_wrap=True)
    for notice in notices:
        console.print(f"note: {notice}", markup=False)
    console.print(f"report: {out / 'report.html'}", soft_wrap=True, markup=False, highlight=False)


def scene(outcome: Outcome) -> Scene:
    """What the picture shows: nominal and calibrated robot, measured targets, and every stage's prediction."""
    fit, m, robot = outcome.stage("final").fit, outcome.measurements, outcome.robot
    rows = fit.model.rows(m.readings, m.covariates, m.station)
    T_world_base = np.array([frame.homogeneous for _, frame in fit.model.world_base])[rows.world]
    calibrated = parse_robot(stage_urdf(outcome.stage("geometric").fit), robot.tip, robot.base, robot.path)
    predicted = {stage.name: m.position - stage.residual[:, :3] for stage in outcome.stages}
    whole = fit.model.poses(fit.theta, rows)[1]
    constant = np.array([c.basis.constant for c in fit.model.coefficients], dtype=bool)
    moved = {}
    for e in outcome.effects:
        own = {c.name for c in e.effect.coefficients}
        gone = np.array([name in own for name in fit.model.names], dtype=bool)
        if gone.any():
            moved[e.effect.label] = whole - fit.model.poses(refitted(fit, gone, constant), rows)[1]
    gravity = np.atleast_2d(fit.model.around.gravity)[0]
    return Scene(
        robot, calibrated, m.readings, T_world_base, m.position, predicted, m.test, outcome.outlier, m.line, gravity,
        moved, outcome.precision.places, outcome.precision.reach,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
