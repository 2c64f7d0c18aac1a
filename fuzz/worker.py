"""One process that fuzzes one reader with Atheris, and keeps a tally on disk."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from random import Random

import atheris

with atheris.instrument_imports(include=["aridcal"], enable_loader_override=False):
    from aridcal.system.errors import AridcalError
    from fuzz.targets import CORPUS, TARGETS

from fuzz.mutate import AFRESH, mutate

# [s] and [MB]: more for one small file is a finding.
SLOW, LARGE = 5.0, 1000

# Share of the mutants of text that are made byte by byte, by libFuzzer.
BYTEWISE = 5

# [s] between two looks at the tally.
TALLY_EVERY = 1.0


class Worker:
    """Reads one mutant after the other, counts, and keeps what should not be."""

    def __init__(self, reader: str, folder: Path, runs: int, seconds: float) -> None:
        self.target, self.folder, self.runs, self.seconds = TARGETS[reader], folder, runs, seconds
        self.seeds = [path.read_bytes() for path in sorted((CORPUS / reader).iterdir())]
        memory = Path("/dev/shm")
        self.home = Path(tempfile.mkdtemp(prefix="aridcal-fuzz-", dir=memory if memory.is_dir() else None))
        self.path = self.home / f"input{self.target.suffix}"
        self.start = self.told = time.monotonic()
        self.executions = self.accepted = 0
        self.slowest = 0.0
        self.findings: set[str] = set()
        self.tell(b"")

    def one(self, content: bytes) -> None:
        """Read one file."""
        self.path.write_bytes(content)
        start = time.perf_counter()
        try:
            self.target.read(self.path)
            self.accepted += 1
        except AridcalError as error:
            if not str(error).strip():
                self.keep(content, "an error that says nothing")
        except Exception as error:
            where = [
                f"{Path(f.filename).name}:{f.name}"
                for f in traceback.extract_tb(error.__traceback__)
                if "aridcal" in f.filename
            ]
            self.keep(content, f"{type(error).__name__} in {where[-1] if where else '?'}", traceback.format_exc())
        taken = time.perf_counter() - start
        self.slowest = max(self.slowest, taken)
        if taken > SLOW:
            self.keep(content, "slow", f"{taken:.1f} s")
        self.executions += 1
        if time.monotonic() - self.told > TALLY_EVERY or self.executions == self.runs:
            self.tell(content)

    def tell(self, content: bytes) -> None:
        """Write the tally; end the process once it has done its work."""
        self.told = time.monotonic()
        if self.memory > LARGE:
            self.keep(content, "large", f"{self.memory} MB")
        tally = {
            "executions": self.executions, "accepted": self.accepted, "findings": len(self.findings), "slowest": self.slowest,
            "memory": self.memory, "seconds": self.told - self.start, "cpu": time.process_time(),
        }  # fmt: skip
        (self.folder / "tally.json").write_text(json.dumps(tally))
        if (self.runs and self.executions == self.runs) or (self.seconds and tally["seconds"] > self.seconds):
            shutil.rmtree(self.home, ignore_errors=True)
            os._exit(0)  # libFuzzer has no way to be told to stop

    @property
    def memory(self) -> int:
        """Peak so far, [MB]."""
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000

    def keep(self, content: bytes, what: str, more: str = "") -> None:
        """Keep the first input of each finding."""
        if what in self.findings:
            return
        self.findings.add(what)
        name = hashlib.sha256(what.encode()).hexdigest()[:12]
        (self.folder / f"finding-{name}{self.target.suffix}").write_bytes(content)
        (self.folder / f"finding-{name}.txt").write_text(f"{what}\n{more}")
        print(f"FINDING {what}", flush=True)

    def mutant(self, content: bytes, longest: int, seed: int) -> bytes:
        """A mutant as Atheris asks for it."""
        if self.target.kind != "binary" and seed % BYTEWISE:
            return mutate(content, seed, self.seeds, longest)
        rng = Random(seed)
        afresh = self.target.kind == "binary" and rng.random() < AFRESH
        return bytes(atheris.Mutate(rng.choice(self.seeds) if afresh else content, longest))


def main() -> None:
    """Fuzz until enough is read."""
    reader, folder, runs, seconds = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    warnings.simplefilter("error", RuntimeWarning)  # a user would see it, and wonder
    worker = Worker(reader, folder, runs, seconds)
    gathered = folder / "gathered"  # libFuzzer adds what it finds interesting to the first folder
    gathered.mkdir(exist_ok=True)
    options = [
        f"-max_len={worker.target.longest}",
        f"-rss_limit_mb={LARGE}",
        f"-timeout={SLOW:.0f}",
        f"-artifact_prefix={folder}/",
        "-mutate_depth=1",
    ]
    atheris.Setup(
        [sys.argv[0], *options, str(gathered), str(CORPUS / reader)], worker.one, custom_mutator=worker.mutant
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main()
