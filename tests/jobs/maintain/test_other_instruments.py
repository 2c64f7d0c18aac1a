"""`check` and `recalibrate` with rows of other instruments than the calibration's, of which nobody knows where they stand."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
import yaml
from calibrated import NOISE, Machine, by_instruments, jump, machine
from simulated_instruments import EYE

from aridcal.__main__ import main
from aridcal.engine.model.model import ONE_FRAME
from aridcal.files.campaign import Frames
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.jobs.maintain.checking import CheckResult, check
from aridcal.jobs.maintain.new_rows import read_new_rows
from aridcal.jobs.maintain.repair import changes, repair_calibration
from aridcal.system.errors import AridcalError

NAMES = robots.ur10().readings
ON_TIP = {"cameras": {"eye": EYE | {"xyz": [0.05, 0.0, 0.02], "rpy": [0.1, -0.1, 1.0]}}}


@cache
def ur10() -> Machine:
    return machine(3)


def asked(folder: Path, kinds: list[str], offset: np.ndarray | float = 0.0, **more: object) -> CheckResult:
    new = read_new_rows(ur10().saved, by_instruments(ur10(), folder, kinds, offset, **more))
    return check(ur10().saved, new.rows, frames=new.frames)


CASES: dict[str, tuple[list[str], object]] = {
    "point": (["point"], None),
    "distance": (["distance"], None),
    "plane": (["plane"], None),
    "camera beside": (["pixels"], {"cameras": {"eye": EYE | {"on": "world"}}}),
    "two": (["distance", "inclination"], None),
}


@pytest.mark.parametrize("name", CASES)
def test_a_zero_that_jumped_is_named_whatever_measures_it(name: str, tmp_path: Path) -> None:
    kinds, instruments = CASES[name]
    n = 8 if "pixels" in kinds else 20
    good = asked(tmp_path, kinds, instruments=instruments, n=n)
    assert good.good
    assert {s.where for s in good.unseen} >= ({"shoulder_pan_joint"} if kinds != ["distance", "inclination"] else set())
    found = asked(tmp_path, kinds, jump(2, 2e-3), instruments=instruments, n=n)
    assert [(c.kind, c.where) for c in found.causes] == [("zero", "elbow_joint")]
    (change,) = changes(found)
    assert change.value[0] == pytest.approx(2e-3, abs=4 * change.std[0])
    assert change.std[0] < 3e-4
    assert found.rest.p_value > FALSE_ALARMS


def test_three_parallel_axes_look_alike_to_a_level_and_a_pose_is_named_that_tells(tmp_path: Path) -> None:
    (cause,) = asked(tmp_path, ["inclination"], jump(1, 2e-3)).causes
    words = [cause.words, *cause.alike]
    assert {f"the zero of {name}" for name in NAMES[1:4]} <= set(words)
    assert cause.telling
    low, high = np.array([ur10().saved.ranges[name] for name in NAMES]).T
    assert all(np.all((low <= told.readings) & (told.readings <= high)) for told in cause.telling)


@pytest.mark.parametrize("kind", ["point", "distance", "plane"])
def test_what_nobody_knew_takes_up_as_many_numbers_as_it_has(kind: str, tmp_path: Path) -> None:
    """The squares that are left are as many as are counted: else alarms would be too few or too many."""
    new = read_new_rows(ur10().saved, by_instruments(ur10(), tmp_path, [kind], n=150))
    rng, squares, numbers, alarms = np.random.default_rng(0), 0.0, 0, 0
    for _ in range(6):
        rows = new.rows.select(rng.choice(len(new.rows), 30, replace=False))
        found = check(ur10().saved, rows, frames=new.frames).first
        squares, numbers, alarms = (
            squares + found.squares,
            numbers + found.numbers,
            alarms + (found.p_value < FALSE_ALARMS),
        )
    assert squares / numbers == pytest.approx(1.0, abs=4 * np.sqrt(2 / numbers) + 0.02)
    assert alarms <= 2


def test_unknown_markers_and_a_camera_take_up_as_many_numbers_as_they_have(tmp_path: Path) -> None:
    """The same of whole images: a marker that is seen once says nothing."""
    new = read_new_rows(ur10().saved, by_instruments(ur10(), tmp_path, ["pixels"], n=30, instruments=ON_TIP))
    image = np.unique(new.rows.readings, axis=0, return_inverse=True)[1]
    rng, squares, numbers = np.random.default_rng(0), 0.0, 0
    for _ in range(4):
        rows = new.rows.select(np.isin(image, rng.choice(image.max() + 1, 8, replace=False)))
        found = check(ur10().saved, rows, frames=new.frames).first
        squares, numbers = squares + found.squares, numbers + found.numbers
    assert squares / numbers == pytest.approx(1.0, abs=4 * np.sqrt(2 / numbers) + 0.02)


# -- tools and bases


def retooled(folder: Path, tool: pin.SE3, kinds: list[str], frames: object, **truth: object) -> Path:
    """What was measured with another tool on the same machine, in a campaign that says which frames are new."""
    m = ur10()
    path = by_instruments(replace(m, model=replace(m.model, tip_target=((None, tool),))), folder, kinds, **truth)
    keys = yaml.safe_load(path.read_text())
    keys["frames"] = frames
    path.write_text(yaml.safe_dump(keys))
    return path


def test_a_tool_is_known_from_one_point_touched_in_several_attitudes(tmp_path: Path) -> None:
    """By a second road: the tool's tip is where p + R t is one place for all touches."""
    m = ur10()
    tool = m.model.tip_target[0][1] * pin.SE3(pin.exp3(np.array([0.2, -0.4, 0.1])), np.array([0.03, -0.11, 0.25]))
    path = retooled(tmp_path, tool, ["point"], {"tip_target": {"identify": True}}, n=30)
    table = robots.read_csv(tmp_path / "measurements_1.csv")
    one = table[table["point"] == table["point"].mode()[0]][:10]
    one.to_csv(tmp_path / "measurements_1.csv", index=False, float_format="%.17g")
    new = read_new_rows(m.saved, path)
    found = repair_calibration(m.saved, check(m.saved, new.rows, frames=new.frames))
    (change,) = found.changes
    assert (change.cause.kind, change.cause.where) == ("new", "tip_target")
    assert change.names == ("tip_target.x", "tip_target.y", "tip_target.z")  # of its turns a point tells nothing

    flange = replace(m.model, tip_target=ONE_FRAME)
    R, p = flange.poses(m.theta, flange.rows(one[list(NAMES)].to_numpy()))
    A = np.concatenate([R, -np.broadcast_to(np.eye(3), R.shape)], axis=2).reshape(-1, 6)
    other = np.linalg.lstsq(A, -p.ravel(), rcond=None)[0][:3]
    before = m.model.tip_target[0][1]
    for place in (tool.translation, other):
        assert np.abs(change.value - before.actInv(place)).max() < 4 * change.std.max() < 1e-3
    old, now = (dict(saved.final.model.tip_target)[None].rotation for saved in (m.saved, found.saved))
    np.testing.assert_allclose(now, old, atol=NOISE)
    kept = [c.where != "tip_target" for c in m.saved.final.model.coefficients]
    index = {c: k for k, c in enumerate(found.saved.final.model.coefficients)}
    after = found.saved.final.theta[[index[c] for c in m.saved.final.model.coefficients]]
    assert np.abs(after - m.saved.final.theta)[kept].max() < 1e-3
    both = found.saved.geometric.model.tip_target[0][1], found.saved.final.model.tip_target[0][1]
    np.testing.assert_allclose(both[0].homogeneous, both[1].homogeneous, atol=1e-9)


