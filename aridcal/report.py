"""``report.html``: what a calibration found, on one page that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

from aridcal import __version__, sections
from aridcal.apart import MEANING
from aridcal.dependence import depends
from aridcal.doty import Link, doty_links
from aridcal.effects import FRAME_COMPONENTS, LINK_COMPONENTS
from aridcal.export import frames, parameters
from aridcal.handover import hand_over
from aridcal.head_section import measuring_head
from aridcal.markup import Content, Html, counted, fixed, join, number, plus_minus, table, tag
from aridcal.outcome import STATISTICS, Outcome, errors
from aridcal.residual import Sigma

SYMBOLS = {"d": "d", "theta": "θ", "beta": "β", "a": "a", "alpha": "α"}
MOST_FRAMES = 12
FEW = 20  # rows: fewer say little about a percentile
MOST_BARS = 7
MOST_REASONS = 3

Section = Callable[[Outcome], Iterable[Content]]

VERDICTS = {
    "noise_floor": "What remains is consistent with the measurement noise: there is nothing left to model.",
    "structure_remains": "Something repeatable remains that the model does not describe: section 5 shows on what it "
    "depends.",
    "not_enough_data": "These measurements cannot tell the model that the robot deserves from a simpler one: "
    "measure more rows, spread over more of the joint ranges.",
}


def write_report(outcome: Outcome, path: Path) -> None:
    """Write the report of a calibration.

    Args:
        outcome: What was found.
        path: The HTML file.
    """
    path.write_text(page(outcome), encoding="utf-8", newline="\n")


def page(outcome: Outcome) -> Html:
    """The report as one self-contained HTML page."""
    chapters: list[tuple[str, str, Section]] = [
        ("data", "1. Is the data sound?", sections.data),
        ("separable", "2. What can be told apart?", sections.separable),
        ("enough", "3. Is there enough data, in the right places?", sections.enough),
        ("fits", "4. Does the model fit?", sections.fits),
        ("depends", "5. If not, on what does the rest depend?", depends),
        ("remains", "6. What remains, and where not to trust it?", sections.remains),
        ("parameters", "What was identified", identified),
        ("use", "How to use the result", use),
    ]
    if outcome.head is not None:
        chapters.insert(7, ("head", "The measuring head", measuring_head))
    if outcome.verification is not None:
        chapters.insert(6, ("verification", "Another day's data", verification))
    links = [tag("a", title, href=f"#{key}") for key, title, _ in chapters]
    body = [
        tag("header", list(summary(outcome)), tag("nav", links, aria_label="Sections")),
        tag("main", [
            tag("section", tag("h2", title), list(section(outcome)), id=key) for key, title, section in chapters
        ]),
        tag("footer", f"aridcal {__version__}, {counted(len(outcome.measurements), 'row')} "
            f"with sha256 {outcome.measurements.sha256[:16]}"),
    ]  # fmt: skip
    style = files("aridcal").joinpath("report.css").read_text("utf-8")
    head = [
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", f"Calibration of {outcome.robot.tree.name}"),
        tag("style", Html(style)),
    ]
    return join([Html("<!DOCTYPE html>\n"), tag("html", tag("head", head), tag("body", body), lang="en")])


def summary(outcome: Outcome) -> Iterator[Content]:
    """The first screen: how good before, how good now, why, what remains, can I trust it."""
    m, robot = outcome.measurements, outcome.robot
    yield tag("h1", f"Calibration of {robot.tree.name}")
    yield tag(
        "p",
        f"{', '.join(path.name for path in m.files)} · {counted(len(m), 'row')}, {m.test.sum():,} of them never used · "
        f"{robot.path.name}, {robot.base} to {robot.tip}",
        class_="about",
    )
    keys = list(sections.ERRORS)[: outcome.stages[-1].residual.shape[1] // 3]
    yield tag("div", [_card(outcome, key) for key in keys], class_="cards")
    yield tag(
        "div",
        tag("div", tag("h2", "Why"), tag("p", list(_why(outcome)))),
        tag("div", tag("h2", "What remains"), tag("p", list(_left(outcome)))),
        tag("div", tag("h2", "Can I trust it?"), tag("ul", [_check(*c) for c in checks(outcome)], class_="checks")),
        class_="answers",
    )


def _card(outcome: Outcome, key: str) -> Html:
    """Before and now in large figures, then one bar for each model."""
    mask, rows = sections.scored(outcome)
    what, unit = sections.ERRORS[key].removesuffix("]").split(" [")
    found = {name: errors(residual, mask)[key] for name, residual in sections.steps(outcome)}
    before, *_, now = found.values() if len(found) > 1 else (*found.values(), *found.values())
    bars = [(name, e["rms"]) for name, e in found.items()]
    if len(bars) > MOST_BARS:
        cut = len(bars) - MOST_BARS + 1
        bars = [*bars[: -cut - 1], (f"{sections.PLUS}{cut} more effects", bars[-2][1]), bars[-1]]
    largest = max(value for _, value in bars) or 1.0
    return tag(
        "div",
        tag("h2", f"{what.capitalize()}, RMS"),
        tag(
            "p",
            tag("span", f"{number(before['rms'])} ", tag("small", unit), class_="before", title="before calibration"),
            tag("span", " → ", class_="arrow"),
            tag("span", f"{number(now['rms'])} ", tag("small", unit), class_="now", title="after calibration"),
            class_="change",
        ),
        tag(
            "p",
            f"before → now, on {mask.sum():,} {rows}. Now 95 % are below {number(now['p95'])} {unit}; the worst is "
            f"{number(now['max'])} {unit}.",
        ),
        tag("ol", [_bar(name.removesuffix(" = final"), value, largest, unit) for name, value in bars], class_="bars"),
        class_="card",
    )


def _bar(name: str, value: float, largest: float, unit: str) -> Html:
    return tag(
        "li",
        tag("span", name, class_="name"),
        tag("span", tag("i", style=f"width:{100 * value / largest:.1f}%"), class_="track"),
        tag("span", f"{number(value)} {unit}", class_="value"),
    )


def _why(outcome: Outcome) -> Iterator[Content]:
    mask, _ = sections.scored(outcome)
    square = [(name, errors(r, mask)["position_mm"]["rms"] ** 2) for name, r in sections.steps(outcome)]
    fit = outcome.stage("geometric").fit
    found = [p for p in parameters(fit) if p["status"] == "identified" and not _of_frame(p["name"])]
    meaning = {e.effect.label: MEANING[e.effect.kind] for e in outcome.effects}
    took = []
    for (_, before), (name, after) in pairwise(square):
        what = (
            f"{counted(len(found), 'constant')} of the geometry"
            if "geometric" in name
            else name.removeprefix(sections.PLUS).removesuffix(" = final")
        )
        if before != after:
            took.append((before - after, what))
    took.sort(reverse=True)
    if took:
        more = f", {len(took) - MOST_REASONS} more the rest" if len(took) > MOST_REASONS else ""
        parts: list[str] = []
        for gain, what in took[:MOST_REASONS]:
            why = f" ({meaning[what]})" if meaning.get(what) and meaning[what] not in " ".join(parts) else ""
            parts.append(f"{what}{why} took off {number(100 * gain / square[0][1], 2)} %")
        yield f"Of the squared position error {', '.join(parts)}{more}. "
    largest = [
        max((p for p in found if p["unit"] == unit), key=lambda p: abs(p["value"]), default=None)
        for unit in ("rad", "m")
    ]
    words: list[Content] = []
    for p in largest:
        if p is not None:
            unit = "mrad" if p["unit"] == "rad" else "mm"
            words += [", ", tag("code", p["name"]), f" {plus_minus(1e3 * p['value'], 1e3 * p['std'])} {unit}"]
    if words:
        yield ["The largest corrections: ", words[1:], "."]


def _first(names: list[str], most: int = 3) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _left(outcome: Outcome) -> Iterator[Content]:
    yield VERDICTS[outcome.verdict]
    if outcome.unexplained_fraction > 0:
        yield f" {100 * outcome.unexplained_fraction:.0f} % of the remaining variance is repeatable beyond the noise."
    noise, pose = outcome.noise, outcome.measurements.quaternion is not None
    yield f" Noise per axis: {_both(noise, pose)}, {outcome.noise_source}"
    if outcome.noise_source == "declared":
        yield f"; over three axes it makes about {_both(noise, pose, math.sqrt(3))}: no model can do better but by chance."
    elif outcome.repeats is not None:
        floor = _both(outcome.repeats.sigma, pose, math.sqrt(3))
        yield f" from what the model leaves. Repeats scatter by {floor} over three axes: no model can do better."
    else:
        yield f" from what the model leaves; over three axes it makes about {_both(noise, pose, math.sqrt(3))}."


def _both(sigma: Sigma, pose: bool, times: float = 1.0) -> str:
    """Position and, for poses, rotation in words."""
    turn = f" and {number(1e3 * times * sigma.rotation)} mrad" if pose else ""
    return f"{number(1e3 * times * sigma.position)} mm{turn}"


def checks(outcome: Outcome) -> Iterator[tuple[bool, str]]:
    """What speaks for the result (True) and what should be looked at first (False)."""
    m, parts = outcome.measurements, outcome.parts()
    rows, flagged, refused = len(m) + len(m.refused), int(outcome.outlier.sum()), len(m.refused)
    unused = int(parts["test"].sum())
    if unused:
        yield unused >= FEW, f"{counted(unused, 'row')} judged it that no fit has seen."
    else:
        yield False, "No row was kept apart, so the errors above are those of the fit itself: too good."
    yield flagged <= sections.QUESTIONABLE * len(m), f"{counted(flagged, 'outlier')} in {counted(len(m), 'row')}."
    if refused:
        share = sections.QUESTIONABLE * rows
        yield refused <= share, f"{counted(refused, 'row')} of {rows:,} could not be used."
    c = outcome.stage("geometric").fit.convergence
    if c.restarts:
        found = f"{c.agreed} of {c.restarts} other starts lead to the same minimum."
        yield c.converged and c.agreed == c.restarts, found
    else:
        yield c.converged, "The fit converged." if c.converged else "The fit did not converge."
    if unused >= FEW:
        last = outcome.stages[-1].residual
        fitted, judged = (errors(last, parts[part])["position_mm"]["rms"] for part in ("train", "test"))
        if fitted > 0:
            yield judged < 1.3 * fitted, f"Error on unused rows: {judged / fitted:.2f} times that on fitted ones."
    if math.isfinite(outcome.precision.halves_measured):
        agree = sections.halves_agree(outcome)
        yield agree, f"Two halves fitted apart {'agree' if agree else 'disagree by more than noise explains'}."
    narrow = sections.narrow(outcome)
    if narrow:
        yield False, f"Less than half of the range was measured of {_first([j.name for j in narrow])}."


def _check(good: bool, text: str) -> Html:
    mark = tag("b", "✓" if good else "!", title="speaks for it" if good else "look at this")
    return tag("li", mark, text, class_="good" if good else "look")


def verification(outcome: Outcome) -> Iterator[Content]:
    """How the models do on another day's data."""
    found = outcome.verification
    assert found is not None
    yield tag("p", f"{found.file}: {counted(len(found.measurements), 'row')} that had no part in the calibration.")
    stages = dict(found.residuals)
    if found.realigned is not None:
        stages["final, frames fitted anew"] = found.realigned
    for key, what in sections.ERRORS.items():
        scores = {name: errors(residual, ~found.outlier).get(key) for name, residual in stages.items()}
        lines = [[name, *(number(s[k]) for k in STATISTICS)] for name, s in scores.items() if s is not None]
        if lines:
            yield table(["model", "RMS", "mean", "median", "95 % below", "max"], lines, what)
    yield tag(
        "p",
        f"{counted(int(found.outlier.sum()), 'gross outlier')} left out. If the error is much larger than on the campaign's "
        "own unused rows, but small again with the frames fitted anew, the target or the instrument was mounted anew; if it "
        "stays large, the robot has changed since.",
    )


