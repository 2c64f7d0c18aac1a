"""Shots of the measuring head (images and sonar ranges) to measured poses of the tip, with their uncertainty.

Example:
    aridcal measure head.yaml -o measurements.csv
"""

from __future__ import annotations

import argparse
import base64
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import track
from scipy.spatial.transform import Rotation

from aridcal.commands import CommandParser, atomic_file, check_writable, command_parser, run
from aridcal.errors import AridcalError, MeasurementError, OutputError
from aridcal.head.fiducials import Fiducials
from aridcal.head.matching import NotMeasured
from aridcal.head.reduction import carried
from aridcal.head.settings import HeadSettings
from aridcal.head.shots import (
    POSE_COLUMNS,
    Sighting,
    load_shots,
    load_squares,
    picture,
    range_columns,
    read_image,
    read_ranges,
    sight,
)
from aridcal.markup import Html, tag
from aridcal.model import Model
from aridcal.robot import Robot, load_robot
from aridcal.settings import load_settings
from aridcal.tables import Table

STD_COLUMNS = ("std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz")
REFUSED_COLUMNS = ("shot", "image", "why")
CLEARLY = 0.5  # the nearest square must be so much nearer than the next, seen from the nominal arm
LEVER = 0.25  # [m] by which a turn of the camera counts as a shift
PARALLEL_FROM = 200  # shots: fewer are measured sooner than processes are started
THUMBNAIL = 256  # [px]
DISAGREES = 4.0  # standard errors of a sonar's mean residual that are worth a word
STYLE = """body { font: 14px system-ui, sans-serif; margin: 1.5rem; color: #222; background: #fff }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(256px, 1fr)); gap: 1rem }
figure { margin: 0 } figcaption { font-size: 12px; overflow-wrap: anywhere } .refused { color: #a11 }"""


@dataclass(frozen=True)
class Shot:
    """One row of ``shots.csv``, ready to be measured.

    Attributes:
        line: Of the file.
        image: Name of its image.
        ranges: h1, h2, ..., shape (S,), [m].
        square: Index of the square nearest the optical axis; a text if the file has something else there; None if not given.
        T_world_camera: From the nominal arm, shape (4, 4); None if the square is given.
    """

    line: int
    image: str
    ranges: np.ndarray
    square: int | str | None
    T_world_camera: np.ndarray | None


@dataclass(frozen=True)
class Measured:
    """What became of a shot.

    Attributes:
        shot: Which one.
        square: Index of the square that was seen.
        T_world_tip: Shape (4, 4); None if the shot was refused.
        std: Position [m] and rotation vector [rad] in world axes, shape (6,).
        range_residuals: What each sonar reads beyond the pose, shape (S,), [m].
        fiducials: Those that were found; None if there are none.
        why: Why the shot was refused; empty if it was not.
        thumbnail: The image with the fiducials drawn on it, JPEG.
    """

    shot: Shot
    square: int | None = None
    T_world_tip: np.ndarray | None = None
    std: np.ndarray | None = None
    range_residuals: np.ndarray | None = None
    fiducials: Fiducials | None = None
    why: str = ""
    thumbnail: bytes = b""


