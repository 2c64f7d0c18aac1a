"""Tables that measure something else than poses: which kind of measurement their columns are, and what it needs to know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aridcal.files.tables import TABLE_ENDINGS, Table
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.boards.camera_file import CAMERA_FILE, CameraFile
from aridcal.jobs.prepare.column_names import positions, unit, words
from aridcal.jobs.prepare.guesses import Proposal
from aridcal.system.errors import MeasurementError, name_list

MARKERS_FILE = "markers.csv"
"""Beside a table of pixels: places of the marks on their board, as `aridcal print` writes it."""

# [rad] Joints that turn further count degrees: two turns.
MOST_RADIANS = 4 * np.pi

# [m] Distances whose median is larger, and readings of a gauge that are, count millimetres.
LONGEST, LONGEST_READING = 50.0, 0.5

# Names of a direction of gravity, which look like those of a place.
GRAVITY_NAMES = (("gx",), ("gy",), ("gz",))

# [px] to which an image's size is rounded up where only the marks in it tell it.
IMAGE_SIZE_STEP = 16


@dataclass(frozen=True)
class OtherKind:
    """How a table of a kind is recognised.

    Attributes:
        name: In campaigns.
        needed: Quantities, each with the names that its column may have.
        spare: Columns that belong to it where they are there.
        noise: How its noise is stated.
        length: The quantity that is a length, and the largest median that is believed to be metres.
    """

    name: str
    needed: dict[str, tuple[str, ...]]
    spare: tuple[str, ...]
    noise: str
    length: tuple[str, float] | None = None


OTHER_KINDS = (
    OtherKind(
        "pixels", {"u": ("u",), "v": ("v",), "marker": ("marker",)}, ("camera", "shot"), "{pixel: …}, 1 sigma, px"
    ),
    OtherKind("inclination", {axis: (axis,) for axis in ("gx", "gy", "gz")}, (), "{inclination: …}, 1 sigma, rad"),
    OtherKind("distance", {"distance": ("distance",)}, ("anchor",), "{distance: …}, 1 sigma, m", ("distance", LONGEST)),
    OtherKind("plane", {"plane": ("plane",)}, ("reading",), "{distance: …}, 1 sigma, m", ("reading", LONGEST_READING)),
    OtherKind("plane", {"reading": ("reading",)}, (), "{distance: …}, 1 sigma, m", ("reading", LONGEST_READING)),
    OtherKind("point", {"point": ("point", "socket")}, (), "{position: …}, 1 sigma per axis, m"),
)
"""The first whose columns are all there is meant."""


def kind_of_table(table: Table, used: set[str]) -> tuple[OtherKind, dict[str, str]] | None:
    """The kind of a table that has no positions of the target.

    Args:
        table: The measurements.
        used: Columns that are spoken for.

    Returns:
        The kind and the column of each of its quantities; None where the table is one of poses or positions.
    """
    free = [name for name in table.names if name and name not in used]
    places = positions(name for name in free if words(name) not in GRAVITY_NAMES)
    if any(np.isfinite(table.matrix(family.columns)).any() for family in places if not family.commanded):
        return None
    for kind in OTHER_KINDS:
        by_words = {words(name): name for name in reversed(free)}
        columns = {
            quantity: by_words[(spelling,)]
            for quantity, spellings in kind.needed.items()
            for spelling in spellings[::-1]
            if (spelling,) in by_words
        }
        if len(columns) == len(kind.needed):
            return kind, columns
    return None


def say_other_kind(
    kind: OtherKind,
    columns: dict[str, str],
    table: Table,
    joints: Sequence[str],
    turning: np.ndarray,
    proposal: Proposal,
) -> set[str]:
    """Say the kind, its units, and what is known of its instruments.

    Args:
        kind: Which one.
        columns: Of its quantities.
        table: The measurements.
        joints: Column of each joint.
        turning: Which of the joints turn, shape (columns,) bool.
        proposal: Told what was found.

    Returns:
        The columns that belong to it.
    """
    proposal.say("measurements.kind", kind.name, f"the columns {name_list(list(columns.values()))}, and no positions")
    proposal.say_columns(columns, "by their names")
    spare = [name for name in kind.spare if name in table.cells]
    _say_units(kind, columns, table, joints, turning, proposal)
    remark = REMARKS_BY_KIND.get(kind.name)
    if remark:
        remark(table, proposal)
    return {*columns.values(), *spare}


def _say_units(
    kind: OtherKind,
    columns: dict[str, str],
    table: Table,
    joints: Sequence[str],
    turning: np.ndarray,
    proposal: Proposal,
) -> None:
    """Units by the header, else by how large the numbers are: no nominal robot decides before the instrument is known."""
    turns = [name for name, turn in zip(joints, turning, strict=True) if turn]
    slides = [name for name, turn in zip(joints, turning, strict=True) if not turn]
    value: dict[str, str] = {}
    reasons: list[str] = []
    sure = True
    by_header = {unit(name) or "" for name in turns} & {"deg", "rad"}
    largest = float(np.nanmax(np.abs(table.matrix(turns)), initial=0.0)) if turns else 0.0
    degrees = by_header == {"deg"} or (not by_header and largest > MOST_RADIANS)
    if degrees:
        value["angle"] = "deg"
    if turns and not by_header:
        sure = False
        reasons.append(f"joints up to {largest:.3g} are taken for {'degrees' if degrees else 'radians'}")
    quantity, most = kind.length or ("", np.inf)
    column = columns.get(quantity) or (quantity if quantity in table.cells else None)
    lengths = [*slides, *([column] if column else [])]
    by_header = {unit(name) or "" for name in lengths} & {"m", "mm", "cm", "in"}
    if len(by_header) > 1:
        raise MeasurementError(
            f"{table.title}: the columns {name_list(lengths)} are in different units, but `units` speaks of all lengths of a "
            f"file: "
            "convert one of them"
        )
    if by_header and by_header != {"m"}:
        value["length"] = next(iter(by_header))
    elif column and not by_header:
        sure = False
        usual = float(np.nanmedian(np.abs(table.numbers(column)[0])))
        if usual > most:
            value["length"] = "mm"
        reasons.append(f"a typical {quantity} of {usual:.3g} is taken for {'mm' if usual > most else 'm'}")
    proposal.say("measurements.units", value or None, "; ".join(reasons) or "as the header says", sure)


def _say_cameras(table: Table, proposal: Proposal) -> None:
    """Cameras as ``camera.yaml`` beside the table has them, and the board whose ``markers.csv`` is there."""
    labels = sorted(set(table.texts("camera").tolist()) - {""}) if "camera" in table.cells else ["camera_1"]
    home = _folder(table)
    cameras_known = (
        load_settings(home / CAMERA_FILE, CameraFile).cameras if home and (home / CAMERA_FILE).is_file() else {}
    )
    cameras = {}
    for label in labels:
        if label in cameras_known:
            cameras[label] = cameras_known[label].model_dump(mode="json", exclude_unset=True)
            continue
        rows = np.full(len(table), True) if "camera" not in table.cells else table.texts("camera") == label
        size = [
            int(IMAGE_SIZE_STEP * np.ceil((np.nanmax(table.numbers(axis)[0][rows], initial=0.0) + 1) / IMAGE_SIZE_STEP))
            for axis in ("u", "v")
        ]
        cameras[label] = {"width": size[0], "height": size[1], "on": "tip", "identify": ["place", "f", "c"]}
    if "camera" not in table.cells:
        proposal.say("measurements.camera", labels[0], "there is no column camera: all rows are of one")
    lacking = [label for label in labels if label not in cameras_known]
    sides = "`on: world` if it stands beside the arm, `on: tip` if it moves with it"
    why = f"from {CAMERA_FILE}, which `aridcal detect` wrote; {sides}"
    if lacking:
        why = f"no {CAMERA_FILE} tells of {name_list(lacking)}: width and height are where the marks end. "
        why += "Write those of the images"
        why += f"; {sides}"
    proposal.say("instruments.cameras", cameras, why, sure=False)
    if home and (home / MARKERS_FILE).is_file():
        proposal.say(
            "instruments.markers",
            {"file": home / MARKERS_FILE},
            f"{MARKERS_FILE} is beside the table: the board's own",
            sure=False,
        )
    else:
        proposal.say(
            "instruments.markers",
            None,
            f"no {MARKERS_FILE} beside the table: each marker is an unknown point, and the scale unknown",
            sure=False,
        )


def _say_lengths(table: Table, proposal: Proposal) -> None:
    why = "none is known, so that the arm's scale is not. Add `instruments: {lengths: [{between: [A, B], length: …, std: …}]}`"
    proposal.say("lengths", None, why, sure=False)


REMARKS_BY_KIND: dict[str, Callable[[Table, Proposal], None]] = {"pixels": _say_cameras, "point": _say_lengths}
"""Further remarks, by the name of the kind."""


def _folder(table: Table) -> Path | None:
    """Where the table is; None if it is no file."""
    path = table.files[0]
    return path.parent if path.suffix.lower() in TABLE_ENDINGS else None
