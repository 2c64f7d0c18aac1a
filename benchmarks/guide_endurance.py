"""What `aridcal guide` stands: drivers killed in mid-line, tables swapped and rotated, pages closed, thousands of rows.

Example:
    python benchmarks/guide_endurance.py            # both
    python benchmarks/guide_endurance.py attacks    # minutes
    python benchmarks/guide_endurance.py long 5000  # rows in batches, one by one at the end; and all at once
    python benchmarks/guide_endurance.py looks 8    # all looks at the table and of the page in 8 hours, without their pauses
    python benchmarks/guide_endurance.py clock 8    # 8 hours by the clock, the page open

The command runs as a child of its own, as a user starts it, on a UR10 whose constants are all off by a millimetre or a
milliradian. Each attack appends rows; afterwards every row that was written whole must have been answered once, under a line
of its own, and no other. Told are the rows, what is missing or too much, and the resident memory; of the long run besides how
long a row takes at the end, and the memory at each thousand of rows.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from endurance import ENVIRONMENT, MEGA, simulated

from aridcal.jobs.guide.events import RowRead

BATCH, SINGLE = 250, 10
"""Rows appended at once in the long run, and rows appended one by one after them."""

GROWS = 1.3
"""Times as much memory at the end of the long run as at its half: more is growth without bound. Rows themselves double."""

PATIENCE = 300.0  # [s] for one answer

DAY_ROWS = 60
"""Rows that come in the hours that are asked for, at equal times: fewer than after which the guide stops by itself."""

QUARTERS = 4
"""Times at which the memory is told; the first one counts as begun."""

PAGE_ASKS = 0.3  # [s], as the page does
HOUR = 3600.0  # [s]


@dataclass
class Guide:
    """The command, and what it said.

    Attributes:
        table: That it follows.
        lines: Header and rows that were measured.
        written: Rows that were written whole so far.
        said: Events so far.
        came: Set when something is said.
    """

    folder: Path
    lines: list[bytes]
    written: int = 0
    said: list[dict[str, Any]] = field(default_factory=list)
    url: str = ""

    def __post_init__(self) -> None:
        command = [sys.executable, "-m", "aridcal", "guide", "campaign.yaml", "--json"]
        self.child = subprocess.Popen(
            command,
            cwd=self.folder,
            env=ENVIRONMENT | {"BROWSER": "true"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        threading.Thread(target=self._listen, daemon=True).start()
        threading.Thread(target=self._errors, daemon=True).start()

    @property
    def table(self) -> Path:
        """The file that it follows."""
        return self.folder / "measurements.csv"

    def _listen(self) -> None:
        assert self.child.stdout is not None
        for line in self.child.stdout:
            self.said.append(json.loads(line))

    def _errors(self) -> None:
        assert self.child.stderr is not None
        for line in self.child.stderr:
            words = line.decode().split()
            self.url = self.url or next((word for word in words if word.startswith("http://")), "")
            if "Traceback" in words:
                print(line.decode(), *map(bytes.decode, self.child.stderr), sep="")

    def some(self, n: int) -> list[bytes]:
        """The next rows, taken as written."""
        self.written += n
        return self.lines[1 + self.written - n : 1 + self.written]

    def append(self, text: bytes) -> None:
        """Append to the table."""
        with self.table.open("ab") as file:
            file.write(text)

    def answered(self) -> list[int]:
        """Lines of rows that were answered for the first time, in order."""
        return list(dict.fromkeys(event["row"] for event in self.said if event["event"] == "row"))

    def wait(self, rows: int) -> float:
        """Wait until so many rows were answered, and the pose after them was said; returns the seconds."""
        begun = time.monotonic()
        while len(self.answered()) < rows or self.said[-1]["event"] not in ("next", "stop"):
            if self.child.poll() is not None or time.monotonic() > begun + PATIENCE:
                break
            time.sleep(0.02)
        return time.monotonic() - begun

    def memory(self) -> float:
        """Resident memory, in bytes."""
        return _resident(str(self.child.pid))

    def end(self) -> None:
        """Kill it: the report is no matter of this."""
        self.child.kill()
        self.child.wait()


def _resident(process: str) -> float:
    """Resident memory of a process, in bytes."""
    status = Path(f"/proc/{process}/status").read_text()
    return 1024.0 * float(status.split("VmRSS:")[1].split()[0])


def _killed_in_mid_line(guide: Guide) -> int:
    """The driver dies within a line, and goes on with a new one: half a line is a row that cannot be read."""
    first, second = guide.some(2)
    guide.append(first[: len(first) // 2])
    time.sleep(0.5)
    guide.append(b"\n" + first + b"\n" + second + b"\n")
    return 3


def _slow_line(guide: Guide) -> int:
    """A line that comes in three pieces."""
    (line,) = guide.some(1)
    for part in (line[:5], line[5:40], line[40:] + b"\n"):
        guide.append(part)
        time.sleep(0.3)
    return 1


def _swapped(guide: Guide) -> int:
    """The whole table is written anew, with two rows more, and moved there."""
    more = guide.some(2)
    fresh = guide.folder / "fresh.csv"
    fresh.write_bytes(guide.table.read_bytes() + b"\n".join(more) + b"\n")
    fresh.replace(guide.table)
    return 2


def _rotated(guide: Guide) -> int:
    """The table is moved away, and a new one begins with its header."""
    guide.table.replace(guide.folder / f"old{guide.written}.csv")
    time.sleep(0.3)
    guide.append(guide.lines[0] + b"\n")
    time.sleep(0.3)
    guide.append(b"\n".join(guide.some(3)) + b"\n")
    return 3


def _other_system(guide: Guide) -> int:
    """Written anew with the other system's line ends."""
    content = guide.table.read_bytes().replace(b"\r\n", b"\n") + b"\n".join(guide.some(1)) + b"\n"
    guide.table.write_bytes(content.replace(b"\n", b"\r\n"))
    return 1


