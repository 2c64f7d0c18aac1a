"""Tables as people and programs write them: what was measured, and the files that it is in.

The layouts of makers are written from their documentation (see docs/formats.md); none of these files is an export of a user.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pinocchio as pin
from scipy.spatial.transform import Rotation

from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot

URDF = Path(__file__).resolve().parents[1] / "urdf"

ROWS = 24

RIGHT, ASKED = "right", "asked"


@dataclass(frozen=True)
class Truth:
    """What was measured.

    Attributes:
        urdf: The robot's file.
        robot: Its chain.
        q: Readings, shape (N, columns), [rad] and [m].
        p: Positions, shape (N, 3), [m].
        R: Orientations.
    """

    urdf: Path
    robot: Robot
    q: np.ndarray
    p: np.ndarray
    R: Rotation


@dataclass(frozen=True)
class Case:
    """A file.

    Attributes:
        name: Of its suffix, too: ``semicolons.csv``.
        about: What is awkward.
        write: Makes its bytes.
        arm: ``ur10`` or ``arid``, whose first joint is a rail.
        expected: What a reader should do.
        off: By how much what is read may differ: the rounding of what is written, [m] and [rad].
        rows: Which rows are read; None: all.
        pose: Whether the orientation is there.
    """

    name: str
    about: str
    write: Callable[[Truth], bytes]
    arm: str = "ur10"
    expected: str = RIGHT
    off: float = 1e-9
    rows: Callable[[int], np.ndarray] | None = None
    pose: bool = True


def truth(arm: str, n: int = ROWS, seed: int = 0) -> Truth:
    """Measurements of a robot whose zeros are a milliradian off."""
    rng = np.random.default_rng(seed)
    urdf, tip = {"ur10": (URDF / "ur10.urdf", "tool0"), "arid": (URDF / "arid.urdf", "flange")}[arm]
    robot = load_robot(urdf, tip)
    low, high = np.clip(robot.limits, -2.4, 2.4).T
    q = rng.uniform(0.8 * low, 0.8 * high, (n, len(low)))

    def placed(size: float) -> pin.SE3:
        return pin.SE3(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-size, size, 3))

    model = Model(robot, (), ((None, placed(2.0)),), ((None, placed(0.15)),))
    R, p = model.poses(np.zeros(0), model.rows(q + 1e-3 * rng.standard_normal(q.shape[1])))
    return Truth(urdf, robot, q, p, Rotation.from_matrix(R))


def _joints(t: Truth, name: str = "q{}", deg: bool = False) -> dict[str, np.ndarray]:
    scale = [1e3 if kind == "prismatic" and deg else 1.0 for kind in t.robot.kinds]
    turn = [180 / np.pi if kind != "prismatic" and deg else 1.0 for kind in t.robot.kinds]
    values = t.q * scale * turn
    return {name.format(k + 1): values[:, k] for k in range(values.shape[1])}


def _three(names: str, values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names.split(), values.T, strict=True))


def _euler(t: Truth, sequence: str) -> np.ndarray:
    return np.asarray(t.R.as_euler(sequence, degrees=True))  # type: ignore[call-overload]


def _number(value: object, decimal: str = ".", thousands: str = "", digits: int | None = None) -> str:
    if not isinstance(value, float | np.floating):
        return str(value)
    plain = f"{value:.{digits}f}" if digits is not None else repr(float(value))
    if thousands and "e" not in plain:
        whole, _, part = plain.lstrip("-").partition(".")
        sign = "-" if plain.startswith("-") else ""
        return sign + f"{int(whole):,}".replace(",", thousands) + (decimal + part if part else "")
    return plain.replace(".", decimal)


def text(
    table: dict[str, np.ndarray],
    separator: str = ",",
    decimal: str = ".",
    thousands: str = "",
    above: Sequence[str] = (),
    units: Sequence[str] | None = None,
    below: Sequence[str] = (),
    header: bool = True,
    digits: int | None = None,
    encoding: str = "utf-8",
    end: str = "\n",
    quote: bool = False,
) -> bytes:
    """A table of text in some dialect."""
    out = io.StringIO()
    writer = csv.writer(
        out, delimiter=separator, lineterminator=end, quoting=csv.QUOTE_ALL if quote else csv.QUOTE_MINIMAL
    )
    for line in above:
        out.write(line + end)
    if header:
        writer.writerow(table)
    if units is not None:
        writer.writerow(units)
    for row in zip(*table.values(), strict=True):
        writer.writerow([_number(cell, decimal, thousands, digits) for cell in row])
    for line in below:
        out.write(line + end)
    return out.getvalue().encode(encoding)


def workbook(sheets: dict[str, Sequence[Sequence[object]]]) -> bytes:
    """A workbook with some sheets of cells."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append([cell.item() if isinstance(cell, np.generic) else cell for cell in row])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def _rows(table: dict[str, np.ndarray]) -> list[list[object]]:
    return [list(table), *[list(row) for row in zip(*table.values(), strict=True)]]


