"""Positioners, moving platforms, plates on links, tables of two arms: calibrated to the noise, what no row tells named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cells
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import two_arms
import yaml
from scipy.spatial.transform import Rotation

import aridcal
from aridcal import identify
from aridcal.system.errors import AridcalError

LIMIT = 1.3
"""Held-out errors of a fifth of 200 rows or more scatter by less."""

XYZ = ["x", "y", "z"]
STD = ["std_x", "std_y", "std_z"]
OF_ONE_CALIBRATION = 2.0
"""Errors of one calibration over its own sigmas are alike at all rows: some ten combinations of constants make them up, whose RMS
is above 2 in one calibration of 50,000 (chi-square of 10 above 40)."""

TARGET = pin.SE3(pin.exp3(np.array([0.1, 0.2, -0.1])), cells.FINGER)
SPOTS = 0.1 * np.array([[0, 0, 0], [1, 0, 0.2], [0, 1, 0], [-1, 0, 0], [0, -1, 0.4]])
NORMAL = np.array([0.05, -0.1, 1.0]) / np.linalg.norm([0.05, -0.1, 1.0])


def positioner() -> tuple[bytes, two_arms.Machine]:
    """An arm, and a table that tilts and turns before it."""
    axes = [cells.Moves("revolute", "0 1 0", "0.55 0 0.2"), cells.Moves("revolute", "0 0 1", "0 0 0.1")]
    text = cells.urdf("cell", [("arm", "cell", cells.arm("0 0 0.3"), "flange"), ("turn", "cell", axes, "plate")])
    return text, cells.as_built(text, "cell", ("flange", "plate"))


def platform() -> tuple[bytes, two_arms.Machine]:
    """An arm on a platform that drives along two rails and turns."""
    rails = [
        cells.Moves("prismatic", "1 0 0", "0 0 0.1"),
        cells.Moves("prismatic", "0 1 0", "0 0 0.05"),
        cells.Moves("revolute", "0 0 1", "0 0 0.05"),
    ]
    text = cells.urdf("floor", [("drive", "floor", rails, "deck"), ("arm", "deck", cells.arm("0 0 0.3"), "flange")])
    return text, cells.as_built(text, "floor", ("flange",))


def at_the_noise(found: aridcal.Calibration, channel: str) -> None:
    """Nothing invented, and rows that were held out as far off as they were measured."""
    assert found.result["verdict"] == "noise_floor" and found.effects.empty
    numbers = 1.0 if channel == "distance" else 3.0
    ratio = found.errors.loc["final"].loc["test"][f"{channel}_rms_mm"] / (np.sqrt(numbers) * 1e3 * cells.SIGMA)
    assert 1.0 / LIMIT < ratio < LIMIT


def noticed(found: aridcal.Calibration, of: str, against: str) -> bool:
    """Whether the result says that constants of joints cannot be told from those of other places."""
    said = [notice.partition(" cannot be told from ") for notice in found.result["notices"]]
    return any(of in former and against in latter.partition(":")[0] for former, _, latter in said)


def test_a_tracker_sees_what_moves_under_the_tip_and_the_tip(tmp_path: Path) -> None:
    """A target on the platform and one on the tip, in turn: where both are to each other, by Pinocchio."""
    (text, machine), base, moved = platform(), "floor", "deck"
    rng = np.random.default_rng(1)
    q, side = rng.uniform(-1.1, 1.1, (180, len(machine.joints))), np.where(np.arange(180) % 2, moved, "tool")

    def targets(q: np.ndarray) -> dict[str, list[pin.SE3]]:
        return {
            name: [T * TARGET for T in machine.seen(q, base, link)]
            for name, link in ((moved, moved), ("tool", "flange"))
        }

    there = targets(q)
    table = machine.table(
        q, target=side, **cells.tracked([there[name][k] for k, name in enumerate(side.tolist())], rng)
    )
    for joint in machine.joints:
        if joint.startswith("arm"):
            table[joint] = table[joint].where(side == "tool")  # not recorded where it is on no row's path
    noise = {"position": cells.SIGMA, "rotation": cells.SIGMA}
    path = cells.write(
        tmp_path, text, {"base": base, "tip": "flange"}, {"tracker": table},
        measurements={"kind": "pose", "file": "tracker.csv", "noise": noise},
        instruments={"targets": {moved: {"on": moved}, "tool": {"on": "flange"}}},
    )  # fmt: skip
    found = aridcal.calibrate(path)
    at_the_noise(found, "position")
    others = rng.uniform(-1.0, 1.0, (50, len(machine.joints)))
    told = [
        found.predict(machine.table(others, target=np.full(50, name)))[XYZ].to_numpy(float) for name in (moved, "tool")
    ]
    real = [np.array([T.translation for T in places]) for places in targets(others).values()]
    apart = [np.linalg.norm(one - other, axis=1) for one, other in (told, real)]
    np.testing.assert_allclose(*apart, rtol=0, atol=3e-4)
    assert np.sqrt(np.mean((apart[0] - apart[1]) ** 2)) < 1e-4
    assert noticed(found, "drive_j1 (below flange and deck)", "world_base")


def test_a_finger_touches_a_workpiece_on_a_positioner(tmp_path: Path) -> None:
    """Five spots of known places on its table, which tilts and turns."""
    text, machine = positioner()
    rng = np.random.default_rng(1)
    label, error = np.arange(400) % len(SPOTS), rng.normal(0, cells.SIGMA, (400, 3))

    def off(q: np.ndarray, k: np.ndarray) -> np.ndarray:
        fingers = np.array([T.act(cells.FINGER) for T in machine.seen(q, "plate", "flange")])
        return np.asarray(fingers - SPOTS[label[k]] - error[k])

    q, good = cells.met(machine, rng.uniform(-1.1, 1.1, (400, len(machine.joints))), off)
    assert good.sum() > 120
    table = machine.table(q[good], point=label[good].astype(str))
    spots = pd.DataFrame(SPOTS, columns=XYZ).assign(point=[str(k) for k in range(len(SPOTS))])
    path = cells.write(
        tmp_path, text, {"base": "cell", "tip": "flange"}, {"touch": table, "spots": spots},
        measurements={"kind": "point", "file": "touch.csv", "target": "finger", "noise": {"position": cells.SIGMA}},
        instruments={
            "points": {"file": "spots.csv", "on": "plate"},
            "targets": {"finger": {"on": "flange", "xyz": cells.FINGER.tolist()}},
        },
    )  # fmt: skip
    found = aridcal.calibrate(path)
    at_the_noise(found, "position")
    assert noticed(found, "turn_j1 (limb to plate)", "arm_j1 (limb to flange)")


@pytest.mark.parametrize("on", ["right_hand", "torso"])
def test_fingers_touch_a_plate_on_the_other_hand_or_one_table(on: str, tmp_path: Path) -> None:
    """A plate that the right hand holds, touched by the left; or a table, touched by both, each row with its own arm's joints."""
    machine, rng = two_arms.Machine(two_arms.machine().model, shoulders=()), np.random.default_rng(1)
    fingers: dict[str, Any] = {"left": two_arms.LEFT} | ({"right": two_arms.RIGHT} if on == "torso" else {})
    side, error = np.array([*fingers])[np.arange(300) % len(fingers)], rng.normal(0, cells.SIGMA, 300)

    def off(q: np.ndarray, k: np.ndarray) -> np.ndarray:
        height = {
            name: np.array([T.act(own) for T in machine.seen(q, on, f"{name}_hand")]) @ NORMAL
            for name, own in fingers.items()
        }
        met = np.array([height[name][row] for row, name in enumerate(side[k].tolist())])
        return np.asarray(met - 0.09 - error[k])[:, None]

    q, good = cells.met(machine, rng.uniform(-1.1, 1.1, (300, len(machine.joints))), off)
    assert good.sum() > 240
    table = machine.table(q[good], target=side[good])
    for joint in machine.joints if on == "torso" else ():
        table[joint] = table[joint].where(table["target"] == joint.partition("_")[0])
    path = cells.write(
        tmp_path, two_arms.urdf(), {"base": "torso", "tip": "left_hand"}, {"touch": table},
        measurements={"kind": "plane", "file": "touch.csv", "noise": {"distance": cells.SIGMA}},
        instruments={
            "planes": {"plate": {"on": on, "normal": [0, 0, 1], "offset": 0.08}},
            "targets": {name: {"on": f"{name}_hand", "xyz": own.tolist()} for name, own in fingers.items()},
        },
        diagnosis={"enabled": on == "right_hand"},
    )  # fmt: skip
    found = aridcal.calibrate(path)
    at_the_noise(found, "distance")
    assert noticed(found, "right_j1 (limb to right_hand)", "left_j1 (limb to left_hand)")


