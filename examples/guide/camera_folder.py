"""A template, not run on hardware: a camera that writes images into a folder; `aridcal detect` runs when one arrives.

    python camera_folder.py images joints.csv corners.csv camera.yaml      # in one terminal
    aridcal guide campaign.yaml                                            # in another: its table is corners.csv

Whoever moves the arm appends a row to joints.csv for each image: `image` and the joints. The lens must be known beforehand
(camera.yaml, which `aridcal detect` writes from twenty images): corners of earlier images then stay as they are.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

LOOK_EVERY = 0.5  # [s]


def main(images: Path, joints: Path, corners: Path, camera: Path) -> None:
    """Detect anew whenever there is another image with its joints; the table is swapped whole."""
    done: tuple[object, ...] = ()
    while True:
        there = (sorted(path.name for path in images.iterdir()), joints.stat().st_mtime_ns if joints.exists() else 0)
        if there != done and all(there):
            command = ["aridcal", "detect", images, "--joints", joints, "--intrinsics", camera, "-o", corners]
            if subprocess.run([str(word) for word in command]).returncode == 0:
                done = there
        time.sleep(LOOK_EVERY)


if __name__ == "__main__":
    main(*(Path(word) for word in sys.argv[1:5]))
