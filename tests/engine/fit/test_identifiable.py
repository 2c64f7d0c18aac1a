"""What is identifiable: the ranks that theory predicts, and every redundancy named by those it hides among."""

from __future__ import annotations

import numpy as np
import pytest
import robots
from scipy.optimize import least_squares

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit import identifiable as identifiable_module
from aridcal.engine.fit.constants import constants
from aridcal.engine.fit.identifiable import CARRIES, REDUNDANT_SHARE, REDUNDANT_SIGMA, Subset, apart, identifiable
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.residual import triangle
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot

PANDA = robots.SHARED_ROBOTS / "panda_description" / "urdf" / "panda.urdf"
TIAGO = robots.SHARED_ROBOTS / "tiago_description" / "robots" / "tiago.urdf"
ROBOTS = {
    "arid": robots.arid,
    "ur10": robots.ur10,
    "panda": lambda: load_robot(PANDA, "panda_hand"),
    "tiago": lambda: load_robot(TIAGO, "wrist_ft_tool_link"),
    "any axes": lambda: robots.random_robot(1, "RPRCR"),
    "two rails": lambda: robots.random_robot(2, "PRPRR"),
}


def whole_jacobian(model: Model, q: np.ndarray, kind: str) -> np.ndarray:
    _, _, J = model.jacobian(np.zeros(len(model.coefficients)), model.rows(q))
    return J[:, : 6 if kind == "pose" else 3].reshape(-1, J.shape[2])


def subset_of(robot: Robot, q: np.ndarray, kind: str, which: str = "full", noise: float = 1e-4) -> tuple[Model, Subset]:
    """Frames anywhere, all constants, and what these configurations can tell of them."""
    rng = np.random.default_rng(9)
    frames = ((None, robots.random_placement(rng)),), ((None, robots.random_placement(rng, 0.3)),)
    model = Model(robot, (*robots.FRAMES, *constants(robot, which)), *frames)
    theta = np.zeros(len(model.coefficients))
    R, p = model.poses(theta, model.rows(q))
    asked = problem(model, robots.measured(robot, q, p, R if kind == "pose" else None))
    R = triangle(asked, theta, np.ones(len(q)), np.full(len(asked.channels), noise))
    return model, identifiable(R, range(len(theta)))


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("name", ROBOTS)
def test_constants_have_rank_4R_plus_2P_plus_6(name: str, kind: str) -> None:
    """Everett and Hsu 1988: and plus 3 where only positions are measured. The second road is the SVD of J itself."""
    robot = ROBOTS[name]()
    q = robots.readings(robot, 200, np.random.default_rng(0))
    model, found = subset_of(robot, q, kind)
    turning = sum(j.kind == "revolute" for j in robot.joints)
    expected = 4 * turning + 2 * (len(robot.joints) - turning) + (6 if kind == "pose" else 3)
    assert len(found.independent) == expected
    J = whole_jacobian(model, q, kind)
    length = np.linalg.norm(J, axis=0)
    J = J[:, length > 0] / length[length > 0]
    assert np.linalg.matrix_rank(J, tol=1e-6) == expected
    assert found.condition < 1e4


def test_arid_has_20() -> None:
    robot = robots.arid()
    q = robots.readings(robot, 200, np.random.default_rng(0))
    assert len(subset_of(robot, q, "pose")[1].independent) == 20


@pytest.mark.parametrize("kind", ["pose", "position"])
@pytest.mark.parametrize("name", ["arid", "ur10", "any axes"])
def test_redundant_parameters_are_named(name: str, kind: str) -> None:
    """What is dropped is indeed a sum of those it is said to hide among, and moves nothing if there are none."""
    robot = ROBOTS[name]()
    q = robots.readings(robot, 200, np.random.default_rng(0))
    model, found = subset_of(robot, q, kind)
    assert sorted([*found.independent, *found.redundant]) == list(range(len(model.coefficients)))
    J = whole_jacobian(model, q, kind)
    for k, partners in found.redundant.items():
        assert set(partners) <= set(found.independent)
        if not partners:
            assert np.abs(J[:, k]).max() < 1e-12
            continue
        rest = J[:, k] - J[:, partners] @ np.linalg.lstsq(J[:, partners], J[:, k], rcond=None)[0]
        assert np.linalg.norm(rest) < 0.05 * np.linalg.norm(J[:, k]), model.names[k]


