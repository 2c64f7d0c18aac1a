"""A camera's frames and the joints of one bag, as rows: one image for each standstill, taken from its middle.

Both are stamped by clocks that are taken to be one: how far the arm has moved cannot be seen in images before what they show is
known. What can be tried is tried: where frames in the middle of a standstill differ by a good part of what frames of different
standstills do, the picture moves, and no row is made; if frames at the ends do at most standstills, the clocks differ. A delay of
some tenths of a second does no harm, for the image is taken from the middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from aridcal.engine.robot.chain import Robot
from aridcal.jobs.boards.camera_frames import thumbnail
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.merge.bag_camera import BagCamera, Load
from aridcal.jobs.merge.log_files import JointLog
from aridcal.jobs.merge.log_rows import TIME_COLUMN, UnpairedStandstill
from aridcal.jobs.merge.standstills import Standstills, span_of, standstills
from aridcal.system.errors import MeasurementError, printable

MOVING_SHARE = 0.15
"""Share of the usual difference between pictures of two stops above which a picture moves: its noise is far below, and a picture
that is a tenth of the way to the next stop blurs and shifts what is measured in it."""

LEAST_GREY_DIFFERENCE = 2.0
"""[grey levels] below which pictures of two stops are alike: there is nothing in them that could move."""

MOST_MOVING_SHARE = 0.5
"""Share of stops with a moving picture above which the clocks, and not the stops, are at fault."""

FEWEST_IMAGE_ROWS = 3
"""Fewest rows that a campaign can begin with."""


@dataclass(frozen=True)
class ImageRows:
    """Rows, each with the number of its image.

    Attributes:
        table: Joints in SI and ``time`` by their clock, shape (K, ...).
        frames: Indices of the images in their topic, shape (K,).
        size: Width and height of the images, [px].
        unpaired: Standstills that make no row.
        notices: What a user should know.
    """

    table: pd.DataFrame
    frames: np.ndarray
    size: tuple[int, int]
    unpaired: tuple[UnpairedStandstill, ...]
    notices: tuple[str, ...]


def choose_images(robot: Robot, joints: JointLog, camera: BagCamera, load: Load) -> ImageRows:
    """Choose an image for each standstill of the joints.

    Raises:
        MeasurementError: there are too few, or the clocks are not one.
    """
    log, q = joints.log, joints.readings(joints.units[0])
    still = standstills(log, q)
    t = camera.time
    if not len(t) or t.max() < log.time[0] or t.min() > log.time[-1]:
        spans = f"{log.time[0]:.3f} to {log.time[-1]:.3f} s" + (f", {t.min():.3f} to {t.max():.3f} s" if len(t) else "")
        raise MeasurementError(
            f"{camera.title} and {log.title}: no image is of the time in which joints were recorded ({spans}). Their clocks "
            "differ: let one computer stamp both, or choose the images by hand and use `aridcal detect --joints`"
        )
    margin = span_of(log)
    windows = [
        np.flatnonzero((t >= a + margin) & (t <= b - margin)) for a, b in zip(still.begin, still.end, strict=True)
    ]
    middle = 0.5 * (still.begin + still.end)
    frame_of = {k: int(rows[np.argmin(np.abs(t[rows] - middle[k]))]) for k, rows in enumerate(windows) if len(rows)}
    reasons = dict.fromkeys(
        (k for k in range(len(still)) if k not in frame_of), "no image was taken while the joints stood"
    )
    thumbnails, sizes, faults = _thumbnails(frame_of, windows, load)
    reasons |= {k: faults[n] for k, n in frame_of.items() if n in faults}
    reasons |= _reasons_of_size({k: sizes[n] for k, n in frame_of.items() if n in sizes})
    reasons |= _reasons_of_motion(frame_of, windows, thumbnails, camera)
    rows = [k for k in frame_of if k not in reasons]
    if len(rows) < FEWEST_IMAGE_ROWS:
        first = next(iter(reasons.items()), None)
        because = f"; first, at {still.begin[first[0]]:.3f} s: {first[1]}" if first else ""
        raise MeasurementError(f"{camera.title}: {len(rows)} of {len(still)} standstills have an image{because}")
    readings = [_mean(log.time, q, still, margin, k) for k in rows]
    table = pd.DataFrame(np.array(readings), columns=list(robot.readings)).assign(**{TIME_COLUMN: middle[rows]})
    unpaired = tuple(
        UnpairedStandstill(log.title, float(still.begin[k]), float(still.end[k]), reasons[k]) for k in sorted(reasons)
    )
    clock = "times of arrival" if camera.by_arrival else "stamps"
    remark = (
        f"{camera.title}: one image for each standstill, the nearest to its middle; {clock} of both are by one clock"
    )
    return ImageRows(
        table, np.array([frame_of[k] for k in rows]), sizes[frame_of[rows[0]]], unpaired, (*log.notes, remark)
    )


def _mean(time: np.ndarray, q: np.ndarray, still: Standstills, margin: float, k: int) -> np.ndarray:
    inside = (time >= still.begin[k] + margin) & (time <= still.end[k] - margin)
    return np.asarray(q[inside if inside.any() else (time >= still.begin[k]) & (time <= still.end[k])].mean(axis=0))


def _thumbnails(
    frame_of: dict[int, int], windows: list[np.ndarray], load: Load
) -> tuple[dict[int, np.ndarray], dict[int, tuple[int, int]], dict[int, str]]:
    """Thumbnails of each chosen frame and its neighbours, sizes of the images, and why some cannot be read, by their number."""
    needed = {m for k, n in frame_of.items() for m in (n, *_middle(n, windows[k]), *_edges(windows[k]))}
    thumbnails: dict[int, np.ndarray] = {}
    sizes: dict[int, tuple[int, int]] = {}
    faults: dict[int, str] = {}

    def take(number: int, image: np.ndarray | NotMeasured) -> None:
        if isinstance(image, NotMeasured):
            faults[number] = printable(str(image))
            return
        thumbnails[number], sizes[number] = thumbnail(image), (image.shape[1], image.shape[0])

    load(frozenset(needed), take)
    return thumbnails, sizes, faults


def _middle(n: int, rows: np.ndarray) -> list[int]:
    """Frames about the chosen one: its neighbours, and those a quarter from either end of the window."""
    return [m for m in (n - 1, n + 1, int(rows[len(rows) // 4]), int(rows[(3 * len(rows)) // 4])) if m in rows]


def _edges(rows: np.ndarray) -> list[int]:
    """The first and the last frame of a window."""
    return [int(rows[0]), int(rows[-1])]


def _reasons_of_size(sizes: dict[int, tuple[int, int]]) -> dict[int, str]:
    """Reasons against stops whose image has another size than most."""
    if not sizes:
        return {}
    distinct, counts = np.unique(np.array(list(sizes.values())), axis=0, return_counts=True)
    usual = tuple(distinct[np.argmax(counts)].tolist())
    return {
        k: f"its image has {size[0]} x {size[1]} pixels, the others {usual[0]} x {usual[1]}"
        for k, size in sizes.items()
        if size != usual
    }


def _reasons_of_motion(
    frame_of: dict[int, int], windows: list[np.ndarray], thumbnails: dict[int, np.ndarray], camera: BagCamera
) -> dict[int, str]:
    """Reasons against stops whose picture moves.

    Raises:
        MeasurementError: it does at most of them.
    """
    readable = [n for n in frame_of.values() if n in thumbnails]
    differences = [float(np.abs(thumbnails[a] - thumbnails[b]).mean()) for a, b in pairwise(readable)]
    usual = float(np.median(differences)) if differences else 0.0
    if usual < LEAST_GREY_DIFFERENCE:
        return {}

    def differs(n: int, others: list[int]) -> bool:
        return any(
            float(np.abs(thumbnails[m] - thumbnails[n]).mean()) > MOVING_SHARE * usual
            for m in others
            if m in thumbnails and n in thumbnails
        )

    moving = {
        k: "the picture still moves while the joints stand"
        for k, n in frame_of.items()
        if differs(n, _middle(n, windows[k]))
    }
    late = [k for k, n in frame_of.items() if differs(n, _edges(windows[k]))]
    if len(late) > MOST_MOVING_SHARE * len(frame_of):
        raise MeasurementError(
            f"{camera.title}: the picture moves at {len(late)} of {len(frame_of)} standstills of the joints. The stamps of "
            "images and joints are of two clocks, or of arrival: let one computer stamp both, or wait longer at each pose"
        )
    return moving
