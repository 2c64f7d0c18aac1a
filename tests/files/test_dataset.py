"""Tables of measurements: every number arrives to the last bit, in SI units, or its row is refused by name."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aridcal.engine.instruments.channels import TARGET_POSITION, TARGET_ROTATION
from aridcal.engine.rows.dataset import Dataset, dataset
from aridcal.engine.rows.repeats import blocks
from aridcal.files.campaign import Campaign
from aridcal.files.query import load_query
from aridcal.files.read import load_measurements
from aridcal.system.errors import CampaignError, MeasurementError

JOINTS = ("rail", "shoulder", "wrist")
KINDS = ("prismatic", "revolute", "continuous")
LIMITS = np.array([[0.0, 18.0], [-3.0, 3.0], [-np.inf, np.inf]])
POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"]


def rows(n: int = 20, seed: int = 0) -> pd.DataFrame:
    """A sound table of `n` random configurations."""
    rng = np.random.default_rng(seed)
    joints = rng.uniform([0, -2.5, -3], [10, 2.5, 3], (n, 3))
    pose = np.hstack([rng.uniform(-2, 2, (n, 3)), Rotation.random(n, rng=rng).as_quat()])
    return pd.DataFrame(np.hstack([joints, pose]), columns=[*JOINTS, *POSE])


def matrices(quaternion: np.ndarray) -> np.ndarray:
    """Rotations of unit quaternions x y z w by Rodrigues' formula, shape (n, 4) to (n, 3, 3)."""
    v, w = quaternion[:, None, :3], quaternion[:, 3, None, None]
    X = np.cross(v, np.eye(3)).transpose(0, 2, 1)
    return np.eye(3) + 2 * w * X + 2 * X @ X


def campaign(file: Path | list[Path], frames: dict[str, Any] | None = None, **settings: Any) -> Campaign:
    files = [str(f) for f in file] if isinstance(file, list) else str(file)
    keys = {"format": 1, "robot": {"urdf": "r.urdf", "tip": "t"}, "measurements": {"file": files, **settings}}
    return Campaign.model_validate(keys if frames is None else {**keys, "frames": frames})


def load(file: Path | list[Path], seed: int = 0, **settings: Any) -> Dataset:
    """The rows as they stand in the files."""
    return as_read(load_measurements(campaign(file, **settings), JOINTS, LIMITS, KINDS, seed))


def as_read(m: Dataset) -> Dataset:
    return m.select(m.as_read)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def write(table: pd.DataFrame | str | bytes, name: str = "m.csv") -> Path:
        path = tmp_path / name
        if isinstance(table, pd.DataFrame):
            table.to_parquet(path) if name.endswith(".parquet") else table.to_csv(path, index=False)
        else:
            path.write_bytes(table.encode() if isinstance(table, str) else table)
        return path

    return write


def changed(line: int, column: str, value: object, n: int = 20) -> pd.DataFrame:
    """A sound table with one cell replaced; lines count from the header, 1."""
    table = rows(n).astype(object)
    table.loc[line - 2, column] = value
    return table


def failure(file: Path | list[Path], **settings: Any) -> str:
    with pytest.raises(MeasurementError) as caught:
        load(file, **settings)
    return str(caught.value)


# ---------------------------------------------------------------- what arrives


@pytest.mark.parametrize("name", ["m.csv", "m.parquet", "M.CSV"])
def test_every_number_arrives_to_the_last_bit(write: Callable[..., Path], name: str) -> None:
    table = rows(50)
    path = write(table.sample(frac=1, axis=1, random_state=1), name)
    m = load(path)
    assert len(m) == 50 and not m.origin.refused and not m.origin.notices and m.names == JOINTS
    np.testing.assert_array_equal(m.readings, table[list(JOINTS)])
    np.testing.assert_array_equal(m.position, table[POSE[:3]])
    np.testing.assert_allclose(m.rotation, matrices(table[POSE[3:]].to_numpy()), atol=1e-15)
    assert m.channels == (TARGET_POSITION, TARGET_ROTATION) and m.sigma == (None, None)
    np.testing.assert_array_equal(m.origin.line, np.arange(2, 52))
    assert m.relative is None and not m.repeats.stale.any() and m.labels.station is None and m.covariates == {}
    assert m.origin.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_units_are_converted_in_every_column_that_has_one(write: Callable[..., Path]) -> None:
    table = rows()
    for k, name in enumerate(["std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz"]):
        table[name] = np.linspace(1, 2, 20) * (k + 1)
    table["temperature"] = np.linspace(20, 30, 20)
    absolute = {"rows": "absolute"}
    si = load(write(table), noise=absolute)
    other = table.copy()
    lengths, angles = ["rail", "x", "y", "z", "std_x", "std_y", "std_z"], ["shoulder", "wrist"]
    other[lengths] *= 1000
    other[[*angles, "std_rx", "std_ry", "std_rz"]] *= 180 / np.pi
    m = load(write(other, "other.csv"), units={"length": "mm", "angle": "deg"}, noise=absolute)
    for name in ("readings", "position", "rotation", "relative", "sigma"):
        np.testing.assert_allclose(getattr(m, name), getattr(si, name), rtol=1e-14)
    np.testing.assert_array_equal(m.covariates["temperature"], si.covariates["temperature"])


