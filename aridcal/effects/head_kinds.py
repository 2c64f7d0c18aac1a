"""Kinds of effects of cameras and of the measuring head: what a lens or a sonar does otherwise than declared."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from aridcal.effects.effect import Coefficient, Effect
from aridcal.effects.instrument_kinds import of_things
from aridcal.effects.kinds import Kind

LENS = (("k1",), ("k1", "k2"), ("k1", "k2", "k3"), ("p1", "p2"))
"""Terms of OpenCV's lens model that make sense together: radial ones of rising order; those of a lens askew."""

ALL_SONARS = "sonars"
"""Where an effect acts that all sonars have alike."""


def head_effect(kind: str, where: str, *components: str) -> Effect:
    """An effect of some numbers of the head."""
    return Effect(kind, where, tuple(Coefficient(where, c) for c in components))


def _camera(kind: str, *alternatives: tuple[str, ...]) -> Callable[[Sequence[str]], Iterator[Effect]]:
    """Every head has a camera, with all of its numbers."""
    return lambda numbers: (head_effect(kind, "camera", *components) for components in alternatives)


def _sonar(kind: str, component: str) -> Callable[[Sequence[str]], Iterator[Effect]]:
    """All sonars alike, then each by itself; none where the head has none."""

    def of_sonars(numbers: Sequence[str]) -> Iterator[Effect]:
        places = [where for where, _, what in (name.partition(".") for name in numbers) if what == component]
        for where in (ALL_SONARS, *places) if places else ():
            yield head_effect(kind, where, component)

    return of_sonars


def moves(coefficient: Coefficient, number: str) -> bool:
    """True if a coefficient moves a number of the head, ``camera.fx`` or ``sonar_1.bias`` for instance."""
    where, _, component = number.partition(".")
    here = where == coefficient.where or (coefficient.where == ALL_SONARS and where.startswith("sonar_"))
    both_axes = coefficient.component == "f" and component in ("fx", "fy")
    return here and (component == coefficient.component or both_axes)


def unit(coefficient: Coefficient) -> str:
    """Unit of a coefficient of the head."""
    if coefficient.where == "camera":
        return "px" if coefficient.component[0] in "fc" else "1"
    return "m" if coefficient.component == "bias" else "1"


HEAD_KINDS = (
    Kind(
        "lens_distortion",
        where="`camera`",
        words="the lens bends the picture otherwise than declared",
        bases=("1",),
        example="{kind: lens_distortion, where: camera, motion: [k1, k2]}",
        doc="of-instruments",
        testable=of_things("lens_distortion", "camera", *LENS),
        of_head=_camera("lens_distortion", *LENS),
        shown=("image_radius",),
    ),
    Kind(
        "focal_length",
        where="`camera`",
        words="the camera's scale is not the one declared",
        bases=("1",),
        example="{kind: focal_length, where: camera}",
        doc="of-instruments",
        testable=of_things("focal_length", "camera", ("fx", "fy")),
        of_head=_camera("focal_length", ("f",), ("fx", "fy")),
        shown=("image_radius",),
    ),
    Kind(
        "principal_point",
        where="`camera`",
        words="the camera's centre is not where it was declared",
        bases=("1",),
        example="{kind: principal_point, where: camera}",
        doc="of-instruments",
        testable=of_things("principal_point", "camera", ("cx", "cy")),
        of_head=_camera("principal_point", ("cx", "cy")),
    ),
    Kind(
        "sonar_bias",
        where="`sonar_1` ..., or all `sonars` alike",
        words="the sonar reads too long or too short",
        bases=("1",),
        example="{kind: sonar_bias, where: sonar_2}",
        doc="of-instruments",
        of_head=_sonar("sonar_bias", "bias"),
    ),
    Kind(
        "sonar_scale",
        where="`sonar_1` ..., or all `sonars` alike",
        words="the sonar's reading grows too fast or too slowly",
        bases=("1",),
        example="{kind: sonar_scale, where: sonars}",
        doc="of-instruments",
        of_head=_sonar("sonar_scale", "scale"),
        shown=("range",),
    ),
)
"""In the order in which they are tried."""
