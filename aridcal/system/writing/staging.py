"""Results built aside, written through to the disk, put in place in one step; the next run settles what a killed run leaves."""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path

from aridcal.system.errors import OutputError
from aridcal.system.writing import disk
from aridcal.system.writing.lock import hold_lock, is_mine
from aridcal.system.writing.signals import defer_signals

OURS, LOCK = ".aridcal-", "lock"
"""In the names of what is beside an output only while it is written: ``.results.aridcal-lock``, ``.results.aridcal-1f0c9a2b``."""

NAME_SHOWN = 50
"""Letters of the output's name in those names: with up to four bytes each they stay within the 255 of file systems."""

MOST_SHARED = 1000
"""Other files in a folder that is swapped: each is linked into the new one, which takes some 10 µs."""

MOUNTS = Path("/proc/self/mountinfo")
"""Its fifth word is the mount point, blanks as ``\\040`` (proc(5))."""

GRACE = 0.1
"""Before an earlier folder is removed, [s]: a program that is listing it, or reading its files one after another, may finish."""

PLAN, NEW, OLD, LINK = "plan.json", "new", "old", "link"
"""What is in a stage: how it gets into its place; what was built (after a swap: what it replaced); what gave way to a link."""

DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS})
"""Errors that speak of the disk written to, whichever file was meant."""

UNMOVABLE_ERRORS = frozenset({errno.EXDEV, errno.EBUSY, errno.EPERM, errno.EACCES})
"""Answers to moving a folder that cannot be moved, though files can be moved into it: from a layer of a container, say."""


@dataclass(frozen=True)
class _Plan:
    """How a finished stage gets into its place. Once it is on the disk, a killed run is settled by the next one.

    Attributes:
        target: The folder, as seen from the one that holds the stage.
        arriving: Names of the new files.
        stale: Names of earlier files that go, since the new result has none in their place.
        swap: Whether the folder as a whole changes its place, or its files one by one.
        first: The file that is replaced; the others are taken away before, and appear after it.
        version: What the new folder is called if only a link can be replaced in one step.
        before: What that link names so far; empty if there is none.
    """

    target: str
    arriving: tuple[str, ...]
    stale: tuple[str, ...]
    swap: bool
    first: str
    version: str
    before: str


@contextmanager
def staged(target: Path, home: Path, path: Path) -> Iterator[Path]:
    """A folder to build in, on the file system of the target; when the block ends, it is settled and gone."""
    stage = home / f"{hidden_prefix(target)}{secrets.token_hex(4)}"
    try:
        with errors_named(path):
            disk.make_folder(stage)
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
    new = stage / NEW
    arriving = tuple(sorted(entry.name for entry in new.iterdir()))
    stale = tuple(sorted(set(replaces).difference(arriving)))
    folders = {name for name in arriving if (new / name).is_dir()}
    check_names(target, [name for name in arriving if name not in folders], folders)
    earlier = target.is_dir()
    if earlier:
        for name in arriving:
            if (target / name).exists():
                disk.keep_mode(target / name, new / name)
        swap = swap and _share_others(target, new, [*arriving, *stale])
    disk.sync_tree(new)
    version = f"{target.name[:NAME_SHOWN]}-{secrets.token_hex(4)}"
    before = str(target.readlink()) if target.is_symlink() else ""
    plan = _Plan(os.path.relpath(target, stage.parent), arriving, stale, swap, first, version, before)
    with defer_signals():
        disk.write(stage / PLAN, json.dumps(asdict(plan)))
        disk.sync(stage)
        if swap:
            _swap(plan, stage, target)
        else:
            _move(plan, new, target)
        disk.sync(target.parent)
    if swap and earlier:
        time.sleep(GRACE)


def _share_others(target: Path, new: Path, names: Collection[str]) -> bool:
    """Give the new folder whatever else the old one holds; False, and nothing, if that cannot be."""
    other_names = names_besides(target, names)
    try:
        for name in other_names:
            disk.share(target / name, new / name)
        disk.keep_mode(target, new)
    except OSError:
        for name in other_names:
            disk.remove(new / name)
        return False
    return True


