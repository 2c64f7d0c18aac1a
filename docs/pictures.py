"""Draw each kind of effect as it looks while the model lacks it, and what is left once it is in: docs/images/effects.

A simulated arm has that one effect. Each point is what one measured row asks for at the place of the effect: the
residual divided by what a unit of motion there does to the target. Rows on which it hardly acts are left out.

Example:
    python docs/pictures.py                # or only some: python docs/pictures.py joint_gain drift
"""

from __future__ import annotations

import io
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from aridcal.engine.robot.kinematics import gravity_loads, joint_frames, transverse, tree_frames
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate, write_campaign

DOCS = Path(__file__).resolve().parent
OUT = DOCS / "images" / "effects"
NOISE = {"position": 1e-4, "rotation": 1e-4}
FRAMES = {
    "arid.urdf": {"world_base": {"xyz": [5, 2, -2], "rpy": [1.5, 0, 0.8]}, "tip_target": {"xyz": [0.3, -0.1, 0.1]}},
    "ur10.urdf": {"world_base": {"xyz": [2, 1, 0], "rpy": [0, 0, 0.8]}, "tip_target": {"xyz": [0.1, -0.1, 0.2]}},
}
BEFORE, AFTER = "#b3452c", "#2c6eb3"


def reading(name: str) -> Callable[[Outcome], np.ndarray]:
    """A joint's reading."""
    return lambda o: o.measurements.readings[:, o.robot.readings.index(name)]


def covariate(name: str) -> Callable[[Outcome], np.ndarray]:
    """A column of the table."""
    return lambda o: o.measurements.covariates[name]


def place(coordinate: int) -> Callable[[Outcome], np.ndarray]:
    """A coordinate of the target's place in the base frame."""

    def of(o: Outcome) -> np.ndarray:
        frame = o.stage("final").fit.model.world_base[0][1]
        return np.asarray((o.measurements.position - frame.translation) @ frame.rotation[:, coordinate])

    return of


def row(o: Outcome) -> np.ndarray:
    """The line of the file."""
    return o.measurements.origin.line


def torque(joint: str, motion: str = "axis") -> Callable[[Outcome], np.ndarray]:
    """Gravity's moment about a joint's own axis, or across it."""

    def of(o: Outcome) -> np.ndarray:
        gravity = np.array(o.campaign.robot.gravity, dtype=float)
        loads = gravity_loads(o.robot, tuple(tree_frames(o.robot, o.measurements.readings)), gravity)
        return np.asarray(loads[:, o.robot.names.index(joint), 3:] @ direction(o, joint, motion))

    return of


@dataclass(frozen=True)
class Picture:
    """One kind of effect.

    Attributes:
        truth: The effect as a scenario has it.
        x: What to draw against.
        label: Its name.
        motion: Component whose error is drawn.
        robot: URDF of the simulated arm.
        declared: What the campaign says of it, where that is not what the scenario says.
    """

    truth: dict[str, Any]
    x: Callable[[Outcome], np.ndarray]
    label: str
    motion: str = "axis"
    robot: str = "ur10.urdf"
    declared: dict[str, Any] = field(default_factory=dict)


