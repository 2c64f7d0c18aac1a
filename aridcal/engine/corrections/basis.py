"""Functions of covariates: what a coefficient is multiplied with, row by row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from aridcal.system.errors import CovariateNotFound, nearest


@dataclass(frozen=True)
class Basis:
    """A function of covariates; the constant 1 by default.

    Attributes:
        form: Key of the function in :data:`FORMS`.
        of: Names of the covariates it depends on.
        numbers: Its parameters: order, power, centre, knots.
    """

    form: str = "1"
    of: tuple[str, ...] = ()
    numbers: tuple[float, ...] = ()

    def __hash__(self) -> int:
        """Hash of the contents, computed once: hundreds of candidates share a basis."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.form, self.of, self.numbers))

    def __getstate__(self) -> dict[str, object]:
        """The fields without the hash: another process hashes strings otherwise."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def constant(self) -> bool:
        """True for the basis 1."""
        return self.form == "1"

    @property
    def always(self) -> bool:
        """True where it is 1 in all rows: of a constant, and of a motion where effects act."""
        return self.constant or self.form == "ones"

    @property
    def smooth(self) -> bool:
        """True where its coefficient is a sample of a smooth function."""
        return not self.constant and FORMS[self.form].smooth


CONSTANT = Basis()

ALWAYS = Basis("ones")
"""The constant 1 of what moves where effects do: at a joint behind its ``<origin>``, beside the joint's own motion."""


Columns = Sequence[np.ndarray]
"""Values of the covariates that a basis depends on, each of one shape."""

Numbers = Sequence[Any]
"""What a basis needs beside its covariates: floats, or arrays of a shape that broadcasts, for many bases at once."""


@dataclass(frozen=True)
class Form:
    """A family of basis functions.

    Attributes:
        value: The function of covariates and numbers.
        name: Its readable name: a template of ``of``, the covariates' names, and ``n``, the numbers.
        absent: What its covariate counts as where nobody gives it; None if it must be given.
        smooth: True where coefficients are samples of a smooth function, so that each means little by itself.
    """

    value: Callable[[Columns, Numbers], np.ndarray]
    name: str
    absent: float | None = None
    smooth: bool = False


def _ones(z: Columns, n: Numbers) -> np.ndarray:
    """1 in all rows, whose number no covariate tells: shape (1,)."""
    return np.ones(1)


def _linear(z: Columns, n: Numbers) -> np.ndarray:
    """Distance z - n0 from n0, where the effect is nil."""
    return np.asarray(z[0] - n[0])


def _power(z: Columns, n: Numbers) -> np.ndarray:
    """((z - n0) / n1)^n2, with n0 the middle and n1 half of the range seen."""
    centred = (z[0] - n[0]) / n[1]
    return np.asarray(centred ** n[2])


def _sine(z: Columns, n: Numbers) -> np.ndarray:
    """sin(n0 z), with n0 the order [1/rad] or the wave number [rad/m]."""
    return np.sin(n[0] * z[0])


def _cosine(z: Columns, n: Numbers) -> np.ndarray:
    """cos(n0 z); see :func:`_sine`."""
    return np.cos(n[0] * z[0])


def _sign(z: Columns, n: Numbers) -> np.ndarray:
    """-1, 0 or 1."""
    return np.sign(z[0])


def _bump(z: Columns, n: Numbers) -> np.ndarray:
    r"""Cubic B-spline centred at n0 with knots n1 apart: 1 at its centre, zero beyond two knots.

    .. math:: B(u) = 1 - \tfrac32 u^2 + \tfrac34 u^3 \ (u < 1), \quad \tfrac14 (2 - u)^3 \ (1 \le u < 2), \quad
        u = |z - n_0| / n_1

    C. de Boor, A Practical Guide to Splines (Springer, 1978), scaled by 3/2.
    """
    u = np.abs(z[0] - n[0]) / n[1]
    v = np.maximum(2.0 - u, 0.0)
    near = 1.0 - u * u * (1.5 - 0.75 * u)
    far = 0.25 * v * v * v
    return np.asarray(np.where(u < 1.0, near, far))


def _bump_of_two(z: Columns, n: Numbers) -> np.ndarray:
    """B-spline of one covariate times that of another: n0, n1 of the first, n2, n3 of the second."""
    return _bump(z[:1], n[:2]) * _bump(z[1:], n[2:])


