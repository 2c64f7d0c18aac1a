"""Campaigns whose rows measure something else than the target's pose, simulated in memory: one block of each kind, and mixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
import yaml
from scipy.spatial.transform import Rotation

from aridcal.engine.fit.constants import constants
from aridcal.engine.instruments.kind import Role
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS, labelled
from aridcal.engine.instruments.pose import TRACKER
from aridcal.engine.instruments.setup import Block, Instruments, Things, Tie
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.rows.row_facts import ROLES, Labels
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.jobs.calibrate import job_inputs, pipeline
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.head1992.observations import CampaignRows

NOISE = {"position": 1e-4, "distance": 5e-5, "pixel": 0.2, "inclination": 2e-4, "rotation": 2e-4}
SIZE = 5e-4
SPACING = 0.05
SWAY = np.array([0.3, 0.3, 0.4, 0.6, 0.6, 1.0])
LENS = np.array([900.0, 900.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0])
TIP_TARGET = pin.SE3(np.eye(3), np.array([0.02, -0.01, 0.15]))
REFLECTORS = {
    name: TIP_TARGET * pin.SE3(np.eye(3), np.array([0.0, y, 0.0])) for name, y in (("near", 0.0), ("far", 0.12))
}
TIP_CAMERA = pin.SE3(Rotation.from_euler("xyz", [0.1, -0.2, 0.4]).as_matrix(), np.array([0.05, 0.02, 0.06]))


@dataclass(frozen=True)
class Measured:
    """Rows of one block.

    Attributes:
        kind: Of measurement.
        q: Readings, shape (n, columns).
        observed: What was read, shape (n, W).
        refers: Labels of the things that a row refers to, shape (n, roles).
        states: The true things by role and label.
        ties: Their known relations.
        target: Labels of targets where there are several.
    """

    kind: str
    q: np.ndarray
    observed: np.ndarray
    refers: np.ndarray
    states: dict[str, dict[str, np.ndarray]]
    ties: tuple[Tie, ...] = ()
    target: np.ndarray | None = None


@dataclass(frozen=True)
class Arm:
    """A robot as it really is."""

    robot: Robot
    model: Model
    theta: np.ndarray
    rng: np.random.Generator

    def poses(self, q: np.ndarray, target: pin.SE3 = TIP_TARGET) -> tuple[np.ndarray, np.ndarray]:
        """True poses of something on the tip: rotations (n, 3, 3) and positions (n, 3)."""
        R, p = self.model.poses(self.theta, self.model.rows(q))
        return R @ target.rotation, p + R @ target.translation


def arm(seed: int = 1, size: float = SIZE) -> Arm:
    """A UR10 whose constants are off."""
    rng = np.random.default_rng(seed)
    robot = robots.ur10()
    coefficients = constants(robot, "full")
    return Arm(robot, Model(robot, coefficients), rng.normal(0.0, size, len(coefficients)), rng)


def brought(of: Arm, q: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Readings near q, shape (n, columns), that bring the target to places (n, 3); rows that do not get there are left out."""
    step, q, away = 1e-6, q.copy(), np.arange(len(q))
    for _ in range(30):
        asked = np.vstack([q[away], *(q[away] + step * e for e in np.eye(q.shape[1]))])
        p, *moved = of.poses(asked)[1].reshape(-1, len(away), 3)
        J = np.stack([(other - p) / step for other in moved], axis=2)
        q[away] += np.clip(np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=1e-3), places[away] - p), -0.3, 0.3)
        away = away[np.linalg.norm(places[away] - p, axis=1) > 1e-9]  # the last step was exact to rounding
        if not len(away):
            break
    there = np.linalg.norm(of.poses(q)[1] - places, axis=1) < 1e-9
    return q[there & (np.abs(q) < 2 * np.pi).all(axis=1)]


def points(of: Arm, pairs: int = 3, rows: int = 20, tied: bool = True) -> Measured:
    """A ball in pairs of sockets that stand a known distance apart."""
    q, labels, places = [], [], {}
    for pair in range(pairs):
        first = of.poses(robots.readings(of.robot, 1, of.rng, 0.3))[1][0]
        for name, place in (("l", first), ("r", first + [SPACING, 0.0, 0.0])):
            # the ball sits in its socket a little off, each time anew
            sat = place + NOISE["position"] * of.rng.normal(size=(3 * rows, 3))
            own = brought(of, robots.readings(of.robot, 3 * rows, of.rng, 0.6), sat)[:rows]
            q.append(own)
            labels += [f"a{pair}/{name}"] * len(own)
            places[f"a{pair}/{name}"] = place
    ties = tuple(Tie("point", f"a{k}/l", f"a{k}/r", "distance", SPACING, 1e-5) for k in range(pairs)) if tied else ()
    every = np.vstack(q)
    return Measured("point", every, np.zeros((len(every), 0)), _labels(labels), {"point": places}, ties)