def tip_pose(sighting: Sighting, T_world_square: np.ndarray, T_tip_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn a sighting into the pose of the tip: T_world_square · T_camera_square⁻¹ · T_tip_camera⁻¹ (7-35c).

    Args:
        sighting: Pose of the square in the camera, with its covariance.
        T_world_square: Shape (4, 4).
        T_tip_camera: Shape (4, 4).

    Returns:
        T_world_tip, shape (4, 4), and its covariance, position and rotation vector in world axes, shape (6, 6).
    """
    T_square_tip = np.linalg.inv(T_tip_camera @ sighting.pose.T_camera_square)
    J = carried(T_world_square[:3, :3], T_square_tip[:3, 3])
    return T_world_square @ T_square_tip, J @ sighting.pose.covariance @ J.T


def measure_shot(shot: Shot, head: HeadSettings, squares: dict[int, np.ndarray]) -> Measured:
    """Measure one shot, or say why it can not be."""
    image, sighting, square = None, None, None
    width = THUMBNAIL
    try:
        image = read_image(shot.image, head.shots.parent, head)
        sonars = read_ranges(shot.ranges, head)
        square = _square(shot, squares)
        sighting = sight(image, sonars, square, squares, head)
        if shot.T_world_camera is not None:
            nearest = _square_seen(sighting, shot.T_world_camera, squares)
            if nearest != square:
                square, sighting = nearest, sight(image, sonars, nearest, squares, head)
                if _square_seen(sighting, shot.T_world_camera, squares) != square:
                    raise NotMeasured("which square is seen is ambiguous: the nominal arm does not tell; give `square`")
        T_world_tip, covariance = tip_pose(sighting, squares[square], head.tip_camera.homogeneous)
    except NotMeasured as refusal:
        thumbnail = b"" if image is None else picture(image, None, None, width)
        return Measured(shot, why=str(refusal), thumbnail=thumbnail)
    return Measured(
        shot,
        square=square,
        T_world_tip=T_world_tip,
        std=np.sqrt(np.diag(covariance)),
        range_residuals=sighting.pose.range_residuals,
        fiducials=sighting.fiducials,
        thumbnail=picture(image, sighting.fiducials, square, width),
    )


def _square(shot: Shot, squares: dict[int, np.ndarray]) -> int:
    """Return the square that the shot names, or the one nearest the optical axis of the nominal arm's camera."""
    if shot.T_world_camera is None:
        if not isinstance(shot.square, int):
            raise NotMeasured(f"square: {shot.square!r} should be the index of a square")
        if shot.square not in squares:
            raise NotMeasured(f"square: there is no square {shot.square} in the table of squares")
        return shot.square
    inverse = np.linalg.inv(shot.T_world_camera)
    middles = {index: (inverse @ T)[:3, 3] for index, T in squares.items()}
    ahead = {index: np.hypot(*p[:2]) for index, p in middles.items() if p[2] > 0}
    if not ahead:
        raise NotMeasured("the nominal arm's camera looks away from all squares: give `square`, or check `tip_camera`")
    return min(ahead, key=lambda index: float(ahead[index]))


def _square_seen(sighting: Sighting, T_world_camera: np.ndarray, squares: dict[int, np.ndarray]) -> int:
    """Return the square that would put the camera nearest to where the nominal arm has it."""
    T_square_camera = np.linalg.inv(sighting.pose.T_camera_square)
    off = {}
    for index, T_world_square in squares.items():
        T = np.linalg.inv(T_world_camera) @ T_world_square @ T_square_camera
        turn = np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))
        off[index] = float(np.linalg.norm(T[:3, 3]) + LEVER * turn)
    best, *others = sorted(off, key=lambda index: off[index])
    if others and off[best] > CLEARLY * off[others[0]]:
        raise NotMeasured(f"which square is seen is ambiguous: {best} or {others[0]}; give `square`")
    return best


def load(path: Path) -> tuple[HeadSettings, dict[int, np.ndarray], Table, list[Shot]]:
    """Read ``head.yaml`` and the tables that it names.

    Raises:
        AridcalError: A file, key, column or row of ``squares.csv`` is wrong; rows of ``shots.csv`` are not looked at.
    """
    head = load_settings(path, HeadSettings)
    squares = load_squares(head.squares)
    table = load_shots(head.shots, head)
    images = table.texts("image")
    h = [table.numbers(name)[0] for name in range_columns(head)]
    ranges = np.column_stack(h) if h else np.zeros((len(table), 0))
    given: list[int | str | None] = [None] * len(table)
    cameras: list[np.ndarray | None] = [None] * len(table)
    if "square" in table.names:
        numbers, _ = table.numbers("square")
        texts = table.texts("square")
        given = [int(n) if n == np.rint(n) else str(t) for n, t in zip(numbers, texts, strict=True)]
    else:
        if head.robot is None:
            raise MeasurementError(f"{head.shots}: no column 'square'; add it, or name the `robot` in {path}")
        robot = load_robot(head.robot.urdf, head.robot.tip, head.robot.base)
        cameras = list(_nominal_cameras(robot, table, head))
    columns = zip(table.line, images, ranges, given, cameras, strict=True)
    return head, squares, table, [Shot(int(line), str(i), r, s, T) for line, i, r, s, T in columns]


def _nominal_cameras(robot: Robot, table: Table, head: HeadSettings) -> Iterator[np.ndarray]:
    table.require(robot.readings, "They tell which square is seen, as there is no column 'square'.")
    q = np.column_stack([table.numbers(name)[0] for name in robot.readings])
    model = Model(robot, ())
    R, p = model.poses(np.zeros(0), model.rows(np.nan_to_num(q)))
    for k in range(len(q)):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R[k], p[k]
        yield head.world_base.homogeneous @ T @ head.tip_camera.homogeneous


def measure_shots(shots: Sequence[Shot], head: HeadSettings, squares: dict[int, np.ndarray]) -> Iterator[Measured]:
    """Measure shots one after the other, over all processors if there are many."""
    with _mapping(len(shots)) as apply:
        yield from apply(partial(measure_shot, head=head, squares=squares), list(shots))


def measured_table(table: Table, results: Sequence[Measured], head: HeadSettings) -> pd.DataFrame:
    """Write measured shots as rows of ``measurements.csv``: shot, the user's other columns, the pose, its ``std_*``."""
    good = [(k, m) for k, m in enumerate(results) if m.T_world_tip is not None]
    T = np.array([m.T_world_tip for _, m in good])
    pose = np.column_stack([T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True)])
    own = table.frame().iloc[[k for k, _ in good]].reset_index(drop=True)
    made = ("shot", *POSE_COLUMNS, *STD_COLUMNS)
    own = own.drop(columns=["image", *range_columns(head), *(c for c in made if c in own.columns)])
    own.insert(0, "shot", [m.shot.line for _, m in good])
    filled = pd.DataFrame(np.column_stack([pose, np.array([m.std for _, m in good])]), columns=[*made[1:]])
    return pd.concat([own, filled], axis=1)