@pytest.mark.parametrize("euler", ["XYZ", "xyz", "ZYX", "zxz"])
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_euler_angles_are_products_of_turns_about_single_axes(
    write: Callable[..., Path], euler: str, unit: str
) -> None:
    rng = np.random.default_rng(1)
    table = rows().drop(columns=POSE[3:])
    angles = rng.uniform([-3, 0.1, -3], [3, 1.4, 3], (20, 3))
    turns = [
        [
            Rotation.from_rotvec(angle * np.eye(3)["xyz".index(letter)])
            for letter, angle in zip(euler.lower(), row, strict=True)
        ]
        for row in angles
    ]
    true = [a * b * c if euler.isupper() else c * b * a for a, b, c in turns]
    scale = 1.0 if unit == "rad" else 180 / np.pi
    table[["a", "b", "c"]] = angles * scale
    table[["shoulder", "wrist"]] *= scale
    m = load(
        write(table), orientation={"euler": euler, "columns": ("a", "b", "c")}, units={"angle": unit, "length": "m"}
    )
    assert max((Rotation.from_matrix(m.rotation) * Rotation.concatenate(true).inv()).magnitude()) < 1e-14
    assert m.covariates == {}


def test_rotation_vectors_are_read(write: Callable[..., Path]) -> None:
    table = rows()
    vectors = Rotation.from_quat(table[POSE[3:]]).as_rotvec()
    table = table.drop(columns=POSE[3:]).assign(rx=vectors[:, 0], ry=vectors[:, 1], rz=vectors[:, 2])
    m = load(write(table), orientation={"rotvec": ("rx", "ry", "rz")})
    assert max((Rotation.from_matrix(m.rotation) * Rotation.from_quat(rows()[POSE[3:]]).inv()).magnitude()) < 1e-14


def test_positions_alone_need_no_orientation(write: Callable[..., Path]) -> None:
    for table in (rows(), rows().drop(columns=POSE[3:])):
        m = load(write(table), kind="position")
        assert m.rotation is None and m.channels == (TARGET_POSITION,) and m.covariates == {}
        np.testing.assert_array_equal(m.position, table[POSE[:3]])


def test_columns_may_have_other_names(write: Callable[..., Path]) -> None:
    table = rows().assign(temperature=21.5)
    names = {"rail": "A 1", "x": "X [m]", "qw": "q0", "temperature": "T_amb"}
    m = load(write(table.rename(columns=names)), columns=names)
    np.testing.assert_array_equal(m.readings, table[list(JOINTS)])
    np.testing.assert_array_equal(m.position, table[POSE[:3]])
    np.testing.assert_array_equal(m.covariates["temperature"], table["temperature"])


def test_a_joint_named_like_a_quantity_needs_columns(write: Callable[..., Path]) -> None:
    table = rows().rename(columns={"rail": "rail_x"})
    arguments: tuple[Any, ...] = (("x", "shoulder", "wrist"), LIMITS, KINDS)
    with pytest.raises(CampaignError, match=r"joint 'x'.*`columns: \{x: COLUMN\}`"):
        load_measurements(campaign(write(table)), *arguments)
    m = as_read(load_measurements(campaign(write(table), columns={"x": "rail_x"}), *arguments))
    np.testing.assert_array_equal(m.readings[:, 0], table["rail_x"])
    np.testing.assert_array_equal(m.position[:, 0], table["x"])


def test_other_numeric_columns_are_covariates_with_their_holes(write: Callable[..., Path]) -> None:
    table = rows(6).assign(
        time=[5, 4, 3, 2, 1, 0],
        temperature_arm=["20.5", "", "21", "n/a", "22", "inf"],
        shoulder_direction=[-1, 0, 1, 1, 7, -1],
        note=["a", "b", "", "c", "d", "e"],
        row=range(6),
        empty="",
    )
    m = load(write(table), ignore=("row",))
    assert set(m.covariates) == {"time", "temperature_arm", "shoulder_direction"}
    np.testing.assert_array_equal(m.covariates["time"], [5, 4, 3, 2, 1, 0])
    np.testing.assert_array_equal(m.covariates["temperature_arm"], [20.5, np.nan, 21, np.nan, 22, np.nan])
    np.testing.assert_array_equal(m.covariates["shoulder_direction"], [-1, 0, 1, 1, np.nan, -1])
    assert len(m) == 6 and {n.column for n in m.origin.notices} == {
        "temperature_arm",
        "shoulder_direction",
        "note",
        "empty",
    }
    assert next(n for n in m.origin.notices if n.column == "shoulder_direction").row == 6


