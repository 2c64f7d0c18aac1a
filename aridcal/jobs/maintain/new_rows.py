"""New rows for a calibration that is there already: of its own instrument, or of another with a campaign of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from aridcal.engine.corrections.labels import label_in
from aridcal.engine.corrections.regional_kind import labels_of
from aridcal.engine.fit.tails import Tails
from aridcal.engine.instruments.channels import Channels
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.setup import TIP, Instruments
from aridcal.engine.robot.drive import NO_STATEMENTS
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import REFERRING, Campaign, Frames, RobotSettings
from aridcal.files.counting import check_joints
from aridcal.files.instrument_settings import InstrumentSettings
from aridcal.files.orientations import column_of
from aridcal.files.quantities import POSITION_COLUMNS
from aridcal.files.read import ONE_TARGET, default_target, load_measurements
from aridcal.files.tables import AnyTable, read_tables
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import CampaignError, MeasurementError, name_list
from aridcal.system.reading.user_names import check_path

FEWEST_NEW_ROWS = 3
"""Rows below which nothing is said: two poses cannot tell a turn of the base from one of a joint."""

MOST_NEW_NUMBERS = 1200
"""Numbers measured, 200 poses, beyond which `aridcal identify` is the better answer; the matrices here grow with their square."""

LEAST_SIGMA = 1e-6
"""[m] and [rad] of noise that no row has less of: no arm repeats to a micrometre, and exact rows, of a simulation for instance,
would make matrices that no computer solves beside changes of metres."""

CAMPAIGN_ENDINGS = (".yaml", ".yml")
"""Endings of a campaign of new rows, beside tables."""


class NewMeasurements(Campaign):
    """What another instrument measured of a robot that was calibrated already: `measurements`, `instruments`, `frames`.

    Of `frames` only keys that are written count: a frame with ``identify: true``, the default, is unknown and fitted with these
    rows; one with ``false`` is where the campaign says. Frames that are not written are as calibrated.
    """

    robot: RobotSettings = RobotSettings.model_construct(urdf=Path(), tip="")
    """That of the calibration; a campaign that names another tip is refused."""


@dataclass(frozen=True)
class NewRows:
    """New rows, and which frames of the calibration do not hold for them.

    Attributes:
        rows: N of them.
        frames: Of the new rows' own campaign, where those that are not set are as calibrated; None of rows of the calibration's.
    """

    rows: Dataset
    frames: Frames | None = None


@dataclass(frozen=True)
class NewRowNoise:
    """Noise of the rows, as declared or as the calibration's own rows scattered.

    Attributes:
        sigma: Of each channel per axis, shape (C,), in its unit.
        freedom: Numbers that each was estimated from, shape (C,); infinite where it was declared.
        tails: Of each channel, if it has any; none: of no channel.
    """

    sigma: np.ndarray
    freedom: np.ndarray
    tails: tuple[Tails | None, ...] = ()

    @property
    def core(self) -> tuple[np.ndarray, np.ndarray]:
        """Scale of each channel's noise, and the degrees of freedom of its tails, infinite without any, shape (C,) each."""
        tails = self.tails or (None,) * len(self.sigma)
        scale = [s if t is None else max(t.sigma, LEAST_SIGMA) for s, t in zip(self.sigma.tolist(), tails, strict=True)]
        return np.array(scale), np.array([np.inf if t is None else t.freedom for t in tails])


def freedom_of(noise: NewRowNoise, counts: np.ndarray) -> float:
    r"""Degrees of freedom of a mean square over all channels: :math:`n^2 / \sum_c n_c^2 / \nu_c` (Satterthwaite 1946).

    Args:
        noise: Of C channels.
        counts: Numbers n_c measured in each, shape (C,).
    """
    return float(counts.sum() ** 2 / max(float(np.sum(counts**2 / noise.freedom)), 1e-12))


def read_new_rows(saved: SavedModel, table: AnyTable) -> NewRows:
    """Read new rows of a calibrated robot.

    Args:
        saved: The calibration.
        table: Rows in the columns and units of the calibration's own campaign, of one of its instruments or of the target; or
            the path of a campaign of another instrument (:class:`NewMeasurements`).

    Raises:
        CampaignError: the calibration does not say how its tables are written, or the campaign needs mending.
        MeasurementError: the table cannot be read, lacks columns, or has too few or too many rows.
    """
    new_instrument = isinstance(table, str | Path) and Path(table).suffix.lower() in CAMPAIGN_ENDINGS
    campaign = _other(saved, Path(str(table))) if new_instrument else _own(saved, table)
    robot = saved.final.model.robot
    rows = load_measurements(
        campaign,
        robot.readings,
        robot.limits,
        robot.kinds,
        robot=robot,
        files=None if new_instrument else [table],
        fitted=False,
    )
    rows = _with_targets(saved, with_directions(rows), new_instrument)
    _refuse_unknown_labels(saved, rows)
    numbers = sum(int(rows.measures[:, c].sum()) * channel.size for c, channel in enumerate(rows.channels))
    too_many = (
        ""
        if numbers <= MOST_NEW_NUMBERS
        else f"; more than {MOST_NEW_NUMBERS} numbers are a campaign of their own: `aridcal identify`"
    )
    if len(rows) < FEWEST_NEW_ROWS or too_many:
        raise MeasurementError(
            f"{rows.title}: {len(rows)} usable rows: 5 to 20 in attitudes that differ are asked for{too_many}"
        )
    return NewRows(rows, campaign.frames if new_instrument else None)


