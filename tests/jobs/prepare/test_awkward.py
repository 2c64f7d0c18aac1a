"""Tables as people and programs write them: read rightly, or asked about; what `init` wrote is all that is needed."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from awkward import judged, known
from awkward_hostile import CASES
from awkward_tables import RIGHT, kuka, plain, robot_calibration, series_b, text, workbook
from repository import ROOT
from scipy.spatial.transform import Rotation

import aridcal
import aridcal.init
from aridcal.engine.robot.chain import load_robot
from aridcal.files.campaign import load_campaign
from aridcal.files.formats.makers import maker
from aridcal.files.formats.number_marks import is_number, marks
from aridcal.files.read import load_measurements
from aridcal.files.tables import read_tables
from aridcal.jobs.prepare.campaign_text import draft
from aridcal.jobs.prepare.guesses import OpenChoice, leave_open
from aridcal.system.errors import AridcalError, MeasurementError
from aridcal.system.reading.dates import orders, seconds
from aridcal.system.reading.dialect import Dates, Dialect
from aridcal.system.reading.regular_files import Limit

SHARED = ROOT.parent / "shared" / "data" / "ur10-laser-tracker"

EVERY = {case.name: case for case in CASES}

HERE = (
    "plain.csv", "thousands_points.csv", "three_decimals.csv", "utf16le.txt", "merged.csv", "log.csv", "footer.csv", "form.xlsx",
    "typed.xlsx", "german.csv", "mixed_units.csv", "matrix16.csv", "ur_lists.csv", "two_bodies.csv", "spatialanalyzer.txt",
    "polyworks.txt", "leica.csv", "faro.csv", "api.txt", "vicon.csv", "motive.csv", "qualisys.tsv", "ndi.csv", "robodk.csv",
    "samples.yaml", "sa_alone.txt", "mixed_decimals.csv", "no_header.csv", "two_poses.csv", "still.csv", "either.csv",
    "entities.xlsx", "twice.csv",
)  # fmt: skip
"""Those of which one stands for its like; `python benchmarks/awkward.py` reads all."""


@pytest.mark.parametrize("name", HERE)
def test_an_awkward_table_is_read_rightly_or_asked_about(name: str, tmp_path: Path) -> None:
    found, why = judged(EVERY[name], tmp_path)
    assert found == EVERY[name].expected, why


def test_no_case_is_expected_to_be_wrong_and_there_are_enough() -> None:
    assert len(CASES) >= 60 and len(EVERY) == len(CASES)
    assert {case.expected for case in CASES} == {RIGHT, "asked"}


def read_by(out: Path, files: list[Path] | None = None):
    campaign = load_campaign(out)
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base)
    rows = load_measurements(campaign, robot.readings, robot.limits, robot.kinds, files=files)
    return rows.select(rows.as_read)


def proposed(path: Path, settled: dict[str, int] | None = None) -> Path:
    out = path.with_suffix(".campaign.yaml")
    made = draft(known("ur10").urdf, [path], out, leave_open, settled)
    out.write_text(made.campaign.text, encoding="utf-8")
    return out


# ---------------------------------------------------------------- the real series


@pytest.mark.skipif(not SHARED.exists(), reason="needs the shared measurements")
def test_the_ur10_series_in_its_original_layout_is_read_as_the_converted_file_is(tmp_path: Path) -> None:
    """Decimal commas, mm, degrees beside radians, Euler angles, commanded poses, spoilt time stamps; second road: convert.py."""
    table = pd.read_csv(SHARED / "series_b.csv")
    goal = pd.read_csv(SHARED / "series_b_commanded.csv")
    rest = {
        "goal": np.hstack([
            goal[["goal_x", "goal_y", "goal_z"]],
            Rotation.from_quat(goal[["goal_qx", "goal_qy", "goal_qz", "goal_qw"]]).as_euler("XYZ"),
        ]),
        "temperature": table["temperature"].to_numpy(),
        "std": table[["std_x", "std_y", "std_z", "std_rx", "std_ry", "std_rz"]].to_numpy(),
    }  # fmt: skip
    joints = table[[name for name in table if name.endswith("_joint")]].to_numpy()
    R = Rotation.from_quat(table[["qx", "qy", "qz", "qw"]])
    path = tmp_path / "measurements_joint_configurations.csv"
    path.write_bytes(series_b(joints, table[["x", "y", "z"]].to_numpy(), R, rest))
    converted = ROOT / "identification" / "ur10-laser-tracker" / "campaign-b.yaml"
    ours, theirs = read_by(proposed(path)), read_by(converted)
    assert len(ours) == len(theirs) > 1400
    np.testing.assert_array_equal(ours.origin.line, theirs.origin.line)
    np.testing.assert_allclose(ours.readings, theirs.readings, atol=1e-12)
    np.testing.assert_allclose(ours.position, theirs.position, atol=1e-12)
    assert ours.rotation is not None and theirs.rotation is not None
    np.testing.assert_allclose(ours.rotation, theirs.rotation, atol=1e-9)
    assert list(ours.covariates) == list(theirs.covariates) == ["temperature"]
    np.testing.assert_array_equal(ours.covariates["temperature"], theirs.covariates["temperature"])
    np.testing.assert_array_equal(ours.test, theirs.test)
    np.testing.assert_array_equal(ours.repeats.configuration, theirs.repeats.configuration)
    np.testing.assert_array_equal(ours.repeats.stale, theirs.repeats.stale)


# ---------------------------------------------------------------- questions and their answers


def test_a_question_names_its_key_and_the_answer_given_beforehand_is_kept(tmp_path: Path, capsys, monkeypatch) -> None:
    path = tmp_path / "m.csv"
    path.write_bytes(EVERY["two_poses.csv"].write(known("ur10")))
    monkeypatch.setattr("sys.stdin", io.StringIO())
    arguments = ["--urdf", str(known("ur10").urdf), "--measurements", str(path), "-o", str(tmp_path / "c.yaml")]
    assert aridcal.init.main(arguments) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "`--set columns=NUMBER`: 1 = a_x a_y a_z; 2 = b_x b_y b_z" in said
    assert not (tmp_path / "c.yaml").exists()
    assert aridcal.init.main([*arguments, "--set", "columns=1"]) == 0
    np.testing.assert_allclose(read_by(tmp_path / "c.yaml").position, known("ur10").p, atol=1e-12)
    for wrong, why in (("columns=3", "from 1 to 2"), ("colums=1", "did you mean 'columns'")):
        assert aridcal.init.main([*arguments[:-1], str(tmp_path / "d.yaml"), "--set", wrong]) == 2
        assert why in capsys.readouterr().err
    with pytest.raises(OpenChoice, match="columns"):
        aridcal.propose(known("ur10").urdf, path)
    assert "x: b_x" in aridcal.propose(known("ur10").urdf, path, {"columns": 2}).text


# ---------------------------------------------------------------- later tables


def test_a_later_table_needs_nothing_that_is_ignored_and_may_be_plain(tmp_path: Path) -> None:
    """New rows in the file's own dialect without the ignored columns, and as plain csv that a command wrote."""
    t = known("ur10")
    n = len(t.q)
    extra = {"no": np.arange(n), "remark": np.array(["fine"] * n), "tracker std x": 1e-3 * t.p[:, 0] ** 2}
    path = tmp_path / "m.csv"
    path.write_bytes(text(extra | kuka(t), ";", ",", units=["-", "-", "mm"] + ["deg"] * 6 + ["mm"] * 3 + ["deg"] * 3))
    out = proposed(path)
    keys = yaml.safe_load(out.read_text())["measurements"]
    assert set(keys["ignore"]) == {"no", "remark -", "tracker std x mm"} or set(keys["ignore"]) >= {"tracker std x mm"}
    later = tmp_path / "later.csv"
    later.write_bytes(text(kuka(t), ";", ",", units=["deg"] * 6 + ["mm"] * 3 + ["deg"] * 3))
    names = pd.read_csv(later, sep=";", header=[0, 1]).columns
    plainly = pd.DataFrame(dict(zip([" ".join(name) for name in names], kuka(t).values(), strict=True)))
    plainly.to_csv(tmp_path / "plain.csv", index=False)
    own = read_by(out)
    for other in (later, tmp_path / "plain.csv"):
        rows = read_by(out, [other])
        np.testing.assert_allclose(rows.readings, own.readings, atol=1e-12)
        np.testing.assert_allclose(rows.position, own.position, atol=1e-12)
        assert not rows.origin.refused and not [note for note in rows.origin.notices if "ignore" in note.why]


