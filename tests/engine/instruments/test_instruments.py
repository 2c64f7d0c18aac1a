"""Kinds of measurements: derivatives against differences, predictions against other formulas, places from their own rows."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.kind import MeasurementKind, Role
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS as EVERY
from aridcal.engine.instruments.kinds import labelled
from aridcal.engine.instruments.pixels import UNSEEN_RESIDUAL
from aridcal.engine.instruments.pose import turned_back
from aridcal.engine.robot.kinematics import transverse

KINDS = {name: kind for name, kind in EVERY.items() if name != "camera_sonar"}  # of images: test_camera_sonar

LENS = np.array([702.0, 697.0, 330.0, 235.0, -0.2, 0.08, 0.001, -0.002, 0.05])
STEP = 1e-3
"""Of differences of the sixth order: their error is 1e-13 of the seventh derivative, rounding 1e-13 of the value."""


def rotations(rng: np.random.Generator, n: int) -> np.ndarray:
    return Rotation.random(n, rng=rng).as_matrix()


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def states_of(kind: MeasurementKind, rng: np.random.Generator, n: int, on_tip: bool) -> list[np.ndarray]:
    """Things around the arm, one for each row, in no special place."""
    made = []
    for role in kind.roles:
        if role.name == "plane":
            made.append(np.hstack([unit(rng.normal(size=(n, 3))), rng.normal(size=(n, 1))]))
        elif role.name == "anchor":
            made.append(
                np.hstack([rng.normal(size=(n, 3)) + 2.0, rng.normal(size=(n, 1)), rng.uniform(0.9, 1.1, (n, 1))])
            )
        elif role.name == "camera":
            flag = np.full((n, 1), float(on_tip))
            made.append(
                np.hstack([rng.normal(size=(n, 3)), rotations(rng, n).reshape(n, 9), np.tile(LENS, (n, 1)), flag])
            )
        elif role.name == "tracker":
            made.append(0.1 * rng.normal(size=(n, 2)))
        elif role.name in ("board", "grasp"):
            made.append(np.hstack([rng.normal(size=(n, 3)), rotations(rng, n).reshape(n, 9)]))
        else:
            made.append(rng.normal(size=(n, 3)))
    return made


def rows(
    name: str, seed: int = 0, n: int = 40, on_tip: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Targets, readings a little off, and states; what a camera sees lies in front of it."""
    rng = np.random.default_rng(seed)
    kind = KINDS[name]
    R, p, states = rotations(rng, n), rng.normal(size=(n, 3)), states_of(kind, rng, n, on_tip)
    observed = rng.normal(size=(n, len(kind.read)))
    if name == "pose":
        measured = R @ Rotation.from_rotvec(rng.normal(scale=0.5, size=(n, 3))).as_matrix()
        observed[:, 3:] = measured.reshape(n, 9)
    if name == "joined":
        held = R @ Rotation.from_rotvec(rng.normal(scale=0.5, size=(n, 3))).as_matrix()
        states[0][:, 3:] = held.reshape(n, 9)
    if name == "pixels":
        camera, board, _ = states
        seen = np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), rng.uniform(0.5, 1.5, n)])
        Z = np.einsum("nij,nj->ni", camera[:, 3:12].reshape(n, 3, 3), seen) + camera[:, :3]
        Y = np.einsum("nij,nj->ni", R, Z) + p if on_tip else np.einsum("nji,nj->ni", R, Z - p)
        states[2] = np.einsum("nji,nj->ni", board[:, 3:].reshape(n, 3, 3), Y - board[:, :3])
        observed += LENS[2:4]
    return R, p, observed, states


def slope(function: Callable[[float], np.ndarray]) -> np.ndarray:
    """Central difference of the sixth order at zero."""
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    total = sum(w * (function(k * STEP) - function(-k * STEP)) for k, w in weights.items())
    return np.asarray(total / (60.0 * STEP))


def same(found: np.ndarray, expected: np.ndarray) -> None:
    """Equal to 1e-7 of the row's largest number."""
    size = np.abs(expected).reshape(len(expected), -1).max(axis=1)
    wrong = np.abs(found - expected).reshape(len(expected), -1).max(axis=1)
    assert (wrong <= 1e-7 * np.maximum(size, 1.0)).all(), float((wrong / np.maximum(size, 1.0)).max())


