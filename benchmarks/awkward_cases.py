"""Layouts of people, of controllers and of measuring systems for `awkward.py`: each is read without a question."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from awkward_tables import (
    Case,
    Truth,
    _clock,
    _euler,
    _joints,
    _matrix,
    _number,
    _pose4,
    _rows,
    _three,
    api,
    faro,
    kuka,
    leica,
    mm,
    motive,
    ndi,
    plain,
    polyworks,
    qualisys,
    robodk,
    robot_calibration,
    spatial_analyzer,
    text,
    vicon,
    workbook,
)


def _but(*missing: int) -> Callable[[int], np.ndarray]:
    return lambda n: np.setdiff1d(np.arange(n), missing)


def _listed(values: np.ndarray, before: str = "[", after: str = "]", between: str = ", ") -> np.ndarray:
    return np.array([before + between.join(repr(float(v)) for v in row) + after for row in values])


def _stacked(*parts: dict) -> dict:
    made: dict = {}
    for part in parts:
        made |= part
    return made


def _fixed(t: Truth) -> bytes:
    """Columns of fixed width, padded with blanks."""
    table = mm(t)
    lines = ["".join(f"{name:>14s}" for name in table)]
    lines += ["".join(f"{v:14.7f}" for v in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(lines).encode()


def _numpy_text(t: Truth) -> bytes:
    """As numpy.savetxt writes it, the header a comment."""
    table = plain(t)
    lines = ["# " + " ".join(table)]
    lines += [" ".join(f"{v:.18e}" for v in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(lines).encode()


def _two_lines(t: Truth) -> bytes:
    table = kuka(t)
    above = ";".join(["Joints"] * 6 + ["Tracker"] * 3 + ["Tracker"] * 3)
    names = ";".join(["1", "2", "3", "4", "5", "6", "X", "Y", "Z", "A", "B", "C"])
    return text(table, ";", ",", above=[above, names], header=False)


def _merged(t: Truth) -> bytes:
    """Merged cells above, empty ones beside them, and units below the names."""
    table = _stacked(
        _joints(t, "J{}", deg=True), _three("x y z", 1e3 * t.p), _three("cx cy cz", 1e3 * np.round(t.p, 2))
    )
    above = ["Joint" + "," * 6 + "Measured,,,Commanded,,"]
    above += [
        ",".join(["1", "2", "3", "4", "5", "6", "X", "Y", "Z", "X", "Y", "Z"]),
        ",".join(["deg"] * 6 + ["mm"] * 6),
    ]
    return text(table, above=above, header=False)


def _xlsx(t: Truth) -> bytes:
    return workbook({"Messung": _rows(kuka(t))})


def _xlsx_form(t: Truth) -> bytes:
    """A form: a title, the date, an empty line, merged names, units, rows, a mean; notes on another sheet."""
    table = kuka(t)
    rows: list[list[object]] = [["Measurement of robot 7"], ["Date", pd.Timestamp("2024-03-14").to_pydatetime()], []]
    units = ["°"] * 6 + ["mm"] * 3 + ["°"] * 3
    rows += [[*table], [*units], *_rows(table)[1:]]
    rows.append(["Mean", *[float(np.mean(v)) for v in list(table.values())[1:]]])
    return workbook({"Notes": [["Everything fine"], ["see mail"]], "Data": rows})


def _xlsx_text(t: Truth) -> bytes:
    """Numbers typed as text with decimal commas, beside numbers."""
    rows = _rows(kuka(t))
    for row in rows[1:]:
        row[6:9] = [_number(v, ",") for v in row[6:9]]
    return workbook({"Tabelle1": rows})


def _xlsx_dates(t: Truth) -> bytes:
    rows = _rows(kuka(t))
    when = [None, *_clock(len(t.q)).to_pydatetime()]
    return workbook({"Tabelle1": [["Zeitstempel" if k == 0 else when[k], *row] for k, row in enumerate(rows)]})


def _footer(t: Truth) -> bytes:
    table = {"no": np.arange(1, len(t.q) + 1)} | kuka(t)
    means = ",".join(repr(float(np.mean(v))) for v in list(table.values())[1:])
    stds = ",".join(repr(float(np.std(v))) for v in list(table.values())[1:])
    return text(table, below=["", f"Mean,{means}", f"Std,{stds}", "End of report"])


def _dated(t: Truth, style: str) -> bytes:
    return text({"Time": _clock(len(t.q)).strftime(style).to_numpy()} | plain(t))


def _log(t: Truth) -> bytes:
    """A log: level and source before each row, text lines in between."""
    table = plain(t)
    lines = ["# robot log 1.4, started 2024-03-14", "# " + ",".join(table)]
    for k, row in enumerate(zip(*table.values(), strict=True)):
        lines.append(",".join(repr(float(v)) for v in row))
        if k % 7 == 3:
            lines.append("# paused by the operator")
    return "\n".join(lines).encode()


def _restarted(t: Truth) -> bytes:
    """A log that was appended to, with its header again in the middle."""
    lines = text(kuka(t), ";", ",").decode().splitlines()
    return "\n".join([*lines[:10], "", lines[0], *lines[10:]]).encode()


def _rtde(t: Truth) -> bytes:
    """UR's real-time data: targets, actual joints, the tracker's pose as a rotation vector, blanks between."""
    rng = np.random.default_rng(3)
    table = {"timestamp": 1000.0 + 0.5 * np.arange(len(t.q))}
    table |= {f"target_q_{k}": t.q[:, k] + 1e-4 * rng.normal(size=len(t.q)) for k in range(6)}
    table |= {f"actual_q_{k}": t.q[:, k] for k in range(6)}
    table |= {f"actual_current_{k}": rng.normal(size=len(t.q)) for k in range(6)}
    table |= _three("leica_x leica_y leica_z", t.p) | _three("leica_rx leica_ry leica_rz", t.R.as_rotvec())
    return text(table, " ")


def _milliseconds(t: Truth) -> bytes:
    return text({"time [ms]": 1000.0 * np.arange(len(t.q)) + 0.5} | plain(t))


def _two_bodies(t: Truth) -> bytes:
    """A body on the tool and one on the floor, which drifts a little."""
    rng = np.random.default_rng(5)
    floor = np.array([0.3, -0.2, 0.1]) + 1e-4 * rng.normal(size=t.p.shape)
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(t.q), 1))
    table = _joints(t) | _three("floor_x floor_y floor_z", floor) | _three("floor_qx floor_qy floor_qz floor_qw", still)
    return text(table | _three("tool_x tool_y tool_z", t.p) | _three("tool_qx tool_qy tool_qz tool_qw", t.R.as_quat()))


def _three_decimals(t: Truth) -> bytes:
    """Positions in mm with three decimals and commas, joints in degrees likewise: 123,456 may be either."""
    table = {name: np.array([_number(float(v), ",", digits=3) for v in values]) for name, values in mm(t).items()}
    return text(table, ";")


def _holes(t: Truth) -> bytes:
    """Words and dashes for what was not measured."""
    table = {name: np.array([repr(v) for v in values.tolist()], dtype=object) for name, values in mm(t).items()}
    table["x"][3], table["y"][5], table["q2"][7] = "n/a", "---", ""
    return text(table)


def _sentinel(t: Truth) -> bytes:
    table = {name: values.copy() for name, values in mm(t).items()}
    for name in "xyz":
        table[name][4] = -1e30
    return text(table)


def _quoted_names(t: Truth) -> bytes:
    table = {f"Gelenk {k + 1} (°)": np.degrees(t.q[:, k]) for k in range(6)}
    return text(table | _three("X_Position Y_Position Z_Position", 1e3 * t.p), ";", ",", encoding="cp1252", quote=True)


def _unicode_minus(t: Truth) -> bytes:
    return text(mm(t), ";", ",").decode().replace("-", "−").encode()


def _wide_matrix(t: Truth) -> bytes:
    T = _pose4(t)
    return text(_joints(t) | {f"T{i + 1}{j + 1}": T[:, i, j] for i in range(4) for j in range(4)})


def _flat_matrix(t: Truth) -> bytes:
    T = _pose4(t).reshape(-1, 16)
    return text(_joints(t) | {f"T[{k}]": T[:, k] for k in range(16)})


def _noap(t: Truth) -> bytes:
    R = t.R.as_matrix()
    table = _joints(t)
    for k, name in enumerate("noa"):
        table |= _three(f"{name}x {name}y {name}z", R[:, :, k])
    return text(table | _three("px py pz", t.p))


def _pose_lists(t: Truth) -> bytes:
    """URScript's poses and joints as lists in one cell each."""
    pose = np.hstack([t.p, t.R.as_rotvec()])
    return text({"actual joints": _listed(t.q), "tracker pose": _listed(pose, "p[")})


