"""Workbooks made to harm: what is unpacked of them, and what is made of it, is bounded; what people save is read."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from awkward_tables import workbook
from openpyxl.styles.numbers import NumberFormat
from openpyxl.worksheet.datavalidation import DataValidation

from aridcal.files.tables import read_tables
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.regular_files import Limit


def spoilt(part: str, change: Callable[[bytes], bytes]) -> bytes:
    """A small workbook with one part changed."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(workbook({"a": [["x"], [1.0]]}))) as book:
        assert part in book.namelist()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as made:
            for name in book.namelist():
                made.writestr(name, change(book.read(name)) if name == part else book.read(name))
    return out.getvalue()


SHEET, STYLES = "xl/worksheets/sheet1.xml", "xl/styles.xml"
FORMATS = b"".join(b'<numFmt numFmtId="%d" formatCode="0"/>' % k for k in range(210_000))
VALIDATIONS = b'<dataValidation type="whole" sqref="A1"/>' * 210_000

BOMBS: dict[str, tuple[str, Callable[[bytes], bytes], str]] = {
    "formats": (
        STYLES,
        lambda c: re.sub(rb"<numFmts.*?/?>(?=<)|(?=<fonts)", b"<numFmts>" + FORMATS + b"</numFmts>", c, count=1),
        "more than 200,000 formats",
    ),
    "formats in UTF-16": (
        STYLES,
        lambda c: (b"<styleSheet>" + b"<numFmt/>" * 250_000).decode().encode("utf-16"),
        "more than 200,000 formats",
    ),
    "checks of cells": (
        SHEET,
        lambda c: c.replace(b"</sheetData>", b"</sheetData><dataValidations>" + VALIDATIONS + b"</dataValidations>"),
        "more than 200,000 formats",
    ),
    "a part of blanks": (STYLES, lambda c: b" " * 21_000_000 + c, "styles.xml has 21 MB, at most 20 MB"),
    "entities behind a comment": (
        STYLES,
        lambda c: c.replace(b"<styleSheet", b"<!--" + b" " * 9000 + b"--><!DOCTYPE a []><styleSheet"),
        "declares entities",
    ),
    "entities in a sheet": (
        SHEET, lambda c: b"<?xml version='1.0'?><!--" + b" " * 99_000 + b"--><!DOCTYPE a []>" + c, "declares entities",
    ),
    "brackets that hide": (STYLES, lambda c: b'<?xml version="1.0" encoding="UTF-7"?>+ADw-a+AD4-', "no XML in UTF-8"),
    "another alphabet": (STYLES, lambda c: '<?xml version="1.0" encoding="cp037"?><a/>'.encode("cp037"), "no XML in UTF-8"),
    "sheets": (
        "xl/workbook.xml",
        lambda c: re.sub(
            rb'<sheet [^>]*/>', lambda m: b"".join(m[0].replace(b'"a"', b'"a%d"' % k) for k in range(1001)), c
        ),
        "1,001 sheets, at most 1,000",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("part", "change", "said"), BOMBS.values(), ids=BOMBS)
def test_what_a_workbook_holds_beside_cells_is_bounded_before_anything_is_made_of_it(
    part: str, change: Callable[[bytes], bytes], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted, not timed: no format and no check of cells is made."""
    made: list[object] = []
    for kind in (NumberFormat, DataValidation):
        monkeypatch.setattr(kind, "__init__", lambda self, *_, **__: made.append(self))
    content = spoilt(part, change)
    assert len(content) < 2_000_000
    (tmp_path / "m.xlsx").write_bytes(content)
    with pytest.raises(MeasurementError, match=rf"m\.xlsx: .*{said}"):
        read_tables([tmp_path / "m.xlsx"])
    assert made == []


def test_a_workbook_with_as_many_formats_as_one_may_have_and_a_chart_of_many_points_is_read(tmp_path: Path) -> None:
    few = FORMATS[: FORMATS.index(b'numFmtId="5000"') - len(b"<numFmt ")]
    content = spoilt(
        STYLES, lambda c: re.sub(rb"<numFmts.*?/?>(?=<)|(?=<fonts)", b"<numFmts>" + few + b"</numFmts>", c, count=1)
    )
    with io.BytesIO() as out:
        out.write(content)
        with zipfile.ZipFile(out, "a") as book:
            book.writestr("xl/charts/chart1.xml", "<c:chart>" + "<c:pt><c:v>1</c:v></c:pt>" * 300_000 + "</c:chart>")
        (tmp_path / "m.xlsx").write_bytes(out.getvalue())
    assert [float(cell.as_py()) for cell in read_tables([tmp_path / "m.xlsx"]).cells["x"][0]] == [1.0]


def test_cells_are_counted_while_they_are_unpacked(tmp_path: Path) -> None:
    """Empty ones, too, which no row holds."""
    many = spoilt(SHEET, lambda c: c.replace(b"<sheetData>", b"<sheetData><row>" + b"<c/>" * 60_000 + b"</row>"))
    (tmp_path / "m.xlsx").write_bytes(many)
    with pytest.raises(MeasurementError, match=r"more cells than 0\.2 MB hold"):
        read_tables([tmp_path / "m.xlsx"], limit=Limit(0.2))
