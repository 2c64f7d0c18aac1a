"""Kinds of effects of instruments that rows refer to: what a tracker, a wire or a plate does otherwise than stated."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

from aridcal.engine.corrections.basis import ALWAYS, Basis
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import EffectKind, ObservedRows
from aridcal.engine.corrections.sights import LENGTH, PLATE_COORDINATES, SAG

WIRE_POWERS = (2.0, 3.0)
"""Of the distance, in which a wire's reading may be off: as its stretch under its own drag, or a drum's growing turns."""

PLACES_EACH = 2
"""Places on a plate for each number of its shape, the three of its plane counted, from which that shape is asked about."""


def thing_effects(
    kind: str, roles: Collection[str], *alternatives: tuple[str, ...]
) -> Callable[[ObservedRows], Iterator[Effect]]:
    """Effects at the things of some roles: components off their stated values, where these are not identified anyway."""

    def testable(rows: ObservedRows) -> Iterator[Effect]:
        for (of, where), exact in rows.stated_components.items():
            for components in alternatives:
                if of in roles and set(components) <= set(exact):
                    yield Effect(kind, where, tuple(Coefficient(where, c, ALWAYS) for c in components))

    return testable


def _of_role(rows: ObservedRows, role: str) -> Iterator[str]:
    """Names of the things of a role."""
    return (where for of, where in rows.stated_components if of == role)


def _range_error(rows: ObservedRows) -> Iterator[Effect]:
    """A tracker that is off along the line of sight by its range squared; a wire that is off by a power of its length."""
    yield from thing_effects("range_error", ("tracker",), ("square",))(rows)
    for where in _of_role(rows, "anchor"):
        for power in WIRE_POWERS:
            basis = Basis("power", (where + LENGTH,), (0.0, 1.0, power))
            yield Effect("range_error", where, (Coefficient(where, "offset", basis),))


def _wire_sag(rows: ObservedRows) -> Iterator[Effect]:
    """The reading of a wire, longer by the bow in which it hangs."""
    for where in _of_role(rows, "anchor"):
        yield Effect("wire_sag", where, (Coefficient(where, "offset", Basis("linear", (where + SAG,), (0.0,))),))


def _flatness(rows: ObservedRows) -> Iterator[Effect]:
    """A plate's height over its plane: the polynomial of second order of the place on it, then that of third order."""
    for where in _of_role(rows, "plane"):
        places = rows.referred.get(("plane", where), 0)
        u, v = (where + ending for ending in PLATE_COORDINATES)
        second = (_power(u, 2.0), _product(u, v, 1.0), _power(v, 2.0))
        third = (_power(u, 3.0), _product(v, u, 2.0), _product(u, v, 2.0), _power(v, 3.0))
        for bases in (second, (*second, *third)):
            if places >= PLACES_EACH * (3 + len(bases)):
                yield Effect("flatness", where, tuple(Coefficient(where, "offset", basis) for basis in bases))


def _power(of: str, exponent: float) -> Basis:
    """A power of a covariate."""
    return Basis("power", (of,), (0.0, 1.0, exponent))


def _product(of: str, other: str, exponent: float) -> Basis:
    """A covariate times a power of another."""
    return Basis("times_power", (of, other), (0.0, 1.0, exponent))


INSTRUMENT_KINDS = (
    EffectKind(
        "tracker_scale",
        where="a block of poses or positions beside others",
        words="the instrument's lengths are all too long or too short",
        bases=("ones",),
        example="{kind: tracker_scale, where: pose}",
        doc="of-instruments",
        testable=thing_effects("tracker_scale", ("tracker",), ("scale",)),
    ),
    EffectKind(
        "distance_scale",
        where="an anchor",
        words="the instrument's reading grows too fast or too slowly with the distance",
        bases=("ones",),
        example="{kind: distance_scale, where: rail}",
        doc="of-instruments",
        testable=thing_effects("distance_scale", ("anchor",), ("scale",)),
    ),
    EffectKind(
        "range_error",
        where="an anchor, or a block of poses or positions beside others",
        words="the reading is off by the square or the cube of the distance",
        bases=("ones", "power"),
        example="{kind: range_error, where: rail}",
        doc="of-instruments",
        testable=_range_error,
        exclusive=True,
    ),
    EffectKind(
        "wire_sag",
        where="an anchor",
        words="the wire hangs in a bow and reads too long",
        bases=("linear",),
        example="{kind: wire_sag, where: rail}",
        doc="of-instruments",
        testable=_wire_sag,
    ),
    EffectKind(
        "flatness",
        where="a plane",
        words="the plate is bent, or hollow",
        bases=("power", "times_power"),
        example="{kind: flatness, where: table}",
        doc="of-instruments",
        testable=_flatness,
        exclusive=True,
    ),
)
"""In the order in which they are tried."""
