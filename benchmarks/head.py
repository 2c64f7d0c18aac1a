"""The measuring head on rendered images: accuracy against the Cramér-Rao bound, hard images, empty images, sonars, speed.

    python benchmarks/head.py accuracy --views 100
    python benchmarks/head.py hard --images 1000
    python benchmarks/head.py empty --images 200
    python benchmarks/head.py sonar
    python benchmarks/head.py speed --images 60

Truth comes from ``aridcal.jobs.head1992.render``, which computes areas covered, supersampled and blurred, and shares no edge
model with the detector. Every image has its own seed, so that any of them can be made again; ``--first`` takes others. What
each figure should be stands behind it in brackets.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pinocchio as pin

from aridcal.engine.instruments.camera import DOTY_OPENCV, predict_pixels
from aridcal.engine.instruments.camera_sonar import predict_ranges
from aridcal.jobs.head1992.fiducials import Fiducials, find_fiducials
from aridcal.jobs.head1992.matching import NotMeasured, spans_plane
from aridcal.jobs.head1992.render import Glare, ImageAppearance, Patch, coverage, light_map, render
from aridcal.jobs.head1992.sonar import doty_plane, fit_plane, ranges
from aridcal.jobs.head1992.square import INCH, FiducialLayout, layout, strip_placements
from aridcal.jobs.head1992.square_pose import Pose, Sonars, measure_pose

WIDTH = HEIGHT = 512
INTRINSICS = np.array([700.0, 700.0, 255.5, 255.5, 0, 0, 0, 0, 0])
SONARS_AT = 2 * INCH * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
SONAR_STD = 2.5e-4
STRIP = strip_placements(5)
OWN = 2
SQUARES = dict(enumerate(STRIP))
AROUND = layout(SQUARES, OWN)
ALONE = layout({OWN: STRIP[OWN]}, OWN)
WRONG_SIGMA, WRONG_M = 5.0, 1e-3
PROCESSES = 2
KINDS = 6  # of images without a usable square


@dataclass(frozen=True)
class View:
    """A view of the strip: pose of the own square, its image, its ranges, and which fiducials of the layout are clean."""

    T: np.ndarray
    image: np.ndarray
    sonars: Sonars
    clean: np.ndarray
    usable: bool


def random_pose(rng: np.random.Generator, tilt_deg: float = 12.0, off_inch: float = 1.5) -> np.ndarray:
    """Draw T_camera_square: any turn, tilt up to 12 degrees, range 0.18 to 0.45 m, off centre by up to 1.5 in."""
    direction = rng.uniform(0, 2 * np.pi)
    tilt = np.radians(tilt_deg) * np.sqrt(rng.random())
    T = np.eye(4)
    T[:3, :3] = DOTY_OPENCV @ pin.exp3(tilt * np.array([np.cos(direction), np.sin(direction), 0]))
    T[:3, :3] = T[:3, :3] @ pin.exp3(np.array([0, 0, rng.uniform(-np.pi, np.pi)]))
    on_axis = np.array([*rng.uniform(-off_inch, off_inch, 2) * INCH, 0])
    T[:3, 3] = [0, 0, rng.uniform(0.18, 0.45)] - T[:3, :3] @ on_axis
    return T


def strip_seen(T: np.ndarray) -> dict[int, np.ndarray]:
    return {k: T @ np.linalg.inv(STRIP[OWN]) @ S for k, S in SQUARES.items()}


def in_view(T: np.ndarray, marks: FiducialLayout, margin: float = 2.0) -> np.ndarray:
    corners, _, _ = predict_pixels(T, marks.corners, INTRINSICS)
    return np.all((corners > margin) & (corners < WIDTH - 1 - margin), axis=(1, 2))


def sonars(T: np.ndarray, rng: np.random.Generator) -> Sonars:
    h, _ = predict_ranges(T, SONARS_AT, "perpendicular")
    return Sonars(h + SONAR_STD * rng.standard_normal(4), SONARS_AT, "perpendicular", SONAR_STD)


def clean_view(seed: int) -> View:
    rng = np.random.default_rng(seed)
    while True:
        T = random_pose(rng)
        clean = in_view(T, AROUND)
        if clean[:6].sum() >= 4:
            image = render(strip_seen(T), INTRINSICS, WIDTH, HEIGHT, ImageAppearance(), rng)
            return View(T, image, sonars(T, rng), clean, True)


def blot(rng: np.random.Generator, u: float, v: float, radius: float, reflectance: float) -> Patch:
    angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
    reach = radius * rng.uniform(0.5, 1, 9)
    return Patch(np.column_stack([u + reach * np.cos(angles), v + reach * np.sin(angles)]), reflectance)


def hard_view(seed: int) -> View:
    """Blur, uneven light, noise, dirt, wrong pixels, glare, occlusion, cut off, upside down, inverted, low contrast: a mix."""
    rng = np.random.default_rng(10_000 + seed)
    T = random_pose(rng, off_inch=1.9)
    scale = INTRINSICS[0] / T[2, 3]
    paper, ink = rng.uniform(0.65, 0.9), rng.uniform(0.05, 0.2)
    if rng.random() < 0.3:  # low contrast
        ink = paper - rng.uniform(0.12, 0.3)
    if rng.random() < 0.3:
        paper, ink = ink, paper
    patches = []
    if rng.random() < 0.6:  # dirt, 0.4 to 2.5 mm
        for _ in range(rng.integers(1, 9)):
            radius = scale * rng.uniform(0.0004, 0.0025)
            patches.append(blot(rng, rng.uniform(0, 511), rng.uniform(0, 511), radius, rng.uniform(0, 0.95)))
    if rng.random() < 0.4:  # obstacles over some fiducials
        seen = predict_pixels(T, ALONE.centres, INTRINSICS)[0]
        for k in rng.choice(6, rng.integers(1, 3), replace=False):
            at = seen[k] + scale * rng.uniform(-0.004, 0.004, 2)
            patches.append(blot(rng, at[0], at[1], scale * rng.uniform(0.005, 0.02), rng.uniform(0, 0.95)))
    glares = [
        Glare(rng.uniform(0, 511), rng.uniform(0, 511), rng.uniform(20, 120), rng.uniform(0.1, 0.6))
        for _ in range(rng.integers(0, 3) if rng.random() < 0.4 else 0)
    ]
    scene = ImageAppearance(
        paper=paper,
        ink=ink,
        surroundings=rng.uniform(0.05, 0.95),
        light=tuple(rng.uniform(-0.3, 0.3, 2)),
        blur=rng.uniform(0.2, 2.0),
        noise=rng.uniform(1, 6),
        patches=patches,
        glares=glares,
        wrong_pixels=rng.uniform(0, 0.004) if rng.random() < 0.4 else 0.0,
    )
    image = render(strip_seen(T), INTRINSICS, WIDTH, HEIGHT, scene, rng)
    clean = clean_fiducials(T, scene)
    corner = clean & (AROUND.fiducial == 1)
    usable = clean[:6].sum() >= 4 and spans_plane(AROUND.centres[:6][clean[:6]]) and bool(corner.any())
    usable &= abs(ink - paper) * 255 * 0.5 > 4 * scene.noise  # the darkest corner has about half the light
    return View(T, image, sonars(T, rng), clean, bool(usable))


def clean_fiducials(T: np.ndarray, scene: ImageAppearance) -> np.ndarray:
    """Tell which fiducials are wholly in view and neither covered nor washed out, shape (M,)."""
    outlines, _, _ = predict_pixels(T, AROUND.corners, INTRINSICS)
    hidden = np.zeros((HEIGHT, WIDTH))
    for patch in scene.patches:
        hidden += coverage(patch.outline[None], WIDTH, HEIGHT)
    plain = replace(scene, patches=(), blur=0.0)
    hidden += light_map(strip_seen(T), INTRINSICS, WIDTH, HEIGHT, plain) > 250
    clean = in_view(T, AROUND)
    for k in np.flatnonzero(clean):
        middle = outlines[k].mean(axis=0)
        around = middle + 1.25 * (outlines[k] - middle)
        low, high = np.floor(around.min(axis=0)).astype(int) - 1, np.ceil(around.max(axis=0)).astype(int) + 2
        low, high = np.clip(low, 0, WIDTH), np.clip(high, 0, WIDTH)
        part = hidden[low[1] : high[1], low[0] : high[0]]
        clean[k] = np.sum(part * coverage(around[None] - low, *(high - low))) < 0.5
    return clean


def empty_view(seed: int) -> View:
    """An image without a usable square: bare, clutter of the right sizes, boards, textures, a square all but hidden."""
    rng = np.random.default_rng(50_000 + seed)
    T = random_pose(rng)
    scene = ImageAppearance(blur=rng.uniform(0.3, 1.5), noise=rng.uniform(1, 6), surroundings=rng.uniform(0.1, 0.9))
    kind, seen = seed % KINDS, strip_seen(T)
    scale = INTRINSICS[0] / T[2, 3]
    if kind in (0, 5):
        seen = {}
    elif kind == 1:  # rectangles of the fiducials' sizes, anywhere
        seen, patches = {}, []
        for _ in range(rng.integers(5, 40)):
            turn = rng.uniform(0, np.pi)
            axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            size = 0.25 * INCH * scale * np.array([1, rng.choice([1, 1, 2])])
            corners = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]) * size
            patches.append(Patch(rng.uniform(20, 490, 2) + corners @ axes, rng.uniform(0, 0.2)))
        scene = replace(scene, patches=patches, surroundings=0.8)
    elif kind == 2:  # a chessboard
        seen, side = {}, 0.25 * INCH * scale * rng.uniform(0.8, 1.2)
        u, v = np.meshgrid(np.arange(0, WIDTH, side), np.arange(0, HEIGHT, side))
        even = (np.rint(u / side + v / side) % 2 == 0).ravel()
        corners = np.array([[0, 0], [side, 0], [side, side], [0, side]])
        patches = [Patch(corners + [a, b], 0.1) for a, b in zip(u.ravel()[even], v.ravel()[even], strict=True)]
        scene = replace(scene, patches=patches[:400], surroundings=0.8)
    elif kind == 3:  # at most two fiducials left uncovered
        places = predict_pixels(T, AROUND.centres, INTRINSICS)[0]
        spared = rng.choice(6, 2, replace=False)
        patches = [
            blot(rng, p[0], p[1], scale * 0.03, 0.5)
            for k, p in enumerate(places)
            if k not in spared and np.all(np.abs(p) < 800)
        ]
        full = [
            Patch(p + scale * 0.0075 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]), 0.8)
            for k, p in enumerate(places)
            if k not in spared and np.all(np.abs(p) < 800)
        ]
        scene = replace(scene, patches=full if rng.random() < 0.5 else patches + full)
    elif kind == 4:  # blurred beyond use
        scene = replace(scene, blur=scale * 0.25 * INCH * rng.uniform(0.8, 1.5), noise=max(scene.noise, 3.0))
    image = render(seen, INTRINSICS, WIDTH, HEIGHT, scene, rng)
    if kind == 5:  # a texture with spots of about a fiducial's size
        spots = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH)), (0, 0), scale * INCH * rng.uniform(0.04, 0.16))
        there = spots > np.quantile(spots, rng.uniform(0.3, 0.9))
        image = np.where(there, rng.uniform(10, 120), image).astype(np.uint8)
    return View(T, image, sonars(T, rng), np.zeros(len(AROUND), dtype=bool), False)


def measure(view: View, marks: FiducialLayout) -> tuple[Fiducials, Pose]:
    found = find_fiducials(view.image, marks, INTRINSICS, view.sonars)
    return found, measure_pose(
        found.layout.centres, found.pixels, found.covariances, view.sonars, INTRINSICS, found.T_camera_square
    )


def twist_error(T_found: np.ndarray, T: np.ndarray) -> np.ndarray:
    return np.asarray(pin.log6(pin.SE3(np.linalg.inv(T_found) @ T)).vector)


def information(T: np.ndarray, used: FiducialLayout, noise: float = 2.0) -> np.ndarray:
    """Fisher information of the pose in the pixels around the fiducials used and in the ranges, from the renderer."""
    steps = np.array([2e-5] * 3 + [2e-4] * 3)

    def seen(twist: np.ndarray) -> np.ndarray:
        return light_map(strip_seen(T @ pin.exp6(twist).homogeneous), INTRINSICS, WIDTH, HEIGHT, ImageAppearance())

    D = np.array([(seen(s * e) - seen(-s * e)) / (2 * s) for s, e in zip(steps, np.eye(6), strict=True)])
    wide = replace(used, sizes=used.sizes + 2 * 0.0028)
    near = coverage(predict_pixels(T, wide.corners, INTRINSICS)[0][:, ::-1], WIDTH, HEIGHT) > 0.5
    J = D[:, near]
    _, J_h = predict_ranges(T, SONARS_AT, "perpendicular")
    return J @ J.T / (noise**2 + 1 / 12) + J_h.T @ J_h / SONAR_STD**2


def _accuracy(job: tuple[int, bool]) -> dict[str, np.ndarray]:
    seed, own_only = job
    cv2.setNumThreads(1)
    view = clean_view(seed)
    found, pose = measure(view, ALONE if own_only else AROUND)
    error = twist_error(pose.T_camera_square, view.T)
    truth, _, _ = predict_pixels(view.T, found.layout.centres, INTRINSICS)
    fisher = information(view.T, found.layout)
    off = found.pixels - truth
    return {
        "pixels": off.ravel(),
        "pixel_chi2": np.einsum("mi,mi->m", off, np.linalg.solve(found.covariances, off[..., None])[..., 0]),
        "error": error,
        "bound": np.sqrt(np.diag(np.linalg.inv(fisher))),
        "efficiency": error @ fisher @ error,
        "chi2": error @ np.linalg.solve(pose.covariance, error),
        "range": view.T[2, 3],
        "stated": np.sqrt(np.diag(pose.covariance)),
        "used": np.array(len(off)),
    }


def accuracy(views: int, first: int) -> None:
    for own_only in (True, False):
        rows = _map(_accuracy, [(first + k, own_only) for k in range(views)])
        error, bound = (np.array([r[k] for r in rows]) for k in ("error", "bound"))
        pixels = np.concatenate([r["pixels"] for r in rows])
        near = np.array([r["range"] for r in rows]) < 0.27
        print(
            f"{'own fiducials' if own_only else 'with neighbours'}: {views} views, {len(pixels) / 2 / views:.1f} fiducials"
        )
        print(f"  fiducial centres: {_rms(pixels):.4f} px rms (0.03), {np.abs(pixels).max():.3f} px worst,", end=" ")
        print(f"chi2/dof {np.mean(np.concatenate([r['pixel_chi2'] for r in rows])) / 2:.2f} (0.8 to 1.25)")
        print(f"  pose: chi2/dof {np.mean([r['chi2'] for r in rows]) / 6:.2f} (0.8 to 1.25); over the bound", end=" ")
        print(f"{np.sqrt(np.mean([r['efficiency'] for r in rows]) / 6):.2f} overall (1.3),", end=" ")
        print("per axis", " ".join(f"{_rms(e) / _rms(b):.2f}" for e, b in zip(error.T, bound.T, strict=True)))
        e = error[near]
        print(
            f"  at 0.18-0.27 m: lateral {1e6 * _rms(e[:, :2]):.1f} um (10), range {1e6 * _rms(e[:, 2]):.1f} um,",
            end=" ",
        )
        print(f"tilt {1e3 * _rms(e[:, 3:5]):.3f} mrad, turn {1e3 * _rms(e[:, 5]):.3f} mrad (0.15)", flush=True)


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _attempt(job: tuple[Callable[[int], View], int]) -> tuple[bool, str, float, float, float]:
    make, seed = job
    cv2.setNumThreads(1)
    view = make(seed)
    try:
        _, pose = measure(view, AROUND)
    except NotMeasured as refusal:
        return view.usable, str(refusal), 0.0, 0.0, 0.0
    error = twist_error(pose.T_camera_square, view.T)
    sigma = np.sqrt(np.diag(pose.covariance))
    chi2 = float(error @ np.linalg.solve(pose.covariance, error))
    return view.usable, "", float(np.max(np.abs(error) / sigma)), float(np.linalg.norm(error[:3])), chi2


def hard(images: int, first: int, verbose: bool = False) -> None:
    rows = _map(_attempt, [(hard_view, first + k) for k in range(images)])
    usable = [r for r in rows if r[0]]
    measured = [r for r in rows if not r[1]]
    missed = [r for r in usable if r[1]]
    wrong = [k for k, r in enumerate(rows) if not r[1] and (r[2] > WRONG_SIGMA or r[3] > WRONG_M)]
    share = 1 - len(missed) / len(usable)
    print(
        f"{images} hard images, {len(usable)} usable: {100 * share:.1f} % of those measured (97), {len(measured)} in all"
    )
    print(f"  wrong (> 5 sigma or > 1 mm): {len(wrong)} = {100 * len(wrong) / images:.2f} % (0.1);", end=" ")
    chi2 = [r[4] for r in measured]
    print(f"chi2/dof {np.mean(chi2) / 6:.2f}, median {np.median(chi2) / 5.35:.2f}")
    print("  usable ones refused:", dict(Counter(r[1] for r in missed)))
    if verbose:
        print("  wrong:", [(first + k, round(rows[k][2], 1), f"{1e3 * rows[k][3]:.3f} mm", rows[k][0]) for k in wrong])
        print("  missed:", [(first + k, r[1][:40]) for k, r in enumerate(rows) if r[0] and r[1]])


def empty(images: int, first: int) -> None:
    rows = _map(_attempt, [(empty_view, first + k) for k in range(images)])
    print(f"{images} images without a usable square: {sum(bool(r[1]) for r in rows)} refused")
    print(
        "  measured all the same:",
        [(first + k, (first + k) % KINDS, round(r[2], 1)) for k, r in enumerate(rows) if not r[1]],
    )


def sonar() -> None:
    """Print the error of the report's plane and of the exact one: the table of the docs."""
    gamma = 2 * INCH
    print("tilt of n  report's form: normal [deg], range [in]             exact form")
    for tilt in (1, 2, 5, 10):
        cells, exact = [], 0.0
        for both in ((1, 1), (1, 0), (0, 1)):  # about both axes, about y only, about x only
            slope = np.sin(np.radians(tilt)) * np.array(both)
            normal = np.array([*slope, np.sqrt(1 - slope @ slope)])
            axial = 10 * INCH
            h = ranges(normal, axial * normal[2], SONARS_AT, "perpendicular")
            for plane in (doty_plane(h, gamma), fit_plane(h, SONARS_AT, "perpendicular")):
                angle = np.degrees(np.arcsin(min(1.0, float(np.linalg.norm(np.cross(plane.normal, normal))))))
                error = (plane.distance / plane.normal[2] - axial) / INCH
                cells.append(f"{angle:6.4f} {error:7.4f}")
            exact = max(exact, angle, abs(error))
        print(f"{tilt:3d} deg    both {cells[0]}   y {cells[2]}   x {cells[4]}   {exact:.0e}")