def test_a_frames_index_written_by_pandas_is_no_covariate(write: Callable[..., Path]) -> None:
    assert load(write(rows().to_csv())).covariates == {}
    table = rows()
    table.index = pd.Index(range(5, 25))
    assert load(write(table, "m.parquet")).covariates == {}


def test_sigmas_are_read_only_where_they_are_wanted(write: Callable[..., Path]) -> None:
    table = rows().assign(std_x=1e-4, std_y=2e-4, std_z=3e-4)
    m = load(write(table), noise={"rotation": 2e-3})
    common = np.sqrt((1 + 4 + 9) / 3)
    np.testing.assert_allclose(m.relative, np.tile([1 / common, 2 / common, 3 / common, 1, 1, 1], (20, 1)), rtol=1e-14)
    assert m.sigma == (None, 2e-3)
    ignored = load(write(table), noise={"rows": "ignore", "position": 1e-3})
    assert ignored.relative is None and ignored.sigma == (1e-3, None)
    m = load(write(table), kind="position", noise={"rows": "absolute"})
    assert m.relative is not None
    np.testing.assert_allclose(m.relative * m.sigma, table[["std_x", "std_y", "std_z"]], rtol=1e-14)
    assert "absolute" in failure(write(table), noise={"rows": "absolute"})
    assert "'std_z'" in failure(write(table.drop(columns="std_z")))
    zero = failure(write(table.assign(std_x=0)))
    assert "20 x a sigma must be positive" in zero and "rows: ignore" in zero


def test_several_files_are_one_table_in_their_order(write: Callable[..., Path]) -> None:
    first, second = rows(5), changed(4, "x", "", 7)
    second = pd.concat([second, first.iloc[:1]])
    paths = [write(first, "a.csv"), write(second.sample(frac=1, axis=1, random_state=0), "b.csv")]
    m = load(paths)
    assert m.origin.files == tuple(paths)
    np.testing.assert_array_equal(m.origin.file, [0] * 5 + [1] * 6)
    np.testing.assert_array_equal(m.origin.line, [2, 3, 4, 5, 6, 2, 3, 5, 6, 7, 8])
    assert [(r.file, r.row) for r in m.origin.refused] == [("b.csv", 4), ("b.csv", 9)]
    assert m.origin.refused[1].why == "identical to line 2 of a.csv"
    stale = first.iloc[:1].assign(rail=first["rail"].iloc[0] + 0.1)
    noted = load([paths[0], write(stale, "stale.csv")]).origin.notices
    assert [(n.file, n.row) for n in noted] == [("stale.csv", 2)]
    assert "repeats the pose of line 2 of a.csv exactly" in noted[0].why
    both = b"".join(path.read_bytes() for path in paths)
    assert m.origin.sha256 == hashlib.sha256(both).hexdigest()
    parquet = load([paths[0], write(rows(7, seed=9), "c.parquet")])
    assert len(parquet) == 12
    message = failure([paths[0], write(rows(3).assign(more=1.0), "d.csv")])
    assert "'more'" in message and "a.csv" in message and "d.csv" in message


def test_selected_rows_are_the_same_rows_in_every_array(write: Callable[..., Path]) -> None:
    table = rows().assign(time=np.arange(20.0), station=[f"s{k % 3}" for k in range(20)], std_x=1, std_y=1, std_z=1)
    table["std_x"] += np.linspace(0, 1, 20)
    m = load(write(table))
    pick = np.array([7, 3, 11])
    some = m.select(pick)
    assert len(some) == 3 and some.labels.station is not None and list(some.labels.station) == ["s1", "s0", "s2"]
    for name in ("origin.line", "origin.file", "readings", "position", "rotation", "relative", "repeats.stale", "test"):
        of = attrgetter(name)
        np.testing.assert_array_equal(of(some), of(m)[pick])
    np.testing.assert_array_equal(some.covariates["time"], [7, 3, 11])
    assert len(m.select(m.test)) + len(m.select(m.train)) == 20