def test_a_later_table_without_its_line_of_units_loses_no_row(tmp_path: Path) -> None:
    """The attack: its first row stands where the units were."""
    t = known("ur10")
    path = tmp_path / "m.csv"
    path.write_bytes(text(kuka(t), ";", ",", units=["[°]"] * 6 + ["[mm]"] * 3 + ["[°]"] * 3))
    out = proposed(path)
    text_now = out.read_text().replace("header: [1, 2]", "header: [1], first_row: 3")
    out.write_text(text_now)
    path.write_bytes(text(kuka(t), ";", ","))
    with pytest.raises(MeasurementError, match=r"line 2: holds numbers, but `table.first_row` is 3"):
        read_by(out)


def test_a_later_table_with_points_among_commas_is_refused_not_read(tmp_path: Path) -> None:
    t = known("ur10")
    path = tmp_path / "m.csv"
    path.write_bytes(text(kuka(t), ";", ","))
    out = proposed(path)
    path.write_bytes(text(kuka(t), ";", "."))
    with pytest.raises(AridcalError, match=r"'A1' has numbers that `table` does not describe, '-?\d+\.\d+'"):
        read_by(out)


def test_two_files_of_one_campaign_are_written_alike(tmp_path: Path) -> None:
    t = known("ur10")
    (tmp_path / "a.csv").write_bytes(text(kuka(t), ";", ","))
    (tmp_path / "b.csv").write_bytes(text(kuka(t), "\t", ","))
    with pytest.raises(MeasurementError, match=r"b\.csv: is not written as .*a\.csv is .*tabs.*semicolons"):
        draft(t.urdf, [tmp_path / "a.csv", tmp_path / "b.csv"], tmp_path / "c.yaml", leave_open)