def _ball(z: Columns, n: Numbers) -> np.ndarray:
    r"""Wendland's function of three covariates about the centre n0, n1, n2, zero beyond the radius n3.

    .. math:: B(u) = (1 - u)^4 (4 u + 1) \ (u < 1), \quad u = |z - (n_0, n_1, n_2)| / n_3

    Twice differentiable, and positive definite in space (H. Wendland, Scattered Data Approximation, Cambridge 2005, table 9.1).
    """
    square = (z[0] - n[0]) ** 2 + (z[1] - n[1]) ** 2 + (z[2] - n[2]) ** 2
    return wendland(np.sqrt(square) / n[3])


def wendland(u: np.ndarray) -> np.ndarray:
    """(1 - u)^4 (4 u + 1) of distances in radii; 0 beyond one."""
    inside = np.maximum(1.0 - u, 0.0)
    return np.asarray(inside**4 * (4.0 * u + 1.0))


def _times_power(z: Columns, n: Numbers) -> np.ndarray:
    """(z0 - n0) (z1 / n1)^n2: what grows with a power of a second covariate, a load with travel for instance."""
    return np.asarray((z[0] - n[0]) * (z[1] / n[1]) ** n[2])


def _step(z: Columns, n: Numbers) -> np.ndarray:
    """-1 before n0, 0 from there on: the constants are those of the machine as it is now."""
    return np.where(z[0] < n[0], -1.0, 0.0)


def _label(z: Columns, n: Numbers) -> np.ndarray:
    """1 in the rows of a label, 0 in all others, those of a label that nobody knows among them."""
    return np.asarray(z[0])


FORMS: dict[str, Form] = {
    "ones": Form(_ones, "1"),
    "linear": Form(_linear, "{of[0]}"),
    "power": Form(_power, "{of[0]}^{n[2]:g}"),
    "sin": Form(_sine, "sin({n[0]:g}*{of[0]})"),
    "cos": Form(_cosine, "cos({n[0]:g}*{of[0]})"),
    "sign": Form(_sign, "sign({of[0]})"),
    "bump": Form(_bump, "map({of[0]}@{n[0]:.6g})", smooth=True),
    "bump2": Form(_bump_of_two, "map({of[0]}@{n[0]:.6g},{of[1]}@{n[2]:.6g})", smooth=True),
    "ball": Form(_ball, "region({n[0]:.6g},{n[1]:.6g},{n[2]:.6g};{n[3]:.6g})", smooth=True),
    "times_power": Form(_times_power, "{of[0]}*{of[1]}^{n[2]:g}"),
    "step": Form(_step, "step({of[0]}@{n[0]:.12g})", absent=np.inf),
    "label": Form(_label, "{of[0]}", absent=0.0),
}


def basis_name(basis: Basis) -> str:
    """Readable name of a basis, ``sin(2*joint_3)`` for instance."""
    return FORMS[basis.form].name.format(of=basis.of, n=basis.numbers)


def evaluate(basis: Basis, covariates: Mapping[str, np.ndarray]) -> np.ndarray:
    """Values of a basis, shape (N,); (1,) where there are no covariates at all, and it needs none.

    Raises:
        CovariateNotFound: a column that it depends on was not measured.
    """
    values = FORMS[basis.form].value(_columns(basis.form, basis.of, covariates), basis.numbers)
    if basis.of or not covariates:
        return values
    return np.broadcast_to(values, next(iter(covariates.values())).shape)


def values_of_bases(bases: Sequence[Basis], covariates: Mapping[str, np.ndarray]) -> np.ndarray:
    """Values of bases, shape (N, B); those of one form and the same covariates at once.

    Args:
        bases: One at least.
        covariates: Shape (N,) each.

    Raises:
        CovariateNotFound: a column that they depend on was not measured.
    """
    alike: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for k, basis in enumerate(bases):
        alike.setdefault((basis.form, basis.of), []).append(k)
    values = np.empty((len(next(iter(covariates.values()))), len(bases)))
    for (form, of), members in alike.items():
        columns = [column[:, None] for column in _columns(form, of, covariates)]
        numbers = np.array([bases[k].numbers for k in members])
        values[:, members] = FORMS[form].value(columns, tuple(numbers.T))
    return values


def _columns(form: str, of: Sequence[str], covariates: Mapping[str, np.ndarray]) -> Columns:
    """Covariates of a form, each of shape (N,)."""
    absent = FORMS[form].absent
    columns = []
    for name in of:
        if name in covariates:
            columns.append(covariates[name])
        elif absent is not None:
            columns.append(np.full_like(next(iter(covariates.values())), absent, dtype=float))
        else:
            raise CovariateNotFound(
                f"the model depends on {name!r}, which was not measured{nearest(name, covariates)}: add that column"
            )
    return columns