def test_a_part_of_the_data_leaves_the_whole_as_it_was_and_numbers_its_own_configurations() -> None:
    """A mask and indices are the same choice; what is common to all rows stays."""
    rng = np.random.default_rng(0)
    config = np.array([0, 0, 1, 2, 1, 3, 3, 2])
    q = rows(4)[list(JOINTS)].to_numpy()[config]
    m = dataset(JOINTS, KINDS, q, rng.normal(size=(8, 3)), sigma=(1e-3,), test=config == 3)
    m = replace(m, relative=rng.uniform(1, 2, (8, 3)))
    np.testing.assert_array_equal(m.repeats.configuration, config)
    before = m.repeats.configuration.copy(), m.relative.copy()
    mask = np.array([False, False, True, True, True, False, True, True])
    some, same = m.select(mask), m.select(np.flatnonzero(mask))
    assert list(some.repeats.configuration) == [0, 1, 0, 2, 1]
    assert list(m.select(mask).select([1, 4]).repeats.configuration) == [0, 0]
    np.testing.assert_array_equal(some.relative, m.relative[mask])  # not scaled anew: sigma is that of the whole
    for name in ("origin.line", "readings", "position", "relative", "repeats.configuration", "test"):
        np.testing.assert_array_equal(attrgetter(name)(some), attrgetter(name)(same))
    assert (some.sigma, some.channels, some.names, some.kinds) == (m.sigma, m.channels, m.names, m.kinds)
    some.relative[:] = some.readings[:] = 0.0
    assert len(m) == 8 and m.readings.all()
    for was, now in zip(before, (m.repeats.configuration, m.relative), strict=True):
        np.testing.assert_array_equal(was, now)
    with pytest.raises(FrozenInstanceError):
        m.test = ~m.test


# ---------------------------------------------------------------- what is refused, and what is named


@pytest.mark.parametrize("column", ["rail", "wrist", "z", "qx"])
@pytest.mark.parametrize(
    ("value", "why"),
    [
        ("", "empty"),
        ("nan", "not finite"),
        ("-inf", "not finite"),
        ("1e400", "not finite"),
        ("1e300", "implausibly large"),
        ("n/a", "not a number"),
        ("1,5", "not a number"),
        ("1.2.3", "not a number"),
    ],
)
def test_a_bad_cell_costs_its_row_and_is_named(write: Callable[..., Path], column: str, value: str, why: str) -> None:
    m = load(write(changed(7, column, value)))
    (refused,) = m.origin.refused
    assert (refused.file, refused.row, refused.column, refused.value) == ("m.csv", 7, column, value)
    assert refused.why == why
    assert len(m) == 19 and 7 not in m.origin.line and np.isfinite(m.readings).all() and np.isfinite(m.rotation).all()


def test_a_refused_row_is_named_once_however_much_is_wrong(write: Callable[..., Path]) -> None:
    table = changed(5, "rail", "")
    table.loc[3, ["x", "qw"]] = ["text", 17]
    assert [(r.row, r.column) for r in load(write(table)).origin.refused] == [(5, "rail")]


def test_quaternions_are_normalised_within_a_thousandth(write: Callable[..., Path]) -> None:
    table = rows()
    table.loc[2, POSE[3:]] *= 1.0009
    table.loc[3, POSE[3:]] *= 1.0011
    table.loc[4, POSE[3:]] = 0.0
    m = load(write(table))
    assert [r.row for r in m.origin.refused] == [5, 6] and [r.value for r in m.origin.refused] == ["1.0011", "0"]
    np.testing.assert_allclose(m.rotation @ m.rotation.transpose(0, 2, 1), np.tile(np.eye(3), (18, 1, 1)), atol=1e-15)
    np.testing.assert_allclose(m.rotation[2], matrices(rows()[POSE[3:]].to_numpy())[2], atol=1e-15)


def test_of_identical_rows_the_first_is_kept(write: Callable[..., Path]) -> None:
    table = pd.concat([rows(5), rows(5).iloc[[1, 1, 3]]]).assign(time=[0, 1, np.nan, 3, 4, 1, 1, 3])
    table["split"] = ["train"] * 5 + ["test"] * 3
    m = load(write(table))
    assert len(m) == 5 and not m.test.any()
    assert [(r.row, r.why) for r in m.origin.refused] == [
        (k, f"identical to line {j}") for k, j in ((7, 3), (8, 3), (9, 5))
    ]
    measured_again = table.assign(time=range(8))
    copies = load(write(measured_again))
    assert len(copies) == 5 and [r.row for r in copies.origin.refused] == [7, 8, 9]
    other = measured_again.assign(temperature=[20.0] * 5 + [20.0, 25.0, 25.0])  # the same bits under another condition
    assert len(load(write(other))) == 7


def test_a_pose_that_did_not_follow_the_joints_is_named(write: Callable[..., Path]) -> None:
    table = rows()
    table.loc[8, POSE] = table.loc[7, POSE]
    table = pd.concat([table, table.iloc[[3]].assign(rail=table["rail"][3] + 5e-5)])
    m = load(write(table))
    assert len(m) == 21 and [(n.row, "line 9" in n.why) for n in m.origin.notices] == [(10, True)]
    assert list(m.origin.line[m.repeats.stale]) == [10]
    later = rows()
    later.loc[15, POSE] = later.loc[4, POSE]
    m = load(write(later))
    assert list(m.origin.line[m.repeats.stale]) == [17] and [(n.row, "line 6" in n.why) for n in m.origin.notices] == [
        (17, True)
    ]


