"""CPU time and memory of `aridcal compensate results PROGRAM -o OUT`, the whole command in a process of its own.

Each language is written plainly, one move a line, and as the heaviest of common systems write it: RoboDK's `pose_trans`, KUKA's
inline forms, declared points of RAPID, points of FANUC with frames, numbered blocks with arcs. The arm is the simulated UR10 of
`tests/support/calibrated.py`; G-code is for the gantry of `made_gcode.py` beside it. The exponent is that
of the cost by the length: 1 is linear. Then files that nobody writes: each should end soon, whatever it says.

Example:
    PYTHONPATH=.:tests/support nice python benchmarks/program_speed.py --moves 10000 100000
    PYTHONPATH=.:tests/support nice python benchmarks/program_speed.py --only .src --moves 100000
    PYTHONPATH=.:tests/support nice python benchmarks/program_speed.py --hostile
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from calibrated import machine
from made_gcode import calibrated_gantry
from rich.console import Console
from rich.table import Table
from target_correction import HOME

from aridcal.engine.robot.chain import Robot
from aridcal.jobs.apply.programs.branches import flanges
from aridcal.jobs.apply.programs.notations import ABB, FANUC, KUKA, UR, YASKAWA
from aridcal.jobs.apply.programs.targets import Notation

BASE = "format: 1\nbases: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\ntools: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\n"

FRAMES = "format: 1\nbases: {'1': {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\ntools: {'1': {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\n"

GANTRY = "format: 1\nbases: {G54: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}\nstart: [0, 0, 0]\n"

LONGEST = 300
"""[s] of CPU: what takes longer is ended."""

Numbers = Sequence[Sequence[float]]


@dataclass(frozen=True)
class Style:
    """A way to write programs.

    Attributes:
        name: For the table.
        ending: Of the file.
        notation: Of its poses; None: millimetres of a gantry's axes.
        files: The text of each file by its ending, for numbers of each move.
        frames: The file of `--frames`; empty: none.
    """

    name: str
    ending: str
    notation: Notation | None
    files: Callable[[Numbers], Mapping[str, str]]
    frames: str = ""


def urscript(numbers: Numbers) -> dict[str, str]:
    lines = [f"  movel(p[{listed(own, 6)}], a=1.2, v=0.25, r=0.005)" for own in numbers]
    return {".script": "\n".join(["def path():", f"  movej([{listed(HOME, 4)}], a=1.4, v=1.05)", *lines, "end", ""])}


def robodk(numbers: Numbers) -> dict[str, str]:
    head = ["def path():", "  global speed_ms = 0.25", "  global accel_mss = 1.2", "  global blend_radius_m = 0.005"]
    head += ["  set_tcp(p[0, 0, 0.1, 0, 0, 0])", "  ref_frame = p[0.1, 0, 0, 0, 0, 0]"]
    head += [f"  movej([{listed(HOME, 4)}], accel_mss, speed_ms, 0, 0)"]
    moves = [
        f"  movel(pose_trans(ref_frame,p[{listed(own, 6)}]),accel_mss,speed_ms,0,blend_radius_m)" for own in numbers
    ]
    return {".script": "\n".join([*head, *moves, "end", ""])}


def krl(numbers: Numbers) -> dict[str, str]:
    head = ["DEF path()", "$BASE = {X 0,Y 0,Z 0,A 0,B 0,C 0}", "$TOOL = {X 0,Y 0,Z 0,A 0,B 0,C 0}"]
    head += ["PTP {A1 17.2,A2 -68.8,A3 85.9,A4 -85.9,A5 -80.2,A6 11.5}"]
    return {".src": "\r\n".join([*head, *(f"LIN {{{kuka(own)}}} C_DIS" for own in numbers), "END", ""])}


def inline_forms(numbers: Numbers) -> dict[str, str]:
    source, data = ["&ACCESS RVP", "DEF path()", "PTP {A1 17.2,A2 -68.8,A3 85.9,A4 -85.9,A5 -80.2,A6 11.5}"], []
    for k, own in enumerate(numbers, start=1):
        source += [
            f";FOLD LIN P{k} CONT Vel=2 m/s CPDAT{k} Tool[1] Base[1];%{{PE}}%R 8.3.22,%MKUKATPBASIS,%CMOVE,%P 1:LIN, 2:P{k}",
            "$BWDSTART=FALSE",
            f"LDAT_ACT=LCPDAT{k}",
            f"FDAT_ACT=FP{k}",
            "BAS(#CP_PARAMS,2)",
            f"LIN XP{k} C_DIS",
            ";ENDFOLD",
            "",
        ]
        data += [
            f"DECL E6POS XP{k}={{{kuka(own)},E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}",
            f'DECL FDAT FP{k}={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}}',
            f"DECL LDAT LCPDAT{k}={{VEL 2.0,ACC 100.0,APO_DIST 100.0,APO_FAC 50.0,ORI_TYP #VAR}}",
        ]
    return {
        ".src": "\r\n".join([*source, "END", ""]),
        ".dat": "\r\n".join(["&ACCESS RVP", "DEFDAT path", *data, "ENDDAT", ""]),
    }


def rapid(numbers: Numbers) -> dict[str, str]:
    moves = (f"    MoveL [{abb(own)}], v100, z5, tool0;" for own in numbers)
    return {".mod": "\n".join(["MODULE path", "  PROC main()", HOMING, *moves, "  ENDPROC", "ENDMODULE", ""])}


def declared(numbers: Numbers) -> dict[str, str]:
    points = (f"  CONST robtarget Target_{k}:=[{abb(own)}];" for k, own in enumerate(numbers))
    moves = (f"    MoveL Target_{k},v100,z5,tool0\\WObj:=wobj0;" for k in range(len(numbers)))
    return {".mod": "\n".join(["MODULE path", *points, "  PROC main()", HOMING, *moves, "  ENDPROC", "ENDMODULE", ""])}


HOMING = "    MoveAbsJ [[17.2,-68.8,85.9,-85.9,-80.2,11.5],[9E9,9E9,9E9,9E9,9E9,9E9]], v100, fine, tool0;"


def fanuc(numbers: Numbers) -> dict[str, str]:
    moves = [f"{k:4d}:L P[{k}] 100mm/sec CNT50    ;" for k in range(1, len(numbers) + 1)]
    return {".ls": listing(moves, numbers)}


def fanuc_framed(numbers: Numbers) -> dict[str, str]:
    moves = []
    for k in range(1, len(numbers) + 1):
        moves += [f"  UFRAME_NUM=1 ;\r\n  UTOOL_NUM=1 ;\r\n  !point {k} ;", f":L P[{k}] R[1]mm/sec CNT50 ACC80   ;"]
        moves += ["  DO[1]=ON ;\r\n  WAIT   .10(sec) ;"]
    return {".ls": listing(moves, numbers)}


def listing(moves: Sequence[str], numbers: Numbers) -> str:
    home = zip(range(1, 7), (17.2, -68.8, 85.9, -85.9, -80.2, 11.5), strict=True)
    lines = ["/PROG  PATH", "/ATTR", "/MN", "   1:J P[999999] 100% FINE ;", *moves, "/POS", "P[999999]{", "   GP1:"]
    lines += ["\tUF : 1, UT : 1,", ",\t".join(f"J{j}= {value:.3f} deg" for j, value in home), "};"]
    for k, (x, y, z, w, p, r) in enumerate(numbers, start=1):
        lines += [f"P[{k}]{{", "   GP1:", "\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',"]
        lines += [f"\tX =  {x:.3f}  mm,\tY =   {y:.3f}  mm,\tZ =   {z:.3f}  mm,"]
        lines += [f"\tW =   {w:.3f} deg,\tP =   {p:.3f} deg,\tR =   {r:.3f} deg", "};"]
    return "\r\n".join([*lines, "/END", ""])


def inform(numbers: Numbers) -> dict[str, str]:
    lines = ["/JOB", "//NAME PATH", "//POS", f"///NPOS {len(numbers) + 1},0,0,0,0,0", "///USER 1", "///TOOL 1"]
    lines += ["///POSTYPE PULSE", "///PULSE", "C00000=17200,-68800,85900,-85900,-80200,11500"]
    lines += ["///POSTYPE USER", "///RECTAN", "///RCONF 1,0,0,0,0,0,0,0"]
    lines += [f"C{k:05d}={','.join(f'{value:.4f}' for value in own)}" for k, own in enumerate(numbers, start=1)]
    lines += ["//INST", "///DATE 2026/11/28 10:26", "///ATTR SC,RW", "///GROUP1 RB1", "NOP", "MOVJ C00000 VJ=10.00"]
    moves = [f"MOVL C{k:05d} V=100.0 PL=1" for k in range(1, len(numbers) + 1)]
    return {".jbi": "\r\n".join([*lines, *moves, "END", ""])}


def gcode(numbers: Numbers) -> dict[str, str]:
    blocks = (f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f}" for x, y, z in numbers)
    return {".nc": "\n".join(["%", "G17 G21 G40 G49 G54 G80 G90", "G0 X0 Y0 Z0", "F1000", *blocks, "M30", "%", ""])}


def gcode_arcs(numbers: Numbers) -> dict[str, str]:
    blocks = (
        f"N{10 * k} G{'1' if k % 3 else '2'} X{x:.3f} Y{y:.3f} Z{z:.3f}{'' if k % 3 else ' I1.5 J0.5'} F{800 + k % 9} (pass {k})"
        for k, (x, y, z) in enumerate(numbers)
    )
    return {".nc": "\n".join(["%", "G17 G21 G40 G49 G54 G80 G90", "G0 X0 Y0 Z0", *blocks, "M30", "%", ""])}


def listed(values: Sequence[float] | np.ndarray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def kuka(own: Sequence[float]) -> str:
    return ",".join(f"{key} {value:.3f}" for key, value in zip("XYZABC", own, strict=True))


def abb(own: Sequence[float]) -> str:
    """A robtarget's parts; the last three numbers are quarters of turns of axes 1, 4 and 6."""
    return f"[{listed(own[:3], 3)}],[{listed(own[3:7], 6)}],[{listed(own[7:], 0)},0],[9E9,9E9,9E9,9E9,9E9,9E9]"


