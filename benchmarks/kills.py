"""Commands killed, at every operation on a file and at any moment; two writers at once; readers while results are written.

Example:
    python benchmarks/kills.py each
    python benchmarks/kills.py random --kills 1000 --seed 1
    python benchmarks/kills.py writers --rounds 200
    python benchmarks/kills.py readers --looks 10000
    python benchmarks/kills.py stops --times 100

Every command runs in a child that shares nothing with its parent but the libraries it has loaded, over an earlier output
of its own and with a file of the user's beside it. ``each`` kills it (SIGKILL) before its k-th operation: every file opened
for writing, every folder made, renamed, linked, removed or swapped; for all k. ``random`` kills at a random
moment of its run. Then the output is looked at: it is the earlier one or the new one, whole, or, where files move one by
one (``measure`` into a folder with other files), never a new one beside an old one; and the next command that writes
there leaves nothing else. ``stops`` sends Ctrl-C or SIGTERM to real processes at any moment of their lives.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from aridcal import compensate, identify, init, measure, predict, simulate
from aridcal.system.writing import staging
from aridcal.system.writing.whole_files import claimed

ROOT = Path(__file__).resolve().parents[1]
ARID = ROOT / "identification" / "arid"
STRIP = ROOT / "identification" / "arid-strip"
MINE = "mine.txt"
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.chmod", "os.chown")
OWN = re.compile(r"aridcal/(?!__init__|interrupt)\w+\.py")
"""In a traceback: a file of ours that is loaded after signals are watched."""


@dataclass(frozen=True)
class Job:
    """A command over an earlier output.

    Attributes:
        name: What it is called in the table.
        main: The command.
        earlier: Arguments that made the earlier output; empty if there is none.
        arguments: Of the run that is killed.
        output: What it writes.
        one_step: Whether all of it appears in one step.
    """

    name: str
    main: Callable[[Sequence[str]], int]
    earlier: tuple[str, ...]
    arguments: tuple[str, ...]
    output: str
    one_step: bool = True


JOBS = (
    Job("identify", identify.main, ("campaign.yaml", "--seed", "1"), ("campaign.yaml",), "results"),
    Job("identify, first", identify.main, (), ("campaign.yaml", "-o", "deep/results"), "deep/results"),
    Job("simulate", simulate.main, ("one.yaml", "-o", "simulated"), ("two.yaml", "-o", "simulated"), "simulated"),
    Job("measure", measure.main, ("one/head.yaml", "-o", "own/m.csv"), ("two/head.yaml", "-o", "own/m.csv"), "own"),
    Job(
        "measure, beside others", measure.main,
        ("one/head.yaml", "-o", "mixed/m.csv"), ("two/head.yaml", "-o", "mixed/m.csv"), "mixed", one_step=False,
    ),
    Job("predict", predict.main, ("c.yaml", "one.csv", "-o", "p.csv"), ("c.yaml", "two.csv", "-o", "p.csv"), "p.csv"),
    Job("compensate", compensate.main, ("c.yaml", "pose1.csv", "-o", "j.csv"), ("c.yaml", "pose2.csv", "-o", "j.csv"), "j.csv"),
    Job("init", init.main, (), ("--urdf", "arid.urdf", "--measurements", "all.csv", "-o", "new.yaml"), "new.yaml"),
)  # fmt: skip


def prepare(home: Path) -> None:
    """Fill a folder with small inputs for every command."""
    shutil.copy(ROOT / "urdf" / "arid.urdf", home)
    keys = yaml.safe_load((ARID / "campaign.yaml").read_text())
    keys["robot"]["urdf"] = "arid.urdf"
    keys["diagnosis"] = {"enabled": False}
    (home / "campaign.yaml").write_text(yaml.safe_dump(keys))
    table = pd.read_csv(ARID / "measurements.csv")
    table.to_csv(home / "all.csv", index=False)
    table.head(80).to_csv(home / "measurements.csv", index=False)
    keys = yaml.safe_load((ARID / "scenario.yaml").read_text())
    keys["robot"]["urdf"] = "arid.urdf"
    for name, seed in (("one", 1), ("two", 2)):
        keys["truth"] |= {"n": 20, "seed": seed}
        (home / f"{name}.yaml").write_text(yaml.safe_dump(keys))
        shots = pd.read_csv(STRIP / "shots.csv").iloc[seed : seed + 3]
        (home / name / "images").mkdir(parents=True)
        for image in shots["image"]:
            shutil.copy(STRIP / image, home / name / image)
        shots.to_csv(home / name / "shots.csv", index=False)
        for file in ("head.yaml", "squares.csv"):
            shutil.copy(STRIP / file, home / name)
        rows = table.iloc[20 * seed : 20 * seed + 20]
        rows.to_csv(home / f"{name}.csv", index=False)
        rows.to_csv(home / f"pose{seed}.csv", index=False)
    (home / "mixed").mkdir()
    (home / "mixed" / MINE).write_text("mine")
    assert started(identify.main, ("campaign.yaml", "-o", "model"), home) == 0
    shutil.copy(home / "model" / "calibration.yaml", home / "c.yaml")
    for job in JOBS:
        if job.earlier:
            assert started(job.main, job.earlier, home) == 0, job.name
        if (home / job.output).is_dir() and job.name != "measure":
            (home / job.output / MINE).write_text("mine")


def in_child(main: Callable[[Sequence[str]], int], arguments: Sequence[str], home: Path, at: int = -1) -> int:
    """Start a command in a child; it dies before its k-th operation on a file. Returns the child's process number."""
    child = os.fork()
    if child:
        return child
    os.chdir(home)
    said = os.open(home.parent / f"said-{os.getpid()}", os.O_WRONLY | os.O_CREAT)
    os.dup2(said, 1)
    os.dup2(said, 2)
    if at >= 0:
        die_at(at, home)
    try:
        status = main(arguments)
    except SystemExit as stop:
        status = int(stop.code or 0)
    os._exit(status)


