"""Shots of a square that is rendered, as a campaign of `measure`."""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.camera import DOTY_OPENCV
from aridcal.engine.instruments.camera_sonar import predict_ranges
from aridcal.jobs.head1992.render import ImageAppearance, render
from aridcal.jobs.head1992.square import INCH, strip_placements
from aridcal.measure import main

INTRINSICS = np.array([700.0, 700.0, 255.5, 255.5, 0, 0, 0, 0, 0])

CORNERS = 2 * INCH * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])

T_TIP_CAMERA = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.01, 0.02, 0.1])).homogeneous

T_WORLD_STRIP = pin.SE3(pin.rpy.rpyToMatrix(1.0, 0.3, -0.4), np.array([1.0, 2.0, 3.0])).homogeneous

HEAD = """\
format: 1
camera: {fx: 700.0, fy: 700.0, cx: 255.5, cy: 255.5, width: 512, height: 512}
sonars:
  positions: [[-0.0508, -0.0508, 0], [0.0508, -0.0508, 0], [0.0508, 0.0508, 0], [-0.0508, 0.0508, 0]]
  std: 2.5e-4
tip_camera: {xyz: [0.01, 0.02, 0.1], rpy: [0.1, -0.2, 0.3]}
squares: squares.csv
shots: shots.csv
"""


def sight(k: int) -> np.ndarray:
    """T_camera_square of the k-th shot."""
    rng = np.random.default_rng(k)
    T = np.eye(4)
    T[:3, :3] = (
        DOTY_OPENCV @ pin.exp3(np.r_[rng.uniform(-0.12, 0.12, 2), 0]) @ pin.exp3(np.r_[0, 0, rng.uniform(-0.5, 0.5)])
    )
    T[:3, 3] = [0, 0, rng.uniform(0.22, 0.4)] - T[:3, :3] @ np.r_[rng.uniform(-1, 1, 2) * INCH, 0]
    return T


class Campaign:
    """A folder with a head, three squares and some shots, and their truth."""

    def __init__(self, folder: Path, shots: int = 4) -> None:
        self.folder = folder
        strip = T_WORLD_STRIP @ strip_placements(3)
        self.squares = dict(enumerate(strip))
        quaternions = Rotation.from_matrix(strip[:, :3, :3]).as_quat()
        poses = np.column_stack([np.arange(3), strip[:, :3, 3], quaternions])
        pd.DataFrame(poses, columns=["index", *"xyz", "qx", "qy", "qz", "qw"]).astype({"index": int}).to_csv(
            folder / "squares.csv", index=False
        )
        (folder / "head.yaml").write_text(HEAD)
        (folder / "images").mkdir()
        self.truth, rows = [], []
        for k in range(shots):
            square, T = k % 3, sight(k)
            rows.append({"joint_a": 0.1 * k, "image": f"images/{k}.png", "square": square, "temperature": 20.0 + k})
            rows[-1] |= self.look(k, square, T)
            self.truth.append(self.squares[square] @ np.linalg.inv(T) @ np.linalg.inv(T_TIP_CAMERA))
        self.shots = pd.DataFrame(rows)

    def look(self, k: int, square: int, T: np.ndarray) -> dict[str, float]:
        seen = {i: T @ np.linalg.inv(self.squares[square]) @ S for i, S in self.squares.items()}
        rng = np.random.default_rng(100 + k)
        cv2.imwrite(str(self.folder / f"images/{k}.png"), render(seen, INTRINSICS, 512, 512, ImageAppearance(), rng))
        h = predict_ranges(T, CORNERS, "perpendicular")[0] + 2.5e-4 * rng.normal(size=4)
        return {f"h{i + 1}": value for i, value in enumerate(h)}

    def run(self) -> int:
        self.shots.to_csv(self.folder / "shots.csv", index=False)
        return main([str(self.folder / "head.yaml"), "-o", str(self.folder / "out" / "measurements.csv")])

    def measured(self) -> pd.DataFrame:
        return pd.read_csv(self.folder / "out" / "measurements.csv")

    def refused(self) -> dict[int, str]:
        table = pd.read_csv(self.folder / "out" / "refused.csv")
        assert list(table.columns) == ["shot", "image", "why"]
        return dict(zip(table["shot"], table["why"], strict=True))