STYLES = (
    Style("URScript, poses", ".script", UR, urscript, BASE),
    Style("URScript, pose_trans", ".script", UR, robodk, BASE),
    Style("KRL, LIN", ".src", KUKA, krl),
    Style("KRL, inline forms", ".src", KUKA, inline_forms, FRAMES),
    Style("RAPID, poses", ".mod", ABB, rapid),
    Style("RAPID, declared", ".mod", ABB, declared),
    Style("FANUC", ".ls", FANUC, fanuc, FRAMES),
    Style("FANUC, six lines each", ".ls", FANUC, fanuc_framed, FRAMES),
    Style("INFORM", ".jbi", YASKAWA, inform, f"{FRAMES}pulses_per_degree: [1000, 1000, 1000, 1000, 1000, 1000]\n"),
    Style("G-code", ".nc", None, gcode, GANTRY),
    Style("G-code, arcs, comments", ".nc", None, gcode_arcs, GANTRY),
)


def hostile(n: int) -> Iterator[tuple[str, str, str]]:
    """Name, ending and text of files that nobody writes; n pieces each."""
    deep = 55
    nested = n // deep
    for name, piece in (("movel(", "movel("), ("movel(p[", "movel(p["), ("quotes", '"'), ("p[0,", "p[0,")):
        yield f"{name} unclosed", ".script", f"def f():\n{piece * n}\nend\n"
        yield f"{name} unclosed, on lines", ".script", f"def f():\n{(piece + chr(10)) * n}end\n"
    yield "nested if", ".script", "def f():\n" + ("if x:\n" * deep + "movej(q)\n" + "end\n" * deep) * nested + "end\n"
    yield "nested while", ".script", "def f():\n" + "while x:\n" * 40 + "y = 1\n" * n + "end\n" * 40 + "end\n"
    yield "functions", ".script", "".join(f"def f{k}():\nf{k + 1}()\nend\n" for k in range(n // 5))
    yield "if, too deep", ".script", "def f():\n" + "if x:\n" * n + "end\n" * n + "end\n"
    for name, piece in (("LIN {", "LIN {"), ("quotes", '"'), ("brackets", "(["), ("{X 1,", "{X 1,")):
        yield f"{name} unclosed", ".src", f"DEF f()\n{piece * n}\nEND\n"
        yield f"{name} unclosed, on lines", ".src", f"DEF f()\n{(piece + chr(10)) * n}END\n"
    yield "nested IF", ".src", "DEF f()\n" + ("IF x THEN\n" * deep + "PTP p\n" + "ENDIF\n" * deep) * nested + "END\n"
    yield "nested LOOP", ".src", "DEF f()\n" + "LOOP\n" * 40 + "y = 1\n" * n + "ENDLOOP\n" * 40 + "END\n"
    yield "procedures", ".src", "".join(f"DEF f{k}()\nf{k + 1}()\nEND\n" for k in range(n // 5))
    yield "jumps", ".src", "DEF f()\n" + "".join(f"L{k}:\nGOTO L{k // 2}\n" for k in range(n // 20)) + "END\n"
    for name, piece in (("MoveL [[", "MoveL [["), ("quotes", '"'), ("brackets", "(["), ("Offs(", "Offs(")):
        yield f"{name} unclosed", ".mod", f"MODULE m\nPROC f()\n{piece * n}\nENDPROC\nENDMODULE\n"
        yield f"{name} unclosed, on lines", ".mod", f"MODULE m\nPROC f()\n{(piece + chr(10)) * n}ENDPROC\nENDMODULE\n"
    ifs = ("IF x THEN\n" * deep + "MoveL p,v,z,t;\n" + "ENDIF\n" * deep) * nested
    yield "nested IF", ".mod", f"MODULE m\nPROC f()\n{ifs}ENDPROC\nENDMODULE\n"
    loops = "WHILE x DO\n" * 40 + "y := 1;\n" * n + "ENDWHILE\n" * 40
    yield "nested WHILE", ".mod", f"MODULE m\nPROC f()\n{loops}ENDPROC\nENDMODULE\n"
    procedures = "".join(f"PROC f{k}()\nf{k + 1};\nENDPROC\n" for k in range(n // 5))
    yield "procedures", ".mod", f"MODULE m\n{procedures}ENDMODULE\n"
    for name, piece in (("L P[", "L P["), ("quotes", '"'), ("brackets", "(["), ("P[1]{", "P[1]{")):
        yield f"{name} unclosed", ".ls", f"/PROG F\n/MN\n{piece * n}\n/POS\n{piece * n}\n/END\n"
        yield (
            f"{name} unclosed, on lines",
            ".ls",
            f"/PROG F\n/MN\n{(piece + chr(10)) * n}/POS\n{(piece + chr(10)) * n}/END\n",
        )
    jumps = "".join(f"  LBL[{k}] ;\n  IF R[1]=1,JMP LBL[{k // 2}] ;\n" for k in range(1, n // 20))
    yield "jumps", ".ls", f"/PROG F\n/MN\n{jumps}/POS\n/END\n"
    for name, piece in (("(", "("), ("[", "["), ("G1 X[", "G1 X["), ("G1 X", "G1 X"), ("quotes", '"')):
        yield f"{name} unclosed", ".nc", f"%\n{piece * n}\n%\n"
        yield f"{name} unclosed, on lines", ".nc", f"%\n{(piece + chr(10)) * n}%\n"
    yield "O-calls", ".nc", "".join(f"O{k} sub\nO{k + 1} call\nO{k} endsub\n" for k in range(1, n // 5)) + "M2\n"


def cost(command: Sequence[str]) -> tuple[float, float, int, str]:
    """CPU time of a command, [s], its most memory, [MB], its exit status, and the last line that it says."""
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stdout=said, stderr=said, env={**os.environ, "OMP_NUM_THREADS": "1"})
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (LONGEST, LONGEST))
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = said.read().decode("utf-8", "replace").splitlines()
    last = next((line for line in reversed(lines) if line.strip()), "")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, process.returncode, last


def seam(n: int) -> np.ndarray:
    """Readings of n targets, each close to the one before, where the arm was calibrated."""
    t = np.linspace(0.0, 0.03 * n, n)[:, None]
    return HOME + 0.2 * np.sin(t * [0.5, 0.6, 0.7, 0.8, 0.9, 1.0])


class Bench:
    """A folder with the calibrations of both machines."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._arm, self._gantry = machine(3, n=150), calibrated_gantry(rotary=False)
        (folder / "arm.yaml").write_text(self._arm.saved.dump())
        (folder / "gantry.yaml").write_text(self._gantry.saved.dump())

    def numbers(self, style: Style, n: int) -> Numbers:
        """Numbers of each move along a seam."""
        if style.notation is None:
            t = np.linspace(0.0, 0.01 * n, n)[:, None]
            return (1e3 * np.sin(t * [0.7, 0.9, 1.0]) * [0.8, 0.8, 0.3]).tolist()
        robot: Robot = self._arm.model.robot
        q = seam(n)
        T = flanges(robot, q)
        if style.files is robodk:
            T[:, 0, 3] -= 0.1
            T[:, :3, 3] += 0.1 * T[:, :3, 2]
        if style.notation is ABB:
            numbers = np.hstack([ABB.numbers(T, np.ones((n, 7))), np.floor(q[:, [0, 3, 5]] / (np.pi / 2))])
        else:
            numbers = style.notation.numbers(T, np.zeros((n, 6)))
        return numbers.tolist()

    def run(self, ending: str, files: Mapping[str, str], frames: str) -> tuple[float, float, int, str]:
        """What a program costs."""
        place = Path(tempfile.mkdtemp(dir=self._folder))
        for own, text in files.items():
            (place / f"path{own}").write_bytes(text.encode("latin-1"))
        calibration = self._folder / ("gantry.yaml" if ending == ".nc" else "arm.yaml")
        command = [sys.executable, "-m", "aridcal", "compensate", str(calibration)]
        programs = [str(place / f"path{own}") for own in files]
        out = place / "out"
        command += [*programs, "-o", str(out if len(programs) > 1 else out.with_suffix(ending))]
        if frames:
            (place / "frames.yaml").write_text(frames)
            command += ["--frames", str(place / "frames.yaml")]
        return cost(command)


def lengths(bench: Bench, styles: Sequence[Style], moves: Sequence[int], console: Console) -> None:
    """Print what programs of some lengths cost."""
    table = Table("program", "moves", "CPU [s]", "peak [MB]", "exponent", "the command's last line")
    for style in styles:
        before: tuple[int, float] | None = None
        for n in moves:
            took, memory, status, said = bench.run(style.ending, style.files(bench.numbers(style, n)), style.frames)
            exponent = "" if before is None else f"{np.log(took / before[1]) / np.log(n / before[0]):.2f}"
            before = (n, took)
            said = said.split(": ", 1)[-1]
            table.add_row(style.name, str(n), f"{took:.1f}", f"{memory:.0f}", exponent, f"{status}: {said[:60]}")
            print(f"{style.name}, {n}: {took:.1f} s, {memory:.0f} MB, {status}: {said[:90]}", file=sys.stderr)
    console.print(table)


def pathological(bench: Bench, only: str, n: int, console: Console) -> None:
    """Print what hostile files cost, and the status of the command: 0, or 2 where it refuses them."""
    table = Table("file", "ending", "bytes", "CPU [s]", "peak [MB]", "status", "the command's last line")
    for name, ending, text in hostile(n):
        if only in ("", ending):
            took, memory, status, said = bench.run(ending, {ending: text}, "")
            said = said.split(": ", 1)[-1]
            table.add_row(name, ending, str(len(text)), f"{took:.1f}", f"{memory:.0f}", str(status), said[:50])
            print(f"{ending} {name}: {took:.1f} s, {memory:.0f} MB, {status}: {said[:90]}", file=sys.stderr)
    console.print(table)


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    command.add_argument("--moves", type=int, nargs="+", default=[10_000, 100_000], help="lengths of programs")
    command.add_argument("--only", choices=sorted({style.ending for style in STYLES}), default="", help="one language")
    command.add_argument("--hostile", action="store_true", help="files that nobody writes, instead")
    command.add_argument("--pieces", type=int, default=100_000, help="of a hostile file")
    arguments = command.parse_args()
    console = Console(width=140)
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name))
        if arguments.hostile:
            pathological(bench, arguments.only, arguments.pieces, console)
        else:
            styles = [style for style in STYLES if arguments.only in ("", style.ending)]
            lengths(bench, styles, arguments.moves, console)


if __name__ == "__main__":
    main()
