"""Escape sequences in what a user named reach no terminal, table or page: they are spelt out."""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
import pyarrow.parquet
import pytest
from markupsafe import Markup
from rich.table import Table

from aridcal.__main__ import main
from aridcal.command_line import run, screens
from aridcal.pages.drawing.html import tag
from aridcal.pages.drawing.page_frame import filled
from aridcal.pages.drawing.plot import text
from aridcal.system.errors import AridcalError, printable_lines
from aridcal.system.progress import console_progress
from aridcal.system.writing.table_writer import write_table

HOSTILE = "a\x1b[2J\x1b]0;title\x07b\x9bc\u2028d\re"
SPELT = "a\\x1b[2J\\x1b]0;title\\x07b\\x9bc\\u2028d\\re"


def test_lines_and_tabs_stay_and_all_else_is_spelt() -> None:
    assert printable_lines(f"x\n\t{HOSTILE}\n") == f"x\n\t{SPELT}\n"
    assert printable_lines("ü – 你好") == "ü – 你好"


@pytest.mark.parametrize("markup", [True, False])
def test_no_command_prints_them(markup: bool, capsys: pytest.CaptureFixture[str]) -> None:
    words, aside = screens(argparse.Namespace(quiet=False))
    table = Table("name")
    table.add_row(HOSTILE.replace("[", "\\[") if markup else HOSTILE)
    for console in (words, aside):
        console.print(
            HOSTILE.replace("[", "\\[") if markup else HOSTILE, markup=markup, highlight=False, soft_wrap=True
        )
        console.print(table)
    with console_progress(aside) as progress:
        progress(f"reading {HOSTILE}")
    assert run(lambda: (_ for _ in ()).throw(AridcalError(HOSTILE))) == 2
    printed = capsys.readouterr()
    for said in printed:
        assert SPELT in said and not set(HOSTILE).difference("abcdetil;0J[]2") & set(said)
    assert printed.err.count(SPELT) >= 3


def test_a_slip_in_the_arguments_is_repeated_without_them(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["doctor", f"--{HOSTILE}"])
    said = capsys.readouterr().err
    assert SPELT in said and "\x1b" not in said


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_tables_spell_them(ending: str, tmp_path: Path) -> None:
    """As of a program's targets; numbers, words and gaps stay what they are."""
    table = pd.DataFrame({"target": [HOSTILE, "P1", None], "line": [1, 2, 3], "good": [True, False, True]})
    write_table(table, tmp_path / f"t.{ending}")
    content = (tmp_path / f"t.{ending}").read_bytes()
    assert b"\x1b" not in content
    if ending == "csv":
        assert content.decode().splitlines() == ["target,line,good", f"{SPELT},1,true", "P1,2,false", ",3,true"]
    else:
        read = pyarrow.parquet.read_table(tmp_path / "t.parquet").to_pylist()
        assert [row["target"] for row in read] == [SPELT, "P1", None] and [row["line"] for row in read] == [1, 2, 3]
    assert table["target"][0] == HOSTILE


def test_pages_spell_them() -> None:
    pages = [tag("p", HOSTILE, title=HOSTILE), text(0, 0, HOSTILE), filled("empty.html", title=HOSTILE, notice=HOSTILE)]
    for page in pages:
        assert "\x1b" not in page and "\x9b" not in page and "\\x1b[2J" in page
    assert tag("p", Markup("\x1b")) == "<p>\x1b</p>"  # markup is the program's own
