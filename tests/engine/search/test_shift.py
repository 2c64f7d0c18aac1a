"""What moved once between two rows: named with its place and row, and the machine as it is now is what is predicted.

The measurements come from two machines, before and after, without the kind `shift` itself.
"""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import yaml
from scipy.spatial.transform import Rotation
from searched import Searched, searched

from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.inverse.row_kinematics import OneRowModel
from aridcal.engine.model.model import Model
from aridcal.files.campaign import load_campaign
from aridcal.files.read import load_measurements
from aridcal.identify import main
from aridcal.jobs.calibrate.folder import moment
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.simulate import main as simulate
from aridcal.system.errors import AridcalError

SIGMA = 1e-4
N = 160
LEVER = "shoulder_lift_joint"
SWING = np.array([2.8, 1.2, 1.8, 2.5, 2.5, 2.8])
MIDDLE = np.array([0.0, -1.2, 0.0, 0.0, 0.0, 0.0])
FEW = {"candidates": ["shift", "drift", "joint_gain"]}
"""Kinds to choose from where it is known from other tests that of all kinds none other is taken."""

Moves = list[tuple[int, str, object]]


class Machine:
    """A UR10 with constants of its own, of which something moves at some rows."""

    def __init__(self, seed: int, moves: Moves, n: int = N) -> None:
        rng = np.random.default_rng(seed)
        robot = robots.ur10()
        self.q = self.draw(rng, n)
        constants = tuple(Coefficient(j, c) for j in robot.names for c in ("x", "y", "z", "roll", "pitch", "yaw"))
        theta = rng.normal(0.0, 1e-3, len(constants))
        self.states = []
        world, tip, zero = robots.random_placement(rng), robots.random_placement(rng, 0.2), np.zeros(6)
        for row, where, move in [(0, "", None), *moves]:
            if where == "world_base":
                world = move * world  # type: ignore[operator]
            elif where == "tip_target":
                tip = tip * move
            elif where:
                zero = zero + move * np.array([name == where for name in robot.names])
            self.states.append((row, Model(robot, constants, ((None, world),), ((None, tip),)), zero))
        self.theta, self.rng = theta, rng

    @staticmethod
    def draw(rng: np.random.Generator, n: int) -> np.ndarray:
        return rng.uniform(-1.0, 1.0, (n, 6)) * SWING + MIDDLE

    def poses(self, q: np.ndarray, state: int = -1) -> tuple[np.ndarray, np.ndarray]:
        _, model, zero = self.states[state]
        return model.poses(self.theta, model.rows(q + zero))

    def table(self, kind: str = "pose") -> pd.DataFrame:
        R, p = self.poses(self.q, 0)
        for k, (row, _, _) in enumerate(self.states):
            R[row:], p[row:] = self.poses(self.q[row:], k)
        p = p + SIGMA * self.rng.normal(size=p.shape)
        R = Rotation.from_rotvec(SIGMA * self.rng.normal(size=p.shape)).as_matrix() @ R
        found = dict(zip(robots.ur10().readings, self.q.T, strict=True)) | dict(zip("xyz", p.T, strict=True))
        if kind == "pose":
            found |= dict(zip(("qx", "qy", "qz", "qw"), Rotation.from_matrix(R).as_quat().T, strict=True))
        return pd.DataFrame(found)

    def campaign(self, folder: Path, table: pd.DataFrame | None = None, kind: str = "pose", **keys: object) -> Path:
        rows = self.table(kind) if table is None else table
        rows.to_csv(folder / "m.csv", index=False, float_format="%.17g")
        robot = {"urdf": str(robots.URDF / "ur10.urdf"), "base": "base_link", "tip": "tool0"}
        text = {"format": 1, "robot": robot, "measurements": {"file": "m.csv", "kind": kind}} | keys
        (folder / "campaign.yaml").write_text(yaml.safe_dump(text))
        return folder / "campaign.yaml"

    def miss(self, model: SolvedModel) -> float:
        """RMS distance from where the target is now, at fresh configurations, [m]."""
        q = self.draw(np.random.default_rng(99), 300)
        return float(np.sqrt(np.mean(np.sum((model.poses(q)[1] - self.poses(q)[1]) ** 2, axis=1))))