def die_at(at: int, home: Path) -> None:
    """From now on count operations on files below a folder, and die before the k-th."""
    count = 0

    def step() -> None:
        nonlocal count
        if count == at:
            os.kill(os.getpid(), signal.SIGKILL)
        count += 1

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            if (
                isinstance(path, str)
                and isinstance(flags, int)
                and flags & WRITING
                and Path(path).absolute().is_relative_to(home)
            ):
                step()
        elif event in CHANGES or (event == "ctypes.dlsym" and arguments[1] == "renameat2"):
            step()

    sys.addaudithook(hook)


def ended(child: int, home: Path) -> tuple[int, str]:
    """Wait for a child: its exit status, or minus the signal that ended it, and what it said."""
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    said = home.parent / f"said-{child}"
    text = said.read_text() if said.exists() else ""
    said.unlink(missing_ok=True)
    return status, text


def started(main: Callable[[Sequence[str]], int], arguments: Sequence[str], home: Path) -> int:
    """Run a command in a child to its end; returns its exit status."""
    return ended(in_child(main, arguments, home), home)[0]


def state(path: Path) -> dict[str, str]:
    """Digest of every file of an output; times that a run took are left out."""
    if path.is_file():
        return {"": digest(path)}
    files = (p for p in sorted(path.rglob("*")) if p.is_file())
    return {str(p.relative_to(path)): digest(p) for p in files}


def digest(path: Path) -> str:
    content = path.read_bytes()
    if path.suffix in (".json", ".html"):
        content = re.sub(rb'"?seconds"?: ?[0-9.]+|[0-9.]+ s\b', b"", content)
    return hashlib.sha256(content).hexdigest()


