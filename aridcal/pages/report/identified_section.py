"""The report on the parameters: which are identifiable, and what was identified."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from markupsafe import Markup

from aridcal.engine.corrections.effect import FRAME_COMPONENTS, LINK_COMPONENTS
from aridcal.engine.fit.constants import has_world
from aridcal.engine.robot.doty import Link, doty_links
from aridcal.jobs.calibrate.folder import frames, parameters
from aridcal.jobs.calibrate.joint_zeros import joint_zeros
from aridcal.jobs.calibrate.key_figures import constants, solved_stages
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.html import Content, codes, fold, table, tag
from aridcal.pages.drawing.parts import zero_in_words
from aridcal.pages.report.second_look_section import combinations_section
from aridcal.system.wording import fixed, number, plural, plus_minus

SYMBOLS = {"d": "d", "theta": "θ", "beta": "β", "a": "a", "alpha": "α"}
ZERO = "axis"
"""Component of a joint's zero, which repairs have beside its origin."""
MOST_FRAMES = 12
MOST_PARTNERS = 6

# One parameter as :func:`aridcal.jobs.calibrate.folder.parameters` has it.
Parameter = dict[str, Any]


def identifiable(outcome: Outcome) -> Iterator[Content]:
    """Question 2: which parameters are identifiable?"""
    redundant = outcome.stage("geometric").fit.redundant
    if not redundant:
        yield tag("p", "All requested parameters are identifiable.")
    else:
        yield from _redundant(redundant)
    fit = outcome.stage("geometric").fit
    rank = f"{len(fit.theta):,} of {len(fit.candidates):,} coefficients identified"
    yield fold(f"{rank}, condition number {number(fit.convergence.condition)}", _convergence(outcome))
    yield from combinations_section(outcome)


def _redundant(redundant: dict[str, tuple[str, ...]]) -> Iterator[Content]:
    """What keeps its nominal value, and why."""
    yield tag(
        "p",
        f"{plural(len(redundant), 'coefficient')} cannot be told from others by these measurements. Each keeps its nominal "
        "value, and the others contain its error. Predictions of the target lose nothing by this.",
    )
    lines = [[tag("code", name), _partners(names)] for name, names in redundant.items()]
    shown = table(["keeps its nominal value", "confounded with"], lines, "Redundant coefficients", numbers=2)
    yield fold("What each is confounded with", shown)


def _convergence(outcome: Outcome) -> Markup:
    """Rank and convergence of every fitted model."""
    stages = solved_stages(outcome)
    facts: dict[str, list[str]] = {
        "coefficients requested": [],
        "coefficients identified (the rank)": [],
        "condition number, columns scaled to length 1": [],
        "iterations": [],
        "remaining step of the gradient, in σ": [],
        "other starting points that reach the same minimum": [],
    }
    for stage in stages.values():
        fit, c = stage.fit, stage.fit.convergence
        values = [
            f"{len(fit.candidates):,}",
            f"{len(fit.theta):,}",
            number(c.condition),
            f"{c.steps:,}",
            number(c.gradient, 2),
            f"{c.agreed} of {c.restarts}" if c.restarts else "none tried",
        ]
        for fact, value in zip(facts.values(), values, strict=True):
            fact.append(value)
    lines = [[what, *values] for what, values in facts.items()]
    return table(["model", *stages], lines, "Rank and convergence")


def _partners(names: tuple[str, ...]) -> Content:
    """What a redundant coefficient is confounded with."""
    if not names:
        return "nothing: it hardly moves what is measured, or the places that are measured follow it"
    shown = codes(names[:MOST_PARTNERS])
    rest = len(names) - MOST_PARTNERS
    return [shown, f" and {rest} more" if rest > 0 else ""]


def identified(outcome: Outcome) -> Iterator[Content]:
    """Geometric parameters and frames with their uncertainty."""
    yield from _zeros(outcome)
    yield fold("All constants", list(_constants(outcome)))
    said = tag(
        "p",
        tag("code", "world_base"), " is the pose of the robot's base in the measured world, ",
        tag("code", "tip_target"), " the pose of the measured target on the tip. Their ± is a twist in the frame's own "
        "axes. Neither is in the URDF.",
        " No instrument knows a frame of the world here: it is the base's own."
        if not outcome.measurements.direct and not has_world(outcome.measurements)
        else "",
    )  # fmt: skip
    yield fold("Frames of base and target", said, list(_frames(outcome)))


