"""A calibrated robot as a function of CasADi, for optimal control; the only module for CasADi."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aridcal.jobs.export.expressions import Term, walk
from aridcal.jobs.export.machine import Machine
from aridcal.system.errors import AridcalError

if TYPE_CHECKING:
    import casadi


def casadi_function(machine: Machine, name: str = "forward") -> casadi.Function:
    """The target's pose as an expression that CasADi differentiates and optimises over.

    Args:
        machine: The calibrated robot.
        name: Of the function.

    Returns:
        ``(q, conditions) -> (R, p)``: readings (joints, 1) in [rad] or [m] and the conditions (conditions, 1), in the order of
        the machine; the target's rotation (3, 3) and position (3, 1) in the world, [m].

    Raises:
        AridcalError: CasADi is not installed.
    """
    try:
        import casadi  # an extra, of several tens of megabytes
    except ImportError:
        raise AridcalError('CasADi is not installed: `pip install "aridcal[export]"`') from None
    q, c = casadi.SX.sym("q", len(machine.joints)), casadi.SX.sym("conditions", len(machine.conditions))
    value: dict[int, Any] = {}
    for term in walk(machine.model.at):
        of = [value[id(each)] if isinstance(each, Term) else each for each in term.of]
        value[id(term)] = _applied(casadi, term, of, q, c)
    R, p = casadi.SX.eye(3), casadi.SX.zeros(3)
    for step, formula in zip(machine.model.steps, machine.model.at, strict=True):
        at = value[id(formula)] if isinstance(formula, Term) else formula
        p = p + R @ casadi.DM(step.placement.translation)
        R = R @ casadi.DM(step.placement.rotation)
        if step.turns:
            cos, sin = casadi.cos(at), casadi.sin(at)
            R = casadi.horzcat(R[:, 0] * cos + R[:, 1] * sin, R[:, 1] * cos - R[:, 0] * sin, R[:, 2])
        else:
            p = p + R[:, 2] * at
    end = machine.model.end
    p = p + R @ casadi.DM(end.translation)
    R = R @ casadi.DM(end.rotation)
    return casadi.Function(name, [q, c], [R, p], ["q", "conditions"], ["R", "p"])


def is_function(path: Path) -> bool:
    """True for a file that holds functions of CasADi."""
    try:
        import casadi

        casadi.Function.load(str(path))
    except (ImportError, RuntimeError, SystemError):
        return False
    return True


def _applied(casadi: Any, term: Term, of: list[Any], q: Any, c: Any) -> Any:
    """A term of numbers of CasADi."""
    rows = () if term.table is None else term.table.rows
    match term.operation:
        case "reading":
            return q[term.index]
        case "condition":
            return c[term.index]
        case "+":
            return of[0] + of[1]
        case "-":
            return of[0] - of[1] if len(of) == 2 else -of[0]
        case "*":
            return of[0] * of[1]
        case "/":
            return of[0] / of[1]
        case "sin" | "cos" | "sign":
            return getattr(casadi, term.operation)(of[0])
        case "power":
            return of[0] ** of[1]
        case "before":
            return -casadi.SX(of[0] < of[1])
        case "pairs":
            x, y = of
            return sum(w * _spline(casadi, (x - a) / h) * _spline(casadi, (y - b) / k) for a, h, b, k, w in rows)
        case "balls":
            parts = []
            for *centre, radius, weight in rows:
                u = casadi.sqrt(sum((z - m) ** 2 for z, m in zip(of, centre, strict=True))) / radius
                parts.append(weight * casadi.fmax(1.0 - u, 0.0) ** 4 * (4.0 * u + 1.0))
            return sum(parts)
        case _:
            assert term.operation == "curve" and term.table is not None
            u = (of[0] - term.table.start) / term.table.step
            pieces = casadi.DM(np.array(rows))
            k = casadi.fmin(casadi.fmax(casadi.floor(u), 0.0), len(rows) - 1.0)
            # SX has no look-up: of all pieces the one counts in which u is
            inside = casadi.vertcat(*[k == n for n in range(len(rows))])
            a = pieces.T @ inside
            v = u - k
            whole = a[0] + v * (a[1] + v * (a[2] + v * a[3]))
            return casadi.SX((u >= 0.0) * (u < len(rows))) * whole


def _spline(casadi: Any, u: Any) -> Any:
    """Cubic B-spline, 1 at its middle, 0 beyond 2: (2 - u)^3 / 4 - (1 - u)^3 of what is positive of each."""
    size = casadi.fabs(u)
    return 0.25 * casadi.fmax(2.0 - size, 0.0) ** 3 - casadi.fmax(1.0 - size, 0.0) ** 3
