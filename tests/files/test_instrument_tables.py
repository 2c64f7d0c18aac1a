"""Tables of every kind of measurement, and campaigns of several: what arrives, what is refused, what is told."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from repository import ROOT
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS as EVERY
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign, load_campaign
from aridcal.files.measurement_settings import MeasurementSettings
from aridcal.files.read import load_measurements
from aridcal.files.yaml_file import parse_settings
from aridcal.system.errors import AridcalError, CampaignError

ELSEWHERE = ("camera_sonar", "joined")  # of images: test_camera_sonar; of a tree: test_joined
KINDS = {name: kind for name, kind in EVERY.items() if name not in ELSEWHERE}

JOINTS = ("rail", "elbow")
LIMITS = np.array([[-1.0, 5.0], [-3.0, 3.0]])
JOINT_KINDS = ("prismatic", "revolute")
EYE = {"fx": 700.0, "fy": 710.0, "cx": 320.0, "cy": 240.0, "width": 640, "height": 480}
ROWS = 24


def table(kind: str, n: int = ROWS, seed: int = 0) -> pd.DataFrame:
    """A sound table of `n` rows, every label in several of them."""
    rng = np.random.default_rng([seed, *kind.encode()])
    label = [f"{'abc'[k % 3]}" for k in range(n)]
    xyz = dict(zip("xyz", rng.uniform(-1, 1, (3, n)), strict=True))
    own: dict[str, dict[str, Any]] = {
        "pose": xyz | dict(zip(("qx", "qy", "qz", "qw"), Rotation.random(n, rng=rng).as_quat().T, strict=True)),
        "position": xyz,
        "point": {"point": label},
        "distance": {"distance": rng.uniform(0.5, 2, n), "anchor": label},
        "plane": {"plane": label, "reading": rng.uniform(0, 1e-3, n)},
        "pixels": {"u": rng.uniform(0, 639, n), "v": rng.uniform(0, 479, n), "marker": label, "shot": range(n)},
        "inclination": dict(zip(("gx", "gy", "gz"), rng.normal(size=(3, n)), strict=True)),
    }
    joints = dict(zip(JOINTS, rng.uniform([[0], [-2]], [[4], [2]], (2, n)), strict=True))
    return pd.DataFrame(joints | own[kind])


Blocks = dict[str, pd.DataFrame] | list[dict[str, Any]]


def write(folder: Path, blocks: Blocks, tables: dict[str, pd.DataFrame] | None = None, **keys: Any) -> Campaign:
    """A campaign of one block for each kind, or of the blocks that are given, with its tables."""
    if isinstance(blocks, dict):
        tables, blocks = blocks, [{"kind": kind, "file": f"{kind}.csv"} for kind in blocks]
    for name, rows in (tables or {}).items():
        rows.to_csv(folder / f"{name}.csv", index=False)
    if any(block["kind"] == "pixels" for block in blocks):
        keys["instruments"] = {"cameras": {"eye": EYE}} | keys.get("instruments", {})
    measurements = blocks[0] if len(blocks) == 1 else blocks
    job = {"format": 1, "robot": {"urdf": "r.urdf", "tip": "t"}, "measurements": measurements} | keys
    (folder / "campaign.yaml").write_text(yaml.safe_dump(job, sort_keys=False))
    return load_campaign(folder / "campaign.yaml")


def load(campaign: Campaign, **options: Any) -> Dataset:
    data = load_measurements(campaign, JOINTS, LIMITS, JOINT_KINDS, **options)
    return data.select(data.as_read)


def said(folder: Path, *arguments: Any, **keys: Any) -> str:
    with pytest.raises(AridcalError) as caught:
        load(write(folder, *arguments, **keys))
    return str(caught.value)


def notices(data: Dataset) -> str:
    return "\n".join(map(str, data.origin.notices))


# ---------------------------------------------------------------- what arrives


@pytest.mark.parametrize("kind", ["point", "distance", "plane", "pixels", "inclination"])
def test_every_number_and_label_of_a_kind_arrives(tmp_path: Path, kind: str) -> None:
    rows = table(kind).assign(temperature=np.linspace(20, 21, ROWS))
    data = load(write(tmp_path, {kind: rows}))
    np.testing.assert_array_equal(data.readings, rows[list(JOINTS)])
    np.testing.assert_array_equal(data.observed, rows[list(KINDS[kind].read)])
    for k, role in enumerate(KINDS[kind].roles):
        expected = {"camera": ["eye"] * ROWS, "board": ["board_on_world"] * ROWS}
        np.testing.assert_array_equal(data.labels.refers[:, k], expected.get(role.name) or rows[role.name])
    assert (data.labels.refers[:, len(KINDS[kind].roles) :] == "").all()
    assert (
        [b.kind for b in data.blocks] == [kind]
        and not data.labels.block.any()
        and data.channels == KINDS[kind].channels
    )
    assert (
        np.isnan(data.position).all()
        and data.rotation is None
        and data.labels.target is None
        and not data.repeats.stale.any()
    )
    assert set(data.covariates) == {"temperature"} and data.test.sum() == round(0.2 * ROWS)
    assert list(data.instruments.things) == [role.name for role in KINDS[kind].roles] and not data.instruments.world


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_poses_alone_are_the_data_that_they_were(tmp_path: Path, kind: str) -> None:
    listed = load(write(tmp_path, [{"kind": kind, "file": "m.csv"}], {"m": table(kind)}))
    assert listed.direct and not (listed.labels.refers != "").any() and listed.labels.target is None
    np.testing.assert_array_equal(listed.position, table(kind)[["x", "y", "z"]])


def test_a_list_of_one_block_is_that_block(tmp_path: Path) -> None:
    one = load(write(tmp_path, {"distance": table("distance")}))
    job = yaml.safe_load((tmp_path / "campaign.yaml").read_text())
    (tmp_path / "list.yaml").write_text(yaml.safe_dump(job | {"measurements": [job["measurements"]]}))
    two = load(load_campaign(tmp_path / "list.yaml"))
    np.testing.assert_array_equal(one.observed, two.observed)
    np.testing.assert_array_equal(one.test, two.test)


def test_units_belong_to_lengths_and_not_to_pixels(tmp_path: Path) -> None:
    for kind, factor in (("distance", 1e-3), ("plane", 1e-3), ("pixels", 1.0), ("inclination", 1.0)):
        rows = table(kind).assign(rail=lambda t: 1000 * t.rail)
        block = {"kind": kind, "file": "m.csv", "units": {"length": "mm"}}
        data = load(write(tmp_path, [block], {"m": rows}))
        np.testing.assert_allclose(data.observed, factor * rows[list(KINDS[kind].read)], rtol=1e-14)


def test_a_plane_without_readings_is_touched_and_named_after_its_block(tmp_path: Path) -> None:
    data = load(write(tmp_path, {"plane": table("plane").drop(columns=["plane", "reading"])}))
    assert not data.observed.any() and set(data.labels.refers[:, 0]) == {"plane"}
    declared = {"planes": {"table": {"normal": [0, 0, 2], "offset": 0.5, "identify": False}}}
    data = load(write(tmp_path, {"plane": table("plane").drop(columns="plane")}, instruments=declared))
    plane = data.instruments.things["plane"]
    assert plane.names == ("table",) and not plane.free.any() and data.instruments.world
    np.testing.assert_array_equal(plane.start, [[0, 0, 1, 0.5]])


def test_blocks_of_every_kind_are_one_data_set(tmp_path: Path) -> None:
    tables = {kind: table(kind) for kind in KINDS}
    tables["distance"]["time"] = np.arange(ROWS)
    data = load(write(tmp_path, tables))
    assert len(data) == ROWS * len(KINDS) and [b.name for b in data.blocks] == list(KINDS)
    names = [channel.name for channel in data.channels]
    assert len(set(names)) == len(names) and {
        "pose_position",
        "point_position",
        "rotation",
        "pixel",
        "plane_distance",
    } <= set(names)
    for number, (kind, rows) in enumerate(tables.items()):
        own = data.select(data.labels.block == number)
        np.testing.assert_array_equal(own.readings, rows[list(JOINTS)])
        np.testing.assert_array_equal(own.origin.line, np.arange(2, ROWS + 2))
        assert {data.origin.files[k].name for k in own.origin.file} == {f"{kind}.csv"}
        numbers = [name for name in KINDS[kind].read if name in rows]
        np.testing.assert_array_equal(own.observed[:, : len(numbers)], rows[numbers])
        assert np.isnan(own.observed[:, len(KINDS[kind].read) :]).all()
        assert own.test.sum() == round(0.2 * ROWS)
        assert np.isfinite(own.position).all() == (kind in ("pose", "position"))
        label = {"pixels": "tip", "inclination": "inclination"}.get(kind, "target")
        assert own.labels.target is not None and set(own.labels.target) == {label}
        assert np.isfinite(own.covariates["time"]).all() == (kind == "distance")
    assert data.rotation is not None and data.instruments.world
    np.testing.assert_array_equal(
        data.rotation[data.labels.block == 0].reshape(-1, 9), data.observed[data.labels.block == 0, 3:]
    )
    assert np.unique(data.origin.order).size == len(data)


def test_rows_alike_in_joints_are_no_repeats_at_another_thing(tmp_path: Path) -> None:
    rows = table("distance", 4).assign(rail=1.0, elbow=[0.0, 1e-5, 2e-5, 3e-5], anchor=["a", "a", "b", "b"])
    more = table("distance", 24)
    tables = {
        "distance": pd.concat([rows, more]),
        "point": table("point").assign(rail=1.0, elbow=0.0, temperature=range(ROWS)),
    }
    data = load(write(tmp_path, tables))
    first = data.repeats.configuration[(data.labels.block == 0) & (data.origin.line < 6)]
    assert first[0] == first[1] != first[2] == first[3]
    assert not set(data.repeats.configuration[data.labels.block == 0]) & set(
        data.repeats.configuration[data.labels.block == 1]
    )
    assert len(set(data.repeats.configuration[data.labels.block == 1])) == 3


def test_several_targets_are_told_apart_and_one_is_not(tmp_path: Path) -> None:
    rows = table("position").assign(target=["left", "right"] * (ROWS // 2))
    data = load(write(tmp_path, {"position": rows}))
    np.testing.assert_array_equal(data.labels.target, rows.target)
    assert len(data.blocks) == 1 and data.instruments.world and set(data.covariates) == set()
    mixed = load(write(tmp_path, {"position": rows, "distance": table("distance")}))
    assert set(mixed.labels.target[mixed.labels.block == 1]) == {"target"}
    alike = load(write(tmp_path, {"point": table("point"), "distance": table("distance")}))
    assert alike.labels.target is None


def test_weights_of_one_block_leave_those_of_others_alone(tmp_path: Path) -> None:
    std = np.linspace(1e-4, 3e-4, ROWS)
    rows = table("position").assign(std_x=std, std_y=std, std_z=std)
    blocks = [
        {"kind": "distance", "file": "distance.csv", "noise": {"distance": 2e-4}},
        {"kind": "position", "file": "position.csv", "noise": {"rows": "absolute"}},
    ]
    data = load(write(tmp_path, blocks, {"distance": table("distance"), "position": rows}))
    assert data.relative is not None and data.relative.shape == (2 * ROWS, 4)
    assert (data.relative[data.labels.block == 0] == 1).all() and (data.relative[:, 0] == 1).all()
    own = (data.labels.block == 1) & data.train
    np.testing.assert_allclose(np.sqrt(np.mean(data.relative[own, 1:] ** 2)), 1, rtol=1e-12)
    assert data.sigma[0] == 2e-4 and data.sigma[1] == pytest.approx(
        np.sqrt(np.mean(std[data.train[data.labels.block == 1]] ** 2))
    )


# ---------------------------------------------------------------- the split


def test_a_label_is_never_left_without_training_rows_by_the_draw(tmp_path: Path) -> None:
    rows = table("point", 40).assign(point=[f"p{k}" for k in range(40)])
    data = load(write(tmp_path, {"point": rows}))
    assert not data.test.any() and re.search(r"all rows of point p\d+, .* are needed to find it", notices(data))
    rows = table("position", 40).assign(target=["a"] * 39 + ["b"])
    for seed in range(6):
        data = load(write(tmp_path, {"position": rows}), seed=seed)
        assert data.test.any() and not data.test[data.labels.target == "b"].any()


def test_a_table_may_keep_a_label_for_the_test(tmp_path: Path) -> None:
    rows = table("point").assign(split=lambda t: np.where(t.point == "c", "test", "train"))
    data = load(write(tmp_path, {"point": rows}))
    np.testing.assert_array_equal(data.test, rows.point == "c")
    assert data.origin.split_given and data.instruments.things["point"].names == ("a", "b", "c")


def test_images_of_one_configuration_stay_together(tmp_path: Path) -> None:
    rows = table("pixels", 60)
    rows[list(JOINTS)] = np.repeat(rows[list(JOINTS)].to_numpy()[:12], 5, axis=0)
    data = load(write(tmp_path, {"pixels": rows}))
    assert all(len(set(part)) == 1 for part in data.test.reshape(12, 5).tolist()) and data.test.any()


# ---------------------------------------------------------------- what is known beforehand


def test_known_points_are_exact_or_as_good_as_their_std(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("point,x,y,z,std\na,1,2,3,\nb,4,5,6,1e-4\nz,0,0,0,\n")
    data = load(write(tmp_path, {"point": table("point")}, instruments={"points": "points.csv"}))
    points = data.instruments.things["point"]
    np.testing.assert_array_equal(points.start, [[1, 2, 3], [4, 5, 6], [np.nan] * 3])
    np.testing.assert_array_equal(points.free, [[False] * 3, [True] * 3, [True] * 3])
    np.testing.assert_array_equal(points.std, [[np.inf] * 3, [1e-4] * 3, [np.inf] * 3])
    assert data.instruments.world and "point z: no row refers to it" in notices(data)


def test_lengths_and_right_angles_become_ties(tmp_path: Path) -> None:
    keys = {"lengths": [{"between": ["a", "b"], "length": 0.05, "std": 2e-5}, {"between": ["b", "c"], "length": 0.1}]}
    ties = load(write(tmp_path, {"point": table("point")}, instruments=keys)).instruments.ties
    assert [(t.role, t.first, t.second, t.form, t.value, t.std) for t in ties] == [
        ("point", "a", "b", "distance", 0.05, 2e-5),
        ("point", "b", "c", "distance", 0.1, 1e-5),
    ]
    keys = {"perpendicular": [["a", "b"], {"between": ["b", "c"], "std": 1e-3}]}
    ties = load(write(tmp_path, {"plane": table("plane")}, instruments=keys)).instruments.ties
    assert [(t.role, t.form, t.value, t.std) for t in ties] == [
        ("plane", "cosine", 0, 1e-5),
        ("plane", "cosine", 0, 1e-3),
    ]


def test_numbers_may_be_labels(tmp_path: Path) -> None:
    rows = table("pixels").assign(marker=[k % 3 for k in range(ROWS)])
    ties = load(
        write(tmp_path, {"pixels": rows}, instruments={"lengths": [{"between": [0, 2], "length": 0.1}]})
    ).instruments.ties
    assert [(t.role, t.first, t.second) for t in ties] == [("marker", "0", "2")]


def test_anchors_are_identified_as_far_as_the_campaign_says(tmp_path: Path) -> None:
    anchors = {
        "a": {"xyz": [1, 2, 3], "identify": False},
        "b": {"identify": ["place", "offset", "scale"], "offset": 0.1},
    }
    data = load(write(tmp_path, {"distance": table("distance")}, instruments={"anchors": anchors}))
    anchor, nan = data.instruments.things["anchor"], np.nan
    np.testing.assert_array_equal(anchor.start, [[1, 2, 3, 0, 1], [nan, nan, nan, 0.1, 1], [nan, nan, nan, nan, 1]])
    np.testing.assert_array_equal(anchor.free, [[False] * 5, [True] * 5, [True] * 4 + [False]])
    assert data.instruments.world


@pytest.mark.parametrize("on", ["tip", "world"])
def test_cameras_and_boards_stand_on_opposite_sides(tmp_path: Path, on: str) -> None:
    eye = EYE | {"on": on, "identify": ["place", "f"], "distortion": [0.1, 0, 0, 0, 0]}
    data = load(write(tmp_path, {"pixels": table("pixels")}, instruments={"cameras": {"eye": eye}}))
    camera, board, marker = (data.instruments.things[name] for name in ("camera", "board", "marker"))
    np.testing.assert_array_equal(camera.start[0, 12:], [700, 710, 320, 240, 0.1, 0, 0, 0, 0, on == "tip"])
    assert np.isnan(camera.start[0, :12]).all() and camera.free[0].tolist() == [True] * 8 + [False] * 7
    assert board.names == (f"board_on_{'world' if on == 'tip' else 'tip'}",) and not board.free.any()
    np.testing.assert_array_equal(board.start[0], [0, 0, 0, *np.eye(3).ravel()])
    assert marker.free.all() and np.isnan(marker.start).all() and not data.instruments.world


def test_what_a_camera_is_on_needs_no_quotes(tmp_path: Path) -> None:
    """YAML 1.1 reads a plain `on` as a truth."""
    write(tmp_path, {"pixels": table("pixels")})
    job = (tmp_path / "campaign.yaml").read_text()
    assert "height: 480" in job
    (tmp_path / "campaign.yaml").write_text(job.replace("height: 480", "height: 480\n      on: world"))
    assert load_campaign(tmp_path / "campaign.yaml").instruments.cameras["eye"].on == "world"


def test_a_board_has_known_markers_and_a_place_that_is_sought(tmp_path: Path) -> None:
    (tmp_path / "markers.csv").write_text("marker,x,y,z\na,0,0,0\nb,0.1,0,0\n")
    keys: dict[str, Any] = {"markers": {"file": "markers.csv", "on": "world"}}
    data = load(write(tmp_path, {"pixels": table("pixels")}, instruments=keys))
    board, marker = data.instruments.things["board"], data.instruments.things["marker"]
    assert board.free.all() and np.isnan(board.start).all() and not data.instruments.world
    assert marker.names == ("a", "b") and not marker.free.any() and marker.start[1].tolist() == [0.1, 0, 0]
    assert {r.why for r in data.origin.refused} == {"no such marker in markers.csv"} and len(
        data.origin.refused
    ) == ROWS // 3
    keys["markers"] |= {"xyz": [0, 0, 1], "rpy": [0, 0, np.pi / 2], "identify": False}
    data = load(write(tmp_path, {"pixels": table("pixels")}, instruments=keys))
    board = data.instruments.things["board"]
    assert data.instruments.world and not board.free.any()
    np.testing.assert_allclose(board.start[0], [0, 0, 1, 0, -1, 0, 1, 0, 0, 0, 0, 1], atol=1e-15)


def test_an_unknown_lens_starts_as_an_ordinary_one(tmp_path: Path) -> None:
    eye = {"width": 640, "height": 480, "identify": ["place", "f", "c"]}
    data = load(write(tmp_path, {"pixels": table("pixels")}, instruments={"cameras": {"eye": eye}}))
    np.testing.assert_array_equal(data.instruments.things["camera"].start[0, 12:16], [640, 640, 319.5, 239.5])


# ---------------------------------------------------------------- what is refused and told


def test_rows_that_no_instrument_reads_are_refused_by_name(tmp_path: Path) -> None:
    spoilt = {
        "distance": ("distance", -0.1, "must be positive"),
        "pixels": ("u", 640.0, "outside the image of 640 x 480 pixels of the camera eye"),
        "point": ("point", "", "empty"),
        "plane": ("plane", "", "empty"),
    }
    for kind, (column, value, why) in spoilt.items():
        rows = table(kind).astype(object)
        rows.loc[3, column] = value
        data = load(write(tmp_path, {kind: rows}))
        assert len(data) == ROWS - 1 and [(r.row, r.column) for r in data.origin.refused] == [(5, column)], kind
        assert why in data.origin.refused[0].why
    rows = table("inclination")
    rows.loc[3, ["gx", "gy", "gz"]] = 0.0
    assert [r.row for r in load(write(tmp_path, {"inclination": rows})).origin.refused] == [5]


def test_copies_are_refused_but_not_of_another_label(tmp_path: Path) -> None:
    rows = pd.concat([table("point"), table("point")[:2], table("point")[2:4].assign(point="d")])
    data = load(write(tmp_path, {"point": rows}))
    assert [(r.row, r.why) for r in data.origin.refused] == [
        (ROWS + 2, "identical to line 2"),
        (ROWS + 3, "identical to line 3"),
    ]


def test_labels_that_tell_nothing_of_the_arm_are_told(tmp_path: Path) -> None:
    rows = table("point")
    rows.loc[0, "point"] = "lone"
    campaign = write(tmp_path, {"point": rows})
    assert "point lone: with so few rows they tell where it is" in notices(load(campaign))
    assert not load(campaign, files=[rows], fitted=False).origin.notices, (
        "of rows that are scored only nothing is asked"
    )
    tied = {"lengths": [{"between": ["lone", "a"], "length": 0.1}]}
    assert "lone: with" not in notices(load(write(tmp_path, {"point": rows}, instruments=tied)))


def test_a_second_days_table_goes_to_the_block_whose_columns_it_has(tmp_path: Path) -> None:
    """The other blocks are there without rows, so that every channel is where the model has it."""
    kinds = ("distance", "point", "pose", "plane")
    campaign = write(tmp_path, {kind: table(kind) for kind in kinds})
    every = load(campaign)
    for number, kind in enumerate(kinds):
        data = load(campaign, files=[table(kind, seed=1)], fitted=False)
        assert data.blocks == every.blocks and data.channels == every.channels
        assert (data.labels.block == number).all() and len(data) == ROWS
        np.testing.assert_array_equal(data.readings, table(kind, seed=1)[list(JOINTS)])
    with pytest.raises(AridcalError, match="fit none of the blocks distance, point, pose"):
        load(campaign, files=[table("pixels")], fitted=False)


def test_tables_of_a_second_day_serve_each_its_own_block(tmp_path: Path) -> None:
    campaign = write(tmp_path, {kind: table(kind) for kind in ("distance", "point", "pose")})
    table("pose", seed=1).to_csv(tmp_path / "later.csv", index=False)
    data = load(campaign, files=[tmp_path / "later.csv", table("distance", seed=1)], fitted=False)
    assert np.bincount(data.labels.block).tolist() == [ROWS, 0, ROWS]
    np.testing.assert_array_equal(data.observed[data.labels.block == 0, 0], table("distance", seed=1)["distance"])
    np.testing.assert_array_equal(data.position[data.labels.block == 2], table("pose", seed=1)[["x", "y", "z"]])


def test_a_second_days_table_that_fits_two_blocks_is_refused_until_their_columns_differ(tmp_path: Path) -> None:
    wires = [{"kind": "distance", "name": name, "file": f"{name}.csv"} for name in ("left", "right")]
    tables = {"left": table("distance"), "right": table("distance", seed=2)}
    later = tmp_path / "later.csv"
    table("distance", seed=3).to_csv(later, index=False)
    with pytest.raises(AridcalError, match=r"later.csv: its columns fit several of the blocks left, right.*`columns`"):
        load(write(tmp_path, wires, tables), files=[later], fitted=False)
    wires[1]["columns"] = {"distance": "wire"}
    tables["right"] = tables["right"].rename(columns={"distance": "wire"})
    campaign = write(tmp_path, wires, tables)
    assert set(load(campaign, files=[later], fitted=False).labels.block) == {0}
    table("distance", seed=3).rename(columns={"distance": "wire"}).to_csv(later, index=False)
    assert set(load(campaign, files=[later], fitted=False).labels.block) == {1}


MARKERS = "marker,x,y,z\na,0,0,0\nb,0.1,0,0\nc,0.2,0,0\n"

REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "a length to nowhere": ("point", {"lengths": [{"between": ["a", "bb"], "length": 1}]}, "refers to 'bb'.*did you mean"),
    "a right angle to nowhere": ("plane", {"perpendicular": [["a", "q"]]}, r"perpendicular\[0\]: no usable row refers to 'q'"),
    "two lengths for one": (
        "point",
        {"lengths": [{"between": ["a", "b"], "length": 1}, {"between": ["b", "a"], "length": 1.1}]},
        r"lengths\[1\]: b and a are 1.1 m apart here and 1 m elsewhere",
    ),
    "an impossible triangle": (
        "point",
        {"lengths": [{"between": p, "length": x} for p, x in ((["a", "b"], 1), (["b", "c"], 1), (["c", "a"], 2.1))]},
        "a and c cannot be 2.1 m apart: by way of b",
    ),
    "a length from a point to itself": ("point", {"lengths": [{"between": ["a", "a"], "length": 1}]}, "'a' twice; name two"),
    "a length against coordinates": (
        "pixels",
        {"markers": {"file": "markers.csv"}, "lengths": [{"between": ["a", "b"], "length": 0.2}]},
        "a and b are 0.1 m apart by their coordinates, not 0.2 m",
    ),
    "an anchor of no place": ("distance", {"anchors": {"a": {"identify": False}}}, r"anchors\.a: .*needs `xyz`"),
    "a plane of no normal": ("plane", {"planes": {"a": {"normal": [0, 0, 0]}}}, r"planes\.a\.normal: a normal of length 0"),
    "a known plane of no offset": ("plane", {"planes": {"a": {"normal": [0, 0, 1], "identify": False}}}, "`normal` and `offset`"),
    "a camera without a focal length": ("pixels", {"cameras": {"eye": {"width": 64, "height": 48}}}, r"cameras\.eye: add `fx`"),
    "no camera": ("pixels", {"cameras": {}}, r"instruments\.cameras: .*needs a camera; add it"),
    "two cameras": ("pixels", {"cameras": {"eye": EYE, "ear": {**EYE, "on": "tip"}}}, "several cameras .eye, ear.; say which"),
    "a board on the camera's side": ("pixels", {"markers": {"on": "tip"}}, "markers.on: the cameras are on the tip, too"),
    "a place without a board": ("pixels", {"markers": {"xyz": [0, 0, 1]}}, "a place belongs to a board: add its `file`"),
    "a camera called as a joint": ("pixels", {"cameras": {"elbow": EYE}}, "the camera 'elbow' has the name of a joint: rename"),
    "a camera called camera": ("pixels", {"cameras": {"camera": EYE}}, "the camera 'camera' has the name of a place of corr"),
    "an unknown key": ("distance", {"anchor": {}}, r"instruments\.anchor: unknown key \(did you mean 'anchors'"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_known_is_refused_by_key(tmp_path: Path, name: str) -> None:
    kind, instruments, why = REFUSED[name]
    (tmp_path / "markers.csv").write_text(MARKERS)
    message = said(tmp_path, {kind: table(kind)}, instruments=instruments)
    assert re.search(why, message), message


BLOCKS: dict[str, tuple[list[dict[str, Any]], dict[str, Any], str]] = {
    "two blocks of one name": ([{"kind": "point"}, {"kind": "point"}], {}, r"s\[1\]\.name: two blocks are called 'point'"),
    "noise of another kind": ([{"kind": "distance", "noise": {"position": 1e-4}}], {}, "noise.position: .*noise of distance"),
    "noise of another kind in a list": (
        [{"kind": "point"}, {"kind": "pixels", "noise": {"distance": 1e-4}}], {}, r"measurements\[1\]: noise.distance: .*of pixel"
    ),
    "a kind that is none": ([{"kind": "point"}, {"kind": "pixel"}], {}, r"line \d+: measurements\[1\]\.kind: .*'pixels'"),
    "a camera of a wire": ([{"kind": "distance", "camera": "eye"}], {}, "camera: belongs to `kind: pixels`; delete it"),
    "a camera that is none": ([{"kind": "pixels", "camera": "eyes"}], {}, r"measurements\.camera: .*'eyes'.*did you mean 'eye'"),
    "a head among others": ([{"kind": "point"}, {"kind": "camera_sonar", "head": "h.yaml"}], {}, r"\[1\]\.kind: camera_sonar"),
    "a target of pixels": ([{"kind": "pixels"}], {"frames": {"tip_target": {"xyz": [0, 0, 1]}}}, r"tip_target: .*delete"),
    "stations of several targets": (
        [{"kind": "point"}, {"kind": "inclination"}], {"frames": {"tip_target": {"per": "station"}}}, "is not for several"
    ),
    "stations of things in the world": (
        [{"kind": "point"}], {"frames": {"world_base": {"per": "station"}}}, r"world_base: .* rows of a tracker, and point"
    ),
    "an empty name": ([{"kind": "point", "name": " "}], {}, r"measurements\.name: is empty; give"),
}  # fmt: skip


@pytest.mark.parametrize("name", BLOCKS)
def test_blocks_that_make_no_sense_are_refused_by_key(tmp_path: Path, name: str) -> None:
    blocks, keys, why = BLOCKS[name]
    blocks = [b if "head" in b else b | {"file": f"{b['kind']}.csv"} for b in blocks]
    tables = {kind: table(kind).assign(station="s") for kind in ("point", "distance", "pixels", "inclination")}
    message = said(tmp_path, blocks, tables, **keys)
    assert re.search(why, message), message


def test_no_blocks_are_no_measurements(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("format: 1\nrobot: {urdf: a, tip: b}\nmeasurements: []\n")
    with pytest.raises(CampaignError, match=r"line 3: measurements: .*at least 1 item"):
        load_campaign(tmp_path / "c.yaml")


PLACES = {
    "a label twice": ("point,x,y,z\na,0,0,0\na,0,0,1\n", "line 3: column 'point', a: appears twice; delete one"),
    "no label": ("point,x,y,z\n,0,0,0\n", "line 2: column 'point'.*give the row a label"),
    "a word": ("point,x,y,z\na,0,zero,0\n", "line 2: column 'y', zero: should be a number"),
    "a negative std": ("point,x,y,z,std\na,0,0,0,-1\n", "column 'std', -1: should be a positive number, or empty"),
    "a word as std": ("point,x,y,z,std\na,0,0,0,good\n", "column 'std', good: should be a positive number, or empty"),
    "millimetres": ("point,x,y,z\na,500,0,300\nb,0,700,0\n", "cannot be in m: .*give them in metres"),
    "no z": ("point,x,y\na,0,0\n", "no column 'z'"),
    "a short row": ("point,x,y,z\na,0,0,0\nb,0\n", "line 3: .*mend the file"),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_table_of_known_points_is_refused_by_cell(tmp_path: Path, name: str) -> None:
    text, why = PLACES[name]
    (tmp_path / "points.csv").write_text(text)
    message = said(tmp_path, {"point": table("point")}, instruments={"points": "points.csv"})
    assert "points.csv" in message and re.search(why, message), message


def test_readings_in_millimetres_and_cameras_of_nobody_are_named(tmp_path: Path) -> None:
    rows = table("distance").assign(distance=lambda t: 1000 * t.distance)
    assert "'distance' cannot be in m" in said(tmp_path, {"distance": rows})
    rows = table("pixels").assign(camera="ear")
    message = said(tmp_path, {"pixels": rows})
    assert (
        "line 2" in message and "column 'camera', ear: there is no such camera" in message and "add it under" in message
    )


def test_a_marker_cannot_be_on_both_sides(tmp_path: Path) -> None:
    cameras = {"hand": EYE, "wall": EYE | {"on": "world"}}
    rows = table("pixels").assign(camera=["hand", "wall"] * (ROWS // 2))
    assert "is seen by cameras on the tip and in the world" in said(
        tmp_path, {"pixels": rows}, instruments={"cameras": cameras}
    )
    rows["marker"] += rows.camera
    data = load(write(tmp_path, {"pixels": rows}, instruments={"cameras": cameras}))
    assert data.instruments.things["board"].names == ("board_on_tip", "board_on_world")


def test_things_of_no_block_are_told_and_of_poses_refused(tmp_path: Path) -> None:
    """The example of the contract has anchors and planes beside blocks of points and pixels."""
    keys = {"anchors": {"pulley": {}}, "planes": {"table": {}}, "markers": {"file": "markers.csv"}}
    (tmp_path / "markers.csv").write_text(MARKERS)
    told = notices(load(write(tmp_path, {"point": table("point")}, instruments=keys)))
    assert all(f"{thing}: no row refers to it" in told for thing in ("anchor pulley", "plane table", "marker a, b, c"))
    assert "instruments: no block's rows refer" in said(tmp_path, {"pose": table("pose")}, instruments={"anchors": {}})


def test_the_examples_of_the_formats_are_campaigns() -> None:
    text = (ROOT / "docs" / "formats.md").read_text("utf-8").split("## 7. ")[1].split("\n## 8. ")[0]
    examples = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    assert len(examples) == 2
    small, full = (parse_settings(example, Path("campaign.yaml"), Campaign) for example in examples)
    assert [block.kind for block in small.blocks] == ["point", "pixels"] and small.blocks[1].camera == "eye"
    assert full.instruments.model_fields_set == set(type(full.instruments).model_fields)


def test_every_kind_and_its_columns_stand_in_the_formats() -> None:
    text = (ROOT / "docs" / "formats.md").read_text("utf-8").split("## 7. ")[1]
    needed = {"joined": {"links": ["left_hand", "right_hand"]}}
    for kind in (*KINDS, "joined"):
        (line,) = re.findall(rf"^\| [^|]*`{kind}`.*\|$", text.split("A campaign of")[0], re.MULTILINE)
        own = MeasurementSettings.model_validate({"kind": kind, **needed.get(kind, {})}).own_columns
        named = " ".join(re.findall("`([^`]*)`", line)).split()
        assert set(own) - {"target"} <= set(named), kind