def identified(outcome: Outcome) -> Iterator[Content]:
    """Constants and frames with their uncertainty."""
    fit = outcome.stage("geometric").fit
    groups: dict[str, list[dict[str, Any]]] = {}
    for p in parameters(fit):
        where, component = p["name"].rsplit(".", 1)
        if not _of_frame(p["name"]):
            groups.setdefault(where, []).append(p | {"component": component})
    links = outcome.campaign.parameters.set in ("doty", "angles")
    if not groups:
        yield tag("p", "No constants were asked for.")
    elif links:
        yield tag(
            "p",
            "Parameters of the link after each joint, Tz(d) Rz(θ) Ry(β) Tx(a) Rx(α), with one standard deviation. "
            "Where two axes meet, θ and β are undefined, and yaw and pitch of the next origin take their place.",
        )
        nominal = {link.joint: link for link in doty_links(outcome.robot)}
        yield tag("div", [_link(nominal, where, g) for where, g in groups.items()], class_="links wide")
    else:
        yield tag(
            "p",
            "Corrections of each joint's own origin, in its own axes, to the nominal URDF, with one standard "
            "deviation. Those called nominal cannot be told from others (section 2).",
        )
        yield tag("div", [_origin(where, g) for where, g in groups.items()], class_="links")
    yield tag("h3", "Frames")
    yield tag(
        "p",
        tag("code", "world_base"), " is where the robot's base stands in the measured world, ",
        tag("code", "tip_target"), " where the measured target sits on the tip. Their ± is a twist in the frame's own "
        "axes. Neither is in the URDF.",
    )  # fmt: skip
    status = {p["name"]: p["status"] for p in parameters(fit)}
    found = frames(outcome.stage("final"))
    shown = list(found.items())[:MOST_FRAMES]
    yield tag("div", [_frame(name, frame, status) for name, frame in shown], class_="links")
    if len(found) > len(shown):
        yield tag("p", tag("em", f"and {len(found) - len(shown)} more; result.json has them all"))


