"""What is known before new rows are measured: a model of all that may be identified, and what the rows so far say of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.sights import Sights
from aridcal.engine.fit.constants import constants, frame_coefficients, frame_labels, station_labels
from aridcal.engine.fit.least_squares import FIRST_NOISE, Fit
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.setup import TIP, Block, Instruments
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import UNIT_SIZES, Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.collisions import Bodies, bodies_of
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.rows.row_facts import ROLES
from aridcal.engine.search.loop import fit_arm, fit_constants, surroundings
from aridcal.files.campaign import Campaign
from aridcal.files.purposes import Box
from aridcal.files.read import load_measurements, with_routes
from aridcal.files.things import (
    InstrumentDeclarations,
    ThingReferences,
    instrument_declarations,
    instruments_of,
    with_trackers,
)
from aridcal.jobs.plan.clearance import ARM_HALF_THICKNESS
from aridcal.jobs.plan.mounting import keeps_above, mounting_side
from aridcal.system.errors import CampaignError, MeasurementError, name_list
from aridcal.system.progress import SILENT, Progress

PLANNED_KINDS = tuple(name for name, kind in MEASUREMENT_KINDS.items() if not kind.of_head)
"""Kinds of measurements that can be planned. What a shot of camera and sonars tells hangs on which squares it shows, and how well
these are found in the image: that is known of images only."""

ANGLES_ALONE = (
    "inclinations tell nothing of lengths: the sigma is what is left of angles, the arm's lengths as in the URDF"
)
"""What the sigma of the target does not hold where directions of gravity are measured."""

GRASP_NOTICE = (
    "planned are postures in which {} and {} hold the body as in the last row, {}: it must not be let go since; taken anew, it "
    "needs a few rows under another label first"
)
"""Of two links that hold one body: only as it was held is it known where these can be."""

KEYS_OF_PLACES = {
    "point": "points: points.csv",
    "distance": "anchors: {NAME: {xyz: [x, y, z]}}",
    "plane": "planes: {NAME: {normal: [x, y, z], offset: o}}",
    "pixels": "cameras: {NAME: {xyz: [x, y, z], rpy: [r, p, y], …}}, markers: {file: markers.csv, xyz: …, rpy: …}",
}
"""What says where the things are that rows of a kind refer to."""

POSTURES_FOR_OVERLAPS = 200
"""Postures of which two shapes that touch in every one overlap by themselves: they say nothing of collisions."""

OFFSET = 3
"""Component of an anchor that may be anything: zero as long as nobody says more."""


class NothingStated(CampaignError):
    """Nobody says where the things are that rows refer to, and no row tells it yet."""


@dataclass(frozen=True)
class PlanSetup:
    """What is known before new rows are planned.

    Attributes:
        campaign: With what is to be measured, how, and what may be identified.
        robot: The nominal chain.
        model: Everything that may be identified, K coefficients; things where they are known to be.
        theta: Coefficients, shape (K,).
        prior: Standard deviation expected of each coefficient by itself, [rad] or [m] per unit of its basis, shape (K,);
            infinite where nothing is expected.
        sigma: Noise of each channel, shape (C,).
        rows: The rows that were fitted, N of them; none where nothing was measured yet.
        weight: Of each row, shape (N,).
        patterns: Rows of which each new one is a copy with other readings: one for every thing that a row may refer to.
        bodies: Shapes of the arm and of boxes that can touch.
        side: Of the mounting plane, on which arm and target are kept, see :func:`mounting_side`; 0 where they are not.
        notices: Assumptions, in words.
    """

    campaign: Campaign
    robot: Robot
    model: Model
    theta: np.ndarray
    prior: np.ndarray
    sigma: np.ndarray
    rows: Dataset
    weight: np.ndarray
    patterns: Dataset
    bodies: Bodies
    side: float
    notices: tuple[str, ...]

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Boxes that the campaign keeps the arm out of."""
        return self.campaign.design.keep_out or ()

    @property
    def kept_out(self) -> str:
        """What the arm is kept out of, in words."""
        if self.boxes:
            return f"kept out of: itself and the {len(self.boxes)} boxes of design.keep_out"
        if self.side:
            plane = f"the mounting plane z = 0 of {self.robot.base}"
            return (
                f"kept out of: itself and {plane}, by {1e3 * ARM_HALF_THICKNESS:.0f} mm (other limits: design.keep_out)"
            )
        return "kept out of: itself alone; floor, tables and walls are not known: state them as design.keep_out"

    def with_coefficients(self, more: tuple[Coefficient, ...], prior: np.ndarray | None = None) -> PlanSetup:
        """The setup with more coefficients that may be identified, perhaps with the standard deviation expected of each."""
        model = self.model.with_coefficients((*self.model.coefficients, *more))
        expected = np.full(len(more), np.inf) if prior is None else prior
        theta = np.concatenate([self.theta, np.zeros(len(more))])
        return replace(self, model=model, theta=theta, prior=np.concatenate([self.prior, expected]))


