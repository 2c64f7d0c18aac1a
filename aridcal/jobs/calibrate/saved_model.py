"""The calibrated model as a file: everything needed to predict, compensate and solve again, in one YAML."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from aridcal import __version__
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.corrections.sights import TARGET, Sights
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS, labelled
from aridcal.engine.inverse.one_pose import Command, InverseKinematics
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.many_rows import short_stretches
from aridcal.engine.model.model import LabelledFrames, Model
from aridcal.engine.robot.chain import Route, check_route, parse_robot, with_limbs
from aridcal.engine.robot.drive import StatedJoints
from aridcal.engine.robot.kinematics import carriers
from aridcal.engine.trust.rival_predictions import Rival, with_rivals
from aridcal.engine.trust.unobservable import with_unobservable
from aridcal.engine.trust.wander import Wander
from aridcal.engine.trust.workspace import OpenCombination, target_std
from aridcal.files.campaign import Campaign
from aridcal.files.measurement_settings import MeasurementSettings
from aridcal.files.query import FramesBy
from aridcal.files.yaml_file import Limits, parse_settings
from aridcal.jobs.calibrate.calibration_file import (
    NOT_OURS,
    CalibrationDocument,
    FramePart,
    Ranges,
    SolvedPart,
    packed,
    read_calibration,
    rivals_document,
    rivals_of,
    unobservable_combinations,
    unobservable_document,
    unpacked,
)
from aridcal.system.errors import AridcalError, CampaignError, RobotError, nearest, shortened
from aridcal.system.reading.user_names import check_path

# libyaml where PyYAML was built with it.
Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

LAYOUT = "lower triangle row by row, float64, little endian, base64"


class _Block(str):
    """Text that is written as a readable block."""


Dumper.add_representer(
    _Block, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", str(text), style="|")
)


@dataclass(frozen=True)
class SolvedModel:
    """A model with its coefficients: theta (K,) and covariance (K, K)."""

    model: Model
    theta: np.ndarray
    covariance: np.ndarray

    def poses(
        self,
        readings: np.ndarray,
        covariates: Mapping[str, np.ndarray] | None = None,
        station: np.ndarray | None = None,
        target: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Predict the target: T_world_target for N configurations.

        Args:
            readings: Shape (N, columns) in the order of ``model.robot.readings``, [rad] or [m].
            covariates: Columns that the effects depend on, each of shape (N,).
            station: Label of each row; needed where a frame is per station.
            target: Label of the target of each row, where stations and targets differ.

        Returns:
            Rotations (N, 3, 3) and positions (N, 3) in [m].

        Raises:
            CovariateNotFound: an effect depends on a column that is not there.
            MeasurementError: a row's station is none of those that were calibrated.
        """
        rows = self.model.rows(readings, covariates, station, target)
        apart = [self.model.poses(self.theta, rows[some]) for some in short_stretches(len(rows))]
        return np.concatenate([R for R, _ in apart]), np.concatenate([p for _, p in apart])

    def std(
        self,
        readings: np.ndarray,
        covariates: Mapping[str, np.ndarray] | None = None,
        station: np.ndarray | None = None,
        target: np.ndarray | None = None,
    ) -> np.ndarray:
        r"""1-sigma of the target in N configurations: the square root of the diagonal of :math:`J \Sigma J^T`.

        J is the target's Jacobian, Sigma the coefficients' covariance; beyond the rows a smooth function has that of its prior.

        Args:
            readings: As for :meth:`poses`.
            covariates: As for :meth:`poses`.
            station: As for :meth:`poses`.
            target: As for :meth:`poses`.

        Returns:
            1-sigma of the position [m] and of the rotation vector [rad], world axes, shape (N, 6).

        Raises:
            CovariateNotFound: an effect depends on a column that is not there.
            MeasurementError: a row's station is none of those that were calibrated.
        """
        rows = self.model.rows(readings, covariates, station, target)
        return target_std(self.model, self.theta, self.covariance, rows)


