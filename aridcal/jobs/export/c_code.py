"""A calibrated robot as C99 without dependencies, without allocation and without global state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from aridcal.engine.corrections.labels import is_label
from aridcal.engine.inverse.one_pose import FIRST_DAMPING, KICK, LARGEST_NEWTON_TURN, SINGULAR_DAMPING
from aridcal.jobs.export.c_texts import CMAKE, HEADER, SOLVER, TABLE_FUNCTIONS, TEST, WALK
from aridcal.jobs.export.expressions import Formula, Term, bare, infix, statements, walk
from aridcal.jobs.export.machine import Chain, Machine, Quantity
from aridcal.system.errors import printable

NEWTON_STEPS, STARTS = 40, 5
"""Work: at the most, as many as `compensate` takes: three steps settle where the arm is free to move; the others, and the further
starts, are for singular places."""

PLACES = 3_000
"""Work: places of steps and slopes that one search may compute, a coefficient counting as a tenth: 50 us at the worst.
A UR10's geometry has 12 places, and 118 with 727 coefficients."""

LEAST_STEPS = 11
"""Work: within them from two starts a UR10 comes as near as `compensate` over its whole range."""

RISE, FALL = 10.0, 2.0
"""By how much damping rises where a step does not help, and falls where it does."""

EXACT = 1e-10
"""[m]: a miss below it, rotations counted, needs no further step: the next would be rounding."""

NEAR = 1e-6
"""[m]: a miss below it, rotations counted, needs no further start."""

WIDE = 118
"""Letters in a line of a file."""


class Rows(NamedTuple):
    """Rows to test the code with.

    Attributes:
        inputs: Readings, then conditions, shape (N, joints + conditions).
        R: Rotations of the target, shape (N, 3, 3).
        p: Its positions, shape (N, 3), [m].
    """

    inputs: np.ndarray
    R: np.ndarray
    p: np.ndarray


def c_files(machine: Machine, name: str, digest: str, about: Sequence[str], rows: Rows) -> dict[str, str]:
    """The files of an export by their names: header, code, test, and what builds them.

    Args:
        machine: The calibrated robot.
        name: A C identifier, which all names begin with.
        digest: sha256 of its ``calibration.yaml``.
        about: Lines that say what it is.
        rows: Of ``predict``.
    """
    texts = {
        "NAME.h": _header(machine, digest, about),
        "NAME.c": _code(machine, about),
        "NAME_test.c": _test(machine, rows),
        "CMakeLists.txt": CMAKE,
    }
    return {file.replace("NAME", name): _called(text, name) for file, text in texts.items()}


def _called(text: str, name: str) -> str:
    """A text of ours with the export's name in it."""
    return text.replace("NAME", name).replace("\0", "").replace("KEYWORD", "NAME")


def _theirs(text: str) -> str:
    """A name of the robot's, in which nothing is replaced."""
    return text.replace("NAME", "NA\0ME").replace("KEYWORD", "KEY\0WORD")


def _header(machine: Machine, digest: str, about: Sequence[str]) -> str:
    joints = [f" *   q[{k}]  {each.name}, {each.unit}{_seen(each)}" for k, each in enumerate(machine.joints)]
    effects = [f" *   {name} = {value:.6g}" for name, value in machine.effects]
    lines = ["/* " + _plain(about[0]), " *", *(f" * {_plain(line)}" for line in about[1:])]
    lines += [" *", " * Readings:", *map(_plain, joints)]
    if effects:
        lines += [
            " *",
            " * Effects beside the constants, in m or rad times what they depend on:",
            *map(_plain, effects),
        ]
    sizes = [
        f"#define NAME_JOINTS {len(machine.joints)}",
        f"#define NAME_CONDITIONS {len(machine.conditions)}",
        f'#define NAME_HASH "{digest}" /* sha256 of calibration.yaml */',
    ]
    fields = [
        f"    double {_theirs(each.identifier)}; /* {_plain(each.unit + _seen(each))} */" for each in machine.conditions
    ]
    fields = fields or ["    double none; /* the model depends on nothing beside the readings */"]
    text = HEADER.replace("{sizes}", "\n".join(sizes)).replace("{conditions}", "\n".join(fields))
    text = text.replace("{no_rotation}", "" if machine.pose else ": NAN, the target's rotation was not measured")
    return "\n".join(lines) + "\n */\n" + text.replace("{newton}", str(math.prod(_newton_steps(machine))))


def _seen(quantity: Quantity) -> str:
    """What was measured of an input, in words."""
    low, high = quantity.range
    return f"; measured from {low:.6g} to {high:.6g}" if math.isfinite(low) and math.isfinite(high) else ""


