"""Causes that the rows could not tell from those named, in use: how far predictions differ between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.model.model import Model
from aridcal.engine.trust.unobservable import with_untold
from aridcal.engine.trust.workspace import Untold, target_covariance


@dataclass(frozen=True)
class Rival:
    """A cause that the rows could not tell from the one named.

    Attributes:
        effect: In words.
        instead_of: The effect that is named, in words.
        weight: How likely it is, of that effect and its rivals.
        change: By how much coefficients differ from the model's with it.
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
    ways: list[Untold] = []
    for effect in dict.fromkeys(rival.instead_of for rival in rivals):
        own = [rival for rival in rivals if rival.instead_of == effect]
        shift: dict[Coefficient, float] = {}
        for rival in own:
            for c, value in rival.change:
                shift[c] = shift.get(c, 0.0) + rival.weight * value
        itself = 1.0 - sum(rival.weight for rival in own)
        for weight, change in ((itself, {}), *((rival.weight, dict(rival.change)) for rival in own)):
            root = np.sqrt(max(weight, 0.0))
            ways.append(tuple((c, root * (change.get(c, 0.0) - value)) for c, value in shift.items()))
        for c, value in shift.items():
            mean[c] = mean.get(c, 0.0) + value
    wide, values, covariance = with_untold(model, theta, ways)
    return wide, values + np.array([mean.get(c, 0.0) for c in wide.coefficients]), covariance


def between(
    model: Model,
    theta: np.ndarray,
    rivals: Sequence[Rival],
    readings: np.ndarray,
    covariates: Mapping[str, np.ndarray],
    labels: tuple[np.ndarray | None, np.ndarray | None],
    seen: Mapping[str, tuple[float, float]],
    tool: np.ndarray | None = None,
) -> np.ndarray:
    """Covariance of the target between an effect and its rivals, shape (N, 6, 6), world axes; see :func:`with_rivals`.

    Args:
        model: Of the calibration.
        theta: Its coefficients, shape (K,).
        rivals: Of its effects.
        readings: Shape (N, columns).
        covariates: Shape (N,) each; what is missing, or a hole, is at the end of what was seen where the rivals differ more.
        labels: Of stations and of targets, shape (N,) each, where frames have some.
        seen: Lowest and highest value of columns.
        tool: A point that moves with the target, in its axes, shape (3,), [m].
    """
    wide, values, covariance = with_rivals(model, theta, rivals)
    found: np.ndarray | None = None
    for end in (0, 1):
        given = dict(covariates)
        for name in wide.needs:
            there = given.get(name, np.full(len(readings), np.nan))
            given[name] = np.where(np.isnan(there), seen.get(name, (0.0, 0.0))[end], there)
        own = target_covariance(wide, values, covariance, wide.rows(readings, given, *labels), tool)
        if found is None:
            found = own
        else:
            larger = np.einsum("nii->n", own[:, :3, :3]) > np.einsum("nii->n", found[:, :3, :3])
            found[larger] = own[larger]
    assert found is not None
    return found