def _rapid(t: Truth) -> bytes:
    """A RAPID position and a quaternion as lists, joints in degrees."""
    return text(
        {"robax": _listed(np.degrees(t.q)), "trans": _listed(1e3 * t.p), "rot": _listed(t.R.as_quat()[:, [3, 0, 1, 2]])}
    )


def _targets(t: Truth) -> bytes:
    """RAPID's jointtarget and robtarget, each in one cell."""
    quat, mms, deg = t.R.as_quat()[:, [3, 0, 1, 2]], 1e3 * t.p, np.degrees(t.q)
    other = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
    place = [f"[{_inner(mms[k])},{_inner(quat[k])},[0,-1,0,0],{other}]" for k in range(len(t.q))]
    axes = [f"[{_inner(deg[k])},{other}]" for k in range(len(t.q))]
    return text({"jointtarget": np.array(axes), "measured": np.array(place)}, ";")


def _inner(values: np.ndarray) -> str:
    return "[" + ",".join(repr(float(v)) for v in values) + "]"


def _hash_numbers(t: Truth) -> bytes:
    """Rows numbered #1, #2: they are no comments."""
    lines = text(kuka(t)).decode().splitlines()
    return "\n".join([f"no,{lines[0]}", *(f"#{k + 1},{line}" for k, line in enumerate(lines[1:]))]).encode()


