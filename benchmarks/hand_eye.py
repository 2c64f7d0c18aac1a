"""Hand-eye calibration beside OpenCV on the same corners: the camera's place on a UR10's flange, from `init` on.

Example:
    python benchmarks/hand_eye.py --draws 12
    python benchmarks/hand_eye.py --draws 100 --images 8 60 --arms real

A draw is a camera of known lens at an unknown place on the flange, a board of 24 corners (35 mm apart) at an unknown place, and
images from 0.35 to 0.6 m, tilted up to 40 degrees, with 0.2 px of noise. The arm is ``perfect``, or ``real``: every constant that
such rows can tell is off by 1 mm or 1 mrad (standard deviation), and nobody says so. OpenCV's five methods of
``calibrateHandEye`` and two of ``calibrateRobotWorldHandEye`` get the nominal arm's poses and those of ``solvePnP`` (refined)
from the same corners. Ours are `aridcal init` on the table of corners with `camera.yaml` and `markers.csv` beside it, and
`aridcal identify` on the campaign as it stands.

``ratio`` is our median error over that of the method whose median is least, in the camera's position and in its rotation; ``to
luckiest`` the median of our error over the least error of any method in the same draw, which only the truth can choose.
``sigma`` is the root mean square of error over predicted sigma, over the six components and all draws: 1 is honest. ``least``
is the median error of an estimate that also knows which constants are off, by how much they usually are, and the noise: the
Bayesian Cramér-Rao bound at the truth of each draw (Van Trees 1968); ``--limit`` prints it alone.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
from peers import TOP, environment
from rich.console import Console
from rich.table import Table

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.instruments.camera import project
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.engine.robot.kinematics import tip_frames
from aridcal.jobs.calibrate.hand_eye import hand_eye
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.prepare.campaign_text import draft
from aridcal.jobs.prepare.guesses import leave_open

URDF = TOP / "urdf" / "ur10.urdf"
IMAGES = (8, 15, 30, 60)
ARMS = ("perfect", "real")
NOISE = 0.2  # [px], of each of u and v
WRONG = 1e-3  # standard deviation of a real arm's constants, [m] and [rad]
LENS = np.array([900.0, 900.0, 640.0, 360.0, -0.12, 0.05, 0.0, 0.0, 0.0])
SIZE = (1280, 720)
CORNERS = np.array([(0.035 * (x - 2.5), 0.035 * (1.5 - y), 0.0) for y in range(4) for x in range(6)])
BOARD = pin.SE3(pin.rpy.rpyToMatrix(0.02, -0.01, 0.3), np.array([0.72, 0.16, 0.05]))
# What rows of a camera and a board at unknown places tell of a UR10: its other constants move with those places.
TOLD = (
    "shoulder_lift_joint.y", "shoulder_lift_joint.pitch", "shoulder_lift_joint.z", "shoulder_lift_joint.yaw",
    "elbow_joint.pitch", "elbow_joint.z", "elbow_joint.roll", "elbow_joint.yaw", "wrist_1_joint.pitch", "wrist_1_joint.x",
    "wrist_1_joint.roll", "wrist_1_joint.yaw", "wrist_2_joint.z", "wrist_2_joint.yaw", "wrist_2_joint.x",
    "wrist_2_joint.roll", "wrist_3_joint.x", "wrist_3_joint.roll",
)  # fmt: skip


@dataclass(frozen=True)
class Draw:
    """What was measured, and the truth.

    Attributes:
        readings: Joints of each image, shape (n, 6), [rad].
        pixels: Corners, shape (n, 24, 2), [px].
        camera: T_tip_camera as it is.
        arm: As it is.
        theta: Its constants.
    """

    readings: np.ndarray
    pixels: np.ndarray
    camera: pin.SE3
    arm: Model
    theta: np.ndarray


def drawn(robot: Robot, images: int, real: bool, seed: int) -> Draw:
    """Images of the board from a camera at a place of its own."""
    rng = np.random.default_rng([seed, images, real])
    turn = pin.rpy.rpyToMatrix(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-np.pi, np.pi))
    camera = pin.SE3(turn, rng.uniform((-0.08, -0.08, 0.02), (0.08, 0.08, 0.1)))
    coefficients = (
        tuple(Coefficient(joint, c) for joint, _, c in (name.rpartition(".") for name in TOLD)) if real else ()
    )
    theta = WRONG * rng.standard_normal(len(coefficients))
    nothing = ((None, pin.SE3.Identity()),)
    arm = Model(robot, coefficients, nothing, nothing)
    readings: list[np.ndarray] = []
    pixels: list[np.ndarray] = []
    while len(readings) < images:
        q = joints_for(robot, view(rng) * camera.inverse(), rng)
        if q is None:
            continue
        corners = seen(arm, theta, q[None], camera, BOARD)[0]
        corners += NOISE * rng.standard_normal(corners.shape)
        if ((corners > 5) & (corners < np.array(SIZE) - 6)).all():
            readings.append(q)
            pixels.append(corners)
    return Draw(np.array(readings), np.array(pixels), camera, arm, theta)


def seen(arm: Model, theta: np.ndarray, readings: np.ndarray, camera: pin.SE3, board: pin.SE3) -> np.ndarray:
    """Corners of the board in the image of each of n readings, shape (n, 24, 2), [px]."""
    images = []
    for R, p in zip(*arm.poses(theta, arm.rows(readings)), strict=True):
        T = (pin.SE3(R, p) * camera).inverse() * board
        images.append(project(CORNERS @ T.rotation.T + T.translation, np.tile(LENS, (len(CORNERS), 1))))
    return np.array(images)


def least(draw: Draw, rng: np.random.Generator) -> np.ndarray:
    """An error of the best estimate there can be: lengths of its two parts, shape (2,), [m] and [rad]."""

    def corners(x: np.ndarray) -> np.ndarray:
        camera, board = draw.camera * pin.exp6(x[:6]), BOARD * pin.exp6(x[6:12])
        return seen(draw.arm, draw.theta + x[12:], draw.readings, camera, board).ravel()

    unknowns, step = 12 + len(draw.theta), 1e-6
    J = np.array([(corners(dx) - corners(-dx)) / (2.0 * step) for dx in step * np.eye(unknowns)]).T / NOISE
    prior = np.r_[np.zeros(12), np.full(len(draw.theta), WRONG**-2.0)]
    covariance = np.linalg.inv(J.T @ J + np.diag(prior))[:6, :6]
    return sizes(rng.multivariate_normal(np.zeros(6), covariance))


def view(rng: np.random.Generator) -> pin.SE3:
    """A pose of the camera in the base frame, from which it looks at the board."""
    tilt, side, roll = rng.uniform(0, np.radians(40)), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    down = np.diag([1.0, -1.0, -1.0])
    R = BOARD.rotation @ pin.rpy.rpyToMatrix(0, 0, side) @ pin.rpy.rpyToMatrix(0, tilt, 0) @ down
    R = R @ pin.rpy.rpyToMatrix(0, 0, roll)
    middle = BOARD.act(np.append(rng.uniform(-0.03, 0.03, 2), 0.0))
    return pin.SE3(R, middle - rng.uniform(0.35, 0.6) * R[:, 2])


def joints_for(robot: Robot, tip: pin.SE3, rng: np.random.Generator) -> np.ndarray | None:
    """Joints that bring the nominal tip to a pose, in any of the arm's postures; None where the search ends elsewhere."""
    q, step = rng.uniform(-np.pi, np.pi, 6), 1e-6
    for _ in range(40):
        R, p = tip_frames(robot, np.vstack([q, q + step * np.eye(6)]))
        poses = [pin.SE3(*each) for each in zip(R, p, strict=True)]
        error = pin.log6(poses[0].actInv(tip)).vector
        if np.abs(error).max() < 1e-7:
            return q if np.abs(q).max() < 2 * np.pi else None
        J = np.array([pin.log6(poses[0].actInv(pose)).vector / step for pose in poses[1:]]).T
        change = np.linalg.solve(J.T @ J + 1e-4 * np.eye(6), J.T @ error)
        q = q + change * min(1.0, 0.5 / np.abs(change).max())
    return None


