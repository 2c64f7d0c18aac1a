"""Kinds of effects of cameras and sonars: what a lens or a sonar does otherwise than declared."""

from __future__ import annotations

from aridcal.engine.corrections.effect_kind import EffectKind
from aridcal.engine.corrections.instrument_kinds import thing_effects

LENS = (("k1",), ("k1", "k2"), ("k1", "k2", "k3"), ("p1", "p2"))
"""Terms of OpenCV's lens model that make sense together: radial ones of rising order; those of a lens askew."""

HEAD_ROLE = "head"
"""Role of a head of a camera and sonars, which are places of their own."""


CAMERA_SONAR_KINDS = (
    EffectKind(
        "lens_distortion",
        where="`camera`",
        words="the lens bends the picture otherwise than declared",
        bases=("ones",),
        example="{kind: lens_distortion, where: camera, motion: [k1, k2]}",
        doc="of-instruments",
        testable=thing_effects("lens_distortion", ("camera", HEAD_ROLE), *LENS),
        of_head="camera",
        shown=("image_radius",),
    ),
    EffectKind(
        "focal_length",
        where="`camera`",
        words="the camera's scale is not the one declared",
        bases=("ones",),
        example="{kind: focal_length, where: camera}",
        doc="of-instruments",
        testable=thing_effects("focal_length", ("camera", HEAD_ROLE), ("f",), ("fx", "fy")),
        of_head="camera",
        shown=("image_radius",),
    ),
    EffectKind(
        "principal_point",
        where="`camera`",
        words="the camera's centre is not where it was declared",
        bases=("ones",),
        example="{kind: principal_point, where: camera}",
        doc="of-instruments",
        testable=thing_effects("principal_point", ("camera", HEAD_ROLE), ("cx", "cy")),
        of_head="camera",
    ),
    EffectKind(
        "sonar_bias",
        where="`sonar_1` ..., or all `sonars` alike",
        words="the sonar reads too long or too short",
        bases=("ones",),
        example="{kind: sonar_bias, where: sonar_2}",
        doc="of-instruments",
        testable=thing_effects("sonar_bias", (HEAD_ROLE,), ("bias",)),
        of_head="sonar",
    ),
    EffectKind(
        "sonar_scale",
        where="`sonar_1` ..., or all `sonars` alike",
        words="the sonar's reading grows too fast or too slowly",
        bases=("ones",),
        example="{kind: sonar_scale, where: sonars}",
        doc="of-instruments",
        testable=thing_effects("sonar_scale", (HEAD_ROLE,), ("scale",)),
        of_head="sonar",
        shown=("range",),
    ),
)
"""In the order in which they are tried."""
