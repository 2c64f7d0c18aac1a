"""Halves of the rows by blocks: what p-values are on clean data, which missing effects they betray, and a real robot.

Example:
    PYTHONPATH=.:tests/support python benchmarks/halves.py clean --runs 300
    PYTHONPATH=.:tests/support python benchmarks/halves.py power --runs 40
    PYTHONPATH=.:tests/support python benchmarks/halves.py real

- ``clean``: simulated campaigns of every kind of measurement, constants fitted, nothing missing; noise estimated from the rows.
- ``power``: 300 poses, and 300 positions, of a UR10 with one effect that is not in the model, of each kind that its rows can
  test, drawn anyhow. It leaves 1 sigma (RMS over the numbers of the rows) after the constants took what they can.
- ``real``: the UR10 of identification/ur10-laser-tracker, series B, through ``identify``: the geometric and the final model.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gauges
import numpy as np
import pinocchio as pin
import robots
import yaml
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from aridcal.engine.corrections.catalogue import candidates
from aridcal.engine.corrections.loads import Surroundings
from aridcal.engine.corrections.smooth import Kernel, samples_root
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.least_squares import Fit, fit, fit_identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import fit_geometry
from aridcal.engine.levels import RARE
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.approach import with_directions
from aridcal.engine.rows.dataset import Dataset, with_places
from aridcal.engine.search.diagnose import covariates_and_exclusions
from aridcal.engine.trust.halves import halves

TOP = Path(__file__).resolve().parents[1]
NOISE = 1e-4
"""[m] and [rad]."""

TOOL = pin.SE3(np.eye(3), np.array([0.05, -0.03, 0.15]))
"""Where the target is on the flange: on the axis of the last joint positions would tell nothing of what turns it."""

WAVE = 0.15
"""Correlation length of missing curves, as a share of the range: waves of some quarter of a turn."""


def p_value(found: Fit, rows: Dataset) -> float:
    """Of the halves of a fit."""
    compared = halves(found, rows)
    assert compared is not None
    return compared.p_value


def of_arm(robot: Robot, kind: str, n: int) -> Callable[[int], float]:
    """Clean campaigns of poses or positions."""
    first = robots.simulate(robot, n, np.random.default_rng(0), 1e-3, NOISE, kind=kind)
    every = first.model.with_coefficients((*robots.FRAMES, *constants(robot, "full")))
    model = fit_identifiable(first.data(every), range(len(every.coefficients))).model

    def run(seed: int) -> float:
        truth = robots.simulate(robot, n, np.random.default_rng(seed), 1e-3, NOISE, kind=kind)
        return p_value(fit(truth.data(model), weight=np.ones(n)), truth.measured)

    return run


def of_instrument(make: Callable[[gauges.Arm], gauges.Measured]) -> Callable[[int], float]:
    """Clean campaigns of another kind: the same configurations with other noise."""
    usual, gauges.NOISE = gauges.NOISE, dict.fromkeys(gauges.NOISE, 0.0)
    arm = gauges.arm()
    exact = make(arm)
    gauges.NOISE = usual
    with tempfile.TemporaryDirectory() as folder:
        campaign = gauges.campaign(Path(folder), arm, gauges.rows(arm, exact))
        rows = gauges.rows(arm, noisy(arm, exact, np.random.default_rng(0)))
        first = fit_geometry(campaign.question, arm.robot, rows, ()).geometric

    def run(seed: int) -> float:
        rows = gauges.rows(arm, noisy(arm, exact, np.random.default_rng(seed)))
        return p_value(fit(problem(first.model, rows), first.theta, np.ones(len(rows))), rows)

    return run


def noisy(arm: gauges.Arm, exact: gauges.Measured, rng: np.random.Generator) -> gauges.Measured:
    """What the instrument reads another time; a ball sits in its socket a little off."""
    if exact.kind == "point":
        places = np.array([exact.states["point"][label] for label in exact.refers[:, 0]])
        off = gauges.NOISE["position"] * rng.normal(size=places.shape)
        return replace(exact, q=gauges.brought(arm, exact.q, places + off))
    channel = {"position": "position", "inclination": "inclination", "pixels": "pixel"}.get(exact.kind, "distance")
    return replace(exact, observed=exact.observed + gauges.NOISE[channel] * rng.normal(size=exact.observed.shape))


CLEAN: dict[str, Callable[[], Callable[[int], float]]] = {
    "pose, UR10, 100 rows": lambda: of_arm(robots.ur10(), "pose", 100),
    "pose, ARID, 60 rows": lambda: of_arm(robots.arid(), "pose", 60),
    "position, UR10, 100 rows": lambda: of_arm(robots.ur10(), "position", 100),
    "position of two targets, 120 rows": lambda: of_instrument(gauges.positions),
    "point, pairs of sockets, 120 rows": lambda: of_instrument(gauges.points),
    "distance, 180 rows": lambda: of_instrument(gauges.distances),
    "plane, 180 rows": lambda: of_instrument(gauges.heights),
    "pixels, 40 images of a board": lambda: of_instrument(gauges.pixels),
    "inclination, 120 rows": lambda: of_instrument(gauges.levels),
}


def clean(runs: int) -> None:
    """Distribution of p-values where nothing is missing."""
    print("| clean campaigns | p of Kolmogorov-Smirnov | below 0.05 | below 0.01 | called in disagreement |")
    for name, made in CLEAN.items():
        run = made()
        p = np.array([run(seed) for seed in range(1, runs + 1)])
        shares = " | ".join(f"{100 * np.mean(p < limit):.1f} %" for limit in (0.05, 0.01, RARE))
        print(f"| {name} | {kstest(p, 'uniform').pvalue:.3f} | {shares} |", flush=True)


def spoilt(kind: str, effect_kind: str, seed: int) -> tuple[float, float]:
    """A campaign with one effect missing.

    Returns:
        The p-value of its halves, and the effect's RMS in the rows before constants took their part, in sigmas.
    """
    rng = np.random.default_rng([seed, 13])
    robot, n = robots.ur10(), 300
    truth = robots.simulate(robot, n, rng, 1e-3, 0.0, kind=kind, tip=TOOL)
    time = np.sort(rng.uniform(0.0, 7200.0, n))
    columns = {
        "time": time,
        "temperature": 20.0 + 4.0 * (1.0 - np.exp(-time / 2400.0)) + 0.2 * rng.standard_normal(n),
        "payload": rng.choice([0.0, 5.0], n),
    }
    rows = with_directions(replace(truth.measured, covariates=columns))
    around = Surroundings(loaded=True)
    seen, _ = covariates_and_exclusions(Model(robot, (), around=around), rows)
    size, moved = 6 if kind == "pose" else 3, np.zeros(0)
    choice = candidates(seen, (effect_kind,))
    while not moved.any():  # a turn of the target itself moves no position
        effect = choice[int(rng.integers(len(choice)))]
        weights = rng.standard_normal(len(effect.coefficients))
        if effect.smooth:
            weights = samples_root(effect.shape, Kernel(WAVE * len(weights), kinks=False)) @ weights
        bent = replace(truth.model, coefficients=effect.coefficients, around=around)
        _, _, J = bent.jacobian(np.zeros(len(weights)), bent.rows(rows.readings, rows.conditions))
        moved = (J @ weights)[:, :size].ravel()
    model = truth.model.with_coefficients((*robots.FRAMES, *constants(robot, "full")))
    _, _, own = model.jacobian(np.zeros(len(model.coefficients)), model.rows(rows.readings))
    own = own[:, :size].reshape(-1, own.shape[2])
    left = moved - own @ np.linalg.lstsq(own, moved, rcond=1e-9)[0]
    scale = NOISE / float(np.sqrt(np.mean(left**2)))
    twist = scale * moved.reshape(n, size)
    noise = NOISE * rng.standard_normal((n, size))
    rotation = rows.rotation
    if rotation is not None:
        rotation = Rotation.from_rotvec((twist + noise)[:, 3:]).as_matrix() @ rotation
    rows = with_places(rows, rows.position + (twist + noise)[:, :3], rotation)
    found = fit_identifiable(problem(model, rows), range(len(model.coefficients)))
    return p_value(found, rows), scale * float(np.sqrt(np.mean(moved**2))) / NOISE


OF_ARMS = (
    "joint_gain", "joint_harmonic", "joint_map", "joint_backlash", "joint_compliance", "bearing_compliance", "axis_wobble",
    "joint_coupling", "thermal", "drift", "payload_compliance", "shift",
)  # fmt: skip
"""Kinds that a UR10 can show."""


def power(runs: int) -> None:
    """Which missing effects are betrayed."""
    print(
        f"| missing, 300 rows | poses: p < {RARE:g} | in the rows before the fit [sigma] | positions | before the fit |"
    )
    total = dict.fromkeys(("pose", "position"), 0)
    tried = 0
    for effect_kind in OF_ARMS:
        cells = []
        for kind in total:
            found = [spoilt(kind, effect_kind, seed) for seed in range(runs)]
            caught = sum(p < RARE for p, _ in found)
            total[kind] += caught
            cells += [f"{caught} of {runs}", f"{np.median([before for _, before in found]):.1f}"]
        tried += runs
        print(f"| {effect_kind} | {' | '.join(cells)} |", flush=True)
    print(f"| all | {total['pose']} of {tried} | | {total['position']} of {tried} | |")


def real(_: int) -> None:
    """A real robot."""
    from aridcal.jobs.calibrate.pipeline import identify

    path = TOP / "identification" / "ur10-laser-tracker" / "campaign-b.yaml"
    keys = yaml.safe_load(path.read_text())
    keys["robot"]["urdf"] = str((path.parent / keys["robot"]["urdf"]).resolve())
    keys["measurements"]["file"] = str((path.parent / keys["measurements"]["file"]).resolve())
    with tempfile.TemporaryDirectory() as folder:
        campaign = Path(folder) / "campaign.yaml"
        campaign.write_text(yaml.safe_dump(keys))
        found = identify(campaign)
    train = found.measurements.select(found.measurements.train)
    for stage in found.stages[1:]:
        print(stage.name, halves(stage.fit, train))


def main() -> None:
    """Run what is asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="+", choices=("clean", "power", "real"))
    parser.add_argument("--runs", type=int, default=300)
    given = parser.parse_args()
    for what in given.what:
        {"clean": clean, "power": power, "real": real}[what](given.runs)


if __name__ == "__main__":
    main()