def _plain(text: str) -> str:
    """Text that ends no comment."""
    return _theirs(printable(text).replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?"))


def _code(machine: Machine, about: Sequence[str]) -> str:
    slopes = [slope for _, _, slope in machine.slopes]
    both, (steps, starts) = (*machine.model.at, *slopes), _newton_steps(machine)
    constants = {
        "STEPS": (len(machine.model.steps), "the robot's joints, and one for each motion of an effect"),
        "NOMINAL_STEPS": (len(machine.nominal.steps), "the robot's joints alone"),
        "SLOPES": (len(slopes), "places of steps that change with a reading"),
        "ROWS": (6 if machine.pose else 3, "numbers of a wanted pose, or position"),
        "LEVER": (_number(machine.lever), "m/rad: what an error of a rad counts"),
        "NEWTON_STEPS": (steps, "from each start, at the most"),
        "STARTS": (starts, "further ones only where the target is not reached"),
        "EXACT": (EXACT, "m, rotations counted: no further step"),
        "NEAR": (NEAR, "m, rotations counted: no further start"),
        "LARGEST_TURN": (LARGEST_NEWTON_TURN, "rad, in one of them"),
        "FIRST_DAMPING": (FIRST_DAMPING, "where a step without damping does not help"),
        "RISE": (RISE, "of the damping, after a step that does not help"),
        "FALL": (FALL, "after one that does"),
        "TINY": (SINGULAR_DAMPING, "damping that keeps a singular arm's step finite"),
        "REACHED_M": (_number(machine.reached[0]), "m"),
        "REACHED_RAD": (_number(machine.reached[1]), "rad"),
    }
    defines = [f"#define {key} {value}{f' /* {why} */' if why else ''}" for key, (value, why) in constants.items()]
    sections = [
        f"/* {_plain(about[0])} */",
        '#include "NAME.h"\n\n#include <math.h>\n#include <string.h>',
        "\n".join(defines),
        _names("NAME_joint_names", machine.joints),
        _names("NAME_condition_names", machine.conditions),
        _STEP,
        _steps("model_steps", "STEPS", machine.model),
        _steps("nominal_steps", "NOMINAL_STEPS", machine.nominal),
        "/* Step and reading of each slope. */\nstatic const int slope_of[SLOPES][2] = {"
        + _wrapped(", ".join(f"{{{k}, {j}}}" for k, j, _ in machine.slopes), "    ")
        + "};",
        _array("limit", "[NAME_JOINTS][2]", [f"{{{_number(a)}, {_number(b)}}}" for a, b in machine.limits.tolist()]),
        _array("moves", "[NAME_JOINTS]", [str(int(each)) for each in machine.moves], "int"),
        _array("kick", "[STARTS][NAME_JOINTS]", _kicks(starts, len(machine.joints))),
        _array("turning", "[NAME_JOINTS]", [str(int(each)) for each in machine.turning], "int"),
        *_ranges(machine),
        *_tables(both),
        *_functions(both),
        *([LEGEND] if any(term.name for term in walk(machine.model.at)) else []),
        _program("places", machine.conditions, {"at": machine.model.at}, _stands(machine.model)),
        _program(
            "places_and_slopes",
            machine.conditions,
            {"at": machine.model.at, "slope": slopes},
            [*_stands(machine.model), *(f"by q[{j}]: {machine.model.steps[k].name}" for k, j, _ in machine.slopes)],
        ),
        _program("nominal_places", None, {"at": machine.nominal.at}, _stands(machine.nominal)),
        _finite_conditions(machine),
        WALK.strip(),
        _in_range(machine),
        SOLVER.strip(),
    ]
    return "\n\n".join(sections) + "\n"


LEGEND = """\
/* Of the nominal arm, in the base's axes: JOINT_at_x is where a joint is, JOINT_z_x the x of its z axis, JOINT_mass_x the first
 * moment of all that it carries. A number that has no name of its own is a part. */"""

_STEP = """\
typedef struct {
    int turns;         /* 1 about its z axis, 0 along it, -1 neither */
    double R[9], p[3]; /* its frame in that of the step before */
} step;"""


def _names(array: str, quantities: Sequence[Quantity]) -> str:
    names = [_theirs(_string(each.name)) for each in quantities]
    return f"const char *const {array}[] = {{{', '.join([*names, '0'])}}};"


def _string(text: str) -> str:
    """A text in C, whatever it holds."""

    def spelt(letter: str) -> str:
        if letter.isprintable() and letter not in '"\\?':
            return letter
        return "".join(f"\\{byte:03o}" for byte in letter.encode("utf-8", "surrogatepass"))

    return f'"{"".join(map(spelt, text))}"'


def _steps(array: str, size: str, chain: Chain) -> str:
    lines = [f"    {{{int(step.turns)}, {_frame(step.placement)}}}, /* {_plain(step.name)} */" for step in chain.steps]
    lines.append(f"    {{-1, {_frame(chain.end)}}} /* the target */")
    return f"static const step {array}[{size} + 1] = {{\n" + "\n".join(lines) + "\n};"


def _stands(chain: Chain) -> list[str]:
    """What each step is, and in which unit it stands."""
    return [f"{step.name}, {'rad' if step.turns else 'm'}" for step in chain.steps]


def _frame(placement: pin.SE3) -> str:
    parts = placement.rotation.ravel().tolist(), placement.translation.tolist()
    return ", ".join(f"{{{', '.join(map(_number, part))}}}" for part in parts)


def _array(name: str, shape: str, values: Sequence[str], kind: str = "double") -> str:
    return f"static const {kind} {name}{shape} = {{" + _wrapped(", ".join(values), "    ") + "};"


def _wrapped(text: str, indent: str) -> str:
    """Text in one line, or in several that are indented."""
    if len(text) < WIDE // 2:
        return text
    lines = wrap(
        text, WIDE, initial_indent=indent, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return "\n" + "\n".join(lines) + "\n"


def _tables(formulas: Sequence[Formula]) -> list[str]:
    tables = {term.table.name: term.table for term in walk(formulas) if term.table is not None}
    texts = []
    for name, table in tables.items():
        rows = [f"    {{{', '.join(map(_number, row))}}}" for row in table.rows]
        shape = f"[{len(table.rows)}][{len(table.rows[0])}]"
        texts.append(f"static const double {name}_table{shape} = {{\n" + ",\n".join(rows) + "\n};")
    return texts


def _functions(formulas: Sequence[Formula]) -> list[str]:
    """The functions with tables that are used, those first that others call."""
    used = {(term.operation, min(term.index, 1)) for term in walk(formulas) if term.table is not None}
    wanted: set[tuple[str, int]] = {(operation, slope) for operation, slope in used}
    if ("pairs", 0) in wanted or ("pairs", 1) in wanted:
        wanted |= {("spline", 0)} | ({("spline", 1)} if ("pairs", 1) in wanted else set())
    return [text.strip() for key, text in TABLE_FUNCTIONS.items() if key in wanted]


def _program(
    name: str, conditions: Sequence[Quantity] | None, results: Mapping[str, Sequence[Formula]], comments: Sequence[str]
) -> str:
    """A function that fills arrays with formulas of readings, and of conditions if it has any."""
    formulas = [formula for part in results.values() for formula in part]
    fields = [_theirs(each.identifier) for each in conditions or ()]
    lines, texts = statements(formulas, lambda term, of: _written(term, of, fields), _number)
    targets = [f"{array}[{k}]" for array, part in results.items() for k in range(len(part))]
    body = [_line(f"const double {n} = {text};", comment) for n, text, comment in lines]
    every = zip(targets, texts, comments, strict=True)
    body += [_line(f"{target} = {text};", comment) for target, text, comment in every]
    if conditions is not None and not any(term.operation == "condition" for term in walk(formulas)):
        body.insert(0, "    (void)c;")
    inputs = "const double q[]" + ("" if conditions is None else ", const NAME_conditions *c")
    outputs = ", ".join(f"double {array}[]" for array in results)
    return f"static void {name}({inputs}, {outputs})\n{{\n" + "\n".join(body) + "\n}"


def _line(text: str, comment: str) -> str:
    remark = f" /* {_plain(comment)} */" if comment else ""
    lines = wrap(
        text, WIDE, initial_indent="    ", subsequent_indent=" " * 8, break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(lines) + remark


def _written(term: Term, of: Sequence[str], fields: Sequence[str]) -> str:
    match term.operation:
        case "reading":
            return f"q[{term.index}]"
        case "condition":
            return f"c->{fields[term.index]}"
        case "+" | "-" | "*" | "/":
            return infix(term, of)
        case "sin" | "cos":
            return f"{term.operation}({bare(of[0])})"
        case "sign":
            return f"(({of[0]} > 0.0) - ({of[0]} < 0.0))"
        case "power":
            return f"pow({bare(of[0])}, {of[1]})"
        case "before":
            return f"({of[0]} < {of[1]} ? -1.0 : 0.0)"
        case _:
            table = term.table
            assert table is not None
            arguments = [*map(bare, of)]
            if term.operation == "curve":
                arguments += [_number(table.start), _number(table.step)]
            if term.index and term.operation != "curve":
                arguments.insert(0, str(term.index))
            slope = "_slope" if term.index else ""
            return f"{term.operation}{slope}({', '.join([*arguments, str(len(table.rows)), f'{table.name}_table'])})"


def _finite_conditions(machine: Machine) -> str:
    checks = " && ".join(f"isfinite(c->{_theirs(each.identifier)})" for each in machine.conditions)
    if not checks:
        return "static int finite_conditions(const NAME_conditions *c)\n{\n    (void)c;\n    return 1;\n}"
    return "static int finite_conditions(const NAME_conditions *c)\n{\n" + _line(f"return c && {checks};", "") + "\n}"


def _newton_steps(machine: Machine) -> tuple[int, int]:
    """Steps from each start of a search, and starts; an arm that reaches nearly nothing exactly needs no second start."""
    places = len(machine.model.steps) + len(machine.slopes) + len(machine.effects) / 10
    steps = max(int(PLACES / places), 2 * LEAST_STEPS)
    starts = 1 if machine.lean else min(STARTS, steps // LEAST_STEPS)
    return min(NEWTON_STEPS, steps // starts), starts


def _kicks(starts: int, joints: int) -> list[str]:
    """How far from the wanted readings each start is: none, then drawn once, so that every run is the same."""
    drawn = KICK * np.random.default_rng(0).standard_normal((starts - 1, joints))
    return [
        f"{{{', '.join(_number(round(x, 4)) for x in row)}}}" for row in (np.zeros(joints).tolist(), *drawn.tolist())
    ]


def _ranges(machine: Machine) -> list[str]:
    """What was measured of each input: readings, then conditions."""
    every = [*machine.joints, *machine.conditions]
    ranges = [f"{{{_number(low)}, {_number(high)}}}" for low, high in (each.range for each in every)]
    holes = [f"{{{k}, {_number(low)}, {_number(high)}}}" for k, each in enumerate(every) for low, high in each.holes]
    texts = [_array("range", f"[{len(every)}][2]", ranges)]
    if holes:
        texts.append("typedef struct {\n    int of;\n    double low, high;\n} gap;")
        texts.append(_array("hole", f"[{len(holes)}]", holes, "gap"))
    return texts


def _in_range(machine: Machine) -> str:
    values = [f"q[{k}]" for k in range(len(machine.joints))]
    values += [f"c->{_theirs(each.identifier)}" for each in machine.conditions]
    holes = sum(len(each.holes) for each in (*machine.joints, *machine.conditions))
    labels = [f"c->{_theirs(each.identifier)} > 0.0" for each in machine.conditions if is_label(each.name)]
    lines = [
        "    if (!finite_readings(q) || !finite_conditions(c))",
        "        return NAME_BAD_INPUT;",
        _line(f"const double value[] = {{{', '.join(values)}}};", ""),
        f"    for (int k = 0; k < {len(values)}; k++)",
        "        if (value[k] < range[k][0] || value[k] > range[k][1])",
        "            return NAME_OUT_OF_RANGE;",
    ]
    if holes:
        lines += [
            f"    for (int k = 0; k < {holes}; k++)",
            "        if (value[hole[k].of] > hole[k].low && value[hole[k].of] < hole[k].high)",
            "            return NAME_OUT_OF_RANGE;",
        ]
    if labels:
        lines += [_line(f"if (!({' || '.join(labels)}))", ""), "        return NAME_OUT_OF_RANGE;"]
    body = "\n".join([*lines, "    return NAME_OK;"])
    return "NAME_status NAME_in_range(const double q[], const NAME_conditions *c)\n{\n" + body + "\n}"


def _test(machine: Machine, rows: Rows) -> str:
    numbers = np.column_stack([rows.inputs, rows.R.reshape(len(rows.p), 9), rows.p])
    lines = ",\n".join(f"    {{{', '.join(map(_number, row))}}}" for row in numbers.tolist())
    joints = len(machine.joints)
    values = ", ".join(f"row[{joints + k}]" for k in range(len(machine.conditions))) or "0.0"
    text = TEST.replace("{count}", str(len(numbers))).replace("{width}", str(numbers.shape[1]))
    return text.replace("{inputs}", str(rows.inputs.shape[1])).replace("{values}", values).replace("{rows}", lines)


def _number(value: float) -> str:
    """A number in C that reads back as it is, without the sign of a zero."""
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value) + 0.0)
