"""The shots of a campaign: what was seen in each, from its image or from the cache of an earlier run, and their rows.

Fiducials are all that is kept of an image. They are cached as ``fiducials.csv``, a line for each fiducial, with a digest of all
that they depend on, so that a second run needs no image and an image that changed is read anew.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from aridcal.engine.instruments.camera_sonar import HEAD, Head, HeadShot, channels, packed
from aridcal.engine.instruments.setup import Block, Instruments, Things
from aridcal.engine.model.declared_noise import with_declared_noise
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.remarks import Remark
from aridcal.engine.rows.row_facts import ROLES
from aridcal.files.campaign import Campaign, FrameSettings
from aridcal.files.read import load_measurements
from aridcal.files.tables import Table, read_tables
from aridcal.jobs.head1992.charuco import corner_places
from aridcal.jobs.head1992.fiducials import Fiducials
from aridcal.jobs.head1992.head_settings import HeadSettings, range_columns
from aridcal.jobs.head1992.matching import NotMeasured, spans_plane
from aridcal.jobs.head1992.observations import CampaignRows, Detections
from aridcal.jobs.head1992.shot_rows import check_pose, head_of, start_anywhere
from aridcal.jobs.head1992.shots import Shot, board, image_content, load, measure_shots, read_ranges
from aridcal.jobs.head1992.square import FIDUCIAL_CENTRES
from aridcal.system.errors import AridcalError, MeasurementError
from aridcal.system.progress import Progress

INDEX_COLUMNS = ("shot", "square", "fiducial")
NUMBER_COLUMNS = ("u", "v", "std_u", "std_v")
CACHE_COLUMNS = (*INDEX_COLUMNS, *NUMBER_COLUMNS, "digest")

# Of a pixel: far below any noise, and the same from a cache as from images.
CACHE_DECIMALS = 5

# Hexadecimal digits: 64 bits, so that a change goes unnoticed once in 10^19 times.
DIGEST_LENGTH = 16

# In place of the digest of an image that is there and cannot be read: no fiducials were ever found in it.
UNREADABLE = "unreadable"


def read_shots(
    campaign: Campaign,
    robot: Robot,
    cache: Path | None,
    seed: int,
    progress: Progress,
    lens: np.ndarray | None = None,
) -> CampaignRows:
    """Read the shots of a campaign; images only where the cache does not know them, or where fiducials are looked for again.

    Args:
        campaign: Of ``kind: camera_sonar``.
        robot: The nominal chain.
        cache: ``fiducials.csv`` of an earlier run; it need not exist.
        seed: Of the split into train and test.
        progress: Called with what is being done.
        lens: Intrinsics, shape (9,), to look for fiducials with in all images that are there, in place of the declared
            ones; the rows still refer to the head as declared.

    Raises:
        AridcalError: A file is wrong, or nothing could be measured.
    """
    assert campaign.measurements.head is not None
    settings, squares, table, shots = load(campaign.measurements.head)
    campaign = _with_head(campaign, settings, table)
    limits, kinds = robot.limits, robot.kinds
    rows = load_measurements(campaign, robot.readings, limits, kinds, seed, files=[settings.shots], require_pose=False)
    lines = rows.origin.line.tolist()
    usable = set(lines)
    by_line = {shot.line: shot for shot in shots if shot.line in usable}
    search_settings = settings if lens is None else _with_lens(settings, lens)
    cache_lines = _Cache(_cached(cache), _digests(list(by_line.values()), settings, squares), again=lens is not None)
    fiducials_of, refused = _fiducials(list(by_line.values()), search_settings, squares, cache_lines, progress)
    head_shots: dict[int, HeadShot] = {}
    for line in lines:
        if line in refused:
            continue
        try:
            head_shots[line] = _head_shot(by_line[line], fiducials_of[line], search_settings, squares)
        except (NotMeasured, ValueError) as refusal:
            refused[line] = str(refusal)
    if not head_shots:
        line, why = next(iter(refused.items()))
        raise AridcalError(f"{settings.shots}: nothing could be measured. First: line {line}: {why}")
    remarks = [Remark(settings.shots.name, line, "image", by_line[line].image, why) for line, why in refused.items()]
    remarks_all = sorted((*rows.origin.refused, *remarks), key=lambda remark: remark.row or 0)
    measured_rows = rows.select(np.isin(rows.origin.line, list(head_shots)))
    rows = shot_rows(
        measured_rows.with_origin(refused=tuple(remarks_all)), list(head_shots.values()), head_of(settings), campaign
    )
    fiducials = pd.concat([fiducials_of[line] for line in head_shots], ignore_index=True)
    images = sum(cache_lines.lines(line) is None for line in fiducials_of)
    camera = settings.camera
    size = camera.width, camera.height
    return CampaignRows(
        campaign,
        rows,
        Detections(fiducials, settings.tip_camera.homogeneous, camera.intrinsics, size, images),
    )


def _with_lens(settings: HeadSettings, lens: np.ndarray) -> HeadSettings:
    """The head's settings with other intrinsics, shape (9,)."""
    fx, fy, cx, cy, *distortion = lens.tolist()
    changes = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": tuple(distortion)}
    return settings.model_copy(update={"camera": settings.camera.model_copy(update=changes)})