def _sep_line(t: Truth) -> bytes:
    """Excel's own first line, which says what parts cells."""
    return text(kuka(t), ";", ",", above=["sep=;"])


def _gaps(t: Truth) -> bytes:
    """Empty columns between, a separator at each end of line, empty lines between."""
    lines = text(kuka(t), ";", ",").decode().splitlines()
    spaced = [
        ";".join([*cells[:6], "", *cells[6:9], "", *cells[9:], ""]) for cells in (line.split(";") for line in lines)
    ]
    return "\n\n".join(spaced).encode()


def _lying_units(t: Truth) -> bytes:
    """A header that says degrees and metres; the numbers are radians and millimetres."""
    table = {f"J{k + 1} [deg]": t.q[:, k] for k in range(6)}
    return text(table | {f"{a} [m]": 1e3 * t.p[:, k] for k, a in enumerate("xyz")})


def _controller_too(t: Truth) -> bytes:
    """The tracker's pose and the controller's own, which fits the nominal robot far better."""
    table = _joints(t, "J{}", deg=True) | _three("tcp_x tcp_y tcp_z", 1e3 * np.round(t.p, 3))
    return text(table | _three("tracker_x tracker_y tracker_z", 1e3 * t.p))


def _latin_joints(t: Truth) -> bytes:
    """Japanese names in Shift JIS, joints and axes in letters."""
    table = {f"J{k + 1}角度": np.degrees(t.q[:, k]) for k in range(6)}
    return text(table | _three("位置X 位置Y 位置Z", 1e3 * t.p), "\t", encoding="shift_jis")


def _one_column_off(t: Truth) -> bytes:
    """A comma too many in one row."""
    lines = text(kuka(t)).decode().splitlines()
    lines[8] = lines[8].replace(",", ",,", 1)
    return "\n".join(lines).encode()


def _robot(t: Truth, name: str) -> dict[str, np.ndarray]:
    """Joints in degrees and positions in mm, as controllers show them."""
    return _joints(t, name, deg=True) | _three("X Y Z", 1e3 * t.p)


PREAMBLE = (
    "Report of measurement", "Operator: A. Person", "Date: 2024-03-14", "", "Robot: R-7, cell 3", "Temperature 21.5", "",
    "Remarks: none, really", "all fine", "",
)  # fmt: skip