def test_a_base_that_is_called_new_is_fitted_alone(tmp_path: Path) -> None:
    m = ur10()
    base = pin.SE3(pin.exp3(np.array([1.0, 2.0, -0.5])), np.array([3.0, -1.0, 0.5]))
    moved = replace(m, model=replace(m.model, world_base=((None, base),)))
    path = by_instruments(moved, tmp_path, ["position"], n=8)
    assert not check(m.saved, read_new_rows(m.saved, path).rows, frames=read_new_rows(m.saved, path).frames).good
    path.write_text(path.read_text() + "frames: {world_base: {identify: true}}\n")
    new = read_new_rows(m.saved, path)
    found = check(m.saved, new.rows, frames=new.frames)
    assert found.good  # the arm is as it was
    mended = repair_calibration(m.saved, found)
    (change,) = mended.changes
    assert (change.cause.kind, change.cause.where, len(change.names)) == ("new", "world_base", 6)
    was, now = (saved.final.model.world_base[0][1] for saved in (m.saved, mended.saved))
    off = pin.log6((base * m.model.world_base[0][1].inverse()).inverse() * now * was.inverse())
    assert np.linalg.norm(off.angular) < 2e-4 and np.linalg.norm(off.linear) < 6e-4  # metres from the world's origin
    assert check(mended.saved, new.rows).good


