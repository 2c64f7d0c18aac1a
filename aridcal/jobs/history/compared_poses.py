r"""Where two calibrations of one robot are compared: configurations that both saw, and the poses that both predict there.

A calibration whose rows could not tell two causes apart predicts by the mean over both, and does not know what they differ by.
Each has base and target where the other has them: a tracker that was set up anew is no difference of arms. What is left of
these motions is taken off by small steps, and the columns that do so are handed on:

.. math:: T_B' = e^{\xi_b} \, T_B \, e^{\xi_t}, \qquad \xi_b, \xi_t = \arg\min \sum_q |T_B'(q) - T_A(q)|^2
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from aridcal.engine.corrections.effect import ROW_ORDER
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.jobs.maintain.hypotheses import widened
from aridcal.system.errors import AridcalError, name_list

DRAWN_CONFIGURATIONS = 256
"""Drawn over the joints' common ranges, a power of two for Sobol's sequence: four times the numbers of the largest models."""

ALIGNMENT_STEPS = 8
"""Small steps that take off the motions of base and target; four are usual."""

ROUNDING_STEP = 1e-13
"""[m] and [rad]: a step below this is rounding."""

OVER_TIME = ("time", ROW_ORDER)
"""Covariates of which every campaign has its own origin: each calibration is compared at its last row."""


@dataclass(frozen=True)
class BothPoses:
    """Two calibrations in M configurations; n numbers, 6 of each configuration, 3 where a rotation is not known.

    Attributes:
        readings: Of the configurations, shape (M, columns), [rad] or [m].
        turns: Whether rotations are compared.
        solved: Both, in one place, with the zeros of all joints among their coefficients.
        J: How the numbers change with the coefficients of each, world axes, shape (n, K) each.
        d: Second minus first, [m] and [rad], shape (n,).
        bodies: How the numbers change with frames set up anew, shape (n, up to 6 + 6 targets).
        frames: These frames, ``world_base`` and ``tip_target``, and how far apart both have each, [m] and [rad].
        notices: What a reader should know.
    """

    readings: np.ndarray
    turns: bool
    solved: tuple[SolvedModel, SolvedModel]
    J: tuple[np.ndarray, np.ndarray]
    d: np.ndarray
    bodies: np.ndarray
    frames: Mapping[str, tuple[float, float]]
    notices: tuple[str, ...]


def common_poses(a: SavedModel, b: SavedModel, moved: Mapping[str, float]) -> BothPoses:
    """The poses of two calibrations of one arm.

    Args:
        a: The first.
        b: The second.
        moved: What is added to coefficients of the first, by name.

    Raises:
        AridcalError: they are not of the same joints, or saw none of the same configurations.
    """
    _check_same_arm(a, b)
    turns = a.turns and b.turns
    notices: list[str] = []
    readings, covariates = _draw_configurations(a, b, notices)
    targets = _targets(a, b)
    first, second, frames = _in_one_place(_with_added(widened(a.doubted), moved), widened(b.doubted), targets)
    which = np.repeat(np.arange(max(1, len(targets))), len(readings))  # every target in every configuration
    readings = np.tile(readings, (max(1, len(targets)), 1))
    covariates = {name: np.tile(values, max(1, len(targets))) for name, values in covariates.items()}
    label = np.array(targets)[which] if targets else None
    R, p, J_a = _poses_and_jacobian(first, readings, covariates, label, a)
    R_b, p_b, J_b = _poses_and_jacobian(second, readings, covariates, label, b)
    bodies = _bodies(R, p, which, frozenset(frames), turns)
    d = _difference_of_poses((R, p), (R_b, p_b), which, bodies, frozenset(frames), turns)
    J = _columns(J_a, turns), _columns(J_b, turns)
    flat = bodies.reshape(d.size, -1)
    return BothPoses(readings, turns, (first, second), J, d.ravel(), flat, frames, tuple(notices))


def _targets(a: SavedModel, b: SavedModel) -> tuple[str, ...]:
    """Labels of the targets that both have, of a robot of several limbs; none of another, whose first target stands for all.

    Raises:
        AridcalError: they have none in common.
    """
    if not a.final.model.robot.others:
        return ()
    first, other = ([label for label, _ in saved.final.model.tip_target if label is not None] for saved in (a, b))
    if first and other and not set(first) & set(other):
        raise AridcalError(
            f"the calibrations have no target in common: one has {name_list(first)}, the other {name_list(other)}. Call what "
            f"is on one "
            "link alike in both"
        )
    return tuple(label for label in first if label in other)


def _with_added(solved: SolvedModel, by: Mapping[str, float]) -> SolvedModel:
    """A solved model with something added to coefficients."""
    names = solved.model.names
    return replace(solved, theta=solved.theta + np.array([by.get(name, 0.0) for name in names]))


def _check_same_arm(a: SavedModel, b: SavedModel) -> None:
    """Make sure that both have the same joints."""
    first, second = a.final.model.robot, b.final.model.robot
    if first.readings != second.readings or tuple(first.kinds) != tuple(second.kinds):
        raise AridcalError(
            f"the calibrations are not of the same arm: one has the joints {name_list(first.readings)}, the other "
            f"{name_list(second.readings)}. Name two calibrations of one robot"
        )


def _draw_configurations(a: SavedModel, b: SavedModel, notices: list[str]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Configurations in the ranges of both, shape (M, columns), and further covariates of effects and their rivals."""
    robot = a.final.model.robot
    covariates = sorted({*a.expected.model.needs, *b.expected.model.needs} - set(OVER_TIME))
    columns = [*robot.readings, *covariates]
    from scipy.stats import qmc  # slow to load: only where configurations are drawn

    unit = qmc.Sobol(len(columns), seed=0).random(DRAWN_CONFIGURATIONS)
    samples = {}
    for share, name in zip(unit.T, columns, strict=True):
        ends = [saved.seen[name] for saved in (a, b) if name in saved.seen]
        low, high = (max(e[0] for e in ends), min(e[1] for e in ends)) if ends else (0.0, 0.0)
        if low > high and name in robot.readings:
            raise AridcalError(
                f"{name}: one calibration saw it from {ends[0][0]:.4g} to {ends[0][1]:.4g}, the other from {ends[1][0]:.4g} to "
                f"{ends[1][1]:.4g}: there is no configuration that both know. Measure where both did"
            )
        if low > high:
            notices.append(
                f"{name} was not the same in both: they are compared at {(low + high) / 2:.4g}, which neither saw"
            )
            low = high = (low + high) / 2
        if name.endswith("_direction") and low < high:
            share = np.round(share)  # a side is one of two
        samples[name] = low + share * (high - low)
    return np.column_stack([samples.pop(name) for name in robot.readings]), samples


