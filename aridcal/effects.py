"""What a coefficient multiplies: where x component x basis, the one form of every correction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aridcal.errors import CovariateNotFound, nearest

FRAME_COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")
LINK_COMPONENTS = ("d", "theta", "beta", "a", "alpha")
ANGULAR = frozenset({"roll", "pitch", "yaw", "theta", "beta", "alpha", "r1", "r2"})


@dataclass(frozen=True)
class Basis:
    """A function of covariates; the constant 1 by default.

    Attributes:
        form: Key of the function in :data:`FORMS`.
        of: Names of the covariates it depends on.
        numbers: What else it needs: order, power, centre, knots.
    """

    form: str = "1"
    of: tuple[str, ...] = ()
    numbers: tuple[float, ...] = ()

    @property
    def constant(self) -> bool:
        """True for the basis 1."""
        return self.form == "1"


CONSTANT = Basis()


@dataclass(frozen=True)
class Coefficient:
    """One unknown of the model: a basis times a small motion somewhere.

    Attributes:
        where: A joint of the chain, the tip's fixed joint, ``world_base`` or ``tip_target``.
        component: ``x y z roll pitch yaw``; ``axis t1 t2 r1 r2`` of a joint; ``theta beta a alpha d`` of its link.
        basis: What it is multiplied with, row by row.
        station: For one frame per station: the label of the rows that it moves.
    """

    where: str
    component: str
    basis: Basis = CONSTANT
    station: str | None = None

    @property
    def name(self) -> str:
        """The same string in tables, files and messages, ``joint_2.pitch`` for instance."""
        label = "" if self.station is None else f"[{self.station}]"
        tail = "" if self.basis.constant else f":{basis_name(self.basis)}"
        return f"{self.where}{label}.{self.component}{tail}"


def basis_name(basis: Basis) -> str:
    """Readable name of a basis, ``sin(2*joint_3)`` for instance."""
    return NAMES[basis.form](basis)


def evaluate(basis: Basis, covariates: Mapping[str, np.ndarray]) -> np.ndarray:
    """Values of a basis, shape (N,).

    Raises:
        CovariateNotFound: a column that it depends on was not measured.
    """
    columns = []
    for name in basis.of:
        if name not in covariates:
            raise CovariateNotFound(
                f"the model depends on {name!r}, which was not measured{nearest(name, covariates)}: add that column"
            )
        columns.append(covariates[name])
    return FORMS[basis.form](columns, basis.numbers)


FORMS = {
    "linear": lambda z, _: z[0],
}
NAMES = {
    "linear": lambda basis: basis.of[0],
}