SLIP = pin.SE3(np.eye(3), np.array([2e-4, -2e-4, 1e-4]))
KNOCK = pin.SE3(pin.exp3(np.array([3e-4, -2e-4, 4e-4])), np.array([3e-4, 4e-4, -2e-4]))
HEAVY = pin.SE3(pin.exp3(np.array([1e-3, 5e-4, -5e-4])), np.array([1.5e-3, -1e-3, 8e-4]))


def happened(found: Searched) -> list[tuple[str, str, int]]:
    """Kind, place and row of each effect, in the order of the rows."""
    rows = [0 if e.at is None else moment(e.at, found.rows)["row"] for e in found.effects]
    return sorted(((e.kind, e.where, row) for e, row in zip(found.effects, rows, strict=True)), key=lambda e: e[2])


def solved(found: Searched) -> SolvedModel:
    return SolvedModel(found.fit.model, found.fit.theta, found.fit.covariance)


@pytest.mark.parametrize(
    ("moves", "kind"),
    [
        ([(80, "tip_target", SLIP)], "pose"),
        ([(80, "tip_target", SLIP)], "position"),
        ([(80, LEVER, 4e-4)], "pose"),
        ([(15, "world_base", HEAVY)], "pose"),  # in the first tenth, and so large that it bends the geometric stage
    ],
)
def test_what_moved_is_named_with_its_row_and_the_rest_is_noise(moves: Moves, kind: str, tmp_path: Path) -> None:
    machine = Machine(1, moves)
    found = searched(machine.campaign(tmp_path, kind=kind))
    ((row, where, _),) = moves
    ((name, place, at),) = happened(found)
    assert (name, place) == ("shift", where)
    assert abs(at - (row + 2)) <= 2
    assert found.verdict == "noise_floor"
    assert machine.miss(solved(found)) < 0.6 * SIGMA


def test_a_campaign_that_never_moved_predicts_as_well_as_one_that_did(tmp_path: Path) -> None:
    """An oracle is told the row; what is found by itself misses no more than a tenth above it."""
    machine = Machine(2, [(80, "tip_target", SLIP)])
    path = machine.campaign(tmp_path, diagnosis=FEW)
    found = machine.miss(solved(searched(path)))
    keys = yaml.safe_load(path.read_text())
    keys |= {"effects": [{"kind": "shift", "where": "tip_target", "at": {"row": 82}}], "diagnosis": {"enabled": False}}
    path.write_text(yaml.safe_dump(keys))
    assert found < 1.1 * machine.miss(solved(searched(path)))


def test_the_time_of_a_shift_counts_where_rows_are_in_another_order(tmp_path: Path) -> None:
    machine = Machine(3, [(90, "world_base", KNOCK)])
    table = machine.table()
    table["time"] = 1000.0 + 30.0 * np.arange(N)
    found = searched(machine.campaign(tmp_path, table.sample(frac=1.0, random_state=0), diagnosis=FEW))
    (effect,) = found.effects
    assert effect.at is not None
    at = moment(effect.at, found.rows)
    assert (effect.kind, effect.where) == ("shift", "world_base")
    assert at["time"] == pytest.approx(1000.0 + 30.0 * 90, abs=61.0)
    lines = pd.read_csv(tmp_path / "m.csv")
    assert lines["time"][at["row"] - 2] == at["time"]
    # In the order of the file there is no step, and who asks without time asks for now.
    assert machine.miss(solved(found)) < 0.6 * SIGMA


def test_two_moves_of_one_frame_are_two_effects(tmp_path: Path) -> None:
    back = pin.SE3(pin.exp3(np.array([-5e-4, 0, 2e-4])), np.array([-6e-4, 3e-4, 2e-4]))
    machine = Machine(4, [(50, "world_base", KNOCK), (120, "world_base", back)])
    found = searched(machine.campaign(tmp_path, diagnosis=FEW))
    (_, first, at_first), (_, second, at_second) = happened(found)
    assert (first, second) == ("world_base", "world_base")
    assert abs(at_first - 52) <= 2
    assert abs(at_second - 122) <= 2
    assert machine.miss(solved(found)) < 0.6 * SIGMA


