"""Files of a campaign to one data set: read, checked, converted to SI and split."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aridcal.engine.instruments.kind import MeasurementKind
from aridcal.engine.instruments.pose import pose_numbers, turned
from aridcal.engine.instruments.setup import TIP, Block
from aridcal.engine.robot.chain import JointKind, Robot, Route, check_route
from aridcal.engine.rows.dataset import Dataset, RowNoise, joined_datasets, weighed, weighed_apart
from aridcal.engine.rows.remarks import Remark
from aridcal.engine.rows.repeats import blocks, by_content, places
from aridcal.engine.rows.row_facts import ROLES, Labels, Origin, Repeats, no_labels
from aridcal.engine.rows.split import draw_split, with_training_rows
from aridcal.files.campaign import Campaign
from aridcal.files.checks import (
    check_distances,
    check_units,
    note_limits,
    nothing_usable,
    refuse_copies,
    refuse_impossible_readings,
    stale_rows,
)
from aridcal.files.measurement_settings import LABELLED, SHOT, TARGET, MeasurementSettings
from aridcal.files.quantities import TableSource
from aridcal.files.routes import needed_columns, numbered, routes_of
from aridcal.files.things import (
    InstrumentDeclarations,
    ThingReferences,
    instrument_declarations,
    instruments_of,
    with_trackers,
)
from aridcal.system.errors import CampaignError, MeasurementError, name_list, nearest, shortened
from aridcal.system.reading.dates import DAY, NIGHTS, unrolled
from aridcal.system.reading.memory_release import give_back_of

if TYPE_CHECKING:
    from aridcal.files.tables import AnyTable, Table

ONE_TARGET = "target"
"""Label of the target of rows that name none, where others do."""


def default_target(kind: MeasurementKind, title: str) -> str:
    """Label of the target for rows of a block that name none: the tip for links, a level's own frame, else the only target."""
    if kind.bare:
        return TIP
    return title if kind.level else ONE_TARGET


@dataclass(frozen=True)
class _Request:
    """The arguments of :func:`load_measurements`, for every block alike."""

    campaign: Campaign
    readings: tuple[str, ...]
    limits: np.ndarray
    kinds: tuple[JointKind, ...]
    seed: int
    require_pose: bool
    fitted: bool
    own_files: bool
    declarations: InstrumentDeclarations
    robot: Robot | None
    table: Table | None


@dataclass(frozen=True)
class _Part:
    """One block: its rows, and their declared noise."""

    rows: Dataset
    noise: RowNoise


def load_measurements(
    campaign: Campaign,
    readings: Sequence[str],
    limits: np.ndarray,
    kinds: Sequence[JointKind],
    seed: int = 0,
    *,
    files: Sequence[AnyTable] | None = None,
    table: Table | None = None,
    require_pose: bool = True,
    fitted: bool = True,
    robot: Robot | None = None,
) -> Dataset:
    """Read the measurements of a campaign.

    Args:
        campaign: Says which files, columns, units and orientations.
        readings: Joints whose readings are needed.
        limits: Lower and upper limit of each, shape (columns, 2), [rad] or [m], infinite where there is none.
        kinds: Kind of each joint; limits of a `continuous` one count whole turns.
        seed: For the split into train and test, where the files have no `split`.
        files: Tables in place of the campaign's own, in the same format; of several blocks each table is of the one whose
            columns it has.
        table: The rows in place of all files, for a campaign of one block: a table that is read in many ways is cut up once.
        require_pose: False for rows that measure something else than the target; then `position` is NaN.
        fitted: False for rows that are scored only: their stations and labels need no training rows.
        robot: Through whose tree rows take paths, where anything that they refer to is on a link of its own.

    Raises:
        CampaignError: `columns` names an unknown quantity, or what is known of the instruments cannot be used.
        MeasurementError: a file cannot be read, lacks columns, is not in the stated units, has two orientations that
            disagree, or has no usable row; or a station that needs a frame of its own has held-out rows only.
    """
    declarations, own_files = instrument_declarations(campaign), files is None and table is None
    robot = robot if campaign.links else None
    request = _Request(
        campaign,
        tuple(readings),
        limits,
        tuple(kinds),
        seed,
        require_pose,
        fitted,
        own_files,
        declarations,
        robot,
        table,
    )
    of_blocks = _tables_of_blocks(campaign, files) if table is None else [(0, ())]
    parts = [_block(request, number, tables) for number, tables in of_blocks]
    direct = not require_pose or _direct(campaign, parts[0].rows)
    if not (direct or fitted):
        parts_by_number = {number: part for (number, _), part in zip(of_blocks, parts, strict=True)}
        parts = [parts_by_number.get(k) or _without_rows(parts[0], block) for k, block in enumerate(campaign.blocks)]
    rows = parts[0].rows if direct else _with_targets(campaign, joined_datasets([part.rows for part in parts]))
    if fitted:
        by_draw = np.repeat([not part.rows.origin.split_given for part in parts], [len(part.rows) for part in parts])
        rows = with_training_rows(rows, campaign.question.by_station, by_draw)
    if direct:
        rows = weighed(rows, parts[0].noise)
    else:
        rows = _with_instruments(weighed_apart(rows, [part.noise for part in parts]), request)
    if fitted:
        _check_masses(rows, campaign)
    return rows


