"""Whether cameras move with the arm or stand beside it: the nominal robot fits one of both, and misses the other by far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aridcal.engine.fit.constants import station_labels
from aridcal.engine.fit.stages import nominal_sigma
from aridcal.engine.instruments.channels import PIXEL
from aridcal.engine.instruments.setup import TIP, WORLD
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign
from aridcal.jobs.prepare.guesses import Proposal
from aridcal.jobs.prepare.orientation_columns import CLEAR_RATIO
from aridcal.system.errors import AridcalError
from aridcal.system.wording import number

CAMERAS = "instruments.cameras"

IN_WORDS = {TIP: "moves with the arm", WORLD: "stands beside the arm"}

Tried = tuple[Campaign, Dataset]
"""A campaign that was proposed, and its rows."""


def best_side(proposal: Proposal, tried: Callable[[Proposal], Tried]) -> Proposal:
    """The proposal with its cameras on the side that fits, where that is clear; unchanged where no row is of a camera.

    Args:
        proposal: As names alone suggest.
        tried: Reads the measurements as a proposal says.
    """
    if not any(guess.key == CAMERAS for guess in proposal.guesses):
        return proposal
    sides = {on: _with_cameras(proposal, on) for on in (TIP, WORLD)}
    misses = {on: _miss(side, tried) for on, side in sides.items()}
    near, far = sorted(misses, key=lambda on: misses[on])
    if not CLEAR_RATIO * misses[near] < misses[far]:
        return proposal
    off = f"by {number(misses[far])} px" if np.isfinite(misses[far]) else "altogether"
    why = f"; it {IN_WORDS[near]}: so the nominal robot misses the marks by {number(misses[near])} px, else {off}"
    return _with_cameras(proposal, near, why)


def _with_cameras(proposal: Proposal, on: str, why: str = "") -> Proposal:
    """The proposal with every camera on one side, and why; its board is then on the other. Lenses nobody stated stay guesses."""
    guesses = [
        replace(
            guess,
            value={name: camera | {"on": on} for name, camera in guess.value.items()},
            why=guess.why.partition(";")[0] + why,
            sure=bool(why) and all("fx" in camera for camera in guess.value.values()),
        )
        if guess.key == CAMERAS
        else guess
        for guess in proposal.guesses
    ]
    return replace(proposal, guesses=guesses)


def _miss(proposal: Proposal, tried: Callable[[Proposal], Tried]) -> float:
    """By how much the nominal robot misses the marks, [px]; infinite where it cannot be placed at all."""
    try:
        campaign, rows = tried(proposal)
        sigma = nominal_sigma(campaign.question, proposal.robot, rows.fitted, station_labels(campaign.question, rows))
    except AridcalError:
        return np.inf
    return float(sigma[[channel.name for channel in rows.channels].index(PIXEL.name)])
