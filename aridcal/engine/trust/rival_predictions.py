"""Causes that the rows could not tell from those named, in use: how far predictions differ between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.model.model import Model
from aridcal.engine.trust.unobservable import with_unobservable
from aridcal.engine.trust.workspace import OpenCombination, target_covariance


@dataclass(frozen=True)
class Rival:
    """A cause that the rows could not tell from the one named.

    Attributes:
        effect: The cause in words.
        instead_of: The effect that is named, in words.
        weight: Probability of the cause among that effect and all its rivals, 0 to 1.
        change: Differences of coefficients from the model's, if this cause is the right one.
    """

    effect: str
    instead_of: str
    weight: float
    change: tuple[tuple[Coefficient, float], ...]


def with_rivals(model: Model, theta: np.ndarray, rivals: Sequence[Rival]) -> tuple[Model, np.ndarray, np.ndarray]:
    r"""The mean over the causes that the rows could not tell apart, and the covariance between them.

    .. math:: \bar\theta = \theta + \sum_k w_k c_k, \qquad \sum_k w_k (c_k - \bar c)(c_k - \bar c)^T

    for the changes :math:`c_k` of each effect's rivals, and of the effect itself, which changes nothing (Bayesian model
    averaging; Hoeting et al. 1999, doi:10.1214/ss/1009212519). A rival's own uncertainty is taken to be the model's: the same
    rows told either.

    Args:
        model: As named, K coefficients.
        theta: Their values, shape (K,).
        rivals: Of its effects.

    Returns:
        The model with the coefficients of rivals beside its own, the mean of all, and their covariance.
    """
    mean: dict[Coefficient, float] = {}
    roots: list[OpenCombination] = []
    for effect in dict.fromkeys(rival.instead_of for rival in rivals):
        of_effect = [rival for rival in rivals if rival.instead_of == effect]
        shift: dict[Coefficient, float] = {}
        for rival in of_effect:
            for c, value in rival.change:
                shift[c] = shift.get(c, 0.0) + rival.weight * value
        itself = 1.0 - sum(rival.weight for rival in of_effect)
        for weight, change in ((itself, {}), *((rival.weight, dict(rival.change)) for rival in of_effect)):
            root = np.sqrt(max(weight, 0.0))
            roots.append(tuple((c, root * (change.get(c, 0.0) - value)) for c, value in shift.items()))
        for c, value in shift.items():
            mean[c] = mean.get(c, 0.0) + value
    wide, values, covariance = with_unobservable(model, theta, roots)
    return wide, values + np.array([mean.get(c, 0.0) for c in wide.coefficients]), covariance


def covariance_between(
    model: Model,
    theta: np.ndarray,
    rivals: Sequence[Rival],
    readings: np.ndarray,
    covariates: Mapping[str, np.ndarray],
    labels: tuple[np.ndarray | None, np.ndarray | None],
    ranges: Mapping[str, tuple[float, float]],
    tool: np.ndarray | None = None,
) -> np.ndarray:
    """Covariance of the target between an effect and its rivals, shape (N, 6, 6), world axes; see :func:`with_rivals`.

    Args:
        model: Of the calibration.
        theta: Its coefficients, shape (K,).
        rivals: Of its effects.
        readings: Shape (N, columns).
        covariates: Shape (N,) each; a missing column, or a hole, is taken at the end of its range where the rivals differ more.
        labels: Labels of stations and of targets, shape (N,) each, where frames have some.
        ranges: Lowest and highest value of each column at the fitted rows.
        tool: A point that moves with the target, in its axes, shape (3,), [m].
    """
    wide, values, covariance = with_rivals(model, theta, rivals)
    largest: np.ndarray | None = None
    for end in (0, 1):
        columns = dict(covariates)
        for name in wide.needs:
            values_there = columns.get(name, np.full(len(readings), np.nan))
            columns[name] = np.where(np.isnan(values_there), ranges.get(name, (0.0, 0.0))[end], values_there)
        covariance_of_end = target_covariance(wide, values, covariance, wide.rows(readings, columns, *labels), tool)
        if largest is None:
            largest = covariance_of_end
        else:
            larger = np.einsum("nii->n", covariance_of_end[:, :3, :3]) > np.einsum("nii->n", largest[:, :3, :3])
            largest[larger] = covariance_of_end[larger]
    assert largest is not None
    return largest
