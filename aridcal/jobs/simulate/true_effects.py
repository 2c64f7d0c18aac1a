"""True causes of error of a simulated machine: the effects a scenario names, and the columns they depend on."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, Field, model_validator

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.catalogue import EFFECT_KINDS, declared
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, ROW_ORDER, Coefficient, Effect
from aridcal.engine.corrections.effect_kind import ObservedRows
from aridcal.engine.corrections.loads import LOAD_MARKS, PAYLOAD, Surroundings, covariate_table, is_load
from aridcal.engine.corrections.sights import sight_table
from aridcal.engine.corrections.smooth import Kernel, samples_root
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, Route
from aridcal.files.campaign import EffectDeclaration
from aridcal.files.yaml_file import LARGEST_SETTING, Number, Section
from aridcal.system.errors import CampaignError, nearest
from aridcal.system.reading.table_files import FIRST_LINE

# From one row to the next, [s].
ROW_PERIOD = 30.0

# Temperature at the start and how far it wanders, [deg C].
WARMTH, WANDERS = 20.0, 6.0

# [kg]
PAYLOADS = (0.0, 1.0, 2.5, 5.0)

# Rows are measured in so many stretches with a payload each.
PAYLOAD_STRETCHES = 24

# What a curve that is drawn is like: alike over three knots.
CURVE_KERNEL = Kernel(3.0)


def _bell(distance: np.ndarray) -> np.ndarray:
    """exp(-d^2)."""
    return np.asarray(np.exp(-(distance**2)))


# Named functions: how many covariates each takes, all scaled to -1 .. 1 over the rows, and its value, at most 1.
ERROR_CURVES: dict[str, tuple[int, Callable[..., np.ndarray]]] = {
    "line": (1, lambda u: u),
    "bow": (1, lambda u: 1.0 - u**2),
    "kink": (1, np.abs),
    "step": (1, np.sign),
    "dent": (1, lambda u: _bell(4.0 * (u - 0.3))),
    "ripple": (1, lambda u: np.sin(9.4 * u + 0.5)),
    "product": (2, lambda u, v: u * v),
    "ridge": (2, lambda u, v: _bell(2.0 * (u - v))),
    "twist": (2, lambda u, v: np.sin(3.0 * u + 2.0 * v)),
}


class Parameter(Section):
    """A true value: given, or drawn from a normal distribution."""

    value: Number = 0.0
    std: float = Field(default=0.0, ge=0, le=LARGEST_SETTING)


def number_as_value(value: Any) -> Any:
    """Let a plain number stand for a value that is not drawn."""
    return {"value": value} if isinstance(value, int | float) and not isinstance(value, bool) else value


def _given_list(values: Any) -> Any:
    return tuple(number_as_value(v) for v in (values if isinstance(values, list | tuple) else (values,)))


class TrueEffect(EffectDeclaration):
    """An effect as a campaign would declare it, and how large it is.

    What is smooth (a map, a rail's straightness, an unknown effect) is a curve drawn at random with the deviation of
    its ``coefficients``, or a named function of its ``covariates``, each motion times its coefficient.
    """

    form: str | None = None
    """Key of :data:`ERROR_CURVES`."""
    coefficients: Annotated[tuple[Parameter, ...], BeforeValidator(_given_list)]
    """In the order of the catalogue, [m] or [rad] per unit of the basis; one ``{std}`` draws them all."""

    @model_validator(mode="after")
    def _can_be_simulated(self) -> TrueEffect:
        if self.form is not None:
            if self.form not in ERROR_CURVES:
                raise ValueError(f"form: no function {self.form!r}{nearest(self.form, ERROR_CURVES)}")
            kind = EFFECT_KINDS[self.kind]
            if not kind.curve:
                *others, last = (k.name for k in EFFECT_KINDS.values() if k.curve)
                raise ValueError(f"form: belongs to {', '.join(others)} and {last}; {self.kind} has its own")
            if not kind.named and (self.motion is None or self.covariates is None):
                raise ValueError(f"an {self.kind} effect with a `form` needs `motion` and `covariates`")
            count = ERROR_CURVES[self.form][0]
            if len(self.covariates or ("",)) != count:
                raise ValueError(f"form: {self.form} is a function of {count} covariates")
        return self


@dataclass(frozen=True)
class PreparedEffect:
    """A true effect made ready for the model.

    Attributes:
        effect: With K coefficients.
        values: Of the coefficients, [m] or [rad] per unit of the basis, shape (K,).
        ranges: Lowest and highest value of each covariate of a named function.
    """

    effect: Effect
    values: np.ndarray
    ranges: dict[str, tuple[float, float]]

    def document(self) -> dict[str, Any]:
        """As plain data for ``truth.json``."""
        e = self.effect
        entries: dict[str, Any] = {"kind": e.kind, "where": e.where}
        extra = {"with": e.with_, "by": e.by, "order": list(e.order) or None, "range": self.ranges or None}
        entries |= {key: value for key, value in extra.items() if value is not None}
        if e.at is not None:
            key = "row" if e.at.of[0] == ROW_ORDER else "time"
            entries["at"] = {key: math.ceil(e.at.numbers[0]) if key == "row" else e.at.numbers[0]}
        entries |= {"motion": list(e.motion), "covariates": [name for name in e.covariates if name != ROW_ORDER]}
        values = zip(e.coefficients, self.values.tolist(), strict=True)
        entries["coefficients"] = [{"name": c.name, "value": value} for c, value in values]
        return entries


@dataclass(frozen=True)
class Machine:
    """A simulated machine without its effects.

    Attributes:
        robot: The nominal chain.
        constants: Those that the scenario names, K of them.
        theta: Their true values, shape (K,).
        world: True T_world_base.
        tips: True T_tip_target by the targets' labels.
    """

    robot: Robot
    constants: tuple[Coefficient, ...]
    theta: np.ndarray
    world: pin.SE3
    tips: Mapping[str, pin.SE3]

    def along(self, route: Route, label: str) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Of readings, shape (n, columns), the poses of a target at the end of a path: (n, 3, 3) and (n, 3), [m]."""
        bare, theta = self.model()
        bare = replace(bare, routes=(route,))
        return lambda readings: bare.poses(theta, bare.rows(readings, target=np.full(len(readings), label)))

    def model(
        self, causes: Sequence[PreparedEffect] = (), around: Surroundings | None = None
    ) -> tuple[Model, np.ndarray]:
        """The machine as a model, and its true coefficients."""
        faults, values = self.faults(causes, around or Surroundings())
        made = faults.with_coefficients((*self.constants, *faults.coefficients))
        return made, np.concatenate([self.theta, values])

    def faults(self, causes: Sequence[PreparedEffect], around: Surroundings) -> tuple[Model, np.ndarray]:
        """A model with the effects alone, without the constants, and their true coefficients."""
        of_effects = tuple(c for cause in causes for c in cause.effect.coefficients)
        frames = ((None, self.world),), tuple(self.tips.items())
        values = np.concatenate([np.zeros(0), *(cause.values for cause in causes)])
        return Model(self.robot, of_effects, *frames, around), values


def columns_needed(effects: Sequence[TrueEffect], robot: Robot) -> tuple[str, ...]:
    """Columns beside the joints that some effects depend on, each once."""
    names = dict.fromkeys(name for e in effects for name in EFFECT_KINDS[e.kind].columns(e))
    return tuple(name for name in names if name not in robot.names and not is_load(name))


def draw_columns(names: Sequence[str], robot: Robot, readings: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    """Draw covariates as a day of measuring gives them; each depends on its name and the seed alone.

    Args:
        names: ``time``, ``temperature`` or ``temperature_NAME``, ``payload`` or ``payload_LINK``, ``JOINT_direction``; any
            other name is a column that wanders.
        robot: The chain.
        readings: Shape (N, columns), in the order of measuring.
        seed: Fixes everything.
    """
    columns = {}
    for name in names:
        rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
        columns[name] = _draw_column(name, robot, readings, rng)
    return columns


def _draw_column(name: str, robot: Robot, readings: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One covariate, shape (N,)."""
    n = len(readings)
    walk = np.cumsum(rng.standard_normal(n)) / np.sqrt(n)
    joint = name.removesuffix("_direction")
    if name == "time":
        return np.cumsum(ROW_PERIOD * rng.uniform(0.7, 1.3, n))
    if name == "temperature" or name.startswith("temperature_"):
        return WARMTH + WANDERS * walk
    if name == PAYLOAD or name.startswith(f"{PAYLOAD}_"):
        stretch = np.arange(n) * min(PAYLOAD_STRETCHES, n) // n
        return rng.choice(PAYLOADS, int(stretch.max()) + 1)[stretch]
    if joint != name and joint in robot.names:
        q = robot.positions(readings)[:, robot.names.index(joint)]
        first_side = rng.choice((-1.0, 1.0))
        return np.sign(np.diff(q, prepend=q[0] - first_side))
    return walk


def make_causes(
    effects: Sequence[TrueEffect],
    robot: Robot,
    readings: np.ndarray,
    columns: Mapping[str, np.ndarray],
    around: Surroundings,
    rng: np.random.Generator,
    place: str,
    lines: np.ndarray | None = None,
    tip: np.ndarray | None = None,
    held: Mapping[tuple[str, str], tuple[str, ...]] | None = None,
    places: Mapping[str, np.ndarray] | None = None,
) -> tuple[list[PreparedEffect], dict[str, np.ndarray]]:
    """Turn effects into coefficients of the model.

    Args:
        effects: What the scenario names.
        robot: The nominal chain.
        readings: Shape (N, columns), [rad] or [m].
        columns: Covariates beside the readings.
        around: Gravity, the payload's place, and that of what measures.
        rng: For coefficients that are drawn.
        place: What to name if an effect is impossible.
        lines: Of each row in its file, counted on through the files, shape (N,); None: rows of one file.
        tip: Number of each row's frame on the tip, shape (N,); None: there is one.
        held: Components of the things that rows refer to, by role and name.
        places: Covariates of places, where rows take paths of their own; None: all take the chain.

    Returns:
        The causes, and all columns that they depend on: those given, the order of the rows, and the named functions' values.

    Raises:
        CampaignError: there is no such effect on this robot, or it has other coefficients.
    """
    world = np.zeros(len(readings), dtype=int)
    order = np.arange(len(readings)) + float(FIRST_LINE) if lines is None else lines
    depends = {**columns, ROW_ORDER: order}
    table = covariate_table(robot, readings, depends, around, world, set(LOAD_MARKS))
    at_tip = world if tip is None else tip
    if places is None:
        places = sight_table(robot, readings, around.sights, np.atleast_2d(around.gravity)[0], at_tip)
    table |= places
    referred = dict.fromkeys(held or {}, len(readings))
    rows = ObservedRows(
        robot, table, tuple(columns), stated_components=held or {}, referred=referred, masses=around.masses
    )
    causes = []
    for e in effects:
        ranges: dict[str, tuple[float, float]] = {}
        if e.form is None:
            effect = declared(rows, e, place)
        else:
            names = e.covariates or (e.by or e.where,)
            column = f"{e.form}({','.join(names)})"
            depends[column], ranges = _function(e, names, table, place)
            effect = _functional(e, column, robot, place)
        causes.append(PreparedEffect(effect, values(e, effect, rng, place), ranges))
    return causes, depends


def _function(
    e: TrueEffect, names: Sequence[str], table: Mapping[str, np.ndarray], place: str
) -> tuple[np.ndarray, dict[str, tuple[float, float]]]:
    """A named function of covariates, shape (N,), and their ranges."""
    assert e.form is not None
    scaled, ranges = [], {}
    for name in names:
        if name not in table:
            raise CampaignError(f"{place}: effects: no covariate {name!r}{nearest(name, table)}")
        low, high = float(table[name].min()), float(table[name].max())
        ranges[name] = (low, high)
        scaled.append((2.0 * table[name] - low - high) / max(high - low, 1e-300))
    return np.asarray(ERROR_CURVES[e.form][1](*scaled)), ranges


def _functional(e: TrueEffect, column: str, robot: Robot, place: str) -> Effect:
    places = (*robot.names, "world_base", "tip_target")
    if e.where not in places:
        raise CampaignError(f"{place}: effects: no place {e.where!r}{nearest(e.where, places)}")
    frame = e.where in ("world_base", "tip_target")
    components = tuple(c for c in EFFECT_KINDS[e.kind].curve if not frame or c in FRAME_COMPONENTS)
    motion = e.motion or components
    for component in motion:
        if component not in components:
            raise CampaignError(
                f"{place}: effects: {e.kind} at {e.where} has no motion {component!r}: {', '.join(components)}"
            )
    basis = Basis("linear", (column,), (0.0,))
    return Effect(e.kind, e.where, tuple(Coefficient(e.where, c, basis) for c in motion))


def values(e: TrueEffect, effect: Effect, rng: np.random.Generator, place: str) -> np.ndarray:
    """True coefficients of an effect, given or drawn, shape (K,).

    Raises:
        CampaignError: it has another number of coefficients.
    """
    parameters, count = e.coefficients, len(effect.coefficients)
    if len(parameters) == 1 and parameters[0].std > 0.0:
        samples = rng.standard_normal(count)
        for component in effect.motion if effect.smooth else ():
            of_component = np.array([c.component == component for c in effect.coefficients])
            function = replace(effect, coefficients=tuple(np.array(effect.coefficients, dtype=object)[of_component]))
            samples[of_component] = samples_root(function.shape, CURVE_KERNEL) @ samples[of_component]
        return parameters[0].value + parameters[0].std * samples
    if len(parameters) != count:
        names = ", ".join(c.name for c in effect.coefficients[:8]) + (", ..." if count > 8 else "")
        raise CampaignError(
            f"{place}: effects: {effect.label} has {count} coefficients, not {len(parameters)}: {names}; give them all, "
            "or one {std} to draw them, or say `motion` or `order` for fewer"
        )
    return np.array([p.value + p.std * rng.standard_normal() for p in parameters])
