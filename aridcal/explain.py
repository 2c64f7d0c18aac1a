"""What was found, in figures: each effect's gain on rows never used, its curve, and whether the rest is noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aridcal.bench import Bench, State
from aridcal.catalogue import Scene, merged
from aridcal.diagnosis import Bound, Diagnosed
from aridcal.effects import ANGULAR, Effect, evaluate
from aridcal.outcome import Curve, Diagnosis, NamedEffect, Rejected
from aridcal.residual import predict_residuals
from aridcal.solver import Data, Fit
from aridcal.whiteness import LEAST, Clue

GRID = 160  # points of a curve
PER_PERIOD = 16  # points at the least in each period of a harmonic
FLOOR_P = 1e-300


def explain(diagnosed: Diagnosed, every: Bound, test: np.ndarray, clues: Sequence[Clue]) -> Diagnosis:
    """Gather what the search did.

    Args:
        diagnosed: The search and the final model.
        every: All rows.
        test: Those never used, without outliers, shape (N,).
        clues: Whether what remains is noise.
    """
    found = diagnosed.found
    state = found.state
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, a in enumerate(state.active):
        groups.setdefault(_identity(a.effect), []).append(k)
    stated = {_identity(e) for e in diagnosed.declared}
    fit, data = diagnosed.fit, every.data(diagnosed.fit.model)
    unused = data[test]

    def residual(own: Sequence[Effect], of: Data) -> np.ndarray:
        """What the model with some of its effects leaves."""
        names = {c.name for e in own for c in e.coefficients}
        keep = np.array([c.basis.constant or c.name in names for c in fit.model.coefficients], dtype=bool)
        return predict_residuals(fit.model, refitted(fit, ~keep, keep), of.rows, of.measured)

    final = predict_residuals(fit.model, fit.theta, data.rows, data.measured)
    effects = []
    for identity, members in groups.items():
        own = [state.active[k] for k in members]
        effect = merged([a.effect for a in own])
        without = residual([a.effect for k, a in enumerate(state.active) if k not in members], unused)
        twins = {_identity(e): e for k in members for e in diagnosed.confounded[k] if _identity(e) not in groups}
        p_value = max(min(1.0, min(a.score.p_value for a in own) * max(found.tested, 1)), FLOOR_P)
        curves = tuple(_curves(effect, fit, diagnosed.scene, diagnosed.bench, state))
        effects.append(
            NamedEffect(effect, identity in stated, p_value, without, final[test], final, tuple(twins.values()),
                        curves)
        )  # fmt: skip
    effects.sort(key=lambda e: -_rms(e.before))
    for k in range(len(effects) - 1):
        effects[k] = replace(effects[k], reached=residual([e.effect for e in effects[: k + 1]], data))
    return Diagnosis(
        tuple(effects),
        tuple(Rejected(v.effect, v.p_value, v.score.gain, v.why) for v in found.rejected),
        tuple((b.what, b.why) for b in diagnosed.barred),
        found.tested,
        tuple((c.what, c.share, c.p_value) for c in clues),
    )


def verdict(clues: Sequence[Clue], diagnosed: Diagnosed, enough: bool) -> tuple[str, float]:
    """The campaign's verdict, and the share of the remaining variance that is repeatable."""
    share = max((c.share for c in clues if c.tells), default=0.0)
    if not enough:
        return "not_enough_data", share
    # What has no name is followed by a smooth curve at best: between and beyond the rows it is not known.
    unnamed = any(a.effect.kind == "unknown" for a in diagnosed.found.state.active)
    return ("structure_remains" if share > LEAST or unnamed else "noise_floor"), share


def _identity(effect: Effect) -> tuple[object, ...]:
    return effect.kind, effect.where, effect.with_, effect.by


def _rms(r: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1)))) if len(r) else 0.0


def refitted(fit: Fit, gone: np.ndarray, free: np.ndarray) -> np.ndarray:
    r"""Coefficients of a model of which some are taken to be zero, and others fitted anew to the same rows.

    .. math:: \theta_F = \theta^*_F + H_{FF}^{-1} H_{FG} \theta^*_G

    Args:
        fit: The whole model, solved: theta* and H, the inverse of its covariance.
        gone: Coefficients G that become zero, shape (K,).
        free: Coefficients F that are fitted anew, shape (K,); the rest stay.

    Returns:
        Shape (K,). It is one Gauss-Newton step: constants that move by milliradians are exact to microradians, and the
        error that they leave is right to second order in that, since it is at its minimum.
    """
    scale = np.sqrt(np.diag(fit.covariance))
    H = np.linalg.inv(fit.covariance / np.outer(scale, scale))  # in units of each coefficient's sigma
    theta = np.where(gone, 0.0, fit.theta)
    step = np.linalg.solve(H[np.ix_(free, free)], H[np.ix_(free, gone)] @ (fit.theta / scale)[gone])
    theta[free] += scale[free] * step
    return theta


def _curves(effect: Effect, fit: Fit, scene: Scene, bench: Bench, state: State) -> list[Curve]:
    """The effect's motions, each over the covariate it depends on first."""
    index = {name: k for k, name in enumerate(fit.model.names)}
    theta = fit.theta
    made = []
    for component in effect.motion:
        own = [c for c in effect.coefficients if c.component == component and c.name in index]
        names = list(dict.fromkeys(c.basis.of[0] for c in own))
        for name in names:
            part = [c for c in own if c.basis.of[0] == name]
            k = [index[c.name] for c in part]
            seen = scene.table[name]
            low, high = float(seen.min()), float(seen.max())
            highest = max((abs(c.basis.numbers[0]) for c in part if c.basis.form in ("sin", "cos")), default=0.0)
            points = max(GRID, math.ceil(PER_PERIOD * highest * (high - low) / (2 * math.pi)))
            grid = np.linspace(low, high, points)
            # A second covariate (a rail's travel, say) is held at its median.
            held = {o: np.full(points, float(np.median(scene.table[o]))) for c in part for o in c.basis.of[1:]}
            phi = np.column_stack([evaluate(c.basis, held | {name: grid}) for c in part])
            rows = np.column_stack([evaluate(c.basis, scene.table) for c in part])
            place = bench.G[:, :, bench.slots.index((part[0].where, component))]
            sigma = np.repeat([state.solution.sigma.position, state.solution.sigma.rotation], 3)[: place.shape[1]]
            lever = np.sum((place / sigma) ** 2, axis=1)
            asks = np.sum(place * state.residual / sigma**2, axis=1) / np.maximum(lever, 1e-30)
            spread = np.sqrt(np.maximum(np.einsum("gi,ij,gj->g", phi, fit.covariance[np.ix_(k, k)], phi), 0.0))
            joint = next((j for j in scene.robot.joints if j.name == effect.where), None)
            turns = component in ANGULAR or (component == "axis" and joint is not None and joint.kind == "revolute")
            used = (state.weight > 0.5) & (lever > 0.05 * np.median(lever))
            made.append(
                Curve(component, "rad" if turns else "m", name, grid, phi @ theta[k], spread,
                      seen[used], (asks + rows @ theta[k])[used])
            )  # fmt: skip
    return made