def _cut_off(guide: Guide) -> int:
    """Cut off in the middle, and written whole again a moment later."""
    content = guide.table.read_bytes()
    guide.table.write_bytes(content[: len(content) // 2])
    time.sleep(0.3)
    guide.table.write_bytes(content + b"\n".join(guide.some(2)) + b"\n")
    return 2


def _pages(guide: Guide) -> int:
    """The page opened and closed, in mid-answer, too, while rows come."""
    for _ in range(30):
        with urllib.request.urlopen(guide.url, timeout=10) as page:
            page.read(100)  # and closed
        with urllib.request.urlopen(guide.url + "state", timeout=10) as state:
            json.loads(state.read())
    host, port = guide.url.removeprefix("http://").strip("/").split(":")
    for _ in range(30):
        with socket.create_connection((host, int(port)), timeout=10) as line:
            line.sendall(b"GET /state HTTP/1.1\r\nHost: x")  # no end
    guide.append(b"\n".join(guide.some(1)) + b"\n")
    return 1


def _by_input(guide: Guide) -> int:
    """A row on standard input between rows of a file."""
    assert guide.child.stdin is not None
    guide.child.stdin.write(guide.some(1)[0] + b"\n")
    guide.child.stdin.flush()
    return 1


ATTACKS: dict[str, Callable[[Guide], int]] = {
    "driver killed in mid-line": _killed_in_mid_line,
    "a line in three pieces": _slow_line,
    "table swapped whole": _swapped,
    "table rotated": _rotated,
    "other line ends": _other_system,
    "cut off, and whole again": _cut_off,
    "page closed and opened": _pages,
    "a row on standard input": _by_input,
}


def _begun(folder: Path, n: int) -> Guide:
    """The command on a table that is not there yet."""
    simulated(folder, n)
    lines = (folder / "measurements.csv").read_bytes().splitlines()
    (folder / "measurements.csv").unlink()
    return Guide(folder, lines)


def attacks(rounds: int) -> bool:
    """Each attack in turn, some rounds of it; every row is answered once."""
    good = True
    with tempfile.TemporaryDirectory() as name:
        guide = _begun(Path(name), 40 + 20 * rounds)
        guide.append(guide.lines[0] + b"\n" + b"\n".join(guide.some(20)) + b"\n")
        expected = 20
        guide.wait(expected)
        for _ in range(rounds):
            for title, attack in ATTACKS.items():
                expected += attack(guide)
                seconds = guide.wait(expected)
                time.sleep(0.5)  # what is too much comes late
                rows = guide.answered()
                well = rows == list(range(2, 2 + expected)) and guide.child.poll() is None
                good &= well
                print(
                    f"{title:28s} rows {len(rows)} of {expected} {'' if well else 'WRONG':5s} "
                    f"{seconds:6.1f} s {guide.memory() / MEGA:6.0f} MB",
                    flush=True,
                )
                if guide.child.poll() is not None:
                    return False
        guide.end()
    return good


def long(n: int) -> bool:
    """Many rows in a session that is not let stop: memory at each thousand, and how long the last ones take."""
    from aridcal.files.campaign import load_campaign, nominal_robot
    from aridcal.jobs.guide.session import session

    with tempfile.TemporaryDirectory() as name:
        simulated(Path(name), n + SINGLE)
        campaign = load_campaign(Path(name) / "campaign.yaml")
        lines = (Path(name) / "measurements.csv").read_bytes().splitlines()
        now = session(campaign, nominal_robot(campaign), None)
    now.table.add(lines[0])
    told, at_half, took = 0, 0.0, []
    while len(now.table.rows) < n + SINGLE:
        done = len(now.table.rows)
        more = lines[1 + done : 1 + (min(done + BATCH, n) if done < n else done + 1)]
        new = [k for line in more for k in now.table.add(line)]
        begun = time.perf_counter()
        now.stopped = False
        told += sum(isinstance(event, RowRead) for event in now.taken(new))
        seconds = time.perf_counter() - begun
        took += [seconds] if len(new) == 1 else []
        if (done + len(new)) % 1000 == 0:
            print(
                f"{done + len(new)} rows: {_resident('self') / MEGA:.0f} MB, the last {len(new)} took {seconds:.1f} s",
                flush=True,
            )
        at_half = at_half or (_resident("self") if done + len(new) >= n // 2 else 0.0)
    grown = _resident("self") / at_half
    well = told >= n + SINGLE and grown < GROWS
    print(
        f"a row at the end: {sorted(took)[SINGLE // 2]:.2f} s; memory over that at the half: {grown:.2f} "
        f"{'' if well else 'WRONG'}"
    )
    return well


def at_once(n: int) -> bool:
    """The command begun on a table with many rows."""
    with tempfile.TemporaryDirectory() as name:
        guide = _begun(Path(name), n)
        guide.append(guide.lines[0] + b"\n" + b"\n".join(guide.some(n)) + b"\n")
        seconds = guide.wait(n)
        well = guide.answered() == list(range(2, 2 + n))
        print(f"{n} rows at once: {seconds:.1f} s, {guide.memory() / MEGA:.0f} MB {'' if well else 'WRONG'}")
        guide.end()
    return well


def clock(hours: float) -> bool:
    """Hours by the clock: rows come at equal times, the page asks as an open one does."""
    with tempfile.TemporaryDirectory() as name:
        guide = _begun(Path(name), DAY_ROWS)
        guide.append(guide.lines[0] + b"\n")
        begun, asked, memory, slowest = time.monotonic(), 0, [], 0.0
        for n in range(1, DAY_ROWS + 1):
            guide.append(guide.some(1)[0] + b"\n")
            took = guide.wait(n)
            slowest = max(slowest, took if n > 1 else 0.0)  # the first one waits for the program to begin
            while time.monotonic() - begun < n * hours * HOUR / DAY_ROWS and guide.child.poll() is None:
                with urllib.request.urlopen(guide.url + f"state?have={asked}", timeout=10) as state:
                    state.read()
                asked += 1
                time.sleep(PAGE_ASKS)
            if n % (DAY_ROWS // QUARTERS) == 0 and guide.child.poll() is None:
                memory.append(guide.memory())
                print(
                    f"{(time.monotonic() - begun) / HOUR:.2f} h, {n} rows, page asked {asked} times: "
                    f"{memory[-1] / MEGA:.1f} MB, slowest answer {slowest:.2f} s",
                    flush=True,
                )
        rows = guide.answered()
        guide.end()
    return rows == list(range(2, 2 + DAY_ROWS)) and len(memory) == QUARTERS and memory[-1] < GROWS * memory[0]


def looks(hours: float) -> bool:
    """All looks of so many hours one after another, and what the page asks between them."""
    from aridcal.files.campaign import load_campaign, nominal_robot
    from aridcal.jobs.guide.session import session
    from aridcal.runs.guide_server import Board, GuideServer
    from aridcal.runs.guided_campaign import LOOK_EVERY, Incoming, followed

    every = round(hours * HOUR / LOOK_EVERY)
    done, memory = 0, []
    with tempfile.TemporaryDirectory() as name:
        simulated(Path(name), DAY_ROWS)
        campaign = load_campaign(Path(name) / "campaign.yaml")
        (table,) = campaign.measurements.files
        lines = table.read_bytes().splitlines(keepends=True)
        table.write_bytes(lines[0])
        incoming, board = Incoming(), Board("a day", None, str(table))
        server = GuideServer(board, incoming)

        def pause(_: float) -> None:
            nonlocal done
            done += 1
            if done * LOOK_EVERY % PAGE_ASKS < LOOK_EVERY:
                with urllib.request.urlopen(server.url + "state", timeout=10) as state:
                    state.read()
            if done % (every // DAY_ROWS) == 1 and done // (every // DAY_ROWS) < DAY_ROWS:
                with table.open("ab") as file:
                    file.write(lines[1 + done // (every // DAY_ROWS)])
            if done % (every // QUARTERS) == 0:
                memory.append(_resident("self"))
                print(f"{done} looks: {memory[-1] / MEGA:.1f} MB", flush=True)
            if done == every:
                incoming.lines.put("stop")

        told = 0
        for events in followed(session(campaign, nominal_robot(campaign), None), incoming, pause):
            board.note(events)
            told += sum(isinstance(event, RowRead) for event in events)
    print(f"{told} of {DAY_ROWS} rows answered")
    return told == DAY_ROWS and len(memory) == QUARTERS and memory[-1] < GROWS * memory[0]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("attacks", "long", "looks", "clock", "all"), default="all")
    parser.add_argument(
        "count", nargs="?", type=float, help="rounds of attacks (3), rows of the long run (5000), hours (8)"
    )
    arguments = parser.parse_args()
    count = 0.0 if arguments.what == "all" else arguments.count or 0.0
    good = True
    if arguments.what in ("attacks", "all"):
        good &= attacks(int(count) or 3)
    if arguments.what in ("long", "all"):
        good &= long(int(count) or 5000)
        good &= at_once(int(count) or 5000)
    if arguments.what in ("looks", "all"):
        good &= looks(count or 8)
    if arguments.what == "clock":
        good &= clock(count or 8)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
