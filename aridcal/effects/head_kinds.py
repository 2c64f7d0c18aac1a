"""Kinds of effects of instruments: what a lens, a sonar or a wire does otherwise than declared."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

from aridcal.effects.basis import Basis
from aridcal.effects.effect import Coefficient, Effect
from aridcal.effects.kinds import Kind, Observed

LENS = (("k1",), ("k1", "k2"), ("k1", "k2", "k3"), ("p1", "p2"))
"""Terms of OpenCV's lens model that make sense together: radial ones of rising order; those of a lens askew."""

HEAD = "head"
"""Role of the measuring head, whose camera and sonars are places of their own."""


def _of_things(
    kind: str, roles: Collection[str], *alternatives: tuple[str, ...]
) -> Callable[[Observed], Iterator[Effect]]:
    """What is otherwise than stated at the things of some roles, where it is not identified anyway."""

    def testable(rows: Observed) -> Iterator[Effect]:
        always = Basis("ones", (rows.robot.names[0],))
        for (of, where), held in rows.held.items():
            for components in alternatives:
                if of in roles and set(components) <= set(held):
                    yield Effect(kind, where, tuple(Coefficient(where, c, always) for c in components))

    return testable


HEAD_KINDS = (
    Kind(
        "lens_distortion",
        where="`camera`",
        words="the lens bends the picture otherwise than declared",
        bases=("ones",),
        example="{kind: lens_distortion, where: camera, motion: [k1, k2]}",
        doc="of-instruments",
        testable=_of_things("lens_distortion", ("camera", HEAD), *LENS),
        of_head="camera",
        shown=("image_radius",),
    ),
    Kind(
        "focal_length",
        where="`camera`",
        words="the camera's scale is not the one declared",
        bases=("ones",),
        example="{kind: focal_length, where: camera}",
        doc="of-instruments",
        testable=_of_things("focal_length", ("camera", HEAD), ("f",), ("fx", "fy")),
        of_head="camera",
        shown=("image_radius",),
    ),
    Kind(
        "principal_point",
        where="`camera`",
        words="the camera's centre is not where it was declared",
        bases=("ones",),
        example="{kind: principal_point, where: camera}",
        doc="of-instruments",
        testable=_of_things("principal_point", ("camera", HEAD), ("cx", "cy")),
        of_head="camera",
    ),
    Kind(
        "distance_scale",
        where="an anchor",
        words="the instrument's reading grows too fast or too slowly with the distance",
        bases=("ones",),
        example="{kind: distance_scale, where: rail}",
        doc="of-instruments",
        testable=_of_things("distance_scale", ("anchor",), ("scale",)),
    ),
    Kind(
        "sonar_bias",
        where="`sonar_1` ..., or all `sonars` alike",
        words="the sonar reads too long or too short",
        bases=("ones",),
        example="{kind: sonar_bias, where: sonar_2}",
        doc="of-instruments",
        testable=_of_things("sonar_bias", (HEAD,), ("bias",)),
        of_head="sonar",
    ),
    Kind(
        "sonar_scale",
        where="`sonar_1` ..., or all `sonars` alike",
        words="the sonar's reading grows too fast or too slowly",
        bases=("ones",),
        example="{kind: sonar_scale, where: sonars}",
        doc="of-instruments",
        testable=_of_things("sonar_scale", (HEAD,), ("scale",)),
        of_head="sonar",
        shown=("range",),
    ),
)
"""In the order in which they are tried."""
