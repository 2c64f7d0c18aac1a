"""The chain from shots to the calibrated arm: error of poses never measured, against an oracle that knows the true form.

    python benchmarks/chain.py --cases 20
    python benchmarks/chain.py --cases 2 --images

The ARID of ``identification/arid-strip``, 120 shots, its constants drawn anew for each seed. By default the fiducials are
drawn with the noise that the detector states of them; with ``--images`` they are found in JPEG images with 2 grey levels of
noise. Sonars have 0.25 mm. The oracle is a bundle adjustment of its own: it knows which constants and which number of the
head are off, and fits those alone to all image points and ranges at once. Errors are those of the camera's pose at
configurations never measured, without noise.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.catalogue import declared
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.identifiable import identifiable
from aridcal.engine.instruments.camera import predict_pixels
from aridcal.engine.instruments.camera_sonar import Head, HeadShot, predict_ranges, square_motion
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.rows.dataset import dataset
from aridcal.engine.search.loop import calibrated_arm, fit_constants
from aridcal.files.campaign import Campaign, FrameSettings
from aridcal.files.yaml_file import load_settings, parse_settings
from aridcal.jobs.head1992.detections import head_things, shot_rows
from aridcal.jobs.head1992.head_settings import HeadSettings, load_squares
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.head1992.render import Optics, photograph, read_sonars
from aridcal.jobs.head1992.shot_rows import head_of, start_anywhere
from aridcal.jobs.head1992.shots import sight
from aridcal.jobs.head1992.square import layout
from aridcal.jobs.head1992.square_pose import Sonars
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.viewpoints import draw_views
from aridcal.system.progress import SILENT

STRIP = Path(__file__).parents[1] / "identification" / "arid-strip"
N, QUERIES = 120, 400
GREY = 2.0  # standard deviation of an image's noise, [grey levels]
PIXEL_STD = (0.008, 0.025)  # [px] of a fiducial, as the detector states it
CASES = {
    "clean": "",
    "k1 = -0.02": "{kind: lens_distortion, where: camera, motion: k1}",
    "sonar 3 reads 3 mm more": "{kind: sonar_bias, where: sonar_3}",
    "sonars read 1 % more": "{kind: sonar_scale, where: sonars}",
    "focal length off by 0.5 %": "{kind: focal_length, where: camera}",
    "camera 2 mm and 5 mrad off": "",
    "elbow gives way": "",
    "elbow gives way, k1 = -0.02": "{kind: lens_distortion, where: camera, motion: k1}",
}
ELBOW = Coefficient("joint_3", "axis", Basis("linear", ("joint_3.gravity_torque",), (0.0,)))
GIVES = 1e-6  # [rad/Nm]
GRAVITY = np.array([0.0, 9.81, 0.0])
SIZES = {"k1": -0.02, "bias": 3e-3, "scale": 0.01, "f": 3.5}


@dataclass(frozen=True)
class Trial:
    """One seed of one case: what was named, and errors of position [m] and rotation [rad], RMS over the queries."""

    named: tuple[str, ...]
    right: bool
    before: np.ndarray
    after: np.ndarray
    oracle: np.ndarray
    seconds: float


def campaign(effect: str = "", search: bool = True) -> Campaign:
    text = f"""format: 1
