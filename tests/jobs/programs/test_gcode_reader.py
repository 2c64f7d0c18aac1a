"""G-code: only known words are corrected, with exactly the zero that acts; what is left says why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from made_gcode import gantry
from robots import ur10

from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import KnownFrames
from aridcal.jobs.apply.programs.gcode import ROW
from aridcal.jobs.apply.programs.gcode.table import CODES, START
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.proof import TextChange, corrected, edit_texts, expected_targets
from aridcal.jobs.apply.programs.targets import Target
from aridcal.jobs.apply.programs.text import Numbers, written
from aridcal.system.errors import AridcalError


def shifted(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


FRAMES = KnownFrames(
    {"g54": shifted(0.1, 0.2, 0.3), "g55": shifted(), "g54.1 p3": shifted(0.5)},
    {"h1": shifted(0.0, 0.0, 0.08)},
    harmless=frozenset({"o7000", "m777"}),
)

HEAD = "G90 G21 G54\n"


def reading(text: str, start: bool = False, rotary: bool = False, frames: KnownFrames = FRAMES) -> ProgramReading:
    project = Project((SourceFile(Path("a.nc"), text),))
    return ROW.read(project, Cell(gantry(rotary), frames, (), start))


def targets(text: str, start: bool = False, rotary: bool = False) -> list[Target]:
    return list(reading(text, start, rotary).targets)


def plain(text: str, start: bool = False, rotary: bool = False) -> list[list[float]]:
    """Readings of what is corrected, [mm] and [rad]."""
    done = [t for t in targets(text, start, rotary) if not t.why]
    return [(t.readings * ([1e3] * 3 + [1.0] * rotary)).round(6).tolist() for t in done if t.readings is not None]


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("G1 X1 Y2 Z3", (101.0, 202.0, 303.0)),
        ("G20 G1 X1 Y2 Z3", (125.4, 250.8, 376.2)),
        ("G55 G1 X1 Y2 Z3", (1.0, 2.0, 3.0)),
        ("G54.1 P3 G1 X1 Y2 Z3", (501.0, 2.0, 3.0)),
        ("G43 H1\nG1 X1 Y2 Z3", (101.0, 202.0, 383.0)),
        ("G43 H01 G1 X1 Y2 Z3", (101.0, 202.0, 383.0)),
        ("G43 H1\nG49 G1 X1 Y2 Z3", (101.0, 202.0, 303.0)),
        ("g01x+1y.2e1z-.5", (101.0, 200.2, 299.5)),
        ("N10G1X1.Y2.Z3.F100", (101.0, 202.0, 303.0)),
        ("/N10 G1 X1 Y2 Z3", (101.0, 202.0, 303.0)),
        ("G0 X1 Y2 Z3 (to G55 X9)", (101.0, 202.0, 303.0)),
        ("G1 X1 Y2 Z3 ; (to X9", (101.0, 202.0, 303.0)),
        ("M98 P7000\nG1 X1 Y2 Z3", (101.0, 202.0, 303.0)),
        ("G65 P7000 X5.5 Q1\nG1 X1 Y2 Z3", (101.0, 202.0, 303.0)),
        ("M777\nG1 X1 Y2 Z3", (101.0, 202.0, 303.0)),
    ],
)
def test_a_place_counts_from_the_zero_that_acts(text: str, where: Sequence[float]) -> None:
    np.testing.assert_allclose(plain(HEAD + text)[0], where)


def test_lower_case_e_behind_a_number_is_a_word_of_its_own() -> None:
    assert [n.text for n in targets(HEAD + "G1 X1e7 Y2 Z3")[0].numbers] == ["1", "2", "3"]


def test_turning_axes_are_degrees_whatever_the_unit() -> None:
    (place,) = plain(HEAD + "G20 G55 G1 X1 Y2 Z3 A90", rotary=True)
    np.testing.assert_allclose(place, [25.4, 50.8, 76.2, np.pi / 2], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("G1 X1 Y1 Z1\nG2 X2 Y2 R5\nG81 X1 Y1 Z1 R2\nG1 X3", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nG91\nX1\nG90\nY3", "does not state X"),
        ("G1 X1 Y1 Z1\nG28 Z0\nX3 Y3", "does not state Z"),
        ("G1 X1 Y1 Z1\nG51 P2\nG53 G0 Z0\nG50\nX3 Y3", "does not state Z"),
        ("G1 X1 Y1 Z1\nG91 G53 G0 Z0\nG90\nX3 Y3", "does not state Z"),
        ("G1 X1 Y1 Z1\nT2\nX3", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nG28\nX3", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nG28 A0\nX3", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nG28 Z\nX3", "line 3: Z is not understood"),
        ("G1 X1 Y1 Z1\nM98 P7000\nX3", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nM6 T1\nX3", "does not state Y Z"),
        ("G1 X1 Y1 Z1\nG92 X0\nX3 Y3 Z3", "line 3: G92: the zero is set anew"),
        ("G54.1 P4 G1 X3 Y3 Z3", "the work offset G54.1 P4 is not in"),
        ("G59.1 G1 X3 Y3 Z3", "the work offset G59.1 is not in"),
        ("G43 H9 G1 X3 Y3 Z3", "the length of tool H9 is not in"),
        ("G1 X#101 Y3 Z3", "X is worked out by the controller"),
        ("G1 X1 Y[#2+1] Z3", "Y is worked out by the controller"),
        ("G1 X1 Y1 Z1\nG33 Z5 K1", "is no straight move"),
        ("G65 P9999\nG1 X1 Y1 Z1", "line 2: G65 P9999 is in no given file"),
        ("G1 X2000000 Y1 Z1", "is no length of a gantry"),
        ("G1 X1 Y1 Z1\nQ5\nG1 X2 Y2 Z2", "line 3: Q belongs to no code of its block"),
        ("G1 X20. Y1.5 Z1.5\nG1 X10 Y1.5 Z1.5", "with a decimal point and without"),
    ],
)
def test_the_reason_names_the_line_and_the_cause(text: str, why: str) -> None:
    assert why in targets(HEAD + text)[-1].why


def test_a_place_of_the_machine_counts_from_no_offset_and_stays() -> None:
    first, machine, last = targets(HEAD + "G1 X1 Y1 Z1\nG53 G0 Y5 Z0\nX3")
    assert (first.why, last.why) == ("", "") and "place of the machine" in machine.why
    assert machine.readings is not None
    np.testing.assert_allclose(machine.readings, [np.nan, 0.005, 0.0])


def test_lengths_and_offsets_that_nobody_knows_do_not_move_a_place_of_the_machine() -> None:
    for lost, again in (("G92 X1", "G92.1"), ("G59.3", "G54")):
        before, machine, behind = targets(HEAD + f"{lost}\nG0 X1 Y1 Z1\nG53 X0 Y0 Z0\n{again}\nX2")
        assert before.why and machine.readings is not None and behind.why == ""
        np.testing.assert_allclose(machine.readings, np.zeros(3))


def test_axes_that_do_not_go_home_stay() -> None:
    assert targets(HEAD + "G1 X1 Y1 Z1\nG91 G28 Z0\nG90\nZ3")[-1].why == ""


def test_a_tool_that_is_only_named_moves_nothing_where_another_code_puts_it_in() -> None:
    assert targets(HEAD + "T1 M06\nG1 X1 Y1 Z1\nT2\nX3")[-1].why == ""
    assert "does not state Y Z" in targets(HEAD + "(M6)\nG1 X1 Y1 Z1\nT2\nX3")[-1].why


def test_a_block_that_leaves_an_axis_out_is_corrected_where_that_is_known() -> None:
    nan = float("nan")
    np.testing.assert_equal(plain(HEAD + "G55 G1 X1 Y1 Z1\nX5"), [[1.0, 1.0, 1.0], [5.0, nan, nan]])
    np.testing.assert_equal(plain(HEAD + "G55 G1 X5", start=True), [[5.0, nan, nan]])
    assert plain(HEAD + "G1 X5") == []
    np.testing.assert_equal(plain(HEAD + "G55 G0 Z5\nX1 Y1\nZ2"), [[1.0, 1.0, nan], [nan, nan, 2.0]])


def test_what_is_left_still_says_where_the_axes_are_if_its_place_is_known() -> None:
    first, second, third = targets(HEAD + "G55\nG0 Z5\nG2 X1 Y1 R5\nG91 X5")
    np.testing.assert_equal(first.readings, [np.nan, np.nan, 0.005])
    np.testing.assert_equal(second.readings, [0.001, 0.001, np.nan])
    assert first.why and second.why and third.why and third.readings is None


def test_axes_left_out_on_two_ways_are_known_only_if_both_left_them_in_one_block() -> None:
    assert len(plain(HEAD + "G1 X1 Y1 Z1\no1 repeat [3]\nM8\no1 endrepeat\nX5")) == 2
    x5 = targets(HEAD + "G1 X1 Y1 Z1\no1 repeat [3]\nX5\nY6\no1 endrepeat")[1]
    assert "does not state Y" in x5.why
    assert len(plain(HEAD + "G1 X1 Y1 Z1\no1 repeat [3]\nX5 Y6 Z7\nY6\no1 endrepeat")) == 3


def test_a_subprogram_is_read_in_the_modes_of_its_callers() -> None:
    sub = "O2\nG1 X1 Y2 Z3\nM99\n"
    assert plain(f"O1\n{HEAD}G55\nM98 P2\nM98 P2 L3\nM30\n{sub}") == [[1.0, 2.0, 3.0]]
    assert plain(f"O1\n{HEAD}G55\nM98 P2\nG20\nM98 P2\nM30\n{sub}") == []
    assert plain(f"o2 sub\nG1 X1 Y2 Z3\no2 endsub\n{HEAD}G55\no2 call\nM2\n") == [[1.0, 2.0, 3.0]]


def test_a_file_of_carriage_returns_has_lines() -> None:
    assert [t.line for t in targets(HEAD.replace("\n", "\r") + "G55\rG1 X1 Y2 Z3\rX2\r") if not t.why] == [3, 4]


def test_what_is_taken_for_granted_is_said() -> None:
    notes = " ".join(reading("G0 X1 Y1 Z1\n").notes)
    assert all(word in notes for word in ("G90", "G21", "G54", "decimal point", "X x, Y y, Z z"))
    assert "G90" not in " ".join(reading(HEAD + "G0 X1.5 Y1.5 Z1.5\n").notes)
    assert "decimal point" not in " ".join(reading(HEAD + "G0 X1.5 Y1.5 Z0\n").notes)
    assert "(G53, line 2) count from" in " ".join(reading(HEAD + "G53 G0 Z0\n").notes)
    assert "G53" not in " ".join(reading(HEAD + "G0 Z0\n").notes)


def test_an_arm_has_no_letters() -> None:
    with pytest.raises(AridcalError, match="sliding and 6 turning joints"):
        ROW.read(Project((SourceFile(Path("a.nc"), "G0 X1"),)), Cell(ur10(), FRAMES))


def test_every_row_of_the_table_that_sets_a_mode_sets_one_that_exists() -> None:
    assert {row.mode for row in CODES.values()} <= {"", "motion", *START}
    assert all(row.why for row in CODES.values() if row.mode and row.value is None)


@pytest.mark.parametrize("code", [code for code, row in CODES.items() if row.mode and row.mode != "motion"])
def test_every_mode_that_is_not_plain_keeps_what_follows_as_it_is(code: str) -> None:
    """The table's other side: a code of a plain value leaves the block behind it plain, any other one does not."""
    row = CODES[code]
    words = {"G43": " H1", "G54.1": " P3", "G10": " L2 P1"}
    text = f"{HEAD}{code}{words.get(code, '')}\nG1 X1 Y1 Z1"
    stated = {"G54", "G55", "G54.1", "G43"}
    known = code in stated or (row.value is not None and row.mode != "work offset")
    assert bool(plain(text)) is known