def _of_frame(name: str) -> bool:
    return name.startswith(("world_base.", "world_base[", "tip_target.", "tip_target["))


def _correction(p: dict[str, Any]) -> str:
    if p["status"] != "identified":
        return "nominal" if p["status"] == "redundant" else "fixed"
    return f"{plus_minus(1e3 * p['value'], 1e3 * p['std'])} {'mrad' if p['unit'] == 'rad' else 'mm'}"


def _origin(where: str, group: list[dict[str, Any]]) -> Html:
    by_component = {p["component"]: p for p in group}
    ordered = [by_component[c] for c in FRAME_COMPONENTS]
    lines = [[p["component"], _correction(p)] for p in ordered if p["status"] == "identified"]
    nominal = [p["component"] for p in ordered if p["status"] != "identified"]
    if nominal:
        lines.append([", ".join(nominal), "nominal"])
    return table(["", "correction ± 1σ"], lines, tag("code", where))


def _link(nominal: dict[str, Link], where: str, group: list[dict[str, Any]]) -> Html:
    lines = []
    for p in group:
        component, angle = p["component"], p["unit"] == "rad"
        if component not in LINK_COMPONENTS:
            lines.append([f"{component} of its origin", "", _correction(p), ""])
            continue
        start = 0.0 if component == "d" else float(getattr(nominal[where], component))
        cells = [_value(v, angle) for v in (start, start + p["value"])]
        lines.append([SYMBOLS[component], cells[0], _correction(p), cells[1]])
    return table(["", "nominal", "correction ± 1σ", "calibrated"], lines, tag("code", where))


