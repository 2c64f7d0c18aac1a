"""Effects that the rows so far show, as a campaign declares them: such rows are too few for the search to find them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc

from aridcal.files.campaign import EffectDeclaration
from aridcal.jobs.guide.posterior import Posterior

SHOWN = 1e-2
"""Probability of an effect that is not there to look as large: of some twenty suspects one in five campaigns declares one in
vain, which costs less than one left out."""


@dataclass(frozen=True)
class _Suspect:
    """An effect that may be there, and the numbers of its coefficients."""

    declaration: EffectDeclaration
    coefficients: list[int]
    shown: bool


def shown_effects(posterior: Posterior) -> tuple[EffectDeclaration, ...]:
    """Effects of gears whose coefficients differ from zero by more than their uncertainty allows."""
    return _together([suspect.declaration for suspect in _suspects(posterior) if suspect.shown])


def left_out(posterior: Posterior) -> np.ndarray:
    r"""By how much the unknowns of a model without the suspects that are not shown differ from the posterior's, shape (D,).

    Where some unknowns u are held at zero, the others follow: :math:`d = \Sigma_{:u} \Sigma_{uu}^{-1} \theta_u`.
    """
    hidden = [k for suspect in _suspects(posterior) if not suspect.shown for k in suspect.coefficients]
    u = posterior.things + np.array(hidden, dtype=int)
    if not len(u):
        return np.zeros(len(posterior.information))
    theta = posterior.setup.theta + posterior.step[posterior.things :]
    covariance = posterior.covariance
    return np.asarray(covariance[:, u] @ np.linalg.solve(covariance[np.ix_(u, u)], theta[hidden]))


def _suspects(posterior: Posterior) -> list[_Suspect]:
    """Suspects of joints that turn, harmonics order by order."""
    coefficients = posterior.setup.model.coefficients
    things, covariance = posterior.things, posterior.covariance
    theta = posterior.setup.theta + posterior.step[things:]
    of: dict[tuple[str, str, float], list[int]] = {}
    for k, c in enumerate(coefficients):
        if c.component != "axis" or not c.basis.of:
            continue
        if c.basis.form in ("sin", "cos"):
            of.setdefault((c.where, "joint_harmonic", c.basis.numbers[0]), []).append(k)
        elif c.basis.of[0].endswith(".gravity_torque"):
            of.setdefault((c.where, "joint_compliance", 0.0), []).append(k)
        elif c.basis.of[0].endswith("_direction"):
            of.setdefault((c.where, "joint_backlash", 0.0), []).append(k)
    suspects = []
    for (where, kind, order), some in of.items():
        if kind == "joint_harmonic":
            declaration = EffectDeclaration(kind=kind, where=where, order=(order,))
        elif kind == "joint_backlash":
            declaration = EffectDeclaration(kind=kind, where=where, by="direction")
        else:
            declaration = EffectDeclaration(kind=kind, where=where)
        u = things + np.array(some)
        square = float(theta[some] @ np.linalg.solve(covariance[np.ix_(u, u)], theta[some]))
        suspects.append(_Suspect(declaration, some, bool(gammaincc(len(some) / 2.0, square / 2.0) < SHOWN)))
    return suspects


def _together(shown: list[EffectDeclaration]) -> tuple[EffectDeclaration, ...]:
    """Harmonics of a joint as one effect."""
    orders: dict[str, tuple[float, ...]] = {}
    for effect in shown:
        if effect.order is not None:
            orders[effect.where] = (*orders.get(effect.where, ()), *effect.order)
    others = [effect for effect in shown if effect.order is None]
    waves = [EffectDeclaration(kind="joint_harmonic", where=where, order=order) for where, order in orders.items()]
    return (*waves, *others)