PAN, LIFT, ELBOW = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"
RAIL = "joint_1"
PICTURES = {
    "joint_gain": Picture(
        {"where": ELBOW, "coefficients": 3e-4}, reading(ELBOW), "elbow, rad"
    ),
    "joint_harmonic": Picture(
        {"where": ELBOW, "order": [2], "coefficients": [4e-4, 2e-4]}, reading(ELBOW), "elbow, rad"
    ),
    "joint_map": Picture(
        {"where": ELBOW, "coefficients": {"std": 4e-4}}, reading(ELBOW), "elbow, rad"
    ),
    "joint_backlash": Picture(
        {"where": PAN, "by": "direction", "coefficients": 3e-4}, reading(PAN), "shoulder pan, rad",
    ),
    "joint_compliance": Picture(
        {"where": LIFT, "coefficients": 1e-5}, torque(LIFT), "gravity torque on the shoulder lift, N·m"
    ),
    "joint_coupling": Picture(
        {"where": ELBOW, "with": "wrist_1_joint", "coefficients": 3e-4}, reading("wrist_1_joint"), "wrist 1, rad"
    ),
    "bearing_compliance": Picture(
        {"where": PAN, "motion": ["r1", "r2"], "coefficients": [1e-5, 1e-5]}, torque(PAN, "r1"),
        "gravity moment across the pan axis, N·m", motion="r1",
    ),
    "axis_wobble": Picture(
        {"where": PAN, "order": [2], "motion": ["r1", "r2"], "coefficients": [4e-4, 0, 0, 4e-4]},
        reading(PAN), "shoulder pan, rad", motion="r1",
    ),
    "rail_straightness": Picture(
        {"where": RAIL, "motion": "t1", "form": "bow", "coefficients": 1.5e-3}, reading(RAIL), "travel, m",
        motion="t1", robot="arid.urdf",
    ),
    "rail_angular": Picture(
        {"where": RAIL, "motion": "yaw", "coefficients": {"std": 4e-4}}, reading(RAIL), "travel, m",
        motion="axis turn", robot="arid.urdf",
    ),
    "thermal": Picture(
        {"where": RAIL, "motion": "axis", "covariates": ["temperature"], "coefficients": 2e-4},
        covariate("temperature"), "temperature, °C", robot="arid.urdf",
    ),
    "drift": Picture(
        {"where": "world_base", "motion": "y", "coefficients": 2e-7}, covariate("time"), "time, s", motion="y",
    ),
    "shift": Picture(
        {"where": "world_base", "at": {"row": 162}, "coefficients": [0, 5e-4, 0, 0, 0, 0]}, row, "row of the table", motion="y",
    ),
    "payload_compliance": Picture(
        {"where": LIFT, "motion": "axis", "covariates": "payload", "coefficients": 2e-4}, covariate("payload"), "payload, kg",
    ),
    "regional": Picture(
        {"where": "joint_3", "motion": "roll", "by": RAIL, "form": "ripple", "coefficients": 4e-4}, reading(RAIL),
        "travel of the rail, m", motion="r1", robot="arid.urdf",
    ),
    "residual_field": Picture(
        {"where": "world_base", "motion": "y", "coefficients": {"std": 1e-3}}, place(2), "place along the rail, m",
        motion="y", robot="arid.urdf",
    ),
    "unknown": Picture(
        {"where": ELBOW, "motion": "pitch", "covariates": ["time"], "form": "step", "coefficients": 4e-4},
        covariate("time"), "time, s", declared={},
    ),
}  # fmt: skip


def campaign(kind: str, picture: Picture, home: Path) -> tuple[Outcome, Outcome]:
    """Simulate, then identify without the effect and with it declared."""
    effect = {"kind": kind, **picture.truth}
    scenario = {
        "format": 1,
        "robot": {
            "urdf": str(DOCS.parent / "urdf" / picture.robot),
            "tip": "flange" if picture.robot == "arid.urdf" else "tool0",
            "gravity": [0.0, 9.81, 0.0] if picture.robot == "arid.urdf" else [0.0, 0.0, -9.81],
        },
        "measurements": {"noise": NOISE},
        "diagnosis": {"enabled": False},
        "truth": {"n": 400, "seed": 8, "noise": NOISE, "frames": FRAMES[picture.robot], "effects": [effect]},
    }
    (home / "scenario.yaml").write_text(json.dumps(scenario))
    write_campaign(simulate(load_settings(home / "scenario.yaml", Scenario)), home, home)
    text = (home / "campaign.yaml").read_text()
    declared = {k: v for k, v in effect.items() if k not in ("coefficients", "form")} | picture.declared
    (home / "with.yaml").write_text(text + "\neffects: [" + json.dumps(declared) + "]\n")
    return identify(home / "campaign.yaml"), identify(home / "with.yaml")


def direction(o: Outcome, joint: str, motion: str) -> np.ndarray:
    """Unit vector of a motion in the joint's frame."""
    axis = o.robot.joint(joint).axis
    across = dict(zip(("1", "2"), transverse(axis), strict=True))
    return across.get(motion[-1], axis)


