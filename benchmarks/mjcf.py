"""Arms in MJCF as others wrote them: read, calibrated at random, written back; every other byte kept, and MuJoCo agrees.

pip download --no-deps robosuite gymnasium-robotics && python -m zipfile -e robosuite-*.whl arms     # and the other
python benchmarks/mjcf.py arms/robosuite/models/assets/robots/*/robot.xml
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import mujoco
import numpy as np

from aridcal.engine.fit.constants import constants, origins_of
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.engine.robot.mjcf import as_urdf, is_mjcf
from aridcal.engine.robot.splice_mjcf import check_written_back, splice_mjcf
from aridcal.engine.robot.tree import UrdfTree, read_tree
from aridcal.system.errors import AridcalError

ROWS = 20
PLACE = rb"\s+(pos|quat|euler|axisangle|xyaxes|zaxis)\s*=\s*(\"[^\"]*\"|'[^']*')"
TAG = rb"<(body|site)((?:\s+[\w-]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*)"


def without_places(content: bytes) -> bytes:
    """A file without the places of its bodies and sites."""
    return re.sub(TAG, lambda match: b"<" + match[1] + re.sub(PLACE, b"", match[2]), content)


def tip_of(tree: UrdfTree, model: mujoco.MjModel) -> str:
    """The body with most moving joints above it."""

    def above(link: str) -> int:
        count = 0
        while link in tree.parent_of:
            link, joint = tree.parent_of[link]
            count += joint.get("name") in tree.moves
        return count

    bodies = {model.body(k).name for k in range(1, model.nbody)}
    return max((link for link in tree.links if link in bodies), key=above)


def places(content: bytes, file: Path, robot: Robot, q: np.ndarray) -> np.ndarray:
    """The tip in the world for rows of readings, as MuJoCo has it."""
    beside = file.with_name(f"of_aridcal_{file.name}")  # meshes are found from there
    beside.write_bytes(content)
    try:
        model = mujoco.MjModel.from_xml_path(str(beside))
    finally:
        beside.unlink()
    data, T = mujoco.MjData(model), np.tile(np.eye(4), (len(q), 1, 1))
    for k, row in enumerate(q):
        data.qpos[:] = model.qpos0
        for name, value in zip(robot.readings, row, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        tip = data.body(robot.tip)
        T[k, :3, :3], T[k, :3, 3] = tip.xmat.reshape(3, 3), tip.xpos
    return T


def off(model: Model, theta: np.ndarray, content: bytes, file: Path) -> float:
    """Largest difference from MuJoCo, [m] and in R."""
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (ROWS, len(model.robot.readings)))
    R, p = model.poses(theta, model.rows(q))
    T = places(content, file, model.robot, q)
    return max(float(np.abs(T[:, :3, :3] - R).max()), float(np.abs(T[:, :3, 3] - p).max()))


def main(files: list[Path]) -> None:
    """Print a line for each file."""
    for file in files:
        content = file.read_bytes()
        name = f"{file.parent.name}/{file.name}"
        try:
            assert is_mjcf(content)
            tree = read_tree(as_urdf(content, file), file)
            robot = load_robot(file, tip_of(tree, mujoco.MjModel.from_xml_path(str(file))), "world")
            check_written_back(robot)
        except (AridcalError, ValueError) as refusal:
            print(f"{name}: {refusal}")
            continue
        coefficients = constants(robot, "full")
        theta = np.random.default_rng(0).normal(0.0, 1e-2, len(coefficients))
        model = Model(robot, coefficients)
        after = splice_mjcf(robot, origins_of(model, theta))
        kept = "kept" if without_places(after) == without_places(content) else "CHANGED"
        before = off(Model(robot, ()), np.zeros(0), content, file)
        apart = off(model, theta, after, file)
        print(
            f"{name}: {len(robot.joints)} joints to {robot.tip}: bytes {kept}, MuJoCo {before:.1e}, calibrated {apart:.1e}"
        )


if __name__ == "__main__":
    main([Path(each) for each in sys.argv[1:]])