@pytest.mark.parametrize("what", ["nothing", "walk", "ramp"])
def test_a_machine_that_stood_still_or_wandered_slowly_has_no_shift(what: str, tmp_path: Path) -> None:
    machine = Machine(5, [])
    table = machine.table()
    rng = np.random.default_rng(6)
    wander = {
        "nothing": np.zeros((N, 3)),
        "walk": np.cumsum(rng.normal(size=(N, 3)), axis=0) * 4e-5,
        "ramp": np.linspace(0.0, 1.0, N)[:, None] * [3e-4, 4e-4, 0.0],
    }[what]
    table[["x", "y", "z"]] += wander
    found = searched(machine.campaign(tmp_path, table))
    assert not any(kind == "shift" for kind, _, _ in happened(found))
    assert found.verdict == ("noise_floor" if what == "nothing" else "structure_remains")


def test_rows_that_moved_alike_are_no_outliers_and_a_wild_one_stays_one(tmp_path: Path) -> None:
    """So few rows before the knock that the geometric stage flags them all: the step takes their flags off."""
    machine = Machine(14, [(12, "world_base", HEAVY)])
    table = machine.table()
    table.loc[100, "x"] += 0.019
    found = searched(machine.campaign(tmp_path, table.assign(split=np.where(np.arange(N) % 5 == 4, "test", "train"))))
    ((kind, where, row),) = happened(found)
    assert (kind, where) == ("shift", "world_base")
    assert abs(row - 14) <= 1
    assert list(found.rows.origin.line[found.judged.outlier]) == [100 + 2]
    assert machine.miss(solved(found)) < 0.6 * SIGMA


@pytest.mark.parametrize("at", [{"row": 82}, {"time": 2415.0}, None], ids=["row", "time", "sought"])
def test_a_declared_shift_is_fitted_where_it_is_said_or_found_to_be(at: object, tmp_path: Path) -> None:
    machine = Machine(7, [(80, "tip_target", SLIP)])
    table = machine.table().assign(time=30.0 * np.arange(N) + 30.0)
    stated = {"kind": "shift", "where": "tip_target"} | ({"at": at} if at else {})
    path = machine.campaign(tmp_path, table, effects=[stated], diagnosis={"enabled": False})
    found = searched(path)
    (effect,) = found.effects
    assert effect.at is not None
    told = moment(effect.at, found.rows)
    if at is None:
        assert abs(told["row"] - 82) <= 3
    else:
        assert told == {"row": 82, "time": 2430.0}
    for coefficient, change in zip(effect.coefficients, [2e-4, -2e-4, 1e-4, 0, 0, 0], strict=True):
        k = found.fit.model.names.index(coefficient.name)
        assert found.fit.theta[k] == pytest.approx(change, abs=4.5 * found.fit.std[k])


def test_a_shift_may_be_declared_to_move_in_some_directions_only(tmp_path: Path) -> None:
    machine = Machine(7, [(80, "tip_target", SLIP)])
    stated = {"kind": "shift", "where": "tip_target", "at": {"row": 82}, "motion": ["z", "x"]}
    path = machine.campaign(tmp_path, effects=[stated], diagnosis={"enabled": False})
    (effect,) = searched(path).effects
    assert effect.motion == ("x", "z")


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"at": {"row": 2}}, "at.row: no fitted row is before it"),
        ({"at": {"row": 5000}}, "at.row: no fitted row is after it"),
        ({"at": {"time": 3.0}}, "at.time: no complete column `time`"),
        ({"at": {}}, "write {row: LINE} or {time: SECONDS}"),
        ({"at": {"row": 5, "time": 3.0}}, "write {row: LINE} or {time: SECONDS}"),
        ({"at": {"row": 1}}, "greater than or equal to 2"),
        ({"kind": "joint_gain", "where": LEVER, "at": {"row": 5}}, "`at` belongs to a shift only"),
    ],
)
def test_a_shift_that_cannot_be_is_refused_with_its_key(stated: dict[str, object], said: str, tmp_path: Path) -> None:
    path = Machine(8, [], 40).campaign(tmp_path, effects=[{"kind": "shift", "where": "world_base"} | stated])
    with pytest.raises(AridcalError) as refused:
        identify(path)
    assert said in str(refused.value)
    assert "campaign.yaml" in str(refused.value)


