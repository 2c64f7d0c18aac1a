"""Whatever stops a command at whichever operation on a file: the output is the old one or the new one, whole."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from aridcal.system.errors import OutputError
from aridcal.system.writing import staging
from aridcal.system.writing.whole_files import atomic_file, atomic_folder, atomic_table, claimed

OLD = {"a.txt": "old a", "b.txt": "old b", "stale.txt": "old"}
NEW = {"a.txt": "new a", "b.txt": "new b", "c.txt": "new c"}
MINE = {"mine.txt": "mine", "notes/today.txt": "mine too"}
REPLACES = {*OLD, *NEW}


def contents(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def fill(folder: Path, texts: dict[str, str]) -> None:
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def write_folder(target: Path) -> None:
    with atomic_folder(target, REPLACES) as folder:
        fill(folder, NEW)


def write_table(target: Path) -> None:
    with atomic_table(target / "a.txt", ["b.txt", "c.txt", "stale.txt"]) as folder:
        fill(folder, NEW)


def write_file(target: Path) -> None:
    with atomic_file(target / "a.txt") as path:
        path.write_text("new a")


WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT

CHANGES = {"os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.chmod", "os.chown"}

_watching: list[Callable[[str, str], None]] = []
"""Told of each operation on files before it is done; hooks of Python's stay for ever, so that there is but one."""


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _watching:
        return
    if event == "open":
        path, _, flags = arguments
        if not (isinstance(path, str | os.PathLike) and isinstance(flags, int) and flags & WRITING):
            return
    elif event == "ctypes.dlsym":  # of the exchange of two folders, which is about to be done
        if arguments[1] != "renameat2":
            return
    elif event not in CHANGES:
        return
    for tell in tuple(_watching):
        tell(event, str(arguments[0]))


sys.addaudithook(_hook)


@contextmanager
def watched(tell: Callable[[str, str], None]) -> Iterator[None]:
    """Have something told of each operation on files before it is done; what it raises is that operation's failure."""
    _watching.append(tell)
    try:
        yield
    finally:
        _watching.remove(tell)


@contextmanager
def acting(at: int, act: Callable[[str], None]) -> Iterator[list[str]]:
    """Do something, with the path, just before the k-th operation on files; yields the names of those that were done."""
    done: list[str] = []

    def tell(operation: str, path: str) -> None:
        done.append(operation)
        if len(done) - 1 == at:
            act(path)

    with watched(tell):
        yield done


def die(_: str = "") -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail(code: int) -> Callable[[str], None]:
    def act(path: str) -> None:
        raise OSError(code, os.strerror(code), path)

    return act


def standing_in(write: Callable[[Path], None]) -> Callable[[Path], None]:
    """A folder that one stands in is not swapped: its files move one by one."""

    def write_inside(target: Path) -> None:
        before = Path.cwd()
        try:
            if target.is_dir():
                os.chdir(target)
            write(target)
        finally:
            os.chdir(before)

    return write_inside


WAYS = {
    "swapped": write_folder,
    "moved": standing_in(write_folder),
    "table": write_table,
    "file": write_file,
}
"""Each way in which an output gets into its place."""


WRITTEN = 7
"""How a child ends that was not killed."""


def serve() -> None:
    """Write in a child for each line that is read: the process of all tests is large, and each fork of it slow."""
    staging.GRACE = 0  # nobody reads
    for line in sys.stdin:
        name, place, kill, late = json.loads(line)
        target = Path(place)
        child = os.fork()
        if child == 0:
            with acting(late, lambda _, target=target: fill(target, {"late.txt": "mine"})), acting(kill, die):
                WAYS[name](target)
            os._exit(WRITTEN)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


@pytest.fixture(scope="module")
def killed() -> Iterator[Callable[..., bool]]:
    """Whether a child that writes in one of the ways was killed before its k-th operation, or had fewer.

    Before another one, ``late``, the user adds a file: two operations that are counted, too.
    """
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", "from test_kills import serve; serve()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env) as server:
        assert server.stdin is not None and server.stdout is not None

        def killed_at(name: str, target: Path, kill: int, late: int = -1) -> bool:
            print(json.dumps([name, str(target), kill, late]), file=server.stdin, flush=True)
            status = int(server.stdout.readline())
            assert status in (WRITTEN, -signal.SIGKILL)
            return status != WRITTEN

        yield killed_at


