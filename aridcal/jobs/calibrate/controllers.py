"""Exports to controllers: as much of the calibration as each kind of controller takes, and the error that remains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import indent
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from aridcal.engine.corrections.basis import evaluate
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import is_zero, stage_urdf
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable, thin
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import Problem, problem
from aridcal.engine.fit.stages import recentred
from aridcal.engine.instruments.channels import Channel, columns
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, chain_in_urdf
from aridcal.engine.robot.dh import DHTable, doty_yaml, kinematics_yaml, modified_dh, standard_dh, xyz_rpy
from aridcal.engine.rows.dataset import Dataset, with_sigma
from aridcal.engine.trust.regions import Region, Regions, regions
from aridcal.jobs.calibrate.hand_eye import HandEye, camera_frames, carrier, hand_eye
from aridcal.jobs.calibrate.hand_eye_files import write_hand_eye
from aridcal.jobs.calibrate.key_figures import judged_channels, scored
from aridcal.jobs.calibrate.outcome import Outcome, leading
from aridcal.jobs.calibrate.urdf_files import write_urdf

EXPORT_ROWS = 2000  # that an export is fitted to
MAP_POINTS = 401  # of a joint's error curve, at least
POINTS_PER_WAVE = 24  # points in each wave of a harmonic: linear interpolation is then off by 1 % of it at most
BY_REGION, INDEX = "URDF by region", "regions/index.yaml"
REGION_NOTE = (
    "A region's URDF holds where its `middle` is the nearest, each coordinate divided by its `scale` [m, rad]. All go with",
    "the two frames of `URDF by region` in frames.yaml.",
)
LABEL_NOTE = (
    "A region's URDF holds for rows whose `station` is its `label`; that of an empty label, the one model, for all others. All",
    "go with the two frames of `URDF by region` in frames.yaml.",
)
OFFSETS = "joint offsets alone"
LEAST_GAIN = 1e-3  # share of the error below which three digits show no difference
HELD_PRECISION = 1e12  # precision of a coefficient that is held, in units of the noise's own


@dataclass(frozen=True)
class Export:
    """One way to hand the calibration over, and the error that remains.

    Attributes:
        name: ``URDF alone``, ``full model`` and so on.
        files: Its files in the result folder.
        error: RMS error on the held-out rows, or on the fitted ones if none were held out, in the channel that judges: [m] of
            positions.
        apart: RMS distance of its predictions from the full model's on the same rows, [m].
        model: Model of the export, with the two frames fitted to it.
        cameras: Where its cameras are, each in the frame of what carries it.
    """

    name: str
    files: tuple[str, ...]
    error: float
    apart: float
    model: Model = field(repr=False)
    cameras: dict[str, pin.SE3] = field(repr=False)


@dataclass(frozen=True)
class ControllerExports:
    """All exports of a calibration.

    Attributes:
        exports: The least complete first, the full model last; joint offsets and maps only where they gain anything.
        rows: The rows that score them, ``60 held-out rows`` for instance.
        channel: The channel of the error.
        offsets: Joint-zero offsets alone: readings' corrections by name, [rad] or [m]; those that the frames take up
            are absent.
        maps: For joints with an error curve of their own: readings and what to add to them, shape (points,) each.
        with_maps: The fit whose constants go with the maps; None where no joint has a curve.
        calibrated: The chain of ``calibrated.urdf``.
        regions: Constants of each region, where some deviate from the one model; else None.
        hand_eye: Where the cameras are; None where no row is of one.
    """

    exports: tuple[Export, ...]
    rows: str
    channel: Channel
    offsets: dict[str, float]
    maps: dict[str, tuple[np.ndarray, np.ndarray]]
    with_maps: Fit | None
    calibrated: Robot
    regions: Regions | None = None
    hand_eye: HandEye | None = None

    def summary(self) -> str:
        """One line: ``nominal 1.73 mm, URDF alone 0.65, full model 0.16``."""
        figures = [f"{e.name} {self.channel.scale * e.error:.3f}" for e in self.exports]
        return f"{figures[0]} {self.channel.shown}, {', '.join(figures[1:])}"


def controller_exports(outcome: Outcome) -> ControllerExports:
    """Work out the export for each kind of controller.

    Joint-zero offsets alone, and constants that go with the joints' own curves, are fitted anew to the training rows:
    the best under that restriction, with both frames left free.
    """
    m, final = outcome.measurements, outcome.stage("final")
    judging, kind = scored(outcome)
    first = next((k for k in leading(m) if k in judged_channels(outcome)), leading(m)[0])
    part = columns(m.channels)[first]

    def export(name: str, files: tuple[str, ...], stage_fit: Fit, of_regions: Regions | None = None) -> Export:
        cameras, stage_fit = camera_frames(stage_fit), recentred(stage_fit)
        residual = (
            problem(stage_fit.model, m).residual(stage_fit.theta) if of_regions is None else of_regions.residual(m)
        )[judging]
        apart = residual - final.residual[judging]
        if not m.direct:
            apart = (_predicted(stage_fit, m) - outcome.at_target.places)[judging]
        return Export(name, files, _rms(residual[:, part]), _rms(apart[:, :3]), stage_fit.model, cameras)

    offsets = _offsets(outcome)
    with_maps = _with_maps(outcome)
    urdf = ("kinematics.yaml", "dh.yaml", "dh_modified.yaml", "doty.yaml")
    nominal = export("nominal", (), outcome.stage("nominal").fit)
    zeros_alone = export(OFFSETS, ("joint_offsets.yaml",), offsets)
    constants = export("URDF alone", ("calibrated.urdf", *urdf), outcome.stage("geometric").fit)
    exports = [nominal, *([zeros_alone] if _gains(zeros_alone, nominal) else []), constants]
    if with_maps is not None:
        maps = export("+ joint maps", ("joint_maps.urdf", "joint_maps.csv"), with_maps)
        with_maps = with_maps if _gains(maps, constants) else None
        exports += [maps] if with_maps is not None else []
    of_regions = by_region(outcome)
    if of_regions is not None:
        exports.append(export(BY_REGION, (INDEX,), final.fit, of_regions))
    exports.append(export("full model", ("calibration.yaml",), final.fit))
    zeros = dict(zip(offsets.model.names, offsets.theta, strict=True))
    robot = outcome.robot
    return ControllerExports(
        exports=tuple(exports),
        rows=f"{int(judging.sum())} {kind}",
        channel=m.channels[first],
        offsets={name: float(zeros[f"{name}.axis"]) for name in robot.readings if f"{name}.axis" in zeros},
        maps=_curves(outcome, with_maps) if with_maps is not None else {},
        with_maps=with_maps,
        calibrated=chain_in_urdf(robot, stage_urdf(outcome.stage("geometric").fit)),
        regions=of_regions,
        hand_eye=hand_eye(outcome),
    )


def _gains(export: Export, before: Export) -> bool:
    """True of an export that leaves less than one that asks less of a controller: in digits that are shown."""
    return export.error < (1.0 - LEAST_GAIN) * before.error


def by_region(outcome: Outcome) -> Regions | None:
    """Constants of each region; None where the whole workspace has the same."""
    m = outcome.measurements
    return regions(outcome.stage("final").fit, m, ~m.test & ~outcome.outlier, [e.effect for e in outcome.effects])


def write_controllers(outcome: Outcome, handover: ControllerExports, folder: Path) -> None:
    """Write the exports into a result folder; each file that takes comments states the error that remains."""
    robot = outcome.robot

    def write(name: str, text: str, export: str, *notes: str) -> None:
        lines = [*_statement(handover, export), *notes]
        (folder / name).write_text("".join(f"# {line}\n" for line in lines) + text, encoding="utf-8")

    for name, table in tables(robot, handover.calibrated).items():
        write(name, table.text, "URDF alone", *table.notes)
    text = yaml.safe_dump({"joint_offsets": handover.offsets}, sort_keys=False)
    absorbed = [name for name in robot.readings if name not in handover.offsets]
    if any(export.name == OFFSETS for export in handover.exports):
        write(
            "joint_offsets.yaml", text, OFFSETS,
            "To be added to what each joint reads [rad, m]; all else nominal, base and target fitted to that.",
            *([f"Of {', '.join(absorbed)}: none, the base or the target takes it up."] if absorbed else []),
        )  # fmt: skip
    frames: dict[str, Any] = {e.name: _frames(e.model) | _of_cameras(outcome, e.cameras) for e in handover.exports}
    note = "# Where the base stands in the world and the target on the tip, for each export [m, rad].\n"
    if handover.hand_eye is not None:
        note += (
            "# `cameras`: where each is on what carries it, z along its line of sight; `hand eye`: as in hand_eye/.\n"
        )
        frames["hand eye"] = _of_cameras(outcome, {c.name: c.placement for c in handover.hand_eye.places})
        write_hand_eye(handover.hand_eye, robot.base, robot.tip, folder)
    (folder / "frames.yaml").write_text(note + yaml.safe_dump(frames, sort_keys=False, width=200), encoding="utf-8")
    if handover.regions is not None:
        (folder / INDEX).parent.mkdir()
        for region in handover.regions.every:
            write_urdf((folder / INDEX).with_name(f"{region.name}.urdf"), region.fit.model, region.fit.theta)
        text = yaml.safe_dump(index_document(outcome, handover.regions), sort_keys=False, width=200)
        unit = f"`error`: RMS {handover.channel.noun} [{handover.channel.unit}] on a region's held-out rows, or on all."
        write(INDEX, text, BY_REGION, *(REGION_NOTE if handover.regions.by else LABEL_NOTE), unit)
    if handover.with_maps is not None:
        write_urdf(folder / "joint_maps.urdf", handover.with_maps.model, handover.with_maps.theta)
        import pandas as pd  # slow to load, and few calibrations have maps

        rows = [
            pd.DataFrame({"joint": name, "reading": at, "correction": value})
            for name, (at, value) in handover.maps.items()
        ]
        pd.concat(rows).to_csv(folder / "joint_maps.csv", index=False, float_format="%.12g")


@dataclass(frozen=True)
class ControllerTable:
    """Constants of `calibrated.urdf` as one kind of controller reads them.

    Attributes:
        text: YAML; of a robot of several limbs under ``limbs``, each by the link that it leads to.
        notes: Comments above it.
    """

    text: str
    notes: tuple[str, ...]


def tables(nominal: Robot, calibrated: Robot) -> dict[str, ControllerTable]:
    """Tables of link parameters, by file: of each limb from the base outwards, where it has them."""

    def doty(before: Robot, after: Robot) -> ControllerTable:
        return ControllerTable(doty_yaml(after), ())

    def makers(before: Robot, after: Robot) -> ControllerTable:
        return ControllerTable(kinematics_yaml(before, after), ())

    def dh(make: Callable[[Robot], DHTable]) -> Callable[[Robot, Robot], ControllerTable]:
        def made(before: Robot, after: Robot) -> ControllerTable:
            table = make(after)
            return ControllerTable(table.dump(), tuple(table.warnings))

        return made

    makers_by_file = {
        "kinematics.yaml": makers, "dh.yaml": dh(standard_dh), "dh_modified.yaml": dh(modified_dh), "doty.yaml": doty,
    }  # fmt: skip
    return {name: _by_limb(make, nominal, calibrated) for name, make in makers_by_file.items()}


def _by_limb(make: Callable[[Robot, Robot], ControllerTable], nominal: Robot, calibrated: Robot) -> ControllerTable:
    """A table of the chain, or of each limb."""
    if not nominal.others:
        return make(nominal, calibrated)
    parts, notes = (
        [],
        [f"Of each limb, from {nominal.base} to the link that it is named by; joints that limbs share stand in each."],
    )
    for before, after in zip(nominal.limbs, calibrated.limbs, strict=True):
        if not before.joints:
            notes.append(
                f"Of {before.tip} none: no joint moves between it and {before.base}; calibrated.urdf has where it is."
            )
        elif before.climbs:
            notes.append(
                f"Of {before.tip} none: the way from {before.base} climbs, and such tables are of chains outwards."
            )
        else:
            table = make(before, after)
            parts.append(f"  {before.tip}:\n{indent(table.text, '    ')}")
            notes += [f"{before.tip}: {note}" for note in table.notes]
    return ControllerTable("limbs:\n" + "".join(parts) if parts else "limbs: {}\n", tuple(notes))


def index_document(outcome: Outcome, of_regions: Regions) -> dict[str, Any]:
    """Where each region's URDF holds, and its error beside those of the one URDF and the full model."""
    part = columns(outcome.channels)[leading(outcome.measurements)[0]]
    residuals = {
        "urdf_alone": outcome.stage("geometric").residual, "this_urdf": of_regions.residual(outcome.measurements),
        "full_model": outcome.stage("final").residual,
    }  # fmt: skip
    test = outcome.measurements.test & ~outcome.outlier

    def entry(region: Region) -> dict[str, Any]:
        held_out = region.rows & test
        judging = held_out if held_out.any() else region.rows & ~outcome.outlier
        errors = {name: _rms(residual[judging][:, part]) for name, residual in residuals.items() if judging.any()}
        ends = {"middle": region.middle, "low": region.low, "high": region.high}
        values_of = {name: dict(zip(of_regions.by, values.tolist(), strict=True)) for name, values in ends.items()}
        return {
            "urdf": f"{region.name}.urdf",
            **(values_of if region.label is None else {"label": region.label}),
            "rows": {"all": int(region.rows.sum()), "held_out": int(held_out.sum())},
            "error": errors,
        }

    scale = dict(zip(of_regions.by, of_regions.scale.tolist(), strict=True))
    return {"format": 1, "scale": scale, "regions": {region.name: entry(region) for region in of_regions.every}}