def calibration_file(path: str | Path) -> Path:
    """The path of `calibration.yaml`, told by itself or by its result folder.

    Raises:
        CampaignError: there is no such file.
    """
    path = Path(path)
    check_path(path, CampaignError)
    path = path / "calibration.yaml" if path.is_dir() else path
    if not path.exists():
        raise CampaignError(f"{path}: there is no such file; `aridcal identify campaign.yaml` writes one")
    return path


@dataclass(frozen=True)
class SavedModel:
    """A calibrated robot as `calibration.yaml` holds it: predicts and commands, without the measurements.

    Attributes:
        geometric: Frames and constants: the best URDF by itself.
        final: Frames, constants and every accepted effect; right as a whole.
        kind: ``pose`` or ``position``.
        gravity: As in the campaign: a vector in the base frame, or ``world``.
        noise: Noise per axis, [m] and [rad].
        ranges: Lowest and highest fitted value of every joint column and covariate that the model depends on.
        record: Other keys of the file: options, data, versions.
        holes: Holes inside those ranges; none in files of versions that did not look for them.
        largest_std: Largest standard deviation of the predicted position [m], and of the rotation [rad], at the fitted rows, all
            three axes together; infinite in such files.
        untold: Combinations of constants that no reading tells, and that move the target.
        recorded: Lowest and highest fitted value of the other numeric columns of the tables, on which nothing depends.
        rivals: Causes that the rows could not tell from the effects; none in files of versions that did not keep them.
        route: Link whose poses are predicted, and the link in whose frame; None: the target in the world.
    """

    geometric: SolvedModel
    final: SolvedModel
    kind: str
    gravity: tuple[float, float, float] | str
    noise: tuple[float, float]
    ranges: dict[str, tuple[float, float]]
    record: dict[str, Any]
    holes: dict[str, Ranges] = field(default_factory=dict)
    largest_std: tuple[float, float] = (np.inf, np.inf)
    untold: tuple[OpenCombination, ...] = ()
    recorded: dict[str, tuple[float, float]] = field(default_factory=dict)
    rivals: tuple[Rival, ...] = ()
    route: Route | None = None

    @property
    def measurements(self) -> MeasurementSettings:
        """Columns and units of the campaign's tables; those of FORMATS, in SI, if the record has no campaign."""
        settings = self.campaign.measurements if self.campaign else MeasurementSettings()
        changes: dict[str, Any] = {"kind": self.kind} | ({"inverted": None} if self.route else {})
        labels = {
            block.columns.get(role.name, role.name)
            for block in (self.campaign.blocks if self.campaign else ())
            if block.kind in MEASUREMENT_KINDS
            for role in labelled(block.kind)
        }
        if labels:  # the measured table itself may be predicted: its labels of instruments are no labels of targets
            changes["ignore"] = (*settings.ignore, *sorted(labels))
        return settings.model_copy(update=changes)

    @cached_property
    def expected(self) -> SolvedModel:
        """The mean over the causes that the rows could not tell apart, with the covariance of the final model.

        Predictions and commands use this model.
        """
        if not self.rivals:
            return self.final
        model, theta, _ = with_rivals(self.final.model, self.final.theta, self.rivals)
        extra = len(theta) - len(self.final.theta)
        return SolvedModel(model, theta, np.pad(self.final.covariance, (0, extra)))

    @cached_property
    def doubted(self) -> SolvedModel:
        """The model :attr:`expected`, its covariance with the differences between those causes: new rows are compared to it."""
        if not self.rivals:
            return self.final
        between = with_rivals(self.final.model, self.final.theta, self.rivals)[2]
        return replace(self.expected, covariance=self.expected.covariance + between)

    @property
    def seen(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest fitted value of every column, whether the final model depends on it or not."""
        return self.recorded | self.ranges

    @cached_property
    def assumed(self) -> dict[str, float]:
        """Middle of the range of each column that only rivals depend on: taken where rows do not have it."""
        names = set(self.expected.model.needs) - set(self.final.model.needs)
        return {name: float(np.mean(self.seen.get(name, (0.0, 0.0)))) for name in sorted(names)}

    def completed(self, covariates: Mapping[str, np.ndarray], rows: int) -> dict[str, np.ndarray]:
        """Covariates of rows, shape (rows,) each, filled up with what is :attr:`assumed`."""
        complete = dict(covariates)
        for name, usual in self.assumed.items():
            values = complete.get(name, np.full(rows, np.nan))
            complete[name] = np.where(np.isnan(values), usual, values)
        return complete

    def of_link(self, link: str, inside: str | None = None) -> SavedModel:
        """The calibration as one that predicts the poses of a link.

        Args:
            link: The link.
            inside: Link in whose frame the poses are; None: the world, or the base where nothing is known in the world.

        Returns:
            A model whose rows need the joints of that path, too; joints that were not calibrated are nominal.

        Raises:
            RobotError: there is no such link, or no joint moves between the two.
        """
        robot = self.final.model.robot
        names = [frame.name for frame in robot.tree.frames if frame.type == pin.FrameType.BODY]
        for name in (link, inside):
            if name is not None and name not in names:
                raise RobotError(
                    f"{robot.path}: no link {shortened(name)!r}{nearest(name, names)}; name one of the URDF's"
                )
        if inside is None and link == robot.base:
            raise RobotError(f"the base {link!r} does not move in the world: name another link")
        route = Route(inside, link)
        check_route(robot, route)
        robot = with_limbs(robot, [limb.tip for limb in robot.others] + [end for end in route if end is not None])
        models = [
            replace(solved, model=replace(solved.model, robot=robot, tip_target=(), routes=(route,)))
            for solved in (self.geometric, self.final)
        ]
        return replace(self, geometric=models[0], final=models[1], kind="pose", route=route)

    def limb(self, link: str) -> SavedModel:
        """The calibration of the chain from the base to a link, as a robot of one limb.

        Effects are the mean over the causes that the rows could not tell apart.

        Raises:
            RobotError: no limb of the calibration ends there, or other limbs change what one of its joints bears.
        """
        ends = [limb.tip for limb in self.final.model.robot.limbs]
        if link not in ends:
            raise RobotError(f"no limb of the calibration ends at {shortened(link)!r}: it has {', '.join(ends)}")
        if len(ends) == 1:
            return self
        models = []
        for solved in (self.geometric, self.expected):
            model, coefficients = solved.model.limb(link)
            models.append(
                SolvedModel(model, solved.theta[coefficients], solved.covariance[np.ix_(coefficients, coefficients)])
            )
        elsewhere = set(self.final.model.robot.readings) - set(models[1].model.robot.readings)
        ranges = {name: pair for name, pair in self.ranges.items() if name not in elsewhere}
        holes = {name: gaps for name, gaps in self.holes.items() if name not in elsewhere}
        return replace(self, geometric=models[0], final=models[1], rivals=(), ranges=ranges, holes=holes)

    @property
    def frames_by(self) -> FramesBy:
        """Columns that select the frames of a row, where there are several."""
        by: FramesBy = self.record.get("frames_by", "station")
        return by

    @property
    def span(self) -> float:
        """Length of the arm from its first joint to the target, with the measured travel of joints that slide, [m]."""
        robot = self.final.model.robot.main
        links = sum(float(np.linalg.norm(step.translation)) for step in robot.onward[1:-1])
        travels = [
            float(np.ptp(self.ranges[name]))
            for j in robot.joints
            if j.kind == "prismatic"
            for name in j.drive.factors
            if name in self.ranges
        ]
        ends = [robot.onward[-1] * frame for _, frame in self.final.model.tip_target]
        return links + sum(travels) + max((float(np.linalg.norm(end.translation)) for end in ends), default=0.0)

    @property
    def scatter(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Sigma per axis of rows about the model, [m] and [rad], and the degrees of freedom behind each.

        In files without it, the noise, as if it had been declared.
        """
        parts = self.record.get("scatter", {})
        pairs = [
            (float(part["sigma"]), float(part["freedom"])) if (part := parts.get(name)) else (noise, np.inf)
            for name, noise in zip(("position", "rotation"), self.noise, strict=True)
        ]
        return (pairs[0][0], pairs[1][0]), (pairs[0][1], pairs[1][1])

    @cached_property
    def wanders(self) -> tuple[Wander, ...]:
        """Processes that joint zeros may follow from place to place; none in files of versions that did not look for them."""
        return tuple(Wander(**process) for process in self.record.get("wander", ()))

    @property
    def limits(self) -> Limits:
        """Limits of the sizes of tables, as the campaign states them."""
        return self.campaign.limits if self.campaign else Limits()

    @property
    def controller_zeros(self) -> Mapping[str, float]:
        """What the controller shows for joints whose readings are zero, [rad] or [m], as the campaign states it; else zero."""
        return self.campaign.robot.controller_zeros if self.campaign else {}

    @cached_property
    def campaign(self) -> Campaign | None:
        """The campaign of the calibration; None where the record has none."""
        text = self.record.get("campaign")
        return parse_settings(text, Path("the campaign in calibration.yaml"), Campaign) if text else None

    @classmethod
    def load(cls, path: str | Path) -> SavedModel:
        """Read `calibration.yaml`, or that of a result folder.

        Raises:
            AridcalError: it is not there, is hostile, or is not a calibration of this format.
        """
        path = calibration_file(path)
        document, record = read_calibration(path)
        try:
            return _restored(document, record)
        except AridcalError as error:
            raise CampaignError(f"{path}: the robot in it: {error}") from None
        except (KeyError, IndexError, ValueError, ArithmeticError) as error:
            reason = f"{type(error).__name__}: {error}"
            raise CampaignError(
                f"{path}: its model cannot be computed ({shortened(reason, 200)}). {NOT_OURS}"
            ) from None

    def command(
        self,
        pose: np.ndarray,
        seed: np.ndarray,
        covariates: Mapping[str, float] | None = None,
        station: str | None = None,
        target: str | None = None,
    ) -> Command:
        """Find the joint readings that bring the real target to a wanted pose, fast enough for a stream of them.

        Args:
            pose: T_world_target, shape (4, 4), [m]; of a calibration from positions only its last column counts.
            seed: Readings to start from, shape (columns,) in the order of ``final.model.robot.readings``, [rad] or [m]:
                what the controller's own inverse kinematics says, or the command before.
            covariates: What the effects depend on beside the joints, temperature or ``JOINT_direction`` for instance.
            station: Label of the frames, where they are per station.
            target: Label of the target, where stations and targets differ.

        Returns:
            The readings, what the model still misses with them, and whether the pose is reached.

        Raises:
            CovariateNotFound: an effect depends on something that is not given.
            MeasurementError: the station is none of those that were calibrated.
        """
        pose = np.asarray(pose, dtype=float)
        return self.inverse_kinematics(station, target).command(
            pose[:3, :3], pose[:3, 3], np.asarray(seed, dtype=float), {**self.assumed, **(covariates or {})}
        )

    @property
    def turns(self) -> bool:
        """True if the target's rotation was measured, not its position alone."""
        return MEASUREMENT_KINDS[self.kind].turns

    def inverse_kinematics(self, station: str | None = None, target: str | None = None) -> InverseKinematics:
        """The solver that brings a target at a station to wanted poses; made once for each."""
        if (station, target) not in self._inverses:
            robot = self.final.model.robot
            turning = np.array([kind != "prismatic" for kind in robot.kinds])
            one_row = OneRowModel(self.expected.model, self.expected.theta, station, target)
            if self.route is not None and self.route.start is not None:
                one_row.moves &= carriers(robot, self.route)
            low, high = np.where(one_row.moves[:, None], robot.limits, (-np.inf, np.inf)).T
            self._inverses[station, target] = InverseKinematics(one_row, low, high, turning, self.turns, self.noise)
        return self._inverses[station, target]

    @cached_property
    def _inverses(self) -> dict[tuple[str | None, str | None], InverseKinematics]:
        return {}

    def dump(self) -> str:
        """The file's text."""
        robot = self.final.model.robot
        encoding = _encoding(robot.urdf + (robot.mjcf or b""))
        document = {
            "format": 1,
            "aridcal": __version__,
            "kind": self.kind,
            "robot": {
                "base": robot.base,
                "tip": robot.tip,
                "gravity": self.gravity if isinstance(self.gravity, str) else list(self.gravity),
                "urdf_name": robot.path.name,
                "urdf_sha256": hashlib.sha256(robot.urdf).hexdigest(),
                "urdf_encoding": encoding,
                **({"joints": dict(robot.stated.joints)} if robot.stated.joints else {}),
                **({"coupled": _plain(robot.stated.coupled)} if robot.stated.coupled else {}),
                **(_paths_document(self.final.model) if robot.others else {}),
                "urdf": _Block(robot.urdf.decode(encoding)),
                **({} if robot.mjcf is None else {"mjcf": _Block(robot.mjcf.decode(encoding))}),
            },
            "noise": {"position": self.noise[0], "rotation": self.noise[1]},
            "ranges": {name: list(pair) for name, pair in self.ranges.items()},
            **({"recorded": {name: list(pair) for name, pair in self.recorded.items()}} if self.recorded else {}),
            "holes": {name: [list(pair) for pair in pairs] for name, pairs in self.holes.items()},
            "largest_std": dict(zip(("position", "rotation"), self.largest_std, strict=True)),
            "geometric": _solved_document(self.geometric),
            "final": _solved_document(self.final),
            **({"untold": unobservable_document(self.untold)} if self.untold else {}),
            **({"rivals": rivals_document(self.rivals)} if self.rivals else {}),
            **self.record,
        }
        return str(yaml.dump(document, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=110))


def frames_document(frames: LabelledFrames) -> list[dict[str, Any]]:
    """Frames as plain data: xyz [m] and quaternion (xyzw), with the station's label."""
    return [
        {"station": label, "xyz": _floats(f.translation), "quaternion": _floats(pin.Quaternion(f.rotation).coeffs())}
        for label, f in frames
    ]


def _solved_document(solved: SolvedModel) -> dict[str, Any]:
    model = solved.model
    std = np.sqrt(np.maximum(np.diag(solved.covariance), 0.0))
    return {
        "world_base": frames_document(model.world_base),
        "tip_target": frames_document(model.tip_target),
        "loads": {
            "gravity": model.around.gravity.tolist(),
            **_payloads_document(model.around.payloads),
            "payload": model.around.loaded,
            **({"targets": model.around.sights.targets.tolist()} if _by_place(model) else {}),
        },
        "coefficients": [
            {
                "name": c.name,
                "where": c.where,
                "component": c.component,
                "basis": {"form": c.basis.form, "of": list(c.basis.of), "numbers": _floats(c.basis.numbers)},
                "station": c.station,
                "value": float(solved.theta[k]),
                "std": float(std[k]),
            }
            for k, c in enumerate(model.coefficients)
        ],
        "covariance": {"layout": LAYOUT, "data": packed(solved.covariance)},
    }


def _payloads_document(payloads: Sequence[Payload]) -> dict[str, Any]:
    """Places of payloads, as plain data."""
    if len(payloads) > 1:
        return {"payloads": [{"at": each.lever.tolist(), "on": each.on, "name": each.name} for each in payloads]}
    (only,) = payloads
    return {"payload_at": only.lever.tolist()} | ({"payload_on": only.on} if only.on else {})


def _paths_document(model: Model) -> dict[str, Any]:
    """Limbs of a robot that has several, the paths of rows, and the links that carry targets, as plain data."""
    return {
        "limbs": [limb.tip for limb in model.robot.others],
        "routes": [list(route) for route in model.routes],
        "targets": dict(model.target_on),
    }


def _by_place(model: Model) -> bool:
    """True if a coefficient depends on where the target is."""
    return any(name in TARGET for c in model.coefficients for name in c.basis.of)


def _restored(document: CalibrationDocument, record: dict[str, Any]) -> SavedModel:
    """The models of a checked file, each tried once: parts that do not fit together show here, and not rows later.

    Raises:
        AridcalError: the URDF has no such chain.
        KeyError, IndexError, ValueError, ArithmeticError: a coefficient has no place in the URDF, or its motion is no number.
    """
    about = document.robot
    without_column = StatedJoints(about.joints, about.coupled)
    robot = parse_robot(about.content, about.tip, about.base, Path(about.urdf_name), stated=without_column)
    robot = replace(robot, mjcf=about.mjcf.encode(about.urdf_encoding)) if about.mjcf is not None else robot
    robot = with_limbs(robot, about.limbs) if about.limbs else robot
    paths: dict[str, Any] = {"routes": tuple(Route(*ends) for ends in about.routes), "target_on": about.targets}
    middle = {name: (low + high) / 2 for name, (low, high) in document.ranges.items()}

    def solved(part: SolvedPart) -> SolvedModel:
        entries = part.coefficients
        coefficients = tuple(Coefficient(e.where, e.component, e.basis.function, e.station) for e in entries)
        loads = part.loads
        sights = Sights(np.array(loads.targets)) if loads.targets else Sights()
        only = Payload(np.array(loads.payload_at), loads.payload_on)
        payloads = tuple(Payload(np.array(each.at), each.on, each.name) for each in loads.payloads) or (only,)
        around = Surroundings(np.array(loads.gravity), payloads, loads.payload, sights)
        model = Model(robot, coefficients, _frames(part.world_base), _frames(part.tip_target), around, **paths)
        theta = np.array([e.value for e in entries], dtype=float)
        solved_model = SolvedModel(model, theta, unpacked(part.covariance.data, len(entries)))
        _try(solved_model, middle)
        return solved_model

    geometric, final = solved(document.geometric), solved(document.final)
    unobservable = unobservable_combinations(document)
    _try(SolvedModel(*with_unobservable(final.model, final.theta, unobservable)), middle)
    rivals = rivals_of(document)
    _try(SolvedModel(*with_rivals(final.model, final.theta, rivals)), middle)
    dependencies = (*robot.readings, *final.model.needs)
    for name in (*document.ranges, *document.holes):
        if name not in dependencies:
            raise ValueError(f"ranges and holes: nothing depends on {shortened(name)!r}{nearest(name, dependencies)}")
    return SavedModel(
        geometric,
        final,
        document.kind,
        about.gravity,
        (document.noise.position, document.noise.rotation),
        document.ranges,
        record,
        document.holes,
        (document.largest_std.position, document.largest_std.rotation),
        unobservable,
        document.recorded,
        rivals,
    )


def _try(solved: SolvedModel, middle: Mapping[str, float]) -> None:
    """Predict one row in the middle of all ranges."""
    model = solved.model
    readings = np.array([[middle.get(name, 0.0) for name in model.robot.readings]])
    covariates = {name: np.array([middle.get(name, 0.0)]) for name in model.needs}
    labels = (None if label is None else np.array([label]) for label in model.first_labels)
    R, p = solved.poses(readings, covariates, *labels)
    if not (np.isfinite(R).all() and np.isfinite(p).all()):
        raise ValueError("a predicted pose is not finite")


def _frames(entries: Sequence[FramePart]) -> LabelledFrames:
    return tuple(
        (e.station, pin.SE3(pin.Quaternion(np.array(e.quaternion)).matrix(), np.array(e.xyz))) for e in entries
    )


def _plain(coupled: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Factors as plain data."""
    return {name: dict(factors) for name, factors in coupled.items()}


def _encoding(urdf: bytes) -> str:
    """utf-8 where that gives the bytes back, else latin-1, which always does."""
    try:
        urdf.decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def _floats(values: Any) -> list[float]:
    return [float(v) for v in values]
