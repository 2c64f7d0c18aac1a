"""Regions of the workspace, each with the constants that serve it best: what a controller that takes a URDF can be given there.

Doty (1992), section 8: the arm is calibrated at each square, and what holds at one need not hold at the next. Constants of a
region are fitted to the whole model's own predictions there, so that they carry no noise of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aridcal.engine.corrections.catalogue import KINDS
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, Coefficient, Effect
from aridcal.engine.corrections.labels import label_in
from aridcal.engine.corrections.regional_kind import IN_SPACE, is_of_labels, labels_of, spread_out
from aridcal.engine.corrections.sights import TARGET
from aridcal.engine.fit.least_squares import UNKNOWN_NOISE, Fit, fit, thin
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import recentred
from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.model.predictions import rows_of_data
from aridcal.engine.robot.chain import Joint
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.search.linear_model import PLAUSIBLE

MOST_REGIONS = 28
"""Drawn: One for each square of the report's strip."""

COUNTS = (1, 2, 3, 4, 6, 8, 11, 15, 20, MOST_REGIONS)
"""Work: Numbers of regions that are tried, about 1.4 apart, until their URDFs are as near to the whole model as is worth
anything."""

NEAR = 0.3
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
        middle: Value of each covariate that tells regions apart, shape (d,).
        low: Their lowest values at the fitted rows of the region, shape (d,).
        high: Their highest.
        rows: Rows of it, fitted and held out, shape (N,) bool.
        fit: Its constants, with the frames of the whole model.
        label: Of its rows, where labels tell regions apart; empty of those of any other label. Else None.
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
        """Where each row's own region has its target, shape (N, 3), [m]."""
        found = np.zeros((len(rows), 3))
        for region in self.every:
            found[region.rows] = _places(region.fit, rows.select(region.rows))
        return found

    def residual(self, rows: Dataset) -> np.ndarray:
        """What each row's own region leaves of it, shape (N, m); the rows are those that the regions were made of."""
        left = np.zeros((len(rows), sum(channel.size for channel in rows.channels)))
        for region in self.every:
            if region.rows.any():
                asked = problem(region.fit.model, rows.select(region.rows))
                left[region.rows] = asked.residual(region.fit.theta)
        return left


