"""What a coefficient multiplies: where x component x basis, the one form of every correction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from aridcal.errors import CovariateNotFound, nearest
from aridcal.robot import Robot, gravity_loads, joint_frames, tip_frames, transverse

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
class Form:
    """A family of basis functions: its values, and its readable name."""

    value: Callable[[list[np.ndarray], tuple[float, ...]], np.ndarray]
    name: Callable[[tuple[str, ...], tuple[float, ...]], str]


def _bump(z: list[np.ndarray], numbers: tuple[float, ...]) -> np.ndarray:
    """Cubic B-spline centred at numbers[0] with knots numbers[1] apart: zero beyond two knots."""
    u = np.abs(z[0] - numbers[0]) / numbers[1]
    v = np.maximum(2.0 - u, 0.0)
    return np.asarray(np.where(u < 1.0, 1.0 - u * u * (1.5 - 0.75 * u), 0.25 * v * v * v))


FORMS: dict[str, Form] = {
    "ones": Form(lambda z, n: np.ones_like(z[0]), lambda of, n: "1"),
    "linear": Form(lambda z, n: z[0] - n[0], lambda of, n: of[0]),
    "power": Form(lambda z, n: ((z[0] - n[0]) / n[1]) ** n[2], lambda of, n: f"{of[0]}^{n[2]:g}"),
    "sin": Form(lambda z, n: np.sin(n[0] * z[0]), lambda of, n: f"sin({n[0]:g}*{of[0]})"),
    "cos": Form(lambda z, n: np.cos(n[0] * z[0]), lambda of, n: f"cos({n[0]:g}*{of[0]})"),
    "sign": Form(lambda z, n: np.sign(z[0]), lambda of, n: f"sign({of[0]})"),
    "bump": Form(_bump, lambda of, n: f"map({of[0]}@{n[0]:.6g})"),
    "bump2": Form(
        lambda z, n: _bump(z[:1], n[:2]) * _bump(z[1:], n[2:]),
        lambda of, n: f"map({of[0]}@{n[0]:.6g},{of[1]}@{n[2]:.6g})",
    ),
    "times_power": Form(lambda z, n: (z[0] - n[0]) * (z[1] / n[1]) ** n[2], lambda of, n: f"{of[0]}*{of[1]}^{n[2]:g}"),
}


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
        tail = "" if self.basis.constant else f":{basis_name(self.basis).replace(f'{self.where}.', '')}"
        return f"{self.where}{label}.{self.component}{tail}"


@dataclass(frozen=True)
class Effect:
    """One cause of error: a kind, a place, and the coefficients that describe it (FORMATS section 4).

    Attributes:
        kind: Of the table of kinds.
        where: A joint of the chain, ``world_base`` or ``tip_target``.
        coefficients: One for each motion and basis.
        order: Periods per turn, for harmonics and wobble.
        with_: The other joint of a coupling.
        by: What a backlash switches with.
        smooth: True where the coefficients are samples of a smooth function and shrink to zero where unseen.
        grid: For a smooth function of two covariates: samples along each; else empty.
    """

    kind: str
    where: str
    coefficients: tuple[Coefficient, ...]
    order: tuple[float, ...] = ()
    with_: str | None = None
    by: str | None = None
    smooth: bool = False
    grid: tuple[int, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Samples of a smooth function along each of its covariates."""
        return self.grid or (len(self.coefficients),)

    @property
    def motion(self) -> tuple[str, ...]:
        """Components that move, each once."""
        return tuple(dict.fromkeys(c.component for c in self.coefficients))

    @property
    def covariates(self) -> tuple[str, ...]:
        """Columns it depends on, each once."""
        return tuple(dict.fromkeys(name for c in self.coefficients for name in c.basis.of))

    @property
    def label(self) -> str:
        """Short name for tables and messages."""
        extra = self.with_ or self.by or (",".join(f"{k:g}" for k in self.order) if self.order else "")
        return f"{self.kind} at {self.where}" + (f" ({extra})" if extra else "")


def basis_name(basis: Basis) -> str:
    """Readable name of a basis, ``sin(2*joint_3)`` for instance."""
    return FORMS[basis.form].name(basis.of, basis.numbers)


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
    return FORMS[basis.form].value(columns, basis.numbers)


@dataclass(frozen=True)
class Surroundings:
    """What the loads on the joints need beside the readings.

    Attributes:
        gravity: In the base frame, [m/s^2], shape (3,), or (worlds, 3) where each station has its own base.
        lever: The payload's place, T_tip_target of the geometric stage, shape (3,), [m].
    """

    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    lever: np.ndarray = field(default_factory=lambda: np.zeros(3))


def covariate_table(
    robot: Robot,
    readings: np.ndarray,
    measured: Mapping[str, np.ndarray],
    around: Surroundings,
    world: np.ndarray,
    wanted: set[str],
) -> dict[str, np.ndarray]:
    """Everything that a basis may depend on, computed once from the nominal model.

    Args:
        robot: The nominal chain.
        readings: Shape (N, columns), [rad] or [m].
        measured: Columns of the table, shape (N,) each.
        around: Gravity and the payload's place.
        world: Index of each row's world_base frame, shape (N,).
        wanted: Names that are needed; loads are computed only if one of them is.

    Returns:
        The joints' positions by name; the measured columns; ``JOINT.gravity_torque`` (force, if prismatic) and
        ``JOINT.gravity_moment_C`` for the components C in which a joint does not move; ``JOINT.payload_torque``.
    """
    table = dict(measured)
    table |= dict(zip(robot.names, robot.positions(readings).T, strict=True))
    if not any(".gravity_" in name or ".payload_" in name for name in wanted):
        return table
    gravity = np.broadcast_to(np.atleast_2d(around.gravity)[world if np.ndim(around.gravity) == 2 else 0],
                              (len(readings), 3))  # fmt: skip
    loads = gravity_loads(robot, readings, gravity)
    for j, joint in enumerate(robot.joints):
        force, moment = loads[:, j, :3], loads[:, j, 3:]
        table[f"{joint.name}.gravity_torque"] = (moment if joint.kind == "revolute" else force) @ joint.axis
        for component in bearing_components(joint.kind):
            table[f"{joint.name}.gravity_moment_{component}"] = moment @ bearing_direction(component, joint.axis)
    payload = measured.get("payload")
    if payload is not None:
        axes, origins = joint_frames(robot, readings)
        R, tip = tip_frames(robot, readings)
        target = tip + R @ around.lever
        for j, joint in enumerate(robot.joints):
            moment = np.cross(target - origins[:, j], payload[:, None] * gravity)
            push = moment if joint.kind == "revolute" else payload[:, None] * gravity
            table[f"{joint.name}.payload_torque"] = np.einsum("nji,nj,i->n", axes[:, j], push, joint.axis)
    return table


def bearing_components(kind: str) -> tuple[str, ...]:
    """The rotations that a joint does not drive."""
    return ("r1", "r2") if kind == "revolute" else ("roll", "pitch", "yaw")


def bearing_direction(component: str, axis: np.ndarray) -> np.ndarray:
    """Unit vector about which a rotation of :func:`bearing_components` turns, in the joint's axes, shape (3,)."""
    if component in FRAME_COMPONENTS:
        return np.eye(3)[FRAME_COMPONENTS.index(component) % 3]
    return transverse(axis)[int(component[1]) - 1]
