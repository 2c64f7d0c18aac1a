"""Doty's own model of the ARID, corrected: first-order poses and matrix E, exact Jacobian, closed-form starts.

K. L. Doty, "Calibration of the ARID Robot", NASA/ASEE Summer Faculty Fellowship (N93-19394), 1992. Equation numbers
are Doty's. What the paper prints differently, and why that is wrong, is said where it matters.

The ARID has a rail along z_0 (joint 1, travel d_1) and three revolute joints about axes that are nominally parallel to
it. Its links are an array of shape (4, 5), one row per joint, columns ``d theta beta a alpha`` in the order of the
product. The readings q = (d_1, theta_2, theta_3, theta_4) add to ``d`` of the first row and to ``theta`` of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.doty import DOTY_COMPONENTS, doty_links, link_transform
from aridcal.system.errors import NotIdentifiable

FRAME = ("x", "y", "z", "roll", "pitch", "yaw")
DOTY_JOINTS = ("joint_1", "joint_2", "joint_3", "joint_4")
JOINT_KINDS = ("prismatic", "revolute", "revolute", "revolute")

PSI = tuple(f"{joint}.{component}" for component in ("beta", "alpha") for joint in DOTY_JOINTS)
"""The unknowns of equation (3-12), in its order: beta_1..beta_4, alpha_1..alpha_4."""

PARAMETERS = (
    *(f"world_base.{c}" for c in FRAME),
    *(f"{joint}.{c}" for joint in DOTY_JOINTS for c in DOTY_COMPONENTS),
    *(f"tip_target.{c}" for c in FRAME),
)
"""The columns of :func:`jacobian`: base, links, tool."""

ORBITER_TO_BASE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Rotation from Orbiter to base coordinates (section 3.1), starboard ARID only: the rail runs along the Orbiter's x."""

D, THETA, BETA, A, ALPHA = range(5)
"""Columns of a links array."""

DEPENDENT_SINGULAR_SHARE = 1e-9
"""Smallest singular value, as a share of the largest, of a matrix whose columns are independent: poses that differ by a
billionth of the workspace say nothing apart."""

TAKES_PART = 1e-6
"""Share of a column in a dependency, beyond which it is named: rounding leaves less."""


