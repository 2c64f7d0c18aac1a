"""Tables of `awkward.py` that no reader can be sure of, some made to deceive: each must be asked about."""

from __future__ import annotations

import numpy as np
import pandas as pd
from awkward_cases import READABLE, _xlsx
from awkward_tables import (
    ASKED,
    Case,
    Truth,
    _joints,
    _number,
    _rows,
    _three,
    kuka,
    mm,
    motive,
    plain,
    robot_calibration,
    spatial_analyzer,
    text,
    vicon,
    workbook,
)


def _mixed_decimals(t: Truth) -> bytes:
    """Joints with points, positions with commas: two programs' output pasted together."""
    joints, rest = _joints(t, "J{}", deg=True), _three("x y z", 1e3 * t.p)
    lines = [";".join([*joints, *rest])]
    for k in range(len(t.q)):
        lines.append(
            ";".join(
                [*(repr(float(v[k])) for v in joints.values()), *(_number(float(v[k]), ",") for v in rest.values())]
            )
        )
    return "\n".join(lines).encode()


def _commas_everywhere(t: Truth) -> bytes:
    """Decimal commas in a file whose cells are parted by commas, without quotes."""
    table = mm(t)
    lines = [",".join(table)]
    lines += [",".join(_number(float(v), ",") for v in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(lines).encode()


def _no_header(t: Truth) -> bytes:
    return text(plain(t), header=False)


def _two_poses(t: Truth) -> bytes:
    """Two poses, both of which move with the robot: nothing says which was measured."""
    other = t.p + t.R.apply([0.03, 0.01, -0.02])
    table = _joints(t) | _three("a_x a_y a_z", t.p) | _three("b_x b_y b_z", other)
    return text(table)


def _still(t: Truth) -> bytes:
    """A tool with one orientation: every way to write Euler angles fits alike."""
    n = len(t.q)
    return text(_joints(t) | _three("x y z", t.p) | _three("A B C", np.tile([10.0, 20.0, 30.0], (n, 1))))


def _shuffled(t: Truth) -> bytes:
    """Joints in another order than the chain's, numbered as if they were in it."""
    order = [3, 1, 5, 0, 4, 2]
    table = {f"q{k + 1}": t.q[:, j] for k, j in enumerate(order)}
    return text(table | _three("x y z", t.p))


def _inverted(t: Truth) -> bytes:
    """The world in the target's frame: inverted poses."""
    back = -t.R.inv().apply(t.p)
    return text(_joints(t) | _three("x y z", back) | _three("qx qy qz qw", t.R.inv().as_quat()))


def _left_handed(t: Truth) -> bytes:
    """Positions with a mirrored axis."""
    return text(_joints(t) | _three("x y z", t.p * [1, -1, 1]))


def _grouped_ints(t: Truth) -> bytes:
    """Hundredths of a millimetre without decimals, thousands with points."""
    hundredths = np.array([[f"{v:,}".replace(",", ".") for v in row] for row in np.round(1e5 * t.p).astype(int)])
    return text(_joints(t, deg=True) | _three("x y z", hundredths), ";", ",")


def _only_three_decimals(t: Truth) -> bytes:
    """The same without any number that would tell: all between 1 and 1000."""
    joints = np.degrees(t.q)
    moved = 1e3 * t.p + 5000
    rows = [
        [_number(float(v), ",", digits=3) for v in row]
        for row in np.hstack([np.where(np.abs(joints) < 1, 1.5, joints), moved % 1000])
    ]
    return ("q1;q2;q3;q4;q5;q6;x;y;z\n" + "\n".join(";".join(row) for row in rows)).encode()


def _duplicate_names(t: Truth) -> bytes:
    """Two columns with one name in plain csv."""
    return b"q1,q2,q3,q4,q5,q6,x,y,z,x\n" + text(
        _joints(t) | _three("x y z w", np.hstack([t.p, t.p[:, :1]])), header=False
    )


def _units_in_cells(t: Truth) -> bytes:
    table = {
        name: np.array([f"{v!r} {'mm' if name in 'xyz' else 'deg'}" for v in values.tolist()])
        for name, values in mm(t).items()
    }
    return text(table)


def _binary(t: Truth) -> bytes:
    return bytes(range(256)) * 40


def _small_turns(t: Truth) -> bytes:
    return text(mm(t) | _three("rx ry rz", np.zeros_like(t.p)))


def _two_tables(t: Truth) -> bytes:
    """Two tables one below the other, the second with its columns in another order."""
    table = mm(t)
    other = {name: table[name] for name in (*"xyz", *(f"q{k + 1}" for k in range(6)))}
    return text(table) + text(other)


def _two_arms(t: Truth) -> bytes:
    """Readings of two arms, and nothing that tells which was measured."""
    rng = np.random.default_rng(4)
    left, right = _joints(t, "left_q{}"), {f"right_q{k + 1}": rng.normal(size=len(t.q)) for k in range(6)}
    return text(right | left | _three("x y z", t.p))


def _row_names(t: Truth) -> bytes:
    """As R writes it: a column of row names that the header does not name."""
    lines = text(mm(t), " ").decode().splitlines()
    return "\n".join([lines[0], *(f'"{k + 1}" {line}' for k, line in enumerate(lines[1:]))]).encode()


def _hardly_moved(t: Truth) -> bytes:
    """Joints that moved by millidegrees: degrees and radians fit alike."""
    q = 1e-3 * t.q
    return text({f"q{k + 1}": q[:, k] for k in range(6)} | _three("x y z", t.p[:1] + 1e-5 * t.p))


def _midnight(t: Truth) -> bytes:
    when = pd.date_range("2024-03-14 23:58:00", periods=len(t.q), freq="37s").strftime("%H:%M:%S").to_numpy()
    return text({"time": when} | plain(t))


def _two_days(t: Truth) -> bytes:
    """The same hours of two days."""
    half = pd.date_range("2024-03-14 09:00:00", periods=(len(t.q) + 1) // 2, freq="37s").strftime("%H:%M:%S").to_numpy()
    return text({"time": np.tile(half, 2)[: len(t.q)]} | plain(t))


def _either_date(t: Truth) -> bytes:
    """Days 1 to 12 of months 1 to 12, in no order: 03/04 may be either."""
    days = np.array([f"{(5 * k) % 12 + 1:02d}/{(7 * k) % 12 + 1:02d}/2024 10:00:{k:02d}" for k in range(len(t.q))])
    return text({"time": days} | plain(t))


def _xlsx_two(t: Truth) -> bytes:
    """Two sheets, each with a table."""
    return workbook({"Monday": _rows(kuka(t)), "Tuesday": _rows(kuka(t))})


def _xlsx_bomb(t: Truth) -> bytes:
    """A workbook with entities in its XML."""
    import io
    import zipfile

    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(_xlsx(t))) as book, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as spoilt:
        for name in book.namelist():
            content = book.read(name)
            if name.endswith("sheet1.xml"):
                content = b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]>' + content
            spoilt.writestr(name, content)
    return out.getvalue()


def _old_excel(t: Truth) -> bytes:
    return b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(4000)


HOSTILE: tuple[Case, ...] = (
    Case("two_tables.csv", "two tables in one file, columns in another order", _two_tables, expected=ASKED, pose=False),
    Case("two_arms.csv", "readings of two arms, as likely", _two_arms, expected=ASKED, pose=False),
    Case("row_names.txt", "R's table: row names without a name", _row_names, expected=ASKED, pose=False),
    Case("two_sheets.xlsx", "Excel: two sheets with tables", _xlsx_two, expected=ASKED),
    Case("entities.xlsx", "Excel: entities in its XML", _xlsx_bomb, expected=ASKED),
    Case("old.xls", "Excel's old binary format", _old_excel, expected=ASKED),
    Case("midnight.csv", "times of day that pass midnight", _midnight),
    Case("two_days.csv", "times of day of two days", _two_days, expected=ASKED),
    Case("either.csv", "03/04/2024 in no order: day or month", _either_date, expected=ASKED),
    Case("hardly.csv", "joints that hardly moved: degrees and radians fit alike", _hardly_moved, expected=ASKED, pose=False),
    Case("motive_alone.csv", "OptiTrack Motive without joints", lambda t: motive(t, joints=False), expected=ASKED),
    Case("sa_alone.txt", "SpatialAnalyzer without names and joints",
         lambda t: spatial_analyzer(t, joints=False), expected=ASKED),
    Case("vicon_alone.csv", "Vicon without joints", lambda t: vicon(t, joints=False), expected=ASKED),
    Case("mixed_decimals.csv", "decimal points and decimal commas in one file", _mixed_decimals, expected=ASKED, pose=False),
    Case("commas_everywhere.csv", "decimal commas between commas, unquoted", _commas_everywhere, expected=ASKED, pose=False),
    Case("no_header.csv", "no header at all", _no_header, expected=ASKED),
    Case("two_poses.csv", "two positions, both of which move with the robot", _two_poses, expected=ASKED, pose=False),
    Case("still.csv", "one orientation throughout: no order of Euler angles is told", _still, expected=ASKED),
    Case("shuffled.csv", "joints exchanged", _shuffled, expected=ASKED, pose=False),
    Case("inverted.csv", "the world in the target", _inverted, expected=ASKED),
    Case("left_handed.csv", "a mirrored axis", _left_handed, expected=ASKED, pose=False),
    Case("hundredths.csv", "hundredths of a mm as whole numbers in groups", _grouped_ints, expected=ASKED, pose=False),
    Case("wrapped.csv", "positions that were folded, 123,456 throughout", _only_three_decimals, expected=ASKED, pose=False),
    Case("twice.csv", "two columns of one name", _duplicate_names, expected=ASKED, pose=False),
    Case("units_in_cells.csv", "units in every cell", _units_in_cells, expected=ASKED, pose=False),
    Case("binary.csv", "bytes of no text", _binary, expected=ASKED),
    Case("bomb.yaml", "aliases in YAML", lambda t: robot_calibration(t, "\na: &a [1]\nb: *a\n"), expected=ASKED, pose=False),
    Case("zeros.csv", "angles that are all zero", _small_turns, expected=ASKED),
)  # fmt: skip

CASES = READABLE + HOSTILE
