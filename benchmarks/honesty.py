"""What rows can tell, and no more: does a calibration say what is so where rows are few, dependent, or tell two causes alike?

    PYTHONPATH=.:tests python benchmarks/honesty.py                # all questions, 25 draws each
    PYTHONPATH=.:tests python benchmarks/honesty.py places --draws 5

Each question has its control: the same without the trap.

- `places`: 45 places measured five times, 4 mrad apart, where the instrument errs alike at a place (control: at each row anew); a
  clean arm and one with an effect. Effects without a cause, error against the truth beside that of the constants alone, z of `std_*`.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table
from robots import readings, simulate, ur10, write_campaign

import aridcal
from aridcal.effects.basis import Basis
from aridcal.effects.effect import Coefficient

PLACES, EACH, APART = 45, 5, 4e-3
"""Places, readings of each, and half of how far their joints are apart, [rad]."""

NOISE, ALIKE = 2e-5, 1.5e-4
"""Of each reading, and of a place, [m] per axis."""

BEND = 2e-4
"""[rad]: amplitude of an error curve of joint 2."""

QUERIES = 400


def places(seed: int, alike: bool, bent: bool) -> dict[str, float]:
    """Rows in places, the instrument's error common to each or not."""
    robot, rng = ur10(), np.random.default_rng(seed)
    truth = simulate(robot, PLACES, rng, kind="position")
    q = np.repeat(truth.readings, EACH, axis=0) + rng.uniform(-APART, APART, (PLACES * EACH, 6))
    model, theta = truth.model, truth.theta
    if bent:
        curve = (Coefficient(robot.names[1], "axis", Basis("sin", (robot.readings[1],), (2.0,))),)
        model = model.with_coefficients((*model.coefficients, *curve))
        theta = np.append(theta, BEND)
    _, p = model.poses(theta, model.rows(q))
    own = rng.normal(size=(PLACES, 3)).repeat(EACH, axis=0) if alike else rng.normal(size=p.shape)
    p = p + ALIKE * own + NOISE * rng.normal(size=p.shape)
    rows = pd.DataFrame({**dict(zip(robot.readings, q.T, strict=True)), **dict(zip("xyz", p.T, strict=True))})
    queries = readings(robot, QUERIES, rng, 0.8)
    _, wanted = model.poses(theta, model.rows(queries))
    asked = pd.DataFrame(dict(zip(robot.readings, queries.T, strict=True)))
    answers = {}
    for name, enabled in (("final", True), ("constants", False)):
        with tempfile.TemporaryDirectory() as folder:
            path = write_campaign(Path(folder), truth, rows, diagnosis={"enabled": enabled})
            cal = aridcal.calibrate(path)
            predicted = cal.predict(asked)
        off = predicted[["x", "y", "z"]].to_numpy() - wanted
        inside = ~predicted["extrapolates"].to_numpy(bool)
        sigma = predicted[["std_x", "std_y", "std_z"]].to_numpy()
        answers[name] = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        answers[f"z {name}"] = float(np.sqrt(np.mean((off[inside] / sigma[inside]) ** 2)))
        if enabled:
            answers["effects"] = float(len(cal.result["effects"]))
            answers["floor"] = float(cal.result["verdict"] == "noise_floor")
    return answers


QUESTIONS: dict[str, Sequence[tuple[str, Callable[[int], dict[str, float]]]]] = {
    "places": (
        ("alike at a place, clean arm", lambda seed: places(seed, True, False)),
        ("each anew, clean arm", lambda seed: places(seed, False, False)),
        ("alike at a place, an error curve", lambda seed: places(seed, True, True)),
        ("each anew, an error curve", lambda seed: places(seed, False, True)),
    ),
}


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("questions", nargs="*", default=list(QUESTIONS))
    command.add_argument("--draws", type=int, default=25)
    command.add_argument("--seed", type=int, default=0)
    arguments = command.parse_args()
    for question in arguments.questions:
        table = Table("case", "draws", "figures: median (largest)")
        for name, draw in QUESTIONS[question]:
            drawn = [draw(arguments.seed + k) for k in range(arguments.draws)]
            figures = {key: np.array([one[key] for one in drawn]) for key in drawn[0]}
            said = ", ".join(f"{key} {np.median(v):.3g} ({v.max():.3g})" for key, v in figures.items())
            table.add_row(name, str(len(drawn)), said)
        Console(width=160).print(question, table)


if __name__ == "__main__":
    main()
