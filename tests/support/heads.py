"""Shots of a measuring head on the ARID that several test files share: drawn with their noise, no images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from repository import ROOT

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.stages import Geometry
from aridcal.engine.instruments.camera import predict_pixels
from aridcal.engine.instruments.camera_sonar import Head, HeadShot
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.search.loop import CalibratedArm, calibrated_arm, fit_constants
from aridcal.files.campaign import Campaign, FrameSettings
from aridcal.files.yaml_file import load_settings, parse_settings
from aridcal.jobs.head1992.detections import shot_rows
from aridcal.jobs.head1992.head_settings import HeadSettings, load_squares
from aridcal.jobs.head1992.render import Optics, read_sonars
from aridcal.jobs.head1992.shot_rows import head_of, start_anywhere
from aridcal.jobs.head1992.square import layout
from aridcal.jobs.head1992.square_pose import Sonars
from aridcal.jobs.simulate.viewpoints import draw_views
from aridcal.system.progress import SILENT

STRIP = ROOT / "identification" / "arid-strip"
SETTINGS = load_settings(STRIP / "head.yaml", HeadSettings)
START = head_of(SETTINGS)
OPTICS = Optics(512, 512, load_squares(SETTINGS.squares))
ARID = load_robot(ROOT / "urdf" / "arid.urdf", "flange")
T_WORLD_BASE = pin.SE3(pin.rpy.rpyToMatrix(-1.569, 0.001, -1.572), np.array([0.004, -0.003, 0.002]))
T_TIP_CAMERA = pin.SE3(pin.rpy.rpyToMatrix(0.004, 1.5738, 0.002), np.array([0.101, -0.001, 0.0013]))
OFF = [  # constants that are wrong, and by how much: [m] and [rad]
    ("joint_2.pitch", 1e-3), ("joint_3.x", -2e-3), ("joint_3.yaw", 1.5e-3), ("joint_3.roll", -1e-3), ("joint_4.pitch", 2e-3),
]  # fmt: skip
MODEL = Model(
    ARID, tuple(Coefficient(*name.split(".")) for name, _ in OFF), ((None, T_WORLD_BASE),), ((None, T_TIP_CAMERA),)
)
THETA = np.array([value for _, value in OFF])


def moved(**numbers: float) -> Head:
    """The head of arid-strip with some of its numbers changed: ``camera_k1=-0.02``, ``sonar_2_bias=3e-3``."""
    phi = START.phi.copy()
    for name, value in numbers.items():
        phi[START.names.index(".".join(name.rsplit("_", 1)))] += value
    return replace(START, phi=phi)


def poses(model: Model, theta: np.ndarray, q: np.ndarray) -> np.ndarray:
    """T_world_camera, shape (N, 4, 4)."""
    R, p = model.poses(theta, model.rows(q))
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = R, p
    return T


def views(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Readings (n, 4) and the square that each looks at."""
    nominal = replace(MODEL, coefficients=())
    return draw_views(nominal, OPTICS, START.intrinsics, n, np.random.default_rng(seed), "test")


def look(T_world_camera: np.ndarray, own: int, head: Head, rng: np.random.Generator, noise: float = 1.0) -> HeadShot:
    """What one shot sees: fiducials wholly in view, with the noise that is stated of them, or ``noise`` times that."""
    near = OPTICS.seen(T_world_camera, own)
    marks = layout({k: OPTICS.squares[k] for k in near}, own)
    corners, _, _ = predict_pixels(near[own], marks.corners, head.intrinsics)
    marks = marks[np.all((corners > 3) & (corners < 508), axis=(1, 2))]
    pixels, _, _ = predict_pixels(near[own], marks.centres, head.intrinsics)
    sigma = rng.uniform(0.01, 0.03, pixels.shape)
    pixels = pixels + noise * sigma * rng.standard_normal(pixels.shape)
    h = read_sonars(near[own], replace(head, std=noise * head.std), rng)
    start = start_anywhere(marks.centres, pixels, Sonars(h, head.positions, head.measures, head.std), START.intrinsics)
    return HeadShot(marks.centres, pixels, sigma[:, :, None] ** 2 * np.eye(2), h, OPTICS.squares[own], start)


def campaign(more: str = "", rows: str = "relative") -> Campaign:
    """The job of arid-strip, its target at the camera."""
    text = f"""format: 1
robot: {{urdf: {ROOT / "urdf" / "arid.urdf"}, base: base_link, tip: flange, gravity: [0, 9.81, 0]}}
measurements: {{kind: camera_sonar, head: head.yaml, noise: {{rows: {rows}}}}}
{more}"""
    job = parse_settings(text, STRIP / "campaign.yaml", Campaign)
    mount = FrameSettings(xyz=SETTINGS.tip_camera.xyz, rpy=SETTINGS.tip_camera.rpy)
    return job.model_copy(update={"frames": job.frames.model_copy(update={"tip_target": mount})})


@dataclass(frozen=True)
class Shots:
    """A campaign of shots."""

    campaign: Campaign
    rows: Dataset
    seen: tuple[HeadShot, ...]


def shots(
    n: int,
    head: Head,
    seed: int = 0,
    more: str = "",
    model: Model = MODEL,
    theta: np.ndarray = THETA,
    noise: str = "relative",
) -> tuple[Shots, np.ndarray]:
    """A campaign of n shots, and its readings."""
    q, square = views(n, seed)
    rng = np.random.default_rng([seed, 1])
    T = poses(model, theta, q)
    seen = tuple(look(T[k], int(square[k]), head, rng) for k in range(n))
    rows = dataset(ARID.readings, ARID.kinds, q, np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan))
    rows = rows.with_origin(files=(Path("shots.csv"),), split_given=True)
    job = campaign(more, noise)
    return Shots(job, shot_rows(rows, seen, START, job), seen), q


def calibrated(given: Shots) -> tuple[CalibratedArm, Geometry]:
    """The arm and the head, and the geometry with the head as declared."""
    geometry = fit_constants(given.campaign.question, ARID, given.rows, ())
    return calibrated_arm(given.campaign.question, ARID, given.rows, (), geometry, SILENT), geometry
