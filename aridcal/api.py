"""The Python face: propose a campaign, calibrate, load.

Example:
    campaign = aridcal.propose("robot.urdf", table)
    cal = aridcal.calibrate(campaign)
    poses = cal.predict(queries)
    cal.save("results")
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from rich.console import Console

from aridcal.calibration import Calibration
from aridcal.errors import AridcalError
from aridcal.init import tell
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.tables import AnyTable
from aridcal.prepare.campaign_text import draft
from aridcal.prepare.guesses import nobody
from aridcal.prepare.other_readings import refuse_misread
from aridcal.result.pipeline import identify
from aridcal.result.saved_model import SavedModel
from aridcal.result.saving import calibration
from aridcal.showing import working

__all__ = ["AridcalError", "Calibration", "Campaign", "calibrate", "load", "propose"]


def propose(urdf: str | Path, measurements: AnyTable | Sequence[AnyTable]) -> Campaign:
    """Propose a campaign by looking at a URDF and at measurements, and print what was found and what was guessed.

    Nothing is asked and nothing is written: where the data leave a choice, the likeliest is taken and said to be
    guessed. ``print(campaign)`` shows the campaign as a file, every choice with its reason.

    Args:
        urdf: The nominal robot.
        measurements: Measured poses as a DataFrame or the path of a csv or parquet file, or several of them.

    Returns:
        The campaign, for :func:`calibrate`.

    Raises:
        AridcalError: what in the tables or the URDF needs mending first.
    """
    tables = [measurements] if isinstance(measurements, str | Path | pd.DataFrame) else list(measurements)
    proposed = draft(Path(urdf).absolute(), tables, Path.cwd() / "campaign.yaml", nobody)
    title = ", ".join(file.name for file in proposed.rows.files)
    tell(proposed, title, Console(force_jupyter=False))
    return proposed.campaign


def calibrate(campaign: str | Path | Campaign, seed: int = 0) -> Calibration:
    """Identify what is wrong with the robot. Nothing is written; terminals and notebooks show the progress.

    Args:
        campaign: ``campaign.yaml``, or what :func:`propose` gave.
        seed: Of the split into train and test, where the table has none.

    Raises:
        AridcalError: whatever in the input needs mending.
    """
    job = campaign if isinstance(campaign, Campaign) else Path(campaign)
    with working() as progress:
        outcome = identify(job, seed, progress=progress, judge=refuse_misread)
    return Calibration(calibration(outcome), outcome)


def load(path: str | Path) -> Calibration:
    """Read a calibration that was saved.

    Args:
        path: A result folder, or the ``calibration.yaml`` in it.

    Raises:
        AridcalError: it is not there, or not a calibration of this format.
    """
    path = Path(path)
    saved = SavedModel.load(path)
    return Calibration(saved, folder=path if path.is_dir() else path.parent)
