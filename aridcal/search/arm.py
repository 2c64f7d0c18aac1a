"""The arm calibrated from measured poses: frames and constants, then effects that nobody declared."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from aridcal.effects.basis import Basis
from aridcal.effects.effect import Effect
from aridcal.effects.loads import Surroundings
from aridcal.fit.residual import problem
from aridcal.fit.stages import Geometry, fit_geometry, recentred
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.channels import spread
from aridcal.inputs.dataset import Dataset
from aridcal.model.model import Model
from aridcal.robot.chain import Robot
from aridcal.search.diagnose import Diagnosed, diagnose

EARTH = np.array([0.0, 0.0, -9.81])
"""Gravity in a levelled world, [m/s^2]."""


@dataclass(frozen=True)
class CalibratedArm:
    """A calibrated arm.

    Attributes:
        rows: All rows, the held-out ones too.
        geometry: Frames alone, and frames with constants; the latter recentred and knowing gravity.
        diagnosed: The final model and how it came about.
    """

    rows: Dataset
    geometry: Geometry
    diagnosed: Diagnosed


def fit_constants(campaign: Campaign, robot: Robot, rows: Dataset, labels: tuple[str, ...]) -> Geometry:
    """Frames and constants from the training rows, the frames at their identified place."""
    found = fit_geometry(campaign, robot, rows.select(rows.train), labels)
    geometric = recentred(found.geometric)
    around = surroundings(campaign, geometric.model, "payload" in rows.covariates)
    return replace(found, geometric=replace(geometric, model=replace(geometric.model, around=around)))


def fit_arm(campaign: Campaign, geometry: Geometry, rows: Dataset, progress: Callable[[str], None]) -> CalibratedArm:
    """Look for what the constants do not explain, on the training rows, and fit all together."""
    found = diagnose(campaign, geometry.geometric, rows.select(rows.train), progress)
    stated = {d.at.number for d in campaign.effects if d.at is not None}
    return CalibratedArm(rows, geometry, settled(found, rows, stated))


def settled(found: Diagnosed, rows: Dataset, stated: Collection[float] = ()) -> Diagnosed:
    """Put each step among the held-out rows that lie between the last fitted row before it and the first one after.

    The fitted rows cannot tell on which side those are, and a wrong guess would count as an error of the model. They say
    it themselves; no coefficient depends on it. Steps that the campaign states stay.
    """
    for step in dict.fromkeys(a.effect.at for a in found.found.state.active):
        if step is not None and step.numbers[0] not in stated:
            found = _with_step(found, step, _between(found, step, rows))
    return found


def _between(found: Diagnosed, step: Basis, rows: Dataset) -> Basis:
    """The step where the held-out rows next to it fit best."""
    values = rows.conditions[step.of[0]]
    fitted = np.sort(values[rows.train])
    here = int(np.searchsorted(fitted, step.numbers[0]))
    if not 0 < here < len(fitted):
        return step
    low, high = fitted[here - 1], fitted[here]
    unknown = np.flatnonzero(rows.test & (values > low) & (values < high))
    ends = np.unique(np.concatenate([[low], values[unknown], [high]]))
    places = [replace(step, numbers=(float(middle),)) for middle in 0.5 * (ends[:-1] + ends[1:])]
    if not len(unknown):
        return step

    def misfit(place: Basis) -> float:
        fit = _with_step(found, step, place).fit
        r = problem(fit.model, rows.select(unknown)).scaled_residual(fit.theta)
        return float(np.sum((r / spread(fit.sigma, rows.channels)) ** 2))

    return min(places, key=misfit)


def _with_step(found: Diagnosed, old: Basis, new: Basis) -> Diagnosed:
    """The same with a step elsewhere between the same two fitted rows."""

    def moved(effect: Effect) -> Effect:
        return effect.placed(new.numbers[0]) if effect.at == old else effect

    coefficients = [replace(c, basis=new) if c.basis == old else c for c in found.fit.model.coefficients]
    state = found.found.state
    active = tuple(replace(a, effect=moved(a.effect)) for a in state.active)
    return replace(
        found,
        fit=replace(found.fit, model=found.fit.model.with_coefficients(coefficients)),
        found=replace(found.found, state=replace(state, active=active)),
        declared=tuple(moved(e) for e in found.declared),
    )


def surroundings(campaign: Campaign, model: Model, loaded: bool) -> Surroundings:
    """Gravity in the base frame and the payload's place, from the campaign and the geometric stage's frames.

    Args:
        campaign: Says where gravity pulls.
        model: The geometric stage's, its frames where they were identified.
        loaded: True where the rows have a payload.
    """
    gravity = campaign.robot.gravity
    lever = model.tip_target[0][1].translation
    if gravity == "world":
        vectors = [frame.rotation.T @ EARTH for _, frame in model.world_base]
        return Surroundings(np.array(vectors) if len(vectors) > 1 else vectors[0], lever, loaded)
    return Surroundings(np.array(gravity, dtype=float), lever, loaded)
