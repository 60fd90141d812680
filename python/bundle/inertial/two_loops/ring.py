"""A bounded queue between two threads that never blocks either."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from bundle.interface.option_fields import number

__all__ = ["Ring"]

Record = TypeVar("Record")


class Ring(Generic[Record]):
    """The newest records of a thread for another: a full ring forgets its oldest.

    One thread puts, one takes. Both use single operations of ``collections.deque``, which the
    interpreter does not interrupt: there is no lock that one could hold while the other is due.

    Args:
        capacity: largest number of records.

    Raises:
        InputError: it is no whole number above 0.
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
        """Records that were forgotten before anybody took them, as far as takes have shown."""
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
        """Return the newest record and forget the others; None where there is none."""
        taken = self.take_all()
        return taken[-1] if taken else None