def _check_masses(rows: Dataset, campaign: Campaign) -> None:
    """Refuse rows that lack the mass of a payload that the campaign hangs up.

    Raises:
        CampaignError: naming its column.
    """
    for number, (name, payload) in enumerate(zip(campaign.masses, campaign.payload, strict=True)):
        if name not in rows.covariates:
            raise CampaignError(
                f"{campaign.path}: {campaign.payload_key(number)}.column: the tables have no numeric column "
                f"{shortened(payload.column)!r}; name the one of the mass, or delete the payload"
            )


def _block(request: _Request, number: int, tables: Sequence[AnyTable]) -> _Part:
    """Read the tables of one block of the campaign, which is told by its number."""
    rows, chosen, noise = _read(request, number, tables)
    give_back_of(len(rows))  # memory of the table's cells, which are larger than the rows
    rows = rows.select(chosen)  # frees the rows in the order of the table
    rows = rows.with_repeats(configuration=blocks(rows.readings, request.kinds))
    if not rows.origin.split_given:
        rows = replace(rows, test=draw_split(places(rows.readings, request.kinds), request.seed))
    return _Part(rows, noise)


def _source(request: _Request, number: int, tables: Sequence[AnyTable]) -> TableSource:
    """The tables of a block as they stand in their files."""
    campaign, settings = request.campaign, request.campaign.blocks[number]
    joint_columns = [settings.columns.get(name, name) for name in request.readings]
    needed = None if request.own_files else {*joint_columns, *(settings.needs if request.require_pose else ())}
    files = _existing(campaign, tables, request.own_files)
    from aridcal.files.tables import read_tables  # slow to load: only where there are tables

    table = request.table
    if table is None:
        table = read_tables(files, settings.ignore, campaign.limits.table, settings.table.dialect, needed)
    for name in sorted(set(settings.units.columns) - set(table.cells)) if request.own_files else ():
        where = f"{campaign.path}: {campaign.place(number)}.units.columns.{name}"
        raise CampaignError(f"{where}: there is no such column{nearest(name, table.names)}")
    without_column = campaign.robot.stated.names
    return TableSource(
        table, settings, request.readings, request.kinds, request.limits, str(campaign.path), without_column
    )


