"""New rows for a calibration that is there already: read as its own campaign's tables are, with the noise that it knows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aridcal.errors import CampaignError, MeasurementError
from aridcal.inputs.approach import with_directions
from aridcal.inputs.campaign import Campaign
from aridcal.inputs.dataset import Dataset
from aridcal.inputs.instrument_settings import InstrumentSettings
from aridcal.inputs.read import load_measurements
from aridcal.inputs.tables import AnyTable
from aridcal.instruments.channels import Channels, spread
from aridcal.result.saved_model import SavedModel

FEWEST = 3
"""Rows below which nothing is said: two poses cannot tell a turn of the base from one of a joint."""

MOST = 200
"""Rows beyond which `aridcal identify` is the better answer; the matrices here grow with the square of the rows."""

LEAST = 1e-6
"""[m] and [rad] of noise that no row has less of: no arm repeats to a micrometre, and exact rows, of a simulation for instance,
would make matrices that no computer solves beside changes of metres."""


@dataclass(frozen=True)
class Noise:
    """What the rows' noise is known to be.

    Attributes:
        sigma: Of each channel per axis, shape (C,), [m] and [rad].
        freedom: Numbers that each was estimated from, shape (C,); infinite where it was declared.
    """

    sigma: np.ndarray
    freedom: np.ndarray

    def of_numbers(self, channels: Channels) -> np.ndarray:
        """Sigma of each number of a row, shape (m,)."""
        return spread(self.sigma, channels)

    def freedom_of(self, channels: Channels) -> float:
        r"""Degrees of freedom of a mean square over all channels: :math:`n^2 / \sum_c n_c^2 / \nu_c` (Satterthwaite 1946)."""
        size = np.array([channel.size for channel in channels], dtype=float)
        return float(size.sum() ** 2 / max(float(np.sum(size**2 / self.freedom)), 1e-12))


def read_new_rows(saved: SavedModel, table: AnyTable) -> Dataset:
    """Read new rows of a calibrated robot in the columns and units of its own campaign.

    Args:
        saved: The calibration.
        table: Rows with a pose, or a position where the calibration is from positions.

    Raises:
        CampaignError: the calibration does not say how its tables are written, or has several targets.
        MeasurementError: the table cannot be read, lacks columns, or has too few or too many rows.
    """
    robot = saved.final.model.robot
    if saved.frames_by == "target":
        raise CampaignError(
            "this calibration has several targets, which few rows cannot check; run `aridcal identify` with all rows"
        )
    rows = load_measurements(
        _campaign(saved), robot.readings, robot.limits, robot.kinds, files=[table], require_pose=True, fitted=False
    )
    rows = with_directions(replace(rows, blocks=(), target=None))
    why = "" if len(rows) <= MOST else f"; more than {MOST} are a campaign of their own: `aridcal identify`"
    if len(rows) < FEWEST or why:
        raise MeasurementError(
            f"{rows.title}: {len(rows)} usable rows: 5 to 20 in attitudes that differ are asked for{why}"
        )
    return rows


def _campaign(saved: SavedModel) -> Campaign:
    """The calibration's campaign for rows of its target; what other instruments measured is left out."""
    if saved.campaign is None:
        raise CampaignError(
            "calibration.yaml holds no campaign, so that nobody knows its tables' columns and units; run "
            "`aridcal identify` again"
        )
    changes = {"listed": (), "measurements": saved.measurements, "instruments": InstrumentSettings()}
    return saved.campaign.model_copy(update=changes)


def known_noise(saved: SavedModel, rows: Dataset) -> Noise:
    """Noise of new rows: what they state of it themselves, else what the calibration's own rows scattered by."""
    count = len(rows.channels)
    if saved.measurements.noise.rows == "absolute" and rows.relative is not None:
        return Noise(np.maximum(rows.declared(np.ones(count)), LEAST), np.full(count, np.inf))
    sigma, freedom = saved.scatter
    return Noise(np.maximum(sigma[:count], LEAST), np.array(freedom[:count]))