robot: {{urdf: {STRIP.parents[1] / "urdf" / "arid.urdf"}, base: base_link, tip: flange, gravity: [0, 9.81, 0]}}
measurements: {{kind: camera_sonar, head: head.yaml}}
effects: [{effect}]
diagnosis: {{enabled: {str(search).lower()}}}
"""
    return parse_settings(text, STRIP / "campaign.yaml", Campaign)


def trial(job: tuple[str, int, bool]) -> Trial:
    case, seed, images = job
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, 7])
    settings = load_settings(STRIP / "head.yaml", HeadSettings)
    scenario = load_settings(STRIP / "scenario.yaml", Scenario)
    robot = load_robot(STRIP.parents[1] / "urdf" / "arid.urdf", "flange")
    optics = Optics(settings.camera.width, settings.camera.height, load_squares(settings.squares))
    start = head_of(settings)
    seen_by = ObservedRows(robot, {}, (), stated_components=head_things(start).held)
    wrong = [declared(seen_by, e, case) for e in campaign(CASES[case]).effects]
    phi = start.phi
    for e in wrong:
        phi = phi + directions(start, e.coefficients) @ [SIZES[c.component] for c in e.coefficients]
    head = replace(start, phi=phi)

    names = [Coefficient(*n.split(".")) for n in scenario.truth.parameters]  # type: ignore[arg-type]
    theta = np.array([p.std for p in scenario.truth.parameters.values()]) * rng.standard_normal(len(names))
    if "elbow" in case:
        names, theta = [*names, ELBOW], np.append(theta, GIVES)
    base = scenario.truth.frames.world_base
    assert base is not None
    T_world_base = pin.SE3(pin.rpy.rpyToMatrix(*base.rpy), np.array(base.xyz))
    T_tip_camera = pin.SE3(settings.tip_camera.homogeneous)
    if "mrad" in case:
        T_tip_camera = T_tip_camera * pin.exp6(np.r_[2e-3 * _unit(rng), 5e-3 * _unit(rng)])
    frames = ((None, T_world_base),), ((None, T_tip_camera),)
    model = Model(robot, tuple(names), *frames, Surroundings(GRAVITY, T_tip_camera.translation))
    nominal = replace(model, coefficients=())
    q, square = draw_views(nominal, optics, settings.camera.intrinsics, N, rng, case)
    T = _poses(model, theta, q)
    square = np.array([optics.nearest(pose) for pose in T])
    seen = []
    for k in range(N):
        if images:
            seen.append(_found(T[k], int(square[k]), optics, head, settings, rng))
        else:
            seen.append(_drawn(T[k], int(square[k]), optics, head, start, rng))
    kept = np.array([s is not None for s in seen])
    found = tuple(s for s in seen if s is not None)

    job_given = campaign()
    mount = FrameSettings(xyz=settings.tip_camera.xyz, rpy=settings.tip_camera.rpy)
    asked = job_given.model_copy(update={"frames": job_given.frames.model_copy(update={"tip_target": mount})})
    nowhere = np.full((kept.sum(), 3), np.nan), np.full((kept.sum(), 3, 3), np.nan)
    rows = dataset(robot.readings, robot.kinds, q[kept], *nowhere)
    began = time.perf_counter()
    rows = shot_rows(rows, found, start, asked)
    geometry = fit_constants(asked.question, robot, rows, ())
    arm = calibrated_arm(asked.question, robot, rows, (), geometry, SILENT)
    seconds = time.perf_counter() - began
    low, high = q.min(axis=0), q.max(axis=0)
    anywhere = rng.uniform(low, high, (QUERIES, len(low)))
    true = _poses(model, theta, anywhere)
    final, plain = arm.diagnosed.fit, geometry.geometric
    oracle = _oracle(model, found, q[kept], start, directions(start, [c for e in wrong for c in e.coefficients]))
    truth = {(e.kind, e.where) for e in wrong} | ({("joint_compliance", "joint_3")} if "elbow" in case else set())
    said = [a.effect for a in arm.diagnosed.stepwise.state.active]
    return Trial(
        tuple(e.label for e in said),
        {(e.kind, e.where) for e in said} == truth,
        _error(_poses(plain.model, plain.theta, anywhere), true),
        _error(_poses(final.model, final.theta, anywhere), true),
        _error(_poses(*oracle, anywhere), true),
        seconds,
    )


def directions(head: Head, coefficients: Sequence[Coefficient]) -> np.ndarray:
    """Which of the head's numbers each coefficient moves, shape (H, d)."""
    H = np.zeros((len(head.phi), len(coefficients)))
    for k, c in enumerate(coefficients):
        H[list(head.role.moved_by(c.where, c.component)), k] = 1.0
    return H


def _unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def _poses(model: Model, theta: np.ndarray, q: np.ndarray) -> np.ndarray:
    R, p = model.poses(theta, model.rows(q))
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = R, p
    return T


def _error(T: np.ndarray, true: np.ndarray) -> np.ndarray:
    turn = np.array([pin.log3(a[:3, :3].T @ b[:3, :3]) for a, b in zip(T, true, strict=True)])
    off = T[:, :3, 3] - true[:, :3, 3]
    return np.sqrt([np.mean(np.sum(off**2, axis=1)), np.mean(np.sum(turn**2, axis=1))])


def _drawn(T: np.ndarray, own: int, optics: Optics, head: Head, start: Head, rng: np.random.Generator) -> HeadShot:
    """Image points of all fiducials in view, with noise of their stated covariances."""
    near = optics.seen(T, own)
    marks = layout({k: optics.squares[k] for k in near}, own)
    corners, _, _ = predict_pixels(near[own], marks.corners, head.intrinsics)
    inside = np.all((corners > 3) & (corners < optics.width - 4), axis=(1, 2))
    marks = marks[inside]
    pixels, _, _ = predict_pixels(near[own], marks.centres, head.intrinsics)
    sigma = rng.uniform(*PIXEL_STD, pixels.shape)
    pixels = pixels + sigma * rng.standard_normal(pixels.shape)
    h = read_sonars(near[own], head, rng)
    sonars = Sonars(h, head.positions, head.measures, head.std)
    at = start_anywhere(marks.centres, pixels, sonars, start.intrinsics)
    return HeadShot(marks.centres, pixels, sigma[:, :, None] ** 2 * np.eye(2), h, optics.squares[own], at)


def _found(
    T: np.ndarray, own: int, optics: Optics, head: Head, settings: HeadSettings, rng: np.random.Generator
) -> HeadShot | None:
    """The same as the detector finds it in an image."""
    content, h = photograph(T, own, optics, head, rng, GREY)
    image = np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE))
    sonars = Sonars(h, head.positions, head.measures, head.std)
    try:
        seen = sight(image, sonars, own, dict(optics.squares), settings)
    except NotMeasured:
        return None
    f = seen.fiducials
    return HeadShot(f.layout.centres, f.pixels, f.covariances, h, optics.squares[own], f.T_camera_square)


