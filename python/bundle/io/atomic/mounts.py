"""Places where another file system, or another part of one, is mounted."""

from __future__ import annotations

import os
import re
from pathlib import Path

__all__ = ["mount_points"]

_TABLE = Path("/proc/self/mountinfo")


def mount_points() -> frozenset[Path]:
    """Return where something is mounted, bind mounts and mounted files included.

    Renaming does not work across these, nor onto them. Empty where the system does not tell.

    Format: proc_pid_mountinfo(5); the fifth column, with odd characters as octal escapes.
    """
    try:
        lines = _TABLE.read_bytes().splitlines()
    except OSError:
        return frozenset()
    columns = (line.split()[4] for line in lines if len(line.split()) > 4)
    return frozenset(
        Path(os.fsdecode(re.sub(rb"\\([0-7]{3})", lambda m: bytes([int(m[1], 8)]), name)))
        for name in columns
    )