@dataclass(frozen=True)
class _Cells:
    """What the cells of a block's N rows say, in SI, in the order of the table.

    Attributes:
        q: Readings of the joints, shape (N, columns), [rad] or [m].
        position: Of the target, shape (N, 3), [m]; None where no tracker measures it.
        quaternion: Of the target, x y z w, shape (N, 4); None where no tracker measures it.
        std: Declared noise of each row's numbers; None where there is none.
        observed: Readings of an instrument, shape (N, W); of a tracker the position; NaN where nothing is read.
        refers: Labels of the things that rows refer to, shape (N, 3).
        of_things: True where rows refer to any.
        target: Labels, shape (N,); None where rows have none.
        station: Labels, shape (N,); None where rows have none.
        split: Which rows are held out, shape (N,) bool; None where the table does not say.
        covariates: By name, shape (N,) each.
    """

    q: np.ndarray
    position: np.ndarray | None
    quaternion: np.ndarray | None
    std: np.ndarray | None
    observed: np.ndarray
    refers: np.ndarray
    of_things: bool
    target: np.ndarray | None
    station: np.ndarray | None
    split: np.ndarray | None
    covariates: dict[str, np.ndarray]

    @property
    def time(self) -> np.ndarray | None:
        """When each row was measured, shape (N,), [s]; None where the table does not say."""
        return self.covariates.get("time")

    @property
    def values(self) -> list[np.ndarray | None]:
        """All numbers but the time: the same pose later is a copy, too."""
        others = [self.covariates[name] for name in sorted(self.covariates) if name != "time"]
        return [self.q, self.observed, self.quaternion, self.std, *others]

    @property
    def labels(self) -> list[np.ndarray | None]:
        """All labels."""
        return [self.station, self.target, *(self.refers.T if self.of_things else ())]


@dataclass(frozen=True)
class _Order:
    """Two orders of the rows of a block.

    Attributes:
        canonical: By time and content, whatever the order of the table, shape (N,).
        sequence: In which they were measured: by time, else as they stand in the table, shape (N,).
    """

    canonical: np.ndarray
    sequence: np.ndarray


def _read(request: _Request, number: int, tables: Sequence[AnyTable]) -> tuple[Dataset, np.ndarray, RowNoise]:
    """All rows of a block, the numbers of its usable rows in their final order, and the noise of these."""
    source = _source(request, number, tables)
    cells = _cells(source, request)
    if request.own_files:  # other tables, another day's for instance, need not have what is ignored anyway
        source.note_unknown_ignored()
    _unroll(source, cells.covariates)
    order = _order(source, cells)
    refuse_copies(source, cells.values, cells.labels, order.sequence)
    observed, repeats = _checked(source, cells, order)
    rows = _dataset(source, request, cells, observed, repeats)
    chosen = order.canonical[source.usable[order.canonical]]
    numbers = sum(channel.size for channel in rows.channels)
    std = None if cells.std is None else cells.std[chosen, :numbers]
    return rows, chosen, RowNoise(std, absolute=source.settings.noise.rows == "absolute")


def _cells(source: TableSource, request: _Request) -> _Cells:
    """Read every cell that is needed, column by column: the first column that cannot be used is the one that is named."""
    campaign, settings, n = request.campaign, source.settings, len(source.table)
    q = source.joints() if request.robot is None else np.zeros((n, len(request.kinds)))
    tracked = request.require_pose and settings.traits.tracked
    position, quaternion, std = _of_target(source) if tracked else (None, None, None)
    target = source.labels(TARGET, filled=True) if TARGET in settings.own_columns else None
    if target is None and settings.target is not None:
        target = np.full(n, settings.target)
    of_things = request.require_pose and not tracked
    observed, refers = np.full((n, 3), np.nan) if position is None else position, no_labels(n).refers
    if of_things:
        observed, refers = _of_things(source, request)
    if request.robot is not None:
        paths = routes_of(request.declarations, settings.kind, refers, target, request.robot.tip, settings.links)
        q = source.joints(needed_columns(request.robot, paths))
    by_station = campaign.question.by_station and (tracked or len(campaign.blocks) == 1)
    station = source.labels("station", needed="station" if by_station else "")
    split, covariates = source.split(), source.covariates()
    return _Cells(q, position, quaternion, std, observed, refers, of_things, target, station, split, covariates)