def opencv_places(opencv: subprocess.Popen[str], robot: Robot, draw: Draw) -> list[pin.SE3]:
    """T_tip_camera of each of OpenCV's methods, from the nominal arm's poses."""
    R, p = tip_frames(robot, draw.readings)
    arrays = {"R": R, "p": p, "corners": CORNERS, "pixels": draw.pixels, "lens": LENS}
    assert opencv.stdin is not None and opencv.stdout is not None
    opencv.stdin.write(json.dumps({name: array.tolist() for name, array in arrays.items()}) + "\n")
    opencv.stdin.flush()
    return [pin.SE3(np.array(T)) for T in json.loads(opencv.stdout.readline()).values()]


def our_place(draw: Draw, folder: Path) -> tuple[pin.SE3, np.ndarray]:
    """T_tip_camera and its sigmas by the campaign that `init` writes."""
    names = load_robot(URDF, "tool0").readings
    labels = [f"c{k}" for k in range(len(CORNERS))]
    table = pd.DataFrame(np.repeat(draw.readings, len(CORNERS), axis=0), columns=list(names))
    table["camera"], table["marker"] = "eye", labels * len(draw.readings)
    table[["u", "v"]] = draw.pixels.reshape(-1, 2)
    table["shot"] = np.repeat(np.arange(1, len(draw.readings) + 1), len(CORNERS))
    table.to_csv(folder / "corners.csv", index=False, float_format="%.6f")
    pd.DataFrame({"marker": labels, **dict(zip("xyz", CORNERS.T, strict=True))}).to_csv(
        folder / "markers.csv", index=False
    )
    fx, fy, cx, cy, *distortion = LENS.tolist()
    (folder / "camera.yaml").write_text(
        f"format: 1\ncameras:\n  eye: {{fx: {fx}, fy: {fy}, cx: {cx}, cy: {cy}, width: {SIZE[0]}, height: {SIZE[1]}, "
        f"distortion: {distortion}, on: tip, identify: [place]}}\n"
    )
    proposed = draft(URDF, [folder / "corners.csv"], folder / "campaign.yaml", leave_open)
    answer = hand_eye(identify(proposed.campaign))
    assert answer is not None
    return answer.places[0].placement, answer.places[0].std