# ---------------------------------------------------------------- numbers, dates, makers


@pytest.mark.parametrize(
    ("cells", "found"),
    [
        (["1.5", "2"], [(".", "")]),
        (["1,5", "2"], [(",", "")]),
        (["1.234,5", "2"], [(",", ".")]),
        (["1,234.5", "0.5"], [(".", ",")]),
        (["1'234.5"], [(".", "'")]),
        (["1 234,5"], [(",", " ")]),
        (["1.234.567", "1,5"], [(",", ".")]),
        (["0,123"], [(",", "")]),
        (["1,234"], [(",", ""), (".", ",")]),
        (["1.234"], [(".", ""), (",", ".")]),
        (["12", "3"], [(".", "")]),
        (["1e5", "2,5E-3"], [(",", "")]),
    ],
)
def test_marks_of_numbers_are_proven_or_left_open(cells: list[str], found: list[tuple[str, str]]) -> None:
    assert all(map(is_number, cells))
    assert marks(cells, "m.csv") == found


@pytest.mark.parametrize(
    "cell", ["", "-", "n/a", "01.02.2024", "1.2.3", "1,23,4", "12:30", "1..2", "e5", "1 2", "0x10"]
)
def test_what_is_no_number_in_any_dialect_is_none(cell: str) -> None:
    assert not is_number(cell)


STYLES = (
    "%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p", "%d-%b-%Y %H:%M",
    "%Y%m%d %H:%M:%S",
)  # fmt: skip


@pytest.mark.parametrize("style", STYLES)
def test_dates_are_what_the_standard_library_reads(style: str) -> None:
    """Second road: Python's own strptime."""
    from datetime import UTC, datetime

    order = {"%d": "dmy", "%m": "mdy", "%Y": "ymd"}[style[:2]]
    for when in ("2024-02-29 00:00:01.5", "1999-12-31 23:59:59", "2031-10-05 12:07:00"):
        cell = pd.Timestamp(when).strftime(style)
        theirs = datetime.strptime(cell, style).replace(tzinfo=UTC).timestamp()
        assert seconds(cell, order) == pytest.approx(theirs, abs=1e-6)


def test_no_date_is_bent_into_another_order() -> None:
    assert orders(["25/03/2024"]) == ("dmy",) and orders(["03/25/2024"]) == ("mdy",)
    assert orders(["03/04/2024", "25/04/2024"]) == ("dmy",)
    for cell in ("31/02/2024", "32.01.2024", "12:60", "24:00:00", "13:00 PM", "2024-13-01", "1/2/345", "24-03-01x"):
        assert all(seconds(cell, order) is None for order in ("ymd", "dmy", "mdy"))
    assert seconds("2024-03-01T10:00:00+02:00", "ymd") == seconds("2024-03-01T08:00:00Z", "ymd")