def _of_target(source: TableSource) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Position, quaternion and declared noise of a target that a tracker measures."""
    if source.settings.traits.oriented:
        position, quaternion = source.pose()
        source.refuse_second_orientation()
        return position, quaternion, source.std()
    return source.position(), None, source.std()


def _of_things(source: TableSource, request: _Request) -> tuple[np.ndarray, np.ndarray]:
    """Readings of an instrument, and what each row refers to."""
    observed, refers = _observed(source), _refers(source, request)
    camera = refers[:, 0] if source.settings.traits.images else None
    refuse_impossible_readings(source, observed, request.campaign.instruments.cameras, camera)
    return observed, refers


def _order(source: TableSource, cells: _Cells) -> _Order:
    """The orders of rows that the checks and the data set need."""
    words = [
        None if label is None else np.unique(label, return_inverse=True)[1] for label in (*cells.labels, cells.split)
    ]
    canonical = by_content([cells.time, *cells.values, *words])
    timed = cells.time is not None and bool(np.isfinite(cells.time[source.usable]).all())
    return _Order(canonical, canonical if timed else np.arange(len(source.table)))


def _checked(source: TableSource, cells: _Cells, order: _Order) -> tuple[np.ndarray, Repeats]:
    """What rows measure as the data set has it, and which measurements repeat earlier ones; configurations are not counted yet.

    Raises:
        MeasurementError: no row is usable, or they are not in the stated units.
    """
    if not source.usable.any():
        raise nothing_usable(source)
    check_units(source, cells.q, cells.position)
    check_distances(source, cells.observed)
    note_limits(source, cells.q)
    none = np.zeros(len(source.table), dtype=bool)
    uncounted = np.zeros(len(none), dtype=int)
    if cells.position is None:
        return cells.observed, Repeats(uncounted, none, none)
    read = [cells.position] if cells.quaternion is None else [cells.position, cells.quaternion]
    oriented = cells.quaternion is not None
    stale, doubtful = stale_rows(source, cells.q, np.hstack(read), order.sequence, noted=oriented)
    rotation = None if cells.quaternion is None else turned(cells.quaternion).as_matrix()
    return pose_numbers(cells.position, rotation), Repeats(uncounted, stale, doubtful)


def _dataset(source: TableSource, request: _Request, cells: _Cells, observed: np.ndarray, repeats: Repeats) -> Dataset:
    """All rows of a block, in the order of the table."""
    table, n = source.table, len(source.table)
    nothing = no_labels(n)
    return Dataset(
        names=request.readings,
        kinds=request.kinds,
        readings=cells.q,
        blocks=(_block_of(source.settings),),
        observed=observed if request.require_pose else np.zeros((n, 0)),
        relative=None,
        covariates=cells.covariates,
        test=np.zeros(n, dtype=bool) if cells.split is None else cells.split,
        labels=Labels(nothing.block, cells.refers, cells.station, cells.target if request.require_pose else None),
        repeats=repeats,
        origin=Origin(
            file=table.file,
            line=table.line,
            order=_counted_on(table) if request.fitted else np.full(n, np.inf),
            files=table.files,
            sha256=table.sha256,
            refused=source.refusals(),
            notices=tuple(source.notices),
            split_given=cells.split is not None,
        ),
    )


def _unroll(source: TableSource, covariates: dict[str, np.ndarray]) -> None:
    """Add a day to the times of rows after midnight.

    Raises:
        MeasurementError: nobody can tell how many nights they pass.
    """
    if "time" not in covariates:
        return
    column, dates, time = source.column("time"), source.settings.table.dialect.dates, covariates["time"]
    of_day = dates is not None and dates.name == column and float(np.nanmax(np.abs(time))) < 2 * DAY
    clock = unrolled(time, of_day)
    if clock is None:
        raise MeasurementError(f"{source.table.title}: column {column!r} {NIGHTS}")
    passed = clock != time
    if of_day:
        passed |= clock >= DAY
    if (passed & np.isfinite(time)).any():
        line = source.table.line[np.flatnonzero(passed & np.isfinite(time))[0]]
        source.note(column, f"passes midnight: from line {line} on it counts one day more")
    covariates["time"] = clock


def _without_rows(like: _Part, settings: MeasurementSettings) -> _Part:
    """A block without rows: where rows are only scored, its channels keep their places among those of the model."""
    none = np.zeros(0, dtype=int)
    rows, origin = like.rows.select(none), Origin(none, none, none.astype(float), split_given=True)
    return _Part(replace(rows, origin=origin, blocks=(_block_of(settings),)), RowNoise())


def _block_of(settings: MeasurementSettings) -> Block:
    """A block with its channels and their declared sigmas."""
    channels = settings.traits.channels
    sigma = tuple(getattr(settings.noise, channel.name) for channel in channels)
    return Block(settings.title, settings.kind, channels, sigma)


def _direct(campaign: Campaign, rows: Dataset) -> bool:
    """True where one tracker alone measures one target on the tip, without labels and links."""
    only = len(campaign.blocks) == 1 and rows.blocks[0].traits.tracked
    return only and rows.labels.target is None and not campaign.links


def _observed(source: TableSource) -> np.ndarray:
    """Readings of the instrument of each row, shape (N, W), in SI; a touched plane without a gauge reads 0."""
    settings, kind = source.settings, source.settings.traits
    names = kind.read
    cells = [source.column(name) for name in names]
    of_length = kind.ranges or kind.gauges
    scale = [settings.units.scale(name, "length") if of_length else 1.0 for name in cells]
    if kind.gauges and not source.has(cells[0]):
        return np.zeros((len(source.table), 1))
    source.table.require(cells, f"`kind: {settings.kind}` needs {' '.join(names)}; map them under measurements.columns")
    if SHOT in settings.own_columns:
        source.labels(SHOT)
    return source.needed(cells, scale)


def _refers(source: TableSource, request: _Request) -> np.ndarray:
    """Labels of the things that each row refers to, shape (N, 3), in the order of the kind's roles."""
    settings, declarations = source.settings, request.declarations
    n = len(source.table)
    labels = {role.name: np.full(n, "") for role in settings.traits.roles}
    for role in settings.traits.roles:
        if role.name == "board":  # named after the marker's carrier, below
            continue
        words = source.labels(role.name, needed=settings.kind if role.name in LABELLED else "", filled=True)
        if words is None:
            words = np.full(n, _default(request.campaign, settings, role.name))
        if role.name == "camera":
            words = _declared_cameras(source, words, declarations)
        labels[role.name] = words
    if "marker" in labels:
        pairs = zip(labels["camera"].tolist(), labels["marker"].tolist(), strict=True)
        labels["board"] = np.array([declarations.board_of(camera, marker) for camera, marker in pairs])
    for board, settings_of_board in declarations.boards.items() if "marker" in labels else ():
        missing = (labels["board"] == board) & ~np.isin(labels["marker"], sorted(declarations.markers))
        assert settings_of_board.file is not None
        source.refuse(missing, source.column("marker"), f"no such marker in {settings_of_board.file.name}")
    return np.column_stack([*labels.values(), *[np.full(n, "")] * (ROLES - len(labels))])