def first_order_link(
    theta: np.ndarray | float,
    beta: np.ndarray | float,
    a: np.ndarray | float,
    alpha: np.ndarray | float,
    d: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Evaluate a link transform to first order in beta and alpha, equations (3-5) and (3-6).

    Args:
        theta: Joint angle, any shape (...) [rad]; all five arguments are broadcast.
        beta: Pitch [rad].
        a: Length [m].
        alpha: Twist [rad].
        d: Offset [m].

    Returns:
        Shape (..., 4, 4); rotations only to first order.
    """
    theta, beta, a, alpha, d = np.broadcast_arrays(theta, beta, a, alpha, d)
    c, s = np.cos(theta), np.sin(theta)
    zx = beta * c + alpha * s
    zy = beta * s - alpha * c
    x = a * c
    y = a * s
    height = d - beta * a
    return _matrix(
        [
            [c, -s, zx, x],
            [s, c, zy, y],
            [-beta, alpha, 1.0, height],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def first_order_pair(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Multiply two links with nearly parallel axes to first order, equations (3-7) to (3-9).

    Args:
        first: ``d theta beta a alpha`` of the first link, shape (..., 5), [m] and [rad].
        second: Those of the second link, likewise.

    Returns:
        Shape (..., 4, 4).
    """
    d1, th1, b1, a1, al1 = np.moveaxis(first, -1, 0)
    d2, th2, b2, a2, al2 = np.moveaxis(second, -1, 0)
    c1, s1 = np.cos(th1), np.sin(th1)
    c2, s2 = np.cos(th2), np.sin(th2)
    c12, s12 = np.cos(th1 + th2), np.sin(th1 + th2)
    # The axis after the first link, then that after both; what of x and y of the end stands in the first's z.
    x1 = b1 * c1 + al1 * s1
    y1 = b1 * s1 - al1 * c1
    x2 = b2 * c12 + al2 * s12 + x1
    y2 = b2 * s12 - al2 * c12 + y1
    zx = -b1 * c2 + al1 * s2 - b2
    zy = b1 * s2 + al1 * c2 + al2
    x = a2 * c12 + a1 * c1 + d2 * x1
    y = a2 * s12 + a1 * s1 + d2 * y1
    z = d1 + d2 + a2 * zx - b1 * a1
    return _matrix(
        [
            [c12, -s12, x2, x],
            [s12, c12, y2, y],
            [zx, zy, 1.0, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def E(theta: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    r"""Build the matrix E of e = E psi, equations (3-11) and (3-12), corrected.

    .. math:: e_1 + i e_2 = \sum_k (\beta_k - i \alpha_k) e^{i f_k}, \quad e_3 + i e_4 = -e^{-i f_4} (e_1 + i e_2),
        \quad f_k = \theta_1 + \dots + \theta_k

    Args:
        theta: Joint angles theta_1..theta_4, shape (..., 4) [rad]; theta_1 is a constant of the rail.
        lengths: a_1, a_2, a_3 [m].

    Returns:
        Shape (..., 5, 8): rows e_1..e_4 [1] and e_5 - d_1 [m], columns as :data:`PSI`, per radian. Rows 3 and 4 repeat
        rows 1 and 2 at every pose, so its rank is 3.

    Doty (1992) prints the columns of rows 1 and 2 in reverse, with further slips of sign: 18 wrong cells of 40.
    """
    theta = np.asarray(theta)
    _, th2, th3, th4 = np.moveaxis(theta, -1, 0)
    a1, a2, a3 = lengths
    zero = np.zeros_like(th4)
    f = np.cumsum(theta, axis=-1)
    g = np.stack([th2 + th3 + th4, th3 + th4, th4, zero], axis=-1)  # what is left to turn after joint k
    # The arm from joint k+1's foot on, seen along x_k.
    beyond_1 = a1 + a2 * np.exp(1j * th2) + a3 * np.exp(1j * (th2 + th3))
    beyond_2 = a2 + a3 * np.exp(1j * th3)
    beyond_3 = np.full_like(th4, a3, dtype=complex)
    beyond_4 = zero.astype(complex)
    reach = np.stack([beyond_1, beyond_2, beyond_3, beyond_4], axis=-1)
    by_beta = [np.cos(f), np.sin(f), -np.cos(g), np.sin(g), -reach.real]
    by_alpha = [np.sin(f), -np.cos(f), np.sin(g), np.cos(g), reach.imag]
    columns_of_beta = np.stack(by_beta, axis=-2)
    columns_of_alpha = np.stack(by_alpha, axis=-2)
    return np.concatenate([columns_of_beta, columns_of_alpha], axis=-1)


def error_vector(poses: np.ndarray, d1: np.ndarray) -> np.ndarray:
    """Read e = (e_1, e_2, e_3, e_4, e_5 - d_1) of (3-12) off end-frame poses, shape (N, 4, 4), at rail travel d1 (N,).

    Returns:
        Shape (N, 5): direction cosines, then the height beside the rail's travel [m].
    """
    e1, e2 = poses[..., 0, 2], poses[..., 1, 2]
    e3, e4 = poses[..., 2, 0], poses[..., 2, 1]
    height = poses[..., 2, 3] - d1
    return np.stack([e1, e2, e3, e4, height], axis=-1)


def first_order_pose(theta: np.ndarray, d1: np.ndarray, psi: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Evaluate the end frame's pose to first order in psi, equation (3-10), with d_1 counted once.

    Doty (1992) has d_1 both in entry (3, 4) and in its epsilon_5 (3-11e). x and y carry no first-order term at all, only
    because d_2 = d_3 = d_4 = a_4 = 0: their error is quadratic in psi, that of the other corrected entries cubic.

    Args:
        theta: Joint angles, shape (N, 4) [rad].
        d1: Rail travel, shape (N,) [m].
        psi: Shape (8,) [rad], in the order of :data:`PSI`.
        lengths: a_1, a_2, a_3 [m].

    Returns:
        Shape (N, 4, 4).
    """
    f = np.cumsum(theta, axis=-1)
    c, s = np.cos(f[..., 3]), np.sin(f[..., 3])
    x, y = np.cos(f[..., :3]) @ lengths, np.sin(f[..., :3]) @ lengths
    e1, e2, e3, e4, height = np.moveaxis(E(theta, lengths) @ psi, -1, 0)
    return _matrix(
        [
            [c, -s, e1, x],
            [s, c, e2, y],
            [e3, e4, 1.0, d1 + height],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def pose(links: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Evaluate the end frame's pose exactly, equation (3-4): L1 L2 L3 L4.

    Args:
        links: Shape (4, 5), ``d theta beta a alpha`` [m] and [rad].
        q: Readings, shape (N, 4): d_1 [m], theta_2..theta_4 [rad].

    Returns:
        Shape (N, 4, 4).
    """
    sums = _with_readings(links, q)
    L = link_transform(**{c: sums[..., k] for k, c in enumerate(DOTY_COMPONENTS)})
    return L[:, 0] @ L[:, 1] @ L[:, 2] @ L[:, 3]


def jacobian(links: np.ndarray, q: np.ndarray, tip: np.ndarray | None = None) -> np.ndarray:
    """Differentiate the pose ``pose(links, q) @ tip`` exactly, by the axes that its factors move along or about.

    A translation t moves the end point p by t; a rotation about w through O moves it by w x (p - O). The axes are those
    of the frame just before the factor. Base errors act at the base's origin, tool errors at the tool's, both at zero.

    Args:
        links: Shape (4, 5), ``d theta beta a alpha`` [m] and [rad].
        q: Readings, shape (N, 4): d_1 [m], theta_2..theta_4 [rad].
        tip: End frame to tool, shape (4, 4); default: the end frame is the tool.

    Returns:
        Shape (N, 6, 32), columns as :data:`PARAMETERS`: velocity of the tool's origin, then angular velocity, in base
        axes, per m or rad.
    """
    sums = _with_readings(links, q)
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    nil = dict.fromkeys(DOTY_COMPONENTS, 0.0)
    factors = _frame_factors(T)  # of the base
    for i in range(len(DOTY_JOINTS)):
        for k, (component, (kind, axis)) in enumerate(DOTY_COMPONENTS.items()):
            factors.append(_Factor(kind, T[:, :3, axis], T[:, :3, 3]))
            T = T @ link_transform(**(nil | {component: sums[:, i, k]}))
    T = T if tip is None else T @ tip
    factors += _frame_factors(T)  # of the tool
    end = T[:, :3, 3]
    J = np.zeros((len(q), 6, len(factors)))
    for k, factor in enumerate(factors):
        if factor.kind == "prismatic":
            J[:, :3, k] = factor.axis
        else:
            J[:, :3, k] = np.cross(factor.axis, end - factor.origin)
            J[:, 3:, k] = factor.axis
    return J


class _Factor(NamedTuple):
    """A factor of the product: what it moves along or about, in base axes, for N rows.

    Attributes:
        kind: ``prismatic`` or ``revolute``.
        axis: Shape (N, 3).
        origin: A point of the axis, shape (N, 3), [m].
    """

    kind: str
    axis: np.ndarray
    origin: np.ndarray


def _frame_factors(T: np.ndarray) -> list[_Factor]:
    """The six components of a frame, shape (N, 4, 4), in the order of :data:`FRAME`."""
    origin = T[:, :3, 3]
    return [_Factor(kind, T[:, :3, axis], origin) for kind in ("prismatic", "revolute") for axis in range(3)]


def solve_psi(
    poses: np.ndarray, theta: np.ndarray, d1: np.ndarray, lengths: np.ndarray, *, rail_zero: bool = False
) -> tuple[np.ndarray, float]:
    """Solve (3-12) for psi by least squares over rows 1, 2 and 5 of E: what each pose says, once.

    Doty (1992) asks for two poses and rows 1 to 4; that 8 x 8 system is always singular. Three poses are needed.

    Args:
        poses: Measured end-frame poses in the base frame, shape (N, 4, 4).
        theta: Joint angles, shape (N, 4) [rad].
        d1: Rail travel, shape (N,) [m].
        lengths: a_1, a_2, a_3 [m].
        rail_zero: Also solve for a constant to be added to d1.

    Returns:
        psi, shape (8,) [rad], and the rail's zero [m] (0 if known).

    Raises:
        NotIdentifiable: too few poses, or poses too much alike.
    """
    rows = [0, 1, 4]
    matrix = E(theta, lengths)[:, rows].reshape(-1, len(PSI))
    errors = error_vector(poses, d1)[:, rows].ravel()
    names = PSI
    if rail_zero:
        matrix = np.column_stack([matrix, np.tile([0.0, 0.0, 1.0], len(poses))])
        names = (*PSI, "joint_1.d")
    _require_full_rank(matrix, names)
    solution = np.linalg.lstsq(matrix, errors, rcond=None)[0]
    psi, extra = solution[: len(PSI)], solution[len(PSI) :]
    return psi, float(extra[0]) if rail_zero else 0.0


@dataclass(frozen=True)
class LinkVectors:
    """Link lengths and angle constants of the ARID in its plane.

    Attributes:
        lengths: a_1, a_2, a_3 [m], shape (3,).
        theta: The rail's theta_1, and what the readings of joints 2 to 4 lack, shape (4,) [rad].
    """

    lengths: np.ndarray
    theta: np.ndarray


def link_vectors(poses: np.ndarray, q: np.ndarray, weights: np.ndarray | None = None) -> LinkVectors:
    r"""Find lengths and angle constants in closed form, from encoders trusted up to constant offsets.

    .. math:: x + i y = A_1 + A_2 e^{i q_2} + A_3 e^{i (q_2 + q_3)}, \quad A_k = a_k e^{i \arg A_k}

    This takes the place of section 3.3, where the angles are unknown at each pose and eliminated by inverse kinematics:
    that is circular, as x, y and the turn of a pose fix its three angles whatever the lengths.

    Args:
        poses: Measured end-frame poses in the base frame, shape (N, 4, 4), N >= 3.
        q: Readings, shape (N, 4): d_1 [m], theta_2..theta_4 [rad].
        weights: Of the rows, as of their squared errors, shape (N,); default: equal.

    Returns:
        The constants: exact for parallel axes, else off by terms quadratic in psi. With a_1 = 0 the first two angles
        mean only their sum.

    Raises:
        NotIdentifiable: too few poses, or joints 2 and 3 do not move.
    """
    _, q2, q3, q4 = q.T
    root = np.ones(len(q)) if weights is None else np.sqrt(weights)
    xy = poses[:, 0, 3] + 1j * poses[:, 1, 3]
    turned = poses[:, 0, 0] + 1j * poses[:, 1, 0]  # x of the end frame
    turns = np.column_stack([np.ones_like(q2), np.exp(1j * q2), np.exp(1j * (q2 + q3))])
    matrix = root[:, None] * turns
    _require_full_rank(matrix, [f"{joint}.a" for joint in DOTY_JOINTS[:3]])
    vectors = np.linalg.lstsq(matrix, root * xy, rcond=None)[0]
    end = np.mean(root**2 * turned * np.exp(-1j * (q2 + q3 + q4)))
    directions = np.array([*vectors, end])
    before = np.array([1.0, *directions[:-1].conj()])
    return LinkVectors(np.abs(vectors), np.angle(directions * before))


def start(poses: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Identify the whole ARID in closed form, base and tool known: where exact least squares may start.

    Args:
        poses: Measured end-frame poses in the base frame, shape (N, 4, 4), N >= 3.
        q: Readings, shape (N, 4): d_1 [m], theta_2..theta_4 [rad].

    Returns:
        Links, shape (4, 5), ``d theta beta a alpha``; the 16 constants that the model has beside a_4 = 0 and
        d_2 = d_3 = d_4 = 0.

    Raises:
        NotIdentifiable: too few poses, or poses too much alike.
    """
    plane = link_vectors(poses, q)
    theta = plane.theta + np.column_stack([np.zeros(len(q)), q[:, 1:]])
    psi, rail_zero = solve_psi(poses, theta, q[:, 0], plane.lengths, rail_zero=True)
    links = np.zeros((4, 5))
    links[0, D] = rail_zero
    links[:, THETA] = plane.theta
    links[:3, A] = plane.lengths
    links[:, BETA], links[:, ALPHA] = psi.reshape(2, 4)
    return links


def links_from_poses(robot: Robot, poses: np.ndarray, readings: np.ndarray) -> np.ndarray | None:
    """:func:`start` for a robot of the ARID's build; None for others, and from poses that are too few or too much alike."""
    if not is_arid(robot):
        return None
    try:
        return start(poses, robot.positions(readings))
    except NotIdentifiable:
        return None


def is_arid(robot: Robot) -> bool:
    """A rail and three revolute joints, all parallel, frames as in Doty (1992)."""
    if tuple(joint.kind for joint in robot.joints) != JOINT_KINDS:
        return False
    along_z = all(np.allclose(joint.axis, [0, 0, 1]) for joint in robot.joints)
    return along_z and not robot.climbs and all(np.allclose(step.rotation, np.eye(3)) for step in robot.onward[:-1])


def link_table(robot: Robot) -> np.ndarray:
    """``d theta beta a alpha`` of each link, shape (links, 5); d is the joint's own travel, so its offset is 0."""
    return np.array([[0.0, link.theta, link.beta, link.a, link.alpha] for link in doty_links(robot)])


def _with_readings(links: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Links with the readings added, shape (N, 4, 5)."""
    readings = np.zeros((len(q), 4, 5))
    readings[:, 0, D] = q[:, 0]
    readings[:, 1:, THETA] = q[:, 1:]
    return links + readings


def _matrix(rows: list[list]) -> np.ndarray:
    """Stack scalars and arrays of one shape (...) into matrices (..., 4, 4)."""
    entries = np.broadcast_arrays(*[entry for row in rows for entry in row])
    return np.stack(entries, axis=-1).reshape(*entries[0].shape, 4, 4)


def _require_full_rank(matrix: np.ndarray, names: Sequence[str]) -> None:
    """Refuse a matrix with dependent columns, naming those that take part.

    Args:
        matrix: Shape (M, K).
        names: Of its columns.
    """
    _, values, directions = np.linalg.svd(np.linalg.qr(matrix, mode="r"))
    rank = int(np.sum(values > DEPENDENT_SINGULAR_SHARE * values.max(initial=0.0)))
    if rank < matrix.shape[1]:
        share = np.linalg.norm(directions[rank:], axis=0)
        raise NotIdentifiable([[name for name, part in zip(names, share, strict=True) if part > TAKES_PART]])