def twisted(R: np.ndarray, p: np.ndarray, k: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """The target after a twist about its own origin in world axes."""
    if k < 3:
        return R, p + step * np.eye(3)[k]
    return Rotation.from_rotvec(step * np.eye(3)[k - 3]).as_matrix() @ R, p


CASES = [(name, on_tip) for name in KINDS for on_tip in ((True, False) if name == "pixels" else (True,))]
ROLES: list[Role] = [role for kind in KINDS.values() for role in kind.roles]


@pytest.mark.parametrize(("name", "on_tip"), CASES)
def test_derivatives_by_the_targets_twist_are_those_of_the_residual(name: str, on_tip: bool) -> None:
    kind = KINDS[name]
    R, p, observed, states = rows(name, on_tip=on_tip)
    seen = kind.derivatives(R, p, observed, states)
    assert seen.by_twist.shape == (len(p), sum(channel.size for channel in kind.channels), 6)
    for k in range(6):
        expected = -slope(lambda step, k=k: kind.residual(*twisted(R, p, k, step), observed, states))
        same(seen.by_twist[:, :, k], expected)
    if not kind.turns:
        assert not seen.by_twist[:, :, 3:].any()


@pytest.mark.parametrize(("name", "on_tip"), CASES)
def test_residuals_are_the_same_with_and_without_derivatives(name: str, on_tip: bool) -> None:
    kind = KINDS[name]
    asked = rows(name, on_tip=on_tip)
    np.testing.assert_allclose(kind.derivatives(*asked).residual, kind.residual(*asked), atol=1e-12)


@pytest.mark.parametrize(("name", "on_tip"), CASES)
def test_derivatives_by_every_component_of_every_role_are_those_of_the_residual(name: str, on_tip: bool) -> None:
    kind = KINDS[name]
    R, p, observed, states = rows(name, on_tip=on_tip)
    rng = np.random.default_rng(5)
    for j, role in enumerate(kind.roles):
        for size in (0.0, 0.3):  # at the start, and after a change
            change = size * rng.normal(size=(len(p), len(role.components)))
            change[:, 6:] *= 1e-2
            there = [role.moved(state, change) if j == k else state for k, state in enumerate(states)]
            by_local = kind.derivatives(R, p, observed, there).by_state[j]
            by_component = by_local if role.slope is None else by_local @ role.slope(states[j], change)
            if name == "pixels":  # some have left the image: their residual is a constant
                front = kind.residual(R, p, observed, there)[:, 0] != UNSEEN_RESIDUAL
                assert front.sum() > 3
            else:
                front = np.ones(len(p), dtype=bool)
            for k in range(len(role.components)):
                own = np.eye(len(role.components))[k]

                def residual(step: float, own: np.ndarray = own, j: int = j, change: np.ndarray = change) -> np.ndarray:
                    moved = [s.copy() for s in states]
                    moved[j] = kind.roles[j].moved(states[j], change + step * own)
                    return kind.residual(R, p, observed, moved)

                near = [residual(3 * s)[:, 0] != UNSEEN_RESIDUAL for s in (-STEP, STEP)]
                kept = front & near[0] & near[1] & (np.abs(residual(0.0)).max(axis=1) < 2000)
                assert kept.sum() > 3
                same(by_component[kept, :, k], -slope(residual)[kept])


@pytest.mark.parametrize("role", ROLES, ids=lambda role: role.name)
def test_no_change_moves_nothing_and_follows_itself(role: Role) -> None:
    kind = next(kind for kind in KINDS.values() if role in kind.roles)
    state = states_of(kind, np.random.default_rng(3), 30, True)[kind.roles.index(role)]
    none = np.zeros((30, len(role.components)))
    np.testing.assert_allclose(role.moved(state, none), state, atol=1e-15)
    assert state.shape[1] == role.size
    assert len(role.units) == len(role.components)
    assert set(role.identified) <= set(role.components)
    if role.slope is not None:
        np.testing.assert_allclose(
            role.slope(state, none), np.tile(np.eye(len(role.components)), (30, 1, 1)), atol=1e-15
        )


@pytest.mark.parametrize("on_tip", [True, False])
def test_pixels_are_opencvs(on_tip: bool) -> None:
    R, p, observed, states = rows("pixels", on_tip=on_tip)
    predicted = observed - KINDS["pixels"].residual(R, p, observed, states)
    for k, (camera, board, marker) in enumerate(zip(*states, strict=True)):
        T_tip, T_camera, T_board = np.eye(4), np.eye(4), np.eye(4)
        T_tip[:3, :3], T_tip[:3, 3] = R[k], p[k]
        T_camera[:3, :3], T_camera[:3, 3] = camera[3:12].reshape(3, 3), camera[:3]
        T_board[:3, :3], T_board[:3, 3] = board[3:].reshape(3, 3), board[:3]
        T = np.linalg.inv(T_tip @ T_camera) @ T_board if on_tip else np.linalg.inv(T_camera) @ T_tip @ T_board
        K = np.array([[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]])
        expected, _ = cv2.projectPoints(marker[None], cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, LENS[4:])
        np.testing.assert_allclose(predicted[k], expected.ravel(), atol=1e-7)


def test_what_is_behind_the_camera_is_far_off_and_moves_nowhere() -> None:
    R, p, observed, states = rows("pixels")
    states[0][:, 3:12] = (states[0][:, 3:12].reshape(-1, 3, 3) @ np.diag([1.0, -1.0, -1.0])).reshape(-1, 9)
    seen = KINDS["pixels"].derivatives(R, p, observed, states)
    assert (seen.residual == UNSEEN_RESIDUAL).all()
    assert not seen.by_twist.any()
    assert not any(part.any() for part in seen.by_state)


def test_inclination_is_the_angle_between_the_two_directions() -> None:
    R, p, observed, _ = rows("inclination")
    residual = KINDS["inclination"].residual(R, p, observed, [])
    down = np.einsum("nji,j->ni", R, [0.0, 0.0, -1.0])
    angle = np.arccos(np.clip(np.sum(unit(observed) * down, axis=1), -1, 1))
    np.testing.assert_allclose(np.linalg.norm(residual, axis=1), angle, atol=1e-9)
    again = KINDS["inclination"].residual(R, p, 9.81 * observed, [])
    np.testing.assert_allclose(again, residual, atol=1e-12)  # its length means nothing
    assert np.abs(KINDS["inclination"].residual(R, p, down, [])).max() < 1e-8
    upside_down = KINDS["inclination"].residual(R, p, -down, [])
    np.testing.assert_allclose(np.linalg.norm(upside_down, axis=1), np.pi, atol=1e-7)


def test_inclination_near_nothing_has_the_slope_of_its_series() -> None:
    rng = np.random.default_rng(0)
    R = rotations(rng, 50)
    small = Rotation.from_rotvec(10.0 ** rng.uniform(-9, -1.5, (50, 1)) * unit(rng.normal(size=(50, 3)))).as_matrix()
    observed = np.einsum("nji,j->ni", small @ R, [0.0, 0.0, -1.0])
    kind = KINDS["inclination"]
    seen = kind.derivatives(R, np.zeros((50, 3)), observed, [])
    for k in range(3, 6):
        expected = -slope(lambda step, k=k: kind.residual(*twisted(R, np.zeros((50, 3)), k, step), observed, []))
        same(seen.by_twist[:, :, k], expected)


def test_a_turn_before_another_adds_through_the_inverse_jacobian() -> None:
    rng = np.random.default_rng(1)
    vectors = 10.0 ** rng.uniform(-8, 0.45, (60, 1)) * unit(rng.normal(size=(60, 3)))
    made = turned_back(vectors)
    before = Rotation.from_rotvec(vectors)
    for k in range(3):
        same(made[:, :, k], slope(lambda s, k=k: (before * Rotation.from_rotvec(s * np.eye(3)[k])).as_rotvec()))


def test_planes_and_distances_are_what_geometry_says() -> None:
    R, p, observed, (plane,) = rows("plane")
    foot = p - (np.sum(plane[:, :3] * p, axis=1) - plane[:, 3])[:, None] * plane[:, :3]
    np.testing.assert_allclose(np.sum(foot * plane[:, :3], axis=1), plane[:, 3], atol=1e-12)
    height = np.linalg.norm(p - foot, axis=1) * np.sign(np.sum((p - foot) * plane[:, :3], axis=1))
    np.testing.assert_allclose(
        (observed[:, 0] - KINDS["plane"].residual(R, p, observed, [plane])[:, 0]), height, atol=1e-12
    )
    R, p, observed, (anchor,) = rows("distance")
    squared = np.sum(p**2, axis=1) - 2 * np.sum(p * anchor[:, :3], axis=1) + np.sum(anchor[:, :3] ** 2, axis=1)
    read = anchor[:, 4] * np.sqrt(squared) + anchor[:, 3]
    np.testing.assert_allclose(
        observed[:, 0] - KINDS["distance"].residual(R, p, observed, [anchor])[:, 0], read, atol=1e-9
    )


def test_a_wire_of_no_length_moves_nowhere() -> None:
    R, p, observed, (anchor,) = rows("distance")
    anchor[:, :3] = p
    seen = KINDS["distance"].derivatives(R, p, observed, [anchor])
    assert np.isfinite(seen.residual).all() and not seen.by_twist.any()


def one_thing(
    name: str, seed: int, n: int, on_tip: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Rows of one thing without error, and its state in every row."""
    rng = np.random.default_rng(seed)
    kind = KINDS[name]
    R, p, _, states = rows(name, seed, n, on_tip)
    states = [np.tile(state[:1], (n, 1)) for state in states]
    if name == "point":
        p = states[0].copy()
    if name == "plane":
        p = p - (np.sum(states[0][:, :3] * p, axis=1) - states[0][:, 3])[:, None] * states[0][:, :3]
        p += rng.uniform(-0.01, 0.01, (n, 1)) * states[0][:, :3]
    if name == "pixels":  # the tip goes to where the camera sees the marker
        camera, board, marker = states
        seen = np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), rng.uniform(0.5, 1.5, n)])
        Z = np.einsum("nij,nj->ni", camera[:, 3:12].reshape(n, 3, 3), seen) + camera[:, :3]
        Y = np.einsum("nij,nj->ni", board[:, 3:].reshape(n, 3, 3), marker) + board[:, :3]
        p = Y - np.einsum("nij,nj->ni", R, Z) if on_tip else Z - np.einsum("nij,nj->ni", R, Y)
    zero = np.zeros((n, len(kind.read)))
    return R, p, zero - kind.residual(R, p, zero, states) if kind.read else zero, states


@pytest.mark.parametrize("on_tip", [True, False])
@pytest.mark.parametrize("name", ["point", "distance", "plane", "pixels"])
def test_a_thing_is_located_from_its_own_rows(name: str, on_tip: bool) -> None:
    kind = KINDS[name]
    for seed in range(10):
        R, p, observed, states = one_thing(name, seed, 12, on_tip)
        blank = states[:-1] + [np.full_like(states[-1], np.nan)]
        if name == "distance":
            blank[-1][:, 4] = states[-1][:, 4]
        found = kind.located(R, p, observed, blank)
        np.testing.assert_allclose(found, states[-1][0], atol=1e-8)


def test_a_touched_plane_is_located_up_to_its_side() -> None:
    R, p, observed, (plane,) = one_thing("plane", 0, 20)
    p = p - observed * plane[:, :3]
    found = KINDS["plane"].located(R, p, np.zeros((20, 1)), [np.full((20, 4), np.nan)])
    np.testing.assert_allclose(found * np.sign(found[:3] @ plane[0, :3]), plane[0], atol=1e-12)
    assert found[:3][np.abs(found[:3]).argmax()] > 0


def misfit(R: np.ndarray, p: np.ndarray, observed: np.ndarray, plane: np.ndarray) -> float:
    return float(np.sum(KINDS["plane"].residual(R, p, observed, [np.tile(plane, (len(p), 1))]) ** 2))


def test_the_nearest_plane_under_a_gauge_has_no_better_neighbour() -> None:
    rng = np.random.default_rng(2)
    for seed in range(10):
        R, p, observed, (plane,) = one_thing("plane", seed, 25)
        observed = observed + 1e-3 * rng.normal(size=observed.shape)
        kind = KINDS["plane"]
        found = kind.located(R, p, observed, [plane])
        best = misfit(R, p, observed, found)
        for change in rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(-5, 0, (40, 1)):
            assert misfit(R, p, observed, kind.roles[0].moved(found[None], change[None])[0]) >= best * (1 - 1e-12)


@pytest.mark.parametrize("on_tip", [True, False])
@pytest.mark.parametrize(("name", "most"), [("point", 0), ("distance", 3), ("plane", 2), ("pixels", 1)])
def test_too_few_rows_locate_nothing(name: str, most: int, on_tip: bool) -> None:
    for n in range(most + 1):
        asked = one_thing(name, 4, max(n, 1), on_tip)
        R, p, observed, states = (part[:n] if k < 3 else [s[:n] for s in part] for k, part in enumerate(asked))
        assert np.isnan(KINDS[name].located(R, p, observed, states)).all()


@pytest.mark.parametrize("on_tip", [True, False])
@pytest.mark.parametrize("name", ["distance", "plane", "pixels"])
def test_rows_that_repeat_one_place_locate_nothing(name: str, on_tip: bool) -> None:
    R, p, observed, states = one_thing(name, 4, 1, on_tip)
    many = (np.tile(R, (9, 1, 1)), np.tile(p, (9, 1)), np.tile(observed, (9, 1)), [np.tile(s, (9, 1)) for s in states])
    assert np.isnan(KINDS[name].located(*many)).all()
    line = p + np.linspace(0, 1, 9)[:, None] * [1.0, 2.0, 3.0]  # nor a line
    if name != "pixels":
        assert np.isnan(KINDS[name].located(many[0], line, many[2], many[3])).all()


def test_rays_that_meet_behind_the_camera_or_that_no_lens_bends_so_locate_nothing() -> None:
    R, p, observed, states = one_thing("pixels", 1, 8)
    kind = KINDS["pixels"]
    mirrored = 2 * states[0][:, 14:16] - observed
    behind = [s.copy() for s in states]
    behind[0][:, 3:12] = (behind[0][:, 3:12].reshape(-1, 3, 3) @ np.diag([-1.0, -1.0, 1.0])).reshape(-1, 9)
    assert np.isfinite(kind.located(R, p, observed, states)).all()
    behind[0][:, 3:12] = (states[0][:, 3:12].reshape(-1, 3, 3) @ np.diag([1.0, -1.0, -1.0])).reshape(-1, 9)
    assert np.isnan(kind.located(R, p, np.column_stack([observed[:, 0], mirrored[:, 1]]), behind)).all()
    assert np.isnan(kind.located(R, p, np.full_like(observed, 1e6), states)).all()
    assert np.isnan(kind.located(R, p, observed, [np.full_like(states[0], np.nan), *states[1:]])).all()


def test_transverse_axes_of_many_are_those_of_each() -> None:
    rng = np.random.default_rng(0)
    axes = np.vstack([unit(rng.normal(size=(200, 3))), np.eye(3), -np.eye(3)])
    e1, e2 = transverse(axes)
    for axis, first, second in zip(axes, e1, e2, strict=True):
        one, two = transverse(axis)
        assert np.array_equal(one, first) and np.array_equal(two, second)


def test_the_table_has_its_columns_channels_and_names() -> None:
    for name, kind in KINDS.items():
        assert kind.name == name
        R, p, observed, states = rows(name)
        assert observed.shape[1] == len(kind.read)
        assert kind.residual(R, p, observed, states).shape[1] == sum(channel.size for channel in kind.channels)
        assert (kind.located is None) == (not labelled(name))
        assert all(role.many == (role.name not in ("camera", "board", "tracker")) for role in kind.roles)