def _swap(plan: _Plan, stage: Path, target: Path) -> None:
    """Have the new folder take the old one's place, in one step wherever there is one."""
    new = stage / NEW
    if not os.path.lexists(target):
        disk.rename(new, target)
        return
    try:
        if target.is_symlink() or not disk.exchange(new, target):
            _relink(plan, stage, target)
    except OSError as error:
        if error.errno not in UNMOVABLE_ERRORS:
            raise
        for source, place in ((target.parent / plan.version, new), (stage / OLD, target)):  # as it was
            if source.is_dir() and not os.path.lexists(place):
                disk.rename(source, place)
        plan = replace(plan, swap=False)
        disk.write(stage / PLAN, json.dumps(asdict(plan)))
        _move(plan, new, target)


def _relink(plan: _Plan, stage: Path, target: Path) -> None:
    """Without an exchange of folders: the target is a link to a version of the folder, and a link is replaced in one step.

    Only the first time, when a folder gives way to the link, are there two.
    """
    disk.rename(stage / NEW, target.parent / plan.version)
    disk.point(stage / LINK, plan.version)
    if not target.is_symlink():
        disk.rename(target, stage / OLD)
    disk.rename(stage / LINK, target)


def _move(plan: _Plan, new: Path, target: Path) -> None:
    """Move files one by one, as far as they have not been moved: never a new one stands beside an old one."""
    waiting = sorted(
        (name for name in plan.arriving if os.path.lexists(new / name)), key=lambda name: name != plan.first
    )
    for name in [*plan.stale, *waiting[1:]]:
        disk.remove(target / name)
    for name in waiting:
        disk.rename(new / name, target / name)


def _settle(stage: Path) -> None:
    """Complete what was begun with a stage, and remove it: at the end of a run, or after one that was killed."""
    if (plan := _read_plan(stage)) is not None:
        target = Path(os.path.normpath(stage.parent / plan.target))
        if plan.swap:
            _settle_swap(plan, stage, target)
        elif target.is_dir():
            _move(plan, stage / NEW, target)
    disk.remove(stage)


def _settle_swap(plan: _Plan, stage: Path, target: Path) -> None:
    """After a swap, or none: the old folder goes, but for what the user has put into it at the last moment."""
    if (stage / OLD).is_dir() and not os.path.lexists(target):  # killed between the two steps of a first link
        disk.rename(stage / OLD, target)
    out = [stage / NEW, stage / OLD]
    linked = target.is_symlink() and str(target.readlink()) == plan.version
    if not linked:
        out.append(target.parent / plan.version)
    elif plan.before:
        out.append(target.parent / plan.before)
    for folder in out:
        if folder.is_dir() and target.is_dir():
            for name in names_besides(folder, [*plan.arriving, *plan.stale]):
                if not os.path.lexists(target / name):
                    disk.rename(folder / name, target / name)
    for folder in out[2:]:
        disk.remove(folder)


def _read_plan(stage: Path) -> _Plan | None:
    """The plan of a stage; None if it has none yet: then nothing has been put in place. No plan reaches elsewhere."""
    try:
        plan = _Plan(**json.loads((stage / PLAN).read_text(encoding="utf-8")))
        names = [plan.target, plan.version, plan.before, *plan.arriving, *plan.stale]
        return plan if all(name != ".." and os.sep not in name for name in names) else None
    except (OSError, ValueError, TypeError):
        return None


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
    if home_of(target) == target or _is_mount_point(target):
        return False
    if not target.is_dir():
        return True
    with suppress(FileNotFoundError):  # this process stands in a folder that is gone
        if Path.cwd().is_relative_to(os.path.realpath(target)):
            return False
    count = 0
    for name in names_besides(target, names):
        inside = (entry for _, folders, files in os.walk(target / name) for entry in (*folders, *files))
        for entry in chain([name], inside):
            count += 1
            if OURS in entry or count > MOST_SHARED:  # OURS: another command writes in it
                return False
    return True


def _is_mount_point(folder: Path) -> bool:
    """Whether a folder is where a file system, or a part of one, is mounted; of a part only the system's own list tells."""
    if os.path.ismount(folder):
        return True
    try:
        mounts = MOUNTS.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:  # not a Linux
        return False
    points = (line.split()[4] for line in mounts.splitlines())
    return str(folder) in {re.sub(r"\\(\d{3})", lambda octal: chr(int(octal[1], 8)), point) for point in points}


def names_besides(folder: Path, names: Collection[str]) -> list[str]:
    """Names in a folder that are none of these."""
    return sorted({entry.name for entry in os.scandir(folder)}.difference(names))


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