def _in_one_place(
    a: SolvedModel, b: SolvedModel, targets: Sequence[str]
) -> tuple[SolvedModel, SolvedModel, dict[str, tuple[float, float]]]:
    """Both with the frames of the first: where base or targets were set up anew, this is no difference of arms.

    Args:
        a: The first.
        b: The second.
        targets: Labels of the targets that are compared; none: the first target's frame serves for all.

    Returns:
        Both, and how far apart they have each frame that is not known to be the same, [m] and [rad].
    """
    models = [solved.model.recentred(solved.theta) for solved in (a, b)]
    (first, theta_a), (second, theta_b) = models
    anew = {}
    changes: dict[str, Any] = {}
    for where in ("world_base", "tip_target"):
        frames_a, frames_b = getattr(first, where), getattr(second, where)
        of_targets = dict(frames_a) if where == "tip_target" and targets else {}
        pairs = (
            [(of_targets[label], dict(frames_b)[label]) for label in targets]
            if of_targets
            else [(frames_a[0][1], frames_b[0][1])]
        )
        steps = [one.inverse() * another for one, another in pairs]
        apart = (
            max(float(np.linalg.norm(step.translation)) for step in steps),
            max(float(Rotation.from_matrix(step.rotation).magnitude()) for step in steps),
        )
        fitted = any(c.where == where and c.basis.constant for model, _ in models for c in model.coefficients)
        if fitted or max(apart) > ROUNDING_STEP:
            anew[where] = apart
            changes[where] = tuple((label, of_targets.get(label, frames_a[0][1])) for label, _ in frames_b)
    second_moved = replace(second, **changes)
    return SolvedModel(first, theta_a, a.covariance), SolvedModel(second_moved, theta_b, b.covariance), anew