def _default(campaign: Campaign, settings: MeasurementSettings, role: str) -> str:
    """Label for all rows of a block whose table has no column of a role: the only thing of the campaign, or the block's name."""
    declared = list(campaign.instruments.declared[role])
    if role == "camera" and settings.camera is not None:
        return settings.camera
    alike = [block for block in campaign.blocks if block.kind == settings.kind]
    if len(declared) == 1 and (len(alike) == 1 or role == "camera"):
        return declared[0]
    if role == "camera":
        raise CampaignError(
            f"{campaign.path}: measurements.camera: there are several cameras ({name_list(declared)}); say which took the "
            f"images of {settings.title}: `camera: NAME`, or a column `camera`"
        )
    return settings.title


def _declared_cameras(source: TableSource, words: np.ndarray, declarations: InstrumentDeclarations) -> np.ndarray:
    """Camera of each row, shape (N,), any declared one in unusable rows.

    Raises:
        MeasurementError: a usable row names a camera that the campaign does not declare.
    """
    cameras = list(declarations.settings.cameras)
    unknown = ~np.isin(words, cameras)
    rows = np.flatnonzero(unknown & source.usable)
    if len(rows):
        remark = source.table.remark(int(rows[0]), source.column("camera"), "there is no such camera")
        hint = nearest(str(words[rows[0]]), cameras)
        raise MeasurementError(f"{remark}{hint}; add it under instruments.cameras of {declarations.origin}")
    return np.where(unknown, cameras[0], words)


