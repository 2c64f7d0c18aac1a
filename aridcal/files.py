"""Results that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Literal

from aridcal.errors import OutputError


def check_writable(path: Path, kind: Literal["folder", "file"] | None = None) -> None:
    """Make sure that results can be written, before any work is done for them.

    Args:
        path: What is to be written; it need not exist. A folder's parents need not either; a file's folder must: a slip
            in its name would else make a folder that nobody looks into.
        kind: What it is to be; None if either would do.

    Raises:
        OutputError: naming the path and what is in the way.
    """
    if kind is not None and path.exists() and path.is_dir() != (kind == "folder"):
        raise OutputError(f"{path}: is a {'file' if kind == 'folder' else 'folder'}, not a {kind}; give another name")
    home = _nearest_existing(path if path.is_dir() else path.parent)
    if not home.is_dir():
        raise OutputError(f"{path}: cannot be written: {home} is a file, not a folder")
    if kind == "file" and not path.parent.is_dir():
        raise OutputError(f"{path}: cannot be written: there is no folder {path.parent}; make it, or mend the path")
    try:
        # os.access knows nothing of read-only or full file systems: only writing tells.
        with tempfile.TemporaryFile(dir=home):
            pass
    except OSError as error:
        raise _cannot_write(path, error) from error


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Write a file that appears whole or not at all.

    Yields:
        Where to write it; it moves to ``path`` when the block ends, and is gone if the block raises.

    Raises:
        OutputError: the path cannot be written.
    """
    check_writable(path, "file")
    with _staged(path, path.parent) as stage:
        yield stage / path.name
        target = Path(os.path.realpath(path))  # a link stays a link
        (stage / path.name).replace(target)


@contextmanager
def atomic_folder(path: Path, replaces: Collection[str] = ()) -> Iterator[Path]:
    """Write several files into a folder: all appear together or none does, and earlier ones survive a failure.

    Whatever else the user keeps in the folder is never touched.

    Args:
        path: The folder; made if it does not exist.
        replaces: Files of an earlier result that must not outlive it, though this one may not write them.

    Yields:
        An empty folder to write into; its files move to ``path`` when the block ends.

    Raises:
        OutputError: the folder cannot be written.
    """
    check_writable(path, "folder")
    with _staged(path, path) as stage:
        new, old = stage / "new", stage / "old"
        new.mkdir()  # with the user's own permissions, which mkdtemp's folder has not
        yield new
        with _undisturbed():
            if path.is_dir():
                old.mkdir()
                _exchange(new, path, old, replaces)
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                new.rename(path)


def _exchange(new: Path, folder: Path, old: Path, replaces: Collection[str]) -> None:
    """Move files of ``new`` into a folder and those that they replace into ``old``; if anything fails, all back."""
    arriving = [entry.name for entry in new.iterdir()]
    leaving = [name for name in {*arriving, *replaces} if os.path.lexists(folder / name)]
    moves = [(folder / name, old / name) for name in leaving] + [(new / name, folder / name) for name in arriving]
    done: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            source.rename(target)
            done.append((source, target))
    except BaseException:
        for source, target in reversed(done):
            target.rename(source)
        raise


@contextmanager
def _staged(path: Path, folder: Path) -> Iterator[Path]:
    """A temporary folder on the file system of ``folder``, gone at the end; OSError in it means ``path``."""
    try:
        stage = Path(tempfile.mkdtemp(prefix=".aridcal-", dir=_nearest_existing(folder)))
        try:
            yield stage
        finally:
            with _undisturbed():
                shutil.rmtree(stage, ignore_errors=True)
    except FileNotFoundError:  # something else than the place to write to: a bug
        raise
    except OSError as error:
        raise _cannot_write(path, error) from error


def _nearest_existing(path: Path) -> Path:
    path = path.absolute()
    return next(p for p in (path, *path.parents) if p.exists())


def _cannot_write(path: Path, error: OSError) -> OutputError:
    return OutputError(f"{path}: cannot be written: {error.strerror or error}. Make room or choose another place.")


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let a few file moves finish; an interruption that comes meanwhile is too late and counts no more."""
    with handling({signal.SIGINT: signal.SIG_IGN, signal.SIGTERM: signal.SIG_IGN}):
        yield


Handler = Callable[[int, FrameType | None], Any] | signal.Handlers


@contextmanager
def handling(handlers: dict[signal.Signals, Handler]) -> Iterator[None]:
    """Set signal handlers for a while; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            with suppress(TypeError):  # None: a handler that was not set from Python cannot be set back
                signal.signal(number, handler)