def regions(final: Fit, rows: Dataset, fitted: np.ndarray, effects: Sequence[Effect]) -> Regions | None:
    """Regions of what deviates from the one model; None if nothing does. Where labels do, each is a region.

    Args:
        final: The whole model.
        rows: All N rows.
        fitted: Those that the models were fitted to, shape (N,) bool.
        effects: In the final model.
    """
    varying = [e for e in effects if KINDS[e.kind].asked]
    if not varying:
        return None
    if any(is_of_labels(e) for e in varying):
        return _of_labels(recentred(final), rows, fitted)
    by, places = _told_apart(final, rows, varying)
    scale = np.maximum(np.ptp(places[fitted], axis=0), 1e-9) if by != TARGET else np.ones(3)
    different = np.unique(np.round(places[fitted] / scale, 6), axis=0)
    most = max(len(different) // ROWS_OF_A_REGION, 1)
    start, enough = recentred(final), NEAR * np.sqrt(3.0) * _noise(final, rows)[0]
    whole = _places(final, rows.select(fitted))
    for count in (count for count in COUNTS if count <= most):
        found = _divided(start, rows, fitted, by, places, scale, _middles(different, count))
        apart = found.places(rows)[fitted] - whole
        if np.sqrt(np.mean(np.sum(apart**2, axis=1))) < enough:
            break
    return found


def _divided(
    final: Fit,
    rows: Dataset,
    fitted: np.ndarray,
    by: tuple[str, ...],
    places: np.ndarray,
    scale: np.ndarray,
    middles: np.ndarray,
) -> Regions:
    """Regions about some middles, shape (R, d), of what lies at places (N, d)."""
    nearest = np.argmin(np.linalg.norm(places[:, None] / scale - middles, axis=2), axis=1)
    every = []
    for number, middle in enumerate(middles):
        own = nearest == number
        inside = places[own & fitted] if np.any(own & fitted) else scale * middle[None]
        low, high = inside.min(axis=0), inside.max(axis=0)
        if by == TARGET:
            far = np.where(fitted, np.linalg.norm(places / scale - middle, axis=1), np.inf)
            wanted = max(ROWS_AROUND, int((own & fitted).sum()))
            around = rows.select(np.sort(np.argsort(far, kind="stable")[: min(wanted, int(fitted.sum()))]))
        else:
            around = _moved(final, rows.select(fitted), by, low, high)
        found = _constants(final, around)
        every.append(Region(f"region_{number + 1:02d}", scale * middle, low, high, own, found))
    return Regions(by, scale, tuple(every))


def _of_labels(final: Fit, rows: Dataset, fitted: np.ndarray) -> Regions:
    """A region for each label that deviates, and, if frames are the same for all labels, one for any other."""
    assert rows.labels.station is not None
    known = [label_in(name) for name in labels_of(c.basis for c in final.model.coefficients)]
    at = rows_of_data(final.model, rows)
    places = final.model.target_places(at, rows.readings)
    nothing = np.zeros(0)
    apart = len(final.model.world_base) > 1 or (rows.labels.target is None and len(final.model.tip_target) > 1)
    every = []
    for number, label in enumerate(known if apart else [*known, ""]):
        own = rows.labels.station == label if label else ~np.isin(rows.labels.station, known)
        far = np.linalg.norm(places - (places[own & fitted] if (own & fitted).any() else places).mean(axis=0), axis=1)
        far = np.where(own, -1.0, far) if label else np.zeros(len(rows))
        order = np.argsort(np.where(fitted, far, np.inf), kind="stable")
        count = min(max(ROWS_AROUND, int((own & fitted).sum())), int(fitted.sum()))
        around = rows.select(np.sort(order[:count]))
        around = around.with_labels(station=np.full(len(around), label))
        found = _constants(final, around)
        every.append(Region(f"region_{number + 1:02d}", nothing, nothing, nothing, own, found, label))
    return Regions((), nothing, tuple(every))


def _places(fit: Fit, rows: Dataset) -> np.ndarray:
    """Where a model has the targets, shape (N, 3), [m]."""
    return fit.model.poses(fit.theta, rows_of_data(fit.model, rows))[1]


def _noise(final: Fit, rows: Dataset) -> list[float]:
    """Of a place and of a turn, per axis, [m] and [rad]."""
    seen = {channel.name: float(sigma) for channel, sigma in zip(rows.channels, final.sigma, strict=True)}
    return [seen.get(channel.name, UNKNOWN_NOISE) for channel in (TARGET_POSITION, TARGET_ROTATION)]


def _told_apart(final: Fit, rows: Dataset, effects: Sequence[Effect]) -> tuple[tuple[str, ...], np.ndarray]:
    """Covariates by which regions are told apart, and their values, shape (N, d): the place, if anything depends on that."""
    model = final.model
    if any(e.by == IN_SPACE for e in effects):
        at = rows_of_data(model, rows)
        return TARGET, model.target_places(at, rows.readings)
    by = tuple(dict.fromkeys(str(e.by) for e in effects))
    known = dict(zip(model.robot.names, model.robot.positions(rows.readings).T, strict=True)) | rows.conditions
    return by, np.column_stack([known[name] for name in by])


def _middles(different: np.ndarray, count: int) -> np.ndarray:
    """Middles of so many regions of different places, shape (count, d), in the order of the coordinate that they spread along."""
    seeds, _ = spread_out(different, count)
    part = np.argmin(np.linalg.norm(different[:, None] - seeds, axis=2), axis=1)
    middles = np.array([different[part == k].mean(axis=0) for k in range(len(seeds))])
    along = int(np.argmax(np.ptp(middles, axis=0)))
    return np.asarray(middles[np.argsort(middles[:, along], kind="stable")])


def _moved(final: Fit, rows: Dataset, by: tuple[str, ...], low: np.ndarray, high: np.ndarray) -> Dataset:
    """Postures of all regions as the arm would take them in one: readings and columns that tell them apart between two values."""
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
    others = sum(factor * readings[:, names.index(name)] for name, factor in factors.items() if name != most)
    readings[:, names.index(most)] = (positions - joint.drive.offset - others) / factors[most]


def _constants(final: Fit, around: Dataset) -> Fit:
    """Constants of the chain that come nearest to the whole model at some rows, with its frames, and instruments as it has them.

    Where the base seems to stand elsewhere in a region, the first joint's origin takes that up: frames are the same for all.
    """
    at = rows_of_data(final.model, around)
    R, p = final.model.poses(final.theta, at)
    robot = final.model.robot
    sigma = _noise(final, around)
    turns = R if around.sees_turns else None
    wanted = dataset(
        robot.readings, robot.kinds, around.readings, p, turns, sigma=sigma[: 1 if turns is None else 2],
        station=around.labels.station, covariates=around.covariates,
    )  # fmt: skip
    wanted = wanted.with_labels(target=around.labels.target)
    known = dict(zip(final.model.coefficients, final.theta.tolist(), strict=True))
    of_things = dict(zip(final.model.coefficients, final.model.at_things.tolist(), strict=True))
    frames = ("world_base", "tip_target")
    first = [Coefficient(robot.joints[0].name, component) for component in FRAME_COMPONENTS]
    own = [c for c in known if of_things[c] or (c.basis.constant and c.where not in frames)]
    coefficients = tuple(dict.fromkeys([*own, *first]))
    theta = np.array([known.get(c, 0.0) for c in coefficients])
    prior = Prior(theta, np.eye(len(theta)) / PLAUSIBLE**2)
    asked = problem(final.model.with_coefficients(coefficients), wanted)
    return fit(asked, theta, np.ones(len(wanted)), prior)