def _zeros(outcome: Outcome) -> Iterator[Content]:
    """The joints' zeros among the constants, as those who adjust them call them."""
    zeros = joint_zeros(outcome.stage("geometric").fit, outcome.robot)
    if not zeros:
        return
    lines: list[list[Content]] = [[zero.joint, codes(zero.names), zero_in_words(zero)] for zero in zeros]
    joints = {zero.joint for zero in zeros}
    rest = [name for name in outcome.robot.readings if name not in joints]
    said = tag(
        "p",
        "A zero that is off by +1 mrad (1 mm of a sliding joint) means that the joint stands that much beyond its reading. "
        "The calibrated URDF has it: correct it there or at the controller, not at both.",
        [" The zeros of ", codes(rest), " are contained in the frames of base or target, or were not asked for."]
        if rest
        else "",
    )
    head = ["joint", "constant", "zero off by ± 1σ"]
    shown = table(head, lines, "Zeros of the joints, among the other constants", numbers=2)
    yield fold(f"Zeros of {plural(len(zeros), 'joint')}", said, shown)


def _constants(outcome: Outcome) -> Iterator[Content]:
    """A table of the corrections for each link or joint origin."""
    groups: dict[str, list[Parameter]] = {}
    for p in constants(outcome):
        where, component = p["name"].rsplit(".", 1)
        groups.setdefault(where, []).append(p | {"component": component})
    if not groups:
        yield tag("p", "No geometric parameters were requested.")
    elif outcome.campaign.parameters.set in ("doty", "angles"):
        yield tag(
            "p",
            "Parameters of the link after each joint, Tz(d) Rz(θ) Ry(β) Tx(a) Rx(α), with one standard deviation. "
            "Where two axes intersect, θ and β are undefined; yaw and pitch of the next origin replace them.",
        )
        nominal = {link.joint: link for link in doty_links(outcome.robot)}
        tables = [_link(nominal, where, group) for where, group in groups.items()]
        yield tag("div", tables, class_="links wide")
    else:
        yield tag(
            "p",
            "Corrections of each joint's own origin, in its own axes, relative to the nominal URDF, with one standard "
            "deviation.",
            " Those marked nominal are redundant (section 2)." if outcome.stage("geometric").fit.redundant else "",
        )
        yield tag("div", [_origin(where, group) for where, group in groups.items()], class_="links")


def _correction(p: Parameter) -> str:
    """A correction with its uncertainty, or why it has none."""
    if p["status"] != "identified":
        return "nominal" if p["status"] == "redundant" else "fixed"
    unit = "mrad" if p["unit"] == "rad" else "mm"
    return f"{plus_minus(1e3 * p['value'], 1e3 * p['std'])} {unit}"


def _origin(where: str, group: list[Parameter]) -> Markup:
    """Corrections of a joint's origin."""
    by_component = {p["component"]: p for p in group}
    ordered = [by_component[c] for c in (*FRAME_COMPONENTS, ZERO) if c in by_component]
    lines = [
        ["zero" if p["component"] == ZERO else p["component"], _correction(p)]
        for p in ordered
        if p["status"] == "identified"
    ]
    nominal = [p["component"] for p in ordered if p["status"] != "identified"]
    if nominal:
        lines.append([", ".join(nominal), "nominal"])
    return table(["", "correction ± 1σ"], lines, tag("code", where))


def _link(nominal: dict[str, Link], where: str, group: list[Parameter]) -> Markup:
    """Nominal and calibrated parameters of the link after a joint."""
    lines = []
    for p in group:
        component, angle = p["component"], p["unit"] == "rad"
        if component not in LINK_COMPONENTS:
            lines.append([f"{component} of its origin", "", _correction(p), ""])
            continue
        start = 0.0 if component == "d" else float(getattr(nominal[where], component))
        before, after = (length_or_angle(v, angle) for v in (start, start + p["value"]))
        lines.append([SYMBOLS[component], before, _correction(p), after])
    return table(["", "nominal", "correction ± 1σ", "calibrated"], lines, tag("code", where))


def length_or_angle(value: float, angle: bool) -> str:
    """An angle [rad] in degrees, or a length [m] in millimetres, with its unit."""
    return f"{fixed(math.degrees(value), 4)}°" if angle else f"{fixed(1e3 * value, 3)} mm"


def _frames(outcome: Outcome) -> Iterator[Content]:
    """A table for each identified frame."""
    status = {p["name"]: p["status"] for p in parameters(outcome.stage("geometric").fit)}
    every_frame = frames(outcome.stage("final"))
    shown = list(every_frame.items())[:MOST_FRAMES]
    yield tag("div", [_frame(name, frame, status) for name, frame in shown], class_="links")
    rest = len(every_frame) - len(shown)
    if rest:
        yield tag("p", tag("em", f"and {rest} more; result.json lists them all"))


def _frame(name: str, frame: dict[str, Any], status: dict[str, str]) -> Markup:
    """Position and angles of one frame; ``status`` by the names of its coefficients."""
    lines = []
    values = [*frame["xyz"], *frame["rpy"]]
    for k, component in enumerate(FRAME_COMPONENTS):
        angle = k >= 3
        state = status[f"{name}.{component}"]
        unit = "mrad" if angle else "mm"
        spread = f"{number(1e3 * frame['std'][k], 2)} {unit}" if state == "identified" else state
        lines.append([component, length_or_angle(values[k], angle), spread])
    return table(["", "value", "± 1σ"], lines, tag("code", name))
