"""Where everything unknown begins: from any attitude, without a guess, on exact and on noisy rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.descent import DescentPoint, StartView, descend, descent_point
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS as EVERY
from aridcal.engine.instruments.kinds import labelled
from aridcal.engine.instruments.setup import Things
from aridcal.engine.instruments.starts import aligned, starts

KINDS = {name: kind for name, kind in EVERY.items() if name != "camera_sonar"}  # of images: test_camera_sonar

LENS = np.array([702.0, 697.0, 330.0, 235.0, -0.1, 0.02, 0.001, -0.002, 0.0])


@dataclass(frozen=True)
class Scene:
    """Exact rows of one kind, and what is true."""

    name: str
    R: np.ndarray
    p: np.ndarray
    observed: np.ndarray
    refers: np.ndarray
    true: dict[str, np.ndarray]
    things: dict[str, Things]
    target: np.ndarray

    def begun(self, hint: np.ndarray | None = None, target_known: bool = False) -> list[DescentPoint]:
        hint = np.eye(4) if hint is None else hint
        asked = (self.R, self.p, self.observed, self.refers, self.things)
        return starts(KINDS[self.name], *asked, self.target if target_known else hint, target_known)

    def misfit(self, start: DescentPoint) -> float:
        """RMS of the residual's numbers."""
        R, p = self.R @ start.target[:3, :3], self.p + self.R @ start.target[:3, 3]
        states = [start.states[role.name][self.refers[:, j]] for j, role in enumerate(KINDS[self.name].roles)]
        return float(np.sqrt(np.mean(KINDS[self.name].residual(R, p, self.observed, states) ** 2)))


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def transform(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (*R.shape[:-2], 1, 1))
    T[..., :3, :3], T[..., :3, 3] = R, p
    return T


def unknown(name: str, true: dict[str, np.ndarray], free: tuple[str, ...] = ()) -> dict[str, Things]:
    """Things of which nothing is known beforehand but what is not free."""
    made = {}
    for role in KINDS[name].roles:
        state = true[role.name]
        start, mask = state.copy(), np.zeros((len(state), len(role.components)), dtype=bool)
        if not free or role.name in free:
            mask[:, [role.components.index(c) for c in role.identified]] = True
            start[:, : 12 if role.name in ("camera", "board") else role.size] = np.nan
            if role.name == "anchor":
                start[:, 4] = state[:, 4]
        labels = tuple(f"{role.name}_{k}" for k in range(len(state)))
        made[role.name] = Things(role, labels, start, mask, np.full(mask.shape, np.inf))
    return made


def scene(name: str, seed: int, n: int = 60) -> Scene:
    """A wrist anywhere in half a metre, turned by up to a radian or more about everything, and things anywhere around it."""
    rng = np.random.default_rng(seed)
    home = Rotation.random(rng=rng)
    R = (Rotation.from_rotvec(rng.uniform(-1.2, 1.2, (n, 3))) * home).as_matrix()
    p = rng.uniform(-0.3, 0.3, (n, 3)) + rng.uniform(-0.6, 0.6, 3)
    target = transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.15, 0.15, 3))
    count = 2
    refers = (np.arange(n) % count)[:, None]
    if name == "point":
        true = {"point": rng.uniform(-0.6, 0.6, (count, 3))}
        p = true["point"][refers[:, 0]] - R @ target[:3, 3]
        observed = np.zeros((n, 0))
    elif name == "distance":
        anchor = p.mean(axis=0) + unit(rng.normal(size=(count, 3))) * rng.uniform(0.5, 1.2, (count, 1))
        true = {"anchor": np.column_stack([anchor, rng.uniform(-0.1, 0.1, count), np.ones(count)])}
    elif name == "plane":
        normal = unit(rng.normal(size=(count, 3)))
        true = {"plane": np.column_stack([normal, rng.uniform(-0.5, 0.5, count)])}
        own = true["plane"][refers[:, 0]]
        q = p + R @ target[:3, 3]
        height = np.sum(own[:, :3] * q, axis=1) - own[:, 3] - rng.uniform(-0.005, 0.005, n)
        p = p - height[:, None] * own[:, :3]
    else:
        true, refers = {}, np.zeros((n, 0), dtype=int)
    if name != "point":
        zero = np.zeros((n, len(KINDS[name].read)))
        if name == "inclination":
            observed = rng.uniform(0.5, 10.0, (n, 1)) * np.einsum("nji,j->ni", R @ target[:3, :3], [0.0, 0.0, -1.0])
        else:
            states = [true[role.name][refers[:, j]] for j, role in enumerate(KINDS[name].roles)]
            observed = zero - KINDS[name].residual(R @ target[:3, :3], p + R @ target[:3, 3], zero, states)
    return Scene(name, R, p, observed, refers, true, unknown(name, true), target)