def _timed(seeds: list[int]) -> tuple[float, float, int]:
    cv2.setNumThreads(1)
    views = [clean_view(seed) for seed in seeds]
    measure(views[0], AROUND)
    cpu, wall = time.process_time(), time.perf_counter()
    for view in views:
        measure(view, AROUND)
    return time.process_time() - cpu, time.perf_counter() - wall, len(views)


def speed(images: int, first: int) -> None:
    rows = _map(_timed, [list(range(first + k, first + images, PROCESSES)) for k in range(PROCESSES)])
    cpu = np.mean([c / n for c, _, n in rows])
    print(
        f"{1e3 * cpu:.1f} ms of CPU per image of 512 x 512: {PROCESSES / cpu:.0f} images a second on {PROCESSES} cores (100);",
        end=" ",
    )
    print(f"by the clock, both at once: {sum(n / w for _, w, n in rows):.0f}")


def _map(function: Callable, jobs: list) -> list:
    with ProcessPoolExecutor(PROCESSES, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(function, jobs, chunksize=max(1, min(8, len(jobs) // PROCESSES))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["accuracy", "hard", "empty", "sonar", "speed"])
    parser.add_argument("--views", type=int, default=60)
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first view or image")
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    if arguments.what == "accuracy":
        accuracy(arguments.views, arguments.first)
    elif arguments.what == "hard":
        hard(arguments.images, arguments.first, arguments.verbose)
    elif arguments.what == "empty":
        empty(arguments.images, arguments.first)
    elif arguments.what == "sonar":
        sonar()
    else:
        speed(arguments.images, arguments.first)


if __name__ == "__main__":
    main()