def _poses_and_jacobian(
    solved: SolvedModel,
    readings: np.ndarray,
    covariates: Mapping[str, np.ndarray],
    target: np.ndarray | None,
    saved: SavedModel,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses and Jacobian of one calibration, as it stood at its last row."""
    model = solved.model
    last = {name: np.full(len(readings), saved.seen.get(name, (0.0, 0.0))[1]) for name in OVER_TIME}
    base, tip = (None if label is None else np.full(len(readings), label) for label in model.first_labels)
    rows = model.rows(readings, dict(covariates) | last, base, tip if target is None else target)
    return model.jacobian(solved.theta, rows)


def _columns(J: np.ndarray, turns: bool) -> np.ndarray:
    """Columns of all numbers, shape (M * 6, K), or (M * 3, K) of positions alone, from a Jacobian (M, 6, K)."""
    rows = J if turns else J[:, :3]
    return rows.reshape(-1, J.shape[2])


def _bodies(R: np.ndarray, p: np.ndarray, which: np.ndarray, anew: frozenset[str], turns: bool) -> np.ndarray:
    """How targets move with the base and on their tools, those set up anew, shape (M, 6 or 3, up to 6 + 6 targets)."""
    M = len(p)
    parts = [np.zeros((M, 6, 0))]
    eye = np.broadcast_to(np.eye(3), (M, 3, 3))
    if "world_base" in anew:
        cross = np.cross(np.eye(3)[None, :, :], p[:, None, :]).transpose(0, 2, 1)
        parts += [
            np.concatenate([np.concatenate([eye, 0.0 * eye], axis=1), np.concatenate([cross, eye], axis=1)], axis=2)
        ]
    if "tip_target" in anew:
        on_tool = np.concatenate([np.concatenate([R, 0.0 * R], axis=1), np.concatenate([0.0 * R, R], axis=1)], axis=2)
        parts += [on_tool * (which == k)[:, None, None] for k in range(which.max() + 1)]
    motions = np.concatenate(parts, axis=2)
    return motions if turns else motions[:, :3]


def _difference_of_poses(
    first: tuple[np.ndarray, np.ndarray],
    second: tuple[np.ndarray, np.ndarray],
    which: np.ndarray,
    bodies: np.ndarray,
    anew: frozenset[str],
    turns: bool,
) -> np.ndarray:
    """Second minus first after base and targets of the second were moved so that both agree best, shape (M, 6 or 3).

    Gauss-Newton: what a motion leaves is small enough for one linear step only after it was taken off.
    """
    (R, p), (R_b, p_b) = first, second
    base, tool = np.zeros(6), np.zeros((which.max() + 1, 6))
    flat = bodies.reshape(-1, bodies.shape[2])
    for _ in range(ALIGNMENT_STEPS):
        places = p_b + np.einsum("nij,nj->ni", R_b, tool[which, :3])
        rotations = R_b @ Rotation.from_rotvec(tool[:, 3:]).as_matrix()[which]
        turn = Rotation.from_rotvec(base[3:]).as_matrix()
        places, rotations = places @ turn.T + base[:3], turn @ rotations
        d = places - p
        if turns:
            d = np.hstack([d, Rotation.from_matrix(rotations @ R.transpose(0, 2, 1)).as_rotvec()])
        if not anew:
            break
        step = np.linalg.lstsq(flat, -d.ravel(), rcond=None)[0]
        base += step[:6] if "world_base" in anew else 0.0
        tool += step[-tool.size :].reshape(-1, 6) if "tip_target" in anew else 0.0
        if np.abs(step).max() < ROUNDING_STEP:
            break
    return np.asarray(d)