def beforehand(campaign: Campaign, robot: Robot, progress: Progress = SILENT) -> PlanSetup:
    """The setup of a plan, from the campaign's tables or, before there are any, from the campaign alone.

    Raises:
        AridcalError: new rows of its kind cannot be planned, or something of it needs mending.
    """
    kind = campaign.measurements.kind
    if kind not in PLANNED_KINDS:
        raise CampaignError(
            f"{campaign.path}: measurements.kind: configurations for `kind: {kind}` cannot be planned, as what a shot tells "
            "hangs on the squares in its image; plan for `kind: pose`, with `noise` as `aridcal measure` states it for your "
            f"head, and take those that show a square. Others that can be planned: {name_list(PLANNED_KINDS[1:])}"
        )
    files = [] if campaign.has_other_tables else [path for block in campaign.blocks for path in block.files]
    missing = [path for path in files if not path.exists()]
    remarks = (ANGLES_ALONE,) if MEASUREMENT_KINDS[kind].level else ()
    if not missing:
        setup = _from_rows(campaign, robot, bodies(campaign.design.keep_out or (), robot), progress)
        return replace(setup, notices=(*remarks, *setup.notices))
    if len(missing) < len(files):
        raise MeasurementError(
            f"{missing[0]}: there is no such file, though others of {campaign.path} are there: take it out of the campaign, and "
            "what is there is added to"
        )
    if len(campaign.blocks) > 1:
        raise CampaignError(
            f"{campaign.path}: measurements: nothing was measured yet, and there are several blocks: plan each in a campaign of "
            "its own"
        )
    if MEASUREMENT_KINDS[kind].joins:
        raise CampaignError(
            f"{campaign.path}: measurements.kind: nothing was measured yet, and nothing else says how the body lies in the hands "
            "that hold it: move both arms with it to a few postures, record them, and plan more rows of that grasp"
        )
    setup = from_nothing(campaign, robot, bodies(campaign.design.keep_out or (), robot))
    return replace(setup, notices=(*remarks, *setup.notices))


def bodies(keep_out: Sequence[Box], robot: Robot) -> Bodies:
    """Shapes that can touch each other: those of the arm's links, and a campaign's boxes."""
    boxes = [(np.array(box.min), np.array(box.max)) for box in keep_out]
    return bodies_of(robot, boxes, draw_readings(robot, POSTURES_FOR_OVERLAPS, np.random.default_rng(0)))


def _shape_notices(robot: Robot, bodies: Bodies) -> tuple[str, ...]:
    """A notice where limbs may meet and the URDF has no shapes of them."""
    if not robot.others or bodies.shaped:
        return ()
    return ("the URDF has no collision shapes: whether limbs touch each other is not looked at",)


def _from_rows(campaign: Campaign, robot: Robot, bodies: Bodies, progress: Progress) -> PlanSetup:
    """The setup with frames, constants and declared effects fitted to the rows so far."""
    progress("reading the measurements")
    rows = with_directions(load_measurements(campaign, robot.readings, robot.limits, robot.kinds, robot=robot))
    question = campaign.question
    labels = station_labels(question, rows)
    progress(f"fitting frames and constants to {rows.train.sum()} rows")
    geometry = fit_constants(question, robot, rows, labels, progress)
    fit = geometry.geometric
    if campaign.effects:
        fit = fit_arm(question.without_search(), geometry, rows, progress).diagnosed.fit
    fitted = set(fit.model.names)
    to_identify = tuple(c for c in geometry.geometric.candidates if c.name not in fitted)
    notices = []
    if len(campaign.blocks) > 1:
        notices.append(f"planned are rows of the first block, {campaign.measurements.title}")
    if rows.labels.station is not None and labels:
        notices.append(f"planned are rows at the station of the last row, {rows.labels.station[rows.as_read[-1]]}")
    setup = from_fit(campaign, robot, bodies, fit, to_identify, rows)
    if campaign.measurements.links is not None:
        notices.append(GRASP_NOTICE.format(*campaign.measurements.links, setup.patterns.labels.refers[0, 0]))
    return replace(setup, rows=rows.fitted, weight=fit.weight, notices=(*notices, *setup.notices))


