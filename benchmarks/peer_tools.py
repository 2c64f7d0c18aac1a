"""One calibration by one public tool, in an environment of its own: the half of ``peers.py`` that knows the tools.

Example:
    build/peers/pybotics/bin/python benchmarks/peer_tools.py pybotics FOLDER

``FOLDER`` holds the same rows in the layout of every tool, as ``peers.py`` writes them. The answer, predicted poses of
the held-out rows and CPU seconds of each step, is written to ``FOLDER/TOOL.npz`` and ``FOLDER/TOOL.json``. Every tool is
used as its own documentation and examples do:

- figaroh: its UR10 example (``full_params``, base and tip frame unknown, ``structural`` choice of parameters, weights 1 and
  0.5, Levenberg-Marquardt, outliers above 20 mm), started in its own closed form. It has no analytic derivatives.
- robotkinecal: its URDF example, on poses of the end effector in the base. It does not look for the base, so it is given
  both frames to a millimetre; its 30 parameters take up what these are off. Derivatives are its own; rows are not weighed.
- pybotics: its calibration example: modified DH constants, ``optimize_accuracy`` and SciPy's ``least_squares``, lengths in
  millimetres as in its models. It knows positions only and has no derivatives. It is given both frames to a millimetre,
  and a mask without the constants that nothing can tell apart (25 remain: two tilts of parallel axes it cannot write).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Answer(NamedTuple):
    """What a tool made of the rows: held-out poses (rotations empty where it has none), and how it went."""

    position: np.ndarray
    rotation: np.ndarray
    seconds: dict[str, float]
    unknowns: int
    said: str


class Clock:
    """CPU seconds of named steps, each from the end of the one before."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.last = time.process_time()

    def lap(self, step: str) -> None:
        """Note what a step took that ends now."""
        now = time.process_time()
        self.seconds[step] = now - self.last
        self.last = now


def aridcal(folder: Path) -> Answer:
    clock = Clock()
    from aridcal.engine.fit.stages import fit_geometry
    from aridcal.engine.robot.chain import load_robot
    from aridcal.files.campaign import load_campaign
    from aridcal.files.read import load_measurements

    clock.lap("imports")
    campaign = load_campaign(folder / "campaign.yaml")
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base)
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds, 0)
    train = rows.select(rows.train)
    clock.lap("read")
    found = fit_geometry(campaign.question, robot, train, ())
    clock.lap("solve")
    fitted = found.geometric
    held = np.load(folder / "rows.npz")["held_readings"]
    R, p = fitted.model.poses(fitted.theta, fitted.model.rows(held))
    clock.lap("predict")
    return Answer(p, R, clock.seconds, len(fitted.theta), f"{len(train)} rows")


def figaroh(folder: Path) -> Answer:
    clock = Clock()
    import pinocchio as pin
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm
    from figaroh.tools.robot import load_robot

    class UR10(BaseCalibration):
        def cost_function(self, var: np.ndarray) -> np.ndarray:
            predicted = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            left = self._compute_logmap_residuals(self.PEE_measured, predicted)
            return np.asarray(self.apply_measurement_weighting(left, pos_weight=1.0, orient_weight=0.5))

    clock.lap("imports")
    robot = load_robot(str(folder / "robot.urdf"), package_dirs=str(folder), load_by_urdf=True)
    calibration = UR10(robot, str(folder / "figaroh.yaml"))
    calibration.calib_config["known_baseframe"] = False
    calibration.calib_config["known_tipframe"] = False
    calibration.load_data_set()
    clock.lap("read")
    calibration.create_param_list()
    clock.lap("choice")
    result = calibration.solve(enable_logging=False)
    clock.lap("solve")
    held = np.load(folder / "rows.npz")["held_readings"]
    settings = dict(calibration.calib_config, NbSample=len(held))
    poses = calc_updated_fkm(calibration.model, calibration.data, result.x, held, settings).reshape(6, -1)
    R = np.array([pin.rpy.rpyToMatrix(*angles) for angles in poses[3:].T])
    clock.lap("predict")
    said = f"{result.message}; {result.nfev} evaluations, {calibration.evaluation_metrics['n_outliers']} outliers"
    return Answer(poses[:3].T, R, clock.seconds, len(result.x), said)


