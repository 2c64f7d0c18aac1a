"""Kinds for what is not the same all over the workspace: constants along a rail, over a column or in space; a field of shifts.

Doty (1992), sections 1 and 8, calibrates the arm at each square of a strip and interpolates between them. Here the deviation
from the one model of the whole workspace is a smooth function of the place, whose size and length the data choose: no size at
all where they do not ask for it. By label, each has a deviation of its own, and their size alone is chosen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import FRAME_COMPONENTS, LINK_COMPONENTS, MOUNTING_FRAMES, Coefficient, Effect
from aridcal.engine.corrections.effect_kind import LEAST_KNOTS, Declaration, EffectKind, ObservedRows, bumps
from aridcal.engine.corrections.joint_kinds import RAIL_KNOTS
from aridcal.engine.corrections.labels import LABEL_COLUMN
from aridcal.engine.corrections.sights import TARGET
from aridcal.engine.robot.doty import links_down

IN_SPACE = "place"
"""What ``by`` says of a deviation that depends on where the target is."""

MOST_NODES = 96
"""Work: Of a field in space, so many that each of three strips of 28 squares has its own."""

WIDTHS = (2.0, 4.0, 8.0, 16.0)
"""Work: Radii of the functions about nodes that are tried, in distances between nodes, an octave apart: two is the least with
which no place between the nodes is left out, sixteen is beyond the whole field."""

ALONE = 2.0
"""Distances between nodes from the nearest one, beyond which nothing was measured: places are half of one from it, and a field
that is smooth over the nodes goes on a little."""

SHIFT, TURN = ("x", "y", "z"), ("roll", "pitch", "yaw")


def _regional(rows: ObservedRows) -> Iterator[Effect]:
    """Tilts of each link along each rail; by label also joints' zeros and frames."""
    for rail in rows.moving("prismatic"):
        for where, motion in _links(rows):
            yield _varying(rows, "regional", where, motion, rail.name)
    if len(rows.labels) > 1:
        zeros = [(joint.name, ("axis",)) for joint in rows.moving()]
        frames = [(where, motion) for where in MOUNTING_FRAMES for motion in (SHIFT, TURN)]
        for where, motion in (*_links(rows), *zeros, *frames):
            yield _varying(rows, "regional", where, motion, LABEL_COLUMN)


def _residual_field(rows: ObservedRows) -> Iterator[Effect]:
    """The target's own shift over its place, alike over distances of an octave each."""
    if TARGET[0] in rows.table:
        field = _varying(rows, "residual_field", "world_base", SHIFT, IN_SPACE)
        yield from widths(field) if field.coefficients else ()


def _links(rows: ObservedRows) -> Iterator[tuple[str, tuple[str, ...]]]:
    """The bend and twist of each link; of one whose next axis meets its own, of the origin beyond it."""
    for link in links_down(rows.robot):
        if not link.singular:
            yield link.joint, ("beta", "alpha")
        elif link.next_origin in rows.robot.names:
            yield str(link.next_origin), ("pitch", "roll")


def _declared(rows: ObservedRows, d: Declaration) -> Iterator[Effect]:
    """The effect of a declaration: a joint's or a frame's motions over a reading, a column or in space; by default its tilts."""
    motion = d.motion or dict(_links(rows)).get(d.where) or (SHIFT if d.where in MOUNTING_FRAMES else FRAME_COMPONENTS)
    by = d.by or IN_SPACE
    labels = (LABEL_COLUMN,) if len(rows.labels) > 1 else ()
    if set(motion) <= set(_motions(rows, d.where)) and by in (IN_SPACE, *labels, *rows.varying()):
        effect = _varying(rows, d.kind, d.where, motion, by)
        if effect.coefficients:
            yield effect


def _motions(rows: ObservedRows, where: str) -> tuple[str, ...]:
    """Components that may vary at a place: of frames, of a joint and of its link."""
    if where in MOUNTING_FRAMES:
        return FRAME_COMPONENTS
    of_link = next((link.components for link in links_down(rows.robot) if link.joint == where), ())
    return ("axis", *FRAME_COMPONENTS, *of_link)


def _varying(rows: ObservedRows, kind: str, where: str, motion: tuple[str, ...], by: str) -> Effect:
    """Motions of one place as smooth functions of a covariate, or of the target's place; empty where there are too few.

    By label they are as many numbers as there are labels, each alike in size alone.
    """
    if by == LABEL_COLUMN and rows.labels:
        bases = [Basis("label", (name,)) for name in rows.labels]
        every = tuple(Coefficient(where, component, basis) for component in motion for basis in bases)
    elif by == IN_SPACE:
        bases = ball_field(np.column_stack([rows.table[name] for name in TARGET]))
        every = tuple(Coefficient(where, component, basis) for component in motion for basis in bases)
    else:
        curves = (bumps(where, component, by, rows.table[by], RAIL_KNOTS) for component in motion)
        every = tuple(coefficient for curve in curves for coefficient in curve)
    return Effect(kind, where, every, by=by, smooth=True)