def test_a_comment_is_put_in_behind_everything_and_changes_no_target() -> None:
    for text in (
        "%\nG0 X1\n%\n",
        "G0 X1 Y1 Z1\nM30",
        "G0 X1 Y1 Z1\r\nM30\r\n",
        "",
        "G0 X1 Y1 Z1\rM30\r",
        "%\nO1\nM30\n%",
    ):
        assert ROW.comment is not None
        place, comment = ROW.comment(text, "corrected (by us) on 2026-11-23")
        marked = text[:place] + comment + text[place:]
        assert marked.startswith(text) and "(corrected [by us] on 2026-11-23)" in marked
        assert [(t.line, t.name, t.why) for t in targets(marked)] == [(t.line, t.name, t.why) for t in targets(text)]
        assert comment.isascii() and ("\r\n" in comment) == ("\r\n" in text)


def test_a_correction_is_proved() -> None:
    text = HEAD + "G55\nG0 Z5\nX10 Y-3.25\nG1 Z-1.5 F100\nG20\nG1 X1 Y.5\nM30\n"
    project, cell = Project((SourceFile(Path("a.nc"), text),)), Cell(gantry(False), FRAMES)
    found = list(ROW.read(project, cell).targets)
    changes = [
        TextChange(0, Numbers([number]), written(number.value + 0.123456, number.text, digits))
        for target in found if not target.why
        for number, digits in zip(target.numbers, target.places, strict=True)
    ]  # fmt: skip
    (new,) = corrected(ROW, project, cell, expected_targets(found), edit_texts(project, changes))
    assert new == HEAD + "G55\nG0 Z5\nX10.1235 Y-3.1265\nG1 Z-1.3765 F100\nG20\nG1 X1.12346 Y.62346\nM30\n".replace(
        "Y.6", "Y0.6"
    )


ODD = (
    "", "%", "%\n%\n", "(", ")", "[" * 20000, "X[" * 20000, "(" * 20000, "G1 X" + "1" * 20000, "X1" * 20000, "G1" * 20000,
    "o1 if [1]\n" * 5000, "WHILE [1] DO1\n" * 5000, "/" * 5000, "#" * 20000, "X1e999 Y1", "G" + "9" * 5000, "GOTO\n" * 2000,
    "O1\n" * 2000, "M98 P1\nO1\n", "N1 GOTO 1\n" * 3000, "\r" * 10000, "o1 sub\no1 call\no1 endsub\no1 call\n", "M98", "G54.1",
    "#99999999999999999999=1", "P" * 9999, "IF [1] GOTO 5\n" * 3000 + "N5", "X\xb2", "G1 X\u00a0",
)  # fmt: skip


@pytest.mark.parametrize("text", ODD, ids=range(len(ODD)))
def test_no_text_is_too_odd(text: str) -> None:
    targets(text)
    targets(HEAD + text + "\nG1 X1 Y1 Z1\n")
