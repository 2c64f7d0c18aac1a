"""Programs as projects: what is read beside them, what is written, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pandas as pd
import pytest
from calibrated import Machine, machine
from made_programs import unmarked

from aridcal.compensate import main as compensate
from aridcal.jobs.apply.programs import krl, rewrite
from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.proof import ProofFailure, TextChange, corrected, edit_texts, expected_targets
from aridcal.jobs.apply.programs.read_project import read_project
from aridcal.jobs.apply.programs.targets import PoseReference, Target
from aridcal.jobs.apply.programs.text import NUL, Number, Numbers

POINT = "{X 700.0,Y 100.0,Z 600.0,A 0.0,B 90.0,C 0.0}"

SOURCE = """DEF WELD( )
BAS(#INITMOV,0)
BAS(#TOOL,1)
BAS(#BASE,2)
PTP {A1 20.0,A2 -60.0,A3 80.0,A4 10.0,A5 40.0,A6 15.0}
LIN XP1
END
"""

DATA = f"DEFDAT WELD\nDECL E6POS XP1={POINT}\nENDDAT\n"

CONFIG = """DEFDAT $CONFIG PUBLIC
TOOL_DATA[1]={X 0,Y 0,Z 100,A 0,B 0,C 0}
BASE_DATA[2]={X 0,Y 0,Z 50,A 0,B 0,C 0}
ENDDAT
"""


@cache
def arm() -> Machine:
    """A UR10 of which the truth is known."""
    return machine(3, n=150)


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    file = tmp_path / "calibration.yaml"
    file.write_text(arm().saved.dump())
    return file


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A folder as a KUKA's: a program, its data list, the controller's own list."""
    folder = tmp_path / "cell"
    folder.mkdir()
    for name, text in {"weld.src": SOURCE, "weld.dat": DATA, "$config.dat": CONFIG}.items():
        (folder / name).write_text(text)
    return folder


def table(file: Path) -> pd.DataFrame:
    return pd.read_csv(file, keep_default_na=False)


def test_frames_come_from_the_controllers_own_list_and_points_from_the_data_list(
    calibration: Path, cell: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert compensate([str(calibration), str(cell), "-o", str(out)]) == 0
    side = table(out / "corrections.csv")
    assert side["corrected"].all()
    assert sorted(side["file"]) == ["weld.dat", "weld.src"]
    assert {path.name for path in out.iterdir()} == {"weld.src", "weld.dat", "corrections.csv"}
    changed = unmarked((out / "weld.dat").read_text())
    assert changed != DATA
    assert changed[: changed.index("{")] == DATA[: DATA.index("{")]


def test_what_stands_in_another_file_is_left_with_the_file_named(calibration: Path, cell: Path, tmp_path: Path) -> None:
    out = tmp_path / "weld.src"
    assert compensate([str(calibration), str(cell / "weld.src"), "-o", str(out)]) == 0
    side = table(tmp_path / "weld.src.corrections.csv")
    left = side[~side["corrected"]]
    assert len(left) == 1
    assert "weld.dat" in left["remark"].iloc[0]


def test_no_file_is_read_twice_and_none_that_was_corrected_says_what_names_mean(
    calibration: Path, cell: Path, tmp_path: Path
) -> None:
    opened = read_project([cell], tmp_path / "out")
    names = [source.path.name for source in opened.project.sources]
    assert sorted(names) == ["$config.dat", "weld.dat", "weld.src"]
    assert [source.path.name for source in opened.project.sources if not source.ours] == ["$config.dat"]
    module = "MODULE A\n  CONST jointtarget j1:=[[20,-60,80,10,40,15],[9E9,9E9,9E9,9E9,9E9,9E9]];\n  PROC main()\n"
    module += "    MoveAbsJ j1\\NoEOffs,v100,fine,tool0;\n  ENDPROC\nENDMODULE\n"
    (cell / "a.mod").write_text(module)
    for _ in range(2):  # the second time the output of the first stands beside the program, with the same names
        assert compensate([str(calibration), str(cell / "a.mod"), "-o", str(cell / "b.mod")]) == 0
        assert table(cell / "b.mod.corrections.csv")["corrected"].all()


def test_a_corrected_program_is_refused_by_its_comment_or_by_the_table_beside_it(
    calibration: Path, cell: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert compensate([str(calibration), str(cell), "-o", str(out)]) == 0
    assert compensate([str(calibration), str(out), "-o", str(tmp_path / "again")]) == 2
    assert "correct the program as it was before" in capfd.readouterr().err
    assert not (tmp_path / "again").exists()
    for name in ("weld.src", "weld.dat"):  # whoever deletes the comment has the table to delete, too
        (out / name).write_text((out / name).read_text().replace("corrected by", "made by"))
    listing = (
        "/PROG A\n/MN\n1:J P[1] 10% FINE ;\n/POS\nP[1]{\n GP1:\n UF : 0, UT : 1,\n"
        " J1= 20.000 deg, J2= -60.000 deg, J3= 80.000 deg,\n J4= 10.000 deg, J5= 40.000 deg, J6= 15.000 deg\n};\n/END\n"
    )
    (cell / "a.ls").write_text(listing)
    first = tmp_path / "b.ls"
    assert compensate([str(calibration), str(cell / "a.ls"), "-o", str(first)]) == 0
    assert first.read_text() != listing
    assert compensate([str(calibration), str(first), "-o", str(tmp_path / "c.ls")]) == 2
    assert "as the table beside it says" in capfd.readouterr().err


@pytest.mark.parametrize("where", ["same", "inside", "above"])
def test_outputs_are_never_where_programs_are_read_from(
    where: str, calibration: Path, cell: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = {path.name: path.read_text() for path in cell.iterdir()}
    out = {"same": cell, "inside": cell / "out", "above": cell / ".." / cell.name}[where]
    assert compensate([str(calibration), str(cell), "-o", str(out)]) == 2
    assert "give a folder outside of" in capfd.readouterr().err
    assert {path.name: path.read_text() for path in cell.iterdir()} == before


def test_nothing_is_written_where_the_new_text_does_not_say_what_was_meant(
    calibration: Path, cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A reader that looks at another place the second time, as a fault of ours might make it."""
    looks: list[Project] = []

    def forgetful(project: Project, cell: Cell) -> object:
        looks.append(project)
        return krl.ROW.read(project if len(looks) == 1 else looks[0], cell)

    def opened(paths: object, out: Path) -> object:
        real = read_project([cell], out)
        language = Language("KRL", krl.ROW.endings, forgetful, context=krl.ROW.context)  # type: ignore[arg-type]
        return type(real)(language, real.project, real.names)

    monkeypatch.setattr(rewrite, "read_project", opened)
    assert compensate([str(calibration), str(cell), "-o", str(tmp_path / "out")]) == 1
    assert "this is a bug in aridcal" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_proof_fails_for_two_changes_at_one_place_and_for_a_number_that_is_not_there() -> None:
    project = Project((SourceFile(Path("a.src"), SOURCE.replace("XP1", POINT)),))
    frames = Cell(arm().model.robot)
    targets = krl.ROW.read(project, frames).targets
    (joints,) = [target for target in targets if target.form == "joints"]
    first = joints.numbers[0]
    right = TextChange(0, Numbers([first]), "20.5")
    assert "A1 20.5," in corrected(krl.ROW, project, frames, expected_targets(targets), edit_texts(project, [right]))[0]
    with pytest.raises(ProofFailure, match="two changes at one place"):
        corrected(krl.ROW, project, frames, expected_targets(targets), edit_texts(project, [right, right]))
    with pytest.raises(ProofFailure):
        corrected(
            krl.ROW,
            project,
            frames,
            expected_targets(targets),
            edit_texts(project, [TextChange(0, Numbers([first]), "20.5,A2 1.0")]),
        )
    moved = type(first)(first.start - 1, first.text)
    with pytest.raises(ProofFailure, match="does not stand where it should"):
        corrected(
            krl.ROW,
            project,
            frames,
            expected_targets(targets),
            edit_texts(project, [TextChange(0, Numbers([moved]), "20.5")]),
        )


SLIPS: dict[str, Callable[[Target], Target]] = {
    "moved": lambda t: replace(t, numbers=_other(t.numbers, 2, lambda n: Number(n.start + 1, n.text))),
    "another text": lambda t: replace(t, numbers=_other(t.numbers, -1, lambda n: Number(n.start, f"{n.text}0"))),
    "one less": lambda t: replace(t, numbers=Numbers(t.numbers[:-1])),
    "another line": lambda t: replace(t, line=t.line + 1),
    "left": lambda t: replace(t, why="is computed"),
    "another frame": lambda t: replace(t, place=PoseReference(t.place.base + 1e-12, t.place.tool)),
    "no frame": lambda t: replace(t, place=None),
    "another turn": lambda t: replace(
        t,
        branch=replace(
            t.branch,
            words=replace(t.branch.words, numbers=_other(t.branch.words.numbers, 1, lambda n: Number(n.start, "7"))),
        ),
    ),
    "no turn": lambda t: replace(t, branch=replace(t.branch, words=None)),
}
"""What a second reading may get wrong of a target that is a pose with S and T."""


def _other(numbers: Numbers, k: int, change: Callable[[Number], Number]) -> Numbers:
    """Numbers of which one is another."""
    own = list(numbers)
    own[k] = change(own[k])
    return Numbers(own)


@pytest.mark.parametrize("slip", SLIPS)
def test_a_proof_fails_whatever_the_second_reading_has_otherwise(slip: str) -> None:
    point = "{X 800,Y 100,Z 900,A 10,B 20,C 30,S 2,T 10}"
    moves = "\n".join(f"PTP {point}" for _ in range(3))
    text = f"DEF a()\n$BASE = {{X 0,Y 0,Z 0,A 0,B 0,C 0}}\n$TOOL = {{X 0,Y 0,Z 0,A 0,B 0,C 0}}\n{moves}\nEND\n"
    project, frames = Project((SourceFile(Path("a.src"), text),)), Cell(arm().model.robot)
    targets = list(krl.ROW.read(project, frames).targets)
    assert [t.why for t in targets] == [""] * 3 and targets[1].branch.words is not None
    changes = [
        TextChange(0, t.numbers, NUL.join(f"{number.value + 1.125:.3f}" for number in t.numbers)) for t in targets
    ]

    def slipped(project: Project, cell: Cell) -> ProgramReading:
        first, second, third = krl.ROW.read(project, cell).targets
        return ProgramReading([first, SLIPS[slip](second), third])

    (new,) = corrected(krl.ROW, project, frames, expected_targets(targets), edit_texts(project, changes))
    assert new.count("X 801.125,") == 3
    with pytest.raises(ProofFailure, match=f"line {targets[1].line}, "):
        corrected(
            replace(krl.ROW, read=slipped), project, frames, expected_targets(targets), edit_texts(project, changes)
        )