def _with_targets(campaign: Campaign, rows: Dataset) -> Dataset:
    """The rows with a label of their target, where there is more than one.

    Raises:
        CampaignError: these labels cannot be used with the campaign's frames.
        MeasurementError: a table calls a target of its own what the tip is called.
    """
    labels = rows.labels.target
    label = labels if labels is not None else np.full(len(rows), "", dtype=str)
    defaults = {block.title: default_target(block.traits, block.title) for block in campaign.blocks}
    if labels is None and len(set(defaults.values())) == 1:
        return rows
    if TIP in label and TIP in defaults.values():
        bare = dict.fromkeys(f"`kind: {block.kind}`" for block in campaign.blocks if block.traits.bare)
        raise MeasurementError(
            f"a target is called {TIP!r}, as the tip itself is beside {name_list([*bare])}; rename it"
        )
    filled = np.where(label == "", np.array([defaults[block.name] for block in rows.blocks])[rows.labels.block], label)
    if campaign.frames.tip_target.per is not None:
        raise CampaignError(
            f"{campaign.path}: frames.tip_target: `per: station` is not for several targets "
            f"({name_list(np.unique(filled).tolist())}); delete it, and give a target that was moved a label of its own"
        )
    return rows.with_labels(target=filled)


def _refuse_things_at_stations(rows: Dataset, campaign: Campaign) -> None:
    """Refuse things in the world beside a base that is at another place in it at each station: theirs would be there, too.

    Raises:
        CampaignError: naming the first block with such rows.
    """
    if campaign.frames.world_base.per is None or rows.direct:
        return
    starts = np.array([path.start is None for path in rows.labels.routes])
    in_world = starts[np.zeros(len(rows), dtype=int) if rows.labels.route is None else rows.labels.route]
    for number, block in enumerate(rows.blocks):
        if not block.traits.tracked and in_world[rows.labels.block == number].any():
            raise CampaignError(
                f"{campaign.path}: frames.world_base: `per: station` is for rows of a tracker, and {block.name} "
                f"(`kind: {block.kind}`) refers to the world; delete it, or give what stands elsewhere at each station a label "
                "of its own"
            )


def _with_instruments(rows: Dataset, request: _Request) -> Dataset:
    """The rows with the instruments and things that they refer to, and their paths."""
    rows = rows.with_labels(refers=with_trackers(rows.labels.refers, rows.blocks, rows.labels.block, request.readings))
    of_blocks = [
        ThingReferences(b.traits, rows.labels.refers[rows.labels.block == number])
        for number, b in enumerate(rows.blocks)
    ]
    instruments, remarks = instruments_of(
        request.declarations, of_blocks, request.readings, request.fitted and request.own_files
    )
    if request.robot is not None:
        remarks = [*remarks, *_undeclared_targets(rows, request.campaign)]
        rows = with_routes(rows, request.campaign.blocks, request.declarations, request.robot)
    _refuse_things_at_stations(rows, request.campaign)
    notices = [Remark(request.campaign.path.name, None, "", "", remark) for remark in remarks]
    return replace(rows, instruments=instruments).with_origin(notices=(*rows.origin.notices, *notices))


def _undeclared_targets(rows: Dataset, campaign: Campaign) -> Iterator[str]:
    """Remarks on targets whose link the campaign does not say, beside others with one: a label may be misspelt.

    Raises:
        MeasurementError: the campaign names no tip that would carry them; naming the first.
    """
    if rows.labels.target is None:
        return
    bare = np.array([block.traits.bare for block in rows.blocks])[rows.labels.block]
    declared = campaign.instruments.targets
    undeclared = sorted(set(rows.labels.target[~bare].tolist()) - set(declared))
    if "tip" in campaign.robot.model_fields_set:
        named = [label for label in undeclared if label not in {ONE_TARGET, *(block.name for block in rows.blocks)}]
        for label in named if declared else ():
            yield (
                f"target {label!r}{nearest(label, declared)}: no key instruments.targets.{label} says on which link it is; "
                f"it is taken to be on the tip, {campaign.robot.tip}"
            )
    elif undeclared:
        raise MeasurementError(
            f"{rows.title}: no key says on which link the target {undeclared[0]!r} is: add instruments.targets.{undeclared[0]}: "
            "{on: LINK}, or name robot.tip, which carries all others"
        )