def test_makers_are_told_by_what_they_write_and_no_plain_table_is_one() -> None:
    t = known("ur10")
    for name, who in {
        "spatialanalyzer.txt": "SpatialAnalyzer", "polyworks.txt": "PolyWorks", "leica.csv": "Leica/Hexagon", "faro.csv": "FARO",
        "api.txt": "API", "vicon.csv": "Vicon", "motive.csv": "OptiTrack Motive", "qualisys.tsv": "Qualisys Track Manager",
        "ndi.csv": "NDI", "robodk.csv": "RoboDK",
    }.items():  # fmt: skip
        assert maker(EVERY[name].write(t).decode().splitlines()[:40]) == who
    assert maker(text(plain(t)).decode().splitlines()) == ""


# ---------------------------------------------------------------- what is made to harm


def test_a_workbook_that_unpacks_to_too_much_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "m.xlsx"
    content = workbook({"a": [["x", "y"], *[[1.5, 0.0]] * 5_000]})
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match=r"unpacks to .* MB, at most 0\.2 MB"):
        read_tables([path], limit=Limit(0.05))
    path.write_bytes(content[:-300])
    with pytest.raises(MeasurementError, match="is no readable workbook"):
        read_tables([path])


def test_a_sheet_whose_row_has_a_huge_number_makes_no_rows_up(tmp_path: Path) -> None:
    import zipfile

    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(workbook({"a": [["x"], [1.0]]}))) as book, zipfile.ZipFile(out, "w") as spoilt:
        for name in book.namelist():
            content = book.read(name)
            if name.endswith("sheet1.xml"):
                content = content.replace(b'r="2"', b'r="999999999999"').replace(b'"A2"', b'"A999999999999"')
            spoilt.writestr(name, content)
    (tmp_path / "m.xlsx").write_bytes(out.getvalue())
    with pytest.raises(MeasurementError, match=r"20,000 empty rows"):
        read_tables([tmp_path / "m.xlsx"])