def asked(o: Outcome, where: str, motion: str) -> tuple[np.ndarray, np.ndarray]:
    """What each row asks for, [mm] or [mrad], and how much the target would feel of it, both of shape (N,)."""
    stage = o.stage("final")
    frame = stage.fit.model.world_base[0][1]
    r = stage.residual[:, :3] @ frame.rotation  # in the base's axes
    if where == "world_base":
        return 1e3 * r[:, "xyz".index(motion)], np.ones(len(r))
    joint = o.robot.joint(where)
    axes, origins = joint_frames(o.robot, o.measurements.readings)
    k = o.robot.names.index(where)
    along = axes[:, k] @ direction(o, where, motion.split()[0])
    slides = motion.startswith("t") or (motion == "axis" and joint.kind == "prismatic")
    target = (o.measurements.position - frame.translation) @ frame.rotation
    lever = along if slides else np.cross(along, target - origins[:, k])
    size = np.sum(lever**2, axis=1)
    return 1e3 * np.sum(lever * r, axis=1) / size, np.sqrt(size)


def draw(kind: str, picture: Picture) -> None:
    """One picture: without the effect in the model, and with it."""
    with tempfile.TemporaryDirectory() as folder:
        without, with_it = campaign(kind, picture, Path(folder))
    where, motion = picture.truth["where"], picture.motion
    fig, ax = plt.subplots(figsize=(4.6, 2.3), layout="constrained")
    for outcome, colour, label in ((without, BEFORE, "missing"), (with_it, AFTER, "in the model")):
        error, felt = asked(outcome, where, motion)
        seen = (felt >= np.median(felt)) & ~outcome.outlier
        ax.plot(picture.x(outcome)[seen], error[seen], ".", ms=3, color=colour, label=label)
    length = where == "world_base" or motion.startswith("t") or without.robot.joint(where).kind == "prismatic"
    ax.set_xlabel(picture.label)
    ax.set_ylabel(f"asked for, {'mm' if length and 'turn' not in motion else 'mrad'}")
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False, loc="upper left", bbox_to_anchor=(0, 1.16), ncols=2, handletextpad=0.1, markerscale=3)
    save(fig, kind)
    rms = [
        1e3 * float(np.sqrt(np.mean(np.sum(o.stage("final").residual[:, :3] ** 2, axis=1)))) for o in (without, with_it)
    ]
    print(f"{kind}: {rms[0]:.3f} mm RMS without, {rms[1]:.3f} mm with it")


def draw_head() -> None:
    """What the measuring head's own errors do to an image point and to a range: the models themselves."""
    f, r, h = 700.0, np.linspace(0, 350, 100), np.linspace(0.2, 1.0, 100)
    lens = {"lens_distortion: k1 = -0.03": -0.03 * r**3 / f**2, "focal_length: 0.3 % long": 0.003 * r}
    sonar = {"sonar_bias: 3 mm": np.full(100, 3.0), "sonar_scale: 0.5 %": 5.0 * h}
    fig, axes = plt.subplots(1, 2, figsize=(7.2, 2.4), layout="constrained")
    for ax, x, curves in ((axes[0], r, lens), (axes[1], h, sonar)):
        for (label, y), colour in zip(curves.items(), (BEFORE, AFTER), strict=True):
            ax.plot(x, y, color=colour, label=label)
        ax.legend(frameon=False, loc="lower left" if x is r else "upper left")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].axhline(1.0, color="0.4", ls=":")
    axes[0].annotate(
        "principal_point: the same everywhere", (0, 1.0), xytext=(3, 3), textcoords="offset points", fontsize=9
    )
    axes[0].set(xlabel="distance from the image's centre, pixels", ylabel="image point off by, pixels")
    axes[1].set(xlabel="range, m", ylabel="range off by, mm", ylim=(0, 6))
    save(fig, "head")


def save(fig: Figure, name: str) -> None:
    """Write a small PNG."""
    page = io.BytesIO()
    fig.savefig(page, dpi=110)
    plt.close(fig)
    OUT.mkdir(parents=True, exist_ok=True)
    Image.open(page).convert("RGB").quantize(48).save(OUT / f"{name}.png", optimize=True)


if __name__ == "__main__":
    for kind in sys.argv[1:] or PICTURES:
        draw(kind, PICTURES[kind])
    if not sys.argv[1:]:
        draw_head()