def test_frames_are_kept_before_the_joints_next_to_them() -> None:
    robot = robots.arid()
    q = robots.readings(robot, 200, np.random.default_rng(0))
    model, found = subset_of(robot, q, "pose")
    kept = {model.names[k] for k in found.independent}
    frames = [c.name for c in robots.FRAMES]
    assert kept.issuperset(frames[:6])
    assert len(kept.intersection(frames)) == 11  # all axes are parallel: one shift along them, at either end
    named = {model.names[k]: {model.names[j] for j in partners} for k, partners in found.redundant.items()}
    assert "tip_target.yaw" in named["joint_4.yaw"]
    assert all(f"flange_fixed.{c}" in named for c in ("x", "y", "z", "roll", "pitch", "yaw"))
    assert {name.split(".")[0] for name in named["joint_1.x"]} == {"world_base"}


def test_with_positions_the_targets_rotation_moves_nothing() -> None:
    robot = robots.ur10()
    model, found = subset_of(robot, robots.readings(robot, 100, np.random.default_rng(0)), "position")
    for c in ("roll", "pitch", "yaw"):
        assert found.redundant[model.names.index(f"tip_target.{c}")] == ()


def test_a_joint_that_never_moves_takes_its_parameters_with_it() -> None:
    """Held still, joint 4 is a fixed joint: the rank is that of the arm without it."""
    robot = robots.ur10()
    q = robots.readings(robot, 200, np.random.default_rng(0))
    q[:, 3] = 0.7
    model, found = subset_of(robot, q, "pose")
    assert len(found.independent) == 4 * 5 + 6
    dropped = {model.names[k] for k in found.redundant if found.redundant[k]}
    assert {f"wrist_1_joint.{c}" for c in ("x", "y", "z", "roll", "pitch", "yaw")} & dropped


def test_one_configuration_tells_six_numbers() -> None:
    robot = robots.ur10()
    _, found = subset_of(robot, np.full((10, 6), 0.3), "pose")
    assert len(found.independent) == 6


def test_a_tool_that_never_turns_leaves_its_translation_open() -> None:
    """As in series D of the public UR10 data: three directions of tip_target go with world_base's."""
    robot = robots.ur10()
    q = robots.readings(robot, 300, np.random.default_rng(0))
    model = Model(robot, robots.FRAMES)
    R, _ = model.poses(np.zeros(12), model.rows(q))
    # Turn the last three joints so that the tool's attitude is the first row's: R_3 R(q4 q5 q6) = constant.
    kept = []
    for row in q[:60]:

        def off(x: np.ndarray, row: np.ndarray = row) -> np.ndarray:
            turned, _ = model.poses(np.zeros(12), model.rows(np.concatenate([row[:3], x])[None]))
            return (turned[0] - R[0]).ravel()

        best = least_squares(off, row[3:])
        if best.cost < 1e-20:
            kept.append(np.concatenate([row[:3], best.x]))
    assert len(kept) > 20
    model, found = subset_of(robot, np.array(kept), "pose", "none")
    named = {model.names[k]: {model.names[j] for j in partners} for k, partners in found.redundant.items()}
    for c in "xyz":
        assert {n.split(".")[0] for n in named[f"tip_target.{c}"]} == {"world_base"}


def upper(columns: list[list[float]]) -> np.ndarray:
    return np.linalg.qr(np.array(columns).T, mode="r")


def test_of_dependent_columns_the_later_in_order_go() -> None:
    rng = np.random.default_rng(0)
    a, b, c = 1e4 * rng.normal(size=(3, 50))
    R = upper([a, b, 2 * a - b, c])
    assert identifiable(R, [0, 1, 2, 3]).redundant == {2: (0, 1)}
    found = identifiable(R, [3, 2, 1, 0])
    assert found.independent == (3, 2, 1)
    assert found.redundant == {0: (2, 1)} or found.redundant == {0: (1, 2)}


