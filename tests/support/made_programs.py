"""Robot programs as integrators write them, of which the truth is known: where each target's numbers stand, and what they mean.

A program is made from a template in which each target's numbers are marked, so that the corrected text can be read by the
template alone: what lies between the marks must be the same, and what lies at them are the new numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

MARK, WORD = "\x00", "\x01"
"""What stands in a template for a number of a target, and for a number of its posture."""

NUMBER = r"([-+]?\d+\.?\d*)"


@dataclass
class Made:
    """A program.

    Attributes:
        template: With a mark in place of each number of a target, and of its posture.
        numbers: As they stand in the program, in its order.
        words: Numbers of postures likewise.
        readings: Of each target, [rad].
        kinds: Of each target: ``joints`` or ``pose``.
        bases: Of each target: T_base_frame.
        tools: Of each target: T_tip_tool.
        frames: The file of ``--frames``; empty if the program states all.
        stale: Targets whose words for a posture nobody asks for, and that must stay as they stand.
    """

    template: str = ""
    numbers: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    readings: list[np.ndarray] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    bases: list[np.ndarray] = field(default_factory=list)
    tools: list[np.ndarray] = field(default_factory=list)
    frames: str = ""
    stale: set[int] = field(default_factory=set)

    @property
    def text(self) -> str:
        """The program."""
        values = {MARK: iter(self.numbers), WORD: iter(self.words)}
        return re.sub(f"[{MARK}{WORD}]", lambda mark: next(values[mark.group()]), self.template)

    def read(self, text: str) -> list[str] | None:
        """Numbers of a corrected program; None where anything else is not as it was, but for the comment that says so."""
        numbers = self._marked(text)
        return None if numbers is None else [number for mark, number in numbers if mark == MARK]

    def read_words(self, text: str) -> list[str]:
        """Numbers of postures in a corrected program."""
        return [number for mark, number in self._marked(text) or () if mark == WORD]

    def _marked(self, text: str) -> list[tuple[str, str]] | None:
        between = re.split(f"[{MARK}{WORD}]", self.template)
        match = re.fullmatch(NUMBER.join(map(re.escape, between)), unmarked(text))
        marks = [letter for letter in self.template if letter in (MARK, WORD)]
        return None if match is None else list(zip(marks, match.groups(), strict=True))


def unmarked(text: str) -> str:
    """A corrected program without the line that says that it is."""
    return re.sub(r"[^\n]*corrected by aridcal[^\n]*\n?", "", text)


def transform(xyz: Sequence[float], rpy: Sequence[float]) -> np.ndarray:
    """T of shape (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
    return T


def random_frame(rng: np.random.Generator, size: float) -> np.ndarray:
    """A frame some way off."""
    return transform(rng.uniform(-size, size, 3), rng.uniform(-1.0, 1.0, 3))


@dataclass(frozen=True)
class Dialect:
    """How a language writes.

    Attributes:
        pose: T to numbers.
        read: Numbers to T.
        joints: What a number of a joint is, [rad].
        head: Numbers of a pose that are text with so many digits.
        digits: Of a pose, and of joints.
    """

    pose: Callable[[np.ndarray], np.ndarray]
    read: Callable[[np.ndarray], np.ndarray]
    joints: float
    digits: tuple[int, int]


def _frame(position: np.ndarray, rotation: Rotation) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T


def _R(T: np.ndarray) -> Rotation:
    return Rotation.from_matrix(T[:3, :3])


DEGREE = np.pi / 180.0

UR = Dialect(
    lambda T: np.concatenate([T[:3, 3], _R(T).as_rotvec()]),
    lambda v: _frame(v[:3], Rotation.from_rotvec(v[3:])),
    1.0,
    (5, 4),
)
KUKA = Dialect(
    lambda T: np.concatenate([1e3 * T[:3, 3], _abc(T)]),
    lambda v: _frame(1e-3 * v[:3], _turn(v[3:])),
    DEGREE,
    (3, 3),
)
FANUC = Dialect(
    lambda T: np.concatenate([1e3 * T[:3, 3], _abc(T)[::-1]]),
    lambda v: _frame(1e-3 * v[:3], _turn(v[3:][::-1])),
    DEGREE,
    (3, 3),
)
YASKAWA = Dialect(FANUC.pose, FANUC.read, DEGREE / 1000, (3, 0))
"""Pulses, a thousand a degree."""
ABB = Dialect(
    lambda T: np.concatenate([1e3 * T[:3, 3], np.roll(_R(T).as_quat(), 1)]),
    lambda v: _frame(1e-3 * v[:3], Rotation.from_quat(np.roll(v[3:], -1))),
    DEGREE,
    (2, 3),
)


def _turn(abc: np.ndarray) -> Rotation:
    """A about z, then B about y, then C about x, each about the axes as they have come to lie."""
    a, b, c = (Rotation.from_rotvec(DEGREE * angle * axis) for angle, axis in zip(abc, np.eye(3)[::-1], strict=True))
    return a * b * c


def _abc(T: np.ndarray) -> np.ndarray:
    """The angles of :func:`_turn`, from the matrix: sin B is minus its lower left element."""
    R = T[:3, :3]
    a, c = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(R[2, 1], R[2, 2])
    return np.array([a, np.arcsin(-R[2, 0]), c]) / DEGREE


@dataclass(frozen=True)
class Step:
    """A target of a program.

    Attributes:
        readings: Where the joints are, shape (6,), [rad].
        form: ``joints`` or ``pose``.
    """

    readings: np.ndarray
    form: str


def path(rng: np.random.Generator, low: np.ndarray, high: np.ndarray, n: int) -> list[Step]:
    """A home position in joints, then points not far from each other, as along a seam, some in joints."""
    middle, half = (low + high) / 2, (high - low) / 2
    at = middle + rng.uniform(-0.5, 0.5, len(low)) * half
    steps = [Step(at, "joints")]
    for _ in range(n - 1):
        at = np.clip(at + rng.normal(0.0, 0.06, len(low)), middle - 0.8 * half, middle + 0.8 * half)
        steps.append(Step(at, "joints" if rng.random() < 0.15 else "pose"))
    return steps


class Writer:
    """Writes a program of a language, and keeps what is true of it.

    Args:
        dialect: How it writes.
        flange: Readings to T_base_tip of the nominal arm.
        end: Of a line.
    """

    def __init__(self, dialect: Dialect, flange: Callable[[np.ndarray], np.ndarray], end: str) -> None:
        self.made, self._dialect, self._flange, self._end = Made(), dialect, flange, end

    def line(self, text: str = "") -> None:
        """A line without a target's numbers."""
        self.made.template += text + self._end

    def frame(self, T: np.ndarray) -> list[str]:
        """A frame's numbers as text, exact."""
        return [f"{value:.9f}" for value in self._dialect.pose(T)]

    def joints(self, q: np.ndarray) -> list[str]:
        """A target of joints: marks, and what is true of it."""
        texts = [f"{value:.{self._dialect.digits[1]}f}" for value in q / self._dialect.joints]
        self._keep(texts, self._dialect.joints * np.array([float(t) for t in texts]), "joints", np.eye(4), np.eye(4))
        return [MARK] * len(texts)

    def pose(self, q: np.ndarray, base: np.ndarray, tool: np.ndarray) -> list[str]:
        """A target that is a pose: marks, and what is true of it."""
        T = np.linalg.inv(base) @ self._flange(q) @ tool
        digits = self._dialect.digits[0]
        values = self._dialect.pose(T)
        texts = [f"{v:.{digits if k < 3 else max(digits, 5)}f}" for k, v in enumerate(values)]
        self._keep(texts, q, "pose", base, tool)
        return [MARK] * len(texts)

    def _keep(self, texts: list[str], q: np.ndarray, kind: str, base: np.ndarray, tool: np.ndarray) -> None:
        self.made.numbers += texts
        self.made.readings.append(q)
        self.made.kinds.append(kind)
        self.made.bases.append(base)
        self.made.tools.append(tool)


Flange = Callable[[np.ndarray], np.ndarray]


def _numbers(texts: Sequence[str]) -> str:
    return ", ".join(texts)


def urscript(rng: np.random.Generator, steps: Sequence[Step], flange: Flange) -> Made:
    """As Polyscope writes them: a header, waypoints under names, features, a tool."""
    w = Writer(UR, flange, str(rng.choice(["\n", "\r\n"])))
    tool, feature, inner = random_frame(rng, 0.2), random_frame(rng, 0.4), random_frame(rng, 0.2)
    w.made.frames = _frames_file({"default": np.eye(4)}, {})
    w.line("def Schweißnaht_1():")
    w.line("  # Kommentar: movel(p[1, 2, 3, 4, 5, 6]) bleibt, wie er ist — äöü")
    w.line('  textmsg("movej([0,0,0,0,0,0])")')
    w.line(f"  set_tcp(p[{_numbers(w.frame(tool))}])")
    w.line("  set_payload(3.200000, [0.011000, 0.002000, 0.064000])")
    w.line(f"  global Plane_1=p[{_numbers(w.frame(feature))}]")
    w.line("  while (True):")
    for k, step in enumerate(steps):
        q = step.readings
        if step.form == "joints":
            if k % 2:
                w.line(f'    $ {k} "Waypoint_{k}"'.replace("$", "#"))
                w.line(f"    Waypoint_{k}_q = [{_numbers(w.joints(q))}]")
                w.line(f"    movej(Waypoint_{k}_q, a=1.3962634015954636, v=1.0471975511965976)")
            else:
                w.line(f"    movej([{_numbers(w.joints(q))}], a=1.3962634015954636, v=1.0471975511965976)")
            continue
        how = rng.integers(4)
        if how == 0:
            w.line(f"    movel(p[{_numbers(w.pose(q, np.eye(4), tool))}], a=1.2, v=0.25, r=0.005)")
        elif how == 1:
            w.line(f"    movel(pose_trans(Plane_1, p[{_numbers(w.pose(q, feature, tool))}]), a=1.2, v=0.25)")
        elif how == 2:
            w.line(f"    global P_{k} = p[{_numbers(w.pose(q, np.eye(4), tool))}]")
            w.line(f"    movej(get_inverse_kin(P_{k}, qnear=[{_numbers([f'{v:.3f}' for v in q])}]), a=1.4, v=1.05)")
        else:
            frame = f"pose_trans(Plane_1, p[{_numbers(w.frame(inner))}])"
            w.line(f"    movep(pose_trans({frame}, p[{_numbers(w.pose(q, feature @ inner, tool))}]), a=1.2, v=0.1)")
        if rng.random() < 0.2:
            w.line("    set_digital_out(0, True)  # Gasstrom ein")
    w.line("  end")
    w.line("end")
    return w.made


def signs(q: np.ndarray) -> str:
    """KUKA's T: a bit for each axis below zero."""
    return str(sum(1 << k for k in range(6) if q[k] < 0))


def quarters(q: np.ndarray) -> list[str]:
    """ABB's quarters of a turn of axes 1, 4 and 6."""
    return [str(int(np.floor(q[j] / (np.pi / 2)))) for j in (0, 3, 5)]


def turns(q: np.ndarray) -> list[str]:
    """FANUC's whole turns of axes 1, 4 and 6."""
    return [str(round(q[j] / (2 * np.pi))) for j in (0, 3, 5)]


def krl(rng: np.random.Generator, steps: Sequence[Step], flange: Flange) -> Made:
    """As WorkVisual and offline systems write them: $BASE and $TOOL, aggregates in moves and under names."""
    w = Writer(KUKA, flange, "\r\n")
    tool, base = random_frame(rng, 0.2), random_frame(rng, 0.5)
    keys = ("X", "Y", "Z", "A", "B", "C")

    def aggregate(texts: Sequence[str], more: str = "") -> str:
        return "{" + ", ".join(f"{key} {text}" for key, text in zip(keys, texts, strict=True)) + more + "}"

    def posed(k: int, q: np.ndarray, moves: Sequence[str]) -> tuple[str, str]:
        """A move, and an aggregate with S and T: stale ones where the controller does not ask for them."""
        texts, status, move = w.pose(q, base, tool), int(rng.integers(8)), str(rng.choice(moves))
        if move == "PTP":
            w.made.words.append(signs(q))
        else:
            w.made.stale.add(k)
        turn = WORD if move == "PTP" else str(63 - int(signs(q)))
        return move, aggregate(texts, f",S {status},T {turn},E1 0.0,E2 0.0")

    w.line("&ACCESS RVP")
    w.line("&REL 12")
    w.line("DEF Naht_7 ( )")
    w.line(";FOLD Ümlaute: Prüfung der Schweißnaht;%{PE}")
    w.line("DECL E6POS XHIDDEN")
    from_numbers = rng.random() < 0.5
    if from_numbers:
        w.line("BAS(#TOOL,3)")
        w.line("BAS(#BASE,5)")
        w.made.frames = _frames_file({"5": base}, {"3": tool})
    else:
        w.line(f"$TOOL={aggregate(w.frame(tool))}")
        if rng.random() < 0.5:
            inner = random_frame(rng, 0.2)
            w.line(f"$BASE={aggregate(w.frame(base))}:{aggregate(w.frame(inner))}")
            base = base @ inner
        else:
            w.line(f"$BASE = {aggregate(w.frame(base))}")
    w.line("; PTP {A1 0, A2 -90, A3 90, A4 0, A5 0, A6 0}")
    for k, step in enumerate(steps):
        q = step.readings
        if step.form == "joints":
            axes = ", ".join(f"A{j + 1} {t}" for j, t in enumerate(w.joints(q)))
            w.line(f"PTP {{{axes}, E1 0.000}} C_PTP")
        elif rng.random() < 0.4:
            move, point = posed(k, q, ["LIN", "SLIN", "PTP"])
            w.line(f"XP{k}={point}")
            w.line(f"{move} XP{k} C_DIS")
        else:
            w.line("  {} {} C_DIS".format(*posed(k, q, ["LIN", "lin", "PTP"])))
        if rng.random() < 0.2:
            w.line('$OUT[12]=TRUE ; Düse auf "X 1, Y 2"')
    w.line(";ENDFOLD")
    w.line("END")
    return w.made


def rapid(rng: np.random.Generator, steps: Sequence[Step], flange: Flange) -> Made:
    """As RobotStudio writes them: robtargets declared, tools and work objects with two frames."""
    w = Writer(ABB, flange, str(rng.choice(["\n", "\r\n"])))
    tool, user, own = random_frame(rng, 0.2), random_frame(rng, 0.4), random_frame(rng, 0.2)

    def nested(texts: Sequence[str]) -> str:
        return f"[{','.join(texts[:3])}],[{','.join(texts[3:])}]"

    w.line("MODULE Naht")
    w.line("  ! Übergabe an die nächste Zelle; p10 := [[1,2,3],[1,0,0,0]]")
    w.line(f"  PERS tooldata tBrenner:=[TRUE,[{nested(w.frame(tool))}],[2.5,[0,0,100],[1,0,0,0],0,0,0]];")
    w.line(f'  TASK PERS wobjdata wobTisch:=[FALSE,TRUE,"",[{nested(w.frame(user))}],[{nested(w.frame(own))}]];')
    external = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
    moves = []
    for k, step in enumerate(steps):
        q = step.readings
        if step.form == "joints":
            w.line(f"  CONST jointtarget jp{k}:=[[{','.join(w.joints(q))}],{external}];")
            moves.append(f"    MoveAbsJ jp{k}\\NoEOffs,v1000,fine,tBrenner;")
            continue
        in_object = rng.random() < 0.6
        base = user @ own if in_object else np.eye(4)
        marks = w.pose(q, base, tool)
        behind = "\\WObj:=wobTisch" if in_object else ""
        how = rng.integers(3)
        w.made.words += quarters(q)
        w.line(f"  CONST robtarget p{k}0:=[{nested(marks)},[{WORD},{WORD},{WORD},0],{external}];")
        point = f"Offs(p{k}0,0,0,0)" if how == 0 else f"p{k}0"
        moves.append(
            f"    Move{rng.choice(['L', 'J'])} {point}, v{100 * (1 + k % 3)}, z{5 * (k % 3)}, tBrenner{behind};"
        )
    w.line("  PROC main()")
    w.line('    TPWrite "MoveL p10, v100, fine, tool0;";')
    for move in moves:
        w.line(move)
    w.line("  ENDPROC")
    w.line("ENDMODULE")
    return w.made


def fanuc(rng: np.random.Generator, steps: Sequence[Step], flange: Flange) -> Made:
    """As ASCII upload and ROBOGUIDE write them: points in /POS with user frame and user tool by number."""
    w = Writer(FANUC, flange, "\r\n")
    tool, base = random_frame(rng, 0.2), random_frame(rng, 0.4)
    w.made.frames = _frames_file({"2": base}, {"1": tool})
    w.line("/PROG  NAHT7")
    w.line("/ATTR")
    w.line('OWNER\t\t= MNEDITOR;\r\nCOMMENT\t\t= "P[1] = X 1.0 mm";\r\nPROG_SIZE\t= 1234;')
    w.line("/MN")
    for k, step in enumerate(steps, start=1):
        w.line(f"{k:4d}:{'J' if step.form == 'joints' else 'L'} P[{k}] 100mm/sec CNT50    ;")
    w.line("/POS")
    for k, step in enumerate(steps, start=1):
        q = step.readings
        w.line(f"P[{k}{':' + chr(34) + 'Düse' + chr(34) if k % 3 == 0 else ''}]{{")
        w.line("   GP1:")
        if step.form == "joints":
            w.line("\tUF : 2, UT : 1,\t")
            t = w.joints(q)
            w.line(f"\tJ1=  {t[0]} deg,\tJ2=  {t[1]} deg,\tJ3=  {t[2]} deg,")
            w.line(f"\tJ4=  {t[3]} deg,\tJ5=  {t[4]} deg,\tJ6=  {t[5]} deg")
        else:
            w.made.words += turns(q)
            w.line(f"\tUF : 2, UT : 1,\t\tCONFIG : 'N U T, {WORD}, {WORD}, {WORD}',")
            t = w.pose(q, base, tool)
            w.line(f"\tX =  {t[0]}  mm,\tY =   {t[1]}  mm,\tZ =   {t[2]}  mm,")
            w.line(f"\tW =   {t[3]} deg,\tP =   {t[4]} deg,\tR =   {t[5]} deg")
        w.line("};")
    w.line("/END")
    return w.made


def halves(q: np.ndarray) -> tuple[int, ...]:
    """Half turns of axes 1, 4 and 6, and of axis 4 once more: what Yaskawa's RCONF may count of an arm of any build."""
    return (*(round(q[j] / (2 * np.pi)) for j in (0, 3, 5)), round(q[3] / np.pi))


def inform(rng: np.random.Generator, steps: Sequence[Step], flange: Flange) -> Made:
    """As a controller writes a converted job: positions with RCONF, tool and user frame before them, and others in pulses."""
    w = Writer(YASKAWA, flange, "\r\n")
    tool, base = random_frame(rng, 0.2), random_frame(rng, 0.4)
    w.made.frames = _frames_file({"2": base}, {"1": tool}) + f"pulses_per_degree: {[1000] * 6}\n"
    w.line("/JOB\r\n//NAME NAHT-7\r\n//POS")
    w.line(f"///NPOS {len(steps)},0,0,0,0,0\r\n///USER 2\r\n///TOOL 1")
    stands: tuple[int, ...] = ()
    kind, moves = "", []
    for k, step in enumerate(steps):
        q = step.readings
        form = (
            step.form if halves(q) == stands else "joints"
        )  # RCONF is not read: where it changes pulses say how the arm stands
        stands = halves(q)
        if form != kind:
            kind = form
            w.line("///POSTYPE PULSE\r\n///PULSE" if form == "joints" else "///POSTYPE USER\r\n///RECTAN")
        if form == "joints":
            w.line(f"C{k:05d}={','.join(w.joints(q))}")
        else:
            w.line(
                f"///RCONF {stands[3] % 2},0,0,{','.join(str(abs(n)) for n in (stands[1], stands[2], stands[0]))},0,0"
            )
            w.line(f"C{k:05d}={','.join(w.pose(q, base, tool))}")
        how = "MOVJ" if form == "joints" else str(rng.choice(["MOVL", "MOVJ"]))
        moves.append(f"{how} C{k:05d} {'VJ=25.00' if how == 'MOVJ' else 'V=138.0'} PL={k % 4}  //C{k:05d}=1,2,3,4,5,6")
    w.line("//INST\r\n///DATE 2026/11/28 10:26\r\n///COMM Schweißnaht\r\n///ATTR SC,RW\r\n///GROUP1 RB1\r\nNOP")
    w.line("'P00001=1.000,2.000,3.000,4.0000,5.0000,6.0000")
    for move in moves:
        w.line(move)
        if rng.random() < 0.2:
            w.line('MSG "MOVL C00000 V=1.0"\r\nDOUT OT#(3) ON')
    w.line("END")
    return w.made


def _frames_file(bases: dict[str, np.ndarray], tools: dict[str, np.ndarray]) -> str:
    def entries(frames: dict[str, np.ndarray]) -> str:
        return ", ".join(
            f"'{name}': {{xyz: {T[:3, 3].tolist()}, rpy: {_R(T).as_euler('xyz').tolist()}}}"
            for name, T in frames.items()
        )

    return f"format: 1\nbases: {{{entries(bases)}}}\ntools: {{{entries(tools)}}}\n"


MAKERS: dict[str, tuple[Dialect, Callable[[np.random.Generator, Sequence[Step], Flange], Made]]] = {
    ".script": (UR, urscript),
    ".src": (KUKA, krl),
    ".mod": (ABB, rapid),
    ".ls": (FANUC, fanuc),
    ".jbi": (YASKAWA, inform),
}
"""By the ending of the file's name."""