def distances(of: Arm, anchors: int = 3, rows: int = 60) -> Measured:
    """Draw-wires from several anchors."""
    states = {
        f"w{k}": np.array([*of.rng.uniform(-2.0, 2.0, 2), of.rng.uniform(0.0, 1.0), 0.013, 1.0]) for k in range(anchors)
    }
    q = robots.readings(of.robot, anchors * rows, of.rng, 0.5)
    labels = np.repeat(list(states), rows)
    return _read(of, "distance", q, 1, _labels(labels), {"anchor": states})


def heights(of: Arm, rows: int = 60) -> Measured:
    """A gauge over three planes."""
    states = {
        name: np.array([*axis, 0.1 * k])
        for k, (name, axis) in enumerate(zip(("floor", "wall", "side"), np.eye(3)[::-1], strict=True))
    }
    q = robots.readings(of.robot, 3 * rows, of.rng, 0.5)
    return _read(of, "plane", q, 1, _labels(np.repeat(list(states), rows)), {"plane": states})


def pixels(of: Arm, shots: int = 40) -> Measured:
    """A camera on the tip that looks at a known board of twenty markers."""
    q0 = robots.readings(of.robot, 1, of.rng, 0.3)[0]
    R, p = of.poses(q0[None], TIP_CAMERA)
    spots = np.array([[x, y, 0.0] for x in np.arange(5) for y in np.arange(4)]) * 0.05 - [0.1, 0.075, 0.0]
    board = np.concatenate([p[0] + R[0] @ [0.0, 0.0, 0.5], R[0].ravel()])
    camera = np.concatenate([TIP_CAMERA.translation, TIP_CAMERA.rotation.ravel(), LENS, [1.0]])
    markers = {f"m{k}": spot for k, spot in enumerate(spots)}
    q = np.repeat(q0 + of.rng.uniform(-0.35, 0.35, (shots, len(q0))) * SWAY, len(spots), axis=0)
    names = np.tile(list(markers), shots)
    refers = np.column_stack([np.full(len(q), "eye"), np.full(len(q), "board"), names])
    states = {"camera": {"eye": camera}, "board": {"board": board}, "marker": markers}
    made = _read(of, "pixels", q, 2, refers, states, pin.SE3.Identity())
    seen = ((made.observed > 0.0) & (made.observed < [640.0, 480.0])).all(axis=1)
    return replace(made, q=made.q[seen], observed=made.observed[seen], refers=made.refers[seen])


def positions(of: Arm, rows: int = 60) -> Measured:
    """A tracker that sees two reflectors on one tool, ``near`` and ``far``."""
    q = robots.readings(of.robot, 2 * rows, of.rng, 0.6)
    labels = np.repeat(["near", "far"], rows)
    p = np.vstack(
        [of.poses(own, REFLECTORS[name])[1] for name, own in zip(("near", "far"), np.split(q, 2), strict=True)]
    )
    noisy = p + NOISE["position"] * of.rng.normal(size=p.shape)
    return Measured("position", q, noisy, _labels([""] * len(q)), {}, target=labels)


def levels(of: Arm, rows: int = 120) -> Measured:
    """An inclinometer on the target."""
    q = robots.readings(of.robot, rows, of.rng, 0.6)
    R, _ = of.poses(q)
    down = np.swapaxes(R, 1, 2) @ [0.0, 0.0, -1.0] + NOISE["inclination"] * of.rng.normal(size=(rows, 3))
    return Measured("inclination", q, down, _labels([""] * rows), {})


def _read(
    of: Arm, kind: str, q: np.ndarray, numbers: int, refers: np.ndarray, states: dict[str, dict[str, np.ndarray]],
    target: pin.SE3 = TIP_TARGET,
) -> Measured:  # fmt: skip
    """What an instrument with noise reads of the true poses: less its residual at a reading of nothing."""
    R, p = of.poses(q, target)
    own = [
        np.array([states[role.name][label] for label in refers[:, k]])
        for k, role in enumerate(MEASUREMENT_KINDS[kind].roles)
    ]
    nothing = np.zeros((len(q), numbers))
    exact = -MEASUREMENT_KINDS[kind].residual(R, p, nothing, own)
    noise = NOISE[MEASUREMENT_KINDS[kind].channels[0].name]
    return Measured(kind, q, exact + noise * of.rng.normal(size=exact.shape), refers, states)


def _labels(first: Sequence[str] | np.ndarray) -> np.ndarray:
    return np.asarray(first, dtype=str)[:, None]


