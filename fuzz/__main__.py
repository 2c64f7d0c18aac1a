"""Fuzz every reader, two at a time, and print what was found.

A finding is any exception but an `AridcalError`, an input that takes more than 5 s, or a process of more than 1 GB. The inputs
that did it are kept below `build/fuzz/`; a mended one goes into `fuzz/corpus/`, where the tests read it for ever.

Example:
    python -m fuzz                       # every reader, 10 minutes in all
    python -m fuzz urdf --runs 1000000   # one of them, until it has read so many files
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

READERS = tuple(sorted(folder.name for folder in (Path(__file__).parent / "corpus").iterdir()))
FOUND = Path("build") / "fuzz"

# One process that fuzzes for each processor that it may use (`taskset -c 0` leaves it one).
AT_ONCE = len(os.sched_getaffinity(0))

# [s] What `make fuzz` takes.
BUDGET = 600.0


def fuzz(reader: str, runs: int, seconds: float) -> dict[str, float]:
    """Fuzz a reader in a process of its own; return its tally."""
    folder = FOUND / reader
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():  # of an earlier run; what it gathered is a start for this one
        if old.is_file():
            old.unlink()
    command = [sys.executable, "-m", "fuzz.worker", reader, str(folder), str(runs), str(seconds)]
    with (folder / "log.txt").open("wb") as log:
        status = subprocess.run(command, stdout=log, stderr=log, check=False).returncode
    if not (folder / "tally.json").exists():
        sys.exit(
            f"{reader}: the fuzzer does not start, see {folder}/log.txt; Atheris comes with `pip install -e '.[fuzz]'`"
        )
    tally: dict[str, float] = json.loads((folder / "tally.json").read_text())
    return tally | {"findings": tally["findings"] + (status != 0)}  # a status: the process itself was killed


def main(argv: list[str] | None = None) -> int:
    """Fuzz; the exit status is 1 if anything was found."""
    parser = argparse.ArgumentParser(
        "python -m fuzz", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"default: all of {', '.join(READERS)}")
    parser.add_argument("--runs", type=int, default=0, help="files to read with each; default: as many as time allows")
    parser.add_argument("--seconds", type=float, help=f"for each; default: {BUDGET:g} in all unless --runs is given")
    arguments = parser.parse_args(argv)
    readers = arguments.readers or list(READERS)
    for name in readers:
        if name not in READERS:
            parser.error(f"no reader {name!r}: {', '.join(READERS)}")
    seconds = arguments.seconds or (0.0 if arguments.runs else BUDGET * min(AT_ONCE, len(readers)) / len(readers))
    print(
        f"{'reader':12s} {'executions':>10s} {'accepted':>9s} {'findings':>8s} {'slowest':>9s} {'memory':>8s} {'time':>7s}",
        flush=True,
    )
    findings = 0
    with ThreadPoolExecutor(AT_ONCE) as pool:
        tallies = pool.map(lambda name: fuzz(name, arguments.runs, seconds), readers)
        for name, tally in zip(readers, tallies, strict=True):
            found = int(tally["findings"])
            findings += found
            print(
                f"{name:12s} {tally['executions']:10,.0f} {tally['accepted'] / max(tally['executions'], 1):9.1%} {found:8d} "
                f"{1e3 * tally['slowest']:6.0f} ms {tally['memory']:5.0f} MB {tally['seconds']:5.0f} s", flush=True,
            )  # fmt: skip
    if findings:
        print(f"{findings} findings: see finding-*, crash-*, oom-* and timeout-* in {FOUND}/*/")
    return int(findings > 0)


if __name__ == "__main__":
    sys.exit(main())