def _refuse_unknown_labels(saved: SavedModel, rows: Dataset) -> None:
    """Refuse rows of a station without constants of its own, where constants vary by station: it would look like a change."""
    allowed = [label_in(name) for name in labels_of(c.basis for c in saved.final.model.coefficients)]
    stations = [""] if rows.labels.station is None else np.unique(rows.labels.station).tolist()
    strangers = [label for label in stations if label not in allowed] if allowed else []
    if strangers:
        what = f"station {strangers[0]!r} is none" if strangers[0] else "the rows' `station` is none"
        raise MeasurementError(
            f"{rows.title}: {what} of those by which the calibration's constants vary ({name_list(allowed)}), and what it "
            "deviates by is not known; take rows of these, or calibrate again with rows of all"
        )


def _other(saved: SavedModel, path: Path) -> Campaign:
    """The campaign of rows of another instrument, checked against the calibration."""
    check_path(path, CampaignError)
    campaign = load_settings(path, NewMeasurements)
    tip = saved.final.model.robot.tip
    if "robot" in campaign.model_fields_set and campaign.robot.tip != tip:
        raise CampaignError(
            f"{path}: robot.tip: {campaign.robot.tip!r} is not the tip that was calibrated, {tip!r}; delete the key `robot`"
        )
    calibrated = saved.final.model.robot.stated
    if campaign.robot.stated not in (NO_STATEMENTS, calibrated):
        raise CampaignError(
            f"{path}: robot.joints and robot.coupled: are not those that were calibrated; delete the key `robot`"
        )
    for number, block in enumerate(campaign.blocks):
        check_joints(
            block, f"{path}: {campaign.place(number)}", saved.final.model.robot.readings, saved.final.model.robot.kinds
        )
    if any(block.traits.of_head for block in campaign.blocks):
        raise CampaignError(
            f"{path}: measurements.kind: camera_sonar is not read here; `aridcal measure` makes a table of poses from its "
            "images: name that, with `kind: pose`"
        )
    ties = [key for key in ("lengths", "perpendicular") if key in campaign.instruments.model_fields_set]
    if ties:
        raise CampaignError(
            f"{path}: instruments.{ties[0]}: what is known between things is not used with a calibration that has its scale "
            "already; delete this key"
        )
    varying = [name for name in ("world_base", "tip_target") if getattr(campaign.frames, name).per is not None]
    if varying:
        raise CampaignError(f"{path}: frames.{varying[0]}.per: new rows have one frame each; delete this key")
    return campaign.model_copy(
        update={"robot": campaign.robot.model_copy(update={"joints": calibrated.joints, "coupled": calibrated.coupled})}
    )


def _own(saved: SavedModel, table: AnyTable) -> Campaign:
    """The calibration's own campaign, for rows of its target or of the instruments that its table has columns of."""
    campaign = saved.campaign
    if campaign is None:
        raise CampaignError(
            "calibration.yaml holds no campaign, so that nobody knows its tables' columns and units; run "
            "`aridcal identify` again"
        )
    robot, settings = saved.final.model.robot, saved.measurements
    position_columns = {column_of(name, settings, robot.readings) for name in POSITION_COLUMNS}
    joints = [settings.columns.get(name, name) for name in robot.readings]
    names = set(read_tables([table], None, saved.limits.table, settings.table.dialect, joints).names)
    per_target = saved.frames_by != "station"
    referring = any(block.kind in REFERRING or block.traits.level for block in campaign.blocks)
    if not per_target and (position_columns <= names or not referring):
        changes: dict[str, Any] = {"listed": (), "measurements": settings, "instruments": InstrumentSettings()}
        return campaign.model_copy(update=changes)
    tables = list(campaign.instruments.tables)
    missing = [path for path in tables if not path.exists()]
    if missing:
        raise CampaignError(
            f"{missing[0]}: there is no such file, and the calibration's campaign names it for its instruments; write a campaign "
            "with `measurements` and `instruments` beside the new table, and name that in place of the table"
        )
    return campaign


