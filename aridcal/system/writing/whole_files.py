"""Results that appear whole or not at all. docs/promises.md says what is guaranteed, and where one step is not to be had."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Literal

from aridcal.system.errors import OutputError
from aridcal.system.writing.lock import hold_lock, is_mine
from aridcal.system.writing.signals import defer_signals
from aridcal.system.writing.staging import (
    LOCK,
    NEW,
    can_be_swapped,
    check_names,
    clear_up,
    errors_named,
    hidden_prefix,
    home_of,
    keep_mode,
    put_in_place,
    staged,
    sync,
)

OutputKind = Literal["folder", "file"]


def check_writable(path: Path, kind: OutputKind | None = None) -> None:
    """Make sure that results can be written, before any work is done for them.

    Args:
        path: What is to be written; it need not exist, nor need its parents.
        kind: What it is to be; None if either would do.

    Raises:
        OutputError: naming the path and what is in the way.
    """
    with errors_named(path):
        if kind is not None and path.exists() and path.is_dir() != (kind == "folder"):
            raise OutputError(
                f"{path}: is a {'file' if kind == 'folder' else 'folder'}, not a {kind}; give another name"
            )
        if path.exists() and not path.is_dir() and not path.is_file():
            raise OutputError(f"{path}: is a device or a pipe, which cannot be replaced; give the name of a file")
        home = _nearest_existing(path if path.is_dir() else path.parent)
        if not home.is_dir():
            raise OutputError(f"{path}: cannot be written: {home} is a file, not a folder")
        # os.access knows nothing of read-only or full file systems: only writing tells.
        with tempfile.TemporaryFile(dir=home):
            pass


@contextmanager
def claimed(path: Path, kind: OutputKind, names: Collection[str] = (), folders: Collection[str] = ()) -> Iterator[None]:
    """Take an output for this process until the block ends, before any work is done for it.

    What killed runs have left beside it is settled and cleared away.

    Args:
        path: What is to be written; its parents are made, and go again if they stay empty.
        kind: What it is to be.
        names: Files that will be written into a folder.
        folders: Folders that will be.

    Raises:
        OutputError: it cannot be written, or another process is writing it, whose number is named.
    """
    check_writable(path, kind)
    parents: list[Path] = []
    with ExitStack() as ends:
        with errors_named(path):
            target = _place(path)
            parents += [parent for parent in (target.parent, *target.parent.parents) if not parent.exists()]
            ends.callback(_remove_empty, parents)
            target.parent.mkdir(parents=True, exist_ok=True)
            with defer_signals():
                lock = home_of(target) / f"{hidden_prefix(target)}{LOCK}"
                if not is_mine(lock):
                    ends.enter_context(hold_lock(lock, path))
                    clear_up(home_of(target), lock)
                    clear_up(target, lock)
            if kind == "folder":
                check_names(target, names, folders)
        yield


@contextmanager
def claimed_table(path: Path, beside: Sequence[str]) -> Iterator[None]:
    """Take a table and the files that belong to it for this process until the block ends, before any work is done for them.

    Args:
        path: The table.
        beside: Names of the other files, in the same folder.

    Raises:
        OutputError: the table is no .csv file or would replace one of the others, or cannot be written.
    """
    if path.suffix.lower() != ".csv" or path.name in beside:
        raise OutputError(f"{path}: should be a .csv file, and not {' or '.join(beside)}, written beside it")
    check_writable(path, "file")
    with claimed(path.parent, "folder", [path.name, *beside]):
        yield


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Write a file that appears whole or not at all. A link stays a link, and permissions stay.

    Yields:
        Where to write it; it moves to ``path`` when the block ends, and is gone if the block raises.

    Raises:
        OutputError: the path cannot be written.
    """
    with claimed(path, "file"):
        target = _place(path)
        with staged(target, target.parent, path) as stage:
            built = stage / target.name
            yield built
            with errors_named(path):
                if target.exists():
                    keep_mode(target, built)
                sync(built)
                built.replace(target)
                sync(target.parent)


@contextmanager
def atomic_folder(path: Path, replaces: Collection[str] = ()) -> Iterator[Path]:
    """Write several files into a folder: all appear together or none does, and earlier ones survive a failure.

    Whatever else the user keeps in the folder stays.

    Args:
        path: The folder; made if it does not exist.
        replaces: Files of an earlier result that must not outlive it, though this one may not write them.

    Yields:
        An empty folder to write into; its files are in ``path`` when the block ends.

    Raises:
        OutputError: the folder cannot be written.
    """
    with claimed(path, "folder"):
        target = _place(path)
        with _built(target, path, can_be_swapped(target, replaces), replaces) as new:
            yield new


@contextmanager
def atomic_table(path: Path, beside: Sequence[str]) -> Iterator[Path]:
    """Write a table and files that belong to it, into a folder that may hold much else.

    In a folder of their own all appear in one step. Elsewhere earlier ones of ``beside`` go first, then the table is
    replaced, then the new ones appear: no table ever stands beside another's.

    Args:
        path: The table.
        beside: Names of the other files, in the same folder.

    Yields:
        An empty folder to write them into, under their names.

    Raises:
        OutputError: the folder cannot be written.
    """
    with claimed(path.parent, "folder", [path.name, *beside]):
        target, names = _place(path.parent), [path.name, *beside]
        alone = not target.is_dir() or {entry.name for entry in target.iterdir()} <= set(names)
        with _built(target, path, alone and can_be_swapped(target, names), names, path.name) as new:
            yield new


@contextmanager
def _built(target: Path, path: Path, swap: bool, replaces: Collection[str], first: str = "") -> Iterator[Path]:
    """An empty folder; what is written into it is put in its place."""
    with staged(target, home_of(target) if swap else target, path) as stage:
        (stage / NEW).mkdir()
        yield stage / NEW
        with errors_named(path):
            put_in_place(stage, target, replaces, swap, first)


def _place(path: Path) -> Path:
    """The file or folder behind a path; links are followed."""
    place = Path(os.path.realpath(path))
    if place.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    return place


def _nearest_existing(path: Path) -> Path:
    path = path.absolute()
    return next(p for p in (path, *path.parents) if p.exists())


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty: it has the result
            folder.rmdir()
