"""The C export of a calibration, compiled and called from Python."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
OK, OUT_OF_RANGE, LIMIT, NOT_REACHED, BAD_INPUT = range(5)
"""The statuses, as the header numbers them."""


def compiler() -> str:
    """A C compiler; the test is skipped where there is none, or fails where one is required."""
    for name in ("gcc", "clang"):
        if shutil.which(name):
            return name
    if os.environ.get("ARIDCAL_REQUIRE_CC") == "1":
        pytest.fail("ARIDCAL_REQUIRE_CC=1, but there is neither gcc nor clang")
    pytest.skip("no C compiler on this computer: install gcc or clang to test the C export")


def program(folder: Path, name: str, *options: str) -> str:
    """What the export's own test prints; it must succeed."""
    sources = [str(folder / f"{name}.c"), str(folder / f"{name}_test.c")]
    executable = folder / "self_test"
    subprocess.run([compiler(), *STRICT, *options, *sources, "-lm", "-o", str(executable)], check=True)
    return subprocess.run([executable], check=True, capture_output=True, text=True).stdout


class Pose(ctypes.Structure):
    """As the header has it."""

    _fields_ = (("R", ctypes.c_double * 9), ("p", ctypes.c_double * 3))

    def __iter__(self):  # type: ignore[no-untyped-def]
        yield np.array(self.R).reshape(3, 3)
        yield np.array(self.p)


class Export:
    """The functions of an export, for one row each.

    Args:
        folder: Where it is.
        name: With which its names begin.
    """

    def __init__(self, folder: Path, name: str) -> None:
        library = folder / f"{name}.so"
        options = ("-O1", "-shared", "-fPIC", str(folder / f"{name}.c"), "-lm", "-o", str(library))
        subprocess.run([compiler(), *STRICT, *options], check=True)
        self._library, self._name = ctypes.CDLL(str(library)), name

    def _call(self, function: str, *arguments: object) -> int:
        return int(getattr(self._library, f"{self._name}_{function}")(*arguments))

    def forward(self, q: np.ndarray, c: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Status, R and p."""
        target = Pose()
        return (self._call("forward", _numbers(q), _numbers(c), ctypes.byref(target)), *target)

    def nominal(self, q: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Status, R and p."""
        target = Pose()
        return (self._call("nominal", _numbers(q), ctypes.byref(target)), *target)

    def jacobian(self, q: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Shape (6, joints)."""
        J = _numbers(np.zeros(6 * len(q)))
        assert self._call("jacobian", _numbers(q), _numbers(c), J) == OK
        return np.array(J).reshape(6, -1)

    def correct(self, wanted: np.ndarray, c: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Status, readings and errors."""
        q, error = _numbers(np.full(len(wanted), np.nan)), _numbers(np.full(2, np.nan))
        status = self._call("correct", _numbers(wanted), _numbers(c), q, error)
        return status, np.array(q), np.array(error)

    def in_range(self, q: np.ndarray, c: np.ndarray) -> int:
        """Status."""
        return self._call("in_range", _numbers(q), _numbers(c))

    def names(self, array: str) -> list[str]:
        """An array of names, up to its null pointer."""
        pointers = (ctypes.c_char_p * 100).in_dll(self._library, f"{self._name}_{array}")
        return [name.decode() for name in iter(iter(pointers).__next__, None)]


def _numbers(values: np.ndarray) -> ctypes.Array[ctypes.c_double]:
    return (ctypes.c_double * len(values))(*values)