def _statement(handover: ControllerExports, name: str) -> list[str]:
    """An export's own error in words."""
    chosen = next(e for e in handover.exports if e.name == name)
    channel = handover.channel
    return [
        f"{name}: {channel.scale * chosen.error:.3f} {channel.shown} RMS {channel.noun} on {handover.rows}, "
        f"{1e3 * chosen.apart:.3f} mm from the full model there.",
        f"All exports: {handover.summary()}.",
    ]


def _frames(model: Model) -> dict[str, dict[str, list[float]]]:
    return {
        where if label is None else f"{where}[{label}]": xyz_rpy(placement)
        for where, frames in (("world_base", model.world_base), ("tip_target", model.tip_target))
        for label, placement in frames
    }


def _of_cameras(outcome: Outcome, cameras: dict[str, pin.SE3]) -> dict[str, Any]:
    """Where cameras are, by name, with what carries each; empty without cameras."""
    places = {name: {"on": carrier(outcome, name)[0], **xyz_rpy(at)} for name, at in cameras.items()}
    return {"cameras": places} if places else {}


def _rms(vectors: np.ndarray) -> float:
    squares = np.sum(vectors**2, axis=1)
    return float(np.sqrt(np.mean(squares[~np.isnan(squares)])))


def _predicted(model_fit: Fit, rows: Dataset) -> np.ndarray:
    """Predicted targets of rows, shape (N, 3), [m]."""
    return model_fit.model.poses(model_fit.theta, problem(model_fit.model, rows).rows)[1]


