"""The report's chapter on the measuring head: its numbers, its mounting, and the answer of 1992 beside the full one."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pinocchio as pin

from aridcal.markup import Content, Html, counted, fixed, number, plus_minus, table, tag
from aridcal.outcome import ClosedForm, HeadNumber, MeasuringHead, Outcome, errors
from aridcal.sections import ERRORS, scored

LINKS = (("θ", 1, True), ("β", 2, True), ("a", 3, False), ("α", 4, True))


def measuring_head(outcome: Outcome) -> Iterator[Content]:
    """What was found of camera and sonars."""
    head = outcome.head
    assert head is not None
    shots = len(set(head.fiducials["shot"].tolist()))
    before, after = head.misfit
    yield tag(
        "p",
        f"{counted(shots, 'shot')} with {len(head.fiducials['shot']) / shots:.0f} fiducials each on average. Beyond the six "
        "numbers of a pose, image points and ranges of a shot must fit together whatever the arm does: they miss by "
        f"{number(before)} times their stated noise with the head as declared, and by {number(after)} times with the head "
        "as identified. 1 is what noise alone would leave.",
    )
    moved = [n for n in head.numbers if n.status != "fixed"]
    if moved:
        yield table(
            ["number", "as declared", "as identified ± 1σ"], [_line(n) for n in moved], "Numbers of the head that moved"
        )
    else:
        yield tag("p", "Nothing asked for another number of camera or sonars: all stay as head.yaml has them.")
    if head.ranges.shape[1]:
        lines = [
            [f"sonar_{k + 1}", *(f"{number(1e3 * v)} mm" for v in column)] for k, column in enumerate(head.ranges.T)
        ]
        caption = "What the sonars read beyond the poses, RMS over all shots"
        yield table(["sonar", "head as declared", "as identified"], lines, caption)
    yield _mount(outcome, head)
    if head.closed_form is not None:
        yield from _closed_form(outcome, head.closed_form)


def _line(n: HeadNumber) -> list[Content]:
    scale, unit = {"m": (1e3, " mm"), "px": (1.0, " px")}.get(n.unit, (1.0, ""))
    declared = f"{number(scale * n.declared) if n.declared else '0'}{unit}"
    if n.std is None:
        return [tag("code", n.name), declared, f"cannot be told from {', '.join(n.redundant_with)}"]
    return [tag("code", n.name), declared, f"{plus_minus(scale * n.value, scale * n.std)}{unit}"]


def _mount(outcome: Outcome, head: MeasuringHead) -> Html:
    """How far the camera sits from where head.yaml has it, in its own axes."""
    fit = outcome.stage("final").fit
    off = pin.log6(pin.SE3(head.mount[0]).actInv(pin.SE3(head.mount[1]))).vector
    std = dict(zip(fit.model.names, fit.std, strict=True))
    lines: list[list[Content]] = []
    for k, component in enumerate(("x", "y", "z", "roll", "pitch", "yaw")):
        name, unit = f"tip_target.{component}", "mm" if k < 3 else "mrad"
        if name in std:
            lines.append([f"{component}", f"{plus_minus(1e3 * float(off[k]), 1e3 * float(std[name]))} {unit}"])
        else:
            partners = ", ".join(fit.redundant.get(name, ())) or "anything"
            lines.append([f"{component}", f"as declared: cannot be told from {partners}"])
    about = "The camera's mounting T_tip_camera (tip_target elsewhere on this page): change, in the camera's own axes"
    return table(["", "change ± 1σ"], lines, about)


def _closed_form(outcome: Outcome, found: ClosedForm) -> Iterator[Content]:
    yield tag("h3", "The answer of 1992 on the same poses")
    yield tag(
        "p",
        "K. L. Doty's closed form, its errata corrected: link lengths and angle offsets from x and y of the end frame, then "
        "pitches β and twists α from the matrix E of his equation 3-12, all poses alike. It takes base and camera as known; "
        "here they are as the full solution has them. The full solution weighs each pose by its own noise, is exact in the "
        "angles, and finds base, camera and head by itself.",
    )
    lines: list[list[Content]] = []
    for i in range(len(found.links)):
        for symbol, k, angle in LINKS:
            if i + 1 == len(found.links) and symbol != "α" and symbol != "β":
                continue  # a_4 is none of the closed form's unknowns, and the full solution has theta_4 in the camera
            values = [array[i, k] for array in (found.nominal, found.links, found.full)]
            cells = [f"{fixed(math.degrees(v), 4)}°" if angle else f"{fixed(1e3 * v, 3)} mm" for v in values]
            gap = values[1] - values[2]
            lines.append([f"{symbol}{i + 1}", *cells, f"{fixed(1e3 * gap, 3)} {'mrad' if angle else 'mm'}"])
    head = ["link parameter", "nominal", "closed form", "full solution", "closed form − full"]
    yield table(head, lines, "Links as in the report: θ offset of the reading, pitch β, length a, twist α")
    mask, words = scored(outcome)
    lines = []
    for name, residual in (("closed form", found.residual), ("full solution", outcome.stage("final").residual)):
        e = errors(residual, mask)
        lines.append([name, *(number(e[key]["rms"]) for key in ERRORS)])
    yield table(["solution", *ERRORS.values()], lines, f"RMS on {words}")