def robotkinecal(folder: Path) -> Answer:
    clock = Clock()
    import roboticstoolbox as rtb
    from robotkinecal import SerialRobotKineCal
    from spatialmath import SE3

    clock.lap("imports")
    rows = np.load(folder / "rows.npz")
    calibration = SerialRobotKineCal(rtb.ERobot.URDF(str(folder / "along_z.urdf")), "target")
    to_base = np.linalg.inv(rows["world_base"])
    observed = [
        SE3(to_base @ _pose(R, p), check=False) for R, p in zip(rows["rotation"], rows["position"], strict=True)
    ]
    calibration.set_observations(list(rows["readings"]), observed)
    clock.lap("read")
    result = calibration.solve()
    clock.lap("solve")
    joints = calibration.N_JOINTS + 1
    made = [rows["world_base"] @ calibration.forward_kinematics(joints, q).A for q in rows["held_readings"]]
    poses = np.array(made)
    clock.lap("predict")
    how = "converged" if result.has_converged else "diverging" if result.is_diverging else "stopped"
    said = f"{how} after {result.nb_iterations_executed} iterations"
    return Answer(poses[:, :3, 3], poses[:, :3, :3], clock.seconds, calibration.N_PARAMS, said)


def pybotics(folder: Path) -> Answer:
    clock = Clock()
    from pybotics.geometry import matrix_2_vector, vector_2_matrix
    from pybotics.kinematic_chain import MDHKinematicChain
    from pybotics.optimization import OptimizationHandler, optimize_accuracy
    from pybotics.robot import Robot
    from pybotics.tool import Tool
    from scipy.optimize import least_squares

    clock.lap("imports")
    rows = np.load(folder / "rows.npz")
    millimetres = np.diag([1e3, 1e3, 1e3, 1.0])
    in_mm = lambda T: millimetres @ T @ np.linalg.inv(millimetres)  # noqa: E731
    table = rows["mdh"] * [1.0, 1e3, 1.0, 1e3]  # alpha, a, theta, d
    world = vector_2_matrix(matrix_2_vector(in_mm(rows["mdh_world"])))
    robot = Robot(MDHKinematicChain(table), tool=Tool(matrix=in_mm(rows["mdh_tool"])), world_frame=world)
    handler = OptimizationHandler(
        robot,
        kinematic_chain_mask=rows["mdh_mask"].ravel().tolist(),
        tool_mask=[True] * 3 + [False] * 3,
        world_mask=[True] * 6,
    )
    clock.lap("read")
    result = least_squares(
        optimize_accuracy,
        handler.generate_optimization_vector(),
        args=(handler, rows["readings"], 1e3 * rows["position"]),
    )
    clock.lap("solve")
    handler.apply_optimization_vector(result.x)
    poses = np.array([handler.robot.fk(q) for q in rows["held_readings"]])
    clock.lap("predict")
    said = f"{result.message}; {result.nfev} evaluations, {result.njev} of derivatives"
    return Answer(1e-3 * poses[:, :3, 3], np.zeros((0, 3, 3)), clock.seconds, len(result.x), said)


TOOLS: dict[str, Callable[[Path], Answer]] = {
    "aridcal": aridcal,
    "robotkinecal": robotkinecal,
    "figaroh": figaroh,
    "pybotics": pybotics,
}


def _pose(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def main(argv: list[str]) -> int:
    name, folder = argv[0], Path(argv[1])
    with redirect_stdout(sys.stderr):
        answer = TOOLS[name](folder)
    np.savez(folder / f"{name}.npz", position=answer.position, rotation=answer.rotation)
    told: dict[str, Any] = {"seconds": answer.seconds, "unknowns": answer.unknowns, "said": answer.said}
    (folder / f"{name}.json").write_text(json.dumps(told))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
