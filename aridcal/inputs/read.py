"""Files of a campaign to one data set: read, checked, converted to SI and split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.errors import MeasurementError
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.checks import check_units, note_limits, note_stale, nothing_usable, refuse_copies, stale_rows
from aridcal.inputs.dataset import Dataset, RowNoise, weighed
from aridcal.inputs.quantities import Source
from aridcal.inputs.repeats import blocks, by_content
from aridcal.inputs.split import draw_split, with_training_rows
from aridcal.inputs.tables import AnyTable, Table, read_tables
from aridcal.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.robot.chain import JointKind


def load_measurements(
    campaign: Campaign,
    readings: Sequence[str],
    limits: np.ndarray,
    kinds: Sequence[JointKind],
    seed: int = 0,
    *,
    files: Sequence[AnyTable] | None = None,
    require_pose: bool = True,
    fitted: bool = True,
) -> Dataset:
    """Read the measurements of a campaign.

    Args:
        campaign: Says which files, columns, units and orientations.
        readings: Joints whose readings are needed.
        limits: Lower and upper limit of each, shape (columns, 2), [rad] or [m], infinite where there is none.
        kinds: Of each joint; limits of a `continuous` one count whole turns.
        seed: For the split into train and test, where the files have no `split`.
        files: Tables in place of the campaign's own, in the same format.
        require_pose: False for rows that measure something else than the target; then `position` is NaN.
        fitted: False for rows that are scored only: their stations need no training rows.

    Raises:
        CampaignError: `columns` names an unknown quantity.
        MeasurementError: a file cannot be read, lacks columns, is not in the stated units, has two orientations that
            disagree, or has no usable row; or a station that needs a frame of its own has held-out rows only.
    """
    settings = campaign.measurements
    table = read_tables(_existing(campaign, files), settings.ignore, campaign.limits.table)
    source = Source(table, settings, tuple(readings), str(campaign.path))
    q = source.joints(kinds)
    position, quaternion, std = np.full((len(table), 3), np.nan), None, None
    if require_pose:
        position = source.position()
        quaternion = source.quaternion() if settings.kind == "pose" else None
        if quaternion is not None:
            source.refuse_second_orientation()
        std = source.std()
    station = source.labels("station", needed=per_station(campaign))
    split = source.split()
    covariates = source.covariates()
    if files is None:  # other tables, another day's for instance, need not have what is ignored anyway
        source.note_unknown_ignored()
    time, others = covariates.get("time"), [covariates[name] for name in sorted(covariates) if name != "time"]
    held = [q, position, quaternion, std, *others]
    words = [None if labels is None else np.unique(labels, return_inverse=True)[1] for labels in (station, split)]
    canonical = by_content([time, *held, *words])
    timed = time is not None and bool(np.isfinite(time[source.usable]).all())
    sequence = canonical if timed else np.arange(len(table))
    refuse_copies(source, held, station, sequence)  # without the time: the same pose later is a copy, too
    if not source.usable.any():
        raise nothing_usable(source)
    check_units(source, q, limits, kinds, position if require_pose else None)
    note_limits(source, q, limits, kinds)
    stale, doubtful = np.full(len(table), -1), np.zeros(len(table), dtype=bool)
    if require_pose:
        measured = position if quaternion is None else np.hstack([position, quaternion])
        stale, doubtful = stale_rows(source, q, kinds, measured, sequence)
    if quaternion is not None:
        note_stale(source, stale)
    channels = (TARGET_POSITION,) if settings.kind == "position" else (TARGET_POSITION, TARGET_ROTATION)
    chosen = canonical[source.usable[canonical]]
    rows = Dataset(
        names=tuple(readings),
        kinds=tuple(kinds),
        files=table.files,
        sha256=table.sha256,
        refused=source.refusals(),
        notices=tuple(source.notices),
        file=table.file,
        line=table.line,
        order=_counted_on(table) if fitted else np.full(len(table), np.inf),
        readings=q,
        channels=channels,
        position=position,
        rotation=None if quaternion is None else Rotation.from_quat(quaternion).as_matrix(),
        sigma=(settings.noise.position, settings.noise.rotation)[: len(channels)],
        relative=None,
        covariates=covariates,
        station=station,
        configuration=np.zeros(len(table), dtype=int),
        stale=stale >= 0,
        doubtful=doubtful,
        test=np.zeros(len(table), dtype=bool) if split is None else split,
        split_given=split is not None,
    ).select(chosen)
    rows = replace(rows, configuration=blocks(rows.readings, kinds))
    if split is None:
        rows = replace(rows, test=draw_split(rows.configuration, seed))
    if fitted:
        rows = with_training_rows(rows, per_station(campaign))
    numbers = sum(channel.size for channel in channels)
    noise = RowNoise(None if std is None else std[chosen, :numbers], absolute=settings.noise.rows == "absolute")
    return weighed(rows, noise)


def _counted_on(table: Table) -> np.ndarray:
    """Lines of the rows, those of the second file after those of the first, shape (N,)."""
    last = [table.line[table.file == k].max(initial=0) for k in range(len(table.files))]
    return np.asarray(table.line + np.cumsum([0, *last])[table.file], dtype=float)


def per_station(campaign: Campaign) -> bool:
    """True where a frame is one for each station, so that every row must say at which it is."""
    return "station" in (campaign.frames.world_base.per, campaign.frames.tip_target.per)


def _existing(campaign: Campaign, files: Sequence[AnyTable] | None) -> Sequence[AnyTable]:
    """The tables to read; a README beside the campaign may say where to get a file that is not there."""
    tables = campaign.tables if files is None else files
    readme = campaign.path.parent / "README.md"
    missing = next((path for path in tables if isinstance(path, Path) and not path.exists()), None)
    if missing is not None and files is None and readme.is_file():
        raise MeasurementError(f"{missing}: there is no such file. {readme} may say where to get it")
    return tables
