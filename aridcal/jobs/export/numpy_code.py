"""A calibrated robot as a Python module that needs NumPy alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pinocchio as pin

from aridcal.jobs.export.expressions import Term, bare, infix, statements, walk
from aridcal.jobs.export.machine import Chain, Machine
from aridcal.system.errors import printable

FUNCTIONS = {
    "curve": '''
def _curve(z, start, step, pieces):
    """A cubic between each knot and the next; 0 beyond the ends."""
    u = (z - start) / step
    k = np.clip(np.floor(np.nan_to_num(u)), 0, len(pieces) - 1).astype(int)
    a, b, c, d = pieces[k].T
    v = u - k
    return np.where((u >= 0.0) & (u < len(pieces)), a + v * (b + v * (c + v * d)), 0.0 * u)
''',
    "pairs": '''
def _spline(u):
    """Cubic B-spline, 1 at its middle, 0 beyond 2."""
    u = np.abs(u)
    v = np.maximum(2.0 - u, 0.0)
    return np.where(u < 1.0, 1.0 - u * u * (1.5 - 0.75 * u), 0.25 * v * v * v)


def _pairs(x, y, table):
    """A sum of products of two splines: middle and knot of x, of y, and the weight."""
    return sum(w * _spline((x - a) / h) * _spline((y - b) / k) for a, h, b, k, w in table)
''',
    "balls": '''
def _balls(x, y, z, table):
    """A sum of functions about places: place, radius and weight."""
    total = 0.0
    for a, b, c, radius, weight in table:
        u = np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / radius
        v = np.maximum(1.0 - u, 0.0)
        total = total + weight * v**4 * (4.0 * u + 1.0)
    return total
''',
}
"""Sums that tables hold."""

TEMPLATE = '''"""{title}

{about}
"""

import numpy as np

JOINTS = {joints}
"""Columns of q, SI units."""

CONDITIONS = {conditions}
"""Columns that the model depends on beside the joints."""

HASH = "{hash}"
"""sha256 of the calibration.yaml that this file was written from."""
{tables}{functions}

def forward(q, conditions=None):
    """Where the target is.

    Args:
        q: Readings of JOINTS, shape (n, {columns}), [rad] or [m].
        conditions: Of each of CONDITIONS a number, or one for each row, by name.

    Returns:
        Rotations R (n, 3, 3) and positions p (n, 3), [m], of the target in the world.
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    rows = len(q)
    c = [np.broadcast_to(np.asarray(conditions[name], dtype=float), rows) for name in CONDITIONS]
{lines}
    at = [{at}]
    R, p = np.tile(np.eye(3), (rows, 1, 1)), np.zeros((rows, 3))
    for (turns, rotation, place), value in zip(_STEPS, at):
        p = p + R @ place
        R = R @ rotation
        if turns:
            cos, sin = np.cos(value)[..., None], np.sin(value)[..., None]
            x, y = R[:, :, 0] * cos + R[:, :, 1] * sin, R[:, :, 1] * cos - R[:, :, 0] * sin
            R = np.stack([x, y, R[:, :, 2]], axis=2)
        else:
            p = p + R[:, :, 2] * np.asarray(value)[..., None]
    rotation, place = _END
    return R @ rotation, p + R @ place


_STEPS = [  # does it turn about its z axis or slide along it; its frame in that of the step before
{steps}
]
_END = {end}  # the target in the frame of the last step
'''


def numpy_module(machine: Machine, digest: str, about: Sequence[str]) -> str:
    """The text of a module with ``JOINTS``, ``CONDITIONS``, ``HASH`` and ``forward``.

    Args:
        machine: The calibrated robot.
        digest: sha256 of its ``calibration.yaml``.
        about: Lines that say what it is.
    """
    lines, at = statements(machine.model.at, _written, repr)
    tables = {term.table.name: term for term in walk(machine.model.at) if term.table is not None}
    used = {term.operation for term in tables.values()}
    first, *others = (printable(line).replace("\\", "/").replace('"""', "'''") for line in about)
    return TEMPLATE.format(
        title=first,
        about="\n".join(others),
        joints=repr(tuple(each.name for each in machine.joints)),
        conditions=repr(tuple(each.name for each in machine.conditions)),
        hash=digest,
        columns=len(machine.joints),
        tables="".join(f"\n_{name.upper()} = np.array({_table(term)})" for name, term in tables.items()) + "\n",
        functions="".join(f"\n{text}" for name, text in FUNCTIONS.items() if name in used),
        lines="\n".join(f"    {name} = {text}{f'  # {comment}' if comment else ''}" for name, text, comment in lines),
        at=", ".join(at),
        steps=_steps(machine.model),
        end=f"({_frame(machine.model.end)})",
    )


def _written(term: Term, of: Sequence[str]) -> str:
    match term.operation:
        case "reading":
            return f"q[:, {term.index}]"
        case "condition":
            return f"c[{term.index}]"
        case "+" | "-" | "*" | "/":
            return infix(term, of)
        case "sin" | "cos" | "sign":
            return f"np.{term.operation}({bare(of[0])})"
        case "power":
            return f"{of[0]} ** {of[1]}"
        case "before":
            return f"np.where({bare(of[0])} < {of[1]}, -1.0, 0.0)"
        case _:
            assert term.table is not None
            table = f"_{term.table.name.upper()}"
            placed = [repr(term.table.start), repr(term.table.step)] if term.operation == "curve" else []
            return f"_{term.operation}({', '.join([*map(bare, of), *placed, table])})"


def _table(term: Term) -> str:
    assert term.table is not None
    return "[\n" + "".join(f"    [{', '.join(map(repr, row))}],\n" for row in term.table.rows) + "]"


def _steps(chain: Chain) -> str:
    return "\n".join(f"    ({step.turns}, {_frame(step.placement)}),  # {printable(step.name)}" for step in chain.steps)


def _frame(placement: pin.SE3) -> str:
    rows = ", ".join(f"[{', '.join(map(number, row))}]" for row in placement.rotation.tolist())
    return f"np.array([{rows}]), np.array([{', '.join(map(number, placement.translation.tolist()))}])"


def number(value: float) -> str:
    """A number that reads back as it is, without the sign of a zero."""
    assert math.isfinite(value)
    return repr(value + 0.0)