@pytest.fixture(params=WAYS)
def way(request, monkeypatch) -> tuple[str, Callable[[Path], None]]:
    monkeypatch.setattr(staging, "GRACE", 0)  # nobody reads
    return request.param, WAYS[request.param]


def expected(name: str, earlier: bool) -> tuple[dict[str, str], dict[str, str]]:
    """What a folder holds before and after."""
    mine = {} if not earlier else MINE
    before = {**OLD, **mine} if earlier else {}
    return before, ({**before, "a.txt": "new a"} if name == "file" else {**NEW, **mine})


@pytest.mark.parametrize("earlier", [True, False])
def test_a_kill_before_any_operation_leaves_old_or_new_and_the_next_run_leaves_nothing_else(
    tmp_path, way, earlier, killed
):
    name, write = way
    at, seen = 0, set()
    while True:
        home = tmp_path / str(at)
        target = home / "results"
        if earlier:
            fill(target, {**OLD, **MINE})
        else:
            home.mkdir()
        before, after = expected(name, earlier)
        cut = killed(name, target, at)
        found = {k: v for k, v in contents(target).items() if staging.OURS not in k} if target.is_dir() else {}
        if name in ("swapped", "file"):
            assert found in (before, after), at
        else:  # files move one by one: a new one never stands beside an old one of the result
            ours = {text.partition(" ")[0] for text in found.values() if not text.startswith("mine")}
            assert ours in ({"old"}, {"new"}, set()), (at, found)
        seen.add(frozenset(found.items()))
        with claimed(target, "folder"):  # any command that writes there clears up
            pass
        left = contents(target) if target.is_dir() else {}
        assert left in (before, after), at
        assert {p.name for p in home.iterdir()} <= {"results"}, at
        write(target)
        assert contents(target) == after
        if not cut:
            break
        at += 1
    assert at >= 4
    assert {frozenset(before.items()), frozenset(after.items())} <= seen


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EXDEV, errno.EACCES])
def test_a_failure_of_any_operation_leaves_old_or_new_and_is_said(tmp_path, way, code):
    name, write = way
    before, after = expected(name, True)
    at = 0
    while True:
        home = tmp_path / str(at)
        target = home / "results"
        fill(target, {**OLD, **MINE})
        with acting(at, fail(code)) as done:
            try:
                write(target)
                said = ""
            except OutputError as error:
                said = str(error)
        with claimed(target, "folder"):  # where the very removal fails, the next run removes
            pass
        found = contents(target)
        assert found in (before, after), at
        assert {p.name for p in home.iterdir()} <= {"results"}, at
        if said:
            assert str(target) in said and os.strerror(code) in said
        else:
            assert found == after
        if len(done) <= at:
            break
        at += 1
    assert at >= 4


def test_a_file_that_the_user_adds_at_the_last_moment_is_not_lost_even_by_a_kill(tmp_path, way, killed):
    for at in range(200):
        target = tmp_path / str(at) / "results"
        fill(target, OLD)
        cut = killed(way[0], target, at + 4, late=at)
        with claimed(target, "folder"):
            pass
        assert (target / "late.txt").exists() or not cut, at
        if not cut:
            break
    assert at >= 4


def test_a_reader_of_a_swapped_folder_never_sees_a_mixture(tmp_path, monkeypatch):
    target = tmp_path / "results"
    fill(target, dict.fromkeys(NEW, "0"))
    stop = threading.Event()
    looks: list[tuple[int, int]] = []

    def wait(seconds: float) -> None:
        """The grace of a replaced folder, until a look that began before has ended, however busy the machine is."""
        assert seconds > 0
        before = len(looks)
        while len(looks) == before and reader.is_alive():
            time.sleep(0)

    def read() -> None:
        while not stop.is_set():
            handle = os.open(target, os.O_RDONLY)  # one look: all its names in one and the same folder
            names = [entry.name for entry in os.scandir(handle)]
            texts = set()
            for name in names:
                file = os.open(name, os.O_RDONLY, dir_fd=handle)
                texts.add(os.read(file, 99))
                os.close(file)
            os.close(handle)
            looks.append((len(names), len(texts)))
            time.sleep(0)

    monkeypatch.setattr(staging, "time", SimpleNamespace(sleep=wait))
    reader = threading.Thread(target=read)
    reader.start()
    for k in range(50):
        with atomic_folder(target, REPLACES) as folder:
            fill(folder, dict.fromkeys(NEW, str(k)))
    stop.set()
    reader.join()
    assert len(looks) >= 50
    assert set(looks) == {(len(NEW), 1)}