def ball_field(places: np.ndarray) -> list[Basis]:
    """Functions about nodes among some places, shape (N, 3), [m]: one for every two of them; the narrowest that are tried."""
    different = np.unique(np.round(places, 6), axis=0)
    count = min(len(different) // 2, MOST_NODES)
    if count < LEAST_KNOTS:
        return []
    nodes, beyond = spread_out(different, count)
    apart = np.sort(np.linalg.norm(nodes[:, None] - nodes, axis=2), axis=1)[:, 1]
    radius = round(WIDTHS[0] * max(float(np.median(apart)), beyond), 6)
    return [Basis("ball", TARGET, (*node, radius)) for node in np.round(nodes, 6).tolist()]


def spread_out(places: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Some of many places, spread evenly over them: each in turn is the one furthest from those before it.

    T. F. Gonzalez, Theoretical Computer Science 38 (1985) 293: no choice of as many leaves any place more than half as near.

    Args:
        places: Shape (N, 3), [m].
        count: How many to choose.

    Returns:
        The chosen places, shape (count, 3), and the largest distance of any place from the nearest of them, [m].
    """
    chosen = [int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < min(count, len(places)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return places[chosen], float(distance.max())


def far_from_nodes(bases: Iterable[Basis], places: np.ndarray) -> np.ndarray:
    """Places, shape (N, 3), at which a field in space says nothing since it was measured nowhere near, shape (N,) bool.

    Further from its nodes than twice as far as any of these is from its neighbour; False where there are but single dents.
    """
    from scipy.spatial.distance import cdist  # slow to load, and a campaign is read without it

    nodes: dict[float, list[tuple[float, ...]]] = {}
    for basis in dict.fromkeys(bases):
        if basis.form == "ball":
            nodes.setdefault(basis.numbers[3], []).append(basis.numbers[:3])
    far = np.zeros(len(places), dtype=bool)
    for group in (np.array(group) for group in nodes.values() if len(group) >= LEAST_KNOTS):
        gap = np.sort(cdist(group, group), axis=1)[:, 1].max()
        far |= cdist(places, group).min(axis=1) > ALONE * gap
    return far


def widths(effect: Effect) -> tuple[Effect, ...]:
    """A field in space with functions of each radius that is tried; any other effect as it is."""
    if not is_field(effect):
        return (effect,)
    return tuple(replace(effect, coefficients=_wider(effect.coefficients, width / WIDTHS[0])) for width in WIDTHS)


def _wider(coefficients: tuple[Coefficient, ...], factor: float) -> tuple[Coefficient, ...]:
    wider = []
    for c in coefficients:
        *node, radius = c.basis.numbers
        wider.append(replace(c, basis=replace(c.basis, numbers=(*node, round(factor * radius, 6)))))
    return tuple(wider)


def is_field(effect: Effect) -> bool:
    """True for a smooth function of a place in space."""
    return effect.coefficients[0].basis.form == "ball"


def is_of_labels(effect: Effect) -> bool:
    """True for deviations of single labels."""
    return effect.coefficients[0].basis.form == "label"


def is_local(effect: Effect) -> bool:
    """True for what says nothing but where its rows are: a field in space, or deviations of labels."""
    return is_field(effect) or is_of_labels(effect)


def labels_of(bases: Iterable[Basis]) -> tuple[str, ...]:
    """Covariates of labels on which some bases depend, each once."""
    return tuple(dict.fromkeys(basis.of[0] for basis in bases if basis.form == "label"))


def without_label(bases: Iterable[Basis], columns: Mapping[str, np.ndarray], count: int) -> np.ndarray:
    """Rows of a label that nobody knows, where deviations of labels are known, shape (count,) bool.

    Args:
        bases: Of a model.
        columns: Covariates of labels, shape (count,) each.
        count: Of the rows.
    """
    of_labels = labels_of(bases)
    labelled = np.zeros(count, dtype=bool)
    for name in of_labels:
        labelled |= columns[name] > 0.0
    return ~labelled if of_labels else labelled


REGIONAL = EffectKind(
    "regional",
    where="a joint, `world_base` or `tip_target`",
    words="a constant that is not the same all over the workspace",
    bases=("bump", "ball", "label"),
    example="{kind: regional, where: joint_2, motion: [beta, alpha], by: joint_1}",
    doc="regional",
    testable=_regional,
    key="by",
    of_declaration=_declared,
    on_request=True,
    columns=lambda d: () if d.by in (IN_SPACE, LABEL_COLUMN) else (str(d.by),),
    curve=("axis", *FRAME_COMPONENTS, *LINK_COMPONENTS),
)

RESIDUAL_FIELD = EffectKind(
    "residual_field",
    where="`world_base` or `tip_target`",
    words="a shift of the target that depends on where it is, of no known cause",
    bases=("ball",),
    example="{kind: residual_field, where: world_base}",
    doc="residual_field",
    testable=_residual_field,
    of_declaration=_declared,
    on_request=True,
    named=False,
)
