"""Results built aside, written through to the disk, put in place in one step; the next run settles what a killed run leaves."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import secrets
import shutil
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from itertools import chain, islice
from pathlib import Path
from typing import Any

from aridcal.system.errors import OutputError
from aridcal.system.writing.lock import hold_lock, is_mine
from aridcal.system.writing.signals import defer_signals

OURS, LOCK = ".aridcal-", "lock"
"""In the names of what is beside an output only while it is written: ``.results.aridcal-lock``, ``.results.aridcal-1f0c9a2b``."""

NAME_SHOWN = 50
"""Letters of the output's name in those names: with up to four bytes each they stay within the 255 of file systems."""

MOST_SHARED = 1000
"""Other files in a folder that is swapped: each is linked into the new one, which takes some 10 µs."""

GRACE = 0.1
"""Before an earlier folder is removed, [s]: a program that is listing it, or reading its files one after another, may finish."""

PLAN, NEW = "plan.json", "new"
"""What is in a stage: how it gets into its place; what was built (after a swap: what it replaced)."""

DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS})
"""Errors that speak of the disk written to, whichever file was meant."""

AT_FDCWD, RENAME_EXCHANGE = -100, 2
"""From Linux's fcntl.h and fs.h: paths are relative to the current folder; swap the two."""


@contextmanager
def staged(target: Path, home: Path, path: Path) -> Iterator[Path]:
    """A folder to build in, on the file system of the target; when the block ends, it is settled and gone."""
    stage = home / f"{hidden_prefix(target)}{secrets.token_hex(4)}"
    try:
        stage.mkdir()
        yield stage
    except OSError as error:
        # Any other file than those written here is somebody else's trouble: a bug, or an input.
        if error.errno in DISK_ERRORS or (str(error.filename).startswith(str(stage)) and error.errno != errno.ENOENT):
            raise _cannot_write(path, error) from error
        raise
    finally:
        with defer_signals(), suppress(OSError):  # what cannot be settled now is left to the next run
            _settle(stage)


def put_in_place(stage: Path, target: Path, replaces: Collection[str], swap: bool, first: str) -> None:
    """Put what was built in its place.

    Args:
        stage: Holds what was built.
        target: Where it goes.
        replaces: Names of an earlier result that go, whether the new one has them or not.
        swap: Whether the folder as a whole changes its place, or its files one by one.
        first: The file that is replaced where files move one by one; the others are taken away before.

    Raises:
        OSError: what was there before is still there, or the next run completes the move.
    """
    new, earlier = stage / NEW, target.is_dir()
    arriving = sorted(_others_than(new, ()), key=lambda name: name != first)
    stale = sorted(set(replaces).difference(arriving))
    folders = {name for name in arriving if (new / name).is_dir()}
    check_names(target, set(arriving) - folders, folders)
    for name in arriving if earlier else ():
        if (target / name).exists():
            keep_mode(target / name, new / name)
    swap = not earlier or (swap and _share_others(target, new, {*arriving, *stale}))
    _sync_tree(new)
    # Once this is on the disk, whatever stops what follows is settled: at the end of the block, or by the next run.
    plan = {"target": os.path.relpath(target, stage.parent), "arriving": arriving, "stale": stale, "swap": swap}
    _write_plan(plan, stage)
    if swap and earlier and not _exchanged(new, target):
        swap = False
        _write_plan(plan | {"swap": False}, stage)
    if not swap:
        _move(plan, new, target)
    elif not earlier:
        new.rename(target)
    sync(target.parent)
    if swap and earlier:
        time.sleep(GRACE)


def _share_others(target: Path, new: Path, names: Collection[str]) -> bool:
    """Give the new folder whatever else the old one holds, as hard links; False if that cannot be."""

    def ours(folder: str, entries: list[str]) -> Collection[str]:
        return names if folder == str(target) else ()

    try:
        shutil.copytree(target, new, symlinks=True, ignore=ours, copy_function=os.link, dirs_exist_ok=True)
        keep_mode(target, new)
        os.utime(new)  # it is changed now, not when the old one was
    except OSError:
        return False
    return True


def _exchanged(first: Path, second: Path) -> bool:
    """Swap two folders in one step (renameat2(2)); False if this cannot be done here: then nothing has happened."""
    swap = getattr(ctypes.CDLL(None), "renameat2", None)
    return swap is not None and not swap(AT_FDCWD, os.fsencode(first), AT_FDCWD, os.fsencode(second), RENAME_EXCHANGE)


def _move(plan: Mapping[str, Any], new: Path, target: Path) -> None:
    """Move files one by one, as far as they have not been moved: never a new one stands beside an old one."""
    waiting = [name for name in plan["arriving"] if os.path.lexists(new / name)]
    for name in [*plan["stale"], *waiting[1:]]:
        _remove(target / name)
    for name in waiting:
        if (target / name).is_dir():
            _remove(target / name)
        shutil.move(new / name, target / name)  # which copies where a file system is mounted at the target


