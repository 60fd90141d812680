"""Command lines of `mpirun -n N bundle`, for what starts processes from the outside."""

from __future__ import annotations

import os
import sys
from pathlib import Path

MPIRUN = Path(sys.executable).parent / "mpirun"


def mpirun_command(num_processes: int, *words: object) -> list[str]:
    """Return the line that runs `bundle WORDS` by so many processes, more than cores if need be."""
    root = ["--allow-run-as-root"] if os.geteuid() == 0 else []
    head = [MPIRUN, *root, "--oversubscribe", "-n", num_processes, sys.executable, "-m", "bundle"]
    return [str(word) for word in (*head, *words)]