def contact_sheet(results: Sequence[Measured], title: str) -> Html:
    """Show all images with what was found in them, as one page that needs nothing else."""
    figures = []
    for m in results:
        source = f"data:image/jpeg;base64,{base64.b64encode(m.thumbnail).decode()}"
        image = Html(f'<img alt="" width="{THUMBNAIL}" src="{source}">') if m.thumbnail else Html("")
        if m.std is None or m.fiducials is None:
            text = tag("figcaption", f"shot {m.shot.line}, {m.shot.image}: {m.why}", class_="refused")
        else:
            um, mrad = 1e6 * np.max(m.std[:3]), 1e3 * np.max(m.std[3:])
            said = (
                f"square {m.square}, {len(m.fiducials.pixels)} fiducials, std of the tip {um:.0f} µm, {mrad:.2f} mrad"
            )
            text = tag("figcaption", f"shot {m.shot.line}, {m.shot.image}: {said}")
        figures.append(tag("figure", image, text))
    good = sum(m.std is not None for m in results)
    head = tag("head", Html('<meta charset="utf-8">'), tag("title", title), tag("style", Html(STYLE)))
    body = tag("body", tag("h1", title), tag("p", f"{good} of {len(results)} shots measured."), tag("main", figures))
    return Html("<!doctype html>" + tag("html", head, body, lang="en"))


def sonar_remarks(results: Sequence[Measured], std: float) -> list[str]:
    """Say which sonars contradict the camera throughout: a fault of the head that single shots can not tell."""
    r = np.array([m.range_residuals for m in results if m.range_residuals is not None])
    if len(r) < 3 or r.shape[1] == 0:
        return []
    off, error = r.mean(axis=0), np.maximum(r.std(axis=0, ddof=1), std) / np.sqrt(len(r))
    return [
        f"sonar {k + 1} reads {1e3 * off[k]:+.2f} mm against the camera, on average of {len(r)} shots: "
        "the head is not as declared; `kind: camera_sonar` can find out why"
        for k in np.flatnonzero(np.abs(off) > DISAGREES * error)
    ]


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("measure", __doc__)
    arguments.add_argument("head", type=Path, help="head.yaml: camera, sonars, squares and shots")
    arguments.add_argument("-o", "--out", type=Path, required=True, help="table of measured poses to write, .csv")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _main(arguments: argparse.Namespace) -> None:
    out: Path = arguments.out
    if out.suffix.lower() != ".csv":
        raise OutputError(f"{out}: should be a .csv file")
    check_writable(out, "file")
    head, squares, table, shots = load(arguments.head)
    console = Console(stderr=True)
    work = measure_shots(shots, head, squares)
    results = list(track(work, "measuring", total=len(shots), console=console, transient=True))
    refused = [(m.shot.line, m.shot.image, m.why) for m in results if m.why]
    refused += [(remark.row or 0, "", remark.why) for remark in table.refused]
    if len(refused) == len(results) + len(table.refused):
        first = f"line {refused[0][0]}, {refused[0][1]}: {refused[0][2]}" if refused else "it has no rows"
        raise AridcalError(f"{head.shots}: nothing could be measured. First: {first}")
    with atomic_file(out) as path:
        measured_table(table, results, head).to_csv(path, index=False, float_format="%.17g")
    with atomic_file(out.parent / "refused.csv") as path:
        pd.DataFrame(refused, columns=list(REFUSED_COLUMNS)).to_csv(path, index=False)
    with atomic_file(out.parent / "shots.html") as path:
        path.write_text(contact_sheet(results, f"Shots of {head.shots.name}"), encoding="utf-8")
    for line, image, why in refused[:5]:
        console.print(f"refused: line {line}, {image}: {why}", markup=False, highlight=False, soft_wrap=True)
    for remark in sonar_remarks(results, head.sonars.std) if head.sonars else []:
        console.print(remark, markup=False, highlight=False, soft_wrap=True)
    console.print(
        f"{out}: {len(results) + len(table.refused) - len(refused)} shots measured, {len(refused)} refused",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


@contextmanager
def _mapping(n: int) -> Iterator[Callable[[Callable[[Shot], Measured], list[Shot]], Iterator[Measured]]]:
    """Give ``map``, over all processors if there is enough to do."""
    if n < PARALLEL_FROM:
        yield map
        return
    with ProcessPoolExecutor(os.cpu_count(), mp_context=multiprocessing.get_context("spawn")) as pool:
        yield partial(pool.map, chunksize=4)


if __name__ == "__main__":
    sys.exit(main())