@dataclass(frozen=True)
class _Cache:
    """Fiducials that an earlier run detected.

    Attributes:
        cache: Lines of ``fiducials.csv``, by the line of their shot.
        digests: Of the shots as they are now, by line.
        again: True where fiducials are looked for again, in all images that are there.
    """

    cache: Mapping[int, pd.DataFrame]
    digests: Mapping[int, str]
    again: bool

    def lines(self, shot: int) -> pd.DataFrame | None:
        """Lines of a shot, if their digest is that of the shot as it is now, or if its image is no longer there."""
        lines, digest = self.cache.get(shot), self.digests[shot]
        if lines is None or (digest and (self.again or digest != lines["digest"].iloc[0])):
            return None
        return lines


def shot_rows(rows: Dataset, shots: Sequence[HeadShot], head: Head, campaign: Campaign) -> Dataset:
    """Shots as rows of measurements.

    Args:
        rows: Joints, covariates and split of N shots.
        shots: What was found in each.
        head: As head.yaml declares it.
        campaign: Says what is known of the noise.
    """
    n, (settings,) = len(rows), campaign.blocks
    sigma = 1.0 if settings.noise.rows == "absolute" else None
    block = Block(settings.title, settings.kind, channels(head), (*rows.sigma[:2], sigma), settings.noise.rows)
    dataset = replace(
        rows,
        blocks=(block,),
        observed=packed(shots, head),
        labels=replace(rows.labels, block=np.zeros(n, dtype=int), refers=np.tile([HEAD, *(ROLES - 1) * [""]], (n, 1))),
        instruments=head_things(head),
    )
    return with_declared_noise(dataset, {HEAD: head.state[None]})


def head_things(head: Head) -> Instruments:
    """The head as a thing that rows refer to, held as declared: effects alone change it."""
    held = np.zeros((1, len(head.phi)), dtype=bool)
    things = Things(head.role, (HEAD,), head.state[None], held, np.full(held.shape, np.inf))
    return Instruments({HEAD: things}, world=True)


def _with_head(campaign: Campaign, settings: HeadSettings, table: Table) -> Campaign:
    """The campaign with the target at the camera: ``tip_target`` is T_tip_camera, with head.yaml's value as a hint.

    Columns that describe shots are no covariates.
    """
    shot_columns = [name for name in ("image", "square", "shot", *range_columns(settings)) if name in table.names]
    ignore = dict.fromkeys((*campaign.measurements.ignore, *shot_columns))
    measurements = campaign.measurements.model_copy(update={"ignore": tuple(ignore)})
    mount = FrameSettings(xyz=settings.tip_camera.xyz, rpy=settings.tip_camera.rpy)
    frames = campaign.frames.model_copy(update={"tip_target": mount})
    return campaign.model_copy(update={"measurements": measurements, "frames": frames})


def _fiducials(
    shots: Sequence[Shot],
    settings: HeadSettings,
    squares: Mapping[int, np.ndarray],
    cached: _Cache,
    progress: Progress,
) -> tuple[dict[int, pd.DataFrame], dict[int, str]]:
    """The fiducials of each shot, and the reasons of shots without any.

    Returns:
        Lines of the cache (M, 8) by the line of their shot; refusals likewise.
    """
    lines_of = {shot.line: lines for shot in shots if (lines := cached.lines(shot.line)) is not None}
    unread = [shot for shot in shots if shot.line not in lines_of]
    refused: dict[int, str] = {}
    if unread:
        progress(f"reading {len(unread)} images")
    for measured in progress.through(measure_shots(unread, settings, squares), len(unread), "images"):
        line = measured.shot.line
        if measured.fiducials is None:
            refused[line] = measured.why
        else:
            lines_of[line] = _lines(line, measured.fiducials).assign(digest=cached.digests[line])
    return lines_of, refused


