"""Doty's model of the ARID: its equations, what is wrong as printed, and what its poses can tell apart.

Reference figures are those of a separate check of every equation, symbolic and numerical, for link lengths of 0.5, 1.2
and 0.9 m; Doty (1992) gives none.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest
from doty_arm import LENGTHS, angles, arid, conditions, printed_E, random_q, ranks
from repository import ROOT

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot
from aridcal.engine.robot.doty import DOTY_COMPONENTS, link_transform
from aridcal.jobs.head1992.doty1992 import (
    DOTY_JOINTS,
    FRAME,
    ORBITER_TO_BASE,
    PARAMETERS,
    PSI,
    E,
    error_vector,
    first_order_link,
    first_order_pair,
    first_order_pose,
    jacobian,
    link_vectors,
    pose,
    solve_psi,
    start,
)
from aridcal.system.errors import NotIdentifiable

URDF = ROOT / "urdf"

TABLE_3_1_PSI = [k for k, name in enumerate(PSI) if not name.startswith("joint_4")]  # psi6: beta_4 = alpha_4 = 0


def columns(names: list[str]) -> list[int]:
    return [PARAMETERS.index(name) for name in names]


def stacked_E(rng: np.random.Generator, sets: int, n: int, theta_1: float = 0.0) -> np.ndarray:
    """E of n random poses, one above the other, for many sets of poses: shape (sets, n, 5, 8)."""
    return E(angles(random_q(rng, sets, n), theta_1), LENGTHS)


def rows_of(matrices: np.ndarray, rows: list[int], psi: list[int] | None = None) -> np.ndarray:
    chosen = matrices[:, :, rows][..., psi if psi is not None else range(8)]
    return chosen.reshape(len(chosen), -1, chosen.shape[-1])


def twists(poses: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Velocity of the origin, then angular velocity, base axes, from a pose's derivative."""
    spin = derivatives[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    return np.concatenate([derivatives[:, :3, 3], angular], axis=-1)


# --- the equations


def test_first_order_link_is_the_linear_part_of_the_exact_one():
    rng = np.random.default_rng(1)
    theta, beta, a, alpha, d = rng.uniform(-2, 2, (5, 40))
    h = 1e-30
    at_zero = link_transform(theta, 0.0, a, 0.0, d)
    slope = link_transform(theta, 1j * h * beta, a, 1j * h * alpha, d).imag / h
    np.testing.assert_allclose(first_order_link(theta, beta, a, alpha, d), at_zero + slope, atol=1e-14)


def test_first_order_pair_is_the_linear_part_of_the_exact_product():
    rng = np.random.default_rng(2)
    first, second = rng.uniform(-2, 2, (2, 40, 5))
    small = np.array([0, 0, 1, 0, 1])

    def product(scale: complex) -> np.ndarray:
        scaled = [pair * (1 - small + scale * small) for pair in (first, second)]
        one, two = (link_transform(**dict(zip(DOTY_COMPONENTS, pair.T, strict=True))) for pair in scaled)
        return one @ two

    expected = product(0.0) + product(1e-30j).imag / 1e-30
    np.testing.assert_allclose(first_order_pair(first, second), expected, atol=1e-13)


@pytest.mark.parametrize("theta_1", [0.0, 0.4])
def test_E_is_the_derivative_of_the_exact_pose(theta_1):
    q = random_q(np.random.default_rng(3), 20)
    by_E = E(angles(q, theta_1), LENGTHS)
    for k in range(8):
        psi = np.zeros(8, complex)
        psi[k] = 1e-30j
        links = arid().astype(complex)
        links[0, 1] = theta_1
        links[:, 2], links[:, 4] = psi.reshape(2, 4)
        poses = pose(links, q)
        assert np.abs(poses[:, :2, 3].imag).max() < 1e-45  # x and y do not depend on psi to first order
        np.testing.assert_allclose(error_vector(poses, q[:, 0]).imag / 1e-30, by_E[..., k], atol=1e-14)


def test_E_row_by_row_is_what_3_11_says_for_one_pose():
    t1, t2, t3, t4 = theta = np.array([0.3, 1.1, 2.0, -0.9])
    f = [t1, t1 + t2, t1 + t2 + t3, t1 + t2 + t3 + t4]
    g = [t2 + t3 + t4, t3 + t4, t4, 0.0]
    a1, a2, a3 = LENGTHS
    expected = [
        [*np.cos(f), *np.sin(f)],
        [*np.sin(f), *-np.cos(f)],
        [*-np.cos(g), *np.sin(g)],
        [*np.sin(g), *np.cos(g)],
        [-a1 - a2 * np.cos(t2) - a3 * np.cos(t2 + t3), -a2 - a3 * np.cos(t3), -a3, 0]
        + [a2 * np.sin(t2) + a3 * np.sin(t2 + t3), a3 * np.sin(t3), 0, 0],
    ]
    np.testing.assert_allclose(E(theta, LENGTHS), expected, atol=1e-15)


def test_rows_3_and_4_of_E_repeat_rows_1_and_2():
    theta = angles(random_q(np.random.default_rng(4), 50), 0.4)
    matrix = E(theta, LENGTHS)
    c, s = (f(theta.sum(axis=1))[:, None] for f in (np.cos, np.sin))
    np.testing.assert_allclose(matrix[:, 2], -c * matrix[:, 0] - s * matrix[:, 1], atol=1e-14)
    np.testing.assert_allclose(matrix[:, 3], s * matrix[:, 0] - c * matrix[:, 1], atol=1e-14)
    assert set(ranks(matrix)) == {3}


def test_reference_pose():
    psi = np.array([4, -3, 2, -1, 1, 2, -3, 4]) * 1e-3
    q = np.array([[5.0, *np.radians([60, 120, -60])]])
    expected = [
        [-0.499976782, -0.866016643, 0.006196038, 0.200009299],
        [0.865995148, -0.500010620, -0.006464013, 1.039226680],
        [0.008696028, 0.002133883, 0.999959912, 5.002248058],
    ]
    np.testing.assert_allclose(pose(arid(psi), q)[0, :3], expected, atol=1e-9)
    first_order = first_order_pose(angles(q), q[:, 0], psi, LENGTHS)
    np.testing.assert_allclose(
        error_vector(first_order, q[:, 0])[0], [0.006196, -0.006464, 0.008696, 0.002134, 0.002248], atol=1e-6
    )
    np.testing.assert_allclose(E(angles(q), LENGTHS)[0, 4], [-0.2, -0.75, -0.9, 0, 1.039230, 0.779423, 0, 0], atol=1e-6)


def test_exact_pose_matches_pinocchio():
    rng = np.random.default_rng(5)
    links = arid(rng.normal(size=8) * 0.3) + rng.normal(size=(4, 5)) * 0.1
    model, frame = pin.Model(), pin.SE3.Identity()
    for k, kind in enumerate([pin.JointModelPZ(), pin.JointModelRZ(), pin.JointModelRZ(), pin.JointModelRZ()]):
        model.addJoint(k, kind, frame, f"joint_{k + 1}")
        frame = pin.SE3(link_transform(**dict(zip(DOTY_COMPONENTS, links[k], strict=True))))
    data = model.createData()
    for q in random_q(rng, 10):
        pin.forwardKinematics(model, data, q)
        np.testing.assert_allclose(pose(links, q[None])[0], (data.oMi[4] * frame).homogeneous, atol=1e-12)


def test_exact_jacobian_matches_complex_differences_of_the_links():
    rng = np.random.default_rng(6)
    links = arid(rng.normal(size=8) * 0.02) + rng.normal(size=(4, 5)) * 0.02
    q = random_q(rng, 12)
    tip = pin.SE3(pin.rpy.rpyToMatrix(-0.3, 0.1, 0.2), np.array([0.1, 0.05, -0.2])).homogeneous
    J = jacobian(links, q, tip)
    poses = pose(links, q) @ tip
    for i, joint in enumerate(DOTY_JOINTS):
        for k, component in enumerate(DOTY_COMPONENTS):
            moved = links.astype(complex)
            moved[i, k] += 1e-30j
            derivative = (pose(moved, q) @ tip).imag / 1e-30
            np.testing.assert_allclose(
                J[..., PARAMETERS.index(f"{joint}.{component}")], twists(poses, derivative), atol=1e-12
            )


@pytest.mark.parametrize("where", ["world_base", "tip_target"])
def test_exact_jacobian_matches_differences_of_base_and_tool(where):
    rng = np.random.default_rng(7)
    links, q = arid(rng.normal(size=8) * 0.02), random_q(rng, 5)
    tip = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)).homogeneous
    J, poses = jacobian(links, q, tip), pose(links, q) @ tip
    for k, component in enumerate(FRAME):
        frames = []
        for h in (1e-6, -1e-6):
            step = h * np.eye(6)[k]
            error = pin.SE3(pin.rpy.rpyToMatrix(step[3:]), step[:3]).homogeneous
            frames.append(error @ poses if where == "world_base" else poses @ error)
        derivative = twists(poses, (frames[0] - frames[1]) / 2e-6)
        np.testing.assert_allclose(J[..., PARAMETERS.index(f"{where}.{component}")], derivative, atol=1e-7)


