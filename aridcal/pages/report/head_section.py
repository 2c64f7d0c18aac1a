"""The chapter on the measuring head: its parameters, its mounting, and the closed form of Doty (1992) beside the fit."""

from __future__ import annotations

from collections.abc import Iterator

import pinocchio as pin
from markupsafe import Markup

from aridcal.jobs.calibrate.doty_answer import ClosedForm
from aridcal.jobs.calibrate.key_figures import scored
from aridcal.jobs.calibrate.measuring_head import HeadNumber, MeasuringHead
from aridcal.jobs.calibrate.outcome import Outcome, errors
from aridcal.pages.drawing.html import Content, fold, table, tag
from aridcal.pages.report.identified_section import length_or_angle
from aridcal.system.wording import fixed, number, plural, plus_minus

# Link parameters of the closed form: symbol, column of a row (d, θ, β, a, α), and whether it is an angle.
LINKS = (("θ", 1, True), ("β", 2, True), ("a", 3, False), ("α", 4, True))

COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")


def measuring_head(outcome: Outcome) -> Iterator[Content]:
    """What was found of camera and sonars."""
    head = outcome.head
    assert head is not None
    yield _misfit(head)
    yield _parameters(head)
    if head.ranges.shape[1]:
        yield fold("Sonars", _sonars(head))
    yield fold("How far the camera sits from where head.yaml has it", _mount(outcome, head))
    if head.closed_form is not None:
        shown = list(_closed_form(outcome, head.closed_form))
        yield fold("The closed form of Doty (1992) on the same poses", shown)


def _misfit(head: MeasuringHead) -> Markup:
    """How well image points and ranges of single shots agree."""
    shot_of_fiducial = head.fiducials["shot"]
    shots = len(set(shot_of_fiducial.tolist()))
    before, after = (number(times) for times in head.misfit)
    return tag(
        "p",
        f"{plural(shots, 'shot')} with {len(shot_of_fiducial) / shots:.0f} fiducials each on average. Once a pose is fitted to "
        "a shot, its image points and ranges must agree, whatever the arm does. They deviate by "
        f"{before} times their stated noise with the head as declared, and by {after} times with the head as identified; "
        "noise alone gives 1.",
    )


def _parameters(head: MeasuringHead) -> Markup:
    """Parameters of the head that differ from the declared ones."""
    moved = [n for n in head.numbers if n.status != "fixed"]
    if not moved:
        return tag(
            "p", "No parameter of the camera or the sonars needed a correction: all keep their values of head.yaml."
        )
    titles = ["parameter", "as declared", "as identified ± 1σ"]
    shown = table(titles, [_line(n) for n in moved], "Identified parameters of the head")
    return fold(f"{plural(len(moved), 'identified parameter')} of the head", shown)


def _line(n: HeadNumber) -> list[Content]:
    """One parameter of the head, declared and identified."""
    scale, unit = {"m": (1e3, " mm"), "px": (1.0, " px")}.get(n.unit, (1.0, ""))
    declared = f"{number(scale * n.declared)}{unit}"
    assert n.std is not None
    return [tag("code", n.name), declared, f"{plus_minus(scale * n.value, scale * n.std)}{unit}"]


def _sonars(head: MeasuringHead) -> Markup:
    """Residuals of the ranges."""
    lines = []
    for k, (declared, identified) in enumerate(head.ranges.T, start=1):
        lines.append([f"sonar_{k}", f"{number(1e3 * declared)} mm", f"{number(1e3 * identified)} mm"])
    caption = "Residuals of the sonar ranges, RMS over all shots"
    return table(["sonar", "head as declared", "head as identified"], lines, caption)


def _mount(outcome: Outcome, head: MeasuringHead) -> Markup:
    """How far the camera sits from where head.yaml has it, in its own axes."""
    fit = outcome.stage("final").fit
    declared, identified = (pin.SE3(T) for T in head.mount)
    change = pin.log6(declared.actInv(identified)).vector
    std = dict(zip(fit.model.names, fit.std, strict=True))
    lines: list[list[Content]] = []
    for k, component in enumerate(COMPONENTS):
        name, unit = f"tip_target.{component}", "mm" if k < 3 else "mrad"
        if name in std:
            value = plus_minus(1e3 * float(change[k]), 1e3 * float(std[name]))
            lines.append([component, f"{value} {unit}"])
        else:
            partners = ", ".join(fit.redundant.get(name, ()))
            lines.append([component, f"as declared{f': confounded with {partners}' if partners else ''}"])
    caption = (
        "Mounting of the camera, T_tip_camera (tip_target elsewhere on this page): change from head.yaml, in the camera's "
        "own axes"
    )
    return table(["", "change ± 1σ"], lines, caption)


def _closed_form(outcome: Outcome, closed: ClosedForm) -> Iterator[Content]:
    """The closed form on the same poses, beside the full solution."""
    yield tag(
        "p",
        "Doty (1992), errata corrected: link lengths and angle offsets come from x and y of the end frame, then pitches β "
        "and twists α from the matrix E of equation 3-12, with equal weights for all poses. The closed form takes base and "
        "camera as known; here it gets those of the full solution. The full solution weights each pose by its own noise, is "
        "exact in the angles, and identifies base, camera and head by itself.",
    )
    yield _link_table(closed)
    mask, words = scored(outcome)
    lines: list[list[Content]] = []
    for name, residual in (("closed form", closed.residual), ("full solution", outcome.stage("final").residual)):
        e = errors(residual, mask, outcome.channels)
        lines.append([name, *(number(e[channel.key]["rms"]) for channel in outcome.channels)])
    yield table(["solution", *(channel.title for channel in outcome.channels)], lines, f"RMS on {words}")


def _link_table(closed_form: ClosedForm) -> Markup:
    """Every link parameter: nominal, by the closed form, by the full solution."""
    lines: list[list[Content]] = []
    for i in range(len(closed_form.links)):
        last = i + 1 == len(closed_form.links)
        for symbol, column, angle in LINKS:
            if last and symbol not in ("α", "β"):
                continue  # a_4 is none of the closed form's unknowns, and the full solution has theta_4 in the camera
            values = [links[i, column] for links in (closed_form.nominal, closed_form.links, closed_form.full)]
            _, closed, full = values
            cells = [length_or_angle(value, angle) for value in values]
            gap = f"{fixed(1e3 * (closed - full), 3)} {'mrad' if angle else 'mm'}"
            lines.append([f"{symbol}{i + 1}", *cells, gap])
    head = ["link parameter", "nominal", "closed form", "full solution", "closed form − full"]
    return table(head, lines, "Links as in Doty (1992): θ offset of the reading, β pitch, a length, α twist")
