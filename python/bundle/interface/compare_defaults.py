"""What a comparison does unless something else is asked for: declared once.

The command line reads this for its flags and its help, without the import of
``bundle.planning.comparison``.
"""

from __future__ import annotations

from bundle.base.memory_sizes import SHARE_OF_FREE_MEMORY

__all__ = [
    "BACKENDS",
    "COMPARED",
    "ORDERINGS",
    "PRECONDITIONERS",
    "REPEAT",
    "SECONDS_NOT_REPEATED",
    "SHARE_OF_FREE_MEMORY",
    "SOLVERS",
    "THREADS",
    "TIMEOUT",
]

BACKENDS = ("fused", "ceres")
SOLVERS = ("dense_schur", "sparse_schur", "iterative_schur")
PRECONDITIONERS = ("auto",)
ORDERINGS = ("points_first",)
THREADS = (0,)
REPEAT = 3
"""Runs of each method."""
TIMEOUT = 60.0
"""Seconds after which a solve is stopped."""
SECONDS_NOT_REPEATED = 10.0
"""A run that took this long is not repeated: its spread is small."""

COMPARED = {
    "backend": "backends",
    "linear_solver_type": "solvers",
    "linear_solver_ordering": "orderings",
    "preconditioner_type": "preconditioners",
    "num_threads": "threads",
}
"""Options of a solve that are compared, with the arguments (and flags) that list their values."""
