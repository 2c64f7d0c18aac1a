"""The cache of a search beside its sums of products: what was worked out of each solved set of effects."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

T = TypeVar("T")


class Answers:
    """Cache of answers by the state that a question is about and by the question; they go when the state goes.

    A state is told by which object it is: it never changes, and one that was put together anew has answers of its own.
    """

    def __init__(self) -> None:
        """Start without any."""
        self._of_states: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()

    def of(self, state: object) -> dict[Any, Any]:
        """All answers about a state, by their questions."""
        return self._of_states.setdefault(state, {})

    def once(self, state: object, question: Hashable, answer: Callable[[], T]) -> T:
        """The answer to a question about a state, computed at its first call alone."""
        answers = self.of(state)
        if question not in answers:
            answers[question] = answer()
        value: T = answers[question]
        return value
