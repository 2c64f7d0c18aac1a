"""Put the scenario of the humanoid's head into a folder, with the place of TALOS's URDF in the package example-robot-data.

Example:
    python identification/humanoid-head/make.py /tmp/talos
"""

from __future__ import annotations

import shutil
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

HERE = Path(__file__).parent
TALOS = "cmeel.prefix/share/example-robot-data/robots/talos_data/robots/talos_reduced.urdf"


def make(folder: Path) -> Path:
    """Write the scenario and its tables; returns the scenario's path."""
    try:
        urdf = Path(str(distribution("example-robot-data").locate_file(TALOS)))
    except PackageNotFoundError:
        sys.exit("TALOS is in the package example-robot-data: pip install example-robot-data")
    folder.mkdir(parents=True, exist_ok=True)
    for table in HERE.glob("*.csv"):
        shutil.copy(table, folder)
    text = (HERE / "scenario.yaml").read_text().replace("talos_reduced.urdf", str(urdf))
    (folder / "scenario.yaml").write_text(text)
    return folder / "scenario.yaml"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print(f"next: aridcal simulate {make(Path(sys.argv[1]))} -o {sys.argv[1]}")