def pictures(seed: int, on_tip: bool, board: bool, shots: int = 15, cameras: int = 1) -> Scene:
    """Images of a few markers by cameras mounted in any attitude; the markers are a printed board's or lie about."""
    rng = np.random.default_rng(seed)
    grid = np.array(np.meshgrid(np.arange(4), np.arange(3), [0.0])).reshape(3, -1).T * [0.04, 0.04, 0.0]
    marker = grid if board else rng.uniform(-0.1, 0.1, (10, 3))
    T_carrier_board = transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.5, 0.5, 3)) if board else np.eye(4)
    if not board:
        marker = marker + rng.uniform(-0.5, 0.5, 3)
    middle = (T_carrier_board @ np.append(marker.mean(axis=0), 1.0))[:3]
    facing = T_carrier_board[:3, :3]
    lists: dict[str, list[np.ndarray]] = {"R": [], "p": [], "refers": [], "camera": []}
    for c in range(cameras):
        T_carrier_camera = transform(
            Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.15, 0.15, 3) * (1 if on_tip else 6)
        )
        camera = np.concatenate([T_carrier_camera[:3, 3], T_carrier_camera[:3, :3].ravel(), LENS, [float(on_tip)]])
        lists["camera"].append(camera)
        for _ in range(shots):
            view = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3) * [1, 1, 4]) * Rotation.from_euler("x", np.pi)
            T_board_camera = transform(facing @ view.as_matrix(), middle)
            T_board_camera[:3, 3] -= T_board_camera[:3, 2] * rng.uniform(0.4, 0.7)
            T = (
                T_board_camera @ np.linalg.inv(T_carrier_camera)
                if on_tip
                else T_carrier_camera @ np.linalg.inv(T_board_camera)
            )
            k = len(marker)
            lists["R"].append(np.tile(T[:3, :3], (k, 1, 1)))
            lists["p"].append(np.tile(T[:3, 3], (k, 1)))
            lists["refers"].append(np.column_stack([np.full(k, c), np.zeros(k, dtype=int), np.arange(k)]))
    R, p, refers = (np.concatenate(lists[name]) for name in ("R", "p", "refers"))
    place = np.concatenate([T_carrier_board[:3, 3], T_carrier_board[:3, :3].ravel()])
    true = {"camera": np.array(lists["camera"]), "board": place[None], "marker": marker}
    zero = np.zeros((len(p), 2))
    states = [true[role.name][refers[:, j]] for j, role in enumerate(KINDS["pixels"].roles)]
    observed = zero - KINDS["pixels"].residual(R, p, zero, states)
    free = ("camera", "board") if board else ("camera", "marker")
    return Scene("pixels", R, p, observed, refers, true, unknown("pixels", true, free), np.eye(4))


def wrong(made: Scene, start: DescentPoint) -> float:
    """Largest error of the target's translation or of a thing's state; planes may show either side."""
    errors = [] if made.name in ("pixels", "inclination") else [np.abs(start.target[:3, 3] - made.target[:3, 3]).max()]
    if made.name == "inclination":
        errors.append(np.abs(start.target - made.target)[:3, :3].max())
    for name, true in made.true.items():
        found = start.states[name]
        errors.append(np.abs(found - true).max())
    return float(np.max(errors))


