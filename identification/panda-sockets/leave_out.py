"""Hold out all rows of one place: writes the table with a column `split`, and a campaign beside it.

Example:
    python identification/panda-sockets/leave_out.py right /tmp/right
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[2] / "shared" / "data" / "panda-sockets"


def main(place: str, folder: Path) -> None:
    """Write `sockets.csv` and `campaign.yaml` into a folder."""
    rows = pd.read_csv(DATA / "sockets.csv", dtype=str)
    held_out = rows["point"].str.startswith(f"{place}/")
    if not held_out.any():
        raise SystemExit(f"there is no place {place!r}; there are {sorted({p.split('/')[0] for p in rows['point']})}")
    folder.mkdir(parents=True, exist_ok=True)
    rows.assign(split=held_out.map({True: "test", False: "train"})).to_csv(folder / "sockets.csv", index=False)
    campaign = (HERE / "campaign.yaml").read_text("utf-8")
    campaign = campaign.replace("../../../shared/data/panda-sockets/panda.urdf", str(DATA / "panda.urdf"))
    campaign = campaign.replace("../../../shared/data/panda-sockets/sockets.csv", "sockets.csv")
    (folder / "campaign.yaml").write_text(campaign, "utf-8")
    print(f"now run: aridcal identify {folder / 'campaign.yaml'}")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