def test_rows_with_too_many_or_too_few_cells_are_named(write: Callable[..., Path]) -> None:
    lines = rows().to_csv(index=False).splitlines()
    lines[4] += ",5"
    lines[9] = lines[9].rpartition(",")[0]
    lines.insert(12, "")
    lines.insert(15, "   ")
    m = load(write("\r\n".join(lines)))
    assert [r.row for r in m.origin.refused] == [5, 10] and "11 cells" in m.origin.refused[0].why
    assert len(m) == 18 and list(m.origin.line) == [k for k in range(2, 24) if k not in (5, 10, 13, 16)]


def test_readings_outside_limits_are_used_and_named(write: Callable[..., Path]) -> None:
    table = rows()
    table.loc[[0, 1], "rail"] = [-0.01, 18.000001]
    table.loc[2, "shoulder"] = 3.2
    table.loc[3, "wrist"] = 400.0
    m = load(write(table))
    assert len(m) == 20
    assert [(n.row, n.column, float(n.value)) for n in m.origin.notices] == [(2, "rail", -0.01), (4, "shoulder", 3.2)]


def test_limits_of_continuous_joints_count_whole_turns(write: Callable[..., Path]) -> None:
    readings = np.array([0.5, 0.5 + 4 * np.pi, -1 - 6 * np.pi, 1.1, 1.1 + 2 * np.pi, np.pi, -1.1 - 40 * np.pi])
    table = rows(7).assign(wrist=readings)
    limits = np.array([[0, 18], [-3, 3], [-1, 1]])
    m = load_measurements(campaign(write(table)), JOINTS, limits, KINDS)
    turned = np.angle(np.exp(1j * readings))
    assert [n.row for n in m.origin.notices if n.column == "wrist"] == list(2 + np.flatnonzero(np.abs(turned) > 1.0001))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"\n\n", "is empty"),
        (b"rail,shoulder,wrist", "no rows"),
        (b"rail,shoulder,wrist\n\n", "no rows"),
        (b"\nrail,shoulder,wrist\n1,2,3\n", "line 1 is empty"),
        (b"rail,rail\n1,2\n", "'rail' is there twice"),
        (b"1.5,2\n1,2\n", "line 1 holds numbers"),
        (b"rail;shoulder\n1,5;2,5\n", "semicolons"),
        (b"rail\tshoulder\n1\t2\n", "tabs"),
        (b"rail,shoulder\n1,5,2,5\n1,6,2,6\n", "Decimal commas"),
        (b"rail,shoulder\n1,\xb52\n", "line 2: is not UTF-8"),
        ("rail,shoulder\n1,2\n".encode("utf-16"), "is not UTF-8"),
        (b'rail,shoulder\n1,"2\n3,4\n', "line 2: a quote"),
    ],
)
def test_a_broken_file_is_one_clear_complaint(write: Callable[..., Path], content: bytes, said: str) -> None:
    path = write(content)
    message = failure(path)
    assert said in message and str(path) in message and "\n" not in message


def test_quoted_decimal_commas_are_recognised(write: Callable[..., Path]) -> None:
    assert "'x' has decimal commas" in failure(write(rows().assign(x=[f"0,{k}" for k in range(20)])))


def test_a_byte_order_mark_and_blanks_do_no_harm(write: Callable[..., Path]) -> None:
    text = rows().to_csv(index=False).replace(",", " , ").replace("\n", "\r\n")
    np.testing.assert_array_equal(load(write(b"\xef\xbb\xbf" + text.encode())).readings, rows()[list(JOINTS)])


def test_missing_files_and_folders_are_named(tmp_path: Path, write: Callable[..., Path]) -> None:
    assert "no such file" in failure(tmp_path / "nothing.csv")
    assert "is a folder" in failure(tmp_path)
    assert "should be a .csv or .parquet" in failure(write(rows().to_csv(index=False), "m.docx"))
    assert "Parquet" in failure(write(b"PAR1 or not", "m.parquet"))


def test_missing_columns_come_with_the_nearest_name_in_the_file(write: Callable[..., Path]) -> None:
    message = failure(write(rows().rename(columns={"shoulder": "sholder", "wrist": "A6"})))
    assert "'shoulder' (did you mean 'sholder'?)" in message and "'wrist'" in message and "A6" in message
    assert "kind: position" in failure(write(rows().drop(columns=POSE[3:])))
    mapped = failure(write(rows()), columns={"rail": "axis_1"})
    assert "'axis_1'" in mapped
    with pytest.raises(CampaignError, match=r"columns\.sholder.*did you mean 'shoulder'"):
        load(write(rows()), columns={"sholder": "A2"})
    with pytest.raises(CampaignError, match="'x' would be two quantities"):
        load(write(rows()), columns={"y": "x"})


