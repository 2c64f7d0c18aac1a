"""The words on a proposed campaign."""

from __future__ import annotations

import itertools

from aridcal.jobs.prepare.campaign_text import Draft, scalar
from aridcal.system.progress import SHOWN_REMARKS, Screen


def print_proposal(proposed: Draft, title: str, console: Screen) -> None:
    """Print findings and guesses of a proposal, and the number of usable rows."""
    by_reason = itertools.groupby(proposed.proposal.guesses, key=lambda guess: (guess.why, guess.sure))
    for (why, sure), group in by_reason:
        entries = [guess.name if guess.value is None else f"{guess.name} = {scalar(guess.value)}" for guess in group]
        console.print("[green]found  [/green]" if sure else "[yellow]guessed[/yellow]", end="  ")
        console.say(f"{', '.join(entries)}: {why}")
    rows = proposed.rows
    for remark in (*rows.origin.refused, *rows.origin.notices)[:SHOWN_REMARKS]:
        console.say(f"note     {remark}")
    summary = f"{title}: {len(rows)} usable rows, {len(rows.origin.refused)} refused"
    console.say(summary)