def _with_targets(saved: SavedModel, rows: Dataset, new_instrument: bool) -> Dataset:
    """The rows with a label of their target, or without where all are of the only target of the calibration.

    Raises:
        MeasurementError: the calibration has several targets, and a row does not say which it is of.
    """
    labels = [label for label, _ in saved.final.model.tip_target]
    if rows.labels.target is None and not rows.direct and new_instrument:
        names = [default_target(b.traits, b.name) for b in rows.blocks]
        rows = rows.with_labels(target=np.array(names)[rows.labels.block])
    if rows.labels.target is None and saved.frames_by != "station":
        several = name_list([str(label) for label in labels])
        raise MeasurementError(
            f"{rows.title}: the calibration has several targets ({several}); add a column `target` that says which each row is of"
        )
    if labels != [None] or rows.labels.target is None:
        return _plain(rows)
    references = {TIP, *(b.name for b in rows.blocks if b.traits.level)}
    targets = sorted(set(rows.labels.target.tolist()) - references)
    if not new_instrument and len(targets) == 1:  # the calibration does not keep the name of its only target
        rows = rows.with_labels(target=np.where(rows.labels.target == targets[0], ONE_TARGET, rows.labels.target))
    unlabelled = set(np.asarray(rows.labels.target).tolist()) == {ONE_TARGET}
    return _plain(rows.with_labels(target=None)) if unlabelled else rows


def _plain(rows: Dataset) -> Dataset:
    """Rows of one tracker and one target without the tracker's own errors, as the calibration's rows are."""
    if (
        len(rows.blocks) == 1
        and rows.blocks[0].traits.tracked
        and rows.labels.target is None
        and rows.labels.route is None
    ):
        return replace(rows, instruments=Instruments()).with_labels(refers=np.full_like(rows.labels.refers, ""))
    return rows


def new_row_noise(saved: SavedModel, rows: Dataset, new_instrument: bool = False) -> NewRowNoise:
    """Noise of new rows: what they or their own campaign state, else what the calibration's rows of that kind scattered by.

    Args:
        saved: The calibration.
        rows: C channels.
        new_instrument: True of rows with a campaign of their own.

    Raises:
        CampaignError: of a channel neither is known.
    """
    kinds = [saved.kind if rows.direct else block.kind for block in rows.blocks for _ in block.channels]
    names = [channel.name for block in rows.blocks for channel in _channels_of(block.kind)]
    absolute = saved.measurements.noise.rows == "absolute" and rows.relative is not None and rows.direct
    scatter = _scatter(saved)
    noises = []
    for c, (channel, kind) in enumerate(zip(rows.channels, kinds, strict=True)):
        name = names[c]
        declared = (float(rows.sigma[c] or 0.0), np.inf, None) if rows.sigma[c] else None
        entry = declared if (new_instrument or absolute) and declared else scatter.get((kind, name), declared)
        if entry is None and rows.measures[:, c].any():
            raise CampaignError(
                f"{rows.title}: nothing is known of the noise of {channel.name}; write it in a campaign of these rows, under "
                f"measurements: `noise: {{{name}: SIGMA}}`, in {channel.unit}"
            )
        noises.append(entry or (1.0, np.inf, None))
    sigma, freedom, tails = zip(*noises, strict=True)
    return NewRowNoise(np.maximum(sigma, LEAST_SIGMA), np.array(freedom), tails)


def _channels_of(kind: str) -> Channels:
    """Channels of a kind."""
    return MEASUREMENT_KINDS[kind].channels


def _scatter(saved: SavedModel) -> dict[tuple[str, str], tuple[float, float, Tails | None]]:
    """Scatter of the calibration's own rows, its degrees of freedom and its tails, by kind and channel."""
    sigma, freedom = saved.scatter
    of_target = zip(("position", "rotation"), sigma, freedom, strict=True)
    records = saved.record.get("scatter", {})
    tracked = [name for name, kind in MEASUREMENT_KINDS.items() if kind.tracked]
    scatter = {(kind, name): (s, f, _tails(records.get(name, {}))) for name, s, f in of_target for kind in tracked}
    for kind, channels in saved.record.get("scatter_of_kinds", {}).items():
        for name, record in channels.items():
            scatter[kind, name] = float(record["sigma"]), float(record["freedom"]), _tails(record)
    return scatter


def _tails(channel: dict[str, Any]) -> Tails | None:
    """Tails of a channel's record in ``calibration.yaml``; None: normal noise."""
    record = channel.get("tails")
    return None if record is None else Tails(float(record["freedom"]), float(record["sigma"]))
