"""Shots of the measuring head as rows of a campaign: fiducials from images, or from the cache of an earlier run."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from aridcal.campaign import Campaign, FrameSettings
from aridcal.errors import AridcalError, MeasurementError
from aridcal.head.charuco import corner_places
from aridcal.head.matching import NotMeasured, spans_plane
from aridcal.head.reduction import Head, Reduced, Seen, reduce_shots, start_anywhere
from aridcal.head.settings import HeadSettings
from aridcal.head.shots import board, range_columns, read_ranges
from aridcal.head.square import CENTRES
from aridcal.measure import Shot, load, measure_shots
from aridcal.measurements import Measurements, load_measurements
from aridcal.quality import joint_kinds, joint_limits
from aridcal.robot import Robot
from aridcal.tables import Remark, read_tables

CACHE = "fiducials.csv"
CACHE_COLUMNS = ("shot", "square", "fiducial", "u", "v", "std_u", "std_v", "digest")
DECIMALS = 5  # of a pixel: far below any noise, and the same from a cache as from images


@dataclass(frozen=True)
class Shots:
    """What the head saw, shot by shot, N of them.

    Attributes:
        campaign: The job, its target at the camera: ``tip_target`` is T_tip_camera, and what head.yaml says of it is a hint.
        head: As head.yaml declares it.
        rows: Joints, covariates and split of each shot; no pose yet.
        seen: What was found in each.
        fiducials: The cache: a line for each fiducial.
        mount: T_tip_camera as head.yaml has it, shape (4, 4).
    """

    campaign: Campaign
    head: Head
    rows: Measurements
    seen: tuple[Seen, ...]
    fiducials: pd.DataFrame
    mount: np.ndarray


def read_shots(
    campaign: Campaign, robot: Robot, cache: Path | None, seed: int, progress: Callable[[str], None]
) -> Shots:
    """Read the shots of a campaign; images only where the cache does not know them.

    Args:
        campaign: Of ``kind: camera_sonar``.
        robot: The nominal chain.
        cache: ``fiducials.csv`` of an earlier run; it need not exist.
        seed: Of the split into train and test.
        progress: Called with what is being done.

    Raises:
        AridcalError: A file is wrong, or nothing could be measured.
    """
    assert campaign.measurements.head is not None
    settings, squares, table, shots = load(campaign.measurements.head)
    own = ("image", "square", "shot", *range_columns(settings))
    ignore = dict.fromkeys((*campaign.measurements.ignore, *(name for name in own if name in table.names)))
    measured = campaign.measurements.model_copy(update={"ignore": tuple(ignore)})
    mount = FrameSettings(xyz=settings.tip_camera.xyz, rpy=settings.tip_camera.rpy)
    frames = campaign.frames.model_copy(update={"tip_target": mount})
    campaign = campaign.model_copy(update={"measurements": measured, "frames": frames})
    limits, kinds = joint_limits(robot), joint_kinds(robot)
    rows = load_measurements(campaign, robot.readings, limits, kinds, seed, files=[settings.shots], require_pose=False)
    usable = set(rows.line.tolist())
    wanted = [s for s in shots if s.line in usable]
    found, refused = _fiducials(wanted, settings, squares, cache, progress)
    seen, good = [], []
    by_line = {s.line: s for s in wanted}
    for line in rows.line.tolist():
        if line in refused:
            continue
        try:
            seen.append(_seen(by_line[line], found[line], settings, squares))
            good.append(line)
        except (NotMeasured, ValueError) as refusal:
            refused[line] = str(refusal)
    if not good:
        line, why = next(iter(refused.items()))
        raise AridcalError(f"{settings.shots}: nothing could be measured. First: line {line}: {why}")
    name = settings.shots.name
    remarks = [Remark(name, line, "image", by_line[line].image, why) for line, why in refused.items()]
    kept = rows.select(np.isin(rows.line, good))
    every = sorted((*rows.refused, *remarks), key=lambda r: r.row or 0)
    lines = pd.concat([found[line] for line in good], ignore_index=True)
    return Shots(campaign, Head.of(settings), replace(kept, refused=tuple(every)), tuple(seen), lines,
                 settings.tip_camera.homogeneous)  # fmt: skip


def posed(rows: Measurements, reduced: Reduced) -> Measurements:
    """The shots as measured poses of the camera; those that do not fit together within themselves own up to it."""
    doubt = 1.0 / reduced.trust
    quaternion = Rotation.from_matrix(reduced.T_world_camera[:, :3, :3]).as_quat()
    position = reduced.T_world_camera[:, :3, 3]
    return replace(rows, position=position, quaternion=quaternion, covariance=reduced.covariance * doubt[:, None, None])


def _fiducials(
    shots: Sequence[Shot],
    settings: HeadSettings,
    squares: dict[int, np.ndarray],
    cache: Path | None,
    progress: Callable[[str], None],
) -> tuple[dict[int, pd.DataFrame], dict[int, str]]:
    """Fiducials of each shot by its line, and why the others have none."""
    known = _cached(cache)
    about = repr(
        (settings.camera, settings.sonars, settings.target, sorted((k, T.tobytes()) for k, T in squares.items()))
    )
    digests = {s.line: _digest(s, settings, about) for s in shots}
    found: dict[int, pd.DataFrame] = {}
    for s in shots:
        lines = known.get(s.line)
        if lines is not None and digests[s.line] in ("", lines["digest"].iloc[0]):
            found[s.line] = lines
    todo = [s for s in shots if s.line not in found]
    refused: dict[int, str] = {}
    if todo:
        progress(f"reading {len(todo)} images")
    for s, m in zip(todo, measure_shots(todo, settings, squares), strict=True):
        if m.fiducials is None:
            refused[s.line] = m.why
            continue
        sigma = np.sqrt(np.diagonal(m.fiducials.covariances, axis1=1, axis2=2))
        numbers = np.round(np.hstack([m.fiducials.pixels, sigma]), DECIMALS)
        names = (m.fiducials.layout.square, m.fiducials.layout.fiducial)
        lines = pd.DataFrame(dict(zip(CACHE_COLUMNS[1:], (*names, *numbers.T), strict=False)))
        lines.insert(0, "shot", s.line)
        found[s.line] = lines.assign(digest=digests[s.line])
    return found, refused


def _digest(shot: Shot, settings: HeadSettings, about: str) -> str:
    """What the fiducials of a shot depend on, in short; empty if its image is not there to ask."""
    path = settings.shots.parent / shot.image
    if not path.is_file():
        return ""
    content = path.read_bytes() + shot.ranges.tobytes() + f"{shot.square} {shot.T_world_camera} {about}".encode()
    return hashlib.sha256(content).hexdigest()[:16]


def _cached(cache: Path | None) -> dict[int, pd.DataFrame]:
    """Fiducials by the line of their shot; a cache that cannot be read is none."""
    if cache is None or not cache.is_file():
        return {}
    try:
        table = read_tables([cache])
        table.require(CACHE_COLUMNS)
    except MeasurementError:
        return {}
    lines = pd.DataFrame({name: table.numbers(name)[0] for name in CACHE_COLUMNS[:-1]})
    lines["digest"] = table.texts("digest")
    if not np.isfinite(lines[list(CACHE_COLUMNS[:-1])].to_numpy()).all() or table.refused:
        return {}
    lines = lines.astype(dict.fromkeys(CACHE_COLUMNS[:3], int))
    return {int(own["shot"].iloc[0]): own.reset_index(drop=True) for _, own in lines.groupby("shot", sort=False)}


def _seen(shot: Shot, lines: pd.DataFrame, settings: HeadSettings, squares: dict[int, np.ndarray]) -> Seen:
    """Give fiducials their places on the square that is listed first."""
    sonars = read_ranges(shot.ranges, settings)
    own = int(lines["square"].iloc[0])
    number = lines["fiducial"].to_numpy()
    if settings.target == "charuco":
        points = corner_places(board(settings))[number]
    else:
        here = np.linalg.inv(squares[own])
        to_own = np.array([here @ squares[int(k)] for k in lines["square"]])
        points = np.einsum("nij,nj->ni", to_own[:, :3, :2], CENTRES[number - 1]) + to_own[:, :3, 3]
    if not spans_plane(points):
        raise NotMeasured("three fiducials that are not on one line are needed")
    pixels, sigma = lines[["u", "v"]].to_numpy(), lines[["std_u", "std_v"]].to_numpy()
    start = start_anywhere(points, pixels, sonars, settings.camera.intrinsics)
    covariances = sigma[:, :, None] ** 2 * np.eye(2)
    seen = Seen(points, pixels, covariances, shot.ranges, squares[own], start)
    reduce_shots([seen], Head.of(settings))
    return seen