def _export_problem(outcome: Outcome, model: Model) -> Problem:
    """The problem of a model on some of the fitted rows, at the noise of the calibration."""
    m = outcome.measurements
    rows = with_sigma(m.fitted.select(~outcome.outlier[m.train]), outcome.noise.tolist())
    whole = problem(model, rows)
    return whole.select(thin(whole.rows, EXPORT_ROWS))


def _offsets(outcome: Outcome) -> Fit:
    """Fit of both frames and the joints' zeros, nothing else."""
    nominal = outcome.stage("nominal").fit.model
    candidates = outcome.stage("geometric").fit.candidates
    beside = {"world_base", "tip_target", *nominal.instruments.names}
    frames = tuple(c for c in candidates if c.basis.constant and c.where in beside)
    robot = outcome.robot
    model = nominal.with_coefficients(
        (*frames, *(Coefficient(name, "axis") for name in robot.readings if name in robot.names))
    )
    if not model.coefficients:
        return outcome.stage("nominal").fit
    return fit_identifiable(_export_problem(outcome, model), range(len(model.coefficients)))


def _own(c: Coefficient) -> bool:
    """True for what moves a joint along its axis as a function of its own position."""
    return c.component == "axis" and c.basis.of == (c.where,)


def _with_maps(outcome: Outcome) -> Fit | None:
    """Fit of the constants that go with the joints' own curves when all other effects are left out."""
    final, geometric = outcome.stage("final").fit, outcome.stage("geometric").fit
    curves = [k for k, c in enumerate(final.model.coefficients) if _own(c)]
    if not curves:
        return None
    coefficients = final.model.coefficients
    constants = [k for k, c in enumerate(coefficients) if c.basis.constant or is_zero(c, outcome.robot) or _own(c)]
    if len(constants) == len(coefficients):
        return final
    model = final.model.with_coefficients([coefficients[k] for k in constants])
    theta = final.theta[constants]
    held = np.array([_own(c) for c in model.coefficients])
    fit_problem = _export_problem(outcome, model)
    precision = HELD_PRECISION * len(fit_problem) / float(geometric.sigma.min()) ** 2
    prior = Prior(theta, np.diag(np.where(held, precision, 0.0)))
    return fit(fit_problem, theta, np.ones(len(fit_problem)), prior)


def _curves(outcome: Outcome, maps_fit: Fit) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Correction of each joint with a curve of its own, over the range measured; shape (points,) each."""
    robot = outcome.robot
    positions = robot.positions(outcome.measurements.readings)
    curves = {}
    for joint, at in zip(robot.joints, positions.T, strict=True):
        coefficients = [k for k, c in enumerate(maps_fit.model.coefficients) if _own(c) and c.where == joint.name]
        if not coefficients:
            continue
        order = max(
            (
                c.basis.numbers[0]
                for k in coefficients
                if (c := maps_fit.model.coefficients[k]).basis.form in ("sin", "cos")
            ),
            default=0.0,
        )
        count = max(MAP_POINTS, int(POINTS_PER_WAVE * order * (np.nanmax(at) - np.nanmin(at)) / (2.0 * np.pi)) + 1)
        points = np.linspace(np.nanmin(at), np.nanmax(at), count)
        phi = np.array([evaluate(maps_fit.model.coefficients[k].basis, {joint.name: points}) for k in coefficients])
        curves[joint.name] = points, maps_fit.theta[coefficients] @ phi
    return curves
