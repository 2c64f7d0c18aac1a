"""A proposal whose table was not read as it was written: the reading that fits is offered beside it, by its number."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from pydantic import BaseModel

from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign
from aridcal.files.measurement_settings import MeasurementSettings
from aridcal.jobs.prepare.campaign_proposal import STRANGE_SHARE
from aridcal.jobs.prepare.guesses import Chooser, Guess, Proposal
from aridcal.jobs.prepare.other_readings import better_reading

READING = "reading"
"""Key of the question."""

OF_A_READING = ("joints", "columns", "units", "orientation", "inverted")
"""Keys under `measurements` in which readings differ."""


def mended(proposal: Proposal, campaign: Campaign, rows: Dataset, asker: Chooser) -> Proposal:
    """The proposal as it is, or with the reading that fits far better, as somebody chooses.

    Args:
        proposal: Judged by the nominal robot.
        campaign: As the proposal says.
        rows: The measurements as it reads them.
        asker: Asked where another reading fits.

    Raises:
        Unanswered: nobody answered; naming the choices.
    """
    if proposal.fit is None or proposal.fit[1] <= STRANGE_SHARE:
        return proposal
    better = better_reading(campaign, proposal.robot, rows, None)
    if better is None:
        return proposal
    answers = [f"{better.other.what}: {better.after} per axis off", f"as it stands: {better.before} off"]
    why = f"as it stands the {better.whose} robot misses the targets by far"
    if asker.pick(READING, "how is the table to be read", answers, why):
        return proposal
    keys = _changed(campaign.measurements, better.other.settings)
    said = f"as was answered: {better.other.what}, {better.after} per axis off the {better.whose} robot"
    kept = [guess for guess in proposal.guesses if _stands(guess, keys)]
    new = [Guess(f"measurements.{key}", value, said) for key, value in keys.items() if key != "columns"] + [
        Guess(f"measurements.columns.{name}", column, said) for name, column in keys.get("columns", {}).items()
    ]
    return replace(proposal, guesses=[*kept, *new], fit=None)


def _stands(guess: Guess, keys: dict[str, Any]) -> bool:
    """True of a guess that another reading leaves as it is: neither replaced by it, nor a mere doubt of the first one."""
    section, _, name = guess.key.rpartition(".")
    if section == "measurements.columns":
        return name not in keys.get("columns", {})
    return name not in keys and (guess.value is not None or guess.sure)


def _changed(before: MeasurementSettings, after: MeasurementSettings) -> dict[str, Any]:
    """Keys in which two readings differ, as the second has them."""
    return {key: _plain(getattr(after, key)) for key in OF_A_READING if getattr(after, key) != getattr(before, key)}


def _plain(value: Any) -> Any:
    """A setting as a campaign writes it."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_defaults=True)
    return {name: _plain(each) for name, each in value.items()} if isinstance(value, dict) else value
