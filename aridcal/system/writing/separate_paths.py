"""What a command writes is none of the files that it reads, by whatever names these are given."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from aridcal.system.errors import OutputError


def check_apart(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Make sure that no file would be replaced by what is made of it.

    Args:
        outputs: Files that are to be written; they need not exist.
        inputs: Files that are read, or result folders; None: an argument that was not given.

    Raises:
        OutputError: one is the other: the same path, a link to it, or its second name.
    """
    files = [path for path in inputs if path is not None]
    for out in outputs:
        for path in files:
            file = _file_of(path)
            if _same(out, file):
                raise OutputError(f"{out}: is {file}, which is read: this would overwrite it; write to another file")


def _file_of(path: Path) -> Path:
    """The file that is read under a path: of a result folder its calibration."""
    with suppress(OSError, ValueError):  # what cannot be the name of a file is no folder
        if path.is_dir():
            return path / "calibration.yaml"
    return path


def _same(first: Path, second: Path) -> bool:
    """Whether two paths are one file, also where neither is there."""
    with suppress(OSError, ValueError):
        return first.samefile(second)
    with suppress(OSError, ValueError):
        return os.path.realpath(first) == os.path.realpath(second)
    return False
