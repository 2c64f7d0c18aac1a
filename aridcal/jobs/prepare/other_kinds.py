"""Tables that measure something else than poses: which kind of measurement their columns are, and what it needs to know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aridcal.files.tables import ENDINGS, Table
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.prepare.column_names import positions, unit, words
from aridcal.jobs.prepare.guesses import Proposal
from aridcal.jobs.print.camera_file import CAMERA_FILE, CameraFile
from aridcal.system.errors import MeasurementError, listed

MARKERS_FILE = "markers.csv"
"""Beside a table of pixels: places of the marks on their board, as `aridcal print` writes it."""

# [rad] Joints that turn further count degrees: two turns.
FARTHEST = 4 * np.pi

# [m] Distances whose median is larger, and readings of a gauge that are, count millimetres.
LONGEST, LONGEST_READING = 50.0, 0.5

# Names of a direction of gravity, which look like those of a place.
GRAVITY = (("gx",), ("gy",), ("gz",))

# [px] to which an image's size is rounded up where only the marks in it tell it.
ROUND = 16


@dataclass(frozen=True)
class OtherKind:
    """How a kind is recognised.

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


def other_kind(table: Table, used: set[str]) -> tuple[OtherKind, dict[str, str]] | None:
    """The kind of a table that has no positions of the target.

    Args:
        table: The measurements.
        used: Columns that are spoken for.

    Returns:
        The kind and the column of each of its quantities; None where the table is one of poses or positions.
    """
    free = [name for name in table.names if name and name not in used]
    places = positions(name for name in free if words(name) not in GRAVITY)
    if any(np.isfinite(table.matrix(family.columns)).any() for family in places if not family.commanded):
        return None
    for kind in OTHER_KINDS:
        known = {words(name): name for name in reversed(free)}
        found = {
            quantity: known[(spelling,)]
            for quantity, spellings in kind.needed.items()
            for spelling in spellings[::-1]
            if (spelling,) in known
        }
        if len(found) == len(kind.needed):
            return kind, found
    return None


def say_other_kind(
    kind: OtherKind, columns: dict[str, str], table: Table, joints: Sequence[str], turning: np.ndarray, made: Proposal
) -> set[str]:
    """Say what the kind is, in which units, and what is known of its instruments.

    Args:
        kind: Which one.
        columns: Of its quantities.
        table: The measurements.
        joints: Column of each joint.
        turning: Which of the joints turn, shape (columns,) bool.
        made: Told what was found.

    Returns:
        The columns that belong to it.
    """
    made.say("measurements.kind", kind.name, f"the columns {listed(list(columns.values()))}, and no positions")
    made.say_columns(columns, "by their names")
    spare = [name for name in kind.spare if name in table.cells]
    _say_units(kind, columns, table, joints, turning, made)
    remark = REMARKS.get(kind.name)
    if remark:
        remark(table, made)
    return {*columns.values(), *spare}


def _say_units(
    kind: OtherKind, columns: dict[str, str], table: Table, joints: Sequence[str], turning: np.ndarray, made: Proposal
) -> None:
    """Units by the header, else by how large the numbers are: no nominal robot decides before the instrument is known."""
    turns = [name for name, turn in zip(joints, turning, strict=True) if turn]
    slides = [name for name, turn in zip(joints, turning, strict=True) if not turn]
    value: dict[str, str] = {}
    reasons: list[str] = []
    sure = True
    said = {unit(name) or "" for name in turns} & {"deg", "rad"}
    largest = float(np.nanmax(np.abs(table.matrix(turns)), initial=0.0)) if turns else 0.0
    degrees = said == {"deg"} or (not said and largest > FARTHEST)
    if degrees:
        value["angle"] = "deg"
    if turns and not said:
        sure = False
        reasons.append(f"joints up to {largest:.3g} are taken for {'degrees' if degrees else 'radians'}")
    quantity, most = kind.length or ("", np.inf)
    column = columns.get(quantity) or (quantity if quantity in table.cells else None)
    lengths = [*slides, *([column] if column else [])]
    said = {unit(name) or "" for name in lengths} & {"m", "mm", "cm", "in"}
    if len(said) > 1:
        raise MeasurementError(
            f"{table.title}: the columns {listed(lengths)} are in different units, but `units` speaks of all lengths of a file: "
            "convert one of them"
        )
    if said and said != {"m"}:
        value["length"] = next(iter(said))
    elif column and not said:
        sure = False
        usual = float(np.nanmedian(np.abs(table.numbers(column)[0])))
        if usual > most:
            value["length"] = "mm"
        reasons.append(f"a typical {quantity} of {usual:.3g} is taken for {'mm' if usual > most else 'm'}")
    made.say("measurements.units", value or None, "; ".join(reasons) or "as the header says", sure)


def _say_cameras(table: Table, made: Proposal) -> None:
    """Cameras as ``camera.yaml`` beside the table has them, and the board whose ``markers.csv`` is there."""
    labels = sorted(set(table.texts("camera").tolist()) - {""}) if "camera" in table.cells else ["camera_1"]
    home = _folder(table)
    known = load_settings(home / CAMERA_FILE, CameraFile).cameras if home and (home / CAMERA_FILE).is_file() else {}
    cameras = {}
    for label in labels:
        if label in known:
            cameras[label] = known[label].model_dump(mode="json", exclude_unset=True)
            continue
        rows = np.full(len(table), True) if "camera" not in table.cells else table.texts("camera") == label
        size = [
            int(ROUND * np.ceil((np.nanmax(table.numbers(axis)[0][rows], initial=0.0) + 1) / ROUND))
            for axis in ("u", "v")
        ]
        cameras[label] = {"width": size[0], "height": size[1], "on": "tip", "identify": ["place", "f", "c"]}
    if "camera" not in table.cells:
        made.say("measurements.camera", labels[0], "there is no column camera: all rows are of one")
    lacking = [label for label in labels if label not in known]
    why = f"from {CAMERA_FILE}, which `aridcal detect` wrote; `on: world` if it stands beside the arm"
    if lacking:
        why = f"no {CAMERA_FILE} tells of {listed(lacking)}: width and height are where the marks end. Write those of the images"
    made.say("instruments.cameras", cameras, why, sure=False)
    if home and (home / MARKERS_FILE).is_file():
        made.say(
            "instruments.markers",
            {"file": home / MARKERS_FILE},
            f"{MARKERS_FILE} is beside the table: the board's own",
            sure=False,
        )
    else:
        made.say(
            "instruments.markers",
            None,
            f"no {MARKERS_FILE} beside the table: each marker is an unknown point, and the scale unknown",
            sure=False,
        )


def _say_lengths(table: Table, made: Proposal) -> None:
    why = "none is known, so that the arm's scale is not. Add `instruments: {lengths: [{between: [A, B], length: …, std: …}]}`"
    made.say("lengths", None, why, sure=False)


REMARKS: dict[str, Callable[[Table, Proposal], None]] = {"pixels": _say_cameras, "point": _say_lengths}
"""What else is to be said of a kind."""


def _folder(table: Table) -> Path | None:
    """Where the table is; None if it is no file."""
    path = table.files[0]
    return path.parent if path.suffix.lower() in ENDINGS else None