HOLDER = """
import sys
from pathlib import Path
from aridcal.system.writing.whole_files import claimed

with claimed(Path(sys.argv[1]), sys.argv[2]):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize(("kind", "name"), [("folder", "results"), ("file", "poses.csv")])
def test_a_second_writer_is_told_the_number_of_the_first(tmp_path, kind, name):
    command = [sys.executable, "-c", HOLDER, str(tmp_path / name), kind]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(OutputError, match=rf"{name}: is being written by process {holder.pid}; wait"):  # noqa: SIM117
            with claimed(tmp_path / name, kind):
                pass
        with claimed(tmp_path / "another", "file"):  # what lives beside it is left alone
            assert (tmp_path / f".{name}.aridcal-lock").exists()
    with claimed(tmp_path / name, kind):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_killed_holder_holds_nothing(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "results"), "folder"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        holder.kill()
    assert (tmp_path / ".results.aridcal-lock").exists()
    write_file(tmp_path)  # another output beside it
    assert contents(tmp_path) == {"a.txt": "new a"}


def test_a_disk_that_is_full_leaves_no_lock_behind(tmp_path, monkeypatch):
    def full(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(Path, "write_text", full)
    for kind, name in (("folder", "new/results"), ("file", "poses.csv")):
        with pytest.raises(OutputError, match=rf"{name}: cannot be written: No space left.*Make room"):  # noqa: SIM117
            with claimed(tmp_path / name, kind):
                pytest.fail("the work has begun")
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    write_folder(tmp_path / "results")  # and no lock is held: another try succeeds


def test_two_threads_do_not_write_the_same_output(tmp_path):
    said = []

    def write() -> None:
        try:
            write_folder(tmp_path / "results")
        except OutputError as error:
            said.append(str(error))

    with claimed(tmp_path / "results", "folder"):
        thread = threading.Thread(target=write)
        thread.start()
        thread.join()
    assert said and "this very process, in another thread" in said[0]


def test_permissions_links_and_the_users_files_stay_what_they_are(tmp_path):
    target = tmp_path / "results"
    fill(target, {**OLD, **MINE})
    target.chmod(0o750)
    (target / "a.txt").chmod(0o600)
    (target / "mine.txt").chmod(0o444)
    (target / "link").symlink_to("mine.txt")
    inode = (target / "mine.txt").stat().st_ino
    write_folder(target)
    modes = {name: (target / name).stat().st_mode & 0o777 for name in ("", "a.txt", "mine.txt")}
    assert modes == {"": 0o750, "a.txt": 0o600, "mine.txt": 0o444}
    assert (target / "link").readlink() == Path("mine.txt")
    assert (target / "mine.txt").stat().st_ino == inode  # an editor that has it open goes on writing to it


@pytest.mark.parametrize("write", [write_folder, write_table])
@pytest.mark.parametrize("kind", ["folder", "link", "pipe"])
def test_what_is_no_file_is_never_replaced_by_one(tmp_path, write, kind):
    target = tmp_path / "results"
    fill(target, {**OLD, "elsewhere.txt": "mine"})
    (target / "b.txt").unlink()
    match kind:
        case "folder":
            fill(target / "b.txt", {"inside.txt": "mine"})
        case "link":
            (target / "b.txt").symlink_to("elsewhere.txt")
        case "pipe":
            os.mkfifo(target / "b.txt")
    before = sorted(str(p) for p in target.rglob("*"))
    with pytest.raises(OutputError, match=r"b\.txt: is (a link|not a file)"):
        write(target)
    assert sorted(str(p) for p in target.rglob("*")) == before


@pytest.mark.parametrize("swap", [True, False])
@pytest.mark.parametrize("where", ["target", "stale"])
def test_a_plan_that_somebody_has_planted_reaches_nothing_elsewhere(tmp_path, swap, where):
    fill(tmp_path, {"mine/thesis.txt": "mine", "shared/.x.aridcal-00000000/new/a.txt": "planted"})
    plan = {"target": "x", "arriving": ["a.txt"], "stale": [], "swap": swap}
    plan |= {"target": "../mine"} if where == "target" else {}
    plan |= {"stale": ["../../mine/thesis.txt"]} if where == "stale" else {}
    (tmp_path / "shared" / "x").mkdir()
    (tmp_path / "shared" / ".x.aridcal-00000000" / staging.PLAN).write_text(json.dumps(plan))
    with claimed(tmp_path / "shared" / "other.csv", "file"):
        pass
    assert contents(tmp_path) == {"mine/thesis.txt": "mine"}


def test_what_another_user_has_left_is_not_touched(tmp_path, monkeypatch):
    fill(tmp_path, {".x.aridcal-00000000/new/a.txt": "theirs"})
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with claimed(tmp_path / "other.csv", "file"):
        pass
    assert contents(tmp_path) == {".x.aridcal-00000000/new/a.txt": "theirs"}


def test_a_device_is_never_replaced_by_a_file():
    with pytest.raises(OutputError, match="/dev/null: is a device or a pipe"), atomic_file(Path("/dev/null")):
        pass


def test_a_folder_that_one_stands_in_keeps_its_identity(tmp_path, monkeypatch):
    target = tmp_path / "results"
    fill(target, OLD)
    monkeypatch.chdir(target)
    inode = target.stat().st_ino
    write_folder(Path())
    assert contents(target) == NEW
    assert Path.cwd().stat().st_ino == inode


MOUNTED = """
import os, subprocess, sys
from pathlib import Path
from test_kills import MINE, NEW, OLD, contents, fill, write_folder

