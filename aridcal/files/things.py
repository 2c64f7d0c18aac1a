"""Prior knowledge of the things that rows refer to: points, anchors, planes, cameras, boards and markers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from aridcal.engine.instruments.joined import GRASP
from aridcal.engine.instruments.kind import MeasurementKind, Role
from aridcal.engine.instruments.pose import TRACKER
from aridcal.engine.instruments.setup import WORLD, Block, Instruments, Things, Tie
from aridcal.files.campaign import JobSettings
from aridcal.files.instrument_settings import (
    CONTRADICTION_SIGMAS,
    AnchorSettings,
    InstrumentSettings,
    LengthSettings,
    MarkerSettings,
    Placement,
    PlaneSettings,
)
from aridcal.files.measurement_settings import BEYOND_REACH
from aridcal.files.yaml_file import FINEST, LARGEST_SETTING
from aridcal.system.errors import CampaignError, MeasurementError, name_list, nearest
from aridcal.system.reading.regular_files import TABLE_LIMIT, Limit
from aridcal.system.reading.user_names import check_name

BOARD_PREFIX = "board_on_"
"""A board is called after what carries it."""

RESERVED_NAMES = re.compile("world_base|tip_target|tip_camera|camera|sonars|sonar_\\d+")
"""Places of corrections beside the joints: a thing of such a name could not be told from them."""

UNDECLARED: dict[str, AnchorSettings | PlaneSettings] = {"anchor": AnchorSettings(), "plane": PlaneSettings()}
"""Settings of things that the campaign does not name; a camera must be named."""

HAVE_LENGTHS = ("point", "anchor", "marker")
"""Things between which a length may be known."""


@dataclass(frozen=True)
class KnownPlace:
    """A point of a table.

    Attributes:
        xyz: Shape (3,), [m].
        std: 1-sigma of each coordinate, [m]; infinite where they are exact.
        on: Its carrier; empty where the table does not say it.
    """

    xyz: np.ndarray
    std: float = np.inf
    on: str = ""


def load_places(path: Path, key: str, limit: Limit = TABLE_LIMIT) -> dict[str, KnownPlace]:
    """Read ``points.csv`` or ``markers.csv``: columns ``point`` or ``marker``, x y z, and perhaps std; [m].

    Args:
        path: The table.
        key: Name of the column of labels.
        limit: How large it may be.

    Raises:
        MeasurementError: a cell is missing or no number, a label appears twice, or these cannot be metres.
    """
    from aridcal.files.tables import read_tables  # slow to load: only where there are tables

    table = read_tables([path], None, limit)
    numbers = ("x", "y", "z", *(("std",) if "std" in table.names else ()))
    table.require((key, *numbers[:3]))
    if table.refused:
        raise MeasurementError(f"{table.title}: {table.refused[0]}; mend the file")
    labels, values = table.texts(key), table.matrix(numbers)
    on = table.texts("on") if key == "point" and "on" in table.names else np.full(len(labels), "")
    places: dict[str, KnownPlace] = {}
    for row, (label, cells) in enumerate(zip(labels.tolist(), values, strict=True)):
        check_name(label, str(table.remark(row, key, "a label", "")), MeasurementError)
        if not label or label in places:
            why = "appears twice; delete one" if label else "empty; give the row a label"
            raise MeasurementError(str(table.remark(row, key, why)))
        for name, value in zip(numbers, cells.tolist(), strict=True):
            exact = name == "std" and table.cell(row, name).strip() == ""
            if not exact and not (abs(value) <= LARGEST_SETTING and (name != "std" or value >= FINEST)):
                what = "a positive number, or empty where the place is exact" if name == "std" else "a number"
                raise MeasurementError(
                    str(table.remark(row, name, f"should be {what}, not beyond {LARGEST_SETTING:g}"))
                )
        std = float(cells[3]) if len(cells) > 3 and np.isfinite(cells[3]) else np.inf
        places[label] = KnownPlace(cells[:3], std, str(on[row]).strip())
    if np.median(np.linalg.norm(values[:, :3], axis=1)) > BEYOND_REACH:
        raise MeasurementError(
            f"{table.title}: x y z cannot be in m: most are more than {BEYOND_REACH:g} m away; give them in metres"
        )
    return places


@dataclass(frozen=True)
class InstrumentDeclarations:
    """All that a campaign says of its instruments, its tables included.

    Attributes:
        settings: ``instruments`` of the campaign.
        points: Known points by their labels.
        markers: Markers of boards by their labels, each on what carries its board; none where there is no board.
        origin: The campaign, for messages.
    """

    settings: InstrumentSettings
    points: dict[str, KnownPlace]
    markers: dict[str, KnownPlace]
    origin: str

    def board_of(self, camera: str, marker: str = "") -> str:
        """Name of the board of a marker that a camera looks at; without one, of markers that are in no table."""
        return BOARD_PREFIX + (self.markers[marker].on if marker in self.markers else self.settings.sides[camera])

    @cached_property
    def boards(self) -> dict[str, MarkerSettings]:
        """Boards whose markers are known, by their names."""
        return {BOARD_PREFIX + carrier: board for carrier, board in self.settings.boards.items()}

    def carrier(self, role: str, label: str) -> str:
        """Carrier of a thing: ``tip``, ``world`` or a link."""
        declared = self.settings.declared.get(role, {})
        if label in declared:
            return declared[label].on
        if role == "board":
            return label.removeprefix(BOARD_PREFIX)
        if role == GRASP.name:
            return ""  # links that its block names
        if role == "point":
            return (label in self.points and self.points[label].on) or self.settings.points.on
        return WORLD

    def linked(self, role: str, label: str) -> bool:
        """True if a link carries a thing, the tip or another."""
        return self.carrier(role, label) != WORLD

    def beforehand(self, role: Role, label: str, on_board: bool) -> tuple[Sequence[float], Sequence[bool], float]:
        """State of one thing, which of its components are identified, and the sigma of those that are known beforehand.

        Args:
            role: Role of the thing.
            label: Its label.
            on_board: True for a marker of a board with a table.
        """
        if role == TRACKER:
            return [0.0] * role.size, [False] * len(role.components), np.inf
        if role.name in self.settings.declared:
            thing = self.settings.declared[role.name].get(label) or UNDECLARED[role.name]
            return thing.state, thing.free, np.inf
        if role == GRASP:
            return Placement().place(is_known=False), 6 * [True], np.inf
        if role.name == "board":
            if label not in self.boards:  # each marker is a point of what carries it
                return Placement().place(is_known=True), 6 * [False], np.inf
            markers = self.boards[label]
            return markers.place(markers.given or not markers.identify), 6 * [markers.identify], np.inf
        places = self.points if role.name == "point" else self.markers if on_board else {}
        if label not in places:
            return 3 * [np.nan], 3 * [True], np.inf
        return places[label].xyz.tolist(), 3 * [bool(np.isfinite(places[label].std))], places[label].std


def instrument_declarations(campaign: JobSettings) -> InstrumentDeclarations:
    """Read what a campaign says of its instruments, its tables of points and markers included.

    Raises:
        MeasurementError: one of them cannot be read.
    """
    settings, limit = campaign.instruments, campaign.limits.table
    points = load_places(settings.points.file, "point", limit) if settings.points.file else {}
    markers: dict[str, KnownPlace] = {}
    for carrier, board in settings.boards.items():
        assert board.file is not None
        for label, place in load_places(board.file, "marker", limit).items():
            if label in markers:
                raise MeasurementError(f"{board.file}: the marker {label!r} is on {markers[label].on}, too; rename one")
            markers[label] = replace(place, on=carrier)
    return InstrumentDeclarations(settings, points, markers, str(campaign.path))


@dataclass(frozen=True)
class ThingReferences:
    """Things that the usable rows of a block refer to.

    Attributes:
        kind: Kind of the block.
        refers: Labels of the things, by the kind's roles, shape (n, 3).
    """

    kind: MeasurementKind
    refers: np.ndarray

    def labels(self, role: str) -> np.ndarray:
        """Labels of one role, shape (n,), or none."""
        names = [role_of_kind.name for role_of_kind in self.kind.roles]
        return self.refers[:, names.index(role)] if role in names else self.refers[:0, 0]


def with_trackers(
    refers: np.ndarray, blocks: Sequence[Block], block: np.ndarray, joints: Collection[str]
) -> np.ndarray:
    """Labels of the things that rows refer to, shape (N, 3), with a tracker for poses and positions, called after its block.

    Args:
        refers: Labels of all other things, shape (N, 3).
        blocks: Blocks of the rows.
        block: Number of each row's block, shape (N,).
        joints: Names that no thing may have.
    """
    names = {*joints, *np.unique(refers).tolist()}
    titles = [f"block {b.name}" if b.name in names or RESERVED_NAMES.fullmatch(b.name) else b.name for b in blocks]
    label = np.array([name if b.traits.tracked else "" for name, b in zip(titles, blocks, strict=True)])[block]
    return np.column_stack([np.where(label != "", label, refers[:, 0]), refers[:, 1:]])


def instruments_of(
    declarations: InstrumentDeclarations, blocks: Sequence[ThingReferences], joints: Collection[str], complete: bool
) -> tuple[Instruments, list[str]]:
    """All things that rows refer to, and remarks on things of which the rows tell too little.

    Args:
        declarations: What the campaign says of things.
        blocks: Rows of each block.
        joints: Names that no thing may have.
        complete: False for rows that are scored only: they need not refer to all that the campaign names.

    Raises:
        CampaignError: a known length or right angle is of things that no row refers to, or contradicts known points.
        MeasurementError: a thing has the name of a joint, of a place of corrections or of a camera, or a marker is both on the
            tip and in the world.
    """
    roles = {role.name: role for rows in blocks for role in rows.kind.roles}
    counts = {name: sum((Counter(rows.labels(name).tolist()) for rows in blocks), Counter[str]()) for name in roles}
    labels = {name: tuple(sorted(count)) for name, count in counts.items()}
    board = _boards_of_markers(blocks)
    _check_names(labels, joints)
    things = {}
    for name, role in roles.items():
        beforehand = [
            declarations.beforehand(role, label, board.get(label) in declarations.boards) for label in labels[name]
        ]
        free = np.array([free for _, free, _ in beforehand], dtype=bool).reshape(len(beforehand), len(role.components))
        std = np.where(free, np.array([std for *_, std in beforehand]).reshape(-1, 1), np.inf)
        start = np.array([state for state, _, _ in beforehand], dtype=float).reshape(len(beforehand), role.size)
        linked = frozenset(label for label in labels[name] if declarations.linked(name, label))
        things[name] = Things(role, labels[name], start, free, std, linked)
    ties = (*_lengths(declarations, labels, complete), *_right_angles(declarations, labels, complete))
    remarks = [*_too_few(blocks, things, counts, ties), *_unreferred(declarations, labels)] if complete else []
    return Instruments(things, ties, _in_world(declarations, blocks, things)), remarks


def _boards_of_markers(blocks: Sequence[ThingReferences]) -> dict[str, str]:
    """Name of the board of each marker."""
    boards: dict[str, str] = {}
    for rows in blocks:
        pairs = np.unique(np.column_stack([rows.labels("marker"), rows.labels("board")]), axis=0)
        for marker, board in pairs.tolist():
            if boards.setdefault(marker, board) != board:
                raise MeasurementError(
                    f"the marker {marker!r} is seen by cameras on the tip and in the world: it is fixed to one of them only; "
                    "rename it in one of the tables"
                )
    return boards


def _check_names(by_role: dict[str, tuple[str, ...]], joints: Collection[str]) -> None:
    """Refuse labels that are names of joints, of places of corrections or of other things."""
    for role, labels in by_role.items():
        others = (
            {name for other, names in by_role.items() if other != role for name in names} if role == "camera" else set()
        )
        for label in labels:
            if label in joints:
                what = "a joint"
            elif label in others:
                what = "another thing"
            elif RESERVED_NAMES.fullmatch(label):
                what = "a place of corrections"
            else:
                continue
            raise MeasurementError(
                f"the {role} {label!r} has the name of {what}: rename it, in the tables and the campaign"
            )


def _role_of(
    declarations: InstrumentDeclarations,
    by_role: dict[str, tuple[str, ...]],
    key: str,
    pair: tuple[str, str],
    roles: Sequence[str],
) -> str:
    """Role of two things that are named together; empty if a known point is not among the rows, which then tell nothing."""
    having = [role for role in roles if set(pair) <= set(by_role.get(role, ()))]
    if len(having) > 1:
        raise CampaignError(
            f"{declarations.origin}: instruments.{key}: {' and '.join(pair)} may be {' or '.join(having)}; "
            "rename the labels of one"
        )
    if having:
        return having[0]
    labels = sorted({label for role in roles for label in by_role.get(role, ())})
    for label in pair:
        if label not in labels and label not in declarations.points and label not in declarations.markers:
            raise CampaignError(
                f"{declarations.origin}: instruments.{key}: no usable row refers to {label!r}{nearest(label, labels)}; "
                "name what rows do"
            )
    if set(pair) <= set(labels):
        raise CampaignError(
            f"{declarations.origin}: instruments.{key}: {' and '.join(pair)} are not of one sort; name two that are"
        )
    return ""


def _lengths(
    declarations: InstrumentDeclarations, by_role: dict[str, tuple[str, ...]], complete: bool
) -> Iterator[Tie]:
    """Known lengths between things that rows refer to."""
    for number, length in enumerate(declarations.settings.lengths):
        key, (a, b) = f"lengths[{number}].between", length.between
        if complete or any({a, b} <= set(by_role.get(role, ())) for role in HAVE_LENGTHS):
            role = _role_of(declarations, by_role, key, (a, b), HAVE_LENGTHS)
            if role:
                _check_against_places(declarations, role, number, length)
                yield Tie(role, a, b, "distance", length.length, length.std)


def _check_against_places(declarations: InstrumentDeclarations, role: str, number: int, length: LengthSettings) -> None:
    """Refuse a length that the known places of its ends contradict."""
    places = {"point": declarations.points, "marker": declarations.markers}.get(role, {})
    ends = [places[label] for label in length.between if label in places]
    if len(ends) == 2:
        apart = float(np.linalg.norm(ends[0].xyz - ends[1].xyz))
        stds = [end.std for end in ends if np.isfinite(end.std)]
        if abs(apart - length.length) > CONTRADICTION_SIGMAS * np.linalg.norm([length.std, *stds]):
            raise CampaignError(
                f"{declarations.origin}: instruments.lengths[{number}]: {' and '.join(length.between)} are {apart:.6g} m apart "
                f"by their coordinates, not {length.length:g} m; delete one of the two"
            )


def _right_angles(
    declarations: InstrumentDeclarations, by_role: dict[str, tuple[str, ...]], complete: bool
) -> Iterator[Tie]:
    """Right angles between planes that rows refer to."""
    for number, angle in enumerate(declarations.settings.perpendicular):
        a, b = angle.between
        if complete or {a, b} <= set(by_role.get("plane", ())):
            _role_of(declarations, by_role, f"perpendicular[{number}]", (a, b), ("plane",))
            yield Tie("plane", a, b, "cosine", 0.0, angle.std)


def _too_few(
    blocks: Sequence[ThingReferences], things: dict[str, Things], counts: dict[str, Counter[str]], ties: Sequence[Tie]
) -> Iterator[str]:
    """Remarks on things with no more rows than their own unknowns need."""
    numbers = {role.name: sum(c.size for c in rows.kind.channels) for rows in blocks for role in rows.kind.roles}
    for name, of_role in things.items():
        tied = {label for tie in ties if tie.role == name for label in (tie.first, tie.second)}
        unknown = (of_role.free & ~np.isfinite(of_role.std)).sum(axis=1)
        few = [
            label
            for label, free in zip(of_role.names, unknown.tolist(), strict=True)
            if of_role.role.many and label not in tied and free and counts[name][label] * numbers[name] <= free
        ]
        if few:
            yield (
                f"{name} {name_list(few)}: with so few rows they tell where it is, and nothing of the arm; measure more of them"
            )


def _unreferred(declarations: InstrumentDeclarations, by_role: dict[str, tuple[str, ...]]) -> Iterator[str]:
    """Remarks on things that the campaign names and no row refers to; of a board not all markers need be seen."""
    of_role: dict[str, Mapping[str, object]] = {"point": declarations.points, **declarations.settings.declared}
    if "marker" not in by_role:
        of_role["marker"] = declarations.markers
    for role, labels in of_role.items():
        absent = sorted(set(labels) - set(by_role.get(role, ())))
        if absent:
            yield f"{role} {name_list(absent)}: no row refers to it; it is not used"


def _in_world(
    declarations: InstrumentDeclarations, blocks: Sequence[ThingReferences], things: dict[str, Things]
) -> bool:
    """True where anything is known in the world frame, or was measured in it."""
    if any(rows.kind.tracked for rows in blocks):
        return True
    size = {"point": 3, "anchor": 3, "plane": 3, "camera": 6, "board": 6}  # of the place among what may be identified
    for name in size.keys() & things.keys():
        unknown = (things[name].free & ~np.isfinite(things[name].std))[:, : size[name]].any(axis=1)
        for label in np.array(things[name].names)[~unknown].tolist():
            if declarations.carrier(name, label) == WORLD and (name != "board" or label in declarations.boards):
                return True
    return False
