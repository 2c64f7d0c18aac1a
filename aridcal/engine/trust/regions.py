"""Regions of the workspace, each with the constants that serve it best: what a controller that takes a URDF can be given there.

Doty (1992), section 8: the arm is calibrated at each square, and what holds at one need not hold at the next. Constants of a
region are fitted to the whole model's own predictions there, so that they carry no noise of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient, Effect
from aridcal.engine.corrections.labels import label_in
from aridcal.engine.corrections.regional_kind import IN_SPACE, is_of_labels, labels_of, spread_out
from aridcal.engine.corrections.sights import TARGET
from aridcal.engine.fit.least_squares import FIRST_NOISE, Fit, fit, thin
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import recentred
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.robot.chain import Joint
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.search.linear_model import PLAUSIBLE_SIZE

MOST_REGIONS = 28
"""Drawn: One for each square of the report's strip."""

COUNTS = (1, 2, 3, 4, 6, 8, 11, 15, 20, MOST_REGIONS)
"""Work: Numbers of regions that are tried, about 1.4 apart, until their URDFs are as near to the whole model as is worth
anything."""

NEAR_NOISE_SHARE = 0.3
"""Of the noise in space: a URDF that is nearer than that to the whole model adds 4 % to what the noise leaves."""

ROWS_OF_A_REGION = 6
"""Fitted rows for each region: fewer regions than squares where there are few rows at each."""

ROWS_AROUND = 40
"""Work: Postures to which a region's constants are fitted: three numbers each, at the least, for the twenty or thirty of an
arm."""


@dataclass(frozen=True)
class Region:
    """A part of the workspace and its constants.

    Attributes:
        name: ``region_01`` and so on.
        middle: Middle of the region in each covariate that tells regions apart, shape (d,).
        low: Lowest values of these covariates at the fitted rows of the region, shape (d,).
        high: Highest values, shape (d,).
        rows: Rows of the region, fitted and held out, shape (N,) bool.
        fit: Its constants, with the frames of the whole model.
        label: Label of its rows, where labels tell regions apart; empty for the region of all other labels. Else None.
    """

    name: str
    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rows: np.ndarray
    fit: Fit = field(repr=False)
    label: str | None = None


@dataclass(frozen=True)
class Regions:
    """All regions of a calibration.

    Attributes:
        by: Covariates that tell them apart: the region is the one whose middle is nearest, each in units of ``scale``. None
            where labels do.
        scale: Of each covariate, shape (d,).
        every: The regions.
    """

    by: tuple[str, ...]
    scale: np.ndarray
    every: tuple[Region, ...]

    def places(self, rows: Dataset) -> np.ndarray:
        """The target of each row as its own region predicts it, shape (N, 3), [m]."""
        places = np.zeros((len(rows), 3))
        for region in self.every:
            places[region.rows] = _places(region.fit, rows.select(region.rows))
        return places

    def residual(self, rows: Dataset) -> np.ndarray:
        """Measured minus predicted of each row by its own region, shape (N, m); of the rows that the regions were made of."""
        residual = np.zeros((len(rows), sum(channel.size for channel in rows.channels)))
        for region in self.every:
            if region.rows.any():
                of_region = problem(region.fit.model, rows.select(region.rows))
                residual[region.rows] = of_region.residual(region.fit.theta)
        return residual


