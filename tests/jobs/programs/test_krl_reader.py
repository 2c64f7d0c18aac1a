"""The reader of KRL: what each statement does to bases, tools, points and postures."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from made_programs import transform
from program_attacks import krl as attack_table
from program_attacks.krl import ATTACKS, BEGIN, CONFIG, FORM, FRAME, FULL, GOOD, INLINE, OTHER, POSE, program, project
from programs_marked import cell_of, project_of, wrong
from robots import ur10

from aridcal.jobs.apply.programs.cell import Cell, ProgramReading
from aridcal.jobs.apply.programs.frames import KnownFrames
from aridcal.jobs.apply.programs.krl import ROW, table
from aridcal.jobs.apply.programs.krl.writing import END_OF_FILE
from aridcal.jobs.apply.programs.moves import Moves, Stop
from aridcal.jobs.apply.programs.notations import KUKA
from aridcal.jobs.apply.programs.project import Project, SourceFile
from aridcal.jobs.apply.programs.targets import Target

CELL = Cell(ur10())


def read(files: Mapping[str, str], cell: Cell = CELL) -> ProgramReading:
    """A project as the reader has it; names that begin with ``$`` are context."""
    _, sources, _ = project_of(files)
    return ROW.read(sources, cell)


def frame(aggregate: str) -> np.ndarray:
    """T of six numbers."""
    return KUKA.pose(np.array([float(v) for v in re.findall(r"-?\d+\.?\d*", aggregate)][:6]))


def places(body: str, more: str = "", cell: Cell = CELL) -> list[Target]:
    """Targets of poses that are not left, of a program of one file."""
    targets = read(program(body, more), cell).targets
    assert not [t.why for t in targets if t.why]
    return [t for t in targets if t.form == "pose"]


@pytest.mark.parametrize("attack", [a for a in ATTACKS if a.why], ids=lambda attack: attack.name)
def test_reasons_name_what_changes_the_meaning(attack: attack_table.Attack) -> None:
    language, sources, _ = project_of(attack.files)
    reasons = [t.why for t in language.read(sources, cell_of(language, attack.frames)).targets if t.why]
    assert any(re.search(re.escape(attack.why).replace(r"\|", "|"), reason) for reason in reasons), reasons


@pytest.mark.parametrize(
    ("body", "base"),
    [
        (f"$BASE={FRAME}", frame(FRAME)),
        (f"$BASE={FRAME}:{OTHER}", frame(FRAME) @ frame(OTHER)),
        (f"$BASE={{FRAME: {FRAME[1:]}", frame(FRAME)),
        (f"F={FRAME}\n$BASE=F:{OTHER}", frame(FRAME) @ frame(OTHER)),
        (f"F={FRAME}:{OTHER}\n$BASE=F", frame(FRAME) @ frame(OTHER)),
        (f"F={FRAME}\nF.Z=7\n$BASE=F", transform((0, 0, -0.043), (0, 0, 0)) @ frame(FRAME)),
        ("$BASE=$NULLFRAME", np.eye(4)),
        ("$BASE=$WORLD", np.eye(4)),
        ("$BASE=$ROBROOT", np.eye(4)),
        ("BAS(#BASE,0)", np.eye(4)),
        ("bas ( #base , 0 )", np.eye(4)),
        (f"$BASE={FRAME}\n$BASE.X=-20.5\n$BASE.z=+3e1", transform((-0.1205, 0, -0.02), (0, 0, 0)) @ frame(FRAME)),
        (f"$BASE={FRAME}\n$BASE=$BASE:{OTHER}", frame(FRAME) @ frame(OTHER)),
        (f"BASE_DATA[3]={FRAME}\nBASE_DATA[4]={OTHER}\nBAS(#BASE,3)", frame(FRAME)),
        (f"BASE_DATA[3]={FRAME}\nBAS(#BASE,3)\nBASE_DATA[3]={OTHER}", frame(FRAME)),
        (f"BASE_DATA[3]={FRAME}\nI=3\nBAS(#BASE,I)", frame(FRAME)),
        (
            f"BASE_DATA[3]={FRAME}\nFDAT_ACT={{TOOL_NO 0,BASE_NO 3,IPO_FRAME #BASE}}\nBAS(#FRAMES,0)\n$TOOL=$NULLFRAME",
            frame(FRAME),
        ),
        (f"IF $IN[1] THEN\n$BASE={FRAME}\nELSE\n$BASE={FRAME}\nENDIF", frame(FRAME)),
        ("sub()", frame(FRAME)),
        ("sub2(3)", np.eye(4)),
    ],
)
def test_bases_that_the_program_states_are_followed_exactly(body: str, base: np.ndarray) -> None:
    more = f"DEF sub()\n$BASE={FRAME}\nEND\nDEF sub2(n:IN)\nINT n\nBASE_DATA[3]=$NULLFRAME\nBAS(#BASE,n)\nEND\n"
    (target,) = places(f"{body}\nLIN {POSE}", more if body.startswith("sub") else "")
    assert target.place is not None
    np.testing.assert_allclose(target.place.base, base, atol=1e-12)


@pytest.mark.parametrize(
    ("move", "before", "behind"),
    [
        (f"LIN P1:{FRAME}", np.eye(4), frame(FRAME)),
        (f"LIN P1:{FRAME}:{OTHER}", np.eye(4), frame(FRAME) @ frame(OTHER)),
        (f"LIN {FRAME}:P1", frame(FRAME), np.eye(4)),
        (f"F={FRAME}\nLIN P1:F", np.eye(4), frame(FRAME)),
    ],
)
def test_shifted_points_are_at_the_product_of_their_frames(move: str, before: np.ndarray, behind: np.ndarray) -> None:
    (target,) = places(f"P1={POSE}\n{move}")
    assert target.place is not None
    base, tool = transform((0.001, 0.002, 0.003), (0, 0, 0)), transform((0, 0, 0.1), (0, 0, 0))
    flange = base @ before @ frame(POSE) @ behind @ np.linalg.inv(tool)
    np.testing.assert_allclose(target.place.base @ frame(POSE) @ np.linalg.inv(target.place.tool), flange, atol=1e-12)


def test_inline_forms_take_tool_and_base_from_their_data() -> None:
    files = project(INLINE, f"DECL E6POS XP1={FULL}\n{FORM.replace('BASE_NO 1', 'BASE_NO 2')}", _config__dat=CONFIG)
    (target,) = (t for t in read(files).targets if t.form == "pose")
    assert target.place is not None and not target.why
    np.testing.assert_allclose(target.place.base, frame(OTHER), atol=1e-12)
    np.testing.assert_allclose(target.place.tool, frame(FRAME), atol=1e-12)
    assert target.branch.words is None or [n.text for n in target.branch.words.numbers] == ["2", "10"]


def test_the_base_of_a_spline_segment_holds_for_it_alone() -> None:
    first, second, third = places(
        f"SLIN {POSE} WITH $BASE=$NULLFRAME,$VEL.CP=0.2\nSLIN {OTHER}\nSPLINE WITH $BASE={FRAME}\nSPL {POSE}\nENDSPLINE"
    )
    assert first.place is not None and second.place is not None and third.place is not None
    np.testing.assert_allclose(first.place.base, np.eye(4))
    np.testing.assert_allclose(second.place.base[:3, 3], (0.001, 0.002, 0.003))
    np.testing.assert_allclose(third.place.base, frame(FRAME), atol=1e-12)


def test_the_foot_of_the_robot_in_the_world_comes_from_the_machine_data() -> None:
    machine = f"DEFDAT $MACHINE PUBLIC\nFRAME $ROBROOT={FRAME}\nENDDAT\n"
    (target,) = (
        t for t in read({**program(f"$BASE={OTHER}\nLIN {POSE}"), "$machine.dat": machine}).targets if t.form == "pose"
    )
    assert target.place is not None
    np.testing.assert_allclose(target.place.base, np.linalg.inv(frame(FRAME)) @ frame(OTHER), atol=1e-12)
    (target,) = (
        t for t in read({**program(f"$BASE=$ROBROOT\nLIN {POSE}"), "$machine.dat": machine}).targets if t.form == "pose"
    )
    assert target.place is not None
    np.testing.assert_allclose(target.place.base, np.eye(4), atol=1e-12)
    stated = Cell(ur10(), KnownFrames({"5": frame(OTHER)}))
    (target,) = (
        t
        for t in read({**program(f"BAS(#BASE,5)\nLIN {POSE}"), "$machine.dat": machine}, stated).targets
        if t.form == "pose"
    )
    assert target.place is not None
    np.testing.assert_allclose(target.place.base, frame(OTHER), atol=1e-12)


NO_AXES = "$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\n"


@pytest.mark.parametrize(
    ("body", "known"),
    [
        (f"LIN {POSE}", False),
        (f"PTP {POSE}", False),
        (f"PTP {FULL}", True),
        (f"PTP {FULL[:-6]}}}", False),
        (f"PTP {{A1 1,A2 -90,A3 90,A4 0,A5 9,A6 0}}\nLIN {POSE}", True),
        (f"PTP {{A1 1}}\nLIN {POSE}", False),
        (f"PTP {FULL}\nLIN {POSE}", True),
        (f"PTP {FULL}\nPTP XHOME\nLIN {POSE}", False),
        (f"PTP {FULL}\nLIN XSEAM\nLIN {POSE}", True),
        (f"PTP {FULL}\nPTP_REL {{A1 5}}\nLIN {POSE}", False),
        (f"PTP {FULL}\nLIN_REL {{Z 5}}\nLIN {POSE}", True),
        (f"PTP {FULL}\nPTP $AXIS_ACT\nLIN {POSE}", True),
        (f"PTP {FULL}\nMYSUB()\n{NO_AXES}$IPO_MODE=#BASE\nLIN {POSE}", False),
        (f"IF $IN[1] THEN\nPTP {FULL}\nENDIF\nLIN {POSE}", False),
        (f"PTP {FULL}:{FRAME}\nLIN {POSE}", False),
    ],
)
def test_how_the_arm_stands_is_known_behind_axes_and_points_with_status_and_turn(body: str, known: bool) -> None:
    targets = read({"a.src": f"DEF a()\n{NO_AXES}{body}\nEND\n"}).targets
    last = [t for t in targets if t.form == "pose" and not t.why][-1]
    assert (not last.branch.unknown) == known
    started = read({"a.src": f"DEF a()\n{NO_AXES}LIN {POSE}\nEND\n"}, Cell(ur10(), start=True)).targets
    assert not started[0].branch.unknown


def test_axes_are_read_in_degrees_and_those_that_are_not_stated_stay() -> None:
    (target,) = read({"a.src": "DEF a()\nPTP {A2 -90, A1 45.5, E1 3}\nEND\n"}).targets
    assert (
        target.form == "joints" and [n.text for n in target.numbers] == ["45.5", "-90"] and target.readings is not None
    )
    np.testing.assert_allclose(np.degrees(target.readings[:2]), (45.5, -90))
    assert np.isnan(target.readings[2:]).all()


def test_targets_come_in_the_order_of_the_moves_and_once() -> None:
    data = f"DECL E6POS P1={POSE}\nDECL E6POS P2={OTHER}\nDECL E6POS P3={POSE}"
    targets = read(project("LIN P2\nLIN P1\nLIN P2", data)).targets
    assert [t.name for t in targets if t.form == "pose"] == ["P2", "P1", "P3"]
    assert [bool(t.why) for t in targets if t.form == "pose"] == [False, False, True]


def test_every_row_of_the_tables_is_taken_as_it_says() -> None:
    for word in sorted(table.SYSTEM_VARIABLES):
        assert not wrong(program(f"{GOOD}\n{word.upper()}=R\n{GOOD}")), word
    for name in sorted((table.FUNCTIONS | table.WRITING | table.PACKAGES) - {"ek", "eb", "lk"}):
        assert not wrong(program(f"{GOOD}\n{name}(3)\nR={name}(I)\n{GOOD}")), name
        assert not wrong(program(f"P1=⟦{POSE}⟧\nLIN P1\n{name}(P1)\n{GOOD}")), name
    for command in sorted(table.BAS_HARMLESS):
        assert not wrong(program(f"{GOOD}\nBAS({command},3)\n{GOOD}")), command
    for name in sorted(table.ODD):
        assert wrong(program(f"{GOOD}\n{name}()\n{GOOD}")), name
    for word in ("wait for", "wait sec", *sorted(table.HARMLESS - {"wait"})):
        assert not wrong(program(f"{GOOD}\n{word} $IN[1]\n{GOOD}")), word
        assert not wrong(program(f"P1=⟦{POSE}⟧\nLIN P1\n{word} P1.X>3\n{GOOD}")), word
    for held in sorted(table.HELD):
        targets = read(program(f"PTP {held.upper()}\n{GOOD.replace('⟨', '').replace('⟩', '')}")).targets
        assert len(targets) == 2 and not any(t.why for t in targets), held
    for module in sorted(table.SYSTEM_MODULES):
        text = f"DEF {module}()\n$BASE=$NULLFRAME\nEND\n"
        assert not wrong({**program(GOOD), f"{module}.src": text}), module


def test_what_is_in_no_table_is_not_taken_as_harmless() -> None:
    for statement in (
        "$NEVERHEARD=1",
        "$NEVERHEARD[1].X=R",
        "NEVERHEARD(1)",
        "NEVERHEARD P1",
        "R=NEVERHEARD(I)",
        "BAS(#NEVER,1)",
    ):
        assert wrong(program(f"{GOOD}\n{statement}\n{GOOD}")), statement


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_line_ends_marks_and_cases_change_nothing(line_end: str) -> None:
    text = program(f"$BASE={FRAME}\nLIN {POSE}")["a.src"]
    for form in (text, text.lower(), "\xef\xbb\xbf" + text, text + END_OF_FILE, text.replace(" ", "\t")):
        targets = ROW.read(Project((SourceFile(Path("a.src"), form.replace("\n", line_end)),)), CELL).targets
        assert [t.why for t in targets] == ["", ""]
        assert targets[1].place is not None
        np.testing.assert_allclose(targets[1].place.base, frame(FRAME), atol=1e-12)
        for target in targets:
            for number in target.numbers:
                assert form.replace("\n", line_end)[number.start : number.end] == number.text


def test_the_mark_of_a_corrected_program_changes_no_target() -> None:
    files = program(f"{GOOD}\nLIN {OTHER}")
    text = files["a.src"].replace("⟨", "").replace("⟩", "")
    for ending in ("", "\n", END_OF_FILE, "\r\n"):
        own = text.rstrip("\n") + ending
        place, insertion = ROW.comment(own, "corrected by a calibration") if ROW.comment else (0, "")
        marked = own[:place] + insertion + own[place:]
        assert insertion.lstrip().startswith(";") and insertion.endswith("\n")
        before, after = (ROW.read(Project((SourceFile(Path("a.src"), t),)), CELL).targets for t in (own, marked))
        assert [(t.line, t.numbers, t.why) for t in before] == [(t.line, t.numbers, t.why) for t in after]


def test_the_other_half_and_the_controllers_data_lists_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "KRC" / "R1" / "Program" / "weld"
    system, mada = tmp_path / "KRC" / "R1" / "System", tmp_path / "KRC" / "R1" / "Mada"
    for own in (folder, system, mada):
        own.mkdir(parents=True)
    for own in (
        folder / "a.src",
        folder / "A.dat",
        folder / "b.dat",
        system / "$config.dat",
        system / "bas.src",
        mada / "$machine.dat",
    ):
        own.write_text("")
    assert set(ROW.context(folder / "a.src")) == {folder / "A.dat", system / "$config.dat", mada / "$machine.dat"}
    assert ROW.context(tmp_path / "nowhere" / "a.src") == []


def test_planned_moves_are_read_back_as_they_were_planned() -> None:
    readings = np.radians([10, -80, 90, 5, 40, 6.5])
    made = Moves("cell", tuple("abcdef"), ("revolute",) * 6, (Stop(readings, 0, ""), Stop(-readings, 1, "x")), 0.5)
    assert ROW.write is not None
    text = "".join(f"{line}\n" for line in ROW.write(made, "poses"))
    targets = ROW.read(Project((SourceFile(Path("poses.src"), text),)), CELL).targets
    assert [t.why for t in targets] == ["", ""]
    np.testing.assert_allclose(targets[1].readings, -readings, atol=1e-6)


def test_no_text_ends_in_an_exception() -> None:
    rng = np.random.default_rng(0)
    seeds = [text for attack in ATTACKS for text in attack.files.values()]
    pieces = [
        "{",
        "}",
        "(",
        ")",
        "[",
        "]",
        '"',
        ";",
        ":",
        "'",
        "\r",
        "\x1a",
        "1e999",
        "nan",
        "9" * 400,
        "IF",
        "ENDIF",
        "DEF",
        "END",
        "&",
        ",",
        "",
    ]
    for _ in range(600):
        text = str(rng.choice(seeds)).replace("⟦", "").replace("⟧", "").replace("⟨", "").replace("⟩", "")
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(text) + 1))
            text = text[:at] + str(rng.choice(pieces)) + text[at + int(rng.integers(0, 6)) :]
        name = "a.dat" if text.startswith("DEFDAT") else "a.src"
        for target in ROW.read(Project((SourceFile(Path(name), text),)), CELL).targets:
            assert target.why or (target.numbers and np.isfinite(target.values).all())
            for number in target.numbers:
                assert text[number.start : number.end] == number.text


@pytest.mark.parametrize(
    "text", ["", "\n", "DEF", "END", '"', "DEFDAT x\nENDDAT", "IF\n" * 200, "LIN (" * 3000, "{X 1," * 3000]
)
def test_files_without_a_program_have_no_targets_that_are_corrected(text: str) -> None:
    for name in ("a.src", "a.dat"):
        assert all(t.why for t in ROW.read(Project((SourceFile(Path(name), text),)), CELL).targets)


def test_programs_with_too_many_ways_are_left_as_a_whole() -> None:
    body = "LOOP\n" * 40 + f"LIN {POSE}\n" * 50 + "ENDLOOP\n" * 40
    targets = read({"a.src": f"DEF a()\n{BEGIN}{body}END\n"}).targets
    assert len(targets) > 50 and all("more ways" in t.why for t in targets)


@pytest.mark.parametrize(
    ("moves", "asked", "settled"),
    [
        ("PTP P1", True, True),
        ("SPTP P1", True, True),
        ("LIN P1", False, False),
        ("SLIN P1", False, False),
        ("CIRC P1,P1", False, False),
        ("SPLINE\nSPL P1\nENDSPLINE", False, False),
        ("LIN P1\nPTP P1", True, False),
    ],
)
def test_status_and_turn_are_asked_for_by_moves_of_all_axes_alone(moves: str, asked: bool, settled: bool) -> None:
    """Where nothing but linear moves goes to a point, its S and T say nothing, and it is not known how the arm comes there."""
    text = f"DEF a()\nDECL E6POS P1\n$BASE={FRAME}\n$TOOL={FRAME}\nP1={FULL}\n{moves}\nEND\n"
    (target,) = read({"a.src": text}).targets
    words = target.branch.words
    assert (words is not None, bool(target.branch.unknown), target.why) == (asked, not settled, "")
    assert words is None or [n.text for n in words.numbers] == ["2", "10"]
