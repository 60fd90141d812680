"""Bounded queue between two threads that never blocks either."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from bundle.interface.option_fields import number

Record = TypeVar("Record")


class Ring(Generic[Record]):
    """Queue of the newest records of one thread for another.

    A full ring discards its oldest record.

    One thread puts, one takes. Both use single operations of ``collections.deque``, which the
    interpreter does not interrupt. No lock can therefore delay a thread with a deadline.

    Args:
        capacity: largest number of records.

    Raises:
        InputError: capacity is not a whole number above 0.
    """

    def __init__(self, capacity: int = 64) -> None:
        size = number("Ring: capacity", capacity, whole=True, minimum=1)
        self._records: deque[tuple[int, Record]] = deque(maxlen=size)
        self._put = 0
        self._last_taken = 0
        self._lost = 0

    def __len__(self) -> int:
        return len(self._records)

    @property
    def num_lost(self) -> int:
        """Number of records discarded before they were taken, as known at the last take."""
        return self._lost

    def put(self, record: Record) -> None:
        """Append a record."""
        self._put += 1
        self._records.append((self._put, record))

    def take_all(self) -> list[Record]:
        """Return and remove the records, oldest first."""
        taken: list[Record] = []
        while True:
            try:
                place, record = self._records.popleft()
            except IndexError:
                return taken
            self._lost += place - self._last_taken - 1
            self._last_taken = place
            taken.append(record)

    def take_newest(self) -> Record | None:
        """Return the newest record and discard the others; None if the ring is empty."""
        taken = self.take_all()
        return taken[-1] if taken else None