def kuka(t: Truth) -> dict[str, np.ndarray]:
    """Joints and poses as KUKA has them, mm and degrees."""
    return _joints(t, "A{}", deg=True) | _three("X Y Z", 1e3 * t.p) | _three("A B C", _euler(t, "ZYX"))


def plain(t: Truth) -> dict[str, np.ndarray]:
    """Joints in rad, positions in m, quaternions."""
    return _joints(t) | _three("x y z", t.p) | _three("qx qy qz qw", t.R.as_quat())


def mm(t: Truth) -> dict[str, np.ndarray]:
    """Joints in degrees, positions in mm."""
    return _joints(t, deg=True) | _three("x y z", 1e3 * t.p)


def _matrix(t: Truth, name: str = "r{}{}") -> dict[str, np.ndarray]:
    R = t.R.as_matrix()
    return {name.format(i + 1, j + 1): R[:, i, j] for i in range(3) for j in range(3)}


def _pose4(t: Truth) -> np.ndarray:
    T = np.tile(np.eye(4), (len(t.q), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = t.R.as_matrix(), t.p
    return T


def _clock(n: int) -> pd.DatetimeIndex:
    return pd.date_range("2024-03-14 09:58:30.25", periods=n, freq="37s")


def motive(t: Truth, joints: bool = True, euler: bool = False) -> bytes:
    """OptiTrack Motive: data about the take, five lines of header, a rigid body and one of its markers; joints beside."""
    n = len(t.q)
    turned = _euler(t, "XYZ") if euler else t.R.as_quat()
    letters = "XYZ" if euler else "XYZW"
    body = [("Rigid Body", "Tool", "8F4C", "Rotation", letter) for letter in letters]
    body += [("Rigid Body", "Tool", "8F4C", "Position", letter) for letter in "XYZ"]
    body += [("Rigid Body", "Tool", "8F4C", "Mean Marker Error", "")]
    body += [("Rigid Body Marker", "Tool:Marker1", "A1B2", "Position", letter) for letter in "XYZ"]
    names = list(_joints(t)) if joints else []
    kind = "XYZ" if euler else "Quaternion"
    lines = [
        f"Format Version,1.23,Take Name,Take 1,Capture Frame Rate,120.000000,Rotation Type,{kind},Length Units,Millimeters,"
        "Coordinate Space,Global",
        "",
    ]
    for k, label in enumerate(("Type", "Name", "ID", "")):
        lines.append(",".join(["", label, *(cells[k] for cells in body), *[""] * len(names)]))
    lines.append(",".join(["Frame", "Time (Seconds)", *(cells[4] for cells in body), *names]))
    rng = np.random.default_rng(1)
    for k in range(n):
        marker = 1e3 * t.p[k] + t.R[k].apply([20.0, 30.0, 0.0])
        row = [k, k / 120, *turned[k], *(1e3 * t.p[k]), 0.1 + 0.01 * rng.random(), *marker, *(t.q[k] if joints else ())]
        lines.append(",".join(_number(float(cell)) if j else str(cell) for j, cell in enumerate(row)))
    return "\n".join(lines).encode()


def vicon(t: Truth, kind: str = "Segments", joints: bool = True) -> bytes:
    """Vicon Nexus and Tracker: what it is, the rate, the object, names, units."""
    names = list(_joints(t, deg=True).values()) if joints else []
    of = ["RX", "RY", "RZ", "TX", "TY", "TZ"] if kind == "Segments" else ["X", "Y", "Z"]
    units = ["rad"] * 3 + ["mm"] * 3 if kind == "Segments" else ["mm"] * 3
    extra = [f"J{k + 1}" for k in range(len(names))]
    lines = [kind, "100", ",".join(["", "", "Tool:Tool", *[""] * (len(of) - 1), *[""] * len(extra)])]
    lines += [",".join(["Frame", "Sub Frame", *of, *extra]), ",".join(["", "", *units, *["deg"] * len(extra)])]
    turned = t.R.as_rotvec()
    for k in range(len(t.q)):
        pose = [*turned[k], *(1e3 * t.p[k])] if kind == "Segments" else [*(1e3 * t.p[k])]
        lines.append(
            ",".join([str(k + 1), "0", *(_number(float(v)) for v in (*pose, *(column[k] for column in names)))])
        )
    return "\n".join(lines).encode()


def qualisys(t: Truth) -> bytes:
    """Qualisys Track Manager, 6D as tab-separated values: variables, then names, Euler angles, residual and the matrix."""
    lines = [
        "FILE_VERSION\t2.0.0", f"NO_OF_FRAMES\t{len(t.q)}", "NO_OF_CAMERAS\t8", "NO_OF_BODIES\t1", "FREQUENCY\t100",
        "DATA_INCLUDED\t6D", "BODY_NAMES\tTool", "",
        "\t".join(["Frame", "Time", "X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual",
                   *(f"Rot[{k}]" for k in range(9)), *_joints(t)]),
    ]  # fmt: skip
    euler = _euler(t, "xyz")
    for k in range(len(t.q)):
        R = t.R[k].as_matrix().T.ravel()  # column by column
        row = [k / 100, *(1e3 * t.p[k]), *euler[k], 0.2, *R, *t.q[k]]
        lines.append("\t".join([str(k + 1), *(_number(float(v)) for v in row)]))
    return "\r\n".join(lines).encode()


def ndi(t: Truth) -> bytes:
    """NDI ToolBox: one tool, scalar first, mm; a row of a tool that was not seen has its large number."""
    names = [
        "Tools",
        "Port 1",
        "Frame",
        "Face",
        "State",
        "Q0",
        "Qx",
        "Qy",
        "Qz",
        "Tx",
        "Ty",
        "Tz",
        "Error",
        *_joints(t, "J{}", deg=True),
    ]
    lines = [",".join(names)]
    quat = t.R.as_quat()[:, [3, 0, 1, 2]]
    for k in range(len(t.q)):
        pose = [*quat[k], *(1e3 * t.p[k]), 0.08]
        state = "OK"
        if k == 5:
            pose, state = [-3.697314e28] * 8, "Missing"
        cells = [*map(_number, map(float, pose)), *(_number(float(v)) for v in np.degrees(t.q[k]))]
        lines.append(",".join(["1", "Port 1", str(1000 + k), "1", state, *cells]))
    return "\n".join(lines).encode()


def spatial_analyzer(t: Truth, joints: bool = True) -> bytes:
    """SpatialAnalyzer's ASCII points: comments with two strokes, then collection, group, target, x y z."""
    lines = ["// SpatialAnalyzer 2023.2.0.1", "// Working frame: A::WORLD", "// Units: Millimeters"]
    names = list(_joints(t, "J{}", deg=True)) if joints else []
    if joints:
        lines.append("// " + ", ".join(["Collection", "Group", "Target", "X", "Y", "Z", *names]))
    for k in range(len(t.q)):
        own = [_number(float(v), digits=9) for v in 1e3 * t.p[k]]
        lines.append(
            ", ".join(
                ["A", "Robot", f"p{k + 1}", *own, *((_number(float(v)) for v in np.degrees(t.q[k])) if joints else ())]
            )
        )
    return "\n".join(lines).encode()


def polyworks(t: Truth) -> bytes:
    """PolyWorks|Inspector: a table of points with measured and nominal coordinates, tabs."""
    measured = 1e3 * t.p
    table = {"Name": np.array([f"pt {k + 1}" for k in range(len(t.q))])}
    table |= _three("NominalX NominalY NominalZ", np.round(measured, 0) + 0.5)
    table |= _three("MeasuredX MeasuredY MeasuredZ", measured) | _joints(t, "J{}", deg=True)
    return text(table, "\t", above=["# PolyWorks|Inspector 2022 IR4", "# Units: mm"])


def leica(t: Truth) -> bytes:
    """Leica tracker with T-Mac: dates, positions in mm, scalar-first quaternions, RMS values."""
    when = _clock(len(t.q))
    table = {"Date": when.strftime("%d.%m.%Y").to_numpy(), "Time": when.strftime("%H:%M:%S").to_numpy()}
    table |= _three("X[mm] Y[mm] Z[mm]", 1e3 * t.p) | _three("Q0 Q1 Q2 Q3", t.R.as_quat()[:, [3, 0, 1, 2]])
    table |= {"RMS": 0.01 + 0.001 * np.arange(len(t.q)) % 7} | _joints(t, "A{}", deg=True)
    return text(table, ";", decimal=",", above=["Leica AT960 T-Mac", "Serial;750123"])


def faro(t: Truth) -> bytes:
    """FARO CAM2: features with actual values and deviations, inches."""
    inch = t.p / 0.0254
    table = {"Feature": np.array([f"Point {k + 1:03d}" for k in range(len(t.q))])}
    table |= (
        _three("Actual_X Actual_Y Actual_Z", inch)
        | _three("Dev_X Dev_Y Dev_Z", 0.001 * inch)
        | _joints(t, "J{}", deg=True)
    )
    return text(table, above=["FARO CAM2 Measure 10", "Units: inches", ""])


def api(t: Truth) -> bytes:
    """API Radian with SmartTRACK Sensor: blanks between, angles in degrees."""
    table = (
        _three("X Y Z", 1e3 * t.p)
        | _three("Pitch Yaw Roll", _euler(t, "xyz")[:, [1, 2, 0]])
        | _joints(t, "J{}", deg=True)
    )
    lines = ["% API Radian, STS 6DoF", "% " + "   ".join(table)]
    lines += ["  ".join(_number(float(v)) for v in row) for row in zip(*table.values(), strict=True)]
    return "\r\n".join(lines).encode()


def robodk(t: Truth) -> bytes:
    """RoboDK's calibration measurements: joints and the tracker's points, each row a measurement."""
    table = {"Id": np.arange(1, len(t.q) + 1)} | _joints(t, "J{} (deg)", deg=True)
    table |= {f"{a} (mm)": 1e3 * t.p[:, k] for k, a in enumerate("XYZ")}
    return text(table, above=["RoboDK calibration measurements"])


def robot_calibration(t: Truth, extra: str = "") -> bytes:
    """robot_calibration's samples, as `rostopic echo -b calibration_data.bag` prints them."""
    out = []
    for k in range(len(t.q)):
        point = ", ".join(f"{a}: {float(v)!r}" for a, v in zip("xyz", t.p[k], strict=True))
        out += [
            "joint_states:", "  header: {seq: 0, stamp: {secs: 10, nsecs: 0}, frame_id: ''}",
            f"  name: [{', '.join(t.robot.readings)}]", f"  position: [{', '.join(repr(float(v)) for v in t.q[k])}]",
            "observations:", "  - sensor_name: tracker", "    features:",
            f"      - {{header: {{frame_id: world}}, point: {{{point}}}}}",
            "  - sensor_name: arm", "    features:",
            "      - {header: {frame_id: tool}, point: {x: 0.0, y: 0.0, z: 0.05}}", "---",
        ]  # fmt: skip
    return ("\n".join(out) + extra).encode()


def series_b(joints: np.ndarray, p: np.ndarray, R: Rotation, rest: dict[str, np.ndarray]) -> bytes:
    """The public UR10 series in the layout in which it was published: see identification/ur10-laser-tracker."""
    names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    goal = rest["goal"]
    table: dict[str, np.ndarray] = {"Timestamp": np.full(len(p), "2,02011E+13")}
    table |= dict(zip(("Goal x", "Goal y", "Goal z", "Goal roll", "Goal pitch", "Goal yaw"), goal.T, strict=True))
    table |= {f"{name}_joint": joints[:, k] for k, name in enumerate(names)}
    table["measurement_temperature"] = rest["temperature"]
    euler = R.as_euler("XYZ", degrees=True)
    for k, a in enumerate("xyz"):
        table |= {f"measurement_{a}": 1e3 * p[:, k], f"measurement_std_{a}": 1e3 * rest["std"][:, k]}
    for k, a in enumerate("xyz"):
        table |= {f"measurement_r{a}": euler[:, k], f"measurement_std_r{a}": np.degrees(rest["std"][:, 3 + k])}
    return text(table, ";", ",")
