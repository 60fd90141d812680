"""Time in which this process was ready to run and had no core, because others used it.

Linux counts it for the calling thread (/proc/self/schedstat). Threads that have ended are not in
it, but their involuntary context switches are in the process's: each costs about a time slice.
"""

from __future__ import annotations

import resource
from pathlib import Path

from bundle.base.records import dataclass


@dataclass(frozen=True)
class Waiting:
    """Waiting of a process so far, or in an interval.

    Attributes:
        waiting: seconds of the calling thread; 0 if the system does not report it.
        preemptions: involuntary context switches of all threads.
    """

    waiting: float
    preemptions: int

    @staticmethod
    def now() -> Waiting:
        """Return the waiting since the start of the process."""
        try:
            text = Path("/proc/self/schedstat").read_text(encoding="ascii")
            seconds = 1e-9 * float(text.split()[1])
        except (OSError, ValueError, IndexError):
            seconds = 0.0
        return Waiting(seconds, resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw)


def waiting_since(before: Waiting) -> Waiting:
    """Return the waiting since an earlier value."""
    now = Waiting.now()
    return Waiting(
        max(now.waiting - before.waiting, 0.0), max(now.preemptions - before.preemptions, 0)
    )