def test_if_nothing_is_usable_the_reasons_are_counted(write: Callable[..., Path]) -> None:
    table = rows(6).astype(object)
    table.loc[:3, "x"] = ""
    table.loc[4:, "qw"] = 9
    message = failure(write(table))
    assert "4 x empty" in message and "2 x the norm" in message and "line 2" in message


def test_one_row_and_rows_all_alike_can_be_held(write: Callable[..., Path]) -> None:
    assert len(load(write(rows(1)))) == 1
    m = load(write(pd.concat([rows(1)] * 4)))
    assert len(m) == 1 and len(m.origin.refused) == 3
    stood_still = rows(4).assign(rail=1.0, shoulder=0.0, wrist=0.0)
    assert len(load(write(stood_still))) == 4


def test_rows_that_measure_something_else_need_no_pose(write: Callable[..., Path]) -> None:
    table = rows().drop(columns=POSE).assign(h1=0.25, image=[f"{k}.png" for k in range(20)])
    m = as_read(load_measurements(campaign(write(table)), JOINTS, LIMITS, KINDS, require_pose=False))
    assert np.isnan(m.position).all() and m.rotation is None and m.relative is None and not m.repeats.stale.any()
    np.testing.assert_array_equal(m.readings, table[list(JOINTS)])
    assert list(m.covariates) == ["h1"] and [n.column for n in m.origin.notices] == ["image"]


# ---------------------------------------------------------------- wrong units


def test_degrees_taken_for_radians_are_refused_with_the_remedy(write: Callable[..., Path]) -> None:
    table = rows()
    table[["shoulder", "wrist"]] *= 180 / np.pi
    path = write(table)
    message = failure(path)
    assert "'shoulder'" in message and "cannot be in rad" in message and "units: {angle: deg}" in message
    assert "'wrist'" not in message
    np.testing.assert_allclose(load(path, units={"angle": "deg"}).readings, rows()[list(JOINTS)], rtol=1e-14)


def test_millimetres_taken_for_metres_are_refused_with_the_remedy(write: Callable[..., Path]) -> None:
    table = rows()
    table[["x", "y", "z"]] *= 1000
    message = failure(write(table))
    assert "'x', 'y', 'z'" in message and "cannot be in m" in message and "units: {length: mm}" in message
    rail = rows()
    rail["rail"] *= 1000
    assert "'rail' cannot be in m" in failure(write(rail))


def test_metres_taken_for_millimetres_are_refused_with_the_remedy(write: Callable[..., Path]) -> None:
    assert "units: {length: m}" in failure(write(rows()), units={"length": "mm"})


def test_radians_taken_for_degrees_are_mentioned(write: Callable[..., Path]) -> None:
    assert any("units: {angle: rad}" in n.why for n in load(write(rows()), units={"angle": "deg"}).origin.notices)
    assert not load(write(rows())).origin.notices


def test_euler_angles_in_degrees_are_recognised(write: Callable[..., Path]) -> None:
    angles = Rotation.from_quat(rows()[POSE[3:]]).as_euler("xyz", degrees=True)
    table = rows().assign(rx=angles[:, 0], ry=angles[:, 1], rz=angles[:, 2])
    assert "'rx', 'ry', 'rz' cannot be in rad" in failure(
        write(table), orientation={"euler": "xyz", "columns": ("rx", "ry", "rz")}
    )


def test_a_few_wild_rows_do_not_condemn_the_unit(write: Callable[..., Path]) -> None:
    table = rows()
    table.loc[:2, "shoulder"] = 90.0
    table.loc[:2, "x"] = 900.0
    m = load(write(table))
    assert len(m) == 20 and [n.row for n in m.origin.notices] == [2, 3, 4]


# ---------------------------------------------------------------- blocks and the split


def brute_force_blocks(readings: np.ndarray, same: np.ndarray) -> np.ndarray:
    """Labels by growing each block row by row."""
    label = np.full(len(readings), -1)
    for seed in range(len(readings)):
        front = [seed] if label[seed] < 0 else []
        while front:
            k = front.pop()
            label[k] = seed
            near = (np.abs(readings - readings[k]) <= same).all(axis=1)
            front += np.flatnonzero(near & (label < 0)).tolist()
    return label


def partition(label: np.ndarray) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(label == k).tolist()) for k in set(label.tolist())}


