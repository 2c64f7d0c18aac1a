"""Undeclared effects and causes of noise in every kind of measurement; run by `instruments.py`, whose docstring says how."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from instrument_cases import QUERIES, WAYS, Made, elsewhere, error_of, geometric, made, noisy, rows_of, scenario

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.instruments.channels import spread
from aridcal.engine.search.loop import calibrated_arm, fit_constants
from aridcal.engine.search.noise_causes import noise_causes
from aridcal.system.errors import AridcalError
from aridcal.system.progress import SILENT

BLIND = ("point", "distance", "plane", "eye in hand")
KINDS = (
    "joint_gain",
    "joint_harmonic",
    "joint_backlash",
    "joint_compliance",
    "axis_wobble",
    "joint_coupling",
    "thermal",
)
SIZES = (3.0, 40.0)
"""Of an effect: RMS per number in sigma, after projection off constants, frames and things."""

SMALL = 1e-4
"""[rad] or [m]: of an effect whose size is measured."""


def causes(kind: str | None, runs: int, rows: int, seed: int) -> None:
    """Whether clean rows name no cause, and rounded joints theirs with its size."""
    step = np.radians(0.1)
    print(
        f"{'kind':20} {'runs':>4} {'clean: named':>12} {'rounded: named':>14} {'all joints':>10} {'their size / true':>18}"
    )
    for way in [kind] if kind else WAYS:
        done, clean, named, sizes = 0, 0, 0, []
        for k in range(runs):
            keys, robot = scenario(way, "six", seed * 1000 + k, rows or 2 * rows_of(way))
            try:
                one = made(noisy(keys), robot)
            except AridcalError as fault:
                print(f"  {way} {k}: {fault}")
                continue
            done += 1
            coarse = replace(one.rows, readings=np.round(one.rows.readings / step) * step)
            for data in (one.rows, coarse):
                geometry = fit_constants(one.campaign.question, robot, data, ())
                found = noise_causes(geometry.geometric, (), data)
                further = () if found is None else found.further
                clean, named = clean + bool(further and data is one.rows), named + bool(further and data is coarse)
                if data is coarse and len(further) == len(robot.readings):
                    sizes.append(min(c.value for c in further) * np.sqrt(12.0) / step)
        ends = f"{min(sizes, default=np.nan):.2f} to {max(sizes, default=np.nan):.2f}"
        print(f"{way:20} {done:4} {clean:12} {named:14} {len(sizes):10} {ends:>18}", flush=True)


def draw_effect(joints: Sequence[str], load: dict[str, float], rng: np.random.Generator) -> dict[str, Any]:
    """An effect as a scenario has it, its coefficients of natural proportions and not yet of its size."""
    name, where = str(rng.choice(KINDS)), str(rng.choice(list(joints)))
    keys: dict[str, Any] = {"kind": name, "where": where}
    if name == "joint_harmonic":
        keys["order"] = [int(rng.integers(1, 5))]
    elif name == "axis_wobble":
        keys |= {"order": [int(rng.integers(1, 3))], "motion": [str(rng.choice(["r1", "r2"]))]}
    elif name == "joint_coupling":
        keys["with"] = str(rng.choice([other for other in joints if other != where]))
    elif name == "joint_backlash":
        keys["by"] = "load"
    elif name == "thermal":
        keys["motion"] = [str(rng.choice(["x", "y", "z"]))]
    count = {"joint_harmonic": 2, "axis_wobble": 2}.get(name, 1)
    per = load[where] if name == "joint_compliance" else 6.0 if name == "thermal" else 1.0
    return keys | {"coefficients": (SMALL / per * rng.standard_normal(count)).tolist() if count > 1 else [SMALL / per]}


def blind(kind: str | None, cases: int, seed: int) -> None:
    """What a search names of one undeclared effect, and what it invents where there is none."""
    for way in [kind] if kind else BLIND:
        named, alike, invented, ratios, false, took, done = 0, 0, 0, [], 0, 0.0, 0
        for k in range(cases):
            number = seed * 10_000 + k
            rng = np.random.default_rng([number, 13])
            n = 2 * rows_of(way)
            keys, robot = scenario(way, "six", number, n)
            try:
                clean, started = made(noisy(keys), robot), time.process_time()
                arm = _searched(clean)
                took += time.process_time() - started
                said = arm.diagnosed.found.state.active
                false += bool(said)
                if said:
                    print(f"  {way} {number} clean -> {', '.join(sorted({_said(a.effect) for a in said}))}")
                one, effect = _with_effect(way, number, n, rng)
                arm = _searched(one)
            except Exception as fault:  # a crash is a result, and must not end the others
                print(f"  {way} {number} failed: {type(fault).__name__}: {str(fault)[:160]}")
                continue
            done += 1
            found = {a.effect for a in arm.diagnosed.found.state.active}
            places = {(e.kind, e.where) for e in found}
            twins = {(t.kind, t.where) for others in arm.diagnosed.confounded for t in others}
            right = (effect["kind"], effect["where"]) in places | twins
            invented += len(places) - bool(right and places)
            new = elsewhere(one, QUERIES)
            errors = [error_of(f, new) for f in (arm.geometry.geometric, arm.diagnosed.fit, _oracle(one, effect))]
            named += right
            alike += right or errors[1] < 1.2 * errors[2]
            ratios.append(errors[1] / errors[2])
            if not right:
                print(f"  {way} {number} {effect['kind']} at {effect['where']} -> {sorted(places)}; error {errors}")
        if done:
            p = np.percentile(ratios, [50, 95])
            print(
                f"{way}: named right {named}/{done}, right or as good as the oracle {alike}/{done}, invented beside {invented}; "
                f"clean with an effect {false}/{cases}; error over the oracle's: median {p[0]:.2f}, 95 % {p[1]:.2f}; "
                f"{took / cases:.1f} s a search", flush=True
            )  # fmt: skip


def _said(effect: Effect) -> str:
    return f"{effect.kind} at {effect.where}"


def _searched(one: Made) -> Any:
    """Do what ``aridcal identify`` does: constants and search."""
    geometry = fit_constants(one.campaign.question, one.robot, one.rows, ())
    return calibrated_arm(one.campaign.question, one.robot, one.rows, (), geometry, SILENT)


def _with_effect(way: str, seed: int, n: int, rng: np.random.Generator) -> tuple[Made, dict[str, Any]]:
    """A campaign with one effect that leaves a residual of a size that is drawn, in sigma."""
    keys, robot = scenario(way, "six", seed, n)
    while True:
        effect = draw_effect(robot.names, {name: 50.0 / (k + 1) for k, name in enumerate(robot.names)}, rng)
        keys, _ = scenario(way, "six", seed, n, [effect])
        try:
            one = made(keys, robot)
        except AridcalError:
            continue
        left = geometric(one).residual / spread(one.sigma, one.rows.channels)
        size = float(np.sqrt(np.mean(left**2)))
        wanted = float(np.exp(rng.uniform(*np.log(SIZES))))
        coefficients = np.array(effect["coefficients"]) * wanted / max(size, 1e-300)
        if wanted / max(size, 1e-300) * SMALL < 0.01:  # nor larger than 10 mrad
            effect["coefficients"] = coefficients.tolist()
            keys, _ = scenario(way, "six", seed, n, [effect])
            return made(noisy(keys), robot), effect


def _oracle(one: Made, effect: dict[str, Any]) -> Fit:
    """The fit of one who knows what is wrong, and looks for nothing else."""
    declared = {name: value for name, value in effect.items() if name != "coefficients"}
    keys = one.campaign.model_dump(by_alias=True, exclude_unset=True)
    keys |= {"effects": [declared], "diagnosis": {"enabled": False}}
    told = one.campaign.model_copy(
        update={name: getattr(type(one.campaign).model_validate(keys), name) for name in ("effects", "diagnosis")}
    )
    geometry = fit_constants(told.question, one.robot, one.rows, ())
    found: Fit = calibrated_arm(told.question, one.robot, one.rows, (), geometry, SILENT).diagnosed.fit
    return found