def _value(value: float, angle: bool) -> str:
    return f"{fixed(math.degrees(value), 4)}°" if angle else f"{fixed(1e3 * value, 3)} mm"


def _frame(name: str, frame: dict[str, Any], status: dict[str, str]) -> Html:
    lines = []
    for k, component in enumerate(FRAME_COMPONENTS):
        value, std = (*frame["xyz"], *frame["rpy"])[k], 1e3 * frame["std"][k]
        known = status[f"{name}.{component}"]
        spread = f"{number(std, 2)} {'mm' if k < 3 else 'mrad'}"
        lines.append([component, _value(value, k > 2), spread if known == "identified" else known])
    return table(["", "value", "± 1σ"], lines, tag("code", name))


def use(outcome: Outcome) -> Iterator[Content]:
    """Which file is for what."""
    rms = {
        name: number(errors(outcome.stage(name).residual, sections.scored(outcome)[0])["position_mm"]["rms"])
        for name in ("geometric", "final")
    }
    lines: list[list[Content]] = [
        ["calibrated.urdf", "in place of the nominal URDF, wherever that is read; only joint origins differ",
         f"{rms['geometric']} mm"],
        ["calibration.yaml", ["the whole model with frames and effects: ",
         tag("code", "python -m aridcal.predict calibration.yaml query.csv -o predicted.csv")], f"{rms['final']} mm"],
        ["result.json", "the figures of this page, for programs", ""],
        ["residuals.csv", "what each model leaves of each row, its part and its flags", ""],
        ["scene.html", "robot, targets and magnified errors in 3D", ""],
    ]  # fmt: skip
    if outcome.effects:
        lines.insert(1, ["model.urdf", "only together with the effects in calibration.yaml, never alone", ""])
    head = ["file", "what for", "position RMS"]
    yield table(head, [[tag("code", str(name)), *rest] for name, *rest in lines], "Files beside this one", numbers=2)
    handover = hand_over(outcome)
    given: list[list[Content]] = [
        [e.name, ", ".join(e.files), f"{number(1e3 * e.error)} mm", f"{number(1e3 * e.apart)} mm"]
        for e in handover.exports
    ]
    head = ["what a controller takes", "files", "position RMS", "from the full model"]
    yield table(head, given, f"What each kind of controller can be given, on {handover.rows}", numbers=2)