def from_fit(
    campaign: Campaign,
    robot: Robot,
    bodies: Bodies,
    fit: Fit,
    to_identify: tuple[Coefficient, ...],
    rows: Dataset,
) -> PlanSetup:
    """The setup about a fit, before its rows count.

    Args:
        campaign: What is to be measured.
        robot: The nominal chain.
        bodies: Shapes that can touch.
        fit: Of frames and things at the least.
        to_identify: What else may be identified.
        rows: What new rows may refer to.
    """
    return PlanSetup(
        campaign=campaign,
        robot=robot,
        model=fit.model.with_coefficients((*fit.model.coefficients, *to_identify)),
        theta=np.concatenate([fit.theta, np.zeros(len(to_identify))]),
        prior=np.full(len(fit.theta) + len(to_identify), np.inf),
        sigma=fit.sigma,
        rows=rows.select(np.zeros(0, dtype=int)),
        weight=np.zeros(0),
        patterns=patterns_of(rows),
        bodies=bodies,
        side=_side(campaign, robot, rows.readings),
        notices=(*bodies.unread, *_shape_notices(robot, bodies)),
    )


def _side(campaign: Campaign, robot: Robot, readings: np.ndarray) -> float:
    """The side of the mounting plane that plans keep to; none where the campaign says what to keep out of, or rows went below.

    Args:
        campaign: What is to be measured.
        robot: The chain.
        readings: Readings of the rows so far, shape (n, columns).
    """
    if robot.others:  # a torso stands on no plane that its arms could not go below
        return 0.0
    side = mounting_side(robot) if campaign.design.keep_out is None else 0.0
    flanges = tip_frames(robot, readings)[1]
    return side if side and keeps_above(robot, side, readings, flanges).all() else 0.0


def patterns_of(rows: Dataset) -> Dataset:
    """One row for everything that rows of the first block refer to, at the station of the last row, held as there."""
    usable = rows.labels.block == 0
    if rows.blocks[0].traits.joins:
        in_order = rows.as_read[usable[rows.as_read]]
        usable &= rows.labels.refers[:, 0] == rows.labels.refers[in_order[-1], 0]
    if rows.labels.station is not None:
        usable &= rows.labels.station == rows.labels.station[rows.as_read[-1]]
    references = np.full((len(rows), 1), "") if rows.labels.target is None else rows.labels.target[:, None].astype(str)
    references = np.hstack([rows.labels.refers.astype(str), references])
    indices = np.flatnonzero(usable)
    _, first = np.unique(references[usable], axis=0, return_index=True)
    patterns = rows.select(indices[np.sort(first)])
    typical = {
        name: np.full(len(patterns), np.nanmean(v[usable]))
        for name, v in rows.covariates.items()
        if np.isfinite(v[usable]).any()
    }
    return replace(patterns, covariates=typical, relative=None).with_repeats(share=1.0)


