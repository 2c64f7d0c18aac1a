"""The few operations on a disk that results are put in place with. Tests make any of them fail, or the process die before it."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path


def _nothing(operation: str, path: Path) -> None:
    """The usual observer: operations simply happen."""


before: Callable[[str, Path], None] = _nothing
"""Called with the name and the path of each operation before it is done; what it raises is that operation's failure."""

AT_FDCWD, RENAME_EXCHANGE = -100, 2
"""From Linux's fcntl.h and fs.h: paths are relative to the current folder; swap the two."""

NO_EXCHANGE = frozenset({errno.EINVAL, errno.ENOSYS})
"""What a file system, or a kernel, answers that cannot swap two folders."""


def make_folder(path: Path) -> None:
    """Make one folder, with the user's own permissions."""
    before("make folder", path)
    path.mkdir()


def write(path: Path, text: str) -> None:
    """Write a small file through to the disk."""
    before("write", path)
    path.write_text(text, encoding="utf-8")
    sync(path)


def append(path: Path, text: str) -> None:
    """Put a few lines behind those of a file, or into a new one."""
    before("append", path)
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text)


def rename(source: Path, target: Path) -> None:
    """Move within a file system, in one step; a file or a link in its place goes."""
    before("rename", target)
    source.replace(target)


def exchange(first: Path, second: Path) -> bool:
    """Swap two folders in one step (renameat2(2)).

    Returns:
        False if this system cannot do it: then nothing has happened.

    Raises:
        OSError: it can, but not with these two.
    """
    before("exchange", second)
    swap = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if swap is None:
        return False
    if swap(AT_FDCWD, os.fsencode(first), AT_FDCWD, os.fsencode(second), RENAME_EXCHANGE) == 0:
        return True
    if (code := ctypes.get_errno()) in NO_EXCHANGE:
        return False
    raise OSError(code, os.strerror(code), str(second))


def share(source: Path, target: Path) -> None:
    """Give a file, a link or a whole folder a second place. A file is not copied where the file system has hard links."""
    before("share", target)
    if source.is_dir() and not source.is_symlink():
        target.mkdir()
        for entry in sorted(source.iterdir()):
            share(entry, target / entry.name)
        keep_mode(source, target)
        shutil.copystat(source, target)
        return
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EMLINK, errno.ENOTSUP, errno.EACCES):
            raise
        shutil.copy2(source, target, follow_symlinks=False)


def point(link: Path, target: str) -> None:
    """Make a symbolic link."""
    before("link", link)
    link.symlink_to(target)


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with all that is in it, if it is there."""
    before("remove", path)
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def keep_mode(source: Path, target: Path) -> None:
    """Give a file or folder the permissions and, as far as the user may, the group of another."""
    before("mode", target)
    with suppress(PermissionError):
        os.chown(target, -1, source.stat().st_gid)
    shutil.copymode(source, target)


def sync(path: Path) -> None:
    """Have a file, or the list of names of a folder, written through to the disk."""
    before("sync", path)
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Have a folder and all that is in it written through to the disk."""
    for entry in folder.iterdir():
        if entry.is_symlink():
            continue
        if entry.is_dir():
            sync_tree(entry)
        else:
            sync(entry)
    sync(folder)