READABLE: tuple[Case, ...] = (
    Case("plain.csv", "our own: csv, SI, quaternions", lambda t: text(plain(t))),
    Case("semicolons.csv", "semicolons, decimal commas", lambda t: text(kuka(t), ";", ",")),
    Case("tabs.txt", "tabs", lambda t: text(kuka(t), "\t")),
    Case("tabs_commas.tsv", "tabs, decimal commas, CRLF", lambda t: text(kuka(t), "\t", ",", end="\r\n")),
    Case("bars.csv", "bars between cells", lambda t: text(kuka(t), "|")),
    Case("fixed.dat", "columns of fixed width", _fixed, off=2e-9, pose=False),
    Case("numpy.txt", "numpy.savetxt: blanks, header as a comment", _numpy_text),
    Case("quoted_commas.csv", "commas between quoted cells with decimal commas",
         lambda t: text(kuka(t), ",", ",", quote=True)),
    Case("thousands_points.csv", "1.234,5: thousands with points", lambda t: text(kuka(t), ";", ",", ".")),
    Case("thousands_commas.csv", "1,234.5 in tabs", lambda t: text(kuka(t), "\t", ".", ",")),
    Case("thousands_swiss.csv", "1'234.5", lambda t: text(kuka(t), ";", ".", "'")),
    Case("thousands_blanks.csv", "1 234,5 with blanks that do not break", lambda t: text(kuka(t), ";", ",", "\u00a0")),
    Case("three_decimals.csv", "123,456: thousands or decimals, the robot tells", _three_decimals, off=1e-6 * 10, pose=False),
    Case("minus.csv", "the typographer's minus", _unicode_minus, pose=False),
    Case("bom.csv", "UTF-8 with its mark", lambda t: text(kuka(t), ";", ",", encoding="utf-8-sig")),
    Case("utf16.csv", "UTF-16 of Windows", lambda t: text(kuka(t), "\t", ",", encoding="utf-16")),
    Case("utf16le.txt", "UTF-16 without its mark", lambda t: text(kuka(t), "\t", ",", encoding="utf-16-le")),
    Case("cp1252.csv", "Windows' encoding, degrees in names, all quoted", _quoted_names, pose=False),
    Case("mac.csv", "line ends of an old Macintosh", lambda t: text(kuka(t), ";", ",", end="\r")),
    Case("units_row.csv", "a line of units below the names",
         lambda t: text(kuka(t), units=["deg"] * 6 + ["mm"] * 3 + ["deg"] * 3)),
    Case("brackets.csv", "units in brackets below the names",
         lambda t: text(kuka(t), ";", ",", units=["[°]"] * 6 + ["[mm]"] * 3 + ["[°]"] * 3)),
    Case("preamble.csv", "ten lines about the measurement first",
         lambda t: text(kuka(t), above=PREAMBLE)),
    Case("two_headers.csv", "two lines of header, joints called 1 to 6", _two_lines),
    Case("merged.csv", "merged cells, names, units; commanded poses beside", _merged, pose=False),
    Case("log.csv", "a log with comments in it", _log),
    Case("restarted.csv", "a log that begins anew in the middle", _restarted),
    Case("footer.csv", "rows of means and deviations at the end", _footer),
    Case("excel.xlsx", "Excel", _xlsx),
    Case("form.xlsx", "Excel: a form with title, units, mean, and a sheet of notes", _xlsx_form),
    Case("typed.xlsx", "Excel: numbers typed as text with commas", _xlsx_text),
    Case("dates.xlsx", "Excel: dates as dates", _xlsx_dates),
    Case("iso.csv", "date and time as ISO writes them", lambda t: _dated(t, "%Y-%m-%dT%H:%M:%S.%f")),
    Case("german.csv", "14.03.2024 09:58:30", lambda t: _dated(t, "%d.%m.%Y %H:%M:%S")),
    Case("american.csv", "03/14/2024 09:58:30 AM", lambda t: _dated(t, "%m/%d/%Y %I:%M:%S %p")),
    Case("milliseconds.csv", "time in ms", _milliseconds),
    Case("mixed_units.csv", "joints in rad, Euler angles in degrees, positions in mm",
         lambda t: text(_joints(t) | _three("x y z", 1e3 * t.p) | _three("roll pitch yaw", _euler(t, "xyz")))),
    Case("rail.csv", "a rail in mm, joints in degrees, positions in m",
         lambda t: text(_joints(t, "axis{}", deg=True) | _three("x y z", t.p) | _three("rx ry rz", t.R.as_rotvec())),
         arm="arid"),
    Case("wxyz.csv", "scalar-first quaternion q1 q2 q3 q4 (ABB)",
         lambda t: text(_robot(t, "J{}") | _three("q1 q2 q3 q4", t.R.as_quat()[:, [3, 0, 1, 2]]))),
    Case("q0.csv", "scalar-first quaternion q0 qx qy qz",
         lambda t: text(_robot(t, "J{}") | _three("q0 qx qy qz", t.R.as_quat()[:, [3, 0, 1, 2]]))),
    Case("r33.csv", "a rotation matrix r11 … r33", lambda t: text(_joints(t) | _three("x y z", t.p) | _matrix(t))),
    Case("matrix4.csv", "a 4x4 matrix T11 … T44", _wide_matrix),
    Case("matrix16.csv", "a 4x4 matrix T[0] … T[15]", _flat_matrix),
    Case("noap.csv", "a matrix as n o a p", _noap),
    Case("staubli.csv", "Stäubli Rx Ry Rz",
         lambda t: text(_robot(t, "j{}") | _three("Rx Ry Rz", _euler(t, "XYZ")), "\t")),
    Case("fanuc.csv", "FANUC W P R",
         lambda t: text(_joints(t, "J{}", deg=True) | _three("X Y Z", 1e3 * t.p) | _three("W P R", _euler(t, "xyz")))),
    Case("kawasaki.csv", "Kawasaki O A T",
         lambda t: text(_joints(t, "JT{}", deg=True) | _three("X Y Z", 1e3 * t.p) | _three("O A T", _euler(t, "ZYZ")))),
    Case("ur.csv", "UR's real-time data and a rotation vector, blanks", _rtde),
    Case("ur_lists.csv", "URScript's p[...] and joints as lists in cells", _pose_lists),
    Case("rapid.csv", "lists in cells: robax, trans, rot", _rapid),
    Case("targets.csv", "RAPID's jointtarget and robtarget in cells", _targets),
    Case("sentinel.csv", "-1e30 where nothing was seen", _sentinel, rows=_but(4), pose=False),
    Case("holes.csv", "n/a, --- and nothing in cells", _holes, rows=_but(3, 5, 7), pose=False),
    Case("two_bodies.csv", "a second body that stands still", _two_bodies),
    Case("spatialanalyzer.txt", "SpatialAnalyzer: points, joints beside", spatial_analyzer, off=1e-11, pose=False),
    Case("polyworks.txt", "PolyWorks: nominal and measured points, joints beside", polyworks, pose=False),
    Case("leica.csv", "Leica T-Mac: date and time apart, scalar-first quaternion, joints beside", leica),
    Case("faro.csv", "FARO CAM2: inches, deviations, joints beside", faro, pose=False),
    Case("api.txt", "API STS: pitch yaw roll, joints beside", api),
    Case("vicon.csv", "Vicon: segments, rotation vectors in rad, joints beside", vicon),
    Case("vicon_trajectories.csv", "Vicon: trajectories, joints beside", lambda t: vicon(t, "Trajectories"), pose=False),
    Case("motive.csv", "OptiTrack Motive: rigid body and marker, quaternions, joints beside", motive),
    Case("motive_xyz.csv", "OptiTrack Motive: Euler angles, joints beside", lambda t: motive(t, euler=True)),
    Case("qualisys.tsv", "Qualisys 6D: Euler angles and matrix, joints beside", qualisys),
    Case("ndi.csv", "NDI: scalar first, a row that was not seen, joints beside", ndi, rows=_but(5)),
    Case("robodk.csv", "RoboDK: joints and points", robodk, pose=False),
    Case("samples.yaml", "robot_calibration: samples as YAML", robot_calibration, pose=False),
    Case("sep.csv", "Excel's line sep=; first", _sep_line),
    Case("gaps.csv", "empty columns, separators at the end, empty lines between", _gaps),
    Case("lying.csv", "a header that lies about units", _lying_units, pose=False),
    Case("controller.csv", "the tracker's position beside the controller's own", _controller_too, pose=False),
    Case("comma_too_many.csv", "a comma too many in one row", _one_column_off, rows=_but(7)),
    Case("shift_jis.txt", "names in Japanese, Shift JIS", _latin_joints, pose=False),
    Case("hash.csv", "rows numbered #1, #2", _hash_numbers),
)  # fmt: skip