def test_blocks_are_the_repeats_and_their_chains() -> None:
    rng = np.random.default_rng(2)
    same = np.array([1e-4, 1e-3, 1e-3])
    centres = rng.uniform(-1, 1, (40, 3))
    readings = centres[rng.integers(0, 40, 300)] + rng.uniform(-0.4, 0.4, (300, 3)) * same
    chain = np.array([0.5, 0.5, 0.5]) + np.arange(30)[:, None] * 0.9 * same
    readings = np.vstack([readings, chain])
    found = blocks(readings, KINDS)
    assert partition(found) == partition(brute_force_blocks(readings, same))
    assert len(set(found[-30:])) == 1
    assert list(dict.fromkeys(found)) == list(range(found.max() + 1))


def test_rows_within_the_tolerance_are_never_parted_and_distant_ones_never_joined() -> None:
    rng = np.random.default_rng(3)
    first = rng.uniform(-3, 3, (400, 3))
    offset = rng.uniform(-1, 1, (400, 3)) * [1e-4, 1e-3, 1e-3]
    label = blocks(np.vstack([first, first + offset, first + [0, 1.6e-3, 0]]), KINDS).reshape(3, 400)
    np.testing.assert_array_equal(label[0], label[1])
    assert (blocks(np.vstack([first, first + [0, 1.6e-3, 0]]), KINDS).reshape(2, 400)[1] >= 400).all()


def test_whole_turns_of_a_continuous_joint_repeat_a_configuration() -> None:
    readings = np.array([[1.0, 0.5, 3.1], [1.0, 0.5, 3.1 - 2 * np.pi], [1.0, 0.5 + 2 * np.pi, 3.1]])
    assert list(blocks(readings, KINDS)) == [0, 0, 1]


def test_many_noisy_repeats_of_few_configurations_stay_cheap() -> None:
    rng = np.random.default_rng(4)
    centre = rng.integers(0, 5, 20000)
    readings = rng.uniform(-3, 3, (5, 6))[centre] + rng.normal(0, 1e-4, (20000, 6))
    assert len(partition(blocks(readings, ["revolute"] * 6)) ^ partition(centre)) == 0


@pytest.mark.parametrize("n", [2, 3, 5, 50, 503])
def test_a_fifth_of_the_rows_is_kept_for_the_test(write: Callable[..., Path], n: int) -> None:
    m = load(write(rows(n)))
    assert m.test.sum() == max(1, round(n / 5))


def test_repeats_stay_on_one_side_of_the_split(write: Callable[..., Path]) -> None:
    rng = np.random.default_rng(5)
    config = rng.integers(0, 60, 300)
    table = rows(300)
    table[list(JOINTS)] = rows(60)[list(JOINTS)].to_numpy()[config] + rng.uniform(-4e-5, 4e-5, (300, 3))
    for seed in range(5):
        test = load(write(table), seed=seed).test
        assert not set(config[test]) & set(config[~test])
        assert 50 <= test.sum() <= 60


@pytest.mark.parametrize("sizes", [(1, 1), (9, 1), (50, 50), (90, 5, 5)])
def test_few_blocks_leave_neither_part_empty(write: Callable[..., Path], sizes: tuple[int, ...]) -> None:
    config = np.repeat(np.arange(len(sizes)), sizes)
    table = rows(len(config))
    table[list(JOINTS)] = rows(len(sizes))[list(JOINTS)].to_numpy()[config]
    test = load(write(table)).test
    assert 0 < test.sum() < len(test) and not set(config[test]) & set(config[~test])


def test_the_split_is_that_of_its_seed(write: Callable[..., Path]) -> None:
    path = write(rows(100))
    np.testing.assert_array_equal(load(path, seed=3).test, load(path, seed=3).test)
    assert (load(path, seed=3).test != load(path, seed=4).test).any()
    share = np.mean([load(path, seed=s).test for s in range(60)], axis=0)
    assert share.min() > 0 and share.max() < 0.6  # every row has its turn


def test_a_split_column_is_obeyed_and_other_words_are_refused(write: Callable[..., Path]) -> None:
    m = load(write(rows(5).assign(split=["train", "test", "Test", "", "train"])))
    assert list(m.test) == [False, True, False] and [(r.row, r.value) for r in m.origin.refused] == [
        (4, "Test"),
        (5, ""),
    ]


# ---------------------------------------------------------------- stations


def test_frames_per_station_need_their_label(write: Callable[..., Path]) -> None:
    frames = {"world_base": {"per": "station"}}
    with pytest.raises(MeasurementError, match=r"'station'.*per: station"):
        load(write(rows()), frames=frames)
    table = rows(4).assign(station=["north", "", "7", "north"])
    m = load(write(table), frames=frames)
    assert m.labels.station is not None and list(m.labels.station) == ["north", "7", "north"]
    assert [(r.row, r.column, r.why) for r in m.origin.refused] == [(3, "station", "empty")]
    assert len(load(write(table))) == 4


# ---------------------------------------------------------------- queries


