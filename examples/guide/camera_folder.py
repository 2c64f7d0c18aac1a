"""A template, not run on hardware: an arm moved by hand and a camera that saves images to a folder, led by `aridcal guide`.

    python camera_folder.py campaign.yaml images/

The campaign's kind is `pixels`, its camera is called `eye`; its lens and the board are known (`aridcal detect`, `aridcal print`).
Whenever an image arrives, `aridcal detect` finds the corners in it.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import aridcal

LOOK_EVERY = 0.2  # [s]
BOARD = ["--board", "charuco"]  # as for `aridcal detect`
STILL = 1.0  # [s] that a file does not grow: it is whole


def next_image(folder: Path, seen: set[Path]) -> Path:
    """Wait for an image that was not there before, until it is whole."""
    while True:
        new = {path for path in folder.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg")} - seen
        if new:
            path = min(new, key=lambda path: path.stat().st_mtime)
            if time.time() - path.stat().st_mtime > STILL:
                seen.add(path)
                return path
        time.sleep(LOOK_EVERY)


def corners(image: Path, shot: int) -> list[dict[str, float | str]]:
    """Rows of an image, by column; none where the board is not seen."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "corners.csv"
        answer = subprocess.run(["aridcal", "detect", str(image), *BOARD, "-o", str(table), "--quiet"], check=False)
        if answer.returncode or not table.exists():
            return []
        with table.open(newline="") as file:
            return [
                {
                    "camera": row["camera"],
                    "marker": row["marker"],
                    "u": float(row["u"]),
                    "v": float(row["v"]),
                    "shot": str(shot),
                }
                for row in csv.DictReader(file)
            ]


def joints() -> dict[str, float]:
    """Readings of the moment in the campaign's units, by joint; replace it by your robot's own."""
    raise NotImplementedError("the joints as they are, not as they were asked for")


def main(campaign: str, folder: Path) -> None:
    """Say where to go, wait for the image, record its corners; until it is enough."""
    guided = aridcal.guide(campaign, tolerance="0.5mm")
    seen = set(folder.iterdir())
    for shot, pose in enumerate(guided, start=1):
        print(pose.why, dict(pose.joints))
        rows, here = corners(next_image(folder, seen), shot), joints()
        if not rows:
            print("the board is not seen: another pose")
            pose.reject()
            continue
        for alarm in pose.record([{**here, **row} for row in rows]):
            print(alarm.what.upper(), alarm.words, "Do:", alarm.do)
    aridcal.calibrate(guided.campaign).save("results")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