def _lines(shot: int, fiducials: Fiducials) -> pd.DataFrame:
    """Write the fiducials of a shot as lines of the cache, less the digest.

    Of a centre's covariance the standard deviations along u and v are kept.
    """
    sigma = np.sqrt(np.diagonal(fiducials.covariances, axis1=1, axis2=2))
    numbers = np.round(np.hstack([fiducials.pixels, sigma]), CACHE_DECIMALS)
    lines = pd.DataFrame(numbers, columns=list(NUMBER_COLUMNS))
    lines.insert(0, "shot", shot)
    lines.insert(1, "square", fiducials.layout.square)
    lines.insert(2, "fiducial", fiducials.layout.fiducial)
    return lines


def _digests(shots: Sequence[Shot], settings: HeadSettings, squares: Mapping[int, np.ndarray]) -> dict[int, str]:
    """Digests of all that the fiducials of each shot depend on, by its line."""
    places = sorted((index, T.tobytes()) for index, T in squares.items())
    about = repr((settings.camera, settings.sonars, settings.target, places))
    return {shot.line: _digest(shot, settings, about) for shot in shots}


def _digest(shot: Shot, settings: HeadSettings, about: str) -> str:
    """Digest of all that the fiducials of a shot depend on; empty if its image is missing."""
    try:
        content = image_content(shot.image, settings)
    except NotMeasured:
        return "" if not os.path.lexists(settings.shots.parent / shot.image) else UNREADABLE
    place = f"{shot.square} {shot.T_world_camera} {about}"
    return hashlib.sha256(content + shot.ranges.tobytes() + place.encode()).hexdigest()[:DIGEST_LENGTH]


def _cached(cache: Path | None) -> dict[int, pd.DataFrame]:
    """Read the fiducials by the line of their shot; a cache that cannot be read is none."""
    if cache is None or not cache.is_file():
        return {}
    try:
        table = read_tables([cache])
        table.require(CACHE_COLUMNS)
    except MeasurementError:
        return {}
    lines = pd.DataFrame({name: table.numbers(name)[0] for name in (*INDEX_COLUMNS, *NUMBER_COLUMNS)})
    if table.refused or not np.isfinite(lines.to_numpy()).all():
        return {}
    lines = lines.astype(dict.fromkeys(INDEX_COLUMNS, int))
    lines["digest"] = table.texts("digest")
    by_shot = (shot_lines.reset_index(drop=True) for _, shot_lines in lines.groupby("shot", sort=False))
    return {int(shot_lines["shot"].iloc[0]): shot_lines for shot_lines in by_shot}


def _head_shot(shot: Shot, lines: pd.DataFrame, settings: HeadSettings, squares: Mapping[int, np.ndarray]) -> HeadShot:
    """A shot with its fiducials' places on the square that is listed first, checked to fit a pose.

    Raises:
        NotMeasured: They do not, or a range is wrong.
        ValueError: Likewise.
    """
    sonars = read_ranges(shot.ranges, settings)
    index = int(lines["square"].iloc[0])
    points = _places(lines, index, settings, squares)
    if not spans_plane(points):
        raise NotMeasured("three fiducials that are not on one line are needed")
    pixels = lines[["u", "v"]].to_numpy()
    sigma = lines[["std_u", "std_v"]].to_numpy()
    start = start_anywhere(points, pixels, sonars, settings.camera.intrinsics)
    covariances = sigma[:, :, None] ** 2 * np.eye(2)
    head_shot = HeadShot(points, pixels, covariances, shot.ranges, squares[index], start)
    check_pose(head_shot, head_of(settings))
    return head_shot


def _places(lines: pd.DataFrame, index: int, settings: HeadSettings, squares: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return the places of fiducials, or of a board's corners, in the frame of one square, shape (M, 3), [m]."""
    number = lines["fiducial"].to_numpy()
    if settings.target == "charuco":
        return corner_places(board(settings))[number]
    T_own_world = np.linalg.inv(squares[index])
    T_own_square = np.array([T_own_world @ squares[int(k)] for k in lines["square"]])
    xy_axes, origin = T_own_square[:, :3, :2], T_own_square[:, :3, 3]
    return np.asarray(np.einsum("nij,nj->ni", xy_axes, FIDUCIAL_CENTRES[number - 1]) + origin)