def query_of(path: Path, **options: Any):
    return load_query(path, JOINTS, LIMITS, KINDS, **options)


def test_a_query_keeps_every_row_and_column_as_written(write: Callable[..., Path]) -> None:
    text = "note,wrist,rail,shoulder,temperature\nfirst,0.10,1.000,0,20\n,,2,1,\nlast,0.3,3,1e-1,22.50\n"
    query = query_of(write(text))
    back = query.table.to_csv(index=False)
    assert pd.read_csv(io.StringIO(back), dtype=str).equals(pd.read_csv(io.StringIO(text), dtype=str))
    assert list(query.usable) == [True, False, True] and query.position is None
    np.testing.assert_array_equal(query.readings, [[1, 0, 0.1], [np.nan] * 3, [3, 0.1, 0.3]])
    np.testing.assert_array_equal(query.covariates["temperature"], [20, np.nan, 22.5])
    assert [(r.row, r.column, r.value) for r in query.refused] == [(3, "wrist", "")]


def test_wanted_poses_need_no_readings_but_take_them_as_seeds(write: Callable[..., Path]) -> None:
    table = rows(4)[POSE].assign(shoulder=["0.5", "", "nan", "1"])
    query = query_of(write(table), poses=True)
    assert query.usable.all() and query.position is not None and query.quaternion is not None
    np.testing.assert_array_equal(query.readings[:, 1], [0.5, np.nan, np.nan, 1])
    assert np.isnan(query.readings[:, [0, 2]]).all()
    np.testing.assert_array_equal(query.position, table[POSE[:3]])
    with pytest.raises(MeasurementError, match="'qw'"):
        query_of(write(table.drop(columns="qw")), poses=True)


@pytest.mark.parametrize("poses", [False, True])
def test_a_word_among_the_joints_of_a_query_is_refused(poses: bool, write: Callable[..., Path]) -> None:
    table = rows(4).assign(shoulder=["0.5", "", "what", "1"])
    with pytest.raises(MeasurementError, match="line 4: column 'shoulder', what: not a number"):
        query_of(write(table), poses=poses)


def test_a_hole_in_a_covariate_that_is_needed_is_refused(write: Callable[..., Path]) -> None:
    path = write(rows(3).assign(temperature=[20, None, 21], humidity=[None, 1, 2]))
    assert query_of(path).usable.all()
    with pytest.raises(MeasurementError, match="line 3: column 'temperature': missing; the calibration has an effect"):
        query_of(path, needs=["temperature"])


def test_a_query_in_other_units_and_names_is_read_as_its_campaign_was(write: Callable[..., Path]) -> None:
    table = rows()
    path = write((table * [1000, 57.29577951308232, 57.29577951308232, *[1] * 7]).rename(columns={"rail": "E1"}))
    job = campaign(path, units={"length": "mm", "angle": "deg"}, columns={"rail": "E1"})
    np.testing.assert_allclose(query_of(path, settings=job.measurements).readings, table[list(JOINTS)], rtol=1e-14)


def test_a_query_with_a_broken_row_is_refused_whole(write: Callable[..., Path]) -> None:
    with pytest.raises(MeasurementError, match="line 3"):
        query_of(write("rail,shoulder,wrist\n1,2,3\n1,2\n"))


# ---------------------------------------------------------------- size, and the real thing


def test_a_hundred_thousand_rows_are_read_whole(write: Callable[..., Path]) -> None:
    table = rows(100_000)
    m = load(write(table, "big.parquet"))
    assert len(m) == 100_000 and m.test.sum() == 20_000 and not m.origin.refused
    np.testing.assert_array_equal(m.position, table[POSE[:3]])


def test_the_public_ur10_series_are_read_and_their_stale_rows_named(shared_data: Path) -> None:
    """Rows, covariates, repeats and stale readings as the data set's README states them."""
    joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", *(f"wrist_{k}_joint" for k in (1, 2, 3))]
    limits = np.tile([-2 * np.pi, 2 * np.pi], (6, 1))
    kinds: list[Any] = ["revolute"] * 6
    for series, count in (("b", 1495), ("d", 632)):
        path = shared_data / "ur10-laser-tracker" / f"series_{series}.csv"
        m = as_read(load_measurements(campaign(path, ignore=["sequence"]), joints, limits, kinds))
        assert len(m) == count and not m.origin.refused and set(m.covariates) == {"temperature"}
        stale = [n.row for n in m.origin.notices]
        sequence = pd.read_csv(path)["sequence"].to_numpy()
        assert list(m.origin.line[m.repeats.stale]) == [row for row in stale if row]
        assert [sequence[row - 2] for row in stale if row] == ([532, 1063] if series == "b" else [])
        if series == "b":
            repeated = np.bincount(m.repeats.configuration) > 1
            assert repeated.sum() == 293
