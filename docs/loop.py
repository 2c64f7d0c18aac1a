"""Draw the loop on the shipped campaign, from its own numbers: docs/images/loop.svg.

Measured, fitted, traced, added: how far the arm is off at each step on held-out rows, and what the rest follows.

Example:
    python docs/loop.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aridcal.engine.corrections.loads import covariate_table
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.pages.drawing.figures import AFTER, BEFORE, below
from aridcal.pages.drawing.plot import GREY, INK, Area, Scale, dots, frame, level, stairs, text, whole

DOCS = Path(__file__).resolve().parent
CAMPAIGN = DOCS.parent / "identification" / "arid-undeclared" / "campaign.yaml"
OUT = DOCS / "images" / "loop.svg"

JOINT = "joint_3"
EACH, HIGH, TOP, FOOT = 195.0, 176.0, 38.0, 36.0
"""Of one of the four steps, two by two, in units of which letters have ten."""
WIDE, TALL = 2 * EACH, 2 * HIGH
SHOWN = 620
"""[px] in which it is shown where there is room: letters have 16 there, and 9 on a phone of 390."""
REACH = 3.0
"""[mm]: of the horizontal axes."""


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
        + below(own, "off by [mm]")
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


def main() -> None:
    """Identify, and draw."""
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
        below(third, "gravity torque, joint 3 [N m]") + upright(third, "asked for [mrad]"),
        head(3, "add the cause", f"{rms['final']:.2f} mm: the noise", AFTER),
        errors(3, lengths["final"], AFTER),
    ]
    alt = "The loop in four steps: measure, fit, trace what remains to its cause, add it"
    svg = whole(alt, WIDE, TALL, parts).replace(
        "<svg ", f'<svg width="{SHOWN}" xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" ', 1
    )
    OUT.write_text(
        svg.replace(">", f'><rect width="{WIDE:.0f}" height="{TALL:.0f}" fill="#fff"/>', 1) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
