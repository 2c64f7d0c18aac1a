"""CPU time and memory of correcting targets of a program, for a UR10 of which the truth is known.

Targets lie along a seam (each close to the one before), around one place (in any order, half a radian about it), or anywhere
where the arm was calibrated; and some are out of reach.

Example:
    OMP_NUM_THREADS=1 python benchmarks/target_correction.py --targets 100000 --way seam --form pose
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import replace

import numpy as np
from calibrated import machine

from aridcal.engine.robot.chain import Robot
from aridcal.jobs.apply.programs.branches import flanges
from aridcal.jobs.apply.programs.correct import correct
from aridcal.jobs.apply.programs.notations import UR
from aridcal.jobs.apply.programs.targets import Branch, PoseReference, Target
from aridcal.jobs.apply.programs.text import Number, Numbers

HOME = np.array([0.3, -1.2, 1.5, -1.5, -1.4, 0.2])


def way(name: str, n: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Readings of n targets."""
    rng = np.random.default_rng(1)
    if name == "around":
        return HOME + rng.uniform(-0.5, 0.5, (n, 6))
    if name == "anywhere":
        return rng.uniform(low, high, (n, 6))
    t = np.linspace(0.0, 0.03 * n, n)[:, None]
    return HOME + 0.5 * np.sin(t * rng.uniform(0.5, 1.0, 6) + rng.uniform(0.0, 6.0, 6))


def targets(robot: Robot, q: np.ndarray, form: str) -> list[Target]:
    """Targets of joints, or poses in the base's frame."""
    values = q if form == "joints" else UR.numbers(flanges(robot, q), np.zeros((len(q), 6)))
    numbers = [tuple(Number(0, f"{value:.6f}") for value in row) for row in values.tolist()]
    if form == "joints":
        units = tuple((1.0, k) for k in range(6))
        return [
            Target(1, "", "joints", Numbers(own), readings=np.array([n.value for n in own]), units=units)
            for own in numbers
        ]
    place = PoseReference(np.eye(4), np.eye(4))
    return [
        Target(1, "", "pose", Numbers(own), notation=UR, place=place, branch=Branch(nearest=True)) for own in numbers
    ]


def memory() -> float:
    """The most so far, [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("--targets", type=int, default=100_000)
    command.add_argument("--way", choices=("seam", "around", "anywhere"), default="seam")
    command.add_argument("--form", choices=("joints", "pose"), default="pose")
    command.add_argument(
        "--lost", type=int, default=0, help="of them, how many are where the arm does not get, of poses"
    )
    given = command.parse_args()
    m = machine(3, n=150)
    robot = m.model.robot
    low, high = np.array([m.saved.ranges[name] for name in robot.readings]).T
    program = targets(robot, way(given.way, given.targets, low, high), given.form)
    for k in np.linspace(0, given.targets - 1, given.lost, dtype=int).tolist():
        base = np.eye(4)
        base[:3, 3] = [0.05, 0.0, 0.3]  # inside the arm's own column
        here = UR.pose(program[k].values)
        program[k] = replace(program[k], place=PoseReference(base @ np.linalg.inv(here), np.eye(4)))
    before, began = memory(), time.process_time()
    found = correct(m.saved, program, {}, HOME)
    took = time.process_time() - began
    done = [c for c in found if not c.why]
    rms = {
        name: 1e3 * float(np.sqrt(np.mean([getattr(c, name)[0] ** 2 for c in done]))) for name in ("before", "after")
    }
    print(
        f"{took:.1f} s of CPU, {1e6 * took / given.targets:.0f} us a target; {memory():.0f} MB at most, {before:.0f} with the "
        f"targets alone; {len(done)} corrected, RMS by the model {rms['before']:.3f} mm before, {rms['after']:.5f} mm after"
    )


if __name__ == "__main__":
    main()