def test_lists_and_dates_that_are_not_there_are_named(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("a;b\n1;2024-01-02\n")
    for dialect in (
        Dialect(separator=";", lists={"c": ("x", "y")}), Dialect(separator=";", dates=Dates("ymd", ("day",))),
    ):  # fmt: skip
        with pytest.raises(MeasurementError, match=r"no column '(c|day)', which `table"):
            read_tables([tmp_path / "m.csv"], dialect=dialect)
    (tmp_path / "m.csv").write_text("a;b\n1;2024-01-02\n2;soon\n")
    with pytest.raises(MeasurementError, match="line 3: column 'b', soon: is no date"):
        read_tables([tmp_path / "m.csv"], dialect=Dialect(separator=";", dates=Dates("ymd", ("b",))))


NONSENSE = (
    "{decimal: x}", "{encoding: nowhere}", "{encoding: base64}", "{header: 0}", "{header: [3], first_row: 2}",
    "{separator: tabs}", "{decimal: ',', thousands: ','}", "{dates: {columns: []}}",
)  # fmt: skip


@pytest.mark.parametrize("table", NONSENSE)
def test_a_table_key_that_says_nothing_is_refused_by_name(table: str, tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        f"format: 1\nrobot: {{urdf: r.urdf, tip: t}}\nmeasurements: {{file: m.csv, table: {table}}}\n"
    )
    with pytest.raises(AridcalError, match=r"line 3: measurements.table"):
        load_campaign(tmp_path / "c.yaml")


def test_samples_of_robot_calibration_with_several_points_are_several_targets(tmp_path: Path) -> None:
    t = known("ur10")
    content = robot_calibration(t).decode().replace("sensor_name: arm", "sensor_name: hand")
    lines = []
    for line in content.splitlines():
        lines.append(line)
        if "frame_id: world" in line:
            lines.append(line.replace("x: ", "x: 0").replace("x: 0-", "x: -"))
    (tmp_path / "s.yaml").write_text("\n".join(lines))
    table = read_tables([tmp_path / "s.yaml"], dialect=Dialect(export="robot_calibration", sheet="tracker"))
    assert set(table.texts("target")) == {"1", "2"} and len(table) == 2 * len(t.q)
    np.testing.assert_array_equal(table.matrix(t.robot.readings)[::2], t.q)
    with pytest.raises(MeasurementError, match="no sample has points of 'laser'; there are hand, tracker"):
        read_tables([tmp_path / "s.yaml"], dialect=Dialect(export="robot_calibration", sheet="laser"))


@pytest.mark.parametrize("writing", ["degrees beside radians", "matrices"])
def test_predictions_come_in_the_tables_own_units_and_are_read_again(writing: str, tmp_path: Path) -> None:
    """Orientations in degrees beside joints in rad, or as matrices; second road: back to the joints through the inverse."""
    t = known("ur10")
    joints = {f"q{k + 1}": t.q[:, k] for k in range(6)}
    place = {f"P{a}": 1e3 * t.p[:, k] for k, a in enumerate("xyz")}
    if writing == "matrices":
        R = t.R.as_matrix()
        turn = {f"R{i + 1}{j + 1}": R[:, i, j] for i in range(3) for j in range(3)}
    else:
        turn = dict(zip("ABC", t.R.as_euler("ZYX", degrees=True).T, strict=True))
    path = tmp_path / "m.txt"
    path.write_bytes(text(joints | place | turn, ";", ","))
    out = proposed(path)
    out.write_text(out.read_text() + "diagnosis: {enabled: false}\nparameters: {set: none}\n")
    cal = aridcal.calibrate(out)
    (tmp_path / "q.txt").write_bytes(text(joints, ";", ","))
    pd.DataFrame(joints).to_csv(tmp_path / "q.csv", index=False)
    own, plainly = cal.predict(tmp_path / "q.txt"), cal.predict(tmp_path / "q.csv")
    for name in (*place, *turn):
        np.testing.assert_allclose(own[name].astype(float), plainly[name].astype(float), atol=1e-9)
        assert (
            np.abs(own[name].astype(float) - (place | turn)[name]).max() < 60
        )  # zeros a milliradian off, mm and degrees
    own.to_csv(tmp_path / "poses.csv", index=False)
    back = cal.compensate(tmp_path / "poses.csv")
    assert back["reached"].all()
    np.testing.assert_allclose(back[list(joints)].astype(float), pd.DataFrame(joints), atol=1e-6)


def test_a_wrong_reading_of_matrices_is_refused_by_identify(tmp_path: Path) -> None:
    """The attack: a key of a campaign that was changed by hand after `init` had it right."""
    t = known("ur10")
    R = t.R.as_matrix()
    joints = {f"q{k + 1}": t.q[:, k] for k in range(6)}
    place = {a: t.p[:, k] for k, a in enumerate("xyz")}
    path = tmp_path / "m.csv"
    path.write_bytes(text(joints | place | {f"r{i + 1}{j + 1}": R[:, i, j] for i in range(3) for j in range(3)}))
    out = proposed(path)
    right = "[r11, r12, r13, r21, r22, r23, r31, r32, r33]"
    assert right in out.read_text()
    out.write_text(out.read_text().replace(right, "[r11, r21, r31, r12, r22, r32, r13, r23, r33]"))
    with pytest.raises(AridcalError, match="orientations of the world in the target"):
        aridcal.calibrate(out)


def test_a_file_that_ends_before_its_first_row_has_no_rows(tmp_path: Path) -> None:
    """The attack: the last line of a short file stands where names are, and would be a row as well."""
    (tmp_path / "m.csv").write_text("a;b\n1;2\n3;4")
    for header, first in (((3,), 0), ((1,), 6), ((3,), 5)):
        with pytest.raises(MeasurementError, match=r"no rows|holds numbers"):
            read_tables([tmp_path / "m.csv"], dialect=Dialect(separator=";", header=header, first_row=first))
    with pytest.raises(MeasurementError, match="no header in line 4"):
        read_tables([tmp_path / "m.csv"], dialect=Dialect(separator=";", header=(4,)))
    read = read_tables([tmp_path / "m.csv"], dialect=Dialect(separator=";", header=(), names=("a", "b"), first_row=2))
    assert read.line.tolist() == [2, 3] and read.numbers("b")[0].tolist() == [2.0, 4.0]


def test_a_unit_of_a_column_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_bytes(EVERY["mixed_units.csv"].write(known("ur10")))
    out = proposed(path)
    out.write_text(out.read_text().replace("pitch: deg", "pich: deg"))
    with pytest.raises(AridcalError, match=r"units.columns.pich: there is no such column.*'pitch'"):
        read_by(out)
    out.write_text(out.read_text().replace("pich: deg", "pitch: mm"))
    with pytest.raises(AridcalError, match=r"units.columns.pitch: mm is no unit of angle"):
        read_by(out)
