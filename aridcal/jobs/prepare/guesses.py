"""What a proposed campaign says and why: the guesses, and the questions that the evidence leaves open."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from aridcal.engine.robot.chain import Robot
from aridcal.system.errors import AridcalError, CampaignError, nearest

# Asks a question with its possible answers, the likeliest first, and why; returns the answer's number, None
# without.
Choose = Callable[[str, Sequence[str], str], int | None]


OF_TARGETS = "instruments.targets."
"""Keys of questions that are asked of each label."""


OF_SEVERAL_KEYS = ("reading",)
"""Keys of questions whose answer is no single key of a campaign."""


@dataclass(frozen=True)
class Guess:
    """One thing that a campaign says, and why.

    Attributes:
        key: Its place in the campaign, ``measurements.units`` for instance; without a dot: a mere remark.
        value: Of the key; None: the key is not written, the default holds.
        why: The evidence.
        sure: False if a person should look at it.
    """

    key: str
    value: Any
    why: str
    sure: bool = True

    @property
    def name(self) -> str:
        """The last word of the key."""
        return self.key.rpartition(".")[2]


class OpenChoice(AridcalError):
    """The data leave a choice that changes every number, and nobody was there to make it."""


@dataclass(frozen=True)
class Chooser:
    """Makes choices that the data leave open.

    Attributes:
        choose: Asks a person.
        settled: Numbers of answers that were given beforehand, by the key of the question.
        drafts: Whether the answers become part of a campaign.
    """

    choose: Choose
    settled: Mapping[str, int] = field(default_factory=dict)
    drafts: bool = True

    def pick(self, key: str, question: str, answers: Sequence[str], why: str) -> int:
        """The number of the answer, from 0, to a question that must not be guessed.

        Args:
            key: Of the campaign, below ``measurements`` unless it begins with ``robot.`` or ``instruments.``.
            question: Without its mark.
            answers: The likeliest first.
            why: What is the matter.

        Raises:
            Unanswered: nobody answered; naming the key and the choices.
            CampaignError: an answer that was given beforehand is none of these.
        """
        settled = self.settled.get(key)
        if settled is not None:
            if not 1 <= settled <= len(answers):
                raise CampaignError(f"--set {key}={settled}: should be from 1 to {len(answers)}: {_numbered(answers)}")
            return settled - 1
        answer = self.choose(question, answers, why)
        if answer is None:
            place = key if key.startswith(("robot.", "instruments.")) else f"measurements.{key}"
            becomes = f"This becomes `{place}`. " if self.drafts and key not in OF_SEVERAL_KEYS else ""
            raise OpenChoice(
                f"{question}? {why[:1].upper()}{why[1:]}. {becomes}Run this again with "
                f"`--set {key}=NUMBER`: {_numbered(answers)}"
            )
        return answer

    def check(self, names: Sequence[str]) -> None:
        """Refuse answers to questions that are never asked.

        Args:
            names: Keys of all questions that there are.

        Raises:
            CampaignError: naming it.
        """
        for key in self.settled:
            if key not in names and not key.startswith(OF_TARGETS):
                raise CampaignError(f"--set {key}: nothing of that name is ever asked{nearest(key, names)}")


def _numbered(answers: Sequence[str]) -> str:
    return "; ".join(f"{number} = {answer}" for number, answer in enumerate(answers, start=1))


@dataclass
class Proposal:
    """A proposed campaign: guesses from a URDF and a table, in the order in which they were made.

    Attributes:
        robot: The chain whose joints have columns.
        guesses: What the campaign says, and why.
        fit: Median distance of the targets from the nominal robot's, [m] and as a share of their spread; None: not judged.
    """

    robot: Robot
    guesses: list[Guess] = field(default_factory=list)
    fit: tuple[float, float] | None = None

    def add_units(self, columns: dict[str, str], why: str) -> None:
        """Say units of single columns, beside those of the table."""
        for k, guess in enumerate(self.guesses):
            if guess.key == "measurements.units":
                value = guess.value or {}
                units = {**value, "columns": {**value.get("columns", {}), **columns}}
                self.guesses[k] = Guess(guess.key, units, f"{guess.why}; {why}", guess.sure)
                return
        self.say("measurements.units", {"columns": columns}, why)

    def say(self, key: str, value: Any, why: str, sure: bool = True) -> None:
        """Add a guess."""
        self.guesses.append(Guess(key, value, why, sure))

    def say_columns(self, columns: dict[str, str], why: str, sure: bool = True) -> None:
        """Add the columns of joints or quantities; those that have their own name need no entry."""
        for quantity, column in columns.items():
            entry = None if column == quantity else column
            self.say(f"measurements.columns.{quantity}", entry, why, sure)


def ask(choose: Choose, question: str, answers: Sequence[str], why: str) -> tuple[int, bool]:
    """The answer's number, the first if nobody answers, and whether somebody did."""
    answer = choose(question, answers, why)
    return answer or 0, answer is not None


def leave_open(question: str, answers: Sequence[str], why: str) -> None:
    """Leaves every question open: what changes no number is guessed and said to be, and all else is an error."""
