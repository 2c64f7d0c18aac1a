"""What `benchmarks/peers.py` gives to other tools is the same robot, the same rows and the same question."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import peer_tools
import peers
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import load_robot


def places_by_table(files: dict[str, np.ndarray], q: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
    """Places of the target by the modified table as pybotics multiplies it out, shape (N, 3); constants first, then frames."""
    change = np.zeros(33) if change is None else change
    table = files["mdh"] + change[:24].reshape(6, 4)
    twist = np.eye(4)
    twist[:3, :3], twist[:3, 3] = Rotation.from_rotvec(change[27:30]).as_matrix(), change[24:27]
    tool = files["mdh_tool"].copy()
    tool[:3, 3] += change[30:]
    made = []
    for row in q:
        T = twist @ files["mdh_world"]
        for (alpha, a, theta, d), angle in zip(table, row, strict=True):
            x, z = np.eye(4), np.eye(4)
            x[:3, :3], x[0, 3] = Rotation.from_euler("x", alpha).as_matrix(), a
            z[:3, :3], z[2, 3] = Rotation.from_euler("z", theta + angle).as_matrix(), d
            T = T @ x @ z
        made.append((T @ tool)[:3, 3])
    return np.array(made)


def test_every_tool_is_given_the_same_robot_and_the_same_rows(tmp_path: Path) -> None:
    rows = peers.simulated(20, 5)
    peers.write(rows, tmp_path)
    files = dict(np.load(tmp_path / "rows.npz"))
    base, target = peers.SIMULATED_FRAMES
    nominal = Model(rows.robot, (), ((None, base),), ((None, target),))
    R, p = nominal.poses(np.zeros(0), nominal.rows(files["readings"]))

    turned = load_robot(tmp_path / "along_z.urdf", "target")
    other = Model(turned, (), ((None, base),), ((None, pin.SE3.Identity()),))
    R_z, p_z = other.poses(np.zeros(0), other.rows(files["readings"]))
    assert all(np.array_equal(joint.axis, [0, 0, 1]) for joint in turned.joints)
    assert np.abs(p_z - p).max() < 1e-12 and np.abs(R_z - R).max() < 1e-12
    assert np.abs(places_by_table(files, files["readings"]) - p).max() < 1e-9

    figaroh = np.loadtxt(tmp_path / "figaroh.csv", delimiter=",", skiprows=1)
    assert np.allclose(figaroh[:, :3], files["position"], rtol=0, atol=1e-15) and len(figaroh) == 20
    assert np.allclose(figaroh[:, 6:], files["readings"], rtol=0, atol=1e-15)
    ours = np.loadtxt(tmp_path / "measurements.csv", delimiter=",", skiprows=1, usecols=range(13))
    assert np.allclose(ours[:20, 6:9], files["position"], rtol=0, atol=1e-15) and len(ours) == 25


def test_pybotics_is_asked_for_all_that_positions_can_tell_and_for_nothing_else(tmp_path: Path) -> None:
    """By singular values of differences: the mask keeps the rank of all 33 numbers, and has no column to spare."""
    rows = peers.simulated(60, 1)
    peers.write(rows, tmp_path)
    files = dict(np.load(tmp_path / "rows.npz"))
    step = 1e-6 * np.eye(33)
    columns = [
        (places_by_table(files, files["readings"], s) - places_by_table(files, files["readings"], -s)).ravel() / 2e-6
        for s in step
    ]
    asked = np.concatenate([files["mdh_mask"].ravel(), np.ones(9, dtype=bool)])
    everything, kept = (np.linalg.svd(np.array(c).T, compute_uv=False) for c in (columns, np.array(columns)[asked]))
    assert asked.sum() == (everything > 1e-6).sum() == (kept > 1e-6).sum() == 25


def test_ours_runs_as_the_others_do_and_errors_are_those_of_held_out_rows(tmp_path: Path) -> None:
    rows = peers.simulated(60, 20)
    peers.write(rows, tmp_path)
    assert peer_tools.main(["aridcal", str(tmp_path)]) == 0
    told = json.loads((tmp_path / "aridcal.json").read_text())
    assert told["said"] == "60 rows" and told["unknowns"] == 30
    mm, mrad = peers.errors(rows, tmp_path, "aridcal")
    assert 0.1 < mm < 0.4 and 0.1 < mrad < 0.4  # 0.17 is the noise alone
    np.savez(
        tmp_path / "aridcal.npz",
        position=rows.data.position[rows.data.test] + [3e-3, 4e-3, 0],
        rotation=np.zeros((0, 3, 3)),
    )
    mm, mrad = peers.errors(rows, tmp_path, "aridcal")
    assert abs(mm - 5.0) < 1e-9 and np.isnan(mrad)
