"""What was found, in figures: each effect's gain on rows never used, its curve, and whether the rest is noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aridcal.catalogue import Scene, merged
from aridcal.diagnosis import Bound, Diagnosed, linear_bench, rows_of
from aridcal.effects import ANGULAR, Effect, evaluate
from aridcal.evidence import solve
from aridcal.outcome import Curve, Diagnosis, NamedEffect, Rejected
from aridcal.search import Bench, State
from aridcal.solver import Fit
from aridcal.whiteness import LEAST, Clue

GRID = 160
FLOOR_P = 1e-300


def explain(diagnosed: Diagnosed, bound: Bound, test: Bound | None, clues: Sequence[Clue]) -> Diagnosis:
    """Gather what the search did.

    Args:
        diagnosed: The search and the final model.
        bound: The training rows.
        test: The rows never used; None where there are none.
        clues: Whether what remains is noise.
    """
    found = diagnosed.found
    state = found.state
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, a in enumerate(state.active):
        groups.setdefault(_identity(a.effect), []).append(k)
    stated = {_identity(e) for e in diagnosed.declared}
    other = _test_bench(diagnosed, test)
    effects = []
    for identity, members in groups.items():
        own = [state.active[k] for k in members]
        effect = merged([a.effect for a in own])
        before, after = _with_and_without(other, state, members)
        if test is not None and test.measured.relative is not None:
            before, after = (r * test.measured.relative[:, : r.shape[1]] for r in (before, after))
        twins = {_identity(e): e for k in members for e in diagnosed.confounded[k] if _identity(e) not in groups}
        p_value = max(min(1.0, min(a.score.p_value for a in own) * max(found.tested, 1)), FLOOR_P)
        curves = tuple(_curves(effect, diagnosed.fit, diagnosed.scene, diagnosed.bench, state))
        effects.append(NamedEffect(effect, identity in stated, p_value, before, after, tuple(twins.values()), curves))
    effects.sort(key=lambda e: _rms(e.after) - _rms(e.before))
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


def _test_bench(diagnosed: Diagnosed, test: Bound | None) -> Bench | None:
    if test is None or len(test.train) == 0:
        return None
    return linear_bench(
        test, diagnosed.linearised_at, diagnosed.found.state.active, (), rows_of(test, diagnosed.scene.measured)
    )


def _with_and_without(test: Bench | None, state: State, own: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of the test rows without some effects, the rest refitted, and with all."""
    if test is None:
        empty = np.zeros((0, state.residual.shape[1]))
        return empty, empty
    design = np.concatenate([test.A, *(a.columns(test) for a in state.active)], axis=2)
    owner = np.concatenate(
        [np.full(test.A.shape[2], -1), *(np.full(len(a.precision), k) for k, a in enumerate(state.active))]
    )
    keep = np.flatnonzero(~np.isin(owner, own))
    less = solve(state.sums.part(keep), state.precision[np.ix_(keep, keep)], state.solution.sigma, fixed=True)
    return test.r - design[:, :, keep] @ less.beta, test.r - design @ state.solution.beta


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
            grid = np.linspace(float(seen.min()), float(seen.max()), GRID)
            # A second covariate (a rail's travel, say) is held at its median.
            held = {o: np.full(GRID, float(np.median(scene.table[o]))) for c in part for o in c.basis.of[1:]}
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