def _settle(stage: Path) -> None:
    """Complete what was begun with a stage, and remove it: at the end of a run, or after one that was killed."""
    plan, new = _read_plan(stage), stage / NEW
    target = stage.parent / plan["target"] if plan else stage
    if plan and target.is_dir() and not plan["swap"]:
        _move(plan, new, target)
    elif plan and target.is_dir() and new.is_dir():  # the old folder: what the user has put into it at the last moment
        for name in _others_than(new, [*plan["arriving"], *plan["stale"]]):
            if not os.path.lexists(target / name):
                (new / name).rename(target / name)
    _remove(stage)


def _write_plan(plan: Mapping[str, Any], stage: Path) -> None:
    (stage / PLAN).write_text(json.dumps(plan), encoding="utf-8")
    sync(stage / PLAN)
    sync(stage)


def _read_plan(stage: Path) -> dict[str, Any]:
    """The plan of a stage; empty if it has none yet: then nothing has been put in place. No plan reaches elsewhere."""
    try:
        plan: dict[str, Any] = json.loads((stage / PLAN).read_text(encoding="utf-8"))
        names = [plan["target"], *plan["arriving"], *plan["stale"], str(plan["swap"])]
        return plan if all(name != ".." and os.sep not in name for name in names) else {}
    except (OSError, ValueError, TypeError, KeyError):
        return {}


def clear_up(folder: Path, current: Path) -> None:
    """Settle what the user's killed runs have left in a folder; of runs that live, and of others' runs, nothing is touched.

    Args:
        folder: Where to look; it need not exist.
        current: The lock that was taken just now.
    """
    entries = []
    for entry in os.scandir(folder) if folder.is_dir() else ():
        with suppress(OSError):  # gone by now
            if OURS in entry.name and entry.stat(follow_symlinks=False).st_uid == os.geteuid():
                entries.append(entry.name)
    for stem in sorted({name.partition(OURS)[0] for name in entries if name.startswith(".")}):
        lock = folder / f"{stem}{OURS}{LOCK}"
        if lock != current and is_mine(lock):
            continue
        with suppress(OutputError, OSError), nullcontext() if lock == current else hold_lock(lock, lock):
            for name in entries:
                if name.startswith(f"{stem}{OURS}") and name != lock.name:
                    _settle(folder / name)


def can_be_swapped(target: Path, names: Collection[str]) -> bool:
    """Whether a folder can change its place as a whole, with nobody missing it who stands or writes in it."""
    if home_of(target) == target or os.path.ismount(target):
        return False
    if not target.is_dir():
        return True
    with suppress(FileNotFoundError):  # this process stands in a folder that is gone
        if Path.cwd().is_relative_to(target):
            return False
    others = _others_than(target, names)
    inside = (entry for name in others for _, *kinds in os.walk(target / name) for entry in chain(*kinds))
    entries = list(islice(chain(others, inside), MOST_SHARED + 1))
    return len(entries) <= MOST_SHARED and not any(OURS in entry for entry in entries)  # OURS: a command writes in it


def _others_than(folder: Path, names: Collection[str]) -> list[str]:
    """Names in a folder that are none of these."""
    return sorted({entry.name for entry in folder.iterdir()}.difference(names))


def check_names(folder: Path, files: Collection[str], folders: Collection[str] = ()) -> None:
    """Refuse to put a file, or a folder, where the user keeps something else under its name.

    Raises:
        OutputError: naming it.
    """
    for name in (*files, *folders):
        path = folder / name
        if path.is_symlink():
            raise OutputError(
                f"{path}: is a link, and what it names would not change with the rest; remove or rename it"
            )
        kind = "folder" if name in folders else "file"
        if path.exists() and not (path.is_dir() if name in folders else path.is_file()):
            raise OutputError(f"{path}: is not a {kind}, and a {kind} of this name is to be written; move it away")


def home_of(target: Path) -> Path:
    """Where what is beside an output stands: in the folder around it, or in itself if nothing may be written there."""
    return target.parent if os.access(target.parent, os.W_OK | os.X_OK) or not target.is_dir() else target


def hidden_prefix(target: Path) -> str:
    """How the names of all that is beside an output begin."""
    return f".{target.name[:NAME_SHOWN]}{OURS}"


def keep_mode(source: Path, target: Path) -> None:
    """Give a file or folder the permissions and, as far as the user may, the group of another."""
    with suppress(PermissionError):
        os.chown(target, -1, source.stat().st_gid)
    shutil.copymode(source, target)


def sync(path: Path) -> None:
    """Have a file, or the list of names of a folder, written through to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_tree(folder: Path) -> None:
    """Have a folder and all that is in it written through to the disk, but for files of the user's that nobody may read."""
    for place, _, names in os.walk(folder):
        for path in map(Path(place).joinpath, names):
            if path.is_file() and not path.is_symlink():
                with suppress(PermissionError):
                    sync(path)
        sync(Path(place))


def _remove(path: Path) -> None:
    """Remove a file, a link, or a folder with all that is in it, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def errors_named(path: Path) -> Iterator[None]:
    """An error of the system inside the block becomes one that names the output."""
    try:
        yield
    except OSError as error:
        raise _cannot_write(path, error) from error
    except ValueError as error:  # a NUL in a name, or letters that the file system does not know
        raise OutputError(f"{str(path)!r}: cannot be written: {error}; give another name") from error


def _cannot_write(path: Path, error: OSError) -> OutputError:
    return OutputError(f"{path}: cannot be written: {error.strerror or error}. Make room or choose another place.")
