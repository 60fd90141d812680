"""A way to solve: what a comparison varies."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.base.words import plural
from bundle.interface.options import SolveOptions

__all__ = ["ITERATIVE", "Method"]

ITERATIVE = ("iterative_schur", "cgnr")


@dataclass(frozen=True, kw_only=True)
class Method:
    """The options that a comparison varies, under the names and values of SolveOptions.

    ``num_threads`` is never 0. ``preconditioner_type`` is "auto" where nothing iterates.
    """

    backend: str
    linear_solver_type: str
    linear_solver_ordering: str = "points_first"
    preconditioner_type: str = "auto"
    num_threads: int

    @property
    def name(self) -> str:
        """Return "fused SPARSE_SCHUR", with whatever differs from the defaults, but no threads."""
        words = [self.backend, self.linear_solver_type.upper()]
        if self.preconditioner_type != "auto":
            words.append(self.preconditioner_type.upper())
        if self.linear_solver_ordering != "points_first":
            words.append(self.linear_solver_ordering.replace("_", " "))
        return " ".join(words)

    @property
    def threads(self) -> str:
        """Return "2 threads"."""
        return plural(self.num_threads, "thread")

    @property
    def is_iterative(self) -> bool:
        """Whether it is sure to iterate on the linear system."""
        return self.linear_solver_type in ITERATIVE

    def options(self, base: SolveOptions) -> SolveOptions:
        """Return the options of a solve by this method."""
        return base.replace(
            backend=self.backend,
            linear_solver_type=self.linear_solver_type,
            linear_solver_ordering=self.linear_solver_ordering,
            preconditioner_type=self.preconditioner_type,
            num_threads=self.num_threads,
        )