def test_other_targets_are_fitted_with_their_rows(tmp_path: Path) -> None:
    """Rows of the calibrated target and of one on a longer tool; the second alone tells nothing of the first."""
    m = ur10()
    tool = m.model.tip_target[0][1] * pin.SE3(np.eye(3), np.array([0.0, 0.05, 0.2]))
    path = retooled(tmp_path, tool, ["position"], {}, n=12)
    long = robots.read_csv(tmp_path / "measurements_1.csv").assign(target="long")
    long["wrist_1_joint"] -= 1e-3
    by_instruments(m, tmp_path, ["position"], jump(3, 1e-3), n=12, seed=9)
    own = robots.read_csv(tmp_path / "measurements_1.csv").assign(target="target")
    pd.concat([own, long]).to_csv(tmp_path / "measurements_1.csv", index=False, float_format="%.17g")
    new = read_new_rows(m.saved, path)
    found = check(m.saved, new.rows, frames=new.frames)
    assert [(c.kind, c.where) for c in found.causes] == [("zero", "wrist_1_joint")]
    mended = repair_calibration(m.saved, found)
    assert [label for label, _ in mended.saved.final.model.tip_target] == [None]
    assert mended.changes[0].value[0] == pytest.approx(1e-3, abs=4 * mended.changes[0].std[0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("frames: {world_base: {per: station}}", "delete this key"),
        ("robot: {urdf: x.urdf, tip: wrist_3_link}", "delete the key `robot`"),
        ("frames: {nowhere: {}}", "frames.nowhere"),
        ("instruments: {lengths: [{between: [a, b], length: 0.1}]}", "delete this key"),
    ],
)
def test_a_campaign_of_new_rows_that_cannot_be_read_says_what_to_do(change: str, said: str, tmp_path: Path) -> None:
    path = by_instruments(ur10(), tmp_path, ["point"])
    path.write_text(f"{path.read_text()}{change}\n")
    with pytest.raises(AridcalError, match=said):
        read_new_rows(ur10().saved, path)


def test_noise_that_nobody_stated_is_asked_for(tmp_path: Path) -> None:
    path = by_instruments(ur10(), tmp_path, ["distance"])
    keys = yaml.safe_load(path.read_text())
    del keys["measurements"][0]["noise"]
    path.write_text(yaml.safe_dump(keys))
    with pytest.raises(AridcalError, match=r"noise: \{distance: SIGMA\}"):
        check(ur10().saved, read_new_rows(ur10().saved, path).rows, frames=Frames())


def test_a_calibration_of_several_targets_is_checked_and_mended_with_rows_of_them(tmp_path: Path, capsys) -> None:
    m = machine(8)
    tools = {
        "a": m.model.tip_target[0][1],
        "b": m.model.tip_target[0][1] * pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.2])),
    }

    def rows(n: int, offset: np.ndarray | float = 0.0, moved: float = 0.0) -> pd.DataFrame:
        parts = []
        for label, tool in tools.items():
            shift = pin.SE3(np.eye(3), np.array([0.0, moved if label == "b" else 0.0, 0.0]))
            own = replace(m, model=replace(m.model, tip_target=((None, tool * shift),)))
            measured = own.measured(own.configurations(n), offset)
            parts.append(robots.table(robots.Truth(own.model, own.theta, measured)).assign(target=label))
        return pd.concat(parts)

    (tmp_path / "robot.urdf").write_bytes(m.model.robot.urdf)
    rows(50).to_csv(tmp_path / "rows.csv", index=False, float_format="%.17g")
    campaign = {
        "format": 1,
        "robot": {"urdf": "robot.urdf", "tip": "tool0"},
        "measurements": {"file": "rows.csv"},
        "diagnosis": {"enabled": False},
    }
    (tmp_path / "campaign.yaml").write_text(yaml.safe_dump(campaign))
    (tmp_path / "calibration.yaml").write_text(calibration(identify(tmp_path / "campaign.yaml")).dump())
    new = tmp_path / "new.csv"
    for table, status, said in (
        (rows(6), 0, "still good"),
        (rows(6, jump(2, 1e-3)), 3, "moved: the zero of elbow_joint, by +"),
        (rows(6, moved=1e-3), 3, "moved: the target b, by "),
        (rows(6).drop(columns="target"), 2, "add a column `target`"),
    ):
        table.to_csv(new, index=False, float_format="%.17g")
        assert main(["check", str(tmp_path), str(new)]) == status
        out = capsys.readouterr()
        assert said in out.out + out.err
    rows(8, moved=1e-3).to_csv(new, index=False, float_format="%.17g")
    assert main(["recalibrate", str(tmp_path), str(new), "-o", str(tmp_path / "out")]) == 0
    assert "is not drawn" not in capsys.readouterr().out
    before, after = (dict(SavedModel.load(p).final.model.tip_target) for p in (tmp_path, tmp_path / "out"))
    np.testing.assert_allclose((before["b"].inverse() * after["b"]).translation, [0.0, 1e-3, 0.0], atol=1e-4)
    np.testing.assert_allclose(before["a"].homogeneous, after["a"].homogeneous, atol=1e-4)
    assert main(["check", str(tmp_path / "out"), str(new)]) == 0
