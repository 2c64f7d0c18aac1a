"""Campaigns proposed for robots of several limbs: nothing is typed, and they are identified as they are."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import two_arms
import yaml
from two_arms import readings

import aridcal
import aridcal.init
from aridcal.engine.fit.constants import urdf_of

ROBOT = two_arms.machine()
LIMIT = 1.3
"""As in test_trees: held-out errors of a tenth of some rows scatter by less."""


def proposed(folder: Path, table: pd.DataFrame, *more: str) -> dict:
    (folder / "two_arms.urdf").write_bytes(two_arms.urdf())
    table.to_csv(folder / "table.csv", index=False)
    out = folder / "campaign.yaml"
    words = [
        "--urdf",
        str(folder / "two_arms.urdf"),
        "--measurements",
        str(folder / "table.csv"),
        "-o",
        str(out),
        *more,
    ]
    assert aridcal.init.main(words) == 0
    return yaml.safe_load(out.read_text())


def tracked(n: int = 160, labels: dict[str, str] | None = None, every_joint: bool = False) -> pd.DataFrame:
    """What a tracker read of both hands in turn, in mm and degrees."""
    q = readings(ROBOT, n)
    table = two_arms.tracker(ROBOT, q, np.random.default_rng(1))[0]
    if every_joint:
        table[ROBOT.joints] = q
    table[ROBOT.joints] = np.degrees(table[ROBOT.joints])
    table[["x", "y", "z"]] *= 1e3
    return table.replace({"target": labels or {"left": "left_hand", "right": "right_hand"}})


def test_a_table_of_two_hands_is_proposed_and_identified_without_a_word_typed(tmp_path: Path) -> None:
    campaign = proposed(tmp_path, tracked())
    assert campaign["robot"]["base"] == "torso" and campaign["robot"]["tip"] in ("left_hand", "right_hand")
    assert campaign["instruments"]["targets"] == {side: {"on": side} for side in ("left_hand", "right_hand")}
    assert campaign["measurements"]["units"] == {"length": "mm", "angle": "deg"}
    found = aridcal.calibrate(tmp_path / "campaign.yaml")
    errors = found.errors.loc["final"].loc["test"]
    assert errors["position_rms_mm"] < LIMIT * np.sqrt(3.0) * 1e3 * two_arms.SIGMA
    assert found.effects.empty
    # the second road: how far the hands of the written robot are apart, by Pinocchio, is as the real one's
    geometric = found.model.geometric
    written = two_arms.Machine(two_arms.pin.buildModelFromXML(urdf_of(geometric.model, geometric.theta).decode()))
    q = readings(ROBOT, 30, 8)
    for hand, own in (("left_hand", two_arms.LEFT), ("right_hand", two_arms.RIGHT)):
        frames = dict(geometric.model.frames(geometric.theta)[1])
        told = np.array([T.act(frames[hand].translation) for T in written.seen(q, "torso", hand)])
        real = np.array([T.act(own) for T in ROBOT.seen(q, "torso", hand)])
        apart = [np.linalg.norm(p[1:] - p[:-1], axis=1) for p in (told, real)]
        np.testing.assert_allclose(apart[0], apart[1], rtol=0, atol=6e-4)


@pytest.mark.parametrize("every_joint", [False, True])
def test_labels_that_are_no_links_go_to_the_limb_that_moves_as_they_do(every_joint: bool, tmp_path: Path) -> None:
    """By which joints their rows have, and where they have all, by the nominal robot."""
    campaign = proposed(tmp_path, tracked(labels={"left": "A", "right": "B"}, every_joint=every_joint))
    assert campaign["instruments"]["targets"] == {"A": {"on": "left_hand"}, "B": {"on": "right_hand"}}


def test_without_labels_the_nominal_robot_tells_which_hand_was_measured(tmp_path: Path) -> None:
    table = tracked(every_joint=True)
    campaign = proposed(tmp_path, table[table["target"] == "right_hand"].drop(columns="target"))
    assert campaign["robot"]["tip"] == "right_hand" and "instruments" not in campaign
    assert set(campaign["measurements"]["ignore"]) >= {f"left_j{k}" for k in range(1, 7)}


def test_one_hand_seen_from_the_other_is_a_path_between_them(tmp_path: Path) -> None:
    q = readings(ROBOT, 100)
    places = [T.act(two_arms.LEFT) for T in ROBOT.seen(q, "right_hand", "left_hand")]
    table = ROBOT.table(q, **dict(zip("xyz", np.array(places).T, strict=True)))
    campaign = proposed(tmp_path, table)
    assert (campaign["robot"]["base"], campaign["robot"]["tip"]) == ("right_hand", "left_hand")


def test_what_the_nominal_robot_does_not_tell_is_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both arms move alike: either may carry the target."""
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    q = readings(ROBOT, 80)
    joints = {name: k for k, name in enumerate(ROBOT.joints)}
    for k in range(1, 7):
        q[:, joints[f"right_j{k}"]] = q[:, joints[f"left_j{k}"]]
    places = [T.act(two_arms.LEFT) for T in ROBOT.seen(q, "torso", "left_hand")]
    table = ROBOT.table(q, target=np.full(len(q), "A"), **dict(zip("xyz", np.array(places).T, strict=True)))
    (tmp_path / "two_arms.urdf").write_bytes(two_arms.urdf())
    table.to_csv(tmp_path / "table.csv", index=False)
    words = ["--urdf", str(tmp_path / "two_arms.urdf"), "--measurements", str(tmp_path / "table.csv")]
    words += ["-o", str(tmp_path / "campaign.yaml")]
    assert aridcal.init.main(words) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "which link carries the target 'A'?" in said and "--set instruments.targets.A.on=NUMBER" in said
    number = re.search(r"(\d) = left_hand", said)
    assert number is not None
    assert aridcal.init.main([*words, "--set", f"instruments.targets.A.on={number[1]}"]) == 0
    assert yaml.safe_load((tmp_path / "campaign.yaml").read_text())["robot"]["tip"] == "left_hand"


def test_a_link_on_the_way_to_which_a_joint_has_no_column_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "two_arms.urdf").write_bytes(two_arms.urdf())
    tracked().drop(columns="right_j3").to_csv(tmp_path / "table.csv", index=False)
    words = ["--urdf", str(tmp_path / "two_arms.urdf"), "--measurements", str(tmp_path / "table.csv")]
    assert aridcal.init.main([*words, "-o", str(tmp_path / "campaign.yaml")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "no columns for the joints right_j3 on the way to it" in said