@pytest.mark.parametrize("name", ["point", "distance", "plane", "inclination"])
def test_exact_rows_begin_at_the_truth_from_any_attitude(name: str) -> None:
    off = [wrong(made, made.begun()[0]) for made in (scene(name, seed) for seed in range(4))]
    assert np.max(off) < 1e-6, (name, np.flatnonzero(np.array(off) >= 1e-6))


@pytest.mark.parametrize("on_tip", [True, False])
@pytest.mark.parametrize("board", [True, False])
def test_exact_images_begin_at_the_truth_from_any_mounting(on_tip: bool, board: bool) -> None:
    made = pictures(2 * on_tip + board, on_tip, board, shots=8)
    assert wrong(made, made.begun()[0]) < 1e-6


def noisy(made: Scene, seed: int) -> Scene:
    """The same with an arm that is off by 0.1 mm and 0.1 mrad at each place, and readings off by 0.1 mm or 0.3 px."""
    rng = np.random.default_rng(seed)
    place = np.unique(made.p, axis=0, return_inverse=True)[1].ravel()
    turned = Rotation.from_rotvec(rng.normal(scale=1e-4, size=(place.max() + 1, 3))).as_matrix()
    moved = rng.normal(scale=1e-4, size=(place.max() + 1, 3))
    read = made.observed + (0.3 if made.name == "pixels" else 1e-4) * rng.normal(size=made.observed.shape)
    return replace(made, R=turned[place] @ made.R, p=made.p + moved[place], observed=read)


def least(made: Scene) -> float:
    """RMS that is left from the truth on: no start should be worse."""
    kind = KINDS[made.name]
    free = {role.name: made.things[role.name].free for role in kind.roles}
    view = StartView(kind, made.R, made.p, made.observed, made.refers, free, made.name != "pixels")
    return float(np.sqrt(descend(view, descent_point(view, made.target, made.true), 60).cost))


@pytest.mark.parametrize("name", ["point", "distance", "plane"])
def test_noisy_rows_begin_where_the_truth_would_end(name: str) -> None:
    for seed in range(3):
        made = noisy(scene(name, seed, n=24), seed)
        assert made.misfit(made.begun()[0]) < 1.01 * least(made), seed


@pytest.mark.parametrize(("on_tip", "board"), [(True, False), (False, True)])
def test_noisy_images_begin_where_the_truth_would_end(on_tip: bool, board: bool) -> None:
    for seed in range(2):
        made = noisy(pictures(seed, on_tip, board, shots=8), seed)
        assert made.misfit(made.begun()[0]) < 1.01 * least(made), seed


def test_cameras_help_each_other() -> None:
    for board in (True, False):
        made = pictures(0, False, board, shots=6, cameras=2)
        assert wrong(made, made.begun()[0]) < 1e-6


@pytest.mark.parametrize("name", ["point", "distance", "plane"])
def test_what_is_known_stays_and_what_nothing_refers_to_has_no_place(name: str) -> None:
    made = scene(name, 3)
    role = KINDS[name].roles[0]
    lonely = np.full((1, role.size), np.nan)
    things = made.things[role.name]
    start, free = np.vstack([things.start, lonely]), np.vstack([things.free, things.free[:1]])
    start[0], free[0] = made.true[role.name][0], False
    known = replace(things, names=(*things.names, "lonely"), start=start, free=free)
    found = replace(made, things={role.name: known}).begun()[0]
    np.testing.assert_array_equal(found.states[role.name][0], made.true[role.name][0])
    np.testing.assert_allclose(found.states[role.name][1], made.true[role.name][1], atol=1e-6)
    assert np.isnan(found.states[role.name][2]).all()
    held = made.begun(target_known=True)[0]
    np.testing.assert_array_equal(held.target, made.target)
    assert wrong(made, held) < 1e-6