def _oracle(
    model: Model, seen: tuple[HeadShot, ...], q: np.ndarray, start: Head, H: np.ndarray
) -> tuple[Model, np.ndarray]:
    """Bundle adjustment: constants, both frames and the head's wrong number from all image points and ranges at once."""
    frames = [Coefficient(where, c) for where in ("world_base", "tip_target") for c in FRAME_COMPONENTS]
    varying = [c for c in model.coefficients if not c.basis.constant]
    coefficients = [*frames, *constants(model.robot, "full"), *varying]
    moving = model.with_coefficients(coefficients)
    theta, phi = np.zeros(len(coefficients)), np.zeros(H.shape[1])
    kept = np.zeros(0, dtype=int)
    for _ in range(8):
        A, b = _whitened(moving, theta, seen, q, replace(start, phi=start.phi + H @ phi), H)
        if len(kept) == 0:
            R = np.asarray(np.linalg.qr(A[:, : len(theta)], mode="r"))
            kept = np.array([*sorted(identifiable(R, range(len(theta))).independent), *range(len(theta), A.shape[1])])
        scale = 1.0 / np.linalg.norm(A[:, kept], axis=0)
        step = np.zeros(A.shape[1])
        step[kept] = scale * np.linalg.lstsq(A[:, kept] * scale, b, rcond=None)[0]
        theta, phi = theta + step[: len(theta)], phi + step[len(theta) :]
    return moving, theta


def _whitened(
    model: Model, theta: np.ndarray, seen: tuple[HeadShot, ...], q: np.ndarray, head: Head, H: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    R, p, J = model.jacobian(theta, model.rows(q))
    blocks, right = [], []
    S = len(head.positions)
    for k, s in enumerate(seen):
        T_world_camera = np.eye(4)
        T_world_camera[:3, :3], T_world_camera[:3, 3] = R[k], p[k]
        T = np.linalg.inv(T_world_camera) @ s.T_world_square
        T_square_camera = np.linalg.inv(T)
        by_theta = np.linalg.solve(square_motion(s.T_world_square[None, :3, :3], T_square_camera[None, :3, 3])[0], J[k])
        pixels, by_twist, by_phi = predict_pixels(T, s.points, head.intrinsics)
        h, h_by_twist = predict_ranges(T, head.positions, head.measures)
        stretch = 1.0 + head.scale
        L = np.linalg.inv(np.linalg.cholesky(s.covariances))
        wide = np.zeros((2 * len(pixels) + S, len(head.phi)))
        wide[:-S, :9] = (L @ by_phi).reshape(-1, 9)
        wide[-S:, 9 : 9 + S], wide[-S:, 9 + S :] = np.eye(S) / head.std, np.diag(h) / head.std
        B = np.concatenate([(L @ by_twist).reshape(-1, 6), stretch[:, None] * h_by_twist / head.std])
        blocks.append(np.hstack([B @ by_theta, wide @ H]))
        off = (L @ (s.pixels - pixels)[:, :, None]).ravel()
        right.append(np.concatenate([off, (s.ranges - stretch * h - head.bias) / head.std]))
    return np.concatenate(blocks), np.concatenate(right)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10, help="seeds of each case")
    parser.add_argument("--seed", type=int, default=0, help="the first of them")
    parser.add_argument("--images", action="store_true", help="find the fiducials in images")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    jobs = [(c, arguments.seed + s, arguments.images) for c in CASES for s in range(arguments.cases)]
    with ProcessPoolExecutor(arguments.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        trials = list(pool.map(trial, jobs))
    print(
        f"{N} shots, {arguments.cases} arms each; RMS of position [um] and rotation [urad] over {QUERIES} poses, median"
    )
    print(
        f"{'case':30}{'named':>8}{'before':>16}{'after':>16}{'oracle':>16}{'over the oracle: median, worst':>34}{'s':>6}"
    )
    for case in CASES:
        own = [t for (c, _, _), t in zip(jobs, trials, strict=True) if c == case]
        shown = [1e6 * np.median([getattr(t, n) for t in own], axis=0) for n in ("before", "after", "oracle")]
        ratio = np.array([t.after[0] / t.oracle[0] for t in own])
        cells = "".join(f"{v[0]:9.1f} {v[1]:6.1f}" for v in shown)
        named = f"{sum(t.right for t in own)}/{len(own)}"
        print(
            f"{case:30}{named:>8}{cells}{np.median(ratio):26.3f} {ratio.max():7.3f}{np.median([t.seconds for t in own]):6.1f}"
        )
        for t in own:
            if not t.right:
                print(f"    said: {', '.join(t.named) or 'nothing'}")


if __name__ == "__main__":
    main()
