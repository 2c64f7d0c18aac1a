"""Where everything unknown begins: from any attitude, without a guess, on exact and on noisy rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aridcal.instruments.catalogue import KINDS
from aridcal.instruments.setup import Things
from aridcal.instruments.starts import Start, starts

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

    def begun(self, hint: np.ndarray | None = None, target_known: bool = False) -> list[Start]:
        hint = np.eye(4) if hint is None else hint
        asked = (self.R, self.p, self.observed, self.refers, self.things)
        return starts(KINDS[self.name], *asked, self.target if target_known else hint, target_known)

    def misfit(self, start: Start) -> float:
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


def wrong(made: Scene, start: Start) -> float:
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
    off = [wrong(made, made.begun()[0]) for made in (scene(name, seed) for seed in range(100))]
    assert np.max(off) < 1e-6, (name, np.flatnonzero(np.array(off) >= 1e-6))


@pytest.mark.parametrize("on_tip", [True, False])
@pytest.mark.parametrize("board", [True, False])
def test_exact_images_begin_at_the_truth_from_any_mounting(on_tip: bool, board: bool) -> None:
    off = [wrong(made, made.begun()[0]) for made in (pictures(seed, on_tip, board) for seed in range(25))]
    assert np.max(off) < 1e-6, np.flatnonzero(np.array(off) >= 1e-6)