def regions(final: Fit, rows: Dataset, fitted: np.ndarray, effects: Sequence[Effect]) -> Regions | None:
    """Divide the workspace where effects vary over it; None if none does. Where they vary by labels, each label is a region.

    Args:
        final: The whole model.
        rows: All N rows.
        fitted: Rows that the model was fitted to, shape (N,) bool.
        effects: Effects of the final model.
    """
    varying = [e for e in effects if EFFECT_KINDS[e.kind].on_request]
    if not varying:
        return None
    if any(is_of_labels(e) for e in varying):
        return _of_labels(recentred(final), rows, fitted)
    by, places = _covariates(final, rows, varying)
    scale = np.maximum(np.ptp(places[fitted], axis=0), 1e-9) if by != TARGET else np.ones(3)
    different = np.unique(np.round(places[fitted] / scale, 6), axis=0)
    most = max(len(different) // ROWS_OF_A_REGION, 1)
    start, enough = recentred(final), NEAR_NOISE_SHARE * np.sqrt(3.0) * _noise(final, rows)[0]
    whole = _places(final, rows.select(fitted))
    for count in (count for count in COUNTS if count <= most):
        result = _divided(start, rows, fitted, by, places, scale, _middles(different, count))
        apart = result.places(rows)[fitted] - whole
        if np.sqrt(np.mean(np.sum(apart**2, axis=1))) < enough:
            break
    return result


def _divided(
    final: Fit,
    rows: Dataset,
    fitted: np.ndarray,
    by: tuple[str, ...],
    places: np.ndarray,
    scale: np.ndarray,
    middles: np.ndarray,
) -> Regions:
    """Regions about some middles, shape (R, d), of rows whose covariates are ``places``, shape (N, d)."""
    nearest = np.argmin(np.linalg.norm(places[:, None] / scale - middles, axis=2), axis=1)
    every = []
    for number, middle in enumerate(middles):
        members = nearest == number
        inside = places[members & fitted] if np.any(members & fitted) else scale * middle[None]
        low, high = inside.min(axis=0), inside.max(axis=0)
        if by == TARGET:
            far = np.where(fitted, np.linalg.norm(places / scale - middle, axis=1), np.inf)
            count = max(ROWS_AROUND, int((members & fitted).sum()))
            around = rows.select(np.sort(np.argsort(far, kind="stable")[: min(count, int(fitted.sum()))]))
        else:
            around = _moved(final, rows.select(fitted), by, low, high)
        constants = _constants(final, around)
        every.append(Region(f"region_{number + 1:02d}", scale * middle, low, high, members, constants))
    return Regions(by, scale, tuple(every))


def _of_labels(final: Fit, rows: Dataset, fitted: np.ndarray) -> Regions:
    """A region for each label with constants of its own and, if all labels share the frames, one for all other labels."""
    assert rows.labels.station is not None
    names = [label_in(name) for name in labels_of(c.basis for c in final.model.coefficients)]
    at = rows_of_data(final.model, rows)
    places = final.model.target_places(at, rows.readings)
    nothing = np.zeros(0)
    apart = len(final.model.world_base) > 1 or (rows.labels.target is None and len(final.model.tip_target) > 1)
    every = []
    for number, label in enumerate(names if apart else [*names, ""]):
        members = rows.labels.station == label if label else ~np.isin(rows.labels.station, names)
        far = np.linalg.norm(
            places - (places[members & fitted] if (members & fitted).any() else places).mean(axis=0), axis=1
        )
        far = np.where(members, -1.0, far) if label else np.zeros(len(rows))
        order = np.argsort(np.where(fitted, far, np.inf), kind="stable")
        count = min(max(ROWS_AROUND, int((members & fitted).sum())), int(fitted.sum()))
        around = rows.select(np.sort(order[:count]))
        around = around.with_labels(station=np.full(len(around), label))
        constants = _constants(final, around)
        every.append(Region(f"region_{number + 1:02d}", nothing, nothing, nothing, members, constants, label))
    return Regions((), nothing, tuple(every))


def _places(fit: Fit, rows: Dataset) -> np.ndarray:
    """Predicted targets of rows, shape (N, 3), [m]."""
    return fit.model.poses(fit.theta, rows_of_data(fit.model, rows))[1]


def _noise(final: Fit, rows: Dataset) -> list[float]:
    """Sigma of a place and of a turn, per axis, [m] and [rad]."""
    sigmas = {channel.name: float(sigma) for channel, sigma in zip(rows.channels, final.sigma, strict=True)}
    return [sigmas.get(channel.name, FIRST_NOISE) for channel in (TARGET_POSITION, TARGET_ROTATION)]


def _covariates(final: Fit, rows: Dataset, effects: Sequence[Effect]) -> tuple[tuple[str, ...], np.ndarray]:
    """Covariates that tell regions apart, and their values, shape (N, d): the target's place, if any effect depends on that."""
    model = final.model
    if any(e.by == IN_SPACE for e in effects):
        at = rows_of_data(model, rows)
        return TARGET, model.target_places(at, rows.readings)
    by = tuple(dict.fromkeys(str(e.by) for e in effects))
    columns = dict(zip(model.robot.names, model.robot.positions(rows.readings).T, strict=True)) | rows.conditions
    return by, np.column_stack([columns[name] for name in by])


def _middles(different: np.ndarray, count: int) -> np.ndarray:
    """Middles of so many regions of different places, shape (count, d), in the order of the coordinate with the widest spread."""
    seeds, _ = spread_out(different, count)
    part = np.argmin(np.linalg.norm(different[:, None] - seeds, axis=2), axis=1)
    middles = np.array([different[part == k].mean(axis=0) for k in range(len(seeds))])
    along = int(np.argmax(np.ptp(middles, axis=0)))
    return np.asarray(middles[np.argsort(middles[:, along], kind="stable")])


def _moved(final: Fit, rows: Dataset, by: tuple[str, ...], low: np.ndarray, high: np.ndarray) -> Dataset:
    """Rows of all regions moved into one: covariates that tell regions apart are drawn from ``low`` to ``high``, shape (d,)."""
    some = rows.select(thin(rows_of_data(final.model, rows), 2 * ROWS_AROUND))
    share = np.random.default_rng(0).uniform(size=(len(some), len(by)))
    readings, covariates = some.readings.copy(), dict(some.covariates)
    for name, values in zip(by, (low + share * (high - low)).T, strict=True):
        joint = next((j for j in final.model.robot.joints if j.name == name), None)
        if joint is None:
            covariates[name] = values
        else:
            _place(readings, joint, values, rows.names)
    return replace(some, readings=readings, covariates=covariates)


def _place(readings: np.ndarray, joint: Joint, positions: np.ndarray, names: Sequence[str]) -> None:
    """Write readings that bring a joint to positions, shape (N,): of several that move it the one that moves it most changes."""
    factors = joint.drive.factors
    if not factors:
        return
    most = max(factors, key=lambda name: abs(factors[name]))
    by_others = sum(factor * readings[:, names.index(name)] for name, factor in factors.items() if name != most)
    readings[:, names.index(most)] = (positions - joint.drive.offset - by_others) / factors[most]


def _constants(final: Fit, around: Dataset) -> Fit:
    """The chain's constants that come nearest to the whole model at some rows; its frames and instruments stay.

    Where the base seems to stand elsewhere in a region, the first joint's origin takes that up: frames are the same for all.
    """
    at = rows_of_data(final.model, around)
    R, p = final.model.poses(final.theta, at)
    robot = final.model.robot
    sigma = _noise(final, around)
    turns = R if around.sees_turns else None
    poses = dataset(
        robot.readings, robot.kinds, around.readings, p, turns, sigma=sigma[: 1 if turns is None else 2],
        station=around.labels.station, covariates=around.covariates,
    )  # fmt: skip
    poses = poses.with_labels(target=around.labels.target)
    values = dict(zip(final.model.coefficients, final.theta.tolist(), strict=True))
    of_things = dict(zip(final.model.coefficients, final.model.at_things.tolist(), strict=True))
    frames = ("world_base", "tip_target")
    first = [Coefficient(robot.joints[0].name, component) for component in FRAME_COMPONENTS]
    of_arm = [c for c in values if of_things[c] or (c.basis.constant and c.where not in frames)]
    coefficients = tuple(dict.fromkeys([*of_arm, *first]))
    theta = np.array([values.get(c, 0.0) for c in coefficients])
    prior = Prior(theta, np.eye(len(theta)) / PLAUSIBLE_SIZE**2)
    question = problem(final.model.with_coefficients(coefficients), poses)
    return fit(question, theta, np.ones(len(poses)), prior)
