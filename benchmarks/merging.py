"""Two logs into one table: how well clocks are found, and whether the averaged rows are as good as they say.

    python benchmarks/merging.py [SEEDS]

A UR10 goes to 150 random configurations, one after the other, at up to 1 rad/s. Joints are logged at 125 Hz, a tracker's pose at
10 Hz (0.05 mm and 0.1 mrad, 1 sigma per axis) with a clock of its own. The table printed has a line for each case: the largest
error of the clocks anywhere in the log, stops that became rows, the chi-square of the rows about the truth over its degrees of
freedom (1 if the standard deviations are right), and sigma √n over the true sigma.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

HERE = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(HERE / "tests" / "support"))

import made_logs  # noqa: E402
import robots  # noqa: E402

from aridcal.jobs.prepare.guesses import leave_open  # noqa: E402
from aridcal.runs.log_merge import join_logs  # noqa: E402
from aridcal.system.errors import AridcalError  # noqa: E402

CASES: dict[str, dict[str, float]] = {
    "3.7 s, 40 ppm": {},
    "no drift": {"drift": 0.0},
    "500 ppm": {"drift": 5e-4},
    "-500 ppm": {"drift": -5e-4},
    "-1,000 s": {"offset": -1000.0},
    "model 5 mm wrong": {"wrong": 5e-3},
    "500 ppm, -1,000 s, 5 mm": {"drift": 5e-4, "offset": -1000.0, "wrong": 5e-3},
    "tracker drops out": {"lost": 0.1},
}
"""What differs from the first."""

STD = ["std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz"]


def one(case: dict[str, float], seed: int) -> tuple[float, float, int, float, float, float]:
    """Largest error of the clocks and its sigma [s], rows, chi-square over its degrees, share of sigma, CPU seconds."""
    robot = robots.ur10()
    lost = case.get("lost", 0.0)
    made = made_logs.made(robot, n=150, seed=seed, **{k: v for k, v in case.items() if k != "lost"})
    tracker = made.tracker
    if lost:  # for half a second to five, so often that it sees so much less
        rng = np.random.default_rng(seed)
        t = tracker["time"].to_numpy()
        begins = rng.uniform(t[0], t[-1], int(lost * (t[-1] - t[0]) / 2.75))
        gone = np.any((t[:, None] > begins) & (t[:, None] < begins + rng.uniform(0.5, 5.0, len(begins))), axis=1)
        tracker = tracker[~gone]
    began = time.process_time()
    found = join_logs(made.joints, tracker, robots.URDF / "ur10.urdf", "tool0", leave_open, {})
    seconds = time.process_time() - began
    at = made.tracker["time"].to_numpy()
    late = np.abs(found.clocks.joints(at) - made.joints_clock(at)).max()
    q = found.table[list(robot.readings)].to_numpy()
    k = np.array([np.argmin(np.abs(made.q - row).sum(axis=1)) for row in q])
    off = found.table[["x", "y", "z"]].to_numpy() - made.position[k]
    measured = Rotation.from_quat(found.table[["qx", "qy", "qz", "qw"]].to_numpy())
    turned = (measured * Rotation.from_matrix(made.rotation[k]).inv()).as_rotvec()
    z = np.hstack([off, turned]) / found.table[STD].to_numpy()
    share = found.table[STD].to_numpy() * np.sqrt(found.table["n"].to_numpy())[:, None] / np.repeat([5e-5, 1e-4], 3)
    return (
        float(late),
        float(found.clocks.std(at).max()),
        len(set(k)),
        float(np.mean(z**2)),
        float(share.mean()),
        seconds,
    )


def main() -> None:
    """Print the table."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    head = (
        f"{'case':<26}{'worst [ms]':>11}{'sigma [ms]':>11}{'rows':>12}{'chi²/dof':>16}{'s√n/sigma':>11}{'CPU [s]':>9}"
    )
    print(head)
    for name, case in CASES.items():
        try:
            runs = np.array([one(case, 100 + seed) for seed in range(seeds)])
        except AridcalError as problem:
            print(f"{name:<26} refused: {problem}")
            continue
        rows = f"{runs[:, 2].min():.0f} to {runs[:, 2].max():.0f}"
        chi = f"{runs[:, 3].min():.2f} to {runs[:, 3].max():.2f}"
        print(
            f"{name:<26}{1e3 * runs[:, 0].max():>11.4f}{1e3 * runs[:, 1].max():>11.4f}{rows:>12}{chi:>16}"
            f"{runs[:, 4].mean():>11.3f}{runs[:, 5].mean():>9.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
