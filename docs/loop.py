"""Draw the loop twice: docs/images/loop.svg on the shipped campaign, docs/images/search.svg as its steps.

The first from the campaign's own numbers: measured, fitted, traced, added, how far the arm is off at each step on held-out rows,
and what the rest follows. The second is what docs/how-the-search-works.md explains.

Example:
    python docs/loop.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aridcal.engine.corrections.loads import covariate_table
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.pages.drawing.figures import AFTER, BEFORE, COLOURS, label_below
from aridcal.pages.drawing.plot import GREY, INK, Area, Scale, dots, frame, level, path, stairs, text, whole

DOCS = Path(__file__).resolve().parent
CAMPAIGN = DOCS.parent / "identification" / "arid-undeclared" / "campaign.yaml"
OUT = DOCS / "images" / "loop.svg"
STEPS_OUT = DOCS / "images" / "search.svg"

JOINT = "joint_3"
EACH, HIGH, TOP, FOOT = 195.0, 176.0, 38.0, 36.0
"""Of one of the four steps, two by two, in units of which letters have ten."""
WIDE, TALL = 2 * EACH, 2 * HIGH
SHOWN = 620
"""[px] in which it is shown where there is room: letters have 16 there, and 9 on a phone of 390."""
REACH = 3.0
"""[mm]: of the horizontal axes."""

BOX_WIDTH, BOX_HEIGHT, GAP = 272.0, 40.0, 16.0
"""Of a step of the search, and between two of them, in the same units."""
STEPS = (
    ("constants and frames fitted", "geometric stage", INK),
    ("candidates", "every effect that the rows can show", INK),
    ("evidence", "explained, less what freedom costs [nat]", INK),
    ("gates", "chance, held-out rows, rows agree, stretches agree", INK),
    ("exact model", "fitted with all effects, linearised anew", INK),
    ("noise", "what it is made of; its causes become weights", INK),
    ("verdict", "is the rest noise? asked of held-out rows, too", AFTER),
)
"""Name, what it does, color."""
BACK = ((3, 1, "added; all tried again"), (4, 1, "until nothing changes"), (5, 0, "weights changed: once more"))
"""Ways back: from step, to step, why."""


def area(k: int, x: Scale, y: Scale) -> Area:
    """The k-th of four areas."""
    left, top = corner(k)
    return Area(left + 43.0, top + TOP, EACH - 53.0, HIGH - TOP - FOOT, x, y)


def corner(k: int) -> tuple[float, float]:
    """Left and upper edge of the k-th step."""
    return EACH * (k % 2), HIGH * (k // 2)


def head(k: int, title: str, said: str, color: str) -> str:
    """What a step is, and what it comes to."""
    left, top = corner(k)
    return text(left + 8.0, top + 14.0, f"{k + 1}  {title}", color=INK) + text(
        left + 8.0, top + 29.0, said, color=color
    )


def upright(own: Area, label: str) -> str:
    """The label of a vertical axis."""
    return text(own.left - 32.0, own.top + own.height / 2, label, "middle", INK, turned=True)


def errors(k: int, lengths: np.ndarray, color: str) -> str:
    """How far held-out rows are off, [mm]."""
    edges = np.linspace(0.0, REACH, 31)
    share = 100.0 * np.histogram(np.minimum(lengths, REACH), edges)[0] / len(lengths)
    own = area(k, Scale(0.0, REACH), Scale(0.0, 1.08 * float(share.max())))
    return (
        frame(own, (4, 4))
        + stairs(own, edges, share, 0.0, color, 0.35, 1.4)
        + label_below(own, "off by [mm]")
        + upright(own, "rows [%]")
    )


def pull(outcome: Outcome, stage: str) -> np.ndarray:
    """What each row asks for at the joint, [mrad]: the residual over what a turn of the joint does to the target, shape (N,)."""
    fit, rows = outcome.stage(stage).fit, outcome.measurements
    model, theta = fit.model, fit.theta
    readings = rows.readings
    k = outcome.robot.readings.index(JOINT)
    step = np.zeros(readings.shape[1])
    step[k] = 1e-5
    (_, before), (_, after) = (model.poses(theta, model.rows(q, rows.covariates)) for q in (readings, readings + step))
    lever = (after - before) / 1e-5
    return np.asarray(
        1e3 * np.einsum("ni,ni->n", outcome.stage(stage).residual[:, :3], lever) / np.einsum("ni,ni->n", lever, lever)
    )


def step_box(k: int) -> str:
    """A step of the search, its name and what it does."""
    name, does, color = STEPS[k]
    top = 8.0 + k * (BOX_HEIGHT + GAP)
    box = path(f"M8 {top:.0f}h{BOX_WIDTH:.0f}v{BOX_HEIGHT:.0f}h{-BOX_WIDTH:.0f}z", stroke=color, stroke_width=1.4)
    on = "" if k == len(STEPS) - 1 else arrow(144.0, top + BOX_HEIGHT, 144.0, top + BOX_HEIGHT + GAP)
    return box + text(16.0, top + 16.0, name, color=color) + text(16.0, top + 31.0, does) + on


def way_back(k: int) -> str:
    """From a step to one before it, right of all boxes; its reason stands right of all ways."""
    last, first, why = BACK[k]
    color, edge, right = COLOURS[k + 1], 8.0 + BOX_WIDTH, BOX_WIDTH + 26.0 + 14.0 * k
    low, high = (8.0 + step * (BOX_HEIGHT + GAP) + BOX_HEIGHT / 2 for step in (last, first))
    high += 7.0 * k
    line = path(f"M{edge:.0f} {low:.0f}H{right:.0f}V{high:.0f}H{edge + 8:.0f}", stroke=color, stroke_width=1.4)
    reason = text(BOX_WIDTH + 26.0 + 14.0 * len(BACK), low + 4.0, why, color=color)
    return line + arrow(edge + 8.0, high, edge, high, color) + reason


def arrow(x: float, y: float, to_x: float, to_y: float, color: str = GREY) -> str:
    """A line with a head at its end."""
    along, across = np.array([to_x - x, to_y - y]), np.array([y - to_y, to_x - x])
    along, across = (v / np.linalg.norm(v) for v in (along, across))
    left, right = (np.array([to_x, to_y]) - 7.0 * along + side * 3.5 * across for side in (1.0, -1.0))
    head = f"M{left[0]:.1f} {left[1]:.1f}L{to_x:.1f} {to_y:.1f}L{right[0]:.1f} {right[1]:.1f}z"
    return path(f"M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}", stroke=color, stroke_width=1.2) + path(head, fill=color)


def draw_search() -> None:
    """The steps of the search, one under the other, and the ways back."""
    alt = "The search: constants, candidates, evidence, gates, exact model, noise, verdict, with three ways back"
    parts = [*(step_box(k) for k in range(len(STEPS))), *(way_back(k) for k in range(len(BACK)))]
    write(STEPS_OUT, alt, 490.0, 8.0 + len(STEPS) * (BOX_HEIGHT + GAP), parts)


def write(out: Path, alt: str, width: float, height: float, parts: list[str]) -> None:
    """A figure as a file of its own, on white."""
    svg = whole(alt, width, height, parts).replace(
        "<svg ", f'<svg width="{SHOWN}" xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" ', 1
    )
    white = f'><rect width="{width:.0f}" height="{height:.0f}" fill="#fff"/>'
    out.write_text(svg.replace(">", white, 1) + "\n", encoding="utf-8")


def main() -> None:
    """Identify, and draw."""
    draw_search()
    outcome = identify(CAMPAIGN)
    held = outcome.parts()["test"]
    lengths = {s.name: 1e3 * np.linalg.norm(s.residual[held, :3], axis=1) for s in outcome.stages}
    rms = {name: float(np.sqrt(np.mean(values**2))) for name, values in lengths.items()}
    rows, name = outcome.measurements, f"{JOINT}.gravity_torque"
    around = outcome.stage("final").fit.model.around
    torque = covariate_table(
        outcome.robot, rows.readings, rows.covariates, around, np.zeros(len(rows), dtype=int), {name}
    )[name]
    asked = pull(outcome, "geometric")
    ends = 1.1 * float(np.abs(asked).max())
    third = area(2, Scale(float(torque.min()), float(torque.max())), Scale(-ends, ends))
    parts = [
        head(0, "measure", f"{rms['nominal']:.2f} mm off as designed", BEFORE),
        errors(0, lengths["nominal"], BEFORE),
        head(1, "fit lengths and zeros", f"{rms['geometric']:.2f} mm remain", BEFORE),
        errors(1, lengths["geometric"], BEFORE),
        head(2, "trace what remains", "it follows the load of the elbow", INK),
        frame(third, (3, 4)) + level(third, 0.0) + dots(third, torque, asked, GREY),
        label_below(third, "gravity torque, joint 3 [N m]") + upright(third, "asked for [mrad]"),
        head(3, "add the cause", f"{rms['final']:.2f} mm: the noise", AFTER),
        errors(3, lengths["final"], AFTER),
    ]
    alt = "The loop in four steps: measure, fit, trace what remains to its cause, add it"
    write(OUT, alt, WIDE, TALL, parts)


if __name__ == "__main__":
    main()
