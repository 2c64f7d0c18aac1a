"""The same measurements in another order of rows, on other numbers of threads: which words of ``result.json`` differ.

Example:
    python benchmarks/determinism.py                # all
    python benchmarks/determinism.py timed untimed  # some of them

- ``timed``: 4,000 simulated rows of the ARID with time and temperature, no column ``split``.
- ``untimed``: the same without either: the order of rows is all that tells when they were measured.
- ``ur10``: UR10 series B (public laser-tracker data, no time), every fifth row held out by a column ``split``.

Each table is calibrated by the command as it stands on one thread, and shuffled on two. Seconds, the numbers of lines and the
order of lists of rows are left out of the comparison; what then differs is printed. With ``time`` nothing may; without it, only
what is said of the order itself: reasons, and ``shift`` among the effects that are confounded with others.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

ROOT = Path(__file__).resolve().parents[1]

ROWS = 4000
"""Those that are not held out are more than the 2,000 from which the search looks at a part of them."""


def simulated(folder: Path, covariates: list[str]) -> tuple[dict[str, Any], pd.DataFrame]:
    """Simulate the shipped scenario with more rows, and some that are grossly wrong."""
    scenario = yaml.safe_load((ROOT / "identification/arid-undeclared/scenario.yaml").read_text())
    scenario["robot"]["urdf"] = str(ROOT / "urdf/arid.urdf")
    scenario["truth"] |= {"n": ROWS, "covariates": covariates, "outliers": {"share": 0.01, "size": 30}}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    made = folder / "made"
    subprocess.run(
        [sys.executable, "-m", "aridcal", "simulate", "scenario.yaml", "-o", str(made)], cwd=folder, check=True
    )
    campaign = yaml.safe_load((made / "campaign.yaml").read_text())
    return campaign, pd.read_csv(made / "measurements.csv", dtype=str, keep_default_na=False)


def timed(folder: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """Campaign and table of ``timed``."""
    return simulated(folder, ["time", "temperature"])


def untimed(folder: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """Campaign and table of ``untimed``."""
    return simulated(folder, [])


def ur10(_: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """Campaign and table of ``ur10``."""
    home = ROOT / "identification/ur10-laser-tracker"
    campaign = yaml.safe_load((home / "campaign-b.yaml").read_text())
    table = pd.read_csv(home / campaign["measurements"]["file"], dtype=str, keep_default_na=False)
    return campaign, table.assign(split=np.where(np.arange(len(table)) % 5 == 2, "test", "train"))


CASES: dict[str, Callable[[Path], tuple[dict[str, Any], pd.DataFrame]]] = {
    "timed": timed,
    "untimed": untimed,
    "ur10": ur10,
}


def identified(folder: Path, campaign: dict[str, Any], table: pd.DataFrame, threads: int) -> Any:
    """Run the command on a table in a folder of its own; ``result.json`` without places and seconds."""
    folder.mkdir()
    table.to_csv(folder / "measurements.csv", index=False)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(campaign))
    counts = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(threads))
    command = [sys.executable, "-m", "aridcal", "identify", "campaign.yaml"]
    subprocess.run(command, cwd=folder, env=os.environ | counts, check=True, stdout=subprocess.DEVNULL)
    text = (folder / "results" / "result.json").read_text()
    document = json.loads(re.sub(r'\b(lines?|rows?) \d+( and \d+)?|(?<="row": )\d+', "0", text))
    document["seconds"] = 0
    for rows in (document["notices"], document["n"]["refused"], document["n"]["outlier_rows"]):
        rows.sort(key=json.dumps)
    return document


def differences(a: Any, b: Any, where: str = "") -> Iterator[str]:
    """Places at which two documents differ, with both values."""
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        for key in a:
            yield from differences(a[key], b[key], f"{where}.{key}".lstrip("."))
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from differences(x, y, f"{where}[{k}]")
    elif a != b:
        yield f"  {where}: {json.dumps(a)} | {json.dumps(b)}"


def main() -> None:
    """Run the cases that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], help="default: all")
    for name in parser.parse_args().cases or CASES:
        with tempfile.TemporaryDirectory() as home:
            folder = Path(home)
            campaign, table = CASES[name](folder)
            campaign["robot"]["urdf"] = str(ROOT / "urdf" / Path(campaign["robot"]["urdf"]).name)
            campaign["measurements"]["file"] = "measurements.csv"
            shuffled = table.sample(frac=1, random_state=1)
            here = identified(folder / "here", campaign, table, 1)
            found = list(differences(here, identified(folder / "there", campaign, shuffled, 2)))
        print(f"{name}: {len(table)} rows, {len(here['effects'])} effects, {len(found)} differences", *found, sep="\n")


if __name__ == "__main__":
    main()
