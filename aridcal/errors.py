"""What can go wrong through no fault of the code: every error a user can cause, and what to do about it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


class AridcalError(Exception):
    """Bad input or use. The message names the culprit and the remedy; commands print it and exit with status 2."""


class CampaignError(AridcalError):
    """A settings file (campaign, scenario, head) cannot be used as it stands."""


class RobotError(AridcalError):
    """A URDF cannot be read, or the chain asked for is not in it."""


class MeasurementError(AridcalError):
    """A table of measurements cannot be read, or nothing usable is left of it."""


class NotOfThisRobot(MeasurementError):
    """Measurements that no constants of this robot explain: of another robot, or not read as they were written."""


class CovariateNotFound(AridcalError):
    """An effect depends on a column that was not measured."""


class OutputError(AridcalError):
    """Results cannot be written where they were asked for."""


class NotIdentifiable(AridcalError):
    """Some coefficients are confounded in these measurements."""

    def __init__(self, groups: Sequence[Sequence[str]]) -> None:
        self.groups = groups
        mixed = "; ".join(" with ".join(names) for names in groups)
        super().__init__(f"confounded: {mixed}. Fix one of each, or measure poses that separate them.")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint for a misspelt name: ``" (did you mean 'x'?)"``, or the known names, or nothing."""
    names = [str(k) for k in known]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if close:
        return f" (did you mean {close[0]!r}?)"
    return f" (known: {', '.join(names)})" if names else ""