@pytest.fixture(scope="module")
def knocked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Path]:
    """A calibration of a machine whose tripod was knocked, in time, and what was printed of it."""
    machine, folder = Machine(9, [(70, "world_base", HEAVY)]), tmp_path_factory.mktemp("knocked")
    path = machine.campaign(folder, machine.table().assign(time=30.0 * np.arange(N)))
    with redirect_stdout(io.StringIO()) as said:
        assert main([str(path), "--out", str(folder / "out")]) == 0
    (folder / "screen.txt").write_text(said.getvalue())
    return machine, folder


def test_what_is_written_predicts_the_present_and_with_a_time_the_past(knocked: tuple[Machine, Path]) -> None:
    machine, folder = knocked
    saved = SavedModel.load(folder / "out")
    q = machine.draw(np.random.default_rng(1), 50)
    for covariates, state in (({}, 1), ({"time": np.full(50, 1e9)}, 1), ({"time": np.zeros(50)}, 0)):
        p = saved.final.poses(q, covariates)[1]
        assert np.abs(p - machine.poses(q, state)[1]).max() < 4 * SIGMA
    one_row = OneRowModel(saved.final.model, saved.final.theta)
    assert one_row.needs == ()
    for covariates, state in (({}, 1), ({"time": 0.0}, 0)):
        p = np.array([one_row.pose(row, one_row.effects(row, covariates))[1] for row in q])
        assert np.abs(p - machine.poses(q, state)[1]).max() < 4 * SIGMA
    assert "time" not in saved.ranges


def test_the_file_of_the_machine_as_it_is_now_needs_no_effects(knocked: tuple[Machine, Path]) -> None:
    """With a shift as the only effect, model.urdf and the frames are the whole present."""
    machine, folder = knocked
    result = json.loads((folder / "out" / "result.json").read_text())
    (effect,) = result["effects"]
    assert (effect["kind"], effect["covariates"]) == ("shift", ["time"])
    robot = robots.load_robot(folder / "out" / "model.urdf", "tool0", "base_link")
    placed = []
    for name in ("world_base", "tip_target"):
        frame = result["frames"][name]
        placed.append(pin.SE3(pin.rpy.rpyToMatrix(*frame["rpy"]), np.array(frame["xyz"])))
    model = Model(robot, (), ((None, placed[0]),), ((None, placed[1]),))
    q = machine.draw(np.random.default_rng(1), 50)
    np.testing.assert_allclose(
        model.poses(np.zeros(0), model.rows(q))[1], SavedModel.load(folder / "out").final.poses(q)[1], atol=1e-9
    )


def test_the_report_and_the_screen_say_what_moved_between_which_rows(knocked: tuple[Machine, Path]) -> None:
    _, folder = knocked
    (effect,) = json.loads((folder / "out" / "result.json").read_text())["effects"]
    row = effect["at"]["row"]
    words = f"world_base moved between rows {row - 1} and {row}"
    assert words in (folder / "out" / "report.html").read_text("utf-8")
    assert words in " ".join((folder / "screen.txt").read_text().split())


def test_rows_of_another_day_come_after_every_shift(tmp_path: Path) -> None:
    machine = Machine(10, [(70, "tip_target", HEAVY)])
    path = machine.campaign(tmp_path, diagnosis=FEW)
    later = replace_rows(machine, 60)
    later.to_csv(tmp_path / "later.csv", index=False)
    outcome = identify(path, verify=tmp_path / "later.csv")
    assert [(e.effect.kind, e.effect.where) for e in outcome.effects] == [("shift", "tip_target")]
    assert outcome.verification is not None
    missed = outcome.verification.residuals["final"][:, :3]
    assert np.sqrt(np.mean(missed**2)) < 1.3 * SIGMA