def test_E_is_the_exact_jacobian_at_the_nominal_arm():
    q = random_q(np.random.default_rng(8), 50)
    J = jacobian(arid(), q)[..., columns(list(PSI))]
    matrix = E(angles(q), LENGTHS)
    np.testing.assert_allclose(J[:, 3], -matrix[:, 1], atol=1e-12)
    np.testing.assert_allclose(J[:, 4], matrix[:, 0], atol=1e-12)
    np.testing.assert_allclose(J[:, 2], matrix[:, 4], atol=1e-12)
    np.testing.assert_allclose(J[:, [0, 1, 5]], 0.0, atol=1e-12)


def test_mirrored_parameters_give_the_mirrored_pose():
    rng = np.random.default_rng(9)
    links, q = arid(rng.normal(size=8) * 0.2), random_q(rng, 10)
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    odd = np.array([-1, 1, -1, 1, -1])  # d, beta, alpha change sign
    np.testing.assert_allclose(pose(links * odd, q * [-1, 1, 1, 1]), mirror @ pose(links, q) @ mirror, atol=1e-12)


def extended_model(names: list[str], lengths: np.ndarray) -> Model:
    """The shipped ARID with these lengths and link coefficients; at its singular fourth link the flange stands in."""
    robot = load_robot(URDF / "arid.urdf", tip="flange")
    origins = [robot.joints[0].origin] + [pin.SE3(np.eye(3), np.array([a, 0.0, 0.0])) for a in lengths]
    joints = tuple(replace(j, origin=origin) for j, origin in zip(robot.joints, origins, strict=True))
    stand_in = {"joint_4.theta": "flange_fixed.yaw", "joint_4.beta": "flange_fixed.pitch"}
    where = [stand_in.get(name, name).split(".") for name in names]
    return Model(replace(robot, joints=joints), tuple(Coefficient(*pair) for pair in where))