def with_routes(
    rows: Dataset, blocks: Sequence[MeasurementSettings], declarations: InstrumentDeclarations, robot: Robot
) -> Dataset:
    """The rows with the paths that they take.

    Raises:
        RobotError: no joint moves on one of them.
    """
    paths = [Route()] * len(rows)
    for number, block in enumerate(blocks):
        rows_of_block = np.flatnonzero(rows.labels.block == number)
        target = None if rows.labels.target is None else rows.labels.target[rows_of_block]
        of_block = routes_of(
            declarations, block.kind, rows.labels.refers[rows_of_block], target, robot.tip, block.links
        )
        for k, path in zip(rows_of_block.tolist(), of_block, strict=True):
            paths[k] = path
    routes, route = numbered(paths, declarations.settings.targets_on(robot.tip).values())
    for path in routes[1:]:
        check_route(robot, path)
    return rows.with_labels(routes=routes, route=route)


def _counted_on(table: Table) -> np.ndarray:
    """Lines of the rows, those of the second file after those of the first, shape (N,)."""
    last = [table.line[table.file == k].max(initial=0) for k in range(len(table.files))]
    return np.asarray(table.line + np.cumsum([0, *last])[table.file], dtype=float)


def _existing(campaign: Campaign, tables: Sequence[AnyTable], own_files: bool) -> Sequence[AnyTable]:
    """The tables to read; a README beside the campaign may say where to get a file that is not there."""
    readme = campaign.path.parent / "README.md"
    missing = next((path for path in tables if isinstance(path, Path) and not path.exists()), None)
    if missing is not None and own_files and readme.is_file():
        raise MeasurementError(f"{missing}: there is no such file. {readme} may say where to get it")
    return tables


def _tables_of_blocks(campaign: Campaign, files: Sequence[AnyTable] | None) -> list[tuple[int, Sequence[AnyTable]]]:
    """Tables of each block, by its number.

    Raises:
        MeasurementError: a table that is given in place of the campaign's own may be of any block or of none.
    """
    if files is None and not campaign.has_other_tables:
        return [(number, block.files) for number, block in enumerate(campaign.blocks)]
    tables = campaign.tables if files is None else files
    if len(campaign.blocks) == 1:
        return [(0, tables)]
    from aridcal.files.tables import path_of  # as above

    of_block: dict[int, list[AnyTable]] = {}
    for table in tables:
        having = [k for k, block in enumerate(campaign.blocks) if block.needs <= _names(table, block, campaign)]
        needed = {k: len(campaign.blocks[k].needs) for k in having}
        most = [k for k in having if needed[k] == max(needed.values())]
        if len(most) != 1:
            titles = name_list([campaign.blocks[k].title for k in most] or [block.title for block in campaign.blocks])
            what = f"{'several' if most else 'none'} of the blocks {titles}"
            raise MeasurementError(
                f"{path_of(table)}: its columns fit {what}; give it the columns of one, and that one columns that no other "
                "has (`columns`)"
            )
        of_block.setdefault(most[0], []).append(table)
    return sorted(of_block.items())


def _names(table: AnyTable, settings: MeasurementSettings, campaign: Campaign) -> set[str]:
    """Columns of a table as a block would read it; none where it is not written as the block's own files are."""
    from aridcal.files.tables import read_tables  # as above

    try:
        return set(read_tables([table], None, campaign.limits.table, settings.table.dialect, settings.needs).names)
    except MeasurementError:
        if settings.table.is_plain:
            raise
        return set()
