"""The end of the report: where the calibration holds, what to measure again, and which file is for what."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from markupsafe import Markup

from aridcal.jobs.calibrate.controllers import INDEX, ControllerExports, Export
from aridcal.jobs.calibrate.hand_eye_files import FOLDER
from aridcal.jobs.calibrate.key_figures import narrow_joints
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.pages.drawing.html import Content, bullets, codes, fold, table, tag
from aridcal.pages.drawing.words import next_command, per_number, sigmas_in_words
from aridcal.pages.report.workspace_section import workspace
from aridcal.system.wording import number, range_in_words

# How the names of the coefficients of the target's frame begin.
AT_TIP = ("tip_target.", "tip_target[")

JOINT_VALUES = (
    "Use the kind of joint values that was recorded here: reported and commanded ones differ by 0.1 to 0.2 mrad."
)


THING_MOVED: list[Content] = [
    "a socket, anchor, plane, camera or board",
    "nothing: it is an instrument, and where it stood is in result.json only",
    "every constant in the URDF, and the target",
]


def limits(outcome: Outcome) -> Iterator[Content]:
    """Question 6: where does the calibration hold?"""
    yield bullets([_outside(outcome), _uncertainty(outcome), JOINT_VALUES])
    hidden = _inside_the_target(outcome)
    if hidden:
        yield tag(
            "p",
            "The pose of the measuring target is calibrated, that of the bare tip link is only as accurate as the nominal URDF: "
            "part of the errors of ", codes(hidden), " is contained in ", tag("code", "tip_target"), ".",
        )  # fmt: skip
    yield from workspace(outcome)
    yield fold("What to measure again after a change", _after_a_change(bool(outcome.things)))


def _outside(outcome: Outcome) -> Content:
    """Joints of which less than half of the range was measured, and what the model does outside."""
    ranges = [f"{j.name} ({range_in_words(j.range, j.kind)})" for j in narrow_joints(outcome)]
    measured = (
        f"Less than half of the range was measured of: {', '.join(ranges)}."
        if ranges
        else "At least half of every joint's range was measured."
    )
    predict = tag("code", "aridcal predict")
    return [
        f"{measured} Outside of what was measured (section 3) the model extrapolates; ",
        predict,
        " marks such rows.",
    ]


def _uncertainty(outcome: Outcome) -> str:
    """What each standard deviation covers, and what it does not."""
    noise = f"{sigmas_in_words(outcome.scatter, outcome.channels)} {per_number(outcome)}"
    source = (
        "as declared in the campaign"
        if outcome.noise_source == "declared"
        else "estimated from the residuals, so that errors which the model lacks widen every ±"
    )
    return (
        f"Each ± is one standard deviation caused by the measurement noise of {noise}, {source}. Not in it: systematic errors "
        "of the instrument (scale, levelling), later changes of the robot, other loads and temperatures."
    )


def _after_a_change(things: bool) -> Markup:
    """What to repeat, by what was changed."""
    lines: list[list[Content]] = [
        [
            "measuring target or tool",
            ["5 to 20 poses with the wrist turned widely, to refit ", tag("code", "tip_target")],
            "every constant in the URDF",
        ],
        [
            "place of the robot's base or the tracker",
            ["5 to 20 poses spread over the workspace, to refit ", tag("code", "world_base")],
            "every constant in the URDF",
        ],
        *([THING_MOVED] if things else []),
        [
            "motor, encoder or zero position of one joint",
            "5 to 20 poses in which that joint moves widely",
            "all but that joint's zero",
        ],
        [
            "gear or link; a collision",
            "5 to 20 poses; the whole campaign if one zero does not explain them",
            "what they show",
        ],
    ]
    caption: Content = [
        tag("code", "aridcal check"),
        " says from such rows what moved, and ",
        tag("code", "aridcal recalibrate"),
        " fits that alone",
    ]
    return table(["changed", "measure again", "stays valid"], lines, caption, numbers=3)


def _inside_the_target(outcome: Outcome) -> list[str]:
    """Where those coefficients act that are confounded with the target's frame, in alphabetical order."""
    redundant = outcome.stage("geometric").fit.redundant
    places = set()
    for name, partners in redundant.items():
        if not name.startswith(AT_TIP) and any(partner.startswith(AT_TIP) for partner in partners):
            places.add(name.rsplit(".", 1)[0])
    return sorted(places)


def use(outcome: Outcome, handover: ControllerExports, beside: Collection[str] = frozenset()) -> Iterator[Content]:
    """Which file is for what; those beside the page are links."""
    following = next_command(outcome, handover, "results")
    if following:
        yield tag("p", "Next: ", tag("code", following))
    for camera in () if handover.hand_eye is None else handover.hand_eye.places:
        words = f" on {camera.parent}: {camera.in_words}. To paste: "
        yield tag("p", "Camera ", tag("code", camera.name), words, tag("code", f"{FOLDER}/"))
    lines: list[list[Content]] = []
    for export in handover.exports:
        distance = f"{number(1e3 * export.apart)} mm"
        named = [part for file in export.files for part in (", ", linked(file, beside))][1:]
        lines.append([export.name, named, _error(handover, export), distance])
    head = ["what your controller gets", "files", f"{handover.channel.name} RMS", "distance from the full model"]
    yield table(head, lines, f"Exports for controllers, on {handover.rows}", numbers=2)
    yield fold("What each file is for", _files(handover, bool(outcome.effects), beside))


def linked(file: str, beside: Collection[str]) -> Markup:
    """The name of a file of the result, as a link where the file stands beside the page."""
    return tag("a", file, href=file) if file in beside else tag("code", file)


def _error(handover: ControllerExports, export: Export) -> str:
    """What an export leaves, with its unit."""
    channel = handover.channel
    return f"{number(channel.scale * export.error)} {channel.shown}"


def _files(handover: ControllerExports, effects: bool, beside: Collection[str]) -> Markup:
    """The files of the result folder."""
    error = {file: _error(handover, export) for export in handover.exports for file in export.files}
    predict = tag("code", "aridcal predict calibration.yaml query.csv -o predicted.csv")
    lines: list[list[Content]] = [
        [
            "calibrated.urdf",
            "replaces the nominal URDF wherever that is read; only joint origins differ",
            error["calibrated.urdf"],
        ],
        ["calibration.yaml", ["the whole model with frames and effects: ", predict], error["calibration.yaml"]],
        ["result.json", "the figures of this page, for programs", ""],
        ["residuals.csv", "residual of each model for every row, with the row's part and flags", ""],
        ["scene.html", "robot, targets and magnified errors in 3D", ""],
    ]
    if handover.regions is not None:
        lines.insert(1, [INDEX, "where the URDF of each region beside it holds, and what it leaves", error[INDEX]])
    if effects:
        lines.insert(1, ["model.urdf", "valid only together with the effects in calibration.yaml, never alone", ""])
    named = [[linked(str(name), beside), *rest] for name, *rest in lines]
    return table(["file", "purpose", f"{handover.channel.name} RMS"], named, "Files in the result folder", numbers=2)