def error(place: pin.SE3, truth: pin.SE3) -> np.ndarray:
    """Twist from the true place, in its own axes, shape (6,), [m] and [rad]."""
    return np.concatenate([truth.actInv(place).translation, pin.log3(truth.rotation.T @ place.rotation)])


def main() -> None:
    """Print a row for each arm and number of images."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--images", type=int, nargs="+", default=list(IMAGES))
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    parser.add_argument("--limit", action="store_true")
    arguments = parser.parse_args()
    robot = load_robot(URDF, "tool0")
    if arguments.limit:
        for arm in arguments.arms:
            for images in arguments.images:
                place, turn = _least(robot, images, arm == "real", arguments.draws)
                print(f"{arm:7s} {images:2d} images: least {1e3 * place:.3f} mm, {1e3 * turn:.3f} mrad", flush=True)
        return
    table = Table(title=f"medians of {arguments.draws} draws", title_justify="left")
    heads = (
        "arm",
        "images",
        "ours, mm",
        "mrad",
        "least, mm",
        "mrad",
        "best method, mm",
        "mrad",
        "ratio",
        "rotation",
        "to luckiest",
        "rotation",
        "sigma",
    )
    for head in heads:
        table.add_column(head, justify="right")
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    worker = [str(environment("opencv")), str(TOP / "benchmarks" / "opencv_hand_eye.py")]
    opencv = subprocess.Popen(worker, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=clean)
    for arm in arguments.arms:
        for images in arguments.images:
            ours, theirs, over = [], [], []
            for seed in range(arguments.draws):
                draw = drawn(robot, images, arm == "real", seed)
                with tempfile.TemporaryDirectory() as folder:
                    place, std = our_place(draw, Path(folder))
                off = error(place, draw.camera)
                over.append(off / std)
                ours.append(sizes(off))
                theirs.append([sizes(error(each, draw.camera)) for each in opencv_places(opencv, robot, draw)])
            median, medians = np.median(ours, axis=0), np.median(theirs, axis=0)  # (2,), (methods, 2)
            best = medians.min(axis=0)
            lucky = np.median(np.array(ours) / np.min(theirs, axis=1), axis=0)
            bound = _least(robot, images, arm == "real", arguments.draws)
            figures = [f"{1e3 * v:.3f}" for v in (*median, *bound, *best)] + [
                f"{v:.3f}" for v in (*(median / best), *lucky)
            ]
            table.add_row(arm, str(images), *figures, f"{np.sqrt(np.mean(np.square(over))):.2f}")
    opencv.communicate()
    Console(width=140).print(table)


def _least(robot: Robot, images: int, real: bool, draws: int) -> np.ndarray:
    """Median of :func:`least` over the draws, shape (2,)."""
    rng = np.random.default_rng(0)
    return np.asarray(np.median([least(drawn(robot, images, real, seed), rng) for seed in range(draws)], axis=0))


def sizes(off: np.ndarray) -> np.ndarray:
    """Lengths of an error's two parts, shape (2,), [m] and [rad]."""
    return np.linalg.norm(off.reshape(2, 3), axis=1)


if __name__ == "__main__":
    main()