def replace_rows(machine: Machine, n: int) -> pd.DataFrame:
    """Rows of the machine as it is now."""
    now = Machine(10, [])
    now.q, now.states, now.theta = machine.draw(np.random.default_rng(5), n), [machine.states[-1]], machine.theta
    now.states = [(0, *now.states[0][1:])]
    return now.table()


def test_held_out_rows_beside_a_shift_choose_nothing_and_are_not_held_against_the_model(tmp_path: Path) -> None:
    """Fitted rows cannot tell on which side they are: all six rows around the knock are held out."""
    machine = Machine(11, [(78, "world_base", HEAVY)])
    held_out = (np.arange(N) % 6 == 0) | ((np.arange(N) >= 77) & (np.arange(N) < 83))
    table = machine.table().assign(split=np.where(held_out, "test", "train"))
    found = searched(machine.campaign(tmp_path, table, diagnosis=FEW))
    ((kind, where, row),) = happened(found)
    assert (kind, where) == ("shift", "world_base")
    assert 79 <= row <= 85
    assert found.verdict == "noise_floor"
    spoiled = table.copy()
    spoiled.loc[held_out, "x"] += 5e-4
    again = searched(machine.campaign(tmp_path, spoiled, diagnosis=FEW))
    assert happened(again) == happened(found)
    np.testing.assert_array_equal(again.fit.theta, found.fit.theta)
    assert again.verdict == "structure_remains"


def test_several_files_are_counted_on_and_a_row_is_named_with_its_file(tmp_path: Path) -> None:
    machine = Machine(12, [(100, "world_base", KNOCK)])
    table = machine.table()
    table[:60].to_csv(tmp_path / "a.csv", index=False)
    table[60:].to_csv(tmp_path / "b.csv", index=False)
    found = searched(machine.campaign(tmp_path, table, measurements={"file": ["a.csv", "b.csv"]}, diagnosis=FEW))
    (effect,) = found.effects
    assert effect.at is not None
    at = moment(effect.at, found.rows)
    assert at["file"] == "b.csv"
    assert abs(at["row"] - 42) <= 2


def test_a_column_that_is_called_like_the_order_of_rows_is_no_covariate(tmp_path: Path) -> None:
    machine = Machine(13, [], 40)
    table = machine.table()
    table["file row"] = np.arange(40.0)[::-1]
    campaign = load_campaign(machine.campaign(tmp_path, table))
    robot = robots.ur10()
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds)
    assert rows.covariates == {}
    np.testing.assert_array_equal(rows.conditions["file row"], rows.origin.line)
    assert any("rename the column" in str(notice) for notice in rows.origin.notices)


def test_the_simulator_makes_shifts_that_are_found(tmp_path: Path) -> None:
    """Half way where no row is said; the truth in the files says where it was."""
    truth = {
        "n": 120, "noise": {"position": SIGMA, "rotation": SIGMA},
        "effects": [
            {"kind": "shift", "where": "tip_target", "at": {"row": 42}, "coefficients": [3e-4, 0, 0, 0, 3e-4, 0]},
            {"kind": "shift", "where": LEVER, "coefficients": 5e-4},
        ],
    }  # fmt: skip
    robot = {"urdf": str(robots.URDF / "ur10.urdf"), "base": "base_link", "tip": "tool0"}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump({"format": 1, "robot": robot, "truth": truth}))
    assert simulate([str(tmp_path / "s.yaml"), "-o", str(tmp_path / "made")]) == 0
    told = json.loads((tmp_path / "made" / "truth.json").read_text())["effects"]
    assert [e["at"] for e in told] == [{"row": 42}, {"row": 62}]
    found = happened(searched(tmp_path / "made" / "campaign.yaml"))
    assert [(kind, where) for kind, where, _ in found] == [("shift", "tip_target"), ("shift", LEVER)]
    assert abs(found[0][2] - 42) <= 2
    assert abs(found[1][2] - 62) <= 2