def test_extended_model_at_the_nominal_arm_has_E_for_its_jacobian():
    q = random_q(np.random.default_rng(34), 40)
    model = extended_model(list(PSI), LENGTHS)
    _, _, J = model.jacobian(np.zeros(8), model.rows(q))
    matrix = E(angles(q), LENGTHS)
    np.testing.assert_allclose(J[:, [4, 3, 2]], matrix[:, [0, 1, 4]] * [[1.0], [-1.0], [1.0]], atol=1e-12)
    np.testing.assert_allclose(J[:, [0, 1, 5]], 0.0, atol=1e-12)


def test_extended_model_has_the_exact_poses_and_jacobian_of_the_report_at_any_size_of_error():
    rng = np.random.default_rng(35)
    names = [name for name in ALL17 if name not in ("joint_4.theta", "joint_4.a")]
    theta = rng.normal(size=len(names)) * 0.05
    theta[[k for k, name in enumerate(names) if name.startswith("joint_4")]] = 0.0  # only there do the orders differ
    links = arid()
    for name, value in zip(names, theta, strict=True):
        joint, component = name.split(".")
        links[DOTY_JOINTS.index(joint), list(DOTY_COMPONENTS).index(component)] += value
    q = random_q(rng, 20)
    model = extended_model(names, LENGTHS)
    R, p, J = model.jacobian(theta, model.rows(q))
    expected = pose(links, q)
    np.testing.assert_allclose(R, expected[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(p, expected[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(J, jacobian(links, q)[..., columns(names)], atol=1e-11)


def test_extended_model_has_the_reference_pose():
    psi = np.array([4, -3, 2, 0, 1, 2, -3, 4]) * 1e-3
    q = np.array([[5.0, *np.radians([60, 120, -60])]])
    model = extended_model(list(PSI), LENGTHS)
    # Folded into the flange, the singular fourth link's -1 mrad of beta comes after its alpha, not before.
    R, p = model.poses(psi, model.rows(q))
    last = pin.SE3(link_transform(0.0, -1e-3, 0.0, 4e-3)), pin.SE3(link_transform(0.0, 0.0, 0.0, 4e-3))
    R = R[0] @ last[1].rotation.T @ last[0].rotation
    np.testing.assert_allclose(R[:, 2], [0.006196038, -0.006464013, 0.999959912], atol=1e-9)
    np.testing.assert_allclose(p[0], [0.200009299, 1.039226680, 5.002248058], atol=1e-9)


# --- how far the first-order model reaches


def first_order_errors(size: float, sets: int = 150, n: int = 10) -> dict[str, float]:
    """Worst errors of the first-order model over random poses, |psi_k| <= size."""
    rng = np.random.default_rng(10)
    worst = dict.fromkeys(("block", "e", "xy", "z", "psi"), 0.0)
    for _ in range(sets):
        psi, q = rng.uniform(-size, size, 8), random_q(rng, n)
        exact, approximate = pose(arid(psi), q), first_order_pose(angles(q), q[:, 0], psi, LENGTHS)
        off = exact - approximate
        e = error_vector(exact, q[:, 0]) - error_vector(approximate, q[:, 0])
        found = np.linalg.lstsq(E(angles(q), LENGTHS).reshape(-1, 8), error_vector(exact, q[:, 0]).ravel(), rcond=None)
        errors = {
            "block": np.abs(off[:, :2, :2]).max(),
            "e": np.abs(e[:, :4]).max(),
            "xy": 1e3 * np.hypot(off[:, 0, 3], off[:, 1, 3]).max(),
            "z": 1e3 * np.abs(e[:, 4]).max(),
            "psi": np.abs(found[0] - psi).max(),
        }
        worst = {key: max(value, errors[key]) for key, value in worst.items()}
    return worst


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (1e-3, (5.9e-6, 1.1e-8, 0.004, 3e-6, 6e-9)),
        (np.radians(0.1), (1.8e-5, 5.5e-8, 0.017, 3e-5, 2e-8)),
        (np.radians(0.5), (4.8e-4, 6.1e-6, 0.28, 2e-3, 3e-6)),
        (np.radians(1.0), (1.8e-3, 4.4e-5, 1.5, 2e-2, 2e-5)),
    ],
)
def test_errors_of_the_first_order_model_are_as_large_as_tabulated(size, expected):
    for found, tabulated in zip(first_order_errors(size).values(), expected, strict=True):
        assert 0.5 < found / tabulated < 2.0


def test_first_order_error_is_quadratic_in_x_y_and_the_block_and_cubic_in_the_rest():
    rng = np.random.default_rng(11)
    direction, q = rng.uniform(-1, 1, 8), random_q(rng, 20)

    def error(size: float) -> np.ndarray:
        off = pose(arid(size * direction), q) - first_order_pose(angles(q), q[:, 0], size * direction, LENGTHS)
        parts = off[:, :2, :2], off[:, :2, 3], off[:, :2, 2], off[:, 2, :2], off[:, 2, 3]
        return np.array([np.linalg.norm(part) for part in parts])

    order = np.log2(error(0.02) / error(0.01))
    np.testing.assert_allclose(order, [2, 2, 3, 3, 3], atol=0.01)


# --- E as printed, and the two-pose system


def test_the_printed_E_is_wrong_in_18_cells():
    theta = angles(random_q(np.random.default_rng(12), 30), 0.4)
    wrong = np.any(np.abs(printed_E(theta) - E(theta, LENGTHS)[:, :4]) > 1e-9, axis=0)
    assert wrong.sum(axis=1).tolist() == [8, 8, 2, 0]
    assert np.flatnonzero(wrong[2]).tolist() == [0, 2]


@pytest.mark.parametrize("blank_filled", [False, True])
def test_the_printed_E_inverts_without_complaint_and_returns_a_wrong_psi(blank_filled):
    rng = np.random.default_rng(13)
    theta = angles(random_q(rng, 300, 2))
    printed = printed_E(theta)
    if blank_filled:
        printed[..., 2, 0] = -np.cos(theta[..., 1:].sum(axis=-1))
    system = printed.reshape(300, 8, 8)
    psi = rng.normal(size=(300, 8))
    e = np.einsum("snij,sj->sni", E(theta, LENGTHS)[..., :4, :], psi).reshape(300, 8)
    found = np.linalg.solve(system, e[..., None])[..., 0]
    assert set(ranks(system)) == {8}
    assert 15 < np.median(conditions(system)) < 40
    assert np.median(np.linalg.norm(found - psi, axis=1) / np.linalg.norm(psi, axis=1)) > 2.0


@pytest.mark.parametrize("theta_1", [0.0, 0.4])
def test_the_correct_two_pose_system_is_always_singular(theta_1):
    system = rows_of(stacked_E(np.random.default_rng(14), 300, 2, theta_1), [0, 1, 2, 3])
    assert system.shape == (300, 8, 8)
    assert set(ranks(system)) == {4}


# --- what E can identify: base, tool, lengths and joints known


@pytest.mark.parametrize("theta_1", [0.0, 0.4])
@pytest.mark.parametrize(
    ("n", "psi8", "psi8_without_row_5", "psi6"),
    [(1, 3, 2, 3), (2, 6, 4, 6), (3, 8, 6, 6), (4, 8, 8, 6), (5, 8, 8, 6), (10, 8, 8, 6)],
)
def test_smallest_number_of_poses_for_psi(theta_1, n, psi8, psi8_without_row_5, psi6):
    matrices = stacked_E(np.random.default_rng(15), 200, n, theta_1)
    every = [0, 1, 2, 3, 4]
    assert set(ranks(rows_of(matrices, every))) == {psi8}
    assert set(ranks(rows_of(matrices, [0, 1, 2, 3]))) == {psi8_without_row_5}
    assert set(ranks(rows_of(matrices, every, TABLE_3_1_PSI))) == {psi6}


@pytest.mark.parametrize(
    ("n", "psi8", "psi8_without_row_5", "psi6"),
    [
        (2, None, None, 46),
        (3, 58, None, 21),
        (4, 26, 36, 16),
        (5, 20, 25, 14),
        (6, 18, 20, 14),
        (10, 15, 15, 13),
        (28, 13, 13, 12),
    ],
)
def test_median_condition_numbers_of_psi_from_E(n, psi8, psi8_without_row_5, psi6):
    matrices = stacked_E(np.random.default_rng(16), 1000, n)
    every = [0, 1, 2, 3, 4]
    systems = rows_of(matrices, every), rows_of(matrices, [0, 1, 2, 3]), rows_of(matrices, every, TABLE_3_1_PSI)
    for system, expected in zip(systems, (psi8, psi8_without_row_5, psi6), strict=True):
        if expected is not None:
            assert abs(np.median(conditions(system)) / expected - 1) < 0.12


def test_links_2_and_3_are_the_hardest_to_tell_apart():
    matrices = stacked_E(np.random.default_rng(17), 1, 3000)[0]
    information = np.einsum("nij,nik->jk", matrices, matrices) / 3000
    values, vectors = np.linalg.eigh(information)
    np.testing.assert_allclose(np.sqrt(values[[0, -1]]), [0.24, 2.9], rtol=0.03)
    z2, z3 = (vectors[k, 0] - 1j * vectors[k + 4, 0] for k in (1, 2))
    assert abs(z2 + z3 * np.exp(1j * np.radians(125))) < 0.05


def poses_moving(rng: np.random.Generator, moving: tuple[int, ...], n: int = 12) -> np.ndarray:
    q = np.tile([5.0, *np.radians([58, 125, -66.5])], (n, 1))
    q[:, list(moving)] = random_q(rng, n)[:, list(moving)]
    return q


def test_psi8_needs_joints_2_to_4_to_move_and_psi6_joints_2_and_3():
    rng = np.random.default_rng(18)
    for count in range(5):
        for moving in combinations(range(4), count):
            matrix = E(angles(poses_moving(rng, moving)), LENGTHS)
            assert (ranks(matrix.reshape(-1, 8)) == 8) == ({1, 2, 3} <= set(moving))
            assert (ranks(matrix[..., TABLE_3_1_PSI].reshape(-1, 6)) == 6) == ({1, 2} <= set(moving))


# --- parameter sets from full 6-D poses

BASE = [f"world_base.{c}" for c in FRAME]
TOOL = [f"tip_target.{c}" for c in FRAME]
PSI8 = list(PSI)
PSI6 = [PSI[k] for k in TABLE_3_1_PSI]
A123 = ["joint_1.a", "joint_2.a", "joint_3.a"]
TH234 = ["joint_2.theta", "joint_3.theta", "joint_4.theta"]
SET15 = [*PSI8, *A123, *TH234, "joint_1.d"]
ALL20 = [name for name in PARAMETERS if name.startswith("joint")]
ALL17 = [name for name in ALL20 if name not in ("joint_2.d", "joint_3.d", "joint_4.d")]
MINIMAL_A = [
    *BASE,
    *("joint_1.beta", "joint_1.alpha", "joint_2.beta", "joint_2.a", "joint_2.alpha"),
    *("joint_3.theta", "joint_3.beta", "joint_3.a", "joint_3.alpha"),
    *(name for name in TOOL if name != "tip_target.z"),
]
MINIMAL_B = [*ALL17, "world_base.roll", "world_base.pitch", "tip_target.y"]
END = ["joint_4.beta", "joint_4.a", "joint_4.alpha", "tip_target.z"]
BASE_GAUGE = ["joint_1.d", "joint_1.theta", "joint_1.a", "joint_2.theta"]

SETS = {  # names: rank, smallest number of generic poses, what to drop to make the set minimal
    "psi6": (PSI6, 6, 2, []),
    "psi6 + a": (PSI6 + A123, 9, 2, []),
    "psi8": (PSI8, 8, 3, []),
    "psi8 + rail zero": ([*PSI8, "joint_1.d"], 9, 3, []),
    "psi8 + a": (PSI8 + A123, 11, 3, []),
    "psi8 + a + offsets": (PSI8 + A123 + TH234, 14, 3, []),
    "15-set": (SET15, 15, 3, []),
    "15-set + theta_1": ([*SET15, "joint_1.theta"], 16, 3, []),
    "17": (ALL17, 17, 4, []),
    "20": (ALL20, 17, 4, ["joint_2.d", "joint_3.d", "joint_4.d"]),
    "base + psi8": (BASE + PSI8, 14, 3, []),
    "psi8 + tool": (PSI8 + TOOL, 12, 3, ["joint_4.beta", "joint_4.alpha"]),
    "base + psi8 + tool": (BASE + PSI8 + TOOL, 17, 4, ["joint_4.beta", "joint_4.alpha", "tip_target.z"]),
    "base + 17": (BASE + ALL17, 19, 5, BASE_GAUGE),
    "17 + tool": (ALL17 + TOOL, 18, 4, ["joint_4.theta", *END]),
    "base + 17 + tool": (BASE + ALL17 + TOOL, 20, 5, [*BASE_GAUGE, "joint_4.theta", *END]),
    "base + 20 + tool": (
        BASE + ALL20 + TOOL,
        20,
        5,
        [*BASE_GAUGE, "joint_4.theta", *END, "joint_2.d", "joint_3.d", "joint_4.d"],
    ),
    "minimal A": (MINIMAL_A, 20, 5, []),
    "minimal B": (MINIMAL_B, 20, 5, []),
}
CAMERA = np.block(
    [[pin.rpy.rpyToMatrix(-0.3, 0.1, 0.2), np.array([[0.1], [0.05], [-0.2]])], [np.zeros((1, 3)), np.ones((1, 1))]]
)


@pytest.fixture(scope="module")
def nominal_jacobian() -> np.ndarray:
    """The exact Jacobian at the nominal arm, 60 random poses, a tool that is turned and off the end frame."""
    return jacobian(arid(), random_q(np.random.default_rng(19), 60), CAMERA)


@pytest.mark.parametrize("name", SETS)
def test_rank_and_smallest_number_of_poses_of_a_parameter_set(name, nominal_jacobian):
    names, rank, smallest, drop = SETS[name]
    J = nominal_jacobian[..., columns(names)]
    by_n = [int(ranks(J[:n].reshape(6 * n, -1))) for n in range(1, 61)]
    assert by_n[-1] == rank
    assert by_n.index(rank) + 1 == smallest
    kept = [k for k, name in enumerate(names) if name not in drop]
    assert len(kept) == rank
    assert ranks(J[..., kept].reshape(-1, len(kept))) == rank


def test_an_unknown_base_needs_the_rail_to_move():
    rng = np.random.default_rng(20)
    for moving, base_psi8, minimal in (((1, 2, 3), 12, 18), ((0, 1, 2, 3), 14, 20)):
        J = jacobian(arid(), poses_moving(rng, moving))
        assert ranks(J[..., columns(BASE + PSI8)].reshape(-1, 14)) == base_psi8
        assert ranks(J[..., columns(MINIMAL_A)].reshape(-1, 20)) == minimal


def test_combinations_of_base_links_and_tool_that_no_pose_shows():
    theta_1, a1 = 0.4, LENGTHS[0]
    c, s = np.cos(theta_1), np.sin(theta_1)
    gauges = [
        {"world_base.z": 1, "joint_1.d": -1},
        {"world_base.yaw": 1, "joint_1.theta": -1},
        {"joint_1.a": 1, "world_base.x": -c, "world_base.y": -s},
        {"joint_2.theta": 1, "world_base.yaw": -1, "world_base.x": -a1 * s, "world_base.y": a1 * c},
        {"joint_4.theta": 1, "tip_target.yaw": -1},
        {"joint_4.beta": 1, "tip_target.pitch": -1},
        {"joint_4.a": 1, "tip_target.x": -1},
        {"joint_4.alpha": 1, "tip_target.roll": -1},
        {"world_base.z": 1, "tip_target.z": -1},
        *({f"joint_{k}.d": 1, "joint_1.d": -1} for k in (2, 3, 4)),
    ]
    links = arid()
    links[0, 1] = theta_1
    J = jacobian(links, random_q(np.random.default_rng(21), 60))
    for gauge in gauges:
        moved = sum(weight * J[..., PARAMETERS.index(name)] for name, weight in gauge.items())
        assert np.abs(moved).max() < 1e-12


def test_without_a1_the_rails_theta_and_joint_2s_offset_are_one_parameter():
    links = arid(lengths=np.array([0.0, 1.2, 0.9]))
    J = jacobian(links, random_q(np.random.default_rng(22), 60))[..., columns(ALL17)]
    assert ranks(J.reshape(-1, 17)) == 16


def test_precision_of_the_15_set_at_ten_poses():
    """1-sigma in mrad and mm at 0.25 mm and 0.5 mrad per axis, median over random pose sets."""
    q = random_q(np.random.default_rng(23), 400, 10)
    J = jacobian(arid(), q.reshape(-1, 4))[..., columns(SET15)] / np.repeat([0.25e-3, 0.5e-3], 3)[:, None]
    J = J.reshape(400, 60, 15)
    std = np.sqrt(np.diagonal(np.linalg.inv(np.swapaxes(J, 1, 2) @ J), axis1=1, axis2=2))
    betas, alphas = [0.17, 0.59, 0.82, 0.38], [0.30, 0.68, 0.53, 0.38]
    expected = [*betas, *alphas, 0.17, 0.36, 0.38, 0.31, 0.35, 0.42, 0.74]
    np.testing.assert_allclose(1e3 * np.median(std, axis=0), expected, rtol=0.15)


# --- solving: section 3.3


@pytest.mark.parametrize("n", [2, 5, 30])
def test_eliminating_the_joint_angles_leaves_no_information_on_the_lengths(n):
    q = random_q(np.random.default_rng(24), n)
    J = jacobian(arid(), q)[:, [0, 1, 5]]  # x, y and the turn of each pose, psi = 0
    per_pose = np.zeros((n, 3, n, 3))
    per_pose[np.arange(n), :, np.arange(n)] = J[..., columns(TH234)]
    free = per_pose.reshape(3 * n, 3 * n)  # each pose has three angles of its own
    lengths = J[..., columns(A123)].reshape(3 * n, 3)
    left = lengths - free @ np.linalg.lstsq(free, lengths, rcond=None)[0]
    assert np.abs(left).max() < 1e-9
    assert ranks(np.hstack([lengths, free])) == 3 * n  # of 3n + 3 unknowns


@pytest.mark.parametrize("weighted", [False, True])
def test_link_vectors_are_exact_from_three_poses_of_a_parallel_arm(weighted):
    rng = np.random.default_rng(25)
    links = arid(lengths=np.array([0.52, 1.19, 0.93]))
    links[:, 1] = [0.01, -0.02, 0.015, 0.03]
    q = random_q(rng, 3)
    found = link_vectors(pose(links, q), q, rng.uniform(0.5, 2, 3) if weighted else None)
    np.testing.assert_allclose(found.lengths, links[:3, 3], atol=1e-12)
    np.testing.assert_allclose(found.theta, links[:, 1], atol=1e-12)


def test_link_vectors_find_offsets_of_any_size():
    rng = np.random.default_rng(26)
    for _ in range(20):
        links = arid()
        links[:, 1] = rng.uniform(-np.pi, np.pi, 4)
        q = random_q(rng, 8)
        np.testing.assert_allclose(link_vectors(pose(links, q), q).theta, links[:, 1], atol=1e-9)


def test_weights_of_link_vectors_are_those_of_repeated_rows():
    rng = np.random.default_rng(27)
    q = random_q(rng, 6)
    poses = pose(arid(), q)
    poses[:, :2, 3] += rng.normal(size=(6, 2)) * 1e-3
    poses[:, :3, :3] = pin.exp3(np.array([0.0, 0.0, 1e-3])) @ poses[:, :3, :3]
    times = np.array([1, 2, 3, 1, 1, 2])
    by_weight = link_vectors(poses, q, times.astype(float))
    by_repeats = link_vectors(np.repeat(poses, times, axis=0), np.repeat(q, times, axis=0))
    np.testing.assert_allclose(by_weight.lengths, by_repeats.lengths, atol=1e-12)
    np.testing.assert_allclose(by_weight.theta, by_repeats.theta, atol=1e-12)


@pytest.mark.parametrize(("n", "expected"), [(3, 27), (5, 15), (10, 12)])
def test_median_condition_of_the_link_vector_system(n, expected):
    _, q2, q3, _ = np.moveaxis(random_q(np.random.default_rng(28), 2000, n), -1, 0)
    systems = np.stack([np.ones_like(q2), np.exp(1j * q2), np.exp(1j * (q2 + q3))], axis=-1)
    assert abs(np.median(conditions(systems)) / expected - 1) < 0.12


@pytest.mark.parametrize("rail_zero", [False, True])
def test_psi_comes_back_from_three_poses_to_third_order(rail_zero):
    rng = np.random.default_rng(29)
    direction, q = rng.uniform(-1, 1, 8), random_q(rng, 3)

    def error(size: float) -> float:
        links = arid(size * direction)
        links[0, 0] = 0.01 if rail_zero else 0.0
        psi, zero = solve_psi(pose(links, q), angles(q), q[:, 0], LENGTHS, rail_zero=rail_zero)
        return float(np.abs([*(psi - size * direction), zero - links[0, 0]]).max())

    assert error(1e-3) < 1e-6
    np.testing.assert_allclose(np.log2(error(0.02) / error(0.01)), 3, atol=0.05)


@pytest.mark.parametrize(("n", "expected"), [(3, 180), (5, 28)])
def test_median_condition_with_an_unknown_rail_zero(n, expected):
    matrices = stacked_E(np.random.default_rng(30), 2000, n)
    zero = np.broadcast_to(np.array([0.0, 0, 0, 0, 1])[:, None], (*matrices.shape[:3], 1))
    systems = np.concatenate([matrices, zero], axis=-1).reshape(2000, -1, 9)
    assert abs(np.median(conditions(systems)) / expected - 1) < 0.12


def test_two_poses_are_refused_and_the_unknowns_named():
    q = random_q(np.random.default_rng(31), 2)
    with pytest.raises(NotIdentifiable, match=r"joint_3.beta with .*joint_3.alpha"):
        solve_psi(pose(arid(), q), angles(q), q[:, 0], LENGTHS)
    with pytest.raises(NotIdentifiable, match=r"joint_1.a with joint_2.a with joint_3.a"):
        link_vectors(pose(arid(), q), q)


def test_a_joint_that_does_not_move_is_named_by_the_links_it_mixes():
    q = poses_moving(np.random.default_rng(32), (0, 1, 3))  # joint 3 held: a_2 and a_3 are one vector
    with pytest.raises(NotIdentifiable) as caught:
        link_vectors(pose(arid(), q), q)
    assert caught.value.groups == [["joint_2.a", "joint_3.a"]]


def test_exact_least_squares_from_the_closed_form_start_ends_at_the_truth():
    rng = np.random.default_rng(33)
    free = columns([*SET15, "joint_1.theta"])
    slots = np.array(free) - len(BASE)
    for _ in range(5):
        truth = arid(rng.uniform(-0.0175, 0.0175, 8), LENGTHS + rng.normal(size=3) * 0.02)
        truth[0, 0] = 0.02
        truth[:, 1] = rng.uniform(-0.5, 0.5, 4)
        q = random_q(rng, 20)
        measured = pose(truth, q)
        links = start(measured, q)
        assert np.abs(links - truth).max() < 5e-3  # second order in psi
        for _ in range(5):
            now = pose(links, q)
            turn = measured[:, :3, :3] @ np.swapaxes(now[:, :3, :3], 1, 2)
            residual = np.c_[measured[:, :3, 3] - now[:, :3, 3], [pin.log3(R) for R in turn]]
            step = np.linalg.lstsq(jacobian(links, q)[..., free].reshape(-1, len(free)), residual.ravel(), rcond=None)
            flat = links.ravel().copy()
            flat[slots] += step[0]
            links = flat.reshape(4, 5)
        np.testing.assert_allclose(links, truth, atol=1e-11)


# --- frames


def test_the_orbiters_x_is_the_rail_and_its_frame_is_right_handed():
    np.testing.assert_array_equal(ORBITER_TO_BASE @ ORBITER_TO_BASE.T, np.eye(3))
    assert np.linalg.det(ORBITER_TO_BASE) == pytest.approx(1.0)
    x, y, z = np.eye(3)
    np.testing.assert_array_equal(ORBITER_TO_BASE @ x, z)
    np.testing.assert_array_equal(ORBITER_TO_BASE @ y, -x)
    np.testing.assert_array_equal(ORBITER_TO_BASE @ z, -y)
