"""Awkward tables: what `aridcal init` makes of files as people and programs write them.

Every file is written from a known truth, proposed by `init` with nobody to ask, and read again by what `init` wrote alone, as
`identify` reads it. `right`: every row that should be read is, to the rounding of what is written. `asked`: an error that says
what to mend or to answer, or a reading that the campaign itself calls a guess that does not fit (MUCH). Anything else is `wrong`.

Example:
    python benchmarks/awkward.py            # all; the exit status is 1 if one is wrong, or not what is expected
    python benchmarks/awkward.py motive     # those whose name holds that word
"""

from __future__ import annotations

import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from awkward_hostile import CASES
from awkward_tables import ASKED, RIGHT, Case, Truth, truth
from scipy.spatial.transform import Rotation

from aridcal.files.campaign import load_campaign
from aridcal.files.read import load_measurements
from aridcal.jobs.prepare.campaign_text import draft
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.system.errors import AridcalError

WRONG = "wrong"


@cache
def known(arm: str) -> Truth:
    return truth(arm)


def judged(case: Case, folder: Path) -> tuple[str, str]:
    """What came of a file: right, asked or wrong, and in words."""
    t = known(case.arm)
    path = folder / case.name
    path.write_bytes(case.write(t))
    out = folder / f"{case.name}.campaign.yaml"
    try:
        made = draft(t.urdf, [path], out, leave_open)
        out.write_text(made.campaign.text, encoding="utf-8")
        robot = made.proposal.robot
        rows = load_measurements(load_campaign(out), robot.readings, robot.limits, robot.kinds)
    except AridcalError as problem:
        said = str(problem).replace(str(folder) + "/", "")
        return ASKED, said
    if "MUCH" in made.campaign.text:
        return ASKED, "the campaign says that no reading fits, and what to check"
    read = rows.select(rows.as_read)
    keep = np.arange(len(t.q)) if case.rows is None else case.rows(len(t.q))
    if read.readings.shape != t.q[keep].shape:
        return WRONG, f"{len(read)} rows of {read.readings.shape[1]} joints read, {len(keep)} are there"
    off = [np.abs(read.readings - t.q[keep]).max(), np.abs(read.position - t.p[keep]).max()]
    if case.pose:
        if read.rotation is None:
            return WRONG, "the orientation is not read"
        off.append((Rotation.from_matrix(read.rotation) * t.R[keep].inv()).magnitude().max())
    if max(off) > case.off:
        return WRONG, f"off by {max(off):.2g}"
    table = [guess.why for guess in made.proposal.guesses if guess.key == "measurements.table"]
    return RIGHT, "; ".join(table) or "plain csv"


def main() -> int:
    """Judge all files, print a table; 1 if one is wrong or not as expected."""
    words = sys.argv[1:]
    counts = {RIGHT: 0, ASKED: 0, WRONG: 0}
    surprises = 0
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            if words and not any(word in case.name for word in words):
                continue
            found, why = judged(case, Path(folder))
            counts[found] += 1
            surprises += found != case.expected
            mark = "" if found == case.expected else f" (expected {case.expected})"
            print(f"| {case.about} | {found}{mark} | {why if len(why) < 400 else why[:399] + '…'} |", flush=True)
    print(f"{counts[RIGHT]} right, {counts[ASKED]} asked, {counts[WRONG]} wrong; {surprises} not as expected")
    return int(counts[WRONG] > 0 or surprises > 0)


if __name__ == "__main__":
    sys.exit(main())
