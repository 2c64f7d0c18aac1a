"""What was read of a campaign, and what was found in its images: without what reads images, which takes its time to load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign

if TYPE_CHECKING:
    import pandas as pd

CACHE = "fiducials.csv"
"""The file of all that is kept of images."""


@dataclass(frozen=True)
class Detections:
    """What was found in the images of a campaign.

    Attributes:
        fiducials: The cache: a line for each fiducial.
        mount: T_tip_camera as head.yaml has it, shape (4, 4).
        intrinsics: Of the camera, as head.yaml has them, shape (9,).
        size: Of its images, [px]: width and height.
        images: How many fiducials were found in now; of the others they were known.
    """

    fiducials: pd.DataFrame
    mount: np.ndarray
    intrinsics: np.ndarray
    size: tuple[int, int]
    images: int


@dataclass(frozen=True)
class CampaignRows:
    """The rows of a campaign, of whatever kind.

    Attributes:
        campaign: The job; of a measuring head its target is at the camera.
        rows: Its rows.
        detections: What was found in images; None where there are none.
    """

    campaign: Campaign
    rows: Dataset
    detections: Detections | None = None