@pytest.mark.parametrize(("reach", "count"), [(0.019, 2), (0.021, 1)])
def test_a_direction_that_the_noise_moves_by_more_than_20_mm_is_redundant(reach: float, count: int) -> None:
    """1 sigma of 19 mm is kept, 21 mm is not: as a column of its own, and as the combination of two."""
    assert len(identifiable(np.diag([1e4, 1 / reach]), [0, 1]).independent) == count
    turn = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2)
    assert len(identifiable(np.diag([1e4, 1 / reach]) @ turn, [0, 1]).independent) == count


def test_a_combination_of_many_that_moves_nothing_is_found() -> None:
    """Each column adds something, yet their alternating sum is as good as zero (Kahan's matrix)."""
    n, c = 30, 0.285
    s = np.sqrt(1 - c**2)
    kahan = np.diag(s ** np.arange(n)) @ (np.eye(n) - c * np.triu(np.ones((n, n)), 1))
    R = 5e3 * kahan
    assert 5e3 * s ** (n - 1) * 0.02 > 1.0
    found = identifiable(R, range(n))
    assert np.linalg.svd(R, compute_uv=False)[-1] * 0.02 < 1.0
    assert len(found.independent) < n
    assert np.linalg.svd(R[:, found.independent], compute_uv=False)[-1] * 0.02 >= 1.0
    assert np.isfinite(found.condition)


def test_order_of_the_constants_is_that_of_the_chain_own_axis_first() -> None:
    robot = robots.arid()
    found = constants(robot, "full")
    assert [c.where for c in found] == [w for w in (*robot.names, "flange_fixed") for _ in range(6)]
    for k, joint in enumerate(robot.joints):
        along = "xyz"[int(np.argmax(np.abs(joint.axis)))]
        first = {c.component for c in found[6 * k : 6 * k + 2]}
        assert first == {along, {"x": "roll", "y": "pitch", "z": "yaw"}[along]}
    assert Coefficient("joint_2", "pitch") in found


def test_what_is_no_sum_of_the_first_columns_is_found_and_only_that() -> None:
    rng = np.random.default_rng(0)
    first = 1e4 * rng.standard_normal((40, 6))
    sums, new, faint = first @ rng.standard_normal((6, 3)), 1e4 * rng.standard_normal((40, 2)), np.full((40, 1), 1.0)
    R = np.linalg.qr(np.hstack([first, sums, new, faint]), mode="r")
    assert apart(R, 6).tolist() == [False, False, False, True, True, False]
    # What is none beside the first columns is none beside more of them.
    kept = identifiable(R, range(R.shape[1])).independent
    assert set(kept) == {0, 1, 2, 3, 4, 5, 9, 10}


@pytest.mark.parametrize("many", [2, 100])
def test_weak_combinations_are_those_of_singular_values(many: int, monkeypatch: pytest.MonkeyPatch):
    """Twenty columns of which some combinations move almost nothing: taken out one by one, all else tried again, with SVDs."""
    monkeypatch.setattr(identifiable_module, "MANY_COLUMNS", many)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        J = 1e4 * rng.standard_normal((60, 20))
        for k in (7, 11, 15, 19):  # each a sum of others but for less than can be measured, two of them in a chain
            J[:, k] = J[:, rng.choice(k, 3, replace=False)].sum(axis=1) + 8.0 * rng.standard_normal(60)
        R = np.linalg.qr(J, mode="r")
        order = rng.permutation(20).tolist()
        length = np.linalg.norm(R, axis=0)
        kept = identifiable_module._extended(R, length, [], order, REDUNDANT_SHARE)
        weak: list[int] = []
        while True:
            _, singular, Vt = np.linalg.svd(R[:, kept])
            if singular[-1] * REDUNDANT_SIGMA >= 1.0:
                break
            part = np.abs(Vt[-1])
            weak.append(kept.pop(int(np.flatnonzero(part > CARRIES * part.max())[-1])))
            rest = [k for k in order if k not in weak]
            kept = identifiable_module._extended(R, length, kept, rest, REDUNDANT_SHARE)
        assert weak
        assert identifiable(R, order).independent == tuple(k for k in order if k in kept)
