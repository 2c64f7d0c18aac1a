"""The report on the instruments: what was found of each thing, how far it fits, and what such measurements cannot tell."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

import numpy as np
from markupsafe import Markup

from aridcal.engine.fit.constants import has_world
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS
from aridcal.engine.instruments.pixels import ON_TIP
from aridcal.jobs.calibrate.instrument_results import ThingValue, known_scale_sigma
from aridcal.jobs.calibrate.key_figures import row_errors
from aridcal.jobs.calibrate.outcome import Outcome, leading
from aridcal.pages.drawing.html import Content, codes, fold, table, tag
from aridcal.pages.drawing.words import scale_in_words
from aridcal.system.wording import number, plural, plus_minus, shown_unit

MOST_THINGS = 40
"""Lines of a table of things: result.json has them all."""

MOST_NAMED_CONSTANTS = 12
"""Constants that are named in a sentence."""

CONSISTENCY = (
    "Consistency is not accuracy: a small residual says that these rows agree with one another, not that the arm is right "
    "where nothing was measured or in what these instruments cannot tell."
)

MORE = {
    "point": "one more point a known distance from another (two sockets in one plate), or points with known coordinates",
    "distance": "a second and a third anchor, or readings that spread all around each anchor",
    "plane": "two more planes, perpendicular to one another, or a gauge that reads heights",
    "pixels": "a printed board of known size, and views of it turned about all axes",
    "inclination": "points, distances or pixels: directions of gravity tell no place",
    "joined": "a known length between the hands, for the scale; a tracker or a camera, for what both arms share",
}
"""What one more measurement would tell, by kind."""

MORE_WITH_SCALE = {
    "point": "a longer known length, whose σ over its length is the scale's; points with known coordinates, for the world",
    "pixels": "views of the board turned about all axes and at several distances; a board with known place, for the world",
}
"""What one more measurement would tell where the scale is known already, by kind."""

BLIND = {
    "point": "rotation of the target about itself; where base and points stand in the world",
    "distance": "rotation of the target about itself; a turn of the base and all anchors together",
    "plane": "rotation of the target about itself; shifts and turns along the planes",
    "pixels": "what moves arm, cameras and boards together",
    "inclination": "every length; turns about the vertical",
    "joined": "the scale of both arms together; where either link's own frame is; joints that carry both links",
}
"""What rows of a kind cannot tell, whatever their number."""


def instruments(outcome: Outcome) -> Iterator[Content]:
    """What was found of the things that measurements refer to."""
    m = outcome.measurements
    yield from _scale(outcome)
    yield tag("p", CONSISTENCY)
    for role, values in groupby(outcome.things, key=lambda v: v.role):
        yield from _things(outcome, role, list(values))
    kinds = dict.fromkeys(block.kind for block in m.blocks)
    scaled = known_scale_sigma(m) not in (None, np.inf)
    more = MORE | (MORE_WITH_SCALE if scaled else {})
    lines = [[MEASUREMENT_KINDS[kind].words, BLIND[kind], more[kind]] for kind in kinds if kind in BLIND]
    if lines:
        shown = table(["instrument", "cannot tell", "what would"], lines, "By kind of measurement", numbers=3)
        yield fold("What these instruments cannot tell, and what would", shown)


def _scale(outcome: Outcome) -> Iterator[Content]:
    """How well the scale is known, and the frame in which everything stands."""
    m = outcome.measurements
    said = [f"{sentence[0].upper()}{sentence[1:]}." for sentence in scale_in_words(outcome)]
    if not said:
        said = ["Scale: the instruments measure lengths themselves; theirs is as good as they are."]
    where = "the world" if has_world(m) else "the robot's base, for no instrument knows another"
    said.append(f"Places are given in the frame of {where}.")
    alone = known_scale_sigma(m)
    yield tag("p", " ".join(said), class_="look" if alone is None or np.isinf(alone) else None)


def _things(outcome: Outcome, role: str, values: list[ThingValue]) -> Iterator[Content]:
    """All things of one role, each with its place, its rows and its own residual."""
    things = [list(own) for _, own in groupby(values, key=lambda v: v.name)]
    shown = [
        v
        for v in things[0]
        if any(each.status != "fixed" for own in things for each in own if each.component == v.component)
    ]
    components = [v.component for v in shown]
    heads = [f"{v.component} [{shown_unit(v.unit)[0]}]" if v.unit else v.component for v in shown]
    errors, unit = _own_errors(outcome, role)
    lines: list[list[Content]] = []
    for own in sorted(things, key=lambda own: -errors.get(own[0].name, (0.0, 0, 0))[0])[:MOST_THINGS]:
        rms, rows, flagged = errors.get(own[0].name, (np.nan, 0, 0))
        by_name = {v.component: v for v in own}
        cells = [_value(by_name[component]) for component in components]
        lines.append([tag("code", own[0].name), *cells, f"{rows:,}", f"{flagged:,}", number(rms)])
    places = "as identified, ± 1σ" if shown else "at places that the campaign states"
    caption = f"{role.capitalize()}s {places}; the worst first"
    parts: list[Content] = [table([role, *heads, "rows", "outliers", f"own residual RMS [{unit}]"], lines, caption)]
    if role == "camera":
        parts.append(_carriers(outcome))
    if len(things) > MOST_THINGS:
        parts.append(tag("p", tag("em", f"and {len(things) - MOST_THINGS:,} more; result.json lists them all")))
    yield fold(plural(len(things), role), parts)
    lost = [f"{v.name}.{v.component}" for v in values if v.status == "redundant"]
    if lost:
        rest = len(lost) - MOST_NAMED_CONSTANTS
        yield tag(
            "p",
            f"No row tells {plural(len(lost), 'number')} of them apart from the rest: ", codes(lost[:MOST_NAMED_CONSTANTS]),
            f" and {rest:,} more" if rest > 0 else "", ". They stay where they began.", class_="look",
        )  # fmt: skip


def _carriers(outcome: Outcome) -> Markup:
    """Which cameras stand on the tip and which in the world: their places are in that frame."""
    cameras = outcome.measurements.instruments.things["camera"]
    on_tip = cameras.start[:, ON_TIP] > 0.5
    said = []
    for where, own, other in (
        ("on the tip", on_tip, "stand in the world"),
        ("in the world", ~on_tip, "are on the tip"),
    ):
        names = [name for name, here in zip(cameras.names, own, strict=True) if here]
        if names:
            verb = "stands" if len(names) == 1 else "stand"
            said.append([codes(names), f" {verb} {where}, in whose frame the place is; boards and markers {other}. "])
    return tag("p", said)


def _value(v: ThingValue) -> str:
    """A number of a thing with its uncertainty, or why it has none."""
    if v.value is None:
        return "not told"
    scale = shown_unit(v.unit)[1]
    if v.status == "identified" and v.std is not None:
        return plus_minus(scale * v.value, scale * v.std)
    return f"{number(scale * v.value, 5)} ({v.status})"


def _own_errors(outcome: Outcome, role: str) -> tuple[dict[str, tuple[float, int, int]], str]:
    """Of each thing of a role: RMS of the final residual of its rows, their number and outliers among them; and the unit."""
    m = outcome.measurements
    error = row_errors(outcome.stages[-1].residual, outcome.channels)
    errors: dict[str, tuple[float, int, int]] = {}
    unit = ""
    for b, (block, channel) in enumerate(zip(m.blocks, leading(m), strict=True)):
        names = [each.name for each in MEASUREMENT_KINDS[block.kind].roles]
        if role not in names:
            continue
        unit = outcome.channels[channel].shown
        own = np.flatnonzero(m.labels.block == b)
        labels, thing = np.unique(m.labels.refers[own, names.index(role)], return_inverse=True)
        square, flagged = error[channel][own] ** 2, outcome.outlier[own]
        sound = ~flagged & ~np.isnan(square)
        every, wild, used = (np.bincount(thing[some], minlength=len(labels)) for some in (slice(None), flagged, sound))
        total = np.bincount(thing[sound], square[sound], minlength=len(labels))
        rms = np.sqrt(np.where(used > 0, total / np.maximum(used, 1), np.nan))
        errors |= dict(zip(labels.tolist(), zip(rms.tolist(), every.tolist(), wild.tolist(), strict=True), strict=True))
    return errors, unit
