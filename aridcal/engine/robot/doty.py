"""Doty's link model of any serial chain, from its geometry and back to it (section 3, equations 3-1 to 3-4).

Doty's link ``L = Tz(d) Rz(theta) Ry(beta) Tx(a) Rx(alpha)`` leads from one joint's axis to the next: four numbers per
revolute joint, as many as Denavit and Hartenberg need, but free of their jump where neighbouring axes are nearly
parallel. Its own weak spot is an axis that meets the one before it: there theta and beta lose their meaning, and the
link is called singular.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from aridcal.engine.robot.chain import Joint, Robot

# Below this distance [m] of the next axis' foot from a joint's axis, theta and beta are undefined.
SINGULAR_LENGTH = 1e-3

# At a singular link, axes within this angle [rad] of parallel have no common normal to turn x to.
PARALLEL_ANGLE = 1e-3

# Cosine of the angle from z (177.4 deg) beyond which the shortest way is hardly defined: a small change of the axis
# turns it round. There z turns onto the opposite direction, and then over.
NEARLY_DOWN = -0.999

# The factors of a link, in order: kind of motion, and the axis (0, 1, 2 for x, y, z) it moves along or about.
DOTY_COMPONENTS = {
    "d": ("prismatic", 2),
    "theta": ("revolute", 2),
    "beta": ("revolute", 1),
    "a": ("prismatic", 0),
    "alpha": ("revolute", 0),
}


@dataclass(frozen=True)
class Link:
    """One moving joint's link: from the joint, after its motion, to the next moving joint's frame (or to the tip).

    ``before * link_transform(theta, beta, a, alpha) * after`` is that placement, to rounding.

    Attributes:
        joint: The moving joint whose motion the link follows.
        prismatic: Whether that joint slides; then ``d`` is its reading and may be corrected.
        theta: Angle about the joint's axis, beside its reading [rad].
        beta: Pitch about y, after theta [rad].
        a: Length [m].
        alpha: Twist about x [rad].
        singular: The next axis meets this one within 1 mm, so theta and beta cannot be corrected here.
        before: From the joint's frame, after its motion, to the frame in which Rz(theta) acts; z is the joint's axis.
        after: From the end of Rx(alpha) to the next moving joint's frame, before its motion, or to the tip.
        next_origin: The joint whose origin takes yaw and pitch in place of theta and beta: the next moving one, or the
            last fixed one before the tip; None where there is none.
    """

    joint: str
    prismatic: bool
    theta: float
    beta: float
    a: float
    alpha: float
    singular: bool
    before: pin.SE3
    after: pin.SE3
    next_origin: str | None

    @property
    def components(self) -> tuple[str, ...]:
        """The factors that can be corrected at this link, in the order of the product."""
        absent = ({"theta", "beta"} if self.singular else set()) | (set() if self.prismatic else {"d"})
        return tuple(c for c in DOTY_COMPONENTS if c not in absent)


def link_transform(
    theta: np.ndarray | float,
    beta: np.ndarray | float,
    a: np.ndarray | float,
    alpha: np.ndarray | float,
    d: np.ndarray | float = 0.0,
) -> np.ndarray:
    r"""Evaluate the link transform, Doty (1992) equations (3-1) to (3-3).

    .. math:: L = T_z(d)\, R_z(\theta)\, R_y(\beta)\, T_x(a)\, R_x(\alpha)

    Args:
        theta: Joint angle, any shape (...) [rad]; all five arguments are broadcast.
        beta: Pitch [rad].
        a: Length [m].
        alpha: Twist [rad].
        d: Offset along the joint's axis [m], the reading of a prismatic joint.

    Returns:
        Homogeneous transforms from the link's end to its joint, shape (..., 4, 4).
    """
    theta, beta, a, alpha, d = np.broadcast_arrays(theta, beta, a, alpha, d)
    ct, st = np.cos(theta), np.sin(theta)
    cb, sb = np.cos(beta), np.sin(beta)
    ca, sa = np.cos(alpha), np.sin(alpha)
    zero, one = np.zeros_like(ct), np.ones_like(ct)
    x = [cb * ct, cb * st, -sb, zero]
    y = [ct * sa * sb - ca * st, ca * ct + sa * sb * st, cb * sa, zero]
    z = [ca * ct * sb + sa * st, -ct * sa + ca * sb * st, ca * cb, zero]
    origin = [a * cb * ct, a * cb * st, d - a * sb, one]
    columns = [np.stack(column, axis=-1) for column in (x, y, z, origin)]
    return np.stack(columns, axis=-1)


def axis_to_link(point: np.ndarray, direction: np.ndarray) -> tuple[float, float, float, float]:
    """Find the link that leads to a given axis: the inverse of :func:`link_transform` up to a screw along that axis.

    Args:
        point: Any point of the next joint's axis in this joint's frame (z along this joint's axis), shape (3,) [m].
        direction: The next axis' unit direction, in the same frame, shape (3,).

    Returns:
        theta, beta [rad], a [m], alpha [rad]. The link ends at the point of the next axis nearest to the frame's
        origin, a from it. Where that point lies on z (a = 0 or beta = +-90 deg) theta and beta mean nothing.
    """
    foot = point - (point @ direction) * direction
    x, y, z = foot
    theta = float(np.arctan2(y, x))
    beta = float(np.arctan2(-z, np.hypot(x, y)))
    return theta, beta, float(np.linalg.norm(foot)), _twist(theta, beta, direction)


def _twist(theta: float, beta: float, direction: np.ndarray) -> float:
    """The angle about x, after theta and beta, that turns z onto a direction [rad]."""
    turned = link_transform(theta, beta, 0.0, 0.0)[:3, :3].T @ direction
    return float(np.arctan2(-turned[1], turned[2]))


def align(direction: np.ndarray) -> pin.SE3:
    r"""Turn z onto a unit direction by the shortest way (by -z where that is close); frame axes permute exactly.

    .. math:: R = 1 + [v] + \frac{[v]^2}{1 + c}, \quad v = z \times d, \ c = z \cdot d, \quad
        1 + c = \frac{|v|^2}{1 - c}

    (Rodrigues). Below the horizon 1 + c is taken in the second form: a direction is a unit vector only to rounding, and
    with the first form R would be a rotation only to that rounding divided by 1 + c.
    """
    if direction[2] < NEARLY_DOWN:
        half_turn = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
        return align(-direction) * half_turn
    x, y, c = direction
    v = pin.skew(np.array([-y, x, 0.0]))
    one_plus_c = 1.0 + c if c >= 0.0 else (x * x + y * y) / (1.0 - c)
    return pin.SE3(np.eye(3) + v + v @ v / one_plus_c, np.zeros(3))


def doty_links(robot: Robot) -> tuple[Link, ...]:
    """Describe the chain base -> tip by Doty's link parameters, one link per moving joint.

    F_0 is the first joint's frame with z turned onto its axis; F_i ends link i, with z on the axis of joint i + 1 (on
    the tip's z for the last link). So each joint adds to theta or d of its own link alone, as equation (3-4) asks.

    Args:
        robot: The chain.

    Returns:
        The links. At a singular one theta turns x onto the common normal z_{i-1} x z_i (0 where the two are parallel),
        beta = a = 0, ``before`` climbs to the foot of the next axis, and ``after`` holds the rest.
    """
    joints = robot.main.joints
    steps = zip(robot.onward[1:-1], joints[1:], strict=True)
    ends: list[tuple[pin.SE3, np.ndarray, str | None]] = [(step, j.along, j.name) for step, j in steps]
    ends.append((robot.onward[-1], np.array([0.0, 0.0, 1.0]), robot.tip_joint))
    links = []
    start = align(joints[0].along).inverse()  # from F_{i-1}, moved by joint i, to joint i's frame
    for joint, (placement, axis, next_origin) in zip(joints, ends, strict=True):
        link, start = _link(joint, start, placement, axis, next_origin)
        links.append(link)
    return tuple(links)


def links_down(robot: Robot) -> tuple[Link, ...]:
    """Links whose parameters corrections can move: of joints on the way down, where the next origin in the URDF holds them."""
    joints = robot.main.joints
    return tuple(link for link, joint in zip(doty_links(robot), joints, strict=True) if not joint.climbs)


def _link(
    joint: Joint, start: pin.SE3, placement: pin.SE3, axis: np.ndarray, next_origin: str | None
) -> tuple[Link, pin.SE3]:
    """Return a joint's link, and the next one's start: from this link's end, moved by the next joint, to its frame."""
    end = start * placement
    direction = end.rotation @ axis
    foot = end.translation - (end.translation @ direction) * direction
    theta, beta, a, alpha = axis_to_link(foot, direction)
    singular = bool(np.hypot(foot[0], foot[1]) < SINGULAR_LENGTH)
    climb, rest = pin.SE3.Identity(), pin.SE3.Identity()
    if singular:
        normal = np.array([-direction[1], direction[0]])  # z x direction
        theta = float(np.arctan2(normal[1], normal[0])) if np.hypot(*normal) > PARALLEL_ANGLE else 0.0
        beta, a, alpha = 0.0, 0.0, _twist(theta, 0.0, direction)
        climb.translation = np.array([0.0, 0.0, foot[2]])
        # The next joint turns about its own axis, not about one 1 mm or 1 mrad off: its frame starts exactly there.
        to_end = link_transform(theta, beta, a, alpha)[:3, :3].T
        rest = align(to_end @ direction)
        rest.translation = to_end @ np.array([foot[0], foot[1], 0.0])
    reached = climb * pin.SE3(link_transform(theta, beta, a, alpha))
    link = Link(
        joint=joint.name,
        prismatic=joint.kind == "prismatic",
        theta=theta,
        beta=beta,
        a=a,
        alpha=alpha,
        singular=singular,
        before=start.inverse() * climb,
        after=reached.actInv(end),
        next_origin=next_origin,
    )
    return link, (reached * rest).actInv(end)


def motion(component: str, value: float) -> pin.SE3:
    """Evaluate one factor of a link: ``theta`` is Rz(value), ``a`` is Tx(value), and so on; [rad] or [m]."""
    kind, axis = DOTY_COMPONENTS[component]
    along = value * np.eye(3)[axis]
    return pin.SE3(np.eye(3), along) if kind == "prismatic" else pin.SE3(pin.exp3(along), np.zeros(3))


def segments(link: Link) -> tuple[tuple[tuple[str, pin.SE3], ...], pin.SE3]:
    """Cut a link where its corrections act, so that each can be an extra joint of a model.

    Args:
        link: The nominal link.

    Returns:
        For each of ``link.components``, its name and the constant placement that leads to it from the component before
        (or from the joint's frame, after its motion); and the placement that remains after the last one.
    """
    cuts = []
    placement = link.before
    for component in DOTY_COMPONENTS:
        placement = placement * motion(component, 0.0 if component == "d" else getattr(link, component))
        if component in link.components:
            cuts.append((component, placement))
            placement = pin.SE3.Identity()
    return tuple(cuts), placement * link.after