home, other = Path(sys.argv[1]), sys.argv[2]
target = home / "my results"
target.mkdir()
subprocess.run(["mount", *(["--bind", home] if other == "bind" else ["-t", "tmpfs", "none"]), target], check=True)
fill(target, {**OLD, **MINE})
before = target.stat().st_ino
write_folder(target)
found = {name: text for name, text in contents(target).items() if not name.startswith("my results")}
assert found == {**NEW, **MINE} and target.stat().st_ino == before, found
assert [p.name for p in target.iterdir() if "aridcal-" in p.name] == []
print(sorted(p.name for p in home.iterdir()))
"""


@pytest.mark.parametrize("other", ["another file system", "bind"])
def test_a_mount_point_gets_its_files_from_within(tmp_path, other):
    """A file system of its own, or, which only the kernel's answer tells, a folder of the same one."""
    inside = ["unshare", "-Urm"]
    if subprocess.run([*inside, "true"], capture_output=True, check=False).returncode:
        pytest.skip("nobody but root may mount here")
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [*inside, sys.executable, "-c", MOUNTED, str(tmp_path), other]
    done = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 0, done.stderr
    if other != "bind":
        assert done.stdout == "['my results']\n"


def test_a_folder_in_which_another_command_writes_is_not_swapped_under_it(tmp_path):
    target = tmp_path / "results"
    fill(target, {**OLD, "sub/mine.txt": "mine"})
    with atomic_file(target / "sub" / "predicted.csv") as path:
        path.write_text("slow")
        write_folder(target)
    assert contents(target) == {**NEW, "sub/mine.txt": "mine", "sub/predicted.csv": "slow"}


def test_a_folder_with_very_many_other_files_keeps_its_identity(tmp_path):
    target = tmp_path / "results"
    fill(target, {**OLD, **{f"other/{k}": "" for k in range(staging.MOST_SHARED)}})
    inode = target.stat().st_ino
    write_folder(target)
    assert target.stat().st_ino == inode
    assert len(contents(target)) == len(NEW) + staging.MOST_SHARED


def test_a_folder_of_a_result_is_replaced_where_files_move_one_by_one(tmp_path, monkeypatch):
    fill(tmp_path / "results", {"inputs/old.csv": "old", "notes/today.txt": "mine"})
    monkeypatch.chdir(tmp_path / "results")
    with atomic_folder(Path(), ["inputs"]) as folder:
        fill(folder, {"inputs/new.csv": "new"})
    assert contents(tmp_path) == {"results/inputs/new.csv": "new", "results/notes/today.txt": "mine"}


def test_what_else_a_user_keeps_in_a_folder_does_not_hold_its_writer_up(tmp_path):
    target = tmp_path / "results"
    fill(target, {**OLD, "secret.txt": "mine"})
    os.mkfifo(target / "pipe")
    (target / "gone").symlink_to("nowhere")
    (target / "secret.txt").chmod(0)
    os.utime(target, (0, 0))
    write_folder(target)
    assert target.stat().st_mtime > 0
    assert sorted(p.name for p in target.iterdir()) == sorted([*NEW, "gone", "pipe", "secret.txt"])
    assert (target / "secret.txt").stat().st_mode & 0o777 == 0