def from_nothing(campaign: Campaign, robot: Robot, bodies: Bodies) -> PlanSetup:
    """The setup before any row: the nominal robot, with frames and things where the campaign's hints say."""
    settings = campaign.measurements
    if campaign.question.by_station:
        raise CampaignError(
            f"{campaign.path}: frames: `per: station`: nothing was measured yet, so that no station is known; plan for one, "
            "without this key"
        )
    things = instrument_declarations(campaign)
    refers = _labels_referred(campaign, things)
    labels = _targets(campaign, robot)
    refers, target = np.repeat(refers, max(1, len(labels)), axis=0), np.tile(labels, len(refers))
    middle = np.clip(np.zeros(len(robot.readings)), *robot.limits.T)
    kind, n = settings.traits, len(refers)
    channels = kind.channels
    declared = tuple(getattr(settings.noise, channel.name) for channel in channels)
    sigma = np.array([s or FIRST_NOISE * UNIT_SIZES[c.unit] for s, c in zip(declared, channels, strict=True)])
    turns = np.tile(np.eye(3), (n, 1, 1)) if kind.oriented else None
    rows = dataset(robot.readings, robot.kinds, np.tile(middle, (n, 1)), np.zeros((n, 3)), turns, sigma=sigma.tolist())
    directions = tuple(f"{name}_direction" for name in robot.readings)
    rows = replace(rows, covariates=dict.fromkeys(directions, np.zeros(n))).with_origin(derived=directions)
    if labels or not kind.tracked:
        blocks = (Block(settings.title, settings.kind, channels, tuple(sigma.tolist())),)
        refers = with_trackers(refers, blocks, rows.labels.block, robot.readings)
        instruments = _with_known_places(
            instruments_of(things, [ThingReferences(kind, refers)], robot.readings, False)[0], campaign
        )
        rows = replace(
            rows,
            blocks=blocks,
            observed=np.zeros((n, max(1, len(kind.read)))),
            labels=replace(rows.labels, refers=refers),
            instruments=instruments,
        )
    if labels:
        rows = with_routes(rows.with_labels(target=target), [settings], things, robot)
    question = campaign.question
    coefficients = frame_coefficients(question, (), rows) + constants(robot, question.constants)
    model = Model(
        robot,
        coefficients,
        ((None, question.world_base.at),),
        tuple(
            (label, question.target(label).at) for label in frame_labels("tip_target", question.tip_target, (), rows)
        ),
        instruments=rows.instruments,
        routes=rows.labels.routes,
        target_on=question.target_on,
    )
    environment = surroundings(question, model, loaded=False)
    if labels:
        environment = replace(
            environment, sights=Sights(np.array([frame.translation for _, frame in model.tip_target]))
        )
    model = replace(model, around=environment)
    assumed = [
        f"noise.{c.name} is not said: planned with {s * c.scale:g} {c.shown}"
        for c, declared_sigma, s in zip(channels, declared, sigma.tolist(), strict=True)
        if declared_sigma is None
    ]
    return PlanSetup(
        campaign=campaign,
        robot=robot,
        model=model,
        theta=np.zeros(len(coefficients)),
        prior=np.full(len(coefficients), np.inf),
        sigma=sigma,
        rows=rows.select(np.zeros(0, dtype=int)),
        weight=np.zeros(0),
        patterns=rows,
        bodies=bodies,
        side=_side(campaign, robot, np.zeros((0, len(robot.readings)))),
        notices=(*assumed, *bodies.unread, *_shape_notices(robot, bodies)),
    )


def _targets(campaign: Campaign, robot: Robot) -> list[str]:
    """Labels of the targets that rows of a robot of several limbs measure; none of a robot of one."""
    if not robot.others:
        return []
    settings = campaign.measurements
    if settings.traits.bare or settings.target or not campaign.instruments.targets:
        return [settings.target or TIP]
    return list(campaign.instruments.targets)


def _labels_referred(campaign: Campaign, things: InstrumentDeclarations) -> np.ndarray:
    """Labels of all that rows may refer to, one row for each choice, shape (n, 3)."""
    settings, declared = campaign.measurements, campaign.instruments.declared
    kind = settings.traits
    if kind.tracked or not kind.roles:
        labels = [("", "", "")]
    elif kind.images:
        cameras = [settings.camera] if settings.camera else list(declared["camera"])
        labels = [(camera, things.board_of(camera, marker), marker) for camera in cameras for marker in things.markers]
    else:
        role = kind.roles[0].name
        labels = [(label, "", "") for label in (things.points if role == "point" else declared[role])]
    if not labels:
        raise _nothing_said(campaign)
    return np.array(labels, dtype=str).reshape(-1, ROLES)


def _with_known_places(instruments: Instruments, campaign: Campaign) -> Instruments:
    """The things with their places, offsets of anchors at zero where the campaign does not say them.

    Raises:
        CampaignError: of one of them nobody says where it is.
    """
    things = {}
    for role, of_role in instruments.things.items():
        start = of_role.start.copy()
        if role == "anchor":
            start[:, OFFSET] = np.nan_to_num(start[:, OFFSET])
        if np.isnan(start).any():
            raise _nothing_said(campaign)
        things[role] = replace(of_role, start=start)
    return replace(instruments, things=things)


def _nothing_said(campaign: Campaign) -> NothingStated:
    """The error where rows would refer to things whose places are not known."""
    kind = campaign.measurements.kind
    return NothingStated(
        f"{campaign.path}: instruments: nothing was measured yet, and it is not said where all is that `kind: {kind}` refers "
        f"to; say nearly where: `{KEYS_OF_PLACES[kind]}`"
    )
