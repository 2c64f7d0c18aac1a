"""What a proposed campaign says and why: the guesses, and the questions that the evidence leaves open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from aridcal.robot.chain import Robot

# Asks a question with its possible answers, the likeliest first, and why; returns the answer's number, None
# without.
Choose = Callable[[str, Sequence[str], str], int | None]


@dataclass(frozen=True)
class Guess:
    """One thing that a campaign says, and why.

    Attributes:
        key: Where it stands in the campaign, ``measurements.units`` for instance; without a dot: a mere remark.
        value: What stands there; None: nothing, the default holds.
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


@dataclass
class Proposal:
    """What was found in a URDF and a table, in the order in which it was found.

    Attributes:
        robot: The chain whose joints have columns.
        guesses: What the campaign says, and why.
    """

    robot: Robot
    guesses: list[Guess] = field(default_factory=list)

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


def nobody(question: str, answers: Sequence[str], why: str) -> None:
    """Leaves every question open: the likeliest answer is taken, and said to be a guess."""