STATIONS = {
    "north": pin.SE3(Rotation.from_rotvec([0.3, -0.2, 2.0]).as_matrix(), np.array([2.0, -1.0, 0.5])),
    "south": pin.SE3(Rotation.from_rotvec([0.0, 0.1, -1.0]).as_matrix(), np.array([-1.5, 2.5, 0.3])),
}


def moved_tracker(folder: Path, touches: bool, search: bool = False, n: int = 300) -> tuple[Path, two_arms.Machine]:
    """A tracker that sees the targets of a positioner and of an arm from two places, and perhaps touches of a finger."""
    text, machine = positioner()
    rng, links = np.random.default_rng(2), {"turntable": "plate", "tool": "flange"}
    q = rng.uniform(-1.1, 1.1, (n, len(machine.joints)))
    target = np.where(np.arange(n) % 2, "turntable", "tool")
    station = np.where(np.arange(n) < n // 2, "north", "south")
    seen = {name: machine.seen(q, "cell", link) for name, link in links.items()}
    places = [
        STATIONS[s].act(seen[t][k].act(cells.FINGER)) for k, (s, t) in enumerate(zip(station, target, strict=True))
    ]
    read = np.array(places) + rng.normal(0, cells.SIGMA, (n, 3))
    tables = {"tracker": machine.table(q, target=target, station=station, **dict(zip(XYZ, read.T, strict=True)))}
    noise = {"position": cells.SIGMA}
    blocks: list[dict[str, Any]] = [{"kind": "position", "file": "tracker.csv", "noise": noise}]
    things: dict[str, Any] = {
        "targets": {name: {"on": link, "xyz": (cells.FINGER + 0.01).tolist()} for name, link in links.items()}
    }
    if touches:
        label = np.arange(n) % len(SPOTS)

        def off(q: np.ndarray, k: np.ndarray) -> np.ndarray:
            fingers = np.array([T.act(cells.FINGER) for T in machine.seen(q, "plate", "flange")])
            return np.asarray(fingers - SPOTS[label[k]] - error[k])

        error = rng.normal(0, cells.SIGMA, (n, 3))
        there, good = cells.met(machine, rng.uniform(-1.1, 1.1, (n, len(machine.joints))), off)
        tables["touch"] = machine.table(there[good], point=label[good].astype(str), target="tool")
        tables["spots"] = pd.DataFrame(SPOTS, columns=XYZ).assign(point=[str(k) for k in range(len(SPOTS))])
        blocks.append({"kind": "point", "file": "touch.csv", "noise": dict(noise)})
        things["points"] = {"file": "spots.csv", "on": "plate"}
    keys: dict[str, Any] = {"measurements": blocks if touches else blocks[0], "instruments": things}
    keys["diagnosis"] = {"enabled": search}
    frames = {"world_base": {"per": "station"}}
    robot = {"base": "cell", "tip": "flange"}
    return cells.write(folder, text, robot, tables, frames=frames, **keys), machine


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> tuple[aridcal.Calibration, two_arms.Machine]:
    """Calibrated with the tracker alone."""
    path, machine = moved_tracker(tmp_path_factory.mktemp("moved"), False, search=True)
    return aridcal.calibrate(path), machine


def test_a_tracker_that_was_moved_sees_the_targets_of_two_limbs(
    moved: tuple[aridcal.Calibration, two_arms.Machine],
) -> None:
    """Predictions of either target at either station are Pinocchio's."""
    found, machine = moved
    at_the_noise(found, "position")
    assert noticed(found, "turn_j1 (limb to plate)", "world_base")
    rng = np.random.default_rng(3)
    others = rng.uniform(-1.0, 1.0, (60, len(machine.joints)))
    for name, link in (("turntable", "plate"), ("tool", "flange")):
        for station, T in STATIONS.items():
            table = machine.table(others, target=np.full(60, name), station=np.full(60, station))
            predicted = found.predict(table)
            real = np.array([T.act(place.act(cells.FINGER)) for place in machine.seen(others, "cell", link)])
            off = (predicted[XYZ].to_numpy(float) - real) / predicted[STD].to_numpy(float)
            assert np.sqrt(np.mean(off**2)) < OF_ONE_CALIBRATION, (name, station)
    bare = machine.table(others, target=np.full(60, "tool"))
    with pytest.raises(AridcalError, match="station"):
        found.predict(bare)


def test_a_moved_tracker_s_limbs_are_checked_and_commanded_at_a_station(
    moved: tuple[aridcal.Calibration, two_arms.Machine], tmp_path: Path
) -> None:
    """A commanded pose of the tool at the second station is reached by the real arm; a moved tracker is noticed."""
    found, machine = moved
    found.save(tmp_path / "results")
    found = aridcal.load(tmp_path / "results")
    rng = np.random.default_rng(5)
    q = rng.uniform(-0.8, 0.8, (12, len(machine.joints)))
    south = STATIONS["south"]
    read = np.array([south.act(T.act(cells.FINGER)) for T in machine.seen(q, "cell", "flange")])
    table = machine.table(q, target="tool", station="south", **dict(zip(XYZ, read.T, strict=True)))
    commands = found.compensate(table)
    reached = commands[list(machine.joints)].to_numpy(float)
    real = np.array([south.act(T.act(cells.FINGER)) for T in machine.seen(reached, "cell", "flange")])
    std = found.predict(machine.table(reached, target="tool", station="south"))[STD].to_numpy(float)
    assert np.sqrt(np.mean(((real - read) / std) ** 2)) < OF_ONE_CALIBRATION
    noisy = table.assign(**{name: table[name] + rng.normal(0, cells.SIGMA, 12) for name in XYZ})
    assert found.check(noisy).good
    assert not found.check(noisy.assign(x=noisy["x"] + 0.003)).good


def test_targets_that_are_known_stay_where_they_are_stated(tmp_path: Path) -> None:
    """One of two is known: it is taken as exact, and the other, of which a hint is a centimetre off, is found."""
    path, _ = moved_tracker(tmp_path, False)
    campaign = yaml.safe_load(path.read_text())
    campaign["instruments"]["targets"]["tool"] |= {"xyz": cells.FINGER.tolist(), "identify": False}
    path.write_text(yaml.safe_dump(campaign, sort_keys=False))
    found = aridcal.calibrate(path)
    at_the_noise(found, "position")
    placed = {label: T.translation for label, T in found.model.final.model.tip_target}
    np.testing.assert_array_equal(placed["tool"], cells.FINGER)
    off = np.linalg.norm(placed["turntable"] - cells.FINGER)
    assert 0.0 < off < 5e-3, "the turntable's own constants may take up what 1 mm and 1 mrad make of it"


def with_split(folder: Path, **split: str) -> Path:
    """Rows of a moved tracker, of touches, and a split of the tracker's that depends on the station."""
    path, _ = moved_tracker(folder, True, n=120)
    table = pd.read_csv(folder / "tracker.csv")
    table.assign(split=table["station"].map(split)).to_csv(folder / "tracker.csv", index=False)
    return path


def test_a_station_with_held_out_rows_alone_is_refused(tmp_path: Path) -> None:
    """The table says so itself; that touches have no split of their own changes nothing."""
    with pytest.raises(AridcalError, match="station 'south' has only `test` rows"):
        aridcal.calibrate(with_split(tmp_path, north="train", south="test"))


@pytest.mark.filterwarnings("error")
def test_figures_are_those_of_the_blocks_with_held_out_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tracker's table keeps all its rows for training: no error of it is known, and none is shown.

    Touches from limb to limb need no station beside it.
    """
    path = with_split(tmp_path, north="train", south="train")
    assert identify.main([str(path), "-o", str(tmp_path / "results")]) == 0
    said = capsys.readouterr().out
    assert "nan" not in said and "point_position RMS" in said and "position_position RMS" not in said
    report = (tmp_path / "results" / "report.html").read_text()
    assert "on 0 held-out rows" not in report


def test_a_target_that_no_key_names_beside_others_is_said_to_be_on_the_tip(tmp_path: Path) -> None:
    """It may be a slip of the pen: the nearest name is given."""
    path, _ = moved_tracker(tmp_path, False, n=120)
    table = pd.read_csv(tmp_path / "tracker.csv")
    table.loc[::11, "target"] = table.loc[::11, "target"].replace("tool", "tol")
    table.to_csv(tmp_path / "tracker.csv", index=False)
    notices = [notice for notice in aridcal.calibrate(path).result["notices"] if "'tol'" in notice]
    assert len(notices) == 1 and "did you mean 'tool'" in notices[0] and "on the tip, flange" in notices[0]
