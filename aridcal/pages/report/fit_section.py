"""The report on the fit: what each model leaves, and whether another day confirms it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from aridcal.engine.instruments.channels import Channels, spread
from aridcal.engine.robot.kinematics import start_frames
from aridcal.jobs.calibrate.key_figures import axis_rms, row_errors, scored, steps, worst_rows
from aridcal.jobs.calibrate.outcome import STATISTICS, Outcome, errors
from aridcal.pages.drawing.fields import color_steps, field
from aridcal.pages.drawing.figures import cloud_caption, histogram, panels
from aridcal.pages.drawing.html import Content, figures, fold, table, tag
from aridcal.pages.report.data_section import row_table
from aridcal.pages.report.second_look_section import halves, left_out_section
from aridcal.system.wording import number, plural, reading_in_words

PART_WORDS = {"test": "held out", "train": "fitted", "test_all": "held out, with outliers"}
STATISTIC_NAMES = dict(zip(STATISTICS, ("RMS", "mean", "median", "95 % below", "max"), strict=True))
MOST_WORST = 5

OF_KINDS = {
    "pose": "A position error is the length of the residual, a rotation error the angle of the residual rotation.",
    "position": "A position error is the length of the residual.",
    "point": "The error at a point is how far the target is from where the point was found.",
    "distance": "A distance error is the reading minus what the model has it, along the wire.",
    "plane": "An error at a plane is the reading minus the target's height over the plane as it was found.",
    "pixels": "A pixel error is how far a marker is in the image from where the model has it.",
    "joined": "An error of two links that hold one body is how far the second is from where the grasp was found, in the first.",
    "camera_sonar": "A position error is the length of the residual of the camera's pose, a rotation error the angle of its "
    "turn; the misfit within shots is what image points and ranges say beyond the pose, in sigmas.",
    "inclination": "An inclination error is the angle between gravity as measured and as the model has it.",
}
"""What the error of each kind of measurement is."""


def fits(outcome: Outcome) -> Iterator[Content]:
    """Question 4: does the model fit?"""
    mask, words = scored(outcome)
    first, last = outcome.stages[0].residual[mask], outcome.stages[-1].residual[mask]
    compared = {"before calibration": first, "after": last}
    yield tag("p", f"Errors of the {words}, before and after calibration, and where they remain:")
    yield _histograms(compared, outcome.channels)
    yield _workspace(outcome)
    yield fold("Errors of every model", list(_error_tables(outcome)))
    yield from halves(outcome)
    yield from left_out_section(outcome)
    yield fold("Axis by axis", _axis_table(outcome), _axis_pictures(compared, outcome.channels, words))
    worst = worst_rows(outcome, MOST_WORST)
    readings = [_configuration(outcome, k) for k in worst]
    shown = row_table(outcome, worst, "configuration", readings, f"The worst {words}, after calibration")
    yield fold("Rows with the largest errors", shown)


def _error_tables(outcome: Outcome) -> Iterator[Content]:
    """Error statistics of every step on every part of the rows that has any."""
    parts = {name: mask for name, mask in outcome.parts().items() if mask.any()}
    if not (parts.get("test_all", outcome.outlier) & outcome.outlier).any():
        parts.pop("test_all", None)
    shown = {name: title for name, title in PART_WORDS.items() if name in parts}
    _, *other_titles = STATISTIC_NAMES.values()
    head = ["model"]
    for title in shown.values():
        head += [f"{title}: RMS", *other_titles]
    path = steps(outcome)
    for channel in outcome.channels:
        lines = []
        for step in path:
            scores = [errors(step.residual, parts[part], outcome.channels)[channel.key] for part in shown]
            lines.append([step.title, *(number(f[s]) for f in scores for s in STATISTICS)])
        yield table(head, lines, channel.title.capitalize())
    yield _error_words(outcome)


def _error_words(outcome: Outcome) -> Markup:
    """What the lines of the error tables are."""
    effects = bool(outcome.effects)
    kinds = dict.fromkeys(block.kind for block in outcome.measurements.blocks)
    what = "".join(f"{OF_KINDS[kind]} " for kind in kinds)
    added = " Each line with a + adds one effect to the model above it, and all coefficients are fitted again."
    return tag(
        "p",
        what,
        tag("code", "nominal"), " is the unchanged URDF, with only the unknown frames fitted. ",
        tag("code", "geometric"), " adds the geometric corrections; ", tag("code", "calibrated.urdf"), " contains it.",
        added if effects else "",
        " ", tag("code", "final"), " is the whole model. Outliers are excluded unless a column says otherwise.",
    )  # fmt: skip


def _histograms(compared: dict[str, np.ndarray], channels: Channels) -> Markup:
    """Distribution of the errors before and after, from residuals (n, m)."""
    drawn: list[tuple[Content, Markup]] = []
    for k, channel in enumerate(channels):
        values = {name: _without_nan(row_errors(residual, channels)[k]) for name, residual in compared.items()}
        if not all(len(v) for v in values.values()):
            continue
        alt = f"Histogram of the {channel.title} before and after calibration"
        drawn.append((channel.title.capitalize(), histogram(channel.key, alt, values, channel.title)))
    return figures(drawn)


def _without_nan(values: np.ndarray) -> np.ndarray:
    """Values of one channel, shape (n,), without the NaN of rows that do not measure it."""
    return values[~np.isnan(values)]


def _axes(channels: Channels) -> list[str]:
    """Titles of the numbers of a residual, without those that tell nothing of the arm."""
    channels = tuple(channel for channel in channels if not channel.inner)
    names = [axis for channel in channels for axis in channel.axes]
    twice = len(names) > len(set(names))
    return [
        f"{f'{channel.name} ' if twice or len(channel.axes) == 1 else ''}{axis} [{channel.shown}]"
        for channel in channels
        for axis in channel.axes
    ]


def _axis_table(outcome: Outcome) -> Markup:
    """RMS of every step in each axis of the world."""
    mask, words = scored(outcome)
    path = steps(outcome)
    axes, of_the_arm = (
        _axes(outcome.channels),
        spread(np.array([not c.inner for c in outcome.channels]), outcome.channels),
    )
    scores = [(step.title, axis_rms(step.residual[mask], outcome.channels)[of_the_arm]) for step in path]
    lines = [[title, *(number(v) for v in values)] for title, values in scores]
    own = "the residual in world axes" if outcome.measurements.direct else "each number read"
    return table(["model", *axes], lines, f"RMS of {own}, {words}")


def _axis_pictures(compared: dict[str, np.ndarray], channels: Channels, words: str) -> Markup:
    """Residuals (n, m) row by row, before and after."""
    drawn: list[tuple[Content, Markup]] = []
    before, _ = compared.values()
    there = ~np.isnan(np.stack(list(compared.values()))).any(axis=0)
    order = np.arange(1.0, len(before) + 1)
    scale = spread(np.array([c.scale for c in channels]), channels)
    of_the_arm = np.flatnonzero(spread(np.array([not c.inner for c in channels]), channels))
    for k, axis in zip(of_the_arm.tolist(), _axes(channels), strict=True):
        own = there[:, k]
        if not own.any():
            continue
        values = {name: scale[k] * residual[own, k] for name, residual in compared.items()}
        alt = f"Residual {axis} row by row, before and after calibration"
        labels = (f"number of the row among the {words}", axis)
        caption = f"Measured minus predicted: {axis}{cloud_caption(int(own.sum()))}"
        drawn.append((caption, panels(f"axis-{k}", alt, order[own], values, labels)))
    return figures(drawn)


def _workspace(outcome: Outcome) -> Markup:
    """Errors at the target over the three planes of the world."""
    sound = ~outcome.outlier
    if outcome.measurements.direct:
        error = row_errors(outcome.stages[-1].residual[sound], outcome.channels)[0]
        points = outcome.measurements.position[sound]
    else:
        shift = outcome.at_target.shift(outcome.stages[-1].residual)
        sound &= ~np.isnan(shift).any(axis=1)
        error, points = 1e3 * np.linalg.norm(shift[sound], axis=1), _in_world(outcome)[sound]
    if not len(error):
        return tag("p", "None of these rows tells where the target is.")
    what = "Position error" if outcome.measurements.direct else "Error at the target"
    drawn: list[tuple[Content, Markup]] = []
    colors = color_steps(error)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        first, second = "xyz"[a], "xyz"[b]
        labels = (f"world {first} [m]", f"world {second} [m]")
        alt = f"{what} after calibration over {labels[0]} and {labels[1]}"
        plot = field(f"field-{first}{second}", alt, points[:, [a, b]], error, labels, "mm", colors)
        drawn.append((f"{what}, {first}–{second} plane", plot))
    return figures(drawn, "figures three")


def _in_world(outcome: Outcome) -> np.ndarray:
    """Places of the targets in the world, shape (N, 3), [m], those that are measured from a link included."""
    m, places = outcome.measurements, outcome.at_target.places
    R, p, linked = start_frames(outcome.robot, m.readings, m.labels.routes, m.labels.route)
    if not linked.any():
        return places
    _, world = outcome.stages[-1].fit.model.world_base[0]
    in_base = p + np.einsum("nij,nj->ni", R, places)
    return np.where(linked[:, None], in_base @ world.rotation.T + world.translation, places)


def _configuration(outcome: Outcome, row: int) -> str:
    """Joint readings of a row in words."""
    readings = zip(outcome.measurements.readings[row], outcome.robot.kinds, strict=True)
    return ", ".join(reading_in_words(value, kind) for value, kind in readings)


def verification(outcome: Outcome) -> Iterator[Content]:
    """How the models do on another day's data."""
    other_day = outcome.verification
    assert other_day is not None
    yield tag(
        "p",
        f"{other_day.file}: {plural(len(other_day.measurements), 'row')} that were not used for the calibration.",
    )
    if other_day.left_out:
        yield tag("p", f"{other_day.left_out}.")
    models = dict(other_day.residuals)
    if other_day.realigned is not None:
        models["final, frames refitted"] = other_day.realigned
    sound = ~other_day.outlier
    channels = other_day.measurements.channels
    shown = []
    for channel in [channels[k] for k in np.flatnonzero(other_day.measurements.measures.sum(axis=0))]:
        scores = {name: errors(residual, sound, channels)[channel.key] for name, residual in models.items()}
        lines = [[name, *(number(s[k]) for k in STATISTICS)] for name, s in scores.items()]
        shown.append(table(["model", *STATISTIC_NAMES.values()], lines, channel.title.capitalize()))
    excluded = plural(int(other_day.outlier.sum()), "gross outlier")
    yield tag(
        "p",
        f"{excluded} excluded. An error that is small only with the frames refitted says that the target or the instrument "
        "was remounted. One that stays large says that the robot has changed.",
    )
    yield fold("Errors of every model on that day", shown)