def _things(role: Role, states: dict[str, np.ndarray]) -> Things:
    """Everything of one role as a campaign has it: nothing known of what is identified, as a rule."""
    start = np.array(list(states.values()))
    free = np.tile([c in role.identified for c in role.components], (len(states), 1))
    if role.name == "marker":
        free[:] = False
    elif role.name in ("camera", "board"):
        start[:, :12] = np.nan
    elif role.name == "anchor":
        start[:, :4] = np.nan
    else:
        start[:] = np.nan
    return Things(role, tuple(states), start, free, np.full(free.shape, np.inf))


def _trackers(names: tuple[str, ...]) -> Things:
    """Trackers without faults, one for each block of positions."""
    none = np.zeros((len(names), TRACKER.size))
    return Things(TRACKER, names, none, none.astype(bool), np.full(none.shape, np.inf))


def rows(of: Arm, *blocks: Measured, declared: bool = False) -> Dataset:
    """One data set of all blocks; a fifth of the rows is held out."""
    q = np.vstack([b.q for b in blocks])
    n, wide = len(q), max([1, *(b.observed.shape[1] for b in blocks)])
    observed, refers = np.full((n, wide), np.nan), np.full((n, ROLES), "", dtype="<U16")
    block = np.repeat(np.arange(len(blocks)), [len(b.q) for b in blocks])
    made, channels, sigma = [], [], []
    things: dict[str, Things] = {}
    names = [b.kind for b in blocks]
    several = [c.name for b in blocks for c in MEASUREMENT_KINDS[b.kind].channels]
    for k, b in enumerate(blocks):
        own = block == k
        observed[own, : b.observed.shape[1]] = b.observed
        refers[own, : b.refers.shape[1]] = b.refers
        name = b.kind if names.count(b.kind) == 1 else f"{b.kind}_{k}"
        mine = tuple(
            c if several.count(c.name) == 1 else replace(c, name=f"{name}_{c.name}")
            for c in MEASUREMENT_KINDS[b.kind].channels
        )
        stated = tuple(NOISE[c.name] if declared else None for c in MEASUREMENT_KINDS[b.kind].channels)
        made.append(Block(name, b.kind, mine, stated))
        channels += mine
        sigma += stated
        things |= {role.name: _things(role, b.states[role.name]) for role in labelled(b.kind)}
        if MEASUREMENT_KINDS[b.kind].roles == (TRACKER,):
            refers[own, 0] = name
            others = things[TRACKER.name].names if TRACKER.name in things else ()
            things[TRACKER.name] = _trackers((*others, name))
    test = np.random.default_rng(0).random(n) < 0.2
    target = None
    if len(blocks) > 1 or blocks[0].target is not None:
        usual = [np.full(len(b.q), "tip" if b.kind == "pixels" else "target") for b in blocks]
        target = np.concatenate([own if b.target is None else b.target for own, b in zip(usual, blocks, strict=True)])
    position = np.full((n, 3), np.nan)
    for k, b in enumerate(blocks):
        if b.kind == "position":
            position[block == k] = b.observed
    data = dataset(of.robot.readings, of.robot.kinds, q, position)
    return replace(
        data,
        test=test,
        blocks=tuple(made),
        observed=observed,
        labels=Labels(block, refers, target=target),
        repeats=replace(data.repeats, configuration=np.arange(n)),
        origin=replace(data.origin, files=(Path("rows.csv"),), split_given=True),
        instruments=Instruments(things, tuple(t for b in blocks for t in b.ties)),
    )


def campaign(folder: Path, of: Arm, data: Dataset, **changes: object) -> Campaign:
    """The job that these rows belong to."""
    (folder / "robot.urdf").write_bytes(of.robot.urdf)
    keys: dict[str, object] = {
        "format": 1,
        "robot": {"urdf": "robot.urdf", "base": of.robot.base, "tip": of.robot.tip},
        "measurements": [
            {"file": f"{block.name}.csv", "kind": block.kind, "name": block.name} for block in data.blocks
        ],
        "diagnosis": {"enabled": False},
    }
    if "camera" in data.instruments.things:
        lens = dict(zip(("fx", "fy", "cx", "cy"), LENS.tolist(), strict=False))
        keys["instruments"] = {"cameras": {"eye": lens | {"width": 640, "height": 480}}}
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(keys | changes, sort_keys=False))
    return load_campaign(path)


def outcome(folder: Path, of: Arm, data: Dataset, **changes: object) -> Outcome:
    """The rows through the whole pipeline, as if they had been read from a file."""
    job = campaign(folder, of, data, **changes)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(job_inputs, "read_rows", lambda job, *_: CampaignRows(job, data))
        return pipeline.identify(job)
