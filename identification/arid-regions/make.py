"""Write the campaign: the 84 shots of `../arid-strip`, each square seen four times, by an arm that is not the same everywhere.

    python identification/arid-regions/make.py       # writes measurements.csv and truth.json beside itself

The second link bends and twists by 1 mrad from the first strip to the last, and around square 41 everything is 0.5 mm off, as if
the door bulged there after it was surveyed. The rows are poses of the tip, as `aridcal measure` makes them from images.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot

HERE = Path(__file__).resolve().parent
STRIP = HERE.parent / "arid-strip"
VIEWS, SPREAD = (
    4,
    np.array([0.03, 0.01, 0.03, 0.06]),
)  # of each square; of each reading around the shot's, [m] and [rad]
WRONG, NOISE = 2e-3, 1e-4  # of every constant; of a pose per axis, [m] and [rad]
BENT = 1e-3  # half of what the second link's beta and alpha change by along the rail, [rad]
BULGE, AT, REACH = 5e-4, 41, 0.12  # [m]; square; one sigma of it, [m]


def main() -> None:
    """Write both files."""
    rng = np.random.default_rng(1992)
    robot = load_robot(HERE / "../../urdf/arid.urdf", "flange")
    shots, squares = pd.read_csv(STRIP / "shots.csv"), pd.read_csv(STRIP / "squares.csv").set_index("index")
    shots = shots.loc[shots.index.repeat(VIEWS)].reset_index(drop=True)
    q = shots[list(robot.readings)].to_numpy() + SPREAD * rng.uniform(-1.0, 1.0, (len(shots), 4))
    low, high = robot.limits.T
    q = np.clip(q, low, high)

    rail = q[:, 0]
    line = {"along": (2.0 * rail - rail.min() - rail.max()) / np.ptp(rail)}
    bent = tuple(Coefficient("joint_2", c, Basis("linear", ("along",), (0.0,))) for c in ("beta", "alpha"))
    world = pin.SE3(pin.rpy.rpyToMatrix(-1.569, 0.001, -1.572), np.array([0.004, -0.003, 0.002]))
    known = constants(robot, "doty")
    model = Model(robot, (*known, *bent), ((None, world),))
    theta = np.concatenate([WRONG * rng.standard_normal(len(known)), [BENT, -BENT]])
    R, p = model.poses(theta, model.rows(q, line))

    place = squares[["x", "y", "z"]].to_numpy()
    normal = Rotation.from_quat(squares[["qx", "qy", "qz", "qw"]].to_numpy()[AT]).as_matrix()[:, 2]
    apart = np.linalg.norm(place[shots["square"]] - place[AT], axis=1)
    p = p + BULGE * np.exp(-0.5 * (apart / REACH) ** 2)[:, None] * normal
    error = NOISE * rng.standard_normal((len(q), 6))
    turned = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_matrix(R)
    table = pd.DataFrame(q, columns=list(robot.readings))
    table[["x", "y", "z"]] = p + error[:, :3]
    table[["qx", "qy", "qz", "qw"]] = turned.as_quat(canonical=True)
    table["square"] = shots["square"]
    table.round(9).to_csv(HERE / "measurements.csv", index=False)
    truth = {
        "parameters": dict(zip((c.name for c in known), theta.round(9).tolist(), strict=False)),
        "joint_2.beta, .alpha along the rail [rad]": {"first strip": [-BENT, BENT], "last strip": [BENT, -BENT]},
        "bulge": {"square": AT, "height_m": BULGE, "reach_m": REACH},
    }
    (HERE / "truth.json").write_text(json.dumps(truth, indent=2) + "\n")


if __name__ == "__main__":
    main()
