"""Calibrations for tests of exports: made robots with every kind of effect, as files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import robots
from kinds_of_effects import every_effect

from aridcal.engine.corrections.basis import FORMS, Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.corrections.sights import TARGET, Sights
from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel

BESIDE = {"payload": (0.0, 5.0), "temperature": (15.0, 30.0), "time": (0.0, 20.0)}


def saved_from(model: Model, theta: np.ndarray, kind: str = "pose") -> SavedModel:
    """A calibration that saw half of each joint's range."""
    solved = SolvedModel(model, theta, 1e-12 * np.eye(len(theta)))
    low, high = np.clip(model.robot.limits, -np.pi, np.pi).T
    quarter = (high - low) / 4
    ranges = dict(zip(model.robot.readings, zip(low + quarter, high - quarter, strict=True), strict=True))
    ranges |= {name: BESIDE.get(name, (-1.0, 1.0)) for name in model.needs}
    ranges = {name: (float(a), float(b)) for name, (a, b) in ranges.items()}
    return SavedModel(solved, solved, kind, (0.0, 0.0, -9.81), (1e-5, 1e-5), ranges, {})


def spoilt(seed: int, robot: Robot, size: float = 1e-2, count: int = 80) -> SavedModel:
    """A robot with constants, effects of the whole table of kinds, and what the search makes of it: every form of basis."""
    rng, n = np.random.default_rng(seed), 40
    q = robots.readings(robot, n, rng)
    columns = {f"{name}_direction": rng.choice([-1.0, 0.0, 1.0], n) for name in robot.names}
    columns |= {name: rng.uniform(*BESIDE[name], n) for name in BESIDE}
    around = Surroundings(rng.normal(size=3) * 9.81, (Payload(rng.normal(size=3) * 0.2),), loaded=bool(seed % 2))
    around = replace(around, sights=Sights(rng.normal(size=(1, 3)) * 0.1))
    effects = every_effect(robot, q, columns, around)
    first, last = robot.names[0], robot.names[-1]
    middle = rng.uniform(-0.5, 0.5, (6, 3))
    forms = [
        *(Basis("bump2", (first, "temperature"), (0.5 * k, 1.0, 20.0 + k, 4.0)) for k in range(4)),
        *(Basis("ball", TARGET, (*place, 1.5)) for place in middle.tolist()),
        *(Basis("bump", ("time",), (at, 2.0)) for at in (3.0, 4.0, 7.3)),
        *(Basis("step", of, (5.0,)) for of in (("time",), ("file row",))),
        Basis("sign", (f"{last}.gravity_torque",)),
        Basis("power", (first,), (0.1, 2.0, 5.0)),
        Basis("label", ("station[hall A]",)),
        Basis("label", ("station[hall B]",)),
    ]
    more = [
        Coefficient(where, component, b) for b in forms for where, component in ((last, "x"), ("world_base", "yaw"))
    ]
    drawn = [effects[k] for k in rng.permutation(len(effects))]
    by_form = {form: [c for c in drawn if c.basis.form == form] for form in sorted({c.basis.form for c in drawn})}
    some = [c for every in by_form.values() for c in every[: count // len(by_form)]]
    frames = [Coefficient(where, c) for where in ("world_base", "tip_target") for c in FRAME_COMPONENTS]
    coefficients = tuple(dict.fromkeys((*constants(robot, "full"), *frames, *some, *more)))
    base, tip = ((None, robots.random_placement(rng)),), ((None, robots.random_placement(rng, 0.3)),)
    model = Model(robot, coefficients, base, tip, around)
    assert {c.basis.form for c in coefficients} >= FORMS.keys() - {"ones"}
    return saved_from(model, rng.normal(0.0, size, len(coefficients)))


def written(saved: SavedModel, folder: Path) -> Path:
    """The calibration as a file."""
    folder.mkdir()
    (folder / "calibration.yaml").write_text(saved.dump(), "utf-8")
    return folder
