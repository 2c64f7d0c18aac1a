"""Tasks done one after another in this process, and what every engine has in common with that."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class WorkFailure:
    """In place of an answer: the work itself failed, which it is not meant to.

    Attributes:
        why: In words.
    """

    why: str


class EngineGone(Exception):
    """What was to do the work is gone and does not come back; what was answered before stays."""


class Engine(Protocol):
    """Does work for each of many tasks."""

    def __call__(self, work: Callable[[T], R], tasks: Mapping[str, T]) -> Iterator[tuple[str, R | WorkFailure]]:
        """Give each task's answer as soon as it is there.

        Args:
            work: To be done; a task that fails raises, and costs no other one its answer.
            tasks: By a name that is its own wherever the same engine works.

        Raises:
            EngineGone: before all is answered.
        """


def run_tasks(work: Callable[[T], R], tasks: Mapping[str, T]) -> Iterator[tuple[str, R | WorkFailure]]:
    """Do one task after another in this process."""
    for name, task in tasks.items():
        try:
            answer: R | WorkFailure = work(task)
        except Exception as problem:
            answer = WorkFailure(in_words(problem))
        yield name, answer


def in_words(problem: BaseException) -> str:
    """What is said of an error that nobody foresaw."""
    return f"{type(problem).__name__}: {problem}" if str(problem) else type(problem).__name__