@dataclass(frozen=True)
class Known:
    """What an output is before a run and after it."""

    before: dict[str, str]
    after: dict[str, str]

    def fault(self, found: dict[str, str], job: Job) -> str:
        """What is wrong with an output after a kill; empty if nothing is."""
        if found == self.before:
            return ""
        if found == self.after:
            return ""
        hidden = [name for name in found if staging.OURS in name]
        if job.one_step or (hidden and not self.before):
            return f"neither old nor new: {sorted(found)}"
        changed = {name for name in found if name not in hidden and self.before.get(name) != self.after.get(name)}
        kinds = {"new" if found[name] == self.after.get(name) else "old" for name in changed}
        return "a mixture" if len(kinds) > 1 or found.get(MINE) != self.before.get(MINE) else ""


def known(job: Job, home: Path) -> Known:
    """Run a job to its end in a copy."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "home"
        shutil.copytree(home, copy)
        assert started(job.main, job.arguments, copy) == 0, job.name
        return Known(state(home / job.output), state(copy / job.output))


def after_kill(job: Job, home: Path, expected: Known) -> str:
    """Look at an output after a kill, then have the next command clear up; returns what is wrong, if anything."""
    fault = expected.fault(state(home / job.output), job)
    if fault:
        return fault
    kind: Any = "folder" if "." not in Path(job.output).name else "file"
    with claimed(home / job.output, kind):
        pass
    left = [str(p.relative_to(home)) for p in home.rglob("*") if staging.OURS in p.name]
    if left:
        return f"left over: {left}"
    found = state(home / job.output)
    return "" if found in (expected.before, expected.after) else "not whole after the next start"


def fresh(home: Path, master: Path) -> None:
    """Put a folder back as it was."""
    shutil.rmtree(home, ignore_errors=True)
    shutil.copytree(master, home)


def each(master: Path, home: Path, only: Sequence[str] = ()) -> int:
    """Kill before every operation of every command; returns the number of faults."""
    faults = 0
    for job in JOBS:
        if only and job.name not in only:
            continue
        expected, at, news, wrong = known(job, master), 0, 0, Counter[str]()
        while True:
            fresh(home, master)
            status, said = ended(in_child(job.main, job.arguments, home, at), home)
            if status == 0:
                break
            assert status == -signal.SIGKILL, (job.name, at, status, said)
            news += state(home / job.output) == expected.after
            fault = after_kill(job, home, expected)
            if fault:
                wrong[fault] += 1
                print(f"  {job.name}, operation {at}: {fault}")
            at += 1
        faults += wrong.total()
        print(
            f"{job.name:24} {at:4} kills: {at - news - wrong.total():4} old, {news:3} new, {wrong.total()} wrong",
            flush=True,
        )
    return faults


def at_random(master: Path, home: Path, kills: int, seed: int) -> int:
    """Kill at random moments; returns the number of faults."""
    choose, faults = random.Random(seed), 0
    for number, job in enumerate(JOBS):
        expected, counts = known(job, master), Counter[str]()
        fresh(home, master)
        begin = time.perf_counter()
        started(job.main, job.arguments, home)
        duration = time.perf_counter() - begin
        for _ in range(number, kills, len(JOBS)):
            fresh(home, master)
            child = in_child(job.main, job.arguments, home)
            time.sleep(choose.uniform(0, duration))
            os.kill(child, signal.SIGKILL)
            status, _ = ended(child, home)
            new = state(home / job.output) == expected.after
            fault = after_kill(job, home, expected)
            if fault:
                print(f"  {job.name}: {fault}")
            counts["wrong" if fault else "done" if status == 0 else "new" if new else "old"] += 1
        faults += counts["wrong"]
        shown = ", ".join(f"{counts[key]} {key}" for key in ("old", "new", "done", "wrong"))
        print(f"{job.name:24} killed within {duration:5.2f} s: {shown}", flush=True)
    return faults


def writers(master: Path, home: Path, rounds: int) -> int:
    """Two writers of one output, started together; returns the number of faults."""
    faults, counts = 0, Counter[str]()
    for number in range(rounds):
        job = JOBS[(0, 2, 3, 5)[number % 4]]
        fresh(home, master)
        pair = [in_child(job.main, job.arguments, home) for _ in range(2)]
        results = {child: ended(child, home) for child in pair}
        status = sorted(code for code, _ in results.values())
        named = any(f"process {child}" in said for child in pair for _, said in results.values())
        left = [p.name for p in home.rglob("*") if staging.OURS in p.name]
        good = not left and (status == [0, 0] or (status == [0, 2] and named))
        counts["both, one after the other" if status == [0, 0] else "one refused, told the other's number"] += good
        if not good:
            faults += 1
            print(f"  {job.name}: {status}, left {left}: {[said[-200:] for _, said in results.values()]}")
    print(f"{rounds} rounds of two writers: {dict(counts)}, {faults} wrong")
    return faults


def readers(master: Path, home: Path, looks: int) -> int:
    """Look at a folder that two runs write in turn, over and over; returns the number of faults.

    A look opens the folder by its path, lists it, and reads every file of what it has opened.
    """
    job = JOBS[2]
    fresh(home, master)
    folder = home / job.output
    whole = []
    for arguments in (job.arguments, job.earlier):
        assert started(job.main, arguments, home) == 0
        whole.append(state(folder))
    writer = os.fork()
    if not writer:
        while True:
            for arguments in (job.arguments, job.earlier):
                ended(in_child(job.main, arguments, home), home)
    missing = mixed = again = 0
    seen = set()
    for _ in range(looks):
        try:
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            missing += 1
            continue
        try:
            seen.add(os.fstat(handle).st_ino)
            mixed += state(Path(f"/proc/self/fd/{handle}/")) not in whole
        except FileNotFoundError:  # this very folder was replaced more than the grace ago
            again += 1
        finally:
            os.close(handle)
    os.kill(writer, signal.SIGKILL)
    os.waitpid(writer, 0)
    print(f"{looks} looks at {len(seen)} folders: {missing} missing, {mixed} mixed, {again} began before a replacement")
    return missing + mixed


def stops(master: Path, home: Path, times: int, seed: int) -> int:
    """Ctrl-C and SIGTERM at any moment of real processes; returns the number of faults."""
    choose, faults, counts = random.Random(seed), 0, Counter[str]()
    commands = [
        [sys.executable, "-m", "aridcal.identify"],
        [str(Path(sys.executable).with_name("aridcal")), "identify"],
    ]
    for number in range(times):
        fresh(home, master)
        by, expected = ((signal.SIGINT, 130), (signal.SIGTERM, 143))[number % 2]
        start = commands[number // 2 % 2]
        pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        with subprocess.Popen([*start, "campaign.yaml"], cwd=home, **pipes) as process:
            moment = choose.uniform(0, 3.0)
            time.sleep(moment)
            process.send_signal(by)
            said, _ = process.communicate()
        left = [p.name for p in home.rglob("*") if staging.OURS in p.name]
        status = process.returncode
        early = status != expected and OWN.search(said) is None  # Python had not reached aridcal
        good = not left and (early or (status in (expected, 0) and "Traceback" not in said))
        counts[f"{by.name}, {'before aridcal was reached' if early and status else status}"] += 1
        if not good:
            faults += 1
            print(f"  {by.name} after {1e3 * moment:.0f} ms: {status}, left {left}: {said[-300:]}")
    print(f"{times} stops: {dict(sorted(counts.items()))}, {faults} wrong")
    return faults


def main() -> int:
    """Run a check; returns 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("check", choices=["each", "random", "writers", "readers", "stops"])
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--looks", type=int, default=10_000)
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        master, home = Path(place) / "master", Path(place) / "home"
        master.mkdir()
        prepare(master)
        faults = {
            "each": lambda: each(master, home),
            "random": lambda: at_random(master, home, given.kills, given.seed),
            "writers": lambda: writers(master, home, given.rounds),
            "readers": lambda: readers(master, home, given.looks),
            "stops": lambda: stops(master, home, given.times, given.seed),
        }[given.check]()
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
