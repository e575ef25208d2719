"""Answers to requests already made, so that a repeated request is answered and not done again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from cut_service.waiting import Until

Answer = TypeVar("Answer")


@dataclass
class Entry(Generic[Answer]):
    """One request; `answer` is None while it is being worked on."""

    answer: Answer | None = None


class Ledger(Generic[Answer]):
    """Remembers the newest requests by their id; the oldest answered ones are forgotten first."""

    def __init__(self, capacity: int) -> None:
        self._entries: OrderedDict[str, Entry[Answer]] = OrderedDict()
        self._capacity = capacity

    def __len__(self) -> int:
        return len(self._entries)

    def open(self, request_id: str) -> tuple[Entry[Answer], bool]:
        """The entry of a request, and whether it is new.

        Who gets True must work on it and set the answer.
        """
        known = self._entries.get(request_id)
        if known is not None:
            return known, False
        entry: Entry[Answer] = Entry()
        self._entries[request_id] = entry
        answered = [key for key, e in self._entries.items() if e.answer is not None]
        for key in answered[: max(0, len(self._entries) - self._capacity)]:
            del self._entries[key]
        return entry, True

    async def once(
        self, request_id: str, work: Callable[[], Awaitable[Answer]], patience: float
    ) -> Answer | None:
        """The answer to a request, whose work is done only for the first with this id.

        Args:
            request_id: Of the request.
            work: Finds the answer, whatever goes wrong.
            patience: How long a repeat waits for the first one's answer [s].

        Returns:
            The answer; None: the first is still being worked on.
        """
        entry, is_new = self.open(request_id)
        if is_new:
            entry.answer = await work()
        else:
            await Until(lambda: entry.answer is not None, patience)
        return entry.answer