def test_a_hint_is_kept_where_nothing_tells_the_target() -> None:
    made = scene("point", 1)
    level = replace(made, R=np.tile(made.R[:1], (60, 1, 1)), p=np.tile(made.p[:1], (60, 1)))
    hint = np.eye(4)
    hint[:3, 3] = [0.01, 0.02, 0.1]
    np.testing.assert_allclose(level.begun(hint)[0].target, hint, atol=1e-9)


def test_a_wrong_hint_of_a_camera_does_no_harm() -> None:
    made = pictures(2, True, True, shots=8)
    camera = made.things["camera"]
    start = made.true["camera"].copy()
    start[:, 3:12] = Rotation.random(rng=np.random.default_rng(0)).as_matrix().ravel()
    things = {**made.things, "camera": replace(camera, start=start)}
    assert wrong(made, replace(made, things=things).begun()[0]) < 1e-6


def test_one_row_of_each_point_is_not_an_error() -> None:
    made = scene("point", 0, n=2)
    assert np.isfinite(made.begun()[0].states["point"]).all()
    for name in ("distance", "plane"):
        assert np.isnan(scene(name, 0, n=2).begun()[0].states[KINDS[name].roles[0].name][:, :3]).all()


def cut(made: Scene, n: int) -> Scene:
    return replace(made, R=made.R[:n], p=made.p[:n], observed=made.observed[:n], refers=made.refers[:n])


def test_too_few_rows_begin_somewhere_and_never_fail() -> None:
    for n in (0, 1, 3, 7):
        for name in ("point", "distance", "plane", "inclination"):
            assert cut(scene(name, 1), n).begun()
        for on_tip, board in ((True, False), (False, True)):
            made = cut(pictures(1, on_tip, board, shots=2), n)
            assert made.begun()
            if n == 7 and on_tip:  # what no image has
                assert replace(made, observed=np.full_like(made.observed, 1e5)).begun()


def carried(role: str, T: np.ndarray, states: np.ndarray) -> np.ndarray:
    """States in the base frame, seen from the world."""
    made, R, p = states.copy(), T[:3, :3], T[:3, 3]
    if role == "plane":
        made[:, :3] = states[:, :3] @ R.T
        made[:, 3] = states[:, 3] + made[:, :3] @ p
        return made
    made[:, :3] = states[:, :3] @ R.T + p
    if role in ("board", "camera"):
        made[:, 3:12] = (R @ states[:, 3:12].reshape(-1, 3, 3)).reshape(-1, 9)
    return made


ROLES = {role.name: role for kind in KINDS for role in labelled(kind)}


@pytest.mark.parametrize("name", sorted(ROLES))
def test_the_base_is_where_known_things_say(name: str) -> None:
    rng = np.random.default_rng(0)
    T = transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    here = rng.normal(size=(5, ROLES[name].size))
    if name == "plane":
        here[:, :3] = unit(here[:, :3])
    if name in ("board", "camera"):
        here[:, 3:12] = Rotation.random(5, rng=rng).as_matrix().reshape(5, 9)
    if name == "camera":
        here[:, 21] = 0.0
    there = carried(name, T, here)
    there[0, 0] = here[1, 1] = np.nan
    found = aligned(ROLES[name], here, there)
    assert found is not None
    np.testing.assert_allclose(found, T, atol=1e-12)
    alone = name in ("board", "camera")
    assert (aligned(ROLES[name], here[2:3], there[2:3]) is not None) == alone
    assert aligned(ROLES[name], here[:2], there[:2]) is None
    if not alone:
        along = here[2:] * 0.0 + here[2]
        assert aligned(ROLES[name], along, carried(name, T, along)) is None
    if name == "camera":
        here[:, 21] = 1.0  # one on the tip stands nowhere in the world
        assert aligned(ROLES[name], here, there) is None
